"""Options that several commands share, each declared once, and checked before anything heavy is imported."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import click

from pixelid.options import Option, options_of

Decorated = TypeVar("Decorated", bound=Callable[..., Any])
Decorator = Callable[[Decorated], Decorated]


def is_given(context: click.Context, name: str) -> bool:
    """Whether the command line says an option, so that its value is not the default."""
    return context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE


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


class IntOrWord(click.IntRange):
    """A whole number, or a word in its place."""

    def __init__(self, low: int, high: int, word: str) -> None:
        super().__init__(low, high)
        self.word, self.name = word, f"integer|{word}"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number, or the word."""
        return value if value == self.word else super().convert(value, param, ctx)


class Name(click.Path):
    """The path of a file or folder; `new`: that is to be made, and needs a name of its own."""

    def __init__(self, new: bool = False) -> None:
        super().__init__(path_type=Path)
        self.new = new

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path of a word."""
        if "\0" in str(value):
            self.fail("expected the name of a file or folder, found a null character in it", param, ctx)
        if self.new and not Path(value).name:
            self.fail(f"expected the name of a file or folder to make, found {str(value)!r}", param, ctx)
        return super().convert(value, param, ctx)


PATH, NEW = Name(), Name(new=True)
SEED = click.IntRange(0, 2**32 - 1)
PIXELS = click.IntRange(1, 1 << 24)  # recordings.events.MOST_PIXELS
SIDE = click.IntRange(1, 1 << 16)  # recordings.events.MOST_SIDE

STATED = ("size", "time_unit", "columns", "stream", "chip", "polarity", "clock")  # recordings.source.ReadingOptions
STATED_AS = (
    ("WxH", "s|ms|us|ns", "t,x,y,p", "NAME", "NAME", "01|pm1|swapped|OFF/ON", "strict|sort|split[:K]"),
    (
        "Sensor's size, where the file does not state it.",
        "Unit of its times.",
        "Order of its columns, or t=NAME,x=NAME,…",
        "Which of several streams, topics or arrays.",
        "The sensor, whose size and addresses are known.",
        "How ON and OFF are coded; swapped: exchanged.",
        "Where times fall: refuse, sort, or read stretch K.",
    ),
)

overwrite = click.option("--overwrite", is_flag=True, help="Replace the result that --out holds.")
quiet = click.option("--quiet", is_flag=True, help="No progress, no table.")
with_effect = click.option("--with", "with_", multiple=True, metavar="EFFECT[:param=value,…]", help="Add an effect.")
without = click.option("--without", multiple=True, metavar="EFFECT", help="Remove an effect.")
fix = click.option("--fix", multiple=True, metavar="NAME=VALUE", help="Hold a parameter at a value.")
set_value = click.option("--set", "set_", multiple=True, metavar="name=value", help="Set a parameter.")
gauge = click.option("--gauge", multiple=True, metavar="NAME=VALUE", help='E.g. q_in=0.875 or "A_loop=0.7 A_amp".')
pixel_levels = click.option("--pixel-levels", metavar="gain|background|both", default="",
                            help="Fit a gain and/or background per pixel; of known spread: gain=0.2.")  # fmt: skip
alpha = click.option("--alpha", type=Number(0.0, 0.5, open_low=True), default=0.01, show_default=True,
                     help="Chance of a false alarm.")  # fmt: skip
as_json = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
recordings = click.argument("recordings", nargs=-1, required=True, type=PATH)


def out(help: str = "Folder for the result.", **settings: Any) -> Decorator:
    """--out; required unless there is a default or `required=False`."""
    return click.option("--out", **{"required": "default" not in settings, **settings}, type=NEW, help=help)


def model(required: bool = True, help: str = "A shipped model, a model file, or a fit folder.", **settings: Any):
    """--model."""
    return click.option("--model", required=required, help=help, **settings)


def seed(help: str | None = None, **settings: Any) -> Decorator:
    """--seed, a whole number from 0."""
    return click.option("--seed", **{"default": 0, "show_default": True, **settings}, type=SEED, help=help)


no_seed = seed("No effect on this command.")


def of(options: type) -> Decorator:
    """An option for every field of an options class, handed on together as `asked`, one of that class."""
    every = options_of(options)

    def decorate(command: Decorated) -> Decorated:
        @functools.wraps(command)
        def gathered(*arguments: Any, **others: Any) -> Any:
            values = {option.name: others.pop(option.name) for option in every}
            given = {name: value for name, value in values.items() if value is not None and value != ()}
            return command(*arguments, asked=options(**given), **others)

        for option in reversed(every):
            gathered = _declared(option)(gathered)
        return cast(Decorated, gathered)

    return decorate


def _declared(option: Option) -> Decorator:
    stated, name = option.stated, option.name
    flags = stated.flags or (f"--{name.replace('_', '-')}",)
    shown: dict[str, Any] = {"help": stated.help, "metavar": stated.metavar}
    if option.kind == "bool":
        return click.option(*flags, name, is_flag=True, help=stated.help)
    if option.default not in (None, (), ""):
        shown |= {"default": option.default, "show_default": True}
    if option.kind == "words":
        shown["multiple"] = True
    elif stated.count:
        shown["nargs"] = stated.count
    return click.option(*flags, name, type=_type_of(option), **shown)


def _type_of(option: Option) -> click.ParamType:
    stated = option.stated
    if option.kind == "Path":
        return PATH
    if stated.choices:
        return click.Choice(stated.choices)
    if option.kind == "int" and stated.word:
        return IntOrWord(int(stated.low), int(stated.high), stated.word)
    if option.kind in ("int", "wholes"):
        return click.IntRange(int(stated.low), int(stated.high))
    if option.kind == "str":
        return click.STRING
    return Number(max(stated.low, stated.above), stated.high, open_low=stated.above > stated.low)


def _region(context: click.Context, parameter: click.Parameter, text: str | None) -> tuple[int, int, int, int] | None:
    """The four whole numbers of --roi."""
    if text is None:
        return None
    parts = text.split(",")
    if len(parts) != 4 or not all(part.strip().isdecimal() and len(part) < 20 for part in parts):
        raise click.BadParameter(f"expected x0,y0,x1,y1 in pixels, found {text[:60]!r}")
    x0, y0, x1, y1 = (int(part) for part in parts)
    return x0, y0, x1, y1


def _span(
    context: click.Context, parameter: click.Parameter, text: str | None
) -> tuple[tuple[float, float] | None, bool]:
    """The two times of --time, either of which may be left out, and whether they count from the first event."""
    if text is None:
        return None, False
    parts = [part.strip() for part in text.split(":")]
    signs = {part[:1] == "+" for part in parts if part}
    try:
        begin, end = (float(part) if part else default for part, default in zip(parts, (0.0, 9e9), strict=True))
        if len(signs) > 1:
            raise ValueError
    except ValueError:
        raise click.BadParameter(f"expected from:to or +from:+to in seconds, found {text[:60]!r}") from None
    return (begin, end), signs == {True}


def crop(command: Decorated) -> Decorated:
    """--roi, --time, --pixels and --without-hot-pixels, handed on together as `crop`."""

    @functools.wraps(command)
    def gathered(*arguments: Any, roi: Any, time_s: Any, pixels: Any, without_hot_pixels: bool, **others: Any) -> Any:
        from pixelid.recordings.crop import Crop

        span, from_first = time_s
        return command(*arguments, crop=Crop(roi, span, pixels, without_hot_pixels, from_first), **others)

    for option in (
        click.option("--without-hot-pixels", is_flag=True, help="Exclude hot pixels."),
        click.option("--pixels", type=PIXELS, metavar="N", help="Only N pixels, chosen by --seed."),
        click.option(
            "--time",
            "time_s",
            metavar="FROM:TO",
            callback=_span,
            help="Only these seconds; +FROM:+TO: since the first event.",
        ),
        click.option(
            "--roi", metavar="X0,Y0,X1,Y1", callback=_region, help="Only these columns and rows (X1, Y1 excluded)."
        ),
    ):
        gathered = option(gathered)
    return cast(Decorated, gathered)


def bench(command: Decorated) -> Decorated:
    """--roi and --pixels of a bench."""
    for option in (
        click.option("--pixels", type=PIXELS, metavar="N", help="How many pixels are fitted (default: 36)."),
        click.option("--roi", metavar="X0,Y0,X1,Y1", callback=_region, help="Only these columns and rows."),
    ):
        command = option(command)
    return command


def said(command: Decorated) -> Decorated:
    """Let a line say what was inferred of each file that the command opens."""

    @functools.wraps(command)
    def saying(*arguments: Any, **others: Any) -> Any:
        from pixelid.cli.terminal import say
        from pixelid.recordings.source import ReadingOptions, stating

        stated = ReadingOptions.of({name: others.pop(name, None) for name in STATED}, "--")
        shows_itself = others.get("quiet") or "as_json" in others
        with stating(stated, None if shows_itself else say):
            return command(*arguments, **others)

    return cast(Decorated, saying)


def reading(command: Decorated) -> Decorated:
    """Options that state what a recording's file does not, for every file that the command opens."""
    return _stating(said(command))


def stated(command: Decorated) -> Decorated:
    """The same options, handed on together as `stated`: over what a bench.toml states."""

    @functools.wraps(command)
    def gathered(*arguments: Any, **others: Any) -> Any:
        from pixelid.recordings.source import ReadingOptions

        values = {name: others.pop(name, None) for name in STATED}
        if "" in values.values():
            name = next(name for name, value in values.items() if value == "")
            raise click.BadParameter(f"--{name.replace('_', '-')}: expected a value, found nothing")
        return command(*arguments, stated=ReadingOptions.of(values, "--"), **others)

    return _stating(cast(Decorated, gathered))


def _stating(command: Decorated) -> Decorated:
    for name, metavar, help in reversed(list(zip(STATED, *STATED_AS, strict=True))):
        command = click.option(f"--{name.replace('_', '-')}", name, metavar=metavar, help=help)(command)
    return command


def where(command: Decorated) -> Decorated:
    """--workers and --cluster, handed on together as `where`."""

    @functools.wraps(command)
    def gathered(*arguments: Any, workers: int, cluster: str, **others: Any) -> Any:
        from pixelid.cluster import Where

        return command(*arguments, where=Where(cluster, workers), **others)

    for option in (
        click.option("--cluster", default="", metavar="tcp://HOST:PORT", help="A running Dask scheduler."),
        click.option(
            "--workers", type=click.IntRange(0, 1024), default=0, help="Local Dask processes; 0: this process alone."
        ),
    ):
        gathered = option(gathered)
    return cast(Decorated, gathered)


def search(command):
    """What every search for the gap takes."""
    taken = (recordings, model(), out(), with_effect, without, alpha, crop, reading, where, overwrite, seed(), quiet)
    for option in reversed(taken):
        command = option(command)
    return command
