"""The next step after a comparison of two states."""

from collections.abc import Iterable, Mapping, Sequence

from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorsBetween, motor_number
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.difference import VehicleDifference
from mavdem.fleet.random_effects import QuantityChange
from mavdem.fleet.report_columns import value_at
from mavdem.report.blocks import Sentence
from mavdem.report.difference.changes import (
    changes_by_cause,
    changes_by_relevance,
    doubtful_changes,
)
from mavdem.report.difference.effort import effort_steps
from mavdem.report.difference.lights import (
    BadLight,
    Review,
    bad_lights,
    later_side,
    lights_are_equal,
    lights_of_both,
)
from mavdem.report.difference.quantity_texts import motor_name
from mavdem.report.difference.reviewed import ReviewedDifference
from mavdem.report.templates import BAN, render_section


def next_step_sentences(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the next steps after a comparison.

    The first of these conditions that applies decides:

    1. A and B are the same flight: no step.
    2. A light is bad: the next step of that log's own review; for the earlier log, only if the later one does not show
       that its fault was mended, or if it is B, whose date may then be wrong.
    3. The states are of two vehicles: no step, since their differences are no faults.
    4. The later flight differs by its motors from other flights of the vehicle: the step of its own page.
    5. A light warns of a motor that the later log does not show to be mended: to inspect it.
    6. A motor was bad in the earlier log and the motors are good in the later one: whether it was repaired; also
       the step of the later log, if that warns of another part.
    7. A quantity changed that new gains do not explain: to check the part that this points to.
    8. A change is doubtful: to inspect the motor that perhaps became weaker, if there is one that the judgement of all
       motors together does not exclude, and to fly again.
    9. All motors perhaps work harder or less hard: to check the load, then the propellers.
    10. Otherwise: the next step of the later log's own review.

    Args:
        reviewed: comparison of two states, beside the reviews of both logs.

    Returns:
        A list with one sentence, two if both logs have a bad light or in the sixth case, or an empty one.
    """
    difference = reviewed.difference
    if difference.is_of_same_flight:
        return []
    steps = _steps_of_bad_logs(reviewed)
    if steps:
        return steps
    if reviewed.are_two_vehicles:
        return []
    motor_steps = (
        _step_of_differing_motors(reviewed)
        or _step_of_watched_motor(reviewed)
        or _step_of_mended_motor(reviewed)
    )
    if motor_steps:
        return motor_steps
    changes = changes_by_relevance(difference, without=reviewed.motors.evidence)
    unexplained_changes = changes_by_cause(difference, changes).unexplained
    if unexplained_changes:
        return _step_of_unexplained_changes(unexplained_changes, difference)
    # All trims together decide whether a motor is weak, which a doubtful trim then does not.
    doubtful = []
    for change in doubtful_changes(reviewed):
        if not reviewed.motors.takes_precedence_over(change):
            doubtful.append(change)
    if doubtful:
        return _step_of_doubtful_changes(doubtful, difference)
    return effort_steps(reviewed) or _step_of_later_log(reviewed.reviews)


def _step_of_later_log(reviews: Mapping[str, Review]) -> list[Sentence]:
    """Returns the next step that the later log's own review advises; empty where it advises none.

    Args:
        reviews: review documents of both logs, by side, "A" and "B".
    """
    side = later_side(reviews)
    next_step = value_at(reviews.get(side, {}), "next_step.sentence")
    return [Sentence(next_step, lead=f"Next, by {side}:")] if next_step else []


def _step_of_doubtful_changes(
    doubtful: Iterable[QuantityChange], difference: VehicleDifference
) -> list[Sentence]:
    """Returns the step to fly again and, if a doubtful change shows a weaker motor, to inspect that motor.

    Args:
        doubtful: the doubtful changes, the most certain first.
        difference: comparison of two states, with the names of the motors.
    """
    motor = ""
    for change in doubtful:
        if change.shows_weaker_motor:
            motor = motor_name(change, difference)
            break
    return render_section("difference_doubt", motor=motor)


def _steps_of_bad_logs(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the next steps that the logs' own reviews advise, of the logs with a bad status light that still counts.

    A step that forbids flight comes first, and otherwise that of the log that was flown later. A step that both logs
    advise is returned once.

    Args:
        reviewed: comparison of two states, with the reviews of both logs.
    """
    steps: list[Sentence] = []
    for side in _sides_with_needed_step(reviewed):
        next_step = value_at(reviewed.reviews[side], "next_step.sentence")
        if next_step and next_step not in [step.text for step in steps]:
            steps.append(Sentence(next_step, lead=f"Next, by {side}:"))
    return sorted(steps, key=lambda step: BAN not in step.text)


def _sides_with_needed_step(reviewed: ReviewedDifference) -> list[str]:
    """Returns the sides, "A" or "B", whose own next step still counts, that of the later log first.

    - That of the later log counts if it has a bad light. It also counts if the later log still warns of a loop that was
      bad in the earlier one, and whose gains were changed since.
    - That of the earlier log counts if it has a bad light and the later log does not make its step superfluous
      (:func:`_is_superseded`). Of two vehicles, one does not show whether the other was mended. The bad light of a B
      that is dated before A counts too, since the order in which the user names them contradicts the dates.

    Args:
        reviewed: comparison of two states, with the reviews of both logs.
    """
    reviews = reviewed.reviews
    later = later_side(reviews)
    [earlier] = set(STATE_NAMES) - {later}
    needed_sides = set[str]()
    for light in bad_lights(reviews):
        if later in light.bad_sides:
            needed_sides.add(later)
        if earlier not in light.bad_sides:
            continue
        later_level = reviews[later]["lights"][light.name]["level"]
        if later_level == Level.WATCH and _has_other_gains(light, reviewed.difference):
            needed_sides.add(later)
        # Where B is dated before A, the user's order contradicts the dates: a wrong clock must not hide a bad B.
        is_order_doubtful = earlier == "B" and later not in light.bad_sides
        if reviewed.are_two_vehicles or is_order_doubtful or not _is_superseded(light, reviewed):
            needed_sides.add(earlier)
    return [side for side in (later, earlier) if side in needed_sides]


def _is_superseded(light: BadLight, reviewed: ReviewedDifference) -> bool:
    """Returns whether the later log makes the step against a bad light of the earlier log superfluous.

    It does if the light is good in the later log; if it is bad there for the same reason, against which the later log's
    own step helps too; or if it judges loops whose gains were changed since.

    Args:
        light: a light that is bad in the earlier log.
        reviewed: comparison of two states, with the reviews of both logs.
    """
    lights_by_side = lights_of_both(reviewed.reviews)[light.name]
    later_light = lights_by_side[later_side(reviewed.reviews)]
    is_mended = later_light["level"] == Level.GOOD
    is_bad_again = lights_are_equal(*lights_by_side.values())
    return is_mended or is_bad_again or _has_other_gains(light, reviewed.difference)


def _has_other_gains(light: BadLight, difference: VehicleDifference) -> bool:
    """Returns whether a bad light judges a loop whose gains differ between the logs, so that it says nothing of today.

    Args:
        light: a status light that is bad in one of the logs.
        difference: comparison of the two states, which knows the axes with other gains.
    """
    return light.name == Light.MARGINS and light.axis in difference.axes_with_changed_loops


def _step_of_differing_motors(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the next step of the later log if its motors differ from those in other flights of the vehicle.

    Args:
        reviewed: comparison of the two states, with the reviews of both logs.

    Returns:
        A list with the step, as the page of that flight has it; empty if the motors do not differ.
    """
    review = reviewed.reviews.get(later_side(reviewed.reviews), {})
    next_step = value_at(review, "next_step.sentence")
    # Headlines with codes of this enumeration are about motors that differ from those in other flights.
    is_about_motors = value_at(review, "headline.code") in list(MotorsBetween)
    if not next_step or not is_about_motors:
        return []
    return [Sentence(next_step, lead="Next:")]


def _step_of_watched_motor(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the step to inspect a motor that looks weak in one of two flights: its light is "watch".

    A motor that looks weak in the earlier flight only needs no inspection if the motors of the later flight are good:
    it was repaired in between.

    Args:
        reviewed: comparison of the two states, with the reviews of both logs.

    Returns:
        A list with one sentence. Empty if no motor looks weak, or if both reviews judge the motors alike: the
        comparison then has nothing to add to their advice.
    """
    if not reviewed.motors.differs:
        return []
    later = later_side(reviewed.reviews)
    # The status light of the motors is their judgement, and its subject is the motor that it warns of.
    lights_by_side = lights_of_both(reviewed.reviews)[Light.MOTORS]
    are_motors_good_later = lights_by_side[later]["level"] == Level.GOOD
    for side, light in lights_by_side.items():
        was_repaired = side != later and are_motors_good_later
        number = motor_number(light.get("subject") or "")
        if light["level"] == Level.WATCH and number is not None and not was_repaired:
            # The sentence for a weaker motor is to inspect it and its propeller.
            return render_section(
                "difference_next",
                motor=f"motor {number}",
                is_weaker=True,
                needs_healthy_flight=reviewed.motors.is_as_likely_as_not,
            )
    return []


def _step_of_mended_motor(reviewed: ReviewedDifference) -> list[Sentence]:
    """Returns the step to inspect a motor that was bad in the earlier log, unless it was repaired since.

    Good motors in the later log do not show that: a loose connector may hold for one flight.

    Args:
        reviewed: comparison of the two states, with the reviews of both logs.

    Returns:
        A list with this step and, if a light of the later log is "watch", the step of that log; empty unless the motors
        are bad in the earlier log and good in the later one.
    """
    lights_by_side = lights_of_both(reviewed.reviews).get(Light.MOTORS)
    if lights_by_side is None:
        return []
    later = later_side(reviewed.reviews)
    [earlier] = set(STATE_NAMES) - {later}
    number = motor_number(lights_by_side[earlier].get("subject") or "")
    is_mended = (
        lights_by_side[earlier]["level"] == Level.BAD
        and lights_by_side[later]["level"] == Level.GOOD
    )
    if number is None or not is_mended:
        return []
    steps = render_section("difference_mended_motor", motor=f"motor {number}")
    lights_of_later_log = value_at(reviewed.reviews[later], "lights") or {}
    if any(light["level"] == Level.WATCH for light in lights_of_later_log.values()):
        steps += _step_of_later_log(reviewed.reviews)
    return steps


def _step_of_unexplained_changes(
    changes: Sequence[QuantityChange], difference: VehicleDifference
) -> list[Sentence]:
    """Returns the next step after changes that new gains do not explain: which part of the vehicle to inspect.

    It follows from one of the changes: the one with the lowest p-value among those that show a weaker motor or, without
    such, among all. If this change is about a motor, the sentence names that motor.

    Args:
        changes: the changed quantities that new gains do not explain, at least one.
        difference: comparison of the vehicle, with the names of its motors.

    Returns:
        A list with one sentence, such as "Inspect motor 2 and its propeller before the next flight."
    """
    weaker_motors = [change for change in changes if change.shows_weaker_motor]
    candidates = weaker_motors or changes
    most_significant_change = min(candidates, key=lambda change: change.p)
    motor = ""
    if most_significant_change.quantity.is_of_motor:
        motor = motor_name(most_significant_change, difference)
    return render_section("difference_next", motor=motor, is_weaker=bool(weaker_motors))
