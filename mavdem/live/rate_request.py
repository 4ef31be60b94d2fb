"""Asks a vehicle for message rates and restores the former ones: the only part of mavdem that transmits.

Source: https://mavlink.io/en/services/command.html and MAV_CMD_GET_MESSAGE_INTERVAL, MAV_CMD_SET_MESSAGE_INTERVAL and
MESSAGE_INTERVAL of https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mavdem.ingest.mavlink.definitions import FrameSender, composed_frames, definition_named, definitions
from mavdem.live.messages import Message

GROUND_STATION = FrameSender(255, 190)  # The usual ids of ground stations; 190 is MAV_COMP_ID_MISSIONPLANNER
GREETER = FrameSender(254, 190)
"""The sender of the HEARTBEATs. Not 255, the usual ground station of a vehicle: when its HEARTBEATs end, autopilots
assume a lost link and may fly home."""
GCS, NO_AUTOPILOT, ACTIVE, VERSION = 6, 8, 4, 3
"""MAV_TYPE_GCS, MAV_AUTOPILOT_INVALID, MAV_STATE_ACTIVE, and the version in every HEARTBEAT."""
GET_INTERVAL, SET_INTERVAL = 510, 511  # MAV_CMD_GET_MESSAGE_INTERVAL and _SET_MESSAGE_INTERVAL
EVERYONE = 0  # Target id of messages to all, and of those without a target
STOPPED = -1  # The interval, µs, of a message that is not sent. 0, the default, is never sent: autopilots differ in it
SHORTEST_INTERVAL = 1000  # µs: shorter ones, also 0, which means an unknown message, are ignored
ACCEPTED, IN_PROGRESS = 0, 5  # MAV_RESULT: done, and a reply that the result follows
ATTITUDE, SERVO_OUTPUT_RAW = 30, 36
EVIDENCE = (245, 32, 74)  # EXTENDED_SYS_STATE, LOCAL_POSITION_NED, VFR_HUD: what distinguishes flight from landing
EVIDENCE_RATE = 4.0  # Hz; those that come faster already stay as they are
REPLY_SECONDS = 1.0  # Until a request without a reply is sent again
MAX_TRIES = 3
SILENCE_SECONDS = 3.0  # Without a byte, or without attitude and motors, until that is reported
WINDOW_SECONDS, MIN_WINDOW_SECONDS = 5.0, 2.0  # Of arrival time, over which rates are measured
SLOW = 0.7  # Share of the rate reached before, below which a message is asked for again
PAUSE_SECONDS, MAX_PAUSE_SECONDS = 10.0, 60.0
"""Between two requests of one message, at least; doubled each time while nobody confirms. Another ground station that
sets rates back, MAVProxy every 15 s, costs as long each time as it takes to ask again."""


class Arrivals:
    """Rates by arrival: how many messages of each kind came in the last ``WINDOW_SECONDS`` of the caller's clock.

    Not by the vehicle's clock, which stops when nothing comes. ``resumed``: whether the vehicle was silent before the
    latest call, and is no longer.
    """

    def __init__(self) -> None:
        self.resumed = False
        self._window: deque[tuple[float, dict[int, int]]] = deque()
        self._heard, self._total = -np.inf, 0

    def rates(self, now: float, arrived: Mapping[int, int]) -> dict[int, float] | None:
        """Hz by message id; None while the window is too short.

        ``arrived``: number of messages so far, by message id.
        """
        total = sum(arrived.values())
        new = total != self._total
        self.resumed = new and self._total > 0 and now - self._heard > SILENCE_SECONDS
        if new:
            self._heard, self._total = now, total
        if self.resumed:
            self._window.clear()
        if not self._window or now - self._window[-1][0] >= MIN_WINDOW_SECONDS / 4:
            self._window.append((now, dict(arrived)))
        while len(self._window) > 1 and self._window[1][0] <= now - WINDOW_SECONDS:
            self._window.popleft()
        start, before = self._window[0]
        if now - start < MIN_WINDOW_SECONDS:
            return None
        return {kind: (count - before.get(kind, 0)) / (now - start) for kind, count in arrived.items()}


@dataclass
class _Interval:
    """One message's interval."""

    message_id: int
    rate: float  # asked for, Hz
    least: bool = False  # whether about that rate is enough, however it is reached
    before: int | None = None  # the former interval, µs, once known
    queries: int = 0  # with settings: number of queries, and of settings since the last reset
    settings: int = 0
    set: bool = False  # whether it was ever set
    unrefused: int = 0  # number of settings ever that the vehicle did not refuse
    last: float = -np.inf  # s, of the last query or setting
    done: bool = False  # with refused: whether no reply is awaited, and whether the vehicle refused
    refused: bool = False
    reached: float = 0.0  # Hz reached since it was set
    again: int = 0  # number of times that it was asked for again since it last stayed
    restored: bool = False  # whether the vehicle confirmed the former interval

    @property
    def name(self) -> str:
        """Of the message."""
        return definitions()[self.message_id].name


class RateRequest:
    """Makes a vehicle send attitude and motor outputs at a rate, Hz, and restores its former rates at the end.

    Messages that distinguish flight from landing, ``evidence``, are asked for at ``EVIDENCE_RATE``. First the interval
    of each message is queried, then set, one at a time since a confirmation does not name the message. If the message
    comes much slower later, after a reboot or by a ground station, it is set again, at most every ``PAUSE_SECONDS``. If
    the vehicle never reports the interval, the one measured before is restored. What comes faster already stays as it
    is. ``events``: sentences to report, the oldest first; the caller removes them.
    """

    def __init__(
        self,
        vehicle: FrameSender,
        rate: float,
        messages: Sequence[int] = (ATTITUDE, SERVO_OUTPUT_RAW),
        evidence: Sequence[int] = EVIDENCE,
    ) -> None:
        self.events: list[str] = []
        self._vehicle = vehicle
        self._asked = [_Interval(message_id, rate) for message_id in messages]
        self._asked += [_Interval(message_id, EVIDENCE_RATE, least=True) for message_id in evidence]
        self._sequence = 0
        self._contested = self._restoring = False
        self._unconfirmed: deque[_Interval] = deque()

    def due(self, now: float, measured: Mapping[int, float] | None) -> list[bytes]:
        """Frames to send at ``now``, s of a monotonic clock.

        The ``measured`` rates, Hz by message id, are restored if the vehicle does not report intervals; None while they
        are not known.
        """
        frames = []
        for one in self._asked:
            rate = None if measured is None else measured.get(one.message_id, 0.0)
            self._watch(one, now, rate)
            if one.done or now - one.last < REPLY_SECONDS:
                continue
            if one.before is None and one.queries < MAX_TRIES:
                one.queries += 1
                frames.append(self._command(GET_INTERVAL, one.message_id))
            elif self._waiting(now) or (rate is None and (one.least or not one.set)):
                continue
            elif rate is not None and (rate >= SLOW * one.rate if one.least else not one.set and rate >= one.rate):
                one.done = True
            elif one.settings < MAX_TRIES:
                if one.before is None:
                    one.before = round(1e6 / rate) if rate else STOPPED
                one.settings += 1
                one.set = True
                one.unrefused += 1
                frames.append(self._command(SET_INTERVAL, one.message_id, round(1e6 / one.rate)))
            else:
                one.done = True
                if not one.least:
                    self.events.append(f"The vehicle has not confirmed a faster rate of {one.name}.")
            one.last = now
        return frames

    def take(self, message: Message) -> None:
        """A MESSAGE_INTERVAL or a COMMAND_ACK of the vehicle."""
        first, second, *addressee = message.values
        if message.name == "MESSAGE_INTERVAL":
            for one in self._asked:
                # After a setting it is not the former one.
                sound = second == STOPPED or second >= SHORTEST_INTERVAL
                if one.message_id == first and one.before is None and not one.settings and sound:
                    one.before, one.last = second, -np.inf
        elif first != SET_INTERVAL or second == IN_PROGRESS or not _is_for_us(*addressee):
            return
        elif self._restoring:
            # In the order of the requests.
            if self._unconfirmed:
                self._unconfirmed.popleft().restored = second == ACCEPTED
        else:
            # It does not contain the message: take the one that was set last.
            waiting = [one for one in self._asked if one.settings and not one.done]
            for one in sorted(waiting, key=lambda one: -one.last)[:1]:
                one.done, one.refused = True, second != ACCEPTED
                one.unrefused -= one.refused
                if one.refused and not one.least:
                    self.events.append(f"The vehicle refuses a faster rate of {one.name} (MAV_RESULT {second}).")

    def restart(self) -> None:
        """The vehicle may have rebooted, and forgotten all rates: asks for them again at once."""
        for one in self._asked:
            one.settings, one.done, one.refused = 0, False, False
            one.last, one.again = -np.inf, 0
        if any(one.set for one in self._asked):
            self.events.append("The vehicle is back: asking for its message rates again.")

    def restore(self) -> list[bytes]:
        """Frames that restore each former interval that may have changed and is not confirmed as before yet."""
        self._restoring = True
        self._unconfirmed = deque(one for one in self._asked if one.unrefused and not one.restored)
        return [self._command(SET_INTERVAL, one.message_id, one.before or STOPPED) for one in self._unconfirmed]

    @property
    def restoring(self) -> bool:
        """Whether replies to the frames of ``restore`` are awaited."""
        return bool(self._unconfirmed)

    def _waiting(self, now: float) -> bool:
        """Whether a setting may still be confirmed."""
        return any(one.settings and not one.done and now - one.last < REPLY_SECONDS for one in self._asked)

    def _watch(self, one: _Interval, now: float, rate: float | None) -> None:
        """Sets the interval of a message again that comes much slower than before, or that was never confirmed."""
        if rate is None or not one.done or one.refused:
            return
        one.reached = max(one.reached, min(rate, one.rate))
        unconfirmed = one.settings == MAX_TRIES and not one.reached
        if rate >= SLOW * one.reached and not unconfirmed:
            if now - one.last >= MAX_PAUSE_SECONDS:
                one.again = 0
            return
        if now - one.last < min(PAUSE_SECONDS * 2**one.again if unconfirmed else PAUSE_SECONDS, MAX_PAUSE_SECONDS):
            return
        if not one.least and not unconfirmed and not self._contested:
            self.events.append(f"{one.name} no longer comes at {one.reached:.3g} Hz; asking for it again.")
        # A request is withdrawn by another program, not by a reboot, if that occurs every time.
        if rate and one.again >= 2 and not self._contested:
            self._contested = True
            self.events.append(
                "Message rates are set back again and again, perhaps by another ground station (in MAVProxy, "
                "`set streamrate -1` ends that): each time they are asked for again."
            )
        one.settings, one.done, one.again = 0, False, one.again + 1

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


def _is_for_us(system: int, component: int) -> bool:
    return system in (EVERYONE, GROUND_STATION.system) and component in (EVERYONE, GROUND_STATION.component)


def greeting(number: int) -> bytes:
    """The ``number``-th HEARTBEAT, from 0 on, for vehicles that send only after they have received something."""
    fields = {"type": GCS, "autopilot": NO_AUTOPILOT, "system_status": ACTIVE, "mavlink_version": VERSION}
    return _frame("HEARTBEAT", GREETER, number, **fields)


def _frame(name: str, sender: FrameSender, number: int, **fields: float) -> bytes:
    definition = definition_named(name)
    assert definition is not None
    payload = np.zeros(1, dtype=definition.wire)
    for field, value in fields.items():
        payload[field] = value
    sequence = np.array([number % 256], dtype=np.uint8)
    data, _ = composed_frames(payload, definition, sender, sequence)
    return data.tobytes()
