"""`pixelid models`: the shipped circuits, or one of them in full."""

from __future__ import annotations

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid models
    pixelid models dvs128
    pixelid models imx636 --bias diff_on=-20,refr=10
"""


@click.command("models", epilog=EXAMPLE)
@click.argument("name", required=False)
@click.option(
    "--bias", multiple=True, metavar="BIAS=CODE,…", help="At this setting, of the circuit's laws of bias codes."
)
@options.as_json
@options.no_seed
@click.option("--quiet", is_flag=True, help="Print names and values only.")
def command(name: str | None, bias: tuple[str, ...], as_json: bool, seed: int, quiet: bool) -> None:
    """List the shipped circuits, or print the circuit NAME (shipped, .toml file or fit folder) with units and gauge."""
    import json

    from pixelid.model.files import load_model, to_document
    from pixelid.model.shipped import find_model, shipped_models

    models = [load_model(path) for path in shipped_models().values()] if name is None else [find_model(name)]
    if bias:
        models = [_at_setting(models[0], name, bias)]
    if as_json:
        documents = [to_document(model) for model in models]
        click.echo(json.dumps(documents if name is None else documents[0], indent=2, ensure_ascii=False))
    elif quiet and name is None:
        click.echo("\n".join(model.name for model in models))
    elif quiet:
        click.echo("\n".join(f"{key} = {value:.10g}" for key, value in models[0].values.items()))
    elif name is None:
        from pixelid.cli.terminal import say

        say(*_overview(models), "`pixelid models NAME` prints one with its effects, values and sources.")
    else:
        from rich.console import Console

        _print_one(Console(markup=False), models[0])  # sources contain words in brackets


def _at_setting(model, name: str | None, bias: tuple[str, ...]):
    """The circuit NAME at a setting of its biases."""
    from pixelid.biases.laws import stated_codes
    from pixelid.biases.saved import read_laws
    from pixelid.errors import InputError
    from pixelid.fit.bias_priors import model_at
    from pixelid.model.shipped import shipped_bias_laws

    file = shipped_bias_laws(name) if name else None
    if file is None:
        raise InputError(f"--bias: expected a circuit with laws of bias codes, as imx636, found {name or 'none'}")
    laws = read_laws(file)
    known = list(dict.fromkeys(code for quantity in laws.values() for code in quantity.codes))
    return model_at(model, laws, stated_codes(bias, known, "--bias"))


def _overview(models) -> list[str]:
    """One line for each: name, light's unit, and what it is, as far as the terminal is wide."""
    from pixelid.cli.terminal import columns

    names = max(len(model.name) for model in models)
    units = max(len(model.radiance_unit) for model in models)
    lines = [f"{model.name:{names}}  {model.radiance_unit:{units}}  {model.summary}" for model in models]
    width = columns()
    return lines if width is None else [line if len(line) <= width else f"{line[: width - 1]}…" for line in lines]


def _names(head: str, names):
    """A column of names that nothing makes narrower."""
    from rich.table import Column

    most_of_names = 34  # columns: the library's in one line, a described effect's in two
    return Column(head, width=min(max(map(len, [head, *names])), most_of_names), overflow="fold")


def _print_one(console, model) -> None:
    from rich.table import Column, Table

    from pixelid import stages

    console.print(f"{model.name}: {model.summary}", style="bold", highlight=False)
    console.print(
        f"photoreceptor {model.photoreceptor}, linearised at the {model.linearisation} of each step, "
        f"radiance in {model.radiance_unit}",
        highlight=False,
    )
    one_table = 110  # columns of a terminal from which on a value and where it comes from fit in one line
    wide = console.width >= one_table
    last = ["source"] if wide else []
    value, unit, free = (Column(head, no_wrap=True) for head in ("value", "unit", "free"))
    table = Table(_names("parameter", model.parameters), value, unit, "bounds", free, *last)
    sources = Table(_names("parameter", model.parameters), "source")
    for p in model.parameters.values():
        bounds = f"{p.lower:g}…{p.upper:g}"
        table.add_row(
            p.name, f"{p.value:.6g}", p.unit, bounds, "yes" if p.free else "no", *([p.source] if wide else [])
        )
        sources.add_row(p.name, p.source)
    console.print(table)
    if not wide:
        console.print(sources)
    effects = Table(_names("effect", model.effects), "what it does", "equation", *last)
    for name in model.effects:
        effect = stages.effect(name)
        effects.add_row(name, effect.sentence, effect.equation, *([effect.source] if wide else []))
    console.print(effects)
    if model.physical is not None:
        physical = Table("physical value", "nominal", "gauge", title=model.physical_source)
        gauge = model.gauge.statements()
        for name, value in model.physical.as_dict().items():
            physical.add_row(name, f"{value:.6g}", str(gauge.get(name, "")))
        console.print(physical)
    elif model.gauge.statements():
        console.print("gauge: " + ", ".join(f"{key} = {value}" for key, value in model.gauge.statements().items()))
