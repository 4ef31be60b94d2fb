"""Streams to read, built byte by byte; checksums come from pymavlink, not from the code under test."""

import struct
from functools import cache
from tempfile import NamedTemporaryFile

import numpy as np
from pymavlink.dialects.v20 import all as dialect
from pymavlink.generator.mavcrc import x25crc

from mavdem.ingest import read_log
from mavdem.ingest.mavlink.dialect import crc_extra_table
from mavdem.ingest.mavlink.framing import find_frames

NOW = 1_700_000_000_000_000


def frame(
    message_id,
    payload,
    system=1,
    component=1,
    sequence=0,
    version=2,
    signed=False,
    seed=None,
):
    """One frame; ``seed`` stands in for the dialect's CRC_EXTRA."""
    if version == 2:
        payload = payload.rstrip(b"\0") or b"\0"
        body = struct.pack(
            "<BBBBBBHB",
            len(payload),
            signed,
            0,
            sequence,
            system,
            component,
            message_id & 0xFFFF,
            message_id >> 16,
        )
    else:
        body = struct.pack("<BBBBB", len(payload), sequence, system, component, message_id)
    seed = dialect.mavlink_map[message_id].crc_extra if seed is None else seed
    checksum = struct.pack("<H", x25crc([*body, *payload, seed]).crc)
    return (
        bytes([0xFD if version == 2 else 0xFE])
        + body
        + payload
        + checksum
        + (b"\x55" * 13 if signed else b"")
    )


@cache
def kind_of(name):
    """The class of a named message, and its fields, which are zero."""
    kind = next(kind for kind in dialect.mavlink_map.values() if kind.msgname == name)
    sizes = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    return kind, {
        field: b"" if of == "char" else [0] * sizes[field] or 0
        for field, of in zip(kind.fieldnames, kind.fieldtypes, strict=True)
    }


def message(name, system=1, component=1, sequence=0, version=2, **values):
    """One frame of a named message; fields that are not given are zero."""
    kind, zeros = kind_of(name)
    sender = dialect.MAVLink(None, system, component)
    sender.seq = sequence
    return bytes(kind(**zeros | values).pack(sender, version == 1))


def tlog(frames):
    """Frames behind their receive stamps, 10 ms apart."""
    return b"".join(
        struct.pack(">Q", NOW + 10_000 * row) + content for row, content in enumerate(frames)
    )


def read(content):
    """The log of a file that holds this."""
    with NamedTemporaryFile(suffix=".tlog") as file:
        file.write(content)
        file.flush()
        return read_log(file.name)


def flight(times, system=1, sequence=0):
    """ATTITUDE and SERVO_OUTPUT_RAW at boot clock times, s; the latter's clock wraps as it does on board."""
    frames = []
    for time in times:
        boot_ms = round(time * 1e3) % 2**32
        boot_us = round(time * 1e6) % 2**32
        frames.append(
            message("ATTITUDE", system, sequence=sequence % 256, time_boot_ms=boot_ms, roll=0.1)
        )
        frames.append(
            message(
                "SERVO_OUTPUT_RAW",
                system,
                sequence=(sequence + 1) % 256,
                time_usec=boot_us,
                servo1_raw=1500,
            )
        )
        sequence += 2
    return frames


def stamped_flight(attitudes):
    """A log with a HEARTBEAT and ATTITUDEs, of stamps and times of reception, s."""
    content = struct.pack(">Q", NOW) + message("HEARTBEAT", type=2, autopilot=3)
    for row, (stamp, reception) in enumerate(attitudes):
        frame = message("ATTITUDE", sequence=(row + 1) % 256, time_boot_ms=round(stamp * 1e3))
        content += struct.pack(">Q", NOW + round(1e6 * reception)) + frame
    return content


def heartbeat(system=1, component=1, kind=2, autopilot=3):
    return message("HEARTBEAT", system, component, type=kind, autopilot=autopilot)


TIMES = [20 + 0.01 * row for row in range(300)]
HOVER = (heartbeat(), *flight(TIMES))


def frames_in(content, gap=0):
    """What the reader finds, as one table."""
    return find_frames(np.frombuffer(content, dtype=np.uint8), crc_extra_table(), gap)
