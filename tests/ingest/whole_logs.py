"""Whole logs to compare: everything a file holds, read as usual or in blocks of a few bytes and messages."""

import tempfile
from typing import Any

from mavdem.errors import Unreadable
from mavdem.ingest import Log, read_log
from mavdem.ingest.mavlink import definitions, framing

SMALL = (
    (framing, "BLOCK", 61),
    (definitions, "BATCH", 3),
)


def read(content: bytes) -> Log | None:
    """The log; None where it is refused as it should be."""
    with tempfile.NamedTemporaryFile(suffix=".tlog") as file:
        file.write(content)
        file.flush()
        try:
            return read_log(file.name)
        except Unreadable:
            return None


def in_small_blocks(content: bytes) -> Log | None:
    usual = [(module, name, getattr(module, name)) for module, name, _ in SMALL]
    try:
        for module, name, size in SMALL:
            setattr(module, name, size)
        return read(content)
    finally:
        for module, name, size in usual:
            setattr(module, name, size)


def everything(log: Log | None) -> list[Any]:
    """All that a log holds, decoded, but for the file's name."""
    if log is None:
        return []
    vehicles = []
    for vehicle in log.vehicles:
        who = (
            vehicle.system,
            vehicle.component,
            vehicle.vehicle,
            repr(vehicle.parameters),
            vehicle.repairs,
        )
        sent = [(name, columns.items()) for name, columns in vehicle.messages.items()]
        vehicles.append(
            (
                who,
                [
                    (name, field, values.tobytes())
                    for name, fields in sent
                    for field, values in fields
                ],
            )
        )
    speakers = [
        (speaker.system, speaker.component, dict(speaker.messages), speaker.lost)
        for speaker in log.components
    ]
    return [vehicles, speakers, log.unread, log.frames, log.bytes_skipped, repr(log.receive_time)]
