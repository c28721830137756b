"""Posed images: `views/transforms_{train,val,test}.json` and the pictures they list.

Poses are OpenGL (x right, y up, z backward) and become x right, y down, z forward; `view_cameras` reads the camera.
Quantised images of D bits hold x
for values in [x, x + 1): they become (x + 0.5) / 2^D.  Unquantised ones (linear colour) get `log_eps` added.
Transparent parts show white.
"""

from __future__ import annotations

import glob
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pixelid.documents import interpreting, read_json
from pixelid.errors import InputError, shown
from pixelid.nerf.data.arrays import read_arrays, rotations, scalar
from pixelid.nerf.data.camera import Camera
from pixelid.nerf.data.colmap import read_transforms
from pixelid.nerf.data.view_cameras import camera_of_document, refuse_several_cameras
from pixelid.recordings.pictures import read_picture

FOLDER = "views"
CONVERTED = "dataset.json"  # marks a dataset that `pixelid dataset` has written, with all that belongs to it
STAGES = ("train", "val", "test")
RENDERER = "renderer_params.npz"
LUMA = np.array([0.299, 0.587, 0.114])  # ITU-R BT.601
# Unquantised pictures have white at 1, and highlights beyond it, here taken to be up to so many times white.  Where the
# brightest value is more, pictures are in another unit, and white is what leaves highlights as much.
HIGHLIGHTS = 4.0
BRIGHT = 0.999  # quantile of all values above which white never is, however bright single pixels are
OPAQUE = 0.999  # alpha of unquantised pictures through which nothing shows: half floats are that near to 1
OPENGL = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Views:
    """Images and where they were taken.

    images: (n, H, W, C) float32 radiance;  position: (n, 3), rotation: (n, 3, 3), camera to world;  names: n;
    exposure: (n,) exposure × gain, relative to the mean over all stages;  transparent: whether white shows through
    anywhere;  peak: the largest value an image can have;  span: from the smallest value that a stored picture can say
    to the largest, the range that the reference implementation scores in;  log_eps: what the data set adds to pictures
    that are not quantised
    """

    images: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    camera: Camera
    names: tuple[str, ...]
    exposure: np.ndarray
    transparent: bool
    peak: float
    span: float = 1.0
    log_eps: float = 0.0

    def __len__(self) -> int:
        return len(self.images)

    @property
    def radiance(self) -> np.ndarray:
        """(n, H, W, C) images at the mean exposure of all stages."""
        if (self.exposure == 1.0).all():
            return self.images
        return self.images / self.exposure.astype(np.float32)[:, None, None, None]

    def some(self, which) -> Views:
        """The views of these indices."""
        names = tuple(np.array(self.names, dtype=object)[which])
        return Views(
            self.images[which], self.position[which], self.rotation[which], self.camera, names, self.exposure[which],
            self.transparent, self.peak, self.span, self.log_eps,
        )  # fmt: skip


@dataclass(frozen=True)
class ViewsFile:
    """Views of one `transforms_*.json`, as `read_views` has them, read one at a time: memory does not grow with them.

    file: of the poses;  document: its content;  channels: colours;  log_eps: of `Views`;  first: a picture of the size
    and type that all have;  usual: mean exposure over all stages next to the file;  peak, span: of `Views`, of all
    pictures of the file
    """

    file: Path
    document: dict
    channels: int
    log_eps: float
    first: np.ndarray
    usual: float
    peak: float
    span: float

    @classmethod
    def open(cls, file: Path, channels: int, dataset: Path | None = None, *, log_eps: float = 0.0) -> ViewsFile:
        """The views of a file; where its pictures are not quantised all of them are looked at, for their white.

        Args:
            file: of the poses.
            channels: colours, 1 or 3.
            dataset: folder that they are of; by default the one that holds the folder of the file, if it is one.
            log_eps: what is added to pictures where no data set says it: with views that several data sets share
                there is none.

        Returns:
            The views.

        Raises:
            InputError: the first picture, or one whose value is asked for, is missing or cannot be read.
        """
        file = Path(file)
        document = read_transforms(file)
        renderer = (file.resolve().parent.parent if dataset is None else Path(dataset)) / RENDERER
        if dataset is not None or renderer.is_file():
            log_eps = _log_eps(renderer)
        with interpreting(file, "posed views"), np.errstate(all="ignore"):
            stages = [place for stage in STAGES if (place := file.parent / f"transforms_{stage}.json").is_file()]
            told = [_exposures(stage, read_json(stage)["frames"]) for stage in (stages or [file])]
            frames = frames_of(file, document)
            refuse_several_cameras(file, document)
            pose_of_frame(file, 0, frames[0])
            first = image_of(picture_of(file, str(frames[0]["file_path"])))
            usual = float(np.mean(np.concatenate(told)))
            opened = cls(file, document, channels, log_eps, first, usual, 1.0, 1.0)
            values = len(frames) * first.shape[0] * first.shape[1] * channels
            images = (opened.view(k).images for k in range(len(frames)))
            peak, span = _peak_and_span(images, values, first.dtype, document)
        return replace(opened, peak=peak, span=span)

    def view(self, k: int) -> Views:
        """The k-th view of the file alone, its exposure relative to the mean over all stages.

        Raises:
            InputError: its picture is missing, cannot be read, or differs from the first one in size or type.
        """
        with interpreting(self.file, "posed views"), np.errstate(all="ignore"):
            document = {**self.document, "frames": [self.document["frames"][k]]}
            view = _views(self.file, document, self.channels, self.log_eps, self.first)
        return replace(view, exposure=view.exposure / self.usual, peak=self.peak, span=self.span)


def views_folder(dataset: Path) -> Path | None:
    """`views/` in the dataset's folder or, as published ones have it, one level up; None when there is none."""
    own, above = Path(dataset) / FOLDER, Path(dataset).resolve().parent / FOLDER
    places = (own,) if (Path(dataset) / CONVERTED).is_file() else (own, above)
    return next((folder for folder in places if folder.is_dir()), None)


def no_views(camera: Camera, channels: int) -> Views:
    """Views of nothing, of the size that this camera would take them in."""
    images = np.empty((0, camera.height, camera.width, channels), np.float32)
    return Views(images, np.empty((0, 3)), np.empty((0, 3, 3)), camera, (), np.empty(0), False, 1.0)


def read_views(dataset: Path, channels: int) -> dict[str, Views]:
    """The views of every stage that the dataset has.

    Args:
        dataset: its folder.
        channels: colours, 1 or 3.

    Returns:
        "train", "val", "test", as far as they are there → views; nothing for a dataset without `views/`.

    Raises:
        InputError: images or poses that cannot be read, or that do not fit each other.
    """
    folder = views_folder(dataset)
    if folder is None:
        return {}
    log_eps = _log_eps(Path(dataset) / RENDERER)
    stages = {
        stage: _stage(folder / f"transforms_{stage}.json", channels, log_eps)
        for stage in STAGES
        if (folder / f"transforms_{stage}.json").is_file()
    }
    if not stages:
        raise InputError(f"{folder}: transforms_test.json: missing")
    usual = float(np.mean(np.concatenate([views.exposure for views in stages.values()])))
    return {stage: replace(views, exposure=views.exposure / usual) for stage, views in stages.items()}


def _log_eps(file: Path) -> float:
    if not file.is_file():
        return 0.0
    arrays = read_arrays(file, ("interm_color_space", "log_eps"))
    space = str(arrays["interm_color_space"])
    if space not in ("display", "linear"):
        raise InputError(f"{file}: interm_color_space: expected 'display' or 'linear', found {shown(space)}")
    return scalar(file, arrays, "log_eps", least=0)


def _stage(file: Path, channels: int, log_eps: float) -> Views:
    document = read_json(file)
    with interpreting(file, "posed views"), np.errstate(all="ignore"):  # what overflows is refused as infinite
        return _views(file, document, channels, log_eps)


def _views(file: Path, document: dict, channels: int, log_eps: float, first: np.ndarray | None = None) -> Views:
    """The views of a document; first: a picture of the size and type that all have, by default that of the first."""
    frames = frames_of(file, document)
    poses = np.array([pose_of_frame(file, k, frame) for k, frame in enumerate(frames)])
    names = [str(frame["file_path"]) for frame in frames]
    images, transparent = np.empty((0, 0, 0, channels), np.float32), False
    for k, name in enumerate(names):
        image = image_of(picture_of(file, name))
        first = image if first is None else first
        if k == 0:
            images = np.empty((len(names), first.shape[0], first.shape[1], channels), np.float32)
        if image.shape != first.shape or image.dtype != first.dtype:
            raise InputError(f"{file}: file_path: the pictures differ in size, channels or type")
        images[k] = _radiance(file, image, document, log_eps, channels)
        transparent |= _shows_through(image, document)
    assert first is not None  # there is a view at least
    peak, span = _peak_and_span(images, images.size, first.dtype, document)
    exposure = _exposures(file, frames)
    camera = camera_of_document(file, document, images.shape[2], images.shape[1])
    short = tuple(Path(name).name for name in names)
    return Views(
        images, poses[:, :3, 3], poses[:, :3, :3] @ OPENGL, camera, short, exposure,
        transparent, peak, span, log_eps,
    )  # fmt: skip


def frames_of(file: Path, document: dict) -> list:
    """The views of a `transforms_*.json`, one entry each."""
    frames = document.get("frames")
    if not isinstance(frames, list) or not frames:
        raise InputError(f"{file}: frames: expected a list of at least one view")
    return frames


def _exposures(file: Path, frames: list) -> np.ndarray:
    """(n,) exposure × gain of frames."""
    exposure = np.array([float(f.get("exposure_time", 1.0)) * float(f.get("gain", 1.0)) for f in frames])
    if not (np.isfinite(exposure) & (exposure > 0)).all():
        raise InputError(f"{file}: exposure_time, gain: expected positive numbers")
    return exposure


def pose_of_frame(file: Path, k: int, frame) -> np.ndarray:
    """(3, 4) of a view, as OpenGL has it."""
    for key in ("file_path", "transform_matrix"):
        if not isinstance(frame, dict) or key not in frame:
            raise InputError(f"{file}: frames[{k}].{key}: missing")
    try:
        pose = np.array(frame["transform_matrix"], dtype=np.float64)
    except (TypeError, ValueError):
        pose = np.empty(0)
    if pose.shape not in ((4, 4), (3, 4)) or not np.isfinite(pose).all():
        raise InputError(f"{file}: frames[{k}].transform_matrix: expected a finite 4 × 4 matrix")
    with np.errstate(all="ignore"):  # what overflows is no rotation
        rotates = bool(rotations(pose[:3, :3]))
    if not rotates:
        raise InputError(f"{file}: frames[{k}].transform_matrix: expected a rotation in its first three columns")
    return pose[:3]


def picture_of(file: Path, name: str) -> Path:
    """The picture of a `file_path`, with or without its extension."""
    exact = file.parent / name
    if exact.is_file():
        return exact
    matches = sorted(exact.parent.glob(f"{glob.escape(exact.name)}.*"))
    if not matches:
        raise InputError(f"{exact}: no such picture (file_path of {file.name})")
    return matches[0]


def image_of(path: Path) -> np.ndarray:
    """(H, W, 1, 3 or 4) as stored: integers when quantised."""
    image = read_picture(path)
    image = image[..., None] if image.ndim == 2 else image
    if image.ndim == 3 and image.shape[2] == 2:
        image = np.concatenate([np.repeat(image[..., :1], 3, axis=2), image[..., 1:]], axis=2)
    if image.ndim != 3 or image.shape[2] not in (1, 3, 4) or image.dtype.kind not in "uf":
        raise InputError(f"{path}: expected a grey, RGB or RGBA picture, found {image.dtype} of shape {image.shape}")
    return image


def _radiance(file: Path, image: np.ndarray, document: dict, log_eps: float, channels: int) -> np.ndarray:
    """(H, W, channels) radiance of a stored picture."""
    quantised = image.dtype.kind == "u"
    levels = 1.0
    if quantised:
        bits = document.get("bit_depth", 8 * image.dtype.itemsize)
        if not isinstance(bits, int) or not 1 <= bits <= 16:
            raise InputError(f"{file}: bit_depth: expected 1..16, found {shown(bits)}")
        levels = _levels(document, image.dtype)
    elif not np.isfinite(image).all() or image.min() < 0:
        raise InputError(f"{file}: file_path: a picture holds negative or non-finite values")
    values = image.astype(np.float64)
    if image.shape[-1] == 4:
        alpha, colour = values[..., 3:], values[..., :3]
        if quantised:  # straight alpha
            alpha = alpha / (levels - 1)
            values = alpha * colour + (1 - alpha) * (levels - 1)
        else:  # premultiplied
            values = colour + (1 - alpha)
    if values.shape[-1] == 3 and channels == 1:
        values = (values @ LUMA)[..., None]
    elif values.shape[-1] == 1 and channels == 3:
        values = np.repeat(values, 3, axis=-1)
    return (values + 0.5) / levels if quantised else values + log_eps


def _shows_through(image: np.ndarray, document: dict) -> bool:
    """Whether a stored picture is transparent somewhere: renderers write an alpha channel of opaque pictures, too."""
    opaque = _levels(document, image.dtype) - 1 if image.dtype.kind == "u" else OPAQUE
    return image.shape[-1] == 4 and bool((image[..., 3] < opaque).any())


def _levels(document: dict, kind: np.dtype) -> float:
    """How many values a quantised picture has."""
    return float(2 ** document.get("bit_depth", 8 * kind.itemsize))


def _peak_and_span(
    images: Iterable[np.ndarray], values: int, kind: np.dtype, document: dict
) -> tuple[float, float]:  # fmt: skip
    """The largest value that pictures of this kind can have, and how far apart their values can be.

    Unquantised ones can have any; scores are relative to their white, which moves continuously with what they hold.

    images: in parts, with so many values together
    """
    if kind.kind == "u":
        levels = _levels(document, kind)
        return 1.0, (levels - 1) / levels
    bright, brightest = _quantile_and_most(images, values, BRIGHT)
    peak = max(1.0, min(brightest / HIGHLIGHTS, bright)) if brightest > HIGHLIGHTS else 1.0
    return peak, peak


def _quantile_and_most(parts: Iterable[np.ndarray], values: int, share: float) -> tuple[float, float]:
    """(quantile, largest) of so many values in parts, of which those above the quantile alone are held."""
    place = share * (values - 1)
    held, above = values - int(place), np.empty(0, np.float32)
    for part in parts:
        above = np.concatenate([above, part.ravel()])
        if len(above) > held:
            above = np.partition(above, len(above) - held)[-held:]
    above = np.sort(above)
    low, high = float(above[0]), float(above[min(1, len(above) - 1)])
    return low + (place - int(place)) * (high - low), float(above[-1])
