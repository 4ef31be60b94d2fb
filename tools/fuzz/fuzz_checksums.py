"""Correct checksums for the frames of a damaged telemetry log, without which hardly any damage would be read."""

from mavdem.ingest.mavlink.checksums import frame_checksum
from mavdem.ingest.mavlink.dialect import definitions_by_id
from mavdem.ingest.mavlink.frame_reader import parse_frame
from mavdem.ingest.mavlink.framing import (
    CHECKSUM_BYTES,
    HEADER_BYTES_V1,
    HEADER_BYTES_V2,
    MARKER_V2,
    frame_length,
)
from mavdem.ingest.tlog import STAMP_BYTES

SHORTEST_FRAME = HEADER_BYTES_V1 + CHECKSUM_BYTES
"""Bytes of a frame of version 1 without a payload."""

BYTES_THAT_TELL_LENGTH = 3
"""Marker, payload's length and flags, from which ``frame_length`` computes the length of a frame."""


def with_checksums(stream: bytearray) -> bytes:
    """Writes the correct checksum into each frame of a telemetry log.

    Args:
        stream: Bytes of the log, with a receive stamp before each frame. They are changed in place.

    Returns:
        The changed bytes. Frames of unknown messages keep their checksums, since these depend on the definition.
    """
    start = STAMP_BYTES
    while start + SHORTEST_FRAME <= len(stream):
        length = frame_length(*stream[start : start + BYTES_THAT_TELL_LENGTH])
        if length is None:
            start += 1
            continue
        if start + length > len(stream):
            break
        frame_bytes = bytes(stream[start : start + length])
        frame = parse_frame(frame_bytes)
        definition = definitions_by_id().get(frame.message_id)
        if definition is not None:
            is_version_2 = frame_bytes[0] == MARKER_V2
            payload_start = HEADER_BYTES_V2 if is_version_2 else HEADER_BYTES_V1
            payload_end = payload_start + len(frame.payload)
            # The checksum follows the payload. It covers the bytes before it but the marker, the first of them.
            checksum = frame_checksum(frame_bytes[1:payload_end], definition.crc_extra)
            checksum_start = start + payload_end
            stream[checksum_start : checksum_start + CHECKSUM_BYTES] = checksum.to_bytes(
                CHECKSUM_BYTES, "little"
            )
        # The stamp of the next frame follows.
        start += length + STAMP_BYTES
    return bytes(stream)
