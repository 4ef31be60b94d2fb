"""Recorded streams of MAVLink frames: their receive times, and joining the frames of several channels."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.confidence import Interval
from mavdem.facts import Facts
from mavdem.ingest.byte_rows import Bytes, Offsets
from mavdem.ingest.mavlink.clocks import Rows, deviates_from_median
from mavdem.ingest.mavlink.framing import Frames, concatenated_frames
from mavdem.ingest.telemetry import MICROSECONDS

MAX_STAMP_JUMP = 3600.0
"""Deviation of a receive stamp from the median of those around it, s, beyond which it is wrong: a choice."""

STAMP_WINDOW = 9
"""Number of receive stamps of which that median is taken."""

STAMPS_AT_ONCE = 1 << 20
"""Number of frames whose receive stamps are in memory at once: a choice, which bounds it for long recordings."""

MAX_NANOSECOND_STAMP = np.iinfo(np.uint64).max // 1000 - 1
"""The last receive stamp, µs, that 64 bits of nanoseconds hold, as in MCAP recordings: in the year 2554."""


@dataclass(frozen=True, eq=False)
class FrameStream:
    """A recorded stream of N frames, not yet sorted by sender."""

    source: str
    """The file or link it came from."""
    file_ending: str
    """The usual ending of the names of such files: ".tlog"."""
    data: Bytes
    """The bytes with the frames, in the order of the recording."""
    frames: Frames
    """The frames (N,), in the same order."""
    receive_stamps: Callable[[slice | Rows], NDArray[np.uint64]]
    """Function that returns when the frames in some rows (n,) were received, UNIX µs, as recorded; 0 where not."""
    bytes_skipped: int
    """Number of bytes of the recording that belong to no frame."""
    repairs: Facts
    """What was odd or damaged, and what was done about it."""

    @property
    def stamps(self) -> NDArray[np.uint64]:
        """When each frame was received (N,), UNIX µs, as recorded; 0 where that was not."""
        return self.receive_stamps(slice(None))

    def stamped_frames(self) -> Iterator[tuple[int, bytes]]:
        """Yields receive stamp, UNIX µs, and bytes of each frame, for writing the stream to a file.

        A frame without a stamp gets the stamp of the last stamped frame before it; 0 if there is no such frame.
        """
        stamps = self.stamps
        rows = np.arange(len(stamps))
        last_stamped_row = np.maximum.accumulate(np.where(stamps > 0, rows, 0))
        # NumPy's view of the memory, whose slices are cheaper than those of the array.
        content = self.data.data
        for stamp, start, end in zip(
            stamps[last_stamped_row].tolist(),
            self.frames.start.tolist(),
            self.frames.end.tolist(),
            strict=True,
        ):
            yield stamp, bytes(content[start:end])


def receive_interval(stream: FrameStream) -> Interval:
    """Returns the first and the last receive stamp of a recording.

    Stamps far from the running median are left out: they are damaged, or from a computer clock that was not yet set.
    A long recording is read in parts, to bound the memory. The last stamps of a part are judged with the next part,
    since the window of the median reaches to later stamps too.

    Args:
        stream: The recording.

    Returns:
        The first and the last receive stamp, UNIX s; NaN where there is none.
    """
    first_stamps, last_stamps = [], []
    margin = STAMP_WINDOW // 2
    seconds = np.empty(0)
    # How many of the first values of ``seconds`` were judged in the part before, and are kept only for the median.
    compared_frames = 0
    for first_row in range(0, len(stream.frames), STAMPS_AT_ONCE):
        end_row = first_row + STAMPS_AT_ONCE
        stamps = stream.receive_stamps(slice(first_row, end_row))
        seconds = np.concatenate([seconds, stamps[stamps > 0] / MICROSECONDS])
        end = len(seconds)
        if end_row < len(stream.frames):
            end = max(end - margin, compared_frames)
        is_outlier = deviates_from_median(seconds, STAMP_WINDOW, MAX_STAMP_JUMP)
        trusted_seconds = seconds[compared_frames:end][~is_outlier[compared_frames:end]]
        if len(trusted_seconds):
            first_stamps.append(float(trusted_seconds.min()))
            last_stamps.append(float(trusted_seconds.max()))
        first_kept = max(end - margin, 0)
        seconds = seconds[first_kept:]
        compared_frames = end - first_kept
    if not first_stamps:
        return np.nan, np.nan
    return min(first_stamps), max(last_stamps)


class RecordingPart(NamedTuple):
    """Some of the frames of a recording, N of them, such as those of one channel."""

    data: Bytes
    """The bytes with the frames."""
    frames: Frames
    """The frames (N,)."""
    position: Offsets
    """Number of the recording's message in which each frame begins (N,)."""
    log_time: NDArray[np.uint64]
    """When that message was recorded (N,), UNIX ns."""


def joined_parts(parts: Sequence[RecordingPart]) -> RecordingPart:
    """Joins parts of a recording into one whose frames and bytes are in the order of the recording.

    A recording may have frames in several channels, which are read one by one as parts. Here they are merged by the
    number of the recorded message in which each frame begins. The bytes of the frames are copied in that order, without
    the bytes between them, and the frames get new offsets.

    Args:
        parts: The parts, at least one. A single one is returned as it is.

    Returns:
        The joined part.
    """
    if len(parts) == 1:
        return parts[0]
    positions = np.concatenate([part.position for part in parts])
    log_times = np.concatenate([part.log_time for part in parts])
    frames = concatenated_frames([part.frames for part in parts])
    part_numbers = np.repeat(np.arange(len(parts)), [len(part.frames) for part in parts])
    order = np.argsort(positions, kind="stable")
    frames = frames[order]
    # NumPy's views of the memory, whose slices are cheaper than those of arrays.
    contents = [part.data.data for part in parts]
    data = bytearray()
    for part_number, start, end in zip(
        part_numbers[order].tolist(), frames.start.tolist(), frames.end.tolist(), strict=True
    ):
        data += contents[part_number][start:end]
    ends = np.cumsum(frames.size, dtype=np.int64)
    frames = replace(frames, start=ends - frames.size)
    return RecordingPart(
        np.frombuffer(data, dtype=np.uint8), frames, positions[order], log_times[order]
    )
