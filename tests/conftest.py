"""Fixtures common to all tests."""

import os
from pathlib import Path

import pytest

# Processes that run tests side by side share the cores: with as many threads each as there are cores, those that
# train take two fifths longer. Set before torch and BLAS are imported; what a test or a user sets holds.
if processes := int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "0")):
    share = str(max(1, (os.cpu_count() or 1) // processes))
    for name in ("OMP_NUM_THREADS", "PIXELID_THREADS"):
        os.environ.setdefault(name, share)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of oracle numbers and recordings beside the checkout; tests that need it skip without it."""
    path = Path(os.environ.get("PIXELID_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    if not path.is_dir():
        pytest.skip(f"no shared data at {path} (set PIXELID_SHARED)")
    return path


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Slow tests may take an hour before they count as hanging."""
    for item in items:
        if item.get_closest_marker("slow"):
            item.add_marker(pytest.mark.timeout(3600))
