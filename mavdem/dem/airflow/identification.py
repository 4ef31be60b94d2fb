"""Two passes over the airflow's model: the drag by the vehicle's own manoeuvres, then the wind for each drag it may be.

The velocity that gusts cause is correlated with the wind, and says next to nothing of the drag: the first pass counts
for as much as the manoeuvres are larger. In its steps of 1 s all that is fast is noise.
"""

from __future__ import annotations

from functools import partial
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.airflow.drag import AXES, Drag, coefficients
from mavdem.dem.airflow.model import GRAVITY, Motion, air_speed, drawn, filtered, motion, posterior, smoothed
from mavdem.dem.engine.linalg import Array
from mavdem.errors import NotLearnable

LEAST_SECONDS = 15.0  # of motion with attitude and velocity
DRAG_STEP, DRAG_STEPS = 1.0, 600  # s, or the samples' own step; longer flights have so many longer steps
BESIDE_SECONDS = 10.0  # of means, where the wind was measured beside the vehicle: only its slow part is the same air
SLOW_SECONDS, MEMORY_SECONDS = 60.0, 20.0  # of the wind in the first pass, and over which its filter follows it
ANSWER_SECONDS, GUST_CORRELATION = 1.0, 0.3
"""A gust of f m/s² makes f m/s at most, before the position loop takes it back; correlation of both, in hovers."""
FOLLOWED, FAST_SECONDS, TILTED = 0.3, 0.3, 0.2
"""In free flight the velocity changes by 0.7 to 1.5 of what the tilt says, over so long; m/s² that gusts balance."""
GUSTS, GUSTS_SD = np.log([1.0, 5.0, 0.05]), np.array([1.0, 1.0, 0.7])  # of sd (m/s), time (s) and noise (m/s²)
DRAWS, ROUNDS, COURSES, GUST_STEPS, ITERATIONS = 128, 5, 32, 600, 30


def checked(time: Array, attitude: Array, velocity: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Returns the rows that are finite, and which; raises what ``estimate_wind`` says."""
    stamps, angles, speeds = (np.asarray(given, np.float64) for given in (time, attitude, velocity))
    if stamps.ndim != 1 or angles.shape != (len(stamps), 3) or speeds.shape != angles.shape:
        raise ValueError("time, attitude and velocity must have shapes (T,), (T, 3) and (T, 3)")
    if not np.isfinite(stamps).all() or (np.diff(stamps) < 0).any():
        raise ValueError("time must be finite and ascend")
    usable = np.asarray(np.isfinite(np.hstack([angles, speeds])).all(axis=1))
    if usable.sum() < 10:
        what = "yaw" if np.isfinite(angles[:, 2]).sum() < 10 <= np.isfinite(angles[:, 0]).sum() else "velocity"
        raise NotLearnable(f"The {what} is not known, and without it there is no wind.")
    stamps, angles, speeds = stamps[usable], angles[usable], speeds[usable]
    if np.abs(angles[:, :2]).max() > np.pi:
        raise ValueError("attitude seems to be in degrees: give rad")
    if (interval := float(np.median(np.diff(stamps)))) <= FAST_SECONDS:
        # Where samples are slower, gusts and the position loop come between tilt and velocity.
        shown = motion(stamps, angles, speeds, max(FAST_SECONDS, 2 * interval))
        tilt = GRAVITY * shown.axes[:, :, 2]
        earth = (np.einsum("ti,tij->tj", one, shown.axes[:, :, :2]) for one in (tilt, shown.force + tilt))
        both = shown.known[1:] & shown.known[:-1]
        turned, moved = (np.diff(values, axis=0)[both].ravel() for values in earth)
        if len(turned) > 40 and turned.std() > TILTED and turned @ moved < FOLLOWED * (turned @ turned):
            why = "the vehicle is held, carried or on the ground, or its velocity is not measured"
            raise NotLearnable(f"The velocity does not follow the tilt: {why}.")
    return stamps, angles, speeds, usable


def gridded(time: Array, attitude: Array, velocity: Array, step: float, most: int, wind: Array | None = None) -> Motion:
    """Returns ``airflow.motion`` in steps of ``step`` s, longer ones where samples are or where there were ``most``."""
    widest = max(step, float(np.median(np.diff(time))), float(time[-1] - time[0]) / most)
    found = motion(time, attitude, velocity, widest, wind)
    if found.known.sum() * found.step < LEAST_SECONDS:
        raise NotLearnable(f"Attitude and velocity cover less than {LEAST_SECONDS:g} s of flight.")
    return found


def drag_at(logs: Array, moved: Motion, drag: Drag) -> Array:
    """Returns (N,) drag over air speed, 1/s, of ``logs`` (N, ≥ 4), where ``drag`` makes the mean force of ``moved``."""
    (c, q), force = np.exp(drag.mean[:2]), np.nanmean(np.einsum("tij,ti->tj", moved.axes, moved.force)[:, :2], axis=0)
    return np.asarray(np.exp(logs[:, 0]) + np.exp(logs[:, 1]) * air_speed(c, q, float(np.hypot(*force))))


def identified(moved: Motion, drag: Drag) -> tuple[Drag, float]:
    """Returns the posterior of a prior ``drag``, and the share of the velocity's variance that gusts may make."""
    along = np.einsum("tij,tj->ti", moved.axes, moved.velocity)
    steered = along - np.nanmean(along, axis=0)  # by which an error is the slope of the likelihood by the drag
    speed = max(float(moved.velocity[moved.known, :2].var(axis=0).sum()), 1e-9)

    def whole(logs: Array, noise: float) -> Array:
        """With the wind's sd by which the steady filter follows it over its memory."""
        sd = noise * np.sqrt(moved.step * SLOW_SECONDS / 2) / MEMORY_SECONDS / drag_at(logs, moved, drag)
        return np.column_stack([logs, np.log(sd), np.tile(np.log([SLOW_SECONDS, noise]), (len(logs), 1))])

    noise, mean = 0.1, drag.mean
    for rounds in (3, ROUNDS):
        for _ in range(4):
            errors = filtered(whole(mean[None], noise), moved, keep=True)[1]
            noise = max(noise * float(np.sqrt(np.nanmean(errors**2))), 0.01)
        doubt, independent = min(2 * (ANSWER_SECONDS * noise) ** 2 / speed, 1.0), independent_share(errors * steered)
        share = independent / (1 + GUST_CORRELATION**2 * independent * moved.known.sum() * doubt)

        found = partial(lambda share, noise, logs: share * filtered(whole(logs, noise), moved)[0], share, noise)
        mean, covariance = posterior(found, drag.mean, drag.covariance, DRAWS, rounds)
    # Slow errors are as a lean, whose information is that of as many errors as are independent.
    scale = np.append(np.ones(4), np.full(2, min(independent_share(errors) / independent, 1.0)))
    before, after = np.linalg.inv(drag.covariance), np.linalg.inv(covariance)
    covariance = np.linalg.inv(before + (after - before) * np.sqrt(np.outer(scale, scale)))
    return Drag(drag.mean + covariance @ (scale * (after @ (mean - drag.mean))), covariance, "flight"), doubt


def independent_share(errors: Array) -> float:
    """Returns for how many independent ones each of ``errors`` (T, k) counts, by their autocorrelation."""
    centred = np.nan_to_num(errors - np.nanmean(errors, axis=0))
    found = (float((centred[lag:] * centred[:-lag]).sum()) for lag in range(1, min(60, len(centred) // 3)))
    return 1 / (1 + 2 * sum(takewhile(lambda one: one > 0, found)) / max(float((centred**2).sum()), 1e-12))


def courses(fine: Motion, drag: Drag) -> tuple[Array, Array]:
    """Returns states (T, N, 4) of the airflow and their covariances, by draws of the ``drag``."""
    part = fine.at(slice(GUST_STEPS))

    def likelihood(logs: Array) -> Array:
        return filtered(np.hstack([np.tile(drag.mean, (len(logs), 1)), logs]), part)[0]

    places = drawn(drag.mean, drag.covariance, COURSES)
    rest = np.tile(posterior(likelihood, GUSTS, np.diag(GUSTS_SD**2), 32, 4)[0], (COURSES, 1))
    rest[:, 0] -= np.log(drag_at(places, fine, drag) / drag_at(drag.mean[None], fine, drag))  # more drag, less wind
    return smoothed(*filtered(np.hstack([places, rest]), fine, keep=True)[2])


def estimate_drag(time: Array, attitude: Array, velocity: Array, wind: Array) -> Drag:
    """Returns the vehicle's drag and lean by a known wind.

    Args:
        time, attitude, velocity: (T,) s, (T, 3) rad and (T, 3) m/s, as :func:`mavdem.estimate_wind` takes them.
        wind: (2,) or (T, 2) m/s, north and east that the air moves to; one that varies counts in means of 10 s.

    Raises:
        ValueError, NotLearnable: as there.
    """
    if np.shape(wind) not in ((2,), (len(time), 2)):
        raise ValueError(f"wind must have shape (2,) or ({len(time)}, 2), not {np.shape(wind)}")
    air: Array = np.zeros((len(time), 2)) + np.asarray(wind, np.float64)
    speeds = np.where(np.isfinite(air).all(axis=1, keepdims=True), np.asarray(velocity, np.float64), np.nan)
    stamps, angles, speeds, usable = checked(time, attitude, speeds)
    step = BESIDE_SECONDS if float(np.ptp(air[usable], axis=0).max()) > 0.1 else DRAG_STEP
    moved, prior = gridded(stamps, angles, speeds, step, DRAG_STEPS, air[usable]), Drag.of_parameters()
    moved, mean, precision = moved.at(moved.known), prior.mean, np.linalg.inv(prior.covariance)
    relative = np.einsum("tij,tj->ti", moved.axes, moved.velocity)
    size, ones = np.hypot(*relative.T)[:, None], np.eye(2)[:, None] * -np.ones((len(relative), 1))
    for _ in range(ITERATIONS):  # Gauss-Newton
        linear, quadratic = coefficients(mean)
        errors = moved.force + (linear + quadratic * size) * relative - mean[4:]
        weight = independent_share(errors) / max(float(errors.var()), 1e-6)
        parts = linear * relative, quadratic * size * relative
        flat = np.stack([*parts, *(part * AXES for part in parts), *ones], 2).reshape(-1, 6)
        covariance = np.linalg.inv(weight * flat.T @ flat + precision)
        pull = weight * flat.T @ errors.ravel() + precision @ (mean - prior.mean)
        mean = mean - np.clip(covariance @ pull, -0.5, 0.5)
    return Drag(mean, covariance, "calibration").of_next_flight()
