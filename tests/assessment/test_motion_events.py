"""Events of the motion, each with the witnesses for it and against it, on made-up flights with all instruments."""

from dataclasses import replace
from math import inf

import numpy as np
from hover import changed, columns, only, pulses, with_pulses
from instrumented import (
    EVENT,
    STICK_CLOSED,
    STICK_MIDDLE,
    driven,
    estimating,
    in_mode,
    instrumented,
    knocked,
    moving,
    rolled,
    saying,
    stamps,
    stick,
)
from pytest import approx, mark

from mavdem.assessment.commanded_swings import path_leans
from mavdem.assessment.contact_time import ContactSearch
from mavdem.assessment.ending import find_ending, lower_unconfirmed_crash_reports
from mavdem.assessment.flights import flights_in_boot
from mavdem.assessment.motion import motion_events
from mavdem.assessment.reported import reported_events
from mavdem.dataset.attitude_error import AttitudeError, largest_error
from mavdem.dataset.signals import Signals
from mavdem.dataset.steady_flight import attitude_tracking
from mavdem.facts import Fact, Level
from mavdem.facts.ending import Ending, FailedFirst, MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.witnesses import HeightSource, SensorFact, Side
from mavdem.ingest.telemetry import selected_rows
from mavdem.ingest.vocabulary import quaternion, wrapped_angle
from mavdem.witnesses.boot_sensors import BootSensors, Rest
from mavdem.witnesses.sensor_facts import (
    ACCELEROMETER,
    ATTITUDE,
    support_count,
    supporting_fact,
)

GRAVITY = 9.8


def events_and_ending(telemetry):
    """The last event of each code, and the ending."""
    signals = Signals(telemetry, inputs="motors")
    reports = reported_events(signals)
    events = lower_unconfirmed_crash_reports(signals, [*reports, *motion_events(signals, reports)])
    assert all(event.sentence for event in events)
    return {event.code: event for event in events}, find_ending(signals, events)


def witnesses(event, side):
    return {fact.code for fact in event.figures["witnesses"] if fact.figures["side"] == side}


def climb_rate_of_fall(elapsed):
    """Returns the climb rate of a free fall, m/s, some seconds after it began."""
    return -GRAVITY * elapsed


@mark.slow
def test_a_sound_flight_has_no_event_of_motion():
    events, ending = events_and_ending(instrumented())
    assert ending is None
    assert not [code for code in events if isinstance(code, MotionEvent)]


def height_runaway(mode="Alt hold"):
    """The estimate falls at 3 m/s while the vehicle climbs at 2 m/s for 5 s, with the motors at their limit."""
    telemetry = moving(instrumented(mode), lambda elapsed: 2.0 * (elapsed < 5.0))
    telemetry = estimating(telemetry, lambda elapsed: -3.0 * (elapsed < 5.0))
    return driven(telemetry, 2000.0, EVENT + 1.0, EVENT + 5.0)


@mark.slow
def test_an_estimate_that_falls_while_the_barometer_rises_has_diverged():
    events, _ = events_and_ending(height_runaway())
    diverged = events[MotionEvent.HEIGHT_DIVERGED]
    assert diverged.level is Level.BAD
    assert diverged.time == approx(EVENT, abs=1.5)
    assert diverged.figures["climb_rate"] < -2.0
    assert diverged.figures["speed"] > 1.5
    assert {
        SensorFact.ROSE,
        SensorFact.THROTTLE_NOT_RAISED,
        SensorFact.MOTORS_FULL,
    } <= witnesses(diverged, Side.FOR)
    # Motors that follow a false height are not too weak.
    assert MotionEvent.MOTOR_AT_ITS_STOP not in events


@mark.slow
def test_full_throttle_does_not_confirm_an_estimate_that_rises_while_the_vehicle_sinks():
    telemetry = moving(instrumented("Alt hold"), lambda elapsed: -1.5 * (elapsed < 5.0))
    telemetry = estimating(telemetry, lambda elapsed: 2.0 * (elapsed < 5.0))
    diverged = events_and_ending(driven(telemetry, 2000.0, EVENT + 1.0, EVENT + 5.0))[0][
        MotionEvent.HEIGHT_DIVERGED
    ]
    assert SensorFact.SANK in witnesses(diverged, Side.FOR)
    assert SensorFact.MOTORS_FULL not in witnesses(diverged, Side.FOR)


@mark.slow
def test_the_accelerometer_is_the_cause_of_a_height_that_diverges():
    telemetry = changed(height_runaway(), "HIGHRES_IMU", zacc=-8.0)
    cause = events_and_ending(telemetry)[0][MotionEvent.HEIGHT_DIVERGED].figures["cause"]
    assert (cause.code, cause.figures["part"]) == (SensorFact.GRAVITY_WRONG, "at rest")
    assert cause.figures["acceleration"] == approx(8.0)


@mark.slow
def test_vibration_is_the_cause_where_the_error_at_rest_does_not_explain_that_in_flight():
    telemetry = height_runaway()
    time = stamps(telemetry, "HIGHRES_IMU")
    is_shaken = (time > EVENT - 5.0) & (time < EVENT + 5.0)
    telemetry = changed(telemetry, "HIGHRES_IMU", zacc=np.where(is_shaken, -2.0, -8.8))
    cause = events_and_ending(telemetry)[0][MotionEvent.HEIGHT_DIVERGED].figures["cause"]
    assert cause.figures["part"] == "in flight"
    assert cause.figures["acceleration"] == approx(2.0, abs=1.0)
    assert "from 8.8 m/s² at rest" in cause.sentence


@mark.slow
@mark.parametrize("autopilot, is_cause", [("PX4", True), ("ARDUPILOTMEGA", False)])
def test_vibration_is_a_cause_beyond_the_limit_of_the_autopilot(autopilot, is_cause):
    telemetry = replace(height_runaway(), autopilot=autopilot)
    time = stamps(telemetry, "LOCAL_POSITION_NED")
    levels = {f"vibration_{axis}": 15.0 for axis in "xyz"}
    clips = {f"clipping_{imu}": 0.0 for imu in range(3)}
    telemetry = changed(telemetry, "VIBRATION", **columns(time, **levels, **clips))
    diverged = events_and_ending(telemetry)[0][MotionEvent.HEIGHT_DIVERGED]
    assert (SensorFact.VIBRATED in witnesses(diverged, Side.FOR)) is is_cause


@mark.slow
def test_a_throttle_closed_after_a_divergence_is_named_beside_it():
    """It rises to 20 m by a false height; in Stabilize the pilot closes the throttle, and it falls."""
    fell = EVENT + 6.5
    telemetry = height_runaway()
    telemetry = moving(
        telemetry,
        lambda elapsed: np.where(elapsed < 5.0, 2.0, -GRAVITY * np.maximum(elapsed - 6.5, 0)),
    )
    telemetry = estimating(
        telemetry,
        lambda elapsed: np.where(elapsed < 5.0, -3.0, -GRAVITY * np.maximum(elapsed - 6.5, 0)),
    )
    telemetry = in_mode(
        stick(driven(telemetry, 1000.0, fell), STICK_CLOSED, fell), (EVENT + 5.5, "Stabilize")
    )
    telemetry = rolled(knocked(telemetry, fell + 1.9, 150.0), 120.0, fell + 0.5)
    cause = events_and_ending(telemetry)[1].figures["cause"]
    assert cause.code is FailedFirst.HEIGHT_DIVERGED_FIRST
    assert cause.figures["later_cause"].time == approx(fell, abs=0.1)
    assert "; then the pilot closed the throttle at 36.5 s" in cause.sentence


@mark.slow
@mark.parametrize("mode", ["Stabilize"])
def test_where_the_stick_is_the_thrust_no_height_is_followed(mode):
    assert MotionEvent.HEIGHT_DIVERGED not in events_and_ending(height_runaway(mode))[0]


@mark.slow
def test_a_climb_that_the_pilot_asks_for_is_no_divergence():
    telemetry = stick(height_runaway(), 1900)
    assert MotionEvent.HEIGHT_DIVERGED not in events_and_ending(telemetry)[0]


def landing_that_topples():
    """It descends to 0.5 m, and there the pilot closes the throttle: it touches down and rolls over."""
    telemetry = moving(
        instrumented("Stabilize"), lambda elapsed: -1.0 * (elapsed < 9.5) - 2.0 * (elapsed > 9.5)
    )
    touch_down = EVENT + 9.8
    telemetry = driven(stick(telemetry, STICK_CLOSED, touch_down - 0.3), 1000.0, touch_down - 0.3)
    return rolled(knocked(telemetry, touch_down + 0.1, 40.0), 95.0, touch_down)


@mark.slow
def test_a_vehicle_that_topples_as_the_throttle_closes_has_landed():
    events, ending = events_and_ending(landing_that_topples())
    assert ending.code is Ending.TOPPLED_AT_LANDING
    assert ending.figures["cause"].code is FailedFirst.THROTTLE_CLOSED_FIRST
    assert ending.time == approx(EVENT + 9.8, abs=0.3)
    toppled = events[MotionEvent.TOPPLED]
    assert {SensorFact.KNOCKED, SensorFact.LAY_ON_ITS_SIDE} <= witnesses(toppled, Side.FOR)
    assert "switch" not in ending.remedy


@mark.slow
def test_a_vehicle_may_topple_between_two_reports_of_its_landed_state():
    telemetry = moving(instrumented("Stabilize"), lambda elapsed: -1.0 * (elapsed < 9.8))
    touch_down = EVENT + 10.2
    telemetry = driven(stick(telemetry, STICK_CLOSED, touch_down - 0.3), 1000.0, touch_down - 0.3)
    telemetry = rolled(telemetry, 95.0, touch_down)
    time = np.arange(0.3, 76.0, 1.0)
    state = np.where((time > 6.0) & (time < touch_down - 1.0), 2, 1)
    reported = changed(telemetry, "EXTENDED_SYS_STATE", **columns(time, landed_state=state))
    assert MotionEvent.TOPPLED in events_and_ending(reported)[0]


def failsafe_in_the_air():
    """A radio failsafe stops the motors at 10 m; the vehicle rolls over as it falls."""
    telemetry = moving(instrumented(), climb_rate_of_fall)
    telemetry = driven(telemetry, 1000.0)
    telemetry = rolled(telemetry, 110.0, EVENT + 0.3, 1.0)
    telemetry = knocked(telemetry, EVENT + 1.43, 150.0)
    return saying(telemetry, EVENT - 0.05, "Radio Failsafe - Disarming")


@mark.slow
def test_a_failsafe_that_stops_the_motors_in_the_air_is_the_cause():
    _, ending = events_and_ending(failsafe_in_the_air())
    cause = ending.figures["cause"]
    assert cause.code is FailedFirst.FAILSAFE_FIRST
    assert cause.figures["cause"].code is ReportedEvent.RADIO_LOST
    assert ending.figures["height"] == approx(10.0, abs=1.5)


@mark.slow
def test_a_radio_that_was_lost_until_the_motors_stopped_is_the_reason():
    """The receiver of the remote control reports no signal from 3 s before the failsafe on."""
    telemetry = changed(failsafe_in_the_air(), "STATUSTEXT", text=np.array(["Hello"]))
    time = np.arange(0.0, 76.0, 0.1)
    is_lost = (time > EVENT - 3.0) & (time < EVENT + 5.0)
    pulse = np.where(is_lost, 900.0, STICK_MIDDLE)
    telemetry = changed(
        telemetry, "RC_CHANNELS", **columns(time, chan3_raw=pulse, rssi=np.where(is_lost, 0, 200))
    )
    lost = columns(time, onboard_control_sensors_health=np.where(is_lost, 0, 1 << 16))
    sensor_masks = dict.fromkeys(
        ("onboard_control_sensors_present", "onboard_control_sensors_enabled"), 1 << 16
    )
    _, ending = events_and_ending(changed(telemetry, "SYS_STATUS", **lost, **sensor_masks))
    cause = ending.figures["cause"]
    assert cause.code is FailedFirst.FAILSAFE_FIRST
    assert cause.figures["cause"].code is ReportedEvent.RADIO_LOST


@mark.slow
def test_a_throttle_that_the_pilot_closes_in_the_air_is_the_cause():
    telemetry = changed(failsafe_in_the_air(), "STATUSTEXT", text=np.array(["Hello"]))
    _, ending = events_and_ending(stick(telemetry, STICK_CLOSED))
    assert ending.figures["cause"].code is FailedFirst.THROTTLE_CLOSED_FIRST


@mark.slow
@mark.parametrize("text", ["Hello", "Battery 1 low voltage"])
def test_a_throttle_closed_after_the_motors_stopped_is_no_cause(text):
    telemetry = stick(saying(failsafe_in_the_air(), EVENT, text), STICK_CLOSED, EVENT + 1.2)
    _, ending = events_and_ending(telemetry)
    assert ending.figures["cause"].code is not FailedFirst.THROTTLE_CLOSED_FIRST


@mark.slow
def test_a_warning_of_a_low_battery_does_not_outrank_the_closed_throttle():
    telemetry = saying(failsafe_in_the_air(), EVENT, "Battery 1 low voltage")
    _, ending = events_and_ending(stick(telemetry, STICK_CLOSED))
    assert ending.figures["cause"].code is FailedFirst.THROTTLE_CLOSED_FIRST


@mark.slow
def test_a_pilot_who_closes_the_throttle_once_it_topples_is_no_cause():
    telemetry = moving(instrumented("Stabilize"), lambda elapsed: -1.0 * (elapsed < 9.8))
    touch_down = EVENT + 9.8
    telemetry = driven(stick(telemetry, STICK_CLOSED, touch_down + 1.0), 1000.0, touch_down + 1.0)
    telemetry = rolled(knocked(telemetry, touch_down + 0.1, 40.0), 95.0, touch_down)
    _, ending = events_and_ending(telemetry)
    assert (ending.code, ending.figures["cause"]) == (Ending.TOPPLED_AT_LANDING, None)


@mark.slow
def test_a_throttle_closed_after_the_contact_does_not_loosen_the_limits_of_a_landing():
    """It drops from 2 m at 4 m/s: with a throttle closed before that is a landing, and else an impact."""
    touch_down = EVENT + 8.5
    codes = []
    for closing in (-0.5, 1.0):
        telemetry = moving(
            instrumented("Stabilize"),
            lambda elapsed: np.select([elapsed < 8, elapsed < 8.5], [-1.0, -4.0]),
        )
        telemetry = driven(stick(telemetry, STICK_CLOSED, touch_down + closing), 1000.0, touch_down)
        telemetry = rolled(knocked(telemetry, touch_down + 0.1, 40.0), 95.0, touch_down)
        codes.append(events_and_ending(telemetry)[1].code)
    assert codes == [Ending.TOPPLED_AT_LANDING, Ending.CRASHED]


@mark.slow
@mark.parametrize("volts, is_cause", [(14.0, False), (11.0, True)])
def test_an_alarm_of_the_battery_explains_a_stop_only_with_an_empty_battery(volts, is_cause):
    telemetry = changed(failsafe_in_the_air(), "STATUSTEXT", text=np.array(["Hello"]))
    telemetry = only(telemetry, lambda time: time < 0, "RC_CHANNELS")
    time = np.arange(0.0, 60.0, 0.5)
    voltage = np.where(time < EVENT - 10.0, 16.6, volts)
    charge = np.where(time < EVENT, 1, 3)
    battery = columns(time, voltage_battery=1000 * voltage, charge_state=charge)
    cause = events_and_ending(changed(telemetry, "SYS_STATUS", **battery))[1].figures["cause"]
    code = FailedFirst.FAILSAFE_FIRST if is_cause else FailedFirst.ALL_OFF_FIRST
    assert cause.code is code


def dive():
    """With the throttle closed it falls for 0.8 s, and the motors stop it within as long."""
    telemetry = moving(
        instrumented("Stabilize"),
        lambda elapsed: -GRAVITY * np.interp(elapsed, [0.0, 0.8, 1.6], [0.0, 0.8, 0.0]),
    )
    return driven(stick(telemetry, STICK_CLOSED, EVENT, EVENT + 0.8), 1000.0, EVENT, EVENT + 0.8)


@mark.slow
def test_a_dive_that_the_pilot_ends_is_no_crash():
    events, ending = events_and_ending(dive())
    assert ending is None
    assert MotionEvent.HIT not in events
    dived = events[MotionEvent.DIVED]
    assert dived.level is Level.GOOD
    assert dived.figures["speed"] == approx(7.8, abs=1.5)
    assert SensorFact.THROTTLE_CLOSED in witnesses(dived, Side.FOR)


@mark.slow
def test_without_a_stick_nobody_knows_that_the_pilot_dived():
    dived = events_and_ending(only(dive(), lambda time: time < 0, "RC_CHANNELS"))[0][
        MotionEvent.DIVED
    ]
    assert SensorFact.MOTORS_THROTTLED in witnesses(dived, Side.FOR)
    assert SensorFact.THROTTLE_CLOSED not in witnesses(dived, Side.FOR)


def test_a_pose_by_the_attitude_is_no_second_witness_of_the_attitude():
    attitude_left_setpoint = supporting_fact(SensorFact.ATTITUDE_LEFT_SETPOINT, angle=1.0)
    poses = [Rest(0.0, 1.5, source).pose_facts[0] for source in (ATTITUDE, ACCELEROMETER)]
    assert [support_count([attitude_left_setpoint, pose]) for pose in poses] == [1, 2]
    assert "by the attitude" in poses[0].sentence


def impact(speed=6.0):
    """It sinks so fast, m/s, until it hits the ground upright, and lies there."""
    seconds = 10.0 / speed
    telemetry = moving(instrumented("Stabilize"), lambda elapsed: -speed * (elapsed < seconds))
    return driven(knocked(telemetry, EVENT + seconds), 1000.0, EVENT + seconds)


@mark.slow
def test_an_impact_has_a_knock_a_descent_and_rest_as_witnesses():
    events, ending = events_and_ending(impact())
    assert ending.code is Ending.CRASHED
    assert ending.figures["speed"] == approx(6.0, abs=1.0)
    hit = events[MotionEvent.HIT]
    assert {SensorFact.KNOCKED, SensorFact.SANK, SensorFact.RESTED} <= witnesses(hit, Side.FOR)
    assert witnesses(hit, Side.AGAINST) == {SensorFact.STOOD_UPRIGHT}
    assert ending.figures["witnesses"] == hit.figures["witnesses"]


@mark.slow
def test_the_speed_of_an_impact_is_the_one_at_its_end_and_not_of_the_fall_before():
    """It falls at 7 m/s, and the pilot brakes it to 3.5 m/s before the ground."""
    telemetry = moving(
        instrumented("Stabilize"),
        lambda elapsed: np.interp(
            elapsed, [0.0, 0.2, 0.4, 1.0, 1.6, 1.61], [0, -5, -7, -7, -3.5, 0]
        ),
    )
    telemetry = driven(knocked(telemetry, EVENT + 1.6, 60.0), 1000.0, EVENT + 1.6)
    events, ending = events_and_ending(telemetry)
    assert events[MotionEvent.HIT].figures["speed"] == approx(4.5, abs=1.1)
    assert ending.figures["speed"] == events[MotionEvent.HIT].figures["speed"]


@mark.slow
@mark.parametrize(
    "mode, pulse, is_cause",
    [("Stabilize", 1150, True), ("Stabilize", 1450, False), ("Alt hold", 1150, False)],
)
def test_a_throttle_lowered_before_an_impact_is_its_cause(mode, pulse, is_cause):
    """It falls at 6 m/s after the pilot lowered the throttle for a second, and opened it again."""
    ground = EVENT + 10.0 / 6.0
    telemetry = moving(instrumented(mode), lambda elapsed: -6.0 * (elapsed < 10.0 / 6.0))
    telemetry = stick(telemetry, pulse, EVENT - 0.5, EVENT + 0.5)
    telemetry = driven(knocked(telemetry, ground), 1000.0, ground)
    _, ending = events_and_ending(telemetry)
    assert ending.code is Ending.CRASHED
    cause = ending.figures["cause"]
    if is_cause:
        assert cause.code is FailedFirst.THROTTLE_LOWERED_FIRST
        assert (cause.time, cause.end_time) == (
            approx(EVENT - 0.5, abs=0.15),
            approx(EVENT + 0.5, abs=0.15),
        )
        assert "lowered the throttle to 15 % from" in ending.sentence
    else:
        assert cause is None


@mark.slow
def test_an_impact_is_at_the_first_knock_and_its_event_and_ending_agree():
    """At 2.5 m it begins to tumble, hits the ground 0.6 s later, and harder once more after that."""
    tumble = EVENT + 7.5
    telemetry = moving(
        instrumented("Stabilize"),
        lambda elapsed: np.interp(elapsed, [0.0, 7.5, 7.51, 8.1], [-1.0, -1.0, -1.0, -7.0]),
    )
    telemetry = stick(driven(telemetry, 1000.0, tumble + 0.6), 1800)
    telemetry = rolled(telemetry, 170.0, tumble, 0.8)
    telemetry = knocked(knocked(telemetry, tumble + 0.6, 50.0), tumble + 0.9, 90.0)
    events, ending = events_and_ending(telemetry)
    hit = events[MotionEvent.HIT]
    assert hit.time == ending.time == approx(tumble + 0.6, abs=0.05)
    assert ending.figures["onset"] == approx(tumble, abs=0.3)
    assert "hit the ground at 38.1 s" in hit.sentence
    assert ending.sentence.startswith("Hit the ground at 38.1 s")


@mark.slow
def test_the_slope_of_a_barometer_does_not_contradict_a_short_fall():
    """It falls freely for 1.4 s from 10 m, and its estimate goes on falling."""
    telemetry = moving(instrumented(), climb_rate_of_fall)
    telemetry = rolled(driven(telemetry, 1000.0), 110.0, EVENT + 0.3, 1.0)
    telemetry = knocked(telemetry, EVENT + 1.43, 150.0)
    position = telemetry.messages["LOCAL_POSITION_NED"]
    goes_on = position["time"] > EVENT + 1.43
    telemetry = changed(telemetry, "LOCAL_POSITION_NED", vz=np.where(goes_on, 12.0, position["vz"]))
    events, _ = events_and_ending(telemetry)
    for code in (MotionEvent.HIT, MotionEvent.FELL):
        assert events[code].figures["speed"] == approx(13.5, abs=1.0)


@mark.slow
@mark.parametrize("pulse, is_spent", [(2000, True), (1500, False)])
def test_a_vehicle_that_sinks_at_full_throttle_with_a_motor_at_its_limit_lacks_thrust(
    pulse, is_spent
):
    """The vehicle sinks at 4 m/s with motor 2 at its limit, and the stick at full or half throttle."""
    ground = EVENT + 10.0 / 4.0
    telemetry = moving(instrumented("Stabilize"), lambda elapsed: -4.0 * (elapsed < 2.5))
    outputs = pulses(telemetry)
    is_sinking = (stamps(telemetry, "SERVO_OUTPUT_RAW") > EVENT) & (
        stamps(telemetry, "SERVO_OUTPUT_RAW") < ground
    )
    outputs[1] = np.where(is_sinking, 2000.0, outputs[1])
    telemetry = stick(with_pulses(telemetry, outputs), pulse, EVENT, ground)
    telemetry = driven(knocked(telemetry, ground), 1000.0, ground)
    _, ending = events_and_ending(telemetry)
    cause = ending.figures["cause"]
    assert (cause is not None and "sank at full throttle" in cause.sentence) is is_spent


@mark.slow
@mark.parametrize(
    "pulse, climb, level, is_full",
    [(2000, 3.0, "good", True), (2000, 0.0, "watch", True), (1500, 3.0, "watch", False)],
)
def test_a_motor_at_its_limit_at_full_throttle_is_to_be_watched_only_without_a_climb(
    pulse, climb, level, is_full
):
    """Motor 2 is at its limit for 2 s; at full throttle in a climb that is normal."""
    telemetry = moving(instrumented("Stabilize"), lambda elapsed: climb * (elapsed < 2.0))
    outputs = pulses(telemetry)
    time = stamps(telemetry, "SERVO_OUTPUT_RAW")
    outputs[1] = np.where((time > EVENT) & (time < EVENT + 2.0), 2000.0, outputs[1])
    telemetry = stick(with_pulses(telemetry, outputs), pulse, EVENT, EVENT + 2.0)
    limit = events_and_ending(telemetry)[0][MotionEvent.MOTOR_AT_ITS_STOP]
    assert (limit.level, "at full throttle" in limit.sentence) == (level, is_full)
    assert ("while the vehicle" in limit.sentence) is is_full
    assert ("motor 2" in limit.remedy) is not is_full


@mark.parametrize("seconds, share", [(2.5, None), (5.0, "100 %")])
def test_two_slow_samples_at_the_limit_are_no_event(seconds, share):
    """Outputs come every 1.6 s: two of them are at the limit, or three."""
    telemetry = instrumented("Stabilize")
    outputs = pulses(telemetry)
    time = stamps(telemetry, "SERVO_OUTPUT_RAW")
    slow = np.searchsorted(time, np.arange(EVENT - 16.0, EVENT + 16.0, 1.6))
    outputs[1] = np.where((time >= EVENT - 0.1) & (time < EVENT + seconds), 2000.0, outputs[1])
    fast_outputs = with_pulses(telemetry, outputs).messages["SERVO_OUTPUT_RAW"]
    slow_outputs = selected_rows(fast_outputs, slow)
    messages = {**telemetry.messages, "SERVO_OUTPUT_RAW": slow_outputs}
    events, _ = events_and_ending(replace(telemetry, messages=messages))
    if share is None:
        assert MotionEvent.MOTOR_AT_ITS_STOP not in events
    else:
        limit = events[MotionEvent.MOTOR_AT_ITS_STOP]
        assert (
            f"at its upper limit in {share} of its samples, one every 1.6 s, from" in limit.sentence
        )


@mark.slow
def test_a_descent_faster_than_a_free_fall_from_that_height_is_no_witness():
    telemetry = impact()
    position = telemetry.messages["LOCAL_POSITION_NED"]
    runs_away = (position["time"] > EVENT + 1.2) & (position["time"] < EVENT + 2.5)
    telemetry = changed(
        telemetry, "LOCAL_POSITION_NED", vz=np.where(runs_away, 41.0, position["vz"])
    )
    hit = events_and_ending(telemetry)[0][MotionEvent.HIT]
    sources = [
        fact.figures["source"] for fact in hit.figures["witnesses"] if fact.code is SensorFact.SANK
    ]
    assert sources == ["barometer"]
    assert hit.figures["speed"] < 10


@mark.slow
@mark.parametrize(
    "mode, angle, period, swings",
    [
        ("Auto", 40.0, 2.4, True),
        ("Loiter", 40.0, 2.4, False),
        ("Auto", 15.0, 2.4, False),
        ("Auto", 40.0, 8.0, False),
    ],
)
def test_a_vehicle_that_an_automatic_mode_leans_to_and_fro_swings(mode, angle, period, swings):
    """The setpoint and the attitude swing together about pitch.

    A mode that a pilot steers, a small angle and a long period give no event.
    """
    telemetry = instrumented(mode)
    elapsed = stamps(telemetry, "ATTITUDE") - EVENT
    is_swinging = (elapsed > 0) & (elapsed < 4 * period)
    lean = np.radians(angle) * np.sin(2 * np.pi * elapsed / period) * is_swinging
    telemetry = changed(telemetry, "ATTITUDE", pitch=lean, pitchspeed=np.gradient(lean, elapsed))
    telemetry = changed(telemetry, "ATTITUDE_TARGET", q=quaternion(0 * lean, lean, 0 * lean))
    events, ending = events_and_ending(telemetry)
    assert ending is None
    assert (MotionEvent.ATTITUDE_SWUNG in events) is swings
    if swings:
        swung = events[MotionEvent.ATTITUDE_SWUNG]
        assert (swung.subject, swung.figures["count"]) == ("pitch", 8)
        assert swung.level is Level.WATCH
        assert swung.figures["period"] == approx(period, abs=0.1)
        assert swung.sentence.startswith("Pitch swung by up to 40° in")
        # The vehicle rolls to one side meanwhile, which is no swing of its own.
        roll = np.radians(30.0) * ((elapsed > period) & (elapsed < 1.5 * period))
        telemetry = changed(telemetry, "ATTITUDE", roll=roll, rollspeed=np.gradient(roll, elapsed))
        telemetry = changed(telemetry, "ATTITUDE_TARGET", q=quaternion(roll, lean, 0 * lean))
        swung = events_and_ending(telemetry)[0][MotionEvent.ATTITUDE_SWUNG]
        assert swung.sentence.startswith("Pitch swung by up to 40° (roll by up to 30°) in")
        assert "position controller" in swung.remedy


@mark.slow
@mark.parametrize(
    "path_share, lead, level",
    [
        (0.8, 0.3, Level.GOOD),
        (0.3, 0.3, Level.WATCH),
        (0.8, -0.3, Level.WATCH),
        (0.0, 0.3, Level.WATCH),
    ],
)
def test_a_swing_is_good_if_a_path_ahead_of_it_commands_most_of_it(path_share, lead, level):
    """The position setpoint sways so that it needs a share of the lean, ahead of it by ``lead``, s, or behind it."""
    telemetry = instrumented("Auto")
    period = 2.4
    frequency = 2 * np.pi / period
    elapsed = stamps(telemetry, "ATTITUDE") - EVENT
    is_swinging = (elapsed > 0) & (elapsed < 4 * period)
    lean = np.radians(30.0) * np.sin(frequency * elapsed) * is_swinging
    telemetry = changed(telemetry, "ATTITUDE", pitch=lean, pitchspeed=np.gradient(lean, elapsed))
    telemetry = changed(telemetry, "ATTITUDE_TARGET", q=quaternion(0 * lean, lean, 0 * lean))
    # With a heading of 0, the nose up slows the vehicle down: a pitch of sin(wt) needs north = sin(wt).
    time = stamps(telemetry, "LOCAL_POSITION_NED")
    acceleration = 9.81 * np.tan(path_share * np.radians(30.0))
    north = acceleration / frequency**2 * np.sin(frequency * (time - EVENT + lead))
    path = columns(time, x=north, y=0.0, z=-10.0, vx=0.0, vy=0.0, vz=0.0)
    telemetry = changed(telemetry, "POSITION_TARGET_LOCAL_NED", **path)
    swung = events_and_ending(telemetry)[0][MotionEvent.ATTITUDE_SWUNG]
    assert swung.level is level
    assert ("commanded by a path" in swung.sentence) is (level is Level.GOOD)
    if level is Level.GOOD:
        assert np.degrees(swung.figures["commanded_angle"]) == approx(24.0 * 0.8, abs=2.0)


def test_a_path_at_constant_speed_needs_no_lean_wherever_it_is_or_begins():
    """A stamp of a month later must not need memory for each moment until then."""
    telemetry = instrumented("Auto")
    time = np.append(np.arange(20.0, 40.0, 0.1), 2.6e6)
    path = columns(time, x=2.0 * time, y=5e3, z=-10.0, vx=2.0, vy=0.0, vz=0.0)
    telemetry = replace(
        telemetry, messages={**telemetry.messages, "POSITION_TARGET_LOCAL_NED": path}
    )
    signals = Signals(telemetry)
    assert abs(path_leans(signals, 0, attitude_tracking(signals, 0))).max() < 1e-6


@mark.slow
def test_a_swing_far_from_the_setpoint_is_no_matter_of_the_position_controller():
    """The setpoint stays level, while the vehicle leans by 50° to both sides: that is bad, though it came back."""
    telemetry = instrumented("Auto")
    elapsed = stamps(telemetry, "ATTITUDE") - EVENT
    is_swinging = (elapsed > 0) & (elapsed < 9.6)
    lean = np.radians(50.0) * np.sin(2 * np.pi * elapsed / 2.4) * is_swinging
    telemetry = changed(telemetry, "ATTITUDE", pitch=lean, pitchspeed=np.gradient(lean, elapsed))
    swung = events_and_ending(telemetry)[0][MotionEvent.ATTITUDE_SWUNG]
    assert np.degrees(swung.figures["angle_error"]) == approx(50.0, abs=1.0)
    assert swung.is_bad
    assert "up to 50° beyond its setpoints of the second before" in swung.sentence
    assert "gains of the attitude controller" in swung.remedy
    assert "position controller" not in swung.remedy


@mark.slow
@mark.parametrize("speed, code", [(0.0, Ending.CONTROL_LOST), (6.0, Ending.CRASHED)])
def test_a_knock_in_the_air_is_a_contact_only_where_it_takes_the_speed(speed, code):
    """At 10 m a propeller breaks with a knock, or the vehicle flies at 6 m/s against a tree; then it falls."""
    telemetry = moving(
        instrumented(), lambda elapsed: climb_rate_of_fall(np.maximum(elapsed - 0.5, 0))
    )
    position = telemetry.messages["LOCAL_POSITION_NED"]
    telemetry = changed(
        telemetry, "LOCAL_POSITION_NED", vx=np.where(position["time"] < EVENT + 0.1, speed, 0.0)
    )
    telemetry = rolled(driven(telemetry, 1000.0, EVENT + 0.6), 110.0, EVENT + 0.1, 0.8)
    telemetry = knocked(knocked(telemetry, EVENT + 0.1, 90.0), EVENT + 1.93, 60.0)
    _, ending = events_and_ending(telemetry)
    assert ending.code is code
    assert ending.time == approx(EVENT + 0.1, abs=0.4)


def left_running(seconds):
    """After an impact the motors run on for so long, s, while the vehicle lies still with its nose down."""
    impact_time = EVENT + 10.0 / 6.0
    telemetry = driven(impact(), 1500.0, impact_time, impact_time + seconds)
    time = stamps(telemetry, "ATTITUDE")
    return changed(telemetry, "ATTITUDE", pitch=np.where(time > impact_time, -1.0, 0.0))


@mark.slow
@mark.parametrize("seconds, is_left_running", [(2.0, False), (12.0, True)])
def test_motors_that_run_on_after_an_impact_are_an_event(seconds, is_left_running):
    events, ending = events_and_ending(left_running(seconds))
    assert ending.code is Ending.CRASHED
    assert (MotionEvent.MOTORS_RAN_ON in events) is is_left_running
    if is_left_running:
        event = events[MotionEvent.MOTORS_RAN_ON]
        assert event.figures["duration"] == approx(seconds, abs=0.5)
        assert "to the end of the record" not in event.sentence


@mark.slow
def test_motors_that_run_again_after_a_pause_of_the_record_were_not_left_running():
    telemetry = left_running(np.inf)
    elapsed = stamps(telemetry, "SERVO_OUTPUT_RAW") - EVENT
    recorded_columns = selected_rows(
        telemetry.messages["SERVO_OUTPUT_RAW"], (elapsed < 3.0) | (elapsed > 10.0)
    )
    messages = {**telemetry.messages, "SERVO_OUTPUT_RAW": recorded_columns}
    events, _ = events_and_ending(replace(telemetry, messages=messages))
    assert MotionEvent.MOTORS_RAN_ON not in events


@mark.slow
@mark.parametrize("crash_check", [0.0, 1.0])
def test_the_advice_on_motors_left_running_knows_the_crash_check(crash_check):
    telemetry = left_running(np.inf)
    parameters = {**telemetry.parameters, "FS_CRASH_CHECK": crash_check}
    events, _ = events_and_ending(replace(telemetry, parameters=parameters))
    event = events[MotionEvent.MOTORS_RAN_ON]
    assert "to the end of the record" in event.sentence
    assert ("although FS_CRASH_CHECK is 1" in event.sentence) is (crash_check == 1.0)
    assert ("with FS_CRASH_CHECK 1" in event.remedy) is (crash_check == 0.0)


@mark.slow
@mark.parametrize(
    "turns, commanded_turns, spins",
    [(3.0, 0.0, True), (3.0, -3.0, True), (3.0, 3.0, False), (0.6, 0.0, False)],
)
def test_a_turn_beyond_the_yaw_command_is_a_spin(turns, commanded_turns, spins):
    """It yaws for 6 s, with a setpoint of the rate that stays, turns to the other side or turns with it."""
    telemetry = instrumented()
    time = stamps(telemetry, "ATTITUDE")
    rate = 2 * np.pi / 6.0 * ((time > EVENT) & (time < EVENT + 6.0))
    heading = wrapped_angle(np.cumsum(turns * rate) * np.median(np.diff(time)))
    telemetry = changed(telemetry, "ATTITUDE", yaw=heading, yawspeed=turns * rate)
    target = {"type_mask": 0, "body_yaw_rate": commanded_turns * rate}
    events, _ = events_and_ending(changed(telemetry, "ATTITUDE_TARGET", **target))
    assert (MotionEvent.SPUN in events) is spins
    if spins:
        spun = events[MotionEvent.SPUN]
        assert spun.figures["turns"] == approx(turns, abs=0.1)
        assert "to the right" in spun.sentence


@mark.slow
def test_what_was_not_recorded_between_two_turns_is_no_spin():
    """It yaws at 40 °/s for a second before and after half a minute without attitude."""
    telemetry = instrumented()
    time = stamps(telemetry, "ATTITUDE")
    is_turning = (time > 29.0) & (time < 61.0)
    telemetry = changed(telemetry, "ATTITUDE", yawspeed=np.where(is_turning, 0.7, 0.0))
    telemetry = changed(telemetry, "ATTITUDE_TARGET", type_mask=0, body_yaw_rate=0.0)
    columns_with_gap = selected_rows(telemetry.messages["ATTITUDE"], (time < 30.0) | (time > 60.0))
    with_gap = replace(telemetry, messages={**telemetry.messages, "ATTITUDE": columns_with_gap})
    assert MotionEvent.SPUN in events_and_ending(telemetry)[0]
    assert MotionEvent.SPUN not in events_and_ending(with_gap)[0]


@mark.slow
def test_a_slow_drift_between_two_fast_turns_is_no_spin():
    """It drifts by 1.3 turns at 9 °/s, and yaws at 30 °/s for a second before and after."""
    telemetry = instrumented()
    elapsed = stamps(telemetry, "ATTITUDE") - 10.0
    is_fast = (elapsed % 52.0 > 0.0) & (elapsed % 52.0 < 1.0)
    rate = np.radians(np.where(is_fast, 30.0, 9.0)) * ((elapsed > 0.0) & (elapsed < 53.0))
    telemetry = changed(telemetry, "ATTITUDE", yawspeed=rate)
    telemetry = changed(telemetry, "ATTITUDE_TARGET", type_mask=0, body_yaw_rate=0.0)
    assert MotionEvent.SPUN not in events_and_ending(telemetry)[0]


@mark.slow
def test_a_hard_landing_upright_is_to_be_watched():
    events, ending = events_and_ending(impact(2.5))
    assert ending is None
    assert events[MotionEvent.LANDED_HARD].level is Level.WATCH
    assert "sinking" in events[MotionEvent.LANDED_HARD].sentence
    assert "sinking" not in Fact(MotionEvent.LANDED_HARD, time=3.0, speed=0.04).sentence


@mark.slow
def test_an_estimate_that_sinks_at_rest_shows_no_speed_of_a_landing():
    sound = impact(2.5)
    position = sound.messages["LOCAL_POSITION_NED"]
    is_at_rest = position["time"] < flights_in_boot(Signals(sound, inputs="motors"), 0)[0][0]
    telemetry = changed(sound, "LOCAL_POSITION_NED", vz=np.where(is_at_rest, 2.0, position["vz"]))
    sources = []
    for log in (sound, telemetry):
        events, _ = events_and_ending(log)
        sources.append(events[MotionEvent.LANDED_HARD].figures["speed_source"])
    assert sources == [HeightSource.ESTIMATE, HeightSource.BAROMETER]


@mark.slow
def test_a_knock_at_the_take_off_does_not_hide_a_hard_landing():
    """The vehicle is knocked harder when it lands than 21 s before, by a force that no vibration reaches."""
    telemetry = knocked(impact(2.5), 9.0, 35.0)
    events, _ = events_and_ending(knocked(telemetry, EVENT + 4.0, 40.0))
    assert MotionEvent.LANDED_HARD in events


@mark.slow
@mark.parametrize("knock, is_hard", [(36.0, False), (80.0, True)])
def test_the_largest_force_of_strong_vibration_is_no_hard_landing(knock, is_hard):
    """It shakes by a normal force, by up to 35 m/s² in flight, and a little more close to the ground."""
    telemetry = impact(2.5)
    time = stamps(telemetry, "HIGHRES_IMU")
    peaks = 20.0 + 4.0 * np.random.default_rng(1).standard_normal(len(time))
    is_shaking = (time > 8.0) & (time < EVENT + 4.0)
    force = telemetry.messages["HIGHRES_IMU"]["zacc"]
    shaken = changed(telemetry, "HIGHRES_IMU", zacc=np.where(is_shaking, -peaks, force))
    events, _ = events_and_ending(knocked(shaken, EVENT + 4.0, knock))
    assert (MotionEvent.LANDED_HARD in events) is is_hard


def test_the_contact_of_a_flight_whose_take_off_was_not_received_is_at_its_knock():
    signals = Signals(knocked(impact(2.5), EVENT + 4.0, 80.0), inputs="motors")
    search = ContactSearch(BootSensors(signals, 0, -inf), flight_start=-inf, loss=None)
    assert search.contact_time(EVENT + 2.0, EVENT + 6.0) == approx(EVENT + 4.0, abs=0.05)


@mark.slow
def test_a_setpoint_that_nothing_follows_is_no_tumble():
    """The attitude is 60° from its setpoint, but neither gyro nor height moves."""
    telemetry = instrumented("Stabilize")
    targets = telemetry.messages["ATTITUDE_TARGET"]["q"].copy()
    is_away = stamps(telemetry, "ATTITUDE_TARGET") > EVENT
    targets[is_away] = [np.cos(0.5), np.sin(0.5), 0.0, 0.0]
    telemetry = only(
        changed(telemetry, "ATTITUDE_TARGET", q=targets), lambda time: time < EVENT + 4.0
    )
    events, ending = events_and_ending(telemetry)
    assert ending is None
    lost = events[MotionEvent.ATTITUDE_LOST]
    assert lost.level is Level.WATCH
    assert "no other sensor confirms" in lost.sentence
    assert SensorFact.DID_NOT_ROTATE in witnesses(lost, Side.AGAINST)


def without_position(telemetry, seconds):
    """The estimator has no position for so many seconds."""
    time = stamps(telemetry, "LOCAL_POSITION_NED")
    is_valid = (time < EVENT) | (time > EVENT + seconds)
    return changed(telemetry, "LOCAL_POSITION_NED", valid=is_valid)


@mark.slow
def test_a_position_that_is_lost_for_long_and_a_blind_land_is_bad():
    telemetry = in_mode(without_position(instrumented(), 18.0), (EVENT + 1.0, "Land"))
    lost = events_and_ending(telemetry)[0][MotionEvent.POSITION_LOST]
    assert lost.level is Level.BAD
    assert (lost.time, lost.figures["duration"]) == approx((EVENT, 18.0), abs=0.3)
    assert SensorFact.MODE_CHANGED in witnesses(lost, Side.FOR)


@mark.slow
@mark.parametrize("seconds, is_lost", [(4.0, False), (6.0, True)])
def test_a_position_that_is_lost_for_five_seconds_is_an_event(seconds, is_lost):
    events, _ = events_and_ending(without_position(instrumented(), seconds))
    assert (MotionEvent.POSITION_LOST in events) is is_lost
    if is_lost:
        assert events[MotionEvent.POSITION_LOST].level is Level.WATCH


@mark.slow
def test_a_position_that_never_comes_back_is_lost_to_the_end_of_the_flight():
    telemetry = without_position(instrumented(), 1000.0)
    no_fix = columns(stamps(telemetry, "LOCAL_POSITION_NED"), fix_type=0)
    no_fix["fix_type"] = np.where(no_fix["time"] >= EVENT, 1, 3)
    lost = events_and_ending(changed(telemetry, "GPS_RAW_INT", **no_fix))[0][
        MotionEvent.POSITION_LOST
    ]
    assert f"from {lost.time:.1f} s to the end of the flight" in lost.sentence
    # Its reasons do not end with the landing either.
    assert [reason.end_time for reason in lost.figures["witnesses"]] == [None, None]
    assert all(
        f"from {lost.time:.1f} s on" in str(witness) for witness in lost.figures["witnesses"]
    )


@mark.slow
def test_flags_that_flicker_before_a_loss_do_not_hide_it():
    telemetry = without_position(instrumented(), 18.0)
    is_valid = telemetry.messages["LOCAL_POSITION_NED"]["valid"].copy()
    is_valid[abs(stamps(telemetry, "LOCAL_POSITION_NED") - (EVENT - 2.0)) < 0.5] = False
    lost = events_and_ending(changed(telemetry, "LOCAL_POSITION_NED", valid=is_valid))[0][
        MotionEvent.POSITION_LOST
    ]
    assert (lost.time, lost.figures["duration"]) == approx((EVENT, 18.0), abs=0.3)


def without_fix(*receivers):
    """The receivers of these messages have no fix for 10 s; no message says what the estimator had."""
    telemetry = instrumented()
    time = stamps(telemetry, "LOCAL_POSITION_NED")
    is_lost = (time > EVENT) & (time < EVENT + 10.0)
    for message in ("GPS_RAW_INT", "GPS2_RAW"):
        fix_type = np.where(is_lost & (message in receivers), 1, 3)
        telemetry = changed(telemetry, message, **columns(time, fix_type=fix_type))
    return telemetry


@mark.slow
def test_receivers_without_a_fix_alone_do_not_speak_for_the_estimator():
    lost = events_and_ending(without_fix("GPS_RAW_INT", "GPS2_RAW"))[0][MotionEvent.POSITION_LOST]
    assert lost.level is Level.WATCH
    assert witnesses(lost, Side.FOR) == {SensorFact.NO_FIX}


@mark.slow
def test_a_second_receiver_with_a_fix_holds_the_position():
    assert MotionEvent.POSITION_LOST not in events_and_ending(without_fix("GPS_RAW_INT"))[0]


@mark.slow
def test_a_crash_that_only_the_autopilot_reports_is_to_be_watched():
    telemetry = saying(instrumented(), EVENT, "Crash: Disarming")
    events, ending = events_and_ending(telemetry)
    assert ending is None
    assert events[ReportedEvent.CRASH_DETECTED].level is Level.WATCH
    _, ending = events_and_ending(saying(impact(), EVENT + 3.0, "Crash: Disarming"))
    assert ending.code is Ending.CRASHED


@mark.slow
def test_a_reported_crash_that_no_sensor_could_show_counts():
    sensors = ("ATTITUDE", "LOCAL_POSITION_NED", "SCALED_PRESSURE", "HIGHRES_IMU")
    telemetry = only(instrumented(), lambda time: time < EVENT - 11.0, *sensors)
    events, _ = events_and_ending(saying(telemetry, EVENT, "Crash: Disarming"))
    assert events[ReportedEvent.CRASH_DETECTED].level is Level.BAD


def bench():
    """Motors run on a bench: nothing rises, nothing turns."""
    telemetry = instrumented()
    time = stamps(telemetry, "LOCAL_POSITION_NED")
    telemetry = changed(telemetry, "LOCAL_POSITION_NED", vz=0.0, z=-0.1 * np.sin(time))
    return changed(telemetry, "SCALED_PRESSURE", altitude=120.0 + 0.1 * np.sin(time))


@mark.slow
def test_what_never_flew_has_no_other_event():
    telemetry = knocked(bench(), EVENT)
    events, ending = events_and_ending(telemetry)
    assert ending is None
    assert [code for code in events if isinstance(code, MotionEvent)] == [MotionEvent.NOT_FLOWN]
    assert "barometer stayed within" in events[MotionEvent.NOT_FLOWN].sentence


def test_what_never_flew_took_not_off_whatever_the_estimator_says():
    telemetry = bench()
    time = stamps(telemetry, "LOCAL_POSITION_NED")
    telemetry = changed(telemetry, "LOCAL_POSITION_NED", vz=-0.6, z=-0.6 * time)
    events, _ = events_and_ending(telemetry)
    assert MotionEvent.NOT_FLOWN in events
    assert ReportedEvent.OFF_GROUND not in events and ReportedEvent.ON_GROUND not in events


def test_an_error_without_a_setpoint_is_stated_as_the_lean():
    magnitude = np.radians([1.0, 20.0, 2.0])
    for has_setpoint, angle in ((True, 20.0), (False, 40.0)):
        error = AttitudeError(
            time=np.arange(3.0),
            lean=magnitude.astype(complex),
            magnitude=magnitude,
            is_toppled=np.zeros(3, bool),
            has_setpoint=np.full(3, has_setpoint),
        )
        largest = largest_error(error, (0.0, 2.0))
        assert np.degrees(largest.angle) == approx(angle)
        assert largest_error(error, (5.0, 6.0)) is None
        statement = supporting_fact(SensorFact.ATTITUDE_LEFT_SETPOINT, **largest._asdict())
        assert ("setpoint" in statement.sentence) == has_setpoint


@mark.slow
def test_a_lean_that_was_caught_is_stated_whole_where_no_setpoint_was_logged():
    telemetry = instrumented("Stabilize")
    elapsed = stamps(telemetry, "ATTITUDE") - EVENT
    lean = np.radians(70.0) * ((elapsed > 0) & (elapsed < 1.5))
    telemetry = changed(telemetry, "ATTITUDE", pitch=lean, pitchspeed=np.gradient(lean, elapsed))
    without_setpoint = {
        name: table for name, table in telemetry.messages.items() if name != "ATTITUDE_TARGET"
    }
    events, _ = events_and_ending(replace(telemetry, messages=without_setpoint))
    caught = events[MotionEvent.ATTITUDE_CAUGHT]
    assert np.degrees(caught.figures["angle"]) == approx(70.0)
    assert caught.sentence.startswith("The vehicle leant from")
    assert caught.sentence.endswith("by up to 70°, and came back; its setpoint was not logged.")
