"""Armed and in the air, once a second as MAVLink tells it, out of the events that a DataFlash log has of their changes.

EV's ids are ``LogEvent`` in ArduPilot's ``libraries/AP_Logger/AP_Logger.h``. A log may begin after take-off: an event
also tells what was so before it. A boot without events has no messages: nobody said.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.meaning import ARMED
from mavdem.ingest.rows import rows_by
from mavdem.telemetry import Columns

ON_GROUND, IN_AIR = 1, 2
"""MAV_LANDED_STATE."""
ARMED_EVENTS = {10: (0, ARMED), 15: (ARMED, ARMED), 11: (ARMED, 0)}
"""base_mode before and after ARMED, AUTO_ARMED and DISARMED."""
LANDED_EVENTS = {28: (ON_GROUND, IN_AIR), 18: (IN_AIR, ON_GROUND)}
"""landed_state before and after NOT_LANDED and LAND_COMPLETE."""
ARM_STATES = {0: (ARMED, 0), 1: (0, ARMED)}
"""base_mode before and after ARM with this ArmState."""

Changes = NDArray[np.float64]
"""Boot, time, state before and state after, (N, 4)."""


def heartbeats(tables: Mapping[str, Columns], kind: int, autopilot: int) -> Columns:
    """HEARTBEATs of a vehicle of MAV_TYPE ``kind``; of ``base_mode`` the armed flag only.

    Args:
        tables: DataFlash's messages by name, on the boot clock.
        kind, autopilot: the vehicle's MAV_TYPE and MAV_AUTOPILOT.
    """
    changes = [_changes(tables, "EV", "Id", ARMED_EVENTS), _changes(tables, "ARM", "ArmState", ARM_STATES)]
    time, boot, state = _each_second(tables, np.concatenate(changes))
    same = {"type": kind, "autopilot": autopilot}
    constant = {name: np.full(len(time), value, dtype=np.uint8) for name, value in same.items()}
    return {"time": time, "boot": boot, **constant, "base_mode": state}


def landed_states(tables: Mapping[str, Columns]) -> Columns:
    """EXTENDED_SYS_STATE, from the same ``tables``: on the ground or in the air, no take-off or landing between."""
    time, boot, state = _each_second(tables, _changes(tables, "EV", "Id", LANDED_EVENTS))
    return {"time": time, "boot": boot, "vtol_state": np.zeros_like(state), "landed_state": state}


def _changes(tables: Mapping[str, Columns], name: str, field: str, meant: Mapping[int, tuple[int, int]]) -> Changes:
    logged = tables.get(name, {})
    if field not in logged:
        return np.zeros((0, 4))
    rows = zip(logged["boot"].tolist(), logged["time"].tolist(), logged[field].tolist(), strict=True)
    return np.array([(boot, time, *meant[value]) for boot, time, value in rows if value in meant]).reshape(-1, 4)


def _each_second(
    tables: Mapping[str, Columns], changes: Changes
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.uint8]]:
    """Time, boot and state at each change and at the first message of each second of a boot that has changes.

    At messages, because between two of them the clock may jump a year.
    """
    told = [np.zeros((0, 3))]
    times = np.concatenate([np.zeros(0), *(columns["time"] for columns in tables.values())])
    boots = np.concatenate([np.zeros(0, dtype=np.int64), *(columns["boot"] for columns in tables.values())])
    there = rows_by(boots) if len(changes) else {}
    for boot, rows in rows_by(changes[:, 0].astype(np.int64)).items():
        own = changes[rows]
        own = own[np.argsort(own[:, 1], kind="stable")]
        logged = np.unique(times[there[boot]])
        _, first = np.unique(np.floor(logged), return_index=True)
        time = np.union1d(logged[first], own[:, 1])
        last = np.searchsorted(own[:, 1], time, side="right") - 1
        state = np.where(last < 0, own[0, 2], own[np.maximum(last, 0), 3])
        told.append(np.column_stack([np.full(len(time), boot), time, state]))
    table = np.concatenate(told)
    return table[:, 1], table[:, 0].astype(np.int64), table[:, 2].astype(np.uint8)
