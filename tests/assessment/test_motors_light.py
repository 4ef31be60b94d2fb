"""The light of the motors: the worst of what they lost, their limits, the pattern of their trim, and what is left."""

from dataclasses import replace

import numpy as np
from hover import X_QUAD_PARAMETERS, Hover, changed, columns, evidence_of, with_pulses
from hover import pulses as outputs_of
from numpy.random import default_rng
from pytest import approx, mark

from mavdem.assessment.assess import alarms_before_loss
from mavdem.assessment.event_lights import light_or_warning
from mavdem.assessment.identity import identify_vehicle
from mavdem.assessment.lights import motors
from mavdem.assessment.lights.motors import motors_light
from mavdem.assessment.motor_alarms import motor_alarms
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorsLight, MotorWatchFact, TrimFact
from mavdem.facts.session import SessionFact
from mavdem.motors.motor_changes import thrust_losses
from mavdem.report.templates import headline

HOVER = Hover(hovering=60.0)
FRONT_LEFT = "motor 3 (front left)"


def evidence(pulses=lambda time: 0.0, **options):
    """Returns the evidence of a hover in which the motors' pulses are increased, µs, by (4, N) or one number."""
    telemetry = HOVER.telemetry(10.0, 10.0, parameters=X_QUAD_PARAMETERS)
    usual = outputs_of(telemetry)
    noise = default_rng(3).normal(1500.0, 3.0, usual.shape)
    time = telemetry.messages["SERVO_OUTPUT_RAW"]["time"]
    outputs = np.where(usual > 1000, noise + pulses(time), 1000.0)
    signals = Signals(with_pulses(telemetry, outputs), inputs="motors")
    changes = alarms_before_loss(motor_alarms(signals), options.get("ending"))
    return evidence_of(signals, events=tuple(thrust_losses(changes)), **options)


def weak(begin, end=np.inf):
    """Motor 2 works a quarter harder from ``begin`` to ``end``, s."""
    return lambda time: np.outer([0, 1, 0, 0], 125.0 * ((time > begin) & (time < end)))


@mark.slow
def test_trims_that_shifted_in_flight_are_to_be_watched_and_name_no_motor():
    flight = evidence()
    shift = Fact(MotorWatchFact.STEADY_TORQUE_CHANGED, time=40.0, rise=0.05, boot=0)
    light = motors_light(replace(flight, events=(shift,)))
    assert light == shift and light.level is Level.WATCH
    assert light.remedy.startswith("Check what the vehicle carries, then motors")


@mark.parametrize(
    "load, motor, checked_first", [(0.07, 0.93, "motors"), (0.95, 0.01, "what the vehicle carries")]
)
def test_the_more_probable_cause_of_shifted_trims_is_to_be_checked_first(
    load, motor, checked_first
):
    """A load or a motor is the more probable cause of a steady change of torque."""
    shift = Fact(
        MotorWatchFact.STEADY_TORQUE_CHANGED,
        time=40.0,
        rise=0.05,
        boot=0,
        load_probability=load,
        motor_probability=motor,
    )
    assert shift.remedy.startswith(f"Check {checked_first}, ")


@mark.slow
@mark.parametrize(
    "pulses, code, level",
    [
        (lambda time: 0.0, MotorsLight.MOTORS_EVEN, "good"),
        (lambda time: np.array([[80], [80], [-80], [-80]]), TrimFact.TRIM_OF_YAW, "watch"),
        (weak(40.0), MotorWatchFact.MOTOR_LOST_THRUST, "bad"),
        (weak(30.0, 50.0), MotorWatchFact.MOTOR_LOST_THRUST, "watch"),
        (lambda time: 420.0, MotorsLight.HEADROOM_LITTLE, "watch"),
        # All motors together at full throttle: a climb, and no fault of a motor.
        (lambda time: 600.0 * (time % 10 < 0.8), MotorsLight.HEADROOM_LITTLE, "watch"),
        (lambda time: 600.0 * (time % 10 < 0.35), MotorsLight.HEADROOM_LITTLE, "watch"),
    ],
)
def test_the_light_of_motors_is_the_worst_fact_about_them(pulses, code, level):
    """Motors are even, trimmed in yaw, weak for good or for 20 s, or near their limit."""
    light_fact = motors_light(evidence(pulses))
    assert (light_fact.code, light_fact.level) == (code, level)
    if code is MotorsLight.HEADROOM_LITTLE:
        # All motors are alike.
        assert len(light_fact.figures["names"]) == 4
        # The hover alone takes 90 %, or fast commands take what it leaves.
        is_by_commands = light_fact.figures["trim"] <= 0.8
        assert (" nearly reached their limits at fast " in str(light_fact)) is is_by_commands
        assert (" have " in str(light_fact)) is not is_by_commands
    if code is MotorWatchFact.MOTOR_LOST_THRUST:
        if level == "bad":
            assert light_fact.end_time is None
            assert light_fact.time == approx(40, abs=1.5)
        else:
            assert [light_fact.time, light_fact.end_time] == approx([30, 50], abs=1.5)
        assert light_fact.subject == "motor 2 (rear left)"


@mark.slow
def test_a_motor_that_is_weak_in_the_descent_alone_is_named():
    """The vehicle sinks from 71 s on, so that it is not in settled flight any more."""
    loss = motors_light(evidence(weak(72.0)))
    assert (loss.code, loss.level) == (MotorWatchFact.MOTOR_LOST_THRUST, "bad")
    assert loss.subject == "motor 2 (rear left)" and loss.time == approx(72, abs=1.5)


@mark.slow
def test_a_motor_that_alone_was_long_at_its_limit_is_not_good():
    even = evidence()
    limit = Fact(MotionEvent.MOTOR_AT_ITS_STOP, Level.WATCH, time=72.0, subject=FRONT_LEFT, boot=0)
    for duration, is_shown in ((3.0, False), (15.0, True)):
        event = limit.replace(end_time=72.0 + duration, duration=duration)
        light_fact = motors_light(replace(even, events=(event,)))
        assert (light_fact == event) is is_shown


@mark.slow
def test_where_one_motor_alone_lacks_headroom_the_remedy_is_about_that_motor():
    """As with a propeller that slips on its shaft now and then: for a twentieth of the time it gives less thrust."""
    slips = motors_light(evidence(lambda time: np.outer([0, 0, 1, 0], 450.0 * (time % 10 < 0.5))))
    assert slips.code is MotorsLight.HEADROOM_LITTLE
    assert slips.figures["names"] == (FRONT_LEFT,)
    assert "motor 3, its propeller and the nut first" in slips.remedy
    all_alike = motors_light(evidence(lambda time: 420.0))
    assert "its propeller" not in all_alike.remedy
    # The advice to reduce the load rests on the mean of the hover, and not on what fast commands need.
    assert ("Reduce the load" in all_alike.remedy) is ("in the mean" in str(all_alike))


@mark.slow
@mark.parametrize(
    "headroom_of_third, limit_of_first, is_named",
    [(0.05, 0.0, True), (0.08, 0.0, False), (0.05, 0.004, False)],
)
def test_a_motor_that_differs_as_the_others_do_is_not_to_be_checked_alone(
    headroom_of_third, limit_of_first, is_named
):
    """Gusts move the motors of a sound vehicle unlike, so that one of them comes first below the limit."""
    flight = evidence()
    hover = replace(
        flight.condition.hover,
        headroom=(0.11, 0.14, headroom_of_third, 0.12),
        at_upper_limit=(limit_of_first, 0.0, 0.0, 0.0),
    )
    flight = replace(flight, condition=replace(flight.condition, hover=hover))
    light = motors_light(flight)
    assert light.code is MotorsLight.HEADROOM_LITTLE
    assert ("motor 3, its propeller and the nut first" in light.remedy) is is_named


@mark.slow
def test_an_uneven_trim_does_not_hide_a_small_headroom():
    light_fact = motors_light(evidence(lambda time: np.array([[420], [420], [180], [180]])))
    assert (light_fact.code, light_fact.level) == (TrimFact.TRIM_OF_YAW, "watch")
    assert light_fact.figures["headroom"] < 0.1
    assert light_fact.sentence.count("% of headroom") == 1
    plenty = motors_light(evidence(lambda time: np.array([[80], [80], [-80], [-80]])))
    assert "headroom" not in plenty.figures


@mark.slow
def test_a_motor_without_headroom_works_harder_where_the_trim_is_not_known(monkeypatch):
    monkeypatch.setattr(motors, "trim_of_signals", lambda signals: None)
    weak_motor = motors_light(evidence(lambda time: np.array([[0], [0], [430], [0]])))
    assert (weak_motor.code, weak_motor.subject) == (MotorsLight.HEADROOM_LITTLE, "")
    assert weak_motor.figures["excess"] == approx(0.53, abs=0.02)
    assert "; it works 53 % harder than the mean of all" in weak_motor.sentence
    assert weak_motor.remedy.startswith("Compare the propeller of motor 3")
    all_alike = motors_light(evidence(lambda time: 430.0))
    assert all_alike.figures["excess"] is None


@mark.slow
def test_what_names_a_motor_before_its_balance_goes_first():
    """Events that name a motor outrank what the balance of the motors shows."""
    even = evidence()
    motor_event, failed, other_event = (
        Fact(code, Level.BAD, time=50.0, subject=subject, boot=0)
        for code, subject in (
            (MotionEvent.MOTOR_OFF, FRONT_LEFT),
            (ReportedEvent.MOTOR_FAILED, FRONT_LEFT),
            (SessionFact.ALARM, "GPS"),
        )
    )
    first, largest = motor_event.replace(rise=0.2), motor_event.replace(rise=0.4)
    assert motors_light(replace(even, ending=motor_event)) == motor_event
    for *later_events, expected_event in ((other_event, motor_event), (failed,), (first, largest)):
        assert motors_light(replace(even, events=(*later_events, expected_event))) == expected_event
    # After control was lost the balance says nothing.
    after = motors_light(evidence(weak(40.0), ending=Fact(SessionFact.ALARM, time=30.0)))
    assert after.code is not MotorWatchFact.MOTOR_LOST_THRUST and not after.subject


@mark.slow
def test_a_motor_that_the_autopilot_names_by_its_number_is_in_the_light():
    even = evidence()
    report = Fact(ReportedEvent.THRUST_LOST, Level.BAD, time=50.0, subject="motor 3", boot=0)
    assert motors_light(replace(even, events=(report,))) == report
    measured = Fact(MotionEvent.MOTOR_OFF, Level.BAD, time=51.0, subject=FRONT_LEFT, boot=0)
    assert motors_light(replace(even, events=(report, measured))) == measured
    report_of_no_motor = report.replace(subject="motor 9")
    assert motors_light(replace(even, events=(report_of_no_motor,))).is_good


@mark.slow
def test_without_settled_flight_or_outputs_it_is_not_known():
    """There is no hover to judge the motors by.

    Only a motor at its limit for long, and not in a loss of control, makes the light known.
    """
    flight = evidence()
    without_hover = replace(flight, condition=replace(flight.condition, hover=None), events=())
    light_fact = motors_light(without_hover)
    assert (light_fact.code, light_fact.level) == (MotorsLight.MOTORS_NOT_SEEN, "unknown")
    assert "10 s" in light_fact.sentence and light_fact.without_flight_advice.remedy.startswith(
        "Check motors"
    )
    stop, shorter, longer = (
        Fact(MotionEvent.MOTOR_AT_ITS_STOP, Level.WATCH, subject=FRONT_LEFT, boot=0, **times)
        for times in (
            {"time": 50.0, "duration": 0.5},
            {"time": 40.0, "end_time": 40.3, "duration": 0.3},
            {"time": 20.0, "end_time": 75.0, "duration": 50.0},
        )
    )
    assert motors_light(replace(without_hover, events=(shorter, longer, stop))) == longer
    # In a flight without a hover, a moment at the limit is no need of thrust.
    limited = replace(without_hover, events=(shorter, stop))
    assert motors_light(limited) == light_fact
    # But what would be unknown shows the longest warning that there is.
    assert light_or_warning(Light.MOTORS, light_fact, limited) == stop
    assert light_or_warning(Light.TRACKING, light_fact, limited) == light_fact
    even = Fact(MotorsLight.MOTORS_EVEN, Level.GOOD)
    assert light_or_warning(Light.MOTORS, even, limited) == even
    # A watchdog restarts a program that hangs, whatever its supply.
    reset = Fact(ReportedEvent.RESTARTED_IN_FLIGHT, Level.BAD, time=50.0, boot=0, watchdog=True)
    restarted = replace(without_hover, events=(reset,))
    assert light_or_warning(Light.TRACKING, light_fact, restarted) == reset
    assert light_or_warning(Light.POWER, light_fact, restarted) == light_fact
    lost = replace(without_hover, events=(stop,), ending=Fact(SessionFact.ALARM, time=40.0))
    assert motors_light(lost).code is MotorsLight.MOTORS_NOT_SEEN
    assert light_or_warning(Light.MOTORS, light_fact, lost) == light_fact
    assert motors_light(replace(flight, events=(stop,))).level == "good"


@mark.slow
def test_the_motor_that_saturates_most_is_named_or_none_of_several_alike():
    """One motor is at its limit for 50 s, one for 0.3 s, and then another for 30 s."""
    flight = evidence()
    without_hover = replace(flight, condition=replace(flight.condition, hover=None))
    names = flight.signals.motors.geometry.names

    def at_limit(motor, time, duration):
        """That a motor was at its limit, up to the end of the log."""
        code = MotionEvent.MOTOR_AT_ITS_STOP
        return Fact(code, time=time, subject=names[motor], duration=duration, boot=0)

    most, least = at_limit(0, 31.0, 50.0), at_limit(2, 30.0, 0.3).replace(end_time=30.3)
    assert motors_light(replace(without_hover, events=(least, most))) == most
    also_long = at_limit(3, 30.5, 30.0)
    alike = motors_light(replace(without_hover, events=(least, also_long, most)))
    assert (alike.code, alike.subject) == (MotorsLight.MOTORS_AT_LIMIT, "")
    assert alike.figures["names"] == (names[0], names[3])
    assert alike.time == also_long.time
    assert "Motor 1 and motor 4" in alike.sentence


@mark.slow
@mark.parametrize("motors, subject", [([0, 0, 1, 0], FRONT_LEFT), ([1, 0, 1, 0], "")])
def test_a_limit_in_hover_names_one_motor_only_where_it_stands_out(motors, subject):
    flight = evidence(lambda time: np.outer(motors, 600.0 * (time % 10 < 0.8)))
    limited = motors_light(replace(flight, events=()))
    assert (limited.code, limited.subject) == (MotorsLight.MOTOR_LIMITED, subject)
    assert len(limited.figures["names"]) == sum(motors)
    assert limited.sentence.startswith("Motor 3 is" if subject else "Motor 1 and motor 3 are")


@mark.slow
@mark.parametrize("seconds, code", [(7.0, MotorsLight.MOTOR_LIMITED), (3.0, None)])
def test_without_a_hover_a_motor_is_bad_that_is_at_its_limit_in_most_of_the_flight(seconds, code):
    flight = evidence(lambda time: np.outer([0, 0, 1, 0], 600.0 * (time % 10 < seconds)))
    restless = replace(flight, condition=replace(flight.condition, hover=None), events=())
    limited = motors_light(restless)
    if code is None:
        assert limited.level == "unknown"
    else:
        assert (limited.code, limited.subject, limited.level) == (code, FRONT_LEFT, "bad")
        assert limited.figures["share"] == approx(0.7, abs=0.05)
        assert limited.sentence.endswith(" % of the time.")


@mark.filterwarnings("error")
def test_a_motor_message_that_ends_at_the_take_off_with_motors_off_is_no_limit():
    telemetry = HOVER.telemetry(10.0, 10.0, parameters=X_QUAD_PARAMETERS)
    time = telemetry.messages["SERVO_OUTPUT_RAW"]["time"]
    in_air = np.where((time >= 6.0) & (time < HOVER.landed), 2, 1)
    telemetry = changed(telemetry, "EXTENDED_SYS_STATE", **columns(time, landed_state=in_air))
    # The motors ran before. While they are off, the autopilot sends less than their lowest pulse.
    pulses = np.where((time > 2.0) & (time < 4.0), default_rng(3).normal(1500, 3, (4, 1)), 980.0)
    pulses[:, time >= 6.3] = np.nan
    flight = evidence_of(Signals(with_pulses(telemetry, pulses), inputs="motors"))
    assert flight.has_operated and flight.condition.hover is None
    assert motors_light(flight).code is MotorsLight.MOTORS_NOT_SEEN


@mark.slow
def test_a_limited_motor_is_not_suspect_where_others_work_as_hard():
    # Motors 1 and 2 (one direction of rotation) work harder; gusts drive motor 1 to its limit, and motor 2 seldom.
    def twisted(time):
        gusts = np.outer([1, 0, 0, 0], 520.0 * (time % 10 < 0.8))
        gusts += np.outer([0, 1, 0, 0], 520.0 * (time % 10 > 9.7))
        return gusts + np.array([[80], [80], [-80], [-80]])

    flight = evidence(twisted)
    limited = motors_light(replace(flight, events=()))
    names = flight.signals.motors.geometry.names
    assert (limited.code, limited.subject) == (MotorsLight.MOTOR_LIMITED, "")
    assert limited.figures["names"] == (names[0],)
    assert limited.figures["equally_loaded"] == (names[1],)
    assert " % of settled flight, motor 2 for 3 %; yaw trim" in limited.sentence
    assert "all counterclockwise motors work harder" in limited.sentence
    assert "before motors and arms are aligned" in limited.remedy
    assert "motor 1" not in limited.remedy


@mark.slow
@mark.parametrize(
    "code, level", [(MotionEvent.HEIGHT_DIVERGED, Level.BAD), (MotionEvent.DIVED, Level.GOOD)]
)
def test_limits_of_a_diverged_height_or_after_a_dive_are_no_motor_s(code, level):
    flight = evidence(lambda time: np.outer([0, 0, 1, 0], 600.0 * (time % 10 < 0.8)))
    event = Fact(code, level, time=20.0, end_time=21.0, speed=6.0, boot=0)
    limited = motors_light(replace(flight, events=(event,)))
    assert limited.code is not MotorsLight.MOTOR_LIMITED


def test_outputs_that_never_change_are_not_called_missing():
    telemetry = Hover(hovering=20.0).telemetry(20.0, 20.0)
    constant = {f"servo{number}_raw": 1000 for number in range(1, 5)}
    fact = motors_light(evidence_of(Signals(changed(telemetry, "SERVO_OUTPUT_RAW", **constant))))
    assert fact.code is MotorsLight.MOTORS_NOT_SEEN
    assert "no output in SERVO_OUTPUT_RAW ever changes." in fact.sentence


@mark.slow
def test_no_headroom_is_stated_under_a_height_that_diverged():
    sound = evidence_of(Signals(Hover(hovering=40.0).telemetry(20.0, 20.0)))
    diverged = Fact(MotionEvent.HEIGHT_DIVERGED, Level.BAD, time=20.0, boot=0)
    fact = motors_light(replace(sound, events=(diverged,)))
    assert fact.figures.get("headroom") is None and "headroom" not in fact.sentence


@mark.parametrize(
    "deviation, text",
    [
        # Lean explains a part of the difference that the outputs show: the figure is without it.
        (0.069, "Motor 1 works 6.9 ± 1.4 % harder than the mean without lean: compare with"),
        (-0.069, "Motor 1 works 6.9 ± 1.4 % less hard than the mean without lean: compare"),
        (0.03, "No motor stands out; one that lost 32 % of its thrust would show; headroom 24 %."),
    ],
)
def test_the_motor_that_deviates_most_is_named_though_the_trim_is_even(deviation, text):
    light_fact = Fact(
        MotorsLight.MOTORS_EVEN,
        Level.GOOD,
        worst="motor 1 (front right)",
        deviation=deviation,
        half=0.014,
        most_loss=0.32,
        headroom=0.24,
    )
    assert headline(light_fact).startswith(text)
    assert ("Motor 1 (front right)" in light_fact.sentence) is (abs(deviation) > 0.06)


def test_a_copter_whose_log_names_no_frame_has_that_of_its_placed_motors():
    telemetry = Hover(hovering=1.0).telemetry(2.0, 2.0, parameters=X_QUAD_PARAMETERS)
    unnamed = replace(telemetry, vehicle="GENERIC_MULTIROTOR")
    assert identify_vehicle(Signals(unnamed)).frame == "QUADROTOR"
    assert identify_vehicle(Signals(replace(unnamed, parameters={}))).frame == unnamed.vehicle
