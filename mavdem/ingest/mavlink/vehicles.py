"""The components of a stream, where in the stream each of their messages is, and which of them are vehicles."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import all as dialect

from mavdem.facts import Fact
from mavdem.facts.sources import Flaw, Repair
from mavdem.ingest.contents import require_whole
from mavdem.ingest.mavlink.clocks import PlacedStamps, Places, Sent, Times, boot_clock
from mavdem.ingest.mavlink.definitions import (
    MessageDefinition,
    columns,
    definitions,
    enum_name,
    parameter_values,
)
from mavdem.ingest.mavlink.framing import GOOD, UNKNOWN, Bytes, Frames, gathered
from mavdem.ingest.motors import MOTOR_MESSAGES
from mavdem.ingest.telemetry import Columns, Component, Log, Telemetry, Unread, repair
from mavdem.ingest.vocabulary import (
    RADIO,
    RADIO_MESSAGES,
    UNNAMED,
)

Starts = NDArray[np.unsignedinteger]
"""Places of frames in the stream, in its order, in the smallest type that holds them."""
SOURCES = 1 << 16  # Pairs of system and component; a source is ``system << 8 | component``


class FrameIndex:
    """The frames of a stream by component and message, added table by table: whole ``frames``, and ``good`` ones.

    ``lost`` (SOURCES,): messages missing by the gaps in each source's sequence numbers; negative where many came twice.
    """

    def __init__(self, size: int) -> None:
        """Starts with the size of the stream, bytes."""
        self.frames = self.good = 0
        self.lost = np.zeros(SOURCES, dtype=np.int64)
        self._last_sequence = np.full(SOURCES, -1, dtype=np.int16)
        # A kind is a message of a source, ``source << 24 | message id``; kinds are numbered as they occur.
        self._kinds: dict[int, int] = {}
        # Of every good frame its place and its kind. ``array`` grows without a copy, and without fragments.
        self._starts, self._kind = array("I" if size < 1 << 32 else "Q"), array("I")
        self._unread: dict[int, Counter[int]] = {}

    def add(self, frames: Frames) -> None:
        """Adds the next frames of the stream."""
        self.frames += len(frames)
        source = frames.system.astype(np.int64) << 8 | frames.component
        order = np.argsort(source.astype(np.uint16), kind="stable")
        self._count_lost(source[order], frames.sequence[order].astype(np.int16))
        good = frames.verdict == GOOD
        for row in np.flatnonzero(~good).tolist():
            key = int(frames.message_id[row]) << 16 | int(source[row])
            self._unread.setdefault(int(frames.verdict[row]), Counter())[key] += 1
        self.good += int(np.count_nonzero(good))
        found, row_of = np.unique(source[good] << 24 | frames.message_id[good], return_inverse=True)
        numbers = np.array(
            [self._kinds.setdefault(kind, len(self._kinds)) for kind in found.tolist()],
            dtype=np.uint32,
        )
        self._starts.frombytes(frames.start[good].astype(self._starts.typecode).tobytes())
        self._kind.frombytes(numbers[row_of].tobytes())

    def _count_lost(self, source: NDArray[np.int64], sequence: NDArray[np.int16]) -> None:
        first = np.ones(len(source), dtype=np.bool_)
        last = np.ones(len(source), dtype=np.bool_)
        first[1:] = last[:-1] = source[1:] != source[:-1]
        before = np.roll(sequence, 1)
        before[first] = self._last_sequence[source[first]]
        self._last_sequence[source[last]] = sequence[last]
        missing = missing_between(before, sequence)
        missing[before < 0] = 0
        gaps = np.flatnonzero(missing)
        np.add.at(self.lost, source[gaps], missing[gaps])

    def sent(self) -> dict[int, dict[int, Starts]]:
        """Where the good frames of each message begin, by source and message id, both ascending; call it once, last."""
        starts = np.frombuffer(self._starts, self._starts.typecode)
        # small numbers are sorted fastest
        smallest = np.min_scalar_type(len(self._kinds))
        kinds = np.frombuffer(self._kind, np.uint32).astype(smallest)
        del self._starts, self._kind
        ends = np.cumsum(np.bincount(kinds, minlength=len(self._kinds)))
        ordered = starts[np.argsort(kinds, kind="stable")]
        found: dict[int, dict[int, Starts]] = {}
        parts = np.split(ordered, ends[:-1])
        for pair, row in sorted(self._kinds.items()):
            found.setdefault(pair >> 24, {})[pair & 0xFFFFFF] = parts[row]
        return found

    def unread(self, sent: Mapping[int, Mapping[int, Starts]]) -> tuple[Unread, ...]:
        """The frames that could not be read, of a stream in which the good ones are ``sent``."""
        unknown = self._unread.get(UNKNOWN, Counter[int]())
        bad: Counter[int] = sum(self._unread.values(), Counter())
        found = []
        for key, count in sorted(bad.items()):
            message_id = key >> 16
            source = key & 0xFFFF
            total = count + len(sent.get(source, {}).get(message_id, ()))
            # Of another dialect all frames of a message fail, and more than two, which may be damage.
            strange = source in sent if key in unknown else count == total >= 3
            cause = Flaw.ANOTHER_DIALECT if strange else Flaw.DAMAGE
            found.append(Unread(message_id, source >> 8, source & 0xFF, count, total, cause))
        return tuple(found)


def missing_between(before: Any, after: Any) -> Any:
    """Returns increase of one sender's number of missing messages from one message to the next, −33 to 127.

    The numbers run from 0 to 255 and start again. A late message was counted as missing when another overtook it, and
    the step after it counts the messages between again. It takes both back, so that the sum over a stream is the number
    sent less the number received, as in RTP (RFC 3550, section 6.4.1). Duplicates make the sum too small.
    """
    step = (after - before) & 0xFF
    late = step >= 256 - 32  # a larger step back is of a sender that restarted
    ahead = (step > 0) & (step <= 128)
    return (step - 1 - 256 * late) * (ahead | late)


NOT_VEHICLES = frozenset(
    {
        "GCS",
        "ANTENNA_TRACKER",
        "ONBOARD_CONTROLLER",
        "GIMBAL",
        "ADSB",
        "CAMERA",
        "CHARGING_STATION",
        "FLARM",
        "SERVO",
        "ODID",
        "BATTERY",
        "LOG",
        "OSD",
        "IMU",
        "GPS",
        "WINCH",
        "ILLUMINATOR",
        "GRIPPER",
        "PARACHUTE",
        RADIO,
    }
)
"""MAV_TYPEs of components and ground equipment."""
VEHICLE_MESSAGES = frozenset({"ATTITUDE", "ATTITUDE_QUATERNION", *MOTOR_MESSAGES})
"""A component without a HEARTBEAT is a vehicle if it sent one of these messages."""
# Component (MAV_COMP_ID_MISSIONPLANNER) under which MAVProxy logs the parameters of a system
PARAMETER_STORE: int = dialect.MAV_COMP_ID_MISSIONPLANNER
CLOCK_UNITS = {"time_boot_ms": 1e3, "time_boot_us": 1e6, "time_usec": 1e6}
"""Fields with the boot clock, the more reliable first, and their units in a second."""


def assemble(
    data: Bytes,
    index: FrameIndex,
    received: Callable[[Places], Times],
    receive_time: tuple[float, float],
    bytes_skipped: int,
    source: str,
    repairs: tuple[Fact, ...],
) -> Log:
    """Returns the log of a stream; raises ``Unreadable`` where the file was cut short meanwhile.

    ``received`` returns the UNIX s (n,) at which the frames that begin at (n,) were received, NaN where that is not
    known; ``receive_time`` is the first and the last such.
    """
    sent = index.sent()
    unread = index.unread(sent)
    for cause in (Flaw.DAMAGE, Flaw.ANOTHER_DIALECT):
        frames = sum(kind.frames for kind in unread if kind.cause is cause)
        repairs += repair(Repair.FRAMES_LEFT_OUT, count=frames, flaw=cause)
    repairs += repair(Repair.BYTES_SKIPPED, count=bytes_skipped, part="frame")
    heard: list[tuple[Component, dict[str, _Columns], tuple[Fact, ...]]] = []
    for ids, starts in sent.items():
        messages, of_clock = _messages(data, starts, received, source)
        kind, autopilot = (
            identity(messages["HEARTBEAT"]) if "HEARTBEAT" in messages else (UNNAMED, UNNAMED)
        )
        counts = {name: columns.count for name, columns in messages.items()}
        if counts and RADIO_MESSAGES.issuperset(counts):
            kind = RADIO
        lost = max(int(index.lost[ids]), 0)
        heard.append(
            (Component(ids >> 8, ids & 0xFF, kind, autopilot, counts, lost), messages, of_clock)
        )
    stores: dict[int, Mapping[str, Columns]] = {
        one.system: messages for one, messages, _ in heard if one.component == PARAMETER_STORE
    }
    vehicles = []
    for one, messages, of_clock in heard:
        # Without a HEARTBEAT it is one by what it sent.
        is_vehicle = one.kind not in NOT_VEHICLES and set(one.messages) != {"HEARTBEAT"}
        if (not VEHICLE_MESSAGES.isdisjoint(one.messages)) if one.kind == UNNAMED else is_vehicle:
            parameters: dict[str, float] = {}
            for own in (stores.get(one.system, {}), messages):
                if "PARAM_VALUE" in own:
                    parameters |= parameter_values(own["PARAM_VALUE"], one.autopilot)
            who = (one.system, one.component, one.kind, one.autopilot)
            found = repairs + of_clock
            vehicles.append(Telemetry(*who, messages, parameters, source, found))
    components = tuple(one for one, *_ in heard)
    return Log(
        source, tuple(vehicles), components, unread, index.frames, bytes_skipped, receive_time
    )


def identity(heartbeats: Columns) -> tuple[str, str]:
    """Returns the MAV_TYPE of most HEARTBEATs, and the MAV_AUTOPILOT of most of these, without their prefixes."""
    votes = np.bincount(heartbeats["type"]).astype(np.float64)
    votes[0] *= 0.1  # GENERIC: scripts send it under any id
    kind = int(votes.argmax())
    autopilot = int(np.bincount(heartbeats["autopilot"][heartbeats["type"] == kind]).argmax())
    return enum_name("MAV_TYPE", kind), enum_name("MAV_AUTOPILOT", autopilot)


def _messages(
    data: Bytes, sent: Mapping[int, Starts], received: Callable[[Places], Times], source: str
) -> tuple[dict[str, _Columns], tuple[Fact, ...]]:
    """The good frames of one component by message id, as columns by name on the boot clock; repairs of its clock."""
    kinds = [(definitions()[message_id], starts) for message_id, starts in sent.items()]
    placed, repairs = boot_clock(
        [_sent(data, definition, starts, source) for definition, starts in kinds], received
    )
    named = (
        (one.name, _Columns(data, starts, one, placed[one.name], source)) for one, starts in kinds
    )
    return dict(named), repairs


class _Columns(Mapping[str, NDArray[Any]]):
    """One message's columns, with ``time`` and ``boot``; its fields are decoded when one is first used."""

    def __init__(
        self,
        data: Bytes,
        starts: Starts,
        definition: MessageDefinition,
        placed: PlacedStamps,
        source: str,
    ) -> None:
        self._data = data
        self._starts = starts
        self._definition = definition
        self._placed = placed
        self._source = source
        self._fields: dict[str, NDArray[Any]] | None = None
        self._names = (
            *(name for name in definition.fields if name not in ("time", "boot")),
            "time",
            "boot",
        )
        self.count = len(starts)

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name == "time":
            return self._placed.time
        if name == "boot":
            return self._placed.boot.astype(np.int64)
        if name not in self._definition.fields:
            raise KeyError(name)
        if self._fields is None:
            require_whole(self._data, self._source)
            self._fields = columns(self._data, self._starts, self._definition)
        return self._fields[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def _sent(data: Bytes, definition: MessageDefinition, starts: Starts, source: str) -> Sent:
    for name, units in CLOCK_UNITS.items():
        if name in definition.fields:
            kind = definition.wire[name]
            period = np.inf if kind.itemsize == 8 else 2.0 ** (8 * kind.itemsize) / units

            def stamps(name: str = name, units: float = units) -> Times:
                require_whole(data, source)
                return np.asarray(columns(data, starts, definition, [name])[name] / units)

            return Sent(definition.name, starts, stamps, period)
    return Sent(definition.name, starts)


@dataclass(frozen=True, eq=False)
class FrameStream:
    """A recorded stream, not yet sorted by who sent what; ``form`` is the usual end of such files' names, ".tlog"."""

    source: str
    form: str
    data: Bytes  # the bytes with the frames, in the same order
    # a row for each of the N messages in the order of the recording; a message that could not become a frame has no
    # bytes, and a verdict other than ``GOOD``
    frames: Frames
    # (N,) UNIX microseconds each was received, as recorded; 0 where that was not
    stamps: NDArray[np.uint64]
    bytes_skipped: int
    repairs: tuple[Fact, ...]

    def stamped_frames(self) -> Iterator[tuple[int, bytes]]:
        """The stamp and the bytes of each frame; a frame without a stamp has that of the frame before."""
        rows = np.flatnonzero(self.frames.end > self.frames.start)
        stamps = self.stamps[rows]
        last = np.maximum.accumulate(np.where(stamps > 0, np.arange(len(rows)), 0))
        content = self.data.data
        places = zip(self.frames.start[rows].tolist(), self.frames.end[rows].tolist(), strict=True)
        for stamp, (start, end) in zip(stamps[last].tolist(), places, strict=True):
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
    place, log_time = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("place", "log_time")
    )
    order = np.argsort(place, kind="stable")
    data, frames = gathered([(part.data, part.frames) for part in parts], order)
    return RecordingPart(data, frames, place[order], log_time[order])
