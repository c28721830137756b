"""The photoreceptor's dominant pole in every light that a table of latencies holds.

After a step the light is constant, so the circuit is linear with the poles of that light: s² + b s + a, a = αE, b = β
+ γE, and the later stages.  Here every light has an a of its own, a = αE exp(δ): the table says how fast the
photoreceptor was in this light, whatever it was in another.  Shared by all lights are thresholds and delays per
setting, later stages and β, fitted to the same rows under the priors of `pixelid latency`, so that an interval of a
pole holds their errors too.  One thing no table of latencies says without a law that joins the lights: a higher
threshold behind a faster pole takes as long.  It is the gauge, and the model's: the mean of its log thresholds per
edge, as uncertain as its file says, the light's swing and its dark light.

Behind one pole a latency is −ln(1 − C/A) τ plus a floor, C the threshold, A the step of log light, τ the pole's time
constant: it is linear in times, and so is the normal approximation of the errors.  The photoreceptor's two are b/a
(its whole delay, 1/p₁ + 1/p₂) and 1/β (that of its second pole): they are drawn jointly, and p₁ is taken of the drawn
pairs. Where b/a = 0 is among the draws the pole has no upper limit; a second time constant below 0 is one of 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pixelid.lowlight import poles
from pixelid.parameters.parameter import OPEN_SD
from pixelid.stages.circuit import Circuit
from pixelid.statistics import Z95
from pixelid.tables.fit import TableFit, Tie, covariance_at, fit_table
from pixelid.tables.latency.camera import Camera
from pixelid.tables.latency.cells import Cells
from pixelid.tables.latency.fit import CameraFit, fit_camera
from pixelid.tables.latency.levels import Level
from pixelid.tables.latency.model import GAMMA_OVER_CORNER, SHARED, THRESHOLD, LatencyModel

HELD_SD = 1e-3  # in ln, of what the gauge holds: far below any table's scatter
DRAWS = 2000  # 95 % limits to about a twentieth of their width
_FASTEST = 1e15  # rad/s, of a pole whose time constant is 0
_BETA = [p.name for p in SHARED].index("beta")  # place among the coordinates


@dataclass(frozen=True)
class Poles:
    """Dominant poles of a table's lights.

    Attributes:
        levels: the lights.
        value: (levels,) rad/s;  low, high: their 95 % limits, high inf where there is none.
        law, law_low, law_high: the same where a = αE holds for all lights together.
        light: (levels,) W/m² after the step, dark current included, as the law's fit has it.
        logs: (levels + 1,) ln of the low-light cutoff per light, αe^δ/β, and of β;  covariance: (…, …) of them.
        gain: nats by which the table prefers a speed for every light.
    """

    levels: tuple[Level, ...]
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    law: np.ndarray
    law_low: np.ndarray
    law_high: np.ndarray
    light: np.ndarray
    logs: np.ndarray
    covariance: np.ndarray
    gain: float
    law_fit: CameraFit
    free_fit: TableFit

    @property
    def identified(self) -> np.ndarray:
        """(levels,) whether the table fixes the pole: two limits, closer than those of a coordinate called open."""
        with np.errstate(invalid="ignore"):
            return np.isfinite(self.high) & (np.log(self.high / self.low) < 2.0 * Z95 * OPEN_SD)

    def exponent(self, on: bool) -> tuple[float, float] | None:
        """(k, standard error) of a low-light cutoff that goes as E^k over the lights of an edge.

        Generalised least squares, with a factor of each lens's own: what is known of the factor of all does not matter.
        None with fewer than two lights behind any lens, or where the table leaves k open.
        """
        chosen = [k for k, level in enumerate(self.levels) if level.on == on]
        lenses = sorted({self.levels[k].lens for k in chosen})
        if len(chosen) <= len(lenses):
            return None
        design = np.array([
            [np.log(self.light[k]), *(float(self.levels[k].lens == lens) for lens in lenses)] for k in chosen
        ])  # fmt: skip
        weight = np.linalg.pinv(self.covariance[np.ix_(chosen, chosen)])
        covariance = np.linalg.inv(design.T @ weight @ design)
        found = covariance @ design.T @ weight @ self.logs[chosen]
        sd = float(np.sqrt(covariance[0, 0]))
        return (1.0 + float(found[0]), sd) if sd < OPEN_SD else None

    def second_pole(self) -> tuple[float, float, float]:
        """(ln of the low-light cutoff per light, ln β, standard error of their difference) over the lights known."""
        chosen = np.flatnonzero(self.identified)
        mix = np.zeros(len(self.logs))
        mix[chosen if len(chosen) else slice(0, -1)] = -1.0 / (len(chosen) or len(self.levels))
        mean = float(-mix @ self.logs)
        mix[-1] = 1.0
        return mean, float(self.logs[-1]), float(np.sqrt(mix @ self.covariance @ mix))


def measured_poles(name: str, cells: Cells, camera: Camera, seed: int = 0, *, describes: bool = True) -> Poles:
    """The poles of one camera's cells.

    Args:
        name: the camera's label.
        cells: what was measured.
        camera: the model's, whose thresholds are the gauge.
        seed: of the draws behind the limits.
        describes: whether the camera describes the table, so that fits begin at it and not at the library's values.

    Raises:
        InputError: fewer than 4 cells.
    """
    law = fit_camera(name, cells, start=camera if describes else None)
    assert isinstance(law.model, LatencyModel)
    model = replace(law.model, departing=True)
    start = np.append(np.exp(law.regression.x), np.ones(len(model.levels)))
    free = fit_table(model, start.tolist(), gauge(model, camera))
    rng = np.random.default_rng([seed, 16])
    light = np.array([_light(_named(law.model, law.regression.x), level) for level in model.levels])
    at, own = _poles(model, free, rng)
    law_at, law_own = _poles(law.model, law.regression, rng)
    count = len(model.levels)
    slope = np.hstack([np.zeros((count + 1, len(free.x) - count)), np.eye(count + 1, count)])
    slope[:-1, 0] = 1.0
    slope[-1, _BETA] = 1.0
    covariance = slope @ covariance_at(free) @ slope.T
    low, high = _limits(own)
    law_low, law_high = _limits(law_own)
    gain = free.log_likelihood - law.regression.log_likelihood
    return Poles(
        model.levels, at, low, high, law_at, law_low, law_high, light, slope @ free.x, covariance, gain, law, free
    )


def gauge(model: LatencyModel, camera: Camera) -> tuple[Tie, ...]:
    """The ties of a fit without law to a camera's thresholds, swing and dark light."""
    place = {p.name: k for k, p in enumerate(model.parameters)}
    ties = []
    for edge, on in (("on", True), ("off", False)):
        known = [s for s in camera.settings if f"{edge}_threshold[{s.name}]" in place]
        if known:
            places = tuple(place[f"{edge}_threshold[{s.name}]"] for s in known)
            mean = float(np.mean(np.log([s.threshold(on) for s in known])))
            ties.append(Tie(places, mean, threshold_sd(camera, edge)))
    held = {"led_off_fraction": camera.led_off_fraction}
    held |= {f"lens_factor[{lens}]": factor for lens, factor in camera.lens.items()}
    if (dark := camera.model.values.get("dark_current.radiance", 0.0)) > 0.0:
        held["dark_current.radiance"] = dark
    return (
        *ties,
        *(Tie((place[name],), float(np.log(value)), HELD_SD) for name, value in held.items() if name in place),
    )


def threshold_sd(camera: Camera, edge: str) -> float:
    """Standard deviation of the log thresholds of an edge, all together: the model's prior, that its fit left.

    A fit that left them open writes no prior: then they are as wide as before any table.
    """
    prior = camera.model.parameters[f"{edge}_threshold"].prior or THRESHOLD.prior
    assert prior is not None
    return max(prior.sd, HELD_SD)


def _poles(model: LatencyModel, fit: TableFit, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """((levels,) poles at the fit, (draws, levels) poles of draws), rad/s; inf where a draw has none."""
    cutoff, beta = _log_cutoffs(model, fit.x), fit.x[_BETA]
    slope = np.zeros((len(cutoff) + 1, len(fit.x)))  # of ln(a/β) of every light, and of ln β
    slope[-1, _BETA] = 1.0
    for n in range(len(fit.x)):
        step = np.zeros(len(fit.x))
        step[n] = 1e-5
        slope[:-1, n] = (_log_cutoffs(model, fit.x + step) - _log_cutoffs(model, fit.x - step)) / 2e-5
    values, vectors = np.linalg.eigh(slope @ covariance_at(fit) @ slope.T)
    drawn = rng.standard_normal((DRAWS, len(values))) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    left = 1.0 - drawn  # of each time constant
    fastest = np.log(_FASTEST)
    logs = np.where(left > 0.0, np.append(cutoff, beta) - np.log(np.maximum(left, 1e-300)), fastest)
    gamma = GAMMA_OVER_CORNER * np.exp(cutoff)
    own = _dominant(np.exp(logs[:, :-1]), np.exp(logs[:, -1:]), gamma)
    own[left[:, :-1] <= 0.0] = np.inf
    return _dominant(np.exp(cutoff), np.exp(beta), gamma), own


def _dominant(cutoff: np.ndarray, beta, gamma: np.ndarray) -> np.ndarray:
    """Slowest pole [rad/s] of a/β, β and γE, that broadcast."""
    circuit = Circuit(alpha=cutoff * beta, beta=beta, gamma=gamma)  # pyright: ignore[reportArgumentType]
    return poles.dominant(circuit, 1.0)


def _limits(own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    low, high = np.quantile(own, [0.025, 0.975], axis=0, method="closest_observation")
    return low, high


def _named(model: LatencyModel, x: np.ndarray) -> dict[str, np.ndarray]:
    """Parameter → value at coordinates (…, n)."""
    return {p.name: np.exp(x[..., k]) for k, p in enumerate(model.parameters)}


def _light(v: dict[str, np.ndarray], level: Level) -> np.ndarray:
    """Light after the step, dark current included [W/m²]."""
    lit = 1.0 if level.on else v["led_off_fraction"]
    return v.get(f"lens_factor[{level.lens}]", np.float64(1.0)) * lit * level.irradiance + v["dark_current.radiance"]


def _log_cutoffs(model: LatencyModel, x: np.ndarray) -> np.ndarray:
    """(levels,) ln of αE/β exp(δ), the low-light cutoff [rad/s], at coordinates (n,)."""
    v = _named(model, x)
    departure = x[len(x) - len(model.levels) :] if model.departing else 0.0
    return np.log([v["alpha_over_beta"] * _light(v, level) for level in model.levels]) + departure
