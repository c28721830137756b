"""Every page that there is: an entry here, and a template, is all that a new kind of result needs."""

from __future__ import annotations

from pixelid.report import analyses, bench, conform, demo, fits, gap, health, scene, tables
from pixelid.report.page import Page

PAGES = (
    Page("demo.json", "demo.html", demo.summarise, demo.prepare, like="calibration"),  # before calibration.json
    Page("calibration.json", "calibration.html", bench.summarise, bench.prepare),
    Page(
        "conform.json", "conform.html", conform.summarise, conform.prepare, like="gap"
    ),  # before gap.json, which lies in the same folder
    Page("gap.json", "gap.html", gap.summarise, gap.prepare),
    Page("fit.json", "fit.html", fits.summarise_fit, fits.prepare_fit),
    Page("lowlight.json", "lowlight.html", analyses.summarise_lowlight, analyses.prepare_lowlight),
    Page("design.json", "design.html", analyses.summarise_design, analyses.prepare_design),
    Page("rates.json", "rates.html", tables.summarise_rates, tables.prepare_parameters),
    Page("latency.json", "latency.html", tables.summarise_latency, tables.prepare_parameters),
    Page("noise.json", "noise.html", tables.summarise_noise, tables.prepare_parameters),
    Page("biases.json", "biases.html", tables.summarise_biases, tables.prepare_biases),
    Page("flicker.json", "flicker.html", tables.summarise_flicker, tables.prepare_flicker),
    Page("reconstruction.json", "reconstruction.html", scene.summarise, scene.prepare),
    Page("dataset.json", "dataset.html", scene.summarise_dataset, scene.prepare_dataset),
    Page("render.json", "render.html", scene.summarise_render, scene.prepare_render),
    Page("inspect.json", "inspect.html", health.summarise_inspect, health.prepare_inspect),
    Page("static_noise.json", "static_noise.html", health.summarise_static_noise, health.prepare_static_noise),
    Page("compare.json", "compare.html", fits.summarise_compare, fits.prepare_compare),
    Page("sensor.json", "sensor.html", fits.summarise_sensor, fits.prepare_sensor),
)
