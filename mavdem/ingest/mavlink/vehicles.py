"""The components of a stream, where in the stream each of their messages is, and which of them are vehicles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from mavdem.facts import Facts
from mavdem.facts.sources import Flaw, Repair
from mavdem.ingest.mavlink.clocks import Places, Sent, boot_clock, deviates_from_median
from mavdem.ingest.mavlink.definitions import (
    MessageDefinition,
    decoded_columns,
    definitions_by_id,
    enum_name,
    latest_parameters,
)
from mavdem.ingest.mavlink.framing import (
    CHECKSUM_MATCHES,
    MESSAGE_UNKNOWN,
    Bytes,
    Frames,
    concatenated,
)
from mavdem.ingest.motors import MOTOR_MESSAGES
from mavdem.ingest.telemetry import (
    Columns,
    Component,
    Fields,
    Log,
    Tables,
    Telemetry,
    UnreadFrames,
    repair_facts,
    rows_by_value,
)
from mavdem.ingest.vocabulary import (
    NAMES,
    RADIO,
    RADIO_MESSAGES,
    UNNAMED,
)

Starts = NDArray[np.integer]
"""Places of frames in the stream, in its order."""


def missing_messages(before: Any, after: Any) -> Any:
    """Returns increase of one sender's number of missing messages from one message to the next, −33 to 127.

    The numbers run from 0 to 255 and start again. A late message was counted as missing when another overtook it, and
    the step after it counts the messages between again. It takes both back, so that the sum over a stream is the number
    sent less the number received, as in RTP (RFC 3550, section 6.4.1). Duplicates make the sum too small.
    """
    step = (after - before) & 0xFF
    late = step >= 256 - 32  # a larger step back is of a sender that restarted
    ahead = (step > 0) & (step <= 128)
    return (step - 1 - 256 * late) * (ahead | late)


NOT_VEHICLES = frozenset({*NAMES["not_vehicles"], RADIO})
"""MAV_TYPEs of components and ground equipment."""
VEHICLE_MESSAGES = frozenset({"ATTITUDE", "ATTITUDE_QUATERNION", *MOTOR_MESSAGES})
"""A component without a HEARTBEAT is a vehicle if it sent one of these messages."""
# Component (MAV_COMP_ID_MISSIONPLANNER) under which MAVProxy logs the parameters of a system
PARAMETER_STORE_COMPONENT: int = dialect.MAV_COMP_ID_MISSIONPLANNER
BOOT_CLOCK_UNITS = {"time_boot_ms": 1e3, "time_boot_us": 1e6, "time_usec": 1e6}
"""Fields with the boot clock, the more reliable first, and their units in a second."""


MAX_STAMP_JUMP = 3600.0  # Seconds from its neighbours beyond which a receive stamp is wrong
STAMP_WINDOW = 9  # Stamps whose median is compared with the one in their middle


def assemble(stream: FrameStream) -> Log:
    """Returns the log of a stream."""
    data = stream.data
    frames = stream.frames
    ids_of = frames.system.astype(np.int64) << 8 | frames.component
    sent = _starts(frames, ids_of)
    rows_of = rows_by_value(ids_of)
    unread = tuple(_unread(frames, ids_of, sent))
    repairs = stream.repairs
    for cause in (Flaw.DAMAGE, Flaw.ANOTHER_DIALECT):
        count = sum(kind.frames for kind in unread if kind.cause is cause)
        repairs += repair_facts(Repair.FRAMES_LEFT_OUT, count=count, flaw=cause)
    repairs += repair_facts(Repair.BYTES_SKIPPED, count=stream.bytes_skipped, part="frame")
    heard = []
    for ids, starts in sent.items():
        messages, of_clock = _messages(data, starts)
        kind, autopilot = (
            identity(messages["HEARTBEAT"]) if "HEARTBEAT" in messages else (UNNAMED, UNNAMED)
        )
        counts = {name: len(fields["time"]) for name, fields in messages.items()}
        if counts and RADIO_MESSAGES.issuperset(counts):
            kind = RADIO
        sequence = frames.sequence[rows_of[ids]].astype(np.int16)
        lost = int(missing_messages(sequence[:-1], sequence[1:]).sum())
        sender = Component(ids >> 8, ids & 0xFF, kind, autopilot, counts, max(lost, 0))
        heard.append((sender, messages, of_clock))
    stores = {
        sender.system: messages
        for sender, messages, _ in heard
        if sender.component == PARAMETER_STORE_COMPONENT
    }
    vehicles = []
    for sender, messages, of_clock in heard:
        # Without a HEARTBEAT it is one by what it sent.
        is_vehicle = sender.kind not in NOT_VEHICLES and set(sender.messages) != {"HEARTBEAT"}
        if (
            (not VEHICLE_MESSAGES.isdisjoint(sender.messages))
            if sender.kind == UNNAMED
            else is_vehicle
        ):
            parameters: dict[str, float] = {}
            for own in (stores.get(sender.system, {}), messages):
                if "PARAM_VALUE" in own:
                    parameters |= latest_parameters(own["PARAM_VALUE"], sender.autopilot)
            who = (sender.system, sender.component, sender.kind, sender.autopilot)
            all_repairs = repairs + of_clock
            vehicles.append(Telemetry(*who, messages, parameters, stream.source, all_repairs))
    stamps = stream.stamps[stream.stamps > 0] / 1e6
    stamps = stamps[~deviates_from_median(stamps, STAMP_WINDOW, MAX_STAMP_JUMP)]
    span = (float(stamps.min()), float(stamps.max())) if len(stamps) else (np.nan, np.nan)
    components = tuple(sender for sender, *_ in heard)
    return Log(
        stream.source,
        tuple(vehicles),
        components,
        unread,
        len(frames),
        stream.bytes_skipped,
        span,
    )


def _starts(frames: Frames, ids_of: Places) -> dict[int, dict[int, Starts]]:
    """Where matching frames of each message begin, by ``system << 8 | component`` and message id, both ascending."""
    matching = frames.checksum == CHECKSUM_MATCHES
    starts = frames.start[matching]
    sent: dict[int, dict[int, Starts]] = {}
    for kind, rows in rows_by_value((ids_of << 24 | frames.message_id)[matching]).items():
        sent.setdefault(kind >> 24, {})[kind & 0xFFFFFF] = starts[rows]
    return sent


def _unread(
    frames: Frames, ids_of: Places, sent: Mapping[int, Mapping[int, Starts]]
) -> Iterator[UnreadFrames]:
    """The frames that could not be read, of a stream in which the matching ones are ``sent``."""
    bad = frames.checksum != CHECKSUM_MATCHES
    checksums = frames.checksum[bad]
    for key, rows in rows_by_value((frames.message_id << 16 | ids_of)[bad]).items():
        message_id = key >> 16
        ids = key & 0xFFFF
        total = len(rows) + len(sent.get(ids, {}).get(message_id, ()))
        # Of another dialect all frames of a message fail, and more than two, which may be damage.
        strange = ids in sent if checksums[rows[0]] == MESSAGE_UNKNOWN else len(rows) == total >= 3
        cause = Flaw.ANOTHER_DIALECT if strange else Flaw.DAMAGE
        yield UnreadFrames(message_id, ids >> 8, ids & 0xFF, len(rows), total, cause)


def identity(heartbeats: Columns) -> tuple[str, str]:
    """Returns the MAV_TYPE of most HEARTBEATs, and the MAV_AUTOPILOT of most of these, without their prefixes."""
    votes = np.bincount(heartbeats["type"]).astype(np.float64)
    votes[0] *= 0.1  # GENERIC: scripts send it under any id
    kind = int(votes.argmax())
    autopilot = int(np.bincount(heartbeats["autopilot"][heartbeats["type"] == kind]).argmax())
    return enum_name("MAV_TYPE", kind), enum_name("MAV_AUTOPILOT", autopilot)


def _messages(data: Bytes, sent: Mapping[int, Starts]) -> tuple[Tables, Facts]:
    """Matching frames of one component by message id, as columns by name on the boot clock; repairs of its clock."""
    decoded = {}
    kinds = []
    for message_id, starts in sent.items():
        definition = definitions_by_id()[message_id]
        fields = decoded[definition.name] = decoded_columns(data, starts, definition)
        kinds.append(_sent(definition, starts, fields))
    placed, repairs = boot_clock(kinds)
    return {name: {**fields, **placed[name]._asdict()} for name, fields in decoded.items()}, repairs


def _sent(definition: MessageDefinition, starts: Starts, fields: Fields) -> Sent:
    for name, units in BOOT_CLOCK_UNITS.items():
        if name in fields:
            kind = fields[name].dtype
            period = np.inf if kind.itemsize == 8 else 2.0 ** (8 * kind.itemsize) / units
            return Sent(definition.name, starts, fields[name] / units, period)
    return Sent(definition.name, starts)


@dataclass(frozen=True, eq=False)
class FrameStream:
    """A recorded stream, not yet sorted by sender; ``file_ending`` is the usual end of such files, ".tlog"."""

    source: str
    file_ending: str
    data: Bytes  # the bytes with the frames, in the same order
    frames: Frames  # (N,) in the order of the recording
    # (N,) UNIX microseconds each was received, as recorded; 0 where that was not
    stamps: NDArray[np.uint64]
    bytes_skipped: int
    repairs: Facts

    def stamped_frames(self) -> Iterator[tuple[int, bytes]]:
        """Yields the stamp and the bytes of each frame; a frame without a stamp has that of the frame before."""
        last = np.maximum.accumulate(np.where(self.stamps > 0, np.arange(len(self.stamps)), 0))
        content = self.data.data
        for stamp, start, end in zip(
            self.stamps[last].tolist(),
            self.frames.start.tolist(),
            self.frames.end.tolist(),
            strict=True,
        ):
            yield stamp, bytes(content[start:end])


class RecordingPart(NamedTuple):
    """Some of a recording's frames, (N,), and the bytes with them.

    ``place`` (N,) is the number of the message of the recording in which each begins, ``log_time`` (N,) UNIX ns.
    """

    data: Bytes
    frames: Frames
    place: Places
    log_time: NDArray[np.uint64]


def joined(parts: Sequence[RecordingPart]) -> RecordingPart:
    """Returns all parts, one at least, as one, its frames and their bytes in the order of the recording."""
    if len(parts) == 1:
        return parts[0]
    contents, tables, places, times = zip(*parts, strict=True)
    offsets = np.concatenate(places)
    order = np.argsort(offsets, kind="stable")
    holding = np.repeat(np.arange(len(parts)), [len(table) for table in tables])[order].tolist()
    frames = concatenated(tables)[order]
    data = bytearray()
    for part, start, end in zip(holding, frames.start.tolist(), frames.end.tolist(), strict=True):
        data += contents[part].data[start:end]
    end = np.cumsum(frames.size)
    frames = replace(frames, start=end - frames.size, end=end)
    joint = np.frombuffer(data, dtype=np.uint8)
    return RecordingPart(joint, frames, offsets[order], np.concatenate(times)[order])
