"""The tables of the page about speed, from docs/speed.json that `benchmarks/speed.py` wrote."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Mapping
from typing import Any

TITLES = {
    "filter": "The pixel's filter, with gradients",
    "video": "Video simulator",
    "likelihood": "Likelihood",
    "analysis": "Whole analyses",
    "rays": "Rendering",
    "growth": "Growth with the size of the problem",
    "startup": "Start-up",
}
Table = Callable[[Iterable[str], Iterable[Iterable[object]]], str]


def page(content: Mapping[str, Any], table: Table) -> str:
    """The sections that were measured, in their order."""
    machine, versions = content["machine"], content["versions"]
    named = ", ".join(f"{name} {versions[name]}" for name in ("pixelid", "python", "numpy", "numba", "torch")
                      if name in versions)  # fmt: skip
    missed = [
        f"{row['path']} ({_target(row)})" for row in content["rows"] if row["target"] and not row["target"]["met"]
    ]
    lines = [
        f"{machine['processor']}, {machine['cores']} cores; {named}. One core copies "
        f"{machine['copy_bytes_per_s'] / 1e9:.1f} GB/s (read and written together), makes "
        f"{machine['flops_per_s'] / 1e9:.1f} Gflop/s of multiply-adds and "
        f"{machine['exponentials_per_s'] / 1e6:.0f} million exponentials of vectors/s.\n",
        (f"Targets missed: {'; '.join(missed)}." if missed else "All targets are met.") + "\n",
    ]
    for section, title in TITLES.items():
        rows = [row for row in content["rows"] if row["section"] == section]
        if rows:
            lines += [f"## {title}\n", _growth(rows, table) if section == "growth" else _paths(rows, table)]
    return "\n".join(lines)


def _paths(rows: list[Mapping[str, Any]], table: Table) -> str:
    heads = ("path", "size", "ours", "compared with", "ratio", "target", "what bounds it", "load")
    cells = []
    for row in rows:
        ours = statistics.median(row["ours_s"])
        clock = "" if row["clock"] == "cpu" else f", wall time, {row['threads']} threads"
        rate = "" if row["items"] == 1 else f" ({_rate(row['items'] / ours, row['item'])})"
        other, ratio = row["other"], row["ratio"]
        compared = " ".join(filter(None, (other["name"], other["version"]))) if other else ""
        compared += f": {seconds(statistics.median(other['seconds']))}" if other else ""
        cells.append((
            row["path"], row["size"], f"{seconds(ours)}{rate}{clock}", compared,
            "{:.3g} ({:.3g} to {:.3g})".format(*ratio.values()) if ratio else "", _target(row), _bound(row),
            f"{max(row['load']):.1f}",
        ))  # fmt: skip
    notes = [f"- {row['path']}: {row['note']}." for row in rows if row["note"]]
    return "\n".join([table(heads, cells), *notes, ""])


def _growth(rows: list[Mapping[str, Any]], table: Table) -> str:
    heads = ("path", "sizes", "CPU time", "exponent", "memory above start", "exponent")
    cells = []
    for row in rows:
        powers = ["–" if power is None else f"{power:.2f}" for power in row["exponents"].values()]
        memory = ", ".join(f"{peak / 2**20:.0f}" for peak in row["peak_bytes"]) + " MiB"
        cpu = ", ".join(map(seconds, row["cpu_s"]))
        cells.append((row["path"], row["size"], cpu, powers[0], memory, powers[1]))
    notes = [f"- {row['path']}: {row['note']}." for row in rows if row["note"]]
    return "\n".join([table(heads, cells), *notes, ""])


def seconds(value: float) -> str:
    """Three digits with the unit that suits them."""
    for unit, scale in (("s", 1.0), ("ms", 1e3), ("µs", 1e6)):
        if value * scale >= 1.0:
            return f"{value * scale:.3g} {unit}"
    return f"{value * 1e6:.2g} µs"


def _rate(value: float, item: str) -> str:
    """Items per second with a prefix."""
    for prefix, scale in (("M ", 1e6), ("k ", 1e3)):
        if value >= scale:
            return f"{value / scale:.3g} {prefix}{item}s/s"
    return f"{value:.3g} {item}s/s"


def _target(row: Mapping[str, Any]) -> str:
    """Target and what was measured."""
    target = row["target"]
    if not target:
        return ""
    value, measured = target["value"], target["measured"]
    words = {
        "seconds": (f"at most {seconds(value)}", seconds(measured)),
        "ratio": (f"at least {value:g} ×", f"{measured:.3g} ×"),
        "rate": (f"at least {_rate(value, row['item'])}", _rate(measured, row["item"])),
    }[target["of"]]
    return f"{words[0]}: {words[1]}, {'met' if target['met'] else '**missed**'}"


def _bound(row: Mapping[str, Any]) -> str:
    bound = row["bound"]
    if "bytes_per_item" not in bound:
        return bound["words"]
    parts = [
        f"{bound[f'{name}_per_item']:.3g} {words}: {100 * bound[f'share_of_{peak}']:.0f} %"
        for name, peak, words in (
            ("bytes", "copy", "bytes"), ("flops", "flops", "flops"), ("exponentials", "exponentials", "exponentials")
        )
    ]  # fmt: skip
    return f"{', '.join(parts)}; {bound['words']}"
