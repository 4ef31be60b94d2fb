"""The queue of logs that are to be read: how many come before each, and when it will probably have been read.

How long a log takes is estimated from those that were read before: by the logs of the nearest sizes, in proportion.
"""

import math
import statistics
import sys
import time
from bisect import bisect
from collections.abc import Sequence
from typing import NamedTuple

from mavdem.facts.serve import Stage
from mavdem.serve.library import Library

HISTORY_LENGTH = 200
"""Logs that were read last, whose durations count: the machine's load and the program's version change."""

NEIGHBOURS = 5
"""Logs of the nearest sizes, of whose durations the median is taken: one odd log among them has no effect."""

MIN_HISTORY = 3
"""Logs that must have been read before anything is estimated."""

MIN_REMAINING_SHARE = 0.1
"""Least share of the seconds so far that a log is expected to take on: one that takes longer than others goes on."""

ROUNDING_SECONDS = 10
"""Seconds to which estimated ends are rounded: finer ones would change with each look, and are not known."""


class ReadLogSize(NamedTuple):
    """A log that was read."""

    size: int
    """size of the log, B"""
    seconds: float
    """how long the reading took, s"""


class QueuePlace(NamedTuple):
    """The place of a log in the queue."""

    ahead: int = 0
    """number of logs that are read before it"""
    estimated_end: float | None = None
    """UNIX time at which it will probably have been read, s; None while too few logs were read before"""


def queue_places(library: Library) -> dict[str, QueuePlace]:
    """Returns the places of all logs that wait or are being read, by their ids.

    All processes are taken to be busy while logs wait, so that as many logs are read at a time as are read now.

    Args:
        library: the library with the logs.
    """
    history = _reading_history(library)
    now = time.time()
    query = "select id, size from entries where stage = ? order by received"
    waiting = library.db.execute(query, [Stage.WAITING]).fetchall()
    reading, _ = library.find("stage = ?", [Stage.READING], sys.maxsize)
    # The estimate for each size is made once: a thousand waiting logs are looked at five times a second.
    seconds_by_size = dict[int, float]()
    if len(history) >= MIN_HISTORY:
        sizes = {size for _, size in waiting} | {entry.size for entry in reading}
        seconds_by_size = {size: estimated_seconds(size, history) for size in sizes}
    places = dict[str, QueuePlace]()
    seconds_before = 0.0
    for entry in reading:
        if entry.size in seconds_by_size:
            begin = float(library.progress(entry).get("started", now))
            seconds_so_far = max(now - begin, 0.0)
            remaining = max(
                seconds_by_size[entry.size] - seconds_so_far, MIN_REMAINING_SHARE * seconds_so_far
            )
            seconds_before += remaining
            places[entry.id] = QueuePlace(0, _rounded(now + remaining))
    processes = max(len(reading), 1)
    for ahead, (id, size) in enumerate(waiting):
        estimated_end = None
        if size in seconds_by_size:
            seconds = seconds_by_size[size]
            estimated_end = _rounded(now + seconds_before / processes + seconds)
            seconds_before += seconds
        places[id] = QueuePlace(ahead, estimated_end)
    return places


def estimated_seconds(size: int, history: Sequence[ReadLogSize]) -> float:
    """Estimates how long the reading of a log takes, s.

    The estimate is the median over the ``NEIGHBOURS`` logs of the nearest sizes of the duration of each, in proportion
    to the size.

    Args:
        size: size of the log, B.
        history: logs that were read, at least one, in order of size.
    """
    place = bisect(history, ReadLogSize(size, math.inf))
    first = min(max(place - (NEIGHBOURS + 1) // 2, 0), max(len(history) - NEIGHBOURS, 0))
    neighbours = history[first : first + NEIGHBOURS]
    return statistics.median(log.seconds * size / log.size for log in neighbours)


def _reading_history(library: Library) -> list[ReadLogSize]:
    """Returns the logs that were read last with success, in order of size."""
    query = """select size, seconds from logs where ended = 'read' and size > 0 and seconds > 0
        order by rowid desc limit ?"""
    found = library.db.execute(query, [HISTORY_LENGTH])
    return sorted(ReadLogSize(size, seconds) for size, seconds in found)


def _rounded(unix_time: float) -> float:
    """Returns a time rounded up to ``ROUNDING_SECONDS``."""
    return ROUNDING_SECONDS * float(math.ceil(unix_time / ROUNDING_SECONDS))
