"""What a result says of each round of a search, as JSON."""

from __future__ import annotations

from collections.abc import Mapping

from pixelid.fit.maximise import Maximum
from pixelid.gap.attribute.attribute import Attribution
from pixelid.gap.detect.diagnostics import Diagnostics
from pixelid.inspection.timestamps import TimestampSignature

Rounds = tuple[dict, ...]


def entry(turn: int, p: float, **told) -> dict:
    """What the result says of one round; `told` adds to it, or replaces what it says of every one."""
    return {"round": turn, "p": p, "candidates": [], "named": None, "refused": None, **told}


def signature_entry(signature: TimestampSignature, known: bool) -> dict:
    """Of an effect read off timestamps or single pixels; known: the base model has it."""
    return entry(0, signature.p, timestamps=signature.where, named=None if known else signature.effect)


def candidate_entries(attribution: Attribution) -> list[dict]:
    """What the result says of every effect tried in a round."""
    return [
        {"name": c.effect, "gain_nats": c.gain, "p_value": c.p, "heldout_gain_nats": c.heldout_gain}
        for c in attribution.candidates
    ]


def attribution_entry(
    turn: int, fit: Maximum, seen: Diagnostics, attribution: Attribution, impossible: Mapping[str, str]
) -> dict:
    """Of effects tried beside a fitted model, and of those impossible there, with reasons."""
    return entry(
        turn + 1, seen.p, background_events=seen.maps.background, model_effects=list(fit.model.effects),
        screened_nats=attribution.screened, candidates=candidate_entries(attribution),
        skipped={**impossible, **attribution.skipped},
    )  # fmt: skip


def amended(rounds: Rounds, index: int, **told) -> Rounds:
    """The rounds with more said of one of them."""
    index %= len(rounds)
    return (*rounds[:index], {**rounds[index], **told}, *rounds[index + 1 :])


def withdrawn(rounds: Rounds, effect: str, why: str) -> Rounds:
    """The rounds with an effect taken back where it was named last: one taken back before may have been named again."""
    index = max(i for i, one in enumerate(rounds) if one["named"] == effect)
    return amended(rounds, index, withdrawn=why)
