"""Commands: what the vehicle does when a ground station asks, and what it answers.

Sources: https://mavlink.io/en/services/command.html, https://mavlink.io/en/services/parameter.html,
https://mavlink.io/en/services/mission.html; where the autopilots differ, ``sitl_scenarios.mavlink.autopilots``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from math import inf, isfinite
from typing import Any, Protocol

from mavdem.ingest.decode import definitions
from sitl_scenarios.mavlink.autopilots import CRITICAL, DENIED, FAILED
from sitl_scenarios.mavlink.hearing import Heard
from sitl_scenarios.mavlink.transmitter import Transmitter

ACCEPTED, UNSUPPORTED = 0, 3
"""MAV_RESULT."""
ARM_DISARM, GET_INTERVAL, SET_INTERVAL, REQUEST_MESSAGE, REQUEST_CAPABILITIES = 400, 510, 511, 512, 520
"""MAV_CMD_COMPONENT_ARM_DISARM, _GET_MESSAGE_INTERVAL, _SET_MESSAGE_INTERVAL, _REQUEST_MESSAGE and
_REQUEST_AUTOPILOT_CAPABILITIES."""
FORCE = 21196
"""What MAV_CMD_COMPONENT_ARM_DISARM's second parameter must be to stop the motors in the air."""
ALL_STREAMS = 0
"""MAV_DATA_STREAM."""
MOST_TOLD = 20
"""Changes of rates that are told: some ground stations ask again and again."""
LONGEST_INTERVAL = 2**31 - 1
"""µs that MESSAGE_INTERVAL can tell."""


class Armable(Protocol):
    """What of a simulation a command can change."""

    def set_armed(self, armed: bool, force: bool = False) -> bool:
        """Arms or disarms at once, in the air if that is forced; answers whether it is as asked for."""


class Commands:
    """Answers the ground stations of one vehicle.

    Attributes:
        accepted: how many commands were.
    """

    def __init__(
        self, transmitter: Transmitter, simulation: Armable, tell: Callable[[str], None] = lambda _: None
    ) -> None:
        """Takes who answers, what is armed and disarmed, and who is told a sentence when rates are changed."""
        self._transmitter, self._simulation, self._tell = transmitter, simulation, tell
        self._told = 0
        self.accepted = 0

    def answer(self, said: Heard) -> None:
        """Does what a message asks for; the answer goes out with the transmitter's next block."""
        whom = {"target_system": said.system, "target_component": said.component}
        match said.name:
            case "COMMAND_LONG" | "COMMAND_INT":
                command = int(said.fields["command"])
                result = self._result(command, float(said.fields["param1"]), float(said.fields["param2"]))
                self.accepted += result == ACCEPTED
                self._transmitter.ask("COMMAND_ACK", command=command, result=result, **whom)
            case "PARAM_REQUEST_LIST":
                self._transmitter.tell_parameters()
            case "PARAM_REQUEST_READ":
                self._read_parameter(said.fields)
            case "PARAM_SET":
                self._set_parameter(said.fields)
            case "REQUEST_DATA_STREAM":
                self._request_streams(said.fields)
            case "MISSION_REQUEST_LIST":
                # There never is a mission.
                self._transmitter.ask("MISSION_COUNT", mission_type=said.fields["mission_type"], **whom)

    def _result(self, command: int, first: float, second: float) -> int:
        """Obeys a command with its first two parameters; answers the MAV_RESULT."""
        if command == REQUEST_CAPABILITIES:
            return self._request("AUTOPILOT_VERSION", 0.0)
        if command not in (ARM_DISARM, GET_INTERVAL, SET_INTERVAL, REQUEST_MESSAGE):
            return UNSUPPORTED
        if not isfinite(first):
            return DENIED
        if command == ARM_DISARM:
            return self._arm(first, second)
        if command == SET_INTERVAL:
            return self._set_interval(first, second)
        if command == GET_INTERVAL:
            return self._request("MESSAGE_INTERVAL", first)
        return self._request(_name(first), second)

    def _arm(self, arm: float, force: float) -> int:
        if round(arm) not in (0, 1):
            return DENIED
        if self._simulation.set_armed(round(arm) == 1, force == FORCE):
            return ACCEPTED
        if round(arm) == 1:
            return FAILED
        text, result = self._transmitter.autopilot.denied_in_air
        if text:
            self._transmitter.ask("STATUSTEXT", severity=CRITICAL, text=text.encode())
        return result

    def _set_interval(self, message: float, interval: float) -> int:
        schedule, name = self._transmitter.schedule, _name(message)
        if name not in schedule.usual or not isfinite(interval):
            return self._transmitter.autopilot.unknown_message
        if interval < 0:
            seconds = inf
        elif interval > 0:
            seconds = interval / 1e6
        else:
            seconds = 1 / schedule.usual[name] if schedule.usual[name] else inf
        self._set_intervals([name], seconds)
        return ACCEPTED

    def _set_intervals(self, names: Iterable[str], seconds: float) -> None:
        """Sets the interval of messages, and tells of those whose interval was another."""
        schedule, changed = self._transmitter.schedule, []
        for name in names:
            before = schedule.interval(name)
            schedule.set(name, seconds, self._transmitter.clock)
            after = schedule.interval(name)
            if after != before:
                changed.append(f"{name} {_in_hertz(after)} instead of {_in_hertz(before)}")
        if changed and self._told < MOST_TOLD:
            self._told += 1
            more = "; what it changes from now on is not told" if self._told == MOST_TOLD else ""
            self._tell(f"A ground station asked for {', '.join(changed)}{more}.")

    def _request(self, name: str, argument: float) -> int:
        """Sends a message once; ``argument`` is the id of the message whose interval MESSAGE_INTERVAL tells."""
        transmitter = self._transmitter
        if name in transmitter.schedule.usual:
            transmitter.ask_streamed(name)
        elif name == "MESSAGE_INTERVAL" and isfinite(argument) and 0 <= argument < 2**16:
            about = _name(argument)
            told = transmitter.schedule.interval(about) if about in transmitter.schedule.usual else 0.0
            interval = min(round(told * 1e6), LONGEST_INTERVAL) if isfinite(told) else -1
            transmitter.ask(name, message_id=int(argument), interval_us=interval)
        elif name == "AUTOPILOT_VERSION":
            autopilot = transmitter.autopilot
            transmitter.ask(name, capabilities=autopilot.capabilities, flight_sw_version=autopilot.version)
        else:
            return transmitter.autopilot.unknown_message
        return ACCEPTED

    def _read_parameter(self, asked: Mapping[str, Any]) -> None:
        parameters, index = self._transmitter.parameters, int(asked["param_index"])
        by_index = list(parameters.values())[index : index + 1] if index >= 0 else []
        found = by_index[0] if by_index else parameters.get(_text(asked["param_id"])) if index < 0 else None
        if found is not None:
            self._transmitter.tell(found)

    def _set_parameter(self, asked: Mapping[str, Any]) -> None:
        known = self._transmitter.parameters.get(_text(asked["param_id"]))
        if known is None:
            return
        changed = known.changed(float(asked["param_value"]), self._transmitter.autopilot.bitwise)
        if changed is not None:
            self._transmitter.parameters[known.name] = changed
        self._transmitter.tell(changed or known)

    def _request_streams(self, asked: Mapping[str, Any]) -> None:
        """Sets the rate, Hz, of a group of messages, or of all groups."""
        groups, group = self._transmitter.autopilot.groups, int(asked["req_stream_id"])
        rate = int(asked["req_message_rate"]) if asked["start_stop"] else 0
        chosen = list(groups) if group == ALL_STREAMS else [group]
        self._set_intervals((name for one in chosen for name in groups.get(one, ())), 1 / rate if rate else inf)


def _in_hertz(interval: float) -> str:
    return f"{1 / interval:.3g} Hz" if isfinite(interval) else "none"


def _name(message: float) -> str:
    """Of the message with this id; empty when there is none."""
    definition = definitions().get(round(message)) if isfinite(message) else None
    return definition.name if definition else ""


def _text(field: bytes) -> str:
    return field.split(b"\0", 1)[0].decode("ascii", errors="replace")
