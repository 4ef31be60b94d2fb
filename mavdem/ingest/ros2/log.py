"""Flights in ROS 2 recordings (rosbag2's MCAP files): PX4's topics and MAVROS's as MAVLink messages, no parameters.

PX4's uXRCE-DDS client publishes ``fmu/out/vehicle_attitude`` and subscribes to ``fmu/in/…``, a version behind the name
where the message has one (``vehicle_status_v1``), and a namespace before it where there are several vehicles
(https://docs.px4.io/main/en/middleware/uxrce_dds). The bridge before it wrote ``fmu/vehicle_attitude/out``.

MAVROS's topics lie under its node's name, ``mavros`` unless it was started with another. They become MAVLink's messages
by the inverse of MAVROS's own translation into the frames of ROS (REP 103: east-north-up, and forward-left-up in the
body). Each function names the file of https://github.com/mavlink/mavros/tree/ros2/mavros/src that it inverts. Stamps
are the autopilot's, moved to the companion's clock (``lib/uas_timesync.cpp``), or the time of receipt where the clocks
were never compared.
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array, Integers
from mavdem.errors import Unreadable
from mavdem.facts import Facts
from mavdem.facts.sources import Flaw, Repair, Source
from mavdem.files import load_adjacent_toml
from mavdem.ingest import px4_topics
from mavdem.ingest.mavlink.clocks import MessageStamps, boot_clock
from mavdem.ingest.mavlink.definitions import enum_name
from mavdem.ingest.mcap.records import McapRecording
from mavdem.ingest.px4_topics import NEEDED, SETPOINTS
from mavdem.ingest.ros2.messages import CDR, TopicColumns, columns_of, decoder
from mavdem.ingest.telemetry import (
    Columns,
    Log,
    SourceFields,
    Tables,
    Telemetry,
    log_of_vehicles,
    repair_facts,
    selected_rows,
    translated_fields,
)
from mavdem.ingest.vocabulary import (
    ARDUPILOT,
    AUTOPILOT_COMPONENT,
    GENERIC,
    NAMES,
    PX4,
    UNNAMED,
    heartbeat_fields,
)

# Bridges from an autopilot to ROS 2
PX4_BRIDGE = "uXRCE-DDS"
MAVROS = "MAVROS"
_PX4_TOPIC = re.compile(
    r"(?P<vehicle>.*?)/(?:fmu/)?(?:(?P<way>in|out)/)?(?P<name>\w+?)(?:_v\d+)?(?:/(?P<old_way>in|out))?"
)


class RosTopic(NamedTuple):
    """A topic: its ``bridge``, ``vehicle`` ("/uav1", or empty) and ``name`` there; ``incoming``: to the autopilot."""

    bridge: str
    vehicle: str
    name: str
    incoming: bool = False


def flight_topics(recording: McapRecording) -> dict[int, RosTopic]:
    """Returns the topic of each channel, by its number, that is of a flight.

    A node is MAVROS's if one of its topics has a type that only MAVROS sends: other drivers send imu/data too.
    """
    topics = {}
    nodes = set()
    for number, channel in recording.channels.items():
        if channel.message_encoding == CDR and channel.schema_id in recording.schemas:
            schema = recording.schemas[channel.schema_id].name
            topic = f"/{channel.topic.lstrip('/')}"
            is_px4 = re.fullmatch(r"px4_msgs/msg/\w+", schema)
            if topic_of := _of_px4(topic) if is_px4 else _of_mavros(topic, schema):
                topics[number] = topic_of
                if is_px4 or schema.startswith("mavros_msgs/msg/"):
                    nodes.add(topic_of.vehicle)
    return {number: topic for number, topic in topics.items() if topic.vehicle in nodes}


def _of_px4(topic: str) -> RosTopic | None:
    match = _PX4_TOPIC.fullmatch(topic)
    # A companion stamps the setpoints it sends by a clock of its own.
    if match is None or match["name"] not in NEEDED:
        return None
    incoming = "in" in (match["way"], match["old_way"])
    if incoming and match["name"] in SETPOINTS:
        return None
    return RosTopic(PX4_BRIDGE, match["vehicle"], match["name"], incoming)


def _of_mavros(topic: str, schema: str) -> RosTopic | None:
    for name, kind in MAVROS_TOPICS.items():
        if schema == kind.schema and topic.endswith(f"/{name}"):
            node = topic.removesuffix(f"/{name}")
            return RosTopic(MAVROS, node.removesuffix("/mavros"), name)
    return None


Fields = Mapping[str, Array]  # The numbers of a topic's messages by name, (N,) each


class MavrosTopic(NamedTuple):
    """A topic: its MAVLink ``message``, its own ``schema``, and the fields with ``numbers``.

    ``fields`` are rules of ``renamed``.
    """

    message: str
    schema: str
    numbers: list[str]
    fields: SourceFields = {}


SECOND = 1_000_000_000  # Nanoseconds
STAMPS = {
    PX4_BRIDGE: {"timestamp": 1000},
    MAVROS: {"header.stamp.sec": SECOND, "header.stamp.nanosec": 1},
}
"""Fields with the stamp of every message, and the unit of each, ns; PX4's is when a message was published."""
_TOPICS = load_adjacent_toml(__file__, "mavros_topics.toml")
MAVROS_TOPICS = {name: MavrosTopic(**topic) for name, topic in _TOPICS.items()}
"""By the name after the node's, which is ``mavros`` unless it was started with another."""
MAVROS_PERIODS = {"rc/out": 2**32 / 1e6}
"""Seconds after which stamps wrap: MAVROS moves the 32 bits of SERVO_OUTPUT_RAW's as they are (plugins/rc_io.cpp)."""


def mavros_autopilot(modes: Counter[str]) -> int:
    """Returns MAV_AUTOPILOT by the names of the flight modes and how often each occurs."""
    modes_of = NAMES["mavros_modes"]
    px4, ardupilot = (
        sum(modes[mode] for mode in modes_of[name]) for name in ("PX4", "ARDUPILOTMEGA")
    )
    px4 += sum(count for mode, count in modes.items() if mode.startswith("AUTO."))
    if px4 == ardupilot:
        return GENERIC
    return PX4 if px4 > ardupilot else ARDUPILOT


def mavros_message(topic: str, fields: Fields, vehicle_autopilot: int) -> dict[str, NDArray[Any]]:
    """Returns the fields of the MAVLink message of one of ``MAVROS_TOPICS``, without its stamps."""
    kind = MAVROS_TOPICS[topic]
    made = translated_fields(fields, kind.fields)
    if kind.message == "ATTITUDE_QUATERNION":
        made |= dict(zip(("q1", "q2", "q3", "q4"), _quaternion(fields), strict=True))
    elif kind.message == "ATTITUDE_TARGET":
        made["q"] = _quaternion(fields).T
    elif kind.message == "SERVO_OUTPUT_RAW":
        made |= {f"servo{n + 1}_raw": fields[f"channels[{n}]"] for n in range(16)}
    elif kind.message == "ACTUATOR_CONTROL_TARGET":
        made["controls"] = np.column_stack([fields[f"controls[{n}]"] for n in range(8)])
    elif kind.message == "HEARTBEAT":
        # plugins/sys_status.cpp; the type of vehicle is not known: 0, GENERIC.
        made = heartbeat_fields(0, vehicle_autopilot, fields["armed"])
    return made


def _quaternion(fields: Fields) -> Array:
    """(4, N) q_ENU,FLU = q_n q_NED,FRD q_b, of half a turn each, undone.

    q_n = (i + j)/√2 swaps north and east and turns down up, q_b = i turns right left and down up. Both are their own
    inverses but for the sign, which an attitude does not have: q_NED,FRD = q_n q_ENU,FLU q_b, multiplied out here.
    """
    w, x, y, z = (fields[f"orientation.{n}"] for n in "wxyz")
    return np.sqrt(0.5) * np.array([w + z, x + y, x - y, w - z])


BOOT_APART = 1e9  # Seconds from one boot's clock to the next's while topics are translated: no log is as long


def read_ros2(recording: McapRecording, source: str) -> Log:
    """Reads the vehicles in a ROS 2 recording; of each, PX4's own topics or, where there are none, MAVROS's.

    In the ``Log``, ``frames`` counts the messages that were read. The ``recording`` was read once, so that its channels
    and schemas are known; it is read anew. Raises ``Unreadable`` without a message of a flight that can be decoded.
    """
    topics = flight_topics(recording)
    schemas = {number: recording.channels[number].schema_id for number in topics}
    decoders = {number: decoder(recording.schemas[number]) for number in set(schemas.values())}
    read: dict[int, dict[int, Any]] = {number: {} for number in topics}
    undecodable: Counter[str] = Counter()
    log_times = []
    anew = McapRecording(recording.content)
    for index, message in enumerate(anew.messages()):
        number = message.channel_id
        if number not in topics:
            continue
        decode = decoders[schemas[number]]
        try:
            assert decode is not None
            read[number][index] = decode(message.data)
            log_times.append(message.log_time / 1e9)
        except Exception:  # cut short, or of another type: the library may raise anything
            undecodable[anew.channels[number].topic] += 1
    tables = []
    for number, messages in read.items():
        table = _table(topics[number], messages)
        if table is None:
            undecodable[anew.channels[number].topic] += len(messages)
        else:
            tables.append((topics[number], table))
    made = [
        (name, telemetry)
        for name, own in _by_vehicle(tables)
        if (telemetry := vehicle(own, source)) is not None
    ]
    if not made:
        raise Unreadable(Source.ROS2_DAMAGED, path=source)
    code = Repair.LOGGED_MESSAGES_LEFT_OUT
    repairs = (
        *anew.repairs(),
        *repair_facts(
            code, flaw=Flaw.UNDECODABLE, count=undecodable.total(), names=sorted(+undecodable)
        ),
    )
    vehicles = tuple(
        replace(vehicle, repairs=repairs + vehicle.repairs) for vehicle in numbered(made)
    )
    span = min(log_times), max(log_times)
    return log_of_vehicles(vehicles, len(log_times), anew.skipped, span)


def _table(topic: RosTopic, messages: Mapping[int, Any]) -> TopicColumns | None:
    if topic.bridge == PX4_BRIDGE:
        return columns_of(messages, [*STAMPS[PX4_BRIDGE]], px4_topics.NEEDED[topic.name])
    return columns_of(messages, (*STAMPS[MAVROS], *MAVROS_TOPICS[topic.name].numbers), ())


def _by_vehicle(
    tables: Sequence[tuple[RosTopic, TopicColumns]],
) -> list[tuple[str, dict[RosTopic, TopicColumns]]]:
    """The namespace of each vehicle and its topics; of several channels of a topic, the one with most messages."""
    vehicles: dict[str, dict[RosTopic, TopicColumns]] = {}
    for topic, table in tables:
        topics = vehicles.setdefault(topic.vehicle, {})
        if len(table.places) > (len(topics[topic].places) if topic in topics else 0):
            topics[topic] = table
    return sorted(vehicles.items())


def vehicle(topics: Mapping[RosTopic, TopicColumns], source: str) -> Telemetry | None:
    """Returns the vehicle of a namespace's topics, PX4's or else MAVROS's, ``system`` 0 if unsaid; None without."""
    # Topics to the autopilot are used where there is none from it.
    in_turn = sorted(topics.items(), key=lambda item: not item[0].incoming)
    px4, mavros = (
        {topic.name: table for topic, table in in_turn if topic.bridge == bridge}
        for bridge in (PX4_BRIDGE, MAVROS)
    )
    made = _px4_vehicle(px4, source)
    if made is None:
        return _mavros_vehicle(mavros, source)
    also = repair_facts(Repair.TOPICS_NOT_READ, name="mavros") if mavros else ()
    return replace(made, repairs=made.repairs + also)


def numbered(vehicles: Sequence[tuple[str, Telemetry]]) -> Iterator[Telemetry]:
    """Yields vehicles with their namespaces, numbered from 1 where some say no system id, or the same.

    Repairs say so.
    """
    said = {vehicle.system for _, vehicle in vehicles if vehicle.system}
    for system, (namespace, vehicle) in enumerate(vehicles, 1):
        if len(said) == len(vehicles):
            yield vehicle
            continue
        further = (
            repair_facts(
                Repair.SYSTEM_NUMBERED, name=namespace or "/", given=vehicle.system, system=system
            )
            if len(vehicles) > 1
            else ()
        )
        yield replace(vehicle, system=system, repairs=vehicle.repairs + further)


def _px4_vehicle(tables: Mapping[str, TopicColumns], source: str) -> Telemetry | None:
    topics, repairs = _on_one_clock(tables, STAMPS[PX4_BRIDGE])
    instances = {}
    for name, columns in topics.items():
        apart = {**columns, "time": columns["time"] + BOOT_APART * columns["boot"]}
        instances[name] = {0: selected_rows(apart, np.argsort(apart["time"], kind="stable"))}
    kind, made, names = px4_topics.messages(instances, {})
    if not made:
        return None
    messages = {}
    for name, fields in made.items():
        boot = (fields["time"] // BOOT_APART).astype(np.int64)
        messages[name] = {**fields, "time": fields["time"] - BOOT_APART * boot, "boot": boot}
    ids = topics.get("vehicle_status", {})
    system = _most_frequent_id(ids, "system_id", 0)
    component = _most_frequent_id(ids, "component_id", 1)
    return Telemetry(
        system,
        component,
        kind,
        "PX4",
        messages,
        {},
        source,
        repairs,
        translated_from=PX4_BRIDGE,
        source_names=names,
    )


def _mavros_vehicle(tables: Mapping[str, TopicColumns], source: str) -> Telemetry | None:
    placed, repairs = _on_one_clock(tables, STAMPS[MAVROS])
    states = tables["state"].columns["mode"] if "state" in tables else ()
    autopilot = mavros_autopilot(Counter(map(str, states)))
    messages = {
        MAVROS_TOPICS[name].message: {
            "time": columns["time"],
            "boot": columns["boot"],
            **mavros_message(name, columns, autopilot),
        }
        for name, columns in placed.items()
    }
    if not messages:
        return None
    names = {topic.message: name for name, topic in MAVROS_TOPICS.items()}
    return Telemetry(
        0,
        AUTOPILOT_COMPONENT,
        UNNAMED,
        enum_name("MAV_AUTOPILOT", autopilot),
        messages,
        {},
        source,
        repairs,
        translated_from=MAVROS,
        source_names=names,
    )


def _on_one_clock(
    tables: Mapping[str, TopicColumns], units: Mapping[str, int]
) -> tuple[Tables, Facts]:
    """Each topic's columns by fields of stamps with their ``units``, with ``time`` and ``boot``, and the repairs.

    UNIX time counts from a second before the first stamp: floats of seconds since 1970 do not resolve a microsecond.
    """
    stamps = {
        name: np.sum([_nanoseconds(table.columns[field], units[field]) for field in units], axis=0)
        for name, table in tables.items()
    }
    every = np.concatenate([*stamps.values(), np.empty(0, dtype=np.int64)])
    start, repairs = _start(every[every > 0])
    seconds = {name: (own - start) / 1e9 for name, own in stamps.items()}
    usable = {name: (own > 0) & (seconds[name] > 0) for name, own in stamps.items()}
    without = sum(np.count_nonzero(~some) for some in usable.values())
    repairs += repair_facts(Repair.LOGGED_MESSAGES_LEFT_OUT, count=without, flaw=Flaw.NO_STAMP)
    sent = [
        MessageStamps(
            name,
            tables[name].places[some],
            seconds[name][some],
            MAVROS_PERIODS.get(name, np.inf),
        )
        for name, some in usable.items()
        if some.any()
    ]
    (stamped, of_clock) = boot_clock(sent)
    placed = dict[str, Columns]()
    for name, (time, boot) in stamped.items():
        # A message whose stamp was ignored has the place of the one before.
        new = np.ones(len(time), dtype=np.bool_)
        new[1:] = (np.diff(time) != 0) | (np.diff(boot) != 0)
        kept = selected_rows(tables[name].columns, np.flatnonzero(usable[name])[new])
        placed[name] = kept | {"time": time[new], "boot": boot[new]}
    return placed, repairs + of_clock


def _start(stamps: Integers) -> tuple[int, Facts]:
    """The origin of time, ns, and a repair where that is not the boot of the vehicle."""
    # The middle stamp itself: the mean of two clocks' stamps, half of the messages each, would be near neither.
    middle = int(np.partition(stamps, len(stamps) // 2)[len(stamps) // 2]) if len(stamps) else 0
    if middle < 10**9 * SECOND:  # the year 2001: no autopilot runs for so long
        return 0, ()
    # Stamps a month away are not of the same recording.
    first = int(stamps[abs(stamps - middle) < 30 * 86400 * SECOND].min()) // SECOND - 1
    return first * SECOND, repair_facts(Repair.UNIX_TIME_MOVED, origin=first)


def _nanoseconds(values: Array, unit: int) -> Integers:
    """Stamps in nanoseconds, from values in multiples of ``unit`` ns; 0 for an impossible one."""
    # As integers: floats do not hold nanoseconds since 1970, and 64 bits not much more than 9e18.
    return (
        np.where((values > 0) & (values < 9 * 10**18 // unit), values, 0.0).astype(np.int64) * unit
    )


def _most_frequent_id(status: Columns, field: str, default: int) -> int:
    valid = [int(number) for number in status.get(field, ()) if 1 <= number <= 255]
    return max(set(valid), key=valid.count, default=default)
