"""Waveforms for a generator: what is played, when the trigger rises, and what the files hold."""

import numpy as np
import pytest
from scipy.io import wavfile

import pixelid as px
from pixelid.cli.main import main
from pixelid.design.waveform import top_frequency_hz
from pixelid.errors import InputError
from pixelid.stimuli.sampled import read_light
from pixelid.stimuli.shapes import chirp


def rises(trigger) -> np.ndarray:
    """Indices of the samples at which a trigger channel rises."""
    return np.flatnonzero(np.diff(np.asarray(trigger, dtype=float)) > 0) + 1


@pytest.mark.parametrize("rate_hz", [8000.0, 48000.0, 44100.0])
@pytest.mark.parametrize("name", ["chirp", "steps", "slow", "constant", "sine", "pulse", "edge"])
def test_the_trigger_rises_at_the_first_and_at_the_last_sample_of_the_light(name, rate_hz):
    wave = px.stimulus(name, rate_hz=rate_hz, rest_s=0.25)
    first, last = rises(wave.trigger)
    assert wave.t[first] == 0
    assert wave.t[last] == pytest.approx(wave.stimulus.duration_s, abs=1e-9)
    np.testing.assert_array_equal(wave.light[first : last + 1], wave.stimulus.radiance)
    assert set(wave.light[:first]) == {wave.light[first]}
    assert set(wave.light[last:]) == {wave.light[last]}
    assert first == pytest.approx(0.25 * rate_hz, abs=1)
    assert not wave.trigger[0]
    assert not wave.trigger[-1]


def test_the_samples_are_the_shape_itself():
    wave = px.stimulus("chirp", level=24.0, contrast=0.5, top_hz=300.0, seconds=0.5, rate_hz=1e4)
    expected = chirp(24.0, 0.5, stop_hz=300.0, duration_s=0.5, dt=1e-4)
    np.testing.assert_allclose(wave.stimulus.radiance, expected.radiance, rtol=1e-9)


@pytest.mark.parametrize(("bits", "top"), [(16, (1 << 15) - 1), (24, (1 << 31) - (1 << 8))])
def test_a_wav_holds_light_and_trigger(bits, top, tmp_path):
    wave = px.stimulus("steps", level=24.0, unit="lux", seed=3)
    trace = wave.save(tmp_path / "steps.wav", bits=bits)
    rate, samples = wavfile.read(tmp_path / "steps.wav")
    assert rate == 48000
    assert samples.max(axis=0).tolist() == [top, top]
    played = samples[:, 0] / top * wave.light.max()
    np.testing.assert_allclose(played, wave.light, atol=wave.light.max() / (1 << (bits - 1)))
    np.testing.assert_array_equal(samples[:, 1] > 0, wave.trigger)
    light = read_light(trace)
    assert light.unit == "lux"
    np.testing.assert_allclose(light.radiance, wave.stimulus.radiance, rtol=1e-8)
    np.testing.assert_allclose(light.t, np.arange(len(light.t)) / 48000, atol=1e-9)


def test_a_csv_has_three_columns(tmp_path):
    wave = px.stimulus("slow", rate_hz=1000.0, rest_s=0.1)
    wave.save(tmp_path / "slow.csv")
    lines = (tmp_path / "slow.csv").read_text().splitlines()
    assert lines[0] == "t_s,light,trigger"
    t, light, trigger = np.loadtxt(lines[1:], delimiter=",").T
    np.testing.assert_allclose(light, wave.light, rtol=1e-8)
    assert t[rises(trigger)].tolist() == [0.0, 1.0]
    with pytest.raises(InputError, match="exists already"):
        wave.save(tmp_path / "slow.csv")
    (tmp_path / "slow.csv").unlink()
    with pytest.raises(InputError, match=r"slow_light\.csv: exists already"):
        wave.save(tmp_path / "slow.csv")


def test_for_a_model_a_chirp_ends_at_its_bandwidth():
    from pixelid.lowlight.poles import exact
    from pixelid.lowlight.response import gain

    model = px.find_model("dvs128")
    for level in (3.0, 24.0, 400.0):
        top = top_frequency_hz(model, level)
        below, above = np.abs(gain(exact(model.circuit(), level, "pixel"), np.array([0.95 * top, 1.05 * top])))
        assert above < 2**-0.5 < below  # two digits are known to 5 %
    wave = px.stimulus("chirp", level=24.0, model=model)
    ends = np.flatnonzero(np.diff(np.sign(wave.stimulus.radiance - 24.0)) > 0) / wave.rate_hz
    assert 1 / np.diff(ends)[-1] == pytest.approx(top_frequency_hz(model, 24.0), rel=0.1)
    assert wave.stimulus.unit == "fA"
    slow = px.stimulus("chirp", level=0.3, model=model, seconds=5.0)  # −3 dB at 1.6 Hz, below where chirps begin
    assert np.ptp(slow.stimulus.radiance) > 0.3
    assert top_frequency_hz(px.find_model("ideal"), 1.0, rate_hz=48000.0) == 4800.0


def test_entries_of_the_menu_files_and_designs(tmp_path):
    named = px.stimulus("steps_24", model="dvs128", parameters={"hold_s": 0.01})
    assert named.stimulus.duration_s == pytest.approx(0.8)
    (tmp_path / "next.toml").write_text('[stimulus]\nkind = "steps"\nlevel = 7.0\nseed = 4\n')
    one, other = px.stimulus(tmp_path / "next.toml"), px.stimulus(tmp_path)
    np.testing.assert_array_equal(one.light, other.light)
    (tmp_path / "light.csv").write_text("t_s,light_lux\n3.0,1\n3.5,4\n4.0,1\n")
    sampled = px.stimulus(tmp_path / "light.csv", rate_hz=100.0)
    assert sampled.stimulus.unit == "lux"
    assert sampled.stimulus.radiance[25] == pytest.approx(2.0)  # log radiance is linear between samples


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"source": "chirpy"}, "did you mean 'chirp'"),
        ({"source": "grating"}, "full-field"),
        ({"source": "chirp", "top_hz": 2e4}, "top_hz: expected at most 12000"),
        ({"source": "chirp", "contrast": 1.5}, "must be positive"),
        ({"source": "sine", "top_hz": 20.0}, "no parameter 'stop_hz'"),
        ({"source": "sine", "rate_hz": 0.0}, "rate_hz"),
        ({"source": "sine", "seconds": 1e9}, "more than"),
        ({"source": "sine", "rest_s": 1e9}, "rest_s"),
    ],
)
def test_what_cannot_be_played_is_said(options, says):
    with pytest.raises(InputError, match=says):
        px.stimulus(**options)


def test_the_command(tmp_path, capsys):
    out = tmp_path / "dim.wav"
    words = ["stimulus", "chirp", "--for", "dvs128", "--level", "24", "--seconds", "0.2", "--out", str(out)]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert "full scale is 42 fA" in printed
    assert (tmp_path / "dim_light.csv").exists()
    assert main(words) == 2
    assert "exists already" in capsys.readouterr().err
    assert main([*words, "--overwrite", "--quiet"]) == 0
    assert main(["stimulus", "chirp", "--out", str(tmp_path / "a.mp3")]) == 2
    assert ".wav or .csv" in capsys.readouterr().err
