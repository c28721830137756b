"""Fit a flicker recording: its frequency, then amplitude, phase and noise of every group of pixels."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pixelid.errors import InputError
from pixelid.model.model import Model
from pixelid.parameters.parameter import OPEN_SD
from pixelid.provenance import input_hashes
from pixelid.recordings.recording import Recording
from pixelid.status import Status
from pixelid.tables.fit import standard_errors
from pixelid.tables.flicker.circuit import Reading, read_circuit
from pixelid.tables.flicker.noisy import AT_BOUND, LOWER, SHAPES, UPPER, GroupFit, fit_group
from pixelid.tables.flicker.phases import Lock, PhaseTable, locked_frequency, phase_table, quiet_windows

OPEN_PHASE_CYCLES = 0.05
HIGHEST_HZ = 1e5  # of a lamp, far above what a pixel follows
# Pixels within a group differ: 0.9 to 3.8 in a real recording whose phases and amplitudes repeat from group to group
MAX_DISPERSION = 4.0
LEAST_EVENTS = 300  # of a group


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
        free = (x > LOWER + AT_BOUND) & (x < UPPER - AT_BOUND)
        sd = np.full(len(x), np.inf)
        sd[free] = standard_errors(self.fit.information[np.ix_(free, free)])
        return sd

    @property
    def known(self) -> bool:
        """Whether amplitude and phase are known well enough to be compared with other groups."""
        return bool(self.fit.converged and self.sd[0] < OPEN_SD and self.sd[2] < OPEN_PHASE_CYCLES)


@dataclass(frozen=True)
class FlickerFit:
    """A finished fit.

    lock: onto the light's frequency;  groups: with enough events, by location;  shapes: name → total log-likelihood;
    shape: the best of them;  memory_gain: nats by which a reference that fades beats one that does not;
    free, equal: what the data fix of a circuit, contrasts free or known to be equal
    """

    lock: Lock
    near_hz: float
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

    @property
    def frequency_hz(self) -> float:
        """Of the light."""
        return self.lock.frequency_hz

    @property
    def known(self) -> list[Group]:
        """The groups that can be compared with each other."""
        return [g for g in self.groups if g.known] if self.lock.sure else []

    def judge(self) -> tuple[Status, str]:
        """(status, advice): the worst that is to be stated, and what to do about it."""
        if not self.lock.sure:
            why = f"No light of a frequency within 2 % of {self.near_hz:g} Hz shows in the events: check --frequency."
            return Status.not_identified, why
        verdicts = {}
        if not all(g.fit.converged for g in self.groups):
            verdicts[Status.not_converged] = "Some groups did not come to rest: use fewer, larger groups."
        typical = float(np.median([g.fit.dispersion for g in self.groups]))
        if typical > MAX_DISPERSION:
            verdicts[Status.misfit] = (
                f"Poor fit: scatter {typical:.1f} × Poisson; the light is not of one frequency alone: "
                "check --frequency, and that nothing moves."
            )
        stuck = [
            f"group {g.column}, {g.row}: {', '.join(names)}" for g in self.groups if (names := g.fit.ratios_at_bound)
        ]
        if stuck:
            verdicts[Status.at_bound] = (
                f"On a bound: {'; '.join(stuck[:3])}{f'; and {len(stuck) - 3} more groups' if len(stuck) > 3 else ''}. "
                "These groups show too few events of one polarity: use fewer, larger groups."
            )
        if not self.known:
            verdicts[Status.not_identified] = "No group of pixels is locked to the light: check --frequency."
        status = Status.worst(verdicts)
        return status, verdicts.get(status, "")


def fit_flicker(
    recording: Recording,
    model: Model,
    *,
    near_hz: float = 120.0,
    grid: tuple[int, int] = (8, 6),
    progress: Callable[[str, float], None] | None = None,
) -> FlickerFit:
    """Fit light L0 (1 + m sin(2πft + φ)), or another shape, of free frequency, phase and contrast per group of pixels.

    model: nominal values at which it is computed what one frequency fixes of a circuit (not what is fitted);
    near_hz: expected frequency, within 2 %;  grid: groups across and down the sensor.

    Raises InputError for pooled recordings, too short ones, and when no group has enough events.
    """
    begun = time.perf_counter()
    report = progress or (lambda what, fraction: None)
    events = recording.events
    if recording.pooled:
        raise InputError(f"{recording.name}: pooled events have no pixels; flicker needs each pixel's last event")
    if not (0 < near_hz <= HIGHEST_HZ and min(grid) >= 1):
        raise InputError(
            f"flicker: expected a frequency above 0 and up to {HIGHEST_HZ:g} Hz and a grid of at least 1x1, "
            f"found {near_hz}, {grid}"
        )
    if model.photoreceptor != "second_order" or "source_follower_pole" not in model.effects:
        raise InputError(f"model {model.name}: expected a second-order photoreceptor with a source follower")
    windows = quiet_windows(events, near_hz)
    report("frequency", 0.05)
    lock = locked_frequency(events, near_hz, windows)
    frequency = lock.frequency_hz
    pixel = np.arange(events.width * events.height)
    column = pixel % events.width * grid[0] // events.width
    row = pixel // events.width * grid[1] // events.height
    tables = {}
    for r in range(grid[1]):
        for c in range(grid[0]):
            table = phase_table(events, (column == c) & (row == r), frequency, windows)
            if table.events >= LEAST_EVENTS:
                tables[c, r] = table
    if not tables:
        raise InputError(f"{recording.name}: no group of pixels has {LEAST_EVENTS} events in quiet light")
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
        lock,
        near_hz,
        tuple(windows),
        grid,
        groups,
        totals,
        best,
        totals[best] - float(perfect),
        read_circuit(frequency, information, nominal, level, equal_contrast=False),
        read_circuit(frequency, information, nominal, level, equal_contrast=True),
        grid[0] * grid[1] - len(groups),
        time.perf_counter() - begun,
        input_hashes([recording.source]),
    )


def _of_seen(information: np.ndarray) -> np.ndarray:
    """(4, 4) information on amplitude, ratio, phase and noise, the firing rate and the background left free."""
    seen, other = np.arange(4), np.arange(4, len(information))
    cross = information[np.ix_(seen, other)]
    return information[np.ix_(seen, seen)] - cross @ np.linalg.pinv(information[np.ix_(other, other)]) @ cross.T
