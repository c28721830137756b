"""A published sequence → a dataset folder that reconstructions read, in bounded memory."""

from __future__ import annotations

import shutil
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from pixelid.errors import InputError
from pixelid.nerf.data import calibration as layout
from pixelid.nerf.data.camera import Camera
from pixelid.nerf.data.dataset import EVENTS, POSES
from pixelid.nerf.data.published import eds, esim, tumvie
from pixelid.nerf.data.published.posed_views import copy_views, write_pictures
from pixelid.nerf.data.published.source import Block, Source
from pixelid.nerf.data.published.window import Window, window_of
from pixelid.nerf.data.views import CONVERTED, RENDERER
from pixelid.nerf.options import DatasetOptions
from pixelid.provenance import provenance
from pixelid.results import Table, WrittenResult
from pixelid.status import Status

LAYOUTS = {"esim": esim.read, "eds": eds.read, "tumvie": tumvie.read}
BINS = 200  # of the rate over time
THRESHOLDS = ("pos_contrast_threshold", "neg_contrast_threshold")


@dataclass(frozen=True, repr=False)
class Conversion(WrittenResult):
    """What was kept of a published sequence.

    content: of dataset.json;  counts: (height, width) events of every pixel;  rate: (bins,) events/s over the part kept
    """

    FILE: ClassVar[str] = CONVERTED

    counts: np.ndarray
    rate: np.ndarray

    @property
    def headline(self) -> str:
        """How much was kept."""
        c = self.content
        return (
            f"dataset: {c['events']['kept']} events of {c['sensor']['width']} × {c['sensor']['height']} pixels in "
            f"{c['duration_s']:.3f} s, {sum(c['views'].values())} views"
        )

    def tables(self) -> list[Table]:
        """Events kept and left out."""
        rows = tuple((name.replace("_", " "), str(value)) for name, value in self.content["events"].items())
        return [Table("", ("events", "number"), rows, frozenset({"events"}))]

    def records(self) -> list[dict[str, Any]]:
        """One row per kind of event."""
        return [{"events": name, "number": value} for name, value in self.content["events"].items()]

    def write_companions(self, folder: Path) -> None:
        """Draw where and when events are; the data are there."""
        from pixelid.nerf.data.published.figures import write_figures

        write_figures(self, folder)


def convert(
    path: Path,
    kind: str,
    folder: Path,
    asked: DatasetOptions,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Conversion:
    """Write a dataset of a published sequence.

    Args:
        path: of the sequence.
        kind: its layout: "esim", "eds" or "tumvie".
        folder: an empty one, which is filled.
        asked: what is kept, and stated.
        progress: called with what is done and the fraction.

    Returns:
        What was kept.

    Raises:
        InputError: naming file and field that are missing or wrong.
    """
    watch = time.perf_counter()
    thresholds = asked.on_threshold, asked.off_threshold
    source = LAYOUTS[kind](path, asked.camera)
    window = window_of(source.poses, asked.start, asked.end)
    kept = _pixels(source.camera, asked.every, asked.seed)
    progress("views", 0.0)
    # first: what is wrong with them is said before all events are read
    number = _views(folder, source, window, asked.views)
    counts, rate, events = _write_events(folder, source, window, kept, round(asked.time_offset * 1e9), progress)
    np.savez(
        folder / POSES, T_wc_position=window.poses.position, T_wc_orientation=window.poses.orientation,
        T_wc_timestamp=window.poses.t - window.begin,
    )  # fmt: skip
    pixel = _pixel(source, thresholds, asked.dead_time)
    which: dict[str, Any] = {} if kept is None else {layout.KEPT: kept}
    np.savez(folder / layout.FILE, **_geometry(source.camera), **pixel, **which)
    if source.renderer is not None:
        np.savez(folder / RENDERER, **source.renderer)
    known = set(layout.CIRCUIT) <= set(pixel)
    content = {
        "status": Status.converged,
        "advice": "",
        "layout": source.layout,
        "events": events,
        "duration_s": (window.end - window.begin) * 1e-9,
        "start_s": (window.begin - int(source.poses.t[0])) * 1e-9,
        "every": asked.every,
        "time_offset_s": asked.time_offset,
        "poses": {"kept": len(window.poses.t), "longest_step_s": float(np.diff(window.poses.t).max()) * 1e-9},
        "views": number,
        "sensor": {
            "width": source.camera.width, "height": source.camera.height,
            "distortion": source.camera.model if len(source.camera.distortion) else "none",
        },
        "pixel": {
            "circuit": known, "on_threshold": float(pixel[THRESHOLDS[0]]), "off_threshold": float(pixel[THRESHOLDS[1]]),
            "refractory_s": float(pixel["refractory_period"]) * 1e-9,
        },
        "notes": [*window.notes, *_notes(source, thresholds, known, number)],
        "seconds": time.perf_counter() - watch,
        "seed": asked.seed,
        **provenance(*source.files),
    }  # fmt: skip
    return Conversion(content, counts, rate)


def _pixels(camera: Camera, every: int, seed: int) -> np.ndarray | None:
    """(height, width) whether a pixel is kept, spread at random: a regular grid would see one colour of a mosaic."""
    if every == 1:
        return None
    pixels = camera.width * camera.height
    kept = np.zeros(pixels, bool)
    kept[np.random.default_rng([seed, every]).permutation(pixels)[: -(-pixels // every)]] = True
    return kept.reshape(camera.height, camera.width)


def _write_events(folder: Path, source: Source, window: Window, kept: np.ndarray | None, offset: int, progress):
    """(counts, rate, {"kept", "other_pixels", "outside"}) of what went into raw_events.npz."""
    height, width = source.camera.height, source.camera.width
    counts, histogram = np.zeros(height * width, np.int64), np.zeros(BINS)
    other = outside = 0
    first, last, span = None, None, window.end - window.begin
    with event_file(folder / EVENTS) as file:
        for block in source.events(window.begin - offset, window.end - offset):
            _check(block, width, height, source.files[0])
            t = block.t + offset
            first, last = int(t.min()) if first is None else first, int(t.max())
            inside = (t >= window.begin) & (t <= window.end)
            outside += len(t) - int(inside.sum())
            if kept is not None:
                chosen = inside & kept[block.y, block.x]
                other += int(inside.sum() - chosen.sum())
                inside = chosen
            t, x, y, on = t[inside] - window.begin, block.x[inside], block.y[inside], block.on[inside]
            file.add(t, x, y, on)
            counts += np.bincount(y.astype(np.int64) * width + x, minlength=height * width)
            histogram += np.bincount((t * BINS // (span + 1)), minlength=BINS)
            progress("events", 0.1 + 0.8 * min(max((last - window.begin) / span, 0.0), 1.0))
        if file.events == 0:
            if other:
                raise InputError(f"--every: none of the {other} events is of a pixel that is kept")
            found = "none" if first is None else f"{first} … {last} ns"
            raise InputError(
                f"{source.files[0]}: no event while there are poses, {window.begin} … {window.end} ns; found {found} "
                "(--time-offset moves the events)"
            )
        number = file.events
    progress("events", 1.0)
    rate = histogram / (span * 1e-9 / BINS)
    return counts.reshape(height, width), rate, {"kept": number, "of_other_pixels": other, "read_outside": outside}


def _check(block: Block, width: int, height: int, file: Path) -> None:
    for name, values, most in (("x", block.x, width), ("y", block.y, height)):
        if values.dtype.kind not in "iu":
            raise InputError(f"{file}: events/{name}: expected whole numbers, found {values.dtype}")
        least, greatest = (int(values.min()), int(values.max())) if len(values) else (0, 0)
        if least < 0 or greatest >= most:
            found = least if least < 0 else greatest
            raise InputError(f"{file}: events/{name}: expected 0 … {most - 1} as the calibration says, found {found}")


def _geometry(camera: Camera) -> dict[str, Any]:
    return {
        "intrinsics": camera.intrinsics, "distortion_params": camera.distortion, "distortion_model": camera.model,
        "img_height": camera.height, "img_width": camera.width,
    }  # fmt: skip


def _pixel(source: Source, thresholds: tuple[float | None, float | None], dead_time: float | None) -> dict[str, Any]:
    pixel = {"bayer_pattern": "", "refractory_period": 0.0, **source.pixel}
    for name, value in zip(THRESHOLDS, thresholds, strict=True):
        if value is not None:
            pixel[name] = value
    if dead_time is not None:
        pixel["refractory_period"] = dead_time * 1e9
    return pixel


def _views(folder: Path, source: Source, window: Window, most: int) -> dict[str, int]:
    """Stage → how many views."""
    if most == 0:
        return {}
    if source.views is not None:
        return copy_views(source.views, folder)
    if source.pictures is None:
        return {}
    return write_pictures(folder, source.pictures, window, most)


def _notes(source: Source, thresholds, known: bool, views: Mapping[str, int]) -> list[str]:
    given = None not in thresholds
    notes = [note for note in source.notes if not (given and note.startswith("thresholds"))]
    if not known:
        notes.append("pixelid reconstruct needs --fit with the pixel of this camera, or --bandwidth off")
    if views and source.views is None and source.pictures is not None:
        notes += source.pictures.notes
    if not views:
        notes.append("no views: the reconstruction has no scores")
    return notes


COLUMNS = {"position": np.dtype("<u2"), "timestamp": np.dtype("<i8"), "polarity": np.dtype("?")}
COPY = 1 << 20  # bytes


class EventFile:
    """The columns, each in a file of its own until their length is known."""

    def __init__(self, files: dict) -> None:
        self._files = files
        self.events = 0

    def add(self, t: np.ndarray, x: np.ndarray, y: np.ndarray, on: np.ndarray) -> None:
        """Events (n,) after those before; t: ns."""
        position = np.column_stack([x, y])
        for name, values in (("position", position), ("timestamp", t), ("polarity", on)):
            self._files[name].write(np.ascontiguousarray(values, COLUMNS[name]).data)
        self.events += len(t)


@contextmanager
def event_file(path: Path) -> Iterator[EventFile]:
    """Yield what takes the events of an npz file, which is there at the end; nothing is when an error stops it."""
    parts = {name: path.with_name(f".{name}.part") for name in COLUMNS}
    try:
        with ExitStack() as stack:
            writer = EventFile({name: stack.enter_context(part.open("wb")) for name, part in parts.items()})
            yield writer
        with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
            for name, part in parts.items():
                shape = (writer.events, 2) if name == "position" else (writer.events,)
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member, part.open("rb") as column:
                    header = {"descr": COLUMNS[name].str, "fortran_order": False, "shape": shape}
                    np.lib.format.write_array_header_1_0(member, header)
                    shutil.copyfileobj(column, member, COPY)
                part.unlink()
    finally:
        for part in parts.values():
            part.unlink(missing_ok=True)
