"""DataFlash logs of other versions of ArduPilot: other columns, units and stamps for the same quantities."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from mavdem.alignment.signals import Signals, setpoints
from mavdem.errors import Unreadable
from mavdem.ingest.dataflash.log import read_dataflash
from mavdem.ingest.telemetry import Telemetry

SHARED = Path(os.environ.get("MAVDEM_SHARED_DATA", Path(__file__).parents[3] / "shared" / "data")) / "real" / "logs"
COLUMNS = {
    "MSG": ("QZ", "TimeUS,Message"),
    "ATT": ("Qfff", "TimeUS,Roll,Pitch,Yaw"),
    "RATE": ("Qffffffffff", "TimeUS,R,P,Y,ROut,POut,YOut,AOut,RDes,PDes,YDes"),
    "IMU": ("Qfff", "TimeUS,GyrX,GyrY,GyrZ"),
    "EV": ("B", "Id"),
    "BAT": ("QBf", "TimeUS,Instance,Volt"),
    "CURR": ("Qh", "TimeUS,Volt"),
}
TIMES = np.arange(20.0, 24.0, 0.02)
ROLL_RATE = np.radians(40.0) * np.sin(5 * TIMES)  # rad/s


def log(
    folder: Path,
    rate: float = 1.0,
    firmware: str = "hello",
    gyro: bool = True,
    swing: float = 1.0,
    battery: str = "",
    **columns: str,
) -> Telemetry:
    """A roll that swings, with RATE's rates in degrees/s times ``rate``; ``columns`` are other field names."""
    defined = {name: (characters, columns.get(name, fields)) for name, (characters, fields) in COLUMNS.items()}
    lines = [f"FMT, {129 + i}, 0, {name}, {', '.join(defined[name])}" for i, name in enumerate(defined)]
    lines.append(f"MSG, 19000000, {firmware}")
    for time, speed in zip(TIMES, swing * ROLL_RATE, strict=True):
        stamp, turned = round(1e6 * time), np.degrees(speed) * rate
        lines.append(f"ATT, {stamp}, {-8 * np.cos(5 * time)}, 0, 0")
        lines.append(
            f"RATE, {stamp}, {turned}, 0, 0, {0.1 * rate}, 0, 0, {0.4 if rate == 1 else 400}, {2 * turned}, 0, 0"
        )
        if gyro:
            lines.append(f"IMU, {stamp}, {speed}, 0, 0")
        if battery == "BAT":
            lines += [f"BAT, {stamp}, {instance}, {volt}" for instance, volt in ((1, 5.0), (0, 15.25))]
        elif battery:
            lines.append(f"{battery}, {stamp}, 1525")
        if stamp in (21_000_000, 23_000_000):
            lines.append(f"EV, {10 if stamp == 21_000_000 else 11}")
    (folder / "flight.log").write_text("\n".join(lines) + "\n")
    (vehicle,) = read_dataflash(folder / "flight.log").vehicles
    return vehicle


@pytest.mark.parametrize(
    ("rate", "firmware", "gyro"),
    [
        (100, "hello", True),
        (100, "APM:Copter V3.3-dev (ae3192b8)", False),
        (1, "APM:Copter V3.3-dev (ae3192b8)", True),
        (1, "ArduCopter V4.5.7 (2a3dc4b7)", False),
        (1, "ArduPlane V3.3.0", False),
    ],
)
def test_the_unit_of_rate_is_told_by_the_gyro_else_by_the_version(
    tmp_path: Path, rate: float, firmware: str, gyro: bool
) -> None:
    vehicle = log(tmp_path, rate, firmware, gyro)
    np.testing.assert_allclose(vehicle.messages["ATTITUDE"]["rollspeed"], ROLL_RATE, rtol=1e-4, atol=1e-6)
    assert any("centidegrees" in note for note in vehicle.repairs) == (rate == 100)
    (asked,) = setpoints(vehicle, "roll")
    np.testing.assert_allclose(asked.signal.values, 2 * ROLL_RATE, rtol=1e-4, atol=1e-6)


def test_a_gyro_that_does_not_turn_decides_nothing(tmp_path: Path) -> None:
    """Rounding and bias of a vehicle at rest make any ratio."""
    assert not any("centidegrees" in note for note in log(tmp_path, 100.0, swing=0.001).repairs)


def test_demands_of_4500_are_full_demands(tmp_path: Path) -> None:
    controls = log(tmp_path, 100.0).messages["ACTUATOR_CONTROL_TARGET"]["controls"]
    np.testing.assert_allclose(controls[:, 0], 10.0 / 4500)
    np.testing.assert_allclose(controls[:, 3], 0.4)
    controls = log(tmp_path).messages["ACTUATOR_CONTROL_TARGET"]["controls"]
    np.testing.assert_allclose(controls[:, [0, 3]], [[0.1, 0.4]] * len(TIMES))


@pytest.mark.filterwarnings("error")
def test_values_that_are_not_finite_give_no_warning(tmp_path: Path) -> None:
    lines = ["FMT, 129, 0, ATT, Qfff, TimeUS,Roll,Pitch,Yaw", "FMT, 130, 0, RATE, Qfff, TimeUS,R,P,Y"]
    lines += [f"ATT, {20000 * row}, {'inf' if row == 7 else 1}, 0, 0" for row in range(1, 20)]
    lines += [f"RATE, {20000 * row}, {'-inf' if row == 7 else 1}, 0, 0" for row in range(1, 20)]
    (tmp_path / "flight.log").write_text("\n".join(lines) + "\n")
    (vehicle,) = read_dataflash(tmp_path / "flight.log").vehicles
    attitude = vehicle.messages["ATTITUDE"]
    assert np.isnan(attitude["roll"]).sum() == 1 and np.isfinite(attitude["rollspeed"]).all()


def test_rate_with_columns_nobody_knows_leaves_the_gyro(tmp_path: Path) -> None:
    vehicle = log(tmp_path, RATE="TimeUS,a,b,c,d,e,f,g,h,i,j")
    np.testing.assert_allclose(vehicle.messages["ATTITUDE"]["rollspeed"], ROLL_RATE, atol=1e-9)
    assert vehicle.called("ATTITUDE") == "ATT" and "ACTUATOR_CONTROL_TARGET" not in vehicle.messages


def test_rate_of_3_3_before_its_release_is_read_under_its_own_names(tmp_path: Path) -> None:
    vehicle = log(tmp_path, RATE="TimeUS,Rll,Pit,Yaw,RllOut,PitOut,YawOut,x,RllDes,PitDes,YawDes")
    (asked,) = setpoints(vehicle, "roll")
    np.testing.assert_allclose(asked.signal.values, 2 * ROLL_RATE, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(vehicle.messages["ATTITUDE"]["rollspeed"], ROLL_RATE, rtol=1e-4, atol=1e-6)
    controls = vehicle.messages["ACTUATOR_CONTROL_TARGET"]["controls"]
    assert (controls[:, 0] == 0.1).all() and np.isnan(controls[:, 3]).all()
    assert Signals(vehicle).collective is None


def test_events_without_stamps_have_the_time_of_the_message_before_them(tmp_path: Path) -> None:
    armed = Signals(log(tmp_path)).armed
    assert armed is not None
    assert armed.time[armed.values > 0].tolist() == [21.0, 22.0]


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("FMT, 129, 0, ATT, ccc, Roll,Pitch,Yaw\nATT, 1, 2, 3\n", "without time stamps"),
        ("FMT, 129, 0, ATT, fff, Roll,Pitch,Yaw\nFMT, 1, 0, TIME, Q, StartTime\nATT, 1, 2, 3\nTIME, 5\n", "sdlog2"),
    ],
)
def test_a_log_without_a_clock_says_what_it_is(tmp_path: Path, lines: str, said: str) -> None:
    (tmp_path / "flight.log").write_text(lines)
    with pytest.raises(Unreadable, match=said):
        read_dataflash(tmp_path / "flight.log")


@pytest.mark.parametrize(
    ("name", "notes"),
    [
        ("ardupilot33_rate_in_centidegrees.bin", 2),
        ("ardupilot34dev_rate_in_centidegrees.BIN", 2),
        ("ardupilot33dev_other_rate_columns.BIN", 2),
        ("ardupilot31_bitmask_already_set.BIN", 0),
    ],
)
def test_recorded_logs_of_old_versions(name: str, notes: int) -> None:
    if not (SHARED / name).exists():
        pytest.skip("the shared data are not here")
    (vehicle,) = read_dataflash(SHARED / name).vehicles
    attitude = Signals(vehicle).attitude
    assert attitude is not None and attitude.impossible == 0
    assert sum("RATE" in note for note in vehicle.repairs) == notes
    # Integrated, the rates are the angles: they have the right unit.
    steps = np.diff(attitude.time)
    usual = (steps < 0.15) & (np.abs(attitude.angle[1:]) < 1)
    change, turned = np.diff(attitude.angle)[usual], (attitude.slope[1:] * steps)[usual]
    assert 0.7 < np.polyfit(turned, change, 1)[0] < 1.3


@pytest.mark.parametrize("battery", ["BAT", "CURR"])
def test_the_battery_in_volts_and_in_the_hundredths_of_old_logs(tmp_path: Path, battery: str) -> None:
    vehicle = log(tmp_path, battery=battery)
    signal = Signals(vehicle).voltage
    assert signal is not None and len(signal.time) == len(TIMES)
    np.testing.assert_allclose(signal.values, 15.25)
    assert vehicle.called("SYS_STATUS") == battery
    assert Signals(log(tmp_path)).voltage is None
