"""Make the bench session that comes with the package and that `make demo` calibrates.

A small session of `tests/oracles/bench_sessions.py`, which shares no code with the package: sixteen pixels, six short
recordings, clocks 40 ppm apart, a leak of 2 Hz that `dvs128` lacks, a photodiode of 12 bits with 0.3 % noise.

    python benchmarks/make_demo_bench.py --out pixelid/demo/bench
"""

from __future__ import annotations

import argparse
import io
import sys
import zipfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.oracles.bench_sessions import make_session

DEMO = {
    "side": 4,
    "levels": (24, 400),
    "durations": (("steps", 0.5), ("chirp", 0.5), ("slow", 0.8)),
    "effects": {"leak": 2.0},
    "clock_ppm": 40.0,
    "fault": "",
    "form": "raw",
    "light_form": "npz",
    "unit": "radiance_fA",
    "trace_noise": 0.003,
    "trace_bits": 12,
    "gain_sd": 0.0,
    "address": (120, 80),
    "chirp_stop": 1.0,
    "ramp": "corners",
    "start": "random",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("pixelid/demo/bench"))
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    truth = make_session(options.out, options.seed, **DEMO)
    packed = io.BytesIO()
    files = sorted(options.out.iterdir())
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in files:
            archive.write(file, file.name)
    size = sum(file.stat().st_size for file in files)
    print(f"{truth['events']} events; {size / 1e3:.0f} kB, {len(packed.getvalue()) / 1e3:.0f} kB packed")
    for name, each in truth["recordings"].items():
        print(f"{name:<12}{each['events']:>7} events in {each['light_s']:.2f} s")


if __name__ == "__main__":
    main()
