"""A recommended experiment as tables for the terminal."""

from __future__ import annotations

from pixelid.results import number

RANKING_HEADINGS = ("stimulus", "expected information [nats]", "±", "per second", "seconds", "events")
WIDTHS_HEADINGS = ("parameter", "value", "95 % before", "95 % after", "narrower by", "unit")


def ranking_rows(found: dict) -> list[list[str]]:
    """One row per candidate, best first."""
    return [
        [
            entry["name"],
            f"{entry['score']:.3f}",
            f"{entry['score_error']:.3f}",
            f"{entry['score_per_second']:.3f}",
            f"{entry['duration_s']:.3g}",
            f"{entry['events']:.0f}",
        ]
        for entry in found["ranking"]
    ]


def widths_rows(found: dict) -> list[list[str]]:
    """One row per free parameter."""
    rows = []
    for name, before in found["widths_before"].items():
        after = found["widths_after"][name]
        rows.append(
            [
                name,
                number(before["value"]),
                *(" … ".join(number(end) for end in width["interval_95"]) for width in (before, after)),
                f"{before['std_coordinate'] / after['std_coordinate']:.3g} ×",
                before["unit"],
            ]
        )
    return rows
