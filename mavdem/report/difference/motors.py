"""The motors of two states: the judgement of their reviews, the compared figures that agree with it, and a table."""

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from mavdem.containers import JsonValues
from mavdem.experiments.paired_test import SIGNIFICANCE
from mavdem.facts import Level
from mavdem.facts.fleet import QuantityOutcome
from mavdem.facts.lights import Light
from mavdem.facts.motors import LIKELY_PROBABILITY, motor_number
from mavdem.fleet.comparability import STATE_NAMES
from mavdem.fleet.difference import VehicleDifference
from mavdem.fleet.quantities import EFFECT, SHARE
from mavdem.fleet.random_effects import QuantityChange
from mavdem.fleet.report_columns import value_at
from mavdem.report.blocks import Blocks, Rated, Table, shortened
from mavdem.report.difference.lights import (
    WARNING_LEVELS,
    Review,
    later_side,
    lights_are_equal,
    lights_of_both,
)
from mavdem.report.difference.quantity_texts import (
    SHOWN_QUANTITIES,
    change_with_interval,
    motor_with_place,
)
from mavdem.report.difference.side_titles import last_log_title
from mavdem.report.fleet import ANOMALOUS_HEALTHS
from mavdem.report.numbers import without_remark
from mavdem.report.templates import capitalize_first, render_section, without_full_stop

WITHOUT_LEAN = "without lean"
"""Title of the column of relative trims without the part that the vehicle's lean makes, as in wind."""

MAX_MOTOR_CHARACTERS = 32
"""Largest length of what a table says of a motor in one flight: two of them fit into 80 columns with the changes."""


class MotorVerdict(NamedTuple):
    """What is known of the motors beside the compared figures, which are then no verdicts of their own.

    The motors of a flight are judged by their balance, which is all trims together, after the part that lean makes.
    That test finds a weak motor where each trim alone is uncertain, and none where lean shifts a trim.
    """

    evidence: tuple[QuantityChange, ...] = ()
    """Changes of figures of a motor that is named as weak, as a weak motor makes them, sure or doubtful."""

    fault_probability: float | None = None
    """Probability of a weak motor in the later flight by the balance of all motors; None if it was not judged."""

    is_weak: bool = False
    """Whether the later flight differs by its motors from others of the vehicle."""

    differs: bool = False
    """Whether the motors of the two states are judged differently, with another level or of another motor."""

    suspects: tuple[int, ...] = ()
    """Numbers of the motors that are named as weak."""

    def covers(self, change: QuantityChange) -> bool:
        """Returns whether a figure is of a motor that is named as weak, so that it is no result of its own."""
        return change.quantity.is_of_motor and change.quantity.motor in self.suspects

    @property
    def is_as_likely_as_not(self) -> bool:
        """Whether a motor is named as weak, although by all trims together that is about as likely as not."""
        if self.fault_probability is None:
            return False
        return self.is_weak and self.fault_probability < LIKELY_PROBABILITY

    @property
    def excludes_weak_motor(self) -> bool:
        """Whether all trims together show that no motor is weak: it is less probable than a false alarm may be."""
        return self.fault_probability is not None and self.fault_probability < SIGNIFICANCE

    def takes_precedence_over(self, change: QuantityChange) -> bool:
        """Returns whether a doubtful change is left out of a text, since the judgement of the motors says more.

        It is left out if it belongs to a motor that is known to be weak, and so is the change of any motor's trim if
        all trims together show that no motor is weak.

        Args:
            change: change of one quantity between the two states.
        """
        is_trim = change.quantity.kind == SHARE
        return change in self.evidence or (is_trim and self.excludes_weak_motor)


NO_VERDICT = MotorVerdict()
"""The motors were not judged, as of two vehicles."""


def motor_verdict(reviews: Mapping[str, Review], difference: VehicleDifference) -> MotorVerdict:
    """Collects what a comparison of two logs knows of the motors: which are weak, and how probable a fault is.

    A motor counts as weak in a log if the log's status light of the motors, their judgement, warns of it. If the lights
    of both logs are the same or warn of the same motor, none counts: whether the motor became worse is then shown by
    its measured quantities alone.
    The probability of a fault is taken from the later log, since its motors were also compared with other flights of
    the vehicle. Of two vehicles it is not known: each was compared with its own flights.

    Args:
        reviews: review documents of both logs, by side, "A" and "B"; of a fleet, empty.
        difference: comparison of the two states, quantity by quantity.
    """
    # Number of the weak motor of a log, by the side of the log.
    weak_motors: dict[str, int | None] = {}
    differs = _has_motor_difference(reviews)
    if differs:
        for side, light in lights_of_both(reviews)[Light.MOTORS].items():
            if light["level"] in WARNING_LEVELS:
                weak_motors[side] = motor_number(light.get("subject") or "")
    is_same_motor_weak = len(weak_motors) > 1 and len(set(weak_motors.values())) == 1
    if is_same_motor_weak:
        weak_motors = {}
    evidence = tuple(evidence_of_weak_motors(difference, weak_motors))
    later_review = reviews.get(later_side(reviews)) or {}
    motor_health = value_at(later_review, "motor_health") or {}
    fault_probability = motor_health.get("fault_probability")
    return MotorVerdict(
        evidence,
        fault_probability=None if difference.is_of_two_vehicles else fault_probability,
        is_weak=motor_health.get("health") in ANOMALOUS_HEALTHS,
        differs=differs,
        suspects=tuple(number for number in weak_motors.values() if number is not None),
    )


def _has_motor_difference(reviews: Mapping[str, Review]) -> bool:
    """Returns whether the reviews of two logs judge the motors differently: with another level, or of another motor.

    The status lights of the motors are compared, and not the measured quantities: if a motor lost thrust during one
    flight, there is no such figure of the other flight to compare with. If neither light warns (one is good and the
    other unknown, for example), the motors count as equal.

    Args:
        reviews: review documents of both logs, by side, "A" and "B". A document without lights, such as the review of a
            fleet, is compared with nothing.
    """
    motor_lights = lights_of_both(reviews).get(Light.MOTORS)
    if motor_lights is None:
        return False
    first_light, second_light = motor_lights.values()
    warns = first_light["level"] in WARNING_LEVELS or second_light["level"] in WARNING_LEVELS
    return warns and not lights_are_equal(first_light, second_light)


def evidence_of_weak_motors(
    difference: VehicleDifference, weak_motors: Mapping[str, int | None]
) -> Iterator[QuantityChange]:
    """Yields the measured changes that confirm a weak motor, such as a higher trim in the log in which it is weak.

    A change counts if it is significant, or doubtful: significant by itself, but not among all tested quantities.

    Args:
        difference: comparison of the two logs, A and B, quantity by quantity.
        weak_motors: number of the motor that a log judges as weak, by side, "A" or "B"; None if that is not known.
    """
    first_side, second_side = STATE_NAMES
    for change in difference.changes:
        if not change.quantity.is_of_motor:
            continue
        is_significant = change.outcome is QuantityOutcome.CHANGED
        # A motor that became stronger from A to B is weaker in A.
        weaker_side = second_side if change.shows_weaker_motor else first_side
        is_of_weak_motor = weak_motors.get(weaker_side) == change.quantity.motor
        if is_of_weak_motor and (is_significant or change.is_doubtful):
            yield change


def motor_table(reviews: Mapping[str, Review], difference: VehicleDifference) -> Blocks:
    """Returns a table that compares the motors of two flights one by one, for a page or the terminal.

    Each row has the name of the motor, then for each flight the worst warning of its review about this motor, such as
    "lost about 25 %". Then come the changes from A to B with their 90 % intervals: of the motor's relative trim, of the
    trim without the part that the vehicle's lean makes, and of the control effectiveness.

    Args:
        reviews: review documents of both logs, by side, "A" and "B"; of a fleet, empty.
        difference: comparison of the two states.

    Returns:
        A list with the table; empty if neither flight has a warning about a single motor, since the changes alone are
        shown elsewhere.
    """
    warnings_by_side = {side: motor_warnings(reviews.get(side, {})) for side in STATE_NAMES}
    if not any(warnings_by_side.values()):
        return []
    columns = _changes_by_motor(difference)
    rows = []
    for motor in _motors_in_table(columns, warnings_by_side, reviews):
        motor_name = motor_with_place(motor, difference)
        row = [motor_name]
        for side in STATE_NAMES:
            warning = warnings_by_side[side].get(motor)
            if warning is None:
                row.append(_cell_without_warning(reviews[side]))
            else:
                row.append(_cell_with_warning(warning, motor_name))
        for changes in columns.values():
            change_of_motor = changes.get(motor)
            row.append("" if change_of_motor is None else change_with_interval(change_of_motor))
        rows.append(row)
    return [Table(["", *_titles_of_motor_table(columns, difference)], rows)]


def _motors_in_table(
    columns: Mapping[str, Mapping[int, QuantityChange]],
    warnings_by_side: Mapping[str, Mapping[int, JsonValues]],
    reviews: Mapping[str, Review],
) -> list[int]:
    """Returns the numbers of the motors that the table of motors lists, from 1 on, in ascending order.

    These are the motors with a compared figure or a warning. If a flight has a warning, all its motors are listed, so
    that the sound ones can be compared.

    Args:
        columns: the compared figures: by kind of quantity, the change of each motor, by its number.
        warnings_by_side: the warning about each motor, by side and by the number of the motor.
        reviews: review documents of both logs, by side.
    """
    motors = set[int]()
    for changes in columns.values():
        motors.update(changes)
    for side, warnings in warnings_by_side.items():
        motors.update(warnings)
        if warnings:
            hover_motors = value_at(reviews[side], "condition.hover.motors") or ()
            motors.update(range(1, len(hover_motors) + 1))
    return sorted(motors)


def _changes_by_motor(difference: VehicleDifference) -> dict[str, dict[int, QuantityChange]]:
    """Returns the changes of each motor by kind of quantity and by the number of the motor: columns of a table.

    The kinds are trims (``SHARE``), trims without the part that the vehicle's lean makes (``WITHOUT_LEAN``), and
    control effectiveness (``EFFECT``). A kind that was compared for no motor is left out.

    Args:
        difference: comparison of two states.
    """
    columns: dict[str, dict[int, QuantityChange]] = {SHARE: {}, WITHOUT_LEAN: {}, EFFECT: {}}
    for change in difference.changes:
        motor = change.quantity.motor
        if change.quantity.is_of_motor:
            columns[change.quantity.kind][motor] = change
        if change.without_lean is not None:
            columns[WITHOUT_LEAN][motor] = change.without_lean
    return {kind: changes for kind, changes in columns.items() if changes}


def _titles_of_motor_table(columns: Iterable[str], difference: VehicleDifference) -> list[str]:
    """Returns the titles of the columns beside the motors' names, such as "A", "B, last of 9 logs", "mean trim".

    Args:
        columns: kinds of the quantities in the columns after those of the two states.
        difference: comparison of two states, with the numbers of their flights.
    """
    # Warnings are those of one flight, and figures the means of all.
    titles = []
    for side, log_count in zip(STATE_NAMES, difference.flights, strict=True):
        titles.append(last_log_title(side, log_count))
    for column in columns:
        if column == WITHOUT_LEAN:
            titles.append(column)
            continue
        name = SHOWN_QUANTITIES[column].name
        titles.append(f"mean {name}" if max(difference.flights) > 1 else name)
    return titles


def motor_warnings(review: Review) -> dict[int, JsonValues]:
    """Returns the worst warning of a log's review about each motor, for a table that compares the motors of two logs.

    Warnings are the status light of the motors and the events of the flight. Of equally bad ones the light is taken, or
    else the first event.

    Args:
        review: review document of a log; empty for a fleet.

    Returns:
        The warnings by the number of the motor, from 1 on, as the JSON document has them, with keys such as "level",
        "subject" and "sentence". Motors without a warning are left out.
    """
    motor_light = value_at(review, f"lights.{Light.MOTORS}")
    findings = []
    if motor_light is not None:
        # An anomaly by the vehicle's other flights may name no motor: then the light by the log alone does.
        findings.append(motor_light.get("by_log_alone") or motor_light)
    findings += review.get("events", ())
    warnings: dict[int, JsonValues] = {}
    # The worst level comes first, so that a later and milder warning does not replace the one that is there.
    for level in WARNING_LEVELS:
        for finding in findings:
            motor = motor_number(finding.get("subject") or "")
            if motor is not None and finding["level"] == level:
                warnings.setdefault(motor, finding)
    return warnings


def _cell_without_warning(review: Review) -> str:
    """Returns the table cell of a motor that a log has no warning about: "no warning", or "not known".

    It is not known if the motors of the log were not judged, for example because their outputs were not logged.

    Args:
        review: review document of the log; empty for a fleet.
    """
    motors_level = value_at(review, f"lights.{Light.MOTORS}.level") or Level.UNKNOWN
    are_motors_judged = Level(motors_level) is not Level.UNKNOWN
    [cell] = render_section(
        "difference_motor", code="", time=None, sentence="", is_known=are_motors_judged
    )
    return cell.text


def _cell_with_warning(warning: JsonValues, motor_name: str) -> Rated:
    """Returns the table cell of a motor that a log warns about, such as "lost 19 to 42 % at 47 s" with the level "bad".

    Warnings that the template of the cell does not know are quoted, without the motor, which the row names.

    Args:
        warning: the worst warning about the motor, as the review document of the log has it (:func:`motor_warnings`).
        motor_name: the motor with its place, such as "motor 1 (front right)".
    """
    figures = warning.get("figures") or {}
    [cell] = render_section(
        "difference_motor",
        code=warning.get("code") or "",
        time=warning.get("time"),
        sentence=_without_motor(warning["sentence"], motor_name),
        loss=figures.get("loss"),
        rise=figures.get("rise"),
        deviation=figures.get("deviation"),
        probability=figures.get("probability"),
        is_known=True,
    )
    text = without_full_stop(shortened(cell.text, MAX_MOTOR_CHARACTERS))
    return Rated(text, Level(warning["level"]))


def _without_motor(sentence: str, motor_name: str) -> str:
    """Returns a sentence without the motor at its start, such as "was at its upper limit.".

    Args:
        sentence: for example "Motor 1 was at its upper limit.", or the same with the place of the motor.
        motor_name: the motor with its place, such as "motor 1 (front right)".
    """
    motor = capitalize_first(motor_name)
    return sentence.removeprefix(motor).removeprefix(without_remark(motor)).strip()
