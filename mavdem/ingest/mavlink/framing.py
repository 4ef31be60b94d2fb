"""Finding MAVLink frames in a stream of bytes, block by block, as a table with one row per frame.

A frame matches when its checksum agrees with its content. The bytes FD and FE that begin frames also occur inside
payloads and time stamps, so each of them is only a candidate. Candidates are accepted in this order:

1. ``linked`` frames: the checksum matches, and another marker is where the next frame should begin, or the bytes end;
2. frames of another dialect, or damaged ones of the right length, whose checksum cannot match: they fill the space
   between two linked frames exactly;
3. ``isolated`` frames: others whose checksum matches, in the space that is left.

A linked frame decides about all bytes before it, so the scan holds no more than a block and the bytes since the last
linked frame.

Sources: https://mavlink.io/en/guide/serialization.html (layout, truncation; the checksum is that of the bytes after the
marker and then of CRC_EXTRA), https://mavlink.io/en/guide/message_signing.html (signature of 13 bytes).
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from mavdem.arrays import Flags
from mavdem.ingest.byte_rows import RESIDENT_BYTES, Bytes, Offsets, release_pages, rows_of
from mavdem.ingest.mavlink.checksums import BlockChecksums, registers_after
from mavdem.ingest.mavlink.dialect import CrcExtras

MARKER_V1 = 0xFE
"""First byte of a frame of MAVLink 1."""
MARKER_V2 = 0xFD
"""First byte of a frame of MAVLink 2."""
MARKERS = (bytes([MARKER_V1]), bytes([MARKER_V2]))
"""First bytes of frames, for ``bytes.startswith``."""

SIGNED_FLAG = 1
"""Incompatibility flag of a frame with a signature, the only one that is defined."""

HEADER_BYTES_V1 = 6
"""Number of bytes before the payload in MAVLink 1."""
HEADER_BYTES_V2 = 10
"""Number of bytes before the payload in MAVLink 2."""
CHECKSUM_BYTES = np.uint16().itemsize
"""Number of bytes of the checksum, which follows the payload."""
SIGNATURE_BYTES = 13
"""Number of bytes of the signature, which follows the checksum."""
MAX_FRAME_BYTES = HEADER_BYTES_V2 + np.iinfo(np.uint8).max + CHECKSUM_BYTES + SIGNATURE_BYTES
"""Number of bytes of the longest frame: one of MAVLink 2 with a payload of 255 bytes and a signature."""

# Where the fields of a header are, in bytes from the marker.

LENGTH_BYTE = 1
"""Offset of the number of payload bytes, in both versions."""
INCOMPATIBILITY_BYTE = 2
"""Offset of the incompatibility flags, in MAVLink 2."""
SENDER_BYTES_V1 = slice(2, 5)
"""Sequence number, system id and component id in MAVLink 1."""
SENDER_BYTES_V2 = slice(4, 7)
"""Sequence number, system id and component id in MAVLink 2."""
MESSAGE_ID_BYTE_V1 = 5
"""Offset of the message id in MAVLink 1, one byte."""
MESSAGE_ID_BYTE_V2 = 7
"""Offset of the first of three bytes of the message id in MAVLink 2, the lowest first."""
MESSAGE_ID_BYTES_V2 = 3
"""Number of bytes of the message id in MAVLink 2."""
LENGTH_FIELDS_BYTES = 3
"""Number of a header's first bytes that determine the length of its frame, in both versions."""

SCANNED_BYTES = 1 << 20
"""Number of bytes that are scanned at a time: a choice, with which the calls for each block cost little.

It bounds the memory for a hostile stream in which all bytes are markers.
"""

CHECKSUM_MATCHES, MESSAGE_UNKNOWN, CHECKSUM_FAILED = range(1, 4)
"""State of a frame: its checksum matches; its message is not in the dialect; its checksum does not match."""


@dataclass(frozen=True, eq=False)
class Frames:
    """A table of N frames in stream order; every column has shape (N,).

    The table of a whole stream has the narrow types of ``COLUMN_TYPES``.
    """

    start: Offsets
    """Offset of the marker in the stream."""
    size: Offsets
    """Number of bytes of the whole frame."""
    message_id: Offsets
    """MAVLink's number of the message."""
    system: Bytes
    """System id of the sender."""
    component: Bytes
    """Component id of the sender."""
    sequence: Bytes
    """Number that each sender counts up with every frame, from 255 to 0."""
    checksum: Bytes
    """``CHECKSUM_MATCHES``, ``MESSAGE_UNKNOWN`` or ``CHECKSUM_FAILED``."""

    @property
    def end(self) -> Offsets:
        """Offset after the last byte of each frame (N,)."""
        return self.start + self.size

    def __len__(self) -> int:
        return len(self.start)

    def __getitem__(self, rows: slice | Flags | Offsets) -> Frames:
        return Frames(*(column[rows] for column in vars(self).values()))


def frame_content(data: Bytes, frames: Frames, row: int) -> bytes:
    """Copies a whole frame out of the stream.

    Args:
        data: Bytes (B,) of the stream.
        frames: Frames (N,) that were found in these bytes.
        row: Row of the wanted frame among them.

    Returns:
        Its bytes, from the marker to the last byte.
    """
    start = int(frames.start[row])
    # NumPy's view of the memory: slicing it is cheaper than slicing the array.
    return bytes(data.data[start : start + int(frames.size[row])])


COLUMN_TYPES = {
    "start": np.int32,
    "size": np.int16,
    "message_id": np.int32,
    "system": np.uint8,
    "component": np.uint8,
    "sequence": np.uint8,
    "checksum": np.uint8,
}
"""Types of the columns of a whole stream's frames, 14 bytes together; the offsets suffice for 2 GiB."""


class _FrameColumns:
    """Collects tables of frames into one: column by column, so that no frame is held twice."""

    def __init__(self) -> None:
        """Starts with no frames."""
        self._columns = {name: bytearray() for name in COLUMN_TYPES}

    def add(self, frames: Frames) -> None:
        """Appends a table of frames."""
        for name, column_type in COLUMN_TYPES.items():
            self._columns[name] += getattr(frames, name).astype(column_type).tobytes()

    def frames(self) -> Frames:
        """Returns all frames that were added, as one table that uses the memory of the collected columns."""
        columns = {}
        for name, column_type in COLUMN_TYPES.items():
            columns[name] = np.frombuffer(self._columns[name], dtype=column_type)
        return Frames(**columns)


def concatenated_frames(tables: Sequence[Frames]) -> Frames:
    """Joins tables of frames to one: each column of the result is the columns of that name, one after the other.

    Args:
        tables: At least one table. The rows keep their order; nothing is sorted by offset.

    Returns:
        A table with as many rows as all tables together.
    """
    joined_columns = {}
    for field in fields(Frames):
        joined_columns[field.name] = np.concatenate(
            [getattr(table, field.name) for table in tables]
        )
    return Frames(**joined_columns)


def find_frames(data: Bytes, crc_extras: CrcExtras, gap: int = 0) -> Frames:
    """Finds every frame in a stream, also of unknown messages and with failed checksums.

    The stream is scanned block by block. A linked frame has a matching checksum, and after it comes the marker of
    another, or the stream ends, which is hardly ever chance; an isolated one has a matching checksum only. In each
    block:

    1. Linked frames are accepted. All bytes up to the end of the last one can then be assigned to a frame or skipped.
    2. Frames whose checksum cannot match, of unknown messages or damaged, are accepted where a chain of them fills the
       space between two linked frames exactly.
    3. Isolated frames are accepted where they fit into the space that is then free.

    Isolated frames after the last linked frame wait for a later block, whose linked frames may rule them out.

    ``tests/ingest/test_framing.py`` compares the frames with those that pymavlink finds, also in damaged streams.

    Args:
        data: Bytes (B,) of the stream.
        crc_extras: CRC_EXTRA by message id, -1 where the dialect has no such message.
        gap: Number of bytes between one frame and the next: 8 for the time stamps of a tlog, 0 for a plain stream.

    Returns:
        The frames in stream order; they do not overlap.
    """
    size = len(data)
    # All bytes before this offset are assigned to a frame or skipped.
    assigned_end = 0
    found_frames = _FrameColumns()
    # Isolated frames of earlier blocks that begin after the assigned bytes.
    waiting_isolated: list[Frames] = []
    for block_start in range(0, max(size, 1), SCANNED_BYTES):
        block_end = min(block_start + SCANNED_BYTES, size)
        block = _FrameBlock(data, block_start, block_end, gap, crc_extras)
        linked_frames = _without_overlaps(block.linked_frames(), assigned_end)
        if len(linked_frames) or block_end == size:
            # The bytes up to this offset are assigned now.
            new_end = size if block_end == size else int(linked_frames.end[-1])
            frames_between = _frames_between_linked(
                data, linked_frames, assigned_end, new_end, gap, crc_extras
            )
            accepted_frames = _in_stream_order([linked_frames, frames_between])
            isolated = []
            for frames in waiting_isolated:
                fits = _lies_in_free_space(
                    frames.start, frames.end, accepted_frames, assigned_end, new_end
                )
                isolated.append(frames[fits])
            fits = _lies_in_free_space(
                block.start, block.end, accepted_frames, assigned_end, new_end
            )
            isolated.append(block.isolated_frames(fits))
            accepted_isolated = _without_overlaps(_in_stream_order(isolated), assigned_end)
            found_frames.add(_in_stream_order([accepted_frames, accepted_isolated]))
            assigned_end = new_end
            waiting_isolated = []
        waiting_isolated.append(block.isolated_frames(block.start >= assigned_end))
        if block_end % RESIDENT_BYTES == 0:
            release_pages(data)
    return found_frames.frames()


class _FrameBlock:
    """The possible frames in one block of a stream: those that begin with a marker and known incompatibility flags.

    Attributes:
        start: Offset (N,) in the stream of each candidate's marker.
        end: Offset (N,) after the frame that its header announces; it may lie beyond the stream.
    """

    def __init__(
        self, data: Bytes, block_start: int, block_end: int, gap: int, crc_extras: CrcExtras
    ) -> None:
        """Finds the possible frames of a block, and which of them are linked: a marker is where the next should begin.

        A block is copied with some bytes after it, so that its last possible frame, and the marker after that, can be
        read without regard to the end of the block or of the stream.

        Args:
            data: The whole stream (B,).
            block_start: Offset of the block's first byte.
            block_end: Offset after the block's last byte.
            gap: Number of bytes between one frame and the next.
            crc_extras: CRC_EXTRA by message id, -1 for none.
        """
        self._block_start = block_start
        self._size = len(data)
        self._crc_extras = crc_extras
        # The block, the bytes of a frame that begins at its end, and the next frame's marker; zeros after the stream.
        self._bytes = np.zeros(block_end - block_start + MAX_FRAME_BYTES + gap + 2, dtype=np.uint8)
        available = data[block_start : block_start + len(self._bytes)]
        self._bytes[: len(available)] = available
        block = self._bytes[: block_end - block_start]
        markers = np.flatnonzero((block == MARKER_V1) | (block == MARKER_V2))
        headers = rows_of(self._bytes, markers, HEADER_BYTES_V2)
        is_version_1 = headers[:, 0] == MARKER_V1
        has_known_flags = is_version_1 | (headers[:, INCOMPATIBILITY_BYTE] <= SIGNED_FLAG)
        self._headers = headers[has_known_flags]
        self.start = markers[has_known_flags] + block_start
        self.end = self.start + _frame_lengths(self._headers)
        next_start = self.end + gap
        next_byte = self._bytes[next_start - block_start]
        next_is_marker = (next_byte == MARKER_V1) | (next_byte == MARKER_V2)
        is_last_of_stream = next_start >= self._size
        self._is_linked = is_last_of_stream | next_is_marker
        self._checksums = BlockChecksums(self._bytes)

    def linked_frames(self) -> Frames:
        """Returns candidates whose checksum matches, and after which another begins, or the bytes end before one."""
        return self._matching_frames(self._is_linked)

    def isolated_frames(self, selection: Flags) -> Frames:
        """Returns the other candidates whose checksum matches, of a selection (N,).

        The linked ones are left out: each was accepted, or begins inside one that was.
        """
        return self._matching_frames(selection & ~self._is_linked)

    def _matching_frames(self, selection: Flags) -> Frames:
        """Selects the candidates that lie in the stream and whose checksum matches.

        The checksum of each is computed over header and payload, and then over CRC_EXTRA, and compared with the two
        bytes after the payload, the lower one first.

        Args:
            selection: (N,) whether a candidate is tried.

        Returns:
            The M ≤ N frames.
        """
        # Candidates of unknown messages are dropped first: without CRC_EXTRA their checksum cannot be computed.
        rows = np.flatnonzero(selection & (self.end <= self._size))
        frames = _frames_of_headers(self.start[rows], self._headers[rows])
        crc_extras = self._crc_extras.take(frames.message_id, mode="clip")
        is_known = crc_extras >= 0
        if not is_known.all():
            frames = frames[is_known]
            crc_extras = crc_extras[is_known]
            rows = rows[is_known]
        # From here on offsets count from the start of the block.
        start = frames.start - self._block_start
        checksum_start = start + _bytes_before_checksum(self._headers[rows])
        low_byte = self._bytes[checksum_start]
        high_byte = self._bytes[checksum_start + 1].astype(np.uint16)
        sent_checksum = low_byte | high_byte << 8
        # The checksum covers header and payload, but not the marker, which is one byte.
        checksum_without_extra = self._checksums.checksums(start + 1, checksum_start)
        is_matching = sent_checksum == registers_after(checksum_without_extra, crc_extras)
        return frames if is_matching.all() else frames[is_matching]


def _bytes_before_checksum(headers: Bytes) -> Offsets:
    """Returns the number of bytes (N,) of header and payload, from headers (N, ``HEADER_BYTES_V2``)."""
    header_bytes = np.where(headers[:, 0] == MARKER_V2, HEADER_BYTES_V2, HEADER_BYTES_V1)
    return np.add(header_bytes, headers[:, LENGTH_BYTE], dtype=np.int64)


def _frame_lengths(headers: Bytes) -> Offsets:
    """Computes the lengths of frames from their headers.

    Args:
        headers: First bytes (N, ``HEADER_BYTES_V2``) of each frame; in MAVLink 1 the last ones belong to the payload.

    Returns:
        Number of bytes (N,) of each frame, from the marker to the checksum or, in MAVLink 2, to the signature.
    """
    is_version_2 = headers[:, 0] == MARKER_V2
    is_signed = is_version_2 & (headers[:, INCOMPATIBILITY_BYTE] == SIGNED_FLAG)
    bytes_after_payload = np.where(is_signed, CHECKSUM_BYTES + SIGNATURE_BYTES, CHECKSUM_BYTES)
    return _bytes_before_checksum(headers) + bytes_after_payload


def frames_at(data: Bytes, start: Offsets) -> Frames:
    """Reads frames whose beginnings are known.

    Args:
        data: Bytes (B,) of the stream.
        start: Offset (N,) of each frame's marker.

    Returns:
        The frames, all with the checksum ``CHECKSUM_MATCHES``, which is not computed.
    """
    # A header of MAVLink 1 at the very end is shorter; the bytes that are read instead are no part of it.
    headers = data.take(start[:, None] + np.arange(HEADER_BYTES_V2), mode="clip")
    return _frames_of_headers(start, headers)


def _frames_of_headers(start: Offsets, headers: Bytes) -> Frames:
    """Reads the fields of headers: in the layout of MAVLink 1 or 2, by the marker with which each header begins.

    Args:
        start: Offset (N,) of each frame's marker.
        headers: First bytes (N, ``HEADER_BYTES_V2``) of each frame. A header of MAVLink 1 is shorter; there the last
            bytes belong to the payload.

    Returns:
        The frames, all with the checksum ``CHECKSUM_MATCHES``, which is not computed.
    """
    # First all headers are read as headers of MAVLink 2, whose message id has three bytes, the lowest first. With a
    # fourth byte, 0, these are a 32-bit number.
    id_bytes = np.zeros((len(headers), np.int32().itemsize), dtype=np.uint8)
    id_bytes[:, :MESSAGE_ID_BYTES_V2] = headers[:, MESSAGE_ID_BYTE_V2:]
    message_id = id_bytes.view("<i4")[:, 0]
    sequence, system, component = headers[:, SENDER_BYTES_V2].T
    # Then the fields of MAVLink 1 are put in their place.
    version_1_rows = np.flatnonzero(headers[:, 0] == MARKER_V1)
    if len(version_1_rows):
        sender = headers[:, SENDER_BYTES_V2].copy()
        sender[version_1_rows] = headers[version_1_rows, SENDER_BYTES_V1]
        sequence, system, component = sender.T
        message_id[version_1_rows] = headers[version_1_rows, MESSAGE_ID_BYTE_V1]
    return Frames(
        start=start,
        size=_frame_lengths(headers),
        message_id=message_id,
        sequence=sequence,
        system=system,
        component=component,
        checksum=np.full(len(start), CHECKSUM_MATCHES, dtype=np.uint8),
    )


def _without_overlaps(frames: Frames, first_offset: int) -> Frames:
    """Leaves out frames that begin before an offset or inside an earlier frame.

    Of frames that overlap, the one that begins first is kept.

    Args:
        frames: Frames in the order of the stream, with their offsets and lengths.
        first_offset: Offset before which no frame may begin.

    Returns:
        The kept frames, in stream order.
    """
    if len(frames) and frames.start[0] < first_offset:
        frames = frames[frames.start >= first_offset]
    has_overlap = (frames.start[1:] < frames.end[:-1]).any()
    if not has_overlap:
        return frames
    is_kept = np.zeros(len(frames), dtype=np.bool_)
    end_of_kept = first_offset
    bounds = zip(frames.start.tolist(), frames.end.tolist(), strict=True)
    for row, (start, end) in enumerate(bounds):
        if start >= end_of_kept:
            is_kept[row] = True
            end_of_kept = end
    return frames[is_kept]


def _frames_between_linked(
    data: Bytes, linked: Frames, space_start: int, space_end: int, gap: int, crc_extras: CrcExtras
) -> Frames:
    """Finds frames without a matching checksum in the spaces before, between and after linked frames.

    A linked frame has a matching checksum, and the marker of a frame after it. The frames in the spaces are of unknown
    messages, or damaged. A single marker byte would prove nothing, but a chain of headers whose lengths lead exactly to
    the next linked frame is hardly ever chance. So a space has frames only if such a chain fills it.

    Args:
        data: Bytes (B,) of the stream.
        linked: The L linked frames, in stream order.
        space_start: Offset at which the first space begins.
        space_end: Offset at which the last one ends: the end of the last linked frame, or of the stream.
        gap: Number of bytes between one frame and the next: 8 for the time stamps of a telemetry log, otherwise 0.
        crc_extras: CRC_EXTRA by message id, -1 for none.

    Returns:
        The frames, in stream order, with the checksum ``MESSAGE_UNKNOWN`` or ``CHECKSUM_FAILED``.
    """
    # The first frame of each of the L + 1 spaces would begin here.
    first_starts = np.concatenate([[space_start], linked.end]) + gap
    # A chain must lead to the next linked frame. In the last space it must lead to the end of the stream; if the stream
    # goes on, that space is left to the next block, and the offset 0 makes it empty.
    is_end_of_stream = space_end == len(data)
    next_starts = np.append(linked.start, len(data) + gap if is_end_of_stream else 0)
    # NumPy's view of the memory: slicing it is cheaper than slicing the array.
    content = data.data
    frame_starts = array("q")
    for space in np.flatnonzero(next_starts > first_starts).tolist():
        chain = _starts_of_chain(content, int(first_starts[space]), int(next_starts[space]), gap)
        frame_starts.extend(chain)
    frames = frames_at(data, np.frombuffer(frame_starts, dtype=np.int64))
    is_unknown = crc_extras.take(frames.message_id, mode="clip") < 0
    frames.checksum[:] = np.where(is_unknown, MESSAGE_UNKNOWN, CHECKSUM_FAILED)
    return frames[frames.end <= len(data)]


def _starts_of_chain(
    content: memoryview, first_start: int, next_start: int, gap: int
) -> Sequence[int]:
    """Follows frames by the lengths in their headers, each to the next, up to a frame that is known to be one.

    If the lengths lead exactly to the known frame, the frames on the way are real; otherwise the bytes only looked like
    headers. If no known frame follows in the stream, the lengths must lead to the stream's end, which may cut off the
    last frame.

    Args:
        content: Bytes of the stream.
        first_start: Offset of the first frame.
        next_start: Offset of the known frame; an offset beyond the stream if none follows.
        gap: Number of bytes between one frame and the next.

    Returns:
        The offset of each frame on the way; none if the lengths lead elsewhere.
    """
    starts = array("q")
    size = len(content)
    offset = first_start
    while offset < next_start and offset + LENGTH_FIELDS_BYTES <= size:
        length = frame_length(*content[offset : offset + LENGTH_FIELDS_BYTES])
        if length is None:
            break
        starts.append(offset)
        offset += length + gap
    has_reached_known_frame = offset == next_start
    has_reached_end = next_start > size and offset + LENGTH_FIELDS_BYTES > size
    if has_reached_known_frame or has_reached_end:
        return starts
    return array("q")


def frame_length(marker: int, payload_length: int, flags: int) -> int | None:
    """Returns the number of bytes of a frame from the first three bytes of its header.

    Args:
        marker: First byte of the header: the marker of MAVLink 1 or 2.
        payload_length: Second byte of the header: the number of bytes of the payload.
        flags: Third byte: the incompatibility flags of MAVLink 2, without meaning in MAVLink 1.

    Returns:
        The number; None if no header begins so.
    """
    if marker == MARKER_V1:
        return HEADER_BYTES_V1 + payload_length + CHECKSUM_BYTES
    if marker == MARKER_V2 and flags <= SIGNED_FLAG:
        signature_bytes = SIGNATURE_BYTES if flags == SIGNED_FLAG else 0
        return HEADER_BYTES_V2 + payload_length + CHECKSUM_BYTES + signature_bytes
    return None


def _lies_in_free_space(
    start: Offsets, end: Offsets, accepted_frames: Frames, first_offset: int, end_offset: int
) -> Flags:
    """Flags the frames that lie between accepted frames without an overlap.

    The A accepted frames leave A + 1 spaces free: before the first, between each two, and after the last. For each
    frame the space in which it begins is looked up; the frame fits if it also ends within that space.

    Args:
        start: Offset (N,) of each frame's marker.
        end: Offset (N,) after each frame.
        accepted_frames: The A accepted frames in stream order.
        first_offset: Offset at which the first space begins.
        end_offset: Offset at which the last space ends.

    Returns:
        Flags (N,).
    """
    # The number of accepted frames that begin before a frame is the index of the space after the last of them.
    space_index = np.searchsorted(accepted_frames.start, start, side="right")
    space_start = np.concatenate([[first_offset], accepted_frames.end])[space_index]
    space_end = np.append(accepted_frames.start, end_offset)[space_index]
    return (start >= space_start) & (end <= space_end)


def _in_stream_order(tables: list[Frames]) -> Frames:
    """Joins tables of frames into one, in the order of the stream.

    Args:
        tables: At least one table, in any order; the positions in the stream may interleave.

    Returns:
        The table of all frames, sorted by their first byte. A single table with frames is returned as it is.
    """
    filled_tables = [table for table in tables if len(table)]
    if not filled_tables:
        return tables[0]
    if len(filled_tables) == 1:
        # It is in order already, and need not be copied.
        return filled_tables[0]
    frames = concatenated_frames(filled_tables)
    order = np.argsort(frames.start, kind="stable")
    return frames[order]
