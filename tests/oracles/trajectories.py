"""The cases of `pixel_trajectories.npz`, solved by an independent adaptive integrator."""

import numpy as np

from pixelid.parameters.invariants import Physical
from pixelid.stages.circuit import Circuit
from pixelid.stimuli.stimulus import Stimulus


def oracle_light(kind, t, L0, f, m, T):
    """The stimulus formulas of the oracle file."""
    s = 1 / (1 + np.exp(-(t - T / 4) / (0.002 * T)))
    return {
        "sine": lambda: L0 * (1 + m * np.sin(2 * np.pi * f * t)),
        "step_up": lambda: L0 * (1 + 3 * m * s),
        "step_down": lambda: L0 * (1 - m * s),
        "chirp": lambda: L0 * np.exp(m * np.sin(2 * np.pi * (f * t + 4 * f * t * t / T))),
        "pulse": lambda: L0 * (1 + 4 * m * np.exp(-0.5 * ((t - T / 2) / (0.01 * T)) ** 2)),
        "edge": lambda: L0 * (1 + m * np.tanh(8 * np.sin(2 * np.pi * f * t))),
    }[kind]()


def oracle_case(file, case):
    """(circuit, light(n) → Stimulus, event times, polarities)."""
    params = file[f"case{case}/params"]
    alpha, beta, gamma = Physical(*params[:5]).invariants()
    circuit = Circuit(
        alpha=alpha, beta=beta, gamma=gamma, follower=2 * np.pi * params[5], differencing=2 * np.pi * params[6],
        on_threshold=params[7], off_threshold=params[8], refractory=params[9],
    )  # fmt: skip
    stimulus = file[f"case{case}/stimulus"]

    def light(n):
        t = np.linspace(0, stimulus[3], n)
        return Stimulus.from_arrays(t, oracle_light(str(file[f"case{case}/kind"]), t, *stimulus))

    return circuit, light, file[f"case{case}/event_t_s"], file[f"case{case}/event_p"]
