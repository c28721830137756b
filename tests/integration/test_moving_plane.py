"""Events of a moving plane: behind the edges that made them in dim light, and at them with the pixel undone."""

import numpy as np
import pytest

moving_plane = pytest.importorskip("moving_plane", reason="needs a checkout")


def test_events_at_the_edges_score_one():
    shown = np.exp(np.array([[0.0, 0.0, -1.0, -1.0, 0.05, 0.05]]))
    at = np.arange(0.0, 5 / moving_plane.SPEED, 1e-5)
    light = np.interp(at * moving_plane.SPEED, np.arange(6), np.log(shown[0]))
    t, x, y, on = moving_plane.events_of(at, light[None], 0.18, 0.0)
    assert on.tolist() == [False] * 5 + [True] * 5
    picture = moving_plane.on_plane(t, x, y, on, shown.shape)
    assert moving_plane.score(picture, shown) > 0.99
    assert moving_plane.score(moving_plane.on_plane(t + 1 / moving_plane.SPEED, x, y, on, shown.shape), shown) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("white", "recorded", "undone"), [(2000.0, (0.95, 1.0), 0.9), (10.0, (-0.2, 0.3), 0.7)])
def test_dim_light_smears_and_the_circuit_mends(monkeypatch, white, recorded, undone):
    shown = moving_plane.plane()[24:40]
    monkeypatch.setattr(moving_plane, "HEIGHT", 16)
    monkeypatch.setattr(moving_plane, "plane", lambda: shown)
    before, after = moving_plane.passes(white, seed=1)["scores"]
    assert recorded[0] < before < recorded[1]
    assert after > undone
