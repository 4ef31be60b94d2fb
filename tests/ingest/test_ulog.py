"""PX4's logs: values as pyulog reads them, in MAVLink's words; and what is whole of a file that is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pyulog import ULog
from ulog_files import (
    OFF,
    REAL,
    TIMES,
    data,
    flight,
    log,
    log_of,
    parameter,
    roll,
    shared,
    subscription,
    vehicle_of,
)

import mavdem
from mavdem.alignment import drive
from mavdem.alignment.signals import Signals, setpoints
from mavdem.ingest import read_log


def same(ours: NDArray[np.generic], theirs: NDArray[np.generic]) -> bool:
    return len(ours) == len(theirs) and bool((np.asarray(ours, np.float64) == np.asarray(theirs, np.float64)).all())


@pytest.mark.parametrize("name", REAL)
def test_values_are_those_pyulog_reads(name: str) -> None:
    path = shared(name)
    (vehicle,) = read_log(path).vehicles
    plain = ULog(str(path))
    attitude, local = (plain.get_dataset(topic).data for topic in ("vehicle_attitude", "vehicle_local_position"))
    ours = vehicle.messages["ATTITUDE_QUATERNION"]
    for field, theirs in zip(("q1", "q2", "q3", "q4"), (f"q[{n}]" for n in range(4)), strict=True):
        assert same(ours[field], attitude[theirs])
    for field in ("rollspeed", "pitchspeed", "yawspeed"):
        assert same(ours[field], attitude[field])
    assert same(np.rint(ours["time"] * 1e6), attitude["timestamp"])
    for field in ("x", "y", "z", "vx", "vy", "vz"):
        assert same(vehicle.messages["LOCAL_POSITION_NED"][field], local[field][local["v_z_valid"] == 1])
    control = plain.get_dataset("actuator_controls_0").data
    for n in range(8):
        assert same(vehicle.messages["ACTUATOR_CONTROL_TARGET"]["controls"][:, n], control[f"control[{n}]"])
    outputs = vehicle.messages["SERVO_OUTPUT_RAW"]
    for topic in (topic for topic in plain.data_list if topic.name == "actuator_outputs"):
        here = outputs["port"] == topic.multi_id
        assert same(np.rint(outputs["time"][here] * 1e6), topic.data["timestamp"])
        for n in range(16):
            assert same(outputs[f"servo{n + 1}_raw"][here], topic.data[f"output[{n}]"])
    armed = plain.get_dataset("vehicle_status").data["arming_state"] == 2
    assert same(vehicle.messages["HEARTBEAT"]["base_mode"] >= 128, armed)
    expected = {name: float(value) for name, value in plain.initial_parameters.items()}
    expected |= {name: float(value) for _, name, value in plain.changed_parameters}
    assert vehicle.parameters == expected
    assert (vehicle.vehicle, vehicle.autopilot, vehicle.system) == ("QUADROTOR", "PX4", 1)


def test_a_log_can_be_learnt_from(tmp_path: Path) -> None:
    times = 20 + 0.01 * np.arange(2500)
    pieces = flight(times)
    pieces.insert(0, data("vehicle_land_detected", 10.0, True))
    pieces.insert(1, data("vehicle_land_detected", 20.0, False))
    path = tmp_path / "flight.ulg"
    path.write_bytes(log(*pieces))
    learnt = mavdem.read_flight(path)
    angle, rate = roll(learnt.time)
    assert learnt.dt == pytest.approx(0.01) and len(learnt) > 1900
    assert np.allclose(learnt.outputs, np.column_stack([angle, rate]), atol=1e-6)
    assert np.allclose(learnt.inputs, 0.5 + np.outer(angle, [-1, 1, 1, -1]), atol=1e-6)


def test_messages_are_on_the_boot_clock(tmp_path: Path) -> None:
    found = log_of(log(*flight(TIMES)), tmp_path)
    (vehicle,) = found.vehicles
    for name in ("ATTITUDE_QUATERNION", "HIL_ACTUATOR_CONTROLS", "ACTUATOR_CONTROL_TARGET"):
        assert (
            np.allclose(vehicle.messages[name]["time"], TIMES, atol=1e-6) and vehicle.messages[name]["boot"].sum() == 0
        )
    assert vehicle.repairs == () and found.bytes_skipped == 0
    assert found.components[0].messages["ATTITUDE_QUATERNION"] == len(TIMES)
    assert np.array_equal(vehicle.messages["HEARTBEAT"]["base_mode"], [129] * 6)


def test_attitude_is_moved_to_the_stamps_of_the_rates(tmp_path: Path) -> None:
    """Attitude 20 times a second and rates 50, as PX4 logs them by default; one stretch without attitude."""
    pieces = []
    for time in np.arange(0, 4, 0.05):
        if not 2 < time < 2.5:
            sign = -1 if round(time / 0.05) % 2 else 1  # the same attitude
            pieces.append(
                data("vehicle_attitude", 20 + time, sign * np.cos(time / 4), sign * np.sin(time / 4), 0, 0, 0)
            )
    pieces += [data("vehicle_angular_velocity", 20 + time, 0.5, 0.0, 0.1) for time in np.arange(0.5, 3.5, 0.02)]
    vehicle = vehicle_of(log(*pieces), tmp_path)
    messages = vehicle.messages["ATTITUDE_QUATERNION"]
    time = messages["time"] - 20
    assert vehicle.repairs[0].startswith("Attitude was logged at 20 Hz and body rates at 50 Hz: ")
    assert np.allclose(np.diff(time)[np.diff(time) < 0.1], 0.02) and not ((time > 2.001) & (time < 2.499)).any()
    angle = 2 * np.arctan2(messages["q2"] * np.sign(messages["q1"]), np.abs(messages["q1"]))
    assert np.allclose(angle, time / 2, atol=1e-4) and np.allclose(messages["yawspeed"], 0.1)


def test_an_attitude_too_slow_keeps_its_stamps(tmp_path: Path) -> None:
    pieces = [data("vehicle_attitude", 20 + 0.5 * row, 1, 0, 0, 0, 0) for row in range(20)]
    pieces += [data("vehicle_angular_velocity", 20 + 0.01 * row, 0.01 * row, 0, 0) for row in range(1000)]
    messages = vehicle_of(log(*pieces), tmp_path).messages["ATTITUDE_QUATERNION"]
    assert np.allclose(messages["time"], 20 + 0.5 * np.arange(20))
    assert np.allclose(messages["rollspeed"], 0.5 * np.arange(20), atol=1e-6)


def test_motors_are_put_on_their_channels(tmp_path: Path) -> None:
    swapped = b"".join(parameter(f"PWM_MAIN_FUNC{n}", motor) for n, motor in ((1, 103), (2, 101), (5, 104), (6, 102)))
    pieces = [data("actuator_motors", 20 + 0.01 * row, 0.1, 0.2, 0.3, 0.4 + row / 1e3, *OFF) for row in range(50)]
    vehicle = vehicle_of(log(*pieces, parameters=swapped), tmp_path)
    controls = vehicle.messages["HIL_ACTUATOR_CONTROLS"]["controls"]
    assert np.allclose(controls[0], [0.3, 0.1, 0, 0, 0.4, 0.2] + [0] * 10)


def test_motors_without_parameters_count_as_channels(tmp_path: Path) -> None:
    pieces = flight(TIMES)
    vehicle = vehicle_of(log(*pieces), tmp_path)
    motors = drive.motors(vehicle)
    assert motors is not None and motors.layout.channels == (1, 2, 3, 4) and motors.scale.name == "normalised"
    assert np.allclose(motors.outputs[:, 0], 0.5 - roll(TIMES)[0])


def test_instances_of_outputs_are_ports(tmp_path: Path) -> None:
    def outputs(row: int, instance: int) -> bytes:
        values = [1000 * (instance + 1) + row + 0.5, *[7.0] * 15]
        return data("actuator_outputs", 20 + 0.01 * row, 1, *values, instance=instance)

    pieces = [subscription("actuator_outputs", 1), *(outputs(row, port) for row in range(10) for port in (0, 1))]
    sent = vehicle_of(log(*pieces), tmp_path).messages["SERVO_OUTPUT_RAW"]
    for port in (0, 1):
        assert np.array_equal(sent["servo1_raw"][sent["port"] == port], 1000 * (port + 1) + np.arange(10) + 0.5)
    assert not sent["servo2_raw"].any()  # beyond the outputs in use


def test_a_topic_subscribed_to_twice_is_one(tmp_path: Path) -> None:
    again = subscription("actuator_controls_0", number=900)
    first = [data("actuator_controls_0", 20 + row, *[row] * 8) for row in range(5)]
    then = [data("actuator_controls_0", 25 + row, *[5 + row] * 8, number=900) for row in range(5)]
    controls = vehicle_of(log(*first, again, *then), tmp_path).messages["ACTUATOR_CONTROL_TARGET"]["controls"]
    assert controls[:, 0].tolist() == list(range(10))


def test_demands_are_controls(tmp_path: Path) -> None:
    pieces = [data("vehicle_torque_setpoint", 20 + row, 0.1, -0.2, row) for row in range(4)]
    pieces += [data("vehicle_thrust_setpoint", 20 + row, 0, 0, -0.5) for row in range(4)]
    target = vehicle_of(log(*pieces), tmp_path).messages["ACTUATOR_CONTROL_TARGET"]
    assert np.allclose(target["controls"][3], [0.1, -0.2, 3, 0.5, 0, 0, 0, 0]) and not target["group_mlx"].any()


def test_setpoints_keep_their_own_stamps(tmp_path: Path) -> None:
    pieces = flight(TIMES)
    for row in range(4):
        half = 0.05 * row
        pieces.append(data("vehicle_attitude_setpoint", 20 + row / 2, 0, np.cos(half), np.sin(half), 0, 0, row != 2))
        pieces.append(data("vehicle_rates_setpoint", 20.1 + row / 2, row, 10 + row, 20 + row))
        pieces.append(data("manual_control_setpoint", 20.2 + row / 2, -0.1 * row, 0.1 * row, 0.5, 0.2 * row))
    vehicle = vehicle_of(log(*pieces), tmp_path)
    assert (np.diff(vehicle.messages["ATTITUDE_TARGET"]["time"]) > 0).all()
    rate, angle, stick = setpoints(vehicle, "roll")
    np.testing.assert_allclose(rate.signal.time, 20.1 + np.arange(4) / 2)
    np.testing.assert_allclose(rate.signal.values, np.arange(4))
    np.testing.assert_allclose(angle.signal.values, [0, 0.1, 0.3], atol=1e-7)
    np.testing.assert_allclose(angle.signal.time, [20, 20.5, 21.5])
    np.testing.assert_allclose(stick.signal.values, 0.1 * np.arange(4), atol=1e-7)
    yaw, stick = setpoints(vehicle, "yaw")
    np.testing.assert_allclose(yaw.signal.values, 20 + np.arange(4))
    np.testing.assert_allclose(stick.signal.values, 0.2 * np.arange(4), atol=1e-7)
    assert vehicle.called("MANUAL_CONTROL") == "manual_control_setpoint"


def test_the_battery(tmp_path: Path) -> None:
    pieces = flight(TIMES) + [data("battery_status", 20 + row, 16 - row, 99) for row in range(3)]
    signal = Signals(vehicle_of(log(*pieces), tmp_path)).voltage
    assert signal is not None and signal.values.tolist() == pytest.approx([16, 15, 14])
    assert signal.time.tolist() == pytest.approx([20, 21, 22])


def test_landed_states(tmp_path: Path) -> None:
    def target(seconds: float, kind: int, valid: bool = True) -> bytes:
        return data("position_setpoint_triplet", seconds, 0, 0.0, False, 0, 0, 47.0, valid, kind)

    pieces = [data("vehicle_land_detected", 10, True), data("vehicle_control_mode", 10.5, True), target(11, 3)]
    pieces += [data("vehicle_land_detected", 12, False), target(20, 2), target(30, 4), target(31, 4, valid=False)]
    pieces += [target(32, 4), data("vehicle_control_mode", 33, False), data("vehicle_land_detected", 40, True)]
    states = vehicle_of(log(*pieces), tmp_path).messages["EXTENDED_SYS_STATE"]
    told = dict(zip(states["time"].tolist(), states["landed_state"].tolist(), strict=True))
    assert told == {10: 1, 10.5: 1, 11: 1, 12: 3, 20: 2, 30: 4, 31: 2, 32: 4, 33: 2, 40: 1}


def test_a_vertical_speed_that_is_not_valid_is_left_out(tmp_path: Path) -> None:
    pieces = [data("vehicle_local_position", 20 + row, 0, 0, 0, 0, 0, row, row % 2 == 0) for row in range(6)]
    climb = Signals(vehicle_of(log(*pieces), tmp_path)).climb_rate
    assert climb is not None and climb.values.tolist() == [0, -2, -4]


@pytest.mark.parametrize(
    ("status", "parameters", "expected"),
    [
        ((2, 13, 1), b"", "HEXAROTOR"),
        ((2, 0, 1), parameter("MAV_TYPE", 14), "OCTOROTOR"),
        ((2, 0, 1), b"", "GENERIC_MULTIROTOR"),
        ((2, 0, 2), b"", "FIXED_WING"),
        ((2, 0, 0), b"", "UNKNOWN"),
    ],
)
def test_what_the_vehicle_is(tmp_path: Path, status: tuple[int, ...], parameters: bytes, expected: str) -> None:
    pieces = [data("vehicle_status", 20 + row, *status) for row in range(4)]
    vehicle = vehicle_of(log(*pieces, parameters=parameters), tmp_path)
    assert vehicle.vehicle == expected
    if expected != "UNKNOWN":
        armed = Signals(vehicle).armed
        assert armed is not None and armed.values.all()


def test_parameters_are_the_last_that_were_set(tmp_path: Path) -> None:
    initial = parameter("MAV_SYS_ID", 7) + parameter("GAIN", 0.5, "float") + parameter("BAD", float("nan"), "float")
    changed = [parameter("GAIN", 0.25, "float"), parameter("GAIN", float("inf"), "float")]
    vehicle = vehicle_of(log(*flight(TIMES[:9]), *changed, parameters=initial), tmp_path)
    assert vehicle.parameters == {"MAV_SYS_ID": 7.0, "GAIN": 0.25} and vehicle.system == 7
