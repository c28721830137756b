"""EDS (Hidalgo-Carrió et al., CVPR 2022): a Prophesee Gen 3.1 and a colour camera behind one beam splitter.

events.h5                   x, y, t (µs since 1970), p, at the top or in a group `events`
stamped_groundtruth.txt     lines of t (s), x, y, z, qx, qy, qz, qw of the event sensor
images/, images_timestamps.txt (µs), times.txt (number, s, exposure in ms, gain in dB, name)
camchain*.yaml, calib*.yaml Kalibr's: `cam0` the colour camera, `cam1` the sensor, `T_cn_cnm1` from the one to the other
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.documents import read_text
from pixelid.errors import InputError, first_line
from pixelid.nerf.data.camera import Camera
from pixelid.nerf.data.published.hdf5_events import events_of
from pixelid.nerf.data.published.source import (
    Pictures,
    Source,
    camera_of,
    equal_exposures,
    found,
    nanoseconds,
    poses_of,
    read_table,
    wanted,
)
from pixelid.recordings.pictures import read_picture

MODELS = {"radtan": "plumb_bob", "equi": "equidistant", "none": "plumb_bob"}  # Kalibr's names → ours
# Biases of the published sequences, in mV: ON, OFF, their common level and the refractory one.  The thresholds' ratio
# is that of the distances to the level; the dead time follows Prophesee's curve as Low & Lee (2024) read it.
BIAS_ON, BIAS_OFF, BIAS_LEVEL, BIAS_REFRACTORY_V = 414, 194, 300, 1.5
OFF_THRESHOLD = 0.25  # assumed, as by Low & Lee: events leave a factor on all thresholds open
NOTES = (
    f"thresholds are assumed: OFF {OFF_THRESHOLD}, ON by the ratio of the published biases",
    "the circuit is not published",
)


def read(path: Path, camera: str = "") -> Source:
    """A sequence of EDS.

    Args:
        path: its folder; the calibration may lie in it, below it or next to it.
        camera: the sensor's name in the calibration; by default the one whose topic speaks of events, else cam1.

    Returns:
        The sequence.

    Raises:
        InputError: naming the file that is missing or wrong.
    """
    if not path.is_dir():
        raise InputError(f"{path}: expected the folder of a sequence with events.h5 and stamped_groundtruth.txt")
    events, truth = wanted(path, "events.h5"), wanted(path, "stamped_groundtruth.txt")
    chain = wanted(path, "camchain*e2kalibr.yaml", "camchain*.yaml", "calib*.yaml")
    cameras = _yaml(chain)
    name = camera or _sensor(cameras, chain)
    table = read_table(truth, 8)
    t = nanoseconds(truth, table[:, 0], 1e9)
    pictures = _pictures(events.parent, cameras, name, chain)
    return Source(
        "eds", _camera(cameras, name, chain), poses_of(truth, t, table[:, 1:4], table[:, 4:8]), events_of(events),
        pictures, _pixel(), None, None, NOTES, (events, truth, chain),
    )  # fmt: skip


def _pixel() -> dict[str, Any]:
    ratio = (BIAS_ON - BIAS_LEVEL) / (BIAS_LEVEL - BIAS_OFF)
    return {
        "pos_contrast_threshold": ratio * OFF_THRESHOLD,
        "neg_contrast_threshold": OFF_THRESHOLD,
        "refractory_period": 4e-23 * math.exp(27.64 * BIAS_REFRACTORY_V) * 1e9,
    }


def _yaml(file: Path) -> Mapping[str, Any]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        document = YAML(typ="safe", pure=True).load(io.StringIO(read_text(file, "CSV")))
    except (YAMLError, ValueError, RecursionError) as error:
        raise InputError(f"{file}: not valid YAML ({first_line(error)[:80]})") from None
    cameras = {name: entry for name, entry in document.items() if isinstance(entry, dict)} if isinstance(
        document, dict
    ) else {}  # fmt: skip
    if not cameras:
        raise InputError(f"{file}: expected a camera chain of Kalibr with cam0 and cam1")
    return cameras


def _sensor(cameras: Mapping[str, Any], file: Path) -> str:
    named = [
        name
        for name, entry in cameras.items()
        if any(word in str(entry.get("rostopic", "")).lower() for word in ("event", "dvs", "prophesee"))
    ]
    name = named[0] if len(named) == 1 else "cam1" if "cam1" in cameras else next(iter(cameras))
    if name not in cameras:
        raise InputError(f"{file}: {name}: missing")
    return name


def _camera(cameras: Mapping[str, Any], name: str, file: Path) -> Camera:
    if name not in cameras:
        raise InputError(f"{file}: {name}: missing; found {', '.join(cameras)}")
    entry = cameras[name]
    missing = [key for key in ("intrinsics", "resolution") if not isinstance(entry.get(key), list)]
    if missing:
        raise InputError(f"{file}: {name}.{missing[0]}: missing, or no list")
    if entry.get("camera_model", "pinhole") != "pinhole":
        raise InputError(f"{file}: {name}.camera_model: expected pinhole, found {entry['camera_model']!r}")
    model = str(entry.get("distortion_model", "none"))
    coefficients = entry.get("distortion_coeffs") or []
    numbers = entry["intrinsics"]
    return camera_of(file, numbers[:2], numbers[2:], entry["resolution"], coefficients, MODELS.get(model, model))


def _pictures(folder: Path, cameras: Mapping[str, Any], sensor: str, chain: Path) -> Pictures | None:
    """The frames of the other camera, where they, their times and the way from it to the sensor are there."""
    others = [name for name in cameras if name != sensor]
    stamps = found(folder, "images_timestamps.txt")
    files = sorted((folder / "images").glob("*.png")) or sorted((folder / "images").glob("*.jpg"))
    listed = folder / "times.txt"
    if not files or not others or (stamps is None and not listed.is_file()):
        return None
    exposure, notes = np.ones(len(files)), equal_exposures(listed, "no such file")
    if listed.is_file():
        rows = [line.split() for line in read_text(listed, "CSV").splitlines() if line.strip()[:1] not in ("", "#")]
        try:
            files = [folder / "images" / row[4] for row in rows]
            t = nanoseconds(listed, np.array([float(row[1]) for row in rows]), 1e9)
            exposure = np.array([float(row[2]) * 10 ** (float(row[3]) / 20) for row in rows])
            notes = ()
            if not (np.isfinite(exposure) & (exposure > 0)).all():
                raise ValueError
        except (ValueError, IndexError, OverflowError):
            raise InputError(f"{listed}: expected lines of number, s, exposure in ms, gain in dB, name") from None
    else:
        assert stamps is not None
        t = nanoseconds(stamps, read_table(stamps, 1)[:, -1], 1e3)
    if len(t) != len(files):
        raise InputError(f"{stamps}: expected a time for each of {len(files)} pictures, found {len(t)}")

    def read_some(which: np.ndarray) -> Iterator[np.ndarray]:
        return (read_picture(files[k]) for k in which)

    other = "cam0" if "cam0" in others else others[0]
    names = tuple(file.stem for file in files)
    pose = _way(cameras, other, sensor, chain)
    return Pictures(t, names, exposure, _camera(cameras, other, chain), pose, read_some, notes)


def _way(cameras: Mapping[str, Any], other: str, sensor: str, file: Path) -> np.ndarray:
    """(4, 4) from the other camera's frame to the sensor's: T_cn_cnm1 of the later one in the chain."""
    later, turned = (sensor, False) if other < sensor else (other, True)
    try:
        way = np.array(cameras[later].get("T_cn_cnm1"), dtype=np.float64)
    except (TypeError, ValueError):
        way = np.empty(0)
    if way.shape != (4, 4) or not np.isfinite(way).all():
        raise InputError(f"{file}: {later}.T_cn_cnm1: expected a 4 × 4 matrix")
    return np.linalg.inv(way) if turned else way
