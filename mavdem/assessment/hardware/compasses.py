"""How much the motors disturb the magnetic field at the compasses in flight, as a fact (a coded finding).

A change from the ground to the flight may also come from steel in the ground. What follows the motors' command, both
averaged over 2 s, comes from their currents.
"""

from dataclasses import replace

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.lights.estimator import MAX_FIELD_CHANGE
from mavdem.assessment.limits import Limits
from mavdem.assessment.magnetic_field import field_change, field_strengths
from mavdem.dataset.intervals import in_intervals
from mavdem.dataset.time_series import TimeSeries, moving_average
from mavdem.facts import Fact, Level
from mavdem.facts.hardware import HardwareFact
from mavdem.witnesses.sensors import compass_fields, is_compass_used

FIELD_CHANGE_LIMITS = Limits(MAX_FIELD_CHANGE, 0.6)
"""Changes of the field, as fractions of it, when the throttle is raised: acceptable below the first, really bad above
the second (https://ardupilot.org/copter/docs/common-diagnosing-problems-using-logs.html, "Compass interference")."""

MIN_SECONDS = 20.0
"""Length of flight, s, from which on a correlation is stated: ten averages of 2 s, of which chance alone correlates one
in twenty by more than 0.63."""


def field_fact(evidence: Evidence) -> Fact | None:
    """Returns the fact about the magnetic field that changed most in flight among the fields at the compasses in use.

    The change of its strength from the ground to the flight decides the level, which is "unknown" if the ground was not
    recorded.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        A fact with the strength of the field, mGauss, its relative change, and its correlation with the motors; None if
        no compass in use was recorded in flight.
    """
    facts = []
    for number, field in compass_fields(evidence.signals).items():
        in_flight = evidence.values_in_flight(field)
        # The use of a compass may be unknown (None). Only one that is certainly not used is left out.
        if not len(in_flight) or is_compass_used(evidence.signals.telemetry, number) is False:
            continue
        change = field_change(evidence, field)
        level = Level.UNKNOWN if change is None else FIELD_CHANGE_LIMITS.level(abs(change))
        facts.append(
            Fact(
                HardwareFact.FIELD_MEASURED,
                level,
                name=f"compass {number}",
                field=float(np.median(field_strengths(in_flight))),
                change=change,
                correlation=motor_correlation(evidence, field),
            )
        )
    return max(facts, key=lambda fact: abs(fact.figures["change"] or 0.0), default=None)


def motor_correlation(evidence: Evidence, field: TimeSeries) -> float | None:
    """Returns the correlation of the field's strength in flight with the mean command of the motors.

    Args:
        evidence: signals, events and measurements of the vehicle.
        field: magnetic field (N, 3) at a compass.

    Returns:
        The correlation, -1 to 1; None with less than ``MIN_SECONDS`` of flight, or if one of the two never changes.
    """
    history = evidence.time_history
    if history is None or history.motors is None or history.motors.outputs is None:
        return None
    outputs = history.motors.outputs
    mean_output = outputs.values.mean(axis=1)
    strengths: list[Array] = []
    commands: list[Array] = []
    seconds = 0.0
    # Only the outputs of one boot are used.
    outputs_interval = (float(outputs.time[0]), float(outputs.time[-1]))
    for flight in evidence.in_flight(field):
        has_outputs = in_intervals(flight.time, [outputs_interval])
        samples = flight.select(has_outputs & (flight.boot == history.segment.boot))
        if len(samples.time) < 2:
            continue
        strength = np.linalg.norm(samples.values, axis=1)
        command = np.interp(samples.time, outputs.time, mean_output)
        strengths.append(moving_average(replace(samples, values=strength)))
        commands.append(moving_average(replace(samples, values=command)))
        seconds += float(np.ptp(samples.time))
    if seconds < MIN_SECONDS:
        return None
    return _correlation(np.concatenate(strengths), np.concatenate(commands))


def _correlation(first_signal: Array, second_signal: Array) -> float | None:
    """Returns the correlation coefficient of two series (N,); None if one of them is constant."""
    if np.ptp(first_signal) == 0 or np.ptp(second_signal) == 0:
        return None
    return float(np.corrcoef(first_signal, second_signal)[0, 1])
