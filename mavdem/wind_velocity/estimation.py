"""Estimation of the wind velocity of one flight from the attitude and the velocity of the vehicle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import IntervalEstimate, half_width
from mavdem.dataset.axes import HORIZONTAL
from mavdem.dem.engine.linalg import one_thread
from mavdem.facts import Fact
from mavdem.facts.identifiability import Status
from mavdem.facts.online import DragSource
from mavdem.wind_velocity.advised_flight import WindErrors, advised_flight
from mavdem.wind_velocity.airflow_filter import TOTAL_WIND_MATRIX, SmoothedStates
from mavdem.wind_velocity.drag_identification import (
    GUST_SECONDS,
    DragPosterior,
    identify_drag,
    sampled_parameters,
    sampled_winds,
)
from mavdem.wind_velocity.identifiability import (
    MAX_REMAINING_DRAG_SD,
    DoubtedFigure,
    doubts_on_wind,
    is_lean_more_uncertain,
)
from mavdem.wind_velocity.mean_wind import (
    MIN_SPEED,
    MeanWind,
    independent_count,
    lower_speed_bound,
    mean_wind_by_minute,
    mean_wind_of_steps,
    running_means,
    speed_interval,
    wind_profile,
)
from mavdem.wind_velocity.motion_grid import (
    MAX_STEPS,
    MotionGrid,
    MotionSamples,
    flight_grid,
    validated_motion,
)
from mavdem.wind_velocity.vehicle_drag import DRAG_PARAMETERS, Drag
from mavdem.wind_velocity.velocity import WindVelocity, mean_air_speed


def estimate_wind(
    time: Array,
    attitude: Array,
    velocity: Array,
    drag: Drag | None = None,
    height: Array | None = None,
) -> WindVelocity:
    """Estimates the wind of one flight from attitude and velocity, at 1 Hz and faster.

    Wind pushes a multirotor, which tilts against it; its drag relates the tilt to the air speed. The steps:

    1. The motion is resampled to two even grids of time. The drag is identified on the coarse one, with its prior.
    2. On the fine one the wind is smoothed for each of N samples of drag and lean from their posterior. The lean is
       specific force that no wind causes. The spread of the N winds is the error by uncertain drag and lean, and the
       smoother's variance is the error by noise.
    3. From these follow the mean wind with its intervals, gusts, the wind by minute and by height.
    4. Estimates that the flight does not determine well are marked as biased or not identifiable, with the reason, and
       with what to fly to know them better.

    Args:
        time: stamps (T,), s, ascending; there may be gaps.
        attitude: roll, pitch and yaw (T, 3), rad, Z-Y-X; rows that are not finite are left out.
        velocity: velocity over ground, north, east and down (T, 3), m/s.
        drag: drag of the vehicle, from another flight or :func:`mavdem.estimate_drag`; None for the population's.
        height: height (T,), m, for the wind by height; None if it is not known.

    Returns:
        The wind: its mean, gusts and time series with their intervals, and the drag.

    Raises:
        ValueError: an array has another shape, the time does not ascend, or the drag is not a ``Drag``.
        NotLearnable: the flight is too short, the vehicle was held or carried, or the velocity is not the vehicle's.
    """
    samples = validated_motion(time, attitude, velocity)
    heights = _validated_heights(height, len(time))[samples.usable]
    prior = Drag.validated_or_population(drag)
    flight = _smoothed_flight(samples, prior)
    grid, winds = flight.grid, flight.winds
    wind_of_steps = winds.velocity
    mean_wind = mean_wind_of_steps(winds.velocities, winds.noise_variances, grid.step)
    air_velocity = _air_velocity(grid, wind_of_steps)
    flight_drag = _drag_of_flight(flight.posterior, prior, mean_air_speed(air_velocity))
    doubts = doubts_on_wind(
        mean_wind,
        flight_drag.relative_sd,
        flight_drag.remaining_sd,
        is_lean_more_uncertain(winds.velocities.mean(axis=0), flight.parameter_samples),
        flight.posterior.steered_share,
        float(np.nanmax(np.hypot(*grid.velocity[:, HORIZONTAL].T))),
        prior.source,
    )
    status = _status_of_figures(doubts)
    lowest_speed = lower_speed_bound(mean_wind.low, mean_wind.high)
    gust = winds.largest_gust(may_be_calm=lowest_speed == 0)
    mean_speed = winds.mean_speed()
    step_heights = np.interp(grid.time, samples.time, heights)
    minutes = mean_wind_by_minute(winds.velocities, winds.noise_variances, grid.time, grid.step)
    profile = wind_profile(winds.velocities, winds.noise_variances, step_heights, grid.step)
    return WindVelocity(
        speed=mean_wind.speed,
        speed_interval=(lowest_speed, mean_wind.high),
        mean_speed=mean_speed.value,
        mean_speed_interval=mean_speed.interval,
        direction=mean_wind.direction,
        direction_interval=mean_wind.direction_half_width,
        gust=gust.value,
        gust_interval=gust.interval,
        gust_seconds=winds.steps_of_gust * grid.step,
        turbulence_intensity=_turbulence_intensity(wind_of_steps),
        time=grid.time,
        velocity=wind_of_steps,
        band=winds.band,
        along=_air_velocity(grid, wind_of_steps.mean(axis=0)),
        air_velocity=air_velocity,
        minutes=tuple(minutes),
        profile=tuple(profile),
        drag=flight_drag.drag,
        status=status,
        reasons={doubt.figure: doubt.reason for doubt in doubts},
        advice=_flight_advice(mean_wind, lowest_speed, status, flight_drag),
    )


class _SmoothedFlight(NamedTuple):
    """The wind of a flight for samples of the drag, and the posterior of the drag by the flight."""

    grid: MotionGrid
    """Motion of the flight at T even time steps."""

    winds: _SampledWind
    """Wind at these steps in each of N samples."""

    posterior: DragPosterior
    """Posterior of drag, lean, gusts and noise."""

    parameter_samples: Array
    """The N samples of these parameters (N, 10) from their posterior."""


def _smoothed_flight(samples: MotionSamples, prior: Drag) -> _SmoothedFlight:
    """Identifies the drag of a vehicle by one flight, then smooths the wind of that flight for samples of the drag.

    Args:
        samples: attitude and velocity of the flight.
        prior: mean and covariance of the vehicle's drag by what is known without this flight.

    Returns:
        The wind at T even time steps for each of N samples of the drag, the samples, and their distribution.
    """
    # The matrices are small: several threads of the linear algebra library would only cost time.
    with one_thread():
        # The identification filters the flight many times, and uses half as many steps as the result, to save time.
        identification_grid = flight_grid(samples, max_steps=MAX_STEPS // 2)
        posterior = identify_drag(identification_grid, prior)
        grid = flight_grid(samples, max_steps=MAX_STEPS)
        parameter_samples = sampled_parameters(posterior)
        winds = _SampledWind.from_states(sampled_winds(grid, parameter_samples), grid.step)
    return _SmoothedFlight(grid, winds, posterior, parameter_samples)


def _status_of_figures(doubts: Sequence[DoubtedFigure]) -> dict[str, Status]:
    """Returns whether "speed", "direction" and "drag" of a wind are reported, biased or not identifiable.

    Args:
        doubts: the figures that are not reported, with their status.
    """
    status = dict.fromkeys(("speed", "direction", "drag"), Status.REPORTED)
    for doubt in doubts:
        status[doubt.figure] = doubt.status
    return status


def _validated_heights(height: Array | None, count: int) -> Array:
    """Returns the heights (count,) of a flight, m; zeros if they are not known.

    Raises:
        ValueError: there are not as many heights as samples.
    """
    heights = np.zeros(count) if height is None else np.asarray(height, np.float64)
    if heights.shape != (count,):
        raise ValueError(f"height must have shape ({count},), not {heights.shape}")
    return heights


def _air_velocity(motion: MotionGrid, wind: Array) -> Array:
    """Returns the velocity of a vehicle relative to the air, along body x and y (T, 2), m/s.

    Args:
        motion: velocity over ground and attitude at T steps.
        wind: wind velocity, north and east, of each step (T, 2) or of all (2,), m/s. It is taken to be horizontal.
    """
    relative_velocity = motion.velocity.copy()
    relative_velocity[:, HORIZONTAL] -= wind
    return motion.along_body_axes(relative_velocity)


@dataclass(frozen=True)
class _SampledWind:
    """The wind at T time steps of a flight, for each of N samples of drag and lean from their posterior.

    The spread over the samples is the error of the wind by uncertain drag and lean. The error by noise is extra.
    """

    velocities: Array
    """Wind velocity in each sample, north and east (T, N, 2), m/s."""

    noise_variances: Array
    """Variance of the error of each component by noise (T, N, 2), (m/s)²."""

    step: float
    """Time step, s."""

    @classmethod
    def from_states(cls, smoothed: SmoothedStates, step: float) -> Self:
        """Returns the wind by the states of the smoother, which are the gust and the mean wind: the wind is their sum.

        Args:
            smoothed: states (T, N, 4) and their covariances, for N samples of the parameters.
            step: time step, s.
        """
        # Letters of einsum: time t, sample n, axis a of the wind, states i and j.
        variances = np.einsum(
            "ai,tnij,aj->tna", TOTAL_WIND_MATRIX, smoothed.covariances, TOTAL_WIND_MATRIX
        )
        return cls(smoothed.states @ TOTAL_WIND_MATRIX.T, variances, step)

    @cached_property
    def velocity(self) -> Array:
        """The estimated wind velocity (T, 2), m/s: the mean over the samples."""
        return self.velocities.mean(axis=1)

    @property
    def band(self) -> Array:
        """Half widths (T, 2) of the 90 % band of both components, m/s."""
        return half_width(self.noise_variances.mean(axis=1) + self.velocities.var(axis=1))

    @cached_property
    def _speeds(self) -> Array:
        """Wind speed (T, N) in each sample, m/s."""
        return np.hypot(self.velocities[..., 0], self.velocities[..., 1])

    @property
    def _noise_variance_of_flight(self) -> Array:
        """Variance (N,) of the error by noise along one direction, (m/s)²: the mean over the flight."""
        return self.noise_variances.mean(axis=(0, 2))

    def mean_speed(self) -> IntervalEstimate:
        """Returns the mean over the flight of the wind speed, m/s, with its interval.

        Unlike the speed of the mean wind velocity, it does not fall where the wind turns.
        """
        mean_speed = float(np.hypot(*self.velocity.T).mean())
        # The noise averages out over the flight.
        noise_variance = self._noise_variance_of_flight / independent_count(
            len(self.velocities), self.step
        )
        low, high = speed_interval(self._speeds.mean(axis=0), noise_variance, mean_speed)
        return IntervalEstimate(mean_speed, low, high)

    @property
    def steps_of_gust(self) -> int:
        """Number of time steps over which the wind speed is averaged for a gust, at least 1."""
        return max(round(GUST_SECONDS / self.step), 1)

    def largest_gust(self, *, may_be_calm: bool) -> IntervalEstimate:
        """Returns the largest mean wind speed over the duration of a gust, m/s, with its interval.

        Args:
            may_be_calm: whether the whole flight may have been in still air; then the interval begins at 0.
        """
        speeds = np.hypot(*self.velocity.T)[:, np.newaxis]
        gust = float(running_means(speeds, self.steps_of_gust).max())
        # (N,) the largest gust in each sample.
        sampled_gusts = running_means(self._speeds, self.steps_of_gust).max(axis=0)
        # A gust is too short for the noise to average out, so that the variance is that of a single time step.
        low, high = speed_interval(sampled_gusts, self._noise_variance_of_flight, gust)
        if may_be_calm:
            # Errors of a velocity make its speed larger than 0, so that the samples never show still air.
            low = 0.0
        return IntervalEstimate(gust, low, high)


def _turbulence_intensity(velocity: Array) -> float:
    """Returns the turbulence intensity of a wind: the standard deviation along its mean direction, over its mean speed.

    Args:
        velocity: wind velocity, north and east (T, 2), m/s.
    """
    mean_velocity = velocity.mean(axis=0)
    mean_speed = max(float(np.hypot(*mean_velocity)), MIN_SPEED)
    speed_along_mean = velocity @ (mean_velocity / mean_speed)
    return float(speed_along_mean.std()) / mean_speed


class _DragOfFlight(NamedTuple):
    """The drag of a vehicle by one flight, and how well this flight determines it."""

    drag: Drag
    """The drag with its covariance."""

    relative_sd: float
    """Standard deviation of the drag force at the mean air speed of the flight, relative to the force."""

    remaining_sd: float
    """This standard deviation, relative to the one before the flight: 1 if the flight shows nothing of the drag."""


def _drag_of_flight(posterior: DragPosterior, prior: Drag, air_speed: float) -> _DragOfFlight:
    """Returns the drag of a vehicle by its flight.

    Args:
        posterior: posterior of drag and other parameters, given the motion of the flight.
        prior: the drag before the flight.
        air_speed: mean air speed of the flight, m/s.
    """
    drag_rows = slice(DRAG_PARAMETERS)
    drag = Drag(posterior.mean[drag_rows], posterior.covariance[drag_rows, drag_rows])
    relative_sd = drag.relative_sd(air_speed)
    remaining_sd = relative_sd / prior.relative_sd(air_speed)
    # If the flight hardly reduces the error, the source of the drag is still the prior's source.
    source = prior.source if remaining_sd > MAX_REMAINING_DRAG_SD else DragSource.FLIGHT
    return _DragOfFlight(replace(drag, source=source), relative_sd, remaining_sd)


def _flight_advice(
    mean_wind: MeanWind,
    lowest_speed: float,
    status: Mapping[str, Status],
    drag: _DragOfFlight,
) -> Fact | None:
    """Returns what to fly so that the wind is known better, if its speed or direction is not reported.

    The direction of air that may be still counts as known well enough.

    Args:
        mean_wind: mean wind of the whole flight.
        lowest_speed: lower end of the 90 % interval of its speed, m/s; 0 if the air may be still.
        status: status of "speed" and "direction".
        drag: the drag by this flight, with its error.

    Returns:
        The advice as a fact; None if both are known well enough, or no flight would help much.
    """
    is_speed_reported = status["speed"] is Status.REPORTED
    # Still air has no direction that another flight could show better.
    is_direction_to_improve = lowest_speed > 0 and status["direction"] is not Status.REPORTED
    if is_speed_reported and not is_direction_to_improve:
        return None
    direction_error = None
    if is_direction_to_improve:
        direction_error = np.radians(mean_wind.direction_half_width)
    errors = WindErrors(
        mean_wind.speed,
        speed_error=(mean_wind.high - lowest_speed) / 2,
        direction_error=direction_error,
        noise_sd=mean_wind.noise_sd,
        drag_sd=drag.relative_sd,
    )
    return advised_flight(errors, drag.drag)
