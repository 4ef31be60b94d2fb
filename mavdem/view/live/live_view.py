"""LiveView: shows a flight while it is learned from."""

from __future__ import annotations

import atexit
import time as wall
from collections.abc import Sequence
from math import isfinite
from threading import Lock
from types import TracebackType
from uuid import uuid4

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike

from mavdem.dem import Estimate, Learned
from mavdem.live import SessionStatus
from mavdem.view.live.rows import Channels, LogLine, ViewRow
from mavdem.view.live.sink_thread import SinkThread
from mavdem.view.live.sinks import Sink

CLOSE_SECONDS = 3.0  # how long ``close`` waits for slow sinks
REBOOT_SECONDS = 2.0  # a clock that falls by more has been restarted; log lines may be a little older
REBOOT_GAP_SECONDS = 1.0  # shown between the last row before a reboot and the first after it


class Timeline:
    """Places times of the boot clock on one timeline, which continues after a reboot: flights do not overlap."""

    def __init__(self) -> None:
        self.shift = 0.0  # timeline minus boot clock, s; 0 until the vehicle reboots
        self.latest = 0.0  # time on the timeline, s
        self._started = False

    def place(self, time: float | None) -> float:
        """The place of a boot-clock time on the timeline, s; the latest one for ``None`` and non-finite times."""
        if time is None or not isfinite(time):
            return self.latest
        if self._started and time + self.shift < self.latest - REBOOT_SECONDS:
            self.shift = self.latest + REBOOT_GAP_SECONDS - time
        self.latest = max(self.latest, time + self.shift) if self._started else time
        self._started = True
        return time + self.shift


class LiveView:
    """Takes rows from the learning thread, log lines and statuses from any thread; never makes one wait.

    It opens its sinks without waiting; ``troubles`` reports those that cannot be written. Each sink has a thread and a
    bounded queue, which drops the oldest rows if the sink is too slow. Use it with ``with``, or call :meth:`close`;
    otherwise it is closed when Python ends.
    """

    def __init__(self, channels: Channels, sinks: Sequence[Sink]) -> None:
        self._timeline, self._lock = Timeline(), Lock()
        self._channels, self._closed, self._marked = channels, False, 0  # Alarms that are marked
        recording_id = uuid4()
        self._threads = [SinkThread(sink, channels, recording_id) for sink in sinks]
        atexit.register(self.close)

    def change(self, channels: Channels) -> None:
        """Sets the ``channels`` of the rows from now on; what was drawn before stays in the recording."""
        if channels != self._channels:
            self._channels = channels
            self.log("other channels are shown from here on; those before stay in the recording")

    def put(
        self,
        time: float,
        segment: int,
        outputs: ArrayLike,
        inputs: ArrayLike,
        estimate: Estimate | None = None,
        learned: Learned | None = None,
    ) -> None:
        """Shows a row of ``outputs`` (m,) and ``inputs`` (r,) at ``time``, s of the boot clock; takes microseconds.

        The number of the ``segment`` changes where samples are missing or the vehicle rebooted. ``estimate`` is of this
        sample; ``learned`` is the learner's last batch result, which contains the prior.
        """
        if self._closed:
            return
        shown, shift = self._place(time)
        # Copies, since callers may reuse their arrays.
        y, u = np.array(outputs, np.float64), np.array(inputs, np.float64)
        row = ViewRow(shown, shift, segment, y, u, estimate, learned, self._channels)
        for thread in self._threads:
            thread.rows.put(row)

    def log(self, text: str, level: str = "INFO", time: float | None = None) -> None:
        """Shows one sentence, ``text``, in the log, with a ``level`` of "INFO", "WARN" or "ERROR".

        Its ``time``, s of the boot clock, is that of the latest row by default.
        """
        if not self._closed:
            self._log(self._place(time)[0], level, text)

    def _place(self, time: float | None) -> tuple[float, float]:
        """The place of a boot-clock time on the timeline, and the shift, s."""
        with self._lock:
            before = self._timeline.shift
            shown, shift = self._timeline.place(time), self._timeline.shift
        if shift != before:
            self._log(shown, "WARN", f"rebooted: {time:.1f} s is shown as {shown:.1f} s")
        return shown, shift

    def _log(self, shown: float, level: str, text: str) -> None:
        # Names from a link need not be valid UTF-8, which Rerun requires.
        line = LogLine(shown, level, text.encode(errors="replace").decode())
        for thread in self._threads:
            thread.lines.put(line)

    def status(self, status: SessionStatus) -> None:
        """Shows the latest ``status``, once a second."""
        new = min(status.alarm_count - self._marked, len(status.alarms))
        for alarm in status.alarms[len(status.alarms) - new :]:
            with self._lock:
                began = alarm.since + self._timeline.shift
            what = f"{alarm.name} works harder" if alarm.name else "the steady torque in roll and pitch is another"
            self._log(began, "WARN", f"{what} from here on")
        self._marked = status.alarm_count
        for thread in self._threads:
            thread.status = status

    @property
    def dropped(self) -> dict[str, int]:
        """Number of rows dropped for each sink, by name."""
        return {thread.sink.name: thread.rows.dropped for thread in self._threads}

    @property
    def troubles(self) -> list[str]:
        """One sentence for each sink that receives nothing."""
        return [thread.trouble for thread in self._threads if thread.trouble]

    def close(self) -> None:
        """Sends what waits and closes the sinks; a sink that hangs is abandoned after ``CLOSE_SECONDS``."""
        if self._closed:
            return
        self._closed = True
        atexit.unregister(self.close)
        for thread in self._threads:
            thread.end()
        deadline = wall.monotonic() + CLOSE_SECONDS
        ended = [thread.ended(max(0.0, deadline - wall.monotonic())) for thread in self._threads]
        if not all(ended):
            # Otherwise Rerun waits for the hanging viewer when Python ends.
            rr.unregister_shutdown()
        for thread in self._threads:
            thread.sink.close()

    def __enter__(self) -> LiveView:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
