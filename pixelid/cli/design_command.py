"""`pixelid design`: which stimulus to record next, and why."""

from __future__ import annotations

from pathlib import Path

import click

from pixelid.cli import options

POSITIVE = options.Number(0.0, open_low=True)
OF_BIASES = ("bias", "bandwidth", "noise", "rate", "frequency")
OF_STIMULI = ("criterion", "recorded", "menu", "pixels", "draws", "spread", "per_second")
EXAMPLE = """
\b
Example:
    pixelid design dvs128 --out design
    pixelid simulate dvs128 --stimulus chirp --out chirp.h5 --pixels 9
    pixelid design dvs128 --recorded chirp.h5 --criterion gamma --out design-gamma
    pixelid rates rate_vs_bias.csv --bias-law --out rates
    pixelid design rates --biases --bandwidth 1000 --noise 50 --out biases
"""


@click.command("design", epilog=EXAMPLE)
@click.argument("model")
@options.out()
@click.option(
    "--criterion", default="D", show_default=True, metavar="D|A|PARAMETER", help="Which uncertainty to reduce."
)
@click.option("--recorded", multiple=True, metavar="REC", type=options.PATH,
              help="A recording (or folder) there is already; repeatable.")  # fmt: skip
@click.option("--menu", type=options.PATH, metavar="FILE", help="TOML of [[stimulus]] tables.")
@click.option("--pixels", type=options.PIXELS, help="Pixels that would record [those recorded or fitted, else 25].")
@click.option(
    "--draws", type=click.IntRange(1, 10_000), default=4, show_default=True, help="Parameter values averaged over."
)
@click.option("--spread", type=options.Number(0.0, 10.0), help="Their standard deviation in ln, without a fit [0.2].")
@click.option("--per-second", is_flag=True, help="Rank by information per second of light.")
@click.option(
    "--biases", is_flag=True, help="MODEL is a folder of `rates --bias-law`: recommend a setting of its bias."
)
@click.option("--bias", metavar="NAME", help="Which bias, with --biases [the fitted one].")
@click.option("--bandwidth", type=POSITIVE, metavar="HZ", help="Minimum cutoff, with --biases.")
@click.option("--noise", type=POSITIVE, metavar="HZ", help="Maximum rate of noise events per pixel.")
@click.option("--rate", type=POSITIVE, metavar="HZ", help="Maximum rate of events per pixel.")
@click.option("--frequency", type=POSITIVE, metavar="HZ", help="Of the light that --rate is of [--bandwidth].")
@options.reading
@options.overwrite
@options.seed("Of the draws and simulations.")
@options.quiet
@click.pass_context
def command(context, model, out, criterion, recorded, menu, pixels, draws, spread, per_second, biases, bias, bandwidth,
            noise, rate, frequency, overwrite, seed, quiet):  # fmt: skip
    """Say which stimulus to record next to learn most about MODEL (shipped, .toml or fit folder).

    Writes design.json, next.toml (the recommended stimulus), figures and report.html. With --biases, say instead which
    setting of a bias gives the bandwidth, noise and events that are wanted, and how surely.
    """
    _check_options(context, biases)
    if biases:
        wanted = {"bandwidth": bandwidth, "noise": noise, "rate": rate}
        wanted = {name: value for name, value in wanted.items() if value is not None}
        return _recommend_setting(model, out, wanted, bias, frequency, overwrite, seed, quiet)
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say_result
    from pixelid.outputs import claimed

    with claimed(out, overwrite, [*recorded, model, *([menu] if menu else [])]):
        from pixelid.inputs import check_given

        check_given(recorded, [model])
        from pixelid.fit.draws import read_fit
        from pixelid.model.shipped import find_model, model_files
        from pixelid.recordings import open_recordings

        circuit, fitted, opened = find_model(model), read_fit(Path(model)), open_recordings(recorded)
        from pixelid.design.result import design_report

        with bar(quiet, compiles=True) as report:
            result = design_report(
                circuit, opened, fitted=fitted, sources=model_files(model), criterion=criterion, menu=menu,
                pixels=pixels, draws=draws, spread=spread, per_second=per_second, seed=seed, progress=report,
            )  # fmt: skip
            result.report(out, overwrite=overwrite)
    if not quiet:
        say_result(result, out)
    return result.status.exit_code


def _check_options(context: click.Context, biases: bool) -> None:
    """Refuse options of the one question with the other."""
    from pixelid.errors import InputError

    for name in OF_STIMULI if biases else OF_BIASES:
        if options.is_given(context, name):
            option = f"--{name.replace('_', '-')}"
            raise InputError(f"{option}: not with --biases" if biases else f"{option}: expected --biases with it")


def _recommend_setting(model, out, wanted, bias, frequency, overwrite, seed, quiet):
    """`pixelid design FOLDER --biases`."""
    from pixelid.cli.terminal import say_result
    from pixelid.errors import InputError
    from pixelid.outputs import claimed

    if not wanted:
        raise InputError("--biases: expected one or more of --bandwidth, --noise and --rate with it")
    if frequency is not None and "rate" not in wanted:
        raise InputError("--frequency: is that of the light that --rate counts events of; expected --rate with it")
    with claimed(out, overwrite, [model]):
        from pixelid.design.bias_result import bias_report

        result = bias_report(Path(model), wanted, bias=bias, frequency_hz=frequency, seed=seed)
        result.report(out, overwrite=overwrite)
    if not quiet:
        say_result(result, out)
    return result.status.exit_code
