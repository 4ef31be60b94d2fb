"""The drawing of all changes between two states: what changed stands first, and nothing leaves the drawing."""

import re

from fleet_rows import WEAK, flight_row

from mavdem.fleet.difference import vehicle_difference
from mavdem.report.charts.change_plan import change_plan, drawn_changes


def rows_of(numbers, **columns):
    return [flight_row("quad", number, **columns) for number in numbers]


def test_what_changed_stands_first_and_every_change_is_within_the_drawing():
    difference = vehicle_difference(rows_of(range(4)), rows_of(range(4, 8), **WEAK))
    svg = change_plan(difference).svg
    texts = re.findall(r'<div style="font-size: 12px[^>]*>([^<]*)<', svg)
    assert len(texts) == len(drawn_changes(difference)) < len(difference.changes)
    assert texts[0].startswith("Motor 3&#39;s relative trim +12")
    positions = [float(value) for value in re.findall(r'(?:x|x1|x2|cx)="([\d.]+)%"', svg)]
    assert min(positions) >= 0 and max(positions) <= 100
    assert svg.count("font-weight: 650") == 2
    # Each kind of quantity has a scale with round numbers.
    ticks = re.findall(r'<text class="small[^>]*>([^<]*)<', svg)
    assert ticks[:5] == ["−10 %", "−5 %", "0", "+5 %", "+10 %"]
    # Their texts, up to 36 of the 320 pixels on a phone, have room at both edges.
    places = [float(x) for x in re.findall(r'<text class="small" x="([\d.]+)%"', svg)]
    assert min(places) > 5.6 and max(places) < 94.4


def test_better_and_worse_have_other_colours_than_what_cannot_be_judged():
    """The margin of pitch rose and that of roll fell; the trim of motor 3 rose, and damping is neither good nor bad."""
    margins = {"phase_margin_interval": 0.05}
    before, after = [], []
    for axis, lower, higher in (("roll", 1.0, 0.3), ("pitch", 0.5, 1.0)):
        first = flight_row("quad", 1, axis, phase_margin=lower, **margins)
        second = flight_row("quad", 2, axis, phase_margin=higher, damping=5.0, **margins, **WEAK)
        before.append(first)
        after.append(second)
    svg = change_plan(vehicle_difference(before, after)).svg
    colours = {}
    for text, colour in re.findall(
        r'<div style="font-size: 12px[^>]*>([^<]*)<.*?stroke: var\(--(\w+)\)', svg, re.DOTALL
    ):
        colours[" ".join(text.replace("&#39;", "'").split()[:4])] = colour
    assert colours["Phase margin on roll"] == "bad" and colours["Phase margin on pitch"] == "good"
    assert colours["Rate damping on roll"] == "link"
    assert colours["Motor 3's relative trim"] == "bad"


def test_without_a_common_quantity_nothing_is_drawn():
    other_vehicle_rows = rows_of(
        range(2), motors=("motor 1",), trim_share=(1.0,), effect=(1.0,), damping=None
    )
    difference = vehicle_difference(rows_of(range(2)), other_vehicle_rows)
    assert difference.changes == ()
    assert change_plan(difference) is None
