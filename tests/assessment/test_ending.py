"""How flights end: losses of attitude, falls and limits by the motion, and what failed first, if that is clear."""

import re
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
from frames import QUAD, geometry
from hover import X_QUAD_PARAMETERS, Hover, changed, columns, only, pulses, with_pulses
from instrumented import stamps
from numpy.random import default_rng
from pytest import approx, mark

from mavdem.assessment.assess import loss_of_flight
from mavdem.assessment.ending import find_ending
from mavdem.assessment.failure_by_commands import is_first_at_limit, weak_motor
from mavdem.assessment.first_failure import first_failure
from mavdem.assessment.motion import motion_events
from mavdem.assessment.motor_failure import (
    _start_of_climb,
    failure_commands,
    raise_level_of_assumed_landings,
    with_evidence_of_cause,
)
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact, Level
from mavdem.facts.ending import Ending, FailedFirst, MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.witnesses import SensorFact
from mavdem.ingest.vocabulary import IN_AIR, ON_GROUND, attitude_target, quaternion
from mavdem.report.charts.plans import frame_plan
from mavdem.report.why import evidence_text
from mavdem.vibration.vibration_message import CLIPPING_FIELDS, LEVEL_FIELDS
from mavdem.witnesses.boot_sensors import BootSensors

FAILS = 30.0
NAMES = geometry().names
OPPOSITE = (1, 0, 3, 2)
ALL = slice(None)
RIGHT = (0.0, 1.0)
ASIDE = (0.3, 1.0)


def flight(rate=10.0):
    """A hover at 10 m whose setpoints, heights and clips are recorded."""
    telemetry = Hover(sway=0.0).telemetry(rate, rate, parameters=X_QUAD_PARAMETERS)
    time = stamps(telemetry, "ATTITUDE")
    level = quaternion(*3 * [0 * time])
    telemetry = changed(telemetry, "ATTITUDE_TARGET", **columns(time, **attitude_target(level)))
    position = telemetry.messages["LOCAL_POSITION_NED"]
    z = np.cumsum(position["vz"]) * 0.1
    telemetry = changed(telemetry, "LOCAL_POSITION_NED", x=0.0, y=0.0, vx=0.0, vy=0.0, z=z)
    return changed(
        telemetry, "VIBRATION", **columns(position["time"], **dict.fromkeys(CLIPPING_FIELDS, 0.0))
    )


def with_lean(telemetry, towards, angle, seconds):
    """Returns telemetry whose attitude leans from ``FAILS`` on, by an ``angle`` in degrees, for some seconds.

    ``towards`` is the direction of the lean, forward and right.
    """
    columns = telemetry.messages["ATTITUDE"]
    seconds_since_failure = columns["time"] - FAILS
    lean = (
        np.radians(angle)
        * np.clip(seconds_since_failure / 0.3, 0, 1)
        * (seconds_since_failure < seconds + 0.3)
    )
    roll, pitch = lean * towards[1], -lean * towards[0]
    rates = {
        "rollspeed": np.gradient(roll, columns["time"]),
        "pitchspeed": np.gradient(pitch, columns["time"]),
    }
    return changed(telemetry, "ATTITUDE", roll=roll, pitch=pitch, **rates)


def with_fall(telemetry, speed=9.0, braked=9.0):
    """Returns telemetry of a vehicle that falls from ``FAILS`` on with up to ``speed``, m/s, and then stops.

    Just before the stop it is no faster than ``braked``, m/s.
    """
    columns = telemetry.messages["LOCAL_POSITION_NED"]
    seconds_since_failure = columns["time"] - FAILS
    vz = np.interp(
        seconds_since_failure, [0, 1.8, 2, 2.01], [0, 0.9 * speed, min(speed, braked), 0]
    )
    return changed(telemetry, "LOCAL_POSITION_NED", vz=vz, z=columns["z"] + np.cumsum(vz) * 0.1)


def with_end_of_log(telemetry, seconds):
    """Returns telemetry that ends some seconds after ``FAILS``."""
    return only(telemetry, lambda time: time < FAILS + seconds)


def with_motor_output(telemetry, motor, output, start_time=FAILS):
    """Returns telemetry in which the output of one motor (from 0), or of several, is constant from a time on, µs."""
    outputs = pulses(telemetry)
    recorded = outputs[motor]
    is_driven = (stamps(telemetry, "SERVO_OUTPUT_RAW") >= start_time) & (recorded > 1000)
    outputs[motor] = np.where(is_driven, output, recorded)
    return with_pulses(telemetry, outputs)


def telemetry_of_lost_motor(motor, rate=10.0):
    """Returns telemetry in which a motor, from 0, loses its thrust: the vehicle leans to its side and falls.

    The controller drives this motor to its limit. When the vehicle lies on the ground, it drives the opposite one.
    """
    telemetry = with_fall(with_lean(flight(rate), QUAD[motor], 120.0, 100.0))
    telemetry = with_motor_output(
        with_motor_output(telemetry, motor, 2000.0), OPPOSITE[motor], 1100.0
    )
    return with_motor_output(telemetry, OPPOSITE[motor], 2000.0, FAILS + 3.0)


def events_and_ending(telemetry, *reported):
    """Returns the last event of each code, by its code, and the event with which the flight was lost."""
    signals = Signals(telemetry, inputs="motors")
    events = *motion_events(signals), *reported
    assert all(event.sentence for event in events)
    return {event.code: event for event in events}, find_ending(signals, events, 0.14)


@mark.slow
def test_a_motor_whose_number_is_assumed_is_named_with_that_remark():
    """Without parameters, the numbers of the motors are those of the usual frame."""
    telemetry = telemetry_of_lost_motor(1)
    _, known = events_and_ending(telemetry)
    _, assumed = events_and_ending(replace(telemetry, parameters={}))
    assert "(motor numbering assumed)" in assumed.sentence
    assert "assumed" not in known.sentence


@mark.slow
@mark.parametrize("rate", [10.0, 50.0])
@mark.parametrize("motor", range(4))
def test_a_loss_names_the_motor_on_the_side_of_the_fall_that_was_driven_hardest(motor, rate):
    events, ending = events_and_ending(telemetry_of_lost_motor(motor, rate))
    assert events[MotionEvent.ATTITUDE_LOST].figures["angle"] > np.radians(80)
    assert events[MotionEvent.FELL].figures["speed"] == approx(9.0, abs=0.5)
    assert events[MotionEvent.MOTOR_AT_ITS_STOP].subject == NAMES[motor]
    assert (ending.code, ending.level) == (Ending.CONTROL_LOST, Level.BAD)
    assert ending.time == approx(FAILS, abs=0.15)
    assert ending.figures["height"] == approx(10.0, abs=0.5)
    assert ending.figures["cause"].code is FailedFirst.LIMIT_FIRST
    assert ending.subject == ending.figures["cause"].subject == NAMES[motor]


@mark.slow
@mark.parametrize("motor", range(4))
def test_the_answer_of_the_motors_before_the_attitude_left_names_the_motor(motor):
    """A controller answers the rate, and once the attitude has left, it works against its own first answer."""
    telemetry = with_fall(with_lean(flight(50.0), QUAD[motor], 120.0, 100.0))
    neighbours = [
        other_motor for other_motor in range(4) if other_motor not in (motor, OPPOSITE[motor])
    ]
    telemetry = with_motor_output(telemetry, motor, 2000.0, FAILS - 0.1)
    telemetry = with_motor_output(telemetry, OPPOSITE[motor], 1100.0, FAILS - 0.1)
    telemetry = with_motor_output(telemetry, motor, 1300.0, FAILS + 0.05)
    telemetry = with_motor_output(telemetry, OPPOSITE[motor], 1300.0, FAILS + 0.05)
    telemetry = with_motor_output(telemetry, neighbours[0], 1900.0, FAILS + 0.05)
    _, ending = events_and_ending(telemetry)
    assert ending.figures["cause"].code is FailedFirst.LIMIT_FIRST
    assert ending.figures["cause"].time == approx(FAILS - 0.1, abs=0.03)
    assert ending.subject == NAMES[motor]


@mark.slow
@mark.parametrize(
    "output, code, words",
    [
        (2000.0, FailedFirst.LIMIT_FIRST, "was at its upper limit first"),
        (1890.0, FailedFirst.THRUST_MISSING_FIRST, "did not hold the vehicle, although it was commanded to 89 %"),
    ],
)  # fmt: skip
def test_a_motor_below_its_limit_was_not_there_first(output, code, words):
    _, ending = events_and_ending(with_motor_output(telemetry_of_lost_motor(1, 50.0), 1, output))
    assert (ending.figures["cause"].code, ending.subject) == (code, NAMES[1])
    assert f": {NAMES[1]} {words}." in str(ending)


def test_the_first_motor_at_its_limit_is_first():
    at_limit = np.array([[False, False], [False, True], [True, True]])
    assert [is_first_at_limit(at_limit, motor) for motor in (0, 1)] == [False, True]
    assert not is_first_at_limit(at_limit[:1], 0)


@mark.slow
def test_a_loss_names_no_motor_if_the_controller_overturned_or_swung_the_vehicle():
    assert (
        events_and_ending(with_lean(telemetry_of_lost_motor(1), QUAD[0], 120.0, 100.0))[1].subject
        == ""
    )
    swung = with_motor_output(
        with_motor_output(telemetry_of_lost_motor(1), 0, 2000.0, FAILS - 1.0), 0, 1100.0
    )
    assert events_and_ending(swung)[1].subject == ""


@mark.slow
def test_a_loss_names_no_motor_if_the_positions_of_motors_are_unknown():
    assert (
        events_and_ending(replace(telemetry_of_lost_motor(1), vehicle="HEXAROTOR", parameters={}))[
            1
        ].subject
        == ""
    )


def test_a_boot_without_motor_outputs_has_no_events_of_motors():
    assert not events_and_ending(changed(flight(), "SERVO_OUTPUT_RAW", boot=1))[0]


@mark.slow
def test_a_loss_names_the_motors_whose_output_is_off():
    telemetry = with_fall(with_lean(flight(), QUAD[2], 120.0, 100.0))
    telemetry = replace(
        telemetry, initial_parameters={"SERVO3_FUNCTION": 35.0, "SERVO9_FUNCTION": 0.0}
    )
    events, ending = events_and_ending(with_motor_output(telemetry, 2, 1000.0))
    assert events[MotionEvent.MOTOR_OFF].subject == ending.subject == NAMES[2]
    assert ending.figures["cause"].code is FailedFirst.MOTOR_OFF_FIRST
    assert "SERVO3_FUNCTION was set" in str(ending) and "propeller" not in ending.remedy
    _, ending = events_and_ending(with_motor_output(telemetry, [2, 3], 1000.0))
    assert ending.subject == ""
    assert ending.figures["cause"].figures["names"] == NAMES[2:]


def test_a_motor_is_off_where_the_others_carry_the_vehicle_on_little_of_their_range():
    """PX4's range begins at the idle in the air: this vehicle hovers at a sixth of it."""
    telemetry = with_motor_output(with_fall(with_lean(flight(), QUAD[2], 120.0, 100.0)), 2, 1000.0)
    parameters = {"PWM_MAIN_MIN": 1400.0, "PWM_MAIN_MAX": 2000.0}
    time = np.arange(0.0, 40.0, 0.2)
    state = np.where(time < 6.0, ON_GROUND, IN_AIR)
    telemetry = changed(telemetry, "EXTENDED_SYS_STATE", **columns(time, landed_state=state))
    events, _ = events_and_ending(replace(telemetry, autopilot="PX4", parameters=parameters))
    assert events[MotionEvent.MOTOR_OFF].subject.startswith("motor 3")


@mark.slow
def test_an_output_that_stands_still_is_no_weak_motor_on_the_other_side():
    """The output of motor 1 freezes a little below its mean in hover: too high, once the vehicle leans away from it."""
    telemetry = with_fall(with_lean(flight(50.0), QUAD[1], 120.0, 100.0))
    swings = 200.0 * np.sin(40.0 * stamps(telemetry, "SERVO_OUTPUT_RAW"))
    telemetry = with_pulses(telemetry, pulses(telemetry) + swings)
    _, ending = events_and_ending(
        with_motor_output(with_motor_output(telemetry, 1, 2000.0), 0, 1590.0)
    )
    assert ending.figures["cause"].code is FailedFirst.OUTPUT_FROZE_FIRST
    assert ending.subject == NAMES[0]


@mark.parametrize(
    "seconds, pulse, are_channels_known, is_frozen",
    [
        (1.5, 1650.0, True, False),
        (3.0, 1650.0, True, True),
        # The lowest pulse of all motors may be that of the idle, and other outputs may drive a gimbal.
        (3.0, 1300.0, True, False),
        (3.0, 1650.0, False, False),
    ],
)
def test_an_output_that_stands_still_in_flight_has_frozen(
    seconds, pulse, are_channels_known, is_frozen
):
    """The vehicle flies on, and the other outputs swing."""
    telemetry = flight(10.0)
    time = stamps(telemetry, "SERVO_OUTPUT_RAW")
    outputs = pulses(telemetry) + 100.0 * np.sin(7.0 * time)
    outputs[2] = np.where((time > FAILS) & (time < FAILS + seconds), pulse, outputs[2])
    telemetry = with_pulses(telemetry, outputs)
    if not are_channels_known:
        telemetry = replace(telemetry, parameters={}, initial_parameters={})
    events, ending = events_and_ending(telemetry)
    assert ending is None and (MotionEvent.OUTPUT_FROZE in events) == is_frozen
    if is_frozen:
        frozen = events[MotionEvent.OUTPUT_FROZE]
        assert (frozen.subject, frozen.level) == (NAMES[2], Level.BAD)
        assert frozen.time == approx(FAILS, abs=0.15)


@mark.slow
def test_a_loss_names_the_motor_whose_output_froze():
    telemetry = with_fall(with_lean(flight(50.0), QUAD[0], 120.0, 100.0))
    swings = 100.0 * np.sin(40.0 * stamps(telemetry, "SERVO_OUTPUT_RAW"))
    telemetry = with_pulses(telemetry, pulses(telemetry) + swings)
    telemetry = replace(telemetry, initial_parameters={"SERVO1_FUNCTION": 33.0})
    _, ending = events_and_ending(with_motor_output(telemetry, 0, 1500.0))
    assert ending.figures["cause"].code is FailedFirst.OUTPUT_FROZE_FIRST
    assert ending.subject == NAMES[0]
    assert "SERVO1_FUNCTION was set" in str(ending) and "propeller" not in ending.remedy


@mark.parametrize(
    "output, start_time, code",
    [
        (1100.0, FAILS, FailedFirst.ALL_OFF_FIRST),
        # A vehicle without power leaves its attitude a little later.
        (1100.0, FAILS - 0.6, FailedFirst.ALL_OFF_FIRST),
        (1910.0, FAILS - 3.0, FailedFirst.THRUST_SPENT_FIRST),
    ],
)
def test_a_loss_by_all_motors_together_names_no_motor(output, start_time, code):
    """All motors stop, or are at their upper limit, before the vehicle is lost."""
    telemetry = with_fall(with_lean(flight(), ASIDE, 120.0, 100.0))
    events, ending = events_and_ending(with_motor_output(telemetry, ALL, output, start_time))
    cause = ending.figures["cause"]
    assert cause.code is code and MotionEvent.LOG_ENDED_IN_AIR not in events
    assert ending.subject == "" and cause.figures.get("share", 1.0) > 0.9
    assert cause.time == approx(start_time, abs=0.15)


@mark.slow
def test_an_attitude_is_lost_beyond_30_degrees_for_three_tenths_of_a_second():
    for angle, seconds, is_caught in ((29.0, 2.0, False), (31.0, 2.0, True), (40.0, 0.1, False)):
        events, ending = events_and_ending(with_lean(flight(), RIGHT, angle, seconds))
        assert ending is None
        if is_caught:
            assert MotionEvent.ATTITUDE_CAUGHT in events
        else:
            assert MotionEvent.ATTITUDE_CAUGHT not in events


def test_a_setpoint_that_is_followed_is_no_loss():
    telemetry = flight()
    time = stamps(telemetry, "ATTITUDE")
    turns = np.clip((time - FAILS) / 2.0, 0, 1)
    roll = np.angle(np.exp(2j * np.pi * turns))
    telemetry = changed(telemetry, "ATTITUDE_TARGET", q=quaternion(roll, 0 * time, 0 * time))
    assert not events_and_ending(changed(telemetry, "ATTITUDE", roll=np.roll(roll, 3)))[0]


FLIP, LOITER = 14, 5
"""Flight modes of ArduCopter."""


@mark.parametrize("mode, is_flip", [(FLIP, True), (LOITER, False)])
def test_a_flip_that_the_vehicle_flies_on_from_explains_motors_at_their_limits(mode, is_flip):
    """The vehicle turns once about its roll axis in two seconds with a motor at its limit.

    This is good in the mode Flip, to be watched in another mode.
    """
    telemetry = changed(flight(), "HEARTBEAT", custom_mode=mode)
    time = stamps(telemetry, "ATTITUDE")
    roll = np.angle(np.exp(2j * np.pi * np.clip((time - FAILS) / 2.0, 0, 1)))
    telemetry = changed(telemetry, "ATTITUDE_TARGET", q=quaternion(roll, 0 * time, 0 * time))
    telemetry = changed(telemetry, "ATTITUDE", roll=np.roll(roll, 3))
    outputs = pulses(telemetry)
    motor_time = stamps(telemetry, "SERVO_OUTPUT_RAW")
    outputs[0, (motor_time > FAILS) & (motor_time < FAILS + 1.0)] = 2000.0
    events, ending = events_and_ending(with_pulses(telemetry, outputs))
    assert ending is None
    limited = events[MotionEvent.MOTOR_AT_ITS_STOP]
    assert limited.level is (Level.GOOD if is_flip else Level.WATCH)
    assert ("in a flip" in limited.sentence) is is_flip
    assert bool(limited.remedy) is not is_flip
    assert (MotionEvent.FLIPPED in events) is is_flip
    if is_flip:
        flip = events[MotionEvent.FLIPPED]
        assert np.degrees(flip.figures["angle"]) == approx(180.0, abs=5.0)
        assert "(mode Flip)" in flip.sentence


def telemetry_of_overturn(lead):
    """Returns telemetry of a flip into the ground, whose setpoint is some samples ahead of the vehicle."""
    telemetry = with_fall(flight())
    time = stamps(telemetry, "ATTITUDE")
    angle = np.radians(200.0) * np.clip((time - FAILS - 1.0) / 0.8, 0, 1)
    roll = np.angle(np.exp(1j * angle))
    setpoint = quaternion(np.roll(roll, -lead), 0 * time, 0 * time)
    telemetry = changed(telemetry, "ATTITUDE_TARGET", q=setpoint)
    return changed(telemetry, "ATTITUDE", roll=roll, rollspeed=np.gradient(angle, time))


@mark.parametrize("lead, is_commanded", [(1, True), (-1, False)])
def test_a_setpoint_that_turns_the_vehicle_over_is_what_failed_first(lead, is_commanded):
    signals = Signals(telemetry_of_overturn(lead), inputs="motors")
    loss = Fact(MotionEvent.HIT, Level.BAD, time=FAILS + 2.0, boot=0)
    cause = first_failure(signals, (), loss, None)
    if is_commanded:
        assert cause.code is FailedFirst.OVERTURN_COMMANDED_FIRST
        assert cause.time == approx(FAILS + 1.2, abs=0.15)
        assert np.degrees(cause.figures["angle"]) > 90.0
        assert "The setpoint itself turned the vehicle over" in cause.sentence
    else:
        assert cause is None


@mark.slow
def test_where_only_rates_are_asked_for_no_attitude_is_lost():
    telemetry = with_lean(flight(), RIGHT, 120.0, 100.0)
    rates = attitude_target(np.zeros((len(stamps(telemetry, "ATTITUDE")), 3)))
    assert not events_and_ending(changed(telemetry, "ATTITUDE_TARGET", **rates))[0]


@mark.slow
def test_without_setpoints_only_a_flight_that_ends_so_is_lost():
    telemetry = only(telemetry_of_lost_motor(1), lambda time: time < 0.0, "ATTITUDE_TARGET")
    assert events_and_ending(telemetry)[1].code is Ending.CONTROL_LOST
    caught = with_lean(telemetry, RIGHT, 70.0, 1.0)
    caught = changed(caught, "LOCAL_POSITION_NED", **flight().messages["LOCAL_POSITION_NED"])
    events, ending = events_and_ending(with_pulses(caught, pulses(flight())))
    assert events[MotionEvent.ATTITUDE_CAUGHT].level is Level.UNKNOWN
    assert ending is None


@mark.parametrize("highest, code", [(0.9, Ending.TIPPED_OVER), (1.1, Ending.CRASHED)])
def test_what_never_rose_tipped_over_at_take_off_and_names_none(highest, code):
    telemetry = telemetry_of_lost_motor(1)
    time = stamps(telemetry, "LOCAL_POSITION_NED")
    z = -highest * ((time > 20.0) & (time < 25.0))
    events, ending = events_and_ending(changed(telemetry, "LOCAL_POSITION_NED", z=z))
    assert (ending.code, ending.subject) == (code, "")
    if code is Ending.TIPPED_OVER:
        assert MotionEvent.TIPPED in events
    else:
        assert MotionEvent.TIPPED not in events
    assert ending.figures["speed"] is not None


@mark.parametrize("height", [0.9, 2.5])
def test_what_topples_in_a_landing_falls_no_further(height):
    """The vehicle topples 0.9 m or 2.5 m above the ground: only the higher one is a fall."""
    telemetry = telemetry_of_lost_motor(1)
    time = stamps(telemetry, "LOCAL_POSITION_NED")
    z = np.select([time < 20.0, time < FAILS - 1.0], [0.0, -3.0], -height)
    vz = 8.0 * (time > FAILS + 1.0)
    z += np.cumsum(vz) * 0.1
    events, ending = events_and_ending(changed(telemetry, "LOCAL_POSITION_NED", z=z, vz=vz))
    if height < 2.0:
        assert ending.code is Ending.TOPPLED_AT_LANDING
        assert MotionEvent.FELL not in events
    else:
        assert ending.code is not Ending.TOPPLED_AT_LANDING
        assert MotionEvent.FELL in events


@mark.parametrize("angle, name", [(27.0, NAMES[1]), (33.0, "")])
def test_a_motor_is_named_within_two_thirds_of_half_the_way_to_the_next(angle, name):
    towards = np.cos(np.radians([225 + angle, 135 + angle]))  # Motor 2 is at 225°.
    assert (
        events_and_ending(with_lean(telemetry_of_lost_motor(1), towards, 60.0, 100.0))[1].subject
        == name
    )


def test_of_two_motors_at_one_place_none_is_named():
    places = {"geometry.positions": 2 * [(1, 1)] + 2 * [(-1, -1)]}
    assert weak_motor(Mock(**places), np.array([2.0, 1.0, -1.0, -2.0]), None) is None


@mark.parametrize("force, hit", [(27.0, False), (29.0, True)])
def test_a_knock_is_18_metres_per_second_squared_above_the_weight(force, hit):
    events, ending = events_and_ending(with_knock(telemetry_of_lost_motor(1), FAILS + 2.0, force))
    if hit:
        impact = events[MotionEvent.HIT]
        assert impact.time == approx(FAILS + 2.0, abs=0.05)
        assert impact.is_bad, "a hit is bad whatever came before it"
    else:
        assert MotionEvent.HIT not in events
    assert (ending.code, ending.subject) == (Ending.CONTROL_LOST, NAMES[1])


@mark.parametrize("speed", [4.7, 5.7])
def test_a_descent_faster_than_five_metres_a_second_is_a_fall(speed):
    events, _ = events_and_ending(with_fall(with_lean(flight(), ASIDE, 120.0, 100.0), speed))
    if speed > 5.0:
        assert MotionEvent.FELL in events
    else:
        assert MotionEvent.FELL not in events


@mark.slow
@mark.parametrize("seconds, caught", [(4.0, False), (6.0, True)])
def test_an_attitude_is_caught_by_five_seconds_of_flight(seconds, caught):
    telemetry = with_lean(flight(50.0), RIGHT, 70.0, 1.0)
    _, ending = events_and_ending(with_end_of_log(telemetry, 1.3 + seconds))
    if caught:
        assert ending is None
    else:
        assert ending is not None


@mark.slow
def test_a_fall_that_stops_at_once_is_a_crash_only_by_a_second_witness():
    """The height shows a fall and an impact. Without the accelerometer that is one sensor only."""
    telemetry = with_end_of_log(with_fall(flight()), 4.0)
    events, ending = events_and_ending(telemetry)
    assert events[MotionEvent.HIT].time == approx(FAILS + 2.0, abs=0.4)
    assert events[MotionEvent.HIT].level is Level.WATCH
    assert ending is None
    _, ending = events_and_ending(with_knock(telemetry, FAILS + 2.0))
    assert ending.code is Ending.CRASHED
    assert ending.time == approx(FAILS + 2.0, abs=0.4)
    assert ending.figures["speed"] == approx(9.0, abs=1.5)
    assert (
        MotionEvent.HIT
        not in events_and_ending(with_end_of_log(with_fall(flight(), 3.6, 2.8), 4.0))[0]
    )


def test_a_dive_that_the_motors_end_is_no_impact():
    telemetry = with_knock(with_end_of_log(with_fall(flight()), 4.0), FAILS + 2.0, most=20.0)
    assert MotionEvent.HIT not in events_and_ending(telemetry)[0]


@mark.slow
def test_a_landing_that_was_only_assumed_is_what_came_first():
    telemetry = with_motor_output(with_fall(with_lean(flight(), ASIDE, 120.0, 100.0)), ALL, 1100.0)
    time = np.arange(0.0, 40.0, 0.2)
    state = np.where((time < 6.0) | (abs(time - FAILS + 0.3) < 0.15), ON_GROUND, IN_AIR)
    telemetry = changed(telemetry, "EXTENDED_SYS_STATE", **columns(time, landed_state=state))
    parameters = {"MPC_THR_HOVER": 0.35, "MPC_THR_MIN": 0.12, "MPC_USE_HTE": 1.0}
    _, ending = events_and_ending(replace(telemetry, parameters=parameters))
    assert ending.figures["cause"].code is FailedFirst.LANDING_ASSUMED_FIRST
    assert "now MPC_THR_MIN 0.12 and MPC_THR_HOVER 0.35. Set MPC_THR_MIN to 0.05" in ending.remedy
    assert "MPC_THR_HOVER to 0.14, at which it hovers (that counts only until" in ending.remedy


def with_knock(telemetry, time, most=100.0):
    """Returns telemetry whose accelerometer measures a knock at a time, ``most`` m/s², and gravity otherwise."""
    sample_times = np.arange(0.0, stamps(telemetry, "ATTITUDE")[-1], 0.04)
    force = np.where(abs(sample_times - time) < 0.03, most, 9.8)
    return changed(
        telemetry, "HIGHRES_IMU", **columns(sample_times, xacc=0.0, yacc=0.0, zacc=-force)
    )


@mark.parametrize("speed, is_stopped", [(6.0, True), (0.0, False)])
def test_what_hits_something_first_is_not_said_to_have_lost_a_motor(speed, is_stopped):
    """A knock that takes the speed is an obstacle; one of a vehicle that hovers may be a propeller that breaks."""
    telemetry = with_knock(telemetry_of_lost_motor(1), FAILS - 0.2)
    flies_on = stamps(telemetry, "LOCAL_POSITION_NED") < FAILS - 0.2
    telemetry = changed(telemetry, "LOCAL_POSITION_NED", vx=np.where(flies_on, speed, 0.0))
    _, ending = events_and_ending(telemetry)
    assert ending.code is (Ending.CRASHED if is_stopped else Ending.CONTROL_LOST)
    assert ending.time == approx(FAILS - 0.2, abs=0.05)
    assert ending.subject == ("" if is_stopped else NAMES[1])


def report_of_lost_thrust(motor):
    return Fact(
        ReportedEvent.THRUST_LOST, Level.BAD, time=FAILS + 1.0, subject=f"motor {motor}", boot=0
    )


@mark.slow
def test_the_autopilots_own_word_names_a_motor_or_is_said_beside_another():
    """The autopilot's text blames motor 2, 3 or 4 while the motion shows that motor 2 failed, or no motor."""
    _, agreed = events_and_ending(telemetry_of_lost_motor(1), report_of_lost_thrust(2))
    assert (agreed.subject, agreed.figures["word"]) == (NAMES[1], None)
    _, apart = events_and_ending(telemetry_of_lost_motor(1), report_of_lost_thrust(3))
    motor_names = [apart.figures[name].subject for name in ("cause", "word")]
    assert (apart.subject, motor_names) == ("", [NAMES[1], NAMES[2]])
    between = with_lean(telemetry_of_lost_motor(1), (-1.0, 0.0), 120.0, 100.0)
    _, alone = events_and_ending(between, report_of_lost_thrust(4))
    assert alone.figures["cause"] is None
    assert alone.subject == alone.figures["word"].subject == NAMES[3]


@mark.slow
def test_a_crash_that_only_the_autopilot_reports_is_an_ending():
    crash = Fact(ReportedEvent.CRASH_DETECTED, Level.BAD, time=FAILS, height=2.0, boot=0)
    _, ending = events_and_ending(flight(), crash)
    assert ending.code is Ending.LOSS_REPORTED
    assert ending.figures["cause"] is crash
    assert events_and_ending(flight(), crash.replace(Level.WATCH))[1] is None


@mark.slow
def test_a_log_that_ends_in_the_air_and_clips_are_events_and_no_ending():
    """The log ends at a height of 10 m, unless it was ended on purpose or the autopilot restarted."""
    telemetry = with_end_of_log(flight(), 0.0)
    time = stamps(telemetry, "VIBRATION")
    counts = 3.0 * (time > 20.0) + 4.0 * (time > 22.0)
    clipped = changed(
        telemetry, "VIBRATION", **dict.fromkeys((*LEVEL_FIELDS, *CLIPPING_FIELDS), counts)
    )
    events, ending = events_and_ending(clipped)
    assert ending is None
    assert events[MotionEvent.LOG_ENDED_IN_AIR].figures["height"] == approx(10.0, abs=0.5)
    assert " 7 times " in str(events[MotionEvent.CLIPPED])
    assert "a crash that it does not show" in events[MotionEvent.LOG_ENDED_IN_AIR].remedy
    ended = replace(telemetry, is_ended_on_purpose=True)
    assert MotionEvent.LOG_ENDED_IN_AIR not in events_and_ending(ended)[0]
    restarted = changed(telemetry, "ATTITUDE", boot=1 * (stamps(telemetry, "ATTITUDE") > 29.8))
    assert MotionEvent.LOG_ENDED_IN_AIR not in events_and_ending(restarted)[0]


def with_reported_flight(telemetry):
    """Returns telemetry that ends in the air, 0.4 s after the last of its reports that the vehicle flies."""
    time = np.arange(0.0, FAILS)
    state = np.where(time < 6.0, ON_GROUND, IN_AIR)
    reports = columns(time, landed_state=state)
    return with_end_of_log(changed(telemetry, "EXTENDED_SYS_STATE", **reports), -0.6)


@mark.slow
def test_a_log_ends_in_the_air_though_its_motors_need_little_thrust_or_its_flight_is_low():
    """By the motors alone the one vehicle would be on the ground, and by the height alone the other one."""
    telemetry = flight()
    outputs = pulses(telemetry)
    light_vehicle = with_pulses(telemetry, 1000 + 0.2 * (outputs - 1000))
    position = telemetry.messages["LOCAL_POSITION_NED"]
    descent = np.interp(position["time"], [18.0, 26.0], [1.0, 0.05])
    low_stream = changed(telemetry, "LOCAL_POSITION_NED", z=descent * position["z"])
    low_flight = replace(low_stream, translated_from="ULog")
    for vehicle in (light_vehicle, low_flight):
        events, _ = events_and_ending(with_reported_flight(vehicle))
        assert MotionEvent.LOG_ENDED_IN_AIR in events
    # Without a report of flight, or with motors that hardly turn, a low vehicle may stand on the ground.
    unreported = with_end_of_log(low_flight, -0.6)
    touched_down = with_motor_output(low_flight, ALL, 1150, FAILS - 3.0)
    # A live session judges a flight at its landing, when the latest report is still one of flight.
    received = with_reported_flight(low_stream)
    for vehicle in (unreported, with_reported_flight(touched_down), received):
        assert MotionEvent.LOG_ENDED_IN_AIR not in events_and_ending(vehicle)[0]


@mark.parametrize("landed_at, words", [(39.0, "came back"), (FAILS + 1.0, "at the landing")])
def test_what_lies_askew_after_its_landing_did_not_come_back(landed_at, words):
    telemetry = with_lean(flight(), RIGHT, 35.0, 2.0)
    position = telemetry.messages["LOCAL_POSITION_NED"]
    z = np.where(position["time"] > landed_at, position["z"][0], position["z"])
    telemetry = changed(telemetry, "LOCAL_POSITION_NED", z=z)
    time = np.arange(0.0, 40.0, 0.2)
    state = np.where((time < 6.0) | (time > landed_at), ON_GROUND, IN_AIR)
    events, _ = events_and_ending(
        changed(telemetry, "EXTENDED_SYS_STATE", **columns(time, landed_state=state))
    )
    assert words in str(events[MotionEvent.ATTITUDE_CAUGHT])


def test_heights_above_a_take_off_before_the_log_are_no_witnesses():
    signals = Signals(flight(), inputs="motors")
    assert BootSensors(signals, 0, 6.0).height_facts(1.0, FAILS)
    assert not BootSensors(signals, 0).height_facts(1.0, FAILS)


def test_a_log_that_ends_after_the_loss_shows_why():
    events, ending = events_and_ending(with_end_of_log(telemetry_of_lost_motor(1), 1.0))
    assert ending.code is Ending.CONTROL_LOST
    assert str(events[MotionEvent.LOG_ENDED_IN_AIR]).endswith(", after control was lost.")
    assert events[MotionEvent.LOG_ENDED_IN_AIR].remedy == ""


@mark.slow
def test_a_loss_is_stated_without_its_cause_where_nothing_else_is_computed():
    telemetry = telemetry_of_lost_motor(1)
    _, ending = events_and_ending(telemetry)
    loss = loss_of_flight(Signals(telemetry))
    assert (loss.code, loss.time) == (ending.code, ending.time)
    assert str(ending).startswith(str(loss).rstrip(".")) and "motor" not in str(loss)
    assert loss_of_flight(Signals(flight())) is None


@mark.slow
def test_every_witness_says_when_and_agrees_with_its_event():
    events, ending = events_and_ending(telemetry_of_lost_motor(1))
    for event in (*events.values(), ending):
        for witness in event.figures.get("witnesses", ()):
            assert re.search(r"\d\.\d s\b", str(witness)), str(witness)
    fell = events[MotionEvent.FELL]
    speeds = [witness.figures["speed"] for witness in fell.figures["witnesses"]]
    assert fell.figures["speed"] in speeds
    assert f"{fell.time:.1f} to {fell.end_time:.1f} s" in str(fell)


@mark.parametrize("at_end", [True, False])
def test_what_falls_on_its_back_is_lost_whatever_is_asked(at_end):
    """Its setpoint follows it, as in rate modes."""
    telemetry = with_fall(with_lean(flight(), RIGHT, 120.0, 100.0 if at_end else 1.0))
    roll = telemetry.messages["ATTITUDE"]["roll"]
    telemetry = changed(telemetry, "ATTITUDE_TARGET", q=quaternion(roll, 0 * roll, 0 * roll))
    events, ending = events_and_ending(telemetry)
    if at_end:
        assert MotionEvent.ATTITUDE_LOST in events
        assert ending.code is Ending.CONTROL_LOST
        assert ending.time == approx(FAILS, abs=0.5)
    else:
        assert MotionEvent.ATTITUDE_LOST not in events


def test_an_estimate_that_runs_away_gives_no_speed():
    telemetry = telemetry_of_lost_motor(1)  # It moves at 9 m/s in the end.
    position = telemetry.messages["LOCAL_POSITION_NED"]
    away = position["time"] > FAILS + 1.5
    ran = {name: np.where(away, most, position[name]) for name, most in (("vz", 20.0), ("z", 50.0))}
    events, _ = events_and_ending(changed(telemetry, "LOCAL_POSITION_NED", **ran))
    fell = events[MotionEvent.FELL].figures
    assert fell["speed"] < 8.0
    assert fell["speed"] in [witness.figures["speed"] for witness in fell["witnesses"]]


def evidence_of_cause(telemetry):
    """The ending with the evidence for its cause, and the facts of that evidence."""
    events, ending = events_and_ending(telemetry)
    ending = with_evidence_of_cause(Signals(telemetry, inputs="motors"), ending, [*events.values()])
    return ending, ending.figures["cause"].figures["witnesses"]


@mark.slow
def test_the_climb_of_its_command_is_the_first_evidence_for_a_weak_motor():
    """The controller drives motor 2 up over the last 6 s, before it reaches its limit."""
    telemetry = telemetry_of_lost_motor(1)
    outputs = pulses(telemetry)
    seconds = stamps(telemetry, "SERVO_OUTPUT_RAW") - FAILS
    outputs[1] += np.where(seconds < 0, 200.0 * np.clip(1 + seconds / 6.0, 0, 1), 0.0)
    ending, (climb,) = evidence_of_cause(with_pulses(telemetry, outputs))
    assert (climb.code, climb.subject) == (SensorFact.COMMANDS_CHANGED, NAMES[1])
    # The average over two seconds may leave its usual range a second early.
    assert FAILS - 7.0 < climb.time < FAILS - 4.0
    assert climb.end_time == approx(FAILS, abs=0.15)
    figures = climb.figures
    assert figures["is_at_limit"] and figures["share"] == approx(1.0)
    # The other motors hold the vehicle as before.
    assert figures["others_share"] == approx(figures["others_share_before"], abs=0.02)
    text = evidence_text(ending)
    assert text.startswith(f"Why: the command of {NAMES[1]} rose from its usual ")
    assert "; then the gyro measured " in text
    assert text.index("the gyro measured") < text.index("the attitude was ")


def test_a_command_that_rises_at_once_has_not_climbed_since_the_lean_changed():
    """Seven seconds before its limit, motor 2 works 1 % harder, since the vehicle leans a little more in the wind."""
    time = np.arange(0.0, 30.0, 0.02)
    commands = np.full((len(time), 4), 0.7)
    commands[:, 1] += default_rng(1).normal(0.0, 0.002, len(time))
    commands[time > 23.0, 1] += 0.01
    commands[time > 29.8, 1] = 1.0
    series = TimeSeries(time, np.zeros(len(time), int), commands)
    usual = series.within((2.0, 20.0))
    # The average over two seconds rises a second early.
    assert 28.7 < _start_of_climb(usual, series, motor=1) < 29.8


def test_of_a_motor_without_output_the_evidence_is_that_its_command_fell():
    telemetry = with_motor_output(
        with_fall(with_lean(flight(), QUAD[2], 120.0, 100.0)), 2, 1000.0, FAILS - 4.0
    )
    _, (fall,) = evidence_of_cause(telemetry)
    assert (fall.time, fall.end_time) == (approx(FAILS - 4.0, abs=0.15), None)
    assert fall.figures["share"] == 0.0 < fall.figures["share_before"]
    assert " fell from its usual " in str(fall) and "(the mean of the others stayed at " in str(
        fall
    )


@mark.slow
def test_motors_that_idled_together_show_it_in_their_mean_command():
    telemetry = with_motor_output(with_fall(with_lean(flight(), ASIDE, 120.0, 100.0)), ALL, 1100.0)
    ending, (fall,) = evidence_of_cause(telemetry)
    assert ending.figures["cause"].code is FailedFirst.ALL_OFF_FIRST
    assert fall.figures["share"] < 0.5 * fall.figures["share_before"]
    assert fall.time == approx(FAILS, abs=0.15)
    assert str(fall).startswith("The mean command of all motors fell from its usual ")


def test_a_height_that_diverged_brings_its_own_evidence():
    witness = Fact(SensorFact.GRAVITY_WRONG, time=2.0, acceleration=7.8, part="at rest")
    divergence = Fact(MotionEvent.HEIGHT_DIVERGED, time=2.0, boot=0, witnesses=(witness,))
    cause = Fact(FailedFirst.HEIGHT_DIVERGED_FIRST, time=2.0, cause=divergence)
    ending = Fact(Ending.CRASHED, time=4.0, boot=0, cause=cause, witnesses=())
    completed = with_evidence_of_cause(Signals(flight()), ending, [divergence])
    assert completed.figures["cause"].figures["witnesses"] == (witness,)


def test_the_landing_that_the_autopilot_detected_is_the_first_evidence_that_it_assumed_one():
    detected = Fact(
        ReportedEvent.LANDING_DETECTED_IN_FLIGHT,
        time=3.8,
        end_time=4.0,
        boot=0,
        height=10.0,
        basis=("X",),
    )
    earlier = detected.replace(time=-9.0)
    cause = Fact(FailedFirst.LANDING_ASSUMED_FIRST, time=3.9)
    ending = Fact(Ending.CONTROL_LOST, time=4.0, boot=0, cause=cause, witnesses=())
    completed = with_evidence_of_cause(Signals(flight()), ending, [earlier, detected])
    assert "Why: the autopilot detected a landing at 3.8 s, 10 m above" in evidence_text(completed)
    assert "-9.0 s" not in evidence_text(completed)
    events = raise_level_of_assumed_landings(completed, [earlier, detected])
    assert [event.is_bad for event in events] == [False, True]
    assert raise_level_of_assumed_landings(None, [detected]) == [detected]


@mark.slow
def test_a_motor_that_failed_is_drawn_as_it_was_commanded_then():
    telemetry = telemetry_of_lost_motor(1)
    signals = Signals(telemetry, inputs="motors")
    _, ending = events_and_ending(telemetry)
    failure = failure_commands(signals, ending)
    assert failure.interval == approx((FAILS, FAILS + 2.0), abs=0.2)
    plan = frame_plan(signals.motors, None, ending, failure)
    assert "at the failure" in plan.title
    assert "motor 2 100 %, usual " in plan.description
    assert frame_plan(signals.motors, None, ending) is None
