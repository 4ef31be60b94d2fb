"""The frames of one sender in a recording: which are copies, how many are missing, and are they of two vehicles?

Most recordings are of one link, whose sequence numbers rise; these alone suffice. Only where they do not, every frame
is compared with those before it (``sender_links``), which takes much longer.
"""

from dataclasses import dataclass

import numpy as np

from mavdem.arrays import Flags
from mavdem.ingest.byte_rows import Bytes, Offsets, rows_of
from mavdem.ingest.mavlink.clocks import Rows
from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES, Frames
from mavdem.ingest.mavlink.sender_links import (
    MAX_LATE_STEPS,
    READING_LAYOUTS,
    SenderLinks,
    clock_reading,
    missing_messages,
)
from mavdem.ingest.mavlink.sequence_counters import SEQUENCE_NUMBERS

MIN_IRREGULAR_SHARE = 0.005
"""Share of frames whose sequence number does not follow that of the frame before, above which several links or two
vehicles are suspected, and all bytes of every frame are compared: a choice.

Two vehicles whose frames come by 50 in turn have twice as many.
"""

LAST_BYTES = np.dtype(np.uint32).itemsize
"""Number of a frame's last bytes by which frames are compared first."""


@dataclass(frozen=True)
class SenderStream:
    """What the frames of one sender show of the links over which they came."""

    is_first: Flags
    """Whether each frame (n,) is no copy of an earlier one."""
    lost: int
    """Number of messages that are missing, by the gaps in the sequence numbers."""
    copies: int = 0
    """Number of copies."""
    longest_delay: float = 0.0
    """How late a copy was at most, s of the boot clock."""
    has_two_senders: bool = False
    """Whether they are frames of two vehicles."""


def sender_stream_of(data: Bytes, all_frames: Frames, rows: Rows) -> SenderStream:
    """Finds out over which links the frames of a sender came, which of them are copies, and how many are missing.

    Over one link the sequence numbers of one vehicle rise, by more than 1 where messages were lost. Most recordings are
    like that, and the numbers alone suffice. Several links, or two vehicles under the same ids, are suspected in two
    cases: many numbers do not rise, or a frame with a boot clock comes twice. Only then every frame is compared with
    those before it, which takes much longer.

    Args:
        data: The stream (B,).
        all_frames: The frames (N,) of all senders, in stream order.
        rows: Rows (n,) of the frames of one sender, ascending.
    """
    # Signed numbers, so that their differences may be negative.
    sequence = all_frames.sequence[rows].astype(np.int16)
    steps = np.diff(sequence) & (SEQUENCE_NUMBERS - 1)
    is_irregular = (steps == 0) | (steps > MAX_LATE_STEPS)
    has_several_links = np.count_nonzero(is_irregular) > MIN_IRREGULAR_SHARE * len(steps)
    if not has_several_links:
        may_have_copies = bool(is_irregular.any())
        readings = all_frames[rows[_has_reading(all_frames.message_id[rows])]]
        if not may_have_copies:
            may_have_copies = _first_reading_is_repeated(data, readings)
        has_several_links = np.bool_(may_have_copies and _has_copies(data, readings))
    if not has_several_links:
        lost = int(missing_messages(sequence[:-1], sequence[1:]).sum())
        return SenderStream(np.ones(len(rows), dtype=np.bool_), max(lost, 0))
    return _sender_stream_of_links(data, all_frames[rows])


def _has_reading(message_ids: Offsets) -> Flags:
    """Flags messages (n,), by their ids, that have a boot clock which the autopilot itself stamps."""
    flags = np.zeros(len(message_ids), dtype=np.bool_)
    for message_id in READING_LAYOUTS:
        flags |= message_ids == message_id
    return flags


def _sender_stream_of_links(data: Bytes, frames: Frames) -> SenderStream:
    """Compares each frame of a sender with those before it, to find copies, missing frames and a second vehicle.

    Args:
        data: The stream (B,).
        frames: The frames (n,) of one sender, in stream order.
    """
    links = SenderLinks()
    # NumPy's view of the memory, whose slices are cheaper than those of the array.
    content = data.data
    is_first = []
    is_readable = frames.checksum == CHECKSUM_MATCHES
    for start, end, message_id, number, readable in zip(
        frames.start.tolist(),
        frames.end.tolist(),
        frames.message_id.tolist(),
        frames.sequence.tolist(),
        is_readable.tolist(),
        strict=True,
    ):
        is_first.append(links.take(bytes(content[start:end]), message_id, number, readable))
    return SenderStream(
        np.array(is_first, dtype=np.bool_),
        max(links.missing, 0),
        links.copies,
        links.longest_delay,
        links.has_found_two_vehicles,
    )


def _first_reading_is_repeated(data: Bytes, frames: Frames) -> bool:
    """Returns whether the first frame with a boot clock comes again, as where a whole recording is repeated.

    Args:
        data: The stream (B,).
        frames: The frames (n,) of one sender that have a boot clock, in stream order.
    """
    if not len(frames):
        return False
    is_alike = (frames.message_id == frames.message_id[0]) & (frames.sequence == frames.sequence[0])
    # NumPy's view of the memory, whose slices are cheaper than those of the array.
    content = data.data
    first_content = bytes(content[int(frames.start[0]) : int(frames.end[0])])
    for row in np.flatnonzero(is_alike)[1:].tolist():
        start, end = int(frames.start[row]), int(frames.end[row])
        if bytes(content[start:end]) == first_content:
            return True
    return False


def _has_copies(data: Bytes, frames: Frames) -> bool:
    """Returns whether a frame with a boot clock comes twice among the frames of a sender.

    Frames are compared by their sequence number and their last four bytes, the end of the payload and the checksum, or
    the end of a signature; those that agree, by all bytes.

    Args:
        data: The stream (B,).
        frames: The frames (n,) of one sender that have a boot clock, in stream order.
    """
    last_bytes = rows_of(data, frames.end - LAST_BYTES, LAST_BYTES).view("<u4")[:, 0]
    keys = frames.sequence.astype(np.uint64) << np.uint64(8 * LAST_BYTES) | last_bytes
    sorted_keys = np.sort(keys)
    repeated_keys = sorted_keys[1:][sorted_keys[1:] == sorted_keys[:-1]]
    if not len(repeated_keys):
        return False
    candidates = np.flatnonzero(np.isin(keys, repeated_keys))
    # NumPy's view of the memory, whose slices are cheaper than those of the array.
    content = data.data
    contents = set[bytes]()
    for row in candidates.tolist():
        frame = bytes(content[int(frames.start[row]) : int(frames.end[row])])
        message_id = int(frames.message_id[row])
        if frame in contents and clock_reading(frame, message_id) is not None:
            return True
        contents.add(frame)
    return False
