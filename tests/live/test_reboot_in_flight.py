"""A vehicle whose autopilot reboots in flight: what was known of its flight before is still known."""

from dataclasses import replace

from pytest import approx, fixture, mark

import mavdem
from mavdem.experiments.paper.flights import write_log
from mavdem.facts import Fact
from mavdem.facts.lights import Light
from mavdem.facts.power import PowerLight
from mavdem.ingest.formats import read_stream
from mavdem.live import LiveStream
from mavdem.live.flight_lights import FlightLights
from mavdem.live.global_position import GlobalPosition
from mavdem.live.takeoff_place import Place, TakeoffPlace
from mavdem.report.live import vehicle_text
from sitl_scenarios.mishaps.specs import Restart
from sitl_scenarios.scenario import Scenario, StreamSpec, VehicleSpec
from sitl_scenarios.simulation import fly

HEIGHT = 6.0
"""Height of the flight, m."""


@fixture(scope="module")
def flown(tmp_path_factory, coarse_physics):
    """A flight whose autopilot restarts after 9 s."""
    stream = StreamSpec(autopilot="ardupilot", rate=25.0, instruments=True)
    mishap = Restart(kind="restart", start=9.0)
    vehicle = VehicleSpec(parameters={"SCHED_LOOP_RATE": 100.0})
    scenario = Scenario(
        duration=24.0, height=HEIGHT, seed=5, vehicle=vehicle, stream=stream, mishap=mishap
    )
    path = tmp_path_factory.mktemp("restarted") / "flight.tlog"
    write_log(path, scenario, fly(scenario))
    return path


@mark.slow
def test_height_distance_and_battery_outlast_a_reboot(flown):
    """The autopilot restarts in flight and its estimates begin anew.

    Height and distance then come from satellites and the barometer.
    """
    stream = LiveStream()
    first_status = None  # The first one in which the vehicle flies after the restart.
    for stamp, frame in read_stream(flown).stamped_frames():
        stream.feed(stamp / 1e6, frame)
        if first_status is None and stream.boot == 1 and stream.is_flying:
            first_status = replace(stream.status(), state=stream.vehicle_state())
    assert "by satellites and barometer" in vehicle_text(first_status)
    assert first_status.displacement_from_takeoff.distance < 5.0
    assert first_status.displacement_from_takeoff.height == approx(HEIGHT, abs=1.5)
    live_power = stream.status().overall_judgement.lights[Light.POWER]
    logged_power = mavdem.review(flown).lights[Light.POWER]
    assert live_power.figures["voltage"] == approx(logged_power.figures["voltage"], abs=0.05)


def test_the_place_of_the_take_off_is_kept_only_in_the_flight_that_began_there():
    """After a restart in flight, the distance is measured from the take-off before it.

    After a restart on the ground it is unknown.
    """
    place = TakeoffPlace()
    place.add_fix(GlobalPosition(47.0, 8.0, None, reception=0.0))
    place.add_pressure(1000.0)
    place.note_phase(is_flying=False, is_takeoff_seen=False)
    place.note_phase(is_flying=True, is_takeoff_seen=True)
    place.restart(was_flying=True)
    assert place.displacement is None
    place.add_fix(GlobalPosition(47.00009, 8.0, None, reception=0.0))
    place.add_pressure(998.8)
    # It takes some seconds to find out that the vehicle of a new boot is in the air.
    place.note_phase(is_flying=False, is_takeoff_seen=False)
    place.note_phase(is_flying=True, is_takeoff_seen=False)
    assert place.displacement == approx((10.0, 10.0), abs=0.2)
    place.restart(was_flying=False)
    place.add_fix(GlobalPosition(47.00009, 8.0, None, reception=0.0))
    place.add_pressure(998.8)
    assert place.displacement is None


def test_an_incomplete_place_is_no_distance():
    assert Place((47.0, 8.0)).displacement_from(Place((47.0, 8.0), 400.0)) is None
    assert Place(None, 400.0).displacement_from(Place((47.0, 8.0), 400.0)) is None


def test_the_light_of_a_later_boot_of_the_same_flight_replaces_one_that_is_no_worse():
    before = Fact(PowerLight.BATTERY_HELD, voltage=11.9)
    later = before.replace(voltage=11.2)
    former = FlightLights()
    former.add(Light.POWER, before)
    lights = FlightLights(former)
    assert lights.latest == {Light.POWER: before}
    lights.add(Light.POWER, later)
    assert lights.latest == {Light.POWER: later}
    lights.begin_flight()
    assert lights.latest == {} and lights.flight_number == former.flight_number + 1
