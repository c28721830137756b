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

__all__ = [
    "Model",
    "Recording",
    "Status",
    "Stimulus",
    "align",
    "biases",
    "calibrate",
    "check",
    "convert",
    "crop",
    "design",
    "find_model",
    "fit",
    "gap",
    "inspect",
    "load_field",
    "lowlight",
    "open",
    "reconstruct",
    "sample",
    "simulate",
    "stimulus",
    "view",
]

if TYPE_CHECKING:
    from pixelid.api import calibrate, check, find_model, fit, gap, sample, simulate
    from pixelid.api_analyses import biases, design, load_field, lowlight, reconstruct, stimulus, view
    from pixelid.api_recordings import align, convert, crop, inspect, open
    from pixelid.model.model import Model
    from pixelid.recordings.recording import Recording
    from pixelid.status import Status
    from pixelid.stimuli.stimulus import Stimulus

_ELSEWHERE = {
    **dict.fromkeys(("align", "convert", "crop", "inspect", "open"), "pixelid.api_recordings"),
    "biases": "pixelid.api_analyses",
    "design": "pixelid.api_analyses",
    "load_field": "pixelid.api_analyses",
    "lowlight": "pixelid.api_analyses",
    "reconstruct": "pixelid.api_analyses",
    "stimulus": "pixelid.api_analyses",
    "view": "pixelid.api_analyses",
    "Model": "pixelid.model.model",
    "Recording": "pixelid.recordings.recording",
    "Status": "pixelid.status",
    "Stimulus": "pixelid.stimuli.stimulus",
}
_HOMES = {name: _ELSEWHERE.get(name, "pixelid.api") for name in __all__}


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
