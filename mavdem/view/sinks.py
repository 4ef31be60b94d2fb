"""Sinks: the destinations of a live flight (file, viewer, web server), and the programs that show it there.

These run as processes of their own: Rerun's ``serve_grpc`` and ``spawn`` know no address to listen at, so that all who
reach this machine would see the flight; a server in this process would also keep its memory.
"""

import os
import re
import shlex
import shutil
import socket
import struct
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

import rerun as rr

from mavdem.files import PathName, atomic_writes
from mavdem.machine import LOOPBACK, free_port, has_screen, require_free_port
from mavdem.processes import kill_with_children

CLOSING_SECONDS = 3.0
"""s for which a file, or any sink, that is closed may still be written."""

COMPLETION_SECONDS = 10 * CLOSING_SECONDS
"""s that completing a file may take: an hour of 100 Hz takes 9 s."""

CONNECTION_TIMEOUT = 0.3
"""s in which a viewer on this machine or its network must accept a connection."""

VIEWER_URL = re.compile(r"rerun(?:\+https?)?://\[?(?P<host>[^/@\]]+?)\]?:(?P<port>\d{1,5})/proxy")
"""The address of a Rerun viewer or server: rerun+http://HOST:PORT/proxy."""

MAX_PORT = 65535
"""The largest TCP port."""

SERVER_MEMORY = "256MB"
"""Memory in which the server keeps data for later viewers; the oldest go first."""

VIEWER_MEMORY = "1GB"
"""Memory in which a window keeps data."""

STREAM_HEADER_BYTES = 12
"""Bytes before the first message of an .rrd file (Rerun's re_log_encoding)."""

MESSAGE_HEADER = struct.Struct("<QQ")
"""Header of a message of an .rrd file: its kind, and the number of bytes that follow (Rerun's re_log_encoding)."""

WATCHDOG = """
import os, psutil, subprocess, sys, threading
def kill_at_end_of_input():
    sys.stdin.buffer.read()
    # Descendants first: once the child has ended, the main thread ends this program.
    for process in reversed(psutil.Process().children(recursive=True)):
        process.kill()
    os._exit(1)
with subprocess.Popen(sys.argv[1:], stdin=subprocess.DEVNULL) as running:
    threading.Thread(target=kill_at_end_of_input, daemon=True).start()
    sys.exit(running.wait())
"""
"""A program that runs another one until its standard input ends. The other end of that is closed when the process that
holds it ends for any reason, even if it is killed."""


RERUN_PROGRAM = "import sys; from rerun_cli.__main__ import main; sys.exit(main())"
"""The program of the package rerun, as its command ``rerun`` starts it, which need not be on the path.

``python -m rerun`` would import the package's library first, which takes half a second. ``python -m rerun_cli`` does
not return the exit code.
"""


def show(path: PathName) -> str:
    """Opens a recording in a window of the Rerun viewer, and returns without waiting for it to close.

    Args:
        path: path of the recording, an .rrd file.

    Returns:
        The reason why it cannot be opened, in one sentence; empty if it can.
    """
    if not has_screen():
        program = ["rerun"] if shutil.which("rerun") else [sys.executable, "-m", "rerun"]
        command = shlex.join([*program, os.fspath(path)])
        return f"There is no screen here; open the recording where there is one, with `{command}`."
    if not Path(path).is_file():
        return f"There is no recording {path}."
    start_rerun(os.fspath(path))
    return ""


def start_rerun(*options: str, ends_with_process: bool = False) -> subprocess.Popen[bytes]:
    """Starts the program of the package rerun, with its reports of usage switched off.

    ``rerun analytics disable`` would change the user's setting permanently. Rerun does not report if ``CI`` is set,
    unless it is forced to. Source: https://github.com/rerun-io/rerun/tree/main/crates/utils/re_analytics.

    Args:
        options: options of the program.
        ends_with_process: whether the program ends with this process, for whatever reason this process ends.

    Returns:
        The running program.
    """
    command = [sys.executable, "-c", RERUN_PROGRAM, "--bind", LOOPBACK, *options]
    if ends_with_process:
        command = [sys.executable, "-I", "-c", WATCHDOG, *command]
    environment = os.environ | {"CI": "1"}
    environment.pop("FORCE_RERUN_ANALYTICS", None)
    return subprocess.Popen(
        command,
        # A new session (on Windows: process group) keeps the Ctrl-C that ends mavdem from the viewer.
        start_new_session=True,
        creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        stdin=subprocess.PIPE if ends_with_process else subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=environment,
    )


class Sink:
    """A destination of a live flight: a file, a viewer or a server.

    Attributes:
        name: what a user calls it.
        period: s between batches.
        is_retried: whether one that fails, or does not exist yet, is tried again.
    """

    name: str
    period = 0.1
    is_retried = True

    def open(self, recording: rr.RecordingStream) -> bool:
        """Directs the recording to the sink, and returns whether that was possible now.

        Raises:
            RuntimeError: it will never be possible.
        """
        raise NotImplementedError

    def end_batch(self, is_complete: bool = True) -> None:
        """Is called after each batch that was sent to the sink, which may put its data in order then.

        Args:
            is_complete: whether all of the batch has arrived; False if sending failed and part of it may be missing.
        """

    def close(self) -> None:
        """Ends the sink, with a process that was started for it, after the recording is disconnected."""


class RecordingFile(Sink):
    """A destination of a live flight: a new .rrd file, which the Rerun viewer opens.

    Each batch goes to the operating system immediately: if the process ends, only the last second is missing. If the
    disk is full, the file is cut to complete messages, since the viewer opens no other. If the process is killed while
    it writes, the end of the file is torn; ``rerun rrd optimize`` repairs it. The table of its chunks would grow in
    memory by a megabyte a minute, so it is made at the end, within ``COMPLETION_SECONDS``.

    Attributes:
        path: path of the file.
        is_broken: whether something could not be written.
        complete_bytes: bytes up to the end of the last complete message.
    """

    # Each chunk has a kilobyte of overhead, so that a file has one a second.
    period = 1.0
    is_retried = False

    def __init__(self, path: PathName) -> None:
        self.path = Path(path)
        self.name = str(self.path)
        self.is_broken = False
        self.complete_bytes = 0

    def open(self, recording: rr.RecordingStream) -> bool:
        """Writes the recording into the file."""
        recording.save(self.path, write_footer=False)
        return True

    def end_batch(self, is_complete: bool = True) -> None:
        """Remembers how much has arrived, and cuts the file where not all did; see :class:`Sink`."""
        self.complete_bytes = self.path.stat().st_size
        if not is_complete:
            self.is_broken = True
            self._cut_to_complete_messages()

    def close(self) -> None:
        """Completes the file with Rerun's index of its content, with which a viewer opens it faster.

        If a write had failed, as on a full disk, the file is cut after its last complete message instead, so that it
        can be read. If adding the index fails, the file stays without it.
        """
        with suppress(OSError, subprocess.TimeoutExpired):
            # Rerun reports a failed write only at the next write, which does not follow here. So the file is checked.
            was_cut = self._cut_to_complete_messages()
            self.is_broken = self.is_broken or was_cut
            if not self.is_broken:
                self._add_index()

    def _add_index(self) -> None:
        """Writes the file again, with the index of its chunks, which Rerun's own program computes.

        Raises:
            OSError, subprocess.TimeoutExpired: it could not; the file is unchanged.
        """
        with atomic_writes(self.path) as (indexed_path,):
            options = ("rrd", "optimize", str(self.path), "-o", str(indexed_path))
            with start_rerun(*options) as process:
                try:
                    exit_code = process.wait(COMPLETION_SECONDS)
                finally:
                    process.kill()
            if exit_code:
                raise OSError(exit_code, "not completed", str(self.path))

    def _cut_to_complete_messages(self) -> bool:
        """Cuts the file after its last complete message.

        Each message has a header with its length, by which the next header is found. The loop ends at the first header
        that is incomplete, or beyond the end of the file because the message before it is incomplete.

        Returns:
            Whether an incomplete message was cut off.
        """
        size = self.path.stat().st_size
        with self.path.open("rb") as file:
            message_start = STREAM_HEADER_BYTES
            while message_start <= size:
                # All messages before this position are complete.
                self.complete_bytes = message_start
                file.seek(message_start)
                header = file.read(MESSAGE_HEADER.size)
                if len(header) < MESSAGE_HEADER.size:
                    break
                _, content_bytes = MESSAGE_HEADER.unpack(header)
                message_start += MESSAGE_HEADER.size + content_bytes
        os.truncate(self.path, self.complete_bytes)
        return self.complete_bytes < size


class Viewer(Sink):
    """A Rerun viewer or server at a URL, which may start and end at any time.

    It connects only where a viewer accepts connections: without one, Rerun's client keeps everything, blocks its caller
    at some size, and delays the end of the process by ten seconds. A client that has lost its connection does not.
    """

    def __init__(self, url: str = f"rerun+http://{LOOPBACK}:9876/proxy") -> None:
        """Takes the address of the viewer, rerun+http://HOST:PORT/proxy.

        Raises:
            ValueError: ``url`` is not of that form.
        """
        self.url = self.name = url
        address = VIEWER_URL.fullmatch(url)
        if address is None or not 0 < int(address["port"]) <= MAX_PORT:
            raise ValueError(
                f"{url!r} is not the address of a Rerun viewer, which looks like "
                "rerun+http://127.0.0.1:9876/proxy"
            )
        self._address = address["host"], int(address["port"])

    def open(self, recording: rr.RecordingStream) -> bool:
        """Connects a recording to the viewer, if one answers at the URL.

        A plain connection is tried first, since Rerun itself would wait for a viewer and report nothing.

        Args:
            recording: the stream of a live flight.

        Returns:
            Whether the viewer answered.
        """
        try:
            socket.create_connection(self._address, timeout=CONNECTION_TIMEOUT).close()
        except OSError:
            return False
        recording.connect_grpc(self.url)
        return True


class WebServer(Viewer):
    """A server that shows the flight in browsers of this machine, until it is closed.

    Attributes:
        page: the address of Rerun's own page for browsers.
        port: port at which it receives recordings, and sends them to browsers.
        page_port: port at which it has that page, and the program of the viewer.
        process: the server's.
    """

    def __init__(self, port: int = 9876, page_port: int = 9090, recording: str = "") -> None:
        """Starts the server.

        Args:
            port: port at which it receives recordings.
            page_port: port at which it serves browsers.
            recording: path or address of a recording that is shown immediately; none unless given.

        Raises:
            OSError: a port is taken.
        """
        super().__init__(f"rerun+http://{LOOPBACK}:{port}/proxy")
        self.port = port
        self.page_port = page_port
        for number in (port, page_port):
            require_free_port(number)
        # This page requests fonts from Google, and reports its use to Rerun, even with the option of notebooks, which
        # was made against that (https://github.com/rerun-io/rerun/pull/3166). Its colours follow the system's, and
        # those of the lines are for a dark background.
        self.page = (
            f"http://{LOOPBACK}:{page_port}?url={quote(self.url, safe='')}&notebook=1&theme=dark"
        )
        options = ["--server-memory-limit", SERVER_MEMORY, "--serve-web"]
        options += ["--port", str(port), "--web-viewer-port", str(page_port)]
        if recording:
            options.append(recording)
        else:
            # A browser that is opened late in a flight begins at its end, and then gets what was before.
            options.append("--newest-first")
        self.process = start_rerun(*options, ends_with_process=True)

    def close(self) -> None:
        """Ends the server, also one that hangs, together with its watchdog."""
        kill_with_children(self.process.pid)
        with self.process:
            self.process.wait()


def requested_sinks(
    rrd: PathName | None = None, connect: str | None = None, web_server: WebServer | None = None
) -> list[Sink]:
    """Returns the sinks that a user has requested; without a request, a viewer in a new window if there is a screen.

    A sink is a destination to which a live flight is sent. The view that receives the sinks closes them.

    Args:
        rrd: a file to record in.
        connect: address of a viewer or server, which may start later.
        web_server: server that shows the flight in browsers of this machine.

    Returns:
        The sinks; empty if there is nowhere to show the flight.

    Raises:
        ValueError: ``connect`` is not the address of a viewer.
    """
    sinks: list[Sink] = []
    if rrd is not None:
        sinks.append(RecordingFile(rrd))
    if connect is not None:
        sinks.append(Viewer(connect))
    if web_server is not None:
        sinks.append(web_server)
    if not sinks and has_screen():
        sinks.append(open_window())
    return sinks


def open_window() -> Viewer:
    """Starts the Rerun viewer in a new window.

    The viewer takes a free port, so that several can run. It stays open after this process ends. Both its server and
    the window itself drop the oldest data beyond their limits of memory.

    Returns:
        The sink that sends data to the viewer.
    """
    port = free_port()
    start_rerun(
        "--server-memory-limit",
        SERVER_MEMORY,
        "--memory-limit",
        VIEWER_MEMORY,
        "--port",
        str(port),
        "--expect-data-soon",
        "--hide-welcome-screen",
    )
    return Viewer(f"rerun+http://{LOOPBACK}:{port}/proxy")
