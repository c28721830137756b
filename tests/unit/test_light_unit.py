"""The unit of the light: the same optimum whatever it is, and what is said of it."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.fit.fit import fit
from pixelid.fit.light_unit import in_recorded_unit, reference_light, unit_sentence
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.files import from_document, to_document
from pixelid.model.shipped import find_model
from pixelid.recordings.bench import Bench, on_bench
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp, steps

MODEL = find_model("dvs128")


@pytest.fixture(scope="module")
def session():
    lights = (chirp(300.0, 1.0, 5.0, 400.0, duration_s=0.3, dt=1e-4), steps(30.0, duration_s=0.4, dt=1e-4, seed=2))
    made = [simulate(MODEL, light, width=3, height=2, seed=k, sensor_seed=0) for k, light in enumerate(lights)]
    return [replace(r, condition=f"light {k}", sensor="one") for k, r in enumerate(made)]


def in_unit(recordings, factor: float, unit: str):
    return [replace(r, stimulus=replace(r.stimulus.brighter_by(factor), unit=unit)) for r in recordings]


@pytest.mark.parametrize(("factor", "unit"), [(0.13, "lux"), (1e-5, "V"), (1e5, "relative")])
def test_the_optimum_does_not_depend_on_the_unit(session, factor, unit):
    known = fit(session, MODEL, starts=0)
    assert known.status == "converged", known.advice
    other = fit(in_unit(session, factor, unit), MODEL, starts=0)
    assert other.status == known.status
    names = list(known.coordinates.names)
    moved = other.x.copy()
    for name in ("alpha", "gamma"):
        moved[names.index(name)] += np.log(factor)
    sd = np.sqrt(np.diag(known.covariance))
    assert np.abs((moved - known.x) / sd).max() < 0.02
    assert other.model.values["alpha"] * factor == pytest.approx(known.model.values["alpha"], rel=1e-4)
    sentence = unit_sentence(other.model, MODEL)
    assert ("fA, were it a dvs128" in sentence) == (unit != "relative")


def test_effects_are_added_in_the_unit_of_the_light(session):
    scaled = in_recorded_unit(MODEL, EventTimes(in_unit(session, 1e-3, "V")))
    k = scaled.light_scale
    assert 3e-4 < k < 3e-3
    grown = scaled.with_effect("dark_current").with_effect("parasitic_photocurrent")
    library = MODEL.with_effect("dark_current").with_effect("parasitic_photocurrent")
    for name, power in (("dark_current.radiance", 1), ("parasitic_photocurrent.rate_hz_per_radiance", -1)):
        assert grown.values[name] == pytest.approx(library.values[name] * k**power)
        assert grown.parameter(name).upper == pytest.approx(library.parameter(name).upper * k**power)
    assert from_document(to_document(scaled)).light_scale == k
    assert reference_light(scaled) == pytest.approx(k * reference_light(MODEL))


def test_a_unit_that_is_held_is_not_looked_for(session):
    held = MODEL.fix({"alpha": None})
    assert in_recorded_unit(held, EventTimes(in_unit(session, 1e-3, "V"))) is held


def test_what_is_known_does_not_depend_on_the_unit_where_zeros_of_the_light_are_free():
    """In W/m2 a zero is known to 1e-9; in steps of one such unit its curvature would hide that of all the rest."""
    lights = (
        chirp(300.0, 0.7, 5.0, 400.0, duration_s=0.3, dt=1e-4),
        chirp(3.0, 0.7, 1.0, 40.0, duration_s=1.0, dt=1e-4),
    )
    made = [simulate(MODEL, light, width=3, height=2, seed=k, sensor_seed=0) for k, light in enumerate(lights)]
    session = [replace(r, condition=f"light {k}", sensor="one") for k, r in enumerate(made)]

    def known(factor: float) -> np.ndarray:
        stated = [on_bench(r, Bench(offset_sd=0.05 * factor)) for r in in_unit(session, factor, "W/m2")]
        result = fit(stated, MODEL, starts=0)
        assert result.status == "converged", result.advice
        offsets = np.array([name.startswith("light_offset") for name in result.coordinates.names])
        assert offsets.sum() == 2
        return np.sqrt(np.diag(result.covariance)) / np.where(offsets, factor, 1.0)

    np.testing.assert_allclose(
        known(3e-7), known(1.0), rtol=0.1
    )  # poles known to 30 %: their curvature is a small rest
