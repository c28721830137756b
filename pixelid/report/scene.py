"""The pages of a reconstruction and of the data that it starts from."""

from __future__ import annotations

import math
import shlex
from pathlib import Path
from typing import Any

from pixelid.documents import is_number
from pixelid.figures.words import in_words
from pixelid.nerf.options import LEAST_SHARE
from pixelid.report.format import count, counted, in_its_unit, number, percent, seconds
from pixelid.report.page import Number, Result, Summary, command_line, folder_name, inputs_of
from pixelid.report.scripts import script

PIXEL_UNITS = {
    "alpha": "1/s² per unit of the views", "beta": "1/s", "gamma": "1/s per unit of the views", "follower": "Hz",
    "differencing": "Hz", "on_threshold": "ln units", "off_threshold": "ln units", "refractory_s": "s",
    "dark": "units of the views",
}  # fmt: skip
FLY = "A page to fly through, with depth and events"
CUTOFFS = {"follower": "sf_cutoff_hz", "differencing": "diff_cutoff_hz"}  # rad/s in the JSON


def summarise(result: Result, folder: Path) -> Summary:
    views, own = result["views"], shlex.quote(folder_name(folder))
    return Summary(
        "reconstruct",
        _answer(result),
        result["status"],
        result.get("advice", ""),
        (
            Number("PSNR, mean", _places(views["psnr"], 2), "dB"),
            Number("SSIM, mean", _places(views["ssim"], 3)),
            Number("changes unexplained", percent(result["held_out_residual"]), "rms, held-out pixels"),
            Number("bandwidth", result["bandwidth"]),
            Number("time taken", seconds(result["seconds"]), f"{result['iterations']} steps on {result['device']}"),
        ),
        command_line(
            "reconstruct",
            result,
            "DATASET",
            "--bandwidth",
            result["bandwidth"],
            *(["--gap"] if result.get("gap") else []),
            out=folder,
            inputs=False,
        ),
        next=(
            (
                "Views and depth around the scene",
                f"pixelid render {own} --path orbit --depth --out {own}_views",
            ),
            (FLY, f"pixelid view {own} --out {own}.html"),
        ),
    )


def _answer(result: Result) -> str:
    """How sharp the scene is, and how much of the events it leaves unexplained."""
    psnr, left = result["views"]["psnr"], result["held_out_residual"]
    said = [f"{_places(psnr, 1)} dB on test views"] if psnr is not None else []
    said += [f"{percent(left)} of changes unexplained"] if left is not None else []
    kind = "Scene reconstructed" if result["status"] == "converged" else "Scene not reliable"
    return f"{kind}: {', '.join(said)}" if said else kind


def prepare(result: Result, folder: Path) -> dict[str, Any]:
    def cell(v: Any) -> str:
        if isinstance(v, list):
            return ", ".join(number(x) for x in v)
        return number(v) if is_number(v) else str("–" if v is None else v)

    def cell_with_unit(name: str, v: Any) -> tuple[str, str]:
        unit = PIXEL_UNITS.get(name, "")
        if unit == "s" and is_number(v):
            shown = in_its_unit({"value": v, "interval_95": None, "unit": unit})
            return shown.value, shown.unit
        return cell(v / math.tau if name in CUTOFFS and is_number(v) else v), unit

    def row(name: str, v: dict) -> list[str]:
        measures = [_places(v["psnr"], 2), _places(v["ssim"], 3)]
        return [name, *measures, *([number(v["lpips"], 3)] if lpips else [])]

    lpips = result["views"]["lpips"] is not None
    views = [row(v["name"], v) for v in result["views"]["per_view"]]
    beside = result.get("beside")
    other = f"bandwidth {beside['bandwidth']}, {_places(beside['psnr'], 1)} dB" if beside else ""
    return {
        "slid": (folder / "slider_reference.png").is_file(),
        "scripts": [script("page"), script("figures"), script("slider")],
        "beside": other,
        "views": [row("mean", result["views"]), *views] if views else [],
        "lpips": lpips,
        "pixel": [
            [
                in_words(CUTOFFS.get(name, str(name))),
                *cell_with_unit(name, v),
            ]
            for name, v in result["pixel"].items()
        ],
        "gap": _gap(result["gap"]) if result.get("gap") else None,
    }


def _gap(gap: dict) -> dict[str, Any]:
    """Rows and words of a search for effects."""
    rows = []
    for k, trials in enumerate(gap["rounds"]):
        for trial in trials:
            kept = k < len(gap["effects"]) and gap["effects"][k]["name"] == trial["name"]
            values = ", ".join(f"{name} {number(value)}" for name, value in trial["values"].items())
            share = f"{100 * trial['heldout_gain']:.1f} %"
            rows.append([str(k + 1), trial["name"], share, number(trial["p_value"], 2), "yes" if kept else "", values])
    names = ", ".join(effect["name"] for effect in gap["effects"] if effect["heldout_gain"] is not None)
    hot = "".join(
        f"Left out, for they fire whatever the light does: {number(effect['values']['hot_pixels.count'])} hot pixels, "
        f"{number(effect['values']['hot_pixels.rate_hz'], 3)} events per second beyond their neighbours."
        for effect in gap["effects"]
        if effect["name"] == "hot_pixels"
    )
    psnr = gap.get("coarse_psnr") or {}
    views = (
        f" A validation view of the coarse scenes has {_places(psnr['after'], 1)} dB instead of "
        f"{_places(psnr['before'], 1)}."
        if psnr.get("before") is not None and psnr.get("after") is not None
        else ""
    )
    sentence = (
        f"{names}: of the loss of held-out events under the stated pixel, {100 * gap['heldout_gain']:.0f} % is "
        f"explained with what was found.{views} The final training moves the strengths on."
    )
    return {"rows": rows, "kept": bool(names), "sentence": sentence, "hot": hot, "least": f"{100 * LEAST_SHARE:.0f} %"}


def _places(value: float | None, places: int) -> str:
    """A dash where there are no views, or nothing to show."""
    return "–" if value is None else f"{value:.{places}f}"


def summarise_dataset(result: Result, folder: Path) -> Summary:
    """The card of a converted dataset."""
    events, sensor, own = result["events"], result["sensor"], shlex.quote(folder_name(folder))
    return Summary(
        "dataset",
        f"Dataset ready: {counted(sum(result['views'].values()), 'view')}, {count(events['kept'])} events",
        "",
        "",
        (
            Number("events", count(events["kept"])),
            Number("sensor", f"{sensor['width']} × {sensor['height']}", "pixels"),
            Number("time", seconds(result["duration_s"])),
            Number("views", str(sum(result["views"].values()))),
            Number("poses", str(result["poses"]["kept"])),
        ),
        "",
        headline=f"From {result['layout']}",
        next=(("Reconstruct the scene", f"pixelid reconstruct {own} --out {own}_scene"),),
    )


def prepare_dataset(result: Result, folder: Path) -> dict[str, Any]:
    """Rows of what was kept."""
    rows = [[name.replace("_", " "), str(value)] for name, value in result["events"].items()]
    rows += [[f"views, {stage}", str(value)] for stage, value in result["views"].items()]
    rows += [[name.replace("_", " "), number(result[name])] for name in ("start_s", "duration_s", "time_offset_s")]
    rows += [
        ["one pixel in", str(result["every"])],
        ["longest step of poses (s)", number(result["poses"]["longest_step_s"])],
    ]
    rows += [
        [name.replace("_", " "), str(value) if isinstance(value, bool) else number(value)]
        for name, value in result["pixel"].items()
    ]
    return {"kept": rows}


def summarise_render(result: Result, folder: Path) -> Summary:
    """The card of rendered views."""
    scene = inputs_of({}, folder)
    return Summary(
        "render",
        f"{counted(len(result['frames']), 'frame')} of the scene rendered",
        "",
        "",
        (
            Number("frames", str(len(result["frames"]))),
            Number("size", f"{result['width']} × {result['height']}", "pixels"),
            Number("reconstruction", result["scene_status"]),
            Number("files", str(len(result["files"]))),
            Number("time taken", seconds(result["seconds"])),
        ),
        "",
        headline="Rendered",
        next=((FLY, f"pixelid view {scene} --out scene.html"),) if scene else (),
    )


def prepare_render(result: Result, folder: Path) -> dict[str, Any]:
    """Rows of what was made."""
    return {"files_made": [[name, what] for name, what in result["files"].items()]}
