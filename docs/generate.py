"""Pages made when the site is built: from the effect classes, the help texts, docstrings and the shipped models.

What benchmarks measured is in `measured.py`.  Nothing here is committed as text, so a figure on a page cannot differ
from the file that a benchmark wrote.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import measured
import method_figures
import names
import notebook_pages
import reference
from page_parts import ROOT, percent, table

GENERATED = ROOT / "docs" / "_generated"
SENSOR_FIGURES = {
    "latency": "Median latencies over irradiance, measured (marks) and predicted (lines), one colour per setting",
    "limits": "Share of the latency that goes with each stage, over irradiance",
}


def effect_library() -> str:
    """Every effect with its equation, source and parameters, from the classes themselves."""
    from pixelid.stages import LIBRARY

    stages = defaultdict(list)
    for effect in LIBRARY.values():
        stages[effect.stage].append(effect)
    lines = []
    for stage, effects in stages.items():
        lines.append(f"## {stage.replace('_', ' ').capitalize()}\n")
        for effect in effects:
            lines += [f"### {effect.name}\n", effect.sentence + "\n", f"```text\n{effect.equation}\n```\n"]
            rows = (
                (f"`{p.name}`", f"{p.value:.6g}", p.unit, f"{p.lower:g} to {p.upper:g}", p.transform,
                 "yes" if p.free else "no")
                for p in effect.parameters
            )  # fmt: skip
            lines += [table(("parameter", "default", "unit", "bounds", "coordinate", "fitted"), rows)]
            lines.append(f"Source: {effect.source}.\n")
    return "\n".join(lines)


def commands() -> str:
    """The help text of every command."""
    environment = os.environ | {"COLUMNS": "100", "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}

    def text(*words: str) -> str:
        command = [sys.executable, "-m", "pixelid", *words, "--help"]
        return subprocess.check_output(command, text=True, env=environment)

    names = [line.split()[0] for line in text().split("Commands:")[1].splitlines() if line[:2] == "  " != line[2:4]]
    names = [name for name in names if name.isidentifier()]
    return "\n".join(f"## {name}\n\n```text\n{text(name).rstrip()}\n```\n" for name in names)


def lowlight() -> str:
    """Where one pole describes the photoreceptor of `dvs128`, computed now by `pixelid lowlight`."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "lowlight"
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
        command = [sys.executable, "-m", "pixelid", "lowlight", "dvs128", "--out", str(out), "--quiet"]
        subprocess.run(command, check=True, env=environment)
        result = json.loads((out / "lowlight.json").read_text())
        shutil.copy(out / "poles.svg", GENERATED / "lowlight_poles.svg")
    lines = []
    for approximation, quantities in result["errors"].items():
        if approximation == "at_dark" and result["dark_radiance"] == 0:
            continue  # the same as one_pole
        rows = []
        for quantity, scopes in quantities.items():
            for scope, errors in scopes.items():
                first = [level["first"] for level in errors["levels"].values()]
                cells = ["never" if x is None else ("in the dark" if x == 0 else f"{x:.3g}") for x in first]
                rows.append((quantity.replace("_", " "), scope, *cells))
        levels = list(next(iter(next(iter(quantities.values())).values()))["levels"])
        heads = ("quantity", "of", *(f"error of {level} from [{result['radiance_unit']}]" for level in levels))
        lines += [f"**`{approximation}`**\n", table(heads, rows)]
    return "\n".join([*lines, *(f"- {sentence}" for sentence in result["sentences"]), ""])


def grammar() -> str:
    """The cells of `stages/described.py`, with their equations."""
    from pixelid.stages.described import all_cells

    rows = [(c.stage, f"`{c.quantity}`", f"`{c.covariate}`", f"`{c.form}`", c.equation) for c in all_cells()]
    return table(("stage", "quantity", "covariate", "form", "equation"), rows)


def schemas() -> str:
    """The schemas of docs/schemas, with the keys of their top level."""
    parts = []
    for path in sorted((ROOT / "docs" / "schemas").glob("*.json")):
        schema = json.loads(path.read_text())
        if path.stem == "common":
            continue
        required = set(schema.get("required", ()))
        rows = [(f"`{key}`", "" if key in required else "optional", _meaning(entry))
                for key, entry in schema["properties"].items()]  # fmt: skip
        link = f'Schema: <a href="{path.name}">{path.name}</a>.'
        parts += [f"### {schema['title']}\n", f"{schema['description']} {link}\n", table(("key", "", "meaning"), rows)]
    return "\n".join(parts)


def _meaning(entry: dict) -> str:
    """A schema's entry in a few words."""
    if "$ref" in entry:
        return entry["$ref"].split("/")[-1].replace("_", " ")
    kind = entry.get("type") or ("one of " + ", ".join(f"`{x}`" for x in entry["enum"]) if "enum" in entry else "")
    kind = " or ".join(kind) if isinstance(kind, list) else kind
    if "const" in entry:
        kind = f"`{entry['const']}`"
    if "anyOf" in entry:
        kind = " or ".join(
            filter(None, (_meaning({k: v for k, v in one.items() if k != "description"}) for one in entry["anyOf"]))
        )
    description = entry.get("description", "")
    return f"{kind}: {description}" if kind and description else kind or description or "any"


def sensors() -> str:
    """The shipped models of real sensors against the table they were fitted to, predicted when the site is built."""
    from pixelid.figures.style import save_figure
    from pixelid.model.shipped import shipped_models
    from pixelid.tables.latency.camera import load_camera
    from pixelid.tables.latency.figures import draw_latency, draw_limits
    from pixelid.tables.latency.recipe import read_latency_recipe
    from pixelid.tables.latency.result import predicted_result

    lines = []
    for name in ("gen31", "imx636"):
        recipe = read_latency_recipe(ROOT / "fits" / f"{name}.toml")
        camera = load_camera(shipped_models()[name])
        result = predicted_result(recipe.table, (camera,))
        lines += [f"## `{name}`\n", camera.model.summary + "\n"]
        for file, axes in (("latency", draw_latency(result["rows"])), ("limits", draw_limits(result["limits"]))):
            save_figure(axes, GENERATED / f"{name}_{file}.svg")
            lines.append(f"![{SENSOR_FIGURES[file]}](../_generated/{name}_{file}.svg)\n")
        lines += [f"- {sentence}" for sentence in result["limiting_stages"]]
        errors = [
            (label, statistic, e["rows"], percent(e["rms"]), e["spoiled"], percent(e["rms_without_spoiled"]))
            for label, by in result["errors"].items()
            for statistic, e in by.items()
        ]
        heads = ("camera", "statistic", "rows", "rms of ln, all rows", "set aside", "rms of ln, without them")
        lines += ["", table(heads, errors)]
        rows = [(f"`{p.name}`", f"{p.value:.4g} {p.unit}", p.source) for p in camera.model.parameters.values()]
        lines.append(table(("parameter", "value", "from"), rows))
        rows = [
            (
                s.name,
                f"{s.on_threshold:.3g}",
                f"{s.off_threshold:.3g}",
                f"{1e6 * s.on_delay_s:.0f}",
                f"{1e6 * s.off_delay_s:.0f}",
            )
            for s in camera.settings
        ]
        heads = ("setting", "ON threshold", "OFF threshold", "ON delay [µs]", "OFF delay [µs]")
        lines.append(table(heads, rows))
    return "\n".join(lines)


def lowlight_figure() -> str:
    """The figure that `lowlight` has left."""
    return "![Poles, bandwidth and step time of `dvs128` over radiance](../_generated/lowlight_poles.svg)\n"


PAGES: dict[str, Callable[[], str]] = {
    "sensors": sensors,
    "effects": effect_library,
    "commands": commands,
    "lowlight": lowlight,
    "figure_lowlight": lowlight_figure,
    "lowlight_latencies": measured.lowlight_latencies,
    "certification": measured.certification,
    "described": measured.described,
    "grammar": grammar,
    "sensitivity": measured.sensitivity,
    "export_comparison": measured.export_comparison,
    "conform_results": measured.conform_results,
    "combinations": measured.combinations,
    "independent": measured.independent,
    "coverage": measured.coverage,
    "bench_sessions": measured.bench_sessions,
    "faults": measured.faults,
    "fuzzing": measured.fuzzing,
    "speed": measured.speed,
    "ranks": measured.ranks,
    "pixel_light": measured.pixel_light,
    "round_trip": measured.round_trip,
    "reconstruction": measured.reconstruction,
    "moving_plane": measured.moving_plane,
    "schemas": schemas,
    "api": reference.page,
    "names": names.page,
    **method_figures.PAGES,
    **notebook_pages.PAGES,
}


def write_all(folder: Path) -> None:
    """Write every page into `folder`; a page that has not changed keeps its time, so that Sphinx skips it."""
    (folder / "api" / "types").mkdir(parents=True, exist_ok=True)
    objects = {f"api/{name}": text for name, text in reference.pages().items()}
    for name, make in PAGES.items():
        objects[name] = make()
    for name, text in objects.items():
        path = folder / f"{name}.md"
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
    for left in set((folder / "api").rglob("*.md")) - {folder / f"{name}.md" for name in objects}:
        left.unlink()
