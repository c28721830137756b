"""Which descriptions are worth a look beside a model, and the shapes to begin with."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.stages.described import Described, all_cells
from pixelid.stages.modulation import SINCE_EVENT
from pixelid.stimuli.pixel_lights import log_radiance_at

EXPONENTS = (-1.0, -0.5, 0.5, 1.0)
SPEED_EXPONENTS = (0.5, 1.0)
QUANTILES = (0.1, 0.5, 0.9)  # of a covariate at the events, as scales
EDGES = (0.25, 0.5, 0.75)  # likewise


def beginnings(values: Mapping[str, np.ndarray], model: Model) -> Iterator[tuple[Described, Model]]:
    """Every description that the model can have and lacks, of strength 0, in each shape to try of `covariates`."""
    for own in all_cells():
        if model.has(own.name) or (own.twin is not None and model.has(own.twin)):
            continue
        if model.photoreceptor not in own.photoreceptors:
            continue
        if own.covariate == SINCE_EVENT and any(f".{SINCE_EVENT}." in name for name in model.effects):
            continue
        for shape in _shapes(own, values.get(own.covariate)):
            yield own, _at(model, own, shape)


def _at(model: Model, own: Described, shape: dict[str, float]) -> Model:
    return model.with_effect(own.name, {"strength": 0.0, **shape})


def _shapes(own: Described, values: np.ndarray | None) -> list[dict[str, float]]:
    if own.form in ("constant", "linear"):
        return [{}]
    if values is None or len(values) == 0 or not np.ptp(values) > 0:
        return []
    if own.form == "power":
        reference = float(np.exp(np.mean(np.log(values[values > 0]))))
        exponents = SPEED_EXPONENTS if own.covariate == "speed" else EXPONENTS
        return [{"exponent": e, "reference": reference} for e in exponents]
    if own.form == "relaxation":
        return [{"scale": float(s)} for s in np.unique(np.quantile(values[values > 0], QUANTILES))]
    return [{"edge": float(e)} for e in np.unique(np.quantile(values, EDGES))]


def covariates(likelihood: EventTimes) -> dict[str, np.ndarray]:
    """Covariate → its values at the events (n,), or since the events before."""
    before = np.concatenate([iv.previous_s for iv in likelihood.intervals])
    parts = _of_light(likelihood.recordings, [(iv.pixel, iv.previous_s) for iv in likelihood.intervals])
    nudge_s = 1e-5  # over which the slope of the light is taken
    later = _of_light(likelihood.recordings, [(iv.pixel, iv.previous_s + nudge_s) for iv in likelihood.intervals])
    return {
        "previous_polarity": np.concatenate([iv.previous_sign for iv in likelihood.intervals]),
        "time_in_recording": before,
        "radiance": np.exp(parts),
        "speed": np.abs(later - parts) / nudge_s,
        SINCE_EVENT: likelihood.time_s - before,
    }


def _of_light(recordings: Sequence[Recording], when: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """(n,) log radiance of each recording's light at (pixels, times)."""
    logs = [log_radiance_at(r.stimulus, *at) for r, at in zip(recordings, when, strict=True) if r.stimulus is not None]
    return np.concatenate(logs)
