"""`pixelid fit`: fit a circuit to recordings."""

from __future__ import annotations

from dataclasses import replace

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid simulate dvs128 --stimulus chirp --out chirp.h5 --pixels 9
    pixelid simulate dvs128 --stimulus steps --out steps.h5 --pixels 9
    pixelid fit chirp.h5 steps.h5 --model dvs128 --out fit
    pixelid fit session.toml --out fit
"""


@click.command("fit", epilog=EXAMPLE)
@options.recordings
@options.model(required=False)
@options.out()
@options.with_effect
@options.without
@options.fix
@options.gauge
@click.option("--between", type=click.Choice(["auto", "linear", "smooth"]), default="auto", show_default=True,
              help="How a sampled stimulus runs between its samples; auto asks the events.")  # fmt: skip
@click.option("--engine", type=click.Choice(["casadi", "torch", "scipy"]),
              help="What maximises (default: casadi); all find the same optimum.")  # fmt: skip
@click.option("--form", type=click.Choice(["discrete", "continuous"]),
              help="Linearised once per stimulus step (default), or continuous in time (slower).")  # fmt: skip
@options.pixel_levels
@click.option("--bias-priors", is_flag=True,
              help="Priors of thresholds, dead time and cutoff from the biases of jAER's header.")  # fmt: skip
@click.option("--bias-laws", type=options.PATH,
              help="The same from the laws of a `pixelid biases` folder, at the codes of .bias files.")  # fmt: skip
@options.crop
@options.reading
@click.option("--sample", is_flag=True, help="Also draw from the posterior: posterior.nc, corner and trace plots.")
@click.option("--profile", is_flag=True, help="Also profile every parameter: bounded, one-sided or flat.")
@options.overwrite
@options.seed()
@options.quiet
def command(
    recordings, model, out, with_, without, fix, gauge, between, engine, form, pixel_levels, bias_priors, bias_laws,
    crop, sample, profile, overwrite, seed, quiet,
):  # fmt: skip
    """Fit a circuit to RECORDINGS (files or folders), or as a RECIPE.toml says.

    Recordings with pixels use the event-time likelihood, pooled ones the pooled-rate likelihood.
    Writes fit.json, model.toml (the fitted model), figures and report.html.
    """
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say_result
    from pixelid.documents import read_toml
    from pixelid.errors import InputError
    from pixelid.inputs import check_given
    from pixelid.interruption import keeping
    from pixelid.outputs import claimed, refuse_inputs

    by_recipe = len(recordings) == 1 and recordings[0].suffix == ".toml"
    if by_recipe and (model or with_ or without or fix or gauge):
        raise InputError("a recipe brings its own model and options; edit the recipe instead")
    if not by_recipe and not model:
        raise InputError("--model is missing: a shipped model (see `pixelid models`), a file or a fit folder")
    if bias_priors and bias_laws:
        raise InputError("--bias-laws: not with --bias-priors, which are by other formulas")
    if by_recipe:
        read_toml(recordings[0])
    else:
        check_given(recordings, [model], with_=with_, without=without)
    with claimed(out, overwrite, [*recordings, *([model] if model else [])]):
        from pixelid.fit.recipe import Recipe, chain_beside, read_recipe

        if by_recipe:
            recipe = read_recipe(recordings[0])
            recipe = replace(recipe, sample=recipe.sample or sample, profile=recipe.profile or profile)
            context = click.get_current_context()
            recipe = replace(
                recipe, crop=recipe.crop.with_(crop),
                between=between if options.is_given(context, "between") else recipe.between,
                seed=seed if options.is_given(context, "seed") else recipe.seed,
            )  # fmt: skip
            refuse_inputs(out, [*recipe.recordings, recipe.model])
        else:
            recipe = Recipe.of(recordings, model, with_, without, fix, gauge, between, seed, sample, profile)
            recipe = replace(recipe, crop=crop)
        if engine:
            recipe = replace(recipe, engine=engine)
        if form:
            recipe = replace(recipe, form=form)
        if pixel_levels:
            recipe = replace(recipe, pixel_levels=pixel_levels)
        if bias_priors or bias_laws:
            recipe = replace(recipe, bias_priors=str(bias_laws) if bias_laws else True)
        with keeping(chain_beside(out), "the chains"), bar(quiet, compiles=True) as report:
            result = recipe.run(out, overwrite, report)
    if not quiet:
        say_result(result, out, recipe.remarks())
    return result.status.exit_code
