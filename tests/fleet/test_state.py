"""Two logs of one vehicle are judged beside each other, as a fleet of both judges them."""

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta

from pytest import mark

from mavdem.facts.motors import HealthUnknown
from mavdem.fleet.common_flights import separate_states
from mavdem.fleet.row import FlightRow
from mavdem.fleet.state import (
    VehicleState,
    motors_by_pair,
    rows_judged_by_each_other,
    rows_with_known_health,
    with_motors_judged,
)
from mavdem.fleet.tracking import assess_rows
from mavdem.ingest.telemetry import Telemetry

WEAK_MOTOR_1 = (-0.05, 0.05, 0.05)
"""Balance in roll, pitch and yaw where motor 1, at the front right, works 15 % harder."""


def state(day, vehicle="001a", balance=(0.0, 0.0, 0.0), vehicles=None):
    """Returns the state of a log with one flight of a quadrotor, by its board's serial number."""
    row = FlightRow(
        file=f"{day}.bin",
        key=str(day),
        vehicle=vehicle,
        vehicle_basis="board",
        date=datetime(2026, 5, day, tzinfo=UTC),
        axis="roll",
        duration=60.0,
        balance=balance,
        balance_error=(0.001,) * 3,
        balance_lean=(0.05, 0.0),
        lean_effect=(0.0,) * 6,
        lean_effect_error=(0.1,) * 6,
        motors=("motor 1", "motor 2", "motor 3", "motor 4"),
        positions=((1, 1), (-1, -1), (1, -1), (-1, 1)),
        spins=(1, 1, -1, -1),
        headline="Nothing wrong found.",
    )
    logs = [Telemetry(1, 1, "QUADROTOR", "ARDUPILOTMEGA", {})] if vehicles is None else vehicles
    return VehicleState([row], review={}, vehicles=logs)


def test_two_logs_have_the_health_that_a_fleet_of_both_has():
    """Motor 1 is weak in the second of two flights: the comparison of two logs says the same as a fleet."""
    before, after = state(1), state(2, balance=WEAK_MOTOR_1)
    judged_states = with_motors_judged(before, after)
    rows = [row for vehicle_state in judged_states for row in vehicle_state.rows]
    assert rows == assess_rows([*before.rows, *after.rows], [])
    assert [row.suspect_motor for row in rows] == [None, 1]
    assert rows[1].health == "drift" and "one flight before" in rows[1].health_reason
    # The order in which both are named changes nothing.
    swapped = with_motors_judged(after, before)
    assert [vehicle_state.rows[0].suspect_motor for vehicle_state in swapped] == [1, None]


def test_two_flights_of_a_fleet_are_judged_by_each_other_alone():
    """Motor 1 is weak in the last of three flights: the first and the last are judged as if there were no second."""
    before, between, after = state(1), state(2), state(3, balance=WEAK_MOTOR_1)
    in_fleet = assess_rows([*before.rows, *between.rows, *after.rows], [])
    alone = assess_rows([*before.rows, *after.rows], [])
    assert in_fleet[2].health_reason != alone[1].health_reason
    assert rows_judged_by_each_other(in_fleet[:1], in_fleet[2:]) == (alone[:1], alone[1:])
    # A library states the health by all flights first, and then what the two alone show, if that is something else.
    assert rows_with_known_health(in_fleet[2:], alone[1:]) == in_fleet[2:]
    assert rows_with_known_health(after.rows, alone[1:]) == alone[1:]
    assert motors_by_pair(in_fleet[2:], alone[1:]) == ""
    of_other_motor = [replace(alone[1], suspect_motor=2)]
    assert motors_by_pair(in_fleet[2:], of_other_motor) == alone[1].health_reason
    assert motors_by_pair(alone[1:], alone[1:]) == motors_by_pair([], []) == ""


def test_a_sound_flight_beside_a_single_one_has_a_probability_but_no_health():
    _, after = with_motors_judged(state(1), state(2))
    (row,) = after.rows
    assert (row.health, row.health_code) == ("unknown", HealthUnknown.HEALTHY_FLIGHTS_FEW)
    assert row.fault_probability < 0.1


def test_two_vehicles_are_left_as_they_are():
    weak = state(2, balance=WEAK_MOTOR_1)
    other_state = state(1, vehicle="002b")
    assert with_motors_judged(other_state, weak) == (other_state, weak)


def fleet(days, weak_days=()):
    """Returns the state of a fleet with a flight on each of these days, with a weak motor 1 on the weak ones."""
    rows = []
    for day in days:
        balance = WEAK_MOTOR_1 if day in weak_days else (0.0, 0.0, 0.0)
        rows += state(day, balance=balance).rows
    return VehicleState(assess_rows(rows, []), review={}, vehicles=(), fleet_rows=rows)


def healths(vehicle_state):
    """Returns the health of the motors in each flight of a state."""
    return [row.health for row in vehicle_state.rows]


@mark.slow
def test_a_fleet_that_is_weak_in_all_flights_is_not_taken_for_healthy_beside_an_older_log():
    """Three flights with an equally weak motor are sound beside each other alone, and one earlier flight shows it."""
    weak_fleet = fleet([2, 3, 4], weak_days=[2, 3, 4])
    assert healths(weak_fleet) == ["ok"] * 3
    before, after = with_motors_judged(state(1), weak_fleet)
    assert healths(before) == ["unknown"]
    assert {row.suspect_motor for row in after.rows} == {1}
    # Of the same fleet, flights of other days are judged beside those before them, too.
    whole = fleet([1, 2, 3, 4], weak_days=[3, 4])
    third = whole._replace(rows=whole.rows[2:3])
    fourth = whole._replace(rows=whole.rows[3:])
    for judged_state in with_motors_judged(third, fourth):
        assert judged_state.rows[0].suspect_motor == 1


def test_a_flight_of_both_states_counts_for_the_smaller_one():
    whole = fleet([1, 2, 3])
    last = whole._replace(rows=whole.rows[2:])
    separate = separate_states(whole, last)
    assert [row.key for row in separate.before.rows] == ["1", "2"]
    assert (separate.after, separate.common_files) == (last, ("3.bin",))
    assert (separate.counting_state, separate_states(last, whole).counting_state) == ("B", "A")
    # A second recording of the flight has another content and the same time.
    other = replace(whole.rows[2], key="other", date=whole.rows[2].date + timedelta(seconds=20))
    recording = last._replace(rows=[other])
    assert len(separate_states(whole, recording).before.rows) == 2
    both = separate_states(last, recording)
    assert (both.before, both.common_files, both.counting_state) == (last, ("3.bin",), "")
    assert separate_states(state(1), state(2)).common_files == ()


def test_a_fleet_has_the_gains_that_all_its_flights_share():
    """One gain was changed between two flights, and a third gain is in one of the logs alone."""
    gains = [
        {"ATC_RAT_RLL_P": 0.1, "ATC_RAT_PIT_P": 0.2, "ATC_RAT_YAW_P": 0.3},
        {"ATC_RAT_RLL_P": 0.1, "ATC_RAT_PIT_P": 0.25},
    ]
    rows = []
    for day, gains_of_flight in enumerate(gains, start=1):
        (row,) = state(day).rows
        rows.append(replace(row, control_parameters=json.dumps(gains_of_flight)))
    fleet = VehicleState(rows, review={}, vehicles=[])
    assert fleet.parameters == {"ATC_RAT_RLL_P": 0.1}
