"""Identify the circuit of an event camera's pixel from its events.

    import pixelid as px

    result = px.calibrate("bench/")          # raw recordings and light traces → a checked model
    print(result.summary())
    px.fit(px.open("session/"), "dvs128")    # one step of it

A model is a `Model`, a shipped name, a .toml file or a fit folder; recordings are paths, `Recording`s, or a list of
either; a stimulus is a `Stimulus`, a built-in name, or a file.  Everything else is an `InputError` in plain words.
"""

from typing import TYPE_CHECKING

from pixelid.lazy import show

__version__ = "0.1.0"

__all__ = [
    "Model",
    "Recording",
    "Status",
    "Stimulus",
    "calibrate",
    "check",
    "design",
    "find_model",
    "fit",
    "gap",
    "load_field",
    "lowlight",
    "open",
    "reconstruct",
    "sample",
    "simulate",
]

if TYPE_CHECKING:
    from pixelid.api import calibrate, check, find_model, fit, gap, open, sample, simulate
    from pixelid.api_analyses import design, load_field, lowlight, reconstruct
    from pixelid.model.model import Model
    from pixelid.recordings.recording import Recording
    from pixelid.status import Status
    from pixelid.stimuli.stimulus import Stimulus

_HOMES = {
    "design": "pixelid.api_analyses",
    "load_field": "pixelid.api_analyses",
    "lowlight": "pixelid.api_analyses",
    "reconstruct": "pixelid.api_analyses",
    "Model": "pixelid.model.model",
    "Recording": "pixelid.recordings.recording",
    "Status": "pixelid.status",
    "Stimulus": "pixelid.stimuli.stimulus",
}
show(__name__, {name: _HOMES.get(name, "pixelid.api") for name in __all__})
