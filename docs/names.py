"""The table of names: every command, the Python function of the same name, and options with another name there."""

from __future__ import annotations

import inspect
from typing import Any

import click
from page_parts import table

WITHOUT = {
    "models": "`find_model`, and `pixelid.model.shipped`",
    "demo": "`calibrate`, on a bench of its own",
}
# Options of many commands, and how Python has them.
SHARED = {
    "out": "`result.report(folder)` or `.save(folder)`",
    "overwrite": "the same, `overwrite=True`",
    "quiet": "`progress=False`",
    "as_json": "`result.as_dict()`",
    "with_": "`model.with_effect(name, rate_hz=2)`",
    "without": "`model.without_effect(name)`",
    "set_": "`model.set(on_threshold=0.3)`",
    **dict.fromkeys(("roi", "time_s", "pixels", "without_hot_pixels"), "`crop(recording, …)`"),
    **dict.fromkeys(
        ("size", "time_unit", "columns", "stream", "chip", "polarity", "clock"), "`open(path, …)`"
    ),
}  # fmt: skip
OWN = {
    ("check", "init"): "the command alone", ("calibrate", "sample"): "`sample(result.fit, result.recordings)`",
    ("fit", "fix"): "`fixed`", ("fit", "bias_laws"): '`bias_priors="folder"`', ("fit", "sample"): "`sample(result, …)`",
    ("inspect", "files"): "`recording`", ("inspect", "as_json"): "`health.content()`",
    ("inspect", "out"): "`health.report(folder)`", ("inspect", "seed"): "`crop(recording, seed=1)`",
    ("simulate", "condition"): "`recording.condition`", ("biases", "model"): "`laws`", ("biases", "predict"): "`laws`",
    ("design", "recorded"): "`recordings`", ("design", "biases"): "`bandwidth`, `noise`, `rate`",
    ("stimulus", "rate"): "`rate_hz`", ("stimulus", "rest"): "`rest_s`",
    ("stimulus", "bits"): "`waveform.save(path, bits=24)`", ("stimulus", "set_"): "`parameters`",
    ("reconstruct", "checkpoint"): "`resume`", ("view", "open_"): "`open`",
}  # fmt: skip
# Of Python alone: what the command line keeps in files of its own, or decides by itself.
PYTHON_ONLY = {"progress", "resume", "preview", "starts", "leave_out", "recommend", "search", "options"}


def pairs() -> list[tuple[str, Any, list[click.Parameter]]]:
    """(command, function of that name or None, parameters of the command)."""
    import pixelid
    from pixelid.cli.main import COMMANDS, cli

    context = click.Context(cli)
    commands = {name: cli.get_command(context, name) for name in COMMANDS}
    public = {name: getattr(pixelid, name) for name in pixelid.__all__}
    return [(name, public.get(name), command.params) for name, command in commands.items() if command]


def apart() -> list[str]:
    """What one side has and the other has under no name of the tables above, and what these name in vain."""
    found, used = [], set()
    for name, function, options in pairs():
        if function is None:
            found += [] if name in WITHOUT else [f"pixelid {name}: no function pixelid.{name}"]
            continue
        known = inspect.signature(function).parameters
        idle = {p.name for p in options if "No effect" in (getattr(p, "help", "") or "")}
        for option in {p.name for p in options} - set(known) - idle:
            if (name, option) in OWN:
                used.add((name, option))
            elif option not in SHARED:
                found.append(f"pixelid {name} --{option}: no parameter of pixelid.{name}")
        named = {word.strip("`") for (command, _), way in OWN.items() if command == name for word in way.split(", ")}
        for parameter in set(known) - {p.name for p in options} - PYTHON_ONLY - named:
            if f"`{parameter}=" not in " ".join(way for (command, _), way in OWN.items() if command == name):
                found.append(f"pixelid.{name}({parameter}=…): no option of pixelid {name}")
    return found + [f"{key}: agrees under its own name" for key in set(OWN) - used]


def page() -> str:
    """The options that Python has elsewhere, and a row for every command."""
    flags = {}
    rows = []
    for name, function, options in pairs():
        own = []
        for option in options:
            flag = option.opts[0] if option.opts[0].startswith("-") else option.human_readable_name
            if option.name in SHARED and (name, option.name) not in OWN:
                flags.setdefault(option.name, flag)
            elif (name, option.name) in OWN and function is not None:
                own.append(f"`{flag}`: {OWN[name, str(option.name)]}")
        python = WITHOUT[name] if function is None else f"`{name}`"
        rows.append((f"`pixelid {name}`", python, "; ".join(own)))
    shared: dict[str, list[str]] = {}
    for option, way in SHARED.items():
        if option in flags:
            shared.setdefault(way, []).append(f"`{flags[option]}`")
    return "\n".join([
        table(("options of many commands", "Python"), ((", ".join(names), way) for way, names in shared.items())),
        table(("command", "function", "options with another name"), rows),
    ])  # fmt: skip
