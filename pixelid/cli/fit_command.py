"""`pixelid fit`: fit a circuit to recordings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

EXAMPLE = """
\b
Example:
    pixelid simulate dvs128 --stimulus chirp --out chirp.h5 --pixels 9
    pixelid simulate dvs128 --stimulus steps --out steps.h5 --pixels 9
    pixelid fit chirp.h5 steps.h5 --model dvs128 --out fit
    pixelid fit fits/session.toml --out fit
"""


@click.command("fit", epilog=EXAMPLE)
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--model", help="A shipped model, a model file, or a fit folder.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder for the result.")
@click.option("--with", "with_", multiple=True, metavar="EFFECT[:param=value,…]", help="Add an effect.")
@click.option("--without", multiple=True, metavar="EFFECT", help="Remove an effect.")
@click.option("--fix", multiple=True, metavar="NAME=VALUE", help="Hold a parameter at a value.")
@click.option("--gauge", multiple=True, metavar="NAME=VALUE", help='E.g. q_in=0.875 or "A_loop=0.7 A_amp".')
@click.option("--between", type=click.Choice(["auto", "linear", "smooth"]), default="auto", show_default=True,
              help="How a sampled stimulus runs between its samples; auto asks the events.")  # fmt: skip
@click.option("--engine", type=click.Choice(["casadi", "torch", "scipy"]),
              help="What maximises (default: casadi); all find the same optimum.")  # fmt: skip
@click.option("--form", type=click.Choice(["discrete", "continuous"]),
              help="Linearised once per stimulus step (default), or continuous in time (slower).")  # fmt: skip
@click.option("--sample", is_flag=True, help="Also draw from the posterior: posterior.nc, corner and trace plots.")
@click.option("--profile", is_flag=True, help="Also profile every parameter: bounded, one-sided or flat.")
@click.option("--overwrite", is_flag=True, help="Replace --out when it exists.")
@click.option("--seed", type=int, default=0, show_default=True)
@click.option("--quiet", is_flag=True, help="No progress, no table.")
def command(
    recordings, model, out, with_, without, fix, gauge, between, engine, form, sample, profile, overwrite, seed, quiet
):
    """Fit a circuit to RECORDINGS (files or folders), or run a RECIPE.toml of fits/.

    Recordings with pixels use the event-time likelihood, pooled ones the pooled-rate likelihood.
    Writes fit.json, model.toml (the fitted model), figures and report.html.
    """
    from pixelid.cli.progress import bar
    from pixelid.errors import InputError
    from pixelid.fit.recipe import Recipe, read_recipe
    from pixelid.outputs import refuse_existing

    refuse_existing(out, overwrite)
    if len(recordings) == 1 and recordings[0].suffix == ".toml":
        if model or with_ or without or fix or gauge:
            raise InputError("a recipe brings its own model and options; edit the recipe instead")
        recipe = read_recipe(recordings[0])
        recipe = replace(recipe, sample=recipe.sample or sample, profile=recipe.profile or profile)
    else:
        if not model:
            raise InputError("--model is missing: a shipped model (see `pixelid models`), a file or a fit folder")
        recipe = Recipe.of(recordings, model, with_, without, fix, gauge, between, seed, sample, profile)
    if engine:
        recipe = replace(recipe, engine=engine)
    if form:
        recipe = replace(recipe, form=form)
    with bar(quiet) as report:
        result = recipe.run(out, overwrite, report)
    if not quiet:
        from rich.console import Console

        from pixelid.fit.table import fit_table

        console = Console()
        for remark in recipe.remarks():
            console.print(remark)
        console.print(fit_table(result))
        console.print(f"{result.status} in {result.seconds:.1f} s; {out / 'report.html'}", highlight=False)
        for sentence in (result.advice, *result.unidentified):
            if sentence:
                console.print(f"- {sentence}", highlight=False)
    return 0 if result.status == "converged" else 1
