"""What a model that was learned in a live flight is good for, and the judgement of its vehicle."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mavdem.assessment.axis import AxisEstimates
from mavdem.assessment.axis.findings import (
    Findings,
    model_findings,
    with_vehicle_made_torque_marked,
)
from mavdem.assessment.axis.loops import loop_of_parameters_or_reason
from mavdem.assessment.condition import Condition
from mavdem.assessment.judgement import Judgement, judge
from mavdem.assessment.lights.margins import margins_light
from mavdem.assessment.lights.motors import motors_light
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.segments import Segment
from mavdem.dem import Learned
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
from mavdem.motors.hover import hover_figures
from mavdem.motors.motor_changes import MotorAlarm, thrust_losses


class JudgedModel(NamedTuple):
    """What a model learned in flight is good for, and what its samples show of the vehicle."""

    findings: Findings
    """The grades of the model."""

    judgement: Judgement
    """The judgement of the vehicle."""


def judge_model(
    learned: Learned,
    row_format: RowFormat,
    alarms: Sequence[MotorAlarm],
    recording_name: str | None,
    *,
    has_rate_setpoint: bool,
    alarms_of_flight: Sequence[MotorAlarm] | None = None,
) -> JudgedModel:
    """Judges a model learned in flight, and the vehicle by the longest segment of the model's samples.

    The samples of the model are put into the form of a log of one axis in settled flight, so that the functions that
    judge logs can be used: limit cycle, hover trim, control loop, and from these the lights and the headline. What
    needs other axes or messages is left for the judgement of the recording after the flight. So are the margins where
    the stream has the setpoint of the body rate: a log identifies the loop by that setpoint then, and refuses margins
    where they are too uncertain, which inputs and outputs alone would still give.

    It is slow, and runs in the executor that learns models: arguments and results can be pickled.

    Args:
        learned: the model, of one axis.
        row_format: format of its rows: message names, mixer geometry, and scale of the motors.
        alarms: changes of the motors' balance while the samples were recorded.
        recording_name: the log that shows what no live message does; empty if it is known later, None without one.
        has_rate_setpoint: whether the stream has a setpoint of the body rate by which a log identifies the loop.
        alarms_of_flight: those of the present flight, by which the motors are judged in flight; None for all.
    """
    record = learned.record
    # Motor outputs (T, r), and angle, rad, with body rate, rad/s (T, 2), of the longest segment.
    inputs, outputs = max(record.segments, key=lambda segment: len(segment.outputs))
    axis = record.output_names[0]
    count = len(inputs)
    duration = count * learned.dt
    time: Any = learned.dt * np.arange(count)

    geometry = row_format.geometry
    motors = MotorOutputs(
        row_format.motor_message,
        time=time,
        boot=np.zeros(count, int),
        outputs=inputs,
        geometry=geometry,
        scale=row_format.scale,
        sent_count=count,
        unused_count=0,
    )
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
    # The model has one axis. It stands for both, so that the vehicle counts as upright where this axis is.
    signals = LiveSignals(telemetry, axis, motors=motors, tilts=(attitude,) * len(TILT_AXES))

    limit_cycle = detect_limit_cycle(motors, {axis: attitude}, [Segment(0, 0.0, duration)])
    mean_lean = {axis: np.degrees(outputs[:, 0].mean())}
    hover = hover_figures(geometry.names, row_format.scale, duration, inputs, mean_lean)
    condition = Condition(duration=duration, settled=duration, hover=hover, oscillation=limit_cycle)
    # The torque of a limit cycle is the vehicle's own, not the wind's.
    learned = with_vehicle_made_torque_marked(learned, vehicle_made_torque=limit_cycle is not None)
    findings = model_findings(learned, None, condition, alarms)

    figures = AxisEstimates((), learned.physical, None, learned.physical_reason)
    loops: dict[str, Loop | Fact] = {
        any_axis: Fact(Unjudged.NOT_JUDGED, reason=None) for any_axis in AXES
    }
    # These lights need messages that nothing in flight looks at.
    judged_later = Fact(Unjudged.JUDGED_LATER, path=recording_name, reason=None)
    if has_rate_setpoint:
        loops[axis] = judged_later
    else:
        loops[axis] = loop_of_parameters_or_reason(figures, record)
    losses = tuple(thrust_losses(alarms if alarms_of_flight is None else alarms_of_flight))
    evidence = live_evidence(signals, condition, LiveFindings(events=losses, loops=loops))
    motors_fact = motors_light(evidence)
    if motors_fact.code is TrimFact.TRIM_UNKNOWN:
        # The trim needs all axes, and the model has one.
        motors_fact = judged_later
    margins_fact = margins_light(evidence)
    # Without the setpoint a peak of the rate may be a test signal that is flown.
    is_peak_unexplained = margins_fact.code is MarginsLight.RATE_STANDS_OUT
    is_loop_identified_later = (
        has_rate_setpoint and margins_fact.code is not MarginsLight.OSCILLATES
    )
    if is_peak_unexplained or is_loop_identified_later:
        margins_fact = judged_later
    judgement = judge(
        evidence,
        findings.purposes,
        motors=motors_fact,
        margins=margins_fact,
        tracking=judged_later,
        estimator=judged_later,
    )
    return JudgedModel(findings, judgement)
