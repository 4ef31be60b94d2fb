"""Whether roll and pitch follow their setpoints, and whether the integrated gyro agrees with the attitude."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from mavdem.arrays import Array, Flags
from mavdem.dataset.axes import TILT_COLUMNS
from mavdem.dataset.flight_states import min_airborne_collective
from mavdem.dataset.intervals import grid_in_record
from mavdem.dataset.signals import Signals
from mavdem.dataset.steady_flight import attitude_tracking
from mavdem.dataset.time_series import moving_average, rows_of_boot, series_of_boot
from mavdem.dataset.vehicle_cache import cached_per_vehicle

RESPONSE_RATE = 10.0
"""Rate, Hz, at which setpoint and angle are compared; all loops of attitude are slower."""

MIN_SETPOINT_RANGE = np.radians(2.0)
"""Standard deviation, rad, of a setpoint, above which its response can be judged."""

MIN_CORRELATION = 0.5
"""Correlation of setpoint and angle from which on the vehicle follows its setpoint."""

MIN_SLOPE = 0.3
"""Slope of the regression of the angle on its setpoint, rad/rad, from which on the vehicle follows it; 1 is perfect."""

MAX_IGNORED_CORRELATION = 0.2
"""Correlation of setpoint and angle up to which the vehicle ignores a setpoint that varies much."""

IGNORED_SETPOINT_RANGE = np.radians(5.0)
"""Standard deviation, rad, of a setpoint that no free vehicle can ignore."""

MAX_MEDIAN_ERROR = np.radians(12.0)
"""Median error, rad, of roll or pitch under power above which the vehicle ignores its setpoint.

The same logs are found with any limit from 9 to 30°.
"""

MAX_HELD_RANGE = np.radians(15.0)
"""Range of roll or pitch, rad, under power, above which nothing holds the vehicle; estimates on a bench drift less."""

DELAY_SECONDS = 1.0
"""Longest delay, s, from setpoint to response that is tried."""

MIN_SECONDS = 2.0
"""Seconds under power that are needed for a judgement."""

MAX_STILL_RATE = np.radians(1.0)
"""Body rate, rad/s, that a vehicle under power stays below only where something holds it: free ones shake."""

MIN_TURN = np.radians(2.0)
"""Change, rad, of roll or pitch within ``TURN_SECONDS`` from which on gyro and attitude can be compared."""

MIN_TURNS = 5
"""Number of such changes that are needed; a choice."""

TURN_SECONDS = 0.5
"""Seconds over which the change of the attitude and the integral of the gyro are compared."""

MAX_AGREEING_RATIO = 0.5
"""Median difference of both, relative to the change of the attitude, up to which they agree; a choice below 1, at which
the gyro explains nothing."""


MIN_RATE_CORRELATION = 0.5
"""Correlation of neighbouring samples of a rate from which on they resolve it: slower ones do not show its integral."""


MAX_RECORD_GAP = 1.0
"""Time between two samples of the attitude, s, from which on the time between them does not count: a choice."""


@dataclass(frozen=True)
class RotationUnderPower:
    """How the vehicle rotated under power in one boot."""

    powered_seconds: float
    """Time with motors that could carry the vehicle, s."""
    follows_setpoint: bool | None
    """Whether roll and pitch follow their setpoints; None if the setpoints change too little to decide."""
    correlation: float | None
    """Largest correlation of a setpoint with its angle; None if no setpoint varies enough."""
    median_error: float | None
    """Larger median error of roll and pitch, rad; None without setpoints."""
    largest_rate: float
    """Largest body rate under power, rad/s."""
    gyro_agrees: bool | None
    """Whether the integral of the gyro is the change of the attitude; None if that cannot be compared."""

    @property
    def is_held(self) -> bool:
        """Whether the vehicle did not rotate at all under power."""
        return self.powered_seconds >= MIN_SECONDS and self.largest_rate < MAX_STILL_RATE


@cached_per_vehicle()
def rotation_under_power(signals: Signals, boot: int) -> RotationUnderPower | None:
    """Measures how a vehicle rotated under power: whether it followed its setpoints, its largest rate, and its gyro.

    Under power means that the motors were fast enough to carry the vehicle.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The measured quantities; None without attitude or motors, or with less than ``MIN_SECONDS`` under power.
    """
    tracking = attitude_tracking(signals, boot)
    collective = series_of_boot(signals.collective, boot)
    if tracking is None or collective is None or len(tracking.time) < 2:
        return None
    time = tracking.time
    min_collective = min_airborne_collective(signals.telemetry.parameters)
    is_powered = np.interp(time, collective.time, moving_average(collective)) > min_collective
    steps = np.diff(time, append=time[-1])
    # Whether the motors ran in a gap of the record is not known.
    is_recorded = steps < MAX_RECORD_GAP
    powered_seconds = float(steps[is_powered & is_recorded].sum())
    if powered_seconds < MIN_SECONDS:
        return None
    response = _setpoint_response(
        time, tracking.angles[:, TILT_COLUMNS], tracking.setpoints, is_powered
    )
    return RotationUnderPower(
        powered_seconds=powered_seconds,
        follows_setpoint=response.follows_setpoint,
        correlation=response.correlation,
        median_error=response.median_error,
        largest_rate=float(_fastest_rates(signals, boot, time)[is_powered].max()),
        gyro_agrees=_gyro_agrees(signals, boot, time[is_powered]),
    )


def _fastest_rates(signals: Signals, boot: int, time: Array) -> Array:
    """Returns the largest of the absolute body rates of all axes at some times, without single damaged samples.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        time: (N,) s since boot.

    Returns:
        (N,) rad/s, filtered by a median over three samples, which keeps the moment in which a vehicle tips over.
    """
    rates = []
    for attitude in signals.attitudes:
        rate = series_of_boot(attitude.rate_series, boot)
        if rate is not None:
            rates.append(np.interp(time, rate.time, abs(rate.values)))
    return np.asarray(scipy.ndimage.median_filter(np.max(rates, axis=0), 3))


class _SetpointResponse(NamedTuple):
    """How roll and pitch follow their setpoints."""

    follows_setpoint: bool | None = None
    """Whether they do; None if the setpoints change too little to decide."""
    correlation: float | None = None
    """Largest correlation of a setpoint with its angle; None if no setpoint varies enough."""
    median_error: float | None = None
    """Larger median error of both axes, rad; None without setpoints."""


def _setpoint_response(
    time: Array, angles: Array, setpoints: Array, is_powered: Flags
) -> _SetpointResponse:
    """Compares roll and pitch with their setpoints under power.

    The setpoint is delayed by up to ``DELAY_SECONDS``, and the delay with the largest correlation is used. The vehicle
    follows its setpoint if at least one of the two axes does, since then nothing holds it. It does not follow it, as on
    a bench, if three conditions are met: neither axis follows, the setpoints vary much or are far from the angles, and
    the angles hardly change.

    Args:
        time: (N,) s, ascending.
        angles: (N, 2) roll and pitch, rad.
        setpoints: (N, 2) their setpoints, rad; NaN for samples without one.
        is_powered: (N,) whether the motors could carry the vehicle.

    Returns:
        Whether the vehicle follows its setpoint, None if that is not known; the largest correlation; and the larger of
        the median errors of roll and pitch, rad.
    """
    # The latest sample at each instant of a uniform grid, since delays are whole steps of it. In a gap of the record
    # that sample would be held and counted, however long the gap is.
    grid_times = grid_in_record(time, 1 / RESPONSE_RATE)
    grid_samples = np.searchsorted(time, grid_times, side="right") - 1
    # ``errors`` has an entry for each axis with enough samples, the other lists for those whose setpoint varies enough.
    correlations = []
    slopes = []
    errors = []
    ignores_setpoint = []
    # The columns are roll and pitch.
    for angle, setpoint in zip(angles[grid_samples].T, setpoints[grid_samples].T, strict=True):
        is_known = np.isfinite(setpoint) & np.isfinite(angle) & is_powered[grid_samples]
        if np.count_nonzero(is_known) < MIN_SECONDS * RESPONSE_RATE:
            continue
        errors.append(float(np.median(abs(angle - setpoint)[is_known])))
        deviation = float(np.std(setpoint[is_known]))
        # If the setpoint hardly varies, the correlation with it has no meaning.
        if deviation < MIN_SETPOINT_RANGE:
            continue
        correlation, slope = _best_fit(angle, setpoint, is_known)
        correlations.append(correlation)
        slopes.append(slope)
        ignores_setpoint.append(
            deviation > IGNORED_SETPOINT_RANGE and correlation < MAX_IGNORED_CORRELATION
        )
    if not errors:
        return _SetpointResponse()
    median_error = max(errors)
    # A vehicle that tips over, or that fails in flight, does not follow its setpoint either, but it moves.
    has_moved = bool((np.ptp(angles[is_powered], axis=0) > MAX_HELD_RANGE).any())
    if not correlations:
        is_held = median_error > MAX_MEDIAN_ERROR and not has_moved
        return _SetpointResponse(False if is_held else None, None, median_error)
    best_fit = int(np.argmax(correlations))
    correlation = correlations[best_fit]
    follows_setpoint = None
    # If one axis follows, nothing holds the vehicle, even if the other axis does not follow.
    if correlation > MIN_CORRELATION and slopes[best_fit] > MIN_SLOPE:
        follows_setpoint = True
    elif (all(ignores_setpoint) or median_error > MAX_MEDIAN_ERROR) and not has_moved:
        follows_setpoint = False
    return _SetpointResponse(follows_setpoint, correlation, median_error)


class _Fit(NamedTuple):
    """How well a delayed setpoint explains an angle."""

    correlation: float
    """Correlation coefficient at the best delay."""
    slope: float
    """Angle per angle of the setpoint at that delay."""


def _best_fit(angle: Array, setpoint: Array, is_known: Flags) -> _Fit:
    """Regresses an angle linearly on its delayed setpoint, at each delay up to ``DELAY_SECONDS``.

    The fit at the delay with the highest correlation is the best one. Delays are skipped at which angle or setpoint is
    constant, so that there is no correlation.

    Args:
        angle: (M,) angle, rad, at ``RESPONSE_RATE``.
        setpoint: (M,) setpoint, rad; NaN where none is known.
        is_known: (M,) whether a sample enters the regression.

    Returns:
        Correlation and slope, rad/rad, of the best fit; −1 and 0 if all delays were skipped.
    """
    best_fit = _Fit(-1.0, 0.0)
    longest_delay = round(DELAY_SECONDS * RESPONSE_RATE)
    # The delay is a number of samples: an angle is compared with the setpoint so many samples before it.
    for delay in range(longest_delay + 1):
        known_samples = np.flatnonzero(is_known[delay:])
        later_angle = angle[delay:][known_samples]
        earlier_setpoint = setpoint[: len(setpoint) - delay][known_samples]
        is_finite = np.isfinite(earlier_setpoint)
        # The covariances of fewer than two samples are NaN, and then the delay is skipped.
        covariances = np.cov(earlier_setpoint[is_finite], later_angle[is_finite])
        setpoint_variance, angle_variance = covariances.diagonal()
        if not np.isfinite(covariances).all() or setpoint_variance <= 0 or angle_variance <= 0:
            continue
        covariance = covariances[0, 1]
        correlation = covariance / np.sqrt(setpoint_variance * angle_variance)
        if correlation > best_fit.correlation:
            slope = covariance / setpoint_variance
            best_fit = _Fit(float(correlation), float(slope))
    return best_fit


def _gyro_agrees(signals: Signals, boot: int, times: Array) -> bool | None:
    """Returns whether the changes of roll and pitch are the integrals of the gyro's rates.

    Both are compared over steps of ``TURN_SECONDS`` under power, by the median of their difference relative to the
    change (``MAX_AGREEING_RATIO``). A gyro with a bias agrees with the attitude that the estimator computed from it. So
    agreement is only weak evidence for the gyro, while disagreement shows that one of the two is wrong.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        times: (N,) times under power, s since boot, ascending.

    Returns:
        Whether the gyro agrees; None if the vehicle hardly turned, or the sampling rate is too low to integrate the
        rates.
    """
    grid = grid_in_record(times, TURN_SECONDS)
    # Only steps of the grid with both ends under power count: near a time under power.
    next_rows = np.minimum(np.searchsorted(times, grid), len(times) - 1)
    is_end_powered = abs(times[next_rows] - grid) < TURN_SECONDS
    # The grid leaves out gaps: a step over one is longer.
    is_one_step = np.diff(grid) < 1.5 * TURN_SECONDS
    is_step_used = is_end_powered[1:] & is_end_powered[:-1] & is_one_step
    changes = []
    differences = []
    for tilt in signals.tilts:
        rows = rows_of_boot(tilt.boot, boot)
        time, angle, euler_rate = tilt.time[rows], tilt.angle[rows], tilt.euler_rate[rows]
        if len(time) < 2 or not _is_resolved(euler_rate):
            return None
        # The rate of the Euler angle is computed from the gyro.
        integrated_rate = _trapezoidal_integral(time, euler_rate)
        change = np.diff(np.interp(grid, time, angle))
        expected_change = np.diff(np.interp(grid, time, integrated_rate))
        changes.append(change[is_step_used])
        differences.append((change - expected_change)[is_step_used])
    change_sizes = abs(np.concatenate(changes))
    difference_sizes = abs(np.concatenate(differences))
    is_turn = change_sizes > MIN_TURN
    if np.count_nonzero(is_turn) < MIN_TURNS:
        return None
    relative_differences = difference_sizes[is_turn] / change_sizes[is_turn]
    # The median leaves out the tumble of a crash, in which Euler angles jump.
    return bool(np.median(relative_differences) <= MAX_AGREEING_RATIO)


def _trapezoidal_integral(time: Array, values: Array) -> Array:
    """Integrates a signal over time by the trapezoidal rule.

    Args:
        time: (N,) times of the samples, s, ascending.
        values: (N,) samples.

    Returns:
        (N,) integral from the first sample to each one, 0 at the first.
    """
    mean_values = (values[1:] + values[:-1]) / 2
    return np.concatenate([[0.0], np.cumsum(np.diff(time) * mean_values)])


def _is_resolved(rate: Array) -> bool:
    """Returns whether samples of a rate (N,) follow each other closely enough that their integral is the angle."""
    earlier, later = rate[:-1], rate[1:]
    if len(earlier) < 2 or earlier.std() == 0 or later.std() == 0:
        return True
    return bool(np.corrcoef(earlier, later)[0, 1] >= MIN_RATE_CORRELATION)
