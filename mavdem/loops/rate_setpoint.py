"""What a recorded setpoint of the body rate consists of: the attitude controller's correction, and its feed-forward.

Both autopilots may add the rate of change of the angle's setpoint to the setpoint of the body rate:

- ArduPilot does on all axes if ``ATC_RATE_FF_ENAB`` is set
  (``AC_AttitudeControl::attitude_controller_run_quat``).
- PX4 does for yaw wherever a yaw rate is demanded, as by the stick or in missions: ``AttitudeControl::update`` of
  ``mc_att_control`` adds the ``yaw_sp_move_rate`` of the attitude setpoint. No parameter says so, but the recorded rate
  setpoint contains it.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.segments import Segments
from mavdem.dataset.signals import MIN_SLOW_MOTION_RATE, Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.ingest.vocabulary import wrapped_angle
from mavdem.loops.controllers import Controller
from mavdem.loops.welch import resampled_signals

RATE_FEEDFORWARD_PARAMETER = "ATC_RATE_FF_ENAB"
"""ArduPilot's parameter that adds the derivative of the attitude's setpoint to the setpoint of the rate."""

MIN_PIECE_SECONDS = 1.0
"""Least length of a piece of flight in which setpoints are compared, s: a choice."""

MIN_COEFFICIENT = 0.5
"""Least regression coefficient of a part for a rate setpoint to contain it: nearer to 1 than to 0."""


class AttitudePiece(NamedTuple):
    """A piece of flight without gaps, with N even samples."""

    rate_setpoint: Array
    """(N,) rad/s."""
    angle: Array
    """(N,) rad."""
    angle_setpoint: Array
    """(N,) rad, without steps from π to -π."""


class RateSetpointParts(NamedTuple):
    """Which parts a recorded setpoint of the body rate contains."""

    has_feedforward: bool
    """Whether it contains the derivative of the angle's setpoint."""
    has_correction: bool
    """Whether it contains the attitude controller's correction, angle gain · error of the angle."""


def rate_setpoint_parts(
    sampling_rate: float, pieces: Sequence[AttitudePiece], angle_gain: float
) -> RateSetpointParts:
    """Returns which parts a recorded setpoint of the body rate contains, by a regression on both.

    Args:
        sampling_rate: rate of the samples, Hz.
        pieces: pieces of flight, at least one.
        angle_gain: gain of the attitude controller, 1/s.
    """
    # The derivative is taken piece by piece: between two pieces the angle setpoint jumps.
    slopes = [sampling_rate * np.gradient(piece.angle_setpoint) for piece in pieces]
    corrections = [
        angle_gain * wrapped_angle(piece.angle_setpoint - piece.angle) for piece in pieces
    ]
    regressors = np.column_stack([np.concatenate(slopes), np.concatenate(corrections)])
    rate_setpoint = np.concatenate([piece.rate_setpoint for piece in pieces])
    feedforward, correction = np.linalg.lstsq(regressors, rate_setpoint)[0]
    return RateSetpointParts(
        has_feedforward=bool(feedforward > MIN_COEFFICIENT),
        has_correction=bool(correction > MIN_COEFFICIENT),
    )


def has_rate_feedforward(
    signals: Signals, segments: Segments, controller: Controller | None
) -> bool:
    """Returns whether the autopilot adds the derivative of the angle's setpoint to the setpoint of the body rate.

    Args:
        signals: logged time series of the axis, with its setpoints.
        segments: segments of settled flight.
        controller: controller of the axis; None if it is not known.

    Returns:
        False also if that is not known (:func:`rate_feedforward_if_known`).
    """
    return bool(rate_feedforward_if_known(signals, segments, controller))


def rate_feedforward_if_known(
    signals: Signals, segments: Segments, controller: Controller | None
) -> bool | None:
    """Returns whether the derivative of the angle's setpoint is added to the setpoint of the rate, if the log shows it.

    A parameter of ArduPilot says so. Without it the recorded setpoints decide, except for roll and pitch of PX4, which
    feeds forward yaw only.

    Args:
        signals: logged time series of the axis, with its setpoints.
        segments: segments of settled flight.
        controller: controller of the axis; None if it is not known.

    Returns:
        None for a vehicle without the parameter of which the controller or a setpoint is not known.
    """
    logged_switch = signals.telemetry.parameters.get(RATE_FEEDFORWARD_PARAMETER)
    if logged_switch is not None:
        return bool(logged_switch)
    if signals.telemetry.autopilot == "PX4" and signals.axis != "yaw":
        return False
    if controller is None:
        return None
    setpoint_parts = _recorded_setpoint_parts(signals, segments, controller.angle_gain)
    return None if setpoint_parts is None else setpoint_parts.has_feedforward


def _recorded_setpoint_parts(
    signals: Signals, segments: Segments, angle_gain: float
) -> RateSetpointParts | None:
    """Returns which parts the recorded setpoint of the body rate contains in settled flight.

    Args:
        signals: logged time series of the axis, with its setpoints.
        segments: segments of settled flight.
        angle_gain: gain of the attitude controller, 1/s.

    Returns:
        The parts; None if the rate setpoint or the angle setpoint was not recorded, or too slowly.
    """
    if signals.rate_and_setpoint is None or signals.angle_setpoint is None:
        return None
    # The angle comes with the rate, without which there is no rate setpoint.
    assert signals.attitude is not None
    series = (
        signals.rate_and_setpoint.setpoint,
        unwrapped(signals.attitude.angle_series),
        unwrapped(signals.angle_setpoint),
    )
    resampled = resampled_signals(series, segments, MIN_PIECE_SECONDS, MIN_SLOW_MOTION_RATE)
    if resampled is None:
        return None
    pieces = [AttitudePiece(*piece) for piece in resampled.pieces]
    return rate_setpoint_parts(resampled.rate, pieces, angle_gain)


def unwrapped(angle: TimeSeries) -> TimeSeries:
    """Returns an angle without its steps from π to -π, rad, so that it can be interpolated."""
    return replace(angle, values=np.unwrap(angle.values))
