"""What one frequency can fix of a circuit: Fisher information carried from what is seen to what is wanted.

At one radiance L the pixel answers flicker of frequency f, modulation m and phase φ_lamp with

    A e^{iφ} = m e^{iφ_lamp} H,   H = αL/(αL − ω² + iω(β + γL)) · ωsf/(ωsf + iω) · ωd/(ωd + iω),   ω = 2πf

(small modulation; `docs/model.md`, "The pixel").  Seen are A/C_on, C_off/C_on, s/C_on and φ of each group.  The
Jacobian of these with respect to all unknowns turns the information on what is seen into the information on the
unknowns, and its eigenvectors say which combinations are fixed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SEEN = ("ln amplitude/C_on", "ln C_off/C_on", "phase", "ln noise/C_on")
SHARED = ("lamp_phase_cycles", "alpha", "beta", "gamma", "sf_cutoff_hz", "diff_cutoff_hz", "on_threshold",
          "off_threshold", "comparator_noise")  # fmt: skip
BLIND = 1e-9  # of the largest eigenvalue, after scaling to a unit diagonal


@dataclass(frozen=True)
class Reading:
    """sd: of each unknown by name (logs; inf where blind);  fixed, blind: directions the data fix, and cannot fix."""

    sd: dict[str, float]
    fixed: int
    blind: int


def response(frequency_hz: float, radiance, values: dict[str, float]) -> complex:
    """H at one frequency; values by the parameter names of a model."""
    w = 2.0 * np.pi * frequency_hz
    a, b2 = values["alpha"] * radiance, values["beta"] + values["gamma"] * radiance
    h = a / (a - w * w + 1j * w * b2)
    for name in ("sf_cutoff_hz", "diff_cutoff_hz"):
        h = h / (1.0 + 1j * frequency_hz / values[name])
    return h


def read_circuit(
    frequency_hz: float,
    information: list[np.ndarray],
    values: dict[str, float],
    radiance: np.ndarray,
    equal_contrast: bool,
) -> Reading:
    """What groups with 4 × 4 information on `SEEN` (one matrix each) say about the circuit at nominal values.

    radiance: (groups,) nominal level of each;  equal_contrast: whether one modulation is known to serve all groups.
    """
    groups = len(information)
    contrasts = ["modulation"] if equal_contrast else [f"modulation[{g}]" for g in range(groups)]
    names = [*SHARED, *contrasts, *(f"radiance[{g}]" for g in range(groups))]
    where = {name: i for i, name in enumerate(names)}

    def seen(x: np.ndarray) -> np.ndarray:
        v = {name: values[name] * np.exp(x[where[name]]) for name in SHARED[1:6]}
        rows = []
        for g in range(groups):
            h = response(frequency_hz, radiance[g] * np.exp(x[where[f"radiance[{g}]"]]), v)
            contrast = x[where["modulation" if equal_contrast else f"modulation[{g}]"]]
            on, off = x[where["on_threshold"]], x[where["off_threshold"]]
            phase = x[where["lamp_phase_cycles"]] - np.angle(h) / (2.0 * np.pi)
            rows += [contrast + np.log(abs(h)) - on, off - on, phase, x[where["comparator_noise"]] - on]
        return np.array(rows)

    step = 1e-5 * np.eye(len(names))
    J = np.stack([(seen(d) - seen(-d)) / 2e-5 for d in step], axis=1)
    F = np.zeros((len(names), len(names)))
    for g in range(groups):
        rows = J[4 * g : 4 * g + 4]
        F += rows.T @ information[g] @ rows
    scale = 1.0 / np.sqrt(np.maximum(np.diag(F), 1e-300))
    scale = np.where(np.diag(F) > 1e-12, scale, 1.0)
    eigenvalues, vectors = np.linalg.eigh(F * np.outer(scale, scale))
    blind = eigenvalues < BLIND * eigenvalues.max()
    inside = ((vectors[:, ~blind] / eigenvalues[~blind]) * vectors[:, ~blind]).sum(1)
    open_ = (vectors[:, blind] ** 2).sum(1) > 1e-6
    sd = np.where(open_, np.inf, np.sqrt(inside) * scale)
    return Reading(dict(zip(names, sd.tolist(), strict=True)), int((~blind).sum()), int(blind.sum()))
