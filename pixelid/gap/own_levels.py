"""Gain and background of every pixel, told with a model and taken as known by the search that follows.

They are fitted together with the circuit (`fit.levels`), and each pixel's light is replaced by what it saw.  The base
lacks what the search is for, and levels may stand for a part of it: what is named is therefore looked for again, under
levels told with it, until the same effects are named.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

from pixelid.fit.fit import fit
from pixelid.fit.levels.pixel_levels import Wanted
from pixelid.gap.options import Report
from pixelid.gap.result import GapReport
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording

Search: TypeAlias = Callable[[Sequence[Recording]], GapReport]


def search_with_levels(
    recordings: Sequence[Recording],
    model: Model,
    wanted: Wanted,
    seed: int,
    search: Search,
    report: Report,
) -> GapReport:
    """The report of the last search, with the levels that it took as known.

    Args:
        recordings: of one sensor, with pixel addresses and a full-field light or one of each pixel's own.
        model: the base.
        wanted: which levels are not known.
        seed: of the fits.
        search: of recordings whose lights are what each pixel saw.
        report: called with what is being done.

    Raises:
        InputError: levels that these recordings cannot tell, or not beside this model.
    """
    found, named = _searched(recordings, model, wanted, seed, search, report), frozenset[str]()
    most_searches = 3
    for _ in range(most_searches - 1):
        before, named = named, frozenset(effect.name for effect in found.effects)
        if not named or named == before or not wanted.separable(found.model):
            break
        found = _searched(recordings, found.model, wanted, seed, search, report)
    return found


def _searched(
    recordings: Sequence[Recording], told_with: Model, wanted: Wanted, seed: int, search: Search, report: Report
) -> GapReport:
    def progress(what: str, fraction: float) -> None:
        report(f"levels of pixels: {what}", 0.01)

    levels = fit(recordings, told_with, starts=0, pixel_levels=wanted, seed=seed, progress=progress).pixel_levels
    assert levels is not None
    return replace(search(levels.seen(recordings)), pixel_levels=levels)
