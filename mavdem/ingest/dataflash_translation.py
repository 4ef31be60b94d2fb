"""DataFlash's messages in MAVLink's vocabulary.

Fields and units: https://ardupilot.org/copter/docs/logmessages.html, from ArduPilot's ``LogStructure.h`` files.

| MAVLink | DataFlash |
|---|---|
| ATTITUDE roll, pitch, yaw (rad) | ATT or, where faster (ArduPilot 4.7), ANG: Roll, Pitch, Yaw (°, yaw 0 to 360) |
| ATTITUDE rollspeed, pitchspeed, yawspeed (rad/s) | RATE R, P, Y (°/s), or IMU GyrX, GyrY, GyrZ of instance 0 (rad/s) |
| SERVO_OUTPUT_RAW servo1_raw to servo16_raw (µs) | RCOU C1 to C14 (Ch1 or Chan1 in old logs) |
| ACTUATOR_CONTROL_TARGET controls of group 0 | RATE ROut, POut, YOut (-1 to 1), AOut (0 to 1): what goes to the mixer |
| LOCAL_POSITION_NED | XKF1 or NKF1 PN, PE, PD (m), VN, VE, VD (m/s) of the core that is primary (XKF4 PI) |
| VFR_HUD climb (m/s) | CTUN CRt (cm/s) |
| HEARTBEAT, EXTENDED_SYS_STATE | EV, ARM (``dataflash_states``) |

RATE holds the rates that MAVLink's ATTITUDE sends, filtered and freed of the gyro bias that the estimator sees. IMU has
the bias still, and is used only where RATE was logged slower than both it and the angles.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.dataflash_states import heartbeats, landed_states
from mavdem.ingest.rows import rows_by
from mavdem.telemetry import Columns

ANGLES, RATES, GYROS = ("Roll", "Pitch", "Yaw"), ("R", "P", "Y"), ("GyrX", "GyrY", "GyrZ")
DEMANDS = ("ROut", "POut", "YOut", "AOut")
NEEDED = ("ATT", "ANG", "RATE", "RCOU", "CTUN", "XKF1", "XKF4", "NKF1", "EV", "ARM")
"""DataFlash's messages that are translated, beside IMU where :func:`needs_gyros`."""
AS_FAST = 0.9
"""A message counts as slower than another only when it has fewer than this share of the other's number."""
BRIDGED = 3.0
"""Usual steps of a stream over which it is interpolated; a longer one is a gap."""
SERVOS = 16

Values = NDArray[np.float64]


def needs_gyros(counts: Mapping[str, int]) -> bool:
    """Whether the body rates must come from IMU, by the number of messages of each name."""
    angles = max(counts.get("ATT", 0), counts.get("ANG", 0))
    return counts.get("RATE", 0) < AS_FAST * min(angles, counts.get("IMU", 0))


def translated(tables: Mapping[str, Columns], kind: int, autopilot: int) -> dict[str, Columns]:
    """MAVLink's messages by name; one for which nothing was logged is left out.

    Args:
        tables: DataFlash's messages by name, on the boot clock.
        kind, autopilot: the vehicle's MAV_TYPE and MAV_AUTOPILOT, for its HEARTBEATs.
    """
    messages = {
        "ATTITUDE": _attitude(tables),
        "SERVO_OUTPUT_RAW": _servos(tables),
        "ACTUATOR_CONTROL_TARGET": _demands(tables),
        "LOCAL_POSITION_NED": _position(tables),
        "VFR_HUD": _climb(tables),
        "HEARTBEAT": heartbeats(tables, kind, autopilot),
        "EXTENDED_SYS_STATE": landed_states(tables),
    }
    return {name: columns for name, columns in messages.items() if columns is not None and len(columns["time"])}


def _attitude(tables: Mapping[str, Columns]) -> Columns | None:
    """At the stamps of the slower of angles and rates: in between, one of the two would be invented."""
    angles = max((_having(tables, name, ANGLES) for name in ("ATT", "ANG")), key=_count)
    rates, gyros = _having(tables, "RATE", RATES), _instance(_having(tables, "IMU", GYROS), "I", 0)
    if angles is None or (rates is None and gyros is None):
        return None
    turned = np.radians(_values(angles, ANGLES))
    if rates is None or (_count(rates) < AS_FAST * _count(angles) and _count(rates) < _count(gyros)):
        assert gyros is not None
        rates, speeds = gyros, _values(gyros, GYROS)
    else:
        speeds = np.radians(_values(rates, RATES))
    base = rates if _count(rates) < AS_FAST * _count(angles) else angles
    turned, speeds = _onto(base, angles, turned, turning=True), _onto(base, rates, speeds)
    # To one turn about zero, as MAVLink has it.
    turned = np.where(np.abs(turned) > np.pi, np.remainder(turned + np.pi, 2 * np.pi) - np.pi, turned)
    names = ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")
    return _stamped(base, "time_boot_ms", dict(zip(names, np.hstack([turned, speeds]).T, strict=True)))


def _servos(tables: Mapping[str, Columns]) -> Columns | None:
    logged = tables.get("RCOU", {})
    fields = {
        channel: field
        for channel in range(1, SERVOS + 1)
        for field in (f"C{channel}", f"Ch{channel}", f"Chan{channel}")
        if field in logged
    }
    if not fields:
        return None
    none = np.zeros(len(logged["time"]))
    outputs = {
        f"servo{channel}_raw": _pulses(logged[fields[channel]] if channel in fields else none)
        for channel in range(1, SERVOS + 1)
    }
    return _stamped(logged, "time_usec", {"port": none.astype(np.uint8), **outputs})


def _pulses(values: NDArray[Any]) -> NDArray[np.uint16]:
    return np.asarray(np.clip(np.nan_to_num(values), 0, np.iinfo(np.uint16).max).astype(np.uint16))


def _demands(tables: Mapping[str, Columns]) -> Columns | None:
    logged = _having(tables, "RATE", DEMANDS)
    if logged is None:
        return None
    controls = np.zeros((len(logged["time"]), 8))
    controls[:, : len(DEMANDS)] = _values(logged, DEMANDS)
    group = np.zeros(len(controls), dtype=np.uint8)
    return _stamped(logged, "time_usec", {"group_mlx": group, "controls": controls})


def _position(tables: Mapping[str, Columns]) -> Columns | None:
    fields = {"x": "PN", "y": "PE", "z": "PD", "vx": "VN", "vy": "VE", "vz": "VD"}
    chosen = tables.get("XKF4", {}).get("PI", np.zeros(0))
    cores, times = np.unique(chosen[chosen >= 0], return_counts=True)
    primary = float(cores[times.argmax()]) if len(cores) else 0
    for name, core in (("XKF1", primary), ("NKF1", 0)):
        logged = _instance(_having(tables, name, tuple(fields.values())), "C", core)
        if logged is not None:
            return _stamped(logged, "time_boot_ms", {ours: logged[theirs] for ours, theirs in fields.items()})
    return None


def _climb(tables: Mapping[str, Columns]) -> Columns | None:
    logged = _having(tables, "CTUN", ("CRt",))
    return None if logged is None else _stamped(logged, "", {"climb": _values(logged, ("CRt",))[:, 0] / 100})


def _having(tables: Mapping[str, Columns], name: str, fields: tuple[str, ...]) -> Columns | None:
    """The messages of that name; None where there are none, or they lack one of the fields as numbers."""
    columns = tables.get(name, {})
    if not all(field in columns and columns[field].dtype.kind in "iuf" for field in fields):
        return None
    return columns if len(columns["time"]) else None


def _instance(columns: Columns | None, field: str, number: float) -> Columns | None:
    """Those of one instance (sensor, core); all where the messages do not count instances."""
    if columns is None or field not in columns:
        return columns
    rows = columns[field] == number
    return {name: values[rows] for name, values in columns.items()} if rows.any() else None


def _count(columns: Columns | None) -> int:
    return 0 if columns is None else len(columns["time"])


def _values(columns: Columns, fields: tuple[str, ...]) -> Values:
    return np.column_stack([np.asarray(columns[field], dtype=np.float64) for field in fields])


def _stamped(logged: Columns, stamp: str, fields: Mapping[str, NDArray[Any]]) -> Columns:
    """A message's columns at the stamps of what was logged, which ``stamp`` repeats as MAVLink sends it."""
    time = logged["time"]
    if stamp == "time_boot_ms":
        fields = {stamp: (np.rint(time * 1e3) % 2**32).astype(np.uint32), **fields}  # as the counter wraps
    elif stamp:
        fields = {stamp: np.rint(time * 1e6).astype(np.uint64), **fields}
    return {"time": time, "boot": logged["boot"], **fields}


def _onto(base: Columns, source: Columns, values: Values, turning: bool = False) -> Values:
    """Columns of ``values`` (N, k), of ``source``, at the stamps of ``base``; NaN before, after and inside gaps.

    Linear between the neighbours, across a full turn where ``turning``; at a stamp that both have, the very value.
    """
    if base is source:
        return values
    moved = np.full((len(base["time"]), values.shape[1]), np.nan)
    finite = np.asarray(np.isfinite(values).all(axis=1))
    sources = rows_by(source["boot"])
    for boot, here in rows_by(base["boot"]).items():
        there = sources.get(boot, here[:0])
        there = there[finite[there]]
        time, first = np.unique(source["time"][there], return_index=True)
        if not len(time):
            continue
        known = values[there[first]]
        if turning:
            known = np.unwrap(known, axis=0)
        at = base["time"][here]
        before = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 1)
        after = np.clip(np.searchsorted(time, at), 0, len(time) - 1)
        longest = BRIDGED * float(np.median(np.diff(time))) if len(time) > 1 else 0.0
        sure = (time[before] <= at) & (at <= time[after]) & (time[after] - time[before] <= longest)
        table = np.column_stack([np.interp(at, time, column) for column in known.T])
        moved[here] = np.where(sure[:, None], table, np.nan)
    return moved
