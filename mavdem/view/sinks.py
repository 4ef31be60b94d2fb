"""Sinks: the places that a live flight is sent to, and the programs that show it there.

These run as processes of their own: Rerun's ``serve_grpc`` and ``spawn`` know no address to listen at, so that all who
reach this machine would see the flight; a server in this process would also keep its memory.
"""

import os
import re
import shlex
import shutil
import signal
import socket
import struct
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

import rerun as rr

from mavdem.files import PathName, atomic_writes
from mavdem.machine import LOOPBACK, free_port, has_screen

CLOSING_SECONDS = 3.0  # how long a file, or any sink, that is closed may still be written
SERVER_MEMORY = "256MB"  # the server keeps data for later viewers; the oldest go first
STREAM_HEADER = 12  # bytes before the first message of an .rrd file
MESSAGE_HEADER = struct.Struct(
    "<QQ"
)  # kind of message, bytes of what follows; source: Rerun's re_log_encoding
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


def show(path: PathName) -> str:
    """Opens the recording at ``path`` in the Rerun viewer; returns "" at once, or in one sentence why it cannot."""
    if not has_screen():
        program = ["rerun"] if shutil.which("rerun") else [sys.executable, "-m", "rerun"]
        command = shlex.join([*program, os.fspath(path)])
        return f"There is no screen here; open the recording where there is one, with `{command}`."
    if not Path(path).is_file():
        return f"There is no recording {path}."
    _start(os.fspath(path))
    return ""


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
    disk is full, the file is cut to whole messages, since the viewer opens no other. If the process is killed while
    it writes, the end of the file is torn; ``rerun rrd optimize`` repairs it. The table of its chunks would grow in
    memory by a megabyte a minute, so it is made at the end, where that takes no longer than ten times
    ``CLOSING_SECONDS``: an hour of 100 Hz takes 9 s.
    """

    period = 1.0  # each chunk has a kilobyte of overhead
    retried = False

    def __init__(self, path: PathName) -> None:
        self.path = Path(path)
        self.name = str(self.path)
        self.broken = False  # whether something could not be written
        self.whole = 0  # bytes, up to the end of the last whole message

    def open(self, recording: rr.RecordingStream) -> bool:
        """Writes the recording into the file."""
        recording.save(self.path, write_footer=False)
        return True

    def delivered(self, arrived: bool = True) -> None:
        """Keeps what has arrived; see :class:`Sink`."""
        self.whole = self.path.stat().st_size
        if not arrived:
            self.broken = True
            self._cut()

    def close(self) -> None:
        """Completes the file, or cuts what could not be written whole; see :class:`Sink`."""
        with suppress(OSError, subprocess.TimeoutExpired):
            # What fails while it is flushed, Rerun reports with a later flush only.
            self.broken |= self._cut()
            if not self.broken:
                self._complete()

    def _complete(self) -> None:
        """Writes the file anew, with the table of its chunks; OSError, or TimeoutExpired: it stays as it is."""
        with atomic_writes(self.path) as (completed,):
            with _start("rrd", "optimize", str(self.path), "-o", str(completed)) as process:
                try:
                    failed = process.wait(10 * CLOSING_SECONDS)
                finally:
                    process.kill()
            if failed:
                raise OSError(failed, "not completed", str(self.path))

    def _cut(self) -> bool:
        """Cuts the file after its last whole message; returns whether there was more."""
        size = self.path.stat().st_size
        with self.path.open("rb") as file:
            end = STREAM_HEADER
            while end <= size:
                self.whole = end
                file.seek(end)
                header = file.read(MESSAGE_HEADER.size)
                if len(header) < MESSAGE_HEADER.size:
                    break
                _, length = MESSAGE_HEADER.unpack(header)
                end += MESSAGE_HEADER.size + length
        os.truncate(self.path, self.whole)
        return self.whole < size


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
            raise ValueError(
                f"{url!r} is not the address of a Rerun viewer, which looks like "
                "rerun+http://127.0.0.1:9876/proxy"
            )
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

    It takes recordings at ``port`` and browsers at ``page_port``; ``OSError`` if one is taken. A ``recording`` that is
    named is shown at once.
    """

    def __init__(self, port: int = 9876, page_port: int = 9090, recording: str = "") -> None:
        super().__init__(f"rerun+http://{LOOPBACK}:{port}/proxy")
        for number in (port, page_port):
            try:
                socket.create_server((LOOPBACK, number)).close()
            except OSError as error:
                raise OSError(
                    f"port {number} of {LOOPBACK} is taken: end the program that uses it, perhaps another view"
                ) from error
        # Rerun's page reports its use to Rerun, unless it is in a notebook: https://github.com/rerun-io/rerun/pull/3166.
        self.page = f"http://{LOOPBACK}:{page_port}?url={quote(self.url, safe='')}&notebook=1"
        self.process = _start(
            "--server-memory-limit",
            SERVER_MEMORY,
            "--serve-web",
            "--port",
            str(port),
            "--web-viewer-port",
            str(page_port),
            *filter(None, [recording]),
            watched=True,
        )

    def close(self) -> None:
        """Ends it."""
        with suppress(ProcessLookupError):
            # The watchdog and the server, also one that hangs.
            os.killpg(self.process.pid, signal.SIGKILL)
        with self.process:
            self.process.wait()


def sinks_for(
    rrd: PathName | None = None, serve: bool = False, connect: str | None = None
) -> list[Sink]:
    """Returns the sinks that a user asked for; with a screen and none of these, a window.

    ``rrd`` is a file to record in, ``serve`` a wish for browsers of this machine, ``connect`` the URL of a viewer or
    server, which may start later. The view that they are given to closes them. ``OSError`` if a port is taken,
    ``ValueError``, one sentence, for an invalid URL; empty if there is nowhere to show the flight.
    """
    sinks: list[Sink] = [] if rrd is None else [RecordingFile(rrd)]
    if connect is not None:
        sinks.append(Viewer(connect))
    if serve:
        sinks.append(WebServer())
    if not sinks and has_screen():
        # A window, which stays open after the process ends.
        port = free_port()
        _start(
            "--server-memory-limit",
            SERVER_MEMORY,
            "--memory-limit",
            "1GB",
            "--port",
            str(port),
            "--expect-data-soon",
            "--hide-welcome-screen",
        )
        sinks.append(Viewer(f"rerun+http://{LOOPBACK}:{port}/proxy"))
    return sinks
