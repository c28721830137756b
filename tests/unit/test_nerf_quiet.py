"""What no event says: quiet intervals of a recording, pairs of times in them, and haze that they clear."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from pixelid.nerf.data.dataset import read_dataset
from pixelid.nerf.events.quiet import draw_pairs, quiet_intervals
from pixelid.nerf.pixel.model import Bandwidth
from pixelid.nerf.synthetic import make_dataset
from pixelid.nerf.training.losses import STILL, quiet_change
from pixelid.nerf.training.predict import draw_quiet
from pixelid.nerf.training.problem import problem_of
from pixelid.nerf.training.recipe import Recipe
from pixelid.nerf.training.state import start
from pixelid.nerf.training.train import step

WIDTH, HEIGHT = 5, 4


def by_hand(t, pixel, least, dead, left_out):
    """Pixel by pixel, in plain Python."""
    found = []
    for p in sorted(set(range(WIDTH * HEIGHT)) - set(left_out)):
        own = [float(time) for time, where in zip(t, pixel, strict=True) if where == p]
        begins, ends = [float(t[0]), *(time + dead for time in own)], [*own, float(t[-1])]
        found += [(a, b, p) for a, b in zip(begins, ends, strict=True) if b - a > least]
    return found


@pytest.mark.parametrize("left_out", [(), (3, 7)])
@pytest.mark.parametrize("dead", [0.0, 0.01])
@pytest.mark.parametrize("at_once", [1, 7, 10**6])
def test_quiet_intervals_are_those_between_events_and_ends_of_the_recording(left_out, dead, at_once, monkeypatch):
    monkeypatch.setattr("pixelid.nerf.events.quiet.EVENTS_AT_ONCE", at_once)
    rng = np.random.default_rng(0)
    t, pixel = np.sort(rng.uniform(0.2, 1.3, 30)), rng.integers(0, WIDTH * HEIGHT, 30)
    quiet = quiet_intervals(t, pixel, WIDTH, HEIGHT, least=0.05, dead=dead, left_out=left_out)
    expected = by_hand(t, pixel, 0.05, dead, left_out)
    assert list(quiet.pixel) == [p for _, _, p in expected]
    np.testing.assert_allclose(quiet.begin, [a for a, _, _ in expected])
    np.testing.assert_allclose(quiet.end, [b for _, b, _ in expected])
    np.testing.assert_allclose(quiet.until[-1], sum(b - a for a, b, _ in expected))


def test_a_silent_pixel_among_firing_ones_is_no_witness():
    """It may be broken; beside others that are silent too, it saw nothing."""
    firing = [p for p in range(WIDTH * HEIGHT) if p % WIDTH < 3 and p != 6]
    pixel = np.repeat(firing, 6)
    t = np.linspace(0, 1, len(pixel))
    quiet = quiet_intervals(t, pixel, WIDTH, HEIGHT, least=0.0, dead=0.0, left_out=())
    assert 6 not in quiet.pixel
    assert {4, 9, 14, 19} <= set(quiet.pixel)


@pytest.mark.parametrize("every", [2, 3, 8])
def test_a_pixel_whose_events_were_not_kept_is_no_witness(every):
    """All fire, but for a dark corner of the sensor; of what is kept only the corner saw nothing."""
    width = height = 24
    rng = np.random.default_rng(every)
    row, column = np.divmod(np.arange(width * height), width)
    corner = (row < 12) & (column < 12)
    kept = rng.permutation(width * height) < width * height // every
    pixel = rng.choice(np.flatnonzero(~corner), 40_000)
    pixel = pixel[kept[pixel]]
    t = np.sort(rng.uniform(0, 1, len(pixel)))
    quiet = quiet_intervals(t, pixel, width, height, least=0.5, dead=0.0, left_out=(), kept=kept)
    assert kept[quiet.pixel].all()
    assert corner[quiet.pixel].all()
    middle = kept & (row < 6) & (column < 6)
    assert set(np.flatnonzero(middle)) <= set(quiet.pixel)


def test_pairs_are_even_over_quiet_time_and_end_before_the_lag():
    t, pixel = np.array([0.0, 0.3, 1.0]), np.array([0, 1, 0])
    quiet = quiet_intervals(t, pixel, 2, 1, least=0.0, dead=0.0, left_out=())
    pairs = draw_pairs(quiet, 20_000, 0.1, np.random.default_rng(0))
    np.testing.assert_allclose((pairs.pixel == 0).mean(), 0.5, atol=0.02)  # 1 s of each pixel
    first = pairs.pixel == 1
    assert set(np.unique(np.digitize(pairs.t[first], [0.2, 0.3, 0.9]))) == {0, 2}  # never within 0.1 s of an end
    together = np.digitize(pairs.t[first], [0.3])
    assert (together[:, 0] == together[:, 1]).all()


def test_the_loss_is_the_mean_change_in_thresholds():
    """Less half of `STILL`, below which changes count by their squares."""
    on, off = torch.tensor(0.3), torch.tensor(0.1)
    light = torch.tensor([[0.0, 0.3], [1.0, 0.5]], dtype=torch.float64)
    assert float(quiet_change(light, on, off)) == pytest.approx(2.0 - 0.5 * STILL)
    still = torch.tensor([[0.0, 0.1 * STILL * 0.2]], dtype=torch.float64)
    assert float(quiet_change(still, on, off)) == pytest.approx(0.5 * 0.1**2 * STILL)


def test_where_nothing_fires_haze_is_cleared(tmp_path):
    """Training with λ on clears more of the box than without; pixels held out are not asked."""
    data = read_dataset(make_dataset(tmp_path / "scene", "hard", seed=3, side=16, revolutions=1.0, frames_per_turn=300))
    problem = problem_of(data)
    held = np.unique(problem.held_out.stretches.pixel[problem.held_out.starts])
    assert not np.isin(held, problem.quiet.pixel).any()
    recipe, changed = Recipe(iterations=60, batch=32, vertices=(17,)), []
    for weight in (0.0, 0.3):
        state = start(problem, recipe, Bandwidth("off"))
        for _ in range(60):
            step(problem, replace(recipe, quiet=weight), state)
        changed.append(state)
    levels = []
    for state in changed:
        pairs = draw_quiet(problem, state, 2000, np.random.default_rng(1))
        assert pairs is not None
        levels.append(_change(problem, state, pairs))
    assert levels[1] < levels[0]


def _change(problem, state, pairs) -> float:
    """Mean change in thresholds between the ends of pairs."""
    from pixelid.nerf.training.predict import draw, light

    rng = np.random.default_rng(2)
    with torch.no_grad():
        batch = draw(problem, state, problem.training, 1, rng)
        _, both = light(problem, state, batch, rng, pairs=pairs)
        return float(quiet_change(both, *state.pixel.thresholds))
