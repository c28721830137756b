"""Every page that there is: an entry here, and a template, is all that a new kind of result needs."""

from __future__ import annotations

from pixelid.report import analyses, conform, fits, gap, health, scene, tables
from pixelid.report.page import Page

def _conform(result: Result, folder: Path) -> Summary:
    counts = result["counts"]
    return Summary(
        "conform",
        f"The signal path of {result['sensor'] or 'these recordings'}",
        result["verdict"],
        result["sentence"],
        (
            Number("has", counted(counts["present"], "effect")),
            Number("lacks", counted(counts["absent"], "effect")),
            Number("not decidable", counted(counts["not_decidable"], "effect")),
            Number("not tested", counted(counts["not_tested"], "effect")),
            Number("time taken", seconds(result.get("seconds"))),
        ),
        command_line("conform", result, "--model", str(result["base"]), out=folder),
    )


def _conform_more(result: Result, folder: Path) -> dict[str, Any]:
    rows = [
        [
            row["stage"].replace("_", " "),
            row["effect"],
            row["verdict"].replace("_", " "),
            strengths_in_words(row),
            number(row["evidence"]["p_value"], 2),
            number(row["evidence"]["heldout_gain_nats"], 3),
            row["evidence"]["why"],
        ]
        for row in result["rows"]
    ]
    cells = [[c["response"], c["where"], number(c["score"], 3), str(c["events"])] for c in result["departs"]]
    left = [[c["response"], c["where"], number(c["score"], 3), str(c["events"])] for c in result["left"]]
    return {"rows": rows, "departs": cells, "left": left}


PAGES = (
    Page("conform.json", "conform.html", conform.summarise, conform.prepare),  # before gap.json, which lies beside it
    Page("gap.json", "gap.html", gap.summarise, gap.prepare),
    Page("fit.json", "fit.html", fits.summarise_fit, fits.prepare_fit),
    Page("lowlight.json", "lowlight.html", analyses.summarise_lowlight, analyses.prepare_lowlight),
    Page("design.json", "design.html", analyses.summarise_design, analyses.prepare_design),
    Page("rates.json", "rates.html", tables.summarise_rates),
    Page("flicker.json", "flicker.html", tables.summarise_flicker, tables.prepare_flicker),
    Page("reconstruction.json", "reconstruction.html", scene.summarise, scene.prepare),
    Page("inspect.json", "inspect.html", health.summarise_inspect, health.prepare_inspect),
    Page("static_noise.json", "static_noise.html", health.summarise_static_noise, health.prepare_static_noise),
    Page("compare.json", "compare.html", fits.summarise_compare, fits.prepare_compare),
    Page("sensor.json", "sensor.html", fits.summarise_sensor, fits.prepare_sensor),
)
