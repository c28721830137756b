"""Events of a plane that moves past the camera, in the plane's own coordinates: smeared by dim light, and mended.

    python benchmarks/moving_plane.py --out docs/moving_plane.png --numbers docs/moving_plane.json

The plane shows a word, dark on bright, and passes a few columns of pixels at one speed, in bright and in dim light.
Each event is put where its pixel looked on the plane when it came (first row).  In the second row the pixel is undone:
the plane of least total variation is looked for which, seen through the circuit, explains all events and the silence
between them, and the events that pixels without a bandwidth limit would have sent of it are put on the plane.

The score is the correlation of ON minus OFF with the contrast of the plane along its motion, 1 where every event lies
on the edge that made it.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path

import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter
from torch.nn.functional import huber_loss

from pixelid.figures.style import styled
from pixelid.model.shipped import find_model
from pixelid.nerf.pixel.model import Bandwidth, Pixel
from pixelid.nerf.pixel.scan import respond
from pixelid.nerf.training.recipe import Recipe
from pixelid.simulate import simulate_stream
from pixelid.stages.circuit import Circuit

WHITES = (2_000.0, 100.0, 20.0, 10.0)  # fA
SPEED = 400.0  # plane pixels per second
WIDTH, HEIGHT = 8, 64  # of the sensor
MARGIN = 24  # plane pixels beside the word
SAMPLES = 2  # of the light, per pixel of motion
DARKEST = 0.15  # of the plane, relative to white
STEPS = 400  # of the search for the light
SPREAD, PULL = 0.2, 2.0  # thresholds: how well an event tells the output; weight of the total variation


def plane() -> np.ndarray:
    """(HEIGHT, columns) radiance of the plane, 1 at white."""
    figure = Figure(figsize=(4.8, HEIGHT / 50), dpi=50 * 4)
    canvas = FigureCanvasAgg(figure)
    figure.text(0.5, 0.47, "pixelid", ha="center", va="center", fontsize=74, fontweight="bold")
    canvas.draw()
    ink = 1.0 - np.asarray(canvas.buffer_rgba())[..., 0] / 255.0
    ink = gaussian_filter(ink, 2.0)[::4, ::4]  # pixels average over their area
    return np.pad(np.exp(np.log(DARKEST) * ink), ((0, 0), (MARGIN, MARGIN)), constant_values=1.0)


def frames(shown: np.ndarray, white: float):
    """(t, radiance (HEIGHT, WIDTH)) while the plane passes from right to left."""
    columns = np.arange(shown.shape[1])
    for k in range(SAMPLES * (shown.shape[1] - WIDTH) + 1):
        at = k / SAMPLES + np.arange(WIDTH)
        yield k / SAMPLES / SPEED, white * np.array([np.interp(at, columns, row) for row in shown])


def told_by(t, x, y, on, circuit: Circuit, level: float, grid: np.ndarray):
    """What events (N,) tell of the output: (pixel (N,), its level (N,), the last level at times (n,): (pixels, n)).

    Events are put into order of pixels: t (N,) comes first.
    """
    pixel = y * WIDTH + x
    order = np.argsort(pixel, kind="stable")
    t, pixel, on = t[order], pixel[order], on[order]
    total = np.concatenate([[0.0], np.cumsum(np.where(on, circuit.on_threshold, -circuit.off_threshold))])
    first = np.searchsorted(pixel, np.arange(WIDTH * HEIGHT + 1))
    told = level + total[1:] - total[first[pixel]]
    last = np.empty((WIDTH * HEIGHT, len(grid)))
    for k, (begin, end) in enumerate(itertools.pairwise(first)):
        levels = np.concatenate([[level], told[begin:end]])
        last[k] = levels[np.searchsorted(t[begin:end], grid, side="right")]
    return t, pixel, told, last


def light_behind(t, x, y, on, circuit: Circuit, level: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    """(t (n,) s, ln light (pixels, n)) of the plane that explains the events (N,) through the circuit.

    level: ln light before the first event;  end: s, of the recording
    """
    dynamics, grid = Pixel(circuit, Bandwidth("on")).dynamics, np.arange(0.0, end, 1 / (SAMPLES * SPEED))
    t, pixel, told, last = told_by(t, x, y, on, circuit, level, grid)
    place = t * SAMPLES * SPEED
    before = np.minimum(place.astype(int), len(grid) - 2)
    share, told, last = (torch.from_numpy(values) for values in (place - before, told, last))
    row, column = np.divmod(np.arange(WIDTH * HEIGHT)[:, None], WIDTH)
    looks_at = row, SAMPLES * column + np.arange(len(grid))  # of the plane, (pixels, n)
    shown = torch.full((HEIGHT, len(grid) + SAMPLES * (WIDTH - 1)), level, dtype=torch.float64, requires_grad=True)
    times, first = np.tile(grid, len(row)), np.arange(len(row) + 1) * len(grid)
    threshold = 0.5 * (circuit.on_threshold + circuit.off_threshold)
    recipe, optimiser = Recipe(iterations=STEPS), torch.optim.Adam([shown])
    for step in range(STEPS):
        optimiser.param_groups[0]["lr"] = recipe.rate_at(step)
        seen = respond(shown[looks_at].flatten(), dynamics, times, first)[0].reshape(len(row), -1)
        at_event = torch.lerp(seen[pixel, before], seen[pixel, before + 1], share)
        events_left = huber_loss((at_event - told) / threshold, torch.zeros_like(at_event))
        # between events the output stays within a threshold of what the last one told
        silence = torch.relu((seen - last).abs() / threshold - 1.0).square().mean()
        variation = sum(torch.diff(shown, dim=axis).abs().mean() for axis in (0, 1)) / threshold
        loss = (events_left + silence) / SPREAD**2 + PULL * shown.numel() / len(t) * variation
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return grid, shown.detach().numpy()[looks_at]


def events_of(grid: np.ndarray, u: np.ndarray, threshold: float, level: float):
    """(t, x, y, on) that pixels without bandwidth limit send at ln light u (pixels, n)."""
    columns = []
    for k, light in enumerate(u):
        now = level
        for i, value in enumerate(light):
            while abs(value - now) >= threshold:
                on = value > now
                now += threshold if on else -threshold
                columns.append((0.5 * (grid[i - 1] + grid[i]), k % WIDTH, k // WIDTH, on))
    t, x, y, on = (np.array(column) for column in zip(*columns, strict=True))
    return t, x, y, on


def on_plane(t, x, y, on, shape) -> np.ndarray:
    """(HEIGHT, columns) ON minus OFF events per cell of the plane."""
    column = np.ceil(x + SPEED * t).astype(int)  # the contrast from the one before
    inside = (column >= 0) & (column < shape[1])
    picture = np.zeros(shape)
    np.add.at(picture, (y[inside], column[inside]), np.where(on[inside], 1.0, -1.0))
    return picture


def score(picture: np.ndarray, shown: np.ndarray) -> float:
    """Correlation with the contrast of the plane from a column to the next."""
    contrast = np.zeros(shown.shape)
    contrast[:, 1:] = np.diff(np.log(shown), axis=1)
    return float((picture * contrast).sum() / np.sqrt((picture**2).sum() * (contrast**2).sum()))


def passes(white: float, seed: int) -> dict:
    """Pictures and scores of one pass at one light."""
    model, shown = find_model("dvs128"), plane()
    end, level = (shown.shape[1] - WIDTH) / SPEED, float(np.log(white))
    chunks = list(simulate_stream(model, frames(shown, white), seed=seed))
    t, x, y, p = (np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in "txyp")
    recorded = t * 1e-9, x.astype(np.int64), y.astype(np.int64), p > 0
    circuit = model.circuit()
    mended = events_of(*light_behind(*recorded, circuit, level, end), circuit.on_threshold, level)
    pictures = [on_plane(*recorded, shown.shape), on_plane(*mended, shown.shape)]
    return {"white_fa": white, "events": len(t), "pictures": pictures, "scores": [score(p, shown) for p in pictures]}


@styled
def draw(results: list[dict], path: Path) -> np.ndarray:
    """A column per light: as recorded, and with the pixel undone."""
    figure = Figure(figsize=(9.0, 2.1), dpi=200, layout="constrained")
    axes = figure.subplots(2, len(results))
    for column, result in enumerate(results):
        for row, (picture, value) in enumerate(zip(result["pictures"], result["scores"], strict=True)):
            axis = axes[row, column]
            most = np.percentile(np.abs(picture), 99)
            axis.imshow(picture, cmap="RdBu", vmin=-most, vmax=most)
            axis.set(xticks=[], yticks=[])
            axis.spines[:].set_visible(False)
            axis.set_xlabel(f"correlation {value:.2f}")
        axes[0, column].set_title(f"{result['white_fa']:,g} fA")
    axes[0, 0].set_ylabel("recorded")
    axes[1, 0].set_ylabel("pixel undone")
    figure.savefig(path)
    return axes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/moving_plane.png"))
    parser.add_argument("--numbers", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    results = [passes(white, options.seed) for white in WHITES]
    draw(results, options.out)
    for result in results:
        recorded, mended = result["scores"]
        print(f"{result['white_fa']:8g} fA: {result['events']} events, recorded {recorded:.3f}, undone {mended:.3f}")
    if options.numbers:
        rows = [{name: value for name, value in result.items() if name != "pictures"} for result in results]
        options.numbers.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
