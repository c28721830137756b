"""`pixelid simulate` and `pixelid models`, as users call them."""

import pytest

from pixelid.cli.main import main
from pixelid.errors import InputError
from pixelid.model.options import assignment, changed, effect_with_values
from pixelid.model.shipped import find_model
from pixelid.recordings import Recording, open_recording, write_recording
from pixelid.recordings.events import Events
from pixelid.stimuli import shapes


@pytest.fixture
def light(tmp_path):
    path = tmp_path / "light.toml"
    path.write_text('[stimulus]\nkind = "sine"\nlevel = 24\nfrequency_hz = 40\nduration_s = 0.1\n')
    return str(path)


def test_a_recording_with_its_origin(tmp_path, light, capsys):
    out = tmp_path / "rec.h5"
    arguments = ["simulate", "dvs128", "--stimulus", light, "--out", str(out), "--pixels", "12", "--seed", "7"]
    assert main([*arguments, "--with", "leak:rate_hz=0.3", "--without", "hot_pixels", "--set", "on_threshold=0.3"]) == 0
    said = capsys.readouterr().out
    assert "--without hot_pixels: the model dvs128 does not have it" in said
    assert "4 x 3 pixels" in said
    recording = open_recording(out)
    assert (recording.events.width, recording.events.height) == (4, 3)
    assert recording.stimulus is not None
    assert recording.condition == "light"
    assert recording.attributes["sensor_seed"] == 7
    assert recording.attributes["parameters"]["leak.rate_hz"] == 0.3
    assert recording.attributes["parameters"]["on_threshold"] == 0.3
    assert "leak" in recording.attributes["effects"]
    assert len(recording.events) > 100
    assert main(arguments) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main([*arguments, "--overwrite", "--quiet", "--synchronous"]) == 0
    assert capsys.readouterr().out == ""
    assert list(tmp_path.glob(".*")) == []


def test_a_video_sets_the_sensor(tmp_path, capsys):
    video, out = tmp_path / "video.h5", tmp_path / "out.h5"
    grating = shapes.grating(width=24, height=10, duration_s=0.01)
    write_recording(Recording(Events.empty(24, 10), grating), video)
    assert main(["simulate", "dvs128", "--stimulus", str(video), "--out", str(out)]) == 0
    assert open_recording(out).events.width == 24
    assert main(["simulate", "dvs128", "--stimulus", str(video), "--out", str(out), "--pixels", "9"]) == 2


def test_models_lists_and_prints(capsys):
    assert main(["models"]) == 0
    assert "dvs128" in capsys.readouterr().out
    assert main(["models", "dvs128"]) == 0
    said = capsys.readouterr().out
    for word in ("alpha", "gauge", "q_in"):
        assert word in said
    assert main(["models", "ideal", "--quiet"]) == 0
    assert "on_threshold = 0.25" in capsys.readouterr().out
    assert main(["models", "nothing"]) == 2
    assert "dvs128" in capsys.readouterr().err


def test_options():
    assert assignment("a.b = 3e-2") == ("a.b", 0.03)
    assert effect_with_values("leak:rate_hz=3") == ("leak", {"rate_hz": 3.0})
    assert effect_with_values("leak") == ("leak", {})
    with pytest.raises(InputError, match="rate_hz once, found 1 and 2"):
        effect_with_values("leak:rate_hz=1,rate_hz=2")
    with pytest.raises(InputError, match="an effect once"):
        changed(find_model("dvs128"), ["leak:rate_hz=1", "leak:rate_hz=3"])
    with pytest.raises(InputError, match="alpha once"):
        changed(find_model("dvs128"), set_=["alpha=5e4", "alpha=6e4"])
    with pytest.raises(InputError, match="after the colon"):
        effect_with_values("leak:")
    with pytest.raises(InputError, match="finite"):
        assignment("a=inf")
    model, remarks = changed(find_model("dvs128"), ["leak"], ["differencing_pole"], ["leak.rate_hz=2"])
    assert model.has("leak")
    assert not model.has("differencing_pole")
    assert remarks == []
