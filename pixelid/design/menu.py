"""The stimuli to choose from: a default menu made for a model, or a file.

[[stimulus]]
name = "steps_24"           any label
kind = "steps"              a built-in shape; the rest are its parameters
level = 24.0
duration_s = 0.8
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from pixelid.documents import read_toml
from pixelid.errors import InputError, shown
from pixelid.model.model import Model
from pixelid.stimuli.files import shape
from pixelid.stimuli.stimulus import Stimulus

LEVELS = (0.05, 0.43, 7.0)  # of the default menu, in units of β²/α: one real pole dominates, complex pair, bright
DURATION_S = 0.8


@dataclass(frozen=True)
class Candidate:
    """One stimulus of the menu: its name, the built-in shape and parameters behind it, and the light."""

    name: str
    kind: str
    parameters: dict[str, float]
    stimulus: Stimulus

    def as_dict(self) -> dict:
        """Everything but the samples, as design.json and a stimulus file have it."""
        duration = self.stimulus.duration_s
        return {"name": self.name, "kind": self.kind, "parameters": self.parameters, "duration_s": duration}


def candidate(name: str, kind: str, **parameters: float) -> Candidate:
    """A candidate of a built-in shape.  Raises InputError for unknown kinds and parameters, and for videos."""
    light = shape(kind, parameters)
    if not light.full_field:
        raise InputError(f"{name}: a design needs full-field light, {kind} differs from pixel to pixel")
    return Candidate(name, kind, dict(parameters), light)


def default_menu(model: Model) -> list[Candidate]:
    """Chirp, steps, slow sine and constant light at three radiance levels, and steps and chirp of twice the length.

    Levels follow the model's β²/α (100 for photoreceptors without one); every duration is `DURATION_S` or twice that.
    """
    natural = natural_level(model)
    menu = []
    for factor in LEVELS:
        level = float(f"{factor * natural:.2g}")
        stop = min(max(300.0 * math.sqrt(factor), 20.0), 5000.0)
        label = f"{level:g}"
        menu += [
            candidate(f"chirp_{label}", "chirp", level=level, stop_hz=stop, duration_s=DURATION_S),
            candidate(f"steps_{label}", "steps", level=level, duration_s=DURATION_S, seed=1),
            candidate(f"slow_{label}", "slow", level=level, duration_s=DURATION_S, seed=1),
            candidate(f"constant_{label}", "constant", level=level, duration_s=DURATION_S),
            candidate(f"long_chirp_{label}", "chirp", level=level, stop_hz=stop, duration_s=2 * DURATION_S),
            candidate(f"long_steps_{label}", "steps", level=level, duration_s=2 * DURATION_S, seed=1),
        ]
    return menu


def natural_level(model: Model) -> float:
    """β²/α, around which the photoreceptor's poles change their kind; 100 for photoreceptors without one."""
    values = model.values
    return values["beta"] ** 2 / values["alpha"] if model.photoreceptor == "second_order" else 100.0


def brightest_level(model: Model) -> float:
    """The highest level of the default menu."""
    return float(f"{max(LEVELS) * natural_level(model):.2g}")


def read_menu(path: Path) -> list[Candidate]:
    """The candidates of a menu file.  Raises InputError naming the file and the entry that is wrong."""
    entries = read_toml(path).get("stimulus")
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{path}: expected [[stimulus]] tables")
    menu: list[Candidate] = []
    for i, entry in enumerate(entries):
        where = f"{path}: [[stimulus]] {i + 1}"
        if not isinstance(entry, dict) or not isinstance(entry.get("kind"), str):
            raise InputError(f"{where}: expected a table with a kind")
        name = entry.get("name", f"{entry['kind']}_{i + 1}")
        if not isinstance(name, str) or name in (c.name for c in menu):
            raise InputError(f"{where}: expected a name of its own, found {shown(name)}")
        try:
            menu.append(candidate(name, entry["kind"], **{k: v for k, v in entry.items() if k not in ("name", "kind")}))
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
    return menu
