"""What each round tried, as a table for the terminal."""

from __future__ import annotations

from pixelid.gap.result import GapReport


def gap_table(report: GapReport):
    """A rich table: one row per effect fitted, round by round."""
    from rich.table import Table

    table = Table(title="effects tried, log-likelihood gained")
    for heading in ("round", "effect", "gain [nats]", "held-out [nats]", "adjusted p", ""):
        table.add_column(heading, justify="left" if heading in ("effect", "") else "right")
    for entry in report.rounds:
        for c in entry["candidates"]:
            said = "named" if c["name"] == entry["named"] else ""
            table.add_row(
                str(entry["round"]), c["name"], f"{c['gain_nats']:.1f}", f"{c['heldout_gain_nats']:.1f}",
                f"{c['p_value']:.2g}", said,
            )  # fmt: skip
    return table
