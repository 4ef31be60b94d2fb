"""Sinks: where a live flight is shown or recorded, and how each is opened."""

from __future__ import annotations

import os
import socket
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Protocol
from urllib.parse import urlsplit

import rerun as rr

from mavdem.view.rerun_program import rerun_command, rerun_environment

REACHED_WITHIN = 0.3
"""Seconds in which a viewer must take a connection."""


ORDERED_WITHIN = 120.0
"""Seconds in which a file must get its table; an hour of flight takes two."""


class Sink(Protocol):
    """A place that a recording is sent to.

    Attributes:
        name: what a user calls it.
        period: seconds between batches.
        patient: whether one that fails, or is not there yet, is tried again.
    """

    name: str
    period: float
    patient: bool

    def open(self, recording: rr.RecordingStream) -> bool:
        """Leads the recording there; whether that was possible.

        Raises:
            RuntimeError: it was not, and trying again is of no use.
        """

    def delivered(self) -> None:
        """Hears that all that was sent so far is there."""

    def failed(self) -> None:
        """Hears that what was sent since is not, and nothing will be."""

    def close(self) -> None:
        """Ends what was started for it, once the recording has left."""


class RecordingFile:
    """An .rrd file, written anew.

    Each batch is handed to the operating system at once, so that whatever ends the process, the file holds all but the
    last second. After a full disk it is cut to what is whole, since the viewer opens no other. Only a process that is
    killed in the very hundredth of a second of writing leaves a torn end, which ``rerun rrd optimize`` mends.

    While it grows it has no table of its chunks, which would keep a kilobyte a chunk in memory until it is written. The
    viewer does without, other readers do not: at the end Rerun's own tool puts one in.

    Attributes:
        path: of the file.
        broken: whether something could not be written.
    """

    period = 1.0
    """A batch a second: each chunk costs a kilobyte beside what it holds."""
    patient = False

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.name = str(self.path)
        self.broken = False
        self._whole = 0

    @property
    def kept(self) -> bool:
        """Whether there is any of it in the file."""
        return self._whole > 0

    def open(self, recording: rr.RecordingStream) -> bool:
        """Leads the recording into the file; see :class:`Sink`."""
        recording.set_sinks(rr.FileSink(self.path, write_footer=False))
        return True

    def delivered(self) -> None:
        """See :class:`Sink`."""
        self._whole = self.path.stat().st_size

    def failed(self) -> None:
        """See :class:`Sink`."""
        self.broken = True
        os.truncate(self.path, self._whole)

    def close(self) -> None:
        """See :class:`Sink`; where there is no room for a table the file stays as it is."""
        if not self._whole or self.broken:
            return
        with_table = self.path.with_name(f".{self.path.name}.unfinished")
        command = rerun_command("rrd", "optimize", str(self.path), "-o", str(with_table))
        with suppress(OSError, subprocess.TimeoutExpired):
            # A session of its own, so that a Ctrl-C of impatience does not end it.
            done = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=ORDERED_WITHIN,
                start_new_session=True,
                env=rerun_environment(),
            )
            if done.returncode == 0:
                os.replace(with_table, self.path)
        with suppress(FileNotFoundError):
            with_table.unlink()


class Viewer:
    """A Rerun viewer or server that listens at a URL, or will, or will again.

    Rerun's own client, told to connect where nobody listens, keeps everything sent, blocks its caller when that has
    become much, and delays the end of the process by ten seconds. One that has lost its connection does none of it. So
    it is only told to connect where someone takes a connection.
    """

    period = 0.1
    patient = True

    def __init__(self, url: str = "rerun+http://127.0.0.1:9876/proxy") -> None:
        """Of a viewer at ``url``.

        Raises:
            ValueError: it is not of the form rerun+http://HOST:PORT/proxy.
        """
        self.url = self.name = url
        try:
            parts = urlsplit(url)
            self._address = parts.hostname or "", parts.port or 0
        except ValueError as error:
            raise ValueError(_NO_URL.format(url)) from error
        schemes = ("rerun", "rerun+http", "rerun+https")
        if parts.scheme not in schemes or parts.path != "/proxy" or not all(self._address):
            raise ValueError(_NO_URL.format(url))

    def open(self, recording: rr.RecordingStream) -> bool:
        """Leads the recording to the viewer, if it is there; see :class:`Sink`."""
        try:
            socket.create_connection(self._address, timeout=REACHED_WITHIN).close()
        except OSError:
            return False
        recording.connect_grpc(self.url)
        return True

    def delivered(self) -> None:
        """See :class:`Sink`."""

    def failed(self) -> None:
        """See :class:`Sink`."""

    def close(self) -> None:
        """See :class:`Sink`; the viewer is not ours."""


_NO_URL = "{!r} is not the address of a Rerun viewer, which looks like rerun+http://127.0.0.1:9876/proxy"
