"""The view of a live flight: a thread for each sink (file, viewer or server) to which the flight is sent.

A slow or hanging viewer delays neither learning nor a file: rows wait for each sink in a bounded queue, which drops the
oldest, and Rerun is called from the sinks' threads only.
"""

import threading
import time as wall
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import groupby
from math import inf
from operator import itemgetter
from uuid import UUID, uuid4

import rerun as rr

from mavdem.facts import Fact, Level
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.session import SessionFact
from mavdem.live import Event, SessionStatus
from mavdem.live.display import DisplayRow
from mavdem.live.link import RETRY_SECONDS
from mavdem.live.samples import MAX_SAMPLES
from mavdem.live.session_status import STATUS_PERIOD
from mavdem.view.first_tab import events_text
from mavdem.view.live_content import Channels, current_value_texts, status_document
from mavdem.view.live_scene import LiveScene
from mavdem.view.live_writer import LiveWriter
from mavdem.view.plots import BOOT_CLOCK, log_event
from mavdem.view.sinks import CLOSING_SECONDS, Sink

MAX_LISTED_EVENTS = 30
"""Latest events that the first tab lists: several screens; the tab "Status" has all."""

FLUSH_SECONDS = 5.0
"""Time limit for sending a batch, s; a slower one is still under way."""


class SinkThread(threading.Thread):
    """Thread that sends rows, events and the status of a live flight to one sink, a few times a second.

    Attributes:
        sink: file, viewer or server that it sends to.
        dropped_rows: number of rows that were dropped, since too many waited.
        is_paused: whether rows wait; they are sent when this is unset, or when the thread ends.
        status: the latest status of the session.
        problem: why nothing arrives at the sink, in one sentence for the user; empty if all arrives.
        closing: event by which the owner asks the thread to send the rest and to end.
    """

    def __init__(self, sink: Sink, recording_id: UUID) -> None:
        """Creates the thread that sends a live flight to one sink; the sink is opened when the first row waits.

        Two queues hold what waits to be sent: rows (samples of all channels at one time) and events. Each drops its
        oldest element when full, so that a sink that hangs does not use up the memory.

        Args:
            sink: file, viewer or server to send to.
            recording_id: id of the recording, the same in all sinks, so that a viewer knows them to be one flight.
        """
        super().__init__(name=f"to {sink.name}", daemon=True)
        self.sink = sink
        self.dropped_rows = 0
        self.is_paused = False
        self.status = SessionStatus()
        self.problem = ""
        self.closing = threading.Event()
        self._recording_id = recording_id
        self._rows: deque[tuple[Channels, DisplayRow]] = deque(maxlen=MAX_SAMPLES)
        self._events: deque[Event] = deque(maxlen=MAX_SAMPLES)
        self._listed_events: deque[Event] = deque(maxlen=MAX_LISTED_EVENTS)
        self._recording: rr.RecordingStream | None = None
        self._writer: LiveWriter | None = None
        self._last_row: DisplayRow | None = None
        # Time of the last sample that the latest model was trained on, s of the boot clock.
        self._training_end_time: float | None = None
        self._reported_drops = 0
        # Times of the monotonic clock, s.
        self._next_status = 0.0
        self._next_attempt = 0.0

    def put(self, channels: Channels, row: DisplayRow) -> None:
        """Queues a row, the samples of all channels at one time, to be sent; a full queue drops its oldest row.

        Args:
            channels: names and units of what the row contains.
            row: the samples, with the estimates at their time.
        """
        if len(self._rows) == self._rows.maxlen:
            self.dropped_rows += 1
        self._rows.append((channels, row))

    def log(self, event: Event) -> None:
        """Adds an event that is to be sent; it is shown in the event log and in the first tab."""
        self._events.append(event)

    def run(self) -> None:
        """Sends the queued data once in each period of the sink; after ``closing`` is set, sends the rest and ends."""
        is_ending = False
        while not is_ending:
            is_ending = self.closing.wait(self.sink.period)
            if is_ending:
                # The last status is sent immediately, without waiting for ``STATUS_PERIOD``.
                self._next_status = 0.0
            self.send_waiting()
        if self._recording is not None:
            self._recording.disconnect()

    def send_waiting(self) -> None:
        """Opens the sink if it is not open and an attempt is due, and sends what waits."""
        self._call_safely(self._open_sink)
        self._call_safely(self._send_queued)

    def _call_safely(self, function: Callable[[], None]) -> None:
        """Calls a function that works with the sink, and catches all its errors.

        An error of one sink must not end the flight or disturb the other sinks. If the sink fails, ``problem`` gets the
        reason, and a later turn may try again.

        Args:
            function: the function, without arguments or result.
        """
        start_time = wall.monotonic()
        try:
            function()
        except (RuntimeError, OSError) as error:
            # Rerun has one type of error for a sink that fails and for one that takes too long.
            if wall.monotonic() - start_time >= FLUSH_SECONDS:
                self.problem = f"{self.sink.name} does not respond"
            else:
                self._give_up_recording(error)
        # A row that cannot be drawn ends neither the view nor the flight.
        except Exception as error:
            time = self._last_row.timeline_time if self._last_row else 0.0
            self.log(Event(time, Fact(SessionFact.ROW_NOT_DRAWN, reason=error)))

    def _give_up_recording(self, error: Exception) -> None:
        """Reports the failure of the sink in ``problem``, which the user sees, and disconnects the recording.

        The sink is the file, viewer or server; the recording is Rerun's stream of data to it. After an error Rerun
        writes nothing more to this stream. So the thread continues without a recording, until ``_open_sink`` opens the
        sink with a new one, which it does only for sinks with ``is_retried``.

        Args:
            error: error of Rerun or the operating system while the sink was opened or data was sent.
        """
        if self._recording is None:
            # The sink could not even be opened.
            self.problem = f"{self.sink.name} cannot be written: {error}"
            return
        self.problem = f"{self.sink.name} failed: {error}"
        # A failed recording disconnects without waiting.
        self._recording.disconnect()
        self._recording = None
        # Part of the latest batch may be in the sink. A file then cuts off its incomplete end, so that it can be read.
        # If that fails too, the problem above is all there is to report.
        with suppress(OSError):
            self.sink.end_batch(is_complete=False)

    def _open_sink(self) -> None:
        """Opens the sink with a new recording, if it is closed, rows are queued, and an attempt is due.

        A viewer that does not run yet is tried again every ``RETRY_SECONDS``, with the reason in ``problem``. A file
        that cannot be opened is not tried again. A new recording has no layout yet; the writer, which sends the layout,
        is therefore created again with the next rows.
        """
        is_open = self._recording is not None
        is_due = wall.monotonic() >= self._next_attempt
        if is_open or not self._rows or not is_due:
            return
        if self.sink.is_retried:
            self._next_attempt = wall.monotonic() + RETRY_SECONDS
        else:
            self._next_attempt = inf
        recording = rr.RecordingStream("mavdem", recording_id=self._recording_id)
        # Rows are sent with the time of the flight, so that Rerun's own times, of logging and of ticks, are left out.
        recording.set_log_time_enabled(False)
        recording.set_log_tick_enabled(False)
        if not self.sink.open(recording):
            self.problem = f"there is no viewer at {self.sink.name}"
            return
        self._recording = recording
        self._writer = None

    def _send_queued(self) -> None:
        """Sends the queued rows and events, and the status if it is due, provided that the sink is open.

        While the view is paused rows stay in their queue, unless the flight is ending. Rows are drawn before events,
        since an alarm is marked in plots, which must exist. The status is sent every ``STATUS_PERIOD``.
        """
        if self._recording is None:
            return
        recording = self._recording
        rows_stay = self.is_paused and not self.closing.is_set()
        # Other threads may append to the queues meanwhile, so the numbers of items to send are fixed here.
        row_count = 0 if rows_stay else len(self._rows)
        event_count = len(self._events)
        channels_and_rows = [self._rows.popleft() for _ in range(row_count)]
        events = [self._events.popleft() for _ in range(event_count)]
        # Successive rows with the same channels are sent together.
        for channels, group in groupby(channels_and_rows, key=itemgetter(0)):
            self._send_rows(recording, channels, [row for _, row in group])
        for event in events:
            self._send_event(recording, event)
        if self._last_row and self._writer and wall.monotonic() >= self._next_status:
            self._next_status = wall.monotonic() + STATUS_PERIOD
            self._send_status(recording, self._last_row, self._writer.channels)
        recording.flush(timeout_sec=FLUSH_SECONDS)
        self.sink.end_batch()
        self.problem = ""

    def _send_rows(
        self, recording: rr.RecordingStream, channels: Channels, rows: list[DisplayRow]
    ) -> None:
        """Draws rows into the sink's recording, and stores the last row and the end of training for later texts.

        ``channels`` are the names and units of the values in the rows, and decide which plots there are. If they have
        changed, for example with the model's inputs, a new ``LiveWriter`` sends a new layout.

        Args:
            recording: the open recording of the sink.
            channels: names and units of all these rows.
            rows: at least one row, in the order of time.
        """
        if self._writer is None:
            self._writer = LiveWriter(channels, recording, LiveScene(recording))
        elif channels != self._writer.channels:
            self._writer = LiveWriter(channels, recording, self._writer.scene)
        self._last_row = rows[-1]
        # The status text states up to which time the data were used for training. Rows before the first model do not.
        estimate = self._last_row.estimate
        if estimate is not None and estimate.model is not None:
            self._training_end_time = estimate.training_end_time
        self._writer.write(rows)

    def _send_event(self, recording: rr.RecordingStream, event: Event) -> None:
        """Writes an event into the log and the list of events, and marks it in the plots if it is an alarm.

        If a motor has lost thrust or recovered it, the estimated wind torque since then was caused by the motor, and is
        marked as such.

        Args:
            recording: the open recording of the sink.
            event: fact (a coded finding) on the flight, with its time.
        """
        log_event(recording, event.seconds, event.sentence, event.fact.level)
        # The newest event stands first, since the viewer does not scroll a text to its end.
        self._listed_events.appendleft(event)
        text = events_text(self._listed_events)
        recording.log("events", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))
        # A fact may state another one as its cause, here possibly the change of a motor.
        cause = event.fact.figures.get("reason", event.fact)
        if self._writer is None or not isinstance(cause, Fact):
            return
        if cause.code in (MotorWatchFact.MOTOR_LOST_THRUST, MotorWatchFact.MOTOR_RECOVERED):
            self._writer.mark_motor_torque(event.start_time)
        if event.is_alarm:
            self._writer.mark_alarm(event.start_time)

    def _send_status(
        self, recording: rr.RecordingStream, row: DisplayRow, channels: Channels
    ) -> None:
        """Writes the texts next to the plots, and an event if rows have been dropped since the last status.

        Args:
            recording: the recording of the sink.
            row: the latest row that was drawn. The texts are shown at its time.
            channels: names and units of the values in the row.
        """
        new_drops = self.dropped_rows - self._reported_drops
        if new_drops:
            sentence = f"{new_drops} rows are not shown here: this view is too slow"
            log_event(recording, row.timeline_time, sentence, Level.WATCH)
            self._reported_drops += new_drops
        current_values = current_value_texts(self.status, row, channels, self._training_end_time)
        documents = {
            "figures": "\n\n".join(current_values),
            "status": status_document(self.status, row, channels, self._training_end_time),
        }
        recording.set_time(BOOT_CLOCK, duration=row.timeline_time)
        for path, text in documents.items():
            recording.log(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))


class LiveView:
    """Receives rows, events and statuses of a live flight, and never makes the caller wait.

    It opens its sinks with the first row; ``problems`` reports those that cannot be written.
    """

    def __init__(self, sinks: Sequence[Sink]) -> None:
        """Starts a thread for each sink; all sinks get the same id of the recording, since they show one flight.

        Args:
            sinks: files, viewers or servers to send to.
        """
        self._channels: Channels | None = None
        self._closed = False
        recording_id = uuid4()
        self._threads = [SinkThread(sink, recording_id) for sink in sinks]
        for thread in self._threads:
            thread.start()

    def change(self, channels: Channels) -> None:
        """Sets the names and units of the rows from now on; it must be called before the first row."""
        self._channels = channels

    def put(self, row: DisplayRow) -> None:
        """Shows a row: hands it to the threads of all sinks, which takes microseconds; none is shown once closed."""
        if self._closed or self._channels is None:
            return
        for thread in self._threads:
            thread.put(self._channels, row)

    def log(self, event: Event) -> None:
        """Shows an event in the log, at its time of the timeline, or at 0 where that is not known."""
        if self._closed:
            return
        time = event.seconds if event.has_time else 0.0
        for thread in self._threads:
            thread.log(event._replace(seconds=time))

    def pause(self, is_paused: bool) -> None:
        """Pauses or resumes the drawing of rows in all sinks, since drawing takes time that the analysis may need.

        Args:
            is_paused: whether rows wait in their queues; events are sent even then.
        """
        for thread in self._threads:
            thread.is_paused = is_paused

    def status(self, status: SessionStatus) -> None:
        """Sets the latest status of the session, which each sink shows about once a second."""
        for thread in self._threads:
            thread.status = status

    @property
    def problems(self) -> list[str]:
        """One sentence for each sink that receives nothing."""
        return [thread.problem for thread in self._threads if thread.problem]

    def close(self) -> None:
        """Sends the queued data and closes the sinks; a sink that hangs is abandoned after ``CLOSING_SECONDS``."""
        if self._closed:
            return
        self._closed = True
        for thread in self._threads:
            thread.closing.set()
        # The threads finish at the same time, so that one deadline holds for all of them together.
        deadline = wall.monotonic() + CLOSING_SECONDS
        for thread in self._threads:
            thread.join(max(0.0, deadline - wall.monotonic()))
            if thread.is_alive():
                name = thread.sink.name
                thread.problem = f"{name} does not respond; the last rows may be missing"
                # Otherwise Rerun waits for the hanging viewer when Python ends.
                rr.unregister_shutdown()
            thread.sink.close()
