"""Extraction of byte strings of equal length from a log, such as headers, time stamps and the values of one message.

A large log is mapped into memory instead of being read. Whatever is looked at of it becomes resident, so that the pages
are released after every ``RESIDENT_BYTES``.
"""

import mmap
import sys

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
"""Bytes of a stream or a file, or one-byte fields of its messages."""

Offsets = NDArray[np.integer]
"""Byte offsets in a stream or a file, or other integers per message."""


RESIDENT_BYTES = 1 << 24
"""Number of bytes of a mapped file that are looked at before its pages are released: a choice."""


def rows_of(data: Bytes, start: Offsets, width: int) -> Bytes:
    """Cuts pieces of equal length out of a stream, such as the headers that begin at each marker.

    The pieces may overlap. A mapped file is read block by block, and its pages are released after each block, to bound
    the resident memory.

    Args:
        data: Bytes (B,) of the stream.
        start: Offset (N,) of each piece; all of its bytes must lie in the stream.
        width: Number of bytes of a piece.

    Returns:
        The pieces as a table (N, width).
    """
    # The stream is viewed as items of ``width`` bytes, one of which begins at each byte (a stride of 1), so that the
    # piece at an offset is the item of that number. NumPy's type "V8" is an opaque item of 8 bytes, which is copied
    # faster by index than single bytes.
    windows = np.ndarray((max(len(data) - width + 1, 0),), f"V{width}", data, strides=(1,))
    is_in_memory = mapping_of(data) is None
    if is_in_memory:
        return windows[start].view(np.uint8).reshape(len(start), width)
    pieces = np.empty(len(start), windows.dtype)
    # The number of pieces that lie in ``RESIDENT_BYTES`` of the file on average.
    pieces_at_once = max(len(start) * RESIDENT_BYTES // len(data), 1)
    for block_start in range(0, len(start), pieces_at_once):
        block = slice(block_start, block_start + pieces_at_once)
        pieces[block] = windows[start[block]]
        release_pages(data)
    return pieces.view(np.uint8).reshape(len(start), width)


def bytes_at(data: Bytes, start: Offsets) -> Bytes:
    """Returns the byte at each offset (N,) of a stream (B,), as ``rows_of`` does."""
    return rows_of(data, start, 1)[:, 0]


def mapping_of(data: Bytes) -> mmap.mmap | None:
    """Returns the mapping of the file whose bytes an array shows; None for an array in memory."""
    view = data.base
    if isinstance(view, memoryview) and isinstance(view.obj, mmap.mmap):
        return view.obj
    return None


def release_pages(data: Bytes) -> None:
    """Releases the memory of a mapped file's pages, which are loaded again when read; other data is not affected."""
    mapping = mapping_of(data)
    if sys.platform != "win32" and mapping is not None and hasattr(mmap, "MADV_DONTNEED"):
        mapping.madvise(mmap.MADV_DONTNEED)
