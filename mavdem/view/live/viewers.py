"""Viewers: starting one to show a live flight in, with a bound on its memory, reachable from this machine only."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

from mavdem.view.live import leash
from mavdem.view.live.sinks import RecordingFile, Sink, Viewer
from mavdem.view.rerun_program import rerun_command, rerun_environment
from mavdem.view.show import has_screen

LOOPBACK = "127.0.0.1"
VIEWER_MEMORY, SERVER_MEMORY = "1GB", "256MB"
"""Of the viewer, and of the server that keeps data for those who look later; beyond, the oldest is forgotten."""

NOWHERE = "There is no screen here: say --rrd FILE to record, or --serve to look with a browser."


class WebServer(Viewer):
    """A server that shows the flight in browsers of this machine, until it is closed.

    Attributes:
        page: what to open in a browser.
        process: the server, and what it started.
    """

    def __init__(self, port: int = 9876, page_port: int = 9090) -> None:
        """Starts it.

        Args:
            port: where recordings come in.
            page_port: where browsers come in.

        Raises:
            OSError: a port is taken.
        """
        super().__init__(f"rerun+http://{LOOPBACK}:{port}/proxy")
        for each in (port, page_port):
            _require_free(each)
        self.page = f"http://{LOOPBACK}:{page_port}?url={quote(self.url, safe='')}"
        self.process = _start("--serve-web", "--port", str(port), "--web-viewer-port", str(page_port), leashed=True)

    def close(self) -> None:
        """Ends it."""
        with suppress(ProcessLookupError):
            # What was started is Python, which started the server: end both, also one that hangs.
            os.killpg(self.process.pid, signal.SIGKILL)
        with self.process:  # closes the leash too
            self.process.wait()


def native_viewer() -> Viewer:
    """Opens a viewer's window; it outlives its caller, with what it shows."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        port = int(probe.getsockname()[1])
    _start("--port", str(port), "--memory-limit", VIEWER_MEMORY, "--expect-data-soon", "--hide-welcome-screen")
    return Viewer(f"rerun+http://{LOOPBACK}:{port}/proxy")


def sinks_for(rrd: str | os.PathLike[str] | None = None, serve: bool = False, connect: str | None = None) -> list[Sink]:
    """The sinks a user asked for, and a window where there is a screen and no other way to look was asked for.

    They are closed by the view they are given to.

    Args:
        rrd: file to record in.
        serve: whether to serve browsers of this machine.
        connect: URL of a viewer or server that is, or will be, there.

    Raises:
        OSError: a port is taken.
        ValueError: there is nowhere to show it, or the URL is none; one sentence.
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
            raise ValueError(NOWHERE)
    return sinks


def _start(*options: str, leashed: bool = False) -> subprocess.Popen[bytes]:
    """Rerun's program, which ends with this process where it is ``leashed``."""
    command = rerun_command("--bind", LOOPBACK, "--server-memory-limit", SERVER_MEMORY, *options)
    # A session of its own, so that Ctrl-C ends the flight and not the picture of it; silent, since nobody reads it.
    return subprocess.Popen(
        [sys.executable, "-I", leash.__file__, *command] if leashed else command,
        start_new_session=True,
        stdin=subprocess.PIPE if leashed else subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=rerun_environment(),
    )


def _require_free(port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except OSError as error:
            raise OSError(
                f"port {port} of {LOOPBACK} is taken: end what listens there, perhaps another view"
            ) from error
