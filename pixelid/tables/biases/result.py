"""What tables of bias codes show: the content of biases.json, fitted or predicted, and its figures."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.stats import t as student

from pixelid.biases.laws import stated_codes
from pixelid.biases.saved import FILE, Quantity, read_laws
from pixelid.errors import InputError
from pixelid.figures.style import save_figure
from pixelid.model.shipped import shipped_bias_laws
from pixelid.outputs import file_name
from pixelid.parameters.parameter import OPEN_SD
from pixelid.provenance import provenance
from pixelid.results import ContentResult, Table, interval, number
from pixelid.statistics import Z95
from pixelid.status import Status
from pixelid.tables.biases.figures import draw_law
from pixelid.tables.biases.fit import FittedLaw, departure_variance, fit_laws, natural_values
from pixelid.tables.biases.mismatch import mismatch_sentences, of_maps, of_spreads
from pixelid.tables.biases.reading import BiasTable, Stated, is_rates, read_bias_tables, read_cutoffs
from pixelid.tables.fit import SUSPECT_SCALES, misses
from pixelid.tables.result import open_sentences

HEADINGS = ("quantity", "parameter", "value", "95 % interval", "unit")


@dataclass(frozen=True, repr=False)
class BiasLaws(ContentResult):
    """Laws of bias codes.

    content: of biases.json (docs/howto/biases.md)
    """

    FILE: ClassVar[str] = FILE

    @property
    def headline(self) -> str:
        """Quantities and status."""
        return f"biases: {', '.join(self.content['quantities']) or 'no quantity'}; {self.status}"

    def tables(self) -> list[Table]:
        """The laws' parameters, and what was asked for."""
        rows = tuple(
            (name, key, number(p["value"]), interval(p["interval_95"]), p["unit"])
            for name, law in self.content["quantities"].items()
            for key, p in law.get("parameters", {}).items()
        )
        asked = tuple(tuple(row) for row in prediction_rows(self.content))
        words = frozenset({"quantity", "parameter", "unit", "codes", "note"})
        return [Table("", HEADINGS, rows, words), Table("predictions", PREDICTION_HEADINGS, asked, words)]

    def records(self) -> list[dict[str, Any]]:
        """One row per quantity and parameter."""
        return [
            {"name": f"{name}: {key}", "law": law["law"], **p}
            for name, law in self.content["quantities"].items()
            for key, p in law.get("parameters", {}).items()
        ]

    def sentences(self) -> list[str]:
        """What was inferred, advice, outliers, rivals, and what is left open."""
        of_laws = [s for law in self.content["quantities"].values() for s in law["sentences"]]
        own = [*self.content["inferred"], self.content["advice"], *of_laws, *self.content["mismatch_sentences"]]
        return [s for s in [*own, *self.content["unidentified"]] if s]

    def write_companions(self, folder: Path) -> None:
        """One figure per quantity."""
        laws = {name: Quantity.of(name, law) for name, law in self.content["quantities"].items() if "rivals" in law}
        for name, entry in self.content["quantities"].items():
            draw = partial(draw_law, name, entry, laws.get(name))
            if any(row["measured"] is not None for row in entry["rows"]):
                save_figure(draw(), folder / f"{file_name(name)}.svg")


PREDICTION_HEADINGS = ("quantity", "codes", "predicted", "95 %", "unit", "note")


def prediction_rows(content: Mapping[str, Any]) -> list[list[str]]:
    """The predictions of single settings as cells."""
    return [
        [one["quantity"], ", ".join(f"{code} {value:g}" for code, value in one["codes"].items()), number(one["value"]),
         interval(one["interval_95"]), one["unit"], one["note"]]
        for one in content["predictions"]
    ]  # fmt: skip


def bias_laws(
    tables: Sequence[Path],
    *,
    laws: Path | None = None,
    at: Sequence[str] = (),
    stated: Stated = Stated(),
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> BiasLaws:
    """Fit laws to tables, or evaluate saved ones on them.

    Args:
        tables: CSV files, folders of `pixelid rates`, and .npz files of threshold maps.
        laws: folder of an earlier result that is evaluated instead of a fit, or a shipped circuit's name.
        at: settings to predict, "NAME=CODE,…" each.
        stated: columns and unit that the tables do not name.
        seed: of the draws behind intervals.
        progress: called with what is done and the fraction.

    Raises:
        InputError: tables that are ambiguous or too small, or codes that no law is of.
    """
    began = time.perf_counter()
    maps, rates = [p for p in tables if p.suffix.lower() == ".npz"], [p for p in tables if is_rates(p)]
    files = [p for p in tables if p not in maps and p not in rates]
    measured, inferred = read_bias_tables(files, stated, measured=laws is None)
    for table, line in map(read_cutoffs, rates):
        measured.append(table)
        inferred.append(line)
    quantities, entries = {}, {}
    if laws is None:
        for k, table in enumerate(measured):

            def report(done: float, k: int = k, name: str = table.name) -> None:
                if progress is not None:
                    progress(name, (k + done) / len(measured))

            entries[table.name] = fitted_entry(table, fit_laws(table, report), seed)
        quantities = {name: Quantity.of(name, entry) for name, entry in entries.items()}
    else:
        laws = shipped_bias_laws(laws) or laws
        quantities = read_laws(laws)
        for table in measured:
            for name in _asked(table, quantities):
                entries[name] = predicted_entry(table, quantities[name], seed)
    mismatch = [one for table in measured if (one := of_spreads(table)) is not None]
    mismatch += [one for path in maps for one in of_maps(path)]
    known = list(dict.fromkeys(code for each in quantities.values() for code in each.codes))
    settings = [stated_codes([words], known, "--at") for words in at]
    predictions = [each.at(setting, seed) for setting in settings for each in quantities.values()
                   if set(each.codes) <= set(setting)]  # fmt: skip
    predictions += [quantities[name].at(dict(zip(quantities[name].codes, row, strict=True)), seed)
                    for name, entry in entries.items() if laws is not None
                    for row in _unmeasured(entry, quantities[name].codes)]  # fmt: skip
    inputs = list(dict.fromkeys([*maps, *(source for table in measured for source in table.sources)]))
    status = Status.worst(Status(entry["status"]) for entry in entries.values())
    advice = "; ".join(f"{name}: {e['advice']}" for name, e in entries.items() if e["advice"])
    origin = [] if laws is None else [Path(laws) / FILE if Path(laws).is_dir() else Path(laws)]
    return BiasLaws({
        "status": status, "advice": advice, "inferred": inferred, "quantities": entries, "mismatch": mismatch,
        "mismatch_sentences": mismatch_sentences(mismatch), "predictions": predictions,
        "unidentified": [f"{name}: {s}" for name, e in entries.items() for s in e.get("unidentified", [])],
        "seed": seed, "seconds": time.perf_counter() - began, **provenance(*inputs, *origin),
    })  # fmt: skip


def _asked(table: BiasTable, quantities: Mapping[str, Quantity]) -> list[str]:
    """Names of the laws that a table asks for: its quantity, or where it holds codes alone, all of these codes."""
    names = [n for n, q in quantities.items() if set(q.codes) <= set(table.codes) and table.name in ("", n)]
    if not names:
        laws = "; ".join(f"{n} of {', '.join(q.codes)}" for n, q in quantities.items())
        raise InputError(
            f"{table.sources[0]}: no law of {table.name or 'a quantity'} of {', '.join(table.codes)}: {laws}"
        )
    return names


def _unmeasured(entry: Mapping[str, Any], codes: Sequence[str]) -> list[list[float]]:
    """Settings of the rows that ask only."""
    return [[row[code] for code in codes] for row in entry["rows"] if row["measured"] is None]


def fitted_entry(table: BiasTable, fitted: Sequence[FittedLaw], seed: int) -> dict[str, Any]:
    """What biases.json shows of a fitted quantity."""
    best = fitted[0]
    status, advice = best.regression.judge()
    if not best.usable and status == Status.converged:
        status, advice = Status.not_identified, "the rows fix no law's parameters: measure at more codes"
    entries, wider = {}, float(student.ppf(0.975, best.law.freedom)) / Z95
    for k, (name, (value, sd, ends)) in enumerate(natural_values(best.law, seed).items()):
        relative = sd / abs(value) if name == "scale" else wider * best.regression.sd[k]
        known = bool(best.regression.converged and relative < OPEN_SD)
        entries[name] = {
            "value": value, "unit": best.law.unit_of(name, table.unit), "std": sd if known else None,
            "interval_95": ends, "identified": known,
        }  # fmt: skip
    law = best.law
    codes = {
        code: {"range": [float(low), float(high)], "reference": float(middle)}
        for code, low, high, middle in zip(law.codes, law.low, law.high, law.centre, strict=True)
    }
    rivals = [
        {"law": one.law.form.name, "coordinates": len(one.law.x),
         "bic": one.bic - best.bic, "weight": one.law.weight, "relative_scatter": one.law.scatter,
         "usable": one.usable, **_heldout(one), **({"fit": one.law.as_dict()} if one.law.weight else {})}
        for one in fitted
    ]  # fmt: skip
    return {
        "status": status, "advice": advice, "law": law.form.name, "equation": law.form.equation, "why": law.form.why,
        "unit": table.unit, "parameter": table.parameter, "codes": codes, "parameters": entries,
        "unidentified": open_sentences(entries, at_rest=best.regression.converged),
        "relative_scatter": best.regression.scale, "departure_variance": departure_variance(table, best),
        "log_likelihood": best.regression.log_likelihood,
        "rows_fitted": len(table.measured), "rivals": rivals, "sentences": _sentences(table, fitted),
        "rows": best.regression.as_rows(),
    }  # fmt: skip


def _heldout(one: FittedLaw) -> dict[str, Any]:
    """Errors of settings left out: rms and largest |ln predicted/measured|; None where none could be."""
    h = np.array([]) if one.heldout is None else one.heldout[np.isfinite(one.heldout)]
    return {"heldout_rms": float(np.sqrt((h**2).mean())) if len(h) else None,
            "heldout_median": float(np.median(np.abs(h))) if len(h) else None,
            "heldout_largest": float(np.abs(h).max()) if len(h) else None}  # fmt: skip


def _sentences(table: BiasTable, fitted: Sequence[FittedLaw]) -> list[str]:
    """The law, its rivals, its outlier rows, and where it ends, in words."""
    best, sentences = fitted[0], []
    low, high = best.law.low, best.law.high
    ranges = ", ".join(f"{c} {a:g} to {b:g}" for c, a, b in zip(table.codes, low, high, strict=True))
    sentences.append(
        f"{table.name}: {best.law.form.name} ({best.law.form.why}), scatter {100 * best.law.scatter:.2g} %, measured "
        f"at {ranges}; outside, intervals rest on the form"
    )
    undecided = 0.05  # weight from which a rival is named: odds of 19 to 1 and less
    close = [one.law.form.name for one in fitted[1:] if one.law.weight > undecided]
    if close:
        sentences.append(
            f"{table.name}: {', '.join(close)} describes the rows about as well, and is part of the intervals"
        )
    r = best.regression
    for k in np.argsort(-np.abs(r.residual)):
        if abs(r.residual[k]) > SUSPECT_SCALES:
            at = ", ".join(f"{c} {v:g}" for c, v in zip(table.codes, table.code[k], strict=True))
            sentences.append(
                f"{table.name} at {at}: measured {table.measured[k]:.4g}, the law has {r.predicted[k]:.4g} "
                f"{table.unit}: {r.residual[k]:+.0f} scales; down-weighted to {100 * r.weight[k]:.1g} %"
            )
    return sentences


def predicted_entry(table: BiasTable, quantity: Quantity, seed: int) -> dict[str, Any]:
    """What biases.json shows of a quantity that a saved law predicts."""
    order = [table.codes.index(code) for code in quantity.codes]
    code, measured = table.code[:, order], table.measured
    if table.unit and table.unit != quantity.unit:
        raise InputError(f"{table.sources[0]}: {table.name}: expected {quantity.unit}, found {table.unit}")
    prediction = quantity.predict(code, seed)
    value, rounding = prediction["value"], 0.5 * table.last_digit
    low, high = np.maximum(prediction["low"] - rounding, 0.0), prediction["high"] + rounding
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.log(measured / value)
        sd = np.maximum(np.log(high / value), np.log(value / low)) / Z95
    known = np.isfinite(ratio)
    wrong = misses(-ratio[known], (ratio / sd)[known]) if known.any() else ""
    rows = [
        {**dict(zip(quantity.codes, map(float, code[k]), strict=True)), "measured": float(measured[k]),
         "predicted": float(value[k]), "interval_95": [_finite(float(low[k])), _finite(float(high[k]))],
         "standardised": float(ratio[k] / sd[k]), "extrapolated": bool(prediction["beyond"][k] > 0.0)}
        for k in range(len(code))
    ]  # fmt: skip
    inside = (measured >= low) & (measured <= high)
    sentences = [] if not known.any() else [
        f"{quantity.name}: {known.sum()} rows predicted within {100 * np.sqrt((ratio[known] ** 2).mean()):.2g} % rms "
        f"(largest {100 * np.abs(ratio[known]).max():.2g} %); {inside[known].mean():.0%} inside their 95 % intervals"
    ]  # fmt: skip
    nowhere = int((~np.isfinite(value)).sum())
    if nowhere:
        sentences.append(f"{quantity.name}: the law has no value in {nowhere} rows")
    return {
        "status": Status.misfit if wrong else Status.converged,
        "advice": f"the law misses what was measured {wrong}: fit it to this table" if wrong else "",
        "law": quantity.laws[0].form.name, "unit": quantity.unit, "parameter": quantity.parameter,
        "rms": float(np.sqrt((ratio[known] ** 2).mean())) if known.any() else None, "sentences": sentences,
        "rows": [{key: _finite(value) for key, value in row.items()} for row in rows],
    }  # fmt: skip


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not np.isfinite(value) else value
