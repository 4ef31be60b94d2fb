"""Time series of one quantity from the fields of recorded messages: sorted, finite, without repeated stamps."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from mavdem.arrays import Array, Flags, Integers
from mavdem.containers import Names
from mavdem.dataset.intervals import TimeInterval
from mavdem.ingest.telemetry import MIN_PREFERRED_SHARE, Columns, Telemetry

AVERAGING_SECONDS = 2.0
"""Seconds over which vertical speed and collective are averaged, so that a gust does not end a climb; a choice."""


@dataclass(frozen=True, eq=False)
class TimeSeries:
    """N samples of one quantity, sorted by boot and time; within a boot the stamps rise strictly."""

    time: Array
    """(N,) seconds on the clock of the sample's boot."""
    boot: Integers
    """(N,) number of the boot in which each sample was taken, from 0."""
    values: Array
    """(N,) or (N, k) samples."""
    sent_count: int = 0
    """Number of messages that the samples were taken from."""
    unused_count: int = 0
    """Number of those messages without a sample here: not finite, or a second value at the same stamp.

    Exact copies of a message do not count.
    """

    def select(self, rows: Flags | slice) -> TimeSeries:
        """Returns the samples of those rows for which ``rows`` (N,) is true; without the counts of messages."""
        return TimeSeries(self.time[rows], self.boot[rows], self.values[rows])

    def of_boot(self, boot: int) -> TimeSeries:
        """Returns the samples of one boot, which take no memory; without the counts of messages."""
        return self.select(rows_of_boot(self.boot, boot))

    def within(self, interval: TimeInterval) -> TimeSeries:
        """Returns the samples in an interval, as a view that takes no memory; the series must be of one boot.

        Args:
            interval: Start and end, s since boot; samples at either belong to it.

        Returns:
            The part of the series; empty if no sample lies in the interval.
        """
        start, end = interval
        return self.select(slice(bisect_left(self.time, start), bisect_right(self.time, end)))

    def value_at(self, time: float) -> float:
        """Interpolates the values linearly at one time; the series must be of one boot.

        Args:
            time: the time, s since boot.

        Returns:
            The value, in the unit of the series. Before the first sample it is the first value, after the last one the
            last value.
        """
        # ``np.interp`` would copy the whole series, since it cannot be written to. So it gets only the sample before
        # the time and the one at or after it.
        row_after = bisect_left(self.time, time)
        around = slice(max(row_after - 1, 0), row_after + 1)
        return float(np.interp(time, self.time[around], self.values[around]))


def rows_of_boot(boots: Integers, boot: int) -> slice:
    """Returns the slice of a series that belongs to one boot of the autopilot.

    Args:
        boots: (N,) number of the boot of each sample, ascending.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The slice; an empty one if the boot has no samples.
    """
    # Bisection, since a log may have hundreds of boots, and a comparison with every sample for each would be slow.
    return slice(bisect_left(boots, boot), bisect_right(boots, boot))


def float_column(columns: Columns, field: str) -> Array:
    """Converts a field of a message to floating-point numbers.

    Args:
        columns: Fields of one message type, N rows each.
        field: Name of a field; (N,) numbers or, of an array field, (N, k).

    Returns:
        (N,) numbers; NaN in place of values that are not numbers.

    Raises:
        KeyError: The message has no such field.
    """
    with np.errstate(invalid="ignore"):
        return np.asarray(columns[field], dtype=float)


def float_columns(columns: Columns, fields: Iterable[str]) -> Array:
    """Converts several scalar fields of a message to one array of floating-point numbers.

    Args:
        columns: Fields of one message type, N rows each.
        fields: Names of k fields, at least one.

    Returns:
        (N, k) numbers, a column for each field, as by :func:`float_column`.

    Raises:
        KeyError: The message lacks one of the fields.
    """
    names = tuple(fields)
    table = np.empty((len(columns[names[0]]), len(names)))
    # Filled field by field, which needs only half the memory of ``column_stack`` for hours of flight.
    for number, name in enumerate(names):
        table[:, number] = float_column(columns, name)
    return table


def clean_series(columns: Columns, values: Array, rows: Flags | None = None) -> TimeSeries:
    """Makes a time series of values that were computed from a message: sorted, finite, each stamp once.

    Links repeat and reorder messages. Of several rows with the same stamp the first is kept. If all rows are used, in
    their order, the series shares the arrays that were given, since a copy of hours of flight takes much memory.

    Args:
        columns: Fields of the message, of which ``time`` and ``boot`` (N,) are used.
        values: (N,) or (N, k) values of all its rows.
        rows: (N,) which rows belong to the series; all by default.

    Returns:
        The series, with the number of selected rows (``sent_count``), and of those that could not be used
        (``unused_count``): not finite, or with another value than an earlier row of the same stamp.
    """
    time = columns["time"]
    boot = columns["boot"]
    table = values[:, np.newaxis] if values.ndim == 1 else values
    is_selected = np.ones(len(time), dtype=bool) if rows is None else rows
    is_finite = np.isfinite(table).all(axis=1) & np.isfinite(time)
    is_used = is_selected & is_finite
    sent_count = int(np.count_nonzero(is_selected))
    if is_used.all() and _rises_strictly(time, boot):
        return TimeSeries(time, boot, np.ascontiguousarray(values), sent_count)
    used_rows = np.flatnonzero(is_used)
    finite_count = len(used_rows)
    used_rows = used_rows[np.lexsort((time[used_rows], boot[used_rows]))]

    # After sorting, a row repeats the stamp of the row before it if neither time nor boot rises.
    repeats_stamp = (np.diff(time[used_rows]) <= 0) & (np.diff(boot[used_rows]) <= 0)
    first_of_pair = np.flatnonzero(repeats_stamp)
    second_of_pair = first_of_pair + 1
    first_values = table[used_rows[first_of_pair]]
    second_values = table[used_rows[second_of_pair]]
    contradiction_count = int(np.count_nonzero((first_values != second_values).any(axis=1)))
    used_rows = np.delete(used_rows, second_of_pair)

    return TimeSeries(
        time[used_rows],
        boot=boot[used_rows],
        values=values[used_rows],
        sent_count=sent_count,
        unused_count=sent_count - finite_count + contradiction_count,
    )


def _rises_strictly(time: Array, boot: Integers) -> bool:
    """Returns whether samples (N,) are sorted by boot and ``time``, s, and no two of a boot have one stamp."""
    has_later_boot = boot[1:] > boot[:-1]
    has_later_time = (boot[1:] == boot[:-1]) & (time[1:] > time[:-1])
    return bool((has_later_boot | has_later_time).all())


def recorded_series(telemetry: Telemetry, message: str, *fields: str) -> TimeSeries | None:
    """Returns the time series of one or several fields of a message.

    Args:
        telemetry: Messages of the vehicle.
        message: Name of the message ("VFR_HUD").
        fields: Names of k of its scalar fields.

    Returns:
        The series, with values (N,) of a single field and (N, k) of several. None if the message or a field was not
        recorded, or no row is finite.
    """
    columns = telemetry.messages.get(message, {})
    if not all(field in columns for field in fields):
        return None
    table = float_columns(columns, fields)
    series = clean_series(columns, table if len(fields) > 1 else table[:, 0])
    return series if len(series.time) else None


def message_counts(telemetry: Telemetry, names: Names) -> dict[str, int]:
    """Returns the number of messages of each of these names that was recorded, in the order of ``names``."""
    counts = {}
    for name in names:
        if name in telemetry.messages:
            counts[name] = len(telemetry.messages[name]["time"])
    return counts


def preferred_message(counts: Mapping[str, int]) -> str | None:
    """Returns the most preferred message among those that are about as frequent as the most frequent one.

    Args:
        counts: Number of messages by name, the preferred name first.

    Returns:
        Its name; None if no message came at all.
    """
    names = names_by_preference(counts)
    return names[0] if names else None


def names_by_preference(counts: Mapping[str, int]) -> list[str]:
    """Sorts the types of messages that were recorded by preference, but puts rare ones last.

    A type is rare if its number of messages is below ``MIN_PREFERRED_SHARE`` of that of the most frequent type.

    Args:
        counts: Number of messages of each type by its name, the preferred name first.

    Returns:
        The names of the types with at least one message.
    """
    min_count = MIN_PREFERRED_SHARE * max(counts.values(), default=0)
    frequent_names = []
    rare_names = []
    for name, count in counts.items():
        if count >= min_count and count > 0:
            frequent_names.append(name)
        elif count > 0:
            rare_names.append(name)
    return frequent_names + rare_names


def series_of_boot(series: TimeSeries | None, boot: int) -> TimeSeries | None:
    """Returns the samples of one boot; None if there are none."""
    if series is None:
        return None
    samples = series.of_boot(boot)
    return samples if len(samples.time) else None


def moving_average(series: TimeSeries) -> Array:
    """Returns the centred moving average of a series of one boot over ``AVERAGING_SECONDS``.

    Args:
        series: N samples (N,), whose stamps need not be uniform.

    Returns:
        (N,) the mean of all samples within half of ``AVERAGING_SECONDS`` of each stamp.
    """
    # The sum over a window is the difference of two cumulative sums.
    cumulative = np.concatenate([[0.0], np.cumsum(series.values)])
    first_row = np.searchsorted(series.time, series.time - AVERAGING_SECONDS / 2, side="left")
    row_after = np.searchsorted(series.time, series.time + AVERAGING_SECONDS / 2, side="right")
    return (cumulative[row_after] - cumulative[first_row]) / (row_after - first_row)


def averaged_series(series: TimeSeries) -> TimeSeries:
    """Returns the centred moving averages of a series of one boot (N,), at its stamps."""
    return TimeSeries(series.time, series.boot, moving_average(series))
