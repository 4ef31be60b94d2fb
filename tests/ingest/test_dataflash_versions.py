"""DataFlash logs of other versions of ArduPilot: other columns, units and stamps for the same quantities."""

from datetime import UTC, datetime

import dataflash_logs as dataflash
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from pytest import mark

from mavdem.dataset.setpoints import recorded_setpoints
from mavdem.dataset.signals import Signals
from mavdem.facts.sources import Repair
from mavdem.ingest.dataflash.log import read_dataflash

COLUMNS = {
    "MSG": ("QZ", "TimeUS,Message"),
    "ATT": ("Qfff", "TimeUS,Roll,Pitch,Yaw"),
    "RATE": ("Qffffffffff", "TimeUS,R,P,Y,ROut,POut,YOut,AOut,RDes,PDes,YDes"),
    "IMU": ("QBfff", "TimeUS,I,GyrX,GyrY,GyrZ"),
    "EV": ("B", "Id"),
    "BAT": ("QBf", "TimeUS,Instance,Volt"),
    "CURR": ("Qh", "TimeUS,Volt"),
}
TIMES = np.arange(20.0, 24.0, 0.02)
CENTIDEGREES = Repair.CENTIDEGREES_CONVERTED
ROLL_RATE = np.radians(40.0) * np.sin(5 * TIMES)  # Unit: rad/s.


def log(
    folder,
    rate=1.0,
    firmware="hello",
    gyro=True,
    swing=1.0,
    battery="",
    **columns,
):
    """A roll that swings, with RATE's rates in degrees/s times ``rate``; ``columns`` are other field names."""
    defined = {
        name: (characters, columns.get(name, fields))
        for name, (characters, fields) in COLUMNS.items()
    }
    lines = [
        f"FMT, {129 + i}, 0, {name}, {', '.join(defined[name])}" for i, name in enumerate(defined)
    ]
    lines.append(f"MSG, 19000000, {firmware}")
    for time, speed in zip(TIMES, swing * ROLL_RATE, strict=True):
        stamp = round(1e6 * time)
        turned = np.degrees(speed) * rate
        lines.append(f"ATT, {stamp}, {-8 * np.cos(5 * time)}, 0, 0")
        lines.append(
            f"RATE, {stamp}, {turned}, 0, 0, {0.1 * rate}, 0, 0, {0.4 if rate == 1 else 400}, {2 * turned}, 0, 0"
        )
        if gyro:
            lines += [f"IMU, {stamp}, {n}, {(1 + 8 * n) * speed}, 0, 0" for n in (0, 1)]
        if battery == "BAT":
            lines += [
                f"BAT, {stamp}, {instance}, {volt}" for instance, volt in ((1, 5.0), (0, 15.25))
            ]
        elif battery:
            lines.append(f"{battery}, {stamp}, 1525")
        if stamp in (21_000_000, 23_000_000):
            lines.append(f"EV, {10 if stamp == 21_000_000 else 11}")
    (folder / "flight.log").write_text("\n".join(lines) + "\n")
    (vehicle,) = read_dataflash(folder / "flight.log").vehicles
    return vehicle


@mark.parametrize("rate, gyro", [(100, True), (1, True), (1, False)])
def test_the_unit_of_rate_is_told_by_the_gyro(tmp_path, rate, gyro):
    """Old versions log rates in centidegrees per second.

    The gyro in the log shows that; without motion nothing is concluded.
    """
    vehicle = log(tmp_path, rate, gyro=gyro)
    assert_allclose(vehicle.messages["ATTITUDE"]["rollspeed"], ROLL_RATE, rtol=1e-4, atol=1e-6)
    if rate == 100:
        assert [fact.code is CENTIDEGREES for fact in vehicle.repairs].count(True) == 1
    else:
        assert [fact.code is CENTIDEGREES for fact in vehicle.repairs].count(True) == 0
    (asked,) = recorded_setpoints(vehicle, "roll")
    assert_allclose(asked.signal.values, 2 * ROLL_RATE, rtol=1e-4, atol=1e-6)
    # Rounding and bias of a vehicle at rest make any ratio.
    assert CENTIDEGREES not in [fact.code for fact in log(tmp_path, 100.0, swing=0.001).repairs]


@mark.slow
def test_demands_of_4500_are_full_demands(tmp_path):
    controls = log(tmp_path, 100.0).messages["ACTUATOR_CONTROL_TARGET"]["controls"]
    assert_allclose(controls[:, 0], 10.0 / 4500)
    assert_allclose(controls[:, 3], 0.4)
    controls = log(tmp_path).messages["ACTUATOR_CONTROL_TARGET"]["controls"]
    assert_allclose(controls[:, [0, 3]], [[0.1, 0.4]] * len(TIMES))


def test_rate_with_columns_nobody_knows_leaves_the_gyro(tmp_path):
    vehicle = log(tmp_path, RATE="TimeUS,a,b,c,d,e,f,g,h,i,j")
    assert_allclose(vehicle.messages["ATTITUDE"]["rollspeed"], ROLL_RATE, atol=1e-9)
    assert (
        vehicle.name_in_source("ATTITUDE") == "ATT"
        and "ACTUATOR_CONTROL_TARGET" not in vehicle.messages
    )


def test_rate_of_3_3_before_its_release_is_read_under_its_own_names(tmp_path):
    vehicle = log(tmp_path, RATE="TimeUS,Rll,Pit,Yaw,RllOut,PitOut,YawOut,x,RllDes,PitDes,YawDes")
    (asked,) = recorded_setpoints(vehicle, "roll")
    assert_allclose(asked.signal.values, 2 * ROLL_RATE, rtol=1e-4, atol=1e-6)
    assert_allclose(vehicle.messages["ATTITUDE"]["rollspeed"], ROLL_RATE, rtol=1e-4, atol=1e-6)
    controls = vehicle.messages["ACTUATOR_CONTROL_TARGET"]["controls"]
    assert (controls[:, 0] == 0.1).all() and np.isnan(controls[:, 3]).all()
    assert Signals(vehicle).collective is None
    # Events without stamps have the time of the message before them, arming that of the one behind.
    armed = Signals(log(tmp_path)).armed
    assert np.unique(armed.time[armed.values > 0]).tolist() == [21.02, 23.0]


@mark.slow
def test_lines_that_are_no_messages_cost_themselves_only(tmp_path):
    """A text log has blank lines, nonsense, and a line that is cut off."""
    complete_log = log(tmp_path, firmware="a, text, with commas")
    path = tmp_path / "flight.log"
    text = path.read_text().replace("\nRATE", "\nRATE, 5\nnonsense\nRATE", 1) + "ATT, 1, 2"
    path.write_text("ArduCopter V4\r\n\r\n" + text.replace("\n", "\r\n"), newline="")
    (vehicle,) = read_dataflash(path).vehicles
    left_out, *_ = vehicle.repairs
    assert (left_out.code, left_out.figures["count"]) == (Repair.LINES_LEFT_OUT, 4)
    for name, fields in complete_log.messages.items():
        for field, values in fields.items():
            assert_array_equal(vehicle.messages[name][field], values)
    assert vehicle.messages["STATUSTEXT"]["text"].tolist() == ["a, text, with commas"]


@mark.parametrize("battery", ["BAT", "CURR"])
def test_the_battery_in_volts_and_in_the_hundredths_of_old_logs(tmp_path, battery):
    vehicle = log(tmp_path, battery=battery)
    signal = Signals(vehicle).batteries[0].voltage
    assert len(signal.time) == len(TIMES)
    assert_allclose(signal.values, 15.25)
    assert vehicle.name_in_source("SYS_STATUS") == battery
    assert not Signals(log(tmp_path)).batteries


def test_a_dataflash_log_has_its_board_and_the_time_of_the_first_receiver(tmp_path):
    """The serial number of the board is in a text; week and milliseconds of GPS give the UTC once there is a fix."""
    moment = datetime(2026, 5, 4, 12, tzinfo=UTC)
    week, seconds = divmod(moment.timestamp() - 315964800 + 18, 604800)
    pieces = [dataflash.message("MSG", 1_000_000, "CUAVv5Nano 001A002F 30395113 33333539")]
    for n in range(5):
        at = round(1e3 * (seconds + n)), int(week)
        fix = 3 if n else 1
        pieces.append(dataflash.message("GPS", 20_000_000 + n * 1_000_000, 0, fix, *at))
    path = tmp_path / "a.bin"
    path.write_bytes(dataflash.log(*dataflash.flight(np.arange(20.0, 25.0, 0.1)), *pieces))
    (vehicle,) = read_dataflash(path).vehicles
    assert (vehicle.board, vehicle.hardware) == ("001a002f3039511333333539", "CUAVv5Nano")
    # The time is that of messages with a fix.
    unix = vehicle.messages["SYSTEM_TIME"]["time_unix_usec"] / 1e6
    assert_allclose(unix, moment.timestamp() + np.arange(1, 5), rtol=1e-12)


def log_of_estimator(folder, start):
    """A vehicle that moves north at 0.5 m/s, of an estimator that is logged with zeros until it starts at a time, s."""
    lines = [
        "FMT, 129, 0, ATT, Qfff, TimeUS,Roll,Pitch,Yaw",
        "FMT, 130, 0, EKF1, Qffffff, TimeUS,VN,VE,VD,PN,PE,PD",
    ]
    for time in TIMES:
        stamp = round(1e6 * time)
        north = 0.5 if time >= start else 0.0
        lines += [f"ATT, {stamp}, 0, 0, 0", f"EKF1, {stamp}, {north}, 0, 0, 0, 0, 0"]
    (folder / "flight.log").write_text("\n".join(lines) + "\n")
    (vehicle,) = read_dataflash(folder / "flight.log").vehicles
    return vehicle


def test_zeros_of_an_estimator_that_has_not_started_are_no_position(tmp_path):
    position = log_of_estimator(tmp_path, start=TIMES[50]).messages["LOCAL_POSITION_NED"]
    assert_allclose(position["time"], TIMES[50:])
    assert_allclose(position["vx"], 0.5)
    assert "LOCAL_POSITION_NED" not in log_of_estimator(tmp_path, start=np.inf).messages
