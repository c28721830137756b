"""Figures of a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pixelid.bench.result import Calibration
from pixelid.fit import figures as of_fit
from pixelid.recordings.recording import Recording


def write_figures(result: Calibration, recordings: Sequence[Recording], folder: Path) -> list[Path]:
    """Write the figures of a calibration as SVG into `folder`; returns their paths."""
    return of_fit.write_figures(result.fit, recordings, folder)
