"""PX4's logs (.ulg, ULog): reading topics on the boot clock, as MAVLink messages.

Damage is left out by ``ulog_records``. There are no checksums: a flipped value stays. ``ulog_topics`` decodes the data,
``ulog_other_records`` the rest, and ``px4_translation`` translates the topics.
Layout: https://docs.px4.io/main/en/dev_log/ulog_file_format.html.
"""

import os
from collections.abc import Iterable, Mapping, Sequence
from math import isfinite

import numpy as np

from mavdem.errors import Unreadable
from mavdem.facts import Facts
from mavdem.facts.sources import Flaw, Repair, SourceFact
from mavdem.files import PathName
from mavdem.ingest.contents import file_content
from mavdem.ingest.mavlink.clock_readings import outlier_stamps
from mavdem.ingest.mavlink.dialect import mavlink_constant
from mavdem.ingest.px4_topics import Topics
from mavdem.ingest.px4_translation import attitude_repairs, messages_of_topics
from mavdem.ingest.telemetry import (
    MICROSECONDS,
    Columns,
    Fields,
    Log,
    Parameters,
    Telemetry,
    concatenated_columns,
    log_of_vehicles,
    repair_facts,
    selected_rows,
)
from mavdem.ingest.ulog_other_records import (
    LoggedText,
    OtherRecords,
    is_of_later_format,
)
from mavdem.ingest.ulog_records import SoundRecords, sound_records
from mavdem.ingest.ulog_topics import LoggedTopic, parse_records
from mavdem.ingest.vocabulary import version_text
from mavdem.log_formats import FORMAT_SIGNATURES, Format

MAGIC = FORMAT_SIGNATURES[Format.ULOG].first_bytes
"""First bytes of a ULog file."""

MILLISECONDS = 1e3
"""Milliseconds in a second: the unit of the dropouts."""

DEFAULT_ID = 1
"""PX4's default of the parameters MAV_SYS_ID and MAV_COMP_ID."""

MAX_ID = 255
"""Largest MAVLink id."""

MAX_SILENCE_SECONDS = 86_400
"""Longest silence within a log, s: some topics are logged at least each second, so that a day is no silence."""


def read_ulog(path: PathName) -> Log:
    """Reads a ULog file, a damaged one as far as possible.

    Args:
        path: The file.

    Returns:
        The log of one vehicle, PX4's. Its ``frames`` are the file's data messages and texts. There are no receive
        times.

    Raises:
        Unreadable: The file cannot be opened, is no ULog, or contains none of the flight's topics.
    """
    source = os.fspath(path)
    records = _sound_records_of(path)
    loss = records.loss
    parsed_records = parse_records(records)
    other_records = parsed_records.other
    parameters, initial_parameters = _last_and_changed_first_values(other_records)
    topics, outlier_count = _cleaned_topics(
        parsed_records.topics, other_records.start_stamp / MICROSECONDS
    )
    translation = messages_of_topics(topics, parameters)
    messages = translation.messages
    if not messages:
        topic_names = sorted({topic.name for topic in parsed_records.topics})
        raise Unreadable(
            SourceFact.ULOG_WITHOUT_FLIGHT,
            path=source,
            names=topic_names,
            damaged=loss.lost_bytes > 0,
            is_px4=other_records.information.get("sys_name") == "PX4",
        )
    attitude_notes = attitude_repairs(topics, messages)
    if other_records.texts:
        messages["STATUSTEXT"] = _status_texts(other_records.texts)
    messages["PARAM_VALUE"] = _parameter_values(other_records)
    information = other_records.information
    telemetry = Telemetry(
        system=_mavlink_id(parameters, "MAV_SYS_ID"),
        component=_mavlink_id(parameters, "MAV_COMP_ID"),
        vehicle=translation.vehicle,
        autopilot="PX4",
        messages=messages,
        parameters=parameters,
        source=source,
        repairs=(*_file_repairs(other_records, records, outlier_count), *attitude_notes),
        translated_from="ULog",
        initial_parameters=initial_parameters,
        default_parameters=_default_parameters(other_records),
        source_names=translation.topic_names,
        firmware=_firmware_name(information),
        dropouts=len(other_records.dropout_durations),
        board=_board_number(information),
        hardware=str(information.get("ver_hw", "")),
    )
    frames = parsed_records.data_records + len(other_records.texts)
    return log_of_vehicles((telemetry,), frames, bytes_skipped=0)


def all_topics(path: PathName) -> dict[str, dict[int, Fields]]:
    """Reads all topics of a ULog file, with all their numeric fields.

    Args:
        path: A log that ``read_ulog`` can read.

    Returns:
        Columns with ``time``, s since boot, by topic and by number of the instance.
    """
    parsed_records = parse_records(_sound_records_of(path), has_all_fields=True)
    start = parsed_records.other.start_stamp / MICROSECONDS
    topics, _ = _cleaned_topics(parsed_records.topics, start)
    fields_by_topic = {}
    for name, instances in topics.items():
        fields_by_topic[name] = {number: dict(columns) for number, columns in instances.items()}
    return fields_by_topic


def _sound_records_of(path: PathName) -> SoundRecords:
    """Opens a ULog file and finds its sound records.

    Args:
        path: Path of the file.

    Returns:
        The sound records, with a summary of what was left out.

    Raises:
        Unreadable: The file cannot be opened, is no ULog, is cut in its header or its flags record, or is of a later
            version of the format.
    """
    source = os.fspath(path)
    content = file_content(path)
    if content[: len(MAGIC)] != MAGIC:
        raise Unreadable(SourceFact.FORMAT_UNKNOWN, path=source, name="ulog")
    try:
        records = sound_records(content)
    except EOFError:
        raise Unreadable(
            SourceFact.ULOG_WITHOUT_FLIGHT, path=source, names=(), damaged=True, is_px4=False
        ) from None
    if is_of_later_format(records):
        raise Unreadable(SourceFact.ULOG_OF_LATER_FORMAT, path=source)
    return records


def _last_and_changed_first_values(other_records: OtherRecords) -> tuple[Parameters, Parameters]:
    """Collects the parameters with a finite value: those at the end of the log, and those before they were changed.

    Args:
        other_records: The records with the parameters' values when the logger began, and with each later setting.

    Returns:
        The last value of each parameter by its name, and the first value of those that ended with another one.
    """
    initial_values = {
        name: value for name, value in other_records.initial_settings.items() if isfinite(value)
    }
    last_values = dict(initial_values)
    for setting in other_records.changed_settings:
        if isfinite(setting.value):
            last_values[setting.name] = setting.value
    changed_first_values = {
        name: value for name, value in initial_values.items() if value != last_values[name]
    }
    return last_values, changed_first_values


def _status_texts(texts: Sequence[LoggedText]) -> Columns:
    """Makes STATUSTEXT from the N texts that PX4 logged.

    Their level is the ASCII character of a digit, 0 to 7, as in syslog; MAV_SEVERITY has the same numbers.

    Args:
        texts: The texts in the order of the log.

    Returns:
        Columns (N,) severity, text, ``time``, s, and ``boot``, 0 throughout.
    """
    levels = np.array([text.level for text in texts])
    stamps = np.array([text.stamp for text in texts])
    return {
        "severity": (levels - ord("0")).astype(np.uint8),
        "text": np.array([text.text for text in texts], dtype=object),
        "time": stamps / MICROSECONDS,
        "boot": np.zeros(len(texts), dtype=np.int64),
    }


def _parameter_values(other_records: OtherRecords) -> Columns:
    """Makes PARAM_VALUE from the parameters' values when the logger began, and one for each later setting.

    All are of the type float32, also integer parameters. So PX4's encoding of integers as the bits of a float does not
    apply when they are decoded.

    Args:
        other_records: The records with the parameters.

    Returns:
        Columns (N,) of the N settings in the order of the log, ``time`` in s.
    """
    # The values when the logger began come first, all of the same time.
    stamps = []
    names = []
    values = []
    for name, value in other_records.initial_settings.items():
        stamps.append(other_records.start_stamp)
        names.append(name)
        values.append(value)
    for setting in other_records.changed_settings:
        stamps.append(setting.stamp)
        names.append(setting.name)
        values.append(setting.value)
    return {
        "time": np.array(stamps, np.float64) / MICROSECONDS,
        "boot": np.zeros(len(names), np.int64),
        "param_id": np.array([name.encode() for name in names], np.object_),
        "param_value": np.array(values, np.float32),
        "param_type": np.full(len(names), mavlink_constant("MAV_PARAM_TYPE_REAL32")),
    }


def _mavlink_id(parameters: Parameters, name: str) -> int:
    """Returns the MAVLink id that a parameter gives, 1 to 255; otherwise PX4's default."""
    value = parameters.get(name, DEFAULT_ID)
    return int(value) if 1 <= value <= MAX_ID else DEFAULT_ID


def _default_parameters(other_records: OtherRecords) -> dict[str, float]:
    """Returns the default values of parameters: of the chosen airframe or, if the log has none, of the firmware.

    PX4 logs only defaults that differ from the values in use. A value that the airframe sets is no change by the user,
    so the firmware's default is not used if the log has the airframe's.

    Args:
        other_records: The records with the defaults.

    Returns:
        Values by the name of the parameter.
    """
    defaults = other_records.airframe_defaults or other_records.firmware_defaults
    return {name: value for name, value in defaults.items() if isfinite(value)}


def _cleaned_topics(logged_topics: Sequence[LoggedTopic], start: float) -> tuple[Topics, int]:
    """Returns the topics that mavdem reads, sorted by time and without messages whose stamps are far from all others.

    A topic is a type of message of PX4, such as ``vehicle_attitude``. It has several instances if, for example, a
    vehicle has two batteries. The first message of each topic is a special case: when logging starts, PX4 logs the
    topic's latest message, whose stamp may be long past. It is kept, since it is valid at the start, and its time is
    moved to the start of the log.

    Args:
        logged_topics: The data records of each subscription.
        start: Start of the logging, s since boot.

    Returns:
        The topics by name and number of the instance, each with ``time``, s since boot; and the number of messages that
        were left out.
    """
    topics: dict[str, dict[int, Columns]] = {}
    outlier_count = 0
    fields_by_instance = _fields_by_instance(logged_topics)
    first_stamp, last_stamp = _span_without_long_silence(fields_by_instance.values())
    for (name, instance), fields in fields_by_instance.items():
        stamps = fields["timestamp"]
        is_outlier = outlier_stamps(stamps / MICROSECONDS)
        is_outlier |= (stamps < first_stamp) | (stamps > last_stamp)
        # The first message may be long past, and is never an outlier.
        is_outlier[:1] = False
        outlier_count += int(np.count_nonzero(is_outlier))
        if is_outlier.any():
            fields = selected_rows(fields, ~is_outlier)
        topics.setdefault(name, {})[instance] = _with_ascending_time(fields, start)
    return topics, outlier_count


def _fields_by_instance(logged_topics: Sequence[LoggedTopic]) -> dict[tuple[str, int], Columns]:
    """Joins the subscriptions to the same instance of a topic, under which its records continue one after the other.

    Args:
        logged_topics: The data records of each subscription; those without stamps are left out.

    Returns:
        Columns (N,) by the name of the topic and the number of the instance.
    """
    tables_by_instance: dict[tuple[str, int], list[Columns]] = {}
    for topic in logged_topics:
        stamps = topic.columns.get("timestamp", np.zeros(0))
        if stamps.dtype == np.uint64:
            tables = tables_by_instance.setdefault((topic.name, topic.instance), [])
            tables.append(topic.columns)
    return {key: concatenated_columns(tables) for key, tables in tables_by_instance.items()}


def _with_ascending_time(fields: Columns, start: float) -> Columns:
    """Sorts the messages of a topic by their stamps, and adds their ``time``, s since boot.

    Args:
        fields: Columns (N,) of the topic by name, at least one message, with ``timestamp``, µs.
        start: Start of the logging, s since boot. The time of the first message, which may be long past, is moved to
            it, but not beyond the second message.
    """
    stamps = fields["timestamp"]
    if np.any(stamps[1:] < stamps[:-1]):
        fields = selected_rows(fields, np.argsort(stamps, kind="stable"))
    time = fields["timestamp"] / MICROSECONDS
    # The logger writes the latest message of each topic first, which may have been sent long before it started.
    second_time = time[1] if len(time) > 1 else np.inf
    time[0] = np.clip(start, time[0], second_time)
    return {**fields, "time": time}


def _span_without_long_silence(tables: Iterable[Columns]) -> tuple[int, int]:
    """Returns the first and the last stamp of a log, without parts whose stamps are wrong by a day or more.

    The clock of a boot does not jump. If it pauses for longer than ``MAX_SILENCE_SECONDS``, the stamps on one side are
    wrong, as in a file that was put together of several logs. Of several parts the one with most messages is the log.

    Args:
        tables: columns of each topic, with ``timestamp``, µs. The first message of a topic may be long past, and does
            not count.

    Returns:
        Both stamps, µs; 0 and the largest possible stamp if no message counts.
    """
    counted_stamps = [table["timestamp"][1:] for table in tables if len(table["timestamp"]) > 1]
    if not counted_stamps:
        return 0, np.iinfo(np.uint64).max
    earliest_stamp = min(int(stamps.min()) for stamps in counted_stamps)
    latest_stamp = max(int(stamps.max()) for stamps in counted_stamps)
    max_silence = MAX_SILENCE_SECONDS * MICROSECONDS
    if latest_stamp - earliest_stamp <= max_silence:
        return earliest_stamp, latest_stamp
    stamps = np.sort(np.concatenate(counted_stamps))
    later_part_starts = 1 + np.flatnonzero(np.diff(stamps) > max_silence)
    stamps_of_parts = np.split(stamps, later_part_starts)
    largest_part = max(stamps_of_parts, key=len)
    return int(largest_part[0]), int(largest_part[-1])


def _file_repairs(other_records: OtherRecords, records: SoundRecords, outlier_count: int) -> Facts:
    """Reports what is damaged or missing in a file, as facts for the user.

    Args:
        other_records: The records that are not data, with the interruptions of the logger (dropouts).
        records: The sound records, with what was left out, and whether the file is cut at its end.
        outlier_count: Number of messages that were left out because their stamps are far from all others.

    Returns:
        A fact on damaged bytes, one on a cut end, one on messages with wrong stamps, and one on interruptions; those
        that apply.
    """
    loss = records.loss
    damage = repair_facts(
        Repair.ULOG_DAMAGED,
        count=loss.lost_bytes,
        places=loss.damaged_places,
        duration=loss.lost_seconds,
    )
    cut_end = repair_facts(Repair.RECORDING_CUT) if records.is_cut else ()
    wrong_stamps = repair_facts(
        Repair.LOGGED_MESSAGES_LEFT_OUT, count=outlier_count, flaw=Flaw.FAR_STAMP
    )
    # How long the logger was interrupted, s; what it missed in that time is not known.
    durations = np.array(other_records.dropout_durations) / MILLISECONDS
    interruptions = repair_facts(
        Repair.LOGGER_DROPPED_OUT,
        count=len(durations),
        duration=durations.sum(),
        longest_gap=durations.max(initial=0),
    )
    return damage + cut_end + wrong_stamps + interruptions


def _board_number(information: Mapping[str, object]) -> str:
    """Returns the serial number of the board, hexadecimal; empty without one, or if zeros made it anonymous.

    Args:
        information: Values that the log has about the system.
    """
    number = str(information.get("sys_uuid", "")).lower()
    return number if number.strip("0") else ""


def _firmware_name(information: Mapping[str, object]) -> str:
    """Returns the name of the firmware, such as "PX4 v1.14.3 (1a2b3c4d)".

    Args:
        information: Values that the log has about the system: the version as a number of 32 bits, and the commit.
            Either may be missing, or damaged, and is left out then.
    """
    name = "PX4"
    version = information.get("ver_sw_release")
    if isinstance(version, int) and 0 <= version < 1 << 32:
        name += f" v{version_text(version)}"
    commit = information.get("ver_sw")
    if isinstance(commit, str):
        name += f" ({commit[:8]})"
    return name
