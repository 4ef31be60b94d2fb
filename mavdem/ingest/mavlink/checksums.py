"""Checksums of MAVLink frames (CRC-16/MCRF4XX): of a single frame, or of all frames in a block of a stream at once.

MAVLink uses CRC-16/MCRF4XX (X.25): register reflected, polynomial 0x8408, starting with 0xFFFF. A CRC is linear over
GF(2). So the register after some bytes is the XOR of two parts: the register that these bytes alone give, starting with
0, and the register before them, moved on by as many zero bytes. From registers that are known at the beginning and the
end of a frame its checksum follows without a look at the bytes between, however many frames there are.

Sources: https://mavlink.io/en/guide/serialization.html; table-driven CRC as in R. N. Williams, "A painless guide to CRC
error detection algorithms" (1993), chapters 9 and 10.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from fastcrc.crc16 import mcrf4xx
from numpy.typing import NDArray

from mavdem.ingest.byte_rows import Bytes, Offsets

Registers = NDArray[np.uint16]
"""Contents of the register of the CRC."""

START_OF_REGISTER = 0xFFFF
"""Content of the register before the first byte of a frame."""

WORD_BYTES = np.dtype(np.uint16).itemsize
"""Number of bytes of the register, which can take in as many bytes in one step."""

ROW_BYTES = 288
"""Number of bytes of the rows into which a block is cut: even, and more than any frame has (280).

So a frame lies in two rows at most. Shorter rows have fewer steps, each of which takes in two bytes of all rows.
"""


BYTE_VALUES = 1 << 8
"""Number of values of a byte."""


def frame_checksum(content: bytes, crc_extra: int) -> int:
    """Returns the checksum of a frame, a CRC-16 that MAVLink calls X.25.

    Args:
        content: The bytes of the frame after the marker and before the checksum.
        crc_extra: CRC_EXTRA of its message: a byte that MAVLink derives from the definition of the message.
    """
    return mcrf4xx(content + bytes((crc_extra,)))


BYTE_TABLE: Registers = np.array([mcrf4xx(bytes((byte,)), 0) for byte in range(256)], np.uint16)
"""The register (256,) after each single byte, starting with 0."""


def registers_after(registers: Registers, following_bytes: Offsets | Bytes | np.uint8) -> Registers:
    """Returns the registers (N,) after one more byte of each (N,), by the table-driven CRC."""
    return registers >> 8 ^ BYTE_TABLE[(registers ^ following_bytes) & 0xFF]


class _CrcTables(NamedTuple):
    """Precomputed results of the CRC, each looked up by what the register holds before."""

    two_byte_step: Registers
    """Register (65536,) after two more bytes, by the XOR of the register before with these bytes."""
    low_byte_after_zeros: Registers
    """Register after n zero bytes if only its low byte was set, at index 256 n + low byte, up to n = ``ROW_BYTES``."""
    high_byte_after_zeros: Registers
    """Register after n zero bytes if only its high byte was set, at index 256 n + high byte."""


@cache
def _crc_tables() -> _CrcTables:
    """Computes the lookup tables of the CRC, when a block is read for the first time.

    Returns:
        The tables, which are cached.
    """
    zero = np.uint8(0)
    all_registers = np.arange(1 << 16).astype(np.uint16)
    # Two bytes move the register on as two zero bytes move the XOR of the register with these bytes.
    two_byte_step = registers_after(registers_after(all_registers, zero), zero)
    byte_values = np.arange(BYTE_VALUES, dtype=np.uint16)
    # Element n has the registers (256,) after n zero bytes, for each value of the byte that was set.
    low_bytes: list[Registers] = [byte_values]
    high_bytes: list[Registers] = [np.left_shift(byte_values, 8)]
    for _ in range(ROW_BYTES):
        low_bytes.append(registers_after(low_bytes[-1], zero))
        high_bytes.append(registers_after(high_bytes[-1], zero))
    return _CrcTables(two_byte_step, np.concatenate(low_bytes), np.concatenate(high_bytes))


def registers_after_zero_bytes(registers: Registers, zero_counts: Offsets) -> Registers:
    """Returns what the 16-bit registers of a CRC hold after a number of zero bytes.

    A CRC is linear: the result is the XOR of the results for the low byte and for the high byte of the register alone.
    Both are looked up in precomputed tables.

    Args:
        registers: The registers (N,) before the zero bytes.
        zero_counts: Number (N,) of zero bytes for each register, at most ``ROW_BYTES``.

    Returns:
        The registers (N,) after the zero bytes.
    """
    tables = _crc_tables()
    # The tables are flat: the entry of a byte after n zero bytes has the index 256 n + byte.
    first_indices = zero_counts * BYTE_VALUES
    from_low_bytes = tables.low_byte_after_zeros.take(first_indices + (registers & 0xFF))
    from_high_bytes = tables.high_byte_after_zeros.take(first_indices + (registers >> 8))
    return from_low_bytes ^ from_high_bytes


class BlockChecksums:
    """Computes the CRC-16 of many pieces of a block of bytes, from CRC registers that one pass over the block stores.

    The block is cut into rows of ``ROW_BYTES``. Step by step, the next two bytes of all rows are taken in at once, and
    the registers are stored. Every row starts with a register of 0.
    """

    def __init__(self, block: Bytes) -> None:
        """Computes the registers at all even offsets of the block.

        Args:
            block: The bytes (B,).
        """
        row_count = len(block) // ROW_BYTES + 1
        self._bytes = np.zeros(row_count * ROW_BYTES, dtype=np.uint8)
        self._bytes[: len(block)] = block
        words = self._bytes.view("<u2").reshape(row_count, ROW_BYTES // WORD_BYTES)
        # Element [k, r] is the register of row r after its first k words of two bytes.
        self._registers = np.zeros((words.shape[1] + 1, row_count), dtype=np.uint16)
        registers = self._registers[0]
        table = _crc_tables().two_byte_step
        words_of_steps = np.ascontiguousarray(words.T)
        for step_words, step_registers in zip(words_of_steps, self._registers[1:], strict=True):
            registers = table.take(registers ^ step_words)
            step_registers[:] = registers

    def checksums(self, first: Offsets, end: Offsets) -> Registers:
        """Returns the CRC-16 of each of N pieces of the block, from the stored registers at their two ends.

        A stored register started with 0 at the beginning of its row, but a checksum starts with 0xFFFF at the beginning
        of the piece. A CRC is linear (an XOR of its inputs is an XOR of its results): two registers that differ by d
        before a piece differ after it by what d becomes after as many zero bytes. So the difference before the piece is
        moved on by the length of the piece, and removed by XOR.

        ``tests/ingest/test_checksums.py`` compares the results with pymavlink's.

        Args:
            first: Offset (N,) of the first byte of each piece in the block.
            end: Offset (N,) after its last byte, at most ``ROW_BYTES`` later.

        Returns:
            CRC-16/MCRF4XX (N,) of each piece, 16 bits.
        """
        difference_before = self._registers_at(first) ^ np.uint16(START_OF_REGISTER)
        difference_after = registers_after_zero_bytes(difference_before, end - first)
        checksums = self._registers_at(end) ^ difference_after
        # If a piece ends in the next row, the registers there started with 0, and not with the last register of the
        # row before. This difference is removed in the same way.
        rows = first // ROW_BYTES
        ends_in_next_row = np.flatnonzero(end // ROW_BYTES > rows)
        last_registers = self._registers[-1, rows[ends_in_next_row]]
        bytes_in_next_row = end[ends_in_next_row] % ROW_BYTES
        checksums[ends_in_next_row] ^= registers_after_zero_bytes(last_registers, bytes_in_next_row)
        return checksums

    def _registers_at(self, offsets: Offsets) -> Registers:
        """Returns the CRC register before each of N bytes of the block, which started with 0 in the row of that byte.

        The register is stored after every second byte only. Before a byte at an odd offset, the byte between is added
        here.

        Args:
            offsets: Offset (N,) of each byte in the block.

        Returns:
            Registers (N,), 16 bits.
        """
        row = offsets // ROW_BYTES
        offset_in_row = offsets - row * ROW_BYTES
        words_before = offset_in_row // WORD_BYTES
        # The element [words_before, row], by a flat index: ``take`` is faster than indexing by two arrays.
        row_count = self._registers.shape[1]
        registers = self._registers.take(words_before * row_count + row)
        is_odd = np.flatnonzero(offset_in_row % WORD_BYTES)
        bytes_between = self._bytes[offsets[is_odd] - 1]
        registers[is_odd] = registers_after(registers[is_odd], bytes_between)
        return registers
