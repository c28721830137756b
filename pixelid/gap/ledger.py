"""Fits already made, kept on disk: an interrupted search, started again, goes on where it stopped.

Everything a search decides follows from fits, and every fit follows from events, stimuli, the model it starts at and
its tolerance.  Those are hashed; a fit whose hash is known is read back instead of made.  The file has one JSON line
per fit, only ever grows, and a line cut off by an interruption is ignored.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from weakref import WeakKeyDictionary

import numpy as np

from pixelid import __version__
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.files import to_document
from pixelid.model.model import Model

_open: ContextVar[Ledger | None] = ContextVar("ledger", default=None)
_digests: WeakKeyDictionary[EventTimes, bytes] = WeakKeyDictionary()


class Ledger:
    """The fits of one search, by hash.  path: the file, read when it exists."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._known: dict[str, dict] = {}
        for line in self.path.read_text().splitlines() if self.path.exists() else ():
            try:
                entry = json.loads(line)
                self._known[entry.pop("key")] = entry
            except (ValueError, KeyError):
                continue

    def get(self, key: str) -> dict | None:
        """The entry of a fit, None when it has not been made."""
        return self._known.get(key)

    def add(self, key: str, entry: dict) -> None:
        """Keep an entry."""
        self._known[key] = entry
        with self.path.open("a") as file:
            file.write("\n" + json.dumps({"key": key, **entry}))


@contextmanager
def remembering(path: Path | None) -> Iterator[None]:
    """Within, fits are kept in a file (None: not at all), which goes when all went well."""
    token = _open.set(None if path is None else Ledger(path))
    try:
        yield
    finally:
        _open.reset(token)
    if path is not None:
        Path(path).unlink(missing_ok=True)


def ledger() -> Ledger | None:
    """The ledger of the search under way, if it keeps one."""
    return _open.get()


def signature(likelihood: EventTimes, model: Model, *settings: float) -> str:
    """Hex hash of all that a fit depends on."""
    seen = hashlib.blake2b(_digest(likelihood), digest_size=16)
    seen.update(likelihood.clock_share.tobytes())
    if likelihood.threshold_factor is not None:
        seen.update(likelihood.threshold_factor.tobytes())
    priors = {p.name: p.prior for p in model.parameters.values() if p.prior is not None}
    seen.update(repr((__version__, to_document(model), priors, settings)).encode())
    return seen.hexdigest()


def _digest(likelihood: EventTimes) -> bytes:
    if likelihood not in _digests:
        seen = hashlib.blake2b(digest_size=16)
        for r in likelihood.recordings:
            stimulus = r.stimulus
            assert stimulus is not None
            seen.update(repr((r.name, r.sensor, r.events.width, r.events.height, r.events.tick_ns)).encode())
            seen.update(stimulus.interpolation.encode())
            for part in (r.events.t, r.events.x, r.events.y, r.events.p, stimulus.t, stimulus.radiance):
                seen.update(np.ascontiguousarray(part).tobytes())
        _digests[likelihood] = seen.digest()
    return _digests[likelihood]
