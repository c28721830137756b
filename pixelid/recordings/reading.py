"""Open any readable recording: look at the file's first bytes, then hand it to the reader of its format."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

from pixelid.delimited import CONTROL, cells_of, encoding_of, is_number
from pixelid.errors import InputError, did_you_mean
from pixelid.recordings.crop import Crop
from pixelid.recordings.doubts import doubts
from pixelid.recordings.isolated import read_isolated, stream_isolated
from pixelid.recordings.parts import LongRecording, as_whole, joined_if_short
from pixelid.recordings.recording import Recording
from pixelid.recordings.session import agreed
from pixelid.recordings.source import ATTRIBUTE, ReadingOptions, Source, announce, options_for

LONG_BYTES = 1 << 21  # of files that are read in parts: smaller ones cannot hold what memory could not
BAG_SUFFIXES = (".bag", ".db3", ".mcap")
BINARY_SUFFIXES = (".h5", ".hdf5", ".npz", ".aedat4", ".aedat", ".raw", ".dat", ".es", ".mat", *BAG_SUFFIXES)
TEXT_SUFFIXES = (".csv", ".txt", ".tsv")
READABLE = ", ".join(BINARY_SUFFIXES + TEXT_SUFFIXES)


def open_recording(path: str | Path, options: ReadingOptions | None = None) -> Recording:
    """The recording in the file `path`, whatever its format.

    Reads pixelid and published HDF5, npz, AEDAT4, AEDAT2 (DAVIS, DVS128), Prophesee RAW (EVT2, EVT2.1, EVT3) and DAT,
    ES, bags, MATLAB files and text.  Times become int64 nanoseconds; `events.tick_ns` remembers the unit of the source.

    Args:
        path: the file; `NAME.source.toml` next to it may state what it does not.
        options: what the caller states, over that.

    Returns:
        The recording; `attributes["source"]` says what was inferred, where anything was.

    Raises:
        InputError: one plain line (file, field, expected, found) for a missing, empty, truncated or unknown file, a
            missing column, unsorted times, pixels outside the sensor, readings of which one must be stated, times that
            do not fit 64 bits in nanoseconds, and a stimulus that is invalid or does not cover the events.
    """
    path = Path(path)
    reader = _recognised(path)
    recording = replace(read_isolated(reader, path, options_for(path, options).as_dict()), source=path)
    if recording.stimulus is not None:
        recording.check_stimulus_covers_events()
    announce(path, recording.attributes, lambda: doubts(recording))
    return recording


def open_cropped(
    path: str | Path, crop: Crop, seed: int = 0, options: ReadingOptions | None = None
) -> Recording | LongRecording:
    """The part of a file's recording that is asked for; one of many events stays in the file.

    Args:
        path: of any readable format; bags and MATLAB files are decoded whole, by a process of their own.
        crop: what is wanted of it.
        seed: chooses the pixels of `crop`.
        options: as of `open_recording`.

    Returns:
        The recording, or what reads it part by part where more than `WHOLE_EVENTS` events are left.

    Raises:
        InputError: as `open_recording` and `Crop.applied`.
    """
    path = Path(path)
    reader = _recognised(path)
    if path.stat().st_size < LONG_BYTES:
        return crop.applied(open_recording(path, options), seed)
    stated = options_for(path, options).as_dict()

    def read() -> Iterator[Recording]:
        for part in islice(stream_isolated(reader, path, stated), 1, None):
            yield replace(part, source=path)

    head = replace(next(stream_isolated(reader, path, stated)), source=path)
    announce(path, head.attributes)
    cropped = crop.applied(LongRecording(head, read), seed)
    recording = joined_if_short(cropped)
    if recording.stimulus is not None:
        recording.check_stimulus_covers_events()
    return recording


def open_recordings(
    paths: Iterable[str | Path], crop: Crop | None = None, seed: int = 0, options: ReadingOptions | None = None
) -> list[Recording]:
    """Every recording of `paths`, as one session; a folder stands for the recordings in it, sorted by name.

    Text files of a folder (often notes) count only when it holds nothing else.  With a crop, only what it leaves is
    taken into memory.  A clock that is split makes several recordings of a file.

    Raises InputError as `open_recording` does, for a folder without recordings, and for recordings that do not agree on
    the sensor's size, the unit of time or the polarity (`session.agreed`).
    """
    cut = crop or Crop()
    opened = []
    for file in (file for path in paths for file in _files(Path(path))):
        first = as_whole(open_cropped(file, cut, seed, options))
        clock = Source.from_dict(first.attributes.get(ATTRIBUTE)).inferred.get("clock", ("",))[0]
        number, _, count = str(clock).partition("/")
        opened.append(first)
        for k in range(2, int(count) + 1) if number == "1" and (options_for(file, options).clock == "split") else ():
            again = replace(options_for(file, options), clock=f"split:{k}")
            opened.append(replace(as_whole(open_cropped(file, cut, seed, again)), label=f"{file.stem} ({k})"))
    return agreed(opened)


def check_readable(paths: Iterable[str | Path]) -> None:
    """Look for the files before anything slow begins.  Raises InputError as `open_recordings`, where a look shows."""
    for path in paths:
        for file in _files(Path(path)):
            _recognised(file)


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    files = sorted(file for file in path.iterdir() if file.is_file() and not file.name.startswith("."))
    for suffixes in (BINARY_SUFFIXES, TEXT_SUFFIXES):
        chosen = [file for file in files if file.suffix.lower() in suffixes]
        if chosen:
            return chosen
    raise InputError(f"{path}: expected a folder with recordings ({READABLE}), found none")


def _recognised(path: Path) -> str:
    """The name of the file's reader.  Raises InputError for what is no file, is empty, or is of no known format."""
    if not path.exists():
        beside = [] if not path.parent.is_dir() else [file.name for file in path.parent.iterdir()]
        raise InputError(f"{path}: no such file{did_you_mean(path.name, beside)}")
    if path.is_dir():
        raise InputError(f"{path}: expected a recording file, found a folder")
    if not path.is_file():
        raise InputError(f"{path}: expected a regular file, found a device, pipe or socket")
    looked_at = 4096  # bytes, by which a format shows
    try:
        with path.open("rb") as file:
            head = file.read(looked_at)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    if not head:
        raise InputError(f"{path}: expected a recording, found an empty file")
    return _reader(path, head)


def _reader(path: Path, head: bytes) -> str:
    """The name of the reader of files that begin with `head`."""
    suffix = path.suffix.lower()
    if head.startswith(b"\x89HDF\r\n\x1a\n") or suffix in (".h5", ".hdf5"):
        return "hdf5"
    if suffix == ".npz" or (suffix == ".npy" and head.startswith(b"\x93NUMPY")):
        return "npz"
    if suffix == ".mat" or head.startswith(b"MATLAB 5.0"):
        return "matlab"
    if head.startswith((b"#ROSBAG V2", b"\x89MCAP0", b"SQLite format 3")) or suffix in BAG_SUFFIXES:
        return "ros"
    if head.startswith(b"#!AER-DAT2"):
        return "aedat2"
    if head.startswith(b"#!AER-DAT") and not head.startswith((b"#!AER-DAT4", b"#!AER-DAT text")):
        version = head.splitlines()[0].decode("latin1")[:40]
        raise InputError(f"{path}: expected AER-DAT2.0 or AER-DAT4.0, found {version}; convert it with jAER or DV")
    if head.startswith((b"#!AER-DAT4", b"Event Stream")):
        return "decoded"
    if suffix in TEXT_SUFFIXES or (suffix not in (".aedat4", ".raw", ".es") and _is_table(head)):
        return "text"
    if suffix in (".aedat4", ".raw", ".dat", ".es"):
        return "decoded"
    if head.startswith((b"\x1f\x8b", b"PK\3\4", b"BZh", b"\xfd7zXZ")):
        raise InputError(f"{path}: expected a recording, found a packed file; unpack it first")
    raise InputError(
        f"{path}: expected a recording ({READABLE}), found {suffix or 'a file without extension'}; "
        "columns t, x, y, p of .csv or .npz are read"
    )


def _is_table(head: bytes) -> bool:
    """Whether a file begins as a table of at least four columns."""
    coding = encoding_of(head)
    if CONTROL.search(head) and coding != "utf-16":
        return False
    rows = [cells_of(line.strip("[]() \t"))[0] for line in head.decode(coding, "replace").splitlines()[:-1]]
    return any(len(row) >= 4 and is_number(row[0]) for row in rows)
