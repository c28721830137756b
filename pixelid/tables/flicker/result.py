"""What a fitted flicker recording says: flicker.json, and what one frequency fixes and leaves open, in words."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from pixelid.parameters.parameter import OPEN_SD
from pixelid.provenance import versions
from pixelid.results import Table, number
from pixelid.statistics import Z95, departures
from pixelid.tables.flicker.circuit import Reading
from pixelid.tables.flicker.figures import draw_maps, draw_phases
from pixelid.tables.flicker.fit import OPEN_PHASE_CYCLES, FlickerFit, Group
from pixelid.tables.flicker.noisy import LINEAR, NAMES
from pixelid.tables.result import TableResult


@dataclass(frozen=True, repr=False)
class FlickerResult(TableResult):
    """Phases of events under a flickering lamp, fitted."""

    FILE: ClassVar[str] = "flicker.json"

    def tables(self) -> list[Table]:
        """Amplitude, lag and noise of the groups of pixels."""
        rows = tuple(
            (f"{g['column']}, {g['row']}", *(number(g[name]["value"]) for name in _OF_GROUPS)) for g in self.records()
        )
        return [Table("", ("group", *_OF_GROUPS.values()), rows, frozenset())]

    def records(self) -> list[dict[str, Any]]:
        """One row per group."""
        return list(self.content["groups"])

    def sentences(self) -> list[str]:
        """Advice, what one frequency fixes, what it leaves open, and where the fit disagrees."""
        content = self.content
        known = [f"identified: {sentence}" for sentence in content["identified"]]
        unknown = [f"not identified: {sentence}" for sentence in content["unidentified"]]
        return [content["advice"], *known, *unknown, *content["disagreements"]]


_OF_GROUPS = {
    "amplitude_over_on_threshold": "amplitude / ON threshold", "off_over_on_threshold": "OFF / ON threshold",
    "phase_cycles": "phase (cycles)",
}  # fmt: skip


def of_flicker(fit: FlickerFit) -> FlickerResult:
    """The result of a fitted recording."""
    figures = {"phases": partial(draw_phases, fit)} | ({"maps": partial(draw_maps, fit)} if len(fit.groups) > 1 else {})
    return FlickerResult(flicker_result(fit), figures)


def flicker_result(fit: FlickerFit) -> dict:
    """The content of flicker.json."""
    status, advice = fit.judge()
    return {
        "status": status,
        "advice": advice,
        "observation": "phase_table",
        "frequency_hz": {"value": fit.frequency_hz, "std": fit.lock.error_hz, "identified": fit.lock.sure},
        "quiet_windows_s": fit.windows,
        "shape": fit.shape,
        "shapes_log_likelihood": fit.shapes,
        "shapes_gain_nats": fit.gains,
        "pulse": pulse(fit),
        "memory_gain_nats": fit.memory_gain,
        "groups": [_group(g, fit.lock.sure) for g in fit.groups],
        "groups_left_out": fit.left_out,
        "parameters": {name: {"identified": bool(sd < OPEN_SD), "std_log": sd} for name, sd in fit.free.sd.items()},
        "fixed_directions": fit.free.fixed,
        "blind_directions": fit.free.blind,
        "if_contrasts_were_equal": {
            "fixed_directions": fit.equal.fixed,
            "blind_directions": fit.equal.blind,
            "identified": [name for name, sd in fit.equal.sd.items() if sd < OPEN_SD],
        },
        "identified": identified_sentences(fit),
        "unidentified": open_sentences(fit),
        "disagreements": disagreements(fit),
        "seconds": fit.seconds,
        "versions": versions(),
        "inputs_sha256": fit.inputs_sha256,
    }


def _group(g: Group, locked: bool) -> dict:
    entry: dict = {"column": g.column, "row": g.row, "pixels": g.table.pixels, "events": g.table.events,
                   "dispersion": g.fit.dispersion, "waveform": []}  # fmt: skip
    linear = LINEAR if g.fit.waveform.logarithmic else (*LINEAR, *g.fit.waveform.numbers)
    for (name, value), sd in zip(g.fit.values.items(), g.sd, strict=True):
        found = {
            "value": value,
            "std": (sd if name in linear else value * sd) if np.isfinite(sd) else None,
            "identified": locked
            and g.fit.converged
            and bool(sd < (OPEN_PHASE_CYCLES if name == "phase_cycles" else OPEN_SD)),
        }
        if name in NAMES:
            entry[name] = found
        else:
            entry["waveform"].append({"name": name} | found)
    return entry


def pulse(fit: FlickerFit) -> dict | None:
    """What the groups show of a light that pulses, behind one pole: its cutoff, and the pulse's share of the period.

    Means over groups, weighted by their errors and what they scatter by beyond these (`departures`); None where no
    group knows both.
    """
    entries = [(g.fit.x[8:], g.sd[8:]) for g in fit.pulses if g.fit.converged and (g.sd[8:] < OPEN_SD).all()]
    if not (entries and fit.lock.sure):
        return None
    found = {}
    for k, (name, scale) in enumerate((("duty", 1.0), ("cutoff_hz", fit.frequency_hz))):
        x, variance = np.array([x[k] for x, _ in entries]), np.array([sd[k] ** 2 for _, sd in entries])
        scatter = departures(np.ones((len(x), 1)), x, np.diag(variance))
        weight = 1.0 / (variance + scatter**2)
        mean, sd = float(weight @ x / weight.sum()), float(weight.sum() ** -0.5)
        low, high = (scale * np.exp(mean + side * Z95 * sd) for side in (-1.0, 1.0))
        found[name] = {"value": scale * np.exp(mean), "interval_95": [low, high], "groups_scatter": scatter}
    return found | {"groups": len(entries), "behind_nats": fit.gains[fit.shape] - fit.gains["pulse"]}


def identified_sentences(fit: FlickerFit) -> list[str]:
    known = fit.known
    if not fit.lock.sure:
        return ["nothing: no light of the expected frequency shows in the events"]
    if not known:
        return ["the frequency of the light, and nothing of the circuit: no group is locked well enough"]
    a = np.array([g.fit.values["amplitude_over_on_threshold"] for g in known])
    ratio = np.array([g.fit.values["off_over_on_threshold"] for g in known])
    lag = _lags(known)
    ms = 1e3 / fit.frequency_hz
    return [
        f"amplitude / ON threshold at {fit.frequency_hz:.2f} Hz, per group: {_range(a)}",
        f"OFF / ON threshold: {np.median(ratio):.2f} (median; {_range(ratio)})",
        f"phase of each group relative to the others: they lag by 0 to {np.ptp(lag):.2f} cycles "
        f"({ms * np.ptp(lag):.2f} ms)",
        "noise / ON threshold of each group, as far as the shape of the noise is right",
    ]


def _range(values: np.ndarray) -> str:
    """Smallest to largest of the groups' values, or the one."""
    low, high = f"{values.min():.2g}", f"{values.max():.2g}"
    return low if low == high else f"{low} to {high} in {len(values)} groups"


def open_sentences(fit: FlickerFit) -> list[str]:
    return [
        f"alpha, beta, gamma, sf_cutoff_hz, diff_cutoff_hz: {fit.free.blind} of "
        f"{fit.free.blind + fit.free.fixed} parameter combinations cannot be determined; one frequency gives "
        "one amplitude and one phase per group",
        "contrast × bandwidth / threshold: only their product is the amplitude, so thresholds and "
        "contrasts stay unknown",
        "absolute phase lag: the lamp's own phase is unknown, only differences between groups are seen",
        f"if every group saw the same contrast, {fit.equal.fixed} of {fit.equal.fixed + fit.equal.blind} directions "
        "would be fixed" + (", and still none of the circuit's parameters" if not _circuit_known(fit.equal) else ""),
    ]


def _circuit_known(reading: Reading) -> bool:
    return any(
        reading.sd[n] < OPEN_SD for n in ("alpha", "beta", "gamma", "sf_cutoff_hz", "diff_cutoff_hz", "on_threshold")
    )


def _lags(groups: list[Group]) -> np.ndarray:
    """Phases of groups in cycles, unwrapped about their mean direction."""
    phase = np.array([g.fit.values["phase_cycles"] for g in groups])
    centre = np.angle(np.exp(2j * np.pi * phase).sum()) / (2 * np.pi)
    return (phase - centre + 0.5) % 1.0 - 0.5


def disagreements(fit: FlickerFit) -> list[str]:
    sentences = []
    worst = max(fit.groups, key=lambda g: g.fit.dispersion)
    typical = float(np.median([g.fit.dispersion for g in fit.groups]))
    if typical > 1.3:
        sentences.append(
            f"counts scatter {typical:.1f} times more than Poisson about the fit (median; "
            f"{worst.fit.dispersion:.1f} in group "
            f"{worst.column}, {worst.row}): pixels within a group differ; errors are scaled for it"
        )
    order = sorted(fit.gains, key=lambda s: -fit.gains[s])
    behind = [f"{s!r} is {fit.gains[order[0]] - fit.gains[s]:.0f} nats worse" for s in order[1:]]
    sentences.append(
        f"the light looks like {order[0]!r}: {', '.join(behind)} (over {len(fit.groups)} groups, scatter and a price "
        "per number of a waveform allowed for)"
    )
    found = pulse(fit)
    if found and order[0] not in ("sine", "deep sine", "rectified"):
        cutoff, duty = found["cutoff_hz"], found["duty"]
        sentences.append(
            f"as a pulse behind one pole: a cutoff of {cutoff['value']:.3g} Hz ({cutoff['interval_95'][0]:.3g} to "
            f"{cutoff['interval_95'][1]:.3g}), lit for {duty['value']:.2g} of the period, in {found['groups']} groups"
        )
    gain = fit.memory_gain / max(typical, 1.0)
    # a reference that fades is named when it is 10 nats likelier: e¹⁰ to one, beyond what the choice of shape can
    # give
    min_memory_gain_nats = 10.0
    if gain > min_memory_gain_nats:
        memory = np.median([g.fit.values["memory"] for g in fit.groups])
        sentences.append(
            f"the level of the last event is remembered by {memory:.2f} only (median; 1 is the model's "
            f"comparator, which is "
            f"{gain:.0f} nats worse): a lower cutoff near the flicker's frequency, or events that noise "
            "triggers, would do that, and this recording cannot show which"
        )
    known = fit.known
    if len(known) > 4:
        lag, a = _lags(known), np.log([g.fit.values["amplitude_over_on_threshold"] for g in known])
        r = float(np.corrcoef(lag, a)[0, 1])
        sentences.append(
            f"amplitude and lag of groups correlate at r = {r:+.2f}: one pole of varying bandwidth alone "
            f"would give −1; "
            "the rest is contrast that varies over the scene"
        )
        error = float(np.hypot(known[lag.argmax()].sd[2], known[lag.argmin()].sd[2]))
        if np.ptp(lag) > 0.25 + 2.0 * error:
            sentences.append(
                f"lags differ by {np.ptp(lag):.2f} cycles, more than the 0.25 that one pole can give: "
                "dim pixels need at least two"
            )
    return sentences
