"""`pixelid simulate`: events of a circuit under a stimulus."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLE = """
\b
Example:
    pixelid simulate dvs128 --stimulus chirp --out chirp.h5 --pixels 100
    pixelid simulate dvs128 --stimulus light.toml --out dark.h5 --with dark_current:radiance=4 --with leak
"""


@click.command("simulate", epilog=EXAMPLE)
@click.argument("model")
@click.option("--stimulus", metavar="S", required=True, help="Recording, .toml stimulus or built-in name.")
@click.option("--out", metavar="REC.h5", required=True, type=click.Path(path_type=Path), help="Recording to write.")
@click.option("--pixels", type=int, help="Number of pixels under full-field light, in a nearly square sensor [25].")
@click.option("--with", "with_", metavar="EFFECT[:param=value,…]", multiple=True, help="Add an effect.")
@click.option("--without", metavar="EFFECT", multiple=True, help="Remove an effect.")
@click.option("--set", "set_", metavar="name=value", multiple=True, help="Set a parameter.")
@click.option("--synchronous", is_flag=True, help="Every pixel takes its first reference at t = 0; no random start.")
@click.option("--condition", default="", help="Label of the recording; default: the stimulus.")
@click.option("--threads", type=click.IntRange(1), help="Default: one per core; results do not depend on it.")
@click.option("--overwrite", is_flag=True, help="Replace --out when it exists.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of every random draw.")
@click.option("--sensor-seed", type=int, help="Of the pixels' thresholds and hot pixels; default: --seed.")
@click.option("--quiet", is_flag=True, help="Print nothing.")
def command(
    model: str,
    stimulus: str,
    out: Path,
    pixels: int | None,
    with_: tuple[str, ...],
    without: tuple[str, ...],
    set_: tuple[str, ...],
    synchronous: bool,
    condition: str,
    threads: int | None,
    overwrite: bool,
    seed: int,
    sensor_seed: int | None,
    quiet: bool,
) -> None:
    """Simulate the circuit MODEL (a shipped name, a .toml file or a fit folder) under a stimulus.

    The sensor of a video stimulus has the video's size.
    """
    from dataclasses import replace

    from pixelid.cli.progress import bar
    from pixelid.errors import InputError
    from pixelid.model.options import changed
    from pixelid.model.shipped import find_model
    from pixelid.outputs import refuse_existing
    from pixelid.recordings import write_recording
    from pixelid.recordings.writing import check_writable
    from pixelid.stimuli.files import load_stimulus

    check_writable(out)
    refuse_existing(out, overwrite)
    circuit_model, remarks = changed(find_model(model), with_, without, set_)
    light = load_stimulus(stimulus)
    if not light.full_field and pixels is not None:
        raise InputError("--pixels: a video stimulus sets the size of the sensor itself")
    width, height = nearly_square(25 if pixels is None else pixels) if light.full_field else (None, None)
    from pixelid.simulate import simulate

    with bar(quiet) as report:
        recording = simulate(
            circuit_model,
            light,
            width=width,
            height=height,
            seed=_own_luck(seed, light),
            sensor_seed=seed if sensor_seed is None else sensor_seed,
            synchronous=synchronous,
            threads=threads,
            progress=lambda done: report("simulating", done),
        )
    recording = replace(recording, condition=condition or Path(stimulus).stem)
    write_recording(recording, out, overwrite=overwrite)
    if not quiet:
        for remark in remarks:
            click.echo(remark)
        events = recording.events
        size = f"{events.width} x {events.height} pixels"
        click.echo(f"{out}: {len(events)} events of {size} in {light.duration_s:g} s")


def _own_luck(seed: int, light) -> int:
    """A seed that differs from stimulus to stimulus, so that one camera's recordings do not repeat their noise."""
    from zlib import crc32

    return (crc32(light.radiance.tobytes(), crc32(light.t.tobytes())) + seed) % (1 << 31)


def nearly_square(pixels: int) -> tuple[int, int]:
    """(width, height) with width · height = pixels, as square as that allows.

    Raises InputError for less than one pixel and for a side beyond 65536.
    """
    from pixelid.errors import InputError

    if pixels < 1:
        raise InputError(f"--pixels: expected at least 1, found {pixels}")
    height = int(pixels**0.5)
    while pixels % height:
        height -= 1
    if pixels // height > 65536:
        raise InputError(f"--pixels {pixels}: no sensor of that many pixels has sides up to 65536; try a round number")
    return pixels // height, height
