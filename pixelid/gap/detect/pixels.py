"""The evidence of recordings with pixels: their events, dealt into pools of pixels, as likelihoods."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pixelid.cluster import Work
from pixelid.fit.cache import FitCache, map_fits
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.field import Field, field_of
from pixelid.fit.maximise import Maximum, maximise, maximise_with_restarts
from pixelid.fit.starts import feasible, longest_dead_time, random_starts
from pixelid.gap.criteria import Criteria
from pixelid.gap.detect.diagnostics import chance_of_background
from pixelid.gap.split import Split
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.recordings.bench import pixel_gains
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import few, only
from pixelid.stages.circuit import Circuit

BETWEEN_SAMPLES = ("smooth", "linear")  # how the light may run between the stimulus's samples
SCREEN_EVENTS = 6_000  # of the pixels that a first search looks at: thresholds to 0.1 % in a tenth of a second a fit
NOISE, DEAD_TIME = "threshold_sigma", "refractory_s"
TURNS, AT_REST = 5, 0.05  # at most, and what a turn may still move a fit by: squared, in standard errors
RANDOM_STARTS = 3  # beside the nominal values, where a base fit leaves events without a cause
# Only those go on that lead after so many of their 40 steps.  All went on in 32 sessions of
# `benchmarks/gap_combinations.py`: in five some ended better than the base fit, by 26 to 600 nats, and in each of
# these a start that leads so early did, too, by all but 7 to 29 of them.
FIRST_LEG_STEPS, GOING_ON = 24, 2


@dataclass(frozen=True)
class PixelEvidence:
    """Recordings as a fit reads them, dealt into pools of pixels.

    Attributes:
        recordings: With stimuli resampled as `between` says.
        between: How the light runs between samples, one of `BETWEEN_SAMPLES`.
        split: Which pixels belong to which pool.
        screening, fitting, judging: Likelihoods of a few fit pixels, of all fit pixels, of the select pixels.  Where
            the fit pixels are few, the first two are one.
        training: Likelihood of fit and select pixels together.
        nominal: The base model at its shipped values, made feasible for these events.
    """

    recordings: tuple[Recording, ...]
    between: str
    split: Split
    screening: EventTimes
    fitting: EventTimes
    judging: EventTimes
    training: EventTimes
    nominal: Model

    def weighed(self, circuit: Circuit) -> PixelEvidence:
        """The same evidence with timestamp noise weighed by one circuit in every pool.

        Models are compared under one and the same likelihood: weigh before fitting the first of them.
        """
        return self.each(lambda pool: pool.weighed(circuit))

    def each(self, seen: Callable[[EventTimes], EventTimes]) -> PixelEvidence:
        """The same with every pool's likelihood as another sees its events."""
        fitting = seen(self.fitting)
        screening = fitting if self.screening is self.fitting else seen(self.screening)
        return replace(
            self, screening=screening, fitting=fitting, judging=seen(self.judging), training=seen(self.training)
        )


def gather_evidence(
    recordings: Sequence[Recording], split: Split, model: Model, between: str, seed: int
) -> PixelEvidence:
    """The evidence of recordings whose light runs between samples as said."""
    fine = tuple(with_fine_light(r, between) for r in recordings)
    fitted = only(fine, split.fit)
    fitting, screening = EventTimes(fitted), EventTimes(few(fitted, SCREEN_EVENTS, np.random.default_rng(seed)))
    if screening.events == fitting.events:
        screening = fitting
    return PixelEvidence(
        fine, between, split, screening, fitting, EventTimes(only(fine, split.select)),
        EventTimes(only(fine, split.train)), feasible(model, screening),
    )  # fmt: skip


def fit_base(
    recordings: Sequence[Recording],
    split: Split,
    model: Model,
    criteria: Criteria,
    seed: int,
    cache: FitCache | None = None,
    work: Work | None = None,
) -> tuple[PixelEvidence, Maximum]:
    """The evidence with the light between samples under which the base model fits best, and the base fitted to it."""
    work = work or Work()
    some = [gather_evidence(recordings, split, model, between, seed) for between in BETWEEN_SAMPLES]
    start = _screened(some[0].screening, some[0].nominal, model, cache, work).model
    some = [evidence.each(lambda pool: pool.with_gains_held(start.circuit())) for evidence in some]
    ends = map_fits(work, _FromHere(start), [(evidence.training, evidence.nominal) for evidence in some], cache)
    evidence, end = max(zip(some, ends, strict=True), key=lambda pair: pair[1].value)
    return evidence, _search_elsewhere(evidence, end, criteria, seed, cache, work)


def fit_base_roughly(
    recordings: Sequence[Recording], split: Split, model: Model, seed: int, cache: FitCache | None = None
) -> tuple[PixelEvidence, Maximum]:
    """As `fit_base`, of a few pixels only: where the times are about to be drawn anew, the fit to them is to be made
    again."""
    evidence = gather_evidence(recordings, split, model, BETWEEN_SAMPLES[0], seed)
    return evidence, _screened(evidence.screening, evidence.nominal, model, cache, Work())


def at_rest(
    evidence: PixelEvidence, fit: Maximum, fitted: Callable[[PixelEvidence, Model], Maximum]
) -> tuple[PixelEvidence, Maximum]:
    """(the evidence weighed where its fit is, that fit): a circuit weighs stamps, and what fits them moves by that.

    Args:
        evidence: Weighed by some circuit.
        fit: To it.
        fitted: A fit from a model.
    """
    for _ in range(TURNS):
        before = fit.x
        evidence = evidence.weighed(fit.model.circuit())
        fit = fitted(evidence, fit.model)
        went = fit.x - before
        if went @ fit.information @ went < AT_REST:
            break
    return evidence, fit


def is_noisy(model: Model, shipped: Model) -> bool:
    """Whether the threshold noise of a model, where it is free, is more than pixels of the shipped kind have."""
    max_noise_factor = 2.0  # of the shipped noise, in a start: pixels of one kind differ by less
    return NOISE in model.free and model.values[NOISE] > max_noise_factor * shipped.values[NOISE]


def _screened(screening: EventTimes, nominal: Model, shipped: Model, cache: FitCache | None, work: Work) -> Maximum:
    """The base fitted to a few pixels, from its feasible start and from others where that start is likely to mislead.

    Where the start explains the events badly, the noise that covers for it is so large that a fit may end there:
    nothing is surprising enough to move the filters.  With little noise, what cannot be explained is background.
    Where no interval is nearly as short as the shipped dead time, the one that the intervals reach down to is tried.
    """
    starts = [nominal]
    if is_noisy(nominal, shipped):
        starts.append(nominal.set({NOISE: shipped.values[NOISE]}))
    # Times the shipped one, from which a fit does not find it: the density barely feels it so far out
    far_dead_time = 4.0
    if DEAD_TIME in nominal.free:
        longest = longest_dead_time(nominal, screening)
        if longest > far_dead_time * nominal.values[DEAD_TIME]:
            starts.append(feasible(shipped.set({DEAD_TIME: longest}), screening))
    return max(map_fits(work, _FromAfar(screening, nominal), starts, cache), key=lambda fit: fit.value)


def _search_elsewhere(
    evidence: PixelEvidence, end: Maximum, criteria: Criteria, seed: int, cache: FitCache | None, work: Work
) -> Maximum:
    """The base fit, from random starts as well where it leaves more events without a cause than it should.

    Either something is missing, or the fit ended at a lesser optimum: a few pixels tell, and all are asked where that
    was so.  After a first leg only the leading starts go on.
    """
    expected = criteria.max_unexplained_fraction * evidence.training.events
    if chance_of_background(end.unexplained, expected) > criteria.max_p_unexplained:
        return end
    few_pixels = evidence.screening
    here = maximise(few_pixels, end.model, tolerance=0.1, max_steps=25, cache=cache)
    coordinates = Coordinates.of(evidence.nominal)
    points = random_starts(coordinates.start, RANDOM_STARTS, np.random.default_rng(seed))
    starts = (evidence.nominal, *(feasible(coordinates.model_at(point), few_pixels) for point in points))
    legs = map_fits(work, _FirstLeg(few_pixels), starts, cache)
    leading = sorted(legs, key=lambda leg: -leg.value)[:GOING_ON]
    afar = _FromAfar(few_pixels, evidence.nominal)
    for other in map_fits(work, afar, [leg.model for leg in leading], cache):
        if other.value > here.value + criteria.min_lead_nats:
            there = maximise_with_restarts(
                evidence.training, other.model, evidence.nominal, tolerance=0.05, max_steps=25, cache=cache
            )
            here, end = other, there if there.value > end.value else end
    return end


@dataclass(frozen=True)
class _FromHere:
    """The base fitted to events from where a few of them led, and from their nominal cutoffs where some ran away."""

    start: Model

    def __call__(self, job: tuple[EventTimes, Model], cache: FitCache | None) -> Maximum:
        events, nominal = job
        return maximise_with_restarts(events, self.start, nominal, tolerance=0.05, max_steps=25, cache=cache)


@dataclass(frozen=True)
class _FirstLeg:
    """The first steps of a fit of the base to a few pixels from a start."""

    pool: EventTimes

    def __call__(self, start: Model, cache: FitCache | None) -> Maximum:
        return maximise(self.pool, start, tolerance=0.1, max_steps=FIRST_LEG_STEPS, cache=cache)


@dataclass(frozen=True)
class _FromAfar:
    """The base fitted to a few pixels from a start, and from its nominal cutoffs where some ran away."""

    pool: EventTimes
    nominal: Model

    def __call__(self, start: Model, cache: FitCache | None) -> Maximum:
        return maximise_with_restarts(self.pool, start, self.nominal, tolerance=0.1, max_steps=40, cache=cache)


def reconsider_stimuli(
    evidence: PixelEvidence,
    recordings: Sequence[Recording],
    model: Model,
    fit: Maximum,
    weights: Circuit,
    seed: int,
    cache: FitCache | None = None,
) -> tuple[PixelEvidence, Maximum]:
    """The evidence with the light running otherwise between samples, where the grown model fits better there.

    Args:
        evidence: As it is; `fit` was fitted to its training pixels.
        recordings: Behind it, with stimuli as they came.
        model: The base as shipped.
        fit: The grown model.
        weights: The circuit that weighs timestamp noise in `evidence`, and so in the other.
        seed: As for `gather_evidence`.
        cache: Fits already made.
    """
    between = BETWEEN_SAMPLES[1 - BETWEEN_SAMPLES.index(evidence.between)]
    other = gather_evidence(recordings, evidence.split, model, between, seed).weighed(weights)
    end = maximise(other.training, fit.model, tolerance=0.05, max_steps=8, cache=cache)
    if end.value <= fit.value:
        return evidence, fit
    return other, maximise(other.training, end.model, tolerance=0.01, max_steps=40, cache=cache)


def reconsider_field(
    evidence: PixelEvidence,
    recordings: Sequence[Recording],
    model: Model,
    fit: Maximum,
    seed: int,
    cache: FitCache | None = None,
) -> tuple[Field | None, PixelEvidence, Maximum]:
    """How pixels still differ under the grown model, where gains were estimated without it; evidence and fit with that.

    Args:
        evidence, recordings, model, fit, seed, cache: As in `reconsider_stimuli`.
    """
    circuit, uneven = fit.model.circuit(), any(len(pixel_gains(r)[0]) for r in recordings)
    field = field_of(EventTimes(evidence.recordings), circuit) if uneven else None
    if field is None:
        return None, evidence, fit
    other = gather_evidence(field.on(recordings), evidence.split, model, evidence.between, seed).weighed(circuit)
    return field, other, maximise(other.training, fit.model, tolerance=0.01, max_steps=40, cache=cache)


def relative_noise(model: Model) -> float:
    """The relative threshold noise of a model, the unit of residuals."""
    return float(np.real(model.circuit().noise))


def per_pixel(likelihood: EventTimes, model: Model) -> np.ndarray:
    """(pixels,) log-likelihood of each pixel under a model."""
    return likelihood.terms(model.circuit()).per_pixel
