"""What `import pixelid` shows of recordings: open, look at, cut and convert them."""
# pyright: reportUnnecessaryIsInstance=false
# what users give is checked, whatever the annotations promise

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pixelid.errors import InputError

if TYPE_CHECKING:
    from pixelid.inputs import StimulusLike
    from pixelid.inspection.health import Health
    from pixelid.recordings.recording import Recording


def open(
    source: str | Path | Sequence[str | Path],
    *,
    size: str | tuple[int, int] | None = None,
    time_unit: str | None = None,
    columns: str | Sequence[str] | None = None,
    stream: str | None = None,
    chip: str | None = None,
    polarity: str | None = None,
    clock: str | None = None,
) -> Recording | tuple[Recording, ...]:
    """Open recordings of any readable format; what their files do not state is inferred, or stated here.

    Args:
        source: a file, a folder that stands for the recordings in it, or a list of either.
        size: the sensor's width and height, as "640x480" or (640, 480).
        time_unit: "s", "ms", "us" or "ns".
        columns: their order, as "t,x,y,p" or "t=NAME,x=NAME,…".
        stream: which of several streams, topics or arrays.
        chip: the sensor's name, where its size and addresses are known by it.
        polarity: "01", "pm1" or "swapped".
        clock: where times fall: "strict" refuses, "sort" sorts, "split" reads stretches.

    Returns:
        One `Recording` for a file, a tuple of them for a folder or a list; what was inferred is in
        `attributes["source"]`.

    Raises:
        InputError: a file or folder that cannot be read as recordings; one line says which and why.

    Example:
        >>> import pixelid as px
        >>> px.open("session/chirp.h5")  # doctest: +SKIP
    """
    from pixelid.inputs import as_recordings, warn_of_empty
    from pixelid.recordings.reading import open_recording
    from pixelid.recordings.source import stating

    with stating(_options(size=size, time_unit=time_unit, columns=columns, stream=stream, chip=chip,
                          polarity=polarity, clock=clock)):  # fmt: skip
        if isinstance(source, str | Path) and not Path(source).is_dir():
            recording = open_recording(source)
            warn_of_empty([recording])
            return recording
        return tuple(as_recordings(source))


def inspect(recording: Recording | str | Path, **options: Any) -> Health:
    """Look at the health of a recording from its events: rates, dead time, tick, lines, hot pixels, readout.

    Args:
        recording: opened, or a file.
        options: of `open`.

    Returns:
        What the events show; `summary()` in words, `to_dict()` as `pixelid inspect --json`.

    Raises:
        InputError: as `open`.

    Example:
        >>> import pixelid as px
        >>> px.inspect(px.simulate("ideal", "sine", pixels=4)).width
        2
    """
    from pixelid.inspection.health import inspect as run

    return run(_one(recording, options))


def crop(
    recording: Recording | str | Path,
    *,
    roi: tuple[int, int, int, int] | None = None,
    time_s: tuple[float, float] | None = None,
    pixels: int | None = None,
    without_hot_pixels: bool = False,
    from_first: bool = False,
    seed: int = 0,
    **options: Any,
) -> Recording:
    """Cut a recording to a part of the sensor, of the time or of the pixels.

    Args:
        recording: opened, or a file.
        roi: (x0, y0, x1, y1), x1 and y1 excluded.
        time_s: (from, to) on the recording's clock.
        pixels: how many, chosen by `seed`.
        without_hot_pixels: leave out pixels that fire whatever the others do.
        from_first: count `time_s` from the first event on.
        seed: of the choice of pixels.
        options: of `open`.

    Returns:
        The part of the recording.

    Raises:
        InputError: a region outside the sensor, an empty span, no event left.

    Example:
        >>> import pixelid as px
        >>> len(set(px.crop(px.simulate("ideal", "sine", pixels=4), pixels=1).events.pixel))
        1
    """
    from pixelid.recordings.crop import Crop

    return Crop(roi, time_s, pixels, without_hot_pixels, from_first).applied(_one(recording, options), seed)


def convert(
    source: str | Path,
    target: str | Path | None = None,
    *,
    stimulus: StimulusLike | None = None,
    align: str | None = None,
    seed: int = 0,
    overwrite: bool = False,
    **options: Any,
) -> Recording:
    """Put a recording with its light, on one clock, and write it.

    Args:
        source: a file of any readable format.
        target: .h5, .npz, .csv or .txt; None: nothing is written.
        stimulus: the light, its file or name; "sensor" or "frames" for what the sensor measured.
        align: "trigger", "first-event", "auto", or seconds; None: light and events have one clock.
        seed: of the part of a long recording that is aligned.
        overwrite: whether a file that is there is replaced.
        options: of `open`.

    Returns:
        The recording.

    Raises:
        InputError: as `open`; light that does not cover the events or cannot be aligned; a file that is there.

    Example:
        >>> import pixelid as px
        >>> px.convert("camera.raw", "chirp.h5", stimulus="light.csv", align="auto")  # doctest: +SKIP
    """
    from pixelid.recordings.conversion import converted
    from pixelid.recordings.crop import Crop
    from pixelid.recordings.parts import as_whole
    from pixelid.recordings.source import stating
    from pixelid.recordings.writing import check_writable, write_recording

    if target is not None:
        check_writable(target)
    with stating(_options(**options)):
        recording, _ = converted(Path(source), stimulus, None if align is None else str(align), Crop(), seed)
        whole = as_whole(recording)
        if target is not None:
            write_recording(whole, target, overwrite=overwrite)
    return whole


def align(
    recording: Recording | str | Path,
    stimulus: StimulusLike,
    how: str | float = "auto",
    **options: Any,
) -> Recording:
    """Bring a light that has its own clock onto the camera's, as `pixelid convert --align` does.

    Args:
        recording: opened, or a file.
        stimulus: the light, its file or name.
        how: "trigger", "first-event", "auto", or the seconds on the camera's clock at which the light starts.
        options: of `open`.

    Returns:
        The recording under its light, without the events outside it; `attributes["alignment"]` says where the light
        starts, how far the clocks differ, and how well that is known.

    Raises:
        InputError: as `open`; light that repeats itself or that the events do not follow.

    Example:
        >>> import pixelid as px
        >>> pixel = px.simulate("dvs128", "chirp", pixels=4)
        >>> px.align(pixel, pixel.stimulus, 0.0).attributes["alignment"]["method"]
        'given'
    """
    from pixelid.inputs import as_stimulus
    from pixelid.recordings.alignment import aligned, find_alignment

    opened, light = _one(recording, options), as_stimulus(stimulus)
    together = aligned(opened, light, find_alignment(opened, light, str(how)))
    together.check_stimulus_covers_events()
    return together


def _one(recording: Recording | str | Path, options: dict[str, Any]) -> Recording:
    from pixelid.recordings.recording import Recording as Opened

    if isinstance(recording, Opened):
        if options:
            raise InputError(f"{next(iter(options))}: states what a file does not; this recording is open already")
        return recording
    if not isinstance(recording, str | Path):
        raise InputError(f"recording: expected a Recording or a path, found {type(recording).__name__}")
    opened = open(recording, **options)
    if not isinstance(opened, Opened):
        raise InputError(f"{recording}: expected one recording, found a folder")
    return opened


def _options(**values: Any):
    from pixelid.recordings.source import ReadingOptions

    return ReadingOptions.of(values)
