"""The low-light analysis as tables for the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from pixelid.lowlight.radii import LEVELS

NAMES = {"one_pole": "one pole", "at_dark": "dark tangent"}
QUANTITIES = {"bandwidth_hz": "−3 dB [Hz]", "step_time_s": "63 % [s]", None: "–"}


def number(value: float | None) -> str:
    """Three significant digits, or a dash."""
    return "–" if value is None else f"{value:.3g}"


def radii_rows(content: dict) -> list[list[str]]:
    """One row per approximation, quantity and scope: largest errors and first radii."""
    rows = []
    for kind, by_quantity in content["errors"].items():
        if kind == "at_dark" and content["dark_radiance"] == 0:
            continue  # the same line as one_pole
        for quantity, by_scope in by_quantity.items():
            for scope, entry in by_scope.items():
                first = [entry["levels"][f"{100 * level:g}%"]["first"] for level in LEVELS]
                rows.append(
                    [NAMES[kind], _named(quantity, scope)]
                    + ["dark" if value == 0 else number(value) for value in first]
                    + [_share(entry["largest_under"]), _share(entry["largest_over"])]
                )
    return rows


def _named(quantity: str, scope: str) -> str:
    return "slowest pole" if quantity == "dominant_pole" else f"{quantity.replace('_', ' ')}, {scope}"


def _share(error: float) -> str:
    """A signed error in per cent; one of many times the value as such.

    >>> _share(-0.494), _share(0.26), _share(0.001), _share(12.0)
    ('−49 %', '+26 %', '0 %', '> 10×')
    """
    if error >= 10:
        return "> 10×"
    percent = round(100 * error)
    return f"{percent:+d} %".replace("-", "−") if percent else "0 %"


def measured_rows(content: dict) -> list[list[str]]:
    """One row per recording."""
    rows = []
    for entry in content["measured"]:
        interval, model = entry["interval_95"], entry["model"] or {}
        rows.append(
            [
                entry["recording"],
                number(entry["radiance"]),
                QUANTITIES[entry["quantity"]],
                number(entry["value"]),
                f"{number(interval[0])} … {number(interval[1])}" if interval else "–",
                number(model.get("same_light")),
                number(model.get("same_light_one_pole")),
                number(model.get("small_signal")),
            ]
        )
    return rows


def not_measurable(content: dict) -> list[str]:
    """Why a recording gave no number, or no interval; one sentence each."""
    return [
        f"{e['recording']}: {'not measurable: ' * (e['value'] is None)}{e['why']}"
        for e in content["measured"]
        if e["why"]
    ]


def latency_rows(latency: dict) -> list[list[str]]:
    """One row per light of a table of latencies, dim first."""
    return [
        [
            one["edge"],
            one["lens"],
            number(one["irradiance_W_m2"]),
            number(one["light_W_m2"]),
            number(one["pole_rad_s"]) if one["identified"] else "not identified",
            _limits(one["interval_95"]),
            number(one["model"]["pole_rad_s"]),
            _limits(one["model"]["interval_95"]),
            number(one["one_law"]["pole_rad_s"]),
        ]
        for one in sorted(latency["levels"], key=lambda one: one["light_W_m2"])
    ]


def _limits(interval: Sequence[float | None] | None) -> str:
    if interval is None:
        return "–"
    low, high = interval
    return f"{number(low)} …" if high is None else f"{number(low)} … {number(high)}"


RADII_HEADINGS = ("approx.", "quantity", "1 %", "10 %", "50 %", "worst underestimate", "worst overestimate")
LATENCY_HEADINGS = ("light", "lens", "lit [W/m²]", "after [W/m²]", "measured", "95 %", "model", "95 % ", "one law")
MEASURED_HEADINGS = ("recording", "radiance", "quantity", "measured", "95 %", "model", "one pole", "small signal")
