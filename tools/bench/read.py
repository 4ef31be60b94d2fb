#!/usr/bin/env python
"""How fast a log is read and in how much memory, beside the usual libraries of its format; prints a Markdown table.

Each reader runs in its own process, in turn; the table has the fastest of three runs, imports left out. Ours decodes
attitude, motor outputs and the roll demand of each vehicle, and has the rate of every message. The libraries:
pymavlink's recv_match, message by message; fasttlogparser with all columns; pymavlink's DFReader with the same message
types as ours; pyulog with all topics; mcap with all messages in file order, and Python's json where they are JSON. One
that is not installed is left out. Memory is the peak of resident memory without mapped files.
``tools/bench/long_tlog.py`` writes a long telemetry log.

Usage: tools/bench/read.py FILE.tlog|FILE.bin|FILE.ulg|FILE.mcap ...
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import lzma
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import click

REPEATS = 3


def mavdem(path: str) -> int:
    from mavdem.alignment import drive, signals
    from mavdem.ingest import read_log

    log = read_log(path)
    for vehicle in log.vehicles:
        for columns in vehicle.messages.values():
            len(columns["time"]) / max(columns["time"][-1] - columns["time"][0], 1e-9)
        signals.attitude(vehicle, "roll")
        drive.motors(vehicle)
        drive.demand(vehicle, "roll")
    return log.frames


def recv_match(path: str) -> int:
    from pymavlink import mavutil

    reader, count = mavutil.mavlogfile(path, robust_parsing=True), 0
    while reader.recv_match() is not None:
        count += 1
    return count


def fasttlogparser(path: str) -> int:
    from fasttlogparser import parseTLog

    messages, _ = parseTLog(path)
    return sum(len(next(iter(fields.values()))) for fields in messages.values())


def dfreader(path: str) -> int:
    from pymavlink.DFReader import DFReader_binary

    log, count = DFReader_binary(path), 0
    kinds = ["ATT", "ANG", "RATE", "IMU", "RCOU", "CTUN", "XKF1", "EV", "ARM", "PARM", "MSG"]
    while log.recv_match(type=kinds) is not None:
        count += 1
    return count


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


READERS: dict[str, dict[str, Callable[[str], int]]] = {
    ".tlog": {"pymavlink.mavutil": recv_match, "fasttlogparser": fasttlogparser},
    ".bin": {"pymavlink.DFReader": dfreader},
    ".ulg": {"pyulog": ulog},
    ".mcap": {"mcap.reader": mcap},
}
"""Of other libraries, by format and module."""

OURS = "mavdem.alignment"


def measured(module: str, path: Path) -> tuple[float, int, float]:
    """Seconds without the imports, messages, and the most memory, MB."""
    command = [sys.executable, __file__, "--one", module, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        most = 0.0
        while process.poll() is None:
            most = max(most, resident(process.pid))
            time.sleep(0.002)
        said = process.stdout.read().splitlines() if process.stdout else []
    seconds, count = said[-1].split() if said else ("nan", "0")
    return float(seconds), int(count), most


def resident(process: int) -> float:
    """Memory of a process beyond mapped files, MB; 0 where it has ended."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return 0.0
    lines = [line.split() for line in status.splitlines() if line.startswith(("RssAnon", "RssShmem"))]
    return sum(float(line[1]) for line in lines) / 1e3


def one(module: str, path: str) -> None:
    importlib.import_module(module)
    read = mavdem if module == OURS else READERS[Path(path).suffix.lower()][module]
    begin = time.perf_counter()
    count = read(path)
    print(f"\n{time.perf_counter() - begin} {count}")


@click.command(help=__doc__)
@click.argument("logs", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--one", "module", hidden=True)
def main(logs: tuple[Path, ...], module: str | None) -> None:
    if module is not None:
        return one(module, str(logs[0]))
    print("| file | MB | reader | s | MB/s | messages | messages/s | memory, MB | mavdem is faster by |")
    print("|---|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for path in logs:
            if path.suffix == ".xz":
                # The libraries read no archives, so all read the unpacked file.
                plain = Path(folder) / path.stem
                plain.write_bytes(lzma.decompress(path.read_bytes()))
                path = plain
            others = [name for name in READERS[path.suffix.lower()] if importlib.util.find_spec(name.partition(".")[0])]
            runs = [(name, measured(name, path)) for _ in range(REPEATS) for name in (OURS, *others)]
            fastest = {name: min(run for who, run in runs if who == name) for name in (OURS, *others)}
            size = path.stat().st_size / 1e6
            for name, (seconds, count, memory) in fastest.items():
                print(
                    f"| {path.name} | {size:.1f} | {name} | {seconds:.2f} | {size / seconds:.1f} | {count:,} "
                    f"| {count / seconds:,.0f} | {memory:.0f} | {seconds / fastest[OURS][0]:.1f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
