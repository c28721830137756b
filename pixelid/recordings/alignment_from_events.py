"""Where the light's time zero lies on the camera's clock, from the events themselves.

1. Signed events per bin are correlated with d ln L/dt over all offsets; the highest peaks are candidates.
2. They are refined by least squares on the changes between events (`alignment_filter.py`), with the best of filters.
3. The best refinement's filter is held against all offsets; where else the events follow the light, rivals are refined.
4. The best is compared with each rival, on the changes that lie within the light at both offsets, and with no light at
   all (`alignment_evidence.py`).

Errors are those of a least-squares estimate whose residuals are correlated within blocks of time (sandwich covariance,
Liang & Zeger 1986, Biometrika 73, 13).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.alignment_evidence import ENOUGH_NATS, evidence_nats
from pixelid.recordings.alignment_filter import (
    RATE_BOUND,
    SHIFT_S,
    SOFT,
    Changes,
    LogLight,
    Refined,
    downhill,
    hold,
    refine,
    soft_loss,
    within,
)
from pixelid.recordings.alignment_search import (
    LEAST_COMMON,
    MOST_BINS,
    NEAR_S,
    WIDEST_BIN_S,
    best_offsets,
    changes_of,
    is_too_long,
    lights_of,
    optima,
    stretches,
)
from pixelid.recordings.clocks import CRYSTAL, Alignment, ClockPrior
from pixelid.recordings.recording import Recording
from pixelid.statistics import Z95
from pixelid.stimuli.pixel_lights import Light

LEAST_CHANGES = 50
LEAST_INSIDE = 0.3  # of the changes within the light: with fewer, a few edges of another light may fit
FORM = 0.03  # thresholds: leak, dark current and the like shift events so that a block shares it
# The loss of a change is 0.002 where a filter explains the events, 0.22 where it explains nothing; searches that end in
# a wrong place leave 0.02 to 0.22.  A third of the events may be noise.
LARGEST_LOSS = 0.075


@dataclass(frozen=True)
class Rival:
    """Another offset: s of the camera's clock;  nats by which it is worse;  share of the changes in the light there."""

    offset_s: float
    nats: float
    inside: float


@dataclass(frozen=True)
class EventAlignment:
    """What events say of the offset and of the clocks' rate, without any prior of the latter.

    offset_s: of the light's time zero;  rate_error: see `Alignment`;  covariance: (2, 2) of both
    nats: by which the light at this offset explains the events better than no light does
    loss: mean of a change within the light;  inside: share of the changes within the light;  rivals: other offsets
    profile: (2, k) lags (s) from this offset at the events' middle, and mean loss there
    middle_s: the events' middle on the light's clock
    """

    offset_s: float
    rate_error: float
    covariance: np.ndarray
    nats: float
    loss: float
    inside: float
    rivals: tuple[Rival, ...]
    profile: np.ndarray
    middle_s: float

    @property
    def follows(self) -> bool:
        """Whether the events follow this light at all."""
        return self.loss <= LARGEST_LOSS and self.nats >= ENOUGH_NATS and self.inside >= LEAST_INSIDE

    @property
    def loss_of_all(self) -> float:
        """Mean loss of all changes, those outside of the light unexplained."""
        return self.inside * self.loss + (1.0 - self.inside) * float(soft_loss(np.ones(1))[0])

    @property
    def equal_rivals(self) -> tuple[Rival, ...]:
        """The rivals that the events do not exclude."""
        return tuple(rival for rival in self.rivals if rival.nats < ENOUGH_NATS)

    def sd_at(self, light_s: float) -> float:
        """Standard error of the camera's time at a moment of the light."""
        at = np.array([1.0, light_s])
        return float(np.sqrt(max(at @ self.covariance @ at, 0.0)))

    def with_rate(self, mean: float, sd: float) -> EventAlignment:
        """The same after a Gaussian prior of the clock rate error."""
        gain = self.covariance[:, 1] / (self.covariance[1, 1] + sd**2)
        moved = np.array([self.offset_s, self.rate_error]) + gain * (mean - self.rate_error)
        covariance = self.covariance - np.outer(gain, self.covariance[1])
        return replace(self, offset_s=float(moved[0]), rate_error=float(moved[1]), covariance=covariance)


def alignment_from_events(recording: Recording, light: Light) -> Alignment:
    """Where the light's time zero lies on the camera's clock, from events against changes of the light.

    Raises:
        InputError: constant light, too few events, no offset that they follow, and two as good as each other.
    """
    events = align_events(recording, light)
    if not events.follows:
        raise InputError(
            f"{recording.name}: --align auto: the events do not follow this light closely enough at any offset to say "
            "where it starts; give --align SECONDS, or record a trigger"
        )
    if events.equal_rivals:
        offsets = [events.offset_s, events.equal_rivals[0].offset_s]
        starts = " or at ".join(f"{offset + light.start_s:.6f}" for offset in offsets)
        raise InputError(
            f"{recording.name}: --align auto: the light may start at {starts} s of the camera's clock, and the events "
            f"cannot say which; give --align {' or '.join(f'{offset:.6f}' for offset in offsets)}, or record a trigger"
        )
    return alignment_of(events.with_rate(0.0, CRYSTAL), light)


def alignment_of(events: EventAlignment, light: Light) -> Alignment:
    """The alignment that events alone give."""
    half, rate_half = Z95 * events.sd_at(0.0), Z95 * float(np.sqrt(max(events.covariance[1, 1], 0.0)))
    return Alignment(
        events.offset_s,
        "auto",
        (events.offset_s - half, events.offset_s + half),
        events.rate_error,
        (events.rate_error - rate_half, events.rate_error + rate_half),
        ClockPrior(0.5 * (light.start_s + light.end_s), light.duration_s, None, 0.0, CRYSTAL),
        events.offset_s + (1.0 + events.rate_error) * light.start_s,
        Z95 * events.sd_at(light.start_s),
    )


def align_events(recording: Recording, light: Light, polarity: int = 1) -> EventAlignment:
    """The offset at which events follow the light best, its error, and how much better it is than others.

    Args:
        polarity: −1 for a recording whose ON and OFF are exchanged.

    Raises:
        InputError: constant light, too few events, and spans too long to search.
    """
    if is_too_long(recording, light):
        raise InputError(
            f"{recording.name}: --align auto: expected events and light of {MOST_BINS * WIDEST_BIN_S:.0f} s together, "
            f"found {recording.events.duration_s:.0f} s and {light.duration_s:.0f} s; give --align SECONDS, or a part "
            "of both"
        )
    recording, lights, of_pixel = lights_of(recording, light)
    changes = changes_of(recording, of_pixel, polarity)
    compared = 3_000  # by which offsets are compared
    few = stretches(changes, compared)
    if len(few.time) < LEAST_CHANGES:
        raise InputError(
            f"{recording.name}: --align auto: expected at least {LEAST_CHANGES} events that follow one of their pixel"
        )
    coarse = LogLight.of(lights, 1)
    fits, profile = optima(few, coarse, best_offsets(recording, lights, of_pixel, polarity)[0] - few.origin_s)
    best = min(fits, key=lambda fit: fit.cost)
    most_changes = 20_000  # of the final refinement: errors of microseconds
    many = stretches(changes, most_changes)
    covered = within(many, coarse, best, few.middle_s)
    inside = float(covered.mean())
    many = many.select(covered) if inside >= LEAST_INSIDE else many
    zero = best.zero_s + RATE_BOUND * float(best.x[1]) * (many.middle_s - few.middle_s)
    start = np.concatenate([[0.0], best.x[1:]])
    # Samples of the filter per sample of the light: with one, a chirp to 1500 Hz at 50 µs is found 47 µs late
    finer = 4
    final = refine(many, LogLight.of(lights, finer), zero, start, start[2:6], 30, 1e-6)
    offset, rate, covariance = _estimate(many, final)
    rivals, spread = _rivals(few, coarse, fits, best, float(np.sqrt(covariance[0, 0])))
    covariance[0, 0] += spread**2
    middle = many.middle_s - final.zero_s
    turn = np.array([[1.0, -middle], [0.0, 1.0]])  # to the light's time zero, which may be far away
    return EventAlignment(
        offset_s=many.origin_s + offset,
        rate_error=rate,
        covariance=turn @ covariance @ turn.T,
        nats=evidence_nats(many.time, final.residuals, np.full(len(final.residuals), -1.0)),
        loss=final.cost,
        inside=inside,
        rivals=tuple(replace(rival, offset_s=many.origin_s + offset + rival.offset_s) for rival in rivals),
        profile=profile,
        middle_s=middle,
    )


def _rivals(
    changes: Changes, light: LogLight, fits: list[Refined], best: Refined, sd_s: float
) -> tuple[list[Rival], float]:
    """(other optima, `offset_s` from the best; the widest lag of those within `NEAR_S` that are as good)."""
    inside = within(changes, light, best)
    rivals, spread = [], 0.0
    for fit in fits:
        lag = fit.zero_s - best.zero_s
        if abs(lag) < 2.0 * sd_s or downhill(changes, light, fit, best):
            continue
        mine = within(changes, light, fit)
        common = inside & mine
        if common.sum() < LEAST_COMMON * inside.sum():
            common[:] = True
        nats = evidence_nats(changes.time[common], best.residuals[common], fit.residuals[common])
        if nats < ENOUGH_NATS and abs(lag) < NEAR_S:
            spread = max(spread, abs(lag))
        else:
            rivals.append(Rival(lag, nats, float(mine.mean())))
    return sorted(rivals, key=lambda rival: rival.nats), spread


def _estimate(changes: Changes, fit: Refined) -> tuple[float, float, np.ndarray]:
    """(light's time zero from `origin_s`, rate error, covariance (2, 2) of both at the changes' middle)."""
    r, jacobian = fit.residuals, fit.jacobian
    weight = 1.0 / np.sqrt(1.0 + (r / SOFT) ** 2)
    time, lasting = changes.time, float(np.ptp(changes.time))
    blocks = 24  # of time, whose residuals count as independent
    block = np.minimum((blocks * (time - time.min()) / lasting).astype(int), blocks - 1)
    scores = np.zeros((blocks, 9))
    np.add.at(scores, block, jacobian * (weight * r)[:, None])
    curvature, meat = jacobian.T @ (jacobian * weight[:, None]), scores.T @ scores
    held = np.zeros(9)
    held[2:6] = hold(len(r)) ** 2
    curvature += np.diag(held)
    meat += np.diag(held**2)  # the centre may be an e-fold off
    shared = np.zeros((blocks, 9))
    np.add.at(shared, block, jacobian * weight[:, None])
    meat += FORM**2 * shared.T @ shared  # what no filter of this form describes, common to a block
    scale = 1.0 / np.sqrt(np.maximum(np.diag(curvature), 1e-30))
    bread = np.linalg.pinv(curvature * np.outer(scale, scale), rcond=1e-9, hermitian=True) * np.outer(scale, scale)
    units = np.array([SHIFT_S, RATE_BOUND])
    covariance = (bread @ meat @ bread)[:2, :2] * np.outer(units, units)
    # All time constants longer by a share: what shift does the same?
    slower = jacobian[:, 2:6] @ np.array([-2.0, -1.0, -1.0, -1.0])
    late = jacobian[:, 0] * weight
    delay = SHIFT_S * float(late @ slower) / max(float(late @ jacobian[:, 0]), 1e-30)
    # Of the filter's own lag: how well its form describes a pixel; tests/statistical/test_alignment.py
    lag_known = 0.03
    unknown = (lag_known * delay) ** 2
    information = jacobian[:, 0] * late
    centre = float(information @ time) / max(float(information.sum()), 1e-30)
    spread = float(information @ (time - centre) ** 2) / max(float(information.sum()), 1e-30)
    varies = unknown / max(12.0 * spread, 1e-30)  # it may differ as much between begin and end
    fast_pole_s = 1e-5  # lag of a pole too fast for the filter to know (a differencing amplifier's, 16 kHz)
    covariance += np.diag([fast_pole_s**2 + unknown, varies])
    # light time τ of an event at t: τ = (1 − rate) t − zero + rate · middle
    rate = RATE_BOUND * float(fit.x[1])
    return (fit.zero_s - rate * changes.middle_s) / (1.0 - rate), 1.0 / (1.0 - rate) - 1.0, covariance
