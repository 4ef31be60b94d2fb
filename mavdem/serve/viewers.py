"""Viewers: recordings of flights in Rerun, in a browser of this machine, by the viewer that Rerun's package has."""

from __future__ import annotations

import socket
import threading
import time
from collections import OrderedDict
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from mavdem.errors import Refusal
from mavdem.facts import Fact
from mavdem.facts.serve import Request
from mavdem.results import RECORDING

if TYPE_CHECKING:
    from mavdem.view import WebServer

PATIENCE_SECONDS = 20.0  # for a viewer to start, which takes one
MOST_OPEN = 3
"""Viewers: each holds its recording in memory, which may be a gigabyte."""


class Viewers:
    """The viewers that are open; the one that was asked for longest ago is closed for another."""

    def __init__(self) -> None:
        self._open: OrderedDict[Path, WebServer] = OrderedDict()
        self._lock = threading.Lock()

    def show(self, recording: Path) -> str:
        """Returns the address of a page that shows a ``recording``; raises ``Refusal`` where none can be started."""
        with self._lock:
            viewer = self._open.pop(recording, None)
            if viewer is None or viewer.process.poll() is not None:
                while len(self._open) >= MOST_OPEN:
                    self._open.popitem(last=False)[1].close()
                viewer = _started(recording)
            self._open[recording] = viewer
            return viewer.page

    def close(self) -> None:
        """Closes all."""
        while self._open:
            self._open.popitem()[1].close()


def _started(recording: Path) -> WebServer:
    """A viewer that answers already."""
    # Rerun takes a second to load.
    from mavdem.view import WebServer

    port = _free_port()
    try:
        viewer = WebServer(_free_port(), port, str(recording))
        ends = time.monotonic() + PATIENCE_SECONDS
        while viewer.process.poll() is None and time.monotonic() < ends:
            with suppress(ConnectionError):
                socket.create_connection(("127.0.0.1", port)).close()
                return viewer
            time.sleep(0.05)
        viewer.close()
        because = str(viewer.process.returncode)
    except OSError as error:
        because = str(error)
    raise Refusal(Fact(Request.NOT_STARTED, name=RECORDING, because=because))


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])
