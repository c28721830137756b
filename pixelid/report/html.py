"""A result folder as one self-contained page: the kind of result by its JSON, a template, figures inside.

Nothing is loaded from anywhere: styles and drawings are in the page, and its content security policy forbids the rest.
Text of the result is escaped, and control characters (also those that turn the direction of text) are left out.
"""

from __future__ import annotations

import itertools
import json
import tomllib
from pathlib import Path
from typing import Any

from pixelid.errors import InputError
from pixelid.figures.style import without_control_characters
from pixelid.outputs import whole_file
from pixelid.report import format as formats
from pixelid.report.pages import PAGES, Page
from pixelid.report.pictures import Picture, read_picture

TEMPLATES = Path(__file__).parent / "templates"
CAPTIONS = Path(__file__).parent / "captions.toml"
LINKED = (".json", ".toml", ".nc", ".npz", ".csv", ".h5")
_DIRECTION = dict.fromkeys([0x200E, 0x200F, *range(0x202A, 0x202F), *range(0x2066, 0x206A)])


def write_report(folder: Path) -> Path:
    """Write report.html of a result folder from its JSON and figures.

    Args:
        folder: of any result: fit, gap, lowlight, design, rates, flicker, reconstruct, inspect, compare, sensor.

    Returns:
        The path of the page.

    Raises:
        InputError: when the folder holds no result.
    """
    folder = Path(folder)
    page = next((page for page in PAGES if (folder / page.file).is_file()), None)
    if page is None:
        known = ", ".join(page.file for page in PAGES)
        raise InputError(f"{folder}: none of {known}; expected the folder of a result")
    try:
        result = clean(json.loads((folder / page.file).read_text(encoding="utf-8")))
    except ValueError:
        raise InputError(f"{folder / page.file}: not valid JSON") from None
    with whole_file(folder / "report.html", overwrite=True) as path:
        path.write_text(render(page, result, folder), encoding="utf-8")
    return folder / "report.html"


def render(page: Page, result: dict[str, Any], folder: Path) -> str:
    """The page of a result as text."""
    import jinja2

    pictures = _pictures(page, folder)
    ids = itertools.count(1)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals |= {
        "number": formats.number,
        "value": formats.value,
        "interval": formats.interval,
        "counted": formats.counted,
        "unique": lambda: f"rows-{next(ids)}",
        "take": lambda name: pictures.pop(name, None),
        "has": lambda name: name in pictures,
        "result": result,
        "summary": page.summarise(result, folder),
        "files": sorted(path.name for path in folder.iterdir() if path.suffix in LINKED and path.is_file()),
        "others": (),
        **page.prepare(result, folder),
    }
    # figures that the template does not name come at its end: the first rendering says which are left
    template = environment.get_template(page.template)
    every = dict(pictures)
    template.render()
    left = list(pictures.values())
    pictures.update(every)
    ids = itertools.count(1)
    return without_control_characters(template.render(others=left))


def _pictures(page: Page, folder: Path) -> dict[str, Picture]:
    files = {path.stem: path for path in sorted(folder.glob("*.png"))}
    files |= {path.stem: path for path in sorted(folder.glob("*.svg"))}
    captions = tomllib.loads(CAPTIONS.read_text(encoding="utf-8")).get(Path(page.file).stem, {})
    pictures = {}
    for name, path in files.items():
        shown = clean(name)
        words = captions.get(name, {"caption": shown.replace("_", " "), "alt": f"Figure: {shown.replace('_', ' ')}"})
        pictures[name] = read_picture(path, words["caption"], words["alt"])
    return pictures


def clean(value: Any) -> Any:
    """`value` of a JSON file with every text, keys too, free of control characters."""
    if isinstance(value, str):
        return without_control_characters(value).translate(_DIRECTION)
    if isinstance(value, dict):
        return {clean(k): clean(v) for k, v in value.items()}
    if isinstance(value, list):
        return [clean(v) for v in value]
    return value
