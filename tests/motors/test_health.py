"""Assessments of made-up vehicles: what is found, what is named, and what is missing."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
from frames import geometry
from numpy.random import default_rng
from pytest import approx, mark, param

from mavdem.facts import Level
from mavdem.facts.motors import Explanation, HealthUnknown, MotorsBetween
from mavdem.motors.change_hypotheses import (
    DETECTABLE_RISE,
    FAULT_RISE,
    ChangeHypotheses,
    ChangeProbabilities,
)
from mavdem.motors.deviation import Deviation
from mavdem.motors.flight_evidence import MIN_REPORTED_PROBABILITY
from mavdem.motors.health import _balance_change, _weak_motor, assess_motor_health
from mavdem.motors.healthy_flight_choice import first_healthy_flights
from mavdem.motors.healthy_flights import HealthFigures, distinct_flights
from mavdem.motors.motor_balance import MotorBalance
from mavdem.motors.signatures import motor_signatures

VEHICLES = 40
MOTORS = geometry().names


QUAD_X = motor_signatures(geometry())
UNKNOWN = motor_signatures(geometry(positions=(), spins=()))
OFFSET = np.array([0.01, -0.02, 0.005])
LEAN_EFFECT = np.array([[0.9, 0.1], [-0.1, 0.8], [0.3, -0.2]])
OF_ONE_NAMED_FLIGHT = {"flights": 1, "are_chosen": True}
ERROR = 0.003
EFFECT_ERROR = 0.15
FIRST = datetime(2026, 3, 1, tzinfo=UTC)


class MadeUpVehicle:
    """Flights differ by 0.008 in the balance on each axis, and lean by 3° and more in the wind of their day."""

    def __init__(self, seed):
        self.rng = default_rng(seed)
        self.flown = 0

    def flight(self, change=0.0):
        """One of a vehicle whose balance changed by ``change`` (3,) from when it was healthy."""
        rng = self.rng
        lean = rng.normal(scale=0.05, size=2)
        mean = OFFSET + rng.normal(scale=0.008, size=3) + change + LEAN_EFFECT @ lean
        effect = LEAN_EFFECT + rng.normal(scale=EFFECT_ERROR, size=(3, 2))
        errors = np.full(3, ERROR), lean, effect, np.full((3, 2), EFFECT_ERROR)
        balance = MotorBalance(mean, *errors, 60.0)
        self.flown += 1
        when = FIRST + timedelta(days=self.flown)
        return HealthFigures(f"flight {self.flown}", MOTORS, QUAD_X, balance, when, 0.5, 11.0)

    def flights(self, count, change=0.0):
        return [self.flight(change) for _ in range(count)]


def weak(motor, harder):
    """The change of the balance where ``motor``, from 1, must work ``harder``."""
    return harder * QUAD_X.weak_motor_balance[motor - 1, 1:]


def undated(flights):
    return [replace(flight, date=None) for flight in flights]


def judged(flight, baseline):
    (assessments,) = assess_motor_health([flight], baseline)
    return assessments


def judged_vehicles(change, healthy=3, vehicles=VEHICLES):
    """Of so many vehicles, each of which flew healthy flights and then one that is judged."""
    made = map(MadeUpVehicle, range(vehicles))
    return [judged(assessment.flight(change), assessment.flights(healthy)) for assessment in made]


@mark.parametrize("motor", [1, *(param(motor, marks=mark.slow) for motor in (2, 3, 4))])
def test_a_weak_motor_is_found_and_named(motor):
    """One motor needs 20 % more command.

    In most of many simulated vehicles it is found, and no other motor is named.
    """
    assessments = judged_vehicles(weak(motor, 0.2))
    assert (
        np.mean(
            [assessment.fault_probability >= MIN_REPORTED_PROBABILITY for assessment in assessments]
        )
        > 0.8
    )
    assert {
        assessment.suspect_motor for assessment in assessments if assessment.health == "fault"
    } <= {motor, None}
    named = [assessment.fact for assessment in assessments if assessment.suspect_motor]
    rises = [fact.figures["rise"] for fact in named]
    assert np.mean([low <= 0.2 <= high for _, low, high in rises]) > 0.8
    assert {fact.subject for fact in named} == {MOTORS[motor - 1]}
    for assessment in assessments:
        if assessment.fact.code is not MotorsBetween.MOTOR_WEAK:
            continue
        figures = assessment.fact.figures
        assert (
            figures["motor_probability"] <= figures["probability"] == assessment.fault_probability
        )


@mark.parametrize(
    "probability, health, level", [(0.81, "fault", Level.BAD), (0.79, "drift", Level.WATCH)]
)
def test_a_weak_motor_is_a_fault_from_four_fifths_of_probability(probability, health, level):
    faults = probability * np.array([0.0, 1.0, 0.0, 0.0])
    unchanged = {"healthy": 1 - probability}
    change = ChangeProbabilities(unchanged, faults, faults, np.zeros((3, 4)), np.zeros(1))
    assessment = _weak_motor(MadeUpVehicle(1).flight(), change, probability, OF_ONE_NAMED_FLIGHT)
    assert (assessment.health, assessment.fact.level) == (health, level)
    assert assessment.suspect_motor == 2


@mark.parametrize("share, suspect", [(0.81, 2), (0.79, None)])
def test_a_motor_is_named_from_four_fifths_of_the_probability_of_a_fault(share, suspect):
    fault_probability = 0.9
    faults = fault_probability * np.array([1 - share, share, 0.0, 0.0])
    change = ChangeProbabilities({"healthy": 0.1}, faults, faults, np.zeros((3, 4)), np.zeros(1))
    assessment = _weak_motor(
        MadeUpVehicle(1).flight(), change, fault_probability, OF_ONE_NAMED_FLIGHT
    )
    assert assessment.suspect_motor == suspect
    assert assessment.fact.subject == ("" if suspect is None else MOTORS[suspect - 1])


@mark.slow
def test_the_healthy_flights_end_at_the_first_fault():
    """Motor 2 is weak in the third and in the last of seven flights; no flight after the third is taken for healthy."""
    vehicle = MadeUpVehicle(3)
    weak_motor = weak(2, 0.4)
    flights = [
        *vehicle.flights(2),
        vehicle.flight(weak_motor),
        *vehicle.flights(3),
        vehicle.flight(weak_motor),
    ]
    assessments = assess_motor_health(flights)
    assert [assessment.health for assessment in assessments[2:]] == [
        "fault",
        "ok",
        "ok",
        "ok",
        "fault",
    ]
    assessments_with_baseline = assess_motor_health(flights, flights[:2])
    assert [assessment.fault_probability for assessment in assessments[2:]] == [
        assessment.fault_probability for assessment in assessments_with_baseline[2:]
    ]
    # The two healthy ones are each compared with one other alone, which excludes no fault.
    assert {assessment.health for assessment in assessments[:2]} == {"unknown"}
    # The healthy ones are found without an assessment of the others.
    assert first_healthy_flights(flights) == tuple(flights[:2])


def test_a_damaged_flight_does_not_hide_the_damage_of_another():
    """Damage does not heal by itself: after the second flight, which has a weak motor, none is taken for healthy."""
    vehicle = MadeUpVehicle(1)
    flights = [vehicle.flight(), *vehicle.flights(2, weak(1, 0.25))]
    assessments = assess_motor_health(flights)
    assert first_healthy_flights(flights) == (flights[0],)
    assert [assessment.health for assessment in assessments] == ["unknown", "drift", "drift"]
    assert [assessment.suspect_motor for assessment in assessments] == [None, 1, 1]
    reason = "2 of which do not count (no date, flown since the motors changed or one was suspect,"
    assert reason in str(assessments[0].fact)


def test_a_repair_begins_the_healthy_flights_again():
    """The motor that was weak in the first flight has its thrust again in the second one."""
    vehicle = MadeUpVehicle(1)
    flights = [vehicle.flight(weak(1, 0.4)), *vehicle.flights(2)]
    assert first_healthy_flights(flights) == tuple(flights[1:])


def test_the_healthy_flights_end_where_a_log_itself_speaks_of_damage():
    """A lost vehicle, or a motor that no log suspected before, ends them; a motor that all logs suspect does not."""
    flights = MadeUpVehicle(11).flights(3)
    for damage in (
        {"suspected_motor": 2},
        {"was_lost": True, "sound": False},
        {"suspected_motor": 2, "balance": None},
    ):
        damaged_flights = [flights[0], replace(flights[1], **damage), flights[2]]
        assert first_healthy_flights(damaged_flights) == (flights[0],)
    alike = [replace(flight, suspected_motor=2) for flight in flights]
    assert first_healthy_flights(alike) == tuple(alike)


def test_a_flight_that_could_not_show_a_weak_motor_is_not_ok():
    vehicle = MadeUpVehicle(1)
    baseline = vehicle.flights(3)
    flight = vehicle.flight()
    lean = np.radians((20.0, 20.0))
    mean = flight.balance.mean + LEAN_EFFECT @ (lean - flight.balance.lean)
    leaning = flight.balance._replace(lean=lean, mean=mean, lean_effect_error=np.full((3, 2), 2.0))
    assessments = judged(replace(flight, balance=leaning), baseline)
    assert (assessments.health, assessments.fault_probability) == ("unknown", None)
    assert assessments.fact.code is HealthUnknown.HEALTH_UNSURE
    assert assessments.fact.figures["loss"] == approx(1 - 1.2**-2)


@mark.slow
def test_a_drift_that_a_motor_most_likely_explains_names_it_with_its_loss():
    """A motor that needs 10 % more command is less than a probable fault in many vehicles; none names a sound one."""
    drifts = []
    for assessment in judged_vehicles(weak(2, 0.1)):
        if assessment.fact.code is MotorsBetween.BALANCE_CHANGED:
            drifts.append(assessment.fact)
            assert assessment.suspect_motor == (2 if assessment.fact.subject else None)
    assert len(drifts) >= 5
    assert {fact.subject for fact in drifts} <= {MOTORS[1], ""}
    named = [fact for fact in drifts if fact.subject]
    assert len(named) > len(drifts) / 2
    for fact in named:
        any_motor_probability = fact.figures["any_motor_probability"]
        assert any_motor_probability >= fact.figures["explanation_probability"]
        if any_motor_probability < MIN_REPORTED_PROBABILITY:
            assert f"{MOTORS[1].capitalize()} is weak (probability 0." in str(fact)
            continue
        # One verdict: the probability of any weak motor, then the likeliest one, which is a part of it.
        assert "a weak motor or propeller (probability 0." in str(fact)
        assert f"most likely {MOTORS[1].removesuffix(')')}; probability 0." in str(fact)


@mark.parametrize(
    "motor, load, suspected_by_log, subject, beginning",
    [
        (
            0.35,
            0.43,
            2,
            MOTORS[1],
            f"{MOTORS[1].capitalize()} is weak (probability 0.32), or the load moved or changed (0.43): not decided.",
        ),
        (
            0.35,
            0.43,
            None,
            "",
            "The load moved or changed (probability 0.43), or a motor or propeller is weak (0.35): not decided.",
        ),
        (
            0.2,
            0.6,
            2,
            "",
            "The balance of the motors changed, most likely by a load that moved or changed (probability 0.60).",
        ),
    ],
)
def test_a_cause_that_is_less_likely_than_not_is_not_said_to_be_the_most_likely(
    motor, load, suspected_by_log, subject, beginning
):
    """Then both causes are named, and first the motor that the log itself suspects."""
    groups = {
        "healthy": 0.9 - motor - load,
        "motor": motor,
        "load": load,
        "yaw": 0.05,
        "other": 0.05,
    }
    motors = motor * np.array([0.1, 0.9, 0.0, 0.0])
    change = ChangeProbabilities(groups, motors, motors, np.zeros((3, 4)), np.zeros(1))
    flight = replace(MadeUpVehicle(1).flight(), suspected_motor=suspected_by_log)
    further_values = {"shift": np.zeros(3), "usual": np.ones(3), **OF_ONE_NAMED_FLIGHT}
    fact = _balance_change(flight, change, 0.97, further_values)
    assert fact.subject == subject
    sentence = str(fact)
    assert sentence.startswith(beginning)


@mark.slow
@mark.parametrize(
    "change, explanation",
    [((0.08, -0.06, 0.0), Explanation.LOAD), ((0.0, 0.0, -0.07), Explanation.YAW)],
)
def test_what_no_motor_does_is_a_drift_and_names_none(change, explanation):
    """The balance changes as by a load or in yaw alone, however much."""
    assessments = judged_vehicles(np.array(change), healthy=4)
    assert np.mean([assessment.health == "fault" for assessment in assessments]) <= 0.05
    assert np.mean([assessment.health == "drift" for assessment in assessments]) > 0.8
    explained = [assessment.fact.figures.get("explanation") for assessment in assessments]
    assert np.mean([assessment is explanation for assessment in explained]) > 0.8
    # Be it ever so large.
    large = judged_vehicles(5 * np.array(change), vehicles=5)
    assert {assessment.health for assessment in large} == {"drift"}


def test_a_repair_ends_the_fault():
    vehicle = MadeUpVehicle(5)
    baseline = vehicle.flights(4)
    assessments = assess_motor_health(
        [*vehicle.flights(3, weak(1, 0.25)), *vehicle.flights(2)], baseline
    )
    assert [assessment.health for assessment in assessments] == [
        "fault",
        "fault",
        "fault",
        "ok",
        "ok",
    ]


@mark.slow
def test_flights_are_judged_in_order_of_date_and_without_dates_each_alone():
    vehicle = MadeUpVehicle(7)
    baseline = vehicle.flights(3)
    flights = vehicle.flights(5, weak(3, 0.12))
    assert (
        assess_motor_health(flights, baseline) == assess_motor_health(flights[::-1], baseline)[::-1]
    )
    alone = undated(flights)
    assert assess_motor_health(alone, baseline) == tuple(
        judged(flight, baseline) for flight in alone
    )


@mark.slow
def test_without_a_choice_the_first_flights_are_taken_for_healthy_and_that_is_said():
    """The user names no healthy flights: the first flights by date count as healthy."""
    vehicle = MadeUpVehicle(11)
    flights = [*vehicle.flights(3), *vehicle.flights(2, weak(1, 0.25))]
    assessments = assess_motor_health(flights)
    assert [assessment.health for assessment in assessments] == ["ok", "ok", "ok", "fault", "fault"]
    assert not assessments[-1].fact.figures["are_chosen"]
    assert {assessment.health for assessment in assess_motor_health(undated(flights))} == {
        "unknown"
    }
    mixed = assess_motor_health([*flights, *undated(vehicle.flights(1))])
    assert [assessment.health for assessment in mixed[:5]] == [
        assessment.health for assessment in assessments
    ]


def test_first_flights_that_are_not_sound_are_not_taken_for_healthy():
    vehicle = MadeUpVehicle(11)
    unsound = [replace(flight, sound=False) for flight in vehicle.flights(2, weak(2, 0.3))]
    sound = vehicle.flights(3)
    flights = [*unsound, *sound]
    assert [assessment.health for assessment in assess_motor_health(flights)][2:] == ["ok"] * 3
    assert [*first_healthy_flights(flights)] == sound
    assert {assessment.fact.code for assessment in assess_motor_health(unsound)} == {
        HealthUnknown.HEALTHY_FLIGHTS_FEW
    }


@mark.slow
def test_more_effort_is_a_drift_and_no_fault():
    """All motors work 2 % or 12 % harder at the same voltage."""
    vehicle = MadeUpVehicle(3)
    baseline = vehicle.flights(3)
    heavy = [replace(vehicle.flight(), collective=0.5 * more) for more in (1.0, 1.02, 1.12)]
    assessments = [judged(flight, baseline) for flight in heavy]
    assert [assessment.health for assessment in assessments] == ["ok", "ok", "drift"]
    assert assessments[-1].fact.code is MotorsBetween.EFFORT_CHANGED
    assert assessments[-1].fact.figures["effort"] == approx(0.12, abs=0.005)
    # What decides comes first, since a list of flights cuts the sentence.
    beginning, _, rest = str(assessments[-1].fact).partition(" (probability ")
    assert beginning == "All motors work 12 % harder than in 3 healthy flights"
    assert rest[4:].startswith("): check the load, then all propellers. Compared is")
    assert max(assessment.fault_probability for assessment in assessments) < 0.1
    assert judged(replace(heavy[-1], voltage=None), baseline).health == "ok"


@mark.slow
def test_one_flight_that_somebody_named_as_healthy_shows_a_fault_but_excludes_none():
    """How much flights differ is then the prior alone."""
    assert judged_vehicles(weak(2, 0.25), healthy=1, vehicles=1)[0].suspect_motor == 2
    healths = [assessment.health for assessment in judged_vehicles(0.0, healthy=1)]
    assert {*healths} <= {"unknown", "drift"} and healths.count("drift") <= 2


@mark.slow
def test_of_two_flights_the_later_is_compared_with_the_earlier_and_a_weak_motor_is_watched():
    """One earlier flight is too few for a fault, but a weak motor is named as a drift."""
    healths = []
    motors = []
    for seed in range(VEHICLES):
        vehicle = MadeUpVehicle(seed)
        sound = vehicle.flights(2)
        first, second = assess_motor_health(sound)
        assert first.fact.code is HealthUnknown.HEALTHY_FLIGHTS_FEW
        assert "there is 1 other of this vehicle, and it takes 2" in str(first.fact)
        healths.append(second.health)
        _, later = assess_motor_health([sound[0], vehicle.flight(weak(2, 0.25))])
        motors.append(later.suspect_motor)
        assert later.health in ("drift", "unknown")
    assert {*healths} <= {"unknown", "drift"} and healths.count("drift") <= 2
    assert {*motors} <= {2, None} and motors.count(2) > VEHICLES / 2
    assert later.fact.level is Level.WATCH
    assert "the vehicle's one flight before, taken for healthy" in str(later.fact)


@mark.slow
def test_it_takes_two_healthy_flights_of_the_same_motors_that_are_not_one():
    """Two logs of one flight count once, and flights with other motors do not count."""
    vehicle = MadeUpVehicle(1)
    first_flight, other, flight = vehicle.flights(3)
    second_log = replace(
        first_flight, name="from the ground", date=first_flight.date + timedelta(seconds=20)
    )
    with_other_spins = replace(other, signatures=motor_signatures(geometry(spins=(-1, -1, 1, 1))))
    with_three_motors = replace(other, motors=MOTORS[:3])
    for others in (
        [],
        [first_flight],
        [first_flight, second_log],
        [first_flight, with_other_spins],
        [first_flight, with_three_motors],
    ):
        assessments = assess_motor_health([*others, flight])[-1]
        assert assessments.health == "unknown"
        assert assessments.suspect_motor is None
        # How probable a fault is is known beside a single flight, too.
        is_compared = assessments.fact.figures["flights"] > 0
        assert (assessments.fault_probability is not None) is is_compared
        assert not is_compared or assessments.fault_probability < 0.1
        assert assessments.fact.code is HealthUnknown.HEALTHY_FLIGHTS_FEW
    assert (assessments.fact.figures["total"], assessments.fact.figures["flights"]) == (2, 1)
    assert assess_motor_health([first_flight, other, flight])[-1].health != "unknown"
    imprecise_log = replace(second_log, balance=second_log.balance._replace(error=np.ones(3)))
    assert distinct_flights([imprecise_log, first_flight]) == [first_flight]


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
def test_what_is_missing_is_said(missing, code):
    """The flight lacks its balance, its geometry or its lean."""
    vehicle = MadeUpVehicle(1)
    assessments = judged(replace(vehicle.flight(), **missing), vehicle.flights(3))
    assert assessments.health == "unknown" and assessments.fact.code is code


def surely(change, scale=0.002):
    """A deviation of which flights and their mean show all but ``scale``."""
    assessments = Deviation(change, np.full(3, 1.12 * scale), 1000.0)
    assert assessments.usual_half_widths == approx(1.842 * scale, rel=1e-3)
    return assessments


def test_what_is_called_a_fault_begins_where_it_is_said_to():
    """A rise just above ``FAULT_RISE`` is a fault, one just below it is none. Both are known without an error."""
    hypotheses = ChangeHypotheses(QUAD_X)
    for more, fault in ((-0.02, 0.0), (0.02, 1.0)):
        assessments = hypotheses.cause_probabilities(surely(weak(1, FAULT_RISE + more)))
        assert assessments.motor_probabilities[
            0
        ] > 0.95 and assessments.fault_probability == approx(fault, abs=0.05)
    # Farther from a motor's pattern than so many scales it is no motor's, however much there is of it.
    offset = np.array([0.0, 0.0, 0.002])
    near, far = (
        hypotheses.cause_probabilities(surely(weak(1, 0.2) + side * offset)) for side in (2.8, 9.5)
    )
    assert near.motor_probabilities[0] > 0.9 and far.motor_probabilities.sum() == 0
    # Who could not show a motor that works so much harder is not called healthy.
    assert hypotheses.detection_probability(surely(np.zeros(3))) > 0.99 > DETECTABLE_RISE
    assert (
        hypotheses.detection_probability(surely(np.zeros(3), DETECTABLE_RISE / 2))
        < MIN_REPORTED_PROBABILITY
    )
    # What held in one flight is no surer in the next than that it was seen and not put right.
    certain_weak_motor = np.eye(len(hypotheses.prior))[hypotheses.groups["motor"].start]
    next_flight = hypotheses.cause_probabilities(surely(np.zeros(3), 100.0), certain_weak_motor)
    assert next_flight.motor_probabilities.sum() == approx(0.55, abs=0.01)
