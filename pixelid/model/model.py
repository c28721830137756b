"""A model: a photoreceptor kind, the effects present, and their parameters.  Immutable."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from numbers import Real
from pathlib import Path
from typing import Any

from pixelid import stages
from pixelid.errors import InputError, did_you_mean, shown
from pixelid.outputs import whole_file
from pixelid.parameters.gauge import Gauge
from pixelid.parameters.invariants import Physical
from pixelid.parameters.parameter import RATE_UNIT, Parameter
from pixelid.parameters.units import RADIANCE, goes_with_light, in_light_unit
from pixelid.results import Table, html_page
from pixelid.stages import Circuit, comparator, photoreceptor

DELAY = Parameter("delay_s", 0.0, "s", -10.0, 10.0, "linear", free=False, source="clock of events minus stimulus")
# What only a recording can have for itself: a factor on the light that its stimulus says and what is added to it, what
# its clock is late by, and a factor on both thresholds.
LIGHT_GAIN = Parameter("light_gain", 1.0, "1", 1e-2, 1e2, "log", source="light of a recording over what it says")
THRESHOLD_GAIN = Parameter(
    "threshold_gain", 1.0, "1", 0.1, 10.0, "log", source="thresholds of a recording over the camera's"
)
LIGHT_OFFSET = Parameter("light_offset", 0.0, "radiance", transform="linear", source="zero of a recording's light")
CLOCK_DELAY = Parameter(
    "alignment.delay_s", 0.0, "s", -0.02, 0.02, "linear", source="clock of a recording against its light's"
)
ONLY_OWN = {p.name: p for p in (LIGHT_GAIN, LIGHT_OFFSET, CLOCK_DELAY, THRESHOLD_GAIN)}
# What all recordings of a session have in common and the pixel has not: what the camera counts per second of the light,
# less one.
CLOCK_RATE = Parameter("alignment.clock_rate", 0.0, RATE_UNIT, -1e-3, 1e-3, "linear", source="two clocks")


@dataclass(frozen=True, repr=False)
class Model:
    """A circuit design with values.

    Example:
        >>> import pixelid as px
        >>> px.find_model("dvs128").with_effect("leak", rate_hz=0.1).values["leak.rate_hz"]
        0.1

    photoreceptor: "second_order" | "one_pole" | "unlimited";  effects: names present, in signal order;
    parameters: name → Parameter, exactly those of the photoreceptor, the comparator, the clock and the effects;
    physical, gauge: nominal circuit values and the statements that make them unique, when known;
    light_scale: what the library's unit of light (the fA of a DVS128) is in the numbers of this model's light;
    nuisances: "parameter[recording]" → Parameter, values that a recording has for itself (`with_nuisances`); of a model
    as it was in one recording, its `light_gain`.  They are no part of the pixel, nor of its file.
    """

    name: str
    photoreceptor: str
    effects: tuple[str, ...]
    parameters: Mapping[str, Parameter]
    summary: str = ""
    linearisation: str = "midpoint"
    radiance_unit: str = "radiance"
    physical: Physical | None = None
    physical_source: str = ""
    gauge: Gauge = field(default_factory=Gauge)
    light_scale: float = 1.0
    nuisances: Mapping[str, Parameter] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.linearisation not in ("midpoint", "newer"):
            raise InputError(f"{self.name}: linearisation must be 'midpoint' or 'newer', found {self.linearisation!r}")
        twice = sorted({name for name in self.effects if self.effects.count(name) > 1})
        if twice:
            raise InputError(f"model {self.name}: effects listed twice: {', '.join(twice)}")
        expected = expected_parameters(self.photoreceptor, self.effects)
        missing = [name for name in expected if name not in self.parameters]
        surplus = [name for name in self.parameters if name not in expected]
        if missing or surplus:
            raise InputError(
                f"model {self.name}: "
                + "; ".join(
                    ([f"missing parameters {', '.join(missing)}"] if missing else [])
                    + ([f"parameters without their effect: {', '.join(surplus)}"] if surplus else [])
                )
            )
        if self.radiance_unit != RADIANCE:  # what the library states for light of any unit
            spelled = {name: in_light_unit(p.unit, RADIANCE, self.radiance_unit) for name, p in self.parameters.items()}
            if any(unit != self.parameters[name].unit for name, unit in spelled.items()):
                parameters = {name: replace(p, unit=spelled[name]) for name, p in self.parameters.items()}
                object.__setattr__(self, "parameters", parameters)

    def __repr__(self) -> str:
        return f"model {self.name}: {self._structure}\n{self._table.text()}"

    def _repr_html_(self) -> str:
        return html_page(f"model {self.name}: {self._structure}", [self._table], [self.summary])

    @property
    def _structure(self) -> str:
        return f"{self.photoreceptor} photoreceptor; {', '.join(self.effects) or 'no effects'}"

    @property
    def _table(self) -> Table:
        rows = tuple(
            (p.name, f"{p.value:.6g}", p.unit, "free" if p.free else "fixed") for p in self.parameters.values()
        )
        headings = ("parameter", "value", "unit", "in fits")
        return Table("", headings, rows, frozenset({"parameter", "unit", "in fits"}))

    @property
    def values(self) -> dict[str, float]:
        """Parameter values by name."""
        return {name: parameter.value for name, parameter in self.parameters.items()}

    @property
    def free(self) -> list[str]:
        """Names of the free parameters, in order."""
        return [name for name, parameter in self.parameters.items() if parameter.free]

    @property
    def starts_anew(self) -> tuple[str, ...]:
        """Names of the parameters that every recording has of its own."""
        return tuple(name for effect in self.effects for name in stages.effect(effect).starts_anew)

    def knows(self, nuisance: str) -> bool:
        """Whether the circuit of this model reads a nuisance, by the name that `nuisances` has it under."""
        parameter, _, recording = nuisance.partition("[")
        return nuisance == CLOCK_RATE.name or (
            bool(recording) and (parameter in self.starts_anew or parameter in ONLY_OWN)
        )

    def has(self, effect: str) -> bool:
        """Whether the effect is part of this model, by name or by the structure of its photoreceptor."""
        stages.effect(effect)
        return effect in self.effects or (
            effect == "second_order_photoreceptor" and self.photoreceptor == "second_order"
        )

    def circuit(self, values: Mapping[str, float] | None = None) -> Circuit:
        """The circuit at these parameter values (default: the model's own); values may be complex."""
        values = {**self.values, **{name: p.value for name, p in self.nuisances.items()}, **(values or {})}
        circuit = self._shared_circuit(values)
        if not self.nuisances:
            return circuit
        own: dict[str, dict] = {}
        for name in self.nuisances:
            if "[" not in name:
                continue
            parameter, recording = name[:-1].split("[", 1)
            own.setdefault(recording, {})[parameter] = values[name]
        circuits = {name: self._shared_circuit({**values, **mine}) for name, mine in own.items()}
        return circuit.with_(of_recordings=tuple((name, _differing(one, circuit)) for name, one in circuits.items()))

    def _shared_circuit(self, values: Mapping[str, float]) -> Circuit:
        """The circuit at values of all parameters, nothing in it a recording's own."""
        own = {name: values.get(name, p.value) for name, p in ONLY_OWN.items()}
        circuit = Circuit(
            linearisation=self.linearisation, delay=values["delay_s"] + own[CLOCK_DELAY.name],
            clock_rate=values.get(CLOCK_RATE.name), light_gain=own[LIGHT_GAIN.name],
            threshold_gain=own[THRESHOLD_GAIN.name],
        )  # fmt: skip
        circuit = photoreceptor.apply(self.photoreceptor, circuit, values)
        circuit = comparator.apply(circuit, values)
        for name in self.effects:
            circuit = stages.effect(name).apply(circuit, values)
        offset = own[LIGHT_OFFSET.name]
        if isinstance(offset, float) and offset == 0.0:
            return circuit
        return circuit.with_(dark=circuit.dark + own[LIGHT_GAIN.name] * offset)  # of the trace, as its gain is

    def set(self, values: Mapping[str, float] | None = None, **named: float) -> Model:
        """The model at other values: `set({"leak.rate_hz": 2})`, `set(on_threshold=0.3)`.

        Raises InputError for unknown names, values that are no numbers, and those out of bounds.
        """
        parameters = dict(self.parameters)
        for name, value in {**(values or {}), **named}.items():
            if isinstance(value, bool) or not isinstance(value, Real):
                raise InputError(f"{name}: expected a number, found {shown(value)}")
            parameters[name] = self.parameter(name).at(float(value))
        return replace(self, parameters=parameters)

    def fix(self, values: Mapping[str, float | None]) -> Model:
        """The model with these parameters held fixed, at the given value or (None) where they are."""
        model = self.set({name: value for name, value in values.items() if value is not None})
        parameters = dict(model.parameters)
        for name in values:
            parameters[name] = model.parameter(name).fixed()
        return replace(model, parameters=parameters)

    def release(self, names: Iterable[str]) -> Model:
        """The model with these parameters free."""
        parameters = dict(self.parameters)
        for name in names:
            parameters[name] = self.parameter(name).freed()
        return replace(self, parameters=parameters)

    def parameter(self, name: str) -> Parameter:
        """One parameter.  Raises InputError listing the known names."""
        try:
            return self.parameters[name]
        except KeyError:
            raise InputError(
                f"model {self.name} has no parameter {name!r}; it has {', '.join(self.parameters)}"
                f"{did_you_mean(name, self.parameters)}"
            ) from None

    def with_radiance_in(self, unit: str | None) -> Model:
        """The model with the numbers it has, said to be of radiance in `unit` (None: as before); nothing is converted.

        Priors learned in another unit say nothing of numbers in this one: they are left out of what goes with radiance.
        """
        old = self.radiance_unit
        if unit is None or old.replace("²", "2") == unit:
            return self
        parameters = {name: replace(p, unit=in_light_unit(p.unit, old, unit)) for name, p in self.parameters.items()}
        for name, p in self.parameters.items():
            if old not in (RADIANCE, "relative") and goes_with_light(p.unit, old):
                parameters[name] = replace(parameters[name], prior=None)
        return replace(self, parameters=parameters, radiance_unit=unit)

    def in_light(self, factor: float) -> Model:
        """The same circuit where the numbers of the light are `factor` times as large: α and γ go with 1/light.

        Example:
            >>> import pixelid as px
            >>> model = px.find_model("dvs128")
            >>> model.in_light(10.0).values["alpha"] / model.values["alpha"]
            0.1
        """
        library = expected_parameters(self.photoreceptor, self.effects)
        scaled = {name: p.in_light(factor, library[name].radiance_power) for name, p in self.parameters.items()}
        return replace(self, parameters=scaled, light_scale=self.light_scale * factor)

    def library(self, effect: str) -> tuple[Parameter, ...]:
        """The parameters of an effect of the library, in the unit of this model's light."""
        return tuple(p.in_light(self.light_scale, p.radiance_power) for p in stages.effect(effect).parameters)

    def with_nuisances(self, values: Mapping[str, Mapping[str, float]]) -> Model:
        """The model with values that recordings have for themselves: parameter → recording → value, free in fits.

        They take the place of the shared parameter, which no fit moves any more.  "light_gain", a factor on the
        stimulus, and "threshold_gain", one on both thresholds, are none that a model shares: recordings without one
        have their light as it is stated, and the model's thresholds.

        Example:
            >>> import pixelid as px
            >>> phases = {"mains_flicker.phase_rad": {"chirp_0": 0.5, "steps_1": 2.5}}
            >>> model = px.find_model("dvs128").with_effect("mains_flicker").with_nuisances(phases)
            >>> model.in_recording("steps_1").values["mains_flicker.phase_rad"]
            2.5
        """
        nuisances = dict(self.nuisances)
        for parameter, own in values.items():
            shared = ONLY_OWN[parameter] if parameter in ONLY_OWN else self.parameter(parameter)
            for recording, value in own.items():
                name = f"{parameter}[{recording}]"
                nuisances[name] = replace(shared, name=name, value=float(value), free=True)
        return replace(self, nuisances=nuisances)

    def in_recording(self, recording: str) -> Model:
        """The model as it was in one recording: its own values in place of shared ones."""
        if not self.nuisances:
            return self
        end = f"[{recording}]"
        mine = {name.removesuffix(end): p for name, p in self.nuisances.items() if name.endswith(end)}
        own = {name: p.value for name, p in mine.items() if name not in ONLY_OWN}
        factor = mine[THRESHOLD_GAIN.name].value if THRESHOLD_GAIN.name in mine else 1.0
        kept = {name: p.fixed() for name, p in self.nuisances.items() if "[" not in name}
        of_bench = {name: p for name, p in mine.items() if name in ONLY_OWN and name != THRESHOLD_GAIN.name}
        kept |= {name: replace(p, name=name).fixed() for name, p in of_bench.items()}
        thresholds = {p.name: factor * self.values[p.name] for p in comparator.PARAMETERS if factor != 1.0}
        return replace(self, nuisances=kept).set(own | thresholds)

    def with_effect(self, name: str, values: Mapping[str, float] | None = None, **named: float) -> Model:
        """The model with an effect added (or its values changed when it is there already): `("leak", rate_hz=2)`.

        `values`, `named`: parameter → value, by full name or by the part after the dot; given values stay free.
        Raises InputError for unknown effects and parameters.
        """
        known = {p.name: p for p in self.library(name)}
        full = {}
        for key, value in {**(values or {}), **named}.items():
            long = key if key in known else f"{name}.{key}"
            if long not in known:
                meant = did_you_mean(long, known) or did_you_mean(key, known)
                raise InputError(f"effect {name} has no parameter {key!r}; it has {', '.join(known)}{meant}")
            full[long] = value
        if self.has(name):
            return self.set(full)
        parameters = {**self.parameters, **known}
        kind = self.photoreceptor
        effects = self.effects
        if name == "second_order_photoreceptor":
            kind = "second_order"
            parameters.pop("alpha_over_beta", None)
        else:
            effects = stages.in_signal_order((*effects, name))
        wanted = expected_parameters(kind, effects)
        model = replace(self, photoreceptor=kind, effects=effects, parameters={key: parameters[key] for key in wanted})
        return model.set(full)

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the model file that `find_model` and every command read.

        Raises:
            InputError: A file that is there, without `overwrite`; a disk that cannot be written.
        """
        from pixelid.model.files import save_model

        with whole_file(Path(path), overwrite) as part:
            save_model(self, part)
        return Path(path)

    def without_effect(self, name: str, photoreceptor_left: str = "one_pole") -> Model:
        """The model without an effect; unchanged when it has none.

        photoreceptor_left: the kind that a second-order photoreceptor makes way for, "one_pole" or "unlimited"
        Raises InputError for unknown effects.
        """
        stages.effect(name)
        if name == "second_order_photoreceptor" and self.photoreceptor == "second_order":
            ratio = self.parameters["alpha"].value / self.parameters["beta"].value
            one_pole = photoreceptor.ONE_POLE[0].in_light(self.light_scale, -1).at(ratio)
            parameters = {**self.parameters, one_pole.name: one_pole}
            kind, effects = photoreceptor_left, self.effects
        elif name in self.effects:
            kind, effects = self.photoreceptor, tuple(e for e in self.effects if e != name)
            parameters = dict(self.parameters)
        else:
            return self
        wanted = expected_parameters(kind, effects)
        left = {key: parameters[key] for key in wanted}
        kept = {*left, *ONLY_OWN}
        nuisances = {key: p for key, p in self.nuisances.items() if key.split("[", 1)[0] in kept}
        return replace(self, photoreceptor=kind, effects=effects, parameters=left, nuisances=nuisances)


def _differing(own: Circuit, shared: Circuit) -> tuple[tuple[str, float], ...]:
    """The numbers of a circuit that are not those of another; an engine's symbols count as differing."""
    pairs = ((f.name, getattr(own, f.name), getattr(shared, f.name)) for f in fields(Circuit))
    return tuple((name, mine) for name, mine, others in pairs if mine is not others and not _equal(mine, others))


def _equal(one: Any, other: Any) -> bool:
    plain = (int, float, complex, str, tuple, type(None))
    return isinstance(one, plain) and isinstance(other, plain) and one == other


def expected_parameters(kind: str, effects: Iterable[str]) -> dict[str, Parameter]:
    """The parameters a model of this structure must have, with their library defaults, in signal order."""
    expected = {p.name: p for p in photoreceptor.parameters(kind)}
    by_stage: list[Parameter] = []
    for name in effects:
        if name == "second_order_photoreceptor":
            raise InputError("second_order_photoreceptor is a photoreceptor kind: set photoreceptor = 'second_order'")
        by_stage.extend(stages.effect(name).parameters)
    plain = [p for p in by_stage if "." not in p.name]
    dotted = [p for p in by_stage if "." in p.name]
    filters = [p for p in plain if p.name.endswith("cutoff_hz")]
    rest = [p for p in plain if p not in filters]
    for p in (*filters, *comparator.PARAMETERS, *rest, DELAY, *dotted):
        expected[p.name] = p
    return expected
