"""Each estimator against events made with a known answer, against nothing to find, and on real files."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from pixelid.cli.main import main
from pixelid.inspection import inspect
from pixelid.inspection.ceiling import Paces
from pixelid.inspection.counts import BusiestWindow, Survey, counts_of
from pixelid.inspection.dead_time import find_dead_time
from pixelid.inspection.hot_pixels import find_hot_pixels_in_silence, hot_of_counts
from pixelid.inspection.intervals import intervals_of, pixel_intervals
from pixelid.inspection.lines import Spectra, _Segments
from pixelid.inspection.tick import find_tick
from pixelid.model.shipped import find_model
from pixelid.recordings import Events, Recording, open_recording, write_recording
from pixelid.recordings.crop import Crop
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp, constant

SHARED = Path(os.environ.get("PIXELID_SHARED", Path(__file__).parents[3] / "shared")) / "recordings"
WIDTH = 10


def find_lines(events: Events):
    first, last = (int(events.t[0]), int(events.t[-1])) if len(events) else (0, 0)
    spectra = Spectra(len(events), first, last)
    spectra.add(events)
    return spectra.lines(None)


def count(events: Events, pooled: bool = False):
    survey = Survey(events.width, events.height, pooled)
    survey.add(events)
    busiest = BusiestWindow(survey)
    busiest.add(events)
    return counts_of(survey, busiest)


def find_ceiling(events: Events, clock_s: float):
    survey = Survey(events.width, events.height, False)
    survey.add(events)
    paces = Paces(survey, clock_s)
    paces.add(events)
    return paces.ceiling()


def find_hot_pixels(events: Events):
    counts = np.bincount(events.pixel, minlength=events.width * events.height)
    return hot_of_counts(counts.reshape(events.height, events.width), events.duration_s)


def poisson_events(
    seed=0, rate_hz=50.0, seconds=2.0, pixels=100, dead_s=0.0, tick_ns=1, line=None, drift=0.0
) -> Events:
    """Independent pixels, each a Poisson process with a dead time; `line` = (frequency, modulation)."""
    rng = np.random.default_rng(seed)
    times, owners = [], []
    for pixel in range(pixels):
        gaps = rng.exponential(1 / rate_hz, int(1.5 * rate_hz * seconds + 30)) + dead_s
        t = np.cumsum(gaps) + rng.uniform(0, 1 / rate_hz)
        chance = 1 + drift * np.sin(2 * np.pi * 0.7 * t / seconds)
        if line is not None:
            chance = chance * (1 + line[1] * np.sin(2 * np.pi * line[0] * t)) / (1 + line[1])
        t = t[(t < seconds) & (rng.random(len(t)) < chance / (1 + drift))]
        times.append(t)
        owners.append(np.full(len(t), pixel))
    t, pixel = np.concatenate(times), np.concatenate(owners)
    order = np.argsort(t, kind="stable")
    t, pixel = (t[order] * 1e9 / tick_ns).astype(np.int64) * tick_ns, pixel[order]
    p = rng.integers(0, 2, len(t))
    return Events.from_columns(t, pixel % WIDTH, pixel // WIDTH, p, WIDTH, pixels // WIDTH, tick_ns=tick_ns)


def real(name: str) -> Recording:
    if not (SHARED / name).exists():
        pytest.skip("shared recordings absent")
    return open_recording(SHARED / name)


def dead_time(events: Events):
    intervals = pixel_intervals(events)
    return find_dead_time(intervals, find_tick(events, intervals).tick_s, intervals_of(events).pairs)


@pytest.mark.parametrize("tick_ns", [1, 1000, 50_000])
@pytest.mark.parametrize("seconds", [3e-4, 1e-3, 5e-3])
def test_a_known_dead_time_comes_back(seconds, tick_ns):
    estimates = [dead_time(poisson_events(seed, rate_hz=400, dead_s=seconds, tick_ns=tick_ns)) for seed in range(4)]
    for dead in estimates:
        assert dead.value_s == pytest.approx(seconds, rel=0.02, abs=0.5e-9 * tick_ns)
    covered = sum(dead.interval_95_s[0] <= seconds <= dead.interval_95_s[1] for dead in estimates)
    assert covered >= 3


def test_a_dead_time_is_measured_only_where_pixels_fire_at_random():
    for seed in range(4):
        assert dead_time(poisson_events(seed, rate_hz=400, dead_s=1e-3, tick_ns=1000, drift=0.5)).kind == "measured"
    few = dead_time(poisson_events(0, rate_hz=20, dead_s=1e-3, seconds=10.0))
    assert few.kind in (None, "upper_bound")


@pytest.mark.parametrize("refractory_s", [1e-6, 1e-5, 1e-4, 3e-4])
def test_pixels_that_follow_the_light_bound_the_dead_time(refractory_s):
    model = find_model("dvs128").set({"refractory_s": refractory_s})
    estimate = dead_time(simulate(model, chirp(), width=3, height=3, seed=0).events)
    assert estimate.kind == "upper_bound"
    low, high = estimate.interval_95_s
    assert low <= refractory_s <= high < refractory_s + 1.3e-4


def test_a_few_shorter_intervals_do_not_move_the_dead_time():
    intervals = pixel_intervals(poisson_events(3, rate_hz=400, dead_s=1e-3, tick_ns=1000))
    rng = np.random.default_rng(0)
    for share in (1e-4, 1e-3, 4e-3):
        short = rng.integers(1, 1000, int(share * len(intervals)) + 1) * 1000
        estimate = find_dead_time(np.concatenate([intervals, short]), 1e-6)
        assert estimate.value_s == pytest.approx(1e-3, rel=0.01)


@pytest.mark.parametrize(("jitter_us", "tolerance"), [(5, 0.03), (30, 0.04)])
def test_jitter_of_the_timestamps_leaves_the_dead_time_in_place(jitter_us, tolerance):
    for seed in range(5):
        intervals = pixel_intervals(poisson_events(seed, rate_hz=300, dead_s=1e-3, tick_ns=1000))
        noise = np.random.default_rng(seed).normal(0, jitter_us * np.sqrt(2), len(intervals))
        estimate = find_dead_time(intervals + np.rint(noise).astype(np.int64) * 1000, 1e-6)
        assert estimate.value_s == pytest.approx(1e-3, rel=tolerance)


def test_no_dead_time_is_found_where_there_is_none():
    for seed in range(25):
        for tick_ns in (1, 1000, 100_000):
            estimate = dead_time(poisson_events(seed, rate_hz=(5, 50, 300)[seed % 3], tick_ns=tick_ns, drift=0.5))
            assert estimate.value_s is None, estimate
            assert estimate.reason


def test_regular_firing_is_no_dead_time():
    for seed in range(10):
        intervals = np.rint(np.random.default_rng(seed).gamma(20, 5e5, 20_000)).astype(np.int64)
        assert find_dead_time(intervals, 1e-6).value_s is None


def test_a_dead_time_below_the_tick_is_not_claimed():
    estimate = dead_time(poisson_events(0, rate_hz=400, dead_s=1e-4, tick_ns=200_000))
    assert estimate.value_s is None


@pytest.mark.parametrize(("period_us", "jitter_us"), [(197.283, 0.3), (101.7, 0.0), (1000.0, 5.0), (61.03, 0.2)])
def test_a_scan_with_one_phase_per_row_is_found(period_us, jitter_us):
    events = poisson_events(1, rate_hz=60, seconds=3.0)
    rng = np.random.default_rng(2)
    phase = events.y * period_us / 10
    t = np.ceil(events.t * 1e-3 / period_us) * period_us + phase + rng.normal(0, 1, len(events)) * jitter_us + 100
    t = np.rint(t).astype(np.int64) * 1000
    order = np.argsort(t, kind="stable")
    events = Events.from_columns(t[order], events.x[order], events.y[order], events.p[order], 10, 10, tick_ns=1000)
    tick = find_tick(events, pixel_intervals(events))
    assert tick.scan_s == pytest.approx(period_us * 1e-6, rel=1e-4)
    assert tick.clock_s == pytest.approx(1e-6)


def test_a_grid_of_all_timestamps_is_the_clock():
    tick = find_tick(*(lambda e: (e, pixel_intervals(e)))(poisson_events(tick_ns=197_000)))
    assert tick.tick_s == pytest.approx(197e-6)


def test_no_scan_is_found_where_there_is_none():
    for seed in range(15):
        for line in (None, (120.0, 0.9), (1000.0, 0.9)):
            events = poisson_events(seed, rate_hz=100, tick_ns=1000, line=line, dead_s=1e-3)
            assert find_tick(events, pixel_intervals(events)).scan_s is None


@pytest.mark.parametrize("frequency", [7.3, 50.02, 120.0, 333.33, 1730.0])
def test_a_known_line_comes_back(frequency):
    lines = find_lines(poisson_events(5, rate_hz=100, line=(frequency, 0.3)))
    assert len(lines) == 1
    assert lines[0].frequency_hz == pytest.approx(frequency, abs=0.1)
    assert abs(lines[0].frequency_hz - frequency) < 5 * lines[0].uncertainty_hz
    assert lines[0].modulation == pytest.approx(0.3, abs=0.06)


def test_polarities_that_alternate_show_the_fundamental():
    rng = np.random.default_rng(0)
    t = np.sort(rng.uniform(0, 2, 40_000))
    p = (np.sin(2 * np.pi * 120 * t) > 0).astype(int)
    events = Events.from_columns((t * 1e9).astype(np.int64), np.zeros(40_000, int), np.zeros(40_000, int), p, 1, 1)
    lines = find_lines(events)
    assert lines[0].frequency_hz == pytest.approx(120, abs=0.1)
    assert len(lines) == 1


def test_lines_are_not_found_where_there_are_none():
    hits = 0
    for seed in range(60):
        hits += len(find_lines(poisson_events(seed, rate_hz=100, drift=0.8, dead_s=(0, 2e-3)[seed % 2], pixels=50)))
    for seed in range(60):  # bursts of random length and strength: strongly red, no line
        rng = np.random.default_rng(seed)
        rate = np.exp(np.cumsum(rng.normal(0, 0.05, 20_000)))
        counts = rng.poisson(2 * rate / rate.mean())
        t = np.sort((np.repeat(np.arange(20_000), counts) + rng.random(counts.sum())) * 1e-4)
        zero = np.zeros(len(t), int)
        hits += len(find_lines(Events.from_columns((t * 1e9).astype(np.int64), zero, zero, zero, 1, 1)))
    assert hits <= 1


def test_hot_pixels_are_found_and_edges_of_the_scene_are_not():
    events = poisson_events(2, rate_hz=20, pixels=400)
    rng = np.random.default_rng(0)
    extra = [(3, 7, 3000), (9, 30, 1500)]
    t = np.concatenate([events.t, *(rng.integers(0, 2 * 10**9, n) for *_, n in extra)])
    x = np.concatenate([events.x, *(np.full(n, a) for a, _, n in extra)])
    y = np.concatenate([events.y, *(np.full(n, b) for _, b, n in extra)])
    order = np.argsort(t, kind="stable")
    hot = find_hot_pixels(Events.from_columns(t[order], x[order], y[order], order % 2, 10, 40))
    assert [(pixel.x, pixel.y) for pixel in hot] == [(3, 7), (9, 30)]
    assert hot[0].rate_hz == pytest.approx(1520, rel=0.05)
    for seed in range(20):
        assert find_hot_pixels(poisson_events(seed, rate_hz=(2, 30)[seed % 2])) == []


def saturate(events: Events, service_ns: int) -> Events:
    """One server: each event leaves `service_ns` after the later of its arrival and the previous departure."""
    step = np.arange(len(events)) * service_ns
    t = np.maximum.accumulate(events.t - step) + step + service_ns
    return Events(t, events.x, events.y, events.p, events.width, events.height)


def test_the_rate_of_hot_pixels_is_of_the_time_that_a_cut_has_kept():
    rng = np.random.default_rng(4)
    flash = np.repeat(np.arange(0.1, 50.0, 5.0), 20)
    own = np.sort(rng.uniform(0.0, 50.0, 200))
    t = np.concatenate([flash, own])
    order = np.argsort(t)
    x = np.concatenate([np.tile(np.arange(20), 10), np.full(200, 3)])[order]
    events = Events.from_columns((t[order] * 1e9).astype(int), x, 0 * x, 1 + 0 * x, 20, 1)
    whole = Recording(events, constant(duration_s=50.0))
    for recording in (whole, Crop(time_s=(25.0, 50.0)).applied(whole)):
        found = find_hot_pixels_in_silence([recording])
        assert found is not None
        assert found.pixels.tolist() == [3]
        assert found.signature.value == pytest.approx(4.0, rel=0.25)


def test_a_saturated_readout_is_told_from_a_busy_one():
    for seed in range(3):
        busy = poisson_events(seed, rate_hz=200, pixels=1000, seconds=1.0)
        assert not find_ceiling(busy, 1e-9).saturated
        full = find_ceiling(saturate(busy, 8000), 1e-9)
        assert full.saturated
        assert full.rate_hz == pytest.approx(125_000, rel=0.02)


def test_counts():
    events = Events.from_columns([0, 0, 10**9], [0, 0, 1], [0, 0, 0], [1, 1, 0], 2, 1)
    counts = count(events)
    assert (counts.events, counts.duration_s, counts.duplicates, counts.active_pixels) == (3, 1.0, 1, 2)
    assert counts.on_fraction == pytest.approx(2 / 3)
    assert counts.peak_hz == pytest.approx(2000)


@pytest.mark.parametrize("n", [0, 1, 2, 5])
def test_almost_empty_recordings_are_inspected(n):
    events = Events.from_columns(np.arange(n), np.zeros(n, int), np.zeros(n, int), np.ones(n, int), 1, 1)
    health = inspect(Recording(events)).to_dict()
    assert health["events"] == n
    assert health["dead_time_s"]["value"] is None
    assert health["lines"] == health["hot_pixels"] == []


def test_real_scan():
    assert inspect(real("dvxplorer_scan.aedat4")).tick.tick_s == pytest.approx(197e-6, rel=0.005)


def test_real_dead_time_and_frame_readout():
    health = inspect(real("davis346_aps.aedat4"))
    assert health.dead_time.value_s == pytest.approx(0.97e-3, rel=0.05)
    assert health.dead_time.edge_95_s == pytest.approx((0.870e-3, 0.975e-3), abs=1e-6)
    assert health.dead_time.kind == "upper_bound"  # a driven scene: successive intervals resemble each other
    assert health.dead_time.interval_95_s == pytest.approx((0.0, 0.975e-3), abs=1e-6)
    assert health.lines[0].frequency_hz == pytest.approx(25, abs=0.1)


@pytest.mark.parametrize(
    ("name", "frequency"),
    [("flicker120_gen31.npz", 120), ("davis346_flicker100.aedat4", 100), ("davis240_rotdisk.aedat", 100)],
)
def test_real_lamps(name, frequency):
    assert inspect(real(name)).lines[0].frequency_hz == pytest.approx(frequency, abs=0.1)


@pytest.mark.parametrize(
    ("name", "saturated"),
    [
        ("gen41_saturated.evt3.raw", True),
        ("gen3.evt2.raw", True),
        ("flicker120_gen31.npz", False),
        ("davis346_aps.aedat4", False),
        ("davis240_boxes.aedat", False),
        ("dvxplorer_scan.aedat4", False),
    ],
)
def test_real_ceilings(name, saturated):
    assert inspect(real(name)).ceiling.saturated is saturated


def test_command_writes_json_and_figures(tmp_path, capsys):
    write_recording(Recording(poisson_events(line=(100.0, 0.5))), tmp_path / "r.h5")
    arguments = ["inspect", str(tmp_path / "r.h5"), "--json", "--out", str(tmp_path / "out")]
    assert main(arguments) == 0
    result = json.loads(capsys.readouterr().out)
    assert result == json.loads((tmp_path / "out" / "inspect.json").read_text())
    assert {"events", "duration_s", "width", "height", "on_fraction", "rate_hz", "dead_time_s", "tick_s"} < set(result)
    assert {"lines", "hot_pixels", "ceiling", "versions", "inputs_sha256", "seed"} < set(result)
    assert result["lines"][0]["frequency_hz"] == pytest.approx(100, abs=0.1)
    for name in ("rate.svg", "intervals.svg", "pixels.svg"):
        assert (tmp_path / "out" / name).stat().st_size > 1000
    assert main(arguments) == 2
    assert "exists already" in capsys.readouterr().err
    assert main([*arguments, "--overwrite", "--quiet"]) == 0
    capsys.readouterr()
    assert main(["inspect", str(tmp_path / "r.h5")]) == 0
    assert "100.0" in capsys.readouterr().out


@pytest.mark.parametrize(
    "stretches", [((0, 2), (4, 6)), ((0, 2), (22, 24)), ((0, 4), (60, 60.001)), ((0, 10), (70, 80))]
)
def test_gaps_hide_no_line(stretches):
    """One taper over all lay on nothing: half the modulation of a lamp, or none."""
    rng, t, p = np.random.default_rng(1), [], []
    for begin, end in stretches:
        when = np.sort(rng.uniform(begin, end, rng.poisson(2e4 * (end - begin))))
        on = rng.random(len(when)) < 0.5
        wave = np.where(on, 1.0, -1.0) * np.sin(2 * np.pi * 100.0 * when)
        kept = rng.random(len(when)) < (1 + 0.5 * wave) / 1.5
        t.append(when[kept])
        p.append(on[kept])
    times, zero = np.concatenate(t), np.zeros(sum(map(len, t)), np.int64)
    events = Events.from_columns((times * 1e9).astype(np.int64), zero, zero, np.concatenate(p).astype(int), 1, 1)
    lines = find_lines(events)
    assert lines
    assert lines[0].frequency_hz == pytest.approx(100.0, abs=4 * max(lines[0].uncertainty_hz, 0.01))
    assert lines[0].modulation == pytest.approx(0.5, abs=0.06)
    even = np.sort(rng.uniform(*stretches[0], 30_000))
    still = np.concatenate([even, [stretches[1][0]]])
    zero = np.zeros(len(still), np.int64)
    assert find_lines(Events.from_columns((still * 1e9).astype(np.int64), zero, zero, zero, 1, 1)) == []


def test_a_stamp_from_long_ago_costs_nothing(monkeypatch):
    """Every second since was walked through, one by one."""
    walked, next_segment = [], _Segments._next
    monkeypatch.setattr(_Segments, "_next", lambda self: (walked.append(1), next_segment(self)))
    rng = np.random.default_rng(0)
    t = np.concatenate([[0], 1_700_000_000_000_000_000 + np.sort(rng.integers(0, 2_000_000_000, 5000))])
    zero = np.zeros(len(t), np.int64)
    assert find_lines(Events.from_columns(t, zero, zero, zero, 1, 1)) == []
    assert len(walked) < 10
