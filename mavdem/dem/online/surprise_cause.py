"""What caused a surprise: a manoeuvre that the model predicts wrongly, or a disturbance.

Two properties of the motors' command decide.

- In a manoeuvre the motors cause the angular acceleration. So the acceleration follows the command with the lag of the
  motors. A disturbance accelerates the vehicle first, and the command then opposes it, so that the command explains
  little of the acceleration (:func:`explained_share`).
- After a manoeuvre the body rate is what it was, and so is the command. A lasting disturbance must be balanced, so that
  the command stays away from its former value (:func:`sustained_fraction`).

The learned model is not used for this. It was learned in closed loop: in a calm flight the command follows the
disturbance, and the model's control effectiveness may even have the wrong sign.
"""

from __future__ import annotations

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.engine.generalized_coordinates import embed
from mavdem.dem.settings import CompleteSettings
from mavdem.facts.online import SurpriseCause

CAUSE_SECONDS = 1.5
"""Length of the time before a mark that shows its cause, s.

The evidence of a mark is averaged over one second; half a second more shows what came first.
"""

MOTOR_LAGS = (0.01, 0.02, 0.04, 0.07, 0.12)
"""Time constants that are tried for the motors' lag, s: from small racing motors to large propellers."""

SETTLING_SECONDS = 1.0
"""Time before ``CAUSE_SECONDS`` in which the first value of the lagged command decays, s: eight of the longest lags."""

REFERENCE_SECONDS = 10.0
"""Time before ``CAUSE_SECONDS`` that shows the usual command, s: as long as the past of a surprise."""

MIN_EXPLAINED_SHARE = 0.6
"""Fraction of the acceleration that the command explains, below which a surprise is a disturbance.

Chosen on simulated flights of even numbers (``tools/validation/surprise.py``).
"""

MAX_SUSTAINED_FRACTION = 0.8
"""Fraction of the command's deviation that is constant, above which a surprise is a disturbance; chosen in the same
way."""


def cause_of_surprise(
    command: Array, outputs: Array, dt: float, settings: CompleteSettings
) -> SurpriseCause | None:
    """Decides whether a misfit of the model or a disturbance made the free energy of the latest samples drop.

    Args:
        command: (T,) command of the axis: the combination of the motors' outputs that turns the vehicle. A positive
            command accelerates the last output.
        outputs: (T, m) outputs of the same samples, without a gap; the last one is the body rate.
        dt: Sampling step, s.
        settings: Settings of the model, whose embedding window gives the acceleration.

    Returns:
        The cause; None if there are too few samples, or nothing varies.
    """
    share_by_command = explained_share(command, outputs, dt, settings)
    if share_by_command is None:
        return None
    # If the command does not explain the acceleration, something else moved the vehicle.
    if share_by_command < MIN_EXPLAINED_SHARE:
        return SurpriseCause.DISTURBANCE
    # A command that is sustained counters something that pushes the vehicle.
    if sustained_fraction(command, dt) > MAX_SUSTAINED_FRACTION:
        return SurpriseCause.DISTURBANCE
    return SurpriseCause.MODEL_MISFIT


def sustained_fraction(command: Array, dt: float) -> float:
    """Returns the fraction of the command's deviation over the last ``CAUSE_SECONDS`` that is constant.

    The deviation is measured from the median command in the ``REFERENCE_SECONDS`` before. The fraction is the square of
    the deviation's mean over its mean square: 1 for a constant deviation, 0 for one that averages to zero. Over a
    manoeuvre the torque of the motors averages to almost zero, since the body rate returns to its former value. A
    constant deviation, in contrast, opposes an external torque.

    Args:
        command: (T,) command of the axis, longer than ``CAUSE_SECONDS``; it must vary.
        dt: Sampling step, s.

    Returns:
        The fraction, 0 to 1.
    """
    latest_count = round(CAUSE_SECONDS / dt)
    reference_count = round(REFERENCE_SECONDS / dt)
    reference_command = command[-latest_count - reference_count : -latest_count]
    deviations = command[-latest_count:] - np.median(reference_command)
    return float(deviations.mean() ** 2 / np.mean(deviations**2))


def explained_share(
    command: Array, outputs: Array, dt: float, settings: CompleteSettings
) -> float | None:
    """Returns the fraction of the acceleration that the command explains, over the last ``CAUSE_SECONDS``.

    The measured angular acceleration is regressed on the command after a first-order lag, with each of the
    ``MOTOR_LAGS``. The fraction is the largest coefficient of determination (R²). If the slope is negative, so that the
    acceleration opposes the command, it is 0.

    Args:
        command: (T,) command of the axis.
        outputs: (T, m) outputs of the same samples.
        dt: Sampling step, s.
        settings: Settings of the model.

    Returns:
        The fraction; None if there are too few samples, or nothing varies.
    """
    latest_count = round(CAUSE_SECONDS / dt)
    window = settings.window
    sample_count = latest_count + round(SETTLING_SECONDS / dt) + window - 1
    if settings.p < 1 or len(outputs) < sample_count:
        return None
    # Both accelerations are smoothed by the window from which the measured derivative is computed.
    center = window // 2
    output_count = outputs.shape[1]
    # The columns are all outputs, then all their first derivatives, and so on. The acceleration is the first derivative
    # of the last output, the body rate.
    embedded_outputs = embed(outputs[-sample_count:], settings.p, dt, window, center)
    column_of_acceleration = 2 * output_count - 1
    acceleration = embedded_outputs[-latest_count:, column_of_acceleration]
    # Only the smoothed values of the lagged commands are used, which are the columns before the derivatives.
    lagged_commands = _lagged_commands(command[-sample_count:], dt)
    embedded_commands = embed(lagged_commands, settings.p, dt, window, center)
    commanded_accelerations = embedded_commands[-latest_count:, : len(MOTOR_LAGS)]
    # Row and column 0 are the measured acceleration, the others the commanded one with each motor lag.
    covariance = np.cov(acceleration, commanded_accelerations, rowvar=False)
    variances = covariance.diagonal()
    if not (variances > 0.0).all():
        return None
    correlations = covariance[0, 1:] / np.sqrt(variances[0] * variances[1:])
    largest_correlation = float(correlations.max())
    return max(largest_correlation, 0.0) ** 2


def _lagged_commands(command: Array, dt: float) -> Array:
    """Returns the command after a first-order lag with each of the time constants ``MOTOR_LAGS``.

    Args:
        command: (T,) command; each lagged command begins with its first value.
        dt: Sampling step, s.

    Returns:
        (T, lags) lagged commands.
    """
    decays = np.exp(-dt / np.array(MOTOR_LAGS))
    lagged_commands = np.empty((len(command), len(decays)))
    lagged_commands[0] = command[0]
    for sample in range(1, len(command)):
        lagged_commands[sample] = (
            decays * lagged_commands[sample - 1] + (1 - decays) * command[sample]
        )
    return lagged_commands
