"""PX4's topics as they are logged: which of them are read, and access to their fields.

Topics are defined in https://github.com/PX4/PX4-Autopilot/tree/main/msg.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array, Flags
from mavdem.files import load_adjacent_toml
from mavdem.ingest.telemetry import (
    Columns,
    Fields,
    concatenated_columns,
    last_values,
    selected_rows,
)

Topics = Mapping[str, Mapping[int, Columns]]
"""Logged topics by name and number of the instance.

Fields have pyulog's names ("q[0]"), (N,) each, and there is ``time`` (N,), s since boot.
"""

TOPIC_FIELDS = {
    topic: tuple(fields)
    for topic, fields in load_adjacent_toml(__file__, "px4_topics.toml").items()
}
"""The topics that are read, and the fields of each except ``timestamp``, arrays with their length."""

SETPOINT_TOPICS = frozenset({"vehicle_attitude_setpoint", "vehicle_rates_setpoint"})
"""Topics that a companion may publish as well as PX4."""


class MessageMaker(NamedTuple):
    """How one MAVLink message is made of the topics alone."""

    topic_name: str
    """The topic that a report names as the origin of the message."""
    make: Callable[[Topics], Fields]
    """Returns the columns of the message; raises KeyError where something that it needs was not logged."""


def first_instance(topics: Topics, name: str) -> Columns:
    """Returns the instance of a topic with the lowest number; empty if there is none."""
    instances = topics.get(name)
    return instances[min(instances)] if instances else {}


def array_field(topic: Columns, field: str, length: int) -> Array:
    """Returns an array field as a table of floats (N, length); raises KeyError where an element was not logged."""
    columns = [topic[f"{field}[{n}]"] for n in range(length)]
    return np.column_stack(columns).astype(np.float64)


def flag_or_true(topic: Columns, field: str) -> Flags:
    """Returns a field of flags (N,); true throughout where it was not logged."""
    return topic.get(field, np.ones(len(topic["time"]))).astype(np.bool_)


def last_field_values(topic: Columns, field: str, time: Array) -> NDArray[Any]:
    """Returns the field's last value at each time (T,), s; 0 before the first, and where it was not logged."""
    if field not in topic:
        return np.zeros(len(time))
    return last_values(time, topic["time"], topic[field])


def in_time_order(tables: Sequence[Columns]) -> Fields:
    """Joins tables of one message into one table in the order of time.

    Args:
        tables: tables with the same columns, among them ``time``, s.

    Returns:
        Columns of all rows; only an empty ``time`` without a table.
    """
    if not tables:
        return {"time": np.zeros(0)}
    columns = concatenated_columns(tables)
    return selected_rows(columns, np.argsort(columns["time"], kind="stable"))
