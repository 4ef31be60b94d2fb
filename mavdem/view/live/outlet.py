"""Outlet: a thread of its own that carries rows to one sink, so that no sink holds up the learning, or another sink."""

from __future__ import annotations

import time
from contextlib import suppress
from itertools import groupby
from threading import Event, Thread
from uuid import UUID

import rerun as rr

from mavdem.view.live.backlog import Backlog
from mavdem.view.live.blueprint import live_blueprint
from mavdem.view.live.content import Content
from mavdem.view.live.row import Channels, LogLine, Row, Status
from mavdem.view.live.sinks import Sink
from mavdem.view.live.status import status_document

MOST_ROWS = 8192
"""That wait for a sink: 20 s at 400 Hz, some 20 MB."""
MOST_LINES = 1000
"""Of the log, likewise."""
STATUS_PERIOD = 1.0
"""Seconds between two documents of the status."""
RETRY = 1.0
"""Seconds until a viewer that is not there is looked for again."""
DELIVERED_WITHIN = 5.0
"""Seconds that a batch may take to be passed on; what takes longer is on its way still."""


class Outlet:
    """Carries what it is given to a sink, a few times a second.

    Attributes:
        sink: where to.
        rows, lines: what waits to be carried there.
        status: the latest.
        trouble: why nothing arrives there, one sentence; empty while all is well.
    """

    def __init__(self, sink: Sink, channels: Channels, recording_id: UUID) -> None:
        """Opens the sink, unless it is one to be waited for; one that cannot be opened is given nothing."""
        self.sink, self._channels, self._id = sink, channels, recording_id
        self.rows, self.lines = Backlog[Row](MOST_ROWS), Backlog[LogLine](MOST_LINES)
        self.status = Status()
        self.trouble = ""
        self._contents = {channels: Content(channels)}
        self._recording: rr.RecordingStream | None = None
        self._last: Row | None = None
        self._told_dropped, self._next_status, self._next_try = 0, 0.0, 0.0
        self._closing = Event()
        if not sink.patient:
            try:
                self._open()
            except (RuntimeError, OSError) as error:
                self._give_up(f"{sink.name} cannot be written: {error}")
        self._thread = Thread(target=self._run, name=f"to {sink.name}", daemon=True)

    def begin(self) -> None:
        """Begins to carry."""
        self._thread.start()

    def end(self) -> None:
        """Begins to carry the rest there and to close; :meth:`ended` tells when that is done."""
        self._closing.set()

    def ended(self, within: float) -> bool:
        """Whether all was carried and the sink closed within so many seconds from now."""
        self._thread.join(within)
        if self._thread.is_alive():
            self.trouble = f"{self.sink.name} does not answer; what was sent last may not have arrived"
        return not self._thread.is_alive()

    def _run(self) -> None:
        while not self._closing.wait(self.sink.period):
            self._carry()
        self._next_status = 0.0
        self._carry(last=True)
        if self._recording is not None:
            self._recording.disconnect()
            self._recording = None

    def _carry(self, last: bool = False) -> None:
        """A batch; a sink that fails is given up, or looked for again."""
        try:
            if self._recording is None and not (self._may_open() and self._open()):
                return
            assert self._recording is not None
            self._send(self._recording)
            if last:
                self._contents[self._channels].end(self._recording)
            self._recording.flush(timeout_sec=DELIVERED_WITHIN)
            self.sink.delivered()
            self.trouble = ""
        except (RuntimeError, OSError) as error:
            if "timed out" in str(error):
                self.trouble = f"{self.sink.name} does not answer"
                return
            self._give_up(f"{self.sink.name} takes no more: {error}")
        except Exception as error:  # a row that cannot be drawn ends neither the view nor the flight
            self.lines.put(LogLine(self._last.time if self._last else 0.0, "ERROR", f"not drawn: {error}"))

    def _give_up(self, trouble: str) -> None:
        self.trouble = trouble
        if self._recording is not None:
            # It has failed, and so does not wait for anything; nor will it write after this.
            self._recording.disconnect()
            self._recording = None
            with suppress(OSError):
                self.sink.failed()

    def _may_open(self) -> bool:
        now = time.monotonic()
        if not self.sink.patient or now < self._next_try:
            return False
        self._next_try = now + RETRY
        return True

    def _open(self) -> bool:
        recording = rr.RecordingStream("mavdem", recording_id=self._id)
        recording.set_log_time_enabled(False)
        recording.set_log_tick_enabled(False)
        if not self.sink.open(recording):
            self.trouble = f"nobody listens at {self.sink.name}"
            return False
        self._recording = recording
        recording.send_recording_name(self._channels.title)
        for content in self._contents.values():
            content.begin(recording)
        self._lay_out(recording)
        recording.flush(timeout_sec=DELIVERED_WITHIN)
        self.sink.delivered()
        return True

    def _lay_out(self, recording: rr.RecordingStream) -> None:
        recording.send_blueprint(live_blueprint(self._channels, self._contents[self._channels].root))

    def _change(self, recording: rr.RecordingStream, channels: Channels) -> None:
        """Shows other channels from now on; their lines are no continuation of those before."""
        self._contents[self._channels].end(recording)
        self._channels = channels
        if channels not in self._contents:
            self._contents[channels] = Content(channels, f"setup_{len(self._contents) + 1}")
            self._contents[channels].begin(recording)
        self._lay_out(recording)

    def _send(self, recording: rr.RecordingStream) -> None:
        rows = self.rows.take()
        if rows:
            self._last = rows[-1]
        for channels, of_these in groupby(rows, key=lambda row: row.channels):
            if channels != self._channels:
                self._change(recording, channels)
            self._contents[channels].rows(recording, list(of_these))
        content = self._contents[self._channels]
        for line in self.lines.take():
            content.log(recording, line)
        now = time.monotonic()
        if self._last is not None and now >= self._next_status:
            self._next_status = now + STATUS_PERIOD
            dropped = self.rows.dropped
            if dropped > self._told_dropped:
                text = f"{dropped - self._told_dropped} rows are not shown here: this view could not keep up"
                content.log(recording, LogLine(self._last.time, "WARN", text))
                self._told_dropped = dropped
            document = status_document(self._channels, self.status, self._last, dropped)
            content.status(recording, self._last.time, document)
