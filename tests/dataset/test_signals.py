"""Which message means what: attitude, motors, their order and scale, armed and airborne."""

import pickle
from dataclasses import replace

import numpy as np
from hover import (
    ARMED,
    MAV_AUTOPILOTS,
    MAV_TYPES,
    Hover,
    changed,
    columns,
    only,
    px4_rotors,
    with_demand,
    with_pulses,
)
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx, mark
from refusals import refused
from scipy.spatial.transform import Rotation

from mavdem.dataset import attitude, motor_outputs
from mavdem.dataset.flight_states import min_airborne_collective
from mavdem.dataset.signals import Signals
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.errors import NotLearnable
from mavdem.facts.learnability import NotLearnableReason, UnusableOutputs
from mavdem.ingest.motor_geometry import motor_geometry
from mavdem.ingest.motors import ChannelSource, PositionSource
from mavdem.ingest.output_scale import output_scale

HOVER = Hover()


def with_quaternion(rate):
    time = HOVER.stamps(rate)
    roll = HOVER.roll(time)
    pitch = 0.2 * np.sin(time)
    yaw = 0.3 * time
    q = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll])).as_quat(scalar_first=True)
    turned = {f"q{n}": column for n, column in enumerate(q.T, 1)}
    rates = {"rollspeed": HOVER.roll_rate(time), "pitchspeed": 0.2, "yawspeed": 0.3}
    sent = columns(time, **turned, **rates)
    return changed(HOVER.telemetry(10.0), "ATTITUDE_QUATERNION", **sent)


@mark.slow
def test_a_faster_quaternion_gives_the_euler_angles_it_was_made_of():
    telemetry = with_quaternion(100.0)
    roll = attitude.attitude_of_axis(telemetry, "roll")
    pitch = attitude.attitude_of_axis(telemetry, "pitch")
    assert roll.message == pitch.message == "ATTITUDE_QUATERNION"
    assert_allclose(roll.angle, HOVER.roll(roll.time), atol=1e-12)
    assert_allclose(roll.rate, HOVER.roll_rate(roll.time), atol=1e-12)
    assert_allclose(pitch.angle, 0.2 * np.sin(pitch.time), atol=1e-12)


@mark.parametrize("per_rad", [1.0, np.degrees(1.0)])
def test_faster_rates_of_the_controller_give_the_angle_between_two_attitudes(per_rad):
    """ArduPilot's log message RATE comes at 100 Hz, and the attitude at 2.5 Hz.

    The rates are integrated between the angles.
    """
    time = HOVER.stamps(100.0)
    achieved = per_rad * HOVER.roll_rate(time)
    axis = np.ones(len(time))
    tuning = columns(time, axis=axis, achieved=achieved, desired=0.0)
    stream = changed(HOVER.telemetry(2.5), "PID_TUNING", **tuning)
    assert attitude.attitude_of_axis(stream, "roll").message == "ATTITUDE", (
        "it has no stamps of its own"
    )
    telemetry = replace(stream, source_names={"PID_TUNING": "RATE"})
    roll = attitude.attitude_of_axis(telemetry, "roll")
    assert roll.message == "PID_TUNING" and len(roll.time) > 0.95 * len(time)
    assert_allclose(roll.angle, HOVER.roll(roll.time), atol=2e-4)
    assert_allclose(roll.rate, HOVER.roll_rate(roll.time), atol=1e-12)
    assert attitude.attitude_of_axis(telemetry, "pitch").message == "ATTITUDE"
    without = only(telemetry, lambda time: (time < 10.0) | (time > 15.0), "ATTITUDE")
    steps = np.diff(attitude.attitude_of_axis(without, "roll").time)
    assert steps.max() == approx(5.0, abs=0.9), "an outage of the angle is one"
    first_half = {name: values[: len(time) // 2] for name, values in tuning.items()}
    interrupted = changed(telemetry, "PID_TUNING", **first_half)
    assert attitude.attitude_of_axis(interrupted, "roll").message == "ATTITUDE", (
        "the rest has attitude too"
    )


def test_slope_is_the_derivative_of_the_angle_in_a_banked_turn():
    """Body rates are computed from known Euler angles. The Euler rates must be their derivatives again."""
    time = np.arange(0, 10, 1e-3)
    roll = 0.4 * np.sin(time)
    pitch = 0.5 + 0.1 * np.cos(2 * time)
    yaw_rate = 0.8
    roll_rate = 0.4 * np.cos(time)
    pitch_rate = -0.2 * np.sin(2 * time)
    telemetry = changed(
        HOVER.telemetry(),
        "ATTITUDE",
        **columns(
            time,
            roll=roll,
            pitch=pitch,
            rollspeed=roll_rate - yaw_rate * np.sin(pitch),
            pitchspeed=pitch_rate * np.cos(roll) + yaw_rate * np.cos(pitch) * np.sin(roll),
            yaw=np.remainder(yaw_rate * time + np.pi, 2 * np.pi) - np.pi,
            yawspeed=-pitch_rate * np.sin(roll) + yaw_rate * np.cos(pitch) * np.cos(roll),
        ),
    )
    heading = attitude.attitude_of_axis(telemetry, "yaw")
    assert_allclose(heading.angle, yaw_rate * time, atol=1e-12)
    assert_allclose(heading.rate, telemetry.messages["ATTITUDE"]["yawspeed"])
    for axis, derivative in (("roll", roll_rate), ("pitch", pitch_rate), ("yaw", yaw_rate)):
        assert_allclose(
            attitude.attitude_of_axis(telemetry, axis).euler_rate, derivative, atol=1e-12
        )


def test_disordered_repeated_and_broken_samples_leave_clean_columns():
    """The messages of a log are shuffled, 500 of them are there twice, and one angle is NaN."""
    telemetry = HOVER.telemetry()
    table = telemetry.messages["ATTITUDE"]
    order = default_rng(0).permutation(len(table["time"]))
    order = np.concatenate([order, order[:500]])
    shuffled = {name: column[order].copy() for name, column in table.items()}
    lost = shuffled["time"][7]
    shuffled["roll"][shuffled["time"] == lost] = np.nan
    shuffled["roll"][-1] += 1.0  # Another value at the same stamp.
    cleaned = attitude.attitude_of_axis(changed(telemetry, "ATTITUDE", **shuffled), "roll")
    assert cleaned.unused_count == 1 + np.count_nonzero(np.isnan(shuffled["roll"]))
    expected_attitude = attitude.attitude_of_axis(telemetry, "roll")
    assert_array_equal(cleaned.time, expected_attitude.time[expected_attitude.time != lost])
    assert_array_equal(cleaned.angle, expected_attitude.angle[expected_attitude.time != lost])


def test_ardupilot_motors_by_servo_function_and_frame():
    """Parameters assign the motors of a plus frame to outputs 2, 3, 4 and 1, and output 5 to something else."""
    parameters = {"FRAME_CLASS": 1, "FRAME_TYPE": 0, "SERVO1_FUNCTION": 36, "SERVO2_FUNCTION": 33}
    parameters |= {"SERVO3_FUNCTION": 34, "SERVO4_FUNCTION": 35, "SERVO5_FUNCTION": 70}
    motors = motor_outputs.motor_outputs_or_reason(HOVER.telemetry(parameters=parameters))
    assert motors.geometry.channels == (2, 3, 4, 1)
    assert motors.geometry.names == (
        "motor 1 (right)",
        "motor 2 (left)",
        "motor 3 (front)",
        "motor 4 (rear)",
    )
    assert not motors.geometry.channels_assumed and not motors.geometry.positions_assumed
    assert_allclose(motors.geometry.mixer_row("roll"), [-0.5, 0.5, 0, 0], atol=1e-12)
    assert_allclose(motors.geometry.mixer_row("pitch"), [0, 0, 0.5, -0.5], atol=1e-12)
    expected = HOVER.motors(motors.time)[:, [1, 2, 3, 0]]
    assert_array_equal(motors.outputs, expected)


def test_yaw_is_by_the_direction_of_the_propellers():
    """A propeller that turns counterclockwise turns the vehicle clockwise: the nose to the right."""
    functions = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 5)}
    for frame_type, signs in ((1, [1, 1, -1, -1]), (3, [-1, -1, 1, 1]), (14, [1, -1, 1, -1])):
        frame = functions | {"FRAME_CLASS": 1.0, "FRAME_TYPE": float(frame_type)}
        geometry = motor_geometry(
            "QUADROTOR", "ARDUPILOTMEGA", frame, moving_channels=range(1, 5), bank_size=8
        )
        assert_array_equal(4 * geometry.mixer_row("yaw"), signs)
    rotors = {f"PWM_MAIN_FUNC{n}": 100.0 + n for n in range(1, 5)}
    rotors |= px4_rotors((1, 1, 0.05), (-1, -1, 0.04), (1, -1, 0.0), (-1, 1, -0.04))
    geometry = motor_geometry("QUADROTOR", "PX4", rotors, moving_channels=range(1, 5), bank_size=16)
    assert geometry.mixer_row("yaw") is None, "it is not known how the third one turns"


def test_without_parameters_the_moving_channels_are_assumed_and_said():
    for incomplete in ({}, {"SERVO7_FUNCTION": 35.0, "SERVO2_FUNCTION": 34.0}):
        motors = motor_outputs.motor_outputs_or_reason(
            HOVER.telemetry(parameters=incomplete)
        ).geometry
        assert motors.channels == (1, 2, 3, 4)
        assert motors.channels_assumed and motors.positions_assumed
    assert dict(motors.basis.figures) == {
        "channels_by": ChannelSource.MOVING_CHANNELS,
        "places_by": PositionSource.X_QUAD,
        "count": 4,
    }


def test_a_tricopter_s_tilt_servo_is_no_motor_and_an_unknown_frame_has_no_places():
    parameters = {"FRAME_CLASS": 7.0} | {f"SERVO{n}_FUNCTION": 32.0 + n for n in (1, 2, 4, 7)}
    geometry = motor_geometry(
        "TRICOPTER", "ARDUPILOTMEGA", parameters, moving_channels=[1, 2, 4, 7], bank_size=8
    )
    assert geometry.motors == (1, 2, 4) and not geometry.positions_assumed
    assert geometry.positions[1] == approx((0.5, -(3**0.5) / 2)), "of 120° from arm to arm"
    # A hexarotor of unknown frame has no places.
    motors = motor_geometry(
        "HEXAROTOR", "ARDUPILOTMEGA", {}, moving_channels=range(1, 9), bank_size=8
    )
    assert motors.channels == (1, 2, 3, 4, 5, 6)
    assert motors.names[0] == "motor 1" and motors.mixer_row("roll") is None


@mark.parametrize(
    "frame_class, frame_type, count",
    [(1, t, 4) for t in (0, 1, 2, 3, 6, 12, 13, 14, 16, 17, 18)]
    + [(2, t, 6) for t in (0, 1, 13, 14)]
    + [(3, t, 8) for t in (0, 1, 13, 14)]
    + [(4, t, 8) for t in (0, 1, 2, 3, 12, 14, 18)]
    + [(5, t, 6) for t in (0, 1, 10, 11)],
)
def test_every_frame_balances(frame_class, frame_type, count):
    """Equal thrust on every motor turns nothing, and both axes can be turned."""
    functions = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, count + 1)}
    frame = functions | {"FRAME_CLASS": frame_class, "FRAME_TYPE": frame_type}
    geometry = motor_geometry(
        "QUADROTOR", "ARDUPILOTMEGA", frame, moving_channels=range(1, count + 1), bank_size=8
    )
    assert len(geometry.motors) == count and not geometry.positions_assumed
    yawless = frame_class == 1 and frame_type in (16, 17)
    if yawless:
        assert geometry.mixer_row("yaw") is None
    else:
        assert geometry.mixer_row("yaw") is not None
    for axis in ("roll", "pitch", *([] if yawless else ["yaw"])):
        assert geometry.mixer_row(axis).sum() == approx(0, abs=1e-6)
        assert abs(geometry.mixer_row(axis)).sum() == approx(1)
        # Turning about one axis turns nothing about the others.
        others = [geometry.mixer_row(other) for other in ("roll", "pitch") if other != axis]
        assert_allclose(np.array(others) @ geometry.mixer_row(axis), 0, atol=1e-6)


def test_rounding_is_measured_before_a_bank_is_moved_to_the_stamps_of_another():
    """Six motors over two banks, whole µs, the second bank's messages 3 ms after the first's."""
    parameters = {f"SERVO{4 + n}_FUNCTION": 32.0 + n for n in range(1, 7)} | {
        "FRAME_CLASS": 2,
        "FRAME_TYPE": 1,
    }
    telemetry = HOVER.telemetry(vehicle="HEXAROTOR", parameters=parameters)
    time = HOVER.stamps(100.0)
    outputs = np.round(1500 + 100 * np.sin(np.outer(time, 1 + 0.1 * np.arange(16))))
    port = np.resize([0.0, 1.0], 2 * len(time))
    banks = enumerate(outputs.reshape(-1, 8).T, 1)  # One row for each message.
    both = {f"servo{n}_raw": column for n, column in banks}
    both |= {"time": np.repeat(time, 2) + 0.003 * port, "port": port}
    motors = motor_outputs.motor_outputs_or_reason(
        changed(telemetry, "SERVO_OUTPUT_RAW", **both, boot=0)
    )
    assert motors.geometry.channels == (5, 6, 7, 8, 9, 10)
    assert np.any(motors.outputs % 1), "the second bank falls between the stamps"
    assert motors.scale.step == 1.0
    apart = motor_outputs.motor_outputs_or_reason(
        changed(telemetry, "SERVO_OUTPUT_RAW", **both, boot=port.astype(int))
    )
    assert apart.code is UnusableOutputs.OUTPUTS_NOT_FINITE


def test_a_message_without_motors_that_move_leaves_the_next():
    """The more frequent message stands still, and the one with the motors has a channel that never has a number."""
    time = HOVER.stamps(50.0)
    actuator = np.full((len(time), 32), np.nan)
    actuator[:, :4] = HOVER.motors(time)
    telemetry = changed(
        HOVER.telemetry(), "ACTUATOR_OUTPUT_STATUS", **columns(time, actuator=actuator)
    )
    motors = motor_outputs.motor_outputs_or_reason(
        with_pulses(telemetry, np.full((8, len(HOVER.stamps(100.0))), 1000.0))
    )
    assert motors.message == "ACTUATOR_OUTPUT_STATUS"
    assert_array_equal(motors.outputs, HOVER.motors(time))


def test_the_range_of_pulse_widths_is_the_throttle_s_where_the_autopilot_says_so():
    throttle = {"RCMAP_THROTTLE": 3.0, "RC3_MIN": 1150.0, "RC3_MAX": 1900.0}
    idle = output_scale(np.array([[1220.0], [1500.0]]), throttle).fraction(np.array([1220.0]))
    assert idle[0] < min_airborne_collective(throttle), (
        "armed on the ground, 70 µs above the range's lower end"
    )


def test_armed_outvotes_strays_and_foreign_heartbeats():
    telemetry = HOVER.telemetry()
    table = {name: column.copy() for name, column in telemetry.messages["HEARTBEAT"].items()}
    table["base_mode"][30] = 0
    table["base_mode"][2] = ARMED
    table["type"][33:36] = MAV_TYPES["GCS"]
    table["autopilot"][36:39] = MAV_AUTOPILOTS["INVALID"]
    table["base_mode"][33:39] = 0
    state = Signals(changed(telemetry, "HEARTBEAT", **table)).armed
    expected = (state.time >= 5) & (state.time < HOVER.landed + 1)
    assert_array_equal(state.values > 0, expected)
    assert len(state.time) == len(table["time"]) - 6


def test_the_demand_on_an_axis_is_one_input_that_turns_it():
    demand = motor_outputs.axis_demand(with_demand(HOVER.telemetry()), "roll")
    assert_allclose(demand.outputs[:, 0], 0.1 * np.sin(demand.time))
    assert demand.geometry.names == ("roll demand",)
    assert_array_equal(demand.geometry.mixer_row("roll"), [1.0])
    assert (demand.scale.low, demand.scale.high) == (-1.0, 1.0)
    # A demand that never moves, one of another group, and none at all are no input.
    assert motor_outputs.axis_demand(with_demand(HOVER.telemetry()), "pitch") is None
    assert motor_outputs.axis_demand(with_demand(HOVER.telemetry(), group=1.0), "roll") is None
    assert motor_outputs.axis_demand(HOVER.telemetry(), "roll") is None


def test_the_collective_is_the_motors_mean_or_else_the_thrust_asked_for():
    telemetry = with_demand(HOVER.telemetry())
    motors = motor_outputs.motor_outputs_or_reason(telemetry)
    expected = motors.scale.fraction(motors.outputs).mean(axis=1)
    assert_array_equal(Signals(telemetry).collective.values, expected)
    without = replace(
        telemetry, messages={k: v for k, v in telemetry.messages.items() if k != "SERVO_OUTPUT_RAW"}
    )
    assert_array_equal(np.unique(Signals(without).collective.values), [0.5])


@mark.parametrize(
    "stay, close, depth, highest, stops",
    [
        (11, 0, 0.01, 0.8, True),
        (9, 0, 0.01, 0.8, False),
        (20, 0, 0.01, 0.55, True),
        (20, 0, 0.01, 0.45, False),
        (90, 50, 0.01, 0.8, True),
        (70, 50, 0.01, 0.8, False),
        (5, 6, 0.0035, 0.8, False),
        (500, 300, 0.01, 0.8, False),
    ],
)
def test_a_stop_is_where_motors_stay_as_nowhere_below(stay, close, depth, highest, stops):
    """The upper limit of a motor is the highest output if it has that output unusually often.

    Of 1000 samples some stay at the highest output, and some close below it.
    """
    shares = np.repeat([highest, highest - depth, 0.4], [stay, close, 1000 - stay - close])
    assert motor_outputs._observed_upper_limit(shares[:, None]) == (highest if stops else 1.0)


def test_a_position_is_metres_north_east_down_of_the_first_even_over_the_date_line():
    # Before the first fix, and damaged.
    degrees = np.array([[0.0, 0.0], [60.0, 179.9999], [60.0001, -179.9999], [95.0, 0.0]])
    fields = dict(zip(("lat", "lon"), np.round(1e7 * degrees.T), strict=True), relative_alt=5000.0)
    made = HOVER.telemetry(without=("LOCAL_POSITION_NED",))
    made = changed(made, "GLOBAL_POSITION_INT", **columns(np.arange(4.0), **fields))
    assert_allclose(Signals(made).position.values, [[0, 0, -5], [11.119, 11.119, -5]], atol=1e-3)


def measured_voltage(time, millivolts):
    measured = columns(time, voltage_battery=millivolts)
    batteries = Signals(changed(HOVER.telemetry(), "SYS_STATUS", **measured)).batteries
    return batteries[0].voltage if batteries else None


def test_without_a_battery_monitor_there_is_none():
    time = HOVER.stamps(1.0)
    for nothing in (0, 65535):
        voltages = np.full(len(time), nothing, dtype=np.uint16)
        assert measured_voltage(time, voltages.copy()) is None
        # Damaged bytes give single values.
        voltages[[3, 30, 31, 40]] = 12_800
        assert measured_voltage(time, voltages) is None
    assert measured_voltage(time[:4], np.full(4, 12_800)) is None
    falling = np.linspace(16000, 14000, len(time))
    falling[[0, 30, 31]] = 65_000, 33_000, 6_000  # Damaged bytes give single values.
    damaged = measured_voltage(time, falling).values
    assert len(damaged) == len(time) - 3 and 14 <= damaged.min() <= damaged.max() <= 16


@mark.parametrize(
    "signal, message, field, value",
    [
        ("height", "LOCAL_POSITION_NED", "z", -12.0),
        ("height", "GLOBAL_POSITION_INT", "relative_alt", 12000.0),
        ("height", "ALTITUDE", "altitude_relative", 12.0),
        ("climb_rate", "LOCAL_POSITION_NED", "vz", -12.0),
        ("climb_rate", "GLOBAL_POSITION_INT", "vz", -1200.0),
        ("climb_rate", "VFR_HUD", "climb", 12.0),
    ],
)
def test_height_and_climb_are_in_metres_upwards(signal, message, field, value):
    """Each message has a height of 12 m, or a climb rate of 12 m/s, in its own unit and sign."""
    hover_telemetry = HOVER.telemetry(10.0, without=("LOCAL_POSITION_NED",))
    telemetry = changed(
        hover_telemetry, message, **columns(np.arange(5.0), **{field: np.full(5, value)})
    )
    assert getattr(Signals(telemetry), signal).values == approx(12.0)


def test_the_wind_is_where_the_air_moves_to():
    blown = columns(np.zeros(1), direction=np.full(1, 60.0), speed=np.full(1, 2.0))
    wind = Signals(changed(HOVER.telemetry(), "WIND", **blown)).autopilot_wind
    assert wind.values[0] == approx([-1.0, -np.sqrt(3.0)])
    # ArduCopter sends zeros without an estimate.
    zeros = Signals(changed(HOVER.telemetry(), "WIND", **blown | {"speed": np.zeros(1)}))
    assert zeros.autopilot_wind is None and zeros.zero_wind_message == "WIND"


def test_what_is_sought_once_is_known_of_its_axis_and_so_is_why_nothing_was_found():
    sought = []

    @cached_per_vehicle("axis")
    def find(signals, boot):
        sought.append((signals.axis, boot))
        if boot:
            raise NotLearnable(NotLearnableReason.NO_ATTITUDE)
        return signals.axis

    roll = Signals(HOVER.telemetry())
    yaw = roll.for_axis("yaw")
    assert [find(each, 0) for each in (roll, yaw, roll)] == ["roll", "yaw", "roll"]
    assert {refused(find, yaw, 1).code for _ in range(2)} == {NotLearnableReason.NO_ATTITUDE}
    assert sought == [("roll", 0), ("yaw", 0), ("yaw", 1)]
    assert len(pickle.loads(pickle.dumps(roll)).cache) == 3
