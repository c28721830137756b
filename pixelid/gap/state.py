"""Where a search stands: an immutable value that each step takes and replaces."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pixelid.fit.maximise import Maximum
from pixelid.gap.attribute.attribute import Attribution, Candidate
from pixelid.gap.detect.diagnostics import Diagnostics
from pixelid.gap.detect.pixels import PixelEvidence
from pixelid.gap.imputation.blur import spreads
from pixelid.gap.imputation.impute import FINEST_TICK_S, JITTER, QUEUE, SIGMA, Imputation
from pixelid.gap.phases import Phase
from pixelid.gap.rounds import Rounds
from pixelid.gap.shot_noise.replicates import Corrected
from pixelid.gap.shot_noise.shot_noise import ShotNoise
from pixelid.gap.split import Split
from pixelid.inspection.hot_pixels import HotInSilence
from pixelid.inspection.timestamps import TimestampSignature
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording


@dataclass(frozen=True)
class Hypothesis:
    """A model fitted to the evidence, and what is left under it.

    Attributes:
        recordings: With what the readout did undone.
        evidence: Gathered from them.
        fit: The model on the training pixels.
        seen: What it leaves there.
        start: The base as shipped, with every effect named at its shipped value.
        corrected: What simulation has corrected of model and maps; None where the likelihood is exact.
        jitter: (standard deviation s, its relative standard error) of the timestamps, where that was undone.
        scatter: By parameter, what its coordinate differs by between draws of imputed times.
    """

    recordings: tuple[Recording, ...]
    evidence: PixelEvidence
    fit: Maximum
    seen: Diagnostics
    start: Model
    corrected: Corrected | None = None
    jitter: tuple[float, float] | None = None
    scatter: Mapping[str, float] = field(default_factory=dict)

    @property
    def model(self) -> Model:
        """The fitted model, corrected where it has to be."""
        model = self.corrected.model if self.corrected else self.fit.model
        return model if self.jitter is None else model.with_effect(JITTER, {SIGMA: self.jitter[0]}).fix({SIGMA: None})


@dataclass(frozen=True)
class NamedStep:
    """One effect named.

    Attributes:
        winner: The candidate.
        attribution: What was tried beside it.
        where: What the model was wrong about before, in words.
        firm: Whether it is wanted even when a flexible alternative may take its place.
        before: The hypothesis before it was named.
        noise_before: Shot noise of that hypothesis, where it was named beside it.
    """

    winner: Candidate[Maximum]
    attribution: Attribution[Maximum]
    where: str
    firm: bool
    before: Hypothesis
    noise_before: ShotNoise | None = None

    @property
    def effect(self) -> str:
        """Its name."""
        return self.winner.effect


@dataclass(frozen=True)
class State:
    """A search under way.

    Attributes:
        phase: What comes next.
        recordings: As they came.
        model: The base as shipped, with the effects read off timestamps.
        split: Which pixels fit, select and confirm.
        base, first: The base fitted, and what it leaves.
        hypothesis: The model so far.
        signatures: What timestamps show;  undone: what of it the library has.
        hot: Pixels told by others' silence.
        imputation: Event times behind the readout, where they had to be imputed;  lost: recordings left out of it.
        steps: Effects named by rounds;  turn: rounds so far;  rounds: what the result says of each.
        given_up: Effects not to be tried again.
        asked_again: Effects named before a jitter, looked for once more behind it.
        stamps_asked: Effects that the stamps were asked for.
        jitter_given_up: Whether a jitter has been named once that did not look like one.
        recordings_asked: Whether recordings that differ have been asked for.
        shot_noise, shot_noise_p: Found, and the chance of what it explains.
        shot_noise_tried: Hypotheses beside which it was looked for, and what was found.
        noise_pursued: Those of them beside whose shot noise more was looked for, as something was left.
        global_p: Of anything being amiss at all.
    """

    phase: Phase
    recordings: tuple[Recording, ...]
    model: Model
    split: Split
    base: Maximum
    first: Diagnostics
    hypothesis: Hypothesis
    signatures: tuple[TimestampSignature, ...] = ()
    undone: tuple[TimestampSignature, ...] = ()
    hot: HotInSilence | None = None
    imputation: Imputation | None = None
    lost: tuple[str, ...] = ()
    steps: tuple[NamedStep, ...] = ()
    turn: int = 0
    rounds: Rounds = ()
    given_up: frozenset[str] = frozenset()
    asked_again: frozenset[str] = frozenset()
    stamps_asked: frozenset[str] = frozenset()
    jitter_given_up: bool = False
    recordings_asked: bool = False
    shot_noise: ShotNoise | None = None
    shot_noise_p: float = 1.0
    shot_noise_tried: tuple[tuple[Hypothesis, ShotNoise | None], ...] = ()
    noise_pursued: tuple[Hypothesis, ...] = ()
    global_p: float = 1.0

    def then(self, phase: Phase, **changes) -> State:
        """The state with what has changed, and the step that comes next."""
        return replace(self, phase=phase, **changes)

    def with_global_p(self, held: Iterable[float] = ()) -> State:
        """The state with the chance of anything being amiss with the base.

        held: chances of what candidates gain, and keep on held-out pixels
        """
        # before anything was undone; what the base model has, and was undone, is nothing amiss
        seen_first = self.first if self.new_signatures else self.hypothesis.seen
        chances = [seen_first.p, *held, *(f.p for f in self.new_signatures)]
        return replace(self, global_p=min(1.0, 2.0 * min(chances)))

    def remainder(self, alpha_each: float) -> bool:
        """Whether something significant is left."""
        return self.hypothesis.seen.p < alpha_each

    @property
    def doubts(self) -> list[tuple[NamedStep, Candidate[Maximum]]]:
        """Steps, each with an effect that explains as well what it does and is not named beside it."""
        named = {step.effect for step in self.steps}
        return [
            (step, other) for step in self.steps for other in step.attribution.runners_up if other.effect not in named
        ]

    @property
    def new_signatures(self) -> list[TimestampSignature]:
        """Effects told without the likelihood that the base model lacked."""
        told = [*self.undone, self.hot.signature] if self.hot is not None else list(self.undone)
        return [f for f in told if f.effect not in self.base.model.effects]

    @property
    def imputed(self) -> bool:
        """Whether event times have been imputed."""
        return self.imputation is not None and bool(self.imputation.windows)

    @property
    def hides_jitter(self) -> bool:
        """Whether the times at hand cannot show a jitter: what a readout has put on a grid or in a queue does not
        jitter, and times imputed behind it, or behind a jitter, scatter as they were drawn."""
        coarse = any(f.effect == QUEUE or f.value >= FINEST_TICK_S for f in self.signatures)
        return coarse or self.hypothesis.jitter is not None

    @property
    def unknown_s(self) -> list[np.ndarray] | None:
        """Per recording (n,) s, by how much the times of the training events are unknown; None where they are known."""
        if self.imputation is None or not self.imputed:
            return None
        if self.imputation.effect == JITTER and self.hypothesis.jitter is None:
            return None  # taken back
        return spreads(self.imputation, self.hypothesis.evidence.training)

    @property
    def on_paths(self) -> bool:
        """Whether whole paths of event times have been drawn, and the model fitted to the stamps behind them."""
        return self.imputation is not None and self.imputation.by_paths

    @property
    def grown_model(self) -> Model:
        """The base with everything found."""
        model = self.hypothesis.model
        if self.hot is not None:
            model = model.with_effect(
                "hot_pixels", {"rate_hz": self.hot.signature.value, "count": len(self.hot.pixels)}
            )
        return replace(model, name=f"{self.base.model.name}_grown")

    @property
    def confirming_pixels(self) -> np.ndarray:
        """The pixels set aside from the beginning, and the hot ones."""
        return self.split.confirm if self.hot is None else np.union1d(self.split.confirm, self.hot.pixels)
