"""Circuit values for simulators that ask for them: some member of the family that makes the same events.

Events fix α, β, γ (docs/gauge.md); a simulator that computes with A_amp, A_loop, τ_out, q_in, q_mil behaves the same
for every member.  The model's own gauge picks one, else that of the DVS128, else one that always exists: with
r = α/(βγ) and x = A_amp q_mil/q,

    A_loop + 1 = r (1 + x)      τ_out = (1 + x)/β      q = 1/γ

where x = 0 unless r ≤ 1.
"""

from __future__ import annotations

from dataclasses import dataclass

from pixelid.errors import InputError
from pixelid.model.model import Model
from pixelid.parameters.gauge import Gauge
from pixelid.parameters.invariants import Physical
from pixelid.stages.photoreceptor import NOMINAL

DVS128 = Gauge({"q_in": NOMINAL.q_in, "q_mil": NOMINAL.q_mil}, {"A_loop": (NOMINAL.A_loop / NOMINAL.A_amp, "A_amp")})
BACK_GATE = NOMINAL.A_loop / NOMINAL.A_amp


@dataclass(frozen=True)
class CircuitValues:
    """A photoreceptor's values, and which statements have picked them."""

    physical: Physical
    chosen_by: str


def circuit_values(model: Model) -> CircuitValues | None:
    """Values that make the model's events; None where its photoreceptor has no bandwidth limit.

    A one-pole photoreceptor has τ_out = 0, as the simulators of Low & Lee read it.
    """
    circuit = model.circuit()
    if model.photoreceptor == "unlimited":
        return None
    if model.photoreceptor == "one_pole":
        # corner = (A_loop + 1)/q_in with q_mil = 0
        physical = Physical(NOMINAL.A_amp, NOMINAL.A_loop, 0.0, (NOMINAL.A_loop + 1.0) / circuit.corner, 0.0)
        return CircuitValues(physical, "the gains of the DVS128 and no Miller capacitance")
    invariants = circuit.alpha, circuit.beta, circuit.gamma
    for gauge, words in ((model.gauge, "the model's gauge"), (DVS128, "the gauge of the DVS128")):
        try:
            return CircuitValues(gauge.physical(*invariants, around=model.physical or NOMINAL), words)
        except InputError:
            continue
    return CircuitValues(
        _always(*invariants), "no Miller capacitance" if _ratio(*invariants) > 1 else "a loop gain of 1"
    )


def _ratio(alpha: float, beta: float, gamma: float) -> float:
    return alpha / (beta * gamma)


def _always(alpha: float, beta: float, gamma: float) -> Physical:
    r = _ratio(alpha, beta, gamma)
    min_loop_gain = 1.0  # positive is all that is asked
    x = 0.0 if r > 1.0 else (1.0 + min_loop_gain) / r - 1.0
    loop = r * (1.0 + x) - 1.0
    amp = max(loop / BACK_GATE, 2.0 * x)  # q_mil = x q/A_amp stays below q/2
    q = 1.0 / gamma
    q_mil = x * q / amp
    return Physical(amp, loop, (1.0 + x) / beta, q - q_mil, q_mil)
