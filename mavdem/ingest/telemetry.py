"""Telemetry and Log: what one vehicle sent, as columns on its boot clock, and all contents of a recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array
from mavdem.confidence import Interval
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.sources import Flaw, Repair
from mavdem.immutable import ImmutableResult

Parameters = Mapping[str, float]  # Values by name
Fields = dict[str, NDArray[Any]]  # Columns of a message that is being made
Columns = Mapping[str, NDArray[Any]]
"""One message type's fields by name; every array has one row per message, in stream order.

Beside the fields of the message definition, in the units of the definition, two columns are always there:

- ``time`` (N,) float64: seconds on the autopilot's boot clock, wraps undone. A message without a clock of its own
  (HEARTBEAT, PARAM_VALUE) has the time of the last message before it that has one.
- ``boot`` (N,) int64: 0 for the first boot in the source, one more after each reboot. ``time`` restarts with each
  boot, so times of different boots must never be compared.
"""
Tables = Mapping[str, Columns]  # The columns of messages by the name of each
MIN_PREFERRED_SHARE = 0.9
"""A preferred message gives way to another only when it comes less often than this share of the other's count."""
MAX_GAP_SECONDS = (
    0.1  # Longest silence that is bridged: half a period of 5 Hz, at which roll still moves
)
MAX_FIELDS = 2000
"""Numbers in a message, of which PX4's and MAVROS's have up to some hundreds: libraries lay out each."""


@dataclass(frozen=True, eq=False)
class Telemetry(ImmutableResult):
    """The messages of one component of one vehicle.

    Attributes:
        system: MAVLink system id.
        component: MAVLink component id (1 is the autopilot).
        vehicle: the vehicle's MAV_TYPE without its prefix ("QUADROTOR"), of most HEARTBEATs; "UNKNOWN" without any.
        autopilot: the MAV_AUTOPILOT without its prefix ("ARDUPILOTMEGA", "PX4").
        messages: columns by message name ("ATTITUDE").
        parameters: the autopilot's parameters by name, as numbers, the last value sent.
        initial_parameters: the first values of those that changed.
        source: the file or link it came from.
        repairs: what was odd or damaged, and what was done about it (a wrap, a reboot, damage).
        translated_from: the source of messages that the autopilot did not send as MAVLink: "DataFlash", "ULog", or
            for ROS 2's topics "uXRCE-DDS" or "MAVROS"; else empty.
        firmware: what the autopilot calls its firmware ("ArduCopter V4.4.4 (865cffa5)"); empty where the log does not.
        dropouts: how often the autopilot's own logger reports to have lost messages.
        source_names: what the source calls messages that were translated ("RCOU"), by their name here.
        board: the number of the autopilot's board, which no other has, in hexadecimal; empty where the log has none.
        hardware: the kind of board, as its firmware calls it ("PX4_FMU_V5"); empty where the log has none.
    """

    system: int
    component: int
    vehicle: str
    autopilot: str
    messages: Tables
    parameters: Parameters = field(default_factory=dict)
    source: str = ""
    repairs: Facts = ()
    translated_from: str = ""
    firmware: str = ""
    dropouts: int = 0
    source_names: Mapping[str, str] = field(default_factory=dict)
    board: str = ""
    hardware: str = ""
    initial_parameters: Parameters = field(default_factory=dict)

    def name_in_source(self, message: str) -> str:
        """Returns the name of ``message`` in the source: DataFlash's "RCOU" for "SERVO_OUTPUT_RAW"."""
        return self.source_names.get(message, message)


def rate_without_gaps(steps: Array) -> float:
    """Returns messages a second by the ``steps`` (N,), s, between them, without gaps of over three usual ones."""
    usual = steps[steps <= 3 * np.median(steps)] if len(steps) else steps
    return 1 / float(usual.mean()) if usual.any() else 0.0


def interpolated(at: Array, time: Array, values: Array) -> Array:
    """Returns the columns of ``values`` (N, k), known at ``time`` (N,), at other times ``at`` (T,)."""
    return np.column_stack([np.interp(at, time, column) for column in values.T])


def held(at: Array, time: Array, values: NDArray[Any]) -> NDArray[Any]:
    """Returns the last of ``values`` (N,), known at ``time`` (N,), at other times ``at`` (T,); 0 before the first."""
    return np.insert(values, 0, 0)[np.searchsorted(time, at, side="right")]


def rows_by_value(values: NDArray[np.integer[Any]]) -> dict[int, NDArray[np.intp]]:
    """Returns the rows of each value in ``values`` (N,), both ascending."""
    order = np.argsort(values, kind="stable")
    distinct, first = np.unique(values[order], return_index=True)
    return dict(zip(distinct.tolist(), np.split(order, first)[1:], strict=True))


def selected_rows(columns: Columns, rows: slice | NDArray[Any]) -> Fields:
    """Returns those rows of every column."""
    return {name: values[rows] for name, values in columns.items()}


def concatenated_columns(parts: Sequence[Columns]) -> Fields:
    """Returns parts, one at least, one after the other, with the columns that all have; one alone is not copied."""
    if len(parts) == 1:
        return dict(parts[0])
    names = [name for name in parts[0] if all(name in part for part in parts)]
    return {name: np.concatenate([part[name] for part in parts]) for name in names}


Choices = Mapping[str, Sequence[tuple[float, str]]]  # By field, factors and names


def renamed(logged: Columns, rule: Mapping[str, Choices]) -> Fields:
    """Returns the columns of a message by a ``rule`` of another's: by field, factors and names; raises ``KeyError``.

    Fields of ``also`` may be lacking, of ``fields`` each must have one of its names.
    """
    also = rule.get("also", {})
    made = {}
    for name, choices in {**rule["fields"], **also}.items():
        there = [(factor, logged[own]) for factor, own in choices if own in logged]
        if there:
            factor, values = there[0]
            made[name] = values if factor == 1 else np.asarray(values, np.float64) * factor
        elif name not in also:
            raise KeyError(name)
    return made


@dataclass(frozen=True, eq=False)
class Component(ImmutableResult):
    """One component that sent messages: a vehicle, a ground station, a gimbal, a radio.

    Attributes:
        system, component: MAVLink ids.
        kind, autopilot: MAV_TYPE ("GCS") and MAV_AUTOPILOT in most of its HEARTBEATs, without prefix; "UNKNOWN" without
            a HEARTBEAT, or "TELEMETRY_RADIO" if RADIO_STATUS is all it sent.
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
class UnreadFrames:
    """Frames of ``message_id`` from ``system`` and ``component``: so many ``frames`` of ``total`` cannot be read.

    ``cause`` is another dialect when none agrees with the dialect's definition, damage when some do.
    """

    message_id: int
    system: int
    component: int
    frames: int
    total: int
    cause: Flaw


@dataclass(frozen=True, eq=False)
class Log:
    """A recorded stream.

    Attributes:
        source: the file it came from.
        vehicles: one ``Telemetry`` for each component that is a vehicle and sent more than HEARTBEATs.
        components: every component, vehicles included; both by system and component.
        unread: frames that could not be read.
        frames: whole frames in the stream, unread ones included.
        bytes_skipped: bytes that belong to no frame.
        receive_time: (first, last) trustworthy receive stamp, UNIX seconds; NaN when there is none.
    """

    source: str
    vehicles: tuple[Telemetry, ...]
    components: tuple[Component, ...]
    unread: tuple[UnreadFrames, ...]
    frames: int
    bytes_skipped: int
    receive_time: Interval


def repair_facts(code: Repair, **figures: Any) -> Facts:
    """Returns the repair as a fact; none where its ``count`` is 0."""
    return (Fact(code, Level.WATCH, **figures),) if figures.get("count", 1) else ()


def log_of_vehicles(
    vehicles: tuple[Telemetry, ...],
    frames: int,
    bytes_skipped: int,
    receive_time: Interval = (nan, nan),
    counts: Mapping[str, int] | None = None,
) -> Log:
    """Returns the log of a file of vehicles only, one at least; ``counts`` are the messages by their own names."""
    components = []
    for vehicle in vehicles:
        sent = counts or {name: len(columns["time"]) for name, columns in vehicle.messages.items()}
        components.append(
            Component(
                vehicle.system, vehicle.component, vehicle.vehicle, vehicle.autopilot, sent, lost=0
            )
        )
    return Log(
        vehicles[0].source, vehicles, tuple(components), (), frames, bytes_skipped, receive_time
    )
