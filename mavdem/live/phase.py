"""Whether the vehicle is in settled flight, while it flies: ``alignment.phases`` in small steps.

``phases`` averages over both sides of a moment, so live the mean is known half the averaging time later. A landing is
known only once it has happened: the last seconds before it, which ``phases`` cuts off, are taken back then. While the
autopilot does not report whether it is in the air, a vehicle that descends may be landing, and its motors keep turning
on the ground for a moment. Then nothing is settled until it has not descended for ``TRANSIENT_SECONDS``, while
``phases`` sees which descent was no landing. Without a vertical speed it may be landing in a mode that lands, on
standby, and when its motors fall far below their level in flight.
"""

from __future__ import annotations

from collections import deque
from math import inf, nan

from mavdem.alignment.phases import (
    AVERAGING_SECONDS,
    CLIMB_OUT_SPEED,
    REPORT_SECONDS,
    TRANSIENT_SECONDS,
    airborne_collective,
)
from mavdem.alignment.signals import CLIMB_FIELDS
from mavdem.ingest.vocabulary import ACTIVE, ARMED, CUSTOM_MODE, IN_AIR, LANDING_MODES, OFF_GROUND, STANDBY
from mavdem.live.history import FLIGHT_UNKNOWN, NOT_FLYING

HALF_AVERAGING_SECONDS = AVERAGING_SECONDS / 2
MIN_UPDATE_SECONDS = 0.05  # Between two means: the mean hardly changes faster
TOUCHDOWN_SHARE = 0.5
"""Of the collective in flight: in the air a multirotor carries its weight, on the ground it idles at a third."""
TOUCHDOWN_SECONDS = 0.2  # Time constant over which the collective is averaged for that
MAX_SAMPLES = 4096  # Samples averaged: 2 s at 2 kHz


class LivePhase:
    """Whether one boot is armed, airborne and settled, from its messages so far.

    ``least_collective``: of a vehicle in the air, 0 to 1; the caller sets it by the autopilot's parameters.
    """

    def __init__(self) -> None:
        self.least_collective = airborne_collective({})
        self._armed, self._airborne = _SinceWhen(), _SinceWhen()
        self._steady = _SinceWhen()  # airborne, and neither taking off nor landing where that is reported
        self._beat: bool | None = None
        self._beat_time = nan
        self._reported_until = -inf  # While EXTENDED_SYS_STATE comes, it decides; otherwise the motors' thrust
        self._collective = _Average()
        self._climbs = {name: _Average() for name in CLIMB_FIELDS}
        self._settled_from: float | None = None
        self._climb_until = -inf  # As ``_reported_until``, for the vertical speed
        self._was_steady = self._was_active = self._may_land = False
        self._level, self._levels = 0.0, 0  # Mean collective in settled flight, and of how many values
        self._share, self._share_time = nan, nan
        self._taken_back: float | None = None

    def evident(self, time: float) -> bool:
        """Whether EXTENDED_SYS_STATE or a vertical speed comes at ``time``, s."""
        return time <= max(self._reported_until, self._climb_until)

    @property
    def flying(self) -> bool:
        """Whether it is airborne and, if that is reported, armed."""
        return self._airborne.true is True and self._armed.true is not False

    @property
    def obstacle(self) -> str:
        """Why it is not flying, one sentence; empty if it is."""
        known = self._airborne.true is not None or self._armed.true is False
        return "" if self.flying else NOT_FLYING if known else FLIGHT_UNKNOWN

    @property
    def steady(self) -> bool:
        """Whether it is flying, and neither takes off nor lands where that is reported."""
        return self.flying and self._steady.true is True

    def settled(self, time: float) -> bool:
        """Whether ``time``, s, is in settled flight, apart from the tilt."""
        return self.steady and self._settled_from is not None and time >= self._settled_from

    def taken_back(self) -> float | None:
        """The time, s, since which samples that counted as settled were of a landing; None if there is no new one."""
        since, self._taken_back = self._taken_back, None
        return since

    def take_heartbeat(self, time: float, autopilot: int, base_mode: int, mode: int = 0, state: int = 0) -> None:
        """A HEARTBEAT of the vehicle's own type and autopilot: only two equal ones in a row change the state.

        It contains the MAV_AUTOPILOT, the base mode, the custom ``mode`` and the MAV_STATE.
        """
        # Some vehicles are on standby always.
        self._was_active |= state == ACTIVE
        lands = bool(base_mode & CUSTOM_MODE) and mode in LANDING_MODES.get(autopilot, ())
        lands |= self._was_active and state == STANDBY
        if lands and self._may_land and not self.evident(time):
            self._unsettle(time)
        self._may_land = lands
        armed = bool(base_mode & ARMED)
        since = time if self._beat is None else self._beat_time
        if self._beat in (None, armed) and armed != self._armed.true:
            self._armed.take(since, armed)
        self._beat, self._beat_time = armed, time
        self._update(since)

    def take_landed_state(self, time: float, state: int) -> None:
        """An EXTENDED_SYS_STATE: until ``REPORT_SECONDS`` after it, it replaces the motors as evidence."""
        if state <= 0:  # undefined
            self._reported_until = -inf
            return
        self._reported_until = time + REPORT_SECONDS
        self._take_airborne(time, state in OFF_GROUND, state == IN_AIR)

    def take_collective(self, time: float, share: float) -> None:
        """The collective of the motors, 0 to 1."""
        mean = self._collective.take(time, share)
        if mean is not None and mean[0] > self._reported_until:
            carried = mean[1] > self.least_collective
            self._take_airborne(mean[0], carried, carried)
        if mean is not None and self.settled(mean[0]):
            self._levels += 1
            self._level += (mean[1] - self._level) / self._levels
        if not abs(share) < inf:
            return
        weight = min((time - self._share_time) / TOUCHDOWN_SECONDS, 1.0)
        self._share = self._share + weight * (share - self._share) if 0 < weight < 1 else share
        self._share_time = time
        if self._share < TOUCHDOWN_SHARE * self._level and not self.evident(time):
            if self.settled(time):
                self._take_back(time)
            self._unsettle(time)

    def take_idle(self) -> None:
        """Outputs arrive and none has moved so far: the vehicle is on the ground."""
        if self._reported_until == -inf and self._airborne.true is None:
            self._airborne.true = self._steady.true = False

    def reset_collective(self) -> None:
        """The scale of the motors has changed: whether they carry the vehicle is unknown again."""
        self._collective = _Average()
        if self._reported_until == -inf:
            self._airborne, self._steady = _SinceWhen(), _SinceWhen()
            self._airborne.true = self._steady.true = self._was_steady = False
            self._update(nan)

    def take_climb(self, message: str, time: float, speed: float) -> None:
        """Vertical speed, m/s, upwards, from one of the messages that contain it."""
        if not abs(speed) < inf:
            return
        mean = self._climbs[message].take(time, speed)
        self._climb_until = time + REPORT_SECONDS
        coming = (name for name, average in self._climbs.items() if average.comes(time))
        preferred = next(coming, message)
        if message != preferred or mean is None:
            return
        at, climb = mean
        reported = at <= self._reported_until
        if not reported and climb <= -CLIMB_OUT_SPEED:
            self._unsettle(at)
        if self._settled_from is None and self.steady and climb < CLIMB_OUT_SPEED:
            self._settled_from = at if at >= self._start + TRANSIENT_SECONDS else None

    @property
    def _start(self) -> float:
        return max(self._armed.since, self._steady.since)

    def _take_airborne(self, time: float, airborne: bool, steady: bool) -> None:
        self._airborne.take(time, airborne)
        self._steady.take(time, steady)
        self._update(time)

    def _unsettle(self, time: float) -> None:
        """It may be landing at ``time``."""
        if self._settled_from is not None:
            self._settled_from = max(self._settled_from, time + TRANSIENT_SECONDS)

    def _take_back(self, time: float) -> None:
        """It landed at ``time``; the earlier of two landings counts where neither was fetched."""
        since = time - TRANSIENT_SECONDS
        self._taken_back = since if self._taken_back is None else min(since, self._taken_back)

    def _update(self, time: float) -> None:
        if self._was_steady and not self.steady:
            self._take_back(time)
            self._level, self._levels = 0.0, 0
        self._was_steady = self.steady
        if not self.steady:
            self._settled_from = None
        elif self._settled_from is None and (
            self._start == -inf or not any(average.count > 1 for average in self._climbs.values())
        ):
            # A take-off before the first message has no transient to cut; without vertical speed the climb is unknown.
            self._settled_from = self._start + TRANSIENT_SECONDS


class _SinceWhen:
    """Whether something is true, and since when; -inf if it was true in the first message about it."""

    def __init__(self) -> None:
        self.true: bool | None = None
        self.since = -inf

    def take(self, time: float, true: bool) -> None:
        if self.true is False and true:
            self.since = time
        self.true = true


class _Average:
    """The mean within ``HALF_AVERAGING_SECONDS`` on either side of a sample, once the later half is there."""

    def __init__(self) -> None:
        self.count = 0
        self._window: deque[tuple[float, float]] = deque(maxlen=MAX_SAMPLES)
        self._waiting: deque[float] = deque(maxlen=MAX_SAMPLES)
        self._updated = -inf

    def comes(self, time: float) -> bool:
        """Whether samples still come at ``time``, s."""
        return self.count > 1 and time - self._window[-1][0] <= REPORT_SECONDS

    def take(self, time: float, value: float) -> tuple[float, float] | None:
        """Time and mean of the latest sample with both halves; None if there is no new one."""
        if not abs(value) < inf or (self._window and time <= self._window[-1][0]):
            return None
        self.count += 1
        self._window.append((time, value))
        self._waiting.append(time)
        if self._waiting[0] > time - HALF_AVERAGING_SECONDS or time < self._updated + MIN_UPDATE_SECONDS:
            return None
        self._updated = time
        middle = self._waiting[0]
        while self._waiting and self._waiting[0] <= time - HALF_AVERAGING_SECONDS:
            middle = self._waiting.popleft()
        while self._window[0][0] < middle - HALF_AVERAGING_SECONDS:
            self._window.popleft()
        around = [value for at, value in self._window if at <= middle + HALF_AVERAGING_SECONDS]
        return middle, sum(around) / len(around)
