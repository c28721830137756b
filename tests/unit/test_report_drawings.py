"""The pixel's drawing and the forest of intervals, from plain numbers."""

import re

import pytest

from pixelid.report.forest import forest
from pixelid.report.pixel_drawing import draw_pixel
from pixelid.report.quantities import quantities, quantity


def entry(value, low=None, high=None, unit="1/s", identified=True, fixed=False):
    return {"value": value, "interval_95": [low, high], "unit": unit, "identified": identified, "fixed": fixed}


PARAMETERS = {
    "beta": entry(2000.0, 1900.0, 2100.0),
    "leak.rate_hz": entry(2.0, 1.8, 2.3, "Hz"),
    "polarity_memory.strength": entry(-0.05, -0.06, -0.04, "1"),
    "described.rate.time_in_recording.linear.strength": entry(0.01, 0.008, 0.012, "1/s"),
    "diff_cutoff_hz": entry(4e4, 2e4, None, "Hz", identified=False),
    "alignment.clock_rate": entry(1e-5, 0.0, 2e-5, "1"),
    "light_gain[chirp]": entry(1.0, 0.9, 1.1, "1"),
}


def test_only_the_pixels_parameters_are_drawn_each_at_its_stage():
    stages = {q.parameter: q.stage for q in quantities(PARAMETERS)}
    assert stages == {
        "beta": "photoreceptor",
        "leak.rate_hz": "differencing",
        "polarity_memory.strength": "comparator",
        "described.rate.time_in_recording.linear.strength": "photoreceptor",
        "diff_cutoff_hz": "differencing",
    }


@pytest.mark.parametrize(
    ("parameter", "given", "shown"),
    [
        ("leak.rate_hz", entry(2.0, 1.8, 2.3, "Hz"), ("2", "events/s")),
        ("diff_cutoff_hz", entry(16000.0, 15000.0, 17000.0, "Hz"), ("16", "kHz")),
        ("sf_cutoff_hz", entry(3122.0, 3000.0, 3250.0, "Hz"), ("3120", "Hz")),
        ("refractory_s", entry(1.62e-4, 1.6e-4, 1.64e-4, "s"), ("162", "µs")),
        ("threshold_sigma", entry(0.04, 0.039, 0.041, "1"), ("4", "%")),
        ("alpha", entry(None, unit="1/s²/fA", identified=False), ("–", "1/s²/fA")),
    ],
)
def test_values_stand_in_the_fields_units(parameter, given, shown):
    q = quantity(parameter, given)
    assert (q.value, q.unit) == shown


def test_no_two_texts_of_the_drawing_overlap():
    for narrow in (False, True):
        drawing = str(draw_pixel(quantities(PARAMETERS), ["leak"], narrow))
        places = re.findall(r'<text class="[^"]*" x="([\d.]+)" y="([\d.]+)"', drawing)
        assert len(places) == len(set(places)) > 12
        width, height = map(float, re.search(r'viewBox="0 0 (\d+) (\d+)"', drawing).groups())
        assert all(0 < float(x) < width and 0 < float(y) < height for x, y in places)
        assert drawing.count('class="parameter added"') == 1
        assert drawing.count('class="parameter open"') == 1


def test_a_forest_has_places_in_per_cent_and_arrows_where_intervals_go_on():
    drawn = forest(PARAMETERS, {"beta": 1000.0, "diff_cutoff_hz": 16000.0}, {"beta": 2000.0}, ["leak"])
    rows = {row.quantity.parameter: (row, str(track)) for row, track in drawn.rows}
    assert "polarity_memory.strength" not in rows  # has no logarithm
    assert "alignment.clock_rate" not in rows
    assert rows["beta"][0].at == 2.0
    assert rows["beta"][0].truth == 2.0
    assert rows["leak.rate_hz"][0].at == 1.0
    assert rows["leak.rate_hz"][0].added
    assert rows["diff_cutoff_hz"][1].count('class="end"') == 1
    assert rows["beta"][1].count('class="end"') == 0
    for _, track in rows.values():
        assert all(0 <= float(x) <= 100 for x in re.findall(r'x[12]?="([-\d.]+)%"', track))
    ticks = re.findall(r"×([\d.]+)<", str(drawn.axis))
    assert "1" in ticks
    assert 2 <= len(ticks) <= 7


@pytest.mark.parametrize("ratio", [1e-6, 0.03, 0.5, 1.0, 1.02, 4.0, 90.0, 1e9])
def test_the_axis_holds_for_every_ratio(ratio):
    drawn = forest({"beta": entry(1000.0 * ratio, 990.0 * ratio, 1010.0 * ratio)}, {"beta": 1000.0}, {})
    assert 1 <= str(drawn.axis).count("×") <= 7
    assert len(drawn.rows) == 1
