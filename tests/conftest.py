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


@pytest.fixture(scope="session")
def calibration(tmp_path_factory):
    """(the calibration of a small session of a camera with a leak, its folder as `pixelid calibrate` writes it)."""
    from pixelid.bench.calibrate import calibrate
    from pixelid.bench.figures import write_figures
    from pixelid.report.html import write_report
    from tests.oracles.bench_sessions import make_session

    folder = tmp_path_factory.mktemp("calibration")
    make_session(
        folder / "bench", 3, side=4, levels=(24.0, 400.0), durations=(("steps", 0.4), ("chirp", 0.4)),
        effects={"leak": 4.0}, form="csv", fault="", unit="radiance_fA", gain_sd=0.0, trace_noise=0.0, trace_bits=0,
    )  # fmt: skip
    result = calibrate(folder / "bench", pixels=9)
    result.save(folder / "camera")
    write_figures(result, result.recordings, folder / "camera")
    write_report(folder / "camera", command="pixelid calibrate bench --out camera")
    return result, folder / "camera"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Slow tests may take an hour before they count as hanging."""
    for item in items:
        if item.get_closest_marker("slow"):
            item.add_marker(pytest.mark.timeout(3600))
