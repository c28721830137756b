"""A dataset folder in the published layout of Robust e-NeRF and Deblur e-NeRF, after preprocessing.

raw_events.npz           position (N, 2) x, y;  timestamp (N,) ns;  polarity (N,) bool, 0/1 or ±1
camera_poses.npz         T_wc_position (K, 3);  T_wc_orientation (K, 4) x, y, z, w or (K, 3, 3);  T_wc_timestamp (K,) ns
camera_calibration.npz   see `calibration`
views/                   see `views`; here or one level up
renderer_params.npz      interm_color_space, log_eps (synthetic data)

Where times are in another unit than ns, raw_events.source.toml or camera_poses.source.toml states it (`time_unit`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.nerf.data.arrays import finite, read_arrays, unit_quaternions
from pixelid.nerf.data.calibration import FILE as CALIBRATION
from pixelid.nerf.data.calibration import Calibration, read_calibration
from pixelid.nerf.data.trajectory import Trajectory
from pixelid.nerf.data.views import RENDERER, Views, no_views, read_views
from pixelid.recordings.events import NS_PER_UNIT
from pixelid.recordings.source import options_for

BLOCK = 1 << 22  # events looked at together, where a copy of all would be in the way
MOST_NS = 1 << 62  # 146 years: sums and differences of times still fit 64 bits
MOST_AWAY = 1e9  # of the scene's unit: rays are single precision, which is a hundred units there
EVENTS, POSES = "raw_events.npz", "camera_poses.npz"
FILES = (EVENTS, POSES, CALIBRATION, RENDERER)


@dataclass(frozen=True)
class Dataset:
    """Everything a reconstruction starts from.  Time zero is the first pose.

    t: (N,) s, non-decreasing;  x, y: (N,) int32;  on: (N,) bool;  views: stage → views
    """

    path: Path
    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    on: np.ndarray
    trajectory: Trajectory
    calibration: Calibration
    views: dict[str, Views]

    @property
    def files(self) -> tuple[Path, ...]:
        """The files it was read from, pictures aside."""
        return tuple(self.path / name for name in FILES if (self.path / name).is_file())


def read_dataset(path: Path) -> Dataset:
    """Read and validate a dataset folder.

    Args:
        path: in the published layout of Robust e-NeRF and Deblur e-NeRF.

    Returns:
        Events, poses, calibration and views.

    Raises:
        InputError: naming the file and the key that is wrong.
    """
    path = Path(path)
    if not path.is_dir():
        raise InputError(f"{path}: no such folder; expected a dataset with {EVENTS}, {POSES}, {CALIBRATION} and views/")
    calibration = read_calibration(path)
    trajectory = _poses(path / POSES)
    zero = trajectory.zero_ns
    t, x, y, on = _events(path / EVENTS, calibration)
    begin, end = zero, round(trajectory.t[-1] * 1e9) + zero
    slack = 1000  # ns by which rounded clocks may disagree
    if t[0] < begin - slack or t[-1] > end + slack:
        raise InputError(
            f"{path / POSES}: T_wc_timestamp: poses cover {begin} … {end} ns, but timestamp of {EVENTS} runs "
            f"{t[0]} … {t[-1]} ns; leave out the events outside, or {_way(path / POSES)}"
        )
    most_poses_per_events = 500  # how much longer poses may be: a thousand times is another unit
    if (t[-1] - t[0]) * most_poses_per_events < end - begin:
        raise InputError(
            f"{path / EVENTS}: timestamp: events cover {t[0]} … {t[-1]}, poses {begin} … {end} ns: expected ns, found "
            f"what looks like µs: {_way(path / EVENTS)}; if it is ns, cut the poses to the events"
        )
    views = read_views(path, calibration.channels)
    return Dataset(path, (t - zero) * 1e-9, x, y, on, trajectory, calibration, views)


def evaluation_views(dataset: Dataset) -> tuple[Views, Views]:
    """The views that fix the correction and those that are scored, apart from each other.

    Test views are scored and validation views correct them; a missing stage is replaced by the next, a single one
    is halved.  One picture alone is not scored; a dataset without views has none of either.

    Args:
        dataset: as read.

    Returns:
        (views that fix the correction, views that are scored).
    """
    stages = [dataset.views[stage] for stage in ("test", "val", "train") if stage in dataset.views]
    if not stages:
        nothing = no_views(dataset.calibration.camera, dataset.calibration.channels)
        return nothing, nothing
    if len(stages) == 1:
        every = np.arange(len(stages[0]))
        if len(every) == 1:
            return stages[0], no_views(dataset.calibration.camera, dataset.calibration.channels)
        return stages[0].some(every[1::2]), stages[0].some(every[::2])
    return stages[1], stages[0]


def write_poses(folder: Path, trajectory: Trajectory) -> None:
    """Write camera_poses.npz into an existing folder."""
    t = np.rint(trajectory.t * 1e9).astype(np.int64) + trajectory.zero_ns
    np.savez(
        folder / POSES, T_wc_position=trajectory.position, T_wc_orientation=trajectory.orientation, T_wc_timestamp=t
    )  # fmt: skip


def _whole_ns(file: Path, key: str, values: np.ndarray) -> np.ndarray:
    """Timestamps (n,) as int64 ns, from the unit that NAME.source.toml next to the file states; ns without it."""
    scale = NS_PER_UNIT[options_for(file).time_unit or "ns"]
    if values.ndim != 1 or values.dtype.kind not in "iuf":
        raise InputError(f"{file}: {key}: expected one column of numbers, found {values.dtype} of shape {values.shape}")
    if values.dtype.kind == "f":
        values, scale = np.rint(finite(file, key, values) * scale), 1
    if len(values) and not (int(values.min()) * scale >= -MOST_NS and int(values.max()) * scale <= MOST_NS):
        found = f"{values.min():.4g} … {values.max():.4g}"
        raise InputError(f"{file}: {key}: expected nanoseconds that fit 64 bits, found {found}")
    return values.astype(np.int64, copy=False) * scale


def _way(file: Path) -> str:
    """How to state the unit of a file's times."""
    return f'state it: time_unit = "s" (ms, us, ns) in {file.stem}.source.toml'


def _events(file: Path, calibration: Calibration):
    """(timestamp ns, x, y, on) sorted by time."""
    arrays = read_arrays(file, ("position", "timestamp", "polarity"))
    position, polarity = arrays["position"], arrays["polarity"]
    t = _whole_ns(file, "timestamp", arrays["timestamp"])
    if len(t) == 0:
        raise InputError(f"{file}: timestamp: no events")
    if position.ndim != 2 or position.shape[1] != 2:
        raise InputError(f"{file}: position: expected (N, 2) x and y, found shape {position.shape}")
    if position.dtype.kind not in "iuf":
        raise InputError(f"{file}: position: expected numbers, found {position.dtype}")
    for key, column in (("position", position), ("polarity", polarity)):
        if len(np.atleast_1d(column)) != len(t):
            raise InputError(
                f"{file}: {key}: expected {len(t)} rows as in timestamp, found {len(np.atleast_1d(column))}"
            )
    x, y = _pixels(file, position, calibration)
    del arrays["position"], position
    values = _distinct(polarity)
    if not (values <= {0, 1} or values <= {-1, 1}):
        raise InputError(f"{file}: polarity: expected booleans, 0 and 1, or −1 and 1, found {str(values)[:60]}")
    on = polarity > 0
    if (t[1:] < t[:-1]).any():
        order = np.argsort(t, kind="stable")
        t, x, y, on = t[order], x[order], y[order], on[order]
    return t, x, y, on


def _pixels(file: Path, position: np.ndarray, calibration: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """x and y (N,) int32, inside the sensor."""
    camera = calibration.camera
    if position.dtype.kind == "f":
        position = finite(file, "position", position)
        if (between := (position != np.rint(position)).any(axis=1)).any():
            k = int(np.argmax(between))
            x, y = position[k].tolist()
            raise InputError(f"{file}: position: expected whole pixels, found ({x:g}, {y:g}) in row {k}")
    x, y = position.T
    outside = (x < 0) | (x >= camera.width) | (y < 0) | (y >= camera.height)
    if outside.any():
        k = int(np.argmax(outside))
        raise InputError(
            f"{file}: position: row {k} is ({x[k]}, {y[k]}), outside the {camera.width} × {camera.height} pixels of "
            f"{CALIBRATION} (img_width, img_height)"
        )
    return x.astype(np.int32), y.astype(np.int32)


def _distinct(polarity: np.ndarray) -> set:
    """The values of a column of polarities; {None} where it is none."""
    if polarity.ndim != 1 or polarity.dtype.kind not in "biuf":
        return {None}
    if polarity.dtype.kind == "b":
        return {0, 1}
    blocks = (polarity[k : k + BLOCK] for k in range(0, len(polarity), BLOCK))
    return set().union(*(np.unique(block).tolist() for block in blocks))


def _poses(file: Path) -> Trajectory:
    """The trajectory in seconds from its first pose."""
    arrays = read_arrays(file, ("T_wc_position", "T_wc_orientation", "T_wc_timestamp"))
    t = _whole_ns(file, "T_wc_timestamp", arrays["T_wc_timestamp"])
    position, orientation = arrays["T_wc_position"], arrays["T_wc_orientation"]
    if len(t) < 2:
        raise InputError(f"{file}: T_wc_timestamp: expected at least two poses, found {len(t)}")
    if not (np.diff(t) > 0).all():
        raise InputError(
            f"{file}: T_wc_timestamp: must increase, row {int(np.argmin(np.diff(t) > 0)) + 1} does not; if "
            f"the unit is not ns, {_way(file)}"
        )
    if position.shape != (len(t), 3):
        raise InputError(f"{file}: T_wc_position: expected ({len(t)}, 3), found {position.shape}")
    if orientation.shape not in ((len(t), 4), (len(t), 3, 3)):
        raise InputError(
            f"{file}: T_wc_orientation: expected ({len(t)}, 4) or ({len(t)}, 3, 3), found {orientation.shape}"
        )
    position = np.ascontiguousarray(finite(file, "T_wc_position", position))
    if not (np.abs(position) <= MOST_AWAY).all():
        raise InputError(
            f"{file}: T_wc_position: expected at most {MOST_AWAY:g} from the origin, found {np.abs(position).max():.3g}"
        )
    orientation = np.ascontiguousarray(unit_quaternions(file, "T_wc_orientation", orientation))
    return Trajectory((t - t[0]) * 1e-9, position, orientation, int(t[0]))
