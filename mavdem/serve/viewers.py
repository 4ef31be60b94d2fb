"""Viewers: recordings of flights in Rerun, in a browser of this machine, by the viewer that Rerun's package has."""

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
from mavdem.serve.uploads import PATIENCE_SECONDS

if TYPE_CHECKING:
    from mavdem.view import WebServer


class Viewers:
    """The viewer that is open, of the recording that was asked for last: it holds it in memory, up to a gigabyte."""

    def __init__(self) -> None:
        self._recording = Path()
        self._viewer: WebServer | None = None
        self._lock = threading.Lock()

    def show(self, recording: Path) -> str:
        """Returns the address of a page that shows a ``recording``; raises ``Refusal`` where none can be started."""
        with self._lock:
            viewer = self._viewer
            if viewer is None or self._recording != recording or viewer.process.poll() is not None:
                self.close()
                viewer = _started(recording)
                self._viewer = viewer
                self._recording = recording
            return viewer.page

    def close(self) -> None:
        """Closes it."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None


def _started(recording: Path) -> WebServer:
    """A viewer that answers already."""
    # Rerun takes a second to load.
    from mavdem.view import WebServer

    port = free_port()
    try:
        viewer = WebServer(free_port(), port, str(recording))
        ends = time.monotonic() + PATIENCE_SECONDS
        while viewer.process.poll() is None and time.monotonic() < ends:
            with suppress(ConnectionError):
                socket.create_connection((LOOPBACK, port)).close()
                return viewer
            time.sleep(0.05)
        viewer.close()
        because = str(viewer.process.returncode)
    except OSError as error:
        because = str(error)
    raise Refusal(Request.NOT_STARTED, name=RECORDING_FILE, because=because)
