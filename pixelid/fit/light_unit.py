"""The unit of the light: one factor between the numbers of the recordings and those of the model, looked for first.

Light in lux, W/m² or volts of a photodiode is as good as light in the model's own unit: α, γ and every parameter with
the dimension of a radiance are in it.  A search that starts a thousandfold off sees a pixel that hardly fires, and does
not come back.  So the likelihood of a few events is scanned over the factor, from the model's own unit and over twelve
decades about the light at which its photoreceptor changes its nature, which does not depend on any unit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.starts import feasible
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.stimuli.pixel_lights import lights_in

NOISE = "threshold_sigma"
# Relative scatter of levels about their median.  Of cameras simulated by another hand it is 0.04 to 0.34 in their own
# unit, with whatever effects missing, and 0.50 (all that is looked at) in one that is off by a factor 3 or more below.
PLAUSIBLE = 0.35
KINETIC = ("alpha", "gamma", "alpha_over_beta")


def in_recorded_unit(model: Model, likelihood: EventTimes) -> Model:
    """The model in the unit of the recordings' light, as their events have it; as it is where its unit is held.

    Args:
        model: At its own values.
        likelihood: Of a few events.
    """
    scaled = [name for name in KINETIC if name in model.parameters]
    if not scaled or not all(model.parameter(name).free for name in scaled):
        return model
    if is_plausible(model, likelihood):
        return model
    about = typical_light(likelihood.recordings) / reference_light(model)
    decades, per_decade = 12, 2  # searches come back from a factor e: the nearest start is within e^0.6
    steps = np.arange(-decades * per_decade // 2, decades * per_decade // 2 + 1) / per_decade
    trials = [model, *(model.in_light(about * 10.0**step) for step in steps)]
    return max(trials, key=lambda trial: _log_likelihood(trial, likelihood))


def is_plausible(model: Model, likelihood: EventTimes) -> bool:
    """Whether the model's own unit may be that of the recordings: levels at most events scatter little about one value.

    In another unit the filtered light does not reach the thresholds that its unfiltered contrast has, or overshoots
    them: levels then scatter by their own size, whatever effect a pixel lacks.
    """
    try:
        start = feasible(model, likelihood)
        return start.values.get(NOISE, np.inf) < PLAUSIBLE and np.isfinite(_log_likelihood(model, likelihood))
    except (InputError, FloatingPointError):
        return False


def typical_light(recordings: Sequence[Recording]) -> float:
    """Geometric mean of the light over the recordings, each counting once."""
    lights = [lights_in(r.stimulus) for r in recordings if r.stimulus is not None]
    return float(np.exp(np.mean([np.mean([np.log(one.radiance).mean() for one in some]) for some in lights])))


def reference_light(model: Model) -> float:
    """The light at which the model's photoreceptor has its corner at 1 rad/s, or its two poles meet (β²/α)."""
    v = model.values
    return 1.0 / v["alpha_over_beta"] if "alpha_over_beta" in v else v["beta"] ** 2 / v["alpha"]


def unit_sentence(fitted: Model, shipped: Model) -> str:
    """What one unit of the recordings' light is in the model's own, were the photodiode the same; "" where it is that.

    γ = 1/q: the charge at the photodiode's node, which the layout decides, makes the ratio of the γ that of the units.
    """
    if fitted.light_scale == shipped.light_scale or shipped.radiance_unit == fitted.radiance_unit:
        return ""
    names = [name for name in ("gamma", "alpha_over_beta") if name in fitted.parameters]
    if not names:
        return ""
    factor = fitted.values[names[0]] / shipped.values[names[0]]
    return f"1 {fitted.radiance_unit} of this light is {factor:.3g} {shipped.radiance_unit}, were it a {shipped.name}"


def _log_likelihood(model: Model, likelihood: EventTimes) -> float:
    try:
        value = likelihood.log_likelihood(feasible(model, likelihood).circuit())
    except (InputError, FloatingPointError):
        return -np.inf
    return value if np.isfinite(value) else -np.inf
