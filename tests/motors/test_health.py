"""Assessments of made-up vehicles: what is found, what is named, and what is missing."""

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
        balance = BalanceFigures(mean, *errors, 60.0)
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
    (found,) = assess_motor_health([flight], baseline)
    return found


def judged_vehicles(change, healthy=3, vehicles=VEHICLES):
    """Of so many vehicles, each of which flew healthy flights and then one that is judged."""
    made = map(MadeUpVehicle, range(vehicles))
    return [judged(one.flight(change), one.flights(healthy)) for one in made]


@mark.parametrize("motor", [1, 2, 3, 4])
def test_a_weak_motor_is_found_and_named(motor):
    found = judged_vehicles(weak(motor, 0.2))
    assert np.mean([one.fault_probability >= MIN_REPORTED_PROBABILITY for one in found]) > 0.8
    assert {one.suspect_motor for one in found if one.health == "fault"} <= {motor, None}
    named = [one.fact for one in found if one.suspect_motor]
    rises = [fact.figures["rise"] for fact in named]
    assert np.mean([low <= 0.2 <= high for _, low, high in rises]) > 0.8
    assert {(fact.code, fact.subject) for fact in named} == {
        (MotorsBetween.MOTOR_WEAK, MOTORS[motor - 1])
    }
    for one in (one for one in found if one.suspect_motor):
        figures = one.fact.figures
        assert figures["motor_probability"] <= figures["probability"] == one.fault_probability


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


def test_a_fault_among_the_first_flights_is_not_taken_for_healthy():
    vehicle = MadeUpVehicle(3)
    cut = weak(2, 0.4)
    flights = [*vehicle.flights(2), vehicle.flight(cut), *vehicle.flights(3), vehicle.flight(cut)]
    found = assess_motor_health(flights)
    assert [one.health for one in found] == ["ok", "ok", "fault", "ok", "ok", "ok", "fault"]
    beside = assess_motor_health(flights, [*flights[:2], flights[3]])
    assert [one.fault_probability for one in found] == [one.fault_probability for one in beside]


def test_a_flight_without_a_fault_is_not_taken_for_healthy_again():
    vehicle = MadeUpVehicle(40)
    found = assess_motor_health(
        [vehicle.flight(), vehicle.flight(weak(2, 0.14)), *vehicle.flights(4)]
    )
    assert found[1].health == "drift"
    assert [one.is_healthy for one in found] == [True, False, True, True, False, False]


def test_a_flight_that_could_not_show_a_weak_motor_is_not_ok():
    vehicle = MadeUpVehicle(1)
    baseline = vehicle.flights(3)
    flight = vehicle.flight()
    lean = np.radians((20.0, 20.0))
    mean = flight.balance.mean + LEAN_EFFECT @ (lean - flight.balance.lean)
    leaning = flight.balance._replace(lean=lean, mean=mean, lean_effect_error=np.full((3, 2), 2.0))
    found = judged(replace(flight, balance=leaning), baseline)
    assert (found.health, found.fault_probability) == ("unknown", None)
    assert found.fact.code is HealthUnknown.HEALTH_UNSURE
    assert found.fact.figures["loss"] == approx(1 - 1.2**-2)


@mark.parametrize(
    "change, explanation",
    [((0.08, -0.06, 0.0), Explanation.LOAD), ((0.0, 0.0, -0.07), Explanation.YAW)],
)
def test_what_no_motor_does_is_a_drift_and_names_none(change, explanation):
    found = judged_vehicles(np.array(change), healthy=4)
    assert np.mean([one.health == "fault" for one in found]) <= 0.05
    assert np.mean([one.health == "drift" for one in found]) > 0.8
    explained = [one.fact.figures.get("explanation") for one in found]
    assert np.mean([one is explanation for one in explained]) > 0.8
    # Be it ever so large.
    large = judged_vehicles(5 * np.array(change), vehicles=5)
    assert {one.health for one in large} == {"drift"}


def test_a_repair_ends_the_fault():
    vehicle = MadeUpVehicle(5)
    baseline = vehicle.flights(4)
    found = assess_motor_health([*vehicle.flights(3, weak(1, 0.25)), *vehicle.flights(2)], baseline)
    assert [one.health for one in found] == ["fault", "fault", "fault", "ok", "ok"]


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


def test_without_a_choice_the_first_flights_are_taken_for_healthy_and_that_is_said():
    vehicle = MadeUpVehicle(11)
    flights = [*vehicle.flights(3), *vehicle.flights(2, weak(1, 0.25))]
    found = assess_motor_health(flights)
    assert [one.health for one in found] == ["ok", "ok", "ok", "fault", "fault"]
    assert not found[-1].fact.figures["are_chosen"]
    assert {one.health for one in assess_motor_health(undated(flights))} == {"unknown"}
    mixed = assess_motor_health([*flights, *undated(vehicle.flights(1))])
    assert [one.health for one in mixed[:5]] == [one.health for one in found]


def test_first_flights_that_are_not_sound_are_not_taken_for_healthy():
    vehicle = MadeUpVehicle(11)
    unsound = [replace(flight, sound=False) for flight in vehicle.flights(2, weak(2, 0.3))]
    sound = vehicle.flights(3)
    flights = [*unsound, *sound]
    assert [one.health for one in assess_motor_health(flights)][2:] == ["ok"] * 3
    assert [*healthy_flights(flights)] == sound
    assert {one.fact.code for one in assess_motor_health(unsound)} == {
        HealthUnknown.HEALTHY_FLIGHTS_FEW
    }


def test_more_effort_is_a_drift_and_no_fault():
    vehicle = MadeUpVehicle(3)
    baseline = vehicle.flights(3)
    heavy = [replace(vehicle.flight(), collective=0.5 * more) for more in (1.0, 1.02, 1.12)]
    found = [judged(flight, baseline) for flight in heavy]
    assert [one.health for one in found] == ["ok", "ok", "drift"]
    assert found[-1].fact.code is MotorsBetween.EFFORT_CHANGED
    assert found[-1].fact.figures["effort"] == approx(0.12, abs=0.005)
    assert max(one.fault_probability for one in found) < 0.1
    assert judged(replace(heavy[-1], voltage=None), baseline).health == "ok"


def test_one_flight_that_somebody_named_as_healthy_shows_a_fault_but_excludes_none():
    """How much flights differ is then the prior alone."""
    assert judged_vehicles(weak(2, 0.25), healthy=1, vehicles=1)[0].suspect_motor == 2
    healths = [one.health for one in judged_vehicles(0.0, healthy=1)]
    assert {*healths} <= {"unknown", "drift"} and healths.count("drift") <= 2


def test_of_two_flights_the_later_is_compared_with_the_earlier_and_a_weak_motor_is_watched():
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


def test_it_takes_two_healthy_flights_of_the_same_motors_that_are_not_one():
    vehicle = MadeUpVehicle(1)
    once, other, flight = vehicle.flights(3)
    again = replace(once, name="from the ground", date=once.date + timedelta(seconds=20))
    turned = replace(other, signatures=motor_signatures(geometry(spins=(-1, -1, 1, 1))))
    three = replace(other, motors=MOTORS[:3])
    for others in ([], [once], [once, again], [once, turned], [once, three]):
        found = assess_motor_health([*others, flight])[-1]
        assert found.health == "unknown"
        assert found.suspect_motor is None
        # How probable a fault is is known beside a single flight, too.
        is_compared = found.fact.figures["flights"] > 0
        assert (found.fault_probability is not None) is is_compared
        assert not is_compared or found.fault_probability < 0.1
        assert found.fact.code is HealthUnknown.HEALTHY_FLIGHTS_FEW
    assert (found.fact.figures["total"], found.fact.figures["flights"]) == (2, 1)
    assert assess_motor_health([once, other, flight])[-1].health != "unknown"
    unsure = replace(again, balance=again.balance._replace(error=np.ones(3)))
    assert distinct_flights([unsure, once]) == [once]


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
    vehicle = MadeUpVehicle(1)
    found = judged(replace(vehicle.flight(), **missing), vehicle.flights(3))
    assert found.health == "unknown" and found.fact.code is code


def surely(change, scale=0.002):
    """A deviation of which flights and their mean show all but ``scale``."""
    found = Deviation(change, np.full(3, 1.12 * scale), 1000.0)
    assert found.usual_half_widths == approx(1.842 * scale, rel=1e-3)
    return found


def test_what_is_called_a_fault_begins_where_it_is_said_to():
    considered = ChangeHypotheses(QUAD_X)
    for more, fault in ((-0.02, 0.0), (0.02, 1.0)):
        found = considered.cause_probabilities(surely(weak(1, FAULT_RISE + more)))
        assert found.motor_probabilities[0] > 0.95 and found.fault_probability == approx(
            fault, abs=0.05
        )
    # Farther from a motor's pattern than so many scales it is no motor's, however much there is of it.
    aside = np.array([0.0, 0.0, 0.002])
    near, far = (
        considered.cause_probabilities(surely(weak(1, 0.2) + side * aside)) for side in (2.8, 9.5)
    )
    assert near.motor_probabilities[0] > 0.9 and far.motor_probabilities.sum() == 0
    # Who could not show a motor that works so much harder is not called healthy.
    assert considered.detection_probability(surely(np.zeros(3))) > 0.99 > DETECTABLE_RISE
    assert (
        considered.detection_probability(surely(np.zeros(3), DETECTABLE_RISE / 2))
        < MIN_REPORTED_PROBABILITY
    )
    # What held in one flight is no surer in the next than that it was seen and not put right.
    sure = np.eye(len(considered.prior))[considered.groups["motor"].start]
    unseen = considered.cause_probabilities(surely(np.zeros(3), 100.0), sure)
    assert unseen.motor_probabilities.sum() == approx(0.55, abs=0.01)
