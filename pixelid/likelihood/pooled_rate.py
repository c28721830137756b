"""Pooled-rate likelihood: event counts of many pixels, or of one pixel with many events per edge.

In the fluid limit a pixel whose amplifier output rises at ẏ emits ON events at ẏ/C_on.  N pooled pixels, dead time ρ
and a background b per polarity give

    λ_on = N (ẏ⁺/C_on) / (1 + ρ |ẏ|/C) + b_on        λ_off likewise with ẏ⁻

Where the pixels' light differs (`light_spread`), λ is the mean over pixels of radiance L e^{σ ξ}, ξ standard normal, by
Gauss–Hermite quadrature.

Counts in bins are Poisson about ∫ λ dt.  Within a bin ∫ẏ⁺ is the rise of the output between the bin's edges.

C/N alone is visible without dead time: N is a gauge, `pooled.pixels`, fixed unless stated otherwise.  Real pools are
more variable than Poisson; `dispersion` measures by how much, and errors are scaled by it (quasi-Poisson; McCullagh &
Nelder 1989, section 9.2).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaln

from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.slew import slews, without_slew_limit
from pixelid.dynamics.slewed import slewed
from pixelid.dynamics.trajectory import integrate
from pixelid.errors import InputError
from pixelid.likelihood.clocks import clock_in
from pixelid.parameters.parameter import Parameter
from pixelid.recordings.kept import kept_of
from pixelid.recordings.recording import Recording
from pixelid.stages.circuit import Circuit
from pixelid.stages.differencing import leaked, leaks
from pixelid.statistics import dispersion
from pixelid.stimuli.drive import drive
from pixelid.stimuli.stimulus import Stimulus

BIN_S = 50e-6  # a fraction of the fastest edges' width, 0.2 ms
MOST_BINS = 2_000_000  # a few hundred MB with their derivatives
LIGHTS = 11  # nodes of the spread of light: counts about a jump of it to 1 % (rms) at σ = 0.3, 3 % at 0.6, 9 % at 1
LEAST_EVENTS = 100  # fewer tell a rate to no better than 10 %


@dataclass(frozen=True)
class Counts:
    """Binned events of one recording.  edges: (n+1,) seconds;  on, off: (n,) counts."""

    edges: np.ndarray
    on: np.ndarray
    off: np.ndarray


def binned(recording: Recording, bin_s: float, first_s: float) -> Counts:
    """Counts per bin over the first seconds that both events and stimulus cover, and that a cut has left."""
    assert recording.stimulus is not None
    t = recording.events.t * 1e-9
    cut = kept_of(recording).time_s or (-math.inf, math.inf)
    start = max(recording.stimulus.start_s, cut[0])
    end = min(recording.stimulus.end_s, cut[1], start + first_s)
    n = max(int((end - start) / bin_s), 1)
    edges = start + bin_s * np.arange(n + 1)
    index = np.floor((t - start) / bin_s).astype(np.int64)
    inside = (index >= 0) & (index < n)
    on = recording.events.p == 1
    return Counts(
        edges,
        np.bincount(index[inside & on], minlength=n).astype(float),
        np.bincount(index[inside & ~on], minlength=n).astype(float),
    )


class PooledRate:
    """The pooled-rate likelihood of one or more recordings.

    nuisances: delay per recording, drift of the clock of each that was aligned (`likelihood.clocks`), background per
    polarity, pooled pixels, and for "shape" stimuli the light L = offset + gain · shape, of which `stimulus.offset` is
    fixed (it sets the unit of radiance).

    Args:
        recordings: With a full-field stimulus each.
        bin_s: Width of the bins.
        first_s: How much of each recording to look at.

    Attributes:
        observed: (bins,) counts, per recording ON then OFF.
        kept: (bins,) bool, those that count: all, but of `of_bins`.

    Raises:
        InputError: For a missing or per-pixel stimulus, too many bins, or hardly any events.
    """

    def __init__(self, recordings: Sequence[Recording], bin_s: float = BIN_S, first_s: float = math.inf) -> None:
        self.recordings = tuple(recordings)
        for recording in self.recordings:
            if recording.stimulus is None:
                raise InputError(f"{recording.name}: no stimulus; a fit needs to know what the light did")
            if not recording.stimulus.full_field:
                raise InputError(f"{recording.name}: the pooled fit needs a full-field stimulus")
            if min(recording.stimulus.duration_s, first_s) / bin_s > MOST_BINS:
                raise InputError(f"{recording.name}: more than {MOST_BINS} bins of {bin_s:g} s; use wider bins")
        self.counts = tuple(binned(recording, bin_s, first_s) for recording in self.recordings)
        self.observed = np.concatenate([np.concatenate([c.on, c.off]) for c in self.counts])
        if self.observed.sum() < LEAST_EVENTS:
            raise InputError(f"fewer than {LEAST_EVENTS} events during the stimulus: nothing to fit")
        self._log_factorial = gammaln(self.observed + 1.0)
        self._width = bin_s
        self.kept = np.ones(len(self.observed), dtype=bool)

    @property
    def events(self) -> int:
        """Events counted."""
        return int(self.observed[self.kept].sum())

    def of_bins(self, kept: np.ndarray) -> PooledRate:
        """The same likelihood with only the bins that `kept` (bins,) says counting."""
        part = copy(self)
        part.kept = kept
        return part

    def nuisances(self) -> tuple[Parameter, ...]:
        """The recordings' own parameters, with starting values."""
        rate = self.observed.mean() / self._width
        parameters = [
            Parameter("pooled.background_on_hz", 0.1 * rate, "Hz", 1e-6 * rate, 1e3 * rate, "log"),
            Parameter("pooled.background_off_hz", 0.1 * rate, "Hz", 1e-6 * rate, 1e3 * rate, "log"),
            Parameter("pooled.pixels", 1.0, "pixels", 1e-3, 1e9, "log", free=False),
        ]
        parameters += [
            Parameter(delay_name(self.recordings, i), 0.0, "s", -0.05, 0.05, "linear")
            for i in range(1, len(self.recordings))
        ]
        if any(r.stimulus is not None and r.stimulus.unit == "shape" for r in self.recordings):
            parameters += [
                Parameter("stimulus.offset", 1.0, "radiance", 1e-9, 1e9, "log", free=False),
                Parameter("stimulus.gain", 2.0, "radiance", 0.05, 1e4, "log"),
            ]
        return tuple(parameters)

    def output(self, i: int, circuit: Circuit, values: Mapping[str, float], brighter: float = 1.0) -> np.ndarray:
        """(n+1,) amplifier output at the bin edges of recording i, of pixels whose light is so many times as bright."""
        recording, counts = self.recordings[i], self.counts[i]
        circuit = circuit.in_recording(recording.name)
        stimulus = recording.stimulus
        assert isinstance(stimulus, Stimulus)
        if stimulus.unit == "shape":
            light = values["stimulus.offset"] + values["stimulus.gain"] * stimulus.radiance
            stimulus = Stimulus(stimulus.t, light, "relative", stimulus.interpolation)
        if brighter != 1.0:
            stimulus = replace(stimulus, radiance=brighter * stimulus.radiance)
        until = counts.edges[-1] + 0.1
        shown = stimulus.t <= until
        if not shown.all():
            stimulus = replace(stimulus, t=stimulus.t[shown], radiance=stimulus.radiance[shown])
        if circuit.described:
            raise InputError("described effects: not in the pooled-rate likelihood")
        wave = drive(stimulus, circuit, until)
        if slews(circuit):
            linear = without_slew_limit(circuit)
            trajectory = slewed(wave.t, wave.radiance, circuit, dynamics_of(linear), log_radiance=wave.log_radiance)
        else:
            trajectory = integrate(
                wave.t, wave.radiance, dynamics_of(circuit), linearisation=circuit.linearisation,
                log_radiance=wave.log_radiance,
            )  # fmt: skip
        delay = values[delay_name(self.recordings, i)]
        clock = clock_in(recording, circuit)
        edges = counts.edges if clock is None else clock.on_light(counts.edges)
        states = trajectory.at(np.maximum(edges - delay, wave.t[0]))
        return states[:, 5]

    def expected(self, circuit: Circuit, values: Mapping[str, float]) -> np.ndarray:
        """(bins,) expected counts, per recording ON then OFF."""
        parts = []
        for i in range(len(self.recordings)):
            on_off = np.zeros((2, len(self.counts[i].on)))
            for brighter, share in lights_of(circuit):
                leak = circuit.on_threshold * self._leaked(i, circuit, brighter)
                change = np.diff(self.output(i, circuit, values, brighter)) + leak
                rise, fall = np.maximum(change, 0.0), np.maximum(-change, 0.0)
                on, off = rise / circuit.on_threshold, fall / circuit.off_threshold
                thinning = values["pooled.pixels"] / (1.0 + circuit.refractory * (on + off) / self._width)
                on_off += share * thinning * np.stack([on, off])
            parts.append(on_off[0] + values["pooled.background_on_hz"] * self._width)
            parts.append(on_off[1] + values["pooled.background_off_hz"] * self._width)
        return np.concatenate(parts)

    def _leaked(self, i: int, circuit: Circuit, brighter: float) -> np.ndarray | float:
        """What leaks in each bin of recording i, in ON thresholds, of pixels whose light is so many times as bright."""
        if not leaks(circuit):
            return 0.0
        stimulus, edges = self.recordings[i].stimulus, self.counts[i].edges
        assert isinstance(stimulus, Stimulus)
        light = brighter * np.interp(0.5 * (edges[1:] + edges[:-1]), stimulus.t, stimulus.radiance)
        return leaked(circuit, self._width, self._width * light)

    def log_likelihood(self, expected: np.ndarray) -> float:
        """Poisson log-likelihood of the counts about `expected` (bins,)."""
        return float(self.per_bin(expected)[self.kept].sum())

    def per_bin(self, expected: np.ndarray) -> np.ndarray:
        """(bins,) log-likelihood of each bin, also of those that do not count."""
        return self._relative(expected) - self._log_factorial

    def per_recording(self, expected: np.ndarray) -> np.ndarray:
        """(recordings,) log-likelihood of each, without the constant of its counts, over all bins."""
        ends = np.cumsum([2 * len(c.on) for c in self.counts])
        return np.array([part.sum() for part in np.split(self._relative(expected), ends[:-1])])

    def _relative(self, expected: np.ndarray) -> np.ndarray:
        """(bins,) Poisson log-likelihood without the constant of the count."""
        return self.observed * np.log(expected) - expected

    def dispersion(self, expected: np.ndarray) -> float:
        """Pearson χ² per bin, among bins grouped until each expects at least 5 counts: 1 for Poisson counts."""
        return dispersion(self.observed[self.kept], expected[self.kept])


def lights_of(circuit: Circuit) -> list[tuple[float, float]]:
    """(factor of the light, share of the pixels) of the nodes that stand for pooled pixels."""
    if circuit.light_spread == 0:
        return [(1.0, 1.0)]
    nodes, weights = np.polynomial.hermite_e.hermegauss(LIGHTS)
    factors = np.exp(circuit.light_spread * nodes)
    return list(zip(factors.tolist(), (weights / weights.sum()).tolist(), strict=True))


def delay_name(recordings: Sequence[Recording], i: int) -> str:
    """The name of recording i's delay: "delay_s" for the first, "delay_s[name]" for the others."""
    return "delay_s" if i == 0 else f"delay_s[{recordings[i].name}]"
