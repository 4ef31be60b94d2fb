#!/usr/bin/env python
"""How fast a telemetry log is read and in how much memory, beside pymavlink and fasttlogparser.

``tools/bench/long_tlog.py`` writes a long one. fasttlogparser (PyPI) is left out where it is not installed.

Each reader has a process of its own, and they take turns. Ours counts every message, takes the rate of each and the
columns of the messages a roll model needs; fasttlogparser makes the columns of those same messages (it has no frames
without columns); pymavlink's recv_match hands out message by message and is stopped after the first of them. The
memory is the most that was resident beyond what lies in files, so beyond the page cache.

Usage: tools/bench/read_tlog.py FLIGHT.tlog ...
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import time
from pathlib import Path

import click

NEEDED = ("ATTITUDE", "SERVO_OUTPUT_RAW", "HEARTBEAT", "PARAM_VALUE")
REPEATS = 3
FIRST = 1_000_000
"""Messages after which pymavlink is stopped."""


def mavdem(path: str) -> int:
    from mavdem.ingest import read_log

    log = read_log(path)
    for vehicle in log.vehicles:
        for name, columns in vehicle.messages.items():
            times = columns["time"]
            print(name, len(times), len(times) / max(times[-1] - times[0], 1e-9), file=sys.stderr)
        for name in NEEDED:
            if name in vehicle.messages:
                dict(vehicle.messages[name])
    return log.frames


def pymavlink(path: str) -> int:
    from pymavlink import mavutil

    reader, count = mavutil.mavlogfile(path, robust_parsing=True), 0
    while count < FIRST and reader.recv_match() is not None:
        count += 1
    return count


def fasttlogparser(path: str) -> int:
    from fasttlogparser import parseTLog

    messages, _ = parseTLog(path)
    return sum(len(next(iter(fields.values()))) for fields in messages.values())


READERS = {reader.__name__: reader for reader in (mavdem, pymavlink, fasttlogparser)}


def measured(reader: str, path: str) -> tuple[int, float, float]:
    """Messages, seconds without the imports, and the most memory, MB."""
    command = [sys.executable, __file__, "--one", reader, path]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        most = 0.0
        while process.poll() is None:
            most = max(most, resident(process.pid))
            time.sleep(0.002)
        said = process.stdout.read().splitlines() if process.stdout else []
    count, seconds = said[-1].split() if said else ("0", "nan")
    return int(count), float(seconds), most


def resident(process: int) -> float:
    """Memory of a process beyond mapped files, MB; 0 where it has ended."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return 0.0
    lines = [line.split() for line in status.splitlines() if line.startswith(("RssAnon", "RssShmem"))]
    return sum(float(line[1]) for line in lines) / 1e3


def one(reader: str, path: str) -> None:
    importlib.import_module({"mavdem": "mavdem.ingest", "pymavlink": "pymavlink.mavutil"}.get(reader, reader))
    begin = time.perf_counter()
    count = READERS[reader](path)
    print(f"\n{count} {time.perf_counter() - begin}")


@click.command(help=__doc__)
@click.argument("logs", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False))
@click.option("--one", "reader", hidden=True, type=click.Choice(list(READERS)))
def main(logs: tuple[str, ...], reader: str | None) -> None:
    if reader is not None:
        return one(reader, *logs)
    readers = [reader for reader in READERS if reader == "mavdem" or importlib.util.find_spec(reader)]
    print(f"{'log':36} {'reader':14} {'messages':>11} {'messages/s':>12} {'memory MB':>10} {'of the file':>11}")
    for path in logs:
        runs = [(reader, measured(reader, path)) for _ in range(REPEATS) for reader in readers]
        for reader in readers:
            count, seconds, most = min((run for name, run in runs if name == reader), key=lambda run: run[1])
            share = most * 1e6 / os.path.getsize(path)
            print(f"{Path(path).name:36} {reader:14} {count:11,} {count / seconds:12,.0f} {most:10,.0f} {share:11.2f}")


if __name__ == "__main__":
    main()
