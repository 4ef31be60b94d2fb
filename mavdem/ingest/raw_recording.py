"""The raw stream of a link kept in a file while it comes: as a telemetry log, or as frames in MCAP.

Unlike what is written at the end of a command, the file is there from the beginning and grows: what was received must
be kept whatever happens next. A telemetry log may be cut off anywhere; of an MCAP file the last second may be missing.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import BinaryIO, Protocol

import numpy as np

from mavdem.errors import Unreadable
from mavdem.ingest.decode import seeds
from mavdem.ingest.framing import LONGEST_FRAME, find_in_pieces
from mavdem.ingest.mcap_writer import raw_channel, started, write_message
from mavdem.ingest.tlog_writer import write_stamped

EVERY = 0.5
"""Seconds of received bytes that are written together: looking for frames has a cost for each time."""
CHUNK = 1 << 15
"""Bytes of an MCAP chunk: about a second of a fast link."""

Frame = tuple[int, bytes]
"""UNIX µs it was received, and its bytes."""


class _Form(Protocol):
    def write(self, frames: Iterable[Frame]) -> None: ...

    def close(self) -> None: ...


class RawRecording:
    """A growing file.

    Attributes:
        frames: how many are in it.
        bytes_skipped: received bytes that belong to no frame, and so are not.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Makes the file.

        Args:
            path: ends in .tlog or .mcap, and is not there yet.

        Raises:
            Unreadable: it is there already, or cannot be made.
            ValueError: it ends in something else.
        """
        forms: dict[str, Callable[[BinaryIO], _Form]] = {".tlog": _Tlog, ".mcap": _Mcap}
        form = forms.get(Path(path).suffix.lower())
        if form is None:
            raise ValueError(f"{path} must end in .tlog or .mcap: the name says what is written")
        try:
            self._file = open(path, "xb")  # noqa: SIM115 - it stays open until it is closed
        except FileExistsError:
            raise Unreadable(f"{path} is there already, and a recording replaces nothing: name another file.") from None
        except OSError as error:
            raise Unreadable(f"{path} cannot be written ({error.strerror or error}): name another file.") from None
        self.frames = self.bytes_skipped = 0
        self._form = form(self._file)
        self._pieces: list[tuple[float, bytes]] = []
        self._first = 0.0

    def take(self, stamp: float, data: bytes) -> None:
        """Takes what a link received.

        Args:
            stamp: UNIX s.
            data: any number of bytes, also parts of frames.

        Raises:
            OSError: it cannot be written.
        """
        if not self._pieces:
            self._first = stamp
        self._pieces.append((stamp, data))
        if not 0 <= stamp - self._first < EVERY:
            self._write(last=False)

    def close(self) -> None:
        """Writes what is left, and the end.

        Raises:
            OSError: it cannot be written.
        """
        if self._file.closed:
            return
        with self._file:
            self._write(last=True)
            self._form.close()

    def _write(self, last: bool) -> None:
        content = b"".join(data for _, data in self._pieces)
        ends = np.cumsum([len(data) for _, data in self._pieces])
        frames, pieces = find_in_pieces(np.frombuffer(content, dtype=np.uint8), ends, seeds())
        settled = len(content)
        if not last:
            # A frame may still be on its way.
            settled = max(int(frames.end.max(initial=0)), len(content) - LONGEST_FRAME)
        stamps = (round(self._pieces[piece][0] * 1e6) for piece in pieces.tolist())
        found = [content[a:b] for a, b in zip(frames.start.tolist(), frames.end.tolist(), strict=True)]
        self._form.write(zip(stamps, found, strict=True))
        self._file.flush()
        self.frames += len(found)
        self.bytes_skipped += settled - sum(map(len, found))
        self._pieces = [(self._pieces[-1][0], content[settled:])] if settled < len(content) else []
        self._first = self._pieces[0][0] if self._pieces else 0.0


class _Tlog:
    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def write(self, frames: Iterable[Frame]) -> None:
        write_stamped(self._file, frames)

    def close(self) -> None: ...


class _Mcap:
    def __init__(self, file: BinaryIO) -> None:
        self._writer = started(file, CHUNK)
        self._channel = raw_channel(self._writer)

    def write(self, frames: Iterable[Frame]) -> None:
        for stamp, frame in frames:
            write_message(self._writer, self._channel, stamp * 1000, frame)

    def close(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
