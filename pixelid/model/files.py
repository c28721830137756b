"""Model files: a circuit as TOML, read and written without loss.

    [model]       name, summary, photoreceptor, effects, linearisation, radiance_unit
    [parameters]  name = { value, unit, lower, upper, transform, free, prior = { mean, sd }, source }
    [physical]    A_amp, A_loop, tau_out, q_in, q_mil, radiance_scale, source      (optional)
    [gauge]       q_in = 0.875, A_loop = "0.7 A_amp", …                            (optional)

What a parameter leaves out is taken from the effect library.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from pathlib import Path

import tomli_w

from pixelid.errors import InputError
from pixelid.model.model import Model, expected_parameters
from pixelid.parameters.gauge import Gauge
from pixelid.parameters.invariants import PHYSICAL_NAMES, Physical
from pixelid.parameters.parameter import Parameter, Prior

_PARAMETER_KEYS = {"value", "unit", "lower", "upper", "transform", "free", "prior", "source"}


def read_toml(path: Path) -> dict:
    """A TOML file as a dictionary.  Raises InputError when it is missing or malformed."""
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or 'not text'})") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from None


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
            raise InputError(f"[{table}]: expected a table, found {document[table]!r}")
    kind = head.get("photoreceptor", "second_order")
    effects = head.get("effects", [])
    if not isinstance(effects, list) or not all(isinstance(name, str) for name in effects):
        raise InputError(f"[model] effects: expected a list of names, found {effects!r}")
    parameters = dict(expected_parameters(kind, effects))
    for name, entry in document.get("parameters", {}).items():
        if name not in parameters:
            raise InputError(f"[parameters] {name!r} belongs to no effect of this model")
        parameters[name] = _parameter(parameters[name], entry)
    physical, source = _physical(document.get("physical"))
    return Model(
        name=str(head["name"]),
        photoreceptor=kind,
        effects=tuple(effects),
        parameters=parameters,
        summary=str(head.get("summary", "")),
        linearisation=str(head.get("linearisation", "midpoint")),
        radiance_unit=str(head.get("radiance_unit", "radiance")),
        physical=physical,
        physical_source=source,
        gauge=Gauge.parse(document.get("gauge", {})),
    )


def _parameter(default: Parameter, entry) -> Parameter:
    if isinstance(entry, (int, float)) and not isinstance(entry, bool):
        return default.at(entry)
    if not isinstance(entry, dict):
        raise InputError(f"[parameters] {default.name}: expected a number or a table, found {entry!r}")
    unknown = set(entry) - _PARAMETER_KEYS
    if unknown:
        raise InputError(f"[parameters] {default.name}: unknown keys {', '.join(sorted(unknown))}")
    changes = dict(entry)
    if "prior" in changes:
        try:
            changes["prior"] = Prior(float(changes["prior"]["mean"]), float(changes["prior"]["sd"]))
        except (TypeError, KeyError, ValueError):
            raise InputError(f"[parameters] {default.name}: prior must be {{ mean = …, sd = … }}") from None
    for key in ("value", "lower", "upper"):
        if key in changes:
            if not isinstance(changes[key], (int, float)) or isinstance(changes[key], bool):
                raise InputError(f"[parameters] {default.name}.{key}: expected a number, found {changes[key]!r}")
            changes[key] = float(changes[key])
    if not isinstance(changes.get("free", True), bool):
        raise InputError(f"[parameters] {default.name}.free: expected true or false, found {changes['free']!r}")
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
    return physical, str(table.get("source", ""))


def to_document(model: Model) -> dict:
    """The TOML document of a model."""
    head = {
        "name": model.name,
        "summary": model.summary,
        "photoreceptor": model.photoreceptor,
        "effects": list(model.effects),
        "linearisation": model.linearisation,
        "radiance_unit": model.radiance_unit,
    }
    document: dict = {"model": head, "parameters": {}}
    for parameter in model.parameters.values():
        entry: dict = {"value": parameter.value, "unit": parameter.unit}
        for key in ("lower", "upper"):
            if math.isfinite(getattr(parameter, key)):
                entry[key] = getattr(parameter, key)
        entry |= {"transform": parameter.transform, "free": parameter.free}
        if parameter.prior:
            entry["prior"] = {"mean": parameter.prior.mean, "sd": parameter.prior.sd}
        if parameter.source:
            entry["source"] = parameter.source
        document["parameters"][parameter.name] = entry
    if model.physical:
        document["physical"] = {**model.physical.as_dict(), "source": model.physical_source}
    if model.gauge.statements():
        document["gauge"] = model.gauge.statements()
    return document


def save_model(model: Model, path: Path) -> None:
    """Write a model file that `load_model` reads back unchanged."""
    Path(path).write_bytes(tomli_w.dumps(to_document(model)).encode())
