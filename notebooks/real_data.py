"""Reproduce the real-data results of docs/real-data.md from a folder of recordings.

    python notebooks/real_data.py RECORDINGS --out real-data

Fits flicker120_gen31.npz, rate_vs_frequency_gen31.csv and led_rate_vs_frequency_evk4.npz where there, writes one
result folder each and prints a summary.  Some two minutes on one core.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from pixelid.cli.main import main

FITS = Path(__file__).resolve().parent.parent / "fits"


def commands(recordings: Path, out: Path) -> dict[str, list[str]]:
    """File → command line that fits it."""
    return {
        "flicker120_gen31.npz": ["flicker", str(recordings / "flicker120_gen31.npz"), "--out", str(out / "flicker")],
        "rate_vs_frequency_gen31.csv": [
            "rates", str(recordings / "rate_vs_frequency_gen31.csv"), "--unit", "mev/s", "--out", str(out / "gen31"),
        ],
        "led_rate_vs_frequency_evk4.npz": [
            "rates", str(FITS / "led_rate_vs_frequency_evk4.toml"), "--data", str(recordings),
            "--out", str(out / "evk4"),
        ],
    }  # fmt: skip


def run(recordings: Path, out: Path) -> int:
    """Fit what is there; returns the exit code: 0 when everything found was fitted, 2 when nothing was."""
    out.mkdir(parents=True, exist_ok=True)
    found = {name: line for name, line in commands(recordings, out).items() if (recordings / name).is_file()}
    if not found:
        print(f"{recordings}: none of {', '.join(commands(recordings, out))}", file=sys.stderr)
        return 2
    codes = []
    for name, line in found.items():
        print(f"== {name}")
        codes.append(main([*line, "--overwrite"]))
    for path in sorted(out.glob("*/*.json")):
        print(path, json.loads(path.read_text())["status"])
    return max(codes)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path, help="folder of recordings")
    parser.add_argument("--out", type=Path, default=Path("real-data"))
    arguments = parser.parse_args()
    sys.exit(run(arguments.recordings, arguments.out))
