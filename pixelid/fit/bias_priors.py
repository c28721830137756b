"""Priors of a fit from the bias settings of the recordings: by jAER's formulas, or by laws fitted to tables.

Parameters share sources of error: κ and the capacitor ratio are in both thresholds, the master current is in dead time
and cutoff.  A fit's priors are independent, so each gets a variance that no combination of them undercuts: where k
parameters share a source with deviations e_i, (Σ e_i x_i)² ≤ k Σ e_i² x_i² (Cauchy & Schwarz), and k e_i² takes the
place of e_i².  With both thresholds their priors are wider than for either alone by up to √2, and hold nothing that
the biases say of their ratio.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.biases import Implied, Value, currents_of, has_jaer_biases, implied_by
from pixelid.biases.currents import CHIPS
from pixelid.biases.saved import Quantity, read_laws
from pixelid.documents import is_number
from pixelid.errors import InputError
from pixelid.model.model import Model
from pixelid.model.shipped import shipped_bias_laws
from pixelid.parameters.parameter import Prior
from pixelid.recordings.recording import Recording
from pixelid.results import Table, number
from pixelid.statistics import Z95

OPTION, LAWS_OPTION = "--bias-priors", "--bias-laws"


def with_bias_priors(
    model: Model, recordings: Sequence[Recording], laws: str | Path | None = None
) -> tuple[Model, dict[str, Any]]:
    """The model with priors from the recordings' biases, and what fit.json says of them.

    A prior takes the place of the model's own, and the search starts at its mean.  Parameters that are held, or that
    the model lacks, get none.

    Args:
        model: of the fit.
        recordings: whose biases are stated.
        laws: folder of `pixelid biases`, whose laws are evaluated at the recordings' codes; jAER's formulas otherwise.

    Raises:
        InputError: a recording without such biases, recordings of different ones, or biases that say nothing of any
            free parameter.
    """
    if laws is None:
        implied = biases_of(recordings)
        values, told = implied.values, implied.as_dict()
    else:
        values, told = values_of_laws(Path(laws), recordings)
    unused = dict(told["without"])
    for name in values:
        if name not in model.parameters:
            unused[name] = f"not in model {model.name}"
        elif not model.parameters[name].free:
            unused[name] = "it is held"
    priors = independent({name: value for name, value in values.items() if name not in unused})
    if not priors:
        reasons = "; ".join(f"{name}: {why}" for name, why in unused.items())
        option = OPTION if laws is None else LAWS_OPTION
        raise InputError(f"{option}: the biases give a prior for no free parameter ({reasons})")
    parameters = dict(model.parameters)
    for name, prior in priors.items():
        start = parameters[name].within(values[name].value)
        parameters[name] = replace(parameters[name], prior=prior, value=start)
    told |= {"priors": {name: _told(prior) for name, prior in priors.items()}, "unused": unused}
    return replace(model, parameters=parameters), told


def biases_of(recordings: Sequence[Recording]) -> Implied:
    """What the biases of all recordings imply, which must be the same ones.

    Raises:
        InputError: as `with_bias_priors`.
    """
    first: Implied | None = None
    for recording in recordings:
        settings = recording.attributes.get("biases")
        if not has_jaer_biases(recording.sensor, settings):
            chips = ", ".join(chip.family for chip in CHIPS)
            wanted = f"the bias settings of a jAER header (AEDAT2 of {chips})"
            raise InputError(f"{recording.name}: {OPTION}: expected {wanted}, found none")
        try:
            implied = implied_by(currents_of(recording.sensor, settings))
        except InputError as error:
            raise InputError(f"{recording.name}: {error}") from None
        if first is None:
            first = implied
        elif first.currents != implied.currents:
            raise InputError(
                f"{recording.name}: {OPTION}: other biases than {recordings[0].name} ({_difference(first, implied)}): "
                "fit recordings of one setting together"
            )
    assert first is not None
    return first


def values_of_laws(folder: Path, recordings: Sequence[Recording]) -> tuple[dict[str, Value], dict[str, Any]]:
    """Values of parameters at the recordings' codes by fitted laws, and what fit.json says of them.

    Raises:
        InputError: no laws, a recording that states none of their codes, or recordings of different codes.
    """
    laws = {q.parameter: q for q in read_laws(shipped_bias_laws(folder) or folder).values() if q.parameter}
    known = {code for quantity in laws.values() for code in quantity.codes}
    settings = []
    for recording in recordings:
        stated = recording.attributes.get("biases")
        stated = stated if isinstance(stated, Mapping) else {}
        settings.append({code: float(stated[code]) for code in known if is_number(stated.get(code))})
        if not settings[-1]:
            wanted = f"codes of {', '.join(sorted(known)) or 'biases'} (a .bias file next to the recording)"
            raise InputError(f"{recording.name}: {LAWS_OPTION}: expected {wanted}, found none")
        if settings[-1] != settings[0]:
            raise InputError(
                f"{recording.name}: {LAWS_OPTION}: other codes than {recordings[0].name}: fit recordings of one "
                "setting together"
            )
    values, without = {}, {}
    for name, quantity in laws.items():
        prior = quantity.prior(settings[0])
        if isinstance(prior, str):
            without[name] = prior
        else:
            at = ", ".join(f"{code} {settings[0][code]:g}" for code in quantity.codes)
            formula = f"{quantity.laws[0].form.name}, at {at}"
            values[name] = Value(math.exp(prior[0]), quantity.unit, formula, {f"law of {name}": prior[1]})
    told = {
        "chip": recordings[0].sensor or "camera", "currents": {}, "without": without,
        "values": {name: value.as_dict() for name, value in values.items()},
    }  # fmt: skip
    return values, told


def model_at(model: Model, laws: Mapping[str, Quantity], codes: Mapping[str, float]) -> Model:
    """The circuit at a setting of its biases: values and priors of what the laws are of; others stay.

    Args:
        model: whose own values are of some other setting; it gets the dead time if it lacks one.
        laws: of `read_laws`.
        codes: of biases; those not stated are 0, the default of drivers.

    Raises:
        InputError: a code at which a law has no value.
    """
    for quantity in laws.values():
        at = {code: codes.get(code, 0.0) for code in quantity.codes}
        prior = quantity.prior(at)
        words = ", ".join(f"{code} {value:g}" for code, value in at.items())
        if isinstance(prior, str):
            raise InputError(f"{quantity.name} at {words}: expected a code where its law has a value: {prior}")
        if quantity.parameter == "refractory_s" and "refractory_s" not in model.parameters:
            model = model.with_effect("refractory_period")
        if quantity.parameter not in model.parameters:
            continue
        low, high = quantity.at(at)["interval_95"]
        own = model.parameters[quantity.parameter]
        source = f"law of bias codes at {words}: 95 % {low:.4g} to {high:.4g}"
        changed = replace(own, value=own.within(math.exp(prior[0])), prior=Prior(*prior), source=source)
        model = replace(model, parameters={**model.parameters, quantity.parameter: changed})
    return model


def independent(values: Mapping[str, Value]) -> dict[str, Prior]:
    """Independent priors of ln value that claim no more than the values with their shared errors."""
    shared = Counter(source for value in values.values() for source in value.errors)
    return {
        name: Prior(
            math.log(value.value), math.sqrt(sum(shared[source] * sd**2 for source, sd in value.errors.items()))
        )
        for name, value in values.items()
    }


def beside_events(told: Mapping[str, Any], names: Sequence[str], x: np.ndarray, sd: np.ndarray) -> list[str]:
    """Where the events add nearly nothing to a prior of the biases, and where they contradict it, in words.

    Args:
        told: of `with_bias_priors`.
        names: (p,) of the fitting coordinates.
        x, sd: (p,) optimum and standard errors, the priors among what they rest on.
    """
    sentences = []
    little_added = 0.9  # of a prior's deviation: the events then carry less than a fifth (1 − 0.9²) of the information
    contradiction = 3.0  # standard deviations: one in 370 of right priors
    for name, prior in told["priors"].items():
        if name not in names:
            continue
        k = list(names).index(name)
        if sd[k] > little_added * prior["sd"]:
            sentences.append(f"{name}: its interval is that of the biases; the events add next to nothing")
        away = abs(x[k] - prior["mean"]) / prior["sd"]
        if away > contradiction:
            sentences.append(
                f"{name}: the events have it {away:.1f} standard deviations from what the biases say: perhaps the "
                "camera did not run with the settings of the header"
            )
    return sentences


def prior_table(told: Mapping[str, Any]) -> Table:
    """The priors that a fit took from biases."""
    rows = []
    for name, prior in told["priors"].items():
        low, high = prior["interval_95"]
        value = told["values"][name]
        rows.append((name, number(value["value"]), f"{number(low)} to {number(high)}", value["unit"], value["formula"]))
    headings = ("parameter", "value", "95 % interval", "unit", "formula")
    return Table(f"priors from the biases of the {told['chip']}", headings, tuple(rows),
                 frozenset({"parameter", "unit", "formula"}))  # fmt: skip


def prior_sentences(told: Mapping[str, Any]) -> list[str]:
    """What got no prior, and why."""
    return [f"{name}: no prior from the biases: {why}" for name, why in told["unused"].items()]


def _told(prior: Prior) -> dict[str, Any]:
    ends = [math.exp(prior.mean + side * Z95 * prior.sd) for side in (-1.0, 1.0)]
    return {"mean": prior.mean, "sd": prior.sd, "interval_95": ends}


def _difference(one: Implied, other: Implied) -> str:
    """The first bias that differs, in words."""
    if one.currents.chip != other.currents.chip:
        return f"{one.currents.chip} and {other.currents.chip}"
    mine, theirs = one.currents.roles, other.currents.roles
    role = next(role for role in {**mine, **theirs} if mine.get(role) != theirs.get(role))
    settings = [roles[role].as_dict() if role in roles else None for roles in (mine, theirs)]
    words = ["not stated" if s is None else f"{s['ampere']:.3g} A" for s in settings]
    return f"{one.currents.of.settings[role]}: {words[0]} and {words[1]}"
