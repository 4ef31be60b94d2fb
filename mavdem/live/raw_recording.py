"""Recording of what a link receives, frame by frame, in a file that grows."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan
from pathlib import Path
from shutil import copyfile
from typing import BinaryIO, NamedTuple

import numpy as np

from mavdem.dataset.intervals import TimeInterval
from mavdem.errors import Unreadable, error_message
from mavdem.extras import require_extra_of_file
from mavdem.facts.session import LinkFact
from mavdem.files import PathName, numbered_path
from mavdem.ingest.mavlink.dialect import crc_extra_table
from mavdem.ingest.mavlink.frame_reader import Frame
from mavdem.ingest.mavlink.framing import find_frames
from mavdem.ingest.mavlink.recording_end import end_mark
from mavdem.ingest.tlog import STAMP_BYTES, write_stamped
from mavdem.live.link import ReceivedPiece

BATCH_SECONDS = 0.5
"""Time for which frames wait in memory for the operating system, s: a choice; a crash loses so much."""

MCAP_CHUNK_BYTES = 1 << 15
"""Size of a chunk of an .mcap, bytes: a choice; smaller than usual, since a crash loses the last chunk."""


class RawRecording:
    """A growing file of the frames that a link receives, a .tlog or an .mcap; a crash loses at most a second.

    Attributes:
        frame_count: number of frames in it. Bytes that belong to no frame are not recorded.
        first_stamp: time of the first of them, UNIX s; NaN before it.
    """

    def __init__(self, path: PathName) -> None:
        """Creates the file.

        Args:
            path: path of the file, an MCAP if it ends so, otherwise a tlog.

        Raises:
            Unreadable: the file exists, or cannot be created.
            MissingExtra: the libraries of MCAP are not installed.
        """
        require_extra_of_file(path)
        # It is open until ``close``.
        self._file = _create_file(path)
        self.frame_count = 0
        self._path = path
        # Number of bytes of a .tlog so far, and of those until the last frame of each system and component.
        self._size = 0
        self._sizes_by_sender: dict[tuple[int, int], int] = {}
        # Every ``BATCH_SECONDS`` a pair is added: time, UNIX s, and number of bytes that were written until then.
        self._sizes_by_time: list[tuple[float, int]] = []
        self.first_stamp = nan
        self._mcap = None
        self._channel = 0
        if Path(path).suffix.lower() == ".mcap":
            from mavdem.ingest.mcap.records import register_frame_channel, start_writer

            self._mcap = start_writer(self._file, MCAP_CHUNK_BYTES)
            self._channel = register_frame_channel(self._mcap)
        # UNIX time of the frames that were last passed on to the operating system, s.
        self._flush_stamp = 0.0

    def add(self, stamp: float, frames: Sequence[Frame]) -> None:
        """Adds frames, and passes them on to the operating system every ``BATCH_SECONDS``.

        Passing on each frame by itself would take most of the time. Frames that were not passed on are lost if the
        program crashes.

        Args:
            stamp: time when the link completed them, UNIX s.
            frames: frames that were received together, in the order of arrival.

        Raises:
            OSError: they cannot be written.
        """
        if frames and self.frame_count == 0:
            self.first_stamp = stamp
        for frame in frames:
            self._write_frame(stamp, frame.content)
            self._size += STAMP_BYTES + len(frame.content)
            # The recording may be divided later, where the last frame of a vehicle ends.
            self._sizes_by_sender[frame.system, frame.component] = self._size
        self.frame_count += len(frames)
        seconds_since_flush = stamp - self._flush_stamp
        # The seconds are negative where the computer's clock was set back.
        is_flush_due = not 0 <= seconds_since_flush < BATCH_SECONDS
        if is_flush_due:
            self._flush_stamp = stamp
            self._file.flush()
            self._sizes_by_time.append((stamp, self._size))

    def mark_end(self, stamp: float) -> None:
        """Marks that the user ended the recording, so that its end is not taken for a failure of the vehicle.

        The mark is no frame of the link, and does not count as one. A recording without frames is left empty.

        Args:
            stamp: time when it ended, UNIX s.

        Raises:
            OSError: the mark cannot be written.
        """
        if self.frame_count:
            self._write_frame(stamp, end_mark())

    def _write_frame(self, stamp: float, content: bytes) -> None:
        """Writes one frame with its stamp, in the format of the file.

        Args:
            stamp: when the link received it, UNIX s.
            content: all bytes of the frame.

        Raises:
            OSError: it cannot be written.
        """
        microseconds = round(stamp * 1e6)
        if self._mcap is None:
            write_stamped(self._file, [(microseconds, content)])
        else:
            nanoseconds = microseconds * 1000
            self._mcap.add_message(self._channel, nanoseconds, content, nanoseconds)

    def copy_to(self, path: Path) -> None:
        """Copies what was recorded so far to another file, while the recording of a .tlog goes on.

        Args:
            path: path of the file.

        Raises:
            OSError: it cannot be written.
        """
        self._file.flush()
        copyfile(self._path, path)

    def close(self) -> None:
        """Writes the rest and closes the file; closing it again does nothing.

        Raises:
            OSError: the rest cannot be written.
        """
        if self._file.closed:
            return
        with self._file:
            if self._mcap is not None:
                self._mcap.finish()  # type: ignore[no-untyped-call]

    def remove_if_empty(self) -> bool:
        """Deletes the file of a closed recording that has no frame, so that nobody takes it for a log.

        Returns:
            Whether it had none.
        """
        if self.frame_count:
            return False
        Path(self._path).unlink(missing_ok=True)
        return True

    def move_after(
        self, system: int, component: int, destination: RawRecording
    ) -> list[ReceivedPiece]:
        """Moves all frames after the last frame of a vehicle from its closed .tlog to the recording of another vehicle.

        The frames were sent by other vehicles, after this one had become silent. An .mcap stays as it is.

        Args:
            system: MAVLink system id of the vehicle.
            component: MAVLink component id of its autopilot.
            destination: the recording that gets the frames; it is open and has the same format.

        Returns:
            The moved frames with their stamps.

        Raises:
            OSError: one of the files cannot be read, written or cut.
        """
        end_of_last_frame = self._sizes_by_sender.get((system, component))
        if end_of_last_frame is None:
            # The recording has no frame of the vehicle.
            return []
        return self._move_from(end_of_last_frame, destination)

    def move_since_restart(
        self, restart: TimeInterval, system: int, component: int, destination: RawRecording
    ) -> list[ReceivedPiece]:
        """Moves all frames since a restart of a vehicle from its closed .tlog to the recording of its next flight.

        The vehicle was silent while it restarted, so that its longest silence in the interval is the restart. Nothing
        is moved if there is no such silence, nor from an .mcap.

        Args:
            restart: an interval in which the vehicle restarted, UNIX s.
            system: system id of the vehicle.
            component: its component id.
            destination: the recording that gets the frames; it is open and has the same format.

        Returns:
            The moved frames with their stamps.

        Raises:
            OSError: one of the files cannot be read, written or cut.
        """
        if self._mcap is not None:
            # An .mcap ends with an index of its content, so that nothing can be cut off its end.
            return []
        # What came well before the restart, which may be hours of flight, is not read.
        earliest_restart_time, _ = restart
        first_byte = self._offset_before(earliest_restart_time)
        with open(self._path, "rb") as file:
            file.seek(first_byte)
            records = _stamped_records(file.read(self._size - first_byte))
        silence_end = _end_of_longest_silence(records, (system, component), restart)
        if silence_end is None:
            return []
        return self._move_from(first_byte + silence_end, destination)

    def _offset_before(self, time: float) -> int:
        """Returns an offset in a .tlog, bytes, from which on all frames of a given time or later are found.

        Reading from there instead of from the beginning saves time. Up to ``BATCH_SECONDS`` of earlier frames follow
        the offset too, or more if the computer's clock was set back.

        Args:
            time: UNIX s.
        """
        offset = 0
        for stamp, size in self._sizes_by_time:
            if stamp >= time:
                break
            offset = size
        return offset

    def _move_from(self, start: int, destination: RawRecording) -> list[ReceivedPiece]:
        """Moves the end of the closed .tlog, from an offset on, to another recording.

        The frames are cut off here only once the operating system has them in the other file, so that no failure loses
        one. An .mcap stays as it is.

        Args:
            start: offset of the first record to move, bytes.
            destination: the recording that gets the frames; it is open and has the same format.

        Returns:
            The moved frames with their stamps.

        Raises:
            OSError: one of the files cannot be read, written or cut.
        """
        if self._mcap is not None:
            return []
        with open(self._path, "r+b") as file:
            file.seek(start)
            pieces = destination._add_records(file.read(self._size - start))
            file.truncate(start)
        self.frame_count -= len(pieces)
        return pieces

    def _add_records(self, records: bytes) -> list[ReceivedPiece]:
        """Adds records of another .tlog to this one, and passes them on to the operating system.

        Args:
            records: complete records: a time stamp, UNIX µs in ``STAMP_BYTES`` bytes, and a MAVLink frame each.

        Returns:
            For each frame its bytes, and when it arrived, UNIX s.

        Raises:
            OSError: they cannot be written.
        """
        self._file.write(records)
        self._file.flush()
        pieces = []
        for record in _stamped_records(records):
            self._sizes_by_sender[record.sender] = self._size + record.end
            pieces.append(ReceivedPiece(record.stamp, records[record.start : record.end]))
        if pieces and self.frame_count == 0:
            self.first_stamp = pieces[0].arrival_time
        self.frame_count += len(pieces)
        self._size += len(records)
        return pieces


class _StampedRecord(NamedTuple):
    """One frame in the bytes of a .tlog."""

    stamp: float
    """When it arrived, UNIX s."""
    start: int
    """Its first byte, which follows the time stamp."""
    end: int
    """The byte after its last."""
    sender: tuple[int, int]
    """System and component id of its sender."""


def _end_of_longest_silence(
    records: Sequence[_StampedRecord], sender: tuple[int, int], interval: TimeInterval
) -> int | None:
    """Returns the offset in a recording at which the longest silence of a vehicle ends.

    Args:
        records: frames of all senders in the order of the recording.
        sender: system and component id of the vehicle.
        interval: start and end, UNIX s, between which silences are compared; the first one begins at the start.

    Returns:
        Offset, bytes, at which the record of the vehicle's first frame after the silence begins; None without a
        silence.
    """
    start_time, end_time = interval
    longest_silence = 0.0
    end_of_longest = None
    # When the vehicle was heard last, and where the record before the present one ends, bytes.
    heard_time = start_time
    end_of_former_record = 0
    for record in records:
        is_in_interval = start_time < record.stamp <= end_time
        if record.sender == sender and is_in_interval:
            silence = record.stamp - heard_time
            if silence > longest_silence:
                longest_silence = silence
                end_of_longest = end_of_former_record
            heard_time = record.stamp
        end_of_former_record = record.end
    return end_of_longest


def _stamped_records(records: bytes) -> list[_StampedRecord]:
    """Returns the frames in the bytes of a .tlog.

    Args:
        records: complete records: a time stamp, UNIX µs in ``STAMP_BYTES`` bytes, and a MAVLink frame each.
    """
    frames = find_frames(np.frombuffer(records, dtype=np.uint8), crc_extra_table(), STAMP_BYTES)
    senders = list(zip(frames.system.tolist(), frames.component.tolist(), strict=True))
    starts = frames.start.tolist()
    ends = frames.end.tolist()
    stamped_records = []
    for sender, start, end in zip(senders, starts, ends, strict=True):
        # The stamp precedes the frame.
        stamp_bytes = records[start - STAMP_BYTES : start]
        seconds = int.from_bytes(stamp_bytes, "big") / 1e6
        stamped_records.append(_StampedRecord(seconds, start, end, sender))
    return stamped_records


def _create_file(path: PathName) -> BinaryIO:
    """Creates a file for a recording and opens it for writing.

    Args:
        path: path of the file.

    Raises:
        Unreadable: the file exists, or cannot be created. If it exists, the error names a free path.
    """
    try:
        return open(path, "xb")
    except FileExistsError:
        raise Unreadable(
            LinkFact.STREAM_FILE_EXISTS, path=path, free_path=_free_path(Path(path))
        ) from None
    except OSError as error:
        raise Unreadable(
            LinkFact.STREAM_FILE_FAILED, path=path, error=error_message(error)
        ) from None


def _free_path(path: Path) -> Path:
    """Returns the path of a further recording beside one: "flight-2.tlog" for "flight.tlog", or the next free number.

    Args:
        path: path of the recording that exists.
    """
    number = 2
    while numbered_path(path, number).exists():
        number += 1
    return numbered_path(path, number)
