#!/usr/bin/env python
"""Time of reading a log, beside its format's plain library, in one run; prints a table.

Ours ends with attitude, motor outputs and roll demand as columns. The libraries: pymavlink's DFReader asked for the
same kinds of message, pyulog for all topics, mcap for all messages in the order of the file, and Python's json where
they are JSON.

Usage: tools/bench/read_logs.py FILE.bin|FILE.ulg|FILE.mcap ...
"""

from __future__ import annotations

import json
import lzma
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import click
from mcap.reader import make_reader
from pymavlink.DFReader import DFReader_binary
from pyulog import ULog

from mavdem.ingest import meaning, read_log

REPEATS = 3


def ours(path: Path) -> None:
    for vehicle in read_log(path).vehicles:
        meaning.attitude(vehicle, "roll")
        meaning.motors(vehicle)
        meaning.demand(vehicle, "roll")


def dfreader(path: Path) -> None:
    log = DFReader_binary(str(path))
    kinds = ["ATT", "ANG", "RATE", "RCOU", "CTUN", "XKF1", "EV", "ARM", "PARM", "MSG"]
    while log.recv_match(type=kinds) is not None:
        pass


def pyulog(path: Path) -> None:
    ULog(str(path))


def mcap(path: Path) -> None:
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            if channel.message_encoding == "json":
                json.loads(message.data)


PLAIN: dict[str, tuple[str, Callable[[Path], None]]] = {
    ".bin": ("pymavlink's DFReader", dfreader),
    ".ulg": ("pyulog", pyulog),
    ".mcap": ("mcap and json", mcap),
}


def seconds(read: Callable[[Path], None], path: Path) -> float:
    times = []
    for _ in range(REPEATS):
        began = perf_counter()
        read(path)
        times.append(perf_counter() - began)
    return min(times)


@click.command(help=__doc__)
@click.argument("files", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False, path_type=Path))
def main(files: tuple[Path, ...]) -> None:
    print("| file | MB | ours, s | library | its, s | times as fast |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for path in files:
            plain = path
            if path.suffix == ".xz":
                # The library takes no archives; so that both read the same, neither gets one.
                plain = Path(folder) / path.stem
                plain.write_bytes(lzma.decompress(path.read_bytes()))
            library, read = PLAIN[plain.suffix.lower()]
            mine, its = seconds(ours, plain), seconds(read, plain)
            size = plain.stat().st_size / 1e6
            print(f"| {plain.name} | {size:.1f} | {mine:.2f} | {library} | {its:.2f} | {its / mine:.1f} |", flush=True)


if __name__ == "__main__":
    main()
