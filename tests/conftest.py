"""Fixtures common to all tests."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of oracle numbers and recordings beside the checkout; tests that need it skip without it."""
    path = Path(os.environ.get("PIXELID_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    if not path.is_dir():
        pytest.skip(f"no shared data at {path} (set PIXELID_SHARED)")
    return path
