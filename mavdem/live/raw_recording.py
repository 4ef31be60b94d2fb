"""RawRecording: what a link receives, frame by frame in a file that grows."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from mavdem.errors import Unreadable
from mavdem.facts import Fact
from mavdem.facts.session import LinkFact
from mavdem.ingest.mavlink.definitions import seeds
from mavdem.ingest.mavlink.framing import LONGEST_FRAME, find_in_pieces
from mavdem.ingest.mcap.records import raw_channel, started, write_message
from mavdem.ingest.tlog import write_stamped

BATCH_SECONDS = 0.5  # Of received bytes written together: each search for frames costs time


class RawRecording:
    """A growing file, new, of the raw stream, a tlog or as .mcap; a crash loses at most a second.

    Raises Unreadable: the file exists, or cannot be created.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        try:
            self._file = open(path, "xb")  # noqa: SIM115 - open until close()
        except FileExistsError:
            raise Unreadable(Fact(LinkFact.STREAM_FILE_EXISTS, path=str(path))) from None
        except OSError as error:
            text = error.strerror or str(error)
            raise Unreadable(
                Fact(LinkFact.STREAM_FILE_FAILED, path=str(path), error=text)
            ) from None
        self.frames = 0  # in it; bytes that belong to no frame are not
        self._mcap = started(self._file, 1 << 15) if Path(path).suffix.lower() == ".mcap" else None
        self._channel = 0 if self._mcap is None else raw_channel(self._mcap)
        self._pieces: list[tuple[float, bytes]] = []
        self._first = 0.0

    def take(self, stamp: float, data: bytes) -> None:
        """Adds any bytes that a link received, also parts of frames, at ``stamp``, UNIX s.

        Raises OSError: it cannot be written.
        """
        if not self._pieces:
            self._first = stamp
        self._pieces.append((stamp, data))
        if not 0 <= stamp - self._first < BATCH_SECONDS:
            self._write(last=False)

    def close(self) -> None:
        """Writes the rest and closes the file. Raises OSError: it cannot be written."""
        if self._file.closed:
            return
        with self._file:
            self._write(last=True)
            if self._mcap is not None:
                self._mcap.finish()  # type: ignore[no-untyped-call]

    def _write(self, last: bool) -> None:
        content = b"".join(data for _, data in self._pieces)
        ends = np.cumsum([len(data) for _, data in self._pieces])
        frames, pieces = find_in_pieces(np.frombuffer(content, dtype=np.uint8), ends, seeds())
        searched = len(content)
        if not last:
            # The last frame may not be complete.
            searched = max(int(frames.end.max(initial=0)), len(content) - LONGEST_FRAME)
        stamps = (round(self._pieces[piece][0] * 1e6) for piece in pieces.tolist())
        contents = [
            content[a:b] for a, b in zip(frames.start.tolist(), frames.end.tolist(), strict=True)
        ]
        stamped = zip(stamps, contents, strict=True)
        if self._mcap is None:
            write_stamped(self._file, stamped)
        else:
            for stamp, frame in stamped:
                write_message(self._mcap, self._channel, stamp * 1000, frame)
        self._file.flush()
        self.frames += len(contents)
        self._pieces = (
            [(self._pieces[-1][0], content[searched:])] if searched < len(content) else []
        )
        self._first = self._pieces[0][0] if self._pieces else 0.0
