"""Whether feed-forward of its setpoint explains that an axis moves further than the setpoint."""

from math import log

import numpy as np

from mavdem.assessment.evidence import Evidence
from mavdem.assessment.flights import settled_flight
from mavdem.facts import Fact
from mavdem.facts.loops import GainFact
from mavdem.facts.margins import TrackingLight
from mavdem.loops.attitude_response import predicted_attitude_response
from mavdem.loops.axis_loops import Loop
from mavdem.loops.rate_setpoint import RATE_FEEDFORWARD_PARAMETER, has_rate_feedforward


def feedforward_finding(evidence: Evidence, axis: str) -> Fact | None:
    """Returns the fact that an axis overshoots its setpoint because of feed-forward; None if that is not the cause.

    Feed-forward adds the derivative of the angle setpoint to the rate setpoint. The identified loop predicts how far
    the angle moves with it and without it. Feed-forward is the cause if the prediction with it is nearer to what was
    measured. For example, the angle moved 1.4 times as far as its setpoint, and the predictions are 1.3 with
    feed-forward and 1.0 without it.

    Args:
        evidence: signals, loops and tracking of the vehicle.
        axis: "roll", "pitch" or "yaw".

    Returns:
        The fact with the measured ``ratio`` of angle to setpoint at a ``frequency``, Hz, and both predictions. None
        also if the loop is not identified, or if the autopilot is not known to use feed-forward.
    """
    tracking = evidence.tracking.get(axis)
    loop = evidence.loops[axis]
    if tracking is None or tracking.code is not TrackingLight.AMPLIFIES_SETPOINT:
        return None
    signals = evidence.signals.for_axis(axis)
    if not isinstance(loop, Loop):
        return None
    if not has_rate_feedforward(signals, settled_flight(signals), loop.controller):
        return None
    frequency = tracking.figures["frequency"]
    ratio_with_feedforward = _predicted_angle_ratio(loop, frequency, has_feedforward=True)
    ratio_without_feedforward = _predicted_angle_ratio(loop, frequency, has_feedforward=False)
    ratio = tracking.figures["ratio"]
    # Half and twice the measured ratio are equally wrong, so errors are compared by their logarithms.
    error_with_feedforward = abs(log(ratio / ratio_with_feedforward))
    error_without_feedforward = abs(log(ratio / ratio_without_feedforward))
    if error_with_feedforward >= error_without_feedforward:
        return None
    has_switch = RATE_FEEDFORWARD_PARAMETER in signals.telemetry.parameters
    return Fact(
        GainFact.FEEDFORWARD_AMPLIFIES,
        axis=axis,
        frequency=frequency,
        ratio=ratio,
        ratio_with_feedforward=ratio_with_feedforward,
        ratio_without_feedforward=ratio_without_feedforward,
        name=RATE_FEEDFORWARD_PARAMETER if has_switch else "",
    )


def _predicted_angle_ratio(loop: Loop, frequency: float, *, has_feedforward: bool) -> float:
    """Returns the predicted ratio of an angle to its setpoint, such as 1.2 if it moves 20 % further than its setpoint.

    Args:
        loop: the identified rate and attitude loops of the axis.
        frequency: frequency of a sinusoidal setpoint, Hz.
        has_feedforward: whether the autopilot adds the derivative of the angle setpoint to the rate setpoint.
    """
    response = predicted_attitude_response(loop, has_feedforward=has_feedforward)
    return float(np.interp(frequency, loop.attitude.frequency, np.abs(response)))
