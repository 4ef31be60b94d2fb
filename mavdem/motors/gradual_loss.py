"""Detection of a motor that lost thrust slowly within a flight, by a comparison over the whole flight so far.

The sequential test of a live session (``loss_detection.py``) looks for a change within the last seconds. A loss that
takes ten seconds or more moves its reference along, and on a vehicle with six or eight motors the neighbours of the
weak one hide most of it. So after a flight, and each second of a live one, the balance b is fitted by a ramp,

    b(t) = b₀ + c · min(max((t − t₀) / d, 0), 1) + noise,

for all beginnings t₀ and many durations d, by least squares. The change c of the best ramp is that of a motor if it is
large, significant, in line with the signature of this motor, and with no other's. The noise is correlated: its long-run
variance counts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Indices
from mavdem.confidence import STRONG_EVIDENCE_NATS
from mavdem.ingest.motors import MotorGeometry
from mavdem.motors.balance_blocks import MIN_PRESENT_FRACTION
from mavdem.motors.balance_model import BalanceModel
from mavdem.motors.change_causes import (
    LOADS_PER_MOTOR,
    CauseEvidence,
    cause_evidence,
    log_odds_of_motor_cause,
)
from mavdem.motors.change_statistics import (
    BLOCK_SECONDS,
    BLOCKS_PER_FREEDOM,
    PRIOR_FREEDOM,
    WANDER_SD,
    WindowChanges,
    log_t_density,
    long_run_variance,
)
from mavdem.motors.loss_detection import PRIOR_BLOCK_SD
from mavdem.motors.motor_changes import MAX_ONSET_ERROR, MIN_LOSS_SECONDS, MotorChange
from mavdem.motors.signatures import motor_signatures

MIN_BEFORE_SECONDS = 4.0
"""Seconds of settled flight that must precede the change: enough blocks for a mean balance."""

MAX_BLOCKS = 240
"""Number of blocks into which a flight is divided at most; longer flights get longer blocks. Two minutes of half
seconds: a change needs no finer time than that."""

RAMP_FRACTIONS = (0.0, 0.05, 0.1, 0.2, 0.4, 0.6, 1.0)
"""Durations of the ramp that are tried, as fractions of the flight; a choice."""

MIN_WORK_RISE = 0.18
"""Rise of a weak motor's work, as a fraction, from which on it is named.

In 60 runs of settled flight in real logs without a motor fault, significant changes in line with a motor's signature
were at most 0.12.
"""

MIN_SIGNIFICANCE = 60.0
"""Square of the change in standard errors, summed over the axes, from which on it is not noise; a choice.

With three axes 16 would do for one ramp. A balance that wind and load change slowly reaches 85 in real flights, and is
then not in line with any motor.
"""

SLOW_LOADS_PER_MOTOR = 0.1
"""Prior odds that a load moved in a change of more than ``MAX_ONSET_ERROR``, against one of a motor.

A load that comes loose slides until something stops it, within a second; a choice.
"""

SIGNATURE_ERROR = 0.08
"""Error of the signature, relative to the change: mixers limit, and thrust is no linear function of the command."""

MAX_MISFIT = 9.0
"""Squared deviation of the change from the signature in standard errors, two degrees of freedom: 99 % are below."""


class Ramp(NamedTuple):
    """The ramp that fits the balance of a flight best."""

    start: int
    """Index of the block in which it begins."""
    profile: Array
    """(B,) fraction of the change that has happened in each block: 0 before the ramp, 1 after it."""
    before: Array
    """(a,) balance before it."""
    change: Array
    """(a,) change of the balance."""

    @property
    def length(self) -> int:
        """Number of blocks that the change takes, at least 1."""
        is_within_ramp = (self.profile > 0) & (self.profile < 1)
        return int(is_within_ramp.sum()) + 1


def gradual_loss(
    time: Array, commands: Array, lean: Array, geometry: MotorGeometry, boot: int = 0
) -> MotorChange | None:
    """Returns the alarm that one motor lost thrust in a run of settled flight, and did not regain it within the run.

    The balance (the torque commands relative to the thrust) is averaged over blocks and fitted by a ramp. It is an
    alarm if the change persists, is significant, and is explained by one motor much better than by any other cause.

    Args:
        time: (N,) s on the boot clock, ascending, of one run of settled flight without a landing.
        commands: (N, k) motor outputs as fractions of the range.
        lean: (N, 2) roll and pitch, rad; NaN where they are not known.
        geometry: positions and spins of the k motors.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The loss, with the beginning of the ramp as ``onset_time`` and the end of the run as ``time``; None if no motor
        lost thrust, the flight is too short, or two motors cannot be distinguished.
    """
    signatures = motor_signatures(geometry)
    if not signatures.is_motor_identifiable or len(time) < 2:
        return None
    model = BalanceModel(signatures)
    duration = float(time[-1] - time[0])
    block_seconds = max(BLOCK_SECONDS, duration / MAX_BLOCKS)
    min_blocks_before = round(MIN_BEFORE_SECONDS / block_seconds) + 1
    min_blocks_after = round(MIN_LOSS_SECONDS / block_seconds)
    block_times, block_commands = _block_means(time, commands, block_seconds)
    thrust = block_commands.mean(axis=1)
    is_sparse = len(block_times) < MIN_PRESENT_FRACTION * duration / block_seconds
    is_too_short = len(block_times) < min_blocks_before + min_blocks_after
    # The balance is relative to the thrust, which is 0 while the motors stand still.
    do_motors_run = bool((thrust > 0).all())
    if is_sparse or is_too_short or not do_motors_run:
        return None
    balances = (block_commands / thrust[:, None]) @ model.torque_rows.T
    ramp = _best_ramp(balances, min_blocks_before)
    begins_near_end = ramp.start > len(balances) - min_blocks_after
    if begins_near_end:
        # A gust, or the beginning of the descent: it is not known whether the change persists.
        return None
    variance = _variance_of_change(balances, ramp)
    significance = (ramp.change**2 / variance).sum()
    if significance < MIN_SIGNIFICANCE:
        return None
    degrees_of_freedom = PRIOR_FREEDOM + len(balances) / BLOCKS_PER_FREEDOM
    lean_after = lean[time >= block_times[ramp.start]].mean(axis=0)
    is_slow = ramp.length * block_seconds > MAX_ONSET_ERROR
    loads_per_motor = SLOW_LOADS_PER_MOTOR if is_slow else LOADS_PER_MOTOR
    cause = _motor_cause(
        ramp.change, variance, degrees_of_freedom, lean_after, loads_per_motor, model
    )
    if cause is None:
        return None
    motor = cause.motor
    # Only the rise of this motor's command is estimated: the pattern of the rises is 1 for it and 0 for all others.
    rise_pattern = np.zeros(len(geometry.names))
    rise_pattern[motor] = 1.0
    estimate = model.estimated_rises(rise_pattern, ramp.before, ramp.before + ramp.change, variance)
    rise = float(estimate.rises[motor])
    half_width = float(estimate.half_widths[motor])
    return MotorChange(
        time=float(block_times[-1]),
        onset_time=float(block_times[ramp.start]),
        motor=geometry.motors[motor],
        name=geometry.names[motor],
        size=rise,
        probability=1 / (1 + np.exp(-cause.log_odds)),
        assumed=geometry.positions_assumed,
        boot=boot,
        loss=model.thrust_loss(motor, max(rise - half_width, 0.0), rise + half_width),
    )


class _BlockMeans(NamedTuple):
    """Commands of k motors, averaged over B blocks of equal length."""

    time: Array
    """Middle of each block (B,), s."""

    commands: Array
    """Mean command of each motor (B, k)."""


def _block_means(time: Array, commands: Array, block_seconds: float) -> _BlockMeans:
    """Averages commands over blocks of equal length.

    Args:
        time: (N,) times of the samples, s, ascending.
        commands: (N, k) outputs of the k motors, as fractions of the range.
        block_seconds: length of a block, s.

    Returns:
        (B,) middles of the blocks that have samples, s, and (B, k) their mean commands.
    """
    block_of_sample = ((time - time[0]) / block_seconds).astype(np.int64)
    # Numbers of the blocks that have samples, the row of each sample's block among them, and the samples of each block.
    blocks, rows, counts = np.unique(block_of_sample, return_inverse=True, return_counts=True)
    means = [np.bincount(rows, command) / counts for command in commands.T]
    return _BlockMeans(time[0] + block_seconds * (blocks + 0.5), np.column_stack(means))


def _best_ramp(balances: Array, min_blocks_before: int) -> Ramp:
    """Fits ramps of several lengths and beginnings to the balance, and returns the one of the highest likelihood.

    A ramp is constant, then changes linearly, then is constant again, at the same times on all axes. For each length
    and beginning, its change is the least-squares slope of the balance on the ramp's profile, which rises from 0 to 1.
    With independent normal noise of unknown variance on each axis, the log likelihood of the best fit is
    −B/2 Σ log(residual sum of squares) over the axes.

    Args:
        balances: (B, a) balance of each block about a axes: torque commands relative to the thrust.
        min_blocks_before: number of blocks before the earliest beginning of a ramp.

    Returns:
        The ramp: its first block, its profile over the blocks, the balance before it and the change of the balance.
    """
    block_count = len(balances)
    # The change needs at least two blocks.
    starts = np.arange(min_blocks_before, block_count - 2)
    fits = []
    for fraction in RAMP_FRACTIONS:
        # A ramp that begins late is shortened, so that it ends within the flight.
        lengths = np.clip(round(fraction * block_count), 1, block_count - 1 - starts)
        fits.append(_likeliest_ramp(balances, starts, lengths))
    # The fits are sorted by length, and ``min`` returns the first of equal ones: the shortest.
    return min(fits, key=lambda fit: fit.misfit).ramp


class _RampFit(NamedTuple):
    """A ramp that was fitted to the balance of a flight."""

    ramp: Ramp
    """The ramp."""
    misfit: float
    """Minus 2/B times its log likelihood, without a constant."""


def _likeliest_ramp(balances: Array, starts: Indices, lengths: Indices) -> _RampFit:
    """Fits s ramps with given beginnings and lengths to the balance by least squares, and returns the likeliest one.

    Args:
        balances: (B, a) balance of each block about a axes: torque commands relative to the thrust.
        starts: (s,) first block of each ramp.
        lengths: (s,) number of blocks that each ramp takes, at least 1.

    Returns:
        The ramp of the highest likelihood, and its misfit.
    """
    block_count = len(balances)
    mean_balance = balances.mean(axis=0)
    centred_balances = balances - mean_balance
    total_squares = (centred_balances**2).sum(axis=0)
    # (s, B) profiles of the ramps: 0 before the ramp, rising to 1 within it, 1 after it.
    block_numbers = np.arange(block_count)
    profiles = np.clip((block_numbers - starts[:, None]) / lengths[:, None], 0.0, 1.0)
    centred_profiles = profiles - profiles.mean(axis=1, keepdims=True)
    profile_squares = (centred_profiles**2).sum(axis=1)
    # (s, a) changes, the slopes of the regression of the balance on each profile, and the residual sums of squares.
    changes = (centred_profiles @ centred_balances) / profile_squares[:, None]
    residual_squares = total_squares - changes**2 * profile_squares[:, None]
    # The variance of slow changes of the balance is added, since the logarithm of residuals of 0 would be infinite.
    misfits = np.log(residual_squares / block_count + WANDER_SD**2).sum(axis=1)
    best = int(np.argmin(misfits))
    profile = profiles[best]
    change = changes[best]
    # The regression line passes through the means of balance and profile.
    balance_before = mean_balance - change * profile.mean()
    ramp = Ramp(int(starts[best]), profile, balance_before, change)
    return _RampFit(ramp, misfit=float(misfits[best]))


def _variance_of_change(balances: Array, ramp: Ramp) -> Array:
    """Returns the variance of a ramp's change: that of a least-squares slope, and that of slow changes of the balance.

    Residuals of neighbouring blocks are correlated, so their long-run variance is used: n times the variance of the
    mean of n blocks. It has a prior, since a short flight has few blocks.

    Args:
        balances: (B, a) balance of each block about a axes: torque commands relative to the thrust.
        ramp: the ramp that was fitted to them.

    Returns:
        (a,) variances, of the square of a balance.
    """
    block_count, axis_count = balances.shape
    residuals = balances - ramp.before - ramp.profile[:, None] * ramp.change
    # One window with all blocks, the first of the result; residuals have the mean 0.
    residual_variance = long_run_variance(
        residuals,
        selection=np.ones((1, block_count), dtype=bool),
        mean=np.zeros((1, axis_count)),
        prior_variance=np.full(axis_count, PRIOR_BLOCK_SD**2),
        prior_freedom=PRIOR_FREEDOM,
    )[0]
    # The change is the slope of a regression of the balance on the ramp's profile.
    centred_profile = ramp.profile - ramp.profile.mean()
    slope_variance = residual_variance / (centred_profile @ centred_profile)
    return np.asarray(slope_variance + WANDER_SD**2)


class _MotorCause(NamedTuple):
    """A weak motor as the cause of a change of the balance."""

    motor: int
    """Index of the motor, from 0."""
    log_odds: float
    """Logarithm of the odds that this motor is the cause, and nothing else."""


def _motor_cause(
    change: Array,
    variance: Array,
    degrees_of_freedom: float,
    lean: Array,
    loads_per_motor: float,
    model: BalanceModel,
) -> _MotorCause | None:
    """Returns the motor whose weakness explains a change of the balance.

    The signature of a motor is the change of the balance if it is weak. Its misfit to the change must be small, and its
    odds against all other causes must be strong evidence. These are the causes of the sequential test: the other
    motors, a load that shifted, which changes yaw too if the vehicle leans, a change in yaw alone, and one in all axes.
    Signatures are not exact; their error is added to the variance.

    Args:
        change: (a,) change of the balance (torque commands relative to the thrust) about a axes.
        variance: (a,) variance of the change.
        degrees_of_freedom: degrees of freedom of that variance, for Student's t distribution.
        lean: (2,) mean roll and pitch after the change, rad; NaN where they are not known.
        loads_per_motor: prior odds of a load that shifted, against one of a motor.
        model: mixer of the vehicle, with the change of the balance that each weak motor causes.

    Returns:
        The motor, with its odds; None if no motor explains the change, or its work rose by less than
        ``MIN_WORK_RISE``.
    """
    variance = variance + (SIGNATURE_ERROR * np.linalg.norm(change)) ** 2
    weights = model.signatures / variance
    # (k,) rise of each motor's command that fits the change best, by weighted least squares, and the squared residuals.
    rises = weights @ change / (weights * model.signatures).sum(axis=1)
    misfits = ((change - rises[:, None] * model.signatures) ** 2 / variance).sum(axis=1)
    # A motor whose command fell did not lose thrust: it must not be chosen.
    misfits[rises <= 0] = np.inf
    motor = int(np.argmin(misfits))
    evidence = _evidence_of_all_causes(change, variance, degrees_of_freedom, lean, model)
    log_odds = log_odds_of_motor_cause(evidence, motor, loads_per_motor)
    # The neighbours supply a part of the missing thrust, so that the motor's own command rises by less than its work.
    work_rise = rises[motor] / model.mixer.own_rise_ratios[motor]
    is_explained = misfits[motor] <= MAX_MISFIT and log_odds >= STRONG_EVIDENCE_NATS
    if not is_explained or work_rise < MIN_WORK_RISE:
        return None
    return _MotorCause(motor, log_odds)


def _evidence_of_all_causes(
    change: Array, variance: Array, degrees_of_freedom: float, lean: Array, model: BalanceModel
) -> CauseEvidence:
    """Computes the Bayes factors of all causes of a change of the balance: a weak motor, a shifted load, and others.

    The factors are those of the test that runs during a flight (``loss_detection.py``). That test examines changes over
    several windows of time. Here there is one window, the whole flight: all arrays get a first axis of length 1.

    Args:
        change: (a,) change of the balance (torque commands relative to the thrust) about a axes.
        variance: (a,) variance of the change.
        degrees_of_freedom: degrees of freedom of that variance, for Student's t distribution.
        lean: (2,) mean roll and pitch after the change, rad; NaN where they are not known.
        model: mixer of the vehicle, with the change of the balance that each weak motor causes.
    """
    changes = WindowChanges(
        change[None],
        variance[None],
        np.array([degrees_of_freedom]),
        block_variance=variance[None],
    )
    log_density_without_change = log_t_density(changes, 0.0)
    return cause_evidence(
        changes, log_density_without_change, model.signatures, lean[None], weak_motor_sizes={}
    )
