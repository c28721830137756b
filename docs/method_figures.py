"""One figure for methods pages that have none among the committed pictures, drawn when the site is built."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from page_parts import ROOT

from pixelid.figures.style import MUTED, OFF, ON, new_axis, save_figure, styled

GENERATED = ROOT / "docs" / "_generated"
FA_PER_LUX = 7.7  # nominal, as for tables in lux


@styled
def draw_noise() -> Any:
    """Rates of noise events of one nominal pixel over light."""
    import pixelid as px
    from pixelid.tables.noise.first_passage import noise_rates

    model = px.find_model("dvs128").with_effect("shot_noise").set({"on_threshold": 0.17, "off_threshold": 0.19})
    lux = np.geomspace(0.1, 100.0, 40)
    rates = [noise_rates(model.circuit(), FA_PER_LUX * each) for each in lux]
    axis = new_axis(5.0, 2.8)
    axis.loglog(lux, [each.on_hz for each in rates], color=ON, label="ON")
    axis.loglog(lux, [each.off_hz for each in rates], color=OFF, label="OFF")
    axis.set(xlabel="light (lux)", ylabel="noise events per pixel\nand second")
    axis.legend()
    return axis


@styled
def draw_delay() -> Any:
    """Mean delay of a circuit over light, and that of the v2e pole which agrees at full light."""
    import pixelid as px
    from pixelid.export.lag import lag_of

    white, grey = 2000.0, np.geomspace(1.0, 255.0, 60)
    lag = lag_of(px.find_model("dvs128").circuit())
    late = np.array([lag.total(white * each / 255.0) for each in grey])
    axis = new_axis(5.0, 2.8)
    axis.loglog(grey, 1e3 * late, label="dvs128, all stages")
    axis.loglog(grey, 1e3 * late[-1] * 275.0 / (grey + 20.0), color=MUTED, linestyle="--", label="v2e's pole")
    axis.set(xlabel="grey level D (white: 2000 fA)", ylabel="mean delay (ms)")
    axis.legend()
    return axis


@styled
def draw_threshold() -> Any:
    """ON threshold of a DAVIS240C over the ratio of its currents, with the 95 % interval of the prior."""
    from pixelid.biases import currents_of, implied_by

    ratios, values, ends = [], [], []
    for fine in (24, 39, 64, 100, 160, 255):
        settings = {"OnBn": (2, 255), "DiffBn": (3, fine)}
        header = {
            f"AddressedIPotCF.{name}.BitValue{kind}": str(value)
            for name, both in settings.items()
            for kind, value in zip(("Coarse", "Fine"), both, strict=True)
        }
        currents = currents_of("DAVIS240C", header)
        threshold = implied_by(currents).values["on_threshold"]
        ratios.append(currents.roles["on"].ampere / currents.roles["differencing"].ampere)
        values.append(threshold.value)
        ends.append(threshold.interval_95)
    low, high = np.array(ends).T
    axis = new_axis(5.0, 2.8)
    axis.fill_between(ratios, low, high, color=ON, alpha=0.2, label="95 %")
    axis.plot(ratios, values, "o-", color=ON, label="ON threshold")
    axis.set(xlabel="current of OnBn over that of DiffBn", ylabel="threshold (ln L)")
    axis.legend()
    return axis


def design() -> str:
    """The ranking of `pixelid design dvs128`."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pixelid", "design", "dvs128", "--draws", "1", "--quiet"]
        subprocess.run([*command, "--out", f"{folder}/design"], check=True, env=environment)
        shutil.copy(Path(folder) / "design" / "ranking.svg", GENERATED / "method_design.svg")
    return _figure("design", "The default menu for `dvs128` without recordings, ranked by the expected information")


def _drawn(name: str, draw: Callable[[], Any], caption: str) -> str:
    save_figure(draw(), GENERATED / f"method_{name}.svg")
    return _figure(name, caption)


def _figure(name: str, caption: str) -> str:
    return f"![{caption}](../_generated/method_{name}.svg)\n\n{caption}.\n"


PAGES: dict[str, Callable[[], str]] = {
    "figure_noise": partial(
        _drawn,
        "noise",
        draw_noise,
        "Noise events of one `dvs128` pixel with shot noise over light, thresholds 0.17 and 0.19",
    ),
    "figure_export": partial(
        _drawn,
        "export",
        draw_delay,
        "Mean delay of `dvs128` over light, and of the pole of v2e that agrees with it at white",
    ),
    "figure_biases": partial(
        _drawn, "biases", draw_threshold, "The ON threshold that a DAVIS240C's biases imply, with its 95 % interval"
    ),
    "figure_design": design,
}
