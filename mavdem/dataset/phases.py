"""Flight phases: which parts of a boot are settled flight, between climb-out and landing, as sets of time intervals.

A set of intervals is a list of (start, end) pairs in seconds of one boot, sorted and disjoint; an end may be infinite.
"""

from collections.abc import Container
from itertools import pairwise
from math import inf, isinf

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import Interval
from mavdem.dataset.axes import TILT_AXES
from mavdem.dataset.intervals import (
    Intervals,
    complement,
    in_intervals,
    intersection,
    split_at_gaps,
    true_intervals,
    union,
)
from mavdem.dataset.signals import Signals, cached_per_vehicle, held_setpoint
from mavdem.dataset.time_series import TimeSeries
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import IN_AIR, OFF_GROUND

MAX_IDLE_COLLECTIVE = 0.15
MIN_COLLECTIVE_ABOVE_IDLE = 0.05
"""Highest share of the motors' range at which autopilots idle on the ground, ArduPilot's default for MOT_SPIN_MIN, and
how much more a multirotor needs at least to stay up."""
TRANSIENT_SECONDS = 5.0
"""Seconds after lift-off and before touch-down that are never settled. Spool-up, ground effect and the estimator's
first metres."""
MAX_LEVEL_FLIGHT_SPEED = 0.25
"""m/s: climb-out and landing last while the vehicle rises or sinks faster. Autopilots land at 0.3 m/s and more."""
# m/s, for ``TRANSIENT_SECONDS`` or longer: a climb or a descent in the midst of a flight
MIN_CLIMB_SPEED = 1.0
MAX_TILT = np.radians(60.0)
"""Tilt beyond which no hover model holds: half the thrust no longer carries, and Euler angles leave the body rates."""
MIN_CARRYING_RATIO = 0.7
"""Of the motors' mean in hover: with less, in the mean of 2 s, no multirotor stays up, be its thrust as the square of
its command or as the command."""
HELD_RATE_RATIO = 0.1
HELD_MOTOR_DEVIATION = 0.5
"""What the ground holds turns so little beside the flight, while some motor does so much more or less than in flight,
as a share of the hover's mean, that it would turn what nothing holds: of four, one that lost half its thrust does 0.3
more."""
MIN_GROUND_SECONDS = (
    3.0  # As long it lasts at least: motors are throttled for a moment in the air, too
)
MIN_LIFT_OFF_SPEED = 0.1  # m/s, averaged, of what leaves the ground
MAX_GROUND_HEIGHT = (
    1.0  # m above the take-off: what never rose above it stood, and what is no higher may stand
)
MAX_SETPOINT_DELAY = 1.0
"""As late a setpoint may be followed: the attitude loops of the largest multirotors take about a second."""
MIN_SETPOINT_TILT = np.radians(10.0)
MIN_FOLLOWED_RATIO = 1 / 3
"""Root mean squares, of what a flight was asked to lean and of what it did of that: free vehicles do 0.8 and more."""
MAX_REPORT_INTERVAL = 10.0
"""Longest time between two reports of EXTENDED_SYS_STATE that they cover: autopilots send it at 0.2 Hz and faster, and
what the vehicle did in a longer gap the other evidence shows better."""
AVERAGING_SECONDS = 2.0
"""Seconds over which vertical speed and collective are averaged, so that a gust does not end a climb."""


def min_airborne_collective(parameters: Parameters) -> float:
    """Returns the least share of the motors' range, 0 to 1, that holds a multirotor up."""
    return parameters.get("MOT_SPIN_MIN", MAX_IDLE_COLLECTIVE) + MIN_COLLECTIVE_ABOVE_IDLE


@cached_per_vehicle()
def settled_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of ``boot`` in settled flight, as the autopilot reports it or else as the motors show it.

    Neither take-off nor landing, where it reports them, nor what the ground holds; both axes must stay upright.
    """
    if signals.preset_settled_intervals is not None:
        return signals.preset_settled_intervals
    climb = series_of_boot(signals.climb_rate, boot)
    landing = series_of_boot(signals.landing, boot)
    flights = intersection(
        armed_intervals(signals, boot), landed_state_intervals(signals, boot, (IN_AIR,))
    )
    if landing is not None and climb is None and series_of_boot(signals.landed_state, boot) is None:
        flights = intersection(flights, true_intervals(landing.time, landing.values == 0))
    flights = without_grounded(flights, signals, boot)
    tilts = [tilt.angle_series.select(tilt.boot == boot) for tilt in signals.tilts]
    for tilt in tilts[:1]:  # what lies on its back has crashed
        flights = intersection(flights, true_intervals(tilt.time, abs(tilt.values) < np.pi / 2))
    level = [
        between for flight in flights if (between := without_transients(flight, climb)) is not None
    ]
    if climb is not None and np.any(
        (speed := moving_average(climb))[in_intervals(climb.time, level)] > -MAX_LEVEL_FLIGHT_SPEED
    ):
        climbs = intersection(level, true_intervals(climb.time, abs(speed) > MIN_CLIMB_SPEED))
        level = intersection(
            level, complement([part for part in climbs if part[1] - part[0] >= TRANSIENT_SECONDS])
        )
    for tilt in tilts:
        level = intersection(level, true_intervals(tilt.time, abs(tilt.values) < MAX_TILT))
    return level if tilts else []


def without_grounded(flights: Intervals, signals: Signals, boot: int) -> Intervals:
    """Returns the ``flights`` of ``boot`` that rose, without what the ground held for ``GROUND_SECONDS`` or longer."""
    if (climb := series_of_boot(signals.climb_rate, boot)) is not None:
        speed = abs(moving_average(climb))
        rose = (
            climb.time[0] > start or speed[climb.time <= end].max() >= MIN_LIFT_OFF_SPEED
            for start, end in flights
        )
        flights = [flight for flight, up in zip(flights, rose, strict=True) if up]
    stood = [flight for flight in flights if _ignored_tilt_setpoints(signals, boot, flight)]
    stood += [
        part
        for part in intersection(flights, grounded_intervals(signals, boot))
        if part[1] - part[0] >= MIN_GROUND_SECONDS
    ]
    return intersection(flights, complement(sorted(stood)))


def has_risen(signals: Signals, boot: int, flight: Interval) -> bool | None:
    """Returns whether a ``flight`` of ``boot`` rose by ``GROUND_HEIGHT``; None where its height was not recorded."""
    height = height_above_take_off(signals, boot, flight)
    if height is None:
        return None
    return bool((height.values[in_intervals(height.time, [flight])] > MAX_GROUND_HEIGHT).any())


def height_above_take_off(signals: Signals, boot: int, flight: Interval) -> TimeSeries | None:
    """Returns the heights above where a ``flight`` of ``boot`` began, m, or else the log; None without heights."""
    height = series_of_boot(signals.height, boot)
    if height is None:
        return None
    ground = np.interp(flight[0], height.time, height.values)
    return TimeSeries(height.time, height.boot, height.values - ground)


def _ignored_tilt_setpoints(signals: Signals, boot: int, flight: Interval) -> bool:
    """Whether a flight never rose, and hardly leaned although it was asked to."""
    if has_risen(signals, boot, flight) is not False:
        return False
    for axis, tilt in zip(TILT_AXES, signals.tilts, strict=False):
        here = (tilt.boot == boot) & in_intervals(tilt.time, [flight])
        for setpoint in signals.for_axis(axis).setpoints:
            squares = held_setpoint(setpoint, boot, tilt.time[here]) ** 2
            finite = np.isfinite(squares)
            if setpoint.unit != "rad" or not finite.any():
                continue
            asked = squares[finite].mean()
            leaned = np.mean(tilt.angle[here][finite] ** 2)
            if asked > MIN_SETPOINT_TILT**2 and leaned < MIN_FOLLOWED_RATIO**2 * asked:
                return True
    return False


@cached_per_vehicle()
def grounded_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns where the ground holds the vehicle, whatever is reported: its motors do much less than in hover.

    Or its attitude stands still while its motors fight what holds it.
    """
    collective = series_of_boot(signals.collective, boot)
    if collective is None:
        return []
    mean = moving_average(collective)
    # a powerful vehicle hovers below any threshold: the land detector goes before it
    running = in_intervals(collective.time, landed_state_intervals(signals, boot, OFF_GROUND))
    if not running.any():
        return []
    hover = np.median(mean[running & (mean > np.quantile(mean[running], 0.9) / 2)])
    squares = np.zeros(len(mean))
    for tilt in signals.tilts:
        turning = TimeSeries(tilt.time, tilt.boot, tilt.rate**2).select(tilt.boot == boot)
        if len(turning.time):
            squares += np.interp(collective.time, turning.time, moving_average(turning))
    lively = np.quantile(squares[running], 0.9)
    moving = running & (squares >= HELD_RATE_RATIO * lively)
    fighting = np.zeros(len(mean), dtype=bool)
    if signals.motors is not None:
        for share in signals.motors.range_fractions(boot).values.T:
            apart = moving_average(TimeSeries(collective.time, collective.boot, share)) - mean
            fighting |= abs(apart - np.median(apart[moving])) > HELD_MOTOR_DEVIATION * hover
    still = squares < HELD_RATE_RATIO**2 * lively
    return true_intervals(collective.time, (mean < MIN_CARRYING_RATIO * hover) | (still & fighting))


def airborne_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of ``boot`` when armed and off the ground."""
    return intersection(
        armed_intervals(signals, boot), landed_state_intervals(signals, boot, OFF_GROUND)
    )


@cached_per_vehicle()
def free_flight_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of ``boot`` when flying and not held by the ground."""
    return without_grounded(airborne_intervals(signals, boot), signals, boot)


def armed_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of ``boot`` when armed; always, where no heartbeat came."""
    state = series_of_boot(signals.armed, boot)
    return [(-inf, inf)] if state is None else true_intervals(state.time, state.values > 0)


def max_collective(signals: Signals) -> float:
    """Returns the highest share of their range at which the motors worked together, averaged."""
    collective = signals.collective
    if collective is None:
        return 0.0
    boots = np.unique(collective.boot)
    return max(moving_average(collective.select(collective.boot == boot)).max() for boot in boots)


def landed_state_intervals(signals: Signals, boot: int, states: tuple[int, ...]) -> Intervals:
    """Returns intervals of ``boot`` in one of MAV_LANDED_STATE's ``states``, in the air where only the thrust shows it.

    The states are those of EXTENDED_SYS_STATE while it comes. A report counts for the time up to the next, not for what
    came before all reports, nor across a long gap.
    """
    reported = series_of_boot(signals.landed_state, boot)
    collective = series_of_boot(signals.collective, boot)
    carried = []
    if collective is not None:
        carried = true_intervals(
            collective.time,
            moving_average(collective) > min_airborne_collective(signals.telemetry.parameters),
        )
    if reported is None:
        return carried
    undefined = reported.values == 0
    covered = split_at_gaps(
        reported.time,
        (np.diff(reported.time) > MAX_REPORT_INTERVAL) | undefined[1:] | undefined[:-1],
    )
    inside = true_intervals(reported.time, np.isin(reported.values, states))
    return (
        inside
        if collective is None
        else union(intersection(inside, covered), intersection(carried, complement(covered)))
    )


def mode_intervals(signals: Signals, boot: int, modes: Container[str]) -> Intervals:
    """Returns the intervals of ``boot`` in one of these flight ``modes``, by name."""
    changes = [*signals.mode_changes(boot), (inf, "")]
    return [(start, end) for (start, name), (end, _) in pairwise(changes) if name in modes]


def without_transients(flight: Interval, climb: TimeSeries | None) -> Interval | None:
    """Returns the settled part of one flight; an end of the flight that was not seen has no transient to cut."""
    start, end = flight
    after = start + TRANSIENT_SECONDS
    before = end - TRANSIENT_SECONDS
    if climb is not None:
        speed = moving_average(climb)
        inside = (climb.time >= after) & (climb.time <= before)
        # No whole flight only sinks: then the estimate has run away.
        if isinf(start) or isinf(end) or np.any(speed[inside] > -MAX_LEVEL_FLIGHT_SPEED):
            rising = climb.time[inside & (speed < MAX_LEVEL_FLIGHT_SPEED)]
            sinking = climb.time[inside & (speed > -MAX_LEVEL_FLIGHT_SPEED)]
            if inside.any() and not isinf(start):
                after = float(rising[0]) if len(rising) else before
            if inside.any() and not isinf(end):
                before = float(sinking[-1]) if len(sinking) else after
    return (after, before) if after < before else None


def series_of_boot(signal: TimeSeries | None, boot: int) -> TimeSeries | None:
    """Returns the samples of ``boot``; None where there are none."""
    if signal is None:
        return None
    here = signal.boot == boot
    return signal.select(here) if here.any() else None


def moving_average(signal: TimeSeries) -> Array:
    """Returns centred mean of the samples within half of ``AVERAGING_SECONDS`` on either side."""
    total = np.concatenate([[0.0], np.cumsum(signal.values)])
    first = np.searchsorted(signal.time, signal.time - AVERAGING_SECONDS / 2, side="left")
    after = np.searchsorted(signal.time, signal.time + AVERAGING_SECONDS / 2, side="right")
    return (total[after] - total[first]) / (after - first)
