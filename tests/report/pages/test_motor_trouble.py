"""The page of a flight says what the vehicle's other flights show, and its light of the motors is as bad as that."""

import re

from fleet_rows import flight_row
from pytest import mark

from mavdem.report.pages.motor_trouble import motor_trouble, trouble_html, with_motor_trouble

PAGE = """<main>
<h1>a.bin</h1>
<div data-light="motors"><dt><a href="#m">Motors</a></dt><dd class="watch">watch</dd><dd class="soft">Uneven.</dd></div>
<div data-light="power"><dt>Power</dt><dd class="good">good</dd><dd class="soft">12 V.</dd></div>
"""


def trouble(health, motor=None):
    return motor_trouble(
        flight_row("quad", 1, health=health, health_reason="It differs.", suspect_motor=motor)
    )


def marked(page, health, motor=None):
    found = trouble(health, motor)
    return with_motor_trouble(page, trouble_html(found), found)


def test_a_fault_beside_other_flights_is_the_light_and_the_next_step_of_the_page():
    page = marked(PAGE, "fault", 2)
    assert '<dd class="bad" data-alone="watch">bad</dd>' in page
    assert "by this log alone watch:</b> Uneven." in page
    assert "about this log alone, except where it names other flights." in page
    assert '<dd class="good">good</dd>' in page
    top = re.search("<main>\n(.*)\n<h1>", page)[1]
    assert "<strong>Next:</strong> Inspect motor 2 and its propeller before the next flight." in top


@mark.parametrize("health", ["ok", "unknown"])
def test_a_flight_that_is_judged_anew_and_is_sound_has_its_own_light_again(health):
    assert marked(marked(PAGE, "fault", 2), health) == PAGE


def test_a_drift_is_no_worse_than_what_the_log_shows():
    page = marked(PAGE, "drift")
    assert page.count("Compared with") == 1 and "data-alone" not in page and "Next:" not in page
    assert marked(page, "drift") == page
