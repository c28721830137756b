"""From a dataset to a scene: train, evaluate, write."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from pixelid.errors import InputError
from pixelid.nerf.data.calibration import CIRCUIT, Calibration, of_fit, uncertainty_of_fit, unexplained_by
from pixelid.nerf.data.dataset import CALIBRATION, Dataset, evaluation_views, write_poses
from pixelid.nerf.data.views import Views
from pixelid.nerf.effects.ignored import ignored_effects, truncated_memory
from pixelid.nerf.effects.search import HELD_OUT as SEARCH_HELD_OUT
from pixelid.nerf.effects.search import hot_pixels, search
from pixelid.nerf.options import LEAST_SHARE, Options
from pixelid.nerf.pixel.maps import PixelMaps, maps_of_sensor
from pixelid.nerf.pixel.model import FILTER, Bandwidth
from pixelid.nerf.shown.beside import Beside
from pixelid.nerf.shown.evaluate import Scores, evaluate, evaluate_as_published, no_scores
from pixelid.nerf.shown.given import Given
from pixelid.nerf.shown.preview import refuse_preview, write_preview
from pixelid.nerf.shown.saved import SavedReconstruction
from pixelid.nerf.training import checkpoint, parallel
from pixelid.nerf.training.judged import keep_best, train_judged
from pixelid.nerf.training.problem import problem_of
from pixelid.nerf.training.recipe import LEAST_STEPS, Recipe
from pixelid.nerf.training.residuals import Left, left_by
from pixelid.nerf.training.state import Problem, State, start
from pixelid.nerf.training.train import held_out_residual
from pixelid.parallel import memory_bytes
from pixelid.provenance import input_hashes, versions
from pixelid.status import Status

if TYPE_CHECKING:
    from pixelid.recordings.recording import Recording

# Root mean square of what is left of held-out changes, as a share of what they show.  An event is a change of one
# threshold: a miss of half of one makes the next number of events as near as the right one.
MOST_UNEXPLAINED = 0.5
# Standard deviations of a fit from which on a trained threshold contradicts it: the scene's contrast, which events tell
# from a threshold hardly, has taken it along
MOST_FAR = 5.0
RESIDUALS = "residuals.npz"
LOOKS = 10  # running PSNR, per run
SAVE_EVERY, SAVE_AFTER_S = 100, 30.0  # steps between checkpoints; sooner where steps take long

Progress = Callable[[str, float], None]


@dataclass(frozen=True, repr=False)
class Reconstruction(SavedReconstruction):
    """A reconstructed scene, how well it can be trusted, and what it was trained with.

    state: of the training in the end;  recipe: how it was trained;  scores: of the test views, NaN when it diverged;
    truth: the test views;  published: scores by the reference implementation's protocol, on request;  beside: another
    scene of the same data;  left: what events say beyond the scene in the end, where effects were looked for;  given:
    what it starts from, as a picture
    """

    state: State
    problem: Problem
    recipe: Recipe
    scores: Scores
    truth: Views
    published: Scores | None
    beside: Beside | None
    left: Left | None
    given: Given

    def write_companions(self, folder: Path) -> None:
        """Write field.npz, the scene, camera_poses.npz where poses were refined, and residuals.npz after `gap`."""
        super().write_companions(folder)
        if self.left:
            np.savez_compressed(folder / RESIDUALS, on=self.left.on, off=self.left.off, rms=self.left.rms)
        if self.state.poses.trained:
            write_poses(folder, self.state.poses.refined())

    def write_figures(self, folder: Path, recordings: Sequence[Recording] = ()) -> None:
        """Draw views with their errors, how training went, and what events say beyond it."""
        from pixelid.nerf.shown.reconstruction_figures import write_figures

        write_figures(self, folder)


def reconstruct(
    dataset: Dataset,
    options: Options | None = None,
    *,
    recipe: Recipe | None = None,
    bandwidth: Bandwidth | None = None,
    calibration: Calibration | None = None,
    resume: Path | None = None,
    preview: Path | None = None,
    overwrite: bool = False,
    progress: Progress = lambda what, share: None,
) -> Reconstruction:
    """Reconstruct the scene of a dataset.

    Under `torchrun` every process takes its share of each batch; all return the same.

    Args:
        dataset: as read.
        options: what is asked for; the defaults otherwise.
        recipe: of the training, in place of what the options say.
        bandwidth: how the pixel enters, likewise.
        calibration: the camera and its pixel, in place of the dataset's.
        resume: a checkpoint, continued when it exists and written as training goes on.
        preview: a PNG of the scene, replaced as training goes on.
        overwrite: whether the preview may replace another picture.
        progress: called with what is done and the fraction.

    Returns:
        The scene, with the scores of its test views.

    Raises:
        InputError: input that cannot be used.
    """
    watch = time.perf_counter()
    options = Options() if options is None else options
    if preview is not None:
        refuse_preview(Path(preview), overwrite)
    other = None if options.beside is None else Beside.read(options.beside, dataset.files)
    device = _device(options.device)
    bandwidth = Bandwidth.of(options) if bandwidth is None else bandwidth
    calibration = _calibration(dataset, options, bandwidth) if calibration is None else calibration
    bandwidth = _with_prior_of_fit(bandwidth, options.fit)
    recipe = Recipe.of(options) if recipe is None else replace(recipe, seed=options.seed)
    recipe = recipe.for_sensor(dataset.calibration.camera.width)
    if recipe.between_poses == "cubic":
        dataset = replace(dataset, trajectory=dataset.trajectory.splined())
    sensor = options.sensor
    maps = maps_of_sensor(sensor, calibration.circuit, calibration.camera) if sensor else None
    make = partial(problem_of, dataset, options=options, maps=maps, cells=recipe.cells)
    problem = make(calibration, trained=bandwidth.moving)
    parallel.join(device)
    recipe = recipe.for_data(len(problem.training.starts), bandwidth.samples if bandwidth.mode != "off" else 1,
                             _memory(device))  # fmt: skip
    inputs = _input_hashes(dataset, options)
    validation, test = evaluation_views(dataset)
    mark = checkpoint.run_identity(problem, recipe, bandwidth, inputs)
    found: Mapping[str, Any] | None = None
    if options.gap:
        told = calibration
        kept = checkpoint.search_file(Path(resume)) if resume is not None else None
        outcome = checkpoint.load_search(kept, told, mark) if kept else None
        if outcome is None:
            result = search(
                told, bandwidth, recipe, partial(make, held_out=SEARCH_HELD_OUT), mapped=maps is not None,
                score=lambda state: _psnr(_running(state, problem, validation)), device=device,
                progress=lambda what, share: progress(what, 0.5 * share),
            )  # fmt: skip
            outcome = result.calibration, result.trained, result.as_dict()
            if kept and parallel.rank() == 0:
                checkpoint.save_search(kept, told, *outcome, mark)
        calibration, trained, found = outcome
        bandwidth = replace(bandwidth, trained=(*bandwidth.trained, *trained))
        problem = make(calibration, trained=bandwidth.moving)
        if hot := hot_pixels(problem):
            found = {**found, "effects": [*found["effects"], hot]}
        mark = checkpoint.run_identity(problem, recipe, bandwidth, inputs)
    state = None
    if resume is not None and Path(resume).exists():
        state = checkpoint.load(Path(resume), problem, recipe, bandwidth, mark, device)
    state = start(problem, recipe, bandwidth, device) if state is None else state
    watched = _Watched(problem, recipe, validation, mark, resume, preview, progress, 0.5 * options.gap, state.seconds)
    train_judged(problem, recipe, state, report=watched.report)
    rate = watched.rate(state)
    if state.finite:
        watched.save(state)
    keep_best(state)
    watched.show(state)
    progress("evaluating", 0.95)
    finite, truth = state.finite, test
    scores = evaluate(state.field, validation, test, problem.dark) if finite else no_scores(test)
    paper = finite and options.protocol == "paper"
    published = evaluate_as_published(state.field, test, problem.dark) if paper else None
    held_out = held_out_residual(problem, state) if finite else float("nan")
    finite = finite and bool(np.isfinite(held_out) or not len(problem.held_out.starts))
    left = left_by(problem, state) if finite and found is not None else None
    unidentified = _left_open(problem, state)
    status, advice = _verdict(
        held_out, scores, state.iteration, finite, state.pixel.thresholds_from_told(), unidentified,
        _missing_steps(recipe, state),
    )  # fmt: skip
    content = {
        "status": status,
        "advice": advice,
        "bandwidth": bandwidth.mode,
        "ignored": list(_ignored(problem, bandwidth, calibration, options.fit, maps, state)),
        "unidentified": unidentified,
        "gap": {**found, "final": left.as_dict() if left else None} if found else None,
        "beside": None if other is None else other.as_dict(),
        **_of_scores(scores, published, truth),
        "seconds": watched.earlier_s + time.perf_counter() - watch,
        "device": device,
        "rays_per_second": rate,
        "samples": bandwidth.samples,
        "held_out_residual": held_out,
        **_of_training(problem, recipe, state),
        "versions": versions(),
        "inputs_sha256": inputs,
    }
    given = Given.of(dataset, truth, problem.low, problem.high)
    return Reconstruction(content, state.field, state, problem, recipe, scores, truth, published, other, left, given)


def _of_scores(scores: Scores, published: Scores | None, truth: Views) -> dict[str, Any]:
    """Entries of reconstruction.json about the test views."""
    numbers = {name: getattr(scores.correction, name).tolist() for name in ("a", "b", "c")}
    return {
        "views": scores.as_dict(truth),
        "log_eps": truth.log_eps,
        "correction": {name: values[0] if len(values) == 1 else values for name, values in numbers.items()},
        "published_protocol": published.means() if published is not None else None,
        "lpips_note": "" if scores.lpips is not None else "LPIPS or its weights are not installed",
    }


def _of_training(problem: Problem, recipe: Recipe, state: State) -> dict[str, Any]:
    """Entries of reconstruction.json about what was trained."""
    pixel = {**dict.fromkeys(FILTER), **problem.values(state.pixel)}
    return {
        "iterations": state.iteration,
        "recipe": recipe.as_dict(),
        "stopping": state.stopping.as_dict(state.iteration, diverged=not state.finite),
        "regularisation": dataclasses.asdict(state.regularisation),
        "gauge": {"kind": problem.gauge.kind, "background": problem.gauge.background},
        "box": {"low": problem.low, "high": problem.high, "near": problem.near},
        "pixel": {**pixel, "differencing": problem.circuit.differencing, "dark": problem.dark},
        "pixels": problem.pixels_as_dict(state.pixel),
        "poses": state.poses.as_dict(problem.time_resolution_s),
        "history": state.history,
        "seed": recipe.seed,
    }


def _device(asked: str) -> str:
    """ "cpu" or "cuda".  Raises InputError where the latter is asked for and not there."""
    there = torch.cuda.is_available()
    if asked == "cuda" and not there:
        raise InputError("--device cuda: no CUDA device is available")
    return ("cuda" if there else "cpu") if asked == "auto" else asked


def _memory(device: str) -> int:
    """Bytes; the first process', since all need one recipe and may have other computers."""
    memory = torch.cuda.get_device_properties(0).total_memory if device == "cuda" else memory_bytes()
    return int(parallel.agreed(np.array([memory]))[0])


def _calibration(dataset: Dataset, options: Options, bandwidth: Bandwidth) -> Calibration:
    """The camera of a dataset with its own pixel or a fit's."""
    if options.radiance_scale is not None and options.fit is None:
        raise InputError("--radiance-scale: relates the unit of --fit to that of the views; needs --fit")
    calibration = dataset.calibration
    if options.fit:
        calibration = of_fit(calibration, options.fit, options.radiance_scale)
    if bandwidth.mode != "off" and not calibration.known:
        raise InputError(
            f"{dataset.path / CALIBRATION}: {CIRCUIT[0]}: missing, like all circuit constants; give the pixel by "
            "--fit, or --bandwidth off"
        )
    return calibration


def _with_prior_of_fit(bandwidth: Bandwidth, fit: Path | None) -> Bandwidth:
    """With a fit's uncertainty as the prior of what is asked for: what `gap` asks for departs from the fit."""
    if not (fit and bandwidth.moving and bandwidth.prior_sd is None):
        return bandwidth
    known = {name: sd for name, sd in uncertainty_of_fit(fit).items() if name in bandwidth.moving}
    return replace(bandwidth, prior_sd=known or None)


def _input_hashes(dataset: Dataset, options: Options) -> dict[str, str]:
    """Of the dataset, the fit and the maps of the sensor."""
    files, fit, sensor = [*dataset.files], options.fit, options.sensor
    files += [fit / "model.toml" if fit.is_dir() else fit] if fit else []
    return input_hashes([*files, *([sensor / name for name in ("sensor.json", "maps.npz")] if sensor else [])])


@dataclass
class _Watched:
    """What accompanies a training: progress, history, preview and checkpoint.

    mark: of the run;  searched: share of the progress that a search for effects has had;  earlier_s: of training before
    an interruption
    """

    problem: Problem
    recipe: Recipe
    validation: Views
    mark: str
    resume: Path | None
    preview: Path | None
    progress: Progress
    searched: float
    earlier_s: float
    begun: float = field(default_factory=time.perf_counter)
    saved: float = field(default_factory=time.perf_counter)

    def rate(self, state: State) -> float:
        """Rays per second of all processes; notes in the state how long it has been trained."""
        state.seconds = self.earlier_s + time.perf_counter() - self.begun
        return state.rays * parallel.world() / max(state.seconds, 1e-9)

    def report(self, now: State, measured: dict[str, float]) -> None:
        """After every step."""
        rate = self.rate(now)
        if now.iteration % max(self.recipe.iterations // LOOKS, 1) == 0:
            seen = _running(now, self.problem, self.validation)
            entry = {"iteration": now.iteration, **measured, "rays_per_second": rate, "running_psnr": _psnr(seen)}
            now.history.append({name: float(value) for name, value in entry.items()})
            self.show(now, seen)
        last = now.history[-1]["running_psnr"] if now.history else float("nan")
        words = f"loss {measured['loss']:.3f}, {rate / 1e3:.0f}k rays/s, {last:.1f} dB"
        self.progress(words, self.searched + (1.0 - self.searched) * 0.95 * now.iteration / self.recipe.iterations)
        if now.finite and (now.iteration % SAVE_EVERY == 0 or time.perf_counter() - self.saved > SAVE_AFTER_S):
            self.save(now)

    def show(self, now: State, seen: Scores | None = None) -> None:
        """Replace the preview; seen: scores of a validation view, where there are any."""
        if self.preview is not None and parallel.rank() == 0:
            seen = _running(now, self.problem, self.validation) if seen is None else seen
            write_preview(Path(self.preview), self.problem, now, seen, self.validation)

    def save(self, now: State) -> None:
        """Write the checkpoint."""
        if self.resume is not None and parallel.rank() == 0:
            checkpoint.save(Path(self.resume), now, self.mark)
            self.saved = time.perf_counter()


def _ignored(
    problem: Problem, bandwidth: Bandwidth, calibration: Calibration, fit: Path | None, maps: PixelMaps | None,
    state: State,
) -> tuple[str, ...]:  # fmt: skip
    """What is known of the pixel and not modelled, in words."""
    ignored = (*ignored_effects(problem.circuit), *(maps.unused if maps else ()), *unexplained_by(fit))
    if bandwidth.mode != "off":
        ignored += truncated_memory(problem.circuit, problem.training)
    if problem.circuit.refractory < calibration.circuit.refractory:
        ignored += (f"a dead time beyond {problem.circuit.refractory:.3g} s, for intervals between events are shorter",)
    return (*ignored, *(maps.filters if maps is not None and not state.pixel.filtering else ()))


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
    unidentified: Sequence[str] = (), missing: int = 0,
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
    unexplained = f"{100 * held_out:.0f} % of what events of held-out pixels show is unexplained (100 %: no scene)"
    if missing:
        return Status.not_converged, (
            f"{unexplained}: training made {steps} of the {steps + missing} steps that a scene needs at least, and "
            "more would explain more; leave --iterations out, or let --steps auto choose"
        )
    if held_out > MOST_UNEXPLAINED:
        return Status.misfit, f"{unexplained}: check poses, polarity, thresholds and --box"
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


def _missing_steps(recipe: Recipe, state: State) -> int:
    """Steps of the least that a scene needs which were not made; 0 where they would win next to nothing."""
    missing = max(LEAST_STEPS - recipe.iterations, 0)
    return 0 if missing and state.stopping.to_gain(missing) < LEAST_SHARE else missing


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
