"""Checksums of all frames in a block at once."""

import numpy as np
import pytest
from pymavlink.generator.mavcrc import x25crc

from mavdem.ingest.mavlink.checksums import ROW_BYTES, BlockChecksums, frame_checksum

LONGEST_PIECE = 280
"""Number of bytes of the longest frame."""


@pytest.mark.parametrize("size", [1, ROW_BYTES - 1, ROW_BYTES, 20 * ROW_BYTES + 17])
def test_checksums_of_pieces_are_those_of_pymavlink(size):
    """The checksums of 500 random pieces of a block of bytes are computed at once."""
    generator = np.random.default_rng(3)
    block = generator.integers(0, 256, size).astype(np.uint8)
    first = generator.integers(0, size, 500)
    end = np.minimum(first + generator.integers(0, LONGEST_PIECE + 1, 500), size)
    checksums = BlockChecksums(block).checksums(first, end)
    for checksum, start, stop in zip(checksums, first, end, strict=True):
        assert checksum == x25crc(block[start:stop].tolist()).crc


def test_a_piece_may_end_with_the_block():
    block = np.arange(2 * ROW_BYTES, dtype=np.uint8)
    first = np.array([ROW_BYTES + 8])
    checksum = BlockChecksums(block).checksums(first, np.array([2 * ROW_BYTES]))
    assert checksum[0] == x25crc(block[ROW_BYTES + 8 :].tolist()).crc


def test_the_checksum_of_a_frame_ends_with_crc_extra():
    assert frame_checksum(b"\x09\x00\x00", 50) == x25crc([9, 0, 0, 50]).crc
