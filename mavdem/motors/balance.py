"""Balance of the motors in steady flight: roll, pitch and yaw commands relative to the thrust, and the effect of lean.

Wind that a vehicle leans against requires a steady torque too: by the flapping of its rotors, by drag above or below
its centre of mass, or by a load off the centre. How the balance is judged: docs/motors.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.axes import AXES, TILT_AXES
from mavdem.dataset.intervals import (
    Intervals,
    TimeInterval,
    intersection,
    split_at_gaps,
    total_duration,
)
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.phases import TRANSIENT_SECONDS, settled_intervals
from mavdem.dataset.segments import Segment, in_segments, settled_segments
from mavdem.dataset.signals import Signals
from mavdem.dataset.steady_flight import steady_intervals
from mavdem.dataset.vehicle_cache import cached_per_vehicle
from mavdem.motors.motor_balance import MotorBalance
from mavdem.motors.signatures import MotorSignatures, motor_signatures

BLOCK_SECONDS = 3.0
"""Seconds over which commands and lean are averaged: longer than the attitude's motion, shorter than most gusts."""

MIN_BLOCKS = 6
"""Number of blocks from which means and slopes have an error that can be estimated."""

MIN_STEADY_SECONDS = 10.0
"""Seconds of steady flight without which no motor is named.

Of 324 real logs, shorter ones showed gusts and corrections of the pilot.
"""

MAX_GAP = TRANSIENT_SECONDS
"""Seconds without settled flight after which what was before is not a reference: no landing with take-off is
shorter."""

MAX_AUTOCORRELATION = 0.9
"""Upper bound of the autocorrelation of neighbouring blocks: an estimate of 1 would make all errors infinite."""


@dataclass(frozen=True, eq=False)
class SteadyRun:
    """Commands of k motors, and roll and pitch, of a vehicle in one run of steady flight, N samples."""

    time: Array
    """(N,) seconds, rising."""
    commands: Array
    """(N, k) motor outputs as fractions of the range."""
    lean: Array
    """(N, 2) roll and pitch, rad; NaN where they are not known."""


@cached_per_vehicle("axis", "inputs")
def balance_of_steady_flight(signals: Signals) -> MotorBalance | None:
    """Measures the balance of a vehicle's motors in all its steady flight: torque commands relative to the thrust.

    Each segment of settled flight gives one run: the samples of its steady intervals, concatenated.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        The balance, with its standard errors and the effect of the lean; None if there are no motor outputs, or too
        little steady flight.
    """
    motors = signals.motors
    if motors is None:
        return None
    runs = []
    seconds = 0.0
    for segment in sorted(settled_segments(signals)):
        steady = steady_intervals(signals, segment.boot)
        intervals = intersection([(segment.start, segment.end)], steady)
        seconds += total_duration(intervals)
        runs.append(steady_run(signals, motors, segment, intervals))
    return motor_balance(runs, motor_signatures(motors.geometry), seconds)


def steady_run(
    signals: Signals, motors: MotorOutputs, segment: Segment, intervals: Intervals
) -> SteadyRun:
    """Collects the motor commands and the lean (roll and pitch) of a vehicle in intervals of one segment of flight.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        motors: Outputs of its motors.
        segment: Segment of flight, with the boot whose clock the times are on.
        intervals: Intervals of steady flight in this segment, s.
    """
    steady_segments = [Segment(segment.boot, start, end) for start, end in intervals]
    is_steady = in_segments(motors, *steady_segments)
    time = motors.time[is_steady]
    return SteadyRun(
        time=time,
        commands=motors.scale.fraction(motors.outputs[is_steady]),
        lean=_lean_at(signals, segment, time),
    )


def settled_run_around(
    signals: Signals, motors: MotorOutputs, boot: int, time: float, interval: TimeInterval
) -> SteadyRun | None:
    """Returns motor commands and the vehicle's lean in the settled flight (no take-off or landing) around a time.

    The run ends where motor messages are missing for more than ``MAX_GAP``: means over seconds need no closer
    samples. Unlike in other runs (:func:`steady_run`), the flight in between need not be steady.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        motors: Outputs of its motors.
        boot: Number of the boot; a boot lasts from one start of the autopilot to the next.
        time: Time that the run must contain, s since boot.
        interval: Interval to which the run is limited, s since boot.

    Returns:
        The run; None if the time is not in settled flight.
    """
    for start, end in settled_intervals(signals, boot):
        motor_times = motors.time[in_segments(motors, Segment(boot, start, end))]
        for run_start, run_end in split_at_gaps(motor_times, np.diff(motor_times) > MAX_GAP):
            if run_start <= time <= run_end:
                run_intervals = intersection([(run_start, run_end)], [interval])
                return steady_run(signals, motors, Segment(boot, run_start, run_end), run_intervals)
    return None


def _lean_at(signals: Signals, segment: Segment, time: Array) -> Array:
    """Returns roll and pitch at the times of other samples, linearly interpolated.

    Args:
        signals: Logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        segment: Segment of flight, with the boot whose clock the times are on.
        time: (N,) times in the segment, s.

    Returns:
        (N, 2) roll and pitch, rad; NaN where they were not recorded.
    """
    lean = np.full((len(time), len(TILT_AXES)), np.nan)
    if len(signals.tilts) < len(TILT_AXES):
        return lean
    for column, tilt in enumerate(signals.tilts):
        is_in_segment = in_segments(tilt, segment)
        if is_in_segment.any():
            lean[:, column] = np.interp(time, tilt.time[is_in_segment], tilt.angle[is_in_segment])
    return lean


def motor_balance(
    runs: Sequence[SteadyRun], signatures: MotorSignatures, seconds: float
) -> MotorBalance | None:
    """Measures the balance of motors (torque commands relative to the thrust) from runs of steady flight.

    Commands and lean (roll and pitch) are averaged over blocks. The effect of the lean is the slope of a least-squares
    regression of the blocks' balance on their lean. The residuals of the regression give the standard errors, which
    allow for the correlation of neighbouring blocks.

    Args:
        runs: Runs of steady flight.
        signatures: Mixer of the vehicle, with the axes that it controls.
        seconds: Duration of all runs, s.

    Returns:
        The balance; None if the runs are too short, or if the mixer controls no axis but thrust. Without a known lean,
        or if the lean varies too little for a regression, the effect of the lean is NaN.
    """
    blocks = []
    for run in runs:
        blocks += block_means(run, signatures)
    if len(blocks) < MIN_BLOCKS or len(signatures.axes) == 1:
        return None
    balance, lean = np.split(np.array(blocks), [len(AXES)], axis=1)
    regression = _regression_on_lean(balance, lean)
    residuals = regression.residuals
    # Each of roll, pitch and yaw has its own variance and correlation.
    inflation = [variance_inflation(residuals_of_axis) for residuals_of_axis in residuals.T]
    # The variance is estimated from few blocks, so that the errors follow Student's t distribution. Later they are used
    # as normal ones. So they get the variance of Student's t with f degrees of freedom, which is f / (f − 2) times the
    # estimate, squares / f.
    block_variance = (residuals**2).sum(axis=0) / (regression.degrees_of_freedom - 2)
    variance = block_variance * inflation
    return MotorBalance(
        mean=balance.mean(axis=0),
        error=np.sqrt(variance / len(blocks)),
        lean=lean.mean(axis=0),
        lean_effect=regression.slopes,
        lean_effect_error=np.sqrt(variance[:, None] * regression.slope_variance_factors),
        seconds=seconds,
    )


class _LeanRegression(NamedTuple):
    """Least-squares regression of the balance of N blocks on their lean."""

    slopes: Array
    """(3, 2) slopes of the balance in roll, pitch and yaw by roll and pitch; NaN without a regression."""
    slope_variance_factors: Array
    """(3, 2) variances of the slopes, relative to the variance of the blocks; NaN without a regression."""
    residuals: Array
    """(N, 3) balance without the effect of the lean and without its mean."""
    degrees_of_freedom: int
    """Number of blocks, less the number of fitted parameters of each axis."""


def _regression_on_lean(balance: Array, lean: Array) -> _LeanRegression:
    """Regresses the balance of the motors on the vehicle's lean, by ordinary least squares with an intercept.

    Args:
        balance: (N, 3) mean balance in roll, pitch and yaw of N blocks of time.
        lean: (N, 2) mean roll and pitch of each block, rad; NaN where they are not known.

    Returns:
        Slopes, their variance factors, and residuals. If the lean is unknown or does not vary in both axes, the slopes
        are NaN, and the residuals are the deviations from the mean.
    """
    balance_deviations = balance - balance.mean(axis=0)
    lean_deviations = lean - lean.mean(axis=0)
    degrees_of_freedom = len(balance) - 1
    is_lean_known = np.isfinite(lean_deviations).all()
    if not is_lean_known or np.linalg.matrix_rank(lean_deviations) < len(TILT_AXES):
        unknown = np.full((len(AXES), len(TILT_AXES)), np.nan)
        return _LeanRegression(unknown, unknown, balance_deviations, degrees_of_freedom)
    inverse_scatter = np.linalg.inv(lean_deviations.T @ lean_deviations)
    slopes = (inverse_scatter @ lean_deviations.T @ balance_deviations).T
    return _LeanRegression(
        slopes,
        slope_variance_factors=np.broadcast_to(np.diag(inverse_scatter), slopes.shape),
        residuals=balance_deviations - lean_deviations @ slopes.T,
        degrees_of_freedom=degrees_of_freedom - len(TILT_AXES),
    )


def block_means(
    run: SteadyRun, signatures: MotorSignatures, block_seconds: float = BLOCK_SECONDS
) -> list[Array]:
    """Averages the torque commands and the lean of a run over blocks of equal length, ``block_seconds`` or a bit more.

    The torque commands of a block are divided by its thrust, so that neither climb nor battery changes the balance.

    Args:
        run: Motor outputs and attitude of an interval of steady flight.
        signatures: Mixer of the vehicle, which turns motor outputs into thrust and torque commands.
        block_seconds: Least length of a block, s.

    Returns:
        For each block (5,): the mean commands in roll, pitch and yaw, relative to the mean command of all motors, and
        the mean roll and pitch, rad. Blocks without thrust are left out, and so is a run that is shorter than a block.
    """
    time = run.time
    seconds = float(np.ptp(time)) if len(time) else 0.0
    if seconds < block_seconds:
        return []
    # The first row of the mixer is thrust, the others are torques about the axes that the geometry gives.
    axis_commands = run.commands @ signatures.mixer_rows.T
    thrust = axis_commands[:, 0]
    # Axes about which the geometry is not known remain NaN.
    torques = np.full((len(time), len(AXES)), np.nan)
    columns = [AXES.index(axis) for axis in signatures.axes[1:]]
    torques[:, columns] = axis_commands[:, 1:]
    table = np.column_stack([thrust, torques, run.lean])

    # A remainder shorter than a block lengthens all blocks. The last sample, at fraction 1, belongs to the last block.
    block_count = int(seconds / block_seconds)
    elapsed_fraction = (time - time[0]) / seconds
    block_numbers = np.minimum(elapsed_fraction * block_count, block_count - 1).astype(int)
    blocks = []
    for number in np.unique(block_numbers):
        mean = table[block_numbers == number].mean(axis=0)
        mean_thrust = mean[0]
        mean_torques, mean_lean = np.split(mean[1:], [len(AXES)])
        if mean_thrust > 0:
            blocks.append(np.append(mean_torques / mean_thrust, mean_lean))
    return blocks


def variance_inflation(residuals: Array) -> float:
    """Estimates the factor by which the variance of a mean exceeds the variance with independent blocks.

    Neighbouring blocks are correlated, since gusts last longer than a block, so that their mean is less precise than
    that of as many independent blocks. They are modelled as a first-order autoregression whose coefficient ρ is the
    correlation of neighbours; for it the factor is (1 + ρ) / (1 − ρ).

    Args:
        residuals: (N,) deviations of successive blocks from the fit, in the order of time.

    Returns:
        The factor, 1 or more.
    """
    power = float(residuals @ residuals)
    correlation = float(residuals[1:] @ residuals[:-1]) / power if power > 0 else 0.0
    correlation = min(max(correlation, 0.0), MAX_AUTOCORRELATION)
    return (1 + correlation) / (1 - correlation)
