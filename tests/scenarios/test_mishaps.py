"""What goes wrong in a simulated flight stands in its truth, and shows in the messages as real autopilots send them."""

from functools import cached_property

import numpy as np
from pytest import approx, mark, raises

from mavdem.errors import Unreadable
from mavdem.ingest.mavlink.vehicles import assemble
from sitl_scenarios.damage import damage_history
from sitl_scenarios.files import SECTION_KINDS, load, names, scenario_from_table
from sitl_scenarios.mavlink.transmitter import recorded_stream
from sitl_scenarios.rotors import CIRCLES, rotor_count, rotor_frame
from sitl_scenarios.simulation import fly
from sitl_scenarios.truth import mishap_truth

pytestmark = mark.usefixtures("coarse_physics")
LOOP_RATE = {"ardupilot": "SCHED_LOOP_RATE", "px4": "IMU_GYRO_RATEMAX"}
BOOT = 2.0
START = 9.0
"""Seconds from arming at which it goes wrong."""


class Flight:
    """A short flight with a mishap: its motion and the messages that its autopilot sent."""

    def __init__(self, kind, autopilot="ardupilot", duration=15.0, **mishap):
        self.scenario = scenario_from_table(
            {
                "duration": duration,
                "height": 3.0,
                "vehicle": {"parameters": {LOOP_RATE[autopilot]: 100.0}},
                "stream": {"autopilot": autopilot, "rate": 25.0, "instruments": True},
                "mishap": {"kind": kind, **mishap},
            }
        )
        self.motion = fly(self.scenario)

    @cached_property
    def messages(self):
        """The columns of each message, by its name."""
        return assemble(recorded_stream(self.scenario, self.motion)).vehicles[0].messages

    def column(self, message, field, begin=-np.inf, end=np.inf):
        """Values of a field whose times are from ``begin`` to ``end``, s after arming."""
        columns = self.messages[message]
        time = columns["time"] - BOOT
        return columns[field][(time >= begin) & (time < end)]

    @property
    def texts(self):
        return " | ".join(map(str, self.messages["STATUSTEXT"]["text"]))


@mark.slow
def test_every_kind_has_a_scenario_with_its_truth():
    flown = {load(name).mishap.kind for name in names() if load(name).mishap is not None}
    kinds = {model.model_fields["kind"].annotation.__args__[0] for model in SECTION_KINDS["mishap"]}
    assert flown == kinds
    known = mishap_truth(load("motor_fade"))
    assert (known["mishap"], known["mishap_time"], known["mishap_motor"]) == ("motor_fade", 17.0, 3)
    assert mishap_truth(load("calm")) == {}


@mark.parametrize("frame", CIRCLES)
def test_rotors_of_a_frame_balance(frame):
    rotors = rotor_frame(frame, (0.2, 0.2))
    assert rotor_count(frame) == len(rotors.yaw)
    columns = np.array([rotors.roll, rotors.pitch, rotors.yaw])
    assert columns.sum(1) == approx(np.zeros(3), abs=1e-8)
    assert columns @ columns.T == approx(np.diag((columns**2).sum(1)), abs=1e-8)


def test_a_fading_motor_loses_its_thrust_step_by_step():
    scenario = scenario_from_table(
        {"mishap": {"kind": "motor_fade", "start": 10.0, "thrust": 0.25}}
    )
    times, conditions = zip(*damage_history(scenario), strict=True)
    assert (times[0], times[-1]) == approx((10.1, 30.0))
    assert conditions[-1].speed == approx((0.5, 1.0, 1.0, 1.0))


def test_a_frame_of_six_is_no_quadrotor_to_its_autopilot():
    with raises(ValueError, match="quadrotors only"):
        scenario_from_table({"vehicle": {"frame": "hexa_x", "mixer": "plus"}})


@mark.slow
@mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_stopped_motor_is_asked_for_all_and_the_vehicle_falls(autopilot):
    flight = Flight("motor_stop", autopilot, start=START, motor=2)
    outputs = flight.column("SERVO_OUTPUT_RAW", "servo2_raw", START + 0.3, START + 0.8)
    assert outputs.max() > 1950
    assert flight.motion.rotor_speeds[-1, 1] == approx(0.0, abs=1.0)
    imu = "RAW_IMU" if autopilot == "ardupilot" else "HIGHRES_IMU"
    assert (
        abs(flight.column(imu, "zacc", START)).max() > abs(flight.column(imu, "zacc", 6, 9)).max()
    )
    assert not flight.motion.armed[-1]


@mark.slow
def test_a_slipping_propeller_shakes_and_makes_its_motor_work_harder():
    flight = Flight("propeller_loose", start=START, motor=3, thrust=0.6)
    assert flight.column("VIBRATION", "vibration_z", START + 1, 15).mean() > 20
    before = flight.column("SERVO_OUTPUT_RAW", "servo3_raw", 6, START).max()
    assert flight.column("SERVO_OUTPUT_RAW", "servo3_raw", START, 15).max() > before + 50


@mark.slow
def test_a_height_that_runs_away_falls_while_the_barometer_rises():
    flight = Flight("height_runaway", start=START, seconds=3.0, duration=30.0)
    estimated = flight.column("LOCAL_POSITION_NED", "z", START, START + 3)
    pressure = flight.column("SCALED_PRESSURE", "press_abs", START, START + 3)
    assert estimated[-1] > estimated[0] and pressure[-1] < pressure[0] - 0.5
    assert flight.column("VIBRATION", "clipping_0")[-1] > 100
    assert "Vibration compensation ON" in flight.texts


@mark.slow
def test_a_biased_accelerometer_moves_the_height_and_reads_too_little():
    flight = Flight("vibration_rectification", start=6.0, bias=0.6)
    error = flight.motion.position[:, 2] - flight.motion.known_position[:, 2]
    assert error.min() == approx(-0.6 / 0.5**2, rel=0.1)
    hovering = (flight.motion.time > BOOT + 9) & (flight.motion.time < BOOT + 14)
    assert flight.motion.specific_force[hovering, 2].mean() == approx(-9.81 + 0.6, abs=0.8)
    assert flight.column("VIBRATION", "vibration_z", 9, 14).min() > 40


@mark.slow
def test_a_barometer_that_drifts_leaves_the_satellites():
    flight = Flight("barometer_drift", "px4", 20.0, start=6.0, metres=-5.0, seconds=6.0)
    assert flight.motion.position[:, 2].min() < -6
    height = flight.column("LOCAL_POSITION_NED", "z", 12, 14)
    assert height.mean() == approx(-3.0, abs=0.5)
    satellites = flight.column("GPS_RAW_INT", "alt")
    assert satellites.max() - satellites[0] > 6000
    # It lands late, and the record goes on at rest.
    assert (
        flight.motion.time[~flight.motion.armed].max()
        - flight.motion.time[flight.motion.armed].max()
    ) > 1.5


@mark.slow
def test_a_stuck_barometer_reads_one_value():
    flight = Flight("barometer_stuck", "px4", start=6.0, climb=4.0)
    assert np.ptp(flight.column("SCALED_PRESSURE", "press_abs", 6.1)) == 0
    assert flight.column("ESTIMATOR_STATUS", "pos_vert_ratio").max() > 1.0


@mark.slow
def test_lost_satellites_are_no_fix_and_a_landing():
    flight = Flight("gps_loss", start=START, failsafe=3.0)
    assert set(flight.column("GPS_RAW_INT", "fix_type", START + 1)) == {1}
    assert flight.column("HEARTBEAT", "custom_mode", START + 4.1)[0] == 9
    assert flight.column("HEARTBEAT", "system_status", START + 4.1)[0] == 5
    assert "EKF Failsafe" in flight.texts and not flight.motion.armed[-1]


@mark.slow
def test_a_glitch_jumps_and_is_rejected():
    flight = Flight("gps_glitch", start=START, seconds=3.0, metres=40.0)
    east = flight.column("GPS_RAW_INT", "lon", START + 0.6, START + 2.9).mean()
    moved = (east - flight.column("GPS_RAW_INT", "lon", 6, START).mean()) / 1e7
    assert moved * 111_195 * np.cos(np.radians(47.397742)) == approx(40, abs=1)
    assert flight.column("EKF_STATUS_REPORT", "flags", START, START + 3).max() & 32768
    assert np.ptp(flight.motion.position[:, 1]) < 1.0


@mark.slow
def test_a_heading_is_set_anew():
    flight = Flight("yaw_reset", start=START, degrees=30.0)
    yaw = flight.column("ATTITUDE", "yaw", START - 1, START + 1)
    assert np.degrees(abs(np.diff(yaw)).max()) == approx(30, abs=4)
    assert "yaw reset" in flight.texts


@mark.slow
def test_on_a_bench_nothing_moves():
    flight = Flight("bench_run", throttle=0.7)
    assert flight.motion.position[:, 2].min() == 0
    assert flight.column("SERVO_OUTPUT_RAW", "servo1_raw").max() > 1500
    assert set(flight.column("EXTENDED_SYS_STATE", "landed_state")) == {1, 2}
    assert abs(flight.column("ATTITUDE", "roll")).max() < 0.01
    assert flight.column("RC_CHANNELS", "chan3_raw").max() > 1600


@mark.slow
@mark.parametrize("kind", ["topple_at_take_off", "topple_at_landing"])
def test_a_vehicle_that_tips_over_lies_on_its_side(kind):
    flight = Flight(kind, bearing=-90.0)
    assert np.degrees(flight.column("ATTITUDE", "roll")[-1]) == approx(-95, abs=1)
    height = -flight.motion.position[:, 2].min()
    assert (height > 1) == (kind == "topple_at_landing")
    assert not flight.motion.armed[-1]


@mark.slow
def test_a_closed_throttle_shows_on_the_stick_before_the_fall():
    flight = Flight("throttle_cut", start=START)
    assert flight.column("RC_CHANNELS", "chan3_raw", START + 0.3).max() == 1000
    assert flight.column("RC_CHANNELS", "chan3_raw", 6, 8.8).min() > 1300
    assert flight.column("HEARTBEAT", "custom_mode", START)[0] == 0
    assert flight.motion.velocity[:, 2].max() > 5


@mark.slow
@mark.parametrize("cause", ["radio", "battery"])
def test_a_failsafe_disarms_in_the_air(cause):
    flight = Flight("failsafe_disarm", start=START, cause=cause)
    disarmed = flight.motion.time[~flight.motion.armed & (flight.motion.time > BOOT)][0]
    assert disarmed == approx(BOOT + START, abs=0.02)
    assert -flight.motion.position[flight.motion.time >= disarmed][0, 2] > 2
    said = {"radio": "Radio Failsafe - Disarming", "battery": "Battery 1 is critical"}
    assert said[cause] in flight.texts


@mark.slow
def test_a_dive_is_caught_without_a_knock():
    flight = Flight("dive", start=START, seconds=0.5)
    force = np.linalg.norm(flight.motion.specific_force, axis=1)
    diving = (flight.motion.time > BOOT + START + 0.2) & (flight.motion.time < BOOT + START + 0.5)
    assert force[diving].mean() < 4 and force.max() < 30
    assert flight.column("RC_CHANNELS", "chan3_raw", START, START + 0.5).min() == 1000


@mark.slow
def test_a_flip_rolls_once_around():
    scenario = scenario_from_table(
        load("flip").model_dump(mode="json")
        | {"duration": 45.0, "vehicle": {"parameters": {"SCHED_LOOP_RATE": 100.0}}}
    )
    motion = fly(scenario)
    rolled = np.trapezoid(motion.rates[:, 0], motion.time)
    assert np.degrees(rolled) == approx(360, abs=15)
    assert motion.position[:, 2].min() < -15 and motion.landed_state[-1] == 1


@mark.slow
def test_a_watchdog_restarts_the_clock_in_flight():
    flight = Flight("restart", start=START)
    assert set(flight.messages["ATTITUDE"]["boot"]) == {0, 1}
    assert "WDG" in flight.texts


@mark.slow
def test_a_second_link_repeats_every_frame():
    flight = Flight("second_link", delay=2.0)
    stream = recorded_stream(flight.scenario, flight.motion)
    alone = recorded_stream(flight.scenario.model_copy(update={"mishap": None}), flight.motion)
    assert len(stream.stamps) == 2 * len(alone.stamps)


@mark.slow
def test_a_second_vehicle_has_its_own_clock():
    flight = Flight("second_vehicle", boot=300.0, metres=40.0)
    stream = recorded_stream(flight.scenario, flight.motion)
    alone = recorded_stream(flight.scenario.model_copy(update={"mishap": None}), flight.motion)
    assert len(stream.stamps) == approx(2 * len(alone.stamps), rel=0.05)
    with raises(Unreadable, match="two vehicles that send as 1:1"):
        assemble(stream)


@mark.slow
def test_the_second_battery_is_empty_and_the_first_is_not():
    flight = Flight("empty_battery", "px4", cell=2.9)
    battery = flight.messages["BATTERY_STATUS"]
    first, second = (battery["voltages"][battery["id"] == number, 0] for number in (0, 1))
    assert first.min() > 10_500 and second.min() < 9_000
    assert flight.column("SYS_STATUS", "voltage_battery").min() > 10_500


@mark.slow
def test_a_brown_out_ends_the_record_in_the_air():
    flight = Flight("brown_out", start=START, seconds=3.0, voltage=4.1, duration=20.0)
    assert flight.motion.time[-1] == approx(BOOT + START + 3.0, abs=0.05)
    assert flight.motion.position[-1, 2] < -2
    assert flight.column("POWER_STATUS", "Vcc")[-1] < 4600
