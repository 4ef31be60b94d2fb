"""Speeds that controllers measure, as witnesses of a motor that is lost: for it, and against it."""

import numpy as np
from hover import changed, columns, evidence_of, pulses, with_pulses
from instrumented import EVENT, instrumented, knocked, moving, rolled
from pytest import approx, mark
from scipy.constants import g as GRAVITY  # noqa: N812

from mavdem.assessment.ending import find_ending
from mavdem.assessment.instances import list_instances
from mavdem.assessment.motion import motion_events
from mavdem.assessment.motor_speeds import speed_facts
from mavdem.assessment.motor_witnesses import with_sensor_evidence
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.facts.ending import FailedFirst, MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.witnesses import SensorFact, Side

MOTOR = 1
"""Index of the motor that fails: motor 2, rear left."""


def with_speeds(telemetry, speed_of_failing=0.0, rate=10.0):
    """Four controllers measure 5000 1/min in flight; that of motor 2 another speed from ``EVENT`` on."""
    time = np.arange(0.0, telemetry.messages["ATTITUDE"]["time"][-1], 1 / rate)
    outputs = telemetry.messages["SERVO_OUTPUT_RAW"]
    is_flying = np.interp(time, outputs["time"], outputs["servo1_raw"]) > 1100
    speeds = np.where(is_flying, 5000.0 + np.sin(time), 0.0)[:, None] * np.ones(4)
    failed = (time > EVENT) & is_flying
    speeds[failed, MOTOR] = speed_of_failing
    return changed(telemetry, "ESC_STATUS", **columns(time, index=0, rpm=speeds))


def lost_motor():
    """The motor stops in a hover; its command rises to the limit, and the vehicle rolls over to its side and falls."""
    telemetry = moving(instrumented(), lambda since: -GRAVITY * since)
    outputs = pulses(telemetry)
    is_lost = telemetry.messages["SERVO_OUTPUT_RAW"]["time"] > EVENT + 0.2
    outputs[MOTOR, is_lost] = 1950.0
    telemetry = rolled(with_pulses(telemetry, outputs), -120.0, EVENT + 0.2, 0.8)
    return knocked(telemetry, EVENT + 1.43, 150.0)


def events_and_ending(telemetry):
    signals = Signals(telemetry, inputs="motors")
    events = motion_events(signals)
    assert all(event.sentence for event in events)
    return {event.code: event for event in events}, find_ending(signals, events)


def codes(event, side):
    return {fact.code for fact in event.figures["witnesses"] if fact.figures["side"] == side}


@mark.slow
@mark.parametrize("rate", [10.0, 4.0])
def test_a_motor_that_stands_still_while_commanded_is_lost_with_a_second_witness(rate):
    events, ending = events_and_ending(with_speeds(lost_motor(), rate=rate))
    stood_still = events[MotionEvent.MOTOR_STOOD_STILL]
    assert stood_still.is_bad
    assert stood_still.subject == "motor 2 (rear left)"
    for_it = {
        SensorFact.SPEED_ZERO,
        SensorFact.COMMAND_ROSE,
        SensorFact.ATTITUDE_LEFT_SETPOINT,
    }
    assert for_it <= codes(stood_still, Side.FOR)
    cause = ending.figures["cause"]
    assert (cause.code, cause.subject) == (
        FailedFirst.MOTOR_STOOD_STILL_FIRST,
        "motor 2 (rear left)",
    )


@mark.slow
def test_a_controller_that_reports_0_in_a_sound_hover_is_to_be_watched():
    events, ending = events_and_ending(with_speeds(instrumented()))
    stood_still = events[MotionEvent.MOTOR_STOOD_STILL]
    assert stood_still.level == "watch"
    assert codes(stood_still, Side.AGAINST) == {
        SensorFact.COMMAND_UNCHANGED,
        SensorFact.ATTITUDE_HELD,
    }
    assert "telemetry" in stood_still.remedy
    assert ending is None


@mark.slow
def test_a_lost_motor_that_turns_in_the_wind_for_most_of_the_flight_stands_still():
    events, _ = events_and_ending(with_speeds(instrumented(), speed_of_failing=100.0))
    assert events[MotionEvent.MOTOR_STOOD_STILL].time == approx(EVENT, abs=0.2)


@mark.slow
def test_motors_that_all_turn_are_no_event():
    events, _ = events_and_ending(with_speeds(instrumented(), 5000.0))
    assert MotionEvent.MOTOR_STOOD_STILL not in events


@mark.parametrize(
    "speed, code, side",
    [
        (3000.0, SensorFact.MOTOR_SLOWED, Side.FOR),
        (5500.0, SensorFact.MOTOR_TURNED, Side.AGAINST),
    ],
)
def test_a_loss_of_thrust_has_the_speed_of_its_motor_for_or_against_it(speed, code, side):
    signals = Signals(with_speeds(instrumented(), speed), inputs="motors")
    loss = Fact(MotorWatchFact.MOTOR_LOST_THRUST, time=EVENT, subject="motor 2 (rear left)", boot=0)
    (witnessed,) = with_sensor_evidence(signals, [loss], ())
    assert codes(witnessed, side) == {code}


def test_a_motor_that_its_command_slowed_did_not_slow_by_itself():
    telemetry = with_speeds(instrumented(), 1000.0)
    outputs = pulses(telemetry)
    outputs[MOTOR, telemetry.messages["SERVO_OUTPUT_RAW"]["time"] > EVENT] = 1000.0
    signals = Signals(with_pulses(telemetry, outputs), inputs="motors")
    off = Fact(MotionEvent.MOTOR_OFF, time=EVENT, subject="motor 2 (rear left)", boot=0)
    assert not speed_facts(signals, off)


def test_a_loss_states_what_else_of_the_flight_agrees_with_it():
    signals = Signals(lost_motor(), inputs="motors")
    subject = "motor 2 (rear left)"
    loss = Fact(MotorWatchFact.MOTOR_SATURATED, time=EVENT, subject=subject, excess=0.4, boot=0)
    report = Fact(ReportedEvent.THRUST_LOST, time=EVENT + 1.0, subject="motor 2", boot=0)
    torque_change = Fact(MotorWatchFact.STEADY_TORQUE_CHANGED, time=EVENT, boot=0)
    witnessed, unnamed = with_sensor_evidence(signals, [loss, torque_change], [report])
    assert {
        SensorFact.COMMAND_ABOVE_OTHERS,
        SensorFact.ATTITUDE_LEFT_SETPOINT,
        SensorFact.SANK,
        SensorFact.AUTOPILOT_REPORTED,
    } == codes(witnessed, Side.FOR)
    assert unnamed == torque_change


@mark.slow
def test_the_table_names_the_motor_of_a_controller_and_that_it_stood_still():
    signals = Signals(with_speeds(instrumented()), inputs="motors")
    evidence = evidence_of(signals, events=motion_events(signals))
    states = {instance.name: instance.state for instance in list_instances(evidence)}
    assert "stood still" in states["ESC 2 (motor 2)"].sentence
    assert states["ESC 1 (motor 1)"].level == "good"
