"""Rank a menu of stimuli by what they would add to what is known, and recommend one."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.design import criteria
from pixelid.design.information import PIXELS, few_pixels, information, simulated
from pixelid.design.menu import Candidate
from pixelid.errors import InputError
from pixelid.figures.words import in_words
from pixelid.figures.words import stimulus as in_short
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.shot_noise import EFFECT as SHOT_NOISE
from pixelid.fit.uncertainty.curvature import combination
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.statistics import Z95
from pixelid.status import Status

PRIOR_SD = 2.0  # of every coordinate before any data, in `Coordinates.longest_moves`: a factor e^±2, or 2 ms


@dataclass(frozen=True)
class Known:
    """What is known before: of a fit, the information (n, n) of `names`; None where only recordings or priors are."""

    names: tuple[str, ...]
    information: np.ndarray


def recommend(
    model: Model,
    menu: Sequence[Candidate],
    *,
    criterion: str = "D",
    recordings: Sequence[Recording] = (),
    known: Known | None = None,
    draws: Sequence[Model] = (),
    pixels: int = 25,
    per_second: bool = False,
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> dict:
    """The content of design.json but for provenance (docs/schemas/design.json).

    The score of a candidate is the mean of `criteria.score` over the model and `draws`.

    Args:
        model: the circuit.
        menu: the candidates.
        criterion: "D", "A" or the name of a parameter (`criteria`).
        recordings: whose information is there before; without them that of `known`, else nothing but a wide prior
            (`PRIOR_SD`).
        known: information of a fit.
        draws: models as uncertain as the circuit is.
        pixels: that would record the stimulus, when there are no recordings to say so.
        per_second: rank by score per second of light.
        seed: of simulations.
        progress: called with the candidate that is done and the fraction.

    Raises:
        InputError: an unknown criterion, an empty menu, models or recordings that the event-time likelihood refuses.
    """
    began = time.perf_counter()
    report = progress or (lambda what, fraction: None)
    if "threshold_noise" not in model.effects:
        raise InputError(f"model {model.name}: the event-time likelihood needs the effect threshold_noise")
    if not menu:
        raise InputError("the menu is empty")
    names = Coordinates.of(model).names
    criteria.check(criterion, names)
    cut, share = few_pixels(recordings, seed) if recordings else ([], pixels / PIXELS)
    models = (model, *draws)
    scores = np.zeros((len(menu), len(models)))
    events = np.zeros(len(menu))
    befores: list[np.ndarray] = []
    afters: list[np.ndarray] = []
    for j, drawn in enumerate(models):
        coordinates = Coordinates.of(drawn)
        # the information of events by noise is not computed, and their simulation takes steps as short as 1 / β
        quiet = drawn.without_effect(SHOT_NOISE) if drawn.has(SHOT_NOISE) else drawn
        x = coordinates.start
        prior = _prior(coordinates)
        base = np.zeros_like(prior) if known is None or cut else _of_fit(known, names)
        before = prior + base + (share * information(cut, coordinates, x) if cut else 0.0)
        befores.append(before)
        for i, stimulus in enumerate(menu):
            recording = simulated(quiet, stimulus.stimulus, seed + j, cut)
            together = share * information([*cut, recording], coordinates, x)
            after = prior + base + together
            scores[i, j] = criteria.score(criterion, names, before, after)
            if j == 0:
                afters.append(after)
                events[i] = len(recording.events) * share
            report(stimulus.name, (j + (i + 1) / len(menu)) / len(models))
    ranking = []
    for i, stimulus in enumerate(menu):
        entry = stimulus.as_dict()
        entry |= {
            "score": scores[i].mean(),
            "score_error": scores[i].std(ddof=1) / np.sqrt(len(models)) if len(models) > 1 else 0.0,
            "score_per_second": scores[i].mean() / stimulus.stimulus.duration_s,
            "events": events[i],
        }
        ranking.append(entry)
    order = sorted(range(len(menu)), key=lambda i: -ranking[i]["score_per_second" if per_second else "score"])
    ranking = [ranking[i] for i in order]
    after = afters[order[0]]
    report("done", 1.0)
    return {
        "status": Status.converged,
        "advice": _advice(ranking, recordings, known, draws, model),
        "model": model.name,
        "criterion": criterion,
        "per_second": per_second,
        "recommended": ranking[0],
        "why": why(names, befores[0], after, criterion, ranking),
        "ranking": ranking,
        "widths_before": _widths(Coordinates.of(model), befores[0]),
        "widths_after": _widths(Coordinates.of(model), after),
        "before": "recordings" if cut else ("fit" if known is not None else "prior"),
        "pixels": round(share * (len(np.unique(np.concatenate([r.events.pixel for r in cut]))) if cut else PIXELS)),
        "draws": len(models),
        "seconds": time.perf_counter() - began,
    }


def _prior(coordinates: Coordinates) -> np.ndarray:
    """(n, n) information of the parameters' own priors, else of the wide one."""
    own = coordinates.prior_gradient_and_curvature(coordinates.start)[1]
    wide = 1.0 / (PRIOR_SD * coordinates.longest_moves()) ** 2
    return np.diag(np.where(own > 0, own, wide))


def _of_fit(known: Known, names: tuple[str, ...]) -> np.ndarray:
    """(n, n) the fit's information in the order of `names`; zero for parameters the fit did not free."""
    prior = np.zeros((len(names), len(names)))
    place = [names.index(name) for name in known.names if name in names]
    kept = [i for i, name in enumerate(known.names) if name in names]
    prior[np.ix_(place, place)] = known.information[np.ix_(kept, kept)]
    return prior


def known_from(names: Sequence[str], covariance: np.ndarray) -> Known:
    """`Known` of a fit's covariance (n, n); parameters without variance (on a bound) add nothing."""
    covariance = np.asarray(covariance, dtype=float)
    seen = np.diag(covariance) > 0
    inverse = criteria.covariance(covariance[np.ix_(seen, seen)])  # inversion, well scaled
    return Known(tuple(name for name, keep in zip(names, seen, strict=True) if keep), 0.5 * (inverse + inverse.T))


def _widths(coordinates: Coordinates, matrix: np.ndarray) -> dict[str, dict]:
    """Parameter → standard error in its fitting coordinate, and the 95 % interval around the model's value."""
    expected = {}
    errors = criteria.standard_errors(matrix)
    for parameter, x, sd in zip(coordinates.parameters, coordinates.start, errors, strict=True):
        ends = (float(x + side * Z95 * sd) for side in (-1, 1))
        low, high = (parameter.from_coordinate(min(max(end, -300.0), 300.0)) for end in ends)
        expected[parameter.name] = {
            "value": parameter.value,
            "unit": parameter.unit,
            "std_coordinate": sd,
            "coordinate": parameter.transform,
            "interval_95": [max(low, parameter.lower), min(high, parameter.upper)],
        }
    return expected


def _advice(ranking: list[dict], recordings, known, draws, model: Model) -> str:
    sentences = []
    if model.has(SHOT_NOISE):
        sentences.append("shot noise is left out: what it hides, and what its own events would add, is not counted")
    if ranking[0]["score"] < 0.01:
        sentences.append("nothing on the menu adds more than 1 %: offer other levels or longer stimuli")
    if recordings and not draws:
        sentences.append(
            "the model's values are taken as they are: give a fit folder to average over their uncertainty"
        )
    if known is not None and not recordings:
        sentences.append(
            "thresholds: the new stimulus is counted as if other pixels recorded it; give the fit's recordings with "
            "--recorded to count the same pixels once"
        )
    return "; ".join(sentences)


def why(names: tuple[str, ...], before: np.ndarray, after: np.ndarray, criterion: str, ranking: list[dict]) -> str:
    """One paragraph: what shrinks, along which direction, and how the runner-up compares.

    before, after: information matrices (n, n) of the recommended stimulus at the central values.
    """
    old, new = criteria.standard_errors(before), criteria.standard_errors(after)
    order = np.argsort(new / old)
    shown = [criterion] if criterion in names else [names[i] for i in order[:3]]
    parts = [_shrinks(name, old[names.index(name)], new[names.index(name)]) for name in shown]
    direction, factor = criteria.most_improved(before, after)
    sentences = [f"It shrinks the standard error of {'; '.join(parts)}."]
    most = combination([in_words(name) for name in names], direction, 0.2, 4)
    sentences.append(f"The direction that gains most is {most}: {factor:.3g} times better known.")
    if len(ranking) > 1:
        best, second = ranking[0], ranking[1]
        other = in_short(second["name"], second.get("parameters", {}), "")
        sentences.append(
            f"Its score is {best['score']:.3g} nats; the next best, {other}, reaches {second['score']:.3g}."
        )
        if best["score"] - second["score"] < 2 * np.hypot(best["score_error"], second["score_error"]):
            sentences.append("The difference lies within the error of the estimate: either will do.")
    return " ".join(sentences)


def _shrinks(name: str, old: float, new: float) -> str:
    return f"{in_words(name)} from {_percent(old)} to {_percent(new)}"


def _percent(sd: float) -> str:
    """A standard error in a log coordinate: '3.1 %', or 'a factor 4.2' when it is large."""
    return f"{100 * sd:.2g} %" if sd < 0.3 else f"a factor {np.exp(min(sd, 50.0)):.2g}"
