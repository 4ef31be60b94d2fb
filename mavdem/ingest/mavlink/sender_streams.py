"""The frames of one sender in a recording: which are copies by a second link, how many are missing, who sent them.

Most recordings are of one link, whose sequence numbers rise; these alone suffice. Where they do not, frames are taken
one by one (``sender_links``) around copies, and in runs elsewhere: a run is a sequence of frames without a copy.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array, Flags
from mavdem.ingest.byte_rows import Bytes, Offsets, release_pages, rows_of
from mavdem.ingest.mavlink.clock_readings import Rows
from mavdem.ingest.mavlink.dialect import definitions_by_id
from mavdem.ingest.mavlink.framing import CHECKSUM_MATCHES, Frames, frame_content
from mavdem.ingest.mavlink.payloads import decoded_field
from mavdem.ingest.mavlink.sender_links import (
    ATTITUDE_LAYOUT,
    CLOCK_UNITS_PER_SECOND,
    MAX_HEADING_PITCH,
    MAX_LATE_STEPS,
    POSITION_LAYOUT,
    READING_LAYOUTS,
    RECENT_FRAMES,
    SenderLinks,
    clock_reading,
    missing_messages,
)
from mavdem.ingest.mavlink.sequence_counters import ATTITUDE_LAYOUTS, SEQUENCE_NUMBERS
from mavdem.ingest.mavlink.vehicle_tracks import ReadingColumns
from mavdem.ingest.vocabulary import DEGREES_PER_UNIT

MIN_IRREGULAR_FRACTION = 0.005
"""Fraction of frames whose sequence number does not follow that of the frame before, above which several links or two
vehicles are suspected, and all bytes of every frame are compared: a choice.

Two vehicles whose frames come by 50 in turn have twice as many.
"""

LAST_BYTES = np.dtype(np.uint32).itemsize
"""Number of a frame's last bytes by which frames are compared first."""

MIXING_FACTOR = np.uint32(0x9E3779B1)
"""Factor that spreads a small number over 32 bits: 2^32 divided by the golden ratio, as in Knuth, vol. 3, sec. 6.4."""


@dataclass(frozen=True)
class SenderStream:
    """What the frames of one sender show of the links over which they came."""

    is_no_copy: Flags
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
    """Finds out which frames of a sender are copies from a second link, and how many frames are missing.

    Over one link the sequence numbers of a vehicle rise, by more than 1 where messages were lost. In most recordings
    they do, and then the numbers alone suffice. Several links, or two vehicles under the same ids, are suspected in two
    cases: many numbers do not rise, or a frame with a boot clock occurs twice. Only then is every frame compared with
    those before it, which takes much longer.

    Args:
        data: Bytes (B,) of the stream.
        all_frames: The frames (N,) of all senders, in stream order.
        rows: Rows (n,) of the frames of one sender, ascending.

    Returns:
        A flag for each frame (n,) that is not a copy, and the number of missing frames.
    """
    steps = _sequence_steps(all_frames.sequence[rows])
    # ``steps.irregular`` is the number of steps that are 0 or backwards; n frames have n − 1 steps.
    has_many_irregular_steps = steps.irregular > MIN_IRREGULAR_FRACTION * max(len(rows) - 1, 0)
    # Only frames with a boot clock are compared, by hashes of their bytes: others may have the same bytes without being
    # copies.
    clock_indices = _indices_with_boot_clock(all_frames, rows)
    clock_rows = rows[clock_indices]
    hashes = np.zeros(0, dtype=np.uint32)
    # Without an irregular step there are no copies, unless the whole recording is in the file twice.
    if steps.irregular or _is_first_frame_repeated(data, all_frames, clock_rows):
        hashes = _frame_hashes(data, all_frames, clock_rows)
    if not has_many_irregular_steps and not _has_copies(data, all_frames, clock_rows, hashes):
        # One flag stands for all frames, and takes no memory. Duplicates may make the count negative.
        return SenderStream(np.broadcast_to(np.True_, len(rows)), max(steps.missing, 0))
    possible_copies = clock_indices[_possible_copies(hashes)]
    return _sender_stream_of_links(data, all_frames[rows], possible_copies)


ROWS_AT_ONCE = 1 << 18
"""Number of frames of which columns are compared at once: a choice, which bounds the memory for long recordings."""


class _SequenceSteps(NamedTuple):
    """Steps of a sender's sequence numbers, each compared with the number before it."""

    irregular: int
    """Number of steps that are none, or backwards by more than late messages make."""
    missing: int
    """Number of missing frames, less those that came late or twice."""


def _sequence_steps(sequence: Bytes) -> _SequenceSteps:
    """Counts the irregular steps and the missing frames of a sender, by its sequence numbers.

    A step of 0 or backwards is irregular: copies, late frames and second vehicles make it.

    Args:
        sequence: Sequence numbers (n,) of its frames, 0 to 255, in stream order.

    Returns:
        Number of irregular steps, and number of missing frames.
    """
    irregular_count = missing_count = 0
    for block_start in range(0, len(sequence), ROWS_AT_ONCE):
        # One number more than ``ROWS_AT_ONCE``, for the step to the next block. The numbers are signed, since their
        # differences may be negative.
        signed_numbers = sequence[block_start : block_start + ROWS_AT_ONCE + 1].astype(np.int16)
        steps = np.diff(signed_numbers) & (SEQUENCE_NUMBERS - 1)
        irregular_count += int(np.count_nonzero((steps == 0) | (steps > MAX_LATE_STEPS)))
        missing_count += int(missing_messages(signed_numbers[:-1], signed_numbers[1:]).sum())
    return _SequenceSteps(irregular_count, missing_count)


def _indices_with_boot_clock(all_frames: Frames, rows: Rows) -> NDArray[np.int32]:
    """Finds the frames of a sender whose messages have a boot clock that the autopilot itself sets.

    These are the frames with a matching checksum and a message of ``READING_LAYOUTS``. In other messages a companion
    computer or a ground station may have set the time stamp.

    Args:
        all_frames: The frames (N,) of all senders.
        rows: Rows (n,) of the sender's frames in ``all_frames``.

    Returns:
        Indices (m,) into ``rows``, ascending.
    """
    index_blocks = [np.zeros(0, dtype=np.int32)]
    for block_start in range(0, len(rows), ROWS_AT_ONCE):
        block_rows = rows[block_start : block_start + ROWS_AT_ONCE]
        is_readable = all_frames.checksum[block_rows] == CHECKSUM_MATCHES
        has_clock = _has_boot_clock(all_frames.message_id[block_rows]) & is_readable
        index_blocks.append((np.flatnonzero(has_clock) + block_start).astype(np.int32))
    return np.concatenate(index_blocks)


def _has_boot_clock(message_ids: Offsets) -> Flags:
    """Flags the messages whose time stamp is always the time since the autopilot started, its boot clock.

    These are the messages of ``READING_LAYOUTS``, such as ATTITUDE, which the autopilot always stamps itself. In other
    messages it may repeat the time stamp of another computer.

    Args:
        message_ids: (n,) MAVLink ids of messages.

    Returns:
        Flags (n,).
    """
    flags = np.zeros(len(message_ids), dtype=np.bool_)
    for message_id in READING_LAYOUTS:
        flags |= message_ids == message_id
    return flags


def _sender_stream_of_links(data: Bytes, frames: Frames, possible_copies: Rows) -> SenderStream:
    """Finds copies, missing frames and a second vehicle among the frames of a sender that several links may deliver.

    From a possible copy on, while a second link is known, each frame is compared with those before it, one by one. All
    other frames are processed in runs, which is much faster and has the same result
    (``tests/ingest/test_sender_runs.py``).

    Args:
        data: Bytes (B,) of the stream.
        frames: The frames (n,) of one sender, in stream order.
        possible_copies: Rows of frames with a boot clock that may be copies of frames before them, ascending.

    Returns:
        Flags (n,) of frames that are not copies, numbers of missing frames and copies, the longest delay of a copy, s,
        and whether two vehicles sent.
    """
    links = SenderLinks()
    run_processor = _RunProcessor(data, frames, links)
    is_no_copy = np.ones(len(frames), dtype=np.bool_)
    row = 0
    for copy_row in [*possible_copies.tolist(), len(frames)]:
        if row < copy_row:
            run_processor.process(row, copy_row)
            row = copy_row
        # The possible copy itself, and the frames after it while a second link is known.
        for frame in _single_frames(data, frames, row):
            if row > copy_row and not links.has_slower_link:
                break
            is_no_copy[row] = links.process_frame(
                frame.content, frame.message_id, frame.sequence, frame.is_readable
            )
            row += 1
    return SenderStream(
        is_no_copy,
        max(links.missing, 0),
        links.copies,
        links.longest_delay,
        links.has_found_two_vehicles,
    )


FRAMES_AT_ONCE = 256
"""Number of frames whose columns are unpacked at once where frames are taken one by one: a choice."""


class _SingleFrame(NamedTuple):
    """One frame, with the arguments of ``SenderLinks.process_frame``."""

    content: bytes
    """All its bytes."""
    message_id: int
    """Number of its message."""
    sequence: int
    """Its sequence number."""
    is_readable: bool
    """Whether its checksum matches."""


def _single_frames(data: Bytes, frames: Frames, first: int) -> Iterator[_SingleFrame]:
    """Yields the frames of a sender one by one, in the order of the stream.

    Args:
        data: Bytes (B,) of the stream.
        frames: The frames (n,) of the sender.
        first: Row in ``frames`` of the first frame to yield; the frames before it are passed over.

    Yields:
        Content, message and sequence number of each frame.
    """
    # NumPy's view of the memory: slicing it is cheaper than slicing the array.
    content = data.data
    # Columns are converted to lists block by block, which is much faster than element by element.
    for block_start in range(first, len(frames), FRAMES_AT_ONCE):
        block = frames[block_start : block_start + FRAMES_AT_ONCE]
        for start, end, message_id, sequence, checksum in zip(
            block.start.tolist(),
            block.end.tolist(),
            block.message_id.tolist(),
            block.sequence.tolist(),
            block.checksum.tolist(),
            strict=True,
        ):
            is_readable = checksum == CHECKSUM_MATCHES
            yield _SingleFrame(bytes(content[start:end]), message_id, sequence, is_readable)


def _is_first_frame_repeated(data: Bytes, all_frames: Frames, rows: Rows) -> bool:
    """Returns whether the first frame with a boot clock occurs again, as in a file with a repeated recording.

    Args:
        data: Bytes (B,) of the stream.
        all_frames: The frames (N,) of all senders.
        rows: Rows (n,) of the frames of one sender that have a boot clock, in stream order.
    """
    if not len(rows):
        return False
    first_row = int(rows[0])
    message_id = all_frames.message_id[first_row]
    sequence = all_frames.sequence[first_row]
    first_content = frame_content(data, all_frames, first_row)
    for block_start in range(0, len(rows), ROWS_AT_ONCE):
        # Few frames have the same message and sequence number; only of these the bytes are compared.
        block_rows = rows[block_start : block_start + ROWS_AT_ONCE]
        is_similar = all_frames.message_id[block_rows] == message_id
        is_similar &= all_frames.sequence[block_rows] == sequence
        for row in block_rows[is_similar].tolist():
            if row != first_row and frame_content(data, all_frames, row) == first_content:
                return True
        # These frames lie all over a mapped file, whose pages would stay in memory.
        release_pages(data)
    return False


def _frame_hashes(data: Bytes, all_frames: Frames, rows: Rows) -> NDArray[np.uint32]:
    """Computes hashes of frames: equal for equal frames, and rarely equal for different ones.

    A hash is made of the sequence number and the last four bytes: the end of the payload and the checksum, or the end
    of a signature. It has only 32 bits, to save memory in a long recording. Frames with equal hashes are compared byte
    by byte afterwards.

    Args:
        data: Bytes (B,) of the stream.
        all_frames: The frames (N,) of all senders.
        rows: Rows (n,) of frames of one sender.

    Returns:
        Hashes (n,).
    """
    hashes = np.empty(len(rows), dtype=np.uint32)
    for block_start in range(0, len(rows), ROWS_AT_ONCE):
        frames = all_frames[rows[block_start : block_start + ROWS_AT_ONCE]]
        last_bytes = rows_of(data, frames.end - LAST_BYTES, LAST_BYTES).view("<u4")[:, 0]
        # The product wraps at 32 bits.
        mixed_sequence = frames.sequence.astype(np.uint32) * MIXING_FACTOR
        hashes[block_start : block_start + ROWS_AT_ONCE] = mixed_sequence ^ last_bytes
    return hashes


def _repeated_values(values: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Returns the values that occur at least twice, sorted; a value that occurs k times is returned k − 1 times."""
    sorted_values = np.sort(values)
    is_repeated = sorted_values[1:] == sorted_values[:-1]
    return sorted_values[1:][is_repeated]


def _has_copies(data: Bytes, all_frames: Frames, rows: Rows, hashes: NDArray[np.uint32]) -> bool:
    """Returns whether the same frame with a boot clock occurs twice among the frames of a sender.

    A vehicle sends no time twice, so that such a frame was delivered by two links, or recorded twice. Only frames whose
    hash occurs twice are compared byte by byte.

    Args:
        data: Bytes (B,) of the stream.
        all_frames: The frames (N,) of all senders.
        rows: Rows (n,) of the frames of one sender that have a boot clock, in stream order.
        hashes: Their hashes (n,); empty if there cannot be copies.
    """
    repeated_hashes = _repeated_values(hashes)
    if not len(repeated_hashes):
        return False
    earlier_contents = set[bytes]()
    for block_start in range(0, len(rows), ROWS_AT_ONCE):
        block_rows = rows[block_start : block_start + ROWS_AT_ONCE]
        block_hashes = hashes[block_start : block_start + ROWS_AT_ONCE]
        # Binary search for each hash among the repeated ones, which are sorted.
        nearest_index = np.searchsorted(repeated_hashes, block_hashes)
        is_repeated = repeated_hashes.take(nearest_index, mode="clip") == block_hashes
        for row in block_rows[is_repeated].tolist():
            content = frame_content(data, all_frames, row)
            # Before the boot clock has begun, it reads 0, and frames without a time may be equal.
            if content in earlier_contents:
                message_id = int(all_frames.message_id[row])
                if clock_reading(content, message_id) is not None:
                    return True
            earlier_contents.add(content)
        # These frames lie all over a mapped file, whose pages would stay in memory.
        release_pages(data)
    return False


def _possible_copies(hashes: NDArray[np.uint32]) -> Rows:
    """Finds the frames that may be copies of a frame that ``SenderLinks`` still remembers when they arrive.

    ``SenderLinks`` remembers the latest ``RECENT_FRAMES`` distinct frames. So a frame that repeats one of the latest
    ``RECENT_FRAMES`` frames may be a copy. While there are such repetitions, the distinct frames reach further back,
    and any repetition may be a copy. A frame that only repeats one of long ago is of a recording that is in the file
    twice, and shows no second link.

    Args:
        hashes: Hashes (n,) of the frames with a boot clock, in stream order.

    Returns:
        Indices of the possible copies, ascending.
    """
    distance = _distance_to_equal_hash(hashes)
    is_repetition = np.isfinite(distance)
    is_recent_repetition = distance < RECENT_FRAMES
    # Number of these repetitions up to each frame, and up to the frame that is ``RECENT_FRAMES`` earlier.
    repetitions = np.cumsum(is_recent_repetition)
    earlier_repetitions = np.zeros(len(hashes), dtype=np.int64)
    earlier_repetitions[RECENT_FRAMES:] = repetitions[:-RECENT_FRAMES]
    # Where the two numbers differ, a recent repetition is among the latest ``RECENT_FRAMES`` frames.
    is_near_recent_repetition = repetitions > earlier_repetitions
    return np.flatnonzero(is_repetition & is_near_recent_repetition)


def _distance_to_equal_hash(hashes: NDArray[np.uint32]) -> Array:
    """Returns how many frames before each frame the last one with the same hash is.

    Args:
        hashes: Hashes (n,) of frames, in stream order.

    Returns:
        Numbers of frames (n,); infinite where no earlier frame has the same hash.
    """
    # The stable sort puts frames with the same hash one after the other, in stream order.
    order = np.argsort(hashes, kind="stable")
    is_same_hash = hashes[order[1:]] == hashes[order[:-1]]
    frame = order[1:][is_same_hash]
    frame_before = order[:-1][is_same_hash]
    distance = np.full(len(hashes), np.inf)
    distance[frame] = frame - frame_before
    return distance


REMEMBERED_ROWS = 3 * RECENT_FRAMES
"""Number of a run's last frames that are remembered: among them ``RECENT_FRAMES`` are usually distinct."""


class _RunProcessor:
    """Passes runs of a sender's frames (without any copy among them) to its ``SenderLinks``, faster than one by one."""

    def __init__(self, data: Bytes, frames: Frames, links: SenderLinks) -> None:
        """Decodes the readings of all frames.

        Args:
            data: Bytes (B,) of the stream.
            frames: The frames (n,) of one sender, in stream order.
            links: Links that receive them.
        """
        self._data = data
        self._frames = frames
        self._links = links
        self._is_readable = frames.checksum == CHECKSUM_MATCHES
        self._reading_rows, self._readings = _clock_readings(data, frames, self._is_readable)
        has_attitude = np.isin(frames.message_id, list(ATTITUDE_LAYOUTS)) & self._is_readable
        self._attitude_rows = np.flatnonzero(has_attitude)

    def process(self, first: int, end: int) -> None:
        """Passes a run of frames, none of which is a copy, to the sender's links.

        As long as no second link is known, the result is as if ``SenderLinks.process_frame`` had processed each frame.
        Most sequence numbers rise by one, and such frames are counted together, which is faster. So the run is divided
        where a number does not follow the one before: the numbers 7, 8, 9, 12, 13 make two parts, 7 to 9 and 12 to 13.

        Args:
            first: Row of the first frame.
            end: Row after the last frame.
        """
        # Sequence numbers are bytes, from 255 on to 0. As signed numbers they have negative differences there, which
        # the bit mask takes modulo 256.
        sequence = self._frames.sequence[first:end].astype(np.int16)
        steps = np.diff(sequence) & (SEQUENCE_NUMBERS - 1)
        # Each step leads from a row of the run to the next one.
        rows_after_first = np.arange(first + 1, end)
        rows_after_jumps = rows_after_first[steps != 1]
        part_bounds = np.concatenate([[first], rows_after_jumps, [end]])
        # With two counters nearly every frame is a part of its own, so that the attitudes of all are looked up at once.
        attitude_bounds = np.searchsorted(self._attitude_rows, part_bounds)
        rows_of_parts = pairwise(part_bounds.tolist())
        attitudes_of_parts = pairwise(attitude_bounds.tolist())
        for part_rows, part_attitudes in zip(rows_of_parts, attitudes_of_parts, strict=True):
            self._count_successive_frames(*part_rows)
            if self._links.has_two_counters:
                self._compare_attitudes(*part_attitudes)
        first_reading, end_reading = np.searchsorted(self._reading_rows, [first, end]).tolist()
        self._links.add_readings(self._readings.between(first_reading, end_reading))
        # Copies of these frames may follow, unless the recording ends here.
        if end < len(self._frames):
            self._links.remember_frames(self._frames_to_remember(first, end))

    def _count_successive_frames(self, first: int, end: int) -> None:
        """Counts frames whose sequence numbers rise by one from each to the next.

        Only before the first of them may frames be missing, so that it is counted by itself, and the others together.

        Args:
            first: Row of the first frame.
            end: Row after the last frame.
        """
        first_sequence = int(self._frames.sequence[first])
        last_sequence = int(self._frames.sequence[end - 1])
        self._links.count_frame(first_sequence)
        other_frames = end - first - 1
        if other_frames > 0:
            self._links.count_frames_in_order(other_frames, last_sequence)

    def _compare_attitudes(self, first: int, end: int) -> None:
        """Compares some attitudes with those in the frames that the other sequence counter numbers.

        Attitudes that contradict each other show two vehicles under the same ids.

        Args:
            first: Index of the first of these attitudes, among the frames of the sender that have one.
            end: Index after the last of them.
        """
        for row in self._attitude_rows[first:end].tolist():
            self._links.compare_attitude(self._content(row), int(self._frames.message_id[row]))

    def _frames_to_remember(self, first: int, end: int) -> Iterator[tuple[int, bytes]]:
        """Yields the frames of a run by which ``SenderLinks`` may recognise later copies.

        It remembers the latest ``RECENT_FRAMES`` distinct frames. These are usually among the last ``REMEMBERED_ROWS``
        frames of the run; if too many of those are equal, all frames of the run are yielded. Frames whose checksum
        fails are left out.

        Args:
            first: Row of the first frame.
            end: Row after the last frame.

        Yields:
            Number of the sender's frames up to this one, itself included, and the bytes of this frame.
        """
        rows = first + np.flatnonzero(self._is_readable[first:end])
        last_rows = rows[-REMEMBERED_ROWS:]
        distinct_frames = {self._content(row) for row in last_rows.tolist()}
        if len(distinct_frames) >= RECENT_FRAMES:
            rows = last_rows
        for row in rows.tolist():
            yield row + 1, self._content(row)

    def _content(self, row: int) -> bytes:
        """Returns the bytes of a frame."""
        return frame_content(self._data, self._frames, row)


class _RowsOfReadings(NamedTuple):
    """The boot clock, heading and position in frames of one sender, and which frames have them."""

    rows: Rows
    """Row (m,) of the frame of each, ascending."""
    readings: ReadingColumns
    """The readings (m,)."""


def _clock_readings(data: Bytes, frames: Frames, is_readable: Flags) -> _RowsOfReadings:
    """Decodes the boot clock, heading and position in all frames at once, as ``clock_reading`` does for one.

    Args:
        data: Bytes (B,) of the stream.
        frames: The frames (n,) of one sender, in stream order.
        is_readable: Whether the checksum of each (n,) matches.

    Returns:
        Rows of the frames that have a boot clock, with clock (s), heading (rad), latitude and longitude (degrees); NaN
        where a frame has none.
    """
    # A clock of 0 means that the frame has none, or that it has not begun.
    clock = np.zeros(len(frames))
    heading = np.full(len(frames), np.nan)
    latitude = np.full(len(frames), np.nan)
    longitude = np.full(len(frames), np.nan)
    for message_id, layout in READING_LAYOUTS.items():
        rows = np.flatnonzero((frames.message_id == message_id) & is_readable)
        frame_starts = frames.start[rows]
        definition = definitions_by_id()[message_id]
        boot_ms = decoded_field(data, frame_starts, definition, "time_boot_ms")
        clock[rows] = boot_ms / CLOCK_UNITS_PER_SECOND
        if layout is ATTITUDE_LAYOUT:
            pitch = decoded_field(data, frame_starts, definition, "pitch").astype(np.float64)
            yaw = decoded_field(data, frame_starts, definition, "yaw").astype(np.float64)
            # Near the vertical, yaw is not a heading.
            heading[rows] = np.where(abs(pitch) <= MAX_HEADING_PITCH, yaw, np.nan)
        elif layout is POSITION_LAYOUT:
            latitude_units = decoded_field(data, frame_starts, definition, "lat")
            longitude_units = decoded_field(data, frame_starts, definition, "lon")
            # Both are 0 while the position is not known.
            is_known = (latitude_units != 0) | (longitude_units != 0)
            latitude[rows] = np.where(is_known, latitude_units * DEGREES_PER_UNIT, np.nan)
            longitude[rows] = np.where(is_known, longitude_units * DEGREES_PER_UNIT, np.nan)
    clock_rows = np.flatnonzero(clock)
    readings = ReadingColumns(
        clock[clock_rows], heading[clock_rows], latitude[clock_rows], longitude[clock_rows]
    )
    return _RowsOfReadings(clock_rows, readings)
