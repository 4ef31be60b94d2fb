"""LiveView: shows a flight while it is learnt from."""

from __future__ import annotations

import atexit
import time as wall
from collections.abc import Sequence
from threading import Lock
from types import TracebackType
from uuid import uuid4

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike

from mavdem.dem import Estimate, Learned
from mavdem.view.live.clock import Clock
from mavdem.view.live.outlet import Outlet
from mavdem.view.live.row import Channels, LogLine, Row, Status
from mavdem.view.live.sinks import Sink

CLOSED_WITHIN = 3.0
"""Seconds that :meth:`LiveView.close` waits for slow sinks."""


class LiveView:
    """Takes rows from the learning thread, log lines and status from any, and never makes one wait.

    Each sink has a thread and a bounded queue, which drops the oldest rows when the sink cannot keep up. After a reboot
    of the vehicle time goes on where it was; status and log say by how much.

    Used with ``with``, or closed by :meth:`close`, or, last of all, when Python ends.
    """

    def __init__(self, channels: Channels, sinks: Sequence[Sink]) -> None:
        """Opens the sinks, and waits for none that is not there yet; of one that cannot be written ``troubles`` tell.

        Args:
            channels: what the numbers are.
            sinks: where to show and record.
        """
        self._clock, self._lock = Clock(), Lock()
        self._channels, self._closed = channels, False
        recording_id = uuid4()
        self._outlets = [Outlet(sink, channels, recording_id) for sink in sinks]
        for outlet in self._outlets:
            outlet.begin()
        atexit.register(self.close)

    def change(self, channels: Channels) -> None:
        """Says what rows are of from now on: other channels are shown instead of those before, which stay recorded.

        Args:
            channels: what the numbers are; nothing changes with those there are.
        """
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
        """Shows a row; returns in microseconds.

        Args:
            time: boot clock, s.
            segment: a number that changes where samples are missing or the vehicle rebooted.
            outputs: (m,).
            inputs: (r,).
            estimate: of this sample; ``None`` where there is none.
            learned: the learner's last whole learning, which tells what the prior left to the data.
        """
        if self._closed:
            return
        shown, shift = self._shown(time)
        # Copied, since callers may use their arrays again.
        y, u = np.array(outputs, np.float64), np.array(inputs, np.float64)
        row = Row(shown, shift, segment, y, u, estimate, learned, self._channels)
        for outlet in self._outlets:
            outlet.rows.put(row)

    def log(self, text: str, level: str = "INFO", time: float | None = None) -> None:
        """Shows a line in the log.

        Args:
            text: one sentence.
            level: "INFO", "WARN" or "ERROR".
            time: boot clock, s; that of the latest row unless given.
        """
        if not self._closed:
            self._line(self._shown(time)[0], level, text)

    def _shown(self, time: float | None) -> tuple[float, float]:
        """Where a time of the boot clock is shown, and how far from there that is, s."""
        with self._lock:
            before = self._clock.shift
            shown, shift = self._clock.shown(time), self._clock.shift
        if shift != before:
            self._line(shown, "WARN", f"rebooted: {time:.1f} s is shown as {shown:.1f} s")
        return shown, shift

    def _line(self, shown: float, level: str, text: str) -> None:
        # A name from a link need not be UTF-8, and what Rerun is given must be.
        line = LogLine(shown, level, text.encode(errors="replace").decode())
        for outlet in self._outlets:
            outlet.lines.put(line)

    def status(self, status: Status) -> None:
        """Shows how the link fares, once a second.

        Args:
            status: as of now; the latest is shown.
        """
        for outlet in self._outlets:
            outlet.status = status

    @property
    def dropped(self) -> dict[str, int]:
        """How many rows each sink, by name, could not be given."""
        return {outlet.sink.name: outlet.rows.dropped for outlet in self._outlets}

    @property
    def troubles(self) -> list[str]:
        """Why a sink is given nothing, a sentence for each that is not."""
        return [outlet.trouble for outlet in self._outlets if outlet.trouble]

    def close(self) -> None:
        """Sends what waits, closes files and connections; a sink that hangs is left alone after three seconds."""
        if self._closed:
            return
        self._closed = True
        atexit.unregister(self.close)
        for outlet in self._outlets:
            outlet.end()
        deadline = wall.monotonic() + CLOSED_WITHIN
        hanging = [o for o in self._outlets if not o.ended(max(0.0, deadline - wall.monotonic()))]
        if hanging:
            # Rerun would wait for it when Python ends, as long as the viewer hangs.
            rr.unregister_shutdown()
        for outlet in self._outlets:
            outlet.sink.close()

    def __enter__(self) -> LiveView:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
