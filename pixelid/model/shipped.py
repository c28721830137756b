"""The circuits and recipes that come with pixelid, found in a checkout and in an installed wheel alike."""

from __future__ import annotations

from pathlib import Path

from pixelid.errors import InputError, did_you_mean
from pixelid.model.files import load_model
from pixelid.model.model import Model


def data_folder(kind: str) -> Path:
    """The folder of shipped files of a kind ("models", "fits")."""
    package = Path(__file__).resolve().parent.parent
    installed = package / "_data" / kind
    return installed if installed.is_dir() else package.parent / kind


def shipped_models() -> dict[str, Path]:
    """Name → file of every shipped circuit."""
    return {path.stem: path for path in sorted(data_folder("models").glob("*.toml"))}


def shipped_bias_laws(name: str | Path) -> Path | None:
    """The file of the laws of bias codes that come with a shipped circuit; None where none do."""
    path = data_folder("models") / "biases" / f"{name}.toml"
    return path if str(name) in shipped_models() and path.is_file() else None


def model_files(spec: str | Path) -> list[Path]:
    """The files that `find_model(spec)` may have read, in addition to shipped ones."""
    return [Path(spec), Path(spec) / "fit.json", Path(spec) / "model.toml"]


def find_model(spec: str | Path) -> Model:
    """The model of a shipped name, a model file, or a fit folder.  Raises InputError listing what is shipped."""
    path = Path(spec)
    if path.is_dir() and (path / "model.toml").is_file():
        return load_model(path / "model.toml")
    if path.suffix == ".toml":
        return load_model(path)
    known = shipped_models()
    if str(spec) in known:
        return load_model(known[str(spec)])
    if path.is_dir() and (inside := sorted(path.glob("*/model.toml"))):
        raise InputError(
            f"{path}: no model.toml in it, but one in each of its folders: expected one of these, "
            f"{', '.join(str(file.parent) for file in inside)}"
        )
    raise InputError(
        f"no model {str(spec)!r}: expected a .toml file, a fit folder, or one of {', '.join(known)}"
        f"{did_you_mean(spec, known)}"
    )
