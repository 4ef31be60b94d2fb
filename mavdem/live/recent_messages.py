"""The latest slow messages of a live vehicle since its autopilot started, as the columns in which a log holds them."""

from collections import Counter
from collections.abc import Iterable, Sequence
from math import inf
from typing import NamedTuple

import numpy as np

from mavdem.containers import Numbers
from mavdem.ingest.telemetry import Columns, concatenated_columns, selected_rows
from mavdem.live.messages import MESSAGE_FIELDS

MAX_ROWS = 2048
"""Messages of one name that are kept, and parameters, of which a vehicle has up to 1500; a choice of memory.

When there are more, every second message of the older half is dropped.
"""

MAX_EVENTS = 256
"""Events, alarms and replies that are kept or wait to be read; a choice of memory."""


class TimedValues(NamedTuple):
    """The values of a message, with its time."""

    time: float
    """Time on the boot clock, s."""

    values: Numbers
    """Values of its ``MESSAGE_FIELDS``, in their order."""


class RecentMessages:
    """The slow messages of one boot by name, with their times, in bounded memory.

    Attributes:
        boot: number of the boot.
        rows: messages by name, each in the order in which they came; only :meth:`add` changes them.
        changes: number of messages so far with other values than the one before, by name.
    """

    def __init__(self, boot: int = 0) -> None:
        """Begins without messages.

        Args:
            boot: number of the boot.
        """
        self.boot = boot
        self.rows: dict[str, list[TimedValues]] = {}
        self.changes = Counter[str]()
        # Columns of the messages in ``rows``, by name, up to the latest call of ``_all_columns``.
        self._converted: dict[str, Columns] = {}

    def add(self, name: str, time: float, values: Numbers) -> None:
        """Adds a message, and counts it in ``changes`` if its values differ from the message before.

        Of more than ``MAX_ROWS`` messages of one name, every second one of the older half is dropped. So the memory is
        bounded, and yet the whole boot stays covered, its latest seconds completely.

        Args:
            name: name of the message.
            time: time on the boot clock, s.
            values: values of its ``MESSAGE_FIELDS``, in their order.
        """
        messages = self.rows.setdefault(name, [])
        is_first = not messages
        if is_first or not _are_equal(messages[-1].values, values):
            self.changes[name] += 1
        messages.append(TimedValues(time, values))
        if len(messages) > MAX_ROWS:
            self.rows[name] = _thinned_out(name, messages)
            # These columns have the dropped messages too.
            self._converted.pop(name, None)

    def names_since(self, start_time: float) -> set[str]:
        """Returns the names of the messages that have come since ``start_time``, s of the boot clock."""
        return {name for name, rows in self.rows.items() if rows[-1].time >= start_time}

    def columns(self, names: Iterable[str], start_time: float = -inf) -> dict[str, Columns]:
        """Returns messages as the columns of a log, which the functions that judge logs take.

        Args:
            names: names of the messages; names without a received message are left out.
            start_time: messages before it are left out, s of the boot clock.

        Returns:
            For each name its columns: ``time``, ``boot``, and one for each of its ``MESSAGE_FIELDS``.
        """
        columns: dict[str, Columns] = {}
        for name in names:
            if name not in self.rows:
                continue
            all_columns = self._all_columns(name)
            is_recent = all_columns["time"] >= start_time
            if is_recent.any():
                columns[name] = selected_rows(all_columns, is_recent)
        return columns

    def _all_columns(self, name: str) -> Columns:
        """Returns all kept messages of one name as columns: ``time``, ``boot``, and one for each field.

        Messages do not change once they have come. So each is converted to columns only once, and later calls append
        the messages that have come since.

        Args:
            name: name of a message in ``rows``.
        """
        parts = []
        converted_count = 0
        if name in self._converted:
            parts.append(self._converted[name])
            converted_count = len(self._converted[name]["time"])
        new_messages = self.rows[name][converted_count:]
        if new_messages:
            parts.append(columns_from(MESSAGE_FIELDS[name], new_messages, self.boot))
            self._converted[name] = concatenated_columns(parts)
        return self._converted[name]


def _are_equal(values: Numbers, other_values: Numbers) -> bool:
    """Returns whether two messages of one name have the same values; a field may be an array, as cells' voltages."""
    for value, other_value in zip(values, other_values, strict=True):
        if isinstance(value, np.ndarray):
            if not np.array_equal(value, other_value):
                return False
        elif value != other_value:
            return False
    return True


def _thinned_out(name: str, messages: Sequence[TimedValues]) -> list[TimedValues]:
    """Drops every second message of the older half, to bound the memory.

    Several batteries report in turn under one message name, so that the messages of each are counted separately.

    Args:
        name: name of the message.
        messages: the messages of that name, in time order.

    Returns:
        The remaining messages, in time order.
    """
    id_index = None
    if name == "BATTERY_STATUS":
        id_index = MESSAGE_FIELDS[name].index("id")
    half = MAX_ROWS // 2
    kept_messages = []
    count_by_battery: Counter[float] = Counter()
    for message in messages[:half]:
        # Messages that are not of a battery are counted together.
        battery_id = 0.0
        if id_index is not None:
            battery_id = message.values[id_index]
        count_by_battery[battery_id] += 1
        if count_by_battery[battery_id] % 2 == 0:
            kept_messages.append(message)
    return [*kept_messages, *messages[half:]]


def columns_from(fields: Sequence[str], messages: Iterable[TimedValues], boot: int) -> Columns:
    """Turns messages of one name into the columns in which a log holds them.

    Args:
        fields: names of the fields, in the order of the values.
        messages: the messages, each with its time and its values; at least one.
        boot: number of the boot, the same for all of them.

    Returns:
        One array of N values for each field, with the columns "time" and "boot".
    """
    times, values = zip(*messages, strict=True)
    columns = {"time": np.array(times), "boot": np.full(len(times), boot)}
    # One tuple of N values for each field, in the order of the fields.
    values_by_field = zip(*values, strict=True)
    for field, field_values in zip(fields, values_by_field, strict=False):
        columns[field] = np.array(field_values)
    return columns
