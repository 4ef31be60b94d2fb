"""MAVLink frames in bytes that come piece by piece, one frame at a time.

What counts as a frame is what counts in files (``ingest.mavlink.framing``): one with a correct checksum, or one of
another dialect or damaged, if it fills the space before one with a correct checksum. Only the order differs: here the
first candidate counts, in a file the one with more evidence. The results differ only where damaged bytes match a
checksum by chance. A frame is complete as soon as its last byte is there. A marker among garbage may delay later frames
until the 280 bytes it can announce have come; nothing is lost by it. The table of ``framing`` takes a quarter of a
millisecond for any input, this 3 µs a frame.
"""

from __future__ import annotations

from bisect import bisect_left
from functools import cache
from itertools import islice, pairwise, takewhile
from typing import NamedTuple

import numpy as np

from mavdem.ingest.mavlink.definitions import definitions, seeds
from mavdem.ingest.mavlink.framing import (
    FAILED,
    GOOD,
    HEADER,
    HEADER_1,
    MARKER_1,
    MARKER_2,
    UNKNOWN,
    announced_length,
    candidates,
    frame_checksum,
)

LONGEST_CHAIN = 32
"""Frames in a row without a correct checksum before they count as garbage: bounds what waits for its end."""


class LiveFrame(NamedTuple):
    """One frame."""

    message_id: int  # with system, component, sequence: from the header
    system: int
    component: int
    sequence: int
    verdict: int  # ``GOOD``, ``UNKNOWN`` or ``FAILED`` of ``framing``
    payload: bytes  # as sent, without the zeros that MAVLink 2 truncates


class LiveFrames:
    """Finds the frames of one stream.

    ``frames``: complete frames so far, unread ones included. ``unread``: those of other dialects, and damaged ones.
    ``garbage``: bytes that belong to no frame.
    """

    def __init__(self) -> None:
        self.frames = self.unread = self.garbage = 0
        self._rest = b""
        _seeds()  # slow the first time

    def feed(self, piece: bytes) -> list[LiveFrame]:
        """The frames that the next bytes complete, in order; independent of how the bytes are cut."""
        data = self._rest + piece
        found: list[LiveFrame] = []
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
            # Damage, garbage or another dialect: examine all that is ahead at once.
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
    """Where in some bytes frames begin that have a correct checksum, or that lead to one, header by header.

    One pass over columns: one by one, a datagram full of markers would take a quarter of a second.
    """

    def __init__(self, data: bytes) -> None:
        self._data, size = data, len(data)
        start, end, good = (column.tolist() for column in candidates(np.frombuffer(data, np.uint8), seeds()))
        # Frames before the one that decides: a correct checksum, or the end of the bytes.
        before = [LONGEST_CHAIN] * size + [0]
        for place, until, agrees in zip(reversed(start), reversed(end), reversed(good), strict=True):
            before[place] = 0 if agrees or until > size else before[until] + 1
        self._hopeful = [place for place in start if before[place] < LONGEST_CHAIN]
        self._good = [(place, until) for place, until, agrees in zip(start, end, good, strict=True) if agrees]

    def hopeful_from(self, place: int) -> int:
        """The first place from here on that leads to a deciding frame; the end of the bytes if there is none."""
        row = bisect_left(self._hopeful, place)
        return self._hopeful[row] if row < len(self._hopeful) else len(self._data)

    def chain(self, place: int) -> tuple[list[LiveFrame], int] | None:
        """The frames from a hopeful place up to one with a correct checksum, and where they end.

        None if more bytes are needed. No frames if one without a correct checksum contains one with: then it was no
        frame, and its length ends where a frame begins by chance.
        """
        frames: list[LiveFrame] = []
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
        """Whether a frame with a correct checksum lies within these bytes, behind the first."""
        row = bisect_left(self._good, (start + 1,))
        inside = takewhile(lambda one: one[0] < end, islice(self._good, row, None))
        return any(until <= end for _, until in inside)


def _frame(data: bytes, place: int) -> tuple[LiveFrame | None, int] | None:
    """The frame announced by the header at ``place`` and where it ends; no frame if there is no header.

    None if it is not complete yet.
    """
    header = data[place : place + HEADER]
    if header and header[0] not in (MARKER_1, MARKER_2):
        return None, place
    if len(header) < 3:
        return None
    length = announced_length(*header[:3])
    if length is None:
        return None, place
    if (end := place + length) > len(data):
        return None
    if header[0] == MARKER_2:
        payload = place + HEADER
        sequence, system, component, low, middle, high = header[4:]
        message_id = low | middle << 8 | high << 16
    else:
        payload = place + HEADER_1
        sequence, system, component, message_id = header[2:HEADER_1]
    behind = payload + header[1]
    seed, verdict = _seeds().get(message_id), UNKNOWN
    if seed is not None:
        sent = data[behind] | data[behind + 1] << 8
        verdict = GOOD if sent == frame_checksum(data[place + 1 : behind], seed) else FAILED
    return LiveFrame(message_id, system, component, sequence, verdict, data[payload:behind]), end


@cache
def _seeds() -> dict[int, int]:
    """CRC_EXTRA by message id."""
    return {message_id: definition.seed for message_id, definition in definitions().items()}
