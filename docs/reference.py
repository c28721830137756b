"""The API reference: signatures and docstrings of the public names, without importing the site's generator.

Docstrings are in Google style.  One that reStructuredText cannot read without a warning is shown as it stands.
"""

from __future__ import annotations

import importlib
import inspect
import io
import re

from docutils.core import publish_doctree
from page_parts import table
from sphinx.ext.napoleon import GoogleDocstring

TASKS = {
    "At the bench": ("check", "calibrate", "stimulus", "design"),
    "Recordings": ("open", "inspect", "convert", "align", "crop", "Recording", "Stimulus"),
    "A circuit": ("find_model", "Model", "simulate", "lowlight", "export", "view"),
    "Fit and search": ("fit", "sample", "compare", "gap", "conform", "sensor", "Status"),
    "Tables and lamps": ("rates", "latency", "flicker", "noise", "biases"),
    "Scenes": ("dataset", "reconstruct", "load_field", "render"),
    "Any result": ("report",),
}
NAMES = tuple(name for names in TASKS.values() for name in names)
RESULTS = (
    "pixelid.results.Result",
    "pixelid.bench.check.CheckReport",
    "pixelid.bench.result.Calibration",
    "pixelid.fit.result.FitResult",
    "pixelid.sample.posterior.Posterior",
    "pixelid.gap.result.GapReport",
    "pixelid.lowlight.result.LowlightReport",
    "pixelid.design.result.DesignReport",
    "pixelid.design.waveform.Waveform",
    "pixelid.tables.biases.result.BiasLaws",
    "pixelid.tables.result.TableResult",
    "pixelid.compare.compare.Comparison",
    "pixelid.sensors.sensor.SensorFit",
    "pixelid.nerf.reconstruct.Reconstruction",
    "pixelid.nerf.shown.saved.SavedReconstruction",
    "pixelid.errors.InputError",
)
WIDTH = 110


def page() -> str:
    """The index by task, with links to a page of each object."""
    tasks = {**TASKS, "What they return": tuple(path.rpartition(".")[2] for path in RESULTS)}
    rows = [
        (task, ", ".join(f"[{name}](_generated/api/{_file(name)}.md)" for name in names))
        for task, names in tasks.items()
    ]
    every = "\n".join(f"_generated/api/{_file(name)}" for names in tasks.values() for name in names)
    return f"{table(('task', 'objects'), rows)}\n```{{toctree}}\n:hidden:\n\n{every}\n```\n"


def pages() -> dict[str, str]:
    """By file, the page of each object: Markdown with embedded reStructuredText."""
    made = {}
    for path in (*(f"pixelid.{name}" for name in NAMES), *RESULTS):
        name = path.rpartition(".")[2]
        made[_file(name)] = f"# {name}\n\n```{{eval-rst}}\n{_entry(path, _at(path))}\n```\n"
    return made


def _file(name: str) -> str:
    """Types in a folder of their own: not every disk knows `stimulus` from `Stimulus`."""
    return f"types/{name}" if name[0].isupper() else name


def _at(path: str) -> object:
    module, _, name = path.rpartition(".")
    return getattr(importlib.import_module(module), name)


def _entry(path: str, thing: object) -> str:
    """A function or a class, with the public methods and properties of the latter."""
    if not inspect.isclass(thing):
        return _block("function", path, _signature(thing), inspect.getdoc(thing))
    enumeration = hasattr(thing, "__members__")  # its constructor takes a value, which is of no use to a reader
    lines = [_block("class", path, "" if enumeration else _signature(thing), inspect.getdoc(thing))]
    for name, member in vars(thing).items():
        member = member.__func__ if isinstance(member, (classmethod, staticmethod)) else member
        if name.startswith("_") or not inspect.getdoc(member):
            continue
        if isinstance(member, property):
            lines.append(_indented(_block("property", name, "", inspect.getdoc(member))))
        elif inspect.isfunction(member):
            lines.append(_indented(_block("method", name, _signature(member, bound=True), inspect.getdoc(member))))
    if enumeration:
        lines.append("   Members: " + ", ".join(f"``{name}``" for name in thing.__members__) + ".\n")
    return "\n\n".join(lines)


def _signature(thing, bound: bool = False) -> str:
    """The signature without annotations: their types are in the docstring."""
    try:
        signature = inspect.signature(thing)
    except (TypeError, ValueError):
        return "()"
    parameters = [p.replace(annotation=p.empty) for p in signature.parameters.values()]
    if bound and parameters and parameters[0].name in ("self", "cls"):
        parameters = parameters[1:]
    parameters = [p.replace(default="…") if len(repr(p.default)) > 40 else p for p in parameters]
    shown = signature.replace(parameters=parameters, return_annotation=inspect.Signature.empty)
    return str(shown).replace("'…'", "...")


def _block(kind: str, name: str, signature: str, docstring: str | None) -> str:
    return f".. py:{kind}:: {name}{signature}\n   :no-index-entry:\n\n" + _indented(_body(docstring or "")) + "\n"


def _body(docstring: str) -> str:
    """A docstring as reStructuredText."""
    parts = re.split(r"(`+[^`\n]+`+)", docstring)
    text = "".join(
        f"``{part.strip('`')}``" if k % 2 else part.replace("|", r"\|").replace("*", r"\*").replace("_ ", r"\_ ")
        for k, part in enumerate(parts)
    )
    lines = "\n".join(GoogleDocstring(text).lines())
    messages = io.StringIO()
    publish_doctree(lines, settings_overrides={"warning_stream": messages, "report_level": 2})
    if messages.getvalue():
        return ".. code-block:: text\n\n" + _indented(docstring)
    return lines


def _indented(text: str) -> str:
    return "\n".join(f"   {line}" if line else "" for line in text.splitlines())
