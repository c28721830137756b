"""From a dataset to a scene: train, evaluate, write."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch

from pixelid.errors import InputError
from pixelid.nerf import checkpoint, parallel
from pixelid.nerf.beside import Beside
from pixelid.nerf.calibration import CIRCUIT, Calibration, of_fit, uncertainty_of_fit, unexplained_by
from pixelid.nerf.dataset import CALIBRATION, Dataset, evaluation_views, write_poses
from pixelid.nerf.evaluate import Scores, evaluate, evaluate_as_published, no_scores, render_views
from pixelid.nerf.given import one_of
from pixelid.nerf.ignored import forgotten, ignored_effects
from pixelid.nerf.judged import keep_best, train_judged
from pixelid.nerf.pixel import FILTER, Bandwidth
from pixelid.nerf.pixel_maps import maps_of_sensor
from pixelid.nerf.preview import refuse_preview, write_preview
from pixelid.nerf.problem import HELD_OUT, problem_of
from pixelid.nerf.recipe import Recipe
from pixelid.nerf.residuals import Left, left_by
from pixelid.nerf.saved import SavedReconstruction, write_field
from pixelid.nerf.search import HELD_OUT as SEARCH_HELD_OUT
from pixelid.nerf.search import hot_pixels, search
from pixelid.nerf.state import Problem, State, start
from pixelid.nerf.train import held_out_residual
from pixelid.nerf.views import Views
from pixelid.parallel import memory_bytes
from pixelid.provenance import input_hashes, versions
from pixelid.results import Result, Table
from pixelid.status import Status

LEARNED = 0.9  # share of held-out changes left unexplained, above which the field explains too little
# Standard deviations of a fit from which on a trained threshold contradicts it: the scene's contrast, which events tell
# from a threshold hardly, has taken it along
MOST_FAR = 5.0
RESIDUALS = "residuals.npz"
DEVICES, PROTOCOLS = ("auto", "cpu", "cuda"), ("strict", "paper")
LOOKS = 10  # running PSNR, per run
SAVE_EVERY, SAVE_AFTER_S = 100, 30.0  # steps between checkpoints; sooner where steps take long


@dataclass(frozen=True, repr=False)
class Reconstruction(Result):
    """A reconstructed scene and how well it can be trusted.

    status: how it ended;  scores: of the test views, NaN when it diverged;  held_out: share of held-out changes left
    unexplained;  truth: the test views;  ignored: what is known of the pixel and the reconstruction does not model;
    published: scores by the reference implementation's protocol, on request;  gap: effects found in the events, on
    request (`search.Found.as_dict`);  recipe: how it was trained;  beside: another scene of the same data;  left: what
    events say beyond the scene in the end, where effects were looked for
    """

    FILE: ClassVar[str] = "reconstruction.json"

    status: Status
    advice: str
    bandwidth: Bandwidth
    state: State
    problem: Problem
    recipe: Recipe
    scores: Scores
    truth: Views
    held_out: float
    seconds: float
    rays_per_second: float
    device: str
    seed: int
    inputs: Mapping[str, str]
    ignored: tuple[str, ...] = ()
    published: Scores | None = None
    gap: Mapping[str, Any] | None = None
    beside: Beside | None = None
    left: Left | None = None

    def as_dict(self) -> dict:
        """The content of reconstruction.json (docs/formats.md)."""
        correction = self.scores.correction
        one = len(correction.a) == 1
        return {
            "status": self.status,
            "advice": self.advice,
            "bandwidth": self.bandwidth.mode,
            "ignored": list(self.ignored),
            "unidentified": _left_open(self.problem, self.state),
            "gap": {**self.gap, "final": self.left.as_dict() if self.left else None} if self.gap else None,
            "beside": None if self.beside is None else self.beside.as_dict(),
            "views": self.scores.as_dict(self.truth),
            "log_eps": self.truth.log_eps,
            "correction": {
                name: float(value[0]) if one else value.tolist()
                for name, value in (("a", correction.a), ("b", correction.b), ("c", correction.c))
            },
            "published_protocol": self.published.means() if self.published is not None else None,
            "lpips_note": "" if self.scores.lpips is not None else "LPIPS or its weights are not installed",
            "iterations": self.state.iteration,
            "seconds": self.seconds,
            "device": self.device,
            "rays_per_second": self.rays_per_second,
            "samples": self.bandwidth.samples,
            "recipe": self.recipe.as_dict(),
            "held_out_residual": self.held_out,
            "stopping": self.state.stopping.as_dict(self.state.iteration, diverged=not self.state.finite),
            "regularisation": self.state.regularisation.as_dict(),
            "gauge": {"kind": self.problem.gauge.kind, "background": self.problem.gauge.background},
            "box": {"low": self.problem.low, "high": self.problem.high, "near": self.problem.near},
            "pixel": {
                **dict.fromkeys(FILTER),
                **self.problem.values(self.state.pixel),
                "differencing": self.problem.circuit.differencing,
                "dark": self.problem.dark,
            },
            "pixels": self.problem.pixels_as_dict(self.state.pixel),
            "poses": self.state.poses.as_dict(self.problem.time_resolution_s),
            "history": self.state.history,
            "seed": self.seed,
            "versions": versions(),
            "inputs_sha256": dict(self.inputs),
        }

    @property
    def _saved(self) -> SavedReconstruction:
        return SavedReconstruction(self.as_dict(), self.state.field)

    @property
    def headline(self) -> str:
        """Status and scores."""
        return self._saved.headline

    def tables(self) -> list[Table]:
        """Scores of every test view."""
        return self._saved.tables()

    def records(self) -> list[dict]:
        """One row per test view."""
        return self._saved.records()

    def sentences(self) -> list[str]:
        """Advice, and what the pixel has but the reconstruction does not model."""
        return self._saved.sentences()

    def write_companions(self, folder: Path) -> None:
        """Write field.npz, the scene, camera_poses.npz where poses were refined, and residuals.npz after `gap`."""
        write_field(self.state.field, folder)
        if self.left:
            np.savez_compressed(folder / RESIDUALS, on=self.left.on, off=self.left.off, rms=self.left.rms)
        if self.state.poses.trained:
            write_poses(folder, self.state.poses.refined())

    @staticmethod
    def load(folder: str | Path) -> SavedReconstruction:
        """The scene and the scores of a folder; the data that it was trained on are not there.

        Args:
            folder: that `save` or `pixelid reconstruct` wrote.

        Returns:
            What the folder holds.

        Raises:
            InputError: no reconstruction there, a damaged one, or one that diverged.
        """
        return SavedReconstruction.load(folder)


def reconstruct(
    dataset: Dataset,
    *,
    fit: Path | None = None,
    sensor: Path | None = None,
    calibration: Calibration | None = None,
    bandwidth: Bandwidth | None = None,
    recipe: Recipe | None = None,
    background: float | None = None,
    scale: str = "auto",
    box: tuple[float, ...] | None = None,
    near: float = 0.0,
    radiance_scale: float | None = None,
    protocol: str = "strict",
    gap: bool = False,
    beside: Path | None = None,
    resume: Path | None = None,
    preview: Path | None = None,
    overwrite: bool = False,
    device: str = "auto",
    seed: int = 0,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Reconstruction:
    """Reconstruct the scene of a dataset.

    Under `torchrun` every process takes its share of each batch; all return the same.

    Args:
        dataset: as read.
        fit: folder of a fit or a search for the gap (or a model file) whose pixel replaces the dataset's.
        sensor: folder of `pixelid sensor`, whose maps say how the pixels differ.
        calibration: another pixel altogether.
        bandwidth: the pixel's filter, known, ignored or trained.
        recipe: of the training.
        background: radiance behind the scene; by default what the views show.
        scale: what pins the radiance unit: "auto", "level" or "free" (see `gauge`).
        box: corners of the scene, x0 y0 z0 x1 y1 z1; by default a cube where the camera looks.
        near: distance from the camera before which nothing is, in the unit of the poses.
        radiance_scale: the fit's radiance units per unit of the views.
        protocol: of the scores: "strict", or "paper" for those of the reference implementation with them.
        gap: look in the events for effects that the pixel lacks, and train with those found (`search`).
        beside: folder of another reconstruction of the dataset, shown with this one.
        resume: a checkpoint, continued when it exists and written as training goes on.
        preview: a PNG of the scene, replaced as training goes on.
        overwrite: whether the preview may replace another picture.
        device: "cpu", "cuda" or "auto".
        seed: of everything random.
        progress: called with what is done and the fraction.

    Returns:
        The scene, with the scores of its test views.

    Raises:
        InputError: input that cannot be used.
    """
    watch = time.perf_counter()
    bandwidth = Bandwidth() if bandwidth is None else bandwidth
    one_of("device", device, DEVICES)
    one_of("protocol", protocol, PROTOCOLS)
    if preview is not None:
        refuse_preview(Path(preview), overwrite)
    other = None if beside is None else Beside.read(beside, dataset.files)
    recipe = replace(Recipe() if recipe is None else recipe, seed=seed).for_sensor(dataset.calibration.camera.width)
    device = ("cuda" if torch.cuda.is_available() else "cpu") if device == "auto" else device
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device cuda: no CUDA device is available")
    if radiance_scale is not None and fit is None:
        raise InputError("--radiance-scale: relates the unit of --fit to that of the views; needs --fit")
    if calibration is None:
        calibration = of_fit(dataset.calibration, fit, radiance_scale) if fit else dataset.calibration
    if bandwidth.mode != "off" and not calibration.known:
        raise InputError(
            f"{dataset.path / CALIBRATION}: {CIRCUIT[0]}: missing, like all circuit constants; give the pixel by "
            "--fit, or --bandwidth off"
        )
    # of what is asked for: what the gap asks for departs from the fit
    if fit and bandwidth.moving and bandwidth.prior_sd is None:
        told = {name: sd for name, sd in uncertainty_of_fit(Path(fit)).items() if name in bandwidth.moving}
        bandwidth = replace(bandwidth, prior_sd=told or None)
    if recipe.between_poses == "cubic":
        dataset = replace(dataset, trajectory=dataset.trajectory.splined())
    maps = maps_of_sensor(Path(sensor), calibration.circuit, calibration.camera) if sensor else None
    cells = recipe.cells

    def make(of: Calibration, trained: tuple[str, ...], held_out: float = HELD_OUT) -> Problem:
        return problem_of(
            dataset, of, trained=trained, background=background, scale=scale, box=box, near=near, maps=maps,
            cells=cells, held_out=held_out, seed=seed,
        )  # fmt: skip

    problem = make(calibration, bandwidth.moving)
    parallel.join(device)
    memory = torch.cuda.get_device_properties(0).total_memory if device == "cuda" else memory_bytes()
    memory = int(parallel.agreed(np.array([memory]))[0])  # processes may have other computers, and need one recipe
    past = bandwidth.samples if bandwidth.mode != "off" else 1
    recipe = recipe.for_data(len(problem.training.starts), past, memory)
    files = [*dataset.files, *([Path(fit) / "model.toml" if Path(fit).is_dir() else Path(fit)] if fit else [])]
    files += [Path(sensor) / name for name in ("sensor.json", "maps.npz")] if sensor else []
    inputs = input_hashes(files)
    validation, test = evaluation_views(dataset)
    mark = checkpoint.run_identity(problem, recipe, bandwidth, inputs)
    found: Mapping[str, Any] | None = None
    if gap:
        kept = checkpoint.search_file(Path(resume)) if resume is not None else None
        outcome = checkpoint.load_search(kept, calibration, mark) if kept else None
        if outcome is None:
            result = search(
                calibration, bandwidth, recipe, lambda of, trained: make(of, trained, SEARCH_HELD_OUT),
                mapped=maps is not None, score=lambda state: _psnr(_running(state, problem, validation)), device=device,
                progress=lambda what, share: progress(what, 0.5 * share),
            )  # fmt: skip
            outcome = result.calibration, result.trained, result.as_dict()
            if kept and parallel.rank() == 0:
                checkpoint.save_search(kept, calibration, *outcome, mark)
        calibration, trained, found = outcome
        bandwidth = replace(bandwidth, trained=(*bandwidth.trained, *trained))
        problem = make(calibration, bandwidth.moving)
        if hot := hot_pixels(problem):
            found = {**found, "effects": [*found["effects"], hot]}
        mark = checkpoint.run_identity(problem, recipe, bandwidth, inputs)
    ignored = (*ignored_effects(problem.circuit), *(maps.unused if maps else ()), *unexplained_by(fit))
    if bandwidth.mode != "off":
        ignored += forgotten(problem.circuit, problem.training)
    if problem.circuit.refractory < calibration.circuit.refractory:
        ignored += (f"a dead time beyond {problem.circuit.refractory:.3g} s, for intervals between events are shorter",)
    state = None
    if resume is not None and Path(resume).exists():
        state = checkpoint.load(Path(resume), problem, recipe, bandwidth, mark, device)
    state = start(problem, recipe, bandwidth, device) if state is None else state
    if maps is not None and not state.pixel.filtering:
        ignored += maps.filters
    earlier, begun = state.seconds, time.perf_counter()
    saved = begun

    def report(now: State, measured: dict[str, float]) -> None:
        nonlocal saved
        now.seconds = earlier + time.perf_counter() - begun
        rate = now.rays * parallel.world() / max(now.seconds, 1e-9)
        if now.iteration % max(recipe.iterations // LOOKS, 1) == 0:
            seen = _running(now, problem, validation)
            entry = {"iteration": now.iteration, **measured, "rays_per_second": rate, "running_psnr": _psnr(seen)}
            now.history.append({name: float(value) for name, value in entry.items()})
            if preview is not None and parallel.rank() == 0:
                write_preview(Path(preview), problem, now, seen, validation)
        last = now.history[-1]["running_psnr"] if now.history else float("nan")
        words = f"loss {measured['loss']:.3f}, {rate / 1e3:.0f}k rays/s, {last:.1f} dB"
        done = 0.95 * now.iteration / recipe.iterations
        progress(words, 0.5 + 0.5 * done if gap else done)
        due = now.iteration % SAVE_EVERY == 0 or time.perf_counter() - saved > SAVE_AFTER_S
        if resume is not None and parallel.rank() == 0 and due and now.finite:
            checkpoint.save(Path(resume), now, mark)
            saved = time.perf_counter()

    train_judged(problem, recipe, state, report=report)
    state.seconds = earlier + time.perf_counter() - begun
    rate = state.rays * parallel.world() / max(state.seconds, 1e-9)
    finite = state.finite
    if resume is not None and parallel.rank() == 0 and finite:
        checkpoint.save(Path(resume), state, mark)
    keep_best(state)
    if preview is not None and parallel.rank() == 0:
        write_preview(Path(preview), problem, state, _running(state, problem, validation), validation)
    progress("evaluating", 0.95)
    scores = evaluate(state.field, validation, test, problem.dark) if finite else no_scores(test)
    published = evaluate_as_published(state.field, test, problem.dark) if finite and protocol == "paper" else None
    held_out = held_out_residual(problem, state) if finite else float("nan")
    told = np.isfinite(held_out) or not len(problem.held_out.starts)
    finite, far = finite and bool(told), state.pixel.thresholds_from_told()
    left = left_by(problem, state) if finite and found is not None else None
    status, advice = _verdict(held_out, scores, state.iteration, finite, far, _left_open(problem, state))
    return Reconstruction(
        status, advice, bandwidth, state, problem, recipe, scores, test, held_out,
        earlier + time.perf_counter() - watch, rate, device, seed, inputs, ignored, published, found, other, left,
    )  # fmt: skip


def _running(state: State, problem: Problem, validation: Views) -> Scores | None:
    """Scores of one validation view, corrected on another (or on itself when it is alone)."""
    if not state.finite or len(validation) == 0:
        return None
    first, second = validation.some([0]), validation.some([len(validation) - 1])
    return evaluate(state.field, first, second, problem.dark)


def _psnr(seen: Scores | None) -> float:
    """Of a validation view, NaN where there is none."""
    return float("nan") if seen is None else float(seen.psnr.mean())


def _verdict(
    held_out: float, scores: Scores, steps: int, finite: bool, far: Mapping[str, float],
    unidentified: Sequence[str] = (),
) -> tuple[Status, str]:  # fmt: skip
    if not finite or not np.isfinite(scores.psnr).all():
        return Status.diverged, (
            f"loss or field was no number after {steps} steps: lower the learning rate, or check thresholds, dead time "
            "and the radiance unit of the pixel"
        )
    if not np.isfinite(held_out):
        return Status.not_identified, (
            "nothing was judged: only one pixel has two events, and the scene was trained on them; take a recording in "
            "which more pixels fire"
        )
    if held_out > LEARNED:
        return Status.misfit, (
            f"{held_out:.2f} of what events of held-out pixels show is unexplained (1 would be no scene): "
            "check poses, polarity, thresholds and --box, or train longer"
        )
    gone = {name: z for name, z in far.items() if abs(z) > MOST_FAR}
    if gone:
        went = ", ".join(f"{name} {z:+.0f}" for name, z in gone.items())
        return Status.misfit, (
            f"trained thresholds contradict the fit: {went} of its standard deviations away: events hardly separate "
            "them from the scene's contrast; leave --train threshold and ratio out, or check --fit"
        )
    if unidentified:
        return Status.not_identified, (
            "the events do not identify all that was trained (see unidentified): leave it out; an offset between "
            "clocks needs a camera whose speed changes, a mean threshold a fit"
        )
    return Status.converged, ""


def _left_open(problem: Problem, state: State) -> list[str]:
    """What was trained and the events do not identify, in words: what hides in the scene."""
    told_s, shows_s = state.poses.refinement.time_sd, problem.time_resolution_s
    open_ = []
    if state.poses.offset.requires_grad and shows_s >= told_s:
        least = f"less than {1e3 * shows_s:.3g} ms" if np.isfinite(shows_s) else "any"
        open_.append(
            f"offset between the clocks of poses and events: the camera moves so evenly that {least} passes for a "
            f"motion of the scene, and it is known to {1e3 * told_s:.3g} ms without events"
        )
    pixel = state.pixel
    if pixel.trains("threshold") and "threshold" not in (pixel.bandwidth.prior_sd or {}):
        open_.append(
            f"mean threshold: {float(pixel.growth.detach()):.3g} times the stated one; a larger one, with a scene of "
            "as much more contrast, makes the same events, so the scene holds up to an exponent"
        )
    return open_


def rendered(reconstruction: Reconstruction) -> np.ndarray:
    """(n, H, W, C) corrected images of the test views."""
    r = reconstruction
    return r.scores.correction(render_views(r.state.field, r.truth, r.problem.dark), r.truth.exposure)
