"""What to record next: the stimulus of the menu that shows most of what these recordings cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pixelid.design.information import simulated
from pixelid.design.menu import Candidate, default_menu
from pixelid.errors import InputError
from pixelid.fit.maximise import maximise
from pixelid.gap.attribute.candidates import holds_together, remove_effect
from pixelid.gap.attribute.directions import Direction, Space, direction, residual_space
from pixelid.gap.options import Options
from pixelid.gap.state import State
from pixelid.gap.verdict import Confounder
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.stimuli.resample import with_overshoots


def advise(
    state: State,
    at: Space,
    directions: Sequence[Direction],
    confounder: Confounder | None,
    remainder: bool,
    options: Options,
) -> dict:
    """What gap.json recommends to record next.

    at: the residual space of the final model;  directions: of the effects that it lacks
    """
    hypothesis, seed = state.hypothesis, options.seed
    model = hypothesis.fit.model
    if remainder:
        cells = hypothesis.seen.maps.cells
        place = cells[0].label if cells else "the recordings as they are"
        return {
            "why": f"the remainder is clearest here: {place}; record more pixels and longer there",
            "stimulus": None,
        }
    if confounder is not None:
        why = f"to tell {confounder.effect} from unequal thresholds"
        return recommended(at, state.model, confounder.effect, None, why, seed)
    if state.doubts:
        step, other = state.doubts[0]
        winner, runner_up = step.effect, other.effect
        without = remove_effect(model, winner, state.model)
        if not holds_together(without):
            without = step.before.fit.model
        training = hypothesis.evidence.training
        lacking = residual_space(training, maximise(training, without, tolerance=0.1, max_steps=5), state.unknown_s)
        why = f"to tell {winner} from {runner_up}"
        return recommended(lacking, state.model, winner, runner_up, why, seed)
    blind = blindest(directions)
    if blind is None:
        return {"why": "nothing: every effect of the library is in the model", "stimulus": None}
    why = f"to see {blind.effect}, the effect that could be overlooked most easily in these recordings"
    return recommended(at, state.model, blind.effect, None, why, seed)


def recommended(at: Space, nominal: Model, effect: str, runner_up: str | None, why: str, seed: int) -> dict:
    """The candidate under which the effect, cleared of the free parameters and the runner-up, would show most.

    nominal: the base as shipped, whose menu is used (fitted values may be unknown to the recordings at hand)
    Returns what gap.json says: name, kind and parameters of the stimulus, why, and the expected doubled nats of the
    effect at its typical strength with the recordings at hand and with the candidate added.
    """
    have = _gram(at, effect, runner_up)
    best: tuple[float, Candidate] | None = None
    for candidate in default_menu(nominal):
        if candidate.name.startswith("long_"):
            continue
        try:
            there = _candidate_space(at, candidate, seed)
            gram = None if there is None else _gram(there, effect, runner_up)
        except InputError:
            continue
        if gram is None:
            continue
        scale = at.likelihood.pixels / max(there.likelihood.pixels, 1) if there is not None else 1.0
        value = _seen(scale * gram if have is None else have + scale * gram)
        if best is None or value > best[0]:
            best = value, candidate
    now = 0.0 if have is None else _seen(have)
    if best is None:
        return {"why": why, "stimulus": None, "would_show": None, "shows_now": now}
    return {"why": why, "stimulus": best[1].as_dict(), "would_show": best[0], "shows_now": now}


def _candidate_space(at: Space, candidate: Candidate, seed: int) -> Space | None:
    recording = simulated(at.fit.model, candidate.stimulus, seed)
    if len(recording.events) < 20:
        return None
    likelihood = EventTimes([recording.with_stimulus(with_overshoots(candidate.stimulus))])
    unknown = [np.full(len(recording.events), at.unknown_s)] if at.blur is not None else None
    return residual_space(likelihood, at.fit, unknown)


def _gram(at: Space, effect: str, runner_up: str | None) -> np.ndarray | None:
    """Inner products of [effect, runner-up, J …], directions at typical strength; None when the effect is unseen."""
    own = direction(at, effect)
    if own is None:
        return None
    columns = [_typical(own)]
    if runner_up is not None:
        other = direction(at, runner_up)
        if other is not None:
            columns.append(_typical(other))
        else:
            columns.append(np.zeros(len(own.raw)))
    J = np.column_stack([*columns, *(at.demeaned(column) for column in at.J.T)])
    return J.T @ J


def _typical(d: Direction) -> np.ndarray:
    size = float(np.sum(d.clear**2))
    return d.raw * (np.sqrt(d.seen / size) if size > 0 else 0.0)


def _seen(gram: np.ndarray) -> float:
    """What of the first column is left after projection off the others."""
    rest = gram[1:, 1:]
    scale = np.sqrt(np.maximum(np.diag(rest), 1e-300))
    inverse = np.linalg.pinv(rest / np.outer(scale, scale), rcond=1e-10)
    along = gram[0, 1:] / scale
    return float(max(gram[0, 0] - along @ inverse @ along, 0.0))


def blindest(directions: Sequence[Direction]) -> Direction | None:
    """The effect that would show least at its typical strength."""
    return min(directions, key=lambda d: d.seen, default=None)
