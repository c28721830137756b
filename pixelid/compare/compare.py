"""Model comparison: log-likelihood of pixels that a fit has not seen, BIC, and PSIS-LOO from posteriors.

Pixels are the exchangeable unit: events of one pixel share its thresholds and are not independent, so
whole pixels are held out, and differences between models are paired over pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.stats import t as student

from pixelid.arrays import load_arrays, save_arrays
from pixelid.documents import interpreting
from pixelid.errors import InputError
from pixelid.fit import FitResult, fit
from pixelid.fit.data import as_fitted, event_times_of
from pixelid.fit.search import check_event_times
from pixelid.model.files import save_model
from pixelid.model.model import Model
from pixelid.outputs import file_name
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import only
from pixelid.results import Result, Table, check_kinds, read_result, required
from pixelid.status import Status


@dataclass(frozen=True)
class Contender:
    """One model: its fit to everything, bic (smaller is better), held_out (pixels,) log-likelihood, and PSIS-LOO
    {"elpd", "se", "worst_k_hat", "status" of the posterior} when posteriors were drawn."""

    result: FitResult
    bic: float
    held_out: np.ndarray
    loo: Mapping[str, Any] | None = None


@dataclass(frozen=True, repr=False)
class Comparison(Result):
    """A finished comparison.

    Attributes:
        contenders: by the name of their model.
        best: the name with the highest held-out log-likelihood.
        sentence: what to conclude.

    Example:
        >>> from pixelid.compare.compare import Comparison
        >>> Comparison.load("compare").to_dataframe()  # doctest: +SKIP
    """

    FILE: ClassVar[str] = "compare.json"

    contenders: Mapping[str, Contender]
    best: str
    sentence: str

    @property
    def status(self) -> Status:
        """The least trustworthy of the fits and posteriors."""
        posteriors = [c.loo["status"] for c in self.contenders.values() if c.loo is not None]
        return Status.worst([*(c.result.status for c in self.contenders.values()), *posteriors])

    @property
    def advice(self) -> str:
        """Which fits cannot be trusted and why, in words, and whether the choice of the best rests on any of them."""
        troubled = {name: c.result for name, c in self.contenders.items() if c.result.status != Status.converged}
        said = [f"{name}, {fit.status}: {fit.advice or fit.status.advice}" for name, fit in troubled.items()]
        if troubled and not {self.best, *_undecided(self.contenders, self.best)} & troubled.keys():
            only = "clear losers are" if len(troubled) > 1 else "a clear loser is"
            said.append(f"Only {only} not to be trusted ({', '.join(troubled)}): the others ended well.")
        late = [name for name, c in self.contenders.items() if c.loo and c.loo["status"] != Status.converged]
        if late:
            said.append(f"{', '.join(late)}, posterior: {Status.not_converged.advice}")
        return " ".join(text if text.endswith(".") else f"{text}." for text in said)

    @property
    def headline(self) -> str:
        """The best, and how the fits ended."""
        return f"comparison of {len(self.contenders)} models: {self.best} predicts best; {self.status}"

    def tables(self) -> list[Table]:
        """Models on held-out pixels."""
        rows = tuple(
            (name, str(row["free_parameters"]), f"{row['held_out_log_likelihood']:.1f}",
             f"{row['behind_best_nats']:.4g} ± {row['behind_best_se']:.2g}", f"{row['bic']:.1f}", row["status"])
            for name, row in self.as_dict()["models"].items()
        )  # fmt: skip
        headings = ("model", "free", "held-out [nats]", "behind the best", "BIC", "status")
        return [Table("", headings, rows, frozenset({"model", "status"}))]

    def records(self) -> list[dict]:
        """One row per model."""
        rows = self.as_dict()["models"].items()
        return [{"model": name, **{k: v for k, v in row.items() if k != "loo"}} for name, row in rows]

    def sentences(self) -> list[str]:
        """What to conclude."""
        return [self.sentence, self.advice]

    def write_companions(self, folder: Path) -> None:
        """Write the fitted models as NAME.toml, each fit into fits/NAME, and held_out.npz: (pixels,) of each model."""
        for name, contender in self.contenders.items():
            place = folder / "fits" / file_name(name)
            save_model(contender.result.model, folder / f"{file_name(name)}.toml")
            place.mkdir(parents=True, exist_ok=True)
            contender.result.write(place)
        save_arrays(folder / "held_out.npz", {name: c.held_out for name, c in self.contenders.items()})

    def write_figures(self, folder: Path, recordings: Sequence[Recording] = ()) -> None:
        """Draw the models on held-out pixels."""
        from pixelid.compare.figures import draw_held_out
        from pixelid.figures.style import save_figure

        save_figure(draw_held_out(self.as_dict()), folder / "held_out.svg")

    @classmethod
    def load(cls, folder: str | Path) -> Comparison:
        """The comparison of a folder, with its fits.

        Args:
            folder: that `save` or `pixelid compare` wrote.

        Returns:
            The comparison, as good as new.

        Raises:
            InputError: no comparison there, or a damaged one.
        """
        folder = Path(folder)
        content = read_result(folder, cls.FILE)
        check_kinds(content, folder / cls.FILE, text=("best", "sentence"), a_table=("models",))
        held_out = load_arrays(folder / "held_out.npz")
        with interpreting(folder / cls.FILE, "a comparison"):
            models, best, sentence = required(content, folder, cls.FILE, "models", "best", "sentence")
            contenders = {
                name: Contender(
                    FitResult.load(folder / "fits" / file_name(name)), row["bic"], held_out[name], _read_loo(row["loo"])
                )
                for name, row in models.items()
            }
            if best not in contenders:
                raise ValueError(f"the best, {best}, is none of the models")
            return cls(contenders, best, sentence)

    def as_dict(self) -> dict:
        """The content of compare.json."""
        best = self.contenders[self.best]
        table = {}
        for name, c in self.contenders.items():
            gain = c.held_out - best.held_out
            table[name] = {
                "status": c.result.status,
                "log_likelihood": c.result.log_likelihood,
                "free_parameters": len(c.result.coordinates),
                "bic": c.bic,
                "held_out_log_likelihood": float(c.held_out.sum()),
                "behind_best_nats": float(gain.sum()),
                "behind_best_se": standard_error(gain),
                "loo": None if c.loo is None else dict(c.loo),
            }
        first = best.result
        return {
            "status": self.status,
            "advice": self.advice,
            "best": self.best,
            "sentence": self.sentence,
            "models": table,
            "seed": first.seed,
            "versions": dict(first.versions),
            "inputs_sha256": dict(first.inputs_sha256),
        }


def standard_error(differences: np.ndarray) -> float:
    """Standard error of the sum of paired differences over pixels."""
    return float(np.sqrt(len(differences)) * differences.std(ddof=1)) if len(differences) > 1 else float("inf")


def compare(
    recordings: Sequence[Recording],
    models: Sequence[Model],
    *,
    folds: int = 2,
    between: str = "auto",
    seed: int = 0,
    posteriors: bool = False,
    progress: Callable[[str, float], None] | None = None,
) -> Comparison:
    """Fit every model and judge it on held-out pixels.

    Args:
        recordings: with pixel addresses and stimuli.
        models: two or more, of different names.
        folds: the pixels are dealt at random into so many parts, each predicted by a fit to the others.
        between: how the stimulus runs between its samples: "linear", "smooth" or "auto".
        seed: of the folds and of the fits' starts.
        posteriors: also PSIS-LOO over pixels, from draws (slower).
        progress: called with what is done and the fraction.

    Returns:
        Every model's fit and held-out log-likelihood, and what to conclude.

    Raises:
        InputError: fewer than two models, two of one name, one without threshold noise, and fewer pixels than folds.
    """
    names = [model.name for model in models]
    if len(models) < 2 or len({file_name(name).casefold() for name in names}) < len(names):
        raise InputError(f"compare: expected two or more models of different names, found {', '.join(names) or 'none'}")
    for model in models:
        check_event_times(model)
    if pooled := [r.name for r in recordings if r.pooled]:
        raise InputError(f"compare: expected events of single pixels, to hold some of them out; {pooled[0]} is pooled")
    report = progress or (lambda what, fraction: None)
    recordings = as_fitted(recordings)
    pixels = np.unique(np.concatenate([r.events.pixel for r in recordings]))
    if len(pixels) < folds or folds < 2:
        raise InputError(f"compare: expected at least 2 folds and as many pixels, found {folds} and {len(pixels)}")
    part = np.random.default_rng(seed).permutation(len(pixels)) % folds
    contenders = {}
    for i, model in enumerate(models):
        report(f"fitting {model.name}", i / len(models))
        result = fit(recordings, model, between=between, seed=seed)
        kind = result.details["stimulus_between_samples"]
        held_out = []
        for fold in range(folds):
            report(f"holding out pixels of {model.name}", (i + (fold + 1) / (folds + 1)) / len(models))
            seen, unseen = pixels[part != fold], pixels[part == fold]
            trained = fit(only(recordings, seen), result.model, starts=0, between=kind, seed=seed)
            held_out.append(event_times_of(trained, only(recordings, unseen)).terms(trained.x).per_pixel)
        bic = len(result.coordinates) * np.log(result.events) - 2.0 * result.log_likelihood
        loo = _loo(result, recordings, seed) if posteriors else None
        contenders[model.name] = Contender(result, float(bic), np.concatenate(held_out), loo)
    best = max(contenders, key=lambda name: contenders[name].held_out.sum())
    report("done", 1.0)
    return Comparison(contenders, best, _sentence(contenders, best) + _about_loo(contenders))


def _loo(result: FitResult, recordings: Sequence[Recording], seed: int) -> dict[str, Any]:
    """PSIS-LOO over pixels (Vehtari, Gelman & Gabry 2017, Stat. Comput. 27)."""
    import warnings

    from arviz_stats.loo.loo import loo

    from pixelid.sample import sample
    from pixelid.sample.groups import inference_data

    posterior = sample(result, recordings, seed=seed)
    data = inference_data(posterior, result, recordings, predictive_draws=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pointwise = loo(data, var_name="pixel", pointwise=True)
    worst = float(np.max(pointwise.pareto_k))
    return {
        "elpd": float(pointwise.elpd), "se": float(pointwise.se), "worst_k_hat": worst, "status": posterior.status
    }  # fmt: skip


def _read_loo(entry: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Of compare.json, where earlier versions said nothing of the posterior."""
    return None if entry is None else {**entry, "status": Status(entry.get("status", Status.converged))}


def _about_loo(contenders: Mapping[str, Contender]) -> str:
    """What PSIS-LOO says of each model, and of which it cannot be relied on; nothing where no posterior was drawn."""
    known = {name: c.loo for name, c in contenders.items() if c.loo is not None}
    if not known:
        return ""
    said = ", ".join(f"{name} {loo['elpd']:.1f} ± {loo['se']:.2g}" for name, loo in known.items())
    most_k_hat = 0.7  # Pareto shape from which on importance weights cannot be relied on (`sample.k_hat`)
    doubted = [f"{name} (k̂ {loo['worst_k_hat']:.2f})" for name, loo in known.items() if loo["worst_k_hat"] > most_k_hat]
    doubted += [f"{name} (not converged)" for name, loo in known.items() if loo["status"] != Status.converged]
    words = f"; not to be relied on for {', '.join(doubted)}: go by the held-out pixels" if doubted else ""
    return f". PSIS-LOO over pixels, in nats: {said}{words}"


def _undecided(contenders: Mapping[str, Contender], best: str) -> list[str]:
    """Models that held-out pixels do not distinguish from the best, nearest first; the others have clearly lost."""
    gains = {name: contenders[best].held_out - c.held_out for name, c in contenders.items() if name != best}
    decisive = 0.975  # chance below which a paired held-out difference stays, by Student's t over pixels
    needed = float(student.ppf(decisive, len(contenders[best].held_out) - 1))
    order = sorted(gains, key=lambda name: float(gains[name].sum()))
    return [name for name in order if gains[name].sum() <= needed * standard_error(gains[name])]


def _sentence(contenders: Mapping[str, Contender], best: str) -> str:
    gains = {name: contenders[best].held_out - c.held_out for name, c in contenders.items() if name != best}
    pixels = len(contenders[best].held_out)
    said = {name: f"{gain.sum():.4g} ± {standard_error(gain):.2g} nats" for name, gain in gains.items()}
    open_ = _undecided(contenders, best)
    if not open_:
        nearest = min(gains, key=lambda name: float(gains[name].sum()))
        return f"the data support {best}: held-out pixels are {said[nearest]} likelier than under {nearest}"
    simpler = min((best, *open_), key=lambda name: len(contenders[name].result.coordinates))
    few_pixels = 8  # whose scatter is known to a quarter
    few = "" if pixels >= few_pixels else f"; {pixels} pixels are few to decide by"
    others = " and ".join(f"{name} ({said[name]})" for name in open_)
    return f"the data do not decide between {best} and {others}: take the simplest, {simpler}{few}"
