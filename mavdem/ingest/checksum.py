"""The X.25 checksum of MAVLink, of many frames at once.

Source: https://mavlink.io/en/guide/serialization.html#checksum (CRC-16/MCRF4XX, register reflected, poly 0x8408,
beginning with 0xFFFF, over the bytes behind the marker and then CRC_EXTRA).
"""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Iterator
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Registers = NDArray[np.uint16]

TIERS = (0, 8, 16, 32, 64, 140)
"""Words of two bytes: frames between two of these lengths are laid side by side in one table."""
FLOOD = 4
"""Times the bytes at hand that frames may cover, overlapping, before their common stretches are computed once."""
LONGEST = 2 * TIERS[-1]


def checksums(data: Bytes, start: NDArray[np.int64], count: NDArray[np.int64], seed: NDArray[np.int32]) -> Registers:
    """Checksums (N,) of ``count`` bytes from ``start`` on and the byte ``seed`` behind them, each of shape (N,).

    ``data`` must go on for ``LONGEST`` bytes behind the last ``start``; no ``count`` may be above that.
    """
    flood = int(count.sum()) > FLOOD * len(data)
    register = _by_doubling(data, start, count) if flood else _by_words(data, start, count)
    return _after_byte(register, seed.astype(np.uint16))


def checksum(content: bytes, seed: int) -> int:
    """The checksum of one frame's ``content`` and the byte ``seed`` behind it.

    The standard library has the same polynomial in C with the bits the other way round.
    """
    register = crc_hqx((content + bytes((seed,))).translate(_MIRRORED), 0xFFFF)
    return _MIRRORED[register >> 8] | _MIRRORED[register & 0xFF] << 8


def rows_of(data: Bytes, start: NDArray[np.int64], width: int) -> Bytes:
    """The ``width`` bytes from each ``start`` (N,) on, as a table (N, width)."""
    everywhere = np.ndarray((max(len(data) - width + 1, 0),), f"V{width}", data, strides=(1,))
    return everywhere[start].view(np.uint8).reshape(len(start), width)


def _by_words(data: Bytes, start: NDArray[np.int64], count: NDArray[np.int64]) -> Registers:
    """Registers after ``count`` bytes, two bytes a step, all frames that are long enough in one go."""
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
    """The same in a time that hardly depends on how often the frames overlap.

    The register is linear: what a stretch of bytes does to it is what as many zeros do, XOR what the bytes do to a
    register of zero. The latter is made for stretches of 1, 2, 4, … bytes from every place on.
    """
    register = np.full(len(start), 0xFFFF, dtype=np.uint16)
    place, stretch = start.copy(), _WORD[:: 1 << 8].take(data)
    longest = int(count.max(initial=0))
    for power, over_zeros in enumerate(_over_zeros()):
        if 1 << power > longest:
            break
        rows = np.flatnonzero(count >> power & 1)
        register[rows] = over_zeros.take(register[rows]) ^ stretch.take(place[rows])
        place[rows] += 1 << power
        stretch = over_zeros.take(stretch[: -(1 << power)]) ^ stretch[1 << power :]
    return register


def _after_byte(register: Registers, byte: NDArray[np.uint8] | Registers) -> Registers:
    return np.asarray(register >> 8 ^ _WORD[:: 1 << 8].take((register ^ byte) & 0xFF), dtype=np.uint16)


@cache
def _over_zeros() -> tuple[Registers, ...]:
    """What 1, 2, 4, … zero bytes make of each register, up to ``LONGEST`` bytes."""
    return tuple(_doublings())


def _doublings() -> Iterator[Registers]:
    table = _after_byte(np.arange(1 << 16, dtype=np.uint16), np.zeros(1 << 16, dtype=np.uint8))
    for _ in range(LONGEST.bit_length()):
        yield table
        table = table.take(table)


def _word_table() -> Registers:
    """What two more bytes do to the register: indexed by register XOR the bytes as a little-endian word."""
    register = np.arange(1 << 16, dtype=np.uint16)
    for _ in range(16):
        register = np.where(register & 1, register >> 1 ^ 0x8408, register >> 1).astype(np.uint16)
    return register


_WORD = _word_table()
_MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
"""Each byte with its bits the other way round."""
