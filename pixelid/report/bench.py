"""The page of a calibration."""

from __future__ import annotations

import base64
import shlex
from pathlib import Path
from typing import Any

from pixelid.documents import is_number, read_json
from pixelid.figures import words
from pixelid.report.forest import forest
from pixelid.report.format import count, counted, number, percent, seconds
from pixelid.report.methods import bibtex, methods
from pixelid.report.page import Number, Result, Summary, command_line, folder_name, identified
from pixelid.report.pixel_drawing import draw_pixel
from pixelid.report.quantities import quantities
from pixelid.report.scripts import script

STATUS_LINES = {
    "converged": "All checks passed: the model describes the recordings",
    "misfit": "The model does not describe everything in the recordings",
    "at_bound": "A parameter is on its bound",
    "not_identified": "The recordings leave part of the circuit open",
    "not_converged": "Not reliable: the optimiser stopped early",
    "diverged": "Not reliable: the fit diverged",
    "interrupted": "Interrupted: call it again to go on",
}
WHAT_TO_DO = {  # about a statement that the events contradict
    "level": "The fit uses the level found. Check filter and distance, then state `level` in bench.toml.",
    "offset": "The fit uses the zero found. Measure it with the photodiode covered.",
    "delay": "The fit uses the delay found. Check trigger input and wiring, or state `clock` in bench.toml.",
    "clock_rate": "The fit uses the rate found. Check the sampling rate in the light's file.",
    "polarity": 'ON and OFF were exchanged. State `polarity = "swapped"` under `[source]` in bench.toml.',
    "light": "The light that fits was used. State the right file under `light` in bench.toml.",
    "unit": "State `unit` in bench.toml.",
    "size": "State `size` under `[source]` in bench.toml.",
}
METHODS = {
    "trigger": "by trigger edges", "auto": "by the events", "given": "as given", "first-event": "by the first event",
    "inherited": "by the other recordings",
}  # fmt: skip
SHOWN_OF_A_KIND = 3  # of contradicted statements: more of a kind have one cause, which the first show
MOST_LINKED = 512 << 10  # bytes of a file that is put into the page; a page is to stay below 3 MB
LINKED = {"model.toml": "text/plain", "calibration.json": "application/json"}


def summarise(result: Result, folder: Path) -> Summary:
    """The answer, and the five numbers that it rests on."""
    used = sum(bool(row["used"]) for row in result["recordings"])
    line = STATUS_LINES.get(result["status"], "")
    if result["status"] == "converged" and result["held_out"]:
        line += f", and {counted(result['held_out']['pixels'], 'pixel')} that no fit has seen"
    return Summary(
        "calibrate",
        result["sentence"],
        result["status"],
        result.get("advice", ""),
        (
            identified(_circuit_alone(result)),
            Number("recordings used", f"{used} of {len(result['recordings'])}"),
            Number("events", count(result["events"]), f"of {counted(result['pixels'], 'pixel')}"),
            _unexplained(result),
            Number("time taken", seconds(result.get("seconds"))),
        ),
        command_line("calibrate", result, out=folder),
        line,
    )


def prepare(result: Result, folder: Path) -> dict[str, Any]:
    """What the template shows in addition to the JSON."""
    shown = quantities(result["parameters"])
    start, truth = result["start"], read_truth(folder, result)
    added = list(dict.fromkeys(q.effect for q in shown if q.effect and q.parameter not in start))
    estimated = [q for q in shown if not q.fixed]
    return {
        "copy": script("copy"),
        "drawings": [draw_pixel(shown, added, narrow) for narrow in (False, True)],
        "forest": forest(result["parameters"], start, truth, added),
        "untracked": [q for q in estimated if not _has_logarithm(result["parameters"][q.parameter])],
        "added": added,
        "statements": _by_kind(result["bench"]),
        "any_open": any(not q.identified for q in estimated),
        "recordings": [_recording(k, row, result["bench"]) for k, row in enumerate(result["recordings"])],
        "bench_parameters": {n: p for n, p in result["parameters"].items() if n not in {q.parameter for q in shown}},
        "refitted": bool(result["effects"] or result["described"]),
        "next_sentence": _next(result["recommended_next"], _light_unit(result)),
        "commands": _commands(folder_name(folder)),
        "downloads": _downloads(folder),
        "methods": methods(result, estimated, [name.replace("_", " ") for name in added]),
        "bibtex": bibtex(result),
    }


def read_truth(folder: Path, result: Result) -> dict[str, float]:
    """True values by parameter from truth.json in the folder, where one lies there.

    It holds values by parameter, also under `parameters`, or by the name of an effect under `effects`.
    """
    file = folder / "truth.json"
    if not file.is_file() or file.is_symlink():
        return {}
    content = read_json(file)
    nested = content.get("parameters"), content.get("effects")
    parameters, effects = (part if isinstance(part, dict) else {} for part in nested)
    truth = {}
    for q in quantities(result["parameters"]):
        found = next((part[name] for part, name in (
            (content, q.parameter), (parameters, q.parameter), (effects, q.effect)
        ) if name in part), None)  # fmt: skip
        if is_number(found):
            truth[q.parameter] = float(found)
    return truth


def _light_unit(result: Result) -> str:
    """The unit of the light, as that of γ or of the corner has it; "" where neither is there."""
    entry = result["parameters"].get("gamma") or result["parameters"].get("alpha_over_beta") or {}
    return str(entry.get("unit", "")).rpartition("/s/")[2]


def _circuit_alone(result: Result) -> Result:
    """The result with the pixel's parameters only: its title counts no others."""
    own = {q.parameter for q in quantities(result["parameters"])}
    return {**result, "parameters": {n: p for n, p in result["parameters"].items() if n in own}}


def _unexplained(result: Result) -> Number:
    held_out = result["held_out"]
    if held_out:
        return Number("events unexplained", percent(held_out["background_fraction"]), "on pixels held out")
    return Number("log-likelihood", number(result["log_likelihood"], 6), "nats")


def _has_logarithm(entry: dict[str, Any]) -> bool:
    return bool(entry["value"]) and entry["value"] > 0


def _by_kind(bench: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Contradicted statements of one kind together: sentences that are shown, the others, and what to do about all."""
    kinds = dict.fromkeys(s["statement"] for s in bench)
    sentences = {kind: [s["sentence"] for s in bench if s["statement"] == kind] for kind in kinds}
    return [
        {"shown": own[:SHOWN_OF_A_KIND], "more": own[SHOWN_OF_A_KIND:], "todo": WHAT_TO_DO.get(kind, "")}
        for kind, own in sentences.items()
    ]


def _recording(k: int, row: dict[str, Any], bench: list[dict[str, Any]]) -> dict[str, Any]:
    """What the card of a recording says."""
    doubted = any(s["recording"] == row["name"] for s in bench)
    light, verdict = (
        ("bad", "not used") if not row["used"] else ("warn", "used, see remark") if doubted else ("good", "used")
    )
    return {
        "figure": f"recording_{k:03d}",
        "name": row["name"],
        "light": light,
        "verdict": verdict,
        "events": f"{counted(row['events'], 'event')} of {counted(row['pixels'], 'pixel')}." if row["events"] else "",
        "aligned": _alignment(row["aligned"]),
        "why": row["why"] if not row["used"] else "",
        "remarks": [s["sentence"].removeprefix(f"{row['name']}: ") for s in bench if s["recording"] == row["name"]],
    }


def _alignment(aligned: dict[str, Any] | None) -> str:
    """Where the light starts on the camera's clock, how well that is known, and from what."""
    if aligned is None:
        return "Light and camera share one clock."
    if aligned["offset_s"] is None:
        return ""
    ends = aligned["interval_95"]
    known = f" ± {words.seconds(0.5 * (ends[1] - ends[0]))}" if ends else ""
    how = METHODS.get(aligned["method"], aligned["method"])
    start = f"{aligned['offset_s']:,.4f}".replace(",", "\N{NARROW NO-BREAK SPACE}")
    return f"The light starts at {start} s of the camera's clock{known}, {how}."


def _next(recommended: dict[str, Any], unit: str) -> str:
    """What to record next, in a sentence."""
    why, stimulus = recommended.get("why", "").replace("_", " "), recommended.get("stimulus")
    if not stimulus:
        return f"Recommended next: {why}." if why else ""
    values = [_with_unit(name, v, unit) for name, v in stimulus["parameters"].items() if name != "duration_s"]
    details = f" ({', '.join(values)})" if values else ""
    return f"Record next: {stimulus['kind']}{details} for {words.seconds(stimulus['duration_s'])}, {why}."


def _with_unit(name: str, value: float, light: str) -> str:
    """A stimulus' parameter in words; its name ends in its unit.

    >>> _with_unit("stop_hz", 794.0, "fA"), _with_unit("level", 210.0, "fA"), _with_unit("rise_s", 2e-3, "fA")
    ('stop 794 Hz', 'level 210 fA', 'rise 2 ms')
    """
    if name.endswith("_hz"):
        return f"{name.removesuffix('_hz').replace('_', ' ')} {number(value, 3)} Hz"
    if name.endswith("_s"):
        return f"{name.removesuffix('_s').replace('_', ' ')} {words.seconds(value)}"
    unit = f" {light}" if name == "level" and light else ""
    return f"{name.replace('_', ' ')} {number(value, 3)}{unit}"


def _commands(folder: str) -> list[tuple[str, str]]:
    """(what for, command) in the order in which one would want them."""
    model = shlex.quote(folder)
    return [
        ("Which light to record next, and what it would improve", f"pixelid design {model} --out {model}_next"),
        ("The same pixel in a simulator", f"pixelid export {model} --to v2e --out {model}_v2e.json"),
        ("How slow it is in low light", f"pixelid lowlight {model} --out {model}_lowlight"),
    ]


def _downloads(folder: Path) -> list[tuple[str, str]]:
    """(name, data URI) of the files that go with the page."""
    links = []
    for name, kind in LINKED.items():
        file = folder / name
        if file.is_file() and not file.is_symlink() and file.stat().st_size <= MOST_LINKED:
            links.append((name, f"data:{kind};base64,{base64.b64encode(file.read_bytes()).decode()}"))
    return links
