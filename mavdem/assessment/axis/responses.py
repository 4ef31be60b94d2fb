"""Measured closed-loop responses of each axis, their predictions, and facts (coded findings) on how both agree."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.axis.margins import response_comparison
from mavdem.assessment.evidence import EXCITATION_MODES, Evidence
from mavdem.dataset.axes import AXES
from mavdem.dataset.segments import Segments
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Facts
from mavdem.facts.loops import StepResponseFact
from mavdem.loops.advice import Advice, AdviceByAxis
from mavdem.loops.attitude_response import predicted_attitude_response
from mavdem.loops.axis_loops import Loop
from mavdem.loops.identified_step import step_from_frequency_response
from mavdem.loops.margins import Complex, OpenLoop
from mavdem.loops.rate_setpoint import has_rate_feedforward
from mavdem.loops.step_response import (
    StepResponse,
    attitude_step_response,
    rate_step_response,
)


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
    def contradiction(self) -> Fact | None:
        """Which of the measured and the predicted response is doubted, if they differ; None without one of them."""
        if self.compared is None or self.compared.is_good:
            return None
        return self.compared

    @property
    def is_step_doubtful(self) -> bool:
        """Whether the step response in ``measured`` is doubtful; False if no step could be measured.

        A measured step may be doubtful by itself (``StepResponse.is_doubtful``). A step that is
        taken from the identified loop, since the rate is too fast for its messages, is doubtful if the measured gain
        contradicts that loop.
        """
        if isinstance(self.measured, Fact):
            return False
        if self.measured.is_identified and self.compared is not None:
            return self.compared.code is StepResponseFact.PREDICTION_DOUBTED
        return self.measured.is_doubtful

    @property
    def facts(self) -> Facts:
        """Facts to report: the measured response or why it is not known, and whether the prediction agrees."""
        if isinstance(self.measured, Fact):
            return (self.measured,)
        return tuple(fact for fact in (self.measured.fact, self.compared) if fact is not None)


Responses = Mapping[str, Mapping[str, LoopResponse]]
"""Responses by axis, and then by loop: "rate" or "attitude"."""

StepsByLoop = Mapping[str, Mapping[str, Array]]
"""Step responses by axis, and then by loop, at the times of the measured ones."""

NO_RESPONSES: Responses = MappingProxyType({})
"""The responses of a flight in which none was measured."""

NO_STEPS: StepsByLoop = MappingProxyType({})
"""The step responses with advised gains of a flight for which no gains are advised."""


def measure_responses(evidence: Evidence) -> Responses:
    """Measures the closed-loop responses of rate and attitude of roll, pitch and yaw, and predicts them by the loops.

    Only settled flight counts, without the flight modes that inject an excitation themselves, such as AutoTune: there
    the setpoint is not what moves the vehicle. Axes without an identified loop have no prediction.

    Args:
        evidence: signals and measurements of the vehicle, with the identified loop of each axis.

    Returns:
        The responses by axis, and then by "rate" and "attitude".
    """
    segments = evidence.settled_segments(EXCITATION_MODES)
    responses = {}
    for axis in AXES:
        # An axis whose loop was not identified has a fact that says why, or nothing.
        loop = evidence.loops.get(axis)
        identified_loop = loop if isinstance(loop, Loop) else None
        signals = evidence.signals.for_axis(axis)
        responses[axis] = _responses_of_axis(signals, segments, identified_loop)
    return responses


def _responses_of_axis(
    signals: Signals, segments: Segments, loop: Loop | None
) -> dict[str, LoopResponse]:
    """Measures the responses of rate and attitude of one axis, and compares them with the predictions of its loop.

    Args:
        signals: logged time series of the axis, with its setpoints.
        segments: the parts of the flight that are used.
        loop: the identified loop of the axis; None without one, and then there is nothing to compare.

    Returns:
        The responses by "rate" and "attitude".
    """
    measured_rate = rate_step_response(signals, segments, loop)
    measured_attitude = attitude_step_response(signals, segments)
    # The response of the attitude depends on whether the controller feeds the rate of the setpoint forward.
    controller = None if loop is None else loop.controller
    has_feedforward = has_rate_feedforward(signals, segments, controller)
    if loop is None:
        rate_response = LoopResponse(measured_rate)
        attitude_response = LoopResponse(measured_attitude)
    else:
        predicted_rate = loop.rate.closed_loop_of_estimate
        rate_response = _compared_response(measured_rate, loop, loop.rate, predicted_rate)
        predicted_attitude = predicted_attitude_response(loop, has_feedforward=has_feedforward)
        attitude_response = _compared_response(
            measured_attitude, loop, loop.attitude, predicted_attitude
        )
    return {
        "rate": rate_response,
        "attitude": attitude_response._replace(has_feedforward=has_feedforward),
    }


def advised_steps(responses: Responses, advice_by_axis: AdviceByAxis) -> StepsByLoop:
    """Predicts the step responses with the advised gains, at the times of the measured step responses.

    They are plotted together with the measured ones. So the prediction for the attitude contains the feedforward of the
    setpoint's derivative if the autopilot adds it.

    Args:
        responses: the measured responses of the rate and attitude loop of each axis.
        advice_by_axis: advice on the gains of each axis, or why there is none.

    Returns:
        By axis and then by loop ("rate" or "attitude"), the response (N,) to a unit step of the setpoint, at the N
        times of the measured one. Axes whose gains do not change, and loops without a measured response, are left out.
    """
    steps = dict[str, dict[str, Array]]()
    for axis, response_by_loop in responses.items():
        advice = advice_by_axis.get(axis)
        if not isinstance(advice, Advice) or not advice.parameters:
            # No gain of this axis changes.
            continue
        loop_with_advised_gains = advice.after
        steps[axis] = {}
        for loop_name, response in response_by_loop.items():
            if not isinstance(response.measured, StepResponse):
                continue
            if loop_name == "rate":
                closed_loop = loop_with_advised_gains.rate.closed_loop_of_estimate
            else:
                closed_loop = predicted_attitude_response(
                    loop_with_advised_gains, has_feedforward=response.has_feedforward
                )
            steps[axis][loop_name] = step_from_frequency_response(
                loop_with_advised_gains.rate.frequency, closed_loop, response.measured.time
            )
    return steps


def _compared_response(
    measured_response: StepResponse | Fact, loop: Loop, open_loop: OpenLoop, closed_loop: Complex
) -> LoopResponse:
    """Predicts the response that was measured by the identified loop, and compares the two.

    The step response is predicted from the frequency response of the closed loop by a Fourier transform, and the gain
    |T| is interpolated at the measured frequencies.

    Args:
        measured_response: the measured response of the rate or attitude loop, or why it is not known.
        loop: the axis with its two identified loops, rate and attitude.
        open_loop: open-loop response of the loop whose closed-loop response was measured, rate or attitude.
        closed_loop: (F,) its predicted frequency response from setpoint to rate or angle, at ``open_loop.frequency``.

    Returns:
        The measured response with its prediction. It has no prediction without a measured response, or if the loop is
        unstable, since then the step response grows without limit.
    """
    if isinstance(measured_response, Fact) or not open_loop.is_stable:
        return LoopResponse(measured_response)
    frequency = open_loop.frequency
    return LoopResponse(
        measured=measured_response,
        predicted_step=step_from_frequency_response(frequency, closed_loop, measured_response.time),
        predicted_gain=np.interp(measured_response.frequency, frequency, abs(closed_loop)),
        compared=response_comparison(measured_response, loop, frequency, closed_loop),
    )
