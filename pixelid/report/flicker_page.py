"""The page of a flicker fit: what one mains frequency fixes, what it leaves open, and group by group."""

from __future__ import annotations

from pathlib import Path

FILE = "flicker.json"

CAPTIONS = {
    "phases": "Events by phase of the light, ON up and OFF down, of the groups with most events; lines: fit.",
    "maps": "Amplitude at the comparator in ON thresholds, and phase, group by group.",
}

BODY = """
<p><b>{{ result.status }}</b>{% if result.advice %} — {{ result.advice }}{% endif %}.
{{ result.frequency_hz.value }} ± {{ number(result.frequency_hz.std) }} Hz, light of shape “{{ result.shape }}”,
{{ result.groups | length }} groups of pixels ({{ result.groups_left_out }} had too few events).</p>
{% for title, sentences in (
  ("Identified", result.identified), ("Not identified", result.unidentified), ("Disagreements", result.disagreements)
) %}{% if sentences %}<h2>{{ title }}</h2>
<ul>{% for s in sentences %}<li>{{ s }}</li>{% endfor %}</ul>{% endif %}{% endfor %}
"""


def context(result: dict, folder: Path) -> dict:
    """What `BODY` needs beside `number` and `result`."""
    return {"title": "pixelid flicker"}
