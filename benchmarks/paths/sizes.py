"""How large every measured problem is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Sizes:
    """Sizes of all sections; the defaults are what the page shows, `TINY` is for tests.

    runs: of each way;  filter_shape: (samples of the past, runs);  video: (width, height, steps);  plain_steps: of the
    video, for the plain ways;  model: of fit and posterior;  effective: samples wanted;  gap: whether to
    search for it;  long_runs: of posterior and gap;  sensors: sides of those rendered;  growth_*: ascending
    """

    runs: int = 5
    filter_shape: tuple[int, int] = (30, 4096)
    video: tuple[int, int, int] = (346, 260, 200)
    plain_steps: int = 20
    streamed: tuple[int, int] = (320, 180)
    streamed_steps: tuple[int, ...] = (250, 1000, 4000)
    likelihood_samples: int = 500_000
    likelihood_seconds: float = 20.0
    likelihood_pixels: tuple[int, int] = (11, 8)
    model: str = "dvs128"
    fit_starts: int = 2
    effective: int = 1000
    sensor_side: int = 16
    whole_sensor: tuple[int, int] = (346, 260)
    gap: bool = True
    long_runs: int = 3
    sensors: tuple[int, ...] = (64, 200, 800)
    rays: int = 5_000
    growth_pixels: tuple[int, ...] = (40, 80, 160)
    growth_steps: tuple[int, ...] = (200, 400, 800)
    growth_events: tuple[int, ...] = (300_000, 1_200_000, 4_800_000)
    growth_samples: tuple[int, ...] = (125_000, 500_000, 2_000_000)
    growth_recordings: tuple[int, ...] = (2, 4, 8)
    growth_chains: tuple[int, ...] = (320, 1280, 5120)


TINY = Sizes(
    runs=2,
    filter_shape=(5, 8),
    video=(8, 6, 10),
    plain_steps=4,
    streamed=(8, 6),
    streamed_steps=(20, 40),
    likelihood_samples=2_000,
    likelihood_seconds=0.1,
    likelihood_pixels=(2, 1),
    model="ideal",
    fit_starts=0,
    effective=20,
    sensor_side=2,
    gap=False,
    long_runs=1,
    sensors=(8,),
    rays=50,
    growth_pixels=(4, 8),
    growth_steps=(10, 20),
    growth_events=(2_000, 4_000),
    growth_samples=(1_000, 2_000),
    growth_recordings=(1, 2),
    growth_chains=(16, 32),
)
