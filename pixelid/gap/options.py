"""What a caller asks of a search beside recordings and a model, and what a search is handed to work with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from pixelid.cluster import Work
from pixelid.fit.cache import FitCache
from pixelid.fit.result import Stopwatch
from pixelid.gap.criteria import Criteria

Report = Callable[[str, float], None]  # what is being done, and the fraction of the whole that is done

ALPHA = 0.01


@dataclass(frozen=True)
class Options:
    """How a search decides.

    Attributes:
        alpha: Chance of naming anything, or of "unknown", when the model is right.
        seed: Decides the split of the pixels and every draw.
        leave_out: Effects that the library is to lack.
        criteria: Every other number that a verdict hangs on.
        recommend: Whether to work out what to record next.
    """

    alpha: float = ALPHA
    seed: int = 0
    leave_out: tuple[str, ...] = ()
    criteria: Criteria = field(default_factory=Criteria)
    recommend: bool = True

    @property
    def alpha_each(self) -> float:
        """What either test, of the maps and of the leading candidate, may err by, so that both err by alpha."""
        return 0.5 * self.alpha


@dataclass(frozen=True)
class Context:
    """What every step is handed beside the state: how to decide, where fits are kept, who does what can be
    done side by side, whom to tell how far it is, and since when it runs."""

    options: Options
    cache: FitCache | None = None
    report: Report = lambda what, fraction: None
    work: Work = field(default_factory=Work)
    watch: Stopwatch = field(default_factory=Stopwatch)
