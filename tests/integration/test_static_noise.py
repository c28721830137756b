"""Histograms of intervals of a still scene: made from known processes here, and the real ones where they are."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pixelid.cli.main import main
from pixelid.errors import InputError
from pixelid.inspection.interval_counts import EDGES_HZ, EDGES_S, IntervalCounts, interval_counts, read_interval_counts
from pixelid.inspection.renewal import MAX_SLOW, SlowPixels, paces
from pixelid.inspection.static_noise import MIN_INTERVALS, static_noise
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import constant

SHARED = Path(os.environ.get("PIXELID_SHARED", Path(__file__).parents[3] / "shared")) / "recordings"
REAL = sorted(SHARED.glob("static_noise_*.npy"))
COARSE = np.array([0.05, 0.1, 0.2, 0.4])


def firing(rates_hz, cv, seconds, seed=0):
    """Counts of pixels that fire with Gamma intervals, in the steady state when the recording begins."""
    rng = np.random.default_rng(seed)
    counts = np.zeros((len(rates_hz), len(EDGES_S) - 1), int)
    for row, rate in zip(counts, rates_hz, strict=True):
        before = 30.0 / rate
        number = int(2 * (before + seconds) * rate + 60)
        t = np.cumsum(rng.gamma(cv**-2, cv**2 / rate, number)) - before + rng.uniform(0, 1 / rate)
        # bins as the files have them: 1/interval at or below the upper edge
        row[:] = np.histogram(1.0 / np.diff(t[(t > 0) & (t < seconds)]), EDGES_HZ)[0][::-1]
    return counts


def log_normal(median, spread, number, seed=0):
    return median * np.exp(spread * np.random.default_rng(seed).normal(size=number))


def saved(path, counts):
    """The layout of the files: counts below the upper edge of each bin, and a column of nothing."""
    below = np.cumsum(counts[:, ::-1], axis=1)
    np.save(path, np.append(below, np.zeros((len(below), 1)), axis=1).reshape(-1, 2, len(EDGES_HZ)))


@pytest.mark.parametrize("cv", [0.1, 0.4, 1.0])
def test_pace_and_regularity_of_fast_pixels_come_back(cv):
    rates = log_normal(5.0, 0.3, 200)
    counts = firing(rates, cv, 20.0)
    estimates = paces(counts, EDGES_S)
    assert np.median(estimates.mean_s * rates) == pytest.approx(1.0, abs=0.02)
    assert estimates.cv == pytest.approx(cv, rel=0.1)
    assert np.median((counts.sum(axis=1) + 1) * estimates.mean_s) == pytest.approx(20.0, rel=0.02)


@pytest.mark.parametrize(("mean_s", "cv"), [(5.0, 1.0), (25.0, 1.0), (8.0, 0.1), (6.0, 0.4)])
def test_number_of_intervals_in_a_window_is_that_of_a_renewal_process(mean_s, cv):
    counts = firing(np.full(20, 1.0 / mean_s), cv, 20.0)
    table = SlowPixels(counts, EDGES_S, 20.0, np.array([cv]))
    at = int(np.argmin(np.abs(table.means - mean_s)))
    # the grid of periods is 6 % wide: move the pixels to it
    counts = firing(np.full(4000, 1.0 / table.means[at]), cv, 20.0, seed=1)
    number = counts.sum(axis=1)
    measured = np.bincount(np.minimum(number, MAX_SLOW + 1), minlength=MAX_SLOW + 2)[: MAX_SLOW + 1] / 4000
    np.testing.assert_allclose(table.number[0, :, at], measured, atol=4 * 0.5 / np.sqrt(4000))


def test_slow_pixels_do_not_look_faster_for_lack_of_time():
    counts = firing(log_normal(0.06, 0.5, 1500), 0.1, 18.0)
    assert np.mean(counts.sum(axis=1) == 0) > 0.4
    estimate = SlowPixels(counts, EDGES_S, 18.0, np.array([0.05, 0.1, 0.2])).fit()
    assert estimate.rate_hz == pytest.approx(0.06, rel=0.1)
    assert estimate.spread == pytest.approx(0.5, abs=0.1)
    assert estimate.cv == pytest.approx(0.1, rel=0.2)
    assert estimate.log_likelihood - estimate.poisson > 100


def test_poisson_pixels_are_not_called_regular():
    estimate = SlowPixels(firing(np.full(600, 0.12), 1.0, 18.0), EDGES_S, 18.0, COARSE).fit()
    assert estimate.cv == 1.0 or estimate.irregular > 0.9


def session(leak_hz, slope, seconds=(18.0, 20.0), lux=(161.0, 3000.0), number=700):
    leak, by_light = log_normal(leak_hz, 0.8, number, 1), log_normal(slope, 0.25, number, 2)
    leak[:40] += np.linspace(1, 20, 40)  # a few are fast, as always
    return [
        IntervalCounts(f"at {at:g}", "ON", at, firing(leak + by_light * at, 0.06, s, seed=int(at)))
        for at, s in zip(lux, seconds, strict=True)
    ]


def test_leak_and_parasitic_photocurrent_come_back():
    estimate = static_noise(session(0.05, 3e-5), resamples=20)
    assert [c.kind for c in estimate.conditions] == ["regular", "regular"]
    for condition, seconds in zip(estimate.conditions, (18.0, 20.0), strict=True):
        assert condition.duration_s is not None
        assert condition.duration_s[0] == pytest.approx(seconds, rel=0.03)
        assert condition.duration_at_least_s < seconds
    fit = estimate.by_light
    assert fit is not None
    assert fit.leak_hz == pytest.approx(0.05, rel=0.15)
    assert fit.parasitic_hz_per_lux == pytest.approx(3e-5, rel=0.1)
    assert fit.leak_interval[0] < fit.leak_hz < fit.leak_interval[1]
    assert min(fit.nats_of_leak, fit.nats_of_parasitic) > 50
    np.testing.assert_allclose(fit.expected[:, 0], fit.measured[:, 0], rtol=0.3, atol=15)


@pytest.mark.slow
def test_leak_alone_has_no_parasitic_photocurrent():
    fit = static_noise(session(0.1, 1e-9), resamples=20).by_light
    assert fit is not None
    assert fit.nats_of_parasitic < 10  # lengths, known to a few per cent each, could be wrong together
    assert fit.parasitic_interval[0] * 3000 < 0.01


def test_simulated_leak_is_regular_and_simulated_shot_noise_is_not():
    model = find_model("dvs128")
    leaking = model.with_effect("leak", {"rate_hz": 3.7}).set({"threshold_sigma": 0.1})
    noisy = model.with_effect("shot_noise", {"density": 3e-3})
    kinds = {}
    for name, camera, light in (("leak", leaking, 24.0), ("shot", noisy, 1.0)):
        events = simulate(camera, constant(light, duration_s=12.0), width=6, height=6, seed=1).events
        measured = [interval_counts(events, p, light, name) for p in (1, 0)]
        estimate = static_noise(measured)
        kinds[name] = [c.kind for c in estimate.conditions]
        if name == "leak":
            assert estimate.conditions[0].cv is not None
            assert estimate.conditions[0].cv[0] == pytest.approx(0.1, rel=0.25)  # the threshold noise
            assert estimate.conditions[0].rate_hz is not None
            assert estimate.conditions[0].rate_hz[0] == pytest.approx(3.7, rel=0.02)
    assert kinds == {"leak": ["regular", "silent"], "shot": ["irregular", "irregular"]}


def test_files_are_read_as_written(tmp_path):
    counts = firing(np.full(30, 2.0), 0.1, 10.0)
    saved(tmp_path / "noise_pos_3klux.npy", counts)
    reread = read_interval_counts(tmp_path / "noise_pos_3klux.npy")
    assert (reread.polarity, reread.lux) == ("ON", 3000.0)
    np.testing.assert_array_equal(reread.counts, counts)


@pytest.mark.parametrize(
    ("name", "array", "says"),
    [
        ("noise.npy", np.zeros((4, 72)), "state it"),  # events, by its name
        ("n_pos_1lux.npy", np.zeros((4, 71)), "shape"),
        ("n_pos_1lux.npy", np.tile(np.arange(72.0)[::-1], (4, 1)), "rise"),
        ("n_pos_1lux.npy", np.full((4, 72), np.nan), "finite"),
        ("n_pos_1lux.npy", np.array([{"a": 1}]), "damaged or different file"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, capsys, name, array, says):
    np.save(tmp_path / name, array, allow_pickle=True)
    assert main(["inspect", str(tmp_path / name)]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert says in message


def test_missing_files_and_mixtures_are_refused(tmp_path, capsys):
    assert main(["inspect", str(tmp_path / "a_pos_1lux.npy")]) == 2
    assert "no such file" in capsys.readouterr().err
    assert main(["inspect", "a.h5", "b.h5"]) == 2
    assert "one recording at a time" in capsys.readouterr().err
    with pytest.raises(InputError, match="same pixels"):
        static_noise([replace(session(0.1, 1e-5, number=n)[0], lux=float(n)) for n in (50, 60)])


def test_command_writes_json(tmp_path, capsys):
    for polarity, rate in (("pos", 3.0), ("neg", 2.0)):
        saved(tmp_path / f"n_{polarity}_0.1lux.npy", firing(log_normal(rate, 0.2, 60), 0.8, 20.0))
    files = [str(tmp_path / f"n_{polarity}_0.1lux.npy") for polarity in ("pos", "neg")]
    assert main(["inspect", *files, "--out", str(tmp_path / "out")]) == 0
    assert "irregular" in capsys.readouterr().out
    result = json.loads((tmp_path / "out" / "static_noise.json").read_text())
    assert [c["kind"] for c in result["conditions"]] == ["irregular", "irregular"]
    assert result["conditions"][0]["rate_hz"][0] == pytest.approx(3.0, rel=0.1)
    assert len(result["inputs_sha256"]) == 2


# --- the real ones ---


@pytest.mark.skipif(len(REAL) < 6, reason="shared recordings absent")
def test_columns_of_the_real_files_count_up_to_the_next_edge():
    # density per Hz is continuous where decades meet only if column j ends at edge j + 1
    for path in REAL:
        counts = read_interval_counts(path).counts.sum(axis=0)[::-1]
        density, shifted = counts / np.diff(EDGES_HZ), counts[1:] / np.diff(EDGES_HZ)[:-1]
        meet = [k for k in (18, 27, 36) if min(counts[k - 1 : k + 1]) > 500]
        for k in meet:
            assert 0.4 < density[k] / density[k - 1] < 2.5
            assert not 0.4 < shifted[k - 1] / shifted[k - 2] < 2.5


@pytest.mark.skipif(len(REAL) < 6, reason="shared recordings absent")
@pytest.mark.slow
def test_real_noise():
    estimate = static_noise([read_interval_counts(path) for path in REAL])
    here = {(c.lux, c.polarity): c for c in estimate.conditions}
    assert {k: c.kind for k, c in here.items()} == {
        (0.1, "ON"): "irregular", (0.1, "OFF"): "irregular", (161.0, "ON"): "regular", (161.0, "OFF"): "silent",
        (3000.0, "ON"): "regular", (3000.0, "OFF"): "silent",
    }  # fmt: skip
    for (_, polarity), c in here.items():
        assert c.duration_s is not None
        assert c.duration_s[0] > c.duration_at_least_s
        if polarity == "OFF" and c.kind == "silent":
            assert c.second_event_hz is not None
            assert c.second_event_hz < 0.01
    assert estimate.by_light is not None
    assert estimate.by_light.leak_hz == pytest.approx(0.055, rel=0.1)
    assert estimate.by_light.parasitic_hz_per_lux == pytest.approx(2.8e-5, rel=0.1)
    assert MIN_INTERVALS > MAX_SLOW


def test_an_array_of_events_is_inspected_as_a_recording(tmp_path, capsys):
    t, across = np.arange(0, 5000, 10), np.arange(500)
    np.save(tmp_path / "events.npy", np.stack([t, across % 4, across % 3, across % 2]))
    assert main(["inspect", str(tmp_path / "events.npy")]) == 0
    assert "500" in capsys.readouterr().out
