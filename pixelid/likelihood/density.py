"""The log-likelihood of event times (Low & Lee, ECCV 2024, for the pixel; docs/model.md for the derivation).

With z_k = sign · change(t_k) and rate r_k = dz/dt at event k, a threshold C_i of pixel i and polarity that is
drawn independently for each event with standard deviation s_k, the density of the event time is

    N(z_k; C_i, s_k²) · r_k · Φ((C_i' − m_k)/s')

the last factor being the chance that the other polarity's threshold C_i' stayed above the extreme m_k that
−z reached on the way.  (That t_k is the first crossing needs no factor: had an earlier z exceeded the threshold
drawn, z_k could not equal it.)  The interval that the end of the recording cuts off contributes the chance that
neither threshold was reached.

Where thresholds drift, C(t) = C (1 + d·t), z is the change over 1 + d·t, whose rate has a part −z·d/(1 + d·t).  Where
they remember the polarity before, C_i (1 + m p p'), z is the change over that factor f, too, and the noise of one draw,
which does not grow with it, is σ C_i/f in units of z.

s_k² = (σ C_i)² + q_k r_k² (tick²/12 + jitter²): threshold noise scales with the pixel's own threshold, and a
timestamp's width is noise in time (q_k: `EventTimes.weighed`).  Light that is only known at
samples adds to s_k² and changes r_k (`light_between_samples.py`).  For C_i in s_k stands its posterior mean under s_k²
with the population's C, known to a few tenths of a percent where a pixel has a hundred events.  (With the population's
C there, the scatter of events would pretend to identify the population's thresholds, and their intervals would be some
10 % too short.)

Pixel-to-pixel mismatch, C_i ~ N(C, τ²), is integrated out in closed form.  For a group (pixel, polarity) with
weights 1/s_k², W their sum and z̄ the weighted mean,

    ∫ Π N(z_k; C_i, s_k²) N(C_i; C, τ²) dC_i
        = Π N(z_k; z̄, s_k²) · √(2π/W) · N(z̄; C, τ² + 1/W).

The survival factors use the group's posterior mean and variance of C_i in place of C_i.

**Background events.**  A pixel also fires now and then for reasons no circuit explains.  Each polarity of each pixel
has a background of BACKGROUND_HZ; an event better explained by it (falling change, or a level many σ from its
threshold) contributes log BACKGROUND_HZ and says nothing about thresholds.  So a model that misses an effect pays a
bounded price per event it cannot explain, instead of distorting every parameter.  Under a true model one event in 10⁵
or fewer is called background.  Likewise a crossing goes missing with probability MISSED, which bounds the price of an
event that the model expects and the recording lacks.

**Lost events** (a share f of all): `losses.py`.

**Events at the end of a silence** (`dead_time_without_reset`): `density_release.py`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from pixelid.likelihood.density_backward import backward
from pixelid.likelihood.density_forward import EventTerms, GroupTerms, Numbers, forward
from pixelid.likelihood.density_release import Released, candidates, released
from pixelid.likelihood.layout import NOTHING, Layout, StackedChanges
from pixelid.likelihood.losses import BACKGROUND_HZ, NO_PULL, Losses, losses_of, missed_of
from pixelid.stages.circuit import Circuit
from pixelid.stages.comparator import drifts_to_zero

NUMBERS = (*Numbers._fields, "lost", "refractory")  # the dead time: after events that were lost


@dataclass(frozen=True)
class Gradient:
    """Derivatives of the log-likelihood: `by_changes`, and (10,) by the circuit's `NUMBERS`."""

    by_changes: StackedChanges
    by_numbers: np.ndarray


@dataclass(frozen=True, eq=False)
class Terms:
    """The pieces of the log-likelihood of a layout's events under one circuit.

    event, group: per event and per (pixel, polarity) group, see `density_forward.py`;  background: (n,) bool
    end: (m,) log survival of the unfinished intervals
    at_release: (n,) bool, events at the end of a silence; empty where pixels do not fall silent
    losses: what lost events make of it, None where none get lost
    """

    layout: Layout
    numbers: Numbers
    clock_share: np.ndarray
    changes: StackedChanges
    event: EventTerms
    background: np.ndarray
    group: GroupTerms
    end: np.ndarray
    losses: Losses | None = None
    at_release: np.ndarray = field(default_factory=lambda: NOTHING)

    @cached_property
    def total(self) -> float:
        """The log-likelihood; −∞ where thresholds drift to zero within the recordings, which no circuit's do."""
        drift = self.numbers.threshold_drift
        if drift < 0 and drifts_to_zero(drift, float(self.layout.last_time_s.max())):
            return -np.inf
        return float(self.event.term.sum() + self.group.term.sum() + self.end.sum())

    @property
    def at_once(self) -> np.ndarray:
        """(n,) events at the end of a silence, whose level lies beyond the threshold, not at it."""
        return self.at_release if len(self.at_release) else np.zeros(len(self.background), np.bool_)

    @property
    def unexplained(self) -> np.ndarray:
        """(n,) chance that nothing in the circuit explains an event: background events that no lost one preceded."""
        return self.background if self.losses is None else self.background * (1.0 - self.losses.after)

    @cached_property
    def per_pixel(self) -> np.ndarray:
        """(pixels,) its parts by pixel, which sum to the total."""
        at = self.layout
        events = sum_by(at.group, self.event.term, at.groups) + self.group.term
        return events.reshape(-1, 2).sum(axis=1) + sum_by(at.last_pixel, self.end, at.pixels)

    @cached_property
    def per_recording(self) -> np.ndarray:
        """(recordings,) its parts given the thresholds' posterior; what is left of the total is the thresholds' own."""
        at = self.layout
        events = sum_by(at.recording, self.event.term, at.recordings)
        return events + sum_by(at.last_recording, self.end, at.recordings)

    @property
    def z(self) -> np.ndarray:
        """(n,) level at the event; 0 where the circuit cannot have fired."""
        return self.event.level

    @cached_property
    def log_rate(self) -> np.ndarray:
        """(n,) log of the level's rate of change [1/s]; 0 where the circuit cannot have fired."""
        return np.log(self.event.rate)

    @cached_property
    def scale(self) -> np.ndarray:
        """(n,) standard deviation of the level about its group's threshold."""
        return np.sqrt(self.event.variance)

    @property
    def reached(self) -> np.ndarray:
        """(n,) extreme that the other polarity's level had reached before the event."""
        return self.event.reached

    @property
    def centre(self) -> np.ndarray:
        """(g,) mean threshold of the population."""
        return self.group.centre

    @property
    def weight_sum(self) -> np.ndarray:
        """(g,) sum of the events' 1/scale²."""
        return self.group.W

    @property
    def weighted_mean(self) -> np.ndarray:
        """(g,) mean level weighted by 1/scale²; 0 without events."""
        return self.group.weighted_mean

    @cached_property
    def mean_variance(self) -> np.ndarray:
        """(g,) variance of `weighted_mean` about `centre`, of one more unit where there are no events."""
        return self.group.spread + 1.0 / np.where(self.weight_sum > 0, self.weight_sum, 1.0)

    @property
    def group_mean(self) -> np.ndarray:
        """(g,) mean of each group's threshold given its events."""
        return self.group.mean

    @property
    def group_variance(self) -> np.ndarray:
        """(g,) its variance."""
        return self.group.variance

    @cached_property
    def released(self) -> Released:
        """The events at the end of a silence, as `density_release` wants them."""
        return released(np.flatnonzero(self.at_release), self.layout, self.changes.events, self.numbers)

    def gradient(self) -> Gradient:
        """The derivatives of the total by everything it was made of."""
        at = self.layout
        by_changes = at.stacked(np.empty(at.size))
        by_numbers = np.zeros(len(NUMBERS))
        lost = 0.0 if self.losses is None else self.losses.fraction
        backward(
            at.sign, at.alike, at.group, at.time_s, self.clock_share, at.last_pixel, at.last_time_s, at.last_sign,
            self.changes.events, self.changes.ends, self.numbers, missed_of(lost), at.light, at.light_reset,
            at.light_last, self.event, self.group, self.released, NO_PULL if self.losses is None else self.losses.pull,
            by_changes.events, by_changes.ends, by_numbers[: len(Numbers._fields)],
        )  # fmt: skip
        if self.losses is not None:
            by_numbers[-2:] = self.losses.slope, self.losses.by_dead_time
            by_numbers[Numbers._fields.index("polarity_memory")] += self.losses.by_memory
        return Gradient(by_changes, by_numbers)


def density(layout: Layout, circuit: Circuit, changes: StackedChanges, clock_share: np.ndarray) -> Terms:
    """The density of a layout's events under a circuit and its changes.

    Args:
        layout: n intervals with an event at their end, m without, in g groups.
        circuit: Of real values; only its `NUMBERS` are looked at.
        changes: The circuit's changes.
        clock_share: (n,) how often timestamp noise counts, see `EventTimes.weighed`.
    """
    numbers = Numbers(*(float(getattr(circuit, name)) for name in Numbers._fields))
    lost = float(circuit.lost)
    n = layout.events
    event = EventTerms(*np.empty((len(EventTerms._fields), n)))
    group = GroupTerms(*np.empty((len(GroupTerms._fields), layout.groups)))
    background, end = np.empty(n, np.bool_), np.empty(layout.ends)
    which = candidates(layout, changes.events, numbers)
    forward(
        layout.sign, layout.alike, layout.group, layout.time_s, layout.tick_s, clock_share, layout.last_pixel,
        layout.last_time_s, layout.last_sign, changes.events, changes.ends, numbers, BACKGROUND_HZ, missed_of(lost),
        (layout.light, layout.light_reset, layout.light_last), released(which, layout, changes.events, numbers),
        event, np.empty(n, np.bool_), background, group, end,
    )  # fmt: skip
    at_release = NOTHING
    if numbers.silent > 0.0:
        at_release = np.zeros(n, np.bool_)
        at_release[which] = ~background[which]
    losses = None
    if lost > 0.0:
        losses = losses_of(layout, circuit, numbers, event, background, group, end)
        event.term[:] += losses.gain
    return Terms(layout, numbers, clock_share, changes, event, background, group, end, losses, at_release)


def sum_by(index: np.ndarray, values: np.ndarray, size: int) -> np.ndarray:
    """(size,) sums of `values` by index."""
    return np.bincount(index, values, size)
