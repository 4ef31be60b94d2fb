"""Viewers: recordings of flights in Rerun, in a browser of this machine, by the viewer that Rerun's package has."""

from __future__ import annotations

import socket
import threading
import time
from collections import OrderedDict
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
        # Rerun takes a second to load.
        from mavdem.view import WebServer

        with self._lock:
            viewer = self._open.pop(recording, None)
            if viewer is None or viewer.process.poll() is not None:
                while len(self._open) >= MOST_OPEN:
                    self._open.popitem(last=False)[1].close()
                try:
                    port = _free_port()
                    viewer = WebServer(_free_port(), port, str(recording))
                    _wait_for(port)
                except OSError as error:
                    fact = Fact(Request.NOT_STARTED, name=RECORDING, because=str(error))
                    raise Refusal(fact) from None
            self._open[recording] = viewer
            return viewer.page

    def close(self) -> None:
        """Closes all."""
        while self._open:
            self._open.popitem()[1].close()


def _wait_for(port: int) -> None:
    """Returns when a viewer answers at ``port``; raises ``OSError`` if that takes too long."""
    ends = time.monotonic() + PATIENCE_SECONDS
    while True:
        try:
            return socket.create_connection(("127.0.0.1", port)).close()
        except OSError:
            if time.monotonic() > ends:
                raise
            time.sleep(0.05)


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])
