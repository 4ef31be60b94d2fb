"""Estimation of the wind velocity of one flight from the attitude and the velocity of the vehicle."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import half_width
from mavdem.dem.engine.linalg import one_thread
from mavdem.facts import Fact
from mavdem.facts.identifiability import Status
from mavdem.facts.online import DragSource
from mavdem.wind_velocity.advised_flight import WindErrors, advised_flight
from mavdem.wind_velocity.airflow_filter import TOTAL_WIND_MATRIX
from mavdem.wind_velocity.drag_identification import (
    GUST_SECONDS,
    identify_drag,
    sampled_parameters,
    sampled_winds,
)
from mavdem.wind_velocity.identifiability import (
    MAX_REMAINING_DRAG_SD,
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
from mavdem.wind_velocity.motion_grid import MAX_STEPS, flight_grid, validated_motion
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
    heights = np.zeros(len(time)) if height is None else np.asarray(height, np.float64)
    if heights.shape != (len(time),):
        raise ValueError(f"height must have shape ({len(time)},), not {heights.shape}")
    prior = Drag.validated_or_population(drag)
    with one_thread():
        coarse = flight_grid(samples, max_steps=MAX_STEPS // 2)
        fine = flight_grid(samples, max_steps=MAX_STEPS)
        posterior = identify_drag(coarse, prior)
        parameter_samples = sampled_parameters(posterior)
        wind_samples = sampled_winds(fine, parameter_samples)
    # The states are gust and mean wind, whose sum is the wind: N samples of it (T, N, 2), with variances by noise.
    # Letters of einsum: time t, sample n, axis a of the wind, states i and j.
    winds = wind_samples.states @ TOTAL_WIND_MATRIX.T
    variances = np.einsum(
        "ai,tnij,aj->tna", TOTAL_WIND_MATRIX, wind_samples.covariances, TOTAL_WIND_MATRIX
    )
    whole_flight = mean_wind_of_steps(winds, variances, fine.step)
    wind_velocity = winds.mean(axis=1)
    mean_wind_velocity = wind_velocity.mean(axis=0)
    step_heights = np.interp(fine.time, samples.time, heights[samples.usable])

    # The wind is taken to be horizontal.
    vertical_wind = np.zeros(len(wind_velocity))
    air_velocity = fine.along_body_axes(
        fine.velocity - np.column_stack([wind_velocity, vertical_wind])
    )
    air_speed = mean_air_speed(air_velocity)
    flight_drag = Drag(
        posterior.mean[:DRAG_PARAMETERS], posterior.covariance[:DRAG_PARAMETERS, :DRAG_PARAMETERS]
    )
    # Standard deviation of the drag at this air speed, relative to the drag and to the deviation before the flight.
    drag_sd = flight_drag.relative_sd(air_speed)
    remaining_sd = drag_sd / prior.relative_sd(air_speed)
    # If the flight hardly reduces it, the source of the drag is still the prior's source.
    source = prior.source if remaining_sd > MAX_REMAINING_DRAG_SD else DragSource.FLIGHT
    flight_drag = replace(flight_drag, source=source)
    is_lean_worse = is_lean_more_uncertain(winds.mean(axis=0), parameter_samples)
    doubts = doubts_on_wind(
        whole_flight, drag_sd, remaining_sd, is_lean_worse, posterior.steered_share, prior.source
    )
    status = dict.fromkeys(("speed", "direction", "drag"), Status.REPORTED)
    for doubt in doubts:
        status[doubt.figure] = doubt.status
    lowest_speed = lower_speed_bound(whole_flight.low, whole_flight.high)
    advice = _flight_advice(whole_flight, lowest_speed, status, drag_sd, flight_drag)

    gust_steps = max(round(GUST_SECONDS / fine.step), 1)
    # Speeds (T, N) in each posterior sample, and the variance (N,) of their error by noise, the mean over the flight.
    sampled_speeds = np.hypot(winds[..., 0], winds[..., 1])
    noise_variance = variances.mean(axis=(0, 2))
    gust = float(running_means(np.hypot(*wind_velocity.T)[:, np.newaxis], gust_steps).max())
    # A gust is too short for the noise to average out.
    gust_low, gust_high = speed_interval(
        running_means(sampled_speeds, gust_steps).max(axis=0), noise_variance, gust
    )
    if not lowest_speed:
        # Still air has no gusts. The samples have, since the speed of a scattered velocity is above 0.
        gust_low = 0.0
    # The mean of the speeds, unlike the speed of the mean, does not fall where the wind turns.
    mean_speed = float(np.hypot(*wind_velocity.T).mean())
    mean_speed_interval = speed_interval(
        sampled_speeds.mean(axis=0),
        noise_variance / independent_count(len(winds), fine.step),
        mean_speed,
    )
    mean_speed_square = max(mean_wind_velocity @ mean_wind_velocity, MIN_SPEED)
    return WindVelocity(
        speed=whole_flight.speed,
        speed_interval=(lowest_speed, whole_flight.high),
        mean_speed=mean_speed,
        mean_speed_interval=mean_speed_interval,
        direction=whole_flight.direction,
        direction_interval=whole_flight.direction_half_width,
        gust=gust,
        gust_interval=(gust_low, gust_high),
        gust_seconds=gust_steps * fine.step,
        turbulence_intensity=(wind_velocity @ mean_wind_velocity).std() / mean_speed_square,
        time=fine.time,
        velocity=wind_velocity,
        band=half_width(variances.mean(axis=1) + winds.var(axis=1)),
        along=fine.along_body_axes(fine.velocity - [*mean_wind_velocity, 0.0]),
        air_velocity=air_velocity,
        minutes=tuple(mean_wind_by_minute(winds, variances, fine.time, fine.step)),
        profile=tuple(wind_profile(winds, variances, step_heights, fine.step)),
        drag=flight_drag,
        status=status,
        reasons={doubt.figure: doubt.reason for doubt in doubts},
        advice=advice,
    )


def _flight_advice(
    mean_wind: MeanWind,
    lowest_speed: float,
    status: Mapping[str, Status],
    drag_sd: float,
    drag: Drag,
) -> Fact | None:
    """Returns what to fly so that the wind is known better, if its speed or direction is not reported.

    The direction of air that may be still counts as known well enough.

    Args:
        mean_wind: mean wind of the whole flight.
        lowest_speed: lower end of the 90 % interval of its speed, m/s; 0 if the air may be still.
        status: status of "speed" and "direction".
        drag_sd: relative standard deviation of the drag at the air speed of the flight.
        drag: the drag by this flight, with the lean.

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
        drag_sd=drag_sd,
    )
    return advised_flight(errors, drag)
