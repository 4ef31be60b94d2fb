"""Which parts of a boot are settled flight: armed, off the ground, past the climb-out and before the landing."""

from __future__ import annotations

from math import isinf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.ingest import meaning
from mavdem.ingest.meaning import Attitude, Signal
from mavdem.intervals import ALWAYS, Interval, Intervals, both, where
from mavdem.telemetry import Telemetry

CARRYING = 0.2
"""Least share of the motors' range that holds a multirotor up; autopilots idle on the ground at 0.05 to 0.15."""

SETTLING = 5.0
"""Seconds after lift-off and before touch-down that are never settled.

Spool-up, ground effect and the estimator's first metres."""

STEADY_CLIMB = 0.25
"""m/s: climb-out and landing last while the vehicle rises or sinks faster. Autopilots land at 0.3 m/s and more."""

UPRIGHT = np.radians(60.0)
"""Tilt beyond which no hover model holds: half the thrust no longer carries, and Euler angles leave the body rates."""

AVERAGING = 2.0
"""Seconds over which vertical speed and collective are averaged, so that a gust does not end a climb."""


class Told(NamedTuple):
    """What tells the phases of all boots; each is None where nothing tells it.

    Found once for a log: to find it takes a pass over its messages, and a log may hold thousands of boots.

    Attributes:
        armed, in_air, climb_rate, collective: as in ``meaning``.
    """

    armed: Signal | None
    in_air: Signal | None
    climb_rate: Signal | None
    collective: Signal | None

    @classmethod
    def by(cls, telemetry: Telemetry) -> Told:
        """What a vehicle told."""
        signals = (meaning.armed, meaning.in_air, meaning.climb_rate, meaning.collective)
        return cls(*(signal(telemetry) for signal in signals))


def settled(told: Told, attitude: Attitude, other: Attitude, boot: int) -> Intervals:
    """Intervals of ``boot`` in settled flight, by what the autopilot says and, where it says nothing, by the motors.

    Args:
        told: of the whole log.
        attitude, other: the axis to learn and the other one: both must stay upright.
        boot: which.
    """
    flying = both(armed(told, boot), airborne(told, boot))
    climb = _of(told.climb_rate, boot)
    level = [stretch for flight in flying if (stretch := _between_transients(flight, climb)) is not None]
    return both(both(level, _upright(attitude, boot)), _upright(other, boot))


def armed(told: Told, boot: int) -> Intervals:
    """Intervals of ``boot`` when armed; always, when no heartbeat says."""
    return _true(_of(told.armed, boot))


def airborne(told: Told, boot: int) -> Intervals:
    """Intervals of ``boot`` off the ground: EXTENDED_SYS_STATE where it comes, otherwise by motors that carry."""
    said = _of(told.in_air, boot)
    if said is not None:
        return _true(said)
    working = _of(told.collective, boot)
    return [] if working is None else where(working.time, _average(working.time, working.values) > CARRYING)


def _between_transients(flight: Interval, climb: Signal | None) -> Interval | None:
    """The settled part of one flight; an end of the flight that was not seen has no transient to cut."""
    start, end = flight
    after, before = start + SETTLING, end - SETTLING
    if climb is not None:
        speed = _average(climb.time, climb.values)
        inside = (climb.time >= after) & (climb.time <= before)
        if not isinf(start):
            level = climb.time[inside & (speed < STEADY_CLIMB)]
            after = float(level[0]) if len(level) else before
        if not isinf(end):
            level = climb.time[inside & (speed > -STEADY_CLIMB)]
            before = float(level[-1]) if len(level) else after
    return (after, before) if after < before else None


def _upright(attitude: Attitude, boot: int) -> Intervals:
    here = attitude.boot == boot
    return where(attitude.time[here], np.abs(attitude.angle[here]) < UPRIGHT)


def _of(signal: Signal | None, boot: int) -> Signal | None:
    """The part of a signal in one boot; None when it has none there."""
    if signal is None or not np.any(signal.boot == boot):
        return None
    here = signal.boot == boot
    return Signal(signal.time[here], signal.boot[here], signal.values[here])


def _true(signal: Signal | None) -> Intervals:
    return ALWAYS if signal is None else where(signal.time, signal.values > 0)


def _average(time: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centred mean of the samples within half of ``AVERAGING`` on either side."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    first = np.searchsorted(time, time - AVERAGING / 2, side="left")
    after = np.searchsorted(time, time + AVERAGING / 2, side="right")
    mean: NDArray[np.float64] = (total[after] - total[first]) / (after - first)
    return mean
