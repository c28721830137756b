"""What users give: a model, recordings, a stimulus, in any of the forms that the command line takes, and as values."""
# pyright: reportUnnecessaryIsInstance=false
# what users give is checked, whatever the annotations promise

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeAlias, cast

from pixelid.errors import Doubtful, InputError
from pixelid.model.model import Model
from pixelid.model.options import changed
from pixelid.model.shipped import find_model, shipped_models
from pixelid.outputs import RESULT_FILES
from pixelid.recordings.reading import BINARY_SUFFIXES, check_readable, open_recordings
from pixelid.recordings.recording import Recording
from pixelid.recordings.session import agreed
from pixelid.stimuli.files import load_stimulus
from pixelid.stimuli.pixel_lights import Light, PixelLights
from pixelid.stimuli.shapes import SHAPES
from pixelid.stimuli.stimulus import Stimulus

MADE_BY = {"posterior": "fit --sample", "static_noise": "inspect", "reconstruction": "reconstruct"}  # file → command

ModelLike: TypeAlias = Model | str | Path
RecordingsLike: TypeAlias = Recording | str | Path | Iterable[Recording | str | Path]
StimulusLike: TypeAlias = Stimulus | PixelLights | str | Path


def as_model(model: ModelLike) -> Model:
    """The model itself, or the one of a shipped name, a .toml file or a fit folder.

    Raises:
        InputError: anything else.
    """
    if isinstance(model, Model):
        return model
    try:
        if isinstance(model, str | Path):
            return find_model(model)
    except InputError as error:
        raise InputError(f"{error}{_swapped(model)}") from None
    raise InputError(
        f"model: expected a Model, a .toml file, a fit folder, or one of {', '.join(shipped_models())}, "
        f"found {_kind(model)}{_swapped(model)}"
    )


def check_given(
    recordings: Iterable[str | Path] = (), models: Iterable[str | Path] = (), **changes: Iterable[str]
) -> None:
    """Look at what a command was given before anything slow is imported.

    Args:
        recordings: files or folders.
        models: names, files or folders.
        changes: `with_`, `without` and `set_` of the models, as words of the command line.

    Raises:
        InputError: a file is missing, empty or of no known format; a model, effect or parameter is unknown.
    """
    for path in recordings:
        _refuse_result(Path(path))
        check_readable([path])
    for model in models:
        changed(find_model(model), **changes)


def as_recordings(recordings: RecordingsLike) -> list[Recording]:
    """One or several recordings; paths are opened, and a folder stands for the recordings in it.

    Raises:
        InputError: nothing at all, something else, a file that cannot be read as a recording, or recordings of
            different sensors.
    """
    if isinstance(recordings, Recording | Model | str | Path):
        recordings = [recordings]  # type: ignore[list-item]  # a model is refused below
    if not isinstance(recordings, Iterable):
        raise InputError(f"recordings: expected a Recording, a path, or a list of either, found {_kind(recordings)}")
    opened: list[Recording] = []
    for entry in recordings:
        if isinstance(entry, Recording):
            opened.append(entry)
        elif isinstance(entry, str | Path):
            _refuse_result(Path(entry))
            try:
                read = open_recordings([entry])
            except InputError as error:
                raise InputError(f"{error}{_swapped(entry)}") from None
            warn_of_empty(read)
            opened += read
        else:
            expected = "expected a Recording, a path, or a list of either"
            raise InputError(f"recordings: {expected}, found {_kind(entry)}{_swapped(entry)}")
    if not opened:
        raise InputError("recordings: expected at least one, found none")
    return agreed(opened)


def as_stimulus(stimulus: StimulusLike) -> Light:
    """The stimulus itself, or the one of a built-in name, a .toml description or a recording.

    Raises:
        InputError: anything else.
    """
    if isinstance(stimulus, Stimulus | PixelLights):
        return stimulus
    if isinstance(stimulus, str | Path):
        return load_stimulus(stimulus)
    raise InputError(
        f"stimulus: expected a Stimulus, a recording, a .toml file, or one of {', '.join(SHAPES)}, "
        f"found {_kind(stimulus)}"
    )


def warn_of_empty(recordings: Iterable[Recording]) -> None:
    """Say which recordings hold no events: nothing is wrong with their files, and hardly anyone means to use them."""
    empty = [str(r.source or r.name) for r in recordings if len(r.events) == 0]
    if empty:
        warnings.warn(f"{', '.join(empty)}: no events", Doubtful, stacklevel=4)


def _swapped(value: object) -> str:
    """Words of doubt about an argument that would fit in another's place; empty where it would not."""
    several = cast("Sequence[object]", value) if isinstance(value, list | tuple) else [value]
    if isinstance(value, str) and value in SHAPES:
        found = "a stimulus"
    elif several and all(isinstance(one, Recording) for one in several):
        found = "a recording"
    elif isinstance(value, Model) or (isinstance(value, str) and value in shipped_models()):
        found = "a model"
    elif isinstance(value, str | Path) and _holds_recordings(Path(value)):
        found = "a recording"
    elif isinstance(value, str | Path) and (Path(value) / "model.toml").is_file():
        found = "a result, which holds a model"
    else:
        return ""
    return f" (this is {found}: are two arguments swapped?)"


def _refuse_result(path: Path) -> None:
    """Raise InputError for the folder of a result in a recording's place, whose tables are no events."""
    made_by = [name.removesuffix(".json") for name in RESULT_FILES if (path / name).is_file()]
    if made_by and not any(file.suffix.lower() in {*BINARY_SUFFIXES} - {".npz"} for file in path.iterdir()):
        command = MADE_BY.get(made_by[0], made_by[0])
        raise InputError(f"{path}: is a result of `pixelid {command}`, not recordings")


def _holds_recordings(path: Path) -> bool:
    """Whether a path is a recording by its look, or a folder of some."""
    if not path.exists() or (path / "model.toml").exists() or path.suffix == ".toml":
        return False
    try:
        check_readable([path])
    except InputError:
        return False
    return True


def _kind(value: object) -> str:
    """A value in words short enough for one line."""
    text = repr(value).replace("\n", " ")
    return f"{type(value).__name__} {text if len(text) <= 40 else text[:37] + '…'}"
