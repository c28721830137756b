"""The page of a reconstruction."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pixelid.report.format import number, seconds
from pixelid.report.page import Number, Result, Summary, command_line


def summarise(result: Result, folder: Path) -> Summary:
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


def prepare(result: Result, folder: Path) -> dict[str, Any]:
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
