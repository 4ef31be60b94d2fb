"""Loss of control in flight: it is alarmed by the judgement of a log, and after it nothing speaks as of a landing."""

from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np
from hover import MAV_AUTOPILOTS, MAV_TYPES, Hover
from live_hover import Flight, by_time, offline, replay, ticks
from mavlink_streams import message
from pytest import approx, fixture, mark, param

from mavdem.dataset.phases import TRANSIENT_SECONDS, settled_intervals
from mavdem.dataset.signals import Signals
from mavdem.facts import Level
from mavdem.facts.assessment import NextStep
from mavdem.facts.ending import Ending, FailedFirst
from mavdem.facts.events import ReportedEvent
from mavdem.facts.lights import Light
from mavdem.facts.motors import MotorsLight
from mavdem.facts.session import SessionFact
from mavdem.facts.vibration import VibrationLight
from mavdem.facts.watch import WatchFact
from mavdem.ingest.telemetry import Telemetry
from mavdem.live.live_signals import FlightMoment
from mavdem.live.recent_messages import RecentMessages
from mavdem.live.watchdog import Watchdog

LOST = 18.0
"""When the vehicle begins to leave its level setpoint, s."""
RATE = 25.0
"""Rate of attitude and motor messages, Hz: a replay takes as long as it has messages, and these suffice for a loss."""
HIGH_RATE = 50.0
"""The same for rows of a model, which need 40 Hz, and for events that last less than a second."""


class Rolling(Hover):
    """A hover that rolls in a way of its own: its rate is the slope of the angle."""

    def roll_rate(self, t):
        return (self.roll(t + 0.01) - self.roll(t - 0.01)) / 0.02


@dataclass(frozen=True)
class Leaving(Rolling):
    """Leaves its setpoint from ``LOST`` on, faster and faster; it lands at ``landed``."""

    hovering: float = 3.0

    @property
    def landed(self):
        return LOST + 4.0

    def roll(self, t):
        return 3.0 * np.clip(np.asarray(t) - LOST, 0.0, None) ** 2

    def motors(self, t):
        outputs = super().motors(t)
        outputs[:, 0] = np.where((t > LOST + 0.1) & (t < self.landed), 2000.0, outputs[:, 0])
        return outputs


@dataclass(frozen=True)
class HighFlight(Flight):
    """A flight 10 m above its take-off, until it is lost."""

    def _climb(self, start, end):
        for time, name, fields in super()._climb(start, end):
            height = np.interp(time, [6.0, 11.0, LOST, self.hover.landed], [0.0, 10.0, 10.0, 0.0])
            yield time, name, fields | {"z": -float(height)}


def replayed_with_messages(hover, *messages, setpoint=True, rate=RATE):
    """Replays a flight with level setpoints of the attitude, and further messages: time, name and fields of each."""
    level = {"q": [1.0, 0.0, 0.0, 0.0], "type_mask": 7}
    targets = [
        (time, message("ATTITUDE_TARGET", time_boot_ms=round(1e3 * time), **level))
        for time in ticks(3.0, LOST + 7.0, 20.0)
        if setpoint
    ]
    others = [(time, message(name, **fields)) for time, name, fields in messages]
    return replay(by_time(HighFlight(hover, rate, rate).frames(end=LOST + 7.0), targets, others))


def alarms(replayed):
    """Returns the alarms that were reported, in the order of time."""
    return [fact for fact in replayed.facts if fact.code is SessionFact.ALARM]


class Wavering(Leaving):
    """Leans by 0.5 rad for a second and by 0.8 rad for a moment before it leaves its setpoint for good."""

    def roll(self, t):
        lean = np.interp(t, [8.0, 8.5, 9.5, 10.0], [0.0, 0.5, 0.5, 0.0])
        away = np.clip(np.asarray(t) - 11.0, 0.0, None)
        return super().roll(t) + lean + (away < 1.2) * np.minimum(3.0 * away**2, 0.8)


@fixture(scope="module")
def lost():
    return replayed_with_messages(Wavering())


@mark.slow
def test_a_loss_of_control_is_alarmed_within_a_second_and_before_a_motor_at_its_limit(lost):
    """What a log does not call lost raises no alarm: a lean within 30 degrees, or one from which it is back at once."""
    [alarm] = alarms(lost)
    loss = alarm.figures["reason"]
    assert loss.code is Ending.CONTROL_LOST and loss.is_bad
    assert LOST < alarm.time <= LOST + 1.5
    assert "parachute" in alarm.remedy and "Land now" not in alarm.remedy


@mark.slow
def test_after_a_loss_nothing_speaks_as_of_a_landing(lost):
    assert WatchFact.ALARM_OVER not in lost.codes
    status = lost.stream.status()
    assert not status.is_flying
    assert status.no_model_reason.code is SessionFact.FLIGHT_OVER
    judgement = status.overall_judgement
    assert judgement.headline.code is Ending.CONTROL_LOST
    assert judgement.next_step.code is NextStep.DO_AS_ADVISED
    assert judgement.lights[Light.TRACKING].is_bad
    # Motors that fought the loss are not called sound.
    assert not judgement.lights[Light.MOTORS].is_good
    assert status.active_alarms == (status.loss,)


@dataclass(frozen=True)
class TurningOver(Leaving):
    """Turns over again and again, and is upright once in each turn."""

    def roll(self, t):
        return np.angle(np.exp(1j * super().roll(t)))


@mark.in_full
def test_a_loss_of_control_ends_settled_flight_some_seconds_before_its_onset_as_in_a_log():
    tumbling = replayed_with_messages(TurningOver(), rate=HIGH_RATE)
    alarm = alarms(tumbling)[0]
    _, withdrawal_time = tumbling.taken_back[0]
    onset = alarm.figures["reason"].time
    assert LOST <= onset < alarm.time
    assert withdrawal_time == approx(onset - TRANSIENT_SECONDS)
    frames = HighFlight(TurningOver(), HIGH_RATE, HIGH_RATE).frames(end=LOST + 7.0)
    vehicle = offline([frame for _, frame in frames])
    [(_, settled_end)] = settled_intervals(Signals(vehicle), 0)
    assert settled_end == approx(withdrawal_time, abs=1.0)
    settled_times = [row.time for row in tumbling.rows if row.is_settled]
    assert settled_times and max(settled_times) <= alarm.time


@dataclass(frozen=True)
class LimitedBefore(Leaving):
    """Motor 3 is at its upper limit for three seconds of the hover, until long before the loss."""

    hovering: float = 12.0

    def motors(self, t):
        outputs = super().motors(t)
        outputs[:, 2] = np.where((t > 8.0) & (t < 11.0), 2000.0, outputs[:, 2])
        # The loss is not by the motors: none shows it.
        outputs[:, 0] = np.where((t > LOST) & (t < self.landed), outputs[:, 1], outputs[:, 0])
        return outputs


@mark.in_full
def test_faults_that_are_over_long_before_a_loss_are_not_its_cause_and_not_active_after_it():
    """The vibration of the last minute is judged still, but neither reported nor shown after the loss."""
    clips = [
        (time, "VIBRATION", {"vibration_x": 5.0, "clipping_0": 0 if time < 9.0 else 5000})
        for time in ticks(4.0, LOST + 7.0, 2.0)
    ]
    replayed = replayed_with_messages(LimitedBefore(), *clips)
    limited, shaken, loss = [alarm.figures["reason"] for alarm in alarms(replayed)]
    assert limited.code is MotorsLight.MOTOR_LIMITED and limited.subject
    assert shaken.code is VibrationLight.VIBRATION_MEASURED
    assert loss.code is Ending.CONTROL_LOST
    assert not loss.subject and loss.figures["cause"] is None
    assert replayed.stream.status().active_alarms == (replayed.stream.status().loss,)


class LeaningFar(Leaving):
    """Leans by 80 degrees for two seconds before it turns over."""

    def roll(self, t):
        away = np.clip(np.asarray(t) - 9.0, 0.0, None)
        return super().roll(t) + (away < 2.0) * np.minimum(3.0 * away**2, 1.4)


@mark.in_full
def test_a_lean_without_a_setpoint_is_lost_only_where_it_is_far():
    """A pilot may lean by 80 degrees on purpose; nobody flies on the back for seconds without saying so."""
    replayed = replayed_with_messages(LeaningFar(), setpoint=False)
    loss = replayed.stream.status().loss
    assert loss.code is Ending.CONTROL_LOST and loss.time > LOST
    losses = [alarm.figures["reason"] for alarm in alarms(replayed)]
    assert [one.code for one in losses].count(Ending.CONTROL_LOST) == 1


@dataclass(frozen=True)
class Tumbling(Rolling):
    """Hovers for a moment; once its motors stop, it turns over if ``tumbles``."""

    hovering: float = 1.0
    tumbles: bool = True

    @property
    def landed(self):
        return self.sinking + 4.0

    def roll(self, t):
        since_stop = np.asarray(t) - self.landed
        tumbled = self.tumbles * np.clip(since_stop, 0.0, 1.4)
        return np.where(since_stop < 0.0, super().roll(t), tumbled)


@dataclass(frozen=True)
class StoppedFlight(Flight):
    """A flight whose motors stop 10 m above the take-off, over ``ground``, m, to which the vehicle falls."""

    ground: float = 0.0

    def _climb(self, start, end):
        """Yields the height of a vehicle that climbs 10 m and falls freely once its motors have stopped."""
        drop = 10.0 - self.ground
        for time, name, fields in super()._climb(start, end):
            falling = np.clip(time - self.hover.landed, 0.0, None)
            height = np.interp(time, [6.0, 11.0], [0.0, 10.0])
            is_falling = 0.0 < falling < np.sqrt(2 * drop / 9.81)
            fallen = min(0.5 * 9.81 * falling**2, drop)
            motion = {"vz": 9.81 * falling * is_falling} if time > 11.0 else {}
            yield time, name, fields | {"z": fallen - float(height)} | motion


@mark.slow
def test_a_vehicle_whose_motors_stop_in_the_air_has_not_landed_and_a_closed_throttle_is_the_cause():
    """The pilot closes the throttle 0.3 s before the vehicle falls."""
    hover = Tumbling()
    sticks = [
        (time, message("RC_CHANNELS", time_boot_ms=round(1e3 * time), chan3_raw=pulse))
        for time in ticks(3.0, 21.0, 5.0)
        for pulse in [1500 if time < hover.landed - 0.3 else 1000]
    ]
    replayed = replay(by_time(StoppedFlight(hover, RATE, RATE).frames(end=21.0), sticks))
    idle, falling, alarm = alarms(replayed)
    assert idle.figures["reason"].code is WatchFact.FALLS_AT_IDLE
    assert falling.figures["reason"].code is WatchFact.STOPPED_IN_AIR
    assert falling.figures["reason"].time == idle.figures["reason"].time
    assert falling.time < alarm.figures["reason"].time
    assert ReportedEvent.ON_GROUND not in replayed.codes
    status = replayed.stream.status()
    assert not status.is_flying and not status.has_landed
    assert status.loss is alarm.figures["reason"]
    assert status.loss.code is Ending.CRASHED
    assert status.loss.figures["cause"].code is FailedFirst.THROTTLE_CLOSED_FIRST


@mark.in_full
def test_a_landing_above_the_take_off_is_one():
    replayed = replay(
        StoppedFlight(Tumbling(tumbles=False), RATE, RATE, ground=9.9).frames(end=21.0)
    )
    assert not alarms(replayed)
    assert ReportedEvent.ON_GROUND in replayed.codes
    assert replayed.stream.status().has_landed


CRASH_TEXT = {"severity": 0, "text": b"Crash: Disarming: AngErr=46>30"}


class Spun(Hover):
    """A hover that rotates fast for a moment before the autopilot reports a crash."""

    def roll_rate(self, t):
        return super().roll_rate(t) + 8.0 * ((np.asarray(t) > 19.0) & (np.asarray(t) < 19.2))


@mark.in_full
def test_a_crash_that_the_motion_does_not_show_loses_no_flight():
    replayed = replayed_with_messages(Hover(hovering=3.0), (20.0, "STATUSTEXT", CRASH_TEXT))
    [alarm] = alarms(replayed)
    assert alarm.figures["reason"].code is ReportedEvent.CRASH_DETECTED
    assert alarm.level is Level.WATCH and "Stop the motors" not in alarm.remedy
    assert replayed.stream.status().loss is None


@fixture(scope="module")
def crashed():
    """A flight in which the autopilot reports a crash at 20 s."""
    return replayed_with_messages(Spun(hovering=3.0), (20.0, "STATUSTEXT", CRASH_TEXT))


@mark.slow
def test_a_crash_that_the_autopilot_reports_is_no_landing(crashed):
    status = crashed.stream.status()
    assert [alarm.figures["reason"].code for alarm in alarms(crashed)] == [
        ReportedEvent.CRASH_DETECTED
    ]
    assert status.loss.code is Ending.LOSS_REPORTED
    assert status.overall_judgement.lights[Light.TRACKING].level is Level.BAD
    in_flight = replace(status, is_flying=True, is_over=False)
    assert in_flight.overall_judgement.next_step.sentence.startswith("Stop the motors.")


@mark.slow
@mark.parametrize(
    "boot_time, take_off", [(0.0, 47.0), (39.5, 43.0)], ids=["in this boot", "in the next"]
)
def test_a_reported_crash_is_over_with_the_next_take_off(crashed, boot_time, take_off):
    """At the time of take-off the autopilot reports that it is in the air again."""
    beat = {"type": MAV_TYPES["QUADROTOR"], "autopilot": MAV_AUTOPILOTS["ARDUPILOTMEGA"]}
    attitudes = [
        (time, message("ATTITUDE", time_boot_ms=round(1e3 * (time - boot_time)), pitch=0.01))
        for time in ticks(40.0, 50.0, RATE)
    ]
    states = [
        (time, message("EXTENDED_SYS_STATE", landed_state=1 if time < take_off else 2))
        for time in ticks(40.0, 50.0, 2.0)
    ]
    beats = [(time, message("HEARTBEAT", base_mode=129, **beat)) for time in ticks(40.0, 50.0, 1.0)]
    stream = deepcopy(crashed.stream)
    replay(by_time(attitudes, states, beats), stream)
    assert stream.is_flying
    assert stream.status().loss is None


@dataclass(frozen=True)
class Throttled(Hover):
    """A hover whose motors idle from 14.0 s to 14.2 s and from 18.0 s to 18.8 s; then they carry the vehicle again."""

    hovering: float = 15.0

    def motors(self, t):
        is_closed = ((t >= 14.0) & (t < 14.2)) | ((t >= 18.0) & (t < 18.8))
        return np.where(is_closed[:, None], 1100.0, super().motors(t))


@dataclass(frozen=True)
class FallingFlight(Flight):
    """A flight at 20 m that falls while its motors idle, and goes on where it was caught."""

    def _climb(self, start, end):
        """Yields the height of a vehicle that climbs 20 m and falls freely while its motors idle."""
        for time, name, fields in super()._climb(start, end):
            height = np.interp(time, [6.0, 11.0], [0.0, 20.0])
            speed = {}
            for fall_start, fall_end in ((14.0, 14.2), (18.0, 18.8)):
                seconds = min(max(time - fall_start, 0.0), fall_end - fall_start)
                height -= 4.9 * seconds**2
                if fall_start <= time < fall_end:
                    speed = {"vz": 9.8 * seconds}
            yield time, name, fields | {"z": -float(height)} | speed


@mark.slow
def test_a_fall_with_idle_motors_is_alarmed_before_it_ends_and_is_no_loss_where_it_is_caught():
    """The motors idle from 18.0 s to 18.8 s, when the pilot gives thrust again; 0.2 s before that raise no alarm."""
    flight = FallingFlight(Throttled(), attitude=HIGH_RATE, motors=HIGH_RATE)
    replayed = replay(flight.frames(end=22.0))
    [alarm] = alarms(replayed)
    fall = alarm.figures["reason"]
    assert fall.code is WatchFact.FALLS_AT_IDLE and fall.is_bad
    assert 18.0 <= fall.time <= 18.1 and alarm.time <= 18.8
    assert alarm.remedy.startswith("Give thrust, or release the parachute.")
    [over] = [fact for fact in replayed.facts if fact.code is WatchFact.ALARM_OVER]
    assert 18.8 <= over.time <= 20.0 and over.figures["reason"].code is WatchFact.FALLS_AT_IDLE
    status = replayed.stream.status()
    assert status.loss is None and not status.active_alarms
    assert not status.overall_judgement.lights[Light.TRACKING].is_bad


@dataclass(frozen=True)
class Toppling(Rolling):
    """Rolls onto its side a moment after it has landed."""

    hovering: float = 1.0

    @property
    def landed(self):
        return self.sinking + 10.0

    def roll(self, t):
        since_landing = np.asarray(t) - self.landed
        fallen = np.clip(4.0 * (since_landing - 0.3), 0.0, 1.5)
        return np.where(since_landing < 0.0, super().roll(t), fallen)


@dataclass(frozen=True)
class LandingFlight(Flight):
    """A flight 10 m above its take-off, which sinks to the ground in the last 10 s of its hover."""

    def _climb(self, start, end):
        landed = self.hover.landed
        for time, name, fields in super()._climb(start, end):
            height = np.interp(time, [6.0, 11.0, landed - 10.0, landed], [0.0, 10.0, 10.0, 0.0])
            yield time, name, fields | {"z": -float(height)}


@mark.in_full
def test_a_vehicle_that_topples_over_after_its_landing_is_an_alarm():
    hover = Toppling()
    end = hover.landed + 6.0
    level = [
        (time, message("ATTITUDE_TARGET", q=[1.0, 0.0, 0.0, 0.0], type_mask=7))
        for time in ticks(3.0, end, 20.0)
    ]
    replayed = replay(by_time(LandingFlight(hover, RATE, RATE).frames(end=end), level))
    losses = [alarm.figures["reason"] for alarm in alarms(replayed)]
    assert [loss.code for loss in losses] == [Ending.TOPPLED_AT_LANDING]


def test_control_is_not_judged_before_the_first_review_of_a_flight():
    vehicle = Telemetry(1, component=1, vehicle=MAV_TYPES["QUADROTOR"], autopilot=3, messages={})
    moment = FlightMoment(10.0, vehicle, takeoff_time=0.0, motion=None)
    assert Watchdog(RecentMessages()).review_control(moment) == []


SINKING_FROM = 14.0
"""When a vehicle begins to sink, s."""


@dataclass(frozen=True)
class Limited(Hover):
    """Sinks at 1.5 m/s with all or one of its motors at the upper limit."""

    hovering: float = 20.0
    limited: int = 1

    def motors(self, t):
        outputs = super().motors(t)
        outputs[t > SINKING_FROM, : self.limited] = 2000.0
        return outputs


@dataclass(frozen=True)
class SinkingFlight(Flight):
    """A flight in Loiter that sinks from 20 m."""

    def _heartbeats(self, start, end):
        for time, name, fields in super()._heartbeats(start, end):
            yield time, name, fields | {"base_mode": fields["base_mode"] + 1, "custom_mode": 5}

    def _climb(self, start, end):
        for time, name, fields in super()._climb(start, end):
            height = np.interp(time, [6.0, 11.0, SINKING_FROM, 24.0], [0.0, 20.0, 20.0, 5.0])
            speed = {"vz": 1.5} if time > SINKING_FROM else {}
            yield time, name, fields | {"z": -float(height)} | speed


@mark.slow
@mark.parametrize(
    "pulse, limited, sinks",
    [param(1500, 1, True, marks=mark.in_full), (1200, 1, False), (1200, 4, True)],
)
def test_a_descent_that_the_pilot_commands_is_alarmed_only_without_any_reserve(
    pulse, limited, sinks
):
    """A vehicle sinks with one or all four motors at their limit.

    With a low throttle stick (1200 µs) the pilot wants to sink, so that one motor at its limit is no reason for it.
    """
    flight = SinkingFlight(Limited(limited=limited), attitude=RATE, motors=RATE)
    sticks = [
        (time, message("RC_CHANNELS", time_boot_ms=round(1e3 * time), chan3_raw=pulse))
        for time in ticks(3.0, 20.0, 5.0)
    ]
    replayed = replay(by_time(flight.frames(end=20.0), sticks))
    codes = [alarm.figures["reason"].code for alarm in alarms(replayed)]
    assert (WatchFact.SINKS_AT_LIMIT in codes) is sinks
    # That a motor is at its limit is said in any case.
    assert sinks or MotorsLight.MOTOR_LIMITED in codes
