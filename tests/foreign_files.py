"""Foreign files of every format, as programs write them, with what is true of their events.

A `Spec` says how a file is written and what it leaves out; `write` makes it.  Whoever reads it must find the truth or
be refused with the option that states what is missing (`judged`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from scipy.io import savemat

from pixelid.errors import InputError, on_command_line
from pixelid.recordings import Recording, open_recording
from pixelid.recordings.source import Source

NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
WAYS = ("--time-unit", "--size", "--columns", "--polarity", "--clock", "--stream", "--chip")
FORMATS = ("text", "npz", "npz_records", "npz_rows", "h5_group", "h5_rows", "h5_records", "h5_root", "mat")


@dataclass(frozen=True)
class Spec:
    """How a file is written.

    Attributes:
        format: of `FORMATS`.
        order: of the columns, where they have one.
        named, unit_named, size_stated: whether names of columns, the unit and the size are in the file.
        unit: of the times.
        floats: "none", "t" or "all": which columns are written as floating numbers.
        polarity: "01", "pm1", "bool", "three" (−1, 0 and 1), "words" (ON and OFF, of text).
        unit_comment: whether a comment or an attribute states the unit.
        size_as: "sides" (width and height) or "pair" (a resolution), where it is stated.
        from_one: whether addresses count from one.
        across: whether rows of an array are its columns.
        brackets, coding: of text.
        mark, decimal, comment, quoted, index, header_size: dialect of text.
        clock: "rises", "ties", "swap" (a pair exchanged), "back" (set back once), "frames" (sorted within frames).
        empty_stream, second_stream: of HDF5 and npz.
        width, height: of the sensor.
        events, seconds, seed: of the recording.
    """

    format: str = "text"
    order: str = "txyp"
    named: bool = True
    unit_named: bool = False
    size_stated: bool = False
    unit: str = "us"
    floats: str = "none"
    polarity: str = "01"
    mark: str = ","
    decimal: str = "."
    comment: str = ""
    quoted: bool = False
    index: bool = False
    clock: str = "rises"
    empty_stream: bool = False
    second_stream: bool = False
    width: int = 320
    height: int = 200
    events: int = 200
    seconds: float = 0.05
    seed: int = 0
    unit_comment: bool = False
    size_as: str = "sides"
    from_one: bool = False
    across: bool = False
    brackets: bool = False
    coding: str = "utf-8"


def columns(spec: Spec) -> dict[str, np.ndarray]:
    """t [ns], x, y, p (0, 1) in the order of the file; its clock may go back."""
    rng = np.random.default_rng(spec.seed)
    n, tick = spec.events, max(NS[spec.unit], 1000)
    ticks = int(spec.seconds * 1e9) // (1000 if spec.floats != "none" or spec.unit in ("us", "ns") else tick)
    step = 1000 if spec.floats != "none" or spec.unit in ("us", "ns") else tick
    t = np.sort(rng.integers(0, max(ticks, 2), n)) * step
    if spec.clock == "ties":
        t = t // (20 * step) * (20 * step)
    if spec.clock == "swap":
        k = n // 2
        t[k], t[k + 1] = t[k + 1] + step, t[k]
    if spec.clock == "back":
        t[n // 2 :] -= t[n // 2] // 2
    if spec.clock == "frames":
        t = t[np.concatenate([rng.permutation(part) for part in np.array_split(np.arange(n), 8)])]
    x, y = rng.integers(0, spec.width, n), rng.integers(0, spec.height, n)
    x[0], y[0], x[2], y[3] = spec.width - 1, spec.height - 1, 0, 0
    return {"t": t, "x": x, "y": y, "p": rng.integers(0, 2, n)}


def _as_written(spec: Spec) -> dict[str, np.ndarray]:
    made = columns(spec)
    scale = NS[spec.unit]
    t = made["t"] / scale if spec.floats != "none" else made["t"] // scale
    p = made["p"]
    if spec.polarity == "pm1":
        p = 2 * p - 1
    elif spec.polarity == "bool":
        p = p.astype(bool)
    elif spec.polarity == "three":
        p = np.where(np.arange(len(p)) % 7 == 3, 0, 2 * p - 1)
    elif spec.polarity == "words":
        p = np.where(p == 1, "ON", "OFF")
    out = {"t": t, "x": made["x"] + spec.from_one, "y": made["y"] + spec.from_one, "p": p}
    if spec.floats == "all":
        out = {name: column if column.dtype.kind == "U" else column.astype(np.float64) for name, column in out.items()}
    return out


def truth(spec: Spec) -> dict[str, np.ndarray]:
    """What a reader must find; times as the file's numbers can say them."""
    made = columns(spec)
    scale = NS[spec.unit]
    t = made["t"] if spec.floats != "none" else made["t"] // scale * scale
    return {**made, "t": t}


def write(spec: Spec, folder: Path) -> Path:
    """The file."""
    data = _as_written(spec)
    kind = spec.format
    name = f"t_{spec.unit}" if spec.unit_named else "t"
    names = {"t": name, "x": "x", "y": "y", "p": "p"}
    if kind == "text":
        path = folder / "a.csv"
        path.write_text(_text(spec, data, names), encoding=spec.coding)
    elif kind.startswith("npz"):
        path = folder / "a.npz"
        extra = {"width": spec.width, "height": spec.height} if spec.size_stated else {}
        if spec.size_stated and spec.size_as == "pair":
            extra = {"sensor_size": np.array([spec.width, spec.height])}
        if spec.unit_comment:
            extra["time_unit"] = np.array(spec.unit)
        if kind == "npz":
            arrays = {names[k]: v for k, v in data.items()}
        elif kind == "npz_records":
            arrays = {"events": np.rec.fromarrays([data[k] for k in spec.order], names=[names[k] for k in spec.order])}
        else:
            rows = [data[k].astype(np.float64) for k in spec.order]
            arrays = {"events": np.stack(rows, axis=0 if spec.across else 1)}
        np.savez(path, **arrays, **extra)
    elif kind == "mat":
        path = folder / "a.mat"
        table = {names[k]: (v + (not spec.from_one) if k in "xy" else v)[:, None] for k, v in data.items()}
        savemat(path, {"events": table})
    else:
        path = folder / "a.h5"
        with h5py.File(path, "w") as file:
            _hdf5(spec, file, data, names)
    return path


def _hdf5(spec: Spec, file, data: dict, names: dict) -> None:
    place = "" if spec.format == "h5_root" else "events/"
    if spec.format in ("h5_group", "h5_root"):
        for letter, column in data.items():
            file[f"{place}{names[letter]}"] = column
    elif spec.format == "h5_rows":
        file["events"] = np.stack(
            [data[k].astype(np.float64 if spec.floats != "none" else np.int64) for k in spec.order],
            0 if spec.across else 1,
        )
    else:
        file["events"] = np.rec.fromarrays([data[k] for k in spec.order], names=[names[k] for k in spec.order])
    if spec.size_stated and spec.size_as == "sides":
        file.attrs["width"], file.attrs["height"] = spec.width, spec.height
    elif spec.size_stated:
        file.attrs["resolution"] = [spec.width, spec.height]
    if spec.unit_comment:
        file.attrs["time_unit"] = spec.unit
    for stated, stream, some in ((spec.empty_stream, "aside", 0), (spec.second_stream, "right", 50)):
        if stated:
            for letter, column in data.items():
                file[f"{stream}/{names[letter]}"] = column[:some]


def _text(spec: Spec, data: dict, names: dict) -> str:
    def cell(value) -> str:
        text = str(value) if not isinstance(value, float) else f"{value:.9f}".rstrip("0")
        text = text + "0" if text.endswith(".") else text
        return text.replace(".", spec.decimal)

    lines = [spec.comment] if spec.comment else []
    if spec.unit_comment:
        lines.append(f"# timestamps in {spec.unit}")
    if spec.size_stated:
        lines.append(f"%geometry:{spec.width},{spec.height}")
    quote = '"' if spec.quoted else ""
    if spec.named:
        heads = [f"{quote}{names[k]}{quote}" for k in spec.order]
        lines.append(spec.mark.join(["", *heads] if spec.index else heads))
    rows = zip(*(data[k].tolist() for k in spec.order), strict=True)
    for k, row in enumerate(rows):
        line = spec.mark.join([*([str(k)] if spec.index else []), *map(cell, row)])
        lines.append(f"[{line}]" if spec.brackets else line)
    return "\n".join(lines) + "\n"


def is_true(recording: Recording, spec: Spec) -> bool:
    """Whether a recording holds the truth of a file, times to a nanosecond and 1 in 10⁹."""
    events, right = recording.events, truth(spec)
    if len(events) != spec.events or np.any(np.abs(events.t - right["t"]) > 1 + 1e-9 * np.abs(right["t"])):
        return False
    return all(np.array_equal(getattr(events, name), right[name]) for name in "xyp")


def judged(spec: Spec, path: Path, options=None) -> str:
    """How a file was answered: "true", "refused: OPTION", or "wrong: WHY"."""
    try:
        with on_command_line():
            recording = open_recording(path, options)
    except InputError as error:
        with on_command_line():
            ways = [way for way in WAYS if way in str(error)]
        return f"refused: {ways[0]}" if ways else f"wrong: refused without a way out: {error}"
    if is_true(recording, spec):
        size = (recording.events.width, recording.events.height)
        return "true" if size == (spec.width, spec.height) else f"wrong: size {size}"
    line = Source.from_dict(recording.attributes.get("source")).line()
    return "said" if _said(spec, line) else f"wrong: {line or 'nothing said'}"


def _said(spec: Spec, line: str) -> bool:
    """Whether a line names the convention by which the file was read otherwise, and which an option overrides."""
    unit = spec.unit != "us" and not spec.unit_named and not spec.unit_comment and "t taken as" in line
    order = spec.order == "yxtp" and not spec.named and "columns taken as" in line
    return unit or order or (spec.from_one and "count from one" in line) or ("size" in line and " says" in line)
