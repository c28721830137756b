"""Fixtures common to several integration tests."""

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def made(tmp_path_factory) -> Path:
    """A dataset of 16 × 16 pixels, one turn in a quarter of a second; copied by tests that change it."""
    from pixelid.nerf.synthetic import make_dataset  # torch, which most tests do without

    folder = tmp_path_factory.mktemp("scene") / "hard"
    return make_dataset(folder, "hard", seed=3, side=16, revolutions=1.0, frames_per_turn=300)
