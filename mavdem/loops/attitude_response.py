"""Response of an angle to its setpoint, as an identified loop predicts it, with the autopilot's rate feed-forward.

Both autopilots may add the rate of change of the angle's setpoint to the setpoint of the body rate:

- ArduPilot does on all axes if ``ATC_RATE_FF_ENAB`` is set
  (``AC_AttitudeControl::attitude_controller_run_quat``).
- PX4 does for yaw wherever a yaw rate is demanded, as by the stick or in missions: ``AttitudeControl::update`` of
  ``mc_att_control`` adds the ``yaw_sp_move_rate`` of the attitude setpoint. No parameter says so, but the recorded rate
  setpoint contains it.
"""

import numpy as np

from mavdem.dataset.segments import Segments
from mavdem.dataset.signals import MIN_SLOW_MOTION_RATE, Signals
from mavdem.loops.axis_loops import Loop
from mavdem.loops.margins import Complex
from mavdem.loops.rate_setpoint import AttitudePiece, rate_setpoint_parts
from mavdem.loops.step_response import unwrapped
from mavdem.loops.welch import resampled_signals

RATE_FEEDFORWARD_PARAMETER = "ATC_RATE_FF_ENAB"
"""ArduPilot's parameter that adds the derivative of the attitude's setpoint to the setpoint of the rate."""

MIN_PIECE_SECONDS = 1.0
"""Least length of a piece of flight in which setpoints are compared, s: a choice."""


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


def has_rate_feedforward(signals: Signals, segments: Segments, loop: Loop | None) -> bool:
    """Returns whether the autopilot adds the derivative of the angle's setpoint to the setpoint of the body rate.

    Of ArduPilot the parameter says so. PX4 may do it for yaw only, and there the recorded setpoints decide.

    Args:
        signals: logged time series of the axis, with its setpoints.
        segments: segments of settled flight.
        loop: the identified loop of the axis; None without one.

    Returns:
        False also for a PX4 vehicle of which a setpoint was not recorded.
    """
    if signals.telemetry.parameters.get(RATE_FEEDFORWARD_PARAMETER):
        return True
    if signals.telemetry.autopilot != "PX4" or signals.axis != "yaw" or loop is None:
        return False
    if signals.rate_and_setpoint is None or signals.angle_setpoint is None:
        return False
    # The angle comes with the rate, without which there is no rate setpoint.
    assert signals.attitude is not None
    series = (
        signals.rate_and_setpoint.setpoint,
        unwrapped(signals.attitude.angle_series),
        unwrapped(signals.angle_setpoint),
    )
    resampled = resampled_signals(series, segments, MIN_PIECE_SECONDS, MIN_SLOW_MOTION_RATE)
    if resampled is None:
        return False
    pieces = [AttitudePiece(*piece) for piece in resampled.pieces]
    parts = rate_setpoint_parts(resampled.rate, pieces, loop.controller.angle_gain)
    return parts.has_feedforward
