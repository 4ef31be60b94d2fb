"""Telemetry logs (.tlog): each frame as it came over the link, behind the 8-byte time it was received.

The time is big-endian microseconds since 1970. It orders nothing here, being late by seconds at times: messages are
placed by the autopilot's own stamps (``clocks``). Layout: pymavlink ``mavutil.mavlogfile``.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Iterator

import numpy as np

from mavdem.errors import Unreadable
from mavdem.ingest.census import Census
from mavdem.ingest.checksum import Bytes
from mavdem.ingest.decode import seeds
from mavdem.ingest.files import READ, mapped_bytes, require_whole
from mavdem.ingest.framing import GOOD, Frames, Progress, concatenated, find_frames
from mavdem.ingest.log import Log
from mavdem.ingest.receipt import STAMP, Receipts
from mavdem.ingest.stream import Stream
from mavdem.ingest.vehicles import assemble

BLOCK = 1 << 20
"""Bytes looked through for line ends at a time."""
FEWEST_LINE_ENDS = 8
"""Line feeds that must all stand behind a carriage return before a file counts as converted: chance gives 1 in 2^64."""


def read_tlog(path: str | os.PathLike[str], progress: Progress | None = None) -> Log:
    """Reads a telemetry log, damaged ones as far as they go.

    Args:
        path: the file.
        progress: called with the fraction done.

    Raises:
        Unreadable: the file cannot be opened, or there is no MAVLink in it, or it is cut short while it is read.
    """
    source = os.fspath(path)
    data, repairs = _without_carriage_returns(mapped_bytes(path))
    census, receipts = Census(len(data), seeds()), Receipts(data)
    for frames in _tables(data, source, progress):
        census.add(frames)
        receipts.add(frames)
    receipts.close()
    if not census.good:
        raise Unreadable(_nothing_in(source, census.frames))
    return assemble(data, census, receipts.at, receipts.span, receipts.bytes_skipped, source, repairs)


def tlog_stream(path: str | os.PathLike[str], progress: Progress | None = None) -> Stream:
    """The frames of a telemetry log with their receive stamps, in the order they were received.

    Args:
        path: the file.
        progress: called with the fraction done.

    Raises:
        Unreadable: as ``read_tlog``.
    """
    source = os.fspath(path)
    data, repairs = _without_carriage_returns(mapped_bytes(path))
    receipts, tables = Receipts(data), []
    for table in _tables(data, source, progress):
        receipts.add(table)
        tables.append(table)
    frames = concatenated(tables)
    if not (frames.verdict == GOOD).any():
        raise Unreadable(_nothing_in(source, len(frames)))
    return Stream(source, ".tlog", data, frames, receipts.recorded(frames.start), receipts.bytes_skipped, repairs)


def _tables(data: Bytes, source: str, progress: Progress | None) -> Iterator[Frames]:
    """What ``find_frames`` gives, as long as the file is whole."""
    for frames in find_frames(data, seeds(), STAMP, progress):
        require_whole(data, source)
        yield frames


def _without_carriage_returns(content: bytes | mmap.mmap) -> tuple[Bytes, tuple[str, ...]]:
    """Undoes the conversion of line ends that some transfers do: then no line feed is without a carriage return."""
    data = np.frombuffer(content, dtype=np.uint8)
    feeds = _converted_line_ends(data)
    if feeds < FEWEST_LINE_ENDS:
        return data, ()
    restored = np.empty(len(data) - feeds, dtype=np.uint8)
    place = 0
    for begin in range(0, len(data), BLOCK):
        block, following = data[begin : begin + BLOCK], data[begin + 1 : begin + BLOCK + 1]
        put = np.zeros(len(block), dtype=np.bool_)
        put[: len(following)] = (block[: len(following)] == ord("\r")) & (following == ord("\n"))
        kept = block[~put]
        restored[place : place + len(kept)] = kept
        place += len(kept)
    sentence = f"The file had been transferred as text, which put 0D before each of its {feeds} bytes 0A; undone."
    return restored, (sentence,)


def _converted_line_ends(data: Bytes) -> int:
    """How many line feeds there are, if each is behind a carriage return; else 0."""
    feeds = 0
    for begin in range(0, len(data), BLOCK):
        at = begin + np.flatnonzero(data[begin : begin + BLOCK] == ord("\n"))
        if len(at) and (at[0] == 0 or (data[at - 1] != ord("\r")).any()):
            return 0
        feeds += len(at)
    return feeds


def _nothing_in(source: str, frames: int) -> str:
    if frames:
        return (
            f"{source} holds {frames} frames that look like MAVLink, but none agrees with a dialect that "
            "pymavlink knows: it is of another dialect or damaged throughout."
        )
    return f"{source} holds no MAVLink: {READ}."
