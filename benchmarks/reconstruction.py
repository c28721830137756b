"""Ablations of the reconstruction on procedural scenes: PSNR of test views, one line per run.

    python benchmarks/reconstruction.py bandwidth --settings hard hard8 --seeds 0 1 2
    python benchmarks/reconstruction.py samples joint pixel effect scale --settings hard8 --seeds 0

bandwidth   on, off, and `ideal`: the same field trained on events of a camera without bandwidth limit; `ideal, no dead
            time`: and without dead time
baselines   on, off, the pixel of Robust e-NeRF (no bandwidth; thresholds, their ratio and dead time trained with the
            scene), and images of the events first, a field fitted to them then (`two_stage.py`)
samples     S of the past: 1, 5, 15, 30, 50
batch       a quarter and four times as many chains per step, as many in all
grid        speeds and illuminances of their own (--settings does not matter): on and off
joint       the filter trained with the scene from a start wrong by 3 in α and the source follower; the same start held
pixel       the camera differs from nominal by 2 in α and the source follower: true, nominal, fitted, and twice too fast
effect      a camera with 2 ms dead time: reconstructed with and without the effect
whole       cameras with more than the data sets' pixel (`CAMERAS`): everything known, only what the data set says, and
            what `--gap` finds in the events beside that
field       what the field is asked for, trained on `ideal` events: nothing, small total variation, and colour by
            harmonics of degree 1 and 2
size        200 × 200 pixels, on and off
paper       800 × 800 pixels, as the published scenes, one revolution: on and off, with the scores of the reference
            implementation beside the stricter ones
once        64 × 64 pixels, filmed once around as those are
memory      the same scene filmed again and again until there are 60 million events: peak memory of a short training
poses       a camera of changing speed whose poses are 5 ms late, or shaken: as they are, and refined with the scene
elsewhere   scenes of another make (`other_scenes.py`): on, off, and on with nothing asked of silence
unbounded   objects before others 20 times as far away (`other_scenes.far_away`): the usual box, one about all of it,
            and space contracted outside the usual one
pictures    no events: a field fitted to the posed pictures of --images, one in ten of them held out
scale       radiance unit pinned by the background, by the views' mean level, free, and free with the pixel trained
            under the prior of a fit

Scenes and fits are kept in --work and reused; results are appended to results.jsonl there, and printed as a table.
--device cuda trains on a GPU; these runs stand beside those of a CPU, with what they took of its memory.
docs/reconstruction.json is made by --save.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import shutil
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from many_events import filmed_again
from other_scenes import FAR, SCENES, far_away
from paths.memory import command_apart
from posed import DEGREE, ITERATIONS, grey_over_white, scene_of_images
from scipy.spatial.transform import Rotation
from two_stage import two_stage

from pixelid.demo.demo import calibration_session
from pixelid.fit import fit
from pixelid.model.model import Model
from pixelid.model.shipped import find_model
from pixelid.nerf.data.calibration import in_unit, of_fit
from pixelid.nerf.data.camera import Camera
from pixelid.nerf.data.dataset import Dataset, read_dataset
from pixelid.nerf.data.scenes import EXTENT, spiral
from pixelid.nerf.data.trajectory import Trajectory
from pixelid.nerf.data.views import OPENGL
from pixelid.nerf.options import Options
from pixelid.nerf.pixel.model import Bandwidth
from pixelid.nerf.reconstruct import reconstruct
from pixelid.nerf.shown.evaluate import ssim
from pixelid.nerf.synthetic import SETTINGS, Renders, Setting, camera_model, make_dataset
from pixelid.nerf.training.poses import Refinement
from pixelid.nerf.training.recipe import Recipe

EXPERIMENTS = (
    "bandwidth", "baselines", "samples", "batch", "grid", "joint", "pixel", "effect", "scale", "whole", "field",
    "poses", "size", "paper", "once", "memory", "elsewhere", "unbounded", "pictures",
)  # fmt: skip
KEPT = ("experiment", "setting", "arm", "seed", "iterations", "device")  # what tells runs apart
SAMPLES = (1, 5, 15, 30, 50)
BATCHES = (80, 320, 1280)  # chains per step
SPEEDS, WHITES = (0.5, 2.0, 8.0), (20.0, 200.0, 2_000.0)  # revolutions per second; fA at white
CAMERAS = {
    "clean": ({}, {}),
    "leak 5 Hz": ({"leak": {"rate_hz": 5.0}}, {}),
    "mismatch 10 %": ({}, {"threshold_mismatch.sigma": 0.1}),
    "leak 40 Hz, mismatch 10 %": ({"leak": {"rate_hz": 40.0}}, {"threshold_mismatch.sigma": 0.1}),
    "dead time 2 ms": ({}, {"refractory_s": 2e-3}),
    "drift 0.6/s": ({"threshold_drift": {"per_s": 0.6}}, {}),
    "hot pixels": ({"hot_pixels": {"rate_hz": 1000.0, "count": 40.0}}, {}),
    "bandwidth floor": ({"bandwidth_floor": {"radiance": 20.0}}, {}),
}  # effects with their values, and other values
FIELDS = {
    "nothing": (0.0, 0, 0.0),
    "total variation": (0.05, 0, 0.0),
    "degree 1": (0.05, 1, 10.0),
    "degree 1, held by 1": (0.05, 1, 1.0),
    "degree 1, held by 100": (0.05, 1, 100.0),
    "degree 1, no total variation": (0.0, 1, 10.0),
    "degree 2": (0.05, 2, 10.0),
    "degree 2, held by 100": (0.05, 2, 100.0),
}  # weight of the total variation, degree of the harmonics, weight of their mean square
ROBUST = ("threshold", "ratio", "refractory")  # trained by Robust e-NeRF with the scene
CUTOFFS = (0.0, 0.1, 0.3, 1.0)  # of the filter that makes images, per revolution
LATE_S, SWING, SHAKEN, SHAKEN_DEG = 5e-3, 0.7, 0.02, 0.5  # of experiment "poses"
LARGE_BATCH = 512  # chains per step for 200 × 200 pixels
PUBLISHED_SIDE, PUBLISHED_CELLS, PUBLISHED_BATCH = 800, 400, 1024
PUBLISHED_FILM = {"revolutions": 1.0, "frames_per_turn": 2400, "supersample": 1}
MANY_EVENTS, FEW_STEPS = 60_000_000, 60  # of experiment "memory"
SLOW = 0.5  # α and source follower of the camera that differs from nominal
CHANGED = ("alpha", "sf_cutoff_hz")


def dataset(
    work: Path, setting: str, seed: int, label: str = "", model: Model | None = None, side: int = 64,
    trajectory: Trajectory | None = None, own: Setting | None = None, scene: Renders | None = None, **film,
) -> Dataset:  # fmt: skip
    """A scene's dataset, made when it is not there yet.

    own: a setting that is not in `SETTINGS`;  film: how it is filmed, as of `make_dataset`
    """
    path = work / f"{setting}_{seed}{label}"
    if not path.is_dir():
        make_dataset(
            path, own or setting, seed=seed, model=model, side=side, trajectory=trajectory, scene=scene, **film
        )  # fmt: skip
    return read_dataset(path)


def fast_camera(setting: str) -> Model:
    """The same camera without bandwidth limit: dark current, mismatch, threshold noise and dead time stay."""
    limited, model = camera_model(SETTINGS[setting]), find_model("ideal")
    for effect in ("dark_current", "threshold_mismatch", "threshold_noise", "refractory_period"):
        model = model.with_effect(effect)
    return model.set({name: value for name, value in limited.values.items() if name in model.parameters})


def slow_camera(setting: str) -> Model:
    """A camera that differs from nominal by `SLOW` in α and the source follower."""
    model = camera_model(SETTINGS[setting])
    return model.set({name: SLOW * model.values[name] for name in CHANGED})


def swinging(duration_s: float, revolutions: float) -> Trajectory:
    """The usual spiral at a speed that changes by 70 %, five times per revolution: clocks that disagree then show."""
    even = spiral(duration_s, revolutions)
    share, cycles = even.t / even.t[-1], 5 * revolutions
    uneven = share + SWING * np.sin(2 * np.pi * cycles * share) / (2 * np.pi * cycles)
    return replace(even, t=even.t[-1] * uneven)


def shaken(trajectory: Trajectory, seed: int) -> Trajectory:
    """The trajectory with smooth errors, of rms `SHAKEN` in the scene's unit and `SHAKEN_DEG` per coordinate."""
    rng = np.random.default_rng(seed)
    share = trajectory.t[:, None] / trajectory.t[-1]

    def smooth() -> np.ndarray:
        error = np.zeros((len(share), 3))
        for waves in (1, 2, 3):
            error += rng.normal(size=3) * np.sin(2 * np.pi * waves * share + rng.uniform(0, 2 * np.pi, 3))
        return error / np.sqrt((error**2).mean())

    turned = Rotation.from_rotvec(np.radians(SHAKEN_DEG) * smooth()) * Rotation.from_quat(trajectory.orientation)
    return replace(trajectory, position=trajectory.position + SHAKEN * smooth(), orientation=turned.as_quat())


def fitted(work: Path, seed: int) -> Path:
    """The fit of a calibration session of that camera, its radiance in fA; α and follower unknown to the fit."""
    folder = work / f"fit_{seed}"
    if not folder.is_dir():
        truth = slow_camera("hard").without_effect("dark_current")
        result = fit(calibration_session(truth, seed), find_model("dvs128"), seed=seed)
        folder.mkdir()
        result.save(folder)
    return folder


def arms(name: str, work: Path, setting: str, seed: int, only: list[str] | None = None):
    """(arm, dataset or what makes it, options of `reconstruct`) of an experiment; only: no data sets for other arms."""

    def wanted(start: str) -> bool:
        return not only or any(arm.startswith(start) for arm in only)

    if name in ("bandwidth", "baselines", "samples", "batch", "joint"):
        data = dataset(work, setting, seed)
        circuit = data.calibration.circuit
    if name == "bandwidth":
        yield "on", data, {}
        yield "off", data, {"bandwidth": Bandwidth("off")}
        yield (
            "ideal",
            lambda: dataset(work, setting, seed, "_ideal", fast_camera(setting)),
            {"bandwidth": Bandwidth("off")},
        )
        tireless = fast_camera(setting).without_effect("refractory_period")
        yield (
            "ideal, no dead time",
            lambda: dataset(work, setting, seed, "_ideal_nodead", tireless),
            {"bandwidth": Bandwidth("off")},
        )
    elif name == "baselines":
        yield "on", data, {}
        yield "off", data, {"bandwidth": Bandwidth("off")}
        yield "Robust e-NeRF's pixel", data, {"bandwidth": Bandwidth("off", trained=ROBUST)}
        for turns in CUTOFFS:
            cutoff = 2 * math.pi * turns * SETTINGS[setting].revolutions_per_s
            yield f"two stages, {turns:g} per revolution", data, {"cutoff": cutoff}
    elif name == "samples":
        for samples in SAMPLES:
            yield f"S={samples}", data, {"bandwidth": Bandwidth("on", samples)}
        yield "off", data, {"bandwidth": Bandwidth("off")}
    elif name == "batch":
        for batch in BATCHES:
            steps = Recipe().iterations * Recipe().batch // batch
            yield f"{batch} chains", data, {"recipe": Recipe(batch=batch, iterations=steps)}
    elif name == "grid":
        for speed, white in itertools.product(SPEEDS, WHITES):
            cell = f"{speed:g} rev/s, {white:g} fA: "
            if not wanted(cell):
                continue
            data = dataset(work, "grid", seed, f"_{speed:g}_{white:g}", own=Setting(speed, white))
            for mode in ("on", "off"):
                yield cell + mode, data, {"bandwidth": Bandwidth(mode)}
    elif name == "joint":
        wrong = replace(data.calibration, circuit=circuit.with_(alpha=circuit.alpha * 3, follower=circuit.follower * 3))
        yield "joint from x3", data, {"calibration": wrong, "bandwidth": Bandwidth("joint")}
        yield "held at x3", data, {"calibration": wrong}
    elif name == "pixel":
        data = dataset(work, setting, seed, "_slow", slow_camera(setting))
        circuit = data.calibration.circuit  # nominal: the file quotes it
        true = in_unit(slow_camera(setting).circuit(), SETTINGS[setting].white_fa)
        yield "true", data, {"calibration": replace(data.calibration, circuit=true)}
        yield "fitted", data, {"calibration": of_fit(data.calibration, fitted(work, seed))}
        yield "nominal", data, {}
        double = circuit.with_(alpha=circuit.alpha * 2, follower=circuit.follower * 2)
        yield "2x nominal", data, {"calibration": replace(data.calibration, circuit=double)}
        yield "off", data, {"bandwidth": Bandwidth("off")}
    elif name == "effect":
        model = camera_model(SETTINGS[setting]).set({"refractory_s": 2e-3})
        data = dataset(work, setting, seed, "_dead", model)
        ignored = replace(data.calibration, circuit=data.calibration.circuit.with_(refractory=0.0))
        yield "dead time known", data, {}
        yield "dead time ignored", data, {"calibration": ignored}
    elif name == "whole":
        for camera, (effects, values) in CAMERAS.items():
            if not wanted(f"{camera}: "):
                continue
            model = camera_model(SETTINGS[setting]).set(values)
            for effect, its_values in effects.items():
                model = model.with_effect(effect, its_values)
            data = dataset(work, setting, seed, "_" + camera.replace(" ", "_").replace("/", "_"), model)
            circuit = in_unit(model.circuit(), SETTINGS[setting].white_fa).with_(dark=data.calibration.circuit.dark)
            yield f"{camera}: known", data, {"calibration": replace(data.calibration, circuit=circuit)}
            told = data.calibration.circuit.with_(refractory=camera_model(SETTINGS[setting]).values["refractory_s"])
            yield f"{camera}: ignored", data, {"calibration": replace(data.calibration, circuit=told)}
            yield f"{camera}: found", data, {"calibration": replace(data.calibration, circuit=told), "gap": True}
    elif name == "field":
        data, off = dataset(work, setting, seed, "_ideal", fast_camera(setting)), Bandwidth("off")
        for arm, (roughness, degree, stiffness) in FIELDS.items():
            recipe = Recipe(roughness=roughness, degree=degree, stiffness=stiffness)
            yield arm, data, {"bandwidth": off, "recipe": recipe}
    elif name == "poses":
        duration = 4.0 / SETTINGS[setting].revolutions_per_s
        data = dataset(work, setting, seed, "_swinging", trajectory=swinging(duration, 4.0))
        right = data.trajectory
        late, wrong = replace(right, t=right.t + LATE_S), shaken(right, seed)
        yield "right", data, {}
        yield "late", replace(data, trajectory=late), {}
        yield "late, refined", replace(data, trajectory=late), {"recipe": Recipe(refinement=Refinement(0.01))}
        refinement = Refinement.of(None, (SHAKEN, SHAKEN_DEG))
        yield "shaken", replace(data, trajectory=wrong), {}
        yield "shaken, refined", replace(data, trajectory=wrong), {"recipe": Recipe(refinement=refinement)}
    elif name == "size":
        data = dataset(work, setting, seed, "_200", side=200)
        for mode in ("on", "off"):
            yield mode, data, {"bandwidth": Bandwidth(mode), "recipe": Recipe(batch=LARGE_BATCH)}
    elif name == "paper":
        data = dataset(work, setting, seed, "_800", side=PUBLISHED_SIDE, **PUBLISHED_FILM)
        large = Recipe(batch=PUBLISHED_BATCH).with_cells(PUBLISHED_CELLS)
        for mode in ("on", "off"):
            yield mode, data, {"bandwidth": Bandwidth(mode), "recipe": large, "protocol": "paper"}
    elif name == "once":
        data = dataset(work, setting, seed, "_once", **PUBLISHED_FILM)
        for mode in ("on", "off"):
            yield mode, data, {"bandwidth": Bandwidth(mode), "protocol": "paper"}
    elif name == "elsewhere":
        for label, scene in SCENES.items():
            data = dataset(work, setting, seed, f"_{label}", scene=scene)
            yield f"{label}: on", data, {}
            yield f"{label}: off", data, {"bandwidth": Bandwidth("off")}
            yield f"{label}: on, silence not asked", data, {"recipe": Recipe(quiet=0.0)}
    elif name == "unbounded":
        data, side = dataset(work, setting, seed, "_far", scene=far_away(seed)), 1.3 * FAR * EXTENT
        yield "usual box", data, {}
        yield "large box", data, {"box": (-side, -side, -side, side, side, side)}
        yield "unbounded", data, {"recipe": Recipe(unbounded=True)}
    elif name == "scale":
        data = dataset(work, setting, seed)
        sharp = {"alpha": 0.01, "beta": 0.01, "gamma": 0.05, "follower": 0.02}
        yield "pinned", data, {}
        yield "level", data, {"scale": "level"}
        yield "free", data, {"scale": "free"}
        yield "free, joint with prior", data, {"scale": "free", "bandwidth": Bandwidth("joint", prior_sd=sharp)}


def run(
    name: str, work: Path, setting: str, seed: int, iterations: int | None, only: list[str] | None, device: str
) -> None:
    """Train every arm of an experiment and note what it reached."""
    if name == "memory":
        return memory(work, setting, seed)
    for arm, make, options in arms(name, work, setting, seed, only):
        if only and arm not in only:
            continue
        data = make() if callable(make) else make
        began, used = time.perf_counter(), time.process_time()
        row: dict = {"experiment": name, "setting": setting, "seed": seed, "arm": arm, "device": device}
        if "cutoff" in options:
            scores = two_stage(data, options["cutoff"], seed=seed)
            row |= {"iterations": ITERATIONS, "degree": DEGREE}
        else:
            chosen = options.pop("recipe", Recipe())
            chosen = replace(chosen, iterations=iterations) if iterations else chosen
            pixel = {name: options.pop(name) for name in ("bandwidth", "calibration") if name in options}
            result = reconstruct(data, Options(seed=seed, device=device, **options), recipe=chosen, **pixel)
            scores = result.scores
            row |= {
                "iterations": result.state.iteration, "degree": chosen.degree, "held_out": round(result.held_out, 4),
                "rays_per_second": round(result.content["rays_per_second"]), "pixel": result.state.pixel.values(),
                "found": [effect["name"] for effect in result.gap["effects"]] if result.gap else None,
                "poses": result.state.poses.as_dict(result.problem.time_resolution_s),
            }  # fmt: skip
            if device == "cuda":
                row["peak_gib"] = round(torch.cuda.max_memory_reserved() / 2**30, 2)
                torch.cuda.reset_peak_memory_stats()
            if result.published is not None:
                row["published_protocol_psnr"] = round(float(result.published.psnr.mean()), 3)
        note(work, row | {"psnr": scores.psnr.mean(), "ssim": scores.ssim.mean()}, began, used)


def memory(work: Path, setting: str, seed: int) -> None:
    """Peak memory of the command line's `reconstruct` on many events, as the system counts it."""
    once, source = dataset(work, setting, seed, "_200", side=200), work / f"{setting}_{seed}_many"
    shutil.rmtree(source, ignore_errors=True)
    events = filmed_again(once, MANY_EVENTS, source)
    began, used = time.perf_counter(), time.process_time()
    spent = command_apart([
        sys.executable, "-m", "pixelid", "reconstruct", str(source), "--out", str(work / "many"), "--overwrite",
        "--iterations", str(FEW_STEPS), "--seed", str(seed),
    ])  # fmt: skip
    views = json.loads((work / "many" / "reconstruction.json").read_text())["views"]
    row = {
        "experiment": "memory", "setting": setting, "seed": seed, "arm": f"{events / 1e6:.0f} million events",
        "device": "cpu",
        "iterations": FEW_STEPS, "degree": Recipe().degree, "peak_gib": round(spent["peak_bytes"] / 2**30, 2),
        "psnr": views["psnr"], "ssim": views["ssim"],
    }  # fmt: skip
    note(work, row, began, used - spent["cpu_s"])


def pictures(work: Path, images: Path, seeds: list[int]) -> None:
    """Fit a field to nine in ten posed pictures and compare it with the others."""
    with np.load(images) as file:
        shots, poses, focal = file["images"], file["poses"], float(file["focal"])
    held = np.arange(0, len(shots), 10)
    kept = np.setdiff1d(np.arange(len(shots)), held)
    height, width = shots.shape[1:3]
    intrinsics = np.array([[focal, 0, width / 2 - 0.5], [0, focal, height / 2 - 0.5], [0, 0, 1]])
    camera = Camera(intrinsics, width, height, np.empty(0))
    truth = grey_over_white(shots[held])
    for seed in seeds:
        began, used = time.perf_counter(), time.process_time()
        scene = scene_of_images(shots[kept], poses[kept], focal, seed=seed)
        shown = scene.render(camera, poses[held, :3, 3], poses[held, :3, :3] @ OPENGL)
        row = {
            "experiment": "pictures", "setting": f"{width} × {height}", "seed": seed, "arm": "direct fit",
            "device": "cpu", "iterations": ITERATIONS, "degree": DEGREE,
            "psnr": np.mean(10 * np.log10(1 / ((shown - truth) ** 2).mean(axis=(1, 2)))),
            "ssim": ssim(shown[..., None], truth[..., None], 1.0).mean(),
        }  # fmt: skip
        note(work, row, began, used)


def note(work: Path, row: dict, began: float, used: float) -> None:
    """Append a run to the results, and say it; began, used: clocks of wall and process before it [s]."""
    row["psnr"], row["ssim"] = round(float(row["psnr"]), 3), round(float(row["ssim"]), 4)
    row["seconds"] = round(time.perf_counter() - began, 1)
    row["cpu_seconds"] = round(time.process_time() - used, 1)
    with (work / "results.jsonl").open("a") as file:
        file.write(json.dumps(row) + "\n")
    print(
        f"{row['experiment']:10} {row['setting']:7} seed {row['seed']}  {row['arm']:22} {row['psnr']:6.2f} dB  "
        f"SSIM {row['ssim']:.3f}  {row['seconds']:5.0f} s wall, {row['cpu_seconds']:5.0f} s CPU",
        flush=True,
    )


def last_runs(work: Path) -> dict[tuple, dict[int, dict]]:
    """Per experiment, setting, arm, number of steps and device: the last run of every seed."""
    rows: dict = {}
    for line in (work / "results.jsonl").read_text().splitlines():
        row = json.loads(line)
        key = row["experiment"], row["setting"], row["arm"], row["iterations"], row["device"]
        rows.setdefault(key, {})[row["seed"]] = row
    return rows


def save(work: Path, path: Path) -> None:
    """Write the last runs, a line each, without what differs between computers; what was not run again stays."""
    names = (
        *KEPT, "psnr", "ssim", "cpu_seconds", "degree", "pixel", "found", "poses", "peak_gib",
        "published_protocol_psnr",
    )  # fmt: skip
    there = json.loads(path.read_text()) if path.is_file() else []
    new = [{name: row.get(name) for name in names} for seeds in last_runs(work).values() for row in seeds.values()]
    runs = {tuple(run[name] for name in KEPT): run for run in (*there, *new)}
    path.write_text("[\n" + ",\n".join(json.dumps(row) for row in runs.values()) + "\n]\n")


def table(work: Path) -> str:
    """Mean ± sd over seeds of every arm, as Markdown."""
    lines = [
        "| experiment | setting | arm | steps | device | PSNR [dB] | SSIM | seeds | CPU s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for (name, setting, arm, steps, device), seeds in last_runs(work).items():
        psnr = np.array([row["psnr"] for row in seeds.values()])
        spread = f" ± {psnr.std(ddof=1):.2f}" if len(psnr) > 1 else ""
        ssim = np.mean([row["ssim"] for row in seeds.values()])
        cpu = np.mean([row["cpu_seconds"] for row in seeds.values()])
        lines.append(
            f"| {name} | {setting} | {arm} | {steps} | {device} | {psnr.mean():.2f}{spread} | {ssim:.3f} | {len(psnr)} "
            f"| {cpu:.0f} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("experiments", nargs="*", choices=[*EXPERIMENTS, []], default=[])
    parser.add_argument("--settings", nargs="+", choices=list(SETTINGS), default=["hard"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--arms", nargs="+", help="only these")
    parser.add_argument("--iterations", type=int)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--images", type=Path, help="for pictures: npz of images, poses, focal")
    parser.add_argument("--save", type=Path, help="write all results of --work to a JSON file")
    parser.add_argument("--work", type=Path, default=Path("out/reconstruction"))
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    for name in options.experiments:
        if name == "pictures":
            pictures(options.work, options.images, options.seeds)
            continue
        for setting in options.settings:
            for seed in options.seeds:
                run(name, options.work, setting, seed, options.iterations, options.arms, options.device)
    if (options.work / "results.jsonl").is_file():
        print(table(options.work))
        if options.save:
            save(options.work, options.save)


if __name__ == "__main__":
    main()
