"""Stamps blurred outside the package, from a fraction of the dead time to several: named, with the right strength."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.gap.gap import gap
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, constant, slow, steps

BASE, DEAD_S = find_model("dvs128"), 2e-4
CAMERA = BASE.set({
    "threshold_sigma": 0.02, "refractory_s": DEAD_S, "alpha": 1.2 * BASE.values["alpha"],
    "beta": 1.1 * BASE.values["beta"], "on_threshold": 0.19, "off_threshold": 0.22,
})  # fmt: skip


def session(model, seed, jitter_s=0.0, tick_s=0.0):
    """Nine pixels, six recordings, stamps jittered and rounded by NumPy and sorted as a camera would."""
    lights = {"constant": constant(24.0), "slow": slow(24.0, seed=seed + 1)}
    for level in (24.0, 400.0):
        lights |= {f"chirp_{level:g}": chirp(level, stop_hz=level), f"steps_{level:g}": steps(level, seed=seed)}
    rng, recordings = np.random.default_rng(seed), []
    for i, (name, light) in enumerate(lights.items()):
        r = simulate(model, resampled(light, "smooth"), width=3, height=3, seed=100 * seed + i, sensor_seed=seed)
        t = 1e-9 * r.events.t + rng.normal(0.0, 1.0, len(r.events)) * jitter_s
        if tick_s:
            t = np.rint(t / tick_s) * tick_s
        inside = np.flatnonzero((t >= 0) & (t <= light.end_s))
        order = inside[np.argsort(t[inside], kind="stable")]
        events = replace(r.events.select(order), t=np.rint(1e9 * t[order]).astype(np.int64), tick_ns=1)
        recordings.append(replace(r, events=events, stimulus=light, condition=name, attributes={}))
    return recordings


def found(recordings):
    report = gap(recordings, BASE, recommend=False)
    values = {name: value for e in report.effects for name, (value, _) in e.parameters.items()}
    return report.verdict, {e.name for e in report.effects}, values


@pytest.mark.slow
@pytest.mark.parametrize("dead_times", [0.1, 0.5, 1.5, 2.0, 3.0])
def test_a_jitter_is_named_within_5_percent(dead_times):
    verdict, names, values = found(session(CAMERA, 1, jitter_s=dead_times * DEAD_S))
    assert (verdict, names) == ("named", {"timestamp_jitter"})
    assert values["timestamp_jitter.sigma_s"] == pytest.approx(dead_times * DEAD_S, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("dead_times", [0.01, 0.3, 1.0, 2.0, 5.0])
def test_a_tick_is_named(dead_times):
    verdict, names, values = found(session(CAMERA, 2, tick_s=dead_times * DEAD_S))
    assert (verdict, names) == ("named", {"timestamp_quantisation"})
    assert values["timestamp_quantisation.tick_s"] == pytest.approx(dead_times * DEAD_S, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("blur", [{"jitter_s": 1.5 * DEAD_S}, {"tick_s": 2.0 * DEAD_S}])
def test_a_leak_behind_blurred_stamps_is_named_as_well(blur):
    leaking = CAMERA.with_effect("leak", {"rate_hz": 2.0})
    verdict, names, values = found(session(leaking, 3, **blur))
    blurs = "timestamp_jitter" if "jitter_s" in blur else "timestamp_quantisation"
    assert (verdict, names) == ("named", {blurs, "leak"})
    assert values["leak.rate_hz"] == pytest.approx(2.0, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "strength", "seed", "dead_times", "within"),
    [
        # a slew limit takes the jitter's place before the dark current is known, and times drawn with it would keep it
        ("dark_current", 4.0, 31, 1.5, 0.05),
        # stamps in the wrong order first make the floor too bright; behind the jitter it is right
        ("bandwidth_floor", 20.0, 8, 2.0, 0.2),
    ],
)
def test_light_in_the_pixel_behind_a_jitter_of_dead_times_is_named_as_well(effect, strength, seed, dead_times, within):
    camera = CAMERA.with_effect(effect, {"radiance": strength})
    verdict, names, values = found(session(camera, seed, jitter_s=dead_times * DEAD_S))
    assert (verdict, names) == ("named", {"timestamp_jitter", effect})
    assert values["timestamp_jitter.sigma_s"] == pytest.approx(dead_times * DEAD_S, rel=0.05)
    assert values[f"{effect}.radiance"] == pytest.approx(strength, rel=within)
