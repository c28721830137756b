"""Recordings at imputed event times: an immutable value that every draw replaces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import expit
from scipy.stats import chi2

from pixelid.gap.imputation.draws import Draw, draw_times
from pixelid.gap.imputation.paths import draw_paths, followable, is_summed_whole
from pixelid.gap.imputation.windows import Windows, with_times
from pixelid.gap.options import Options
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.parameters.parameter import Prior
from pixelid.recordings.recording import Recording
from pixelid.stimuli.pixel_lights import Light

QUEUE, TICK, JITTER, SIGMA = (
    "readout_latency", "timestamp_quantisation", "timestamp_jitter", "timestamp_jitter.sigma_s",
)  # fmt: skip
MOSTLY_WAITED = 0.1  # of a recording's events that waited in a queue; where fewer did, hardly anything has to be drawn


@dataclass(frozen=True)
class Imputation:
    """Recordings at imputed event times.

    Attributes:
        effect: What the readout did.
        stimuli: As they came.
        fine: The recordings as stamped, their stimuli as a fit reads them.
        windows, times: Per recording (`windows.py`); () where nothing has to be drawn.
        random: State of the generator that the next draw begins with.
        priors: Of filters, while times are drawn.
        by_paths: Whether whole paths are drawn (`paths.py`), and the model follows the stamps behind them.
        lost: Names of recordings left out.
        nats: Of the stamps drawn by paths, under the model that they were last drawn from.
        error: Relative standard error of a jitter's spread.
        scatter: By parameter, standard deviation of its coordinate between draws.
    """

    effect: str
    stimuli: tuple[Light | None, ...]
    fine: tuple[Recording, ...]
    windows: tuple[Windows, ...]
    times: tuple[np.ndarray, ...]
    random: Mapping
    priors: Mapping[str, Prior]
    by_paths: bool = False
    lost: tuple[str, ...] = ()
    nats: float = 0.0
    error: float = 0.0
    scatter: Mapping[str, float] = field(default_factory=dict)

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """At the times drawn last, with the stimuli they came with."""
        made = with_times(self.fine, self.times) if self.windows else self.fine
        return tuple(replace(r, stimulus=stimulus) for r, stimulus in zip(made, self.stimuli, strict=True))

    @property
    def sigma_s(self) -> float:
        """The jitter's standard deviation."""
        return 1e-9 * self.windows[0].sd

    def draws_paths(self, model: Model) -> bool:
        """Whether all times of a pixel are drawn at once: behind a jitter, a coarse tick, and a queue where sums
        over paths know the model."""
        queued = self.effect == QUEUE and followable(self.fine, model)
        return self.by_paths or (queued and is_summed_whole(model.circuit()))

    @property
    def likelihood(self) -> EventTimes:
        """Of the times drawn last."""
        return EventTimes(with_times(self.fine, self.times))

    def with_filter_priors(self, model: Model) -> Model:
        """The model with the priors on its free filters."""
        parameters = {
            name: replace(p, prior=self.priors[name]) if p.free and name in self.priors else p
            for name, p in model.parameters.items()
        }
        return replace(model, parameters=parameters)

    def only(self, kept: np.ndarray) -> Imputation:
        """Without some recordings: kept (recordings,) bool."""

        def some(values: Sequence) -> tuple:
            return tuple(value for value, stays in zip(values, kept, strict=True) if stays)

        lost = tuple(r.name for r, stays in zip(self.fine, kept, strict=True) if not stays)
        return replace(
            self, stimuli=some(self.stimuli), fine=some(self.fine), windows=some(self.windows),
            times=some(self.times), lost=self.lost + lost,
        )  # fmt: skip

    def few(self, events: int, rng: np.random.Generator) -> Imputation:
        """With as many pixels, at least two, as hold about so many events; chosen at random."""
        pixel = np.concatenate([r.events.pixel for r in self.fine])
        pixels, counts = np.unique(pixel, return_counts=True)
        order = rng.permutation(len(pixels))
        enough = max(int(np.searchsorted(np.cumsum(counts[order]), events)) + 1, 2)
        return self.of(pixels[order[:enough]])

    def of(self, pixels: np.ndarray) -> Imputation:
        """Of some pixels (k,), flat indices."""
        kept = [np.isin(r.events.pixel, pixels) for r in self.fine]
        fine = tuple(replace(r, events=r.events.select(some)) for r, some in zip(self.fine, kept, strict=True))
        windows = tuple(w.only(some) for w, some in zip(self.windows, kept, strict=True))
        times = tuple(t[some] for t, some in zip(self.times, kept, strict=True))
        return replace(self, fine=fine, windows=windows, times=times)

    def with_spread(self, sigma_s: float) -> Imputation:
        """With stamps about the times by another standard deviation."""
        return replace(self, windows=tuple(replace(w, sd=1e9 * sigma_s) for w in self.windows))

    def is_uneven(self, options: Options) -> bool:
        """Whether what was imputed does not look like a jitter, the same for all recordings and polarities."""
        limit = options.criteria.max_jitter_divergence_nats
        return uneven(self.fine, self.windows, self.times, limit, options.alpha_each)


def draw_again(imputation: Imputation, model: Model, *, estimate: bool = True, exact: bool = False) -> Imputation:
    """All times drawn once more, and the jitter estimated from them."""
    rng = np.random.default_rng(0)
    rng.bit_generator.state = imputation.random
    times, reordered, paths = imputation.times, imputation.by_paths, imputation.draws_paths(model)
    nats = 0.0
    if paths:
        waited = np.array([reordered or (w.hi > w.lo).sum() > MOSTLY_WAITED * len(w.hi) for w in imputation.windows])
        made = draw_paths(imputation.fine, imputation.windows, times, model.circuit(), rng, among=waited)
        times, nats = made.times, float(made.per_pixel.sum())
    draw = draw_times(imputation.fine, imputation.windows, times, model, rng, exact or paths, reordered)
    windows, error = imputation.windows, imputation.error
    exchanges = 4  # of stamps, per path: paths find the order of polarities, these who has which stamp of one polarity
    if imputation.effect == JITTER:
        for _ in range(exchanges if reordered else 1):
            windows = tuple(exchange_stamps(imputation.fine, windows, draw.times, rng))
        if estimate:
            sd, error = estimate_spread(draw, windows[0].sd)
            windows = tuple(replace(w, sd=sd) for w in windows)
    random = rng.bit_generator.state
    return replace(imputation, windows=windows, times=tuple(draw.times), random=random, nats=nats, error=error)


# Of a polarity: from there on χ² is exceeded at most 1.3 times as often as it says, at chances from 1e-2 to 1e-4; by 16
# events 1.6 times, by 5 up to 6 times, by two up to 100 times (a million draws each).
MIN_EVENTS = 30
MAX_LOG_MOVE = 0.5  # of the spread between two estimates


def uneven(
    recordings: Sequence[Recording],
    windows: Sequence[Windows],
    times: Sequence[np.ndarray],
    max_divergence_nats: float,
    alpha: float,
) -> bool:
    """Whether imputed displacements differ between recordings or polarities by more than one normal allows.

    A common normal is what a jitter is; a delay of one polarity, say, is not.  With mean m and standard deviation s of
    a recording's polarity, in units of the jitter's, the relative entropy per event is (m² + s² − 1 − ln s²)/2; twice
    n times that is χ² with two degrees of freedom where the normal holds, and what that allows, among so many
    recordings and polarities, is taken off.  Of a few events it does not hold, and they say little: they are not asked.
    """
    groups = []
    for recording, window, t in zip(recordings, windows, times, strict=True):
        assert window.stamp is not None
        late = (window.stamp - t) / window.sd
        groups += [late[recording.events.p == polarity] for polarity in (0, 1)]
    groups = [some for some in groups if len(some) >= MIN_EVENTS and some.std() > 0]
    for some in groups:
        mean, variance = float(some.mean()), float(some.var())
        divergence = 0.5 * (mean**2 + variance - 1.0 - np.log(variance))
        if divergence - 0.5 * float(chi2.isf(alpha / len(groups), 2)) / len(some) > max_divergence_nats:
            return True
    return False


def exchange_stamps(
    recordings: Sequence[Recording], windows: Sequence[Windows], times: Sequence[np.ndarray], rng: np.random.Generator
) -> list[Windows]:
    """The windows with stamps drawn anew: jitter lets successive events of a pixel and polarity swap theirs."""
    drawn = []
    for recording, window, t in zip(recordings, windows, times, strict=True):
        assert window.stamp is not None
        order = np.lexsort((t, recording.events.p, recording.events.pixel))
        pixel, polarity, stamp = recording.events.pixel[order], recording.events.p[order], window.stamp[order]
        moment = t[order]
        for start in (0, 1):
            k = np.arange(start, len(order) - 1, 2)
            k = k[(pixel[k] == pixel[k + 1]) & (polarity[k] == polarity[k + 1])]
            gain = (stamp[k + 1] - stamp[k]) * (moment[k] - moment[k + 1]) / window.sd**2
            k = k[rng.random(len(k)) < expit(gain)]
            stamp[k], stamp[k + 1] = stamp[k + 1], stamp[k]
        back = np.empty_like(stamp)
        back[order] = stamp
        drawn.append(replace(window, stamp=back))
    return drawn


def estimate_spread(draw: Draw, sd: float) -> tuple[float, float]:
    """(standard deviation of the jitter, ns, that makes the misses likeliest;  its relative standard error).

    Each event's own time is integrated over, which makes alternating draws and estimates settle sooner.  sd: the last
    """

    max_cost_nats = 8.0  # of one event's jitter, four standard deviations: events farther off have other causes

    def loss(log_sd: float) -> float:
        variance = np.exp(2.0 * log_sd) + draw.variance
        return float(np.sum(0.5 * np.log(variance) + np.minimum(0.5 * draw.miss**2 / variance, max_cost_nats)))

    best = minimize_scalar(loss, bounds=(np.log(sd) - MAX_LOG_MOVE, np.log(sd) + MAX_LOG_MOVE), method="bounded")
    estimate = float(np.exp(best.x))
    told = np.sum(2.0 * (estimate**2 / (estimate**2 + draw.variance)) ** 2)
    return estimate, float(1.0 / np.sqrt(max(told, 1.0)))
