"""Pictures from the session of `pixelid demo`: the first one, a photodiode's trace, and residuals of two models.

    python docs/tutorial_pictures.py --out docs

`tutorial/bench.svg` is drawn by hand.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from pixelid.bench.calibrate import calibrate
from pixelid.bench.result import Calibration
from pixelid.demo.demo import BENCH
from pixelid.documents import read_json
from pixelid.figures.intervals import draw_intervals
from pixelid.figures.style import INK, MUTED, OFF, ON, new_axes, save_figure, styled
from pixelid.fit.figures import standardised
from pixelid.fit.panels import draw_light, draw_rates, light_of, simulated
from pixelid.fit.result import FitResult
from pixelid.stimuli.files import load_stimulus

RECORDING = "chirp_400"
STORY = "chirp_24"
PAGE_WIDTH, PAGE_END = 920, ".recording"
MOST_POINTS = 2000  # of a curve
BINS = 14


@styled
def draw_trace():
    """A chirp as the photodiode saw it: whole, and its last milliseconds."""
    light = load_stimulus(BENCH / f"{RECORDING}_light.npz")
    t = light.t - light.t[0]
    axes = new_axes(1, 2, 4.4, 2.3)
    step = max(len(t) // MOST_POINTS, 1)
    axes.flat[0].plot(t[::step], light.radiance[::step], color=MUTED, linewidth=0.8)
    late = t > t[-1] - 0.01
    axes.flat[1].plot(1e3 * t[late], light.radiance[late], ".-", color=MUTED, markersize=3, linewidth=0.8)
    axes.flat[0].set(title="whole trace", xlabel="time (s)", ylabel=f"light ({light.unit})", ylim=(0, None))
    axes.flat[1].set(title="its last 10 ms", xlabel="time (ms)", ylim=(0, None))
    return axes


@styled
def draw_residuals(result: Calibration):
    """Mean residual against the time since the pixel's previous event, of the start model and of the calibrated one."""
    axes = new_axes(1, 2, 4.4, 2.5)
    for axis, fit, title in zip(
        axes.flat, (result.first, result.fit), ("bad: dvs128 without a leak", "good: with the leak"), strict=True
    ):
        _residuals(axis, fit, result)
        axis.set(title=title, xlabel="time since the pixel's previous event (s)", xscale="log")
    low = min(axis.get_ylim()[0] for axis in axes.flat)
    high = max(axis.get_ylim()[1] for axis in axes.flat)
    for axis in axes.flat:
        axis.set_ylim(low, high)
    axes.flat[0].set_ylabel("mean residual\n(standard deviations)")
    axes.flat[0].legend()
    return axes


@styled
def draw_story(result: Calibration):
    """From light and events to the fitted pixel: a recording, its rates measured and simulated, and the parameters."""
    recording = next(r for r in result.recordings if r.name == STORY)
    events, light = recording.events, light_of(recording, "linear")
    pixels, row = np.unique(events.pixel, return_inverse=True)
    figure_axes = new_axes(2, 3, 3.0, 1.7, height_ratios=(1, 2))
    draw_light(figure_axes[0, 0], recording)
    figure_axes[0, 0].set_title("1. Light, measured")
    t = 1e-9 * events.t
    for sign, colour, name in ((1, ON, "ON"), (0, OFF, "OFF")):
        mine = events.p == sign
        figure_axes[1, 0].plot(t[mine], row[mine], "|", color=colour, markersize=3, markeredgewidth=0.5, label=name)
    figure_axes[1, 0].set(title=f"2. Events of {len(pixels)} pixels", xlabel="time (s)", ylabel="pixel", yticks=[])
    figure_axes[1, 0].sharex(figure_axes[0, 0])
    grid = figure_axes[0, 1].get_gridspec()
    for axis in (*figure_axes[:, 1], *figure_axes[:, 2]):
        axis.remove()
    rates, intervals = (figure_axes[0, 0].figure.add_subplot(grid[:, k]) for k in (1, 2))
    model = simulated(result.fit.model, recording, light, result.fit.seed, len(pixels))
    draw_rates(rates, recording, light, {"the fitted pixel": (model, len(pixels), None, "-")})
    rates.set(title="3. Measured (areas) and fitted (lines)", xlabel="time (s)", ylabel="events/s per pixel")
    truth = read_json(BENCH / "truth.json")
    of_effects = {f"{name}.rate_hz": value for name, value in truth["effects"].items()}
    hidden = {**truth, **of_effects, "threshold_mismatch.sigma": truth["threshold_mismatch"]}
    own = {n: p for n, p in result.as_dict()["parameters"].items() if "[" not in n and "alignment" not in n}
    draw_intervals(own, reference=hidden, axis=intervals)
    intervals.set(title="4. The pixel", xlabel="95 % intervals over the truth")
    for legend in rates.figure.legends:
        legend.remove()
    return np.array([figure_axes[0, 0], figure_axes[1, 0], rates, intervals])


def _residuals(axis, fit: FitResult, result: Calibration) -> None:
    likelihood, residual, kept = standardised(fit, result.recordings)
    since = np.concatenate([each.time_s - each.previous_s for each in likelihood.intervals])
    bins = np.geomspace(since[kept].min(), 1.001 * since[kept].max(), BINS + 1)
    centre = np.sqrt(bins[1:] * bins[:-1])
    for sign, colour, name in ((1, ON, "ON"), (-1, OFF, "OFF")):
        chosen = kept & (likelihood.sign == sign)
        index = np.digitize(since[chosen], bins) - 1
        count = np.bincount(index, minlength=BINS)[:BINS]
        full = count > 9
        mean = np.bincount(index, residual[chosen], BINS)[:BINS][full] / count[full]
        axis.errorbar(centre[full], mean, 2 / np.sqrt(count[full]), fmt="o", color=colour, label=name, markersize=3)
    axis.axhline(0.0, color=INK, linewidth=0.6)


# Numbers next to the parts of a page that the tutorial lists in this order.
NUMBERS = """(parts => parts.forEach((part, k) => {
  const at = document.querySelector(part).getBoundingClientRect(), mark = document.createElement("b");
  mark.textContent = k + 1;
  mark.style = `position: absolute; left: 8px; top: ${at.top + scrollY}px; width: 26px; border-radius: 13px;
    color: #fff; background: #b0578d; text-align: center; font: bold 16px/26px sans-serif`;
  document.body.append(mark);
}))(["h1", ".sentence", "#pixel", "#recordings", "#residuals-before-and-after"])"""


def take_page(result: Calibration, path: Path) -> None:
    """The page of a calibration with numbers at its parts, as Chromium shows it, down to the first recordings."""
    sys.path.append(str(Path(__file__).parents[1] / "tests"))
    from browser import Browser  # pyright: ignore[reportMissingImports]
    from PIL import Image

    with tempfile.TemporaryDirectory() as folder:
        page = result.report(Path(folder) / "camera", list(result.recordings))
        with Browser(Path(folder) / "profile") as window:
            window.visit(page, PAGE_WIDTH)
            window.evaluate("document.body.style.paddingLeft = '48px'")
            window.evaluate(NUMBERS)
            end = int(window.evaluate(f"document.querySelector('{PAGE_END}').getBoundingClientRect().bottom + scrollY"))
            with Image.open(window.screenshot(Path(folder) / "page.png")) as shot:
                shot.crop((0, 0, shot.width, end + 10)).convert("P", palette=Image.Palette.ADAPTIVE).save(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs"))
    parser.add_argument("--stages", type=Path, help="folder that keeps the calibration's stages")
    options = parser.parse_args()
    result = calibrate(BENCH, resume=options.stages)
    save_figure(draw_story(result), options.out / "picture.png")
    save_figure(draw_trace(), options.out / "tutorial" / "photodiode.svg")
    save_figure(draw_residuals(result), options.out / "tutorial" / "residuals.svg")
    take_page(result, options.out / "tutorial" / "page.png")


if __name__ == "__main__":
    main()
