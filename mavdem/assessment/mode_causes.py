"""Why the autopilot changed its flight mode: its own reason, a failsafe, the pilot, or a command."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mavdem.assessment.autopilot_messages import ModeChangeReason, mode_change_reason
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import rows_of_boot
from mavdem.facts import Fact, Level
from mavdem.facts.events import ReportedEvent

MAX_CAUSE_DELAY = 1.0
"""Longest time, s, from a command or a failsafe to the first message that has the new mode.

PX4 publishes vehicle_status at least every 0.5 s, and logs may have every second message of it.
"""

COMMAND_FIELDS = {"command", "from_external", "source_system", "source_component"}
"""Fields of vehicle_command that say what is commanded, and by whom; PX4 before 1.9 lacks some."""

MODE_COMMANDS = (20, 21, 22, 23, 34, 35, 84, 176, 192, 300, 100000)
"""MAV_CMDs by which PX4's commander changes the flight mode (Commander.cpp, ``handle_command``).

They are return, land, take-off, precision landing, orbit, figure eight, vertical take-off, DO_SET_MODE, DO_REPOSITION,
start of the mission, and PX4's own SET_NAV_STATE.
"""

GROUND_STATION_COMPONENT = 190
"""MAV_COMP_ID_MISSIONPLANNER, the component by which QGroundControl and Mission Planner send."""


SWITCH_MODE_ACTION = 5
"""PX4's ``ActionRequest.ACTION_SWITCH_MODE``: a switch, button or stick of the transmitter asks for a flight mode."""


class ModeRequest(NamedTuple):
    """A request for another flight mode, which PX4 received."""

    time: float
    """When PX4 received it, s since boot."""
    sender: str
    """Who sent it, in words."""


def mode_change_cause(
    time: float,
    ardupilot_reason: float | None,
    requests: Sequence[ModeRequest],
    faults: Sequence[Fact],
) -> ModeChangeReason:
    """Returns why the autopilot changed its flight mode.

    ArduPilot logs its reason. PX4 does not: there a failsafe that begins with the new mode is the cause, or else the
    last request shortly before, by the transmitter or by a command. Without any of these the cause is not known.

    Args:
        time: time of the first message with the new mode, s since boot.
        ardupilot_reason: the field ``Rsn`` of the message MODE; None if the log has no such field.
        requests: requests for flight modes in this boot (:func:`mode_requests`).
        faults: reports of the autopilot in this boot, in any order.
    """
    if ardupilot_reason is not None:
        return mode_change_reason(ardupilot_reason)
    if _failsafe_begins_at(faults, time):
        return ModeChangeReason("failsafe", Level.WATCH)
    earlier_requests = [
        request for request in requests if 0 <= time - request.time <= MAX_CAUSE_DELAY
    ]
    if not earlier_requests:
        return ModeChangeReason("", Level.GOOD)
    latest_request = max(earlier_requests, key=lambda request: request.time)
    return ModeChangeReason(latest_request.sender, Level.GOOD)


def _failsafe_begins_at(faults: Sequence[Fact], time: float) -> bool:
    """Returns whether a failsafe began within ``MAX_CAUSE_DELAY`` of a time, s since boot, by the reported faults."""
    for fault in faults:
        is_failsafe = fault.code is ReportedEvent.FAILSAFE
        if is_failsafe and abs(fault.start_time - time) <= MAX_CAUSE_DELAY:
            return True
    return False


def mode_requests(signals: Signals, boot: int) -> list[ModeRequest]:
    """Returns the requests for flight modes that PX4 received in one boot: those of the transmitter, then commands.

    Args:
        signals: logged time series of the vehicle, with its messages.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
    """
    return [*_requests_of_pilot(signals, boot), *_requests_by_command(signals, boot)]


def _requests_of_pilot(signals: Signals, boot: int) -> Iterator[ModeRequest]:
    """Yields the requests of the transmitter in one boot, from PX4's topic action_request; none without it."""
    columns = signals.telemetry.messages.get("action_request", {})
    if "action" not in columns:
        return
    rows = rows_of_boot(columns["boot"], boot)
    is_mode_request = columns["action"][rows] == SWITCH_MODE_ACTION
    for time in columns["time"][rows][is_mode_request].tolist():
        yield ModeRequest(time, "pilot")


def _requests_by_command(signals: Signals, boot: int) -> Iterator[ModeRequest]:
    """Yields the commands for a flight mode in one boot, from PX4's topic vehicle_command; none without it."""
    columns = signals.telemetry.messages.get("vehicle_command", {})
    if not columns.keys() >= COMMAND_FIELDS:
        return
    rows = rows_of_boot(columns["boot"], boot)
    for index in np.flatnonzero(np.isin(columns["command"][rows], MODE_COMMANDS)):
        sender = _command_sender(
            is_external=bool(columns["from_external"][rows][index]),
            is_aboard=columns["source_system"][rows][index] == signals.telemetry.system,
            component=int(columns["source_component"][rows][index]),
        )
        yield ModeRequest(float(columns["time"][rows][index]), f"command of {sender}")


def _command_sender(*, is_external: bool, is_aboard: bool, component: int) -> str:
    """Returns who sent a command, in words that follow "command of".

    Args:
        is_external: whether the command came by MAVLink or ROS 2; otherwise a part of the autopilot sent it, such as
            its mission.
        is_aboard: whether the sender has the system id of the vehicle, which MAVLink gives to all its parts.
        component: MAVLink's component id of the sender.
    """
    if not is_external:
        return "the autopilot itself"
    if component == GROUND_STATION_COMPONENT:
        return "a ground station"
    if is_aboard:
        return f"a companion computer, component {component}"
    return "another system"
