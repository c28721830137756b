"""`pixelid stimulus`: a waveform for a generator or sound card."""

from __future__ import annotations

from pathlib import Path

import click

from pixelid.cli import options

POSITIVE = options.Number(0.0, open_low=True)
EXAMPLE = """
\b
Example:
    pixelid stimulus chirp --level 400 --top-hz 800 --out bright_chirp.wav
    pixelid stimulus steps --level 24 --unit lux --out dim_steps.csv --rate 20000
    pixelid stimulus chirp --for dvs128 --level 24 --out dim_chirp.wav
    pixelid stimulus next.toml --out next.wav --bits 24        # next.toml of `pixelid design`, or its folder
"""


@click.command("stimulus", epilog=EXAMPLE)
@click.argument("source", metavar="NAME|FILE")
@options.out("File to write, .wav or .csv.", metavar="FILE.wav|.csv")
@click.option("--for", "model", metavar="MODEL",
              help="Choose level and top frequency for this circuit, in its unit of light.")  # fmt: skip
@click.option("--seconds", type=POSITIVE, metavar="S", help="Duration of the light.")
@click.option("--level", type=POSITIVE, metavar="LIGHT", help="Mean light.")
@click.option("--contrast", type=POSITIVE, metavar="M", help="Modulation of the light.")
@click.option("--top-hz", type=POSITIVE, metavar="HZ", help="Where a chirp ends [with --for: the -3 dB frequency].")
@click.option("--unit", metavar="UNIT", help="Of the light: lux, W/m2, fA, ….")
@click.option("--set", "set_", multiple=True, metavar="name=value", help="Any other parameter of the shape.")
@click.option("--rate", type=POSITIVE, default=48_000.0, show_default=True, metavar="HZ", help="Samples per second.")
@click.option("--bits", type=click.Choice(["16", "24"]), default="16", show_default=True, help="Of a .wav's samples.")
@click.option("--rest", type=options.Number(0.0), default=1.0, show_default=True, metavar="S",
              help="Seconds at the first value before the light.")  # fmt: skip
@click.option("--overwrite", is_flag=True, help="Replace the files.")
@options.seed("Of random steps and phases [the shape's own].", default=None, show_default=False)
@options.quiet
def command(
    source: str,
    out: Path,
    model: str | None,
    seconds: float | None,
    level: float | None,
    contrast: float | None,
    top_hz: float | None,
    unit: str | None,
    set_: tuple[str, ...],
    rate: float,
    bits: str,
    rest: float,
    overwrite: bool,
    seed: int | None,
    quiet: bool,
) -> None:
    """Write a waveform for a generator or sound card: a built-in shape (chirp, steps, slow, constant, sine, pulse,
    edge), a .toml stimulus, a recording's light, or the recommendation of `pixelid design`.

    A .wav is stereo: left the light (full scale: its brightest value; the output must be DC coupled), right the
    trigger. A .csv has the columns t_s, light, trigger. The trigger rises at the light's first sample and at its last.
    The light that is to be expected goes to NAME_light.csv.
    """
    from pixelid.cli.terminal import columns, say
    from pixelid.outputs import claimed
    from pixelid.results import wrapped

    with claimed(out, overwrite, [source]):
        from pixelid.api_models import stimulus
        from pixelid.design.waveform_files import check_name, full_scale
        from pixelid.model.options import assignments

        check_name(out)
        wave = stimulus(
            source, seconds=seconds, level=level, contrast=contrast, top_hz=top_hz, model=model,
            parameters=assignments("--set", set_), rate_hz=rate, rest_s=rest, unit=unit, seed=seed,
        )  # fmt: skip
        trace = wave.save(out, bits=int(bits), overwrite=overwrite)
    if not quiet:
        scale = f"; full scale is {full_scale(wave):.6g} {wave.stimulus.unit}" if out.suffix.lower() == ".wav" else ""
        lines = (
            f"{out}: {rest:g} s of rest, then {wave.stimulus!r}; {rate:g} samples/s{scale}",
            "the trigger rises at the light's first sample and at its last: --align trigger",
            f"{trace}: the light to expect, from the first trigger edge on",
        )
        say(*(wrapped(line, columns()) for line in lines))
