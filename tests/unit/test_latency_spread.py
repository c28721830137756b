"""Order statistics, settings and spoiled cells of latency tables, against brute force and hand calculation."""

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.tables.latency.cells import gather
from pixelid.tables.latency.reading import read_tables
from pixelid.tables.latency.settings import between, bias_of
from pixelid.tables.latency.spread import Regions, Spread, statistics
from pixelid.tables.latency.steps import TIMES_S

HEADER = "camera,lens,polarity,irradiance_W_m2,bias_config,roi_index,min,median,max,stdev,nb_pol0,nb_pol1\n"


def test_order_statistics_are_those_of_many_drawn_pixels():
    tau, C, delay, n, edges = 4e-4, 0.4, 3e-5, 100, 4000
    spread = Spread(mismatch=0.08, noise=0.06, delay=0.3, edge=0.0)
    changes = (1.0 - np.exp(-TIMES_S / tau))[None]
    one = np.ones(1)
    found = statistics(changes, Regions(np.zeros(1, int), C * one, delay * one, 0.02 * one, n * one), spread)
    rng = np.random.default_rng(3)
    level = C * (1 + 0.08 * rng.standard_normal((edges, n)))
    level += np.hypot(0.06 * C, 0.02) * rng.standard_normal((edges, n))
    t = -tau * np.log(1.0 - level) + delay * np.exp(0.3 * rng.standard_normal((edges, n)))
    assert found["median"][0] == pytest.approx(np.median(t, axis=1).mean(), rel=0.01)
    assert found["min"][0] == pytest.approx(t.min(axis=1).mean(), rel=0.02)
    assert found["max"][0] == pytest.approx(t.max(axis=1).mean(), rel=0.02)
    assert found["sd"][0] == pytest.approx(t.std(), rel=0.03)


def test_scatter_between_edges_is_that_of_events_and_not_of_pixels():
    tau, C, n, edges = 4e-4, 0.4, 100, 3000
    changes = (1.0 - np.exp(-TIMES_S / tau))[None]
    one = np.ones(1)
    regions = Regions(np.zeros(1, int), C * one, 0.0 * one, 0.0 * one, n * one)
    found = statistics(changes, regions, Spread(0.1, 0.05, 0.0, 2e-6))
    rng = np.random.default_rng(5)
    pixels = 1 + 0.1 * rng.standard_normal(n)
    level = C * (pixels + 0.05 * rng.standard_normal((edges, n)))
    means = (-tau * np.log(1.0 - level)).mean(axis=1) + 2e-6 * rng.standard_normal(edges)
    assert found["stdev"][0] == pytest.approx(means.std(), rel=0.15)  # one draw of 100 pixels' thresholds


def test_pixels_that_never_reach_their_threshold_do_not_count():
    changes = (0.5 * (1.0 - np.exp(-TIMES_S / 1e-3)))[None]
    one = np.ones(1)
    regions = Regions(np.zeros(1, int), 0.5 * one, 0.0 * one, 0.0 * one, 50 * one)
    found = statistics(changes, regions, Spread(0.1, 0.0, 0.0, 0.0))
    rng = np.random.default_rng(2)
    level = 0.5 * (1 + 0.1 * rng.standard_normal(100_000))
    t = -1e-3 * np.log(1.0 - level[level < 0.5] / 0.5)
    assert found["median"][0] == pytest.approx(np.median(t), rel=0.01)


def test_bias_of_a_setting_and_values_between():
    assert bias_of("0.25min") == -0.25
    assert bias_of("30") == 30.0
    assert bias_of("default") is None
    known = {-1.0: 0.1, 0.0: 0.2, 1.0: 0.4}
    assert between(known, 0.5, logarithmic=False) == pytest.approx(0.3)
    assert between(known, 0.5, logarithmic=True) == pytest.approx(np.sqrt(0.08))
    assert between(known, -6.0, logarithmic=False) == pytest.approx(0.1 * 0.5**5)
    assert between({0.0: 0.3}, 9.0, logarithmic=False) == 0.3


def test_a_lost_edge_is_seen_in_the_scatter_and_put_right(tmp_path):
    truth, share = 1000.0, 1.0 / 6.0
    written, scatter = truth * (1 - share), truth * np.sqrt(share * (1 - share))
    rows = [f"C,l,0,0.1,0,{k},500,{truth},1500,10,100,0" for k in range(2)]
    short = f"{500 * (1 - share)},{written},{1500 * (1 - share)},{scatter},176,0"
    rows += [f"C,l,0,0.1,0,{k},{short}" for k in range(2, 5)]
    rows += [f"C,l,0,0.2,0,0,{short}"]
    path = tmp_path / "table.csv"
    path.write_text(HEADER + "\n".join(rows) + "\n")
    cells = gather(read_tables([path]))
    np.testing.assert_allclose(cells.lost, [0, 0, share, share, share, share], rtol=1e-3)
    np.testing.assert_allclose(1e6 * cells.table.latency_s["median"], [truth, truth], rtol=1e-3)
    assert cells.spoiled.tolist() == [False, False, True, True, True, True]


def test_larger_regions_have_lost_nothing(tmp_path):
    rows = [f"C,l,0,{light},0,{k},500,1000,1500,30,{100 + 300 * (k % 2)},0" for light in (0.1, 0.2) for k in range(6)]
    path = tmp_path / "table.csv"
    path.write_text(HEADER + "\n".join(rows) + "\n")
    cells = gather(read_tables([path]))
    assert not cells.spoiled.any()
    assert not cells.lost.any()


def test_a_camera_whose_edges_all_scatter_has_lost_nothing(tmp_path):
    rows = [f"C,l,0,{light},0,0,{median},{median},{median},{0.4 * median},1,0" for light, median in
            ((0.1, 1000.0), (0.3, 333.3), (1.0, 100.0))]  # fmt: skip
    path = tmp_path / "table.csv"
    path.write_text(HEADER + "\n".join(rows) + "\n")
    cells = gather(read_tables([path]))
    np.testing.assert_allclose(1e6 * cells.table.latency_s["median"], [1000.0, 333.3, 100.0])
    assert not cells.lost.any()


@pytest.mark.parametrize(
    ("row", "word"),
    [
        ("C,l,2,0.1,0,0,1,2,3,4,5,6", "polarity"),
        ("C,l,1,0,0,0,1,2,3,4,5,6", "irradiance_W_m2"),
        ("C,l,1,0.1,0,0,1,-2,3,4,5,6", "median"),
        ("C,l,1,0.1,0,0,1,two,3,4,5,6", "row 1"),
    ],
)
def test_wrong_cells_are_named(tmp_path, row, word):
    path = tmp_path / "table.csv"
    path.write_text(HEADER + row + "\n")
    with pytest.raises(InputError, match=word):
        read_tables([path])


def test_statistics_are_smooth_where_pixels_begin_to_stay_silent():
    """A threshold that passes what the light changes: no latency jumps, and medians are those of a truncated normal."""
    changes = (0.5 * (1.0 - np.exp(-TIMES_S / 1e-3)))[None]
    thresholds = np.linspace(0.3, 0.55, 1001)
    one = np.ones(len(thresholds))
    regions = Regions(np.zeros(len(one), int), thresholds, 2e-4 * one, 0.01 * one, 100 * one)
    found = statistics(changes, regions, Spread(0.08, 0.06, 0.2, 0.0))
    for name, step in (("median", 0.005), ("min", 0.005), ("max", 0.02), ("sd", 0.02)):
        values = np.log(found[name])
        assert np.abs(np.diff(values)).max() < step, name
    rng = np.random.default_rng(2)
    for k in (200, 600, 900):
        C = thresholds[k]
        level = C + np.sqrt((0.08 * C) ** 2 + (0.06 * C) ** 2 + 0.01**2) * rng.standard_normal(400_000)
        delay = 2e-4 * np.exp(0.2 * rng.standard_normal(400_000))
        fires = level < 0.5 * (1.0 - np.exp(-1.0 / 1e-3))
        t = -1e-3 * np.log(1.0 - level[fires] / 0.5) + delay[fires]
        assert found["median"][k] == pytest.approx(np.median(t), rel=0.01)
