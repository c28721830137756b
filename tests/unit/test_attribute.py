"""Which effects count as explaining events about as well as the one that is named: by fitted and by unseen units."""

from dataclasses import dataclass

import numpy as np
import pytest

from pixelid.gap.attribute.attribute import attribute
from pixelid.gap.options import Options
from pixelid.model.model import Model
from pixelid.model.shipped import find_model

BASE = find_model("dvs128")
WINNER, RIVAL, UNITS = "leak", "dark_current", 20


@dataclass(frozen=True)
class Fitted:
    """A model, and its log likelihood."""

    model: Model
    value: float


@dataclass(frozen=True)
class Evidence:
    """Two effects with the nats that they gain on units fitted to, and on each of the others."""

    gain: dict[str, float]
    held_out: dict[str, np.ndarray]
    base: Fitted = Fitted(BASE, 0.0)

    def screen(self, effects, report):
        return [(Fitted(BASE.with_effect(e), self.gain[e]), self.gain[e]) for e in effects]

    def fit(self, starts, report):
        return [end for _, end in starts]

    def fit_without(self, effect, end):
        return None

    def held_out_gain(self, better, worse):
        return self.held_out[next(e for e in self.held_out if better.model.has(e))]


def runners_up(lead, apart):
    """Names, where the winner leads by so many nats on the units fitted to, and is so far apart on each unseen one."""
    gain, unseen = {WINNER: 60.0, RIVAL: 60.0 - lead}, np.linspace(2.0, 4.0, UNITS)
    found = attribute(Evidence(gain, {WINNER: unseen, RIVAL: unseen - apart}), [WINNER, RIVAL], Options())
    assert found.winner is not None
    assert found.winner.effect == WINNER
    return [other.effect for other in found.runners_up]


NOISE = np.tile([2.0, -2.0], UNITS // 2)  # standard error of the sum: 9 nats


@pytest.mark.parametrize(
    ("lead", "apart", "as_good"),
    [
        (1.6, np.full(UNITS, 0.8), False),  # unseen units decide
        (1.6, np.zeros(UNITS), True),  # nothing does
        (1.6, np.full(UNITS, 0.1), True),  # they favour it, by too little for both together
        (1.6, 0.3 + NOISE, True),  # by less than they scatter
        (1.6, np.full(UNITS, -0.8), True),  # they favour the rival
        (20.0, np.full(UNITS, 0.1), False),
        (20.0, NOISE, True),
    ],
)
def test_a_rival_is_as_good_unless_both_kinds_of_units_together_tell_them_apart(lead, apart, as_good):
    assert runners_up(lead, apart) == ([RIVAL] if as_good else [])


@pytest.mark.parametrize(("lead", "named"), [(0.2, True), (20.0, False)])
def test_of_two_that_fitted_units_do_not_tell_apart_that_one_is_named_that_unseen_units_bear_out(lead, named):
    unseen = np.linspace(0.2, 0.4, UNITS)
    evidence = Evidence({RIVAL: 60.0 + lead, WINNER: 60.0}, {RIVAL: np.zeros(UNITS), WINNER: unseen})
    found = attribute(evidence, [WINNER, RIVAL], Options())
    assert [c.effect for c in found.candidates] == [RIVAL, WINNER]
    assert (found.winner is not None and found.winner.effect == WINNER) is named
    assert bool(found.runners_up) is False
