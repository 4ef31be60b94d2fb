"""Measured closed-loop responses of rate and attitude of each axis, compared with those that the loops predict."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.evidence import EXCITATION_MODES, Evidence
from mavdem.dataset.axes import AXES
from mavdem.facts import Fact, Facts
from mavdem.loops.advice import Advice, AdviceByAxis
from mavdem.loops.axis_loops import Loop
from mavdem.loops.identified_step import step_from_frequency_response
from mavdem.loops.margins import Complex, OpenLoop
from mavdem.loops.step_response import (
    StepResponse,
    attitude_step_response,
    rate_step_response,
)

RATE_FEEDFORWARD_PARAMETER = "ATC_RATE_FF_ENAB"
"""ArduPilot's parameter that adds the derivative of the attitude's setpoint to the setpoint of the rate."""


class LoopResponse(NamedTuple):
    """Response of one closed loop of one axis to its setpoint."""

    measured: StepResponse | Fact
    """As measured, or why it is not known."""
    predicted_step: Array | None = None
    """Predicted step response at the times of the measured one; None without a stable identified loop."""
    predicted_gain: Array | None = None
    """Predicted gain at the frequencies of the measured one; None without a stable identified loop."""
    compared: Fact | None = None
    """Whether the two agree, or which of them is doubted; None without one of them."""
    has_feedforward: bool = False
    """Whether the autopilot adds the derivative of the attitude's setpoint to the setpoint of the rate."""

    @property
    def facts(self) -> Facts:
        """What there is to report of it."""
        if isinstance(self.measured, Fact):
            return (self.measured,)
        return tuple(fact for fact in (self.measured.fact, self.compared) if fact is not None)


Responses = Mapping[str, Mapping[str, LoopResponse]]
"""Responses by axis, and then by loop: "rate" or "attitude"."""

StepsByLoop = Mapping[str, Mapping[str, Array]]
"""Step responses by axis, and then by loop, at the times of the measured ones."""

NO_RESPONSES: Responses = MappingProxyType({})
"""What a flight has of which no response was measured."""

NO_STEPS: StepsByLoop = MappingProxyType({})
"""What a flight has whose gains are kept."""


def responses_of(evidence: Evidence) -> Responses:
    """Measures the closed-loop responses of rate and attitude of roll, pitch and yaw, and predicts them by the loops.

    They are of settled flight, without the modes that excite the vehicle themselves: there the setpoint is not what
    moves it. Responses of axes without an identified loop have no prediction.

    Args:
        evidence: what the log shows of the vehicle, with the identified loop of each axis.

    Returns:
        The responses by axis, and then by "rate" and "attitude".
    """
    segments = evidence.settled_segments(EXCITATION_MODES)
    responses = {}
    for axis in AXES:
        signals = evidence.signals.for_axis(axis)
        loop = evidence.loops.get(axis)
        has_feedforward = bool(signals.telemetry.parameters.get(RATE_FEEDFORWARD_PARAMETER))
        rate = rate_step_response(signals, segments, loop if isinstance(loop, Loop) else None)
        attitude = attitude_step_response(signals, segments)
        if isinstance(loop, Loop):
            attitude_prediction = predicted_attitude_response(loop, has_feedforward)
            rate_response = _compared_response(rate, loop, loop.rate, loop.rate.closed[0])
            attitude_response = _compared_response(
                attitude, loop, loop.attitude, attitude_prediction
            )
        else:
            rate_response = LoopResponse(rate)
            attitude_response = LoopResponse(attitude)
        responses[axis] = {
            "rate": rate_response,
            "attitude": attitude_response._replace(has_feedforward=has_feedforward),
        }
    return responses


def advised_steps(responses: Responses, advice_by_axis: AdviceByAxis) -> StepsByLoop:
    """Predicts the step responses with the advised gains, at the times of the measured responses.

    They belong beside the measured ones, so that an attitude has the feedforward that the autopilot adds.

    Args:
        responses: the measured responses.
        advice_by_axis: advice on each axis, or why there is none.

    Returns:
        By axis and loop, the response to a step of 1 at the times of the measured one; only where gains change, and a
        response was measured.
    """
    steps = dict[str, dict[str, Array]]()
    for axis, loops in responses.items():
        advice = advice_by_axis.get(axis)
        if not isinstance(advice, Advice) or not advice.parameters:
            continue
        after = advice.after
        steps[axis] = {}
        for loop_name, response in loops.items():
            if not isinstance(response.measured, StepResponse):
                continue
            # Row 0 is the estimated plant.
            closed_loop = after.rate.closed[0]
            if loop_name == "attitude":
                closed_loop = predicted_attitude_response(after, response.has_feedforward)
            steps[axis][loop_name] = step_from_frequency_response(
                after.rate.frequency, closed_loop, response.measured.time
            )
    return steps


def predicted_attitude_response(loop: Loop, has_feedforward: bool) -> Complex:
    """Returns the frequency response of the attitude to its setpoint at F frequencies, as the loop predicts it.

    With the angle gain K and T the closed loop, a feedforward of the setpoint's derivative makes it T (1 + jω/K): the
    setpoint of the rate is K (setpoint − angle) + jω setpoint.

    Args:
        loop: of the axis.
        has_feedforward: whether the derivative of the setpoint is added to the setpoint of the rate.

    Returns:
        (F,) at ``loop.attitude.frequency``.
    """
    closed_loop = loop.attitude.closed[0]
    if not has_feedforward:
        return closed_loop
    derivative_share = 2j * np.pi * loop.attitude.frequency / loop.controller.angle_gain
    return closed_loop * (1 + derivative_share)


def _compared_response(
    measured: StepResponse | Fact, loop: Loop, open_loop: OpenLoop, closed_loop: Complex
) -> LoopResponse:
    """Returns a measured response together with the predicted one, at the times and frequencies of the measured one.

    The step response is predicted from the frequency response of the closed loop by a Fourier transform.

    Args:
        measured: the response, or why it is not known.
        loop: the identified loops of the axis.
        open_loop: the one of these that is compared, whose first row is the estimate. An unstable one predicts no
            response.
        closed_loop: (F,) predicted frequency response at ``open_loop.frequency``.
    """
    if isinstance(measured, Fact) or not open_loop.stable[0]:
        return LoopResponse(measured)
    frequency = open_loop.frequency
    return LoopResponse(
        measured,
        step_from_frequency_response(frequency, closed_loop, measured.time),
        np.interp(measured.frequency, frequency, abs(closed_loop)),
        _comparison(measured, loop, frequency, closed_loop),
    )


def _comparison(
    measured: StepResponse, loop: Loop, frequency: Array, closed_loop: Complex
) -> Fact | None:
    """Returns whether a measured and a predicted response agree, or which of them is doubted.

    The loops of an axis have one rating. Where the flight has shown whether the rate follows the loop
    (:attr:`Loop.agrees`), the gain at some frequencies does not outrank the fit of the whole response.

    Args:
        measured: the response.
        loop: the identified loops of the axis.
        frequency: (F,) Hz.
        closed_loop: (F,) predicted frequency response.

    Returns:
        The fact; None where it would contradict the fit of the rate.
    """
    comparison = measured.comparison(frequency, closed_loop)
    if loop.agrees is not None and comparison.is_good != loop.agrees:
        return None
    return comparison
