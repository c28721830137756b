"""Bench sessions as a laboratory has them, by a simulator that shares no code with the package.

A folder holds the camera's events of each recording and a photodiode's trace on a clock of its own, `NAME_light.csv`
(or `.npz`); `truth.json` says what is true.  Events come from `bench_pixel.py`, lights from `bench_lights.py`, files
from `bench_files.py`.

    make_session(folder, 7)                                   everything drawn
    make_session(folder, 7, fault="edge", effects={"leak": 2.0}, clock_ppm=0.0)
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.oracles.bench_files import EPOCH_US, SUFFIX, write_events, write_light
from tests.oracles.bench_lights import Light, make_light, sample
from tests.oracles.bench_pixel import Circuit, grid, thresholds, trajectory, walk

LEVELS_FA = 3, 24, 400
DURATION_S = {"steps": 0.8, "chirp": 0.8, "constant": 1.5, "slow": 1.0}  # in order of recording
STEP_S = {"steps": 1e-5, "chirp": 1e-5, "constant": 2e-5, "slow": 2e-5}  # crossings within 2 ns (test_bench_sessions)
LIGHT_START_S, MINUTE_US = 3.2, 60_000_000  # of the photodiode's clock; between recordings
# The DVS128 in fA: 1/s²/fA, 1/s, 1/s/fA, Hz, Hz.
NOMINAL = {"alpha": 61287.0, "beta": 1851.0, "gamma": 1 / 0.89, "sf_cutoff_hz": 3122.0, "diff_cutoff_hz": 16000.0}
STRENGTHS = {  # of effects, log-uniform: Hz, fA, Hz/fA, fA/Hz, s
    "leak": (0.3, 3.0),
    "I_dark": (0.8, 4.0),
    "par_leak": (0.002, 0.01),
    "shot": (3e-6, 5e-5),
    "jitter": (2e-6, 1e-5),
}
FIELD = {
    "leak": "leak_hz", "I_dark": "dark_fa", "par_leak": "leak_hz_per_fa", "shot": "shot_density", "jitter": "jitter_s",
}  # fmt: skip
UNITS = {  # header → factors, log-uniform, between the numbers in the file and fA
    "radiance_fA": (1.0, 1.0),
    "illuminance_lux": (0.01, 10.0),
    "voltage_V": (1e-4, 1e-2),
    "irradiance_W/m2": (1e-8, 1e-5),
}
FAULTS = "level", "light", "polarity", "edge"
ADDRESSES = (0, 0), (120, 80), (17, 201), (300, 5)


@dataclass(frozen=True)
class Plan:
    """What a session is; every field can be an option of `make_session`.

    `circuit` as an option is a dictionary of the fields to be replaced; `fault_size` is a factor or microseconds;
    `start` is "reset", all changes begin at 0 with the light, or "random", they begin anywhere between the thresholds.
    """

    circuit: Circuit
    effects: dict[str, float]
    form: str
    unit: str
    unit_factor: float
    clock_ppm: float
    gain_sd: float
    trace_noise: float
    trace_bits: int
    address: tuple[int, int]
    chirp_stop: float
    ramp: str
    fault: str
    fault_size: float
    start: str
    side: int = 5
    levels: tuple[float, ...] = LEVELS_FA
    durations: tuple[tuple[str, float], ...] = tuple(DURATION_S.items())
    light_step_s: float = 5e-5
    light_form: str = "csv"


def draw(seed: int, **options: Any) -> Plan:
    """The plan of a seed with some of it stated.  What is not stated is the same as without the statement."""
    rng = np.random.default_rng([seed, 1])

    def log_uniform(low, high):
        return math.exp(rng.uniform(math.log(low), math.log(high)))

    both = math.exp(rng.uniform(-0.5, 0.5))  # α and β fall together where the amplifier is slow
    factors = both, both * math.exp(rng.uniform(-0.1, 0.1)), *np.exp(rng.uniform(-0.2, 0.2, 3))
    values = {name: NOMINAL[name] * float(each) for name, each in zip(NOMINAL, factors, strict=True)}
    on, off = (float(each) for each in rng.uniform(0.17, 0.24, 2))
    circuit = Circuit(**values, on_threshold=on, off_threshold=off, refractory_s=rng.uniform(1e-4, 3e-4),
                      threshold_mismatch=0.03, threshold_sigma=0.04)  # fmt: skip
    chosen = rng.permutation(list(STRENGTHS))[: rng.choice(4, p=(0.35, 0.3, 0.2, 0.15))]
    strengths = {name: log_uniform(*limits) for name, limits in STRENGTHS.items()}
    unit = str(rng.choice(list(UNITS), p=(0.5, 0.2, 0.15, 0.15)))
    factor = {name: log_uniform(*limits) for name, limits in UNITS.items()}
    form = str(rng.choice(list(SUFFIX)))
    plan = Plan(
        circuit, {name: strengths[name] for name in STRENGTHS if name in chosen}, form, unit, 1.0,
        float(rng.uniform(-60, 60)), float(rng.choice([0.0, 0.03])), float(rng.choice([0.0, 0.003])),
        int(rng.choice([0, 12])), ADDRESSES[rng.integers(len(ADDRESSES))], log_uniform(1.0, 1.9),
        str(rng.choice(["corners", "smooth"])), "", 0.0, str(rng.choice(["reset", "random"])),
    )  # fmt: skip
    faulty, which = rng.uniform() < 0.5, rng.uniform()
    size = {"level": rng.uniform(1.3, 1.8) ** rng.choice([-1, 1]), "edge": rng.uniform(30, 80)}
    if options.get("fault") == "edge":
        options = {"form": "raw", **options}
    circuit = replace(circuit, **options.pop("circuit", {}))
    plan = replace(plan, circuit=circuit, **{k: v for k, v in options.items() if k != "fault"})
    possible = FAULTS if plan.form == "raw" else FAULTS[:-1]
    fault = options.get("fault", possible[int(which * len(possible))] if faulty else "")
    if fault and (fault not in FAULTS or (fault == "edge" and plan.form != "raw")):
        raise ValueError(f"no fault {fault!r} with form {plan.form!r}")
    disturbed = {FIELD[name]: strength for name, strength in plan.effects.items()}
    return replace(
        plan,
        circuit=replace(plan.circuit, **disturbed),
        unit_factor=options.get("unit_factor", factor[plan.unit]),
        fault=fault,
        fault_size=options.get("fault_size", float(size.get(fault, 0.0))),
    )


def make_session(folder: Path | str, seed: int, **options: Any) -> dict[str, Any]:
    """Write a session into `folder`; its truth, which is in `truth.json` too.

    Args:
        folder: made if it is absent.
        seed: of everything drawn.
        options: fields of `Plan` to be stated.
    """
    folder, plan = Path(folder), draw(seed, **options)
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([seed, 2])
    circuit, pixels = plan.circuit, plan.side**2
    own = thresholds(circuit, pixels, rng)
    gains = rng.standard_normal(pixels) * plan.gain_sd
    gains = np.exp(gains - gains.mean())  # the stated light is the mean over the field
    kinds = dict(plan.durations)
    names = {f"{kind}_{level:g}": (kind, level) for level in plan.levels for kind in kinds}
    wrong = _wrong(plan, list(names), rng)
    lights, recordings = {}, {}
    for k, (name, (kind, level)) in enumerate(names.items()):
        rng = np.random.default_rng([seed, 3, k])
        light = make_light(kind, level, kinds[kind], rng, plan.chirp_stop, plan.ramp)
        t = plan.light_step_s * np.arange(round(light.duration_s / plan.light_step_s))
        trace = sample(light, t, plan.trace_noise, plan.trace_bits, rng) * plan.unit_factor
        lights[name] = t, trace * (plan.fault_size if name in wrong and plan.fault == "level" else 1.0)
        start_us = rng.uniform(2e5, 9e5) + (0 if plan.form == "raw" else EPOCH_US + k * MINUTE_US)

        def clock(seconds, start_us=start_us):
            return np.floor(start_us + 1e6 * seconds * (1 + 1e-6 * plan.clock_ppm)).astype(np.int64)

        light = replace(light, duration_s=float(t[-1]))  # the camera records until the light's last sample
        seconds, which, signs = events(circuit, own, gains, light, STEP_S[kind], plan.start, rng)
        stamps = clock(seconds + circuit.jitter_s * rng.standard_normal(len(seconds)))
        order = np.argsort(stamps, kind="stable")
        edges = clock(t[[0, -1]])
        if plan.fault == "edge" and name in wrong:
            edges[wrong[name]] += round(plan.fault_size)
        p = (signs > 0) != (plan.fault == "polarity")
        x, y = plan.address[0] + which % plan.side, plan.address[1] + which // plan.side
        path = folder / f"{name}{SUFFIX[plan.form]}"
        write_events(path, plan.form, stamps[order], x[order], y[order], p[order].astype(np.uint8), edges)
        recordings[name] = {"events": len(stamps), "camera_at_light_zero_us": start_us, "light_s": light.duration_s}
    swapped = dict(zip(wrong, reversed(wrong), strict=True)) if plan.fault == "light" else {}
    for name in names:
        t, trace = lights[swapped.get(name, name)]
        path = folder / f"{name}_light.{plan.light_form}"
        write_light(path, plan.light_form, LIGHT_START_S + t, trace, plan.unit)
    truth = _truth(plan, own, recordings, wrong)
    (folder / "truth.json").write_text(json.dumps(truth, indent=1))
    return truth


def events(
    circuit: Circuit, own: np.ndarray, gains: np.ndarray, light: Light, step_s: float, start: str,
    rng: np.random.Generator,
):  # fmt: skip
    """(times s, pixels, signs ±1) of all pixels in order of time; own: (n, 2) thresholds, gains: (n,) of the light."""
    steps = grid(light.of, light.corners, light.duration_s, min(step_s, 1e-5) if circuit.shot_density else step_s)
    alike = np.all(gains == 1.0) and circuit.shot_density == 0
    path = trajectory(circuit, steps) if alike else None
    most = int(light.duration_s / circuit.refractory_s) + 2
    times, which, signs = [], [], []
    for i, (mine, gain) in enumerate(zip(own, gains, strict=True)):
        draws = 1.0 + circuit.threshold_sigma * rng.standard_normal((most, 2))
        begin = rng.uniform() if start == "random" else None
        seen = path or trajectory(circuit, steps, gain, rng)
        t, p = walk(circuit, steps, seen, mine, draws, begin)
        times.append(t)
        which.append(np.full(len(t), i))
        signs.append(p)
    t = np.concatenate(times)
    order = np.argsort(t, kind="stable")
    return t[order], np.concatenate(which)[order], np.concatenate(signs)[order]


def _wrong(plan: Plan, names: list[str], rng: np.random.Generator) -> dict[str, int]:
    """Recordings with the wrong statement → which of two edges is late.

    A wrong level shows where the bandwidth does, in chirps and steps; a constant light may be any other constant one.
    """
    changing = [name for name in names if not name.startswith("constant")]
    fast = [name for name in changing if not name.startswith("slow")]
    possible, count = {
        "": ([], 0), "level": (fast, 1), "light": (changing, 2), "polarity": (names, len(names)), "edge": (names, 1),
    }[plan.fault]  # fmt: skip
    order, edge = rng.permutation(len(possible))[:count], int(rng.integers(2))
    return {possible[i]: edge for i in order}


def _truth(plan: Plan, own: np.ndarray, recordings: dict[str, Any], wrong: dict[str, int]) -> dict[str, Any]:
    circuit = {k: float(v) for k, v in asdict(plan.circuit).items() if k not in FIELD.values()}
    rest = {f.name: getattr(plan, f.name) for f in fields(plan) if f.name not in ("circuit", "effects", "durations")}
    return {
        "events": sum(each["events"] for each in recordings.values()),
        "pixels": len(own),
        **circuit,
        "thresholds_of_pixels": own.mean(axis=0).tolist(),
        "effects": plan.effects,
        **rest,
        "fault_recordings": sorted(wrong),
        "recordings": recordings,
    }
