"""Frames of a DAVIS as light, against the decoder's own frames of a public recording."""

from pathlib import Path

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.recordings.frames import with_frames
from pixelid.recordings.reading import open_recording
from pixelid.recordings.sensor_light import is_measured, light_caveats

FILE = Path(__file__).resolve().parents[3] / "shared" / "recordings" / "davis346_aps.aedat4"
WITHOUT = FILE.with_name("dvxplorer_scan.aedat4")
needs_file = pytest.mark.skipif(not FILE.exists(), reason="needs ../shared/recordings")


@needs_file
def test_light_is_grey_level_over_exposure():
    from faery.extension import aedat

    with aedat.Decoder(FILE) as decoder:
        frames = [packet for _, packet in decoder if type(packet).__name__ == "Frame"]
    before = open_recording(FILE)
    recording = with_frames(before, dark=10.0)
    assert is_measured(recording)
    assert len(light_caveats([recording])) == 2
    lights = recording.stimulus
    assert lights.size == (346, 260)
    levels = np.stack([frame.pixels for frame in frames]).astype(float)
    clipped = (levels.min(axis=0) < 11) | (levels.max(axis=0) == 255)
    np.testing.assert_array_equal(lights.of_pixel < 0, clipped)
    seconds = np.array([1e-6 * (f.exposure_end_t - f.exposure_start_t) for f in frames])
    y, x = np.argwhere(~clipped)[1234]
    light = lights.lights[lights.of_pixel[y, x]]
    np.testing.assert_allclose(light.radiance, (levels[:, y, x] - 10.0) / seconds, rtol=1e-6)
    middle = np.array([f.exposure_start_t + f.exposure_end_t for f in frames]) / 2
    np.testing.assert_allclose(light.t, 1e-6 * (middle - middle[0]), atol=1e-9)
    first_ns = 500 * (frames[0].exposure_start_t + frames[0].exposure_end_t)
    span = (before.events.t >= first_ns) & (before.events.t <= first_ns + light.t[-1] * 1e9)
    kept = span & ~clipped[before.events.y, before.events.x]
    np.testing.assert_array_equal(recording.events.t, before.events.t[kept] - first_ns)


@needs_file
@pytest.mark.parametrize(("path", "dark", "message"), [(WITHOUT, 0.0, "two grey frames"), (FILE, 300.0, "every pixel")])
def test_frames_that_tell_no_light(path, dark, message):
    with pytest.raises(InputError, match=message):
        with_frames(open_recording(path), dark)
