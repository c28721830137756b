"""A model's free parameters fitted to a part of the pixels, from given starts, for searches that make many such fits.

`maximise` starts at the model's own values; `maximise_with_restarts` gives filter cutoffs, and a photoreceptor, that
ran away a second chance.  Fits are read from and kept in a `FitCache` where one is passed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pixelid.fit import newton
from pixelid.fit.cache import FitCache
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.starts import narrower
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model

# From nominal (natural logarithm), beyond which a cutoff is put back and fitted again.  Cameras of one kind differ by
# less; a fit that is restarted needlessly only costs time, as the better of the two is kept.
RUNAWAY_LOG_FACTOR = math.log(5.0)
# The photoreceptor as one filter: where β ran away, γ, alone left where it went, would hold the fit there (beside a
# silence 710 nats below where it ends with all three put back, of 6,482 events).  Only β is in a unit without the
# light's, in which a camera may differ from nominal by any factor.
TWO_POLES = ("alpha", "beta", "gamma")


@dataclass(frozen=True)
class Maximum:
    """A model at its likeliest values for some events.

    Attributes:
        model: At the fitted values.
        coordinates: The free parameters.
        x: (d,) the fitted values in those coordinates.
        value: Log-likelihood, nats.
        information: (d, d) at x.
        unexplained: Number of events that no threshold explains (background events).
        converged: Whether the optimiser met its tolerance.
    """

    model: Model
    coordinates: Coordinates
    x: np.ndarray
    value: float
    information: np.ndarray
    unexplained: int
    converged: bool

    @property
    def values(self) -> Mapping[str, float]:
        """All parameter values."""
        return self.model.values


def maximise(
    likelihood: EventTimes, model: Model, *, tolerance: float, max_steps: int, cache: FitCache | None = None
) -> Maximum:
    """The model's free parameters fitted to a likelihood's events, from the model's own values.

    Args:
        likelihood: Of the events to explain.
        model: Where to start.
        tolerance: Nats that one more step may still promise at the end.
        max_steps: Of the optimiser.
        cache: Where fits already made are kept; None: nowhere.
    """
    coordinates = Coordinates.of(model)
    key = "" if cache is None else cache.key(likelihood, model, tolerance, max_steps)
    entry = None if cache is None else cache.get(key)
    if entry is None:
        entry = _fit(likelihood, coordinates, tolerance, max_steps)
        if cache is not None:
            cache.add(key, entry)
    x = np.array(entry["x"])
    return Maximum(
        coordinates.model_at(x), coordinates, x, entry["value"], np.array(entry["information"]), entry["unexplained"],
        entry["converged"],
    )  # fmt: skip


def maximise_with_restarts(
    likelihood: EventTimes,
    model: Model,
    nominal: Model,
    *,
    tolerance: float,
    max_steps: int,
    cache: FitCache | None = None,
) -> Maximum:
    """As `maximise`, and again with the cutoffs that ran away from `nominal` put back, if any; the better of both.

    A cutoff far above all others leaves the likelihood flat: a fit that gets there by accident stays, though a better
    optimum lies where the pole belongs.  A neighbouring effect would then pass for a pole that the model has.  A
    photoreceptor's β is a cutoff, too.
    """
    end = maximise(likelihood, model, tolerance=tolerance, max_steps=max_steps, cache=cache)
    cutoffs = [name for name in end.coordinates.names if name.endswith("cutoff_hz") or name == "beta"]
    away = [
        name
        for name in cutoffs
        if name in nominal.values and abs(math.log(end.values[name] / nominal.values[name])) > RUNAWAY_LOG_FACTOR
    ]
    whole = [name for name in TWO_POLES if "beta" in away and name in end.coordinates.names]
    runaway = {name: nominal.values[name] for name in (*away, *whole)}
    if not runaway:
        return end
    again = maximise(likelihood, end.model.set(runaway), tolerance=tolerance, max_steps=max_steps, cache=cache)
    return again if again.value > end.value else end


def _fit(likelihood: EventTimes, coordinates: Coordinates, tolerance: float, max_steps: int) -> dict:
    objective = EventTimesObjective(likelihood, coordinates)
    end = newton.maximise(objective, coordinates.start, tolerance=tolerance, max_steps=max_steps)
    closer = narrower(coordinates.model_at(end.x), likelihood)
    if closer is not None:
        again = newton.maximise(objective, Coordinates.of(closer).start, tolerance=tolerance, max_steps=max_steps)
        end = again if again.local.value > end.local.value else end
    terms = objective.terms(end.x)
    return {
        "x": end.x.tolist(),
        "value": float(terms.total),
        "information": end.local.information.tolist(),
        "unexplained": int(terms.unexplained.sum()),
        "converged": bool(end.converged),
    }
