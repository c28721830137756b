"""What the training events look like under a fitted model: residuals, their maps, and how sure it is that they err."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from scipy.stats import poisson

from pixelid.fit.maximise import Maximum
from pixelid.gap.criteria import Criteria
from pixelid.gap.detect.covariates import Factor, sort_events
from pixelid.gap.detect.maps import Maps, map_residuals
from pixelid.gap.detect.residuals import Residuals, residuals, tangents
from pixelid.likelihood.event_times import EventTimes


@dataclass(frozen=True)
class Diagnostics:
    """What a fitted model leaves of its training events.

    Attributes:
        residual: (n,) of every event.
        factors: Ways to sort the events into cells.
        maps: Where residuals leave zero.
        p: Chance of the whole, maps and background events, under a true model.
        allowed: Of the events that a true model may leave without a cause; None: they did not count.
    """

    residual: Residuals
    factors: tuple[Factor, ...]
    maps: Maps
    p: float
    allowed: float | None = None

    @property
    def background_fraction(self) -> float:
        """Of the events, those without a cause in the model."""
        return float(self.residual.background.mean())

    def has_excess_background(self, allowed: float, chance: float) -> bool:
        """Whether so many events without a cause are less likely than `chance`, where a share is `allowed`."""
        background = self.residual.background
        return chance_of_background(int(background.sum()), allowed * len(background)) < chance


def diagnose(
    likelihood: EventTimes,
    fit: Maximum,
    criteria: Criteria,
    seed: int,
    *,
    background_fraction: float | None,
    like: Sequence[Factor] = (),
) -> Diagnostics:
    """Residuals and maps of a likelihood's events under a fitted model.

    Args:
        likelihood: Of the events.
        fit: The model.
        criteria: What the maps are judged by.
        seed: Of the signs flipped.
        background_fraction: Of the events that a true model may leave without a cause; None: they do not count.
        like: Of other diagnostics, whose cells the maps shall have.
    """
    circuit = fit.model.circuit()
    here = residuals(likelihood, circuit)
    tangent = tangents(likelihood, fit.coordinates, fit.x, here)
    factors = tuple(sort_events(likelihood, circuit, here, like=like))
    maps = map_residuals(likelihood, here, tangent, factors, criteria, seed)
    p_background = 1.0
    if background_fraction is not None:
        allowed = background_fraction + circuit.lost  # what follows a lost event
        p_background = chance_of_background(maps.background, allowed * likelihood.events)
    significant = p_background < criteria.max_p_unexplained
    p = min(maps.p, p_background) if significant else maps.p
    return Diagnostics(here, factors, maps, p, background_fraction)


def chance_of_background(events: int, expected: float) -> float:
    """Poisson chance of so many background events or more; 1 of none."""
    return float(poisson.sf(events - 1, expected)) if events else 1.0
