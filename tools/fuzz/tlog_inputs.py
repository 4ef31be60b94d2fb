"""Inputs for the reader of telemetry logs: the first byte is the mode, the rest a file.

Besides what ``harness`` asserts, blocks of a few bytes give the same result as one. An odd mode gives every frame a
correct checksum first: otherwise hardly any change would pass it.
"""

from __future__ import annotations

from pathlib import Path

import harness
from pymavlink.dialects.v20 import all as dialect
from pymavlink.generator.mavcrc import x25crc
from whole_logs import everything, in_small_blocks, read

ROOT = Path(__file__).parents[2]


def mended(content: bytes) -> bytes:
    """The stream with a correct checksum behind whatever looks like a frame of a known message."""
    stream, place = bytearray(content), 8
    while place + 8 <= len(stream):
        second = stream[place] == 0xFD
        if stream[place] not in (0xFD, 0xFE) or (second and stream[place + 2] > 1):
            place += 1
            continue
        header = 10 if second else 6
        end = place + header + stream[place + 1]
        if end + 2 > len(stream):
            break
        message_id = int.from_bytes(stream[place + 7 : place + 10], "little") if second else stream[place + 5]
        if message_id in dialect.mavlink_map:
            seed = dialect.mavlink_map[message_id].crc_extra
            stream[end : end + 2] = x25crc([*stream[place + 1 : end], seed]).crc.to_bytes(2, "little")
        place = end + 2 + (13 if second and stream[place + 2] == 1 else 0) + 8
    return bytes(stream)


def check(data: bytes) -> None:
    content = mended(data[1:]) if data[:1] and data[0] % 2 else data[1:]
    log = read(content)
    assert everything(log) == everything(in_small_blocks(content)), "blocks matter"
    if log is not None:
        harness.check_columns(log)


def seeds() -> dict[str, bytes]:
    """Six pieces of each sample log."""
    found = {}
    for sample in sorted((ROOT / "logs").glob("*.tlog")):
        content = sample.read_bytes()
        for row, place in enumerate(range(0, len(content), len(content) // 6)):
            found[f"{sample.stem}_{row}"] = b"\1" + content[place : place + 600]
    return found
