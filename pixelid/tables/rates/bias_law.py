"""Cutoffs by bias: the follower's bias current is subthreshold, so ln of its cutoff is linear in the bias voltage.

    f = f_ref exp(± (V − V_ref) / s),        s = U_T / κ,  U_T = k T / q

(Enz, Krummenacher & Vittoz 1995, Analog Integr. Circuits Signal Process. 8, 83; in bias generators of event cameras
Delbrück et al. 2010, IEEE ISCAS.)  The law replaces one cutoff per column by two numbers for all.  A column left out of
the fit is predicted by taking its own bias as V_ref: the cutoff fitted is then the one predicted, with its interval.

Settings depart from the law by more than their rates' errors (other currents, the loop around the photoreceptor).  The
variance τ² of ln f about it is estimated by moments from the columns' own cutoffs (`statistics.departures`), and widens
both the predictions and the interval of the e-fold.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.constants import Boltzmann, elementary_charge

from pixelid.errors import InputError, shown
from pixelid.parameters.parameter import OPEN_SD, Parameter
from pixelid.statistics import Z95, departures
from pixelid.tables.fit import TableFit, covariance_at, fit_table
from pixelid.tables.rates.pixel import CUTOFF, CUTOFF_STARTS, DEAD_STARTS_S, PixelFit, PixelModel
from pixelid.tables.rates.reading import RateTable
from pixelid.tables.rates.square_wave import rate

MOST_MV = 10_000.0  # supplies of image sensors are 3.3 V or less
LEAST_COLUMNS = 3  # two lie on any line
NO_LAW = "the biases do not fix how the cutoff goes with them"
SLOPE = Parameter("mv_per_efold", 32.0, "mV", 5.0, 500.0, "log")
TEMPERATURE_K = 300.0  # of the sensor, where nobody says: 15 K more or less change κ by 5 %


def biases_of(columns: Sequence[str]) -> np.ndarray:
    """(m,) mV, the number at the end of each column's name.

    Raises:
        InputError: a name without one, fewer than 3 columns, or one bias twice.
    """
    found = [re.search(r"(\d+(?:\.\d+)?)\s*$", name) for name in columns]
    missing = [name for name, match in zip(columns, found, strict=True) if match is None]
    if missing:
        found_name = shown(missing[0])
        raise InputError(f"--bias-law: expected columns named by their bias in mV, as fo1477; found {found_name}")
    biases = np.array([float(match.group(1)) for match in found if match])
    if biases.max() > MOST_MV:
        largest = shown(columns[int(biases.argmax())])
        raise InputError(f"--bias-law: expected biases of at most {MOST_MV:g} mV, found {largest}")
    if len(np.unique(biases)) < max(LEAST_COLUMNS, len(biases)):
        raise InputError(f"--bias-law: expected {LEAST_COLUMNS} or more columns of different biases")
    return biases


@dataclass(frozen=True)
class BiasLawModel(PixelModel):
    """Rates of one pixel whose cutoffs follow the subthreshold law.

    Attributes:
        bias_mv: (m,) of the columns.
        reference_mv: bias that the cutoff is stated at.
        sign: of d ln f / d V.
    """

    bias_mv: np.ndarray = field(default_factory=lambda: np.zeros(0))
    reference_mv: float = 0.0
    sign: float = -1.0

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of a pixel with one cutoff, that at the reference bias, and the bias of an e-fold behind them."""
        nearest = self.table.columns[int(np.argmin(np.abs(self.bias_mv - self.reference_mv)))]
        own = [p for p in super().parameters if not p.name.startswith("cutoff_hz")]
        starts = {p.name: p.value for p in super().parameters}
        cutoff = CUTOFF.at(starts[f"cutoff_hz[{nearest}]"])
        return (*own, replace(cutoff, lower=1e-3, upper=1e9), SLOPE)

    @property
    def places(self) -> tuple[np.ndarray, ...]:
        """As of a pixel; the cutoff's is that of its two numbers."""
        columns = len(self.table.columns)
        swing, dead, noise, first = np.zeros(columns, int), None, None, 1
        for kind in ("dead", "noise"):
            shared = kind in self.shared
            place = first + (np.zeros(columns, int) if shared else np.arange(columns))
            first += 1 if shared else columns
            dead, noise = (place, noise) if kind == "dead" else (dead, place)
        assert dead is not None
        assert noise is not None
        return swing, np.full(columns, first), dead, noise, np.full(columns, first + 1)

    def rate_at(self, x: np.ndarray, frequency_hz: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Events per second at any frequencies of the table's columns."""
        swing, cutoff, dead, noise, slope = (x[place[column]] for place in self.places)
        log_cutoff = cutoff + self.sign * (self.bias_mv[column] - self.reference_mv) * np.exp(-slope)
        tau = np.exp(-np.clip(log_cutoff, -50.0, 50.0)) / (2.0 * np.pi)
        return rate(frequency_hz, np.exp(swing), tau, np.exp(dead), np.exp(noise))


def fit_law(table: RateTable, bias_mv: np.ndarray, reference_mv: float, shared: tuple[str, ...]) -> TableFit:
    """The likeliest law: either sign, dead times short and long.

    Args:
        table: rates per frequency and bias.
        bias_mv: (m,) of its columns.
        reference_mv: bias that the cutoff is stated at.
        shared: which of "swing" and "dead" have one value for all columns; the swing always has.
    """
    models = [
        BiasLawModel(table, shared, dead, slower, bias_mv=bias_mv, reference_mv=reference_mv, sign=sign)
        for dead in DEAD_STARTS_S
        for slower in CUTOFF_STARTS[:2]
        for sign in (-1.0, 1.0)
    ]
    return max((fit_table(model) for model in models), key=lambda fit: fit.log_likelihood)


def bias_law(free: PixelFit) -> dict[str, Any]:
    """What rates.json says of the law: the e-fold, κ, what it costs, and every column predicted from the others.

    Args:
        free: the same table with a cutoff of each column's own.

    Raises:
        InputError: columns that are not named by biases.
    """
    table, shared = free.table, free.model.shared
    biases = biases_of(table.columns)
    law = fit_law(table, biases, float(np.mean(biases)), shared)
    model = law.model
    assert isinstance(model, BiasLawModel)
    own = [_log_estimate(free.regression, f"cutoff_hz[{name}]") for name in table.columns]
    said = [_of_others(table, biases, k, shared) for k in range(len(biases)) if len(biases) > LEAST_COLUMNS]
    worse = free.regression.log_likelihood - law.log_likelihood
    places = [[p.name for p in free.regression.parameters].index(f"cutoff_hz[{name}]") for name in table.columns]
    apart = departure(biases, own, worse, covariance_at(free.regression)[np.ix_(places, places)])
    slope, slope_sd = _log_estimate(law, SLOPE.name)
    # ln f = c ± V/s: a departure τ of each setting moves 1/s by τ / √Σ(V − V̄)², and so ln s by s times that
    spread = float(np.sqrt(((biases - biases.mean()) ** 2).sum()))
    slope_sd = float(np.hypot(slope_sd, apart * np.exp(slope) / spread))
    known = slope_sd < OPEN_SD
    thermal_mv = 1e3 * Boltzmann * TEMPERATURE_K / elementary_charge
    left_out = [
        {
            "column": name,
            "predicted_hz": float(np.exp(theirs[0])),
            "interval_95": _interval(theirs[0], float(np.hypot(theirs[1], apart))),
            "own_interval_95": free.regression.as_dict()[f"cutoff_hz[{name}]"]["interval_95"],
        }
        for name, theirs in zip(table.columns, said, strict=False)
    ]
    return {
        "bias_mv": dict(zip(table.columns, biases.tolist(), strict=True)),
        "cutoff": "falls with the bias" if model.sign < 0 else "rises with the bias",
        "mv_per_efold": {"value": float(np.exp(slope)), "interval_95": _interval(slope, slope_sd), "identified": known},
        "kappa": {
            "value": thermal_mv * float(np.exp(-slope)),
            "interval_95": [thermal_mv * value for value in _interval(-slope, slope_sd)],
            "temperature_k": TEMPERATURE_K, "identified": known,
        },
        "reference_mv": model.reference_mv,
        "cutoff_hz_at_reference": law.as_dict()["cutoff_hz"],
        "departure_sd": apart,
        "nats_worse_than_free_cutoffs": worse,
        "parameters_fewer": len(free.regression.x) - len(law.x),
        "left_out": left_out,
    }  # fmt: skip


def departure(
    biases: np.ndarray, own: Sequence[tuple[float, float]], worse: float = 0.0, covariance: np.ndarray | None = None
) -> float:
    """τ, by which ln f of settings (estimate, sd) scatters about a line over their biases beyond the errors.

    covariance: of the errors, which a swing that all settings share makes go together; independent where None
    worse: nats by which the law is less likely than a cutoff for each, which know of cutoffs that are known on one side
    """
    value, sd = np.array(own).T
    kept = np.flatnonzero(sd < OPEN_SD)
    if len(kept) < LEAST_COLUMNS:
        return 0.0
    line = np.stack([np.ones(len(kept)), biases[kept] - biases[kept].mean()], axis=1)
    errors = np.diag(sd[kept] ** 2) if covariance is None else covariance[np.ix_(kept, kept)]
    least_sd = 1e-6  # of ln f: rates without any scatter
    errors = errors + np.diag(np.maximum(least_sd**2 - np.diag(errors), 0.0))
    return departures(line, value[kept], errors, 2.0 * worse - (len(biases) - len(kept)))


def describes(law: dict[str, Any]) -> bool:
    """Whether the law explains more of how the cutoffs of the settings vary than it leaves."""
    explained = np.std(list(law["bias_mv"].values())) / law["mv_per_efold"]["value"]
    return bool(law["departure_sd"] < explained)


def law_sentences(law: dict[str, Any]) -> list[str]:
    """The law in words."""
    slope, kappa = law["mv_per_efold"], law["kappa"]
    if not slope["identified"]:
        return [NO_LAW]
    low, high = kappa["interval_95"]
    sentences = [
        f"the cutoff {law['cutoff']} by a factor e per {slope['value']:.1f} mV ({slope['interval_95'][0]:.1f} to "
        f"{slope['interval_95'][1]:.1f}): κ {kappa['value']:.2f} ({low:.2f} to {high:.2f}) at {TEMPERATURE_K:g} K; "
        f"settings depart from that by a factor {np.exp(law['departure_sd']):.2f}, and a cutoff for each is "
        f"{law['nats_worse_than_free_cutoffs']:.1f} nats likelier, with {law['parameters_fewer']} parameters more"
    ]
    for one in law["left_out"]:
        (a, b), (c, d) = one["interval_95"], one["own_interval_95"]
        sentences.append(
            f"{one['column']} predicted from the other biases: {one['predicted_hz']:.3g} Hz ({a:.3g} to {b:.3g}); "
            f"its own rates say {c:.3g} to {d:.3g}"
        )
    return sentences


def _of_others(table: RateTable, biases: np.ndarray, k: int, shared: tuple[str, ...]) -> tuple[float, float]:
    """(ln of a column's cutoff as the law of all others has it, its standard error)."""
    rest = np.arange(len(biases)) != k
    columns = tuple(name for name, kept in zip(table.columns, rest, strict=True) if kept)
    others = replace(table, columns=columns, rate_hz=table.rate_hz[:, rest])
    return _log_estimate(fit_law(others, biases[rest], float(biases[k]), shared), CUTOFF.name)


def _log_estimate(fit: TableFit, name: str) -> tuple[float, float]:
    k = [p.name for p in fit.parameters].index(name)
    return float(fit.x[k]), float(fit.sd[k])


def _interval(centre: float, sd: float) -> list[float]:
    return [float(np.exp(np.clip(centre + side * Z95 * sd, -300.0, 300.0))) for side in (-1.0, 1.0)]
