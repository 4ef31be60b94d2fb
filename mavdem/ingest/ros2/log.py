"""Flights in ROS 2 recordings (MCAP files of rosbag2): topics of PX4 or MAVROS as MAVLink messages, no parameters."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags, Integers
from mavdem.errors import Unreadable
from mavdem.facts import Facts
from mavdem.facts.sources import Flaw, Repair, SourceFact
from mavdem.ingest.mavlink.clock_readings import MessageStamps
from mavdem.ingest.mavlink.clocks import boot_clock
from mavdem.ingest.mavlink.dialect import enum_name
from mavdem.ingest.mcap.records import NANOSECONDS, McapRecording
from mavdem.ingest.px4_topics import TOPIC_FIELDS
from mavdem.ingest.px4_translation import messages_of_topics
from mavdem.ingest.ros2.clock_setting import ReceiveTimes, with_joined_clocks
from mavdem.ingest.ros2.mavros import (
    MAVROS,
    MAVROS_TOPICS,
    WRAP_PERIODS,
    mavros_autopilot,
    mavros_message,
)
from mavdem.ingest.ros2.messages import TopicColumns, columns_of, decoder
from mavdem.ingest.ros2.topics import PX4_BRIDGE, RosTopic, flight_topics
from mavdem.ingest.telemetry import (
    Columns,
    Log,
    Tables,
    Telemetry,
    log_of_vehicles,
    repair_facts,
    selected_rows,
)
from mavdem.ingest.vocabulary import AUTOPILOT_COMPONENT, UNNAMED

SECOND = 1_000_000_000
"""Nanoseconds in a second, as an integer."""

STAMP_UNITS = {
    PX4_BRIDGE: {"timestamp": 1000},
    MAVROS: {"header.stamp.sec": SECOND, "header.stamp.nanosec": 1},
}
"""Fields that together are the stamp of a message, and the unit of each, ns; PX4's is when a message was published."""

BOOT_INTERVAL = 1e9
"""Time, s, by which boots lie apart on one clock while PX4's topics are translated: no log is as long."""


class _DecodedMessages(NamedTuple):
    """The messages of a recording that can be decoded; a position is a message's number in the whole recording."""

    by_channel: dict[int, dict[int, Any]]
    """Decoded messages by position, by the id of the channel."""
    receive_times: dict[int, int]
    """When each decoded message was received, UNIX ns, by position."""
    undecodable: Counter[str]
    """Number of messages that could not be decoded, by topic."""


def _decoded_messages(
    recording: McapRecording, second_reading: McapRecording, topics: Mapping[int, RosTopic]
) -> _DecodedMessages:
    """Decodes the messages of some topics, and counts messages that cannot be decoded.

    The recording is read twice: all channels and schemas must be known before the first message can be decoded.

    Args:
        recording: The recording after its messages were read, so that its channels and schemas are known.
        second_reading: The same recording, to be read from the beginning.
        topics: The topics by the id of their channel.

    Returns:
        The messages by channel and position in the recording, with their receive times, UNIX ns, and the number of
        undecodable messages by topic. A channel without a decodable message has an empty dictionary.
    """
    schema_of_channel = {
        channel_id: recording.channels[channel_id].schema_id for channel_id in topics
    }
    decoders = {
        schema: decoder(recording.schemas[schema]) for schema in set(schema_of_channel.values())
    }
    by_channel: dict[int, dict[int, Any]] = {channel_id: {} for channel_id in topics}
    receive_times: dict[int, int] = {}
    undecodable_counts: Counter[str] = Counter()
    for position, message in enumerate(second_reading.messages()):
        channel_id = message.channel_id
        if channel_id not in topics:
            continue
        topic_name = second_reading.channels[channel_id].topic
        decode = decoders[schema_of_channel[channel_id]]
        if decode is None:
            # The library has no decoder for messages of this type.
            undecodable_counts[topic_name] += 1
            continue
        try:
            by_channel[channel_id][position] = decode(message.data)
            receive_times[position] = message.log_time
        except Exception:
            # The library may raise anything on a message that is cut short, or of another type.
            undecodable_counts[topic_name] += 1
    return _DecodedMessages(by_channel, receive_times, undecodable_counts)


def read_ros2(recording: McapRecording, source: str) -> Log:
    """Reads the vehicles in a ROS 2 recording; of each, PX4's own topics or, where there are none, MAVROS's.

    Messages are decoded one by one, and kept by their number in the recording. Each topic is then turned into columns,
    topics are grouped by vehicle, and the topics of a vehicle are translated together. What cannot be decoded is
    counted and reported.

    Args:
        recording: The recording, which was read once, so that its channels and schemas are known; it is read again.
        source: Name of the file, for error messages and the report.

    Returns:
        The log; its ``frames`` are the messages that were decoded.

    Raises:
        Unreadable: No message of a flight can be decoded.
    """
    topics = flight_topics(recording)
    second_reading = McapRecording(recording.content)
    decoded = _decoded_messages(recording, second_reading, topics)
    receive_times = decoded.receive_times
    undecodable_counts = decoded.undecodable
    tables = []
    for channel_id, messages in decoded.by_channel.items():
        table = _topic_columns(topics[channel_id], messages)
        if table is None:
            undecodable_counts[second_reading.channels[channel_id].topic] += len(messages)
        else:
            tables.append((topics[channel_id], table))
    vehicles = []
    for namespace, tables_of_vehicle in _tables_by_vehicle(tables):
        telemetry = _telemetry_of_namespace(tables_of_vehicle, receive_times, source)
        if telemetry is not None:
            vehicles.append((namespace, telemetry))
    if not vehicles:
        raise Unreadable(SourceFact.ROS2_DAMAGED, path=source)
    repairs = (
        *second_reading.repairs(),
        *repair_facts(
            Repair.LOGGED_MESSAGES_LEFT_OUT,
            flaw=Flaw.UNDECODABLE,
            count=undecodable_counts.total(),
            # The plus drops topics whose count is 0.
            names=sorted(+undecodable_counts),
        ),
    )
    return log_of_vehicles(
        tuple(
            replace(vehicle, repairs=repairs + vehicle.repairs)
            for vehicle in with_system_ids(vehicles)
        ),
        frames=len(receive_times),
        bytes_skipped=second_reading.skipped_bytes,
        receive_time=(
            min(receive_times.values()) / NANOSECONDS,
            max(receive_times.values()) / NANOSECONDS,
        ),
    )


def _topic_columns(topic: RosTopic, messages: Mapping[int, Any]) -> TopicColumns | None:
    """Returns columns of the time stamp and of those other fields of a topic that are used.

    PX4's messages may lack a field, since its versions differ. MAVROS's types are fixed: each field is required.

    Args:
        topic: Vehicle (namespace), bridge and name of the topic.
        messages: Its decoded messages, by their number in the recording.

    Returns:
        Columns of the messages; None if a required field is missing, since they are then of another type.
    """
    # The keys are the names of the stamp's fields.
    stamp_fields = tuple(STAMP_UNITS[topic.bridge])
    if topic.bridge == PX4_BRIDGE:
        return columns_of(messages, required=stamp_fields, optional=TOPIC_FIELDS[topic.name])
    required_fields = (*stamp_fields, *MAVROS_TOPICS[topic.name].numbers)
    return columns_of(messages, required_fields, optional=())


def _tables_by_vehicle(
    tables: Sequence[tuple[RosTopic, TopicColumns]],
) -> list[tuple[str, dict[RosTopic, TopicColumns]]]:
    """Groups the topics of a recording by vehicle, that is by namespace.

    A topic may have been recorded in several channels; then the channel with most messages counts.

    Args:
        tables: The topic of each channel and its messages, as columns.

    Returns:
        For each vehicle its namespace, and its topics with their messages; sorted by namespace.
    """
    topics_of_vehicle: dict[str, dict[RosTopic, TopicColumns]] = {}
    for topic, table in tables:
        topics = topics_of_vehicle.setdefault(topic.vehicle, {})
        message_count = len(topics[topic].positions) if topic in topics else 0
        if len(table.positions) > message_count:
            topics[topic] = table
    return sorted(topics_of_vehicle.items())


def _telemetry_of_namespace(
    topics: Mapping[RosTopic, TopicColumns], receive_times: ReceiveTimes, source: str
) -> Telemetry | None:
    """Returns the vehicle of one namespace, from PX4's topics, or otherwise from MAVROS's topics.

    Both bridges may have been recorded. PX4's topics have more messages, and are preferred; a fact then reports that
    MAVROS's topics were not read.

    Args:
        topics: The vehicle's topics of both bridges.
        receive_times: Reception time of each message, by topic.
        source: Name of the file, for error messages and the report.

    Returns:
        The vehicle, whose ``system`` is 0 if no topic has the system id; None if no topic makes a flight.
    """
    px4_tables: dict[str, TopicColumns] = {}
    mavros_tables: dict[str, TopicColumns] = {}
    # A topic may be logged both on its way to the autopilot and from it. The latter is last here, and takes precedence.
    to_autopilot = [topic for topic in topics if topic.incoming]
    from_autopilot = [topic for topic in topics if not topic.incoming]
    for topic in to_autopilot + from_autopilot:
        tables = px4_tables if topic.bridge == PX4_BRIDGE else mavros_tables
        tables[topic.name] = topics[topic]
    telemetry = _px4_telemetry(px4_tables, receive_times, source)
    if telemetry is None:
        return _mavros_telemetry(mavros_tables, receive_times, source)
    if mavros_tables:
        not_read = repair_facts(Repair.TOPICS_NOT_READ, name="mavros")
        telemetry = replace(telemetry, repairs=telemetry.repairs + not_read)
    return telemetry


def with_system_ids(vehicles: Sequence[tuple[str, Telemetry]]) -> Iterator[Telemetry]:
    """Gives the vehicles of a recording distinct system ids, if they lack them.

    In a log, vehicles are distinguished by their system ids; in a ROS 2 recording, by their namespaces. If a vehicle
    has no system id, or two have the same, all are numbered from 1. With several vehicles, a fact of each reports
    that.

    Args:
        vehicles: Namespace and telemetry of each vehicle; ``system`` is 0 where it is not known.

    Yields:
        Each vehicle, with a system id that no other has.
    """
    system_ids = {vehicle.system for _, vehicle in vehicles if vehicle.system}
    has_distinct_ids = len(system_ids) == len(vehicles)
    for number, (namespace, vehicle) in enumerate(vehicles, 1):
        if has_distinct_ids:
            yield vehicle
            continue
        repairs = vehicle.repairs
        if len(vehicles) > 1:
            repairs += repair_facts(
                Repair.SYSTEM_NUMBERED, name=namespace or "/", given=vehicle.system, system=number
            )
        yield replace(vehicle, system=number, repairs=repairs)


def _px4_telemetry(
    tables: Mapping[str, TopicColumns], receive_times: ReceiveTimes, source: str
) -> Telemetry | None:
    """Translates the topics that PX4 publishes to ROS 2 to MAVLink messages, by the translation for PX4's own logs.

    That translation assumes a single boot, as in a log of PX4. A recording may have several, with a clock that starts
    anew in each. So all boots are first put on one clock, and separated again after the translation.

    Args:
        tables: PX4's topics by name.
        receive_times: Reception time of each message.
        source: Name of the file, for error messages and the report.

    Returns:
        The vehicle with its messages; None if the topics hold no flight.
    """
    topics, repairs = _on_boot_clock(tables, receive_times, STAMP_UNITS[PX4_BRIDGE])
    # Each topic has one instance, number 0.
    topics_on_one_clock = {
        name: {0: _on_clock_of_all_boots(columns)} for name, columns in topics.items()
    }
    translation = messages_of_topics(topics_on_one_clock, parameters={})
    if not translation.messages:
        return None
    messages = {
        name: _on_clocks_of_boots(columns) for name, columns in translation.messages.items()
    }
    status = topics.get("vehicle_status", {})
    return Telemetry(
        system=_most_frequent_id(status, "system_id", default=0),
        component=_most_frequent_id(status, "component_id", default=AUTOPILOT_COMPONENT),
        vehicle=translation.vehicle,
        autopilot="PX4",
        messages=messages,
        source=source,
        repairs=repairs,
        translated_from=PX4_BRIDGE,
        source_names=translation.topic_names,
    )


def _on_clock_of_all_boots(columns: Columns) -> Columns:
    """Puts the messages of all boots on one clock, ``BOOT_INTERVAL`` seconds apart, in the order of time.

    Args:
        columns: Columns (N,) with ``time``, s since boot, and ``boot``.
    """
    time = columns["time"] + BOOT_INTERVAL * columns["boot"]
    time_order = np.argsort(time, kind="stable")
    return selected_rows({**columns, "time": time}, time_order)


def _on_clocks_of_boots(columns: Columns) -> Columns:
    """Returns messages with their times since boot and their boots: the inverse of :func:`_on_clock_of_all_boots`.

    Args:
        columns: Columns (N,) with ``time``, s, on the clock of all boots.
    """
    boot = (columns["time"] // BOOT_INTERVAL).astype(np.int64)
    return {**columns, "time": columns["time"] - BOOT_INTERVAL * boot, "boot": boot}


def _mavros_telemetry(
    tables: Mapping[str, TopicColumns], receive_times: ReceiveTimes, source: str
) -> Telemetry | None:
    """Translates the topics of MAVROS, the bridge from MAVLink to ROS, back to MAVLink messages.

    The topics do not name the autopilot; its kind follows from the names of flight modes in the topic ``state``.

    Args:
        tables: MAVROS's topics by name, each with columns (N,).
        receive_times: Reception time of each message.
        source: Name of the file, for error messages and the report.

    Returns:
        The vehicle with its messages, times in s since boot; None if no topic gives one.
    """
    topics, repairs = _on_boot_clock(tables, receive_times, STAMP_UNITS[MAVROS])
    modes = tables["state"].columns["mode"] if "state" in tables else ()
    autopilot = mavros_autopilot(Counter(map(str, modes)))
    messages = {}
    for name, columns in topics.items():
        message = MAVROS_TOPICS[name].message
        fields = mavros_message(name, columns, autopilot)
        messages[message] = {"time": columns["time"], "boot": columns["boot"], **fields}
    if not messages:
        return None
    return Telemetry(
        system=0,
        component=AUTOPILOT_COMPONENT,
        vehicle=UNNAMED,
        autopilot=enum_name("MAV_AUTOPILOT", autopilot),
        messages=messages,
        source=source,
        repairs=repairs,
        translated_from=MAVROS,
        source_names={topic.message: name for name, topic in MAVROS_TOPICS.items()},
    )


def _on_boot_clock(
    tables: Mapping[str, TopicColumns], receive_times: ReceiveTimes, stamp_units: Mapping[str, int]
) -> tuple[Tables, Facts]:
    """Puts the topics of one vehicle on its boot clock, the time since the autopilot started.

    Stamps are integers of nanoseconds, and are moved to an origin near the flight before they become floats: floats of
    seconds since 1970 do not resolve a microsecond. Messages without a stamp, or with one before the origin, are left
    out.

    Args:
        tables: The topics by name.
        receive_times: Reception time of each message.
        stamp_units: Fields whose sum is the stamp of a message, and the unit of each, ns.

    Returns:
        The topics' columns with ``time``, s, and ``boot``, without messages whose stamps are missing or wrong; and
        facts that report what was repaired.
    """
    stamps, repairs = _stamps_of_topics(tables, receive_times, stamp_units)
    all_stamps = np.concatenate([*stamps.values(), np.empty(0, dtype=np.int64)])
    origin, origin_repairs = _time_origin(all_stamps[all_stamps > 0])
    repairs += origin_repairs
    is_usable: dict[str, Flags] = {}
    message_stamps = []
    unusable_count = 0
    for name, topic_stamps in stamps.items():
        seconds = (topic_stamps - origin) / NANOSECONDS
        is_usable[name] = (topic_stamps > 0) & (seconds > 0)
        unusable_count += int(np.count_nonzero(~is_usable[name]))
        if is_usable[name].any():
            positions = tables[name].positions[is_usable[name]]
            period = WRAP_PERIODS.get(name, np.inf)
            message_stamps.append(MessageStamps(name, positions, seconds[is_usable[name]], period))
    repairs += repair_facts(
        Repair.LOGGED_MESSAGES_LEFT_OUT, count=unusable_count, flaw=Flaw.NO_STAMP
    )
    boot_times, clock_repairs, _ = boot_clock(message_stamps)
    columns_on_boot_clock = dict[str, Columns]()
    for name, (time, boot) in boot_times.items():
        # A message whose stamp was ignored has the time of the one before, and is left out.
        is_new = np.ones(len(time), dtype=np.bool_)
        is_new[1:] = (np.diff(time) != 0) | (np.diff(boot) != 0)
        rows = np.flatnonzero(is_usable[name])[is_new]
        columns = selected_rows(tables[name].columns, rows)
        columns_on_boot_clock[name] = columns | {"time": time[is_new], "boot": boot[is_new]}
    return columns_on_boot_clock, repairs + clock_repairs


def _stamps_of_topics(
    tables: Mapping[str, TopicColumns], receive_times: ReceiveTimes, stamp_units: Mapping[str, int]
) -> tuple[dict[str, Integers], Facts]:
    """Reads the time stamps of all topics of one vehicle, and undoes settings of its clock during the recording.

    Args:
        tables: The topics by name.
        receive_times: Reception time of each message.
        stamp_units: Fields whose sum is the stamp of a message, and the unit of each, ns.

    Returns:
        The stamps (n,) of each topic, ns, 0 for none; and a fact that reports the settings if there were some.
    """
    stamps: dict[str, Integers] = {}
    for name, table in tables.items():
        summands = [
            _stamps_in_nanoseconds(table.columns[field], unit)
            for field, unit in stamp_units.items()
        ]
        stamps[name] = np.sum(summands, axis=0)
    # Where a counter wraps, it would be taken for a clock that is set. Wraps are undone later.
    stamps_without_wraps = {
        name: values for name, values in stamps.items() if name not in WRAP_PERIODS
    }
    positions = {name: tables[name].positions for name in stamps_without_wraps}
    joined_stamps, repairs = with_joined_clocks(stamps_without_wraps, positions, receive_times)
    return stamps | joined_stamps, repairs


MIN_UNIX_STAMP = 10**9 * SECOND
"""Stamp, ns, from which on stamps are UNIX time: of the year 2001. No autopilot runs for so long."""

MAX_RECORDING = 30 * 86400 * SECOND
"""Distance of a stamp, ns, from the median beyond which it is of no message of the same recording: a month."""


def _time_origin(stamps: Integers) -> tuple[int, Facts]:
    """Finds out whether stamps count from boot or from 1970, and chooses the origin from which time is counted.

    Args:
        stamps: The stamps (N,) of all messages, ns.

    Returns:
        The origin, ns: 0, the boot of the vehicle; or, for UNIX time, a second before the first stamp, which is
        reported as a fact.
    """
    if not len(stamps):
        return 0, ()
    # One of the stamps, not ``np.median``: where half of them are UNIX time, it would be the mean of two unlike stamps.
    middle_row = len(stamps) // 2
    middle_stamp = int(np.partition(stamps, middle_row)[middle_row])
    if middle_stamp < MIN_UNIX_STAMP:
        return 0, ()
    is_of_recording = abs(stamps - middle_stamp) < MAX_RECORDING
    origin_seconds = int(stamps[is_of_recording].min()) // SECOND - 1
    return origin_seconds * SECOND, repair_facts(Repair.UNIX_TIME_MOVED, origin=origin_seconds)


MAX_NANOSECONDS = 9 * 10**18
"""Bound of stamps, ns: 64 bits with a sign do not hold much more."""


def _stamps_in_nanoseconds(values: Array, unit: int) -> Integers:
    """Converts time stamps to integer nanoseconds.

    Nanoseconds since 1970 have 19 digits, of which a float holds only 16. So each number of a stamp, such as its
    seconds and its nanoseconds, is converted to an integer before they are added.

    Args:
        values: (N,) stamps, or numbers of stamps, in multiples of the unit.
        unit: Length of the unit, ns: 10⁹ for seconds.

    Returns:
        (N,) nanoseconds; 0 for a value that is not positive or too large.
    """
    is_possible = (values > 0) & (values < MAX_NANOSECONDS // unit)
    return np.where(is_possible, values, 0.0).astype(np.int64) * unit


def _most_frequent_id(status: Columns, field: str, default: int) -> int:
    """Returns the most frequent MAVLink id, 1 to 255, in a field; a default where there is none."""
    ids = [int(number) for number in status.get(field, ()) if 1 <= number <= 255]
    return max(set(ids), key=ids.count, default=default)
