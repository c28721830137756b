"""Pooled-rate likelihood: event counts of N pixels whose addresses are not known.

The expected count of a bin is N times that of one pixel (`likelihood/pool.py`: dead time, thresholds and their noise),
averaged over the kinds of pixel in the pool (`kinds_of`: mismatch, spread of light), queued where one arbiter serves
them all, plus a background b per polarity.  A readout that takes all pixels that wait in one cycle makes them wait for
each other: when cycles began and how many events each had is taken from what came before (`pool_read.py`).  The
end of the one under way is known to its spread only, so those that wait fall into one bin or the next all together,
which adds to the variance.  In the limit of many small thresholds and no dead time that is the fluid
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
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaln, ndtr

from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.slew import slews, without_slew_limit
from pixelid.dynamics.slewed import slewed
from pixelid.dynamics.trajectory import Trajectory, integrate
from pixelid.errors import InputError
from pixelid.likelihood.clocks import clock_in
from pixelid.likelihood.pool import Comparator, divide, flow, places, queued, signals
from pixelid.likelihood.pool_kinds import KINDS, Kind, kinds_of, lights_of
from pixelid.likelihood.pool_read import Cycles, Pool, read_flow
from pixelid.parallel import map_threads
from pixelid.parameters.parameter import Parameter
from pixelid.recordings.bursts import bursts_of, cycles
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
LONGEST_BETWEEN_CYCLES = 0.5  # step, in bins
FAR = 5.0  # standard deviations from its expected end that a cycle may end
LEAST_EVENTS = 100  # fewer tell a rate to no better than 10 %


@dataclass(frozen=True)
class Counts:
    """Binned events of one recording.  edges: (n+1,) seconds;  on, off: (n,) counts."""

    edges: np.ndarray
    on: np.ndarray
    off: np.ndarray


@dataclass(frozen=True)
class Read:
    """The cycles of a shared readout in one recording.  begun_s: (cycles,) first stamps;  size: (cycles,) events"""

    begun_s: np.ndarray
    size: np.ndarray


def binned(recording: Recording, bin_s: float, first_s: float, read: Read | None = None) -> Counts:
    """Counts per bin over the first seconds that both events and stimulus cover, and that a cut has left.

    Before the light first changes a pixel at rest is silent, and what comes is of a light before: it is not counted.
    read: by a shared readout, whose events count when their cycle begins: it stamps them row by row
    """
    assert recording.stimulus is not None
    t = recording.events.t * 1e-9 if read is None else np.repeat(read.begun_s, read.size)
    cut = kept_of(recording).time_s or (-math.inf, math.inf)
    light = recording.stimulus
    start = max(_first_change_s(light) if isinstance(light, Stimulus) else light.start_s, cut[0])
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
        cycles: Per recording those of a shared readout; None where its events show none.
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
        self.cycles = tuple(map(_cycles_of, self.recordings))
        self.counts = tuple(
            binned(recording, bin_s, first_s, read)
            for recording, read in zip(self.recordings, self.cycles, strict=True)
        )
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
        if self.cycles[i] is not None:
            return self._read_moments(i, circuit, values, kinds, places(steps))
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

    def _read_moments(
        self, i: int, circuit: Circuit, values: Mapping[str, float], kinds: Sequence[Kind], place: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """As `_moments`, of pixels that share a readout; place: (n + 1,) times in bins, of which more are made."""
        cycles, warm_up = self.cycles[i], self._warm_up(i)
        assert cycles is not None
        if circuit.polarity_memory != 0.0 or circuit.silent > circuit.refractory:
            raise InputError(
                "shared_readout: pooled counts do not know it with polarity_memory or a silence after events"
            )
        bins = warm_up + len(self.counts[i].on)
        begun = (cycles.begun_s - self.counts[i].edges[-1]) / self._width + bins
        inside = (begun >= 0.0) & (begun < bins)
        begun, size = begun[inside], cycles.size[inside].astype(float)
        lasts = (circuit.per_cycle + circuit.per_event * size) / self._width
        released = begun + circuit.refractory / self._width
        place = np.unique(np.concatenate([place, begun, released[released < bins]]))
        times = self.counts[i].edges[0] + self._width * (place - warm_up)
        lights = sorted({kind.light for kind in kinds})
        seen = [self._at(i, self._trajectory(i, circuit, values, light), times, circuit, values) for light in lights]
        level, output = (np.ascontiguousarray(part) for part in np.stack(seen, axis=1))
        pixels, background = values["pooled.pixels"], self.background(i, values).reshape(2, -1)
        pool = Pool(
            np.array([circuit.on_threshold * kind.on for kind in kinds]),
            np.array([circuit.off_threshold * kind.off for kind in kinds]),
            np.array([kind.share for kind in kinds]),
            np.array([lights.index(kind.light) for kind in kinds]),
            float(circuit.noise), float(circuit.threshold_drift * self._width),
            float(min(circuit.differencing * self._width, 1e9)), float(pixels), float(background[:, 0].sum()),
        )  # fmt: skip
        read = Cycles(
            np.searchsorted(place, begun), np.searchsorted(place, np.minimum(released, bins)), begun + lasts, size
        )
        events, held = read_flow(place, level, output, pool, read)
        kept, at_once = 1.0 - circuit.lost, np.minimum(place[:-1].astype(np.int64), bins - 1)
        mean = np.stack([np.bincount(at_once, kept * part, bins) for part in events])
        less, together = np.zeros_like(mean), np.zeros_like(mean)
        for at, chance in _falls(read.ends, circuit.cycle_spread * lasts, bins):
            for polarity in (0, 1):
                part = kept * held[polarity] * chance
                mean[polarity] += np.bincount(at, part, bins)
                less[polarity] += np.bincount(at, part**2, bins)
                together[polarity] += np.bincount(at, (kept * held[polarity]) ** 2 * chance * (1.0 - chance), bins)
        mean, variance = mean[:, warm_up:], (mean - less + max(pixels - 1.0, 0.0) * together)[:, warm_up:]
        return pixels * mean + background, pixels * np.maximum(variance, 0.0) + background

    def _fluid_moments(self, i: int, circuit: Circuit, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """As `_moments`: changes in thresholds, thinned by the dead time of those in the same bin."""
        mean = self.background(i, values).reshape(2, -1).copy()
        for light, share in lights_of(circuit):
            change = np.diff(self.output(i, circuit, values, light))
            on, off = np.maximum(change, 0.0) / circuit.on_threshold, np.maximum(-change, 0.0) / circuit.off_threshold
            dead = circuit.refractory + circuit.per_cycle + circuit.per_event * values["pooled.pixels"]
            thinned = share * values["pooled.pixels"] / (1.0 + dead * (on + off) / self._width)
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
        longest = 1.0 if self.cycles[i] is None else LONGEST_BETWEEN_CYCLES
        return divide(level, output, self._coarse * noise, min(circuit.differencing * self._width, 1e9), longest)

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


def _first_change_s(light: Stimulus) -> float:
    """When light that stays from sample to sample first changes; its beginning, of other light."""
    change = np.flatnonzero(np.diff(light.radiance))
    held = light.interpolation == "previous" and len(change) > 0
    return float(light.t[change[0] + 1]) if held else light.start_s


def _cycles_of(recording: Recording) -> Read | None:
    """What the events of a recording show of a shared readout; None where they show none."""
    bursts = bursts_of(recording)
    if bursts.cycle is None:
        return None
    begun, size = cycles(recording.events.t, bursts.wait_ns)
    return Read(begun * 1e-9, size)


def _falls(ends: np.ndarray, spread: np.ndarray, bins: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(bin, chance to end there), (cycles,) each, for every bin about the one where a cycle is expected to end.

    ends, spread: (cycles,) in bins, of a normal distribution
    """
    if not len(ends):
        return
    at = np.floor(ends)
    reach = math.ceil(FAR * float(spread.max())) + 1
    spread = np.maximum(spread, 1e-9)
    below = ndtr((at - reach - ends) / spread)
    for step in range(-reach, reach + 1):
        above = ndtr((at + step + 1 - ends) / spread)
        yield np.clip(at + step, 0, bins - 1).astype(np.int64), above - below
        below = above


def delay_name(recordings: Sequence[Recording], i: int) -> str:
    """The name of recording i's delay: "delay_s" for the first, "delay_s[name]" for the others."""
    return "delay_s" if i == 0 else f"delay_s[{recordings[i].name}]"
