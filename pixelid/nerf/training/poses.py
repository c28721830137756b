"""Poses and clock of the camera, refined with the scene under priors.

    pose of an event at t = correction(t) ∘ trajectory(t + τ)

τ is one number.  The correction is a shift of the camera and a rotation about it, as a vector in the scene's axes, both
linear in time between knots.  Their means over the knots are held at zero: what cameras and scene have in common, no
event shows.  The prior of τ, and of every knot's numbers, is a normal one about zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from pixelid.nerf.data.trajectory import Trajectory
from pixelid.nerf.field.render import threads

KNOTS = 32


@dataclass(frozen=True)
class Refinement:
    """What of the poses is trained with the scene, by the standard deviations of the priors; 0 is not trained.

    time_sd: s, of the offset between the clocks;  position_sd: in the unit of the scene, rotation_sd: rad, of each
    coordinate at each of `knots` times, evenly apart
    """

    time_sd: float = 0.0
    position_sd: float = 0.0
    rotation_sd: float = 0.0
    knots: int = KNOTS

    @classmethod
    def of(cls, time_sd: float | None, poses_sd: Sequence[float] | None) -> Refinement:
        """From s, and (scene's unit, degrees); None for what is not trained."""
        position, degrees = poses_sd or (0.0, 0.0)
        return cls(time_sd or 0.0, position, math.radians(degrees))

    @property
    def moves(self) -> bool:
        """Whether poses depart from the trajectory."""
        return bool(self.position_sd > 0 or self.rotation_sd > 0)


class Poses(torch.nn.Module):
    """A trajectory as training sees it.

    offset: (1,) τ and moved: (knots, 6) shift and rotation, in their standard deviations, trained where these are not 0
    """

    sd: torch.Tensor

    def __init__(self, trajectory: Trajectory, refinement: Refinement) -> None:
        super().__init__()
        self.trajectory, self.refinement = trajectory, refinement
        self.offset = torch.nn.Parameter(
            torch.zeros(1, dtype=torch.float64), requires_grad=bool(refinement.time_sd > 0)
        )
        moved = torch.zeros(refinement.knots, 6, dtype=torch.float64)
        self.moved = torch.nn.Parameter(moved, requires_grad=refinement.moves)
        sd = [refinement.position_sd] * 3 + [refinement.rotation_sd] * 3
        self.register_buffer("sd", torch.tensor(sd, dtype=torch.float64))

    @property
    def trained(self) -> bool:
        """Whether anything is."""
        return self.offset.requires_grad or self.moved.requires_grad

    @property
    def time_offset_s(self) -> float:
        """τ."""
        return self.refinement.time_sd * float(self.offset.detach())

    def rays(self, times: np.ndarray, inside: np.ndarray):
        """World origins and unit directions (n, 3) float32 of camera-frame unit directions (n, 3) at times (n,) s.

        Arrays where nothing is trained, else tensors.
        """
        if not self.trained:
            return self.trajectory.rays(times, inside, threads())
        there = times + self.time_offset_s
        device = self.offset.device
        rays = [
            torch.as_tensor(column, device=device).double() for column in self.trajectory.rays(there, inside, threads())
        ]
        if self.offset.requires_grad:
            later = self.refinement.time_sd * (self.offset - self.offset.detach())
            rays = [column + later * rate for column, rate in zip(rays, self._rates(there, inside), strict=True)]
        origins, directions = rays
        if self.moved.requires_grad:
            correction = self._corrections(times)
            origins, directions = origins + correction[:, :3], _rotated(directions, correction[:, 3:])
        return origins.float(), directions.float()

    def _rates(self, times: np.ndarray, inside: np.ndarray) -> list[torch.Tensor]:
        """Derivatives of origins and directions by time, (n, 3) each, over a quarter of the spacing of the poses."""
        step = 0.25 * float(np.median(np.diff(self.trajectory.t)))
        before, after = (self.trajectory.rays(times + shift, inside, threads()) for shift in (-step, step))
        return [
            torch.as_tensor((b.astype(np.float64) - a) / (2 * step), device=self.offset.device)
            for a, b in zip(before, after, strict=True)
        ]

    def _corrections(self, times: np.ndarray) -> torch.Tensor:
        """(n, 6) shift and rotation at times."""
        t, knots = self.trajectory.t, len(self.moved)
        place = np.clip((times - t[0]) / (t[-1] - t[0]), 0.0, 1.0) * (knots - 1)
        k = np.minimum(place.astype(np.int64), knots - 2)
        share = torch.as_tensor(place - k, device=self.moved.device)[:, None]
        which = torch.as_tensor(k, device=self.moved.device)
        centred = self.sd * (self.moved - self.moved.mean(dim=0))
        return torch.lerp(centred[which], centred[which + 1], share)

    def penalty(self) -> torch.Tensor:
        """−ln prior."""
        return 0.5 * (self.offset**2).sum() + 0.5 * (self.moved**2).sum()

    def refined(self) -> Trajectory:
        """The trajectory on the events' clock with its corrections."""
        t = self.trajectory.t
        position, rotation = self.trajectory.at(t + self.time_offset_s)
        with torch.no_grad():
            correction = self._corrections(t).cpu().numpy()
        turned = Rotation.from_rotvec(correction[:, 3:]) * Rotation.from_matrix(rotation)
        return replace(self.trajectory, position=position + correction[:, :3], orientation=turned.as_quat())

    def as_dict(self, time_resolution_s: float) -> dict[str, float | None] | None:
        """The entry "poses" of reconstruction.json; None where nothing is trained.

        time_resolution_s: of `gauge.time_resolution`
        """
        if not self.trained:
            return None
        with torch.no_grad():
            rms = self._corrections(self.trajectory.t).square().mean(dim=0)
        return {
            "time_offset_s": self.time_offset_s,
            "time_resolution_s": time_resolution_s if math.isfinite(time_resolution_s) else None,
            "position_rms": math.sqrt(float(rms[:3].sum())),
            "rotation_rms_deg": math.degrees(math.sqrt(float(rms[3:].sum()))),
        }


def _rotated(vectors: torch.Tensor, by: torch.Tensor) -> torch.Tensor:
    """Vectors (n, 3) turned by rotation vectors (n, 3) of less than a radian (Rodrigues, its series to 1e-6)."""
    angle2 = (by * by).sum(dim=1, keepdim=True)
    sine = 1 - angle2 / 6 * (1 - angle2 / 20 * (1 - angle2 / 42))  # sin(θ)/θ
    cosine = 0.5 * (1 - angle2 / 12 * (1 - angle2 / 30 * (1 - angle2 / 56)))  # (1 − cos θ)/θ²
    once = torch.linalg.cross(by, vectors)
    return vectors + sine * once + cosine * torch.linalg.cross(by, once)
