"""Flight phases: which parts of a boot are settled flight, between climb-out and landing, as sets of time intervals.

A set of intervals is a list of (start, end) pairs in seconds of one boot, sorted and disjoint; an end may be infinite.
"""

from collections.abc import Container
from itertools import pairwise
from math import inf, isinf

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.confidence import Interval
from mavdem.dataset.drive import TILT_AXES, Signal
from mavdem.dataset.signals import Signals, held, once
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import IN_AIR, OFF_GROUND

Intervals = list[Interval]

IDLE_COLLECTIVE = 0.15
ABOVE_IDLE = 0.05
"""Highest share of the motors' range at which autopilots idle on the ground, ArduPilot's default for MOT_SPIN_MIN, and
how much more a multirotor needs at least to stay up."""
TRANSIENT_SECONDS = 5.0
"""Seconds after lift-off and before touch-down that are never settled. Spool-up, ground effect and the estimator's
first metres."""
CLIMB_OUT_SPEED = 0.25
"""m/s: climb-out and landing last while the vehicle rises or sinks faster. Autopilots land at 0.3 m/s and more."""
# m/s, for ``TRANSIENT_SECONDS`` or longer: a climb or a descent in the midst of a flight
CLIMB_SPEED = 1.0
MAX_TILT = np.radians(60.0)
"""Tilt beyond which no hover model holds: half the thrust no longer carries, and Euler angles leave the body rates."""
CARRYING_SHARE = 0.7
"""Of the motors' mean in hover: with less, in the mean of 2 s, no multirotor stays up, be its thrust as the square of
its command or as the command."""
STILL_SHARE = 0.1
FIGHTING_SHARE = 0.5
"""What the ground holds turns so little beside the flight, while some motor does so much more or less than in flight,
as a share of the hover's mean, that it would turn what nothing holds: of four, one that lost half its thrust does 0.3
more."""
GROUND_SECONDS = 3.0  # As long it lasts at least: motors are throttled for a moment in the air, too
LEAST_CLIMB = 0.1  # m/s, averaged, of what leaves the ground
GROUND_HEIGHT = (
    1.0  # m above the take-off: what never rose above it stood, and what is no higher may stand
)
ASKED_SECONDS = 1.0
"""As late a setpoint may be followed: the attitude loops of the largest multirotors take about a second."""
ASKED_LEAN = np.radians(10.0)
FOLLOWED_SHARE = 1 / 3
"""Root mean squares, of what a flight was asked to lean and of what it did of that: free vehicles do 0.8 and more."""
REPORT_SECONDS = 10.0
"""Longest time between two reports of EXTENDED_SYS_STATE that they cover: autopilots send it at 0.2 Hz and faster, and
what the vehicle did in a longer gap the other evidence shows better."""
AVERAGING_SECONDS = 2.0
"""Seconds over which vertical speed and collective are averaged, so that a gust does not end a climb."""


def where(time: Array, true: Flags) -> Intervals:
    """Returns from the first to the last stamp of each run of ``true`` (N,) at ``time`` (N,).

    A run that holds at the first or last stamp is taken to hold before or after it too, so only the changes that were
    seen bound an interval.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(np.int8)))
    runs = zip(edges[::2], edges[1::2], strict=True)
    return [
        (-inf if a == 0 else float(time[a]), inf if b == len(time) else float(time[b - 1]))
        for a, b in runs
    ]


def longest(time: Array, true: Flags) -> float:
    """Returns for how long, s, without a break ``true`` (N,) holds at ``time`` (N,)."""
    ends = np.clip(where(time, true), time[0], time[-1])
    return float(max((end - start for start, end in ends), default=0.0))


def unbroken(time: Array, broken: Flags) -> Intervals:
    """Returns the runs of ``time`` (N,) between the steps (N - 1,) that are ``broken``; none of a single stamp."""
    if not len(time):
        return []
    breaks = np.flatnonzero(broken)
    starts = time[np.append(0, breaks + 1)]
    ends = time[np.append(breaks, -1)]
    last = starts < ends
    return [*zip(starts[last].tolist(), ends[last].tolist(), strict=True)]


def both(a: Intervals, b: Intervals) -> Intervals:
    """Returns where ``a`` and ``b`` overlap."""
    overlaps = []
    i = 0
    j = 0
    while i < len(a) and j < len(b):
        start = max(a[i][0], b[j][0])
        end = min(a[i][1], b[j][1])
        if start < end:
            overlaps.append((start, end))
        if a[i][1] < b[j][1]:
            i += 1
        else:
            j += 1
    return overlaps


def either(a: Intervals, b: Intervals) -> Intervals:
    """Returns where ``a`` or ``b`` is; intervals that touch are joined."""
    return outside(both(outside(a), outside(b)))


def outside(intervals: Intervals) -> Intervals:
    """Returns everywhere else."""
    edges = [-inf, *(edge for interval in intervals for edge in interval), inf]
    return [(start, end) for start, end in zip(edges[::2], edges[1::2], strict=True) if start < end]


def total(intervals: Intervals) -> float:
    """Returns the seconds in all of them."""
    return sum(end - start for start, end in intervals)


def during(time: Array | float, intervals: Intervals) -> Flags:
    """Returns which stamps (N,) are in the intervals, or whether one is."""
    at = np.asarray(time)
    return np.any([(at >= start) & (at <= end) for start, end in [(inf, inf), *intervals]], axis=0)


def airborne_collective(parameters: Parameters) -> float:
    """Returns the least share of the motors' range, 0 to 1, that holds a multirotor up."""
    return parameters.get("MOT_SPIN_MIN", IDLE_COLLECTIVE) + ABOVE_IDLE


@once()
def settled(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of ``boot`` in settled flight, as the autopilot reports it or else as the motors show it.

    Neither take-off nor landing, where it reports them, nor what the ground holds; both axes must stay upright.
    """
    if signals.settled is not None:
        return signals.settled
    climb = of_boot(signals.climb_rate, boot)
    landing = of_boot(signals.landing, boot)
    flights = both(armed(signals, boot), in_states(signals, boot, (IN_AIR,)))
    if landing is not None and climb is None and of_boot(signals.landed_state, boot) is None:
        flights = both(flights, where(landing.time, landing.values == 0))
    flights = off_ground(flights, signals, boot)
    tilts = [tilt.angles.at(tilt.boot == boot) for tilt in signals.tilts]
    for tilt in tilts[:1]:  # what lies on its back has crashed
        flights = both(flights, where(tilt.time, abs(tilt.values) < np.pi / 2))
    level = [
        between for flight in flights if (between := between_transients(flight, climb)) is not None
    ]
    if climb is not None and np.any(
        (speed := average(climb))[during(climb.time, level)] > -CLIMB_OUT_SPEED
    ):
        climbs = both(level, where(climb.time, abs(speed) > CLIMB_SPEED))
        level = both(
            level, outside([part for part in climbs if part[1] - part[0] >= TRANSIENT_SECONDS])
        )
    for tilt in tilts:
        level = both(level, where(tilt.time, abs(tilt.values) < MAX_TILT))
    return level if tilts else []


def off_ground(flights: Intervals, signals: Signals, boot: int) -> Intervals:
    """Returns the ``flights`` of ``boot`` that rose, without what the ground held for ``GROUND_SECONDS`` or longer."""
    if (climb := of_boot(signals.climb_rate, boot)) is not None:
        speed = abs(average(climb))
        rose = (
            climb.time[0] > start or speed[climb.time <= end].max() >= LEAST_CLIMB
            for start, end in flights
        )
        flights = [flight for flight, up in zip(flights, rose, strict=True) if up]
    stood = [flight for flight in flights if _stood(signals, boot, flight)]
    stood += [
        part
        for part in both(flights, grounded(signals, boot))
        if part[1] - part[0] >= GROUND_SECONDS
    ]
    return both(flights, outside(sorted(stood)))


def rose(signals: Signals, boot: int, flight: Interval) -> bool | None:
    """Returns whether a ``flight`` of ``boot`` rose by ``GROUND_HEIGHT``; None where its height was not recorded."""
    height = above_take_off(signals, boot, flight)
    if height is None:
        return None
    return bool((height.values[during(height.time, [flight])] > GROUND_HEIGHT).any())


def above_take_off(signals: Signals, boot: int, flight: Interval) -> Signal | None:
    """Returns the heights above where a ``flight`` of ``boot`` began, m, or else the log; None without heights."""
    height = of_boot(signals.height, boot)
    if height is None:
        return None
    ground = np.interp(flight[0], height.time, height.values)
    return Signal(height.time, height.boot, height.values - ground)


def _stood(signals: Signals, boot: int, flight: Interval) -> bool:
    """Whether a flight never rose, and hardly leaned although it was asked to."""
    if rose(signals, boot, flight) is not False:
        return False
    for axis, tilt in zip(TILT_AXES, signals.tilts, strict=False):
        here = (tilt.boot == boot) & during(tilt.time, [flight])
        for setpoint in signals.about(axis).setpoints:
            squares = held(setpoint, boot, tilt.time[here]) ** 2
            finite = np.isfinite(squares)
            if setpoint.unit != "rad" or not finite.any():
                continue
            asked = squares[finite].mean()
            leaned = np.mean(tilt.angle[here][finite] ** 2)
            if asked > ASKED_LEAN**2 and leaned < FOLLOWED_SHARE**2 * asked:
                return True
    return False


@once()
def grounded(signals: Signals, boot: int) -> Intervals:
    """Returns where the ground holds the vehicle, whatever is reported: its motors do much less than in hover.

    Or its attitude stands still while its motors fight what holds it.
    """
    collective = of_boot(signals.collective, boot)
    if collective is None:
        return []
    mean = average(collective)
    # a powerful vehicle hovers below any threshold: the land detector goes before it
    running = during(collective.time, in_states(signals, boot, OFF_GROUND))
    if not running.any():
        return []
    hover = np.median(mean[running & (mean > np.quantile(mean[running], 0.9) / 2)])
    squares = np.zeros(len(mean))
    for tilt in signals.tilts:
        turning = Signal(tilt.time, tilt.boot, tilt.rate**2).at(tilt.boot == boot)
        if len(turning.time):
            squares += np.interp(collective.time, turning.time, average(turning))
    lively = np.quantile(squares[running], 0.9)
    moving = running & (squares >= STILL_SHARE * lively)
    fighting = np.zeros(len(mean), dtype=bool)
    if signals.motors is not None:
        for share in signals.motors.shares(boot).values.T:
            apart = average(Signal(collective.time, collective.boot, share)) - mean
            fighting |= abs(apart - np.median(apart[moving])) > FIGHTING_SHARE * hover
    still = squares < STILL_SHARE**2 * lively
    return where(collective.time, (mean < CARRYING_SHARE * hover) | (still & fighting))


def flying(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of ``boot`` when armed and off the ground."""
    return both(armed(signals, boot), in_states(signals, boot, OFF_GROUND))


@once()
def flown(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of ``boot`` when flying and not held by the ground."""
    return off_ground(flying(signals, boot), signals, boot)


def armed(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of ``boot`` when armed; always, where no heartbeat came."""
    state = of_boot(signals.armed, boot)
    return [(-inf, inf)] if state is None else where(state.time, state.values > 0)


def highest_collective(signals: Signals) -> float:
    """Returns the highest share of their range at which the motors worked together, averaged."""
    collective = signals.collective
    if collective is None:
        return 0.0
    boots = np.unique(collective.boot)
    return max(average(collective.at(collective.boot == boot)).max() for boot in boots)


def in_states(signals: Signals, boot: int, states: tuple[int, ...]) -> Intervals:
    """Returns intervals of ``boot`` in one of MAV_LANDED_STATE's ``states``, in the air where only the thrust shows it.

    The states are those of EXTENDED_SYS_STATE while it comes. A report counts for the time up to the next, not for what
    came before all reports, nor across a long gap.
    """
    reported = of_boot(signals.landed_state, boot)
    collective = of_boot(signals.collective, boot)
    carried = []
    if collective is not None:
        carried = where(
            collective.time, average(collective) > airborne_collective(signals.telemetry.parameters)
        )
    if reported is None:
        return carried
    undefined = reported.values == 0
    covered = unbroken(
        reported.time, (np.diff(reported.time) > REPORT_SECONDS) | undefined[1:] | undefined[:-1]
    )
    inside = where(reported.time, np.isin(reported.values, states))
    return (
        inside
        if collective is None
        else either(both(inside, covered), both(carried, outside(covered)))
    )


def in_modes(signals: Signals, boot: int, modes: Container[str]) -> Intervals:
    """Returns the intervals of ``boot`` in one of these flight ``modes``, by name."""
    changes = [*signals.modes(boot), (inf, "")]
    return [(start, end) for (start, name), (end, _) in pairwise(changes) if name in modes]


def between_transients(flight: Interval, climb: Signal | None) -> Interval | None:
    """Returns the settled part of one flight; an end of the flight that was not seen has no transient to cut."""
    start, end = flight
    after = start + TRANSIENT_SECONDS
    before = end - TRANSIENT_SECONDS
    if climb is not None:
        speed = average(climb)
        inside = (climb.time >= after) & (climb.time <= before)
        # No whole flight only sinks: then the estimate has run away.
        if isinf(start) or isinf(end) or np.any(speed[inside] > -CLIMB_OUT_SPEED):
            rising = climb.time[inside & (speed < CLIMB_OUT_SPEED)]
            sinking = climb.time[inside & (speed > -CLIMB_OUT_SPEED)]
            if inside.any() and not isinf(start):
                after = float(rising[0]) if len(rising) else before
            if inside.any() and not isinf(end):
                before = float(sinking[-1]) if len(sinking) else after
    return (after, before) if after < before else None


def of_boot(signal: Signal | None, boot: int) -> Signal | None:
    """Returns the samples of ``boot``; None where there are none."""
    if signal is None:
        return None
    here = signal.boot == boot
    return signal.at(here) if here.any() else None


def average(signal: Signal) -> Array:
    """Returns centred mean of the samples within half of ``AVERAGING_SECONDS`` on either side."""
    total = np.concatenate([[0.0], np.cumsum(signal.values)])
    first = np.searchsorted(signal.time, signal.time - AVERAGING_SECONDS / 2, side="left")
    after = np.searchsorted(signal.time, signal.time + AVERAGING_SECONDS / 2, side="right")
    return (total[after] - total[first]) / (after - first)
