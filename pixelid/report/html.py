"""A result folder as one self-contained page.

Each kind of result has its page: a module of this folder with FILE (the JSON that marks the kind), CAPTIONS of its
figures, BODY (a Jinja template) and `context(result, folder)`, what the template needs, a title among it.
"""

from __future__ import annotations

import base64
import importlib
import json
from pathlib import Path

from pixelid.errors import InputError

PAGES = (
    "gap_page",
    "fit_page",
    "lowlight_page",
    "design_page",
    "rates_page",
    "flicker_page",
    "reconstruction_page",
)

_SHELL = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{{ title }}</title><style>
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #222 }
h1 { font-size: 1.5rem } h2 { font-size: 1.1rem; margin-top: 2rem }
table { border-collapse: collapse } td, th { padding: .2rem .8rem; border-bottom: 1px solid #ddd; text-align: right }
td:first-child, th:first-child { text-align: left } .no { color: #b00 } img { max-width: 100% }
figcaption { font-size: .85rem; color: #555 } .small { font-size: .8rem; color: #555 }
</style></head><body>
<h1>{{ title }}</h1>
BODY
{% for name, image, caption in figures %}
<figure><img alt="{{ name }}" src="data:image/png;base64,{{ image }}"><figcaption>{{ caption }}</figcaption></figure>
{% endfor %}
<p class="small">{% if result.seed is defined %}Seed {{ result.seed }}; {% endif %}
{% for k, v in result.versions.items() %}{{ k }} {{ v }}
{{- ", " if not loop.last }} {% endfor %}. Inputs:
{% for k, v in result.inputs_sha256.items() %}{{ k }} {{ v[:12] }}{{ ", " if not loop.last }}{% endfor %}.</p>
</body></html>
"""


def write_report(folder: Path) -> Path:
    """Write report.html of a result folder from its JSON and figures; returns its path.

    Raises InputError when the folder holds no result.
    """
    import jinja2

    from pixelid.fit.table import number

    folder = Path(folder)
    pages = [importlib.import_module(f"pixelid.report.{name}") for name in PAGES]
    page = next((page for page in pages if (folder / page.FILE).is_file()), None)
    if page is None:
        known = ", ".join(page.FILE for page in pages)
        raise InputError(f"{folder}: none of {known}; expected the folder of a result")
    try:
        result = json.loads((folder / page.FILE).read_text(encoding="utf-8"))
    except ValueError:
        raise InputError(f"{folder / page.FILE}: not valid JSON") from None
    figures = [
        (path.stem, base64.b64encode(path.read_bytes()).decode(), page.CAPTIONS.get(path.stem, path.stem))
        for path in sorted(folder.glob("*.png"))
    ]
    rendered = (
        jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
        .from_string(_SHELL.replace("BODY", page.BODY))
        .render(result=result, figures=figures, number=number, **page.context(result, folder))
    )
    path = folder / "report.html"
    path.write_text(rendered, encoding="utf-8")
    return path
