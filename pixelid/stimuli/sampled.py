"""Light that was measured or displayed: a photodiode's table, arrays, a video, or a folder of frames.

A table has a header that names its columns, with the unit of each in the name, in brackets, or in a comment line:

    t_s,radiance_lux          time [ms];irradiance [W/m²]          # unit: fA

Times count from the clock of whatever measured the light; `pixelid convert --align` brings it onto the camera's.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import numpy as np

from pixelid.arrays import load_arrays
from pixelid.documents import refuse_hollow, separator_of, words_of
from pixelid.errors import InputError, first_line, shown
from pixelid.parallel import memory_bytes
from pixelid.stimuli.stimulus import Stimulus, unit_named

TABLES, ARRAYS = (".csv", ".txt", ".tsv"), (".npy", ".npz")
VIDEOS, PICTURES = (".mp4", ".avi", ".mov", ".mkv", ".webm"), (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")
LIGHT_WORDS = (
    "radiance",
    "irradiance",
    "illuminance",
    "light",
    "photodiode",
    "luminance",
    "intensity",
    "voltage",
    "lux",
)
# Words in the name of a column of times that are no unit.
BESIDE_TIME = (
    "time", "t", "stamp", "timestamp", "since", "start", "of", "the", "in", "from", "elapsed", "relative", "rel", "abs",
    "absolute", "0", "zero", "clock", "axis", "unit", "units", "camera", "sensor", "light", "photodiode", "led",
    "trigger",
)  # fmt: skip
TIME_IN = re.compile(r"(?:^|[#;,.:])\s*times?\W+(?:is |are )?in\W+([^\W\d_]+)", re.I)  # of a comment
TIME_WORDS = ("t", "time", "timestamp", "seconds")
SECONDS_PER = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0), **dict.fromkeys(("min", "minutes"), 60.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "usec", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanosecond", "nanoseconds"), 1e-9),
}  # fmt: skip
UNIT_WORDS = {
    "relative": "relative", "lux": "lux", "lx": "lux", "fa": "fA", "shape": "shape",
    "w/m2": "W/m2", "w/m²": "W/m2", "w/m^2": "W/m2", "w_m2": "W/m2", "wm2": "W/m2",
}  # fmt: skip
DISPLAY_GAMMA = 2.2  # of a display or a camera's pictures; sRGB differs from it by at most 4 % of full scale
MOST_ROWS, MOST_BYTES = 50_000_000, 2 << 30  # of a table
HEAD_BYTES = 1 << 16  # in which a table's header lies


def is_light_table(path: Path) -> bool:
    """Whether a text file holds light over time, not events: by the names of its columns."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    lines = head.decode("utf-8-sig", "replace").splitlines()[:40]
    names = _names(next((line for line in lines if line.strip() and not line.lstrip().startswith("#")), ""))
    words = [re.split(r"[^a-zµ]+", name) for name in names]
    return len(names) >= 2 and any(word in LIGHT_WORDS for name in words for word in name)


def holds_pictures(path: Path) -> bool:
    """Whether a folder holds pictures."""
    return any(file.suffix.lower() in PICTURES for file in path.iterdir())


def read_light(path: Path, *, unit: str | None = None, fps: float | None = None, gamma: str = "linear") -> Stimulus:
    """The light in a file, or in a folder of frames.

    Args:
        path: table (.csv, .txt, .tsv), array (.npy of rows t, radiance; .npz with t and radiance), video, or a folder
            of pictures in the order of their names, their times (s, one a line) in `timestamps.txt`, or at `fps`.
        unit: of the radiance, where the file does not say.
        fps: frames per second, for videos and folders.
        gamma: "linear" when grey levels are proportional to light, "display" when they go as light to the power 1/2.2.

    Returns:
        A full-field stimulus; of shape (n, height, width) for frames.

    Raises:
        InputError: one line that names file, field, expected and found.
    """
    unit = None if unit is None else unit_named(unit, where="unit of the light")
    if gamma not in ("linear", "display"):
        raise InputError(f"gamma: expected linear or display, found {gamma!r}")
    suffix = path.suffix.lower()
    if not path.is_dir() and not path.is_file():
        raise InputError(f"{path}: expected a file or a folder of frames, found {_kind_of(path)}")
    if path.is_dir() or suffix in VIDEOS:
        frames, t = _folder(path, fps) if path.is_dir() else _video(path, fps)
        return _of_frames(frames, t, unit or "relative", gamma, path)
    if suffix in ARRAYS:
        return _array(path, unit)
    return _table(path, unit)


def _kind_of(path: Path) -> str:
    return "a device, pipe or socket" if path.exists() else "nothing of that name"


def _table(path: Path, unit: str | None) -> Stimulus:
    refuse_hollow(path)
    if path.stat().st_size > MOST_BYTES:
        raise InputError(f"{path}: expected at most {MOST_BYTES >> 30} GiB, found {path.stat().st_size} bytes")
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = list(islice(file, MOST_ROWS))
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected text, found binary data") from error
    comments = " ".join(line for line in lines[:40] if line.lstrip().startswith("#"))
    lines = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if len(lines) < 3:
        raise InputError(f"{path}: expected a header t,radiance and at least two rows, found {len(lines)} lines")
    names = _names(lines[0])
    separator = separator_of(lines[0])
    time = next((k for k, name in enumerate(names) if words_of(name)[:1] and words_of(name)[0] in TIME_WORDS), None)
    light = next(
        (k for k, name in enumerate(names) if k != time and any(w in LIGHT_WORDS for w in words_of(name))), None
    )
    if time is None or light is None:
        raise InputError(
            f"{path}: expected columns t and radiance in the first line, found {shown(lines[0].strip(), 80)}"
        )
    try:
        columns = np.loadtxt(lines[1:], delimiter=separator, usecols=(time, light), ndmin=2)
    except (ValueError, IndexError) as error:
        raise InputError(f"{path}: expected numbers in every row: {first_line(error)}") from None
    scale = _seconds_per(names[time], comments, path)
    told = _unit_in(names[light]) or _unit_in(" ".join(re.findall(r"unit\s*[:=]\s*(\S+)", comments, re.I)))
    return _stimulus(columns[:, 0] * scale, columns[:, 1], unit or told or "relative", path)


def _seconds_per(name: str, comments: str, path: Path) -> float:
    """Of the unit in the name of the column of times, or in a comment ("time in ms"); seconds where none is said."""
    words = words_of(name)
    said = [word for found in TIME_IN.findall(comments) for word in words_of(found)]
    told = [SECONDS_PER[word] for word in (*words[1:], *words[:1], *said) if word in SECONDS_PER]
    unknown = [word for word in words[1:] if word not in SECONDS_PER and word not in BESIDE_TIME]
    if not told and unknown:
        raise InputError(f"{path}: unit of the times: expected s, ms, us, ns or min, found {shown(unknown[0], 30)}")
    return told[0] if told else 1.0


def _names(line: str) -> list[str]:
    try:
        row = next(csv.reader([line.strip()], delimiter=separator_of(line) or " ", skipinitialspace=True), [])
    except csv.Error:  # a cell of more than 128 KiB
        return []
    return [name.strip().lower() for name in row]


def _unit_in(text: str) -> str | None:
    text = text.lower()
    for word, unit in UNIT_WORDS.items():
        if re.search(rf"(^|[^a-z]){re.escape(word)}($|[^a-z0-9²])", text):
            return unit
    return None


def _array(path: Path, unit: str | None) -> Stimulus:
    arrays = load_arrays(path)
    if "" in arrays:
        content = arrays[""]
        if content.ndim != 2 or 2 not in content.shape or content.dtype.kind not in "fiu":
            raise InputError(f"{path}: expected rows of t, radiance, found {content.dtype} of shape {content.shape}")
        t, radiance = content.T if content.shape[1] == 2 else content
        return _stimulus(t, radiance, unit or "relative", path)
    missing = [name for name in ("t", "radiance") if name not in arrays]
    if missing:
        raise InputError(f"{path}: {missing[0]}: missing; expected t and radiance, found {shown(list(arrays), 200)}")
    for name in ("t", "radiance"):
        if arrays[name].dtype.kind not in "fiu":
            raise InputError(f"{path}: {name}: expected numbers, found {arrays[name].dtype}")
    told = str(arrays["unit"]) if "unit" in arrays else None
    between = str(arrays["interpolation"]) if "interpolation" in arrays else "linear"
    return _stimulus(arrays["t"], arrays["radiance"], unit or told or "relative", path, between)


def _stimulus(t: np.ndarray, radiance: np.ndarray, unit: str, path: Path, between: str = "linear") -> Stimulus:
    """A stimulus, where a trace that reaches zero or below says what may be done about it."""
    radiance = np.asarray(radiance)
    if unit != "shape" and radiance.dtype.kind in "fiu" and np.isfinite(radiance).any() and np.nanmin(radiance) <= 0:
        raise InputError(
            f"{path}/radiance: must be positive, found {np.nanmin(radiance):g}; take the detector's offset off, "
            "or say unit shape for a trace known up to offset and gain"
        )
    return Stimulus.from_arrays(t, radiance, unit, between, where=str(path))


def _folder(path: Path, fps: float | None) -> tuple[np.ndarray, np.ndarray]:
    from pixelid.recordings.pictures import read_picture

    files = sorted(file for file in path.iterdir() if file.suffix.lower() in PICTURES and file.is_file())
    if len(files) < 2:
        raise InputError(f"{path}: expected a folder of pictures ({', '.join(PICTURES)}), found {len(files)}")
    stamps = path / "timestamps.txt"
    if stamps.is_file():
        try:
            t = np.loadtxt(stamps, ndmin=1)
        except ValueError as error:
            raise InputError(f"{stamps}: expected one time in seconds a line: {str(error)[:100]}") from None
        if t.shape != (len(files),):
            raise InputError(f"{stamps}: expected {len(files)} times, one for each picture, found {t.shape}")
    else:
        t = _regular(len(files), fps, path)
    return _stacked((_grey(read_picture(file), file) for file in files), len(files), path), t


def _video(path: Path, fps: float | None) -> tuple[np.ndarray, np.ndarray]:
    from pixelid.recordings.pictures import read_video

    rate, pictures = read_video(path)
    frames = _stacked((picture.astype(np.float32) / np.float32(255.0) for picture in pictures), 0, path)
    return frames, _regular(len(frames), fps or rate or None, path)


def _stacked(frames: Iterable[np.ndarray], expected: int, path: Path) -> np.ndarray:
    """(n, h, w) of grey frames of one size, as far as they fit into half of the memory.

    Args:
        frames: (h, w) each.
        expected: how many there are; 0: not known.
        path: named in errors.
    """
    found: list[np.ndarray] = []
    most = memory_bytes() // 2
    for frame in frames:
        if found and frame.shape != found[0].shape:
            raise InputError(f"{path}: expected pictures of one size, found {found[0].shape} and {frame.shape}")
        found.append(frame)
        if 2 * frame.nbytes * max(len(found), expected) > most:  # the frames, and the array that they are copied into
            raise InputError(
                f"{path}: expected frames that fit into memory, found {max(len(found), expected)} or more of "
                f"{frame.shape[1]} × {frame.shape[0]} pixels; take fewer or smaller ones"
            )
    if len(found) < 2:
        raise InputError(f"{path}: expected at least two frames, found {len(found)}")
    return np.stack(found)


def _regular(n: int, fps: float | None, path: Path) -> np.ndarray:
    if fps is None or not 0 < fps < 1e9:
        raise InputError(f"{path}: fps: expected the frames per second, a positive number, found {fps}")
    return np.arange(n) / fps


def _grey(picture: np.ndarray, path: Path) -> np.ndarray:
    """(h, w) float32 grey levels, full scale 1; of colours their luma (Rec. 709)."""
    if picture.ndim == 3:
        picture = picture[..., :3] @ np.array([0.2126, 0.7152, 0.0722]) if picture.shape[2] >= 3 else picture[..., 0]
        scale = 65535.0 if picture.max(initial=0) > 255 else 255.0
    elif picture.ndim == 2:
        scale = float(np.iinfo(picture.dtype).max) if picture.dtype.kind in "iu" else 1.0
    else:
        raise InputError(f"{path}: expected a picture of two or three dimensions, found {picture.ndim}")
    return (picture / scale).astype(np.float32)


def _of_frames(frames: np.ndarray, t: np.ndarray, unit: str, gamma: str, path: Path) -> Stimulus:
    """Frames are held until the next: what a display shows, and all that a camera's pictures say.

    Grey level zero, which no light is, counts as half a step of an 8-bit display.
    """
    if gamma == "display":
        frames = frames**DISPLAY_GAMMA
        least = (0.5 / 255.0) ** DISPLAY_GAMMA
    else:
        least = 0.5 / 255.0
    return Stimulus.from_arrays(t, np.maximum(frames, np.float32(least)), unit, "previous", where=str(path))
