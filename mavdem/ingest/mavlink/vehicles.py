"""The components of a stream, which of them are vehicles, and the messages of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.contents import require_whole
from mavdem.ingest.log import Component, Log, repair_sentences
from mavdem.ingest.mavlink.checksum import Bytes
from mavdem.ingest.mavlink.clocks import PlacedStamps, Sent, boot_clock
from mavdem.ingest.mavlink.definitions import MessageDefinition, columns, definitions, enum_name, parameter_values
from mavdem.ingest.mavlink.frame_index import FrameIndex, Starts
from mavdem.ingest.mavlink.outlier_stamps import Places, Times
from mavdem.ingest.telemetry import Columns, Telemetry
from mavdem.ingest.vocabulary import RADIO, RADIO_MESSAGES, UNNAMED

NOT_VEHICLES = frozenset(
    {"GCS", "ANTENNA_TRACKER", "ONBOARD_CONTROLLER", "GIMBAL", "ADSB", "CAMERA", "CHARGING_STATION", "FLARM", "SERVO"}
    | {"ODID", "BATTERY", "LOG", "OSD", "IMU", "GPS", "WINCH", "ILLUMINATOR", "GRIPPER", "PARACHUTE", RADIO}
)
"""MAV_TYPEs of components and ground equipment."""
VEHICLE_MESSAGES = frozenset(
    {"ATTITUDE", "ATTITUDE_QUATERNION", "SERVO_OUTPUT_RAW", "ACTUATOR_OUTPUT_STATUS", "HIL_ACTUATOR_CONTROLS"}
)
"""A component without a HEARTBEAT is a vehicle if it sent one of these messages."""
PARAMETER_STORE = 190  # Component (MAV_COMP_ID_MISSIONPLANNER) under which MAVProxy logs the parameters of a system
CLOCK_UNITS = {"time_boot_ms": 1e3, "time_boot_us": 1e6, "time_usec": 1e6}
"""Fields with the boot clock, the more reliable first, and their units in a second."""


def assemble(
    data: Bytes,
    index: FrameIndex,
    received: Callable[[Places], Times],
    receive_time: tuple[float, float],
    bytes_skipped: int,
    source: str,
    repairs: tuple[str, ...],
) -> Log:
    """The log of a stream; raises ``Unreadable`` where the file was cut short meanwhile.

    ``received`` returns the UNIX s (n,) at which the frames that begin at (n,) were received, NaN where that is not
    known; ``receive_time`` is the first and the last such.
    """
    sent = index.sent()
    unread = index.unread(sent)
    failed = sum(kind.frames for kind in unread if kind.cause == "damage")
    foreign = sum(kind.frames for kind in unread if kind.cause == "another dialect")
    repairs += repair_sentences(
        (failed, f"{failed} damaged frames were left out."),
        (foreign, f"{foreign} frames of another dialect were left out."),
        (bytes_skipped, f"{bytes_skipped} bytes that belong to no frame were skipped."),
    )
    heard: list[tuple[Component, dict[str, _Columns], tuple[str, ...]]] = []
    for ids, starts in sent.items():
        messages, of_clock = _messages(data, starts, received, source)
        kind, autopilot = identity(messages["HEARTBEAT"]) if "HEARTBEAT" in messages else (UNNAMED, UNNAMED)
        counts = {name: columns.count for name, columns in messages.items()}
        if counts and RADIO_MESSAGES.issuperset(counts):
            kind = RADIO
        lost = max(int(index.lost[ids]), 0)
        heard.append((Component(ids >> 8, ids & 0xFF, kind, autopilot, counts, lost), messages, of_clock))
    stores: dict[int, Mapping[str, Columns]]
    stores = {one.system: messages for one, messages, _ in heard if one.component == PARAMETER_STORE}
    vehicles = []
    for one, messages, of_clock in heard:
        if _is_vehicle(one):
            parameters: dict[str, float] = {}
            for own in (stores.get(one.system, {}), messages):
                if "PARAM_VALUE" in own:
                    parameters |= parameter_values(own["PARAM_VALUE"], one.autopilot)
            who, found = (one.system, one.component, one.kind, one.autopilot), repairs + of_clock
            vehicles.append(Telemetry(*who, messages, parameters, source, found))
    components = tuple(one for one, *_ in heard)
    return Log(source, tuple(vehicles), components, unread, index.frames, bytes_skipped, receive_time)


def identity(heartbeats: Columns) -> tuple[str, str]:
    """The MAV_TYPE of most HEARTBEATs, and the MAV_AUTOPILOT of most of these, without their prefixes."""
    votes = np.bincount(heartbeats["type"]).astype(np.float64)
    votes[0] *= 0.1  # GENERIC: scripts send it under any id
    kind = int(votes.argmax())
    autopilot = int(np.bincount(heartbeats["autopilot"][heartbeats["type"] == kind]).argmax())
    return enum_name("MAV_TYPE", kind), enum_name("MAV_AUTOPILOT", autopilot)


def _is_vehicle(one: Component) -> bool:
    if one.kind == UNNAMED:
        return not VEHICLE_MESSAGES.isdisjoint(one.messages)
    return one.kind not in NOT_VEHICLES and set(one.messages) != {"HEARTBEAT"}


def _messages(
    data: Bytes, sent: Mapping[int, Starts], received: Callable[[Places], Times], source: str
) -> tuple[dict[str, _Columns], tuple[str, ...]]:
    """The good frames of one component, which begin at ``sent`` by message id, as columns by name on the boot clock.

    And a sentence for each repair of the clock.
    """
    kinds = [(definitions()[message_id], starts) for message_id, starts in sent.items()]
    clock = boot_clock([_sent(data, definition, starts, source) for definition, starts in kinds], received)
    return {
        definition.name: _Columns(data, starts, definition, clock.placed[definition.name], source)
        for definition, starts in kinds
    }, clock.repairs


class _Columns(Mapping[str, NDArray[Any]]):
    """One message's columns, with ``time`` and ``boot``; its fields are decoded when one is first used."""

    def __init__(
        self, data: Bytes, starts: Starts, definition: MessageDefinition, placed: PlacedStamps, source: str
    ) -> None:
        self._data, self._starts, self._definition = data, starts, definition
        self._placed, self._source = placed, source
        self._fields: dict[str, NDArray[Any]] | None = None
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
        yield from (name for name in self._definition.fields if name not in ("time", "boot"))
        yield from ("time", "boot")

    def __len__(self) -> int:
        return len(set(self._definition.fields) | {"time", "boot"})


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
