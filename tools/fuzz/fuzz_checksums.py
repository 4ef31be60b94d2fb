"""Correct checksums for the frames of a damaged telemetry log, without which hardly any damage would be read."""

from mavdem.ingest.mavlink.checksums import frame_checksum
from mavdem.ingest.mavlink.dialect import definitions_by_id
from mavdem.ingest.mavlink.framing import (
    CHECKSUM_BYTES,
    HEADER_BYTES_V1,
    HEADER_BYTES_V2,
    MARKER_V2,
    frame_length,
)


def with_checksums(stream: bytearray) -> bytes:
    """A telemetry log whose frames all have correct checksums."""
    at = 8
    while at + 8 <= len(stream):
        length = frame_length(*stream[at : at + 3])
        if length is None:
            at += 1
            continue
        if at + length > len(stream):
            break
        frame = bytes(stream[at : at + length])
        payload = (HEADER_BYTES_V2 if frame[0] == MARKER_V2 else HEADER_BYTES_V1) + frame[1]
        number = int.from_bytes(frame[7:10], "little") if frame[0] == MARKER_V2 else frame[5]
        if number in definitions_by_id():
            checksum = frame_checksum(frame[1:payload], definitions_by_id()[number].crc_extra)
            stream[at + payload : at + payload + CHECKSUM_BYTES] = checksum.to_bytes(
                CHECKSUM_BYTES, "little"
            )
        at += length + 8
    return bytes(stream)
