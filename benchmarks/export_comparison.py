"""Other simulators, run with parameters of `pixelid export`, beside `pixelid simulate` of the same circuit.

    python benchmarks/export_comparison.py --v2e DIR --iebcs DIR --dvs-voltmeter DIR --deblur-e-nerf DIR --evlib DIR

Each DIR is a checkout of that simulator (evlib: the folder `evlib` of its wheel); those left out are left out.  All
pixels see a step up, a step down and a sine of the light.  Events and first latencies go to
docs/results/export_comparison.json.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import json
import math
import sys
import types
from collections.abc import Iterable
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np

from pixelid.export.export import export
from pixelid.export.light import Light
from pixelid.model.shipped import find_model
from pixelid.provenance import versions
from pixelid.simulate import simulate
from pixelid.stimuli.stimulus import Stimulus

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results" / "export_comparison.json"
SIDE, STEP_S, DURATION_S = 5, 5e-5, 1.2
UP_S, DOWN_S, SINE_S = 0.2, 0.5, 0.7  # when the light doubles, halves, and begins to swing
LEVEL, SINE_HZ, SINE_LN = 100.0, 20.0, 0.7
SEED = 7
DISPLAYS = ("cv2", "screeninfo", "easygui", "plyer", "engineering_notation", "dv_processing", "dv", "gooey", "tqdm")
CIRCUITS = {
    "dvs128": lambda: find_model("dvs128").with_effect("leak", {"rate_hz": 2.0}),
    "one pole": lambda: find_model("dvs128_low_light")
    .without_effect("source_follower_pole").without_effect("differencing_pole").without_effect("refractory_period")
    .without_effect("threshold_noise").with_effect("bandwidth_floor", {"radiance": 20.0})
    .with_effect("leak", {"rate_hz": 2.0}),
    "no bandwidth limit": lambda: find_model("ideal").with_effect("leak", {"rate_hz": 2.0}),
}  # fmt: skip


def light() -> tuple[np.ndarray, np.ndarray]:
    """(times [s], radiance): steps of a factor of two, then a sine of ln L."""
    t = np.arange(round(DURATION_S / STEP_S) + 1) * STEP_S
    u = np.where((t >= UP_S) & (t < DOWN_S), math.log(2.0), 0.0)
    u = np.where(t >= SINE_S, SINE_LN * np.sin(2 * math.pi * SINE_HZ * (t - SINE_S)), u)
    return t, LEVEL * np.exp(u)


def summary(t: np.ndarray, x: np.ndarray, y: np.ndarray, on: np.ndarray) -> dict:
    """Events per pixel of each part, and the median of pixels' first events after each step."""
    pixel = np.asarray(x).astype(int) + SIDE * np.asarray(y).astype(int)
    t, on = np.asarray(t, float), np.asarray(on).astype(bool)
    told = {}
    for name, begin, end in (("steps", 0.0, SINE_S), ("sine", SINE_S, DURATION_S + 1.0)):
        part = (t > begin) & (t <= end)
        told[f"on_{name}"] = float(np.count_nonzero(part & on)) / SIDE**2
        told[f"off_{name}"] = float(np.count_nonzero(part & ~on)) / SIDE**2
    for name, begin, end, polarity in (("up", UP_S, DOWN_S, True), ("down", DOWN_S, SINE_S, False)):
        part = (t >= begin) & (t < end) & (on == polarity)
        first = [t[part & (pixel == k)].min() - begin for k in range(SIDE**2) if (part & (pixel == k)).any()]
        told[f"latency_{name}_ms"] = 1e3 * float(np.median(first)) if first else None
    return told


def of_pixelid(model) -> dict:
    t, radiance = light()
    e = simulate(
        model, Stimulus.from_arrays(t, radiance, "relative"), width=SIDE, height=SIDE, seed=SEED, synchronous=True
    ).events
    return summary(e.t * 1e-9, e.pixel % SIDE, e.pixel // SIDE, e.p == 1)


def frames():
    t, radiance = light()
    for when, value in zip(t, radiance, strict=True):
        yield float(when), np.full((SIDE, SIDE), value)


def columns(chunks: list[np.ndarray]) -> np.ndarray:
    return np.concatenate(chunks) if chunks else np.zeros((0, 4))


def of_v2e(folder: Path, p: dict) -> dict:
    sys.path.insert(0, str(folder))
    for name in ("ae_text_output", "aedat2_output", "aedat4_output"):
        sys.modules[f"v2ecore.output.{name}"] = MagicMock()
    sys.modules["v2ecore.v2e_utils"] = MagicMock()
    import logging

    logging.disable(logging.WARNING)
    emulator = importlib.import_module("v2ecore.emulator")
    camera = emulator.EventEmulator(
        pos_thres=p["pos_thres"], neg_thres=p["neg_thres"], sigma_thres=p["sigma_thres"], cutoff_hz=p["cutoff_hz"],
        leak_rate_hz=p["leak_rate_hz"], refractory_period_s=p["refractory_period"],
        shot_noise_rate_hz=p["shot_noise_rate_hz"],
        leak_jitter_fraction=p["leak_jitter_fraction"], noise_rate_cov_decades=p["noise_rate_cov_decades"], seed=SEED,
        device="cpu", output_width=SIDE, output_height=SIDE,
    )  # fmt: skip
    found = [camera.generate_events(frame, when) for when, frame in frames()]
    e = columns([c for c in found if c is not None])
    return summary(e[:, 0], e[:, 1], e[:, 2], e[:, 3] > 0)


def of_iebcs(folder: Path, p: dict) -> dict:
    sys.path.insert(0, str(folder / "src"))
    sensor = importlib.import_module("dvs_sensor")
    np.random.seed(SEED)  # noqa: NPY002 (what the simulator draws from)
    camera = sensor.DvsSensor("exported")
    camera.initCamera(SIDE, SIDE, **{**p, "tau": max(p["tau"], 1e-6)})
    t, x, y, polarity = [], [], [], []
    for k, (_, frame) in enumerate(frames()):
        if k == 0:
            camera.init_image(frame)
            continue
        e = camera.update(frame, round(1e6 * STEP_S))
        n = e.i
        for column, values in ((t, e.ts * 1e-6), (x, e.x), (y, e.y), (polarity, e.p)):
            column.append(values[:n])
    return summary(np.concatenate(t), np.concatenate(x), np.concatenate(y), np.concatenate(polarity) == 1)


def of_dvs_voltmeter(folder: Path, p: dict) -> dict:
    import torch

    package = types.ModuleType("voltmeter")
    package.__path__ = [str(folder / "src")]
    sys.modules["voltmeter"] = package
    simulator = importlib.import_module("voltmeter.simulator")
    torch.manual_seed(SEED)
    cfg = types.SimpleNamespace(SENSOR=types.SimpleNamespace(K=[p[f"k{i}"] for i in range(1, 7)]))
    camera = simulator.EventSim(cfg=cfg, output_folder=".", video_name="exported")
    found = [camera.generate_events(frame, round(1e6 * when)) for when, frame in frames()]
    e = columns([c for c in found if c is not None])
    return summary(e[:, 0] * 1e-6, e[:, 1], e[:, 2], e[:, 3] == 1)


def events_of_evlib(folder: Path, p: dict, seen: Iterable[tuple[float, np.ndarray]]) -> np.ndarray:
    """(n, 4) x, y, time [s] and polarity of evlib's ESIM that sees (time [s], frame) of radiance."""
    package = types.ModuleType("evlib_simulation")
    package.__path__ = [str(folder / "simulation")]
    sys.modules["evlib_simulation"] = package
    esim, config = (importlib.import_module(f"evlib_simulation.{name}") for name in ("esim", "config"))
    camera = esim.ESIMSimulator(
        config.ESIMConfig(
            positive_threshold=p["contrast_threshold_pos"], negative_threshold=p["contrast_threshold_neg"],
            refractory_period_ms=1e-6 * p["refractory_period_ns"], log_floor=max(p["log_eps"], 1e-9), device="cpu",
        )
    )  # fmt: skip
    found = [np.stack(camera.process_frame(frame, when), axis=1) for when, frame in seen]
    return columns([c for c in found if len(c)])


def of_evlib(folder: Path, p: dict) -> dict:
    e = events_of_evlib(folder, p, frames())
    return summary(e[:, 2], e[:, 0], e[:, 1], e[:, 3] > 0)


def filter_of_deblur_e_nerf(folder: Path, model) -> float:
    """Difference in ln of its pixel filter and our trajectory at the end of 0.1 s of a sine, same samples."""
    import torch

    from pixelid.dynamics.of_circuit import dynamics_of
    from pixelid.dynamics.trajectory import integrate
    from pixelid.nerf.data.calibration import CIRCUIT, COMPARATOR  # the keys of the file

    torch.set_default_dtype(torch.float64)
    exported = export(model, "deblur-e-nerf", Light(level=LEVEL)).parameters
    assert set(exported) == {*CIRCUIT, *COMPARATOR}
    arrays = {name: np.array(value, dtype=np.float64) for name, value in exported.items()}
    for name, path in (("denerf", folder / "deblur_e_nerf"), ("denerf.models", folder / "deblur_e_nerf" / "models"),
                       ("denerf.utils", folder / "deblur_e_nerf" / "utils")):  # fmt: skip
        sys.modules[name] = types.ModuleType(name)
        sys.modules[name].__path__ = [str(path)]
    datasets = types.SimpleNamespace(Event=types.SimpleNamespace(load_camera_calibration=lambda folder: arrays))
    data = types.ModuleType("denerf.data")
    vars(data)["datasets"] = datasets
    sys.modules["denerf.data"] = data
    bandwidth = importlib.import_module("denerf.models.pixel_bandwidth")
    theirs = bandwidth.PixelBandwidth(".", 0, 1.0, types.SimpleNamespace(max_sample_lifetime=0.95))
    n = 400
    t = np.arange(n) * 2.5e-4
    radiance = LEVEL * np.exp(0.7 * np.sin(2 * math.pi * 20.0 * t))
    intensity = torch.from_numpy(radiance / 255.0)
    steps = torch.full((n - 1,), 2.5e5)
    weight = theirs.intensity_sample_to_weight(intensity, steps)
    out = float((weight.squeeze() * intensity.log()).sum() / weight.sum()) + math.log(255.0)
    ours = integrate(t, radiance, dynamics_of(model.circuit()), linearisation="newer")
    return abs(out - float(ours.stage("differencing")[-1]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    runs = {"v2e": of_v2e, "iebcs": of_iebcs, "dvs-voltmeter": of_dvs_voltmeter, "evlib": of_evlib}
    for name in (*runs, "deblur-e-nerf"):
        parser.add_argument(f"--{name}", type=Path)
    folders = vars(parser.parse_args())
    for name in DISPLAYS:  # what only shows pictures and progress may be missing
        if importlib.util.find_spec(name) is None:
            sys.modules[name] = MagicMock()
    settings = {"level": LEVEL, "sine_hz": SINE_HZ, "sine_ln": SINE_LN, "frame_s": STEP_S}
    content: dict = {"versions": versions(), "light": settings, "runs": [], "filter": None}
    for circuit, make in CIRCUITS.items():
        model = make()
        ours = of_pixelid(model)
        for name, run in runs.items():
            folder = folders[name.replace("-", "_")]
            if folder is None or (name == "iebcs" and model.photoreceptor == "unlimited"):
                continue  # without delays IEBCS never leaves its loop
            to = "esim" if name == "evlib" else name
            exported = export(model, to, Light(level=LEVEL))
            theirs = run(folder, exported.parameters)
            content["runs"].append({"simulator": name, "circuit": circuit, "theirs": theirs, "ours": ours})
            print(name, circuit, theirs, ours, flush=True)
            RESULTS.write_text(json.dumps(content, indent=1) + "\n")
    if folders["deblur_e_nerf"] is not None:
        apart = filter_of_deblur_e_nerf(folders["deblur_e_nerf"], CIRCUITS["dvs128"]())
        content["filter"] = {"difference_ln": apart}
        print(content["filter"])
    RESULTS.write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    main()
