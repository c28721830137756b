"""Pictures and videos, decoded in the reading process: their decoders are compiled libraries too.

A picture that declares more pixels than `MOST_PIXELS` is refused; what a video or a folder of pictures takes altogether
is for its caller to limit, frame by frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.damage import refusing
from pixelid.recordings.isolated import arrays_isolated

MOST_PIXELS = 1 << 27  # of a picture, 11 000 × 11 000; of a grey frame as float32 0.5 GiB


def read_picture(path: Path) -> np.ndarray:
    """A stored picture.

    Args:
        path: PNG, TIFF, JPEG, BMP, OpenEXR, or a .npy array.

    Returns:
        (H, W) or (H, W, channels), of the type that it is stored in.

    Raises:
        InputError: it is missing, damaged, too large, or decoding it crashed or hung.
    """
    if not path.is_file():
        raise InputError(f"{path}: {'expected a picture, found no file' if path.exists() else 'no such picture'}")
    (found,) = arrays_isolated("picture", path, single=True)
    return found["picture"]


def read_video(path: Path) -> Iterator[tuple[float, np.ndarray]]:
    """Times [s] (NaN where the file has none) and grey frames of a video one by one, (H, W) uint8 or uint16.

    Raises:
        InputError: it is damaged or no video, the package that decodes videos is missing, or it crashed or hung; also
            between frames.
    """
    return ((float(answer["time"][0]), answer["frame"]) for answer in arrays_isolated("video", path))


def picture(path: Path) -> Iterator[dict[str, np.ndarray]]:
    """What the reading process does for `read_picture`."""
    with refusing(path, "not a readable picture", Exception):  # readers of many formats, each with its own exceptions
        if path.suffix == ".npy":
            image = np.load(path, mmap_mode="r", allow_pickle=False)
        elif path.suffix.lower() == ".exr":
            image = _exr(path)
        else:
            from imageio.v3 import imread

            image = imread(path)
    image = np.asarray(image)
    if not 2 <= image.ndim <= 4 or image.size > 4 * MOST_PIXELS or image.dtype.kind not in "buif":
        raise InputError(
            f"{path}: expected a picture of at most {MOST_PIXELS} pixels, found {image.dtype} of shape {image.shape}"
        )
    yield {"picture": image}


def video(path: Path) -> Iterator[dict[str, np.ndarray]]:
    """What the reading process does for `read_video`."""
    try:
        import av  # pyright: ignore[reportMissingImports]  (optional)
        from av.error import FFmpegError  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise InputError(f'{path}: videos need the package av: pip install "pixelid[video]"') from None
    kinds = FFmpegError, LookupError, ValueError, ArithmeticError
    with refusing(path, "expected a video", *kinds), av.open(str(path)) as file:
        for frame in file.decode(file.streams.video[0]):
            if frame.width * frame.height > MOST_PIXELS:
                raise InputError(f"{path}: expected frames of at most {MOST_PIXELS} pixels")
            deep = any(component.bits > 8 for component in frame.format.components)
            grey = frame.to_ndarray(format="gray16le" if deep else "gray")
            yield {"time": np.array([np.nan if frame.time is None else frame.time]), "frame": grey}


def _exr(path: Path) -> np.ndarray:
    import os

    os.environ.setdefault("OPENCV_IO_ENABLE_OPENEXR", "1")
    try:
        import cv2  # type: ignore[import-not-found]
    except ImportError:
        raise InputError(f"{path}: reading EXR needs OpenCV (pip install opencv-python-headless)") from None
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise InputError(f"{path}: OpenCV cannot read it")
    return image if image.ndim == 2 else image[..., [2, 1, 0, *range(3, image.shape[2])]]
