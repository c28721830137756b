"""What replicates show, taken out of a map: from cells where it is clear, or from all."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pixelid.gap.detect.maps import Cell, Maps
from pixelid.gap.shot_noise.replicates import subtract_replicates

CELLS = tuple(Cell("level", "time", name, score, 100, 0.0) for name, score in (("a", 12.0), ("b", 6.0), ("c", 0.5)))
SEEN: Any = SimpleNamespace(maps=Maps(CELLS, 1e-6, 1e-6, None, 0))


def shown(a, b=(1.0, -1.0, 1.0, -1.0)):
    return [{("level", "a"): x, ("level", "b"): y, ("level", "c"): 0.0} for x, y in zip(a, b, strict=True)]


def test_what_replicates_clearly_show_is_nothing_and_the_rest_stays_as_it_is():
    cells, p = subtract_replicates(SEEN, shown((11.0, 13.0, 12.0, 12.5)), clear=4.0)
    left = {c.label: c.score for c in cells}
    assert abs(left["a"]) < 1.0
    assert left["b"] == 6.0
    assert left["c"] == 0.5
    assert p == pytest.approx(3 * 2 * 9.866e-10, rel=1e-3)  # of 6 normal standard deviations, in three cells


def test_what_replicates_show_by_chance_takes_nothing_away():
    cells, _ = subtract_replicates(SEEN, shown((1.9, 1.5, 2.0, 1.8)), clear=4.0)
    assert {c.label: c.score for c in cells} == {"a": 12.0, "b": 6.0, "c": 0.5}


def test_replicates_that_differ_tell_less():
    """A mean of 12 that scatters by 6 leaves a score of 24 within what is usual, one that scatters by 1 does not."""
    twice: Any = SimpleNamespace(maps=Maps((Cell("level", "time", "a", 24.0, 100, 0.0),), 1e-6, 1e-6, None, 0))
    left = []
    for spread in (1.0, 6.0):
        values = 12.0 + spread * np.array([-1.2, -0.4, 0.4, 1.2])
        left.append(subtract_replicates(twice, [{("level", "a"): v} for v in values], clear=4.0)[0][0].score)
    assert left[0] > 2.0 * left[1] > 0.0


def test_without_a_limit_every_cell_pays_for_the_replicates():
    left = {c.label: c.score for c in subtract_replicates(SEEN, shown((1.9, 1.5, 2.0, 1.8)))[0]}
    assert 0.0 < left["b"] < 6.0
    assert 0.0 < left["a"] < 12.0 - 1.8
