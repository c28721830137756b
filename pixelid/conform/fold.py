"""The table's lines, each folded from what a search has said; nothing here fits or decides again."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pixelid import stages
from pixelid.conform.removals import BANDWIDTH, Removal
from pixelid.conform.row import ABSENT, NOT_DECIDABLE, NOT_TESTED, PRESENT, STAGES, Row, Strength
from pixelid.gap.attribute.significance import gain_of_chance
from pixelid.gap.confirm.intervals import open_sides
from pixelid.gap.criteria import Criteria
from pixelid.gap.result import GapReport
from pixelid.inspection.timestamps import TimestampSignature
from pixelid.model.model import Model
from pixelid.parameters.parameter import precision_in_words


def nats_needed(effect: str, alpha_each: float, tried: int, pixels: Mapping[str, Any], criteria: Criteria) -> float:
    """Nats on the training pixels that an effect has to be worth for a search to name it with a power of 80 %.

    A gain of S nats expected is a χ² of non-centrality λ = 2 S, of which √λ has about unit variance.  To be named the
    gain has to be significant on the pixels that fit, among `tried` effects, and to exceed so many of its standard
    errors on the pixels that select, where it is λ/2 ± √λ.

    Args:
        effect: Its name.
        alpha_each: Chance that naming may err by.
        tried: Number of effects tried.
        pixels: How many "fit" and "select"; both together train, and with too few pixels all do either.
        criteria: Of the search.
    """
    fit, select = int(pixels["fit"]), int(pixels["select"])
    train = fit + select if pixels.get("apart", True) else max(fit, select)
    power_sd = 0.84  # standard deviations above what is required, for a power of 80 %
    significant = np.sqrt(2.0 * gain_of_chance(effect, alpha_each, tried)) + power_sd
    leading = 2.0 * (criteria.min_lead_standard_errors + power_sd)
    return 0.5 * train * max(significant**2 / max(fit, 1), leading**2 / max(select, 1))


THRESHOLDS = ("on_threshold", "off_threshold")


@dataclass(frozen=True)
class Beside:
    """What a table needs of a search that its report does not say.

    Attributes:
        model: That the search ended with, before descriptions, fitted.
        intervals: 95 %, of its free parameters.
        removals: Of effects that came with the base model.
        doubted: Named effect → others that explain as well what it does.
        readout: Effect read off timestamps or single pixels → why it is absent, or None where nothing can decide.
        signatures: Effect that timestamps or single pixels show → how.
        pixels: Whether events have pixels.
    """

    model: Model
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    removals: Mapping[str, Removal] = field(default_factory=dict)
    doubted: Mapping[str, Sequence[str]] = field(default_factory=dict)
    readout: Mapping[str, str | None] = field(default_factory=dict)
    signatures: Mapping[str, TimestampSignature] = field(default_factory=dict)
    pixels: bool = True

    def strength(self, name: str) -> Strength:
        """(value, 95 % interval) of a parameter; a side that its range ends, and no data, is None."""
        ranges = {**self.model.parameters, **self.model.nuisances}
        return self.model.values[name], open_sides(self.intervals.get(name), ranges[name])


def rows_of(report: GapReport, beside: Beside, criteria: Criteria) -> tuple[Row, ...]:
    """One line for each effect of the library and for what every pixel has, in the order of the signal path."""
    rows = [_row(name, report, beside, criteria) for name in stages.LIBRARY]
    rows += [_bandwidth(rows, beside), *(_threshold(name, beside) for name in THRESHOLDS)]
    return tuple(sorted(rows, key=lambda row: STAGES.index(row.stage)))


def _row(effect: str, report: GapReport, beside: Beside, criteria: Criteria) -> Row:
    stage = stages.effect(effect).stage
    named = next((e for e in report.effects if e.name == effect), None)
    if named is not None:
        others = [*beside.doubted.get(effect, ())]
        gains = next((c for entry in report.rounds if entry["named"] == effect for c in entry["candidates"]
                      if c["name"] == effect), None)  # fmt: skip
        return Row(
            effect, stage, NOT_DECIDABLE if others else PRESENT,
            f"{', '.join(others)} would explain it as well" if others else named.where, named.parameters, named.p_value,
            gains["gain_nats"] if gains else None, named.heldout_gain,
        )  # fmt: skip
    rivals = [name for name, others in beside.doubted.items() if effect in others]
    if rivals:
        return Row(effect, stage, NOT_DECIDABLE, f"would explain as well what {rivals[0]} does")
    if report.base.has(effect) and not stages.effect(effect).in_event_times and beside.pixels:
        return _readout_in_base(effect, beside)
    if report.base.has(effect):
        return _in_base(effect, beside, criteria)
    if effect in report.details.get("withdrawn", ()):
        return Row(effect, stage, NOT_DECIDABLE, "named, then removed: on held-out pixels it closes next to nothing",
                   {}, *_gains(effect, report.rounds))  # fmt: skip
    if report.verdict == "ambiguous" and effect in report.sentence:
        return Row(effect, stage, NOT_DECIDABLE, report.sentence)
    if not stages.effect(effect).in_event_times and beside.pixels:
        return _in_readout(effect, beside)
    return _lacking(effect, report, beside, criteria)


def _in_base(effect: str, beside: Beside, criteria: Criteria) -> Row:
    """An effect of the base model: needed, or weaker than it ever is, or open."""
    own, values = stages.effect(effect), beside.model.values
    strengths = {p.name: beside.strength(p.name) for p in own.parameters if p.name in values}
    removal = beside.removals.get(effect)
    said = (removal.p, removal.gain, removal.heldout_gain) if removal else (None, None, None)
    free = next((p for p in own.parameters if p.free), own.parameters[0])
    limits = beside.intervals.get(free.name)
    if removal is not None and removal.needed:
        return Row(effect, own.stage, PRESENT, "in the base model, and fits worse without it", strengths, *said)
    if limits is None:
        why = "in the base model; it was not taken out" if removal is None else "in the base model, not fitted"
        return Row(effect, own.stage, NOT_TESTED, why, strengths, *said)
    weakest, strongest = _relative(effect, limits, free.value)
    if removal is None and weakest > criteria.min_relative_strength:
        return Row(effect, own.stage, PRESENT, "in the base model; its interval excludes none", strengths)
    if strongest < 1.0:
        limit = (
            free.name,
            limits[0] if own.weakens else max(abs(limits[0]), abs(limits[1])),
        )
        why = "in the base model, fits as well without it, and its interval ends below the typical strength"
        return Row(effect, own.stage, ABSENT, why, {}, *said, limit=limit)
    without = "it could not be taken out" if removal is None else "fits as well without it"
    return Row(effect, own.stage, NOT_DECIDABLE, f"in the base model, {without}, and it may be strong", strengths,
               *said)  # fmt: skip


def _readout_in_base(effect: str, beside: Beside) -> Row:
    """An effect of the base model that no density of single events knows."""
    stage, signature = stages.effect(effect).stage, beside.signatures.get(effect)
    if signature is not None:
        strength = {signature.parameter: (signature.value, signature.interval)}
        return Row(effect, stage, PRESENT, signature.where, strength, signature.p)
    row = _in_readout(effect, beside)
    return replace(row, why=f"in the base model; {row.why}")


def _relative(effect: str, limits: tuple[float, float], typical: float) -> tuple[float, float]:
    """(weakest, strongest) of an interval, in units of the typical strength."""
    ends = sorted(abs(end) / abs(typical) for end in limits)
    if limits[0] < 0 < limits[1]:
        ends[0] = 0.0
    if stages.effect(effect).weakens:
        return 1.0 / max(ends[1], 1e-300), 1.0 / max(ends[0], 1e-300)
    return ends[0], ends[1]


def _in_readout(effect: str, beside: Beside) -> Row:
    """An effect that no density of single events knows, and that was not found."""
    stage = stages.effect(effect).stage
    if effect not in beside.readout:
        return Row(effect, stage, NOT_TESTED, "looked for only where something significant is left to explain")
    why = beside.readout[effect]
    if why is None:
        return Row(
            effect, stage, NOT_DECIDABLE, "too few events, pixels or quiet seconds, or too coarse a file, to decide"
        )
    return Row(effect, stage, ABSENT, why)


def _lacking(effect: str, report: GapReport, beside: Beside, criteria: Criteria) -> Row:
    """An effect that base and grown model lack."""
    stage, details = stages.effect(effect).stage, report.details
    tried = [entry for entry in report.rounds if entry["candidates"] or entry.get("screened_nats")]
    last = tried[-1] if tried else {}
    if not beside.pixels and effect in details.get("not_in_pooled_counts", ()):
        return Row(effect, stage, NOT_TESTED, "counts without pixel addresses do not show it")
    skipped = last.get("skipped", {})
    if effect in skipped:
        return Row(effect, stage, NOT_TESTED, str(skipped[effect]))
    p, _, held = said = _gains(effect, tried[-1:])
    if p is not None and held is not None and p < report.alpha / 2 and held > criteria.min_lead_nats:
        refused = last.get("refused") or "something else explains more"
        return Row(effect, stage, NOT_DECIDABLE, f"it would gain, but was not named: {refused}", {}, *said)
    shows = details.get("shows_at_typical_strength_nats", {}).get(effect)
    if shows is None:
        if not beside.pixels and not tried:
            return Row(effect, stage, NOT_TESTED, "looked for only where something significant is left to explain")
        if effect not in last.get("screened_nats", {}):
            return Row(effect, stage, NOT_TESTED, "no strength of it could be tried on these recordings", {}, *said)
        if not beside.pixels:
            why = "tried, and gains too little; from what strength on pooled counts would show it is not known"
            return Row(effect, stage, NOT_DECIDABLE, why, {}, *said)
        return Row(effect, stage, NOT_DECIDABLE, "no visible influence here", {}, *said)
    split = {**details["pixels"], "apart": details["held_out"]}
    others = max(len(last.get("screened_nats", {})), len(details["shows_at_typical_strength_nats"]))
    needed = nats_needed(effect, report.alpha / 2, others, split, criteria)
    if shows < needed:
        why = f"at its typical strength it would show by {shows:.2g} nats, less than the {needed:.2g} that a name needs"
        return Row(effect, stage, NOT_DECIDABLE, why, {}, *said, shows_nats=shows)
    why = "detectable here; not found"
    if report.remainder:
        why += "; something else is left unexplained"
    limit = _limit(effect, beside.model, shows, needed)
    return Row(effect, stage, ABSENT, why, {}, *said, shows_nats=shows, limit=limit)


def _gains(effect: str, rounds: Sequence[Mapping[str, Any]]) -> tuple[float | None, float | None, float | None]:
    """(p, nats on pixels fitted, on pixels that no fit has seen) in the last of the rounds that fitted the effect."""
    fitted = [c for entry in rounds for c in entry["candidates"] if c["name"] == effect]
    last = fitted[-1] if fitted else None
    return (last["p_value"], last["gain_nats"], last["heldout_gain_nats"]) if last else (None, None, None)


def _limit(effect: str, model: Model, shows: float, needed: float) -> tuple[str, float]:
    """(parameter, strength that would show enough): nats go with the square of the strength."""
    free = next(p for p in model.library(effect) if p.free)
    factor = math.sqrt(needed / shows)
    return free.name, abs(free.value) * (1.0 / factor if stages.effect(effect).weakens else factor)


def _bandwidth(rows: Sequence[Row], beside: Beside) -> Row:
    """Whether the photoreceptor has a bandwidth that light sets, of whatever order."""
    if beside.model.photoreceptor == "unlimited":
        second = next(row for row in rows if row.effect == "second_order_photoreceptor")
        return Row(BANDWIDTH, "photoreceptor", second.verdict, f"the model has none; a second-order one: {second.why}")
    values = beside.model.values
    names = [n for n in ("alpha", "beta", "gamma", "alpha_over_beta") if n in values]
    strengths = {n: beside.strength(n) for n in names}
    removal = beside.removals.get(BANDWIDTH)
    if removal is None:
        why = "a pixel without it could not be fitted" if beside.pixels else "it was not taken out of pooled counts"
        return Row(BANDWIDTH, "photoreceptor", NOT_TESTED, why, strengths)
    why = "the model fits worse without it" if removal.needed else "the model fits as well without it"
    return Row(BANDWIDTH, "photoreceptor", PRESENT if removal.needed else NOT_DECIDABLE, why, strengths, removal.p,
               removal.gain, removal.heldout_gain)  # fmt: skip


def _threshold(name: str, beside: Beside) -> Row:
    """A threshold as fitted, or what kept it from being: every pixel has one, but perhaps no event identifies it."""
    strength = beside.strength(name)
    limits = strength[1]
    has_it = "always present"
    if not beside.pixels:
        why = f"{has_it}; pooled counts show only its ratio to the number of pixels"
        return Row(name, "comparator", PRESENT, why, {name: strength})
    if limits is None:
        return Row(name, "comparator", NOT_TESTED, f"{has_it}; held at the model's value, not fitted", {name: strength})
    known = precision_in_words(limits, beside.model.parameters[name])
    if None in limits:
        shown = {} if known == "not identified" else {name: strength}
        return Row(name, "comparator", NOT_DECIDABLE, f"{has_it}; {known}", shown)
    return Row(name, "comparator", PRESENT, f"{has_it}; fitted value", {name: strength})
