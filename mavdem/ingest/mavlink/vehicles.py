"""Sorting a MAVLink stream by sender: the messages of each component, and which components are vehicles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.errors import Unreadable
from mavdem.facts import Facts
from mavdem.facts.sources import Flaw, Repair, SourceFact
from mavdem.ingest.byte_rows import Bytes
from mavdem.ingest.mavlink.clock_readings import BootTimes, MessageStamps, Times, stamped_messages
from mavdem.ingest.mavlink.clock_steps import backward_clock_steps, with_steps_undone
from mavdem.ingest.mavlink.clocks import BootClock, boot_clock
from mavdem.ingest.mavlink.dialect import (
    MessageDefinition,
    definitions_by_id,
    definitions_by_name,
    enum_name,
    mavlink_constant,
)
from mavdem.ingest.mavlink.frame_columns import DecodedColumns, FrameColumns
from mavdem.ingest.mavlink.frame_stream import FrameStream, receive_interval
from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES, MESSAGE_UNKNOWN, Frames
from mavdem.ingest.mavlink.payloads import FrameSender, decoded_field, latest_parameters
from mavdem.ingest.mavlink.recording_end import is_ended_on_purpose
from mavdem.ingest.mavlink.reference_clock import reference_type_of
from mavdem.ingest.mavlink.restarts import HeartbeatStates, RestartDelays
from mavdem.ingest.mavlink.sender_streams import SenderStream, sender_stream_of
from mavdem.ingest.motors import MOTOR_MESSAGES
from mavdem.ingest.other_recordings import (
    STREAM_RULES,
    BootTimesInUtc,
    LeftOutBlock,
    StampedMessages,
    blocks_of_other_recordings,
    outside_blocks,
)
from mavdem.ingest.telemetry import (
    MICROSECONDS,
    Columns,
    Component,
    Log,
    Parameters,
    Tables,
    Telemetry,
    UnreadFrames,
    repair_facts,
    rows_by_value,
    selected_rows,
)
from mavdem.ingest.vocabulary import NAMES, RADIO, RADIO_MESSAGES, UNNAMED

NON_VEHICLE_TYPES = frozenset({*NAMES["not_vehicles"], RADIO})
"""MAV_TYPEs of components and ground equipment."""

VEHICLE_MESSAGES = frozenset({"ATTITUDE", "ATTITUDE_QUATERNION", *MOTOR_MESSAGES})
"""A component without a HEARTBEAT is a vehicle if it sent one of these messages."""

BOOT_CLOCK_UNITS = {"time_boot_ms": 1e3, "time_boot_us": 1e6, "time_usec": 1e6}
"""Fields with the boot clock, the more reliable first, and their units per second."""

PARAMETER_STORE_COMPONENT = mavlink_constant("MAV_COMP_ID_MISSIONPLANNER")
"""Component id under which MAVProxy logs the parameters of a system."""

OffsetsByMessage = Mapping[int, NDArray[np.integer]]
"""Offsets (n,) of the frames of each message whose checksum matches, ascending, by message id, ascending."""


@dataclass(frozen=True)
class _ComponentRecord:
    """What one component sent."""

    component: Component
    """Who it is, and how many messages it sent."""
    messages: Tables
    """Its messages on its boot clock."""
    repairs: Facts
    """Facts that report what was repaired of that clock, and copies that were left out."""
    restart_delays: RestartDelays
    """How long it was silent before each restart."""
    has_two_senders: bool
    """Whether two vehicles send under its ids."""


def assemble(stream: FrameStream) -> Log:
    """Sorts the frames of a recording by sender, and decodes the messages of each.

    A sender, or component, is a pair of system id and component id. All components are listed in the log; those that
    are vehicles also become a ``Telemetry`` with messages and parameters. Frames that cannot be decoded are listed as
    ``unread``. Copies of frames, as received over a second link, are left out. Two vehicles that send under the same
    ids are left out too, since it is not known which of them sent a message without a clock.

    Args:
        stream: The frames of a recording.

    Returns:
        The log: all components, and the vehicles among them with their messages.

    Raises:
        Unreadable: The only vehicles are two with the same ids.
    """
    sender_streams, is_no_copy = _streams_of_senders(stream)
    frames = stream.frames
    if not is_no_copy.all():
        frames = frames[is_no_copy]
    sender_ids = _sender_ids(frames)
    frames_of_senders = _matching_frames_by_sender(frames, sender_ids)
    unread = tuple(_unread_frames(frames, sender_ids, frames_of_senders))
    # These take tens of megabytes for a recording of hours.
    del frames, sender_ids, is_no_copy
    records = []
    for sender_id, frames_of_messages in frames_of_senders.items():
        sender_stream = sender_streams[sender_id]
        records.append(_component_record(stream, sender_id, frames_of_messages, sender_stream))
    stream_repairs = _stream_repairs(stream, unread)
    vehicles = []
    shared_ids = []
    for record in records:
        component = record.component
        if not _is_vehicle(component):
            continue
        if record.has_two_senders:
            shared_ids.append(f"{component.system}:{component.component}")
        else:
            vehicles.append(_telemetry_of_component(stream, record, records, stream_repairs))
    if shared_ids and not vehicles:
        raise Unreadable(SourceFact.TWO_VEHICLES_ONE_ID, path=stream.source, names=shared_ids)
    return Log(
        source=stream.source,
        vehicles=tuple(vehicles),
        components=tuple(record.component for record in records),
        unread=unread,
        frames=len(stream.frames),
        bytes_skipped=stream.bytes_skipped,
        receive_time=receive_interval(stream),
    )


def _telemetry_of_component(
    stream: FrameStream,
    vehicle: _ComponentRecord,
    all_components: Sequence[_ComponentRecord],
    stream_repairs: Facts,
) -> Telemetry:
    """Makes the telemetry of a vehicle, which is one of the MAVLink components in a stream.

    Args:
        stream: MAVLink frames of the recording, with their receive stamps.
        vehicle: The component that is the vehicle, with its messages.
        all_components: All components, since another one may have stored the vehicle's parameters.
        stream_repairs: Facts on what was repaired of the stream, which concern all its vehicles.

    Returns:
        Messages and parameters of the vehicle, facts on what was repaired, and whether its recording ended on purpose.
    """
    component = vehicle.component
    sender = FrameSender(component.system, component.component)
    return Telemetry(
        system=component.system,
        component=component.component,
        vehicle=component.kind,
        autopilot=component.autopilot,
        messages=vehicle.messages,
        parameters=_parameters_of(vehicle, all_components),
        source=stream.source,
        repairs=stream_repairs + vehicle.repairs,
        restart_delays=vehicle.restart_delays,
        is_ended_on_purpose=is_ended_on_purpose(stream, sender),
    )


def _stream_repairs(stream: FrameStream, unread: Sequence[UnreadFrames]) -> Facts:
    """Reports what was repaired or left out of a stream, for all its vehicles.

    Args:
        stream: The recording, with facts on what was repaired when its frames were found.
        unread: Numbers of frames that could not be read, by message and sender, with the cause.

    Returns:
        A fact for each cause for which frames were left out, and one for bytes outside frames.
    """
    repairs = stream.repairs
    for cause in (Flaw.DAMAGE, Flaw.ANOTHER_DIALECT):
        count = sum(message.frames for message in unread if message.cause is cause)
        repairs += repair_facts(Repair.FRAMES_LEFT_OUT, count=count, flaw=cause)
    return repairs + repair_facts(
        Repair.BYTES_SKIPPED, count=stream.bytes_skipped, total=len(stream.data), part="frame"
    )


# A sender's system and component id are packed into one number, so that frames can be sorted by sender.

COMPONENT_BITS = 8
"""Number of bits of a component id."""
COMPONENT_MASK = 0xFF
"""The bits of the component id in a packed sender."""
SENDER_BITS = 16
"""Number of bits of a packed sender."""
SENDER_MASK = 0xFFFF
"""Those bits."""


class _StreamsOfSenders(NamedTuple):
    """Losses and copies among the N frames of a recording, for each sender and for each frame."""

    by_sender: dict[int, SenderStream]
    """The losses and copies of each sender, by system id << 8 | component id."""
    is_no_copy: NDArray[np.bool_]
    """(N,) whether each frame is no copy of an earlier one, as one received over a second link is."""


def _streams_of_senders(stream: FrameStream) -> _StreamsOfSenders:
    """Counts lost messages and finds copies among the frames of each sender, such as those of a second radio link.

    Frames are grouped by sender first, since each sender numbers its own messages.

    Args:
        stream: The frames (N,) of a recording.
    """
    sender_streams = {}
    is_no_copy = np.ones(len(stream.frames), dtype=np.bool_)
    for sender_id, rows in rows_by_value(_sender_ids(stream.frames)).items():
        sender_stream = sender_stream_of(stream.data, stream.frames, rows)
        sender_streams[sender_id] = sender_stream
        if sender_stream.copies:
            is_no_copy[rows] = sender_stream.is_no_copy
    return _StreamsOfSenders(sender_streams, is_no_copy)


def _sender_ids(frames: Frames) -> NDArray[np.uint16]:
    """Packs system and component id of each frame (N,) into ``system << 8 | component``."""
    return (frames.system.astype(np.uint16) << COMPONENT_BITS | frames.component).astype(np.uint16)


def _matching_frames_by_sender(
    frames: Frames, sender_ids: NDArray[np.uint16]
) -> dict[int, OffsetsByMessage]:
    """Groups the frames with a matching checksum by sender, and the frames of each sender by message.

    Args:
        frames: Frames (N,) in stream order.
        sender_ids: Sender (N,) of each: system id << 8 | component id.

    Returns:
        For each sender, ascending, a mapping of message id to the offsets (n,) of its frames in the stream.
    """
    frames_of_senders: dict[int, OffsetsByMessage] = {}
    for sender_id, rows in rows_by_value(sender_ids).items():
        is_matching = frames.checksum[rows] == CHECKSUM_MATCHES
        matching_rows = rows[is_matching]
        if not len(matching_rows):
            continue
        starts = frames.start[matching_rows]
        starts_by_message = {}
        rows_of_messages = rows_by_value(frames.message_id[matching_rows])
        for message_id, message_rows in rows_of_messages.items():
            starts_by_message[message_id] = starts[message_rows]
        frames_of_senders[sender_id] = starts_by_message
    return frames_of_senders


MIN_FOREIGN_FRAMES = 3
"""Number of frames of a message, all with failed checksums, that make it another dialect's; fewer may be damaged."""


def _unread_frames(
    frames: Frames,
    sender_ids: NDArray[np.uint16],
    frames_of_senders: Mapping[int, OffsetsByMessage],
) -> Iterator[UnreadFrames]:
    """Counts the frames that cannot be read, by message and sender, and finds out why.

    The dialect is the set of message definitions that is used here. A frame cannot be read for one of two reasons: it
    was damaged, or its sender uses another dialect. They are distinguished like this:

    - The message is not in the dialect. If its sender sent readable frames too, the sender is real, and the message is
      another dialect's; otherwise the frame is damaged, and the ids in it are wrong.
    - The message is in the dialect, but checksums do not match. If all of its frames from this sender fail, at least
      ``MIN_FOREIGN_FRAMES``, the sender has another definition of it; otherwise single frames are damaged.

    Args:
        frames: Frames (N,) in stream order.
        sender_ids: Sender (N,) of each: system id << 8 | component id.
        frames_of_senders: Offsets of the frames that can be read, by sender and message id.

    Yields:
        The number of unread frames of each message and sender, with the cause.
    """
    is_unreadable = frames.checksum != CHECKSUM_MATCHES
    checksums = frames.checksum[is_unreadable]
    # One key per message and sender. An unknown message is unknown in each of its frames, so that the first frame of a
    # key shows it.
    message_ids = frames.message_id[is_unreadable].astype(np.int64)
    keys = message_ids << SENDER_BITS | sender_ids[is_unreadable]
    for key, rows_of_key in rows_by_value(keys).items():
        message_id = key >> SENDER_BITS
        sender_id = key & SENDER_MASK
        readable_offsets = frames_of_senders.get(sender_id, {}).get(message_id, ())
        frame_count = len(rows_of_key) + len(readable_offsets)
        if checksums[rows_of_key[0]] == MESSAGE_UNKNOWN:
            is_foreign = sender_id in frames_of_senders
        else:
            is_foreign = len(rows_of_key) == frame_count >= MIN_FOREIGN_FRAMES
        yield UnreadFrames(
            message_id,
            system=sender_id >> COMPONENT_BITS,
            component=sender_id & COMPONENT_MASK,
            frames=len(rows_of_key),
            total=frame_count,
            cause=Flaw.ANOTHER_DIALECT if is_foreign else Flaw.DAMAGE,
        )


def _component_record(
    stream: FrameStream,
    sender_id: int,
    frames_of_messages: OffsetsByMessage,
    sender_stream: SenderStream,
) -> _ComponentRecord:
    """Decodes all messages of one component, and finds out what it is and how many messages were lost.

    What it is follows from its HEARTBEATs. A component that sent only the messages that telemetry radios insert is a
    radio.

    Args:
        stream: MAVLink frames of the recording, with their receive stamps.
        sender_id: The sender: system id << 8 | component id.
        frames_of_messages: Offsets of its readable frames by message id.
        sender_stream: Links over which its frames came, copies and losses.

    Returns:
        The component, its messages by name, and facts that report what was repaired.
    """
    # A message that only the slower of two links delivered arrived after later messages.
    messages, clock = _messages_on_boot_clock(
        stream, frames_of_messages, is_in_order=not sender_stream.copies
    )
    vehicle_type, autopilot = UNNAMED, UNNAMED
    if "HEARTBEAT" in messages:
        vehicle_type, autopilot = vehicle_identity(messages["HEARTBEAT"])
    counts = {name: len(columns["time"]) for name, columns in messages.items()}
    if counts and RADIO_MESSAGES.issuperset(counts):
        vehicle_type = RADIO
    component = Component(
        sender_id >> COMPONENT_BITS,
        sender_id & COMPONENT_MASK,
        vehicle_type,
        autopilot,
        messages=counts,
        lost=sender_stream.lost,
    )
    repairs = repair_facts(
        Repair.COPIES_LEFT_OUT,
        count=sender_stream.copies,
        delay=sender_stream.longest_delay,
        name=f"{component.system}:{component.component}",
    )
    return _ComponentRecord(
        component,
        messages,
        repairs + clock.repairs,
        restart_delays=clock.delays,
        has_two_senders=sender_stream.has_two_senders,
    )


def _is_vehicle(component: Component) -> bool:
    """Returns whether a component is a vehicle: by its HEARTBEAT, or without any by the messages that it sent.

    One that sent nothing but HEARTBEATs is not a vehicle here: nothing of its motion can be read.

    Args:
        component: The component, with its type by its HEARTBEATs and its messages.
    """
    if component.kind == UNNAMED:
        return not VEHICLE_MESSAGES.isdisjoint(component.messages)
    return component.kind not in NON_VEHICLE_TYPES and set(component.messages) != {"HEARTBEAT"}


def _parameters_of(vehicle: _ComponentRecord, records: Sequence[_ComponentRecord]) -> Parameters:
    """Returns a vehicle's parameters: those that it sent, and those that MAVProxy stored for its system.

    MAVProxy writes the parameters that it has received into its logs under a special component id. They may be older
    than the vehicle's, which take precedence.

    Args:
        vehicle: The vehicle, as one of the components.
        records: All components of the recording.

    Returns:
        Values by the name of the parameter.
    """
    parameters: dict[str, float] = {}
    sources = [
        record
        for record in records
        if record.component.system == vehicle.component.system
        and record.component.component == PARAMETER_STORE_COMPONENT
    ]
    # Later values overwrite earlier ones, so the vehicle is last.
    for record in (*sources, vehicle):
        if "PARAM_VALUE" in record.messages:
            autopilot = vehicle.component.autopilot
            reports = parameter_reports(record.messages, autopilot)
            parameters |= latest_parameters(reports, autopilot)
    return parameters


def parameter_reports(messages: Mapping[str, Columns], autopilot: str) -> Columns:
    """Returns the reports of parameters from the boots in which a component had a certain autopilot.

    Vehicles with different autopilots may have had the same ids in different boots of a recording.

    Args:
        messages: Messages of the component, with PARAM_VALUE among them.
        autopilot: MAV_AUTOPILOT without its prefix.

    Returns:
        Columns of PARAM_VALUE. Boots without a HEARTBEAT are taken for boots of this autopilot.
    """
    reports = messages["PARAM_VALUE"]
    heartbeats = messages.get("HEARTBEAT")
    if heartbeats is None or (heartbeats["autopilot"] == heartbeats["autopilot"][0]).all():
        return reports
    boots_of_others = []
    for boot in np.unique(heartbeats["boot"]).tolist():
        heartbeats_of_boot = selected_rows(heartbeats, heartbeats["boot"] == boot)
        if vehicle_identity(heartbeats_of_boot).autopilot != autopilot:
            boots_of_others.append(boot)
    return selected_rows(reports, ~np.isin(reports["boot"], boots_of_others))


GENERIC_WEIGHT = 0.1
"""Weight of a HEARTBEAT of type GENERIC among all of a component: scripts send such under any id."""


class VehicleIdentity(NamedTuple):
    """What a component declares itself to be."""

    vehicle_type: str
    """MAV_TYPE without its prefix."""

    autopilot: str
    """MAV_AUTOPILOT without its prefix."""


def vehicle_identity(heartbeats: Columns) -> VehicleIdentity:
    """Finds out what a component is, by the majority of its HEARTBEATs.

    They may disagree: frames are damaged, and scripts send HEARTBEATs under the ids of a vehicle. Those are mostly of
    type GENERIC, whose votes therefore weigh less.

    Args:
        heartbeats: Columns of HEARTBEAT, at least one row.

    Returns:
        The MAV_TYPE of most HEARTBEATs, and the MAV_AUTOPILOT of most of these, without their prefixes.
    """
    votes = np.bincount(heartbeats["type"]).astype(np.float64)
    votes[mavlink_constant("MAV_TYPE_GENERIC")] *= GENERIC_WEIGHT
    mav_type = int(votes.argmax())
    autopilots = heartbeats["autopilot"][heartbeats["type"] == mav_type]
    autopilot = int(np.bincount(autopilots).argmax())
    return VehicleIdentity(enum_name("MAV_TYPE", mav_type), enum_name("MAV_AUTOPILOT", autopilot))


def _messages_on_boot_clock(
    stream: FrameStream, frames_of_messages: OffsetsByMessage, *, is_in_order: bool
) -> tuple[Tables, BootClock]:
    """Puts the frames (packed messages) of one component on its boot clock, the time since its autopilot started.

    Of their fields only time stamps, and the states in HEARTBEATs, are decoded here.

    Args:
        stream: MAVLink frames of the recording, with their receive stamps.
        frames_of_messages: Offsets of the component's readable frames by message id.
        is_in_order: Whether the frames of each message are in the order in which they were sent. Otherwise they are
            sorted by boot and time; messages of the same time keep their order.

    Returns:
        Columns by name of the message; and the clock, with facts that report all that was repaired of it.
    """
    definitions = definitions_by_id()
    all_stamps = []
    for message_id, frame_offsets in frames_of_messages.items():
        all_stamps.append(_message_stamps(stream.data, definitions[message_id], frame_offsets))
    receive_times = partial(_receive_times, stream)
    steps = backward_clock_steps(all_stamps, stream.frames, receive_times)
    all_stamps = [with_steps_undone(stamps, steps) for stamps in all_stamps]
    all_stamps, repairs = _without_other_recordings(stream, all_stamps)
    for step in steps:
        repairs += repair_facts(Repair.CLOCK_SET_BACK, time=step.time_before, duration=step.seconds)
    clock = boot_clock(all_stamps, receive_times, _heartbeat_states(stream.data, all_stamps))
    tables = {}
    decoded_columns = DecodedColumns(stream.data)
    # The stamps of one message, such as ATTITUDE, after the other.
    for stamps in all_stamps:
        times = clock.times[stamps.message]
        frame_offsets = stamps.positions
        if not is_in_order:
            order = np.lexsort((times.time, times.boot))
            frame_offsets = frame_offsets[order]
            times = BootTimes(times.time[order], times.boot[order])
        definition = definitions_by_name()[stamps.message]
        tables[stamps.message] = FrameColumns(
            stream.data, frame_offsets, definition, times, decoded_columns
        )
    return tables, clock._replace(repairs=repairs + clock.repairs)


def _heartbeat_states(
    data: Bytes, message_types: Sequence[MessageStamps]
) -> HeartbeatStates | None:
    """Returns the HEARTBEATs among the messages of a component, with the states that they report; None without any.

    Args:
        data: Bytes (B,) of the recording.
        message_types: The component's messages by type.
    """
    for message_type in message_types:
        if message_type.message == "HEARTBEAT":
            starts = message_type.positions
            definition = definitions_by_name()["HEARTBEAT"]
            states = decoded_field(data, starts, definition, "system_status")
            return HeartbeatStates(starts, states)
    return None


def _without_other_recordings(
    stream: FrameStream, message_stamps: list[MessageStamps]
) -> tuple[list[MessageStamps], Facts]:
    """Leaves out the messages of one component that belong to another recording, such as an earlier flight.

    Args:
        stream: MAVLink frames of the recording, with their receive stamps.
        message_stamps: The component's messages by type, with the stamps of their fields.

    Returns:
        The messages outside the blocks of other recordings, and a fact that reports what was left out.
    """
    blocks = _blocks_of_other_recordings(stream, message_stamps)
    if not blocks:
        return message_stamps, ()
    stamps_outside_blocks = []
    left_out_count = 0
    for stamps in message_stamps:
        is_outside = outside_blocks(blocks, stamps.positions)
        left_out_count += int(np.count_nonzero(~is_outside))
        if is_outside.any():
            stamps_outside_blocks.append(_selected_stamps(stamps, is_outside))
    duration = sum(block.duration for block in blocks)
    repairs = repair_facts(Repair.OTHER_CLOCK_LEFT_OUT, count=left_out_count, duration=duration)
    return stamps_outside_blocks, repairs


def _selected_stamps(message_type: MessageStamps, is_selected: NDArray[np.bool_]) -> MessageStamps:
    """Returns some of the messages of a type, with their stamps; flags (n,) select them."""
    stamps = message_type.decoded_stamps()
    selected_stamps = None if stamps is None else stamps[is_selected]
    positions = message_type.positions[is_selected]
    return message_type._replace(positions=positions, stamps=selected_stamps)


def _blocks_of_other_recordings(
    stream: FrameStream, message_stamps: Sequence[MessageStamps]
) -> list[LeftOutBlock]:
    """Finds the blocks of a component's stream whose messages do not follow its boot clock.

    They are of another sender, or of an older recording. Only one message type is examined, the reference, by its
    stamps. Where its clock goes back, the autopilot has rebooted only if the clock begins near zero, or if by the
    reception times it started again after the messages before; otherwise the messages are of another recording.

    Args:
        stream: MAVLink frames of the recording, with their receive stamps.
        message_stamps: The component's messages by type, with their stamps.

    Returns:
        The blocks to leave out, in the order of the stream.
    """
    reference = reference_type_of(message_stamps)
    if reference is None:
        return []
    positions, seconds = stamped_messages(reference)
    goes_back = np.diff(seconds) < -STREAM_RULES.max_fall
    if not goes_back.any():
        return []
    receive_time = _receive_times(stream, positions)
    has_receive_time = ~np.isnan(receive_time)
    # By the clock of the receiver, the boot clock read 0 at this UTC. It changes when the autopilot reboots.
    utc_at_boot = receive_time - seconds
    # The definitions of messages, with which a DataFlash log begins, are not in a stream.
    log_starts = np.zeros(0, dtype=np.int64)
    return blocks_of_other_recordings(
        StampedMessages(positions, seconds),
        log_starts,
        BootTimesInUtc(positions[has_receive_time], utc_at_boot[has_receive_time]),
        STREAM_RULES,
    )


def _receive_times(stream: FrameStream, starts: NDArray[np.integer]) -> NDArray[np.float64]:
    """Returns when frames were received, UNIX s (n,), NaN where that was not recorded.

    Args:
        stream: MAVLink frames of the recording, with their receive stamps.
        starts: Offset (n,) of each frame in the recording.
    """
    rows = np.searchsorted(stream.frames.start, starts)
    seconds = stream.receive_stamps(rows).astype(np.float64) / MICROSECONDS
    return np.where(seconds > 0, seconds, np.nan)


def _message_stamps(
    data: Bytes, definition: MessageDefinition, starts: NDArray[np.integer]
) -> MessageStamps:
    """Returns the stamps in the messages of one type, s, if the type has a field with the boot clock.

    Args:
        data: Bytes (B,) of the recording.
        definition: MAVLink's definition of the message: names, types and order of its fields.
        starts: Offset (n,) of each frame in the recording.

    Returns:
        The stamps, which are decoded only when they are used, and the time after which their counter wraps.
    """
    for name, units_per_second in BOOT_CLOCK_UNITS.items():
        if name not in definition.fields:
            continue
        # A counter of 32 bits wraps in the course of a flight, one of 64 bits never does.
        counter_bits = 8 * definition.payload_type[name].itemsize
        period = np.inf if counter_bits == 64 else 2.0**counter_bits / units_per_second
        decode_stamps = partial(_decoded_stamps, data, definition, starts, name)
        return MessageStamps(definition.name, starts, decode_stamps, period)
    return MessageStamps(definition.name, starts)


def _decoded_stamps(
    data: Bytes, definition: MessageDefinition, starts: NDArray[np.integer], name: str
) -> Times:
    """Decodes the stamps (n,) of messages, s, from the field of that name; other arguments as ``_message_stamps``."""
    return decoded_field(data, starts, definition, name) / BOOT_CLOCK_UNITS[name]
