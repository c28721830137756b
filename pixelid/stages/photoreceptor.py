"""Photoreceptor: logarithmic, second order, bandwidth growing with light.

    d²y/dt² + (β + γL) dy/dt + αL y = αL ln L

In low light (τ_out ≪ τ_in + τ_mil) one pole at ωc = (α/β) L remains.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from pixelid.errors import InputError
from pixelid.parameters.invariants import Physical
from pixelid.parameters.parameter import Parameter
from pixelid.stages.circuit import Circuit
from pixelid.stages.effect import Effect

# DVS128 nominal values: Low & Lee, arXiv 2409.17988, supplement (reference simulator configuration), L in fA.
NOMINAL = Physical(A_amp=140.0, A_loop=98.0, tau_out=1815e-6, q_in=0.875, q_mil=0.015)
_ALPHA, _BETA, _GAMMA = NOMINAL.invariants()

SECOND_ORDER = (
    Parameter("alpha", _ALPHA, "1/s²/radiance", 1e-6, 1e15, "log", source="DVS128 nominal"),
    Parameter("beta", _BETA, "1/s", 1e-3, 1e9, "log", source="DVS128 nominal"),
    Parameter("gamma", _GAMMA, "1/s/radiance", 1e-9, 1e9, "log", source="DVS128 nominal"),
)
ONE_POLE = (
    Parameter("alpha_over_beta", _ALPHA / _BETA, "rad/s/radiance", 1e-6, 1e12, "log", source="DVS128 nominal α/β"),
)


def parameters(kind: str) -> tuple[Parameter, ...]:
    """The parameters of a photoreceptor kind ("second_order", "one_pole", "unlimited")."""
    try:
        return {"second_order": SECOND_ORDER, "one_pole": ONE_POLE, "unlimited": ()}[kind]
    except KeyError:
        raise InputError(f"photoreceptor must be 'second_order', 'one_pole' or 'unlimited', found {kind!r}") from None


def apply(kind: str, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
    """The circuit with this kind of photoreceptor."""
    if kind == "second_order":
        return circuit.with_(photoreceptor=kind, alpha=values["alpha"], beta=values["beta"], gamma=values["gamma"])
    if kind == "one_pole":
        return circuit.with_(photoreceptor=kind, corner=values["alpha_over_beta"])
    return circuit.with_(photoreceptor=kind)


class SecondOrderPhotoreceptor(Effect):
    name = "second_order_photoreceptor"
    stage = "photoreceptor"
    sentence = "The photoreceptor has its second pole: the low-light one-pole model is not enough."
    equation = "y'' + (β + γL) y' + αL y = αL ln L instead of y' = (α/β) L (ln L − y)"
    source = "Low & Lee, arXiv 2409.17988, supplement"
    parameters = SECOND_ORDER
    vanishes_at = math.inf

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return apply("second_order", circuit, values)


class BandwidthFloor(Effect):
    name = "bandwidth_floor"
    stage = "photoreceptor"
    sentence = "The photoreceptor's bandwidth does not fall below a floor in low light."
    equation = "rates α (L + floor) and β + γ (L + floor); ln L without the floor"
    source = "Hu, Liu & Delbruck, CVPRW 2021, arXiv 2006.07722 (v2e: low-pass of corner ∝ L + 20 of 255 grey levels)"
    parameters = (Parameter("bandwidth_floor.radiance", 20.0, "radiance", 1e-6, 1e6, "log"),)
    photoreceptors = ("second_order", "one_pole")
    trades_places = True

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        if circuit.photoreceptor not in self.photoreceptors:
            raise InputError("bandwidth_floor: a photoreceptor without a bandwidth limit has no floor of it")
        return circuit.with_(bandwidth_floor=values["bandwidth_floor.radiance"])


EFFECTS = (SecondOrderPhotoreceptor(), BandwidthFloor())
