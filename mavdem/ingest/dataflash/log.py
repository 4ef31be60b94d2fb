"""DataFlash logs, written on board by ArduPilot, binary (.bin) or as text (.log): reading them as MAVLink messages.

All messages carry one clock: TimeUS, µs since boot, or TimeMS before ArduPilot 3.3. A log may contain several boots,
appended.
"""

import os
import re
from collections.abc import Mapping, Sequence
from math import isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array, Integers
from mavdem.errors import Unreadable
from mavdem.facts import Facts
from mavdem.facts.sources import Flaw, Repair, SourceFact
from mavdem.files import PathName
from mavdem.ingest.contents import (
    RECOGNITION_BYTES,
    FileContent,
    file_content,
    is_dataflash_text,
)
from mavdem.ingest.dataflash.binary import (
    MAX_MESSAGE_BYTES,
    DataflashRecording,
    MessageTable,
    read_binary,
    usable_fields,
)
from mavdem.ingest.dataflash.samples import ACCELEROMETER_FIELDS, GYRO_FIELDS, raw_samples
from mavdem.ingest.dataflash.sensors import STATUS_3D_FIX
from mavdem.ingest.dataflash.states import ARMING_EVENTS
from mavdem.ingest.dataflash.tables import field_texts
from mavdem.ingest.dataflash.text import read_text
from mavdem.ingest.dataflash.translation import (
    FLIGHT_MESSAGES,
    TRANSLATED_MESSAGES,
    mavlink_messages,
    satellite_utc,
    with_new_names,
)
from mavdem.ingest.mavlink.clocks import MessageStamps, Rows, boot_clock
from mavdem.ingest.mavlink.dialect import mavlink_constant
from mavdem.ingest.other_recordings import (
    DATAFLASH_RULES,
    BootTimesInUtc,
    StampedMessages,
    blocks_of_other_recordings,
    outside_blocks,
)
from mavdem.ingest.telemetry import (
    Columns,
    Log,
    Parameters,
    Tables,
    Telemetry,
    log_of_vehicles,
    repair_facts,
    selected_rows,
)
from mavdem.ingest.vocabulary import (
    AUTOPILOT_COMPONENT,
    UNNAMED,
    board_name_in_texts,
    board_number_in_texts,
)

CLOCK_FIELDS = {"TimeUS": 1e6, "TimeMS": 1e3}
"""Fields with the time since boot, and their units per second; where a message has both, the last counts."""

MESSAGES_WITH_OLD_STAMPS = ("MSG", "PARM")
"""Messages whose stamps are not used as a clock: those of the start are older than the messages around them."""

UNSTAMPED_MESSAGES = ("EV", "ARM", "ERR", "MODE", *MESSAGES_WITH_OLD_STAMPS)
"""Messages that are used also where they have no stamp, as before ArduCopter 3.4.

Without a stamp they have the time of the message before them; with an old one (MSG, PARM), their own, as far as it lies
between those of their neighbours.
"""

MAX_STAMP_SECONDS = 2.0**63 / 1e6
"""Bound of stamps, s: TimeUS in a signed integer of 64 bits. Damaged stamps lie beyond it."""

FIRMWARES = {
    "plane": "FIXED_WING",
    "copter": "QUADROTOR",
    "tracker": "ANTENNA_TRACKER",
    "blimp": "AIRSHIP",
    "rover": "GROUND_ROVER",
    "sub": "SUBMARINE",
}
"""MAV_TYPE by what follows "Ardu", "APM:" or "Antenna" in MSG ("ArduCopter V4.5.7", "APM:Copter V3.5")."""

_FIRMWARE = re.compile(rf"^(?:Ardu|APM:|Antenna)?({'|'.join(FIRMWARES)})\b", re.IGNORECASE)
_FRAME = re.compile(r"^Frame: ([A-Z0-9_]+)")

FRAME_CLASSES = (
    "QUADROTOR",
    "QUADROTOR",
    "HEXAROTOR",
    "OCTOROTOR",
    "OCTOROTOR",
    "HEXAROTOR",
    "HELICOPTER",
    "TRICOPTER",
    "COAXIAL",
    "COAXIAL",
    "COAXIAL",
    "HELICOPTER",
    "DODECAROTOR",
    "HELICOPTER",
    "DECAROTOR",
)
"""MAV_TYPE by FRAME_CLASS, as in ArduCopter's HEARTBEAT (``get_frame_mav_type``)."""

FRAME_NAMES = {
    "QUAD": "QUADROTOR",
    "HEXA": "HEXAROTOR",
    "Y6": "HEXAROTOR",
    "OCTA": "OCTOROTOR",
    "OCTAQUAD": "OCTOROTOR",
    "OCTA_QUAD": "OCTOROTOR",
    "TRI": "TRICOPTER",
    "HELI": "HELICOPTER",
}
"""MAV_TYPE by the frame's name in MSG: "Frame: QUAD/X"."""

SYSTEM_ID_PARAMETERS = ("MAV_SYSID", "SYSID_THISMAV")
"""Parameters with the MAVLink system id: from ArduPilot 4.7 on, and before."""

MAX_SYSTEM_ID = 255
"""Largest MAVLink system id; 0 means all."""


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
    content, recording = _recording(path)
    vehicle = _vehicle(recording, source, content)
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
    content, recording = _recording(path)
    recording = _without_old_blocks(recording, _logged_messages(recording), content).recording
    logged_tables = {name: usable_fields(recording.decode(name)) for name in recording.counts}
    tables, _ = _on_boot_clock(logged_tables, _log_clock(logged_tables))
    return tables


class _Content(NamedTuple):
    """A file, and what it holds."""

    content: FileContent
    """Its bytes; none of a text log."""

    recording: DataflashRecording
    """The log, whose messages are not decoded yet."""


def _recording(path: PathName) -> _Content:
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
        settings: Name and value of each time that a parameter was logged, in the order of the log.

    Returns:
        Both by name.
    """
    # A dictionary keeps the last of several values under one name: that of the reversed list is the first.
    last_values = dict(settings)
    first_values = dict(reversed(settings))
    changed_first_values = {
        name: value for name, value in first_values.items() if value != last_values[name]
    }
    return _ParameterValues(last_values, changed_first_values)


def _vehicle(recording: DataflashRecording, source: str, content: FileContent) -> Telemetry:
    """Makes the vehicle of a recording: its messages on the boot clock, in MAVLink's vocabulary, and its parameters.

    Args:
        recording: The log, whose messages are decoded here.
        source: Name of the file.
        content: Its bytes; none of a text log.

    Returns:
        The vehicle, with what was repaired: damaged bytes, old blocks, clock and units.

    Raises:
        Unreadable: It has no message of a flight.
    """
    recording, logged_tables, clock, block_repairs = _without_old_blocks(
        recording, _logged_messages(recording), content
    )
    tables, clock_repairs = _on_boot_clock(logged_tables, clock)
    if not any(len(tables[name]["time"]) for name in FLIGHT_MESSAGES if name in tables):
        raise _error_without_flight(recording, source)
    texts = field_texts(logged_tables["MSG"].columns, "Message")
    parameter_columns = logged_tables["PARM"].columns
    parameter_names = field_texts(parameter_columns, "Name")
    parameters, initial_parameters = _last_and_changed_first_values(
        _finite_values(parameter_names, parameter_columns, "Value")
    )
    vehicle_kind = _mav_type(texts, parameters)
    messages, source_names, unit_repairs = mavlink_messages(
        tables, mavlink_constant(f"MAV_TYPE_{vehicle_kind}"), parameters
    )
    for name, (source_name, columns) in raw_samples(tables, parameters).items():
        messages[name] = columns
        source_names[name] = source_name
    dropouts = _lost_messages(recording)
    skipped_bytes = recording.bytes_skipped
    unreadable_messages = sum(table.unreadable for table in logged_tables.values())
    return Telemetry(
        system=_system_id(parameters),
        component=AUTOPILOT_COMPONENT,
        vehicle=UNNAMED if vehicle_kind == "GENERIC" else vehicle_kind,
        autopilot="ARDUPILOTMEGA",
        messages=messages,
        parameters=parameters,
        source=source,
        repairs=(
            *recording.repairs,
            *repair_facts(Repair.BYTES_SKIPPED, count=skipped_bytes, part="message"),
            *repair_facts(
                Repair.LOGGED_MESSAGES_LEFT_OUT,
                count=unreadable_messages,
                flaw=Flaw.UNREADABLE_NUMBER,
            ),
            *block_repairs,
            *clock_repairs,
            *unit_repairs,
            *repair_facts(Repair.LOGGER_WITHOUT_ROOM, count=dropouts),
        ),
        translated_from="DataFlash",
        firmware=_firmware(texts),
        dropouts=dropouts,
        source_names=source_names,
        board=board_number_in_texts(texts),
        hardware=board_name_in_texts(texts),
        initial_parameters=initial_parameters,
        default_parameters=dict(_finite_values(parameter_names, parameter_columns, "Default")),
    )


def _error_without_flight(recording: DataflashRecording, source: str) -> Unreadable:
    """Returns the error that explains why a log has no message of a flight.

    Either it is a log of PX4 from before ULog, which has the same format; or most of its messages have no definition;
    or it has other messages, or none at all.

    Args:
        recording: The log, which has none of ``FLIGHT_MESSAGES``.
        source: Name of the file.

    Returns:
        The error to raise.
    """
    if "StartTime" in recording.decode("TIME").columns:
        return Unreadable(SourceFact.PX4_LOG_BEFORE_ULOG, path=source)
    names = sorted(recording.counts)
    undefined_messages = recording.undefined_messages
    # Messages without a definition count as skipped bytes. In random data the two bytes of their marker would occur
    # once in 65536 bytes, not at least once in every ``MAX_MESSAGE_BYTES``.
    if (
        undefined_messages * MAX_MESSAGE_BYTES > recording.bytes_skipped
        and undefined_messages > len(names)
    ):
        return Unreadable(
            SourceFact.DATAFLASH_WITHOUT_DEFINITIONS, path=source, count=undefined_messages
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


class _LogClock(NamedTuple):
    """The n messages with a stamp of all names, in the order of the log."""

    names: tuple[str, ...]
    """Names of these messages."""

    positions: Integers
    """Position (n,) of each."""

    seconds: Array
    """Its stamp (n,), s."""

    rows: Mapping[str, Integers]
    """Row of each message of a name among these, by the name."""


class _KeptMessages(NamedTuple):
    """A log without the blocks of other logs in it."""

    recording: DataflashRecording
    """The log, which decodes only messages of its own."""

    logged: dict[str, MessageTable]
    """Its messages that are translated, by name."""

    clock: _LogClock
    """Their stamps."""

    repairs: Facts
    """What was left out."""


def _log_clock(logged_tables: Mapping[str, MessageTable]) -> _LogClock:
    """Merges the stamps of all messages into one clock, in the order of the log.

    ``MESSAGES_WITH_OLD_STAMPS`` are left out: their stamps may be older than the messages before them.

    Args:
        logged_tables: Decoded messages by name.

    Returns:
        Names of the messages with stamps, positions in the file and times, s, of all N stamps in the order of the log,
        and for each name the rows of its messages among these.
    """
    stamps = _stamps_of_messages(logged_tables)
    names = tuple(name for name in stamps if name not in MESSAGES_WITH_OLD_STAMPS)
    if not names:
        return _LogClock((), np.zeros(0, dtype=np.int64), np.zeros(0), {})
    positions = np.concatenate([logged_tables[name].position for name in names])
    order = np.argsort(positions, kind="stable")
    seconds = np.concatenate([stamps[name] for name in names])
    # The inverse permutation: the row in the order of the log of each stamp in the order of the names.
    row_of_message = np.empty(len(order), dtype=np.int64)
    row_of_message[order] = np.arange(len(order))
    message_counts = [len(logged_tables[name].position) for name in names]
    rows = np.split(row_of_message, np.cumsum(message_counts)[:-1])
    return _LogClock(names, positions[order], seconds[order], dict(zip(names, rows, strict=True)))


def _without_old_blocks(
    recording: DataflashRecording, logged_tables: dict[str, MessageTable], content: FileContent
) -> _KeptMessages:
    """Leaves out the blocks of a log that belong to another recording (``other_recordings``), such as an older file.

    Args:
        recording: The log, whose messages are located.
        logged_tables: Its translated messages, by name.
        content: The bytes of the file; empty for a text log.

    Returns:
        The messages outside these blocks, with their clock, and a repair that reports the blocks.
    """
    clock = _log_clock(logged_tables)
    if not clock.names:
        return _KeptMessages(recording, logged_tables, clock, ())
    blocks = blocks_of_other_recordings(
        StampedMessages(clock.positions, clock.seconds, content),
        recording.decode("FMT").position,
        _boot_times_in_utc(logged_tables),
        DATAFLASH_RULES,
    )
    if not blocks:
        return _KeptMessages(recording, logged_tables, clock, ())

    def decode(name: str) -> MessageTable:
        """Decodes the messages of one name outside of the blocks."""
        table = recording.decode(name)
        is_kept = outside_blocks(blocks, table.position)
        columns = {field: values[is_kept] for field, values in table.columns.items()}
        return table._replace(position=table.position[is_kept], columns=columns)

    recording_without_blocks = recording._replace(decode=decode)
    # The last block may reach to the end of the file, whose offset is not a real one (``END_OF_FILE``).
    last_position = int(clock.positions.max())
    repairs = repair_facts(
        Repair.OLD_BLOCKS_LEFT_OUT,
        count=len(blocks),
        size=sum(min(block.end, last_position) - block.start for block in blocks),
        duration=sum(block.duration for block in blocks),
    )
    messages = _logged_messages(recording_without_blocks)
    return _KeptMessages(recording_without_blocks, messages, _log_clock(messages), repairs)


def _boot_times_in_utc(logged_tables: Mapping[str, MessageTable]) -> BootTimesInUtc:
    """Computes from messages of the GPS the UNIX time at which the boot clock read 0.

    Args:
        logged_tables: Decoded messages by name, with GPS.

    Returns:
        Positions of N such messages in the file, and the UNIX time, s, by each of them.
    """
    positions = logged_tables["GPS"].position
    columns = logged_tables["GPS"].columns
    stamps = _stamps_of_messages({"GPS": logged_tables["GPS"]}).get("GPS")
    if stamps is None or not {"Status", "GMS", "GWk"} <= columns.keys():
        return BootTimesInUtc(np.zeros(0, dtype=np.int64), np.zeros(0))
    has_time = (columns["Status"] >= STATUS_3D_FIX) & (columns["GWk"] > 0)
    utc_at_boot = satellite_utc(columns["GWk"], columns["GMS"]) - stamps
    has_time &= np.isfinite(utc_at_boot)
    return BootTimesInUtc(positions[has_time], utc_at_boot[has_time])


def _stamps_of_messages(logged_tables: Mapping[str, MessageTable]) -> dict[str, Array]:
    """Returns the stamps of the messages that have any, s, by name.

    Args:
        logged_tables: Decoded messages by name.

    Returns:
        Stamps (n,), s, by name of the message.
    """
    stamps: dict[str, Array] = {}
    for name, table in logged_tables.items():
        for field, units_per_second in CLOCK_FIELDS.items():
            if field in table.columns:
                stamps[name] = table.columns[field] / units_per_second
    return stamps


def _lost_messages(recording: DataflashRecording) -> int:
    """Returns how many messages the logger had no room for: DSF counts them, again with each boot."""
    counter = usable_fields(recording.decode("DSF")).columns.get("Dp", np.zeros(0))
    increases = np.maximum(np.diff(counter.astype(np.float64)), 0)
    return int(np.nansum(increases))


def _system_id(parameters: Parameters) -> int:
    """Returns the MAVLink system id that the parameters give, 1 to 255; 1 where they give none."""
    for name in SYSTEM_ID_PARAMETERS:
        if 1 <= parameters.get(name, 0) <= MAX_SYSTEM_ID:
            return int(parameters[name])
    return 1


def _firmware(texts: Sequence[str]) -> str:
    """Returns the first text that names the firmware; empty without any."""
    for text in texts:
        if _FIRMWARE.match(text):
            return text.strip()
    return ""


def _on_boot_clock(
    logged_tables: Mapping[str, MessageTable], clock: _LogClock
) -> tuple[Tables, Facts]:
    """Puts the messages that have stamps, and those of ``UNSTAMPED_MESSAGES``, on the boot clock.

    The stamps of all messages, in the order of the log, give one clock with boots counted and outliers found. Each
    message then looks up its own stamp there. Messages without a stamp are placed between their neighbours.

    Args:
        logged_tables: The messages by name.
        clock: The stamps of all of them.

    Returns:
        Their columns, with ``time`` (s) and ``boot``, and the repairs of the clock. Messages with impossible or
        outlying stamps are left out.
    """
    if not clock.names:
        return {}, ()
    stamps = _stamps_of_messages(logged_tables)
    # All messages have one clock: their stamps, in the order of the log, are read as those of one message.
    positions = clock.positions
    seconds = clock.seconds
    # As a float, or in text, a damaged stamp may be anything.
    is_impossible = ~((seconds >= 0) & (seconds <= MAX_STAMP_SECONDS))
    # In the boot clock's input, 0 means no stamp.
    seconds[is_impossible] = 0.0
    all_messages = ""
    boot_times, clock_repairs = boot_clock(
        [MessageStamps(all_messages, np.arange(len(positions)), seconds)]
    )
    time, boot = boot_times[all_messages]
    tables: dict[str, Columns] = {}
    for name, table in logged_tables.items():
        if name in clock.names:
            rows = clock.rows[name]
            table_time = time[rows]
            tables[name] = {**table.columns, "time": table_time, "boot": _boots(boot, rows)}
            # A message whose stamp was ignored has the time of the one before it: it is not to be trusted either.
            is_trusted = table_time == seconds[rows]
            if not is_trusted.all():
                tables[name] = selected_rows(tables[name], is_trusted)
        elif name in UNSTAMPED_MESSAGES and len(table.position):
            # The row of the stamped message after each.
            rows = np.searchsorted(positions, table.position)
            tables[name] = _placed_by_neighbours(name, table, stamps.get(name), rows, time, boot)
    count = np.count_nonzero(is_impossible)
    impossible_stamps = repair_facts(
        Repair.LOGGED_MESSAGES_LEFT_OUT, count=count, flaw=Flaw.IMPOSSIBLE_STAMP
    )
    return tables, impossible_stamps + clock_repairs


def _boots(boot: Rows, rows: NDArray[np.signedinteger]) -> Rows:
    """Returns the numbers of the boots (N,) of messages in some rows; that of the only boot takes no memory."""
    if not boot.any():
        return np.broadcast_to(np.int64(0), len(rows))
    return boot[rows]


def _placed_by_neighbours(
    name: str,
    table: MessageTable,
    stamps: Array | None,
    next_rows: NDArray[np.signedinteger],
    time: Array,
    boot: Rows,
) -> Columns:
    """Gives times to messages that have no stamps, or old ones, by the stamped messages before and after them.

    A message was logged between its stamped neighbours in the file. If it has a stamp, this is clipped to the interval
    between them; but a text (MSG) before all stamped messages keeps its earlier stamp. Without a stamp, a message gets
    the time of the neighbour before it. Only the event of arming gets that of the neighbour after it: by default
    nothing is logged while the vehicle is disarmed, and arming ends this gap.

    Args:
        name: Name of the messages.
        table: The messages (N,).
        stamps: Their stamps (N,), s; None if they have none.
        next_rows: Row (N,) of the first stamped message after each, in the order of the log.
        time: Times (S,) of all stamped messages on the boot clock, s.
        boot: Numbers (S,) of their boots.

    Returns:
        The columns with ``time`` and ``boot``.
    """
    row_before = np.maximum(next_rows - 1, 0)
    row_after = np.minimum(next_rows, len(time) - 1)
    if stamps is None:
        is_arming = np.isin(table.columns.get("Id", 0), ARMING_EVENTS)
        ends_gap = (name == "EV") & is_arming & (boot[row_after] == boot[row_before])
        # Clipped to the times of the neighbours, below.
        stamps = np.where(ends_gap, np.inf, -np.inf)
    earliest = time[row_before]
    if name == "MSG":
        # A text from before the beginning of the log, such as that of arming, keeps the time at which it was sent.
        earliest = np.where((next_rows == 0) & (stamps > 0), 0.0, earliest)
    latest = np.maximum(time[row_after], earliest)
    return {
        **table.columns,
        "time": np.clip(stamps, earliest, latest),
        "boot": boot[row_before],
    }


def _finite_values(
    names: Sequence[str], parameter_columns: Columns, field: str
) -> list[tuple[str, float]]:
    """Returns name and value of each parameter with a finite value, in the order of the log.

    Args:
        names: Name (N,) of the parameter in each message PARM.
        parameter_columns: Columns (N,) of PARM.
        field: "Value", or "Default", which only newer firmware logs; without the field there are no values.
    """
    values = parameter_columns.get(field, np.zeros(0)).astype(float).tolist()
    return [(name, value) for name, value in zip(names, values, strict=False) if isfinite(value)]


def _mav_type(texts: Sequence[str], parameters: Parameters) -> str:
    """Finds out the kind of vehicle, which a DataFlash log does not state as such.

    The name of the firmware tells whether it is a copter, a plane and so on. The number of a copter's motors follows
    from the parameter FRAME_CLASS, or else from the frame that a text names.

    Args:
        texts: The texts of MSG, which name firmware and frame.
        parameters: The autopilot's parameters by name.

    Returns:
        MAV_TYPE without its prefix ("QUADROTOR"). It is GENERIC_MULTIROTOR for a copter whose frame is not known,
        GENERIC for a vehicle that is not.
    """
    kind = "GENERIC"
    firmware = _FIRMWARE.match(_firmware(texts))
    if firmware is not None:
        kind = FIRMWARES[firmware[1].lower()]
    elif "FRAME_CLASS" in parameters and "ATC_RAT_RLL_P" in parameters:
        # Only copters have both parameters.
        kind = FIRMWARES["copter"]
    if kind != FIRMWARES["copter"]:
        return kind
    if "FRAME_CLASS" in parameters:
        frame_class = int(parameters["FRAME_CLASS"])
        if 0 <= frame_class < len(FRAME_CLASSES):
            return FRAME_CLASSES[frame_class]
        return "GENERIC_MULTIROTOR"
    for text in texts:
        frame = _FRAME.match(text)
        if frame is not None:
            return FRAME_NAMES.get(frame[1], "GENERIC_MULTIROTOR")
    return "GENERIC_MULTIROTOR"
