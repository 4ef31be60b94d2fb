"""Assessments of the motors of made-up vehicles: their health, the named motor, and what is missing."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
from frames import geometry
from numpy.random import default_rng
from pytest import approx, mark

from mavdem.facts import Level
from mavdem.facts.motors import Explanation, HealthUnknown, MotorsBetween
from mavdem.motors.balance_figures import BalanceFigures
from mavdem.motors.change_hypotheses import (
    DETECTABLE_RISE,
    FAULT_RISE,
    ChangeHypotheses,
    ChangeProbabilities,
)
from mavdem.motors.deviation import Deviation
from mavdem.motors.health import MIN_REPORTED_PROBABILITY, _weak_motor, assess_motor_health
from mavdem.motors.healthy_flights import HealthFigures, distinct_flights, healthy_flights
from mavdem.motors.signatures import motor_signatures

VEHICLES = 40
MOTORS = geometry().names


QUAD_X = motor_signatures(geometry())
UNKNOWN = motor_signatures(geometry(positions=(), spins=()))
OFFSET = np.array([0.01, -0.02, 0.005])
LEAN_EFFECT = np.array([[0.9, 0.1], [-0.1, 0.8], [0.3, -0.2]])
COMPARED_WITH_ONE_CHOSEN_FLIGHT = {"flights": 1, "are_chosen": True}
ERROR = 0.003
EFFECT_ERROR = 0.15
FIRST_DATE = datetime(2026, 3, 1, tzinfo=UTC)


class MadeUpVehicle:
    """Flights differ by 0.008 in the balance on each axis, and lean by 3° and more in the wind of their day."""

    def __init__(self, seed):
        self.rng = default_rng(seed)
        self.flight_count = 0

    def flight(self, change=0.0):
        """A flight whose balance deviates by ``change`` (3,) from the healthy vehicle's."""
        rng = self.rng
        lean = rng.normal(scale=0.05, size=2)
        mean = OFFSET + rng.normal(scale=0.008, size=3) + change + LEAN_EFFECT @ lean
        effect = LEAN_EFFECT + rng.normal(scale=EFFECT_ERROR, size=(3, 2))
        errors = np.full(3, ERROR), lean, effect, np.full((3, 2), EFFECT_ERROR)
        balance = BalanceFigures(mean, *errors, 60.0)
        self.flight_count += 1
        date = FIRST_DATE + timedelta(days=self.flight_count)
        return HealthFigures(
            f"flight {self.flight_count}", MOTORS, QUAD_X, balance, date, 0.5, 11.0
        )

    def flights(self, count, change=0.0):
        return [self.flight(change) for _ in range(count)]


def weak_motor_change(motor, rise):
    """The change of the balance if the command of ``motor``, from 1, rises by the fraction ``rise``."""
    return rise * QUAD_X.weak_motor_balance[motor - 1, 1:]


def without_dates(flights):
    return [replace(flight, date=None) for flight in flights]


def healths(assessments):
    return [assessment.health for assessment in assessments]


def assessment_of(flight, baseline):
    (assessment,) = assess_motor_health([flight], baseline)
    return assessment


def assessments_of_vehicles(change, healthy=3, vehicles=VEHICLES):
    """Assessments of a flight of each vehicle, whose balance changed by ``change`` from its healthy flights."""
    assessments = []
    for seed in range(vehicles):
        vehicle = MadeUpVehicle(seed)
        flight = vehicle.flight(change)
        assessments.append(assessment_of(flight, baseline=vehicle.flights(healthy)))
    return assessments


@mark.parametrize("motor", [1, 2, 3, 4])
def test_a_weak_motor_is_found_and_named(motor):
    assessments = assessments_of_vehicles(weak_motor_change(motor, 0.2))
    is_reported = [
        assessment.fault_probability >= MIN_REPORTED_PROBABILITY for assessment in assessments
    ]
    assert np.mean(is_reported) > 0.8
    faults = [assessment for assessment in assessments if assessment.health == "fault"]
    assert {assessment.suspect_motor for assessment in faults} <= {motor, None}
    contains_rise = []
    for assessment in assessments:
        if assessment.suspect_motor is None:
            continue
        fact = assessment.fact
        assert (fact.code, fact.subject) == (MotorsBetween.MOTOR_WEAK, MOTORS[motor - 1])
        _, low, high = fact.figures["rise"]
        contains_rise.append(low <= 0.2 <= high)
        assert fact.figures["probability"] == assessment.fault_probability
        assert fact.figures["motor_probability"] <= assessment.fault_probability
    assert np.mean(contains_rise) > 0.8


@mark.parametrize(
    "probability, health, level", [(0.81, "fault", Level.BAD), (0.79, "drift", Level.WATCH)]
)
def test_a_weak_motor_is_a_fault_from_four_fifths_of_probability(probability, health, level):
    faults = probability * np.array([0.0, 1.0, 0.0, 0.0])
    unchanged = {"healthy": 1 - probability}
    change = ChangeProbabilities(unchanged, faults, faults, np.zeros((3, 4)), np.zeros(1))
    assessment = _weak_motor(
        MadeUpVehicle(1).flight(), change, probability, COMPARED_WITH_ONE_CHOSEN_FLIGHT
    )
    assert (assessment.health, assessment.fact.level) == (health, level)
    assert assessment.suspect_motor == 2


@mark.parametrize("share, suspect", [(0.81, 2), (0.79, None)])
def test_a_motor_is_named_from_four_fifths_of_the_probability_of_a_fault(share, suspect):
    fault_probability = 0.9
    faults = fault_probability * np.array([1 - share, share, 0.0, 0.0])
    change = ChangeProbabilities({"healthy": 0.1}, faults, faults, np.zeros((3, 4)), np.zeros(1))
    assessment = _weak_motor(
        MadeUpVehicle(1).flight(), change, fault_probability, COMPARED_WITH_ONE_CHOSEN_FLIGHT
    )
    assert assessment.suspect_motor == suspect
    assert assessment.fact.subject == ("" if suspect is None else MOTORS[suspect - 1])


def test_a_fault_among_the_first_flights_is_not_taken_for_healthy():
    vehicle = MadeUpVehicle(3)
    cut = weak_motor_change(2, 0.4)
    flights = [*vehicle.flights(2), vehicle.flight(cut), *vehicle.flights(3), vehicle.flight(cut)]
    assessments = assess_motor_health(flights)
    assert healths(assessments) == ["ok", "ok", "fault", "ok", "ok", "ok", "fault"]
    # The healthy flights are the first three without the fault, as if the user had chosen them.
    with_chosen_baseline = assess_motor_health(flights, [*flights[:2], flights[3]])
    for assessment, other_assessment in zip(assessments, with_chosen_baseline, strict=True):
        assert assessment.fault_probability == other_assessment.fault_probability


def test_a_flight_without_a_fault_is_not_taken_for_healthy_again():
    vehicle = MadeUpVehicle(40)
    first_flights = [vehicle.flight(), vehicle.flight(weak_motor_change(2, 0.14))]
    assessments = assess_motor_health([*first_flights, *vehicle.flights(4)])
    assert assessments[1].health == "drift"
    is_healthy = [assessment.is_healthy for assessment in assessments]
    assert is_healthy == [True, False, True, True, False, False]


def test_a_flight_that_could_not_show_a_weak_motor_is_not_ok():
    vehicle = MadeUpVehicle(1)
    baseline = vehicle.flights(3)
    flight = vehicle.flight()
    lean = np.radians((20.0, 20.0))
    mean = flight.balance.mean + LEAN_EFFECT @ (lean - flight.balance.lean)
    leaning = flight.balance._replace(lean=lean, mean=mean, lean_effect_error=np.full((3, 2), 2.0))
    assessment = assessment_of(replace(flight, balance=leaning), baseline)
    assert (assessment.health, assessment.fault_probability) == ("unknown", None)
    assert assessment.fact.code is HealthUnknown.HEALTH_UNSURE
    assert assessment.fact.figures["loss"] == approx(1 - 1.2**-2)


@mark.parametrize(
    "change, explanation",
    [((0.08, -0.06, 0.0), Explanation.LOAD), ((0.0, 0.0, -0.07), Explanation.YAW)],
)
def test_a_change_that_no_weak_motor_causes_is_a_drift_and_names_none(change, explanation):
    assessments = assessments_of_vehicles(np.array(change), healthy=4)
    assert healths(assessments).count("fault") <= 0.05 * VEHICLES
    assert healths(assessments).count("drift") > 0.8 * VEHICLES
    explanations = [assessment.fact.figures.get("explanation") for assessment in assessments]
    assert explanations.count(explanation) > 0.8 * VEHICLES
    # However large the change is.
    assessments_of_large_changes = assessments_of_vehicles(5 * np.array(change), vehicles=5)
    assert set(healths(assessments_of_large_changes)) == {"drift"}


def test_a_repair_ends_the_fault():
    vehicle = MadeUpVehicle(5)
    baseline = vehicle.flights(4)
    faulty_flights = vehicle.flights(3, weak_motor_change(1, 0.25))
    assessments = assess_motor_health([*faulty_flights, *vehicle.flights(2)], baseline)
    assert healths(assessments) == ["fault", "fault", "fault", "ok", "ok"]


def test_flights_are_judged_in_order_of_date_and_without_dates_each_alone():
    vehicle = MadeUpVehicle(7)
    baseline = vehicle.flights(3)
    flights = vehicle.flights(5, weak_motor_change(3, 0.12))
    assert (
        assess_motor_health(flights, baseline) == assess_motor_health(flights[::-1], baseline)[::-1]
    )
    undated_flights = without_dates(flights)
    each_alone = tuple(assessment_of(flight, baseline) for flight in undated_flights)
    assert assess_motor_health(undated_flights, baseline) == each_alone


def test_without_a_choice_the_first_flights_are_the_healthy_ones_and_the_fact_says_so():
    vehicle = MadeUpVehicle(11)
    flights = [*vehicle.flights(3), *vehicle.flights(2, weak_motor_change(1, 0.25))]
    assessments = assess_motor_health(flights)
    assert healths(assessments) == ["ok", "ok", "ok", "fault", "fault"]
    assert not assessments[-1].fact.figures["are_chosen"]
    # Without dates it is not known which flights were first.
    assert set(healths(assess_motor_health(without_dates(flights)))) == {"unknown"}
    with_undated_flight = assess_motor_health([*flights, *without_dates(vehicle.flights(1))])
    assert healths(with_undated_flight)[:5] == healths(assessments)


def test_first_flights_that_are_not_sound_are_not_taken_for_healthy():
    vehicle = MadeUpVehicle(11)
    unsound = [
        replace(flight, sound=False) for flight in vehicle.flights(2, weak_motor_change(2, 0.3))
    ]
    sound = vehicle.flights(3)
    flights = [*unsound, *sound]
    assert healths(assess_motor_health(flights))[2:] == ["ok"] * 3
    assert [*healthy_flights(flights)] == sound
    for assessment in assess_motor_health(unsound):
        assert assessment.fact.code is HealthUnknown.HEALTHY_FLIGHTS_FEW


def test_more_effort_is_a_drift_and_no_fault():
    vehicle = MadeUpVehicle(3)
    baseline = vehicle.flights(3)
    flights = [replace(vehicle.flight(), collective=0.5 * ratio) for ratio in (1.0, 1.02, 1.12)]
    assessments = [assessment_of(flight, baseline) for flight in flights]
    assert healths(assessments) == ["ok", "ok", "drift"]
    assert assessments[-1].fact.code is MotorsBetween.EFFORT_CHANGED
    assert assessments[-1].fact.figures["effort"] == approx(0.12, abs=0.005)
    assert max(assessment.fault_probability for assessment in assessments) < 0.1
    # The effort is the mean output times the voltage, and not known without the voltage.
    assert assessment_of(replace(flights[-1], voltage=None), baseline).health == "ok"


def test_a_single_chosen_healthy_flight_suffices_for_a_fault_but_not_for_ok():
    """How much flights differ is then given by the prior alone."""
    (faulty,) = assessments_of_vehicles(weak_motor_change(2, 0.25), healthy=1, vehicles=1)
    assert faulty.suspect_motor == 2
    healths_without_fault = healths(assessments_of_vehicles(0.0, healthy=1))
    assert {*healths_without_fault} <= {"unknown", "drift"}
    assert healths_without_fault.count("drift") <= 2


def test_of_two_flights_the_later_is_compared_with_the_earlier_and_a_weak_motor_is_watched():
    second_healths = []
    suspect_motors = []
    for seed in range(VEHICLES):
        vehicle = MadeUpVehicle(seed)
        sound_flights = vehicle.flights(2)
        first, second = assess_motor_health(sound_flights)
        assert first.fact.code is HealthUnknown.HEALTHY_FLIGHTS_FEW
        assert "there is 1 other of this vehicle, and it takes 2" in str(first.fact)
        second_healths.append(second.health)
        faulty_flight = vehicle.flight(weak_motor_change(2, 0.25))
        _, later = assess_motor_health([sound_flights[0], faulty_flight])
        suspect_motors.append(later.suspect_motor)
        assert later.health in ("drift", "unknown")
    assert {*second_healths} <= {"unknown", "drift"} and second_healths.count("drift") <= 2
    assert {*suspect_motors} <= {2, None} and suspect_motors.count(2) > VEHICLES / 2
    assert later.fact.level is Level.WATCH
    assert "the vehicle's one flight before, taken for healthy" in str(later.fact)


def test_a_flight_is_judged_with_two_distinct_healthy_flights_of_the_same_motors():
    vehicle = MadeUpVehicle(1)
    first, second, flight = vehicle.flights(3)
    second_record = replace(first, name="from the ground", date=first.date + timedelta(seconds=20))
    other_spins = replace(second, signatures=motor_signatures(geometry(spins=(-1, -1, 1, 1))))
    three_motors = replace(second, motors=MOTORS[:3])
    insufficient = (
        [],
        [first],
        [first, second_record],
        [first, other_spins],
        [first, three_motors],
    )
    for earlier_flights in insufficient:
        assessment = assess_motor_health([*earlier_flights, flight])[-1]
        assert assessment.health == "unknown"
        assert assessment.suspect_motor is None
        # The probability of a fault is known with a single healthy flight, too.
        is_compared = assessment.fact.figures["flights"] > 0
        assert (assessment.fault_probability is not None) is is_compared
        assert not is_compared or assessment.fault_probability < 0.1
        assert assessment.fact.code is HealthUnknown.HEALTHY_FLIGHTS_FEW
    assert (assessment.fact.figures["total"], assessment.fact.figures["flights"]) == (2, 1)
    assert assess_motor_health([first, second, flight])[-1].health != "unknown"


def test_of_two_records_of_a_flight_the_more_accurate_one_is_kept():
    flight = MadeUpVehicle(1).flight()
    inaccurate_balance = flight.balance._replace(error=np.ones(3))
    inaccurate_record = replace(
        flight, date=flight.date + timedelta(seconds=20), balance=inaccurate_balance
    )
    assert distinct_flights([inaccurate_record, flight]) == [flight]


@mark.parametrize(
    "missing, code",
    [
        ({"balance": None}, HealthUnknown.BALANCE_UNKNOWN),
        ({"signatures": None}, HealthUnknown.BALANCE_UNKNOWN),
        ({"signatures": UNKNOWN}, HealthUnknown.GEOMETRY_UNKNOWN),
        (
            {"balance": MadeUpVehicle(1).flight().balance._replace(lean=np.full(2, np.nan))},
            HealthUnknown.LEAN_UNKNOWN,
        ),
    ],
)
def test_a_flight_that_lacks_a_measurement_is_unknown_and_the_fact_names_it(missing, code):
    vehicle = MadeUpVehicle(1)
    assessment = assessment_of(replace(vehicle.flight(), **missing), vehicle.flights(3))
    assert assessment.health == "unknown"
    assert assessment.fact.code is code


def certain_deviation(change, scale=0.002):
    """A deviation from healthy flights that usually deviate by ``scale`` (standard deviation) on each axis."""
    deviation = Deviation(change, np.full(3, 1.12 * scale), 1000.0)
    assert deviation.usual_half_widths == approx(1.842 * scale, rel=1e-3)
    return deviation


def test_a_motor_that_works_harder_by_more_than_the_limit_is_a_fault():
    hypotheses = ChangeHypotheses(QUAD_X)
    for excess, fault_probability in ((-0.02, 0.0), (0.02, 1.0)):
        deviation = certain_deviation(weak_motor_change(1, FAULT_RISE + excess))
        probabilities = hypotheses.cause_probabilities(deviation)
        assert probabilities.motor_probabilities[0] > 0.95
        assert probabilities.fault_probability == approx(fault_probability, abs=0.05)


def test_a_change_far_from_the_pattern_of_a_motor_is_not_caused_by_it():
    hypotheses = ChangeHypotheses(QUAD_X)
    scale = 0.002
    yaw = np.array([0.0, 0.0, scale])
    near_pattern = certain_deviation(weak_motor_change(1, 0.2) + 2.8 * yaw, scale)
    assert hypotheses.cause_probabilities(near_pattern).motor_probabilities[0] > 0.9
    far_from_pattern = certain_deviation(weak_motor_change(1, 0.2) + 9.5 * yaw, scale)
    assert hypotheses.cause_probabilities(far_from_pattern).motor_probabilities.sum() == 0


def test_only_an_accurate_balance_would_show_a_weak_motor():
    hypotheses = ChangeHypotheses(QUAD_X)
    accurate = certain_deviation(np.zeros(3))
    assert hypotheses.detection_probability(accurate) > 0.99 > DETECTABLE_RISE
    inaccurate = certain_deviation(np.zeros(3), DETECTABLE_RISE / 2)
    assert hypotheses.detection_probability(inaccurate) < MIN_REPORTED_PROBABILITY


def test_a_fault_of_the_flight_before_may_have_been_repaired():
    hypotheses = ChangeHypotheses(QUAD_X)
    # After the flight before, one hypothesis of a weak motor was certain.
    certain_fault = np.eye(len(hypotheses.prior))[hypotheses.groups["motor"].start]
    # The balance of this flight is so inaccurate that it shows nothing.
    inaccurate = certain_deviation(np.zeros(3), 100.0)
    probabilities = hypotheses.cause_probabilities(inaccurate, certain_fault)
    assert probabilities.motor_probabilities.sum() == approx(0.55, abs=0.01)
