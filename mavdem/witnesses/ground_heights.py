"""Heights on the ground before a flight and after it: barometer and satellites, while the vehicle lies still.

An estimator follows its barometer, so that a barometer that drifts looks sound in flight. On the ground it shows: the
vehicle is back where it took off, and the barometer reads another height than before. The altitude by satellites tells
that apart from a landing place that is higher or lower. Alone it would not do: receivers of sound vehicles wander by
up to 9 m within 20 s, while their barometers agree within 1.3 m before and after a flight.
"""

from dataclasses import dataclass
from math import inf, isfinite
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.intervals import Intervals, TimeInterval, in_intervals, intersection
from mavdem.dataset.position_fix import RECEIVER_MESSAGES, has_fix_by_row
from mavdem.dataset.signals import Signals, global_positions, plane_positions
from mavdem.dataset.time_series import TimeSeries, clean_series, float_column, series_of_boot
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.ingest.vocabulary import MILLIMETRES_PER_METRE
from mavdem.witnesses.accelerometer import rest_intervals
from mavdem.witnesses.height import barometer_noise, is_usable_barometer
from mavdem.witnesses.sensors import barometer_altitude

MIN_REST_SECONDS = 1.0
"""Seconds that the vehicle must lie still before the flight, and after it: two windows of rest."""

MAX_REST_SECONDS = 10.0
"""Seconds of rest next to the flight that count: a barometer that lies for minutes in the sun drifts there, too."""

LANDING_SECONDS = 5.0
"""Seconds before the end of a flight from which on the vehicle may rest: autopilots report a landing late."""

MAX_WAIT_SECONDS = 30.0
"""Seconds before a take-off and after a landing within which the vehicle must rest, so that it is not another
flight's rest; a choice."""

MIN_SAMPLES = 2
"""Number of readings whose mean is used as a height: one second at 2 Hz."""


@dataclass(frozen=True)
class GroundHeights:
    """By how much heights changed from the rest before a flight to the rest after it."""

    barometer_change: float
    """Change of the barometer's height, m upwards."""
    barometer_scatter: float
    """Standard deviation of the barometer's readings at rest, m: the larger one of before and after."""
    frozen_since: float | None
    """Time, s since boot, from which on the barometer read the same to the rest after it; None if it did not."""
    satellite_change: float
    """Change of the altitude by satellites, m upwards."""
    distance: float
    """Horizontal distance, m, of landing and take-off by satellites."""


def ground_heights(
    signals: Signals, boot: int, flight_interval: TimeInterval, rests: Intervals | None = None
) -> GroundHeights | None:
    """Compares the heights at rest before a flight and after it, by barometer and satellites.

    The ground does not move. If the barometer shows another height after the flight and the satellites do not, the
    barometer drifted.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot; infinite if the record has no take-off or
            landing.
        rests: when the vehicle rested before and after the flight, s since boot; None to find that in the signals.

    Returns:
        The changes of height, m, from before to after, and the distance of the two places, m. None if the vehicle did
        not rest both times, the barometer is missing or not usable, or no satellite receiver had a fix both times.
    """
    barometer = series_of_boot(barometer_altitude(signals), boot)
    position = series_of_boot(satellite_position(signals), boot)
    if barometer is None or position is None or not is_usable_barometer(barometer_noise(barometer)):
        return None
    if rests is None:
        rests = rest_intervals(signals, boot)
    rest_before, rest_after = _rests_around(rests, flight_interval)
    if rest_before is None or rest_after is None:
        return None
    heights_before = _values_in(barometer, rest_before)
    heights_after = _values_in(barometer, rest_after)
    if min(len(heights_before), len(heights_after)) < MIN_SAMPLES:
        return None
    positions_before = _values_in(position, rest_before)
    positions_after = _values_in(position, rest_after)
    if not len(positions_before) or not len(positions_after):
        return None
    take_off_place = np.median(positions_before, axis=0)
    landing_place = np.median(positions_after, axis=0)
    _, _, altitude_change = landing_place - take_off_place
    return GroundHeights(
        barometer_change=float(heights_after.mean() - heights_before.mean()),
        barometer_scatter=float(max(heights_before.std(), heights_after.std())),
        frozen_since=_frozen_since(barometer, rest=rest_after),
        satellite_change=float(altitude_change),
        distance=horizontal_distance(take_off_place, landing_place),
    )


def _frozen_since(barometer: TimeSeries, rest: TimeInterval) -> float | None:
    """Returns since when a barometer is frozen: it reads the same height from some time in flight on.

    On the ground a coarse barometer reads the same height too. So it counts as frozen only if its equal readings begin
    more than ``LANDING_SECONDS`` before the rest.

    Args:
        barometer: heights (N,), m.
        rest: start and end of the rest after a flight, s since boot; the readings are examined until its end.

    Returns:
        Time of the first of the equal readings, s since boot; None if the barometer is not frozen.
    """
    rest_start, rest_end = rest
    is_before_end = barometer.time <= rest_end
    times = barometer.time[is_before_end]
    heights = barometer.values[is_before_end]
    last_height = heights[-1]
    different_readings = np.flatnonzero(heights != last_height)
    # The equal readings begin after the last different one, or with the record if there is none.
    first_equal_index = different_readings[-1] + 1 if len(different_readings) else 0
    first_equal_time = float(times[first_equal_index])
    if first_equal_time >= rest_start - LANDING_SECONDS:
        return None
    return first_equal_time


def horizontal_distance(start: Array, end: Array) -> float:
    """Returns the horizontal distance between two nearby places, in the plane that is tangent to the sphere there.

    Args:
        start, end: latitude and longitude, degrees (2,); further values, such as an altitude, are not used.

    Returns:
        The horizontal distance, m.
    """
    [displacement] = plane_positions(end[np.newaxis, :2], origin=start[:2])
    return float(np.hypot(*displacement))


@cached_per_vehicle()
def satellite_position(signals: Signals) -> TimeSeries | None:
    """Selects the positions of the first GPS receiver with fixes.

    A receiver whose altitude never changes does not measure one, and is passed over.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        (N, 3) latitude and longitude, degrees, and altitude, m; None if no receiver measured all three.
    """
    for message in RECEIVER_MESSAGES:
        columns = signals.telemetry.messages.get(message, {})
        if not all(field in columns for field in ("fix_type", "lat", "lon", "alt")):
            continue
        degrees, is_valid_position = global_positions(columns)
        altitude = float_column(columns, "alt") / MILLIMETRES_PER_METRE
        has_fix = has_fix_by_row(columns) & is_valid_position
        if has_fix.any() and np.ptp(altitude[has_fix]) > 0:
            return clean_series(columns, np.column_stack([degrees, altitude]), has_fix)
    return None


class _RestsAroundFlight(NamedTuple):
    """Times at rest on the ground next to a flight, s since boot; None for one that is missing."""

    before: TimeInterval | None
    """The last rest before the take-off."""

    after: TimeInterval | None
    """The first rest after the landing."""


def _rests_around(rests: Intervals, flight_interval: TimeInterval) -> _RestsAroundFlight:
    """Returns the last rest before a flight and the first one after it.

    Both must be near the flight (``MAX_WAIT_SECONDS``), and only the ``MAX_REST_SECONDS`` next to it are returned. If
    the landing was not recorded, any rest after the take-off is on the ground, since a vehicle rests only without
    power.

    Args:
        rests: intervals in which the vehicle lay still without power, ascending, s since boot.
        flight_interval: start and end, s since boot.

    Returns:
        Start and end of both rests, s since boot; None for one that is missing.
    """
    take_off, landing = flight_interval
    interval_before = (take_off - MAX_WAIT_SECONDS, take_off)
    if isfinite(landing):
        interval_after = (max(landing - LANDING_SECONDS, take_off), landing + MAX_WAIT_SECONDS)
    else:
        interval_after = (take_off + LANDING_SECONDS, inf)
    rests_before = _long_enough(intersection(rests, [interval_before]))
    rests_after = _long_enough(intersection(rests, [interval_after]))
    rest_before = None
    rest_after = None
    if rests_before:
        start, end = rests_before[-1]
        rest_before = max(start, end - MAX_REST_SECONDS), end
    if rests_after:
        start, end = rests_after[0]
        rest_after = start, min(end, start + MAX_REST_SECONDS)
    return _RestsAroundFlight(rest_before, rest_after)


def _long_enough(rests: Intervals) -> Intervals:
    """Returns the intervals of at least ``MIN_REST_SECONDS``."""
    return [(start, end) for start, end in rests if end - start >= MIN_REST_SECONDS]


def _values_in(series: TimeSeries, interval: TimeInterval) -> Array:
    """Returns the values of a series in an interval, s since boot."""
    return series.values[in_intervals(series.time, [interval])]
