"""An effect that may hide behind unequal thresholds, in any unit of light."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pixelid import find_model
from pixelid.gap.options import Options
from pixelid.gap.verdict import confounded


@pytest.mark.parametrize("unit", [1.0, 4.5e-6, 1e4])
@pytest.mark.parametrize(("seen", "hides"), [(1e-3, True), (1e6, False)])
def test_what_would_show_hides_in_no_unit(unit, seen, hides):
    """`seen` is at the typical strength, which is that of the session's unit."""
    model = find_model("dvs128").in_light(unit)
    typical = next(p for p in model.library("bandwidth_floor") if p.free)
    fit = SimpleNamespace(
        model=model, x=np.array([0.1, 0.0]), information=1e6 * np.eye(2),
        coordinates=SimpleNamespace(names=("on_threshold", "off_threshold")),
    )  # fmt: skip
    at: Any = SimpleNamespace(fit=fit)
    apart = SimpleNamespace(
        effect="bandwidth_floor", strength=typical.value, bias=np.array([0.1, -0.05]), seen=seen, hidden=1.0
    )
    directions: Any = [apart]
    found = confounded(at, directions, Options())
    assert (found is not None) == hides
    if found is not None:
        assert found.strength == pytest.approx(0.1 / 0.15 * typical.value)
