"""The notebooks as pages of the site, with the outputs that are stored in them, and a gallery of pictures."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Callable
from functools import partial

from page_parts import ROOT

GENERATED = ROOT / "docs" / "_generated"
NAMES = ("calibrate", "hidden_effect", "reconstruction", "gauge")
# Pictures of other pages: (file, sentence, page).  Files below _generated are made by the pages before.
PICTURES = (
    ("tutorial/photodiode.svg", "Light for a calibration: a chirp", "tutorial.md"),
    ("picture.png", "From light and events to the fitted pixel", "tutorial.md"),
    ("_generated/notebook_calibrate_2.png", "A fit's intervals, and where it started", "notebooks/calibrate.md"),
    ("_generated/notebook_gauge_1.png", "Circuit values that events cannot fix", "notebooks/gauge.md"),
    ("tutorial/residuals.svg", "Residuals without and with a leak", "howto/gap.md"),
    ("_generated/notebook_hidden_effect_1.png", "Where a model is wrong", "notebooks/hidden_effect.md"),
    ("gap_certification.png", "Verdicts by planted effect", "results/gap.md"),
    ("_generated/lowlight_poles.svg", "Where one pole is enough", "results/lowlight.md"),
    ("_generated/gen31_latency.svg", "Latencies of a camera, measured and predicted", "results/sensors.md"),
    ("moving_plane.png", "Motion blur of events, undone", "results/reconstruction.md"),
    ("_generated/notebook_reconstruction_1.png", "A scene under three pixel models", "notebooks/reconstruction.md"),
)  # fmt: skip


def notebook(name: str) -> str:
    """A notebook as Markdown: its text, its code, and what its cells printed and drew.

    Args:
        name: of a file in `notebooks/`, without `.ipynb`
    """
    cells = json.loads((ROOT / "notebooks" / f"{name}.ipynb").read_text())["cells"]
    parts, pictures = [], 0
    for cell in cells:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(_linked(source))
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            data = output.get("data", {})
            if "image/png" in data:
                pictures += 1
                file = f"notebook_{name}_{pictures}.png"
                (GENERATED / file).write_bytes(base64.b64decode(data["image/png"]))
                parts.append(f"![Output of the code above](../_generated/{file})")
            elif text := "".join(output.get("text", data.get("text/plain", ""))):
                parts.append(f"```text\n{text.rstrip()}\n```")
    parts.insert(1, f"Run it yourself: {{download}}`{name}.ipynb <../../notebooks/{name}.ipynb>`.")
    return "\n\n".join(parts) + "\n"


def _linked(text: str) -> str:
    """`docs/gauge.md` as a link to that page."""
    return re.sub(r"docs/((?:\w+/)?\w+)\.md", r"[\1](../\1.md)", text)


def gallery() -> str:
    """Pictures, each with a sentence that leads to its page."""
    items = (
        f"```{{container}} picture\n[![{sentence}]({file})]({page})\n\n[{sentence}]({page})\n```"
        for file, sentence, page in PICTURES
    )
    return "````{container} gallery\n" + "\n".join(items) + "\n````\n"


PAGES: dict[str, Callable[[], str]] = {
    **{f"notebook_{name}": partial(notebook, name) for name in NAMES},
    "gallery": gallery,
}
