"""Telemetry and Log: what one vehicle sent, as columns on its boot clock, and all contents of a recording."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isclose, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array, Flags
from mavdem.confidence import Interval
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.sources import Flaw, Repair
from mavdem.immutable import ImmutableResult

Parameters = Mapping[str, float]
"""Values of an autopilot's parameters by name."""

Fields = dict[str, NDArray[Any]]
"""Columns of a message by field name, while the message is being made."""

Columns = Mapping[str, NDArray[Any]]
"""One message type's fields by name; every array has one row per message, in stream order.

Beside the fields of the message definition, in the units of the definition, two columns are always there:

- ``time`` (N,) float64: seconds on the autopilot's boot clock, wraps undone. A message without a clock of its own
  (HEARTBEAT, PARAM_VALUE) has the time of the last message before it that has one.
- ``boot`` (N,) int64: 0 for the first boot in the source, one more after each reboot. ``time`` restarts with each
  boot, so times of different boots must never be compared.
"""

Tables = Mapping[str, Columns]
"""The columns of each message type by its name."""

MICROSECONDS = 1e6
"""Microseconds in a second."""

MIN_PREFERRED_SHARE = 0.9
"""A preferred message gives way to another only where it comes less often than this fraction of the other's count.

A choice: a tenth fewer messages is less harm than the disadvantages of the other message.
"""

MAX_GAP_SECONDS = 0.1
"""Longest silence, s, across which signals are interpolated: half a period of 5 Hz, at which roll still moves."""

FLOAT32_TOLERANCE = 1e-6
"""Relative difference of two values that are the same 32-bit float, whose steps are 1.2e-7, after printing."""

MAX_FIELDS = 2000
"""Largest number of numbers in one message that is decoded.

PX4's and MAVROS's have up to some hundreds. A malicious definition can announce millions, for each of which the
libraries that decode messages allocate memory.
"""


@dataclass(frozen=True, eq=False)
class Telemetry(ImmutableResult):
    """The messages of one component of one vehicle.

    Attributes:
        system: MAVLink system id.
        component: MAVLink component id (1 is the autopilot).
        vehicle: the vehicle's MAV_TYPE without its prefix ("QUADROTOR"), of most HEARTBEATs; "UNKNOWN" without any.
        autopilot: the MAV_AUTOPILOT without its prefix ("ARDUPILOTMEGA", "PX4").
        messages: columns by message name ("ATTITUDE").
        parameters: the autopilot's parameters by name, as numbers, the last value sent.
        source: the file or link it came from.
        repairs: what was odd or damaged, and what was done about it (a wrap, a reboot, damage).
        translated_from: the source of messages that the autopilot did not send as MAVLink: "DataFlash", "ULog", or for
            ROS 2's topics "uXRCE-DDS" or "MAVROS"; otherwise empty.
        firmware: what the autopilot calls its firmware ("ArduCopter V4.4.4 (865cffa5)"); empty if the log does not.
        dropouts: how often the autopilot's own logger reports to have lost messages.
        source_names: what the source calls messages that were translated ("RCOU"), by their name here.
        board: the number of the autopilot's board, which no other has, in hexadecimal; empty if the log has none.
        hardware: the kind of board, as its firmware calls it ("PX4_FMU_V5"); empty if the log has none.
        initial_parameters: the first values of those parameters that changed, by name.
        later_parameters: the last values of those parameters that changed after these messages, by name, if these are
            a part of a recording.
        default_parameters: the firmware's defaults for this vehicle, by name, of those parameters whose default the log
            gives; empty if it gives none.
        restart_delays: for each boot but the first, how long the autopilot was silent before its clock started, s, by
            the times at which messages were received; boots for which that is not known are left out.
        is_ended_on_purpose: whether the user ended the recording, so that its end tells nothing about the vehicle;
            False if that is not known.
    """

    system: int
    component: int
    vehicle: str
    autopilot: str
    messages: Tables
    parameters: Parameters = field(default_factory=dict)
    source: str = ""
    repairs: Facts = ()
    translated_from: str = ""
    firmware: str = ""
    dropouts: int = 0
    source_names: Mapping[str, str] = field(default_factory=dict)
    board: str = ""
    hardware: str = ""
    initial_parameters: Parameters = field(default_factory=dict)
    later_parameters: Parameters = field(default_factory=dict)
    default_parameters: Parameters = field(default_factory=dict)
    restart_delays: Mapping[int, float] = field(default_factory=dict)
    is_ended_on_purpose: bool = False

    @property
    def present_parameters(self) -> Parameters:
        """The parameters at the end of the whole recording, by name, which the vehicle still has."""
        return {**self.parameters, **self.later_parameters}

    def name_in_source(self, message: str) -> str:
        """Returns the name of a message in the source: DataFlash's "RCOU" for "SERVO_OUTPUT_RAW"."""
        return self.source_names.get(message, message)

    @property
    def changed_defaults(self) -> Parameters:
        """Default values of the parameters that differ from their default at the end of the log, by name.

        Values that agree as 32-bit floats, as autopilots store them, are the same.
        """
        changed_values = {}
        for name, default in self.default_parameters.items():
            value = self.parameters.get(name, default)
            if not isclose(value, default, rel_tol=FLOAT32_TOLERANCE):
                changed_values[name] = default
        return changed_values


def firmware_version(telemetry: Telemetry) -> tuple[int, int] | None:
    """Returns major and minor version of the firmware, by its name or the message AUTOPILOT_VERSION; None without both.

    PX4 writes a lower-case v ("PX4 v1.15.0-beta"), ArduPilot an upper-case one ("ArduCopter V4.4.4"). Only the letter
    of this autopilot is searched: other parts of the name, such as the board, may have a number after the other letter.

    Args:
        telemetry: autopilot, firmware and messages of the vehicle.

    Returns:
        (major, minor), or None.
    """
    letter = "v" if telemetry.autopilot == "PX4" else "V"
    version = re.search(letter + r"(\d+)\.(\d+)", telemetry.firmware)
    if version is not None:
        return int(version[1]), int(version[2])
    columns = telemetry.messages.get("AUTOPILOT_VERSION", {})
    number = int(columns["flight_sw_version"][-1]) if "flight_sw_version" in columns else 0
    # One byte each for the major, minor and patch number and the maturity; 0 if the version is not known.
    if not number:
        return None
    major, minor, _, _ = number.to_bytes(4, "big")
    return major, minor


MAX_USUAL_STEP_RATIO = 3.0
"""A time step longer than this many median steps is a gap in a stream."""


def rate_without_gaps(steps: Array) -> float:
    """Estimates how many messages per second a stream has while it is not interrupted.

    Args:
        steps: Times (N,) between successive messages, s.

    Returns:
        Messages per second: 1 / the mean of the steps that are at most ``MAX_USUAL_STEP_RATIO`` medians long; 0 if
        there are no steps, or all are 0.
    """
    if not len(steps):
        return 0.0
    usual_steps = steps[steps <= MAX_USUAL_STEP_RATIO * np.median(steps)]
    if not usual_steps.any():
        return 0.0
    return 1 / float(usual_steps.mean())


def interpolated(query_time: Array, time: Array, values: Array) -> Array:
    """Interpolates columns linearly; before the first and after the last sample they stay constant.

    Args:
        query_time: Times (T,), s, at which values are wanted.
        time: Times (N,) of the samples, s, ascending.
        values: Samples (N, k).

    Returns:
        Values (T, k).
    """
    return np.column_stack([np.interp(query_time, time, column) for column in values.T])


def last_values(query_time: Array, time: Array, values: NDArray[Any]) -> NDArray[Any]:
    """Returns the last value before or at each time (a zero-order hold).

    Args:
        query_time: Times (T,), s, at which values are wanted.
        time: Times (N,) of the samples, s, ascending.
        values: Samples (N,).

    Returns:
        Values (T,); 0 before the first sample.
    """
    samples_before = np.searchsorted(time, query_time, side="right")
    return np.insert(values, 0, 0)[samples_before]


def rows_by_value(values: NDArray[np.integer[Any]]) -> dict[int, NDArray[np.int32]]:
    """Groups the rows of a column by their value.

    A long column is sorted block by block, to bound the memory. Each value then has rows in several blocks.

    Args:
        values: The column (N,).

    Returns:
        The rows of each value, ascending; the values are in ascending order too.
    """
    rows_in_blocks: dict[int, list[NDArray[np.int32]]] = {}
    for block_start in range(0, len(values), SORTED_ROWS):
        block = values[block_start : block_start + SORTED_ROWS]
        if block.dtype.itemsize > np.dtype(np.uint16).itemsize and is_in_uint16(block):
            # NumPy sorts integers of 16 bits fastest (radix sort).
            block = block.astype(np.uint16)
        order = np.argsort(block, kind="stable").astype(np.int32)
        sorted_values = block[order]
        first_rows = np.flatnonzero(begins_value(sorted_values))
        # ``split`` puts an empty array before the first row of the first value.
        rows_of_values = np.split(order + np.int32(block_start), first_rows)[1:]
        distinct_values = sorted_values[first_rows].tolist()
        for value, rows in zip(distinct_values, rows_of_values, strict=True):
            rows_in_blocks.setdefault(value, []).append(rows)
    joined_rows = {}
    for value in sorted(rows_in_blocks):
        # Removed from the dictionary, so that the memory of its blocks is freed once they are joined.
        joined_rows[value] = np.concatenate(rows_in_blocks.pop(value))
    return joined_rows


def begins_value(values: NDArray[Any]) -> Flags:
    """Returns whether each element of an ascending column (N,) is the first one of its value."""
    is_first = np.ones(len(values), dtype=np.bool_)
    is_first[1:] = values[1:] > values[:-1]
    return is_first


def firsts_of_seconds(time: Array) -> Array:
    """Returns the first of the stamps (N,), s, ascending, in each second that has any."""
    return time[begins_value(np.floor(time))]


SORTED_ROWS = 1 << 20
"""Number of rows that are sorted at once: a choice."""


def is_in_uint16(values: NDArray[np.integer[Any]]) -> bool:
    """Returns whether all values (N,), at least one, are 0 to 65535."""
    return bool(values.min() >= 0 and values.max() <= np.iinfo(np.uint16).max)


def selected_rows(columns: Columns, rows: slice | NDArray[Any]) -> Fields:
    """Returns some rows of every column; ``rows`` is a slice, row numbers, or flags (N,)."""
    if isinstance(rows, np.ndarray) and rows.dtype == np.bool_:
        # Row numbers are found once; flags would be searched for each column.
        rows = np.flatnonzero(rows)
    return {name: values[rows] for name, values in columns.items()}


def concatenated_columns(tables: Sequence[Columns]) -> Fields:
    """Joins tables of the same message one after the other.

    Args:
        tables: The tables (N_i rows each), at least one. The columns of a single one are not copied.

    Returns:
        The columns that all tables have, with the rows of all.
    """
    if len(tables) == 1:
        return dict(tables[0])
    joined_columns = {}
    for name in tables[0]:
        if all(name in table for table in tables):
            joined_columns[name] = np.concatenate([table[name] for table in tables])
    return joined_columns


SourceFields = Mapping[str, Sequence[tuple[float, str]]]
"""How fields of a MAVLink message are named in another format, by name of the field in MAVLink.

For each there are pairs of factor and name: the factor turns the unit of the format into MAVLink's, and the name is
one of those that the field has had over the versions of the format, the preferred first.
"""


def translated_fields(
    source: Columns, required: SourceFields, optional: SourceFields | None = None
) -> Fields:
    """Translates columns of another format into the fields of a MAVLink message: names and units.

    Of the names that a field has had over the versions of the format, the first that the source has is used.

    Args:
        source: Columns (N,) of the other format.
        required: Names and factors of the fields that the message must have.
        optional: Those of fields that the source may lack.

    Returns:
        Columns by name of MAVLink, in its units.

    Raises:
        KeyError: The source has none of the names of a required field.
    """
    fields: Fields = {}
    for name, choices in {**required, **(optional or {})}.items():
        for factor, source_name in choices:
            if source_name in source:
                values = source[source_name]
                # With the factor 1, integers remain integers.
                fields[name] = values if factor == 1 else np.asarray(values, np.float64) * factor
                break
        if name in required and name not in fields:
            raise KeyError(name)
    return fields


def fields_by_rule(source: Columns, rule: Mapping[str, SourceFields]) -> Fields:
    """Translates columns by a rule of a ``translation.toml``: its ``fields`` and, if it has them, ``optional_fields``.

    Args:
        source: Columns (N,) of the other format.
        rule: The rule of a MAVLink message.

    Returns:
        Columns by name of MAVLink, in its units.

    Raises:
        KeyError: The source has none of the names of a required field.
    """
    return translated_fields(source, rule["fields"], rule.get("optional_fields"))


@dataclass(frozen=True, eq=False)
class Component(ImmutableResult):
    """One component that sent messages: a vehicle, a ground station, a gimbal, a radio.

    Attributes:
        system, component: MAVLink ids.
        kind, autopilot: MAV_TYPE ("GCS") and MAV_AUTOPILOT in most of its HEARTBEATs, without prefix; "UNKNOWN" without
            a HEARTBEAT, or "TELEMETRY_RADIO" if RADIO_STATUS is all it sent.
        messages: number of messages by name.
        lost: messages missing by the gaps in its sequence numbers; a gap counts 127 at most.
    """

    system: int
    component: int
    kind: str
    autopilot: str
    messages: Mapping[str, int]
    lost: int


@dataclass(frozen=True)
class UnreadFrames:
    """Frames of one message from one sender that cannot be read."""

    message_id: int
    """MAVLink's number of the message."""
    system: int
    """System id of the sender."""
    component: int
    """Component id of the sender."""
    frames: int
    """Number of frames that cannot be read."""
    total: int
    """Number of all frames of this message from this sender."""
    cause: Flaw
    """Another dialect when no frame agrees with the dialect's definition, damage when some do."""


@dataclass(frozen=True, eq=False)
class Log:
    """A recorded stream.

    Attributes:
        source: the file it came from.
        vehicles: one ``Telemetry`` for each component that is a vehicle and sent more than HEARTBEATs.
        components: every component, vehicles included; both by system and component.
        unread: frames that could not be read.
        frames: whole frames in the stream, unread ones included.
        bytes_skipped: bytes that belong to no frame.
        receive_time: (first, last) trustworthy receive stamp, UNIX seconds; NaN when there is none.
    """

    source: str
    vehicles: tuple[Telemetry, ...]
    components: tuple[Component, ...]
    unread: tuple[UnreadFrames, ...]
    frames: int
    bytes_skipped: int
    receive_time: Interval


def repair_facts(code: Repair, **figures: Any) -> Facts:
    """Returns the fact that tells the user what was repaired in a log, such as 12 damaged frames that were left out.

    A fact is a coded finding with figures, from which its sentence is made; the level WATCH marks it as worth a look.

    Args:
        code: What was repaired or left out; its sentence is made from this code.
        figures: Figures of the fact; ``count``, if given, is the number of repairs.

    Returns:
        The fact in a tuple, to be added to those of other repairs; an empty tuple if ``count`` is 0.
    """
    if figures.get("count", 1) == 0:
        return ()
    return (Fact(code, Level.WATCH, **figures),)


def log_of_vehicles(
    vehicles: tuple[Telemetry, ...],
    frames: int,
    bytes_skipped: int,
    receive_time: Interval = (nan, nan),
    counts: Mapping[str, int] | None = None,
) -> Log:
    """Makes the log of a file in which only vehicles sent messages, such as an autopilot's own log.

    No message was lost on a link, and there are no frames that could not be read.

    Args:
        vehicles: The vehicles, at least one.
        frames: Number of messages in the file.
        bytes_skipped: Number of bytes that belong to no message.
        receive_time: First and last receive stamp, UNIX s; NaN if the file has none.
        counts: Number of messages by their names in the file; None to count the translated MAVLink messages.

    Returns:
        The log, with a component for each vehicle.
    """
    components = []
    for vehicle in vehicles:
        message_counts = counts
        if not message_counts:
            message_counts = {
                name: len(columns["time"]) for name, columns in vehicle.messages.items()
            }
        components.append(
            Component(
                vehicle.system,
                vehicle.component,
                vehicle.vehicle,
                vehicle.autopilot,
                message_counts,
                lost=0,
            )
        )
    return Log(
        source=vehicles[0].source,
        vehicles=vehicles,
        components=tuple(components),
        unread=(),
        frames=frames,
        bytes_skipped=bytes_skipped,
        receive_time=receive_time,
    )
