"""Steps of a measured position or height that no multirotor flies: witnesses of a fault, whatever flags are set."""

from collections.abc import Iterator
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.gps_jumps import receiver_altitudes, receiver_positions
from mavdem.dataset.flight_states import SURFACE_VEHICLES
from mavdem.dataset.position_fix import RECEIVER_MESSAGES
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact
from mavdem.facts.estimator import EstimatorLight
from mavdem.witnesses.sensors import barometer_altitude

MAX_SPEED = 200.0
"""Speed, m/s, that no multirotor reaches: the fastest, built for the record, fly at 180 m/s."""

MIN_STEP = 300.0
"""Smallest distance, m, of an impossible step: a choice.

An estimate that is corrected after minutes without satellites, a height above a home that is moved in flight, and
reflections of satellite signals make smaller ones.
"""


class MeasuredPlace(StrEnum):
    """What measured a place, as sentences name it."""

    GPS = "GPS"
    GPS_ALTITUDE = "the altitude by GPS"
    ESTIMATED_POSITION = "the estimated position"
    ESTIMATED_HEIGHT = "the estimated height"
    BAROMETER = "the barometer's altitude"


class _Step(NamedTuple):
    """A change of a place from one sample to the next."""

    time: float
    """Time of the later sample, s since boot."""
    seconds: float
    """Time between the samples, s."""
    distance: float
    """Distance between them, m."""


def impossible_steps(evidence: Evidence) -> Iterator[Fact]:
    """Yields a fact for each measured place that steps in flight farther than any multirotor flies in that time.

    Vehicles that stay on the ground or below the water are not judged: their barometer may measure the water.

    Args:
        evidence: signals and flights of the vehicle.

    Yields:
        Facts on the largest step of each place in each flight: its time, s since boot, the ``place``, the ``distance``,
        m, and the time for it as ``duration``, s.
    """
    if evidence.signals.telemetry.vehicle in SURFACE_VEHICLES:
        return
    for place, samples in _measured_places(evidence):
        for flight in evidence.in_flight(samples):
            step = _largest_impossible_step(flight)
            if step is not None:
                yield Fact(
                    EstimatorLight.MOTION_IMPOSSIBLE,
                    time=step.time,
                    place=place,
                    distance=step.distance,
                    duration=step.seconds,
                )


def _measured_places(evidence: Evidence) -> Iterator[tuple[MeasuredPlace, TimeSeries | None]]:
    """Yields each measurement or estimate of where the vehicle was: position, height or altitude, with its samples.

    Args:
        evidence: signals of the vehicle.

    Yields:
        What the samples are of, and N samples in m: (N, 2) positions north and east, (N,) heights or altitudes; None
        for samples that were not recorded.
    """
    signals = evidence.signals
    for message in RECEIVER_MESSAGES:
        yield MeasuredPlace.GPS, receiver_positions(signals.telemetry, message)
        yield MeasuredPlace.GPS_ALTITUDE, receiver_altitudes(signals.telemetry, message)
    yield MeasuredPlace.ESTIMATED_POSITION, signals.position
    yield MeasuredPlace.ESTIMATED_HEIGHT, signals.height
    yield MeasuredPlace.BAROMETER, barometer_altitude(signals)


def _largest_impossible_step(flight: TimeSeries) -> _Step | None:
    """Returns the largest step from one sample to the next that is faster than ``MAX_SPEED``; None without one.

    A sample that was stamped late leaves little time to the next one, so that a usual movement would seem too fast. So
    no step counts as shorter than the median interval.

    Args:
        flight: samples (N,) or (N, k) of a position, height or altitude in one flight, m.
    """
    if len(flight.time) < 2:
        return None
    intervals = np.diff(flight.time)
    least_durations = np.maximum(intervals, np.median(intervals))
    distances = _distances_between_samples(flight.values)
    is_impossible = (distances > MIN_STEP) & (distances > MAX_SPEED * least_durations)
    if not is_impossible.any():
        return None
    largest = int(np.where(is_impossible, distances, 0.0).argmax())
    return _Step(
        time=float(flight.time[largest + 1]),
        seconds=float(intervals[largest]),
        distance=float(distances[largest]),
    )


def _distances_between_samples(values: Array) -> Array:
    """Returns the distance (N - 1,), m, between each two neighbouring samples of N places, (N,) or (N, k) in m."""
    places = values.reshape(len(values), -1)
    return np.asarray(np.linalg.norm(np.diff(places, axis=0), axis=1))
