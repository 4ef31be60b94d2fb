"""Checksums of MAVLink frames: of a single one, or of all frames in a block of a stream at once.

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
        crc_extra: CRC_EXTRA of its message.
    """
    return mcrf4xx(content + bytes((crc_extra,)))


BYTE_TABLE: Registers = np.array([mcrf4xx(bytes((byte,)), 0) for byte in range(256)], np.uint16)
"""The register (256,) after each single byte, starting with 0."""


def registers_after(registers: Registers, following_bytes: Offsets | Bytes | np.uint8) -> Registers:
    """Returns the registers (N,) after one more byte of each (N,), by the table-driven CRC."""
    return registers >> 8 ^ BYTE_TABLE[(registers ^ following_bytes) & 0xFF]


class _Tables(NamedTuple):
    """What the register becomes, for all of its contents or all values of one of its bytes."""

    words: Registers
    """Register (65536,) after two more bytes, by the XOR of the register before with these bytes."""
    low_byte_shifts: Registers
    """What a low byte of the register becomes after n zero bytes, by 256 n + byte, up to n = ``ROW_BYTES``."""
    high_byte_shifts: Registers
    """The same of a high byte."""


@cache
def _tables() -> _Tables:
    """Computes the lookup tables of this module when a block is read for the first time.

    Registers after n + 1 zero bytes are computed from those after n, by one more step of the CRC.

    Returns:
        The tables, which are cached.
    """
    zero = np.uint8(0)
    all_registers = np.arange(1 << 16).astype(np.uint16)
    words = registers_after(registers_after(all_registers, zero), zero)
    low_bytes = np.arange(BYTE_VALUES, dtype=np.uint16)
    registers = np.concatenate([low_bytes, low_bytes << 8])
    shifts = []
    # Row n has the registers after n zero bytes: of all values of the low byte, then of all values of the high byte.
    for _ in range(ROW_BYTES + 1):
        shifts.append(registers)
        registers = registers_after(registers, zero)
    shifts_of_low_bytes, shifts_of_high_bytes = np.split(np.array(shifts), 2, axis=1)
    return _Tables(words, shifts_of_low_bytes.ravel(), shifts_of_high_bytes.ravel())


def shifted(registers: Registers, zero_bytes: Offsets) -> Registers:
    """Returns the contents of the checksum's register after a number of zero bytes.

    Since the CRC is linear, the contributions of the low and of the high byte of the register are looked up separately
    and combined by XOR.

    Args:
        registers: Contents (N,) of the register, 16 bits.
        zero_bytes: Number (N,) of zero bytes that follow, at most ``ROW_BYTES``.

    Returns:
        Contents (N,) of the register.
    """
    tables = _tables()
    # The tables are flat, with ``BYTE_VALUES`` entries for each number of zero bytes: one index is faster than two.
    first_of_row = zero_bytes * BYTE_VALUES
    low_bytes = tables.low_byte_shifts.take(first_of_row + (registers & 0xFF))
    return low_bytes ^ tables.high_byte_shifts.take(first_of_row + (registers >> 8))


class BlockChecksums:
    """Computes checksums of pieces of a block of bytes, however many there are, from one pass over the block.

    The block is cut into rows of ``ROW_BYTES``. Step by step, the next two bytes of all rows are taken in at once, and
    the registers are kept. Every row starts with a register of 0.
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
        # The registers are indexed by the number of words that were taken in, then by row.
        self._registers = np.zeros((words.shape[1] + 1, row_count), dtype=np.uint16)
        registers = self._registers[0]
        table = _tables().words
        words_of_steps = np.ascontiguousarray(words.T)
        for step_words, step_registers in zip(words_of_steps, self._registers[1:], strict=True):
            registers = table.take(registers ^ step_words)
            step_registers[:] = registers

    def checksums(self, first: Offsets, end: Offsets) -> Registers:
        """Returns the checksums (N,) of pieces of the block.

        ``tests/ingest/test_checksums.py`` compares them with pymavlink's.

        Args:
            first: Offset of the first byte of each piece (N,).
            end: Offset after its last byte (N,), at most ``ROW_BYTES`` later.

        Returns:
            CRC-16/MCRF4XX of each piece (N,), 16 bits.
        """
        # The kept registers were computed from the beginning of the row, not of the piece. The CRC is linear: if two
        # registers differ, they differ after the same bytes by this difference, shifted by as many zero bytes. So the
        # difference at the beginning of the piece is shifted to its end and removed there.
        difference = self._registers_at(first) ^ np.uint16(START_OF_REGISTER)
        checksums = self._registers_at(end) ^ shifted(difference, end - first)
        # A piece may end in the next row, which started with 0 instead of the last register of the row before. This
        # difference is removed in the same way.
        first_rows = first // ROW_BYTES
        in_two_rows = np.flatnonzero(end // ROW_BYTES > first_rows)
        last_registers = self._registers[-1, first_rows[in_two_rows]]
        bytes_in_next_row = end[in_two_rows] % ROW_BYTES
        checksums[in_two_rows] ^= shifted(last_registers, bytes_in_next_row)
        return checksums

    def _registers_at(self, offsets: Offsets) -> Registers:
        """Looks up the registers before the bytes at some offsets, computed from the beginning of their rows.

        Registers are kept after each word of two bytes; at an odd offset one more byte is taken in.

        Args:
            offsets: Offsets (N,) of bytes in the block.

        Returns:
            Registers (N,).
        """
        rows = offsets // ROW_BYTES
        row_offsets = offsets - rows * ROW_BYTES
        words = row_offsets // WORD_BYTES
        # The element [words, rows], by a flat index: ``take`` is faster than indexing by two arrays.
        registers = self._registers.take(words * self._registers.shape[1] + rows)
        is_odd = np.flatnonzero(row_offsets % WORD_BYTES)
        last_bytes = self._bytes[offsets[is_odd] - 1]
        registers[is_odd] = registers_after(registers[is_odd], last_bytes)
        return registers
