"""Well-formed files of which one field is hostile: what a person, another program or an attacker may write.

`fuzz.py` damages bytes, and most of what it makes is refused by the first parser.  Here a file stays TOML, JSON, HDF5,
an archive of arrays, a table or a picture; one number, text, array, attribute, key or cell of it is replaced.
"""

from __future__ import annotations

import copy
import io
import json
import math
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import tomli_w

from pixelid.documents import read_toml

Mutant = tuple[str, "bytes | Callable[[], bytes]"]  # what is wrong, and the file or what makes it
Path_ = tuple[str | int, ...]  # keys and places down to a value of a document

BIG, SMALL = (1 << 63) - 1, -(1 << 63)
WORDS = ("", "\x1b[2Jred", "../../../../etc/passwd", "nan", "²", "x" * 5000, "a\nb", "é🎈\u202e", "-1", "/dev/zero")
NUMBERS: tuple[Any, ...] = (
    0, -1, -0.0, 1e308, -1e308, 1e-308, BIG, SMALL, 0.5, math.inf, math.nan, True, "1", [1.0], {}
)  # fmt: skip


def mutants(path: Path) -> list[Mutant]:
    """Every mutant of a file."""
    return list(BY_SUFFIX[path.suffix](path))


def content(mutant: Mutant) -> bytes:
    """The bytes of a mutant."""
    return mutant[1] if isinstance(mutant[1], bytes) else mutant[1]()


# --- documents ----------------------------------------------------------------------------------------------------


def toml_mutants(path: Path) -> Iterator[Mutant]:
    """Of a TOML file."""
    document = read_toml(path)
    for what, changed in _changed_documents(document):
        yield what, lambda changed=changed: tomli_w.dumps(changed()).encode()
    text = path.read_bytes()
    first = next((line for line in text.splitlines() if b"=" in line and not line.startswith(b"#")), b"a = 1")
    yield "a key twice", text.replace(first, first + b"\n" + first, 1)
    yield "tables 60 deep", text + b"\n[" + b".".join([b"a"] * 60) + b"]\nb = 1\n"
    yield "arrays 60 deep", b"zz = " + b"[" * 60 + b"]" * 60 + b"\n" + text
    yield "Latin-1", text.replace(b"=", b"= \xe9", 1)
    yield "UTF-16", text.decode().encode("utf-16")
    yield "a null", text.replace(b"=", b"=\0", 1)
    yield "nothing", b""


def json_mutants(path: Path) -> Iterator[Mutant]:
    """Of a JSON file; a number that is not finite is written as Python does, which JSON does not know."""
    document = json.loads(path.read_text())
    for what, changed in _changed_documents(document):
        yield what, lambda changed=changed: json.dumps(changed()).encode()
    text = path.read_text()
    yield "a key twice", ('{"status": [1],' + text.lstrip()[1:]).encode()
    yield "1e999", _first_number(text, "1e999").encode()
    yield "60 deep", ('{"zz": ' + "[" * 60 + "]" * 60 + "," + text.lstrip()[1:]).encode()
    yield "a list", f"[{text}]".encode()
    yield "UTF-16", text.encode("utf-16")
    yield "nothing", b""


def _first_number(text: str, number: str) -> str:
    import re

    return re.sub(r"(: )-?[0-9][0-9.eE+-]*", rf"\g<1>{number}", text, count=1)


def _changed_documents(document: Any) -> Iterator[tuple[str, Callable[[], Any]]]:
    """(what, how to make the document) with one value replaced, left out or added."""
    for place in _places(document):
        value = _at(document, place)
        name = ".".join(map(str, place)) or "the whole"
        for other in _others(value):
            yield f"{name}: {str(other)[:40]!r} for {type(value).__name__}", partial(_with, document, place, other)
        if place:
            yield f"{name}: left out", partial(_without, document, place)
        if isinstance(value, dict):
            yield f"{name}: an unknown key", partial(_with, document, (*place, "unknown_key"), 1)
        if isinstance(value, list) and value:
            yield f"{name}: the first twice", partial(_with, document, place, [value[0], *value])
            yield f"{name}: reversed", partial(_with, document, place, value[::-1])
            yield f"{name}: one less", partial(_with, document, place, value[:-1])


def _others(value: Any) -> Sequence[Any]:
    if isinstance(value, bool) or value is None:
        return ("yes", 2, [], {})
    if isinstance(value, int | float):
        return NUMBERS
    if isinstance(value, str):
        return (*WORDS, 7, [], {}, [value], True)
    if isinstance(value, list):
        return ([], {}, "a", 3, [[]], [{}], ["a"], [1], [1e308] * 3, value * 200)
    return ({}, [], "a", 3, [{}])


def _places(value: Any, here: Path_ = (), most: int = 3) -> Iterator[Path_]:
    """Where there are values; of a long list or table of like things the first ones."""
    yield here
    if isinstance(value, dict):
        for key in value:
            yield from _places(value[key], (*here, key))
    elif isinstance(value, list):
        for k in range(min(len(value), most)):
            yield from _places(value[k], (*here, k))


def _at(document: Any, place: Path_) -> Any:
    for key in place:
        document = document[key]
    return document


def _with(document: Any, place: Path_, value: Any) -> Any:
    if not place:
        return value if isinstance(value, dict) else {"a": value}
    changed = copy.deepcopy(document)
    _at(changed, place[:-1])[place[-1]] = value
    return changed


def _without(document: Any, place: Path_) -> Any:
    changed = copy.deepcopy(document)
    del _at(changed, place[:-1])[place[-1]]
    return changed


# --- arrays -------------------------------------------------------------------------------------------------------


def array_mutants(a: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """An array with another type, shape, length or values."""
    if a.dtype.names or a.dtype.kind in "USO":
        yield from (("numbers", np.arange(3)), ("empty", np.array("")), ("words", np.array(["x" * 3000, "\x1b[2J"])))
        return
    with np.errstate(all="ignore"):
        yield "texts", a.astype("S8")
        yield "complex", a.astype(np.complex128)
        yield "booleans", a.astype(bool)
        yield "8 bits", a.astype(np.uint8)
        yield "half floats", a.astype(np.float16)
        yield "floats", a.astype(np.float64)
        yield "big-endian", a.astype(a.dtype.newbyteorder(">"))
        yield "unsigned", a.astype(np.uint64)
        yield "a scalar", a.ravel()[:1].reshape(()) if a.size else np.zeros((), a.dtype)
        yield "a column", a.reshape(len(a), -1)[:, :, None] if a.ndim else a[None]
        yield "a row more", a[None]
        yield "empty", a[:0] if a.ndim else np.zeros(0, a.dtype)
        yield "no elements, one axis more", np.zeros((0, 3), a.dtype)
        if a.ndim:
            yield "one less", a[:-1]
            yield "one alone", a[:1]
            yield "reversed", a[::-1]
            yield "doubled", np.concatenate([a, a])
            yield "all the first", np.broadcast_to(a[:1], a.shape).copy()
            if a.shape[0] != a.T.shape[0]:
                yield "transposed", a.T
        for what, value in (("NaN", np.nan), ("inf", np.inf), ("-inf", -np.inf), ("1e308", 1e308), ("1e-308", 1e-308)):
            if a.dtype.kind == "f" and a.size:
                yield f"one {what}", _one(a, value, a.size // 2)
                yield f"all {what}", np.full(a.shape, value, a.dtype)
            elif a.size:
                yield f"floats, one {what}", _one(a.astype(np.float64), value, a.size // 2)
        for what, value in (("-1", -1), ("0", 0), ("2⁶³ − 1", BIG), ("−2⁶³", SMALL), ("2⁶⁴ − 1", (1 << 64) - 1)):
            if not a.size:
                continue
            kind = np.uint64 if value > BIG else np.int64
            for where, at in (("first", 0), ("last", a.size - 1)):
                yield f"{where} {what}", _one(a if a.dtype.kind == "f" else a.astype(kind), value, at)
            if value >= 0 or a.dtype.kind == "f":
                yield f"all {what}", np.full(a.shape, value, a.dtype if a.dtype.kind == "f" else kind)


def _one(a: np.ndarray, value: Any, at: int) -> np.ndarray:
    changed = a.copy()
    changed.reshape(-1)[at] = value
    return changed


def npz_mutants(path: Path) -> Iterator[Mutant]:
    """Of an archive of arrays."""
    with np.load(path, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}

    def packed(**some: np.ndarray) -> bytes:
        buffer = io.BytesIO()
        np.savez(buffer, **some)  # type: ignore[arg-type]
        return buffer.getvalue()

    for name, array in arrays.items():
        rest = {key: a for key, a in arrays.items() if key != name}
        yield f"{name}: left out", packed(**rest)
        for what, changed in array_mutants(array):
            yield f"{name}: {what}", packed(**rest, **{name: changed})
        if array.dtype.kind in "US" and array.ndim == 0 and str(array).startswith("{"):
            for what, document in _changed_documents(json.loads(str(array))):
                yield f"{name}: {what}", packed(**rest, **{name: np.array(json.dumps(document()))})
    yield "nothing in it", packed()
    yield "an array more", packed(**arrays, extra=np.zeros((2, 3)))
    buffer = io.BytesIO()
    np.savez(buffer, **arrays | {next(iter(arrays)): np.array([{"a": 1}], object)})  # type: ignore[arg-type]
    yield "objects", buffer.getvalue()


def npy_mutants(path: Path) -> Iterator[Mutant]:
    """Of one array."""
    for what, changed in array_mutants(np.load(path)):
        buffer = io.BytesIO()
        np.save(buffer, changed)
        yield what, buffer.getvalue()


# --- HDF5 ---------------------------------------------------------------------------------------------------------

ATTRIBUTES: tuple[Any, ...] = (
    -1, 0, 1, 1e308, np.nan, BIG, SMALL, 10**9, "", "x", "²", "\x1b[2J", "a" * 60_000, b"\xff\xfe", True,
    np.zeros(0), np.arange(3), np.zeros((2, 2)), np.array(["a", "b"], "S1"), h5py.Empty("f8"), np.complex128(1j),
)  # fmt: skip
METADATA = ("{}", "[]", "nan", '{"diff": [1]}', '{"diff": NaN}', '{"a": ' * 70 + "1" + "}" * 70, '{"diff": 1e999}')


def hdf5_mutants(path: Path) -> Iterator[Mutant]:
    """Of an HDF5 file: datasets, attributes, groups."""
    original = path.read_bytes()
    sets, groups, attributes = [], [], []
    with h5py.File(path, "r") as file:
        attributes += [("/", key) for key in file.attrs]

        def visit(name: str, item: Any) -> None:
            (sets if isinstance(item, h5py.Dataset) else groups).append(name)
            attributes.extend((name, key) for key in item.attrs)

        file.visititems(visit)

    def changed(change: Callable[[h5py.File], None]) -> bytes:
        buffer = io.BytesIO(original)
        with h5py.File(buffer, "r+") as file:
            change(file)
        return buffer.getvalue()

    def put(name: str, values: Any, **how: Any) -> bytes:
        def change(file: h5py.File) -> None:
            attrs = dict(file[name].attrs)
            del file[name]
            file.create_dataset(name, data=values, **how)
            file[name].attrs.update(attrs)

        return changed(change)

    def empty(name: str, shape: tuple[int, ...], kind: Any, **how: Any) -> bytes:
        def change(file: h5py.File) -> None:
            del file[name]
            file.create_dataset(name, shape, kind, **how)

        return changed(change)

    def delete(name: str) -> bytes:
        return changed(lambda file: file.__delitem__(name))

    def attribute(name: str, key: str, value: Any) -> bytes:
        return changed(lambda file: file[name].attrs.__setitem__(key, value))

    for name in sets:
        with h5py.File(path, "r") as file:
            array = file[name][()]
        yield f"{name}: left out", delete(name)
        if array.dtype.names:
            for field in array.dtype.names:
                for what, column in array_mutants(array[field]):
                    if column.shape == array.shape:
                        kinds = [(f, column.dtype if f == field else array.dtype[f]) for f in array.dtype.names]
                        record = np.empty(array.shape, kinds)
                        for f in array.dtype.names:
                            record[f] = column if f == field else array[f]
                        yield f"{name}.{field}: {what}", put(name, record)
                rest = [f for f in array.dtype.names if f != field]
                yield f"{name}.{field}: left out", put(name, array[rest].copy())
        else:
            for what, values in array_mutants(array):
                yield f"{name}: {what}", put(name, values)
        yield f"{name}: nothing", put(name, h5py.Empty("f8"))
        yield f"{name}: text", put(name, "x" * 100)
        yield f"{name}: texts of any length", put(name, np.array(["a", "b" * 1000], object), dtype=h5py.string_dtype())
        for what, kind in (("references", h5py.ref_dtype), ("lists", h5py.vlen_dtype(np.float64)), ("pairs", "2i8")):
            yield f"{name}: {what}", empty(name, (3,), kind)
        yield f"{name}: choices", put(name, np.zeros(3, np.int8), dtype=h5py.enum_dtype({"a": 0}, basetype="i1"))
        yield f"{name}: a group", changed(lambda f, n=name: (f.__delitem__(n), f.create_group(n)))  # type: ignore
        for power in (24, 40):
            yield f"{name}: {power} binary digits of length", empty(name, (1 << power,), "i8", chunks=(1 << 20,))
    for name in groups:
        yield f"{name}: left out", delete(name)
        yield f"{name}: an array", changed(lambda f, n=name: (f.__delitem__(n), f.__setitem__(n, np.arange(3))))  # type: ignore
    for name, key in attributes:
        yield f"{name}@{key}: left out", changed(lambda f, n=name, k=key: f[n].attrs.__delitem__(k))
        for value in (*ATTRIBUTES, *(METADATA if key in ("biases", "alignment") else ())):
            yield f"{name}@{key}: {str(value)[:40]!r}", attribute(name, key, value)
        if key in ("biases", "alignment"):
            with h5py.File(path, "r") as file:
                document = json.loads(file[name].attrs[key])
            for what, other in _changed_documents(document):
                yield f"{name}@{key}: {what}", attribute(name, key, json.dumps(other()))
    for k in ("pooled", "temperature_k", "geometry", "biases", "alignment"):
        for value in (*ATTRIBUTES, *METADATA):
            yield f"/@{k}: {str(value)[:40]!r} added", attribute("/", k, value)


# --- tables, pictures ---------------------------------------------------------------------------------------------

CELLS = ("", "nan", "inf", "-1", "0", "1e308", "-1e308", "1e-308", "9" * 400, "9223372036854775807", "1e999", "x", "²",
         "\x1b[2J", "1 2", '"', "0x10", "1_0", "1,5", "'=cmd", "\0", "é")  # fmt: skip


def table_mutants(path: Path) -> Iterator[Mutant]:
    """Of a table in text: a header and rows of cells."""
    lines = path.read_text().splitlines()
    head = next(k for k, line in enumerate(lines) if line and not line.startswith("#"))
    comma = "," if "," in lines[head] else ";" if ";" in lines[head] else " "

    def table(rows: list[str]) -> bytes:
        return ("\n".join(rows) + "\n").encode(errors="surrogateescape")

    for row, name in ((head, "head"), (head + 1, "first"), (len(lines) - 1, "last")):
        cells = lines[row].split(comma)
        for column in range(len(cells)):
            for cell in CELLS:
                changed = comma.join([*cells[:column], cell, *cells[column + 1 :]])
                yield f"{name} {cells[column][:12]}: {cell[:20]!r}", table([*lines[:row], changed, *lines[row + 1 :]])
            yield (
                f"{name} {column}: left out",
                table([*lines[:row], comma.join(cells[:column] + cells[column + 1 :]), *lines[row + 1 :]]),
            )
            yield (
                f"{name} {column}: twice",
                table([*lines[:row], comma.join(cells[: column + 1] + cells[column:]), *lines[row + 1 :]]),
            )
    split = [line.split(comma) for line in lines[head:]]
    for column in range(len(split[0])):
        for cell in ("0", "-1", "nan", "1e308", "1", "x"):
            rows = [comma.join([*s[:column], cell, *s[column + 1 :]]) for s in split[1:]]
            yield f"all {split[0][column][:12]}: {cell!r}", table([*lines[: head + 1], *rows])
        kept = [comma.join(s[:column] + s[column + 1 :]) for s in split]
        yield f"column {split[0][column][:12]}: left out", table([*lines[:head], *kept])
    yield "the head alone", table(lines[: head + 1])
    yield "one row", table(lines[: head + 2])
    yield "reversed", table([*lines[: head + 1], *lines[:head:-1]])
    yield "rows twice", table([*lines, *lines[head + 1 :]])
    yield "no head", table(lines[head + 1 :])
    yield "comments", b"# x\n" * 10
    yield "UTF-16", "\n".join(lines).encode("utf-16")
    yield "Latin-1", table(lines) + b"\xe9\n"
    yield "old Macintosh", "\r".join(lines).encode()
    yield "one line of 10⁶", table([*lines[: head + 1], "1" * 10**6])
    yield "10⁵ columns", table([*lines[: head + 1], comma.join(["1"] * 10**5)])
    yield "nothing", b""


def png_mutants(path: Path) -> Iterator[Mutant]:
    """Of a picture: other sizes, depths and channels, a truncated one."""
    from skimage.io import imread

    good = imread(path)
    yield "1 × 1", png(np.zeros((1, 1, 3), np.uint8))
    yield "16 bits", png(good.astype(np.uint16) * 257)
    yield "alpha, all clear", png(np.dstack([good[..., :3], np.zeros(good.shape[:2], np.uint8)]))
    yield "grey and alpha", png(np.zeros((*good.shape[:2], 2), np.uint8))
    yield "grey", png(np.zeros((*good.shape[:2], 1), np.uint8))
    yield "one row less", png(good[:-1])
    yield "no rows", png(good[:0])
    yield "cut", path.read_bytes()[:-20]
    yield "a header alone", path.read_bytes()[:33]
    yield "nothing", b""


def png(picture: np.ndarray) -> bytes:
    """A picture (height, width, channels) of 8 or 16 bits as PNG, whatever its size."""
    height, width, channels = picture.shape
    data = b"".join(b"\0" + row.tobytes() for row in picture.astype(picture.dtype.newbyteorder(">")))
    return declared_png(width, height, data, 8 * picture.dtype.itemsize, channels)


def declared_png(width: int, height: int, data: bytes, depth: int = 8, channels: int = 1) -> bytes:
    """A PNG that declares a size, bits and channels, whatever its data are (each row behind a filter byte)."""
    header = struct.pack(">IIBBBBB", width, height, depth, {1: 0, 2: 4, 3: 2, 4: 6}[channels], 0, 0, 0)

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(data)) + chunk(b"IEND", b"")


BY_SUFFIX: dict[str, Callable[[Path], Iterator[Mutant]]] = {
    ".toml": toml_mutants, ".json": json_mutants, ".npz": npz_mutants, ".npy": npy_mutants, ".h5": hdf5_mutants,
    ".csv": table_mutants, ".txt": table_mutants, ".png": png_mutants,
}  # fmt: skip
