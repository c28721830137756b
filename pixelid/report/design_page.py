"""The page of a recommended experiment: what, why, and what it would do to every parameter."""

from __future__ import annotations

from pathlib import Path

FILE = "design.json"

CAPTIONS = {
    "widths": "Standard errors in fitting coordinates (0.1 is 10 % for log parameters): before, and after the "
    "recommended stimulus.",
    "ranking": "Score of every stimulus on the menu; bars: spread over the parameter values drawn.",
}

BODY = """
<p><b>{{ result.status }}</b>{% if result.advice %} — {{ result.advice }}{% endif %}.</p>
<p>Next: <b>{{ result.recommended.name }}</b>. {{ result.why }}</p>
<h2>Ranking by {{ result.criterion }}</h2>
<table><tr>{% for h in ranking_headings %}<th>{{ h }}</th>{% endfor %}</tr>
{% for row in ranking %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>{% endfor %}</table>
<h2>Expected 95 % intervals</h2>
<table><tr>{% for h in widths_headings %}<th>{{ h }}</th>{% endfor %}</tr>
{% for row in widths %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>{% endfor %}</table>
"""


def context(result: dict, folder: Path) -> dict:
    """What `BODY` needs beside `number` and `result`."""
    from pixelid.design.table import RANKING_HEADINGS, WIDTHS_HEADINGS, ranking_rows, widths_rows

    return {
        "title": f"pixelid design: {result['model']}",
        "ranking_headings": RANKING_HEADINGS,
        "ranking": ranking_rows(result),
        "widths_headings": WIDTHS_HEADINGS,
        "widths": widths_rows(result),
    }
