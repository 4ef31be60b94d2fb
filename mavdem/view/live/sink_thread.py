"""SinkThread: a thread that sends rows to one sink, so that a slow sink delays neither learning nor other sinks."""

from __future__ import annotations

import time
from collections import deque
from contextlib import suppress
from itertools import groupby
from threading import Event, Lock, Thread
from typing import Generic, TypeVar
from uuid import UUID

import rerun as rr

from mavdem.live import SessionStatus
from mavdem.view.live.blueprint import live_blueprint
from mavdem.view.live.content import Content
from mavdem.view.live.figures import figures, status_document
from mavdem.view.live.rows import Channels, LogLine, ViewRow
from mavdem.view.live.sinks import Sink

MAX_ROWS = 8192  # rows that wait for a sink: 20 s at 400 Hz, about 20 MB
MAX_LINES = 1000  # log lines that wait for a sink
STATUS_SECONDS = 1.0  # between two status documents
RETRY_SECONDS = 1.0  # between two attempts to reach a viewer
FLUSH_SECONDS = 5.0  # time limit for sending a batch; a slower one is still under way

Item = TypeVar("Item")


class Backlog(Generic[Item]):
    """A queue between two threads, of at most ``size`` items; neither thread waits for the other."""

    def __init__(self, size: int) -> None:
        self._items: deque[Item] = deque(maxlen=size)
        self.dropped = 0  # number of items
        # Held for an append or a swap only.
        self._lock = Lock()

    def put(self, item: Item) -> None:
        """Adds an item; drops the oldest if the queue is full."""
        with self._lock:
            self.dropped += len(self._items) == self._items.maxlen
            self._items.append(item)

    def take(self) -> list[Item]:
        """Removes and returns all items, oldest first."""
        with self._lock:
            taken, self._items = self._items, deque(maxlen=self._items.maxlen)
        return list(taken)


class SinkThread:
    """Sends rows, log lines and the status to a sink, a few times a second; one that cannot be opened gets nothing."""

    def __init__(self, sink: Sink, channels: Channels, recording_id: UUID) -> None:
        self.sink, self._channels, self._id = sink, channels, recording_id
        self.rows, self.lines = Backlog[ViewRow](MAX_ROWS), Backlog[LogLine](MAX_LINES)
        self.status = SessionStatus()
        self.trouble = ""  # why nothing arrives, one sentence
        self._contents = {channels: Content(channels)}
        self._recording: rr.RecordingStream | None = None
        self._last: ViewRow | None = None
        self._until: float | None = None  # Time of the last sample that the latest model was learnt from, s
        self._reported_drops, self._next_status, self._next_try = 0, 0.0, 0.0
        self._closing = Event()
        self._thread = Thread(target=self._run, name=f"to {sink.name}", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Starts to send the rest and to close; see :meth:`ended`."""
        self._closing.set()

    def ended(self, within: float) -> bool:
        """Whether all is sent and the sink closed within so many seconds from now."""
        self._thread.join(within)
        if self._thread.is_alive():
            self.trouble = f"{self.sink.name} does not respond; the last rows may be missing"
        return not self._thread.is_alive()

    def _run(self) -> None:
        # Here, since Rerun takes a third of a second the first time, in which the caller receives samples.
        if not self.sink.retried:
            try:
                self._open()
            except (RuntimeError, OSError) as error:
                self._give_up(f"{self.sink.name} cannot be written: {error}")
        while not self._closing.wait(self.sink.period):
            self._send_batch()
        self._next_status = 0.0
        self._send_batch(last=True)
        if self._recording is not None:
            self._recording.disconnect()
            self._recording = None

    def _send_batch(self, last: bool = False) -> None:
        """Sends what waits; gives up a sink that fails, or retries it later."""
        try:
            if self._recording is None:
                now = time.monotonic()
                if not self.sink.retried or now < self._next_try:
                    return
                self._next_try = now + RETRY_SECONDS
                if not self._open():
                    return
            assert self._recording is not None
            self._send(self._recording)
            if last:
                self._contents[self._channels].end(self._recording)
            self._recording.flush(timeout_sec=FLUSH_SECONDS)
            self.sink.delivered()
            self.trouble = ""
        except (RuntimeError, OSError) as error:
            if "timed out" in str(error):
                self.trouble = f"{self.sink.name} does not respond"
                return
            self._give_up(f"{self.sink.name} failed: {error}")
        except Exception as error:  # a row that cannot be drawn ends neither the view nor the flight
            self.lines.put(LogLine(self._last.time if self._last else 0.0, "ERROR", f"not drawn: {error}"))

    def _give_up(self, trouble: str) -> None:
        self.trouble = trouble
        if self._recording is not None:
            # A failed recording disconnects without waiting, and writes nothing more.
            self._recording.disconnect()
            self._recording = None
            with suppress(OSError):
                self.sink.failed()

    def _open(self) -> bool:
        recording = rr.RecordingStream("mavdem", recording_id=self._id)
        recording.set_log_time_enabled(False)
        recording.set_log_tick_enabled(False)
        if not self.sink.open(recording):
            self.trouble = f"there is no viewer at {self.sink.name}"
            return False
        self._recording = recording
        recording.send_recording_name(self._channels.title)
        for content in self._contents.values():
            content.begin(recording)
        self._send_blueprint(recording)
        recording.flush(timeout_sec=FLUSH_SECONDS)
        self.sink.delivered()
        return True

    def _send_blueprint(self, recording: rr.RecordingStream) -> None:
        recording.send_blueprint(live_blueprint(self._channels, self._contents[self._channels].root))

    def _send(self, recording: rr.RecordingStream) -> None:
        rows = self.rows.take()
        if rows:
            self._last = rows[-1]
            models = (row.estimate.until for row in reversed(rows) if row.estimate and row.estimate.model)
            self._until = next(models, self._until)
        for channels, of_these in groupby(rows, key=lambda row: row.channels):
            if channels != self._channels:
                # Drawn apart from those before.
                self._contents[self._channels].end(recording)
                self._channels = channels
                if channels not in self._contents:
                    self._contents[channels] = Content(channels, f"setup_{len(self._contents) + 1}")
                    self._contents[channels].begin(recording)
                self._send_blueprint(recording)
            self._contents[channels].rows(recording, list(of_these))
        content = self._contents[self._channels]
        for line in self.lines.take():
            content.log(recording, line)
        now = time.monotonic()
        if self._last is not None and now >= self._next_status:
            self._next_status = now + STATUS_SECONDS
            dropped = self.rows.dropped
            if dropped > self._reported_drops:
                text = f"{dropped - self._reported_drops} rows are not shown here: this view is too slow"
                content.log(recording, LogLine(self._last.time, "WARN", text))
                self._reported_drops = dropped
            about = self._channels, self.status, self._last, self._until
            content.status(recording, self._last.time, status_document(*about, dropped), figures(*about))
