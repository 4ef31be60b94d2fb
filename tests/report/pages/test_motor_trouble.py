"""The page of a flight says what the vehicle's other flights show, and its light of the motors is as bad as that."""

import re

from fleet_rows import flight_row
from pytest import mark

from mavdem.report.pages.motor_trouble import motor_trouble, with_motor_trouble

PAGE = """<main>
<h1>a.bin</h1>
<div class="layout">
<section id="result" class="blocks assessment">
<p class="headline"><strong>Nothing wrong found.</strong></p>
<p><strong>Next:</strong> Fly anew.</p>
<div data-light="motors"><dt><a href="#m">Motors</a></dt><dd class="watch">watch</dd><dd class="soft">Uneven.</dd></div>
<div data-light="power"><dt>Power</dt><dd class="good">good</dd><dd class="soft">12 V.</dd></div>
</section>
</div>
"""
CRASHED_PAGE = PAGE.replace("blocks assessment", "blocks assessment doubted")


def trouble(health, motor=None):
    return motor_trouble(
        flight_row("quad", 1, health=health, health_reason="It differs.", suspect_motor=motor)
    )


def marked(page, health, motor=None):
    return with_motor_trouble(page, trouble(health, motor))


def test_a_fault_beside_other_flights_is_the_headline_and_the_next_step_of_the_page():
    page = marked(PAGE, "fault", 2)
    assert '<dd class="bad" data-alone="watch">bad</dd>' in page
    assert "by this log alone watch:</b> Uneven." in page
    assert "about this log alone, except where it names other flights." in page
    assert '<dd class="good">good</dd>' in page
    (headline,) = re.findall('<p class="headline"><strong>(.*?)</strong>', page)
    (next_step,) = re.findall("<strong>Next:</strong> (.*?)</p>", page)
    assert headline == "It differs."
    assert next_step == "Inspect motor 2 and its propeller before the next flight."
    sections = re.findall('<section id="(.*?)" class="(.*?)"', page)
    assert sections == [("beside", "blocks assessment doubted"), ("result", "blocks assessment")]
    assert "<strong>This log alone:</strong> Nothing wrong found." in page
    assert "<strong>Then, by this log alone:</strong> Fly anew." in page


@mark.parametrize("health", ["ok", "unknown"])
@mark.parametrize("page", [PAGE, CRASHED_PAGE])
@mark.parametrize("earlier_health", ["fault", "drift"])
def test_a_flight_that_is_judged_anew_and_is_sound_has_its_own_result_again(
    page, earlier_health, health
):
    with_trouble = marked(page, earlier_health, 2)
    assert with_trouble != page
    assert marked(with_trouble, health) == page


def test_a_drift_without_a_motor_leaves_the_next_step_to_the_log():
    page = marked(PAGE, "drift")
    assert "data-alone" not in page
    assert page.count('class="headline"') == 1 and "<strong>It differs.</strong>" in page
    assert page.count("<strong>Next:</strong> Fly anew.") == 1
    assert marked(page, "drift") == page


def test_a_drift_stands_below_the_headline_of_a_log_that_shows_worse():
    page = marked(CRASHED_PAGE, "drift", 2)
    assert page.index('id="result"') < page.index('id="beside"')
    assert '<p class="headline"><strong>Nothing wrong found.</strong></p>' in page
    assert page.count("Next:") == 1 and "other flights:</strong> It differs." in page
    assert marked(page, "drift", 2) == page
    assert marked(page, "fault", 2) == marked(CRASHED_PAGE, "fault", 2)
