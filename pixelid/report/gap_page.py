"""The page of a search for the gap: verdict, where, what each effect explains, before and after, what next."""

from __future__ import annotations

from pathlib import Path

FILE = "gap.json"

CAPTIONS = {
    "map": "Where residuals leave zero most. Level: events late (red) or early (blue); spread: more or less scatter; "
    "memory: an event's residual against the one before. Independent scores of a true model stay within about ±4.",
    "forest": "Log-likelihood that each effect gains: on pixels no fit has seen (dots), on the pixels fitted (ticks).",
    "closed": "Free-run gap per recording on the pixels set aside: before, after, and chance alone.",
    "before_after": "The recordings with the largest gap: measured (filled), base model, grown model.",
    "edges": "Measured counts over what the base and the grown model expect, by the time since the light jumped.",
    "unknown": "The nameless term: threshold shift that would explain the remainder, with 95 % bars.",
}

BODY = """
<p><b>{{ result.verdict }}</b> — {{ result.sentence }}</p>
<p>Chance of the base model showing this by itself: p = {{ number(result.global_p) }}; of what is left:
{{ number(result.details.remaining_p) }} (α = {{ result.alpha }}).
{% if not result.details.held_out %}<b class="no">Too few pixels to set any aside: gains are judged on the pixels
fitted.</b>{% endif %}</p>
{% if result.effects %}<h2>Effects named</h2>
<table><tr><th>effect</th><th>strength</th><th>adjusted p</th><th>held-out gain</th><th>runner-up</th>
<th>most alike (|cos|)</th></tr>
{% for e in result.effects %}<tr><td>{{ e.name }}</td>
<td>{% for k, v in e.parameters.items() %}{{ k }} = {{ number(v.value) }}
{% if v.interval_95 %}({{ number(v.interval_95[0]) }} … {{ number(v.interval_95[1]) }}){% endif %}
{{ "; " if not loop.last }}{% endfor %}</td>
<td>{{ number(e.p_value) }}</td><td>{{ number(e.heldout_gain_nats) }} nats</td>
<td>{% if e.runner_up %}{{ e.runner_up }}, {{ number(e.runner_up_gain_nats) }} nats{% else %}–{% endif %}</td>
<td>{% if e.max_cosine_with %}{{ e.max_cosine_with }} ({{ "%.2f" | format(e.max_cosine) }}){% else %}–{% endif %}</td>
</tr>{% endfor %}</table>
<ul>{% for e in result.effects %}<li>{{ e.name }} was found here: {{ e.where }}.</li>{% endfor %}</ul>{% endif %}
{% if result.gap %}<h2>The gap, on pixels set aside</h2>
<p>{{ result.gap.metric }}: {{ number(result.gap.before) }} before, {{ number(result.gap.after) }} after, chance alone
{{ number(result.gap.floor) }}.{% if result.gap.closed_fraction is not none %} Closed:
{{ "%.3f" | format(result.gap.closed_fraction) }}{% if result.gap.closed_fraction_interval %}
({{ "%.3f" | format(result.gap.closed_fraction_interval[0]) }} …
{{ "%.3f" | format(result.gap.closed_fraction_interval[1]) }}){% endif %}.{% endif %}</p>{% endif %}
{% if result.unknown_term %}<h2>What no effect explains</h2>
<p>Thresholds that depend on {{ result.unknown_term.depends_on }} would gain
{{ number(result.unknown_term.heldout_gain_nats) }} nats on pixels not used to find them. That is a description, not
a cause.</p>{% endif %}
{% if result.details.confusion is defined %}<h2>What these recordings can show, and take for what</h2>
<p>Nats by which each effect still missing from the model would show at its typical strength, beside all free
parameters (below 5 it would go unseen); the effect it looks most like under these stimuli; and the nats that would tell
the two apart (below 5: ambiguous).</p>
<table><tr><th>effect</th><th>would show</th><th>most alike (|cos|)</th><th>told apart by</th></tr>
{% for k, v in result.details.confusion.items() %}<tr><td>{{ k }}</td>
<td>{{ number(result.details.shows_at_typical_strength_nats[k]) }} nats</td>
<td>{% if v.most_alike %}{{ v.most_alike }} ({{ "%.2f" | format(v.cosines[v.most_alike]) }}){% else %}–{% endif %}</td>
<td>{{ number(v.told_apart_nats) }} nats</td></tr>{% endfor %}</table>{% endif %}
{% if result.details.after_jumps is defined %}<h2>Counts after the light jumped</h2>
<table><tr><th>where</th><th>measured</th><th>base model</th><th>grown model</th></tr>
{% for row in result.details.after_jumps %}<tr><td>{{ row.where }}</td><td>{{ number(row.measured) }}</td>
<td>{{ number(row.base) }}</td><td>{{ number(row.grown) }}</td></tr>{% endfor %}</table>{% endif %}
<h2>What to record next</h2>
<p>{% if result.recommended_next.stimulus %}{{ result.recommended_next.stimulus.name }}
({{ result.recommended_next.stimulus.kind }},
{% for k, v in result.recommended_next.stimulus.parameters.items() %}
{{ k }} = {{ number(v) }}{{ ", " if not loop.last }}{% endfor %}) — {% endif %}{{ result.recommended_next.why }}.</p>
"""


def context(result: dict, folder: Path) -> dict:
    """What `BODY` needs beside `number` and `result`."""
    return {"title": f"pixelid gap: {result['verdict']}"}
