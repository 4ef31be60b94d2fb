"""Twin of an assessed vehicle: its simulation with other gains, or the fact (a coded finding) why there is none."""

from collections.abc import Mapping
from dataclasses import replace
from math import inf
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.evidence import Evidence
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.errors import NotLearnable
from mavdem.facts import Fact, Facts, NamedFacts
from mavdem.facts.loops import GainFact
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

REPLAY_SECONDS = 12.0
"""Duration of the part of the recorded flight that the twin repeats to compare gains, s: a choice.

It takes a second or two of processor time, and the pilot who has just landed waits for it.
"""
WIND_SECONDS = 10.0
"""Duration of the hover in wind with which the twin compares gains, s: a choice.

Both sets of gains meet the same wind and noise, so that this is long enough to tell them apart.
"""


class AssessedTwin(NamedTuple):
    """The twin of a vehicle, a simulation of it, with the loops from which it was built."""

    twin: Twin
    """The simulation, with the gains that flew."""
    loops: LoopsByAxis
    """The identified loops from which it was built."""
    missing: NamedFacts
    """Why the loops of other axes are not known, by axis."""


def build_assessed_twin(evidence: Evidence, mass: float | None = None) -> AssessedTwin:
    """Builds the twin of a vehicle: a simulation with its identified loops, hover thrust, drag and wind.

    Roll and the hover are needed. Axes without an identified loop are reported as missing. The drag is the one with
    which the wind was estimated, otherwise the drag in the autopilot's parameters.

    Args:
        evidence: signals, events and measurements of the vehicle.
        mass: mass of the vehicle, kg; None if it is not known.

    Returns:
        The twin, the loops that it simulates, and by axis the reason why a loop is missing.

    Raises:
        NotLearnable: the loop of roll, or the hover, is not known.
    """
    # An axis without an identified loop has a fact that says why.
    missing_loops = {}
    for axis, loop in evidence.loops.items():
        if isinstance(loop, Fact):
            # A vehicle that must not fly is not advised to fly for a loop.
            missing_loops[axis] = (
                loop.without_flight_advice if evidence.reasons_not_to_fly else loop
            )
    if "roll" in missing_loops:
        if evidence.reasons_not_to_fly:
            raise NotLearnable(evidence.reasons_not_to_fly[0])
        raise NotLearnable(missing_loops["roll"])
    loops = evidence.identified_loops
    telemetry = evidence.signals.telemetry
    hover = hover_of(evidence.signals.for_axis("roll", "motors"), evidence.log.components)
    wind = evidence.wind.estimate
    if wind is not None:
        drag = wind.drag
    else:
        drag = Drag.from_parameters(telemetry.autopilot, telemetry.parameters)
    twin = build_twin(
        loops,
        px4=telemetry.autopilot == "PX4",
        # Mean command of all motors in the hover, as a fraction of their range.
        hover=float(np.mean(hover.trim_of_range)),
        wind=wind,
        drag=drag,
        mass=mass,
    )
    return AssessedTwin(twin, loops, missing_loops)


class TwinMotion(NamedTuple):
    """Angle of one axis of the twin with the present gains and with advised ones, in the same wind and noise."""

    time: Array
    """Time since the beginning (T,), s."""
    setpoint: Array
    """Setpoint of the angle (T,), rad."""
    present: Array
    """Angle with the present gains (T,), rad."""
    advised: Array
    """Angle with the advised gains (T,), rad."""

    @property
    def present_error(self) -> float:
        """Standard deviation of the angle from its setpoint with the present gains, degrees."""
        return float(np.degrees(np.std(self.present - self.setpoint)))

    @property
    def expected_error(self) -> float:
        """Standard deviation of the angle from its setpoint that is expected with the advised gains, degrees."""
        return float(np.degrees(np.std(self.advised - self.setpoint)))


class GainTrial(NamedTuple):
    """Flights of the twin that compare gains, without their beginning, in which the twin settles."""

    tracking: dict[str, TwinMotion]
    """By "roll" and "pitch", the motion on the setpoints of the recorded flight."""
    wind: dict[str, TwinMotion]
    """By "roll" and "pitch", the motion in a hover, in wind of the recorded spectrum; empty if it was not flown."""


def try_gains(evidence: Evidence, gains: Parameters, *, in_wind: bool = True) -> GainTrial | Fact:
    """Simulates flights of the twin with the present gains and with other gains, in the same wind and noise.

    The twin is a simulation of the vehicle with its identified loops. One pair of flights follows the setpoints of the
    recorded flight, in the seconds in which they move most. A second pair hovers in wind, with setpoints of 0.

    Args:
        evidence: signals, events and measurements of the vehicle.
        gains: gains to set, by the autopilot's names.
        in_wind: whether the second pair of flights is simulated.

    Returns:
        The motion of both flights by axis, "roll" and "pitch", without axes whose setpoints were not recorded; or the
        reason why the twin cannot fly.
    """
    loops = evidence.identified_loops
    recorded_segments = replay_segments(loops) if "roll" in loops else {}
    if not recorded_segments:
        return GainTrial({}, {})
    dt = loops["roll"].record.dt
    motion_in_wind = {}
    try:
        present_twin = build_assessed_twin(evidence).twin
        advised_twin = replace(present_twin, parameters={**present_twin.parameters, **gains})
        twins = (present_twin, advised_twin)
        samples_to_repeat = samples_of_most_movement(recorded_segments, dt)
        replayed_segments = _samples_of_segments(recorded_segments, samples_to_repeat)
        tracking = _compared_motions(twins, loops, replayed_segments)
        if in_wind:
            motion_in_wind = _compared_motions(twins, loops, _hover_segments(recorded_segments, dt))
    except NotLearnable as error:
        return error.fact
    return GainTrial(tracking, motion_in_wind)


def _samples_of_segments(
    recorded_segments: Mapping[str, ReplaySegment], samples: slice
) -> dict[str, ReplaySegment]:
    """Returns some samples of a recorded flight, for the twin to repeat.

    Args:
        recorded_segments: outputs and setpoints of the same T samples by axis.
        samples: which of these samples.
    """
    segments = {}
    for axis, (outputs, setpoints) in recorded_segments.items():
        segments[axis] = ReplaySegment(outputs[samples], setpoints[samples])
    return segments


def _hover_segments(
    recorded_segments: Mapping[str, ReplaySegment], dt: float
) -> dict[str, ReplaySegment]:
    """Returns a hover for the twin: as many samples as it needs of a recorded flight, with all setpoints 0.

    Args:
        recorded_segments: outputs and setpoints of the same T samples by axis.
        dt: time between samples, s.
    """
    needed_samples = slice(round((SETTLING_SECONDS + WIND_SECONDS) / dt))
    segments = _samples_of_segments(recorded_segments, needed_samples)
    for axis, segment in segments.items():
        segments[axis] = segment._replace(setpoints=np.zeros_like(segment.setpoints))
    return segments


def samples_of_most_movement(segments: Mapping[str, ReplaySegment], dt: float) -> slice:
    """Selects the samples of a recorded flight to simulate: the window in which the setpoints of angles move most.

    It has ``SETTLING_SECONDS``, in which the twin settles, and then ``REPLAY_SECONDS``. Windows that begin at each full
    second are compared by the variance of their setpoints without the settling, summed over roll and pitch.

    Args:
        segments: recorded setpoints of the same T samples by axis.
        dt: time between samples, s.

    Returns:
        The samples; all samples of a flight that is shorter.
    """
    # Column 0 of the setpoints is the angle; the setpoint of yaw's angle is 0.
    angle_setpoints = np.array([segment.setpoints[:, 0] for segment in segments.values()])
    sample_count = angle_setpoints.shape[1]
    settling_length = round(SETTLING_SECONDS / dt)
    window_length = round((SETTLING_SECONDS + REPLAY_SECONDS) / dt)
    last_start = max(sample_count - window_length, 0)
    samples_per_second = round(1 / dt)
    best_start = 0
    largest_variance = -inf
    for start in range(0, last_start + 1, samples_per_second):
        end = start + window_length
        setpoints_after_settling = angle_setpoints[:, start + settling_length : end]
        variance = float(setpoints_after_settling.var(axis=1).sum())
        if variance > largest_variance:
            best_start = start
            largest_variance = variance
    return slice(best_start, best_start + window_length)


def _compared_motions(
    twins: tuple[Twin, Twin], loops: LoopsByAxis, segments: dict[str, ReplaySegment]
) -> dict[str, TwinMotion]:
    """Flies two twins through the same setpoints, and compares their roll and pitch.

    Args:
        twins: the twin with the present gains, and the twin with the advised ones.
        loops: identified loops by axis, "roll" among them.
        segments: setpoints by axis.

    Returns:
        For each of "roll" and "pitch" that has setpoints: the setpoint and the angles of both twins.

    Raises:
        NotLearnable: a twin cannot fly.
    """
    dt = loops["roll"].record.dt
    present_twin, advised_twin = twins
    # True angles are compared, since in calm air the noise of estimated ones would hide the effect of the gains.
    present_flight = fly_twin(present_twin, loops, segments, is_estimated=False)
    advised_flight = fly_twin(advised_twin, loops, segments, is_estimated=False)
    # The beginning, in which the twin settles, is flown but left out.
    settled_samples = slice(round(SETTLING_SECONDS / dt), None)
    motions = {}
    for axis in TILT_AXES:
        if axis not in segments:
            continue
        # Column 0 of setpoints and motions is the angle, column 1 the rate.
        setpoint = segments[axis].setpoints[settled_samples, 0]
        axis_index = AXES.index(axis)
        motions[axis] = TwinMotion(
            time=np.arange(len(setpoint), dtype=np.float64) * dt,
            setpoint=setpoint,
            present=present_flight[settled_samples, axis_index, 0],
            advised=advised_flight[settled_samples, axis_index, 0],
        )
    return motions


def predicted_errors(evidence: Evidence, gains: Parameters) -> Facts:
    """Predicts how closely roll and pitch would follow their setpoints with other gains, by simulated flights.

    The twin, a simulation of the vehicle, flies the setpoints of the recorded flight with either set of gains, in the
    same wind and noise.

    Args:
        evidence: signals, events and measurements of the vehicle.
        gains: gains to set, by the autopilot's names.

    Returns:
        For roll and pitch a fact with the standard deviation of the angle from its setpoint, degrees: ``present_error``
        with the present gains and ``expected_error`` with the others. If the twin cannot fly, only the reason; nothing
        if the log has no setpoints of roll.
    """
    trial = try_gains(evidence, gains, in_wind=False)
    if isinstance(trial, Fact):
        return (trial,)
    error_facts = []
    for axis, motion in trial.tracking.items():
        error_fact = Fact(
            GainFact.TWIN_ANGLE_ERROR,
            subject=axis,
            present_error=motion.present_error,
            expected_error=motion.expected_error,
        )
        error_facts.append(error_fact)
    return tuple(error_facts)
