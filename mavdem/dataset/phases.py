"""Phases of a flight: when a vehicle is armed, airborne, held by the ground, or in settled flight.

Each phase is a set of intervals (``mavdem.dataset.intervals``) in seconds on the clock of one boot. Settled flight is
what models are learned from: airborne, upright, and neither in climb-out nor in landing.
"""

from collections.abc import Container
from itertools import pairwise
from math import inf, isinf

import numpy as np

from mavdem.arrays import Array, Flags
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
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.setpoints import Setpoint, held_setpoint
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.ingest.telemetry import Parameters
from mavdem.ingest.vocabulary import IN_AIR, OFF_GROUND, UNDEFINED_LANDED_STATE

AVERAGING_SECONDS = 2.0
"""Seconds over which vertical speed and collective are averaged, so that a gust does not end a climb; a choice."""

MAX_IDLE_COLLECTIVE = 0.15
"""Highest fraction of the range at which motors idle on the ground: the default of ArduPilot's MOT_SPIN_MIN."""

MIN_COLLECTIVE_ABOVE_IDLE = 0.05
"""Fraction of the range above idle that a multirotor needs at least to stay in the air; a choice."""

TRANSIENT_SECONDS = 5.0
"""Seconds after lift-off and before touch-down that are never settled flight.

They hold spool-up, ground effect and the first metres, in which the estimator still converges. A choice.
"""

MAX_LEVEL_FLIGHT_SPEED = 0.25
"""Vertical speed, m/s, above which climb-out lasts, and landing has begun: autopilots land at 0.3 m/s or more."""

MIN_CLIMB_SPEED = 1.0
"""Vertical speed, m/s, from which ``TRANSIENT_SECONDS`` or more of a flight are a climb or a descent; a choice."""

MAX_TILT = np.radians(60.0)
"""Roll or pitch, rad, beyond which no model of hover holds.

There half the thrust no longer carries the vehicle, and derivatives of Euler angles are no longer the body rates.
"""

MIN_CARRYING_RATIO = 0.7
"""Collective, relative to that in hover, below which no multirotor stays in the air.

It holds for motors whose thrust goes with the square of their command and for those whose thrust goes with the command.
"""

HELD_RATE_RATIO = 0.1
"""Body rates below this fraction of their RMS in hover: the vehicle does not rotate."""

MIN_ROTATING_SQUARE_RATIO = 0.1
"""Mean square of the body rates, relative to that in hover, from which the vehicle certainly rotates freely."""

HELD_MOTOR_DEVIATION = 0.5
"""Deviation of a motor from its mean in flight, relative to the collective in hover, that would rotate a free vehicle.

Together with body rates near zero it means that the ground holds the vehicle. In flight, a motor of a quadrotor that
lost half its thrust deviates by 0.3.
"""

HIGH_QUANTILE = 0.9
"""Quantile of collective and of body rates that stands for flight, in records that are partly from the ground."""

MIN_GROUND_SECONDS = 3.0
"""Seconds that signs of the ground must last, since motors are throttled for a moment in the air too; a choice."""

MIN_LIFT_OFF_SPEED = 0.1
"""Vertical speed, m/s, that every vehicle that leaves the ground exceeds, averaged over ``AVERAGING_SECONDS``."""

MAX_GROUND_HEIGHT = 1.0
"""Height, m, above the take-off at which a vehicle may stand on the ground: the error of height estimates."""

MAX_SETPOINT_DELAY = 1.0
"""Seconds by which an attitude may follow its setpoint: the response of the largest multirotors."""

MANUAL_THROTTLE_MODES = frozenset(
    {"Stabilize", "Acro", "Flip", "Drift", "Turtle", "Manual", "Stabilized"}
)
"""Modes of ArduPilot and PX4 in which the stick is the thrust, so that no estimate of the height is followed."""

MIN_SETPOINT_TILT = np.radians(10.0)
"""RMS, rad, of a setpoint of roll or pitch that a vehicle in the air must follow; a choice."""

MIN_FOLLOWED_RATIO = 1 / 3
"""RMS of the tilt relative to that of its setpoint, below which the ground holds the vehicle: in the air it is 0.8."""

MAX_REPORT_INTERVAL = 10.0
"""Longest time, s, between two reports of the landed state that they cover.

Autopilots send EXTENDED_SYS_STATE at 0.2 Hz and faster. In a longer gap the collective shows better what happened.
"""

SURFACE_VEHICLES = ("GROUND_ROVER", "SURFACE_BOAT", "SUBMARINE")
"""MAV_TYPEs of vehicles that never leave the ground or the water, whatever a land detector reports."""


@cached_per_vehicle()
def settled_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of settled flight in a boot.

    They are armed, in the air and upright, without what the ground holds, without climb-out and landing, and without
    long climbs and descents.

    Args:
        signals: Signals of the vehicle.
        boot: Number of the boot.

    Returns:
        The intervals; none if no attitude was recorded.
    """
    if signals.preset_settled_intervals is not None:
        return signals.preset_settled_intervals
    if not signals.tilts:
        return []
    climb_rate = series_of_boot(signals.climb_rate, boot)
    tilts = [tilt.angle_series.of_boot(boot) for tilt in signals.tilts]
    flights = without_grounded(_flights_in_air(signals, boot), signals, boot)
    # A vehicle that lies on its back has crashed.
    roll = tilts[0]
    flights = intersection(flights, true_intervals(roll.time, abs(roll.values) < np.pi / 2))
    intervals = []
    for flight in flights:
        level_part = without_transients(flight, climb_rate)
        if level_part is not None:
            intervals.append(level_part)
    if climb_rate is not None:
        intervals = _without_long_climbs(intervals, climb_rate)
    for tilt in tilts:
        intervals = intersection(intervals, true_intervals(tilt.time, abs(tilt.values) < MAX_TILT))
    return intervals


def _flights_in_air(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals in which a vehicle is armed and in the air, without reported take-offs and landings.

    If neither the landed state nor the vertical speed is known, the flight modes that land say when it lands.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.

    Returns:
        Intervals, s since boot.
    """
    flights = intersection(
        armed_intervals(signals, boot), landed_state_intervals(signals, boot, (IN_AIR,))
    )
    landing = series_of_boot(signals.landing, boot)
    climb_rate = series_of_boot(signals.climb_rate, boot)
    landed_state = series_of_boot(signals.landed_state, boot)
    if landing is not None and climb_rate is None and landed_state is None:
        flights = intersection(flights, true_intervals(landing.time, landing.values == 0))
    return flights


def without_transients(flight: Interval, climb_rate: TimeSeries | None) -> Interval | None:
    """Returns a flight without its climb-out and its landing.

    Both last ``TRANSIENT_SECONDS`` at least, and as long as the vehicle still rises, or already sinks, faster than
    ``MAX_LEVEL_FLIGHT_SPEED``. An infinite end of the flight was not recorded, and nothing is cut there.

    Args:
        flight: Start and end of the flight, s.
        climb_rate: Vertical speed, m/s upwards, of the same boot; None if it was not recorded.

    Returns:
        Start and end of the level part, s; None if nothing is left.
    """
    start, end = flight
    level_start = start + TRANSIENT_SECONDS
    level_end = end - TRANSIENT_SECONDS
    if climb_rate is not None:
        speed = moving_average(climb_rate)
        is_inside = (climb_rate.time >= level_start) & (climb_rate.time <= level_end)
        is_sinking = speed <= -MAX_LEVEL_FLIGHT_SPEED
        is_rising = speed >= MAX_LEVEL_FLIGHT_SPEED
        # A whole flight cannot only sink: there the estimate of the height has diverged, and says nothing.
        is_whole_flight = not (isinf(start) or isinf(end))
        has_diverged = is_whole_flight and not np.any(is_inside & ~is_sinking)
        if is_inside.any() and not has_diverged:
            if not isinf(start):
                level_times = climb_rate.time[is_inside & ~is_rising]
                level_start = float(level_times[0]) if len(level_times) else level_end
            if not isinf(end):
                level_times = climb_rate.time[is_inside & ~is_sinking]
                level_end = float(level_times[-1]) if len(level_times) else level_start
    return (level_start, level_end) if level_start < level_end else None


def _without_long_climbs(level: Intervals, climb_rate: TimeSeries) -> Intervals:
    """Removes climbs and descents of ``TRANSIENT_SECONDS`` or longer from level flight.

    Args:
        level: Intervals without climb-out and landing, s.
        climb_rate: Vertical speed, m/s upwards.

    Returns:
        The remaining intervals, s.
    """
    speed = moving_average(climb_rate)
    # If all level flight sinks, the estimate of the height has diverged.
    if not np.any(speed[in_intervals(climb_rate.time, level)] > -MAX_LEVEL_FLIGHT_SPEED):
        return level
    is_climbing = abs(speed) > MIN_CLIMB_SPEED
    climbs = intersection(level, true_intervals(climb_rate.time, is_climbing))
    long_climbs = [(start, end) for start, end in climbs if end - start >= TRANSIENT_SECONDS]
    return intersection(level, complement(long_climbs))


@cached_per_vehicle()
def free_flight_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of a boot in which the vehicle is armed, airborne and not held by the ground.

    For a vehicle that is not a multirotor they are the intervals in which it operates.

    Args:
        signals: Signals of the vehicle.
        boot: Number of the boot.

    Returns:
        Start and end of each interval, s since boot.
    """
    airborne = airborne_intervals(signals, boot)
    if signals.telemetry.vehicle not in POSSIBLE_MULTIROTORS:
        return airborne
    return without_grounded(airborne, signals, boot)


def airborne_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of a boot in which the vehicle is armed and off the ground, with take-off and landing.

    For a vehicle that is not a multirotor they are the intervals in which it operates.

    Args:
        signals: Signals of the vehicle.
        boot: Number of the boot.

    Returns:
        Start and end of each interval, s since boot.
    """
    if signals.telemetry.vehicle not in POSSIBLE_MULTIROTORS:
        return _operating_intervals(signals, boot)
    return intersection(
        armed_intervals(signals, boot), landed_state_intervals(signals, boot, OFF_GROUND)
    )


def _operating_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals in which a vehicle other than a multirotor operates: armed and, if reported, in the air.

    Its motor outputs do not show when it flies: a plane glides, and idles on the runway. So a surface vehicle operates
    while it is armed, and so does a vehicle whose landed state is not reported.

    Args:
        signals: Signals of the vehicle.
        boot: Number of the boot.

    Returns:
        The intervals, s; none if the log does not show when the vehicle was armed.
    """
    if series_of_boot(signals.armed, boot) is None:
        return []
    armed_spans = armed_intervals(signals, boot)
    reports = series_of_boot(signals.landed_state, boot)
    if reports is None or signals.telemetry.vehicle in SURFACE_VEHICLES:
        return armed_spans
    is_undefined = reports.values == UNDEFINED_LANDED_STATE
    if is_undefined.all():
        return armed_spans
    is_off_ground = np.isin(reports.values, OFF_GROUND) | is_undefined
    return intersection(armed_spans, true_intervals(reports.time, is_off_ground))


def armed_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of a boot in which the vehicle is armed; all times where no heartbeat was recorded."""
    armed_series = series_of_boot(signals.armed, boot)
    if armed_series is None:
        return [(-inf, inf)]
    return true_intervals(armed_series.time, armed_series.values > 0)


def mode_intervals(signals: Signals, boot: int, modes: Container[str]) -> Intervals:
    """Returns the intervals of a boot in which the vehicle is in one of several flight modes, by their names."""
    changes = [*signals.mode_changes(boot), (inf, "")]
    return [(start, end) for (start, name), (end, _) in pairwise(changes) if name in modes]


def landed_state_intervals(signals: Signals, boot: int, states: tuple[int, ...]) -> Intervals:
    """Finds the intervals of a boot in which the vehicle is in one of several landed states.

    The state is that of EXTENDED_SYS_STATE while it is reported. A report holds until the next one, but not across a
    gap longer than ``MAX_REPORT_INTERVAL``. At all other times the collective decides: if it is high enough to keep the
    vehicle in the air, the vehicle counts as in one of the states. If motor outputs are missing too, the last reported
    state holds, since a missing message is no landing.

    Args:
        signals: Signals of the vehicle.
        boot: Number of the boot.
        states: Numbers of MAV_LANDED_STATE, all of them states in the air.

    Returns:
        Start and end of the intervals, s. Without reports they are those of a high collective (mean output of all
        motors).
    """
    reports = series_of_boot(signals.landed_state, boot)
    collective = series_of_boot(signals.collective, boot)
    # Where the motors carry the vehicle, judged by the collective alone.
    intervals_by_collective: Intervals = []
    if collective is not None:
        min_collective = min_airborne_collective(signals.telemetry.parameters)
        intervals_by_collective = true_intervals(
            collective.time, moving_average(collective) > min_collective
        )
    if reports is None:
        return intervals_by_collective
    reported_intervals = true_intervals(reports.time, np.isin(reports.values, states))
    if collective is None:
        return true_intervals(reports.time, np.isin(_last_defined(reports.values), states))
    is_undefined = reports.values == UNDEFINED_LANDED_STATE
    is_gap = np.diff(reports.time) > MAX_REPORT_INTERVAL
    # The times at which a report holds: between two defined reports that are not too far apart. Elsewhere the
    # collective decides.
    covered_intervals = split_at_gaps(reports.time, is_gap | is_undefined[1:] | is_undefined[:-1])
    if covered_intervals and covered_intervals[0][0] == reports.time[0] <= collective.time[0]:
        # Nothing was recorded before the first report: its state holds there too.
        covered_intervals[0] = (-inf, covered_intervals[0][1])
    flights = union(
        intersection(reported_intervals, covered_intervals),
        intersection(intervals_by_collective, complement(covered_intervals)),
    )
    # If neither reports nor outputs come, the last report holds.
    uncovered_intervals = complement(union(covered_intervals, _with_samples_near(collective.time)))
    last_reported_intervals = true_intervals(
        reports.time, np.isin(_last_defined(reports.values), states)
    )
    held_intervals = intersection(last_reported_intervals, uncovered_intervals)
    return union(
        flights, [(start, end) for start, end in held_intervals if start < reports.time[-1]]
    )


def _with_samples_near(time: Array) -> Intervals:
    """Finds the intervals in which the last or the next sample is no farther than ``MAX_REPORT_INTERVAL``.

    Args:
        time: Stamps (N,) of the samples, s, ascending.

    Returns:
        Start and end of each interval, s.
    """
    recorded_spans = split_at_gaps(time, np.diff(time) > 2 * MAX_REPORT_INTERVAL)
    return [
        (start - MAX_REPORT_INTERVAL, end + MAX_REPORT_INTERVAL) for start, end in recorded_spans
    ]


def _last_defined(landed_states: Array) -> Array:
    """Returns for each of N landed states the last one before or at it that is defined; undefined before the first."""
    rows = np.arange(len(landed_states))
    last_rows = np.maximum.accumulate(np.where(landed_states == UNDEFINED_LANDED_STATE, 0, rows))
    return landed_states[last_rows]


def min_airborne_collective(parameters: Parameters) -> float:
    """Returns the least collective, as a fraction of the range, that keeps a multirotor in the air."""
    return parameters.get("MOT_SPIN_MIN", MAX_IDLE_COLLECTIVE) + MIN_COLLECTIVE_ABOVE_IDLE


def min_airborne_command(motors: MotorOutputs) -> float:
    """Returns the least command of a motor, as a fraction of its range, that is clearly above its idle."""
    return motors.scale.lower_stop + MIN_COLLECTIVE_ABOVE_IDLE


def max_collective(signals: Signals) -> float:
    """Returns the highest collective, the mean output of all motors, that a log shows for some time.

    It is the highest moving average over ``AVERAGING_SECONDS``, since a short peak lifts no vehicle.

    Args:
        signals: signals of the vehicle.

    Returns:
        The highest average of all boots, as a fraction of the range; 0 where the collective was not recorded.
    """
    collective = signals.collective
    if collective is None:
        return 0.0
    highest_of_boots = []
    for boot in np.unique(collective.boot):
        highest_of_boots.append(moving_average(collective.of_boot(boot)).max())
    return max(highest_of_boots)


def without_grounded(flights: Intervals, signals: Signals, boot: int) -> Intervals:
    """Returns the parts of flights in which the ground does not hold the vehicle, whatever the autopilot reports.

    Three parts are excluded: flights without any vertical speed; flights in which the vehicle never rose and did not
    follow its setpoints; and intervals of at least ``MIN_GROUND_SECONDS`` in which the motors show that the ground
    carries or holds it.

    Args:
        flights: Intervals of flight by the reports of the autopilot, s.
        signals: Signals of the vehicle.
        boot: Number of the boot that the intervals belong to.

    Returns:
        The remaining intervals, s.
    """
    climb_rate = series_of_boot(signals.climb_rate, boot)
    if climb_rate is not None:
        speed = TimeSeries(climb_rate.time, climb_rate.boot, abs(moving_average(climb_rate)))
        flights = [flight for flight in flights if _has_vertical_speed(flight, speed)]
    excluded_intervals = []
    for flight in flights:
        if _ignored_tilt_setpoints(signals, boot, flight):
            excluded_intervals.append(flight)
    for start, end in intersection(flights, grounded_intervals(signals, boot)):
        if end - start >= MIN_GROUND_SECONDS:
            excluded_intervals.append((start, end))
    return intersection(flights, complement(sorted(excluded_intervals)))


def _has_vertical_speed(flight: Interval, speed: TimeSeries) -> bool:
    """Returns whether the vertical speed shows that a flight left the ground, or was not recorded from its start.

    All speeds up to the end of the flight count, since a report of the take-off may come late.

    Args:
        flight: Start and end of the flight, s.
        speed: Averaged vertical speed without its sign, m/s.
    """
    start, end = flight
    if speed.time[0] > start:
        return True
    return bool(speed.values[speed.time <= end].max() >= MIN_LIFT_OFF_SPEED)


def has_risen(signals: Signals, boot: int, flight: Interval) -> bool | None:
    """Returns whether the vehicle was more than ``MAX_GROUND_HEIGHT`` above its take-off in a flight.

    Args:
        signals: Signals of the vehicle.
        boot: Number of the boot.
        flight: Start and end of the flight, s.

    Returns:
        Whether it rose; None if the height was not recorded.
    """
    height = height_above_take_off(signals, boot, flight)
    if height is None:
        return None
    is_in_flight = in_intervals(height.time, [flight])
    return bool((height.values[is_in_flight] > MAX_GROUND_HEIGHT).any())


def height_above_take_off(signals: Signals, boot: int, flight: Interval) -> TimeSeries | None:
    """Returns the height of a whole boot above the place where a flight began.

    If the flight began before the record, the first recorded height is the reference.

    Args:
        signals: Signals of the vehicle.
        boot: Number of the boot.
        flight: Start and end of the flight, s.

    Returns:
        The height (N,), m; None if it was not recorded.
    """
    height = series_of_boot(signals.height, boot)
    if height is None:
        return None
    start_height = np.interp(flight[0], height.time, height.values)
    return TimeSeries(height.time, height.boot, height.values - start_height)


def _ignored_tilt_setpoints(signals: Signals, boot: int, flight: Interval) -> bool:
    """Returns whether a vehicle was held: it never rose in a flight, and hardly tilted although setpoints asked it to.

    That is a vehicle on a test stand, or in somebody's hand. If no height shows whether it rose, it counts as free.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
        flight: start and end of the flight, s since boot.

    Returns:
        Whether it was held: it did not rise, and a large setpoint of roll or pitch was not followed.
    """
    if has_risen(signals, boot, flight) is not False:
        return False
    for axis, tilt in zip(TILT_AXES, signals.tilts, strict=False):
        boot_angle = tilt.angle_series.of_boot(boot)
        angle = boot_angle.select(in_intervals(boot_angle.time, [flight]))
        for setpoint in signals.for_axis(axis).setpoints:
            # Setpoints of body rates, in rad/s, tell nothing about the tilt that was asked for.
            is_of_angle = setpoint.unit == "rad"
            if is_of_angle and _is_not_followed(setpoint, boot, angle.time, angle.values):
                return True
    return False


def _is_not_followed(setpoint: Setpoint, boot: int, time: Array, angle: Array) -> bool:
    """Returns whether a setpoint asks for a large tilt, and the vehicle makes hardly any of it.

    Both are compared by their root mean squares (RMS), at the times when the setpoint is valid.

    Args:
        setpoint: Setpoint of the angle, rad.
        boot: Number of the boot.
        time: (N,) times of the angle, s since boot.
        angle: (N,) roll or pitch at these times, rad.

    Returns:
        Whether the RMS of the setpoint exceeds ``MIN_SETPOINT_TILT``, and that of the angle is below
        ``MIN_FOLLOWED_RATIO`` of it.
    """
    setpoint_squares = held_setpoint(setpoint, boot, time) ** 2
    is_finite = np.isfinite(setpoint_squares)
    if not is_finite.any():
        return False
    mean_square_setpoint = setpoint_squares[is_finite].mean()
    mean_square_angle = np.mean(angle[is_finite] ** 2)
    is_large = mean_square_setpoint > MIN_SETPOINT_TILT**2
    return bool(is_large and mean_square_angle < MIN_FOLLOWED_RATIO**2 * mean_square_setpoint)


@cached_per_vehicle()
def grounded_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of a boot in which the motors show that the ground carries or holds the vehicle.

    The ground carries the vehicle while the motors give much less thrust than in hover. The ground holds it while it
    does not rotate although some motor deviates so far from its mean in flight that it would rotate a free vehicle. The
    autopilot's reports decide only which part of the boot is taken for flight.

    Args:
        signals: Signals of the vehicle.
        boot: Number of the boot.

    Returns:
        The intervals, s; none if no motor outputs were recorded, or the vehicle did not fly.
    """
    collective = series_of_boot(signals.collective, boot)
    if collective is None:
        return []
    mean = moving_average(collective)
    # The autopilot's landed state comes first, since a powerful vehicle hovers below any fixed collective.
    is_flown = in_intervals(collective.time, landed_state_intervals(signals, boot, OFF_GROUND))
    if not is_flown.any():
        return []
    # Hover is the median collective in flight, without the times of less than half of the highest usual collective, in
    # which the vehicle stands or falls.
    is_carrying = mean > np.quantile(mean[is_flown], HIGH_QUANTILE) / 2
    hover_collective = float(np.median(mean[is_flown & is_carrying]))
    # The rotation is compared with the vehicle's own fastest rotation in flight.
    square_rates = _mean_square_tilt_rates(signals, boot, collective.time)
    flight_square_rate = np.quantile(square_rates[is_flown], HIGH_QUANTILE)
    is_rotating = is_flown & (square_rates >= MIN_ROTATING_SQUARE_RATIO * flight_square_rate)
    is_still = square_rates < HELD_RATE_RATIO**2 * flight_square_rate

    max_deviation = HELD_MOTOR_DEVIATION * hover_collective
    is_deviating = _motor_deviations(signals, boot, collective, is_rotating) > max_deviation
    is_carried = mean < MIN_CARRYING_RATIO * hover_collective
    return true_intervals(collective.time, is_carried | (is_still & is_deviating))


def _motor_deviations(
    signals: Signals, boot: int, collective: TimeSeries, is_rotating: Flags
) -> Array:
    """Returns how far the furthest motor deviates from its usual output while the vehicle rotates freely.

    The output of a motor is taken relative to the mean of all motors.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
        collective: (N,) mean of the outputs of all motors in a boot, as a share of their range.
        is_rotating: (N,) whether the vehicle flies and rotates.

    Returns:
        (N,) largest deviation of any motor, as a share of the range; 0 without motors.
    """
    largest_deviation = np.zeros(len(collective.time))
    if signals.motors is None:
        return largest_deviation
    mean = moving_average(collective)
    for fractions in signals.motors.range_fractions(boot).values.T:
        motor = TimeSeries(collective.time, collective.boot, fractions)
        relative_output = moving_average(motor) - mean
        usual_output = np.median(relative_output[is_rotating])
        deviation = abs(relative_output - usual_output)
        largest_deviation = np.fmax(largest_deviation, deviation)
    return largest_deviation


def _mean_square_tilt_rates(signals: Signals, boot: int, time: Array) -> Array:
    """Returns the speed at which roll and pitch change: the sum of the mean squares of their rates.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
        time: times in that boot (N,), s.

    Returns:
        Moving averages of the squared rates of both axes, added up (N,), (rad/s)²; interpolated to the times.
    """
    total = np.zeros(len(time))
    for tilt in signals.tilts:
        rate = tilt.rate_series.of_boot(boot)
        squares = TimeSeries(rate.time, rate.boot, rate.values**2)
        if len(squares.time):
            total += np.interp(time, squares.time, moving_average(squares))
    return total


def series_of_boot(series: TimeSeries | None, boot: int) -> TimeSeries | None:
    """Returns the samples of one boot; None if there are none."""
    if series is None:
        return None
    samples = series.of_boot(boot)
    return samples if len(samples.time) else None


def moving_average(series: TimeSeries) -> Array:
    """Returns the centred moving average of a series of one boot over ``AVERAGING_SECONDS``.

    Args:
        series: N samples (N,), whose stamps need not be uniform.

    Returns:
        (N,) the mean of all samples within half of ``AVERAGING_SECONDS`` of each stamp.
    """
    # The sum over a window is the difference of two cumulative sums.
    cumulative = np.concatenate([[0.0], np.cumsum(series.values)])
    first_row = np.searchsorted(series.time, series.time - AVERAGING_SECONDS / 2, side="left")
    row_after = np.searchsorted(series.time, series.time + AVERAGING_SECONDS / 2, side="right")
    return (cumulative[row_after] - cumulative[first_row]) / (row_after - first_row)
