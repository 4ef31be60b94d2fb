"""MAVLink frames in bytes that come piece by piece, one frame at a time.

What counts as a frame is what counts in files (``framing``): one whose checksum agrees; one of another dialect, or
damaged but of the right length, if it fills the space before one that agrees. What differs is the order: here the first
candidate counts, in a file the one with more evidence. They part only where bytes of a damaged stretch agree with a
checksum by chance.

A frame is told as soon as its last byte is there. A marker among garbage may hold those behind it up until the 280
bytes it can announce have come; nothing is lost by it. The table of ``framing`` takes a quarter of a millisecond
whatever it holds, this 3 µs a frame.
"""

from __future__ import annotations

from bisect import bisect_left
from functools import cache
from itertools import islice, pairwise, takewhile
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.checksum import checksum
from mavdem.ingest.decode import definitions, seeds
from mavdem.ingest.framing import (
    CHECKSUM,
    FAILED,
    GOOD,
    HEADER,
    HEADER_1,
    MARKER_1,
    MARKER_2,
    SIGNATURE,
    SIGNED,
    UNKNOWN,
    candidates,
)

LONGEST_CHAIN = 32
"""Frames in a row that no checksum vouches for, before they count as garbage: bounds what waits for its end."""


class Frame(NamedTuple):
    """One frame.

    Attributes:
        message_id, system, component, sequence: from the header.
        verdict: ``GOOD``, ``UNKNOWN`` or ``FAILED`` of ``framing``.
        payload: as sent: without the zeros that MAVLink 2 cuts off.
    """

    message_id: int
    system: int
    component: int
    sequence: int
    verdict: int
    payload: bytes


class LiveFrames:
    """Finds the frames of one stream.

    Attributes:
        frames: whole frames so far, unread ones included.
        unread: those of other dialects or damaged.
        garbage: bytes that belong to no frame.
    """

    def __init__(self) -> None:
        """Begins without a byte."""
        self.frames = self.unread = self.garbage = 0
        self._rest = b""
        _seeds()  # takes a while the first time

    def feed(self, piece: bytes) -> list[Frame]:
        """The frames that the next bytes of the stream complete, in order; the same however the bytes are cut."""
        data = self._rest + piece
        found: list[Frame] = []
        ahead: _Ahead | None = None
        place = 0
        while place < len(data):
            one = _frame(data, place)
            if one is None:
                break
            frame, end = one
            if frame is not None and frame.verdict == GOOD:
                found.append(frame)
                place = end
                continue
            # Damage, garbage or another dialect: what is ahead is looked at once, all of it together.
            ahead = _Ahead(data) if ahead is None else ahead
            start = ahead.hopeful_from(place)
            self.garbage += start - place
            place = start
            if place == len(data):
                break
            chain = ahead.chain(place)
            if chain is None:
                break
            frames, end = chain
            found += frames
            self.garbage += not frames
            place = end if frames else place + 1
        self._rest = data[place:]
        self.frames += len(found)
        self.unread += sum(frame.verdict != GOOD for frame in found)
        return found


class _Ahead:
    """Where in some bytes frames begin that a checksum vouches for, or that lead to one, header by header.

    All are looked at in one pass over columns: one by one, a datagram full of markers would take a quarter of a second.
    """

    def __init__(self, data: bytes) -> None:
        self._data, size = data, len(data)
        start, end, good = (column.tolist() for column in candidates(np.frombuffer(data, np.uint8), _seed_table()))
        # Frames to read before what decides: a checksum that agrees, or the end of what has come.
        before = [LONGEST_CHAIN] * size + [0]
        for place, until, agrees in zip(reversed(start), reversed(end), reversed(good), strict=True):
            before[place] = 0 if agrees or until > size else before[until] + 1
        self._hopeful = [place for place in start if before[place] < LONGEST_CHAIN]
        self._good = [(place, until) for place, until, agrees in zip(start, end, good, strict=True) if agrees]

    def hopeful_from(self, place: int) -> int:
        """The first place, from this one on, that leads to what decides; the end of the bytes where there is none."""
        row = bisect_left(self._hopeful, place)
        return self._hopeful[row] if row < len(self._hopeful) else len(self._data)

    def chain(self, place: int) -> tuple[list[Frame], int] | None:
        """The frames from a hopeful place up to one whose checksum agrees, and where they end.

        None where more must come to decide. No frames where one that no checksum vouches for holds one that agrees:
        what announced a length that happens to end where a frame begins was no frame.
        """
        frames: list[Frame] = []
        places = [place]
        while not (frames and frames[-1].verdict == GOOD):
            found = _frame(self._data, places[-1])
            if found is None:
                return None
            frame, end = found
            assert frame is not None  # or the place would not be hopeful
            frames.append(frame)
            places.append(end)
        if any(self._holds_good(start, until) for start, until in pairwise(places[:-1])):
            return [], place
        return frames, places[-1]

    def _holds_good(self, start: int, end: int) -> bool:
        """Whether a frame whose checksum agrees lies within these bytes, behind the first."""
        row = bisect_left(self._good, (start + 1,))
        inside = takewhile(lambda one: one[0] < end, islice(self._good, row, None))
        return any(until <= end for _, until in inside)


def _frame(data: bytes, place: int) -> tuple[Frame | None, int] | None:
    """The frame that the header at ``place`` announces and where it ends; no frame where there is none.

    None where it is not all there yet.
    """
    header = data[place : place + HEADER]
    if not header:
        return None
    second = header[0] == MARKER_2
    if not (second or header[0] == MARKER_1) or (second and len(header) > 2 and header[2] > SIGNED):
        return None, place
    if len(header) < (HEADER if second else HEADER_1):
        return None
    if second:
        payload = place + HEADER
        sequence, system, component, low, middle, high = header[4:]
        message_id = low | middle << 8 | high << 16
    else:
        payload = place + HEADER_1
        sequence, system, component, message_id = header[2:HEADER_1]
    behind = payload + header[1]
    end = behind + CHECKSUM + (SIGNATURE if second and header[2] == SIGNED else 0)
    if end > len(data):
        return None
    seed, verdict = _seeds().get(message_id), UNKNOWN
    if seed is not None:
        sent = data[behind] | data[behind + 1] << 8
        verdict = GOOD if sent == checksum(data[place + 1 : behind], seed) else FAILED
    return Frame(message_id, system, component, sequence, verdict, data[payload:behind]), end


@cache
def _seeds() -> dict[int, int]:
    """CRC_EXTRA by message id."""
    return {message_id: definition.seed for message_id, definition in definitions().items()}


@cache
def _seed_table() -> NDArray[np.int32]:
    """The same as a column."""
    return seeds()
