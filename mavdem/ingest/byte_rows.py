"""Pieces of equal length out of the bytes of a log, such as headers, time stamps and the values of one message."""

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
"""Bytes of a stream or a file, or one-byte fields of its messages."""

Offsets = NDArray[np.int64]
"""Byte offsets in a stream or a file, or other integers per message."""


def rows_of(data: Bytes, start: Offsets, width: int) -> Bytes:
    """Cuts pieces of equal length out of a stream, such as the headers that begin at each marker.

    The pieces may overlap. The stream is viewed as a sequence of items of ``width`` bytes, one of which begins at each
    byte (a stride of 1), so that the pieces are just the items with the numbers ``start``.

    Args:
        data: The stream (B,).
        start: Offset (N,) of each piece; all of its bytes must lie in the stream.
        width: Number of bytes of a piece.

    Returns:
        The pieces as a table (N, width).
    """
    # The type "V8" is an item of 8 bytes without meaning; NumPy copies such items faster than single bytes by index.
    windows = np.ndarray((max(len(data) - width + 1, 0),), f"V{width}", data, strides=(1,))
    return windows[start].view(np.uint8).reshape(len(start), width)
