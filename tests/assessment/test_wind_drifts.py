"""A vehicle that wind carries away, and one that only brakes; a log and a live flight are judged the same."""

from dataclasses import dataclass, replace
from math import radians

import numpy as np
from hover import Hover, changed, columns
from live_hover import Flight, replay
from mavlink_streams import read, tlog
from pytest import approx, mark

from mavdem.assessment.assess import assess
from mavdem.assessment.wind_drifts import WindDriftDetector, drift_sample, wind_drifts
from mavdem.dataset.signals import Signals
from mavdem.facts import Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.lights import Light
from mavdem.facts.session import SessionFact
from mavdem.facts.watch import WatchFact
from mavdem.witnesses.boot_sensors import BootSensors


def drift_of(roll_degrees, east, yaw=0.0, **parameters):
    """The drift in ten seconds with a roll and a velocity that each are constant or a series; None without one."""
    detector = WindDriftDetector()
    times = np.arange(100.0, 110.0, 0.25)
    rolls = np.broadcast_to(np.radians(roll_degrees), times.shape)
    velocities = np.broadcast_to(east, times.shape)
    for time, roll, velocity in zip(times, rolls, velocities, strict=True):
        detector.add_sample(drift_sample(time, (roll, 0.0, yaw), (0.0, velocity)), parameters)
    return detector.latest


def test_a_vehicle_that_moves_against_its_thrust_is_carried_away():
    drift = drift_of(45.0, -2.0)
    assert drift.level is Level.BAD and drift.time == 100.0 and drift.end_time is None
    assert drift.figures["distance"] == approx(19.5)
    assert drift.sentence == (
        "Wind carries the vehicle away since 100 s: it leans 45° against its motion, as far as it may, and still moves "
        "at 2.0 m/s, 20 m so far."
    )


@mark.parametrize(
    "roll, east, yaw, parameters",
    [
        (45.0, 8.0, 0.0, {}),  # It flies where it leans to.
        (45.0, -0.1, 0.0, {}),  # It holds its place.
        (45.0, -2.0, radians(180.0), {}),
        (25.0, -2.0, 0.0, {}),  # It could lean further.
        (45.0, np.minimum(-16.0 + 8.0 * np.arange(0.0, 10.0, 0.25), 0.0), 0.0, {}),  # It brakes.
        (45.0, -2.0, 0.0, {"ANGLE_MAX": 6000.0}),
    ],
)
def test_motions_that_are_no_drift_by_wind_give_no_event(roll, east, yaw, parameters):
    assert drift_of(roll, east, yaw, **parameters) is None


def test_a_drift_ends_before_a_long_gap():
    detector = WindDriftDetector()
    for time in (*np.arange(100.0, 110.0, 0.25).tolist(), 300.0):
        detector.add_sample(drift_sample(time, (radians(45.0), 0.0, 0.0), (0.0, -2.0)), {})
    assert detector.latest.end_time == 109.75
    assert detector.latest.figures["distance"] == approx(19.5)


def test_a_lean_limit_in_the_parameters_replaces_the_usual_one():
    assert drift_of(25.0, -2.0, ATC_ANGLE_MAX=25.0) is not None


@mark.slow
def test_a_lean_limit_that_was_set_after_the_flight_is_not_that_of_the_flight():
    """At the limit of 25° the wind carries the vehicle away for 10 s; after the landing 60° are allowed."""
    telemetry = Hover().telemetry(20.0, 20.0)
    roll = np.full(len(telemetry.messages["ATTITUDE"]["time"]), radians(25.0))
    telemetry = changed(telemetry, "ATTITUDE", roll=roll)
    time = telemetry.messages["LOCAL_POSITION_NED"]["time"]
    is_blown = (time >= 20.0) & (time < 30.0)
    velocity = np.where(is_blown, -2.0, 2.0)
    telemetry = changed(telemetry, "LOCAL_POSITION_NED", vx=0.0, vy=velocity, x=0.0, y=0.0, z=-5.0)
    landed = Hover().landed
    settings = columns(
        np.array([1.0, landed + 2.0]),
        param_id=np.array([b"ATC_ANGLE_MAX"] * 2),
        param_type=9,
        param_value=np.array([25.0, 60.0]),
    )
    telemetry = changed(telemetry, "PARAM_VALUE", **settings)
    signals = Signals(replace(telemetry, parameters={"ATC_ANGLE_MAX": 60.0}))
    [drift] = wind_drifts(BootSensors(signals, 0), (6.0, landed))
    assert drift.time == approx(20.0, abs=3.0) and drift.figures["lean"] == approx(radians(25.0))


@dataclass(frozen=True)
class BlownFlight(Flight):
    """A flight that leans 44° to the right from 13 s to 23 s, and moves to the left at 3 m/s."""

    def _attitude(self, start, end):
        for time, name, values in super()._attitude(start, end):
            roll = radians(44.0) if 13.0 <= time < 23.0 else 0.0
            yield time, name, values | {"roll": roll, "rollspeed": 0.0, "pitch": 0.0}

    def _climb(self, start, end):
        for time, name, values in super()._climb(start, end):
            yield time, name, values | {"vy": -3.0 if 13.0 <= time < 23.0 else 0.1}


@mark.slow
def test_a_log_and_a_live_flight_are_judged_the_same():
    """The wind carries the vehicle away for ten seconds: the alarm in flight and the event of the log agree."""
    frames = BlownFlight(Hover(hovering=30.0), attitude=20.0, motors=20.0).frames(end=64.0)
    replayed = replay(frames)
    [alarm] = [fact for fact in replayed.facts if fact.code is SessionFact.ALARM]
    [end_of_alarm] = [fact for fact in replayed.facts if fact.code is WatchFact.ALARM_OVER]
    drift = end_of_alarm.figures["reason"]
    # What to do before the next flight is no advice in the air.
    assert alarm.sentence_and_remedy.endswith("Descend to where the wind is weaker, and land.")
    assert alarm.time == approx(13.0 + 5.0, abs=2.0) and end_of_alarm.time == approx(23.5, abs=1.0)
    # After the landing the light still says that it was so.
    status = replayed.stream.status()
    assert not status.is_flying and status.overall_judgement.headline.level is Level.BAD
    assert status.worst_lights[Light.WIND].level is Level.BAD

    assessment = assess(read(tlog(content for _, content in frames)))
    [event] = [fact for fact in assessment.evidence.events if fact.code is MotionEvent.CARRIED_AWAY]
    assert event.end_time == drift.end_time and event.figures == approx(drift.figures)
    assert assessment.lights[Light.WIND] == event and assessment.judgement.headline == event


@dataclass(frozen=True)
class BlownWithoutAttitude(BlownFlight):
    """The same flight, whose attitude does not come from 15 s to 40 s."""

    def _attitude(self, start, end):
        for time, name, values in super()._attitude(start, end):
            if not 15.0 <= time < 40.0:
                yield time, name, values


@mark.slow
def test_an_attitude_that_no_longer_comes_shows_no_drift():
    frames = BlownWithoutAttitude(Hover(hovering=30.0), attitude=20.0, motors=20.0).frames(end=64.0)
    assessment = assess(read(tlog(content for _, content in frames)))
    codes = [fact.code for fact in assessment.evidence.events]
    assert MotionEvent.CARRIED_AWAY not in codes
