"""Phases of a flight: when a vehicle flies freely, and when it is in settled flight, without climb-out and landing.

Each phase is a set of intervals (``mavdem.dataset.intervals``) in seconds on the clock of one boot. Settled flight is
what models are learned from: airborne, upright, and neither in climb-out nor in landing. When a vehicle is armed and
airborne is in ``flight_states``, when the ground holds it in ``grounded``.
"""

from math import isinf

import numpy as np

from mavdem.dataset.extreme_tilt import extreme_tilt_intervals
from mavdem.dataset.flight_states import airborne_intervals, armed_intervals, landed_state_intervals
from mavdem.dataset.grounded import mean_climb_rate, without_grounded
from mavdem.dataset.intervals import (
    Intervals,
    TimeInterval,
    complement,
    in_intervals,
    intersection,
    true_intervals,
)
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, series_of_boot
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.ingest.vocabulary import IN_AIR

TRANSIENT_SECONDS = 5.0
"""Seconds after lift-off and before touch-down that are never settled flight.

They hold spool-up, ground effect and the first metres, in which the estimator still converges. A choice.
"""

MAX_LEVEL_FLIGHT_SPEED = 0.25
"""Vertical speed, m/s, above which climb-out lasts, and landing has begun: autopilots land at 0.3 m/s or more."""

MIN_CLIMB_SPEED = 1.0
"""Vertical speed, m/s, from which ``TRANSIENT_SECONDS`` or more of a flight are a climb or a descent; a choice."""


@cached_per_vehicle()
def settled_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of settled flight in a boot.

    In settled flight the vehicle is armed, in the air, upright and not held by the ground. Climb-out, landing, long
    climbs and descents, and tumbles are left out.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The intervals; none if no attitude was recorded.
    """
    if signals.preset_settled_intervals is not None:
        return signals.preset_settled_intervals
    if not signals.tilts:
        return []
    climb_rate = mean_climb_rate(signals, boot)
    flights = without_grounded(_flights_in_air(signals, boot), signals, boot)
    # A vehicle that lies on its back has crashed.
    roll = signals.tilts[0].angle_series.of_boot(boot)
    flights = intersection(flights, true_intervals(roll.time, abs(roll.values) < np.pi / 2))
    intervals = []
    for flight in flights:
        level_part = without_transients(flight, climb_rate)
        if level_part is not None:
            intervals.append(level_part)
    if climb_rate is not None:
        intervals = _without_long_climbs(intervals, climb_rate)
    return intersection(intervals, complement(extreme_tilt_intervals(signals, boot)))


def _flights_in_air(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals in which a vehicle is armed and in the air, without reported take-offs and landings.

    If neither the landed state nor the vertical speed was recorded, the times in a flight mode that lands are left out.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        Intervals, s since boot.
    """
    armed = armed_intervals(signals, boot)
    in_air = landed_state_intervals(signals, boot, (IN_AIR,))
    flights = intersection(armed, in_air)
    climb_rate = series_of_boot(signals.climb_rate, boot)
    landed_state = series_of_boot(signals.landed_state, boot)
    # Whether the flight mode is one that lands, 1 or 0.
    landing_mode = series_of_boot(signals.landing, boot)
    if landing_mode is not None and climb_rate is None and landed_state is None:
        in_other_modes = true_intervals(landing_mode.time, landing_mode.values == 0)
        flights = intersection(flights, in_other_modes)
    return flights


def without_transients(
    flight_interval: TimeInterval, climb_rate: TimeSeries | None
) -> TimeInterval | None:
    """Cuts the climb-out and the landing off a flight, to leave level flight.

    The climb-out lasts ``TRANSIENT_SECONDS``, or longer while the vehicle still rises faster than
    ``MAX_LEVEL_FLIGHT_SPEED``; the landing likewise, while it sinks. An infinite start or end of the flight was not
    recorded, and nothing is cut there.

    Args:
        flight_interval: Start and end of the flight, s.
        climb_rate: Averaged vertical speed, m/s upwards, of the same boot; None if it was not recorded.

    Returns:
        Start and end of the level flight, s; None if no time remains.
    """
    start, end = flight_interval
    level_start = start + TRANSIENT_SECONDS
    level_end = end - TRANSIENT_SECONDS
    is_start_recorded = not isinf(start)
    is_end_recorded = not isinf(end)
    rates = None if climb_rate is None else climb_rate.within((level_start, level_end))
    if rates is not None and len(rates.time):
        is_rising = rates.values >= MAX_LEVEL_FLIGHT_SPEED
        is_sinking = rates.values <= -MAX_LEVEL_FLIGHT_SPEED
        # No vehicle sinks in a whole flight, from take-off to landing. If the climb rate shows that, the estimate of
        # the height has diverged, and its rate is not used.
        has_diverged = is_start_recorded and is_end_recorded and bool(is_sinking.all())
        if is_start_recorded and not has_diverged:
            times_without_rise = rates.time[~is_rising]
            level_start = float(times_without_rise[0]) if len(times_without_rise) else level_end
        if is_end_recorded and not has_diverged:
            times_without_sink = rates.time[~is_sinking]
            level_end = float(times_without_sink[-1]) if len(times_without_sink) else level_start
    if level_start >= level_end:
        return None
    return level_start, level_end


def _without_long_climbs(level_intervals: Intervals, climb_rate: TimeSeries) -> Intervals:
    """Removes climbs and descents of ``TRANSIENT_SECONDS`` or longer from level flight.

    Args:
        level_intervals: Intervals without climb-out and landing, s.
        climb_rate: Averaged vertical speed, m/s upwards.

    Returns:
        The remaining intervals, s.
    """
    speed = climb_rate.values
    # If the vehicle sinks in all level flight, the estimate of the height has diverged, and nothing is removed.
    if not np.any(speed[in_intervals(climb_rate.time, level_intervals)] > -MAX_LEVEL_FLIGHT_SPEED):
        return level_intervals
    is_climbing = abs(speed) > MIN_CLIMB_SPEED
    climbs = intersection(level_intervals, true_intervals(climb_rate.time, is_climbing))
    long_climbs = [(start, end) for start, end in climbs if end - start >= TRANSIENT_SECONDS]
    return intersection(level_intervals, complement(long_climbs))


@cached_per_vehicle()
def free_flight_intervals(signals: Signals, boot: int) -> Intervals:
    """Returns the intervals of a boot in which the vehicle is armed, airborne and not held by the ground.

    For a vehicle that is not a multirotor they are the intervals in which it operates.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        Start and end of each interval, s since boot.
    """
    airborne = airborne_intervals(signals, boot)
    if signals.telemetry.vehicle not in POSSIBLE_MULTIROTORS:
        return airborne
    return without_grounded(airborne, signals, boot)
