"""Which effects look alike under these stimuli: their directions in the space of residuals.

An effect of a small strength λ moves the level of event k by λ v_k of its scale, and its log scale by λ w_k; both
stand in one column (v, √2 w), whose inner products are those of the Fisher information of a normal density.  What the
free parameters can imitate is projected out (v demeaned per pixel and polarity, off the tangents J): v⊥.  Two effects
with |cos| of their v⊥ near 1 cannot be told apart by these recordings, and an effect with v⊥ ≈ 0 hides behind the
free parameters.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pixelid import stages
from pixelid.errors import InputError
from pixelid.fit.maximise import Maximum
from pixelid.gap.attribute.candidates import SILENCE, by_strength
from pixelid.gap.detect.residuals import Residuals, compare, residuals, tangents
from pixelid.gap.imputation.blur import Blur, blur_by
from pixelid.gap.imputation.exact import LOST
from pixelid.gap.imputation.windows import DELAY
from pixelid.likelihood.density import sum_by
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model

# Of the events, that may lose their cause there: they count as not moved, so this much of what an effect would show may
# be missed.
MAX_SHARE_LOST = 0.05
WEAKER_DECADES = (-3.0, -4.0, -5.0)  # of the shipped strength, where a hundredth of it moves the residuals too far
WITHOUT_DIRECTION = {LOST, SILENCE}  # they take events away, and leave the residuals of the others where they are
MIN_RMS_MOVE_SD = 1e-9  # below, rounding
PRIOR_SD = 1.0  # of coordinates (a factor e), where these recordings say nothing of them


@dataclass(frozen=True)
class Direction:
    """One effect.

    strength: of its first parameter, at which v was taken;  raw: (2n,) v demeaned;  clear: (2n,) v⊥
    bias: (d,) what each free coordinate would move by if the effect were there and the model lacked it
    seen: Σ v⊥² at the library's typical strength, twice the nats by which it would show;  hidden: cosine between v and
    what the free parameters can do
    """

    effect: str
    strength: float
    raw: np.ndarray
    clear: np.ndarray
    bias: np.ndarray
    seen: float
    hidden: float


@dataclass(frozen=True)
class Space:
    """Residuals of a fitted model and the tangents of its free parameters, J (2n, d), weighed.

    blur: of the events, where their times are not known;  unknown_s: by how much they are not, in the mean
    """

    likelihood: EventTimes
    fit: Maximum
    here: Residuals
    J: np.ndarray
    blur: Blur | None = None
    unknown_s: float = 0.0

    def weighed(self, column: np.ndarray) -> np.ndarray:
        """A column (2n,) as the stamps show it: as it is, where they are the times."""
        if self.blur is None:
            return column
        n = len(self.here.e)
        return np.concatenate([self.blur.weigh(column[:n]), column[n:] * self.blur.share])

    def demeaned(self, column: np.ndarray) -> np.ndarray:
        """A weighed column (2n,) whose levels lack their mean per pixel and polarity; 0 for background events."""
        likelihood, n = self.likelihood, len(self.here.e)
        kept = ~self.here.background
        level, rest = column[:n], column[n:]
        if self.blur is not None:
            return np.concatenate([self.blur.without_pixel_means(level), rest])
        size = np.maximum(np.bincount(likelihood.group, kept, 2 * likelihood.pixels), 1.0)
        mean = sum_by(likelihood.group, np.where(kept, level, 0.0), 2 * likelihood.pixels) / size
        return np.concatenate([np.where(kept, level - mean[likelihood.group], 0.0), np.where(kept, rest, 0.0)])


def residual_space(likelihood: EventTimes, end: Maximum, sd_s: Sequence[np.ndarray] | None = None) -> Space:
    """The residual space of a fit; sd_s: per recording (n,) s, by how much the times of its events are unknown."""
    circuit = end.model.circuit()
    here = residuals(likelihood, circuit)
    tangent = tangents(likelihood, end.coordinates, end.x, here)
    J = np.concatenate([tangent.level, np.sqrt(2.0) * tangent.log_scale])
    if sd_s is None:
        return Space(likelihood, end, here, J)
    unknown = float(np.mean(np.concatenate(sd_s))) if likelihood.events else 0.0
    at = Space(likelihood, end, here, J, blur_by(likelihood, circuit, sd_s), unknown)
    return replace(at, J=np.column_stack([at.weighed(column) for column in J.T])) if J.size else at


def direction(at: Space, effect: str) -> Direction | None:
    """The direction of a missing effect, at the largest strength tried that is small; None if it moves nothing.

    From weak to strong, as moves grow: beyond the first that is large, most events may have lost their cause, and what
    little of the others moves is no direction.  Where the weakest moves far, weaker ones are tried.
    """
    if effect in WITHOUT_DIRECTION:
        return None
    best = _largest_small_move(at, by_strength(at.fit.model, effect))
    for decade in WEAKER_DECADES if best is None else ():
        best = _largest_small_move(at, by_strength(at.fit.model, effect, (decade,)))
        if best is not None:
            break
    if best is None or best[0] < MIN_RMS_MOVE_SD:
        return None
    _, v, trial = best
    v = at.weighed(v)
    name = next(p.name for p in stages.effect(effect).parameters if p.free)
    raw = at.demeaned(v)
    J = np.column_stack([at.demeaned(column) for column in at.J.T])
    inner, *_ = np.linalg.lstsq(J, raw, rcond=1e-10)
    # pixel means included: what shifts all pixels, thresholds imitate; a wide prior holds what the data do not know
    bias = np.linalg.solve(at.J.T @ at.J + np.eye(at.J.shape[1]) / PRIOR_SD**2, at.J.T @ v)
    clear = raw - J @ inner
    ratio = _typical_ratio(effect, name, trial, at.fit.model)
    total = float(np.sum(v**2))
    hidden = float(np.sqrt(max(0.0, 1.0 - np.sum(clear**2) / total))) if total > 0 else 1.0
    return Direction(
        effect,
        trial.values[name],
        raw,
        clear,
        bias,
        _shown(at, J, ratio * raw) if DELAY in at.fit.coordinates.names else float(np.sum(clear**2)) * ratio**2,
        hidden,
    )


def _largest_small_move(at: Space, strengths: Iterable[Sequence[Model]]) -> tuple[float, np.ndarray, Model] | None:
    """The largest of the moves (`_move`) that are small, of strengths from weak to strong; None where none is."""
    best: tuple[float, np.ndarray, Model] | None = None
    max_rms_move_sd = 0.2  # of the residuals, at the strength at which a direction is taken: small enough to be linear
    for alike in strengths:
        moves = [moved for moved in (_move(at, trial) for trial in alike) if moved is not None]
        small = [moved for moved in moves if moved[0] < max_rms_move_sd]
        if moves and not small:
            break
        best = max((one for one in (best, *small) if one is not None), key=lambda one: one[0], default=None)
    return best


def _move(at: Space, trial: Model) -> tuple[float, np.ndarray, Model] | None:
    """(rms, (2n,) how a trial moves the residuals, the trial); infinite where too many events lose their cause.

    None where it cannot be evaluated.
    """
    try:
        moved = residuals(at.likelihood, trial.circuit())
    except InputError:
        return None
    lost = moved.background & ~at.here.background
    if lost.sum() > MAX_SHARE_LOST * len(lost):
        return np.inf, np.zeros(2 * len(lost)), trial
    undefined = at.here.background | moved.background
    level, log_scale = compare(at.here, moved)
    change = np.concatenate([np.where(undefined, 0.0, level), np.where(undefined, 0.0, np.sqrt(2.0) * log_scale)])
    return float(np.sqrt(np.mean(change**2))), change, trial


def _shown(at: Space, J: np.ndarray, v: np.ndarray) -> float:
    """Σ v⊥² of an effect at its typical strength, where the delay of the stamps can imitate it within its bounds only.

    J: (2n, d) tangents, demeaned;  v: (2n,) the effect, demeaned
    """
    index = at.fit.coordinates.names.index(DELAY)
    lower, upper = (edge[index] for edge in at.fit.coordinates.bounds())
    held = np.zeros(J.shape[1])
    held[index] = np.sqrt(12.0) / (upper - lower)  # the standard deviation of what is uniform between them
    rows, wanted = np.vstack([J, held]), np.append(v, 0.0)
    moved, *_ = np.linalg.lstsq(rows, wanted, rcond=1e-10)
    return float(np.sum((wanted - rows @ moved) ** 2))


def _typical_ratio(effect: str, name: str, trial: Model, base: Model) -> float:
    """How many times as strong as in `trial` an effect is at its shipped values; linear, as weak effects are.

    A pole's strength is the delay that it adds.  A second-order photoreceptor adds to one pole the delay 1/β of
    another, which α follows there, and to none that of both, nearly β/(αL).
    """
    shipped = {p.name: p.value for p in trial.library(effect)}
    if effect == "second_order_photoreceptor" and base.photoreceptor == "unlimited":
        late = trial.values["beta"] / trial.values["alpha"]
        return shipped["beta"] / shipped["alpha"] / late
    ratio = shipped[name] / trial.values[name]
    return 1.0 / ratio if stages.effect(effect).weakens else ratio


def cosine(a: np.ndarray, b: np.ndarray) -> float:
    """|cos| between two directions; 0 when either vanishes."""
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return abs(float(a @ b)) / size if size > 0 else 0.0


def confusion(directions: Sequence[Direction]) -> dict[str, dict]:
    """What these stimuli would take each missing effect for.

    effect → its |cos| with every other, the most alike one, and by how many nats it would be told apart from that one
    at its typical strength (few nats: `ambiguous`).
    """
    table = {}
    for own in directions:
        alike = {other.effect: cosine(own.clear, other.clear) for other in directions if other is not own}
        nearest = max(alike, key=lambda name: alike[name], default="")
        apart = 0.5 * own.seen * (1.0 - alike.get(nearest, 0.0) ** 2)
        table[own.effect] = {"most_alike": nearest, "told_apart_nats": apart, "cosines": alike}
    return table


def similarities(at: Space, effect: str, others: Sequence[Direction]) -> dict[str, float]:
    """|cos| between an effect that the fitted model has and the directions of those that it lacks, by name."""
    name = next(p.name for p in stages.effect(effect).parameters if p.free)
    index = at.fit.coordinates.names.index(name)
    rest = [i for i in range(len(at.fit.x)) if i != index]
    own = at.demeaned(at.J[:, index])
    J = np.column_stack([at.demeaned(at.J[:, i]) for i in rest])
    q, _ = np.linalg.qr(J)
    own = own - q @ (q.T @ own)
    return {other.effect: cosine(own, other.raw - q @ (q.T @ other.raw)) for other in others}
