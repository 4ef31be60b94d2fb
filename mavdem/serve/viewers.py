"""The Rerun viewer that shows recordings of flights in a browser of this machine."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from mavdem.errors import Refusal
from mavdem.facts.serve import Request
from mavdem.machine import LOOPBACK, free_port
from mavdem.results import RECORDING_FILE

if TYPE_CHECKING:
    from mavdem.view import WebServer

MAX_START_SECONDS = 30.0
"""Seconds in which a viewer must answer after its start; on a busy machine loading Rerun takes long."""

POLL_SECONDS = 0.05
"""Seconds between attempts to connect to a viewer that is starting."""


class RecordingViewer:
    """Shows one recording at a time, the last one that was opened: a viewer holds up to a gigabyte of it in memory."""

    def __init__(self) -> None:
        self._recording = Path()
        self._server: WebServer | None = None
        self._lock = threading.Lock()

    def open(self, recording: Path) -> str:
        """Starts a viewer for a recording, in place of the one for another recording, unless it runs already.

        Returns:
            The address of its page.

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
            return server.page

    def close(self) -> None:
        """Ends the viewer if one runs."""
        if self._server is not None:
            self._server.close()
            self._server = None


def _start_viewer(recording: Path) -> WebServer:
    """Starts a Rerun viewer that shows a recording in browsers, and waits until it accepts connections.

    It is a process with two ports that are free: one for recordings, one for the page in the browser.

    The browser is sent to the viewer's address at once, where it would find nothing while the viewer is starting.

    Args:
        recording: path of the recording that it shows.

    Raises:
        Refusal: it ended, or did not answer within ``MAX_START_SECONDS``.
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
        server.close()
        reason = str(server.process.returncode)
    except OSError as error:
        reason = str(error)
    raise Refusal(Request.NOT_STARTED, name=RECORDING_FILE, because=reason)
