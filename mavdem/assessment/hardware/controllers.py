"""Speed controllers (ESCs) over a flight, as a fact (a coded finding): speeds, currents, temperatures, error counts."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.instances import MAX_ERROR_RATE
from mavdem.dataset.speed_controllers import SpeedController, speed_controllers
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact, Level
from mavdem.facts.hardware import HardwareFact


def controllers_fact(evidence: Evidence) -> Fact | None:
    """Returns the fact about the speed controllers' measurements in flight: speeds, currents, temperatures and errors.

    The level is "unknown" unless all of them count errors. Then it is "watch" if one of them counted too many errors
    per second in a flight, and "good" otherwise (:func:`_errors_in_flight`).

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The fact; None without a flight, or if no controller reported a speed in it.
    """
    controllers = speed_controllers(evidence.signals)
    speeds = _in_flight(evidence, [controller.speed for controller in controllers])
    if not len(speeds):
        return None
    currents = _in_flight(evidence, [controller.current for controller in controllers])
    temperatures = _in_flight(evidence, [controller.temperature for controller in controllers])
    errors = None
    level = Level.UNKNOWN
    if all(controller.error_count is not None for controller in controllers):
        reported_errors = _errors_in_flight(evidence, controllers)
        errors = reported_errors.error_count
        level = reported_errors.level
    return Fact(
        HardwareFact.CONTROLLERS_MEASURED,
        level,
        count=len(controllers),
        rotation_least=speeds.min(),
        rotation=speeds.max(),
        current=currents.max() if len(currents) else None,
        temperature=temperatures.max() if len(temperatures) else None,
        errors=errors,
    )


def _in_flight(evidence: Evidence, series: list[TimeSeries | None]) -> Array:
    """Returns all samples in flight (N,) of several series, one after another."""
    return np.concatenate([np.zeros(0), *map(evidence.values_in_flight, series)])


class _ReportedErrors(NamedTuple):
    """The errors that all speed controllers of a vehicle report in flight."""

    error_count: int
    """Number of errors."""
    level: Level
    """Watch if one controller counted more than ``MAX_ERROR_RATE`` errors per second in a flight, otherwise good."""


def _errors_in_flight(
    evidence: Evidence, controllers: Sequence[SpeedController]
) -> _ReportedErrors:
    """Counts the errors that speed controllers report in flight, and judges their rate.

    Args:
        evidence: signals, events and measurements of the vehicle.
        controllers: speed controllers; each counts its errors.
    """
    error_count = 0
    level = Level.GOOD
    for controller in controllers:
        for count in evidence.in_flight(controller.error_count):
            # The difference is negative if the counter was reset in flight: then it shows no errors.
            new_errors = max(int(count.values[-1] - count.values[0]), 0)
            error_count += new_errors
            if new_errors > MAX_ERROR_RATE * np.ptp(count.time):
                level = Level.WATCH
    return _ReportedErrors(error_count, level)
