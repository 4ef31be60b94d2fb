#!/usr/bin/env python
"""Looks for a DataFlash log that the reader does not survive: ``tools/fuzz/read_dataflash.py [CORPUS] [OPTIONS]``.

See ``read_tlog.py`` for the options. The first byte of an input says what is made of the rest: a file as it is, or one
of its pieces, binary or a line of text each, with the usual definitions before them or without; or a whole flight.
"""

from __future__ import annotations

import sys
from math import cos, sin
from pathlib import Path

import whole

sys.path.insert(0, str(Path(__file__).parents[2] / "tests/ingest"))

import dataflash_logs as made  # noqa: E402

from mavdem.ingest.dataflash import read_dataflash  # noqa: E402

FILE, OWN, DEFINED, TEXT, DEFINED_TEXT = range(5)
TEXT_FORMATS = "\n".join(
    ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns"]
    + [f"FMT, {kind}, 0, {name}, {characters}, {fields}" for name, (kind, characters, fields) in made.MESSAGES.items()]
).encode()


def made_of(piece: bytes, text: bool) -> bytes:
    if not piece.startswith(whole.FLIGHT):
        return piece
    times = whole.times(piece)
    rows = [(time, 5 * sin(3 * time), 15 * cos(3 * time), sin(5 * time)) for time in times]
    if not text:
        parts = [
            (made.att(t, roll), made.rate(t, rate, wish), made.rcou(t, 1500 + round(50 * wish), 1600))
            for t, roll, rate, wish in rows
        ]
        return b"".join(b"".join(part) for part in parts)
    lines = []
    for time, roll, rate, wish in rows:
        stamp = round(1e6 * time)
        lines.append(f"ATT, {stamp}, 0, {roll:.2f}, 0, 0, 0, 0, 0, 0, 3")
        lines.append(f"RATE, {stamp}, 0, {rate:.3f}, {wish:.3f}, 0, 0, 0, 0, 0, 0, 0, 0, 0.5, 1")
        lines.append(f"RCOU, {stamp}, {1500 + 50 * wish:.0f}, 1600, 1500, 1500" + ", 0" * 10)
    return "\n".join(lines).encode()


def log(content: bytes) -> bytes:
    mode = content[0] % 5 if content else 0
    if mode == FILE:
        return content[1:]
    text = mode in (TEXT, DEFINED_TEXT)
    pieces = [made_of(piece, text) for piece in whole.pieces(content[1:])]
    if mode in (DEFINED, DEFINED_TEXT):
        pieces.insert(0, TEXT_FORMATS if text else made.formats())
    return b"\n".join(pieces) if text else b"".join(pieces)


def seeds() -> dict[str, bytes]:
    message = made.message
    told = [message("MSG", 1_000_000, "ArduCopter V4.5.7"), message("MSG", 1, "Frame: QUAD/X")]
    told += [message("PARM", 1_000_000, "FRAME_CLASS", 1.0, 0.0), message("PARM", 1, "SYSID_THISMAV", 7.0, 1.0)]
    rows = [
        row for n in range(3) for row in (made.att(20 + n / 100, 2), made.rate(20 + n / 100, 1), made.rcou(20, 1500))
    ]
    rows += [message("EV", 20_500_000, 10), message("EV", 20_600_000, 28), message("ARM", 21_000_000, 0, 0, 0, 1)]
    rows += [message("CTUN", 20_500_000, 0.5, 1, 2), message("IMU", 20_500_000, 0, 0.1, 0.2, 0.3)]
    formats = [made.fmt(name) for name in ("ATT", "RATE", "RCOU", "EV")]
    wrong = [made.fmt("ATT", length=10), made.fmt("RATE", characters="QfffaZnNgLeE"), made.fmt("EV", kind=129)]
    hover = whole.flight(20, 0.022, 250)
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
        OWN: [[*formats, *told, *rows], [*wrong, *rows], [*formats, hover, *wrong, hover], rows],
        DEFINED: [[*told, *rows], [hover, *rows], [*told, hover, *wrong, hover], [*wrong, hover]],
        TEXT: [own, [*own, *lines], TEXT_FORMATS.split(b"\n")[:4] + lines],
        DEFINED_TEXT: [lines, [hover, *lines], [hover, *own, *lines]],
    }
    found = whole.corpus([(mode, parts) for mode, some in lists.items() for parts in some])
    found |= {
        f"file_{mode}_{row}": b"\0" + log(bytes([mode]) + whole.BETWEEN.join(parts))
        for mode, some in lists.items()
        for row, parts in enumerate(some)
        if hover not in parts
    }
    return found


def check(content: bytes) -> None:
    whole.check(read_dataflash, log(content), ".bin")


if __name__ == "__main__":
    whole.run(sys.argv, check, seeds())
