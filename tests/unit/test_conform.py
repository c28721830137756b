"""The table's rows, folded from reports made by hand: every verdict from the evidence that it stands for."""

from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from pixelid import stages
from pixelid.conform.conform import conform
from pixelid.conform.fold import Beside, nats_needed, rows_of
from pixelid.conform.removals import BANDWIDTH, Removal, without_bandwidth
from pixelid.conform.result import ConformReport
from pixelid.conform.row import STAGES
from pixelid.errors import InputError
from pixelid.gap.attribute.significance import chance_of_gain
from pixelid.gap.criteria import Criteria
from pixelid.gap.gap import gap
from pixelid.gap.result import GapReport, Named
from pixelid.inspection.timestamps import TimestampSignature, with_coarse_units_as_grids
from pixelid.model.shipped import find_model
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate
from pixelid.status import Status
from pixelid.stimuli.shapes import chirp

LEAK = Named("leak", 1e-9, 40.0, "parasitic_photocurrent", 20.0, 0.3, "dark_current",
             {"leak.rate_hz": (2.0, (1.9, 2.1))}, "ON events under constant light")  # fmt: skip


SPLIT = {"pixels": {"fit": 5, "select": 3, "confirm": 4}, "held_out": True}


def report(verdict="none", effects=(), rounds=(), details=None, base="dvs128", **changes) -> GapReport:
    base = find_model(base) if isinstance(base, str) else base
    model = base
    for effect in effects:
        model = model.with_effect(effect.name)
    known = {"sentence": "", "remainder": False, "global_p": 0.5, "alpha": 0.01, "free_run": None, "term": None,
             "recommended_next": {}, "seconds": 1.0, "seed": 0}  # fmt: skip
    return GapReport(verdict=verdict, effects=tuple(effects), rounds=tuple(rounds), base=base, model=model,
                     details=MappingProxyType({**SPLIT, **(details or {})}), **{**known, **changes})  # fmt: skip


def a_round(candidates=(), **told) -> dict:
    return {"round": 1, "p": 0.5, "named": None, "refused": None, "candidates": list(candidates), **told}


def candidate(name, gain, held, p) -> dict:
    return {"name": name, "gain_nats": gain, "heldout_gain_nats": held, "p_value": p}


def rows(found, **beside):
    return {row.effect: row for row in rows_of(found, Beside(**{"model": found.model, **beside}), Criteria())}


def test_what_is_too_little_for_the_search_is_too_little_for_the_table():
    model = find_model("dvs128").without_effect("threshold_mismatch")
    recording = simulate(model, chirp(24.0, duration_s=0.05, dt=2e-4), width=2, height=1, seed=1)
    found = conform([recording], model)
    assert found.status == gap([recording], model, recommend=False).status == Status.not_identified
    assert "events could not have shown an effect" in found.as_dict()["advice"]


def test_one_sensor_counts_in_one_coarse_unit():
    events = simulate(find_model("dvs128"), chirp(24.0, duration_s=1.0, dt=2e-4), width=4, height=1, seed=1).events
    fine = Recording(events, source=Path("fine.h5"))
    coarse = Recording(replace(events, t=events.t // 500_000 * 500_000, tick_ns=500_000), source=Path("coarse.h5"))
    assert [r.events.tick_ns for r in with_coarse_units_as_grids([coarse, coarse])] == [1, 1]
    assert [r.events.tick_ns for r in with_coarse_units_as_grids([fine, fine])] == [events.tick_ns] * 2
    with pytest.raises(InputError, match=r"coarse counts time in units of 0\.5 ms.*fine in"):
        with_coarse_units_as_grids([fine, coarse])


def test_every_effect_has_one_row_in_signal_order():
    found = rows_of(report(), Beside(report().model), Criteria())
    effects = [row.effect for row in found]
    assert sorted(effects) == sorted([*stages.LIBRARY, BANDWIDTH, "on_threshold", "off_threshold"])
    places = [STAGES.index(row.stage) for row in found]
    assert places == sorted(places)


def test_a_named_effect_is_present_with_its_strength_and_evidence():
    rounds = [a_round([candidate("leak", 60.0, 40.0, 1e-9)], named="leak")]
    row = rows(report("named", [LEAK], rounds))["leak"]
    assert row.verdict == "present"
    assert row.parameters == {"leak.rate_hz": (2.0, (1.9, 2.1))}
    assert (row.p_value, row.gain_nats, row.heldout_gain_nats) == (1e-9, 60.0, 40.0)
    assert row.why == "ON events under constant light"


def test_effects_that_explain_the_same_are_not_decidable():
    found = rows(report("ambiguous", [LEAK]), doubted={"leak": ["parasitic_photocurrent"]})
    assert found["leak"].verdict == found["parasitic_photocurrent"].verdict == "not_decidable"


def test_what_was_taken_back_is_not_decidable_and_numbers_are_of_one_model():
    rounds = [a_round([candidate("leak", 60.0, 40.0, 1e-9)], named="leak"), a_round([])]
    fitted = find_model("dvs128").set({"refractory_s": 2e-4})
    interval = {"refractory_s": (1.9e-4, 2.1e-4)}
    found = rows(
        report("unknown", rounds=rounds, details={"withdrawn": ["leak"]}, remainder=True), model=fitted,
        intervals=interval,
    )  # fmt: skip
    assert (found["leak"].verdict, found["leak"].gain_nats) == ("not_decidable", 60.0)
    assert "removed" in found["leak"].why
    assert found["refractory_period"].parameters == {"refractory_s": (2e-4, (1.9e-4, 2.1e-4))}


def test_what_pooled_counts_cannot_say():
    none = rows(report(), pixels=False)
    assert (none["dark_current"].verdict, none["on_threshold"].verdict) == ("not_tested", "present")
    assert "significant" in none["dark_current"].why
    assert "number of pixels" in none["on_threshold"].why
    tried = rows(report(rounds=[a_round(screened_nats={"dark_current": 0.1})]), pixels=False)["dark_current"]
    assert tried.verdict == "not_decidable"
    assert "moves nothing" not in tried.why
    rivals = {"dark_current": ["linear_log"]}
    one = Named("dark_current", 1e-9, 40.0, "linear_log", 39.0, 0.3, "linear_log", {}, "dim light")
    found = rows(report("ambiguous", [one]), pixels=False, doubted=rivals)
    assert found["dark_current"].verdict == found["linear_log"].verdict == "not_decidable"


def needed(effect, tried):
    return nats_needed(effect, 0.005, tried, {"fit": 5, "select": 3, "apart": True}, Criteria())


def test_the_nats_that_a_name_needs_give_it_four_times_in_five():
    """Gains drawn as the χ² that they are: on pixels that fit beside twenty effects, and on pixels that select."""
    rng, tried = np.random.default_rng(1), 20
    nats = needed("threshold_drift", tried)
    fit = 0.5 * (np.sqrt(2.0 * nats * 5 / 8) + rng.normal(size=100_000)) ** 2
    root = np.sqrt(2.0 * nats * 3 / 8)
    select = 0.5 * root**2 + root * rng.normal(size=100_000)
    significant = np.array([chance_of_gain("threshold_drift", g, tried) for g in fit[:20_000]]) < 0.005
    assert significant.mean() > 0.79
    assert (select > root).mean() > 0.79
    assert min(significant.mean(), (select > root).mean()) < 0.82


def test_what_a_named_effect_explained_away_is_judged_by_what_is_left():
    rounds = [
        a_round([candidate("mains_flicker", 900.0, 500.0, 0.0)], named="leak"),
        a_round(screened_nats={"leak": 1.0}),
    ]
    details = {"shows_at_typical_strength_nats": {"mains_flicker": 12733.0}}
    assert rows(report("named", [LEAK], rounds, details))["mains_flicker"].verdict == "absent"


def test_effects_of_the_base_that_only_timestamps_show():
    model = find_model("dvs128").with_effect("timestamp_quantisation").with_effect("hot_pixels")
    found = report(base=model)
    seen = TimestampSignature("hot_pixels", "hot_pixels.rate_hz", 50.0, (45.0, 55.0), 0.0, 2.0, 0.1, "one of 16")
    told = rows(found, signatures={"hot_pixels": seen}, readout={"timestamp_quantisation": "no grid"})
    assert told["hot_pixels"].verdict == "present"
    assert told["hot_pixels"].parameters == {"hot_pixels.rate_hz": (50.0, (45.0, 55.0))}
    assert (told["timestamp_quantisation"].verdict, told["timestamp_quantisation"].parameters) == ("absent", {})
    assert rows(found)["timestamp_quantisation"].verdict == "not_tested"


def test_a_threshold_that_no_event_tells_is_not_decidable():
    """Of recordings without an OFF event, off_threshold was "present, as fitted", of whatever value it began at."""
    off, noise = (find_model("dvs128").parameters[name] for name in ("off_threshold", "threshold_sigma"))
    verdicts = {
        (off.lower, off.upper): ("not_decidable", "not identified"),
        (0.2, off.upper): ("not_decidable", "only a lower limit"),
        (0.24, 0.26): ("present", "fitted value"),
    }
    for interval, (verdict, said) in verdicts.items():
        row = rows(report(), intervals={"off_threshold": interval})["off_threshold"]
        assert row.verdict == verdict
        assert said in row.why
        assert bool(row.parameters) is (said != "not identified")
    held = rows(report())["off_threshold"]
    assert held.verdict == "not_tested"
    assert rows(report(), pixels=False)["off_threshold"].verdict == "present"
    open_ = rows(report(), intervals={noise.name: (noise.lower, noise.upper)})["threshold_noise"]
    assert open_.verdict == "not_decidable"


def test_a_side_that_only_the_range_ends_is_open_and_limits_of_either_sign_are_the_larger():
    model = find_model("dvs128").with_effect("threshold_drift")
    low = model.parameters["sf_cutoff_hz"].lower
    found = rows(
        report(base=model), intervals={"sf_cutoff_hz": (low, 4e3), "threshold_drift.per_s": (-0.03, 0.004)},
        removals={name: Removal(0.1, -0.2, 1.0, False) for name in ("source_follower_pole", "threshold_drift")},
    )  # fmt: skip
    assert found["source_follower_pole"].parameters["sf_cutoff_hz"][1] == (None, 4e3)
    assert found["threshold_drift"].limit == ("threshold_drift.per_s", 0.03)


def test_absence_needs_that_it_would_have_been_seen():
    details = {"shows_at_typical_strength_nats": {"leak": 500.0, "dark_current": 2.0}}
    found = rows(report(details=details, rounds=[a_round(screened_nats={"leak": 0.1, "lower_cutoff": 0.0})]))
    assert found["leak"].verdict == "absent"
    assert found["leak"].limit == ("leak.rate_hz", pytest.approx(0.1 * (needed("leak", 2) / 500.0) ** 0.5))
    assert found["dark_current"].verdict == "not_decidable"
    assert found["lower_cutoff"].verdict == "not_decidable"  # tried, and it moved nothing
    assert found["parasitic_photocurrent"].verdict == "not_tested"


def test_the_limit_of_a_pole_is_above_its_typical_cutoff():
    details = {"shows_at_typical_strength_nats": {"source_follower_pole": 500.0}}
    limit = rows(report(details=details, base="photoreceptor"))["source_follower_pole"].limit
    assert limit is not None
    name, value = limit
    assert name == "sf_cutoff_hz"
    assert value == pytest.approx(3122.0 * (500.0 / needed("source_follower_pole", 1)) ** 0.5)


def test_what_would_gain_and_was_refused_is_not_absent():
    details = {"shows_at_typical_strength_nats": {"leak": 500.0}}
    rounds = [a_round([candidate("leak", 60.0, 40.0, 1e-9)], refused="leak: a flexible alternative explains more")]
    row = rows(report("unknown", rounds=rounds, details=details, remainder=True))["leak"]
    assert row.verdict == "not_decidable"
    assert "flexible alternative" in row.why


def test_what_the_structure_forbids_is_not_tested():
    rounds = [a_round([candidate("leak", 1.0, 0.0, 1.0)], skipped={"slew_limit": "needs both poles"})]
    row = rows(report(rounds=rounds))["slew_limit"]
    assert (row.verdict, row.why) == ("not_tested", "needs both poles")


@pytest.mark.parametrize(
    ("removal", "interval", "verdict"),
    [
        (Removal(50.0, 30.0, 1e-9, True), (9e-5, 1.1e-4), "present"),
        (Removal(0.1, -0.2, 1.0, False), (1e-8, 2e-5), "absent"),
        (Removal(0.1, -0.2, 1.0, False), (1e-8, 5e-4), "not_decidable"),
        (None, (9e-5, 1.1e-4), "present"),
        (Removal(0.1, -0.2, 1.0, False), None, "not_tested"),
    ],
)
def test_effects_of_the_base_are_judged_by_taking_them_out(removal, interval, verdict):
    beside = {"removals": {"refractory_period": removal} if removal else {},
              "intervals": {"refractory_s": interval} if interval else {}}  # fmt: skip
    assert rows(report(), **beside)["refractory_period"].verdict == verdict


def test_a_fast_pole_is_absent_where_its_cutoff_is_surely_above_the_typical_one():
    removal = {"differencing_pole": Removal(0.0, 0.0, 1.0, False)}
    fast = rows(report(), removals=removal, intervals={"diff_cutoff_hz": (1e5, 1e8)})["differencing_pole"]
    slow = rows(report(), removals=removal, intervals={"diff_cutoff_hz": (1e3, 1e8)})["differencing_pole"]
    assert (fast.verdict, fast.limit) == ("absent", ("diff_cutoff_hz", 1e5))
    assert slow.verdict == "not_decidable"


def test_what_only_timestamps_and_silence_show():
    found = rows(report(), readout={"timestamp_quantisation": "no grid", "hot_pixels": None})
    verdicts = [found[e].verdict for e in ("timestamp_quantisation", "hot_pixels", "shot_noise")]
    assert verdicts == ["absent", "not_decidable", "not_tested"]


def test_a_bandwidth_that_the_recordings_need():
    assert rows(report(), removals={BANDWIDTH: Removal(90.0, 70.0, 0.0, True)})[BANDWIDTH].verdict == "present"
    model = without_bandwidth(find_model("dvs128").with_effect("bandwidth_floor"))
    assert (model.photoreceptor, model.has("bandwidth_floor")) == ("unlimited", False)
    assert "alpha" not in model.values


def test_a_report_counts_its_rows_and_goes_to_a_folder(tmp_path):
    found = report("named", [LEAK])
    table = ConformReport(found, rows_of(found, Beside(found.model), Criteria()), "v2e", 2.0)
    assert sum(table.counts.values()) == len(table.rows)
    table.save(tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"conform.json", "gap.json", "model.toml"}
    assert "leak.rate_hz 2 (1.9 … 2.1)" in table.summary()
