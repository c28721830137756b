"""`pixelid latency`: first-event latencies against irradiance, threshold setting and edge."""

from __future__ import annotations

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid latency fits/nist_latency/nist_latency_by_roi.csv --out latency
    pixelid latency other_irradiances.csv --model latency --predict --out check
    pixelid latency fits/imx636.toml --out imx636
"""


@click.command("latency", epilog=EXAMPLE)
@click.argument("tables", nargs=-1, required=True, type=options.PATH)
@options.out()
@options.model(
    False, "What --predict evaluates, or where a fit begins: a shipped model, a model file, or a fit folder."
)
@click.option("--predict", is_flag=True, help="Evaluate --model on the tables instead of fitting.")
@click.option("--camera", help="Only the rows of this camera.")
@click.option("--sample", is_flag=True, help="Sample the posterior with emcee.")
@options.overwrite
@options.seed("Of the sampling.")
@options.quiet
def command(tables, out, model, predict, camera, sample, overwrite, seed, quiet):
    """Fit TABLES (CSV: camera, lens, polarity, irradiance_W_m2, bias_config, min, median, max, stdev in µs).

    One circuit per camera, radiance in W/m²; thresholds and delays per setting. A recipe (.toml) says which cameras of
    its tables are of one kind, fits them as one, and names the model. Writes latency.json (rows with measured
    and predicted seconds, which stage limits where, what stays open), model.toml (one folder per camera where there are
    several), figures and report.html.
    """
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say, say_page, say_sentences
    from pixelid.errors import InputError
    from pixelid.outputs import claimed, whole_folder

    if predict and model is None:
        raise InputError("--predict: expected --model with it")
    if predict and sample:
        raise InputError("--sample: nothing to sample with --predict")
    by_recipe = tables[0].suffix == ".toml"
    if by_recipe and (len(tables) > 1 or predict or camera):
        raise InputError(f"{tables[0]}: a recipe stands alone, without other tables, --predict and --camera")
    with claimed(out, overwrite, [*tables, *([model] if model else [])]):
        from pixelid.report.html import write_report
        from pixelid.tables.latency.choosing import chosen_cameras, chosen_rows
        from pixelid.tables.latency.fit import fit_latency
        from pixelid.tables.latency.reading import read_tables
        from pixelid.tables.latency.recipe import read_latency_recipe
        from pixelid.tables.latency.result import save_fit, save_prediction

        recipe = read_latency_recipe(tables[0]) if by_recipe else None
        table = recipe.table if recipe else chosen_rows(read_tables(tables, measured=not predict), camera)
        cameras, files = chosen_cameras(model) if model is not None else ((), ())
        if predict:
            with whole_folder(out, overwrite) as folder:
                written = save_prediction(table, cameras, folder, *files, seed=seed)
                write_report(folder)
        else:
            fits = 0.2 if sample else 1.0  # of the time, about
            with bar(quiet) as report, whole_folder(out, overwrite) as folder:
                fit = fit_latency(table, lambda done: report("cameras", fits * done), cameras)
                extra = {"seed": seed}
                if sample:
                    from pixelid.tables.latency.posterior import sample_fit

                    extra |= sample_fit(
                        fit, seed, folder, progress=lambda done: report("posterior", fits + (1.0 - fits) * done)
                    )
                written = save_fit(fit, folder, extra, recipe)
                write_report(folder)
    if not quiet:
        for name, errors in written["errors"].items():
            for statistic, e in errors.items():
                clean = "–" if e["rms_without_spoiled"] is None else f"{100 * e['rms_without_spoiled']:.1f} %"
                say(f"{name:10s} {statistic:8s} {e['rows']:5d} rows, rms {100 * e['rms']:5.1f} %, {clean} without the "
                    f"{e['spoiled']} excluded rows")  # fmt: skip
        say_sentences(written["limiting_stages"])
        say_page(out)
    return written["status"].exit_code
