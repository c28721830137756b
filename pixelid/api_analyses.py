"""What `import pixelid` shows with fits and searches: low light, the next stimulus, and reconstructions."""
# pyright: reportUnnecessaryIsInstance=false
# what users give is checked, whatever the annotations promise

from __future__ import annotations

import tempfile
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pixelid.nerf.options import Options as Reconstructing
from pixelid.options import takes
from pixelid.public import public

if TYPE_CHECKING:
    from pixelid.api import Progress
    from pixelid.design.result import DesignReport
    from pixelid.design.waveform import Waveform
    from pixelid.fit.result import FitResult
    from pixelid.gap.result import GapReport
    from pixelid.inputs import ModelLike, RecordingsLike
    from pixelid.lowlight.result import LowlightReport
    from pixelid.nerf.field.radiance import Field
    from pixelid.nerf.reconstruct import Reconstruction
    from pixelid.recordings.recording import Recording
    from pixelid.tables.biases.result import BiasLaws


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


@public
def lowlight(
    model: ModelLike,
    recordings: RecordingsLike = (),
    *,
    latency: str | Path | Sequence[str | Path] = (),
    camera: str | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> LowlightReport:
    """Say where one pole describes a photoreceptor, and where it does not.

    Args:
        model: the circuit; a fit folder brings its uncertainty, drawn as bands.
        recordings: of chirps or steps, whose bandwidth or step time is compared with the model's; none by default.
        latency: tables of the sensor's latencies, a recipe, or the folder of a finished fit; none by default.
        camera: which of the tables' cameras the model is.
        seed: of draws and simulations.
        progress: called with what is done and the fraction.

    Returns:
        Radiances where the approximations err, curves, and what recordings say.

    Raises:
        InputError: a photoreceptor without bandwidth.

    Example:
        >>> import pixelid as px
        >>> px.lowlight("dvs128").status
        <Status.converged: 'converged'>
    """
    from pixelid.inputs import as_model
    from pixelid.lowlight.result import lowlight_report

    fitted, sources = _fit_and_files(model)
    tables = [latency] if isinstance(latency, str | Path) else list(latency)
    return lowlight_report(
        as_model(model), _opened(recordings), fitted=fitted, sources=sources, latency=[Path(t) for t in tables],
        camera=camera, seed=seed, progress=progress,
    )  # fmt: skip


@public
def design(
    model: ModelLike,
    recordings: RecordingsLike = (),
    *,
    criterion: str = "D",
    menu: str | Path | None = None,
    pixels: int | None = None,
    draws: int = 4,
    spread: float | None = None,
    per_second: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> DesignReport:
    """Say which stimulus to record next to learn most about a circuit.

    Args:
        model: the circuit; a fit folder brings what is known already.
        recordings: that there are already; none by default.
        criterion: what is to shrink: "D" (all), "A" (the mean), or one parameter.
        menu: a TOML file of [[stimulus]] tables; a default menu otherwise.
        pixels: that would record, when neither recordings nor a fit say so; 25 by default.
        draws: parameter values averaged over.
        spread: their standard deviation in ln, without a fit.
        per_second: rank by score per second of light.
        seed: of draws and simulations.
        progress: called with what is done and the fraction.

    Returns:
        The ranked menu, and the intervals to expect with the best.

    Raises:
        InputError: an unknown criterion, options that exclude each other, a model that has no event-time likelihood.

    Example:
        >>> import pixelid as px
        >>> px.design("dvs128", criterion="gamma").stimulus  # doctest: +SKIP
    """
    from pixelid.design.result import design_report
    from pixelid.inputs import as_model

    fitted, sources = _fit_and_files(model)
    return design_report(
        as_model(model), _opened(recordings), fitted=fitted, sources=sources, criterion=criterion,
        menu=None if menu is None else Path(menu), pixels=pixels, draws=draws, spread=spread, per_second=per_second,
        seed=seed, progress=progress,
    )  # fmt: skip


@public
def stimulus(
    source: str | Path,
    *,
    seconds: float | None = None,
    level: float | None = None,
    contrast: float | None = None,
    top_hz: float | None = None,
    model: ModelLike | None = None,
    parameters: Mapping[str, float] | None = None,
    rate_hz: float = 48_000.0,
    rest_s: float = 1.0,
    unit: str | None = None,
    seed: int | None = None,
) -> Waveform:
    """A waveform for a generator or a sound card, with the trigger edges that mark its ends.

    Args:
        source: a built-in shape ("chirp", "steps", "slow", "constant", …), an entry of the model's menu, a stimulus
            file, or the folder of a design, whose recommendation it is.
        seconds: of light; the shape's own by default.
        level: mean light; with a model the brightest of its menu by default.
        contrast: the shape's modulation.
        top_hz: where a chirp ends; with a model its −3 dB frequency at this level by default.
        model: the circuit that the waveform is for; the light is in its unit.
        parameters: further ones of the shape, as {"hold_s": 0.01}.
        rate_hz: samples per second.
        rest_s: seconds at the first value before the light, for the pixel to come to rest.
        unit: of the light, when not the model's.
        seed: of random steps and phases.

    Returns:
        The waveform; `.save("chirp.wav")` writes it.

    Raises:
        InputError: an unknown name or parameter, light of each pixel's own, a chirp too fast for the rate.

    Example:
        >>> import pixelid as px
        >>> px.stimulus("chirp", level=24.0, model="dvs128").stimulus.duration_s
        0.8
    """
    from pixelid.design.waveform import waveform
    from pixelid.inputs import as_model

    asked = {"duration_s": seconds, "level": level, "modulation": contrast, "stop_hz": top_hz, "seed": seed}
    asked = {name: value for name, value in asked.items() if value is not None}
    return waveform(
        source, model=None if model is None else as_model(model), parameters={**(parameters or {}), **asked},
        rate_hz=rate_hz, rest_s=rest_s, unit=unit,
    )  # fmt: skip


@public
@takes(Reconstructing)
def reconstruct(
    dataset: str | Path,
    *,
    resume: str | Path | None = None,
    preview: str | Path | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Reconstruction:
    """Reconstruct a scene from motion-blurred events, through the identified pixel.

    Args:
        dataset: a folder in the published layout of Robust e-NeRF and Deblur e-NeRF.
        **options
        resume: a checkpoint, continued when it exists and written as training goes on.
        preview: a PNG of the scene, replaced as training goes on; another picture of that name is refused.
        progress: called with what is done and the fraction.

    Returns:
        The scene, with the scores of its test views.

    Raises:
        InputError: a dataset or options that cannot be used.

    Example:
        >>> import pixelid as px
        >>> px.reconstruct("scene/", fit="fit/")  # doctest: +SKIP
    """
    from pixelid.nerf.data.dataset import read_dataset
    from pixelid.nerf.reconstruct import reconstruct as run

    with _as_file(options.pop("fit", None)) as file:
        asked = Reconstructing(fit=file, **options)
        return run(
            read_dataset(Path(dataset)), asked, resume=None if resume is None else Path(resume),
            preview=None if preview is None else Path(preview), progress=progress or (lambda what, share: None),
        )  # fmt: skip


@public
def view(model: ModelLike, out: str | Path, *, open: bool = False, overwrite: bool = False) -> Path:
    """Write a page with a pixel to play with: drag light, thresholds or bandwidth, and its events move.

    Args:
        model: the circuit that the page begins with; it has the shipped ones as well.
        out: the page to write; it needs no server.
        open: show it in the browser.
        overwrite: replace a page that is there.

    Returns:
        The path of the page.

    Raises:
        InputError: an unknown model, a folder that holds a scene and no pixel, a page that is there already.

    Example:
        >>> import pixelid as px
        >>> px.view("dvs128", "pixel.html", open=True)  # doctest: +SKIP
    """
    from pixelid.inputs import as_model
    from pixelid.report.pixel_view import refuse_scene, write_view

    if isinstance(model, str | Path):
        refuse_scene(model)
    write_view(as_model(model), Path(out), overwrite=overwrite)
    if open:
        import webbrowser

        webbrowser.open(Path(out).resolve().as_uri())
    return Path(out)


def load_field(folder: str | Path) -> Field:
    """The scene of a reconstruction's folder, to render or to look at.

    Args:
        folder: that `pixelid reconstruct` or `.save` wrote.

    Returns:
        The field: `field(rays)` gives radiance and opacity, `field.dense()` log density and log radiances at the
        vertices, and the harmonics.

    Raises:
        InputError: no scene there, or a damaged one.

    Example:
        >>> import pixelid as px
        >>> px.load_field("sharp/").vertices  # doctest: +SKIP
    """
    from pixelid.nerf.shown.saved import read_field

    return read_field(Path(folder))


@contextmanager
def _as_file(fit: ModelLike | FitResult | GapReport | None) -> Generator[Path | None]:
    """The folder or file of a fit or a model; one in memory goes to a temporary folder, for as long as the block."""
    from pixelid.inputs import as_model
    from pixelid.model.files import save_model
    from pixelid.model.shipped import shipped_models
    from pixelid.results import Result

    if fit is None or (isinstance(fit, str | Path) and str(fit) not in shipped_models()):
        yield None if fit is None else Path(fit)
        return
    with tempfile.TemporaryDirectory() as name:
        if isinstance(fit, Result):
            fit.write(name)
        else:
            save_model(as_model(fit), Path(name) / "model.toml")
        yield Path(name)


def _fit_and_files(model: ModelLike) -> tuple[dict[str, Any] | None, list[Path]]:
    """The fit that a folder holds, and the files that a model comes from; neither for a model in memory."""
    from pixelid.fit.draws import read_fit
    from pixelid.model.shipped import model_files

    return (read_fit(Path(model)), model_files(model)) if isinstance(model, str | Path) else (None, [])


def _opened(recordings: RecordingsLike) -> list[Recording]:
    """The recordings, of which there may be none."""
    from pixelid.inputs import as_recordings

    if isinstance(recordings, Sequence) and len(recordings) == 0 and not isinstance(recordings, str):
        return []
    return as_recordings(recordings)
