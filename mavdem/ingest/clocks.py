"""The boot clock: one time axis for everything a component sent, from the stamps inside its messages.

Stamps come as ``time_boot_ms`` (uint32 milliseconds), ``time_usec`` (uint32 microseconds in SERVO_OUTPUT_RAW, which
wraps every 71.6 minutes, uint64 elsewhere) and ``time_boot_us``. One message type is the reference. Its own stamps tell
reboots from strays; all other stamps are read against it, which undoes their wraps and puts them on its epoch.

A ``time_usec`` may also be UNIX time: a type whose stamps lie on another epoch is moved as a whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Times = NDArray[np.float64]
Rows = NDArray[np.int64]

REFERENCES = ("ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "SYSTEM_TIME")
"""Stamped by the autopilot itself, often: the first of these that was sent is what the others are read against."""
FEWEST = 3
"""Stamps that make a message type fit to be the reference."""
STRAY = 5.0
"""Seconds off its neighbours, beside ten usual steps, that make a stamp of the reference a stray."""
WRAP_GAP = 60.0
"""Longest silence, s, across which a 32-bit reference clock is taken to have wrapped rather than started anew."""
STEP_BACK = 1.0
"""Seconds a clock must fall to have been reset; less is reordering."""
LASTING = 5
"""Stamps in a row that must all lie below those before, for a reset; fewer are late arrivals."""
BOOT_SLACK = 30.0
"""Seconds a clock may read after a reboot beyond those the receiver saw pass."""
OTHER_EPOCH = 10.0
"""Seconds between a type's stamps and the reference, in the median, that make it another clock."""


@dataclass(frozen=True, eq=False)
class Stamps:
    """The stamps of one message type: ``rows`` (n,) among the component's messages, ``seconds`` (n,), zero for none.

    ``period`` is where the counter wraps, s; infinite for 64-bit counters.
    """

    message: str
    rows: Rows
    seconds: Times
    period: float


@dataclass(frozen=True, eq=False)
class BootClock:
    """``time`` (N,) s and ``boot`` (N,) of each of a component's messages, and a sentence for each thing mended.

    Messages before the first stamp take the first stamp; without any stamp all times are NaN.
    """

    time: Times
    boot: Rows
    repairs: tuple[str, ...]


def boot_clock(stamps: Sequence[Stamps], received: Times) -> BootClock:
    """Places each of a component's messages on its boot clock.

    Args:
        stamps: those of every message type that has any.
        received: (N,) s, when each message was received by the receiver's clock; NaN where that is not known.
    """
    time, boot = np.full(len(received), np.nan), np.zeros(len(received), dtype=np.int64)
    stamps = [kind for kind in map(_without_zeros, stamps) if len(kind.rows)]
    if not stamps:
        return BootClock(time, boot, ())
    reference, repairs = _placed_alone(_reference(stamps), received)
    for kind in stamps:
        placed = reference
        if kind.message != reference.message:
            placed, repair = _placed_against(reference, kind)
            repairs += repair
        if len(placed.rows):
            # A message whose stamp was ignored repeats the last of its kind: between those of others it would pass for
            # one that was sent then.
            at = np.maximum(np.searchsorted(placed.rows, kind.rows, side="right") - 1, 0)
            time[kind.rows], boot[kind.rows] = placed.time[at], placed.boot[at]
    last = np.maximum.accumulate(np.where(np.isnan(time), -1, np.arange(len(time))))
    last[last < 0] = np.flatnonzero(~np.isnan(time))[0]
    return BootClock(time[last], boot[last], tuple(repairs))


@dataclass(frozen=True, eq=False)
class _Placed:
    """Messages of one type on the boot clock; strays are left out."""

    message: str
    rows: Rows
    time: Times
    boot: Rows


def _without_zeros(stamps: Stamps) -> Stamps:
    sent = stamps.seconds > 0
    return Stamps(stamps.message, stamps.rows[sent], stamps.seconds[sent], stamps.period)


def _reference(stamps: Sequence[Stamps]) -> Stamps:
    enough = {kind.message: kind for kind in stamps if len(kind.rows) >= FEWEST}
    for message in REFERENCES:
        if message in enough:
            return enough[message]
    return max(stamps, key=lambda kind: (np.isfinite(kind.period), len(kind.rows)))


def running_median(values: Times, window: int) -> Times:
    """The median of the ``window`` (odd) values around each; the ends are reflected."""
    around = np.pad(values, window // 2, mode="reflect")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(around, window), axis=1))


def _placed_alone(stamps: Stamps, received: Times) -> tuple[_Placed, list[str]]:
    """The reference, by its own stamps: strays out, wraps undone, reboots counted."""
    kept = ~_strays(stamps.seconds)
    rows, raw = stamps.rows[kept], stamps.seconds[kept]
    steps = np.diff(raw)
    wraps = np.concatenate([[False], (steps < 0) & (steps + stamps.period <= WRAP_GAP)])
    turns = np.cumsum(wraps)
    time = raw + turns * (stamps.period if wraps.any() else 0.0)
    reboots = _reboots(time, raw, received[rows])
    boot = np.zeros(len(rows), dtype=np.int64)
    boot[reboots] = 1
    boot = np.cumsum(boot)
    turns -= turns[np.concatenate([[0], reboots])][boot]
    time = raw + turns * (stamps.period if wraps.any() else 0.0)
    late = _before_lower(time, boot)
    repairs = _ignored(stamps.message, int(np.count_nonzero(~kept) + np.count_nonzero(late)))
    if wraps.any():
        repairs.append(f"The clock of {stamps.message} wraps every {stamps.period / 60:.1f} min; undone.")
    if len(reboots):
        at = time[reboots[0] - 1]
        times = "once," if len(reboots) == 1 else f"{len(reboots)} times, first"
        repairs.append(f"The vehicle rebooted {times} when its clock read {at:.1f} s.")
    return _Placed(stamps.message, rows[~late], time[~late], boot[~late]), repairs


def _strays(seconds: Times) -> NDArray[np.bool_]:
    """Stamps far off the median of the five around them: one or two odd messages, no lasting change of the clock."""
    if len(seconds) < FEWEST:
        return np.zeros(len(seconds), dtype=np.bool_)
    usual = float(np.median(np.abs(np.diff(seconds))))
    return np.asarray(np.abs(seconds - running_median(seconds, 5)) > STRAY + 10 * usual)


def _before_lower(time: Times, boot: Rows) -> NDArray[np.bool_]:
    """Stamps soon followed by one far lower in the same boot: the upper ones of a clock that jumps to and fro."""
    lower = np.zeros(len(time), dtype=np.bool_)
    for ahead in range(1, min(LASTING, len(time))):
        lower[:-ahead] |= (time[:-ahead] - time[ahead:] > STRAY) & (boot[:-ahead] == boot[ahead:])
    return lower


def _ignored(message: str, stamps: int) -> list[str]:
    return [f"{stamps} time stamps of {message} far off their neighbours were ignored."] if stamps else []


def _reboots(time: Times, raw: Times, received: Times) -> Rows:
    """Rows at which the clock started anew: it fell, stays down, and reads no more than has passed since."""
    ahead = np.lib.stride_tricks.sliding_window_view(np.pad(time, (0, LASTING - 1), mode="edge"), LASTING).max(axis=1)
    gaps = np.abs(np.diff(received, prepend=np.nan))
    passed = float(np.nansum(gaps))
    speed = max(float(np.clip(np.diff(time), 0, None).sum()) / passed, 1.0) if passed > 0 else 1.0
    most = np.where(gaps > 0, BOOT_SLACK + 2 * speed * gaps, BOOT_SLACK if passed > 0 else np.inf)
    possible = ((raw <= most) | np.isnan(gaps)).tolist()
    reboots, peak = [], -np.inf
    for row, (now, highest_ahead) in enumerate(zip(time.tolist(), ahead.tolist(), strict=True)):
        if highest_ahead < peak - STEP_BACK and possible[row]:
            reboots.append(row)
            peak = now
        peak = max(peak, now)
    return np.array(reboots, dtype=np.int64)


def _placed_against(reference: _Placed, stamps: Stamps) -> tuple[_Placed, list[str]]:
    """Another type, by the reference's stamps before and after each of its messages."""
    following = np.searchsorted(reference.rows, stamps.rows)
    before = np.maximum(following - 1, 0)
    after = np.minimum(following, len(reference.rows) - 1)
    earlier, later = reference.time[before], reference.time[after]
    same_boot = reference.boot[before] == reference.boot[after]
    by_earlier, by_later = _unwrapped(stamps, earlier), _unwrapped(stamps, later)
    off_earlier = by_earlier - np.where(same_boot, np.clip(by_earlier, earlier, later), earlier)
    off_later = by_later - np.where(same_boot, np.clip(by_later, earlier, later), later)
    first = np.abs(off_earlier) <= np.abs(off_later)
    time = np.where(first, by_earlier, by_later)
    off = np.where(first, off_earlier, off_later)
    boot = np.where(first, reference.boot[before], reference.boot[after])

    wrapped = np.isfinite(stamps.period) and bool((np.abs(time - stamps.seconds) > stamps.period / 2).any())
    inside = (following > 0) & (following < len(reference.rows))
    typical = float(np.median(off[inside] if inside.any() else off))
    repairs = []
    if abs(typical) > OTHER_EPOCH:
        for number in np.unique(boot):
            shift = np.median(off[boot == number])
            time[boot == number] -= shift
            off[boot == number] -= shift
        repairs.append(
            f"The time stamps of {stamps.message} are of another clock, {typical:.6g} s away; "
            "they were moved to the boot clock."
        )
    elif wrapped:
        repairs.append(f"The clock of {stamps.message} wraps every {stamps.period / 60:.1f} min; undone.")
    kept = ~_strays(off)
    repairs += _ignored(stamps.message, int(np.count_nonzero(~kept)))
    return _Placed(stamps.message, stamps.rows[kept], time[kept], boot[kept]), repairs


def _unwrapped(stamps: Stamps, near: Times) -> Times:
    """The stamps, whole periods added so that each lies nearest to the time given for it."""
    if not np.isfinite(stamps.period):
        return stamps.seconds
    return stamps.seconds + stamps.period * np.round((near - stamps.seconds) / stamps.period)
