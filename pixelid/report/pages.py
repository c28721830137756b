"""The pages: which JSON marks a kind of result, what is said first, and what its figures show.

An entry of `PAGES` is all that a new kind of result needs beside its template in `templates/`.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pixelid.documents import read_json
from pixelid.errors import InputError
from pixelid.model.files import load_model
from pixelid.report.format import count, counted, interval, number, percent, seconds, value

Result = dict[str, Any]

TONES = {
    "converged": "good", "named": "good", "none": "good",
    "misfit": "warn", "at_bound": "warn", "not_identified": "warn", "ambiguous": "warn", "unknown": "warn",
}  # fmt: skip
VERDICTS = {
    "converged": "Converged", "misfit": "Misfit: the model does not describe the data",
    "at_bound": "A parameter sits on its bound", "not_identified": "Not identified", "not_converged": "Not converged",
    "diverged": "Diverged", "interrupted": "Interrupted", "none": "No gap: the model describes the recordings",
    "named": "The gap has a name", "ambiguous": "Several effects explain the gap equally well",
    "unknown": "A gap remains that no known effect explains",
}  # fmt: skip


@dataclass(frozen=True)
class Number:
    """One of the numbers on the card."""

    label: str
    value: str
    unit: str = ""


@dataclass(frozen=True)
class Summary:
    """What the card on top says.

    Attributes:
        kind: of the result, as its command is called.
        title: of the page.
        status: the closed word of the JSON.
        sentence: what it means here.
        numbers: the five that matter.
        command: how to make it again; empty where the result does not say.
        headline: what stands for the status where there is none.
    """

    kind: str
    title: str
    status: str
    sentence: str
    numbers: tuple[Number, ...]
    command: str
    headline: str = ""

    @property
    def tone(self) -> str:
        """good, warn, bad or plain: the colour of the card; the words say the same."""
        return TONES.get(self.status, "bad" if self.status else "plain")

    @property
    def verdict(self) -> str:
        """The status in words."""
        return self.headline or VERDICTS.get(self.status, self.status.replace("_", " ").capitalize())


@dataclass(frozen=True)
class Page:
    """A kind of result.

    Attributes:
        file: the JSON that marks it.
        template: in `templates/`.
        summarise: (result, folder) → what the card says.
        prepare: (result, folder) → further names for the template.

    The captions of its figures are in `captions.toml`, under the name of the JSON.
    """

    file: str
    template: str
    summarise: Callable[[Result, Path], Summary]
    prepare: Callable[[Result, Path], dict[str, Any]] = lambda result, folder: {}


def command_line(name: str, result: Result, *words: str, out: Path, inputs: bool = True, seed: bool = True) -> str:
    """The command as the result records it, else put together from what it does record."""
    if result.get("command"):
        return str(result["command"])
    files = [f for f in result.get("inputs_sha256", {}) if not f.endswith((".toml", "fit.json"))] if inputs else []
    parts = ["pixelid", name, *files, *words, *(["--seed", str(result["seed"])] if seed and "seed" in result else [])]
    name = out.resolve().name
    if name.startswith("."):  # still being written, beside its place: .NAME.random
        name = name[1:].rpartition(".")[0]
    return shlex.join([*parts, "--out", name or "out"])


def _known(result: Result) -> Number:
    free = [p for p in result["parameters"].values() if not p.get("fixed")]
    return Number("parameters identified", f"{sum(bool(p['identified']) for p in free)} of {len(free)}")


def _fit(result: Result, folder: Path) -> Summary:
    return Summary(
        "fit",
        f"{result['model']}, fitted",
        result["status"],
        result.get("advice", ""),
        (
            Number("events", count(result["events"])),
            Number("pixels", str(result["pixels"]), f"in {counted(len(result['recordings']), 'recording')}"),
            _known(result),
            Number("log-likelihood", number(result["log_likelihood"], 6), "nats"),
            Number("time taken", seconds(result["seconds"])),
        ),
        command_line("fit", result, "--model", str(result["model"]), out=folder),
    )


def _fit_more(result: Result, folder: Path) -> dict[str, Any]:
    truth = folder / "truth.json"
    return {
        "truth": read_json(truth) if truth.is_file() else None,
        "physical": [[name, number(v)] for name, v in (result.get("physical") or {}).items()],
    }


def _gap(result: Result, folder: Path) -> Summary:
    gap = result.get("gap") or {}
    closed = gap.get("closed_fraction")
    best = max((e["heldout_gain_nats"] for e in result["effects"] if e["heldout_gain_nats"] is not None), default=None)
    return Summary(
        "gap",
        f"What {_base_name(folder)} lacks",
        result["verdict"],
        result["sentence"],
        (
            Number("effects named", str(len(result["effects"]))),
            Number("chance of the base model showing this", number(result["global_p"], 2)),
            Number("largest held-out gain", number(best, 3), "nats" if best is not None else ""),
            Number("gap closed", percent(closed, 3), interval(gap.get("closed_fraction_interval")) if closed else ""),
            Number("time taken", seconds(result.get("seconds"))),
        ),
        command_line("gap", result, "--model", _base_name(folder), out=folder),
    )


def _base_name(folder: Path) -> str:
    """The name of the model that was grown; the grown one carries it with a suffix."""
    try:
        return load_model(folder / "model.toml").name.removesuffix("_grown")
    except InputError:
        return "the model"


def _gap_more(result: Result, folder: Path) -> dict[str, Any]:
    details = result.get("details", {})
    effects = [
        [
            e["name"],
            "; ".join(
                f"{name} = {value(v['value'], v.get('interval_95'))}"
                + (f" ({interval(v['interval_95'])})" if v.get("interval_95") else "")
                for name, v in e["parameters"].items()
            ),
            number(e["p_value"], 2),
            number(e["heldout_gain_nats"]),
            f"{e['runner_up']}, {number(e['runner_up_gain_nats'])}" if e.get("runner_up") else "–",
            f"{e['max_cosine_with']} ({e['max_cosine']:.2f})" if e.get("max_cosine_with") else "–",
        ]
        for e in result["effects"]
    ]
    shows = details.get("shows_at_typical_strength_nats", {})
    confusion = [
        [
            name,
            number(shows.get(name)),
            f"{v['most_alike']} ({v['cosines'][v['most_alike']]:.2f})" if v["most_alike"] else "–",
            number(v["told_apart_nats"]),
        ]
        for name, v in details.get("confusion", {}).items()
    ]
    jumps = [
        [row["where"], number(row["measured"]), number(row["base"]), number(row["grown"])]
        for row in details.get("after_jumps", ())
    ]
    return {"effects": effects, "confusion": confusion, "after_jumps": jumps}


def _lowlight(result: Result, folder: Path) -> Summary:
    regimes = result["regimes"]
    critical = regimes["critical"]
    unit = result["radiance_unit"]
    return Summary(
        "lowlight",
        f"{result['model']} in low light",
        result["status"],
        result.get("advice", ""),
        (
            Number("radiance where αL = β²", number(regimes["epsilon_one"], 3), unit),
            Number("radiance where γL = β", number(regimes["gamma_one"], 3), unit),
            Number("poles are complex", interval(critical) if critical else "nowhere", unit if critical else ""),
            Number("lowest damping", number(regimes["lowest_damping"], 2)),
            Number("recordings compared", str(len(result["measured"]))),
        ),
        command_line("lowlight", result, str(result["model"]), out=folder, inputs=False),
    )


def _lowlight_more(result: Result, folder: Path) -> dict[str, Any]:
    from pixelid.lowlight.table import MEASURED_HEADINGS, RADII_HEADINGS, measured_rows, not_measurable, radii_rows

    levels = [
        [number(x["radiance"], 3)]
        + (
            [number(x["epsilon"], 3), number(x["gamma_ratio"], 3), number(x["damping"], 3),
             "complex" if x["complex"] else "real"]
            if "damping" in x else ["–"] * 4
        )
        for x in result["regimes"]["levels"]
    ]  # fmt: skip
    return {
        "radii_headings": RADII_HEADINGS,
        "radii": radii_rows(result),
        "measured_headings": MEASURED_HEADINGS,
        "measured": measured_rows(result),
        "not_measurable": not_measurable(result),
        "levels": levels,
    }


def _design(result: Result, folder: Path) -> Summary:
    best = result["recommended"]
    return Summary(
        "design",
        f"Record next: {best['name']}",
        result["status"],
        " ".join(x for x in (result["why"], result.get("advice", "")) if x),
        (
            Number("stimulus", best["kind"]),
            Number("light", seconds(best["duration_s"])),
            Number(f"score by {result['criterion']}", number(best["score"], 3), "nats"),
            Number("events expected", number(best["events"], 2)),
            Number("stimuli compared", str(len(result["ranking"]))),
        ),
        command_line("design", result, str(result["model"]), "--criterion", result["criterion"], out=folder,
                     inputs=False),
    )  # fmt: skip


def _design_more(result: Result, folder: Path) -> dict[str, Any]:
    from pixelid.design.table import RANKING_HEADINGS, WIDTHS_HEADINGS, ranking_rows, widths_rows

    return {
        "ranking_headings": RANKING_HEADINGS,
        "ranking": ranking_rows(result),
        "widths_headings": WIDTHS_HEADINGS,
        "widths": widths_rows(result),
    }


def _rates(result: Result, folder: Path) -> Summary:
    suspects = sum(abs(row["standardised"]) > 4 for row in result.get("rows", ()))
    return Summary(
        "rates",
        {"pixel": "Event rates of one pixel", "pool": "Event rates of a light's image"}[result["model"]],
        result["status"],
        result.get("advice", ""),
        (
            Number("cells", str(result["cells_fitted"])),
            Number("relative scatter", percent(result["relative_scatter"])),
            Number("cells disbelieved", str(suspects)),
            _known(result),
            Number("log-likelihood", number(result["log_likelihood"]), "nats"),
        ),
        command_line("rates", result, out=folder),
    )


def _noise(result: Result, folder: Path) -> Summary:
    worst = max(
        (abs(row["measured"] / row["predicted"] - 1.0) for row in result["rows"] if row["measured"]), default=0.0
    )
    return Summary(
        "noise",
        "Noise events of still scenes",
        result["status"],
        result.get("advice", ""),
        (
            Number("rows", str(len(result["rows"]))),
            Number("relative scatter", percent(result["relative_scatter"])),
            Number("largest disagreement", percent(worst)),
            _known(result),
            Number("unit of light", result["radiance_unit"]),
        ),
        command_line("noise", result, out=folder),
    )


def _flicker(result: Result, folder: Path) -> Summary:
    frequency, groups = result["frequency_hz"], result["groups"]
    locked = sum(g["amplitude_over_on_threshold"]["identified"] and g["phase_cycles"]["identified"] for g in groups)
    return Summary(
        "flicker",
        f"Light that flickers at {frequency['value']:.2f} Hz",
        result["status"],
        result.get("advice", ""),
        (
            Number("frequency", f"{frequency['value']:.3f}", f"± {number(frequency['std'], 2)} Hz"),
            Number("shape of the light", result["shape"]),
            Number("groups locked", f"{locked} of {len(groups)}", f"{result['groups_left_out']} left out"),
            Number("directions fixed", str(result["fixed_directions"]), f"{result['blind_directions']} blind"),
            Number("time taken", seconds(result["seconds"])),
        ),
        command_line("flicker", result, "--frequency", f"{frequency['value']:.4g}", out=folder),
    )


def _flicker_more(result: Result, folder: Path) -> dict[str, Any]:
    def cell(entry: dict) -> str:
        return f"{entry['value']:.3g}" + (f" ± {entry['std']:.2g}" if entry["std"] is not None else " (open)")

    names = ("amplitude_over_on_threshold", "off_over_on_threshold", "phase_cycles", "noise_over_on_threshold")
    return {
        "groups": [
            [f"{g['column']}, {g['row']}", str(g["events"]), *(cell(g[n]) for n in names), f"{g['dispersion']:.2f}"]
            for g in sorted(result["groups"], key=lambda g: -g["events"])
        ]
    }


def _reconstruction(result: Result, folder: Path) -> Summary:
    views = result["views"]
    return Summary(
        "reconstruct",
        "A scene from events",
        result["status"],
        result.get("advice", ""),
        (
            Number("PSNR, mean", f"{views['psnr']:.2f}", "dB"),
            Number("SSIM, mean", f"{views['ssim']:.3f}"),
            Number("changes unexplained", number(result["held_out_residual"], 3), "rms, held-out pixels"),
            Number("bandwidth", result["bandwidth"]),
            Number("time taken", seconds(result["seconds"]), f"{result['iterations']} steps on {result['device']}"),
        ),
        command_line("reconstruct", result, "DATASET", "--bandwidth", result["bandwidth"], out=folder, inputs=False),
    )


def _reconstruction_more(result: Result, folder: Path) -> dict[str, Any]:
    def cell(v: Any) -> str:
        if isinstance(v, list):
            return ", ".join(number(x) for x in v)
        return number(v) if isinstance(v, (int, float)) and not isinstance(v, bool) else str("–" if v is None else v)

    def row(name: str, v: dict) -> list[str]:
        return [name, f"{v['psnr']:.2f}", f"{v['ssim']:.3f}", number(v["lpips"], 3)]

    views = [row(v["name"], v) for v in result["views"]["per_view"]]
    return {
        "views": [row("mean", result["views"]), *views],
        "pixel": [[name, cell(v)] for name, v in result["pixel"].items()],
    }


def _inspect(result: Result, folder: Path) -> Summary:
    dead, rate, lines = result["dead_time_s"], result["rate_hz"], result["lines"]
    if dead.get("kind") == "upper_bound":
        dead_time = Number("dead time", f"≤ {seconds(dead['interval_95'][1])}", "shortest interval")
    elif dead["value"] is not None:
        dead_time = Number("dead time", seconds(dead["value"]))
    else:
        dead_time = Number("dead time", "not visible")
    return Summary(
        "inspect",
        result["name"] or "Recording",
        "",
        "What the events of the recording show by themselves, without knowing the light.",
        (
            Number("events", count(result["events"]), f"in {seconds(result['duration_s'])}"),
            Number("mean rate", number(rate["mean"], 3), "Hz"),
            dead_time,
            Number("strongest line", number(lines[0]["frequency_hz"]) if lines else "none", "Hz" if lines else ""),
            Number("hot pixels", str(result["hot_pixel_count"])),
        ),
        command_line("inspect", result, out=folder, seed=False),
        "Health of the recording",
    )


def _inspect_more(result: Result, folder: Path) -> dict[str, Any]:
    from pixelid.inspection.table import rows_of_result

    return {
        "findings": [list(row) for row in rows_of_result(result)],
        "hot": [[f"{p['x']}, {p['y']}", number(p["rate_hz"], 3), str(p["events"])] for p in result["hot_pixels"]],
        "lines": [
            [f"{x['frequency_hz']:.3f}", number(x["uncertainty_hz"], 2), number(x["modulation"], 2),
             str(len(x["harmonics_hz"])), number(x["p_value"], 2)]
            for x in result["lines"]
        ],
    }  # fmt: skip


def _static_noise(result: Result, folder: Path) -> Summary:
    conditions, leak = result["conditions"], result["by_light"]
    return Summary(
        "inspect",
        "Noise of a still scene",
        "",
        result["findings"][0] if result["findings"] else "",
        (
            Number("conditions", str(len(conditions))),
            Number("pixels", str(conditions[0]["pixels"])),
            Number("intervals", count(sum(c["intervals"] for c in conditions))),
            Number("leak, median pixel", number(leak["leak_hz"], 2) if leak else "–", "Hz" if leak else ""),
            Number("by light", number(leak["parasitic_hz_per_lux"], 2) if leak else "–", "Hz/lux" if leak else ""),
        ),
        command_line("inspect", result, out=folder),
        "What the intervals show",
    )


def _static_noise_more(result: Result, folder: Path) -> dict[str, Any]:
    def triple(v: list | None) -> str:
        return "–" if v is None else f"{number(v[0], 3)} ({interval(v[1:])})"

    return {
        "conditions": [
            [f"{c['lux']:g} lux, {c['polarity']}", str(c["intervals"]), percent(c["without_intervals"]),
             triple(c["rate_hz"]), triple(c["cv"]), c["kind"]]
            for c in result["conditions"]
        ]
    }  # fmt: skip


def _compare(result: Result, folder: Path) -> Summary:
    models = result["models"]
    order = sorted(models, key=lambda name: -models[name]["behind_best_nats"])
    second = models[order[1]]
    return Summary(
        "compare",
        " or ".join(models) + "?",
        "converged" if all(m["status"] == "converged" for m in models.values()) else "misfit",
        result["sentence"][:1].upper() + result["sentence"][1:] + ".",
        (
            Number("most likely on held-out pixels", result["best"]),
            Number("ahead of the next by", number(-second["behind_best_nats"], 3), "nats"),
            Number("± standard error", number(second["behind_best_se"], 2), "nats"),
            Number("smallest BIC", min(models, key=lambda name: models[name]["bic"])),
            Number("models", str(len(models))),
        ),
        command_line("compare", result, *(w for name in models for w in ("--model", name)), out=folder),
    )


def _compare_more(result: Result, folder: Path) -> dict[str, Any]:
    return {
        "models": [
            [name, m["status"].replace("_", " "), str(m["free_parameters"]), f"{m['held_out_log_likelihood']:.1f}",
             f"{number(m['behind_best_nats'])} ± {number(m['behind_best_se'], 2)}", f"{m['bic']:.1f}"]
            for name, m in sorted(result["models"].items(), key=lambda item: -item[1]["behind_best_nats"])
        ]
    }  # fmt: skip


def _sensor(result: Result, folder: Path) -> Summary:
    maps = result["maps"]
    first = next(iter(maps.values()))
    return Summary(
        "sensor",
        f"Maps of {result['width']} × {result['height']} pixels",
        result["status"],
        result.get("advice", ""),
        (
            Number("pixels with events", count(result["pixels_with_events"])),
            Number("events", count(result["events"])),
            Number("parameters mapped", str(len(maps))),
            Number(f"spread of {next(iter(maps))}", percent(first["relative_spread"])),
            Number("time taken", seconds(result["seconds"])),
        ),
        command_line("sensor", result, "--model", str(result["model"]), out=folder),
    )


def _sensor_more(result: Result, folder: Path) -> dict[str, Any]:
    return {
        "maps": [
            [name, value(m["mean"], m["mean_interval_95"]), m["unit"], percent(m["relative_spread"]),
             percent(m["typical_error_before"]), percent(m["typical_error_after"]), str(m["without_estimate"])]
            for name, m in result["maps"].items()
        ]
    }  # fmt: skip


PAGES = (
    Page("gap.json", "gap.html", _gap, _gap_more),
    Page("fit.json", "fit.html", _fit, _fit_more),
    Page("lowlight.json", "lowlight.html", _lowlight, _lowlight_more),
    Page("design.json", "design.html", _design, _design_more),
    Page("rates.json", "rates.html", _rates),
    Page("noise.json", "noise.html", _noise),
    Page("flicker.json", "flicker.html", _flicker, _flicker_more),
    Page("reconstruction.json", "reconstruction.html", _reconstruction, _reconstruction_more),
    Page("inspect.json", "inspect.html", _inspect, _inspect_more),
    Page("static_noise.json", "static_noise.html", _static_noise, _static_noise_more),
    Page("compare.json", "compare.html", _compare, _compare_more),
    Page("sensor.json", "sensor.html", _sensor, _sensor_more),
)
