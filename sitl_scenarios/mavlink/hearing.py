"""Hearing: what a ground station says to one vehicle, out of datagrams that may hold anything."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mavdem.ingest.decode import columns, definitions, seeds
from mavdem.ingest.framing import GOOD, find_frames

BROADCAST = 0
"""Target system or component of what is said to all."""
UNDERSTOOD = frozenset(
    {"COMMAND_LONG", "COMMAND_INT", "PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"}
    | {"REQUEST_DATA_STREAM", "MISSION_REQUEST_LIST"}
)
"""Messages that are answered; each names its target."""


@dataclass(frozen=True)
class Heard:
    """A message of ``name`` with its ``fields`` from ``system`` and ``component``."""

    name: str
    fields: dict[str, Any]
    system: int
    component: int


def heard(datagram: bytes, system: int, component: int, most: int | None = None) -> list[Heard]:
    """The messages in a datagram that are understood and meant for this system and component, or for all.

    Args:
        datagram: what came.
        system, component: who hears it.
        most: how many are looked for; all unless given.
    """
    data = np.frombuffer(datagram, dtype=np.uint8)
    understood = []
    for frames in find_frames(data, seeds()):
        for row in np.flatnonzero(frames.verdict == GOOD).tolist():
            definition = definitions()[int(frames.message_id[row])]
            if definition.name not in UNDERSTOOD:
                continue
            read = columns(data, frames.start[row : row + 1], definition)
            fields = {name: values[0] for name, values in read.items()}
            meant = fields["target_system"] in (system, BROADCAST) and fields["target_component"] in (
                component,
                BROADCAST,
            )
            if meant:
                understood.append(Heard(definition.name, fields, int(frames.system[row]), int(frames.component[row])))
            if len(understood) == most:
                return understood
    return understood
