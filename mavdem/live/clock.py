"""The boot clock while it runs: what ``ingest.clocks`` makes of whole streams, stamp by stamp.

The stamps of attitude are the reference; all others are read against the latest of them, which undoes their wraps.
A stamp that does not continue the clock is held back with all that came with it. If the next stamps of attitude go on
from there the clock has changed: what was held back is placed on the new one, so that nothing is lost. If one continues
the old clock the doubtful ones were strays, and are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, isfinite, isnan, nan
from statistics import median
from typing import NamedTuple

from mavdem.ingest.clocks import OTHER_EPOCH, STEP_BACK, WRAP_GAP
from mavdem.ingest.live_messages import Message
from mavdem.ingest.meaning import ATTITUDE_MESSAGES
from mavdem.ingest.strays import LASTING, STRAY

MOST_HELD = 40 * LASTING
"""Messages held back at most; older ones are left out."""


class Placed(NamedTuple):
    """A message at ``time`` s of boot number ``boot``; ``stamped`` tells whether by a stamp of its own."""

    message: Message
    time: float
    boot: int
    stamped: bool


class LiveClock:
    """Places the messages of one vehicle on its boot clock.

    Attributes:
        now: the latest of the reference, s; NaN before it is known.
        boot: number of the boot, from 0 on.
        left_out: messages whose stamps were strays.
    """

    def __init__(self) -> None:
        """Begins without a clock."""
        self.now, self.boot, self.left_out = nan, 0, 0
        self._latest = nan
        self._turns = 0
        self._held: list[Message] = []
        self._run: list[float] = []
        self._agreed = 0
        self._shifts: dict[str, float] = {}
        self._off: dict[str, list[tuple[int, float]]] = {}
        self._sentences: list[str] = []

    def place(self, message: Message) -> Iterator[Placed]:
        """What can be placed now that this message is here: itself, and those before it that were held back."""
        if not message.stamp > 0:
            if not isnan(self._latest):
                yield Placed(message, self._latest, self.boot, False)
        elif message.name in ATTITUDE_MESSAGES:
            yield from self._take_reference(message)
        else:
            time = self._read(message)
            if time is None:
                self._hold(message)
            else:
                self._latest = time
                yield Placed(message, time, self.boot, True)

    def sentences(self) -> list[str]:
        """What happened to the clock since the last call."""
        told, self._sentences = self._sentences, []
        return told

    def _take_reference(self, message: Message) -> Iterator[Placed]:
        time = message.stamp + self._turns * message.period if self._turns else message.stamp
        if time < self.now - STEP_BACK and time + message.period - self.now <= WRAP_GAP:
            time += message.period
        if -STEP_BACK < time - self.now <= STRAY:
            self._turns = round((time - message.stamp) / message.period) if isfinite(message.period) else 0
            self.now = max(self.now, time)
            self._latest = time
            self._agreed += 1
            self._forget()
            yield Placed(message, time, self.boot, True)
            return
        if self._run and not -STEP_BACK < message.stamp - self._run[-1] <= STRAY:
            self._run = []
        self._run.append(message.stamp)
        self._hold(message)
        if len(self._run) >= LASTING:
            yield from self._begin_anew()

    def _begin_anew(self) -> Iterator[Placed]:
        first, before = self._run[0], self.now
        if first < before:
            self.boot += 1
            self._sentences.append(f"The vehicle rebooted when its clock read {before:.1f} s.")
        elif not isnan(before):
            self._sentences.append(
                f"For {first - before:.1f} s of the vehicle's clock, from {before:.1f} s on, nothing was heard."
            )
        held, self._held, self._run = self._held, [], []
        self._turns = 0
        self._off.clear()
        self.now = first
        started = False
        for message in held:
            if message.name in ATTITUDE_MESSAGES:
                # What was held before the run, beside it, belongs to no clock.
                if -STEP_BACK < message.stamp - self.now <= STRAY:
                    started = True
                    self.now = max(self.now, message.stamp)
                    self._latest = message.stamp
                    yield Placed(message, message.stamp, self.boot, True)
                else:
                    self.left_out += 1
            elif (time := self._read(message)) is not None and (started or time >= first - STEP_BACK):
                self._latest = time
                yield Placed(message, time, self.boot, True)
            else:
                self.left_out += 1

    def _read(self, message: Message) -> float | None:
        """The time of another message by the reference; None where it is far off."""
        if isnan(self.now):
            return None
        shift = self._shifts.get(message.name, 0.0)
        time = _near(message.stamp + shift, message.period, self.now)
        if abs(time - self.now) <= STRAY:
            self._off.pop(message.name, None)
            return time
        # Only what the reference has agreed to in between speaks of another clock: else it is the reference that is
        # about to change.
        offs = self._off.setdefault(message.name, [])
        if not offs or offs[-1][0] != self._agreed:
            if offs and abs(message.stamp - self.now - offs[-1][1]) > STRAY:
                offs.clear()
            offs.append((self._agreed, message.stamp - self.now))
        if len(offs) > LASTING:
            away = median(off for _, off in offs)
            self._shifts[message.name] = -away if abs(away) > OTHER_EPOCH else 0.0
            self._off.pop(message.name)
            self._sentences.append(
                f"The time stamps of {message.name} are of another clock, {away:.6g} s away; they are moved to the "
                "boot clock."
            )
        return None

    def _hold(self, message: Message) -> None:
        self._held.append(message)
        if len(self._held) > MOST_HELD:
            del self._held[0]
            self.left_out += 1

    def _forget(self) -> None:
        self.left_out += len(self._held)
        self._held, self._run = [], []


def _near(seconds: float, period: float, near: float) -> float:
    """The stamp, whole periods added so that it lies nearest to the time given."""
    return seconds if period == inf else seconds + period * round((near - seconds) / period)
