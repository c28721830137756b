"""Recordings as they would be with a perfect readout: true times drawn under the model, stage by stage.

Behind a queue or a tick, first only recordings whose windows are short, until thresholds and their noise settle; then
those with longer windows, whose times first follow the model so found.  Filters are held near the model's values by a
wide prior meanwhile.  A recording whose events mostly waited for far longer (a saturated readout) has lost its times:
it is left out.  Behind a jitter all are drawn at once, and its spread is estimated with them.  A model that gains an
effect later moves the times behind it: they are drawn `again`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pixelid.fit.starts import feasible
from pixelid.gap.climb import Climbed, climbed
from pixelid.gap.latent import (
    Windows,
    beginning,
    drawn,
    exchanged,
    jitter_windows,
    queue_windows,
    ranked,
    spaced,
    spread,
    tick_windows,
    with_times,
)
from pixelid.gap.readout import Fingerprint
from pixelid.gap.workbench import finer
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.parameters.parameter import Prior
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import few
from pixelid.stimuli.stimulus import Stimulus

SHORT, LONG = 20.0, 200.0  # of the service time: windows (9 of 10) of the first stage, and of the second
SCOUT_EVENTS = 6_000  # events of the pixels that a first fit looks at
SWEEPS = (20, 8, 8)  # rounds of draws and refits in each stage, the last with exact draws
REDRAWN = 24  # rounds, with exact draws, after the model has gained an effect
SETTLING = 60  # draws without refits before the second stage
JITTER, SIGMA = "timestamp_jitter", "timestamp_jitter.sigma_s"
SETTLED = 8  # draws before the first refit behind a jitter
JITTER_ROUNDS = (12, 12, 24)  # with the thresholds' noise held, then free, then with exact draws
LEAP, FARTHER = 6, 3.0  # rounds after which the model goes on by itself, and how much farther than in their last half
FEWEST, ASIDE, UNEVEN = 300, 0.5, 0.25  # events; of a jitter's spread: means, and differences of spread, it may have
NOISE, FAST = "threshold_sigma", ("sf_cutoff_hz", "diff_cutoff_hz")
WIDTH = 0.5  # standard deviation of the prior on log filters
FILTERS = ("alpha", "beta", "gamma", "alpha_over_beta", "sf_cutoff_hz", "diff_cutoff_hz")
TORN = 0.01  # share of a recording's events without a cause from which on its times count as lost
FINEST_S = 5e-6  # a tick finer than this is a width of the density, not a window


@dataclass
class Restored:
    """Recordings at true times, which can be drawn again when more is known of the model behind them.

    effect: what the readout did;  stimuli: as they came;  fine: the recordings as stamped, their stimuli as a fit reads
    them;  windows, times: per recording (`latent.py`);  reins: priors of filters meanwhile
    lost: names of recordings left out;  error: relative, of a jitter's spread
    scatter: by parameter, by how much its coordinate differs between draws of the times (standard deviation)
    """

    effect: str
    stimuli: tuple[Stimulus | None, ...]
    fine: list[Recording]
    windows: list[Windows]
    times: list[np.ndarray]
    rng: np.random.Generator
    report: Callable[[str], None]
    reins: dict[str, Prior]
    lost: tuple[str, ...] = ()
    error: float = 0.0
    scatter: dict[str, float] = field(default_factory=dict)

    @property
    def recordings(self) -> list[Recording]:
        """At the times drawn last, with the stimuli they came with."""
        made = with_times(self.fine, self.times) if self.windows else self.fine
        return [replace(r, stimulus=stimulus) for r, stimulus in zip(made, self.stimuli, strict=True)]

    @property
    def sigma_s(self) -> float:
        """The jitter's standard deviation."""
        return 1e-9 * self.windows[0].sd

    def again(self, model: Model, rounds: int = REDRAWN, exact: bool = True) -> Model:
        """Draw times and refit the model in turns; the model so found."""
        if not self.windows:
            return model
        model, ends = self.reined(model), []
        for turn in range(rounds):
            self.report("true times")
            for _ in range(2):
                self.draw(model, exact=exact)
            ends.append(climbed(EventTimes(with_times(self.fine, self.times)), model, tolerance=0.5, max_steps=4))
            model = ends[-1].model
            if self.effect == JITTER and turn % LEAP == LEAP - 1 and turn < rounds - 1:
                model = _leapt(ends[-LEAP:])
        scatter = np.std([end.x for end in ends[rounds // 2 :]], axis=0)
        self.scatter = dict(zip(ends[-1].coordinates.names, scatter.tolist(), strict=True))
        return model

    def uneven(self) -> bool:
        """Whether the jitter differs between recordings or polarities by more than the drawing of times can.

        A common normal is what it should be; a delay of one polarity, say, is not.
        """
        for recording, window, t in zip(self.fine, self.windows, self.times, strict=True):
            assert window.stamp is not None
            late = (window.stamp - t) / window.sd
            for some in (late[recording.events.p == polarity] for polarity in (0, 1)):
                if len(some) >= FEWEST and (abs(some.mean()) > ASIDE or abs(some.std() - 1.0) > UNEVEN):
                    return True
        return False

    def reined(self, model: Model) -> Model:
        """The model with the priors on its free filters."""
        parameters = {
            name: replace(p, prior=self.reins[name]) if p.free and name in self.reins else p
            for name, p in model.parameters.items()
        }
        return replace(model, parameters=parameters)

    def only(self, kept: np.ndarray) -> None:
        """Leave recordings out: kept (recordings,) bool."""
        self.lost += tuple(r.name for r, stays in zip(self.fine, kept, strict=True) if not stays)
        self.stimuli = tuple(stimulus for stimulus, stays in zip(self.stimuli, kept, strict=True) if stays)
        self.fine = [r for r, stays in zip(self.fine, kept, strict=True) if stays]
        self.windows = [w for w, stays in zip(self.windows, kept, strict=True) if stays]
        self.times = [t for t, stays in zip(self.times, kept, strict=True) if stays]

    def draw(self, model: Model, estimate: bool = True, exact: bool = False) -> None:
        """Draw all times once, and estimate the jitter from them."""
        draw = drawn(self.fine, self.windows, self.times, model, self.rng, exact)
        self.times = draw.times
        if self.effect == JITTER:
            self.windows = exchanged(self.fine, self.windows, self.times, self.rng)
            if estimate:
                sd, self.error = spread(draw, self.windows[0].sd)
                self.windows = [replace(w, sd=sd) for w in self.windows]


def restored(
    recordings: Sequence[Recording],
    found: Fingerprint,
    model: Model,
    seed: int,
    report: Callable[[str], None] = lambda what: None,
) -> Restored:
    """The recordings without what the fingerprint says the readout did to their times."""
    rng = np.random.default_rng(seed)
    stimuli = tuple(r.stimulus for r in recordings)
    if found.effect == "timestamp_quantisation" and found.value < FINEST_S:
        return Restored(found.effect, stimuli, [_ticked(r, found.value) for r in recordings], [], [], rng, report, {})
    fine = [finer(r, "smooth") for r in recordings]
    if found.effect == "timestamp_quantisation":
        windows = [tick_windows(r, found.value) for r in recordings]
    else:
        windows = [queue_windows(r, found.value) for r in recordings]
    reach = np.array([np.quantile(w.hi - w.lo, 0.9) if len(w.hi) else 0.0 for w in windows])
    unit = 1e9 * found.value
    kept = reach <= LONG * unit
    if sum(len(w.hi) for w, stays in zip(windows, kept, strict=True) if stays) < 100:
        kept = reach <= np.sort(reach)[len(reach) // 2]
    times = beginning(fine, windows, found.effect == "readout_latency")
    whole = Restored(found.effect, stimuli, fine, windows, times, rng, report, _reins(model))
    whole.only(kept)
    model = _begun(whole, reach[kept] <= SHORT * unit, whole.reined(model), seed)
    model = whole.again(model, SWEEPS[1], exact=False)
    model = whole.again(model, SWEEPS[2])
    whole.only(~_torn(with_times(whole.fine, whole.times), model))
    return whole


def unjittered(
    recordings: Sequence[Recording],
    fitted: Model,
    nominal: Model,
    between: str,
    seed: int,
    report: Callable[[str], None] = lambda what: None,
) -> tuple[Restored, Model]:
    """The recordings without the jitter of a model `fitted` to them, and the model of the times so found.

    nominal: where to look for what jitter hides;  between: how stimuli run between samples
    """
    fine = [finer(r, between) for r in recordings]
    windows = [jitter_windows(r, fitted.values[SIGMA]) for r in recordings]
    model = _revealed(fitted.without_effect(JITTER), nominal)
    times = spaced(fine, windows, float(model.circuit().refractory))
    stimuli = tuple(r.stimulus for r in recordings)
    whole = Restored(JITTER, stimuli, fine, windows, times, np.random.default_rng(seed), report, _reins(nominal))
    for _ in range(SETTLED):
        whole.draw(model, estimate=False)
    held = whole.again(model.fix({NOISE: None}), JITTER_ROUNDS[0], exact=False)
    free = whole.again(model.set({n: held.values[n] for n in held.free}), JITTER_ROUNDS[1], exact=False)
    return whole, whole.again(free, JITTER_ROUNDS[2])


def _revealed(fitted: Model, nominal: Model) -> Model:
    """The fitted model with what timestamps that jitter cannot tell apart set as the nominal one has it.

    Fast poles run away under jitter, and the dead time with them; what it and the amplifier's recovery take together
    is known.
    """
    values = {name: nominal.values[name] for name in FAST if name in fitted.free and name in nominal.values}
    if "refractory_s" in fitted.free and "diff_cutoff_hz" in values:
        recovery = [1.0 / (2.0 * np.pi * each["diff_cutoff_hz"]) for each in (fitted.values, values)]
        dead = float(fitted.values["refractory_s"] + recovery[0] - recovery[1])
        values["refractory_s"] = max(dead, 0.1 * nominal.values["refractory_s"])
    return fitted.set(values)


def _begun(whole: Restored, brief: np.ndarray, model: Model, seed: int) -> Model:
    """The model that recordings with brief windows (bool per recording) tell, where all times begin."""
    chosen = brief if brief.any() else ~brief
    timed = [r for r, use in zip(with_times(whole.fine, whole.times), chosen, strict=True) if use]
    scout = EventTimes(few(timed, SCOUT_EVENTS, np.random.default_rng(seed)))
    model = climbed(scout, feasible(model, scout), tolerance=0.1, max_steps=30).model
    if sum(len(r.events) for r in timed) < 100 or not brief.any():
        return model
    part = replace(whole)
    part.only(brief)
    model = part.again(model, SWEEPS[0], exact=False)
    if whole.effect == "readout_latency":
        pixels = len(np.unique(np.concatenate([r.events.pixel for r in whole.fine])))
        whole.times = ranked(whole.fine, whole.windows, model, pixels, seed)
    for i, t in zip(np.flatnonzero(brief), part.times, strict=True):
        whole.times[i] = t
    for _ in range(SETTLING):
        whole.draw(model)
    return model


def _torn(recordings: Sequence[Recording], model: Model) -> np.ndarray:
    """(recordings,) bool: too many events without a cause."""
    likelihood = EventTimes(recordings)
    stray = likelihood.terms(model.circuit()).stray
    n = np.bincount(likelihood.recording_of_event, minlength=len(recordings))
    return np.bincount(likelihood.recording_of_event, stray, len(recordings)) > TORN * np.maximum(n, 1)


def _reins(model: Model) -> dict[str, Prior]:
    """A wide prior on each filter of the model, about where it is."""
    return {n: Prior(p.to_coordinate(p.value), WIDTH) for n, p in model.parameters.items() if n in FILTERS and p.free}


def _leapt(ends: Sequence[Climbed]) -> Model:
    """The model farther along the way that the last refits have gone: they follow the times drawn in small steps."""
    coordinates, path = ends[-1].coordinates, [end.x for end in ends]
    gone = np.mean(path[-2:], axis=0) - np.mean(path[-5:-3], axis=0)
    limit = 0.2 * coordinates.longest_moves()
    x = path[-1] + FARTHER * np.clip(gone, -limit, limit)
    return coordinates.model_at(np.clip(x, *coordinates.bounds()))


def _ticked(recording: Recording, tick_s: float) -> Recording:
    """The same events, known to be as wide as the tick."""
    return replace(recording, events=replace(recording.events, tick_ns=max(round(1e9 * tick_s), 1)))
