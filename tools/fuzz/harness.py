"""Shared by the fuzzers: the initial corpus, the pieces of an input, and what must hold of a log.

Any bytes are read, or refused with ``Unreadable`` in one sentence, within the time and the memory that libFuzzer allows
(``-timeout``, ``-rss_limit_mb``). Nothing is printed. Every column has as many rows as its ``time``, no time is
infinite, and ``mavdem info`` can report on it.
"""

from __future__ import annotations

import contextlib
import io
import struct
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from mavdem.condition.inventory import inventory
from mavdem.errors import NotLearnable, Unreadable
from mavdem.ingest import Log

BETWEEN = b"\xff\n"  # separates the pieces of an input: it hardly occurs in JSON, names and numbers
FLIGHT = b"~"  # first byte of a piece that is replaced by a whole flight, which single bytes would never make
MEMORY = Path("/dev/shm")
Read = Callable[[str], Log]


def pieces(data: bytes) -> list[bytes]:
    return data.split(BETWEEN)


def corpus(
    seeds: Iterable[tuple[int, list[bytes]]], log: Callable[[bytes], bytes], header: int = 0
) -> dict[str, bytes]:
    """Inputs by name: a first byte, the mode, and the pieces; and the file that ``log`` makes of them, of mode 0.

    ``header`` is the number of bytes that a file of mode 0 gets anyway.
    """
    found = {}
    for row, (mode, parts) in enumerate(seeds):
        found[f"seed_{row}"] = bytes([mode]) + BETWEEN.join(parts)
        if not any(part.startswith(FLIGHT) for part in parts):
            found[f"file_{row}"] = b"\0" + log(found[f"seed_{row}"])[header:]
    return found


def times(piece: bytes) -> list[float]:
    """The stamps (s) of a whole flight, from its piece: the first stamp, the step and their number."""
    first, step, count = struct.unpack_from("<IIB", piece[1:].ljust(9, b"\0"))
    return [0.001 + first / 1e4 + row * step / 1e6 for row in range(count)]


def flight(first: float, step: float, count: int) -> bytes:
    """The piece that is replaced by such a flight."""
    return FLIGHT + struct.pack("<IIB", round(1e4 * first), round(1e6 * step), count)


def check(read: Read, content: bytes, suffix: str) -> None:
    """Reads the content as a file and asserts what must hold of any."""
    printed = io.StringIO()
    with tempfile.NamedTemporaryFile(suffix=suffix, dir=MEMORY if MEMORY.exists() else None) as file:
        file.write(content)
        file.flush()
        with contextlib.redirect_stdout(printed):
            try:
                log = read(file.name)
            except Unreadable as error:
                assert "\n" not in str(error), error
                log = None
    assert not printed.getvalue(), printed.getvalue()
    if log is not None:
        check_columns(log)
        with contextlib.suppress(NotLearnable, Unreadable):
            inventory(log)


def check_columns(log: Log) -> None:
    for vehicle in log.vehicles:
        for name, columns in vehicle.messages.items():
            assert not np.isinf(columns["time"]).any(), name
            assert {len(values) for values in columns.values()} == {columns["time"].size}, name
