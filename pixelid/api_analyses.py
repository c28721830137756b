"""What `import pixelid` shows of recordings under models: comparisons, maps of sensors, conformance; and reports."""
# pyright: reportUnnecessaryIsInstance=false
# what users give is checked, whatever the annotations promise

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pixelid.public import public

if TYPE_CHECKING:
    from pixelid.api import Progress
    from pixelid.compare import Comparison
    from pixelid.conform.result import ConformReport
    from pixelid.inputs import ModelLike, RecordingsLike
    from pixelid.sensors import SensorFit


@public
def compare(
    recordings: RecordingsLike,
    models: Sequence[ModelLike],
    *,
    folds: int = 2,
    sample: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> Comparison:
    """Fit every model to recordings and judge it on pixels that its fit has not seen.

    Args:
        recordings: with pixel addresses and stimuli.
        models: two or more, of different names.
        folds: parts that the pixels are dealt into.
        sample: also PSIS-LOO over pixels, from posteriors.
        seed: of the folds and starts.
        progress: called with what is done and the fraction.

    Returns:
        Every model's fit and held-out log-likelihood, and what to conclude.

    Raises:
        InputError: fewer than two models, two of one name, fewer pixels than folds.

    Example:
        >>> import pixelid as px
        >>> px.compare("session/", ["dvs128", "photoreceptor"]).best  # doctest: +SKIP
    """
    from pixelid.compare import compare as run
    from pixelid.inputs import as_model, as_recordings

    circuits = [as_model(model) for model in ([models] if isinstance(models, str | Path) else models)]
    return run(as_recordings(recordings), circuits, folds=folds, posteriors=sample, seed=seed, progress=progress)


@public
def sensor(
    recordings: RecordingsLike,
    model: ModelLike,
    *,
    bandwidth: str | None = None,
    block: int = 1,
    tile: int = 32,
    bootstrap: int = 200,
    workers: int = 0,
    cluster: str = "",
    resume: str | Path | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> SensorFit:
    """Map thresholds and a bandwidth over a whole sensor under full-field light.

    Args:
        recordings: of one sensor, with pixel addresses and stimuli.
        model: the population's values, as of a fit.
        bandwidth: parameter to map; "none": thresholds alone; by default sf_cutoff_hz where the model has it.
        block: side of pixel groups with one bandwidth.
        tile: side of the units of work.
        bootstrap: replicates over pixels.
        workers: local Dask processes; 0: this process alone.
        cluster: address of a running Dask scheduler.
        resume: folder that keeps finished tiles, for a call that is interrupted and repeated.
        seed: of the bootstrap.
        progress: called with what is done and the fraction.

    Returns:
        A map of each parameter, every pixel shrunk towards the population by what its own events say.

    Raises:
        InputError: recordings or options that do not fit together.

    Example:
        >>> import pixelid as px
        >>> px.sensor("chirp.h5", "fit/").to_dataframe()  # doctest: +SKIP
    """
    from pixelid.cluster import Where
    from pixelid.inputs import as_model, as_recordings
    from pixelid.sensors import fit_sensor

    circuit = as_model(model)
    if bandwidth is None:
        bandwidth = "sf_cutoff_hz" if "sf_cutoff_hz" in circuit.parameters else "none"
    return fit_sensor(
        as_recordings(recordings), circuit, bandwidth="" if bandwidth == "none" else bandwidth, block=block, tile=tile,
        replicates=bootstrap, where=Where(cluster, workers), keep=None if resume is None else Path(resume), seed=seed,
        progress=progress,
    )  # fmt: skip


@public
def conform(
    recordings: RecordingsLike,
    model: ModelLike,
    *,
    alpha: float = 0.01,
    workers: int = 0,
    cluster: str = "",
    resume: str | Path | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> ConformReport:
    """Say of every effect of the signal path whether recordings of a simulator or a camera have it.

    Args:
        recordings: of one sensor, with full-field stimuli.
        model: where to begin; what it has is tested by taking it out, what it lacks by adding it.
        alpha: chance of a false alarm.
        workers: local Dask processes; 0: this process alone.
        cluster: address of a running Dask scheduler.
        resume: a file that keeps the fits made so far.
        seed: of the split of pixels, and of simulations.
        progress: called with what is done and the fraction.

    Returns:
        A row for each effect: present, absent, not decidable or not tested.

    Raises:
        InputError: as `gap`.

    Example:
        >>> import pixelid as px
        >>> px.conform("session/", "dvs128").counts  # doctest: +SKIP
    """
    from pixelid.cluster import Where
    from pixelid.conform.conform import conform as run
    from pixelid.inputs import as_model, as_recordings

    return run(
        as_recordings(recordings), as_model(model), alpha=alpha, where=Where(cluster, workers),
        resume=None if resume is None else Path(resume), seed=seed, progress=progress,
    )  # fmt: skip


@public
def report(folder: str | Path) -> Path:
    """Write the page of a result's folder again, report.html, from its JSON and figures.

    Args:
        folder: of any result.

    Returns:
        The path of the page.

    Raises:
        InputError: the folder holds no result, or a damaged one.

    Example:
        >>> import pixelid as px
        >>> px.report("fit/")  # doctest: +SKIP
    """
    from pixelid.report.html import write_report

    return write_report(Path(folder), command="")
