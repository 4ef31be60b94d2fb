"""Twin of an assessed vehicle: a simulation with the identified plant, and its flight with other gains."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mavdem.assessment.evidence import Evidence
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts, NamedFacts
from mavdem.facts.loops import Gains
from mavdem.ingest.telemetry import Parameters
from mavdem.loops.axis_loops import LoopsByAxis
from mavdem.loops.twin import Twin, build_twin
from mavdem.loops.twin_flight import (
    SETTLING_SECONDS,
    ReplaySegment,
    fly_twin,
    replay_segments,
)
from mavdem.motors.hover import hover_of
from mavdem.wind_velocity.vehicle_drag import Drag

REPLAY_SECONDS = 40.0
"""Duration of the flight that the twin repeats to compare gains, s: the pilot who has just landed waits for it."""


class AssessedTwin(NamedTuple):
    """The twin of a vehicle."""

    twin: Twin
    loops: LoopsByAxis
    """The identified loops from which it was built."""
    missing: NamedFacts
    """Why the loops of other axes are not known, by axis."""


def assessed_twin(evidence: Evidence, mass: float | None = None) -> AssessedTwin:
    """Builds the twin of a vehicle: a simulation with its identified loops, hover thrust, drag and wind.

    Roll and the hover are needed. Axes without an identified loop are reported as missing. The drag is the one that the
    wind was estimated with, otherwise that of the autopilot's parameters.

    Args:
        evidence: of the vehicle.
        mass: of the vehicle, kg; None if it is not known.

    Raises:
        NotLearnable: the loop of roll, or the hover, is not known.
    """
    missing = {axis: loop for axis, loop in evidence.loops.items() if isinstance(loop, Fact)}
    if evidence.reasons_not_to_fly:
        missing = {axis: fact.grounded for axis, fact in missing.items()}
    if "roll" in missing:
        reasons = (*evidence.reasons_not_to_fly, missing["roll"])
        raise NotLearnable(reasons[0])
    loops = evidence.identified_loops
    signals = evidence.signals
    hover = hover_of(signals.for_axis("roll", "motors"), evidence.log.components)
    hover_share = float(np.mean(hover.trim_of_range))
    telemetry = signals.telemetry
    wind = evidence.wind.estimate
    drag = Drag.from_parameters(telemetry.autopilot, telemetry.parameters)
    if wind is not None:
        drag = wind.drag
    is_px4 = telemetry.autopilot == "PX4"
    twin = build_twin(loops, is_px4, hover_share, wind, drag, mass)
    return AssessedTwin(twin, loops, missing)


def predicted_errors(evidence: Evidence, gains: Parameters) -> Facts:
    """Predicts how well the vehicle would follow its setpoints with other gains, by flights of its twin.

    The twin repeats the setpoints of the flight twice, with the present gains and with the others, in the same wind and
    noise. So the errors of both flights differ by the gains alone.

    Args:
        evidence: of the vehicle.
        gains: to set, by the autopilot's names.

    Returns:
        For roll and pitch a fact with the standard deviation of the angle from its setpoint, degrees: ``present_error``
        with the present gains and ``expected_error`` with the others. If the twin cannot fly, only the reason; nothing
        if the log has no setpoints of roll.
    """
    loops = evidence.identified_loops
    recorded_segments = replay_segments(loops) if "roll" in loops else {}
    if not recorded_segments:
        return ()
    dt = loops["roll"].record.dt
    # The beginning, in which the twin settles, is flown but left out of the errors.
    replayed_samples = slice(round(REPLAY_SECONDS / dt))
    settled_samples = slice(round(SETTLING_SECONDS / dt), None)
    segments = {}
    for axis, recorded in recorded_segments.items():
        segments[axis] = ReplaySegment(*(values[replayed_samples] for values in recorded))
    try:
        present_twin = assessed_twin(evidence).twin
        changed_twin = replace(present_twin, parameters={**present_twin.parameters, **gains})
        present_motion = fly_twin(present_twin, loops, segments)
        changed_motion = fly_twin(changed_twin, loops, segments)
    except NotLearnable as error:
        return (error.fact,)
    facts = []
    for axis in TILT_AXES:
        if axis not in segments:
            continue
        # Column 0 of setpoints and motions is the angle, column 1 the rate.
        setpoints = segments[axis].setpoints[settled_samples, 0]
        angle_errors = [
            motion[settled_samples, AXES.index(axis), 0] - setpoints
            for motion in (present_motion, changed_motion)
        ]
        present_error, expected_error = np.degrees(np.std(angle_errors, axis=1)).tolist()
        facts.append(
            Fact(
                Gains.TWIN_FLIES,
                subject=axis,
                present_error=present_error,
                expected_error=expected_error,
            )
        )
    return tuple(facts)
