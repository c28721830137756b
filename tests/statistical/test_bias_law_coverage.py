"""Intervals of laws of bias codes cover what they should: parameters, and settings that were not measured."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from pixelid.biases.laws import BY_NAME
from pixelid.biases.saved import Quantity
from pixelid.tables.biases.fit import fit_form, fit_laws, natural_values
from pixelid.tables.biases.reading import BiasTable
from pixelid.tables.biases.result import fitted_entry

TABLES = 40
CHANCE = 1e-3  # that a right interval fails here
SCATTER = 0.015
REFR = np.linspace(-20.0, 200.0, 24)[:, None]
DIFF = np.array([[own, amplifier] for amplifier in (0, 10, 20) for own in (0, -10, -20, -35)], float)
LAWS = {
    "inverse of a linear current with a floor": (
        REFR, lambda c: 1e-3 / (c[:, 0] + 24.0) + 6e-6, {"scale": 1e-3, "zero_current_code": -24.0, "floor": 6e-6},
    ),
    "difference over a gain": (
        DIFF, lambda c: np.exp(0.008 * (c[:, 1] - 10.0)) * (0.2 + 0.0036 * (c[:, 0] + 17.5) - 0.003 * (c[:, 1] - 10.0)),
        {"value_at_reference": 0.2, "slope.x": 0.0036, "slope.d": -0.003, "log_gain.d": 0.008},
    ),
}  # fmt: skip


def simulated(name: str, seed: int) -> tuple[BiasTable, np.random.Generator]:
    code, law, _ = LAWS[name]
    rng = np.random.default_rng(seed)
    noise = SCATTER * rng.standard_t(4, len(code)) if seed % 2 else SCATTER * rng.standard_normal(len(code))
    codes = tuple(f"bias_{k}" for k in range(code.shape[1]))
    return BiasTable("q", "s", codes, code, law(code) * np.exp(noise), np.zeros(len(code))), rng


@pytest.mark.parametrize("name", LAWS)
def test_parameters_lie_in_their_intervals(name):
    """Half of the tables with normal errors, half with those of t₄; of 150 tables 87 to 97 % cover."""
    truth = LAWS[name][2]
    inside = dict.fromkeys(truth, 0)
    for seed in range(TABLES):
        found = natural_values(fit_form(simulated(name, seed)[0], BY_NAME[name]).law, seed)
        for key, value in truth.items():
            low, high = found[key][2]
            inside[key] += low <= value <= high
    assert min(inside.values()) >= binom.ppf(CHANCE, TABLES, 0.95)


def test_settings_that_were_not_measured_lie_in_their_intervals():
    """The whole way: the form is chosen, rivals and settings left out widen the interval."""
    name = "difference over a gain"
    law = LAWS[name][1]
    new = np.array([[-5.0, 5.0], [-25.0, 15.0], [-30.0, 0.0]])
    inside = np.zeros(len(new), int)
    for seed in range(TABLES):
        table, rng = simulated(name, seed)
        quantity = Quantity.of("q", fitted_entry(table, fit_laws(table), seed))
        found = quantity.predict(new)
        measured = law(new) * np.exp(SCATTER * rng.standard_normal(len(new)))
        inside += (found["low"] <= measured) & (measured <= found["high"])
    assert (inside >= binom.ppf(CHANCE, TABLES, 0.95)).all()
    assert np.exp(np.mean(np.log(found["high"] / found["low"]))) < 1.25  # and say something: 25 % from end to end
