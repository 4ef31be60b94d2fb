#!/usr/bin/env python
"""How fast a log is read, beside the usual libraries of its format; prints a Markdown table.

The table has the fastest of three runs. Ours decodes attitude, motor outputs and the roll demand of each vehicle, and
has the rate of every message. The libraries: pymavlink's recv_match, message by message; fasttlogparser with all
columns; pymavlink's DFReader with the same message types as ours; pyulog with all topics; mcap with all messages in
file order, and Python's json where they are JSON. One that is not installed is left out.

Usage: tools/bench/read.py FILE.tlog|FILE.bin|FILE.ulg|FILE.mcap ...
"""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from timeit import repeat

import click


def ours(path: str) -> int:
    from mavdem.alignment import drive, signals
    from mavdem.ingest import read_log

    log = read_log(path)
    for vehicle in log.vehicles:
        for columns in vehicle.messages.values():
            len(columns["time"]) / max(columns["time"][-1] - columns["time"][0], 1e-9)
        signals.attitude(vehicle, "roll")
        drive.motors_or_obstacle(vehicle)
        drive.demand(vehicle, "roll")
    return log.frames


def recv_match(path: str) -> int:
    from pymavlink import mavutil

    return sum(1 for _ in iter(mavutil.mavlogfile(path, robust_parsing=True).recv_match, None))


def fasttlogparser(path: str) -> int:
    from fasttlogparser import parseTLog

    messages, _ = parseTLog(path)
    return sum(len(next(iter(fields.values()))) for fields in messages.values())


def dfreader(path: str) -> int:
    from pymavlink.DFReader import DFReader_binary

    kinds = ["ATT", "ANG", "RATE", "IMU", "RCOU", "CTUN", "XKF1", "EV", "ARM", "PARM", "MSG"]
    return sum(1 for _ in iter(partial(DFReader_binary(path).recv_match, type=kinds), None))


def ulog(path: str) -> int:
    from pyulog import ULog

    return sum(len(topic.data["timestamp"]) for topic in ULog(path).data_list)


def mcap(path: str) -> int:
    from mcap.reader import make_reader

    count = 0
    with open(path, "rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            count += 1
            if channel.message_encoding == "json":
                json.loads(message.data)
    return count


READERS: dict[str, dict[str, Callable[[str], int]]] = {  # by format and library
    ".tlog": {"mavdem": ours, "pymavlink": recv_match, "fasttlogparser": fasttlogparser},
    ".bin": {"mavdem": ours, "pymavlink": dfreader},
    ".ulg": {"mavdem": ours, "pyulog": ulog},
    ".mcap": {"mavdem": ours, "mcap": mcap},
}


@click.command(help=__doc__)
@click.argument("logs", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False, path_type=Path))
def main(logs: tuple[Path, ...]) -> None:
    print("| file | MB | reader | s | MB/s | messages | messages/s | mavdem is faster by |")
    print("|---|---|---|---|---|---|---|---|")
    for path in logs:
        size, fastest = path.stat().st_size / 1e6, 0.0
        for name, read in READERS[path.suffix.lower()].items():
            if importlib.util.find_spec(name) is None:
                continue
            count = read(str(path))
            seconds = min(repeat(partial(read, str(path)), number=1, repeat=3))
            fastest = fastest or seconds
            print(
                f"| {path.name} | {size:.1f} | {name} | {seconds:.2f} | {size / seconds:.1f} | {count:,} "
                f"| {count / seconds:,.0f} | {seconds / fastest:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
