"""Which effects a description takes the place of."""

from types import SimpleNamespace

import numpy as np
import pytest

from pixelid.gap.options import Context, Options
from pixelid.gap.steps import describe_remainder as remainder


def ended(judged, descriptions=1):
    """Descriptions whose model has this log-likelihood on each of four pixels."""
    return SimpleNamespace(judged=judged + np.array([0.0, 0.1, -0.1, 0.0]), price=8.0 * descriptions, penalty=4.0)


def with_steps(*effects):
    return SimpleNamespace(steps=[SimpleNamespace(effect=effect) for effect in effects])


@pytest.mark.parametrize(
    ("alone", "beside", "better"),
    [
        (ended(100.0), ended(90.0), True),
        (ended(90.0), ended(100.0), False),
        (ended(100.0), ended(100.0), True),  # dark_current and bandwidth_floor cost a parameter each
        (ended(98.0), ended(100.0), False),  # 8 nats less for 8 nats of parameters
        (ended(100.0, 2), ended(100.0, 0), False),  # two descriptions of two parameters for two effects of one
        (ended(104.0, 2), ended(100.0, 0), True),
    ],
)
def test_a_description_takes_the_place_of_effects_if_it_explains_more_for_its_parameters(alone, beside, better):
    state = with_steps("dark_current", "bandwidth_floor")
    assert remainder._is_better(alone, beside, state, Context(Options())) is better


def test_effects_are_not_weighed_against_descriptions_at_other_times():
    recording, drawn = SimpleNamespace(), SimpleNamespace()
    before = SimpleNamespace(corrected=None, recordings=(recording,))
    state = SimpleNamespace(
        steps=[SimpleNamespace(before=before, effect="leak")], hypothesis=SimpleNamespace(recordings=(drawn,))
    )
    assert remainder._without_steps(state) is None
    state.hypothesis.recordings = ()  # lost their times
    assert remainder._without_steps(state) is None
    assert remainder._without_steps(SimpleNamespace(steps=())) is None
