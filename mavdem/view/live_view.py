"""LiveView: shows a flight while it is learned from, by a thread for each place that it is sent to.

A slow or hanging viewer delays neither learning nor a file: rows wait for each sink in a bounded queue, which drops the
oldest, and Rerun is called from the sinks' threads only.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time as wall
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import groupby
from math import inf, isfinite
from pathlib import Path
from urllib.parse import quote
from uuid import UUID, uuid4

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike

from mavdem.dem import Estimate, Learned
from mavdem.fleet.row import as_text
from mavdem.live import Event, SessionStatus
from mavdem.live.wind import WindRow
from mavdem.view.flown import BOOT_CLOCK
from mavdem.view.live_content import Channels, LiveWriter, ViewRow, figures, log, status_document

LOOPBACK = "127.0.0.1"
SERVER_MEMORY = "256MB"  # the server keeps data for later viewers; the oldest go first
WATCHDOG = """
import os, signal, subprocess, sys, threading
def kill_at_end_of_input():
    sys.stdin.buffer.read()
    os.killpg(0, signal.SIGKILL)
with subprocess.Popen(sys.argv[1:], stdin=subprocess.DEVNULL) as running:
    threading.Thread(target=kill_at_end_of_input, daemon=True).start()
    sys.exit(running.wait())
"""
"""Runs a program until its standard input ends, whose other end is closed when the process that holds it ends for any
reason, even if it is killed. It runs in a session of its own."""


def show(path: str | os.PathLike[str]) -> str:
    """Opens the recording at ``path`` in the Rerun viewer; returns "" at once, or in one sentence why it cannot."""
    if not has_screen():
        program = ["rerun"] if shutil.which("rerun") else [sys.executable, "-m", "rerun"]
        command = shlex.join([*program, os.fspath(path)])
        return f"There is no screen here; open the recording where there is one, with `{command}`."
    if not Path(path).is_file():
        return f"There is no recording {path}."
    _start(os.fspath(path))
    return ""


def has_screen() -> bool:
    """Returns whether a window can probably be opened here."""
    return not sys.platform.startswith("linux") or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


def _start(*options: str, watched: bool = False) -> subprocess.Popen[bytes]:
    """Starts the program that belongs to the package; if ``watched``, it ends with this process.

    ``rerun analytics disable`` would decide for its user for good. What it does not report is what runs where ``CI`` is
    set, unless it is forced to. Source: https://github.com/rerun-io/rerun/tree/main/crates/utils/re_analytics.
    """
    command = [sys.executable, "-m", "rerun", "--bind", LOOPBACK, *options]
    environment = os.environ | {"CI": "1"}
    environment.pop("FORCE_RERUN_ANALYTICS", None)
    # A session of its own, so that Ctrl-C ends the flight and not its picture.
    return subprocess.Popen(
        [sys.executable, "-I", "-c", WATCHDOG, *command] if watched else command,
        start_new_session=True,
        stdin=subprocess.PIPE if watched else subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=environment,
    )


class Sink:
    """A destination of a live flight."""

    name: str  # as a user calls it
    period = 0.1  # seconds between batches
    retried = True  # whether one that fails, or is not there yet, is tried again

    def open(self, recording: rr.RecordingStream) -> bool:
        """Directs the recording to the sink; returns whether it could; ``RuntimeError`` if it never can."""
        raise NotImplementedError

    def delivered(self, arrived: bool = True) -> None:
        """Notes whether all that was sent has arrived."""

    def close(self) -> None:
        """Ends what was started for it, after the recording is disconnected."""


class RecordingFile(Sink):
    """A new .rrd file.

    Each batch is passed to the operating system at once: if the process ends, only the last second is missing. If the
    disk is full, the file is cut to complete batches, since the viewer opens no other. If the process is killed while
    it writes, the end of the file is torn; ``rerun rrd optimize`` repairs it.
    """

    period = 1.0  # each chunk has a kilobyte of overhead
    retried = False

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.name = str(self.path)
        self.broken = False  # whether something could not be written
        self.complete = 0  # bytes of complete batches

    def open(self, recording: rr.RecordingStream) -> bool:
        """Writes the recording into the file."""
        recording.set_sinks(rr.FileSink(self.path))
        return True

    def delivered(self, arrived: bool = True) -> None:
        """Keeps what has arrived; see :class:`Sink`."""
        if arrived:
            self.complete = self.path.stat().st_size
        else:
            self.broken = True
            os.truncate(self.path, self.complete)


class Viewer(Sink):
    """A Rerun viewer or server at a URL, which may come and go.

    It connects only where a viewer accepts connections: without one, Rerun's client keeps everything, blocks its caller
    at some size, and delays the end of the process by ten seconds. A client that has lost its connection does not.
    A ``url`` that is not of the form rerun+http://HOST:PORT/proxy is a ``ValueError``.
    """

    def __init__(self, url: str = f"rerun+http://{LOOPBACK}:9876/proxy") -> None:
        self.url = self.name = url
        address = re.fullmatch(r"rerun(?:\+https?)?://\[?([^/@\]]+?)\]?:(\d{1,5})/proxy", url)
        if address is None or not 0 < int(address[2]) < 65536:
            form = (
                "the address of a Rerun viewer, which looks like rerun+http://127.0.0.1:9876/proxy"
            )
            raise ValueError(f"{url!r} is not {form}")
        self._address = address[1], int(address[2])

    def open(self, recording: rr.RecordingStream) -> bool:
        """Sends the recording to the viewer, if it is there; see :class:`Sink`."""
        try:
            socket.create_connection(self._address, timeout=0.3).close()
        except OSError:
            return False
        recording.connect_grpc(self.url)
        return True


class WebServer(Viewer):
    """A server that shows the flight in browsers of this machine at its ``page``, until it is closed.

    It takes recordings at ``port`` and browsers at ``page_port``; ``OSError`` if one is taken.
    """

    def __init__(self, port: int = 9876, page_port: int = 9090) -> None:
        super().__init__(f"rerun+http://{LOOPBACK}:{port}/proxy")
        for number in (port, page_port):
            try:
                socket.create_server((LOOPBACK, number)).close()
            except OSError as error:
                taken = f"port {number} of {LOOPBACK} is taken: end the program that uses it, perhaps another view"
                raise OSError(taken) from error
        # Rerun's page reports its use to Rerun, unless it is in a notebook: https://github.com/rerun-io/rerun/pull/3166.
        self.page = f"http://{LOOPBACK}:{page_port}?url={quote(self.url, safe='')}&notebook=1"
        ports = ("--port", str(port), "--web-viewer-port", str(page_port))
        self.process = _start(
            "--server-memory-limit", SERVER_MEMORY, "--serve-web", *ports, watched=True
        )

    def close(self) -> None:
        """Ends it."""
        with suppress(ProcessLookupError):
            # The watchdog and the server, also one that hangs.
            os.killpg(self.process.pid, signal.SIGKILL)
        with self.process:
            self.process.wait()


def sinks_for(
    rrd: str | os.PathLike[str] | None = None, serve: bool = False, connect: str | None = None
) -> list[Sink]:
    """Returns the sinks that a user asked for; with a screen and neither ``serve`` nor ``connect``, also a window.

    ``rrd`` is a file to record in, ``serve`` a wish for browsers of this machine, ``connect`` the URL of a viewer or
    server, which may start later. The view that they are given to closes them. ``OSError`` if a port is taken,
    ``ValueError``, one sentence, for an invalid URL; empty if there is nowhere to show the flight.
    """
    sinks: list[Sink] = [] if rrd is None else [RecordingFile(rrd)]
    if connect is not None:
        sinks.append(Viewer(connect))
    if serve:
        sinks.append(WebServer())
    if connect is None and not serve and has_screen():
        # A window, which stays open after the process ends.
        with socket.create_server((LOOPBACK, 0)) as probe:
            port = int(probe.getsockname()[1])
        limits = ("--server-memory-limit", SERVER_MEMORY, "--memory-limit", "1GB")
        _start(*limits, "--port", str(port), "--expect-data-soon", "--hide-welcome-screen")
        sinks.append(Viewer(f"rerun+http://{LOOPBACK}:{port}/proxy"))
    return sinks


CLOSE_SECONDS = 3.0  # how long ``close`` waits for slow sinks
# that wait for a sink: rows of 20 s at 400 Hz, about 20 MB, and log lines
MAX_ROWS = 8192
MAX_LINES = 1000
# between two status documents, and two attempts to reach a viewer
STATUS_SECONDS = 1.0
RETRY_SECONDS = 1.0
FLUSH_SECONDS = 5.0  # time limit for sending a batch; a slower one is still under way


class SinkThread:
    """Sends rows, log lines and the status to a sink, a few times a second; one that cannot be opened gets nothing."""

    def __init__(self, sink: Sink, recording_id: UUID) -> None:
        self.sink = sink
        self._id = recording_id
        self._rows: deque[ViewRow] = deque(maxlen=MAX_ROWS)
        self._lines: deque[Event] = deque(maxlen=MAX_LINES)
        self._lock = threading.Lock()  # held for an append or a swap only
        self.dropped = 0  # rows
        self.status = SessionStatus()
        self.trouble = ""  # why nothing arrives, one sentence
        self._writer: LiveWriter | None = None
        self._recording: rr.RecordingStream | None = None
        self._last: ViewRow | None = None
        # time of the last sample that the latest model was trained on, s
        self._until: float | None = None
        self._reported_drops = 0
        self._next_status = 0.0
        self._next_try = 0.0
        self.closing = threading.Event()  # when it is set, the rest is sent
        self.thread = threading.Thread(target=self._run, name=f"to {sink.name}", daemon=True)
        self.thread.start()

    def put(self, item: ViewRow | Event) -> None:
        """Adds a row or a log line; drops the oldest if too many wait."""
        with self._lock:
            if isinstance(item, Event):
                self._lines.append(item)
            else:
                self.dropped += len(self._rows) == self._rows.maxlen
                self._rows.append(item)

    def _run(self) -> None:
        ending = False
        while not ending:
            ending = self.closing.wait(self.sink.period)
            self._next_status *= not ending
            self._attempt(self._open)
            self._attempt(self._send)
        if self._recording is not None:
            self._recording.disconnect()

    def _attempt(self, work: Callable[[], None]) -> None:
        """Opens the sink or sends what waits; gives up a sink that fails, or retries it later."""
        try:
            work()
        except (RuntimeError, OSError) as error:
            if "timed out" in str(error):
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
            self.put(Event(self._last.time if self._last else 0.0, f"not drawn: {error}", "ERROR"))

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
        with self._lock:
            rows = list(self._rows)
            lines = list(self._lines)
            self._rows.clear()
            self._lines.clear()
        for channels, batch in groupby(rows, key=lambda row: row.channels):
            if self._writer is None or channels != self._writer.channels:
                self._writer = LiveWriter(channels, recording)
            same = list(batch)
            self._last = same[-1]
            models = (
                row.estimate.until for row in reversed(same) if row.estimate and row.estimate.model
            )
            self._until = next(models, self._until)
            self._writer.rows(same)
        for line in lines:
            log(recording, *line[:3])
            if self._writer is not None:
                self._writer.mark(line.since)
        if self._last is not None and wall.monotonic() >= self._next_status:
            self._next_status = wall.monotonic() + STATUS_SECONDS
            if new := self.dropped - self._reported_drops:
                log(
                    recording,
                    self._last.time,
                    f"{new} rows are not shown here: this view is too slow",
                    "WARN",
                )
                self._reported_drops += new
            about = self.status, self._last, self._until
            documents = {f"figures/{i}": text for i, text in enumerate(figures(*about))}
            recording.set_time(BOOT_CLOCK, duration=self._last.time)
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

    def change(self, channels: Channels) -> None:
        """Sets the ``channels`` of the rows from now on; once at least before the first row."""
        self._channels = channels

    def put(
        self,
        time: float,
        shift: float,
        segment: int,
        outputs: ArrayLike,
        inputs: ArrayLike,
        estimate: Estimate | None = None,
        learned: Learned | None = None,
        wind: WindRow | None = None,
    ) -> None:
        """Shows a row of ``outputs`` (m,) and ``inputs`` (r,) at ``time``, s of the boot clock; takes microseconds.

        The timeline is ``shift`` s after that clock, so that flights of two boots do not overlap. The number of the
        ``segment`` changes where samples are missing or the vehicle rebooted. ``estimate`` is of this sample;
        ``learned`` is the learner's last batch result, which contains the prior; ``wind`` is the latest row in m/s.
        """
        if self._closed or self._channels is None:
            return
        # Copies, since callers may reuse their arrays.
        y = np.array(outputs, np.float64)
        u = np.array(inputs, np.float64)
        row = ViewRow(time + shift, shift, segment, y, u, estimate, learned, self._channels, wind)
        for thread in self._threads:
            thread.put(row)

    def log(self, event: Event) -> None:
        """Shows an event in the log, at its time of the timeline."""
        time = event.seconds if isfinite(event.seconds) else 0.0
        for thread in () if self._closed else self._threads:
            thread.put(event._replace(seconds=time, sentence=as_text(event.sentence)))

    def status(self, status: SessionStatus) -> None:
        """Shows the latest ``status``, once a second."""
        for thread in self._threads:
            thread.status = status

    @property
    def troubles(self) -> list[str]:
        """One sentence for each sink that receives nothing."""
        return [thread.trouble for thread in self._threads if thread.trouble]

    def close(self) -> None:
        """Sends what waits and closes the sinks; a sink that hangs is abandoned after ``CLOSE_SECONDS``."""
        if self._closed:
            return
        self._closed = True
        for thread in self._threads:
            thread.closing.set()
        deadline = wall.monotonic() + CLOSE_SECONDS
        for each in self._threads:
            each.thread.join(max(0.0, deadline - wall.monotonic()))
            if each.thread.is_alive():
                each.trouble = f"{each.sink.name} does not respond; the last rows may be missing"
                # otherwise Rerun waits for the hanging viewer when Python ends
                rr.unregister_shutdown()
            each.sink.close()
