"""The raw stream of a link kept in a file while it comes: as a telemetry log, or as frames in MCAP.

Unlike what is written at the end of a command, the file is there from the beginning and grows: what was received must
be kept whatever happens next. A telemetry log may be cut off anywhere; of an MCAP file the last second may be missing.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import BinaryIO, Protocol

import numpy as np
from mcap.writer import Writer

from mavdem.errors import Unreadable
from mavdem.ingest.decode import seeds
from mavdem.ingest.framing import LONGEST_FRAME, find_frames
from mavdem.ingest.mcap_writer import RAW_ENCODING, RAW_TOPIC

EVERY = 0.5
"""Seconds of received bytes that are written together: looking for frames has a cost for each time."""
CHUNK = 1 << 15
"""Bytes of an MCAP chunk: about a second of a fast link."""

Frame = tuple[int, bytes]
"""UNIX µs it was received, and its bytes."""


class _Form(Protocol):
    def write(self, frames: Sequence[Frame]) -> None: ...

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
        tables = list(find_frames(np.frombuffer(content, dtype=np.uint8), seeds())) if content else []
        starts, stops = (
            np.concatenate([getattr(table, name) for table in tables] or [np.zeros(0, dtype=np.int64)])
            for name in ("start", "end")
        )
        settled = len(content)
        if not last:
            # A frame may still be on its way; one that was found may turn out to be the inside of it.
            settled = max(int(stops.max(initial=0)), len(content) - LONGEST_FRAME)
        taken = stops <= settled
        holding = np.searchsorted(ends, starts[taken], side="right")
        stamps = [round(self._pieces[piece][0] * 1e6) for piece in holding.tolist()]
        found = [content[a:b] for a, b in zip(starts[taken].tolist(), stops[taken].tolist(), strict=True)]
        self._form.write(list(zip(stamps, found, strict=True)))
        self._file.flush()
        self.frames += len(found)
        self.bytes_skipped += settled - sum(map(len, found))
        self._pieces = [(self._pieces[-1][0], content[settled:])] if settled < len(content) else []
        self._first = self._pieces[0][0] if self._pieces else 0.0


class _Tlog:
    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def write(self, frames: Sequence[Frame]) -> None:
        self._file.write(b"".join(struct.pack(">Q", stamp) + frame for stamp, frame in frames))

    def close(self) -> None: ...


class _Mcap:
    def __init__(self, file: BinaryIO) -> None:
        self._writer = Writer(file, chunk_size=CHUNK)
        self._writer.start(library="mavdem")
        self._channel = self._writer.register_channel(RAW_TOPIC, RAW_ENCODING, schema_id=0)

    def write(self, frames: Sequence[Frame]) -> None:
        for stamp, frame in frames:
            self._writer.add_message(self._channel, log_time=stamp * 1000, data=frame, publish_time=stamp * 1000)

    def close(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
