"""The X.25 checksum of MAVLink, for many frames at once.

Source: https://mavlink.io/en/guide/serialization.html#checksum (CRC-16/MCRF4XX, register reflected, poly 0x8408,
starting with 0xFFFF, over the bytes after the marker and then CRC_EXTRA).
"""

from __future__ import annotations

from binascii import crc_hqx
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Registers = NDArray[np.uint16]

TIERS = (0, 8, 16, 32, 64, 140)  # Words of two bytes; frames between two of these lengths are checked in one table
MAX_CHECKSUM_BYTES = 2 * TIERS[-1]  # Bytes that a checksum may cover


def checksums(data: Bytes, start: NDArray[np.int64], count: NDArray[np.int64], seed: NDArray[np.int32]) -> Registers:
    """Checksums (N,) of ``count`` bytes from ``start`` on and the byte ``seed`` after them, each of shape (N,).

    ``data`` must have ``MAX_CHECKSUM_BYTES`` after the last ``start``; no ``count`` may be above that.
    """
    # Overlapping bytes of many frames are processed only once.
    overlapping = int(count.sum()) > 4 * len(data)
    register = _by_doubling(data, start, count) if overlapping else _by_words(data, start, count)
    return _after_byte(register, seed.astype(np.uint16))


def frame_checksum(content: bytes, seed: int) -> int:
    """The checksum of one frame's ``content`` and the byte ``seed`` after it.

    The standard library has the same polynomial in C with the bits in reverse order.
    """
    register = crc_hqx((content + bytes((seed,))).translate(_MIRRORED), 0xFFFF)
    return _MIRRORED[register >> 8] | _MIRRORED[register & 0xFF] << 8


def rows_of(data: Bytes, start: NDArray[np.int64], width: int) -> Bytes:
    """The ``width`` bytes from each ``start`` (N,) on, as a table (N, width)."""
    everywhere = np.ndarray((max(len(data) - width + 1, 0),), f"V{width}", data, strides=(1,))
    return everywhere[start].view(np.uint8).reshape(len(start), width)


def _by_words(data: Bytes, start: NDArray[np.int64], count: NDArray[np.int64]) -> Registers:
    """Registers after ``count`` bytes; each step takes two bytes of all frames that are long enough."""
    order = np.argsort(count.astype(np.uint16), kind="stable")
    start, count = start[order], count[order]
    words = count // 2
    sorted_registers = np.full(len(start), 0xFFFF, dtype=np.uint16)
    for shortest, longest in pairwise(np.searchsorted(words, TIERS, side="right").tolist()):
        if shortest == longest:
            continue
        tier = slice(shortest, longest)
        most = int(words[longest - 1])
        table = rows_of(data, start[tier], 2 * most).view("<u2")
        register = sorted_registers[tier]
        for step, first in enumerate(np.searchsorted(words[tier], np.arange(most), side="right")):
            register[first:] = _WORD.take(register[first:] ^ table[first:, step], mode="wrap")
    odd = np.flatnonzero(count % 2)
    sorted_registers[odd] = _after_byte(sorted_registers[odd], data[start[odd] + count[odd] - 1])
    registers = np.empty_like(sorted_registers)
    registers[order] = sorted_registers
    return registers


def _by_doubling(data: Bytes, start: NDArray[np.int64], count: NDArray[np.int64]) -> Registers:
    """The same in a time that hardly depends on the overlap of the frames.

    The register is linear: its value after some bytes is its value after as many zeros, XOR that of a zero register
    after the bytes. The latter is computed for 1, 2, 4, … bytes from every place on.
    """
    register = np.full(len(start), 0xFFFF, dtype=np.uint16)
    place, partial = start.copy(), _WORD[:: 1 << 8].take(data)
    longest = int(count.max(initial=0))
    for power, over_zeros in enumerate(_over_zeros()):
        if 1 << power > longest:
            break
        rows = np.flatnonzero(count >> power & 1)
        register[rows] = over_zeros.take(register[rows]) ^ partial.take(place[rows])
        place[rows] += 1 << power
        partial = over_zeros.take(partial[: -(1 << power)]) ^ partial[1 << power :]
    return register


def _after_byte(register: Registers, byte: NDArray[np.uint8] | Registers) -> Registers:
    return np.asarray(register >> 8 ^ _WORD[:: 1 << 8].take((register ^ byte) & 0xFF), dtype=np.uint16)


@cache
def _over_zeros() -> list[Registers]:
    """Each register after 1, 2, 4, … zero bytes, up to ``MAX_CHECKSUM_BYTES``."""
    tables = [_after_byte(np.arange(1 << 16, dtype=np.uint16), np.zeros(1 << 16, dtype=np.uint8))]
    for _ in range(MAX_CHECKSUM_BYTES.bit_length() - 1):
        tables.append(tables[-1].take(tables[-1]))
    return tables


def _word_table() -> Registers:
    """The register after two more bytes, indexed by register XOR the bytes as a little-endian word."""
    register = np.arange(1 << 16, dtype=np.uint16)
    for _ in range(16):
        register = np.where(register & 1, register >> 1 ^ 0x8408, register >> 1).astype(np.uint16)
    return register


_WORD = _word_table()
_MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))  # Each byte with its bits in reverse order
