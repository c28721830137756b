"""Which rows and which cameras a run of latencies is about."""

from __future__ import annotations

from pathlib import Path

from pixelid.errors import InputError, did_you_mean
from pixelid.model.shipped import shipped_models
from pixelid.tables.latency.camera import Camera, load_cameras
from pixelid.tables.latency.reading import LatencyTable


def chosen_rows(table: LatencyTable, camera: str | None) -> LatencyTable:
    """The rows of one camera, or all.  Raises InputError for a camera that the table does not have."""
    if camera is None:
        return table
    known = list(dict.fromkeys(table.camera.tolist()))
    if camera not in known:
        raise InputError(f"--camera: the table has {', '.join(known)}, found {camera!r}{did_you_mean(camera, known)}")
    return table.select(table.camera == camera)


def chosen_cameras(spec: str) -> tuple[tuple[Camera, ...], tuple[Path, ...]]:
    """(cameras, files) of a shipped model, a model file or a result folder.

    Raises InputError listing what is shipped.
    """
    path, known = Path(spec), shipped_models()
    if not path.is_dir() and path.suffix != ".toml":
        if spec not in known:
            raise InputError(
                f"no model {spec!r}: expected a .toml file, a fit folder, or one of {', '.join(known)}"
                f"{did_you_mean(spec, known)}"
            )
        path = known[spec]
    return load_cameras(path), (path,)
