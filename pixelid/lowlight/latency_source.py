"""What of latencies a low-light analysis is given: tables, a recipe or a finished fit; and how uncertain a fit left its
circuit."""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.arrays import load_arrays
from pixelid.documents import interpreting, read_json
from pixelid.errors import InputError
from pixelid.fit.draws import WIDEST
from pixelid.model.model import Model
from pixelid.statistics import Z95
from pixelid.tables.latency.camera import Camera
from pixelid.tables.latency.choosing import chosen_cameras, chosen_rows
from pixelid.tables.latency.model import GAMMA_OVER_CORNER
from pixelid.tables.latency.reading import LatencyTable, read_tables
from pixelid.tables.latency.recipe import read_latency_recipe
from pixelid.tables.latency.result import of_camera

RESULT = "latency.json"
_ADDED = ("measured", "predicted", "standardised", "statistics", "lost_edges", "spoiled")  # to the table's columns


@dataclass(frozen=True)
class LatencySource:
    """Rows of one camera, their label, and the files that they came from."""

    table: LatencyTable
    name: str
    files: tuple[Path, ...]


def read_source(paths: Sequence[Path], camera: Camera, label: str | None = None) -> LatencySource:
    """The rows to analyse.

    Args:
        paths: CSV tables, one recipe (.toml), or the folder of one finished `pixelid latency`.
        camera: of the model; its label chooses among several of the tables.
        label: the camera wanted.

    Raises:
        InputError: naming file and cell; several cameras and no word which is meant.
    """
    first = paths[0]
    alone = first.is_dir() or first.suffix == ".toml"
    if alone and len(paths) > 1:
        raise InputError(f"{first}: a recipe or a folder stands alone, without other tables")
    if first.is_dir():
        table, files = _of_result(first / RESULT), (first / RESULT,)
    elif alone:
        recipe = read_latency_recipe(first)
        table, files = recipe.table, (first, *recipe.table.sources)
    else:
        table, files = read_tables(paths), tuple(paths)
    table = chosen_rows(table, label)
    names = list(dict.fromkeys(table.camera.tolist()))
    if len(names) > 1 and camera.name in names:
        table, names = chosen_rows(table, camera.name), [camera.name]
    if len(names) > 1:
        raise InputError(f"{first}: latencies of {', '.join(names)}: say with --camera which of them the model is")
    return LatencySource(table, names[0], files)


def camera_of(spec: Path) -> Camera:
    """The camera of a shipped name, a model file, or the folder of a fit of one camera.

    Raises:
        InputError: a folder of several, or a damaged file.
    """
    first, *others = chosen_cameras(str(spec))[0]
    if others:
        names = ", ".join(camera.name for camera in (first, *others))
        raise InputError(f"{spec}: {len(others) + 1} cameras in it; expected the folder of one of {names}")
    return first


def latency_draws(
    folder: Path, model: Model, count: int, rng: np.random.Generator, camera: str | None = None
) -> list[Model]:
    """Circuits as uncertain as `pixelid latency` left that of a folder, or one camera's of several in it.

    Empty where it holds no fit of that camera, or of several and no word of which.

    From posterior.npz where the fit was sampled; else from the intervals of latency.json, as if they were independent.

    Raises:
        InputError: a damaged file.
    """
    path = folder / RESULT
    if not path.is_file():
        return []
    document = read_json(path)
    names = ("alpha_over_beta", "beta", "sf_cutoff_hz", "diff_cutoff_hz", "dark_current.radiance")
    with interpreting(path, "a latency fit"):
        entries = document["parameters"]
        own = {name: entries.get(of_camera(name, camera or "", camera is not None), {}) for name in names}
        if any(entry.get("interval_95") is None for entry in own.values()):
            return []  # several cameras, or a prediction
        sampled = document.get("posterior", {})
        if camera is None and len(sampled) == 1:
            camera = str(next(iter(sampled)))
        if camera is not None and (folder / "posterior.npz").is_file() and camera in sampled:
            chains, order = load_arrays(folder / "posterior.npz"), list(sampled[camera]["parameters"])
            chain = np.asarray(chains[camera], dtype=float).reshape(-1, len(order))
            chosen = np.exp(chain[rng.integers(len(chain), size=count)])
            values = {name: chosen[:, order.index(name)] for name in names}
        else:
            values = {name: _drawn(own[name], count, rng) for name in names}
    values["alpha"] = values["alpha_over_beta"] * values["beta"]
    values["gamma"] = GAMMA_OVER_CORNER * values.pop("alpha_over_beta")
    kept = {name: value for name, value in values.items() if name in model.parameters}
    limits = {name: (model.parameters[name].lower, model.parameters[name].upper) for name in kept}
    return [
        model.set({name: float(np.clip(value[k], *limits[name])) for name, value in kept.items()})
        for k in range(count)
    ]  # fmt: skip


def _drawn(entry: dict[str, Any], count: int, rng: np.random.Generator) -> np.ndarray:
    """(count,) values of a parameter, log-normal within its interval; open ones no wider than `WIDEST`."""
    low, high = entry["interval_95"]
    sd = min(np.log(high / low) / (2.0 * Z95), WIDEST)
    return entry["value"] * np.exp(sd * rng.standard_normal(count))


def _of_result(path: Path) -> LatencyTable:
    """The table that a finished fit was made from, from its rows."""
    document = read_json(path)
    with interpreting(path, "a latency fit"), tempfile.TemporaryDirectory() as folder:
        rows, cameras = document["rows"], document["cameras"]
        names = [name for name in rows[0] if name not in _ADDED]
        text = Path(folder) / path.name
        with text.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(names)
            writer.writerows([["" if row[name] is None else row[name] for name in names] for row in rows])
        try:
            table = replace(read_tables([text]), sources=(path,))
        except InputError as error:
            raise InputError(str(error).replace(str(text), f"{path}: rows")) from None
    if len(cameras) == 1:  # a recipe's, that joins several
        table = replace(table, camera=np.full(len(table), str(cameras[0])))
    return table
