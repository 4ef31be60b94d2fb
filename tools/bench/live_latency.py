#!/usr/bin/env python
"""The cost of `mavdem live`: latency from a datagram's arrival, as the kernel stamps it, to its estimate, and CPU time.

A simulated hover is sent by another process over UDP for half a minute; dashboard and raw stream are recorded.

Usage: tools/bench/live_latency.py [--busy]
"""

from __future__ import annotations

import math
import multiprocessing
import os
import socket
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import numpy as np
from pymavlink.dialects.v20 import all as dialect

from mavdem.cli.live import Dashboard, _run
from mavdem.dem import Settings
from mavdem.dem.parallel import LearningProcess
from mavdem.live import LiveStream
from mavdem.live.link import Link
from mavdem.live.recording import RawRecording
from mavdem.live.session import LiveSession

SECONDS = 30.0
PORT = 14598


def hover(rate: float) -> Iterator[tuple[float, bytes]]:
    """Datagrams with the second at which each is sent: attitude and motor outputs at ``rate`` Hz each, in the air."""
    vehicle, rng = dialect.MAVLink(None, srcSystem=1, srcComponent=1), np.random.default_rng(0)
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
        yield now, vehicle.attitude_encode(round(stamp), roll, 0.01, 0.2, speed, 0.0, 0.0).pack(vehicle)
        outputs = (1600 - push, 1600 + push, 1600 + push, 1600 - push, 0, 0, 0, 0)
        yield now, vehicle.servo_output_raw_encode(round(stamp * 1e3) % 2**32, 0, *outputs).pack(vehicle)


def send(rate: float) -> None:
    """Sends the hover to this machine at its own pace."""
    datagrams = list(hover(rate))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as outlet:
        begin = time.monotonic()
        for at, datagram in datagrams:
            time.sleep(max(begin + at - time.monotonic(), 0.0))
            outlet.sendto(datagram, ("127.0.0.1", PORT))


def over_udp(rate: float, folder: Path) -> str:
    link, path = Link(f"udpin:127.0.0.1:{PORT}"), folder / f"{rate:.0f}.rrd"
    vehicle = multiprocessing.get_context("spawn").Process(target=send, args=(rate,))
    with closing(Dashboard("a hover", "roll", path, False, None)) as dashboard, LearningProcess() as executor:
        shown = dashboard.open, dashboard.report, list[str]().append
        session = LiveSession(link, LiveStream(), Settings(), *shown, executor, RawRecording(path.with_suffix(".tlog")))
        vehicle.start()
        while session.status.vehicle is None:
            session.step()
        used, main, began = time.process_time(), time.thread_time(), time.monotonic()
        _run(session, lambda: not vehicle.is_alive(), None)
        spent, used, main = time.monotonic() - began, time.process_time() - used, time.thread_time() - main
    link.close()
    now, shares = session.status, (f"{main / spent:.0%}", f"{used / spent:.0%}")
    row = [f"{rate:.0f}", now.learned + now.shown, now.lost, *(f"{1e3 * each:.1f}" for each in now.latency), *shares]
    return f"| {' | '.join(map(str, row))} |"


@click.command(help=__doc__)
@click.option("--busy", is_flag=True, help="Beside a busy loop on every core.")
def main(busy: bool) -> None:
    for _ in range(busy * (os.cpu_count() or 1)):
        multiprocessing.Process(target=exec, args=("while True: pass",), daemon=True).start()
    print("| Hz | rows | lost | median, ms | 99th percentile, ms | longest, ms | main thread | process, of a core |")
    print("|---|---|---|---|---|---|---|---|")
    with TemporaryDirectory() as folder:
        for rate in (50.0, 100.0, 200.0, 400.0):
            print(over_udp(rate, Path(folder)), flush=True)


if __name__ == "__main__":
    main()
