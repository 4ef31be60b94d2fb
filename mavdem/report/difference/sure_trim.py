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
    """Lets the light of the motors in B state a trim that surely rose, where it doubts that the motor is weak.

    The balance of all motors also knows other causes, such as a shifted load, so that it may leave open what one trim
    shows. The reader gets one verdict: the trim, which is measured, and how probable a weak motor is as its cause.

    Args:
        reviews: review documents of both logs, by side, "A" and "B".
        motors: what is known of the motors, with the changes that agree with a weak one.
        difference: comparison of the two states.

    Returns:
        The reviews, that of B with another sentence and rise of the motors' light; the same if no trim surely rose, if
        B's balance shows a weak motor, or if a side has several flights, whose mean trim is not that of the judged one.
    """
    _, later_name = STATE_NAMES
    review = reviews.get(later_name, {})
    light = value_at(review, f"lights.{Light.MOTORS}") or {}
    health = review.get("motor_health") or {}
    probability = health.get("fault_probability")
    trim = _trim_that_surely_rose(motors)
    is_doubted = probability is not None and probability < PROBABLE
    is_by_balance = light.get("sentence") == health.get("sentence")
    is_watched = light.get("level") == Level.WATCH and is_by_balance
    if trim is None or not is_doubted or not is_watched or max(difference.flights) > 1:
        return reviews
    [sentence] = render_section(
        "difference_sure_trim",
        motor=motor_with_place(trim.quantity.motor, difference),
        increase=increase_with_interval(trim),
        probability=probability,
    )
    figures = (light.get("figures") or {}) | {"rise": (trim.difference, *trim.interval)}
    stated_light = light | {"sentence": sentence.text, "figures": figures}
    lights = review["lights"] | {Light.MOTORS: stated_light}
    return {**reviews, later_name: {**review, "lights": lights}}


def _trim_that_surely_rose(motors: MotorVerdict) -> QuantityChange | None:
    """Returns the trim of a motor that is named as weak, if it surely rose and lean does not explain it; or None."""
    for change in motors.evidence:
        is_rise_of_trim = change.quantity.kind == SHARE and change.shows_weaker_motor
        is_sure = change.outcome is QuantityOutcome.CHANGED and not change.is_explained_by_lean
        if is_rise_of_trim and is_sure:
            return change
    return None
