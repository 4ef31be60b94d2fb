"""RawRecording: what a link receives, frame by frame in a file that grows."""

from collections.abc import Sequence
from pathlib import Path

from mavdem.errors import Unreadable, error_message
from mavdem.facts.session import LinkFact
from mavdem.files import PathName
from mavdem.ingest.mcap.records import register_frame_channel, start_writer, write_message
from mavdem.ingest.tlog import write_stamped
from mavdem.live.messages import Frame

BATCH_SECONDS = 0.5  # In which frames wait for the operating system


class RawRecording:
    """A growing file, new, of the raw stream, a tlog or as .mcap; a crash loses at most a second.

    Raises Unreadable: the file exists, or cannot be created.
    """

    def __init__(self, path: PathName) -> None:
        try:
            self._file = open(path, "xb")  # noqa: SIM115 - open until close()
        except FileExistsError:
            raise Unreadable(LinkFact.STREAM_FILE_EXISTS, path=path) from None
        except OSError as error:
            raise Unreadable(
                LinkFact.STREAM_FILE_FAILED, path=path, error=error_message(error)
            ) from None
        self.frames = 0  # in it; bytes that belong to no frame are not
        self._mcap = (
            start_writer(self._file, 1 << 15) if Path(path).suffix.lower() == ".mcap" else None
        )
        self._channel = 0 if self._mcap is None else register_frame_channel(self._mcap)
        self._passed_on = 0.0  # UNIX s

    def take(self, stamp: float, frames: Sequence[Frame]) -> None:
        """Adds frames that a link completed at ``stamp``, UNIX s. Raises OSError: they cannot be written."""
        microseconds = round(stamp * 1e6)
        for frame in frames:
            if self._mcap is None:
                write_stamped(self._file, [(microseconds, frame.content)])
            else:
                write_message(self._mcap, self._channel, microseconds * 1000, frame.content)
        self.frames += len(frames)
        if not 0 <= stamp - self._passed_on < BATCH_SECONDS:
            self._passed_on = stamp
            self._file.flush()

    def close(self) -> None:
        """Writes the rest and closes the file. Raises OSError: it cannot be written."""
        if self._file.closed:
            return
        with self._file:
            if self._mcap is not None:
                self._mcap.finish()  # type: ignore[no-untyped-call]
