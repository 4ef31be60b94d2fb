#!/usr/bin/env python
"""Writes a long telemetry log as an input of read.py.

The messages of an ArduPilot quadrotor at 100 Hz: attitude, motor outputs and inertial units at the full rate, the rest
at 1 to 10 Hz. Fields are random, clocks run, and MAVLink 2 payloads are not truncated.

Usage: tools/bench/long_tlog.py MEGABYTES LONG.tlog
"""

from __future__ import annotations

from itertools import count
from pathlib import Path
from random import Random

import click
import numpy as np

from mavdem.ingest.mavlink.definitions import MessageDefinition, definitions
from mavdem.ingest.mavlink.framing import frame_checksum

PERIOD_STEPS = {
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
"""Steps of 10 ms between two messages, by type."""
FIRST_STAMP_MICROSECONDS = 1_700_000_000_000_000


def frame(definition: MessageDefinition, step: int, sequence: int, chance: Random) -> bytes:
    """The stamped frame sent at ``step``."""
    payload = bytearray(chance.randbytes(definition.wire.itemsize))
    known = {"time_boot_ms": 10 * (100 + step), "time_usec": 10_000 * (100 + step)}
    if definition.name == "HEARTBEAT":
        known |= {"type": 2, "autopilot": 3}
    for name, value in known.items():
        if name in definition.fields:
            field = np.ndarray((1,), definition.wire, payload)[name]
            field[0] = value % 256**field.itemsize
    stamp = (FIRST_STAMP_MICROSECONDS + 10_000 * step).to_bytes(8, "big")
    head = bytes([len(payload), 0, 0, sequence % 256, 1, 1]) + definition.message_id.to_bytes(3, "little")
    checksum = frame_checksum(head + payload, definition.seed)
    return stamp + b"\xfd" + head + payload + checksum.to_bytes(2, "little")


@click.command(help=__doc__)
@click.argument("megabytes", type=click.IntRange(1))
@click.argument("to", metavar="LONG.tlog", type=click.Path(dir_okay=False, path_type=Path))
def main(megabytes: int, to: Path) -> None:
    by_name = {definition.name: definition for definition in definitions().values()}
    chance, sequence = Random(0), 0
    with to.open("wb") as file:
        for step in count():
            for rank, (name, every) in enumerate(PERIOD_STEPS.items()):
                if step % every == rank % every:
                    file.write(frame(by_name[name], step, sequence, chance))
                    sequence += 1
            if file.tell() >= megabytes * 1_000_000:
                break


if __name__ == "__main__":
    main()
