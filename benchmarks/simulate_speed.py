"""Speed of the video simulator, as ratios to plain ways of writing the same step, measured in the same run.

    python benchmarks/simulate_speed.py [--runs 5]

A 346 × 260 moving grating, 200 steps of 100 µs, contrast 0.5, fourth-order pixel with threshold mismatch and noise.
The simulator's time includes everything but the making of the stimulus: trajectories, events, sorting.  The plain
ways advance the states only, without events:

    scalar   `kernels.advance`, compiled, pixel by pixel on one thread
    numpy    the same closed form on float64 arrays of all pixels
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from numba import njit

from pixelid.dynamics import kernels
from pixelid.dynamics.equations import step_two_poles
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import grating


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5, help="the fastest of so many counts")
    runs = parser.parse_args().runs
    model, video = find_model("dvs128"), grating(level=100.0, modulation=0.5, duration_s=0.02, dt=1e-4)
    dynamics = tuple(dynamics_of(model.circuit()).uniform()[:7])
    steps = (len(video.t) - 1) * video.radiance[0].size
    logs = np.log(video.radiance.reshape(len(video.t), -1).astype(np.float64))
    ways = {
        "simulator, one thread": lambda: simulate(model, video, threads=1),
        "simulator, two threads": lambda: simulate(model, video, threads=2),
        "scalar kernel, states only": lambda: _scalar(logs[:21], 1e-4, dynamics),
        "numpy, states only": lambda: _numpy(logs[:21], 1e-4, dynamics),
    }
    share = {name: 1.0 if name.startswith("simulator") else 0.1 for name in ways}
    times = {name: _fastest(way, runs) / (steps * share[name]) for name, way in ways.items()}
    events = len(simulate(model, video).events)
    print(f"{steps / 1e6:.1f} million pixel steps, {events} events")
    for name, seconds in times.items():
        ratio = seconds / times["simulator, one thread"]
        print(f"{name:28s} {1e-6 / seconds:8.2f} million pixel steps/s   {ratio:6.2f} x the time of the simulator")


def _fastest(way, runs: int) -> float:
    way()
    best = np.inf
    for _ in range(runs):
        start = time.perf_counter()
        way()
        best = min(best, time.perf_counter() - start)
    return best


@njit
def _scalar(u, tau, dynamics):
    alpha, beta, gamma, w1, w2, wh, wd = dynamics
    total = 0.0
    for i in range(u.shape[1]):
        state = (0.0, u[0, i], u[0, i], u[0, i], 0.0, u[0, i])
        for k in range(len(u) - 1):
            light = np.exp(0.5 * (u[k, i] + u[k + 1, i]))
            slope = (u[k + 1, i] - u[k, i]) / tau
            state = kernels.advance(
                state, u[k, i], slope, tau, alpha * light, beta + gamma * light, w1, w2, wh, wd, False
            )
        total += state[5]
    return total


def _numpy(u, tau, dynamics):
    alpha, beta, gamma, w1, _, _, wd = dynamics
    state = (np.zeros(u.shape[1]), u[0], u[0], u[0])
    k1, kd = np.exp(-w1 * tau), np.exp(-wd * tau)
    for k in range(len(u) - 1):
        light = np.exp(0.5 * (u[k] + u[k + 1]))
        a, b2 = alpha * light, beta + gamma * light
        root = np.sqrt((0.25 * b2 * b2 - a).astype(np.complex128))
        decay = np.exp(-0.5 * b2 * tau)
        g = decay * (np.sinh(root * tau) / root).real
        f = decay * np.cosh(root * tau).real
        factors = f + 0.5 * b2 * g, f - 0.5 * b2 * g, g
        state = step_two_poles(state, u[k], (u[k + 1] - u[k]) / tau, tau, a, b2, w1, wd, factors, k1, kd)
    return state[3].sum()


if __name__ == "__main__":
    main()
