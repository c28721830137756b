"""Which changes of a criterion turn a decision: against searches with that criterion changed."""

import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from decisions import FACTORS, Varied, combine, noted_decisions, plain
from gap_sensitivity import changed

from pixelid.gap.criteria import Criteria
from pixelid.gap.detect import diagnostics


@pytest.mark.parametrize("name", [field.name for field in fields(Criteria)])
def test_a_comparison_is_noted_exactly_where_its_outcome_changes(name):
    rng = np.random.default_rng(0)
    for value in getattr(Criteria(), name) * np.exp(rng.uniform(-1.5, 1.5, 40)):
        with noted_decisions() as (criteria, noted):
            outcome = np.float64(value) < getattr(criteria, name)
        other = {factor: value < getattr(changed(name, factor), name) for factor in FACTORS}
        assert outcome == (value < getattr(Criteria(), name))
        assert noted == {(name, factor) for factor in FACTORS if other[factor] != outcome}


def test_changes_are_followed_through_arithmetic_and_functions():
    def chance(criteria):
        expected = criteria.max_unexplained_fraction * 20_000
        return np.sqrt(2.0 * criteria.replicate_error_share + 1.0), diagnostics.chance_of_background(9, expected)

    def sides(criteria):
        error, p = chance(criteria)
        return bool(error * 3.0 > 3.2), bool(p < criteria.max_p_unexplained * 1e6)

    with noted_decisions() as (criteria, noted):
        usual = sides(criteria)
    assert usual == sides(Criteria())
    wanted = set()
    for name in ("replicate_error_share", "max_unexplained_fraction", "max_p_unexplained"):
        wanted |= {(name, factor) for factor in FACTORS if sides(changed(name, factor)) != usual}
    assert wanted
    assert noted == wanted


def test_what_leaves_for_an_array_or_a_float_counts_as_turned():
    noted = set()
    value = Varied(1.0, {("a", 0.5): 0.5, ("b", 2.0): 1.0}, noted)
    assert plain(combine(np.add, value, 1.0)) == 2.0
    assert not noted
    np.testing.assert_array_equal(np.ones(2) * value, np.ones(2))
    assert noted == {("a", 0.5)}
    noted.clear()
    assert float(value) == 1.0
    assert noted == {("a", 0.5)}
