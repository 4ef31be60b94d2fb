"""States of the vehicle, armed and landed, from DataFlash's events.

EV's ids are ``LogEvent`` in ArduPilot's ``libraries/AP_Logger/AP_Logger.h``. A log may begin after take-off, so an
event also gives the state before it. Where that is not the state after the event before, one between them was not
logged, and the landed state is undefined, as it is after the last. A boot without events has neither message.
"""

from collections.abc import Callable, Mapping
from functools import cache, partial
from operator import itemgetter

import numpy as np

from mavdem.arrays import Array
from mavdem.ingest.telemetry import Columns, Tables
from mavdem.ingest.vocabulary import ARDUPILOT, ARMED, IN_AIR, ON_GROUND, heartbeat_fields

Stamps = Callable[[float], Array]
"""(N,) of all that was logged in a boot, ascending, each once."""
ARMED_EVENTS = {10: (0, ARMED), 15: (ARMED, ARMED), 11: (ARMED, 0)}
"""base_mode before and after ARMED, AUTO_ARMED and DISARMED."""
# those after which it is armed
ARMING = [event for event, (_, after) in ARMED_EVENTS.items() if after]
LANDED_EVENTS = {28: (ON_GROUND, IN_AIR), 18: (IN_AIR, ON_GROUND)}
"""landed_state before and after NOT_LANDED and LAND_COMPLETE."""
ARM_STATES = {0: (ARMED, 0), 1: (0, ARMED)}  # base_mode before and after ARM with this ArmState


def states_of(tables: Tables, kind: int) -> tuple[Columns, Columns]:
    """Returns HEARTBEAT and EXTENDED_SYS_STATE of the events in DataFlash's ``tables``; ``kind`` is the MAV_TYPE."""
    stamps = cache(partial(_stamps, tables))
    changes = [
        _changes(tables, "EV", "Id", ARMED_EVENTS, stamps),
        _changes(tables, "ARM", "ArmState", ARM_STATES, stamps),
    ]
    landed = _changes(tables, "EV", "Id", LANDED_EVENTS, stamps)
    return _armed(max(changes, key=len), kind, stamps), _landed(landed, stamps)


def _changes(
    tables: Tables, name: str, field: str, states: Mapping[int, tuple[int, int]], stamps: Stamps
) -> Array:
    """Boot, time, state before and state after (N, 4) each event, and the beginning of each boot that has some."""
    logged = tables.get(name, {})
    if field not in logged:
        return np.zeros((0, 4))
    rows = zip(*(logged[name].tolist() for name in ("boot", "time", field)), strict=True)
    changes = [(boot, time, *states[value]) for boot, time, value in rows if value in states]
    for boot, before in {boot: before for boot, _, before, _ in reversed(changes)}.items():
        changes.insert(0, (boot, float(stamps(boot)[0]), before, before))
    return np.array(sorted(changes, key=itemgetter(0, 1))).reshape(-1, 4)


def _armed(changes: Array, kind: int, stamps: Stamps) -> Columns:
    """HEARTBEAT at each change: what it was till then, and twice what the change says that it was and what it became.

    Twice, for a single row would be taken for damage. What it was is another than after the change before where a
    change between was not logged, at the latest when the log stopped before this one.
    """
    boot, time, before, after = changes.T
    till_then = np.where(np.diff(boot, prepend=-1) > 0, before, np.roll(after, 1))
    since = time.copy()
    unlogged = till_then != before
    for number in np.unique(boot[unlogged]):
        times = stamps(number)
        rows = unlogged & (boot == number)
        since[rows] = times[np.maximum(np.searchsorted(times, time[rows]) - 1, 0)]
    states = np.column_stack([till_then, before, before, after, after])
    times = np.column_stack([since, since, since, time, time])
    fields = heartbeat_fields(kind, ARDUPILOT, states.ravel())
    return {"time": times.ravel(), "boot": np.repeat(boot, 5).astype(np.int64), **fields}


def _stamps(tables: Tables, boot: float) -> Array:
    stamps = [columns["time"][columns["boot"] == boot] for columns in tables.values()]
    return np.unique(np.concatenate(stamps))


def _landed(changes: Array, stamps: Stamps) -> Columns:
    """EXTENDED_SYS_STATE at each change and at the first message of each second of a boot that has changes.

    At messages, because between two of them the clock may jump a year. The state is 0 between changes that contradict
    each other, up to a second before the second, and after the last.
    """
    parts = [np.zeros((0, 3))]
    for boot in np.unique(changes[:, 0]):
        at, before, after = changes[changes[:, 0] == boot, 1:].T
        times = stamps(boot)
        _, first = np.unique(np.floor(times), return_index=True)
        time = np.union1d(times[first], at)
        passed = np.searchsorted(at, time, side="right")
        state = np.append(before[0], after)[passed]
        unsure = np.concatenate([[False], after[:-1] != before[1:], [True]])[passed]
        soon = np.append(at, np.inf)[passed] <= time + 1.0
        until_next = np.where(soon, np.append(before, 0)[passed], 0)
        state = np.where(unsure & ~np.isin(time, at), until_next, state)
        parts.append(np.column_stack([time, np.full(len(time), boot), state]))
    time, boots, states = np.concatenate(parts).T
    return {
        "time": time,
        "boot": boots.astype(np.int64),
        "landed_state": states.astype(np.uint8),
    }
