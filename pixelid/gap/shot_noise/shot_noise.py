"""Shot noise, which no density of single events knows: found by simulating it (indirect inference).

To the likelihood, noise before the photoreceptor is threshold noise; what gives it away is where events scatter, that
an event's deviation reverses the one before, and that pixels fire in constant light.  So the noise that the fit calls
the thresholds' is shared out between them and shot noise (`likelihood/shot_noise.py`), and put right by replicates that
are simulated and fitted like the measurement (`shares.py`).  Shot noise is named when nothing then tells measurement
and replicates apart.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from pixelid.cluster import Work
from pixelid.fit.again import can_be_simulated
from pixelid.fit.cache import FitCache, map_fits
from pixelid.fit.maximise import Maximum
from pixelid.fit.shot_noise import EFFECT, NOISE
from pixelid.gap.criteria import Criteria
from pixelid.gap.detect.diagnostics import Diagnostics
from pixelid.gap.detect.pixels import PixelEvidence
from pixelid.gap.options import Options
from pixelid.gap.shot_noise.replicates import (
    Corrected,
    Replicate,
    background_by_polarity,
    make_replicate,
    subtract_replicates,
)
from pixelid.gap.shot_noise.shares import Guess, sound, vector
from pixelid.likelihood.shot_noise import share_out
from pixelid.model.model import Model
from pixelid.statistics import Z95

REPLICATES = 4  # at the density taken
MAX_MOVE = 0.1  # of its logarithm that these leave from the one that they were made at: else they are made again
ROUNDS, PATIENCE = 10, 2  # of replicates, at most, and of those that come hardly nearer
APPROACH = (2, *range(3 + REPLICATES * ROUNDS, 8 + REPLICATES * ROUNDS))  # turns of single replicates before these
NEARER = 0.9  # of what was left, that must at most be left for being nearer
MAX_SCORE = 10.0  # standard deviations: cells that differ by more count as this in a distance
MAX_SCORE_AT_SIGHT = 30.0  # the same where maps are only looked at
MIN_HALF_WIDTH = 0.05  # relative, of the interval: replicates are no better than this


@dataclass(frozen=True)
class ShotNoise:
    """Shot noise found.

    Attributes:
        density, interval: Its strength, and where that lies with 95 %.
        corrected: The model with it, and what is left beside its replicates.
        gain: Nats by which the maps come nearer (half the sum of squared scores).
        left: Nats by which they are still off.
    """

    density: float
    interval: tuple[float, float]
    corrected: Corrected
    gain: float
    left: float


def looks_like_shot_noise(seen: Diagnostics, criteria: Criteria) -> bool:
    """Whether the maps look like it at first sight: spreads are off more than levels, and deviations reverse."""
    scores = {kind: [c.score for c in seen.maps.cells if c.response == kind] for kind in ("level", "spread", "memory")}
    if not scores["level"] or not scores["spread"]:
        return False
    level, spread = (
        float(np.mean(np.clip(scores[kind], -MAX_SCORE_AT_SIGHT, MAX_SCORE_AT_SIGHT) ** 2))
        for kind in ("level", "spread")
    )
    memory = [0.0, *scores["memory"]]
    return spread > level and min(-min(memory), max(memory)) > criteria.min_alternation_score


def noise_explains_more(evidence: PixelEvidence, model: Model, gain: float, options: Options) -> bool:
    """Whether by the filter shot noise gains more beside the model with an effect than that effect does.

    No other effect of the library gains as much, so what the filter sees is no other effect's.

    Args:
        evidence: Of the pixels.
        model: With the leading effect, or with what describes what is left.
        gain: Nats of that.
        options: Of the search.
    """
    if EFFECT in options.leave_out or model.has(EFFECT):
        return False
    beside = share_out(evidence.training, model.circuit(), options.seed, free_jitter=True)
    return beside is not None and beside.gain > max(gain, options.criteria.min_shot_noise_gain_nats)


def find_shot_noise(
    evidence: PixelEvidence, fit: Maximum, seen: Diagnostics, options: Options, cache: FitCache | None = None,
    work: Work | None = None,
) -> ShotNoise | None:  # fmt: skip
    """Shot noise that explains what is left under a fitted model.

    None where it cannot be simulated, a replicate's noise cannot be told, or replicates with it come little nearer than
    those without.

    Args:
        evidence: Of the pixels.
        fit: Whose noise is shared out.
        seen: What it leaves.
        options: Of the search.
        cache: Fits already made.
        work: Who simulates and fits the replicates; None: this process.
    """
    if NOISE not in fit.coordinates.names or not can_be_simulated(evidence.training.recordings, fit.model):
        return None
    criteria = options.criteria
    found = share_out(evidence.training, fit.model.circuit(), options.seed, free_jitter=True)
    if found is None or found.gain < criteria.min_shot_noise_gain_nats:
        return None

    one = _OneReplicate(evidence, fit, seen, criteria, options.seed)

    def made(*jobs: tuple[Model, int]) -> list[Replicate]:
        return map_fits(work or Work(), one, jobs, cache)

    measured = Replicate(
        fit.x, seen.maps.scores, background_by_polarity(evidence.training, seen.residual.background), found
    )
    guess = Guess.first(fit, found)
    bare, guessed = made((fit.model, 0), (guess.model, 1))
    without = _distance(measured, bare, criteria)
    alike = 0.5 * len(measured.scores)  # between replicates of one model
    near_enough = min(
        alike + 2.0 * criteria.max_share_left_by_shot_noise * (without - alike),  # half as near as they must in the end
        without - 0.5 * criteria.min_shot_noise_gain_nats,
    )
    near = _approached(guess, guessed, lambda one: _distance(measured, one, criteria), near_enough, made)
    if near is None:
        return None
    guess, first = near
    final = [first, *made(*((guess.model, turn) for turn in range(3, 2 + REPLICATES)))]
    return _put_right(
        guess, final, measured.background, lambda at, turn: made(*((at.model, turn + k) for k in range(REPLICATES))),
        lambda at, some: _judged(at, some, measured, seen, without, criteria), criteria.sufficient_p_shot_noise,
    )  # fmt: skip


def _approached(
    guess: Guess,
    guessed: Replicate,
    distance: Callable[[Replicate], float],
    near_enough: float,
    made: Callable[..., list[Replicate]],
) -> tuple[Guess, Replicate] | None:
    """A guess, corrected by one replicate after the other, and one of its own that comes near enough; None where none
    does.

    The first corrections may lead away: an effect that does to events what shot noise does takes part of it at first.

    Args:
        guess: As the filter has it.
        guessed: A replicate of it.
        distance: From the measurement, of a replicate.
        near_enough: Such a distance.
        made: Replicates of (model, turn)s.
    """
    nearest, farther = distance(guessed), 0
    for turn in APPROACH:
        guess = guess.corrected([guessed])
        if not guess.is_told:
            return None
        (guessed,) = made((guess.model, turn))
        off = distance(guessed)
        if off <= near_enough:
            return guess, guessed
        farther = 0 if off < NEARER * nearest else farther + 1
        if farther == PATIENCE:
            return None
        nearest = min(nearest, off)
    return None


def _put_right(
    guess: Guess,
    final: Sequence[Replicate],
    background: np.ndarray,
    made: Callable[[Guess, int], list[Replicate]],
    judged: Callable[[Guess, Sequence[Replicate]], ShotNoise | None],
    enough: float,
) -> ShotNoise | None:
    """Shot noise as guessed, put right by replicates of it until these are like the measurement, or come no nearer.

    Replicates correct a guess in the measure of their own errors: far off they do not put it right at once, and may
    overshoot.

    Args:
        guess: What the first replicates were made from.
        final: These.
        background: (2,) OFF and ON events without a cause that were measured.
        made: Replicates of a guess, from a number of a turn on.
        judged: What is left beside replicates, by the guess that they lead to; None for too much.
        enough: p-value of what is left, from which on no more are made, but once where they were off in the density by
            more than its error.
    """
    best: ShotNoise | None = None
    alike: ShotNoise | None = None  # leaves little enough, but its replicates were off in the density
    worse = 0
    for turn in range(2 + REPLICATES, 2 + REPLICATES * ROUNDS, REPLICATES):
        if turn > 2 + REPLICATES:
            final = made(guess, turn - REPLICATES)
        better = guess.corrected(final, None if best is None else background)
        if not better.is_told or not sound(final):
            break
        off = abs(math.log(better.density / guess.density))
        if turn > 2 + REPLICATES or off < MAX_MOVE:
            noise = judged(better, final)
            if noise is None:
                break
            sufficient = noise.corrected.seen.p >= enough
            if alike is not None or (sufficient and off < better.error(final)):
                return noise if sufficient else alike
            alike = noise if sufficient else None
            worse = 0 if best is None or noise.left < NEARER * best.left else worse + 1
            best = noise if best is None or noise.left < best.left else best
            if worse == PATIENCE:
                break
        guess = better
    return alike or best


@dataclass(frozen=True)
class _OneReplicate:
    """A session simulated under a (model, turn) and fitted as the measured one was."""

    evidence: PixelEvidence
    fit: Maximum
    seen: Diagnostics
    criteria: Criteria
    seed: int

    def __call__(self, job: tuple[Model, int], cache: FitCache | None) -> Replicate:
        model, turn = job
        seed = self.seed + 31 * (turn + 1)
        return make_replicate(self.evidence, model, self.fit, self.seen, self.criteria, seed, cache)


def _judged(
    guess: Guess, final: Sequence[Replicate], measured: Replicate, seen: Diagnostics, without: float, criteria: Criteria
) -> ShotNoise | None:
    """Shot noise as guessed; None where it explains too little.

    final: replicates of it;  without: distance of a replicate without shot noise
    """
    among = [_distance(one, other, criteria) for one, other in itertools.combinations(final, 2)]
    floor, off = float(np.median(among)), float(np.median([_distance(measured, r, criteria) for r in final]))
    explained = without - floor
    too_little = explained < criteria.min_shot_noise_gain_nats
    if too_little or off - floor > criteria.max_share_left_by_shot_noise * explained:
        return None
    cells, _ = subtract_replicates(seen, [r.scores for r in final])
    # replicates scatter about each other as the measurement about them, heavy tails of cells and all; and what they
    # are simulated from is itself known to a part of what it explains only
    alike = 0.5 * len(measured.scores)
    chance = np.hypot(max(float(np.std(among, ddof=1)), np.sqrt(alike)), criteria.replicate_error_share * explained)
    p = 2.0 * float(norm.sf(max(off - floor, 0.0) / chance))
    usual = np.mean([r.background for r in final], axis=0)
    error = guess.error(final)
    chance = np.sqrt(criteria.unexplained_overdispersion * (usual + 1.0) * (1.0 + 1.0 / REPLICATES))
    chance = np.hypot(chance, usual * guess.background_per_density() * error)
    p_background = 2.0 * len(usual) * float(norm.sf(np.abs((measured.background - usual) / chance).max()))
    p = min(p, p_background, 1.0)
    half = max(Z95 * error, MIN_HALF_WIDTH)
    before, after = (0.5 * sum(min(c.score**2, MAX_SCORE**2) for c in some) for some in (seen.maps.cells, cells))
    left = replace(seen, maps=replace(seen.maps, cells=cells, p=p), p=p)
    model, fit, density = guess.model, guess.fit, guess.density
    corrected = Corrected(model, vector(model, fit) - fit.x, left, guess.widened(final))
    return ShotNoise(density, (density * np.exp(-half), density * np.exp(half)), corrected, before - after, off - floor)


def _distance(one: Replicate, other: Replicate, criteria: Criteria) -> float:
    """Half the squared distance, nats, of two maps and their background events, in the chance of their difference."""
    maps = sum(
        min((score - other.scores[key]) ** 2 / 2.0, MAX_SCORE**2)
        for key, score in one.scores.items()
        if key in other.scores
    )
    chance = 2.0 * criteria.unexplained_overdispersion * (other.background + 1.0)
    background = np.minimum((one.background - other.background) ** 2 / chance, MAX_SCORE**2)
    return 0.5 * float(maps + background.sum())
