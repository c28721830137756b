"""The video simulator beside plain ways of writing its step, and beside evlib's ESIM where that is installed."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import statistics
import sys
import types
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np
from numba import njit

from paths.counting import step_flops
from paths.memory import measured_apart
from paths.sizes import Sizes
from paths.timing import Counts, Other, Target, Task, compared, interleaved, row
from pixelid.dynamics import kernels
from pixelid.dynamics.equations import step_two_poles
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.export.export import export
from pixelid.export.light import Light
from pixelid.model.shipped import find_model
from pixelid.provenance import versions
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import grating
from pixelid.stimuli.stimulus import Stimulus

ITEM, DT, LEVEL = "pixel step", 1e-4, 100.0


def tasks(sizes: Sizes) -> Iterator[Task]:
    """One thread beside three others, two threads, and memory of a streamed video over its frames."""
    yield Task("video", "simulator beside the scalar kernel", lambda: beside(sizes, "scalar"))
    yield Task("video", "simulator beside NumPy", lambda: beside(sizes, "numpy"))
    yield Task("video", "simulator beside ESIM", lambda: beside(sizes, "esim"))
    yield Task("video", "simulator, two threads", lambda: two_threads(sizes))
    yield Task("video", "streamed, memory over frames", lambda: streamed(sizes))


@lru_cache(maxsize=2)
def video(shape: tuple[int, int, int]) -> Stimulus:
    """A moving grating of contrast 0.5 in frames of 100 µs."""
    width, height, steps = shape
    return grating(width=width, height=height, level=LEVEL, modulation=0.5, duration_s=steps * DT, dt=DT)


def counts() -> Counts:
    """Per step and pixel √ of the mean light and exp of the photoreceptor's decay, one new log, √ in the bound on the
    slope (the other exponentials are those of the step's length, shared by all); four states are read and written,
    frames read."""
    return Counts(bytes=8.0 * (4 + 4) + 8, flops=step_flops(), exponentials=4)


def beside(sizes: Sizes, name: str) -> dict:
    """One thread, in turn with another way; the plain ones advance states only, without events."""
    model, stimulus = find_model("dvs128"), video(sizes.video)
    steps = (len(stimulus.t) - 1) * stimulus.radiance[0].size
    other, note = {"scalar": _scalar_way, "numpy": _numpy_way, "esim": _esim_way}[name](stimulus, sizes)
    found = compared(
        lambda: simulate(model, stimulus, threads=1),
        other,
        sizes.runs,
        size="{} × {} pixels × {} steps".format(*sizes.video),
        item=ITEM,
        items=steps,
        target=Target("rate", 40e6) if name == "scalar" else None,
        counts=counts(),
        words="arithmetic of the closed-form step, then the crossings of pixels that fire",
        note=note,
    )
    return found


def _states_only(stimulus: Stimulus, sizes: Sizes):
    logs = np.log(stimulus.radiance[: sizes.plain_steps + 1].reshape(sizes.plain_steps + 1, -1).astype(np.float64))
    dynamics = tuple(dynamics_of(find_model("dvs128").circuit()).uniform()[:7])
    return logs, dynamics, sizes.plain_steps / (len(stimulus.t) - 1)


def _scalar_way(stimulus: Stimulus, sizes: Sizes):
    logs, dynamics, share = _states_only(stimulus, sizes)
    version = f"numba {versions()['numba']}" if "numba" in versions() else "numba"
    return Other("scalar kernel, states only", version, lambda: _scalar(logs, DT, dynamics), share), ""


def _numpy_way(stimulus: Stimulus, sizes: Sizes):
    logs, dynamics, share = _states_only(stimulus, sizes)
    return Other("NumPy, states only", f"numpy {np.__version__}", lambda: _numpy(logs, DT, dynamics), share), ""


def _esim_way(stimulus: Stimulus, sizes: Sizes):
    """evlib's ESIM on the same frames, without bandwidth limit or noise: less work, and times between frames linear."""
    found = importlib.util.find_spec("evlib")
    if found is None or not found.submodule_search_locations:
        return None, "evlib is not installed: no ESIM beside it (`pip install --target DIR evlib`, PYTHONPATH=DIR)"
    package = types.ModuleType("evlib_simulation")  # without the rest of evlib, which needs more packages
    package.__path__ = [str(Path(found.submodule_search_locations[0]) / "simulation")]
    sys.modules["evlib_simulation"] = package
    esim, config = (importlib.import_module(f"evlib_simulation.{name}") for name in ("esim", "config"))
    exported = export(find_model("dvs128"), "esim", Light(level=LEVEL)).parameters
    settings = config.ESIMConfig(
        positive_threshold=exported["contrast_threshold_pos"], negative_threshold=exported["contrast_threshold_neg"],
        refractory_period_ms=1e-6 * exported["refractory_period_ns"], log_floor=max(exported["log_eps"], 1e-9),
        device="cpu",
    )  # fmt: skip
    share = sizes.plain_steps / (len(stimulus.t) - 1)

    def work() -> None:
        camera = esim.ESIMSimulator(settings)
        for k in range(sizes.plain_steps + 1):
            camera.process_frame(stimulus.radiance[k], float(stimulus.t[k]))

    version = importlib.metadata.version("evlib")
    note = "ESIM has neither bandwidth limit nor noise; its first frames are timed"
    return Other("ESIM of evlib", version, work, share), note


def two_threads(sizes: Sizes) -> dict:
    """Wall time of two threads in turn with one; the CPU time that both take says what other processes cannot spoil."""
    model, stimulus = find_model("dvs128"), video(sizes.video)
    steps = (len(stimulus.t) - 1) * stimulus.radiance[0].size
    ways = {count: lambda count=count: simulate(model, stimulus, threads=count) for count in (1, 2)}
    cpu = interleaved({str(count): way for count, way in ways.items()}, sizes.runs)
    more = statistics.median(cpu["2"]) / statistics.median(cpu["1"])
    return compared(
        ways[2],
        Other("one thread", "", ways[1]),
        sizes.runs,
        size="{} × {} pixels × {} steps".format(*sizes.video),
        item=ITEM,
        items=steps,
        clock="wall",
        threads=2,
        target=Target("ratio", 1.8),
        words="tiles of pixels are independent; sorting events by time is not",
        note=f"CPU time of two threads over that of one: {more:.2f}",
        extra={"cpu_of_two_over_one": more},
    )


def streamed(sizes: Sizes) -> dict:
    """Peak memory of the processes that simulate a video as its frames come, one per length."""
    width, height = sizes.streamed
    points = [measured_apart("stream", [width, height, steps]) for steps in sizes.streamed_steps]
    peaks = [p["before_bytes"] + p["peak_bytes"] for p in points]
    frames = sizes.streamed_steps
    slope = (peaks[-1] - peaks[-2]) / (frames[-1] - frames[-2])
    return row(
        [points[-1]["cpu_s"]],
        size=f"{width} × {height} pixels × {', '.join(map(str, frames))} frames",
        item=ITEM,
        items=width * height * frames[-1],
        words="a block of frames at a time",
        note=f"peak memory of the whole process {', '.join(f'{p / 2**20:.0f}' for p in peaks)} MiB, Python and "
        f"compiled code included: {slope:.0f} bytes per frame more in the end, where a frame of float32 has "
        f"{4 * width * height}",
        extra={"peak_bytes": peaks, "frames": list(frames), "bytes_per_frame": slope},
    )


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
