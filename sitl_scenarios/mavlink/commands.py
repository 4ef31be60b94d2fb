"""MAVLink commands and requests of a ground station to a simulated vehicle, and the vehicle's replies.

Sources: the services of https://mavlink.io/en/services/: command, parameter, mission, timesync; logs by common.xml.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any, NamedTuple

from mavdem.ingest.mavlink.dialect import definitions_by_id, mavlink_constant
from mavdem.ingest.mavlink.frame_reader import FrameReader
from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES
from mavdem.ingest.mavlink.payloads import FrameSender, field_values
from sitl_scenarios.flight_simulation import Simulation
from sitl_scenarios.mavlink.transmitter import Transmitter

ACCEPTED, DENIED, UNSUPPORTED, FAILED = (
    mavlink_constant(f"MAV_RESULT_{name}")
    for name in ("ACCEPTED", "DENIED", "UNSUPPORTED", "FAILED")
)
BROADCAST_ID = mavlink_constant("MAV_COMP_ID_ALL")
"""Target system or component of messages to all."""

HANDLED_MESSAGES = frozenset(
    {
        "COMMAND_LONG",
        "LOG_REQUEST_LIST",
        "MISSION_CLEAR_ALL",
        "MISSION_COUNT",
        "MISSION_REQUEST",
        "MISSION_REQUEST_INT",
        "MISSION_REQUEST_LIST",
        "PARAM_REQUEST_LIST",
        "PARAM_REQUEST_READ",
        "PARAM_SET",
        "REQUEST_DATA_STREAM",
        "TIMESYNC",
    }
)
"""Messages that the vehicle handles."""


class ReceivedMessage(NamedTuple):
    """A message that the vehicle received."""

    name: str
    """Name of the message."""
    sender: FrameSender
    """Who sent it."""
    fields: Mapping[str, Any]
    """Values of its fields by name."""


def addressed_messages(datagram: bytes, system: int, component: int) -> list[ReceivedMessage]:
    """Decodes the messages in a datagram that the vehicle handles and that are addressed to it or to all.

    Args:
        datagram: Bytes of one datagram.
        system: System id of the vehicle.
        component: Component id of its autopilot.

    Returns:
        The messages with their senders, in the order of the datagram.
    """
    messages = []
    for frame in FrameReader().feed(datagram):
        definition = definitions_by_id().get(frame.message_id)
        if frame.checksum != CHECKSUM_MATCHES or definition is None:
            continue
        if definition.name not in HANDLED_MESSAGES:
            continue
        fields = field_values(frame.payload, definition)
        # TIMESYNC of older senders names no target: it is meant for all.
        is_addressed = fields.get("target_system", BROADCAST_ID) in (system, BROADCAST_ID) and (
            fields.get("target_component", BROADCAST_ID) in (component, BROADCAST_ID)
        )
        if is_addressed:
            sender = FrameSender(frame.system, frame.component)
            messages.append(ReceivedMessage(definition.name, sender, fields))
    return messages


FORCE_DISARM = 21196
"""Second parameter of MAV_CMD_COMPONENT_ARM_DISARM that stops the motors even in the air (common.xml)."""

ALL_STREAMS = 0
"""MAV_DATA_STREAM_ALL: the group of all messages in REQUEST_DATA_STREAM."""

MAX_INT32 = 2**31 - 1
"""Largest value of MESSAGE_INTERVAL's signed field."""

MESSAGE_IDS = 2**16
"""Number of message ids that MESSAGE_INTERVAL's field can hold."""

MICROSECONDS_PER_SECOND = 1e6
"""Factor from seconds to the microseconds of message intervals."""

NANOSECONDS_PER_SECOND = 1e9
"""Factor from seconds to the nanoseconds of TIMESYNC."""

MISSION_ACCEPTED, MISSION_UNSUPPORTED, MISSION_INVALID_ITEM = (
    mavlink_constant(f"MAV_MISSION_{name}")
    for name in ("ACCEPTED", "UNSUPPORTED", "INVALID_SEQUENCE")
)


@dataclass
class CommandHandler:
    """Executes the commands that a simulated vehicle receives."""

    transmitter: Transmitter
    """Sends the replies, and has the rates of messages."""
    simulation: Simulation
    """The vehicle that is armed and disarmed."""
    accepted: int = 0
    """Number of commands accepted so far."""

    def handle(self, received: ReceivedMessage) -> None:
        """Executes a message from a ground station; the reply is sent with the transmitter's next block.

        A command is acknowledged with its result. A request for parameters, and one to set a parameter, is answered by
        the values; a request for data streams changes the rates of messages. The vehicle flies its scenario: it has no
        mission and accepts none, and it has no logs.

        Args:
            received: Message that is addressed to the vehicle. It is ignored if it is none of ``HANDLED_MESSAGES``.
        """
        fields = received.fields
        match received.name:
            case "COMMAND_LONG":
                result = self._execute(fields["command"], fields["param1"], fields["param2"])
                if result == ACCEPTED:
                    self.accepted += 1
                self.transmitter.send_once(
                    "COMMAND_ACK",
                    command=fields["command"],
                    result=result,
                    target_system=received.sender.system,
                    target_component=received.sender.component,
                )
            case "PARAM_REQUEST_LIST":
                self.transmitter.send_parameters()
            case "PARAM_REQUEST_READ":
                self.transmitter.send_parameters(fields["param_id"])
            case "PARAM_SET":
                self._set_parameter(received)
            case "REQUEST_DATA_STREAM":
                self._set_stream_rate(received)
            case "MISSION_REQUEST_LIST":
                self._answer_on_mission("MISSION_COUNT", received, count=0)
            case "MISSION_REQUEST" | "MISSION_REQUEST_INT":
                self._answer_on_mission("MISSION_ACK", received, type=MISSION_INVALID_ITEM)
            case "MISSION_COUNT":
                self._answer_on_mission("MISSION_ACK", received, type=MISSION_UNSUPPORTED)
            case "MISSION_CLEAR_ALL":
                self._answer_on_mission("MISSION_ACK", received, type=MISSION_ACCEPTED)
            case "LOG_REQUEST_LIST":
                # One entry with a number of 0 logs ends the list.
                self.transmitter.send_once("LOG_ENTRY")
            case "TIMESYNC" if fields["tc1"] == 0:
                # A request has tc1 = 0 and the sender's time in ts1, which the reply returns.
                now = round(self.transmitter.clock * NANOSECONDS_PER_SECOND)
                self.transmitter.send_once("TIMESYNC", tc1=now, ts1=fields["ts1"])

    def _answer_on_mission(self, name: str, request: ReceivedMessage, **values: int) -> None:
        """Replies to a request of the mission service.

        Args:
            name: Name of the message that is the reply.
            request: Message of the service; the reply is for its sender and its type of mission.
            values: Further fields of the reply.
        """
        self.transmitter.send_once(
            name,
            target_system=request.sender.system,
            target_component=request.sender.component,
            mission_type=request.fields["mission_type"],
            **values,
        )

    def _set_parameter(self, request: ReceivedMessage) -> None:
        """Sets a parameter, and replies with the value that it has then; an unknown name gets no reply.

        Parameters of the controller act at once. Others keep their values, and the reply has the value that was kept.

        Args:
            request: A PARAM_SET.
        """
        names = [parameter.name for parameter in self.transmitter.parameters]
        if request.fields["param_id"] not in names:
            return
        parameter = self.transmitter.parameters[names.index(request.fields["param_id"])]
        value = parameter.value_of_float32(
            request.fields["param_value"], bitwise=self.transmitter.autopilot.bitwise
        )
        if self.simulation.set_parameter(parameter.name, value):
            self.transmitter.change_parameter(parameter.name, value)
        self.transmitter.send_parameters(parameter.name)

    def _set_stream_rate(self, request: ReceivedMessage) -> None:
        """Sets the rate of a group of messages, or of all groups, as the request REQUEST_DATA_STREAM demands.

        An unknown group is ignored, as is every group of an autopilot that does not obey the request.

        Args:
            request: A REQUEST_DATA_STREAM.
        """
        # The rate is in Hz. A request with start_stop 0, or with the rate 0, stops the messages.
        rate = int(request.fields["req_message_rate"])
        interval = inf
        if request.fields["start_stop"] and rate:
            interval = 1 / rate
        groups = self.transmitter.autopilot.groups
        requested_group = int(request.fields["req_stream_id"])
        requested_groups = [requested_group]
        if requested_group == ALL_STREAMS:
            requested_groups = list(groups)
        for group in requested_groups:
            self._set_intervals(groups.get(group, ()), interval)

    def _execute(self, command: int, first: float, second: float) -> int:
        """Executes a command.

        Args:
            command: Number of the MAV_CMD.
            first: First parameter of the command; a value that is not finite is denied.
            second: Second parameter of the command. What both parameters mean depends on the command.

        Returns:
            MAV_RESULT that acknowledges it.
        """
        executor = COMMANDS.get(command)
        if executor is None:
            return UNSUPPORTED
        if not isfinite(first):
            return DENIED
        return executor(self, first, second)

    def _arm(self, arm: float, force: float) -> int:
        """Executes MAV_CMD_COMPONENT_ARM_DISARM.

        Args:
            arm: 1 to arm, 0 to disarm.
            force: ``FORCE_DISARM`` to disarm in the air, too; any other value does not.

        Returns:
            MAV_RESULT: denied for another value of ``arm``, failed where the vehicle refuses.
        """
        if round(arm) not in (0, 1):
            return DENIED
        if self.simulation.set_armed(round(arm) == 1, force == FORCE_DISARM):
            return ACCEPTED
        return FAILED

    def _set_interval(self, message_id: float, interval: float) -> int:
        """Executes MAV_CMD_SET_MESSAGE_INTERVAL.

        Args:
            message_id: Id of the message.
            interval: Interval in µs; 0 sets the usual one, a negative value stops the message.

        Returns:
            MAV_RESULT: denied for a message that the vehicle does not have.
        """
        schedule = self.transmitter.schedule
        name = _message_name(message_id)
        if name not in schedule.usual_rates or not isfinite(interval):
            return DENIED
        if interval < 0:
            seconds = inf
        elif interval > 0:
            seconds = interval / MICROSECONDS_PER_SECOND
        else:
            usual_rate = schedule.usual_rates[name]
            seconds = 1 / usual_rate if usual_rate else inf
        self._set_intervals([name], seconds)
        return ACCEPTED

    def _set_intervals(self, names: Iterable[str], seconds: float) -> None:
        """Sends messages every so many ``seconds`` from now on; never, where that is infinite."""
        for name in names:
            self.transmitter.schedule.set_interval(name, seconds, self.transmitter.clock)

    def _send_interval(self, message_id: float, _: float) -> int:
        """Executes MAV_CMD_GET_MESSAGE_INTERVAL: replies with MESSAGE_INTERVAL.

        The interval in the reply is in µs: 0 for a message that the vehicle does not have, -1 for one that it does not
        send now (common.xml).

        Args:
            message_id: Id of the message.
            _: The second parameter, which this command does not use.

        Returns:
            MAV_RESULT: denied for a number that the reply cannot hold.
        """
        if not 0 <= message_id < MESSAGE_IDS:
            return DENIED
        schedule = self.transmitter.schedule
        name = _message_name(message_id)
        interval = schedule.interval(name) if name in schedule.usual_rates else 0.0
        # The interval of a message that is not sent is infinite.
        microseconds = -1
        if isfinite(interval):
            microseconds = min(round(interval * MICROSECONDS_PER_SECOND), MAX_INT32)
        self.transmitter.send_once(
            "MESSAGE_INTERVAL", message_id=int(message_id), interval_us=microseconds
        )
        return ACCEPTED

    def _send_message(self, message_id: float, _: float) -> int:
        """Executes MAV_CMD_REQUEST_MESSAGE: sends a message once, in the next cycle of the autopilot.

        The vehicle has AUTOPILOT_VERSION, and the messages that it can send at regular intervals.

        Args:
            message_id: Id of the message, the first parameter of the command.
            _: The second parameter, which the vehicle does not use.

        Returns:
            MAV_RESULT: denied for a message that the vehicle does not have.
        """
        name = _message_name(message_id)
        if name == "AUTOPILOT_VERSION":
            # It is sent as if it was requested by the command for that message, whose first parameter is 1.
            return self._send_version(1.0, 0.0)
        if name not in self.transmitter.schedule.usual_rates:
            return DENIED
        self.transmitter.schedule.send_next(name, self.transmitter.clock)
        return ACCEPTED

    def _send_version(self, is_wanted: float, _: float) -> int:
        """Executes MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: replies with AUTOPILOT_VERSION.

        The version is 0: the simulated vehicle is no version of the autopilot that it resembles.

        Args:
            is_wanted: The first parameter: 1 to get the reply.
            _: The second parameter, which this command does not use.

        Returns:
            MAV_RESULT: denied for another value of ``is_wanted``.
        """
        if round(is_wanted) != 1:
            return DENIED
        encoding = "BYTEWISE" if self.transmitter.autopilot.bitwise else "C_CAST"
        capabilities = 0
        for capability in (f"PARAM_ENCODE_{encoding}", "MISSION_INT", "MAVLINK2"):
            capabilities |= mavlink_constant(f"MAV_PROTOCOL_CAPABILITY_{capability}")
        self.transmitter.send_once("AUTOPILOT_VERSION", capabilities=capabilities)
        return ACCEPTED


COMMANDS = {
    mavlink_constant("MAV_CMD_COMPONENT_ARM_DISARM"): CommandHandler._arm,
    mavlink_constant("MAV_CMD_GET_MESSAGE_INTERVAL"): CommandHandler._send_interval,
    mavlink_constant("MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES"): CommandHandler._send_version,
    mavlink_constant("MAV_CMD_REQUEST_MESSAGE"): CommandHandler._send_message,
    mavlink_constant("MAV_CMD_SET_MESSAGE_INTERVAL"): CommandHandler._set_interval,
}
"""Method that executes each MAV_CMD, given its first two parameters."""


def _message_name(message_id: float) -> str:
    """Returns the name of the message with this id, a parameter of a command; empty when there is none."""
    definition = definitions_by_id().get(round(message_id)) if isfinite(message_id) else None
    return definition.name if definition else ""
