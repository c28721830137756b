"""A recipe says what an .npz of a published measurement means: frequencies, conditions, which array is which."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.model.files import read_toml
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
    source = (folder or path.resolve().parent) / str(document["table"])
    if not source.is_file():
        raise InputError(f"{source}: no such file (recipe {path.name}; --data says where recordings are)")
    frequency, rows = np.array(document["frequency_hz"], float), [str(c) for c in document["conditions"]]
    means, spreads, labels = [], [], []
    try:
        with np.load(source) as archive:
            for entry in document["arrays"]:
                for kind, into in (("mean", means), ("spread", spreads)):
                    name = entry.get(kind)
                    if name not in archive:
                        raise InputError(f"{source}: no array {name!r}; found {', '.join(archive.files)}")
                    if archive[name].shape != (len(rows), len(frequency)):
                        raise InputError(
                            f"{source}: {name}: expected {(len(rows), len(frequency))} values, found "
                            f"{archive[name].shape}"
                        )
                    into.append(archive[name])
                labels += [f"{row}, {entry.get('label', '')}" for row in rows]
    except (zipfile.BadZipFile, ValueError) as error:
        raise InputError(f"{source}: expected a .npz archive ({error})") from error
    return PoolTable(frequency, tuple(labels), np.concatenate(means).T, np.concatenate(spreads).T), source
