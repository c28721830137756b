"""Intervals of circuit values follow from those of the invariants as draws of the invariants say."""

import numpy as np
import pytest

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.uncertainty.physical import physical_intervals
from pixelid.model.shipped import find_model


def test_intervals_agree_with_draws():
    model = find_model("dvs128")
    coordinates = Coordinates.of(model)
    rng = np.random.default_rng(0)
    d = len(coordinates)
    root = 0.004 * rng.standard_normal((d, d))
    covariance = root @ root.T + 1e-6 * np.eye(d)
    at = np.array([model.parameters[name].to_coordinate(model.values[name]) for name in coordinates.names])
    values = model.gauge.physical(*(model.values[k] for k in ("alpha", "beta", "gamma")), model.physical).as_dict()
    found = physical_intervals(model, coordinates, covariance, values)
    which = [coordinates.names.index(name) for name in ("alpha", "beta", "gamma")]
    draws = rng.multivariate_normal(at[which], covariance[np.ix_(which, which)], 400)
    drawn = [model.gauge.physical(*np.exp(draw), model.physical).as_dict() for draw in draws]
    for name, ends in found.items():
        spread = np.std(np.log([circuit[name] for circuit in drawn]))
        if ends is None:
            assert spread < 1e-6, name
        else:
            assert np.log(ends[1] / ends[0]) / (2 * 1.96) == pytest.approx(spread, rel=0.15), name
    assert any(ends is not None for ends in found.values())
    assert found["q_in"] is None  # the gauge of this model states it


def test_what_the_data_leave_open_has_no_interval():
    model = find_model("dvs128")
    coordinates = Coordinates.of(model)
    covariance = 1e-4 * np.eye(len(coordinates))
    covariance[coordinates.names.index("beta")] = covariance[:, coordinates.names.index("beta")] = np.inf
    values = model.gauge.physical(*(model.values[k] for k in ("alpha", "beta", "gamma")), model.physical).as_dict()
    assert physical_intervals(model, coordinates, covariance, values)["A_amp"] is None
