"""Dominant poles of the shipped sensors from their latencies, as `pixelid lowlight NAME --latency` finds them.

    python benchmarks/latency_poles.py [--out benchmarks/latency_poles.json]

A minute of CPU; `make models` runs it once the models are fitted.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SENSORS = ("gen31", "imx636")


def poles(sensor: str) -> dict[str, Any]:
    """What lowlight.json has under "latency" for a shipped model and the table that it was fitted to."""
    with tempfile.TemporaryDirectory() as folder:
        recipe, out = ROOT / "fits" / f"{sensor}.toml", Path(folder) / "lowlight"
        words = ["lowlight", sensor, "--latency", str(recipe), "--out", str(out), "--quiet"]
        subprocess.run([sys.executable, "-m", "pixelid", *words], check=True)
        return json.loads((out / "lowlight.json").read_text())["latency"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks" / "latency_poles.json")
    found = {sensor: poles(sensor) for sensor in SENSORS}
    parser.parse_args().out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
