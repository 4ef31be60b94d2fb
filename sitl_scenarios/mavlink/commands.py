"""Commands: what a ground station asks of a simulated vehicle, and what the vehicle answers.

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
BROADCAST_ID = mavlink_constant("MAV_COMP_ID_ALL")  # Target system or component of messages to all
UNDERSTOOD = frozenset(
    {"COMMAND_LONG", "PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "REQUEST_DATA_STREAM"}
)
"""Messages that are answered; each names its target."""


def addressed_messages(datagram: bytes, system: int, component: int) -> list[Any]:
    """Returns the messages in a datagram, of pymavlink, that are understood and meant for this component, or all."""
    return [
        message
        for message in pymavlink_messages(datagram)
        if message.get_type() in UNDERSTOOD
        and message.target_system in (system, BROADCAST_ID)
        and message.target_component in (component, BROADCAST_ID)
    ]


# What MAV_CMD_COMPONENT_ARM_DISARM's second parameter must be to stop the motors in the air
FORCE = 21196


@dataclass
class CommandHandler:
    """Executes a vehicle's commands, ``accepted`` so many."""

    transmitter: Transmitter
    simulation: Simulation
    accepted: int = 0

    def answer(self, received: Any) -> None:
        """Does what a message asks for; the reply goes out with the transmitter's next block."""
        match received.get_type():
            case "COMMAND_LONG":
                result = self._result(received.command, received.param1, received.param2)
                self.accepted += result == ACCEPTED
                self.transmitter.ask(
                    "COMMAND_ACK",
                    command=received.command,
                    result=result,
                    target_system=received.get_srcSystem(),
                    target_component=received.get_srcComponent(),
                )
            case "PARAM_REQUEST_LIST":
                self.transmitter.tell_parameters()
            case "PARAM_REQUEST_READ":
                self.transmitter.tell_parameters(received.param_id)
            case "REQUEST_DATA_STREAM":
                # The rate, Hz, of a group of messages, or of all groups.
                groups = self.transmitter.autopilot.groups
                group = int(received.req_stream_id)
                rate = int(received.req_message_rate) if received.start_stop else 0
                chosen = list(groups) if group == 0 else [group]
                self._set_intervals(
                    (name for group in chosen for name in groups.get(group, ())),
                    1 / rate if rate else inf,
                )

    def _result(self, command: int, first: float, second: float) -> int:
        """Obeys a command with its first two parameters; returns the MAV_RESULT."""
        obey = OBEYED.get(command)
        if obey is None:
            return UNSUPPORTED
        if not isfinite(first):
            return DENIED
        return obey(self, first, second)

    def _arm(self, arm: float, force: float) -> int:
        if round(arm) not in (0, 1):
            return DENIED
        if self.simulation.set_armed(round(arm) == 1, force == FORCE):
            return ACCEPTED
        return FAILED

    def _set_interval(self, message: float, interval: float) -> int:
        schedule = self.transmitter.schedule
        name = _name(message)
        if name not in schedule.usual or not isfinite(interval):
            return DENIED
        usual = 1 / schedule.usual[name] if schedule.usual[name] else inf
        self._set_intervals([name], inf if interval < 0 else interval / 1e6 or usual)
        return ACCEPTED

    def _set_intervals(self, names: Iterable[str], seconds: float) -> None:
        for name in names:
            self.transmitter.schedule.set(name, seconds, self.transmitter.clock)

    def _tell_interval(self, message: float, _: float) -> int:
        """Says at what interval the message of that id is sent: 0 of one that it does not have, -1 of one at rest."""
        if not 0 <= message < 2**16:
            return DENIED
        schedule = self.transmitter.schedule
        name = _name(message)
        interval = schedule.interval(name) if name in schedule.usual else 0.0
        microseconds = min(round(interval * 1e6), 2**31 - 1) if isfinite(interval) else -1
        self.transmitter.ask("MESSAGE_INTERVAL", message_id=int(message), interval_us=microseconds)
        return ACCEPTED


OBEYED = {
    mavlink_constant("MAV_CMD_COMPONENT_ARM_DISARM"): CommandHandler._arm,
    mavlink_constant("MAV_CMD_GET_MESSAGE_INTERVAL"): CommandHandler._tell_interval,
    mavlink_constant("MAV_CMD_SET_MESSAGE_INTERVAL"): CommandHandler._set_interval,
}
"""What is done by MAV_CMD, with its first two parameters."""


def _name(message: float) -> str:
    """Of the message with this id; empty when there is none."""
    definition = definitions_by_id().get(round(message)) if isfinite(message) else None
    return definition.name if definition else ""
