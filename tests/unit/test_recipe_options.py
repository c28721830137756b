"""What the command line says beside a recipe is put in place of what the recipe says."""

import pytest

from pixelid.cli.main import main
from pixelid.errors import InputError
from pixelid.fit.recipe import Recipe
from pixelid.model.shipped import find_model
from pixelid.recordings import write_recording
from pixelid.recordings.crop import Crop
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp

KEYS = 'recordings = ["r.h5"]\nmodel = "dvs128"\nseed = 3\nbetween = "smooth"\npixels = 4\n'


@pytest.mark.parametrize(
    ("words", "seed", "between", "crop"),
    [
        ([], 3, "smooth", Crop(pixels=4)),
        (["--seed", "5", "--between", "linear", "--pixels", "2"], 5, "linear", Crop(pixels=2)),
        (["--roi", "0,0,1,1", "--without-hot-pixels"], 3, "smooth", Crop((0, 0, 1, 1), None, 4, True)),
        (["--time", "0:0.1"], 3, "smooth", Crop(None, (0.0, 0.1), 4)),
    ],
)
def test_options_beside_a_recipe_count(tmp_path, monkeypatch, words, seed, between, crop):
    """All six were ignored without a word."""
    write_recording(simulate(find_model("dvs128"), chirp(duration_s=0.2), width=2, height=2), tmp_path / "r.h5")
    (tmp_path / "fit.toml").write_text(f"[fit]\n{KEYS}")
    ran = []

    def run(self, *_):
        ran.append(self)
        raise InputError("enough")

    monkeypatch.setattr(Recipe, "run", run)
    assert main(["fit", str(tmp_path / "fit.toml"), "--out", str(tmp_path / "out"), "--quiet", *words]) == 2
    (recipe,) = ran
    assert (recipe.seed, recipe.between, recipe.crop) == (seed, between, crop)
