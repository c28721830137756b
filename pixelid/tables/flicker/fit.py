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
from pixelid.tables.fit import MOST_SUSPECT, standard_errors
from pixelid.tables.flicker.circuit import Reading, read_circuit
from pixelid.tables.flicker.noisy import PHASES, GroupFit, fit_group
from pixelid.tables.flicker.phases import Lock, PhaseTable, locked_frequency, phase_table, quiet_windows
from pixelid.tables.flicker.waveforms import HARMONICS, WAVEFORMS, Waveform, as_harmonics, harmonics

OPEN_PHASE_CYCLES = 0.05
# Pixels within a group differ: 0.9 to 3.8 in a real recording whose phases and amplitudes repeat from group to group
MAX_DISPERSION = 4.0
LEAST_EVENTS = 300  # of a group

Fits = dict[tuple[int, int], GroupFit]  # by (column, row) of the group


@dataclass(frozen=True)
class Group:
    """One group of pixels: where it is (column, row of the grid), its data and its fit."""

    column: int
    row: int
    table: PhaseTable
    fit: GroupFit

    @property
    def sd(self) -> np.ndarray:
        """(coordinates,) standard errors of the fit's, inf where open; those on a bound are held, and inf."""
        free = self.fit.free
        sd = np.full(len(free), np.inf)
        sd[free] = standard_errors(self.fit.information[np.ix_(free, free)])
        return sd

    @property
    def known(self) -> bool:
        """Whether amplitude and phase are known well enough to be compared with other groups."""
        return bool(self.fit.converged and self.sd[0] < OPEN_SD and self.sd[2] < OPEN_PHASE_CYCLES)


@dataclass(frozen=True)
class FlickerFit:
    """A finished fit.

    lock: onto the light's frequency;  groups: with enough events, by location;
    shapes: waveform → total log-likelihood;  gains: of `waveform_gains`;
    shape: the best of them;  pulses: the groups as pulses behind one pole;
    memory_gain: nats by which a reference that fades beats one that does not;
    free, equal: what the data fix of a circuit, contrasts free or known to be equal
    """

    lock: Lock
    near_hz: float
    windows: tuple[tuple[float, float], ...]
    grid: tuple[int, int]
    groups: tuple[Group, ...]
    shapes: dict[str, float]
    gains: dict[str, float]
    shape: str
    pulses: tuple[Group, ...]
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
        poor = sorted((g for g in self.groups if g.fit.dispersion > MAX_DISPERSION), key=lambda g: -g.table.events)
        share = sum(g.table.events for g in poor) / sum(g.table.events for g in self.groups)
        if share > MOST_SUSPECT:
            named = "; ".join(f"{g.column}, {g.row}: {g.fit.dispersion:.1f}" for g in poor[:3])
            more = f"; and {len(poor) - 3} more" if len(poor) > 3 else ""
            verdicts[Status.misfit] = (
                f"Poor fit in {len(poor)} of {len(self.groups)} groups, with {share:.0%} of the events (scatter over "
                f"Poisson's in group {named}{more}): their pixels differ, or something moves. Use smaller groups, and "
                "check --frequency."
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
        stated = dict.fromkeys((status, Status.misfit))  # a poor fit is stated whatever else is wrong
        return status, " ".join(verdicts[one] for one in stated if one in verdicts)


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
    highest_hz = 1e5  # of a lamp, far above what a pixel follows
    if not (0 < near_hz <= highest_hz and min(grid) >= 1):
        raise InputError(
            f"flicker: expected a frequency above 0 and up to {highest_hz:g} Hz and a grid of at least 1x1, "
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

    def fitted(waveform: Waveform, begin: Callable[[GroupFit], list[np.ndarray]], of: Fits, share: float) -> Fits:
        found = {}
        for j, (where, table) in enumerate(tables.items()):
            found[where] = fit_group(table, waveform, begin(of[where]) if of else ())
            report(f"groups, {waveform.name}", share + (j + 1) / len(tables) / (len(WAVEFORMS) + len(HARMONICS) + 1))
        return found

    fits: dict[str, Fits] = {}
    for waveform in WAVEFORMS.values():
        alike = fits["sine"] if waveform.name == "deep sine" else {}
        fits[waveform.name] = fitted(waveform, _at_phases, alike, 0.1 + 0.8 * len(fits) / 8)
    closest, gained = _likeliest(fits), -np.inf
    for order in HARMONICS:
        free, of = harmonics(order), fits[closest]
        fits[free.name] = fitted(
            free, lambda fit, order=order: [_free_start(fit, order)], of, 0.1 + 0.8 * len(fits) / 8
        )
        if waveform_gains(fits)[free.name] <= gained:
            break
        gained = waveform_gains(fits)[free.name]
    best = _likeliest(fits)
    gains = waveform_gains(fits)
    groups, pulses = (
        tuple(Group(c, r, table, fits[name][c, r]) for (c, r), table in tables.items()) for name in (best, "pulse")
    )
    perfect = sum(fit_group(g.table, g.fit.waveform, [g.fit.x], memory=1.0).log_likelihood for g in groups)
    totals = {name: float(sum(fit.log_likelihood for fit in of.values())) for name, of in fits.items()}
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
        gains,
        best,
        pulses,
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


def _at_phases(fit: GroupFit) -> list[np.ndarray]:
    """Where a similar waveform's fit begins: at a fit's coordinates, of which the phase is doubted."""
    return [fit.x + shift * np.eye(len(fit.x))[2] for shift in PHASES]


def _free_start(fit: GroupFit, order: int) -> np.ndarray:
    """A fit's coordinates with its waveform as harmonics."""
    lag, numbers = as_harmonics(fit.waveform.fine(fit.x[8:]), order)
    return np.concatenate([fit.x[:8] + lag * np.eye(8)[2], numbers])


def _likeliest(fits: dict[str, Fits]) -> str:
    """The waveform that explains the groups best, its numbers paid for."""
    gains = waveform_gains(fits)
    return max(gains, key=lambda name: gains[name])


def waveform_gains(fits: dict[str, Fits]) -> dict[str, float]:
    """Waveform → nats by which it beats the first: counts scatter as about the likeliest of all, and each number of its
    own costs half the logarithm of a group's events (Schwarz 1978, Ann. Stat. 6, 461)."""
    gains = dict.fromkeys(fits, 0.0)
    first = next(iter(fits.values()))
    for where, of in first.items():
        scatter = max(max((fit[where] for fit in fits.values()), key=lambda fit: fit.log_likelihood).dispersion, 1.0)
        price = 0.5 * np.log(max(float(of.expected.sum()), 2.0))
        for name, fit in fits.items():
            nats = (fit[where].log_likelihood - of.log_likelihood) / scatter
            gains[name] += float(nats - price * len(fit[where].waveform.numbers))
    return gains
