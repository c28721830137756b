"""The pages of tables: event rates, and phases under mains light."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pixelid.report.format import number, percent, seconds
from pixelid.report.page import Number, Result, Summary, command_line, identified


def summarise_rates(result: Result, folder: Path) -> Summary:
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
            identified(result),
            Number("log-likelihood", number(result["log_likelihood"]), "nats"),
        ),
        command_line("rates", result, out=folder),
    )


def summarise_flicker(result: Result, folder: Path) -> Summary:
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


def prepare_flicker(result: Result, folder: Path) -> dict[str, Any]:
    def cell(entry: dict) -> str:
        return f"{entry['value']:.3g}" + (f" ± {entry['std']:.2g}" if entry["std"] is not None else " (open)")

    names = ("amplitude_over_on_threshold", "off_over_on_threshold", "phase_cycles", "noise_over_on_threshold")
    return {
        "groups": [
            [f"{g['column']}, {g['row']}", str(g["events"]), *(cell(g[n]) for n in names), f"{g['dispersion']:.2f}"]
            for g in sorted(result["groups"], key=lambda g: -g["events"])
        ]
    }
