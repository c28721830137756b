"""Physical circuit values and the three invariants that events can identify (docs/model.md, "Invariants").

With q = q_in + q_mil and the radiance scale s (physical radiance per recorded unit),

    α = s (A_loop + 1) / (q τ_out)      β = (q_in + (A_amp + 1) q_mil) / (q τ_out)      γ = s / q

so ωn² = α L and 2ζωn = β + γ L for the recorded radiance L.  Six unknowns meet three equations.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields

import numpy as np

INVARIANTS = ("alpha", "beta", "gamma")


@dataclass(frozen=True)
class Physical:
    """The photoreceptor's circuit values.

    A_amp: amplifier gain;  A_loop: total loop gain;  tau_out: output time constant [s];
    q_in, q_mil: input and Miller time constant × radiance [radiance·s];
    radiance_scale: physical radiance per recorded unit.
    """

    A_amp: float
    A_loop: float
    tau_out: float
    q_in: float
    q_mil: float
    radiance_scale: float = 1.0

    def invariants(self) -> tuple[float, float, float]:
        """(α, β, γ) in recorded radiance units."""
        q = self.q_in + self.q_mil
        return (
            self.radiance_scale * (self.A_loop + 1.0) / (q * self.tau_out),
            (self.q_in + (self.A_amp + 1.0) * self.q_mil) / (q * self.tau_out),
            self.radiance_scale / q,
        )

    def as_dict(self) -> dict[str, float]:
        """Values by name."""
        return asdict(self)


PHYSICAL_NAMES = tuple(field.name for field in fields(Physical))
PHYSICAL_UNITS = {
    "A_amp": "1",
    "A_loop": "1",
    "tau_out": "s",
    "q_in": "fA·s",
    "q_mil": "fA·s",
    "radiance_scale": "fA/radiance",
}


def log_jacobian(physical: Physical) -> np.ndarray:
    """(3, 6) derivatives of (ln α, ln β, ln γ) by the logs of the physical values, in `PHYSICAL_NAMES` order."""
    p = physical
    q = p.q_in + p.q_mil
    numerator = p.q_in + (p.A_amp + 1.0) * p.q_mil
    in_q, mil_q = p.q_in / q, p.q_mil / q
    return np.array(
        [
            [0.0, p.A_loop / (p.A_loop + 1.0), -1.0, -in_q, -mil_q, 1.0],
            [
                p.A_amp * p.q_mil / numerator,
                0.0,
                -1.0,
                p.q_in / numerator - in_q,
                (p.A_amp + 1.0) * p.q_mil / numerator - mil_q,
                0.0,
            ],
            [0.0, 0.0, 0.0, -in_q, -mil_q, 1.0],
        ]
    )
