#!/usr/bin/env python
"""Speed of writing columns over time as an MCAP file, compared with the package mcap; prints a table.

Usage: tools/bench/channels.py
"""

import io
import json
import time
from collections.abc import Callable
from functools import partial
from timeit import repeat

import click
import numpy as np
from mcap.writer import Writer

from mavdem.ingest.mcap.series import Series, write_series
from mavdem.report.blocks import Table, markdown

ROWS = 6500
"""Messages of each channel: 65 s at 100 Hz."""

COLUMN_COUNTS = (2, 4, 2, 4, 1, 5, 1, 1, 2, 2)
"""Columns of each channel, as in a learned flight."""


def random_series() -> dict[str, Series]:
    """Returns ten channels of random numbers."""
    random = np.random.default_rng(1)
    series: dict[str, Series] = {}
    for number, count in enumerate(COLUMN_COUNTS):
        columns = {f"column_{column}": random.standard_normal(ROWS) for column in range(count)}
        series[f"channel/{number}"] = (np.linspace(1.0, 66.0, ROWS), columns)
    return series


def write_by_message(series: dict[str, Series]) -> None:
    """Writes the same channels with the package mcap: each row becomes JSON and is given to the writer.

    Args:
        series: times, s, and columns of each channel, by its topic.
    """
    writer = Writer(io.BytesIO())
    writer.start()
    messages = []
    for topic, (times, columns) in series.items():
        schema = writer.register_schema(topic, "jsonschema", b"{}")
        channel = writer.register_channel(topic, "json", schema)
        for seconds, *samples in zip(times.tolist(), *columns.values(), strict=True):
            values_by_field = dict(zip(columns, map(float, samples), strict=True))
            messages.append((round(1e9 * seconds), channel, json.dumps(values_by_field).encode()))
    for nanoseconds, channel, data in sorted(messages):
        writer.add_message(channel, nanoseconds, data, nanoseconds)
    writer.finish()  # type: ignore[no-untyped-call]


def write_by_columns(series: dict[str, Series]) -> None:
    """Writes the channels with mavdem, which formats a column of numbers at once.

    Args:
        series: times, s, and columns of each channel, by its topic.
    """
    write_series(io.BytesIO(), series)


def fastest(write: Callable[[], None]) -> float:
    """Returns the processor time of the fastest of three runs, s."""
    return min(repeat(write, number=1, repeat=3, timer=time.process_time))


@click.command()
def bench() -> None:
    """Writes 65,000 messages as an MCAP file with mavdem and with the package mcap, and prints the processor times."""
    series = random_series()
    seconds_by_columns = fastest(partial(write_by_columns, series))
    seconds_by_message = fastest(partial(write_by_message, series))
    rows = [
        ["the package mcap, message by message", f"{seconds_by_message:.2f} s"],
        ["mavdem, by columns", f"{seconds_by_columns:.2f} s"],
        ["ratio", f"{seconds_by_message / seconds_by_columns:.1f}"],
    ]
    count = ROWS * len(COLUMN_COUNTS)
    click.echo(markdown([Table([f"{count:,} messages", "processor time"], rows)]))


if __name__ == "__main__":
    bench()
