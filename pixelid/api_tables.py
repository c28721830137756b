"""What `import pixelid` shows of tables and of lights that need no trace: rates, latencies, flicker, noise, biases."""
# pyright: reportUnnecessaryIsInstance=false
# what users give is checked, whatever the annotations promise

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pixelid.errors import InputError
from pixelid.public import public

if TYPE_CHECKING:
    from pixelid.api import Progress
    from pixelid.inputs import ModelLike, RecordingsLike
    from pixelid.recordings.recording import Recording
    from pixelid.tables.biases.result import BiasLaws
    from pixelid.tables.flicker.result import FlickerResult
    from pixelid.tables.latency.result import LatencyResult
    from pixelid.tables.noise.result import NoiseResult
    from pixelid.tables.rates.result import RateResult


@public
def rates(
    source: str | Path, *, unit: str | None = None, bias_law: bool = False, data: str | Path | None = None
) -> RateResult:
    """Fit tables of event rate against the frequency of a blinking light.

    Args:
        source: a CSV (freq_hz, one column per setting; one pixel), or a recipe .toml of a light's whole image.
        unit: of the rates in a CSV, "hz", "kev/s" or "mev/s"; by default what its header says.
        bias_law: columns end in a bias in mV (fo1477): also one law for their cutoffs.
        data: where a recipe's files are; its own folder by default.

    Returns:
        Bandwidth, dead time and noise with intervals, and cells that disagree.

    Raises:
        InputError: no such file, or a table that cannot be fitted.

    Example:
        >>> import pixelid as px
        >>> px.rates("rate_vs_frequency.csv", unit="mev/s").summary()  # doctest: +SKIP
    """
    from pixelid.options import one_of
    from pixelid.tables.rates import result
    from pixelid.tables.rates.bias_law import biases_of
    from pixelid.tables.rates.pixel import fit_pixel
    from pixelid.tables.rates.pool import fit_pool
    from pixelid.tables.rates.reading import read_table
    from pixelid.tables.rates.recipe import read_pool_recipe

    source = _file(source)
    if source.suffix == ".toml":
        if bias_law:
            raise InputError("--bias-law: for a CSV of one pixel, not for a recipe")
        pool, file = read_pool_recipe(source, None if data is None else Path(data))
        return result.of_pool(fit_pool(pool), file)
    table = read_table(source, None if unit is None else one_of("--unit", unit, ("hz", "kev/s", "mev/s")))
    if bias_law:
        biases_of(table.columns)
    return result.of_pixel(fit_pixel(table), bias_law)


@public
def latency(
    tables: str | Path | Sequence[str | Path],
    *,
    model: str | Path | None = None,
    predict: bool = False,
    camera: str | None = None,
    sample: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> LatencyResult:
    """Fit first-event latencies against irradiance, threshold setting and edge.

    Args:
        tables: CSV files (camera, lens, polarity, irradiance_W_m2, bias_config, min, median, max, stdev in µs), or one
            recipe .toml.
        model: what `predict` evaluates, or where a fit begins: a shipped name, a model file or a fit folder.
        predict: evaluate the model on the tables instead of fitting.
        camera: only the rows of this camera.
        sample: also draw from the posterior.
        seed: of the draws.
        progress: called with what is done and the fraction.

    Returns:
        Measured and predicted latencies, which stage limits where, and the fitted circuits.

    Raises:
        InputError: tables or a model that cannot be used, or options that exclude each other.

    Example:
        >>> import pixelid as px
        >>> px.latency("latency_by_roi.csv").save("latency")  # doctest: +SKIP
    """
    from pixelid.tables.latency import result
    from pixelid.tables.latency.choosing import chosen_cameras, chosen_rows
    from pixelid.tables.latency.fit import fit_latency
    from pixelid.tables.latency.posterior import sample_fit
    from pixelid.tables.latency.reading import read_tables
    from pixelid.tables.latency.recipe import read_latency_recipe

    files = [Path(tables)] if isinstance(tables, str | Path) else [Path(table) for table in tables]
    if predict and model is None:
        raise InputError("--predict: expected --model with it")
    if predict and sample:
        raise InputError("--sample: nothing to sample with --predict")
    by_recipe = bool(files) and files[0].suffix == ".toml"
    if by_recipe and (len(files) > 1 or predict or camera):
        raise InputError(f"{files[0]}: a recipe stands alone, without other tables, --predict and --camera")
    recipe = read_latency_recipe(files[0]) if by_recipe else None
    table = recipe.table if recipe else chosen_rows(read_tables(files, measured=not predict), camera)
    cameras, inputs = chosen_cameras(str(model)) if model is not None else ((), ())
    if predict:
        return result.of_prediction(table, cameras, *inputs, seed=seed)

    def report(what: str, share: float) -> None:
        if progress is not None:
            progress(what, share)

    fits = 0.2 if sample else 1.0  # of the time, about
    fit = fit_latency(table, lambda done: report("cameras", fits * done), cameras)
    drawn = None
    if sample:
        drawn = sample_fit(fit, seed, progress=lambda done: report("posterior", fits + (1.0 - fits) * done))
    return result.of_fit(fit, seed=seed, recipe=recipe, posterior=drawn)


@public
def flicker(
    recording: Recording | str | Path,
    *,
    frequency: float = 120.0,
    groups: tuple[int, int] = (8, 6),
    model: ModelLike = "dvs128",
    progress: Progress | None = None,
) -> FlickerResult:
    """Fit amplitude, phase and noise of groups of pixels under a flickering lamp, from the events' phases.

    Args:
        recording: of a still scene under the lamp.
        frequency: of the light [Hz], within 2 %.
        groups: of pixels, across and down.
        model: nominal circuit, at which it is computed what one frequency can fix.
        progress: called with what is done and the fraction.

    Returns:
        What one frequency fixes of the pixels, and what it leaves open.

    Raises:
        InputError: a recording too short or without events, groups larger than the sensor.

    Example:
        >>> import pixelid as px
        >>> px.flicker("lamp.npz", frequency=100.0).to_dataframe()  # doctest: +SKIP
    """
    from pixelid.inputs import as_model
    from pixelid.recordings.reading import open_recording
    from pixelid.tables.flicker import fit_flicker
    from pixelid.tables.flicker.result import of_flicker

    circuit = as_model(model)
    opened = open_recording(recording) if isinstance(recording, str | Path) else recording
    return of_flicker(fit_flicker(opened, circuit, near_hz=frequency, grid=groups, progress=progress))


@public
def noise(
    sources: RecordingsLike,
    *,
    model: ModelLike | None = None,
    predict: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> NoiseResult:
    """Fit noise events of still scenes against light: thresholds over noise, bandwidth, dark current, leak.

    Args:
        sources: tables (CSV: light, ON and OFF events per pixel and second), or still recordings.
        model: where a fit starts, and what `predict` evaluates; dvs128 by default.
        predict: evaluate the model on the rates instead of fitting.
        seed: recorded; nothing here is random.
        progress: called with what is done and the fraction.

    Returns:
        Measured and predicted rates, and the fitted circuit.

    Raises:
        InputError: tables and recordings together, rates of nothing, a model that cannot be used.

    Example:
        >>> import pixelid as px
        >>> px.noise("noise_vs_lux.csv").summary()  # doctest: +SKIP
    """
    from pixelid.inputs import as_model, as_recordings
    from pixelid.model.shipped import model_files
    from pixelid.tables.noise import result
    from pixelid.tables.noise.fit import fit_noise
    from pixelid.tables.noise.reading import read_noise_tables, reduced_recordings

    if predict and model is None:
        raise InputError("--predict: expected --model with it")
    given = list(sources) if isinstance(sources, Sequence) and not isinstance(sources, str) else [sources]
    tables = [_file(one) for one in given if isinstance(one, str | Path) and Path(one).suffix.lower() == ".csv"]
    if tables and len(tables) < len(given):
        raise InputError("noise: expected tables (.csv) or recordings, found both")
    circuit = as_model("dvs128" if model is None else model)
    table = read_noise_tables(tables) if tables else reduced_recordings(as_recordings(sources))
    if not predict:
        return result.of_fit(fit_noise(table, circuit, progress), seed)
    spec = model if isinstance(model, str | Path) else ""
    inputs = [path for path in model_files(spec) if path.is_file()]
    return result.of_prediction(table, circuit, result.model_beside(spec), seed, inputs, result.model_scales(spec))


@public
def biases(
    tables: str | Path | Sequence[str | Path],
    *,
    laws: str | Path | None = None,
    at: str | Sequence[str] = (),
    quantity: str | Sequence[str] = (),
    bias: str | Sequence[str] = (),
    unit: str | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> BiasLaws:
    """Fit laws of bias codes to tables of dead times, thresholds, cutoffs or latencies, or evaluate saved laws on them.

    Args:
        tables: CSV files with columns bias_… and a quantity, and .npz files of threshold maps.
        laws: folder of an earlier result, evaluated instead of a fit.
        at: settings to predict, "bias_refr=10" each.
        quantity: columns that were measured; by default the one that is named as a quantity.
        bias: columns of codes; by default those named bias_….
        unit: of the quantity (s, ms, us, ns, hz, khz, mhz, log); by default as its column's name ends.
        seed: of the draws behind intervals.
        progress: called with what is done and the fraction.

    Returns:
        A law per quantity with its rivals, parameters, rows and predictions.

    Raises:
        InputError: tables that are ambiguous or too small, or codes that no law is of.

    Example:
        >>> import pixelid as px
        >>> px.biases("dead_time_vs_refr.csv", at="bias_refr=10").content["predictions"]  # doctest: +SKIP
    """
    from pixelid.tables.biases.reading import Stated
    from pixelid.tables.biases.result import bias_laws

    def each(given: str | Path | Sequence[str | Path]) -> tuple[str, ...]:
        return (str(given),) if isinstance(given, str | Path) else tuple(map(str, given))

    return bias_laws(
        [Path(path) for path in each(tables)], laws=None if laws is None else Path(laws), at=each(at),
        stated=Stated(each(quantity), each(bias), unit), seed=seed, progress=progress,
    )  # fmt: skip


def _file(path: str | Path) -> Path:
    if not Path(path).exists():
        raise InputError(f"{path}: no such file")
    return Path(path)
