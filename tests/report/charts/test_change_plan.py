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
    # Both ends of the shaded band have their figures: quantities have different units.
    ends = re.findall(r'<text class="small[^>]*>([−+][^<]*)<', svg)
    assert ends[:2] == ["−6.0 %", "+6.0 %"] and len(ends) == 2 * len(texts)


def test_without_a_common_quantity_nothing_is_drawn():
    other_vehicle_rows = rows_of(
        range(2), motors=("motor 1",), trim_share=(1.0,), effect=(1.0,), damping=None
    )
    difference = vehicle_difference(rows_of(range(2)), other_vehicle_rows)
    assert difference.changes == ()
    assert change_plan(difference) is None
