"""Battery, vibration and calendar time of a DataFlash log as MAVLink's SYS_STATUS, VIBRATION and SYSTEM_TIME."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mavdem.ingest.dataflash.definitions import MessageTable
from mavdem.ingest.dataflash.fields import having, instance, stamped, values
from mavdem.ingest.telemetry import Columns, selected

BATTERIES = ("BAT", "CURR")
MAX_VOLTAGE = 200.0  # V: no multirotor has more, and a battery of one cell has more hundredths
LEVELS = ("VibeX", "VibeY", "VibeZ")
GPS_EPOCH, WEEK = 315964800, 604800  # UNIX s at which GPS time began, and seconds of a week
LEAP_SECONDS = ((0.0, 16), (1435708800.0, 17), (1483228800.0, 18))
"""How far GPS time is ahead of UTC from a UNIX second on: https://hpiers.obspm.fr/iers/bul/bulc/bulletinc.dat."""
FIX_3D = 3  # GPS Status from which the receiver knows the time


def battery(tables: Mapping[str, Columns]) -> tuple[Columns | None, str]:
    """SYS_STATUS of the first battery, with the decimals the message cuts off, and the name of its message."""
    for name in BATTERIES:
        logged = having(tables, name, ("Volt",))
        if logged is None:
            continue
        for field in ("Inst", "Instance", "I"):
            logged = instance(logged, field, 0) or logged
        volts = values(logged, ("Volt",))[:, 0]
        hundredths = np.any(volts > 0) and np.nanmedian(volts[volts > 0]) > MAX_VOLTAGE
        found = {"voltage_battery": volts * (10.0 if hundredths else 1000.0)}
        if having(tables, name, ("Curr",)) is not None:
            found["current_battery"] = values(logged, ("Curr",))[:, 0] * (1.0 if hundredths else 100.0)
        return stamped(logged, "", found), name
    return None, BATTERIES[0]


def vibration(tables: Mapping[str, Columns]) -> Columns | None:
    """VIBRATION of the first IMU: the standard deviation of the acceleration along each axis, m/s²."""
    logged = having(tables, "VIBE", LEVELS)
    if logged is None:
        return None
    logged = instance(logged, "IMU", 0) or logged
    clips = next((logged[name] for name in ("Clip", "Clip0") if name in logged), np.zeros(len(logged["time"])))
    levels = zip(("vibration_x", "vibration_y", "vibration_z"), values(logged, LEVELS).T, strict=True)
    none = np.zeros(len(logged["time"]))
    return stamped(logged, "time_usec", {**dict(levels), "clipping_0": clips, "clipping_1": none, "clipping_2": none})


def on_boot_clock(gps: MessageTable) -> MessageTable:
    """GPS before ArduPilot 3.3 under its later names: there TimeMS is of the week, and T of the boot."""
    old = {"TimeMS": "GMS", "Week": "GWk", "T": "TimeMS"}
    if not old.keys() <= gps.columns.keys():
        return gps
    return MessageTable(gps.place, {old.get(name, name): column for name, column in gps.columns.items()})


def calendar_time(tables: Mapping[str, Columns]) -> Columns | None:
    """SYSTEM_TIME, UTC by the receiver, where it has a fix."""
    logged = having(tables, "GPS", ("Status", "GMS", "GWk"))
    if logged is None:
        return None
    logged = selected(logged, (logged["Status"] >= FIX_3D) & (logged["GWk"] > 0))
    week, milliseconds = values(logged, ("GWk", "GMS")).T
    seconds = GPS_EPOCH + WEEK * week + milliseconds / 1e3
    begins, ahead = zip(*LEAP_SECONDS, strict=True)
    seconds = seconds - np.array(ahead)[np.searchsorted(begins, seconds, side="right") - 1]
    unix = np.rint(1e6 * np.where(np.isfinite(seconds), seconds, 0.0)).astype(np.uint64)
    return stamped(logged, "time_boot_ms", {"time_unix_usec": unix})
