"""Fit a flicker recording: its frequency, then amplitude, phase and noise of every group of pixels."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pixelid.errors import InputError
from pixelid.flicker.circuit import Reading, read
from pixelid.flicker.noisy import LINEAR, LOWER, NAMES, SHAPES, UPPER, GroupFit, fit_group
from pixelid.flicker.phases import PhaseTable, locked_frequency, phase_table, quiet_windows
from pixelid.model.model import Model
from pixelid.provenance import input_hashes, versions
from pixelid.recordings.recording import Recording
from pixelid.status import Status

OPEN_SD = 0.5


@dataclass(frozen=True)
class Group:
    """One group of pixels: where it is (column, row of the grid), its data and its fit."""

    column: int
    row: int
    table: PhaseTable
    fit: GroupFit

    @property
    def sd(self) -> np.ndarray:
        """(8,) standard errors in the fit's coordinates, inf where open; those on a bound are held, and inf."""
        x = self.fit.x
        free = (x > LOWER + 1e-6) & (x < UPPER - 1e-6)
        values, vectors = np.linalg.eigh(self.fit.information[np.ix_(free, free)])
        floor = 1e-10 * max(values.max(), 1e-300)
        variance = (vectors**2 / np.maximum(values, floor)).sum(1)
        sd = np.full(len(x), np.inf)
        sd[free] = np.where((vectors**2 * (values < floor)).sum(1) > 1e-6, np.inf, np.sqrt(variance))
        return sd


@dataclass(frozen=True)
class FlickerFit:
    """A finished fit.

    frequency_hz, frequency_sd;  groups: with enough events, by location;  shapes: name → total log-likelihood;
    shape: the best of them;  memory_gain: nats by which a reference that fades beats one that does not;
    free, equal: what the data fix of a circuit, contrasts free or known to be equal
    """

    frequency_hz: float
    frequency_sd: float
    windows: tuple[tuple[float, float], ...]
    grid: tuple[int, int]
    groups: tuple[Group, ...]
    shapes: dict[str, float]
    shape: str
    memory_gain: float
    free: Reading
    equal: Reading
    left_out: int
    seconds: float
    inputs_sha256: dict[str, str]

    def as_dict(self) -> dict:
        """The content of flicker.json."""
        settled = all(g.fit.converged for g in self.groups)
        return {
            "status": Status.converged if settled else Status.not_converged,
            "advice": "" if settled else "some groups did not settle: use fewer, larger groups",
            "observation": "phase_table",
            "frequency_hz": {"value": self.frequency_hz, "std": self.frequency_sd, "identified": True},
            "quiet_windows_s": self.windows,
            "shape": self.shape,
            "shapes_log_likelihood": self.shapes,
            "memory_gain_nats": self.memory_gain,
            "groups": [_group(g) for g in self.groups],
            "groups_left_out": self.left_out,
            "parameters": {
                name: {"identified": bool(sd < OPEN_SD), "std_log": sd} for name, sd in self.free.sd.items()
            },
            "fixed_directions": self.free.fixed,
            "blind_directions": self.free.blind,
            "if_contrasts_were_equal": {
                "fixed_directions": self.equal.fixed,
                "blind_directions": self.equal.blind,
                "identified": [name for name, sd in self.equal.sd.items() if sd < OPEN_SD],
            },
            "identified": _fixed_sentences(self),
            "unidentified": _open_sentences(self),
            "disagreements": _disagreements(self),
            "seconds": self.seconds,
            "versions": versions(),
            "inputs_sha256": self.inputs_sha256,
        }


def fit_flicker(
    recording: Recording,
    model: Model,
    *,
    near_hz: float = 120.0,
    grid: tuple[int, int] = (8, 6),
    least_events: int = 300,
    progress: Callable[[str, float], None] | None = None,
) -> FlickerFit:
    """Fit light L0 (1 + m sin(2πft + φ)), or another shape, of free frequency, phase and contrast per group of pixels.

    model: nominal values at which it is computed what one frequency fixes of a circuit (not what is fitted);
    near_hz: expected frequency, within 2 %;  grid: groups across and down the sensor;  least_events: of a group.

    Raises InputError for pooled recordings, too short ones, and when no group has enough events.
    """
    begun = time.perf_counter()
    report = progress or (lambda what, fraction: None)
    events = recording.events
    if recording.pooled:
        raise InputError(f"{recording.name}: pooled events have no pixels; flicker needs each pixel's last event")
    if not (near_hz > 0 and grid[0] >= 1 and grid[1] >= 1):
        raise InputError(f"flicker: expected a frequency above 0 and a grid of at least 1x1, found {near_hz}, {grid}")
    if model.photoreceptor != "second_order" or "source_follower_pole" not in model.effects:
        raise InputError(f"model {model.name}: expected a second-order photoreceptor with a source follower")
    windows = quiet_windows(events)
    report("frequency", 0.05)
    frequency, error = locked_frequency(events, near_hz, windows)
    pixel = np.arange(events.width * events.height)
    column = pixel % events.width * grid[0] // events.width
    row = pixel // events.width * grid[1] // events.height
    tables = {}
    for r in range(grid[1]):
        for c in range(grid[0]):
            table = phase_table(events, (column == c) & (row == r), frequency, windows)
            if table.events >= least_events:
                tables[c, r] = table
    if not tables:
        raise InputError(f"{recording.name}: no group of pixels has {least_events} events in quiet light")
    totals, fits = {}, {}
    for k, shape in enumerate(SHAPES):
        fits[shape] = {}
        for j, (where, table) in enumerate(tables.items()):
            start = fits["sine"][where].x if shape == "deep sine" else None
            fits[shape][where] = fit_group(table, shape, start)
            report(f"groups, {shape}", 0.1 + 0.85 * (k + (j + 1) / len(tables)) / len(SHAPES))
        totals[shape] = float(sum(fit.log_likelihood for fit in fits[shape].values()))
    best = max(totals, key=lambda shape: totals[shape])
    groups = tuple(Group(c, r, table, fits[best][c, r]) for (c, r), table in tables.items())
    perfect = max(
        sum(fit_group(table, shape, fits[shape][where].x, memory=1.0).log_likelihood for where, table in tables.items())
        for shape in SHAPES
    )
    information = [_of_seen(g.fit.information) for g in groups]
    nominal = {**model.values, "diff_cutoff_hz": model.values.get("diff_cutoff_hz", 1e5)}
    level = np.geomspace(10.0, 1000.0, len(groups))
    return FlickerFit(
        frequency,
        error,
        tuple(windows),
        grid,
        groups,
        totals,
        best,
        totals[best] - float(perfect),
        read(frequency, information, nominal, level, equal_contrast=False),
        read(frequency, information, nominal, level, equal_contrast=True),
        grid[0] * grid[1] - len(groups),
        time.perf_counter() - begun,
        input_hashes([recording.source]),
    )


def _of_seen(information: np.ndarray) -> np.ndarray:
    """(4, 4) information on amplitude, ratio, phase and noise, the firing rate and the background left free."""
    seen, other = np.arange(4), np.arange(4, len(information))
    cross = information[np.ix_(seen, other)]
    return information[np.ix_(seen, seen)] - cross @ np.linalg.pinv(information[np.ix_(other, other)]) @ cross.T


def _group(g: Group) -> dict:
    found = {"column": g.column, "row": g.row, "pixels": g.table.pixels, "events": g.table.events,
             "dispersion": g.fit.dispersion}  # fmt: skip
    for name, value, sd in zip(NAMES, g.fit.values.values(), g.sd, strict=True):
        found[name] = {
            "value": value,
            "std": (sd if name in LINEAR else value * sd) if np.isfinite(sd) else None,
            "identified": bool(sd < (0.05 if name == "phase_cycles" else OPEN_SD)),
        }
    return found


def _fixed_sentences(fit: FlickerFit) -> list[str]:
    known = [g for g in fit.groups if g.sd[0] < OPEN_SD and g.sd[2] < 0.05]
    if not known:
        return ["the frequency of the light, and nothing of the circuit: no group is locked well enough"]
    a = np.array([g.fit.values["amplitude_over_on_threshold"] for g in known])
    ratio = np.array([g.fit.values["off_over_on_threshold"] for g in known])
    lag = _lags(known)
    ms = 1e3 / fit.frequency_hz
    return [
        f"amplitude / ON threshold at {fit.frequency_hz:.2f} Hz, per group: {a.min():.2g} to "
        f"{a.max():.2g} in {len(known)} groups",
        f"OFF / ON threshold: {np.median(ratio):.2f} (median over groups; {ratio.min():.2g} to {ratio.max():.2g})",
        f"phase of each group relative to the others: they lag by 0 to {np.ptp(lag):.2f} cycles "
        f"({ms * np.ptp(lag):.2f} ms)",
        "noise / ON threshold of each group, as far as the shape of the noise is right",
    ]


def _open_sentences(fit: FlickerFit) -> list[str]:
    return [
        f"alpha, beta, gamma, sf_cutoff_hz, diff_cutoff_hz: {fit.free.blind} directions of "
        f"{fit.free.blind + fit.free.fixed} unknowns stay blind; one frequency gives one amplitude and "
        f"one phase per group",
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


def _disagreements(fit: FlickerFit) -> list[str]:
    found = []
    worst = max(fit.groups, key=lambda g: g.fit.dispersion)
    typical = float(np.median([g.fit.dispersion for g in fit.groups]))
    if typical > 1.3:
        found.append(
            f"counts scatter {typical:.1f} times more than Poisson about the fit (median; "
            f"{worst.fit.dispersion:.1f} in group "
            f"{worst.column}, {worst.row}): pixels within a group differ; errors are scaled for it"
        )
    order = sorted(fit.shapes, key=lambda s: -fit.shapes[s])
    behind = [
        f"{s!r} is {(fit.shapes[order[0]] - fit.shapes[s]) / max(typical, 1.0):.0f} nats worse" for s in order[1:]
    ]
    found.append(
        f"the light looks like {order[0]!r}: {', '.join(behind)} (over {len(fit.groups)} groups, scatter allowed for)"
    )
    gain = fit.memory_gain / max(typical, 1.0)
    if gain > 10.0:
        memory = np.median([g.fit.values["memory"] for g in fit.groups])
        found.append(
            f"the level of the last event is remembered by {memory:.2f} only (median; 1 is the model's "
            f"comparator, which is "
            f"{gain:.0f} nats worse): a lower cutoff near the flicker's frequency, or events that noise "
            "triggers, would do that, and this recording cannot tell which"
        )
    known = [g for g in fit.groups if g.sd[0] < OPEN_SD and g.sd[2] < 0.05]
    if len(known) > 4:
        lag, a = _lags(known), np.log([g.fit.values["amplitude_over_on_threshold"] for g in known])
        r = float(np.corrcoef(lag, a)[0, 1])
        found.append(
            f"amplitude and lag of groups correlate at r = {r:+.2f}: one pole of varying bandwidth alone "
            f"would give −1; "
            "the rest is contrast that varies over the scene"
        )
        error = float(np.hypot(known[lag.argmax()].sd[2], known[lag.argmin()].sd[2]))
        if np.ptp(lag) > 0.25 + 2.0 * error:
            found.append(
                f"lags differ by {np.ptp(lag):.2f} cycles, more than the 0.25 that one pole can give: "
                "dim pixels need at least two"
            )
    return found
