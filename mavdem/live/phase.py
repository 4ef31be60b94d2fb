"""Whether the vehicle is in settled flight, said while it flies: ``phases`` in small steps.

What ``phases`` takes from both sides of a moment is known here half of its averaging time later, and the landing only
when it is there: the last seconds before it, which ``phases`` cuts off, are still told settled here. Where the
autopilot does not tell whether it is in the air, a vehicle that sinks may be landing, and its motors run on for a
moment on the ground: nothing is settled here until it has not sunk for ``SETTLING`` seconds, while ``phases`` knows
which sinking was no landing.
"""

from __future__ import annotations

from collections import deque
from math import inf, nan

from mavdem.ingest.meaning import ARMED, CLIMBS, IN_AIR
from mavdem.phases import AVERAGING, CARRYING, SETTLING, STEADY_CLIMB

HALF = AVERAGING / 2
OFTEN = 0.05
"""Seconds between two means at least."""
MOST = 4096
"""Samples averaged at most: 2 s at 2 kHz."""


class Flying:
    """Armed, airborne and settled, as of what was heard so far of one boot."""

    def __init__(self) -> None:
        """Begins without knowing anything."""
        self._armed, self._airborne = _Since(), _Since()
        self._beat: bool | None = None
        self._beat_time = nan
        self._said = False
        self._working = _Average()
        self._climbs = {name: _Average() for name in CLIMBS}
        self._settled_from: float | None = None

    @property
    def now(self) -> bool:
        """Whether it is in the air and, as far as that is told, armed."""
        return self._airborne.true is True and self._armed.true is not False

    def settled(self, time: float) -> bool:
        """Whether that time, s, is one of settled flight, but for the tilt."""
        return self.now and self._settled_from is not None and time >= self._settled_from

    def take_heartbeat(self, time: float, base_mode: int) -> None:
        """A HEARTBEAT of the vehicle's own type and autopilot: two in a row must agree to change what is believed."""
        state = bool(base_mode & ARMED)
        if self._beat is None or (state == self._beat and state != self._armed.true):
            self._armed.take(time if self._beat is None else self._beat_time, state)
        self._beat, self._beat_time = state, time
        self._update()

    def take_landed_state(self, time: float, state: int) -> None:
        """An EXTENDED_SYS_STATE, which is believed rather than the motors from the first that tells."""
        if state <= 0:  # the autopilot does not tell
            return
        if not self._said:
            self._airborne, self._said = _Since(), True
        self._airborne.take(time, state == IN_AIR)
        self._update()

    def take_collective(self, time: float, share: float) -> None:
        """How hard the motors work together, 0 to 1."""
        middle = self._working.take(time, share)
        if not self._said and middle is not None:
            self._airborne.take(middle[0], middle[1] > CARRYING)
            self._update()

    def take_idle(self) -> None:
        """Outputs are heard and none has moved so far: what takes off later was seen on the ground."""
        if not self._said and self._airborne.true is None:
            self._airborne.true = False

    def forget_collective(self) -> None:
        """The scale of the motors turned out to be another: whether they carry must be seen anew."""
        self._working = _Average()
        if not self._said:
            self._airborne = _Since()
            self._airborne.true = False
            self._update()

    def take_climb(self, message: str, time: float, speed: float) -> None:
        """Vertical speed, m/s, upwards, of one of the messages that tell it."""
        middle = self._climbs[message].take(time, speed)
        preferred = next((name for name, average in self._climbs.items() if average.count > 1), message)
        if message != preferred or middle is None:
            return
        at, mean = middle
        if not self._said and self._settled_from is not None and mean <= -STEADY_CLIMB:
            self._settled_from = max(self._settled_from, at + SETTLING)
        if self._settled_from is None and self.now and at >= self._start + SETTLING and mean < STEADY_CLIMB:
            self._settled_from = at

    @property
    def _start(self) -> float:
        return max(self._armed.since, self._airborne.since)

    def _update(self) -> None:
        if not self.now:
            self._settled_from = None
        elif self._settled_from is None and (
            self._start == -inf or not any(average.count > 1 for average in self._climbs.values())
        ):
            # A beginning that was not seen has no transient to cut; without vertical speeds the climb-out is not seen.
            self._settled_from = self._start + SETTLING


class _Since:
    """Whether something is true, and since when: always, where it was when it was first told."""

    def __init__(self) -> None:
        self.true: bool | None = None
        self.since = -inf

    def take(self, time: float, true: bool) -> None:
        if self.true is not None and true and not self.true:
            self.since = time
        self.true = true


class _Average:
    """The mean within ``HALF`` on either side of each sample, as soon as the second half is there."""

    def __init__(self) -> None:
        self.count = 0
        self._window: deque[tuple[float, float]] = deque(maxlen=MOST)
        self._waiting: deque[float] = deque(maxlen=MOST)
        self._told = -inf

    def take(self, time: float, value: float) -> tuple[float, float] | None:
        """The latest sample that is ``HALF`` old, its time and the mean about it; None where none is new."""
        if not abs(value) < inf or (self._window and time <= self._window[-1][0]):
            return None
        self.count += 1
        self._window.append((time, value))
        self._waiting.append(time)
        # Not after each of many: in OFTEN the mean hardly moves.
        if self._waiting[0] > time - HALF or time < self._told + OFTEN:
            return None
        self._told = time
        middle = self._waiting[0]
        while self._waiting and self._waiting[0] <= time - HALF:
            middle = self._waiting.popleft()
        while self._window[0][0] < middle - HALF:
            self._window.popleft()
        about = [value for at, value in self._window if at <= middle + HALF]
        return middle, sum(about) / len(about)
