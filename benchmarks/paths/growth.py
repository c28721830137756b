"""How time and memory grow with the size of the problem."""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from paths.memory import command_apart, measured_apart
from paths.sizes import Sizes
from paths.timing import Task, row
from pixelid.recordings import write_recording
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording

START_UP_EVENTS = 1_000  # of a file whose cost is that of starting the command


def tasks(sizes: Sizes) -> Iterator[Task]:
    """A row per command and what it grows with."""
    pixels = [[side, sizes.growth_steps[0]] for side in sizes.growth_pixels]
    yield _of_job("simulate", "pixel", pixels, [a * a for a, _ in pixels], "simulate, over pixels")
    steps = [[sizes.growth_pixels[0], n] for n in sizes.growth_steps]
    yield _of_job("simulate", "step", steps, sizes.growth_steps, "simulate, over steps")
    samples = [[n, 1] for n in sizes.growth_samples]
    yield _of_job("likelihood", "sample", samples, sizes.growth_samples, "likelihood, over samples and events")
    recordings = [[sizes.growth_samples[0], n] for n in sizes.growth_recordings]
    yield _of_job("likelihood", "recording", recordings, sizes.growth_recordings, "likelihood, over recordings")
    chains = [[n] for n in sizes.growth_chains]
    yield _of_job("training", "chain", chains, sizes.growth_chains, "training step, over chains of a batch")
    yield Task("growth", "inspect, over events", lambda: _of_command("inspect", sizes.growth_events))
    yield Task("growth", "convert, over events", lambda: _of_command("convert", sizes.growth_events))


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float:
    """The slope of ln value over ln size, 1 where the cost per item is constant; NaN where nothing was used."""
    if min(values) <= 0:
        return math.nan
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def _row(item: str, sizes: Sequence[int], points: Sequence[dict], note: str = "") -> dict:
    cpu, peak = [p["cpu_s"] for p in points], [p["peak_bytes"] for p in points]
    powers = {"cpu_s": exponent(sizes, cpu), "peak_bytes": exponent(sizes, peak)}
    return row(
        [cpu[-1]],
        size=", ".join(f"{n}" for n in sizes) + f" {item}s",
        item=item,
        items=sizes[-1],
        note=note,
        extra={
            "sizes": list(sizes), "cpu_s": cpu, "peak_bytes": peak,
            "exponents": {name: power if math.isfinite(power) else None for name, power in powers.items()},
        },
    )  # fmt: skip


def _of_job(job: str, item: str, arguments: list[list[int]], sizes: Sequence[int], path: str) -> Task:
    return Task("growth", path, lambda: _row(item, sizes, [measured_apart(job, each) for each in arguments]))


def _of_command(name: str, sizes: Sequence[int]) -> dict:
    """A command on files of random events, less what it takes on a small file."""
    with tempfile.TemporaryDirectory() as folder:

        def measured(count: int) -> dict[str, float]:
            path = Path(folder) / f"{count}.h5"
            write_recording(_recording(count), path)
            words = [str(path), *([str(Path(folder) / f"{count}.npz")] if name == "convert" else [])]
            return command_apart([sys.executable, "-m", "pixelid", name, *words, "--quiet"])

        start_up, *points = (measured(count) for count in (START_UP_EVENTS, *sizes))
    less = [{key: p[key] - start_up[key] for key in p} for p in points]
    note = (
        f"less a file of {START_UP_EVENTS} events: {start_up['cpu_s']:.1f} s, {start_up['peak_bytes'] / 2**20:.0f} MiB"
    )
    return _row("event", sizes, less, note)


def _recording(count: int) -> Recording:
    """Random events of 128 × 128 pixels, one per microsecond on average."""
    rng = np.random.default_rng(count)
    t = np.sort(rng.integers(0, 1000 * count, count))
    x, y, p = rng.integers(0, 128, count), rng.integers(0, 128, count), rng.integers(0, 2, count)
    return Recording(Events.from_columns(t, x, y, p, 128, 128, tick_ns=1), None, sensor="random")
