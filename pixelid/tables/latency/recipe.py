"""A recipe says which cameras of which latency tables are of one kind, and what the model fitted to them is called."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pixelid import stages
from pixelid.documents import read_toml
from pixelid.errors import InputError, did_you_mean, shown
from pixelid.tables.latency.camera import Camera
from pixelid.tables.latency.reading import LatencyTable, read_tables

KEYS = ("tables", "cameras", "name", "summary", "without")


@dataclass(frozen=True)
class LatencyRecipe:
    """What to fit, and as what.

    Attributes:
        path: of the recipe.
        table: the rows of its cameras, under the model's name as one camera; `columns` keep their labels.
        name: of the model.
        summary: of the model, a sentence.
        without: effects left out of the model's file, because latencies do not show them.
    """

    path: Path
    table: LatencyTable
    name: str
    summary: str
    without: tuple[str, ...]

    def finished(self, camera: Camera) -> Camera:
        """The fitted camera under the recipe's name and summary, without what it leaves out."""
        model = camera.model
        for effect in self.without:
            model = model.without_effect(effect)
        return replace(camera, model=replace(model, name=self.name, summary=self.summary))


def read_latency_recipe(path: Path) -> LatencyRecipe:
    """The recipe of a TOML file with a [latency] table:

    tables: CSV files, relative to the recipe;  cameras: labels in them, all of one kind;  name, summary: of the model;
    without: effects left out of its file (optional).

    Raises:
        InputError: naming file and key, and for a camera that the tables do not have.
    """
    path = Path(path)
    document = read_toml(path).get("latency")
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected a [latency] table")
    for key in document:
        if key not in KEYS:
            raise InputError(f"{path}: [latency] {shown(key)}: expected one of {', '.join(KEYS)}")
    files, cameras = _texts(document, "tables", path), _texts(document, "cameras", path)
    name, summary = (_text(document, key, path) for key in ("name", "summary"))
    without = _texts(document, "without", path) if "without" in document else ()
    for effect in without:
        if effect not in stages.LIBRARY:
            known = did_you_mean(effect, stages.LIBRARY)
            raise InputError(f"{path}: [latency] without: no effect {shown(effect)}{known}")
    table = read_tables([path.parent / file for file in files])
    known = list(dict.fromkeys(table.camera.tolist()))
    for label in cameras:
        if label not in known:
            raise InputError(f"{path}: [latency] cameras: the tables have {', '.join(known)}, found {shown(label)}")
    chosen = table.select(np.isin(table.camera, cameras))
    return LatencyRecipe(path, replace(chosen, camera=np.full(len(chosen), name)), name, summary, without)


def _text(document: dict[str, Any], key: str, path: Path) -> str:
    value = document.get(key)
    if not isinstance(value, str) or not value:
        raise InputError(f"{path}: [latency] {key}: expected a text, found {shown(value)}")
    return value


def _texts(document: dict[str, Any], key: str, path: Path) -> tuple[str, ...]:
    values = document.get(key)
    if not isinstance(values, list) or not values or not all(isinstance(v, str) and v for v in values):
        raise InputError(f"{path}: [latency] {key}: expected a list of texts, found {shown(values)}")
    return tuple(values)
