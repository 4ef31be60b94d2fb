"""Telemetry: what one vehicle sent, as columns on the autopilot's own clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

Columns = Mapping[str, NDArray[Any]]
"""One message type's fields by name; every array has one row per message, in stream order.

Beside the fields of the message definition, in the units of the definition, two columns are always there:

- ``time`` (N,) float64: seconds on the autopilot's boot clock, wraps undone. A message without a clock of its own
  (HEARTBEAT, PARAM_VALUE) takes that of the last message before it that had one.
- ``boot`` (N,) int64: 0 for the first boot in the source, one more after each reboot. ``time`` starts anew with
  each boot, so times of different boots must never be compared.
"""


@dataclass(frozen=True, eq=False)
class Telemetry:
    """What one component of one vehicle sent.

    Attributes:
        system: MAVLink system id.
        component: MAVLink component id (1 is the autopilot).
        vehicle: the vehicle's MAV_TYPE without its prefix ("QUADROTOR"), outvoting stray heartbeats; "UNKNOWN" when
            none came.
        autopilot: the MAV_AUTOPILOT without its prefix ("ARDUPILOTMEGA", "PX4").
        messages: columns by message name ("ATTITUDE").
        parameters: the autopilot's parameters by name, as numbers, the last value sent.
        source: the file or link it came from.
        repairs: one sentence for each thing that was mended on the way (a wrap, a reboot, damage).
        translated_from: what the messages were made from, where the autopilot did not send them as they are:
            "DataFlash", "ULog", or of ROS 2's topics "uXRCE-DDS" or "MAVROS"; else empty.
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
