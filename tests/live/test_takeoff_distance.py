"""How far a live vehicle is from the place of its take-off."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
from hover import Hover
from live_hover import Flight, by_time, replay
from mavlink_streams import message
from pytest import approx, mark

from mavdem.assessment.wind_drifts import drift_sample
from mavdem.facts import Fact
from mavdem.facts.session import RowsFact
from mavdem.live.link_loss import link_loss_fact
from mavdem.live.session_status import SessionStatus
from mavdem.live.vehicle_state import VehicleState
from mavdem.report.live import status_line_text, vehicle_state_cells, vehicle_text

pytestmark = mark.slow


class Unplaced(Flight):
    """A flight that sends no position: the test does."""

    def _climb(self, start, end):
        return []


def test_without_a_local_position_the_global_one_shows_distance_and_height():
    """The vehicle moves by 1e-4 degrees of latitude, 11 m, and climbs by 10 m; before that no position is known."""
    positions = [
        (
            time,
            message(
                "GLOBAL_POSITION_INT",
                time_boot_ms=round(1e3 * time),
                lat=degrees and round(1e7 * degrees),
                lon=degrees and round(85e6),
                relative_alt=round(1e3 * height),
            ),
        )
        for time, degrees, height in ((5.1, 0, 0), (5.2, 47.0, 0.5), (12.0, 47.0001, 10.5))
    ]
    flight = Unplaced(Hover(hovering=8.0), attitude=20.0, motors=20.0).frames(end=12.8)
    status = replay(by_time(flight, positions)).stream.status()
    assert status.displacement_from_takeoff == (approx(11.1, abs=0.1), approx(10.0))
    # It is also where the vehicle is searched once its link is lost.
    assert status.last_position[:3] == (approx(47.0001), approx(8.5), approx(10.5))


def test_a_vehicle_without_a_position_of_its_own_is_searched_where_satellites_saw_it_last():
    fixes = [
        (time, message("GPS_RAW_INT", fix_type=fix_type, lat=round(1e7 * degrees), lon=85_000_000))
        for time, fix_type, degrees in ((5.5, 3, 47.0), (6.0, 3, 47.1), (6.5, 1, 47.2))
    ]
    own = message("GLOBAL_POSITION_INT", time_boot_ms=5900, lat=471500000, lon=85_000_000)
    flight = Unplaced(Hover(hovering=8.0), attitude=20.0, motors=20.0).frames(end=7.0)
    lost = replay(by_time(flight, fixes)).stream.status().last_position
    assert lost[:3] == (approx(47.1), approx(8.5), None)
    lost = replay(by_time(flight, fixes, [(5.9, own)])).stream.status().last_position
    assert lost[:3] == (approx(47.15), approx(8.5), 0.0)


def test_a_vehicle_is_not_searched_where_it_was_in_a_flight_before_a_reboot():
    """After the reboot no position comes; until it flies again, the last one is where the vehicle lies."""
    fix = message("GPS_RAW_INT", fix_type=3, lat=470000000, lon=85_000_000)
    flight = Unplaced(Hover(hovering=8.0), attitude=20.0, motors=20.0)
    flown = replay(by_time(flight.frames(end=17.0), [(9.0, fix)]))
    assert flown.stream.status().last_position is not None

    # Frames with the bytes of former ones would count as their copies.
    rebooted = [(time + 20.0, frame) for time, frame in flight.frames(start=0.01, end=8.0)]
    first_seconds = [(time, frame) for time, frame in rebooted if time < 23.0]
    on_ground = replay(first_seconds, flown.stream).stream
    assert on_ground.boot == 1 and on_ground.status().last_position is not None
    in_next_flight = replay(rebooted[len(first_seconds) :], on_ground).stream.status()
    assert in_next_flight.is_flying and in_next_flight.last_position is None
    text = link_loss_fact(
        Fact(RowsFact.NOTHING_RECEIVED, duration=3.0),
        age=12.0,
        reception=None,
        displacement=None,
        voltage=None,
        last_position=in_next_flight.last_position,
        cause=None,
        is_over=False,
    ).sentence
    assert text.endswith("no position received in this flight.")


def test_distance_and_height_from_the_take_off_are_shown_in_flight(monkeypatch):
    """Positions 20 m east of the take-off and 10 m above it are received."""
    drift_samples = Mock(wraps=drift_sample)
    monkeypatch.setattr("mavdem.live.stream.drift_sample", drift_samples)
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
    assert status.is_flying and status.displacement_from_takeoff == (approx(20.0), approx(10.0))
    # The drift in wind is judged by the velocity north and east of the same messages.
    assert {call.args[2] for call in drift_samples.call_args_list} == {(1.5, -2.0)}
    text = vehicle_text(
        SessionStatus(
            "1:1",
            is_flying=True,
            state=VehicleState(),
            position=(3.0, 20.4, -12.0),
            takeoff_position=(3.0, 0.0, -1.7),
        )
    )
    assert text.startswith("1:1, in flight 20 m from the take-off and 10 m above it, battery")


def test_no_distance_is_shown_where_the_take_off_was_not_seen():
    flight = Unplaced(Hover(hovering=20.0), attitude=20.0, motors=20.0).frames(start=12.0, end=19.0)
    positions = [
        (time, message("LOCAL_POSITION_NED", time_boot_ms=round(1e3 * time), x=3.0, y=time))
        for time in np.arange(12.0, 19.0, 0.5).tolist()
    ]
    status = replay(by_time(flight, positions)).stream.status()
    assert status.is_flying and status.displacement_from_takeoff is None


def test_a_vehicle_that_was_met_in_flight_is_so_far_from_its_home_position():
    """The take-off was not seen. The vehicle is 1e-4 degrees of latitude, 11 m, from home, and 10 m above it."""
    flight = Unplaced(Hover(hovering=20.0), attitude=20.0, motors=20.0).frames(start=12.0, end=19.0)
    home = message("HOME_POSITION", latitude=470_000_000, longitude=85_000_000, altitude=400_000)
    own = message(
        "GLOBAL_POSITION_INT",
        time_boot_ms=18_000,
        lat=470_001_000,
        lon=85_000_000,
        relative_alt=10_000,
    )
    status = replay(by_time(flight, [(15.0, home), (18.0, own)])).stream.status()
    assert status.place_in_flight == ("home", approx(11.1, abs=0.1), approx(10.0))
    shown = replace(status, state=VehicleState("Guided"))
    assert "in flight 11 m from home and 10 m above it" in vehicle_text(shown)
    assert replace(status, is_flying=False).place_in_flight is None
    # Without HOME_POSITION the height above it is known, and the distance from it is not.
    only_height = replay(by_time(flight, [(18.0, own)])).stream.status()
    assert only_height.place_in_flight == ("home", None, approx(10.0))
    only_height = replace(only_height, state=VehicleState("Guided"))
    assert "in flight 10 m above home, " in vehicle_text(only_height)
    assert "in flight, 10 m above home; " in status_line_text(only_height)
    height_cell = vehicle_state_cells(only_height)[1]
    assert (height_cell.lead, height_cell.text) == ("10 m up", "above home")


def test_a_take_off_before_the_vehicle_is_followed_is_seen():
    """It is followed from its third HEARTBEAT on, at 6 s, when it takes off."""
    stream = replay(Flight(attitude=25.0, motors=25.0).frames(start=4.5, end=12.0)).stream
    assert stream.takeoff_time == approx(6.0, abs=0.01)
