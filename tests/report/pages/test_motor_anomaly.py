"""The page of a flight says what the vehicle's other flights show, and its light of the motors is as bad as that."""

import re

from fleet_rows import flight_row
from pytest import mark

from mavdem.fleet.difference import vehicle_difference
from mavdem.report.difference import headline_of_comparison, motor_table, next_blocks
from mavdem.report.pages.difference_page import comparison_page
from mavdem.report.pages.motor_anomaly import (
    motor_anomaly,
    review_with_anomaly,
    with_motor_anomaly,
)

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


def anomaly(health, motor=None, reason="It differs."):
    return motor_anomaly(
        flight_row("quad", 1, health=health, health_reason=reason, suspect_motor=motor)
    )


def marked(page, health, motor=None):
    return with_motor_anomaly(page, anomaly(health, motor))


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
    with_anomaly = marked(page, earlier_health, 2)
    assert with_anomaly != page
    assert marked(with_anomaly, health) == page


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


@mark.parametrize("health, level", [("fault", "bad"), ("drift", "watch")])
def test_a_comparison_shows_the_motors_as_they_are_beside_other_flights(health, level):
    motors = {"level": "good", "sentence": "No motor lost over 32 %."}
    review = {
        "lights": {"motors": motors},
        "headline": {"level": "good", "sentence": "Nothing wrong found."},
        "next_step": {"sentence": "Fly anew."},
    }
    weak = anomaly(health, 1, "Motor 1 (front right) lost about 22 % of its thrust.")
    reviews = {"A": review, "B": review_with_anomaly(review, weak)}
    assert review["lights"]["motors"] is motors and review_with_anomaly(review, None) is review
    flights = [[flight_row("quad", number)] for number in (1, 2)]
    difference = vehicle_difference(*flights)
    first, second, *_ = headline_of_comparison(reviews, difference)
    assert first.lead == "Motors:"
    assert first.text == f"good in A, {level} in B. {weak.reason}"
    assert second.lead.startswith("No other")
    (table,) = motor_table(reviews, difference)
    assert [row[:2] for row in table.rows][0] == ["motor 1", "no warning"]
    assert "lost about 22 %" in table.rows[0][2]
    page = comparison_page(("a", "b"), (review, review), difference, anomalies={"B": weak})
    assert f"Motors: good in A, {level} in B. Motor 1 (front right) lost about" in page
    assert "<strong>B by itself:</strong>" not in page
    if health == "fault":
        (step,) = next_blocks(difference, reviews)
        assert step.text == "Inspect motor 1 and its propeller before the next flight."


def test_a_log_that_shows_worse_is_compared_as_it_is():
    review = {"lights": {"motors": {"level": "bad", "sentence": "Motor 2 stopped."}}}
    assert review_with_anomaly(review, anomaly("drift", 1)) is review
    assert review_with_anomaly(review, anomaly("fault", 1)) is review
