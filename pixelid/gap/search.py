"""The search itself: undo what the readout did, then detect, attribute, add, and again, until nothing is left to name.

`Search` holds where the search stands: the workbench, the fitted model, what is left under it, the effects named so
far.  `gap.py` starts it and reads the report off it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pixelid.gap.attribute import DISTINCT, Attribution, Candidate, attribute, secure
from pixelid.gap.candidates import canonical
from pixelid.gap.climb import Climbed, climbed, settled
from pixelid.gap.covariates import Factor
from pixelid.gap.hot import Hot, hot_pixels
from pixelid.gap.intervals import limits
from pixelid.gap.nameless import nameless, standing
from pixelid.gap.noise import CLEAR, EFFECT, ShotNoise, scattering, shot_noise
from pixelid.gap.readout import Fingerprint, fingerprints
from pixelid.gap.replicas import Corrected, cleared, simulated_again
from pixelid.gap.restored import FINEST_S, JITTER, SIGMA, Restored, restored, unjittered
from pixelid.gap.split import Split, locked
from pixelid.gap.words import where
from pixelid.gap.workbench import (
    STRAYS_EXPECTED,
    Look,
    Workbench,
    based,
    look,
    reconsidered,
    relative_noise,
    workbench,
)
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import only

Progress = Callable[[str, float], None]
MOST_ROUNDS = 4
LOOKS, APART = 3, 8  # draws of times that are looked at, and rounds between them
DOUBTFUL = 0.05  # p of what shot noise alone leaves, below which something beside it may be needed
STRAYS_JITTERED = 5e-3  # fraction of events whose times behind a jitter may not be found


@dataclass(frozen=True)
class Step:
    """One effect named: the candidate, what was tried beside it, where the model was wrong before (in words), and
    whether it is wanted even when a nameless term may take its place."""

    winner: Candidate
    found: Attribution
    where: str
    firm: bool


@dataclass(frozen=True)
class State:
    """Where the search stands: the recordings, with what the readout did undone, the workbench made of them, the model
    fitted on it, what is left under that model, and the base with every effect named.

    corrected: what simulation has corrected of model and maps (None where the likelihood is exact)
    jitter: (standard deviation, s, its relative standard error) of the timestamps, where it is among what was undone
    scatter: by parameter, what its coordinate differs by between draws of the times
    """

    timely: tuple[Recording, ...]
    bench: Workbench
    current: Climbed
    seen: Look
    start: Model
    corrected: Corrected | None = None
    jitter: tuple[float, float] | None = None
    scatter: dict[str, float] = field(default_factory=dict)

    @property
    def model(self) -> Model:
        """The fitted model, corrected where it has to be."""
        model = self.corrected.model if self.corrected else self.current.model
        return model if self.jitter is None else model.with_effect(JITTER, {SIGMA: self.jitter[0]}).fix({SIGMA: None})

    def limits(self) -> dict[str, tuple[float, float]]:
        """95 % intervals of the free parameters, and of the jitter."""
        plain = limits(self.bench.train, self.current, self.scatter)
        if self.jitter is not None:
            sigma, error = self.jitter
            plain[SIGMA] = (sigma * (1.0 - 1.96 * error), sigma * (1.0 + 1.96 * error))
        if self.corrected is None:
            return plain
        moved = {}
        coordinates = self.current.coordinates
        for p, shift in zip(coordinates.parameters, self.corrected.shift, strict=True):
            edges = (p.to_coordinate(edge) for edge in plain[p.name])
            low, high = (float(p.from_coordinate(float(shift + edge))) for edge in edges)
            moved[p.name] = (max(low, p.lower), min(high, p.upper))
        return moved


@dataclass
class Search:
    """A search under way.

    recordings: as they came;  model: the base, as shipped, with the effects read off timestamps;  base: fitted;
    first: what was left under it;  latent: the true times behind the readout, where they had to be drawn
    marks, prints: what timestamps show, and what of it the library has;  hot: pixels found by others' silence
    global_p: of anything being amiss at all;  lost: recordings whose true times could not be restored
    steps: what the rounds found;  noise, noise_p: shot noise, and the chance of what it explains
    """

    recordings: Sequence[Recording]
    model: Model
    alpha: float
    seed: int
    leave_out: tuple[str, ...]
    report: Progress
    like: Sequence[Factor] = ()  # cells that its maps shall have
    split: Split = field(init=False)
    base: Climbed = field(init=False)
    first: Look = field(init=False)
    state: State = field(init=False)
    marks: list[Fingerprint] = field(default_factory=list)
    prints: list[Fingerprint] = field(default_factory=list)
    hot: Hot | None = None
    latent: Restored | None = None
    lost: tuple[str, ...] = ()
    steps: list[Step] = field(default_factory=list)
    noise: ShotNoise | None = None
    noise_p: float = 1.0
    rounds: list[dict] = field(default_factory=list)
    global_p: float = 1.0
    before: list[State] = field(default_factory=list)  # the state before each step
    _noises: list[tuple[State, ShotNoise | None]] = field(default_factory=list)  # looked for already, and where

    def begin(self) -> None:
        """Lock the split, fit the base model, look at what is left."""
        self.split = locked(self.recordings, self.seed)
        self.report("base model", 0.02)
        timely = tuple(r.within_stimulus() for r in self.recordings)
        bench, self.base = based(timely, self.split, self.model, self.seed)
        self.first = look(bench, self.base)
        self.state = State(timely, bench, self.base, self.first, bench.nominal)

    def read_timestamps(self) -> None:
        """Find what timestamps and single pixels give away; undo it; fit the base model again."""
        self.report("timestamps", 0.06)
        self.marks = fingerprints(self.recordings)
        self.prints = [f for f in self.marks if f.effect not in self.leave_out]
        if "hot_pixels" not in self.leave_out and not self.model.has("hot_pixels"):
            self.hot = hot_pixels(self.state.timely)
        timely = self.state.timely
        if self.hot is not None:
            self.rounds.append(_stamped(self.hot.print, False))
            self.split = self.split.without(self.hot.pixels)
            timely = tuple(only(timely, self.split.everyone))
        for found in self.prints:
            self.rounds.append(_stamped(found, self.model.has(found.effect)))
            self.latent = restored(timely, found, self.model, self.seed, lambda what: self.report(what, 0.08))
            timely, self.lost = tuple(self.latent.recordings), self.lost + self.latent.lost
            model = self.model.with_effect(found.effect, {found.parameter: found.value})
            self.model = model.fix({found.parameter: None})
        if self.prints or self.hot:
            bench, current = based(timely, self.split, self.model, self.seed)
            self.state = State(timely, bench, current, self._looked(bench, current), bench.nominal)

    def go_on(self) -> None:
        """Round after round, until nothing more can be named."""
        for turn in range(MOST_ROUNDS):
            early = turn == 1 and scattering(self.before[0].seen)
            if early and self._try_noise([(self.before[0], 0), (None, 0), (self.state, 1)]):
                break
            if not self._round(turn):
                break
        if self.noise is None:
            self._try_noise([*((state, 0) for state in self.before[:1]), (self.state, len(self.steps))])
        if self.remainder() and self.latent is not None and self.latent.windows:
            self._clear_of_drawing()
        if self.remainder():
            self._withdraw()

    def _clear_of_drawing(self) -> None:
        """Take from what is left what a simulated session shows as well, its times drawn in the same way.

        Drawn times come near true ones where intervals tell them; where events crowd, how they were drawn shows.
        """
        state, seen = self.state, self.state.seen
        made = simulated_again(
            self.recordings, state.model, len(self.split.everyone), state.bench.between, self.seed + 5003
        )
        other = Search(made, self.model, self.alpha, self.seed, self.leave_out, self.report, like=seen.factors)
        shown = other._drawn_like(state, self.prints).maps
        cells, p = cleared(seen, [shown.scores])
        left = {"p_of_what_is_left": p, "strays": shown.strays}
        self.rounds.append(_line(len(self.rounds) + 1, seen.p, drawn_alike=left))
        self.state = replace(state, seen=replace(seen, maps=replace(seen.maps, cells=cells, p=p), p=p))

    def _drawn_like(self, state: State, prints: Sequence[Fingerprint]) -> Look:
        """What is left under the model of another search's state, fitted to times drawn as there."""
        self.split, self.prints = locked(self.recordings, self.seed), list(prints)
        timely = tuple(r.within_stimulus() for r in self.recordings)
        model = state.model

        def report(what: str) -> None:
            self.report(f"{what}, simulated", 0.65)

        for found in prints:
            model = model.without_effect(found.effect)
            self.latent = restored(timely, found, model, self.seed, report)
            timely = tuple(self.latent.recordings)
            model = model.with_effect(found.effect, {found.parameter: found.value}).fix({found.parameter: None})
        if state.jitter is not None:
            nominal, between = state.start, state.bench.between
            self.latent, model = unjittered(timely, model, nominal, between, self.seed, report)
        else:
            assert self.latent is not None
            model = self.latent.again(model)
        return self._redrawn(model, state.start, state).seen

    def _withdraw(self) -> None:
        """Take back effects that only stand in for what is left, which is no accident.

        Those that a nameless term leaves little to explain, those that explain less than is left, and a jitter, for
        which any scatter passes.
        """
        term = nameless(self.state.bench, self.state.current, self.state.seen)
        left = 0.0 if term is None else float(term.held_out.sum())
        weak = (
            i
            for i, step in enumerate(self.steps)
            if not step.firm or step.winner.heldout_gain < left or step.winner.effect == JITTER
        )
        kept = next(weak, None)
        if kept is None:
            return
        for step in self.steps[kept:]:
            self._entry_of(step.winner.effect)["withdrawn"] = "it may only stand in for what is left"
        self.state, self.steps = self.before[kept], self.steps[:kept]

    def _try_noise(self, tries: Sequence[tuple[State | None, int]]) -> bool:
        """Ask simulation whether shot noise explains what the library's likelihoods leave; whether it is named.

        tries: states, each with the number of steps kept: in place of whatever the rounds have named, which may only
        stand in for it, or beside that; None: the base that the steps lead to
        """
        if EFFECT in self.leave_out or not self.remainder():
            return False
        tries = list(tries)  # which may grow by one
        alone: ShotNoise | None = None  # what leaves least of those with nothing beside them
        enough: tuple[ShotNoise, State, int, dict] | None = None
        for given, kept in tries:
            state = given or self._bare(self.state)
            if state.corrected is not None or state.jitter is not None or state.current.model.has(EFFECT):
                continue  # drawn times scatter as the drawing made them: replicas know nothing of that
            found = self._noise_at(state)
            if found is None:
                continue
            entry, p = self.rounds[-1], found.corrected.look.p
            if kept == 0:
                alone = found if alone is None or found.left < alone.left else alone
                if p >= DOUBTFUL:
                    return self._name_noise(found, state, kept, entry)
                if p >= self.each and enough is None:
                    enough = found, state, kept, entry
            elif p >= self.each:
                # effects named before, in a likelihood that misread the noise, must weigh more than the noise does;
                # what was named first may also show by what noise alone leaves
                needed = kept == 1 and alone is not None and found.left < alone.left - CLEAR
                if needed or all(step.winner.heldout_gain > found.gain for step in self.steps[:kept]):
                    return self._name_noise(found, state, kept, entry)
                if (None, 0) not in tries:
                    tries.append((None, 0))
        return enough is not None and self._name_noise(*enough)

    def _name_noise(self, found: ShotNoise, state: State, kept: int, entry: dict) -> bool:
        entry["named"] = EFFECT
        for step in self.steps[kept:]:
            self._entry_of(step.winner.effect)["withdrawn"] = f"{EFFECT} explains it"
        self.steps = self.steps[:kept]
        self.noise, self.noise_p = found, state.seen.p
        self.state = replace(state, seen=found.corrected.look, corrected=found.corrected)
        return True

    def _bare(self, state: State) -> State:
        """The state without the effects named, its base fitted again from where they have led it."""
        model, start = state.current.model, state.start
        for step in self.steps:
            model, start = model.without_effect(step.winner.effect), start.without_effect(step.winner.effect)
        current = climbed(state.bench.train, model, tolerance=0.01, max_steps=40)
        return replace(state, current=current, seen=self._looked(state.bench, current), start=start, corrected=None)

    def _noise_at(self, state: State) -> ShotNoise | None:
        """Shot noise beside the model of a state, looked for once; the rounds say what it leaves."""
        if not any(there is state for there, _ in self._noises):
            self.report("shot noise", 0.7)
            self._noises.append((state, shot_noise(state.bench, state.current, state.seen, self.seed)))
        done = next(found for there, found in self._noises if there is state)
        if done is not None:
            left = {"name": EFFECT, "density": done.density, "p_of_what_is_left": done.corrected.look.p}
            self.rounds.append(_line(len(self.rounds) + 1, state.seen.p, by_simulation=left))
        return done

    def remainder(self) -> bool:
        """Whether something significant is left."""
        return self.state.seen.p < self.each

    @property
    def doubts(self) -> list[tuple[Step, Candidate]]:
        """Steps, each with an effect that explains as well what it does and that no later round has named beside it."""
        named = {step.winner.effect for step in self.steps}
        return [(step, rival) for step in self.steps for rival in step.found.rivals if rival.effect not in named]

    @property
    def each(self) -> float:
        """What either test, of the maps and of the best candidate, may err by, so that both err by alpha."""
        return 0.5 * self.alpha

    def _round(self, turn: int) -> bool:
        """One round; whether there may be another."""
        state, share = self.state, 0.1 + 0.6 * turn / MOST_ROUNDS
        bent = state.seen.stray_fraction > STRAYS_EXPECTED or not state.current.converged
        found = attribute(
            state.bench.pools, state.current.model, self.each, skip=(*self.leave_out, *self._untellable()),
            restart=state.start if bent else None,
            report=lambda what: self.report(f"round {turn + 1}: {what}", share),
        )  # fmt: skip
        entry = _entry(turn, state.current, state.seen, found)
        self.rounds.append(entry)
        winner = found.winner
        if turn == 0:
            held = (c.p for c in found.candidates if secure(c.held_out))
            chances = [self.first.p, *held, *(f.p for f in self.new_prints())]
            self.global_p = min(1.0, 2.0 * min(chances))
        if winner is None:
            return False
        stands = standing(state.bench, state.current, state.seen, winner, self.each)
        if stands.hopeless:
            entry["refused"] = f"{winner.effect}: a nameless term explains more, and leaves it little to explain"
            return False
        steadied = self._steadied(winner) if winner.effect == JITTER else None
        if winner.effect == JITTER and steadied is None:
            entry["refused"] = f"{winner.effect}: what it would take of the times does not look like one"
            return False
        self.before.append(state)
        entry["named"] = winner.effect
        noise = relative_noise(state.current.model)
        place = where(state.seen.maps, state.bench.train, state.seen.residual.stray, noise)
        self.steps.append(Step(winner, found, place, stands.firm))
        self.state = steadied or self._grown(winner)
        return True

    def _untellable(self) -> tuple[str, ...]:
        """Effects that the times at hand cannot show: what the readout has put on a grid or in a queue does not jitter,
        and times drawn behind it, or behind a jitter, scatter as the drawing made them."""
        coarse = any(f.effect == "readout_latency" or f.value >= FINEST_S for f in self.marks)
        return (JITTER,) if coarse or self.state.jitter is not None else ()

    def _grown(self, winner: Candidate) -> State:
        """The state with the winner added, and without what the winner leaves nothing to explain."""
        state, bench = self.state, self.state.bench
        start = state.start.with_effect(winner.effect)
        bench.train.weigh_clock(state.current.model.circuit())
        grown = canonical(winner.end.model, self.model)
        current = settled(bench.train, grown, start, tolerance=0.01, max_steps=40)
        for k in reversed(range(len(self.steps) - 1)):
            earlier = self.steps[k].winner.effect
            if not current.model.has(earlier):
                continue
            less = climbed(bench.train, current.model.without_effect(earlier), tolerance=0.05, max_steps=25)
            if current.value - less.value < DISTINCT:
                current, start = less, start.without_effect(earlier)
                self._entry_of(earlier)["withdrawn"] = f"{winner.effect} explains it"
                del self.steps[k], self.before[k + 1]
        if self.latent is not None and self.latent.windows:
            return self._redrawn(self.latent.again(current.model), start, state)
        bench, current = reconsidered(bench, state.timely, self.model, current)
        return replace(
            state, bench=bench, current=current, seen=self._looked(bench, current), start=start, corrected=None
        )

    def _steadied(self, winner: Candidate) -> State | None:
        """The state at the times behind a jitter; None where what is drawn does not look like one."""
        state = self.state
        self.latent, model = unjittered(
            state.timely, winner.end.model, state.start, state.bench.between, self.seed,
            lambda what: self.report(what, 0.5),
        )  # fmt: skip
        if self.latent.uneven():
            self.latent = None
            return None
        return self._redrawn(model, state.start, state)

    def _redrawn(self, model: Model, start: Model, state: State) -> State:
        """The state at times drawn under a model: of several draws, the one that shows least.

        What is missing shows in all of them; what shows in some is the drawing's.
        """
        assert self.latent is not None
        scatter, made = self.latent.scatter, []
        for turn in range(LOOKS):
            model = self.latent.again(model, APART) if turn else model
            made.append(self._at(model, start, state, scatter))
        return max(made, key=lambda one: one.seen.p)

    def _at(self, model: Model, start: Model, state: State, scatter: dict[str, float]) -> State:
        """The state with the times drawn last, and the model they were drawn under fitted to them."""
        assert self.latent is not None
        timely = tuple(self.latent.recordings)
        bench = workbench(timely, self.split, self.model, state.bench.between, self.seed)
        values = {name: model.values[name] for name in start.free if name in model.values}
        current = settled(bench.train, start.set(values), start, tolerance=0.01, max_steps=40)
        jitter = (self.latent.sigma_s, self.latent.error) if self.latent.effect == JITTER else None
        seen = self._looked(bench, current, jitter is not None)
        return State(timely, bench, current, seen, start, None, jitter, scatter)

    def _looked(self, bench: Workbench, current: Climbed, jitter: bool = False) -> Look:
        expected = STRAYS_JITTERED if jitter else None if self.prints else STRAYS_EXPECTED
        return look(bench, current, expected, self.like)

    def _entry_of(self, effect: str) -> dict:
        return next(entry for entry in self.rounds if entry["named"] == effect)

    def new_prints(self) -> list[Fingerprint]:
        """Effects found without the likelihood that the base model lacked."""
        found = [f for f in self.prints if f.effect not in self.base.model.effects]
        return [*found, self.hot.print] if self.hot is not None else found

    def grown_model(self) -> Model:
        """The base with everything found."""
        model = self.state.model
        if self.hot is not None:
            model = model.with_effect("hot_pixels", {"rate_hz": self.hot.print.value, "count": len(self.hot.pixels)})
        return replace(model, name=f"{self.base.model.name}_grown")

    def watched(self) -> np.ndarray:
        """The pixels that confirm: set aside from the beginning, and the hot ones."""
        return self.split.confirm if self.hot is None else np.union1d(self.split.confirm, self.hot.pixels)


def _stamped(found: Fingerprint, known: bool) -> dict:
    return _line(0, found.p, timestamps=found.where, named=None if known else found.effect)


def _entry(turn: int, current: Climbed, seen: Look, found: Attribution) -> dict:
    tried = [
        {"name": c.effect, "gain_nats": c.gain, "p_value": c.p, "heldout_gain_nats": c.heldout_gain}
        for c in found.candidates
    ]
    effects = list(current.model.effects)
    return _line(
        turn + 1, seen.p, strays=seen.maps.strays, model_effects=effects, screened_nats=found.screened, candidates=tried
    )


def _line(turn: int, p: float, **said) -> dict:
    """What the result says of one round; `said` adds to it or replaces what it says of every one."""
    return {"round": turn, "p": p, "candidates": [], "named": None, "refused": None, **said}
