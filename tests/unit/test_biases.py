"""Biases of jAER headers as currents and as values of the pixel: numbers worked by hand, and errors by simulation."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pixelid.biases import currents_of, has_jaer_biases, implied_by
from pixelid.biases.currents import master_current_a
from pixelid.errors import InputError
from pixelid.fit.bias_priors import beside_events, independent, with_bias_priors
from pixelid.model.shipped import find_model
from pixelid.recordings import Events, Recording, open_recording, write_recording

SHARED = Path(__file__).resolve().parents[3] / "shared" / "recordings"
# of a DAVIS240C: coarse and fine values
BOXES = {"DiffBn": (3, 39), "OnBn": (2, 255), "OffBn": (3, 0), "PrBp": (5, 58), "PrSFBp": (6, 16), "RefrBp": (3, 25)}
ALL = BOXES | {"OffBn": (5, 40)}
DVS128 = {"diff": 13125, "diffOn": 209996, "diffOff": 132, "refr": 969, "foll": 271, "Pr": 217}


def davis(settings: dict[str, tuple[int, int]], **more: str) -> dict[str, str]:
    entries = {}
    for name, (coarse, fine) in settings.items():
        entries |= {f"AddressedIPotCF.{name}.BitValueCoarse": str(coarse)}
        entries |= {f"AddressedIPotCF.{name}.BitValueFine": str(fine)}
    return entries | {key.replace("__", "."): value for key, value in more.items()}


def dvs128(settings: dict[str, int] | None = None) -> dict[str, str]:
    return {f"IPot.{name}": str(value) for name, value in (DVS128 if settings is None else settings).items()}


def recording(biases: object, sensor: str = "DAVIS240C", name: str = "one") -> Recording:
    attributes = {} if biases is None else {"biases": biases}
    return Recording(Events.empty(2, 2, tick_ns=1000), sensor=sensor, source=Path(f"{name}.h5"), attributes=attributes)


def implied(settings=ALL, **more: str):
    return implied_by(currents_of("DAVIS240C", davis(settings, **more)))


def test_currents_of_a_davis_by_hand():
    roles = currents_of("DAVIS240C", davis(BOXES)).roles
    picoampere = {role: current.ampere * 1e12 for role, current in roles.items()}
    assert picoampere == pytest.approx({
        "differencing": 48437 * 39 / 255, "on": 387500.0, "off": 0.0, "photoreceptor": 756 * 58 / 255,
        "follower": 94 * 16 / 255, "refractory": 48437 * 25 / 255,
    })  # fmt: skip
    for coarse in range(8):  # jAER's own: 389 nA at a coarse value of 2, a factor 8 a step, of 256
        own = 389e-9 * 8.0 ** (2 - coarse) * 100 / 256
        ampere = currents_of("DAVIS346B", davis({"OnBn": (coarse, 100)})).roles["on"].ampere
        assert ampere == pytest.approx(own, rel=0.08)


def test_currents_of_a_dvs128_by_hand():
    # 25.827 mV · ln 45 / 8.2 kΩ = 11.99 µA in weak inversion, 2 · 0.7241 / (340 µA/V² · (8.2 kΩ)²) = 63.34 µA in strong
    assert master_current_a({}) == pytest.approx(11.99e-6 + 63.34e-6, rel=1e-3)
    assert currents_of("DVS128", dvs128()).roles["differencing"].ampere == pytest.approx(58.93e-9, rel=1e-3)
    with_internal = {"Masterbias.rx": "8200.0", "Masterbias.internalResistorUsed": "true"}  # 54.2 kΩ
    assert master_current_a(with_internal) == pytest.approx(1.814e-6 + 1.450e-6, rel=1e-3)


def test_values_of_a_davis_by_hand():
    told = implied(BOXES)
    assert set(told.values) == {"on_threshold", "refractory_s", "sf_cutoff_hz"}
    # ln(387500 / 7408) / (0.7 · 20)
    assert told.values["on_threshold"].value == pytest.approx(3.95715 / 14.0, rel=1e-4)
    assert told.values["refractory_s"].value == pytest.approx(3.3693e-6, rel=1e-4)  # 20 fF · 0.8 V / 4.7487 nA
    assert told.values["sf_cutoff_hz"].value == pytest.approx(286.3, rel=1e-3)  # 5.898 pA / (2π · 25 mV · 131.167 fF)
    assert told.without == {"off_threshold": "OffBn is set to no current"}
    both = implied()
    assert both.values["off_threshold"].value == pytest.approx(math.log(7408.0 / 118.59) / 14.0, rel=1e-4)


def test_values_of_a_dvs128_by_hand():
    told = implied_by(currents_of("DVS128", dvs128()))
    assert told.values["on_threshold"].value == pytest.approx(2.77257 / 15.4, rel=1e-4)  # ln 15.9997 / (0.7 · 22)
    assert told.values["off_threshold"].value == pytest.approx(4.59940 / 15.4, rel=1e-4)  # ln 99.432
    assert all("no capacitance is known" in told.without[name] for name in ("refractory_s", "sf_cutoff_hz"))
    double = implied_by(currents_of("DVS128", dvs128() | {"Masterbias.rx": "20000"}))  # cancels in a ratio
    assert double.values["on_threshold"].value == pytest.approx(told.values["on_threshold"].value, rel=1e-12)


def test_the_spread_of_values_is_that_of_what_makes_them():
    """10⁵ chips whose κ, capacitors and currents scatter as stated: the formulas again, without linearisation."""
    rng, n = np.random.default_rng(1), 100_000

    def lognormal(centre, sd):
        return centre * np.exp(sd * rng.standard_normal(n))

    kappa = lognormal(0.7, 0.1) / lognormal(0.7, 0.1) ** 2
    ratio = lognormal(387500.0, 0.25) / lognormal(7408.0, 0.25)
    threshold = kappa / lognormal(20.0, 0.2) * np.log(ratio)
    master = lognormal(1.0, 0.2)
    dead = lognormal(20e-15, 0.4) * lognormal(0.8, 0.2) / (lognormal(4.7487e-9, 0.25) * master)
    leak = math.log1p(1.0 / 5.898)
    follower = lognormal(5.898e-12, math.hypot(0.25, leak)) * master * lognormal(1.0, 0.2)
    cutoff = follower / (2.0 * math.pi * lognormal(25e-3, 0.07) * lognormal(131.167e-15, 0.2))
    values = implied(BOXES).values
    for name, drawn in (("on_threshold", threshold), ("refractory_s", dead), ("sf_cutoff_hz", cutoff)):
        low, high = np.percentile(np.log(drawn), [2.5, 97.5])
        assert np.log(drawn).std() == pytest.approx(values[name].sd, rel=0.02), name
        assert np.log(values[name].interval_95) == pytest.approx([low, high], abs=0.05), name


def test_priors_claim_no_more_than_values_that_share_their_errors():
    values = implied().values
    priors = independent(values)
    alone = independent({"on_threshold": values["on_threshold"]})["on_threshold"]
    assert alone.sd == pytest.approx(values["on_threshold"].sd)
    names = list(values)
    rng = np.random.default_rng(2)
    for _ in range(50):  # whichever way a source of error moves either parameter
        sources = {source for value in values.values() for source in value.errors}
        pushes = [[rng.choice([-1, 1]) * values[name].errors.get(source, 0.0) for name in names] for source in sources]
        shared = np.array(pushes).T @ np.array(pushes)
        stated = np.diag([priors[name].sd ** 2 for name in names])
        assert np.linalg.eigvalsh(stated - shared).min() > -1e-12
    assert priors["on_threshold"].sd < math.sqrt(2.0) * values["on_threshold"].sd + 1e-12


def test_what_gives_no_current_gives_no_value():
    assert implied(ALL, AddressedIPotCF__OnBn__Enabled="false").without["on_threshold"] == "OnBn is switched off"
    assert implied(ALL | {"DiffBn": (3, 0)}).without["off_threshold"] == "DiffBn is set to no current"
    assert implied(ALL | {"RefrBp": (3, 0)}).without["refractory_s"] == "RefrBp is set to no current"
    few = implied({name: value for name, value in ALL.items() if name not in ("PrBp", "RefrBp")})
    assert few.without == {"refractory_s": "the header has no RefrBp", "sf_cutoff_hz": "the header has no PrBp"}
    assert "does not make the cutoff alone" in implied(ALL | {"PrSFBp": (5, 30)}).without["sf_cutoff_hz"]
    assert "has no threshold" in implied(ALL | {"OnBn": (3, 60)}).without["on_threshold"]  # a ratio of 1.5
    assert "has no threshold" in implied(ALL | {"OnBn": (5, 60)}).without["on_threshold"]  # below that of DiffBn


@pytest.mark.parametrize(
    ("sensor", "biases", "words"),
    [
        ("EVK4", davis(ALL), "sensor: expected one of DAVIS240, DAVIS346, DVS128, found 'EVK4'"),
        ("", davis(ALL), "found nothing"),
        ("DAVIS240C", {"bias_diff": 299}, "found none"),
        ("DAVIS240C", [1, 2], "found none"),
        ("DAVIS240C", None, "found none"),
        ("DVS128", davis(ALL), "found none"),
        ("DAVIS240C", davis(ALL) | {"AddressedIPotCF.OnBn.BitValueFine": "nan"}, "OnBn.BitValueFine: expected a whole"),
        ("DAVIS240C", davis(ALL | {"OnBn": (2, 256)}), "from 0 to 255, found '256'"),
        ("DAVIS240C", davis(ALL | {"OnBn": (8, 25)}), "from 0 to 7, found '8'"),
        ("DAVIS240C", davis(ALL) | {"AddressedIPotCF.OnBn.BitValueFine": "-1"}, "found '-1'"),
        ("DAVIS240C", davis(ALL) | {"AddressedIPotCF.OnBn.BitValueFine": "²"}, "found '²'"),
        ("DAVIS240C", davis(ALL) | {"AddressedIPotCF.OnBn.BitValueFine": [3]}, "found '[3]'"),
        ("DVS128", dvs128(DVS128 | {"diff": 1 << 24}), "from 0 to 16777215"),
        ("DVS128", dvs128() | {"Masterbias.rx": "nan"}, "Masterbias.rx: expected a resistance"),
        ("DVS128", dvs128() | {"Masterbias.rx": "0"}, "Masterbias.rx: expected a resistance"),
    ],
)
def test_bad_settings_get_one_line(sensor, biases, words):
    with pytest.raises(InputError) as caught:
        currents_of(sensor, biases)
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    if "found none" not in words and sensor in ("DAVIS240C", "DVS128"):
        with pytest.raises(InputError, match=r"one\.h5|one: biases"):
            with_bias_priors(find_model("dvs128"), [recording(biases, sensor)])


def test_a_model_takes_priors_of_its_free_parameters():
    dvs = find_model("dvs128").fix({"on_threshold": 0.3})
    model, told = with_bias_priors(dvs, [recording(davis(ALL))])
    values = implied().values
    assert model.values["on_threshold"] == 0.3
    assert model.parameters["on_threshold"].prior is None
    assert told["unused"]["on_threshold"] == "it is held"
    for name in ("off_threshold", "refractory_s", "sf_cutoff_hz"):
        prior = model.parameters[name].prior
        assert prior is not None
        assert prior.mean == pytest.approx(math.log(values[name].value))
        assert model.values[name] == pytest.approx(values[name].value)
        assert told["priors"][name]["sd"] == prior.sd
    bare, told = with_bias_priors(dvs.without_effect("refractory_period"), [recording(davis(ALL))])
    assert "refractory_s" not in bare.parameters
    assert told["unused"]["refractory_s"] == "not in model dvs128"
    with pytest.raises(InputError, match="a prior for no free parameter"):
        with_bias_priors(dvs, [recording(davis({"OnBn": (2, 255), "DiffBn": (3, 39)}))])


def test_where_events_and_biases_disagree_or_add_nothing():
    _, told = with_bias_priors(find_model("dvs128"), [recording(davis(ALL))])
    mean, sd = (told["priors"]["on_threshold"][key] for key in ("mean", "sd"))
    names = ("gamma", "on_threshold")

    def said(z: float, share: float) -> list[str]:
        return beside_events(told, names, np.array([0.0, mean + z * sd]), np.array([1.0, share * sd]))

    assert said(1.0, 0.5) == []
    assert "the events add next to nothing" in said(0.0, 0.95)[0]
    assert "3.5 standard deviations from what the biases say" in said(-3.5, 0.1)[0]


def test_recordings_of_one_setting_only():
    frames = recording(davis(ALL, AddressedIPotCF__ApsROSFBn__BitValueFine="3"))  # a bias of the frames' readout
    with_bias_priors(find_model("dvs128"), [recording(davis(ALL)), frames])
    for other, words in (
        (
            recording(davis(ALL | {"OnBn": (2, 100)}), name="two"),
            r"two.*other biases.*OnBn: 3\.87e-07 A and 1\.52e-07 A",
        ),
        (recording(davis({**ALL, "OnBn": (2, 255)}), "DAVIS346B", "two"), "DAVIS240C and DAVIS346B"),
        (recording(None, name="two"), "two.*bias.priors: expected the bias settings of a jAER header"),
        (recording({"bias_diff": 299}, "EVK4", "two"), "found none"),
    ):
        with pytest.raises(InputError, match=words):
            with_bias_priors(find_model("dvs128"), [recording(davis(ALL)), other])


@pytest.mark.parametrize("ending", ["h5", "npz", "csv"])
def test_conversion_keeps_what_biases_imply(tmp_path, ending):
    events = Events.from_columns([1000, 2000], [0, 1], [0, 1], [1, 0], 2, 2)
    write_recording(replace(recording(davis(ALL)), events=events), tmp_path / f"r.{ending}")
    again = open_recording(tmp_path / f"r.{ending}")
    assert has_jaer_biases(again.sensor, again.attributes["biases"])
    assert implied_by(currents_of(again.sensor, again.attributes["biases"])) == implied()


def test_an_aedat2_file_of_a_dvs128(tmp_path):
    header = "#!AER-DAT2.0\r\n# AEChip: ch.unizh.ini.jaer.chip.retina.DVS128\r\n"
    entries = {f"DVS128.{key}": value for key, value in dvs128().items()} | {"DVS128.Masterbias.rx": "8200.0"}
    header += "".join(f'#<entry key="{key}" value="{value}"/>\r\n' for key, value in entries.items())
    on, off = (5 << 8) | (9 << 1), (127 << 8) | (127 << 1) | 1  # row, column, 0 for ON
    words = np.array([[on, 10], [1 << 15, 11], [1 << 31, 12], [off, 13]], ">u4")
    (tmp_path / "r.aedat").write_bytes(header.encode() + words.tobytes())
    read = open_recording(tmp_path / "r.aedat")
    assert (read.events.width, read.events.height, read.sensor) == (128, 128, "DVS128")
    columns = (read.events.t // 1000, read.events.x, read.events.y, read.events.p)
    assert [column.tolist() for column in columns] == [[10, 13], [9, 127], [5, 127], [1, 0]]
    assert read.attributes["biases"]["Masterbias.rx"] == "8200.0"
    told = implied_by(currents_of(read.sensor, read.attributes["biases"]))
    assert told.values["on_threshold"].value == pytest.approx(0.18004, rel=1e-4)


@pytest.mark.parametrize("name", ["davis240_boxes.aedat", "davis240_rotdisk.aedat"])
def test_real_headers(name):
    if not (SHARED / name).exists():
        pytest.skip("shared recordings absent")
    read = open_recording(SHARED / name)
    told = implied_by(currents_of(read.sensor, read.attributes["biases"]))
    assert told.as_dict() == implied(BOXES).as_dict()
