"""Commands that a ground station sends to a simulated vehicle, and the vehicle's replies.

Sources: https://mavlink.io/en/services/command.html, https://mavlink.io/en/services/parameter.html.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any

from mavdem.ingest.mavlink.definitions import definitions_by_id, pymavlink_messages
from mavdem.ingest.vocabulary import mavlink_constant
from sitl_scenarios.mavlink.transmitter import Transmitter
from sitl_scenarios.simulation import Simulation

ACCEPTED, DENIED, UNSUPPORTED, FAILED = (
    mavlink_constant(f"MAV_RESULT_{name}")
    for name in ("ACCEPTED", "DENIED", "UNSUPPORTED", "FAILED")
)
BROADCAST_ID = mavlink_constant("MAV_COMP_ID_ALL")
"""Target system or component of messages to all."""

HANDLED_MESSAGES = frozenset(
    {"COMMAND_LONG", "PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "REQUEST_DATA_STREAM"}
)
"""Messages that the vehicle handles; each names its target system and component."""


def addressed_messages(datagram: bytes, system: int, component: int) -> list[Any]:
    """Returns the messages in a datagram that the vehicle handles and that are addressed to it or to all.

    Args:
        datagram: Bytes of one datagram.
        system: System id of the vehicle.
        component: Component id of its autopilot.

    Returns:
        Messages of pymavlink.
    """
    return [
        message
        for message in pymavlink_messages(datagram)
        if message.get_type() in HANDLED_MESSAGES
        and message.target_system in (system, BROADCAST_ID)
        and message.target_component in (component, BROADCAST_ID)
    ]


FORCE_DISARM = 21196
"""Second parameter of MAV_CMD_COMPONENT_ARM_DISARM that stops the motors even in the air (common.xml)."""

MAX_INT32 = 2**31 - 1
"""Largest value of MESSAGE_INTERVAL's signed field."""

MESSAGE_IDS = 2**16
"""Number of message ids that MESSAGE_INTERVAL's field can hold."""

MICROSECONDS_PER_SECOND = 1e6
"""Factor from seconds to the microseconds of message intervals."""


@dataclass
class CommandHandler:
    """Executes the commands that a simulated vehicle receives."""

    transmitter: Transmitter
    """Sends the replies, and has the rates of messages."""
    simulation: Simulation
    """The vehicle that is armed and disarmed."""
    accepted: int = 0
    """Number of commands accepted so far."""

    def handle(self, received: Any) -> None:
        """Executes a message of pymavlink; the reply goes out with the transmitter's next block.

        A command is acknowledged with its result. Requests for parameters are answered by their values, and requests
        for data streams change the rates of messages.
        """
        match received.get_type():
            case "COMMAND_LONG":
                result = self._execute(received.command, received.param1, received.param2)
                if result == ACCEPTED:
                    self.accepted += 1
                self.transmitter.send_once(
                    "COMMAND_ACK",
                    command=received.command,
                    result=result,
                    target_system=received.get_srcSystem(),
                    target_component=received.get_srcComponent(),
                )
            case "PARAM_REQUEST_LIST":
                self.transmitter.send_parameters()
            case "PARAM_REQUEST_READ":
                self.transmitter.send_parameters(received.param_id)
            case "REQUEST_DATA_STREAM":
                self._set_stream_rate(received)

    def _set_stream_rate(self, request: Any) -> None:
        """Sets the rate of a group of messages, or with MAV_DATA_STREAM_ALL (0) of all, by REQUEST_DATA_STREAM."""
        groups = self.transmitter.autopilot.groups
        group = int(request.req_stream_id)
        # The rate in Hz.
        rate = int(request.req_message_rate) if request.start_stop else 0
        interval = 1 / rate if rate else inf
        requested_groups = list(groups) if group == 0 else [group]
        for requested_group in requested_groups:
            self._set_intervals(groups.get(requested_group, ()), interval)

    def _execute(self, command: int, first: float, second: float) -> int:
        """Executes a MAV_CMD with its first two parameters; returns the MAV_RESULT."""
        executor = COMMANDS.get(command)
        if executor is None:
            return UNSUPPORTED
        if not isfinite(first):
            return DENIED
        return executor(self, first, second)

    def _arm(self, arm: float, force: float) -> int:
        """Arms (1) or disarms (0) the vehicle, in the air only with ``FORCE_DISARM``; returns the MAV_RESULT."""
        if round(arm) not in (0, 1):
            return DENIED
        if self.simulation.set_armed(round(arm) == 1, force == FORCE_DISARM):
            return ACCEPTED
        return FAILED

    def _set_interval(self, message: float, interval: float) -> int:
        """Sets the interval of a message; returns the MAV_RESULT.

        Args:
            message: Number of the message.
            interval: Interval in µs; 0 sets the usual one, a negative value stops the message.
        """
        schedule = self.transmitter.schedule
        name = _message_name(message)
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
            self.transmitter.schedule.set(name, seconds, self.transmitter.clock)

    def _send_interval(self, message: float, _: float) -> int:
        """Replies with the interval of a message, given by its number; returns the MAV_RESULT.

        The interval is in µs: 0 for a message that the vehicle does not have, -1 for one that it does not send now.
        """
        if not 0 <= message < MESSAGE_IDS:
            return DENIED
        schedule = self.transmitter.schedule
        name = _message_name(message)
        interval = schedule.interval(name) if name in schedule.usual_rates else 0.0
        microseconds = -1
        if isfinite(interval):
            microseconds = min(round(interval * MICROSECONDS_PER_SECOND), MAX_INT32)
        self.transmitter.send_once(
            "MESSAGE_INTERVAL", message_id=int(message), interval_us=microseconds
        )
        return ACCEPTED


COMMANDS = {
    mavlink_constant("MAV_CMD_COMPONENT_ARM_DISARM"): CommandHandler._arm,
    mavlink_constant("MAV_CMD_GET_MESSAGE_INTERVAL"): CommandHandler._send_interval,
    mavlink_constant("MAV_CMD_SET_MESSAGE_INTERVAL"): CommandHandler._set_interval,
}
"""Method that executes each MAV_CMD, given its first two parameters."""


def _message_name(message: float) -> str:
    """Returns the name of the message with this number; empty when there is none."""
    definition = definitions_by_id().get(round(message)) if isfinite(message) else None
    return definition.name if definition else ""
