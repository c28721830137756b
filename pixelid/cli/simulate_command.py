"""`pixelid simulate`: events of a circuit under a stimulus."""

from __future__ import annotations

from pathlib import Path

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid simulate dvs128 --stimulus chirp --out chirp.h5 --pixels 100
    pixelid simulate dvs128 --stimulus light.toml --out dark.h5 --with dark_current:radiance=4 --with leak
"""


@click.command("simulate", epilog=EXAMPLE)
@click.argument("model")
@click.option("--stimulus", metavar="S", required=True, help="Recording, .toml stimulus or built-in name.")
@options.out("Recording to write.", metavar="REC.h5")
@click.option("--pixels", type=int, help="Number of pixels under full-field light, in a nearly square sensor [25].")
@options.with_effect
@options.without
@options.set_value
@click.option("--synchronous", is_flag=True, help="Start all pixels in phase.")
@click.option("--condition", default="", help="Label of the recording; default: the stimulus.")
@click.option("--threads", type=click.IntRange(1, 1024), help="Default: one per core; results do not depend on it.")
@click.option("--overwrite", is_flag=True, help="Replace the recording --out.")
@options.seed("Of every random draw.")
@click.option("--sensor-seed", type=options.SEED, help="Of the pixels' thresholds and hot pixels; default: --seed.")
@options.quiet
@options.said
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
    from pixelid.cli.terminal import say
    from pixelid.errors import printable
    from pixelid.outputs import claimed
    from pixelid.recordings.writing import check_writable

    check_writable(out)
    with claimed(out, overwrite, [stimulus, model]):
        from pixelid.model.options import changed
        from pixelid.model.shipped import find_model
        from pixelid.recordings import write_recording
        from pixelid.stimuli.files import load_stimulus

        circuit_model, remarks = changed(find_model(model), with_, without, set_)
        light = load_stimulus(stimulus)
        from pixelid.api import simulate

        with bar(quiet, compiles=True) as report:
            recording = simulate(
                circuit_model, light, pixels=pixels, seed=seed, sensor_seed=sensor_seed, synchronous=synchronous,
                threads=threads, progress=report,
            )  # fmt: skip
        recording = replace(recording, condition=printable(condition) or Path(stimulus).stem)
        write_recording(recording, out, overwrite=overwrite)
    if not quiet:
        events = recording.events
        size = f"{events.width} x {events.height} pixels"
        say(*remarks, f"{out}: {len(events)} events of {size} in {light.duration_s:g} s")
