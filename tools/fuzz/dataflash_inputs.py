"""Inputs for the reader of DataFlash logs.

The first byte of an input is its mode: the rest is a file as it is, or pieces that become one, binary or a line of text
each, with or without the usual definitions before them; or a whole flight.
"""

from __future__ import annotations

from math import cos, sin

import dataflash_logs as made
import harness

from mavdem.ingest.dataflash.log import read_dataflash

FILE, OWN, DEFINED, TEXT, DEFINED_TEXT = range(5)
TEXT_FORMATS = "\n".join(
    ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns"]
    + [f"FMT, {kind}, 0, {name}, {characters}, {fields}" for name, (kind, characters, fields) in made.MESSAGES.items()]
).encode()


def made_of(piece: bytes, text: bool) -> bytes:
    if not piece.startswith(harness.FLIGHT):
        return piece
    parts = []
    for time in harness.times(piece):
        roll, rate, wish, stamp = 5 * sin(3 * time), 15 * cos(3 * time), sin(5 * time), round(1e6 * time)
        if text:
            lines = (
                f"ATT, {stamp}, 0, {roll:.2f}, 0, 0, 0, 0, 0, 0, 3",
                f"RATE, {stamp}, 0, {rate:.3f}, {wish:.3f}, 0, 0, 0, 0, 0, 0, 0, 0, 0.5, 1",
                f"RCOU, {stamp}, {1500 + 50 * wish:.0f}, 1600, 1500, 1500" + ", 0" * 10,
            )
            parts += [line.encode() for line in lines]
        else:
            parts += [made.att(time, roll), made.rate(time, rate, wish), made.rcou(time, 1500 + round(50 * wish), 1600)]
    return (b"\n" if text else b"").join(parts)


def log(content: bytes) -> bytes:
    mode = content[0] % 5 if content else 0
    if mode == FILE:
        return content[1:]
    text = mode in (TEXT, DEFINED_TEXT)
    pieces = [made_of(piece, text) for piece in harness.pieces(content[1:])]
    if mode in (DEFINED, DEFINED_TEXT):
        pieces.insert(0, TEXT_FORMATS if text else made.formats())
    return b"\n".join(pieces) if text else b"".join(pieces)


def seeds() -> dict[str, bytes]:
    message = made.message
    messages = [message("MSG", 1_000_000, "ArduCopter V4.5.7"), message("MSG", 1, "Frame: QUAD/X")]
    messages += [message("PARM", 1_000_000, "FRAME_CLASS", 1.0, 0.0), message("PARM", 1, "SYSID_THISMAV", 7.0, 1.0)]
    rows = [
        row for n in range(3) for row in (made.att(20 + n / 100, 2), made.rate(20 + n / 100, 1), made.rcou(20, 1500))
    ]
    rows += [message("EV", 20_500_000, 10), message("EV", 20_600_000, 28), message("ARM", 21_000_000, 0, 0, 0, 1)]
    rows += [message("CTUN", 20_500_000, 0.5, 1, 2), message("IMU", 20_500_000, 0, 0.1, 0.2, 0.3)]
    formats = [made.fmt(name) for name in ("ATT", "RATE", "RCOU", "EV")]
    wrong = [made.fmt("ATT", length=10), made.fmt("RATE", characters="QfffaZnNgLeE"), made.fmt("EV", kind=129)]
    hover = harness.flight(20, 0.022, 250)
    lines = [
        b"ATT, 20000000, 0, 1.5, 0, 0, 0, 0, 0, 0, 3",
        b"RATE, 20000000, 0, 1, 0.1, 0, 0, 0, 0, 0, 0, 0, 0, 0.5, 1",
        b"RCOU, 20000000, 1500, 1600" + b", 0" * 12,
        b"EV, 20000001, 10",
        b"MSG, 1, ArduCopter V4, with commas",
        b"PARM, 1, FRAME_CLASS, 1, nan",
    ]
    own = [b"FMT, 129, 0, ATT, Qcccc, TimeUS,Roll,Pitch,Yaw,X", b"FMT, 130, 0, RATE, Qfff, TimeMS,R,P,Y"]
    own += [b"ATT, 1e5, 1, 2, 3, 4", b"RATE, 5, inf, -1e400, nan"]
    lists = {
        OWN: [[*formats, *messages, *rows], [*wrong, *rows], [*formats, hover, *wrong, hover], rows],
        DEFINED: [[*messages, *rows], [hover, *rows], [*messages, hover, *wrong, hover], [*wrong, hover]],
        TEXT: [own, [*own, *lines], TEXT_FORMATS.split(b"\n")[:4] + lines],
        DEFINED_TEXT: [lines, [hover, *lines], [hover, *own, *lines]],
    }
    return harness.corpus([(mode, parts) for mode, some in lists.items() for parts in some], log)


def check(content: bytes) -> None:
    harness.check(read_dataflash, log(content), ".bin")
