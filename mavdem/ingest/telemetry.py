"""Telemetry: the messages of one vehicle, as columns on the autopilot's own clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[Any]]
"""One message type's fields by name; every array has one row per message, in stream order.

Beside the fields of the message definition, in the units of the definition, two columns are always there:

- ``time`` (N,) float64: seconds on the autopilot's boot clock, wraps undone. A message without a clock of its own
  (HEARTBEAT, PARAM_VALUE) has the time of the last message before it that has one.
- ``boot`` (N,) int64: 0 for the first boot in the source, one more after each reboot. ``time`` restarts with each
  boot, so times of different boots must never be compared.
"""


@dataclass(frozen=True, eq=False)
class Telemetry:
    """The messages of one component of one vehicle.

    Attributes:
        system: MAVLink system id.
        component: MAVLink component id (1 is the autopilot).
        vehicle: the vehicle's MAV_TYPE without its prefix ("QUADROTOR"), of most HEARTBEATs; "UNKNOWN" without any.
        autopilot: the MAV_AUTOPILOT without its prefix ("ARDUPILOTMEGA", "PX4").
        messages: columns by message name ("ATTITUDE").
        parameters: the autopilot's parameters by name, as numbers, the last value sent.
        source: the file or link it came from.
        repairs: one sentence for each repair (a wrap, a reboot, damage).
        translated_from: the source of messages that the autopilot did not send as MAVLink: "DataFlash", "ULog", or
            for ROS 2's topics "uXRCE-DDS" or "MAVROS"; else empty.
        firmware: what the autopilot calls its firmware ("ArduCopter V4.4.4 (865cffa5)"); empty where the log does not.
        dropouts: how often the autopilot's own logger reports to have lost messages.
        names: what the source calls messages that were translated ("RCOU"), by their name here.
        board: the number of the autopilot's board, which no other has, in hexadecimal; empty where the log has none.
    """

    system: int
    component: int
    vehicle: str
    autopilot: str
    messages: Mapping[str, Columns]
    parameters: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    repairs: tuple[str, ...] = ()
    translated_from: str = ""
    firmware: str = ""
    dropouts: int = 0
    names: Mapping[str, str] = field(default_factory=dict)
    board: str = ""

    def called(self, message: str) -> str:
        """The name of ``message`` in the source: DataFlash's "RCOU" for "SERVO_OUTPUT_RAW"."""
        return self.names.get(message, message)


def rate_without_gaps(steps: NDArray[np.float64]) -> float:
    """Messages a second by the ``steps`` (N,), s, between them; gaps of over three usual ones count not; 0 of none."""
    return 1 / float(steps[steps <= 3 * np.median(steps)].mean()) if len(steps) else 0.0


def rows_by(values: NDArray[np.integer[Any]]) -> dict[int, NDArray[np.intp]]:
    """The rows of each value in ``values`` (N,), both ascending."""
    order = np.argsort(values, kind="stable")
    found, first = np.unique(values[order], return_index=True)
    return dict(zip(found.tolist(), np.split(order, first)[1:], strict=True))


def selected(columns: Columns, rows: slice | NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Those rows of every column."""
    return {name: values[rows] for name, values in columns.items()}


def joined(parts: Sequence[Columns]) -> dict[str, NDArray[Any]]:
    """Parts, one at least, one after the other, with the columns that all have; one part alone is not copied."""
    if len(parts) == 1:
        return dict(parts[0])
    names = [name for name in parts[0] if all(name in part for part in parts)]
    return {name: np.concatenate([part[name] for part in parts]) for name in names}
