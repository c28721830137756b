"""Fits already made, kept in a file: a computation that was interrupted goes on where it stopped.

Whatever is decided from fits follows from them, and a fit follows from its events and stimuli, from the model it starts
at and from its settings.  A hash of those is the key.  The file holds one JSON line per fit, each with a checksum, and
only grows.  A line cut off by an interruption is dropped; a file that is damaged otherwise is set aside next to itself
(`….damaged`) and that is stated, its sound lines are kept, and what they lack is computed again.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Generic, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from pixelid import __version__
from pixelid.cluster import Work
from pixelid.errors import OutputError
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.files import to_document
from pixelid.model.model import Model
from pixelid.outputs import set_aside
from pixelid.recordings.bench import pixel_gains
from pixelid.recordings.recording import Recording

DIGEST_BYTES = 16  # 2⁻⁶⁴ for two of a search's few thousand fits to share a key


Item = TypeVar("Item")
Made = TypeVar("Made")


class FitCache:
    """Entries of fits by key, in memory and in a file.

    Args:
        path: The file; read when it exists, made with the first entry.  None: in memory alone.
        entries: Fits already made.
    """

    def __init__(self, path: Path | None, entries: Mapping[str, dict] | None = None) -> None:
        self.path = path
        self._entries: dict[str, dict] = dict(entries or {})
        self._events: WeakKeyDictionary[EventTimes, bytes] = WeakKeyDictionary()  # of likelihoods, which do not change
        self._one_at_a_time = Lock()
        if path is not None and path.exists():
            self._read(path)
        self._known = set(self._entries)

    @property
    def entries(self) -> Mapping[str, dict]:
        """All entries."""
        return self._entries

    @property
    def added(self) -> dict[str, dict]:
        """The entries that it neither read nor was made with."""
        return {key: entry for key, entry in self._entries.items() if key not in self._known}

    def get(self, key: str) -> dict | None:
        """The entry of a fit, None when it has not been made."""
        return self._entries.get(key)

    def add(self, key: str, entry: dict) -> None:
        """Keep an entry, and write it out."""
        with self._one_at_a_time:
            self._add(key, entry)

    def _add(self, key: str, entry: dict) -> None:
        self._entries[key] = entry
        if self.path is None:
            return
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write("\n" + _line(key, entry))
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written ({error.strerror or error})") from error

    def remove(self) -> None:
        """Remove the file: the computation is done."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)

    def key(self, likelihood: EventTimes, model: Model, *settings: float) -> str:
        """Hash, in hexadecimal, of all that a fit depends on.

        Args:
            likelihood: Its recordings, clock weights and threshold factors count.
            model: Its effects, values, bounds and priors count: a fit starts there.
            settings: Of the optimiser.
        """
        if likelihood not in self._events:
            self._events[likelihood] = _digest(likelihood)
        hashed = hashlib.blake2b(self._events[likelihood], digest_size=DIGEST_BYTES)
        priors = {p.name: p.prior for p in model.parameters.values() if p.prior is not None}
        hashed.update(repr((__version__, to_document(model), priors, settings)).encode())
        if model.nuisances:
            hashed.update(repr(sorted(model.nuisances.items())).encode())
        return hashed.hexdigest()

    def _read(self, path: Path) -> None:
        lines = path.read_bytes().split(b"\n")
        read = [_entry(line) for line in lines if line]
        self._entries = dict(pair for pair in read if pair is not None)
        if lines[-1] and read[-1] is None:  # cut off: away, so that the next entry does not follow its beginning
            os.truncate(path, max(sum(len(line) + 1 for line in lines[:-1]) - 1, 0))
        if None in read[:-1]:  # not just cut off at its end
            set_aside(path, "is damaged (its sound lines are kept)", "damaged")
            for key, entry in self._entries.items():
                self.add(key, entry)


def map_fits(
    work: Work,
    function: Callable[[Item, FitCache | None], Made],
    items: Iterable[Item],
    cache: FitCache | None,
    begun: Callable[[Item], None] = lambda item: None,
) -> list[Made]:
    """Apply a function that fits to every item, and keep the fits that it makes, whichever process makes them.

    Args:
        work: Who does it.
        function: What to do with an item and a cache.
        items: The items.
        cache: Fits already made.
        begun: Called with each item when its turn comes.

    Returns:
        The results in the order of the items.
    """
    if not work.apart:
        return work.map(lambda item: function(item, cache), items, begun)
    results = work.map(_Apart(function, None if cache is None else dict(cache.entries)), items, begun)
    for _, added in results:
        for key, entry in added.items():
            if cache is not None and cache.get(key) is None:
                cache.add(key, entry)
    return [result for result, _ in results]


@dataclass(frozen=True)
class _Apart(Generic[Item, Made]):
    """A function that fits, in a process that cannot write the cache: what it adds comes back next to the result."""

    function: Callable[[Item, FitCache | None], Made]
    entries: Mapping[str, dict] | None

    def __call__(self, item: Item) -> tuple[Made, dict[str, dict]]:
        cache = None if self.entries is None else FitCache(None, self.entries)
        made = self.function(item, cache)
        return made, {} if cache is None else cache.added


def _line(key: str, entry: dict) -> str:
    body = json.dumps(entry)
    return json.dumps({"key": key, "checksum": _checksum(key, body), "entry": body})


def _entry(line: bytes) -> tuple[str, dict] | None:
    """(key, entry) of a line; None for a damaged one."""
    try:
        parts = json.loads(line.decode())
        if not isinstance(parts["key"], str) or not isinstance(parts["entry"], str):  # two numbers add up as well
            return None
        if parts["checksum"] != _checksum(parts["key"], parts["entry"]):
            return None
        return parts["key"], json.loads(parts["entry"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def _checksum(key: str, body: str) -> str:
    return hashlib.blake2b((key + body).encode(), digest_size=8).hexdigest()


def _digest(likelihood: EventTimes) -> bytes:
    hashed = hashlib.blake2b(digest_size=DIGEST_BYTES)
    for recording in likelihood.recordings:
        hashed.update(_content(recording))
    hashed.update(np.ascontiguousarray(likelihood.clock_share).tobytes())
    if likelihood.threshold_factor is not None:
        hashed.update(b"factor" + np.ascontiguousarray(likelihood.threshold_factor).tobytes())
    if likelihood.shift is not None:
        hashed.update(b"shift" + likelihood.shift.change.tobytes() + likelihood.shift.slope.tobytes())
    if likelihood.carried is not None:
        hashed.update(b"carried" + likelihood.carried.by.tobytes() + likelihood.carried.level.tobytes())
    if likelihood.placed is not None:
        hashed.update(b"placed" + likelihood.placed.earlier.tobytes() + likelihood.placed.back.tobytes())
    if likelihood.by_gain is not None:
        hashed.update(b"gains" + likelihood.by_gain.tobytes())
    return hashed.digest()


def _content(recording: Recording) -> bytes:
    hashed = hashlib.blake2b(digest_size=DIGEST_BYTES)
    stimulus, events = recording.stimulus, recording.events
    assert stimulus is not None
    hashed.update(repr((recording.name, recording.sensor, events.width, events.height, events.tick_ns)).encode())
    hashed.update(stimulus.interpolation.encode())
    for part in (events.t, events.x, events.y, events.p, *stimulus.arrays.values(), *pixel_gains(recording)):
        hashed.update(np.ascontiguousarray(part).tobytes())
    return hashed.digest()
