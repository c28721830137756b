"""Tables of `pixelid conform` of recordings that others have made, for docs/results/conform/.

    python benchmarks/conform_tables.py --v2e-bandwidth DIR --v2e-leak DIR --evlib DIR --led FILE FILE --out DIR

v2e: folders of its recordings of light of known radiance, frames of 20 µs, one with a cutoff of 200 Hz and one with a
leak of 2 Hz.  evlib: the folder `evlib` of its wheel, whose ESIM is run here.  led: both recordings of a blinking LED.
Those left out are left out.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from export_comparison import events_of_evlib

from pixelid.conform.conform import conform
from pixelid.model.options import changed
from pixelid.model.shipped import find_model
from pixelid.recordings import open_recordings
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, slow
from pixelid.stimuli.stimulus import Stimulus

FRAME_S, SIDE = 2e-5, 5
# no faster than a threshold in the dead time: several would come at once after it, with one stamp
ESIM_LIGHTS = (chirp(40.0, stop_hz=200.0), chirp(110.0, stop_hz=200.0), slow(40.0, seed=1), slow(110.0, seed=2))
ESIM = {
    "contrast_threshold_pos": 0.2, "contrast_threshold_neg": 0.2, "refractory_period_ns": 1e5, "log_eps": 1e-9,
}  # fmt: skip


@dataclass(frozen=True)
class Table:
    """What is searched: recordings of whom, and the base model with what is added to it and taken out."""

    title: str
    about: str
    model: str
    with_: Sequence[str] = ()
    without: Sequence[str] = ()


KEPT = ("title", "about", "sentence", "verdict", "status", "rows", "gap", "seed", "versions", "inputs_sha256")
SCATTER = ("threshold_noise", "threshold_mismatch")
TABLES = {
    "v2e_bandwidth": Table(
        "v2e, cutoff of 200 Hz that moves with light",
        "25 pixels, frames of 20 µs, two chirps and two steps; base `dvs128_low_light` without source follower and "
        "differencing pole.",
        "dvs128_low_light", without=("source_follower_pole", "differencing_pole"),
    ),
    "v2e_leak": Table(
        "v2e, no bandwidth limit, leak of 2 Hz",
        "25 pixels, frames of 20 µs, two chirps and two steps; base `ideal` with mismatch and threshold noise.",
        "ideal", with_=SCATTER,
    ),
    "evlib_esim": Table(
        "ESIM of evlib 0.13.2",
        "25 pixels, frames of 20 µs, two chirps to 200 Hz and two slow lights at two levels, thresholds of 0.2 and "
        "a dead time of 0.1 ms (its default); base `ideal` with mismatch and threshold noise.",
        "ideal", with_=SCATTER,
    ),
    "led": Table(
        "A blinking LED outdoors (EVK4, 504 and 3125 Hz), all pixels pooled",
        "Two recordings without pixel addresses, their light the published sequence; base `dvs128`.",
        "dvs128",
    ),
}  # fmt: skip


def esim_recordings(folder: Path) -> list[Recording]:
    """The session of evlib's ESIM."""
    made = []
    for k, light in enumerate(ESIM_LIGHTS):
        fine = resampled(light, "smooth")
        t = light.start_s + FRAME_S * np.arange(int(light.duration_s / FRAME_S))
        radiance = np.exp(np.interp(t, fine.t, np.log(fine.radiance)))
        frames = ((float(when), np.full((SIDE, SIDE), value)) for when, value in zip(t, radiance, strict=True))
        x, y, at, polarity = events_of_evlib(folder, ESIM, frames).T
        stamps = np.rint(1e9 * at).astype(np.int64)
        order = np.lexsort((x, y, stamps))
        columns = (x.astype(np.uint16), y.astype(np.uint16), (polarity > 0).astype(np.uint8))
        events = Events(stamps[order], *(c[order] for c in columns), SIDE, SIDE, 1)
        seen = Stimulus.from_arrays(t, radiance, light.unit)
        made.append(Recording(events, seen, condition=f"light_{k}", sensor="evlib ESIM"))
    return made


def save(name: str, recordings: Sequence[Recording], out: Path) -> None:
    """Search, and write the table."""
    table = TABLES[name]
    base, _ = changed(find_model(table.model), table.with_, table.without, ())
    result = conform(recordings, base)
    told = {"title": table.title, "about": table.about, **result.as_dict()}
    told = {key: told[key] for key in KEPT}
    (out / f"{name}.json").write_text(json.dumps(told, indent=1, default=float) + "\n")
    print(name, result.summary(), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--v2e-bandwidth", type=Path)
    parser.add_argument("--v2e-leak", type=Path)
    parser.add_argument("--evlib", type=Path)
    parser.add_argument("--led", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    for name in TABLES:
        given = getattr(options, "evlib" if name == "evlib_esim" else name)
        if given is None:
            continue
        files = given if isinstance(given, list) else [given]
        save(name, esim_recordings(given) if name == "evlib_esim" else open_recordings(files), options.out)


if __name__ == "__main__":
    main()
