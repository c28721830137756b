"""What training may add to a pixel, and how two pixels are compared on held-out events."""

from dataclasses import replace
from types import SimpleNamespace

import click
import numpy as np
import pytest
import torch

from pixelid.dynamics.trajectory import Dynamics, integrate
from pixelid.nerf.data.calibration import Calibration
from pixelid.nerf.data.camera import pinhole
from pixelid.nerf.effects.additions import ADDITIONS, tilts
from pixelid.nerf.effects.search import (
    _begun,
    _Bench,
    _candidates,
    _Place,
    _told,
    _with_named,
    with_trained_values,
)
from pixelid.nerf.events.intervals import CHAIN, chains, intervals
from pixelid.nerf.pixel.maps import PixelMaps
from pixelid.nerf.pixel.model import TRAINABLE, Bandwidth, Pixel
from pixelid.nerf.pixel.scan import respond
from pixelid.nerf.training.losses import amplifier_drift, changes, terms
from pixelid.nerf.training.residuals import Rows, apart, compare, of_every_pixel, of_some_pixels, residual_map
from pixelid.nerf.training.state import Problem
from pixelid.stages.circuit import Circuit
from tests.unit.test_nerf_stretches import QUICK, comparator

CIRCUIT = Circuit(photoreceptor="unlimited", on_threshold=0.2, off_threshold=0.2, refractory=1e-3)


def some_events(seed: int = 0, count: int = 400):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(2e-3, 2e-2, count))
    return t, rng.integers(0, 3, count), np.zeros(count, int), rng.random(count) < 0.6


def cut(circuit: Circuit):
    """Stretches of some events, bursts among them."""
    return intervals(
        *some_events(), 3, dead=circuit.refractory, shortest=0.02, drift=circuit.threshold_drift,
        memory=circuit.polarity_memory,
    )  # fmt: skip


@pytest.mark.parametrize(("name", "amount"), [("threshold_drift", 0.7), ("polarity_memory", -0.2)])
def test_tilts_say_what_a_strength_does_to_every_stretch(name, amount):
    """Against the events cut anew under that strength, thresholds of the circuit made smaller by the common part."""
    tilt = tilts(cut, CIRCUIT, [name])[name]
    nominal, there = (cut(c).stretches for c in (CIRCUIT, CIRCUIT.with_(**{ADDITIONS[name].field: amount})))
    grown = 1.0 + tilt.common * amount
    np.testing.assert_allclose(nominal.rise * grown + amount * tilt.rise, there.rise, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(nominal.fall * grown + amount * tilt.fall, there.fall, rtol=1e-5, atol=1e-5)
    assert tilt.threshold_factor(amount) == pytest.approx(1.0 / grown)
    assert float((tilt.rise + tilt.fall).sum()) == pytest.approx(0.0, abs=1e-3)  # the mean threshold is held
    assert tilts(cut, CIRCUIT, ["leak", "refractory"]) == {}


def test_a_leak_is_trained_from_nothing():
    """On the true light, events of a pixel whose amplifier drifts by 12 thresholds per second."""
    t = np.linspace(0.0, 1.0, 500_001)
    light = 1 + 0.6 * np.sin(2 * np.pi * 37 * t) + 0.3 * np.sin(2 * np.pi * 90 * t + 1)
    smooth = integrate(t[::10], light[::10], QUICK).at(t)[:, 2]
    when, on = comparator(smooth + 12.0 * 0.18 * t, t, 0.18, 0.18, 1e-4)
    circuit = Circuit(
        alpha=QUICK.alpha, beta=QUICK.beta, gamma=QUICK.gamma, follower=QUICK.follower, on_threshold=0.18,
        off_threshold=0.18, refractory=1e-4,
    )  # fmt: skip
    pixel = Pixel(circuit, Bandwidth("on", trained=("leak",)))
    zero = np.zeros(len(when), int)
    spans = intervals(when, zero, zero, on, 1, dead=circuit.refractory)
    batch = chains(spans, np.arange(0, len(spans.starts) - 16, 8), 100, 1000.0, np.random.default_rng(0))
    u = torch.tensor(np.log(np.interp(batch.t, t, light)))
    optimiser = torch.optim.Adam([pixel.added], lr=0.05)
    for _ in range(200):
        level, output = respond(u, pixel.dynamics, batch.t, batch.first)
        drift = amplifier_drift(u, batch.t, pixel.thresholds[0], pixel.strength("leak"), 0.0)
        loss = terms(changes(level, output, batch, None, None, drift), level, batch, *pixel.thresholds)["diff"]
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        pixel.keep_within_bounds()
    assert pixel.values()["leak.rate_hz"] == pytest.approx(12.0, rel=0.05)


def test_what_is_added_stays_above_its_bound():
    pixel = Pixel(CIRCUIT.with_(leak_hz=2.0), Bandwidth("off", trained=("leak", "threshold_drift")))
    with torch.no_grad():
        pixel.added.fill_(-100.0)
    pixel.keep_within_bounds()
    assert pixel.values()["leak.rate_hz"] == pytest.approx(0.0, abs=1e-12)
    assert pixel.values()["threshold_drift.per_s"] == pytest.approx(-100.0 * ADDITIONS["threshold_drift"].step)
    assert "parasitic_photocurrent.rate_hz_per_radiance" not in pixel.values()  # neither there nor trained


def test_chains_apart_share_no_stretch_and_leave_none_out():
    every = cut(CIRCUIT)
    starts = every.starts[apart(every)]
    pixel = every.stretches.pixel
    covered = np.zeros(len(pixel), int)
    for start in starts:
        some = np.arange(start, min(start + CHAIN, len(pixel)))
        covered[some[pixel[some] == pixel[start]]] += 1
    assert (covered == 1).all()


def test_some_pixels_are_whole_and_the_same_however_they_are_cut():
    t = np.cumsum(np.random.default_rng(4).uniform(2e-4, 2e-3, 9000))
    x, on = np.random.default_rng(5).integers(0, 30, 9000), np.random.default_rng(6).random(9000) < 0.5
    chosen = []
    for dead in (0.0, 1e-3):
        every = intervals(t, x, np.zeros(9000, int), on, 30, dead=dead, shortest=0.005)
        starts = apart(every)
        pixel = every.stretches.pixel[every.starts[starts]]
        some = of_some_pixels(every, starts, 60)
        assert 60 <= len(some) < 60 + np.bincount(pixel).max()
        for one in np.unique(pixel[some]):
            assert set(np.flatnonzero(pixel == one)) <= set(some.tolist())
        chosen.append(set(pixel[some].tolist()))
    assert len(chosen[0] & chosen[1]) >= min(map(len, chosen)) - 1


def rows(rest: np.ndarray, end: np.ndarray, burst: np.ndarray | None = None, begin: np.ndarray | None = None) -> Rows:
    n = len(rest)
    burst = np.zeros(n, bool) if burst is None else burst
    pixel = np.arange(n) // 20
    return Rows(
        pixel, end - 1.0 if begin is None else begin, end, rest, np.zeros(n), np.arange(n) % 2 == 0, burst,
        np.ones(n), 0.2,
    )  # fmt: skip


def test_a_pixel_that_explains_more_gains_and_one_that_does_not_gains_nothing():
    rng = np.random.default_rng(1)
    end, noise = np.arange(1000.0), rng.normal(0, 0.3, 1000)
    before = rows(noise + 0.3 * np.where(rng.random(1000) < 0.5, 1, -1), end)
    better = compare(before, rows(noise, end))
    assert better.share > 0.3
    assert better.p_value < 1e-6
    assert better.rows == 1000
    p_values = [compare(*(rows(rng.normal(0, 0.3, 1000), end) for _ in range(2))).p_value for _ in range(400)]
    assert np.mean(np.array(p_values) < 0.05) == pytest.approx(0.05, abs=0.04)


def test_rows_of_other_cuts_are_compared_where_they_end_alike():
    end = np.arange(1000.0)
    burst = end % 5 == 0
    before = rows(np.full(1000, 0.5), end, burst)
    other = rows(np.full(1000, 0.1), np.where(end % 7 == 0, end + 0.25, end), burst, begin=end - 0.5)
    assert compare(before, other).rows == int((~burst & (end % 7 != 0)).sum())
    nothing = compare(before, replace(other, end=other.end + 0.1))
    assert (nothing.share, nothing.p_value, nothing.rows) == (0.0, 1.0, 0)


def test_sums_between_rows_count_what_single_rows_hide():
    """Contrast lost in bursts: the quiet rows are explained as well, and what lies between them is not."""
    end = np.arange(1000.0)
    burst = end % 5 == 0
    rest = np.where(burst, 0.0, 0.2)
    lost = np.where(burst, np.where(end % 10 == 0, 3.0, -3.0), 0.2)
    begin = end - 0.5
    begin[0] += 0.1  # so that they count as cut differently
    assert compare(rows(rest, end, burst), rows(lost, end, burst, begin=begin)).share < -0.1


def test_a_residual_map_shows_what_depends_on_the_interval():
    end = np.cumsum(np.random.default_rng(2).uniform(0.01, 1.0, 2000))
    begin = np.concatenate([[0.0], end[:-1]])
    length = end - begin
    on = np.arange(2000) % 2 == 0
    before = rows(np.where(on, 1.0, -1.0) * (0.5 - length), end, begin=begin)
    found = residual_map(before=before, after=rows(np.zeros(2000), end, begin=begin))["interval_s"]
    for polarity in ("on", "off"):
        assert found[f"{polarity}_before"][0] > 0.3
        assert found[f"{polarity}_before"][-1] < -0.3
        assert found[f"{polarity}_after"] == pytest.approx([0.0] * 8)


def test_the_filter_can_be_trained_alone():
    dynamics = Dynamics(*Pixel(Circuit(
        alpha=QUICK.alpha, beta=QUICK.beta, gamma=QUICK.gamma, follower=QUICK.follower, on_threshold=0.2,
        off_threshold=0.2,
    ), Bandwidth("on", trained=("alpha",))).dynamics.tolist())  # fmt: skip
    assert dynamics.alpha == pytest.approx(QUICK.alpha)
    pixel = Pixel(CIRCUIT.with_(photoreceptor="second_order", alpha=1e6, beta=1e3, gamma=1.0, follower=1e4),
                  Bandwidth("on", trained=("alpha",)))  # fmt: skip
    with torch.no_grad():
        pixel.factors.fill_(np.log(2.0))
    assert pixel.values()["alpha"] == pytest.approx(2e6)
    assert pixel.values()["follower"] == pytest.approx(1e4)


def test_the_command_offers_what_can_be_trained():
    from pixelid.cli import reconstruct_command

    (train,) = (p for p in reconstruct_command.command.params if "--train" in p.opts)
    assert isinstance(train.type, click.Choice)
    assert tuple(train.type.choices) == TRAINABLE == ("threshold", "ratio", *ADDITIONS)


def a_calibration(circuit: Circuit) -> Calibration:
    return Calibration(pinhole(8, 8, 0.7), "", circuit, np.zeros(1), 1.0, True)


def test_a_told_leak_stays_what_it_is_where_thresholds_are_told_anew():
    """It is counted in thresholds, and those change where the tilt of a drift holds their mean."""
    circuit = replace(CIRCUIT, leak_hz=20.0)
    tilt = tilts(cut, circuit, ["threshold_drift"])
    problem = SimpleNamespace(tilts=tilt, shortest=2e-3)
    begun = _begun("threshold_drift", a_calibration(circuit), 0.5, problem).circuit
    assert begun.on_threshold != pytest.approx(circuit.on_threshold, rel=0.02)
    assert begun.leak_hz * begun.on_threshold == pytest.approx(20.0 * circuit.on_threshold)
    pixel = Pixel(circuit, Bandwidth("off", trained=("threshold_drift",)))
    with torch.no_grad():
        pixel.added[list(ADDITIONS).index("threshold_drift")] = 0.5
    after = with_trained_values(a_calibration(circuit), pixel, problem).circuit
    assert after.threshold_drift != 0.0
    assert after.leak_hz * after.on_threshold == pytest.approx(20.0 * circuit.on_threshold)


def test_only_what_was_named_is_handed_on():
    """Filter and thresholds that the search has trained stay as told, those that a drift begins from among them."""
    told = replace(CIRCUIT, photoreceptor="second_order", alpha=1e6, beta=1e3, gamma=1.0, follower=1e4)
    found = replace(
        told, alpha=3e6, follower=2e4, on_threshold=0.1, off_threshold=0.05, leak_hz=40.0, refractory=2e-3,
        threshold_drift=0.5, mismatch=0.03,
    )  # fmt: skip
    circuits = [a_calibration(circuit) for circuit in (told, found)]
    for names, given in (
        (["leak"], {"leak_hz": 40.0}),
        (["refractory", "bandwidth"], {"refractory": 2e-3, "alpha": 3e6, "follower": 2e4}),
        (["leak", "threshold_drift"], {"leak_hz": 40.0, "threshold_drift": 0.5}),
        (["threshold_mismatch"], {"mismatch": 0.03}),
    ):
        assert _with_named(*circuits, names).circuit == replace(told, **given)


def test_reported_thresholds_are_those_of_the_typical_event_and_pixel():
    """A drift that tilts them and a map of single pixels both move their mean; a leak in ln L per second stays."""
    circuit = replace(CIRCUIT, leak_hz=20.0)
    tilt = tilts(cut, circuit, ["threshold_drift"])
    maps = PixelMaps(np.log([[1.5, 0.5], [1.5, 0.5], [1.5, 0.5]]), np.zeros((3, 2)))
    pixel = Pixel(circuit, Bandwidth("off", trained=("threshold_drift",)), maps)
    with torch.no_grad():
        pixel.added[list(ADDITIONS).index("threshold_drift")] = 0.5
    told = Problem.values(SimpleNamespace(tilts=tilt), pixel)  # type: ignore[arg-type]
    factor = tilt["threshold_drift"].threshold_factor(float(pixel.addition("threshold_drift").detach()))
    assert abs(factor - 1.0) > 0.02
    assert told["on_threshold"] == pytest.approx(0.3 * factor)
    assert told["off_threshold"] == pytest.approx(0.1 * factor)
    assert told["leak.rate_hz"] * told["on_threshold"] == pytest.approx(20.0 * 0.2)


def test_values_are_of_stages_that_are_there():
    """What a kernel takes for an infinite cutoff is no number to report."""
    ideal = Pixel(CIRCUIT, Bandwidth("on")).values()
    assert not {"alpha", "beta", "gamma", "follower"} & set(ideal)
    one = Pixel(Circuit(photoreceptor="one_pole", corner=30.0, follower=500.0, on_threshold=0.2, off_threshold=0.2),
                Bandwidth("joint"))  # fmt: skip
    with torch.no_grad():
        one.factors[0] = np.log(2.0)
    told = one.values()
    assert (told["corner"], told["follower"]) == (pytest.approx(60.0), 500.0)
    assert "alpha" not in told


def test_a_trained_corner_of_one_pole_is_kept():
    circuit = Circuit(photoreceptor="one_pole", corner=30.0, on_threshold=0.2, off_threshold=0.2)
    pixel = Pixel(circuit, Bandwidth("joint"))
    with torch.no_grad():
        pixel.factors[0] = np.log(2.0)
    after = with_trained_values(a_calibration(circuit), pixel, SimpleNamespace(tilts={})).circuit
    assert after.corner == pytest.approx(60.0)
    assert np.isnan(after.alpha)  # of which one pole knows nothing


def test_a_dead_time_is_not_tried_below_the_one_that_is_told():
    calibration = a_calibration(CIRCUIT)
    assert "refractory" in _candidates(calibration, Bandwidth("off"), False, shortest=2e-3)
    assert "refractory" not in _candidates(calibration, Bandwidth("off"), False, shortest=1.1e-3)


FILTERS = {
    "one pole": (replace(CIRCUIT, photoreceptor="one_pole", corner=30.0), {"corner": 30.0}),
    "follower": (replace(CIRCUIT, follower=500.0), {"follower": 500.0}),
    "second order": (
        replace(CIRCUIT, photoreceptor="second_order", alpha=9.0, beta=1.0, gamma=1.0, follower=500.0),
        {"alpha": 9.0, "follower": 500.0},
    ),
}


@pytest.mark.parametrize("kind", FILTERS)
def test_another_bandwidth_is_tried_of_whatever_filters(kind):
    """And of nothing else: not where the filter is ignored, trained anyway, or absent."""
    circuit, cutoffs = FILTERS[kind]
    calibration = a_calibration(circuit)
    assert "bandwidth" in _candidates(calibration, Bandwidth("on"), False, shortest=0.0)
    for other in (Bandwidth("off"), Bandwidth("joint"), Bandwidth("on", 1)):
        assert "bandwidth" not in _candidates(calibration, other, False, shortest=0.0)
    without = replace(circuit, photoreceptor="unlimited", follower=np.inf)
    assert "bandwidth" not in _candidates(a_calibration(without), Bandwidth("on"), False, shortest=0.0)
    assert _told("bandwidth", calibration) == cutoffs
    found = replace(circuit, **{name: 2.0 * value for name, value in cutoffs.items()}, leak_hz=3.0)
    named = _with_named(calibration, a_calibration(found), ["bandwidth"]).circuit
    assert _told("bandwidth", a_calibration(named)) == {name: 2.0 * value for name, value in cutoffs.items()}
    assert named.leak_hz == 0.0  # not named, so as told


def test_chains_of_every_pixel_are_drawn_evenly():
    every = cut(CIRCUIT)
    starts = apart(every)
    pixel = every.stretches.pixel[every.starts[starts]]
    some = of_every_pixel(every, starts, 6)
    assert (np.bincount(pixel[some], minlength=3) == 2).all()
    assert (np.diff(some) > 0).all()
    assert len(of_every_pixel(every, starts, 10**6)) == len(starts)
    assert (np.bincount(pixel[of_every_pixel(every, starts, 1)]) == 1).all()  # each is asked, however few


class Bench(_Bench):
    """Whose places are numbers: what each explains, and the turn from which on it has diverged."""

    def __init__(self, explains: list[float], until: list[float]) -> None:
        object.__setattr__(self, "explains", explains)
        object.__setattr__(self, "until", until)

    def grown(self, here, at_rest):
        k, turn = here.state.k, here.state.turn + 1
        finite = turn < self.until[k]  # type: ignore[attr-defined]
        return replace(here, state=SimpleNamespace(k=k, turn=turn, finite=finite))

    def rows(self, here):
        rest = np.where(np.arange(1000) % 2 == 0, 1.0, -1.0) * (1.0 - self.explains[here.state.k])  # type: ignore[attr-defined]
        return rows(rest if here.state.finite else rest * np.nan, np.arange(1000.0))


@pytest.mark.parametrize(
    ("until", "which"), [((9, 9, 9), 1), ((9, 2, 9), 2), ((2, 9, 9), 1), ((1, 2, 9), 2), ((1, 2, 1), None)]
)
def test_of_rivals_that_settle_those_that_diverge_are_left_out(until, which):
    """The second explains most, the third more than the first."""
    places = [_Place(a_calibration(CIRCUIT), (), SimpleNamespace(k=k, turn=0, finite=True)) for k in range(3)]  # type: ignore[arg-type]
    found = Bench([0.1, 0.5, 0.3], list(until)).settled(places)
    assert (found and found[0]) == which
    if found:
        assert found[1].state.k == which


def test_a_candidate_that_diverges_explains_nothing():
    bench = Bench([0.1, 0.5], [9, 9])
    there = [
        _Place(a_calibration(CIRCUIT), (), SimpleNamespace(k=k, turn=0, finite=finite))  # type: ignore[arg-type]
        for k, finite in ((0, True), (1, True), (1, False))
    ]
    assert bench._gain(bench.rows(there[0]), there[1]).share > 0.3
    assert bench._gain(bench.rows(there[0]), there[2]) == (0.0, 1.0, 1000)


class LineSearched(_Bench):
    """Whose scenes explain held-out events the better the nearer a drift is to the best one, on a scale of factors."""

    def __init__(self, best: float, told: bool) -> None:
        told_all = {"best": best, "told": told, "steps": 1, "make": lambda *_, **__: SimpleNamespace(tilts={})}
        for name, value in told_all.items():
            object.__setattr__(self, name, value)

    def go_on(self, here, steps):
        assert "threshold_drift" not in here.trained  # or a scene that has not followed yet would pull it back
        return here

    def rows(self, here):
        missed = abs(np.log2(here.calibration.circuit.threshold_drift / self.best))  # type: ignore[attr-defined]
        rng = np.random.default_rng(int(abs(1e6 * here.calibration.circuit.threshold_drift)))
        rest = 1.0 + missed + (0.01 if self.told else 30.0) * rng.standard_normal(1000)  # type: ignore[attr-defined]
        return rows(rest, np.arange(1000.0))


@pytest.mark.parametrize(
    ("best", "end"), [(0.8, 0.8), (0.1, 0.1), (0.28, 0.1 * 2**1.5), (0.075, 0.1 * 0.5**0.5), (-0.8, -0.8)]
)
def test_a_drift_is_looked_for_by_factors_until_held_out_events_are_explained_no_better(best, end):
    circuit = CIRCUIT.with_(threshold_drift=float(np.copysign(0.1, best)))
    here = _Place(a_calibration(circuit), ("leak", "threshold_drift"), SimpleNamespace(finite=True))  # type: ignore[arg-type]
    found = LineSearched(best, told=True).line_search(here, "threshold_drift")
    assert found.calibration.circuit.threshold_drift == pytest.approx(end)
    assert found.trained == ("leak",)
    noisy = LineSearched(best, told=False).line_search(here, "threshold_drift")
    assert noisy.calibration.circuit.threshold_drift == circuit.threshold_drift
