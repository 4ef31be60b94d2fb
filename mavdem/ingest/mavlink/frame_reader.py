"""Finding and parsing MAVLink frames in the bytes of a link as these arrive.

A frame counts as it does in a file: with a matching checksum, or, of another dialect or damaged, where such frames
exactly fill the bytes between two frames with matching checksums.

Source: https://mavlink.io/en/guide/serialization.html
"""

from typing import NamedTuple

from mavdem.ingest.mavlink import framing
from mavdem.ingest.mavlink.checksums import frame_checksum
from mavdem.ingest.mavlink.dialect import definitions_by_id

MAX_UNDECIDED_BYTES = 32 * framing.MAX_FRAME_BYTES
"""Bytes without a matching checksum that wait for one; a choice that bounds the memory for hostile input."""

SEQUENCE_OFFSET_V1 = 2
"""Offset in a MAVLink 1 frame of its sequence number, after the marker and the length of the payload, bytes."""

SEQUENCE_OFFSET_V2 = 4
"""Offset in a MAVLink 2 frame of its sequence number, after marker, length and two bytes of flags, bytes."""


class Frame(NamedTuple):
    """One frame of a stream, as its header announces it."""

    message_id: int
    """Number of the message's definition."""

    system: int
    """MAVLink system id of the sender."""

    component: int
    """MAVLink component id of the sender."""

    sequence: int
    """Sequence number of the sender, 0 to 255, which wraps."""

    checksum: int
    """``CHECKSUM_MATCHES``, ``MESSAGE_UNKNOWN`` or ``CHECKSUM_FAILED`` of ``mavdem.ingest.mavlink.framing``."""

    payload: bytes
    """The payload as sent: MAVLink 2 leaves out zeros at its end."""

    content: bytes
    """All bytes of the frame."""


class FrameReader:
    """Finds the MAVLink frames of one stream, whose bytes arrive piece by piece.

    Attributes:
        undecoded_frames: number of frames so far that are damaged or of another dialect.
    """

    def __init__(self) -> None:
        self.undecoded_frames = 0
        self._pending = b""
        # Bytes at the beginning of the pending ones in which no frame with a matching checksum begins.
        self._searched = 0

    def feed(self, piece: bytes) -> list[Frame]:
        """Returns the frames that the next bytes of the stream complete, in their order.

        A frame begins with a marker byte, but the same byte may occur inside a payload. So the search tries each offset
        in turn: if the frame that the header there announces has a matching checksum, it is accepted, and the search
        continues after it. Then the bytes between it and the accepted frame before it are classified: if a chain of
        frames, damaged or of another dialect, fills them exactly, these are returned too; otherwise they are skipped.

        If the announced frame has not arrived completely, the search stops, and the bytes after the last accepted frame
        are kept for the next call. So the accepted frames do not depend on how the stream is cut into pieces.

        Args:
            piece: the next bytes of the stream, of any number.

        Returns:
            The frames. Those without a matching checksum are counted in ``undecoded_frames``, too.
        """
        unclassified_bytes = self._pending + piece
        # All bytes before this offset are classified: they belong to frames that were returned, or to none.
        decided_end = 0
        offset = self._searched
        frames: list[Frame] = []
        while True:
            length = _announced_length(unclassified_bytes, offset)
            # The frame that may begin here has not arrived completely.
            if length > len(unclassified_bytes) - offset:
                break
            frame = parse_frame(unclassified_bytes[offset : offset + length]) if length else None
            if frame is None or frame.checksum != framing.CHECKSUM_MATCHES:
                offset += 1
                continue
            undecoded_frames = _frames_that_fill(unclassified_bytes[decided_end:offset])
            self.undecoded_frames += len(undecoded_frames)
            frames += undecoded_frames
            frames.append(frame)
            offset += length
            decided_end = offset
        # In a stream without any good frame no byte is ever classified: to bound the memory, only the last are kept.
        decided_end = max(decided_end, offset - MAX_UNDECIDED_BYTES)
        self._pending = unclassified_bytes[decided_end:]
        self._searched = offset - decided_end
        return frames


def _announced_length(data: bytes, start: int) -> int:
    """Returns the length of the frame whose header would be at ``start``, as that header announces it.

    The first three bytes of a header are enough for both versions of MAVLink.

    Args:
        data: bytes that were received over the link.
        start: offset of the possible header, bytes.

    Returns:
        Length, bytes; 0 if no header is there. If fewer than three bytes have arrived, the largest possible length, so
        that the caller waits for more.
    """
    header = data[start : start + 3]
    if len(header) < 3:
        return framing.MAX_FRAME_BYTES
    marker, payload_length, flags = header
    return framing.frame_length(marker, payload_length, flags) or 0


def _frames_that_fill(data: bytes) -> list[Frame]:
    """Returns the frames that fill the bytes between two good frames exactly.

    Such frames are damaged or of another dialect, so their checksums prove nothing. The proof is that headers lead from
    one frame to the next, and exactly to the next good one.

    Args:
        data: the bytes between two frames with matching checksums.

    Returns:
        The frames in order; none if the headers do not fill the bytes.
    """
    frames = []
    start = 0
    while start < len(data):
        length = _announced_length(data, start)
        if not 0 < length <= len(data) - start:
            return []
        frames.append(parse_frame(data[start : start + length]))
        start += length
    return frames


def parse_frame(content: bytes) -> Frame:
    """Parses the bytes of one frame, of MAVLink 1 or 2, and checks its checksum.

    After the marker and the length of the payload MAVLink 2 has two bytes of flags. Then both versions have sequence
    number, system id, component id, message id (one byte or three, little endian), payload and checksum. The checksum
    also covers a byte made from the message's definition, so that it can be checked only for known messages.

    Args:
        content: all bytes of the frame, as long as its header announces.

    Returns:
        The frame, with the result of its checksum: matches, failed, or message unknown.
    """
    if content[0] == framing.MARKER_V2:
        sequence_offset = SEQUENCE_OFFSET_V2
        header_length = framing.HEADER_BYTES_V2
    else:
        sequence_offset = SEQUENCE_OFFSET_V1
        header_length = framing.HEADER_BYTES_V1
    sequence = content[sequence_offset]
    system = content[sequence_offset + 1]
    component = content[sequence_offset + 2]
    message_id = int.from_bytes(content[sequence_offset + 3 : header_length], "little")
    payload_length = content[framing.LENGTH_BYTE]
    payload_end = header_length + payload_length
    definition = definitions_by_id().get(message_id)
    checksum = framing.MESSAGE_UNKNOWN
    if definition is not None:
        sent_checksum = int.from_bytes(
            content[payload_end : payload_end + framing.CHECKSUM_BYTES], "little"
        )
        # The marker is not part of what the checksum covers.
        expected_checksum = frame_checksum(content[1:payload_end], definition.crc_extra)
        matches = sent_checksum == expected_checksum
        checksum = framing.CHECKSUM_MATCHES if matches else framing.CHECKSUM_FAILED
    payload = content[header_length:payload_end]
    return Frame(message_id, system, component, sequence, checksum, payload, content)
