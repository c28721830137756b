"""Where a model stands in the coordinates of a fit whose recordings have values of their own."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.gap.shot_noise.shares import vector
from pixelid.model.shipped import find_model
from pixelid.parameters.parameter import Parameter


def test_phases_of_recordings_are_the_models_and_delays_the_fits():
    model = find_model("dvs128").with_effect("mains_flicker", {"modulation": 0.05})
    model = model.with_nuisances({"mains_flicker.phase_rad": {"dim": 0.4, "bright": 1.1}})
    delay = Parameter("delay_s[dim]", 2e-4, "s", -1.0, 1.0)
    coordinates = Coordinates.of(model, (delay,))
    fit: Any = SimpleNamespace(coordinates=coordinates, x=coordinates.start + 0.01)
    moved = model.set({"alpha": 1.1 * model.values["alpha"]})
    at = dict(zip(coordinates.names, vector(moved, fit), strict=True))
    start = dict(zip(coordinates.names, coordinates.start, strict=True))
    assert at["mains_flicker.phase_rad[dim]"] == start["mains_flicker.phase_rad[dim]"]
    assert at["mains_flicker.phase_rad[bright]"] == start["mains_flicker.phase_rad[bright]"]
    assert at["delay_s[dim]"] == start["delay_s[dim]"] + 0.01
    np.testing.assert_allclose(at["alpha"] - start["alpha"], np.log(1.1))
