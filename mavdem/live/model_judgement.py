"""What a model that was learned in a live flight is good for, and the judgement of its vehicle."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.axis import AxisEstimates
from mavdem.assessment.axis.findings import (
    Findings,
    model_findings,
    with_vehicle_made_torque_marked,
)
from mavdem.assessment.axis.loops import loop_of_parameters_or_reason
from mavdem.assessment.condition import Condition
from mavdem.assessment.evidence import Evidence
from mavdem.assessment.judgement import Judgement, judge
from mavdem.assessment.lights.margins import margins_light
from mavdem.assessment.lights.motors import motors_light
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dataset.intervals import Intervals, in_intervals
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.segments import MIN_SEGMENT_SECONDS, Segment
from mavdem.dem import Learned
from mavdem.dem.record import Record, SegmentSamples
from mavdem.facts import Fact
from mavdem.facts.lights import Unjudged
from mavdem.facts.margins import MarginsLight
from mavdem.facts.motors import TrimFact
from mavdem.ingest.telemetry import Telemetry
from mavdem.ingest.vocabulary import UNNAMED
from mavdem.live.live_signals import LiveFindings, LiveSignals, attitude_from_samples, live_evidence
from mavdem.live.rows import RowFormat
from mavdem.loops.axis_loops import Loop
from mavdem.loops.limit_cycles import detect_limit_cycle
from mavdem.motors.hover import HoverFigures, hover_figures
from mavdem.motors.motor_changes import MotorChange, thrust_losses, torque_changes


class JudgedModel(NamedTuple):
    """What a model learned in flight is good for, and what its samples show of the vehicle."""

    findings: Findings
    """The grades of the model."""

    judgement: Judgement
    """The judgement of the vehicle."""


def judge_model(
    learned: Learned,
    row_format: RowFormat,
    alarms: Sequence[MotorChange],
    recording_name: str | None,
    *,
    climbs: Intervals,
    provisional_margins: Fact | None,
) -> JudgedModel:
    """Judges a model learned in flight, and the vehicle by the longest settled segment of the model's samples.

    The settled samples of the model are put into the form of a log of one axis, so that the functions that judge logs
    can be used: limit cycle, hover trim, control loop, and from these the lights and the headline. What
    needs other axes or messages is left for the judgement of the recording after the flight. The margins are left for
    :class:`mavdem.live.margin_review.MarginReview` where the stream has the setpoint of the body rate: by that setpoint
    the loop is identified, and margins that are too uncertain are not reported. Inputs and outputs alone, as here,
    would still give such margins.

    It is slow, and runs in the executor that learns models: arguments and results can be pickled.

    Args:
        learned: the model, of one axis.
        row_format: format of its rows: message names, mixer geometry, and scale of the motors.
        alarms: changes of the motors' balance in the flight of the model.
        recording_name: name of the recorded log, by which the rest is judged later; empty if the name is not known yet,
            None if nothing is recorded.
        climbs: times of climbs after take-off, s of the boot clock. The model is learned from them, too, but they are
            not settled flight: a limit cycle and the hover are looked for in the samples after them.
        provisional_margins: the light of the margins until the loop is identified by setpoints of the body rate, which
            is not done here; None where these do not come.
    """
    record = learned.record
    settled_segment = longest_settled_segment(record, climbs)
    if settled_segment is not None:
        signals = _signals_of_segment(settled_segment, record, row_format, recording_name)
        condition = _settled_condition(settled_segment, signals, record, row_format)
    else:
        # A model of the climb alone: its samples show neither a hover nor a limit cycle.
        segment = max(record.segments, key=lambda segment: len(segment.outputs))
        signals = _signals_of_segment(segment, record, row_format, recording_name)
        condition = Condition(duration=len(segment.outputs) * record.dt)
    # The torque of a limit cycle is the vehicle's own, not the wind's.
    has_limit_cycle = condition.oscillation is not None
    learned = with_vehicle_made_torque_marked(learned, vehicle_made_torque=has_limit_cycle)
    findings = model_findings(learned, None, condition, alarms)
    live_findings = LiveFindings(
        events=(*thrust_losses(alarms), *torque_changes(alarms)),
        loops=_loops_by_axis(learned, provisional_margins),
    )
    evidence = live_evidence(signals, condition, live_findings)
    # What needs other messages than the samples have is judged by the recording, after the landing.
    after_landing = Fact(Unjudged.JUDGED_LATER, path=recording_name, reason=None)
    judgement = judge(
        evidence,
        motors=_motors_light(evidence, after_landing),
        margins=_margins_light(evidence, after_landing, provisional_margins),
        tracking=after_landing,
        estimator=after_landing,
    )
    return JudgedModel(findings, judgement)


def _signals_of_segment(
    segment: SegmentSamples, record: Record, row_format: RowFormat, recording_name: str | None
) -> LiveSignals:
    """Returns the samples of a segment in the form that the signals of a log have, with times from 0 s on.

    Args:
        segment: motor outputs (T, r), and angle, rad, with body rate, rad/s (T, 2).
        record: the record that the segment is a part of: its axis, time step, and the autopilot's parameters.
        row_format: format of the samples: message names, mixer geometry, and scale of the motors.
        recording_name: name of the recorded log; None if nothing is recorded.
    """
    inputs, outputs = segment
    time = record.dt * np.arange(len(inputs), dtype=float)
    angle, body_rate = outputs.T
    attitude = attitude_from_samples(row_format.attitude_message, time, 0, angle, body_rate)
    telemetry = Telemetry(
        system=1,
        component=1,
        vehicle=UNNAMED,
        autopilot="",
        messages={},
        parameters=record.parameters,
        source=recording_name or "",
    )
    return LiveSignals(
        telemetry,
        record.output_names[0],
        motors=_motor_outputs(row_format, time, inputs),
        # The model has one axis. It stands for both, so that the vehicle counts as upright where this axis is.
        tilts=(attitude,) * len(TILT_AXES),
    )


def _settled_condition(
    settled_segment: SegmentSamples, signals: LiveSignals, record: Record, row_format: RowFormat
) -> Condition:
    """Returns how the vehicle hovered in a segment of settled flight, and whether it oscillated in a limit cycle.

    Args:
        settled_segment: samples of the segment.
        signals: the same as the signals of a log.
        record: the record that the segment is a part of.
        row_format: format of the samples: mixer geometry, and scale of the motors.
    """
    assert signals.motors is not None
    duration = len(settled_segment.outputs) * record.dt
    attitude = signals.tilts[0]
    hover = hover_of_segment(settled_segment, record, row_format)
    limit_cycle = detect_limit_cycle(
        signals.motors, {signals.axis: attitude}, [Segment(0, 0.0, duration)]
    )
    return Condition(duration=duration, settled=hover.seconds, hover=hover, oscillation=limit_cycle)


def _loops_by_axis(learned: Learned, provisional_margins: Fact | None) -> dict[str, Loop | Fact]:
    """Returns the control loop of each axis, or why it is not known: that of the model by its physical parameters.

    Args:
        learned: the model of one axis.
        provisional_margins: the fact that the margins will be known later in the flight, which takes the place of this
            loop; None where setpoints of the body rate, by which it is identified, do not come.
    """
    loops: dict[str, Loop | Fact] = {axis: Fact(Unjudged.NOT_JUDGED, reason=None) for axis in AXES}
    axis_of_model = learned.record.output_names[0]
    if provisional_margins is not None:
        loops[axis_of_model] = provisional_margins
    else:
        figures = AxisEstimates((), learned.physical, learned.physical_reason)
        loops[axis_of_model] = loop_of_parameters_or_reason(figures, learned.record)
    return loops


def longest_settled_segment(record: Record, climbs: Intervals) -> SegmentSamples | None:
    """Returns the longest segment of a model's samples in settled flight.

    Args:
        record: samples of the model, whose segments begin at known times of the boot clock.
        climbs: times of climbs after take-off, s of the boot clock, which are not settled flight.

    Returns:
        The samples; None if no segment has ``MIN_SEGMENT_SECONDS`` of settled flight.
    """
    settled_segments = []
    for segment, start_time in zip(record.segments, record.begins, strict=True):
        settled_segments.append(_samples_after_climbs(segment, start_time, record.dt, climbs))
    longest_segment = max(settled_segments, key=lambda segment: len(segment.outputs))
    is_long_enough = len(longest_segment.outputs) * record.dt >= MIN_SEGMENT_SECONDS
    return longest_segment if is_long_enough else None


def hover_of_segment(
    settled_segment: SegmentSamples, record: Record, row_format: RowFormat
) -> HoverFigures:
    """Returns how hard each motor works in a segment of settled flight.

    Args:
        settled_segment: samples of the segment, whose first output is the angle, rad.
        record: the record that the segment is a part of: names of its outputs, and time step.
        row_format: format of the samples: mixer geometry, and scale of the motors.
    """
    inputs, outputs = settled_segment
    mean_lean = {record.output_names[0]: np.degrees(outputs[:, 0].mean())}
    seconds = len(outputs) * record.dt
    return hover_figures(row_format.geometry.names, row_format.scale, seconds, inputs, mean_lean)


def _samples_after_climbs(
    segment: SegmentSamples, start_time: float, dt: float, climbs: Intervals
) -> SegmentSamples:
    """Returns the samples of a segment that follow its last sample in a climb; all samples if none is in a climb.

    Args:
        segment: consecutive samples.
        start_time: time of the first one, s of the boot clock.
        dt: time step between them, s.
        climbs: first and last time of each climb, s of the boot clock.
    """
    time = start_time + dt * np.arange(len(segment.outputs), dtype=float)
    # Rounding of the times is far less than half a step.
    widened_climbs = [(start - dt / 2, end + dt / 2) for start, end in climbs]
    climb_samples = np.flatnonzero(in_intervals(time, widened_climbs))
    if not len(climb_samples):
        return segment
    first_settled_sample = climb_samples[-1] + 1
    return SegmentSamples(
        segment.inputs[first_settled_sample:], segment.outputs[first_settled_sample:]
    )


def _motor_outputs(row_format: RowFormat, time: Array, outputs: Array) -> MotorOutputs:
    """Returns the motor outputs of a segment of live samples in the form that logs have, for the functions for logs.

    Args:
        row_format: format of the rows: message names, mixer geometry, and scale of the r motors.
        time: (T,) times of the samples, s.
        outputs: (T, r) motor outputs in the unit of the message.
    """
    count = len(time)
    return MotorOutputs(
        row_format.motor_message,
        time=time,
        boot=np.zeros(count, int),
        outputs=outputs,
        geometry=row_format.geometry,
        scale=row_format.scale,
        sent_count=count,
        unused_count=0,
    )


def _motors_light(evidence: Evidence, after_landing: Fact) -> Fact:
    """Judges the motors in flight, by the samples of the model's axis.

    Args:
        evidence: signals and events of one axis, made from the samples of the model.
        after_landing: the fact that a part of the vehicle is judged by the recording after the landing.

    Returns:
        The judgement, a fact with a level (the status light of the motors); ``after_landing`` if one axis is not enough
        for it.
    """
    judgement = motors_light(evidence)
    # The hover trim of the motors needs all axes, and the model has one.
    if judgement.code is TrimFact.TRIM_UNKNOWN:
        return after_landing
    return judgement


def _margins_light(
    evidence: Evidence, after_landing: Fact, provisional_margins: Fact | None
) -> Fact:
    """Judges the stability margins of the control loop in flight, by the samples of the model's axis.

    Args:
        evidence: signals and events of one axis, made from the samples of the model.
        after_landing: the fact that a part of the vehicle is judged by the recording after the landing.
        provisional_margins: the fact that the margins will be known later in the flight. It is given if setpoints of
            the body rate are received, since they identify the loop better than the samples of the model do; None if
            none are received.

    Returns:
        The judgement, a fact with a level (the status light of the margins): an oscillation in any case;
        ``provisional_margins`` where that is given; ``after_landing`` if the samples are not enough.
    """
    judgement = margins_light(evidence)
    if judgement.code is MarginsLight.OSCILLATES:
        return judgement
    if provisional_margins is not None:
        return provisional_margins
    # The samples have no setpoint, so that a peak of the rate may be a test signal that is flown.
    if judgement.code is MarginsLight.RATE_STANDS_OUT:
        return after_landing
    return judgement
