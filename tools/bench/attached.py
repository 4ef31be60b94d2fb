#!/usr/bin/env python
"""What `mavdem live` costs: from a datagram to the estimate of its sample, over UDP on this machine; prints a table.

A made-up hover whose attitude and motor outputs come at 100, 400 and 1000 Hz
each, sent at their own pace by a process of its own for half a minute, learnt from with default settings. Then so many
minutes (10) of 100 Hz as fast as they are taken, and what memory that took.

Usage: tools/bench/attached.py [MINUTES]
"""

from __future__ import annotations

import resource
import time
from itertools import islice

import click
from made_up_hover import hover, sender

from mavdem.attached import Attached
from mavdem.dem import Settings
from mavdem.ingest.link import Link
from mavdem.learning_process import LearningProcess
from mavdem.live import LiveStream, Setup

SECONDS = 30.0
PORT = 14598


class Nobody:
    """Is shown everything and looks at nothing."""

    def put(self, *_: object) -> None: ...

    def log(self, text: str) -> None: ...


def nobody(setup: Setup) -> Nobody:
    return Nobody()


def silence(_: object) -> None: ...


def over_udp(rate: float) -> str:
    link = Link(f"udpin:127.0.0.1:{PORT}")
    vehicle = sender(rate, SECONDS, PORT)
    with LearningProcess() as executor:
        attached = Attached(link, LiveStream(), Settings(), nobody, silence, silence, executor)
        vehicle.start()
        while attached.standing.vehicle is None:
            attached.step()
        used, began = time.process_time(), time.monotonic()
        while vehicle.is_alive():
            attached.step()
        share = (time.process_time() - used) / (time.monotonic() - began)
    link.close()
    status, standing = attached.stream.status(), attached.standing
    median, late = (1e3 * each for each in standing.latency)
    rows = sum(standing.samples)
    return f"| {rate:.0f} | {rows} | {status.lost} | {median:.2f} | {late:.2f} | {share:.0%} |"


class Recorded:
    """A link from which everything comes at once."""

    datagrams, speaks_first = True, False

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


@click.command(help=__doc__)
@click.argument("minutes", default=10.0, type=click.FloatRange(0, min_open=True))
def main(minutes: float) -> None:
    print("| Hz | rows | lost | median, ms | 99th percentile, ms | share of a core |")
    print("|---|---|---|---|---|---|")
    for rate in (100.0, 400.0, 1000.0):
        print(over_udp(rate), flush=True)
    print()
    print(for_long(minutes))


if __name__ == "__main__":
    main()
