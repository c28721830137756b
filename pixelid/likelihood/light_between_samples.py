"""What is not known of a light that was only sampled: its course between two samples, integrated out.

Between two samples log radiance is taken as a Brownian bridge of variance v over the gap, whatever the gap's length: a
sensor that measures its light after every event has about one threshold of change in each.  At a fraction w of the gap
the path is normal about the straight line with variance v w (1 − w); the change from a release in the same gap, at w_r,
with v (w − w_r)(1 − w + w_r).

An event is a first passage of that path.  For a path that began at a, a time τ ago, the density of the first passage of
c is (c − a)/τ times the density of being at c (Karatzas & Shreve, Brownian Motion and Stochastic Calculus, 2.8).  With
Y = c − a ~ N(m, B) on the line, m = r τ and r the line's rate, the density of an event's time with a threshold C of
noise s² is therefore

    ∫ N(c; C, s²) · (c − a)⁺/τ · N(c − a; m, B) dc ≈ N(E c; C, s² + var c) · E[Y⁺]/τ,

c under its density weighted by Y⁺.  With x = m/√B, φ and Φ the normal density and its integral,

    E[Y⁺] = √B g₁,   E c = a + √B g₂/g₁,   var c = B (g₃/g₁ − (g₂/g₁)²),
    g₁ = x Φ + φ,   g₂ = (x² + 1) Φ + x φ,   g₃ = (x³ + 3x) Φ + (x² + 2) φ:

the light was further at the event than the line says, by `First.shift`.  v and s² are estimated by events and samples
together, beforehand (`told`).  How far the line may still be off is `fit/measured_light.py`'s to say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import ndtr

from pixelid.likelihood.layout import Layout, StackedChanges, read_only
from pixelid.likelihood.losses import BACKGROUND_HZ
from pixelid.likelihood.sections import Section, sections_of
from pixelid.recordings.recording import Recording
from pixelid.recordings.sensor_light import is_measured

BETWEEN = "light_between_samples"  # attribute of a recording: what `told` found of all its pixels
STARTS = (0.5, 0.005)  # of v in squared thresholds, a rough light and a smooth one
FAR = -5.0  # x, from which it seldom leaves it


class First(NamedTuple):
    """(n,) of the light at first passages: how much further than the line, its variance, and the speed E[Y⁺]/τ."""

    shift: np.ndarray
    variance: np.ndarray
    speed: np.ndarray


class Gaps(NamedTuple):
    """(n,) of the light at events: line's level and rate, τ, and variances about the line if v were 1.

    own: of the path since τ ago;  reset: at the release, where another gap holds it
    ahead: how much further than the line at the event the next sample is
    """

    level: np.ndarray
    rate: np.ndarray
    since_s: np.ndarray
    own: np.ndarray
    reset: np.ndarray
    ahead: np.ndarray


class Told(NamedTuple):
    """What events and samples say of the light between: v, and s² of the levels' other noise, in log radiance."""

    variance: float
    noise: float


@dataclass(frozen=True)
class UnknownLight:
    """What is not known of the light of the n events of several recordings.

    events: (n,) bool, whose light was measured at samples;  first: of these;  reset: of these, variance at the release
    ahead: of these, how much further than the line at the event the next sample is
    last: (m,) variance of the changes of unfinished intervals
    """

    events: np.ndarray
    first: First
    reset: np.ndarray
    ahead: np.ndarray
    last: np.ndarray

    def added(self, layout: Layout) -> Layout:
        """The layout with the variances that the light adds."""
        level, reset = np.zeros((2, layout.events))
        level[self.events], reset[self.events] = self.first.variance + self.reset, self.reset
        return replace(layout, light=read_only(level), light_reset=read_only(reset), light_last=read_only(self.last))

    def apply(self, changes: StackedChanges, sign: np.ndarray, among: np.ndarray | None = None) -> None:
        """Changes at first passages, and their speed for the slope; of the events `among` (n,) only."""
        k, mine = np.flatnonzero(self.events), slice(None)
        if among is not None:
            mine = among[k]
            k = k[mine]
        changes.events.change[k] += sign[k] * self.first.shift[mine]
        changes.events.slope[k] = sign[k] * self.first.speed[mine]


def first_passage(rate: np.ndarray, since_s: np.ndarray, variance: np.ndarray) -> First:
    """Of paths with a line's rate (n,) [1/s], begun since_s (n,) ago, of variance (n,) about the line now."""
    spread = np.sqrt(np.maximum(variance, 1e-12))
    away = rate * since_s / spread
    certain = 30.0  # x, from which the path never falls back to its beginning
    x = np.clip(away, -certain, certain)
    below, density = ndtr(x), np.exp(-0.5 * x * x) / np.sqrt(2.0 * np.pi)
    first, second = x * below + density, (x * x + 1.0) * below + x * density
    third = (x**3 + 3.0 * x) * below + (x * x + 2.0) * density
    with np.errstate(invalid="ignore", divide="ignore"):
        mean, square = second / first, third / first
    far = x < FAR  # digits are lost: Y given Y > 0, weighted by itself, is a gamma of shape 2 and rate −x
    low = np.minimum(x, FAR)
    mean, square = np.where(far, -2.0 / low, mean), np.where(far, 6.0 / low**2, square)
    first = np.where(far, density / np.maximum(x * x, 1.0), first)
    sure, small = x >= certain, 1.0 / np.maximum(away, certain)  # Y is above 0 for sure: E Y² / E Y = m + B/m
    return First(
        spread * np.where(sure, small, mean - x),
        spread**2 * np.where(sure, 1.0 - small**2, np.clip(square - mean**2, 0.0, 1.0)),
        np.where(sure, rate, spread * first / since_s),
    )


def gaps_of(section: Section) -> Gaps:
    """Where in the gaps of its light each event of a section lies, and what the straight line says there."""
    of, iv = section.light, section.intervals
    begin = np.concatenate([[0], np.cumsum([len(light.t) for light in section.lights])])
    t = np.concatenate([light.t for light in section.lights])
    u = np.log(np.concatenate([light.radiance for light in section.lights]))
    zero, span = float(t.min()), float(np.ptp(t)) + 1.0
    keys = t - zero + span * np.repeat(np.arange(len(section.lights)), np.diff(begin))
    last = begin[of + 1] - 2

    def place(when: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(gap, fraction of it, variance about its line); before the first measurement and after the last: open."""
        k = np.clip(np.searchsorted(keys, when - zero + span * of, side="right") - 1, begin[of], last)
        w = np.clip((when - t[k]) / (t[k + 1] - t[k]), 0.0, 1.0)
        return k, w, np.where(k == begin[of], 1.0 - w, np.where(k == last, w, w * (1.0 - w)))

    (at, w, now), (at_reset, w_reset, then) = place(iv.time_s), place(iv.previous_s)
    one, moved = at == at_reset, np.maximum(w - w_reset, 0.0)
    open_ended = (at == begin[of]) | (at == last)
    within = np.where(open_ended, moved, moved * (1.0 - moved))
    rate = (u[at + 1] - u[at]) / (t[at + 1] - t[at])
    level = u[at] + w * (u[at + 1] - u[at]) - u[at_reset] - w_reset * (u[at_reset + 1] - u[at_reset])
    since = np.maximum(iv.time_s - np.maximum(t[at], iv.previous_s), iv.tick_s)
    own, reset = np.where(one, within, now), np.where(one, 0.0, then)
    ahead = rate * np.maximum(t[at + 1] - iv.time_s, 0.0)
    return Gaps(iv.sign * level, iv.sign * rate, since, own, reset, iv.sign * ahead)


def _together(parts: Sequence[Gaps]) -> Gaps:
    return Gaps(*(np.concatenate(rows) for rows in zip(*parts, strict=True)))


def told(recording: Recording) -> Told | None:
    """v and s² that explain a recording's events best, if its light was measured at samples; None for other light.

    Of a pixel without poles, whose change is that of the light itself; thresholds ON and OFF, v and s are maximised.
    """
    if not is_measured(recording):
        return None
    if BETWEEN in recording.attributes:
        return Told(**recording.attributes[BETWEEN])
    intervals, sections = sections_of(recording)
    least_noise = 0.02  # of a threshold, s/C at least: no sensor is known below
    if len(intervals) < len(STARTS) + 2:
        return Told(0.0, least_noise**2)
    gaps, on = _together([gaps_of(section) for section in sections]), intervals.sign > 0
    most_telling = 20_000  # events that tell v and s²: enough for 1 % of them
    every = slice(None, None, max(len(on) // most_telling, 1))
    gaps, on = Gaps(*(row[every] for row in gaps)), on[every]
    usual = max(float(np.median(np.abs(gaps.level))), 1e-3)

    def loss(x: np.ndarray) -> float:
        low, high, noise, v = np.exp(np.clip(x, -30.0, 10.0))
        threshold = usual * np.where(on, high, low)
        first = first_passage(gaps.rate, gaps.since_s, v * usual**2 * gaps.own)
        total = first.variance + v * usual**2 * gaps.reset + (max(noise, least_noise) * threshold) ** 2
        away = threshold - gaps.level - first.shift
        terms = np.log(np.maximum(first.speed, 1e-300)) - 0.5 * (away**2 / total + np.log(2.0 * np.pi * total))
        return -float(np.logaddexp(terms, np.log(BACKGROUND_HZ)).sum())

    begins = [np.log([1.0, 1.0, 0.2, v]) for v in STARTS]
    ends = [minimize(loss, x, method="Nelder-Mead", options={"maxfev": 800, "xatol": 1e-3}) for x in begins]
    low, high, noise, v = np.exp(np.clip(min(ends, key=lambda end: end.fun).x, -30.0, 10.0))
    return Told(float(v) * usual**2, float(max(noise, least_noise) * usual * np.sqrt(low * high)) ** 2)


def with_told(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings with what all their pixels show of the light between samples, so that some of them know it too."""
    return [
        r if (found := told(r)) is None else replace(r, attributes={**r.attributes, BETWEEN: found._asdict()})
        for r in recordings
    ]


def unknown_light(recordings: Sequence[Recording], sections: Sequence[Sequence[Section]]) -> UnknownLight | None:
    """What is not known of the light of recordings that are divided into these sections; None: all of it is known."""
    if not any(map(is_measured, recordings)):
        return None
    measured, parts, resets, aheads, lasts = [], [], [], [], []
    for recording, some in zip(recordings, sections, strict=True):
        found = told(recording)
        events, ends = (sum(len(getattr(s, f)) for s in some) for f in ("light", "last_light"))
        measured.append(np.full(events, found is not None))
        lasts.append(np.full(ends, 0.0 if found is None else found.variance))
        if found is not None and some:
            gaps = _together([gaps_of(section) for section in some])
            parts.append(first_passage(gaps.rate, gaps.since_s, found.variance * gaps.own))
            resets.append(found.variance * gaps.reset)
            aheads.append(gaps.ahead)
    first = First(*(np.concatenate(rows) for rows in zip(*parts, strict=True)))
    return UnknownLight(np.concatenate(measured), first, *map(np.concatenate, (resets, aheads, lasts)))
