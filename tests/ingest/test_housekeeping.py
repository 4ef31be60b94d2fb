"""Battery, vibration, UTC, board and firmware of the autopilots' own logs, beside their own libraries' readings."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import dataflash_logs as dataflash
import numpy as np
import pytest
from pymavlink.DFReader import DFReader_binary
from pyulog import ULog
from recorded_flights import shared

from mavdem.ingest import read_log
from mavdem.ingest.telemetry import Telemetry

TIMES = [20 + 0.1 * n for n in range(50)]


def vehicle_of(path: Path, *messages: bytes) -> Telemetry:
    log = [dataflash.formats(), dataflash.told(), *dataflash.flight(TIMES), *messages]
    path.write_bytes(b"".join(log))
    return read_log(path).vehicles[0]


def test_a_dataflash_log_has_the_first_battery_imu_and_receiver(tmp_path):
    moment = datetime(2026, 5, 4, 12, tzinfo=UTC)
    week, seconds = divmod(moment.timestamp() - 315964800 + 18, 604800)
    messages = [dataflash.message("MSG", 1_000_000, "CUAVv5Nano 001A002F 30395113 33333539")]
    for n in range(5):
        time = 20_000_000 + n * 1_000_000
        for instance in (0, 1):
            messages.append(dataflash.message("BAT", time, instance, 12.5 - instance, 12.6, 15.25 + instance))
            messages.append(dataflash.message("VIBE", time, instance, 1.5, 2.5, 3.5 + instance, n + 7 * instance))
        fix = 3 if n else 1
        messages.append(dataflash.message("GPS", time, 0, fix, round(1e3 * (seconds + n)), int(week)))
    found = vehicle_of(tmp_path / "a.bin", *messages)
    assert found.board == "001a002f3039511333333539" and found.called("VIBRATION") == "VIBE"
    power, shaking, clock = (found.messages[name] for name in ("SYS_STATUS", "VIBRATION", "SYSTEM_TIME"))
    np.testing.assert_allclose(power["voltage_battery"], 12500)
    np.testing.assert_allclose(power["current_battery"], 1525)
    np.testing.assert_allclose(shaking["vibration_z"], 3.5)
    np.testing.assert_array_equal(shaking["clipping_0"], range(5))
    np.testing.assert_allclose(clock["time_unix_usec"] / 1e6, moment.timestamp() + np.arange(1, 5))  # with a fix


def test_a_dataflash_log_has_what_pymavlink_reads_of_it():
    path = shared("real/propeller/hover_good_1.BIN")
    (vehicle,) = read_log(path).vehicles
    reader = DFReader_binary(str(path))
    levels, volts, stamps = [], [], []
    while (message := reader.recv_match(type=["VIBE", "BAT", "GPS"])) is not None:
        if message.get_type() == "VIBE" and message.IMU == 0:
            levels.append((message.TimeUS, message.VibeX, message.VibeY, message.VibeZ, message.Clip))
        elif message.get_type() == "BAT" and message.Instance == 0:
            volts.append((message.TimeUS, message.Volt, message.Curr))
        elif message.get_type() == "GPS" and message.I == 0 and message.Status >= 3:
            stamps.append((message.TimeUS, message.GWk, message.GMS))
    shaking, power, clock = (vehicle.messages[name] for name in ("VIBRATION", "SYS_STATUS", "SYSTEM_TIME"))
    names = ("vibration_x", "vibration_y", "vibration_z", "clipping_0")
    ours = np.column_stack([1e6 * shaking["time"], *(shaking[name] for name in names)])
    np.testing.assert_allclose(ours, levels, rtol=1e-6)
    ours = np.column_stack([1e6 * power["time"], power["voltage_battery"] / 1e3, power["current_battery"] / 1e2])
    np.testing.assert_allclose(ours, volts, rtol=1e-6)
    first = clock["time_unix_usec"][0] / 1e6
    # pymavlink subtracts the leap seconds of its own table.
    assert first == pytest.approx(reader.clock._gpsTimeToTime(*stamps[0][1:]), abs=1e-3)


def test_a_ulog_has_what_pyulog_reads_of_it():
    path = shared("real/logs/px4_default_rates_learnable.ulg")
    (vehicle,) = read_log(path).vehicles
    log = ULog(str(path), ["vehicle_imu_status", "battery_status"])
    status, power = log.get_dataset("vehicle_imu_status").data, log.get_dataset("battery_status").data
    np.testing.assert_array_equal(vehicle.messages["VIBRATION"]["vibration_z"], status["accel_vibration_metric"])
    np.testing.assert_allclose(vehicle.messages["SYS_STATUS"]["current_battery"], 100.0 * power["current_a"], rtol=1e-6)
    assert vehicle.board == log.msg_info_dict["sys_uuid"]
    version = log.get_version_info_str().replace(" (RC)", "-rc")
    assert vehicle.firmware == f"PX4 {version} ({log.msg_info_dict['ver_sw'][:8]})"


def test_a_ulog_s_utc_is_that_of_the_receiver():
    path = shared("real/logs/px4_motor_failure.ulg")
    clock = read_log(path).vehicles[0].messages["SYSTEM_TIME"]
    gps = ULog(str(path), ["vehicle_gps_position"]).get_dataset("vehicle_gps_position").data
    known = gps["time_utc_usec"] > 0
    np.testing.assert_array_equal(clock["time_unix_usec"], gps["time_utc_usec"][known])
    np.testing.assert_allclose(clock["time"], gps["timestamp"][known] / 1e6)
