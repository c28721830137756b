"""Which decisions of one search would have gone otherwise, had a criterion been half or twice what it is.

A criterion acts on a verdict through comparisons alone.  `Varied` is a criterion that carries its value halved and
doubled along through arithmetic, and notes at each comparison whether the outcome there is another.  Where no outcome
is, the search with the changed criterion takes the same way to the same verdict and need not be run.

Criteria of cells choose among them by comparisons that nearly always come out otherwise somewhere.  What a search
reads of the maps is the chance of the whole, so the maps are made under each change and that chance carries what it
would have been; where the cells themselves are read (shot noise, imputed times), every change of these criteria counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from unittest.mock import patch

import numpy as np
from scipy.stats import poisson

from pixelid.gap.criteria import Criteria
from pixelid.gap.detect import diagnostics, pixels
from pixelid.gap.detect.maps import Maps
from pixelid.gap.steps import discount_imputation_noise, explain_by_shot_noise, name_effect

FACTORS = (0.5, 2.0)
OF_CELLS = ("min_cell_events", "min_cell_share_unfitted")
OF_WHAT_IS_LEFT_TO_ONE = ("min_hidden_cosine", "complete_closed_fraction")
COMPARISONS = (np.less, np.less_equal, np.greater, np.greater_equal, np.equal, np.not_equal)


def scaled(name: str, factor: float) -> float:
    """A criterion multiplied; near one, what is left to one is."""
    default = float(getattr(Criteria(), name))
    return 1.0 - (1.0 - default) * factor if name in OF_WHAT_IS_LEFT_TO_ONE else factor * default


class Varied(float):
    """A number that depends on criteria.

    Attributes:
        others: (criterion, factor) → the value under it; under all others it is the number itself.
        noted: Where decisions that come out otherwise are put: (criterion, factor).
    """

    others: dict[tuple[str, float], object]
    noted: set[tuple[str, float]]

    def __new__(cls, value, others, noted):
        self = super().__new__(cls, value)
        self.others, self.noted = others, noted
        return self

    def __array_ufunc__(self, ufunc, method, *inputs, **options):
        if method != "__call__" or options:
            return NotImplemented
        return combine(ufunc, *inputs)

    def __float__(self) -> float:
        self._lose()
        return float.__add__(self, 0.0)

    def __bool__(self) -> bool:
        self._note({key: bool(other) for key, other in self.others.items()}, float.__bool__(self))
        return float.__bool__(self)

    def _lose(self) -> None:
        """It leaves for where it cannot be followed: any change may change anything."""
        base = float.__add__(self, 0.0)
        self.noted |= {key for key, other in self.others.items() if not np.array_equal(other, base)}

    def _note(self, outcomes: dict, outcome) -> None:
        self.noted |= {key for key, other in outcomes.items() if not np.array_equal(other, outcome)}


def plain(value):
    """Without what it would have been."""
    return float.__add__(value, 0.0) if isinstance(value, Varied) else value


def combine(function: Callable, *inputs):
    """A function of numbers of which some depend on criteria: a number that does; of a comparison, its outcome."""
    varied = [i for i in inputs if isinstance(i, Varied)]
    noted = varied[0].noted
    keys = {key for v in varied for key in v.others}
    value = function(*map(plain, inputs))
    others = {
        key: function(*(i.others.get(key, plain(i)) if isinstance(i, Varied) else i for i in inputs)) for key in keys
    }
    if function not in COMPARISONS and np.ndim(value) == 0:
        return Varied(value, others, noted)
    # a decision; or it spreads over an array, through which it is not followed
    noted |= {key for key, other in others.items() if not np.array_equal(other, value)}
    return value if np.ndim(value) else bool(value)


def _install() -> None:
    binary = {
        "add": np.add, "sub": np.subtract, "mul": np.multiply, "truediv": np.true_divide, "pow": np.power,
    }  # fmt: skip
    for name, ufunc in binary.items():
        setattr(Varied, f"__{name}__", lambda self, other, ufunc=ufunc: combine(ufunc, self, other))
        setattr(Varied, f"__r{name}__", lambda self, other, ufunc=ufunc: combine(ufunc, other, self))
    for name, ufunc in zip(("lt", "le", "gt", "ge", "eq", "ne"), COMPARISONS, strict=True):
        setattr(Varied, f"__{name}__", lambda self, other, ufunc=ufunc: combine(ufunc, self, other))
    Varied.__neg__ = lambda self: combine(np.negative, self)
    Varied.__hash__ = lambda self: float.__hash__(self)


_install()


@dataclass(frozen=True)
class VariedMaps(Maps):
    """Maps whose `p` knows what it would have been;  others: (criterion of cells, factor) → the maps under it."""

    others: dict[tuple[str, float], Maps] = field(default_factory=dict)


def _map_residuals(likelihood, residual, tangent, factors, criteria: Criteria, seed: int) -> Maps:
    """`maps.map_residuals` as `diagnose` calls it, under each change of the criteria of cells as well."""
    varied = criteria.min_cell_events
    if not isinstance(varied, Varied):
        return _PLAIN_MAPS(likelihood, residual, tangent, factors, criteria, seed)
    others = {
        (name, factor): _PLAIN_MAPS(
            likelihood, residual, tangent, factors, replace(Criteria(), **{name: scaled(name, factor)}), seed
        )
        for name in OF_CELLS
        for factor in FACTORS
    }
    usual = _PLAIN_MAPS(likelihood, residual, tangent, factors, Criteria(), seed)
    p = Varied(usual.p, {key: maps.p for key, maps in others.items()}, varied.noted)
    return VariedMaps(usual.cells, p, usual.p_normal, usual.p_pixels, usual.background, others)


def _looks_like_shot_noise(seen, criteria: Criteria) -> bool:
    """`shot_noise.looks_like_shot_noise`, of each of the maps."""
    usual = _PLAIN_LOOKS(seen, criteria)
    if isinstance(seen.maps, VariedMaps) and isinstance(criteria.min_cell_events, Varied):
        others = {key: _PLAIN_LOOKS(replace(seen, maps=maps), Criteria()) for key, maps in seen.maps.others.items()}
        criteria.min_cell_events._note(others, usual)
    return usual


def _reading_cells(function: Callable, noted: set[tuple[str, float]]) -> Callable:
    """The function, which reads cells: whatever chooses other cells may change what it finds."""

    def reading(*inputs, **named):
        noted.update((name, factor) for name in OF_CELLS for factor in FACTORS)
        return function(*inputs, **named)

    return reading


def _least(*numbers) -> float:
    """`min` of chances that are reported and decide nothing."""
    return min(*map(plain, numbers)) if len(numbers) > 1 else min(map(plain, numbers[0]))


def _chance_of_background(events: int, expected: float) -> float:
    """`diagnostics.chance_of_background`, of a number that depends on criteria as well."""
    if not isinstance(expected, Varied):
        return _PLAIN(events, expected)
    return combine(lambda mean: float(poisson.sf(events - 1, mean)), expected) if events else 1.0


_PLAIN = diagnostics.chance_of_background
_PLAIN_MAPS = diagnostics.map_residuals
_PLAIN_LOOKS = explain_by_shot_noise.looks_like_shot_noise


@contextmanager
def noted_decisions() -> Iterator[tuple[Criteria, set[tuple[str, float]]]]:
    """(criteria to search with, (criterion, factor) of the decisions that it would change) within the block."""
    noted: set[tuple[str, float]] = set()
    criteria = Criteria()
    for one in fields(Criteria):
        default = getattr(criteria, one.name)
        others = {(one.name, factor): scaled(one.name, factor) for factor in FACTORS}
        object.__setattr__(criteria, one.name, Varied(default, others, noted))
    find, subtract = explain_by_shot_noise.find_shot_noise, discount_imputation_noise.subtract_replicates
    with (
        patch.object(diagnostics, "chance_of_background", _chance_of_background),
        patch.object(pixels, "chance_of_background", _chance_of_background),
        patch.object(diagnostics, "map_residuals", _map_residuals),
        patch.object(name_effect, "min", _least, create=True),
        patch.object(explain_by_shot_noise, "looks_like_shot_noise", _looks_like_shot_noise),
        patch.object(explain_by_shot_noise, "find_shot_noise", _reading_cells(find, noted)),
        patch.object(discount_imputation_noise, "subtract_replicates", _reading_cells(subtract, noted)),
    ):
        yield criteria, noted
