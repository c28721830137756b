"""Which changes of a criterion turn a decision: against searches with that criterion changed."""

from dataclasses import fields

import numpy as np
import pytest
from decisions import FACTORS, OF_CELLS, Varied, combine, noted_decisions, plain
from gap_certification import camera, session
from gap_sensitivity import changed

from pixelid.fit.maximise import maximise
from pixelid.fit.starts import feasible
from pixelid.gap.criteria import Criteria
from pixelid.gap.detect import diagnostics
from pixelid.gap.detect.diagnostics import diagnose
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings.selection import only


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


def test_the_chance_of_maps_carries_what_it_would_have_been():
    base = find_model("dvs128")
    likelihood = EventTimes(only(session(camera(3), 3), np.arange(4)))
    fit = maximise(likelihood, feasible(base, likelihood), tolerance=0.5, max_steps=20)
    with noted_decisions() as (criteria, noted):
        p = diagnose(likelihood, fit, criteria, 0, background_fraction=1e-4).p
    assert isinstance(p, Varied)
    assert plain(p) == diagnose(likelihood, fit, Criteria(), 0, background_fraction=1e-4).p
    assert {name for name, _ in p.others} >= {"min_cell_events", "min_cell_share_unfitted"}
    for name, factor in p.others:
        there = diagnose(likelihood, fit, changed(name, factor), 0, background_fraction=1e-4).p
        assert p.others[name, factor] == pytest.approx(there, rel=1e-12)
    assert not noted & {(name, factor) for name in OF_CELLS for factor in FACTORS}
