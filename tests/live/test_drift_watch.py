"""A vehicle that wind carries away, and one that only brakes."""

from math import radians
from unittest.mock import Mock

import numpy as np
from hover import Hover
from live_hover import Flight, by_time, replay
from mavlink_streams import message
from pytest import approx, mark

from mavdem.facts import Level
from mavdem.facts.lights import Light
from mavdem.facts.session import SessionFact
from mavdem.facts.watch import WatchFact
from mavdem.live.drift_watch import DriftWatch
from mavdem.live.session_status import SessionStatus
from mavdem.live.vehicle_state import VehicleState
from mavdem.report.live import vehicle_text


def watched(roll_degrees, east, yaw=0.0, **parameters):
    """What is reported of ten seconds with a roll and a velocity that each are constant or a series."""
    watch = DriftWatch()
    times = np.arange(100.0, 110.0, 0.25)
    rolls = np.broadcast_to(np.radians(roll_degrees), times.shape)
    velocities = np.broadcast_to(east, times.shape)
    facts = [
        watch.add_sample(time, (roll, 0.0, yaw), (0.0, velocity), parameters)
        for time, roll, velocity in zip(times, rolls, velocities, strict=True)
    ]
    return watch, [fact for fact in facts if fact is not None]


def test_a_vehicle_that_moves_against_its_thrust_is_carried_away():
    watch, [alarm] = watched(45.0, -2.0)
    assert alarm.code is SessionFact.ALARM and alarm.level is Level.BAD and alarm.time == 100.0
    assert alarm.advised == (
        "Alarm: wind carries the vehicle away since 100 s: it leans 45° against its motion, as far as it may, and "
        "still moves at 2.0 m/s. Descend to where the wind is weaker, and land. Fly in less wind."
    )
    assert watch.active and watch.lights[Light.WIND] == alarm.figures["reason"]
    ends = [
        watch.add_sample(time, (0.1, 0.0, 0.0), (0.0, -2.0), {})
        for time in np.arange(110.0, 114.0, 0.25)
    ]
    [over] = [fact for fact in ends if fact is not None]
    assert over.code is WatchFact.ALARM_OVER and not watch.active
    # The light keeps its level, and says that it is over.
    assert watch.lights == {Light.WIND: over.replace(Level.BAD)}
    watch.end_flight()
    watch.add_sample(200.0, (0.0, 0.0, 0.0), (0.0, 0.0), {})
    assert not watch.lights


@mark.parametrize(
    "roll, east, yaw, parameters",
    [
        (45.0, 8.0, 0.0, {}),  # it flies where it leans to
        (45.0, -0.1, 0.0, {}),  # it holds its place
        (45.0, -2.0, radians(180.0), {}),
        (25.0, -2.0, 0.0, {}),  # lean is left
        (45.0, np.minimum(-16.0 + 8.0 * np.arange(0.0, 10.0, 0.25), 0.0), 0.0, {}),  # it brakes
        (45.0, -2.0, 0.0, {"ANGLE_MAX": 6000.0}),
    ],
)
def test_what_is_not_carried_away(roll, east, yaw, parameters):
    watch, facts = watched(roll, east, yaw, **parameters)
    assert not facts and not watch.lights


def test_a_limit_that_is_known_counts():
    _, facts = watched(25.0, -2.0, ATC_ANGLE_MAX=25.0)
    assert len(facts) == 1


class Unplaced(Flight):
    """A flight that sends no position: the test does."""

    def _climb(self, start, end):
        return []


def test_distance_and_height_from_the_take_off_are_shown_in_flight(monkeypatch):
    taken = Mock(return_value=None)
    monkeypatch.setattr(DriftWatch, "add_sample", taken)
    hover = Hover(hovering=8.0)
    positions = [
        (
            time,
            message(
                "LOCAL_POSITION_NED",
                time_boot_ms=round(1e3 * time),
                x=3.0,
                y=4.0 * moved,
                z=-2.0 * moved,
                vx=1.5,
                vy=-2.0,
                vz=9.0,
            ),
        )
        for time, moved in ((5.2, 0.0), (5.4, 0.0), (12.0, 5.0), (12.3, 5.0), (12.6, 5.0))
    ]
    flight = Unplaced(hover, attitude=20.0, motors=20.0).frames(end=12.8)
    status = replay(by_time(flight, positions)).stream.status()
    assert status.is_flying and status.from_takeoff == (approx(20.0), approx(10.0))
    assert {call.args[2] for call in taken.call_args_list} == {(1.5, -2.0)}
    shown = vehicle_text(
        SessionStatus(
            "1:1",
            is_flying=True,
            state=VehicleState(),
            position=(3.0, 20.4, -12.0),
            takeoff_position=(3.0, 0.0, -1.7),
        )
    )
    assert shown.startswith("1:1, in flight 20 m from the take-off and 10 m above it, battery")


def test_no_distance_is_shown_where_the_take_off_was_not_seen():
    flight = Unplaced(Hover(hovering=20.0), attitude=20.0, motors=20.0).frames(start=12.0, end=19.0)
    positions = [
        (time, message("LOCAL_POSITION_NED", time_boot_ms=round(1e3 * time), x=3.0, y=time))
        for time in np.arange(12.0, 19.0, 0.5).tolist()
    ]
    status = replay(by_time(flight, positions)).stream.status()
    assert status.is_flying and status.from_takeoff is None
