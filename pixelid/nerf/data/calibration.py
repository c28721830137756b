"""`camera_calibration.npz`: the camera's geometry and its pixel's circuit, in the radiance unit of the views.

The file quotes circuit values with the photocurrent per unit of image intensity divided out:

    input_time_const_eff_it_prod   q_in = τ_in L       miller_time_const_eff_it_prod   q_mil = τ_mil L
    A_loop = amplifier_gain / closed_loop_gain         black_level = dark current in units of image intensity

They enter through the invariants α, β, γ (docs/model.md).  A fit of the same camera may replace them: its radiance
unit is tied to the dataset's by q_in, which both quote (the fit in its gauge).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.documents import read_json
from pixelid.errors import InputError, shown
from pixelid.model.model import Model
from pixelid.model.shipped import find_model
from pixelid.nerf.data.arrays import finite, has_none, intrinsics_of, read_arrays, scalar
from pixelid.nerf.data.camera import DISTORTIONS, Camera, refuse_lens_without_inverse
from pixelid.nerf.pixel.maps import THRESHOLDS
from pixelid.parameters.invariants import Physical
from pixelid.recordings.events import MOST_PIXELS, MOST_SIDE
from pixelid.stages.circuit import Circuit

FILE = "camera_calibration.npz"
GEOMETRY = ("intrinsics", "distortion_params", "distortion_model", "img_height", "img_width", "bayer_pattern")
COMPARATOR = ("pos_contrast_threshold", "neg_contrast_threshold", "refractory_period")
CIRCUIT = (
    "input_time_const_eff_it_prod", "miller_time_const_eff_it_prod", "black_level", "amplifier_gain",
    "closed_loop_gain", "output_time_const", "lower_cutoff_freq", "sf_cutoff_freq", "diff_amp_cutoff_freq",
)  # fmt: skip
KEPT = "kept_pixels"  # optional: (height, width) bool
COLOURS = "RGB"


@dataclass(frozen=True)
class Calibration:
    """Geometry and pixel of a dataset.

    camera: of the event sensor;  bayer: "" (monochrome) or four letters, the 2 × 2 colours row by row;
    circuit: in the views' radiance unit, `dark` included;  dark: (C,) black level per colour channel;
    q_in: the input time constant × radiance [unit·s], which ties fits of other units to this one;
    known: whether the file has the circuit (data sets of Robust e-NeRF have thresholds and dead time only);
    kept: (pixels,) bool, row-major, whose events the data set has, None for all; of the others nothing is known
    """

    camera: Camera
    bayer: str
    circuit: Circuit
    dark: np.ndarray
    q_in: float
    known: bool
    kept: np.ndarray | None = None

    @property
    def channels(self) -> int:
        """1 for a monochrome sensor, 3 behind a colour filter array."""
        return 3 if self.bayer else 1

    def channel_of(self, x, y) -> np.ndarray:
        """The colour channel (n,) of pixels at integer positions x, y (n,)."""
        if not self.bayer:
            return np.zeros(len(x), np.int64)
        pattern = np.array([COLOURS.index(letter) for letter in self.bayer])
        return pattern[(np.asarray(x) % 2) + 2 * (np.asarray(y) % 2)]


def read_calibration(path: Path) -> Calibration:
    """The calibration of a dataset folder.

    Args:
        path: the dataset's folder.

    Returns:
        Camera, colour pattern, pixel and black level.

    Raises:
        InputError: naming file and key.
    """
    file = Path(path) / FILE
    known = not has_none(file, CIRCUIT)
    arrays = read_arrays(file, (*GEOMETRY, *COMPARATOR, *(CIRCUIT if known else ())))
    camera = _camera(file, arrays)
    kept = _kept_pixels(file, camera)
    bayer = str(arrays["bayer_pattern"])
    if bayer and (len(bayer) != 4 or set(bayer) != set(COLOURS)):
        raise InputError(f"{file}: bayer_pattern: expected '' or four letters of {COLOURS}, found {shown(bayer)}")
    if not known:
        return Calibration(camera, bayer, _comparator(file, arrays), np.zeros(3 if bayer else 1), 0.0, False, kept)
    circuit, q_in = _circuit(file, arrays)
    dark = finite(file, "black_level", np.atleast_1d(arrays["black_level"])).ravel()
    if len(dark) not in (1, 3) or not (np.isfinite(dark) & (dark >= 0)).all():
        raise InputError(f"{file}: black_level: expected one or three numbers ≥ 0, found {dark}")
    dark = np.resize(dark if bayer else dark.mean(), 3 if bayer else 1)
    return Calibration(camera, bayer, circuit.with_(dark=float(dark.mean())), dark, q_in, True, kept)


def _kept_pixels(file: Path, camera: Camera) -> np.ndarray | None:
    """(pixels,) bool of `KEPT`, None where the file has none."""
    if has_none(file, (KEPT,)):
        return None
    kept = read_arrays(file, (KEPT,))[KEPT]
    if kept.shape != (camera.height, camera.width) or kept.dtype != np.bool_ or not kept.any():
        raise InputError(
            f"{file}: {KEPT}: expected ({camera.height}, {camera.width}) booleans, not all false, found {kept.dtype} "
            f"of shape {kept.shape}"
        )
    return kept.ravel()


def _camera(file: Path, arrays: dict[str, np.ndarray]) -> Camera:
    intrinsics = intrinsics_of(file, arrays["intrinsics"])
    distortion = finite(file, "distortion_params", np.atleast_1d(arrays["distortion_params"])).ravel()
    model = str(arrays["distortion_model"])
    if len(distortion) not in (0, 4, 5) or not np.isfinite(distortion).all():
        raise InputError(f"{file}: distortion_params: expected 0, 4 or 5 finite numbers, found {distortion}")
    if np.any(distortion != 0) and (model not in DISTORTIONS or (model == "equidistant" and len(distortion) != 4)):
        raise InputError(f"{file}: distortion_model: expected one of {', '.join(DISTORTIONS)}, found {shown(model)}")
    height, width = (scalar(file, arrays, name, least=1) for name in ("img_height", "img_width"))
    if max(height, width) > MOST_SIDE or height * width > MOST_PIXELS or height % 1 or width % 1:
        raise InputError(
            f"{file}: img_width, img_height: expected whole numbers of at most {MOST_SIDE}, together {MOST_PIXELS} "
            f"pixels, found {width:g} × {height:g}"
        )
    camera = Camera(intrinsics, round(width), round(height), distortion, model)
    refuse_lens_without_inverse(file, "distortion_params", camera)
    return camera


def _circuit(file: Path, arrays: dict[str, np.ndarray]) -> tuple[Circuit, float]:
    """The circuit of the file's values, and its q_in."""
    q_in, q_mil, tau_out = (scalar(file, arrays, name, least=0) for name in (CIRCUIT[0], CIRCUIT[1], CIRCUIT[5]))
    gain, closed = (
        scalar(file, arrays, name, above=0, finite=False) for name in ("amplifier_gain", "closed_loop_gain")
    )
    lower = scalar(file, arrays, "lower_cutoff_freq", least=0)
    follower, differencing = (scalar(file, arrays, name, above=0, finite=False) for name in CIRCUIT[7:])
    circuit = _comparator(file, arrays).with_(
        follower=2 * math.pi * follower, differencing=2 * math.pi * differencing, lower_cutoff=2 * math.pi * lower
    )  # fmt: skip
    loop = gain / closed
    if not math.isfinite(gain) or q_in + q_mil == 0:
        return circuit, q_in
    if tau_out == 0:
        return circuit.with_(photoreceptor="one_pole", corner=(loop + 1) / (q_in + (gain + 1) * q_mil)), q_in
    alpha, beta, gamma = Physical(gain, loop, tau_out, q_in, q_mil).invariants()
    return circuit.with_(photoreceptor="second_order", alpha=alpha, beta=beta, gamma=gamma), q_in


def _comparator(file: Path, arrays: dict[str, np.ndarray]) -> Circuit:
    """A circuit without bandwidth limit: thresholds and dead time alone."""
    on, off = (scalar(file, arrays, name, above=0) for name in COMPARATOR[:2])
    refractory = scalar(file, arrays, "refractory_period", least=0) * 1e-9
    return Circuit(photoreceptor="unlimited", on_threshold=on, off_threshold=off, refractory=refractory)


def of_fit(calibration: Calibration, folder: Path, scale: float | None = None) -> Calibration:
    """The calibration with the pixel of a fit in place of the file's.

    Args:
        calibration: of the dataset.
        folder: of the fit, or a model file.
        scale: the fit's radiance units per unit of the views; by default from q_in, which the fit's gauge (or nominal
            physical values) and the dataset both quote.

    Returns:
        The calibration with another circuit, and another black level where the fit has one.

    Raises:
        InputError: no fit there, one without thresholds, or no scale when neither states it.
    """
    folder = Path(folder)
    file = folder / "model.toml" if folder.is_dir() else folder
    if not file.is_file():
        raise InputError(f"{file}: no such file; expected --fit to be the folder of a fit")
    model = find_model(file)
    circuit = model.circuit()
    if scale is None:
        scale = 1.0 if _in_any_unit(circuit) else _scale(calibration, model, file)
    circuit = in_unit(circuit, scale)
    if not math.isfinite(circuit.on_threshold) or not math.isfinite(circuit.off_threshold):
        raise InputError(f"{file}: on_threshold, off_threshold: missing")
    if "dark_current" in model.effects:
        dark = np.full(calibration.channels, circuit.dark)
    else:
        dark, circuit = calibration.dark, circuit.with_(dark=float(calibration.dark.mean()))
    return replace(calibration, circuit=circuit, dark=dark, known=True)


UNCERTAIN = (
    ("alpha", "alpha"), ("alpha", "alpha_over_beta"), ("beta", "beta"), ("gamma", "gamma"),
    ("follower", "sf_cutoff_hz"),
)  # fmt: skip  # what `Pixel` trains, and the parameter of a fit: of one pole only α/β


def uncertainty_of_fit(folder: Path) -> dict[str, float]:
    """Standard deviations of the logs of what `Pixel` may train, from fit.json; empty where there is none.

    Of the thresholds those of their mean and of their ratio.  What the fit held fixed is known to 0.1 %; what it could
    not identify is left out.
    """
    file = Path(folder) / "fit.json"
    if not file.is_file():
        return {}
    try:
        content = read_json(file)
        known = {
            name: 1e-3 if entry.get("fixed") else float(entry["std"]) / float(entry["value"])
            for name, entry in content["parameters"].items()
            if name in (*THRESHOLDS, *(theirs for _, theirs in UNCERTAIN))
            and (entry.get("fixed") or (entry.get("std") and entry.get("identified", True)))
        }
        deviations = {ours: known[theirs] for ours, theirs in UNCERTAIN if theirs in known}
        if set(THRESHOLDS) <= known.keys():
            deviations |= _of_mean_and_ratio(content, *(known[name] for name in THRESHOLDS))
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, ZeroDivisionError):
        raise InputError(f"{file}: parameters, covariance: expected value and std of each, and their matrix") from None
    return {name: max(sd, 1e-3) for name, sd in deviations.items()}


def _of_mean_and_ratio(content: Mapping[str, Any], on_sd: float, off_sd: float) -> dict[str, float]:
    """Standard deviations of the logs of the mean threshold and of ON over OFF, from those of the thresholds' logs."""
    on, off = (float(content["parameters"][name]["value"]) for name in THRESHOLDS)
    told: Mapping[str, Any] = content.get("covariance") or {"names": ()}
    both = 0.0  # covariance of the logs
    if set(THRESHOLDS) <= set(told["names"]):
        row, column = (list(told["names"]).index(name) for name in THRESHOLDS)
        both = float(told["matrix"][row][column] or 0.0)
    matrix, share = np.array([[on_sd**2, both], [both, off_sd**2]]), on / (on + off)
    ways = {"threshold": np.array([share, 1.0 - share]), "ratio": np.array([1.0, -1.0])}
    return {name: math.sqrt(max(float(way @ matrix @ way), 0.0)) for name, way in ways.items()}


def unexplained_by(folder: Path | None) -> tuple[str, ...]:
    """What a search for the gap found and could not name or distinguish, in words; nothing for other folders."""
    file = Path(folder) / "gap.json" if folder is not None else None
    if file is None or not file.is_file():
        return ()
    content = read_json(file)
    if content.get("unknown_term") or content.get("remainder"):
        return ("what no effect explains in gap.json",)
    if content.get("verdict") != "ambiguous":
        return ()
    then = content.get("recommended_next")
    why = then.get("why") if isinstance(then, dict) else None  # "to tell one effect from the other"
    which = f", recommended_next: {why}" if isinstance(why, str) and why else ""
    return (f"the other explanation that gap.json leaves open (ambiguous{which})",)


def _scale(calibration: Calibration, model: Model, file: Path) -> float:
    q_in = model.gauge.fixed.get("q_in") or (model.physical.q_in if model.physical else None)
    if not q_in or not calibration.q_in > 0:
        raise InputError(
            f"{file}: radiance unit: expected q_in in its [gauge] and input_time_const_eff_it_prod > 0 in {FILE}, "
            "which tie the two units; or give --radiance-scale"
        )
    return q_in / calibration.q_in


def _in_any_unit(circuit: Circuit) -> bool:
    """Whether nothing of the circuit depends on the unit of radiance."""
    pairs = zip(astuple(circuit), astuple(in_unit(circuit, 2.0)), strict=True)
    return all(a == b or (a != a and b != b) for a, b in pairs)  # NaN: a number that this photoreceptor has not


def in_unit(circuit: Circuit, scale: float) -> Circuit:
    """The same circuit for radiance in units that are `scale` times larger: L' = L / scale."""
    return circuit.with_(
        alpha=circuit.alpha * scale, gamma=circuit.gamma * scale, corner=circuit.corner * scale,
        dark=circuit.dark / scale, shot_density=circuit.shot_density / scale,
        leak_hz_per_radiance=circuit.leak_hz_per_radiance * scale, bandwidth_floor=circuit.bandwidth_floor / scale,
    )  # fmt: skip
