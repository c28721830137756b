"""Fit a circuit to pooled event counts: align clocks, match counts, maximise on a part, then on all."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.bench import held, with_bench
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.own_values import with_own_values
from pixelid.fit.pooled_rate import PooledRateObjective
from pixelid.fit.pooled_search import BLURS, SETTLED, best_of, settled
from pixelid.fit.search import SearchResult
from pixelid.fit.starts import align, match_counts, upright
from pixelid.likelihood.pooled_rate import PooledRate
from pixelid.model.model import Model
from pixelid.recordings.bursts import Bursts, bursts_of
from pixelid.recordings.recording import Recording

SCOUT_EVENTS, SCOUT_KINDS = 10_000, 6  # per recording, and kinds of pixel, that the search from afar looks at
LEAST_SCOUT_S = 0.1  # of each recording
AFAR = 20.0  # times as long for the fluid limit, which costs little and on a short stretch has wrong optima
# Held in a blurred pool: it would take the place of what is not yet right.
SCATTER = ("threshold_sigma", "threshold_mismatch.sigma")
MUCH = 2.0  # times as long as a part worth a search of its own
ENOUGH = 1.0  # standard errors of that part: more than those of all
DEAD_TIMES_S = (1e-5, 1e-4, 1e-3)
UNITS = (10.0, 100.0, 1000.0)  # of light, times the model's
OF_BOUND = (0.9, 0.5)  # of what bursts bound it by; pools of fast thresholds fire again so long after it
READOUT = "shared_readout"
FLUID = (
    "number of pooled pixels × thresholds: without threshold_noise counts are those of many small thresholds, and show "
    "only their ratio (pooled.pixels is a gauge)"
)
SHARED = (
    "bursts show a shared readout, for which all pixels wait (`pixelid inspect`), and the model has none "
    "(--with shared_readout): a dead time may be the readout's"
)


@dataclass(frozen=True)
class Search:
    """One search of several: of which likelihood, `of` which coordinates, and the rest as of `best_of`."""

    likelihood: PooledRate
    of: Coordinates
    blurs: tuple[float, ...]
    tolerance: float


def fit_pooled(
    recordings: Sequence[Recording],
    model: Model,
    fixed: Mapping[str, float],
    report: Callable[[str, float], None],
    seed: int = 0,
) -> SearchResult:
    """The optimum of pooled counts.

    The search goes from wide optima to narrow ones: the fluid limit, a pool less and less blurred, the pool on a part
    of the events, the pool on all.  A model without threshold_noise is fitted in the fluid limit.

    fixed: nuisances of the recordings to hold.  Raises InputError for a name in it that is none.
    """
    model, stated_light = model.release(["delay_s"]), recordings
    recordings = [upright(recording) for recording in recordings]
    scout = PooledRate(recordings, first_s=_scouted_s(recordings), kinds=SCOUT_KINDS)
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
    stated = {
        name: model.values[name] for name in ("on_threshold", "off_threshold", "refractory_s") if name in model.free
    }
    report("aligning clocks", 0.05)
    afar = PooledRate(recordings, first_s=AFAR * _scouted_s(recordings)).fluid()
    start |= align(afar, model, start)
    fluid = "threshold_noise" not in model.effects
    bursts = [b for b in map(bursts_of, recordings) if b.pixels is not None]
    model = read_out(model, bursts)
    start |= {name: value for name, value in model.values.items() if name.startswith(READOUT)}
    sizes = {b.pixels for b in bursts}
    size = next(iter(sizes)) if len(sizes) == 1 else None
    pixels = fixed.get("pooled.pixels", None if size is None else float(size))
    spacings_s = [b.spacing_s for b in bursts if b.spacing_s is not None]
    begins = [stated]
    if spacings_s and "refractory_s" in stated:
        dead = model.parameter("refractory_s")
        begins += [{"refractory_s": dead.within(share * min(spacings_s))} for share in OF_BOUND]
    if any(afar.cycles):  # the fluid limit knows no waiting, and its optimum is far
        begins += _as_stated(model, stated, "stimulus.gain" in nuisances)
    start |= {name: value for name, value in _counted(afar, model, start, pixels).items() if name not in fixed}
    if pixels is not None or fluid:
        nuisances["pooled.pixels"] = nuisances["pooled.pixels"].at(start["pooled.pixels"]).fixed()
    model = model.set({name: value for name, value in start.items() if name in model.parameters})
    names = [recording.name for recording in recordings]
    model = with_own_values(
        model, names, lambda trial: scout.per_recording(scout.expected(trial.circuit(), {**start, **trial.values}))
    )
    model = held(model, {name: value for name, value in fixed.items() if name in owned})
    coordinates = Coordinates.of(model, tuple(p.at(start[name]) for name, p in nuisances.items()))
    report("searching", 0.1)
    own = tuple(p.at(start[name]) for name, p in nuisances.items())
    poleless = Coordinates.of(model.fix(dict.fromkeys(_poles(model))), own)
    narrow = Coordinates.of(model.fix({name: None for name in (*SCATTER, *_poles(model)) if name in model.free}), own)
    searches = [Search(afar, narrow, (1.0,), 1.0)]
    if fluid:
        searches = [Search(PooledRate(recordings).fluid(), narrow, (1.0,), 0.1)]
    else:
        searches += [Search(scout, narrow, BLURS, 1.0), Search(scout, poleless, (0.0, 0.0), 1.0)]
        searches += [Search(scout, coordinates, (0.0,), 1.0)] if poleless.names != coordinates.names else []
    x, steps, searched = narrow.start, 0, narrow
    for k, search in enumerate(searches):
        x, searched = (x if search.of is searched else _wider(searched, x, search.of)), search.of
        starts = [x, *(_at(searched, x, begin) for begin in begins)] if search.blurs is BLURS else [x]
        objective, optimum = best_of(
            PooledRateObjective(search.likelihood, searched), starts, search.tolerance, search.blurs,
            lambda part, k=k: report("fitting", 0.1 + 0.5 * (k + part) / len(searches)),
        )  # fmt: skip
        x, steps = optimum.x, steps + optimum.steps
    information = optimum.local.information
    if not fluid:
        for k, part_s in enumerate(_lengths_s(recordings)):
            last = PooledRateObjective(PooledRate(recordings, first_s=part_s), coordinates)
            objective, optimum, information = settled(
                last, optimum.x, seed, lambda part, k=k: report("fitting", 0.6 + 0.15 * (k + part)),
                SETTLED if part_s == math.inf else ENOUGH,
            )  # fmt: skip
            steps += optimum.steps
    dispersion = objective.likelihood.dispersion(objective.expected(optimum.x))
    caveats = [FLUID] if fluid else []
    turned = [r.name for r, was in zip(recordings, stated_light, strict=True) if r is not was]
    if turned:
        caveats.append(f"{', '.join(turned)}: ON events come where the shape of the light falls: taken upside down")
    if any(burst.cycle is not None for burst in bursts) and not model.has(READOUT):
        caveats.append(SHARED)
    if pixels is not None:
        caveats.append(f"pooled.pixels = {pixels:g} is held: as stated, or the events come in bursts of so many")
    if "stimulus.offset" in nuisances:
        caveats.append(
            "light levels: radiance is in units of the light that is on all the time (stimulus.offset = 1 is a gauge), "
            "so alpha and gamma are in that unit too"
        )
    details = {
        "dispersion": dispersion,
        "bin_s": float(np.diff(objective.likelihood.counts[0].edges[:2])[0]),
        "steps": steps,
    }
    values = objective.coordinates.values(optimum.x)
    return SearchResult(
        objective, optimum, 1 if fluid else max(round(values["pooled.pixels"]), 1), details, caveats=caveats,
        dispersion=dispersion, information=information,
    )  # fmt: skip


def _as_stated(model: Model, stated: Mapping[str, float], shaped: bool) -> list[dict[str, float]]:
    """Points at which to start, of the model's own values; under light of unknown unit, for several units."""
    circuit = {
        name: model.values[name] for name in model.free if not name.startswith(("pooled.", "stimulus.", "delay"))
    }
    begins = []
    for unit in UNITS if shaped else (1.0,):
        scaled = {name: unit * circuit[name] for name in ("alpha", "gamma") if name in circuit}
        for dead_s in (stated.get("refractory_s"), DEAD_TIMES_S[0]) if "refractory_s" in circuit else (None,):
            begins.append({**circuit, **scaled, **({} if dead_s is None else {"refractory_s": dead_s})})
    return begins


def read_out(model: Model, bursts: Iterable[Bursts]) -> Model:
    """The model whose readout has the cycle that bursts show, where it has one and they do."""
    cycle = next((b.cycle for b in bursts if b.cycle is not None), None)
    if cycle is None or not model.has(READOUT):
        return model
    shown = {"event_s": cycle.event_s, "cycle_s": cycle.cycle_s, "spread": cycle.spread}
    return model.set({f"{READOUT}.{name}": model.parameter(f"{READOUT}.{name}").within(v) for name, v in shown.items()})


def _poles(model: Model) -> tuple[str, ...]:
    """The amplifier's pole, which changes places with the follower's where nothing shows the reset."""
    return ("diff_cutoff_hz",) if {"sf_cutoff_hz", "diff_cutoff_hz"} <= set(model.free) else ()


def _at(coordinates: Coordinates, x: np.ndarray, stated: Mapping[str, float]) -> np.ndarray:
    """The point x with the stated values, not those that the fluid limit needs, in which no pixel waits."""
    x = x.copy()
    for i, parameter in enumerate(coordinates.parameters):
        if parameter.name in stated:
            x[i] = parameter.to_coordinate(stated[parameter.name])
    return x


def _wider(narrow: Coordinates, x: np.ndarray, coordinates: Coordinates) -> np.ndarray:
    """The point x of `narrow` in coordinates that have more."""
    at = dict(zip(narrow.names, x, strict=True))
    return np.array([at.get(name, begin) for name, begin in zip(coordinates.names, coordinates.start, strict=True)])


def _scouted_s(recordings: Sequence[Recording]) -> float:
    """Seconds of every recording that hold events enough for a search from afar."""
    rates = [len(r.events) / max(float(np.ptp(r.events.t)) * 1e-9, 1e-9) for r in recordings if len(r.events) > 1]
    return max(SCOUT_EVENTS / min(rates), LEAST_SCOUT_S) if rates else LEAST_SCOUT_S


def _lengths_s(recordings: Sequence[Recording]) -> list[float]:
    """Seconds of every recording that the last searches look at: a part where that is less than all, then all."""
    few_s = _scouted_s(recordings)
    longer = any(r.stimulus is not None and r.stimulus.duration_s > MUCH * few_s for r in recordings)
    return [few_s, math.inf] if longer else [math.inf]


def _counted(afar: PooledRate, model: Model, start: dict[str, float], pixels: float | None) -> dict[str, float]:
    """Pixels, thresholds and dead time to start from: of several dead times, the one that suits the counts best.

    A dead time that is off by a factor of ten changes which events follow which, so it has no useful gradient.
    """
    times = [None] if "refractory_s" not in model.free else [model.values["refractory_s"], *DEAD_TIMES_S]
    best: tuple[float, dict[str, float]] = (-np.inf, {})
    for dead_s in times:
        trial = start if dead_s is None else {**start, "refractory_s": model.parameter("refractory_s").within(dead_s)}
        trial = {**trial, **match_counts(afar, model, trial, pixels)}
        value = afar.log_likelihood(afar.expected(model.circuit(trial), trial))
        best = max(best, (value, trial), key=lambda pair: pair[0])
    return best[1]
