"""PX4's own logs (.ulg): topics on the boot clock, as MAVLink's messages.

Damage is left out by ``ulog_records``. There are no checksums: a flipped value stays. ``ulog_topics`` decodes the data,
pyulog the rest, and ``px4_translation`` translates the topics.
Layout: https://docs.px4.io/main/en/dev_log/ulog_file_format.html.
"""

import io
import os
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from math import isfinite
from typing import NamedTuple

import numpy as np
from pyulog import ULog, ULogIncompatibleFlagException

from mavdem.errors import Unreadable
from mavdem.facts import Facts
from mavdem.facts.sources import Flaw, Repair, SourceFact
from mavdem.files import PathName
from mavdem.ingest.contents import file_content
from mavdem.ingest.mavlink.clocks import outlier_stamps
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
from mavdem.ingest.ulog_records import RecordLoss, sound_records
from mavdem.ingest.ulog_topics import LoggedTopic, parse_records
from mavdem.ingest.vocabulary import version_text
from mavdem.log_formats import FORMAT_SIGNATURES, Format

MAGIC = FORMAT_SIGNATURES[Format.ULOG].first_bytes
"""First bytes of a ULog file."""

MILLISECONDS = 1e3
"""Milliseconds in a second: the unit of pyulog's dropouts."""

DEFAULT_ID = 1
"""PX4's default of the parameters MAV_SYS_ID and MAV_COMP_ID."""

FIRMWARE_DEFAULT = 0
"""pyulog's number of the firmware's defaults: the bit that marks them in ULog's message Q."""

AIRFRAME_DEFAULT = 1
"""pyulog's number of the defaults of the chosen airframe."""

MAX_ID = 255
"""Largest MAVLink id."""


class ParameterSetting(NamedTuple):
    """The value of a parameter from some time on."""

    stamp: int
    """When it was set, µs since boot."""
    name: str
    """Name of the parameter."""
    value: float
    """Its value; it may be NaN or infinite."""


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
    content = file_content(path)
    if content[: len(MAGIC)] != MAGIC:
        raise Unreadable(SourceFact.FORMAT_UNKNOWN, path=source, name="ulog")
    records = sound_records(content)
    loss = records.loss
    parsed_records = parse_records(records)
    log = _parsed_by_pyulog(parsed_records.other_content, source)
    initial_settings, changed_settings = _parameter_settings(log)
    settings = [*initial_settings, *changed_settings]
    parameters = {setting.name: setting.value for setting in settings if isfinite(setting.value)}
    initial_parameters = {
        setting.name: setting.value
        for setting in initial_settings
        if isfinite(setting.value) and setting.value != parameters[setting.name]
    }
    start = log.start_timestamp / MICROSECONDS
    topics, outlier_count = _topics(parsed_records.topics, start)
    translation = messages_of_topics(topics, parameters)
    messages = translation.messages
    if not messages:
        topic_names = sorted({topic.name for topic in parsed_records.topics})
        raise Unreadable(
            SourceFact.ULOG_WITHOUT_FLIGHT,
            path=source,
            names=topic_names,
            damaged=loss.lost_bytes > 0,
        )
    attitude_notes = attitude_repairs(topics, messages)
    if log.logged_messages:
        messages["STATUSTEXT"] = _status_texts(log)
    messages["PARAM_VALUE"] = _parameter_values(settings)
    information = log.msg_info_dict
    telemetry = Telemetry(
        system=_mavlink_id(parameters, "MAV_SYS_ID"),
        component=_mavlink_id(parameters, "MAV_COMP_ID"),
        vehicle=translation.vehicle,
        autopilot="PX4",
        messages=messages,
        parameters=parameters,
        source=source,
        repairs=(*_file_repairs(log, loss, outlier_count), *attitude_notes),
        translated_from="ULog",
        initial_parameters=initial_parameters,
        default_parameters=_default_parameters(log),
        source_names=translation.topic_names,
        firmware=_firmware(information),
        dropouts=len(log.dropouts),
        board=str(information.get("sys_uuid", "")).lower(),
        hardware=str(information.get("ver_hw", "")),
    )
    frames = parsed_records.data_records + len(log.logged_messages)
    return log_of_vehicles((telemetry,), frames, bytes_skipped=0)


def all_topics(path: PathName) -> dict[str, dict[int, Fields]]:
    """Reads all topics of a ULog file, with all their numeric fields.

    Args:
        path: A log that ``read_ulog`` can read.

    Returns:
        Columns with ``time``, s since boot, by topic and by number of the instance.
    """
    source = os.fspath(path)
    parsed_records = parse_records(sound_records(file_content(path)), has_all_fields=True)
    log = _parsed_by_pyulog(parsed_records.other_content, source)
    topics, _ = _topics(parsed_records.topics, log.start_timestamp / MICROSECONDS)
    return {
        name: {number: dict(columns) for number, columns in instances.items()}
        for name, instances in topics.items()
    }


def _status_texts(log: ULog) -> Columns:
    """Makes STATUSTEXT of the N texts that PX4 logged.

    Their level is the ASCII character of a digit, 0 to 7, as in syslog; MAV_SEVERITY has the same numbers.

    Args:
        log: The log, as pyulog parsed it.

    Returns:
        Columns (N,) severity, text, ``time``, s, and ``boot``, 0 throughout.
    """
    texts = log.logged_messages
    levels = np.array([text.log_level for text in texts])
    stamps = np.array([text.timestamp for text in texts])
    return {
        "severity": (levels - ord("0")).astype(np.uint8),
        "text": np.array([text.message for text in texts], dtype=object),
        "time": stamps / MICROSECONDS,
        "boot": np.zeros(len(texts), dtype=np.int64),
    }


def _parameter_values(settings: list[ParameterSetting]) -> Columns:
    """Makes PARAM_VALUE of the parameters' values when the logger began, and of each that was set later.

    All are sent as float32, whatever the parameter's type, so that they are decoded without PX4's copying of bits.

    Args:
        settings: Stamp, name and value of each, in the order of the log.

    Returns:
        Columns (N,) of the N settings, ``time`` in s.
    """
    stamps = np.array([setting.stamp for setting in settings], np.float64)
    names = [setting.name.encode() for setting in settings]
    values = [setting.value for setting in settings]
    return {
        "time": stamps / MICROSECONDS,
        "boot": np.zeros(len(settings), np.int64),
        "param_id": np.array(names, np.object_),
        "param_value": np.array(values, np.float32),
        "param_type": np.full(len(settings), mavlink_constant("MAV_PARAM_TYPE_REAL32")),
    }


def _mavlink_id(parameters: Parameters, name: str) -> int:
    """Returns the MAVLink id that a parameter gives, 1 to 255; otherwise PX4's default."""
    value = parameters.get(name, DEFAULT_ID)
    return int(value) if 1 <= value <= MAX_ID else DEFAULT_ID


def _parsed_by_pyulog(content: bytes, path: str) -> ULog:
    """Parses the records of a file that are not logged data, such as parameters and texts, with pyulog.

    Args:
        content: A ULog file that contains only these records.
        path: Path of the log, which the error states.

    Returns:
        The parsed log.

    Raises:
        Unreadable: The file is of a later version of the format, or its definitions are damaged or malicious.
    """
    try:
        # The library prints messages about damage.
        with redirect_stdout(io.StringIO()):
            return ULog(io.BytesIO(content))
    except ULogIncompatibleFlagException:
        raise Unreadable(SourceFact.ULOG_OF_LATER_FORMAT, path=path) from None
    except Exception:
        # Damaged definitions may make the library raise any exception. The error lists the topics that the log has,
        # of which none is known here.
        raise Unreadable(
            SourceFact.ULOG_WITHOUT_FLIGHT, path=path, names=(), damaged=True
        ) from None


def _parameter_settings(
    log: ULog,
) -> tuple[list[ParameterSetting], list[ParameterSetting]]:
    """Returns the parameters of a log: those at the start of the logger, and those that were set later.

    Values that are not numbers come from damage, and are left out.

    Args:
        log: The log, as pyulog parsed it.

    Returns:
        Settings at the start, and later settings in the order of the log.
    """
    initial = []
    for name, value in log.initial_parameters.items():
        if isinstance(value, int | float):
            initial.append(ParameterSetting(log.start_timestamp, name, float(value)))
    changed_settings = []
    for stamp, name, value in log.changed_parameters:
        if isinstance(value, int | float):
            changed_settings.append(ParameterSetting(stamp, name, float(value)))
    return initial, changed_settings


def _default_parameters(log: ULog) -> dict[str, float]:
    """Returns the default values of parameters: those of the chosen airframe or, without any, those of the firmware.

    PX4 logs only defaults that differ from the values in use. A value that the airframe sets is no change by the user,
    so the firmware's default is not used if the log has the airframe's.

    Args:
        log: The log, as pyulog parsed it.

    Returns:
        Values by the name of the parameter.
    """
    if not log.has_default_parameters:
        return {}
    logged = log.get_default_parameters(AIRFRAME_DEFAULT)
    defaults = logged or log.get_default_parameters(FIRMWARE_DEFAULT)
    return {
        name: float(value)
        for name, value in defaults.items()
        if isinstance(value, int | float) and isfinite(value)
    }


def _topics(logged_topics: Sequence[LoggedTopic], start: float) -> tuple[Topics, int]:
    """Returns the topics that mavdem reads, sorted by time and without messages whose stamps are far from all others.

    A topic is a kind of message of PX4, such as ``vehicle_attitude``; it has several instances where, say, a vehicle
    has two batteries. The first message of each topic needs care: when logging starts, PX4 logs the topic's last
    message, with its stamp, which may be long past. It is kept, since it says what held at the start, and is dated to
    the start of the log.

    Args:
        logged_topics: The data records of each subscription.
        start: Start of the logging, s since boot.

    Returns:
        The topics by name and number of the instance, each with ``time``, s since boot; and the number of messages that
        were left out.
    """
    subscriptions: dict[tuple[str, int], list[Columns]] = {}
    for topic in logged_topics:
        stamps = topic.columns.get("timestamp", np.zeros(0))
        if stamps.dtype == np.uint64:
            # A topic that was subscribed to twice continues under another number.
            subscriptions.setdefault((topic.name, topic.instance), []).append(topic.columns)
    topics: dict[str, dict[int, Columns]] = {}
    outlier_count = 0
    for (name, instance), parts in subscriptions.items():
        fields = concatenated_columns(parts)
        is_outlier = outlier_stamps(fields["timestamp"] / MICROSECONDS)
        # The first message is no outlier, however long past.
        is_outlier[:1] = False
        outlier_count += int(np.count_nonzero(is_outlier))
        if is_outlier.any():
            fields = selected_rows(fields, ~is_outlier)
        if np.any(fields["timestamp"][1:] < fields["timestamp"][:-1]):
            fields = selected_rows(fields, np.argsort(fields["timestamp"], kind="stable"))
        time = fields["timestamp"] / MICROSECONDS
        # Its stamp is moved to the start of the log, but not beyond the second message.
        second_time = time[1:2].min(initial=np.inf)
        time[0] = np.clip(start, time[0], second_time)
        topics.setdefault(name, {})[instance] = fields | {"time": time}
    return topics, outlier_count


def _file_repairs(log: ULog, loss: RecordLoss, outlier_count: int) -> Facts:
    """Reports what is damaged or missing in a file.

    Args:
        log: The parsed file, with the interruptions of the logger, whose durations are in ms.
        loss: Summary of the parts that were left out.
        outlier_count: Number of messages that were left out because their stamps are far from all others.

    Returns:
        A repair for damaged bytes, one for messages with wrong stamps, and one for interruptions of the logger.
    """
    damage = repair_facts(
        Repair.ULOG_DAMAGED,
        count=loss.lost_bytes,
        places=loss.places,
        duration=loss.lost_seconds,
    )
    # How long the logger was interrupted, s; what it missed in that time is not known.
    durations = np.array([dropout.duration for dropout in log.dropouts]) / MILLISECONDS
    return (
        *damage,
        *repair_facts(Repair.LOGGED_MESSAGES_LEFT_OUT, count=outlier_count, flaw=Flaw.FAR_STAMP),
        *repair_facts(
            Repair.LOGGER_DROPPED_OUT,
            count=len(durations),
            duration=durations.sum(),
            longest_gap=durations.max(initial=0),
        ),
    )


def _firmware(information: Mapping[str, object]) -> str:
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
