"""Fit a circuit to pooled event counts: align clocks, match counts, maximise on a part, then on all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.bench import held, with_bench
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.newton import Optimum, maximise
from pixelid.fit.own_values import with_own_values
from pixelid.fit.pooled_rate import PooledRateObjective
from pixelid.fit.starts import align, match_counts
from pixelid.likelihood.pooled_rate import PooledRate
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording

SCOUT_S, SCOUT_KINDS = 0.3, 8  # seconds of each recording, and kinds of pixel, that the search from afar looks at
ROUNDS = 4  # of a search with the variances of counts of where the last one ended; they settle in two
SETTLED = 0.3  # standard errors that a round may move


def fit_pooled(
    recordings: Sequence[Recording],
    model: Model,
    fixed: Mapping[str, float],
    report: Callable[[str, float], None],
    seed: int = 0,
) -> tuple[PooledRateObjective, Optimum, dict, int]:
    """(objective, optimum, details, 1) of the model fitted to pooled counts.

    fixed: nuisances of the recordings to hold.  Raises InputError for a name in it that is none.
    """
    model = model.release(["delay_s"])
    scout = PooledRate(recordings, first_s=SCOUT_S, kinds=SCOUT_KINDS)
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
    x, steps = coordinates.start, 0
    for likelihood, share, tolerance in ((scout, 0.4, 1.0), (PooledRate(recordings), 0.4, 0.1)):
        objective, optimum = _maximised(
            PooledRateObjective(likelihood, coordinates), x, tolerance,
            lambda part, share=share: report("searching" if share else "fitting", 0.1 + share * part),
        )  # fmt: skip
        x, steps = optimum.x, steps + optimum.steps
    dispersion = objective.likelihood.dispersion(objective.expected(optimum.x))
    caveats = []
    if "stimulus.offset" in nuisances:
        caveats.append(
            "light levels: radiance is in units of the light that is on all the time (stimulus.offset = 1 is a gauge), "
            "so alpha and gamma are in that unit too"
        )
    details = {
        "dispersion": dispersion,
        "bin_s": float(np.diff(likelihood.counts[0].edges[:2])[0]),
        "steps": steps,
        "caveats": caveats,
        "information": objective.information(optimum.x, optimum.local, seed),
    }
    return objective, optimum, details, 1


def _maximised(
    objective: PooledRateObjective, x: np.ndarray, tolerance: float, report: Callable[[float], None]
) -> tuple[PooledRateObjective, Optimum]:
    """(the objective near its optimum, the optimum): variances of counts follow the search, round by round."""
    for turn in range(ROUNDS):
        objective = objective.near(x)
        noisy = max(objective.likelihood.dispersion(objective.expected(x)), 1.0)
        optimum = maximise(
            objective, x, tolerance=tolerance * noisy, max_steps=40,
            progress=lambda step, value, turn=turn: report((turn + step / 40) / ROUNDS),
        )  # fmt: skip
        move, x = optimum.x - x, optimum.x
        if move @ optimum.local.information @ move < SETTLED**2 * noisy:
            break
    return objective, optimum
