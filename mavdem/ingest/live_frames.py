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

import re
from functools import cache
from itertools import pairwise
from typing import NamedTuple

from mavdem.ingest.checksum import checksum
from mavdem.ingest.decode import definitions
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
)

LONGEST_CHAIN = 32
"""Frames in a row that no checksum vouches for, before they count as garbage: bounds what waits for its end."""

_MARKER = re.compile(rb"[\xfd\xfe]")


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
        nothing: set[int] = set()
        place = 0
        while marker := _MARKER.search(data, place):
            self.garbage += marker.start() - place
            place = marker.start()
            chain = _chain(data, place, nothing)
            if chain is None:
                break
            frames, place_after = chain
            found += frames
            self.garbage += not frames
            place = place_after if frames else place + 1
        else:
            self.garbage += len(data) - place
            place = len(data)
        self._rest = data[place:]
        self.frames += len(found)
        self.unread += sum(frame.verdict != GOOD for frame in found)
        return found


def _chain(data: bytes, place: int, nothing: set[int]) -> tuple[list[Frame], int] | None:
    """The frames from ``place`` up to one whose checksum agrees, and where they end; none where that leads nowhere.

    None where more bytes must decide. ``nothing`` holds the places from which nothing was led to, so that each is
    looked at once.
    """
    frames: list[Frame] = []
    places: list[int] = []
    while len(frames) < LONGEST_CHAIN and place not in nothing:
        found = _frame(data, place)
        if found is None:
            return None
        places.append(place)
        frame, end = found
        if frame is None:
            break
        frames.append(frame)
        if frame.verdict == GOOD:
            if any(_holds_another(data[start:until]) for start, until in pairwise(places)):
                # What announced a length that happens to end where a frame begins was no frame.
                nothing.add(places[0])
                return [], end
            return frames, end
        place = end
    nothing.update(places)
    return [], place


def _holds_another(span: bytes) -> bool:
    """Whether a frame whose checksum agrees lies within the bytes of one that no checksum vouches for."""
    for marker in _MARKER.finditer(span, 1):
        found = _frame(span, marker.start())
        if found is not None and found[0] is not None and found[0].verdict == GOOD:
            return True
    return False


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
