"""The page with a pixel to play with: its arithmetic is the simulator's, and it reads everywhere."""

import json
import shutil
import subprocess

import browser
import numpy as np
import pytest

import pixelid as px
from pixelid.cli.main import main
from pixelid.model.files import save_model
from pixelid.model.model import Model
from pixelid.model.shipped import find_model, shipped_models
from pixelid.report.html import TEMPLATES
from pixelid.report.pixel_view import preset, view_page
from pixelid.simulate.simulator import simulate
from pixelid.stimuli.stimulus import Stimulus

NODE = shutil.which("node")
CYCLES = 4
PIXELS = 150
needs_javascript = pytest.mark.skipif(NODE is None and browser.EXECUTABLE is None, reason="no node and no Chromium")
needs_browser = pytest.mark.skipif(browser.EXECUTABLE is None, reason="no Chromium")


@pytest.fixture(scope="module")
def window(tmp_path_factory):
    with browser.Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture(scope="module")
def javascript(request, tmp_path_factory):
    """A function that evaluates an expression with the functions of pixel.js, in node or else in a browser."""
    if NODE is not None:
        head = f"const {{ simulate, response, stimulus }} = require({json.dumps(str(TEMPLATES / 'pixel.js'))});"

        def in_node(expression: str):
            code = f"{head} process.stdout.write(JSON.stringify({expression}))"
            return json.loads(subprocess.check_output([str(NODE), "-"], input=code, text=True))

        return in_node
    opened = request.getfixturevalue("window")
    page = tmp_path_factory.mktemp("page") / "pixel.html"
    page.write_text(view_page())
    opened.visit(page, 1280)
    return opened.evaluate


def quiet(name: str) -> Model:
    """A shipped circuit without what is random, of an odd leak so that no event is due just when the light turns."""
    model = find_model(name)
    for effect in ("shot_noise", "threshold_noise", "threshold_mismatch"):
        model = model.without_effect(effect) if effect in model.effects else model
    return model.with_effect("leak", {"leak.rate_hz": 2.71})


def both(javascript, model: Model, kind: str, frequency: float, pixels: int = 1, draws: int = 1):
    """(events of `draws` seeds of the page, its signals, the recording of `pixels` pixels under the same light)."""
    given = json.dumps(preset(model) | {"bandwidth": 1.0})
    code = f"""(() => {{ const p = {given}, s = stimulus("{kind}", p.level, 0.8, {frequency}), runs = [];
      for (let seed = 1; seed <= {draws}; seed++) runs.push(simulate(p, s.t, s.light, {CYCLES}, seed));
      return {{ s, events: runs.map(run => run.events), signals: runs[0].signals }}; }})()"""
    page = javascript(code)
    t, light = (np.array(page["s"][name]) for name in ("t", "light"))
    t = np.concatenate([t, *(t[1:] + cycle * t[-1] for cycle in range(1, CYCLES))])
    stimulus = Stimulus.from_arrays(t, np.concatenate([light, *[light[1:]] * (CYCLES - 1)]), model.radiance_unit)
    events = [np.array(run).reshape(-1, 2) for run in page["events"]]
    recording = simulate(model, stimulus, width=pixels, height=1, synchronous=True, as_sampled=True)
    return events, np.array(page["signals"]), recording


@needs_javascript
@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("kind", ["sine", "step"])
@pytest.mark.parametrize("name", shipped_models())
def test_events_are_those_of_the_simulator(javascript, name, kind, dark):
    """Of one polarity, one by one; a crossing that is nearly a touch may be late, by far less than one can see."""
    model = quiet(name)
    if dark:
        level = 0.2 * preset(model)["level"]
        model = (model.set if model.has("dark_current") else lambda v: model.with_effect("dark_current", v))(
            {"dark_current.radiance": level}
        )
    late = []
    for frequency in (2.0, 30.0, 400.0):
        (mine,), _, recording = both(javascript, model, kind, frequency)
        t, p = 1e-9 * recording.events.t, 2 * recording.events.p.astype(int) - 1
        assert len(mine) == len(t)
        assert (mine[:, 1] == p).all()
        late.append(np.abs(mine[:, 0] - t) * frequency)
    late = np.concatenate(late)
    assert len(late) > 40
    assert late.max() < 1e-3  # of a period: a pixel of the screen
    assert np.mean(late < 1e-4) > 0.95  # a tenth of it


@needs_javascript
def test_signals_are_exact_at_samples(javascript):
    from pixelid.dynamics.of_circuit import dynamics_of
    from pixelid.dynamics.trajectory import integrate

    for name in ("dvs128", "dvs128_low_light", "gen31", "imx636"):
        model = quiet(name)
        _, signals, recording = both(javascript, model, "step", 30.0)
        light = recording.stimulus
        assert isinstance(light, Stimulus)
        states = integrate(light.t, light.radiance + model.circuit().dark, dynamics_of(model.circuit()))
        for column, stage in ((1, "source_follower"), (2, "differencing")):
            np.testing.assert_allclose(signals[:, column], states.stage(stage), atol=1e-8)


@needs_javascript
def test_threshold_noise_scatters_events_as_the_simulator_does(javascript):
    model = find_model("dvs128").without_effect("threshold_mismatch").set({"threshold_sigma": 0.1})
    runs, _, recording = both(javascript, model, "sine", 30.0, pixels=PIXELS, draws=PIXELS)
    events = recording.events
    mine = np.array([run[0, 0] for run in runs])
    theirs = 1e-9 * np.array([events.t[events.x == x][0] for x in range(PIXELS)])
    error = theirs.std() * np.sqrt(2 / PIXELS)
    assert abs(mine.mean() - theirs.mean()) < 4 * error
    assert np.log(mine.std() / theirs.std()) == pytest.approx(0, abs=4 / np.sqrt(PIXELS))
    counts = np.array([len(run) for run in runs])
    assert abs(counts.mean() - len(events.t) / PIXELS) < 4 * counts.std() * np.sqrt(2 / PIXELS)


@needs_javascript
@pytest.mark.parametrize("name", ["dvs128", "dvs128_low_light", "imx636"])
def test_numbers_of_the_page(javascript, name):
    """A small slow sine is late by the delay, and one at the cutoff keeps 1/√2 of its size."""
    given = json.dumps(preset(find_model(name)) | {"bandwidth": 1.0, "delay": 0.0, "noise": 0.0})
    ends = javascript(f"""(() => {{ const p = {given}, {{ cutoff, delay }} = response(p, p.level);
      const size = frequency => {{ const {{ t, light }} = stimulus("sine", p.level, 1e-4, frequency);
        return {{ frequency, y: simulate(p, t, light, 40).signals.slice(-400).map(s => s[2]) }}; }};
      return {{ cutoff, delay, slow: size(cutoff / 100), at: size(cutoff) }}; }})()""")
    phasor = {key: 2 * np.fft.fft(ends[key]["y"])[1] / 400 for key in ("slow", "at")}
    dark = preset(find_model(name))
    whole = 1e-4 * dark["level"] / (dark["level"] + dark["dark"])
    assert abs(phasor["at"]) == pytest.approx(whole / np.sqrt(2), rel=5e-3)
    # samples 1 to 400 of the last period, of a sine: the phase of −i e^{i 2π/400}
    late = -np.angle(phasor["slow"] * 1j * np.exp(-2j * np.pi / 400))
    assert late / (2 * np.pi * ends["slow"]["frequency"]) == pytest.approx(ends["delay"], rel=0.02)


@needs_browser
def test_the_page_reads_and_plays_everywhere(window, tmp_path):
    page = px.view(find_model("dvs128").with_effect("leak", {"leak.rate_hz": 3.0}), tmp_path / "pixel.html")
    assert page.stat().st_size < 300_000
    for width in (1280, 768, 390):
        for dark in (False, True):
            window.visit(page, width, dark=dark)
            assert not window.complaints
            assert [address.partition(":")[0] for address in window.requests] == ["file"]
            assert not window.sticking_out()
    count = window.evaluate("presets.length")
    assert count == len(shipped_models()) + 1
    assert window.evaluate("document.getElementById('leak').nextElementSibling.textContent") == "3 events/s"
    window.evaluate("document.getElementById('play').click()")  # stop it, so that only sliders move it
    drawn = "document.getElementById('%s').toDataURL()"
    for chosen in range(count):
        window.evaluate(f"element('preset').value = {chosen}; element('preset').dispatchEvent(new Event('change'))")
        before = [window.evaluate(drawn % plot) for plot in ("light", "change", "events")]
        window.evaluate("element('contrast').value = 950; element('contrast').dispatchEvent(new Event('input'))")
        after = [window.evaluate(drawn % plot) for plot in ("light", "change", "events")]
        assert all(one != other for one, other in zip(before, after, strict=True))
        assert "ON and" in window.evaluate("element('numbers').textContent")
    window.evaluate("document.querySelector('input[value=step]').click()")
    assert not window.complaints


def test_the_page_of_a_fit_has_its_values(tmp_path, capsys):
    (tmp_path / "fit").mkdir()
    save_model(find_model("dvs128").set(on_threshold=0.3217), tmp_path / "fit" / "model.toml")
    assert main(["view", str(tmp_path / "fit"), "--out", str(tmp_path / "page.html")]) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    presets = json.loads(text.partition('id="presets">')[2].partition("</script>")[0])
    assert presets[0]["on"] == 0.3217
    assert len(presets) == len(shipped_models()) + 1
    assert main(["view", "dvs128", "--out", str(tmp_path / "page.html")]) == 2  # there already


def test_a_damaged_scene_and_an_unknown_folder_are_refused(tmp_path, capsys):
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene" / "reconstruction.json").write_text("{}")
    for name, words in (("scene", "status: missing"), ("nothing", "no model")):
        assert main(["view", str(tmp_path / name), "--out", str(tmp_path / "page.html")]) == 2
        message = capsys.readouterr().err
        assert words in message
        assert message.count("\n") == 1
    assert not (tmp_path / "page.html").exists()
