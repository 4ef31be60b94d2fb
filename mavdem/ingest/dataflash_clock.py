"""The messages of a DataFlash log on the boot clock.

All carry the same one: TimeUS, microseconds since boot, or TimeMS before ArduPilot 3.3. A log may hold several boots,
appended; stamps in a garbled message lie anywhere.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mavdem.ingest.clocks import Sent, boot_clock
from mavdem.ingest.dataflash_definition import Table
from mavdem.telemetry import Columns

CLOCKS = {"TimeUS": 1e6, "TimeMS": 1e3}
"""Stamps and their units in a second."""
LATEST = 2.0**63 / 1e6
"""Seconds that no stamp gets past: as a float, or in text, it may be anything."""


def on_boot_clock(tables: Mapping[str, Table]) -> tuple[dict[str, Columns], tuple[str, ...]]:
    """The tables with ``time`` (s) and ``boot`` beside their columns, and a sentence for each thing mended.

    Tables without stamps are left out, and so are messages whose stamp cannot be.
    """
    clocks = {name: field for name, table in tables.items() for field in CLOCKS if field in table.columns}
    if not clocks:
        return {}, ()
    seconds = {
        name: np.asarray(tables[name].columns[field], dtype=np.float64) / CLOCKS[field]
        for name, field in clocks.items()
    }
    impossible = {name: ~((stamps >= 0) & (stamps <= LATEST)) for name, stamps in seconds.items()}
    for name in clocks:
        seconds[name][impossible[name]] = 0.0  # which says that there is none
    place = np.concatenate([tables[name].place for name in clocks])
    order = np.argsort(place, kind="stable")
    stamps = np.concatenate([seconds[name] for name in clocks])[order]
    sent = Sent("the messages", np.arange(len(order)), stamps.copy)
    clock = boot_clock([sent], received=lambda places: np.full(len(places), np.nan))
    on_clock = clock.placed[sent.message]
    row = np.empty(len(order), dtype=np.int64)
    row[order] = np.arange(len(order))
    placed: dict[str, Columns] = {}
    first = 0
    for name in clocks:
        rows = row[first : first + len(seconds[name])]
        first += len(rows)
        time, boot = on_clock.time[rows], on_clock.boot[rows].astype(np.int64)
        # A stamp that was ignored took the place of the one before it: its message cannot be trusted either.
        kept = time == seconds[name]
        columns = {field: values[kept] for field, values in tables[name].columns.items()}
        placed[name] = {**columns, "time": time[kept], "boot": boot[kept]}
    lost = sum(int(np.count_nonzero(rows)) for rows in impossible.values())
    left_out = (f"{lost} messages with a time stamp that cannot be were left out.",) if lost else ()
    return placed, (*left_out, *clock.repairs)
