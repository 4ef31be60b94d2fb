"""Tables of DataFlash messages: choosing messages and instances, texts, and resampling at another message's stamps."""

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.containers import Names
from mavdem.ingest.telemetry import Columns, Tables, interpolated, selected_rows


def messages_with_fields(tables: Tables, name: str, fields: Names) -> Columns:
    """Returns the messages of a name; empty if there are none, or one of the fields is missing."""
    columns = tables.get(name, {})
    if not message_count(columns) or not all(field in columns for field in fields):
        return {}
    return columns


def rows_of_instance(columns: Columns, field: str, number: float) -> Columns:
    """Returns the messages of one instance, such as a sensor or an estimator core.

    Args:
        columns: Columns of the messages of all instances.
        field: Field with the number of the instance.
        number: Number of the wanted instance.

    Returns:
        Its messages, empty if there are none; all messages where they do not have the field.
    """
    if field not in columns:
        return columns
    is_instance = columns[field] == number
    return selected_rows(columns, is_instance) if is_instance.any() else {}


def message_count(columns: Columns) -> int:
    """Returns how many messages there are."""
    return len(columns.get("time", ()))


def float_table(columns: Columns, fields: Names) -> Array:
    """Returns k fields as a table of floats (N, k), one column per field; NaN where a value is not finite."""
    table = np.column_stack([columns[field] for field in fields]).astype(np.float64)
    table[~np.isfinite(table)] = np.nan
    return table


def with_stamps(logged_columns: Columns, fields: Columns) -> Columns:
    """Returns the fields of a translated message with the stamps of the logged one."""
    return {"time": logged_columns["time"], "boot": logged_columns["boot"], **fields}


def field_texts(columns: Columns, field: str) -> list[str]:
    """Decodes the texts of a field, one per message.

    Texts are filled up with zeros, which are removed. A value that damage has made no text becomes an empty one, so
    that there are as many texts as messages.

    Args:
        columns: Columns of the message, by name of the field.
        field: Name of the field; without it there are no texts.

    Returns:
        The texts, in the order of the messages.
    """
    texts = []
    field_values = columns.get(field, np.zeros(0))
    if field_values.ndim > 1:
        return [""] * len(field_values)
    for value in field_values.tolist():
        text = ""
        if isinstance(value, bytes):
            text = value.split(b"\0", 1)[0].decode("utf-8", errors="replace")
        texts.append(text)
    return texts


SECONDS_PER_BOOT = 1e9
"""Time, s, by which boots lie apart on the clock of :func:`continuous_time`: no boot lasts as long."""


def continuous_time(columns: Columns) -> Array:
    """Returns stamps (N,), s, on one clock for all boots, one after the other."""
    return columns["time"] + SECONDS_PER_BOOT * columns["boot"]


MAX_USUAL_STEP_RATIO = 3.0
"""A step longer than this many median steps is a gap, across which nothing is interpolated."""


def resampled(target: Columns, source: Columns, values: Array, is_angle: bool = False) -> Array:
    """Interpolates values of one message linearly at the stamps of another message.

    Messages of DataFlash logs have different stamps and rates, so values that are used together must be brought to
    common stamps. Nothing is interpolated across gaps.

    Args:
        target: The message (T rows) at whose stamps the values are wanted.
        source: The message (N rows) of the values.
        values: Values (N, k) of ``source``.
        is_angle: Whether the values are angles, rad. These are unwrapped first, so that values between 359° and 1° are
            near 0°, not 180°; the result may exceed a full turn.

    Returns:
        Values (T, k); NaN before the first and after the last value, and inside gaps. They are exact at stamps that
        both messages have.
    """
    if target is source:
        return values
    is_finite = np.isfinite(values).all(axis=1)
    # The first of several messages with one stamp counts.
    source_time, first_rows = np.unique(continuous_time(source)[is_finite], return_index=True)
    target_time = continuous_time(target)
    if len(source_time) < 2:
        return np.full((len(target_time), values.shape[1]), np.nan)
    finite_values = values[is_finite][first_rows]
    if is_angle:
        finite_values = np.unwrap(finite_values, axis=0)
    resampled_values = interpolated(target_time, source_time, finite_values)
    is_defined = _is_between_samples(target_time, source_time)
    return np.where(is_defined[:, None], resampled_values, np.nan)


def _is_between_samples(time: Array, sample_time: Array) -> Flags:
    """Flags the times that lie between two samples without a gap, at which a value may be interpolated.

    A step between two samples that is longer than ``MAX_USUAL_STEP_RATIO`` median steps is a gap.

    Args:
        time: (T,) times, s.
        sample_time: (N,) stamps of the samples, s, rising; two at least.

    Returns:
        Flags (T,); True also at the stamp of a sample, next to a gap or not.
    """
    # The step from sample ``step`` to the next one contains the time.
    row_before = np.searchsorted(sample_time, time, side="right") - 1
    step = np.clip(row_before, 0, len(sample_time) - 2)
    step_lengths = np.diff(sample_time)
    is_gap = step_lengths > MAX_USUAL_STEP_RATIO * np.median(step_lengths)
    is_at_sample = (time == sample_time[step]) | (time == sample_time[step + 1])
    is_covered = (time >= sample_time[0]) & (time <= sample_time[-1])
    return is_covered & (is_at_sample | ~is_gap[step])
