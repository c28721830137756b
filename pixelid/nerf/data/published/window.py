"""Which part of a sequence is kept: between two times, and where the poses have no gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pixelid.errors import InputError
from pixelid.nerf.data.published.source import Poses
from pixelid.nerf.data.trajectory import Trajectory


@dataclass(frozen=True)
class Window:
    """A part of a sequence.  begin, end: ns;  poses: from begin to end, both included;  notes: what was left out."""

    begin: int
    end: int
    poses: Poses
    notes: tuple[str, ...]

    @property
    def trajectory(self) -> Trajectory:
        """The poses, in seconds from the beginning."""
        t, position, orientation = self.poses
        return Trajectory((t - self.begin) * 1e-9, np.ascontiguousarray(position), np.ascontiguousarray(orientation))


def window_of(poses: Poses, start: float | None, end: float | None) -> Window:
    """The longest part without a gap in the poses, between two times.

    Args:
        poses: of the sequence.
        start: s after the first pose; its beginning by default.
        end: s after the first pose; its end by default.

    Returns:
        The part, with poses interpolated at both ends.

    Raises:
        InputError: there are no poses between the two times.
    """
    zero, last = int(poses.t[0]), int(poses.t[-1])
    begin = zero if start is None else zero + round(start * 1e9)
    until = last if end is None else min(last, zero + round(end * 1e9))
    step = np.diff(poses.t)
    # Motion capture that loses its markers leaves gaps: longer than ten usual steps, and than a hand takes to turn.
    gap_steps, gap_ns = 10.0, 100_000_000
    gap = max(gap_steps * float(np.median(step)), gap_ns)
    edges = np.flatnonzero(step > gap)
    parts = [
        (max(int(poses.t[a]), begin), min(int(poses.t[b]), until))
        for a, b in zip([0, *(edges + 1)], [*edges, len(poses.t) - 1], strict=True)
    ]
    parts = [(a, b) for a, b in parts if b > a]
    if not parts:
        covered = (last - zero) * 1e-9
        raise InputError(f"--start, --end: expected times with poses between 0 and {covered:.3f} s after the first one")
    a, b = max(parts, key=lambda part: part[1] - part[0])
    notes = ()
    if len(parts) > 1:
        others = ", ".join(f"{(x - zero) * 1e-9:.2f} … {(y - zero) * 1e-9:.2f} s" for x, y in parts if x != a)
        notes = (f"poses have gaps: only the longest part is kept, {others} left out (--start and --end choose)",)
    return Window(a, b, _between(poses, a, b), notes)


def _between(poses: Poses, begin: int, end: int) -> Poses:
    """The poses inside, and interpolated ones at both ends."""
    inside = (poses.t > begin) & (poses.t < end)
    position, orientation = (np.ascontiguousarray(column) for column in poses[1:])
    whole = Trajectory((poses.t - begin) * 1e-9, position, orientation)
    times = np.array([0.0, (end - begin) * 1e-9])
    position, rotation = whole.at(times)
    orientation = Rotation.from_matrix(rotation).as_quat()
    return Poses(
        np.concatenate([[begin], poses.t[inside], [end]]),
        np.concatenate([position[:1], poses.position[inside], position[1:]]),
        np.concatenate([orientation[:1], poses.orientation[inside], orientation[1:]]),
    )
