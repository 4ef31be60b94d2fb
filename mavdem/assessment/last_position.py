"""Where a lost flight was seen last: its last position by satellites, and how far that is from the take-off."""

from typing import NamedTuple

import numpy as np

from mavdem.assessment.flights import flights_in_boot
from mavdem.dataset.signals import Signals, plane_positions
from mavdem.dataset.time_series import TimeSeries, series_of_boot
from mavdem.facts import Fact
from mavdem.witnesses.ground_heights import satellite_position


class LastPosition(NamedTuple):
    """The last position of a flight that was lost, as a satellite receiver measured it."""

    latitude: float
    """Latitude, degrees north."""

    longitude: float
    """Longitude, degrees east."""

    altitude: float
    """Height above mean sea level, m."""

    time: float
    """When it was measured, s since boot."""

    distance: float
    """Horizontal distance from the take-off, m."""

    direction: float
    """Direction from the take-off, degrees clockwise from north."""


def last_position_of_loss(signals: Signals, ending: Fact | None) -> LastPosition | None:
    """Returns the last position of the flight that was lost.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        ending: the event with which the flight was lost, a fact (a coded finding) with its time and boot; None if no
            flight was lost.

    Returns:
        The last position before that flight ended; None if no flight was lost, or without satellites then.
    """
    if ending is None:
        return None
    positions = series_of_boot(satellite_position(signals), ending.figures["boot"])
    if positions is None:
        return None
    flown_positions = _positions_of_flight(signals, positions, ending.start_time)
    if not len(flown_positions.time):
        return None
    latitude, longitude, altitude = flown_positions.values[-1].tolist()
    [(north, east)] = plane_positions(
        flown_positions.values[-1:, :2], origin=flown_positions.values[0, :2]
    ).tolist()
    return LastPosition(
        latitude,
        longitude,
        altitude,
        time=float(flown_positions.time[-1]),
        distance=float(np.hypot(north, east)),
        direction=float(np.degrees(np.arctan2(east, north))) % 360,
    )


def _positions_of_flight(signals: Signals, positions: TimeSeries, time: float) -> TimeSeries:
    """Returns those positions that were measured in the flight that had begun last before a time.

    Args:
        signals: logged time series of the vehicle.
        positions: positions of one boot.
        time: time in or after that flight, s since boot.

    Returns:
        The positions from its take-off to its end; all of them if no flight had begun.
    """
    boot = int(positions.boot[0])
    flights_before = [flight for flight in flights_in_boot(signals, boot) if flight[0] <= time]
    if not flights_before:
        return positions
    take_off, end = flights_before[-1]
    # A loss may be noticed a moment after the vehicle was detected as landed.
    return positions.within((take_off, max(end, time)))
