"""`pixelid gap --pixel-levels`: pixels that see the light through gains and backgrounds that nobody knows."""

from __future__ import annotations

import json
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from pixel_light import grating

from pixelid.cli.main import main
from pixelid.errors import InputError
from pixelid.fit.levels.pixel_levels import PixelLevels, Wanted
from pixelid.gap import own_levels
from pixelid.gap.gap import gap
from pixelid.gap.result import GapReport
from pixelid.model.model import Model
from pixelid.model.shipped import find_model
from pixelid.recordings import write_recording
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate
from pixelid.stimuli.pixel_lights import PixelLights
from pixelid.stimuli.shapes import grating as grating_of_pixels
from pixelid.stimuli.stimulus import Stimulus

SIDE, FRAME_S, SUBFRAMES, SECONDS = 5, 1e-4, 16, 0.5  # finer frames than searches are given, as in `pixel_light.py`
GAIN_SPREAD = 0.2  # standard deviation of ln gain


def session(truth, seed: int, side: int = SIDE, levels: tuple[float, ...] = (10.0, 300.0)):
    """(ln gain (side²,), gratings as recorded with the events of pixels that saw them through these gains)."""
    rng = np.random.default_rng(seed)
    log_gain, background = GAIN_SPREAD * rng.standard_normal(side**2), 0.1 * levels[0] * rng.random(side**2)
    t, made = np.arange(round(SUBFRAMES * SECONDS / FRAME_S) + 1) * FRAME_S / SUBFRAMES, []
    for k, level in enumerate(levels):
        film = grating(level, side, t).radiance
        seen = film * np.exp(log_gain).reshape(side, side) + background.reshape(side, side)
        events = simulate(truth, Stimulus(t, seen), seed=4 * seed + k, sensor_seed=seed).events
        shown = Stimulus(t[::SUBFRAMES], film[::SUBFRAMES])
        made.append(Recording(events, shown, condition=f"grating_{level:g}", sensor=f"simulated {seed}"))
    return log_gain, made


@dataclass(frozen=True)
class Said:
    """What a search says, as far as `search_with_levels` looks at it."""

    effects: tuple
    model: Model
    pixel_levels: PixelLevels | None = None


@pytest.mark.parametrize(
    ("named", "searches"),
    [([[]], 1), ([["leak"], ["leak"]], 2), ([["leak"], []], 2), ([["leak"], ["lower_cutoff"], ["leak"]], 3)],
)
def test_levels_are_told_again_with_what_is_named(named, searches, monkeypatch):
    base, told_with, seen = find_model("dvs128"), [], []
    film = grating_of_pixels(20.0, 0.6, 25.0, 8.0, width=2, height=2, duration_s=0.1, dt=1e-3)
    recording = simulate(base, film, seed=1)

    def levels(recordings, model, **words):
        told_with.append(model)
        nothing = np.empty(0)
        gain = np.array([0.5, 1.0, 1.5, 2.0]) * len(told_with)
        x, y = np.array([0, 1, 0, 1]), np.array([0, 0, 1, 1])
        return SimpleNamespace(pixel_levels=PixelLevels(x, y, gain, nothing, nothing, nothing, {}, {}))

    def search(recordings):
        seen.append(recordings[0].stimulus)
        names = named[len(seen) - 1]
        model = base
        for name in names:
            model = model.with_effect(name)
        return Said(tuple(SimpleNamespace(name=name) for name in names), model)

    monkeypatch.setattr(own_levels, "fit", levels)
    wanted = Wanted(("gain",), {})
    report = own_levels.search_with_levels([recording], base, wanted, 0, search, print)  # type: ignore[arg-type]
    assert len(seen) == searches
    assert [model.effects for model in told_with[1:]] == [base.with_effect(some[0]).effects for some in named[:-1]]
    assert isinstance(seen[-1], PixelLights)
    assert report.pixel_levels is not None
    for k, (x, y) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
        gain = report.pixel_levels.gain[k]
        assert np.allclose(seen[-1].lights[k].radiance, gain * film.radiance[:, y, x])


def test_a_background_beside_a_free_dark_current_is_refused():
    model = find_model("dvs128").with_effect("dark_current", {"radiance": 1.0})
    with pytest.raises(InputError, match="dark current"):
        gap(session(find_model("dvs128"), 1, 2, (100.0,))[1], model, pixel_levels="background")


@pytest.mark.slow
def test_gains_are_no_gap_and_a_leak_is_one(tmp_path):
    model = find_model("dvs128")
    for name, truth in (("none", model), ("leak", model.with_effect("leak", {"rate_hz": 2.0}))):
        folder, out = tmp_path / name, tmp_path / f"gap_{name}"
        folder.mkdir()
        recordings = session(truth, 1)[1]
        for recording in recordings:
            write_recording(recording, folder / f"{recording.condition}.h5")
        assert (
            main(["gap", str(folder), "--model", "dvs128", "--out", str(out), "--quiet", "--pixel-levels", "both"]) == 0
        )
        content = json.loads((out / "gap.json").read_text())
        named = [effect["name"] for effect in content["effects"]]
        assert (content["verdict"], named) == (("none", []) if name == "none" else ("named", ["leak"]))
        if named:
            low, high = content["effects"][0]["parameters"]["leak.rate_hz"]["interval_95"]
            assert low < 2.0 < high
        assert GapReport.load(out).pixel_levels is not None
        assert 'id="figure-levels"' in (out / "report.html").read_text()
    assert gap(session(model, 1)[1], model, recommend=False).verdict == "unknown"  # the light taken as exact
