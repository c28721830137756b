"""A result folder as one self-contained page."""

from __future__ import annotations

import base64
import json
from pathlib import Path

from pixelid.errors import InputError

_CAPTIONS = {
    "conditions": "Events per pixel and second over time, per recording: measured (filled) and simulated by the fitted "
    "model (lines); ON up, OFF down.",
    "residuals": "What is left: level at each event minus its pixel's threshold, in standard deviations. Points that "
    "leave zero by more than their bars show an effect the model lacks.",
    "edges": "Average response to the light's steps: measured (filled) and fitted (lines).",
    "truth": "Estimates with 95 % intervals, relative to the truth.",
}

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{{ title }}</title><style>
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #222 }
h1 { font-size: 1.5rem } h2 { font-size: 1.1rem; margin-top: 2rem }
table { border-collapse: collapse } td, th { padding: .2rem .8rem; border-bottom: 1px solid #ddd; text-align: right }
td:first-child, th:first-child { text-align: left } .no { color: #b00 } img { max-width: 100% }
figcaption { font-size: .85rem; color: #555 } .small { font-size: .8rem; color: #555 }
</style></head><body>
<h1>{{ title }}</h1>
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
{% for name, image, caption in figures %}
<figure><img alt="{{ name }}" src="data:image/png;base64,{{ image }}"><figcaption>{{ caption }}</figcaption></figure>
{% endfor %}
<p class="small">Seed {{ fit.seed }}; {% for k, v in fit.versions.items() %}{{ k }} {{ v }}{{ ", " if not loop.last }}
{% endfor %}. Inputs:
{% for k, v in fit.inputs_sha256.items() %}{{ k }} {{ v[:12] }}{{ ", " if not loop.last }}{% endfor %}.</p>
</body></html>
"""


def write_report(folder: Path) -> Path:
    """Write report.html of a result folder from its JSON and figures; returns its path.

    Raises InputError when the folder holds no result.
    """
    import jinja2

    from pixelid.fit.table import number

    folder = Path(folder)
    if not (folder / "fit.json").is_file():
        raise InputError(f"{folder}: no fit.json; expected the folder of a result")
    fit = json.loads((folder / "fit.json").read_text())
    truth_file = folder / "truth.json"
    figures = [
        (path.stem, base64.b64encode(path.read_bytes()).decode(), _CAPTIONS.get(path.stem, path.stem))
        for path in sorted(folder.glob("*.png"))
    ]
    page = (
        jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
        .from_string(_PAGE)
        .render(
            title=f"pixelid fit of {fit['model']}",
            fit=fit,
            truth=json.loads(truth_file.read_text()) if truth_file.is_file() else None,
            figures=figures,
            number=number,
        )
    )
    path = folder / "report.html"
    path.write_text(page)
    return path
