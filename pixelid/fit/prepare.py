"""What a fit begins with: recordings that go together, and the model as they are to be fitted with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from pixelid.errors import InputError
from pixelid.fit.bias_priors import with_bias_priors
from pixelid.fit.data import as_fitted
from pixelid.fit.engines import FORMS
from pixelid.fit.levels.pixel_levels import Wanted
from pixelid.fit.measured_light import as_light_tells, unresolved
from pixelid.model.model import Model
from pixelid.parameters.gauge import Gauge
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import unit_of_light
from pixelid.recordings.sensor_light import is_measured


@dataclass(frozen=True)
class Prepared:
    """Recordings and model of a fit.

    Attributes:
        recordings: Within their light.
        model: In the unit of that light, with the gauge and priors asked for.
        pooled: Whether the recordings have no pixels.
        sampled: Whether sensors measured the light themselves, so that only its samples are known.
        held: Parameters that such light does not resolve, held.
        levels: Of pixels to be fitted, None: the light is taken as stated.
        of_biases: Priors from the bias settings in the recordings' headers.
    """

    recordings: Sequence[Recording]
    model: Model
    pooled: bool
    sampled: bool
    held: Sequence[str]
    levels: Wanted | None
    of_biases: dict[str, Any] | None


def prepare(
    recordings: Sequence[Recording],
    model: Model,
    gauge: Gauge | None,
    levels: Wanted | None,
    form: str,
    bias_priors: bool | str,
) -> Prepared:
    """What a fit begins with; arguments as of `fit`.

    Raises:
        InputError: Recordings that cannot be fitted together, an impossible gauge, a form that they do not allow.
    """
    if form not in FORMS:
        raise InputError(f"form must be one of {', '.join(FORMS)}, found {form!r}")
    if not recordings:
        raise InputError("no recordings to fit")
    if gauge is not None:
        if model.physical is None:
            raise InputError(f"model {model.name} has no [physical] values, so a gauge has nothing to map to")
        gauge.check(model.physical)
        model = replace(model, gauge=gauge)
    pooled = [recording.pooled for recording in recordings]
    if any(pooled) and not all(pooled):
        raise InputError("some recordings are pooled and some have pixels; fit them separately")
    for recording in recordings:
        recording.check_stimulus_covers_events()
    model = model.with_radiance_in(unit_of_light(recordings))
    if levels is not None:
        levels.check(recordings, model, form)
    fitted = as_fitted(recordings)
    sampled = any(map(is_measured, fitted))
    if form != "discrete" and (sampled or all(pooled)):
        why = "light that the sensor measured itself is" if sampled else "pooled counts are"
        raise InputError(f"form: {why} followed in the discrete form only")
    held, model = unresolved(model) if sampled else [], as_light_tells(model, fitted)
    of_biases = None
    if bias_priors:
        model, of_biases = with_bias_priors(model, fitted, None if bias_priors is True else bias_priors)
    return Prepared(fitted, model, all(pooled), sampled, held, levels, of_biases)
