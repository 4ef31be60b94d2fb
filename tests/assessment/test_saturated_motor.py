"""A motor at its limit that does not hold the vehicle lost thrust; limits of other origin name no motor."""

import numpy as np
from frames import QUAD, geometry
from hover import X_QUAD_PARAMETERS, Hover, changed, columns, pulses, with_pulses
from pytest import approx, mark

from mavdem.assessment.motion import motion_events
from mavdem.assessment.motor_events import motor_events
from mavdem.assessment.saturated_motor import (
    saturation_losses,
    with_motors_limited_before,
    with_saturated_motor,
)
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.facts.ending import Ending, FailedFirst, MotionEvent
from mavdem.facts.event import Event
from mavdem.facts.motors import MotorWatchFact
from mavdem.ingest.vocabulary import IN_AIR, ON_GROUND, attitude_target, quaternion

HOVER = Hover(sway=0.0)
NAMES = geometry().names
SATURATES = 40.0
"""Seconds at which a motor reaches its limit."""


def flight(height=10.0):
    """A hover at 10 m, or on a stand that the barometer sees at another height, with setpoints of the attitude."""
    telemetry = HOVER.telemetry(10.0, 10.0, parameters=X_QUAD_PARAMETERS)
    time = telemetry.messages["ATTITUDE"]["time"]
    level = quaternion(*3 * [0 * time])
    telemetry = changed(telemetry, "ATTITUDE_TARGET", **columns(time, **attitude_target(level)))
    position = telemetry.messages["LOCAL_POSITION_NED"]
    share = height / 10.0
    z = share * np.cumsum(position["vz"]) * 0.1
    return changed(
        telemetry,
        "LOCAL_POSITION_NED",
        x=0.0,
        y=0.0,
        vx=0.0,
        vy=0.0,
        vz=share * position["vz"],
        z=z,
    )


def with_rising_output(telemetry, motor, seconds, highest=2000.0, end_time=np.inf):
    """Returns telemetry in which the output of a motor, from 0, rises to ``highest`` within some seconds, and stays.

    It is at its highest from the time ``SATURATES`` on.
    """
    time = telemetry.messages["SERVO_OUTPUT_RAW"]["time"]
    outputs = pulses(telemetry)
    rise = np.clip((time - SATURATES) / seconds + 1, 0, 1) * (time < end_time)
    outputs[motor] = np.where(outputs[motor] > 1000, outputs[motor] + rise * (highest - 1600), 1000)
    return with_pulses(telemetry, np.minimum(outputs, 2000.0))


def with_lean(telemetry, towards, degrees):
    """Returns telemetry whose attitude leans from ``SATURATES`` on in the direction ``towards``, forward and right."""
    attitude = telemetry.messages["ATTITUDE"]
    lean = np.radians(degrees) * (attitude["time"] > SATURATES)
    return changed(telemetry, "ATTITUDE", roll=lean * towards[1], pitch=-lean * towards[0])


def sinking(telemetry, speed):
    """Returns telemetry of a vehicle that sinks from ``SATURATES`` on."""
    position = telemetry.messages["LOCAL_POSITION_NED"]
    vz = np.where(position["time"] > SATURATES, speed, position["vz"])
    return changed(
        telemetry, "LOCAL_POSITION_NED", vz=vz, z=position["z"] + np.cumsum(vz > 0) * 0.1
    )


def losses(telemetry, ending=None):
    signals = Signals(telemetry, inputs="motors")
    return saturation_losses(signals, motion_events(signals), ending)


@mark.parametrize("motor", range(4))
@mark.parametrize("seconds", [1.0, 5.0])
def test_a_motor_at_its_limit_to_whose_side_the_vehicle_leans_is_named(motor, seconds):
    [loss] = losses(
        with_lean(with_rising_output(flight(), motor, seconds, 2100.0), QUAD[motor], 15.0)
    )
    assert (loss.code, loss.level) == (MotorWatchFact.MOTOR_SATURATED, "bad")
    assert loss.subject == NAMES[motor]
    assert loss.time == approx(SATURATES, abs=1.3)
    assert loss.figures["excess"] == approx(0.4, abs=0.05)


def test_a_loss_over_40_s_is_named_before_the_fall():
    telemetry = with_rising_output(flight(), 2, 30.0, 2100.0)
    position = telemetry.messages["LOCAL_POSITION_NED"]
    vz = np.where(position["time"] > SATURATES, 1.5, position["vz"])
    [loss] = losses(changed(telemetry, "LOCAL_POSITION_NED", vz=vz))
    assert loss.subject == NAMES[2]


@mark.slow
def test_a_limit_that_holds_the_vehicle_is_no_loss():
    telemetry = with_rising_output(flight(), 1, 2.0, 2100.0)
    assert any(
        event.code is MotionEvent.MOTOR_AT_ITS_STOP for event in motion_events(Signals(telemetry))
    )
    assert not losses(telemetry)


def test_a_lean_to_another_side_is_no_loss_of_that_motor():
    assert not losses(with_lean(with_rising_output(flight(), 1, 2.0, 2100.0), QUAD[0], 15.0))


@mark.slow
def test_a_limit_just_before_an_impact_is_no_loss():
    telemetry = with_lean(with_rising_output(flight(), 1, 2.0, 2100.0), QUAD[1], 15.0)
    impact = Fact(Ending.CRASHED, time=SATURATES + 0.5, boot=0)
    assert not losses(telemetry, impact)
    assert losses(telemetry, impact.replace(time=SATURATES + 5.0))


def test_a_short_limit_is_no_loss():
    telemetry = with_rising_output(flight(), 1, 0.5, 2100.0, end_time=SATURATES + 2.0)
    assert not losses(with_lean(telemetry, QUAD[1], 15.0))


@mark.parametrize("speed, is_loss", [(2.0, True), (0.2, False)])
def test_a_motor_at_its_limit_while_the_vehicle_sinks_to_the_ground_lost_thrust(speed, is_loss):
    """The flight ends after 4 s: the motor of an octorotor stops, and the seven others brake the fall."""
    telemetry = sinking(with_rising_output(flight(), 1, 0.5, 2100.0), speed)
    velocity = telemetry.messages["LOCAL_POSITION_NED"]["vz"]
    telemetry = changed(telemetry, "LOCAL_POSITION_NED", z=0.1 * np.cumsum(velocity))
    time = np.arange(0.0, HOVER.end, 0.5)
    is_in_air = (time >= 6.0) & (time < SATURATES + 4.0)
    states = columns(time, landed_state=np.where(is_in_air, IN_AIR, ON_GROUND))
    found = losses(changed(telemetry, "EXTENDED_SYS_STATE", **states))
    assert [loss.subject for loss in found] == ([NAMES[1]] if is_loss else [])


@mark.slow
def test_all_motors_at_their_limit_are_no_loss_of_one():
    telemetry = flight()
    for motor in range(4):
        telemetry = with_rising_output(telemetry, motor, 2.0, 2100.0)
    assert not losses(with_lean(telemetry, QUAD[1], 15.0))


def test_a_motor_at_its_limit_near_the_ground_is_no_event():
    telemetry = with_rising_output(flight(height=0.3), 1, 2.0, 2100.0)
    codes = [event.code for event in motion_events(Signals(telemetry))]
    assert MotionEvent.MOTOR_AT_ITS_STOP not in codes


def test_a_diverged_height_explains_every_limit():
    telemetry = with_lean(with_rising_output(flight(), 1, 2.0, 2100.0), QUAD[1], 15.0)
    signals = Signals(telemetry, inputs="motors")
    diverged = Fact(MotionEvent.HEIGHT_DIVERGED, time=30.0, boot=0)
    assert not saturation_losses(signals, [diverged, *motion_events(signals)], None)


@mark.parametrize("reported, named", [("", NAMES[1]), (NAMES[1], NAMES[1]), (NAMES[0], NAMES[0])])
def test_a_loss_without_a_cause_names_the_motor_that_saturated(reported, named):
    losses_of_motor = losses(with_lean(with_rising_output(flight(), 1, 2.0, 2100.0), QUAD[1], 15.0))
    lost = Fact(Ending.CONTROL_LOST, time=45.0, subject=reported, cause=None, word=None, boot=0)
    ending = with_saturated_motor(lost, losses_of_motor)
    assert ending.subject == named
    if named == NAMES[1]:
        assert ending.figures["cause"].code is FailedFirst.LIMIT_FIRST
    else:
        assert ending == lost


def test_a_motor_was_not_at_its_limit_first_after_another_one():
    losses_of_motor = losses(with_lean(with_rising_output(flight(), 1, 2.0, 2100.0), QUAD[1], 15.0))
    lost = Fact(Ending.CONTROL_LOST, time=45.0, subject="", cause=None, word=None, boot=0)
    limit = Fact(MotionEvent.MOTOR_AT_ITS_STOP, time=SATURATES - 1.0, subject=NAMES[0], boot=0)
    ending = with_saturated_motor(lost, losses_of_motor, [limit])
    assert ending.figures["cause"].code is FailedFirst.THRUST_MISSING_FIRST
    assert str(ending.figures["cause"]) == f"{NAMES[1].capitalize()} did not hold the vehicle."


@mark.parametrize("limit_time, is_named", [(35.0, True), (39.5, False)])
def test_a_motor_at_its_limit_long_before_all_thrust_was_used_up_is_named(limit_time, is_named):
    """All motors are at their limits from 40 s on, motor 1 since 35 s or 39.5 s."""
    spent = Fact(FailedFirst.THRUST_SPENT_FIRST, time=40.0, share=0.93)
    crashed = Fact(Ending.CRASHED, time=42.0, subject="", cause=spent, word=None, boot=0)
    limit = Fact(
        MotionEvent.MOTOR_AT_ITS_STOP, time=limit_time, end_time=41.0, subject=NAMES[0], boot=0
    )
    over = limit.replace(subject=NAMES[1], end_time=36.0)
    other_boot = limit.replace(subject=NAMES[2], boot=1)
    ending = with_motors_limited_before(crashed, [limit, over, other_boot])
    text = f"{ending.figures['cause']}"
    assert (
        f"limit from 40.0 s on, {NAMES[0]} at its own limit from 35.0 s on." in text
    ) == is_named
    assert with_motors_limited_before(None, [limit]) is None
    assert with_motors_limited_before(crashed.replace(cause=None), [limit]).figures["cause"] is None


def test_a_saturated_motor_replaces_no_known_cause_and_no_impact():
    losses_of_motor = losses(with_lean(with_rising_output(flight(), 1, 2.0, 2100.0), QUAD[1], 15.0))
    frozen = Fact(FailedFirst.OUTPUT_FROZE_FIRST, subject=NAMES[0])
    lost = Fact(Ending.CONTROL_LOST, time=45.0, subject=NAMES[0], cause=frozen, boot=0)
    crashed = Fact(Ending.CRASHED, time=45.0, cause=None, boot=0)
    assert with_saturated_motor(lost, losses_of_motor) == lost
    assert with_saturated_motor(crashed, losses_of_motor) == crashed


def test_a_limit_that_began_before_the_record_has_a_duration_but_no_start_in_words():
    """A motor is at its upper limit from before the first record until 20 s.

    The sentence states the end alone and never an infinite time.
    """
    telemetry = flight()
    outputs = pulses(telemetry)
    time = telemetry.messages["SERVO_OUTPUT_RAW"]["time"]
    outputs[1] = np.where(time < 20.0, 2000.0, outputs[1])
    event = next(
        motor_events(
            Signals(with_pulses(telemetry, outputs), inputs="motors"), 0, [(-np.inf, np.inf)]
        )
    )
    assert event.code is MotionEvent.MOTOR_AT_ITS_STOP and event.start_time == -np.inf
    assert event.figures["duration"] == approx(event.latest_time - time[0])
    assert event.sentence.endswith(
        f"was at its upper limit 100 % of the time until {event.latest_time:.1f} s."
    )
    lasting_event = event.replace(end_time=None)
    assert lasting_event.sentence.endswith("throughout the record.")
    assert not Event(event.start_time, event).has_time
