"""Which component sent which message, and where in the stream, in a few bytes a frame; and how many are missing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.log import Unread
from mavdem.ingest.mavlink.framing import GOOD, UNKNOWN, Frames

Numbers = TypeVar("Numbers", int, NDArray[np.integer])
Starts = NDArray[np.unsignedinteger]
"""Places of frames in the stream, in its order, in the smallest type that holds them."""
BATCH = 1 << 16  # Frames sorted together
SOURCES = 1 << 16  # Pairs of system and component; a source is ``system << 8 | component``


class FrameIndex:
    """The frames of a stream by component and message, added table by table: whole ``frames``, and ``good`` ones.

    ``lost`` (SOURCES,): messages missing by the gaps in each source's sequence numbers; negative where many came twice.
    """

    def __init__(self, size: int, seeds: NDArray[np.int32]) -> None:
        """Starts with the size of the stream, bytes, and CRC_EXTRA by message id."""
        self.frames = self.good = 0
        self.lost = np.zeros(SOURCES, dtype=np.int64)
        self._last_sequence = np.full(SOURCES, -1, dtype=np.int16)
        self._ids = np.flatnonzero(seeds >= 0)
        self._rank_of_id = np.cumsum(seeds >= 0) - 1
        # A kind is a message of a source. Kinds are numbered from 1 on as they occur, so that sorting is fast.
        self._kinds: list[int] = []
        # By the rank of the source, in order of occurrence, and that of the message id.
        self._kind_of = np.zeros((1, len(self._ids)), dtype=np.int32)
        self._rank_of_source = np.full(SOURCES, -1, dtype=np.int32)
        self._sources = 0
        self._starts, self._kind = _Growing(np.min_scalar_type(size)), _Growing(np.dtype(np.uint32))
        self._unread: dict[int, Counter[int]] = {}

    def add(self, frames: Frames) -> None:
        """Adds the next frames of the stream."""
        self.frames += len(frames)
        source = frames.system.astype(np.int64) << 8 | frames.component
        self._count_lost(source, frames.sequence)
        good = frames.verdict == GOOD
        for row in np.flatnonzero(~good).tolist():
            key = int(frames.message_id[row]) << 16 | int(source[row])
            self._unread.setdefault(int(frames.verdict[row]), Counter())[key] += 1
        self.good += int(np.count_nonzero(good))
        self._starts.extend(frames.start[good])
        self._kind.extend(self._kinds_of(source[good], self._rank_of_id[frames.message_id[good]]))

    def _kinds_of(self, source: NDArray[np.int64], rank_of_id: NDArray[np.int64]) -> NDArray[np.int32]:
        rank_of_source = self._rank_of_source[source]
        if (rank_of_source < 0).any():
            new = np.unique(source[rank_of_source < 0])
            self._rank_of_source[new] = self._sources + np.arange(len(new))
            self._sources += len(new)
            rank_of_source = self._rank_of_source[source]
            if self._sources > len(self._kind_of):
                larger = np.zeros((2 * self._sources, len(self._ids)), dtype=np.int32)
                larger[: len(self._kind_of)] = self._kind_of
                self._kind_of = larger
        kind = self._kind_of[rank_of_source, rank_of_id]
        if not kind.all():
            first = np.unique(source[kind == 0] * len(self._ids) + rank_of_id[kind == 0])
            at = self._rank_of_source[first // len(self._ids)], first % len(self._ids)
            self._kind_of[at] = len(self._kinds) + 1 + np.arange(len(first))
            self._kinds += first.tolist()
            kind = self._kind_of[rank_of_source, rank_of_id]
        return kind

    def _count_lost(self, source: NDArray[np.int64], sequence: NDArray[np.uint8]) -> None:
        order = np.argsort(source.astype(np.uint16), kind="stable")
        source, sequence = source[order], sequence[order].astype(np.int16)
        first, last = np.ones(len(source), dtype=np.bool_), np.ones(len(source), dtype=np.bool_)
        first[1:] = last[:-1] = source[1:] != source[:-1]
        before = np.roll(sequence, 1)
        before[first] = self._last_sequence[source[first]]
        self._last_sequence[source[last]] = sequence[last]
        missing = missing_between(before, sequence)
        missing[before < 0] = 0
        gaps = np.flatnonzero(missing)
        np.add.at(self.lost, source[gaps], missing[gaps])

    def sent(self) -> dict[int, dict[int, Starts]]:
        """Where the good frames of each message begin, by source and message id, both ascending; call it once, last."""
        smallest = np.min_scalar_type(len(self._kinds))
        counts = np.zeros(len(self._kinds) + 1, dtype=np.int64)
        for kind in self._kind.batches():
            present, number = np.unique(kind.astype(smallest), return_counts=True)
            counts[present] += number
        ends = np.cumsum(counts)
        free = ends - counts
        starts = np.empty(self.good, dtype=self._starts.dtype)
        for start, kind in zip(self._starts.batches(), self._kind.batches(), strict=True):
            order = np.argsort(kind.astype(smallest), kind="stable")
            present, begin, number = np.unique(kind[order], return_index=True, return_counts=True)
            starts[np.repeat(free[present] - begin, number) + np.arange(len(kind))] = start[order]
            free[present] += number
        self._starts, self._kind = _Growing(self._starts.dtype), _Growing(self._kind.dtype)
        found: dict[int, dict[int, Starts]] = {}
        for pair, first, end in sorted(zip(self._kinds, ends[:-1].tolist(), ends[1:].tolist(), strict=True)):
            source, rank = divmod(pair, len(self._ids))
            found.setdefault(source, {})[int(self._ids[rank])] = starts[first:end]
        return found

    def unread(self, sent: Mapping[int, Mapping[int, Starts]]) -> tuple[Unread, ...]:
        """The frames that could not be read, of a stream in which the good ones are ``sent``."""
        unknown = self._unread.get(UNKNOWN, Counter[int]())
        bad: Counter[int] = sum(self._unread.values(), Counter())
        found = []
        for key, count in sorted(bad.items()):
            message_id, source = key >> 16, key & 0xFFFF
            total = count + len(sent.get(source, {}).get(message_id, ()))
            # Of another dialect all frames of a message fail, and more than two, which may be damage.
            strange = source in sent if key in unknown else count == total >= 3
            cause = "another dialect" if strange else "damage"
            found.append(Unread(message_id, source >> 8, source & 0xFF, count, total, cause))
        return tuple(found)


class _Growing:
    """A growing array of numbers in a few large pieces: many small ones would fragment the memory."""

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self.dtype = dtype
        self._pieces: list[NDArray[Any]] = []
        self._free = self._count = 0

    def extend(self, values: NDArray[Any]) -> None:
        while len(values):
            if not self._free:
                self._free = max(BATCH, self._count)
                self._pieces.append(np.empty(self._free, dtype=self.dtype))
            piece = self._pieces[-1]
            part, values = values[: self._free], values[self._free :]
            piece[len(piece) - self._free :][: len(part)] = part
            self._free -= len(part)
            self._count += len(part)

    def batches(self) -> Iterator[NDArray[Any]]:
        """All of them in order, ``BATCH`` at a time."""
        left = self._count
        for piece in self._pieces:
            filled = piece[:left]
            left -= len(filled)
            yield from (filled[begin : begin + BATCH] for begin in range(0, len(filled), BATCH))


def missing_between(before: Numbers, after: Numbers) -> Numbers:
    """Increase of one sender's number of missing messages from one message to the next, −33 to 127.

    The numbers run from 0 to 255 and start again. A late message was counted as missing when another overtook it, and
    the step after it counts the messages between again. It takes both back, so that the sum over a stream is the number
    sent less the number received, as in RTP (RFC 3550, section 6.4.1). Duplicates make the sum too small.
    """
    step = (after - before) & 0xFF
    late = step >= 256 - 32  # a larger step back is of a sender that restarted
    ahead = (step > 0) & (step <= 128)
    return (step - 1 - 256 * late) * (ahead | late)
