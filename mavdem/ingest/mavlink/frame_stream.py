"""Recorded streams of MAVLink frames: their receive times, and merging the frames of several recorded channels."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.confidence import Interval
from mavdem.facts import Facts
from mavdem.ingest.byte_rows import Bytes, Offsets
from mavdem.ingest.mavlink.clock_readings import Rows, Times, deviates_from_median
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
        # Read once, since they may have to be read from the file.
        stamps = self.stamps
        rows = np.arange(len(stamps))
        # A stamped frame has its own row here, any other frame the row of the last stamped frame before it.
        last_stamped_row = np.maximum.accumulate(np.where(stamps > 0, rows, 0))
        known_stamps = stamps[last_stamped_row].tolist()
        frame_starts = self.frames.start.tolist()
        frame_ends = self.frames.end.tolist()
        # NumPy's view of the memory: slicing it is cheaper than slicing the array.
        content = self.data.data
        for stamp, start, end in zip(known_stamps, frame_starts, frame_ends, strict=True):
            yield stamp, bytes(content[start:end])


def receive_interval(stream: FrameStream) -> Interval:
    """Returns the first and the last receive stamp of a recording, without outliers.

    The smallest and the largest stamp would not do: a stamp by which damage moved a frame a few minutes back or forth
    is no outlier.

    Args:
        stream: MAVLink frames of the recording, with their receive stamps.

    Returns:
        The first and the last receive stamp, UNIX s; NaN where there is none.
    """
    first_stamp, last_stamp = np.nan, np.nan
    for seconds in _receive_seconds_without_outliers(stream):
        if len(seconds):
            if np.isnan(first_stamp):
                first_stamp = float(seconds[0])
            last_stamp = float(seconds[-1])
    return first_stamp, last_stamp


def _receive_seconds_without_outliers(stream: FrameStream) -> Iterator[Times]:
    """Yields the receive stamps of a recording without those far from their running median.

    Outliers are damaged, or from a computer clock that was not yet set. A long recording is read block by block, to
    bound the memory. The last stamps of a block are checked with the next block, since the window of the median reaches
    to later stamps too.

    Args:
        stream: MAVLink frames of the recording, with their receive stamps.

    Yields:
        Stamps (n,), UNIX s, in the order of the stream; none of them may be left in a block.
    """
    half_window = STAMP_WINDOW // 2
    # Stamps, s, that were yielded, or left out, with the block before: the windows of the next ones reach back to them.
    stamps_before = np.empty(0)
    # Stamps, s, that are not checked yet, since their windows reach into the next block.
    waiting_stamps = np.empty(0)
    for first_row in range(0, len(stream.frames), STAMPS_AT_ONCE):
        end_row = first_row + STAMPS_AT_ONCE
        stamps = stream.receive_stamps(slice(first_row, end_row))
        seconds = np.concatenate([stamps_before, waiting_stamps, stamps[stamps > 0] / MICROSECONDS])
        is_outlier = deviates_from_median(seconds, STAMP_WINDOW, MAX_STAMP_JUMP)
        check_start = len(stamps_before)
        is_last_block = end_row >= len(stream.frames)
        waiting_count = 0 if is_last_block else min(half_window, len(seconds) - check_start)
        check_end = len(seconds) - waiting_count
        checked = slice(check_start, check_end)
        yield seconds[checked][~is_outlier[checked]]
        stamps_before = seconds[max(check_end - half_window, 0) : check_end]
        waiting_stamps = seconds[check_end:]


class ChannelFrames(NamedTuple):
    """The N frames in one channel of a recording, or in several channels that were merged."""

    data: Bytes
    """The bytes with the frames."""
    frames: Frames
    """The frames (N,)."""
    message_number: Offsets
    """Number of the recording's message in which each frame begins (N,)."""
    log_time: NDArray[np.uint64]
    """When that message was recorded (N,), UNIX ns."""


def merged_channels(channels: Sequence[ChannelFrames]) -> ChannelFrames:
    """Merges the frames of several channels of a recording, in the order in which they were recorded.

    The order follows from the number of the recorded message in which each frame begins. The bytes of the frames are
    copied in that order, without bytes that belong to no frame, so that each frame gets a new offset.

    Args:
        channels: The frames of each channel, of at least one. A single one is returned as it is.

    Returns:
        The merged frames, with their bytes.
    """
    if len(channels) == 1:
        return channels[0]
    message_numbers = np.concatenate([channel.message_number for channel in channels])
    log_times = np.concatenate([channel.log_time for channel in channels])
    frames = concatenated_frames([channel.frames for channel in channels])
    frame_counts = [len(channel.frames) for channel in channels]
    channel_of_frame = np.repeat(np.arange(len(channels)), frame_counts)
    order = np.argsort(message_numbers, kind="stable")
    frames = frames[order]
    channel_of_frame = channel_of_frame[order]
    # NumPy's views of the memory: slicing them is cheaper than slicing arrays.
    bytes_of_channels = [channel.data.data for channel in channels]
    places = zip(channel_of_frame.tolist(), frames.start.tolist(), frames.end.tolist(), strict=True)
    merged_data = bytearray()
    for channel_number, start, end in places:
        merged_data += bytes_of_channels[channel_number][start:end]
    # Each frame now begins where the one before it ends.
    new_ends = np.cumsum(frames.size, dtype=np.int64)
    frames = replace(frames, start=new_ends - frames.size)
    return ChannelFrames(
        np.frombuffer(merged_data, dtype=np.uint8),
        frames,
        message_numbers[order],
        log_times[order],
    )
