"""LiveView: shows a flight while it is learned from, by a thread for each place that it is sent to.

A slow or hanging viewer delays neither learning nor a file: rows wait for each sink in a bounded queue, which drops the
oldest, and Rerun is called from the sinks' threads only.
"""

import threading
import time as wall
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import groupby
from math import inf, isfinite
from operator import itemgetter
from uuid import UUID, uuid4

import rerun as rr

from mavdem.facts import Fact, Level
from mavdem.facts.motors import InFlight
from mavdem.facts.session import Session
from mavdem.live import Event, SessionStatus
from mavdem.live.display import DisplayRow
from mavdem.live.link import RETRY_SECONDS
from mavdem.live.samples import MAX_SAMPLES
from mavdem.live.session_status import STATUS_PERIOD
from mavdem.view.live_content import Channels, LiveWriter, figures, status_document
from mavdem.view.plots import BOOT_CLOCK, log
from mavdem.view.sinks import CLOSING_SECONDS, Sink

FLUSH_SECONDS = 5.0  # time limit for sending a batch; a slower one is still under way


class SinkThread(threading.Thread):
    """Sends rows, log lines and the status to a sink, a few times a second; one that cannot be opened gets nothing."""

    def __init__(self, sink: Sink, recording_id: UUID) -> None:
        super().__init__(name=f"to {sink.name}", daemon=True)
        self.sink = sink
        self._id = recording_id
        self._rows: deque[tuple[Channels, DisplayRow]] = deque(maxlen=MAX_SAMPLES)
        self._lines: deque[Event] = deque(maxlen=MAX_SAMPLES)
        self.dropped = 0  # rows
        self.is_paused = False  # whether rows wait until it closes or is let go
        self.status = SessionStatus()
        self.trouble = ""  # why nothing arrives, one sentence
        self._writer: LiveWriter | None = None
        self._recording: rr.RecordingStream | None = None
        self._last: DisplayRow | None = None
        # time of the last sample that the latest model was trained on, s
        self._until: float | None = None
        self._reported_drops = 0
        self._next_status = 0.0
        self._next_try = 0.0
        self.closing = threading.Event()  # when it is set, the rest is sent

    def put(self, channels: Channels, row: DisplayRow) -> None:
        """Adds a row; drops the oldest if too many wait."""
        self.dropped += len(self._rows) == self._rows.maxlen
        self._rows.append((channels, row))

    def log(self, event: Event) -> None:
        """Adds a line of the log."""
        self._lines.append(event)

    def run(self) -> None:
        """Sends what waits at the pace of the sink, until it closes."""
        ending = False
        while not ending:
            ending = self.closing.wait(self.sink.period)
            self._next_status *= not ending
            self.turn()
        if self._recording is not None:
            self._recording.disconnect()

    def turn(self) -> None:
        """Opens the sink where that is due, and sends what waits."""
        self._attempt(self._open)
        self._attempt(self._send)

    def _attempt(self, work: Callable[[], None]) -> None:
        """Opens the sink or sends what waits; gives up a sink that fails, or retries it later."""
        began = wall.monotonic()
        try:
            work()
        except (RuntimeError, OSError) as error:
            # Rerun has one type of error for a sink that fails and for one that takes too long.
            if wall.monotonic() - began >= FLUSH_SECONDS:
                self.trouble = f"{self.sink.name} does not respond"
                return
            self.trouble = f"{self.sink.name} {'cannot be written' if self._recording is None else 'failed'}: {error}"
            if self._recording is not None:
                # A failed recording disconnects without waiting, and writes nothing more.
                self._recording.disconnect()
                self._recording = None
                with suppress(OSError):
                    self.sink.delivered(arrived=False)
        except (
            Exception
        ) as error:  # a row that cannot be drawn ends neither the view nor the flight
            fact = Fact(Session.ROW_NOT_DRAWN, because=error)
            self.log(Event(self._last.timeline_time if self._last else 0.0, fact))

    def _open(self) -> None:
        if self._recording is not None or not self._rows or wall.monotonic() < self._next_try:
            return
        self._next_try = wall.monotonic() + RETRY_SECONDS if self.sink.retried else inf
        recording = rr.RecordingStream("mavdem", recording_id=self._id)
        recording.set_log_time_enabled(False)
        recording.set_log_tick_enabled(False)
        if not self.sink.open(recording):
            self.trouble = f"there is no viewer at {self.sink.name}"
            return
        self._recording = recording
        self._writer = None

    def _send(self) -> None:
        if (recording := self._recording) is None:
            return
        # Of a deque each end may be used by another thread.
        count = 0 if self.is_paused and not self.closing.is_set() else len(self._rows)
        rows = [self._rows.popleft() for _ in range(count)]
        lines = [self._lines.popleft() for _ in range(len(self._lines))]
        for channels, batch in groupby(rows, key=itemgetter(0)):
            if self._writer is None or channels != self._writer.channels:
                self._writer = LiveWriter(channels, recording)
            same = [row for _, row in batch]
            self._last = same[-1]
            if self._last.estimate is not None and self._last.estimate.model is not None:
                self._until = self._last.estimate.until
            self._writer.rows(same)
        for line in lines:
            log(recording, line.seconds, line.sentence, line.fact.level)
            because = line.fact.figures.get("because", line.fact)
            if self._writer is not None and isinstance(because, Fact):
                if because.code in (InFlight.MOTOR_LOST_THRUST, InFlight.MOTOR_RECOVERED):
                    self._writer.disown(line.since)
                if line.is_alarm:
                    self._writer.mark(line.since)
        if self._last and self._writer and wall.monotonic() >= self._next_status:
            self._next_status = wall.monotonic() + STATUS_PERIOD
            if new := self.dropped - self._reported_drops:
                words = f"{new} rows are not shown here: this view is too slow"
                log(recording, self._last.timeline_time, words, Level.WATCH)
                self._reported_drops += new
            about = self.status, self._last, self._writer.channels, self._until
            documents = {f"figures/{i}": text for i, text in enumerate(figures(*about))}
            recording.set_time(BOOT_CLOCK, duration=self._last.timeline_time)
            for path, text in {**documents, "status": status_document(*about)}.items():
                recording.log(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))
        recording.flush(timeout_sec=FLUSH_SECONDS)
        self.sink.delivered()
        self.trouble = ""


class LiveView:
    """Takes rows, log lines and statuses of a live flight; never makes their giver wait.

    It opens its sinks with the first row; ``troubles`` reports those that cannot be written.
    """

    def __init__(self, sinks: Sequence[Sink]) -> None:
        self._channels: Channels | None = None
        self._closed = False
        recording_id = uuid4()
        self._threads = [SinkThread(sink, recording_id) for sink in sinks]
        for thread in self._threads:
            thread.start()

    def change(self, channels: Channels) -> None:
        """Sets the ``channels`` of the rows from now on; once at least before the first row."""
        self._channels = channels

    def put(self, row: DisplayRow) -> None:
        """Shows a row; takes microseconds."""
        if self._closed or self._channels is None:
            return
        for thread in self._threads:
            thread.put(self._channels, row)

    def log(self, event: Event) -> None:
        """Shows an event in the log, at its time of the timeline."""
        time = event.seconds if isfinite(event.seconds) else 0.0
        for thread in () if self._closed else self._threads:
            thread.log(event._replace(seconds=time))

    def pause(self, is_paused: bool) -> None:
        """Makes rows wait while this computer has no time to draw them."""
        for thread in self._threads:
            thread.is_paused = is_paused

    def status(self, status: SessionStatus) -> None:
        """Shows the latest ``status``, once a second."""
        for thread in self._threads:
            thread.status = status

    @property
    def troubles(self) -> list[str]:
        """One sentence for each sink that receives nothing."""
        return [thread.trouble for thread in self._threads if thread.trouble]

    def close(self) -> None:
        """Sends what waits and closes the sinks; a sink that hangs is abandoned after ``CLOSING_SECONDS``."""
        if self._closed:
            return
        self._closed = True
        for thread in self._threads:
            thread.closing.set()
        deadline = wall.monotonic() + CLOSING_SECONDS
        for each in self._threads:
            each.join(max(0.0, deadline - wall.monotonic()))
            if each.is_alive():
                each.trouble = f"{each.sink.name} does not respond; the last rows may be missing"
                # otherwise Rerun waits for the hanging viewer when Python ends
                rr.unregister_shutdown()
            each.sink.close()
