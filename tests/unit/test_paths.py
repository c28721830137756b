"""Whole paths of true times behind blurred stamps, against chances summed on a grid by other means."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from pixelid.gap.imputation import paths as whole_paths
from pixelid.gap.imputation.chances import BLOCK, Light, Thresholds, add_chances
from pixelid.gap.imputation.lattice import draw_path
from pixelid.gap.imputation.paths import Lights, draw_paths, followable
from pixelid.gap.imputation.windows import jitter_windows, tick_windows
from pixelid.model.shipped import find_model
from pixelid.recordings.own_light import with_fine_light
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp

STEP_S, DEAD_S = 2e-6, 1e-4
AT = Thresholds(0.2, 0.25, 0.01, 0.012, 0.0)
MODEL = find_model("dvs128")


def light(log_radiance: np.ndarray, dead_s: float = DEAD_S) -> Light:
    """A pixel without filters: output and reset level are the log radiance."""
    blocks = np.append(log_radiance, np.full(-len(log_radiance) % BLOCK, log_radiance[-1])).reshape(-1, BLOCK)
    return Light(
        0.0, STEP_S, log_radiance, log_radiance, np.zeros(len(log_radiance)), blocks.max(axis=1), blocks.min(axis=1),
        0.0, np.inf, dead_s,
    )  # fmt: skip


def crossing(u: np.ndarray, when: float, sign: float) -> np.ndarray:
    """(c,) chance, cell by cell, of the next event of one polarity after one at `when`, by running extremes."""
    t = STEP_S * np.arange(len(u))
    change = u - np.interp(when + DEAD_S, t, u)
    alive = t >= when + DEAD_S
    reached = []
    for s, mean, sd in ((1.0, AT.on, AT.sd_on), (-1.0, AT.off, AT.sd_off)):
        extreme = np.maximum.accumulate(np.where(alive, s * change, -np.inf))
        reached.append(norm.cdf((extreme - mean) / sd))
    own, other = reached if sign > 0 else reached[::-1]
    new = np.diff(np.concatenate([[0.0], own]))
    return new * (1.0 - np.concatenate([[0.0], other])[:-1])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("memory", [0.0, 0.1])
def test_chances_of_cells_are_those_of_the_running_extreme(sign, memory):
    t = STEP_S * np.arange(2000)
    u = 0.2155 * np.sin(2 * np.pi * 400.0 * t) + 100.0 * t  # about as likely to fall by the one as to rise by the other
    at = AT._replace(on=AT.on / (1.0 + memory), off=AT.off / (1.0 - memory), memory=memory)  # as AT after an ON event
    when = 3.01e-4
    cells = np.zeros(len(u)), np.zeros(len(u))
    add_chances(light(u), at, when, 1.0, 0, 1, len(u) - 1, *cells, 1.0)
    mine = cells[0] if sign > 0 else cells[1]
    np.testing.assert_allclose(mine, crossing(u, when, sign), atol=2e-5)
    assert 0.05 < mine.sum() < 0.99


def test_wide_cells_have_the_chances_of_the_narrow_ones_in_them():
    t = STEP_S * np.arange(2000)
    u, when, nothing = 150.0 * t, 2e-4, np.empty(0)
    fine, coarse = np.zeros(2000), np.zeros(500)
    add_chances(light(u), AT, when, -1.0, 3, 1, 1999, fine, nothing, 1.0)
    add_chances(light(u), AT, when, -1.0, 3, 4, 1999, coarse, nothing, 1.0)
    sums = [fine[max(4 * k - 3, 0) : 4 * k + 1].sum() for k in range(500)]
    np.testing.assert_allclose(coarse[: len(sums)], sums, atol=1e-5)


def drawn(path_light, on, off, sd, many, seed=0):
    rng = np.random.default_rng(seed)
    times = np.empty((many, len(on) + len(off)))
    for k in range(many):
        uniform = rng.random(2 * (len(on) + len(off)))
        value = draw_path(
            path_light, AT, on, off, sd, np.full(len(on), 6 * sd), np.full(len(off), 6 * sd), False, 1e-3, uniform,
            times[k, : len(on)], times[k, len(on) :],
        )  # fmt: skip
        assert np.isfinite(value)
    return times


@pytest.mark.slow
def test_paths_have_the_mean_and_scatter_of_the_posterior_summed_by_hand():
    """Three ON events under a ramp: the chain's posterior as a product of matrices."""
    u = 100.0 * STEP_S * np.arange(4600)  # a threshold in 2 ms, scattered by 0.1 ms
    stamps, sd = np.array([1.0e-3, 3.0e-3, 5.4e-3]), 3e-4
    t = STEP_S * (np.arange(len(u)) - 0.5)
    some = slice(0, len(u), 10)
    weigh = [norm.pdf(s, t[some], sd) for s in stamps]
    matrix = np.array([crossing(u, when, 1.0)[some] for when in t[some]])
    forward = weigh[0]
    forwards = [forward]
    for w in weigh[1:]:
        forward = (forward @ matrix) * w
        forwards.append(forward)
    backward = np.ones(len(forward))
    expected = []
    for k in (2, 1, 0):
        p = forwards[k] * backward
        p /= p.sum()
        mean = p @ t[some]
        expected.append((mean, np.sqrt(p @ (t[some] - mean) ** 2)))
        backward = matrix @ (weigh[k] * backward)
    times = drawn(light(u), stamps, np.empty(0), sd, 1500)
    for k, (mean, scatter) in zip((2, 1, 0), expected, strict=True):
        assert times[:, k].mean() == pytest.approx(mean, abs=4 * scatter / np.sqrt(1500) + STEP_S)
        assert times[:, k].std() == pytest.approx(scatter, rel=0.08)


def test_stamps_with_windows_of_their_own_have_the_likelihood_summed_by_hand():
    """Four ON events under a ramp, the third known exactly: sums over the windows, cell by cell, for two thresholds."""
    u = 100.0 * STEP_S * np.arange(5200)
    t = STEP_S * np.arange(len(u))
    stamps, reach = np.array([1.0e-3, 3.2e-3, 5.1e-3, 7.4e-3]), np.array([2e-4, 6e-4, 0.0, 3e-4])
    within = [
        (t >= s - r) & (t <= s + r) if r else np.arange(len(t)) == np.ceil(s / STEP_S)
        for s, r in zip(stamps, reach, strict=True)
    ]
    nothing, uniform, times = np.empty(0), np.full(8, 0.5), np.empty(4)
    by_hand, found = [], []
    for on in (0.2, 0.19):
        at = AT._replace(on=on)
        forward = 1.0 * within[0]
        for here in within[1:]:
            new = np.zeros(len(t))
            for k in np.flatnonzero(forward):
                reached = u - np.interp(t[k] - 0.5 * STEP_S + DEAD_S, t, u)
                crossed = norm.cdf((np.where(t >= t[k] + DEAD_S, reached, -np.inf) - on) / at.sd_on)
                new += forward[k] * np.diff(np.concatenate([[0.0], crossed]))
            forward = new * here
        by_hand.append(np.log(forward.sum()))
        found.append(
            draw_path(light(u), at, stamps, nothing, np.inf, reach, nothing, False, 1e-3, uniform, times, np.empty(0))
        )
        assert (np.abs(times - stamps) <= reach + STEP_S).all()
    assert found[1] - found[0] == pytest.approx(by_hand[1] - by_hand[0], abs=0.02)


def test_polarities_are_put_in_the_order_that_the_light_allows():
    """Light rises by a threshold and falls again: the ON event came first, though its stamp is the later one."""
    t = STEP_S * np.arange(4000)
    u = np.interp(t, [0.0, 1e-3, 3e-3, 3.5e-3, 6e-3, 8e-3], [0.0, 0.0, 0.24, 0.24, -0.06, -0.06])
    first = np.array([0.4e-3])  # an OFF event before, as reference
    on, off = np.array([4.9e-3]), np.array([0.4e-3, 4.6e-3])
    times = drawn(light(u), on, off, 6e-4, 60)
    assert (times[:, 0] < times[:, 2]).all()
    assert (times[:, 2] > 3.5e-3).all()
    assert np.abs(times[:, 1] - first).max() < 3e-3


def test_the_order_of_two_events_has_its_odds():
    """Either polarity may have come first; how often, the grid of all pairs of times says."""
    t = STEP_S * np.arange(3000)
    u = 0.235 * np.sin(2 * np.pi * 300.0 * t)
    on, off, sd = np.array([1.0e-3, 3.2e-3]), np.array([2.4e-3]), 8e-4
    times = drawn(light(u), on, off, sd, 1200)
    some = np.arange(0, len(u), 12)
    middle = t - 0.5 * STEP_S
    first = norm.pdf(on[0], middle[some], sd)
    chance = np.zeros(3)
    by_on, by_off = (np.array([crossing(u, when, s) for when in middle[some]]) for s in (1.0, -1.0))

    def weigh(stamp):
        return norm.pdf(stamp, middle[some], sd)

    from_on = [by_on[:, some], by_off[:, some]]
    chance[0] = (first @ from_on[1] * weigh(off[0])) @ from_on[0] @ weigh(on[1])  # ON OFF ON
    chance[1] = (first @ from_on[0] * weigh(on[1])) @ from_on[1] @ weigh(off[0])  # ON ON OFF
    chance[2] = (weigh(off[0]) @ from_on[0] * weigh(on[0])) @ from_on[0] @ weigh(on[1])  # OFF ON ON
    chance /= chance.sum()
    order = np.argsort(times, axis=1)
    seen = [np.mean((order == which).all(axis=1)) for which in ([0, 2, 1], [0, 1, 2], [2, 0, 1])]
    np.testing.assert_allclose(seen, chance, atol=4 * np.sqrt(0.25 / 1200))


@pytest.fixture(scope="module")
def exact():
    return simulate(MODEL, chirp(60.0, stop_hz=100.0, duration_s=0.3), width=2, height=2, seed=1)


def test_times_behind_a_coarse_tick_stay_in_it_and_a_dead_time_apart(exact):
    tick_ns = 1e6  # ten dead times: several events of a pixel share a stamp
    stamped = replace(exact, events=replace(exact.events, t=(np.rint(exact.events.t / tick_ns) * tick_ns).astype(int)))
    recording = with_fine_light(stamped, "smooth")
    pixel = recording.events.pixel
    assert len(np.unique(np.stack([pixel, recording.events.t]), axis=1).T) < len(pixel)
    window = tick_windows(recording, 1e-9 * tick_ns)
    paths = draw_paths(
        [recording], [window], [recording.events.t.astype(float)], MODEL.circuit(), np.random.default_rng(0)
    )
    times = paths.times[0]
    assert paths.stuck == 0
    assert ((window.lo <= times) & (times <= window.hi)).all()
    order = np.lexsort((times, pixel))
    same = np.diff(pixel[order]) == 0
    assert np.diff(times[order])[same].min() > 0.95e9 * MODEL.values["refractory_s"]


def test_displacements_behind_a_jitter_are_that_jitter(exact):
    sd = 2e5
    rng = np.random.default_rng(2)
    late = np.clip(exact.events.t + rng.normal(0.0, sd, len(exact.events)), 0, 3e8)
    order = np.argsort(late)
    events = replace(exact.events.select(order), t=np.rint(late[order]).astype(int))
    recording = with_fine_light(replace(exact, events=events), "smooth")
    window = jitter_windows(recording, 1e-9 * sd)
    times = [recording.events.t.astype(float)]
    for _ in range(3):
        times = draw_paths([recording], [window], times, MODEL.circuit(), rng).times
    off = recording.events.t - times[0]
    assert abs(off.mean()) < 4 * sd / np.sqrt(len(off))
    assert np.sqrt(np.mean(off**2)) == pytest.approx(sd, rel=0.15)


def test_light_that_is_remembered_draws_the_same_paths(exact, monkeypatch):
    """It is that of the model: another one, and stamps after the light's end, have their own."""
    made, make = [], whole_paths._light

    def counted(*given):
        made.append(given)
        return make(*given)

    monkeypatch.setattr(whole_paths, "_light", counted)
    recording, stamps = with_fine_light(exact, "smooth"), [exact.events.t.astype(float)]
    other = MODEL.set({"sf_cutoff_hz": 0.5 * MODEL.values["sf_cutoff_hz"]})

    def drawn_paths(sd_s, model, lights=None):
        rng, windows = np.random.default_rng(3), [jitter_windows(recording, sd_s)]
        return draw_paths([recording], windows, stamps, model.circuit(), rng, lights)

    lights = Lights()
    for sd_s, model, makes in ((1e-4, MODEL, 1), (2e-4, MODEL, 0), (2e-4, other, 1), (1e-4, MODEL, 0)):
        made.clear()
        again = drawn_paths(sd_s, model, lights)
        assert len(made) == makes
        anew = drawn_paths(sd_s, model)
        assert again.log_likelihoods == anew.log_likelihoods
        np.testing.assert_array_equal(again.times[0], anew.times[0])
    late = replace(recording, events=replace(recording.events, t=recording.events.t + int(2e7)))
    assert lights.of(late, MODEL.circuit()) is not lights.of(recording, MODEL.circuit())
    assert lights.of(recording, MODEL.circuit()) is lights.of(recording, MODEL.circuit())


def test_paths_are_only_drawn_under_full_field_light_that_is_known(exact):
    assert followable([exact], MODEL)
    video = replace(exact.stimulus, radiance=np.ones((len(exact.stimulus.t), 2, 2)))
    assert not followable([exact.with_stimulus(video)], MODEL)
