"""What held-out events choose: which state is kept, when training stops, how smooth a field is held."""

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from pixelid.nerf.training.held_out import FACTORS, LOOKS, Look, Stopping, chosen, looked_at, most_gained, paired
from pixelid.nerf.training.recipe import Recipe

PIXELS, ROWS = 120, 3000


def watched(course, noise: float, seed: int = 0, apart: int = 50) -> Stopping:
    """Looks at losses that follow a course, every pixel with its own level and, from look to look, its own noise."""
    rng = np.random.default_rng(seed)
    level = rng.gamma(3.0, size=PIXELS)
    stopping = Stopping(tuple(range(0, apart * len(course), apart)))
    for k, size in enumerate(course):
        losses = level * (size + noise * rng.normal(size=PIXELS))
        stopping.add(Look(apart * k, losses, ROWS), {"vertices": k})
        if stopping.stopped:
            break
    return stopping


def test_a_gain_is_judged_by_students_test_over_pixels():
    rng = np.random.default_rng(3)
    old = rng.gamma(2.0, size=40)
    new = old * 0.995 + 0.05 * rng.normal(size=40)
    gain = paired(old, new, 400)
    n = len(old)
    # of a sum, whose spread is told by n values about their mean, all n counted
    score = (old - new).sum() / np.sqrt(((old - new - (old - new).mean()) ** 2).sum())
    statistic, p_value = ttest_1samp(old - new, 0.0, alternative="greater")
    assert score == pytest.approx(statistic * np.sqrt(n / (n - 1)))
    assert gain.share == pytest.approx(1.0 - new.sum() / old.sum())
    assert 0.001 < gain.p_value < 0.5
    assert gain.p_value == pytest.approx(p_value, rel=0.1)
    assert paired(old, old, 400).p_value > 0.4
    assert paired(old[:1], new[:1], 10).p_value == 1.0


@pytest.mark.parametrize(("apart", "least", "most_often"), [(0.01, 0.93, 0.97), (0.2, 0.95, 1.0)])
def test_the_upper_limit_of_a_gain_covers_the_true_one(apart, least, most_often):
    """A loss that falls by 2 % a look: pixels with slopes of their own, and a course that moves all together.

    Where pixels differ it covers more than asked: all of the error is given the few degrees of freedom of the course.
    """
    rng, covered, wide = np.random.default_rng(0), 0, []
    for _ in range(2000):
        level, slope = rng.gamma(3.0, size=PIXELS), 0.06 + apart * rng.normal(size=PIXELS)
        course = 0.05 * rng.normal(size=5)
        looks = level + course[:, None] - slope * np.arange(5)[:, None]
        most = most_gained(looks, 3.0, 0.05)
        covered += most > 3.0 * 0.06 * PIXELS / looks[-1].sum()
        wide.append(most)
    assert least < covered / 2000 < most_often
    assert np.median(wide) < 0.15
    assert most_gained(looks[:2], 3.0, 0.05) == np.inf
    assert most_gained(looks[:, :1], 3.0, 0.05) == np.inf


def test_the_last_state_is_kept_while_none_before_is_demonstrably_better():
    falling = watched(np.linspace(1.0, 0.8, LOOKS), 0.02)
    assert (falling.kept, falling.scene) == (LOOKS - 1, {"vertices": LOOKS - 1})
    ties = [watched(np.ones(LOOKS), 0.02, seed) for seed in range(200)]
    assert np.mean([tie.kept == len(tie.looks) - 1 for tie in ties]) > 0.97  # the last one's


def test_the_best_state_is_kept_where_training_goes_wrong_after_it():
    course = [1.0, 0.9, 0.8, 0.7, 0.7, 0.8, 1.0, 1.2]
    stopping = watched(course, 0.02)
    assert stopping.kept in (3, 4)
    assert stopping.scene["vertices"] == stopping.kept
    said = stopping.as_dict(50 * len(course))
    assert said["kept"] == 50 * stopping.kept
    assert "demonstrably worse" in said["reason"]


def test_a_state_whose_loss_is_no_number_is_not_kept_and_rules_no_other_out():
    course = np.array([1.0, 0.9, 0.8, 0.7, 0.7, 0.7, 1.2, 1.2])
    for at, kept in ((2, (3, 4, 5)), (3, (4, 5)), (7, (3, 4, 5))):
        stopping = watched(np.where(np.arange(LOOKS) == at, np.nan, course), 0.02)
        assert stopping.kept in kept
        assert stopping.scene["vertices"] == stopping.kept
        assert np.isfinite(stopping.looks[stopping.kept].loss)


def test_training_stops_where_nothing_is_left_to_win_and_not_on_noise():
    still = watched(np.full(LOOKS, 0.5), 0.001)
    assert still.stopped
    assert len(still.looks) < LOOKS
    assert still.as_dict(99)["stopped_early"]
    for course, noise, apart in (
        (np.geomspace(1.0, 0.8, LOOKS), 0.001, 50),  # still falling by three per cent a look
        (np.full(LOOKS, 0.5), 0.2, 50),  # still, but who knows
        (np.full(LOOKS, 0.5), 0.001, 5),  # still, but for as long as steps remember each other
    ):
        stopping = watched(course, noise, apart=apart)
        assert not stopping.stopped
        assert len(stopping.looks) == LOOKS
    assert Stopping().as_dict(7) == {
        "kept": 7, "stopped_early": False, "reason": "no events were held out", "looks": [],
    }  # fmt: skip


def test_steps_beyond_the_last_look_win_nothing_where_the_loss_stands_still():
    still, falling = watched(np.full(LOOKS, 0.5), 1e-4), watched(np.linspace(1.0, 0.5, LOOKS), 1e-4)
    assert still.to_gain(100) < 0.01
    assert falling.to_gain() == 0.0  # all its looks are made
    assert falling.to_gain(100) > 0.1
    assert watched(np.full(LOOKS, 0.5), 1e-4, apart=6).to_gain(100) == np.inf  # too close to show anything


@pytest.mark.parametrize("iterations", [1, 2, 3, 7, 24, 1200, 30_000])
def test_looks_are_spread_over_the_last_stage_and_end_with_it(iterations):
    recipe = Recipe(iterations=iterations).with_cells(64)
    steps = looked_at(recipe.last_stage, iterations)
    assert steps[-1] == iterations
    assert len(steps) == min(LOOKS, max(iterations - recipe.last_stage, 1))
    assert all(recipe.vertices_at(step) == recipe.vertices[-1] for step in (recipe.last_stage, *steps))
    assert recipe.last_stage == 0 or recipe.vertices_at(recipe.last_stage - 1) != recipe.vertices[-1]


def test_another_regularisation_is_taken_only_where_it_is_demonstrably_better():
    rng = np.random.default_rng(0)
    usual = rng.gamma(3.0, size=PIXELS)
    better = 0.97 * usual + 0.05 * rng.normal(size=PIXELS)
    alike = usual + 0.05 * rng.normal(size=PIXELS)
    assert chosen(usual, [alike, better], ROWS).factor == FACTORS[1]
    assert chosen(usual, [better, alike], ROWS).factor == FACTORS[0]
    assert chosen(usual, [1.1 * usual, 1.1 * usual], ROWS).factor == 1.0
    assert chosen(usual, [better, np.full(PIXELS, np.nan)], ROWS).factor == FACTORS[0]
    draws = (chosen(usual, [usual + 0.05 * rng.normal(size=PIXELS) for _ in FACTORS], ROWS) for _ in range(1000))
    assert sum(draw.factor != 1.0 for draw in draws) < 25  # a hundredth, all together
    trials = chosen(usual, [alike, better], ROWS).trials
    assert [trial.factor for trial in trials] == [1.0, *FACTORS]
    assert trials[0].loss == pytest.approx(usual.sum() / ROWS)
