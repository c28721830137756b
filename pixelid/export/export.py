"""A circuit for another simulator: which there are, and how each is written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pixelid.export import deblur_e_nerf, dvs_voltmeter, esim, iebcs, v2e
from pixelid.export.exported import Exported, write_arrays, write_json, write_lines
from pixelid.export.light import GREY_LEVELS, IRRADIANCE, Light
from pixelid.model.model import Model
from pixelid.model.shipped import model_files
from pixelid.provenance import provenance
from pixelid.results import read_unidentified


@dataclass(frozen=True)
class Target:
    """A simulator: how a circuit becomes its parameters, and the lines of its file (None: it reads no text)."""

    convert: Callable[[Model, Light], Exported]
    lines: Callable[[Exported], Sequence[str]] | None = None


TARGETS = {
    "v2e": Target(v2e.export, v2e.lines),
    "iebcs": Target(iebcs.export),
    "esim": Target(esim.export, esim.lines),
    "deblur-e-nerf": Target(deblur_e_nerf.export),
    "dvs-voltmeter": Target(dvs_voltmeter.export, dvs_voltmeter.lines),
}


def export(model: Model, to: str, light: Light) -> Exported:
    """The parameters of a simulator that come nearest to a circuit.

    Args:
        model: The circuit.
        to: One of `TARGETS`.
        light: How images show radiance.

    Example:
        >>> from pixelid.export.export import export
        >>> from pixelid.export.light import Light
        >>> from pixelid.model.shipped import find_model
        >>> round(export(find_model("dvs128"), "v2e", Light()).parameters["pos_thres"], 2)
        0.25
    """
    return TARGETS[to].convert(model, light)


def exported(
    model: Model,
    to: str,
    *,
    white: float | None = None,
    level: float | None = None,
    spec: str | Path = "",
    seed: int = 0,
) -> Exported:
    """The parameters of a simulator, with what is lost and where it comes from.

    Args:
        model: The circuit.
        to: One of `TARGETS`.
        white: Radiance of a white pixel; `GREY_LEVELS` of the model's unit by default.
        level: Radiance at which one number stands for what depends on light; `white` by default.
        spec: What the model was given by, a name, file or folder; "" for one in memory.
        seed: Recorded.

    Raises:
        InputError: A circuit that the simulator cannot express at all.
    """
    unit, lost = model.radiance_unit, []
    result = export(model, to, Light(white or GREY_LEVELS, level or white or GREY_LEVELS, unit))
    if white is None and unit in IRRADIANCE:
        lost.append(f"light: {GREY_LEVELS:g} {unit} stands for white, 255 grey levels, since --white does not say")
    if spec:
        lost += [f"not identified by the fit: {sentence}" for sentence in read_unidentified(Path(spec))]
    files = model_files(spec) if spec else []
    return replace(result, lost=(*result.lost, *lost), provenance={"seed": seed, **provenance(*files)})


def write(exported: Exported, path: Path, *, as_json: bool) -> None:
    """Write the simulator's own file, or JSON.

    What reads no text of its own is JSON in any case, but for the calibration of Deblur e-NeRF, a NumPy archive.
    """
    lines = TARGETS[exported.target].lines
    if as_json or (lines is None and exported.target != "deblur-e-nerf"):
        write_json(exported, path)
    elif lines is None:
        write_arrays(exported, path)
    else:
        write_lines(exported, path, lines(exported))
