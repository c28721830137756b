"""A pixel to play with: one page with a small simulator in it, for shipped models and for a model of one's own.

The arithmetic is `templates/pixel.js`, which tests compare with `pixelid.simulate`; `templates/view.js` draws.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from pixelid.model.model import Model
from pixelid.model.shipped import find_model, shipped_models
from pixelid.outputs import whole_file
from pixelid.report.html import TEMPLATES
from pixelid.report.scripts import script

FAST = 1e7  # rad/s, as in pixel.js, which takes stages from there on for absent: they are late by 0.1 µs
SHOWN = {
    "source_follower_pole", "differencing_pole", "threshold_noise", "refractory_period", "leak", "dark_current",
}  # fmt: skip
OF_CIRCUIT = {
    "alpha": "alpha", "beta": "beta", "gamma": "gamma", "corner": "corner", "dark": "dark", "noise": "noise",
    "on": "on_threshold", "off": "off_threshold", "dead": "refractory", "leak": "leak_hz", "delay": "delay",
}  # fmt: skip


def preset(model: Model) -> dict[str, Any]:
    """What the page knows of a model: rates in rad/s, times in s, thresholds in log radiance, light in its unit."""
    circuit = model.circuit()
    numbers = {name: float(getattr(circuit, of)) for name, of in OF_CIRCUIT.items()}
    corner = {"second_order": circuit.alpha / circuit.beta, "one_pole": circuit.corner}.get(circuit.photoreceptor)
    # Of the photoreceptor in the light that the page begins with: events lag visibly, none is lost
    usual_corner_hz = 200.0
    return {name: number for name, number in numbers.items() if math.isfinite(number)} | {
        "name": model.name,
        "unit": model.radiance_unit,
        "photoreceptor": circuit.photoreceptor,
        "follower": min(circuit.follower, FAST),
        "differencing": min(circuit.differencing, FAST),
        "level": 2.0 * math.pi * usual_corner_hz / corner if corner else 100.0,
        "left_out": [name.replace("_", " ") for name in model.effects if name not in SHOWN],
    }


def is_scene(spec: str | Path) -> bool:
    """Whether a folder holds a scene and no pixel."""
    return (Path(spec) / "reconstruction.json").is_file() and not (Path(spec) / "model.toml").is_file()


def view_page(model: Model | None = None) -> str:
    """The page as text: a model of one's own, if there is one, and the shipped ones."""
    import jinja2

    shipped = [find_model(name) for name in shipped_models()]
    models = shipped if model is None else [model, *(one for one in shipped if one != model)]
    template = (TEMPLATES / "view.html").read_text(encoding="utf-8")
    return jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined).from_string(template).render(
        title="Play with a pixel" if model is None else f"Play with the pixel {model.name}",
        style=(TEMPLATES / "style.css").read_text(encoding="utf-8"),
        presets=json.dumps([preset(one) for one in models]).replace("<", "\\u003c"),
        scripts=[script("pixel"), script("view")],
    )  # fmt: skip


def write_view(model: Model, path: Path, *, overwrite: bool = False) -> None:
    """Write the page of a model.  Raises InputError where `path` exists and may not be replaced."""
    text = view_page(model)
    with whole_file(path, overwrite) as temporary:
        temporary.write_text(text, encoding="utf-8")
