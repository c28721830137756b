"""Stages of a long computation, each kept in a folder of its own: interrupted and called again, it goes on there."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from pixelid.documents import read_json
from pixelid.errors import InputError
from pixelid.outputs import plain, whole_folder, write_json

Kept = TypeVar("Kept")
KEY = "stage.json"  # what a stage's folder was made of


class Stages:
    """Folders of stages below one folder; without a folder nothing is kept.

    Args:
        folder: That keeps them, made when the first stage ends; None: none.
        inputs: Everything that results depend on in addition to the stage before: options, versions, hashes of files.
    """

    def __init__(self, folder: Path | None, inputs: Mapping[str, Any]) -> None:
        self.folder = folder
        self._key = _digest(inputs)

    def run(
        self, name: str, make: Callable[[], Kept], write: Callable[[Kept, Path], None], read: Callable[[Path], Kept]
    ) -> Kept:
        """What a stage makes, or what it made when it was called with the same inputs.

        Later stages depend on this one too: their key carries its name.

        Args:
            name: Of the stage, and of its folder.
            make: Does the work.
            write: Writes what was made into an existing folder.
            read: Reads it back; damaged files are made again.
        """
        self._key = _digest({"before": self._key, "stage": name})
        if self.folder is None:
            return make()
        folder = self.folder / name
        with suppress(InputError, OSError, KeyError, ValueError):
            if (folder / KEY).is_file() and read_json(folder / KEY) == {"key": self._key}:
                return read(folder)
        made = make()
        self.folder.mkdir(parents=True, exist_ok=True)
        if folder.exists():
            shutil.rmtree(folder)
        with whole_folder(folder) as temporary:
            write(made, temporary)
            write_json(temporary / KEY, {"key": self._key})
        return made


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(plain(content), sort_keys=True).encode()).hexdigest()
