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
from pixelid.options import Checked, option, options_of
from pixelid.outputs import refuse_existing, whole_folder
from pixelid.parameters.gauge import Gauge
from pixelid.recordings import open_recordings
from pixelid.recordings.crop import Crop
from pixelid.recordings.events import MOST_PIXELS, MOST_SIDE
from pixelid.recordings.selection import named_apart

BETWEEN = ("auto", "linear", "smooth")
LISTS = ("recordings", "with", "without", "fix", "gauge")  # of texts


@dataclass(frozen=True)
class Settings(Checked):
    """How a fit is made."""

    between: str = option("auto", "How stimuli run between their samples.", choices=BETWEEN)
    seed: int = option(0, "Of everything random.", low=0, high=2**32 - 1)
    sample: bool = option(False, "Also draw from the posterior.")
    profile: bool = option(False, "Also profile every parameter.")
    engine: str = option("casadi", "What maximises.", choices=ENGINES)
    form: str = option("discrete", "Linearised once per step of the stimulus, or continuous in time.", choices=FORMS)
    pixel_levels: str = option("", '"gain", "background" or "both" of every pixel unknown.')


@dataclass(frozen=True)
class _Cut(Checked):
    """The cut that a recipe asks for; see `recordings.crop.Crop`."""

    roi: tuple[int, ...] | None = option(None, "Columns and rows.", low=0, high=MOST_SIDE, count=4)
    time: tuple[float, ...] | None = option(None, "From, to.", count=2)
    pixels: int | None = option(None, "How many.", low=1, high=MOST_PIXELS)
    without_hot_pixels: bool = option(False, "Leave them out.")

    def crop(self) -> Crop:
        """The cut."""
        return Crop(self.roi, self.time, self.pixels, self.without_hot_pixels)  # type: ignore[arg-type]


OWN = tuple(of.name for of in options_of(Settings))
CUT = tuple(of.name for of in options_of(_Cut))
KEYS = {"model", "bias_priors", *LISTS, *OWN, *CUT}


@dataclass(frozen=True, kw_only=True)
class Recipe(Settings):
    """Everything a fit needs to run again."""

    recordings: tuple[Path, ...]
    model: str
    with_: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    fix: tuple[str, ...] = ()
    gauge: tuple[str, ...] = ()
    crop: Crop = field(default_factory=Crop)
    bias_priors: bool | str = False

    @staticmethod
    def of(
        recordings, model, with_, without, fix, gauge, between, seed, sample: bool = False, profile: bool = False
    ) -> Recipe:
        """A recipe from sequences of command-line words."""
        return Recipe(
            recordings=tuple(map(Path, recordings)), model=model, with_=tuple(with_), without=tuple(without),
            fix=tuple(fix), gauge=tuple(gauge), between=between, seed=seed, sample=sample, profile=profile,
        )  # fmt: skip

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
    if unknown := set(document) - KEYS:
        meant = did_you_mean(min(unknown), KEYS) if len(unknown) == 1 else ""
        raise InputError(f"{path}: unknown keys {', '.join(sorted(unknown))}; known: {', '.join(sorted(KEYS))}{meant}")
    for key in ("recordings", "model"):
        if key not in document:
            raise InputError(f"{path}: [fit] {key} is missing")

    def words(key: str) -> tuple[str, ...]:
        value = document.get(key, [])
        if not isinstance(value, list) or not all(isinstance(word, str) for word in value):
            raise InputError(f"{path}: [fit] {key} must be a list of strings")
        return tuple(value)

    base, model, priors = path.resolve().parent, document["model"], document.get("bias_priors", False)
    if not isinstance(model, str):
        raise InputError(f"{path}: [fit] model must be a string, found {shown(model)}")
    if not isinstance(priors, bool | str):
        raise InputError(f"{path}: [fit] bias_priors must be true, false or a folder, found {shown(priors)}")
    try:
        return Recipe(
            recordings=tuple(base / name for name in words("recordings")),
            model=str(base / model) if model and (base / model).exists() else model,
            with_=words("with"), without=words("without"), fix=words("fix"), gauge=words("gauge"),
            crop=_Cut(**{key: document[key] for key in CUT if key in document}).crop(),
            bias_priors=str(base / priors) if isinstance(priors, str) else priors,
            **{key: document[key] for key in OWN if key in document},
        )  # fmt: skip
    except InputError as error:
        raise InputError(f"{path}: [fit] {str(error).removeprefix(f'{path}: [fit] ')}") from None
