"""What a fit of rates says of a sensor at any value of one bias: cutoff, noise and events, each with its uncertainty.

ln of the cutoff is linear in the bias (`pixelid rates --bias-law`), and so is ln of the noise, a rate of currents as
well. Settings depart from a line by more than their errors; the variance τ² of that is estimated by moments
(DerSimonian & Laird 1986, Controlled Clinical Trials 7, 177; for a line: Raudenbush 2009, in The Handbook of Research
Synthesis, ch. 16) and belongs to every prediction.  It is known from n settings, so limits are those of Student's t
with n − 2 degrees of freedom.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t as student

from pixelid.documents import interpreting, read_json
from pixelid.errors import InputError, shown
from pixelid.statistics import Z95, departures
from pixelid.status import Status
from pixelid.tables.rates.bias_law import LEAST_COLUMNS, MOST_MV
from pixelid.tables.rates.square_wave import rate

RESULT = "rates.json"
DRAWS = 400  # of rates: 95 % limits to a tenth of their width


@dataclass(frozen=True)
class Line:
    """ln q = level + slope (V − centre), with standard errors of both, departures τ, and degrees of freedom."""

    centre: float
    level: float
    level_sd: float
    slope: float
    slope_sd: float
    departure: float
    freedom: float

    def at(self, bias: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """((n,) ln q, (n,) standard error of a setting's own ln q) at biases (n,) mV."""
        away = np.asarray(bias) - self.centre
        error = np.sqrt(self.level_sd**2 + (self.slope_sd * away) ** 2 + self.departure**2)
        return self.level + self.slope * away, error

    @property
    def reach(self) -> float:
        """Standard errors of a 95 % limit."""
        return float(student.ppf(0.975, self.freedom))


@dataclass(frozen=True)
class BiasFit:
    """One bias of one sensor.

    Attributes:
        name: of the bias, as the columns are named before their number; empty where they have none.
        column_mv: column → bias.
        cutoff: Hz;  noise: events per second in the dark, None where fewer than 3 settings fix it.
        swing, dead_s: (ln, standard error) of the light's swing in thresholds and of the dead time; None where open.
        own: column → quantity → (value, low, high), as its own rates say; absent where they leave it open.
        source: the file.
        status, advice: of the fit.
    """

    name: str
    column_mv: dict[str, float]
    cutoff: Line
    noise: Line | None
    swing: tuple[float, float] | None
    dead_s: tuple[float, float] | None
    own: dict[str, dict[str, tuple[float, float, float]]]
    source: Path
    status: Status = Status.converged
    advice: str = ""

    @property
    def range_mv(self) -> tuple[float, float]:
        """Lowest and highest bias that was fitted."""
        return min(self.column_mv.values()), max(self.column_mv.values())

    def log_rates(self, bias: np.ndarray, frequency_hz: float, rng: np.random.Generator) -> np.ndarray:
        """(DRAWS, n) ln of events per second under the table's light, blinking at `frequency_hz`, at biases (n,).

        Raises:
            InputError: swing, dead time or noise are open.
        """
        if self.swing is None or self.dead_s is None or self.noise is None:
            raise InputError(
                f"{self.source}: the rates leave the light's swing, the dead time or the noise open: nothing fitted "
                "says how many events a setting gives"
            )
        swing, dead = (mean + sd * rng.standard_normal((DRAWS, 1)) for mean, sd in (self.swing, self.dead_s))
        drawn = []
        for line in (self.cutoff, self.noise):
            mean, sd = line.at(bias)
            drawn.append(mean + sd * rng.standard_t(line.freedom, (DRAWS, 1)))
        tau = np.exp(-np.clip(drawn[0], -50.0, 50.0)) / (2.0 * math.pi)
        noise = np.exp(np.clip(drawn[1], -50.0, 50.0))
        found = rate(np.full((1, 1), frequency_hz), np.exp(swing), tau, np.exp(dead), noise)
        return np.log(np.maximum(found, 1e-300))


def read_bias_fit(folder: Path, bias: str | None = None) -> BiasFit:
    """The fit of a folder of `pixelid rates --bias-law`.

    Args:
        folder: with rates.json.
        bias: the name of the bias asked for; None: whichever was fitted.

    Raises:
        InputError: nothing fitted says anything about the bias, or a damaged file.
    """
    path = Path(folder) / RESULT
    if not path.is_file():
        raise InputError(f"{folder}: no {RESULT} in it: expected the folder of `pixelid rates TABLE.csv --bias-law`")
    document = read_json(path)
    law = document.get("bias_law")
    if law is None:
        raise InputError(f"{path}: no law of a bias in it: fit the table again with `pixelid rates --bias-law`")
    with interpreting(path, "a fitted law of a bias"):
        columns = {str(name): float(value) for name, value in law["bias_mv"].items()}
        if not all(0.0 <= value <= MOST_MV for value in columns.values()):
            raise InputError(f"{path}: bias_mv: expected biases of 0 to {MOST_MV:g} mV, found others")
        names = {name.rstrip("0123456789. ") for name in columns}
        fitted = names.pop() if len(names) == 1 else ""
        if bias is not None and bias != fitted:
            raise InputError(
                f"{path}: the law of {fitted or 'an unnamed bias'}; nothing fitted says what {shown(bias)} does"
            )
        if not law["mv_per_efold"]["identified"]:
            raise InputError(
                f"{path}: the biases do not fix how the cutoff goes with them: record rates at more of them"
            )
        own = {name: _own(document["parameters"], name) for name in columns}
        together = document["one_dead_time"]["parameters"]
        return BiasFit(
            fitted, columns, _cutoff(law, len(columns)), _noise(columns, own), _log(together["swing_over_threshold"]),
            _log(together["dead_time_s"]), own, path, Status(document["status"]), str(document["advice"]),
        )  # fmt: skip


def line_through(bias: np.ndarray, log_value: np.ndarray, sd: np.ndarray) -> Line:
    """The line through values (n,) of standard errors (n,), with departures by moments."""
    X = np.stack([np.ones(len(bias)), bias - bias.mean()], axis=1)
    departure = departures(X, log_value, np.diag(sd**2))
    W = np.diag(1.0 / (sd**2 + departure**2))
    covariance = np.linalg.inv(X.T @ W @ X)
    level, slope = covariance @ X.T @ W @ log_value
    errors = np.sqrt(np.diag(covariance))
    return Line(
        float(bias.mean()), float(level), float(errors[0]), float(slope), float(errors[1]), departure, len(bias) - 2
    )


def _cutoff(law: Mapping[str, Any], columns: int) -> Line:
    """The line of the law; its level, too, is a mean over settings that depart."""
    level, level_sd = _required_log(law["cutoff_hz_at_reference"])
    log_efold, efold_sd = _required_log(law["mv_per_efold"])
    sign = -1.0 if law["cutoff"].startswith("falls") else 1.0
    slope, departure = sign * math.exp(-log_efold), float(law["departure_sd"])
    level_sd = math.hypot(level_sd, departure / math.sqrt(columns))
    return Line(float(law["reference_mv"]), level, level_sd, slope, abs(slope) * efold_sd, departure, columns - 2)


def _noise(columns: Mapping[str, float], own: Mapping[str, Mapping[str, tuple[float, float, float]]]) -> Line | None:
    known = [(columns[name], *found["noise"]) for name, found in own.items() if "noise" in found]
    if len(known) < LEAST_COLUMNS:
        return None
    bias, value, low, high = np.array(known).T
    return line_through(bias, np.log(value), np.log(high / low) / (2.0 * Z95))


def _own(parameters: Mapping[str, Any], column: str) -> dict[str, tuple[float, float, float]]:
    found = {}
    for quantity, name in (("bandwidth", f"cutoff_hz[{column}]"), ("noise", f"noise_hz[{column}]")):
        entry = parameters[name]
        if entry["identified"]:
            found[quantity] = (float(entry["value"]), *map(float, entry["interval_95"]))
    return found


def _log(entry: Mapping[str, Any]) -> tuple[float, float] | None:
    return _required_log(entry) if entry["identified"] else None


def _required_log(entry: Mapping[str, Any]) -> tuple[float, float]:
    """(ln of a value, standard error) of an entry with an interval."""
    low, high = entry["interval_95"]
    return math.log(entry["value"]), math.log(high / low) / (2.0 * Z95)
