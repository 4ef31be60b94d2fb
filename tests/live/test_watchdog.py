"""The watchdog: what is wrong is said within seconds of take-off, without a model, and sound flights are let alone."""

import io
import random
import re
from dataclasses import dataclass, replace
from errno import ENOSPC
from pkgutil import resolve_name
from unittest.mock import Mock

import numpy as np
from hover import ARMED, MAV_AUTOPILOTS, MAV_TYPES, Hover
from live_hover import Flight, by_time, replay, ticks
from mavlink_streams import message
from numpy.testing import assert_equal
from pytest import approx, fixture, mark, param
from rich.console import Console
from rich.live import Live

from mavdem.assessment.condition import Condition
from mavdem.assessment.headline import headline_by_lights
from mavdem.assessment.judgement import Judgement
from mavdem.assessment.next_step import choose_next_step
from mavdem.cli.live_lines import event_line
from mavdem.cli.live_status import MAX_SETTLING_SECONDS, ChangeDebouncer, StatusLines
from mavdem.dataset.segment_learnability import slow_streams
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Headline, NextStep
from mavdem.facts.ending import Ending, MotionEvent
from mavdem.facts.estimator import EstimatorLight
from mavdem.facts.event import Event
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light
from mavdem.facts.log import LogLight
from mavdem.facts.margins import MarginsLight, TrackingLight
from mavdem.facts.motors import MotorsLight, MotorWatchFact
from mavdem.facts.power import PowerLight
from mavdem.facts.session import (
    LinkFact,
    MissingMessages,
    RecordingState,
    RowsFact,
    SessionFact,
    TimeUse,
    VehicleFact,
)
from mavdem.facts.vibration import VibrationLight
from mavdem.facts.watch import WatchedQuantity, WatchFact
from mavdem.ingest.mavlink.frame_reader import FrameReader
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import EstimatorRatio
from mavdem.live import LiveStream, recent_messages
from mavdem.live import watchdog as watchdog_module
from mavdem.live.active_alarms import CALM_SECONDS
from mavdem.live.flight_lights import FlightLights
from mavdem.live.history import LiveHistory
from mavdem.live.live_signals import RecentMotion
from mavdem.live.messages import MESSAGE_FIELDS, decode_message
from mavdem.live.motor_limits import ALARMING_SHARE
from mavdem.live.recent_messages import MAX_ROWS, RecentMessages, columns_from
from mavdem.live.review import Review
from mavdem.live.samples import DECISION_SECONDS, MEMORY_SECONDS
from mavdem.live.session_state import Latency
from mavdem.live.session_status import SessionStatus
from mavdem.live.silence import resumption
from mavdem.live.takeoff_place import Displacement
from mavdem.live.vehicle_state import VehicleState
from mavdem.live.watch_list import not_watched
from mavdem.live.watchdog import TRACKING_PERIOD, Watchdog
from mavdem.live.wind import WindEstimate
from mavdem.loops.limit_cycles import Oscillation
from mavdem.report.live import light_rows, vehicle_text, watched_quantities_text
from mavdem.report.pages.live_page import live_page
from mavdem.report.templates import headline as headline_text


@dataclass(frozen=True)
class Hot(Hover):
    """Rolls at ``frequency``, by ``size`` µs of the motors, until 12 s; motor 1 is at its limit from 14 s on."""

    frequency: float = 23.0
    size: float = 450.0

    def roll_rate(self, t):
        return super().roll_rate(t) + (np.asarray(t) < 12.0) * 0.8 * self._line(t)

    def motors(self, t):
        outputs = super().motors(t)
        running = (outputs > 1200)[:, :1] * (t < 12.0)[:, np.newaxis]
        outputs += running * self.size * np.outer(self._line(t), [-1, 1, 1, -1])
        outputs[:, 0] = np.where((t > 14.0) & (t < 18.0), 2000.0, outputs[:, 0])
        return np.clip(outputs, 1000.0, 2000.0)

    def _line(self, t):
        return np.sin(2 * np.pi * self.frequency * np.asarray(t))


def facts_about(replayed, code):
    """Returns the reported facts with a code, or whose reason has that code."""
    return [
        fact
        for fact in replayed.facts
        if code in (fact.code, getattr(fact.figures.get("reason"), "code", None))
    ]


@fixture(scope="module")
def hot():
    """A hover whose roll loop begins to oscillate in a limit cycle of 23 Hz."""
    return replay(Flight(Hot(hovering=30.0), attitude=70.0, motors=70.0).frames(end=30.0))


@mark.slow
def test_a_limit_cycle_is_reported_within_two_seconds_and_when_it_ends(hot):
    """Roll oscillates at 23 Hz from the take-off on until 11 s or later."""
    takeoff_time = next(fact.time for fact in hot.facts if fact.code is ReportedEvent.OFF_GROUND)
    alarm, end_of_alarm, *_ = facts_about(hot, MarginsLight.OSCILLATES)
    assert (
        alarm.code is SessionFact.ALARM
        and alarm.level is Level.BAD
        and takeoff_time < alarm.time <= takeoff_time + 2
    )
    cycle = alarm.figures["reason"]
    assert cycle.subject == "roll" and cycle.figures["frequency"] == approx(23.0, abs=1.1)
    assert cycle.figures["turn_rate"] < np.pi
    assert hot.stream.status().worst_lights[Light.MOTORS].is_bad
    assert end_of_alarm.code is WatchFact.ALARM_OVER and 11.0 < end_of_alarm.time < 14.6
    [terminal_output] = [each for each in hot.events if each.fact is end_of_alarm]
    assert terminal_output.seconds - 1.7e9 == approx(end_of_alarm.time + CALM_SECONDS, abs=0.6)


def test_motors_that_an_oscillation_drives_to_limits_are_bad_in_flight_as_in_a_log():
    """Of motors within their limits it is not known how sound they are. The axis with most time at a limit counts."""
    vehicle = Telemetry(1, 1, "QUADROTOR", "PX4", {}, {})
    cycle = Oscillation("roll", 17.0, 3.0, 0.04, False, 2.0, None)
    levels = []
    for other_axes in ((), (cycle._replace(axis="yaw", at_limit=0.06),)):
        watchdog = Watchdog(RecentMessages())
        watchdog.status_lights.add(Light.MOTORS, Fact(MotorWatchFact.NO_LOSS_FOUND, clock=3.0))
        watchdog._motor_limits._limit_cycle = cycle._replace(other_axes=other_axes)
        watchdog.loss_watch.judge_flight = Mock(return_value=[])
        watchdog.is_thorough = False
        review = Review(
            6.0, vehicle, is_flying=True, has_settled=True, phase_start=2.0, recent_signals=None
        )
        review.facts[WatchedQuantity.OSCILLATION] = Fact(MarginsLight.OSCILLATES)
        watchdog._judge_flight(review, Mock(motion=None))
        motors = watchdog.status_lights.latest.get(Light.MOTORS)
        levels.append(None if motors is None else motors.level)
    assert levels == [None, Level.BAD]


@mark.slow
def test_what_was_wrong_is_the_headline_of_the_session(hot):
    judgement = replace(hot.stream.status(), motor_alarms=()).overall_judgement
    # Both are over.
    assert judgement.headline.code is WatchFact.ALARM_OVER and judgement.headline.is_bad
    assert judgement.headline.figures["reason"].code is MotorsLight.MOTOR_LIMITED
    assert judgement.lights["margins"].figures["reason"].code is MarginsLight.OSCILLATES
    assert judgement.next_step.figures["reason"] is judgement.headline
    # What to check and repair is the next step after the landing.
    assert str(judgement.next_step) == "Land soon."
    landed = replace(hot.stream.status(), motor_alarms=(), is_flying=False).overall_judgement
    assert landed.next_step.code is NextStep.DO_AS_ADVISED
    assert str(landed.next_step).startswith("Do not fly")


@mark.slow
def test_a_motor_at_its_limit_is_named(hot):
    [alarm, _] = facts_about(hot, MotorsLight.MOTOR_LIMITED)
    assert alarm.subject == "motor 1 (front right)" and alarm.code is SessionFact.ALARM
    begun = 14.0 + ALARMING_SHARE * DECISION_SECONDS
    assert begun <= alarm.time <= begun + 0.6


@mark.in_full
def test_what_is_steered_is_no_limit_cycle():
    steered = Hot(hovering=10.0, frequency=1.0)
    replayed = replay(Flight(steered, attitude=60.0, motors=60.0).frames(end=16.0))
    assert not facts_about(replayed, MarginsLight.OSCILLATES)


@mark.in_full
def test_what_interrupts_a_link_raises_no_alarm():
    """Rows of such links are tested without the watchdog and without alarms about motors; here both run."""
    flight = Flight(Hover(hovering=30.0), attitude=50.0, motors=50.0)
    chance = random.Random(3)
    lossy = [entry for entry in flight.frames(end=14.0) if chance.random() > 0.2]
    twice = [entry for entry in flight.frames(start=14.0, end=16.0) for _ in range(2)]
    swapped = flight.frames(start=16.0, end=18.0)
    swapped[::2], swapped[1::2] = swapped[1::2], swapped[::2]
    after_a_gap = flight.frames(start=18.5, end=21.0)
    another_rate = Flight(flight.hover, motors=25.0).frames(start=21.0, end=24.0)
    replayed = replay([*lossy, *twice, *swapped, *after_a_gap, *another_rate])
    assert len(replayed.segments()) > 1, "the gap interrupts the rows"
    assert SessionFact.ALARM not in replayed.codes
    watched = {fact.subject: fact.code for fact in replayed.stream.status().watch_facts}
    assert watched["oscillation"] is not WatchFact.NOT_WATCHED


@dataclass
class WatchedFlight:
    """What the watchdog reports of a flight of which slow messages come: nothing else needs a link or its motion."""

    facts: list
    """The reported facts, in their order."""

    watchdog: Watchdog
    """The watchdog after the last review."""

    is_flying: bool
    """Whether the vehicle still flies."""

    watch_facts: list
    """After each review, what is watched, and why the rest is not."""

    def status(self):
        """The status of the session that has this watchdog."""
        return SessionStatus(
            "1:1",
            is_flying=self.is_flying,
            active_alarms=self.watchdog.active_alarms,
            worst_lights=self.watchdog.status_lights.latest,
            watch_facts=tuple(self.watchdog.watch_list.facts.values()),
        )


def watched_with_messages(
    *messages, until=20.0, landed=np.inf, autopilot="ARDUPILOTMEGA", motion=lambda now: None
):
    """Watches a flight from its take-off at 6 s, settled from 12 s on, in reviews twice a second.

    Args:
        messages: time, name and fields of each slow message; HEARTBEATs are added where there are none.
        until: end of the watch, s.
        landed: time of the landing, s.
        autopilot: name of the autopilot.
        motion: function of the time that returns the motion of the last seconds.
    """
    identity = {"type": MAV_TYPES["QUADROTOR"], "autopilot": MAV_AUTOPILOTS[autopilot]}
    beats = [
        (time, "HEARTBEAT", identity | {"base_mode": ARMED * (5.0 <= time < landed + 1.0)})
        for time in ticks(3.0, until, 1.0)
        if "HEARTBEAT" not in {name for _, name, _ in messages}
    ]
    waiting = sorted([*beats, *messages], key=lambda entry: entry[0])
    recent = RecentMessages()
    watched = WatchedFlight([], Watchdog(recent), is_flying=False, watch_facts=[])
    vehicle = Telemetry(1, 1, "QUADROTOR", autopilot, {}, {})
    for now in ticks(3.5, until, 2.0):
        while waiting and waiting[0][0] < now:
            time, name, fields = waiting.pop(0)
            recent.add(name, time, decoded(message(name, **fields)).values)
        watched.is_flying = 6.0 <= now < landed
        watched.watchdog.update_phase(now, is_flying=watched.is_flying, takeoff_time=6.0)
        settled_start = 12.0 if watched.is_flying and now > 12.0 else None
        watched.facts += watched.watchdog.begin_review(
            now, vehicle, is_flying=watched.is_flying, settled_start=settled_start
        )
        if watched.is_flying and watched.watchdog.is_thorough:
            watched.watchdog.review_lights()
        watched.facts += watched.watchdog.finish_review(motion(now), 6.0)
        watched.watch_facts += watched.watchdog.watch_list.facts.values()
    return watched


def decoded(frame):
    """Returns the message of a frame as the live path has it."""
    [found] = FrameReader().feed(frame)
    return decode_message(found)


@mark.slow
def test_a_low_battery_vibration_and_warnings_are_said_as_they_come():
    """The voltage falls at 8 s, vibration rises at 15 s, and a GPS glitch is reported at 10 s. Each has one alarm."""
    seconds = np.arange(4.0, 20.0, 0.5).tolist()
    volts = {time: 12.4 if time < 8.0 else 8.0 for time in seconds}
    shaken = {time: 5.0 if time < 15.0 else 70.0 for time in seconds}
    replayed = watched_with_messages(
        *((time, "SYS_STATUS", {"voltage_battery": round(1000 * volts[time])}) for time in seconds),
        *((time, "VIBRATION", {"vibration_x": shaken[time]}) for time in seconds),
        (10.0, "STATUSTEXT", {"severity": 4, "text": b"GPS Glitch"}),
        (11.0, "STATUSTEXT", {"severity": 4, "text": b"GPS Glitch"}),
    )
    [battery_alarm] = facts_about(replayed, PowerLight.BATTERY_LOW)[-1:]
    assert battery_alarm.code is SessionFact.ALARM and battery_alarm.time < 20.0
    watched, shaking, *_ = facts_about(replayed, VibrationLight.VIBRATION_MEASURED)
    assert (
        watched.level is Level.WATCH and shaking.code is SessionFact.ALARM and shaking.time > 15.0
    )
    [jumped] = facts_about(replayed, ReportedEvent.GPS_JUMPED)
    assert jumped.time == approx(10.0, abs=0.1)
    watched_quantities = {fact.subject for fact in replayed.status().watch_facts}
    # Whether motors lose thrust is watched beside the watchdog.
    assert watched_quantities == {*WatchedQuantity} - {WatchedQuantity.MOTORS}


@mark.slow
@mark.parametrize(
    "version, end, is_known",
    [(0x010C03FF, 18.0, False), param(0x010D00FF, 67.0, True, marks=mark.in_full)],
)
def test_a_version_that_came_once_says_what_the_vibration_of_px4_is(version, end, is_known):
    """PX4 before 1.13 sends other quantities in VIBRATION, so that it can be judged only with the version.

    The version stays known for longer than the minute for which messages are kept.
    """
    levels = [(time, "VIBRATION", {"vibration_z": 0.1}) for time in ticks(4.0, end, 2.0)]
    sent = [(3.5, "AUTOPILOT_VERSION", {"flight_sw_version": version}), *levels]
    watched = watched_with_messages(*sent, until=end, autopilot="PX4")
    light = watched.status().worst_lights[Light.VIBRATION]
    assert (light.code is VibrationLight.VIBRATION_MEASURED) is is_known
    assert light.is_good is is_known


@mark.parametrize("later, shown", [(0.1, 0.2), (0.3, 0.3)], ids=["a smaller one", "a larger one"])
def test_the_largest_innovation_of_a_flight_stays_when_the_last_minute_has_another(later, shown):
    lights = FlightLights()
    for ratio in (0.2, later):
        agreed = Fact(EstimatorLight.FILTER_AGREED, name=EstimatorRatio.VELOCITY, ratio=ratio)
        lights.add(Light.ESTIMATOR, agreed)
    assert lights.latest[Light.ESTIMATOR].figures["ratio"] == shown
    lights.add(Light.ESTIMATOR, Fact(EstimatorLight.FILTER_DOUBTED, ratio=1.2))
    lights.add(Light.ESTIMATOR, Fact(EstimatorLight.FILTER_AGREED, ratio=0.1))
    assert lights.latest[Light.ESTIMATOR].code is EstimatorLight.FILTER_DOUBTED


@mark.slow
def test_a_fault_of_the_estimator_is_over_when_its_innovation_was_last_beyond_its_limit():
    """Its duration is counted from its start, not from the time of the largest innovation, which its sentence has.

    From 12 s to 18 s the innovation test ratio of the position is above its limit of 1.
    """
    reports = {
        time: {
            "velocity_variance": 0.1,
            "pos_horiz_variance": time / 10 if 12.0 < time < 18.0 else 0.1,
        }
        for time in ticks(4.0, 34.0, 2.0)
    }
    sent = [(time, "EKF_STATUS_REPORT", fields) for time, fields in reports.items()]
    watched = watched_with_messages(*sent, until=20.0)
    light = watched.status().worst_lights[Light.ESTIMATOR]
    assert light.code is EstimatorLight.FILTER_DOUBTED and light.level is Level.WATCH
    # It is reported before it is over, beside a light with its whole duration.
    [report] = facts_about(watched, EstimatorLight.FILTER_DOUBTED)
    assert " s so far: innovation" in str(report) and "so far" not in str(light)
    facts = facts_about(watched_with_messages(*sent, until=33.0), EstimatorLight.FILTER_DOUBTED)
    [end] = [fact for fact in facts if fact.code is WatchFact.ALARM_OVER]
    assert end.figures["reason"].time == approx(17.5, abs=0.3)
    assert end.time == approx(17.5, abs=0.3)


@mark.slow
def test_a_receiver_without_a_fix_is_not_said_to_be_over_while_it_has_none():
    """The report is of the moment when the fix was lost, and the state lasts until the end, after the landing too."""
    fixes = [
        (time, "GPS_RAW_INT", {"fix_type": 3 if time < 10.0 else 1, "satellites_visible": 12})
        for time in np.arange(4.0, 38.0, 0.5).tolist()
    ]
    estimates = [
        (time, "EKF_STATUS_REPORT", {"pos_horiz_variance": 0.1})
        for time in np.arange(4.0, 38.0, 0.5).tolist()
    ]
    replayed = watched_with_messages(*fixes, *estimates, until=36.0)
    [lost] = [
        fact for fact in facts_about(replayed, ReportedEvent.GPS_LOST) if fact.is_watch_or_bad
    ]
    assert lost.code is SessionFact.ALARM
    assert not [
        fact
        for fact in facts_about(replayed, ReportedEvent.GPS_LOST)
        if fact.code is WatchFact.ALARM_OVER
    ]


@mark.slow
def test_motors_that_take_turns_at_their_limit_are_one_alarm():
    """Each comes to its limit for two seconds; between them none is there, for longer than an alarm lasts."""
    turns = {10.0: 0, 13.0: 1, 28.0: 2, 45.0: 0}

    flight = Hover(hovering=60.0).telemetry(attitude_time=20.0, motor_time=20.0)
    motors = Signals(flight).motors
    motors = replace(motors, outputs=motors.outputs.copy())
    for begin, motor in turns.items():
        motors.outputs[(motors.time > begin) & (motors.time < begin + 2.0), motor] = 2000.0

    def motion(now):
        recent = (motors.time > now - MEMORY_SECONDS) & (motors.time <= now)
        columns = {name: getattr(motors, name)[recent] for name in ("time", "boot", "outputs")}
        return RecentMotion(replace(motors, **columns), tilts={})

    replayed = watched_with_messages(until=60.0, motion=motion)
    begun, end_of_alarm, second_alarm, *rest = facts_about(replayed, MotorsLight.MOTOR_LIMITED)
    assert begun.code is second_alarm.code is SessionFact.ALARM
    assert len(end_of_alarm.figures["reason"].figures["names"]) == 2
    # The alarm that has come again lasts for twice as long, so that the fourth turn is of the same one.
    assert not rest
    active = replayed.status().active_alarms[-1]
    assert len(active.figures["names"]) == 2


@mark.slow
def test_a_lasting_fault_of_the_tracking_is_one_alarm_until_it_is_judged_to_be_over():
    """Reviews come a little faster than usual, so that the calm time is over before the tracking is judged again."""
    watchdog = Watchdog(RecentMessages())
    light = Mock()
    vehicle = Telemetry(1, 1, "quadrotor", "px4", {})
    watchdog._tracking.judge = light
    reported = []
    now = 30.0
    while now < 80.0:
        now += 0.49
        level = Level.BAD if now < 60.0 else Level.GOOD
        light.return_value = Fact(TrackingLight.FOLLOWS_SETPOINT, level)
        watchdog.update_phase(now, is_flying=True)
        watchdog.begin_review(now, vehicle, is_flying=True, settled_start=0.0)
        if watchdog.is_thorough and watchdog.is_tracking_due:
            watchdog.review_tracking(0.0)
        reported += watchdog.finish_review(None)
    alarm, end_of_alarm = reported
    assert alarm.code is SessionFact.ALARM and end_of_alarm.code is WatchFact.ALARM_OVER
    assert 60.0 - TRACKING_PERIOD - 2.0 < end_of_alarm.time < 60.0


@mark.slow
def test_a_single_output_shows_no_motor_that_stays_at_its_limit():
    replayed = replay(Flight(Limited(hovering=20.0), attitude=20.0, motors=0.5).frames(end=24.0))
    assert not facts_about(replayed, MotorsLight.MOTOR_LIMITED)
    watched = {fact.subject: fact for fact in replayed.stream.status().watch_facts}
    assert watched[WatchedQuantity.MOTOR_LIMITS].code is WatchFact.NOT_WATCHED


@mark.slow
def test_the_emptiest_of_two_batteries_is_alarmed_and_named():
    """Battery 2 falls to 8 V at 8 s while battery 1, and the voltage of the whole system, stay at 12.5 V."""
    seconds = np.arange(4.0, 20.0, 0.5).tolist()

    def status(battery_id, volts, state):
        voltages = [round(1000 * volts), *[65535] * 9]
        return {"id": battery_id, "voltages": voltages, "charge_state": state}

    empty = {time: 12.4 if time < 8.0 else 8.0 for time in seconds}
    replayed = watched_with_messages(
        *((time, "BATTERY_STATUS", status(0, 12.5 - 0.001 * time, 1)) for time in seconds),
        *(
            (time, "BATTERY_STATUS", status(1, empty[time], 1 if time < 10.0 else 3))
            for time in seconds
        ),
        *((time, "SYS_STATUS", {"voltage_battery": 12500}) for time in seconds),
    )
    [battery_alarm] = facts_about(replayed, PowerLight.BATTERY_LOW)[-1:]
    assert battery_alarm.figures["reason"].subject == "battery 2"
    # The page has battery 1; a pilot in flight reads no more than what matters.
    assert "battery 1" not in battery_alarm.sentence
    reports = facts_about(replayed, ReportedEvent.BATTERY_ALARMED)
    assert {report.subject or report.figures["reason"].subject for report in reports} == {
        "battery 2"
    }


@mark.slow
def test_a_battery_that_the_autopilot_reports_is_an_alarm_headline_and_light():
    """PX4 warns of a low battery (charge state 2), then of a critical one (3), while its voltage has no limit."""
    states = {
        time: 1 if time < 10.0 else 2 if time < 14.0 else 3 for time in np.arange(4.0, 20.0, 0.5)
    }
    sent = [
        (time, "BATTERY_STATUS", {"voltages": [9100, *[65535] * 9], "charge_state": state})
        for time, state in states.items()
    ]
    battery_alarm = watched_with_messages(*sent, until=13.0).status().overall_judgement
    assert (
        battery_alarm.headline.code
        is battery_alarm.lights[Light.POWER].code
        is ReportedEvent.BATTERY_WARNED
    )
    assert str(battery_alarm.next_step) == "Land soon."
    replayed = watched_with_messages(*sent)
    [warning] = facts_about(replayed, ReportedEvent.BATTERY_WARNED)
    assert warning.remedy == "Land soon."
    [alarm] = facts_about(replayed, ReportedEvent.BATTERY_ALARMED)
    assert alarm.code is SessionFact.ALARM and alarm.time == approx(14.0, abs=0.1)
    assert alarm.sentence_and_remedy.startswith(
        "Alarm: the autopilot reports a critical battery. Land now."
    )
    status = replayed.status()
    critical = status.overall_judgement
    assert (
        critical.headline.code is critical.lights[Light.POWER].code is alarm.figures["reason"].code
    )
    assert critical.next_step.code is NextStep.LAND_NOW
    assert [fact.code for fact in status.active_alarms] == [critical.headline.code]


@mark.slow
def test_a_supply_that_falls_before_a_vehicle_vanishes_is_an_alarm_and_the_headline():
    """The voltage of the flight controller's supply falls from 5.05 V to 4.22 V, and the link is lost."""
    volts = [5.05, 5.04, 5.05, 5.04, 5.05, 4.69, 4.58, 4.47, 4.33, 4.22]
    sent = [
        (10.0 + 0.5 * row, "POWER_STATUS", {"Vcc": round(1000 * value)})
        for row, value in enumerate(volts)
    ]
    status = watched_with_messages(*sent, until=15.0).status()
    [alarm] = status.active_alarms
    assert alarm.is_bad and alarm.code in {ReportedEvent.BOARD_VOLTAGE_LOW, PowerLight.SUPPLY_LOW}
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=3.0)
    vanished = replace(status, no_model_reason=silence).overall_judgement
    assert vanished.headline.figures["cause"] == vanished.lights[Light.POWER]
    assert vanished.next_step.code is NextStep.LAND_NOW
    # So does a supply that is to be watched only.
    battery_alarm = Fact(PowerLight.SUPPLY_LOW, voltage=4.6, voltage_usual=5.0, voltage_limit=4.8)
    watched = replace(
        status, active_alarms=(), worst_lights={Light.POWER: battery_alarm}, no_model_reason=silence
    )
    assert watched.overall_judgement.headline.figures["cause"] == battery_alarm
    assert "radio" in str(watched.overall_judgement.next_step)


@mark.slow
def test_an_empty_battery_is_not_said_to_be_over_after_the_landing():
    """The battery reports a critical charge at 12 s; its alarm ends with the flight, without a message."""
    batteries = [
        (time, "BATTERY_STATUS", {"voltages": [9100, *[65535] * 9], "charge_state": state})
        for time, state in ((4.0, 1), (9.0, 1), (12.0, 3), (14.0, 3))
    ]
    replayed = watched_with_messages(*batteries, until=24.0, landed=20.0)
    assert ReportedEvent.ON_GROUND in [fact.code for fact in replayed.facts]
    assert [fact.code for fact in facts_about(replayed, ReportedEvent.BATTERY_ALARMED)] == [
        SessionFact.ALARM
    ]
    assert not replayed.status().active_alarms


@mark.slow
def test_a_low_battery_after_a_critical_one_advises_nothing_milder():
    """Battery 2 is critical from 10 s on (charge state 3), and battery 1 low from 13 s on (2)."""
    states = [(9.0, 0, 1), (9.0, 1, 1), (10.0, 1, 3), (11.0, 1, 3), (13.0, 0, 2), (14.0, 0, 2)]
    messages = []
    for time, battery, state in states:
        fields = {"id": battery, "voltages": [9100, *[65535] * 9], "charge_state": state}
        messages.append((time, "BATTERY_STATUS", fields))
    replayed = watched_with_messages(*messages)
    [alarm] = facts_about(replayed, ReportedEvent.BATTERY_ALARMED)
    assert alarm.code is SessionFact.ALARM
    [warning] = facts_about(replayed, ReportedEvent.BATTERY_WARNED)
    assert warning.time > alarm.time and not warning.remedy
    [active_alarm] = replayed.status().active_alarms
    assert active_alarm.code is ReportedEvent.BATTERY_ALARMED


def rebooted(before, text):
    """Replays frames before a reboot, then a text message of the autopilot, and a flight whose clock begins at 0."""
    after = Flight(Hover(hovering=30.0), attitude=20.0, motors=20.0, clock=-12.0).frames(12.0, 18.0)
    return replay([*before, (12.0, message("STATUSTEXT", severity=2, text=text)), *after])


@mark.slow
@mark.parametrize(
    "text, light",
    [(b"WDG: T2 SL0", Light.TRACKING), param(b"Frame: QUAD/X", Light.POWER, marks=mark.in_full)],
)
def test_a_restart_in_flight_is_an_alarm_with_its_cause(text, light):
    """The autopilot restarts at 12 s.

    A text about its watchdog says that the software failed; otherwise the power did.
    """
    before = Flight(Hover(hovering=30.0), attitude=20.0, motors=20.0).frames(end=12.0)
    replayed = rebooted(before, text)
    [alarm] = facts_about(replayed, ReportedEvent.RESTARTED_IN_FLIGHT)
    assert alarm.code is SessionFact.ALARM
    judgement = replayed.stream.status().overall_judgement
    assert (
        judgement.headline.code is judgement.lights[light].code is ReportedEvent.RESTARTED_IN_FLIGHT
    )
    assert judgement.headline.figures["watchdog"] == (light is Light.TRACKING)
    assert judgement.next_step.code is NextStep.LAND_NOW
    assert judgement.headline in replayed.stream.status().active_alarms


@mark.slow
def test_a_restart_on_the_ground_is_no_alarm():
    before = Flight(attitude=20.0, motors=20.0, clock=20.0).frames(-8.0, 4.0)
    replayed = rebooted(before, b"Frame: QUAD/X")
    assert VehicleFact.VEHICLE_REBOOTED in replayed.codes
    assert not facts_about(replayed, ReportedEvent.RESTARTED_IN_FLIGHT)


@mark.slow
@mark.parametrize(
    "autopilots, gap",
    [
        (("PX4", "ARDUPILOTMEGA"), 3.0),
        param(("ARDUPILOTMEGA", "PX4"), 30.0, marks=mark.in_full),
    ],
)
def test_a_vehicle_lost_in_flight_that_starts_again_on_the_ground_has_not_restarted_in_flight(
    autopilots, gap
):
    """The second boot arms after 0.7 s and takes off within three seconds of its first message."""
    first, second = autopilots
    cut = 9.0
    before = Flight(
        Hover(hovering=30.0), attitude=20.0, motors=20.0, clock=-4.0, autopilot=first
    ).frames(4.3, cut)
    after = Flight(
        Hover(hovering=30.0), attitude=25.0, motors=25.0, clock=-4.0, autopilot=second
    ).frames(4.3, 11.0)
    replayed = replay([*before, *[(time + cut + gap - 4.3, frame) for time, frame in after]])
    assert replayed.codes.count(VehicleFact.VEHICLE_REBOOTED) == 1
    assert not facts_about(replayed, ReportedEvent.RESTARTED_IN_FLIGHT)
    assert replayed.codes.count(ReportedEvent.OFF_GROUND) == 2


@mark.slow
def test_thinning_out_keeps_every_battery():
    recent = RecentMessages()
    for row in range(3 * MAX_ROWS):
        recent.add("BATTERY_STATUS", 0.1 * row, (row % 2, 0, 0, 0, 0))
    columns = recent.columns(["BATTERY_STATUS"])["BATTERY_STATUS"]
    assert len(columns["time"]) <= MAX_ROWS
    oldest = columns["time"] < 0.2 * MAX_ROWS
    assert set(columns["id"][oldest].tolist()) == {0, 1}


@mark.slow
def test_an_external_mode_of_px4_is_reported_by_its_announced_name():
    """At 8 s the mode changes to one that a companion computer has announced as "Wall follower"."""
    beat = {"type": 2, "autopilot": 12, "base_mode": 209}
    seconds = np.arange(3.0, 20.0, 0.5).tolist()
    modes = {time: 4 << 16 | (3 if time < 8.0 else 12) << 24 for time in seconds}
    replayed = watched_with_messages(
        (
            5.0,
            "AVAILABLE_MODES",
            {"custom_mode": 4 << 16 | 12 << 24, "mode_name": b"Wall follower"},
        ),
        *((time, "HEARTBEAT", {**beat, "custom_mode": modes[time]}) for time in seconds),
        autopilot="PX4",
    )
    [*_, changed] = facts_about(replayed, ReportedEvent.MODE_CHANGED)
    assert changed.subject == "Wall follower"
    assert changed.time == approx(8.0, abs=0.6)


@mark.slow
def test_what_is_watched_is_always_shown():
    """On the ground nothing is watched.

    In flight each quantity is watched as soon as its messages and its reference are there.
    """
    frames = Flight(Hover(hovering=20.0), attitude=25.0, motors=25.0).frames(0.0, 25.0)
    parts = [
        [(time, frame) for time, frame in frames if start <= time < end]
        for start, end in ((0.0, 5.0), (5.0, 14.0), (14.0, 26.0))
    ]
    stream = LiveStream()
    ground, *_ = replay(parts[0], stream).stream.status().watch_facts
    assert ground.code is WatchFact.NOT_WATCHED
    early = replay(parts[1], stream).stream.status().watch_facts
    reasons = {one.subject: one.figures["reason"] for one in early}
    assert reasons[WatchedQuantity.MOTORS].code is WatchFact.REFERENCE_SHORT
    status = replay(parts[2], stream).stream.status()
    facts_by_quantity = {fact.subject: fact for fact in status.watch_facts}
    assert {
        WatchedQuantity.CONTROL,
        WatchedQuantity.MOTORS,
        WatchedQuantity.OSCILLATION,
        WatchedQuantity.WARNINGS,
        WatchedQuantity.DRIFT,
    } == {what for what, fact in facts_by_quantity.items() if fact.code is WatchFact.WATCHED} - {
        WatchedQuantity.MOTOR_LIMITS
    }
    assert (
        facts_by_quantity[WatchedQuantity.BATTERY].figures["reason"].code
        is WatchFact.MESSAGE_MISSING
    )
    assert "loss of thrust (" in watched_quantities_text(
        status.watch_facts
    ) and "battery" in watched_quantities_text(status.watch_facts)
    assert not watched_quantities_text([])


def test_what_is_not_watched_before_a_vehicle_is_chosen_has_no_time():
    """Several vehicles send and none is followed, so that no boot clock is known."""
    watched = Fact(WatchFact.WATCHED, time=3.0, subject=WatchedQuantity.BATTERY, reason=None)
    fact = not_watched(watched, Fact(WatchFact.ON_GROUND_NOW), np.nan)
    assert fact.code is WatchFact.NOT_WATCHED and fact.time is None
    assert watched_quantities_text([fact]).startswith("Not watched: battery (")


@mark.slow
@mark.parametrize(
    "volts, code",
    [
        (lambda time: 12.6 - 0.01 * time, WatchFact.WATCHED),
        (lambda time: 12.6, WatchFact.NOT_WATCHED),
    ],
)
def test_a_battery_that_nothing_measures_is_not_called_watched(volts, code):
    """A voltage that never changes is a constant without a sensor."""
    seconds = np.arange(4.0, 20.0, 0.5).tolist()
    watched = watched_with_messages(
        *((time, "SYS_STATUS", {"voltage_battery": round(1000 * volts(time))}) for time in seconds)
    )
    status = watched.status()
    [battery] = [fact for fact in status.watch_facts if fact.subject == WatchedQuantity.BATTERY]
    assert battery.code is code
    assert status.worst_lights[Light.POWER].is_good == (code is WatchFact.WATCHED)


@mark.slow
def test_rates_that_vary_are_no_news(capsys, monkeypatch):
    monkeypatch.setattr("mavdem.cli.live_status.SETTLING_SECONDS", 0.0)
    lines = StatusLines(None)
    counts = []
    for rate in (5.5, 5.5, 5.6, 4.9):
        rates = {"ATTITUDE": rate, "SERVO_OUTPUT_RAW": 6.0}
        slow = slow_streams(rates, "roll")
        obstacle = Fact(RowsFact.LIVE_RATES_TOO_LOW, can_ask=True, reason=slow)
        watch = Fact(WatchFact.NOT_WATCHED, subject=WatchedQuantity.OSCILLATION, reason=slow)
        status = SessionStatus(vehicle="1:1", no_model_reason=obstacle, watch_facts=(watch,))
        lines.show(Mock(shown_status=status))
        counts.append(len(capsys.readouterr().out.splitlines()))
    # The second look at the same next step prints that.
    assert counts == [2, 1, 0, 0]


def test_a_lasting_state_is_repeated_in_a_short_line_and_its_next_step_once(capsys):
    lines = StatusLines(None)
    status = SessionStatus(
        "1:1", no_model_reason=Fact(SessionFact.NOT_FLYING), boot_clock=182.44, message_age=0.5
    )
    for _ in range(3):
        # The second and the third line repeat an unchanged state.
        lines.show(Mock(shown_status=status))
        lines._print_time = -np.inf
    # A vehicle that is silent on the ground is no news.
    silent = replace(status, message_age=40.0)
    for _ in range(3):
        lines.show(Mock(shown_status=silent))
        lines._print_time = -np.inf
    printed = capsys.readouterr().out
    assert printed.count(status.no_model_reason.remedy) == 1
    assert len(printed.splitlines()) == 4
    for line in printed.splitlines():
        assert re.match(r"\d\d:\d\d:\d\d    182.4 s  \S", line) and len(line) <= 120


def test_alarms_and_their_ends_are_marked_in_lines_of_one_form(capsys):
    """An alarm begins and ends, and a link is lost and returns.

    Messages that resume end an alarm only if there was one.
    """
    limit = Fact(ReportedEvent.BATTERY_ALARMED, Level.BAD)
    silent = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MOTION, duration=3.0)
    link_loss = SessionStatus("1:1", is_flying=True, no_model_reason=silent).link_loss
    assert link_loss is not None
    lost = link_loss.replace(Level.BAD)
    resumed = Fact(RowsFact.MESSAGES_RESUMED, subject=MissingMessages.MOTION, duration=9.0)
    facts = (
        resumed,
        Fact(SessionFact.ALARM, reason=limit),
        Fact(WatchFact.ALARM_OVER, time=50.0, reason=limit),
        Fact(WatchFact.ALARM_OVER, time=50.0, reason=limit, is_at_landing=True),
        lost,
        resumed,
        resumed,
    )
    lines = StatusLines(None)
    for fact in facts:
        lines.print_event(Event(9.0, fact, reception=0.0))
    printed = capsys.readouterr().out.splitlines()
    starts = [re.split(r"- s  ", line)[1] for line in printed]
    markers = [re.match(r"(ALARM OVER|ALARM|)", start).group() for start in starts]
    assert markers == ["", "ALARM", "ALARM OVER", "ALARM OVER", "ALARM", "ALARM OVER", ""]
    # The end of what was only to be watched ends no alarm.
    watched = Fact(WatchFact.ALARM_OVER, time=50.0, reason=limit.replace(Level.WATCH))
    assert "ALARM" not in event_line(Event(9.0, watched, reception=0.0))
    # A landing ends an alarm without curing anything.
    assert "not its cause" not in starts[2] and "not its cause" in starts[3]
    assert "Alarm" not in "".join(printed)


def test_a_wind_that_may_come_from_anywhere_is_half_a_turn_uncertain():
    assert (
        WindEstimate(60.0, np.array([-0.1, 0.0]), np.array([5.0, 5.0])).compass.direction_half_width
        == 180.0
    )


def test_the_direction_of_a_wind_is_kept_while_its_speed_varies_about_calm():
    """Speeds from 0.48 and from 0.52 m/s on: the second states its direction, which stays until it is half unknown."""
    near_calm = WindEstimate(60.0, np.array([-3.48, 0.0]), np.array([3.0, 1.0]))
    windy = WindEstimate(60.1, np.array([-3.52, 0.0]), np.array([3.0, 1.0]))
    from_anywhere = WindEstimate(60.2, np.array([-0.1, 0.0]), np.array([5.0, 5.0]))
    assert not near_calm.is_direction_known and windy.is_direction_known
    near_calm_later = replace(near_calm, was_direction_known=True)
    (speed, direction) = near_calm_later.facts
    assert speed.figures["speed"] is None and direction.figures["direction"] == approx(0.0)
    assert not replace(from_anywhere, was_direction_known=True).is_direction_known


@mark.slow
def test_the_status_stands_in_its_place_on_a_terminal():
    """The terminal shows wind, two alarms and the learning in lines that are updated in place."""
    terminal_output = io.StringIO()
    console = Console(file=terminal_output, force_terminal=True, highlight=False, width=100)
    weak = Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, subject="motor 1", share=0.9)
    other = weak.replace(subject="motor 2")
    wind = WindEstimate(60.0, np.array([-8.0, -11.0]), np.array([2.5, 2.5]))
    status_fields = {
        "wind": wind,
        "is_flying": True,
        "rates": {"ATTITUDE": 99.6},
        "latency": Latency(0.01, 0.02),
    }
    with Live(console=console, auto_refresh=False, transient=True) as terminal_text:
        lines = StatusLines(terminal_text)
        lines.show(Mock(shown_status=SessionStatus(vehicle="1:1")))
        assert "Learning; 0 samples" in terminal_output.getvalue()
        status = SessionStatus(
            vehicle="1:1", learned_rows=123_456, active_alarms=(weak, other), **status_fields
        )
        lines.show(Mock(shown_status=status))
    last = terminal_output.getvalue().split("1:1, nothing received yet.")[-1]
    # The alarm is red and a word, and each light has its level as a word.
    assert "\x1b[1;31m" in last and "Learning; 123,456 samples" in last and "unknown" in last
    # A sentence that is longer than a line wraps, so that none is cut.
    words = re.sub(r"\x1b\[[^m]*m|\s+", " ", last).split()
    # The alarm in the headline is not said twice.
    text = " ".join(words)
    assert text.count(str(weak)) == text.count(str(other)) == 1 and "…" not in last


def shown_status(status, monkeypatch, width=80):
    """Returns the lines of a session's status as a terminal of ``width`` columns shows them."""
    terminal_output = io.StringIO()
    console = Console(file=terminal_output, width=width, highlight=False)
    monkeypatch.setattr("mavdem.cli.live_status.STDERR", console)
    terminal_text = Mock()
    StatusLines(terminal_text).show(Mock(shown_status=status))
    console.print(terminal_text.update.call_args.args[0])
    return terminal_output.getvalue()


@mark.slow
def test_a_long_headline_leaves_room_for_the_table(monkeypatch):
    """The headline names the first of four batteries, although all are nearly empty."""
    further = tuple(
        Fact(PowerLight.CELLS_UNKNOWN, subject=f"battery {number}", voltage=9.4)
        for number in (2, 3, 4)
    )
    spent = Fact(
        PowerLight.CHARGE_LOW,
        Level.BAD,
        subject="battery 1",
        share=0.02,
        share_limit=0.07,
        batteries=further,
    )
    status = SessionStatus("1:1", is_flying=True, active_alarms=(spent,))
    assert len(str(spent)) > 200
    terminal_output = shown_status(status, monkeypatch)
    text = " ".join(terminal_output.split())
    assert (
        "Charge of battery 1 down to 2.0 % by the autopilot's estimate: at or below its limit of 7 %"
        in text
    )
    assert "Land now." in text and "battery 4" not in text


@mark.slow
def test_after_a_landing_nobody_is_asked_to_take_off_again(monkeypatch):
    """After the landing, the status shows the lights of the flight without the advice to take off."""
    landed = SessionStatus(
        "1:1",
        no_model_reason=Fact(SessionFact.NOT_FLYING),
        worst_lights={
            Light.MOTORS: Fact(
                MotorsLight.HEADROOM_LITTLE,
                Level.WATCH,
                names=("motor 4 (rear right)",),
                share=0.07,
                trim=0.7,
            )
        },
    )
    terminal_output = shown_status(landed, monkeypatch)
    text = " ".join(terminal_output.split())
    assert text.count("Not learning; 0 samples") == 1 and "Take off" not in text
    assert "motors watch motor 4: headroom 7 %" in text


def test_changes_of_what_is_watched_are_printed_once_they_settled():
    debouncer = ChangeDebouncer()
    assert not debouncer.update({"tracking": "missing"}, 100.0)
    assert not debouncer.update({"tracking": "missing", "height": "missing"}, 102.0)
    assert not debouncer.update({"height": "missing"}, 105.0)
    assert debouncer.update({"height": "missing"}, 109.0)
    # Without changes nothing waits; and what changes all the time does not wait for ever.
    debouncer.update({}, 199.0)
    settled = [debouncer.update({"height": time}, float(time)) for time in range(200, 220)]
    assert settled.index(True) == MAX_SETTLING_SECONDS


@mark.parametrize("width", [60, 80, 120, 200])
def test_the_status_fits_the_terminal(width, monkeypatch):
    """The status has at most 14 lines on 60 columns, and fewer on wider terminals."""
    wind = WindEstimate(60.0, np.array([-8.0, -11.0]), np.array([2.5, 2.5]))
    missing = Fact(WatchFact.MESSAGE_MISSING, name="SCALED_PRESSURE", rate=None)
    unwatched = Fact(
        WatchFact.NOT_WATCHED, time=3.0, subject=WatchedQuantity.HEIGHT, reason=missing
    )
    status = SessionStatus(
        "1:1", is_flying=True, message_age=0.0, wind=wind, watch_facts=(unwatched,)
    )
    terminal_output = shown_status(status, monkeypatch, width)
    lines = terminal_output.splitlines()
    # The vehicle, headline and next step, seven lights, and a line on the model and what is not watched.
    assert len(lines) <= {60: 14, 80: 9, 120: 8, 200: 8}[width]
    assert max(map(len, lines)) <= min(width, 120)
    text = " ".join(terminal_output.split())
    assert "wind unknown now 11–16 m/s 54°" in text and "Not watched: height." in text


def test_a_flying_vehicle_without_a_judgement_is_not_called_grounded():
    assert SessionStatus().overall_judgement.headline.code is SessionFact.NOT_FLYING
    # After a crash too the vehicle is on the ground: much has to be done then before the next take-off.
    assert "before take-off" not in str(SessionStatus().overall_judgement.next_step)
    assert (
        SessionStatus(is_flying=True).overall_judgement.headline.code is SessionFact.BEING_LEARNED
    )


def test_the_headline_counts_lights_that_need_no_model():
    """The model knows of the margins alone; the watchdog has judged motors, and before any model their light counts."""
    unknown = Fact(VibrationLight.VIBRATION_UNKNOWN, recorder="")
    lights = {str(light): unknown for light in Light}
    lights["margins"] = Fact(LogLight.RECORDED_FAST, Level.GOOD)
    headline = headline_by_lights(lights)
    judgement = Judgement(headline, choose_next_step(headline, lights), lights)
    motors = {Light.MOTORS: Fact(MotorsLight.MOTORS_EVEN, Level.GOOD)}
    status = SessionStatus(model_judgement=judgement, worst_lights=motors)
    headline = status.overall_judgement.headline
    assert headline.figures["names"] == ("motors", "margins")
    waiting = replace(status, model_judgement=None, no_model_reason=Fact(SessionFact.NOT_SETTLED))
    assert waiting.overall_judgement.headline.code is Headline.NOTHING_WRONG
    assert waiting.overall_judgement.next_step.figures["reason"] == waiting.no_model_reason
    # In flight it begins with what the pilot asks first, and with nothing else once it is over.
    flying = replace(waiting, is_flying=True)
    told = str(flying.overall_judgement.headline)
    assert told == (
        "No alarm now, but 6 lights are not judged: motors were checked; "
        "margins, tracking, vibration, power, estimator and wind unknown."
    )
    for status_on_ground in (waiting, replace(flying, is_over=True)):
        assert str(status_on_ground.overall_judgement.headline).startswith("Too little was checked")


@mark.parametrize(
    "obstacle",
    [
        Fact(LinkFact.CONNECTION_LOST, cause=None, reopening=False),
        Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=3.0),
        Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MOTION, duration=3.0),
        Fact(VehicleFact.TWO_VEHICLES_LIVE, subject="1:1"),
    ],
)
def test_a_lost_link_heads_the_status_with_a_light_that_is_bad(obstacle):
    """The link of a flying vehicle is lost, or it is not known whom to follow.

    No light stays good, and a light that is bad is the headline or its cause.
    """
    lights = {Light.MOTORS: Fact(MotorsLight.MOTORS_EVEN, Level.GOOD)}
    status = SessionStatus(no_model_reason=obstacle, worst_lights=lights, is_flying=True)
    headline = status.overall_judgement.headline
    assert obstacle in (headline, headline.figures.get("reason"))
    assert not status.overall_judgement.lights[Light.MOTORS].is_good
    bad = Fact(MotorsLight.MOTORS_AT_LIMIT, Level.BAD)
    status = replace(status, worst_lights={Light.MOTORS: bad})
    headline = status.overall_judgement.headline
    assert bad in (headline, headline.figures.get("cause"))


def test_on_a_terminal_the_place_of_a_lost_vehicle_stands_in_its_line_alone():
    """The line about the vehicle states height and distance also after the link was lost; the headline is short."""
    silent = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=3.0)
    state = VehicleState("Guided", is_armed=True, voltage=12.2)
    status = SessionStatus(
        "1:1",
        state=state,
        is_flying=True,
        flight_seconds=6.0,
        message_age=4.0,
        displacement=Displacement(distance=3.0, height=10.0),
    )
    terminal_text = "10 m above the take-off, 3 m from it"
    assert terminal_text in vehicle_text(status, has_table=True)
    lost = replace(status, no_model_reason=silent)
    assert terminal_text not in headline_text(lost.overall_judgement.headline)
    shown_text = vehicle_text(lost, has_table=True)
    assert (
        shown_text
        == f"1:1, Guided, in flight, last heard 6 s after take-off, last {terminal_text}."
    )


def test_a_line_of_a_log_says_what_is_new(capsys, monkeypatch):
    """Without a terminal a line is printed for each change, and none for a status that was printed before."""
    monkeypatch.setattr("mavdem.cli.live_status.SETTLING_SECONDS", 0.0)
    waiting = Fact(SessionFact.NOT_FLYING)
    ground = Fact(WatchFact.NOT_WATCHED, time=3.0, subject=WatchedQuantity.MOTORS, reason=waiting)
    watched = Fact(WatchFact.WATCHED, time=9.0, subject=WatchedQuantity.MOTORS, reason=None)
    landed = ground.replace(reason=Fact(WatchFact.ON_GROUND_NOW))
    bad = Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, subject="motor 1", share=0.9)
    lines = StatusLines(None)
    news = (
        ({"no_model_reason": waiting, "watch_facts": (ground,)}, 2),
        # The next step, which is the same in this second look.
        ({"no_model_reason": waiting, "watch_facts": (ground,), "learned_rows": 1}, 1),
        ({"no_model_reason": waiting, "watch_facts": (ground,), "learned_rows": 2}, 0),
        ({"watch_facts": (watched,)}, 2),
        ({"watch_facts": (landed,)}, 0),
        ({"watch_facts": (watched,)}, 0),
        ({"watch_facts": (watched,), "active_alarms": (bad,)}, 1),
    )
    for status_fields, count in news:
        lines.show(Mock(shown_status=SessionStatus(vehicle="1:1", **status_fields)))
        assert len(capsys.readouterr().out.splitlines()) == count


@mark.slow
def test_slow_messages_show_no_limit_cycle_and_that_is_said():
    replayed = replay(Flight(Hot(hovering=10.0), attitude=10.0, motors=10.0).frames(end=14.0))
    facts_by_quantity = {fact.subject: fact for fact in replayed.stream.status().watch_facts}
    reason = facts_by_quantity[WatchedQuantity.OSCILLATION].figures["reason"]
    assert reason.code is WatchFact.MESSAGE_MISSING and reason.figures["rate"] < 20


@mark.slow
def test_every_vehicle_on_a_link_is_watched():
    """Two vehicles oscillate. The one that the user follows is reported as itself, others as other vehicles."""
    flights = (
        Flight(Hot(hovering=12.0), attitude=60.0, motors=60.0, system=system) for system in (1, 2)
    )
    frames = by_time(*(flight.frames(end=10.5) for flight in flights))
    replayed = replay(frames)
    facts_by_quantity = facts_about(replayed, WatchFact.OTHER_VEHICLE_ALARM)
    assert {fact.subject for fact in facts_by_quantity} == {"1:1", "2:1"}
    assert {fact.figures["reason"].code for fact in facts_by_quantity} >= {SessionFact.ALARM}
    assert "vehicle 2:1 watched: " in watched_quantities_text(replayed.stream.status().watch_facts)
    # One that was chosen is reported as itself.
    replayed = replay(frames, vehicle="1:1")
    facts_by_quantity = facts_about(replayed, WatchFact.OTHER_VEHICLE_ALARM)
    assert {fact.subject for fact in facts_by_quantity} == {"2:1"} and facts_about(
        replayed, MarginsLight.OSCILLATES
    )


def test_what_is_kept_is_bounded_and_converted_once(monkeypatch):
    converted_times = []

    def columns_of_new(fields, messages, boot):
        converted_times.extend(message.time for message in messages)
        return columns_from(fields, messages, boot)

    monkeypatch.setattr(recent_messages, "columns_from", columns_of_new)
    recent = RecentMessages()
    for second in range(2048):
        recent.add("SYS_STATUS", second, (12000 + second, 100, 50, 0, 0, 0))
        if second % 256 == 0:
            columns = recent.columns(["SYS_STATUS", "HEARTBEAT"], start_time=second - 9)
            assert columns.keys() == {"SYS_STATUS"}
            assert columns["SYS_STATUS"]["time"].tolist() == [
                *range(max(second - 9, 0), second + 1)
            ]
    assert converted_times == [*range(1793)]
    # Every second message of the older half is dropped now.
    recent.add("SYS_STATUS", 2048, (12000 + 2048, 100, 50, 0, 0, 0))
    kept_times = [*range(1, 1024, 2), *range(1024, 2049)]
    assert [time for time, _ in recent.rows["SYS_STATUS"]] == kept_times
    fields = MESSAGE_FIELDS["SYS_STATUS"]
    expected = columns_from(fields, recent.rows["SYS_STATUS"], boot=0)
    assert_equal(recent.columns(["SYS_STATUS"])["SYS_STATUS"], expected)
    assert not recent.columns(["SYS_STATUS"], start_time=2049)


@dataclass(frozen=True)
class Topped(Hover):
    """Motors stay at one output in the climb, and reach none so high later."""

    top: float = 1800.0

    def motors(self, t):
        outputs = super().motors(t)
        outputs[(outputs[:, 0] > 1200) & (t < 9.0)] = self.top
        return outputs


class Limited(Hover):
    """Motor 1 is at its limit from take-off on."""

    def motors(self, t):
        outputs = super().motors(t)
        outputs[:, 0] = np.where(outputs[:, 0] > 1200, 2000.0, outputs[:, 0])
        return outputs


@mark.in_full
def test_the_first_seconds_of_a_flight_name_no_motor():
    replayed = replay(Flight(Limited(hovering=8.0), attitude=50.0, motors=50.0).frames(end=14.0))
    (takeoff,) = [fact for fact in replayed.facts if fact.code is ReportedEvent.OFF_GROUND]
    # No land detector reports.
    assert takeoff.figures["basis"] == ("SERVO_OUTPUT_RAW",)
    # It is recognised later than it was, which the line says: the time of the flight counts from then on.
    start_time = replayed.stream.takeoff_time
    assert start_time < takeoff.time
    assert str(takeoff) == f"Take-off at {start_time:.1f} s (SERVO_OUTPUT_RAW)."
    takeoff_time = takeoff.time
    alarm, *_ = facts_about(replayed, MotorsLight.MOTOR_LIMITED)
    assert takeoff_time + DECISION_SECONDS <= alarm.time <= takeoff_time + DECISION_SECONDS + 1.0


@mark.slow
@mark.parametrize("top", [1800.0, param(2000.0, marks=mark.in_full)])
def test_a_climb_at_one_throttle_is_no_stop_of_the_motors(top):
    replayed = replay(
        Flight(Topped(hovering=12.0, top=top), attitude=50.0, motors=50.0).frames(end=16.0)
    )
    assert {setup.scale.upper_limit for setup in replayed.setups.values()} == {1.0}
    assert not facts_about(replayed, MotorsLight.MOTOR_LIMITED)


@mark.slow
def test_no_message_waits_for_more_than_a_part_of_a_review(monkeypatch):
    """Choice of inputs in two parts, phase and limit cycle: a row would come as late as all of them take."""
    work_times = []
    for name in (
        "motor_inputs.InputSelector.candidate_messages",
        "motor_inputs.InputSelector.select",
        "flight_phase.FlightPhase.review",
        "motor_limit_watch.detect_starting_limit_cycle",
    ):
        original = resolve_name(f"mavdem.live.{name}")

        def part(*given, original=original):
            work_times.append(time)
            return original(*given)

        monkeypatch.setattr(f"mavdem.live.{name}", part)
    stream = LiveStream()
    for time, frame in Flight(Hot(hovering=20.0)).frames(end=14.0):
        rows = stream.process_frames(time, stream.frame_reader.feed(frame))
        before = len(work_times)
        for _ in rows:
            assert len(work_times) == before
    # With the message by which the vehicle is followed, its earlier ones are processed.
    first = work_times[0]
    work_times = [time for time in work_times if time > first]
    assert len(work_times) > 30 and len(set(work_times)) == len(work_times)


def test_after_a_gap_no_light_says_that_the_motors_lost_no_thrust_in_it():
    """The test of their balance begins anew then, and would not find a loss in the gap."""
    watchdog = Watchdog(RecentMessages())
    lights = watchdog.status_lights
    watchdog.set_motors_watched(None, 22.0)
    watchdog.set_motors_watched(Fact(WatchFact.SETTLED_FLIGHT_AWAITED), 50.0)
    assert lights.latest[Light.MOTORS].figures["clock"] == 22.0, "a manoeuvre is no gap"
    watchdog.set_motors_watched(
        Fact(WatchFact.REFERENCE_SHORT, duration=8.0, remaining_duration=5.0), 60.0
    )
    assert Light.MOTORS not in lights.latest
    watchdog.set_motors_watched(None, 70.0)
    assert lights.latest[Light.MOTORS].figures["clock"] == 70.0


def test_messages_with_arrays_are_counted_where_a_value_of_the_array_changes():
    recent = RecentMessages()
    for time, cell in enumerate((4100, 4100, 4050)):
        recent.add("BATTERY_STATUS", float(time), (0, np.array([cell, 4100]), -1, 50, 1))
    assert recent.changes["BATTERY_STATUS"] == 2


def test_what_was_asked_for_in_vain_is_not_advised():
    lights = {str(light): Fact(LogLight.RECORDED_FAST, Level.GOOD) for light in Light}
    unknown = lights["vibration"] = Fact(VibrationLight.VIBRATION_UNKNOWN, recorder="")
    headline = Fact(Headline.NOTHING_WRONG, Level.GOOD)
    judgement = Judgement(headline, choose_next_step(headline, lights), lights)
    status = SessionStatus(model_judgement=judgement)
    assert "Ask for VIBRATION" in str(status.overall_judgement.next_step)
    asked = replace(status, absent_messages=frozenset({"VIBRATION"})).overall_judgement
    assert asked.lights["vibration"] == unknown.replace(is_asked=True)
    assert str(asked.next_step) == "Look for the vibration in the autopilot's own log."
    # The same fact with other figures is the same advice.
    other = replace(judgement, lights=lights | {"vibration": unknown.replace(is_zero=True)})
    asked = replace(
        status, model_judgement=other, absent_messages=frozenset({"VIBRATION"})
    ).overall_judgement
    assert "Ask for VIBRATION" not in str(asked.next_step)
    tracking = Fact(TrackingLight.TRACKING_UNKNOWN, axis="roll", asked=False, recorder="")
    lights |= {"vibration": lights["log"], "tracking": tracking}
    untracked = Judgement(headline, choose_next_step(headline, lights), lights)
    status = replace(status, model_judgement=untracked)
    assert "Ask for ATTITUDE_TARGET" in str(status.overall_judgement.next_step)
    asked = replace(status, absent_messages=frozenset({"ATTITUDE_TARGET"})).overall_judgement
    assert str(asked.lights["tracking"]) == "ATTITUDE_TARGET was asked for, and does not come."
    assert str(asked.next_step) == "Look for the tracking in the autopilot's own log."


def test_what_a_flight_has_shown_stays_the_headline_once_the_landed_vehicle_is_silent():
    silent = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=3.0)
    lights = {Light.MOTORS: Fact(MotorsLight.MOTORS_EVEN, Level.GOOD)}
    unwatched = Fact(
        WatchFact.NOT_WATCHED, time=9.0, subject=WatchedQuantity.TRACKING, reason=silent
    )
    judgement = SessionStatus(
        no_model_reason=silent, worst_lights=lights, watch_facts=(unwatched,)
    ).overall_judgement
    assert judgement.headline.code is Headline.NOTHING_WRONG
    # Nothing helps a light that can no longer be judged, so that it is no step.
    assert judgement.next_step.code is NextStep.KEEP_LOG


@mark.parametrize("is_flying", [True, False])
def test_a_bad_event_heads_the_status_before_the_vibration_that_caused_it(is_flying):
    vibration = Fact(VibrationLight.VIBRATION_MEASURED, Level.BAD)
    diverged = Fact(MotionEvent.HEIGHT_DIVERGED, time=20.0)
    status = SessionStatus(
        is_flying=is_flying,
        worst_lights={Light.VIBRATION: vibration, Light.ESTIMATOR: diverged},
        active_alarms=(vibration, diverged) if is_flying else (),
    )
    assert status.overall_judgement.headline == diverged


@mark.parametrize(
    "autopilot, name",
    [("PX4", "ESTIMATOR_STATUS"), ("ARDUPILOTMEGA", "EKF_STATUS_REPORT")],
)
def test_the_message_that_is_missing_is_that_of_the_autopilot(autopilot, name):
    vehicle = Telemetry(1, 1, "QUADROTOR", autopilot, {}, {})
    watchdog = Watchdog(RecentMessages())
    reasons = watchdog._reasons_not_watched(5.0, vehicle, None)
    assert reasons[WatchedQuantity.ESTIMATOR].figures["name"] == name


def test_what_a_light_calls_unknown_is_not_called_watched_beside_it(monkeypatch):
    """A battery is watched once it is judged, which outlasts a reboot; the tracking too, after settled flight."""
    vehicle = Telemetry(1, 1, "QUADROTOR", "PX4", {}, {})
    unmeasured = Fact(PowerLight.POWER_UNMEASURED)
    monkeypatch.setattr(watchdog_module, "power_light", Mock(return_value=unmeasured))
    review = Review(
        6.0, vehicle, is_flying=True, has_settled=False, phase_start=5.0, recent_signals=None
    )

    def reasons_in_flight(watchdog):
        watchdog._slow_messages.names_since = Mock(return_value={"SYS_STATUS"})
        watchdog._tracking.has_setpoints = Mock(return_value=True)
        watchdog.update_phase(5.0, is_flying=True)
        reasons = watchdog._reasons_not_watched(6.0, vehicle, None)
        quantities = (WatchedQuantity.BATTERY, WatchedQuantity.TRACKING)
        return [reasons[quantity].code for quantity in quantities if quantity in reasons]

    first_boot = Watchdog(RecentMessages())
    awaited = [RowsFact.RATES_BEING_MEASURED, WatchFact.TRACKING_AWAITED]
    assert reasons_in_flight(first_boot) == awaited
    first_boot._judge_battery(review, Condition(duration=1.0))
    assert reasons_in_flight(first_boot) == awaited
    first_boot._judge_battery(review, Condition(duration=10.0))
    first_boot.status_lights.add(Light.TRACKING, Fact(TrackingLight.FOLLOWS_SETPOINT, Level.GOOD))
    for watchdog in (first_boot, Watchdog(RecentMessages(), first_boot, was_flying=True)):
        assert reasons_in_flight(watchdog) == [WatchFact.BATTERY_NOT_JUDGED]


@mark.slow
def test_a_battery_whose_voltage_comes_is_never_said_to_be_unmeasured():
    """The voltage falls from the first message on, so that the battery is measured."""
    voltages = [
        (time, "SYS_STATUS", {"voltage_battery": round(12600 - 10 * time)})
        for time in ticks(3.0, 14.0, 2.0)
    ]
    reasons = [
        fact.figures["reason"].code
        for fact in watched_with_messages(*voltages, until=14.0).watch_facts
        if fact.subject == WatchedQuantity.BATTERY and fact.figures["reason"] is not None
    ]
    assert reasons
    assert WatchFact.BATTERY_NOT_JUDGED not in reasons


def test_a_weak_motor_takes_one_line_of_the_table_on_a_narrow_terminal(monkeypatch):
    weak = Fact(
        MotorWatchFact.MOTOR_LOST_THRUST,
        Level.BAD,
        time=62.0,
        subject="motor 1 (front right)",
        loss=(0.32, 0.59),
        rise=0.2,
        probability=0.99,
        assumed=False,
        boot=0,
    )
    status = SessionStatus("1:1", worst_lights={Light.MOTORS: weak})
    lines = shown_status(status, monkeypatch).splitlines()
    motors_line = r"motors +BAD +motor 1: −32 to −59 % +vibration +unknown"
    assert any(re.match(motors_line, line) for line in lines)
    # That its alarm is over hides neither the motor nor the loss.
    over = Fact(WatchFact.ALARM_OVER, Level.BAD, time=50.0, reason=weak)
    lines = shown_status(replace(status, worst_lights={Light.MOTORS: over}), monkeypatch)
    assert any(re.match(motors_line, line) for line in lines.splitlines())


def test_a_light_that_warns_has_words_beside_its_level():
    judged = Fact(SessionFact.LIGHT_OF_RECORDING, Level.BAD)
    [motors, *_] = light_rows(SessionStatus("1:1", worst_lights={Light.MOTORS: judged}))
    assert motors.level is Level.BAD and motors.figure


@mark.slow
def test_a_take_off_ends_what_is_said_of_a_vehicle_on_the_ground(monkeypatch):
    """The review, which decides why nothing is learned, comes twice a second."""
    stream = replay(Flight(attitude=20.0, motors=20.0).frames(end=6.0)).stream
    monkeypatch.setattr(stream._review, "no_rows_reason", Fact(SessionFact.NOT_FLYING))
    monkeypatch.setattr(stream._phase, "is_flying", True)
    assert stream.status().no_model_reason is None
    monkeypatch.setattr(stream._phase, "is_flying", False)
    assert stream.status().no_model_reason is not None


def test_lines_below_each_other_say_that_attitude_is_back_during_an_alarm(capsys):
    silent = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MOTION, duration=3.0)
    alarm = Fact(ReportedEvent.BATTERY_ALARMED, Level.BAD)
    lines = StatusLines(None)
    alarmed = SessionStatus(
        "1:1",
        is_flying=True,
        no_model_reason=silent,
        active_alarms=(alarm,),
        state=VehicleState("Hold", is_armed=True),
        message_age=0.5,
    )
    rates = {"ATTITUDE": 50.0, "SERVO_OUTPUT_RAW": 50.0}
    unsettled = Fact(SessionFact.NOT_SETTLED)
    for status in (alarmed, replace(alarmed, no_model_reason=unsettled, rates=rates)):
        lines.show(Mock(shown_status=status))
    without, step, back, other_step = capsys.readouterr().out.splitlines()
    assert "; unknown: motors" in without and without.endswith("; no attitude; not learning")
    assert "; good: log; unknown: motors" in back and back.endswith("; 50 Hz; not learning")
    assert "s  NEXT Land" in step and "s  NEXT Land" in other_step


def test_each_new_next_step_is_printed_once_and_a_link_that_is_just_lost(capsys, monkeypatch):
    alarm = Fact(ReportedEvent.BATTERY_ALARMED, Level.BAD)
    watched = Fact(WatchFact.WATCHED, time=4.0, subject=WatchedQuantity.OSCILLATION, reason=None)
    sound = SessionStatus(
        "1:1",
        is_flying=True,
        no_model_reason=Fact(SessionFact.NOT_SETTLED),
        watch_facts=(watched,),
        state=VehicleState("Hold", is_armed=True),
        message_age=0.5,
    )
    alarmed = replace(sound, active_alarms=(alarm,))
    lines = StatusLines(None)
    steps = []
    # Another alarm asks for the same.
    other = replace(sound, active_alarms=(Fact(ReportedEvent.BATTERY_SPENT, Level.BAD),))
    for status in (sound, sound, alarmed, other, sound, sound, sound):
        lines.show_status(status)
        printed = capsys.readouterr().out.splitlines()
        steps.append([line.split("NEXT ")[1] for line in printed if "NEXT" in line])
    # Without a warning a step must be the same in two looks.
    assert steps == [[], ["Fly on."], ["Land now."], [], [], ["Fly on."], []]
    # After a delay the step that holds again is the last one that is printed.
    late = replace(sound, held_alarm_delay=4.0)
    for status in (late, sound, sound, late, sound, sound):
        lines.show_status(status)
    printed = capsys.readouterr().out
    assert re.findall("NEXT (.*?)[:.]", printed) == 2 * ["Watch the vehicle itself", "Fly on"]
    assert "; up to 4 s late" in printed
    # To fly on is no news while a model is learned.
    learning = replace(sound, no_model_reason=None)
    # After a landing the step waits until the flight is judged.
    landed = replace(sound, is_flying=False, flight_number=1)
    read = Fact(SessionFact.RECORDING_NOT_JUDGED, kind=RecordingState.BEING_READ)
    judged = replace(landed, recording_verdict=read)
    for status in (learning, learning, sound, sound, learning, learning, landed, landed, judged):
        lines.show_status(status)
    lines.show_status(judged)
    printed = capsys.readouterr().out
    assert re.findall("NEXT (.*?)[:.]", printed) == ["Wait for the result before the next flight"]
    # A fault that the model shows only after the landing is printed once, before what to do about it.
    small = Fact(MotorsLight.MOTOR_LIMITED, Level.WATCH, subject="motor 1", share=0.9)
    found = replace(landed, worst_lights={Light.MOTORS: small})
    for status in (landed, found, found):
        lines.show_status(status)
    verdict, step = [
        line for line in capsys.readouterr().out.splitlines() if "VERDICT" in line or "NEXT" in line
    ]
    assert f"VERDICT {headline_text(small)}" in verdict and "NEXT" in step
    # In flight a light that warns without an alarm is stated as the reason of the step, once.
    warned = replace(sound, worst_lights={Light.MOTORS: small})
    lines = StatusLines(None)
    for status in (sound, warned, warned):
        lines.show_status(status)
    reason, step = [
        line for line in capsys.readouterr().out.splitlines() if "WARNING" in line or "NEXT" in line
    ]
    assert reason.endswith(f"WARNING {headline_text(small)}") and "NEXT" in step
    lines.show_status(sound)
    lines.show_status(sound)
    capsys.readouterr()
    silence = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=3.0)
    silent = replace(sound, no_model_reason=silence, message_age=5.0)
    for status in (silent, silent, sound, silent):
        lines.show_if_new(status)
    printed = capsys.readouterr().out
    assert printed.count("s  WARNING Link lost 5 s ago, in flight") == 2
    lines.show_status(silent)
    assert "NEXT" not in capsys.readouterr().out, "the warning has said it"
    # The alarm has only what the warning did not say.
    long_loss = replace(silent, message_age=10.0).link_loss
    lines.print_event(Event(4.0, long_loss, reception=0.0))
    alarm_text = capsys.readouterr().out.partition("ALARM ")[2]
    assert alarm_text == (
        "Link lost 10 s ago, in flight. Land by sight: no alarm can come while the link is lost.\n"
    )
    lines.print_event(Event(5.0, resumption(MissingMessages.MESSAGES, 12.0), reception=0.0))
    capsys.readouterr()
    # The alarm says what to do. Once it is over, the step before is printed again, at the first look.
    lines.print_event(Event(4.0, Fact(SessionFact.ALARM, reason=alarm), reception=0.0))
    lines.print_event(Event(4.0, Fact(ReportedEvent.ON_GROUND, basis=()), reception=0.0))
    lines.show_status(alarmed)
    printed = capsys.readouterr().out
    assert "ALARM" in printed and printed.count("Land now.") == 1 and "NEXT" not in printed
    over = Fact(WatchFact.ALARM_OVER, time=5.0, reason=alarm)
    lines.print_event(Event(5.0, over, reception=0.0))
    lines.show_status(sound)
    assert "NEXT Fly on." in capsys.readouterr().out
    # Later, when the alarm may be far above, the same step is printed.
    lines.print_event(Event(6.0, Fact(SessionFact.ALARM, reason=alarm), reception=0.0))
    monkeypatch.setattr("mavdem.cli.live_status.ADVICE_SECONDS", -1.0)
    lines.show_status(alarmed)
    assert "NEXT Land now." in capsys.readouterr().out


def test_a_status_below_earlier_lines_keeps_all_lights_and_has_the_next_step_below(
    capsys, monkeypatch
):
    """The fault of an earlier flight and the next step are printed once, although the status is repeated."""
    loss = Fact(Ending.CONTROL_LOST, time=22.1, height=10.0, cause=None, word=None)
    crashed = SessionStatus("1:1", is_flying=True, flight_number=1, flight_seconds=34.0, loss=loss)
    alarm = Fact(ReportedEvent.BATTERY_ALARMED, Level.BAD)
    status = SessionStatus(
        "1:1",
        is_flying=True,
        flight_number=2,
        verdicts=(crashed.verdict,),
        active_alarms=(alarm,),
        state=VehicleState("Hold", is_armed=True, voltage=9.9, charge=4.0),
        message_age=0.5,
    )
    monkeypatch.setattr("mavdem.cli.live_status.UNCHANGED_STATE_PERIOD", 0.0)
    lines = StatusLines(None)
    for _ in range(2):
        lines.show_status(status)
    first, fault, step, repetition = capsys.readouterr().out.splitlines()
    texts = [line.split("s  ", 1)[1] for line in (first, fault, step, repetition)]
    assert texts[0] == texts[3] and "9.9 V (4 %)" in texts[0]
    assert all(name in texts[0] for name in status.overall_judgement.lights)
    assert texts[1].startswith("Flight 1 (0:34 min): lost control")
    assert texts[2].startswith("NEXT Land")


def test_an_alarm_that_stays_after_the_landing_is_shown_as_a_fault(monkeypatch):
    alarm = Fact(ReportedEvent.BATTERY_ALARMED, Level.BAD)
    landed = VehicleState("Hold", is_armed=False)
    status = SessionStatus("1:1", active_alarms=(alarm,), state=landed, message_age=40.0)
    shown = shown_status(status, monkeypatch)
    assert "The autopilot reports a critical battery." in shown
    assert "ALARM" not in shown and "no attitude" not in shown
    # A vehicle that is silent after its landing is switched off, and nobody need check its link.
    silent = Fact(RowsFact.NOTHING_RECEIVED, subject=MissingMessages.MESSAGES, duration=3.0)
    switched_off = replace(
        status, no_model_reason=silent, flight_number=1, worst_lights={Light.POWER: alarm}
    )
    shown = shown_status(switched_off, monkeypatch, width=300)
    assert "last message 40 s ago" in shown
    assert "No messages" not in shown and "router" not in shown, "its first line says it"


@mark.slow
def test_what_forbids_to_fly_since_an_earlier_flight_stands_on_terminal_lines_and_page(
    monkeypatch, capsys
):
    weak = Fact(MotorsLight.MOTOR_LIMITED, Level.BAD, subject="motor 3", share=0.9)
    first = SessionStatus("1:1", flight_number=1, worst_lights={Light.MOTORS: weak}).verdict
    second = SessionStatus("1:1", is_flying=True, flight_number=2, verdicts=(first,))
    account = dict.fromkeys(TimeUse, 0.0)
    for status in (second, replace(second, is_flying=False)):
        StatusLines(None).show(Mock(shown_status=status))
        texts = {
            "terminal": shown_status(status, monkeypatch, width=1000),
            "lines": capsys.readouterr().out,
            "page": live_page("udp", "roll", LiveHistory(), status, account, None),
        }
        for surface, text in texts.items():
            words = text.replace("\N{NO-BREAK SPACE}", " ")
            assert "Flight 1: motor 3" in words, surface
            advice = "Do not fly"
            if status.is_flying:
                is_line = surface == "lines"
                advice = "not repaired, land" if is_line else "Land unless the fault of flight 1"
            assert advice in words, surface
    # On the ground no event asks for a take-off.
    StatusLines(None).print_event(Event(12.0, Fact(SessionFact.NOT_FLYING), reception=0.0))
    event_text = capsys.readouterr().out
    assert "on the ground" in event_text and "Take off" not in event_text


def test_plain_lines_say_that_a_loss_of_thrust_is_not_watched_until_it_is(capsys, monkeypatch):
    monkeypatch.setattr("mavdem.cli.live_status.SETTLING_SECONDS", 0.0)

    def watch_fact(code, reason):
        return Fact(code, time=4.0, subject=WatchedQuantity.MOTORS, reason=reason)

    reference = Fact(WatchFact.REFERENCE_SHORT, duration=8.0)
    status = SessionStatus("1:1", is_flying=True, message_age=0.0)
    lines = StatusLines(None)
    for fact in (
        watch_fact(WatchFact.NOT_WATCHED, reference),
        watch_fact(WatchFact.WATCHED, None),
    ):
        lines.show(Mock(shown_status=replace(status, watch_facts=(fact,))))
    printed = capsys.readouterr().out
    assert "Not watched: loss of thrust (the first 8 s of settled flight" in printed
    assert "Watched: loss of thrust (since 4 s)" in printed
    # The alarm of a weak motor shows that the thrust is watched.
    weak = Fact(
        MotorWatchFact.MOTOR_LOST_THRUST, Level.BAD, subject="motor 3", loss=(0.2, 0.4), time=9.0
    )
    alarm = Fact(SessionFact.ALARM, Level.BAD, reason=weak)
    watched = watch_fact(WatchFact.WATCHED, None)
    alarmed = replace(status, watch_facts=(watched,), active_alarms=(alarm,))
    StatusLines(None).show(Mock(shown_status=alarmed))
    assert "Watched: loss of thrust" not in capsys.readouterr().out


def test_the_headline_of_an_earlier_flight_is_its_first_clause():
    weak = Fact(
        MotorWatchFact.MOTOR_LOST_THRUST, Level.BAD, subject="motor 3", loss=(0.2, 0.4), time=9.0
    )
    crash = Fact(
        Ending.CRASHED,
        Level.BAD,
        time=38.2,
        height=None,
        speed=5.1,
        cause=None,
        word=None,
        weak_motor=weak,
    )
    verdict = SessionStatus("1:1", flight_number=1, loss=crash).verdict.fact
    assert "before that, motor 3" in verdict.sentence
    standing = Fact(SessionFact.UNREPAIRED_FAULT, reason=verdict, next_step=None, is_in_flight=True)
    for text in (headline_text(verdict), str(standing)):
        assert text.startswith("Flight 1: ") and "before that" not in text


def test_the_terminal_rings_once_for_each_alarm_and_never_elsewhere(monkeypatch):
    """A bell character is printed on a terminal only, and only for alarms."""
    terminal_output = io.StringIO()
    console = Console(file=terminal_output, width=80, force_terminal=True, color_system=None)
    monkeypatch.setattr("mavdem.cli.live_status.STDERR", console)
    limit = Fact(ReportedEvent.BATTERY_ALARMED, Level.BAD)
    alarm = Event(9.0, Fact(SessionFact.ALARM, reason=limit), reception=0.0)
    note = Event(9.0, Fact(SessionFact.FLIGHT_UNKNOWN), reception=0.0)
    lines = StatusLines(None)
    lines.print_event(alarm)
    assert terminal_output.getvalue().count("\a") == 0
    lines.terminal_text = Mock()
    for event in (note, alarm, note):
        lines.print_event(event)
    assert terminal_output.getvalue().count("\a") == 1


def test_lines_above_a_status_are_about_the_vehicle_and_short(monkeypatch):
    """Above a status in place only the landing is printed; without a terminal also that rows begin."""
    terminal_output = io.StringIO()
    console = Console(file=terminal_output, width=80, force_terminal=True, color_system=None)
    monkeypatch.setattr("mavdem.cli.live_status.STDERR", console)
    rows_begin = Fact(RowsFact.ROWS_BEGIN, names=("ATTITUDE",), step=0.01, inputs=4)
    landed = Fact(ReportedEvent.ON_GROUND, time=9.0, basis=("EXTENDED_SYS_STATE",))
    events = [Event(9.0, fact, reception=0.0) for fact in (rows_begin, landed)]
    for terminal_text, line_count in ((Mock(), 1), (None, 2)):
        terminal_output.seek(0)
        terminal_output.truncate()
        lines = StatusLines(terminal_text, console)
        for event in events:
            lines.print_event(event)
        assert len(terminal_output.getvalue().splitlines()) == line_count
        assert "On the ground" in terminal_output.getvalue()


def test_the_conclusion_below_other_lines_begins_with_the_time_and_goes_on_below_its_text():
    terminal_output = io.StringIO()
    console = Console(file=terminal_output, width=60, force_terminal=True, color_system=None)
    StatusLines(None, console).print_conclusion("The motors are sound. " * 4, "VERDICT")
    first, *others = terminal_output.getvalue().splitlines()
    column = first.index("VERDICT The motors")
    assert re.match(r"\d\d:\d\d:\d\d +- s  $", first[:column])
    assert others
    for line in others:
        assert len(line) - len(line.lstrip()) == column


def test_lines_that_a_full_disk_loses_are_reported_once(capsys):
    class FullDisk(io.StringIO):
        def write(self, text):
            raise OSError(ENOSPC, "No space left on device")

    lines = StatusLines(None, Console(file=FullDisk(), width=80))
    for _ in range(2):
        lines.print_conclusion("The motors are sound.")
    (report,) = capsys.readouterr().err.splitlines()
    assert report.startswith("mavdem: Standard output cannot be written to (No space left")


def test_a_state_of_listening_is_not_printed(capsys):
    """Messages come, and their sender is mostly known a moment later."""
    listening = SessionStatus(no_model_reason=Fact(VehicleFact.LISTENING))
    StatusLines(None).show(Mock(shown_status=listening))
    assert capsys.readouterr().out == ""


def test_a_terminal_that_was_closed_does_not_end_the_session():
    terminal_text = Mock(**{"update.side_effect": OSError("Input/output error")})
    StatusLines(terminal_text).show(Mock(shown_status=SessionStatus("1:1")))
    assert terminal_text.update.called
