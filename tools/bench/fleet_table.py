#!/usr/bin/env python
"""Time, memory and size of a fleet's table without its logs: what rows cost when there are many; prints a table.

Usage: tools/bench/fleet_table.py [--logs 20000] [--vehicles 200]
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from mavdem.fleet.compaction import compact
from mavdem.fleet.dataset import group_of, read_rows
from mavdem.fleet.journal import Journal
from mavdem.fleet.ledger import entry_of, read_ledger
from mavdem.fleet.reading.outcome import Limits, ReadOutcome
from mavdem.fleet.reading.sources import Source
from mavdem.fleet.row import FlightRow
from mavdem.fleet.second_pass import with_health

FOUR = (0.25, 0.5, 0.75, 1.0)


def rows_of(number: int, vehicles: int) -> tuple[FlightRow, ...]:
    """A log's two rows, with as many numbers as a log of tier b fills."""
    return tuple(
        FlightRow(
            file=f"/logs/{number}.bin",
            key=f"{number:032x}-1000",
            vehicle=f"vehicle {number % vehicles}",
            vehicle_basis="board",
            axis=axis,
            tier="b",
            duration=60.0 + number,
            motors=("motor 1", "motor 2", "motor 3", "motor 4"),
            trim=FOUR,
            trim_share=FOUR,
            trim_share_interval=FOUR,
            headroom=FOUR,
            warnings=("The motors come at 10 Hz, which is too slow for their lag.",),
        )
        for axis in ("roll", "pitch")
    )


@click.command(help=__doc__)
@click.option("--logs", "count", default=20_000)
@click.option("--vehicles", default=200)
def main(count: int, vehicles: int) -> None:
    limits = Limits()

    def timed(name: str, work: Callable[[], object]) -> None:
        began, busy = time.perf_counter(), time.process_time()
        work()
        took, busy = time.perf_counter() - began, time.process_time() - busy
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        each = f"{1e6 * took / count:8.0f} µs a log, {1e6 * busy / count:6.0f} of a processor"
        print(f"{name:30}  {took:7.1f} s {each}  {most:5.0f} MB", flush=True)

    with TemporaryDirectory() as folder:
        place = Path(folder)
        with Journal(place) as journal:

            def append() -> None:
                for number in range(count):
                    rows = rows_of(number, vehicles)
                    outcome = ReadOutcome("read", rows, rows[0].key, 1.0, 200.0)
                    source = Source(rows[0].file, 1000, str(number))
                    groups = [group_of(row.vehicle) for row in rows]
                    journal.append(entry_of(source, outcome, groups, limits), rows)

            timed("journal, each log on the disk", append)
            print(f"{journal.path.stat().st_size / count:.0f} bytes a log in the journal")
            timed("compaction", lambda: compact(place, journal, with_health, []))
        timed("reading the ledger", lambda: read_ledger(place))
        timed("reading the rows", lambda: read_rows(place))
        size = sum(path.stat().st_size for path in place.rglob("*.parquet"))
        print(f"{size / count:.0f} bytes a log in the data set and the ledger")


if __name__ == "__main__":
    main()
