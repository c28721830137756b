"""What `import pixelid` shows of a circuit by itself: low light, what to record next and how, other simulators."""
# pyright: reportUnnecessaryIsInstance=false
# what users give is checked, whatever the annotations promise

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pixelid.public import public

if TYPE_CHECKING:
    from pixelid.api import Progress
    from pixelid.design.bias_result import BiasReport
    from pixelid.design.result import DesignReport
    from pixelid.design.waveform import Waveform
    from pixelid.export.exported import Exported
    from pixelid.inputs import ModelLike, RecordingsLike
    from pixelid.lowlight.result import LowlightReport
    from pixelid.recordings.recording import Recording


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
    bias: str | None = None,
    bandwidth: float | None = None,
    noise: float | None = None,
    rate: float | None = None,
    frequency: float | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> DesignReport | BiasReport:
    """Say which stimulus to record next to learn most about a circuit, or which setting of a bias meets wishes.

    Args:
        model: the circuit; a fit folder brings what is known already.
        recordings: that there are already; none by default.
        criterion: what is to shrink: "D" (all), "A" (the mean), or one parameter.
        menu: a TOML file of [[stimulus]] tables; a default menu otherwise.
        pixels: that would record, when neither recordings nor a fit say so; 25 by default.
        draws: parameter values averaged over.
        spread: their standard deviation in ln, without a fit.
        per_second: rank by score per second of light.
        bias: of the settings, where `model` is a folder of `pixelid rates --bias-law` and a wish is given.
        bandwidth: wish: at least this cutoff [Hz].
        noise: wish: at most this many noise events per second.
        rate: wish: at most this many events per second under a light that blinks.
        frequency: of that light [Hz]; the wished bandwidth by default.
        seed: of draws and simulations.
        progress: called with what is done and the fraction.

    Returns:
        The ranked menu, and the intervals to expect with the best; with wishes, the setting that meets them.

    Raises:
        InputError: an unknown criterion, options that exclude each other, a model that has no event-time likelihood.

    Example:
        >>> import pixelid as px
        >>> px.design("dvs128", criterion="gamma").stimulus  # doctest: +SKIP
    """
    from pixelid.design.result import design_report
    from pixelid.inputs import as_model

    wishes = {"bandwidth": bandwidth, "noise": noise, "rate": rate}
    wishes = {name: value for name, value in wishes.items() if value is not None}
    if wishes:
        from pixelid.design.bias_result import bias_report

        return bias_report(Path(str(model)), wishes, bias=bias, frequency_hz=frequency, seed=seed)
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
def export(
    model: ModelLike,
    to: str,
    out: str | Path | None = None,
    *,
    white: float | None = None,
    level: float | None = None,
    overwrite: bool = False,
    seed: int = 0,
) -> Exported:
    """A circuit in the parameters of another simulator, with what that simulator cannot express.

    Args:
        model: the circuit; of a fit folder, what the fit left open is stated as well.
        to: "v2e", "iebcs", "esim", "deblur-e-nerf" or "dvs-voltmeter".
        out: the simulator's own file to write; a name that ends in .json gives JSON.  None: nothing is written.
        white: radiance of a white pixel, 255 grey levels, in the model's unit; 255 by default.
        level: radiance at which one number stands for what depends on light; `white` by default.
        overwrite: replace a file that is there.
        seed: recorded; nothing here is random.

    Returns:
        Parameters by name, and what is lost, in words.

    Raises:
        InputError: an unknown simulator, a circuit that it cannot express at all, a file that is there.

    Example:
        >>> import pixelid as px
        >>> round(px.export("dvs128", "v2e").parameters["pos_thres"], 2)
        0.25
    """
    from pixelid.export.export import TARGETS, exported, write
    from pixelid.inputs import as_model
    from pixelid.options import one_of
    from pixelid.outputs import refuse_existing, whole_file

    if out is not None:
        refuse_existing(Path(out), overwrite)
    spec = model if isinstance(model, str | Path) else ""
    target = one_of("--to", to.lower(), tuple(TARGETS))
    result = exported(as_model(model), target, white=white, level=level, spec=spec, seed=seed)
    if out is not None:
        with whole_file(Path(out), overwrite) as path:
            write(result, path, as_json=Path(out).suffix == ".json")
    return result


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
