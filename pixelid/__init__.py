"""Identify the circuit of an event camera's pixel from its events.

    import pixelid as px

    result = px.calibrate("bench/")          # raw recordings and light traces → a checked model
    print(result.summary())
    px.fit(px.open("session/"), "dvs128")    # one step of it

A model is a `Model`, a shipped name, a .toml file or a fit folder; recordings are paths, `Recording`s, or a list of
either; a stimulus is a `Stimulus`, a built-in name, or a file.  Everything else is an `InputError` in plain words.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOMES = {
    **dict.fromkeys(("calibrate", "check", "find_model", "fit", "gap", "sample", "simulate"), "pixelid.api"),
    **dict.fromkeys(("align", "convert", "crop", "inspect", "open"), "pixelid.api_recordings"),
    **dict.fromkeys(("compare", "conform", "report", "sensor"), "pixelid.api_analyses"),
    **dict.fromkeys(("design", "export", "lowlight", "stimulus"), "pixelid.api_models"),
    **dict.fromkeys(("biases", "flicker", "latency", "noise", "rates"), "pixelid.api_tables"),
    **dict.fromkeys(("dataset", "load_field", "reconstruct", "render", "view"), "pixelid.api_scenes"),
    "Model": "pixelid.model.model",
    "Recording": "pixelid.recordings.recording",
    "Status": "pixelid.status",
    "Stimulus": "pixelid.stimuli.stimulus",
}

__all__ = [
    "Model", "Recording", "Status", "Stimulus", "align", "biases", "calibrate", "check", "compare", "conform",
    "convert", "crop", "dataset", "design", "export", "find_model", "fit", "flicker", "gap", "inspect", "latency",
    "load_field", "lowlight", "noise", "open", "rates", "reconstruct", "render", "report", "sample", "sensor",
    "simulate", "stimulus", "view",
]  # fmt: skip

if TYPE_CHECKING:
    from pixelid.api import calibrate, check, find_model, fit, gap, sample, simulate
    from pixelid.api_analyses import compare, conform, report, sensor
    from pixelid.api_models import design, export, lowlight, stimulus
    from pixelid.api_recordings import align, convert, crop, inspect, open
    from pixelid.api_scenes import dataset, load_field, reconstruct, render, view
    from pixelid.api_tables import biases, flicker, latency, noise, rates
    from pixelid.model.model import Model
    from pixelid.recordings.recording import Recording
    from pixelid.status import Status
    from pixelid.stimuli.stimulus import Stimulus


def __getattr__(name: str) -> Any:  # PEP 562: what is heavy loads when it is used
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return globals().setdefault(name, getattr(import_module(_HOMES[name]), name))


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


class _Package(ModuleType):
    """This package, of which a few functions and subpackages have one name: `pixelid.fit(…)`, `pixelid.fit.FitResult`.

    The import system sets a subpackage as an attribute once it is loaded.  The function keeps its place, and shares the
    subpackage's names.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if isinstance(value, ModuleType) and name in _HOMES:
            function = getattr(self, name)
            value.__dict__["__wrapped__"] = function.__wrapped__  # where `inspect` looks for the signature
            function.__dict__ = value.__dict__
        else:
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
