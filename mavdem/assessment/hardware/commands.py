"""What commanded the vehicle, as facts (coded findings): setpoints of its position, sticks and switches that moved."""

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.commanded_swings import POSITION_TARGET_MESSAGE
from mavdem.assessment.evidence import Evidence
from mavdem.dataset.pilot_input import pilot_input
from mavdem.dataset.time_series import TimeSeries, recorded_series, series_of_boot
from mavdem.facts import Fact, Level, NamedFacts
from mavdem.facts.setpoints import CommandFact, CommandPart

POSITION_MESSAGE = "LOCAL_POSITION_NED"
"""Message with the estimates of position, x, y and z, m, and velocity, vx, vy and vz, m/s."""

MIN_STICK_CHANGE = {"%": 5.0, "µs": 50.0}
"""Change of a stick in flight, by its unit, from which on it moved: a choice well above the noise of receivers."""

MIN_SWITCH_CHANGE = 100.0
"""Change of a channel, µs, from which on its switch moved: those of three positions change by some 400."""


def command_facts(evidence: Evidence) -> NamedFacts:
    """Returns facts about what commanded the vehicle in flight: position setpoints, and the pilot's sticks.

    Neither is judged: how near a vehicle should keep to its position depends on gusts and on the flown course.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        Facts by "targets" and "sticks"; without the one that was not recorded in flight.
    """
    facts = {
        CommandPart.TARGETS: _targets_fact(evidence),
        CommandPart.STICKS: _sticks_fact(evidence),
    }
    return {str(source): fact for source, fact in facts.items() if fact is not None}


def _targets_fact(evidence: Evidence) -> Fact | None:
    """Returns the fact about how far the position was from its setpoint in flight.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The fact, with the RMS error ``horizontal`` and ``vertical``, m, None if that was not recorded. None without
        any setpoint of position or velocity in flight.
    """
    squared_errors = {axis: _squared_errors(evidence, axis) for axis in "xyz"}
    horizontal_rms = None
    if len(squared_errors["x"]) and len(squared_errors["y"]):
        mean_square = squared_errors["x"].mean() + squared_errors["y"].mean()
        horizontal_rms = float(np.sqrt(mean_square))
    vertical_rms = None
    if len(squared_errors["z"]):
        vertical_rms = float(np.sqrt(squared_errors["z"].mean()))
    has_position_setpoint = horizontal_rms is not None or vertical_rms is not None
    if not has_position_setpoint and not _has_velocity_setpoint(evidence):
        return None
    return Fact(
        CommandFact.TARGETS_FOLLOWED,
        Level.UNKNOWN,
        horizontal=horizontal_rms,
        vertical=vertical_rms,
    )


def _has_velocity_setpoint(evidence: Evidence) -> bool:
    """Returns whether a setpoint of the velocity was recorded in flight, on any axis."""
    for axis in "xyz":
        setpoints = recorded_series(evidence.signals.telemetry, POSITION_TARGET_MESSAGE, f"v{axis}")
        if next(evidence.in_flight(setpoints), None):
            return True
    return False


def _squared_errors(evidence: Evidence, axis: str) -> Array:
    """Returns the squared error of the position at each setpoint in flight.

    Args:
        evidence: signals, events and measurements of the vehicle.
        axis: field of the position along one axis: "x", "y" or "z".

    Returns:
        The squared error (N,), m²; empty without any.
    """
    telemetry = evidence.signals.telemetry
    position = recorded_series(telemetry, POSITION_MESSAGE, axis)
    squared_errors = [np.zeros(0)]
    for target in evidence.in_flight(recorded_series(telemetry, POSITION_TARGET_MESSAGE, axis)):
        estimate = None if position is None else series_of_boot(position, int(target.boot[0]))
        if estimate is not None:
            error = np.interp(target.time, estimate.time, estimate.values) - target.values
            squared_errors.append(error**2)
    return np.concatenate(squared_errors)


def _sticks_fact(evidence: Evidence) -> Fact | None:
    """Returns the fact that names the sticks and switches that the pilot moved in flight.

    A stick moved if its values in flight span at least ``MIN_STICK_CHANGE``, and a switch if they span
    ``MIN_SWITCH_CHANGE``.

    Args:
        evidence: signals, events and measurements of the vehicle.

    Returns:
        The fact, whose level is "unknown"; None if no stick or switch was recorded in flight.
    """
    inputs = pilot_input(evidence.signals)
    is_recorded = False
    moved_sticks = []
    for name, positions in inputs.sticks.items():
        is_recorded = is_recorded or bool(len(evidence.values_in_flight(positions)))
        if _change_in_flight(evidence, positions) >= MIN_STICK_CHANGE[inputs.unit]:
            moved_sticks.append(name)
    moved_channels = []
    for number, positions in inputs.switches.items():
        is_recorded = is_recorded or bool(len(evidence.values_in_flight(positions)))
        if _change_in_flight(evidence, positions) >= MIN_SWITCH_CHANGE:
            moved_channels.append(str(number))
    if not is_recorded:
        return None
    return Fact(
        CommandFact.STICKS_MOVED, Level.UNKNOWN, names=moved_sticks, channels=moved_channels
    )


def _change_in_flight(evidence: Evidence, series: TimeSeries) -> float:
    """Returns the largest change of a series (N,) within a flight, in its unit."""
    return max((float(np.ptp(part.values)) for part in evidence.in_flight(series)), default=0.0)
