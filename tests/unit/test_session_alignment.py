"""Sessions aligned at once, made by a pixel of ten lines: log light behind one pole, thresholds, dead time."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.recordings import session_cases
from pixelid.recordings.alignment import aligned, find_alignment
from pixelid.recordings.alignment_evidence import ENOUGH_NATS, evidence_nats
from pixelid.recordings.clocks import CRYSTAL, clock_of
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.recordings.session_alignment import align_session
from pixelid.recordings.session_cases import shared_rate
from pixelid.recordings.triggers import Triggers
from pixelid.stimuli.stimulus import Stimulus

PPM, STEP_S, BEGIN_S = -60.0, 5e-5, 3.2
OFFSETS = {"steps": 11.3, "chirp": 27.8, "slow": 44.1, "constant": 61.7}  # the light's time zero on the camera's clock


def log_lights() -> dict[str, np.ndarray]:
    t = STEP_S * np.arange(16_001)
    values = np.random.default_rng(5).uniform(-1.0, 1.0, 40)
    sine = np.sin(2.0 * np.pi * 2.5 * t)
    phase = 2.0 * np.pi * (3.0 * t + 0.5 * (150.0 / 0.8) * t**2)
    return {
        "steps": values[(t / 0.0201).astype(int)],
        "chirp": 0.9 * np.sin(phase),
        "slow": 0.9 * sine,
        "constant": np.zeros_like(t),
    }


def pixel_times(u: np.ndarray, threshold: float, cutoff_hz: float, dead_s: float) -> tuple[np.ndarray, np.ndarray]:
    """(times of events from the light's begin, polarities) of one pixel."""
    keep = np.exp(-2.0 * np.pi * cutoff_hz * STEP_S)
    y = np.empty_like(u)
    y[0] = u[0]
    for k in range(1, len(u)):
        y[k] = keep * y[k - 1] + (1.0 - keep) * 0.5 * (u[k] + u[k - 1])
    times, signs, when, reference = [], [], 0.0, y[0]
    for k in range(1, len(u)):
        while when < k * STEP_S:
            begin = max(when, (k - 1) * STEP_S)
            if when > (k - 1) * STEP_S:  # released within this step
                reference = y[k - 1] + (when / STEP_S - k + 1) * (y[k] - y[k - 1])
            sign = np.sign(y[k] - y[k - 1])
            rest = reference + sign * threshold - y[k - 1]
            if sign * (y[k] - reference) < threshold:
                break
            moment = max((k - 1 + rest / (y[k] - y[k - 1])) * STEP_S, begin)
            times.append(moment)
            signs.append(sign > 0)
            when = moment + dead_s
    return np.array(times), np.array(signs)


def session() -> tuple[list[Recording], list[Stimulus]]:
    """Nine pixels under each light, with trigger edges at the first and the last sample."""
    rng = np.random.default_rng(2)
    recordings, lights = [], []
    for name, u in log_lights().items():
        columns = []
        for pixel in range(9):
            t, p = pixel_times(u, 0.2 * np.exp(0.03 * rng.normal()), 300.0, 2e-4)
            columns += [(on_camera(name, BEGIN_S + moment), pixel, sign) for moment, sign in zip(t, p, strict=True)]
        t, pixel, p = np.array(sorted(columns), float).reshape(-1, 3).T
        ns = (np.rint(1e6 * t) * 1000).astype(np.int64)
        pixel = pixel.astype(int)
        events = Events.from_columns(ns, pixel % 3, pixel // 3, p.astype(int), width=3, height=3, tick_ns=1000)
        edges = [BEGIN_S, BEGIN_S + STEP_S * (len(u) - 1)]
        stamps = (np.rint([1e6 * on_camera(name, edge) for edge in edges]) * 1000).astype(np.int64)
        triggers = Triggers.from_columns(stamps, [True, True], [0, 0])
        recordings.append(Recording(events, condition=name, triggers=triggers))
        lights.append(Stimulus(BEGIN_S + STEP_S * np.arange(len(u)), 50.0 * np.exp(u)))
    return recordings, lights


def on_camera(name: str, light_s: float) -> float:
    return OFFSETS[name] + (1.0 + 1e-6 * PPM) * light_s


@pytest.fixture(scope="module")
def bench() -> tuple[list[Recording], list[Stimulus]]:
    return session()


@pytest.fixture(scope="module")
def by_events(bench):
    recordings, lights = bench
    return {one.name: one for one in align_session(without_edges(recordings), lights)}


def without_edges(recordings):
    return [replace(recording, triggers=None) for recording in recordings]


def test_events_share_a_clock_rate_and_have_delays_of_their_own(by_events):
    for name in ("steps", "chirp", "slow"):
        one = by_events[name]
        assert one.method == "auto"
        low, high = one.interval_95
        assert low < on_camera(name, BEGIN_S) < high
        assert not one.doubts
    low, high = by_events["constant"].clock_rate_interval_95
    assert low < 1e-6 * PPM < high
    assert high - low < 1.2e-4  # a third of what the prior leaves
    for name, most_s in (("steps", 4e-5), ("chirp", 1e-4)):
        assert by_events[name].offset_s == pytest.approx(on_camera(name, BEGIN_S), abs=most_s)


def test_a_periodic_light_is_placed_where_it_covers_the_events(bench, by_events):
    recordings, lights = bench
    assert "repeats itself" in by_events["slow"].sentence
    with pytest.raises(InputError, match="cannot say which"):
        find_alignment(recordings[2], lights[2], "auto")


def test_constant_light_takes_the_rate_and_covers_its_events(bench, by_events):
    recordings, lights = bench
    one = by_events["constant"]
    assert (one.method, one.evidence) == ("inherited", None)
    assert "any start serves" in one.sentence
    assert one.clock_rate_error == pytest.approx(by_events["steps"].clock_rate_error, abs=1e-5)
    t = np.array([60_000_000_000, 60_500_000_000])  # events of noise
    noisy = replace(
        recordings[3], triggers=None, events=Events.from_columns(t, [0, 1], [0, 1], [0, 1], width=3, height=3)
    )
    placed = align_session([noisy], [lights[3]])[0]
    assert len(aligned(noisy, lights[3], placed.alignment).events) == 2
    assert clock_of(aligned(noisy, lights[3], placed.alignment)).prior.rate_sd == CRYSTAL


def test_the_evidence_has_its_minimum_at_the_offset(by_events):
    for name in ("steps", "chirp"):
        evidence = by_events[name].evidence
        assert abs(evidence[0, np.argmin(evidence[1])]) < 5e-4


def test_edges_are_taken_where_events_agree(bench):
    recordings, lights = bench
    for one in align_session(recordings, lights):
        assert (one.method, one.doubts) == ("trigger", ())
        assert one.offset_s == pytest.approx(on_camera(one.name, BEGIN_S), abs=2e-6)
        assert one.clock_rate_error == pytest.approx(1e-6 * PPM, abs=3e-6)


@pytest.mark.parametrize(("edge", "which"), [(0, "first"), (1, "last")])
def test_a_late_edge_is_named_with_its_size(bench, edge, which):
    recordings, lights = bench
    stamps = recordings[0].triggers.t.copy()
    stamps[edge] += 90_000
    late = replace(recordings[0], triggers=replace(recordings[0].triggers, t=stamps))
    one, *others = align_session([late, *recordings[1:]], lights)
    assert [doubt.statement for doubt in one.doubts] == ["delay"]
    assert one.doubts[0].found == pytest.approx(9e-5, abs=3e-6)
    assert f"{which} trigger edge is 9" in one.doubts[0].sentence
    assert one.offset_s == pytest.approx(on_camera("steps", BEGIN_S), abs=2e-5)
    assert not any(other.doubts for other in others)


def test_exchanged_polarity_is_said(bench):
    recordings, lights = without_edges(bench[0]), bench[1]
    events = recordings[0].events
    one = align_session([replace(recordings[0], events=replace(events, p=1 - events.p)), recordings[1]], lights[:2])[0]
    assert (one.polarity, [doubt.statement for doubt in one.doubts]) == (-1, ["polarity"])
    assert one.offset_s == pytest.approx(on_camera("steps", BEGIN_S), abs=3e-5)


def test_another_recordings_light_is_said(bench):
    recordings, lights = without_edges(bench[0]), bench[1]
    first, second = align_session(recordings[:2], lights[1::-1])
    assert (first.light, second.light) == ("chirp", "steps")
    assert [doubt.statement for doubt in (*first.doubts, *second.doubts)] == ["light", "light"]
    assert first.offset_s == pytest.approx(on_camera("steps", BEGIN_S), abs=3e-5)


def test_a_start_stated_wrong_is_said_and_one_stated_right_is_kept(bench):
    recordings, lights = without_edges(bench[0]), bench[1]
    right, wrong = (f"{OFFSETS['steps'] + late:.6f}" for late in (5e-4, 0.2))
    kept = align_session(recordings[:1], lights[:1], {"steps": right})[0]
    assert (kept.method, kept.doubts) == ("given", ())
    doubted = align_session(recordings[:1], lights[:1], {"steps": wrong})[0]
    assert (doubted.method, doubted.doubts[0].statement) == ("auto", "delay")
    assert doubted.doubts[0].found == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize(
    ("how", "sd"), [("11.3", 1e-3), ("11.3±0.002", 2e-3), ("11.3+-2e-3", 2e-3), ("11.3 ± 5e-5", 5e-5)]
)
def test_an_offset_by_hand_has_an_error(bench, how, sd):
    found = find_alignment(bench[0][0], bench[1][0], how)
    assert found.prior.delay_sd_s == sd
    assert found.prior.rate_sd == CRYSTAL
    assert found.offset_interval_95 == pytest.approx((11.3 - 1.96 * sd, 11.3 + 1.96 * sd), abs=1e-6)
    clock = clock_of(aligned(bench[0][0], bench[1][0], found))
    assert clock.prior.delay_sd_s == sd
    for bad in ("11.3±-1", "11.3±a", "±1"):
        with pytest.raises(InputError, match="align: expected"):
            find_alignment(bench[0][0], bench[1][0], bad)


def test_an_oscilloscopes_zero_is_its_trigger(bench):
    recording, light = bench[0][0], bench[1][0]
    edge = recording.triggers.t[0] * 1e-9
    scope = light.shifted(-BEGIN_S - 0.1)  # a tenth of a second before its trigger
    assert find_alignment(recording, scope, "trigger").offset_s == pytest.approx(edge)
    assert find_alignment(recording, scope, "trigger@start").start_s == pytest.approx(edge)
    assert find_alignment(recording, light, "trigger").start_s == pytest.approx(edge)
    one_clock = find_alignment(recording, light, "trigger", one_clock=True)
    assert (one_clock.rate_error, one_clock.prior.rate_sd < 1e-6) == (0.0, True)
    assert one_clock.start_s == pytest.approx(edge)


def test_rates_are_combined_and_a_wrong_pair_of_edges_gives_way():
    means, sds = np.array([3e-5, 5e-5]), np.array([1e-5, 2e-5])
    together = shared_rate([(mean, sd, False) for mean, sd in zip(means, sds, strict=True)])
    weights = sds**-2.0
    assert together.mean == pytest.approx(weights @ means / weights.sum(), rel=0.02)  # beside a prior ten times as wide
    assert together.sd == pytest.approx(weights.sum() ** -0.5, rel=0.05)
    edges = [(mean, 1e-6, True) for mean in (3e-5, 3.05e-5, 9e-5)]
    assert shared_rate(edges).mean == pytest.approx(3.02e-5, abs=2e-6)
    assert shared_rate([]).mean == pytest.approx(0.0, abs=1e-9)


def test_evidence_counts_independent_blocks_not_events():
    rng = np.random.default_rng(0)
    t = np.sort(rng.uniform(0.0, 1.0, 1000))
    mine = 0.1 * rng.normal(size=1000)
    assert evidence_nats(t, mine, mine) <= 0.0
    everywhere, few = mine + 0.5, mine + np.where(np.abs(t - 0.5) < 0.02, 0.8, 0.0)
    assert evidence_nats(t, mine, everywhere) > 10 * ENOUGH_NATS
    assert evidence_nats(t, mine, few) > ENOUGH_NATS  # all of it in 4 % of the recording
    assert evidence_nats(t, everywhere, mine) < 0.0
    shared = 0.3 * rng.normal(size=12)[(12 * t).astype(int)]  # all events of a stretch are off together
    assert evidence_nats(t, shared, shared + 0.2) < 0.1 * evidence_nats(t, mine, mine + 0.2)


def test_lights_are_exchanged_and_not_shared(monkeypatch):
    """Of lights of one shape each recording follows one, which is nobody else's.

    Noise under constant light, which seems to follow another's, keeps its own.
    """
    follows = {"a": {2: 0.003, 1: 0.004}, "b": {0: 0.003}, "c": {2: 0.003}, "constant": {2: 0.07}, "none": {}}
    names = list(follows)
    events = session()[0][0].events.select(slice(0))
    recordings = [SimpleNamespace(name=name, triggers=None, events=events) for name in names]

    def hypotheses(i, recordings, lights, polarity):
        def events(loss):
            return SimpleNamespace(follows=True, loss_of_all=loss)

        return [session_cases._Hypothesis(events(loss), k) for k, loss in follows[names[i]].items()]

    monkeypatch.setattr(session_cases, "_hypotheses", hypotheses)
    monkeypatch.setattr(session_cases, "_events", lambda recording, light, polarity=1: None)
    cases = session_cases.cases_of(recordings, names, {})  # pyright: ignore[reportArgumentType]
    assert [case.of for case in cases] == ["b", "a", "c", "constant", "none"]
