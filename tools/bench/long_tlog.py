#!/usr/bin/env python
"""Writes a long telemetry log to read.

What an ArduPilot quadrotor sends at 100 Hz, in about the shares of such a flight: attitude, motor outputs and inertial
units at the full rate, the rest at 1 to 10 Hz; random fields, running clocks, MAVLink 2 without truncated zeros.

Usage: tools/bench/long_tlog.py MEGABYTES LONG.tlog
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.checksum import LONGEST, checksums
from mavdem.ingest.decode import Definition, definitions

EVERY = {
    "ATTITUDE": 1,
    "SERVO_OUTPUT_RAW": 1,
    "ATTITUDE_QUATERNION": 1,
    "RAW_IMU": 1,
    "SCALED_IMU2": 1,
    "SIMSTATE": 1,
    "LOCAL_POSITION_NED": 1,
    "ATTITUDE_TARGET": 5,
    "GLOBAL_POSITION_INT": 10,
    "ESC_TELEMETRY_1_TO_4": 10,
    "PARAM_VALUE": 10,
    "WIND": 20,
    "GPS_RAW_INT": 20,
    "VFR_HUD": 20,
    "SYS_STATUS": 50,
    "HEARTBEAT": 100,
}
"""Messages, and steps of 10 ms between two of them."""
FIRST = 1_700_000_000_000_000
STEPS = 20_000
"""Steps written at a time."""


def frames(definition: Definition, step: NDArray[np.int64], chance: np.random.Generator) -> NDArray[np.uint8]:
    """Stamped frames (N, width) sent at ``step`` (N,), sequence numbers and checksums still open."""
    size = definition.wire.itemsize
    table = chance.integers(1, 255, (len(step), 8 + 10 + size + 2), dtype=np.uint8)
    table[:, :8] = (FIRST + 10_000 * step).astype(">u8")[:, None].view(np.uint8)
    table[:, 8:18] = [0xFD, size, 0, 0, 0, 1, 1, *definition.message_id.to_bytes(3, "little")]
    payload = np.ascontiguousarray(table[:, 18:-2]).view(definition.wire)[:, 0]
    for name, units in (("time_boot_ms", 10), ("time_usec", 10_000)):
        if name in definition.fields:
            payload[name] = (100 + step) * units % 2**32
    if definition.name == "HEARTBEAT":
        payload["type"], payload["autopilot"] = 2, 3
    table[:, 18:-2] = payload[:, None].view(np.uint8)
    return table


def cycle(first: int, chance: np.random.Generator) -> bytes:
    """What is sent in ``STEPS`` steps from ``first`` on."""
    by_name = {definition.name: definition for definition in definitions().values()}
    tables, orders = [], []
    for rank, (name, every) in enumerate(EVERY.items()):
        step = first + np.arange(rank % every, STEPS, every)
        tables.append((frames(by_name[name], step, chance), by_name[name].seed))
        orders.append(step * len(EVERY) + rank)
    order = np.argsort(np.concatenate(orders), kind="stable")
    sequence = np.empty(len(order), dtype=np.uint8)
    sequence[order] = np.arange(len(order))
    widths = np.concatenate([np.full(len(table), table.shape[1]) for table, _ in tables])
    ends = np.empty(len(order), dtype=np.int64)
    ends[order] = np.cumsum(widths[order])
    content, row = np.zeros(int(widths.sum()) + LONGEST, dtype=np.uint8), 0
    for table, seed in tables:
        rows = slice(row, row + len(table))
        row += len(table)
        table[:, 12] = sequence[rows]
        width = table.shape[1]
        places = ends[rows] - width
        np.lib.stride_tricks.sliding_window_view(content, width, writeable=True)[places] = table
        counts, seeds = np.full(len(table), width - 11), np.full(len(table), seed, dtype=np.int32)
        sums = checksums(content, places + 9, counts, seeds)
        content[ends[rows] - 2], content[ends[rows] - 1] = sums & 0xFF, sums >> 8
    return content[:-LONGEST].tobytes()


@click.command(help=__doc__)
@click.argument("megabytes", type=click.IntRange(1))
@click.argument("to", metavar="LONG.tlog", type=click.Path(dir_okay=False, path_type=Path))
def main(megabytes: int, to: Path) -> None:
    chance, first, left = np.random.default_rng(0), 0, megabytes * 1_000_000
    with to.open("wb") as file:
        while left > 0:
            content = cycle(first, chance)
            file.write(content)
            first, left = first + STEPS, left - len(content)


if __name__ == "__main__":
    main()
