"""The whole low-light analysis of one model, with or without recordings, as one dictionary."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from pixelid.lowlight import beside, curves, poles, radii
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.status import Status

LEVELS_SHOWN = (0.05, 0.43, 1.0, 7.0)  # of Bode and step plots, in units of β²/α


def analyse(
    model: Model,
    recordings: Sequence[Recording] = (),
    *,
    draws: Sequence[Model] = (),
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> dict:
    """The content of lowlight.json but for provenance (docs/schemas/lowlight.json).

    Args:
        model: the circuit.
        recordings: of chirps or steps, to be put compared with it.
        draws: models drawn from the uncertainty of a fit, for bands.
        seed: of simulations compared with the recordings.
        progress: called with what is done and the fraction.

    Raises:
        InputError: a photoreceptor without bandwidth.
    """
    began = time.perf_counter()
    report = progress or (lambda what, fraction: None)
    circuit = model.circuit()
    poles.check(circuit)
    report("radii", 0.0)
    errors = radii.all_radii(circuit)
    report("curves", 0.3)
    content = {
        "status": Status.converged,
        "advice": "",
        "model": model.name,
        "photoreceptor": model.photoreceptor,
        "radiance_unit": model.radiance_unit,
        "dark_radiance": circuit.dark,
        "alpha_over_beta": poles.ratio(circuit),
        "errors": errors,
        "regimes": radii.regimes(circuit) | {"levels": levels(circuit)},
        "curves": curves.all_curves(circuit),
        "bands": None,
        "measured": [],
    }
    if draws:
        report("bands", 0.4)
        content["bands"] = curves.bands(circuit, [drawn.circuit() for drawn in draws])
    if recordings:
        content["measured"] = beside.compare(
            recordings, model, seed, lambda done: report("recordings", 0.6 + 0.4 * done)
        )
    content["advice"] = _advice(content)
    content["seconds"] = time.perf_counter() - began
    report("done", 1.0)
    return content


def levels(circuit) -> list[dict]:
    """The regime at the radiances that the Bode and step plots show."""
    centre = radii.natural_radiance(circuit)
    listed = []
    for factor in LEVELS_SHOWN:
        radiance = factor * centre
        pair = poles.pair(circuit, radiance)
        entry = {"radiance": radiance, "photoreceptor_poles": [[p.real, p.imag] for p in pair]}
        if circuit.photoreceptor == "second_order":
            effective = radiance + circuit.dark
            entry |= {
                "epsilon": circuit.alpha * effective / circuit.beta**2,
                "gamma_ratio": circuit.gamma * effective / circuit.beta,
                "damping": float((pair.sum() / (2 * abs(pair[0] * pair[1]) ** 0.5)).real),
                "complex": bool(abs(pair[0].imag) > 0),
            }
        listed.append(entry)
    return listed


def sentences(content: dict) -> list[str]:
    """The regime map in words."""
    unit, map_ = content["radiance_unit"], content["regimes"]
    if content["photoreceptor"] == "one_pole":
        return ["The model's photoreceptor is the one-pole approximation itself: there is no error to speak of."]
    low, high = map_["critical"] or (math.inf, math.inf)
    said = ["With this dark current no light is dim enough for one pole alone."]
    if map_["epsilon_one"] is not None and low > 0:
        said = [f"One pole is the low-light limit: ε = αL/β² reaches 1 at {map_['epsilon_one']:.3g} {unit}."]
    if map_["critical"]:
        said.append(
            f"Between {low:.3g} and {high:.3g} {unit} the two photoreceptor poles are a complex pair (damping down to "
            f"{map_['lowest_damping']:.2g}) and no single pole describes it."
            if low > 0
            else f"From the dark up to {high:.3g} {unit} the photoreceptor poles are a complex pair."
        )
    else:
        said.append("The two photoreceptor poles are real at every radiance.")
    first = content["errors"]["one_pole"]["dominant_pole"]["photoreceptor"]["levels"]
    accurate = [f"to {level} below {entry['first']:.3g} {unit}" for level, entry in first.items() if entry["first"]]
    dark = [level for level, entry in first.items() if entry["first"] == 0.0]
    if accurate:
        said.append(f"One pole, ωc = (α/β) L, is accurate {', '.join(accurate)}.")
    if dark:
        said.append(f"Already in the dark ωc = (α/β) L is off by {', '.join(dark)}.")
    return said


def _advice(content: dict) -> str:
    missing = [entry for entry in content["measured"] if entry["value"] is None]
    if content["measured"] and len(missing) == len(content["measured"]):
        return "no recording shows a bandwidth or step time: record a chirp past the bandwidth, or steps that settle"
    return ""
