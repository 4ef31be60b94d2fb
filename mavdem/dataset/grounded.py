"""Times in which the ground carries or holds a vehicle although it is reported in flight, by its motors and motion.

The autopilot's landed state may report flight all the same: on a test stand, in somebody's hand, or before take-off.
"""

from math import inf, nan

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.dataset.axes import TILT_AXES
from mavdem.dataset.extreme_tilt import extreme_tilt_intervals
from mavdem.dataset.flight_states import landed_state_intervals
from mavdem.dataset.intervals import (
    Intervals,
    TimeInterval,
    complement,
    in_intervals,
    intersection,
    true_intervals,
)
from mavdem.dataset.setpoints import Setpoint, held_setpoint
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import (
    TimeSeries,
    averaged_series,
    moving_average,
    series_of_boot,
)
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.ingest.vocabulary import OFF_GROUND

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
"""Quantile of collective and of body rates that is the value in flight, if records are partly from the ground."""

MIN_GROUND_SECONDS = 3.0
"""Seconds that signs of the ground must last, since motors are throttled for a moment in the air too; a choice."""

MIN_LIFT_OFF_SPEED = 0.1
"""Vertical speed, m/s, that every vehicle that leaves the ground exceeds, averaged over ``AVERAGING_SECONDS``."""

MAX_GROUND_HEIGHT = 1.0
"""Height, m, above the take-off at which a vehicle may stand on the ground: the error of height estimates."""

MAX_SETPOINT_DELAY = 1.0
"""Seconds by which an attitude may follow its setpoint: the response of the largest multirotors."""

MIN_SETPOINT_TILT = np.radians(10.0)
"""RMS, rad, of a setpoint of roll or pitch that a vehicle in the air must follow; a choice."""

SETPOINT_DELAY_STEP = 0.1
"""Step, s, of the delays up to ``MAX_SETPOINT_DELAY`` that are tried: shorter than any attitude takes to follow."""

MIN_FOLLOWED_GAIN = 1 / 3
"""Least-squares gain from setpoint to tilt, rad/rad, below which something holds the vehicle: in the air it is 0.8."""


def without_grounded(flights: Intervals, signals: Signals, boot: int) -> Intervals:
    """Removes the times in which the ground carries or holds the vehicle, although the autopilot reports a flight.

    A vehicle may be reported in flight while it stands with running motors, or is held by hand or a rope. Three things
    are removed:

    1. flights without any vertical speed;
    2. flights in which the vehicle never rose and did not follow its setpoints;
    3. within the other flights, intervals of at least ``MIN_GROUND_SECONDS`` in which the motors show that the ground
       carries or holds it.

    Args:
        flights: Intervals of flight by the reports of the autopilot, s.
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: Number of the boot that the intervals belong to.

    Returns:
        The remaining intervals, s.
    """
    climb_rate = mean_climb_rate(signals, boot)
    if climb_rate is not None:
        # Rule 1. Without a climb rate in the log it cannot be applied.
        flights = [flight for flight in flights if _has_vertical_speed(flight, climb_rate)]
    excluded_intervals = []
    # Rule 2.
    for flight in flights:
        if _was_held(signals, boot, flight):
            excluded_intervals.append(flight)
    # Rule 3.
    for start, end in intersection(flights, grounded_intervals(signals, boot)):
        if end - start >= MIN_GROUND_SECONDS:
            excluded_intervals.append((start, end))
    return intersection(flights, complement(sorted(excluded_intervals)))


@cached_per_vehicle()
def mean_climb_rate(signals: Signals, boot: int) -> TimeSeries | None:
    """Returns the vertical speed in a boot, m/s upwards, averaged over ``AVERAGING_SECONDS``.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The mean around each stamp (N,), m/s; None if the vertical speed was not recorded.
    """
    climb_rate = series_of_boot(signals.climb_rate, boot)
    return None if climb_rate is None else averaged_series(climb_rate)


def _has_vertical_speed(flight_interval: TimeInterval, climb_rate: TimeSeries) -> bool:
    """Returns whether the vertical speed confirms that a vehicle left the ground.

    All speeds up to the end of the flight count, since a report of the take-off may come late.

    Args:
        flight_interval: Start and end of the flight, s.
        climb_rate: Averaged vertical speed, m/s upwards.

    Returns:
        Whether it ever moved up or down fast enough; True also if the speed was not recorded from the start, so that it
        cannot contradict the flight.
    """
    start, end = flight_interval
    if climb_rate.time[0] > start:
        return True
    speeds = climb_rate.within((-inf, end)).values
    return bool(abs(speeds).max() >= MIN_LIFT_OFF_SPEED)


def has_risen(signals: Signals, boot: int, flight_interval: TimeInterval) -> bool | None:
    """Returns whether the vehicle was more than ``MAX_GROUND_HEIGHT`` above its take-off in a flight.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.
        flight_interval: Start and end of the flight, s.

    Returns:
        Whether it rose; None if the height was not recorded.
    """
    height = height_above_take_off(signals, boot, flight_interval)
    if height is None:
        return None
    return bool((height.within(flight_interval).values > MAX_GROUND_HEIGHT).any())


def height_above_take_off(
    signals: Signals, boot: int, flight_interval: TimeInterval
) -> TimeSeries | None:
    """Returns the height above the place where a flight began, for the whole time of a boot.

    If the flight began before the record, the first recorded height is the reference.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.
        flight_interval: Start and end of the flight, s.

    Returns:
        The height (N,), m; None if it was not recorded.
    """
    height = series_of_boot(signals.height, boot)
    if height is None:
        return None
    take_off_time, _ = flight_interval
    return TimeSeries(height.time, height.boot, height.values - height.value_at(take_off_time))


def _was_held(signals: Signals, boot: int, flight_interval: TimeInterval) -> bool:
    """Returns whether a vehicle was held in a flight, as on a test stand or in somebody's hand.

    It was held if it never rose, and did not follow a large setpoint of roll or pitch. If the height or the attitude
    was not recorded, it counts as free.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.
    """
    # None if the height was not recorded.
    rose = has_risen(signals, boot, flight_interval)
    if rose is None or rose:
        return False
    # Without a recorded attitude there are no tilts.
    for axis, tilt in zip(TILT_AXES, signals.tilts, strict=False):
        angle = tilt.angle_series.of_boot(boot).within(flight_interval)
        for setpoint in signals.for_axis(axis).setpoints:
            # Setpoints of body rates, in rad/s, do not state a tilt.
            is_of_angle = setpoint.unit == "rad"
            if is_of_angle and _is_not_followed(setpoint, boot, angle.time, angle.values):
                return True
    return False


def _is_not_followed(setpoint: Setpoint, boot: int, time: Array, angle: Array) -> bool:
    """Returns whether the setpoint of a tilt angle is large, and the measured angle hardly follows it.

    The setpoint is large by its root mean square (RMS). How far the angle follows is the gain of its least-squares fit
    by the setpoint, at the delay with the largest gain. Size alone would not show it: on uneven ground, or in
    somebody's hand, a vehicle leans and rocks whatever its setpoint is.

    Args:
        setpoint: Setpoint of the angle, rad.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.
        time: (N,) times of the angle, s since boot.
        angle: (N,) roll or pitch at these times, rad.

    Returns:
        Whether the RMS of the setpoint exceeds ``MIN_SETPOINT_TILT``, and the gain is below ``MIN_FOLLOWED_GAIN`` at
        all delays up to ``MAX_SETPOINT_DELAY``. False where the setpoint is never valid.
    """
    setpoint_values = held_setpoint(setpoint, boot, time)
    is_finite = np.isfinite(setpoint_values)
    if not is_finite.any():
        return False
    mean_square_setpoint = np.mean(setpoint_values[is_finite] ** 2)
    if mean_square_setpoint <= MIN_SETPOINT_TILT**2:
        return False
    gains = []
    for delay in np.arange(0.0, MAX_SETPOINT_DELAY + SETPOINT_DELAY_STEP / 2, SETPOINT_DELAY_STEP):
        gains.append(_gain_at_delay(setpoint, boot, time, angle, float(delay)))
    return max(gains) < MIN_FOLLOWED_GAIN


def _gain_at_delay(setpoint: Setpoint, boot: int, time: Array, angle: Array, delay: float) -> float:
    """Returns the gain with which a delayed setpoint fits an angle best, in the least-squares sense.

    Args:
        setpoint: Setpoint of the angle, rad.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.
        time: (N,) times of the angle, s since boot.
        angle: (N,) roll or pitch at these times, rad.
        delay: Time by which the setpoint is earlier than the angle, s.

    Returns:
        The gain, rad/rad; 0 where the delayed setpoint is never valid, or always 0.
    """
    delayed_setpoint = held_setpoint(setpoint, boot, time - delay)
    is_finite = np.isfinite(delayed_setpoint)
    sum_of_squares = np.sum(delayed_setpoint[is_finite] ** 2)
    if sum_of_squares == 0:
        return 0.0
    return float(np.sum(delayed_setpoint[is_finite] * angle[is_finite]) / sum_of_squares)


@cached_per_vehicle()
def grounded_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of a boot in which the motors show that the ground carries or holds the vehicle.

    The ground carries the vehicle while the motors give much less thrust than in hover. The ground holds it while it
    does not rotate although some motor deviates so far from its mean in flight that it would rotate a free vehicle. The
    autopilot's reports decide only which part of the boot is taken for flight.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The intervals, s; none if no motor outputs were recorded, or the vehicle did not fly.
    """
    collective = series_of_boot(signals.collective, boot)
    if collective is None:
        return []
    mean_collective = moving_average(collective)
    # The autopilot's landed state comes first, since a powerful vehicle hovers below any fixed collective. A tumble is
    # left out: it rotates so fast, and its motors differ so much, that a hover beside it would seem to be held.
    flights = intersection(
        landed_state_intervals(signals, boot, OFF_GROUND),
        complement(extreme_tilt_intervals(signals, boot)),
    )
    is_flown = in_intervals(collective.time, flights)
    if not is_flown.any():
        return []
    hover_collective = _hover_collective(mean_collective[is_flown])
    is_carried = mean_collective < MIN_CARRYING_RATIO * hover_collective
    is_held = _is_held_by_ground(signals, collective, is_flown, hover_collective)
    return true_intervals(collective.time, is_carried | is_held)


def _is_held_by_ground(
    signals: Signals, collective: TimeSeries, is_flown: Flags, hover_collective: float
) -> Flags:
    """Flags the times at which a vehicle does not rotate, although its motors differ enough to rotate a free one.

    It does not rotate if its rates are far below its fastest ones in flight. The motors differ enough if the output
    of one deviates far from what is usual for it while the vehicle rotates freely.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        collective: (N,) mean of the outputs of all motors in one boot, as a share of their range.
        is_flown: (N,) whether each of these times counts as flight; one at least.
        hover_collective: Mean output of all motors in hover, as a share of their range.

    Returns:
        Flags (N,).
    """
    boot = int(collective.boot[0])
    square_rates = _mean_square_tilt_rates(signals, boot, collective.time)
    # The rotation is judged relative to the fastest rotation of this vehicle in flight, a high quantile.
    fast_square_rate = np.quantile(square_rates[is_flown], HIGH_QUANTILE)
    is_rotating = is_flown & (square_rates >= MIN_ROTATING_SQUARE_RATIO * fast_square_rate)
    is_still = square_rates < HELD_RATE_RATIO**2 * fast_square_rate
    deviations = _motor_deviations(signals, boot, collective, is_rotating)
    return is_still & (deviations > HELD_MOTOR_DEVIATION * hover_collective)


def _hover_collective(collective: Array) -> float:
    """Returns the mean output of all motors with which a vehicle hovers: its median in flight.

    Times below half of a high quantile are left out, since the vehicle stands on the ground or falls then.

    Args:
        collective: (N,) mean output of all motors at the times that count as flight, as a share of their range.

    Returns:
        The output; NaN if the motors were off at all these times.
    """
    is_carrying = collective > np.quantile(collective, HIGH_QUANTILE) / 2
    if not is_carrying.any():
        return nan
    return float(np.median(collective[is_carrying]))


def _motor_deviations(
    signals: Signals, boot: int, collective: TimeSeries, is_rotating: Flags
) -> Array:
    """Returns the largest deviation of any motor from its usual output, at each time.

    Outputs are taken relative to the mean of all motors. The usual output of a motor is its median while the vehicle
    rotates freely.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        collective: (N,) mean of the outputs of all motors in a boot, as a share of their range.
        is_rotating: (N,) whether the vehicle flies and rotates.

    Returns:
        (N,) largest deviation of any motor, as a share of the range; 0 without motors.
    """
    largest_deviation = np.zeros(len(collective.time))
    if signals.motors is None:
        return largest_deviation
    mean_of_motors = moving_average(collective)
    for outputs_of_motor in signals.motors.range_fractions(boot).values.T:
        motor = TimeSeries(collective.time, collective.boot, outputs_of_motor)
        relative_output = moving_average(motor) - mean_of_motors
        usual_output = np.median(relative_output[is_rotating])
        deviation = abs(relative_output - usual_output)
        # ``fmax`` ignores a deviation of NaN.
        largest_deviation = np.fmax(largest_deviation, deviation)
    return largest_deviation


def _mean_square_tilt_rates(signals: Signals, boot: int, time: Array) -> Array:
    """Returns how fast roll and pitch change around each time: the sum of the mean squares of their rates.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        time: times in that boot (N,), s.

    Returns:
        Moving averages of the squared rates of both axes, added up (N,), (rad/s)²; interpolated to the times.
    """
    sum_of_mean_squares = np.zeros(len(time))
    for tilt in signals.tilts:
        rate = tilt.rate_series.of_boot(boot)
        squared_rate = TimeSeries(rate.time, rate.boot, rate.values**2)
        if len(squared_rate.time):
            sum_of_mean_squares += np.interp(time, squared_rate.time, moving_average(squared_rate))
    return sum_of_mean_squares
