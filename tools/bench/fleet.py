#!/usr/bin/env python
"""How a fleet grows: what one more log costs among thousands, and what a cluster earns; prints Markdown tables.

The index of thousands of logs is made of real ones: of each row that `mavdem track` has stored, jittered copies stand for
further flights of further vehicles. The generator is seeded, so that the same logs make the same index.

Usage: tools/bench/fleet.py growth LOG... [--plot FILE.svg]   # one more log, page, search and diff by number of logs
       tools/bench/fleet.py make FLEET LOG... [--logs N]      # only makes the index, to look at
       tools/bench/fleet.py cluster LOG...                    # logs a second by workers of a Dask cluster
"""

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import click

from mavdem.containers import group_by
from mavdem.fleet.row import FlightRow, FlightRows
from mavdem.fleet.sources import LogSource
from mavdem.fleet.store import Store, open_store
from mavdem.fleet.tracking import assess_rows
from mavdem.fleet.workers import PAGES, JobLimits, JobOutcome
from mavdem.machine import free_port
from mavdem.report.blocks import Table, markdown

FLIGHTS_OF_A_VEHICLE = 50
"""Logs of each vehicle of a generated fleet: two flights a week for half a year."""

DAYS_BETWEEN_FLIGHTS = 3.5
"""Days from one flight of a vehicle to its next."""

FIRST_DAY = datetime(2026, 1, 5, 9, tzinfo=UTC)
"""Date of each vehicle's first flight."""

JITTER = 0.03
"""Relative standard deviation of each figure of a generated flight about the real one."""

JITTERED_COLUMNS = (
    "duration",
    "voltage_mean",
    "collective",
    "tilt_sd",
    "vibration",
    "trim_share",
    "effect",
    "damping",
    "lag",
    "phase_margin",
    "gain_margin",
    "ms",
    "wind_torque_sd",
    "wind_speed",
    "wind_direction",
    "balance",
    "mean_inputs",
)
"""Columns whose figures differ from flight to flight."""

SEED = 71
"""Seed of the generator."""

FLEET_SIZES = 100, 1_000, 10_000
"""Numbers of logs that are measured."""


@click.group(help=__doc__)
def bench() -> None:
    """Benchmarks of a fleet."""


class GeneratedLog(NamedTuple):
    """A log that was never flown, with the rows that its reading would have given."""

    source: LogSource
    """Its path, under which no file lies."""
    outcome: JobOutcome
    """What its reading gave."""


def generated_logs(rows: FlightRows, count: int) -> Iterator[GeneratedLog]:
    """Yields logs of a fleet, each a jittered copy of a real one.

    Each vehicle copies one real log again and again, so that its flights differ by the jitter alone. Logs without a
    flight are as frequent as among the real ones.

    Args:
        rows: rows of real logs.
        count: number of logs.
    """
    chance = random.Random(SEED)
    real_logs = list(group_by(rows, lambda row: row.key or row.file).values())
    for number in range(count):
        vehicle, flight = divmod(number, FLIGHTS_OF_A_VEHICLE)
        real_rows = real_logs[vehicle % len(real_logs)]
        size = 1_000_000 + number
        key = f"{number:032x}-{size}"
        path = f"/flights/vehicle_{vehicle:03}/{flight:03}.bin"
        date = FIRST_DAY + timedelta(days=DAYS_BETWEEN_FLIGHTS * flight, minutes=vehicle)
        scale = {column: chance.gauss(1.0, JITTER) for column in JITTERED_COLUMNS}
        copies = tuple(
            _jittered(row, scale, chance, file=path, key=key, date=date, vehicle=f"{vehicle:03}")
            for row in real_rows
        )
        outcome = JobOutcome(path, "read", copies, key, {}, seconds=1.0, megabytes=200.0)
        yield GeneratedLog(LogSource(path, size, version="1"), outcome)


def _jittered(
    row: FlightRow, scale: dict[str, float], chance: random.Random, **columns: Any
) -> FlightRow:
    """Returns a copy of a row whose figures are scaled at random.

    Args:
        row: a row of a real log.
        scale: factor of each jittered column, which all rows of a log share.
        chance: the random numbers by which entries of lists differ beyond that.
        columns: further columns, such as those that name the log.
    """
    for name, factor in scale.items():
        value = getattr(row, name)
        if isinstance(value, tuple):
            columns[name] = [entry * factor * chance.gauss(1.0, JITTER) for entry in value]
        elif value is not None:
            columns[name] = value * factor
    if row.vehicle_basis is not None:
        # The name of the real vehicle stays part of the name, which is as long as those of real ones.
        columns["vehicle"] = f"{row.vehicle}{columns['vehicle']}"
    else:
        del columns["vehicle"]
    if row.page is not None:
        columns["page"] = f"{PAGES}/{columns['key']}.html"
    return replace(row, **columns)


def fill_store(store: Store, rows: FlightRows, count: int) -> None:
    """Fills a store with generated logs, judges their vehicles and writes its table.

    Args:
        store: an empty store.
        rows: rows of real logs.
        count: number of logs.
    """
    limits = JobLimits()
    with store.transaction():
        sources = []
        for log in generated_logs(rows, count):
            store.add(log.source, log.outcome, limits)
            sources.append(log.source)
        store.track(sources)
    store.publish(assess_rows)


def track(folder: Path, logs: Sequence[Path], *options: str) -> None:
    """Runs ``mavdem track`` on logs."""
    words = [sys.executable, "-m", "mavdem", "track", *map(str, logs), "--out", str(folder)]
    subprocess.run([*words, *options], check=True, capture_output=True)


if __name__ == "__main__":
    bench()
