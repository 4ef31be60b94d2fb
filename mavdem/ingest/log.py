"""Log: all contents of a recording, vehicle by vehicle, with what could not be read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import nan

from mavdem.ingest.telemetry import Telemetry

MAX_LISTED, MAX_CHARACTERS = 5, 80  # Names in a sentence, and characters of each


@dataclass(frozen=True, eq=False)
class Component:
    """One component that sent messages: a vehicle, a ground station, a gimbal, a radio.

    Attributes:
        system, component: MAVLink ids.
        kind: the MAV_TYPE in most of its HEARTBEATs, without the prefix ("GCS"); "UNKNOWN" without a HEARTBEAT, or
            "TELEMETRY_RADIO" if RADIO_STATUS is all it sent.
        autopilot: likewise its MAV_AUTOPILOT.
        messages: number of messages by name.
        lost: messages missing by the gaps in its sequence numbers; a gap counts 127 at most.
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
        components: every component, vehicles included, by system and component.
        unread: frames that could not be read.
        frames: whole frames in the stream, unread ones included.
        bytes_skipped: bytes that belong to no frame.
        receive_time: (first, last) trustworthy receive stamp, UNIX seconds; NaN when there is none.
    """

    source: str
    vehicles: tuple[Telemetry, ...]
    components: tuple[Component, ...]
    unread: tuple[Unread, ...]
    frames: int
    bytes_skipped: int
    receive_time: tuple[float, float]


def listed(names: Iterable[str]) -> str:
    """Names for a sentence: a few, in one line, whatever the file contains."""
    ordered = sorted(names)
    shown = [name if len(name) <= MAX_CHARACTERS else f"{name[:MAX_CHARACTERS]}…" for name in ordered[:MAX_LISTED]]
    shown = ["".join(one if one.isprintable() else "\N{REPLACEMENT CHARACTER}" for one in name) for name in shown]
    return ", ".join(shown) + (", …" if len(ordered) > MAX_LISTED else "")


def repair_sentences(*counted: tuple[int, str]) -> tuple[str, ...]:
    """The sentences whose count is not 0."""
    return tuple(sentence for count, sentence in counted if count)


def log_of_vehicles(
    vehicles: tuple[Telemetry, ...],
    frames: int,
    bytes_skipped: int,
    receive_time: tuple[float, float] = (nan, nan),
    counts: Mapping[str, int] | None = None,
) -> Log:
    """The log of a file that contains vehicles, one at least, and no other components.

    ``counts`` are the messages by their names in the file; those of ``Telemetry.messages`` unless given.
    """
    components = tuple(
        Component(
            one.system,
            one.component,
            one.vehicle,
            one.autopilot,
            counts or {name: len(columns["time"]) for name, columns in one.messages.items()},
            lost=0,
        )
        for one in vehicles
    )
    return Log(vehicles[0].source, vehicles, components, (), frames, bytes_skipped, receive_time)
