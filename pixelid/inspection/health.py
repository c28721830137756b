"""Everything `inspect` says about a recording, in one value."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from pixelid.biases import currents_of, has_jaer_biases, implied_by
from pixelid.errors import InputError
from pixelid.inspection.ceiling import Ceiling, Paces
from pixelid.inspection.counts import BusiestWindow, Counts, Survey, counts_of
from pixelid.inspection.dead_time import DeadTime, find_dead_time
from pixelid.inspection.hot_pixels import HotPixel, hot_of_counts
from pixelid.inspection.lines import Line, Spectra
from pixelid.inspection.preview import Preview
from pixelid.inspection.tick import MIN_EVENTS, Tick, tick_of
from pixelid.outputs import whole_folder, write_json
from pixelid.provenance import provenance
from pixelid.recordings.bursts import BurstCounter, Bursts
from pixelid.recordings.doubts import doubts, polarity_doubt
from pixelid.recordings.events import Events
from pixelid.recordings.parts import LongRecording
from pixelid.recordings.recording import Recording
from pixelid.recordings.source import ATTRIBUTE, Source

HOT_PIXELS_LISTED = 100
RATE_BINS = 500
Progress: TypeAlias = Callable[[str, float], None]


def no_progress(what: str, fraction: float) -> None:
    """Say nothing."""


@dataclass(frozen=True)
class Health:
    """What the events of a recording show by themselves.

    bursts: of pooled events
    intervals_share: of the intervals within pixels, how many dead time and tick were looked for in; 1 but in long ones
    biases: what the bias settings of jAER's header imply, as `biases.Implied.as_dict`; None where there are none
    source: what was inferred of the file and what was stated, as `recordings.source.Source.as_dict`
    doubts: what speaks against the events, in words
    overview: what figures show
    file: that the recording was read from, None for one in memory
    """

    name: str
    sensor: str
    width: int
    height: int
    pooled: bool
    counts: Counts
    dead_time: DeadTime
    tick: Tick
    lines: list[Line]
    hot_pixels: list[HotPixel]
    ceiling: Ceiling | None
    bursts: Bursts | None = None
    intervals_share: float = 1.0
    biases: dict[str, Any] | None = None
    source: dict[str, Any] | None = None
    doubts: tuple[str, ...] = ()
    overview: Overview | None = field(default=None, repr=False, compare=False)
    file: Path | None = None

    def report(self, folder: str | Path, *, overwrite: bool = False, seed: int = 0) -> Path:
        """Write inspect.json, figures and page into a folder; returns the path of the page.

        Args:
            folder: of the result.
            overwrite: replace the result of pixelid that the folder holds.
            seed: that chose the pixels, recorded.

        Raises:
            InputError: the folder is there and is not to be replaced, or belongs to no result of pixelid.
        """
        from pixelid.inspection.figures import write_figures
        from pixelid.report.html import write_report

        with whole_folder(Path(folder), overwrite) as temporary:
            write_json(temporary / "inspect.json", self.content(seed))
            write_figures(self, temporary)
            write_report(temporary)
        return Path(folder) / "report.html"

    def content(self, seed: int = 0) -> dict[str, Any]:
        """Of inspect.json: `to_dict`, with where it comes from."""
        files = [self.file] if self.file and self.file.is_file() else []
        return {**self.to_dict(), "file": str(self.file or ""), "seed": seed, **provenance(*files)}

    def summary(self) -> str:
        """What was found, in words: one line per finding."""
        from pixelid.inspection.table import rows_of_result

        return "\n".join(f"{name}: {text}" for name, text in rows_of_result(self.to_dict()))

    def to_dict(self) -> dict:
        """The stable keys of `inspect --json`."""
        counts, dead, tick = self.counts, self.dead_time, self.tick
        return {
            "name": self.name,
            "sensor": self.sensor,
            "events": counts.events,
            "duration_s": counts.duration_s,
            "width": self.width,
            "height": self.height,
            "pooled": self.pooled,
            "active_pixels": counts.active_pixels,
            "on_fraction": counts.on_fraction,
            "rate_hz": {"mean": counts.mean_hz, "peak": counts.peak_hz, "peak_window_s": counts.peak_window_s},
            "duplicates": counts.duplicates,
            "dead_time_s": {
                "value": dead.value_s,
                "interval_95": dead.interval_95_s,
                "visible": dead.value_s is not None,
                "reason": dead.reason,
                "intervals": dead.intervals,
                "intervals_share": self.intervals_share,
                "below": dead.below,
                "kind": dead.kind,
                "edge_95": dead.edge_95_s,
            },
            "tick_s": tick.tick_s,
            "tick": {
                "clock_s": tick.clock_s,
                "scan_s": tick.scan_s,
                "scan_jitter_s": tick.scan_jitter_s,
                "concentration": tick.concentration,
            },
            "lines": [asdict(line) for line in self.lines],
            "hot_pixels": [asdict(pixel) for pixel in self.hot_pixels[:HOT_PIXELS_LISTED]],
            "hot_pixel_count": len(self.hot_pixels),
            "ceiling": None if self.ceiling is None else asdict(self.ceiling),
            **({} if self.bursts is None else {"bursts": self.bursts.as_dict()}),
            **({} if self.biases is None else {"biases": self.biases}),
            "source": {"line": Source.from_dict(self.source).line(), **(self.source or {})},
            "doubts": list(self.doubts),
        }


@dataclass(frozen=True)
class Overview:
    """What figures of an inspection show, small however long the recording.

    Attributes:
        edges_s: (k + 1,) of bins of time from the first event on.
        on, off: (k,) events in them.
        image: (height, width) events per pixel.
        intervals: (m,) intervals within pixels [ns], of long recordings a random share.
        preview: t [ns], x, y, p of consecutive events from the middle on.
    """

    edges_s: np.ndarray
    on: np.ndarray
    off: np.ndarray
    image: np.ndarray
    intervals: np.ndarray
    preview: Mapping[str, np.ndarray]


def inspect(recording: Recording | LongRecording, progress: Progress = no_progress) -> Health:
    """Health of `recording` from its events.

    A pooled recording has no pixels: hot pixels, duplicates and ceiling are not looked for, and what its bursts show of
    dead time and number of pixels is (`bursts.py`).  A long
    recording is read twice, part by part; of its intervals within pixels a random share is looked at
    (`intervals.MOST_INTERVALS`), everything else is exact.  Time O(n log n); memory a small multiple of the
    events, for a long recording of a part of them.

    Args:
        recording: with or without a stimulus.
        progress: called with what is done and the fraction.
    """
    head = recording.head if isinstance(recording, LongRecording) else recording
    pooled = head.pooled
    survey = Survey(head.events.width, head.events.height, pooled)
    for events in _read(recording):
        survey.add(events)
        progress(f"{survey.events / 1e6:.0f} M events", 0.0)
    intervals = survey.intervals.intervals
    tick = tick_of(survey.clock_ns, intervals) if survey.events >= MIN_EVENTS and survey.clock_ns else Tick(None)
    if pooled:
        dead_time = DeadTime(None, None, "pixels are pooled; see the spacing of full bursts", 0)
    else:
        dead_time = find_dead_time(intervals, tick.tick_s, survey.intervals.pairs)
    busiest, spectra = BusiestWindow(survey), Spectra(survey.events, survey.first_ns, survey.last_ns)
    paces = None if pooled else Paces(survey, tick.clock_s)
    rates = _Rates(survey)
    bursts = BurstCounter() if pooled else None
    preview = Preview(0.5 * (survey.first_ns + survey.last_ns) if survey.events else 0.0)
    seen = 0
    for events in _read(recording):
        for part in (busiest, spectra, rates, preview, *([paces] if paces else []), *([bursts] if bursts else [])):
            part.add(events)
        seen += len(events)
        progress("rates and lines", seen / max(survey.events, 1))
    return Health(
        name=head.name,
        sensor=head.sensor,
        width=head.events.width,
        height=head.events.height,
        pooled=pooled,
        counts=counts_of(survey, busiest),
        dead_time=dead_time,
        tick=tick,
        lines=spectra.lines(tick.tick_s),
        hot_pixels=[] if pooled else hot_of_counts(survey.image, survey.duration_s),
        ceiling=None if paces is None else paces.ceiling(),
        bursts=None if bursts is None else bursts.bursts(),
        intervals_share=survey.intervals.share,
        biases=_implied(head),
        source=Source.from_dict(head.attributes.get(ATTRIBUTE)).as_dict(),
        doubts=_doubts(recording, survey),
        overview=Overview(rates.edges_s, rates.counts[1], rates.counts[0], survey.image, intervals, preview.events()),
        file=head.source,
    )


def _doubts(recording: Recording | LongRecording, survey: Survey) -> tuple[str, ...]:
    if isinstance(recording, Recording):
        return tuple(doubts(recording))
    line = polarity_doubt(survey.events, survey.on / survey.events if survey.events else None)
    return (line,) if line else ()


def _implied(head: Recording) -> dict[str, Any] | None:
    """What the biases of a recording imply; of damaged ones, why they imply nothing."""
    settings = head.attributes.get("biases")
    if not has_jaer_biases(head.sensor, settings):
        return None
    try:
        return implied_by(currents_of(head.sensor, settings)).as_dict()
    except InputError as error:
        return {"chip": head.sensor, "currents": {}, "values": {}, "without": {"biases": str(error)}}


def _read(recording: Recording | LongRecording) -> Iterable[Events]:
    """The events, in one piece where they lie in memory."""
    if isinstance(recording, LongRecording):
        return (part.events for part in recording.read())
    return [recording.events]


class _Rates:
    """Events of each polarity over time, part by part."""

    def __init__(self, survey: Survey) -> None:
        self.edges_s = np.linspace(0, max(survey.duration_s, 1e-9), RATE_BINS + 1)
        self.counts, self._first = np.zeros((2, RATE_BINS), np.int64), survey.first_ns

    def add(self, events: Events) -> None:
        time = (events.t - self._first) * 1e-9
        for polarity in (0, 1):
            self.counts[polarity] += np.histogram(time[events.p == polarity], self.edges_s)[0]
