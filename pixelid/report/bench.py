"""The page of a calibration."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from pixelid.figures import words
from pixelid.report.circuit import STATUS_LINES, circuit_alone, circuit_parts, next_recording, uses_of
from pixelid.report.format import count, counted, number, percent, seconds
from pixelid.report.methods import methods
from pixelid.report.page import Number, Result, Summary, command_line, folder_name, identified
from pixelid.report.quantities import quantities

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
            identified(circuit_alone(result)),
            Number("recordings used", f"{used} of {len(result['recordings'])}"),
            Number("events", count(result["events"]), f"of {counted(result['pixels'], 'pixel')}"),
            _unexplained(result),
            Number("time taken", seconds(result.get("seconds"))),
        ),
        command_line("calibrate", result, out=folder),
        line,
        next=uses_of(shlex.quote(folder_name(folder))),
    )


def prepare(result: Result, folder: Path) -> dict[str, Any]:
    """What the template shows in addition to the JSON."""
    shown = quantities(result["parameters"])
    added = list(dict.fromkeys(q.effect for q in shown if q.effect and q.parameter not in result["start"]))
    estimated = [q for q in shown if not q.fixed]
    return circuit_parts(result["parameters"], result["start"], folder, result["base"], added) | {
        "statements": _by_kind(result["bench"]),
        "recordings": [_recording(k, row, result["bench"]) for k, row in enumerate(result["recordings"])],
        "refitted": bool(result["effects"] or result["described"]),
        "next_sentence": next_recording(result["recommended_next"], words.light_unit(result["parameters"])),
        "methods": methods(result, estimated, [name.replace("_", " ") for name in added]),
    }


def _unexplained(result: Result) -> Number:
    held_out = result["held_out"]
    if held_out:
        return Number("events unexplained", percent(held_out["background_fraction"]), "on pixels held out")
    return Number("log-likelihood", number(result["log_likelihood"], 6), "nats")


def _by_kind(bench: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Contradicted statements of one kind together: sentences that are shown, the others, and what to do about all."""
    kinds = dict.fromkeys(s["statement"] for s in bench)
    sentences = {kind: [s["sentence"] for s in bench if s["statement"] == kind] for kind in kinds}
    shown_of_a_kind = 3  # of contradicted statements: more of a kind have one cause, which the first show
    return [
        {"shown": own[:shown_of_a_kind], "more": own[shown_of_a_kind:], "todo": WHAT_TO_DO.get(kind, "")}
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
