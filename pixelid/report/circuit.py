"""The parts of a page that show a pixel's circuit: its drawing, the forest of intervals, and what to do with it."""

from __future__ import annotations

import base64
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from pixelid.documents import is_number, read_json
from pixelid.figures import words
from pixelid.model.shipped import find_model, shipped_models
from pixelid.report.forest import forest
from pixelid.report.format import number
from pixelid.report.pixel_drawing import draw_pixel
from pixelid.report.quantities import quantities

STATUS_LINES = {
    "converged": "All checks passed: the model describes the recordings",
    "misfit": "The model does not describe everything in the recordings",
    "at_bound": "A parameter is on its bound",
    "not_identified": "The recordings leave part of the circuit open",
    "not_converged": "Not reliable: the optimiser stopped early",
    "diverged": "Not reliable: the fit diverged",
    "interrupted": "Interrupted: call it again to go on",
}

Parameters = Mapping[str, Mapping[str, Any]]


def circuit_parts(
    parameters: Parameters, start: Mapping[str, float], folder: Path, base: str, added: Collection[str] = ()
) -> dict[str, Any]:
    """Names for the macros `pixel` and `intervals` of `parts.html`.

    Args:
        parameters: as a result's JSON has them.
        start: values of the start model by parameter.
        folder: of the result, where truth.json may lie.
        base: name of the start model.
        added: effects that it lacks.
    """
    shown = quantities(parameters)
    estimated = [q for q in shown if not q.fixed]
    return {
        "base": base,
        "added": list(added),
        "drawings": [draw_pixel(shown, added, narrow) for narrow in (False, True)],
        "forest": forest(parameters, start, read_truth(folder, parameters), added),
        "untracked": [q for q in estimated if not _has_logarithm(parameters[q.parameter])],
        "any_open": any(not q.identified for q in estimated),
        "other_parameters": {n: p for n, p in parameters.items() if n not in {q.parameter for q in shown}},
    }


def interval_parts(parameters: Parameters, start: Mapping[str, float] | None = None, base: str = "") -> dict[str, Any]:
    """Names for the macro `intervals` alone: of all free parameters, over `start` or their own values."""
    free = {name: p for name, p in parameters.items() if not p.get("fixed")}
    return {
        "base": base,
        "added": [],
        "forest": forest(free, start or {}, {}, stages_only=False),
        "untracked": [],
        "any_open": not all(p["identified"] for p in free.values()),
    }


def _has_logarithm(entry: Mapping[str, Any]) -> bool:
    return bool(entry["value"]) and entry["value"] > 0


def shipped_values(name: str, parameters: Parameters) -> dict[str, float]:
    """Values of a shipped model by parameter, where it has the name and they are in the units of a result's."""
    if name not in shipped_models():
        return {}
    model = find_model(name)
    same = [n for n, p in model.parameters.items() if n in parameters and p.unit == parameters[n].get("unit")]
    return {n: model.values[n] for n in same}


def read_truth(folder: Path, parameters: Parameters) -> dict[str, float]:
    """True values by parameter from truth.json in the folder, where one lies there.

    It holds values by parameter, also under `parameters`, or by the name of an effect under `effects`.
    """
    file = folder / "truth.json"
    if not file.is_file() or file.is_symlink():
        return {}
    content = read_json(file)
    nested = content.get("parameters"), content.get("effects")
    own, effects = (part if isinstance(part, dict) else {} for part in nested)
    truth = {}
    for q in quantities(parameters):
        places = (content, q.parameter), (own, q.parameter), (effects, q.effect)
        value = next((part[name] for part, name in places if name in part), None)
        if is_number(value):
            truth[q.parameter] = float(value)
    return truth


def circuit_alone(result: Mapping[str, Any]) -> dict[str, Any]:
    """The result with the pixel's parameters only, not those of recordings and clocks."""
    own = {q.parameter for q in quantities(result["parameters"])}
    return {**result, "parameters": {n: p for n, p in result["parameters"].items() if n in own}}


def next_recording(recommended: Mapping[str, Any], unit: str) -> str:
    """What to record next, in a sentence; the light in `unit`."""
    why, stimulus = recommended.get("why", "").replace("_", " "), recommended.get("stimulus")
    if not stimulus:
        return f"Recommended next: {why}." if why else ""
    values = [
        _with_unit(name, v, unit) for name, v in stimulus["parameters"].items() if name not in ("duration_s", "seed")
    ]
    details = f" ({', '.join(values)})" if values else ""
    return f"Record next: {stimulus['kind']}{details} for {words.seconds(stimulus['duration_s'])}, {why}."


def _with_unit(name: str, value: float, light: str) -> str:
    """A stimulus' parameter in words; its name ends in its unit.

    >>> _with_unit("stop_hz", 794.0, "fA"), _with_unit("level", 210.0, "fA"), _with_unit("rise_s", 2e-3, "fA")
    ('stop 794 Hz', 'level 210 fA', 'rise 2 ms')
    """
    if name.endswith("_hz"):
        return f"{name.removesuffix('_hz').replace('_', ' ')} {number(value, 3)} Hz"
    if name.endswith("_s"):
        return f"{name.removesuffix('_s').replace('_', ' ')} {words.seconds(value)}"
    unit = f" {light}" if name == "level" and light else ""
    return f"{name.replace('_', ' ')} {number(value, 3)}{unit}"


def uses_of(model: str) -> tuple[tuple[str, str], ...]:
    """(what for, command) of the model in a folder, its name quoted, in the order in which one would want them."""
    return (
        ("Which light to record next, and what it would improve", f"pixelid design {model} --out {model}_next"),
        ("The same pixel in a simulator", f"pixelid export {model} --to v2e --out {model}_v2e.json"),
        ("How slow it is in low light", f"pixelid lowlight {model} --out {model}_lowlight"),
    )


def downloads(folder: Path, file: str) -> list[tuple[str, str]]:
    """(name, data URI) of the files that go with a page: the model, and the JSON that it shows."""
    links = []
    most_linked = 512 << 10  # bytes of a file that is put into the page; a page is to stay below 3 MB
    for name, kind in (("model.toml", "text/plain"), (file, "application/json")):
        path = folder / name
        if path.is_file() and not path.is_symlink() and path.stat().st_size <= most_linked:
            links.append((name, f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode()}"))
    return links
