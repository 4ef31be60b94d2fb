"""Asks a vehicle for message rates, which it restores, and parameters: the only part of mavdem that transmits.

Source: https://mavlink.io/en/services/command.html, https://mavlink.io/en/services/parameter.html, and
MAV_CMD_GET_MESSAGE_INTERVAL, MAV_CMD_SET_MESSAGE_INTERVAL and MESSAGE_INTERVAL of
https://mavlink.io/en/messages/common.html.
"""

from collections import deque
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import all as dialect

from mavdem.facts import Fact
from mavdem.facts.session import RateFact
from mavdem.ingest.mavlink.definitions import FrameSender, definitions_by_id
from mavdem.ingest.vocabulary import ACTIVE
from mavdem.live.link import MAX_TRIES
from mavdem.live.link import PAUSE_SECONDS as TRY_SECONDS
from mavdem.live.messages import Message
from mavdem.live.rows import DECISION_SECONDS

# The usual ids of ground stations; 190 is MAV_COMP_ID_MISSIONPLANNER
GROUND_STATION = FrameSender(255, 190)
# Of HEARTBEATs: when those of 255 end, autopilots may fly home for a lost link
GREETER = FrameSender(254, 190)
GET_INTERVAL = dialect.MAV_CMD_GET_MESSAGE_INTERVAL
SET_INTERVAL = dialect.MAV_CMD_SET_MESSAGE_INTERVAL
EVERYONE = dialect.MAV_COMP_ID_ALL  # Target id of messages to all, and of those without a target
# The interval, µs, of a message that is not sent. 0, the default, is never sent: autopilots differ in it
STOPPED = -1
SHORTEST_INTERVAL = 1000  # µs: shorter ones, also 0, which means an unknown message, are ignored
MOTION = dialect.MAVLINK_MSG_ID_ATTITUDE, dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW
SETPOINTS = dialect.MAVLINK_MSG_ID_ATTITUDE_TARGET
"""By which loops are identified, asked for at half the rate, and 50 Hz where that is more: with less these are known
worse, and with all radios have no room for the others."""
EVIDENCE = (
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    dialect.MAVLINK_MSG_ID_VFR_HUD,
)
"""What distinguishes flight from landing."""
EVIDENCE_RATE = 4.0  # Hz; those that come faster already stay as they are
# Between two requests for parameters: a slow radio has other things to send
PARAMETER_SECONDS = 0.2
# Of arrival time, over which rates are measured
MEASURED_SECONDS = 5.0
AGAIN_SHARE = 0.7  # Share of the rate reached before, below which a message is asked for again
PAUSE_SECONDS = 10.0
"""Between two requests of one message that was reached. Another ground station that sets rates back, MAVProxy every
15 s, costs as long each time as it takes to ask again."""


class Arrivals:
    """Rates over the last ``MEASURED_SECONDS`` of the caller's clock: the vehicle's stops when nothing comes."""

    def __init__(self) -> None:
        self._window: deque[tuple[float, dict[int, int]]] = deque()

    def rates(self, now: float, arrived: Mapping[int, int]) -> dict[int, float] | None:
        """Returns Hz by message id from the number of messages so far by id; None while the window is too short."""
        if not self._window or now - self._window[-1][0] >= DECISION_SECONDS / 4:
            self._window.append((now, dict(arrived)))
        while len(self._window) > 1 and self._window[1][0] <= now - MEASURED_SECONDS:
            self._window.popleft()
        start, before = self._window[0]
        if now - start < DECISION_SECONDS:
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
    needed: float  # Hz, below which it is asked for
    is_told: bool  # whether what becomes of it is reported
    before: int | None = None  # the former interval, µs, once known
    queries: int = 0  # so far
    settings: int = 0  # since it came fast enough last
    last: float = -np.inf  # s, of the last query or setting
    is_set: bool = False  # whether the vehicle may have changed it
    reached: bool = False  # whether it came fast enough after that
    falls: int = 0  # number of times that it became slow again
    restored: bool = False  # whether the vehicle confirmed the former interval


class RateRequest:
    """Makes a vehicle send attitude and motor outputs at a rate, Hz, and restores its former rates at the end.

    ``evidence``, without a word of what becomes of it: ``SETPOINTS`` at half the rate or more, and at ``EVIDENCE_RATE``
    what distinguishes flight from landing. Each interval is queried, then set until the message comes as fast,
    ``MAX_TRIES`` times at most; what then comes is enough. What comes much slower later, after a reboot or by a ground
    station, is set again, at most every ``PAUSE_SECONDS``. Where the vehicle never reports the interval, the one
    measured before is restored. ``parameters`` are asked for by name, ``MAX_TRIES`` times at most, until they come.
    ``events``: facts to report; the caller removes them.
    """

    def __init__(
        self,
        vehicle: FrameSender,
        rate: float,
        messages: Sequence[int] = MOTION,
        evidence: Sequence[int] = (SETPOINTS, *EVIDENCE),
        parameters: Sequence[str] = (),
    ) -> None:
        self.events: list[Fact] = []
        self._target = vehicle
        self._parameters = deque(MAX_TRIES * [name.encode() for name in parameters])
        # s: when the next parameter, and the next setting may be asked for; a confirmation does not name the message
        self._next = self._free = -np.inf
        names = {number: definitions_by_id()[number].name for number in (*messages, *evidence)}
        self._intervals = [_Interval(id, names[id], rate, rate, True) for id in messages]
        for id in evidence:
            wanted = min(rate, max(50.0, rate / 2)) if id == SETPOINTS else EVIDENCE_RATE
            self._intervals.append(_Interval(id, names[id], wanted, AGAIN_SHARE * wanted, False))
        self._restoring = False
        self.unconfirmed: deque[_Interval] = deque()  # whose restoring awaits a reply

    def due(
        self, now: float, measured: Mapping[int, float] | None, answered: Container[bytes] = ()
    ) -> list[bytes]:
        """Returns frames to send at ``now``, s of a monotonic clock.

        ``measured``: Hz by message id, once known; ``answered``: names of the parameters that came.
        """
        frames = []
        while self._parameters and self._parameters[0] in answered:
            self._parameters.popleft()
        if self._parameters and now >= self._next:
            name = self._parameters.popleft()
            asked = dialect.MAVLink_param_request_read_message(*self._target, name, -1)
            frames.append(_frame(asked, GROUND_STATION))
            self._next = now + PARAMETER_SECONDS
        for interval in self._intervals:
            if now - interval.last < TRY_SECONDS:
                continue
            if interval.before is None and interval.queries < MAX_TRIES:
                interval.queries += 1
                interval.last = now
                frames.append(self._command(GET_INTERVAL, interval.message_id))
            elif now >= self._free and (measured is not None or interval.is_set):
                frames += self._set(interval, now, (measured or {}).get(interval.message_id, 0.0))
        return frames

    def _set(self, interval: _Interval, now: float, rate: float) -> list[bytes]:
        """Sets the interval of a message that comes too slowly, at ``rate``, Hz."""
        if rate >= interval.needed:
            interval.settings = 0
            interval.reached = interval.is_set
            return []
        pause = PAUSE_SECONDS if interval.reached else MEASURED_SECONDS
        if interval.is_set and now - interval.last < pause:
            return []
        if interval.settings == MAX_TRIES:
            interval.needed = AGAIN_SHARE * rate
            self._report(interval, RateFact.RATE_BELOW_ASKED, rate=rate, needed_rate=interval.rate)
            return []
        if interval.reached:
            self._report_fall(interval, rate)
        if interval.before is None:
            interval.before = round(1e6 / rate) if rate else STOPPED
        interval.needed = AGAIN_SHARE * interval.rate
        interval.reached = False
        interval.settings += 1
        interval.is_set = True
        interval.last = now
        self._free = now + TRY_SECONDS
        return [self._command(SET_INTERVAL, interval.message_id, round(1e6 / interval.rate))]

    def _report_fall(self, interval: _Interval, rate: float) -> None:
        """Reports a message that became slow: the first time, and that another program sets it back."""
        interval.falls += rate > 0
        if interval.falls <= 1:
            self._report(interval, RateFact.RATE_FELL, former_rate=interval.rate)
        # A request is withdrawn by another program, not by a reboot, if it is obeyed first, every time.
        contested = [each for each in self._intervals if each.falls == MAX_TRIES and each.is_told]
        if contested == [interval]:
            self.events.append(Fact(RateFact.RATES_CONTESTED))

    def _report(self, interval: _Interval, code: RateFact, **figures: Any) -> None:
        if interval.is_told:
            self.events.append(Fact(code, subject=interval.name, **figures))

    def take(self, message: Message) -> None:
        """Takes a MESSAGE_INTERVAL or a COMMAND_ACK of the vehicle."""
        first, second, *addressee = message.values
        us = GROUND_STATION.system, GROUND_STATION.component
        ours = all(to in (EVERYONE, own) for to, own in zip(addressee, us, strict=False))
        if message.name == "MESSAGE_INTERVAL":
            possible = second == STOPPED or second >= SHORTEST_INTERVAL
            for interval in self._intervals:
                is_former = interval.before is None and not interval.is_set
                if interval.message_id == first and is_former and possible:
                    interval.before = second
                    interval.last = -np.inf
        elif first != SET_INTERVAL or second == dialect.MAV_RESULT_IN_PROGRESS or not ours:
            return
        elif self._restoring:
            if self.unconfirmed:  # in the order of the requests
                self.unconfirmed.popleft().restored = second == dialect.MAV_RESULT_ACCEPTED
        else:
            self._free = -np.inf
            latest = max(self._intervals, key=lambda interval: interval.last)
            if second != dialect.MAV_RESULT_ACCEPTED and latest.settings:
                latest.needed = 0.0
                latest.is_set = False
                self._report(latest, RateFact.RATE_REFUSED, result=second)

    def restart(self) -> None:
        """Asks for all rates again at once: the vehicle may have rebooted, and forgotten them."""
        if any(each.is_set for each in self._intervals):
            self.events.append(Fact(RateFact.RATES_ASKED_AGAIN))
        for each in self._intervals:
            each.settings = 0
            each.reached = False
            each.last = -np.inf
            each.needed = AGAIN_SHARE * each.rate

    def restore(self) -> list[bytes]:
        """Returns frames that restore each former interval that may have changed and is not confirmed as before yet."""
        self._restoring = True
        self.unconfirmed = deque(
            each for each in self._intervals if each.is_set and not each.restored
        )
        return [
            self._command(SET_INTERVAL, each.message_id, each.before or STOPPED)
            for each in self.unconfirmed
        ]

    def _command(self, command: int, first: float, second: float = 0.0) -> bytes:
        given = *self._target, command, 0, first, second, *[0.0] * 5
        return _frame(dialect.MAVLink_command_long_message(*given), GROUND_STATION)


def greeting() -> bytes:
    """Returns a HEARTBEAT, for vehicles that send only after they have received one."""
    autopilot = dialect.MAV_AUTOPILOT_INVALID
    beat = dialect.MAVLink(None).heartbeat_encode(dialect.MAV_TYPE_GCS, autopilot, 0, 0, ACTIVE)
    return _frame(beat, GREETER)


_sequence = count()


def _frame(message: Any, sender: FrameSender) -> bytes:
    link = dialect.MAVLink(None, *sender)
    link.seq = next(_sequence) % 256
    return bytes(message.pack(link))
