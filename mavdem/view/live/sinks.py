"""Sinks: the file, viewers and web server that a live flight is sent to, reachable from this machine only."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote, urlsplit

import rerun as rr

from mavdem.files import atomic_writes
from mavdem.view.live import watchdog
from mavdem.view.viewer import has_screen, rerun_command, rerun_environment

CONNECT_SECONDS = 0.3  # time limit for a viewer to accept a connection
INDEX_SECONDS = 120.0  # time limit for the index of a file; an hour of flight takes two seconds
LOOPBACK = "127.0.0.1"
VIEWER_MEMORY, SERVER_MEMORY = "1GB", "256MB"  # the server keeps data for later viewers; the oldest go first
NO_SCREEN = "There is no screen here: use --rrd FILE to record, or --serve for browsers"
INVALID_URL = "{!r} is not the address of a Rerun viewer, which looks like rerun+http://127.0.0.1:9876/proxy"


class Sink:
    """A destination of a recording."""

    name: str  # as a user calls it
    period: float  # seconds between batches
    retried: bool  # whether one that fails, or is not there yet, is tried again

    def open(self, recording: rr.RecordingStream) -> bool:
        """Directs the recording to the sink; returns whether it could; ``RuntimeError`` if it never can."""
        raise NotImplementedError

    def delivered(self) -> None:
        """Called when all that was sent has arrived."""

    def failed(self) -> None:
        """Called when what was sent since the last delivery has not arrived."""

    def close(self) -> None:
        """Ends what was started for it; called after the recording is disconnected."""


class RecordingFile(Sink):
    """A new .rrd file.

    Each batch is passed to the operating system at once: if the process ends, only the last second is missing. If the
    disk is full, the file is cut to complete batches, since the viewer opens no other. If the process is killed while
    it writes, the end of the file is torn; ``rerun rrd optimize`` repairs it.

    While it grows it has no index, which would take a kilobyte of memory for each chunk. Viewers do not need one, other
    readers do: Rerun's own tool adds it at the end.
    """

    period = 1.0  # each chunk has a kilobyte of overhead
    retried = False

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.name = str(self.path)
        self.broken = False  # whether something could not be written
        self._complete = 0

    @property
    def kept(self) -> bool:
        """Whether the file contains anything."""
        return self._complete > 0

    def open(self, recording: rr.RecordingStream) -> bool:
        """Writes the recording into the file; see :class:`Sink`."""
        recording.set_sinks(rr.FileSink(self.path, write_footer=False))
        return True

    def delivered(self) -> None:
        """See :class:`Sink`."""
        self._complete = self.path.stat().st_size

    def failed(self) -> None:
        """See :class:`Sink`."""
        self.broken = True
        os.truncate(self.path, self._complete)

    def close(self) -> None:
        """Adds the index; if there is no space for it, the file stays as it is."""
        if not self._complete or self.broken:
            return
        with suppress(OSError, subprocess.SubprocessError), atomic_writes(self.path) as (indexed,):
            # A session of its own, so that a second Ctrl-C does not end it.
            subprocess.run(
                rerun_command("rrd", "optimize", str(self.path), "-o", str(indexed)),
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=INDEX_SECONDS,
                start_new_session=True,
                env=rerun_environment(),
                check=True,
            )


class Viewer(Sink):
    """A Rerun viewer or server at a URL, which may come and go.

    It connects only where a viewer accepts connections: without one, Rerun's client keeps everything, blocks its caller
    at some size, and delays the end of the process by ten seconds. A client that has lost its connection does not.
    A ``url`` that is not of the form rerun+http://HOST:PORT/proxy is a ``ValueError``.
    """

    period = 0.1
    retried = True

    def __init__(self, url: str = "rerun+http://127.0.0.1:9876/proxy") -> None:
        self.url = self.name = url
        try:
            parts = urlsplit(url)
            self._address = parts.hostname or "", parts.port or 0
        except ValueError as error:
            raise ValueError(INVALID_URL.format(url)) from error
        schemes = ("rerun", "rerun+http", "rerun+https")
        if parts.scheme not in schemes or parts.path != "/proxy" or not all(self._address):
            raise ValueError(INVALID_URL.format(url))

    def open(self, recording: rr.RecordingStream) -> bool:
        """Sends the recording to the viewer, if it is there; see :class:`Sink`."""
        try:
            socket.create_connection(self._address, timeout=CONNECT_SECONDS).close()
        except OSError:
            return False
        recording.connect_grpc(self.url)
        return True


class WebServer(Viewer):
    """A server that shows the flight in browsers of this machine, until it is closed.

    It takes recordings at ``port`` and browsers at ``page_port``; ``OSError`` if one is taken.
    """

    def __init__(self, port: int = 9876, page_port: int = 9090) -> None:
        super().__init__(f"rerun+http://{LOOPBACK}:{port}/proxy")
        for each in (port, page_port):
            with socket.socket() as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                try:
                    probe.bind((LOOPBACK, each))
                except OSError as error:
                    cure = "end the program that uses it, perhaps another view"
                    raise OSError(f"port {each} of {LOOPBACK} is taken: {cure}") from error
        # The URL to open in a browser; the process is the watchdog, which runs the server.
        # Rerun's page reports its use to Rerun, unless it is in a notebook: https://github.com/rerun-io/rerun/pull/3166.
        self.page = f"http://{LOOPBACK}:{page_port}?url={quote(self.url, safe='')}&notebook=1"
        self.process = _start("--serve-web", "--port", str(port), "--web-viewer-port", str(page_port), watched=True)

    def close(self) -> None:
        """Ends it."""
        with suppress(ProcessLookupError):
            # The watchdog and the server, also one that hangs.
            os.killpg(self.process.pid, signal.SIGKILL)
        with self.process:
            self.process.wait()


def native_viewer() -> Viewer:
    """Opens a viewer's window, which stays open after the process ends."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        port = int(probe.getsockname()[1])
    _start("--port", str(port), "--memory-limit", VIEWER_MEMORY, "--expect-data-soon", "--hide-welcome-screen")
    return Viewer(f"rerun+http://{LOOPBACK}:{port}/proxy")


def sinks_for(rrd: str | os.PathLike[str] | None = None, serve: bool = False, connect: str | None = None) -> list[Sink]:
    """The sinks that a user asked for; with a screen and neither ``serve`` nor ``connect``, also a window.

    ``rrd`` is a file to record in, ``serve`` a wish for browsers of this machine, ``connect`` the URL of a viewer or
    server, which may start later. The view that they are given to closes them. ``OSError`` if a port is taken,
    ``ValueError``, one sentence, for an invalid URL or if there is nowhere to show the flight.
    """
    sinks: list[Sink] = []
    if rrd is not None:
        sinks.append(RecordingFile(Path(rrd)))
    if connect is not None:
        sinks.append(Viewer(connect))
    if serve:
        sinks.append(WebServer())
    if not serve and connect is None:
        if has_screen():
            sinks.append(native_viewer())
        elif rrd is None:
            raise ValueError(NO_SCREEN)
    return sinks


def _start(*options: str, watched: bool = False) -> subprocess.Popen[bytes]:
    """Starts Rerun's program; if ``watched``, it ends with this process."""
    command = rerun_command("--bind", LOOPBACK, "--server-memory-limit", SERVER_MEMORY, *options)
    # A session of its own, so that Ctrl-C ends the flight and not its picture.
    return subprocess.Popen(
        [sys.executable, "-I", watchdog.__file__, *command] if watched else command,
        start_new_session=True,
        stdin=subprocess.PIPE if watched else subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=rerun_environment(),
    )
