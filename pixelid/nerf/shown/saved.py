"""A reconstruction as its folder holds it: the scene and what was found, without the data it was trained on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch

from pixelid.arrays import load_arrays
from pixelid.documents import interpreting
from pixelid.errors import InputError, shown
from pixelid.nerf.field.bricks import Bricks
from pixelid.nerf.field.contraction import LEAST_VERTICES
from pixelid.nerf.field.harmonics import number_of
from pixelid.nerf.field.radiance import Field
from pixelid.nerf.options import HIGHEST_DEGREE
from pixelid.nerf.shown.correction import Correction
from pixelid.options import numbers
from pixelid.results import Result, Table, check_kinds, number, read_result, required
from pixelid.status import Status

FILE, FIELD = "reconstruction.json", "field.npz"
DEGREES = {number_of(degree): degree for degree in range(HIGHEST_DEGREE + 1)}  # number of harmonics → degree


@dataclass(frozen=True, repr=False)
class SavedReconstruction(Result):
    """A scene, and how well it can be trusted.

    Attributes:
        content: of reconstruction.json.
        field: the scene; `field(rays)` renders it.

    Example:
        >>> from pixelid.nerf.shown.saved import SavedReconstruction
        >>> SavedReconstruction.load("out").to_dataframe()  # doctest: +SKIP
    """

    FILE: ClassVar[str] = FILE

    content: Mapping[str, Any]
    field: Field

    @property
    def status(self) -> Status:
        """How it ended."""
        return Status(self.content["status"])

    @property
    def advice(self) -> str:
        """What to do about it."""
        return self.content["advice"]

    @property
    def held_out(self) -> float:
        """Share of held-out changes left unexplained."""
        return self.content["held_out_residual"]

    @property
    def ignored(self) -> Sequence[str]:
        """What is known of the pixel and the reconstruction does not model."""
        return self.content["ignored"]

    @property
    def gap(self) -> Mapping[str, Any] | None:
        """Effects found in the events, where they were looked for."""
        return self.content.get("gap")

    @property
    def log_eps(self) -> float:
        """What the data set adds to pictures of its views that are not quantised."""
        return float(self.content.get("log_eps") or 0.0)

    @property
    def correction(self) -> Correction | None:
        """That the scores were made with, None where there is none."""
        a, b, c = (np.atleast_1d(np.asarray(self.content["correction"][name], dtype=float)) for name in "abc")
        return Correction(a, b, c) if np.isfinite(np.concatenate([a, b, c])).all() else None

    @property
    def dark(self) -> np.ndarray:
        """(C,) black level that the field does not hold."""
        told = self.content["pixel"].get("dark")
        return np.resize(np.asarray(0.0 if told is None else told, dtype=float), self.field.grid.shape[1] - 1)

    @property
    def headline(self) -> str:
        """Status and scores."""
        views = self.content["views"]
        scored = (
            f"{_digits(views['psnr'], 2)} dB{self._published}, SSIM {_digits(views['ssim'], 3)} over "
            f"{len(views['per_view'])} test views"
            if views["per_view"]
            else "no views to compare with"
        )
        return (
            f"reconstruction: {self.status}; {scored}, {_percent(self.content['held_out_residual'])} "
            f"unexplained on held-out pixels, {self.content['seconds']:.0f} s"
        )

    @property
    def _published(self) -> str:
        """The score by the reference implementation's protocol, where it was asked for."""
        other = self.content.get("published_protocol")
        return f" ({_digits(other['psnr'], 2)} dB by the paper's protocol)" if other else ""

    def tables(self) -> list[Table]:
        """Scores of every test view."""
        rows = tuple(
            (str(view["name"]), _digits(view["psnr"], 2), _digits(view["ssim"], 3), number(view["lpips"]))
            for view in self.content["views"]["per_view"]
        )
        return [Table("", ("view", "PSNR [dB]", "SSIM", "LPIPS"), rows, frozenset({"view"}))]

    def records(self) -> list[dict[str, Any]]:
        """One row per test view."""
        return [
            {"view": view["name"], "psnr": view["psnr"], "ssim": view["ssim"], "lpips": view["lpips"]}
            for view in self.content["views"]["per_view"]
        ]

    def sentences(self) -> list[str]:
        """Advice, what was found in the events or left open by them, and what the pixel has and is not modelled."""
        ignored = self.content["ignored"]
        said = f"not modelled: {', '.join(ignored)}" if ignored else ""
        open_ = [f"not identified: {text}" for text in self.content.get("unidentified", ())]
        texts = (self.advice or self.status.advice, self._found, self._moved, *open_, said)
        return [text for text in texts if text]

    @property
    def _moved(self) -> str:
        """What became of the poses, where they were refined."""
        poses = self.content.get("poses")
        if not poses:
            return ""
        return (
            f"poses refined: events at t saw the poses of t {1e3 * poses['time_offset_s']:+.3g} ms, moved by "
            f"{poses['position_rms']:.3g} of the scene's unit and {poses['rotation_rms_deg']:.2g}° (root mean square)"
        )

    @property
    def _found(self) -> str:
        """Effects found in the events, where they were looked for."""
        gap = self.gap
        if not gap:
            return ""
        names = [effect["name"] for effect in gap["effects"] if effect["heldout_gain"] is not None]
        explained = f"{', '.join(names)}, {100 * gap['heldout_gain']:.0f} % of the held-out loss explained"
        left_out = [
            f"{effect['values']['hot_pixels.count']:.0f} hot pixels, left out"
            for effect in gap["effects"]
            if effect["name"] == "hot_pixels"
        ]
        said = [*([explained] if names else []), *left_out] or ["no effect that the pixel lacks"]
        return f"found in the events: {'; '.join(said)}"

    def as_dict(self) -> dict[str, Any]:
        """The content of reconstruction.json (docs/formats.md)."""
        return dict(self.content)

    def write_companions(self, folder: Path) -> None:
        """Write field.npz, the scene."""
        write_field(self.field, folder)

    @staticmethod
    def load(folder: str | Path) -> SavedReconstruction:
        """The scene of a folder.

        Args:
            folder: that `save` or `pixelid reconstruct` wrote.

        Returns:
            The scene with its scores; it renders, and cannot be trained on.

        Raises:
            InputError: no reconstruction there, a damaged one, or one that diverged.
        """
        folder = Path(folder)
        content = read_result(folder, FILE)
        check_kinds(
            content, folder / FILE, text=("status", "advice", "bandwidth"),
            a_list_of_texts=("ignored", "unidentified"), a_table=("views", "pixel", "correction"),
            a_number=("seconds", "held_out_residual"),
        )  # fmt: skip
        needed = ("status", "advice", "views", "held_out_residual", "seconds", "ignored", "pixel", "correction")
        required(content, folder, FILE, *needed)
        if content["status"] == Status.diverged:  # what its field holds is no scene, and may be no numbers
            raise InputError(f"{folder}: the reconstruction diverged, there is no scene: {content['advice']}")
        saved = SavedReconstruction(content, read_field(folder))
        with interpreting(folder / FILE, "a reconstruction"):
            saved.summary()
            _check_colours(content, folder / FILE, saved.field.grid.shape[1] - 1)
            if not (math.isfinite(saved.log_eps) and saved.log_eps >= 0):
                raise ValueError(f"log_eps: expected a number of at least 0, found {saved.log_eps}")
        return saved


def _check_colours(content: Mapping[str, Any], file: Path, colours: int) -> None:
    """Raise InputError unless correction and black level are one number, or one per colour, or all null."""
    correction = {f"correction.{name}": _listed(content["correction"][name]) for name in "abc"}
    if all(values and all(value is None for value in values) for values in correction.values()):  # nothing was scored
        correction = {}
    dark = content["pixel"].get("dark")
    told = correction | ({} if dark is None else {"pixel.dark": _listed(dark)})
    for name, values in told.items():
        least = 0.0 if name == "pixel.dark" else -math.inf
        numbers(f"{file}: {name}", values, 1 if len(values) == 1 else colours, least=least)


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def write_field(scene: Field, folder: Path) -> None:
    """Write field.npz into an existing folder.

    Its arrays: grid (n, n, n, 1 + C), coefficients (n, n, n, C, K), both in half precision, low, high (3,) and
    background (C,); near (), the distance before which rays meet nothing, where it is not 0; unbounded (), 1 where low
    and high are the corners of the inner box, beyond which space is contracted (`contraction`).  Of a field that is not
    held whole: grid (rows, 1 + C), coefficients (rows, C, K), vertices () and bricks (b, b, b), which say where the
    rows are (`Bricks`).
    """
    background = np.exp(scene.log_background.detach().cpu().numpy())
    arrays: dict[str, Any] = {"low": scene.low, "high": scene.high, "background": background}
    arrays |= {"near": scene.near} if scene.near else {}
    arrays |= {"unbounded": 1} if scene.unbounded else {}
    if scene.bricks.whole:
        grid, coefficients = scene.dense()
    else:
        grid, coefficients = scene.grid.detach().cpu().numpy(), scene.coefficients.detach().cpu().numpy()
        arrays |= {"vertices": scene.vertices, "bricks": scene.bricks.index}
    arrays |= {"grid": grid.astype(np.float16), "coefficients": coefficients.astype(np.float16)}
    np.savez_compressed(folder / FIELD, **arrays)


def read_field(folder: Path) -> Field:
    """The scene that `write_field` wrote, to half precision.

    Raises:
        InputError: no scene there, or a damaged one.
    """
    arrays = load_arrays(folder / FIELD)
    with interpreting(folder / FIELD, "a scene"):
        _check_scene(arrays)
        grid = torch.from_numpy(arrays["grid"].astype(np.float32))
        bricks = None
        if "bricks" in arrays:
            bricks = Bricks.of_index(arrays["vertices"].astype(int).item(), arrays["bricks"])
        shape = (bricks.rows,) if bricks is not None else (grid.shape[0],) * 3
        channels = arrays["background"].size
        if grid.shape != (*shape, 1 + channels):
            raise ValueError(f"grid {tuple(grid.shape)} of {channels} colours")
        coefficients = torch.from_numpy(arrays["coefficients"].astype(np.float32)) if "coefficients" in arrays else None
        if coefficients is not None and (
            coefficients.shape[:-1] != (*shape, channels) or coefficients.shape[-1] not in DEGREES
        ):
            raise ValueError(f"coefficients {tuple(coefficients.shape)} of a grid {tuple(grid.shape)}")
        near = float(arrays["near"].item()) if "near" in arrays else 0.0
        unbounded = "unbounded" in arrays and bool(arrays["unbounded"].item())
        vertices = grid.shape[0] if bricks is None else bricks.vertices
        if unbounded and vertices < LEAST_VERTICES:
            raise ValueError(f"unbounded: expected at least {LEAST_VERTICES} vertices per side, found {vertices}")
        scene = Field(
            arrays["low"], arrays["high"], 2, channels, arrays["background"], near=near, unbounded=unbounded
        )  # fmt: skip
        if bricks is None:
            scene.hold_dense(grid, coefficients)
        else:
            scene.hold(bricks, grid, coefficients)
            scene.look_for_empty_blocks()  # bricks that it has just grown into are not seen while it is trained either
        return scene


def _check_scene(arrays: Mapping[str, np.ndarray]) -> None:
    """Raise ValueError for numbers of which no scene can be: a box without inside, radiance that is not positive."""
    for name in ("grid", "coefficients", "low", "high", "background", "vertices", "bricks", "near", "unbounded"):
        if name in arrays and (arrays[name].dtype.kind not in "fiu" or not np.isfinite(arrays[name]).all()):
            raise ValueError(f"{name}: expected finite numbers")
    if "near" in arrays and not (arrays["near"].size == 1 and arrays["near"] >= 0):
        raise ValueError(f"near: expected a distance, found {shown(arrays['near'].tolist())}")
    if "unbounded" in arrays and not (arrays["unbounded"].size == 1 and arrays["unbounded"] in (0, 1)):
        raise ValueError(f"unbounded: expected 0 or 1, found {shown(arrays['unbounded'].tolist())}")
    low, high, background = arrays["low"], arrays["high"], arrays["background"]
    if low.shape != (3,) or high.shape != (3,) or not (low < high).all():
        raise ValueError(f"low, high: expected corners of a box, found {shown(low.tolist())}, {shown(high.tolist())}")
    if arrays["grid"].shape[0] < 2 or background.size not in (1, 3) or not (background > 0).all():
        raise ValueError(f"background: expected one or three positive numbers, found {shown(background.tolist())}")


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


def _digits(value: float | None, places: int) -> str:
    return "–" if value is None else f"{value:.{places}f}"
