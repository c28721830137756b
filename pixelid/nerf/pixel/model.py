"""The pixel that training assumes: a circuit's dynamics and thresholds as tensors, fixed or trained with the scene.

Filter, mean threshold and ON/OFF ratio are trained as factors e^x, positive, with a Gaussian prior on x: what a fit
leaves uncertain, or a wide one.  The invariants α, β, γ and the source follower are what the data can say of the filter
(docs/model.md, "Invariants"); fixing q_in, as the paper does, would leave flat directions.  What may be zero is trained
as a sum (`additions`): dead time, leak, parasitic photocurrent, drift and memory of the thresholds.  All but the filter
can be trained whatever is done of the filter; threshold, ratio and dead time without one are the pixel of Low & Lee,
arXiv 2309.08596.  Only stages that the circuit has enter, and only those are trained.

Thresholds of single pixels are trained in every mode, as far as they are unknown (`pixel_maps`).  Their mean over the
pixels is held: a common factor is the circuit's, and would otherwise follow the contrast that the field still lacks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import overload

import numpy as np
import torch

from pixelid.dynamics.equations import PRESENT_BELOW, photoreceptor_rates
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.slew import without_slew_limit
from pixelid.dynamics.trajectory import Dynamics
from pixelid.nerf.effects.additions import ADDITIONS
from pixelid.nerf.options import TRAINABLE, Options
from pixelid.nerf.pixel.maps import PixelMaps, maps_of_circuit
from pixelid.stages.circuit import Circuit

FILTER = ("alpha", "beta", "gamma", "follower")
PHOTORECEPTOR = ("alpha", "beta", "gamma")  # of them, those of a second-order photoreceptor
FACTORS = (*FILTER, "threshold", "ratio")
PRIOR_SD = 1.5  # of ln(factor), when no fit says better


@dataclass(frozen=True)
class Bandwidth:
    """How the pixel enters.

    mode: the filter is known ("on"), ignored ("off") or trained ("joint");  samples: S of the past;  prior_sd: of
    ln(factor), per name of `FACTORS` (default `PRIOR_SD`);  trained: names of `TRAINABLE` (and of `FILTER`, when it is
    on) that are trained too
    """

    mode: str = "on"
    samples: int = 30
    prior_sd: dict[str, float] | None = None
    trained: tuple[str, ...] = ()

    @classmethod
    def of(cls, options: Options) -> Bandwidth:
        """What options ask for."""
        return cls(options.bandwidth, options.samples, trained=options.trained)

    @property
    def moving(self) -> tuple[str, ...]:
        """The names of `FACTORS` and `ADDITIONS` that are trained, in a circuit that has them."""
        return (*FILTER, *self.trained) if self.mode == "joint" else self.trained


def filter_parameters(circuit: Circuit) -> tuple[str, ...]:
    """The names of `FILTER` that this circuit has: of a one-pole photoreceptor only α, which then scales its corner."""
    photoreceptor = {"second_order": ("alpha", "beta", "gamma"), "one_pole": ("alpha",)}
    follower = ("follower",) if math.isfinite(circuit.follower) else ()
    return (*photoreceptor.get(circuit.photoreceptor, ()), *follower)


def limits_bandwidth(circuit: Circuit) -> bool:
    """Whether any stage of the circuit filters."""
    cutoffs = (circuit.follower, circuit.extra_pole, circuit.differencing)
    return circuit.photoreceptor != "unlimited" or circuit.lower_cutoff > 0 or any(map(math.isfinite, cutoffs))


class Pixel(torch.nn.Module):
    """A circuit as tensors, and its pixels.

    factors: (6,) logs of what multiplies `FACTORS`, trained where `moves` is 1;  told: (6,) of them, where priors lie:
    0, unless the circuit is one that training has moved before;  added: (5,) what is added to the
    circuit's `ADDITIONS`, in their steps, trained where `adds` is 1;  departures: (pixels, 2) of single ON and OFF
    thresholds from what `maps` expects, in its standard deviations, trained where they are not 0
    """

    nominal: torch.Tensor
    prior_sd: torch.Tensor
    told: torch.Tensor
    moves: torch.Tensor
    adds: torch.Tensor
    steps: torch.Tensor
    expected: torch.Tensor
    unknown: torch.Tensor

    def __init__(self, circuit: Circuit, bandwidth: Bandwidth, maps: PixelMaps | None = None) -> None:
        super().__init__()
        self.circuit, self.bandwidth = circuit, bandwidth
        self.maps = maps_of_circuit(circuit.with_(mismatch=0.0), 1) if maps is None else maps
        dynamics = dynamics_of(without_slew_limit(circuit))
        self.register_buffer("nominal", torch.tensor(dynamics.uniform(), dtype=torch.float64))
        self.register_buffer("expected", torch.tensor(self.maps.threshold))
        self.register_buffer("unknown", torch.tensor(self.maps.threshold_sd))
        trained = bool((self.unknown > 0).any())
        self.departures = torch.nn.Parameter(torch.zeros_like(self.expected), requires_grad=trained)
        sd = [(bandwidth.prior_sd or {}).get(name, PRIOR_SD) for name in FACTORS]
        self.register_buffer("prior_sd", torch.tensor(sd, dtype=torch.float64))
        moving = {*filter_parameters(circuit), *TRAINABLE} & {*bandwidth.moving}
        moves = torch.tensor([float(name in moving) for name in FACTORS], dtype=torch.float64)
        adds = torch.tensor([float(name in moving) for name in ADDITIONS], dtype=torch.float64)
        self.factors = torch.nn.Parameter(torch.zeros_like(moves), requires_grad=bool(moves.any()))
        self.added = torch.nn.Parameter(torch.zeros_like(adds), requires_grad=bool(adds.any()))
        self.register_buffer("told", torch.zeros_like(moves), persistent=False)
        self.register_buffer("moves", moves)
        self.register_buffer("adds", adds)
        steps = [addition.step_from(circuit) for addition in ADDITIONS.values()]
        self.register_buffer("steps", torch.tensor(steps, dtype=torch.float64))

    @property
    def filtering(self) -> bool:
        """Whether light is filtered at all: not when off, not with a single sample, and not without a stage."""
        return self.bandwidth.mode != "off" and self.bandwidth.samples > 1 and limits_bandwidth(self.circuit)

    @property
    def has_amplifier_pole(self) -> bool:
        """Whether the differencing amplifier has one."""
        return math.isfinite(self.circuit.differencing)

    @property
    def dynamics(self) -> torch.Tensor:
        """(8,) numbers of `Dynamics`."""
        nominal = self.nominal
        if not bool(self.moves[: len(FILTER)].any()):
            return nominal
        ones = torch.ones(len(nominal) - len(FILTER), dtype=torch.float64, device=nominal.device)
        return nominal * torch.cat([self._scale[: len(FILTER)], ones])

    def dynamics_at(self, pixels: np.ndarray) -> torch.Tensor:
        """(8,) numbers of `Dynamics`, or (n, 8) of pixels (n,) that differ."""
        if self.maps.bandwidth is None:
            return self.dynamics
        return self.dynamics * torch.as_tensor(self.maps.bandwidth[pixels], device=self.nominal.device)

    @property
    def _scale(self) -> torch.Tensor:
        return torch.exp(self.factors * self.moves)

    @property
    def thresholds(self) -> tuple[torch.Tensor, torch.Tensor]:
        """(ON, OFF), both positive [ln L]."""
        on, off = float(self.circuit.on_threshold), float(self.circuit.off_threshold)
        mean, ratio = 0.5 * (on + off) * self._scale[4], on / off * self._scale[5]
        return 2 * mean * ratio / (1 + ratio), 2 * mean / (1 + ratio)

    @property
    def mean_threshold(self) -> float:
        """Of ON and OFF, as trained, without a gradient [ln L]."""
        return 0.5 * sum(float(threshold.detach()) for threshold in self.thresholds)

    def trains(self, name: str) -> bool:
        """Whether one of `FACTORS` is trained."""
        return bool(self.moves[FACTORS.index(name)])

    @property
    def growth(self) -> torch.Tensor:
        """By how much the mean threshold has been trained to be larger than stated."""
        return self._scale[4] * torch.exp(-self.told[4])

    def thresholds_at(self, pixels: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """(ON, OFF), (n, 1) each, of pixels (n,)."""
        which = torch.as_tensor(pixels if len(self.expected) > 1 else np.zeros_like(pixels), device=self.nominal.device)
        on, off = self.thresholds
        log = self._departing()[which]
        log = log - log.mean(dim=0) + log.mean(dim=0).detach()  # what these pixels have in common moves none of them
        factor = torch.exp(log)
        return on * factor[:, :1], off * factor[:, 1:]

    def threshold_spread(self) -> tuple[float, float]:
        """Relative standard deviation of the pixels' ON and OFF thresholds in use."""
        on, off = self._departing().detach().std(dim=0, correction=0)
        return float(on), float(off)

    def _departing(self) -> torch.Tensor:
        """(pixels, 2) ln of every pixel's thresholds over the circuit's."""
        moved = self.unknown * self.departures
        return self.expected + moved - moved.mean(dim=0).detach()

    def adds_to(self, name: str) -> bool:
        """Whether one of `ADDITIONS` is trained."""
        return bool(self.adds[list(ADDITIONS).index(name)])

    def addition(self, name: str) -> torch.Tensor:
        """What is added to the circuit's value of one of `ADDITIONS`."""
        k = list(ADDITIONS).index(name)
        return self.steps[k] * self.adds[k] * self.added[k]

    def strength(self, name: str) -> torch.Tensor:
        """The value in use of one of `ADDITIONS`, in the circuit's unit."""
        return getattr(self.circuit, ADDITIONS[name].field) + self.addition(name)

    def keep_within_bounds(self) -> None:
        """Move what is added up to the least value that each may have."""
        with torch.no_grad():
            least = [(a.least - getattr(self.circuit, a.field)) for a in ADDITIONS.values()]
            self.added.clamp_(min=torch.tensor(least, dtype=torch.float64, device=self.added.device) / self.steps)

    def thresholds_from_told(self) -> dict[str, float]:
        """By how many standard deviations trained mean and ratio have left what `Bandwidth.prior_sd` states."""
        far = dict(zip(FACTORS, self._far.detach().tolist(), strict=True))
        return {name: far[name] for name in ("threshold", "ratio") if name in (self.bandwidth.prior_sd or {})}

    def penalty(self, left: float = 1.0) -> torch.Tensor:
        """−ln prior of the factors, and of the pixels' thresholds times `left`, the variance that a change leaves."""
        return 0.5 * (self._far**2).sum() + 0.5 * left * (self.departures**2).sum()

    @property
    def _far(self) -> torch.Tensor:
        """(6,) from where their priors lie to the factors, in standard deviations."""
        return self.moves * (self.factors - self.told) / self.prior_sd

    @property
    def moved(self) -> torch.Tensor:
        """(6,) logs by which `FACTORS` have left what was stated."""
        return (self.moves * self.factors - self.told).detach()

    @overload
    def slowest(self, radiance: float) -> float: ...
    @overload
    def slowest(self, radiance: np.ndarray) -> np.ndarray: ...
    def slowest(self, radiance: float | np.ndarray) -> float | np.ndarray:
        """The slowest dominant low-pass pole [rad/s] at a radiance, or at each of an array, of the circuit's stages.

        The amplifier's reset and the lower cutoff count only where nothing else filters.
        """
        circuit, dynamics = self.circuit, Dynamics(*(float(x) for x in self.dynamics.detach()))
        others = [cutoff for cutoff in (dynamics.follower, dynamics.extra_pole) if cutoff < PRESENT_BELOW]
        if circuit.photoreceptor != "unlimited":
            a, b2 = photoreceptor_rates(dynamics, np.asarray(radiance, float))
            real = np.sqrt(np.maximum(0.25 * b2 * b2 - a, 0.0))  # 0 where a pair is complex, whose modulus counts
            rate = np.minimum(np.where(real > 0, a / (0.5 * b2 + real), np.sqrt(a)), min(others, default=np.inf))
        else:
            rate = np.full(np.shape(radiance), min(others, default=circuit.lower_cutoff or dynamics.differencing))
        return rate if np.ndim(radiance) else float(rate)

    def values(self) -> dict[str, float]:
        """The numbers in use, by name, of the stages that the circuit has; of `ADDITIONS` those that it has or trains.

        A photoreceptor of one pole has its `corner` [rad/s per radiance] in place of α, β and γ.
        """
        used = Dynamics(*(float(x) for x in self.dynamics.detach()))
        on, off = (float(x.detach()) for x in self.thresholds)
        second = self.circuit.photoreceptor == "second_order"
        filtered = {
            name: getattr(used, name) for name in FILTER
            if (second or name not in PHOTORECEPTOR) and getattr(used, name) < PRESENT_BELOW
        }  # fmt: skip
        if self.circuit.photoreceptor == "one_pole":
            filtered["corner"] = self.circuit.corner * used.alpha / float(self.nominal[0])
        strengths = {a.parameter: float(self.strength(name).detach()) for name, a in ADDITIONS.items()}
        shown = {a.parameter for name, a in ADDITIONS.items() if name == "refractory" or self.adds_to(name)}
        acting = {name: value for name, value in strengths.items() if value or name in shown}
        return {**filtered, "on_threshold": on, "off_threshold": off, **acting}
