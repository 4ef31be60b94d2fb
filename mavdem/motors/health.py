"""Health of a vehicle's motors between flights, with facts (coded findings): which motor works too hard.

Each flight is compared with healthy flights of the same vehicle, by the balance of its motors and by their effort.
The method: docs/motors.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from mavdem.containers import JsonValues
from mavdem.facts import Fact, Level
from mavdem.facts.motors import Explanation, HealthUnknown, MotorHealth, MotorsBetween
from mavdem.motors.change_hypotheses import DETECTABLE_RISE, ChangeProbabilities
from mavdem.motors.flight_evidence import (
    MIN_REPORTED_PROBABILITY,
    FlightEvidence,
    flight_evidence,
)
from mavdem.motors.healthy_flight_choice import first_healthy_flights, named_healthy_flights
from mavdem.motors.healthy_flights import (
    MIN_BASELINE_FLIGHTS,
    MIN_HEALTHY_FLIGHTS,
    HealthFigures,
    HealthFlights,
    is_comparable,
    is_same_flight,
)
from mavdem.motors.thrust_loss import lost_thrust

MIN_FAULT_PROBABILITY = 0.8
"""Probability of a weak motor from which that is a fault, which is bad: a choice. A less probable one is a drift, which
is to be watched."""

MIN_NAMED_PROBABILITY = 0.8
"""Probability of one motor, given that some motor is faulty, from which that motor is named; a choice."""


class HealthAssessment(NamedTuple):
    """Assessment of the motors in one flight, with the evidence."""

    health: MotorHealth
    """Health of the motors.

    FAULT: a motor works 8 % harder or more than in healthy flights, since it or its propeller is weak. DRIFT: that is
    probable, but not sure, or the balance changed by less, or not by a motor, or the effort changed. OK: as in healthy
    flights, and a motor that works 20 % harder would have shown.
    """
    fact: Fact
    """The evidence, or what is missing."""
    fault_probability: float | None = None
    """Probability that some motor works 8 % harder or more, since it or its propeller is weak; None where unknown."""
    change_probability: float | None = None
    """Probability that anything changed, faults included; None where unknown."""
    suspect_motor: int | None = None
    """Number of the motor that most likely has the fault or explains the drift, from 1; None if none can be named."""
    is_healthy: bool = False
    """Whether it is one of the healthy flights that others are compared with."""


def assess_motor_health(
    flights: Sequence[HealthFigures], baseline: Sequence[HealthFigures] | None = None
) -> tuple[HealthAssessment, ...]:
    """Assesses the motors in each flight of one vehicle against its healthy flights.

    A healthy flight is compared with the other healthy ones. Flights are assessed in the order of their dates, and the
    result of one flight is the prior of the next.

    Args:
        flights: Flights of one vehicle.
        baseline: Its healthy flights, from ``flights`` or others. By default they are its first sound flights
            (:func:`first_healthy_flights`). A flight that was logged twice counts once. Where there is but one such
            flight besides, the later of the two is compared with it.

    Returns:
        An assessment for each flight, in their order.
    """
    if baseline is None:
        healthy = first_healthy_flights(flights)
    else:
        healthy = named_healthy_flights(baseline)
    assessor = _FlightAssessor(healthy, flights, baseline)
    # Each assessment with the number of its flight, in the order of the dates.
    assessments: dict[int, HealthAssessment] = {}
    for number in sorted(range(len(flights)), key=lambda number: flights[number].start_time):
        assessments[number] = assessor.assess(flights[number])
    return tuple(
        assessments[number]._replace(is_healthy=flight in healthy)
        for number, flight in enumerate(flights)
    )


class _FlightAssessor:
    """Assesses the motors in the flights of one vehicle, one after the other in the order of their dates.

    The evidence of one flight is the prior of the next one with the same geometry of the motors.
    """

    def __init__(
        self,
        healthy: HealthFlights,
        flights: Sequence[HealthFigures],
        baseline: Sequence[HealthFigures] | None,
    ) -> None:
        """Stores with which flights all others are compared; nothing is assessed yet.

        Args:
            healthy: Healthy flights of the vehicle.
            flights: All flights of the vehicle.
            baseline: The healthy flights that the user chose; None if they were chosen by default.
        """
        self._healthy = healthy
        self._is_baseline_chosen = baseline is not None
        self._candidate_flights = flights if baseline is None else baseline
        # Evidence of the latest flight, by the geometry of its motors.
        self._latest_evidence: dict[object, FlightEvidence] = {}

    def assess(self, flight: HealthFigures) -> HealthAssessment:
        """Assesses the next flight by comparison with the healthy ones.

        Args:
            flight: The flight; none before it has a later date.
        """
        comparable_flights = [
            healthy_flight
            for healthy_flight in self._healthy
            if is_comparable(flight, healthy_flight)
        ]
        # Figures of every fact about the flight.
        comparison: JsonValues = {
            "flights": len(comparable_flights),
            "are_chosen": self._is_baseline_chosen,
        }
        if not self._is_baseline_chosen and len(comparable_flights) < MIN_HEALTHY_FLIGHTS:
            # The earlier one of two flights counts as the healthy one, if nobody has named one.
            comparable_flights = _flights_before(comparable_flights, flight)
        unknown_reason = _unknown_reason(
            flight, comparable_flights, self._candidate_flights, comparison
        )
        if unknown_reason is not None:
            return HealthAssessment(MotorHealth.UNKNOWN, unknown_reason)
        evidence = self._compare_with_healthy_flights(flight, comparable_flights)
        assessment = _assessment_of_evidence(flight, evidence, comparison)
        if assessment.health is MotorHealth.OK and len(comparable_flights) < MIN_HEALTHY_FLIGHTS:
            # One flight shows a fault, but not by how much healthy flights differ, and so not that there is none. How
            # probable a fault is stays known: `mavdem diff` of these two flights states it.
            reason = _too_few_healthy_flights(flight, self._candidate_flights, comparison)
            return assessment._replace(health=MotorHealth.UNKNOWN, fact=reason)
        return assessment

    def _compare_with_healthy_flights(
        self, flight: HealthFigures, comparable_flights: HealthFlights
    ) -> FlightEvidence:
        """Returns the evidence of a change of the motors in a flight, by comparison with healthy flights.

        The evidence of the flight before is its prior, since a change probably persists. Healthy flights are no part of
        this sequence, and neither is a flight without a date, whose place in it is unknown.

        Args:
            flight: The flight to compare.
            comparable_flights: Healthy flights with the same geometry of the motors.
        """
        is_healthy = any(is_same_flight(flight, other) for other in self._healthy)
        if is_healthy or flight.date is None:
            return flight_evidence(flight, comparable_flights, previous=None)
        previous = self._latest_evidence.get(flight.geometry_key)
        evidence = flight_evidence(flight, comparable_flights, previous)
        self._latest_evidence[flight.geometry_key] = evidence
        return evidence


def _flights_before(flights: HealthFlights, flight: HealthFigures) -> list[HealthFigures]:
    """Returns the flights that are known to be earlier than another one; none where its date is not known."""
    if flight.date is None:
        return []
    return [other for other in flights if other.start_time < flight.start_time]


def _unknown_reason(
    flight: HealthFigures,
    comparable_flights: HealthFlights,
    candidate_flights: HealthFlights,
    comparison: JsonValues,
) -> Fact | None:
    """Returns the reason why the motors of a flight cannot be judged by comparison with healthy flights.

    Args:
        flight: The flight that is judged. If how evenly its motors work was not measured, its ``missing`` states why.
        comparable_flights: Healthy flights to compare it with: those with the same geometry of the motors.
        candidate_flights: All flights from which the healthy ones were chosen.
        comparison: Figures of the fact about too few flights: the number of ``flights`` to compare with, and whether
            the user chose them (``are_chosen``).

    Returns:
        The reason, as a fact (a code with figures): what the flight lacks, or that there are too few healthy flights.
        None if the motors can be judged.
    """
    balance_was_measured = flight.missing is None
    if not balance_was_measured:
        return flight.missing
    if len(comparable_flights) < MIN_BASELINE_FLIGHTS:
        return _too_few_healthy_flights(flight, candidate_flights, comparison)
    return None


def _too_few_healthy_flights(
    flight: HealthFigures, candidate_flights: HealthFlights, comparison: JsonValues
) -> Fact:
    """Returns the fact (coded finding) that there are too few healthy flights to compare a flight with.

    Args:
        flight: The flight that is judged, which is not counted itself.
        candidate_flights: All flights from which the healthy ones were chosen.
        comparison: Figures of the fact: the number of healthy ``flights`` to compare with, and whether the user chose
            them (``are_chosen``).

    Returns:
        The fact. Its further figures are ``total``, the number of the other candidates, and ``needed``, the number of
        healthy flights that a comparison needs.
    """
    other_candidates = [candidate for candidate in candidate_flights if candidate is not flight]
    return Fact(
        HealthUnknown.HEALTHY_FLIGHTS_FEW,
        **comparison,
        total=len(other_candidates),
        needed=MIN_HEALTHY_FLIGHTS,
    )


def _assessment_of_evidence(
    flight: HealthFigures, evidence: FlightEvidence, comparison: JsonValues
) -> HealthAssessment:
    """Turns the evidence of a flight into an assessment: fault, drift, unknown or OK, tested in this order.

    1. Fault: one motor is weak, with a probability so high that it is named (:func:`_weak_motor`).
    2. Drift: one motor is weak, or anything else changed, of balance or effort, with a probability of at least
       ``MIN_REPORTED_PROBABILITY``, or the balance lies outside of nearly all healthy flights'.
    3. Unknown: the balance is so imprecise that a weak motor would not have been found.
    4. OK: nothing changed, and a weak motor would have been found.

    Args:
        flight: Measured motor balance of the flight, and the names of its motors.
        evidence: Its comparison with healthy flights.
        comparison: Values that every fact contains: the number of healthy flights, and whether the user chose them.

    Returns:
        The health, with its fact and probabilities.
    """
    change = evidence.change
    change_probability = evidence.change_probability
    if change.fault_probability >= MIN_REPORTED_PROBABILITY:
        return _weak_motor(flight, change, change_probability, comparison)
    suspect_motor = None
    if evidence.is_changed:
        health = MotorHealth.DRIFT
        fact = _drift_fact(flight, evidence, change_probability, comparison)
        # A drift that a motor most likely explains names this motor as its subject.
        if fact.subject:
            # Motors are numbered from 1.
            suspect_motor = flight.motors.index(fact.subject) + 1
    elif not evidence.would_show_weak_motor:
        return HealthAssessment(MotorHealth.UNKNOWN, _imprecise_balance(evidence, comparison))
    else:
        health = MotorHealth.OK
        fact = Fact(MotorsBetween.MOTORS_UNCHANGED, probability=change_probability, **comparison)
    return HealthAssessment(
        health,
        fact=fact,
        fault_probability=change.fault_probability,
        change_probability=change_probability,
        suspect_motor=suspect_motor,
    )


def _imprecise_balance(evidence: FlightEvidence, comparison: JsonValues) -> Fact:
    """Returns the fact that the measured balance of a flight's motors is too imprecise to show a weak motor.

    A motor that lost thrust is commanded more. Only a rise of its command by ``DETECTABLE_RISE`` would have shown.

    Args:
        evidence: Deviation of the flight's balance from healthy flights, with the mixer of the vehicle.
        comparison: Values that every fact contains: the number of healthy flights, and whether the user chose them.

    Returns:
        A fact with the ``loss`` of thrust that may have been missed, as a fraction, and the ``usual`` deviations of
        healthy flights.
    """
    # The loss of thrust of each motor by which its command rises so far. With more than four motors, its neighbours
    # supply a part.
    undetected_losses = lost_thrust(DETECTABLE_RISE, evidence.hypotheses.signatures.own_rise_ratios)
    return Fact(
        HealthUnknown.HEALTH_UNSURE,
        loss=undetected_losses.max(),
        usual=evidence.deviation.usual_half_widths,
        **comparison,
    )


def _weak_motor(
    flight: HealthFigures,
    change: ChangeProbabilities,
    change_probability: float,
    comparison: JsonValues,
) -> HealthAssessment:
    """Returns the assessment of a flight in which one motor is probably weak: fault or drift.

    A motor that lost thrust is commanded more than in the healthy flights. The motor is named only if its conditional
    probability, given that some motor is weak, is at least ``MIN_NAMED_PROBABILITY``: to name a sound motor is the
    worse mistake. Compared with a single flight that nobody has named as healthy, a weak motor is never a fault: that
    flight may have been the worse one.

    Args:
        flight: Measured motor balance of the flight, the names of its motors, and the mixer of the vehicle.
        change: Posterior probability of each cause of a change: a weak motor by motor, a shifted load, and others.
        change_probability: Probability that the balance or the effort changed at all.
        comparison: Values that every fact contains: the number of healthy flights, and whether the user chose them.
    """
    assert flight.signatures is not None
    suspect = int(change.fault_probabilities.argmax())
    suspect_probability = change.fault_probabilities[suspect]
    is_named = suspect_probability >= MIN_NAMED_PROBABILITY * change.fault_probability
    # (3,) mean and ends of the 90 % interval of the rise of the suspect's command.
    command_rise = change.rises[:, suspect]
    is_comparison_reliable = (
        comparison["are_chosen"] or comparison["flights"] >= MIN_HEALTHY_FLIGHTS
    )
    is_probable = change.fault_probability >= MIN_FAULT_PROBABILITY
    if is_comparison_reliable and is_probable:
        health, level = MotorHealth.FAULT, Level.BAD
    else:
        health, level = MotorHealth.DRIFT, Level.WATCH
    fact = Fact(
        MotorsBetween.MOTOR_WEAK,
        level,
        subject=flight.motors[suspect] if is_named else "",
        probability=change.fault_probability,
        motor_probability=suspect_probability,
        rise=command_rise,
        loss=lost_thrust(command_rise, flight.signatures.own_rise_ratios[suspect]),
        **comparison,
    )
    return HealthAssessment(
        health,
        fact=fact,
        fault_probability=change.fault_probability,
        change_probability=change_probability,
        # Motors are numbered from 1.
        suspect_motor=suspect + 1 if is_named else None,
    )


def _drift_fact(
    flight: HealthFigures,
    evidence: FlightEvidence,
    change_probability: float,
    comparison: JsonValues,
) -> Fact:
    """Returns the fact about a flight that differs from the healthy ones, without a single motor being at fault.

    The balance (torque in roll, pitch and yaw relative to the thrust) and the effort (mean output times voltage) may
    have changed; the more probable change is reported. For a changed balance the likeliest cause is given
    (:func:`_balance_change`). If neither change is probable enough, the balance is reported as outside of nearly all
    healthy flights'.

    Args:
        flight: Measured motor balance of the flight, and the names of its motors.
        evidence: Deviation of the flight's balance and effort from healthy flights, and what may have caused it.
        change_probability: Probability that anything changed, 0 to 1.
        comparison: Values that every fact contains: the number of healthy flights, and whether the user chose them.

    Returns:
        The fact, with its figures: probabilities from 0 to 1, shifts of the balance relative to the mean command.
    """
    change = evidence.change
    effort = evidence.effort
    change_values: JsonValues = {
        "shift": evidence.deviation.change,
        "usual": evidence.deviation.usual_half_widths,
        **comparison,
    }
    if change_probability < MIN_REPORTED_PROBABILITY:
        return Fact(MotorsBetween.BALANCE_OUTSIDE, **change_values)
    balance_probability = 1 - change.unchanged_probability
    # The effort is not known in every flight.
    if effort is not None and effort.probability > balance_probability:
        return Fact(
            MotorsBetween.EFFORT_CHANGED,
            probability=change_probability,
            balance_probability=balance_probability,
            effort=effort.relative_change,
            **comparison,
        )
    return _balance_change(flight, change, change_probability, change_values)


def _balance_change(
    flight: HealthFigures,
    change: ChangeProbabilities,
    change_probability: float,
    further_values: JsonValues,
) -> Fact:
    """Returns the fact about a changed balance, with its likeliest cause.

    The cause is a weak motor, a shifted load, or another one. A cause that is less likely than not is not the cause to
    name: then the two likeliest are given, as undecided.

    Args:
        flight: Measured motor balance of the flight, and the names of its motors.
        change: Posterior probability of each cause of a change: a weak motor by motor, a shifted load, and others.
        change_probability: Probability that the balance or the effort changed at all.
        further_values: Further values of the fact: the change, the usual deviations, and the healthy flights.

    Returns:
        The fact, with the likeliest cause as ``explanation``, if it is undecided the second one as
        ``other_explanation``, the probability that any motor is the cause, and the mean and the ends of the 90 %
        interval of the rise of the likeliest motor's command, and of its loss of thrust. The motor is its subject if
        that is probable enough, or if the flight's own log suspects it.
    """
    motor = int(change.motor_probabilities.argmax())
    motor_probability = float(change.motor_probabilities[motor])
    any_motor_probability = change.group_probabilities[Explanation.MOTOR]
    # Motors are numbered from 1.
    is_suspected_by_log = flight.suspected_motor == motor + 1
    causes = _likeliest_causes(change, prefers_motor=is_suspected_by_log)
    explanation, *other_explanations = causes
    # A motor is named if it is probably this one, given that the cause is some motor.
    is_this_motor = motor_probability >= MIN_NAMED_PROBABILITY * any_motor_probability
    is_named = explanation is Explanation.MOTOR and (is_this_motor or is_suspected_by_log)
    if is_named:
        causes[Explanation.MOTOR] = motor_probability
    other_values: JsonValues = {}
    for other_explanation in other_explanations:
        other_values["other_explanation"] = other_explanation
        other_values["other_explanation_probability"] = causes[other_explanation]
    assert flight.signatures is not None
    rise = change.rises[:, motor]
    return Fact(
        MotorsBetween.BALANCE_CHANGED,
        subject=flight.motors[motor] if is_named else "",
        probability=change_probability,
        explanation=explanation,
        explanation_probability=causes[explanation],
        any_motor_probability=any_motor_probability,
        rise=rise,
        loss=lost_thrust(rise, flight.signatures.own_rise_ratios[motor]),
        **other_values,
        **further_values,
    )


def _likeliest_causes(
    change: ChangeProbabilities, *, prefers_motor: bool
) -> dict[Explanation, float]:
    """Returns the likeliest cause of a changed balance or, if it is less likely than not, the two likeliest ones.

    Args:
        change: Posterior probability of each cause.
        prefers_motor: Whether a weak motor is the first of two causes even if it is the less likely one.

    Returns:
        The probabilities of the causes, the likeliest first.
    """
    probabilities = {cause: float(change.group_probabilities[cause]) for cause in Explanation}
    ranked_causes = sorted(Explanation, key=lambda cause: probabilities[cause], reverse=True)
    if probabilities[ranked_causes[0]] >= MIN_REPORTED_PROBABILITY:
        causes = ranked_causes[:1]
    else:
        causes = ranked_causes[:2]
    if prefers_motor:
        # The sort is stable: all other causes keep their order.
        causes.sort(key=lambda cause: cause is not Explanation.MOTOR)
    return {cause: probabilities[cause] for cause in causes}
