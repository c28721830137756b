"""The page of a reconstruction: scores, correction, the pixel that was assumed, views with their errors."""

from __future__ import annotations

from pathlib import Path

FILE = "reconstruction.json"

CAPTIONS = {
    "views": "Test views: reference, reconstruction after the correction a·L^b − c fitted on validation views, and the "
    "absolute error.",
    "training": "Loss terms, and the PSNR of one validation view corrected on another.",
}

BODY = """
<p><b>{{ result.status }}</b>{% if result.advice %} — {{ result.advice }}{% endif %}.
Bandwidth {{ result.bandwidth }}, {{ result.iterations }} steps, {{ "%.0f" | format(result.seconds) }} s on
{{ result.device }}, {{ number(result.rays_per_second) }} rays/s.</p>
<table><tr><th>test view</th><th>PSNR [dB]</th><th>SSIM</th><th>LPIPS</th></tr>
{% for view in result.views.per_view %}<tr><td>{{ view.name }}</td><td>{{ "%.2f" | format(view.psnr) }}</td>
<td>{{ "%.3f" | format(view.ssim) }}</td><td>{{ number(view.lpips) }}</td></tr>{% endfor %}
<tr><th>mean</th><th>{{ "%.2f" | format(result.views.psnr) }}</th><th>{{ "%.3f" | format(result.views.ssim) }}</th>
<th>{{ number(result.views.lpips) }}</th></tr></table>
{% if result.lpips_note %}<p class="small">{{ result.lpips_note }}.</p>{% endif %}
<p>Of the changes that events of held-out pixels tell, {{ number(result.held_out_residual) }} (rms) is left unexplained.
The radiance unit is pinned by the {{ result.gauge.kind }}.</p>
<h2>Pixel</h2>
<table>{% for name, value in pixel %}<tr><td>{{ name }}</td><td>{{ value }}</td></tr>{% endfor %}</table>
"""


def context(result: dict, folder: Path) -> dict:
    """What `BODY` needs beside `number` and `result`."""
    from pixelid.fit.table import number

    def cell(value) -> str:
        return ", ".join(number(v) for v in value) if isinstance(value, list) else number(value)

    return {
        "title": "pixelid reconstruct",
        "pixel": [(name, cell(value)) for name, value in result["pixel"].items()],
    }
