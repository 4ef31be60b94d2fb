"""The queue of logs to be read: how many are before each log, and when it will probably have been read.

How long a log takes is estimated from those that were read before: by the logs of the nearest sizes, in proportion, and
by how much faster or slower than such an estimate the last logs were read, which the machine's load decides.
"""

import math
import statistics
import sys
import time
from bisect import bisect
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from mavdem.facts.serve import Stage
from mavdem.serve.library import Library

HISTORY_LENGTH = 200
"""Logs that were read last, whose durations count: the machine's load and the program's version change."""

NEIGHBOURS = 5
"""Logs of the nearest sizes, of whose durations the median is taken: one odd log among them has no effect."""

RECENT_LOGS = 3
"""Logs that were read last, by which estimates follow the present speed: the median of three leaves out an odd one."""

MIN_HISTORY = 3
"""Logs that must have been read before anything is estimated."""

MIN_REMAINING_SHARE = 0.1
"""Least share of the seconds so far that a log is expected to take on: one that takes longer than others continues."""

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
    """Returns the places in the queue of all logs that wait or are being read, with the estimated end of each reading.

    For a log that is being read, the end follows from the begin of the reading and its estimated duration. The reading
    of a waiting log begins when the work before it is done. That work is shared by as many processes as read logs now,
    since all processes are busy while logs wait.

    Args:
        library: the logs that the server stores, with their results and their index.

    Returns:
        By id of the log, how many logs are before it, and when its reading ends, which is None as long as fewer than
        ``MIN_HISTORY`` logs have been read.
    """
    history = _reading_history(library)
    now = time.time()
    query = "select id, size from entries where stage = ? order by received"
    waiting_rows = library.db.execute(query, [Stage.WAITING]).fetchall()
    reading = library.find("stage = ?", [Stage.READING], sys.maxsize).entries
    sizes = {size for _, size in waiting_rows} | {entry.size for entry in reading}
    # The estimate for each size is made once, since a queue of a thousand logs is listed five times a second.
    seconds_by_size = _estimates_by_size(sizes, history)
    places_by_id = dict[str, QueuePlace]()
    # Sum of the reading times of all logs before the next waiting one, s.
    seconds_before = 0.0
    for entry in reading:
        if entry.size in seconds_by_size:
            begin = float(library.progress(entry).get("started", now))
            remaining_seconds = _remaining_seconds(seconds_by_size[entry.size], now - begin)
            seconds_before += remaining_seconds
            places_by_id[entry.id] = QueuePlace(0, _rounded_up(now + remaining_seconds))
    processes = max(len(reading), 1)
    for logs_ahead, (id, size) in enumerate(waiting_rows):
        estimated_end = None
        if size in seconds_by_size:
            begin = now + seconds_before / processes
            estimated_end = _rounded_up(begin + seconds_by_size[size])
            seconds_before += seconds_by_size[size]
        places_by_id[id] = QueuePlace(logs_ahead, estimated_end)
    return places_by_id


def _estimates_by_size(sizes: Iterable[int], history: Sequence[ReadLogSize]) -> dict[int, float]:
    """Estimates how long the reading of a log of each size takes, at the present speed of the machine.

    Args:
        sizes: sizes of the logs, B.
        history: sizes and durations of logs that were read, the latest first.

    Returns:
        Seconds by size; empty as long as fewer than ``MIN_HISTORY`` logs have been read.
    """
    if len(history) < MIN_HISTORY:
        return {}
    # The smallest log comes first: the time for a size is estimated from the logs of about that size.
    history_by_size = sorted(history)
    # How much longer the latest logs took than others of their size, for example while the machine is busy.
    slowness = recent_slowness(history)
    return {size: slowness * estimated_seconds(size, history_by_size) for size in sizes}


def _remaining_seconds(estimate: float, seconds_so_far: float) -> float:
    """Estimates the remaining time of the reading of a log.

    A reading that has taken longer than its estimate is expected to take ``MIN_REMAINING_SHARE`` of the time so far in
    addition.

    Args:
        estimate: estimated duration of the whole reading, s.
        seconds_so_far: time since the reading began, s; below 0 if the clock was set back.

    Returns:
        The time, s.
    """
    seconds_so_far = max(seconds_so_far, 0.0)
    return max(estimate - seconds_so_far, MIN_REMAINING_SHARE * seconds_so_far)


def estimated_seconds(size: int, history: Sequence[ReadLogSize]) -> float:
    """Estimates how long the reading of a log takes, s, from the logs of similar size that were read before.

    Each of the ``NEIGHBOURS`` logs nearest in size gives an estimate: its own duration, scaled in proportion to the
    size. The result is their median.

    Args:
        size: size of the log, B.
        history: sizes and durations of logs that were read, at least one, in order of size.

    Returns:
        Estimated duration, s.
    """
    # As many neighbours are smaller as are larger than this size, except near the ends of the list.
    rows_not_larger = bisect(history, ReadLogSize(size, math.inf))
    centred_first_row = max(rows_not_larger - (NEIGHBOURS + 1) // 2, 0)
    last_possible_first_row = max(len(history) - NEIGHBOURS, 0)
    first_row = min(centred_first_row, last_possible_first_row)
    neighbours = history[first_row : first_row + NEIGHBOURS]
    return statistics.median(log.seconds * size / log.size for log in neighbours)


def recent_slowness(history: Sequence[ReadLogSize]) -> float:
    """Returns how much slower than usual the last ``RECENT_LOGS`` logs were read, as a ratio of durations.

    It is above 1 once the load of the machine has risen, and below 1 once it has fallen.

    Args:
        history: sizes and durations of logs that were read, at least one, the latest first.

    Returns:
        The median of the ratios of each log's duration to the one estimated for its size from the whole history.
    """
    # The first field of a log is its size, so that the logs are sorted by it.
    logs_by_size = sorted(history)
    ratios = []
    for log in history[:RECENT_LOGS]:
        ratios.append(log.seconds / estimated_seconds(log.size, logs_by_size))
    return statistics.median(ratios)


def _reading_history(library: Library) -> list[ReadLogSize]:
    """Returns the logs that were read last with success, the latest first."""
    query = """select size, seconds from logs where ended = 'read' and size > 0 and seconds > 0
        order by rowid desc limit ?"""
    rows = library.db.execute(query, [HISTORY_LENGTH])
    return [ReadLogSize(size, seconds) for size, seconds in rows]


def _rounded_up(unix_time: float) -> float:
    """Returns a time rounded up to ``ROUNDING_SECONDS``."""
    return ROUNDING_SECONDS * float(math.ceil(unix_time / ROUNDING_SECONDS))
