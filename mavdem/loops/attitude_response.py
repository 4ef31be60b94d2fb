"""Response of an angle to its setpoint, as an identified loop predicts it, with the autopilot's rate feed-forward."""

import numpy as np

from mavdem.loops.axis_loops import Loop
from mavdem.loops.margins import Complex


def predicted_attitude_response(loop: Loop, *, has_feedforward: bool) -> Complex:
    """Returns the frequency response of the attitude to its setpoint at F frequencies, as the loop predicts it.

    The attitude controller demands the rate K (setpoint − angle), with the angle gain K, 1/s; the response of the angle
    to its setpoint is then T. Feedforward adds the derivative of the setpoint, jω setpoint, to the demanded rate. This
    acts as if the setpoint were (1 + jω/K) times as large, so that the response becomes T (1 + jω/K).

    Args:
        loop: the identified loops of the axis.
        has_feedforward: whether the derivative of the setpoint is added to the setpoint of the rate.

    Returns:
        (F,) at ``loop.attitude.frequency``.
    """
    closed_loop = loop.attitude.closed_loop_of_estimate
    if not has_feedforward:
        return closed_loop
    feedforward = 2j * np.pi * loop.attitude.frequency / loop.controller.angle_gain
    return closed_loop * (1 + feedforward)
