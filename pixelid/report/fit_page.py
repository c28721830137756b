"""The page of a fit: parameters, what is not identified, physical values under the gauge."""

from __future__ import annotations

import json
from pathlib import Path

FILE = "fit.json"

CAPTIONS = {
    "conditions": "Events per pixel and second over time, per recording: measured (filled) and simulated by the fitted "
    "model (lines); ON up, OFF down.",
    "corner": "Posterior: every parameter against every other, with the contours of 68 and 95 %.",
    "trace": "Posterior: mean and 5 to 95 % range of the walkers at every step, one colour per ensemble.",
    "residuals": "What is left: level at each event minus its pixel's threshold, in standard deviations. Points that "
    "leave zero by more than their bars show an effect the model lacks.",
    "edges": "Average response to the light's steps: measured (filled) and fitted (lines).",
    "truth": "Estimates with 95 % intervals, relative to the truth.",
}

BODY = """
<p><b>{{ fit.status }}</b>{% if fit.advice %} — {{ fit.advice }}{% endif %}.
{{ fit.events }} events of {{ fit.pixels }} pixels in {{ fit.recordings | length }} recordings,
{{ fit.observation | replace("_", " ") }} likelihood, {{ "%.1f" | format(fit.seconds) }} s.</p>
<h2>Parameters</h2>
<table><tr><th>parameter</th><th>value</th><th>95 % interval</th><th>unit</th><th>known?</th>
{% if truth %}<th>truth</th>{% endif %}</tr>
{% for name, p in fit.parameters.items() %}<tr><td>{{ name }}</td><td>{{ number(p.value) }}</td>
<td>{% if p.interval_95 %}{{ number(p.interval_95[0]) }} … {{ number(p.interval_95[1]) }}{% else %}–{% endif %}</td>
<td>{{ p.unit }}</td>
<td>{% if p.fixed %}fixed{% elif p.identified %}yes{% else %}<b class="no">no</b>{% endif %}</td>
{% if truth %}<td>{{ number(truth.get(name)) }}</td>{% endif %}</tr>{% endfor %}</table>
{% if fit.unidentified %}<h2>Not identified</h2>
<ul>{% for s in fit.unidentified %}<li>{{ s }}</li>{% endfor %}</ul>{% endif %}
<h2>Physical values under the gauge</h2>
{% if fit.physical %}<p>Assuming {% for k, v in fit.gauge.fixed.items() %}{{ k }} = {{ v }}{{ ", " if not loop.last }}
{% endfor %}:
{% for k, v in fit.physical.items() %}{{ k }} = {{ number(v) }}{{ ", " if not loop.last }}{% endfor %}.</p>
{% else %}<p>None: {{ fit.gauge.why_no_physical }}.</p>{% endif %}
"""


def context(result: dict, folder: Path) -> dict:
    """What `BODY` needs beside `number`."""
    truth = folder / "truth.json"
    return {
        "title": f"pixelid fit of {result['model']}",
        "fit": result,
        "truth": json.loads(truth.read_text()) if truth.is_file() else None,
    }
