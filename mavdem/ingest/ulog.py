"""PX4's own logs (.ulg): topics as ``pyulog`` reads them, on the boot clock, as MAVLink's messages.

After damage pyulog goes on at the next message that it knows, or at the next mark of synchronisation, which PX4 writes
twice a second. There are no checksums: a flipped value stays. ``px4_topics`` translates the topics.
Layout: https://docs.px4.io/main/en/dev_log/ulog_file_format.html.
"""

import io
import os
import re
from collections.abc import Mapping
from contextlib import redirect_stdout
from functools import cache
from math import isfinite
from struct import calcsize

import numpy as np
from pymavlink.dialects.v20 import all as dialect
from pyulog import ULog, ULogIncompatibleFlagException

from mavdem.errors import Unreadable
from mavdem.facts import Facts
from mavdem.facts.sources import Flaw, Repair, Source
from mavdem.files import PathName
from mavdem.ingest.contents import file_bytes
from mavdem.ingest.mavlink.clocks import outlier_stamps
from mavdem.ingest.px4_topics import NEEDED, Topics, messages, notes
from mavdem.ingest.telemetry import (
    MAX_FIELDS,
    Columns,
    Log,
    Telemetry,
    concatenated_columns,
    log_of_vehicles,
    repair_facts,
    selected_rows,
)
from mavdem.ingest.vocabulary import version_text
from mavdem.log_formats import FORMAT_SIGNATURES, Format

MAGIC = FORMAT_SIGNATURES[Format.ULOG].first_bytes
"""First bytes of a ULog file."""
HEADER_BYTES = calcsize("<HB")  # Of each message: how long it is, and of what type


def read_ulog(path: PathName) -> Log:
    """Reads a ULog file; a damaged one as far as possible. It has one vehicle, PX4's.

    In the ``Log``, ``frames`` counts the file's data messages and texts. There are no receive times. Raises Unreadable:
    the file cannot be opened, is no ULog, or contains none of the flight's topics.
    """
    source = os.fspath(path)
    content = file_bytes(path)
    if not content.startswith(MAGIC):
        raise Unreadable(Source.FORMAT_UNKNOWN, path=source, name="ulog")
    log = _parsed(content, source)
    sent = _parameters(log)
    parameters = {name: value for _, name, value in sent if isfinite(value)}
    topics, repairs = _topics(log)
    vehicle, made, names = messages(topics, parameters)
    if not made:
        topic_names = sorted({topic.name for topic in log.data_list})
        raise Unreadable(
            Source.ULOG_WITHOUT_FLIGHT, path=source, names=topic_names, damaged=log.file_corruption
        )
    if texts := log.logged_messages:
        severity, stamps = (
            np.array([getattr(text, name) for text in texts]) for name in ("log_level", "timestamp")
        )
        made["STATUSTEXT"] = {
            "severity": (severity - ord("0")).astype(np.uint8),
            "text": np.array([text.message for text in texts], dtype=object),
            "time": stamps / 1e6,
            "boot": np.zeros(len(texts), dtype=np.int64),
        }
    times, names_sent, values = zip(*sent, strict=True) if sent else ((), (), ())
    made["PARAM_VALUE"] = {
        "time": np.array(times, np.float64) / 1e6,
        "boot": np.zeros(len(sent), np.int64),
        "param_id": np.array([name.encode() for name in names_sent], np.object_),
        "param_value": np.array(values, np.float32),
        "param_type": np.full(len(sent), dialect.MAV_PARAM_TYPE_REAL32),
    }
    ids = (parameters.get(name, 1.0) for name in ("MAV_SYS_ID", "MAV_COMP_ID"))
    # 1 is PX4's default
    system, component = (int(number) if 1 <= number <= 255 else 1 for number in ids)
    telemetry = Telemetry(
        system=system,
        component=component,
        vehicle=vehicle,
        autopilot="PX4",
        messages=made,
        parameters=parameters,
        source=source,
        repairs=(*repairs, *notes(topics, made)),
        translated_from="ULog",
        initial_parameters={
            name: old
            for _, name, old in sent[: len(log.initial_parameters)]
            if isfinite(old) and parameters[name] != old
        },
        source_names=names,
        firmware=_firmware(log.msg_info_dict),
        dropouts=len(log.dropouts),
        board=str(log.msg_info_dict.get("sys_uuid", "")).lower(),
        hardware=str(log.msg_info_dict.get("ver_hw", "")),
    )
    frames = sum(len(next(iter(topic.data.values()))) for topic in log.data_list) + len(texts)
    return log_of_vehicles((telemetry,), frames, bytes_skipped=0)


_FILL = re.compile(rb"\0{3,}|\xff{3,}")
"""What a card holds where nothing was written: no header begins so, and the library would take it byte by byte."""


class _Content(io.BytesIO):
    """A file for the library, which goes back too far, and for ever, where a damaged length goes beyond the end."""

    _message = 0
    _is_cut = False

    def read(self, size: int | None = -1) -> bytes:
        content = super().read(size)
        if size == HEADER_BYTES:
            if fill := _FILL.match(self.getbuffer(), self.tell() - len(content)):
                super().seek(fill.end())
            self._message = self.tell() - len(content)
        self._is_cut = len(content) < (size or 0)
        return content

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        offset_from_start = self.tell() + offset if whence == os.SEEK_CUR else offset
        is_again = self._is_cut and whence == os.SEEK_CUR and offset_from_start <= self._message
        return super().seek(self._message + 1 if is_again else offset_from_start)


def _parsed(content: bytes, source: str) -> ULog:
    try:
        # It prints what is damaged.
        with redirect_stdout(io.StringIO()):
            _raise_on_huge(ULog(_Content(content), parse_header_only=True).message_formats)
            return ULog(_Content(content))
    except ULogIncompatibleFlagException:
        raise Unreadable(Source.ULOG_OF_LATER_FORMAT, path=source) from None
    except Exception:  # the library may raise anything of damaged definitions
        raise Unreadable(Source.ULOG_WITHOUT_FLIGHT, path=source, names=(), damaged=True) from None


def _raise_on_huge(formats: Mapping[str, ULog.MessageFormat]) -> None:
    """Raises ValueError: a format has over ``MAX_FIELDS`` numbers; RecursionError: one has itself in it."""

    @cache
    def count(kind: str) -> int:
        fields = formats[kind].fields if kind in formats else ()
        return sum(max(length, 1) * count(kind) for kind, length, _ in fields) or 1

    if max(map(count, formats), default=0) > MAX_FIELDS:
        raise ValueError


def _parameters(log: ULog) -> list[tuple[int, str, float]]:
    """Time, µs, name and value of each parameter when the logger began, and when one was set."""
    began = [(log.start_timestamp, name, value) for name, value in log.initial_parameters.items()]
    return [
        (stamp, name, float(value))
        for stamp, name, value in (*began, *log.changed_parameters)
        if isinstance(value, int | float)
    ]


def _topics(log: ULog) -> tuple[Topics, Facts]:
    """The topics that are read, by name and number of the instance, and what was left out."""
    parts: dict[tuple[str, int], list[Columns]] = {}
    for topic in log.data_list:
        stamps = topic.data.get("timestamp", np.zeros(0))
        if topic.name in NEEDED and stamps.dtype == np.uint64:
            # A topic that was subscribed to twice continues under another number.
            parts.setdefault((topic.name, topic.multi_id), []).append(topic.data)
    topics: dict[str, dict[int, Columns]] = {}
    far: int | np.integer = 0
    for (name, instance), pieces in parts.items():
        fields = concatenated_columns(pieces)
        # When logging starts, each topic's last message, long past, is logged: what it says held then.
        wrong = outlier_stamps(fields["timestamp"] / 1e6)
        wrong[:1] = False
        far += np.count_nonzero(wrong)
        fields = selected_rows(fields, ~wrong)
        fields = selected_rows(fields, np.argsort(fields["timestamp"], kind="stable"))
        time = fields["timestamp"] / 1e6
        time[0] = np.clip(log.start_timestamp / 1e6, time[0], time[1:2].min(initial=np.inf))
        topics.setdefault(name, {})[instance] = fields | {"time": time}
    lasted = np.array([dropout.duration for dropout in log.dropouts]) / 1e3  # not what is missing
    return topics, (
        *(repair_facts(Repair.ULOG_DAMAGED) if log.file_corruption else ()),
        *repair_facts(Repair.LOGGED_MESSAGES_LEFT_OUT, count=far, flaw=Flaw.FAR_STAMP),
        *repair_facts(
            Repair.LOGGER_DROPPED_OUT,
            count=len(lasted),
            duration=lasted.sum(),
            longest_gap=lasted.max(initial=0),
        ),
    )


def _firmware(information: Mapping[str, object]) -> str:
    version = information.get("ver_sw_release")
    commit = information.get("ver_sw")
    number = (
        f" v{version_text(version)}" if isinstance(version, int) and 0 <= version < 1 << 32 else ""
    )
    return f"PX4{number} ({commit[:8]})" if isinstance(commit, str) else f"PX4{number}"
