"""Barometer, accelerometer and stick of DataFlash and ULog, in MAVLink's messages."""

import dataflash_logs
import ulog_files
from pytest import approx

from mavdem.ingest.dataflash.log import read_dataflash

TIMES = [20 + 0.1 * row for row in range(30)]


def dataflash_vehicle(folder, *pieces):
    path = folder / "flight.bin"
    path.write_bytes(dataflash_logs.log(*dataflash_logs.flight(TIMES), *pieces))
    (vehicle,) = read_dataflash(path).vehicles
    return vehicle


def dataflash_message(name, time, *values):
    return dataflash_logs.message(name, round(1e6 * time), *values)


def test_of_several_barometers_and_imus_in_dataflash_the_first_is_read(tmp_path):
    pieces = []
    for time in TIMES:
        for number in (1, 0):
            pieces.append(dataflash_message("BARO", time, number, 5.0 + number, 95_000.0))
            pieces.append(dataflash_message("IMU", time, number, 0, 0, 0, 0, 0, -9.8 - number))
    messages = dataflash_vehicle(tmp_path, *pieces).messages
    assert messages["SCALED_PRESSURE"]["altitude"] == approx([5.0] * len(TIMES))
    assert messages["SCALED_PRESSURE"]["press_abs"] == approx([950.0] * len(TIMES))
    assert messages["HIGHRES_IMU"]["zacc"] == approx([-9.8] * len(TIMES))


def test_the_sticks_of_dataflash_are_rc_channels(tmp_path):
    pieces = [dataflash_message("RCIN", time, 1500, 1501, 1100, 1502) for time in TIMES]
    channels = dataflash_vehicle(tmp_path, *pieces).messages["RC_CHANNELS"]
    assert channels["chan3_raw"].tolist() == [1100] * len(TIMES)
    assert channels["chan4_raw"].tolist() == [1502] * len(TIMES)


def test_old_dataflash_has_the_throttle_stick_in_ctun_too(tmp_path, monkeypatch):
    old_definition = (135, "Qhhh", "TimeUS,ThrIn,DCRt,CRt")
    monkeypatch.setitem(dataflash_logs.MESSAGES, "CTUN", old_definition)
    pieces = [dataflash_message("CTUN", time, 550) for time in TIMES]
    stick = dataflash_vehicle(tmp_path, *pieces).messages["MANUAL_CONTROL"]
    assert stick["z"].tolist() == [550] * len(TIMES)


def test_the_throttle_of_the_controller_is_not_the_stick(tmp_path):
    pieces = [dataflash_message("CTUN", time, 0.35) for time in TIMES]
    assert "MANUAL_CONTROL" not in dataflash_vehicle(tmp_path, *pieces).messages


def test_px4s_air_data_is_the_barometer(tmp_path):
    air = [ulog_files.data("vehicle_air_data", time, 488.0, 95_600.0) for time in TIMES]
    vehicle = ulog_files.vehicle_in(tmp_path, *ulog_files.flight(TIMES), *air)
    assert vehicle.messages["SCALED_PRESSURE"]["altitude"] == approx([488.0] * len(TIMES))
    assert vehicle.messages["SCALED_PRESSURE"]["press_abs"] == approx([956.0] * len(TIMES))


def test_px4s_throttle_stick_counts_from_closed_to_open(tmp_path):
    sticks = [
        ulog_files.data("manual_control_setpoint", time, is_valid, throttle)
        for time, is_valid, throttle in ((20.0, True, -1.0), (21.0, False, 0.5), (22.0, True, 0.0))
    ]
    vehicle = ulog_files.vehicle_in(tmp_path, *ulog_files.flight(TIMES), *sticks)
    assert vehicle.messages["MANUAL_CONTROL"]["z"] == approx([0.0, 500.0])
