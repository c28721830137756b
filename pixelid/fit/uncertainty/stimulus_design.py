"""What a set of stimuli cannot identify, whatever the events say (docs/model.md, "Invariants")."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.recordings.recording import Recording
from pixelid.stimuli.pixel_lights import Light, pixel_lights
from pixelid.stimuli.stimulus import Stimulus

ONE_LEVEL = 1.5  # mean levels within this factor count as one
STRETCH = 0.7  # of ln L, 5 to 95 %: stimuli that stay within it are gentle
ONE_LINE = 0.9  # share of the power of ln L near one frequency and its harmonics
SAMPLES = 1 << 14
LIGHTS = 16  # of pixels' own, that are looked at


@dataclass(frozen=True)
class Design:
    """levels: mean radiance of each recording, sorted;  stretch: 5 to 95 % range of ln L over all of them
    frequency_hz: the only frequency of the modulated ones, None when there are more;  shape: light in unknown units
    """

    levels: tuple[float, ...]
    stretch: float
    frequency_hz: float | None
    shape: bool

    @property
    def one_level(self) -> bool:
        """Whether every recording has about the same mean radiance."""
        return not self.shape and self.levels[-1] < ONE_LEVEL * self.levels[0]

    @property
    def one_frequency(self) -> bool:
        """Whether all the modulation is one sine."""
        return self.frequency_hz is not None

    @property
    def poor(self) -> bool:
        """Whether curvature at the optimum alone must not be trusted."""
        return self.one_level or self.one_frequency


def design_of(recordings: Sequence[Recording]) -> Design:
    """The design of recordings; lights of pixels' own count as a recording each."""
    levels, ranges, lines = [], [], []
    shape = False
    for recording in recordings:
        stimulus = recording.stimulus
        if stimulus is None:
            continue
        if stimulus.unit == "shape":
            shape = True
            continue
        for light in _lights(stimulus, recording.events.pixel):
            t = np.linspace(light.t[0], light.t[-1], SAMPLES)
            u = np.interp(t, light.t, np.log(light.radiance))
            levels.append(float(np.exp(u.mean())))
            ranges.append(np.quantile(u, [0.05, 0.95]))
            if u.std() > 1e-3:
                lines.append(_line(u, light.duration_s))
    frequency = None
    if lines and all(line is not None for line in lines) and max(lines) < 1.05 * min(lines):
        frequency = float(np.mean(lines))
    stretch = float(max(r[1] for r in ranges) - min(r[0] for r in ranges)) if ranges else np.inf
    return Design(tuple(sorted(levels)) or (1.0,), stretch, frequency, shape)


def _lights(stimulus: Light, pixels: np.ndarray) -> Sequence[Stimulus]:
    """The light of a recording, of each pixel's own that of some pixels: those show what one of all would."""
    grouped = pixel_lights(stimulus, pixels)
    if grouped is None:
        return (stimulus,)  # pyright: ignore[reportReturnType]
    return grouped.lights[:: -(-len(grouped.lights) // LIGHTS)]


def _line(u: np.ndarray, duration_s: float) -> float | None:
    """The frequency [Hz] of u when nearly all its power lies at it and its harmonics, else None."""
    power = np.abs(np.fft.rfft((u - u.mean()) * np.hanning(len(u)))) ** 2
    power[:2] = 0.0
    peak = int(power[: len(power) // 2].argmax())
    bins = np.arange(len(power))
    nearest = np.maximum(np.round(bins / peak), 1) * peak if peak else np.full(len(power), -9)
    share = power[(np.abs(bins - nearest) <= 2) & (nearest <= 5 * peak)].sum() / power.sum()
    return peak / duration_s if share > ONE_LINE and peak >= 2 and 5 * peak > 5 * 4 else _slow(u, peak, duration_s)


def _slow(u: np.ndarray, peak: int, duration_s: float) -> float | None:
    """The same for so few cycles that harmonics cannot be distinguished from neighbours: a sine fitted in time."""
    if peak == 0 or peak > 6:
        return None
    u = u[:: len(u) // 512]  # three harmonics of seven cycles: 24 samples for the shortest
    phase = 2 * np.pi * np.linspace(0.0, 1.0, len(u))
    best, frequency_hz = 0.0, None
    for cycles in np.linspace(max(peak - 1, 0.5), peak + 1, 41):
        columns = [np.ones(len(u))]
        for harmonic in (1, 2, 3):
            columns += [np.sin(harmonic * cycles * phase), np.cos(harmonic * cycles * phase)]
        J = np.stack(columns, axis=1)
        left = u - J @ np.linalg.lstsq(J, u, rcond=None)[0]
        share = 1.0 - left.var() / u.var()
        if share > best:
            best, frequency_hz = share, cycles / duration_s
    return float(frequency_hz) if frequency_hz is not None and best > 0.99 else None


def caveats(design: Design, values: Mapping[str, float], free: Collection[str]) -> list[str]:
    """What the design leaves open of the free parameters, one sentence each."""
    sentences = []
    second_order = {"alpha", "beta", "gamma"} <= set(free)
    if design.one_level and second_order:
        level = float(np.exp(np.mean(np.log(design.levels))))
        how = "gently modulated, " if design.stretch < STRETCH else ""
        sentences.append(
            f"one radiance level ({level:.3g}, {how}mean of every recording): the data see alpha·L and beta + gamma·L, "
            "and separate alpha, beta and gamma only by how the response bends with the modulation; record a second "
            "level, a factor 10 away"
        )
        if "sf_cutoff_hz" in free:
            sentences.append(_exchange(values, level))
    if design.one_frequency:
        sentences.append(
            f"one frequency ({design.frequency_hz:.3g} Hz): gain and phase at one frequency cannot separate several "
            "poles, and lower gain with lower thresholds gives the same events (contrast × threshold); record a chirp "
            "or steps"
        )
    if design.shape:
        sentences.append(
            "contrast × threshold: the light is known by its shape only: its contrast and the thresholds scale together"
        )
    return sentences


def _exchange(values: Mapping[str, float], level: float) -> str:
    exchanged = exchanged_poles(values, level)
    text = "at one level the source follower and the photoreceptor poles can be exchanged without changing the response"
    if not exchanged:
        return text + " to small signals (here the photoreceptor's pair is complex, so only one assignment is real)"
    e = exchanged[0]
    return text + (
        f": sf_cutoff_hz {e['sf_cutoff_hz']:.4g} with alpha {e['alpha']:.4g}, beta {e['beta']:.4g} "
        "fits small signals as well"
    )


def exchanged_poles(values: Mapping[str, float], level: float) -> list[dict[str, float]]:
    """Values whose small-signal response at `level` is the same, one of the photoreceptor's real poles and the source
    follower's having changed places; empty when the pair is complex.

    s² + (β + γL) s + αL = (s + p₁)(s + p₂); with ω the follower's pole, (s + ω)(s + p₂) and follower p₁.  β and γ
    scale together.
    """
    drag = values["beta"] + values["gamma"] * level
    product = values["alpha"] * level
    root = drag * drag - 4.0 * product
    if root <= 0:
        return []
    omega = 2.0 * np.pi * values["sf_cutoff_hz"]
    slow, fast = 0.5 * (drag - np.sqrt(root)), 0.5 * (drag + np.sqrt(root))
    alternatives = []
    for leaves, stays in ((fast, slow), (slow, fast)):
        scale = (omega + stays) / drag
        alternatives.append(
            {
                "alpha": omega * stays / level,
                "beta": values["beta"] * scale,
                "gamma": values["gamma"] * scale,
                "sf_cutoff_hz": leaves / (2.0 * np.pi),
            }
        )
    return alternatives
