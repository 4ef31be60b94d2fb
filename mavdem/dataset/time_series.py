"""Time series of one quantity, made from the columns of a message in a vehicle's Telemetry."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from mavdem.arrays import Array, Flags, Integers
from mavdem.containers import Names
from mavdem.ingest.motors import MotorGeometry as MotorGeometry
from mavdem.ingest.motors import position_name as position_name
from mavdem.ingest.telemetry import MIN_PREFERRED_SHARE, Columns, Telemetry

pass


@dataclass(frozen=True, eq=False)
class TimeSeries:
    """One quantity: ``values`` (N,) or (N, k) at ``time`` (N,) s of ``boot`` (N,), of ``sent`` messages.

    ``left_out`` counts those not used: not finite, or with the stamp of another. Exact copies do not count.
    """

    time: Array
    boot: Integers
    values: Array
    sent_count: int = 0
    unused_count: int = 0

    def select(self, rows: Flags) -> TimeSeries:
        """Returns the samples of these ``rows`` (N,)."""
        return TimeSeries(self.time[rows], self.boot[rows], self.values[rows])


def float_column(columns: Columns, field: str) -> Array:
    """Returns a field of a message as floats; what is no number becomes NaN."""
    with np.errstate(invalid="ignore"):
        return np.asarray(columns[field], dtype=float)


def float_columns(columns: Columns, fields: Iterable[str]) -> Array:
    """Returns fields of a message (N, k) as :func:`floats`."""
    return np.column_stack([float_column(columns, field) for field in fields])


def clean_series(columns: Columns, values: Array, rows: Flags | None = None) -> TimeSeries:
    """Returns ``values`` (N,) or (N, k) of all messages, or ``rows`` (N,), in time order, each stamp once, finite."""
    time, boot = columns["time"], columns["boot"]
    table = np.atleast_2d(values.T).T
    chosen = np.ones(len(time), dtype=bool) if rows is None else rows
    order = np.flatnonzero(chosen & np.isfinite(table).all(axis=1) & np.isfinite(time))
    finite = len(order)
    order = order[np.lexsort((time[order], boot[order]))]
    again = np.flatnonzero((np.diff(time[order]) <= 0) & (np.diff(boot[order]) <= 0))
    others = int(np.count_nonzero((table[order[again]] != table[order[again + 1]]).any(axis=1)))
    order = np.delete(order, again + 1)
    sent = int(np.count_nonzero(chosen))
    return TimeSeries(time[order], boot[order], values[order], sent, sent - finite + others)


def recorded_series(telemetry: Telemetry, message: str, *fields: str) -> TimeSeries | None:
    """Returns a field of a message (N,), or several (N, k), as :func:`series` does; None where none was finite."""
    columns = telemetry.messages.get(message, {})
    if not all(field in columns for field in fields):
        return None
    table = float_columns(columns, fields)
    signal = clean_series(columns, table if len(fields) > 1 else table[:, 0])
    return signal if len(signal.time) else None


def message_counts(telemetry: Telemetry, names: Names) -> dict[str, int]:
    """Returns how many of each message there are, of those that there are."""
    return {
        name: len(telemetry.messages[name]["time"]) for name in names if name in telemetry.messages
    }


def preferred_message(counts: Mapping[str, int]) -> str | None:
    """Returns the first of ``counts``, the preferred first, that came about as often as the most frequent."""
    return next(iter(names_by_preference(counts)), None)


def names_by_preference(counts: Mapping[str, int]) -> list[str]:
    """Returns the names of ``counts``, the preferred first; behind them those that came clearly less often."""
    enough = MIN_PREFERRED_SHARE * max(counts.values(), default=0)
    return sorted(filter(counts.get, counts), key=lambda name: counts[name] < enough)
