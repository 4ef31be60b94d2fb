#!/usr/bin/env python
"""The cost of `mavdem live`: latency from a datagram to its estimate, and the share of a core.

Input is a simulated hover at 100, 400 and 1000 Hz, sent by another process over UDP on this machine for half a minute.
Settings are the default ones.

Usage: tools/bench/live_latency.py
"""

from __future__ import annotations

import math
import multiprocessing
import socket
import time
from collections.abc import Iterator

import click
import numpy as np
from pymavlink.dialects.v20 import all as dialect

from mavdem.cli.background import LearningProcess
from mavdem.dem import Settings
from mavdem.live import LiveStream
from mavdem.live.link import Link
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


def silence(_: object) -> None: ...


def over_udp(rate: float) -> str:
    link = Link(f"udpin:127.0.0.1:{PORT}")
    vehicle = multiprocessing.get_context("spawn").Process(target=send, args=(rate,))
    with LearningProcess() as executor:
        session = LiveSession(link, LiveStream(), Settings(), silence, silence, silence, executor)
        vehicle.start()
        while session.status.vehicle is None:
            session.step()
        used, began = time.process_time(), time.monotonic()
        while vehicle.is_alive():
            session.step()
        share = (time.process_time() - used) / (time.monotonic() - began)
    link.close()
    status, (median, late) = session.status, (1e3 * each for each in session.status.latency)
    rows = status.learned + status.shown
    return f"| {rate:.0f} | {rows} | {status.lost} | {median:.2f} | {late:.2f} | {share:.0%} |"


@click.command(help=__doc__)
def main() -> None:
    print("| Hz | rows | lost | median, ms | 99th percentile, ms | share of a core |")
    print("|---|---|---|---|---|---|")
    for rate in (100.0, 400.0, 1000.0):
        print(over_udp(rate), flush=True)


if __name__ == "__main__":
    main()
