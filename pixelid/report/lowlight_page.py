"""The page of a low-light analysis: radii, regimes, measured beside the model."""

from __future__ import annotations

from pathlib import Path

FILE = "lowlight.json"

CAPTIONS = {
    "poles": "Poles, −3 dB frequency and step time over radiance: exact (black; 95 % band of a fit in grey) and "
    "approximate. Green: measured; ×: the model's own events under the same light. Shaded: the pair is complex.",
    "errors": "Relative errors of the approximations; thin lines at 1, 10 and 50 %.",
    "bode": "Gain and phase of the whole pixel, exact and with the pair replaced by one pole.",
    "steps": "Response of the whole pixel to a small step of ln L.",
    "measured": "Gain over frequency, or response over time, from events: recording and model under the same light.",
}

BODY = """
<p><b>{{ result.status }}</b>{% if result.advice %} — {{ result.advice }}{% endif %}.</p>
{% for sentence in result.sentences %}<p>{{ sentence }}</p>{% endfor %}
<h2>Radiance [{{ result.radiance_unit }}] where the approximations err</h2>
<table><tr>{% for h in radii_headings %}<th>{{ h }}</th>{% endfor %}</tr>
{% for row in radii %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>{% endfor %}</table>
{% if result.bands %}<p>From the fit's uncertainty (95 %, {{ result.bands.draws }} draws):
{% for level, range in result.bands.first.one_pole.items() %}one pole errs by {{ level }} from
{% if range %}{{ number(range[0]) }} … {{ number(range[1]) }}{% else %}–{% endif %}{{ ", " if not loop.last }}
{% endfor %}.</p>{% endif %}
<h2>Levels shown</h2>
<table><tr><th>radiance</th><th>ε = αL/β²</th><th>γL/β</th><th>damping</th><th>pair</th></tr>
{% for level in result.regimes.levels %}<tr><td>{{ number(level.radiance) }}</td>
{% if level.damping is defined %}<td>{{ number(level.epsilon) }}</td><td>{{ number(level.gamma_ratio) }}</td>
<td>{{ number(level.damping) }}</td><td>{{ "complex" if level.complex else "real" }}</td>{% endif %}</tr>{% endfor %}
</table>
{% if measured %}<h2>Measured</h2>
<table><tr>{% for h in measured_headings %}<th>{{ h }}</th>{% endfor %}</tr>
{% for row in measured %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>{% endfor %}</table>
{% for sentence in not_measurable %}<p class="small">{{ sentence }}</p>{% endfor %}{% endif %}
"""


def context(result: dict, folder: Path) -> dict:
    """What `BODY` needs beside `number` and `result`."""
    from pixelid.lowlight.table import MEASURED_HEADINGS, RADII_HEADINGS, measured_rows, not_measurable, radii_rows

    return {
        "title": f"pixelid lowlight: {result['model']}",
        "radii_headings": RADII_HEADINGS,
        "radii": radii_rows(result),
        "measured_headings": MEASURED_HEADINGS,
        "measured": measured_rows(result),
        "not_measurable": not_measurable(result),
    }
