"""The gap in the scene itself: what the pixel lacks, found in what a scene leaves unexplained of held-out events.

A scene is trained coarsely under the pixel as it is stated.  Every candidate is then added, at a strength that the
residuals suggest, and trained on together with the scene for some steps; so is the pixel without it.  A scene bends to
what its pixel lacks (a leak becomes light that brightens on and on), so residuals of one scene under two pixels would
hide most of it; two scenes, each trained under its own pixel, do not.  What explains events of held-out pixels best is
kept, if chance would not do as well, and the search goes on with it.  Views are never asked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch

from pixelid.errors import InputError
from pixelid.nerf.data.calibration import Calibration
from pixelid.nerf.effects.additions import ADDITIONS, threshold_factor
from pixelid.nerf.effects.suggestions import Suggested, suggestions
from pixelid.nerf.options import ALPHA, LEAST_SHARE
from pixelid.nerf.pixel.maps import MISMATCH
from pixelid.nerf.pixel.model import FILTER, Bandwidth, Pixel, filter_parameters
from pixelid.nerf.training import parallel
from pixelid.nerf.training.held_out import Gain
from pixelid.nerf.training.recipe import Recipe
from pixelid.nerf.training.residuals import Rows, compare, residual_map, rows_of
from pixelid.nerf.training.state import Problem, State, optimiser_of, start
from pixelid.nerf.training.train import train
from pixelid.stages.circuit import Circuit

BANDWIDTH, MISMATCHED = "bandwidth", "threshold_mismatch"
BANDWIDTH_FACTORS = ("alpha", "follower")  # of `FILTER`: how fast, not how far from overshooting
HELD_OUT = 0.1  # share of the pixels that judge; the final training holds out less
# Of the scene that candidates are judged on, as its false alarms were counted (tests): colours that depend on the
# direction move with the camera, hence with time, and a drift of thresholds was named in two of three clean cameras.
SCENE: dict[str, Any] = {"degree": 0, "roughness": 0.0, "quiet": 0.0}
WARM, TRIAL = 1 / 3, 1 / 12  # shares of the recipe's steps: of the first scene, and of every candidate
MOST_ROUNDS = 3
# Times that the strengths of what was kept are renewed before the next round, at least and at most, until none moves by
# more than a share: a scene gives back what it has taken of an effect by and by, and neighbours of the effect would be
# named for the rest
SETTLING, MOST_SETTLING, SETTLED = 2, 6, 0.1
# A drift is then looked for along a line, by factors that are tried in order, each while it explains held-out events
# better: in bright light at low speed a scene takes most of it upon itself, and hints from its own rests end at a sixth
FACTORS, MOST_SOUGHT = (2.0, 2.0**0.5, 0.5**0.5), 6
# A dead time cannot be longer than any interval, and one that matters is hardly shorter; so close to it that what went
# on meanwhile can still be told from the time that was left to look.
WITHIN = 0.8
# Candidates that explain nearly as much as the best, as a share of that, settle side by side before one is kept: while
# the scene holds half of a leak, a parasitic photocurrent explains as much.
RIVALS = 0.1
TIE = 0.01  # of the loss: of candidates that explain as much, the first in the list is taken

Make = Callable[..., Problem]  # (calibration, trained=names)


@dataclass(frozen=True)
class Trial:
    """A candidate in one round: name in the effect library, what it was trained from and to, what it explained."""

    name: str
    start: Mapping[str, float]
    values: Mapping[str, float]
    gain: Gain

    def as_dict(self) -> dict[str, Any]:
        """An entry of "gap" in reconstruction.json."""
        return {
            "name": self.name, "start": dict(self.start), "values": dict(self.values),
            "heldout_gain": self.gain.share, "p_value": self.gain.p_value, "rows": self.gain.rows,
        }  # fmt: skip


@dataclass(frozen=True)
class Found:
    """What a search found.

    calibration: with the effects at the strengths found;  trained: names of `Bandwidth.trained` to train on;  kept:
    the trials that were kept, in order;  rounds: all trials of every round;  gain: of all that was kept together, over
    the same scene trained as long without;  psnr: of a validation view of those two scenes, dB;  residuals: of
    `residual_map`
    """

    calibration: Calibration
    trained: tuple[str, ...]
    kept: tuple[Trial, ...]
    rounds: tuple[tuple[Trial, ...], ...]
    gain: Gain | None = None
    psnr: tuple[float, float] | None = None
    residuals: Mapping[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """The entry "gap" of reconstruction.json."""
        return {
            "effects": [trial.as_dict() for trial in self.kept],
            "heldout_gain": self.gain.share if self.gain else 0.0,
            "coarse_psnr": {"before": self.psnr[0], "after": self.psnr[1]} if self.psnr else None,
            "residuals": dict(self.residuals),
            "rounds": [[trial.as_dict() for trial in trials] for trials in self.rounds],
            "alpha": ALPHA,
        }


def search(
    calibration: Calibration, bandwidth: Bandwidth, recipe: Recipe, make: Make, *, mapped: bool = False,
    score: Callable[[State], float] = lambda state: math.nan, device: str = "cpu",
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Found:  # fmt: skip
    """Find effects that the pixel of a dataset lacks.

    Args:
        calibration: of the camera and its pixel.
        bandwidth: how the pixel enters.
        recipe: of the training that follows; its first grid and a share of its steps are used here.
        make: the problem under a calibration, with what training is to move.
        mapped: whether thresholds of single pixels are known from a map.
        score: PSNR of a scene, for the record: nothing is decided by it.
        device: "cpu" or "cuda".
        progress: called with what is done and the fraction.

    Returns:
        The pixel with what was found, and all else as it was stated.
    """
    warm, steps = (max(round(share * recipe.iterations), 1) for share in (WARM, TRIAL))
    problem = make(calibration, trained=bandwidth.moving)
    if not len(problem.held_out.starts):
        raise InputError("--gap: effects are judged on pixels held out, and only one pixel has events to hold out")
    names = _candidates(calibration, bandwidth, mapped, problem.shortest)
    # as if the search kept one effect; it may keep none, or more
    total, done = float(warm + (2 * len(names) + 8) * steps), 0.0

    def report(now: State, measured: dict[str, float]) -> None:
        nonlocal done
        done += 1.0
        progress(f"searching for effects, loss {measured['loss']:.3f}", min(done / total, 1.0))

    unit = 0.5 * float(calibration.circuit.on_threshold + calibration.circuit.off_threshold)
    coarse = replace(recipe, vertices=recipe.vertices[:1], **SCENE)
    bench = _Bench(make, coarse, bandwidth, steps, unit, device, report)
    state = train(problem, bench.recipe, start(problem, bench.recipe, bandwidth, device), until=warm, report=report)
    here = told = _Place(calibration, (), state).after(problem, state)
    kept: list[tuple[str, Trial]] = []
    rounds: list[tuple[Trial, ...]] = []
    while len(rounds) < MOST_ROUNDS and names and here.state.finite:
        trials, places, plain = bench.round(here, names)
        rounds.append(trials)
        named = [k for k, t in enumerate(trials) if t.gain.p_value * len(names) < ALPHA and t.gain.share >= LEAST_SHARE]
        if not named:
            here = plain
            break
        most = max(trials[k].gain.share for k in named)
        rivals = [k for k in named if trials[k].gain.share > min((1.0 - RIVALS) * most, most - TIE)]
        outcome = bench.settled([places[k] for k in rivals])
        if outcome is None:
            here = plain
            break
        best, here = rivals[outcome[0]], outcome[1]
        if names[best] in ADDITIONS and ADDITIONS[names[best]].of_events:
            here = bench.line_search(here, names[best])
        kept.append((names[best], trials[best]))
        names = tuple(name for k, name in enumerate(names) if k != best)
    if not kept:
        return Found(calibration, (), (), tuple(rounds), residuals=_map(*[bench.rows(here)] * 2))
    told = bench.go_on(told, here.state.iteration - told.state.iteration)
    before, after = bench.rows(told), bench.rows(here)
    named = _with_named(calibration, here.calibration, [name for name, _ in kept])
    effects = (replace(trial, values=_values(name, named, here.state.pixel)) for name, trial in kept)
    return Found(
        named, here.trained, tuple(effects), tuple(rounds), _agreed(compare(before, after)),
        (score(told.state), score(here.state)), _map(before, after),
    )  # fmt: skip


def hot_pixels(problem: Problem) -> dict[str, Any] | None:
    """An entry of "effects" in "gap" of reconstruction.json: pixels left out that the circuit does not contain.

    Their events speak for themselves; no scene is trained with them, so nothing is judged on held-out events.
    """
    maps = problem.maps
    if maps is None or len(maps.hot) == 0 or problem.circuit.hot_count > 0:
        return None
    values = {"hot_pixels.count": float(len(maps.hot)), "hot_pixels.rate_hz": maps.hot_hz}
    return {"name": "hot_pixels", "start": {}, "values": values, "heldout_gain": None, "p_value": None, "rows": 0}


def _agreed(gain: Gain) -> Gain:
    """The first process' of gains that all have, to rounding."""
    share, p_value = parallel.agreed(np.array([gain.share, gain.p_value])).tolist()
    return gain._replace(share=share, p_value=p_value)


def _map(before: Rows, after: Rows) -> Mapping[str, Any]:
    """As `residual_map`; nothing where a scene has diverged, or held-out pixels say nothing."""
    return residual_map(before=before, after=after) if before.told and after.told else {}


@dataclass(frozen=True)
class _Place:
    """Where a search is: a pixel, what of it is trained beyond the stated, and a scene trained under it.

    moved: (6,) logs by which training has moved `pixel.FACTORS` from what was stated, where their priors stay
    """

    calibration: Calibration
    trained: tuple[str, ...]
    state: State
    moved: torch.Tensor | float = 0.0

    def after(self, problem: Problem, state: State) -> _Place:
        """The same, once a scene and its pixel have been trained."""
        calibration = with_trained_values(self.calibration, state.pixel, problem)
        return replace(self, calibration=calibration, state=state, moved=state.pixel.moved)


@dataclass(frozen=True)
class _Bench:
    """What all steps of a search share: how problems are made, scenes trained and rests counted."""

    make: Make
    recipe: Recipe
    bandwidth: Bandwidth
    steps: int
    unit: float
    device: str
    report: Callable[[State, dict[str, float]], None]

    def round(
        self, here: _Place, names: tuple[str, ...]
    ) -> tuple[tuple[Trial, ...], tuple[_Place, ...], _Place]:  # fmt: skip
        """(trials, where they ended, where the scene without any of them ended).

        With and without a candidate, strengths of what was kept before begin again: else a neighbour of an effect
        would be named for what the effect itself has not yet got back from the scene.
        """
        suggested, every = self._suggested(here)
        plain = self.go_on(_renewed(here, suggested, every), self.steps)
        reference = self.rows(plain)
        trials, places = [], []
        for name in names:
            begun = _renewed(here, suggested, every, name)
            there = self.go_on(begun, self.steps)
            gain = self._gain(reference, there)
            values = _values(name, there.calibration, there.state.pixel)
            trials.append(
                Trial(
                    ADDITIONS[name].effect if name in ADDITIONS else name, _told(name, begun.calibration), values, gain
                )
            )
            places.append(there)
        return tuple(trials), tuple(places), plain

    def grown(self, here: _Place, at_rest: bool) -> _Place:
        """Scene and pixel after as many steps as a trial takes, from strengths that the residuals suggest."""
        return self.go_on(_renewed(here, *self._suggested(here), at_rest=at_rest), self.steps)

    def settled(self, rivals: Sequence[_Place]) -> tuple[int, _Place] | None:
        """(which of some places explains most, where it is) when strengths have come to rest, all trained as long.

        Those that diverge are left out; None where all do.
        """
        at = dict(enumerate(rivals))
        for turn in range(MOST_SETTLING):
            grown = {k: self.grown(place, turn >= SETTLING) for k, place in at.items()}
            moved = {k: _moved_by(at[k], place) for k, place in grown.items() if place.state.finite}
            at = {k: grown[k] for k in moved}
            if not at:
                return None
            if turn + 1 >= SETTLING and max(moved.values()) < SETTLED:
                break
        first, *others = at
        if not others:
            return first, at[first]
        reference = self.rows(at[first])
        shares = {first: 0.0, **{k: self._gain(reference, at[k]).share for k in others}}
        which = next(k for k, share in shares.items() if share > max(shares.values()) - TIE)
        return which, at[which]

    def line_search(self, here: _Place, name: str) -> _Place:
        """Where a strength explains held-out events best; it is held from here on.

        With and without a factor scenes are trained as long.  Trained with them, a strength would go back before the
        scene has followed: rests that a scene leaves are smallest where all thresholds are alike.
        """
        here = replace(here, trained=tuple(each for each in here.trained if each != name))
        factors = list(FACTORS)
        for _ in range(MOST_SOUGHT):
            there, here = (self.go_on(place, self.steps) for place in (self._times(factors[0], name, here), here))
            gain = self._gain(self.rows(here), there)
            if gain.share > 0 and gain.p_value < ALPHA:
                here = there
            elif len(factors) > 1:
                del factors[0]
            else:
                break
        return here

    def _times(self, factor: float, name: str, here: _Place) -> _Place:
        """The same place with one strength times a factor."""
        more = (factor - 1.0) * getattr(here.calibration.circuit, ADDITIONS[name].field)
        every = self.make(here.calibration, trained=tuple(ADDITIONS))
        return replace(here, calibration=_begun(name, here.calibration, more, every))

    def _gain(self, reference: Rows, there: _Place) -> Gain:
        """The first process' gain of a place, which all have to rounding: what one decides, all do.

        A place that has diverged explains nothing.
        """
        gain = compare(reference, self.rows(there))
        return _agreed(gain) if there.state.finite else Gain(0.0, 1.0, gain.rows)

    def _suggested(self, here: _Place) -> tuple[Suggested, Problem]:
        every = self.make(here.calibration, trained=(*self._using(here.trained).moving, *ADDITIONS))
        return suggestions(every, here.state), every

    def go_on(self, here: _Place, steps: int) -> _Place:
        """The same, trained on for some steps, in a copy; the pixel is what training has moved it to."""
        problem, state = self._moved(here)
        state = train(problem, self.recipe, state, until=state.iteration + steps, report=self.report)
        return here.after(problem, state)

    def rows(self, here: _Place) -> Rows:
        """What is left unexplained of held-out events."""
        problem, state = self._moved(here)
        return rows_of(problem, state, problem.held_out, self.unit)

    def _using(self, trained: tuple[str, ...]) -> Bandwidth:
        return replace(self.bandwidth, trained=(*self.bandwidth.trained, *trained))

    def _moved(self, here: _Place) -> tuple[Problem, State]:
        """The problem under a place's pixel, and a copy of its scene; what single thresholds were trained to stays."""
        using = self._using(here.trained)
        problem = self.make(here.calibration, trained=using.moving)
        copy = start(problem, self.recipe, using, self.device)
        with torch.no_grad():
            copy.field.hold(here.state.field.bricks, here.state.field.grid, here.state.field.coefficients)
            copy.field.log_background.copy_(here.state.field.log_background)
            copy.poses.load_state_dict(here.state.poses.state_dict())
            copy.pixel.told.copy_(-torch.as_tensor(here.moved, dtype=torch.float64))
            if copy.pixel.departures.requires_grad and here.state.pixel.departures.requires_grad:
                copy.pixel.departures.copy_(here.state.pixel.departures)
        copy.field.occupied = here.state.field.occupied.copy()
        copy.optimiser = optimiser_of(copy.field, copy.pixel, copy.poses, self.recipe)
        copy.iteration, copy.rays = here.state.iteration, here.state.rays
        return problem, copy


def with_trained_values(calibration: Calibration, pixel: Pixel, problem: Problem) -> Calibration:
    """The calibration with what training has moved in place of what it began with.

    problem: that it was trained in
    """
    changed = {a.field: float(pixel.strength(name).detach()) for name, a in ADDITIONS.items() if pixel.adds_to(name)}
    numbers: dict[str, float] = dict(zip(FILTER, pixel.dynamics.detach().tolist(), strict=False))
    moving = [name for name, moves in zip(FILTER, pixel.moves.tolist(), strict=False) if moves]
    changed |= {name: float(numbers[name]) for name in moving}
    factor = threshold_factor(problem.tilts, pixel.addition)
    on, off = (factor * float(x.detach()) for x in pixel.thresholds)
    changed |= {"on_threshold": on, "off_threshold": off}
    if "alpha" in changed and calibration.circuit.photoreceptor == "one_pole":
        moved = float(changed.pop("alpha")) / float(pixel.nominal[0])
        changed["corner"] = calibration.circuit.corner * moved
    return replace(calibration, circuit=_same_leak(calibration.circuit.with_(**changed), factor))


def _with_named(told: Calibration, found: Calibration, names: Sequence[str]) -> Calibration:
    """The pixel as stated, with what was named as found.

    What else the search has trained (`--bandwidth joint`, `--train`) stays as stated: its priors lie there, and the
    training that follows counts the events again.  So do thresholds with a drift, which are those it begins from; the
    search has held their mean over the events.  A leak stays in thresholds per second, which events show.
    """
    moved: dict[str, float] = {}
    for name in names:
        fields = (
            _cutoffs(told.circuit) if name == BANDWIDTH
            else ("mismatch",) if name == MISMATCHED
            else (ADDITIONS[name].field,)
        )  # fmt: skip
        moved |= {field: getattr(found.circuit, field) for field in fields}
    return replace(told, circuit=told.circuit.with_(**moved))


def _same_leak(circuit: Circuit, factor: float) -> Circuit:
    """The circuit, whose ON threshold has grown by a factor, with the leak as it was: its strength is in thresholds."""
    return circuit.with_(
        leak_hz=circuit.leak_hz / factor, leak_hz_per_radiance=circuit.leak_hz_per_radiance / factor
    )  # fmt: skip


def _candidates(calibration: Calibration, bandwidth: Bandwidth, mapped: bool, shortest: float) -> tuple[str, ...]:
    """Names of what is tried: `ADDITIONS`, mismatch, and a filter slower or faster than stated.

    A dead time is tried only where the shortest interval leaves room for a longer one than is stated.
    """
    circuit = calibration.circuit
    names = [name for name, addition in ADDITIONS.items() if addition.searched and name not in bandwidth.moving]
    if WITHIN * shortest <= circuit.refractory:
        names = [name for name in names if name != "refractory"]
    if not mapped and circuit.mismatch < MISMATCH:
        names.append(MISMATCHED)
    if bandwidth.mode == "on" and bandwidth.samples > 1 and _trained_by(BANDWIDTH, calibration):
        names.append(BANDWIDTH)
    return tuple(names)


def _trained_by(name: str, calibration: Calibration) -> tuple[str, ...]:
    """What of the pixel a candidate trains."""
    if name == BANDWIDTH:
        return tuple(part for part in BANDWIDTH_FACTORS if part in filter_parameters(calibration.circuit))
    return (name,) if name in ADDITIONS and not ADDITIONS[name].held else ()


def _cutoffs(circuit: Circuit) -> tuple[str, ...]:
    """Fields of a circuit that a filter slower or faster than stated moves; of one pole α is its corner."""
    one = circuit.photoreceptor == "one_pole"
    has = filter_parameters(circuit)
    return tuple("corner" if one and part == "alpha" else part for part in BANDWIDTH_FACTORS if part in has)


def _renewed(here: _Place, suggested: Suggested, problem: Problem, name: str = "", at_rest: bool = True) -> _Place:
    """Where strengths of what was kept begin again, with a candidate or alone; once it has settled (`at_rest`) only
    those that are renewed until they rest."""
    new = _trained_by(name, here.calibration)
    kept = (k for k in here.trained if k in ADDITIONS and (not at_rest or ADDITIONS[k].renewed))
    least = {k: ADDITIONS[k].least - getattr(here.calibration.circuit, ADDITIONS[k].field)
             for k in (*kept, *new) if k in ADDITIONS}  # fmt: skip
    moved, calibration = suggested.of(least), here.calibration
    moved = dict(zip(moved, parallel.agreed(np.array(list(moved.values()), float)).tolist(), strict=True))
    for each in (*here.trained, name):
        calibration = _begun(each, calibration, moved.get(each, 0.0), problem)
    return replace(here, calibration=calibration, trained=(*here.trained, *new))


def _moved_by(before: _Place, after: _Place) -> float:
    """The largest relative move of a strength that is trained."""
    moved = [0.0]
    for name in after.trained:
        if name in ADDITIONS:
            was, now = (getattr(place.calibration.circuit, ADDITIONS[name].field) for place in (before, after))
            moved.append(abs(now - was) / max(abs(now), 1e-12))
    return max(moved)


def _begun(name: str, calibration: Calibration, moved: float, problem: Problem) -> Calibration:
    """The calibration that a candidate begins with; moved: what is suggested to add to its strength."""
    circuit = calibration.circuit
    if name == MISMATCHED:
        return replace(calibration, circuit=circuit.with_(mismatch=MISMATCH))
    if name not in ADDITIONS:
        return calibration
    addition = ADDITIONS[name]
    if name == "refractory":
        value = WITHIN * problem.shortest
    else:
        value = max(getattr(circuit, addition.field) + moved, addition.least)
    added = value - getattr(circuit, addition.field)
    factor = problem.tilts[name].threshold_factor(added) if name in problem.tilts else 1.0
    on, off = factor * circuit.on_threshold, factor * circuit.off_threshold
    begun = circuit.with_(**{addition.field: value, "on_threshold": on, "off_threshold": off})
    return replace(calibration, circuit=_same_leak(begun, factor))


def _told(name: str, calibration: Calibration) -> dict[str, float]:
    """Parameters of a candidate where it begins, by their names in the library.

    Of another bandwidth by fields of `Circuit`: alpha [1/s²/radiance], or of one pole corner [rad/s/radiance], and
    follower [rad/s], the cutoff that the library quotes in Hz.
    """
    circuit = calibration.circuit
    if name == MISMATCHED:
        return {"threshold_mismatch.sigma": circuit.mismatch}
    if name == BANDWIDTH:
        return {part: getattr(circuit, part) for part in _cutoffs(circuit)}
    return {ADDITIONS[name].parameter: getattr(circuit, ADDITIONS[name].field)}


def _values(name: str, calibration: Calibration, pixel: Pixel) -> dict[str, float]:
    """The same after training; of the mismatch, the spread that thresholds of single pixels have come to."""
    if name == MISMATCHED:
        return {"threshold_mismatch.sigma": float(np.hypot(*pixel.threshold_spread()) / np.sqrt(2.0))}
    return _told(name, calibration)
