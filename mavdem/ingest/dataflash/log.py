"""DataFlash logs, written on board by ArduPilot, binary (.bin) or as text (.log): reading them as MAVLink messages."""

import os
from collections.abc import Mapping, Sequence
from functools import partial
from math import isfinite
from typing import NamedTuple

import numpy as np

from mavdem.errors import Unreadable
from mavdem.facts import Facts
from mavdem.facts.sources import Flaw, Repair, SourceFact
from mavdem.files import PathName
from mavdem.ingest.contents import RECOGNITION_BYTES, FileContent, file_content, is_dataflash_text
from mavdem.ingest.dataflash.binary import read_binary
from mavdem.ingest.dataflash.clock import (
    CLOCK_FIELDS,
    LogClock,
    log_clock,
    on_boot_clock,
    stamps_of_table,
)
from mavdem.ingest.dataflash.definitions import are_markers_frequent
from mavdem.ingest.dataflash.recording import DataflashRecording, MessageTable, usable_fields
from mavdem.ingest.dataflash.samples import ACCELEROMETER_FIELDS, GYRO_FIELDS, raw_samples
from mavdem.ingest.dataflash.sensors import STATUS_3D_FIX
from mavdem.ingest.dataflash.tables import field_texts
from mavdem.ingest.dataflash.text import read_text
from mavdem.ingest.dataflash.translation import (
    FLIGHT_MESSAGES,
    TRANSLATED_MESSAGES,
    mavlink_messages,
    satellite_utc,
    with_new_names,
)
from mavdem.ingest.dataflash.vehicle_kind import firmware_text, mav_type, system_id_of_parameters
from mavdem.ingest.mavlink.dialect import mavlink_constant
from mavdem.ingest.other_recordings import (
    DATAFLASH_RULES,
    BootTimesInUtc,
    LeftOutBlock,
    StampedMessages,
    blocks_of_other_recordings,
    outside_blocks,
)
from mavdem.ingest.telemetry import Columns, Log, Tables, Telemetry, log_of_vehicles, repair_facts
from mavdem.ingest.vocabulary import (
    AUTOPILOT_COMPONENT,
    UNNAMED,
    board_name_in_texts,
    board_number_from_texts,
)


def read_dataflash(path: PathName) -> Log:
    """Reads a DataFlash log, binary or text, a damaged one as far as possible.

    Args:
        path: The log, or an archive of it.

    Returns:
        The log of one vehicle. Its component counts the messages under DataFlash's names ("ATT"); the telemetry has
        them under MAVLink's ("ATTITUDE").

    Raises:
        Unreadable: The file cannot be opened, or has no message of a flight.
    """
    source = os.fspath(path)
    content, recording = _open_recording(path)
    vehicle = _translated_vehicle(recording, source, content)
    return log_of_vehicles(
        (vehicle,),
        frames=sum(recording.counts.values()),
        bytes_skipped=recording.bytes_skipped,
        counts=recording.counts,
    )


def all_tables(path: PathName) -> Tables:
    """Reads all messages of a DataFlash log under its own names, with all fields that have one number per message.

    Args:
        path: A log that ``read_dataflash`` can read.

    Returns:
        Columns by name of the message, with ``time`` (s) and ``boot``; without messages that have no stamps.
    """
    content, recording = _open_recording(path)
    recording = _without_old_blocks(recording, _logged_messages(recording), content).recording
    logged_tables = {name: usable_fields(recording.decode(name)) for name in recording.counts}
    tables, _ = on_boot_clock(logged_tables, log_clock(logged_tables))
    return tables


class _Content(NamedTuple):
    """A file, and what it holds."""

    content: FileContent
    """Its bytes; none of a text log."""

    recording: DataflashRecording
    """The log, whose messages are not decoded yet."""


def _open_recording(path: PathName) -> _Content:
    """Finds the messages of a DataFlash log, binary or text.

    Args:
        path: The log, or an archive of it.

    Returns:
        The located messages, with the bytes of the file, which are empty for a text log.

    Raises:
        Unreadable: The file cannot be opened.
    """
    content = file_content(path)
    if is_dataflash_text(content[:RECOGNITION_BYTES]):
        return _Content(b"", read_text(content[:]))
    return _Content(content, read_binary(content))


class _ParameterValues(NamedTuple):
    """Values of parameters in a log, by name."""

    last: dict[str, float]
    """Last value of each parameter."""

    changed_first: dict[str, float]
    """First value of each parameter that changed in the log."""


def _last_and_changed_first_values(
    settings: list[tuple[str, float]],
) -> _ParameterValues:
    """Returns the last values of all parameters, and the first values of those that changed in the log.

    Args:
        settings: Name and value of a parameter, each time that one was logged, in the order of the log.

    Returns:
        Both by the names of the parameters.
    """
    # A dictionary keeps the last of several values under one name: of the reversed list, that is the first one.
    last_values = dict(settings)
    first_values = dict(reversed(settings))
    changed_first_values = {
        name: value for name, value in first_values.items() if value != last_values[name]
    }
    return _ParameterValues(last_values, changed_first_values)


def _translated_vehicle(
    recording: DataflashRecording, source: str, content: FileContent
) -> Telemetry:
    """Makes the vehicle of a recording: its messages on the boot clock, in MAVLink's vocabulary, and its parameters.

    Args:
        recording: The log, whose messages are decoded here.
        source: Name of the file, for error messages and the report.
        content: Its bytes; none of a text log.

    Returns:
        The vehicle, with what was repaired: damaged bytes, old blocks, clock and units.

    Raises:
        Unreadable: The log has no message of a flight.
    """
    recording, logged_tables, clock, block_repairs = _without_old_blocks(
        recording, _logged_messages(recording), content
    )
    tables, clock_repairs = on_boot_clock(logged_tables, clock)
    if not any(len(tables[name]["time"]) for name in FLIGHT_MESSAGES if name in tables):
        raise _error_without_flight(recording, source)
    texts = field_texts(logged_tables["MSG"].columns, "Message")
    parameter_columns = logged_tables["PARM"].columns
    parameter_names = field_texts(parameter_columns, "Name")
    parameters, initial_parameters = _last_and_changed_first_values(
        _finite_settings(parameter_names, parameter_columns, "Value")
    )
    vehicle_kind = mav_type(texts, parameters)
    messages, source_names, unit_repairs = mavlink_messages(
        tables, mavlink_constant(f"MAV_TYPE_{vehicle_kind}"), parameters
    )
    for name, (source_name, columns) in raw_samples(tables, parameters).items():
        messages[name] = columns
        source_names[name] = source_name
    dropouts = _lost_messages(recording)
    damage_repairs = _damage_repairs(recording, logged_tables)
    return Telemetry(
        system=system_id_of_parameters(parameters),
        component=AUTOPILOT_COMPONENT,
        vehicle=UNNAMED if vehicle_kind == "GENERIC" else vehicle_kind,
        autopilot="ARDUPILOTMEGA",
        messages=messages,
        parameters=parameters,
        source=source,
        repairs=(
            *damage_repairs,
            *block_repairs,
            *clock_repairs,
            *unit_repairs,
            *repair_facts(Repair.LOGGER_WITHOUT_ROOM, count=dropouts),
        ),
        translated_from="DataFlash",
        firmware=firmware_text(texts),
        dropouts=dropouts,
        source_names=source_names,
        board=board_number_from_texts(texts),
        hardware=board_name_in_texts(texts),
        initial_parameters=initial_parameters,
        default_parameters=dict(_finite_settings(parameter_names, parameter_columns, "Default")),
    )


def _damage_repairs(
    recording: DataflashRecording, logged_tables: Mapping[str, MessageTable]
) -> Facts:
    """Reports the damage of a log: bytes that belong to no message, and messages with unreadable numbers.

    Args:
        recording: The log, with facts on what was repaired when its messages were found.
        logged_tables: Its decoded messages, by name.

    Returns:
        The facts; none for a sound log.
    """
    unreadable_messages = sum(table.unreadable for table in logged_tables.values())
    return (
        *recording.repairs,
        *repair_facts(
            Repair.BYTES_SKIPPED,
            count=recording.bytes_skipped,
            total=recording.size,
            part="message",
        ),
        *repair_facts(
            Repair.LOGGED_MESSAGES_LEFT_OUT,
            count=unreadable_messages,
            flaw=Flaw.UNREADABLE_NUMBER,
        ),
    )


def _error_without_flight(recording: DataflashRecording, source: str) -> Unreadable:
    """Returns the error that explains why a log has no message of a flight.

    Either it is a log of PX4 from before ULog, which has the same format; or most of its messages have no definition;
    or it has other messages, or none at all.

    Args:
        recording: The log, which has none of ``FLIGHT_MESSAGES``.
        source: Name of the file, for error messages and the report.

    Returns:
        The error to raise.
    """
    is_of_px4 = "StartTime" in recording.decode("TIME").columns
    if is_of_px4:
        return Unreadable(SourceFact.PX4_LOG_BEFORE_ULOG, path=source)
    names = sorted(recording.counts)
    # Messages without a definition count as skipped bytes, and are recognised by their marker.
    undefined_count = recording.undefined_messages
    are_messages = are_markers_frequent(undefined_count, recording.bytes_skipped)
    if are_messages and undefined_count > len(names):
        return Unreadable(
            SourceFact.DATAFLASH_WITHOUT_DEFINITIONS, path=source, count=undefined_count
        )
    code = SourceFact.DATAFLASH_WITHOUT_FLIGHT if names else SourceFact.DATAFLASH_WITHOUT_MESSAGES
    return Unreadable(code, path=source, names=names)


def _logged_messages(recording: DataflashRecording) -> dict[str, MessageTable]:
    """Decodes the messages that are translated, by name, under the names that fields have today.

    A message that the log does not have gets an empty table.

    Args:
        recording: The log, whose messages are located.

    Returns:
        Tables by name of the message.
    """
    logged_tables = {}
    for name in TRANSLATED_MESSAGES:
        logged_tables[name] = with_new_names(name, usable_fields(recording.decode(name)))
    # IMU has by far the most messages: only what is used of each stays in memory.
    imu = logged_tables["IMU"]
    used_fields = {*CLOCK_FIELDS, "I", "T", "Temp", *GYRO_FIELDS, *ACCELEROMETER_FIELDS}
    used_columns = {name: values for name, values in imu.columns.items() if name in used_fields}
    logged_tables["IMU"] = imu._replace(columns=used_columns)
    return logged_tables


class _KeptMessages(NamedTuple):
    """A log without the blocks of other logs in it."""

    recording: DataflashRecording
    """The log, which decodes only messages of its own."""

    logged: dict[str, MessageTable]
    """Its messages that are translated, by name."""

    clock: LogClock
    """Their stamps."""

    repairs: Facts
    """What was left out."""


def _without_old_blocks(
    recording: DataflashRecording, logged_tables: dict[str, MessageTable], content: FileContent
) -> _KeptMessages:
    """Leaves out the blocks of a log that belong to another recording, such as an older file on the same memory card.

    A block is a part of the file, from one byte offset to another, in which the stamps are those of another flight. Two
    logs are returned as they are: one whose messages have no stamps, and one without such blocks.

    Args:
        recording: The log, whose messages are located.
        logged_tables: Its translated messages, by name.
        content: The bytes of the file, by which repeated blocks are found; empty for a text log.

    Returns:
        The messages outside these blocks, with their clock, and a fact that reports what was left out.
    """
    clock = log_clock(logged_tables)
    if not clock.names:
        return _KeptMessages(recording, logged_tables, clock, ())
    # A log begins with FMT, the definitions of its messages: where they are repeated, another log may begin.
    log_starts = recording.decode("FMT").position
    blocks = blocks_of_other_recordings(
        StampedMessages(clock.positions, clock.seconds, content),
        log_starts,
        _boot_times_in_utc(logged_tables),
        DATAFLASH_RULES,
    )
    if not blocks:
        return _KeptMessages(recording, logged_tables, clock, ())
    recording_without_blocks = recording._replace(
        decode=partial(_decode_outside_blocks, recording, blocks)
    )
    # The last block may reach to the end of the file, whose offset is not a real one (``END_OF_FILE``).
    last_position = int(clock.positions.max())
    repairs = repair_facts(
        Repair.OLD_BLOCKS_LEFT_OUT,
        count=len(blocks),
        size=sum(min(block.end, last_position) - block.start for block in blocks),
        duration=sum(block.duration for block in blocks),
    )
    messages = _logged_messages(recording_without_blocks)
    return _KeptMessages(recording_without_blocks, messages, log_clock(messages), repairs)


def _decode_outside_blocks(
    recording: DataflashRecording, blocks: Sequence[LeftOutBlock], name: str
) -> MessageTable:
    """Decodes the messages of one name, and leaves out those in blocks that belong to another recording.

    Args:
        recording: The log, whose messages are located.
        blocks: The blocks to leave out, at least one, in the order of the log.
        name: Name of the messages ("ATT").

    Returns:
        The messages outside the blocks.
    """
    table = recording.decode(name)
    is_kept = outside_blocks(blocks, table.position)
    columns = {field: values[is_kept] for field, values in table.columns.items()}
    return table._replace(position=table.position[is_kept], columns=columns)


def _boot_times_in_utc(logged_tables: Mapping[str, MessageTable]) -> BootTimesInUtc:
    """Computes from messages of the GPS the UNIX time at which the boot clock read 0.

    Args:
        logged_tables: Decoded messages by name, with GPS.

    Returns:
        Positions of N such messages in the file, and the UNIX time, s, by each of them.
    """
    table = logged_tables["GPS"]
    columns = table.columns
    stamps = stamps_of_table(table)
    if stamps is None or not {"Status", "GMS", "GWk"} <= columns.keys():
        return BootTimesInUtc(np.zeros(0, dtype=np.int64), np.zeros(0))
    has_time = (columns["Status"] >= STATUS_3D_FIX) & (columns["GWk"] > 0)
    utc_at_boot = satellite_utc(columns["GWk"], columns["GMS"]) - stamps
    has_time &= np.isfinite(utc_at_boot)
    return BootTimesInUtc(table.position[has_time], utc_at_boot[has_time])


def _lost_messages(recording: DataflashRecording) -> int:
    """Returns how many messages the logger had no room for: DSF counts them, again with each boot."""
    counter = usable_fields(recording.decode("DSF")).columns.get("Dp", np.zeros(0))
    increases = np.maximum(np.diff(counter.astype(np.float64)), 0)
    return int(np.nansum(increases))


def _finite_settings(
    names: Sequence[str], parameter_columns: Columns, field: str
) -> list[tuple[str, float]]:
    """Selects the messages PARM of a log that set a parameter to a finite value.

    Args:
        names: Name (N,) of the parameter in each message.
        parameter_columns: Columns (N,) of the messages.
        field: "Value", or "Default", which only newer firmware logs; without the field there are no values.

    Returns:
        Pairs of name and value, in the order of the log.
    """
    if field not in parameter_columns:
        return []
    values = parameter_columns[field].astype(float).tolist()
    # A damaged definition may lack the names; then there are no settings.
    return [(name, value) for name, value in zip(names, values, strict=False) if isfinite(value)]
