"""`pixelid design --biases`: planted laws are met as often as said, wishes that nothing meets, refusals."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pixelid.cli.main import main
from pixelid.design.bias_fits import BiasFit, line_through, read_bias_fit
from pixelid.design.bias_result import bias_report
from pixelid.design.biases import recommend_setting
from pixelid.errors import InputError
from pixelid.report.html import write_report
from pixelid.status import Status
from pixelid.tables.rates.square_wave import rate
from tests.integration.test_bias_law import BIASES, CUTOFF_HZ, EFOLD_MV, table
from tests.integration.test_schemas import check

SETTINGS = np.linspace(1200.0, 1500.0, 7)
EFOLD, REFERENCE, DEPARTURE, ERROR = 40.0, 2000.0, 0.3, 0.1  # REFERENCE: Hz at 1350 mV
NOISE = 5.0  # events/s there; it goes with the root of the cutoff


def cutoff_hz(bias):
    return REFERENCE * np.exp((1350.0 - bias) / EFOLD)


def noise_hz(bias):
    return NOISE * np.exp((1350.0 - bias) / (2 * EFOLD))


def planted(rng: np.random.Generator, departure: float = DEPARTURE) -> BiasFit:
    """What a table of seven settings would say that depart from the law, each known to 10 %."""

    def line(value):
        scatter = np.hypot(departure, ERROR) * rng.standard_normal(len(SETTINGS))
        return line_through(SETTINGS, np.log(value(SETTINGS)) + scatter, np.full(len(SETTINGS), ERROR))

    columns = {f"fo{bias:g}": float(bias) for bias in SETTINGS}
    return BiasFit(
        "fo", columns, line(cutoff_hz), line(noise_hz), (np.log(30.0), 0.05), (np.log(1e-5), 0.05),
        {name: {} for name in columns}, Path("rates.json"),
    )  # fmt: skip


def test_a_line_without_departures_is_least_squares():
    rng = np.random.default_rng(1)
    y = 3.0 - 0.02 * SETTINGS + 1e-3 * rng.standard_normal(len(SETTINGS))
    line = line_through(SETTINGS, y, np.full(len(SETTINGS), 0.1))
    slope, level = np.polyfit(SETTINGS - SETTINGS.mean(), y, 1)
    assert line.departure == 0.0
    assert line.slope == pytest.approx(slope)
    assert line.level == pytest.approx(level)
    assert line.level_sd == pytest.approx(0.1 / np.sqrt(len(SETTINGS)))


def test_recommended_settings_meet_the_wish_as_often_as_said():
    """The setting recommended departs from the law as all do: it lies in its interval 95 of 100 times, and a wish that
    is met surely is met 97.5 of 100 times."""
    inside, met, tries = 0, 0, 400
    for seed in range(tries):
        rng = np.random.default_rng(seed)
        found = recommend_setting(planted(rng), {"bandwidth": 800.0})["recommended"]
        assert found["surely"]
        assert not found["extrapolated"]
        true = cutoff_hz(found["bias_mv"]) * np.exp(DEPARTURE * rng.standard_normal())
        low, high = found["predicted"]["bandwidth"]["interval_95"]
        inside += low <= true <= high
        met += true >= 800.0
    print(f"{inside} of {tries} inside, {met} of {tries} met")
    assert inside >= 0.92 * tries
    assert met >= 0.95 * tries


def test_the_slowest_setting_that_is_sure_is_recommended():
    found = recommend_setting(planted(np.random.default_rng(0), 0.0), {"bandwidth": 800.0})
    low, _ = found["recommended"]["predicted"]["bandwidth"]["interval_95"]
    assert 800.0 <= low < 830.0  # the next setting, 1.5 mV slower, would not be sure
    assert found["meets_surely_mv"][1] == pytest.approx(found["recommended"]["bias_mv"])


def test_of_two_wishes_the_setting_between_is_taken_and_the_tighter_one_binds():
    fit = planted(np.random.default_rng(2), 0.0)
    found = recommend_setting(fit, {"bandwidth": 1000.0, "noise": 10.0})
    best = found["recommended"]
    assert found["status"] == "converged"
    assert best["surely"]
    assert cutoff_hz(best["bias_mv"]) > 1000.0
    assert noise_hz(best["bias_mv"]) < 10.0
    tight = recommend_setting(fit, {"bandwidth": 1000.0, "noise": 1.05 * NOISE / np.sqrt(2.0)})
    assert not tight["recommended"]["surely"]


def test_wishes_that_exclude_each_other_are_named_with_their_distance():
    """1000 Hz needs noise of 3.5/s; at most 0.35/s was wanted.  The best is missed by a factor of both together of 10
    in noise, the noise going with the root of the cutoff."""
    found = recommend_setting(
        planted(np.random.default_rng(3), 0.0), {"bandwidth": 1000.0, "noise": 0.1 * NOISE / 2**0.5}
    )
    assert found["status"] == "at_bound"
    assert not found["recommended"]["met"]
    missed = {name: one["missed_by_factor"] or 1.0 for name, one in found["wishes"].items()}
    assert missed["noise"] * np.sqrt(missed["bandwidth"]) == pytest.approx(10.0, rel=0.15)
    assert "no setting meets" in found["advice"]
    for name, one in found["wishes"].items():
        assert one["met"] or name in found["advice"]


def test_a_setting_beyond_the_fitted_ones_is_called_an_extrapolation():
    wanted = 1.5 * cutoff_hz(SETTINGS.min())
    found = recommend_setting(planted(np.random.default_rng(4)), {"bandwidth": wanted})
    assert found["recommended"]["extrapolated"]
    assert found["recommended"]["bias_mv"] < SETTINGS.min()
    assert found["status"] == "not_identified"
    assert "extrapolation" in found["why"]
    low, high = found["recommended"]["predicted"]["bandwidth"]["interval_95"]
    inner = recommend_setting(planted(np.random.default_rng(4)), {"bandwidth": REFERENCE})["recommended"]["predicted"]
    assert high / low > inner["bandwidth"]["interval_95"][1] / inner["bandwidth"]["interval_95"][0]


def test_no_setting_below_zero_is_recommended():
    """Of settings from 20 to 320 mV, half of their range below is -130 mV."""
    fit = planted(np.random.default_rng(4))
    near = {name: bias - 1180.0 for name, bias in fit.column_mv.items()}
    fit = replace(fit, column_mv=near, cutoff=replace(fit.cutoff, centre=fit.cutoff.centre - 1180.0))
    found = recommend_setting(fit, {"bandwidth": 100.0 * cutoff_hz(SETTINGS.min())})
    assert min(found["curve"]["bias_mv"]) == 0.0
    assert found["recommended"]["bias_mv"] >= 0.0
    assert max(found["curve"]["bias_mv"]) == pytest.approx(470.0)


def test_no_setting_near_is_fast_enough():
    found = recommend_setting(planted(np.random.default_rng(5), 0.0), {"bandwidth": 1e9})
    assert found["status"] == "at_bound"
    assert not found["recommended"]["extrapolated"]
    best = cutoff_hz(SETTINGS.min())
    assert found["wishes"]["bandwidth"]["missed_by_factor"] == pytest.approx(1e9 / best, rel=0.3)


def test_events_are_those_of_the_tables_light():
    fit = planted(np.random.default_rng(6), 0.0)
    found = recommend_setting(fit, {"bandwidth": 500.0, "rate": 1e6}, frequency_hz=200.0)
    bias = found["recommended"]["bias_mv"]
    true = rate(200.0, 30.0, 1.0 / (2.0 * np.pi * cutoff_hz(bias)), 1e-5, noise_hz(bias))[0]
    low, high = found["recommended"]["predicted"]["rate"]["interval_95"]
    assert low < true < high
    assert high / low < 2.0


def test_what_nothing_fitted_says_is_refused():
    fit = planted(np.random.default_rng(0))
    silent = BiasFit(fit.name, fit.column_mv, fit.cutoff, None, None, None, fit.own, fit.source)
    for wanted, words in (({"noise": 3.0}, "noise"), ({"bandwidth": 9.0, "rate": 3.0}, "events"), ({}, "wishes")):
        with pytest.raises(InputError, match=words):
            recommend_setting(silent, wanted)
    with pytest.raises(InputError, match="frequency"):
        recommend_setting(fit, {"rate": 3.0})


@pytest.fixture(scope="module")
def rates(tmp_path_factory) -> Path:
    """A finished `pixelid rates --bias-law` of simulated rates."""
    folder = tmp_path_factory.mktemp("rates")
    made = table(2)
    lines = ["freq_hz," + ",".join(made.columns)]
    lines += [",".join(f"{v:.10g}" for v in (f, *row)) for f, row in zip(made.frequency_hz, made.rate_hz, strict=True)]
    (folder / "t.csv").write_text("\n".join(lines) + "\n")
    assert main(["rates", str(folder / "t.csv"), "--bias-law", "--out", str(folder / "law"), "--quiet"]) in (0, 1)
    return folder / "law"


def test_the_command_end_to_end(rates, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["design", str(rates), "--biases", "--bandwidth", "300", "--rate", "1e6", "--frequency", "50"]
    assert main([*words, "--out", str(out)]) == 0
    assert "fo" in capsys.readouterr().out
    written = json.loads((out / "design.json").read_text())
    check("design", written)
    best = written["recommended"]
    true = CUTOFF_HZ * np.exp((BIASES[0] - best["bias_mv"]) / EFOLD_MV)
    low, high = best["predicted"]["bandwidth"]["interval_95"]
    assert low < true < high
    assert true > 300.0
    assert "rates.json" in written["inputs_sha256"]
    assert (out / "biases.svg").is_file()
    (out / "report.html").unlink()
    write_report(out)
    assert "Settings that were measured" in (out / "report.html").read_text()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("{law} --biases", "--bandwidth"),
        ("{law} --biases --bandwidth 0", "above 0"),
        ("{law} --biases --bandwidth 100 --bias pr", "pr"),
        ("{law} --biases --bandwidth 100 --draws 3", "--draws"),
        ("{law} --biases --rate 100", "--frequency"),
        ("dvs128 --bandwidth 100", "--biases"),
        ("dvs128 --biases --bandwidth 100", "rates.json"),
    ],
)
def test_bad_input_is_refused(rates, words, says, tmp_path, capsys):
    assert main(["design", *words.format(law=rates).split(), "--out", str(tmp_path / "out")]) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_what_is_wrong_with_the_fit_is_wrong_with_the_setting(rates, tmp_path):
    content = json.loads((rates / "rates.json").read_text())
    for status, advice in (("misfit", "check the unit of the table"), ("not_converged", "")):
        (tmp_path / "rates.json").write_text(json.dumps({**content, "status": status, "advice": advice}))
        found = bias_report(tmp_path, {"bandwidth": 300.0})
        assert found.status == status
        assert (advice or Status(status).advice) in found.content["advice"]
        assert found.content["recommended"]["met"]
    (tmp_path / "rates.json").write_text(json.dumps({**content, "status": "fine"}))
    with pytest.raises(InputError, match=r"rates\.json"):
        read_bias_fit(tmp_path)


def test_fits_that_say_nothing_of_a_bias_are_refused(rates, tmp_path):
    content = json.loads((rates / "rates.json").read_text())
    law = content["bias_law"]
    open_law = {**law, "mv_per_efold": {**law["mv_per_efold"], "identified": False}}
    for changed, says in (
        ({k: v for k, v in content.items() if k != "bias_law"}, "no law of a bias"),
        ({**content, "bias_law": open_law}, "do not fix"),
        ({**content, "bias_law": {**law, "bias_mv": 3}}, "a fitted law"),
        ({**content, "parameters": {}}, "a fitted law"),
    ):
        (tmp_path / "rates.json").write_text(json.dumps(changed))
        with pytest.raises(InputError, match=says):
            read_bias_fit(tmp_path)
