"""One verdict on a motor whose trim surely rose, while the balance of all motors leaves open whether it is weak."""

from collections.abc import Mapping

from mavdem.facts import Level
from mavdem.facts.fleet import QuantityOutcome
from mavdem.facts.lights import Light
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.difference import VehicleDifference
from mavdem.fleet.quantities import SHARE
from mavdem.fleet.random_effects import QuantityChange
from mavdem.fleet.report_columns import value_at
from mavdem.report.difference.lights import Review
from mavdem.report.difference.motors import MotorVerdict
from mavdem.report.difference.quantity_texts import increase_with_interval, motor_with_place
from mavdem.report.templates import render_section

PROBABLE = 0.5
"""Probability of a weak motor from which the judgement of the balance stands as it is: more likely than not."""


def reviews_with_sure_trim(
    reviews: Mapping[str, Review], motors: MotorVerdict, difference: VehicleDifference
) -> Mapping[str, Review]:
    """Returns the reviews of two logs, the second of which states a motor's trim that surely rose.

    The trim of a motor is how much harder it works than the mean of all. The review judges all trims together, and also
    by other causes, such as a shifted load. So it may doubt that the motor is weak, although its trim surely rose from
    A to B. The reader then gets one verdict: the measured trim, and how probable a weak motor is as its cause.

    Args:
        reviews: review documents of both logs, by side, "A" and "B".
        motors: what is known of the motors, with the changes that agree with a weak one.
        difference: comparison of the two states.

    Returns:
        The reviews, that of B with another sentence and rise of the motors' light. They are returned as they are if no
        trim surely rose, if B shows a weak motor by all trims, or if a side has several flights, whose mean trim is not
        that of the judged flight.
    """
    _, second_side = STATE_NAMES
    review = reviews.get(second_side, {})
    trim = _trim_that_surely_rose(motors)
    probability = _doubted_probability(review)
    has_several_flights = max(difference.flights) > 1
    if trim is None or probability is None or has_several_flights:
        return reviews
    [sentence] = render_section(
        "difference_sure_trim",
        motor=motor_with_place(trim.quantity.motor, difference),
        increase=increase_with_interval(trim),
        probability=probability,
    )
    light = review["lights"][Light.MOTORS]
    figures = (light.get("figures") or {}) | {"rise": (trim.difference, *trim.interval)}
    stated_light = light | {"sentence": sentence.text, "figures": figures}
    lights = review["lights"] | {Light.MOTORS: stated_light}
    return {**reviews, second_side: {**review, "lights": lights}}


def _doubted_probability(review: Review) -> float | None:
    """Returns the probability of a weak motor if the motors are to be watched, but are probably not weak.

    Args:
        review: review document of a log.

    Returns:
        The probability by all trims together; None if it is not known or not small, or if the light of the motors is
        not of the level "watch" or states something else.
    """
    light = value_at(review, f"lights.{Light.MOTORS}") or {}
    health = review.get("motor_health") or {}
    probability: float | None = health.get("fault_probability")
    is_by_all_trims = light.get("sentence") == health.get("sentence")
    is_watched = light.get("level") == Level.WATCH and is_by_all_trims
    if probability is None or probability >= PROBABLE or not is_watched:
        return None
    return probability


def _trim_that_surely_rose(motors: MotorVerdict) -> QuantityChange | None:
    """Returns the first surely risen trim that shows a weaker motor, or None if there is none.

    The trim is a motor's mean command in hover compared with the other motors: a weak motor gets more. A rise that a
    change of the vehicle's lean (its tilt in hover) explains does not count.
    """
    for change in motors.evidence:
        is_rise_of_trim = change.quantity.kind == SHARE and change.shows_weaker_motor
        is_sure = change.outcome is QuantityOutcome.CHANGED and not change.is_explained_by_lean
        if is_rise_of_trim and is_sure:
            return change
    return None
