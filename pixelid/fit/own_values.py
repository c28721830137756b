"""What every recording has of its own (a lamp's phase): free in each of them, from where the events of each want it.

Recordings are made minutes apart, so an effect's `starts_anew` parameters are theirs and not the camera's.  A phase has
many optima: a fit climbs to the nearest, so each recording starts at the best of `PHASES`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pixelid.errors import InputError
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model

PHASES = tuple(np.pi * (k / 4.0 - 1.0) for k in range(8))  # at most 22.5° from the best, well inside its hill


def with_own_values(model: Model, names: Sequence[str], parts_of: Callable[[Model], np.ndarray]) -> Model:
    """The model with what each recording has of its own free there.

    Unchanged where nothing of the kind is free, where there is one recording, and where recordings share a name.

    Args:
        model: At values to start from.
        names: Of the recordings.
        parts_of: The log-likelihood (recordings,) of each under a model.
    """
    anew = [name for name in model.starts_anew if model.parameter(name).free]
    own = {name.split("[", 1)[0] for name in model.nuisances}
    if own & {*anew} or not anew or len(names) < 2 or len(set(names)) < len(names):
        return model
    for parameter in anew:
        trials = [model.parameter(parameter).value, *PHASES]
        parts = np.array([_finite(parts_of, model.set({parameter: value})) for value in trials])
        best = np.argmax(parts, axis=0)
        own = {name: trials[k] for name, k in zip(names, best, strict=True)}
        model = model.with_nuisances({parameter: own})
    return model


def in_event_times(model: Model, likelihood: EventTimes) -> Model:
    """As `with_own_values`, by the event times of recordings."""
    names = [recording.name for recording in likelihood.recordings]
    return with_own_values(model, names, lambda trial: likelihood.terms(trial.circuit()).per_recording)


def _finite(parts_of: Callable[[Model], np.ndarray], trial: Model) -> np.ndarray | float:
    try:
        parts = parts_of(trial)
    except (InputError, FloatingPointError):
        return -np.inf
    return np.where(np.isfinite(parts), parts, -np.inf)
