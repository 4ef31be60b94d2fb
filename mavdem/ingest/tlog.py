"""Telemetry logs (.tlog): each frame as it came over the link, behind the 8-byte time it was received.

The time is big-endian microseconds since 1970. It orders nothing here, being late by seconds at times: messages are
placed by the autopilot's own stamps (``clocks``). Layout: pymavlink ``mavutil.mavlogfile``.
"""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray

from mavdem.errors import Unreadable
from mavdem.ingest.clocks import Times, running_median
from mavdem.ingest.decode import seeds
from mavdem.ingest.files import file_bytes
from mavdem.ingest.framing import GOOD, Bytes, Frames, Progress, find_frames, padded
from mavdem.ingest.log import Log
from mavdem.ingest.stream import Stream

STAMP = 8
"""Bytes of the time stamp before each frame."""
FEWEST_LINE_ENDS = 8
"""Line feeds that must all stand behind a carriage return before a file counts as converted: chance gives 1 in 2^64."""
FAR = 3600.0
"""Seconds off its neighbours that make a receive stamp wrong."""
FAR_AFTER_DAMAGE = 60.0
"""The same for a stamp behind damage, which may itself be damaged."""


def read_tlog(path: str | os.PathLike[str], progress: Progress | None = None) -> Log:
    """Reads a telemetry log, damaged ones as far as they go.

    Args:
        path: the file.
        progress: called with the fraction done.

    Raises:
        Unreadable: the file cannot be opened, or there is no MAVLink in it.
    """
    return tlog_stream(path, progress).log()


def tlog_stream(path: str | os.PathLike[str], progress: Progress | None = None) -> Stream:
    """The frames of a telemetry log with their receive stamps, not yet sorted by who sent them.

    Args:
        path: the file.
        progress: called with the fraction done.

    Raises:
        Unreadable: the file cannot be opened, or there is no MAVLink in it.
    """
    content, repairs = _without_carriage_returns(file_bytes(path))
    data = padded(content)
    frames = find_frames(data, seeds(), STAMP, progress)
    if not (frames.verdict == GOOD).any():
        raise Unreadable(_nothing_in(path, frames))
    skipped = _skipped(frames, len(content))
    received = _receive_times(data, frames)
    return Stream(os.fspath(path), ".tlog", data, frames, _stamps(data, frames), received, skipped, repairs)


def _without_carriage_returns(content: bytes) -> tuple[bytes, tuple[str, ...]]:
    """Undoes the conversion of line ends that some transfers do: then no line feed is without a carriage return."""
    feeds = content.count(b"\n")
    if feeds < FEWEST_LINE_ENDS or content.count(b"\r\n") != feeds:
        return content, ()
    sentence = f"The file had been transferred as text, which put 0D before each of its {feeds} bytes 0A; undone."
    return content.replace(b"\r\n", b"\n"), (sentence,)


def _stamps(data: Bytes, frames: Frames) -> NDArray[np.uint64]:
    """The stamp before each frame as it stands there, microseconds; 0 where there is none."""
    stamped = np.flatnonzero(_space(frames) >= STAMP)
    stamps = np.zeros(len(frames), dtype=np.uint64)
    at = frames.start[stamped] - STAMP
    stamps[stamped] = np.lib.stride_tricks.sliding_window_view(data, STAMP)[at].view(">u8")[:, 0]
    return stamps


def _space(frames: Frames) -> NDArray[np.int64]:
    """Bytes between each frame and the one before."""
    return np.asarray(frames.start - np.concatenate([[0], frames.end[:-1]]))


def _receive_times(data: Bytes, frames: Frames) -> Times:
    """UNIX seconds from the stamp before each frame; NaN where there is none or it lies far from its neighbours'."""
    space = _space(frames)
    stamped = np.flatnonzero(space >= STAMP)
    stamps = _stamps(data, frames)[stamped] / 1e6
    times = np.full(len(frames), np.nan)
    limit = np.where(space[stamped] == STAMP, FAR, FAR_AFTER_DAMAGE)
    near = near_neighbours(stamps, limit)
    times[stamped[near]] = stamps[near]
    return times


def near_neighbours(stamps: Times, limit: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which stamps (N,), s, lie no farther than ``limit`` (N,), s, from the median of the nine around them."""
    if not len(stamps) or (np.abs(np.diff(stamps)) <= limit[1:]).all():
        return np.ones(len(stamps), dtype=np.bool_)
    return np.asarray(np.abs(stamps - running_median(stamps, 9)) <= limit)


def _skipped(frames: Frames, size: int) -> int:
    """Bytes that are neither frame nor stamp."""
    between = np.append(frames.start, size + STAMP) - np.concatenate([[0], frames.end]) - STAMP
    return int(between[between > 0].sum())


def _nothing_in(path: str | os.PathLike[str], frames: Frames) -> str:
    if len(frames):
        return (
            f"{os.fspath(path)} holds {len(frames)} frames that look like MAVLink, but none agrees with a dialect that "
            "pymavlink knows: it is of another dialect or damaged throughout."
        )
    return f"{os.fspath(path)} holds no MAVLink: name a telemetry log (.tlog)."
