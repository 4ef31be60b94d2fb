"""The frames of one sender in a recording: which are copies, how many are missing, and whether two vehicles sent them.

Most recordings are of one link, whose sequence numbers rise; these alone suffice. Where they do not, frames are taken
one by one (``sender_links``) around copies, and in runs elsewhere.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Flags
from mavdem.ingest.byte_rows import Bytes, Offsets, release_pages, rows_of
from mavdem.ingest.mavlink.clocks import Rows
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

MIN_IRREGULAR_SHARE = 0.005
"""Share of frames whose sequence number does not follow that of the frame before, above which several links or two
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
    has_several_links = steps.irregular > MIN_IRREGULAR_SHARE * max(len(rows) - 1, 0)
    reading_rows = _rows_of_possible_readings(all_frames, rows)
    frame_rows = rows[reading_rows]
    # Without an irregular step or a repeated first reading there are no copies, and no keys are needed to find them.
    keys = np.zeros(0, dtype=np.uint32)
    if steps.irregular or _first_reading_is_repeated(data, all_frames, frame_rows):
        keys = _frame_keys(data, all_frames, frame_rows)
    if not has_several_links and not _has_copies(data, all_frames, frame_rows, keys):
        # One flag stands for all frames, and takes no memory. Duplicates may make the count negative.
        return SenderStream(np.broadcast_to(np.True_, len(rows)), max(steps.missing, 0))
    return _sender_stream_of_links(data, all_frames[rows], reading_rows[_possible_copies(keys)])


ROWS_AT_ONCE = 1 << 18
"""Number of frames of which columns are compared at once: a choice, which bounds the memory for long recordings."""


class _SequenceSteps(NamedTuple):
    """Steps of a sender's sequence numbers, each compared with the number before it."""

    irregular: int
    """Number of steps that are none, or backwards by more than late messages make."""
    missing: int
    """Number of missing frames, less those that came late or twice."""


def _sequence_steps(sequence: Bytes) -> _SequenceSteps:
    """Counts irregular steps and missing frames of a sender.

    Args:
        sequence: Sequence numbers (n,) of its frames, in stream order.

    Returns:
        Number of steps that are 0 or go back, as copies and late frames make them, and number of missing frames.
    """
    irregular = missing = 0
    for first in range(0, len(sequence), ROWS_AT_ONCE):
        # A part includes the first number of the next one. The numbers are signed: their differences may be negative.
        part = sequence[first : first + ROWS_AT_ONCE + 1].astype(np.int16)
        steps = np.diff(part) & (SEQUENCE_NUMBERS - 1)
        irregular += int(np.count_nonzero((steps == 0) | (steps > MAX_LATE_STEPS)))
        missing += int(missing_messages(part[:-1], part[1:]).sum())
    return _SequenceSteps(irregular, missing)


def _rows_of_possible_readings(all_frames: Frames, rows: Rows) -> NDArray[np.int32]:
    """Finds the frames of a sender from which its boot clock may be read.

    These are the readable ones of the messages in ``READING_LAYOUTS``, whose ``time_boot_ms`` or ``time_usec`` is set
    by the autopilot and not by a companion computer or ground station.

    Args:
        all_frames: The frames (N,) of all senders.
        rows: Rows (n,) of the sender's frames in ``all_frames``.

    Returns:
        Positions (m,) of the found frames in ``rows``, ascending.
    """
    parts = [np.zeros(0, dtype=np.int32)]
    for first in range(0, len(rows), ROWS_AT_ONCE):
        part = rows[first : first + ROWS_AT_ONCE]
        is_readable = all_frames.checksum[part] == CHECKSUM_MATCHES
        has_reading = _has_reading(all_frames.message_id[part]) & is_readable
        parts.append((np.flatnonzero(has_reading) + first).astype(np.int32))
    return np.concatenate(parts)


def _has_reading(message_ids: Offsets) -> Flags:
    """Flags the messages from whose stamps the boot clock may be read: their ids are in ``READING_LAYOUTS``.

    Args:
        message_ids: (n,) ids of messages.

    Returns:
        Flags (n,).
    """
    flags = np.zeros(len(message_ids), dtype=np.bool_)
    for message_id in READING_LAYOUTS:
        flags |= message_ids == message_id
    return flags


def _sender_stream_of_links(data: Bytes, frames: Frames, possible_copies: Rows) -> SenderStream:
    """Finds copies, missing frames and a second vehicle among the frames of a sender.

    Around a copy, while a second link is known, each frame is compared with those before it, one by one. All other
    frames are processed in runs, which is much faster and has the same result (``tests/ingest/test_sender_runs.py``).

    Args:
        data: Bytes (B,) of the stream.
        frames: The frames (n,) of one sender, in stream order.
        possible_copies: Rows of frames with a boot clock that may be copies of frames before them, ascending.

    Returns:
        Flags (n,) of frames that are no copies, numbers of missing frames and copies, the longest delay of a copy, s,
        and whether two vehicles sent.
    """
    links = SenderLinks()
    run_processor = _RunProcessor(data, frames, links)
    is_first = np.ones(len(frames), dtype=np.bool_)
    row = 0
    for copy_row in [*possible_copies.tolist(), len(frames)]:
        if row < copy_row:
            run_processor.process(row, copy_row)
            row = copy_row
        # The possible copy itself, and the frames after it while a second link is known.
        for frame in _single_frames(data, frames, row):
            if row > copy_row and not links.has_late_link:
                break
            is_first[row] = links.process_frame(
                frame.content, frame.message_id, frame.sequence, frame.is_readable
            )
            row += 1
    return SenderStream(
        is_first,
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
    # NumPy's view of the memory, whose slices are cheaper than those of the array.
    content = data.data
    for begin in range(first, len(frames), FRAMES_AT_ONCE):
        part = frames[begin : begin + FRAMES_AT_ONCE]
        for start, end, message_id, sequence, checksum in zip(
            part.start.tolist(),
            part.end.tolist(),
            part.message_id.tolist(),
            part.sequence.tolist(),
            part.checksum.tolist(),
            strict=True,
        ):
            is_readable = checksum == CHECKSUM_MATCHES
            yield _SingleFrame(bytes(content[start:end]), message_id, sequence, is_readable)


def _first_reading_is_repeated(data: Bytes, all_frames: Frames, rows: Rows) -> bool:
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
    for first in range(0, len(rows), ROWS_AT_ONCE):
        part = rows[first : first + ROWS_AT_ONCE]
        is_alike = all_frames.message_id[part] == message_id
        is_alike &= all_frames.sequence[part] == sequence
        for row in part[is_alike].tolist():
            if row != first_row and frame_content(data, all_frames, row) == first_content:
                return True
        # These frames lie all over the file.
        release_pages(data)
    return False


def _frame_keys(data: Bytes, all_frames: Frames, rows: Rows) -> NDArray[np.uint32]:
    """Computes keys that are equal for equal frames, and rarely for different ones.

    They are made of the sequence number and the last four bytes: the end of the payload and the checksum, or the end of
    a signature. Both are mixed into 32 bits, since of a long recording the keys take much memory. Afterwards frames
    with equal keys are compared byte by byte.

    Args:
        data: Bytes (B,) of the stream.
        all_frames: The frames (N,) of all senders.
        rows: Rows (n,) of frames of one sender.

    Returns:
        (n,) keys.
    """
    keys = np.empty(len(rows), dtype=np.uint32)
    for first in range(0, len(rows), ROWS_AT_ONCE):
        frames = all_frames[rows[first : first + ROWS_AT_ONCE]]
        last_bytes = rows_of(data, frames.end - LAST_BYTES, LAST_BYTES).view("<u4")[:, 0]
        # The product wraps at 32 bits.
        mixed_sequence = frames.sequence.astype(np.uint32) * MIXING_FACTOR
        keys[first : first + ROWS_AT_ONCE] = mixed_sequence ^ last_bytes
    return keys


def _has_copies(data: Bytes, all_frames: Frames, rows: Rows, keys: NDArray[np.uint32]) -> bool:
    """Returns whether a frame with a boot clock occurs twice among the frames of a sender.

    Args:
        data: Bytes (B,) of the stream.
        all_frames: The frames (N,) of all senders.
        rows: Rows (n,) of the frames of one sender that have a boot clock, in stream order.
        keys: Their keys (n,), or none if there cannot be copies.

    Returns:
        True for at least one pair of equal frames.
    """
    sorted_keys = np.sort(keys)
    repeated_keys = sorted_keys[1:][sorted_keys[1:] == sorted_keys[:-1]]
    del sorted_keys
    if not len(repeated_keys):
        return False
    contents = set[bytes]()
    for first in range(0, len(rows), ROWS_AT_ONCE):
        part_keys = keys[first : first + ROWS_AT_ONCE]
        # Binary search for each key among the repeated ones, which are sorted.
        key_rows = np.searchsorted(repeated_keys, part_keys)
        is_repeated = repeated_keys.take(key_rows, mode="clip") == part_keys
        for row in rows[first : first + ROWS_AT_ONCE][is_repeated].tolist():
            frame = frame_content(data, all_frames, row)
            is_copy = frame in contents
            if is_copy and clock_reading(frame, int(all_frames.message_id[row])) is not None:
                return True
            contents.add(frame)
        # These frames lie all over the file.
        release_pages(data)
    return False


def _possible_copies(keys: NDArray[np.uint32]) -> Rows:
    """Finds the frames that may be copies of one of the frames shortly before.

    An equal frame more than ``RECENT_FRAMES`` frames earlier does not count: it is of a recording that is repeated in
    the file, and shows no second link.

    Args:
        keys: Keys (n,) of the frames with a boot clock, in stream order.

    Returns:
        Their rows, ascending.
    """
    order = np.argsort(keys, kind="stable")
    is_repeated = keys[order[1:]] == keys[order[:-1]]
    repeated_rows = order[1:][is_repeated]
    frames_since = np.full(len(keys), np.inf)
    frames_since[repeated_rows] = repeated_rows - order[:-1][is_repeated]
    # ``SenderLinks`` remembers the latest ``RECENT_FRAMES`` different frames. Where some of the latest frames repeat
    # each other, older ones are among these, so that any repeated key is a possible copy there.
    repeats_until = np.cumsum(frames_since < RECENT_FRAMES)
    repeats_before = np.zeros(len(keys), dtype=np.int64)
    repeats_before[RECENT_FRAMES:] = repeats_until[:-RECENT_FRAMES]
    has_recent_repeats = repeats_until > repeats_before
    return np.flatnonzero(np.isfinite(frames_since) & has_recent_repeats)


REMEMBERED_ROWS = 3 * RECENT_FRAMES
"""Number of a run's last frames that are remembered: among them ``RECENT_FRAMES`` are usually distinct."""


class _RunProcessor:
    """Processes runs of a sender's frames that contain no copies, without comparing their bytes."""

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
        The run is cut where a sequence number does not follow the one before; frames between two cuts are counted
        together, which is faster.

        Args:
            first, end: Row of the first frame, and the row after the last one.
        """
        # Signed numbers, so that their differences may be negative; the bit mask takes them modulo 256.
        sequence = self._frames.sequence[first:end].astype(np.int16)
        steps = np.diff(sequence) & (SEQUENCE_NUMBERS - 1)
        # Row of the first frame after each cut. The run's first frame is one: a copy may lie before it.
        breaks = np.concatenate([[0], np.flatnonzero(steps != 1) + 1])
        run_ends = np.append(breaks[1:], len(sequence))
        # The frames with an attitude between two cuts are given by their range among all frames with an attitude.
        attitudes_before = np.searchsorted(self._attitude_rows, first + breaks)
        attitudes_at_end = np.searchsorted(self._attitude_rows, first + run_ends)
        for break_row, run_end, first_attitude, end_attitude in zip(
            breaks.tolist(),
            run_ends.tolist(),
            attitudes_before.tolist(),
            attitudes_at_end.tolist(),
            strict=True,
        ):
            self._links.count_frame(int(sequence[break_row]))
            if run_end > break_row + 1:
                count = run_end - break_row - 1
                self._links.count_frames_in_order(count, int(sequence[run_end - 1]))
            if self._links.has_two_counters:
                self._compare_attitudes(first_attitude, end_attitude)
        first_reading, end_reading = np.searchsorted(self._reading_rows, [first, end]).tolist()
        self._links.add_readings(self._readings.part(first_reading, end_reading))
        if end < len(self._frames):
            self._links.remember(self._contents(first, end))

    def _compare_attitudes(self, first: int, end: int) -> None:
        """Compares attitudes ``first`` to ``end`` − 1, counted among the attitudes of all frames, with the others."""
        for row in self._attitude_rows[first:end].tolist():
            self._links.compare_attitude(self._content(row), int(self._frames.message_id[row]))

    def _contents(self, first: int, end: int) -> Iterator[tuple[int, bytes]]:
        """Yields the readable frames of a run that are to be remembered, so that later copies are recognised.

        These are the last ``REMEMBERED_ROWS``, or all frames if too many of the last ones are equal.

        Args:
            first, end: Row of the first frame, and the row after the last one.

        Yields:
            Number of frames that the sender had sent with this one, and the bytes of the frame.
        """
        rows = first + np.flatnonzero(self._is_readable[first:end])
        last_contents = {self._content(row) for row in rows[-REMEMBERED_ROWS:].tolist()}
        if len(last_contents) >= RECENT_FRAMES:
            rows = rows[-REMEMBERED_ROWS:]
        for row in rows.tolist():
            yield row + 1, self._content(row)

    def _content(self, row: int) -> bytes:
        """Returns the bytes of a frame."""
        return frame_content(self._data, self._frames, row)


class _RowsOfReadings(NamedTuple):
    """The readings of a sender, and where they are."""

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
            # Near the vertical, yaw is no heading.
            is_heading = abs(pitch) <= MAX_HEADING_PITCH
            heading[rows[is_heading]] = yaw[is_heading]
        elif layout is POSITION_LAYOUT:
            latitude_units = decoded_field(data, frame_starts, definition, "lat")
            longitude_units = decoded_field(data, frame_starts, definition, "lon")
            # Both are 0 while the position is not known.
            is_known = (latitude_units != 0) | (longitude_units != 0)
            latitude[rows[is_known]] = latitude_units[is_known] * DEGREES_PER_UNIT
            longitude[rows[is_known]] = longitude_units[is_known] * DEGREES_PER_UNIT
    # A frame without a boot clock has 0 in this column.
    clock_rows = np.flatnonzero(clock)
    readings = ReadingColumns(
        clock[clock_rows], heading[clock_rows], latitude[clock_rows], longitude[clock_rows]
    )
    return _RowsOfReadings(clock_rows, readings)
