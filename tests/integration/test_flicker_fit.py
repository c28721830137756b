"""Flicker fits: phase tables count right, known truth comes back, and one frequency fixes little of a circuit."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pixelid.cli.main import main
from pixelid.errors import InputError
from pixelid.model.shipped import find_model
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.recordings.writing import write_recording
from pixelid.tables.flicker import fit_flicker
from pixelid.tables.flicker.circuit import read_circuit, response
from pixelid.tables.flicker.fit import waveform_gains
from pixelid.tables.flicker.noisy import NAMES, fit_group, rates
from pixelid.tables.flicker.phases import BINS, PhaseTable, locked_frequency, phase_table, quiet_windows
from pixelid.tables.flicker.result import flicker_result
from pixelid.tables.flicker.waveforms import FINE, PULSE, WAVEFORMS, as_harmonics, harmonics

F = 120.0
SINE = WAVEFORMS["sine"]
TRUTH = np.array([np.log(0.9), np.log(0.8), 0.3, np.log(0.35), np.log(30.0), np.log(0.5), np.log(0.8), 0.6])


def _simulated(x=TRUTH, pixels=800, duration=1.5, seed=0, width=40) -> Events:
    """Events of noisy comparators with the rates of `noisy.rates`, drawn by thinning."""
    rng = np.random.default_rng(seed)
    rate = rates(x, SINE)[0]
    top = rate.sum(0).max()
    t, p, pixel = [], [], []
    for k in range(pixels):
        now, reset = 0.0, int(rng.integers(BINS))
        while True:
            now += rng.exponential(1 / top)
            if now > duration:
                break
            here = int(now * F % 1 * BINS)
            on, off = rate[0, reset, here], rate[1, reset, here]
            u = rng.uniform(0, top)
            if u < on + off:
                t.append(now), p.append(int(u < on)), pixel.append(k)
                reset = here
    order = np.argsort(t)
    t, p, pixel = (np.array(c)[order] for c in (t, p, pixel))
    return Events.from_columns(
        np.rint(t * 1e9).astype(np.int64), pixel % width, pixel // width, p, width, pixels // width
    )


@pytest.fixture(scope="module")
def events():
    return _simulated()


def test_a_phase_table_holds_every_interval_and_every_second(events):
    window = (float(events.t[0] * 1e-9), 1.2)
    table = phase_table(events, np.ones(800, bool), F, [window])
    t, total, counted = events.t * 1e-9, 0.0, 0
    for k in range(800):
        mine = t[(events.pixel == k) & (t < window[1])]
        total += window[1] - mine[0] if len(mine) else 0.0
        counted += max(len(mine) - 1, 0)
    assert table.exposure.sum() == pytest.approx(total, rel=1e-9)
    assert table.on.sum() + table.off.sum() == counted == table.events


def test_the_frequency_is_found(events):
    lock = locked_frequency(events, 119.0, quiet_windows(events, 119.0))
    assert lock.sure
    assert lock.error_hz < 0.05
    assert lock.frequency_hz == pytest.approx(F, abs=max(4 * lock.error_hz, 0.02))


@pytest.mark.parametrize(
    ("f", "seconds", "pixels"), [(120.3, 20.0, 1), (507.3, 20.0, 10), (1010.0, 10.0, 10), (60.02, 300.0, 4)]
)
def test_the_frequency_of_long_recordings_and_of_few_pixels_is_found(f, seconds, pixels):
    """One pixel is no tenth of itself; and the longer a recording, the finer the grid has to be."""
    for near in (f / 1.015, f / 0.985):
        lock = locked_frequency(_periodic(f, seconds, pixels), near, [(0.0, seconds)])
        assert lock.sure
        assert abs(lock.frequency_hz - f) < 5.0 * lock.error_hz < 0.1 / seconds


def test_what_is_not_there_is_not_locked_to():
    for near in (117.5, 123.5):  # the lamp is 2.4 % away
        assert not locked_frequency(_periodic(120.3, 5.0, 8), near, [(0.0, 5.0)]).sure
    sure = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        noise = _events(np.sort(rng.random(3000) * 5.0), rng.integers(0, 2, 3000), rng.integers(0, 12, 3000))
        sure.append(locked_frequency(noise, 120.0, [(0.0, 5.0)]).sure)
    assert not any(sure)


def _periodic(f, seconds, pixels):
    """ON events early and OFF events late in the period, smeared, half of them missing."""
    rng, t, p, pixel = np.random.default_rng(1), [], [], []
    for k in range(pixels):
        for on, phase in ((1, 0.3), (0, 0.8)):
            cycles = np.flatnonzero(rng.random(int(f * seconds) - 1) > 0.5)
            t.append((cycles + phase + 0.1 * rng.normal(size=len(cycles))) / f)
            p.append(np.full(len(cycles), on)), pixel.append(np.full(len(cycles), k))
    t, p, pixel = (np.concatenate(each) for each in (t, p, pixel))
    order = np.argsort(t)
    return _events(t[order], p[order], pixel[order])


def _events(t, p, pixel):
    t = np.rint(np.maximum(t, 0.0) * 1e9).astype(np.int64)
    return Events.from_columns(t, pixel, 0 * pixel, p, int(pixel.max()) + 1, 1)


def test_no_light_is_not_identified_and_one_wrong_time_is_told():
    rng = np.random.default_rng(3)
    t, p, pixel = np.sort(rng.random(6000) * 3.0), rng.integers(0, 2, 6000), rng.integers(0, 12, 6000)
    found = fit_flicker(Recording(_events(t, p, pixel)), find_model("dvs128"), grid=(1, 1))
    written = flicker_result(found)
    assert (written["status"], written["frequency_hz"]["identified"]) == ("not_identified", False)
    assert not any(value["identified"] for value in written["groups"][0].values() if isinstance(value, dict))
    t[-1] = 9e8
    with pytest.raises(InputError, match="one timestamp"):
        quiet_windows(_events(t, p, pixel), F)


def test_known_amplitude_phase_and_noise_come_back(events):
    table = phase_table(events, np.ones(800, bool), F, [(float(events.t[0] * 1e-9), 1.5)])
    fit = fit_group(table, SINE)
    sd = np.sqrt(np.diag(np.linalg.inv(fit.information)))
    assert fit.converged
    assert np.all(np.abs((fit.x - TRUTH) / sd) < 4), dict(zip(NAMES, (fit.x - TRUTH) / sd, strict=True))
    assert fit.dispersion == pytest.approx(1.0, abs=0.2)
    assert fit.log_likelihood > fit_group(table, SINE, memory=1.0).log_likelihood + 5


def _in_time(amplitude, ratio, noise, nu, frequency, seconds, pixels, seed=0) -> Events:
    """Events of noisy comparators in small steps of time: no bins of phase, and none of the module's rates."""
    rng = np.random.default_rng(seed)
    step = 0.01 / nu
    reference, found = np.zeros(pixels), []
    for k in range(int(seconds / step)):
        level = amplitude * np.sin(2.0 * np.pi * frequency * (k + 0.5) * step)
        z = level - reference
        on = 0.3 + nu * np.exp(-0.5 * (np.maximum(1.0 - z, 0.0) / noise) ** 2)
        off = 0.1 + nu * np.exp(-0.5 * (np.maximum(ratio + z, 0.0) / noise) ** 2)
        fires = np.flatnonzero(rng.random(pixels) < -np.expm1(-(on + off) * step))
        up = rng.random(len(fires)) < on[fires] / (on + off)[fires]
        found += [((k + 0.5) * step, pixel, sign) for pixel, sign in zip(fires, up, strict=True)]
        reference[fires] = level
    t, pixel, p = (np.array(column) for column in zip(*found, strict=True))
    return _events(t, p.astype(int), pixel)


def test_a_light_of_several_thresholds_is_not_smeared_by_bins_of_phase():
    events = _in_time(2.0, 1.2, 0.3, 960.0, F, 2.0, 36)
    fit = fit_group(phase_table(events, np.ones(events.width * events.height, bool), F, [(0.0, 2.0)]), SINE)
    error = np.sqrt(np.diag(np.linalg.pinv(fit.information)))
    wanted = np.log([2.0, 1.2, 0.3, 960.0])
    assert (np.abs(fit.x[[0, 1, 3, 4]] - wanted) < 3.0 * error[[0, 1, 3, 4]]).all()
    assert error[0] < 0.02  # 32 bins were off by 5 %


@pytest.mark.parametrize("gap", [(0.3, 1.1), (0.2, 0.5)])
def test_a_gap_is_no_quiet_light(events, gap):
    kept = events.select((events.t < gap[0] * 1e9) | (events.t > gap[1] * 1e9))
    windows = quiet_windows(kept, F)
    inside = np.zeros(len(kept), bool)
    for a, b in windows:
        inside |= (kept.t >= a * 1e9) & (kept.t < b * 1e9)
    assert inside.mean() > 0.7
    assert all(b <= gap[0] + 0.1 or a >= gap[1] - 0.1 for a, b in windows)


def test_slices_hold_periods_of_slow_light(events):
    slow = Events(events.t * 60, events.x, events.y, events.p, events.width, events.height)  # 2 Hz in 90 s
    windows = quiet_windows(slow, F / 60.0)
    assert sum(b - a for a, b in windows) > 0.8 * slow.duration_s


def test_the_right_shape_wins():
    x = TRUTH.copy()
    x[0] = np.log(1.5)
    exposure = np.full((BINS, BINS), 5.0)
    counts = np.random.default_rng(0).poisson(rates(x, WAVEFORMS["rectified"])[0] * exposure)
    table = PhaseTable(counts[0], counts[1], exposure, 1, int(counts.sum()))
    log_likelihoods = {name: fit_group(table, one).log_likelihood for name, one in WAVEFORMS.items() if name != "pulse"}
    assert max(log_likelihoods, key=lambda s: log_likelihoods[s]) == "rectified"


def test_shapes_are_normalised():
    for waveform in (*WAVEFORMS.values(), harmonics(5)):
        g = waveform.fine(np.array(waveform.begin))
        assert g.mean() == pytest.approx(0, abs=1e-12)
        assert np.ptp(g) == pytest.approx(2)


@pytest.mark.parametrize("waveform", [SINE, PULSE, harmonics(3)], ids=lambda waveform: waveform.name)
def test_derivatives_of_rates_are_those_of_differences(waveform):
    x = np.append(TRUTH, [np.log(0.13), np.log(0.8), 0.1, -0.4][: len(waveform.numbers)])
    slopes = rates(x, waveform, 32)[1]
    for k in range(len(x)):
        size = 1e-3 if k == 2 else 1e-5  # places of a waveform are as far apart as a step of the phase
        step = size * np.eye(len(x))[k]
        wanted = (rates(x + step, waveform, 32)[0] - rates(x - step, waveform, 32)[0]) / (2 * size)
        if not (waveform.name == "pulse" and k == 2):  # a pulse's corners lie between places
            assert slopes[k] == pytest.approx(wanted, abs=0.01 * np.abs(wanted).max())


def test_a_pulse_behind_one_pole_is_that_of_a_circuit():
    """Charge and discharge by small steps, until one period is like the one before."""
    duty, corner = 0.13, 0.8
    level, step, values = 0.0, 1.0 / (8 * FINE), []
    for k in range(20 * 8 * FINE):
        level += 2 * np.pi * corner * step * (float((k * step) % 1.0 < duty) - level)
        values.append(level)
    last = np.roll(np.array(values[-8 * FINE :]), 1)[::8]
    last = (last - last.mean()) * 2.0 / np.ptp(last)
    assert PULSE.fine(np.log([duty, corner])) == pytest.approx(last, abs=0.02)


def test_a_waveform_as_harmonics_is_the_same_at_its_phase():
    g = PULSE.fine(np.log([0.2, 0.5]))
    lag, numbers = as_harmonics(g, 16)
    assert harmonics(16).at(numbers, np.arange(FINE) / FINE - lag)[0] == pytest.approx(g, abs=0.06)


def _of_waveform(numbers, waveform, seconds=2.0):
    x = np.append(TRUTH, numbers)
    x[0], x[7] = np.log(1.5), 1.0
    exposure = np.full((BINS, BINS), seconds)
    counts = np.random.default_rng(4).poisson(rates(x, waveform)[0] * exposure)
    return PhaseTable(counts[0], counts[1], exposure, 1, int(counts.sum()))


def test_the_cutoff_behind_a_pulse_comes_back():
    wanted = np.log([0.1, 0.8])
    fit = fit_group(_of_waveform(wanted, PULSE), PULSE)
    error = np.sqrt(np.diag(np.linalg.pinv(fit.information)))[8:]
    assert fit.converged
    assert (np.abs(fit.x[8:] - wanted) < 3.5 * error).all()
    assert (error < 0.1).all()


def test_only_harmonics_that_the_events_carry_are_paid_for():
    """Of a sine none; of a waveform of four those four, and eight are no better."""
    for order, numbers in ((1, []), (4, [0.4, -0.3, 0.0, 0.3, -0.25, 0.1])):
        table = _of_waveform(numbers, harmonics(order) if order > 1 else SINE)
        first = fit_group(table, SINE)
        found = {"sine": {(0, 0): first}}
        for more in (2, 4, 8):
            lag, begin = as_harmonics(first.waveform.fine(first.x[8:]), more)
            start = np.concatenate([first.x[:8] + lag * np.eye(8)[2], begin])
            found[f"harmonics ({more})"] = {(0, 0): fit_group(table, harmonics(more), [start])}
        gains = waveform_gains(found)
        assert max(gains, key=lambda name: gains[name]) == ("sine" if order == 1 else "harmonics (4)")


def test_poor_groups_with_many_events_are_named(events):
    found = fit_flicker(Recording(events), find_model("dvs128"), grid=(2, 1))
    assert found.judge()[0] == "converged"
    bad = replace(found.groups[1], fit=replace(found.groups[1].fit, dispersion=8.0))
    status, advice = replace(found, groups=(found.groups[0], bad)).judge()
    assert status == "misfit"
    assert "group 1, 0: 8.0" in advice


def test_one_frequency_leaves_the_circuit_open():
    model = find_model("dvs128")
    information = [1e4 * np.eye(4)] * 3
    reading = read_circuit(F, information, model.values, np.array([10.0, 50.0, 300.0]), equal_contrast=False)
    for name in ("alpha", "beta", "gamma", "sf_cutoff_hz", "diff_cutoff_hz", "on_threshold", "lamp_phase_cycles"):
        assert np.isinf(reading.sd[name])
    # 3 groups: 3 amplitudes, 3 phases, one ratio of thresholds, one of noise
    assert reading.fixed == 8
    assert reading.fixed + reading.blind == len(reading.sd)


def test_the_response_matches_the_simulated_trajectory():
    from pixelid.dynamics.of_circuit import dynamics_of
    from pixelid.dynamics.trajectory import integrate

    model = find_model("dvs128")
    t = np.arange(0, 0.1, 1e-5)
    u = np.log(100.0) + 0.01 * np.sin(2 * np.pi * F * t)
    run = integrate(t, np.exp(u), dynamics_of(model.circuit()))
    late = t > 0.1 - 5 / F
    basis = np.stack([np.sin(2 * np.pi * F * t), np.cos(2 * np.pi * F * t), np.ones_like(t)], 1)[late]
    a, b, _ = np.linalg.lstsq(basis, run.stage("differencing")[late], rcond=None)[0]
    assert (a + 1j * b) / 0.01 == pytest.approx(response(F, 100.0, model.values), rel=2e-3)


def test_command_on_a_simulated_recording(tmp_path, events):
    write_recording(Recording(events, condition="lamp"), tmp_path / "lamp.h5")
    out = tmp_path / "flicker"
    arguments = ["flicker", str(tmp_path / "lamp.h5"), "--groups", "2x1", "--quiet", "--out", str(out)]
    assert main(arguments) == 0
    written = json.loads((out / "flicker.json").read_text())
    assert written["shape"] == "sine"
    assert not any(written["parameters"][name]["identified"] for name in ("alpha", "beta", "gamma", "sf_cutoff_hz"))
    assert (out / "phases.svg").is_file()
    assert (out / "maps.svg").is_file()
    page = (out / "report.html").read_text()
    assert page.count("<svg") == 5  # phases, maps, and intervals by kind of parameter
    assert written["unidentified"][0].partition(": ")[2] in page  # ids before it are names there


def test_ratios_on_their_bound_are_said_to_be():
    x = TRUTH.copy()
    x[1], x[3] = np.log(0.02), np.log(0.1)  # an OFF threshold far below what the search allows
    assert fit_group(_counts_of(x), SINE).ratios_at_bound == ["off_over_on_threshold"]
    assert fit_group(_counts_of(TRUTH), SINE).ratios_at_bound == []


def _counts_of(x) -> PhaseTable:
    exposure = np.full((BINS, BINS), 3.0)
    counts = np.random.default_rng(0).poisson(rates(x, SINE)[0] * exposure)
    return PhaseTable(counts[0], counts[1], exposure, 1, int(counts.sum()))


def test_bad_input_is_one_plain_line(tmp_path, events, capsys):
    write_recording(Recording(events.select(events.t < 3e8)), tmp_path / "short.h5")
    base = ["flicker", str(tmp_path / "short.h5"), "--out", str(tmp_path / "o"), "--quiet"]
    for extra, expected in (([], "at least 1 s"), (["--groups", "8"], "8x6"), (["--model", "none"], "no model")):
        assert main([*base, *extra]) == 2
        error = capsys.readouterr().err
        assert expected in error
        assert error.count("\n") == 1


@pytest.mark.slow
def test_real_flicker(shared, tmp_path):
    source = shared / "recordings" / "flicker120_gen31.npz"
    if not source.is_file():
        pytest.skip(f"no {source}")
    assert main(["flicker", str(source), "--out", str(tmp_path / "o"), "--groups", "4x3", "--quiet"]) == 0
    written = json.loads((tmp_path / "o" / "flicker.json").read_text())
    assert written["frequency_hz"]["value"] == pytest.approx(120.0, abs=0.1)
    assert not any(written["parameters"][name]["identified"] for name in ("alpha", "beta", "gamma", "on_threshold"))
    locked = [g for g in written["groups"] if g["amplitude_over_on_threshold"]["identified"]]
    assert len(locked) >= 3
