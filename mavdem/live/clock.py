"""The boot clock while it runs: what ``ingest.mavlink.clocks`` does to whole streams, message by message.

The stamps of attitude are the reference. All other stamps are placed nearest to the latest of them, which undoes their
wraps. A stamp that does not continue the clock is held back, with all messages that follow. If the next attitude stamps
continue from there, the clock has changed, and the held messages are placed on the new clock. If one continues the old
clock, the held stamps were outliers and are dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import isfinite, isnan, nan
from statistics import median
from typing import NamedTuple

from mavdem.alignment.signals import ATTITUDE_MESSAGES
from mavdem.ingest.mavlink.clocks import MAX_OFFSET, MIN_RESET_STAMPS, OTHER_EPOCH, STEP_BACK, WRAP_GAP
from mavdem.live.messages import LiveMessage

MAX_HELD = 40 * MIN_RESET_STAMPS  # Messages held back; beyond it the oldest are dropped


class LiveStamp(NamedTuple):
    """A ``message`` at ``time`` s of boot number ``boot``; ``stamped`` if the time is from its own stamp."""

    message: LiveMessage
    time: float
    boot: int
    stamped: bool


class LiveClock:
    """Places the messages of one vehicle on its boot clock; ``report`` is called with each sentence about it.

    ``now``: the latest reference stamp, s; NaN before the first. ``boot``: number of the boot, from 0 on. ``outliers``:
    messages dropped for their stamps.
    """

    def __init__(self, report: Callable[[str], None]) -> None:
        self.now, self.boot, self.outliers = nan, 0, 0
        self._latest, self._turns, self._accepted = nan, 0, 0
        self._held: list[LiveMessage] = []
        self._run: list[float] = []
        self._shifts: dict[str, float] = {}
        self._far: dict[str, list[tuple[int, float]]] = {}
        self._report = report

    def place(self, message: LiveMessage) -> Iterator[LiveStamp]:
        """What can be placed after this message: itself, and messages held back before."""
        if not message.stamp > 0:
            if not isnan(self._latest):
                yield LiveStamp(message, self._latest, self.boot, False)
        elif message.name in ATTITUDE_MESSAGES:
            yield from self._place_reference(message)
        else:
            time = self._time_of(message)
            if time is None:
                self._hold(message)
            else:
                yield self._stamp(message, time)

    def _stamp(self, message: LiveMessage, time: float) -> LiveStamp:
        self._latest = time
        return LiveStamp(message, time, self.boot, True)

    def _continues(self, time: float, before: float) -> bool:
        return -STEP_BACK < time - before <= MAX_OFFSET

    def _place_reference(self, message: LiveMessage) -> Iterator[LiveStamp]:
        time = message.stamp + self._turns * message.period if self._turns else message.stamp
        if time < self.now - STEP_BACK and time + message.period - self.now <= WRAP_GAP:
            time += message.period
        if self._continues(time, self.now):
            self._turns = round((time - message.stamp) / message.period) if isfinite(message.period) else 0
            self.now = max(self.now, time)
            self._accepted += 1
            self.outliers += len(self._held)
            self._held, self._run = [], []
            yield self._stamp(message, time)
            return
        if self._run and not self._continues(message.stamp, self._run[-1]):
            self._run = []
        self._run.append(message.stamp)
        self._hold(message)
        if len(self._run) >= MIN_RESET_STAMPS:
            yield from self._restart()

    def _restart(self) -> Iterator[LiveStamp]:
        """Starts the clock again at the first of the held stamps that continue each other."""
        first, before = self._run[0], self.now
        if first < before:
            self.boot += 1
            self._report(f"The vehicle rebooted when its clock read {before:.1f} s.")
        elif not isnan(before):
            self._report(
                f"Nothing was received for {first - before:.1f} s of the vehicle's clock, from {before:.1f} s on."
            )
        held, self._held, self._run = self._held, [], []
        self._turns = 0
        self._far.clear()
        self.now = first
        started = False
        for message in held:
            time: float | None = message.stamp
            if message.name in ATTITUDE_MESSAGES:
                # Held stamps that do not continue the run belong to no clock.
                placed = self._continues(message.stamp, self.now)
                if placed:
                    started = True
                    self.now = max(self.now, message.stamp)
            else:
                time = self._time_of(message)
                placed = time is not None and (started or time >= first - STEP_BACK)
            if placed and time is not None:
                yield self._stamp(message, time)
            else:
                self.outliers += 1

    def _time_of(self, message: LiveMessage) -> float | None:
        """The time of another message by the reference; None if it is far off."""
        if isnan(self.now):
            return None
        time = message.stamp + self._shifts.get(message.name, 0.0)
        if isfinite(message.period):
            time += message.period * round((self.now - time) / message.period)
        if abs(time - self.now) <= MAX_OFFSET:
            self._far.pop(message.name, None)
            return time
        # Count each accepted reference stamp once: otherwise it may be the reference that is about to change.
        far = self._far.setdefault(message.name, [])
        if not far or far[-1][0] != self._accepted:
            if far and abs(message.stamp - self.now - far[-1][1]) > MAX_OFFSET:
                far.clear()
            far.append((self._accepted, message.stamp - self.now))
        if len(far) > MIN_RESET_STAMPS:
            away = median(offset for _, offset in far)
            self._shifts[message.name] = -away if abs(away) > OTHER_EPOCH else 0.0
            self._far.pop(message.name)
            self._report(
                f"The time stamps of {message.name} are of another clock, {away:.6g} s away; they are moved to the "
                "boot clock."
            )
        return None

    def _hold(self, message: LiveMessage) -> None:
        self._held.append(message)
        if len(self._held) > MAX_HELD:
            del self._held[0]
            self.outliers += 1
