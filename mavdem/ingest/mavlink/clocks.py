"""The boot clock: one time axis for everything a component sent, from the stamps inside its messages.

Stamps come as ``time_boot_ms`` (uint32 milliseconds), ``time_usec`` (uint32 microseconds in SERVO_OUTPUT_RAW, which
wraps every 71.6 minutes, uint64 elsewhere) and ``time_boot_us``. One message type is the reference. Its own stamps show
reboots and outliers; all other stamps are compared with it, which undoes their wraps and moves them to its epoch. A
``time_usec`` may also be UNIX time: a type whose stamps lie on another epoch is moved as a whole.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, median_filter

from mavdem.facts.sources import Repair
from mavdem.ingest.telemetry import Facts, Flags, repair

Times = NDArray[np.float64]
Rows = NDArray[np.int64]
Places = NDArray[np.integer]  # Places of messages in the stream, of any integer type
Boots = NDArray[np.unsignedinteger]  # Numbers of boots, in the smallest type that holds them
# Seconds from its neighbours, plus ten median steps, beyond which a stamp is an outlier
MAX_OFFSET = 5.0
MIN_RESET_STAMPS = 5
"""Stamps in a row that are all lower than those before after a reset of the clock; fewer are late arrivals."""


def far_off(values: Times, window: int, limit: float | Times) -> Flags:
    """Returns which values are over ``limit`` from the median of a ``window`` (odd) around them; ends are reflected."""
    if not len(values):
        return np.zeros(0, dtype=np.bool_)
    half = window // 2
    medians = median_filter(np.pad(values, half, mode="reflect"), window)[half : half + len(values)]
    return np.asarray(np.abs(values - medians) > limit)


def outliers(seconds: Times) -> Flags:
    """Stamps far from the median of the five around them: one or two messages, not a lasting change of the clock."""
    if len(seconds) < 3:
        return np.zeros(len(seconds), dtype=np.bool_)
    return far_off(seconds, 5, MAX_OFFSET + 10 * float(np.median(np.abs(np.diff(seconds)))))


def before_lower(time: Times, boot: Boots) -> Flags:
    """Stamps soon followed by a much lower one in the same boot: the upper ones of a clock that jumps up and down."""
    lower = np.zeros(len(time), dtype=np.bool_)
    for ahead in range(1, min(MIN_RESET_STAMPS, len(time))):
        lower[:-ahead] |= (time[:-ahead] - time[ahead:] > MAX_OFFSET) & (
            boot[:-ahead] == boot[ahead:]
        )
    return lower


def without(rows: Flags, *columns: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Returns the columns without these rows; not copied where there are none."""
    return tuple(column[~rows] for column in columns) if rows.any() else columns


REFERENCES = (
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "GLOBAL_POSITION_INT",
    "SYSTEM_TIME",
)
"""Stamped by the autopilot itself, often: the first of these that was sent is the reference."""
# Longest silence, s, across which a 32-bit reference clock counts as wrapped, not as restarted
WRAP_GAP = 60.0
STEP_BACK = 1.0  # Seconds by which a clock falls when it was reset; less is reordering
# Seconds that a clock may show after a reboot beyond the time that passed at the receiver
BOOT_SLACK = 30.0
# Seconds by which no clock runs ahead of the receiver's, or of the reference's stamps around it
AHEAD = 600.0
# Median offset, s, of a type's stamps from the reference above which they are of another clock
OTHER_EPOCH = 10.0
BATCH = 1 << 16  # Messages placed or sorted together: bounds the memory of intermediate arrays


class Sent(NamedTuple):
    """The messages of one type: ``places`` (n,) in the stream, ascending, and a function for their stamps, if any.

    ``stamps`` returns (n,) s, zero for none, in an array of its own. ``period``, s, is where the counter wraps;
    infinite for 64-bit counters.
    """

    message: str
    places: Places
    stamps: Callable[[], Times] | None = None
    period: float = np.inf


class PlacedStamps(NamedTuple):
    """``time`` (n,) s and ``boot`` (n,) of each message of one type."""

    time: Times
    boot: Boots


def boot_clock(
    sent: Sequence[Sent], received: Callable[[Places], Times] | None = None
) -> tuple[dict[str, PlacedStamps], Facts]:
    """Places each of a component's messages on its boot clock: those of each type by name, and the repairs.

    Messages before the first stamp have the first stamp; without any stamp all times are NaN. Stamps are read one type
    at a time: those of all types of a long log take much memory. ``received`` returns when the messages at the places
    (n,) were received, s of the receiver's clock; NaN where that is not known.
    """
    chosen = _reference(sent)
    if chosen is None:
        return {kind.message: _unplaced(kind, np.dtype(np.uint8)) for kind in sent}, ()
    places, seconds = _stamps(chosen)
    receive_times = np.full(len(places), np.nan) if received is None else received(places)
    reference, repairs = _placed_alone(chosen, places, seconds, receive_times)
    placed = {}
    for kind in sent:
        placed[kind.message] = _unplaced(kind, reference.boot.dtype)
        (places, seconds) = _stamps(kind)
        own = reference
        if kind is not chosen and len(places):
            own, further = _placed_against(reference, kind, places, seconds)
            repairs += further
        if len(places) and len(own.places):
            rows = _last_at(kind.places, places)
            # A message whose stamp was ignored repeats the last time of its type: that of another type would look like
            # a time at which it was sent.
            at = _last_at(own.places, places)
            placed[kind.message].time[rows] = own.time[at]
            placed[kind.message].boot[rows] = own.boot[at]
    _fill(sent, placed)
    return placed, repairs


class _Kept(NamedTuple):
    """Messages of one type on the boot clock, without outliers."""

    places: Places
    time: Times
    boot: Boots


def _stamps(kind: Sent) -> tuple[Places, Times]:
    """The places of the messages that have a stamp, and the stamps, s."""
    seconds = np.empty(0) if kind.stamps is None else kind.stamps()
    places = kind.places[: len(seconds)]
    there = seconds > 0
    if not there.all():
        places = places[there]
        seconds = seconds[there]
    return places, seconds


def _reference(sent: Sequence[Sent]) -> Sent | None:
    stamped = {kind.message: kind for kind in sent if kind.stamps is not None}
    for message in REFERENCES:
        if message in stamped and len(_stamps(stamped[message])[0]) >= 3:
            return stamped[message]
    counts = {message: len(_stamps(kind)[0]) for message, kind in stamped.items()}
    some = [kind for message, kind in stamped.items() if counts[message]]
    return max(
        some, key=lambda kind: (np.isfinite(kind.period), counts[kind.message]), default=None
    )


def _unplaced(kind: Sent, boot: np.dtype[Any]) -> PlacedStamps:
    return PlacedStamps(np.full(len(kind.places), np.nan), np.zeros(len(kind.places), dtype=boot))


def _last_at(places: Places, wanted: Places) -> Rows | slice:
    """The row of the last of ``places`` at or before each wanted one, else the first; one contains all of the other."""
    if len(places) == len(wanted):
        return slice(None)
    return np.asarray(np.maximum(np.searchsorted(places, wanted, side="right") - 1, 0))


def _fill(sent: Sequence[Sent], placed: Mapping[str, PlacedStamps]) -> None:
    """Gives each message without a time that of the last message before it, of any type, or else the first time."""
    kinds = [(kind.places, *placed[kind.message]) for kind in sent]
    known = [without(np.isnan(time), places, time, boot) for places, time, boot in kinds]
    known = [columns for columns in known if len(columns[0])]
    if not known:
        return
    first = min(known, key=lambda columns: int(columns[0][0]))
    for places, time, boot in kinds:
        missing = np.flatnonzero(np.isnan(time))
        wanted = places[missing]
        latest = np.full(len(missing), -1, dtype=np.int64)
        time[missing] = first[1][0]
        boot[missing] = first[2][0]
        for there, times, boots in known:
            row = np.searchsorted(there, wanted, side="right") - 1
            later = (row >= 0) & (there[row] > latest)
            latest[later] = there[row[later]]
            time[missing[later]] = times[row[later]]
            boot[missing[later]] = boots[row[later]]


def _placed_alone(kind: Sent, places: Places, raw: Times, received: Times) -> tuple[_Kept, Facts]:
    """The reference, by its own stamps: without outliers, wraps undone, reboots counted."""
    outlier = outliers(raw)
    outlier[~outlier] = _ahead(raw[~outlier], received[~outlier])
    places, raw, received = without(outlier, places, raw, received)
    wraps = 1 + np.flatnonzero((np.diff(raw) < 0) & (np.diff(raw) + kind.period <= WRAP_GAP))
    turns = np.zeros(len(raw), dtype=np.int64)
    turns[wraps] = 1
    turns = np.cumsum(turns)
    time = raw + kind.period * turns if len(wraps) else raw
    reboots = _reboots(time, raw, received)
    boot = np.zeros(len(places), dtype=np.min_scalar_type(len(reboots)))
    boot[reboots] = 1
    boot = np.cumsum(boot, dtype=boot.dtype)
    if len(wraps):
        time = raw + kind.period * (turns - turns[np.concatenate([[0], reboots])][boot])
    late = before_lower(time, boot)
    ignored = np.count_nonzero(outlier) + np.count_nonzero(late)
    repairs = repair(Repair.STAMPS_IGNORED, count=ignored, name=kind.message)
    if len(wraps):
        repairs += repair(Repair.CLOCK_WRAPPED, name=kind.message, period=kind.period)
    if len(reboots):
        at = time[reboots[0] - 1]
        repairs += repair(Repair.LOG_OF_SEVERAL_BOOTS, count=len(reboots), time=at)
    return _Kept(*without(late, places, time, boot)), repairs


def _ahead(raw: Times, received: Times) -> Flags:
    """Stamps far ahead of the last good one by the receiver's clock, which runs as fast: of damaged bytes, no wraps."""
    ahead = np.zeros(len(raw), dtype=np.bool_)
    good = 0
    steps = np.diff(raw)
    gaps = np.diff(received)
    jumps = steps > AHEAD + 2 * np.abs(gaps)
    passed, ran = (float(np.nansum(each[~jumps & (steps > 0)])) for each in (gaps, steps))
    for row in range(1, len(raw)) if jumps.any() and passed / 2 < ran < 2 * passed else ():
        ahead[row] = raw[row] - raw[good] > AHEAD + 2 * abs(received[row] - received[good])
        good = good if ahead[row] else row
    return ahead if 2 * np.count_nonzero(ahead) < len(ahead) else np.zeros_like(ahead)


def _reboots(time: Times, raw: Times, received: Times) -> Rows:
    """Rows at which the clock restarted: it fell, stays low, and shows no more than the time that has passed since."""
    ahead = maximum_filter1d(
        time, MIN_RESET_STAMPS, origin=-(MIN_RESET_STAMPS // 2), mode="nearest"
    )
    gaps = np.abs(np.diff(received, prepend=np.nan))
    passed = float(np.nansum(gaps))
    speed = max(float(np.clip(np.diff(time), 0, None).sum()) / passed, 1.0) if passed > 0 else 1.0
    most = np.where(gaps > 0, BOOT_SLACK + 2 * speed * gaps, BOOT_SLACK if passed > 0 else np.inf)
    possible = (raw <= most) | np.isnan(gaps)
    reboots = []
    peak = -np.inf
    if (ahead < np.maximum.accumulate(time) - STEP_BACK).any():
        rows = zip(time.tolist(), ahead.tolist(), possible.tolist(), strict=True)
        for row, (now, highest_ahead, may_be) in enumerate(rows):
            if highest_ahead < peak - STEP_BACK and may_be:
                reboots.append(row)
                peak = now
            peak = max(peak, now)
    return np.array(reboots, dtype=np.int64)


def _placed_against(
    reference: _Kept, kind: Sent, places: Places, seconds: Times
) -> tuple[_Kept, Facts]:
    """Another type, compared with the reference's stamps before and after each of its messages."""
    time, off, boot = _read_against(reference, places, seconds, kind.period)
    inside = slice(*np.searchsorted(places, reference.places[[0, -1]], side="right").tolist())
    typical = float(np.median(off[inside] if inside.start < inside.stop else off))
    repairs: Facts = ()
    if abs(typical) > OTHER_EPOCH:
        for number in np.unique(boot):
            of_boot = boot == number
            shift = np.median(off[of_boot])
            time[of_boot] -= shift
            off[of_boot] -= shift
        repairs += repair(Repair.CLOCK_MOVED, name=kind.message, offset=typical)
    outlier = outliers(off)
    near = slice(max(inside.start - MIN_RESET_STAMPS, 0), inside.stop + MIN_RESET_STAMPS)
    outlier[near] |= (np.abs(off[near]) > AHEAD) | (time[near] < 0)
    if abs(typical) <= OTHER_EPOCH and (np.abs(time - seconds)[~outlier] > kind.period / 2).any():
        repairs += repair(Repair.CLOCK_WRAPPED, name=kind.message, period=kind.period)
    ignored = np.count_nonzero(outlier)
    repairs += repair(Repair.STAMPS_IGNORED, count=ignored, name=kind.message)
    return _Kept(*without(outlier, places, time, boot)), repairs


def _read_against(
    reference: _Kept, places: Places, seconds: Times, period: float
) -> tuple[Times, Times, Boots]:
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
    first = np.abs(off_earlier) <= np.abs(off_later)
    boot = np.where(first, reference.boot[before], reference.boot[after])
    return np.where(first, by_earlier, by_later), np.where(first, off_earlier, off_later), boot


def _unwrapped(seconds: Times, period: float, near: Times) -> Times:
    """Stamps plus whole periods, so that each is nearest to the time ``near`` for it."""
    return (
        seconds + period * np.round((near - seconds) / period) if np.isfinite(period) else seconds
    )
