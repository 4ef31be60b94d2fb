"""The flights of a log as a pilot counts them: from take-off to landing, with distance over ground and height."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from mavdem.assessment.flights import MIN_FLIGHT_SECONDS, flights_off_ground
from mavdem.dataset.grounded import without_grounded
from mavdem.dataset.intervals import TimeInterval, intersection
from mavdem.dataset.segments import recorded_spans
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, series_of_boot
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.witnesses.boot_sensors import BootSensors

MAX_HOP_SECONDS = 5.0
"""Time off the ground, s, below which a vehicle that stays low only hops; a choice: a flight takes longer to land."""

MAX_HOP_HEIGHT = 2.0
"""Height, m, below which so short a time off the ground is a hop; a choice.

Near the ground the air that propellers press down changes a barometer's height by one or two metres.
"""

PATH_STEP = 1.0
"""Time between two positions of the path whose length is the distance flown, s; a choice.

The noise of a position is some decimetres. With every sample of the position it would add metres to the path of a
hover each second.
"""

MAX_PATH_SPEED = 50.0
"""Ground speed, m/s, above which a step of the position is a reset of the estimator: no usual multirotor is so fast."""

MIN_KNOWN_FRACTION = 0.5
"""Fraction of a flight in which the estimator must report a position, so that a distance is known; a choice.

Without a position the vehicle may have flown anywhere, so that the rest is no distance of the flight.
"""


MAX_FLIGHT_SECONDS = 86_400.0
"""Longest time in the air, s: a battery lasts for hours at most, so after a day the clock has jumped."""


@dataclass(frozen=True)
class FlownFlight:
    """One flight of a log, from take-off to landing, as far as it was recorded."""

    boot: int
    """Number of the boot, from 0."""
    start: float
    """Take-off or the first record, s since boot."""
    end: float
    """Landing or the last record, s since boot."""
    distance: float | None
    """Length of the path over ground, m; None without a position for most of the flight, or if GPS never had a fix."""
    height: float | None
    """Largest height above the take-off, m; None if it was not recorded, or the log begins in the air."""

    @property
    def duration(self) -> float:
        """Duration, s."""
        return self.end - self.start


def flown_flights(signals: Signals) -> list[FlownFlight]:
    """Returns the flights of a multirotor's log, in order of boot and time, without hops (``MAX_HOP_SECONDS``).

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        The flights; none for another kind of vehicle, without a recorded attitude, or in boots in which sensors show
        that the vehicle did not fly.
    """
    return [flight for flight in flights_and_hops(signals) if not _is_hop(flight)]


def flights_and_hops(signals: Signals) -> list[FlownFlight]:
    """Returns the flights of a multirotor's log as :func:`flown_flights` does, and the hops between them.

    Each is a part of a recorded span (a piece of the log without a gap) in which the vehicle was in the air.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        Flights and hops in the order of time; empty for a vehicle that is not a multirotor.
    """
    if signals.telemetry.vehicle not in POSSIBLE_MULTIROTORS or not signals.tilts:
        return []
    boots_with_attitude = {int(boot) for boot in np.unique(signals.tilts[0].boot)}
    flights = []
    for span in recorded_spans(signals):
        if span.boot not in boots_with_attitude:
            continue
        for take_off, landing in flights_off_ground(signals, span.boot):
            # A land detector may report a landing as late as at disarming, or not at all after a crash.
            _, last_time_in_air = without_grounded([(take_off, landing)], signals, span.boot)[-1]
            in_air = (take_off, last_time_in_air)
            for start, end in intersection([(span.start, span.end)], [in_air]):
                if end - start < MIN_FLIGHT_SECONDS:
                    continue
                # If the recording begins in the air, the take-off is not known.
                recorded_take_off = None if start > take_off else take_off
                flights.append(_flight(signals, span.boot, recorded_take_off, (start, end)))
    return flights


def _is_hop(flight: FlownFlight) -> bool:
    """Returns whether a vehicle only hopped; False if its height is not known."""
    is_low = flight.height is not None and flight.height < MAX_HOP_HEIGHT
    return is_low and flight.duration < MAX_HOP_SECONDS


def total_time(flights: Sequence[FlownFlight]) -> float | None:
    """Returns the sum of the durations of flights, s; None without a flight, and if the clock jumped during one."""
    durations = [flight.duration for flight in flights]
    if not durations or max(durations) > MAX_FLIGHT_SECONDS:
        return None
    return sum(durations)


def total_distance(flights: Sequence[FlownFlight]) -> float | None:
    """Returns the sum of the distances of flights, m; None if none is known."""
    distances = [flight.distance for flight in flights if flight.distance is not None]
    return sum(distances) if distances else None


def largest_height(flights: Sequence[FlownFlight]) -> float | None:
    """Returns the largest height of any flight above its take-off, m; None if none is known."""
    return max((flight.height for flight in flights if flight.height is not None), default=None)


def _flight(
    signals: Signals, boot: int, take_off: float | None, interval: TimeInterval
) -> FlownFlight:
    """Measures the flown distance and the greatest height of one flight.

    Args:
        signals: logged time series of the vehicle.
        boot: number of the boot.
        take_off: time of the take-off, s since boot; None if it was before the record, so that its height is not known.
        interval: the recorded part of the flight, s since boot.

    Returns:
        The flight. Its distance over ground and height above the take-off, m, are None if they were not recorded, or
        the position had no fix.
    """
    sensors = BootSensors(signals, boot, -inf if take_off is None else take_off)
    greatest_height = None
    if take_off is not None and sensors.height_above_take_off is not None:
        heights = sensors.height_above_take_off.within(interval).values
        if len(heights):
            # The landing may be lower than the take-off, and a flight down a hill has no height above it.
            greatest_height = max(float(heights.max()), 0.0)
    distance = None
    position = series_of_boot(signals.position, boot)
    has_valid_position = _has_position(sensors.trust.position.validity, interval)
    is_fix_missing = sensors.trust.has_position_fix is False
    if position is not None and has_valid_position and not is_fix_missing:
        distance = _path_length(position.within(interval))
    start, end = interval
    return FlownFlight(int(boot), float(start), float(end), distance, greatest_height)


def _has_position(validity: TimeSeries | None, interval: TimeInterval) -> bool:
    """Returns whether the estimator reports a position for at least ``MIN_KNOWN_FRACTION`` of a flight.

    Args:
        validity: whether the estimator reports a position (N,), 1 or 0; None if the log does not say.
        interval: start and end of the flight, s since boot.
    """
    # Without any report the position is taken as known.
    if validity is None:
        return True
    reports = validity.within(interval).values
    return not len(reports) or reports.mean() >= MIN_KNOWN_FRACTION


def _path_length(position: TimeSeries) -> float | None:
    """Returns the length of a path over ground, m, by positions ``PATH_STEP`` apart; None with fewer than two.

    Args:
        position: positions (N, 3) of one boot, m north, east and down.
    """
    # An estimator without any source of a position reports its origin all the time.
    if not position.values[:, :2].any():
        return None
    # The first sample of each period of ``PATH_STEP`` is used, so that noise between samples adds no length.
    period_numbers = np.floor((position.time - position.time[0]) / PATH_STEP)
    _, first_samples = np.unique(period_numbers, return_index=True)
    if len(first_samples) < 2:
        return None
    north_and_east = position.values[first_samples, :2]
    north_steps, east_steps = np.diff(north_and_east, axis=0).T
    lengths = np.hypot(north_steps, east_steps)
    durations = np.diff(position.time[first_samples])
    # A faster step is a jump of the estimate.
    is_flown = lengths <= MAX_PATH_SPEED * durations
    return float(lengths[is_flown].sum())
