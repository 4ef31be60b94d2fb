"""What is said of a flight is read back as it was."""

import io

import numpy as np
from made_up_motion import ROLL, made_up_motion
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, mark
from scipy.spatial.transform import Rotation

from mavdem.ingest import read_log
from mavdem.ingest.tlog import write_tlog
from sitl_scenarios.mavlink import transmitter as recorded_module
from sitl_scenarios.mavlink.transmitter import Transmitter, recorded_stream
from sitl_scenarios.scenario import Faults, Scenario, StreamSpec

AUTOPILOTS = ("px4", "ardupilot")
NO_FAULTS = Faults()


def written(scenario, motion):
    file = io.BytesIO()
    write_tlog(file, recorded_stream(scenario, motion))
    return file.getvalue()


def scenario(autopilot="px4", faults=NO_FAULTS, **stream):
    return Scenario(stream=StreamSpec(autopilot=autopilot, **stream), faults=faults)


def read(tmp_path, flown_scenario, motion):
    (tmp_path / "flight.tlog").write_bytes(written(flown_scenario, motion))
    return read_log(tmp_path / "flight.tlog")


@mark.slow
@mark.parametrize("autopilot", AUTOPILOTS)
def test_what_is_read_back_is_what_was_true(autopilot, tmp_path):
    """The messages of a simulated flight have its true motion, to their resolution."""
    motion = made_up_motion(autopilot=autopilot)
    log = read(tmp_path, scenario(autopilot, system=7), motion)
    assert (log.unread, log.bytes_skipped) == ((), 0)
    (vehicle,) = log.vehicles
    assert (vehicle.system, vehicle.component, vehicle.vehicle) == (7, 1, "QUADROTOR")
    assert vehicle.autopilot == {"px4": "PX4", "ardupilot": "ARDUPILOTMEGA"}[autopilot]
    assert [speaker.lost for speaker in log.components] == [0]
    sent = vehicle.messages

    def rows(message):
        return np.searchsorted(motion.time, sent[message]["time"] - 1e-6)

    def is_sent(message, names, known):
        columns = np.column_stack([sent[message][name] for name in names])
        assert_array_equal(columns, known[rows(message)].astype(np.float32))

    attitude = sent["ATTITUDE"]
    at = rows("ATTITUDE")
    angles = Rotation.from_quat(motion.attitude[at], scalar_first=True).as_euler("ZYX")
    read_back = np.column_stack([attitude[name] for name in ("yaw", "pitch", "roll")])
    assert_allclose(read_back, angles, rtol=0, atol=1e-7)
    assert attitude["roll"].max() == approx(ROLL, abs=1e-3)
    is_sent("ATTITUDE", ("rollspeed", "pitchspeed", "yawspeed"), motion.rates)
    is_sent("LOCAL_POSITION_NED", "xyz", motion.position)
    is_sent("LOCAL_POSITION_NED", ("vx", "vy", "vz"), motion.velocity)
    is_sent("SERVO_OUTPUT_RAW", [f"servo{n}_raw" for n in range(1, 5)], motion.outputs)
    state = sent["EXTENDED_SYS_STATE"]["landed_state"]
    assert state[np.flatnonzero(np.diff(state, prepend=0))].tolist() == [1, 3, 2, 4, 1]
    if autopilot == "px4":
        controls = np.where(motion.armed[:, None], (motion.outputs - 1000) / 1000, 0)
        for message, field, known in (
            ("HIL_ACTUATOR_CONTROLS", "controls", controls),
            ("ACTUATOR_OUTPUT_STATUS", "actuator", motion.outputs),
        ):
            expected = known[rows(message)].astype(np.float32)
            assert_array_equal(sent[message][field][:, :4], expected)


@mark.slow
def test_a_place_is_north_and_east_of_where_it_began_and_as_high(tmp_path):
    """Latitude and longitude, 1e-7 °, follow the position north and east, m."""
    motion = made_up_motion()
    flown_scenario = scenario(rates={"GLOBAL_POSITION_INT": 5.0})
    positions = read(tmp_path, flown_scenario, motion).vehicles[0].messages["GLOBAL_POSITION_INT"]
    rows = np.searchsorted(motion.time, positions["time"] - 1e-3)
    north, east = motion.known_position[rows, :2].T
    cosine_of_latitude = np.cos(np.radians(positions["lat"][0] / 1e7))
    # Ten millionths of a degree in a metre.
    assert np.polyfit(north, positions["lat"], 1)[0] == approx(89.9, rel=0.01)
    assert np.polyfit(east, positions["lon"], 1)[0] == approx(89.9 / cosine_of_latitude, rel=0.01)
    up = -1000 * motion.known_position[rows, 2]
    assert_allclose(positions["alt"], 488_000 + up, atol=0.5001)
    assert_allclose(positions["hdg"], 100 * np.degrees(0.3), atol=0.5001)


@mark.in_full
def test_the_same_seed_is_the_same_file_however_it_is_cut(monkeypatch):
    """The faults of the link are random, but depend neither on the size of the blocks nor on anything but the seed."""
    faults = Faults(
        loss=0.1,
        delay=0.05,
        jitter=0.03,
        reordered=0.2,
        reboot=6.0,
        outage=9.0,
        outage_seconds=2.0,
        clock_jump=12.0,
    )
    motion = made_up_motion()
    flown_scenario = scenario(faults=faults)
    file_content = written(flown_scenario, motion)
    monkeypatch.setattr(recorded_module, "BLOCK_CYCLES", 37)
    assert written(flown_scenario, motion) == file_content
    assert written(flown_scenario.model_copy(update={"seed": 1}), motion) != file_content


@mark.slow
def test_each_seed_is_a_flight_of_its_own_day():
    motion = made_up_motion()
    flights = (scenario().model_copy(update={"seed": seed}) for seed in (0, 1, 2**32 - 1))
    days = [recorded_stream(one, motion).stamps[0] // 86_400_000_000 for one in flights]
    assert days == [20454, 20455, 20454 + 295]


@mark.slow
def test_a_reboot_in_the_air_is_a_new_boot(tmp_path):
    log = read(tmp_path, scenario(faults=Faults(reboot=8.0)), made_up_motion())
    (vehicle,) = log.vehicles
    boot, time = (vehicle.messages["ATTITUDE"][name] for name in ("boot", "time"))
    assert set(boot) == {0, 1}
    assert (time[boot == 0][-1], time[boot == 1][0]) == approx((10.0, 1.0), abs=0.02)
    assert len(vehicle.messages["PARAM_VALUE"]["time"]) == 2 * len(vehicle.parameters)
    beat = vehicle.messages["HEARTBEAT"]
    assert (
        beat["system_status"][beat["boot"] == 1][0] == 4
        and beat["base_mode"][beat["boot"] == 1][0] & 128
    )


def test_after_a_reboot_only_heartbeats_come_until_messages_are_asked_for_again(
    tmp_path,
):
    """A vehicle that sends on request only forgets the requests when it restarts at 8 s."""
    log = read(
        tmp_path, scenario("ardupilot", only_when_asked=True), made_up_motion(autopilot="ardupilot")
    )
    assert log.components[0].messages.keys() == {"HEARTBEAT", "STATUSTEXT"}
    motion = made_up_motion(autopilot="ardupilot")
    sending = Transmitter(scenario("ardupilot", Faults(reboot=8.0), only_when_asked=True))
    sending.schedule.set_interval("ATTITUDE", 0.01, 0.0)
    sending.send(motion[:1])
    frame_times, kinds = np.array([(time, frame[7]) for time, frame in sending.send(motion[1:])]).T
    sending.schedule.set_interval("ATTITUDE", 0.01, sending.clock)
    assert np.sum(kinds == 0) > 15 and frame_times[kinds == 30].max(initial=0.0) < 10.001


@mark.slow
def test_an_outage_and_a_jump_of_the_clock_are_as_long_as_they_are_asked_to_be(tmp_path):
    faults = Faults(outage=3.0, outage_seconds=2.5, clock_jump=9.0, clock_jump_seconds=100.0)
    (vehicle,) = read(tmp_path, scenario(faults=faults), made_up_motion()).vehicles
    attitude = vehicle.messages["ATTITUDE"]
    gaps = np.diff(attitude["time"])
    assert set(attitude["boot"]) == {0}
    assert_allclose(gaps[gaps > 0.02], [2.5, 100.0], atol=0.02)
