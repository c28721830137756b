"""Cutoffs of a finished `pixelid rates` as a table against the bias that its columns are named by."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pixelid.documents import interpreting, read_json
from pixelid.errors import InputError
from pixelid.tables.biases.reading import BiasTable
from pixelid.tables.rates.bias_law import biases_of

FILE = "rates.json"
CUTOFF = re.compile(r"^cutoff_hz\[(.+)\]$")


def is_rates(path: Path) -> bool:
    """Whether this is the folder of a result of `pixelid rates`, or its rates.json."""
    return path.name == FILE or (path / FILE).is_file()


def read_cutoffs(path: Path) -> tuple[BiasTable, str]:
    """The cutoffs that the rates fix, with their errors, and a line that says which.

    Raises:
        InputError: a damaged result, columns that no bias names, or no cutoff that is identified.
    """
    path = path if path.name == FILE else path / FILE
    content = read_json(path)
    with interpreting(path, "the cutoffs of a `pixelid rates` result"):
        cutoffs = {match[1]: entry for name, entry in content["parameters"].items() if (match := CUTOFF.match(name))}
        known = {
            name: (float(e["value"]), float(e["std"])) for name, e in cutoffs.items() if e["identified"] and e["std"]
        }
    if not known:
        raise InputError(f"{path}: expected cutoffs of several columns that the rates fix, found none")
    value, sd = np.array(list(known.values())).T
    label = re.sub(r"[\d.\s]+$", "", next(iter(known))).strip("_ ").lower()
    code = label if label.startswith("bias_") else f"bias_{label or 'mv'}"
    name = "sf_cutoff_hz" if code == "bias_fo" else "cutoff_hz"
    table = BiasTable(name, "Hz", (code,), biases_of(list(known))[:, None], value, sd / value, sources=(path,))
    left_out = [column for column in cutoffs if column not in known]
    words = f"; without {', '.join(left_out)}, whose cutoff the rates leave open" if left_out else ""
    return table, f"{path.name}: {name} [Hz] against {code}{words}"
