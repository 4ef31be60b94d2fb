"""SinkThread: a thread that sends rows to one sink, so that a slow sink delays neither learning nor other sinks."""

from __future__ import annotations

import time
from collections import deque
from contextlib import suppress
from itertools import groupby
from math import isfinite
from threading import Event, Lock, Thread
from typing import Generic, TypeVar
from uuid import UUID

import rerun as rr

from mavdem.dem.online.learner import TOO_FEW
from mavdem.dem.online.surprise import FALSE_MARK_SECONDS
from mavdem.live import SessionStatus
from mavdem.live.status import sentence
from mavdem.view.live.blueprint import live_blueprint
from mavdem.view.live.content import Content
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
            document = status_document(self._channels, self.status, self._last, self._until, dropped)
            content.status(recording, self._last.time, document)


LEGEND = (
    "The thin lines beside a thick one are its 90 % band. y ← x is the entry of A or B from x to y, in the model's "
    f"units. Surprise is how far F(t) is below its recent median: 1 is the worst of twenty samples. A mark "
    f"is where it stays above what is usual in this flight; one in {FALSE_MARK_SECONDS / 60:.0f} minutes is expected "
    "without a change."
)


def status_document(channels: Channels, status: SessionStatus, row: ViewRow, until: float | None, dropped: int) -> str:
    """The latest status and row as a Markdown document, with the number of rows that this view has dropped.

    The latest model was learnt ``until`` s of the boot clock; None before the first.
    """
    facts = {"samples": f"{status.learned + status.shown:,} at {1 / channels.dt:.4g} Hz"}
    reboot = f" since a reboot; shown as {row.time:,.1f} s" if row.shift else ""
    facts["boot clock"] = f"{row.time - row.shift:,.1f} s{reboot}"
    facts |= {name: f"{rate:.1f} Hz" for name, rate in status.rates.items()}
    facts["frames lost"] = f"{status.lost:,}"
    if isfinite(status.latency[0]):
        facts["latency"] = f"{1000 * status.latency[0]:.0f} ms"
    if isfinite(status.useful[0]):
        ahead, ratio = status.useful
        facts["useful predictions"] = f"up to {ahead:.2g} s ahead: error ratio {ratio:.2f} (1: last sample or mean)"
    if dropped:
        facts["rows not shown"] = f"{dropped:,}: this view is too slow"
    first, *others = (f"| {name} | {fact} |" for name, fact in facts.items())
    obstacle = status.obstacle or (TOO_FEW if until is None else "")
    if until is None:
        learning = "No model yet."
    elif row.estimate is None:
        learning = "The latest model is kept; the samples now are not settled flight."
    else:
        learning = f"The model was learned up to {max(0.0, row.estimate.time - until):.1f} s ago."
    learning += f" {sentence(obstacle)}" if obstacle else ""
    cautions = [f"**Cautions:** {' '.join(row.learned.cautions)}"] if row.learned and row.learned.cautions else []
    return "\n\n".join([f"**{channels.title}**", learning, "\n".join([first, "|---|---|", *others]), *cautions, LEGEND])
