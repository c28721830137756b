"""Light from pictures: a folder of them, or a video.

Grey levels are scaled by their type, never by what they hold: an 8-bit picture by 255, a 16-bit one by 65535 (or by a
stated `full_scale`), one of floating numbers not at all.  Colours are linear light before their luma (Rec. 709) is
taken; transparent parts show a stated background, black by default.  Level zero, which no light is, counts as half a
step.  Pictures follow each other as people count (2 before 10), at their own times or at stated frames per second, and
the last one is shown as long as the one before.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pixelid.delimited import COMMENTS, cells_of, is_number
from pixelid.documents import read_text
from pixelid.errors import InputError, shown
from pixelid.parallel import memory_bytes
from pixelid.stimuli.light_times import seconds
from pixelid.stimuli.stimulus import INTERPOLATIONS, Stimulus

VIDEOS = (".mp4", ".avi", ".mov", ".mkv", ".webm")
PICTURES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".exr")
DISPLAY_GAMMA = 2.2  # of a display or a camera's pictures; sRGB differs from it by at most 4 % of full scale
GAMMAS, BACKGROUNDS = ("linear", "display"), {"black": 0.0, "white": 1.0}
REC_709 = np.array([0.2126, 0.7152, 0.0722])
STAMPS = re.compile(r".*(time|stamp).*\.(txt|csv)|images\.(txt|csv)", re.I)
TIME_UNITS = ("s", "ms", "us", "ns")
FEWER_BITS = (10, 12, 14)  # of cameras whose levels are stored in 16


@dataclass(frozen=True)
class FrameOptions:
    """How frames become light.

    Attributes:
        fps: frames per second, over the file's own times.
        gamma: "linear" where grey levels are proportional to light, "display" where they go as light^(1/2.2); None:
            linear, said in a line.
        interpolation: "previous" holds each frame until the next, "linear" runs between them.
        full_scale: level of full light; None: by the type of the pictures.
        background: what transparent parts show, "black" or "white".
        time_unit: of the times in a file, "s", "ms", "us" or "ns"; None: as the file states, else inferred.
    """

    fps: float | None = None
    gamma: str | None = None
    interpolation: str = "previous"
    full_scale: float | None = None
    background: str = "black"
    time_unit: str | None = None

    def __post_init__(self) -> None:
        choices: tuple[tuple[str, object, Iterable[object]], ...] = (
            ("gamma", self.gamma, (None, *GAMMAS)),
            ("interpolation", self.interpolation, INTERPOLATIONS),
            ("background", self.background, BACKGROUNDS),
            ("time_unit", self.time_unit, (None, *TIME_UNITS)),
        )
        for name, value, known in choices:
            if value not in known:
                expected = " or ".join(str(one) for one in known if one is not None)
                raise InputError(f"{name}: expected {expected}, found {shown(value)}")
        if self.full_scale is not None and not 0 < self.full_scale < 1e12:
            raise InputError(f"full_scale: expected a positive number, found {shown(self.full_scale)}")


def holds_pictures(path: Path) -> bool:
    """Whether a folder holds pictures."""
    return any(file.suffix.lower() in PICTURES for file in path.iterdir())


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sorts names as people count: frame_2 before frame_10."""
    parts = re.findall(r"\d+|\D+", name.lower())
    return tuple((0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts)


def read_frames(path: Path, unit: str, options: FrameOptions, say: Callable[[str], object]) -> Stimulus:
    """The light of a folder of pictures or of a video.

    Args:
        path: the folder or file.
        unit: of the light.
        options: as stated.
        say: called with what is inferred, in a line.

    Raises:
        InputError: pictures that cannot be read or differ in size, times that are missing.
    """
    notes: list[str] = [] if options.gamma else ['grey levels taken as proportional to light (else: gamma = "display")']
    levels, t, step = (_folder if path.is_dir() else _video)(path, options, notes)
    if options.gamma == "display":
        step = step**DISPLAY_GAMMA
    zero = min(0.5 * step, float(levels[levels > 0].min(initial=step)))
    levels = np.maximum(levels, np.float32(zero))
    if options.interpolation == "previous":  # the last frame is shown, too
        t, levels = np.append(t, 2 * t[-1] - t[-2]), np.concatenate([levels, levels[-1:]])
    for note in notes:
        say(f"{path.name}: {note}")
    return Stimulus.from_arrays(t, levels, unit, options.interpolation, where=str(path))


def _folder(path: Path, options: FrameOptions, notes: list[str]) -> tuple[np.ndarray, np.ndarray, float]:
    """Levels (n, h, w), times and the step of a level, of a folder's pictures."""
    from pixelid.recordings.pictures import read_picture

    files = sorted((f for f in path.iterdir() if f.suffix.lower() in PICTURES and f.is_file()), key=_order)
    if len(files) < 2:
        raise InputError(
            f"{path}: expected a folder of pictures ({', '.join(PICTURES)}), one a file, found {len(files)}; convert "
            "others to these"
        )
    if files != sorted(files):
        notes.append(f"pictures in the order of their numbers: {files[0].name}, {files[1].name}, …")
    stamps = sorted(file for file in path.iterdir() if STAMPS.fullmatch(file.name) and file.is_file())
    if not stamps or options.fps is not None:
        t = _regular(len(files), options.fps, path)
    elif len(stamps) > 1:
        found = ", ".join(file.name for file in stamps)
        raise InputError(f"{path}: expected one file of times, found {found}; remove others, or state fps")
    else:
        t = _times(stamps[0], files, options, notes)
    steps: set[float] = set()

    def levels() -> Iterator[np.ndarray]:
        for file in files:
            level, step = _level(read_picture(file), options, file, notes)
            steps.add(step)
            if len(steps) > 1:
                raise InputError(f"{file}: expected pictures of one type, found others before; convert them to one")
            yield level

    stacked = _stacked(levels(), len(files), path)
    step = steps.pop()
    notes += _fewer_bits(float(stacked.max()), step)
    return stacked, t, step


def _fewer_bits(most: float, step: float) -> list[str]:
    """A line where 16-bit pictures hold no level that 10, 12 or 14 bits could not."""
    bits = next((bits for bits in FEWER_BITS if round(most / step) < 1 << bits), 16)
    if step != 1 / 65535 or bits == 16:
        return []
    return [f"no level above {(1 << bits) - 1} of 65535: if these are {bits} bits, full_scale = {(1 << bits) - 1}.0"]


def _order(file: Path) -> tuple:
    return natural_key(file.name)


def _times(stamps: Path, files: list[Path], options: FrameOptions, notes: list[str]) -> np.ndarray:
    """(n,) seconds of pictures, one a line, alone or with the picture's name or number."""
    lines = [line.strip() for line in read_text(stamps, "CSV").splitlines() if line.strip()]
    rows = [cells_of(line)[0] for line in lines if not line.startswith(COMMENTS)]
    names = rows.pop(0) if rows and not any(is_number(cell) for cell in rows[0]) else []
    if len(rows) != len(files) or len({len(row) for row in rows}) != 1 or len(rows[0]) not in (1, 2):
        found = f"{len(rows)} lines"
        raise InputError(f"{stamps}: expected {len(files)} times, one a line for each picture, found {found}")
    time = 0
    for k in range(len(rows[0]) if len(rows[0]) == 2 else 0):
        place = {Path(row[k]).name: row for row in rows}
        if set(place) == {file.name for file in files}:
            rows, time = [place[file.name] for file in files], 1 - k
            break
        if [row[k] for row in rows] in ([str(i) for i in range(len(rows))], [str(i + 1) for i in range(len(rows))]):
            time = 1 - k
            break
    else:
        if len(rows[0]) == 2:
            raise InputError(f"{stamps}: expected a time a line, or a picture's name and its time, found two columns")
    try:
        numbers = np.array([float(row[time]) for row in rows])
    except ValueError as error:
        raise InputError(f"{stamps}: expected one time a line: {str(error)[:100]}") from None
    comments = " ".join(line for line in lines if line.startswith(COMMENTS))
    name = names[time] if len(names) == len(rows[0]) else "t"
    return seconds(numbers, name, comments, options.time_unit, notes.append, stamps, "the stimulus' .toml")


def _video(path: Path, options: FrameOptions, notes: list[str]) -> tuple[np.ndarray, np.ndarray, float]:
    from pixelid.recordings.pictures import read_video

    times: list[float] = []
    top = [255.0]

    def levels() -> Iterator[np.ndarray]:
        for time_s, picture in read_video(path):
            times.append(time_s)
            top[0] = float(np.iinfo(picture.dtype).max)
            yield _level(picture, options, path, notes)[0]

    stacked = _stacked(levels(), 0, path)
    t = np.array(times)
    if options.fps is not None or not np.isfinite(t).all():
        t = _regular(len(stacked), options.fps, path)
    return stacked, t - t[0], 1 / (options.full_scale or top[0])


def _level(picture: np.ndarray, options: FrameOptions, path: Path, notes: list[str]) -> tuple[np.ndarray, float]:
    """(h, w) float32 light of a picture, full scale 1; and the step of a level, before any gamma."""
    if picture.dtype.kind == "b":  # of one bit
        picture = picture.astype(np.uint8) * np.uint8(255)
    if picture.ndim == 2:
        picture = picture[..., None]
    if picture.ndim != 3 or picture.shape[2] > 4:
        raise InputError(f"{path}: expected a grey, RGB or RGBA picture, found shape {picture.shape}")
    scale = options.full_scale or _full_scale(picture, path)
    values = picture.astype(np.float64) / scale
    alpha = values[..., -1:] * (scale / _alpha_scale(picture)) if picture.shape[2] in (2, 4) else None
    values = values[..., :-1] if alpha is not None else values
    if picture.dtype.kind == "f" and not (np.isfinite(values).all() and values.min(initial=0.0) >= 0):
        raise InputError(f"{path}: expected light of at least 0, found negative or non-finite values")
    if options.gamma == "display":
        values = values**DISPLAY_GAMMA
    if alpha is not None and (alpha < 1).any():
        note = f'transparent parts show {options.background} (background = "white" or "black")'
        notes += [] if note in notes else [note]
        values = alpha * values + (1 - alpha) * BACKGROUNDS[options.background]
    grey = values @ REC_709 if values.shape[2] == 3 else values[..., 0]
    float_step = 1 / 65535  # of pictures of floating numbers, where they hold zero
    return grey.astype(np.float32), float_step if picture.dtype.kind == "f" else 1 / scale


def _full_scale(picture: np.ndarray, path: Path) -> float:
    """The level of full light, by the type of the picture.

    Raises:
        InputError: floating numbers beyond 1 in a format that has no agreement about them.
    """
    if picture.dtype.kind in "iu":
        return float(np.iinfo(picture.dtype).max)
    if picture.dtype.kind == "f" and path.suffix.lower() != ".exr" and picture.max(initial=0.0) > 1:
        raise InputError(
            f"{path}: floating grey levels up to {picture.max():g}: state which is full light, full_scale = 1.0 or more"
        )
    return 1.0


def _alpha_scale(picture: np.ndarray) -> float:
    return float(np.iinfo(picture.dtype).max) if picture.dtype.kind in "iu" else 1.0


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
