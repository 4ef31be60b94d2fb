"""What the topics of one namespace of a ROS 2 recording tell of its vehicle, in MAVLink's messages on one clock."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest import mavros_topics, px4_topics
from mavdem.ingest.decode import enum_name
from mavdem.ingest.mcap_records import listed
from mavdem.ingest.ros2_clock import SECOND, OnClock, Stamped, on_one_clock
from mavdem.ingest.ros2_messages import Table
from mavdem.ingest.ros2_topics import MAVROS, PX4, Topic
from mavdem.ingest.vehicles import UNNAMED
from mavdem.telemetry import Columns

PX4_STAMP, PX4_SAMPLE = "timestamp", "timestamp_sample"
"""µs on one clock: when a message was published, and, in some, when what it tells was measured."""
AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1."""
LATEST = 9 * 10**18
"""Nanoseconds that 64 bits hold."""
Numbers = Mapping[str, NDArray[np.float64]]
"""The numbers of a topic's messages by name, (N,) each."""


class Vehicle(NamedTuple):
    """A vehicle: its ``namespace``, the ``bridge`` of its topics, and the rest as in ``Telemetry``.

    ``system`` is 0 where no topic tells it.
    """

    namespace: str
    bridge: str
    system: int
    component: int
    vehicle: str
    autopilot: str
    messages: Mapping[str, Columns]
    repairs: tuple[str, ...]


def vehicle(namespace: str, topics: Mapping[Topic, Table]) -> Vehicle | None:
    """The vehicle of a namespace, by PX4's own topics or else MAVROS's; None where they tell nothing."""
    # What the autopilot is told stands in for what it does not tell.
    in_turn = sorted(topics.items(), key=lambda item: not item[0].incoming)
    px4 = {topic.name: table for topic, table in in_turn if topic.bridge == PX4}
    mavros = {topic.name: table for topic, table in in_turn if topic.bridge == MAVROS}
    made = _of_px4(namespace, px4)
    if made is None:
        return _of_mavros(namespace, mavros)
    beside = ("MAVROS's topics of the same vehicle were not read: PX4's own are there.",) if mavros else ()
    return made._replace(repairs=made.repairs + beside)


def numbered(vehicles: Sequence[Vehicle]) -> Iterator[Vehicle]:
    """The vehicles, each with a system id of its own; of several a sentence tells where that is not what topics say."""
    said = {one.system for one in vehicles}
    free = iter(sorted(set(range(1, 1 + len(said) + len(vehicles))) - said))
    given: set[int] = set()
    for one in vehicles:
        if one.system and one.system not in given:
            given.add(one.system)
            yield one
            continue
        system = next(free)
        what = f"say system {one.system}, as others do" if one.system else "tell no system id"
        told = (
            (f"The topics of {listed([one.namespace or '/'])} {what}: numbered {system}.",) if len(vehicles) > 1 else ()
        )
        yield one._replace(system=system, repairs=one.repairs + told)


def _of_px4(namespace: str, tables: Mapping[str, Table]) -> Vehicle | None:
    stamped = {name: Stamped(table.places, _ns(table.columns[PX4_STAMP], 1000)) for name, table in tables.items()}
    placed, repairs = on_one_clock(stamped)
    topics = {name: _px4_topic(tables[name].columns, on_clock) for name, on_clock in placed.items()}
    kind = px4_topics.mav_type({name: {0: topic} for name, topic in topics.items()}, {})
    name_of_kind = enum_name("MAV_TYPE", kind) if kind is not None else UNNAMED
    boots = []
    for boot in np.unique(np.concatenate([on_clock.boot for on_clock in placed.values()])) if placed else ():
        rows = {name: np.flatnonzero(on_clock.boot == boot) for name, on_clock in placed.items()}
        here = {name: {0: _in_order(topics[name], rows[name])} for name in topics if len(rows[name])}
        made = px4_topics.messages(here, {}, name_of_kind, kind)
        boots.append({name: {**columns, "boot": columns["boot"] + boot} for name, columns in made.items()})
    messages = {name: _joined([made[name] for made in boots if name in made]) for name in sorted(set().union(*boots))}
    if not messages:
        return None
    status = topics.get("vehicle_status", {})
    return Vehicle(
        namespace=namespace,
        bridge=PX4,
        system=_id(status.get("system_id"), 0),
        component=_id(status.get("component_id"), AUTOPILOT),
        vehicle=name_of_kind,
        autopilot=enum_name("MAV_AUTOPILOT", px4_topics.PX4),
        messages=messages,
        repairs=repairs,
    )


def _px4_topic(columns: Numbers, on_clock: OnClock) -> Numbers:
    """The topic's messages on the clock, both its stamps moved alike, also where they were of another clock."""
    topic = {name: values[on_clock.rows] for name, values in columns.items()} | {"time": on_clock.time}
    if PX4_SAMPLE in topic:
        topic[PX4_SAMPLE] = topic[PX4_SAMPLE] + np.rint(on_clock.time * 1e6 - topic[PX4_STAMP])
    return topic


def _of_mavros(namespace: str, tables: Mapping[str, Table]) -> Vehicle | None:
    kinds = {name: mavros_topics.TOPICS[name] for name in tables}
    sec, nanosec = mavros_topics.STAMP
    placed, repairs = on_one_clock(
        {
            kinds[name].message: Stamped(
                table.places,
                _ns(table.columns[sec], SECOND) + _ns(table.columns[nanosec], 1),
                mavros_topics.PERIODS.get(kinds[name].message, np.inf),
            )
            for name, table in tables.items()
        }
    )
    pilot = mavros_topics.autopilot(sum((table.texts for table in tables.values()), Counter()))
    messages: dict[str, Columns] = {}
    for name, table in tables.items():
        message = kinds[name].message
        if message in placed:
            on_clock = placed[message]
            fields = {field: values[on_clock.rows] for field, values in table.columns.items()}
            made = mavros_topics.translated(message, fields, pilot)
            messages[message] = {"time": on_clock.time, "boot": on_clock.boot, **made}
    if not messages:
        return None
    named = enum_name("MAV_AUTOPILOT", pilot)
    return Vehicle(namespace, MAVROS, 0, AUTOPILOT, UNNAMED, named, messages, repairs)


def _ns(values: NDArray[np.float64], unit: int) -> NDArray[np.int64]:
    """Stamps in nanoseconds, of which one of ``values`` has ``unit``; 0 for what is none."""
    # As integers: floats do not hold nanoseconds since 1970.
    return np.where((values > 0) & (values < LATEST // unit), values, 0.0).astype(np.int64) * unit


def _in_order(topic: Numbers, rows: NDArray[np.intp]) -> Numbers:
    order = rows[np.argsort(topic["time"][rows], kind="stable")]
    return {name: values[order] for name, values in topic.items()}


def _joined(parts: Sequence[Columns]) -> dict[str, NDArray[Any]]:
    """One boot after the other."""
    return {field: np.concatenate([part[field] for part in parts]) for field in parts[0]}


def _id(said: NDArray[np.float64] | None, untold: int) -> int:
    """The id that most messages tell."""
    ids = [] if said is None else [int(one) for one in said if 1 <= one <= 255]
    return max(set(ids), key=ids.count, default=untold)
