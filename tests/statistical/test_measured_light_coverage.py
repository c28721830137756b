"""Thresholds from light that the sensor measured itself, against cameras simulated apart from the package.

Each pixel is stepped through its light at 50 µs; after every event it measures one exposure, as an ATIS does: it waits
for its photocurrent, then integrates a fixed charge.  The light is smooth, steps, or is as rough as a random walk.
"""

import numpy as np
import pytest

from pixelid.fit import fit
from pixelid.model.shipped import find_model
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.recordings.sensor_light import with_measured_light

STEP_S, SECONDS, PIXELS = 5e-5, 2.0, 40
ON, OFF, NOISE, DEAD_S, CHARGE, LATE_S = 0.3, 0.36, 0.06, 1e-3, 1.0, 4e-4
LEVEL = 700.0  # of the light: exposures of about CHARGE/LEVEL = 1.4 ms


def smooth(rng, n, time_s):
    f = np.fft.rfftfreq(n, STEP_S)
    u = np.fft.irfft(np.exp(-0.5 * (2 * np.pi * f * time_s) ** 2) * (rng.normal(size=(2, len(f))).T @ [1, 1j]), n)
    return 0.6 * u / u.std()


def rough(rng, n, time_s):
    f = np.fft.rfftfreq(n, STEP_S)
    u = np.fft.irfft((rng.normal(size=(2, len(f))).T @ [1, 1j]) / np.hypot(1.0, 2 * np.pi * f * time_s), n)
    return 0.6 * u / u.std()


def edges(rng, n, time_s):
    t, u, before = np.arange(n) * STEP_S, np.zeros(n), rng.normal(0.0, 0.6)
    for when in np.cumsum(rng.exponential(0.15, 40)):
        after = rng.normal(0.0, 0.6)
        u += 0.5 * (after - before) * (1.0 + np.tanh((t - when) / time_s))
        before = after
    return u


def camera(light, time_s, seed):
    """A recording with exposures: PIXELS pixels, each under its own light of that kind."""
    rng, n = np.random.default_rng(seed), round(SECONDS / STEP_S)
    u = np.array([light(rng, n, time_s) for _ in range(PIXELS)])
    radiance, late = LEVEL * np.exp(u), round(LATE_S / STEP_S)
    own_on, own_off = ON * (1 + 0.04 * rng.normal(size=PIXELS)), OFF * (1 + 0.04 * rng.normal(size=PIXELS))
    draw = lambda: (own_on * (1 + NOISE * rng.normal(size=PIXELS)), own_off * (1 + NOISE * rng.normal(size=PIXELS)))  # noqa: E731
    (on, off), reference, free_at = draw(), u[:, 0].copy(), np.zeros(PIXELS)
    left = np.zeros(PIXELS)  # charge until the exposure begins (above CHARGE) or ends
    events, begins, ends = [], [], []
    for k in range(1, n):
        t = k * STEP_S
        before = left.copy()
        left = np.where(left > 0, left - radiance[:, k] * STEP_S, left)
        begins += [(t, i, 0) for i in np.flatnonzero((before > CHARGE) & (left <= CHARGE))]
        ends += [(t, i, 1) for i in np.flatnonzero((before > 0) & (left <= 0))]
        released = (free_at > 0) & (t >= free_at)
        reference = np.where(released, u[:, k], reference)
        free_at = np.where(released, 0.0, free_at)
        change = u[:, k] - reference
        fires = (free_at == 0) & ((change >= on) | (-change >= off))
        if fires.any():
            events += [(t + late * STEP_S, i, int(change[i] > 0)) for i in np.flatnonzero(fires)]
            new_on, new_off = draw()
            on, off = np.where(fires, new_on, on), np.where(fires, new_off, off)
            free_at = np.where(fires, t + DEAD_S, free_at)
            left = np.where(fires, 1.7 * CHARGE, left)

    def as_events(rows):
        t, x, p = np.array(sorted(rows)).T
        t_ns = np.round(t * 1e6).astype(np.int64) * 1000
        return Events.from_columns(t_ns, x.astype(int), np.zeros(len(t), int), p.astype(int), PIXELS, 1)

    return with_measured_light(Recording(as_events(events), exposures=as_events(begins + ends)))


LIGHTS = [(smooth, 0.02), (smooth, 0.05), (smooth, 0.1), (edges, 0.01), (edges, 0.03), (rough, 0.3), (rough, 1.0)]


@pytest.mark.slow
@pytest.mark.parametrize(("light", "time_s"), LIGHTS)
def test_intervals_hold_thresholds_and_delay(light, time_s):
    """Of 84 intervals of all kinds of light, about 80."""
    held = []
    for seed in range(4):
        result = fit([camera(light, time_s, seed)], find_model("dvs128"), starts=0, seed=0)
        assert result.status in ("converged", "misfit")
        for name, truth in (("on_threshold", ON), ("off_threshold", OFF), ("delay_s", LATE_S)):
            estimate = result.estimates[name]
            low, high = estimate.interval_95
            held.append(low <= truth <= high)
            print(light.__name__, time_s, seed, name, f"{estimate.value:.4g} ({low:.4g} … {high:.4g})", held[-1])
    assert sum(held) >= 10  # of 12: fewer would be one in 50
