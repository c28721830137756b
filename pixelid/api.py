"""The functions that `import pixelid` shows: thin, typed, and forgiving about what they are given.

A model is a `Model`, a shipped name, a .toml file or a fit folder; recordings are a path, a `Recording`, or a list of
either; a stimulus is a `Stimulus`, a built-in name or a file.  `progress(what, fraction)` reports on long work.
"""
# pyright: reportUnnecessaryIsInstance=false
# what users give is checked, whatever the annotations promise

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from pixelid.errors import InputError
from pixelid.public import public

if TYPE_CHECKING:
    from pixelid.bench.check import CheckReport
    from pixelid.bench.result import Calibration
    from pixelid.fit.levels.pixel_levels import PixelLevelsLike
    from pixelid.fit.result import FitResult
    from pixelid.gap.result import GapReport
    from pixelid.inputs import ModelLike, RecordingsLike, StimulusLike
    from pixelid.model.model import Model
    from pixelid.parameters.gauge import Gauge
    from pixelid.recordings.recording import Recording
    from pixelid.sample.posterior import Posterior

Progress: TypeAlias = Callable[[str, float], None]


def find_model(model: ModelLike) -> Model:
    """The circuit of a shipped name, a .toml file or a fit folder.

    Raises:
        InputError: unknown names, with the shipped ones.

    Example:
        >>> import pixelid as px
        >>> px.find_model("dvs128").values["refractory_s"] > 0
        True
    """
    from pixelid.inputs import as_model

    return as_model(model)


@public
def simulate(
    model: ModelLike,
    stimulus: StimulusLike,
    *,
    pixels: int | None = None,
    seed: int = 0,
    sensor_seed: int | None = None,
    synchronous: bool = False,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Recording:
    """Events of a circuit under a stimulus.

    Args:
        model: the circuit of every pixel.
        stimulus: full-field light, or a video, whose size is the sensor's.
        pixels: of a nearly square sensor under full-field light; 25 by default.
        seed: of everything that differs from recording to recording; other light draws other noise.
        sensor_seed: of what belongs to the sensor (thresholds, hot pixels); `seed` by default.
        synchronous: every pixel takes its first reference at the first sample.
        threads: one per core by default; the events do not depend on it.
        progress: called with what is done and the fraction; by default a bar where a terminal or notebook shows it.

    Returns:
        The recording, with its stimulus.

    Raises:
        InputError: a stimulus of unknown radiance, pixels that make no sensor, a circuit that cannot be simulated.

    Example:
        >>> import pixelid as px
        >>> px.simulate("ideal", "sine", pixels=4).events.width
        2
    """
    from pixelid.inputs import as_model, as_stimulus
    from pixelid.recordings.selection import nearly_square
    from pixelid.simulate.simulator import simulate as run

    circuit, light = as_model(model), as_stimulus(stimulus)
    if not light.full_field and pixels is not None:
        raise InputError("--pixels: a video stimulus sets the size of the sensor itself")
    width, height = nearly_square(25 if pixels is None else pixels) if light.full_field else (None, None)
    return run(
        circuit, light, width=width, height=height, seed=light.own_seed(seed),
        sensor_seed=seed if sensor_seed is None else sensor_seed, synchronous=synchronous, threads=threads,
        progress=None if progress is None else lambda done: progress("simulating", done),
    )  # fmt: skip


@public
def fit(
    recordings: RecordingsLike,
    model: ModelLike,
    *,
    gauge: Gauge | Mapping[str, str | float] | None = None,
    fixed: Mapping[str, float] | None = None,
    starts: int = 2,
    between: str = "auto",
    engine: str = "casadi",
    form: str = "discrete",
    pixel_levels: PixelLevelsLike = None,
    bias_priors: bool | str = False,
    profile: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> FitResult:
    """Fit a circuit's free parameters to recordings, all in one problem.

    Args:
        recordings: with pixel addresses (event-time likelihood) or pooled (pooled-rate likelihood), all or none.
        model: what is fitted, from its own values.
        gauge: statements that make physical values unique, as {"q_in": 0.875, "A_loop": "0.7 A_amp"}.
        fixed: parameters to hold, at these values.
        starts: random starts in addition to the model's own values.
        between: how the stimulus runs between its samples: "linear", "smooth", or "auto": as explains the events best.
        engine: "casadi", "torch" or "scipy"; all find the same maximum.
        form: "discrete", linearised once per stimulus step, or "continuous" in time, which takes longer.
        pixel_levels: "gain", "background" or "both": each pixel sees gain · light + background, both unknown; with the
            spread over pixels where it is known, {"gain": 0.2, "background": None}.
        bias_priors: priors of thresholds, dead time and the follower's cutoff from the bias settings of jAER's headers;
            a folder of `pixelid biases`: from its laws at the codes of the recordings' .bias files.
        profile: also profile every parameter: bounded, one-sided or flat.
        seed: of the starts.
        progress: called with what is done and the fraction; by default a bar where a terminal or notebook shows it.

    Returns:
        Values with intervals, what is not identified, and how it ended.

    Raises:
        InputError: recordings that cannot be fitted together, unknown parameters, an impossible gauge.

    Example:
        >>> import pixelid as px
        >>> px.fit("session/", "dvs128", fixed={"gamma": 1.12}).summary()  # doctest: +SKIP
    """
    from pixelid.fit.fit import fit as run
    from pixelid.inputs import as_model, as_recordings
    from pixelid.parameters.gauge import Gauge

    circuit, opened = as_model(model), as_recordings(recordings)
    held = dict(fixed or {})
    circuit = circuit.fix({name: value for name, value in held.items() if name in circuit.parameters})
    nuisances = {name: value for name, value in held.items() if name not in circuit.parameters}
    result = run(
        opened, circuit, gauge=Gauge.parse(gauge) if isinstance(gauge, Mapping) else gauge, fixed=nuisances,
        starts=starts, between=between, engine=engine, form=form, pixel_levels=pixel_levels,
        bias_priors=bias_priors, seed=seed, progress=progress,
    )  # fmt: skip
    if profile:
        from pixelid.fit.uncertainty.profiles import profiled

        result = profiled(result, opened, progress)
    return replace(result, fitted=tuple(opened))


@public
def sample(
    result: FitResult | str | Path,
    recordings: RecordingsLike,
    *,
    seed: int = 0,
    wanted: int = 1000,
    ensembles: int = 2,
    max_steps: int = 4000,
    chain_file: str | Path | None = None,
    progress: Progress | None = None,
) -> Posterior:
    """Draw from the exact posterior of a fit's free parameters.

    Args:
        result: a fit, or its folder.
        recordings: what it was fitted to.
        seed: of the draws.
        wanted: effective samples per parameter.
        ensembles: independent ones, at least 2: their agreement is the test of convergence.
        max_steps: of every walker; a posterior that needs more says that it did not converge.
        chain_file: .npz file of the chains; an unfinished one of the same fit and seed is continued.
        progress: called with what is done and the fraction; by default a bar where a terminal or notebook shows it.

    Returns:
        The draws, with their convergence.

    Raises:
        InputError: fewer than two ensembles, something that is no fit.

    Example:
        >>> import pixelid as px
        >>> px.sample("fit/", "session/").to_dataframe()  # doctest: +SKIP
    """
    from pixelid.fit.result import FitResult
    from pixelid.inputs import as_recordings
    from pixelid.sample.sample import sample as run

    if isinstance(result, str | Path):
        result = FitResult.load(result)
    if not isinstance(result, FitResult):
        raise InputError(f"result: expected a FitResult or a fit folder, found {type(result).__name__}")
    path = None if chain_file is None else Path(chain_file)
    return run(
        result, as_recordings(recordings), seed=seed, wanted=wanted, ensembles=ensembles, max_steps=max_steps,
        chain_file=path, progress=progress,
    )  # fmt: skip


@public
def gap(
    recordings: RecordingsLike,
    model: ModelLike,
    *,
    alpha: float = 0.01,
    seed: int = 0,
    leave_out: Sequence[str] = (),
    recommend: bool = True,
    pixel_levels: PixelLevelsLike = None,
    workers: int = 0,
    cluster: str = "",
    resume: str | Path | None = None,
    progress: Progress | None = None,
) -> GapReport:
    """Search recordings for effects that a model lacks.

    Args:
        recordings: of one sensor.
        model: the base.
        alpha: chance of naming anything, or of "unknown", when the model is right.
        seed: of the split of pixels, and of simulations.
        leave_out: effects that the library is to lack.
        recommend: also work out what to record next.
        pixel_levels: as of `fit`; the search takes them as they are estimated with the base, and again with what it
            names.
        workers: local Dask processes; 0: this process alone.
        cluster: address of a running Dask scheduler.
        resume: a file that keeps the fits made so far, for a search that is interrupted and called again.
        progress: called with what is done and the fraction; by default a bar where a terminal or notebook shows it.

    Returns:
        The verdict, the effects with their strengths, and the gap before and after.

    Raises:
        InputError: recordings without pixels or stimulus, of several sensors; a model that cannot be searched from.

    Example:
        >>> import pixelid as px
        >>> px.gap("session/", "dvs128").verdict  # doctest: +SKIP
    """
    from pixelid.cluster import Where
    from pixelid.gap.gap import gap as run
    from pixelid.inputs import as_model, as_recordings

    file = None if resume is None else Path(resume)
    return run(
        as_recordings(recordings), as_model(model), alpha=alpha, seed=seed, leave_out=leave_out, progress=progress,
        resume=file, recommend=recommend, pixel_levels=pixel_levels, where=Where(cluster, workers),
    )  # fmt: skip


@public
def check(
    bench: str | Path,
    *,
    roi: tuple[int, int, int, int] | None = None,
    pixels: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> CheckReport:
    """Read the recordings of a bench session and bring each onto its light's clock.

    Args:
        bench: a folder of recordings and light traces (NAME.raw with NAME_light.csv), or a bench.toml.
        roi: (x0, y0, x1, y1) of the sensor to look at.
        pixels: how many a fit will look at.
        seed: chooses them.
        progress: called with what is done and the fraction; by default a bar where a terminal or notebook shows it.

    Returns:
        One row per recording, what was inferred, and what is wrong.

    Raises:
        InputError: nothing that can be read as a bench.

    Example:
        >>> import pixelid as px
        >>> px.check("bench/").rows  # doctest: +SKIP
    """
    from pixelid.bench.check import check as run

    return run(bench, roi=roi, pixels=pixels, seed=seed, progress=progress)


@public
def calibrate(
    bench: str | Path,
    *,
    model: ModelLike | None = None,
    roi: tuple[int, int, int, int] | None = None,
    pixels: int | None = None,
    search: bool = True,
    seed: int = 0,
    resume: str | Path | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a camera's pixel from a bench session: align, fit, search for missing effects, fit all together.

    Args:
        bench: a folder of recordings and light traces (NAME.raw with NAME_light.csv), or a bench.toml.
        model: where the fit starts; the bench's, or dvs128, by default.
        roi: (x0, y0, x1, y1) of the sensor to look at.
        pixels: how many are fitted.
        search: whether to search for what the model lacks.
        seed: of every choice and draw.
        resume: a folder that keeps finished stages, for a calibration that is interrupted and called again.
        progress: called with what is done and the fraction; by default a bar where a terminal or notebook shows it.

    Returns:
        The calibrated model with intervals, what the events contradict of the bench, and what to record next.

    Raises:
        InputError: nothing that can be read as a bench, recordings that cannot be fitted together.

    Example:
        >>> import pixelid as px
        >>> px.calibrate("bench/").save("camera")  # doctest: +SKIP
    """
    from pixelid.bench.calibrate import calibrate as run
    from pixelid.inputs import as_model

    start = None if model is None else as_model(model)
    kept = None if resume is None else Path(resume)
    return run(bench, model=start, roi=roi, pixels=pixels, search=search, seed=seed, resume=kept, progress=progress)
