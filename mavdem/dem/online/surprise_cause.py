"""What caused a surprise: a manoeuvre that the model predicts wrongly, or a disturbance.

In a manoeuvre the motors cause the angular acceleration: it follows their command with their lag, however much the
model errs. A disturbance accelerates the vehicle first, and the command then opposes it. So the share of the
acceleration that the command explains tells the two apart. The model itself could not: learned in the closed loop of a
calm flight, where the command follows the disturbance, its control effectiveness may even have the wrong sign.
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
"""Time before ``CAUSE_SECONDS`` in which the lagged command forgets where it began, s: eight of the longest lags."""

CAUSE_SAMPLE_SECONDS = CAUSE_SECONDS + SETTLING_SECONDS
"""Length of the samples that a decision takes, s, besides a window of the derivatives."""

MIN_EXPLAINED_SHARE = 0.6
"""Share of the acceleration that the command explains, from which on a surprise is a misfit of the model.

Chosen on simulated flights of even numbers (``tools/validation/surprise.py``).
"""


def cause_of_surprise(
    command: Array, outputs: Array, dt: float, settings: CompleteSettings
) -> SurpriseCause | None:
    """Decides whether a misfit of the model or a disturbance made the free energy of the latest samples drop.

    Args:
        command: (T,) command of the axis: the combination of the motors' outputs that turns the vehicle, positive where
            it accelerates the last output.
        outputs: (T, m) outputs of the same samples, without a gap; the last one is the body rate.
        dt: Sampling step, s.
        settings: Settings of the model, whose embedding window gives the acceleration.

    Returns:
        The cause; None where there are too few samples, or nothing varies.
    """
    share = explained_share(command, outputs, dt, settings)
    if share is None:
        return None
    if share >= MIN_EXPLAINED_SHARE:
        return SurpriseCause.MODEL_MISFIT
    return SurpriseCause.DISTURBANCE


def explained_share(
    command: Array, outputs: Array, dt: float, settings: CompleteSettings
) -> float | None:
    """Returns the share of the acceleration that the command explains, over the last ``CAUSE_SECONDS``.

    It is the coefficient of determination (R²) of a regression of the measured acceleration on the command with a lag
    of first order, the largest over ``MOTOR_LAGS``. A lag with a negative slope explains nothing.

    Args:
        command: (T,) command of the axis.
        outputs: (T, m) outputs of the same samples.
        dt: Sampling step, s.
        settings: Settings of the model.

    Returns:
        The share; None where there are too few samples, or nothing varies.
    """
    latest = round(CAUSE_SECONDS / dt)
    window = settings.window
    sample_count = latest + round(SETTLING_SECONDS / dt) + window - 1
    if settings.p < 1 or len(outputs) < sample_count:
        return None
    # Both accelerations are smoothed by the window that the measured derivative is taken from.
    center = window // 2
    m = outputs.shape[1]
    derivatives = embed(outputs[-sample_count:], settings.p, dt, window, center)
    measured = derivatives[-latest:, 2 * m - 1]
    lagged_commands = _lagged_commands(command[-sample_count:], dt)
    by_command = embed(lagged_commands, settings.p, dt, window, center)
    by_command = by_command[-latest:, : len(MOTOR_LAGS)]
    covariance = np.cov(measured, by_command, rowvar=False)
    variances = covariance.diagonal()
    if not (variances > 0.0).all():
        return None
    correlations = covariance[0, 1:] / np.sqrt(variances[0] * variances[1:])
    return float(max(correlations.max(), 0.0) ** 2)


def _lagged_commands(command: Array, dt: float) -> Array:
    """Returns the command (T,) with each of the lags of ``MOTOR_LAGS``, (T, lags), from its first value."""
    decays = np.exp(-dt / np.array(MOTOR_LAGS))
    lagged = np.empty((len(command), len(decays)))
    lagged[0] = command[0]
    for sample in range(1, len(command)):
        lagged[sample] = decays * lagged[sample - 1] + (1 - decays) * command[sample]
    return lagged
