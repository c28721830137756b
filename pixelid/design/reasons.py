"""Why the recommended stimulus is recommended, in words."""

from __future__ import annotations

import numpy as np

from pixelid.design import criteria
from pixelid.figures.words import in_words, stimulus
from pixelid.fit.uncertainty.curvature import combination


def why(names: tuple[str, ...], before: np.ndarray, after: np.ndarray, criterion: str, ranking: list[dict]) -> str:
    """One paragraph: what shrinks, along which direction, and how the runner-up compares.

    before, after: information matrices (n, n) of the recommended stimulus at the central values.
    """
    old, new = criteria.standard_errors(before), criteria.standard_errors(after)
    order = np.argsort(new / old)
    shown = [criterion] if criterion in names else [names[i] for i in order[:3]]
    parts = [_shrinks(name, old[names.index(name)], new[names.index(name)]) for name in shown]
    direction, factor = criteria.most_improved(before, after)
    said = [f"It shrinks the standard error of {'; '.join(parts)}."]
    most = combination([in_words(name) for name in names], direction, 0.2, 4)
    said.append(f"The direction that gains most is {most}: {factor:.3g} times better known.")
    if len(ranking) > 1:
        best, second = ranking[0], ranking[1]
        other = stimulus(second["name"], second.get("parameters", {}), "")
        said.append(f"Its score is {best['score']:.3g} nats; the next best, {other}, reaches {second['score']:.3g}.")
        if best["score"] - second["score"] < 2 * np.hypot(best["score_error"], second["score_error"]):
            said.append("The difference lies within the error of the estimate: either will do.")
    return " ".join(said)


def _shrinks(name: str, old: float, new: float) -> str:
    return f"{in_words(name)} from {_percent(old)} to {_percent(new)}"


def _percent(sd: float) -> str:
    """A standard error in a log coordinate: '3.1 %', or 'a factor 4.2' when it is large."""
    return f"{100 * sd:.2g} %" if sd < 0.3 else f"a factor {np.exp(min(sd, 50.0)):.2g}"
