"""When each frame of a telemetry log was received, by the stamps between the frames, as far as they can be trusted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.checksum import Bytes, rows_of
from mavdem.ingest.framing import Frames
from mavdem.ingest.strays import Places, Times, far_off

STAMP = 8
"""Bytes of the time stamp before each frame."""
FAR = 3600.0
"""Seconds off its neighbours that make a receive stamp wrong."""
FAR_AFTER_DAMAGE = 60.0
"""The same for a stamp behind damage, which may itself be damaged."""
BATCH = 1 << 16
"""Stamps read together."""
AROUND = 9
"""Stamps whose median says where the one in their middle should lie."""


class Receipts:
    """The receive stamps of a stream, taken table by table; only the places of those that are wrong are kept.

    Attributes:
        bytes_skipped: bytes that are neither frame nor stamp.
    """

    def __init__(self, data: Bytes) -> None:
        """Takes the stream."""
        self._data = data
        self.bytes_skipped = len(data)
        self._end = 0
        self._last: Times = np.empty(0)
        self._steady = True
        self._all, self._near = _Span(), _Span()
        self._without: list[Places] = [np.empty(0, dtype=np.int64)]
        self._wrong: list[Places] = [np.empty(0, dtype=np.int64)]
        # Stamps whose neighbours are still to come, behind those of their neighbours that were judged.
        self._waiting = (np.empty(0, dtype=np.int64), np.empty(0), np.empty(0))
        self._judged = 0
        # Places of frames without a stamp to trust, known at the end, and the end of the stream.
        self._untrusted: Places = np.empty(0, dtype=np.int64)

    def add(self, frames: Frames) -> None:
        """Takes the next frames of the stream."""
        if not len(frames):
            return
        space = frames.start - np.concatenate([[self._end], frames.end[:-1]])
        self._end = int(frames.end[-1])
        self.bytes_skipped -= int(np.minimum(space, STAMP).sum() + (frames.end - frames.start).sum())
        stamped = space >= STAMP
        if not stamped.all():
            self._without.append(frames.start[~stamped])
        start, limit = frames.start[stamped], np.where(space[stamped] == STAMP, FAR, FAR_AFTER_DAMAGE)
        times = _stamps(self._data, start) / 1e6
        steps = np.abs(np.diff(times, prepend=self._last))
        self._steady = self._steady and bool((steps <= limit[len(limit) - len(steps) :]).all())
        self._last = times[-1:] if len(times) else self._last
        self._all.take(times)
        starts, before, limits = self._waiting
        self._waiting = (
            np.concatenate([starts, start]),
            np.concatenate([before, times]),
            np.concatenate([limits, limit]),
        )
        if len(self._waiting[0]) >= AROUND:
            self._judge(AROUND // 2)

    def close(self) -> None:
        """Ends the stream."""
        self._judge(0)
        untrusted = self._without if self._steady else self._without + self._wrong
        self._untrusted = np.sort(np.concatenate([*untrusted, [len(self._data)]]))

    @property
    def span(self) -> tuple[float, float]:
        """First and last trustworthy stamp, UNIX s; NaN where there is none."""
        return self._all.ends if self._steady else self._near.ends

    def at(self, start: Places) -> Times:
        """UNIX s (N,) of the frames that begin at ``start`` (N,), ascending.

        NaN where there is no stamp or it lies far from its neighbours'.
        """
        times = np.empty(len(start))
        for begin in range(0, len(start), BATCH):
            rows = slice(begin, begin + BATCH)
            places = start[rows].astype(np.int64)
            untrusted = self._untrusted[np.searchsorted(self._untrusted, places)] == places
            times[rows] = np.where(untrusted, np.nan, _stamps(self._data, places) / 1e6)
        return times

    def recorded(self, start: Places) -> NDArray[np.uint64]:
        """UNIX microseconds (N,) that stand before the frames that begin at ``start`` (N,); 0 where none do."""
        stampless = np.isin(start, np.concatenate(self._without))
        return np.where(stampless, np.uint64(0), _stamps(self._data, start.astype(np.int64)))

    def _judge(self, yet_to_come: int) -> None:
        start, times, limit = self._waiting
        far = far_off(times, AROUND, limit)
        rows = slice(self._judged, len(start) - yet_to_come)
        if far[rows].any():
            self._wrong.append(start[rows][far[rows]])
        self._near.take(times[rows][~far[rows]])
        kept = max(rows.stop - AROUND // 2, 0)
        self._waiting = (start[kept:], times[kept:], limit[kept:])
        self._judged = rows.stop - kept


class _Span:
    """The least and the greatest of the values taken."""

    def __init__(self) -> None:
        self.ends = (np.nan, np.nan)

    def take(self, values: Times) -> None:
        if len(values):
            self.ends = (float(np.fmin(self.ends[0], values.min())), float(np.fmax(self.ends[1], values.max())))


def _stamps(data: Bytes, start: NDArray[np.int64]) -> NDArray[np.uint64]:
    """Microseconds, big-endian, before each frame; without meaning where a frame begins before any stamp fits."""
    if len(data) < STAMP:
        return np.zeros(len(start), dtype=np.uint64)
    return rows_of(data, np.maximum(start - STAMP, 0), STAMP).view(">u8")[:, 0].astype(np.uint64)
