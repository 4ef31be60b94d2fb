"""Joining logs of one flight that the autopilot wrote one after the other.

An autopilot that restarts in flight (watchdog, brown-out) begins a new file, and so does a logger that begins anew
while the autopilot runs on. Two files are of one flight where they are of one vehicle, the first ends armed, and the
second begins shortly thereafter by UTC: that of the recorder of a stream, else that of the autopilot. Without UTC the
vehicle must also be armed as soon as the second begins.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan

import numpy as np

from mavdem.arrays import Array
from mavdem.errors import Unreadable
from mavdem.facts.sources import Repair, Separation, SourceFact
from mavdem.ingest.telemetry import (
    Columns,
    Component,
    Log,
    Parameters,
    Tables,
    Telemetry,
    concatenated_columns,
    repair_facts,
    selected_rows,
)
from mavdem.ingest.utc import utc_at_boot
from mavdem.ingest.vocabulary import ARMED

MAX_RESTART_SECONDS = 60.0
"""Longest time, s, between the end of a file and the beginning of the next one of the same flight.

A choice: an autopilot logs again some seconds after a restart, and nobody changes a battery so soon.
"""

MAX_CLOCK_ERROR = 2.0
"""Largest error, s, of a difference of two times by UTC.

A choice: GPS time is logged up to some tenths of a second late, and flights last longer than this.
"""

MAX_BOOT_CLOCK = 30.0
"""Time, s, that the boot clock reads at most at the beginning of a log that a restart in the air began.

A choice: an autopilot logs within some seconds of its start, and nobody takes off so soon.
"""

MAX_ARMING_DELAY = 3.0
"""Time, s, from the beginning of a log within which an autopilot is armed again that restarted in the air.

A choice: one that arms again after a reset by its watchdog does so as soon as it has started; a pilot takes longer.
"""

MIN_COMMON_PARAMETERS = 50
"""Number of parameters from which on they show whether two logs are of one vehicle: a choice, far below all."""

MAX_CHANGED_PARAMETERS = 0.15
"""Largest fraction of the parameters that differ between the end of a log and the beginning of the next.

A choice: of logs of one board on different days at most 7 % differ, such as calibrations and counters.
"""


@dataclass(frozen=True)
class Recording:
    """The one vehicle of a log, with the times at which its record begins and ends."""

    log: Log
    """The log."""
    vehicle: Telemetry
    """Its only vehicle."""
    first_boot: int
    """Number of the boot in which the record begins."""
    last_boot: int
    """Number of the boot in which it ends."""
    start: float
    """Beginning on the clock of the first boot, s."""
    end: float
    """End on the clock of the last boot, s."""
    utc_at_first_boot: float | None
    """UNIX time at which the clock of the first boot read 0, s; None where it is not known."""
    utc_at_last_boot: float | None
    """UNIX time at which the clock of the last boot read 0, s; None where it is not known."""

    @property
    def utc_start(self) -> float:
        """UNIX time of the beginning, s; NaN where it is not known."""
        return nan if self.utc_at_first_boot is None else self.utc_at_first_boot + self.start


def join_logs(logs: Sequence[Log]) -> Log:
    """Joins logs of one flight to one log, in which the boots of later logs follow the boots of earlier ones.

    Args:
        logs: At least one log. They may be in any order where all have UTC; without it they must be in order of time.

    Returns:
        The log, under the name of the earliest one; a single log is returned as it is.

    Raises:
        Unreadable: The logs are not of one flight, or nothing shows that they are.
    """
    if len(logs) == 1:
        return logs[0]
    recordings = _recordings_by_time([_recording_of_log(log) for log in logs])
    joined_recording = recordings[0]
    for recording in recordings[1:]:
        joined_recording = _recording_of_log(_joined_pair(joined_recording, recording))
    return joined_recording.log


def _recording_of_log(log: Log) -> Recording:
    """Describes a log of one vehicle by its first and last boot.

    Args:
        log: The log of a flight, with the messages of each vehicle.

    Returns:
        The vehicle, with the boots, their times and dates.

    Raises:
        Unreadable: The log does not have exactly one vehicle.
    """
    if len(log.vehicles) != 1:
        raise Unreadable(
            SourceFact.LOGS_NOT_JOINED,
            path=log.source,
            reason=Separation.NOT_ONE_VEHICLE,
            count=len(log.vehicles),
        )
    (vehicle,) = log.vehicles
    boots: set[int] = set()
    for columns in vehicle.messages.values():
        boots.update(np.unique(columns["boot"]).tolist())
    first_boot, last_boot = min(boots), max(boots)
    start = float(_stamps_of_most_frequent_message(vehicle.messages, first_boot)[0])
    end = float(_stamps_of_most_frequent_message(vehicle.messages, last_boot)[-1])
    if np.isfinite(log.receive_time).all():
        # Reception times are by the clock of the computer that recorded all logs, and need no UTC of the autopilot.
        first_reception, last_reception = log.receive_time
        utc_at_first_boot: float | None = first_reception - start
        utc_at_last_boot: float | None = last_reception - end
    else:
        utc_at_first_boot = utc_at_boot(vehicle.messages, first_boot)
        utc_at_last_boot = utc_at_boot(vehicle.messages, last_boot)
    return Recording(
        log=log,
        vehicle=vehicle,
        first_boot=first_boot,
        last_boot=last_boot,
        start=start,
        end=end,
        utc_at_first_boot=utc_at_first_boot,
        utc_at_last_boot=utc_at_last_boot,
    )


def _stamps_of_most_frequent_message(messages: Tables, boot: int) -> Array:
    """Returns the stamps of the most frequent message of a boot, which show when the boot's record begins and ends.

    The stamps of rare messages may be older than the file: PX4 logs their last values at its beginning.

    Args:
        messages: Columns by message, with ``time`` and ``boot``.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The stamps (N,), s.
    """
    most_stamps = np.zeros(0)
    for columns in messages.values():
        is_of_boot = columns["boot"] == boot
        stamps = columns["time"][is_of_boot]
        if len(stamps) > len(most_stamps):
            most_stamps = stamps
    return most_stamps


def _recordings_by_time(recordings: Sequence[Recording]) -> list[Recording]:
    """Returns the recordings by their beginning in UTC, or as they are given where one of them has no UTC."""
    starts = [recording.utc_start for recording in recordings]
    if np.isnan(starts).any():
        return list(recordings)
    return sorted(recordings, key=lambda recording: recording.utc_start)


def _joined_pair(earlier: Recording, later: Recording) -> Log:
    """Joins two logs of one flight, and adds a fact to the vehicle that reports the joining.

    Args:
        earlier, later: The recordings in the order of time.

    Returns:
        One log with one vehicle.

    Raises:
        Unreadable: The logs are not of one flight.
    """
    gap = _gap_by_utc(earlier, later)
    reason_against_joining = _separation_of_vehicles(earlier.vehicle, later.vehicle)
    if reason_against_joining is None:
        reason_against_joining = _separation_in_time(earlier, later, gap)
    if reason_against_joining is not None:
        raise Unreadable(
            SourceFact.LOGS_NOT_JOINED,
            path=earlier.log.source,
            other=later.log.source,
            reason=reason_against_joining,
            duration=gap,
        )
    has_restarted = not _clock_runs_on(earlier, later)
    vehicle = _joined_vehicle(earlier, later, has_restarted=has_restarted)
    repair = repair_facts(
        Repair.LOGS_JOINED,
        path=later.log.source,
        restarted=has_restarted,
        duration=None if gap is None else max(gap, 0.0),
    )
    return _joined_log(earlier.log, later.log, replace(vehicle, repairs=vehicle.repairs + repair))


def _separation_of_vehicles(earlier: Telemetry, later: Telemetry) -> Separation | None:
    """Returns the first reason why two logs cannot be of the same vehicle.

    The MAVLink ids, the format and the kind of autopilot must agree, firmware and board if both logs have them,
    and most parameters.

    Args:
        earlier, later: The vehicle as each log describes it, in the order of time.

    Returns:
        The reason; None if both may be of one vehicle.
    """
    if (earlier.system, earlier.component) != (later.system, later.component):
        return Separation.OTHER_SYSTEM
    if earlier.translated_from != later.translated_from:
        return Separation.OTHER_FORMAT
    if earlier.autopilot != later.autopilot:
        return Separation.OTHER_FIRMWARE
    if earlier.firmware and later.firmware and earlier.firmware != later.firmware:
        return Separation.OTHER_FIRMWARE
    if earlier.board and later.board and earlier.board != later.board:
        return Separation.OTHER_BOARD
    if _changed_parameters(earlier, later) > MAX_CHANGED_PARAMETERS:
        return Separation.OTHER_PARAMETERS
    return None


def _changed_parameters(earlier: Telemetry, later: Telemetry) -> float:
    """Returns the fraction of parameters that differ between the end of a log and the beginning of the next.

    Args:
        earlier, later: The vehicle by the two logs, in the order of time.

    Returns:
        The fraction of those that both logs have; 0 where these are fewer than ``MIN_COMMON_PARAMETERS``.
    """
    values_before = earlier.parameters
    values_after = {**later.parameters, **later.initial_parameters}
    common_names = values_before.keys() & values_after.keys()
    if len(common_names) < MIN_COMMON_PARAMETERS:
        return 0.0
    changed_count = sum(values_before[name] != values_after[name] for name in common_names)
    return changed_count / len(common_names)


def _separation_in_time(
    earlier: Recording, later: Recording, gap: float | None
) -> Separation | None:
    """Returns the reason why two logs of a vehicle are not of one flight.

    The vehicle must be armed at the end of the first log, and the second must follow it within the time of a restart.
    Without UTC, only the logs themselves can show this (:func:`_is_same_flight`).

    Args:
        earlier, later: The recordings in the order of time.
        gap: Time by UTC between them, s; negative if they overlap, None if it is not known.

    Returns:
        The reason; None if both may be of one flight.
    """
    armed_flags = _heartbeats(earlier.vehicle, earlier.last_boot)["base_mode"] & ARMED
    if len(armed_flags) and not armed_flags[-1]:
        return Separation.DISARMED
    if gap is None:
        return None if _is_same_flight(earlier, later) else Separation.TIME_UNKNOWN
    if gap < -MAX_CLOCK_ERROR:
        return Separation.SAME_TIME
    if gap > MAX_RESTART_SECONDS:
        return Separation.OTHER_TIME
    return None


def _gap_by_utc(earlier: Recording, later: Recording) -> float | None:
    """Returns the time by UTC from the end of a log to the beginning of the next, s; None if it is not known."""
    if earlier.utc_at_last_boot is None or later.utc_at_first_boot is None:
        return None
    return (later.utc_at_first_boot + later.start) - (earlier.utc_at_last_boot + earlier.end)


def _clock_runs_on(earlier: Recording, later: Recording) -> bool:
    """Returns whether the boot clock of a log continues in the next: the autopilot did not restart between them."""
    if earlier.utc_at_last_boot is not None and later.utc_at_first_boot is not None:
        return abs(later.utc_at_first_boot - earlier.utc_at_last_boot) <= MAX_CLOCK_ERROR
    return 0.0 <= later.start - earlier.end <= MAX_RESTART_SECONDS


def _is_same_flight(earlier: Recording, later: Recording) -> bool:
    """Returns whether two logs without UTC show by themselves that they are of one flight.

    The vehicle must be armed at the end of the first log and soon after the beginning of the second. In addition the
    clock of the second log must continue the clock of the first, or begin so near zero that there was no time to arm
    the vehicle on the ground: the autopilot restarted in flight.

    Args:
        earlier, later: The recordings in the order of time.
    """
    last_heartbeats = _heartbeats(earlier.vehicle, earlier.last_boot)
    is_armed_before = (last_heartbeats["base_mode"] & ARMED) != 0
    if not len(is_armed_before) or not is_armed_before[-1]:
        return False
    first_heartbeats = _heartbeats(later.vehicle, later.first_boot)
    is_armed_after = (first_heartbeats["base_mode"] & ARMED) != 0
    is_at_beginning = first_heartbeats["time"] <= later.start + MAX_ARMING_DELAY
    if not np.any(is_armed_after & is_at_beginning):
        return False
    has_just_booted = later.start <= MAX_BOOT_CLOCK
    return has_just_booted or _clock_runs_on(earlier, later)


def _heartbeats(vehicle: Telemetry, boot: int) -> Columns:
    """Returns ``time`` and ``base_mode`` (N,) of the HEARTBEATs of a boot; N is 0 where there are none."""
    columns = vehicle.messages.get("HEARTBEAT", {})
    if "base_mode" not in columns:
        return {"time": np.zeros(0), "base_mode": np.zeros(0, np.uint8)}
    return selected_rows(columns, columns["boot"] == boot)


def _joined_vehicle(earlier: Recording, later: Recording, *, has_restarted: bool) -> Telemetry:
    """Joins what two logs contain of one vehicle: messages, parameters and identity.

    Args:
        earlier, later: The recordings in the order of time.
        has_restarted: Whether the autopilot restarted between them, so that the later one begins with another boot.

    Returns:
        The vehicle, without a fact that reports the joining. Parameters that differ have the later log's values;
        identity, such as the firmware, is the earlier log's where it has one.
    """
    earlier_vehicle, later_vehicle = earlier.vehicle, later.vehicle
    new_repairs = tuple(
        fact for fact in later_vehicle.repairs if fact not in earlier_vehicle.repairs
    )
    is_type_unknown = earlier_vehicle.vehicle == "UNKNOWN"
    return replace(
        earlier_vehicle,
        vehicle=later_vehicle.vehicle if is_type_unknown else earlier_vehicle.vehicle,
        messages=_joined_messages(earlier, later, has_restarted=has_restarted),
        parameters={**earlier_vehicle.parameters, **later_vehicle.parameters},
        initial_parameters=_initial_parameters(earlier_vehicle, later_vehicle),
        repairs=earlier_vehicle.repairs + new_repairs,
        firmware=earlier_vehicle.firmware or later_vehicle.firmware,
        board=earlier_vehicle.board or later_vehicle.board,
        hardware=earlier_vehicle.hardware or later_vehicle.hardware,
        dropouts=earlier_vehicle.dropouts + later_vehicle.dropouts,
        source_names={**earlier_vehicle.source_names, **later_vehicle.source_names},
        is_ended_on_purpose=later_vehicle.is_ended_on_purpose,
    )


def _joined_messages(
    earlier: Recording, later: Recording, *, has_restarted: bool
) -> dict[str, Columns]:
    """Joins the messages of two logs of one vehicle, with the boots of both numbered one after the other.

    Args:
        earlier, later: The recordings in the order of time.
        has_restarted: Whether the autopilot restarted between them, so that the later one begins with another boot.

    Returns:
        Columns by name of the message.
    """
    first_boot_of_later = earlier.last_boot + 1 if has_restarted else earlier.last_boot
    boot_offset = first_boot_of_later - later.first_boot
    messages: dict[str, Columns] = dict(earlier.vehicle.messages)
    for name, columns in later.vehicle.messages.items():
        if not has_restarted:
            # Values from before the beginning of the later log would be there twice, and out of order.
            is_repeated = (columns["boot"] == later.first_boot) & (columns["time"] <= earlier.end)
            columns = selected_rows(columns, ~is_repeated)
        later_columns = {**columns, "boot": columns["boot"] + boot_offset}
        if name in messages:
            later_columns = concatenated_columns([messages[name], later_columns])
        messages[name] = later_columns
    return messages


def _initial_parameters(earlier: Telemetry, later: Telemetry) -> Parameters:
    """Finds the parameters that changed within one of two logs or between them, and their values before that.

    ``initial_parameters`` of a log has the first values of the parameters that changed in it, and ``parameters`` the
    last values of all.

    Args:
        earlier: The vehicle in the first log.
        later: The vehicle in the second log.

    Returns:
        The value of each such parameter before its first change, by name.
    """
    # A parameter that changed in both logs has its first value from the first log.
    initial_values = {**later.initial_parameters, **earlier.initial_parameters}
    values_at_start_of_second = {**later.parameters, **later.initial_parameters}
    for name, last_value_of_first in earlier.parameters.items():
        value_of_second = values_at_start_of_second.get(name, last_value_of_first)
        has_changed_between = value_of_second != last_value_of_first
        if has_changed_between:
            initial_values.setdefault(name, last_value_of_first)
    return initial_values


def _joined_log(earlier: Log, later: Log, vehicle: Telemetry) -> Log:
    """Merges two logs into one, whose message counts are sums and whose reception times span both.

    Args:
        earlier, later: The logs in the order of time.
        vehicle: Telemetry of the vehicle, joined from both logs.

    Returns:
        The joined log, named after the earlier file.
    """
    components: dict[tuple[int, int], Component] = {}
    for component in earlier.components + later.components:
        ids = (component.system, component.component)
        if ids in components:
            component = replace(
                component,
                messages=_added_counts(components[ids].messages, component.messages),
                lost=components[ids].lost + component.lost,
            )
        components[ids] = component
    # First and last time of reception of both logs; NaN in a log that does not have them.
    receive_stamps = np.array([earlier.receive_time, later.receive_time])
    known_stamps = receive_stamps[np.isfinite(receive_stamps)].tolist()
    return Log(
        source=earlier.source,
        vehicles=(vehicle,),
        components=tuple(components[ids] for ids in sorted(components)),
        unread=earlier.unread + later.unread,
        frames=earlier.frames + later.frames,
        bytes_skipped=earlier.bytes_skipped + later.bytes_skipped,
        receive_time=(min(known_stamps, default=nan), max(known_stamps, default=nan)),
    )


def _added_counts(first: Mapping[str, int], second: Mapping[str, int]) -> dict[str, int]:
    """Returns the sums of two counts of messages, by name."""
    names = dict.fromkeys((*first, *second))
    return {name: first.get(name, 0) + second.get(name, 0) for name in names}
