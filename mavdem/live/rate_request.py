"""Asking a vehicle for message rates and giving back what was there: the only thing in mavdem that transmits.

Source: https://mavlink.io/en/services/command.html and MAV_CMD_GET_MESSAGE_INTERVAL, MAV_CMD_SET_MESSAGE_INTERVAL and
MESSAGE_INTERVAL of https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mavdem.ingest.compose import Sender, compose
from mavdem.ingest.live_messages import Message
from mavdem.ingest.mavlink_json import definition_named

GROUND_STATION = Sender(255, 190)
"""Who asks: MAV_COMP_ID_MISSIONPLANNER, the ids that ground stations have."""
PASSER_BY = Sender(254, 190)
"""Who says that it is there. Not the ground station that a vehicle counts on, 255 unless set otherwise: of that one's
HEARTBEATs autopilots take the end for a link that was lost, and may fly home."""
GCS, NO_AUTOPILOT, ACTIVE, VERSION = 6, 8, 4, 3
"""MAV_TYPE_GCS, MAV_AUTOPILOT_INVALID, MAV_STATE_ACTIVE, and the version that every HEARTBEAT bears."""
GET_INTERVAL, SET_INTERVAL = 510, 511
"""MAV_CMD_GET_MESSAGE_INTERVAL and _SET_MESSAGE_INTERVAL."""
DEFAULT, STOPPED = 0, -1
"""Intervals with a meaning of their own. 0 is never sent: autopilots make different things of it."""
ATTITUDE, SERVO_OUTPUT_RAW = 30, 36
PATIENCE = 1.0
"""Seconds until what was not answered is asked again."""
TRIES = 3
FALLEN = 0.7
"""Of the rate that a message came at: what comes slower has been set back, by a reboot or a ground station."""
AGAIN = 10.0
"""Seconds from one setting to the next, where somebody else keeps setting it back."""


@dataclass
class _Asked:
    """One message's interval.

    Attributes:
        was: µs, before it was set, once that is known.
        inquiries, settings: how often it was asked for, and set since it last had to be.
        set: whether it ever was.
        last: s, when it last was asked for or set.
        done, refused: whether there is nothing to wait for, and whether there never will be.
        reached: Hz that it has come at since.
        restored: whether the vehicle has said that it is as it was.
    """

    message_id: int
    was: int | None = None
    inquiries: int = 0
    settings: int = 0
    set: bool = False
    last: float = -np.inf
    done: bool = False
    refused: bool = False
    reached: float = 0.0
    restored: bool = False


class RateRequest:
    """Sees to it that a vehicle sends attitude and motor outputs at a rate, and that at the end all is as it was.

    First each message's interval is asked for and noted, then set, and set again until the vehicle says that it has.
    One that comes much slower later, after a reboot or because a ground station wants it so, is set anew. One that
    never tells the interval it had gets, at the end, the one that was measured before.

    Attributes:
        events: sentences to tell, the oldest first; whoever tells them takes them out.
    """

    def __init__(self, vehicle: Sender, rate: float, messages: Sequence[int] = (ATTITUDE, SERVO_OUTPUT_RAW)) -> None:
        """Takes the vehicle, the rate in Hz, and the ids of the messages."""
        self.events: list[str] = []
        self._vehicle, self._interval = vehicle, round(1e6 / rate)
        self._rate = rate
        self._asked = [_Asked(message_id) for message_id in messages]
        self._sequence = 0
        self._restoring = False

    def due(self, now: float, measured: Mapping[int, float]) -> list[bytes]:
        """Frames to send now.

        Args:
            now: seconds of any clock that only goes forward.
            measured: rates, Hz, of messages that come, by id; what was not answered is restored to these.
        """
        frames = []
        for one in self._asked:
            self._watch(one, now, measured.get(one.message_id, 0.0))
            if one.done or now - one.last < PATIENCE:
                continue
            if one.was is None and one.inquiries < TRIES:
                one.inquiries += 1
                frames.append(self._command(GET_INTERVAL, one.message_id))
            elif one.settings < TRIES:
                if one.was is None:
                    rate = measured.get(one.message_id, 0.0)
                    one.was = round(1e6 / rate) if rate > 0 else STOPPED
                one.settings += 1
                one.set = True
                frames.append(self._command(SET_INTERVAL, one.message_id, self._interval))
            else:
                one.done = True
                self.events.append(f"The vehicle does not answer whether it sends message {one.message_id} faster.")
                continue
            one.last = now
        return frames

    def heard(self, message: Message) -> None:
        """Takes a MESSAGE_INTERVAL or a COMMAND_ACK of the vehicle."""
        first, second = message.values
        if message.name == "MESSAGE_INTERVAL":
            self._told(first, second)
        elif first == SET_INTERVAL and self._restoring:
            for one in [one for one in self._asked if one.set and not one.restored][:1]:
                one.restored = True
        elif first == SET_INTERVAL:
            # It does not say for which message: the one that has waited longest.
            waiting = [one for one in self._asked if one.settings and not one.done]
            if waiting:
                self._answered(min(waiting, key=lambda one: one.last), second)

    def restore(self) -> list[bytes]:
        """Frames that give each message the interval it had, but those of which the vehicle has said that it has it."""
        self._restoring = True
        changed = [one for one in self._asked if one.set and one.was is not None and not one.restored]
        return [self._command(SET_INTERVAL, one.message_id, one.was or STOPPED) for one in changed]

    def _watch(self, one: _Asked, now: float, rate: float) -> None:
        """Begins to set a message anew that comes much slower than it did."""
        if not one.done or one.refused:
            return
        one.reached = max(one.reached, min(rate, self._rate))
        if rate < FALLEN * one.reached and now - one.last >= AGAIN:
            self.events.append(f"Message {one.message_id} was set back to {rate:.3g} Hz; it is asked for again.")
            one.settings, one.done = 0, False

    def _told(self, message_id: int, interval: int) -> None:
        for one in self._asked:
            # What it says after it was set is not what it had; 0 says that it does not know the message.
            if one.message_id == message_id and one.was is None and not one.settings and interval != DEFAULT:
                one.was, one.last = interval, -np.inf

    def _answered(self, one: _Asked, result: int) -> None:
        one.done = True
        if result:
            one.refused = True
            self.events.append(f"The vehicle refuses to send message {one.message_id} faster (MAV_RESULT {result}).")

    def _command(self, command: int, first: float, second: float = 0.0) -> bytes:
        self._sequence += 1
        return _frame(
            "COMMAND_LONG",
            GROUND_STATION,
            self._sequence - 1,
            target_system=self._vehicle.system,
            target_component=self._vehicle.component,
            command=command,
            param1=first,
            param2=second,
        )


def greeting(number: int) -> bytes:
    """A ground station's HEARTBEAT, for those that answer only who has spoken to them; the ``number``-th, from 0 on."""
    fields = {"type": GCS, "autopilot": NO_AUTOPILOT, "system_status": ACTIVE, "mavlink_version": VERSION}
    return _frame("HEARTBEAT", PASSER_BY, number, **fields)


def _frame(name: str, sender: Sender, number: int, **fields: float) -> bytes:
    definition = definition_named(name)
    assert definition is not None
    payload = np.zeros(1, dtype=definition.wire)
    for field, value in fields.items():
        payload[field] = value
    sequence = np.array([number % 256], dtype=np.uint8)
    data, _ = compose(payload, definition, sender, sequence, np.ones(1, dtype=np.bool_))
    return data.tobytes()
