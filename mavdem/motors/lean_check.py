"""Whether a lasting shift of the trims in flight is beyond what the vehicle's lean against the wind explains.

Wind that freshens or turns for good asks for another steady torque, as a load does that shifts. But the vehicle leans
against that wind too, and the torque is about linear in the lean (``balance.py``). So the balance b of the motors in
blocks of steady flight is fitted by least squares with the lean l of each block and a step at the time of the shift,

    b = b₀ + E l + c · (1 after the shift, 0 before) + noise,

and the shift is beyond the lean if the step c is significant in roll or pitch. Logs and live sessions are judged by it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from typing import NamedTuple

import numpy as np
import scipy

from mavdem.arrays import Array, Flags
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dataset.intervals import TimeInterval
from mavdem.motors.balance import BLOCK_SECONDS, SteadyRun, block_means, variance_inflation
from mavdem.motors.motor_changes import MAX_ONSET_ERROR, MotorChange
from mavdem.motors.signatures import MotorSignatures

MIN_FREEDOM = 3
"""Fewest blocks beyond the coefficients of the fit, with which its errors are known at all; a choice."""

MIN_SIDE_BLOCKS = 4
"""Number of blocks before the shift and after it for which blocks are shortened, as far as ``MIN_BLOCK_SECONDS``.

In flights of a minute only about 10 s follow a shift. Two or three blocks there show no error that is small enough.
"""

MIN_BLOCK_SECONDS = 2.0
"""Least length of a block, s. Blocks of 1.5 s are so alike that up to 7 % of simulated shifts by wind alone passed."""

FALSE_FRACTION = 0.01
"""Fraction of shifts by wind alone that may pass for beyond the lean, by the design of the test; a choice."""


def without_shifts_by_lean(
    changes: Sequence[MotorChange],
    signatures: MotorSignatures,
    run_around: Callable[[MotorChange, TimeInterval], SteadyRun | None],
) -> list[MotorChange]:
    """Removes the changes of the motors' balance that the vehicle's lean against the wind may explain.

    Changes that name a motor are kept. Each of the others is judged by the settled flight around it, from the change
    before it to the one after.

    Args:
        changes: all changes of the motors' balance in one boot, in the order of time.
        signatures: mixer of the vehicle.
        run_around: function that returns the settled flight around a change within an interval, s since boot; None
            without any.

    Returns:
        The other changes, in the same order.
    """
    remaining = []
    for change in changes:
        if change.motor is not None:
            remaining.append(change)
            continue
        run = run_around(change, _interval_between_neighbours(change, changes))
        # Without settled flight around the change, nothing shows that it is more than the lean explains.
        if run is not None and is_beyond_lean(run, signatures, change.onset_time):
            remaining.append(change)
    return remaining


def _interval_between_neighbours(
    change: MotorChange, changes: Sequence[MotorChange]
) -> TimeInterval:
    """Returns the interval from the change of the motors' balance before a given one to the change after it.

    Args:
        change: the change.
        changes: all changes of the motors' balance in the boot, in any order.

    Returns:
        Both ends, s since boot; -inf or inf without a change before or after.
    """
    previous_onset, next_onset = -inf, inf
    for other_change in changes:
        if other_change.onset_time < change.onset_time:
            previous_onset = max(previous_onset, other_change.onset_time)
        elif other_change.onset_time > change.onset_time:
            next_onset = min(next_onset, other_change.onset_time)
    return previous_onset, next_onset


def is_beyond_lean(run: SteadyRun, signatures: MotorSignatures, onset_time: float) -> bool:
    """Returns whether the trims shifted in roll or pitch by more than the lean of the vehicle explains.

    The balance of the motors in blocks of steady flight is fitted by the lean of each block and a step at the onset.
    The step is compared with its error, which allows for the correlation of neighbouring blocks. Samples within the
    error of the onset belong to neither side.

    Args:
        run: motor outputs and lean in steady flight before and after the shift, with no other change of the motors.
        signatures: mixer of the vehicle.
        onset_time: when the trims shifted, s.

    Returns:
        Whether the step is significant in roll or pitch; False if too little flight or an unknown lean leaves it open.
    """
    is_before = run.time < onset_time - MAX_ONSET_ERROR
    is_after = run.time > onset_time + MAX_ONSET_ERROR
    if not is_before.any() or not is_after.any():
        return False
    seconds_of_shorter_side = min(np.ptp(run.time[is_before]), np.ptp(run.time[is_after]))
    block_seconds = float(
        np.clip(seconds_of_shorter_side / MIN_SIDE_BLOCKS, MIN_BLOCK_SECONDS, BLOCK_SECONDS)
    )
    blocks_before = block_means(_selected(run, is_before), signatures, block_seconds)
    blocks_after = block_means(_selected(run, is_after), signatures, block_seconds)
    if not blocks_before or not blocks_after:
        return False
    blocks = np.array(blocks_before + blocks_after)
    is_block_after = np.arange(len(blocks)) >= len(blocks_before)
    step = _fitted_step(blocks, is_block_after)
    if step is None:
        return False
    # Student's t test at the level ``FALSE_FRACTION``, divided among two axes and the two directions of a step.
    tail_probability = FALSE_FRACTION / (2 * len(TILT_AXES))
    limit = scipy.special.stdtrit(step.freedom, 1 - tail_probability)
    # Constant commands have no error, so that the step is not divided by it.
    is_significant = abs(step.size) > limit * step.error
    tilt_columns = [AXES.index(axis) for axis in TILT_AXES]
    return bool(is_significant[tilt_columns].any())


class _FittedStep(NamedTuple):
    """The step of the balance that is left when the effect of the lean is taken away."""

    size: Array
    """(3,) step about roll, pitch and yaw: c in the equation at the head of this file."""
    error: Array
    """(3,) its standard error."""
    freedom: int
    """Degrees of freedom of the error."""


def _fitted_step(blocks: Array, is_after: Flags) -> _FittedStep | None:
    """Fits the balance of the motors by a constant, the lean of the vehicle, and a step at the time of a shift.

    It is a linear regression by least squares. The error of the step allows for the correlation of neighbouring blocks.

    Args:
        blocks: (N, 5) balance about roll, pitch and yaw, and lean in roll and pitch, rad, of N blocks.
        is_after: (N,) whether each block is after the shift.

    Returns:
        The step; None if the lean of a block is not known, or the blocks do not determine the step and its error.
    """
    # The coefficients of a constant, of the step, and of both angles of the lean.
    coefficient_count = 2 + len(TILT_AXES)
    degrees_of_freedom = len(blocks) - coefficient_count
    if degrees_of_freedom < MIN_FREEDOM or not np.isfinite(blocks).all():
        return None
    balance, lean = np.split(blocks, [len(AXES)], axis=1)
    centred_lean = lean - lean.mean(axis=0)
    regressors = np.column_stack([np.ones(len(blocks)), is_after, centred_lean])
    if np.linalg.matrix_rank(regressors) < coefficient_count:
        return None
    inverse = np.linalg.inv(regressors.T @ regressors)
    coefficients = inverse @ regressors.T @ balance
    residuals = balance - regressors @ coefficients
    block_variance = (residuals**2).sum(axis=0) / degrees_of_freedom
    inflation = np.array([variance_inflation(axis_residuals) for axis_residuals in residuals.T])
    # The step has the second regressor.
    step = coefficients[1]
    step_error = np.sqrt(block_variance * inflation * inverse[1, 1])
    return _FittedStep(step, step_error, degrees_of_freedom)


def _selected(run: SteadyRun, selection: Flags) -> SteadyRun:
    """Returns the selected samples of a run.

    Args:
        run: motor outputs and lean in steady flight, N samples.
        selection: (N,) whether each sample is selected.
    """
    return SteadyRun(run.time[selection], run.commands[selection], run.lean[selection])
