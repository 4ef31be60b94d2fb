#!/usr/bin/env python
"""What the live path costs: CPU time of a datagram, and the time from its receipt to the row it completes.

Attitude and motor outputs of a made-up hover at 400 Hz each, first fed as fast as they are taken, then sent over UDP on
this machine at their own pace by a process of its own.

Usage: tools/bench/live.py
"""

from __future__ import annotations

import gc
import time

import click
import numpy as np
from made_up_hover import hover, sender

from mavdem.ingest.link import Link
from mavdem.live import LiveStream

RATE = 400
SECONDS = 20
PORT = 14599


def told(name: str, seconds: list[float]) -> None:
    values = np.array(seconds) * 1e3
    median, late = np.percentile(values, [50, 99])
    print(f"{name}: mean {values.mean():.3f} ms, median {median:.3f}, 99 % {late:.3f}, most {values.max():.3f}")


@click.command(help=__doc__)
def main() -> None:
    datagrams = list(hover(RATE, SECONDS))
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
    vehicle = sender(RATE, SECONDS, PORT)
    vehicle.start()
    received, last = 0, time.monotonic()
    begin = time.thread_time()
    while received == 0 or time.monotonic() < last + 1.0:
        for stamp, datagram in link.receive(0.2):
            received, last = received + 1, time.monotonic()
            waits += [time.time() - stamp for _ in stream.feed(stamp, datagram)]
    spent = time.thread_time() - begin
    vehicle.join()
    link.close()
    told("from receipt to row", waits)
    print(f"{received} of {len(datagrams)} datagrams received, {spent / SECONDS:.1%} of a core")


if __name__ == "__main__":
    main()
