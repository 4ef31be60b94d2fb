"""How a live vehicle follows its setpoints, by the light of a log."""

from dataclasses import replace
from math import cos, inf, sin

from pytest import approx, mark

from mavdem.assessment.axis.tracking import tracking_of_axes
from mavdem.dataset.segments import Segment
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Level
from mavdem.facts.margins import TrackingLight
from mavdem.facts.watch import WatchFact
from mavdem.ingest.telemetry import Telemetry
from mavdem.live.link import SILENCE_SECONDS
from mavdem.live.messages import MESSAGE_FIELDS, Message
from mavdem.live.recent_messages import RecentMessages, TimedValues, columns_from
from mavdem.live.tracking_watch import MIN_SETTLED_SECONDS, TrackingWatch

VEHICLE = Telemetry(1, component=1, vehicle="QUADROTOR", autopilot="ARDUPILOTMEGA", messages={})


def add_flight(watch, start, end, error):
    """Adds attitudes and setpoints from start to end, s, at 50 Hz; roll deviates by a constant error, rad."""
    for row in range(round(50 * (end - start))):
        time = start + row / 50
        roll = 0.05 * sin(time)
        quaternion = (cos(roll / 2), sin(roll / 2), 0.0, 0.0)
        watch.add_message(
            Message("ATTITUDE_TARGET", time, inf, (7, quaternion, 0.0, 0.0, 0.0)), time
        )
        watch.add_message(
            Message("ATTITUDE", time, inf, (roll + error, 0.0, 0.0, 0.0, 0.0, 0.0)), time
        )


@mark.parametrize(
    "error, seconds, level",
    [
        (0.0, 2.0 * MIN_SETTLED_SECONDS, Level.GOOD),
        (0.3, 2.0 * MIN_SETTLED_SECONDS, Level.BAD),
        (0.3, 0.5 * MIN_SETTLED_SECONDS, None),
    ],
)
def test_the_tracking_is_that_of_the_latest_minute(error, seconds, level):
    """Roll deviates from its setpoint by a constant error, rad; after too few seconds it is not judged."""
    watch = TrackingWatch(RecentMessages())
    assert not watch.has_setpoints(0.0)
    add_flight(watch, 0.0, seconds, error)
    assert watch.has_setpoints(seconds)
    light = watch.judge(seconds, VEHICLE, 0.0)
    assert (None if light is None else light.level) is level


def test_setpoints_that_show_too_little_are_the_reason_once_settled_flight_is_long_enough(
    monkeypatch,
):
    watch = TrackingWatch(RecentMessages())
    seconds = 2.0 * MIN_SETTLED_SECONDS
    add_flight(watch, 0.0, seconds, 0.0)
    assert watch.reason_not_judged(seconds, 0.0).code is WatchFact.TRACKING_AWAITED
    unknown = Fact(TrackingLight.TRACKING_UNKNOWN, recorder="", axis="roll", asked=True)
    monkeypatch.setattr("mavdem.live.tracking_watch.tracking_light", lambda _: unknown)
    assert watch.judge(seconds, VEHICLE, 0.0) is None
    assert watch.reason_not_judged(seconds, 0.0).code is WatchFact.SETPOINTS_SHOW_LITTLE
    assert watch.reason_not_judged(seconds, None).code is WatchFact.TRACKING_AWAITED


def quick_motion(seconds):
    """Roll follows quick steps of a stick, as a first-order lag, at 100 Hz; every other row has a setpoint, too."""
    roll = 0.0
    for row in range(round(100 * seconds)):
        time = row / 100
        setpoint = 0.2 if time % 0.37 < 0.17 else -0.2
        roll += (setpoint - roll) / 8
        yield "ATTITUDE", TimedValues(time, (roll, 0.0, 0.0, 0.0, 0.0, 0.0))
        if row % 2 == 0:
            quaternion = (cos(setpoint / 2), sin(setpoint / 2), 0.0, 0.0)
            yield "ATTITUDE_TARGET", TimedValues(time, (7, quaternion, 0.0, 0.0, 0.0))


def test_errors_of_quick_motion_are_those_of_the_log():
    """A log has all messages. Were some left out live, the setpoint would be interpolated there: another error."""
    watch = TrackingWatch(RecentMessages())
    seconds = 1.5 * MIN_SETTLED_SECONDS
    messages = {"ATTITUDE": [], "ATTITUDE_TARGET": []}
    for name, sample in quick_motion(seconds):
        watch.add_message(Message(name, sample.time, inf, sample.values), sample.time)
        messages[name].append(sample)
    columns = {
        name: columns_from(MESSAGE_FIELDS[name], samples, 0) for name, samples in messages.items()
    }
    log = tracking_of_axes(Signals(replace(VEHICLE, messages=columns)), [Segment(0, 0.0, seconds)])
    live_error = watch.judge(seconds, VEHICLE, 0.0).figures["angle_error"]
    assert live_error == approx(log["roll"].figures["angle_error"], rel=1e-6)


@mark.slow
def test_rates_are_judged_where_the_attitude_is_to_be_ignored():
    """As of a pilot in a mode without angles, or a computer that commands rates: bit 7 of the type mask."""
    watch = TrackingWatch(RecentMessages())
    seconds = 2.0 * MIN_SETTLED_SECONDS
    for row in range(round(50 * seconds)):
        time = row / 50
        rate = sin(3.0 * time)
        setpoint = (128, (1.0, 0.0, 0.0, 0.0), rate, 0.0, 0.0)
        watch.add_message(Message("ATTITUDE_TARGET", time, inf, setpoint), time)
        attitude = (0.0, 0.0, 0.0, rate, 0.0, 0.0)
        watch.add_message(Message("ATTITUDE", time, inf, attitude), time)
    light = watch.judge(seconds, VEHICLE, 0.0)
    assert light.is_good and light.code is TrackingLight.FOLLOWS_RATE_SETPOINT


@mark.slow
@mark.parametrize(
    "seconds_after_gap, level", [(1.0, None), (2.0 * MIN_SETTLED_SECONDS, Level.GOOD)]
)
def test_the_tracking_is_judged_anew_after_a_gap_of_messages(seconds_after_gap, level):
    """Roll deviates from its setpoint before the gap, and follows it afterwards."""
    watch = TrackingWatch(RecentMessages())
    gap_start = 2.0 * MIN_SETTLED_SECONDS
    gap_end = gap_start + 2.0 * SILENCE_SECONDS
    add_flight(watch, 0.0, gap_start, error=0.3)
    assert watch.judge(gap_start, VEHICLE, 0.0).is_bad
    end = gap_end + seconds_after_gap
    add_flight(watch, gap_end, end, error=0.0)
    light = watch.judge(end, VEHICLE, 0.0)
    assert (None if light is None else light.level) is level


@mark.parametrize(
    "message_rate, rate_of_setpoint, is_found", [(50, 0.3, True), (50, 0.0, False), (4, 0.3, False)]
)
def test_a_rate_setpoint_shows_the_loop_if_it_changes_and_is_fast(
    message_rate, rate_of_setpoint, is_found
):
    """The loop can be identified from a rate setpoint that changes and comes at 50 Hz, but not from one at 4 Hz."""
    watch = TrackingWatch(RecentMessages())
    assert not watch.has_rate_setpoint(VEHICLE, "roll")
    for row in range(10 * message_rate):
        time = row / message_rate
        roll_rate = rate_of_setpoint * sin(time)
        values = (0, (1.0, 0.0, 0.0, 0.0), roll_rate, 0.0, 0.0)
        watch.add_message(Message("ATTITUDE_TARGET", time, inf, values), time)
    assert watch.has_rate_setpoint(VEHICLE, "roll") == is_found
    assert not watch.has_rate_setpoint(VEHICLE, "pitch")
