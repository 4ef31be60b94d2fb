"""PX4's own logs (.ulg): topics on the boot clock, brought to MAVLink's messages.

What is whole in the file is found first (``ulog_framing``) and given to pyulog, which on damage prints, loses what
follows, or fails. What the topics mean is told by ``px4_topics``.
"""

from __future__ import annotations

import io
import os
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyulog import ULog

from mavdem.errors import Unreadable
from mavdem.ingest.decode import enum_name
from mavdem.ingest.files import file_bytes
from mavdem.ingest.framing import Progress
from mavdem.ingest.log import Log, Speaker
from mavdem.ingest.px4_topics import NEEDED, PX4, Topic, mav_type, messages
from mavdem.ingest.rows import rows_by
from mavdem.ingest.ulog_framing import MAGIC, Intact, intact
from mavdem.ingest.vehicles import UNNAMED
from mavdem.telemetry import Telemetry

FILLED = 1.1
"""Body rates for each attitude that was logged, above which the log says that attitude was interpolated."""


def read_ulog(path: str | os.PathLike[str], progress: Progress | None = None) -> Log:
    """Reads a ULog file, damaged ones as far as they go; one vehicle, PX4's.

    In the ``Log``, ``frames`` counts the whole messages of the file. There are no receive times.

    Args:
        path: the file, or an xz archive of it.
        progress: called with the fraction done.

    Raises:
        Unreadable: the file cannot be opened, is no ULog, or holds none of the topics that tell of the flight.
    """
    source, content = os.fspath(path), file_bytes(path)
    if not content.startswith(MAGIC):
        raise Unreadable(f"{source} is no PX4 ULog: name a file that PX4's logger wrote (.ulg).")
    found = intact(content, {name.encode() for name in NEEDED}, source, progress)
    log = ULog(io.BytesIO(found.content))
    parameters = _parameters(log)
    topics = _topics(log, found)
    kind = mav_type(topics, parameters)
    vehicle = enum_name("MAV_TYPE", kind) if kind is not None else UNNAMED
    made = messages(topics, parameters, vehicle, kind)
    if not made:
        raise Unreadable(f"{source} is a PX4 ULog without the topics that tell of a flight: {_nothing(found)}")
    system, component = _id(parameters, "MAV_SYS_ID"), _id(parameters, "MAV_COMP_ID")
    autopilot = enum_name("MAV_AUTOPILOT", PX4)
    counts = {name: len(columns["time"]) for name, columns in made.items()}
    repairs = (*_damage(found), *_dropouts(found), *_filled(topics, counts))
    telemetry = Telemetry(system, component, vehicle, autopilot, made, parameters, source, repairs, "ULog")
    speaker = Speaker(system, component, vehicle, autopilot, counts, 0)
    if progress is not None:
        progress(1.0)
    return Log(source, (telemetry,), (speaker,), (), found.messages, found.bytes_skipped, (np.nan, np.nan))


def _topics(log: ULog, found: Intact) -> dict[str, dict[int, Topic]]:
    """Topics by name and instance, in the order of their time stamps; those astray are left out."""
    parts: dict[tuple[str, int], list[dict[str, NDArray[Any]]]] = {}
    rows = rows_by(found.topic)
    for data in log.data_list:
        kept = ~found.astray[rows[data.msg_id]]
        # One that was subscribed to twice goes on under another number.
        parts.setdefault((data.name, data.multi_id), []).append({name: of[kept] for name, of in data.data.items()})
    topics: dict[str, dict[int, Topic]] = {}
    for (name, instance), pieces in parts.items():
        order = np.argsort(np.concatenate([piece["timestamp"] for piece in pieces]), kind="stable")
        common = [field for field in pieces[0] if all(field in piece for piece in pieces)]
        fields = {field: np.concatenate([piece[field] for piece in pieces])[order] for field in common}
        fields["time"] = fields["timestamp"].astype(np.float64) / 1e6
        if len(order):
            topics.setdefault(name, {})[instance] = fields
    return topics


def _parameters(log: ULog) -> dict[str, float]:
    """The last finite value of each parameter."""
    values = [*log.initial_parameters.items(), *((name, value) for _, name, value in log.changed_parameters)]
    return {name: float(value) for name, value in values if isinstance(value, int | float) and isfinite(value)}


def _id(parameters: dict[str, float], name: str) -> int:
    """A MAVLink id, 1 where there is none: PX4's default."""
    value = parameters.get(name, 1.0)
    return int(value) if 1 <= value <= 255 else 1


def _damage(found: Intact) -> tuple[str, ...]:
    sentences = []
    if found.damaged:
        sentences.append(
            f"The file is damaged in {_times(found.damaged, 'place')}: {found.bytes_skipped} bytes that belong to no "
            "message were skipped."
        )
    if found.cut:
        sentences.append(f"Left out: {_times(found.cut, 'message')} cut off by the end of the file or of a part of it.")
    if found.astray.any():
        count = int(np.count_nonzero(found.astray))
        sentences.append(f"Left out: {_times(count, 'message')} with a time stamp far from those around it.")
    if found.crowded:
        subscriptions = _times(found.crowded, "subscription")
        sentences.append(f"Left out: {subscriptions} to more topics, or larger ones, than PX4 has.")
    return tuple(sentences)


def _dropouts(found: Intact) -> tuple[str, ...]:
    """What PX4's logger could not write in time: it notes how long it lasted, not what is missing."""
    lasted = found.dropouts / 1e3
    if not len(lasted):
        return ()
    often, longest = _times(len(lasted), "time"), lasted.max()
    return (
        f"The logger dropped out {often}, for {lasted.sum():.3g} s in all and {longest:.3g} s at most: what came then "
        "is missing.",
    )


def _filled(topics: dict[str, dict[int, Topic]], counts: dict[str, int]) -> tuple[str, ...]:
    """Attitude that was made up between samples, where the body rates came clearly more often."""
    logged = max((len(topic["time"]) for topic in topics.get("vehicle_attitude", {}).values()), default=0)
    told = counts.get("ATTITUDE_QUATERNION", 0)
    if told <= FILLED * logged:
        return ()
    return (f"Attitude was logged {logged} times; at the {told} stamps of the body rates it lies on lines between.",)


def _times(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _nothing(found: Intact) -> str:
    if found.damaged or found.cut or found.crowded:
        return "it is damaged or cut off at its beginning."
    return "log vehicle_attitude, vehicle_angular_velocity and actuator_motors (the parameter SDLOG_PROFILE)."
