"""Asks a vehicle for message rates, which it restores, and parameters: the only part of mavdem that transmits.

Source: https://mavlink.io/en/services/command.html, https://mavlink.io/en/services/parameter.html, and
MAV_CMD_GET_MESSAGE_INTERVAL, MAV_CMD_SET_MESSAGE_INTERVAL and MESSAGE_INTERVAL of
https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import all as dialect

from mavdem.facts import Fact
from mavdem.facts.session import RateFact
from mavdem.ingest.mavlink.definitions import FrameSender, definitions
from mavdem.ingest.vocabulary import ACTIVE
from mavdem.live.messages import Message

# The usual ids of ground stations; 190 is MAV_COMP_ID_MISSIONPLANNER
GROUND_STATION = FrameSender(255, 190)
# Of HEARTBEATs: when those of 255 end, autopilots may fly home for a lost link
GREETER = FrameSender(254, 190)
GET_INTERVAL = dialect.MAV_CMD_GET_MESSAGE_INTERVAL
SET_INTERVAL = dialect.MAV_CMD_SET_MESSAGE_INTERVAL
EVERYONE = 0  # Target id of messages to all, and of those without a target
# The interval, µs, of a message that is not sent. 0, the default, is never sent: autopilots differ in it
STOPPED = -1
SHORTEST_INTERVAL = 1000  # µs: shorter ones, also 0, which means an unknown message, are ignored
MOTION = dialect.MAVLINK_MSG_ID_ATTITUDE, dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW
EVIDENCE = (
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    dialect.MAVLINK_MSG_ID_VFR_HUD,
)
"""What distinguishes flight from landing."""
EVIDENCE_RATE = 4.0  # Hz; those that come faster already stay as they are
REPLY_SECONDS = 1.0  # Until a request without a reply is sent again
MAX_TRIES = 3
# Between two requests for parameters: a slow radio has other things to send
PARAMETER_SECONDS = 0.2
SILENCE_SECONDS = 3.0  # Without a byte, or without attitude and motors, until that is reported
# Of arrival time, over which rates are measured
WINDOW_SECONDS = 5.0
MIN_WINDOW_SECONDS = 2.0
SLOW = 0.7  # Share of the rate reached before, below which a message is asked for again
PAUSE_SECONDS = 10.0
MAX_PAUSE_SECONDS = 60.0
"""Between two requests of one message, at least; doubled each time while nobody confirms. Another ground station that
sets rates back, MAVProxy every 15 s, costs as long each time as it takes to ask again."""


class Arrivals:
    """Rates over the last ``WINDOW_SECONDS`` of the caller's clock: the vehicle's stops when nothing comes."""

    def __init__(self) -> None:
        # whether the vehicle was silent before the latest call, and is no longer
        self.resumed = False
        self._window: deque[tuple[float, dict[int, int]]] = deque()
        self._heard = -np.inf
        self._total = 0

    def rates(self, now: float, arrived: Mapping[int, int]) -> dict[int, float] | None:
        """Returns Hz by message id from the number of messages so far by id; None while the window is too short."""
        total = sum(arrived.values())
        self.resumed = total != self._total > 0 and now - self._heard > SILENCE_SECONDS
        if total != self._total:
            self._heard = now
            self._total = total
        if self.resumed:
            self._window.clear()
        if not self._window or now - self._window[-1][0] >= MIN_WINDOW_SECONDS / 4:
            self._window.append((now, dict(arrived)))
        while len(self._window) > 1 and self._window[1][0] <= now - WINDOW_SECONDS:
            self._window.popleft()
        start, before = self._window[0]
        if now - start < MIN_WINDOW_SECONDS:
            return None
        return {
            kind: (count - before.get(kind, 0)) / (now - start) for kind, count in arrived.items()
        }


@dataclass
class _Interval:
    """One message's interval."""

    message_id: int
    name: str  # of the message
    rate: float  # asked for, Hz
    least: bool = False  # whether about that rate is enough, however it is reached
    before: int | None = None  # the former interval, µs, once known
    queries: int = 0  # so far
    settings: int = 0  # since the last reset
    unrefused: int = 0  # number of settings ever that the vehicle did not refuse
    last: float = -np.inf  # s, of the last query or setting
    done: bool = False  # whether no reply is awaited
    refused: bool = False  # by the vehicle
    reached: float = 0.0  # Hz reached since it was set
    again: int = 0  # number of times that it was asked for again since it last stayed
    came: bool = False  # whether it has come since it was last asked for
    restored: bool = False  # whether the vehicle confirmed the former interval


class RateRequest:
    """Makes a vehicle send attitude and motor outputs at a rate, Hz, and restores its former rates at the end.

    ``evidence``, messages that distinguish flight from landing, are asked for at ``EVIDENCE_RATE``. Each interval is
    queried, then set, one at a time since a confirmation does not name the message. What comes much slower later, after
    a reboot or by a ground station, is set again, at most every ``PAUSE_SECONDS``. Where the vehicle never reports the
    interval, the one measured before is restored. ``parameters`` are asked for by name, ``MAX_TRIES`` times at most,
    until they come. ``events``: facts to report; the caller removes them.
    """

    def __init__(
        self,
        vehicle: FrameSender,
        rate: float,
        messages: Sequence[int] = MOTION,
        evidence: Sequence[int] = EVIDENCE,
        parameters: Sequence[str] = (),
    ) -> None:
        self.events: list[Fact] = []
        self._target = vehicle
        self._parameters = deque(MAX_TRIES * [name.encode() for name in parameters])
        self._next = -np.inf
        self._intervals = [
            _Interval(number, definitions()[number].name, rate) for number in messages
        ]
        self._intervals += [
            _Interval(number, definitions()[number].name, EVIDENCE_RATE, True)
            for number in evidence
        ]
        self._contested = self._restoring = False
        self.unconfirmed: deque[_Interval] = deque()  # whose restoring awaits a reply

    def due(
        self, now: float, measured: Mapping[int, float] | None, known: Container[bytes] = ()
    ) -> list[bytes]:
        """Returns frames to send at ``now``, s of a monotonic clock.

        ``measured``: Hz by message id, once known; ``known``: names of the parameters that came.
        """
        frames = []
        while self._parameters and self._parameters[0] in known:
            self._parameters.popleft()
        if self._parameters and now >= self._next:
            name = self._parameters.popleft()
            asked = dialect.MAVLink_param_request_read_message(*self._target, name, -1)
            frames.append(_frame(asked, GROUND_STATION))
            self._next = now + PARAMETER_SECONDS
        for interval in self._intervals:
            rate = None if measured is None else measured.get(interval.message_id, 0.0)
            self._watch(interval, now, rate)
            if interval.done or now - interval.last < REPLY_SECONDS:
                continue
            if interval.before is None and interval.queries < MAX_TRIES:
                interval.queries += 1
                frames.append(self._command(GET_INTERVAL, interval.message_id))
            elif any(
                each.settings and not each.done and now - each.last < REPLY_SECONDS
                for each in self._intervals
            ):
                continue  # a setting may still be confirmed
            elif rate is None and (interval.least or not interval.unrefused):
                continue
            elif rate is not None and (
                rate >= SLOW * interval.rate
                if interval.least
                else not interval.unrefused and rate >= interval.rate
            ):
                interval.done = True  # what comes faster already stays as it is
            elif interval.settings < MAX_TRIES:
                if interval.before is None:
                    interval.before = round(1e6 / rate) if rate else STOPPED
                interval.settings += 1
                interval.unrefused += 1
                frames.append(
                    self._command(SET_INTERVAL, interval.message_id, round(1e6 / interval.rate))
                )
            else:
                interval.done = True
                if not interval.least:
                    self.events.append(Fact(RateFact.RATE_NOT_CONFIRMED, subject=interval.name))
            interval.last = now
        return frames

    def take(self, message: Message) -> None:
        """Takes a MESSAGE_INTERVAL or a COMMAND_ACK of the vehicle."""
        first, second, *addressee = message.values
        us = GROUND_STATION.system, GROUND_STATION.component
        ours = all(to in (EVERYONE, own) for to, own in zip(addressee, us, strict=False))
        if message.name == "MESSAGE_INTERVAL":
            possible = second == STOPPED or second >= SHORTEST_INTERVAL
            for interval in self._intervals:
                # After a setting it is not the former interval.
                if (
                    interval.message_id == first
                    and interval.before is None
                    and not interval.settings
                    and possible
                ):
                    interval.before = second
                    interval.last = -np.inf
        elif first != SET_INTERVAL or second == dialect.MAV_RESULT_IN_PROGRESS or not ours:
            return
        elif self._restoring:
            if self.unconfirmed:  # in the order of the requests
                self.unconfirmed.popleft().restored = second == dialect.MAV_RESULT_ACCEPTED
        elif waiting := [
            interval for interval in self._intervals if interval.settings and not interval.done
        ]:
            # It does not contain the message: take the one that was set last.
            latest = max(waiting, key=lambda interval: interval.last)
            latest.done = True
            latest.refused = second != dialect.MAV_RESULT_ACCEPTED
            latest.unrefused -= latest.refused
            if latest.refused and not latest.least:
                self.events.append(Fact(RateFact.RATE_REFUSED, subject=latest.name, result=second))

    def restart(self) -> None:
        """The vehicle may have rebooted, and forgotten all rates: asks for them again at once."""
        self._intervals = [
            replace(
                each,
                settings=0,
                last=-np.inf,
                done=False,
                refused=False,
                reached=0.0,
                again=0,
                came=False,
            )
            for each in self._intervals
        ]
        if any(each.unrefused for each in self._intervals):
            self.events.append(Fact(RateFact.RATES_ASKED_AGAIN))

    def restore(self) -> list[bytes]:
        """Returns frames that restore each former interval that may have changed and is not confirmed as before yet."""
        self._restoring = True
        self.unconfirmed = deque(
            each for each in self._intervals if each.unrefused and not each.restored
        )
        return [
            self._command(SET_INTERVAL, each.message_id, each.before or STOPPED)
            for each in self.unconfirmed
        ]

    def _watch(self, interval: _Interval, now: float, rate: float | None) -> None:
        """Sets the interval of a message again that comes much slower than before, or that was never confirmed."""
        if rate is None or not interval.done or interval.refused:
            return
        interval.reached = max(interval.reached, min(rate, interval.rate))
        unconfirmed = interval.settings == MAX_TRIES and not interval.reached
        if rate >= SLOW * interval.reached and not unconfirmed:
            if rate and not interval.came and now - interval.last >= WINDOW_SECONDS:
                interval.came = True
                if rate < 0.9 * interval.rate and not (interval.least or interval.again):
                    self.events.append(
                        Fact(
                            RateFact.RATE_BELOW_ASKED,
                            subject=interval.name,
                            rate=rate,
                            needed_rate=interval.rate,
                        )
                    )
            if now - interval.last >= MAX_PAUSE_SECONDS:
                interval.again = 0
            return
        if now - interval.last < min(
            PAUSE_SECONDS * 2 ** (interval.again * unconfirmed), MAX_PAUSE_SECONDS
        ):
            return
        if not interval.least and not unconfirmed and not self._contested:
            reached = interval.reached
            self.events.append(Fact(RateFact.RATE_FELL, subject=interval.name, former_rate=reached))
        # A request is withdrawn by another program, not by a reboot, if it is obeyed first, every time.
        if rate and interval.came and interval.again >= 2 and not self._contested:
            self._contested = True
            self.events.append(Fact(RateFact.RATES_CONTESTED))
        interval.settings = 0
        interval.done = False
        interval.again = interval.again + 1
        interval.came = False

    def _command(self, command: int, first: float, second: float = 0.0) -> bytes:
        given = (first, second, *[0.0] * 5)
        message = dialect.MAVLink_command_long_message(*self._target, command, 0, *given)
        return _frame(message, GROUND_STATION)


def greeting() -> bytes:
    """Returns a HEARTBEAT, for vehicles that send only after they have received one."""
    kind, autopilot = dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID
    message = dialect.MAVLink(None).heartbeat_encode(kind, autopilot, 0, 0, ACTIVE)
    return _frame(message, GREETER)


_sequence = count()


def _frame(message: Any, sender: FrameSender) -> bytes:
    link = dialect.MAVLink(None, *sender)
    link.seq = next(_sequence) % 256
    return bytes(message.pack(link))
