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
    """Returns the finding that feed-forward, and no gain, explains most of how far an axis exceeds its setpoint.

    The identified loop predicts the gain |T| from setpoint to angle with and without the feed-forward. It explains the
    measured gain if the prediction with it is nearer to that by ratio.

    Args:
        evidence: signals, loops and tracking of the vehicle.
        axis: "roll", "pitch" or "yaw".

    Returns:
        The fact with the measured ``ratio`` at a ``frequency``, Hz, and both predictions. None if the axis does not
        exceed its setpoint, if its loop is not identified, or if the autopilot does not feed forward, as far as known.
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
    ratio_with_feedforward = _predicted_ratio(loop, frequency, has_feedforward=True)
    ratio_without_feedforward = _predicted_ratio(loop, frequency, has_feedforward=False)
    ratio = tracking.figures["ratio"]
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


def _predicted_ratio(loop: Loop, frequency: float, *, has_feedforward: bool) -> float:
    """Returns how many times as far as its setpoint an angle moves at a frequency, Hz, as the identified loop predicts.

    Args:
        loop: the loops of the axis.
        frequency: the frequency.
        has_feedforward: whether the autopilot adds the slope of the setpoint to the setpoint of the rate.
    """
    response = predicted_attitude_response(loop, has_feedforward=has_feedforward)
    return float(np.interp(frequency, loop.attitude.frequency, np.abs(response)))
