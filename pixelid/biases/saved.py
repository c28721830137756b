"""Laws of bias codes that `pixelid biases` has fitted: read from its folder, and evaluated at codes.

No law is exact.  What a quantity departs from it by is taken as a Wiener process over the codes (a discrepancy as
that of Kennedy & O'Hagan 2001, J. R. Statist. Soc. B 63, 425): nothing more at measured settings, whose scatter is
known, and a variance that grows with the distance from them, at the rate at which settings left out were missed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.biases.laws import Law
from pixelid.documents import interpreting, read_json, read_toml
from pixelid.errors import InputError
from pixelid.statistics import Z95

FILE = "biases.json"
DRAWS = 4000  # 95 % limits to 3 % of their half-width
BEYOND = 0.5  # of the measured range, beyond either end: an extrapolation further than that is none


@dataclass(frozen=True)
class Quantity:
    """A quantity with its laws, the best first; the others count by their weights.

    Attributes:
        name, unit: as in biases.json, SI units;  parameter: of a model that it is, "" where of none.
        laws: of the same codes.
        settings: (settings, codes) that were measured.
        departure: variance of ln q per half of the measured range, away from the measured settings.
    """

    name: str
    unit: str
    parameter: str
    laws: tuple[Law, ...]
    settings: np.ndarray
    departure: float

    @staticmethod
    def of(name: str, entry: Mapping[str, Any]) -> Quantity:
        """The quantity of an entry of biases.json.  Raises LookupError, TypeError or ValueError for another."""
        laws = tuple(Law.of(rival["fit"]) for rival in entry["rivals"] if "fit" in rival)
        if not laws or len({law.codes for law in laws}) > 1:
            raise ValueError(f"{name}: expected laws of the same codes")
        settings = entry.get("settings") or [[row[code] for code in laws[0].codes] for row in entry["rows"]]
        settings = np.unique(np.array(settings, float), axis=0)
        return Quantity(
            name, str(entry["unit"]), str(entry["parameter"]), laws, settings, float(entry["departure_variance"])
        )

    @property
    def codes(self) -> tuple[str, ...]:
        """Names of the biases."""
        return self.laws[0].codes

    def predict(self, codes: np.ndarray, seed: int = 0) -> dict[str, np.ndarray]:
        """What would be measured at codes (n, codes).

        The interval holds the parameters' errors, the scatter of settings about the law, the rivals by weight, and what
        left-out settings were missed by.

        Returns:
            "value", the mean of ln q over the laws by weight (Hoeting et al. 1999, Statist. Sci. 14, 382), "low" and
            "high" of 95 %, each (n,) in `unit`, NaN where open or where the best law has no value; "beyond" (n,): how
            far outside the measured codes, as a share of their range.
        """
        codes = np.atleast_2d(np.asarray(codes, float))
        rng = np.random.default_rng(seed)
        drawn = []
        depart = np.sqrt(self.departure * self.laws[0].distances(codes, self.settings))
        freedom = 4.0  # of Student's t: that of tables.fit
        for law in self.laws:
            count = round(DRAWS * law.weight)
            x, scatter = law.draw(count, rng)
            noise = scatter[:, None] * rng.standard_t(freedom, (count, len(codes)))
            drawn.append(law.log_value(codes, x) + noise + depart * rng.standard_normal((count, len(codes))))
        every = np.concatenate(drawn)
        low, high = np.nanpercentile(np.where(np.isnan(every).all(0), 0.0, every), [2.5, 97.5], axis=0)
        most_lost = 0.025  # of the draws may have no value at a code before the interval is open
        lost = np.isnan(every).mean(0) > most_lost
        best = self.laws[0]
        outside = np.maximum(best.low - codes, codes - best.high) / (best.high - best.low)
        each = np.stack([law.log_value(codes) for law in self.laws])
        weight = np.array([law.weight for law in self.laws])[:, None] * np.isfinite(each)
        mean = (weight * np.nan_to_num(each)).sum(0) / np.maximum(weight.sum(0), 1e-12)
        mean = np.where(np.isnan(each[0]), np.nan, mean)
        values = np.exp(np.stack([mean, np.where(lost, np.nan, low), np.where(lost, np.nan, high)]))
        return {**dict(zip(("value", "low", "high"), values, strict=True)), "beyond": np.maximum(outside, 0.0).max(1)}

    def at(self, setting: Mapping[str, float], seed: int = 0) -> dict[str, Any]:
        """The entry of a prediction in JSON at one setting of all its codes."""
        prediction = {
            key: float(a[0]) for key, a in self.predict(np.array([[setting[c] for c in self.codes]]), seed).items()
        }
        finite = {key: value if np.isfinite(value) else None for key, value in prediction.items()}
        return {
            "quantity": self.name, "codes": {c: setting[c] for c in self.codes}, "value": finite["value"],
            "interval_95": [finite["low"], finite["high"]], "unit": self.unit, "law": self.laws[0].form.name,
            "extrapolated": prediction["beyond"] > 0.0, "note": self._note(finite["value"], prediction["beyond"]),
        }  # fmt: skip

    def _note(self, value: float | None, beyond: float) -> str:
        if value is None:
            return "the law has no value at this code"
        if beyond > BEYOND:
            return f"{beyond:.1f} ranges outside the measured codes: only the law's form speaks for it"
        return "outside the measured codes" if beyond > 0.0 else ""

    def prior(self, setting: Mapping[str, float]) -> tuple[float, float] | str:
        """(mean, standard deviation) of the logarithm at a setting, or why there is none, in words."""
        missing = [code for code in self.codes if code not in setting]
        if missing:
            return f"{', '.join(missing)} not stated"
        prediction = self.at(setting)
        low, high = prediction["interval_95"]
        if low is None or high is None or prediction["value"] is None:
            return "the law leaves it open there"
        mean = float(np.log(prediction["value"]))
        return mean, float(max(np.log(high) - mean, mean - np.log(low))) / Z95


def read_laws(folder: Path) -> dict[str, Quantity]:
    """Quantity → its laws, of a folder of `pixelid biases`, its biases.json, or a shipped .toml.

    Raises:
        InputError: no such file, a damaged one, or one without laws.
    """
    path = Path(folder) if Path(folder).suffix in (".json", ".toml") else Path(folder) / FILE
    if not path.is_file():
        raise InputError(f"{path}: expected the folder of a `pixelid biases` result, found no such file")
    content = read_toml(path) if path.suffix == ".toml" else read_json(path)
    with interpreting(path, "the laws of a `pixelid biases` result"):
        laws = {name: Quantity.of(name, entry) for name, entry in content["quantities"].items() if "rivals" in entry}
    if not laws:
        raise InputError(f"{path}: expected fitted laws, found none (a prediction?)")
    return laws
