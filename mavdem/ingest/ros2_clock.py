"""The messages of one vehicle's ROS 2 topics on one clock.

PX4 stamps with its boot clock, or with the companion's UNIX time to which the bridge moves it; MAVROS with the latter.
Whatever it is, all topics share it: it may start anew, jump, or be missing from what other programs send.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest.clocks import Sent, boot_clock
from mavdem.ingest.strays import Places

SECOND = 1_000_000_000
UNIX = 10**9 * SECOND
"""Nanoseconds, the year 2001: no autopilot has been running for so long."""
SAME_FLIGHT = 30 * 86400 * SECOND
"""Nanoseconds: stamps farther from the others are not of the same recording."""


class Stamped(NamedTuple):
    """The messages of one topic: ``places`` (N,) in the recording, ascending, and their ``stamps`` (N,), ns."""

    places: Places
    stamps: NDArray[np.int64]
    period: float = np.inf
    """Seconds after which stamps wrap."""


class OnClock(NamedTuple):
    """``time`` (M,) s and ``boot`` (M,) of the messages of one topic that have a place on the clock, its ``rows``."""

    rows: NDArray[np.intp]
    time: NDArray[np.float64]
    boot: NDArray[np.int64]


def on_one_clock(topics: Mapping[str, Stamped]) -> tuple[dict[str, OnClock], tuple[str, ...]]:
    """The messages of each topic on the clock of all, and a sentence for each thing mended.

    UNIX time counts from a second before the first stamp: floats of seconds since 1970 do not tell a microsecond.
    """
    stamps = np.concatenate([topic.stamps for topic in topics.values()]) if topics else np.empty(0, dtype=np.int64)
    start, repairs = _start(stamps[stamps > 0])
    seconds = {name: (topic.stamps - start) / 1e9 for name, topic in topics.items()}
    usable = {name: (topic.stamps > 0) & (seconds[name] > 0) for name, topic in topics.items()}
    without = sum(int(np.count_nonzero(~some)) for some in usable.values())
    if without:
        repairs.append(f"{without} messages without a time stamp, or one of another clock, were left out.")
    # Receive times are not given: by them a companion's clock that was set back would be no new start.
    clock = boot_clock(
        [
            Sent(name, topic.places[usable[name]], seconds[name][usable[name]].copy, topic.period)
            for name, topic in topics.items()
            if usable[name].any()
        ],
        received=lambda places: np.full(len(places), np.nan),
    )
    placed = {}
    for name, on_clock in clock.placed.items():
        time, boot = on_clock.time, on_clock.boot.astype(np.int64)
        # A message whose stamp was ignored has the place of the one before.
        new = np.ones(len(time), dtype=np.bool_)
        new[1:] = (np.diff(time) != 0) | (np.diff(boot) != 0)
        placed[name] = OnClock(np.flatnonzero(usable[name])[new], time[new], boot[new])
    return placed, (*repairs, *clock.repairs)


def _start(stamps: NDArray[np.int64]) -> tuple[int, list[str]]:
    """What to count from, ns, and a sentence where that is not when the vehicle booted."""
    # The middle stamp itself: between those of two clocks, half of the messages each, there would be none near.
    middle = int(np.partition(stamps, len(stamps) // 2)[len(stamps) // 2]) if len(stamps) else 0
    if middle < UNIX:
        return 0, []
    first = int(stamps[np.abs(stamps - middle) < SAME_FLIGHT].min()) // SECOND - 1
    return first * SECOND, [f"The time stamps are UNIX time; here they count from {first} s."]
