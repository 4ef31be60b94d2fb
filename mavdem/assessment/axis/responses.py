"""Responses: the measured closed loops of each axis, beside those that the identified loops predict."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.evidence import INJECTED, Evidence
from mavdem.dataset.axes import AXES
from mavdem.facts import Fact, Facts
from mavdem.loops.axis_loops import Loop
from mavdem.loops.margins import Complex, OpenLoop
from mavdem.loops.step_response import (
    StepResponse,
    attitude_step_response,
    rate_step_response,
    step_from_frequency_response,
)

FEEDFORWARD = "ATC_RATE_FF_ENAB"
"""ArduPilot's parameter by which the rate of the attitude's setpoint is asked for too."""


class LoopResponse(NamedTuple):
    """One loop of one axis: as ``measured``, or why it is not, and at the same times and frequencies as predicted."""

    measured: StepResponse | Fact
    predicted_step: Array | None = None
    predicted_gain: Array | None = None
    compared: Fact | None = None
    """Whether the two agree, or which is doubted; None without one of them."""

    @property
    def facts(self) -> Facts:
        """What is said of it."""
        if isinstance(self.measured, Fact):
            return (self.measured,)
        return tuple(filter(None, (self.measured.fact, self.compared)))


Responses = Mapping[str, Mapping[str, LoopResponse]]
"""By axis, and by "rate" or "attitude"."""


def responses_of(evidence: Evidence) -> Responses:
    """Returns the responses of "rate" and "attitude" of roll, pitch and yaw, but for injected tests."""
    parts = evidence.settled(INJECTED)
    responses = {}
    for axis in AXES:
        signals = evidence.signals.for_axis(axis)
        loop = evidence.loops.get(axis)
        rate = rate_step_response(signals, parts)
        attitude = attitude_step_response(signals, parts)
        if isinstance(loop, Loop):
            ahead = bool(signals.telemetry.parameters.get(FEEDFORWARD))
            responses[axis] = {
                "rate": _beside(rate, loop.rate, loop.rate.closed[0]),
                "attitude": _beside(attitude, loop.attitude, predicted_attitude(loop, ahead)),
            }
        else:
            responses[axis] = {"rate": LoopResponse(rate), "attitude": LoopResponse(attitude)}
    return responses


def predicted_attitude(loop: Loop, ahead: bool) -> Complex:
    """Returns (F,) the attitude's response, ``ahead`` with the rate of its setpoint asked for too."""
    turns = 2j * np.pi * loop.attitude.frequency / loop.controller.angle_gain
    return loop.attitude.closed[0] * (1 + ahead * turns)


def _beside(measured: StepResponse | Fact, loop: OpenLoop, closed: Complex) -> LoopResponse:
    if isinstance(measured, Fact) or not loop.stable[0]:
        return LoopResponse(measured)
    return LoopResponse(
        measured,
        step_from_frequency_response(loop.frequency, closed, measured.time),
        np.interp(measured.frequency, loop.frequency, abs(closed)),
        measured.comparison(loop.frequency, closed),
    )
