"""What differs from pixel to pixel: thresholds trained under their prior, maps of a sensor, hot pixels left out."""

import math

import numpy as np
import pytest
import torch

from pixelid.errors import InputError
from pixelid.model.shipped import find_model
from pixelid.nerf.data.camera import pinhole
from pixelid.nerf.events.intervals import chains, intervals
from pixelid.nerf.pixel.maps import PixelMaps, find_hot, maps_of_circuit, maps_of_sensor
from pixelid.nerf.pixel.model import Bandwidth, Pixel
from pixelid.nerf.training.losses import changes, terms, variance_left
from pixelid.sensors import SensorFit
from pixelid.sensors.map import Map
from pixelid.sensors.shrinkage import Population
from pixelid.stages.circuit import Circuit

OTHERS = ("differencing_pole", "threshold_noise", "refractory_period")
CIRCUIT = Circuit(photoreceptor="unlimited", on_threshold=0.2, off_threshold=0.25, mismatch=0.1)


def crossings(u, t, on: float, off: float):
    """(times, polarities) at which light u (n,) has moved by a threshold since the event before."""
    level, times, polarity = u[0], [], []
    for now, value in zip(t, u, strict=True):
        if value - level >= on or level - value >= off:
            times.append(now)
            polarity.append(value > level)
            level = value
    return np.array(times), np.array(polarity, bool)


def test_thresholds_of_single_pixels_are_found_under_their_prior():
    """On the true light: thresholds that differ by 10 % come back to 3 %, and their mean stays the circuit's."""
    rng = np.random.default_rng(0)
    truth = 0.1 * rng.normal(size=(24, 2))
    truth -= truth.mean(axis=0)
    t = np.linspace(0.0, 1.0, 20_001)
    columns = []
    for pixel, (on, off) in enumerate(truth):
        u = np.sin(2 * np.pi * 7 * t + pixel) + 0.6 * np.sin(2 * np.pi * 17 * t + 2 * pixel)
        when, up = crossings(u, t, 0.2 * math.exp(on), 0.25 * math.exp(off))
        columns.append((when, np.full(len(when), pixel), up))
    when, x, up = (np.concatenate(column) for column in zip(*columns, strict=True))
    spans = intervals(when, x, np.zeros_like(x), up, 24)
    batch = chains(spans, np.arange(0, len(spans.starts), 16), 1, 1.0, rng)
    phase = np.repeat(batch.pixel, np.diff(batch.first))
    light = np.sin(2 * np.pi * 7 * batch.t + phase) + 0.6 * np.sin(2 * np.pi * 17 * batch.t + 2 * phase)
    pixel = Pixel(CIRCUIT, Bandwidth("off"), maps_of_circuit(CIRCUIT, 24))
    level = torch.tensor(light)
    change = changes(level, level, batch, None)
    optimiser = torch.optim.Adam([pixel.departures], lr=0.1)
    for _ in range(150):
        thresholds = pixel.thresholds_at(batch.pixel)
        left = variance_left(change, batch, *thresholds)
        loss = terms(change, level, batch, *thresholds)["diff"] + pixel.penalty(left) / len(spans.starts)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    on, off = pixel.thresholds_at(np.arange(24))
    found = torch.log(torch.cat([on / 0.2, off / 0.25], dim=1)).detach().numpy()
    assert np.sqrt(((found - truth) ** 2).mean()) < 0.03
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=1e-9)
    assert pixel.threshold_spread()[0] == pytest.approx(0.1, rel=0.4)


def test_what_pixels_have_in_common_is_not_theirs():
    """A scene that still lacks contrast would lower all thresholds; their mean is held, step by step."""
    pixel = Pixel(CIRCUIT, Bandwidth("off"), maps_of_circuit(CIRCUIT, 10))
    on, off = pixel.thresholds_at(np.array([2, 5, 7]))
    (on.sum() + 2 * off.sum()).backward()
    assert pixel.departures.grad is not None
    np.testing.assert_allclose(pixel.departures.grad.numpy(), 0.0, atol=1e-12)
    on, off = pixel.thresholds_at(np.array([2, 5, 7]))
    (on[0] - on[1]).backward()
    moved = np.flatnonzero(pixel.departures.grad[:, 0].abs().numpy() > 1e-12)
    assert moved.tolist() == [2, 5]


def test_known_thresholds_are_not_trained():
    known = maps_of_circuit(CIRCUIT.with_(mismatch=0.0), 4)
    pixel = Pixel(CIRCUIT, Bandwidth(), PixelMaps(np.full((4, 2), 0.1), known.threshold_sd))
    assert not pixel.departures.requires_grad
    on, off = pixel.thresholds_at(np.array([3]))
    assert float(on.detach()) == pytest.approx(0.2 * math.exp(0.1))
    assert float(off.detach()) == pytest.approx(0.25 * math.exp(0.1))


def of_values(name: str, value: np.ndarray, sd: float) -> Map:
    """A map of these values."""
    log, error = np.log(value), np.full(value.shape, sd)
    return Map(name, "", log, error, log, error, Population(float(log.mean()), 0.1, value.size), (0, 0), (0, 0))


def sensor(folder, maps, events, block=1, model=None):
    """A folder as `pixelid sensor` writes it."""
    folder.mkdir()
    model = model or find_model("dvs128")
    SensorFit({m.name: m for m in maps}, events, 1, block, model, 1.0, 0, {}).write(folder)
    return folder


def test_maps_of_a_sensor_replace_the_mismatch(tmp_path):
    """6 × 4 pixels; bandwidth in blocks of 2 × 2, relative to the model that the map was made with."""
    rng = np.random.default_rng(1)
    on, off = 0.3 * np.exp(0.1 * rng.normal(size=(2, 4, 6)))
    follower = find_model("dvs128").values["sf_cutoff_hz"] * np.array([[1.0, 0.5, 2.0], [1.0, 1.0, 1.0]])
    events = np.full((4, 6), 100)
    events[2, 3] = 100_000
    maps = [of_values("on_threshold", on, 0.02), of_values("off_threshold", off, 0.03),
            of_values("sf_cutoff_hz", follower, 0.05)]  # fmt: skip
    folder = sensor(tmp_path / "maps", maps, events, block=2)
    circuit = CIRCUIT.with_(photoreceptor="one_pole", corner=100.0, follower=1e4)
    found = maps_of_sensor(folder, circuit, pinhole(6, 4, 0.7))
    pixel = Pixel(circuit, Bandwidth(), found)
    shown = [x.detach().numpy().reshape(4, 6) for x in pixel.thresholds_at(np.arange(24))]
    np.testing.assert_allclose(shown, [on, off], rtol=1e-6)
    np.testing.assert_allclose(found.threshold_sd, [[0.02, 0.03]] * 24)
    rates = pixel.dynamics_at(np.array([0, 2, 4, 17])).numpy()[:, 3]
    np.testing.assert_allclose(rates, 1e4 * np.array([1.0, 0.5, 2.0, 1.0]))
    assert found.hot.tolist() == [2 * 6 + 3]
    # dvs128 beside follower and mismatch: no maps, and this circuit has none of them
    assert found.unused == tuple(f"{name} of the maps' model" for name in OTHERS)
    with pytest.raises(InputError, match=r"expected 5 × 4 as in the dataset, found 6 × 4"):
        maps_of_sensor(folder, CIRCUIT, pinhole(5, 4, 0.7))


def test_a_map_without_a_place_is_named(tmp_path):
    events = np.full((3, 3), 50)
    folder = sensor(tmp_path / "maps", [of_values("lower_cutoff.cutoff_hz", np.full((3, 3), 0.5), 0.1)], events)
    found = maps_of_sensor(folder, CIRCUIT, pinhole(3, 3, 0.7))
    assert [name for name in found.unused if name.startswith("map ")] == ["map of lower_cutoff.cutoff_hz"]
    assert found.bandwidth is None
    np.testing.assert_array_equal(found.threshold_sd, 0.1)  # no map of thresholds: the circuit's mismatch


def test_effects_of_the_model_of_the_maps_that_the_circuit_lacks_are_named(tmp_path):
    maps = [of_values(name, np.full((2, 2), 0.3), 0.1) for name in ("on_threshold", "off_threshold")]
    model = find_model("dvs128").with_effect("leak", {"rate_hz": 0.1}).with_effect("hot_pixels", {"count": 2.0})
    folder = sensor(tmp_path / "maps", maps, np.full((2, 2), 50), model=model)

    def lacking(circuit: Circuit) -> list[str]:
        return [name.split()[0] for name in maps_of_sensor(folder, circuit, pinhole(2, 2, 0.7)).unused]

    assert sorted(lacking(CIRCUIT.with_(mismatch=0.0))) == sorted((*OTHERS, "source_follower_pole", "leak"))
    same = model.circuit()
    assert lacking(same) == []
    assert lacking(same.with_(leak_hz=0.0)) == ["leak"]
    assert lacking(same.with_(leak_hz=7.0)) == []  # another strength is that of the circuit


@pytest.mark.parametrize(
    ("mapped", "circuit"),
    [
        ("sf_cutoff_hz", {}),
        ("diff_cutoff_hz", {"follower": 1e4}),
        ("alpha", {"differencing": 1e5}),
        ("gamma", {"photoreceptor": "one_pole", "corner": 100.0}),
    ],
)
def test_a_map_of_a_stage_that_the_circuit_lacks_is_named(mapped, circuit, tmp_path):
    """It would move a pole that is nowhere, and be reported as in use."""
    typical = find_model("dvs128").values[mapped]
    folder = sensor(tmp_path / "maps", [of_values(mapped, typical * np.array([[1.0, 2.0]]), 0.1)], np.full((1, 2), 50))
    found = maps_of_sensor(folder, CIRCUIT.with_(**circuit), pinhole(2, 1, 0.7))
    assert [name for name in found.unused if name.startswith("map ")] == [f"map of {mapped}"]
    assert found.bandwidth is None


def test_hot_pixels_are_those_that_no_light_explains():
    """Balanced events whose rate varies 30-fold along an edge hide nobody; ON events that nothing answers do."""
    rng = np.random.default_rng(2)
    side = 24
    rate = 8.0 + 240.0 * np.exp(-(((np.arange(side) - 9) / 2.0) ** 2))
    counts = rng.poisson(np.tile(rate, (side, 1)))
    pixel = np.repeat(np.arange(side * side), counts.ravel())
    on = np.arange(len(pixel)) % 2 == 0
    camera = pinhole(side, side, 0.7)
    y, x = np.divmod(pixel, side)
    assert len(find_hot(x, y, on, camera, CIRCUIT, 1.0)) == 0
    slow, fast = 5 * side + 20, 11 * side + 3
    extra = np.repeat([slow, fast], [60, 4000])
    pixel, on = np.concatenate([pixel, extra]), np.concatenate([on, np.ones(len(extra), bool)])
    y, x = np.divmod(pixel, side)
    assert find_hot(x, y, on, camera, CIRCUIT, 1.0).tolist() == [slow, fast]


@pytest.mark.parametrize("every", [2, 4, 8])
def test_pixels_whose_light_rose_are_not_hot_where_most_pixels_were_not_kept(every):
    """Two thirds of a sensor brighten by 25 thresholds; one pixel of the rest fires ON alone."""
    side, rng = 48, np.random.default_rng(every)
    column = np.arange(side * side) % side
    bright = column < 32
    kept = rng.permutation(side * side) < side * side // every
    down = rng.poisson(10, side * side)
    up = down + np.where(bright, 25, 0)
    hot = np.flatnonzero(kept & (column > 40))[3]
    up[hot] += 60
    pixel = np.repeat(np.arange(side * side), up + down)
    on = np.concatenate([np.repeat([True, False], pair) for pair in zip(up, down, strict=True)])
    pixel, on = pixel[kept[pixel]], on[kept[pixel]]
    y, x = np.divmod(pixel, side)
    assert find_hot(x, y, on, pinhole(side, side, 0.7), CIRCUIT, 1.0, kept).tolist() == [hot]


def test_drifting_thresholds_and_their_memory_are_those_of_each_event():
    t = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 0.5, 1.5])
    on = np.array([True, True, False, False, True, True, False])
    x = np.array([0, 0, 0, 0, 0, 1, 1])
    spans = intervals(t, x, np.zeros(7, int), on, 2, drift=0.1, memory=0.05).stretches
    np.testing.assert_allclose(spans.rise, [1.1 + 0.05, 0, 0, 1.4 - 0.05, 0])
    np.testing.assert_allclose(spans.fall, [0, 1.2 - 0.05, 1.3 + 0.05, 0, 1.15 - 0.05])
    merged = intervals(t, x, np.zeros(7, int), on, 2, drift=0.1, memory=0.05, shortest=10.0).stretches
    np.testing.assert_allclose(merged.rise, [1.15 + 1.35, 0.0])
    np.testing.assert_allclose(merged.fall, [1.15 + 1.35, 1.1])
