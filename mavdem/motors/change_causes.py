"""Bayes factors of the causes of a change of the motors' balance in flight: a weak motor, a load, or others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import log
from typing import Any, NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.dataset.axes import TILT_COLUMNS, YAW
from mavdem.motors.change_statistics import WindowChanges, log_t_density
from mavdem.motors.motor_changes import CauseProbabilities

RISES = np.geomspace(0.05, 0.8, 13)
"""(s,) rises of a weak motor's own command that are considered, relative to the mean command."""

RECOVERIES = np.linspace(0.2, 1.3, len(RISES))
"""(s,) fractions of a weak motor's rise that its recovery takes back; the rise may be wrong by a quarter."""

RECOVERIES_PER_LOSS = 5.0
"""Prior odds of the recovery of a weak motor, or of all of them, against the loss of another one; a choice."""

OTHER_CHANGE_SD = 0.06
"""Standard deviation of a change of the balance that is not a motor's, relative to the mean command; a choice."""

OTHERS_PER_MOTOR = 0.1
"""Prior odds of a change in yaw alone, or in all axes, against one of a motor.

They are high: the worst mistake is to name a sound motor.
"""

LOADS_PER_MOTOR = 0.5
"""Prior odds of a load that shifts suddenly in flight, against a motor that loses thrust.

The largest of five values by which no motor of one half of 124 simulated flights was named later, and the smallest by
which none was named falsely; of 41 loads that shifted in the other half one was named as a motor, instead of three.
"""

IS_YAW = np.array([0.0, 0.0, 1.0])
"""(a,) 1 for yaw and 0 for roll and pitch: the axes of a balance."""

YAW_PER_TILT = np.geomspace(2.0, 16.0, 7)
"""Ratios of the yaw command for a torque to the roll or pitch command for the same torque, that are considered.

It is the lever arm of the rotors over the ratio of their torque to their thrust. That ratio is 0.05 to 0.08 propeller
diameters for common propellers (UIUC Propeller Data Site), and the rotors of a frame are 0.5 to 0.8 diameters to the
side: 6 to 16. The simulators' models of the Iris have 2 to 4.
"""

LEVEL_ERROR = np.radians(1.0)
"""Standard deviation, rad, of the tilt of the rotor plane about that of the autopilot, as mounted: a choice."""

UNKNOWN_LEAN_SD = np.radians(6.0)
"""Standard deviation, rad, of a lean that is not known: that of a hover in a moderate breeze. A choice."""

CAUSES_WITHOUT_MOTOR = 3
"""Number of the causes that are not a motor's: a change in roll and pitch, in yaw, and in all axes."""


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
    """(w,) for a shifted load, which changes roll and pitch, and yaw by the lean, by window."""
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
    log_density_without_change: Array,
    signatures: Array,
    lean: Array,
    weak_motor_sizes: Mapping[int, float],
) -> CauseEvidence:
    """Computes the Bayes factors of all causes of a change against "nothing changed".

    The balance is the torque that the motors make about each of a axes (roll, pitch and yaw), relative to their thrust.
    A Bayes factor is the ratio of two densities of its observed change: under the cause, averaged over the sizes that
    the change may have, and under "nothing changed". It is also not known when the change began: each of w windows is
    one assumption about that, and factors are given by window and summed over the windows.

    Args:
        changes: Change of the balance on a axes for each of w windows.
        log_density_without_change: (w,) log density of the changes if nothing changed.
        signatures: (k, a) change of the balance where the own command of a motor rises by 1.
        lean: (w, 2) mean roll and pitch of the vehicle in each window, rad; NaN where they are not known.
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
    motor_log_factors_by_window = log_sum(densities) - log(len(RISES)) - log_density_without_change
    motor_log_factors = log_sum(motor_log_factors_by_window.T) - log(motor_count)
    motor_log_factors[motor_count:] += log(RECOVERIES_PER_LOSS)
    load = _log_factors_of_load(changes, log_density_without_change, lean)
    yaw = _log_factors_of_axes(changes, log_density_without_change, IS_YAW)
    all_axes = _log_factors_of_axes(changes, log_density_without_change, np.ones_like(IS_YAW))
    return CauseEvidence(
        rises=rises,
        motor_log_factors_by_window=motor_log_factors_by_window,
        motor_log_factors=motor_log_factors,
        load_log_factors=load,
        yaw_log_factors=yaw,
        all_axes_log_factors=all_axes,
        other_log_factor=float(log_sum([log_sum(yaw), log_sum(all_axes)])),
    )


def log_odds_of_motor_cause(
    evidence: CauseEvidence, cause: int, loads_per_motor: float = LOADS_PER_MOTOR
) -> float:
    """Returns the logarithm of the odds of one motor cause against all other causes and "nothing changed" together.

    The odds are the Bayes factor of the cause over the sum of the Bayes factors of its rivals.

    Args:
        evidence: Logarithms of the Bayes factors of all causes.
        cause: Row of the cause among the hypotheses of the motors.
        loads_per_motor: Prior odds of a load that shifted, against one of a motor.
    """
    other_motor_causes = np.delete(evidence.motor_log_factors, cause)
    load = log_sum(evidence.load_log_factors) + log(loads_per_motor)
    other_changes = evidence.other_log_factor + log(OTHERS_PER_MOTOR)
    # The Bayes factor of "nothing changed" against itself is 1.
    nothing_changed = 0.0
    rivals = [*other_motor_causes, load, other_changes, nothing_changed]
    return float(evidence.motor_log_factors[cause] - log_sum(rivals))


def _log_factors_of_axes(
    changes: WindowChanges, log_density_without_change: Array, is_changed_axis: Array
) -> Array:
    """Returns the log Bayes factors of a cause that changes the balance about some axes by an unknown amount.

    The unknown amount is normal with the standard deviation ``OTHER_CHANGE_SD``, which adds to the variance of these
    axes.

    Args:
        changes: Change of the balance on a axes for each of w windows.
        log_density_without_change: (w,) log density of the changes if nothing changed.
        is_changed_axis: (a,) 1 for an axis that the cause changes, otherwise 0.

    Returns:
        (w,) logarithms of the Bayes factors against "nothing changed".
    """
    added_variance = OTHER_CHANGE_SD**2 * is_changed_axis
    return log_t_density(changes, 0.0, added_variance) - log_density_without_change


def cause_probabilities(evidence: CauseEvidence, selection: Flags) -> CauseProbabilities:
    """Returns the posterior probabilities that a shifted load or a weak motor changed the balance of the motors.

    By Bayes' theorem they are the prior odds of each cause multiplied with its Bayes factor, and normalised. The prior
    odds are relative to those of a weak motor.

    Args:
        evidence: Logarithms of the Bayes factors of all causes by window; each window is an assumption when the change
            began.
        selection: (w,) whether the change may have begun in a window.

    Returns:
        The probabilities. What they lack to 1 is the probability of a change in yaw alone, or in all axes.
    """
    # The Bayes factor of a weak motor is the mean over the hypotheses which motor it is. All windows are equally
    # probable, so that the Bayes factors of a cause are added over the windows.
    hypothesis_count = len(evidence.motor_log_factors)
    selected_log_factors = evidence.motor_log_factors_by_window[:, selection]
    log_odds_by_hypothesis = log_sum(selected_log_factors.T) - log(hypothesis_count)
    motor_log_odds = log_sum(log_odds_by_hypothesis)
    # The first k hypotheses are the loss of thrust of each of the k motors; recoveries follow.
    motor_count = evidence.rises.shape[-1]
    likeliest_motor = int(np.argmax(log_odds_by_hypothesis[:motor_count]))
    likeliest_log_odds = log_odds_by_hypothesis[likeliest_motor]
    load_log_odds = log_sum(evidence.load_log_factors[selection]) + log(LOADS_PER_MOTOR)
    yaw_log_odds = log_sum(evidence.yaw_log_factors[selection]) + log(OTHERS_PER_MOTOR)
    all_axes_log_odds = log_sum(evidence.all_axes_log_factors[selection]) + log(OTHERS_PER_MOTOR)
    log_sum_of_causes = log_sum([load_log_odds, motor_log_odds, all_axes_log_odds, yaw_log_odds])
    return CauseProbabilities(
        load=float(np.exp(load_log_odds - log_sum_of_causes)),
        motor=float(np.exp(motor_log_odds - log_sum_of_causes)),
        likeliest_motor=likeliest_motor,
        likeliest_motor_probability=float(np.exp(likeliest_log_odds - log_sum_of_causes)),
    )


def _log_factors_of_load(
    changes: WindowChanges, log_density_without_change: Array, lean: Array
) -> Array:
    """Returns the log Bayes factors of a load that shifted, by unknown distances forward and to the right.

    A load changes roll and pitch by amounts R and P that are normal with the standard deviation ``OTHER_CHANGE_SD``
    beforehand, so that given the measured changes they are normal too. They decide the change of yaw by the lean
    (:func:`_yaw_change_of_load`), up to a ratio, over whose values ``YAW_PER_TILT`` the factor is averaged.

    Args:
        changes: Change of the balance in roll, pitch and yaw for each of w windows.
        log_density_without_change: (w,) log density of the changes if nothing changed.
        lean: (w, 2) mean roll and pitch of the vehicle in each window, rad; NaN where they are not known.

    Returns:
        (w,) logarithms of the Bayes factors against "nothing changed".
    """
    prior_variance = OTHER_CHANGE_SD**2
    measured_variance = changes.variance[:, TILT_COLUMNS]
    # Posterior means and variances (w, 2) of R and P: a normal prior of mean 0 shrinks the measured changes.
    shrinkage = prior_variance / (prior_variance + measured_variance)
    tilt_change = shrinkage * changes.change[:, TILT_COLUMNS]
    tilt_variance = shrinkage * measured_variance
    yaw_change = _yaw_change_of_load(tilt_change, tilt_variance, lean)
    # Mean and variance of the changes by a load: an axis for the ratios, then windows, then roll, pitch and yaw.
    ratios = YAW_PER_TILT[:, None]
    expected = np.zeros((len(YAW_PER_TILT), *changes.change.shape))
    expected[..., YAW] = ratios * yaw_change.mean
    added_variance = np.full(expected.shape, prior_variance)
    added_variance[..., YAW] = ratios**2 * yaw_change.variance
    densities = log_t_density(changes, expected, added_variance)
    return np.asarray(log_sum(densities) - log(len(YAW_PER_TILT)) - log_density_without_change)


class _YawChange(NamedTuple):
    """Change of the yaw command for each of w windows, divided by the ratio of yaw to tilt commands for one torque."""

    mean: Array
    """(w,) its mean."""
    variance: Array
    """(w,) its variance."""


def _yaw_change_of_load(tilt_change: Array, tilt_variance: Array, lean: Array) -> _YawChange:
    """Predicts by how much a shifted load changes the yaw command, from the changes of the roll and pitch commands.

    The torque of all forces of the air about the centre of mass changes by their sum times the distance that the centre
    moved. In steady flight that sum is opposite to the weight, so that its direction in the body is known from the
    lean: with roll φ, pitch θ, the changes R and P of the roll and pitch commands, and the ratio κ of the yaw command
    to a tilt command for the same torque, the change of the yaw command is

        Y = κ (R tan θ / cos φ − P tan φ).

    Args:
        tilt_change: (w, 2) expected R and P for each of w windows.
        tilt_variance: (w, 2) their variances.
        lean: (w, 2) roll and pitch, rad; NaN where they are not known.

    Returns:
        Mean and variance of Y / κ.
    """
    lean_sd = np.full(lean.shape, float(LEVEL_ERROR))
    lean_sd[~np.isfinite(lean)] = UNKNOWN_LEAN_SD
    roll, pitch = np.nan_to_num(lean).T
    # (w, 2) derivatives of Y / κ by R and P. For a small lean they are the pitch and minus the roll, so that their
    # variances are those of the pitch and of the roll: the columns change places.
    slopes = np.column_stack([np.tan(pitch) / np.cos(roll), -np.tan(roll)])
    slope_variances = lean_sd[:, ::-1] ** 2
    # The variance of a product of independent factors.
    squared_changes = tilt_change**2 + tilt_variance
    variances = slopes**2 * tilt_variance + slope_variances * squared_changes
    return _YawChange(
        mean=(slopes * tilt_change).sum(axis=1),
        variance=variances.sum(axis=1),
    )


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
    changes: WindowChanges, log_density_without_change: Array, motor_causes: int, threshold: float
) -> bool:
    """Returns whether any cause could explain the changes of the balance well enough for an alarm.

    This is a quick test before the causes are computed: most changes in flight are too small for an alarm. The Bayes
    factor of a cause is the density of the change under this cause over its density if nothing changed. It is largest
    for a cause that expects exactly the observed change. An alarm compares one of two sums of Bayes factors with the
    threshold: that of one cause over all windows, or that of all causes in one window. The largest factor, times the
    number of terms in both sums, bounds each of them.

    Args:
        changes: Change of the balance for each of w windows (assumptions on when the change began).
        log_density_without_change: (w,) log density of the changes if nothing changed.
        motor_causes: Number of losses and of recoveries of single motors.
        threshold: Logarithm of the sum of Bayes factors that an alarm needs.
    """
    # A cause that expects the observed change has errors of 0, so that only the variance remains of its log density.
    log_density_of_exact_cause = -np.log(changes.variance).sum(axis=-1) / 2
    largest_log_factor = (log_density_of_exact_cause - log_density_without_change).max()
    # Prior odds weight the Bayes factors of a cause: at most ``RECOVERIES_PER_LOSS``, as much as so many terms.
    terms_over_windows = RECOVERIES_PER_LOSS * len(log_density_without_change)
    joint_recovery_of_weak_motors = 1
    terms_over_causes = motor_causes + joint_recovery_of_weak_motors + CAUSES_WITHOUT_MOTOR
    log_bound = largest_log_factor + log(terms_over_windows + terms_over_causes)
    return bool(log_bound >= threshold)
