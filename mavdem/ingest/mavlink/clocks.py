"""The boot clock: one time axis for everything a component sent, from the stamps inside its messages.

Stamps come as ``time_boot_ms`` (uint32 milliseconds), ``time_usec`` (uint32 microseconds in SERVO_OUTPUT_RAW, which
wraps every 71.6 minutes, uint64 elsewhere) and ``time_boot_us``. One message type is the reference. Its own stamps show
reboots and outliers; all other stamps are compared with it, which undoes their wraps and moves them to its epoch. A
``time_usec`` may also be UNIX time: a type whose stamps lie on another epoch is moved as a whole.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, median_filter

from mavdem.arrays import Flags
from mavdem.facts import Facts
from mavdem.facts.sources import Repair
from mavdem.ingest.telemetry import repair_facts

Times = NDArray[np.float64]
Rows = NDArray[np.int64]
Places = NDArray[np.integer]  # Places of messages in the stream, of any integer type
# Seconds from its neighbours, plus ten median steps, beyond which a stamp is an outlier
MAX_STAMP_DEVIATION = 5.0
MIN_RESET_STAMPS = 5
"""Stamps in a row that are all lower than those before after a reset of the clock; fewer are late arrivals."""


def deviates_from_median(values: Times, window: int, limit: float | Times) -> Flags:
    """Returns which values are over ``limit`` from the median of a ``window`` (odd) around them; ends are reflected."""
    if not len(values):
        return np.zeros(0, dtype=np.bool_)
    return abs(values - median_filter(values, window, mode="mirror")) > limit


def outliers(seconds: Times) -> Flags:
    """Returns which stamps are far from the median of the five around them.

    These are one or two messages, not a lasting change of the clock.
    """
    if len(seconds) < 3:
        return np.zeros(len(seconds), dtype=np.bool_)
    return deviates_from_median(
        seconds, 5, MAX_STAMP_DEVIATION + 10 * np.median(abs(np.diff(seconds)))
    )


REFERENCES = (
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "GLOBAL_POSITION_INT",
    "SYSTEM_TIME",
)
"""Stamped by the autopilot itself, often: the first of these that was sent is the reference."""
# Longest silence, s, across which a 32-bit reference clock counts as wrapped, not as restarted
MAX_WRAP_GAP = 60.0
MIN_RESET_STEP = 1.0  # Seconds by which a clock falls when it was reset; less is reordering
# Median offset, s, of a type's stamps from the reference above which they are of another clock
OTHER_EPOCH = 10.0


class Sent(NamedTuple):
    """The messages of one type: ``places`` (n,) in the stream, ascending, and their ``stamps`` (n,), if any.

    Stamps are in seconds, zero for none. ``period``, s, is where the counter wraps; infinite for 64-bit counters.
    """

    message: str
    places: Places
    stamps: Times | None = None
    period: float = np.inf


class PlacedStamps(NamedTuple):
    """``time`` (n,) s and ``boot`` (n,) of each message of one type."""

    time: Times
    boot: Rows


def boot_clock(sent: Sequence[Sent]) -> tuple[dict[str, PlacedStamps], Facts]:
    """Places each of a component's messages on its boot clock: those of each type by name, and the repairs.

    Messages before the first stamp have the first stamp; without any stamp all times are NaN.
    """
    placed = {
        kind.message: PlacedStamps(
            np.full(len(kind.places), np.nan), np.zeros(len(kind.places), dtype=np.int64)
        )
        for kind in sent
    }
    chosen = _reference(sent)
    if chosen is None:
        return placed, ()
    reference, repairs = _placed_alone(chosen, *_stamps(chosen))
    for kind in sent:
        places, seconds = _stamps(kind)
        own = reference
        if kind is not chosen and len(places):
            own, further = _placed_against(reference, kind, places, seconds)
            repairs += further
        if len(places) and len(own.places):
            # A message whose stamp was ignored repeats the last time of its type: that of another type would look like
            # a time at which it was sent.
            at = _last_at(own.places, places)
            rows = np.searchsorted(kind.places, places)
            placed[kind.message].time[rows] = own.time[at]
            placed[kind.message].boot[rows] = own.boot[at]
    _fill(sent, placed)
    return placed, repairs


class _Kept(NamedTuple):
    """Messages of one type on the boot clock, without outliers."""

    places: Places
    time: Times
    boot: Rows


def _stamps(kind: Sent) -> tuple[Places, Times]:
    """The places of the messages that have a stamp, and the stamps, s."""
    if kind.stamps is None:
        return kind.places[:0], np.empty(0)
    there = kind.stamps > 0
    return kind.places[there], kind.stamps[there]


def _reference(sent: Sequence[Sent]) -> Sent | None:
    stamped = {kind.message: kind for kind in sent if len(_stamps(kind)[0])}
    for message in REFERENCES:
        if message in stamped and len(_stamps(stamped[message])[0]) >= 3:
            return stamped[message]
    return max(
        stamped.values(),
        key=lambda kind: (np.isfinite(kind.period), len(_stamps(kind)[0])),
        default=None,
    )


def _last_at(places: Places, wanted: Places) -> Rows:
    """The row of the last of ``places`` at or before each wanted one, else the first."""
    return np.maximum(np.searchsorted(places, wanted, side="right") - 1, 0)


def _fill(sent: Sequence[Sent], placed: Mapping[str, PlacedStamps]) -> None:
    """Gives each message without a time that of the last message before it, of any type, or else the first time."""
    columns = [(kind.places, *placed[kind.message]) for kind in sent]
    places, time, boot = (np.concatenate(column) for column in zip(*columns, strict=True))
    stamped = np.flatnonzero(~np.isnan(time))
    stamped = stamped[np.argsort(places[stamped], kind="stable")]
    for own_places, own_time, own_boot in columns if len(stamped) else ():
        missing = np.isnan(own_time)
        last = stamped[_last_at(places[stamped], own_places[missing])]
        own_time[missing] = time[last]
        own_boot[missing] = boot[last]


def _placed_alone(kind: Sent, places: Places, raw: Times) -> tuple[_Kept, Facts]:
    """The reference, by its own stamps: without outliers, wraps undone, reboots counted."""
    outlier = outliers(raw)
    places = places[~outlier]
    raw = raw[~outlier]
    wraps = 1 + np.flatnonzero((np.diff(raw) < 0) & (np.diff(raw) + kind.period <= MAX_WRAP_GAP))
    turns = np.cumsum(np.bincount(wraps, minlength=len(raw)))
    time = raw + kind.period * turns if len(wraps) else raw
    reboots = _reboots(time)
    boot = np.cumsum(np.bincount(reboots, minlength=len(places)))
    if len(wraps):
        time = raw + kind.period * (turns - turns[np.concatenate([[0], reboots])][boot])
    ignored = np.count_nonzero(outlier)
    repairs = repair_facts(Repair.STAMPS_IGNORED, count=ignored, name=kind.message)
    if len(wraps):
        repairs += repair_facts(Repair.CLOCK_WRAPPED, name=kind.message, period=kind.period)
    if len(reboots):
        at = time[reboots[0] - 1]
        repairs += repair_facts(Repair.LOG_OF_SEVERAL_BOOTS, count=len(reboots), time=at)
    return _Kept(places, time, boot), repairs


def _reboots(time: Times) -> Rows:
    """Rows at which the clock restarted: it fell, and stays low."""
    ahead = maximum_filter1d(
        time, MIN_RESET_STAMPS, origin=-(MIN_RESET_STAMPS // 2), mode="nearest"
    )
    reboots = []
    peak = -np.inf
    if (ahead < np.maximum.accumulate(time) - MIN_RESET_STEP).any():
        for row, (now, highest_ahead) in enumerate(zip(time.tolist(), ahead.tolist(), strict=True)):
            if highest_ahead < peak - MIN_RESET_STEP:
                reboots.append(row)
                peak = now
            peak = max(peak, now)
    return np.array(reboots, dtype=np.int64)


def _placed_against(
    reference: _Kept, kind: Sent, places: Places, seconds: Times
) -> tuple[_Kept, Facts]:
    """Another type, compared with the reference's stamps before and after each of its messages."""
    time, off, boot = _read_against(reference, places, seconds, kind.period)
    first, last = np.searchsorted(places, reference.places[[0, -1]], side="right").tolist()
    typical = np.median(off[first:last] if first < last else off)
    repairs: Facts = ()
    if abs(typical) > OTHER_EPOCH:
        for number in np.unique(boot):
            of_boot = boot == number
            shift = np.median(off[of_boot])
            time[of_boot] -= shift
            off[of_boot] -= shift
        repairs += repair_facts(Repair.CLOCK_MOVED, name=kind.message, offset=typical)
    outlier = outliers(off)
    if abs(typical) <= OTHER_EPOCH and (abs(time - seconds)[~outlier] > kind.period / 2).any():
        repairs += repair_facts(Repair.CLOCK_WRAPPED, name=kind.message, period=kind.period)
    ignored = np.count_nonzero(outlier)
    repairs += repair_facts(Repair.STAMPS_IGNORED, count=ignored, name=kind.message)
    return _Kept(places[~outlier], time[~outlier], boot[~outlier]), repairs


def _read_against(
    reference: _Kept, places: Places, seconds: Times, period: float
) -> tuple[Times, Times, Rows]:
    """The time of each stamp, its offset from the interval of the reference's stamps around it, and its boot."""
    following = np.searchsorted(reference.places, places)
    before = np.maximum(following - 1, 0)
    after = np.minimum(following, len(reference.places) - 1)
    earlier = reference.time[before]
    later = reference.time[after]
    same_boot = reference.boot[before] == reference.boot[after]
    by_earlier = _unwrapped(seconds, period, earlier)
    by_later = _unwrapped(seconds, period, later)
    off_earlier = by_earlier - np.where(same_boot, np.clip(by_earlier, earlier, later), earlier)
    off_later = by_later - np.where(same_boot, np.clip(by_later, earlier, later), later)
    first = abs(off_earlier) <= abs(off_later)
    boot = np.where(first, reference.boot[before], reference.boot[after])
    return np.where(first, by_earlier, by_later), np.where(first, off_earlier, off_later), boot


def _unwrapped(seconds: Times, period: float, near: Times) -> Times:
    """Stamps plus whole periods, so that each is nearest to the time ``near`` for it."""
    return (
        seconds + period * np.round((near - seconds) / period) if np.isfinite(period) else seconds
    )
