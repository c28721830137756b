"""A recipe says what an .npz of a published measurement means: frequencies, conditions, which array is which."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pixelid.arrays import load_arrays
from pixelid.documents import is_number, read_toml
from pixelid.errors import InputError, shown
from pixelid.tables.rates.pool import PoolTable


def read_pool_recipe(path: Path, folder: Path | None = None) -> tuple[PoolTable, Path]:
    """(table, file it came from) of a TOML recipe with a [rates] table:

    table: an .npz, relative to `folder` (default: the recipe's);  frequency_hz: (n,) of the light's cycles;
    conditions: (m,) labels of rows;  arrays: list of {mean, spread, label}, names of (m, n) arrays.

    Raises InputError naming file and key.
    """
    document = read_toml(path).get("rates")
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected a [rates] table")
    for key in ("table", "frequency_hz", "conditions", "arrays"):
        if key not in document:
            raise InputError(f"{path}: [rates] {key} is missing")
    table, conditions, arrays = document["table"], document["conditions"], document["arrays"]
    if not isinstance(table, str):
        raise InputError(f"{path}: [rates] table: expected the name of a .npz file, found {shown(table)}")
    if not isinstance(conditions, list) or not all(isinstance(c, str | int | float) for c in conditions):
        raise InputError(f"{path}: [rates] conditions: expected a list of labels, found {shown(conditions)}")
    frequency = _frequencies(document["frequency_hz"], path)
    source = (folder or path.resolve().parent) / table
    if not source.is_file():
        raise InputError(f"{source}: no such file (recipe {path.name}; --data says where recordings are)")
    rows = [str(c) for c in conditions]
    means, spreads, labels = [], [], []
    archive = load_arrays(source)
    for entry in _entries(arrays, path):
        for kind, into in (("mean", means), ("spread", spreads)):
            values = archive[_known(archive, entry.get(kind), source)]
            if values.shape != (len(rows), len(frequency)) or values.dtype.kind not in "fiu":
                raise InputError(
                    f"{source}: {entry[kind]}: expected {(len(rows), len(frequency))} numbers, found "
                    f"{values.shape} of {values.dtype}"
                )
            into.append(values.astype(float))
        labels += [f"{row}, {entry.get('label', '')}" for row in rows]
    if len(set(labels)) < len(labels):
        raise InputError(f"{path}: [rates] conditions, arrays: expected labels that differ, found {shown(labels)}")
    return PoolTable(frequency, tuple(labels), np.concatenate(means).T, np.concatenate(spreads).T), source


def _frequencies(listed: object, path: Path) -> np.ndarray:
    numbers = isinstance(listed, list) and all(map(is_number, listed))
    if not numbers or not listed:
        raise InputError(f"{path}: [rates] frequency_hz: expected a list of numbers, found {shown(listed)}")
    return np.array(listed, float)


def _entries(arrays: object, path: Path) -> list[dict]:
    if not isinstance(arrays, list) or not arrays or not all(isinstance(entry, dict) for entry in arrays):
        raise InputError(f"{path}: [rates] arrays: expected tables of mean, spread, label, found {shown(arrays)}")
    return arrays


def _known(archive: Mapping, name: object, source: Path) -> str:
    if not isinstance(name, str) or name not in archive:
        raise InputError(f"{source}: no array {shown(name)}; found {shown(', '.join(archive), 200)}")
    return name
