"""Fit a circuit to pooled event counts: align clocks, match counts, maximise on a part, then on all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.bench import held, with_bench
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.newton import maximise
from pixelid.fit.own_values import with_own_values
from pixelid.fit.pooled_rate import PooledRateObjective
from pixelid.fit.search import SearchResult
from pixelid.fit.starts import align, match_counts
from pixelid.likelihood.pooled_rate import PooledRate
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording

SCOUT_S = 1.0  # seconds of each recording that the search from afar looks at


def fit_pooled(
    recordings: Sequence[Recording], model: Model, fixed: Mapping[str, float], report: Callable[[str, float], None]
) -> SearchResult:
    """The optimum of pooled counts.

    fixed: nuisances of the recordings to hold.  Raises InputError for a name in it that is none.
    """
    for effect in ("threshold_noise", "threshold_mismatch", "refractory_period"):
        model = model.without_effect(effect)
    model = model.release(["delay_s"])
    exchange = {"sf_cutoff_hz", "diff_cutoff_hz"} <= set(model.free)
    if exchange:
        model = model.fix({"diff_cutoff_hz": None})
    scout = PooledRate(recordings, first_s=SCOUT_S)
    nuisances = {p.name: p for p in scout.nuisances()}
    model = with_bench(model, recordings, delays=False)
    owned = {f"{parameter}[{recording.name}]" for parameter in model.starts_anew for recording in recordings}
    owned |= {*model.nuisances}
    for name, value in fixed.items():
        if name in owned:
            continue
        if name not in nuisances:
            raise InputError(f"--fix {name}: neither the model nor these recordings have it")
        nuisances[name] = nuisances[name].at(value).fixed()
    start = {**model.values, **{name: p.value for name, p in nuisances.items()}}
    report("aligning clocks", 0.05)
    start |= align(scout, model, start)
    start |= {name: value for name, value in match_counts(scout, model, start).items() if name not in fixed}
    model = model.set({name: value for name, value in start.items() if name in model.parameters})
    names = [recording.name for recording in recordings]
    model = with_own_values(
        model, names, lambda trial: scout.per_recording(scout.expected(trial.circuit(), {**start, **trial.values}))
    )
    model = held(model, {name: value for name, value in fixed.items() if name in owned})
    coordinates = Coordinates.of(model, tuple(p.at(start[name]) for name, p in nuisances.items()))
    report("searching", 0.1)
    scouted = maximise(
        PooledRateObjective(scout, coordinates),
        coordinates.start,
        tolerance=1.0,
        max_steps=60,
        progress=lambda step, value: report("searching", 0.1 + 0.4 * step / 60),
    )
    noisy = scout.dispersion(PooledRateObjective(scout, coordinates).expected(scouted.x))
    likelihood = PooledRate(recordings)
    objective = PooledRateObjective(likelihood, coordinates)
    optimum = maximise(
        objective,
        scouted.x,
        tolerance=0.1 * max(noisy, 1.0),  # a tenth of a nat, for counts this noisy
        max_steps=80,
        progress=lambda step, value: report("fitting", 0.5 + 0.4 * step / 80),
    )
    dispersion = likelihood.dispersion(objective.expected(optimum.x))
    caveats = [
        "number of pooled pixels × thresholds: only their ratio is visible (pooled.pixels is a gauge, chosen so that "
        f"on_threshold started at {model.values['on_threshold']:g})",
        "threshold noise, mismatch and dead time: pooled counts do not show them (left out of the model)",
    ]
    if exchange:
        caveats.append(
            "source follower and differencing pole: pooled counts do not show the reset that separates them, so they "
            "can change places; diff_cutoff_hz is held where it was"
        )
    if "stimulus.offset" in nuisances:
        caveats.append(
            "light levels: radiance is in units of the light that is on all the time (stimulus.offset = 1 is a gauge), "
            "so alpha and gamma are in that unit too"
        )
    details = {
        "dispersion": dispersion,
        "bin_s": float(np.diff(likelihood.counts[0].edges[:2])[0]),
        "steps": optimum.steps,
    }
    return SearchResult(objective, optimum, 1, details, caveats=caveats, dispersion=dispersion)
