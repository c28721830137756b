"""Pooled-rate likelihood: event counts of N pixels whose addresses are not known.

The expected count of a bin is N times that of one pixel (`likelihood/pool.py`: dead time, thresholds and their noise),
averaged over the kinds of pixel in the pool (`kinds_of`: mismatch, spread of light), queued where one arbiter serves
them all, plus a background b per polarity.  In the limit of many small thresholds and no dead time that is the fluid
rate

    λ_on = N max(ẏ, 0)/C_on        λ_off = N max(−ẏ, 0)/C_off

in which only N/C shows.  N shows in bursts, in the dead time's ceiling N/ρ, and in the phase of the next event.

Counts scatter less than Poisson's where few events make a ramp: every pixel fires once, sooner or later.  Their
variance v comes from the same chain, and the likelihood of a bin is Poisson's to the power μ/v (quasi-likelihood;
McCullagh & Nelder 1989, chapter 9), with v at a model nearby (`PooledRate.near`), so that two models are compared by
the same measure.
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
from pixelid.dynamics.trajectory import Trajectory, integrate
from pixelid.errors import InputError
from pixelid.likelihood.clocks import clock_in
from pixelid.likelihood.pool import Comparator, divide, flow, places, queued, signals
from pixelid.likelihood.pool_kinds import KINDS, Kind, kinds_of, lights_of
from pixelid.parallel import map_threads
from pixelid.parameters.parameter import Parameter
from pixelid.recordings.kept import kept_of
from pixelid.recordings.recording import Recording
from pixelid.stages.circuit import Circuit
from pixelid.stages.differencing import leaked, leaks
from pixelid.stimuli.drive import drive
from pixelid.stimuli.stimulus import Stimulus

BIN_S = 50e-6  # a fraction of the fastest edges' width, 0.2 ms
MOST_BINS = 2_000_000  # a few hundred MB with their derivatives
# A count that the chain calls nearly certain still depends on what moves all pixels alike: a twentieth of Poisson's
# variance is a clock or a step that is off by 5 % of a bin in a burst.
LEAST_RATIO = 0.05
ROUGH, ROUGH_KINDS = 3.0, 6  # steps so much longer, and kinds of pixel, where derivatives are taken
LEAST_VARIANCE = 1e-4  # of a bin, per pixel: no threshold is normal so far out in its tail
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
        kinds: How many kinds of pixel stand for the pool where pixels differ.

    Attributes:
        observed: (bins,) counts, per recording ON then OFF.
        kept: (bins,) bool, those that count: all, but of `of_bins`.
        ratio: (bins,) variance over mean of counts: 1, but of `near`.
        rough: The same with longer steps and fewer kinds of pixel, for derivatives; None, but of `near`.
        steps: Per recording (bins,) steps of the forward pass, but for a new likelihood: then they suit each model.

    Raises:
        InputError: For a missing or per-pixel stimulus, too many bins, or hardly any events.
    """

    def __init__(
        self, recordings: Sequence[Recording], bin_s: float = BIN_S, first_s: float = math.inf, kinds: int = KINDS
    ) -> None:
        self._kinds, self._coarse, self._blur, self._fluid = kinds, 1.0, 0.0, False
        self.rough: PooledRate | None = None
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
        self.ratio = np.ones(len(self.observed))
        self.steps: tuple[np.ndarray, ...] | None = None

    @property
    def events(self) -> int:
        """Events counted."""
        return int(self.observed[self.kept].sum())

    def of_bins(self, kept: np.ndarray) -> PooledRate:
        """The same likelihood with only the bins that `kept` (bins,) says counting."""
        part = copy(self)
        part.kept = kept
        return part

    def without_rough(self) -> PooledRate:
        """The same likelihood whose derivatives are its own."""
        part = copy(self)
        part.rough = None
        return part

    def fluid(self) -> PooledRate:
        """The limit of many small thresholds: no pixel remembers its last event, so optima are few and wide."""
        part = copy(self)
        part._fluid = True
        return part

    def near(
        self, circuit: Circuit, values: Mapping[str, float], scatter: bool = True, blur: float = 0.0
    ) -> PooledRate:
        """The same likelihood with the steps and the variances of counts that suit models near this one.

        Args:
            circuit, values: The model.
            scatter: False: Poisson's variances, for a model that may be far from the truth and certain of what is
                wrong.
            blur: Noise of thresholds added, relative.  Pixels in step make a comb of events that fits a threshold at
                every tooth; a blurred pool shows their rate, whose optimum is near the right tooth.
        """
        if self._fluid:
            return self
        part = copy(self)
        part._blur = blur
        rough = copy(part)
        part.steps = tuple(part._steps(i, circuit, values) for i in range(len(self.recordings)))
        rough._kinds, rough._coarse = min(ROUGH_KINDS, self._kinds), ROUGH
        rough.steps = tuple(rough._steps(i, circuit, values) for i in range(len(self.recordings)))
        part.rough = rough
        part.ratio = np.ones(len(self.observed))
        if not scatter:
            return part
        mean, variance = part.moments(circuit, values)
        least = LEAST_VARIANCE * values["pooled.pixels"]
        part.ratio = np.maximum(np.maximum(variance, least) / mean, LEAST_RATIO)
        return part

    def nuisances(self) -> tuple[Parameter, ...]:
        """The recordings' own parameters, with starting values."""
        rate = self.observed.mean() / self._width
        parameters = [
            Parameter("pooled.background_on_hz", 0.01 * rate, "Hz", 1e-6 * rate, 1e3 * rate, "log"),
            Parameter("pooled.background_off_hz", 0.01 * rate, "Hz", 1e-6 * rate, 1e3 * rate, "log"),
            Parameter("pooled.pixels", 1.0, "pixels", 0.1, 1e9, "log"),
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
        trajectory = self._trajectory(i, circuit, values, brighter)
        return self._at(i, trajectory, self.counts[i].edges, circuit, values)[1]

    def moments(self, circuit: Circuit, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """(mean, variance), (bins,) each, of the counts, per recording ON then OFF."""
        if circuit.described:
            raise InputError("described effects: not in the pooled-rate likelihood")
        parts = [self._moments(i, circuit, values) for i in range(len(self.recordings))]
        return np.concatenate([mean.ravel() for mean, _ in parts]), np.concatenate([v.ravel() for _, v in parts])

    def expected(self, circuit: Circuit, values: Mapping[str, float]) -> np.ndarray:
        """(bins,) expected counts, per recording ON then OFF."""
        return self.moments(circuit, values)[0]

    def _moments(self, i: int, circuit: Circuit, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """(mean, variance), (2, n) each, of recording i."""
        if self._fluid:
            return self._fluid_moments(i, circuit, values)
        steps = self._steps(i, circuit, values) if self.steps is None else self.steps[i]
        circuit = circuit.in_recording(self.recordings[i].name)
        pixels, warm_up = values["pooled.pixels"], self._warm_up(i)
        times = self.counts[i].edges[0] + self._width * (places(steps) - warm_up)
        if self._blur > 0:  # so much noise hides from which pixel it comes
            noise = math.hypot(circuit.noise, circuit.mismatch, self._blur)
            circuit = replace(circuit, noise=noise, mismatch=0.0)
        kinds = kinds_of(circuit, self._kinds)
        shared = {
            light: signals(steps, *self._at(i, self._trajectory(i, circuit, values, light), times, circuit, values))
            for light in {kind.light for kind in kinds}
        }
        flows = map_threads(lambda kind: flow(shared[kind.light], self._comparator(circuit, kind)), kinds)
        shares, kept = np.array([kind.share for kind in kinds]), 1.0 - circuit.lost
        events = kept * np.tensordot(shares, np.stack([events for events, _ in flows]), axes=1)
        twice = kept**2 * np.tensordot(shares, np.stack([twice for _, twice in flows]), axes=1)
        if circuit.service > 0:
            events = queued(events * pixels, times, circuit.service) / pixels
        first = np.cumsum(steps) - steps
        mean = np.add.reduceat(events, first, axis=1)[:, warm_up:]
        variance = np.maximum(twice[:, warm_up:] + mean - mean**2, 0.0)
        background = self.background(i, values).reshape(2, -1)
        return pixels * mean + background, pixels * variance + background

    def _fluid_moments(self, i: int, circuit: Circuit, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """As `_moments`: changes in thresholds, thinned by the dead time of those in the same bin."""
        mean = self.background(i, values).reshape(2, -1).copy()
        for light, share in lights_of(circuit):
            change = np.diff(self.output(i, circuit, values, light))
            on, off = np.maximum(change, 0.0) / circuit.on_threshold, np.maximum(-change, 0.0) / circuit.off_threshold
            thinned = share * values["pooled.pixels"] / (1.0 + circuit.refractory * (on + off) / self._width)
            mean += np.stack([thinned * on, thinned * off])
        return mean, mean

    def _comparator(self, circuit: Circuit, kind: Kind) -> Comparator:
        width = self._width
        return Comparator(
            float(circuit.on_threshold * kind.on), float(circuit.off_threshold * kind.off),
            float(circuit.noise),
            float(circuit.polarity_memory), float(circuit.threshold_drift * width), float(circuit.refractory / width),
            float(max(circuit.silent - circuit.refractory, 0.0) / width), float(min(circuit.differencing * width, 1e9)),
        )  # fmt: skip

    def _warm_up(self, i: int) -> int:
        """Bins of recording i from the beginning of the light to the first that counts."""
        stimulus = self.recordings[i].stimulus
        assert isinstance(stimulus, Stimulus)
        return max(math.ceil((self.counts[i].edges[0] - stimulus.start_s) / self._width - 1e-6), 0)

    def _steps(self, i: int, circuit: Circuit, values: Mapping[str, float]) -> np.ndarray:
        """(bins,) steps of the forward pass through recording i that suit a model."""
        circuit = circuit.in_recording(self.recordings[i].name)
        n = self._warm_up(i) + len(self.counts[i].on)
        edges = self.counts[i].edges[-1] + self._width * np.arange(-n, 1)
        level, output = self._at(i, self._trajectory(i, circuit, values), edges, circuit, values)
        noise = min(circuit.on_threshold, circuit.off_threshold) * max(
            math.hypot(circuit.noise, circuit.mismatch, self._blur), 1e-2
        )
        return divide(level, output, self._coarse * noise, min(circuit.differencing * self._width, 1e9))

    def _trajectory(self, i: int, circuit: Circuit, values: Mapping[str, float], brighter: float = 1.0) -> Trajectory:
        """The signals of recording i under a light so many times as bright."""
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
        wave = drive(stimulus, circuit, until)
        if slews(circuit):
            linear = without_slew_limit(circuit)
            return slewed(wave.t, wave.radiance, circuit, dynamics_of(linear), log_radiance=wave.log_radiance)
        return integrate(
            wave.t, wave.radiance, dynamics_of(circuit), linearisation=circuit.linearisation,
            log_radiance=wave.log_radiance,
        )  # fmt: skip

    def _at(
        self, i: int, trajectory: Trajectory, times: np.ndarray, circuit: Circuit, values: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """(reset level, amplifier output) at times (m,) of recording i, with what leaks into the change."""
        delay, clock = values[delay_name(self.recordings, i)], clock_in(self.recordings[i], circuit)
        on_light = (times if clock is None else clock.on_light(times)) - delay
        on_light = np.maximum(on_light, trajectory.t[0])
        step = np.maximum(np.searchsorted(trajectory.t, on_light, side="right") - 1, 0)
        level, output = trajectory.outputs_at(on_light, step)
        if leaks(circuit):
            light = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(on_light) * (self._light(i, on_light)))])
            drift = circuit.on_threshold * leaked(circuit, on_light - on_light[0], light)
            level, output = level + drift, output + drift
        return level, output

    def _light(self, i: int, times: np.ndarray) -> np.ndarray:
        """(m − 1,) sum of the radiance at both ends of each interval between times (m,) of the light."""
        stimulus = self.recordings[i].stimulus
        assert isinstance(stimulus, Stimulus)
        light = np.interp(times, stimulus.t, stimulus.radiance)
        return light[1:] + light[:-1]

    def linear_parts(self, expected: np.ndarray, values: Mapping[str, float]) -> dict[str, np.ndarray]:
        """By name, (bins,) of the `expected` counts what grows in proportion to a nuisance, where none queue."""
        on, off = [], []
        for i, counts in enumerate(self.counts):
            background, n = self.background(i, values), len(counts.on)
            on += [background[:n], np.zeros(n)]
            off += [np.zeros(n), background[n:]]
        backgrounds = {"pooled.background_on_hz": np.concatenate(on), "pooled.background_off_hz": np.concatenate(off)}
        return {**backgrounds, "pooled.pixels": expected - sum(backgrounds.values())}

    def background(self, i: int, values: Mapping[str, float]) -> np.ndarray:
        """(2 n,) expected background in the bins of recording i, ON then OFF."""
        rates = np.array([values["pooled.background_on_hz"], values["pooled.background_off_hz"]])
        return np.repeat(self._width * rates, len(self.counts[i].on))

    def on_recording(self, i: int, t: np.ndarray, values: Mapping[str, float], circuit: Circuit) -> np.ndarray:
        """(m,) times of recording i at times t (m,) of its light."""
        clock = clock_in(self.recordings[i], circuit)
        t = t + values[delay_name(self.recordings, i)]
        return t if clock is None else (t - clock.slope * clock.at_s) / (1.0 - clock.slope)

    def log_likelihood(self, expected: np.ndarray) -> float:
        """Quasi log-likelihood of the counts about `expected` (bins,)."""
        return float(self.per_bin(expected)[self.kept].sum())

    def per_bin(self, expected: np.ndarray) -> np.ndarray:
        """(bins,) log-likelihood of each bin, also of those that do not count."""
        return self._relative(expected) - self._log_factorial / self.ratio

    def per_recording(self, expected: np.ndarray) -> np.ndarray:
        """(recordings,) log-likelihood of each, without the constant of its counts, over all bins."""
        ends = np.cumsum([2 * len(c.on) for c in self.counts])
        return np.array([part.sum() for part in np.split(self._relative(expected), ends[:-1])])

    def _relative(self, expected: np.ndarray) -> np.ndarray:
        """(bins,) quasi log-likelihood without the constant of the count."""
        return (self.observed * np.log(expected) - expected) / self.ratio

    def dispersion(self, expected: np.ndarray) -> float:
        """Mean χ² of cells: 1 where counts vary about `expected` as `ratio` says.

        Cells are bins, those of less variance than 1 gathered in order until it is 1.
        """
        off, variance = (self.observed - expected)[self.kept], (expected * self.ratio)[self.kept]
        cell = np.floor(np.cumsum(np.minimum(variance, 1.0))).astype(np.int64)
        off, variance = np.bincount(cell, off), np.bincount(cell, variance)
        whole = variance >= 0.5
        return float(np.mean(off[whole] ** 2 / variance[whole])) if whole.any() else 1.0


def delay_name(recordings: Sequence[Recording], i: int) -> str:
    """The name of recording i's delay: "delay_s" for the first, "delay_s[name]" for the others."""
    return "delay_s" if i == 0 else f"delay_s[{recordings[i].name}]"
