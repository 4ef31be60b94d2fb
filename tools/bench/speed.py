#!/usr/bin/env python
"""How fast logs are read, a fleet's rows and live estimates made; prints Markdown tables.

Usage: tools/bench/speed.py read FILE.tlog|FILE.bin|FILE.ulg|FILE.mcap ...
       tools/bench/speed.py fleet LOG ...
       tools/bench/speed.py live [--busy]
"""

from __future__ import annotations

import importlib.util
import json
import math
import multiprocessing
import os
import resource
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from statistics import mean, median
from tempfile import TemporaryDirectory
from timeit import repeat

import click
import numpy as np
from pymavlink.dialects.v20 import all as dialect
from threadpoolctl import threadpool_limits

from mavdem.alignment import drive, signals
from mavdem.cli.live import Dashboard
from mavdem.dem import Settings
from mavdem.dem.parallel import LearningProcess, stay_in_this_process
from mavdem.errors import Unreadable
from mavdem.fleet.row import best_tier
from mavdem.fleet.rows_of_log import rows_of_log
from mavdem.ingest import read_log
from mavdem.live import LiveStream
from mavdem.live.link import Link
from mavdem.live.raw_recording import RawRecording
from mavdem.live.running import run
from mavdem.live.session import LiveSession
from mavdem.report.flight_page import flight_page


def ours(path: str) -> int:
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


def read(logs: tuple[Path, ...]) -> None:
    """How fast a log is read, beside the usual libraries of its format: the fastest of three runs.

    Ours decodes attitude, motor outputs and the roll demand of each vehicle, and has the rate of every message. The
    libraries: pymavlink's recv_match, message by message; fasttlogparser with all columns; pymavlink's DFReader with
    the same message types as ours; pyulog with all topics; mcap with all messages in file order, and Python's json
    where they are JSON. One that is not installed is left out.
    """
    print("| file | MB | reader | s | MB/s | messages | messages/s | mavdem is faster by |")
    print("|---|---|---|---|---|---|---|---|")
    for path in logs:
        size = path.stat().st_size / 1e6
        fastest = 0.0
        for name, reader in READERS[path.suffix.lower()].items():
            if importlib.util.find_spec(name) is None:
                continue
            count = reader(str(path))
            seconds = min(repeat(partial(reader, str(path)), number=1, repeat=3))
            fastest = fastest or seconds
            print(
                f"| {path.name} | {size:.1f} | {name} | {seconds:.2f} | {size / seconds:.1f} | {count:,} "
                f"| {count / seconds:,.0f} | {seconds / fastest:.1f} |",
                flush=True,
            )


def fleet(logs: tuple[Path, ...]) -> None:
    """What logs cost a fleet: CPU seconds for the rows and the page of each, by format and tier, on one core."""
    stay_in_this_process()
    threadpool_limits(limits=1, user_api="blas")
    kinds = dict[str, list[float]]()
    every = list[float]()
    rows_of_log(logs[0], "", flight_page)  # which loads the libraries
    for path in logs:
        began = time.process_time()
        tier = ""
        with suppress(Unreadable):
            tier = best_tier(rows_of_log(path, path.name, flight_page)[0])
        every.append(time.process_time() - began)
        kinds.setdefault(
            f"{path.suffix.lower()}, {f'tier {tier}' if tier else 'no flight'}", []
        ).append(every[-1])
    print("| logs | number | CPU s each: mean | median | longest |\n|---|---|---|---|---|")
    for kind, spent in [*sorted(kinds.items()), ("all", every)]:
        print(
            f"| {kind} | {len(spent)} | {mean(spent):.2f} | {median(spent):.2f} | {max(spent):.2f} |"
        )
    print(f"\nAt most {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB.")


SECONDS = 30.0
PORT = 14598


def hover(rate: float) -> Iterator[tuple[float, bytes]]:
    """Datagrams with the second at which each is sent: attitude and motor outputs at ``rate`` Hz each, in the air."""
    vehicle = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    rng = np.random.default_rng(0)
    roll = speed = wind = 0.0
    for tick in range(round(SECONDS * rate)):
        now = tick / rate
        if tick % round(rate) == 0:
            yield now, vehicle.heartbeat_encode(2, 3, 128, 0, 4).pack(vehicle)
        push = round(20 * math.sin(5 * now) + 10 * math.sin(11.3 * now))
        wind += (-wind / 0.2) / rate + 2.0 * math.sqrt(2 / 0.2 / rate) * rng.standard_normal()
        speed += (0.3 * push + wind - 4.0 * speed - 9.0 * roll) / rate
        roll += speed / rate
        stamp = 10_000 + now * 1e3
        yield (
            now,
            vehicle.attitude_encode(round(stamp), roll, 0.01, 0.2, speed, 0.0, 0.0).pack(vehicle),
        )
        outputs = (1600 - push, 1600 + push, 1600 + push, 1600 - push, 0, 0, 0, 0)
        yield (
            now,
            vehicle.servo_output_raw_encode(round(stamp * 1e3) % 2**32, 0, *outputs).pack(vehicle),
        )


def send(rate: float) -> None:
    """Sends the hover to this machine at its own pace."""
    datagrams = list(hover(rate))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as outlet:
        begin = time.monotonic()
        for at, datagram in datagrams:
            time.sleep(max(begin + at - time.monotonic(), 0.0))
            outlet.sendto(datagram, ("127.0.0.1", PORT))


def over_udp(rate: float, folder: Path) -> str:
    link = Link(f"udpin:127.0.0.1:{PORT}")
    path = folder / f"{rate:.0f}.rrd"
    vehicle = multiprocessing.get_context("spawn").Process(target=send, args=(rate,))
    with (
        closing(Dashboard("a hover", "roll", path, False, None)) as dashboard,
        LearningProcess() as executor,
    ):
        shown = dashboard.open, dashboard.report, list[object]().append
        session = LiveSession(
            link,
            LiveStream(),
            Settings(),
            *shown,
            executor,
            RawRecording(path.with_suffix(".tlog")),
        )
        vehicle.start()
        while session.status.vehicle is None:
            session.step()
        used = time.process_time()
        main = time.thread_time()
        began = time.monotonic()
        run(session, lambda: not vehicle.is_alive(), None, 5.0, lambda *_: "")
        spent = time.monotonic() - began
        used = time.process_time() - used
        main = time.thread_time() - main
    link.close()
    now = session.status
    shares = (f"{main / spent:.0%}", f"{used / spent:.0%}")
    row = [
        f"{rate:.0f}",
        now.learned + now.shown,
        now.lost,
        *(f"{1e3 * each:.1f}" for each in now.latency),
        *shares,
    ]
    return f"| {' | '.join(map(str, row))} |"


def live(busy: bool) -> None:
    """The cost of `mavdem live`: latency from a datagram's arrival to its estimate, and CPU time.

    Arrival is as the kernel stamps it. A simulated hover is sent by another process over UDP for half a minute;
    dashboard and raw stream are recorded.
    """
    for _ in range(busy * (os.cpu_count() or 1)):
        multiprocessing.Process(target=exec, args=("while True: pass",), daemon=True).start()
    print(
        "| Hz | rows | lost | median, ms | 99th percentile, ms | longest, ms | main thread | process, of a core |"
    )
    print("|---|---|---|---|---|---|---|---|")
    with TemporaryDirectory() as folder:
        for rate in (50.0, 100.0, 200.0, 400.0):
            print(over_udp(rate, Path(folder)), flush=True)


@click.command(help=__doc__)
@click.argument("what", type=click.Choice(["read", "fleet", "live"]))
@click.argument("logs", nargs=-1, type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--busy", is_flag=True, help="Beside a busy loop on every core.")
def main(what: str, logs: tuple[Path, ...], busy: bool) -> None:
    {"read": partial(read, logs), "fleet": partial(fleet, logs), "live": partial(live, busy)}[
        what
    ]()


if __name__ == "__main__":
    main()
