"""Stamps in the messages of a component, those among them that are outliers, and readings of the boot clock."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from mavdem.arrays import Flags

Times = NDArray[np.float64]
"""Times or differences of times, s."""

Rows = NDArray[np.integer]
"""Row numbers, or numbers of boots."""

StreamPositions = NDArray[np.integer]
"""Where messages are in the stream: byte offsets or message numbers. Only their order matters."""

ReceiveTimes = Callable[[StreamPositions], Times]
"""A function that returns when the messages at some positions (n,) were received, s; NaN where that is not known."""

MAX_STAMP_DEVIATION = 5.0
"""Deviation of a stamp from those around it, s, beyond which it is an outlier; ten median steps are added to it.

A choice: delays within an autopilot and its link are shorter, and damaged stamps are wrong by more.
"""

OUTLIER_WINDOW = 5
"""Number of stamps around which the median is taken for finding outliers: up to two wrong ones do not move it."""

MAX_STEPS_OFF = 10
"""Number of median time steps by which a stamp may deviate beyond ``MAX_STAMP_DEVIATION``: for slow messages."""

MIN_REFERENCE_STAMPS = 3
"""Number of stamps that a message type needs at least for the outliers among them to be recognised."""


class MessageStamps(NamedTuple):
    """The n messages of one type that a component sent, and the stamps inside them."""

    message: str
    """Name of the message type."""
    positions: StreamPositions
    """Position of each message in the stream (n,), ascending."""
    stamps: Times | Callable[[], Times] | None = None
    """Stamp inside each message (n,), s, 0 where it has none, or a function that decodes them.

    None for a type without stamps.
    """
    period: float = np.inf
    """Time after which the counter of the stamps wraps, s; infinite for 64-bit counters."""

    def decoded_stamps(self) -> Times | None:
        """Returns the stamp inside each message (n,), s, 0 where it has none; None for a type without stamps."""
        return self.stamps() if callable(self.stamps) else self.stamps


class BootTimes(NamedTuple):
    """When the n messages of one type were sent, on the boot clock."""

    time: Times
    """Time since boot (n,), s."""
    boot: Rows
    """Number of the boot (n,), from 0."""


class ClockReadings(NamedTuple):
    """The stamped messages of one type on the boot clock, without outliers."""

    positions: StreamPositions
    """Position in the stream (m,), ascending."""
    time: Times
    """Time since boot (m,), s."""
    boot: Rows
    """Number of the boot (m,), from 0."""

    def select(self, rows: Rows | Flags | slice) -> "ClockReadings":
        """Returns some of the messages."""
        return ClockReadings(self.positions[rows], self.time[rows], self.boot[rows])

    def followed_by(self, later: "ClockReadings") -> "ClockReadings":
        """Returns these messages with later ones of the stream appended."""
        return ClockReadings(
            np.concatenate([self.positions, later.positions]),
            np.concatenate([self.time, later.time]),
            np.concatenate([self.boot, later.boot]),
        )


def deviates_from_median(values: Times, window: int, limit: float | Times) -> Flags:
    """Flags values that are far from the running median.

    Args:
        values: Values (n,).
        window: Number of values around each, odd, of which the median is taken; values are mirrored at the ends.
        limit: Largest deviation from the median that is not flagged, or one for each value (n,).

    Returns:
        Flags (n,).
    """
    if not len(values):
        return np.zeros(0, dtype=np.bool_)
    running_median = scipy.ndimage.median_filter(values, window, mode="mirror")
    return abs(values - running_median) > limit


def outlier_stamps(stamps: Times) -> Flags:
    """Flags stamps that are far from their neighbours in the stream, as damaged messages have them.

    Damage changes one or two messages at a time; a lasting change of the clock is not flagged.

    Args:
        stamps: Stamps (n,), s, in the order of the stream.

    Returns:
        Flags (n,); none is set where there are too few stamps to compare.
    """
    if len(stamps) < MIN_REFERENCE_STAMPS:
        return np.zeros(len(stamps), dtype=np.bool_)
    steps = np.diff(stamps)
    # A shortcut for stamps that only rise: the running median of ascending values is the value itself, except within
    # half a window of either end. There it deviates by at most the duration of that half window.
    half_window = OUTLIER_WINDOW // 2
    first_duration = stamps[half_window] - stamps[0]
    last_duration = stamps[-1] - stamps[-1 - half_window]
    is_ascending = steps.min() >= 0
    if is_ascending and max(first_duration, last_duration) <= MAX_STAMP_DEVIATION:
        return np.zeros(len(stamps), dtype=np.bool_)
    median_step = np.median(abs(steps))
    max_deviation = MAX_STAMP_DEVIATION + MAX_STEPS_OFF * median_step
    return deviates_from_median(stamps, OUTLIER_WINDOW, max_deviation)


def stamped_messages(message_type: MessageStamps) -> tuple[StreamPositions, Times]:
    """Returns the messages of a type that have a stamp; a stamp of 0 was not set.

    Args:
        message_type: The messages of the type. Its ``stamps`` are an array, a function that decodes them, or None for a
            type without stamps.

    Returns:
        Positions (m,) of these messages in the stream, and their stamps (m,), s.
    """
    stamps = message_type.decoded_stamps()
    if stamps is None:
        return message_type.positions[:0], np.empty(0)
    has_stamp = stamps > 0
    if has_stamp.all():
        # Without a selection the arrays are not copied.
        return message_type.positions, stamps
    return message_type.positions[has_stamp], stamps[has_stamp]


def last_rows_before(positions: StreamPositions, query: StreamPositions) -> Rows:
    """Returns the row of the last of ``positions`` at or before each queried one; 0 where all are after it."""
    return np.maximum(np.searchsorted(positions, query, side="right") - 1, 0)
