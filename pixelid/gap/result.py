"""What the search for the gap found: verdict, effects, the numbers behind them, and the grown model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pixelid.gap.attribute.flexible import Flexible
from pixelid.gap.confirm.free_run import FreeRun
from pixelid.model.files import save_model
from pixelid.model.model import Model
from pixelid.outputs import write_json

VERDICTS = ("none", "named", "ambiguous", "unknown")


@dataclass(frozen=True)
class Named:
    """One effect found.

    p_value: adjusted for all effects tried;  heldout_gain, runner_up_gain: nats on pixels no fit had seen
    max_cosine, max_cosine_with: the most similar other effect or parameter under these stimuli
    parameters: name → (value, 95 % interval);  where: what it was found by
    """

    name: str
    p_value: float
    heldout_gain: float
    runner_up: str | None
    runner_up_gain: float | None
    max_cosine: float
    max_cosine_with: str
    parameters: Mapping[str, tuple[float, tuple[float, float] | None]]
    where: str

    def as_dict(self) -> dict:
        """Its entry in gap.json."""
        return {
            "name": self.name,
            "p_value": self.p_value,
            "heldout_gain_nats": self.heldout_gain,
            "runner_up": self.runner_up,
            "runner_up_gain_nats": self.runner_up_gain,
            "max_cosine": self.max_cosine,
            "max_cosine_with": self.max_cosine_with,
            "parameters": {k: {"value": v, "interval_95": i} for k, (v, i) in self.parameters.items()},
            "where": self.where,
        }


@dataclass(frozen=True)
class GapReport:
    """A finished search.

    verdict: one of `VERDICTS`;  remainder: whether something significant is left unexplained
    base, model: the fitted base model and the grown one;  rounds: what each round saw, as JSON
    free_run: the gap before and after;  term: the nameless term, for what no effect explains
    """

    verdict: str
    sentence: str
    remainder: bool
    global_p: float
    alpha: float
    effects: tuple[Named, ...]
    free_run: FreeRun | None
    rounds: tuple[dict, ...]
    base: Model
    model: Model
    term: Flexible | None
    recommended_next: Mapping
    seconds: float
    seed: int
    details: Mapping = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    inputs_sha256: Mapping[str, str] = field(default_factory=dict)

    def as_dict(self) -> dict:
        """The content of gap.json (COMMANDS.md)."""
        sigma = self.model.values.get("threshold_sigma", 0.02)
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "remainder": self.remainder,
            "global_p": self.global_p,
            "alpha": self.alpha,
            "effects": [effect.as_dict() for effect in self.effects],
            "gap": self.free_run.as_dict() if self.free_run else None,
            "rounds": list(self.rounds),
            "unknown_term": self.term.as_dict(sigma) if self.term else None,
            "model": "model.toml",
            "recommended_next": dict(self.recommended_next),
            "details": dict(self.details),
            "seconds": self.seconds,
            "seed": self.seed,
            "versions": dict(self.versions),
            "inputs_sha256": dict(self.inputs_sha256),
        }

    def save(self, folder: Path) -> None:
        """Write gap.json and model.toml (the grown model) into an existing folder."""
        write_json(folder / "gap.json", self.as_dict())
        save_model(self.model, folder / "model.toml")
