"""Bayes factors of the causes of a change of the motors' balance in flight: a weak motor, a load, or others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import log
from typing import Any

import numpy as np

from mavdem.arrays import Array
from mavdem.motors.change_statistics import WindowChanges, log_t_density

RISES = np.geomspace(0.05, 0.8, 13)
"""(s,) rises of a weak motor's own command that are considered, relative to the mean command."""

RECOVERIES = np.linspace(0.2, 1.3, len(RISES))
"""(s,) shares of a weak motor's rise that its recovery takes back; the rise may be wrong by a quarter."""

RECOVERIES_PER_LOSS = 5.0
"""Prior odds of the recovery of a weak motor, or of all of them, against the loss of another one; a choice."""

OTHER_CHANGE_SD = 0.06
"""Standard deviation of a change of the balance that is no motor's, relative to the mean command; a choice."""

OTHERS_PER_MOTOR = 0.1
"""Prior odds of a change in yaw alone, or in all axes, against one of a motor.

They are high: the worst mistake is to name a sound motor.
"""

CAUSES_WITHOUT_MOTOR = 3
"""Number of the causes that are no motor's: a change in roll and pitch, in yaw, and in all axes."""


@dataclass(frozen=True, eq=False)
class CauseEvidence:
    """Logarithms of the Bayes factors of all causes of a change of the motors' balance against "nothing changed".

    There are h hypotheses of a motor, w windows since the change, s sizes and k motors.
    """

    rises: Array
    """(h, s, k) rises of the motors' commands under the hypotheses of a motor."""
    motor_log_factors_by_window: Array
    """(h, w) for the hypotheses of a motor, averaged over the sizes, by window."""
    motor_log_factors: Array
    """(h,) for the hypotheses of a motor, with their prior odds, summed over the windows."""
    load_log_factors: Array
    """(w,) for a change in roll and pitch alone, by window."""
    yaw_log_factors: Array
    """(w,) for a change in yaw alone, by window."""
    all_axes_log_factors: Array
    """(w,) for a change in roll, pitch and yaw, by window."""
    other_log_factor: float
    """For a change in yaw alone or in all axes, summed over the windows."""


def log_sum(logarithms: Any) -> Any:
    """Returns the logarithm of the sum of numbers along the first axis, from the array or list of their logarithms."""
    return np.logaddexp.reduce(logarithms)


def cause_evidence(
    changes: WindowChanges,
    no_change: Array,
    signatures: Array,
    tilt_axes: Array,
    weak_motor_sizes: Mapping[int, float],
) -> CauseEvidence:
    """Computes the Bayes factors of all causes of a change against "nothing changed".

    The balance is the torque that the motors make about each of a axes (roll, pitch and yaw), relative to their thrust.
    A Bayes factor is the ratio of two densities of its observed change: under the cause, averaged over the sizes that
    the change may have, and under "nothing changed". It is also not known when the change began: each of w windows is
    one assumption about that, and factors are given by window and summed over the windows.

    Args:
        changes: Change of the balance on a axes for each of w windows.
        no_change: (w,) log density of the changes where nothing changed.
        signatures: (k, a) change of the balance where the own command of a motor rises by 1.
        tilt_axes: (a,) 1 for roll and pitch, 0 for yaw.
        weak_motor_sizes: Rise of the command of each motor that is weak already, by its index.

    Returns:
        Logarithms of the Bayes factors of the motors' causes, of a load, of a change in yaw, and of one about all axes.
    """
    motor_count = len(signatures)
    rises = hypothetical_rises(motor_count, weak_motor_sizes)
    # (h, s, a): h hypotheses, s sizes, a axes.
    expected_changes = rises @ signatures
    # (s, h, 1, a): the sizes come first, since the mixture sums over them; the axis of length 1 broadcasts over the
    # windows.
    expected_by_size = expected_changes.swapaxes(0, 1)[:, :, None]
    # (s, h, w).
    densities = log_t_density(changes, expected_by_size)
    # All sizes are equally probable, and so is the loss of any motor. Recoveries follow the losses.
    motor_log_factors_by_window = log_sum(densities) - log(len(RISES)) - no_change
    motor_log_factors = log_sum(motor_log_factors_by_window.T) - log(motor_count)
    motor_log_factors[motor_count:] += log(RECOVERIES_PER_LOSS)
    load = _log_factors_of_axes(changes, no_change, tilt_axes)
    yaw = _log_factors_of_axes(changes, no_change, 1 - tilt_axes)
    all_axes = _log_factors_of_axes(changes, no_change, np.ones_like(tilt_axes))
    return CauseEvidence(
        rises=rises,
        motor_log_factors_by_window=motor_log_factors_by_window,
        motor_log_factors=motor_log_factors,
        load_log_factors=load,
        yaw_log_factors=yaw,
        all_axes_log_factors=all_axes,
        other_log_factor=float(log_sum([log_sum(yaw), log_sum(all_axes)])),
    )


def log_odds_of_motor_cause(evidence: CauseEvidence, cause: int) -> float:
    """Returns the logarithm of the odds of one motor cause against all other causes and "nothing changed" together.

    The odds are the Bayes factor of the cause over the sum of the Bayes factors of its rivals.

    Args:
        evidence: Logarithms of the Bayes factors of all causes.
        cause: Row of the cause among the hypotheses of the motors.
    """
    other_motor_causes = np.delete(evidence.motor_log_factors, cause)
    load = log_sum(evidence.load_log_factors)
    other_changes = evidence.other_log_factor + log(OTHERS_PER_MOTOR)
    # The Bayes factor of "nothing changed" against itself is 1.
    no_change = 0.0
    rivals = [*other_motor_causes, load, other_changes, no_change]
    return float(evidence.motor_log_factors[cause] - log_sum(rivals))


def _log_factors_of_axes(changes: WindowChanges, no_change: Array, is_changed_axis: Array) -> Array:
    """Returns the log Bayes factors of a cause that changes the balance about some axes by an unknown amount.

    The unknown amount is normal with the standard deviation ``OTHER_CHANGE_SD``, which adds to the variance of these
    axes.

    Args:
        changes: Change of the balance on a axes for each of w windows.
        no_change: (w,) log density of the changes where nothing changed.
        is_changed_axis: (a,) 1 for an axis that the cause changes, otherwise 0.

    Returns:
        (w,) logarithms of the Bayes factors against "nothing changed".
    """
    added_variance = OTHER_CHANGE_SD**2 * is_changed_axis
    return log_t_density(changes, 0.0, added_variance) - no_change


def hypothetical_rises(motor_count: int, weak_motor_sizes: Mapping[int, float]) -> Array:
    """Returns the rise of each motor's command under each hypothesis on which motors changed.

    The controller compensates a loss of thrust by a higher command to the motor, the rise, and lowers it again if the
    motor recovers (for example when ice falls off). There is one hypothesis for the loss of each motor, one for the
    recovery of each weak motor and, if several are weak, one for the joint recovery of all of them. The size of the
    change is not known, so each hypothesis has s sizes: ``RISES`` for a loss, and ``RECOVERIES`` for a recovery, as
    fractions of the rise that the motor had.

    Args:
        motor_count: k, the number of motors.
        weak_motor_sizes: Rise of the command of each motor that is weak already, as a fraction, by its index.

    Returns:
        (h, s, k) rises relative to the mean command of all motors, for h hypotheses: losses by motor, then recoveries
        of single motors, then the joint recovery. They are 0 for motors that do not change, negative for recoveries.
    """
    # Row i of the unit matrix is a rise by 1 of motor i alone.
    unit_rises = np.eye(motor_count)
    weak_rises = [size * unit_rises[motor] for motor, size in weak_motor_sizes.items()]
    recoverable_rises = list(weak_rises)
    # The joint recovery of all weak motors takes back the sum of their rises.
    if len(weak_rises) > 1:
        recoverable_rises.append(sum(weak_rises))
    # Each outer product has one row for each size (s) and one column for each motor (k).
    losses = [np.outer(RISES, unit_rise) for unit_rise in unit_rises]
    recoveries = [np.outer(-RECOVERIES, weak_rise) for weak_rise in recoverable_rises]
    return np.array(losses + recoveries)


def can_reach_threshold(
    changes: WindowChanges, no_change: Array, motor_causes: int, threshold: float
) -> bool:
    """Returns whether any cause could explain the changes of the balance well enough for an alarm.

    This is a quick test before all causes are computed. An alarm needs a large sum of Bayes factors: densities of the
    change under the causes, over its density if nothing changed. No density is higher than under a cause that expects
    exactly the observed change. This largest factor, times the number of terms of the sum, bounds the sum. Most changes
    in flight are so small that even the bound is below the threshold.

    Args:
        changes: Change of the balance for each of w windows (assumptions on when the change began).
        no_change: (w,) log density of the changes where nothing changed.
        motor_causes: Number of losses and of recoveries of single motors.
        threshold: Logarithm of the sum of Bayes factors that an alarm needs.
    """
    # The log density at the expected change itself: the squares of the errors are 0, so only the variance remains.
    log_perfect_density = -np.log(changes.variance).sum(axis=-1) / 2
    largest_log_factor = (log_perfect_density - no_change).max()
    # An alarm compares one of two sums with the threshold: the factors of one cause over all windows, with prior odds
    # of at most ``RECOVERIES_PER_LOSS``, or the factors of all causes in one window. Both together have no more terms
    # than this. The joint recovery of all weak motors is one more cause.
    window_count = len(no_change)
    cause_count = motor_causes + CAUSES_WITHOUT_MOTOR + 1
    term_count = RECOVERIES_PER_LOSS * window_count + cause_count
    return bool(largest_log_factor + log(term_count) >= threshold)
