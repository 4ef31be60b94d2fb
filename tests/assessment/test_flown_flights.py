"""The flights of a log as a pilot counts them: flight time, distance over ground, height above the take-off."""

from dataclasses import replace

import numpy as np
from hover import ARMED, Hover, changed, columns, log_of, with_pulses
from pytest import approx, mark

from mavdem.assessment.assess import assess
from mavdem.assessment.flown_flights import (
    FlownFlight,
    flights_and_hops,
    flown_flights,
    largest_height,
    total_distance,
    total_time,
)
from mavdem.dataset.signals import Signals
from mavdem.report.review import review_title

HOVER = Hover(hovering=20.0)
SPEED = 3.0
"""m/s to the north, from take-off to landing."""


def run_on_the_ground(pause, outputs):
    """A hover that lands, and whose motors run for 20 s from ``pause`` s after that, at ``outputs`` (4,) µs."""
    time = np.arange(0.0, HOVER.landed + pause + 25.0, 0.02)
    has_landed = time >= HOVER.landed
    is_run = (time >= HOVER.landed + pause) & (time < HOVER.landed + pause + 20.0)
    noise = 3.0 * np.random.default_rng(2).standard_normal((len(time), 4))
    motors = np.where(is_run[:, None], outputs + noise, HOVER.motors(time))
    telemetry = with_pulses(HOVER.telemetry(time, time), motors.T)
    telemetry = changed(
        telemetry,
        "ATTITUDE",
        roll=np.where(has_landed, 0.1, HOVER.roll(time)),
        rollspeed=np.where(has_landed, 1e-3 * np.sin(90 * time), HOVER.roll_rate(time)),
    )
    beat = np.arange(0.0, time[-1], 1.0)
    is_armed = (beat >= 5.0) & (beat < time[-1] - 2.0)
    heartbeat = telemetry.messages["HEARTBEAT"]
    telemetry = changed(
        telemetry,
        "HEARTBEAT",
        **columns(
            beat,
            type=heartbeat["type"][0],
            autopilot=heartbeat["autopilot"][0],
            base_mode=np.where(is_armed, ARMED + 1, 1),
        ),
    )
    # The land detector takes running motors for a flight.
    is_running = (HOVER.motors(beat)[:, 0] > 1000) | (np.interp(beat, time, is_run) > 0)
    landed_state = np.where(is_running, 2, 1)
    return changed(telemetry, "EXTENDED_SYS_STATE", **columns(beat, landed_state=landed_state))


def flying_north(shift=0.0):
    """A hover that flies north at ``SPEED``, with noise of its position, which jumps by ``shift`` m at 20 s."""
    telemetry = HOVER.telemetry()
    time = HOVER.stamps(10.0)
    north = SPEED * np.clip(time, 6.0, HOVER.landed) + shift * (time > 20.0)
    noise = 0.1 * np.random.default_rng(1).standard_normal(len(time))
    height = np.cumsum(HOVER.climb(time)) / 10.0
    return changed(
        telemetry, "LOCAL_POSITION_NED", x=north, y=noise, z=-height, vz=-HOVER.climb(time)
    )


@mark.slow
def test_a_flight_has_time_distance_and_height():
    (flight,) = flown_flights(Signals(flying_north()))
    assert flight.start == approx(6.0, abs=1.0) and flight.end == approx(HOVER.landed, abs=1.0)
    assert flight.distance == approx(SPEED * flight.duration, rel=0.05)
    assert flight.height == approx(10.0, abs=1.0)


def test_a_flight_ends_at_the_landing_also_if_it_is_reported_late():
    telemetry = run_on_the_ground(0.0, np.full(4, 1320.0))
    (flight,) = flown_flights(Signals(telemetry))
    assert flight.end == approx(HOVER.landed, abs=1.5)


@mark.in_full
def test_a_vehicle_that_the_ground_holds_does_not_fly():
    telemetry = run_on_the_ground(10.0, np.array([1930.0, 1270.0, 1930.0, 1270.0]))
    (flight,) = flown_flights(Signals(telemetry))
    assert flight.end == approx(HOVER.landed, abs=1.5)
    assert "armed, " in review_title(assess(log_of(telemetry))).text


@mark.slow
def test_a_reset_of_the_position_is_no_distance():
    assert total_distance(flown_flights(Signals(flying_north(shift=500.0)))) == approx(
        total_distance(flown_flights(Signals(flying_north()))), abs=2 * SPEED
    )


@mark.slow
def test_a_flight_without_a_position_for_most_of_it_has_no_distance():
    telemetry = flying_north()
    time = telemetry.messages["LOCAL_POSITION_NED"]["time"]
    for lost_from, distance in ((20.0, None), (45.0, approx(SPEED * 39.0, rel=0.05))):
        (flight,) = flown_flights(
            Signals(changed(telemetry, "LOCAL_POSITION_NED", valid=time < lost_from))
        )
        assert flight.distance == distance


@mark.slow
def test_each_boot_has_its_flights_and_without_a_position_no_distance_is_known():
    telemetry = HOVER.telemetry(without=("LOCAL_POSITION_NED",))
    messages = {}
    for name, table in telemetry.messages.items():
        twice = {field: np.concatenate([values, values]) for field, values in table.items()}
        twice["boot"] = np.repeat([0, 1], len(table["time"]))
        messages[name] = twice
    flights = flown_flights(Signals(replace(telemetry, messages=messages)))
    assert [flight.boot for flight in flights] == [0, 1]
    assert total_distance(flights) is None and largest_height(flights) is None


def test_an_estimator_that_stays_at_its_origin_gives_no_distance():
    telemetry = changed(flying_north(), "LOCAL_POSITION_NED", x=0.0, y=0.0)
    assert total_distance(flown_flights(Signals(telemetry))) is None


@mark.slow
def test_an_estimator_that_assumes_a_standstill_gives_no_distance():
    """It integrates accelerations, so that its position moves; an unhealthy filter does not report that."""
    telemetry = flying_north()
    time = telemetry.messages["LOCAL_POSITION_NED"]["time"]
    velocity_and_height = 1 | 4 | 32
    until_unhealthy = np.where(time < 8.0, 128, 0)
    for standstill, is_known in ((128, False), (until_unhealthy, False), (0, True)):
        status = columns(time, flags=velocity_and_height | standstill)
        flights = flown_flights(Signals(changed(telemetry, "EKF_STATUS_REPORT", **status)))
        assert (total_distance(flights) is not None) is is_known


@mark.parametrize("disarmed_seconds, flight_count", [(3.0, 2), (1.0, 1)])
def test_a_vehicle_that_was_disarmed_has_landed_however_soon_it_flies_again(
    disarmed_seconds, flight_count
):
    """A land detector alone may be mistaken for a moment, and a single heartbeat may be wrong."""
    telemetry = HOVER.telemetry()
    beat = telemetry.messages["HEARTBEAT"]
    is_disarmed = (beat["time"] > 20.0) & (beat["time"] <= 20.0 + disarmed_seconds)
    telemetry = changed(
        telemetry, "HEARTBEAT", base_mode=np.where(is_disarmed, 1, beat["base_mode"])
    )
    assert len(flown_flights(Signals(telemetry))) == flight_count


@mark.slow
def test_a_short_time_just_off_the_ground_is_a_hop_and_no_flight():
    """The vehicle is in the air for some seconds, up to a height of 0.5 m or 4 m."""
    time = HOVER.stamps(10.0)
    beat = HOVER.stamps(2.0)
    for end, top, durations in ((9.0, 0.5, []), (9.0, 4.0, [2.0]), (14.0, 0.5, [7.0])):
        is_in_air = (beat > 6.0) & (beat < end)
        telemetry = changed(
            HOVER.telemetry(),
            "EXTENDED_SYS_STATE",
            **columns(beat, landed_state=np.where(is_in_air, 2, 1)),
        )
        height = top * ((time > 7.0) & (time < end))
        telemetry = changed(telemetry, "LOCAL_POSITION_NED", x=0 * time, y=0 * time, z=-height)
        flights = flown_flights(Signals(telemetry))
        assert [flight.duration for flight in flights] == approx(durations, abs=1.0)
        # A hop is time in the air too.
        assert total_time(flights_and_hops(Signals(telemetry))) == approx(end - 7.0, abs=1.0)


def test_a_flight_in_which_the_clock_jumps_by_more_than_a_day_has_no_time_in_the_air():
    before = FlownFlight(boot=0, start=10.0, end=70.0, distance=None, height=None)
    assert total_time([before, replace(before, start=100.0, end=130.0)]) == 90.0
    assert total_time([before, replace(before, start=100.0, end=1e7)]) is None
