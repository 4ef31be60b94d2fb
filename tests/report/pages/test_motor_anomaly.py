"""The page of a flight says what the vehicle's other flights show, and its light of the motors is as bad as that."""

import json
import re
from dataclasses import replace
from math import log1p

from fleet_rows import flight_row
from pytest import mark

from mavdem.facts import Fact
from mavdem.facts.fleet import QuantityOutcome
from mavdem.facts.motors import MotorsBetween
from mavdem.fleet.difference import vehicle_difference
from mavdem.fleet.quantities import SHARE
from mavdem.report.blocks import plain_text
from mavdem.report.difference.baseline import baseline_blocks
from mavdem.report.difference.changes import (
    change_sentences,
    difference_blocks,
    sentences_without_change,
    undetected_change_table,
)
from mavdem.report.difference.flight_cautions import flight_cautions
from mavdem.report.difference.headline import headline_of_comparison
from mavdem.report.difference.lights import light_blocks, light_heading
from mavdem.report.difference.motors import motor_table
from mavdem.report.difference.next_step import next_step_sentences
from mavdem.report.difference.reviewed import (
    ComparedState,
    compared_states,
    reviewed_difference,
)
from mavdem.report.difference.sides import side_descriptions
from mavdem.report.fleet import vehicle_texts
from mavdem.report.pages.difference_page import comparison_page
from mavdem.report.pages.motor_anomaly import (
    motor_anomaly,
    review_with_anomaly,
    review_with_compared_motors,
    with_motor_anomaly,
)

PAGE = """<main>
<h1>a.bin</h1>
<div class="layout">
<section id="result" class="blocks assessment">
<p class="headline"><strong>Nothing wrong found.</strong></p>
<p><strong>Next:</strong> Fly anew.</p>
<div data-light="motors"
tabindex="0"><dt><a href="#m">Motors</a></dt><dd class="watch">watch</dd><dd class="soft">Uneven.</dd></div>
<div data-light="power"><dt>Power</dt><dd class="good">good</dd><dd class="soft">12 V.</dd></div>
</section>
</div>
"""
CRASHED_PAGE = PAGE.replace("blocks assessment", "blocks assessment doubted")


def anomaly(health, motor=None, reason="It differs.", **columns):
    columns |= {"health": health, "health_reason": reason, "suspect_motor": motor}
    return motor_anomaly(flight_row("quad", 1, **columns))


def page_with_anomaly(page, health, motor=None):
    return with_motor_anomaly(page, anomaly(health, motor))


def test_a_fault_beside_other_flights_is_the_headline_and_the_next_step_of_the_page():
    page = page_with_anomaly(PAGE, "fault", 2)
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


@mark.parametrize("figures", [None, "{damaged", "[1]", "[" * 100_000])
def test_an_anomaly_without_figures_or_with_damaged_ones_has_none(figures):
    assert anomaly("fault", 1, health_figures=figures).figures == {}


def test_the_light_of_the_motors_with_a_figure_is_as_bad_as_the_anomaly_too():
    """The page of a flight has a figure for phones, which the anomaly hides: it is by the log alone."""
    page = PAGE.replace('">watch</dd>', '">watch</dd><dd class="brief">headroom 20 %</dd>')
    with_fault = page_with_anomaly(page, "fault", 2)
    assert '<dd class="bad" data-alone="watch">bad</dd><dd class="brief" hidden>' in with_fault
    assert page_with_anomaly(with_fault, "ok") == page


def test_good_motors_are_unknown_until_they_are_compared_with_other_flights():
    """What the log alone warns of stands also before the comparison."""
    page = PAGE.replace('"watch">watch', '"good">good')
    pending = with_motor_anomaly(page, None, is_compared=False)
    assert '<dd class="unknown" data-alone="good">unknown</dd>' in pending
    assert "<b>Not compared with other flights yet, by this log alone good:</b> Uneven." in pending
    assert with_motor_anomaly(pending, None) == page
    assert with_motor_anomaly(PAGE, None, is_compared=False) == PAGE


@mark.parametrize("health", ["ok", "unknown"])
@mark.parametrize("page", [PAGE, CRASHED_PAGE])
@mark.parametrize("earlier_health", ["fault", "drift"])
def test_a_flight_that_is_judged_anew_and_is_sound_has_its_own_result_again(
    page, earlier_health, health
):
    with_anomaly = page_with_anomaly(page, earlier_health, 2)
    assert with_anomaly != page
    assert page_with_anomaly(with_anomaly, health) == page


def test_a_drift_without_a_motor_has_the_step_of_its_vehicle_and_of_its_comparison():
    page = page_with_anomaly(PAGE, "drift")
    assert "data-alone" not in page
    assert page.count('class="headline"') == 1 and "<strong>It differs.</strong>" in page
    step = "Unless they were replaced, check motors and propellers, then the load."
    assert f"<strong>Next:</strong> {step}" in page
    assert page.count("<strong>Then, by this log alone:</strong> Fly anew.") == 1
    assert page_with_anomaly(page, "drift") == page
    # Figures stand below the headline and the next step.
    page = with_motor_anomaly(PAGE, anomaly("drift", reason="It differs. Roll by 4.8 %."))
    assert "<strong>It differs.</strong>" in page
    assert page.index("Next:") < page.index('<p class="soft">Roll by 4.8 %. By comparison')
    # The motor that the log alone warns of comes first, and its step is not repeated.
    row = flight_row("quad", 1, health="drift", health_reason="It differs.", watched_motor=1)
    row = replace(row, health_code=MotorsBetween.BALANCE_CHANGED)
    step = "Compare the propeller of motor 1 with the others, and check the place of the load."
    page_of_log = PAGE.replace("Fly anew.", step)
    page = with_motor_anomaly(page_of_log, motor_anomaly(row))
    assert page.count(f"<p><strong>Next:</strong> {step}") == 1 and "<p hidden>" in page
    assert with_motor_anomaly(page, None) == page_of_log
    assert vehicle_texts([[row]]).next_step == step
    reviews = {"A": GOOD_REVIEW, "B": review_with_compared_motors(GOOD_REVIEW, [row])}
    reviewed = reviewed_difference(doubtful_trim(1, 0.16), reviews)
    assert texts(next_step_sentences(reviewed)) == [f"Next: {step}"]
    # The table of motors has what the log shows of the motor.
    sentence = "Motor 1 (front right) works 8 % harder."
    light = {"level": "watch", "subject": "motor 1 (front right)", "sentence": sentence}
    watched_review = GOOD_REVIEW | {"lights": {"motors": light}}
    reviews["B"] = review_with_compared_motors(watched_review, [row])
    (table,) = motor_table(reviews, reviewed.difference)
    assert table.rows[0][2] == "works 8 % harder"


@mark.parametrize("health", ["drift", "fault"])
def test_an_anomaly_stands_below_the_headline_of_a_log_that_shows_something_bad(health):
    page = page_with_anomaly(CRASHED_PAGE, health, 2)
    assert page.index('id="result"') < page.index('id="beside"')
    assert '<p class="headline"><strong>Nothing wrong found.</strong></p>' in page
    assert page.count("Next:") == 1 and "other flights:</strong> It differs." in page
    assert page_with_anomaly(page, health, 2) == page
    assert page_with_anomaly(page, "fault", 3) == page_with_anomaly(CRASHED_PAGE, "fault", 3)


@mark.parametrize("health, level", [("fault", "bad"), ("drift", "watch")])
def test_a_comparison_shows_the_motors_as_they_are_beside_other_flights(health, level):
    """Flight B by itself has good motors, but beside other flights of the vehicle motor 1 is weak.

    Headline, table and next step have that judgement.
    """
    motors = {"level": "good", "sentence": "No motor lost over 32 %."}
    review = {
        "lights": {"motors": motors},
        "headline": {"level": "good", "sentence": "Nothing wrong found."},
        "next_step": {"sentence": "Fly anew."},
    }
    figures = {"loss": (0.22, 0.1, 0.3), "rise": (0.13, 0.06, 0.2), "probability": 0.9}
    columns = {"health_code": MotorsBetween.MOTOR_WEAK, "health_figures": json.dumps(figures)}
    reason = "Motor 1 (front right) lost about 22 % of its thrust."
    weak = anomaly(health, 1, reason, **columns)
    reviews = {"A": review, "B": review_with_anomaly(review, weak)}
    assert review["lights"]["motors"] is motors and review_with_anomaly(review, None) is review
    flights = [[flight_row("quad", number)] for number in (1, 2)]
    difference = vehicle_difference(*flights)
    first, second, *_ = headline_of_comparison(reviewed_difference(difference, reviews))
    assert first.lead == "Motors:"
    assert first.text == f"good in A, {level} in B. {weak.reason}"
    assert second.lead.startswith("No other")
    # The motor that the headline names is no other figure, nor one without a change.
    trims = [change for change in difference.changes if change.quantity.kind == SHARE]
    uncertain = [trim._replace(outcome=QuantityOutcome.UNCERTAIN) for trim in trims]
    reviewed = reviewed_difference(difference._replace(changes=tuple(uncertain)), reviews)
    _, result = texts(headline_of_comparison(reviewed))
    assert "All 3 other figures compared (trims) are too uncertain" in result
    reviewed = reviewed_difference(difference, reviews)
    (bounds,) = undetected_change_table(reviewed)
    assert bounds.rows[0][0] == "relative trim of motors 2, 3 and 4"
    assert "motor 1" not in plain_text(sentences_without_change(reviewed))
    (table,) = motor_table(reviews, difference)
    assert table.rows[0][:2] == ["motor 1 (front right)", "no warning"]
    assert table.rows[0][2] == "lost about 22 %"
    light = reviews["B"]["lights"]["motors"]
    assert light["figures"]["loss"] == [0.22, 0.1, 0.3] and light["units"]["loss"] == "1"
    reviewed = reviewed_difference(difference, reviews)._replace(motors_by_pair="Nothing.")
    page = comparison_page(("a", "b"), reviewed).replace("\N{NO-BREAK SPACE}", " ")
    assert "<strong>By these two alone:</strong> Nothing.</p>" in page
    assert "<strong>In B: motor 1 (front right) lost about 22 % of its thrust.</strong>" in page
    assert f"<strong>Motors:</strong> good in A, {level} in B.</p>" in page
    assert "<strong>B by itself:</strong>" not in page
    if health == "fault":
        (step,) = next_step_sentences(reviewed_difference(difference, reviews))
        assert step.text == "Inspect motor 1 and its propeller before the next flight."


GOOD_REVIEW = {
    "lights": {"motors": {"level": "good", "sentence": "No motor lost over 32 %."}},
    "headline": {"level": "good", "sentence": "Nothing wrong found."},
}


def doubtful_trim(motor, change):
    """Returns the comparison of two flights in which the trim of a motor changed, but too uncertainly to count."""
    difference = vehicle_difference(*([flight_row("quad", number)] for number in (1, 2)))
    (trim,) = [
        quantity_change
        for quantity_change in difference.changes
        if quantity_change.quantity.kind == SHARE and quantity_change.quantity.motor == motor
    ]
    doubtful = trim._replace(
        tested_difference=log1p(change),
        tested_half_width=0.06 / (1 + change),
        p=0.047,
        outcome=QuantityOutcome.UNCERTAIN,
    )
    rest = [
        quantity_change for quantity_change in difference.changes if quantity_change is not trim
    ]
    return difference._replace(changes=(doubtful, *rest))


def judged_reviews(**health):
    """Returns the reviews of a good flight and of one that is judged beside it."""
    reason = "Motor 1 (front right) lost about 21 % of its thrust with probability 0.60."
    rows = [flight_row("quad", 2, **{"health_reason": reason, **health})]
    return {"A": GOOD_REVIEW, "B": review_with_compared_motors(GOOD_REVIEW, rows)}


def texts(sentences):
    return [f"{sentence.lead} {sentence.text}".strip() for sentence in sentences]


@mark.slow
def test_a_doubtful_figure_of_the_motor_that_is_weak_is_evidence_and_no_second_verdict():
    """Motor 1 is weak beside other flights, and its trim changed doubtfully.

    The trim is named as agreement, once, and only if it has the same direction.
    """
    difference = doubtful_trim(1, 0.08)
    reviews = judged_reviews(health="drift", suspect_motor=1, fault_probability=0.6)
    headline = headline_of_comparison(reviewed_difference(difference, reviews))
    motors, rest, *_ = texts(headline)
    assert motors.startswith("Motors: good in A, watch in B. Motor 1 (front right) lost about 21 %")
    assert motors.endswith("This agrees with motor 1's relative trim +8 % (+2 to +14 %).")
    assert rest.startswith("No other compared figure changed significantly.")
    everything = " ".join(
        texts([*headline, *difference_blocks(reviewed_difference(difference, reviews), headline)])
    )
    assert "Perhaps" not in everything and "Doubtful" not in everything
    (step,) = texts(next_step_sentences(reviewed_difference(difference, reviews)))
    assert step.startswith(
        "Next: Inspect motor 1 and its propeller before the next flight. If both"
    )
    page = comparison_page(("a", "b"), reviewed_difference(difference, reviews))
    assert page.count('<path style="fill: var(--watch)" d="M0 -7') == 1
    # A trim that surely rose is the verdict where the balance leaves open whether the motor is weak.
    trim, *rest_of_changes = difference.changes
    sure_trim = trim._replace(outcome=QuantityOutcome.CHANGED)
    surely = reviewed_difference(
        difference._replace(changes=(sure_trim, *rest_of_changes)),
        judged_reviews(health="drift", suspect_motor=1, fault_probability=0.3),
    )
    motors, *_ = texts(headline_of_comparison(surely))
    assert "Motor 1 (front right) works 8 % (2 to 14 %) harder than in A. Perhaps" in motors
    assert "agrees" not in motors and motors.count("probability") == 1
    # A doubtful trim of another motor is part of the verdict of all trims, and no second one.
    *_, rest = texts(headline_of_comparison(reviewed_difference(doubtful_trim(2, -0.08), reviews)))
    assert rest.startswith("No other change is certain. ") and "Perhaps" not in rest
    # A motor that became stronger is no evidence that it is weak.
    stronger = " ".join(
        texts(headline_of_comparison(reviewed_difference(doubtful_trim(1, -0.08), reviews)))
    )
    assert "agrees" not in stronger
    # Nor is a motor that both flights warn of: the change then shows only which of them is worse.
    both = dict.fromkeys("AB", reviews["B"])
    lights = {"motors": reviews["B"]["lights"]["motors"] | {"level": "bad"}}
    both["A"] = {**reviews["B"], "lights": lights}
    assert "agrees" not in " ".join(
        texts(headline_of_comparison(reviewed_difference(doubtful_trim(1, -0.08), both)))
    )
    # Means over good flights and others agree with neither.
    mixed = {"motors": reviews["A"]["lights"]["motors"] | {"levels": ["watch", "good"]}}
    reviews["A"] = {**reviews["A"], "lights": mixed}
    # The heading says how many flights it is about.
    light = {
        "level": "bad",
        "sentence": "Motor 1 is weak.",
        "levels": ["unknown", "unknown", "bad"],
    }
    lights = {"A": light, "B": {"level": "bad", "sentence": "Motor 2 is weak."}}
    assert light_heading(lights) == "In 1 of 3 logs of A: motor 1 is weak. In B: motor 2 is weak."
    # Flights with the same clause share it, though the figures after it differ.
    lights["B"]["sentence"] = "Motor 1 is weak: 12 %."
    (clause_of_both,) = light_heading(lights).split(". ")
    assert clause_of_both == "In 1 of 3 logs of A and B: motor 1 is weak."
    light["levels"] = ["bad", "unknown", "bad"]
    assert light_heading({"A": light}) == "In the last of 3 logs of A: motor 1 is weak."
    light["levels"] = ["bad", "bad", "bad"]
    assert light_heading({"A": light}) == "In the last of 3 logs of A (all bad): motor 1 is weak."
    assert "agrees" not in " ".join(
        texts(headline_of_comparison(reviewed_difference(difference, reviews)))
    )


def test_flights_of_a_fleet_which_has_no_reviews_have_one_verdict_too():
    """The rows of a fleet alone are compared, without lights, and the judgement of the motors still comes first."""
    sound = flight_row("quad", 1, health_reason="No change.", fault_probability=0.01)
    weak = flight_row(
        "quad",
        2,
        health="drift",
        health_reason="Motor 1 lost thrust.",
        suspect_motor=1,
        fault_probability=0.6,
    )
    rows = {"A": sound, "B": weak}
    reviews = {side: review_with_compared_motors({}, [row]) for side, row in rows.items()}
    motors, rest = texts(
        headline_of_comparison(reviewed_difference(doubtful_trim(1, 0.08), reviews))
    )
    assert motors == (
        "Motors: good in A, watch in B. Motor 1 lost thrust. "
        "This agrees with motor 1's relative trim +8 % (+2 to +14 %)."
    )
    assert rest.startswith("No other compared figure changed significantly.")
    assert reviews["B"]["headline"]["sentence"] == "Motor 1 lost thrust."


@mark.slow
def test_a_fleet_says_in_how_many_flights_its_motors_are_bad_and_that_its_means_are_mixed():
    """Motor 1 is weak in the last two of four flights of A; B was flown before and is sound."""
    columns = {"health_reason": "Motor 1 lost thrust.", "suspect_motor": 1, "health": "fault"}
    columns |= {"light_vibration": "watch", "light_log": "good"}
    rows = [flight_row("quad", number, health_reason="No change.") for number in (1, 2)]
    rows += [flight_row("quad", number, **columns) for number in (3, 4)]
    sound = [flight_row("quad", 0, health_reason="No change.")]
    states = [ComparedState(side_rows, {}, {}) for side_rows in (rows, sound)]
    reviewed = compared_states(*states)
    motors, *_ = texts(headline_of_comparison(reviewed))
    assert motors.startswith("Motors: bad in 2 of 4 logs of A, the last one too; good in B.")
    (mixed,) = texts(flight_cautions(reviewed))
    assert "A is of several states: its motors are bad in 2 of 4 logs, good in 2." in mixed
    assert mixed.endswith("Choose flights of one state with `--days-a`.")
    # Flights of one day are named, and those that could not be judged may be of either state.
    unjudged = [replace(row, health="unknown", date=rows[3].date) for row in rows[:2]]
    one_day = compared_states(ComparedState([*unjudged, *rows[2:]], {}, {}), states[1])
    (mixed,) = texts(flight_cautions(one_day))
    assert "A may be of several states: its motors are bad in 2 of 4 logs, not judged" in mixed
    assert "--days" not in mixed and "Not good of A: 0003.ulg and 0004.ulg." in mixed, mixed
    # Flights that others are compared with are named so, in sentences, charts and tables.
    references = [replace(row, reference=1) for row in unjudged]
    one_day = compared_states(ComparedState([*references, *rows[2:]], {}, {}), states[1])
    (mixed,) = texts(flight_cautions(one_day))
    assert "A is of several states: its motors are bad in 2 of 4 logs, taken for healthy" in mixed
    page = comparison_page(("fleet", "log"), one_day)
    assert "A, reference" in page and "motors unknown" not in page
    lights, _ = light_blocks(one_day.reviews)
    assert lights.rows[0][1].reason.startswith("in 2 of 4 logs, reference in 2.")
    # A was flown later, so that B does not show that the motor was mended.
    (step,) = texts(next_step_sentences(reviewed))
    assert step.startswith("Next, by A: Inspect motor 1")
    description = side_descriptions(("fleet", "log"), reviewed)["A"]
    assert description.endswith("(figures are their means), flown 2026-01-06 to 2026-01-09")
    page = comparison_page(("fleet", "log"), reviewed)
    assert "its motors are bad in 2 of 4 logs" in page
    titles = ("A, last of 4 logs", "flown with (mean)", "<th>A, 4 logs</th>")
    for part in ("A, motors good", "A, motors bad", "A, mean", *titles):
        assert part in page
    assert page.count("Each motor has a column for A (dots) and one for B (squares)") == 1
    # Of a fleet each light is counted over its flights.
    lights, equal = light_blocks(reviewed.reviews)
    reasons = {name: fleet_cell.reason for name, fleet_cell, _ in lights.rows}
    assert reasons["motors"].startswith("in 2 of 4 logs, good in 2. The last one, bad: Motor 1")
    assert "The last one, bad: see the top of the page." in page
    assert reasons["vibration"] == "in 2 of 4 logs, unknown in 2."
    assert "power" in equal.text and "power" not in reasons
    # No chart of this page is over time.
    assert "Drag over a plot" not in page
    common = reviewed._replace(common_files=("a.bin",), counting_side="B")
    assert "1 flight of B is in A too (a.bin): it counts for B alone." in plain_text(
        flight_cautions(common)
    )


@mark.parametrize("lean_effect, is_explained", [(0.6, True), (0.0, False)])
def test_a_trim_that_lean_explains_is_no_change_of_the_motor(lean_effect, is_explained):
    """Motors 1 and 4, on the right, work 12 % harder in flights that lean by 0.2 rad.

    That is the effect of lean that the flights themselves show, or it is not.
    """
    geometry = {
        "positions": ((1, 1), (-1, -1), (1, -1), (-1, 1)),
        "spins": (1, 1, -1, -1),
        "lean_effect": (-lean_effect, 0.0, 0.0, 0.0, 0.0, 0.0),
        "lean_effect_error": (0.02,) * 6,
        "balance_error": (0.001,) * 3,
    }
    level = [
        flight_row("quad", number, balance=(0.0,) * 3, balance_lean=(0.0, 0.0), **geometry)
        for number in range(3)
    ]
    leaning = [
        flight_row(
            "quad",
            number,
            trim_share=(1.12, 0.88, 0.90, 1.10),
            balance=(-0.12, 0.0, 0.0),
            balance_lean=(0.2, 0.0),
            **geometry,
        )
        for number in range(3, 6)
    ]
    difference = vehicle_difference(level, leaning)
    reviewed = reviewed_difference(difference)
    headline = " ".join(texts(headline_of_comparison(reviewed)))
    has_lean = "but for what lean explains. Explained by lean: motor 1's relative trim" in headline
    assert has_lean == is_explained
    assert bool(next_step_sentences(reviewed)) != is_explained
    assert ("Changed: motor" in headline) != is_explained


def test_a_sure_change_of_the_weak_motor_is_evidence_too():
    difference = doubtful_trim(1, 0.16)
    change, *rest = difference.changes
    sure = change._replace(outcome=QuantityOutcome.CHANGED, p=1e-4)
    difference = difference._replace(changes=(sure, *rest))
    reviews = judged_reviews(health="fault", suspect_motor=1, fault_probability=0.97)
    headline = " ".join(texts(headline_of_comparison(reviewed_difference(difference, reviews))))
    assert (
        "This agrees with motor 1's relative trim +16 % (+10 to +22 %), sure by itself." in headline
    )
    assert "Changed:" not in headline
    # Where the trim of another motor changed, too, the larger change heads the result, and is not stated twice.
    other = next(change for change in rest if change.quantity.kind == SHARE)
    other = other._replace(outcome=QuantityOutcome.CHANGED, p=1e-5, tested_difference=log1p(-0.09))
    both = difference._replace(changes=(sure, other))
    headline = " ".join(texts(headline_of_comparison(reviewed_difference(both, reviews))))
    assert "Changed: motor 1's relative trim +16 % (+10 to +22 %), and motor 2's" in headline
    assert headline.count("+16 %") == 1
    # Where all trims together leave it open, the headline has one verdict, and the next step a further flight.
    reviews = judged_reviews(health="drift", suspect_motor=1, fault_probability=0.5)
    doubted = reviewed_difference(difference, reviews)
    assert "sure by itself" not in " ".join(texts(headline_of_comparison(doubted)))
    assert "another healthy flight" in " ".join(texts(next_step_sentences(doubted)))
    figures = {
        "rise": (0.13, 0.06, 0.2),
        "loss": (0.22, 0.11, 0.3),
        "flights": 1,
        "are_chosen": False,
    }
    fact = Fact(
        MotorsBetween.MOTOR_WEAK,
        subject="motor 1",
        probability=0.5,
        motor_probability=0.5,
        **figures,
    )
    assert fact.sentence.startswith(
        "Motor 1 works 13 % (6 to 20 %) harder; that it lost thrust is as likely as not (probability 0.50): one healthy"
    )


def test_a_doubtful_trim_is_no_step_where_all_together_show_no_weak_motor():
    """The headline names the doubtful trim of motor 4, and that all trims together show no weak motor."""
    difference = doubtful_trim(4, 0.08)
    reviews = judged_reviews(
        health="unknown", fault_probability=0.01, health_reason="Not enough flights."
    )
    (result,) = texts(headline_of_comparison(reviewed_difference(difference, reviews)))
    assert result.startswith(
        "No change is certain. Perhaps: motor 4's relative trim +8 % (+2 to +14 %)"
    )
    assert result.endswith("show no motor that works 8 % harder (probability 0.01).")
    assert next_step_sentences(reviewed_difference(difference, reviews)) == []
    # It may be a damage, so that a light that became better follows it.
    shaken = {"level": "watch", "sentence": "Vibration 16 m/s²."}
    lights_by_side = {"A": shaken, "B": shaken | {"level": "good"}}
    reviews_with_vibration = {
        side: {**reviews[side], "lights": reviews[side]["lights"] | {"vibration": light}}
        for side, light in lights_by_side.items()
    }
    headline = headline_of_comparison(reviewed_difference(difference, reviews_with_vibration))
    assert [sentence.lead for sentence in headline] == ["No change is certain.", "Vibration:"]
    reviewed = reviewed_difference(difference, reviews)
    headline = headline_of_comparison(reviewed)
    # What the headline says is not said again below it.
    assert "Doubtful" not in plain_text(change_sentences(reviewed, headline))
    # A probability that is not small excludes nothing: then the trim has its step.
    open_reviews = judged_reviews(health="unknown", fault_probability=0.33)
    reviewed = reviewed_difference(difference, open_reviews)
    (result,) = texts(headline_of_comparison(reviewed))
    assert result.endswith("leave open whether a motor works 8 % harder (probability 0.33).")
    (step,) = texts(next_step_sentences(reviewed))
    assert step.startswith("Next: Inspect motor 4")
    # Without that judgement the trim is all that is known.
    assert texts(headline_of_comparison(reviewed_difference(difference)))[0].startswith(
        "No change is certain. Perhaps: motor 4"
    )
    (step,) = texts(next_step_sentences(reviewed_difference(difference)))
    assert step.startswith("Next: Inspect motor 4")


def test_beside_a_baseline_the_weak_motor_has_one_verdict():
    row = flight_row(
        "quad", 2, health="drift", health_reason="Motor 1 lost thrust.", suspect_motor=1
    )
    _, motors, rest, *further_texts = texts(baseline_blocks(row, doubtful_trim(1, 0.08)))
    assert motors == (
        "Motors: Motor 1 lost thrust. This agrees with motor 1's relative trim +8 % (+2 to +14 %)."
    )
    assert rest.startswith("No other compared figure changed significantly.")
    assert not any("Perhaps" in text or "Doubtful" in text for text in further_texts)


def test_a_motor_that_the_log_alone_watches_has_the_words_of_lists_in_a_comparison():
    alone = {"level": "watch", "subject": "motor 1", "sentence": "Motor 1 works 9 % harder."}
    review = {"lights": {"motors": alone}, "headline": {"level": "watch", "sentence": "Uneven."}}
    weak = anomaly("drift", 1, "Motor 1 lost about 27 % of its thrust.")
    light = review_with_anomaly(review, weak)["lights"]["motors"]
    assert (light["level"], light["subject"], light["sentence"]) == (
        "watch",
        "motor 1",
        weak.reason,
    )
    unnamed = anomaly("drift", None, "It differs.")
    light = review_with_anomaly(review, unnamed)["lights"]["motors"]
    assert light["subject"] == "motor 1"
    assert light["sentence"] == "It differs. By this log alone: Motor 1 works 9 % harder."


@mark.parametrize("health", ["drift", "fault"])
def test_a_log_that_shows_something_bad_keeps_its_headline_and_light(health):
    bad = {"level": "bad", "sentence": "Motor 2 stopped."}
    review = {"headline": bad, "lights": {"motors": bad}, "next_step": {"sentence": "Repair it."}}
    assert review_with_anomaly(review, anomaly(health, 1)) == review
