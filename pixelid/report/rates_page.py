"""The page of a fitted rate table: parameters, and where table and model disagree."""

from __future__ import annotations

from pathlib import Path

FILE = "rates.json"

CAPTIONS = {"rates": "Measured (dots) and fitted (lines) above; below, what is left."}

BODY = """
<p><b>{{ result.status }}</b>{% if result.advice %} — {{ result.advice }}{% endif %}.
{{ result.cells_fitted }} cells, relative scatter {{ number(100 * result.relative_scatter) }} %.</p>
<h2>Parameters</h2>
<table><tr><th>parameter</th><th>value</th><th>95 % interval</th><th>unit</th><th>known?</th></tr>
{% for name, p in result.parameters.items() %}<tr><td>{{ name }}</td><td>{{ number(p.value) }}</td>
<td>{% if p.interval_95 %}{{ number(p.interval_95[0]) }} … {{ number(p.interval_95[1]) }}{% else %}–{% endif %}</td>
<td>{{ p.unit }}</td><td>{% if p.identified %}yes{% else %}<b class="no">no</b>{% endif %}</td></tr>{% endfor %}</table>
{% for title, sentences in (("Not identified", result.unidentified), ("Disagreements", result.disagreements)) %}
{% if sentences %}<h2>{{ title }}</h2>
<ul>{% for s in sentences %}<li>{{ s }}</li>{% endfor %}</ul>{% endif %}{% endfor %}
"""


def context(result: dict, folder: Path) -> dict:
    """What `BODY` needs beside `number` and `result`."""
    return {"title": "pixelid rates: " + {"pixel": "one pixel", "pool": "the image of a light"}[result["model"]]}
