"""The Rerun viewer that shows recordings of flights in a browser of this machine."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from mavdem.errors import Refusal
from mavdem.facts.serve import RefusalReason
from mavdem.machine import LOOPBACK, free_port
from mavdem.results import RECORDING_FILE

if TYPE_CHECKING:
    from mavdem.view import WebServer

MAX_START_SECONDS = 30.0
"""Seconds in which a viewer must answer after its start; on a busy machine loading Rerun takes long."""

POLL_SECONDS = 0.05
"""Seconds between attempts to connect to a viewer that is starting."""


WATCH_SECONDS = 5.0
"""Seconds between looks whether anybody still uses a viewer."""

MAX_SECONDS_WITHOUT_TAB = 30.0
"""Seconds without a connection of a browser after which a viewer ends: its tab is gone. A reload takes a few."""

MAX_IDLE_SECONDS = 600.0
"""Seconds after somebody last looked at it until a viewer ends: it takes a third of a processor core, used or not."""


class RecordingViewer:
    """Shows the recording that was opened last; only one, since a viewer takes up to a gigabyte of memory for it.

    It ends when its tab is gone, or after ten minutes in which nobody looked at it. What somebody does in the viewer
    stays in the browser, where the viewer's process sees nothing of it. So the page around the viewer opens it again
    every half minute while its tab is in front, which does nothing but begin the ten minutes again.
    """

    def __init__(self) -> None:
        self._recording = Path()
        self._server: WebServer | None = None
        self._opened = 0.0
        self._last_visit = 0.0
        self._lock = threading.Lock()

    def open(self, recording: Path) -> str:
        """Starts a viewer for a recording, unless it is running; a viewer of another recording is ended.

        In either case the timeout of an unused viewer starts again.

        Args:
            recording: path of the recording.

        Returns:
            The address from which a viewer loads the recording.

        Raises:
            Refusal: the viewer cannot be started.
        """
        with self._lock:
            server = self._server
            is_running = server is not None and server.process.poll() is None
            if server is None or not is_running or self._recording != recording:
                self.close()
                server = _start_viewer(recording)
                self._server = server
                self._recording = recording
                # This thread ends the viewer when nobody uses it any more.
                threading.Thread(
                    target=self._end_unused_viewer, args=(server,), daemon=True
                ).start()
            self._opened = time.monotonic()
            self._last_visit = self._opened
            return server.url

    def _end_unused_viewer(self, server: WebServer) -> None:
        """Runs in a thread for each viewer: ends the viewer when nobody uses it any more.

        A viewer is unused if no browser was connected for ``MAX_SECONDS_WITHOUT_TAB``, or if its page did not request
        it (``open``) for ``MAX_IDLE_SECONDS``. The thread ends with its viewer, or when another viewer replaces it.

        Args:
            server: the process of the viewer.
        """
        while server.process.poll() is None:
            time.sleep(WATCH_SECONDS)
            now = time.monotonic()
            has_visitor = has_connections(server.process.pid)
            with self._lock:
                if self._server is not server:
                    return
                if has_visitor:
                    self._last_visit = now
                is_tab_closed = now - self._last_visit > MAX_SECONDS_WITHOUT_TAB
                is_idle = now - self._opened > MAX_IDLE_SECONDS
                if is_tab_closed or is_idle:
                    self.close()
                    return

    @property
    def program_port(self) -> int | None:
        """Port of this machine at which the running viewer has its program; None while none runs."""
        server = self._server
        return None if server is None else server.page_port

    def close(self) -> None:
        """Ends the viewer if one runs."""
        if self._server is not None:
            self._server.close()
            self._server = None


def has_connections(process_id: int) -> bool:
    """Returns whether a client is connected by TCP to a process or one of its children; False if it has ended.

    Args:
        process_id: number of the process.
    """
    with suppress(psutil.Error):
        process = psutil.Process(process_id)
        for process_of_viewer in (process, *process.children(recursive=True)):
            for connection in process_of_viewer.net_connections("tcp"):
                if connection.status == psutil.CONN_ESTABLISHED:
                    return True
    return False


def _start_viewer(recording: Path) -> WebServer:
    """Starts a Rerun viewer that shows a recording in browsers, and waits until it accepts connections.

    The viewer is a process that listens on two free ports: one for recordings, one for the page in the browser. The
    caller redirects the browser to that page immediately, so it must be there when this function returns.

    Args:
        recording: path of the recording that it shows.

    Returns:
        The running viewer.

    Raises:
        Refusal: the viewer ended, or did not answer within ``MAX_START_SECONDS``.
    """
    # Importing Rerun takes a second, which the start of the server should not.
    from mavdem.view import WebServer

    port = free_port()
    try:
        server = WebServer(free_port(), port, str(recording))
        deadline = time.monotonic() + MAX_START_SECONDS
        while server.process.poll() is None and time.monotonic() < deadline:
            with suppress(ConnectionError):
                socket.create_connection((LOOPBACK, port)).close()
                return server
            time.sleep(POLL_SECONDS)
        # The process has ended, or is killed now because it did not answer in time. Either way it has a return code.
        server.close()
        reason = str(server.process.returncode)
    except OSError as error:
        reason = str(error)
    raise Refusal(RefusalReason.NOT_STARTED, name=RECORDING_FILE, reason=reason)
