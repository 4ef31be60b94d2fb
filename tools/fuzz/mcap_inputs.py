"""Inputs for the reader of MCAP recordings.

The first byte of an input is its mode: the rest is a file as it is, or pieces that become one: a message on the topic
of its first byte, any other record, or a whole flight.
"""

from __future__ import annotations

import struct
import zlib
from math import cos, sin

import harness
import lz4.frame
import zstandard
from mavlink_streams import heartbeat, message

from mavdem.ingest.mcap.log import read_mcap
from mavdem.ingest.mcap.records import CHANNEL, CHUNK, FOOTER, MAGIC, MESSAGE

# The first byte of a piece chooses one.
CHANNELS = [
    *((f"mavlink/1/1/{name}", "json", 1) for name in ("ATTITUDE", "SERVO_OUTPUT_RAW", "HEARTBEAT", "PARAM_VALUE")),
    *((f"mavlink/1/1/{name}", "json", 1) for name in ("STATUSTEXT", "SYSTEM_TIME", "EXTENDED_SYS_STATE", "OTHER")),
    *((f"/mavlink/2/1/{name}", "json5", 1) for name in ("ATTITUDE_QUATERNION", "HIL_ACTUATOR_CONTROLS")),
    ("mavlink/out", "json", 1),
    ("mavlink/raw", "mavlink", 0),
    ("serial", "", 0),
    ("camera", "cdr", 1),
]
OUT, RAW, SERIAL = 10, 11, 12
FILE, PLAIN, CHUNKED, LZ4, ZSTD, WRONG_SUM = range(6)
ANY = b"\xfe"
NOW = 1_700_000_000_000_000_000


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode & 0xFF, len(content)) + content


def text(content: bytes) -> bytes:
    return struct.pack("<I", len(content)) + content


def sent(channel: int, body: bytes, stamp: int) -> bytes:
    return record(MESSAGE, struct.pack("<HIQQ", channel, 0, stamp, stamp) + body)


def channel_record(number: int, topic: str, encoding: str, schema: int) -> bytes:
    return record(
        CHANNEL, struct.pack("<HH", number, schema) + text(topic.encode()) + text(encoding.encode()) + text(b"")
    )


def records(piece: bytes, row: int) -> bytes:
    """The records of a piece: a flight, a record with the opcode after ``ANY``, or a message."""
    stamp = NOW + 10_000_000 * row
    if piece.startswith(harness.FLIGHT):
        made = [sent(OUT, b'{"message":{"type":"HEARTBEAT","mavtype":2,"autopilot":3}}', stamp)]
        for number, time in enumerate(harness.times(piece)):
            body = b'{"time_boot_ms":%d,"roll":%.4f,"pitch":0,"yaw":0,"rollspeed":%.3f,"pitchspeed":0,"yawspeed":0}'
            made.append(
                sent(
                    0,
                    body % (round(1e3 * time), sin(3 * time) / 10, cos(3 * time) * 3 / 10),
                    stamp + 1_000_000 * number,
                )
            )
            body = b'{"time_usec":%d,"servo1_raw":%d,"servo2_raw":1600,"servo3_raw":1500,"servo4_raw":1500,"port":0}'
            made.append(sent(1, body % (round(1e6 * time), 1500 + 50 * sin(5 * time)), stamp + 1_000_000 * number))
        return b"".join(made)
    if piece.startswith(ANY):
        return record(piece[1] if len(piece) > 1 else 0, piece[2:])
    return sent(piece[0] % len(CHANNELS), piece[1:], stamp) if piece else b""


def recording(data: bytes) -> bytes:
    mode, pieces = data[0] % 6 if data else 0, harness.pieces(data[1:])
    if mode == FILE:
        return MAGIC + data[1:]
    channels = b"".join(channel_record(number, *channel) for number, channel in enumerate(CHANNELS))
    made = [channels, *(records(piece, row) for row, piece in enumerate(pieces))]
    if mode != PLAIN:
        compression, pack = {LZ4: (b"lz4", lz4.frame.compress), ZSTD: (b"zstd", zstandard.compress)}.get(
            mode, (b"", bytes)
        )
        half = len(made) // 2 + 1
        made = [
            chunk(b"".join(part), compression, pack(b"".join(part)), mode == WRONG_SUM)
            for part in (made[:half], made[half:])
        ]
    return MAGIC + b"".join(made) + record(FOOTER, bytes(20)) + MAGIC


def chunk(content: bytes, compression: bytes, packed: bytes, wrong: bool) -> bytes:
    checksum = zlib.crc32(content) ^ wrong
    head = struct.pack("<QQQI", 0, 0, len(content), checksum) + text(compression) + struct.pack("<Q", len(packed))
    return record(CHUNK, head + packed)


def seeds() -> dict[str, bytes]:
    header = b'{"header":{"system_id":1,"component_id":1,"sequence":%d,"message_id":30},"message":{"type":"%s",%s}}'
    bodies = [
        b"\2"
        + header % (0, b"HEARTBEAT", b'"mavtype":{"type":"MAV_TYPE_QUADROTOR"},"autopilot":3,"base_mode":{"bits":209}'),
        b"\0" + header % (1, b"ATTITUDE", b'"time_boot_ms":20000,"roll":0.1,"pitch":NaN,"yaw":-inf'),
        b"\1" + header % (2, b"SERVO_OUTPUT_RAW", b'"time_usec":20000000,"servo1_raw":1500'),
        b"\3" + header % (3, b"PARAM_VALUE", b'"param_value":33.0,"param_id":["A","\\u0000"],"param_type":9'),
        b"\4" + header % (4, b"STATUSTEXT", b'"severity":"MAV_SEVERITY_INFO","text":"hello"'),
        b"\6" + header % (5, b"EXTENDED_SYS_STATE", b'"landed_state":{"type":"MAV_LANDED_STATE_IN_AIR"}'),
        b"\7" + header % (6, b"OTHER", b'"x":1'),
        b'\x08{"time_boot_ms":5,"q1":1,"q2":0,"q3":0,"q4":0,"rollspeed":"1.5","repr_offset_q":[1,2,3,4]}',
        b'\x09{"time_usec":5,"controls":[0.5,0.5,0.5,0.5],"mode":"MAV_MODE_FLAG_SAFETY_ARMED | 1"}',
        b"\x0a" + header % (7, b"VFR_HUD", b'"alt":1.0,"climb":null,"heading":-3'),
        b"\x0b" + heartbeat() + message("ATTITUDE", time_boot_ms=20_000, roll=0.1),
        b"\x0c" + message("SERVO_OUTPUT_RAW", time_usec=20_000_000, servo1_raw=1500, version=1),
        b"\x0d\xff\xd8",
        ANY + b"\x01" + text(b"") + text(b"profile"),
        ANY + b"\x04" + struct.pack("<HH", 1, 1) + text(b"mavlink/3/1/VFR_HUD") + text(b"json") + text(b""),
        harness.flight(20, 0.022, 250),
    ]
    whole = [(mode, parts) for mode in range(1, 6) for parts in (bodies, bodies[:-1])]
    return harness.corpus([*whole, *((1 + n % 5, [body]) for n, body in enumerate(bodies))], recording, len(MAGIC))


def check(data: bytes) -> None:
    harness.check(read_mcap, recording(data), ".mcap")
