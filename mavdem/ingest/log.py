"""Log: everything a recorded stream held, vehicle by vehicle, with what could not be read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mavdem.telemetry import Telemetry


@dataclass(frozen=True, eq=False)
class Speaker:
    """One component heard in the stream: a vehicle, a ground station, a gimbal, a radio.

    Attributes:
        system, component: MAVLink ids.
        kind: what most of its HEARTBEATs say it is, a MAV_TYPE without its prefix ("GCS"); "UNKNOWN" when none came.
        autopilot: likewise its MAV_AUTOPILOT.
        messages: number of messages by name.
        lost: messages missing by the gaps in its sequence numbers; at most 127 show for each gap.
    """

    system: int
    component: int
    kind: str
    autopilot: str
    messages: Mapping[str, int]
    lost: int


@dataclass(frozen=True)
class Unread:
    """Frames of one message from one component that could not be read.

    Attributes:
        message_id, system, component: from their headers.
        frames: how many could not be read.
        of: how many there were in all.
        cause: "another dialect" when none agrees with the dialect's definition, "damage" when some do.
    """

    message_id: int
    system: int
    component: int
    frames: int
    of: int
    cause: str


@dataclass(frozen=True, eq=False)
class Log:
    """A recorded stream.

    Attributes:
        source: the file it came from.
        vehicles: one ``Telemetry`` for each component that is a vehicle and sent more than HEARTBEATs, by system and
            component.
        speakers: every component heard, vehicles included, by system and component.
        unread: frames that could not be read.
        frames: whole frames in the stream, unread ones included.
        bytes_skipped: bytes that belong to no frame.
        receive_time: (first, last) trustworthy receive stamp, UNIX seconds; NaN when there is none.
    """

    source: str
    vehicles: tuple[Telemetry, ...]
    speakers: tuple[Speaker, ...]
    unread: tuple[Unread, ...]
    frames: int
    bytes_skipped: int
    receive_time: tuple[float, float]
