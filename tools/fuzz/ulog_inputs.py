"""Inputs for the reader of ULog files.

The first byte of an input is its mode: the rest is a file as it is, or pieces that become one: a message with the
letter of its type and a correct length, or a whole flight.
"""

from __future__ import annotations

import struct

import harness
import numpy as np
from ulog_files import (
    FORMATS,
    HEADER,
    LAYOUTS,
    NUMBERS,
    SYNC,
    data,
    definitions,
    flight,
    parameter,
    subscription,
    subscriptions,
)

from mavdem.ingest.ulog import read_ulog

FILE, OWN, DEFINED, FITTED = range(4)
SIZES = {NUMBERS[name]: struct.calcsize(layout) for name, layout in LAYOUTS.items()}


def made_of(piece: bytes, fitted: bool) -> bytes:
    """The message of a piece; ``fitted``: a data message gets the size of its topic."""
    if piece.startswith(harness.FLIGHT):
        return b"".join(flight(np.array(harness.times(piece))))
    kind, content = piece[:1], piece[1:]
    if fitted and kind == b"D" and len(content) >= 2:
        size = 2 + SIZES.get(content[0], len(content) - 2)
        content = content[:1] + b"\0" + content[2:size].ljust(size - 2, b"\0")
    return struct.pack("<H", len(content) & 0xFFFF) + kind + content if kind else b""


def log(content: bytes) -> bytes:
    mode, header = content[0] % 4 if content else 0, bytes(HEADER)
    if mode == FILE:
        return header + content[1:]
    if mode != OWN:
        header += definitions() + subscriptions()
    return header + b"".join(made_of(piece, mode == FITTED) for piece in harness.pieces(content[1:]))


def seeds() -> dict[str, bytes]:
    def piece(whole_message: bytes) -> bytes:
        return whole_message[2:]

    stamped = [
        b"D" + struct.pack("<HQQ", NUMBERS[name], 20_000_000, 19_999_000) + b"\1\0\0\x3f" * 9 for name in LAYOUTS
    ]
    texts = [
        f"{name}:{FORMATS[name]}".encode()
        for name in ("vehicle_attitude", "position_setpoint", "position_setpoint_triplet")
    ]
    own = [b"F" + part for part in texts]
    own += [
        b"Fvehicle_angular_velocity:uint64_t timestamp;float[3] xyz;",
        b"Factuator_motors:uint64_t timestamp;int8_t[12] control;",
    ]
    own += [piece(subscription(name)) for name in ("vehicle_attitude", "vehicle_angular_velocity", "actuator_motors")]
    own += [piece(data("vehicle_attitude", 20 + n / 10, 1, 0, 0, 0, 0)) for n in range(3)]
    own += [
        b"D" + struct.pack("<HQ", topic, 20_000_000 + 100_000 * n) + b"\1\0\0\x3f" * 3
        for topic in (1, 2)
        for n in range(3)
    ]
    others = [
        piece(parameter("MAV_SYS_ID", 7)),
        piece(parameter("CA_ROTOR0_PX", 0.1, "float")),
        piece(parameter("PWM_MAIN_FUNC1", 101)),
        piece(SYNC),
        b"O\x10\0",
        b"I\x0echar[3] ver_swPX4",
        b"M\0\x0achar[3] abxyz",
        b"Q\1\x0dint32_t GAIN1\1\0\0\0",
        b"L6" + bytes(8) + b"hello",
        b"C6\1\0" + bytes(8) + b"tagged",
        b"R\1\0",
        b"B" + bytes(8) + b"\1" + bytes(7) + struct.pack("<3Q", 300, 600, 0),
    ]
    hover = [harness.flight(20, 0.022, 250)]
    states = [piece(data("vehicle_land_detected", 20, False)), piece(data("vehicle_control_mode", 20, True))]
    states += [
        piece(data("vehicle_status", 20, 2, 2, 1)),
        piece(data("position_setpoint_triplet", 20, 0, 0.0, True, 1, 0, 1.0, True, 4)),
    ]
    states += [piece(data("vehicle_local_position", 20 + n, 0, 0, 0, 0, 0, n, True)) for n in range(2)]
    states += [piece(data("actuator_outputs", 20 + n / 100, 4, *[1500 + n] * 16)) for n in range(3)]
    mixed = [*own[:3], *others, *own[3:]]
    lists = [own, mixed, others, stamped, states, [*hover, *states], [*states, *others, *hover]]
    return harness.corpus([(mode, parts) for mode in (1, 2, 3) for parts in lists], log, len(HEADER))


def check(content: bytes) -> None:
    harness.check(read_ulog, log(content), ".ulg")
