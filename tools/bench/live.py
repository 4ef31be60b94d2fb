#!/usr/bin/env python
"""What the live path costs: CPU time of a datagram, and the time from its receipt to the row it completes.

``python tools/bench/live.py``: attitude and motor outputs of a made-up hover at 400 Hz each, first fed as fast as they
are taken, then sent over UDP on this machine at their own pace by a process of its own.
"""

from __future__ import annotations

import gc
import math
import multiprocessing
import socket
import sys
import time
from collections.abc import Iterator

import numpy as np
from pymavlink.dialects.v20 import all as dialect

from mavdem.ingest.link import Link
from mavdem.live import LiveStream

RATE = 400
SECONDS = 20
PORT = 14599


def hover() -> Iterator[tuple[float, bytes]]:
    """Datagrams with the second at which each is sent: in the air, armed, from the start."""
    vehicle = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    for tick in range(SECONDS * RATE):
        now = tick / RATE
        stamp = 10_000 + tick * 1000 // RATE, 10_000_000 + tick * 1_000_000 // RATE
        if tick % RATE == 0:
            yield now, vehicle.heartbeat_encode(2, 3, 128, 0, 4).pack(vehicle)
        roll, push = 0.1 * math.sin(3 * now), round(20 * math.sin(5 * now))
        yield now, vehicle.attitude_encode(stamp[0], roll, 0.01, 0.2, 0.3 * math.cos(3 * now), 0.0, 0.0).pack(vehicle)
        outputs = (1600 - push, 1600 + push, 1600 + push, 1600 - push, 0, 0, 0, 0)
        yield now, vehicle.servo_output_raw_encode(stamp[1] % 2**32, 0, *outputs).pack(vehicle)


def send(port: int) -> None:
    """The hover at its own pace."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        begin = time.monotonic()
        for at, datagram in list(hover()):
            time.sleep(max(begin + at - time.monotonic(), 0.0))
            sender.sendto(datagram, ("127.0.0.1", port))


def told(name: str, seconds: list[float]) -> None:
    values = np.array(seconds) * 1e3
    median, late = np.percentile(values, [50, 99])
    print(f"{name}: mean {values.mean():.3f} ms, median {median:.3f}, 99 % {late:.3f}, most {values.max():.3f}")


def main() -> int:
    datagrams = list(hover())
    gc.freeze()
    stream, costs, rows = LiveStream(), [], 0
    for at, datagram in datagrams:
        begin = time.thread_time()
        rows += len(stream.feed(at, datagram))
        costs.append(time.thread_time() - begin)
    told("CPU time of a datagram", costs)
    print(
        f"fed as fast as they are taken: {len(datagrams) / sum(costs):.0f} datagrams/s, {rows / sum(costs):.0f} rows/s"
    )

    link, stream, waits = Link(f"udpin:127.0.0.1:{PORT}"), LiveStream(), []
    sender = multiprocessing.get_context("spawn").Process(target=send, args=(PORT,))
    sender.start()
    received, last = 0, time.monotonic()
    begin = time.thread_time()
    while received == 0 or time.monotonic() < last + 1.0:
        for stamp, datagram in link.receive(0.2):
            received, last = received + 1, time.monotonic()
            waits += [time.time() - stamp for _ in stream.feed(stamp, datagram)]
    spent = time.thread_time() - begin
    sender.join()
    link.close()
    told("from receipt to row", waits)
    print(f"{received} of {len(datagrams)} datagrams received, {spent / SECONDS:.1%} of a core")
    return 0


if __name__ == "__main__":
    sys.exit(main())
