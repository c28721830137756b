"""`pixelid noise`: noise events of still scenes against light."""

from __future__ import annotations

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid noise noise_vs_lux.csv --out noise
    pixelid noise other_lights.csv --model noise --predict --out check
    pixelid noise dark.h5 dim.h5 bright.h5 --model dvs128 --out noise
"""


@click.command("noise", epilog=EXAMPLE)
@click.argument("sources", nargs=-1, required=True, type=options.PATH)
@options.out()
@options.model(False, "Where a fit starts, and what --predict evaluates; default: dvs128.")
@click.option("--predict", is_flag=True, help="Evaluate --model on the rates instead of fitting.")
@options.reading
@options.overwrite
@options.seed("No effect on this command.")
@options.quiet
def command(sources, out, model, predict, overwrite, seed, quiet):
    """Fit noise rates of SOURCES: tables (CSV: light, ON and OFF events per pixel and second) or still recordings.

    The circuit's own noise, through all its stages and resets, gives rates against light: thresholds over noise,
    bandwidth, dark current, leak. Writes noise.json (rows with measured and predicted events/s), model.toml, noise.svg
    and report.html.
    """
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say, say_page, say_sentences
    from pixelid.errors import InputError
    from pixelid.outputs import claimed, whole_folder

    if predict and model is None:
        raise InputError("--predict: expected --model with it")
    for source in sources:
        if not source.exists():
            raise InputError(f"{source}: no such file")
    with claimed(out, overwrite, [*sources, *([model] if model else [])]):
        from pixelid.inputs import as_model
        from pixelid.model.shipped import model_files
        from pixelid.recordings.reading import open_recordings
        from pixelid.report.html import write_report
        from pixelid.tables.noise.fit import fit_noise
        from pixelid.tables.noise.reading import read_noise_tables, reduced_recordings
        from pixelid.tables.noise.result import model_beside, model_scales, save_fit, save_prediction

        tables = [source for source in sources if source.suffix.lower() == ".csv"]
        if tables and len(tables) < len(sources):
            raise InputError("noise: expected tables (.csv) or recordings, found both")
        circuit = as_model(model or "dvs128")
        table = read_noise_tables(tables) if tables else reduced_recordings(open_recordings(sources))
        if predict:
            inputs = [path for path in model_files(model) if path.is_file()]
            with whole_folder(out, overwrite) as folder:
                beside, scales = model_beside(model), model_scales(model)
                written = save_prediction(table, circuit, beside, folder, seed, inputs, scales)
                write_report(folder)
        else:
            with bar(quiet) as report:
                fit = fit_noise(table, circuit, report)
            with whole_folder(out, overwrite) as folder:
                written = save_fit(fit, folder, seed)
                write_report(folder)
    if not quiet:
        for name, v in written["parameters"].items():
            known = "   held" if v.get("fixed") else "" if v["identified"] else "   not identified"
            say(f"{name:44s} {v['value']:10.4g} {v['unit']}{known}")
        say(f"relative scatter {100 * written['relative_scatter']:.1f} %")
        say_sentences([written["advice"], *written["disagreements"]])
        say_page(out)
    return written["status"].exit_code
