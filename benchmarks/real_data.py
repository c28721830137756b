"""Reproduce the real-data results of docs/results/real-data.md from a folder of recordings.

    python benchmarks/real_data.py RECORDINGS --out real-data

Fits flicker120_gen31.npz, rate_vs_frequency_gen31.csv and led_rate_vs_frequency_evk4.npz, inspects the noise of a still
scene (static_noise_*.npy), dvxplorer_scan.aedat4 and davis346_aps.aedat4, each where it is there, writes one result
folder each and prints a summary.  Some three minutes on one core.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pixelid.cli.main import main
from pixelid.inspection.timestamps import find_timestamp_signatures
from pixelid.model.model import Model
from pixelid.model.shipped import find_model
from pixelid.recordings import open_recording
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import constant

FITS = Path(__file__).resolve().parent.parent / "fits"


def commands(recordings: Path, out: Path) -> dict[str, list[str]]:
    """File → command line that fits it."""
    return {
        "flicker120_gen31.npz": ["flicker", str(recordings / "flicker120_gen31.npz"), "--out", str(out / "flicker")],
        "rate_vs_frequency_gen31.csv": [
            "rates", str(recordings / "rate_vs_frequency_gen31.csv"), "--unit", "mev/s", "--bias-law",
            "--out", str(out / "gen31"),
        ],
        "led_rate_vs_frequency_evk4.npz": [
            "rates", str(FITS / "led_rate_vs_frequency_evk4.toml"), "--data", str(recordings),
            "--out", str(out / "evk4"),
        ],
    }  # fmt: skip


def still_scene(recordings: Path, out: Path) -> int:
    """Leak, parasitic photocurrent or noise, and beside it what the simulator's own effects show."""
    files = sorted(recordings.glob("static_noise_*.npy"))
    code = main(["inspect", *map(str, files), "--out", str(out / "static_noise"), "--overwrite"])
    for name, (on, off) in regularity().items():
        print(f"simulated {name:28} cv of intervals: ON {on:.2f}, OFF {off:.2f}")
    return code


def regularity(seconds: float = 20.0) -> dict[str, tuple[float, float]]:
    """Effect → median cv of a simulated pixel's ON and OFF intervals under constant light (nan: too few events)."""
    model = find_model("dvs128")
    leak = model.with_effect("leak", {"rate_hz": 3.0})
    noise = {f"shot noise {d:g} at 1 fA": model.with_effect("shot_noise", {"density": d}) for d in (1e-3, 3e-3)}
    cases: dict[str, tuple[Model, float]] = {name: (camera, 1.0) for name, camera in noise.items()}
    for sigma in (0.02, 0.04, 0.1):
        cases[f"leak, threshold noise {sigma:g}"] = (leak.set({"threshold_sigma": sigma}), 24.0)
    both = leak.with_effect("shot_noise", {"density": 1e-4}).set({"threshold_sigma": 0.01})
    cases["leak and shot noise 1e-4"] = (both, 24.0)
    variations = {}
    for name, (camera, light) in cases.items():
        events = simulate(camera, constant(light, duration_s=seconds), width=4, height=4, seed=1).events
        variations[name] = (_cv(events, 1), _cv(events, 0))
    return variations


def _cv(events, polarity: int) -> float:
    cvs = []
    for pixel in np.unique(events.pixel):
        interval = np.diff(events.t[(events.pixel == pixel) & (events.p == polarity)])
        if len(interval) >= 10:
            cvs.append(interval.std(ddof=1) / interval.mean())
    return float(np.median(cvs)) if cvs else float("nan")


def readout(name: str) -> Callable[[Path, Path], int]:
    """What a recording's timestamps give away: `pixelid inspect`, and what the search for the gap reads off them."""

    def inspected(recordings: Path, out: Path) -> int:
        code = main(["inspect", str(recordings / name), "--out", str(out / name.split(".")[0]), "--overwrite"])
        for signature in find_timestamp_signatures([open_recording(recordings / name)]):
            print(f"{signature.parameter} = {1e6 * signature.value:.4f} µs: {signature.where}")
        return code

    return inspected


def led(recordings: Path, out: Path) -> int:
    """The gap of the blinking LED, all pixels pooled: both recordings, or the one that is there."""
    files = [str(f) for f in sorted(recordings.glob("led_uart_*hz_30m.h5"))]
    return main(["gap", *files, "--model", "dvs128", "--out", str(out / "led"), "--overwrite"])


# A file that must be there → what to do with the folder of recordings
INSPECTIONS: dict[str, Callable[[Path, Path], int]] = {
    "static_noise_pos_3klux.npy": still_scene,
    "dvxplorer_scan.aedat4": readout("dvxplorer_scan.aedat4"),
    "davis346_aps.aedat4": readout("davis346_aps.aedat4"),
    "led_uart_504hz_30m.h5": led,
}


def run(recordings: Path, out: Path) -> int:
    """Do what is there; returns the exit code: 0 when everything found went well, 2 when nothing was there."""
    out.mkdir(parents=True, exist_ok=True)
    lines = commands(recordings, out)
    missing = [name for name in (*lines, *INSPECTIONS) if not (recordings / name).is_file()]
    if len(missing) == len(lines) + len(INSPECTIONS):
        print(f"{recordings}: none of {', '.join(missing)}", file=sys.stderr)
        return 2
    codes = []
    for name in (name for name in (*lines, *INSPECTIONS) if name not in missing):
        print(f"== {name}")
        codes.append(main([*lines[name], "--overwrite"]) if name in lines else INSPECTIONS[name](recordings, out))
    for name in missing:
        print(f"== {name}: not there, left out")
    for path in sorted(out.glob("*/*.json")):
        print(path, json.loads(path.read_text()).get("status", ""))
    return max(codes)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path, help="folder of recordings")
    parser.add_argument("--out", type=Path, default=Path("real-data"))
    arguments = parser.parse_args()
    sys.exit(run(arguments.recordings, arguments.out))
