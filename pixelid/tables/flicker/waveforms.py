"""Waveforms of light on a logarithmic scale, as the amplifier shows them: mean 0, peak to peak 2, over one period.

Fixed ones, two families with numbers of their own, and a free one:

- `pulse`: light that is on for a share d of the period, behind one pole of cutoff f_c.  From y₀ it rises to
  y₁ = (1 − e^{−2πκd}) / (1 − e^{−2πκ}) with κ = f_c/f, and falls back as e^{−2πκθ}.
- `harmonics`: sin 2πθ + Σ_{h=2}^{H} (c_h cos 2πhθ + d_h sin 2πhθ), scaled to peak to peak 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FINE = 1024  # places in a period
HARMONICS = (2, 4, 8)  # tried in turn, as long as each explains more than its numbers cost
LARGEST = 5.0  # of a harmonic over the fundamental: pulses far narrower than a hundredth of the period have less
STEP = 1e-4  # for derivatives by the numbers of a waveform
_THETA = 2.0 * np.pi * np.arange(FINE) / FINE


@dataclass(frozen=True)
class Waveform:
    """A waveform, or a family of them.

    Attributes:
        name: as results call it.
        numbers: names of its own numbers; none of a fixed waveform.
        logarithmic: whether these are logarithms in a fit.
        lower, upper: bounds of these, as they are in a fit.
        begin: where a fit begins.
    """

    name: str
    numbers: tuple[str, ...] = ()
    logarithmic: bool = False
    lower: tuple[float, ...] = ()
    upper: tuple[float, ...] = ()
    begin: tuple[float, ...] = ()

    def fine(self, numbers: np.ndarray) -> np.ndarray:
        """(FINE,) its values over a period."""
        if self.name == "pulse":
            g = _pulse(*np.exp(numbers))
        elif self.numbers:
            order = np.arange(2, len(numbers) // 2 + 2)[:, None] * _THETA
            g = np.sin(_THETA) + numbers[0::2] @ np.cos(order) + numbers[1::2] @ np.sin(order)
        else:
            g = _FIXED[self.name]
        return (g - g.mean()) * 2.0 / np.ptp(g)

    def at(self, numbers: np.ndarray, cycles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n,) values at phases, and (1 + numbers, n) derivatives by the phase and by its numbers."""
        g = self.fine(numbers)
        x = (cycles % 1.0) * FINE
        k = x.astype(int) % FINE

        def at(values: np.ndarray) -> np.ndarray:
            return values[k] + (x - np.floor(x)) * (values[(k + 1) % FINE] - values[k])

        by = [0.5 * FINE * (np.roll(g, -1) - np.roll(g, 1))]
        by += [(self.fine(numbers + d) - self.fine(numbers - d)) / (2.0 * STEP) for d in STEP * np.eye(len(numbers))]
        return at(g), np.stack([at(one) for one in by])


def harmonics(order: int) -> Waveform:
    """The free waveform of so many harmonics, the fundamental among them."""
    names = tuple(f"{part}[{h}]" for h in range(2, order + 1) for part in ("cos", "sin"))
    count = len(names)
    return Waveform(f"harmonics ({order})", names, False, (-LARGEST,) * count, (LARGEST,) * count, (0.0,) * count)


def as_harmonics(g: np.ndarray, order: int) -> tuple[float, np.ndarray]:
    """(phase in cycles by which the fundamental of (FINE,) values lags a sine, numbers of `harmonics` of the rest)."""
    of = np.fft.rfft(g)[: order + 1] * 2.0 / FINE
    lag = -(np.angle(of[1]) / (2.0 * np.pi) + 0.25)
    turned = of * np.exp(2j * np.pi * np.arange(order + 1) * lag) / abs(of[1])
    numbers = np.stack([turned[2:].real, -turned[2:].imag], axis=1).ravel()
    return float(lag), np.clip(numbers, -0.99 * LARGEST, 0.99 * LARGEST)


def _pulse(duty: float, corner: float) -> np.ndarray:
    rate, theta = 2.0 * np.pi * corner, np.arange(FINE) / FINE
    top = np.expm1(-rate * duty) / np.expm1(-rate)
    rise = 1.0 - (1.0 - top * np.exp(-rate * (1.0 - duty))) * np.exp(-rate * theta)
    return np.where(theta < duty, rise, top * np.exp(-rate * (theta - duty)))


_FIXED = {
    "sine": np.sin(_THETA),
    "deep sine": np.log1p(0.9 * np.sin(_THETA)),
    "rectified": np.log(0.1 + np.abs(np.sin(0.5 * _THETA))),
}
# A pulse is no shorter than an eighth of a bin of phases, and no pole far from the light's frequency shows
PULSE = Waveform(
    "pulse", ("duty", "cutoff_over_frequency"), True, (np.log(1e-3), np.log(0.02)), (np.log(0.9), np.log(50.0)),
    (np.log(0.1), np.log(1.0)),
)  # fmt: skip
WAVEFORMS = {name: Waveform(name) for name in _FIXED} | {"pulse": PULSE}
