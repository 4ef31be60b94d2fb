"""Armed and landed states of an ArduPilot vehicle, from the events in its DataFlash log.

EV's ids are ``LogEvent`` in ArduPilot's ``libraries/AP_Logger/AP_Logger.h``. A log may begin after take-off, so an
event also gives the state before it. Where that is not the state after the event before, one between them was not
logged, and the landed state is undefined, as it is after the last. A boot without events has neither message.

An arming may also be missing before the first event of a log that began disarmed, and then was not written until the
motors were armed. POWR.Safety of newer firmware has a flag of armed motors, at 10 Hz: it adds changes without events.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.ingest.telemetry import Columns, Tables, begins_value, firsts_of_seconds
from mavdem.ingest.vocabulary import (
    ARDUPILOT,
    ARMED,
    IN_AIR,
    ON_GROUND,
    UNDEFINED_LANDED_STATE,
    heartbeat_fields,
)

BootStamps = Callable[[float], Array]
"""Returns the stamps (N,), s, of what was logged in a boot, ascending, each once."""

DISARMED = 0
"""HEARTBEAT.base_mode without the flag of armed motors."""


class StateChange(NamedTuple):
    """The states before and after an event."""

    before: int
    after: int


ARMED_EVENTS = {
    # ARMED, AUTO_ARMED and DISARMED.
    10: StateChange(DISARMED, ARMED),
    15: StateChange(ARMED, ARMED),
    11: StateChange(ARMED, DISARMED),
}
"""HEARTBEAT.base_mode before and after events, by EV.Id."""

ARMING_EVENTS = [event for event, change in ARMED_EVENTS.items() if change.after == ARMED]
"""Ids of the events after which the vehicle is armed."""

LANDED_EVENTS = {
    # NOT_LANDED and LAND_COMPLETE.
    28: StateChange(ON_GROUND, IN_AIR),
    18: StateChange(IN_AIR, ON_GROUND),
}
"""EXTENDED_SYS_STATE.landed_state before and after events, by EV.Id."""

ARMED_SAFETY_FLAG = 4
"""Flag of armed motors in POWR.Safety (``Write_Power`` in ArduPilot's ``libraries/AP_Logger/LogFile.cpp``)."""

MAX_FLAG_LEAD = 0.5
"""Time, s, by which the flag in POWR may change before the event is logged: both are written within one slow loop."""

ARM_STATES = {0: StateChange(ARMED, DISARMED), 1: StateChange(DISARMED, ARMED)}
"""HEARTBEAT.base_mode before and after a message ARM, by its ArmState."""


class _DatedChange(NamedTuple):
    """One change of a state, at a time of a boot, s; ``_StateChanges`` has its fields as columns."""

    boot: int
    time: float
    before: int
    after: int


@dataclass(frozen=True)
class _StateChanges:
    """Changes of one state, by boot and time; all arrays have shape (N,).

    Each boot with changes begins with one that changes nothing, at its first message.
    """

    boot: Array
    """Number of the boot."""
    time: Array
    """Time since boot, s."""
    before: Array
    """State before the change."""
    after: Array
    """State after it."""

    def __len__(self) -> int:
        return len(self.boot)

    def of_boot(self, boot: int) -> "_StateChanges":
        """Returns the changes in one boot."""
        is_of_boot = self.boot == boot
        return _StateChanges(
            self.boot[is_of_boot],
            self.time[is_of_boot],
            self.before[is_of_boot],
            self.after[is_of_boot],
        )


class _ArmedFlags(NamedTuple):
    """The flag of armed motors that the messages POWR of one boot have."""

    time: Array
    """Times (M,) of the messages, s since boot."""

    state: Array
    """The armed state (M,): ``ARMED`` or ``DISARMED``."""


class StateMessages(NamedTuple):
    """Messages of MAVLink with the states of the vehicle, made of the events of a log."""

    heartbeat: Columns
    """HEARTBEAT, with the armed state."""

    extended_sys_state: Columns
    """EXTENDED_SYS_STATE, with the landed state."""


def states_of(tables: Tables, vehicle_type: int) -> StateMessages:
    """Makes HEARTBEAT and EXTENDED_SYS_STATE from the events of a log.

    Armings are reported by EV and, in newer firmware, by ARM: of these the message with more changes is read. Changes
    that it lacks are added from the flag of armed motors in POWR.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
        vehicle_type: MAV_TYPE, for HEARTBEAT.

    Returns:
        Columns of HEARTBEAT and of EXTENDED_SYS_STATE; without rows where there are no events.
    """
    # Cached, since all states need the stamps of each boot, and collecting them takes a pass over all messages.
    boot_stamps = cache(partial(_boot_stamps, tables))
    changes_by_events = _state_changes(tables, "EV", "Id", ARMED_EVENTS, boot_stamps)
    changes_by_arm_messages = _state_changes(tables, "ARM", "ArmState", ARM_STATES, boot_stamps)
    armed_changes = changes_by_events
    if len(changes_by_arm_messages) > len(changes_by_events):
        armed_changes = changes_by_arm_messages
    armed_changes = _with_changes_of_power_flags(armed_changes, tables)
    landed_changes = _state_changes(tables, "EV", "Id", LANDED_EVENTS, boot_stamps)
    return StateMessages(
        _heartbeats_of_changes(armed_changes, vehicle_type, boot_stamps),
        _landed_states(landed_changes, boot_stamps),
    )


def _state_changes(
    tables: Tables,
    message: str,
    field: str,
    changes_by_value: Mapping[int, StateChange],
    boot_stamps: BootStamps,
) -> _StateChanges:
    """Collects the changes of a state, such as the armed state, from the events of a log.

    The state before the first event of a boot follows from that event: a disarming shows that the vehicle was armed. So
    each boot with an event gets another entry at its first message, which has this state before and after it.

    Args:
        tables: Columns of DataFlash's messages, by the name of the message ("ATT").
        message: Name of the message with the events ("EV").
        field: Its field with the number of the event ("Id").
        changes_by_value: State before and after each event, by its number; other events are left out.
        boot_stamps: Function that returns the stamps of all messages of a boot, s, ascending.

    Returns:
        The changes in the order of boot and time.
    """
    logged_columns = tables.get(message, {})
    if field not in logged_columns:
        return _sorted_changes([])
    changes: list[_DatedChange] = []
    # Boots whose state at the beginning has an entry already.
    boots_with_initial_state = set()
    events = zip(
        logged_columns["boot"].tolist(),
        logged_columns["time"].tolist(),
        logged_columns[field].tolist(),
        strict=True,
    )
    for boot, time, event in events:
        change = changes_by_value.get(event)
        if change is None:
            continue
        if boot not in boots_with_initial_state:
            boots_with_initial_state.add(boot)
            boot_start = float(boot_stamps(boot)[0])
            changes.append(_DatedChange(boot, boot_start, change.before, change.before))
        changes.append(_DatedChange(boot, time, change.before, change.after))
    return _sorted_changes(changes)


def _sorted_changes(changes: list[_DatedChange]) -> _StateChanges:
    """Arranges changes by boot and time, as columns; changes of the same time keep their order."""
    changes.sort(key=attrgetter("boot", "time"))
    # An array with a row per change, turned into one column per field.
    columns = np.array(changes, np.float64).reshape(-1, len(_DatedChange._fields)).T
    return _StateChanges(*columns)


def _with_changes_of_power_flags(event_changes: _StateChanges, tables: Tables) -> _StateChanges:
    """Adds the armings and disarmings that no event reports, by the flag of armed motors in POWR.

    A log that is written only while the motors are armed may lack the event of the arming itself. The message POWR is
    logged regularly, and its field Safety has a flag (one bit) that is set while the motors are armed.

    Args:
        event_changes: Armings and disarmings (N,) by the messages EV or ARM, each with the time of its message.
        tables: Columns of DataFlash's messages, by the name of the message ("POWR").

    Returns:
        The changes in the order of boot and time, in the boots that have events. If POWR has no flag, or one that is
        never set, as in older firmware, these are the events alone.
    """
    power = tables.get("POWR", {})
    if "Safety" not in power:
        return event_changes
    has_armed_flag = (power["Safety"].astype(np.int64) & ARMED_SAFETY_FLAG) != 0
    if not np.any(has_armed_flag):
        return event_changes
    armed_state = np.where(has_armed_flag, ARMED, DISARMED)
    changes: list[_DatedChange] = []
    for boot in np.unique(event_changes.boot).astype(int).tolist():
        is_of_boot = power["boot"] == boot
        flags = _ArmedFlags(power["time"][is_of_boot], armed_state[is_of_boot])
        events = event_changes.of_boot(boot)
        changes += _event_changes_of_boot(boot, events, flags)
        changes += _flag_changes_without_event(boot, events, flags)
    return _sorted_changes(changes)


def _event_changes_of_boot(
    boot: int, events: _StateChanges, flags: _ArmedFlags
) -> list[_DatedChange]:
    """Lists the changes of the armed state that the events of one boot report, with the state at its beginning.

    The first entry is no event, but has the state at the beginning of the boot. It was inferred from the first event:
    before an arming the motors were disarmed. Where POWR was logged before that event, its flag replaces this state,
    since the flag is measured, and earlier events may be missing.

    Args:
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.
        events: The state at the beginning, and the change by each event of the boot; N entries, at least two.
        flags: States by the flag of armed motors in the messages POWR (M,) of the boot; may be empty.

    Returns:
        The N entries.
    """
    changes = [
        _DatedChange(boot, time, before, after)
        for time, before, after in zip(events.time, events.before, events.after, strict=True)
    ]
    first_event_time = events.time[1]
    if len(flags.time) and flags.time[0] < first_event_time:
        first_flag = flags.state[0]
        changes[0] = _DatedChange(boot, events.time[0], before=first_flag, after=first_flag)
    return changes


def _flag_changes_without_event(
    boot: int, events: _StateChanges, flags: _ArmedFlags
) -> list[_DatedChange]:
    """Lists the changes of the armed flag in one boot that no event reports.

    An event reports a change of the flag if it leads from the same state to the same state, and lies between the
    message before the change and the message after it, or up to ``MAX_FLAG_LEAD`` earlier.

    Args:
        boot: Number of the boot.
        events: Changes (N,) by the events of the boot.
        flags: Armed flags (M,) of the boot.

    Returns:
        The changes, dated to the first message with the new state.
    """
    changes = []
    changed_rows = 1 + np.flatnonzero(np.diff(flags.state))
    for row in changed_rows.tolist():
        state_before = flags.state[row - 1]
        state_after = flags.state[row]
        earliest_report = flags.time[row - 1] - MAX_FLAG_LEAD
        is_near = (events.time >= earliest_report) & (events.time <= flags.time[row])
        has_same_states = (events.before == state_before) & (events.after == state_after)
        if not np.any(is_near & has_same_states):
            changes.append(_DatedChange(boot, flags.time[row], state_before, state_after))
    return changes


def _heartbeats_of_changes(
    changes: _StateChanges, vehicle_type: int, boot_stamps: BootStamps
) -> Columns:
    """Converts the changes of the armed state to a table of HEARTBEATs, five for each change.

    The first row has the state after the previous change, the next two the state before this change, the last two the
    state after it. States come twice because readers of HEARTBEAT ignore a single differing row as damage.

    If the state after the previous change is not the one before this change, a change between them was not logged. It
    is dated to the last message before this change: the first three rows get the time of that message. For example,
    after a disarming at 100 s the log begins again at 300 s, and has a disarming at 400 s, 0.1 s after the message
    before: then the states are disarmed, armed and armed at 399.9 s, and disarmed twice at 400 s.

    Args:
        changes: The changes (K,) of the armed state (base_mode), in the order of boot and time.
        vehicle_type: MAV_TYPE.
        boot_stamps: Function that returns the stamps of all messages of a boot, s, ascending.

    Returns:
        Columns (5 K,) of HEARTBEAT.
    """
    # The first change of a boot has no previous change, and the state before it is used.
    is_first_of_boot = np.diff(changes.boot, prepend=-1) > 0
    previous_state = np.where(is_first_of_boot, changes.before, np.roll(changes.after, 1))
    time_before = changes.time.copy()
    follows_missing_change = previous_state != changes.before
    for boot in np.unique(changes.boot[follows_missing_change]):
        stamps = boot_stamps(boot)
        is_selected = follows_missing_change & (changes.boot == boot)
        # The last message before each of these changes, or the first one of the boot if there is none before.
        last_stamp_rows = np.maximum(np.searchsorted(stamps, changes.time[is_selected]) - 1, 0)
        time_before[is_selected] = stamps[last_stamp_rows]
    states = np.column_stack(
        [previous_state, changes.before, changes.before, changes.after, changes.after]
    )
    times = np.column_stack([time_before, time_before, time_before, changes.time, changes.time])
    rows_per_change = states.shape[1]
    fields = heartbeat_fields(vehicle_type, ARDUPILOT, states.ravel())
    boot_of_rows = np.repeat(changes.boot, rows_per_change).astype(np.int64)
    return {"time": times.ravel(), "boot": boot_of_rows, **fields}


def _boot_stamps(tables: Tables, boot: float) -> Array:
    """Returns the stamps of all messages of a boot except texts, ascending, each once.

    They show when logging was active. A text (MSG) does not: ArduPilot stamps it when it is sent, and may log it later.

    Args:
        tables: DataFlash's messages by name, with ``time`` and ``boot``.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The stamps (N,), s.
    """
    stamps_of_messages = []
    for name, columns in tables.items():
        if name != "MSG":
            is_of_boot = columns["boot"] == boot
            stamps_of_messages.append(columns["time"][is_of_boot])
    # NumPy's stable sort is fastest here: the stamps of each message are in order already.
    stamps = np.sort(np.concatenate(stamps_of_messages), kind="stable")
    return stamps[begins_value(stamps)]


CONTRADICTION_SECONDS = 1.0
"""Time, s, before an event from which on the state before it holds, where it contradicts the event before."""


def _landed_states(changes: _StateChanges, boot_stamps: BootStamps) -> Columns:
    """Turns take-off and landing events into a table of EXTENDED_SYS_STATE, as a vehicle would have sent it.

    A boot with C changes gets a row at each change, and at the first logged message of each second. Rows lie at logged
    messages and not on a grid of seconds, because a damaged clock may jump by a year. A row has the state
    after the last change before it, unless this is unsure. There are two such cases:

    - Two successive changes contradict each other: the second begins with another state than the first led to, so an
      event between them was not logged. The state between them is undefined, except in the last
      ``CONTRADICTION_SECONDS`` before the second change, when it is the state that this change begins with.
    - After the last change it is undefined, since a later event may not have been logged.

    Args:
        changes: The changes of landed_state, in the order of boot and time; the first of each boot changes nothing and
            dates the first state.
        boot_stamps: Function that returns the stamps of a boot.

    Returns:
        Columns (N,) of EXTENDED_SYS_STATE.
    """
    times = [np.zeros(0)]
    boots = [np.zeros(0)]
    states = [np.zeros(0)]
    for boot in np.unique(changes.boot):
        is_of_boot = changes.boot == boot
        change_time = changes.time[is_of_boot]
        states_before = changes.before[is_of_boot]
        states_after = changes.after[is_of_boot]
        stamps = boot_stamps(boot)
        time = np.union1d(firsts_of_seconds(stamps), change_time)
        # Each row has the number of changes up to its time, 0 to C. The arrays of C + 1 elements that are made below
        # have one element for each of these numbers; indexing them by ``passed_changes`` gives the value of each row.
        passed_changes = np.searchsorted(change_time, time, side="right")
        state = np.append(states_before[0], states_after)[passed_changes]
        contradicts_next = states_after[:-1] != states_before[1:]
        # Before the first change the state is sure, and after the last one it is not.
        is_uncertain = np.concatenate([[False], contradicts_next, [True]])[passed_changes]
        next_change_time = np.append(change_time, np.inf)[passed_changes]
        state_before_next = np.append(states_before, UNDEFINED_LANDED_STATE)[passed_changes]
        is_next_soon = next_change_time <= time + CONTRADICTION_SECONDS
        uncertain_state = np.where(is_next_soon, state_before_next, UNDEFINED_LANDED_STATE)
        # At the time of a change itself the state after it is certain.
        is_change = np.isin(time, change_time)
        states.append(np.where(is_uncertain & ~is_change, uncertain_state, state))
        times.append(time)
        boots.append(np.full(len(time), boot))
    return {
        "time": np.concatenate(times),
        "boot": np.concatenate(boots).astype(np.int64),
        "landed_state": np.concatenate(states).astype(np.uint8),
    }
