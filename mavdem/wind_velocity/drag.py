"""The drag by the vehicle's own manoeuvres, and the wind for each drag it may be.

The velocity that gusts cause is correlated with the wind, and says next to nothing of the drag: what the flight says of
it counts for as much as the manoeuvres are larger.
"""

import numpy as np
from scipy.constants import g as GRAVITY  # noqa: N812
from scipy.linalg import block_diag

from mavdem.arrays import Array, ArrayPair, Flags, as_real_array
from mavdem.dem.engine.linalg import normal_draws
from mavdem.errors import NotLearnable
from mavdem.facts.online import Airflow, DragSource
from mavdem.wind_velocity.airflow import (
    FREEDOM,
    WIND_SD,
    Drag,
    MotionGrid,
    air_speed,
    coefficients,
    filtered,
    motion_grid,
)

# of a flight: a day
LONGEST_SECONDS = 1e5
LEAST_SECONDS = 15.0  # of motion with attitude and velocity
# s, or the samples' own step; longer flights have so many longer steps, half of them to identify the drag
GRID_STEP = 0.5
STEPS = 1200
GUST_SECONDS = 3.0
"""Of a gust's mean (WMO-No. 8, vol. I, ch. 5); and of means where the wind was measured beside the vehicle: only its
slow part is the same air."""
STEERED_SECONDS = 2.0
VELOCITY_SD = 0.2
"""Steered flight changes its velocity in so long, against the drag; m/s, along each axis, of the velocity's error."""
FOLLOWED = 0.3
FAST_SECONDS = 0.3
TILTED = 0.2
"""In free flight the velocity changes by 0.7 to 1.5 of what the tilt says, over so long; m/s² that gusts balance."""
GUST_PRIOR_MEAN = np.log([0.3, 5.0, 0.03, 0.05])
GUST_PRIOR_SD = np.array([1.0, 1.0, 1.0, 0.7])
"""Logarithms of gusts' sd (m/s²) and time (s), of the mean wind's change (m/s² in 1 s) and of noise (m/s²)."""
MODEL_SD = 0.09
SPLIT_SD = 0.2
"""Of the drag's logarithm, over all of a flight, as thrust, air and load change it; and of its quadratic part's."""
UNSAID = np.vstack([[[MODEL_SD, -0.3 * SPLIT_SD], [MODEL_SD, SPLIT_SD]], np.zeros((8, 2))])
# of parameters; their steps; and sd at which these end
DIFFERENCE = 0.05
LARGEST_STEP = 0.5
CONVERGED = 0.1
COURSES = 64  # draws of what is identified, each with its course of the air
ITERATIONS = 12  # at most, of Gauss and Newton
WEIGHTINGS = 5  # of a known wind's errors, by those that the drag leaves


def validated_motion(
    time: Array, attitude: Array, velocity: Array
) -> tuple[Array, Array, Array, Flags]:
    """Returns the rows that are finite, and which; raises what ``estimate_wind`` says."""
    stamps = as_real_array(time, "time")
    angles = as_real_array(attitude, "attitude")
    speeds = as_real_array(velocity, "velocity")
    if stamps.ndim != 1 or angles.shape != (len(stamps), 3) or speeds.shape != angles.shape:
        raise ValueError("time, attitude and velocity must have shapes (T,), (T, 3) and (T, 3)")
    if not np.isfinite(stamps).all() or (np.diff(stamps) < 0).any():
        raise ValueError("time must be finite and ascend")
    if len(stamps) and np.ptp(stamps) > LONGEST_SECONDS:
        raise ValueError("time must be in s, of one flight")
    usable = np.asarray(np.isfinite(np.hstack([angles, speeds])).all(axis=1))
    if usable.sum() < 10:
        missing = (
            "yaw"
            if np.isfinite(angles[:, 2]).sum() < 10 <= np.isfinite(angles[:, 0]).sum()
            else "velocity"
        )
        raise NotLearnable(Airflow.MOTION_UNKNOWN, missing=missing)
    stamps = stamps[usable]
    angles = angles[usable]
    speeds = speeds[usable]
    if abs(angles[:, :2]).max() > np.pi:
        raise ValueError("attitude seems to be in degrees: give rad")
    if (interval := np.median(np.diff(stamps))) <= FAST_SECONDS:
        # Where samples are slower, gusts and the position loop come between tilt and velocity.
        shown = motion_grid(stamps, angles, speeds, max(FAST_SECONDS, 2 * interval))
        tilt = GRAVITY * shown.axes[:, :, 2]
        earth = (
            np.einsum("ti,tij->tj", vectors, shown.axes[:, :, :2])
            for vectors in (tilt, shown.force + tilt)
        )
        both = shown.known[1:] & shown.known[:-1]
        turned, moved = (np.diff(values, axis=0)[both].ravel() for values in earth)
        if (
            len(turned) > 40
            and turned.std() > TILTED
            and turned @ moved < FOLLOWED * (turned @ turned)
        ):
            raise NotLearnable(Airflow.VELOCITY_INCONSISTENT)
    return stamps, angles, speeds, usable


def gridded(
    time: Array,
    attitude: Array,
    velocity: Array,
    step: float = GRID_STEP,
    most: int = STEPS,
    wind: Array | None = None,
) -> MotionGrid:
    """Returns the motion in steps of ``step`` s, longer ones where samples are or where there were ``most``."""
    widest = max(step, np.median(np.diff(time)), (time[-1] - time[0]) / most)
    gridded_motion = motion_grid(time, attitude, velocity, widest, wind)
    if gridded_motion.known.sum() * gridded_motion.step < LEAST_SECONDS:
        raise NotLearnable(Airflow.MOTION_TOO_SHORT, duration=LEAST_SECONDS)
    return gridded_motion


def identified(moved: MotionGrid, drag: Drag) -> tuple[Array, Array, float]:
    """Returns mean (10,) and covariance of what ``filtered`` takes, and how much of the flight :func:`opposing` is.

    Sizes of the wind are times the drag, m/s². By a prior ``drag``, and Fisher scoring of the filter's likelihood. What
    it says of the drag counts for as much as is steered, and what it says of the lean for as much as the yaw turns: the
    rest would be of the model's form. Steps may overshoot, and then lead ever farther away: the best place counts.
    """
    prior = np.append(drag.mean, GUST_PRIOR_MEAN)
    precision = block_diag(np.linalg.inv(drag.covariance), np.diag(GUST_PRIOR_SD**-2))
    steered = opposing(moved)
    ahead = moved.axes[moved.known, 0, :2]
    turned = max(1 - np.hypot(*(ahead / np.hypot(*ahead.T)[:, None]).mean(axis=0)) ** 2, 0.0)
    counted = np.repeat([steered**2, turned, 1.0], [4, 2, 4])
    mean = prior
    best = np.nan
    farthest = 4 / np.sqrt(np.diag(precision))
    apart = DIFFERENCE * np.vstack([np.zeros(10), np.eye(10), -np.eye(10)])

    def rise(values: Array) -> Array:
        return (values[1:11] - values[11:]) / (2 * DIFFERENCE)

    for _ in range(ITERATIONS):
        tracked = filtered(filter_parameters(mean + apart, moved), moved)
        errors = tracked.errors[moved.known].swapaxes(0, 1)
        spread = tracked.spread[moved.known].swapaxes(0, 1)
        inverse = np.linalg.inv(spread[0])
        slope = rise(tracked.log_likelihood)
        slopes = rise(errors)
        pulled = np.einsum("tij,tj->ti", inverse, errors[0])
        pulled *= ((FREEDOM + 2) / (FREEDOM + (pulled * errors[0]).sum(axis=1)))[:, None]
        slope[:6] = -np.einsum("kti,ti->k", slopes[:6], pulled)
        changes = np.einsum("tij,ktjl->ktil", inverse, rise(spread))[6:]
        information = np.einsum("kti,tij,ltj->kl", slopes, inverse, slopes)
        information[6:, 6:] += np.einsum("ktij,ltji->kl", changes, changes) / 2
        information *= np.sqrt(np.outer(counted, counted))
        # What the model's own error changes, no flight says.
        kept = np.eye(10) - information @ UNSAID @ np.linalg.solve(
            np.eye(2) + UNSAID.T @ information @ UNSAID, UNSAID.T
        )
        # The drag that makes a strong wind of the mean force is less likely, however little is steered.
        speed = mean_speed(mean + apart, moved) / WIND_SD
        faster = rise(speed) * (1 - steered)
        expected = -speed[0] * faster
        covariance = np.linalg.inv(precision + kept @ information + np.outer(faster, faster))
        away = mean - prior
        value = tracked.log_likelihood[0] - away @ precision @ away / 2
        if value > best or np.isnan(best):
            best = value
            estimate = mean, (covariance + covariance.T) / 2, steered
        step = covariance @ (kept @ (counted * slope) + expected - precision @ away)
        mean = np.clip(
            mean + np.clip(step, -LARGEST_STEP, LARGEST_STEP), prior - farthest, prior + farthest
        )
        if np.all(abs(step) < CONVERGED * np.sqrt(np.diag(covariance))):
            break
    return estimate


def opposing(moved: MotionGrid) -> float:
    """Returns which share of the force's variance opposes the velocity, as drag does; of gusts, both go one way."""
    steps = max(round(STEERED_SECONDS / moved.step), 1)
    force = np.einsum("tij,ti->tj", moved.axes, moved.force)[:, :2]
    both = moved.known[steps:] & moved.known[:-steps]
    pushed, moving = (
        (part[steps:] - part[:-steps])[both].ravel() for part in (force, moved.velocity[:, :2])
    )
    noise = 2 * VELOCITY_SD**2 * len(moving)
    against = -(pushed @ moving) / np.sqrt(
        max((pushed @ pushed) * (moving @ moving + noise), 1e-12)
    )
    return max(float(against), 0.0) ** 2


def filter_parameters(places: Array, moved: MotionGrid) -> Array:
    """Returns what ``filtered`` takes, of ``places`` (N, 10) with sizes of the wind times the drag."""
    (c, q) = np.exp(places[:, :2]).T
    moved_places = places.copy()
    moved_places[:, [6, 8]] -= np.log(c + q * mean_speed(places, moved))[:, None]
    return moved_places


def mean_speed(places: Array, moved: MotionGrid) -> Array:
    """Returns (N,) air speed, m/s, at which the drag of ``places`` (N, 10) makes the mean force."""
    force = np.einsum("tij,ti->tj", moved.axes, moved.force)[moved.known, :2].mean(axis=0)
    c, q = np.exp(places[:, :2]).T
    return air_speed(c, q, np.hypot(*force))


def independent_share(errors: Array) -> float:
    """Returns for how many independent ones each of ``errors`` (T, k) counts, as autoregressions of first order."""
    centred = np.nan_to_num(errors - np.nanmean(errors, axis=0))
    square = max((centred**2).sum(), 1e-12)
    correlation = min(max((centred[1:] * centred[:-1]).sum() / square, 0.0), 0.99)
    return (1 - correlation) / (1 + correlation)


def courses(moved: MotionGrid, mean: Array, covariance: Array) -> ArrayPair:
    """Returns states (T, N, 4) of the airflow and their covariances, by draws of what is :func:`identified`."""
    places = filter_parameters(normal_draws(mean, covariance, COURSES, seed=1), moved)
    return filtered(places, moved).smoothed()


def estimate_drag(
    time: Array,
    attitude: Array,
    velocity: Array,
    wind: Array,
) -> Drag:
    """Returns the vehicle's drag and lean by a known wind.

    Args:
        time, attitude, velocity: (T,) s, (T, 3) rad and (T, 3) m/s, as :func:`mavdem.estimate_wind` takes them.
        wind: (2,) or (T, 2) m/s, north and east that the air moves to; one that varies counts in means of 3 s.

    Raises:
        ValueError, NotLearnable: as there.
    """
    from scipy.optimize import least_squares  # it takes half a second to import

    velocities = as_real_array(wind, "wind")
    if velocities.shape not in ((2,), (len(time), 2)):
        raise ValueError(f"wind must have shape (2,) or ({len(time)}, 2), not {velocities.shape}")
    air = np.broadcast_to(velocities, (len(time), 2))
    speeds = as_real_array(velocity, "velocity")
    speeds = np.where(np.isfinite(air).all(axis=1, keepdims=True), speeds, np.nan)
    stamps, angles, speeds, usable = validated_motion(time, attitude, speeds)
    step = GUST_SECONDS if np.ptp(air[usable], axis=0).max() > 0.1 else GRID_STEP
    moved = gridded(stamps, angles, speeds, step, wind=air[usable])
    prior = Drag.of_parameters()
    moved = moved.at(moved.known)
    relative = np.einsum("tij,tj->ti", moved.axes, moved.velocity)
    size = np.hypot(*relative.T)[:, None]
    whitening = np.linalg.inv(np.linalg.cholesky(prior.covariance))

    def errors(logs: Array) -> Array:
        linear, quadratic = coefficients(logs)
        return moved.force + (linear + quadratic * size) * relative - logs[4:]

    def residuals(logs: Array, weight: float) -> Array:
        return np.append(weight**0.5 * errors(logs), whitening @ (logs - prior.mean))

    mean = prior.mean
    for _ in range(WEIGHTINGS):
        left = errors(mean)
        weight = independent_share(left) / max(left.var(), 1e-6)
        solution = least_squares(residuals, mean, args=(weight,))
        mean = solution.x
    slopes = np.asarray(solution.jac)
    covariance = np.linalg.inv(slopes.T @ slopes)
    return Drag(mean, covariance, DragSource.CALIBRATION).of_next_flight()
