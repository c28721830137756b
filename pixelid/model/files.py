"""Model files: a circuit as TOML, read and written without loss.

    [model]       name, summary, photoreceptor, effects, linearisation, radiance_unit
    [parameters]  name = { value, unit, lower, upper, transform, free, prior = { mean, sd }, source }
    [physical]    A_amp, A_loop, tau_out, q_in, q_mil, radiance_scale, source      (optional)
    [gauge]       q_in = 0.875, A_loop = "0.7 A_amp", …                            (optional)
    [[described]] stage, quantity, covariate, form, parameters                     (optional, `stages/described.py`)

What a parameter leaves out is taken from the effect library; the source only with the library's value.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import tomli_w

from pixelid.documents import is_number, read_toml
from pixelid.errors import InputError, shown
from pixelid.model.model import Model, expected_parameters
from pixelid.parameters.gauge import Gauge
from pixelid.parameters.invariants import PHYSICAL_NAMES, Physical
from pixelid.parameters.parameter import Parameter, Prior
from pixelid.stages.described import PREFIX, cell
from pixelid.stages.described import described as described_effect

_PARAMETER_KEYS = {"value", "unit", "lower", "upper", "transform", "free", "prior", "source"}


def load_model(path: Path) -> Model:
    """The model of a TOML file.  Raises InputError naming the file and the key that is wrong."""
    document = read_toml(path)
    try:
        return from_document(document)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def from_document(document: dict) -> Model:
    """A model from parsed TOML."""
    head = document.get("model")
    if not isinstance(head, dict) or "name" not in head:
        raise InputError("expected a [model] table with a name")
    for table in ("parameters", "physical", "gauge"):
        if not isinstance(document.get(table, {}), dict):
            raise InputError(f"[{table}]: expected a table, found {shown(document[table])}")
    words = {"name": "", "photoreceptor": "second_order", "summary": "", "linearisation": "midpoint",
             "radiance_unit": "radiance"}  # fmt: skip
    title, kind, summary, linearisation, radiance_unit = (_text(head, "[model]", key, words[key]) for key in words)
    light_scale = head.get("light_scale", 1.0)
    if not is_number(light_scale) or not 0 < light_scale < math.inf:
        raise InputError(f"[model] light_scale: expected a positive number, found {shown(light_scale)}")
    if "\n" in title:
        raise InputError(f"[model] name: expected one line, found {shown(title)}")
    effects = head.get("effects", [])
    if not isinstance(effects, list) or not all(isinstance(name, str) for name in effects):
        raise InputError(f"[model] effects: expected a list of names, found {shown(effects)}")
    described, own = _described(document.get("described", []))
    effects = [*effects, *described]
    parameters = dict(expected_parameters(kind, effects))
    for name, entry in {**document.get("parameters", {}), **own}.items():
        if name not in parameters:
            raise InputError(f"[parameters] {shown(name)} belongs to no effect of this model")
        parameters[name] = _parameter(parameters[name], entry)
    physical, source = _physical(document.get("physical"))
    return Model(
        name=title,
        photoreceptor=kind,
        effects=tuple(effects),
        parameters=parameters,
        summary=summary,
        linearisation=linearisation,
        radiance_unit=radiance_unit,
        light_scale=light_scale,
        physical=physical,
        physical_source=source,
        gauge=Gauge.parse(document.get("gauge", {})),
    )


def _described(entries) -> tuple[list[str], dict]:
    """(names, parameters by full name) of the [[described]] tables."""
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise InputError(f"[[described]]: expected tables, found {shown(entries)}")
    names, parameters = [], {}
    for entry in entries:
        unknown = set(entry) - {"stage", "quantity", "covariate", "form", "parameters"}
        if unknown:
            raise InputError(f"[[described]] unknown keys {', '.join(sorted(unknown))}")
        own = cell(*(_text(entry, "[[described]]", key, "") for key in ("quantity", "covariate", "form")))
        if _text(entry, "[[described]]", "stage", own.stage) != own.stage:
            raise InputError(f"[[described]] stage: {own.quantity} belongs to {own.stage!r}, found {entry['stage']!r}")
        values = entry.get("parameters", {})
        if not isinstance(values, dict):
            raise InputError(f"[[described]] parameters: expected a table, found {shown(values)}")
        names.append(own.name)
        parameters |= {f"{own.name}.{key}": value for key, value in values.items()}
    return names, parameters


def _parameter(default: Parameter, entry) -> Parameter:
    if is_number(entry):
        return default.at(entry)
    if not isinstance(entry, dict):
        raise InputError(f"[parameters] {default.name}: expected a number or a table, found {shown(entry)}")
    unknown = set(entry) - _PARAMETER_KEYS
    if unknown:
        raise InputError(f"[parameters] {default.name}: unknown keys {', '.join(sorted(unknown))}")
    changes = dict(entry)
    if "prior" in changes:
        try:
            changes["prior"] = Prior(
                **{key: float(changes["prior"][key]) for key in {"mean", "sd"} | {*changes["prior"]}}
            )
        except (TypeError, KeyError, ValueError):
            raise InputError(f"[parameters] {default.name}: prior must be {{ mean = …, sd = … }}") from None
    for key in ("value", "lower", "upper"):
        if key in changes:
            if not is_number(changes[key]):
                raise InputError(f"[parameters] {default.name}.{key}: expected a number, found {shown(changes[key])}")
            changes[key] = float(changes[key])
    for key in ("unit", "transform", "source"):
        _text(changes, f"[parameters] {default.name}", key, "")
    if "source" not in changes and changes.get("value", default.value) != default.value:
        changes["source"] = ""  # the library's is of its own value
    if not isinstance(changes.get("free", True), bool):
        raise InputError(f"[parameters] {default.name}.free: expected true or false, found {shown(changes['free'])}")
    return replace(default, **changes)


def _physical(table: dict | None) -> tuple[Physical | None, str]:
    if table is None:
        return None, ""
    values = {key: value for key, value in table.items() if key != "source"}
    unknown = set(values) - set(PHYSICAL_NAMES)
    if unknown:
        raise InputError(f"[physical] unknown names {', '.join(sorted(unknown))}; known: {', '.join(PHYSICAL_NAMES)}")
    try:
        physical = Physical(**{key: float(value) for key, value in values.items()})
    except (TypeError, ValueError):
        raise InputError(f"[physical] needs the numbers {', '.join(PHYSICAL_NAMES[:5])}") from None
    for key, value in physical.as_dict().items():
        if not 0 < value < math.inf:
            raise InputError(f"[physical] {key}: expected a positive number, found {value:g}")
    return physical, _text(table, "[physical]", "source", "")


def _text(table: dict, where: str, key: str, default: str) -> str:
    value = table.get(key, default)
    if not isinstance(value, str):
        raise InputError(f"{where} {key}: expected text, found {shown(value)}")
    return value


def to_document(model: Model) -> dict:
    """The TOML document of a model."""
    head = {
        "name": model.name,
        "summary": model.summary,
        "photoreceptor": model.photoreceptor,
        "effects": [name for name in model.effects if not name.startswith(PREFIX)],
        "linearisation": model.linearisation,
        "radiance_unit": model.radiance_unit,
        **({} if model.light_scale == 1.0 else {"light_scale": model.light_scale}),
    }
    document: dict = {"model": head, "parameters": {}}
    described = {name: described_entry(name) for name in model.effects if name.startswith(PREFIX)}
    for parameter in model.parameters.values():
        entry: dict = {"value": parameter.value, "unit": parameter.unit}
        for key in ("lower", "upper"):
            if math.isfinite(getattr(parameter, key)):
                entry[key] = getattr(parameter, key)
        entry |= {"transform": parameter.transform, "free": parameter.free}
        if parameter.prior:
            entry["prior"] = parameter.prior.as_dict()
        if parameter.source:
            entry["source"] = parameter.source
        owner, _, short = parameter.name.rpartition(".")
        own = described.get(owner)
        (document if own is None else own)["parameters"][parameter.name if own is None else short] = entry
    if described:
        document["described"] = list(described.values())
    if model.physical:
        document["physical"] = {**model.physical.as_dict(), "source": model.physical_source}
    if model.gauge.statements():
        document["gauge"] = model.gauge.statements()
    return document


def described_entry(name: str) -> dict:
    """The [[described]] table of an effect of the grammar, its parameters to be filled in."""
    own = described_effect(name)
    return {"stage": own.stage, "quantity": own.quantity, "covariate": own.covariate, "form": own.form,
            "parameters": {}}  # fmt: skip


def save_model(model: Model, path: Path) -> None:
    """Write a model file that `load_model` reads back unchanged."""
    Path(path).write_bytes(tomli_w.dumps(to_document(model)).encode())
