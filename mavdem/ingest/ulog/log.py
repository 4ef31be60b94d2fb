"""PX4's own logs (.ulg): topics on the boot clock, translated to MAVLink's messages by ``px4_topics``.

``framing`` first finds the whole messages of the file; pyulog decodes only these. Given a damaged file, pyulog prints,
loses what follows, or fails.
"""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from math import isfinite

import numpy as np
from pyulog import ULog

from mavdem.errors import Unreadable
from mavdem.ingest.contents import file_bytes
from mavdem.ingest.log import Log, listed, log_of_vehicles, repair_sentences
from mavdem.ingest.mavlink.definitions import enum_name
from mavdem.ingest.mavlink.framing import Progress
from mavdem.ingest.px4_topics import NEEDED, Px4Topic, mav_type, messages, names
from mavdem.ingest.telemetry import Columns, Telemetry, joined, rate_without_gaps, rows_by, selected
from mavdem.ingest.ulog.framing import MAGIC, WholeMessages, whole_messages
from mavdem.ingest.vocabulary import PX4, UNNAMED, version_text


def read_ulog(path: str | os.PathLike[str], progress: Progress | None = None) -> Log:
    """Reads a ULog file; a damaged one as far as possible. It has one vehicle, PX4's.

    In the ``Log``, ``frames`` counts the whole messages of the file. There are no receive times. Raises Unreadable: the
    file cannot be opened, is no ULog, or contains none of the flight's topics.
    """
    source, content = os.fspath(path), file_bytes(path)
    if not content.startswith(MAGIC):
        raise Unreadable(f"{source} is no PX4 ULog: name a file that PX4's logger wrote (.ulg).")
    found = whole_messages(content, {name.encode() for name in NEEDED}, source, progress)
    log = ULog(io.BytesIO(found.content))
    values = [*log.initial_parameters.items(), *((name, value) for _, name, value in log.changed_parameters)]
    # The last finite value of each.
    parameters = {name: float(value) for name, value in values if isinstance(value, int | float) and isfinite(value)}
    topics = _topics(log, found)
    kind = mav_type(topics, parameters)
    vehicle = enum_name("MAV_TYPE", kind) if kind is not None else UNNAMED
    made = messages(topics, parameters, vehicle, kind)
    if "EXTENDED_SYS_STATE" in made:
        made["EXTENDED_SYS_STATE"] = _each_second(made["EXTENDED_SYS_STATE"], topics)
    if not made:
        raise Unreadable(f"{source} is a ULog without the topics of a flight: {_instead(content, source, found)}")
    telemetry = Telemetry(
        system=_id(parameters, "MAV_SYS_ID"),
        component=_id(parameters, "MAV_COMP_ID"),
        vehicle=vehicle,
        autopilot=enum_name("MAV_AUTOPILOT", PX4),
        messages=made,
        parameters=parameters,
        source=source,
        repairs=(*_damage(found), *_interpolated(topics, made)),
        translated_from="ULog",
        names=names(topics, made),
        firmware=_firmware(log.msg_info_dict),
        dropouts=len(found.dropouts),
        board=str(log.msg_info_dict.get("sys_uuid", "")).lower(),
    )
    if progress is not None:
        progress(1.0)
    return log_of_vehicles((telemetry,), found.messages, found.bytes_skipped)


def _instead(content: bytes, source: str, found: WholeMessages) -> str:
    """What a ULog holds that is not a flight's."""
    log = ULog(io.BytesIO(whole_messages(content, None, source).content))
    held = {topic.name for topic in log.data_list if len(topic.data["timestamp"])}
    if not held:
        wrong = found.damaged or found.cut or found.crowded
        return "it is damaged or cut off at its beginning." if wrong else "nothing was logged in it."
    state = (
        "is damaged," if found.damaged or found.crowded else "is cut off at its end," if found.cut else "is intact, but"
    )
    return (
        f"the file {state} holds neither attitude nor motor outputs (its topics: {listed(held)}); in PX4 log "
        "vehicle_attitude, vehicle_angular_velocity and actuator_motors (the parameter SDLOG_PROFILE)."
    )


def _topics(log: ULog, found: WholeMessages) -> dict[str, dict[int, Px4Topic]]:
    """Topics by name and instance, in the order of their time stamps, without wrong stamps."""
    parts: dict[tuple[str, int], list[Columns]] = {}
    rows = rows_by(found.topic)
    for data in log.data_list:
        kept = ~found.wrong_stamp[rows[data.msg_id]]
        # A topic that was subscribed to twice continues under another number.
        parts.setdefault((data.name, data.multi_id), []).append(selected(data.data, kept))
    topics: dict[str, dict[int, Px4Topic]] = {}
    for (name, instance), pieces in parts.items():
        fields = joined(pieces)
        fields = selected(fields, np.argsort(fields["timestamp"], kind="stable"))
        if len(fields["timestamp"]):
            topics.setdefault(name, {})[instance] = fields | {"time": fields["timestamp"].astype(np.float64) / 1e6}
    return topics


def _each_second(state: Columns, topics: dict[str, dict[int, Px4Topic]]) -> Columns:
    """A state that old PX4 logged at its changes only, repeated at the first message of each second without it."""
    logged = np.unique(np.concatenate([topic["time"] for group in topics.values() for topic in group.values()]))
    _, first = np.unique(np.floor(logged), return_index=True)
    last = np.searchsorted(state["time"], logged[first], side="right") - 1
    missing = (last >= 0) & (logged[first] - state["time"][np.maximum(last, 0)] > 1.0)
    rows = np.sort(np.concatenate([np.arange(len(state["time"])), last[missing]]))
    return selected(state, rows) | {"time": np.union1d(state["time"], logged[first][missing])}


def _firmware(information: Mapping[str, object]) -> str:
    """PX4's version and the first digits of its commit, as far as they were logged: "PX4 v1.16.0 (94cb2012)"."""
    version, commit = information.get("ver_sw_release"), information.get("ver_sw")
    number = f" v{version_text(version)}" if isinstance(version, int) and 0 <= version < 1 << 32 else ""
    return f"PX4{number} ({commit[:8]})" if isinstance(commit, str) else f"PX4{number}"


def _id(parameters: dict[str, float], name: str) -> int:
    """A MAVLink id; 1, PX4's default, where there is none."""
    value = parameters.get(name, 1.0)
    return int(value) if 1 <= value <= 255 else 1


def _damage(found: WholeMessages) -> tuple[str, ...]:
    wrong = int(np.count_nonzero(found.wrong_stamp))
    places, subscriptions = _times(found.damaged, "place"), _times(found.crowded, "subscription")
    lasted = found.dropouts / 1e3  # PX4's logger records the duration, not what is missing
    return repair_sentences(
        (
            found.damaged,
            f"The file is damaged in {places}: {found.bytes_skipped} bytes that belong to no message were skipped.",
        ),
        (found.cut, f"Left out: {_times(found.cut, 'message')} cut off by the end of the file or of a part of it."),
        (wrong, f"Left out: {_times(wrong, 'message')} with a time stamp far from those around it."),
        (found.crowded, f"Left out: {subscriptions} to more topics, or larger ones, than PX4 has."),
        (
            len(lasted),
            f"The logger dropped out {_times(len(lasted), 'time')}, for {lasted.sum():.3g} s in all and "
            f"{lasted.max(initial=0):.3g} s at most: messages of these times are missing.",
        ),
    )


def _interpolated(topics: dict[str, dict[int, Px4Topic]], messages: dict[str, Columns]) -> tuple[str, ...]:
    """Attitude that was interpolated between samples, where the body rates were logged clearly more often."""
    logged = [topic["time"] for topic in topics.get("vehicle_attitude", {}).values()]
    made = messages.get("ATTITUDE_QUATERNION", {"time": np.zeros(0)})["time"]
    if len(made) <= 1.1 * max(map(len, logged), default=0):
        return ()
    attitude, rates = (rate_without_gaps(np.diff(time)) for time in (max(logged, key=len), made))
    return (
        f"Attitude was logged at {attitude:.3g} Hz and body rates at {rates:.3g} Hz: attitude was interpolated at the "
        "timestamps of the body rates.",
    )


def _times(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
