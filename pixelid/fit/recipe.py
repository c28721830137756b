"""Fit recipes: a whole fit as a value, from the command line or from a TOML file.

[fit]
recordings = ["session/"]       files or folders, relative to the recipe
model = "dvs128"                a shipped name, a model file or a fit folder
with = ["leak:rate_hz=0.1"]     effects to add
without = ["refractory_period"] effects to remove
fix = ["gamma=1.12"]            parameters to hold
gauge = ["q_in=0.875"]          statements for physical values
between = "auto"                "linear", "smooth" or "auto"
engine = "casadi"               "casadi", "torch" or "scipy"
form = "discrete"               "discrete" or "continuous"
pixel_levels = ""               "gain", "background" or "both" of every pixel unknown; "gain=0.2": by that much
bias_priors = false             priors from the bias settings in the recordings' headers; "laws/": by fitted laws
sample, profile = false         also draw from the posterior, also profile every parameter
roi = [0, 0, 64, 64]            only these columns and rows (as --roi), time = [0.0, 0.5], pixels = 25,
without_hot_pixels = true       likewise
seed = 0
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from pixelid.documents import read_toml
from pixelid.errors import InputError, did_you_mean, shown
from pixelid.fit.engines import ENGINES, FORMS
from pixelid.fit.fit import fit
from pixelid.fit.levels.pixel_levels import Wanted
from pixelid.fit.result import FitResult
from pixelid.model.model import Model
from pixelid.model.options import assignment, changed
from pixelid.model.shipped import find_model
from pixelid.outputs import refuse_existing, whole_folder
from pixelid.parameters.gauge import Gauge
from pixelid.recordings import open_recordings
from pixelid.recordings.crop import Crop
from pixelid.recordings.selection import named_apart

_KEYS = {
    "recordings",
    "model",
    "with",
    "without",
    "fix",
    "gauge",
    "between",
    "seed",
    "sample",
    "profile",
    "engine",
    "form",
    "pixel_levels",
    "bias_priors",
    "roi",
    "time",
    "pixels",
    "without_hot_pixels",
}


@dataclass(frozen=True)
class Recipe:
    """Everything a fit needs to run again."""

    recordings: tuple[Path, ...]
    model: str
    with_: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    fix: tuple[str, ...] = ()
    gauge: tuple[str, ...] = ()
    between: str = "auto"
    seed: int = 0
    sample: bool = False
    profile: bool = False
    engine: str = "casadi"
    form: str = "discrete"
    crop: Crop = field(default_factory=Crop)
    pixel_levels: str = ""
    bias_priors: bool | str = False

    @staticmethod
    def of(
        recordings, model, with_, without, fix, gauge, between, seed, sample: bool = False, profile: bool = False
    ) -> Recipe:
        """A recipe from sequences of command-line words."""
        options = tuple(with_), tuple(without), tuple(fix), tuple(gauge)
        return Recipe(tuple(map(Path, recordings)), model, *options, between, seed, sample, profile)

    def prepared_model(self) -> tuple[Model, list[str]]:
        """The model with effects changed and parameters held, and remarks for the user."""
        model, remarks = changed(find_model(self.model), self.with_, self.without, ())
        held = {name: value for name, value in map(assignment, self.fix) if name in model.parameters}
        return model.fix(held), remarks

    def held_nuisances(self, model: Model) -> dict[str, float]:
        """Values of `fix` that are not the model's: light levels, background, pooled pixels of the recordings."""
        return {name: value for name, value in map(assignment, self.fix) if name not in model.parameters}

    def remarks(self) -> list[str]:
        """What the user should know about the options."""
        return self.prepared_model()[1]

    def prepared_gauge(self) -> Gauge | None:
        """The gauge demanded, or None."""
        statements = {}
        for text in self.gauge:
            name, sign, value = text.partition("=")
            if not sign:
                raise InputError(f"--gauge: expected name=value, found {text!r}")
            statements[name.strip()] = value.strip()
        return Gauge.parse(statements) if statements else None

    def prepared_levels(self) -> Wanted | None:
        """The levels of pixels asked for, or None."""
        levels = Wanted.of(self.pixel_levels or None, "--pixel-levels")
        if levels is not None and (self.sample or self.profile):
            option = "--sample" if self.sample else "--profile"
            raise InputError(f"{option}: not with --pixel-levels, whose levels would be held at their estimates")
        return levels

    def run(
        self, out: Path, overwrite: bool = False, progress: Callable[[str, float], None] | None = None
    ) -> FitResult:
        """Fit and write the result folder; nothing is left behind when it fails."""
        from pixelid.report.html import write_report

        model, _ = self.prepared_model()
        gauge, levels = self.prepared_gauge(), self.prepared_levels()
        recordings = named_apart(open_recordings(self.recordings, self.crop, self.seed))
        refuse_existing(out, overwrite)
        result = fit(
            recordings,
            model,
            gauge=gauge,
            fixed=self.held_nuisances(model),
            between=self.between,
            engine=self.engine,
            form=self.form,
            pixel_levels=levels,
            bias_priors=self.bias_priors,
            seed=self.seed,
            progress=progress,
        )
        if self.profile:
            from pixelid.fit.uncertainty.profiles import profiled

            result = profiled(result, recordings, progress)
        with whole_folder(out, overwrite) as folder:
            if self.sample:
                from pixelid.sample.step import sampled

                result = sampled(result, recordings, folder, chain_beside(out), progress)
            result.write(folder)
            result.write_figures(folder, recordings)
            write_report(folder)
        return result


def chain_beside(out: Path) -> Path:
    """Where the chains of an unfinished sampling wait to be continued: next to the result folder, hidden."""
    return out.with_name(f".{out.name}.chain.npz")


def read_recipe(path: Path) -> Recipe:
    """The recipe of a TOML file.  Raises InputError naming the file and the key that is wrong."""
    document = read_toml(path).get("fit")
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected a [fit] table")
    unknown = set(document) - _KEYS
    if unknown:
        meant = did_you_mean(min(unknown), _KEYS) if len(unknown) == 1 else ""
        raise InputError(f"{path}: unknown keys {', '.join(sorted(unknown))}; known: {', '.join(sorted(_KEYS))}{meant}")
    for key in ("recordings", "model"):
        if key not in document:
            raise InputError(f"{path}: [fit] {key} is missing")
    for key in ("model", "between", "pixel_levels"):
        if not isinstance(document.get(key, ""), str):
            raise InputError(f"{path}: [fit] {key} must be a string, found {shown(document[key])}")

    def words(key: str) -> tuple[str, ...]:
        value = document.get(key, [])
        if not isinstance(value, list) or not all(isinstance(word, str) for word in value):
            raise InputError(f"{path}: [fit] {key} must be a list of strings")
        return tuple(value)

    base = path.resolve().parent
    model = document["model"]
    if model and (base / model).exists():
        model = str(base / model)
    return Recipe(
        tuple(base / name for name in words("recordings")),
        model,
        words("with"),
        words("without"),
        words("fix"),
        words("gauge"),
        document.get("between", "auto"),
        _whole_number(document.get("seed", 0), path),
        _yes_or_no(document, "sample", path),
        _yes_or_no(document, "profile", path),
        _choice(document, "engine", ENGINES, path),
        _choice(document, "form", FORMS, path),
        _crop(document, path),
        document.get("pixel_levels", ""),
        str(base / document["bias_priors"])
        if isinstance(document.get("bias_priors"), str)
        else _yes_or_no(document, "bias_priors", path),
    )


def _crop(document, path: Path) -> Crop:
    """The cut that a recipe asks for: roi of four whole numbers, time of two, pixels, without_hot_pixels."""

    def numbers(key: str, count: int, kinds: type | tuple[type, ...]) -> tuple | None:
        value = document.get(key)
        right = isinstance(value, list) and len(value) == count
        if value is not None and not (right and all(isinstance(v, kinds) and not isinstance(v, bool) for v in value)):
            raise InputError(f"{path}: [fit] {key} must be a list of {count} numbers, found {shown(value)}")
        return None if value is None else tuple(value)

    pixels = document.get("pixels")
    if pixels is not None and (not isinstance(pixels, int) or isinstance(pixels, bool) or pixels < 1):
        raise InputError(f"{path}: [fit] pixels must be a positive whole number, found {shown(pixels)}")
    hot = document.get("without_hot_pixels", False)
    if not isinstance(hot, bool):
        raise InputError(f"{path}: [fit] without_hot_pixels must be true or false, found {shown(hot)}")
    return Crop(numbers("roi", 4, int), numbers("time", 2, (int, float)), pixels, hot)


def _choice(document, key: str, known: tuple[str, ...], path: Path) -> str:
    """One of the known words, the recipe's own default when it says nothing."""
    value = document.get(key, getattr(Recipe, key))
    if value not in known:
        raise InputError(f"{path}: [fit] {key} must be one of {', '.join(known)}, found {shown(value)}")
    return value


def _whole_number(value, path: Path) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 32:
        raise InputError(f"{path}: [fit] seed must be a whole number from 0 to 2³² − 1, found {shown(value)}")
    return value


def _yes_or_no(document: dict, key: str, path: Path) -> bool:
    value = document.get(key, False)
    if not isinstance(value, bool):
        raise InputError(f"{path}: [fit] {key} must be true or false, found {shown(value)}")
    return value
