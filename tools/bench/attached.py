#!/usr/bin/env python
"""What `mavdem live` costs: from a datagram to the estimate of its sample, over UDP on this machine; prints a table.

``tools/bench/attached.py [MINUTES]``: a made-up hover whose attitude and motor outputs come at 100, 400 and 1000 Hz
each, sent at their own pace by a process of its own for half a minute, learnt from with default settings. Then so many
minutes (10) of 100 Hz as fast as they are taken, and what memory that took.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import resource
import socket
import sys
import time
from collections.abc import Iterator
from itertools import islice

import numpy as np
from pymavlink.dialects.v20 import all as dialect

from mavdem.attached import Attached
from mavdem.dem import Settings
from mavdem.dem.workers import pool
from mavdem.ingest.link import Link
from mavdem.live import LiveStream, Setup

SECONDS = 30.0
PORT = 14598


def hover(rate: float, seconds: float) -> Iterator[tuple[float, bytes]]:
    """Datagrams with the second at which each is sent: in the air, armed, from the start."""
    vehicle, rng = dialect.MAVLink(None, srcSystem=1, srcComponent=1), np.random.default_rng(0)
    roll = speed = wind = 0.0
    for tick in range(round(seconds * rate)):
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
    """The hover at its own pace."""
    datagrams = list(hover(rate, SECONDS))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        begin = time.monotonic()
        for at, datagram in datagrams:
            time.sleep(max(begin + at - time.monotonic(), 0.0))
            sender.sendto(datagram, ("127.0.0.1", PORT))


class Nobody:
    """Is shown everything and looks at nothing."""

    def put(self, *_: object) -> None: ...

    def log(self, text: str) -> None: ...


def nobody(setup: Setup) -> Nobody:
    return Nobody()


def silence(_: object) -> None: ...


def over_udp(rate: float) -> str:
    link = Link(f"udpin:127.0.0.1:{PORT}")
    sender = multiprocessing.get_context("spawn").Process(target=send, args=(rate,))
    with pool(1) as executor:
        executor.submit(os.nice, 10)  # as mavdem live has it
        attached = Attached(link, LiveStream(), Settings(), nobody, silence, silence, executor)
        sender.start()
        while attached.standing.vehicle is None:
            attached.step()
        used, began = time.process_time(), time.monotonic()
        while sender.is_alive():
            attached.step()
        share = (time.process_time() - used) / (time.monotonic() - began)
    link.close()
    status, standing = attached.stream.status(), attached.standing
    median, late = (1e3 * each for each in standing.latency)
    rows = sum(standing.samples)
    return f"| {rate:.0f} | {rows} | {status.lost} | {median:.2f} | {late:.2f} | {share:.0%} |"


class Recorded:
    """A link from which everything comes at once."""

    datagrams = True

    def __init__(self, minutes: float) -> None:
        self._datagrams = hover(100.0, 60 * minutes)
        self.done = False

    def receive(self, timeout: float) -> list[tuple[float, bytes]]:
        batch = [(1e9 + at, datagram) for at, datagram in islice(self._datagrams, 20)]
        self.done = not batch
        return batch


def for_long(minutes: float) -> str:
    link = Recorded(minutes)
    attached = Attached(link, LiveStream(), Settings(), nobody, silence, silence)  # type: ignore[arg-type]
    marks, began = [], time.monotonic()
    while not link.done:
        attached.step(0.0)
        if sum(attached.standing.samples) >= (len(marks) + 1) * 1500 * minutes:
            marks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    speed = 60 * minutes / (time.monotonic() - began)
    told = ", ".join(f"{mark:.0f}" for mark in marks)
    return f"{minutes:g} minutes at 100 Hz, {speed:.0f} times as fast: most memory by quarters {told} MB"


def main(words: list[str]) -> None:
    if words and not words[0].replace(".", "").isdigit():
        sys.exit(__doc__)
    print("| Hz | rows | lost | median, ms | 99th percentile, ms | share of a core |")
    print("|---|---|---|---|---|---|")
    for rate in (100.0, 400.0, 1000.0):
        print(over_udp(rate), flush=True)
    print()
    print(for_long(float(words[0]) if words else 10.0))


if __name__ == "__main__":
    main(sys.argv[1:])
