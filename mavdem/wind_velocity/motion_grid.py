"""Attitude, velocity and specific force of a flight on an even time grid, from which wind and drag are estimated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags, Indices, as_real_array
from mavdem.confidence import SIGNIFICANT_SIGMAS
from mavdem.dataset.axes import DOWN, HORIZONTAL, ROLL, TILT_COLUMNS, YAW
from mavdem.errors import NotLearnable
from mavdem.facts.online import AirflowFact
from mavdem.physical_constants import GRAVITY

GRID_STEP = 0.5
"""Usual time step of the grid, s: a choice. Slower samples have their own step."""

MAX_STEPS = 1200
"""Largest number of steps of the grid; longer flights have longer steps, which bounds the time of computation."""

MAX_FLIGHT_SECONDS = 1e5
"""Longest time that stamps of one flight may span, s: a day and a little more."""

MIN_MOTION_SECONDS = 15.0
"""Least time of complete motion, s: a choice. Less does not separate wind from drag and lean."""

MIN_SAMPLES = 10
"""Least number of finite samples of attitude and velocity: a choice."""

ATTITUDE_LAG = 0.03
"""Assumed standard error of the time between attitude and velocity, s."""

SCALE_ERROR = 0.05
"""Assumed standard error of a measured acceleration, relative to it."""

MAX_SPECIFIC_FORCE = 25.0
"""Specific force across the thrust axis, m/s², beyond which the velocity jumped: no drag is so large."""

MAX_BRIDGED_SECONDS = 10.0
"""Distance to the next complete step, s, up to which incomplete steps are kept in the grid."""

ROUNDING_STEPS = 1e-6
"""Fraction of a step by which stamps on the border of two steps are moved, against rounding."""

FAST_SAMPLE_SECONDS = 0.3
"""Longest time between samples, s, with which velocity is compared with tilt.

With slower samples, gusts and the position control come between the two.
"""

MIN_COMPARED_STEPS = 40
"""Least number of steps, over both axes, in which velocity is compared with tilt: a choice."""

MIN_TILT_CHANGE = 0.2
"""Least standard deviation of changes of tilt times gravity, m/s², with which velocity is compared with tilt.

Gusts balance smaller ones.
"""

MIN_VELOCITY_RESPONSE = 0.3
"""Least acceleration per tilt times gravity: in free flight it is 0.7 to 1.5."""

INDEPENDENT_STEPS = 8
"""Number of steps in a block whose sum is assumed to be independent of the next: a change of means spans three
steps."""


class MotionGrid(NamedTuple):
    """Motion of a flight in T steps; NaN where a step has no samples."""

    time: Array
    """Middle of each step (T,), s."""

    body_axes: Array
    """Unit vectors of body x and y in north, east and down (T, 2, 3)."""

    velocity: Array
    """Velocity north, east and down (T, 3), m/s, over ground, or relative to the air if the wind is known."""

    force: Array
    """Specific force along body x and y (T, 2), m/s²."""

    force_error: Array
    """Standard error of the force by timing and scale of attitude and velocity (T,), m/s²."""

    step: float
    """Time step, s."""

    @property
    def complete(self) -> Flags:
        """Which steps have both force and velocity (T,)."""
        has_force = np.isfinite(self.force).all(axis=1)
        has_velocity = np.isfinite(self.velocity).all(axis=1)
        return np.asarray(has_force & has_velocity)

    @property
    def level_force(self) -> Array:
        """Specific force north, east and down (T, 3), m/s², without its part along body z."""
        # The body's axes (rows i, at each time t) turn a force along them into one north, east and down (j).
        return np.asarray(np.einsum("tij,ti->tj", self.body_axes, self.force))

    def along_body_axes(self, velocity: Array) -> Array:
        """Returns the components along body x and y (T, 2) of a velocity north, east and down (T, 3)."""
        return np.asarray(np.einsum("tij,tj->ti", self.body_axes, velocity))

    def select(self, rows: Flags | slice) -> MotionGrid:
        """Selects some of the time steps of the motion. The time step stays the same, so that there may be gaps.

        Args:
            rows: flags (T,), or a slice, of the steps to select.

        Returns:
            The motion at these steps.
        """
        return MotionGrid(
            self.time[rows],
            body_axes=self.body_axes[rows],
            velocity=self.velocity[rows],
            force=self.force[rows],
            force_error=self.force_error[rows],
            step=self.step,
        )


class MotionSamples(NamedTuple):
    """Finite samples of a flight's motion."""

    time: Array
    """Stamps (N,), s."""

    attitude: Array
    """Roll, pitch and yaw (N, 3), rad."""

    velocity: Array
    """Velocity over ground, north, east and down (N, 3), m/s."""

    usable: Flags
    """Which of the given samples these are (T,)."""


@dataclass(frozen=True)
class _Bins:
    """Assignment of N samples to the steps of an even time grid."""

    index: Indices
    """Step of each sample (N,)."""

    fraction: Array
    """Position of each sample in its step (N,), from 0 to 1."""

    count: int
    """Number of steps."""

    start: float
    """Beginning of the first step, s."""

    def select(self, rows: Flags) -> _Bins:
        """Returns the assignment of some samples to the same steps.

        Args:
            rows: flags (N,) of the samples to keep.
        """
        return _Bins(self.index[rows], self.fraction[rows], self.count, self.start)

    def _sums(self, values: Array) -> Array:
        """Returns the sums of values (k, N) in each step (k, count)."""
        return np.array([np.bincount(self.index, row, self.count) for row in values])

    def triangular_means(self, values: Array) -> Array:
        """Returns means over each two adjacent steps, with weights that rise over the first and fall over the second.

        With the position p of a sample in its step, 0 to 1, the weight is p in the first and 1 − p in the second.

        Args:
            values: k quantities at N samples (k, N).

        Returns:
            Means (k, count − 1); NaN where both steps have no sample.
        """
        # The first row, of ones, is summed to the weights by which the other rows are divided.
        values_and_ones = np.vstack([np.ones(len(self.index)), values])
        # Sums over each step with the weights p, and with 1 − p.
        rising_sums = self._sums(self.fraction * values_and_ones)
        falling_sums = self._sums(values_and_ones) - rising_sums
        # The weights rise in the first step of each pair, and fall in the second.
        weighted_sums = rising_sums[:, :-1] + falling_sums[:, 1:]
        weights = weighted_sums[0]
        return weighted_sums[1:] / weights

    def mean_differences(self, values: Array) -> Array:
        """Returns the differences between means of values (k, N) in adjacent steps (k, count − 1)."""
        values_and_ones = np.vstack([np.ones(len(self.index)), values])
        sums = self._sums(values_and_ones)
        return np.diff(sums[1:] / sums[0])


def _assigned_to_bins(time: Array, step: float) -> _Bins:
    """Assigns samples to the steps of an even grid.

    Args:
        time: stamps of the samples (N,), s, ascending.
        step: time step of the grid, s.

    Returns:
        For each sample the index of its step and its position in it, 0 to 1; the number of steps; and the start of the
        grid, s.
    """
    # The grid begins half a sampling interval before the first sample, so that this sample is not at an edge.
    start = float(time[0] - np.median(np.diff(time)) / 2)
    count = int((time[-1] - start) / step + ROUNDING_STEPS) + 1
    position = (time - start) / step
    index = np.minimum((position + ROUNDING_STEPS).astype(int), count - 1)
    return _Bins(index, position - index, count, start)


def motion_grid(
    time: Array,
    attitude: Array,
    velocity: Array,
    step: float,
    wind: Array | None = None,
) -> MotionGrid:
    """Resamples the motion of a flight to an even grid, and computes the specific force that is not thrust or gravity.

    The thrust of a multirotor acts along body z. Drag and lean accelerate the vehicle across body z. All quantities are
    means over two steps with triangular weights. The mean acceleration with these weights is the difference between the
    mean velocities of the two steps, so manoeuvres do not look like drag.

    Args:
        time: stamps of the samples (N,), s, ascending.
        attitude: roll, pitch and yaw (N, 3), rad.
        velocity: velocity over ground, north, east and down (N, 3), m/s.
        step: time step of the grid, s.
        wind: velocity of the air, north and east (N, 2), m/s, which is subtracted from the velocity; None if it is not
            known.

    Returns:
        The motion at the boundaries between adjacent steps, each a mean over the step before and the step after it.
        Boundaries that are far from all steps with samples are left out.
    """
    body_x, body_y, body_z = _body_axes(attitude)
    # North and east components of body z per down component, (2, N): the tangent of the tilt.
    tilt = body_z[:2] / body_z[2]

    bins = _assigned_to_bins(time, step)
    # A step without samples divides by 0, and becomes NaN.
    with np.errstate(divide="ignore", invalid="ignore"):
        body_axes = bins.triangular_means(np.vstack([body_x, body_y])).T.reshape(-1, 2, 3)
        mean_tilt = bins.triangular_means(tilt).T
        mean_velocity = bins.triangular_means(velocity.T).T
        tilt_rate = bins.mean_differences(tilt).T / step
        acceleration = bins.mean_differences(velocity.T).T / step
        if wind is not None:
            mean_velocity[:, HORIZONTAL] -= bins.triangular_means(wind.T).T

    # The down component of the thrust per mass is the downward acceleration minus gravity; its product with the tilt is
    # the north and east components. The acceleration minus these, (T, 2), is projected on body x and y.
    level_force = acceleration[:, HORIZONTAL] + (GRAVITY - acceleration[:, [DOWN]]) * mean_tilt
    # Letters of einsum: time t, axis i of the body, north or east j.
    force = np.einsum("tij,tj->ti", body_axes[:, :, :2], level_force)
    # A force beyond the limit is due to wrong data, such as a jump of the velocity, and is left out.
    force[~(abs(force) < MAX_SPECIFIC_FORCE).all(axis=1)] = np.nan
    # If the attitude lags behind the velocity while the tilt changes, or its scale is wrong, this looks like a force.
    timing_error = ATTITUDE_LAG * GRAVITY * tilt_rate
    scale_error = SCALE_ERROR * acceleration[:, HORIZONTAL]
    force_error = np.sqrt((timing_error**2 + scale_error**2).sum(axis=1))
    middle = bins.start + step * np.arange(1, bins.count, dtype=np.float64)
    grid = MotionGrid(
        middle,
        body_axes=body_axes,
        velocity=mean_velocity,
        force=force,
        force_error=force_error,
        step=step,
    )
    return grid.select(_near_complete_steps(grid))


def _body_axes(attitude: Array) -> Array:
    """Returns the directions of the body axes in north, east and down, the columns of the rotation matrix R_z R_y R_x.

    It is computed here, because the import of ``scipy.spatial.transform.Rotation``, which returns the same, takes a
    tenth of a second and 10 MB.

    Args:
        attitude: roll, pitch and yaw (N, 3), rad.

    Returns:
        (3, 3, N) body x, y and z, each by its north, east and down components.
    """
    sin_roll, sin_pitch, sin_yaw = np.sin(attitude.T)
    cos_roll, cos_pitch, cos_yaw = np.cos(attitude.T)
    return np.array(
        [
            [cos_yaw * cos_pitch, sin_yaw * cos_pitch, -sin_pitch],
            [
                cos_yaw * sin_pitch * sin_roll - sin_yaw * cos_roll,
                sin_yaw * sin_pitch * sin_roll + cos_yaw * cos_roll,
                cos_pitch * sin_roll,
            ],
            [
                cos_yaw * sin_pitch * cos_roll + sin_yaw * sin_roll,
                sin_yaw * sin_pitch * cos_roll - cos_yaw * sin_roll,
                cos_pitch * cos_roll,
            ],
        ]
    )


def _near_complete_steps(grid: MotionGrid) -> Flags:
    """Finds the steps that are at most ``MAX_BRIDGED_SECONDS`` away from a complete step, one with force and velocity.

    Args:
        grid: motion of the vehicle on an even grid of times, with gaps.

    Returns:
        Flags (T,).
    """
    steps_to_each_side = int(MAX_BRIDGED_SECONDS / grid.step)
    # An empty list cannot be convolved, so that False is appended for grids without steps.
    is_complete = [*grid.complete, False]
    # The convolution with ones counts the complete steps around each step.
    complete_count = np.convolve(is_complete, np.ones(2 * steps_to_each_side + 1))
    # It is longer than the grid by as many steps at the start, and at least as many at the end.
    grid_end = steps_to_each_side + len(grid.force)
    return np.asarray(complete_count[steps_to_each_side:grid_end] > 0)


def flight_grid(
    samples: MotionSamples,
    step: float = GRID_STEP,
    max_steps: int = MAX_STEPS,
    wind: Array | None = None,
) -> MotionGrid:
    """Averages the motion of a whole flight over the steps of an even time grid.

    Steps are longer than ``step`` if samples are slower, or if the flight is so long that it would have too many.

    Args:
        samples: samples of the flight's motion.
        step: shortest time step, s.
        max_steps: largest number of steps of the grid; a longer flight gets longer steps.
        wind: (N, 2) known velocity of the air, as in :func:`motion_grid`; None to estimate it.

    Returns:
        The motion on the grid.

    Raises:
        NotLearnable: too little of the motion is complete.
    """
    time = samples.time
    sampling_step = np.median(np.diff(time))
    duration = time[-1] - time[0]
    grid_step = max(step, sampling_step, duration / max_steps)
    grid = motion_grid(time, samples.attitude, samples.velocity, grid_step, wind)
    # Steps in gaps of the samples are not complete.
    complete_seconds = float(grid.complete.sum() * grid.step)
    if complete_seconds < MIN_MOTION_SECONDS:
        raise NotLearnable(
            AirflowFact.MOTION_TOO_SHORT, settled=complete_seconds, duration=MIN_MOTION_SECONDS
        )
    return grid


def validated_motion(time: Array, attitude: Array, velocity: Array) -> MotionSamples:
    """Checks the arguments of the wind estimation, and removes samples that are not finite.

    Args:
        time: (T,) stamps, s.
        attitude: (T, 3) roll, pitch and yaw, rad.
        velocity: (T, 3) velocity over ground, north, east and down, m/s.

    Returns:
        The finite samples, with flags (T,) that mark them among all.

    Raises:
        ValueError: arguments have other shapes, stamps do not ascend or span too long for one flight, or the attitude
            seems to be in degrees.
        NotLearnable: there are too few finite samples, or the velocity does not follow the tilt.
    """
    stamps = as_real_array(time, "time")
    angles = as_real_array(attitude, "attitude")
    velocities = as_real_array(velocity, "velocity")
    if stamps.ndim != 1 or angles.shape != (len(stamps), 3) or velocities.shape != angles.shape:
        raise ValueError("time, attitude and velocity must have shapes (T,), (T, 3) and (T, 3)")
    _require_stamps_of_flight(stamps)
    is_finite = np.asarray(np.isfinite(np.hstack([angles, velocities])).all(axis=1))
    if is_finite.sum() < MIN_SAMPLES:
        # The advice names what is missing: the yaw, if there is a roll without it.
        has_roll = np.isfinite(angles[:, ROLL]).sum() >= MIN_SAMPLES
        has_yaw = np.isfinite(angles[:, YAW]).sum() >= MIN_SAMPLES
        missing_quantity = "yaw" if has_roll and not has_yaw else "velocity"
        raise NotLearnable(AirflowFact.MOTION_UNKNOWN, missing=missing_quantity)
    samples = MotionSamples(stamps[is_finite], angles[is_finite], velocities[is_finite], is_finite)
    largest_tilt = abs(samples.attitude[:, TILT_COLUMNS]).max()
    if largest_tilt > np.pi:
        raise ValueError("attitude seems to be in degrees: give rad")
    _require_velocity_follows_tilt(samples)
    return samples


def _require_stamps_of_flight(stamps: Array) -> None:
    """Checks that time stamps (T,), s, can be the stamps of one flight.

    Raises:
        ValueError: they are not finite, do not ascend, or span more than ``MAX_FLIGHT_SECONDS``.
    """
    if not np.isfinite(stamps).all() or (np.diff(stamps) < 0).any():
        raise ValueError("time must be finite and ascend")
    if len(stamps) and np.ptp(stamps) > MAX_FLIGHT_SECONDS:
        raise ValueError("time must be in s, of one flight")


def _require_velocity_follows_tilt(samples: MotionSamples) -> None:
    """Checks that the vehicle flies freely, by comparing the changes of its velocity with its tilt.

    A multirotor accelerates by about g times its tilt. So the changes of its acceleration are regressed on the changes
    of g times the tilt. The slope is about 1 in free flight, and about 0 if the vehicle is carried or held. At a low
    sampling rate the changes of the tilt have errors, which would reduce the slope. So they are computed twice, from
    the samples with even and with odd numbers, and each is the instrumental variable of the other, so that errors of
    only one of them do not bias the slope.

    Nothing is checked if the result would not be reliable: if samples are slow or few, or if the tilt hardly changes. A
    slope is too small only if the difference is significant.

    Args:
        samples: samples of the flight's motion.

    Raises:
        NotLearnable: the vehicle is held or carried, or the velocity is not the vehicle's.
    """
    interval = np.median(np.diff(samples.time))
    if interval > FAST_SAMPLE_SECONDS:
        return
    step = max(FAST_SAMPLE_SECONDS, 2 * interval)
    bins = _assigned_to_bins(samples.time, step)
    _, _, body_z = _body_axes(samples.attitude)
    # Acceleration to north and east by the thrust of a vehicle that keeps its height, (2, N).
    expected_acceleration = -GRAVITY * body_z[:2] / body_z[2]
    is_even = np.arange(len(samples.time)) % 2 == 0
    # A step without samples divides by 0, and becomes NaN.
    with np.errstate(divide="ignore", invalid="ignore"):
        acceleration = bins.mean_differences(samples.velocity[:, HORIZONTAL].T) / step
        even, odd = (
            np.diff(bins.select(rows).triangular_means(expected_acceleration[:, rows]), axis=1)
            for rows in (is_even, ~is_even)
        )
    measured_acceleration = np.diff(acceleration, axis=1)
    is_complete = np.isfinite(even + odd + measured_acceleration).all(axis=0)
    if 2 * is_complete.sum() <= MIN_COMPARED_STEPS:
        return
    even, odd, measured_acceleration = (
        changes[:, is_complete] for changes in (even, odd, measured_acceleration)
    )
    # Sums over both axes for each step: of the squared change of the tilt, and of the product of the changes of tilt
    # and acceleration.
    squares = 2 * (even * odd).sum(axis=0)
    products = ((even + odd) * measured_acceleration).sum(axis=0)
    if squares.sum() <= 2 * even.size * MIN_TILT_CHANGE**2:
        return
    slope = products.sum() / squares.sum()
    # Adjacent changes share samples, but changes of different blocks hardly share any.
    starts = np.arange(0, len(squares), INDEPENDENT_STEPS)
    residuals = np.add.reduceat(products - slope * squares, starts)
    standard_error = np.sqrt((residuals**2).sum()) / squares.sum()
    if slope + SIGNIFICANT_SIGMAS * standard_error < MIN_VELOCITY_RESPONSE:
        raise NotLearnable(AirflowFact.VELOCITY_INCONSISTENT)
