"""Parameters as a reader of the field writes them: symbol, name, unit, and the pixel's stage they belong to."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup, escape

from pixelid.errors import InputError
from pixelid.figures.words import RATES, SYMBOLS, UNIT, in_words, unit_of
from pixelid.report.format import Shown, in_its_unit, interval, value
from pixelid.stages import LIBRARY, comparator, effect, photoreceptor
from pixelid.stages.described import Described

STAGES = {
    "photocurrent": "Light",
    "photoreceptor": "Photoreceptor",
    "source_follower": "Source follower",
    "differencing": "Differencing amplifier",
    "comparator": "Comparator",
    "readout": "Readout",
}
NAMES = {
    "alpha": "α", "beta": "β", "gamma": "γ", "alpha_over_beta": "corner per light",
    "sf_cutoff_hz": "cutoff frequency", "diff_cutoff_hz": "cutoff frequency", "on_threshold": "ON threshold",
    "off_threshold": "OFF threshold", "threshold_sigma": "threshold noise",
    "threshold_mismatch.sigma": "threshold mismatch", "refractory_s": "dead time",
    "off_background.rate_hz": "OFF background", "led_off_fraction": "light of the LED when off",
    "on_delay_s": "ON delay", "off_delay_s": "OFF delay", "delay_sigma": "spread of delays",
    "lens_factor": "transmission of the lens",
}  # fmt: skip
SHARES = ("threshold_sigma", "threshold_mismatch.sigma", "lost_events.fraction", "mains_flicker.modulation")
KILOHERTZ = 1e4  # from which on a frequency is written in kHz: four digits suffice below


@dataclass(frozen=True)
class Quantity:
    """One parameter of a result.

    symbol: (letter, index), both "" where the field has none;  name: in words;  value, interval, unit: as text
    stage: a key of `STAGES`;  effect: that brought it, "" for the circuit's own
    """

    parameter: str
    symbol: tuple[str, str]
    name: str
    value: str
    interval: str
    unit: str
    stage: str
    effect: str
    identified: bool
    fixed: bool

    @property
    def label(self) -> str:
        """Symbol and name as plain text."""
        letters = "".join(self.symbol) if not self.symbol[1] else "_".join(self.symbol)
        return f"{letters}, {self.name}" if letters and letters != self.name else self.name

    @property
    def markup(self) -> Markup:
        """Symbol and name as HTML."""
        if self.symbol[0] in ("", self.name.partition(",")[0]):
            return escape(self.name)
        return Markup("<i>{}</i> {}").format(with_index("_".join(filter(None, self.symbol))), self.name)


def with_index(text: str) -> Markup:
    """A formula as HTML: what follows an underscore lowered, tau as τ.

    >>> str(with_index("0.7 A_amp")), str(with_index("tau_out"))
    ('0.7 A<sub>amp</sub>', 'τ<sub>out</sub>')
    """
    return Markup(re.sub(r"(?<=\w)_(\w+)", r"<sub>\1</sub>", str(escape(text.replace("tau_", "τ_")))))


def quantity(parameter: str, entry: Mapping[str, Any]) -> Quantity:
    """A parameter of a result's JSON.

    Args:
        parameter: its name.
        entry: its value, interval_95, unit, identified, fixed.

    >>> entry = {"value": 0.0405, "interval_95": [0.039, 0.042], "unit": "1", "identified": True, "fixed": False}
    >>> q = quantity("threshold_sigma", entry)
    >>> q.symbol, q.value, q.interval, q.unit, q.stage
    (('σ', 'C'), '4.05', '3.9 … 4.2', '%', 'comparator')
    """
    shown = _shown(parameter, entry)
    own = _effect_of(parameter)
    return Quantity(
        parameter,
        SYMBOLS.get(parameter.partition("[")[0], ("", "")),
        name_of(parameter),
        shown.value,
        shown.interval,
        shown.unit,
        stage_of(parameter),
        own if parameter not in SYMBOLS else "",
        bool(entry.get("identified", False)),
        bool(entry.get("fixed", False)),
    )


def name_of(parameter: str) -> str:
    """A parameter in words: of an effect with one parameter, the effect.

    >>> name_of("leak.rate_hz"), name_of("on_threshold"), name_of("slew_limit.rise_per_s")
    ('leak', 'ON threshold', 'slew limit, rise per s')
    >>> name_of("described.rate.time_in_recording.linear.strength"), name_of("cutoff_hz[fo 1477]")
    ('rate by time in recording', 'cutoff, fo 1477')
    """
    parameter, _, of = parameter.removesuffix("]").partition("[")
    if of:
        return f"{name_of(parameter)}, {of}"
    if parameter in NAMES:
        return NAMES[parameter]
    own = _effect_of(parameter)
    if not own:
        return in_words(UNIT.sub("", parameter))
    known = effect(own)
    several = len([p for p in known.parameters if p.free]) > 1
    if isinstance(known, Described):
        depends = "" if known.covariate == "none" else f" by {known.covariate}"
        words = f"{known.quantity}{depends}" + (f", {parameter.rpartition('.')[2]}" if several else "")
        return words.replace("_", " ")
    return in_words(UNIT.sub("", parameter)) if several else own.replace("_", " ")


def stage_of(parameter: str) -> str:
    """The stage of the signal path that a parameter belongs to; "" for one that is not the pixel's.

    >>> stage_of("alpha"), stage_of("off_threshold"), stage_of("leak.rate_hz"), stage_of("alignment.clock_rate")
    ('photoreceptor', 'comparator', 'differencing', '')
    """
    if parameter in {p.name for p in (*photoreceptor.SECOND_ORDER, *photoreceptor.ONE_POLE)}:
        return "photoreceptor"
    if parameter in {p.name for p in comparator.PARAMETERS}:
        return "comparator"
    own = _effect_of(parameter)
    return effect(own).stage if own else ""


def quantities(parameters: Mapping[str, Mapping[str, Any]]) -> list[Quantity]:
    """Every parameter of the pixel among a result's, those of recordings and clocks left out."""
    return [quantity(name, entry) for name, entry in parameters.items() if "[" not in name and stage_of(name)]


def _effect_of(parameter: str) -> str:
    """The effect that a parameter comes with; "" for none."""
    known = next((e.name for e in LIBRARY.values() if parameter in {p.name for p in e.parameters}), "")
    if known:
        return known
    name = parameter.rpartition(".")[0]
    try:
        return effect(name).name if name else ""
    except (InputError, ValueError, KeyError):
        return ""


def _shown(parameter: str, entry: Mapping[str, Any]) -> Shown:
    unit, estimate = entry.get("unit", ""), entry["value"]
    if parameter in SHARES:
        return _scaled(entry, 0.01, "%")
    if parameter in RATES:
        return _scaled(entry, 1.0, unit_of(parameter, unit))
    if unit == "Hz" and estimate and abs(estimate) >= KILOHERTZ:
        return _scaled(entry, 1e3, "kHz")
    shown = in_its_unit(entry)
    return Shown(shown.value, shown.interval, "ln units" if unit == "log radiance" else shown.unit, shown.scale)


def _scaled(entry: Mapping[str, Any], scale: float, unit: str) -> Shown:
    estimate, ends = entry["value"], entry.get("interval_95")
    ends = ends and [None if end is None else end / scale for end in ends]
    estimate = None if estimate is None else estimate / scale
    return Shown(value(estimate, ends), interval(ends), unit, scale)
