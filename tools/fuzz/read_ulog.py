#!/usr/bin/env python
"""Looks for a ULog file that the reader does not survive: ``python tools/fuzz/read_ulog.py [CORPUS] [OPTIONS]``.

See ``read_tlog.py`` for the options. The first byte of an input says what is made of the rest: a file as it is, or one
of its pieces, each of them a message led by the letter of its kind, with a length that is right, or a whole flight.
"""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import whole

sys.path.insert(0, str(Path(__file__).parents[2] / "tests/ingest"))

import numpy as np  # noqa: E402
from ulog_files import (  # noqa: E402
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

from mavdem.ingest.ulog import read_ulog  # noqa: E402

FILE, OWN, DEFINED, FITTED = range(4)
SIZES = {NUMBERS[name]: struct.calcsize(layout) for name, layout in LAYOUTS.items()}


def made_of(piece: bytes, fitted: bool) -> bytes:
    """The message that a piece stands for; ``fitted``: a data message gets the size that its topic has."""
    if piece.startswith(whole.FLIGHT):
        return b"".join(flight(np.array(whole.times(piece))))
    kind, content = piece[:1], piece[1:]
    if fitted and kind == b"D" and len(content) >= 2:
        size = 2 + SIZES.get(content[0], len(content) - 2)
        content = content[:1] + b"\0" + content[2:size].ljust(size - 2, b"\0")
    return struct.pack("<H", len(content) & 0xFFFF) + kind + content if kind else b""


def log(content: bytes) -> bytes:
    mode = content[0] % 4 if content else 0
    if mode == FILE:
        return HEADER + content[1:]
    first = definitions() + subscriptions() if mode != OWN else b""
    return HEADER + first + b"".join(made_of(piece, mode == FITTED) for piece in whole.pieces(content[1:]))


def seeds() -> dict[str, bytes]:
    def piece(whole_message: bytes) -> bytes:
        return whole_message[2:]

    told = [b"D" + struct.pack("<HQQ", NUMBERS[name], 20_000_000, 19_999_000) + b"\1\0\0\x3f" * 9 for name in LAYOUTS]
    texts = [
        f"{name}:{FORMATS[name]}".encode()
        for name in ("vehicle_attitude", "position_setpoint", "position_setpoint_triplet")
    ]
    own = [b"F" + part for part in texts]
    own += [
        b"Fvehicle_angular_velocity:uint64_t timestamp;float[3] xyz;",
        b"Factuator_motors:uint64_t timestamp;int8_t[12] control;",
    ]
    own += [
        piece(subscription("vehicle_attitude")),
        piece(subscription("vehicle_angular_velocity")),
        piece(subscription("actuator_motors")),
    ]
    own += [piece(data("vehicle_attitude", 20 + n / 10, 1, 0, 0, 0, 0)) for n in range(3)]
    own += [b"D" + struct.pack("<HQ", 1, 20_000_000 + 100_000 * n) + b"\1\0\0\x3f" * 3 for n in range(3)]
    own += [b"D" + struct.pack("<HQ", 2, 20_000_000 + 100_000 * n) + b"\1\0\0\x3f" * 3 for n in range(3)]
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
    hover = [whole.flight(20, 0.022, 250)]
    states = [piece(data("vehicle_land_detected", 20, False)), piece(data("vehicle_control_mode", 20, True))]
    states += [
        piece(data("vehicle_status", 20, 2, 2, 1)),
        piece(data("position_setpoint_triplet", 20, 0, 0.0, True, 1, 0, 1.0, True, 4)),
    ]
    states += [piece(data("vehicle_local_position", 20 + n, 0, 0, 0, 0, 0, n, True)) for n in range(2)]
    states += [piece(data("actuator_outputs", 20 + n / 100, 4, *[1500 + n] * 16)) for n in range(3)]
    lists = [own, [*own[:3], *others, *own[3:]], others, told, states, [*hover, *states], [*states, *others, *hover]]
    made = whole.corpus([(mode, parts) for mode in (1, 2, 3) for parts in lists])
    made |= {f"file_{row}": b"\0" + log(b"\1" + whole.BETWEEN.join(parts))[16:] for row, parts in enumerate(lists)}
    return made


def check(content: bytes) -> None:
    whole.check(read_ulog, log(content), ".ulg")


if __name__ == "__main__":
    whole.run(sys.argv, check, seeds())
