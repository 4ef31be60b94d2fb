"""The queue of received frames that wait for analysis in a live session, and the tasks that are put off meanwhile."""

from collections import deque
from math import inf

import numpy as np

from mavdem.assessment.repeated_reports import REPEAT_SECONDS
from mavdem.facts import Fact
from mavdem.facts.session import DelayedWork, SessionFact
from mavdem.live import clock
from mavdem.live.alarm_delay import AlarmDelay
from mavdem.live.history import MAX_ROWS
from mavdem.live.intake import FrameBatch
from mavdem.live.link import SILENCE_SECONDS
from mavdem.live.session_state import Latency
from mavdem.live.vehicle_selection import Component

STEP_SECONDS = 0.02
"""Duration of analysis between two looks at the link, and of arrival that is analysed at once, s: a choice."""

POSTPONING_DELAYS = {
    DelayedWork.PHYSICAL_FITS: 0.5,
    DelayedWork.REFITS: 1.0,
    DelayedWork.PLOTS: 2.0,
    DelayedWork.ESTIMATES: 3.0,
}
"""Delay of the analysis from which on a task is put off, until the delay is half of that, s: a choice.

First fits wait, then pictures, then estimates, so that motors and messages are always judged in time.
"""

SUSPENSION_DELAY = 0.1
"""Delay of the analysis from which on the process that learns is paused, until it is below ``STEP_SECONDS``, s.

It is a fifth of the first delay above: a fit that runs takes longer, and no task has to be put off.
"""

BEHIND_DELAY = POSTPONING_DELAYS[DelayedWork.REFITS]
"""Delay of the analysis from which on the computer is reported to be too slow, s."""

CATCH_UP_SECONDS = 10.0
"""Time from the beginning of a session that begins late within which its delay is not reported, s: a choice."""


class Backlog:
    """The queue of received frames in the order of arrival, and the tasks that are put off while they wait for long.

    Attributes:
        postponed_tasks: the tasks that are put off now.
        longest_delay: the longest time that frames have waited, s.
        alarm_delay: by how much alarms come late, held for some seconds.
        suspends_learning: whether the process that learns is to be paused, so that the analysis has its time.
    """

    def __init__(self, *, begins_late: bool = False) -> None:
        """Makes an empty backlog, of an analysis that keeps up.

        Args:
            begins_late: whether the session first analyses frames from before its beginning.
        """
        self.postponed_tasks = set[DelayedWork]()
        self.longest_delay = 0.0
        self.alarm_delay = AlarmDelay()
        self.suspends_learning = False
        self._batches: deque[FrameBatch] = deque()
        # Whether nothing waits in the link to be added.
        self._is_link_empty = True
        # When the latest frames arrived, s of the monotonic clock.
        self._latest_arrival = -inf
        # When the analysis was last late by ``BEHIND_DELAY``, s of the monotonic clock; None while it keeps up.
        self._latest_late_time: float | None = None
        # When a delay was reported last, s of that clock.
        self._report_time = 0.0
        # The delay that was reported then, s.
        self._reported_delay = 0.0
        # A delay until this time, s of that clock, is due to frames that were sent before the session.
        self._catch_up_end = clock.monotonic() + (CATCH_UP_SECONDS if begins_late else 0.0)

    def __len__(self) -> int:
        """The number of batches that wait."""
        return len(self._batches)

    @property
    def analysed_until(self) -> float:
        """Time until which all that arrived has been analysed, s of the monotonic clock: now if nothing waits."""
        if self._batches:
            return self._batches[0].arrival_time
        if not self._is_link_empty:
            # What waits in the link arrived later than everything that was received.
            return self._latest_arrival
        return clock.monotonic()

    def latest_arrival_from(self, vehicle: Component | None) -> float | None:
        """Returns when the latest waiting batch with a frame of a vehicle arrived.

        Args:
            vehicle: the vehicle; None for any sender.

        Returns:
            The time, s of the monotonic clock; None if no such batch waits.
        """
        for batch in reversed(self._batches):
            is_from_vehicle = vehicle is None or any(
                vehicle.has_sent(frame) for frame in batch.frames
            )
            if is_from_vehicle:
                return batch.arrival_time
        return None

    @property
    def is_late(self) -> bool:
        """Whether any task is put off."""
        return bool(self.postponed_tasks)

    @property
    def delay(self) -> float:
        """How long the oldest frames that are not analysed have waited, s; 0 if none wait."""
        return clock.monotonic() - self.analysed_until

    def add(self, batches: list[FrameBatch], *, is_link_empty: bool = True) -> None:
        """Adds received frames to the queue.

        Args:
            batches: frames by the time of their arrival, the oldest first.
            is_link_empty: whether all that has arrived is received now. Otherwise more waits in the link, so that the
                analysis has not caught up even when the queue is empty.
        """
        self._is_link_empty = is_link_empty
        self._batches += batches
        if batches:
            self._latest_arrival = batches[-1].arrival_time

    def pop_simultaneous(self) -> list[FrameBatch]:
        """Removes the oldest batch and those that arrived less than ``STEP_SECONDS`` after it, and returns them.

        They are analysed together, as if they had arrived at once. Some links send each frame in a datagram of its own;
        the fixed cost of analysing a batch would then exceed the cost of its frames. The backlog must not be empty.

        Returns:
            One batch or more, in the order of arrival.
        """
        first_arrival = self._batches[0].arrival_time
        batches = []
        while self._batches and self._batches[0].arrival_time - first_arrival <= STEP_SECONDS:
            batches.append(self._batches.popleft())
        return batches

    def postpones(self, task: DelayedWork) -> bool:
        """Returns whether a task, such as the drawing of plots, is put off now, since the analysis is late."""
        return task in self.postponed_tasks

    def update(self, dropped_datagrams: int) -> Fact | None:
        """Measures the delay of the analysis, decides which tasks wait for it, and returns what to tell the user.

        The delay is how long the oldest frame that is not analysed has waited.

        Args:
            dropped_datagrams: number of datagrams lost so far, because they were not read in time.

        Returns:
            The fact that this computer is too slow, or that it keeps up again; None if there is nothing new. While a
            session that began late catches up, its delay is expected, and nothing is reported.
        """
        now = clock.monotonic()
        delay = now - self.analysed_until
        self.longest_delay = max(self.longest_delay, delay)
        self.alarm_delay.update(delay, now)
        self._postpone_tasks(delay)
        is_delay_expected = now < self._catch_up_end
        if is_delay_expected:
            return None
        if delay >= BEHIND_DELAY:
            return self._report_of_delay(delay, now)
        return self._report_of_recovery(dropped_datagrams, now)

    def _postpone_tasks(self, delay: float) -> None:
        """Decides which tasks wait until the analysis has caught up, and whether the process that learns is paused.

        Learning is resumed at a smaller delay than it is paused, so that it does not change all the time.

        Args:
            delay: how long the oldest frame that is not analysed has waited, s.
        """
        self.postponed_tasks = _tasks_to_postpone(delay, self.postponed_tasks)
        if delay >= SUSPENSION_DELAY:
            self.suspends_learning = True
        elif delay < STEP_SECONDS:
            self.suspends_learning = False

    def _report_of_delay(self, delay: float, now: float) -> Fact | None:
        """Returns the report that the analysis is late, if that is new or the delay has doubled since the last report.

        A doubled delay is reported at most once in ``REPEAT_SECONDS``: the user must know that alarms come so late. The
        delay is stored, for the next call.

        Args:
            delay: present delay of the analysis, s, which is at least ``BEHIND_DELAY``.
            now: present time, s of the monotonic clock.
        """
        is_new = self._latest_late_time is None
        has_doubled = delay >= 2 * self._reported_delay
        is_repetition_due = now - self._report_time >= REPEAT_SECONDS
        self._latest_late_time = now
        if not is_new and not (has_doubled and is_repetition_due):
            return None
        self._report_time = now
        self._reported_delay = delay
        return Fact(SessionFact.COMPUTER_BEHIND, delay=delay)

    def _report_of_recovery(self, dropped_datagrams: int, now: float) -> Fact | None:
        """Returns the report that the analysis keeps up again, once, after ``REPEAT_SECONDS`` without a long delay.

        Messages must come in that time: a silent link does not show whether this computer would keep up. So in a
        silence the time begins again. With the wait, a delay around the limit is not reported again and again.

        Args:
            dropped_datagrams: number of datagrams lost so far, because they were not read in time.
            now: present time, s of the monotonic clock, at which the analysis is not late.
        """
        if self._latest_late_time is None:
            # The analysis was not late since the last such report.
            return None
        is_silent = now - self._latest_arrival > SILENCE_SECONDS
        if is_silent:
            self._latest_late_time = now
            return None
        if now - self._latest_late_time < REPEAT_SECONDS:
            return None
        self._latest_late_time = None
        return Fact(
            SessionFact.COMPUTER_KEEPS_UP,
            delay=self.longest_delay,
            datagrams=dropped_datagrams,
        )


def _tasks_to_postpone(delay: float, postponed_tasks: set[DelayedWork]) -> set[DelayedWork]:
    """Returns the tasks to postpone: those whose limit in ``POSTPONING_DELAYS`` the delay of the analysis has reached.

    A task that is postponed already waits until the delay is half of its limit: with one limit for both, tasks would be
    stopped and resumed all the time.

    Args:
        delay: how long the oldest frame that is not analysed has waited, s.
        postponed_tasks: the tasks that are postponed so far.
    """
    tasks = set()
    for task, limit in POSTPONING_DELAYS.items():
        threshold = limit
        if task in postponed_tasks:
            threshold = limit / 2
        if delay >= threshold:
            tasks.add(task)
    return tasks


class LatencyMeter:
    """Measures the time from the arrival of a packet to the estimate that it completes."""

    def __init__(self) -> None:
        self._latest = deque[float](maxlen=MAX_ROWS)
        self._longest = 0.0

    def add(self, seconds: float) -> None:
        """Adds the latency of one row."""
        self._latest.append(seconds)
        self._longest = max(self._longest, seconds)

    def clear(self) -> None:
        """Forgets the latest latencies; the longest stays."""
        self._latest.clear()

    @property
    def latency(self) -> Latency:
        """Median and 99th percentile of the latest rows, and the longest of all, s; NaN without any."""
        if not self._latest:
            return Latency()
        median, p99 = np.percentile(self._latest, [50, 99]).tolist()
        return Latency(median, p99, self._longest)
