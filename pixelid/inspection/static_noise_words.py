"""What histograms of a still scene's intervals say and do not say, in sentences; and their table."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp

from pixelid.inspection.leak_by_light import LeakByLight
from pixelid.inspection.static_noise_result import Condition, StaticNoise


def findings(
    conditions: Sequence[Condition], by_light: LeakByLight | None, lux: tuple[float, float] | None
) -> tuple[str, ...]:
    """What the conditions show, in sentences."""
    said = []
    for light in sorted({c.lux for c in conditions}):
        here = {c.polarity: c for c in conditions if c.lux == light}
        on, off = here.get("ON"), here.get("OFF")
        if on is None:
            continue
        if on.kind == "regular" and (off is None or off.kind == "silent"):
            said.append(f"{light:g} lux: ON only and regular (cv {_value(on.cv)}): a leak, not shot noise")
        elif on.kind == "irregular" and off is not None and off.kind == "irregular":
            said.append(
                f"{light:g} lux: both polarities, irregular (cv ON {_value(on.cv)}, OFF {_value(off.cv)}): noise "
                "across the thresholds, as shot noise makes; a leak as in brighter light would be hidden by it"
            )
        elif on.kind == "silent":
            said.append(f"{light:g} lux: too few ON events repeat to say anything")
        else:
            said.append(f"{light:g} lux: ON {on.kind}, OFF {off.kind if off else 'not given'}: no single effect")
    if by_light is not None and lux is not None:
        said.append(
            f"leak {_value((by_light.leak_hz, *by_light.leak_interval))} Hz in the median pixel, spread by a factor "
            f"{exp(by_light.leak_spread):.2g} over pixels, and {_value(_slope(by_light))} Hz/lux by light (factor "
            f"{exp(by_light.parasitic_spread):.2g}); without leak the likelihood loses "
            f"{by_light.nats_of_leak:.0f} nats, without parasitic photocurrent {by_light.nats_of_parasitic:.0f}"
        )
    return tuple(said)


def unknown(conditions: Sequence[Condition], lux: tuple[float, float] | None) -> tuple[str, ...]:
    """What they leave open, in sentences."""
    said = [
        "the length of the recordings is inferred (pixels that fire all along), not stated; rates scale with it",
        "events that a pixel sent once are not in the file, nor times, nor the order of intervals, nor ON against OFF",
    ]
    if lux is not None:
        said.append(
            f"{lux[0]:g} and {lux[1]:g} lux give two numbers per pixel: that one is proportional to light is assumed"
        )
    if any(c.kind == "irregular" for c in conditions):
        said.append(
            "irregular intervals at one light are noise of the front end; shot noise, as against noise of the "
            "amplifiers, would need its growth with light at two dark levels"
        )
    return tuple(said)


def static_noise_table(noise: StaticNoise):
    """A rich Table of the conditions; the sentences are its caption."""
    from rich import box
    from rich.table import Table

    caption = "\n".join((*noise.findings, *(f"not known: {s}" for s in noise.unknown)))
    table = Table(title="noise of a still scene", box=box.SIMPLE, title_justify="left", caption=caption)
    table.caption_justify = "left"
    for name in ("light", "intervals", "length [s]", "rate [Hz]", "cv"):
        table.add_column(name, no_wrap=True)
    for c in noise.conditions:
        rate = f"< {c.second_event_hz:.2g}" if c.second_event_hz is not None else _value(c.rate_hz)
        length = f"{c.duration_s[0]:.3g}" if c.duration_s else "–"
        table.add_row(f"{c.lux:g} lux {c.polarity}", str(c.intervals), length, rate, _value(c.cv, 2))
    return table


def _slope(by_light: LeakByLight) -> tuple[float, float, float]:
    return by_light.parasitic_hz_per_lux, *by_light.parasitic_interval


def _value(value: tuple[float, float, float] | None, digits: int = 3) -> str:
    return "–" if value is None else "{:.{n}g} ({:.{n}g}…{:.{n}g})".format(*value, n=digits)
