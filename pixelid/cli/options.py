"""Options that several commands share, each declared once, and checked before anything heavy is imported."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

Decorated = TypeVar("Decorated", bound=Callable[..., Any])
Decorator = Callable[[Decorated], Decorated]


class Number(click.ParamType):
    """A finite number between open or closed limits."""

    name = "number"

    def __init__(self, low: float = -math.inf, high: float = math.inf, *, open_low: bool = False) -> None:
        self.low, self.high, self.open_low = low, high, open_low

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number of a word."""
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = math.nan
        outside = number < self.low or number > self.high or (self.open_low and number == self.low)
        if outside or not math.isfinite(number):
            self.fail(f"expected {self._expected()}, found {value}", param, ctx)
        return number

    def _expected(self) -> str:
        above = f"{'above' if self.open_low else 'at least'} {self.low:g}"
        if math.isfinite(self.low) and math.isfinite(self.high):
            return f"a number {above} and at most {self.high:g}"
        return f"a number {above}" if math.isfinite(self.low) else "a finite number"


PATH = click.Path(path_type=Path)
SEED = click.IntRange(0, 2**32 - 1)

overwrite = click.option("--overwrite", is_flag=True, help="Replace the result that --out holds.")
quiet = click.option("--quiet", is_flag=True, help="No progress, no table.")
with_effect = click.option("--with", "with_", multiple=True, metavar="EFFECT[:param=value,…]", help="Add an effect.")
without = click.option("--without", multiple=True, metavar="EFFECT", help="Remove an effect.")
fix = click.option("--fix", multiple=True, metavar="NAME=VALUE", help="Hold a parameter at a value.")
set_value = click.option("--set", "set_", multiple=True, metavar="name=value", help="Set a parameter.")
gauge = click.option("--gauge", multiple=True, metavar="NAME=VALUE", help='E.g. q_in=0.875 or "A_loop=0.7 A_amp".')
alpha = click.option("--alpha", type=Number(0.0, 0.5, open_low=True), default=0.01, show_default=True,
                     help="Chance of a false alarm.")  # fmt: skip
as_json = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
recordings = click.argument("recordings", nargs=-1, required=True, type=PATH)


def out(help: str = "Folder for the result.", **settings: Any) -> Decorator:
    """--out; required unless there is a default or `required=False`."""
    return click.option("--out", **{"required": "default" not in settings, **settings}, type=PATH, help=help)


def model(required: bool = True, help: str = "A shipped model, a model file, or a fit folder.", **settings: Any):
    """--model."""
    return click.option("--model", required=required, help=help, **settings)


def seed(help: str | None = None, **settings: Any) -> Decorator:
    """--seed, a whole number from 0."""
    return click.option("--seed", **{"default": 0, "show_default": True, **settings}, type=SEED, help=help)


no_seed = seed("Accepted everywhere; nothing here is random.")
