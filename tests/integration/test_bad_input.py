"""Bad input on the command line: exit code 2, one or two plain lines that name it, and nothing half written."""

import importlib.util
from pathlib import Path

import h5py
import numpy as np
import pytest

from pixelid.cli.main import main
from pixelid.recordings import Events, Recording, write_recording
from pixelid.stimuli.stimulus import Stimulus

FIT = "fit {file} --model dvs128 --out {out}"
COMMANDS = {
    "inspect": "inspect {file} --out {out}",
    "convert": "convert {file} {out}.h5",
    "simulate": "simulate dvs128 --stimulus {file} --out {out}.h5",
    "fit": FIT,
}
PRESENT = [name for name in COMMANDS if importlib.util.find_spec(f"pixelid.cli.{name}_command")]


def good(path: Path) -> Path:
    """A small recording of four pixels under one second of changing light."""
    rng = np.random.default_rng(3)
    n = 200
    t = np.sort(rng.choice(10**6, n, replace=False)) * 1000
    events = Events.from_columns(
        t, rng.integers(0, 2, n), rng.integers(0, 2, n), rng.integers(0, 2, n), 2, 2, tick_ns=1000
    )
    write_recording(Recording(events, Stimulus.from_arrays(np.linspace(0, 1, 50), 20 + rng.random(50), "fA")), path)
    return path


def edit(path: Path, name: str, change) -> None:
    """Replace one column of a recording by change(column)."""
    with h5py.File(path, "r+") as file:
        attributes, values = dict(file[name].attrs), change(file[name][()])
        del file[name]
        file[name] = values
        file[name].attrs.update(attributes)


def remove(path: Path, name: str) -> None:
    with h5py.File(path, "r+") as file:
        del file[name]


def with_nan(column):
    return np.where(np.arange(len(column)) == 7, np.nan, column)


# what is wrong → (how to make the file, what the message says)
FILES = {
    "empty file": (lambda path: path.write_bytes(b""), "empty file"),
    "truncated HDF5": (lambda path: path.write_bytes(good(path).read_bytes()[:3000]), "truncated or damaged HDF5"),
    "text for HDF5": (lambda path: path.write_text("t,x,y,p\n"), "expected an HDF5 file"),
    "missing file": (lambda path: None, "no such file"),
    "folder without recordings": (lambda path: path.mkdir(), "folder"),
    "unsorted timestamps": (lambda path: edit(good(path), "events/t", np.flip), "timestamps must not decrease"),
    "negative timestamps": (lambda path: edit(good(path), "events/t", lambda t: t - 10**9), "must not be negative"),
    "64-bit overflow": (
        lambda path: edit(good(path), "events/t", lambda t: t.astype(np.uint64) + np.uint64(2**63)),
        "fit",
    ),
    "wrong polarity coding": (
        lambda path: edit(good(path), "events/p", lambda p: 2 * p.astype(np.int8) - 1),
        "polarity must be 1 (ON) or 0 (OFF)",
    ),
    "pixel out of range": (lambda path: edit(good(path), "events/x", lambda x: x + 1), "expected 0..1"),
    "missing column": (lambda path: remove(good(path), "events/p"), "events/p: missing"),
    "NaN stimulus": (lambda path: edit(good(path), "stimulus/radiance", with_nan), "NaN"),
    "negative radiance": (lambda path: edit(good(path), "stimulus/radiance", np.negative), "must be positive"),
    "stimulus times that stand still": (
        lambda path: edit(good(path), "stimulus/t", lambda t: 0 * t),
        "times must increase",
    ),
    "stimulus shorter than the events": (
        lambda path: edit(good(path), "stimulus/t", lambda t: t / 2),
        "expected to cover the events",
    ),
}


def refused(words: list[str], folder: Path, capsys) -> str:
    """Run the command line, check that it refuses plainly and leaves the folder as it was; the message."""
    before = snapshot(folder)
    code = main(words)
    printed = capsys.readouterr()
    assert code == 2, printed.err
    assert printed.out == ""
    assert "Traceback" not in printed.err
    lines = printed.err.splitlines()
    assert 1 <= len(lines) <= 2
    assert lines[0].startswith("pixelid: ")
    assert snapshot(folder) == before
    return printed.err


def snapshot(folder: Path) -> dict[str, bytes | None]:
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


def words(template: str, **names) -> list[str]:
    return [word.format(**names) for word in template.split()]


@pytest.mark.parametrize("command", PRESENT)
@pytest.mark.parametrize("wrong", FILES)
def test_a_bad_recording_is_refused(command, wrong, tmp_path, capsys):
    make, says = FILES[wrong]
    make(tmp_path / "bad.h5")
    message = refused(words(COMMANDS[command], file=tmp_path / "bad.h5", out=tmp_path / "out"), tmp_path, capsys)
    if command == "simulate" and wrong in ("missing file", "folder without recordings"):
        says = "no stimulus"  # there the word may also be a built-in name
    assert says in message
    assert "bad.h5" in message


@pytest.mark.parametrize("command", PRESENT)
def test_an_existing_result_is_kept(command, tmp_path, capsys):
    good(tmp_path / "good.h5")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "precious").write_text("numbers")
    (tmp_path / "out.h5").write_text("precious")
    message = refused(words(COMMANDS[command], file=tmp_path / "good.h5", out=tmp_path / "out"), tmp_path, capsys)
    assert "exists already" in message
    assert "--overwrite" in message


@pytest.mark.parametrize("command", PRESENT)
def test_a_missing_folder_is_refused(command, tmp_path, capsys):
    good(tmp_path / "good.h5")
    message = refused(
        words(COMMANDS[command], file=tmp_path / "good.h5", out=tmp_path / "missing" / "out"), tmp_path, capsys
    )
    assert "does not exist" in message


SIMULATE = "simulate dvs128 --stimulus {file} --out {out}.h5 "
SENSOR, GAP = "sensor {file} --model dvs128 --out {out} ", "gap {file} --model dvs128 --out {out} "
FITS = Path(__file__).resolve().parents[2] / "fits"
NIST = FITS / "nist_latency" / "nist_latency_median_over_roi.csv"
USAGE = {
    "models: unknown circuit": ("models dvs129", "no model 'dvs129'"),
    "simulate: unknown circuit": (SIMULATE.replace("dvs128", "dvs129"), "no model 'dvs129'"),
    "simulate: unknown effect": (SIMULATE + "--with glow", "unknown effect 'glow'; known: dark_current"),
    "simulate: unknown effect removed": (SIMULATE + "--without glow", "unknown effect 'glow'"),
    "simulate: unknown parameter of an effect": (SIMULATE + "--with leak:speed=1", "has no parameter 'speed'"),
    "simulate: parameter out of bounds": (SIMULATE + "--set on_threshold=-1", "outside its bounds"),
    "simulate: parameter without value": (SIMULATE + "--set on_threshold", "expected name=value"),
    "simulate: NaN parameter": (SIMULATE + "--set on_threshold=nan", "finite"),
    "simulate: no pixels": (SIMULATE + "--pixels 0", "--pixels"),
    "simulate: unknown stimulus": ("simulate dvs128 --stimulus sawtooth --out {out}.h5", "no stimulus 'sawtooth'"),
    "simulate: unknown format": ("simulate dvs128 --stimulus {file} --out {out}.mp3", "mp3"),
    "fit: unknown circuit": (FIT.replace("dvs128", "dvs129"), "no model 'dvs129'"),
    "fit: no circuit": ("fit {file} --out {out}", "--model"),
    "fit: unknown effect": (FIT + " --with glow", "unknown effect 'glow'; known: dark_current"),
    "fit: unknown effect removed": (FIT + " --without glow", "unknown effect 'glow'"),
    "fit: unknown parameter held": (FIT + " --fix speed=1", "has no parameter 'speed'"),
    "fit: value out of bounds": (FIT + " --fix on_threshold=-1", "outside its bounds"),
    "fit: incomplete gauge": (FIT + " --gauge q_in=0.875", "2 directions left flat"),
    "fit: over-determined gauge": (
        FIT + " --gauge q_in=0.875 --gauge q_mil=0.015 --gauge A_loop=98 --gauge A_amp=140",
        "over-determined",
    ),
    "fit: impossible gauge name": (FIT + " --gauge q_out=1", "unknown name 'q_out'"),
    "fit: gauge without value": (FIT + " --gauge q_in", "expected name=value"),
    "fit: gauge of nonsense": (FIT + " --gauge q_in=much", "neither a number nor a ratio"),
    "simulate: negative seed": (SIMULATE + "--seed -1", "--seed"),
    "simulate: seed of nonsense": (SIMULATE + "--seed 1e3", "--seed"),
    "simulate: seed beyond 32 bits": (SIMULATE + f"--seed {1 << 32}", "--seed"),
    "simulate: seed of the sensor": (SIMULATE + "--sensor-seed -1", "--sensor-seed"),
    "simulate: negative pixels": (SIMULATE + "--pixels -3", "--pixels"),
    "simulate: too many pixels": (SIMULATE + "--pixels 9999999999999", "--pixels"),
    "simulate: infinite parameter": (SIMULATE + "--set on_threshold=inf", "finite"),
    "simulate: 5000 digits": (SIMULATE + f"--set on_threshold={'9' * 5000}", "finite"),
    "simulate: no threads": (SIMULATE + "--threads 0", "--threads"),
    "fit: negative seed": (FIT + " --seed -1", "--seed"),
    "fit: unknown engine": (FIT + " --engine warp", "--engine"),
    "fit: unknown form": (FIT + " --form odd", "--form"),
    "fit: unknown levels of pixels": (FIT + " --pixel-levels loud", "expected gain, background or both"),
    "fit: levels of no spread": (FIT + " --pixel-levels gain=0", "expected a positive number"),
    "fit: background beside a dark current": (
        FIT + " --with dark_current --pixel-levels both",
        "a background that all pixels share is a dark current",
    ),
    "fit: levels in the continuous form": (FIT + " --pixel-levels gain --form continuous", "the discrete form only"),
    "fit: priors without biases": (FIT + " --bias-priors", "expected the bias settings of a jAER header"),
    "fit: levels sampled": (FIT + " --pixel-levels gain --sample", "not with --pixel-levels"),
    "fit: no pixels": (FIT + " --pixels 0", "--pixels"),
    "fit: region of words": (FIT + " --roi a,b,c,d", "--roi"),
    "fit: region of other digits": (FIT + " --roi ²,²,³,³", "--roi"),
    "fit: region of 5000 digits": (FIT + f" --roi 0,0,1,{'9' * 5000}", "--roi"),
    "fit: empty region": (FIT + " --roi 1,1,1,1", "--roi"),
    "fit: time of nonsense": (FIT + " --time a:b", "--time"),
    "fit: time that is none": (FIT + " --time nan:nan", "--time"),
    "fit: endless time": (FIT + " --time 0:inf", "--time"),
    "fit: NaN held": (FIT + " --fix gamma=nan", "finite"),
    "fit: infinite gauge": (FIT + " --gauge q_in=inf", "positive and finite"),
    "gap: alpha": ("gap {file} --model dvs128 --out {out} --alpha nan", "--alpha"),
    "gap: alpha of zero": ("gap {file} --model dvs128 --out {out} --alpha 0", "--alpha"),
    "gap: negative seed": ("gap {file} --model dvs128 --out {out} --seed -1", "--seed"),
    "flicker: groups of nothing": ("flicker {file} --out {out} --groups 0x0", "groups"),
    "flicker: groups of words": ("flicker {file} --out {out} --groups many", "groups"),
    "flicker: negative groups": ("flicker {file} --out {out} --groups -3x2", "groups"),
    "flicker: endless groups": ("flicker {file} --out {out} --groups 99999999999x2", "groups"),
    "flicker: frequency": ("flicker {file} --out {out} --frequency nan", "--frequency"),
    "design: no pixels": ("design dvs128 --out {out} --pixels 0", "--pixels"),
    "design: no draws": ("design dvs128 --out {out} --draws 0", "--draws"),
    "design: spread": ("design dvs128 --out {out} --spread nan", "--spread"),
    "design: criterion": ("design dvs128 --out {out} --criterion Q", "criterion"),
    "compare: one fold": ("compare {file} --model dvs128 --model ideal --out {out} --folds 1", "--folds"),
    "sensor: no block": ("sensor {file} --model dvs128 --out {out} --block 0", "--block"),
    "sensor: no tile": ("sensor {file} --model dvs128 --out {out} --tile 0", "--tile"),
    "sensor: negative bootstrap": ("sensor {file} --model dvs128 --out {out} --bootstrap -1", "--bootstrap"),
    "reconstruct: samples": ("reconstruct {out} --out {out}2 --samples 0", "--samples"),
    "reconstruct: box": ("reconstruct {out} --out {out}2 --box 0 0 0 nan 1 1", "--box"),
    "report: no result": ("report {file}", "good.h5"),
    "report: no folder": ("report {out}", "out"),
    "latency: no model": ("latency {file} --out {out} --predict", "--model"),
    "latency: not a table": ("latency {file} --out {out}", "good.h5"),
    "biases: no laws": ("biases {file} --out {out} --predict", "--model"),
    "biases: laws without predict": ("biases {file} --out {out} --model {out}", "--predict"),
    "biases: not a table": ("biases {file} --out {out}", "good.h5"),
    "fit: two sources of priors": ("fit {file} --model dvs128 --out {out} --bias-priors --bias-laws x", "--bias-laws"),
    "noise: predict without a model": ("noise {file} --out {out} --predict", "--model"),
    "rates: unit": ("rates {file} --out {out} --unit furlongs", "--unit"),
    "convert: unknown format": ("convert {file} {out}.mp3", "mp3"),
    "inspect: unknown option": ("inspect {file} --out {out} --speed 3", "--speed"),
    "demo: negative seed": ("demo --out {out} --seed -1", "--seed"),
    "simulate: effect removed that was never known": (SIMULATE + "--without leek", "parasitic_photocurrent"),
    "simulate: value of an effect that is none": (SIMULATE + "--with leak:rate_hz=fast", "name=value"),
    "simulate: value of an effect out of bounds": (SIMULATE + "--with leak:rate_hz=-3", "leak.rate_hz"),
    "simulate: effect added and removed": (SIMULATE + "--with leak --without leak", "both"),
    "simulate: unknown parameter": (SIMULATE + "--set nothing=1", "on_threshold"),
    "simulate: words for pixels": (SIMULATE + "--pixels many", "--pixels"),
    "simulate: more hot pixels than pixels": (SIMULATE + "--with hot_pixels:count=1000", "hot_pixels.count"),
    "sensor: bandwidth of a threshold": (SENSOR + "--bandwidth on_threshold", "expected a cutoff"),
    "sensor: unknown bandwidth": (SENSOR + "--bandwidth nonsense", "nonsense"),
    "sensor: workers of two kinds": (SENSOR + "--workers 1 --cluster tcp://127.0.0.1:1", "exclude"),
    "lowlight: no bandwidth": ("lowlight ideal --out {out}", "no bandwidth limit"),
    "lowlight: unknown circuit": ("lowlight nothing --out {out}", "no model"),
    "lowlight: missing recording": ("lowlight dvs128 missing.h5 --out {out}", "no such file"),
    "lowlight: unknown effect": ("lowlight dvs128 --with glow --out {out}", "glow"),
    "lowlight: described effect of nothing": (
        "lowlight dvs128 --with described.rate.radiance.power:strength=5 --out {out}",
        "described effects of rate",
    ),
    "lowlight: latencies of several cameras": ("lowlight gen31 --latency {nist} --out {out}", "--camera"),
    "lowlight: latencies of another camera": ("lowlight gen31 --latency {nist} --camera CAM9 --out {out}", "CAM9"),
    "lowlight: camera without latencies": ("lowlight gen31 --camera CAM3 --out {out}", "--latency"),
    "lowlight: latencies in another unit": ("lowlight dvs128 --latency {nist} --camera CAM3 --out {out}", "W/m2"),
    "lowlight: recipe after a table": (
        "lowlight gen31 --latency {nist} --latency {fits}/gen31.toml --out {out}",
        "header",
    ),
    "lowlight: table after a recipe": (
        "lowlight gen31 --latency {fits}/gen31.toml --latency {nist} --out {out}",
        "stands alone",
    ),
    "lowlight: folder that is no fit": ("lowlight gen31 --latency {fits} --out {out}", "latency.json"),
    "lowlight: missing latencies": ("lowlight gen31 --latency no.csv --out {out}", "no.csv"),
    "design: unknown criterion": ("design dvs128 --criterion E --out {out}", "expected D, A or a free parameter"),
    "design: missing recording": ("design dvs128 --recorded missing.h5 --out {out}", "no such file"),
    "design: missing menu": ("design dvs128 --menu missing.toml --out {out}", "cannot be read"),
    "design: nothing to learn": ("design ideal --out {out}", "threshold_noise"),
    "convert: alignment without light": ("convert {file} {out}.h5 --align auto", "--stimulus"),
    "convert: unknown alignment": (
        "convert {file} {out}.h5 --stimulus steps --align soon",
        "--align: expected trigger",
    ),
    "convert: alignment to constant light": ("convert {file} {out}.h5 --stimulus constant --align auto", "constant"),
    "convert: light on another clock": ("convert {file} {out}.h5 --stimulus steps", "--align"),
    "convert: region outside the sensor": ("convert {file} {out}.h5 --roi 0,0,9,9", "--roi"),
    "convert: region of words": ("convert {file} {out}.h5 --roi a", "x0,y0,x1,y1"),
    "convert: time that goes back": ("convert {file} {out}.h5 --time 2:1", "--time"),
    "convert: format that is only read": ("convert {file} {out}.aedat4", ".aedat4"),
    "convert: no format": ("convert {file} {out}", ".h5"),
    "gap: unknown effect": (GAP + "--with leek", "leek"),
    "gap: without the noise that it needs": (GAP + "--without threshold_noise", "threshold_noise"),
    "noise: unknown circuit": ("noise {file} --model nothing --out {out}", "no model"),
    "noise: missing table": ("noise absent.csv --out {out}", "absent.csv"),
    "fit: missing recipe": ("fit {out}.toml --out {out}", "cannot be read"),
}


@pytest.mark.parametrize("case", USAGE)
def test_bad_usage_is_refused(case, tmp_path, capsys):
    template, says = USAGE[case]
    good(tmp_path / "good.h5")
    given = words(template, file=tmp_path / "good.h5", out=tmp_path / "out", fits=FITS, nist=NIST)
    assert says in refused(given, tmp_path, capsys)


@pytest.mark.skipif("fit" not in PRESENT, reason="no fit command")
@pytest.mark.parametrize(
    ("recipe", "says"),
    [
        ("", "[fit] table"),
        ("[fit", "not valid TOML"),
        ('[fit]\nmodel = "dvs128"', "recordings is missing"),
        ('[fit]\nrecordings = ["good.h5"]', "model is missing"),
        ('[fit]\nrecordings = "good.h5"\nmodel = "dvs128"', "list of strings"),
        ('[fit]\nrecordings = ["gone.h5"]\nmodel = "dvs128"', "gone.h5: no such file"),
        ('[fit]\nrecordings = ["good.h5"]\nmodel = "dvs128"\nspeed = 1', "unknown keys speed"),
        ('[fit]\nrecordings = ["good.h5"]\nmodel = "dvs128"\nseed = "x"', "seed: expected a whole number"),
        ('[fit]\nrecordings = ["good.h5"]\nmodel = "dvs128"\nbetween = "cubic"', "cubic"),
        ('[fit]\nrecordings = []\nmodel = "dvs128"', "recording"),
    ],
)
def test_a_bad_recipe_is_refused(recipe, says, tmp_path, capsys):
    good(tmp_path / "good.h5")
    (tmp_path / "recipe.toml").write_text(recipe)
    message = refused(["fit", str(tmp_path / "recipe.toml"), "--out", str(tmp_path / "out")], tmp_path, capsys)
    assert says in message


def test_fit_needs_a_stimulus(tmp_path, capsys):
    pytest.importorskip("pixelid.cli.fit_command")
    remove(good(tmp_path / "good.h5"), "stimulus")
    message = refused(words(FIT, file=tmp_path / "good.h5", out=tmp_path / "out"), tmp_path, capsys)
    assert "no stimulus" in message


@pytest.mark.parametrize(
    ("toml", "says"),
    [
        ("", "[stimulus] table"),
        ('[stimulus]\nkind = "triangle"', "found 'triangle'"),
        ('[stimulus]\nkind = "sine"\ncolour = 3', "has no parameter 'colour'"),
        ('[stimulus]\nkind = "sine"\nlevel = "high"', "expected a number"),
        ('[stimulus]\nkind = "sine"\nlevel = -1.0', "positive"),
        ('[stimulus]\nkind = "sine"\nlevel = nan', "light.toml"),
    ],
)
def test_a_bad_stimulus_file_is_refused(toml, says, tmp_path, capsys):
    pytest.importorskip("pixelid.cli.simulate_command")
    (tmp_path / "light.toml").write_text(toml)
    message = refused(words(SIMULATE, file=tmp_path / "light.toml", out=tmp_path / "out"), tmp_path, capsys)
    assert says in message
    assert "light.toml" in message


@pytest.mark.skipif("simulate" not in PRESENT, reason="no simulate command")
def test_a_bad_model_file_is_refused_by_name(tmp_path, capsys):
    good(tmp_path / "good.h5")
    (tmp_path / "mine.toml").write_text('[model]\nname = "mine"\neffects = ["glow"]\n')
    message = refused(
        words(SIMULATE.replace("dvs128", "{model}"), file=tmp_path / "good.h5", out=tmp_path / "out",
              model=tmp_path / "mine.toml"), tmp_path, capsys
    )  # fmt: skip
    assert "mine.toml: unknown effect 'glow'" in message
