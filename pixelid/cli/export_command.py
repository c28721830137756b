"""`pixelid export`: a circuit in another simulator's parameters."""

from __future__ import annotations

import click

from pixelid.cli import options

TARGETS = ("v2e", "iebcs", "esim", "deblur-e-nerf", "dvs-voltmeter")
EXAMPLE = """
\b
Example:
    pixelid export dvs128 --to v2e --out v2e.args
    pixelid export dvs128 --to deblur-e-nerf --white 2000 --out camera_calibration.npz
    pixelid export dvs128 --to dvs-voltmeter --out voltmeter.json
"""


@click.command("export", epilog=EXAMPLE)
@click.argument("model")
@click.option("--to", required=True, type=click.Choice(TARGETS, case_sensitive=False), help="The simulator.")
@options.out("The file to write; a name that ends in .json gives JSON for any simulator.")
@click.option("--white", type=options.Number(0.0, open_low=True), default=None,
              help="Radiance of a white pixel, 255 grey levels, in the model's unit.  [default: 255]")  # fmt: skip
@click.option("--level", type=options.Number(0.0, open_low=True), default=None,
              help="Radiance at which one number stands for what depends on light.  [default: white]")  # fmt: skip
@options.with_effect
@options.without
@options.set_value
@options.overwrite
@options.seed("Written into the result; no other effect.")
@options.quiet
def command(model, to, out, white, level, with_, without, set_, overwrite, seed, quiet):
    """Write the parameters of another simulator that come nearest to MODEL (shipped, .toml file or fit folder).

    What that simulator cannot express is stated in words, in the file and on the terminal.  The file is the simulator's
    own: options of v2e and DVS-Voltmeter, flags of the improved ESIM, the pixel's part of camera_calibration.npz of
    Deblur e-NeRF; IEBCS has none and gets JSON.
    """
    from pixelid.cli.terminal import columns, say, say_sentences
    from pixelid.export.export import exported, write
    from pixelid.model.options import changed
    from pixelid.model.shipped import find_model
    from pixelid.outputs import claimed, whole_file

    with claimed(out, overwrite, [model]):
        circuit, remarks = changed(find_model(model), with_, without, set_)
        result = exported(circuit, to, white=white, level=level, spec=model, seed=seed)
        with whole_file(out, overwrite) as path:
            write(result, path, as_json=out.suffix == ".json")
    if not quiet:
        say(*remarks, result.table().text(width=columns()))
        say_sentences(result.remarks())
        say(str(out))
