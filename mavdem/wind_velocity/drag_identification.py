"""Identification of the drag: from a flight's own manoeuvres, or from a known wind.

Gusts change the velocity of a vehicle as well, so its velocity is correlated with the wind and shows little of the
drag. The likelihood's information on the drag is therefore scaled by how much of the force opposes the velocity, as
drag does in manoeuvres.

The scaled parameters (10,) that are identified are the six entries of ``Drag.mean``, and logarithms of the wind's
parameters times the drag, so that these are accelerations: the gusts' standard deviation (m/s²), their time (s), the
change of the mean wind (m/s² in 1 s), and the standard deviation of the force's noise (m/s²).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from mavdem.arrays import Array, as_real_array
from mavdem.dataset.axes import HORIZONTAL
from mavdem.dem.engine.linalg import normal_draws
from mavdem.facts.online import DragSource
from mavdem.wind_velocity.airflow_filter import (
    DEGREES_OF_FREEDOM,
    WIND_SD,
    FilteredMotion,
    SmoothedStates,
    filter_motion,
)
from mavdem.wind_velocity.motion_grid import (
    GRID_STEP,
    MotionGrid,
    flight_grid,
    validated_motion,
)
from mavdem.wind_velocity.vehicle_drag import (
    DRAG_PARAMETERS,
    LEAN,
    LOG_LINEAR,
    LOG_QUADRATIC,
    Drag,
    air_speed,
    axis_drag,
)

GUST_SECONDS = 3.0
"""Averaging time of a gust, s (WMO-No. 8, Guide to Instruments and Methods of Observation, vol. I, ch. 5).

Winds that were measured near the vehicle are averaged over it as well: only their slow part is the same air.
"""

STEERED_SECONDS = 2.0
"""Time over which steering changes the velocity, s, in which force and velocity are compared: a choice."""

VELOCITY_SD = 0.2
"""Standard error of the velocity along each axis, m/s."""

GUST_PRIOR_MEAN = np.log([0.3, 5.0, 0.03, 0.05])
"""Prior mean of the last four scaled parameters: gusts' size and time, change of the mean wind, noise."""

GUST_PRIOR_SD = np.array([1.0, 1.0, 1.0, 0.7])
"""Prior standard deviation of the last four scaled parameters."""

PARAMETER_COUNT = DRAG_PARAMETERS + len(GUST_PRIOR_MEAN)
"""Number of scaled parameters."""

GUST_SIZE = 6
"""Index of the logarithm of the gusts' size among the scaled parameters."""

MEAN_WIND_CHANGE = 8
"""Index of the logarithm of the mean wind's change among the scaled parameters."""

DRAG_CHANGE_SD = 0.09
"""Standard deviation of the logarithm of a flight's drag about its model's drag, by thrust, air density and load."""

QUADRATIC_CHANGE_SD = 0.2
"""Standard deviation of a further change of the logarithm of the quadratic drag, in the same flights."""

LINEAR_PER_QUADRATIC_CHANGE = -0.3
"""Change of the logarithm of the linear drag per such change of the quadratic one: a choice."""

MODEL_ERROR = np.vstack(
    [
        [
            [DRAG_CHANGE_SD, LINEAR_PER_QUADRATIC_CHANGE * QUADRATIC_CHANGE_SD],
            [DRAG_CHANGE_SD, QUADRATIC_CHANGE_SD],
        ],
        np.zeros((PARAMETER_COUNT - 2, 2)),
    ]
)
"""Square root L (10, 2) of the covariance L Lᵀ of the scaled parameters by these two changes of the drag."""

DIFFERENCE_STEP = 0.05
"""Step of central differences by each scaled parameter: a choice."""

SPEED_SCALE = 2**0.5 * WIND_SD
"""Root mean square of the wind's speed by its prior, m/s: of a vector with ``WIND_SD`` along north and east."""

MAX_STEP = 0.5
"""Largest change of any scaled parameter in one iteration: a choice."""

CONVERGED_STEP = 0.1
"""Step in standard deviations of each scaled parameter with which the iteration ends: a choice."""

MAX_PRIOR_DEVIATIONS = 4.0
"""Distance from the prior mean, in standard deviations, that no scaled parameter exceeds."""

USUAL_ITERATIONS = 12
"""Number of iterations of Fisher scoring after which it ends if it has converged: a choice."""

MAX_ITERATIONS = 40
"""Number of iterations of Fisher scoring, at most: a choice."""

REPEATED_CHANGE = 0.5
"""Change of the log posterior over two iterations, in nats, below which the search repeats itself.

A choice, small compared with the 3 nats that are strong evidence. On 46 recorded and simulated flights the search then
ends after 0.82 of the iterations, and the highest posterior is lower by 0.3 nats at most.
"""

CONVERGED_CHANGE = 5.0
"""Change of the log posterior over one or two iterations, in nats, from which on the search is still under way.

A choice: around a maximum that the search has found, it changes by 1 or 2 nats.
"""

WIND_DRAWS = 64
"""Number of posterior samples of the scaled parameters, each with its own wind: a choice."""

WEIGHTING_ITERATIONS = 5
"""Number of iterations in which the weight of a known wind's errors is found: a choice."""

VARYING_WIND = 0.1
"""Range of a known wind's component, m/s, from which on it varies, and is averaged over ``GUST_SECONDS``."""

MIN_POWER = 1e-12
"""Least sum of squares in a denominator: it only avoids a division by 0."""

MAX_AUTOCORRELATION = 0.99
"""Largest lag-one autocorrelation of errors: at 1, no number of them would be enough."""

MIN_VARIANCE = 1e-6
"""Least variance of the errors with a known wind, (m/s²)²: it only avoids a division by 0."""


class DragPosterior(NamedTuple):
    """Posterior of the scaled parameters by one flight."""

    mean: Array
    """Mean (10,)."""

    covariance: Array
    """Covariance (10, 10)."""

    steered_share: float
    """Fraction of the force's variance that opposes the velocity, as by steering."""


class _Expansion(NamedTuple):
    """The filter's likelihood about some scaled parameters, to second order."""

    log_likelihood: float
    """Log likelihood, up to a constant."""

    gradient: Array
    """Gradient (10,) of the log likelihood."""

    information: Array
    """Fisher information (10, 10)."""

    speed_slope: Array
    """Derivatives of the mean air speed, relative to ``SPEED_SCALE``, by the scaled parameters (10,)."""

    prior_gradient: Array
    """Gradient (10,) of the log prior density of the mean force, which follows from the prior of the wind's speed."""


def identify_drag(grid: MotionGrid, drag: Drag) -> DragPosterior:
    """Identifies the drag and the sizes of gusts and noise by Fisher scoring of the filter's likelihood.

    The ten scaled parameters are four logarithms of drag coefficients, the lean along body x and y (specific force that
    no wind causes), and four logarithms of the sizes and times of gusts, changes of the mean wind, and noise.

    Drag and wind can be distinguished only in manoeuvres, and lean and wind only while the vehicle yaws. Without these
    the likelihood would still depend on them, but only because of the form of the model. So its information is
    multiplied by a factor below 1: for drag the squared fraction of the force that manoeuvres explain
    (``steered_fraction``), for lean the fraction of turned yaw.

    Each iteration expands the log likelihood, adds the prior, and makes one step. Steps may overshoot and then diverge,
    so the result is the parameters with the highest posterior of all iterations. The prior of the mean force
    (:func:`log_prior_of_force`) is used only for the steps, not in that posterior. A search that has not converged
    after ``USUAL_ITERATIONS`` continues, since after fast manoeuvres it may move far away before it finds the drag. It
    ends earlier if it repeats its values (:func:`_has_converged`).

    Args:
        grid: motion of the flight.
        drag: prior of the drag.

    Returns:
        Mean and covariance of the ten scaled parameters, and the fraction of the force that steering explains.
    """
    prior = _Prior.with_drag(drag)
    information_used = _InformationUsed.of_flight(grid)
    mean = prior.mean
    highest_log_posterior = np.nan
    log_posteriors = list[float]()
    while len(log_posteriors) < MAX_ITERATIONS:
        expansion = _expand_log_posterior(mean, grid, prior, information_used)
        log_posterior = expansion.log_posterior
        if log_posterior > highest_log_posterior or np.isnan(highest_log_posterior):
            highest_log_posterior = log_posterior
            covariance = (expansion.covariance + expansion.covariance.T) / 2
            best_posterior = DragPosterior(mean, covariance, information_used.steered_fraction)
        log_posteriors.append(log_posterior)
        if _has_converged(log_posteriors):
            break
        step = expansion.covariance @ expansion.gradient
        mean = prior.clipped(mean + np.clip(step, -MAX_STEP, MAX_STEP))
        if np.all(abs(step) < CONVERGED_STEP * np.sqrt(np.diag(expansion.covariance))):
            break
    return best_posterior


class _Prior(NamedTuple):
    """Gaussian prior of the ten scaled parameters."""

    mean: Array
    """Mean (10,)."""

    precision: Array
    """Inverse (10, 10) of the covariance."""

    @classmethod
    def with_drag(cls, drag: Drag) -> _Prior:
        """Returns the prior of drag and lean of a vehicle, with that of gusts and noise, which is the same for all.

        Args:
            drag: mean and covariance of the six parameters of drag and lean.
        """
        gust_precision = np.diag(GUST_PRIOR_SD**-2)
        return cls(
            mean=np.append(drag.mean, GUST_PRIOR_MEAN),
            precision=scipy.linalg.block_diag(np.linalg.inv(drag.covariance), gust_precision),
        )

    def clipped(self, parameters: Array) -> Array:
        """Returns scaled parameters (10,), none further from its prior mean than ``MAX_PRIOR_DEVIATIONS``."""
        max_deviation = MAX_PRIOR_DEVIATIONS / np.sqrt(np.diag(self.precision))
        clipped: Array = np.clip(parameters, self.mean - max_deviation, self.mean + max_deviation)
        return clipped


class _InformationUsed(NamedTuple):
    """How much of a flight's information on the scaled parameters is used, by how the vehicle manoeuvred."""

    steered_fraction: float
    """Fraction of the force's variance that opposes the velocity, as in manoeuvres."""

    fractions: Array
    """Fraction (10,) of the information on each parameter that is used."""

    @classmethod
    def of_flight(cls, grid: MotionGrid) -> _InformationUsed:
        """Returns the fractions of a flight: for drag by its manoeuvres, for lean by its turns of the yaw.

        Args:
            grid: motion of the flight.
        """
        steered_fraction = steered_share(grid)
        # Four entries of drag, two of lean, and four of gusts and noise.
        fractions = np.repeat([steered_fraction**2, _turned_fraction(grid), 1.0], [4, 2, 4])
        return cls(steered_fraction, fractions)


class _PosteriorExpansion(NamedTuple):
    """The posterior of the scaled parameters about some values of them, to second order."""

    log_posterior: float
    """Log posterior density, up to a constant, without the prior of the mean force."""

    gradient: Array
    """Gradient (10,) of the log posterior density, with that prior."""

    covariance: Array
    """Inverse (10, 10) of the information, with that prior."""


def _expand_log_posterior(
    parameters: Array, grid: MotionGrid, prior: _Prior, information_used: _InformationUsed
) -> _PosteriorExpansion:
    """Expands the log posterior of the ten scaled parameters to second order, for one step of Fisher scoring.

    It is the sum of three expansions: of the filter's likelihood, of the Gaussian prior of the parameters, and of the
    prior of the mean force, by which a drag is improbable with which that force would mean an improbable wind. The less
    of the force comes of steering, the more of it is wind, and the more the last one counts.

    Args:
        parameters: point of the expansion (10,).
        grid: motion of the flight.
        prior: Gaussian prior of the scaled parameters.
        information_used: fractions (0 to 1) of the flight's information on each of them that are used, and the fraction
            of the force's variance that comes of steering.

    Returns:
        The log posterior at this point, without the prior of the mean force, its gradient (10,) and the inverse of its
        information (10, 10).
    """
    likelihood = _expand_log_likelihood(parameters, grid)
    used_fractions = information_used.fractions
    information = likelihood.information * np.sqrt(np.outer(used_fractions, used_fractions))
    discount = _discount_by_drag_changes(information)
    likelihood_gradient = discount @ (used_fractions * likelihood.gradient)
    deviation = parameters - prior.mean
    prior_gradient = -prior.precision @ deviation
    unsteered_fraction = 1 - information_used.steered_fraction
    force_prior_gradient = unsteered_fraction * likelihood.prior_gradient
    # Slope (10,) of the mean air speed relative to the standard deviation of the wind's speed by its prior: its outer
    # product with itself is the information of the prior of the mean force.
    speed_slope = unsteered_fraction * likelihood.speed_slope
    log_prior = -deviation @ prior.precision @ deviation / 2
    posterior_information = (
        prior.precision + discount @ information + np.outer(speed_slope, speed_slope)
    )
    return _PosteriorExpansion(
        log_posterior=float(likelihood.log_likelihood + log_prior),
        gradient=likelihood_gradient + force_prior_gradient + prior_gradient,
        covariance=np.asarray(np.linalg.inv(posterior_information), dtype=float),
    )


def _discount_by_drag_changes(information: Array) -> Array:
    """Returns the matrix (10, 10) by which changes of the drag within the flight reduce the information of its data.

    The model has a constant drag. If L Lᵀ is the covariance of the changes of the scaled parameters, the information I
    with unknown changes is (I⁻¹ + L Lᵀ)⁻¹ = D I. By the matrix inversion lemma, D = 1 − I L (1 + Lᵀ I L)⁻¹ Lᵀ.

    Args:
        information: Fisher information I (10, 10) on the scaled parameters if they did not change.
    """
    changes_sd = MODEL_ERROR
    change_count = changes_sd.shape[1]
    precision_of_changes = np.eye(change_count) + changes_sd.T @ information @ changes_sd
    return np.eye(PARAMETER_COUNT) - information @ changes_sd @ np.linalg.solve(
        precision_of_changes, changes_sd.T
    )


def _has_converged(log_posteriors: Sequence[float]) -> bool:
    """Returns whether the search for the drag has converged, by the log posteriors of its iterations so far.

    There are two cases:

    - The search alternates between two points on either side of the maximum, since its steps overshoot: twice in
      succession, the log posterior is nearly the same as two iterations before.
    - After ``USUAL_ITERATIONS``, the log posterior differs little from one of the two before it.

    Args:
        log_posteriors: log posterior density after each iteration, nats, in their order.

    Returns:
        Whether it has converged; False before the fourth iteration.
    """
    if len(log_posteriors) < 4:
        return False
    fourth_last, third_last, second_last, latest = log_posteriors[-4:]
    change = abs(latest - second_last)
    change_over_two = abs(latest - third_last)
    earlier_change_over_two = abs(second_last - fourth_last)
    is_alternating = change_over_two < REPEATED_CHANGE and earlier_change_over_two < REPEATED_CHANGE
    if is_alternating:
        return True
    has_small_change = change < CONVERGED_CHANGE or change_over_two < CONVERGED_CHANGE
    return len(log_posteriors) > USUAL_ITERATIONS and has_small_change


def _expand_log_likelihood(scaled_parameters: Array, grid: MotionGrid) -> _Expansion:
    """Expands the log likelihood of the wind filter to second order, for one step of Fisher scoring.

    The derivatives are central differences. There are 21 sets of scaled parameters: the given one, and one on either
    side of it for each of the ten parameters. The filter processes all of them together.

    With innovations e and their covariance S, the Fisher information of two parameters is
    Σ_t ∂eᵀ S⁻¹ ∂e + ½ tr(S⁻¹ ∂S S⁻¹ ∂S). The gradient by drag and lean is −Σ_t ∂eᵀ S⁻¹ e for constant S, with the
    weights of Student's t distribution, which reduce the effect of outliers.

    Args:
        scaled_parameters: point of the expansion (10,).
        grid: motion of the flight.

    Returns:
        Value, gradient (10,) and information (10, 10) of the log likelihood, the derivatives of the mean air speed, and
        those of the log prior density of the mean force.
    """
    steps = DIFFERENCE_STEP * np.vstack(
        [np.zeros(PARAMETER_COUNT), np.eye(PARAMETER_COUNT), -np.eye(PARAMETER_COUNT)]
    )
    points = scaled_parameters + steps

    def central_differences(values: Array) -> Array:
        """Returns the derivatives of values (21, …) by each parameter (10, …)."""
        # Values at the point itself come first, then those after positive steps, then those after negative steps.
        after_positive_step = values[1 : PARAMETER_COUNT + 1]
        after_negative_step = values[PARAMETER_COUNT + 1 :]
        return (after_positive_step - after_negative_step) / (2 * DIFFERENCE_STEP)

    filtered_motion: FilteredMotion = filter_motion(filter_parameters(points, grid), grid)
    # Innovations (21, T, 2) and their covariances (21, T, 2, 2) at all points; index 0 is the point itself.
    innovations = filtered_motion.innovations[grid.complete].swapaxes(0, 1)
    covariances = filtered_motion.innovation_covariances[grid.complete].swapaxes(0, 1)
    inverse = np.linalg.inv(covariances[0])
    slopes = central_differences(innovations)

    # Letters of einsum: time t, parameters k and l; i and j the axes of the innovations.
    whitened_innovations = np.einsum("tij,tj->ti", inverse, innovations[0])
    squares = (whitened_innovations * innovations[0]).sum(axis=1)
    whitened_innovations *= ((DEGREES_OF_FREEDOM + 2) / (DEGREES_OF_FREEDOM + squares))[:, None]
    gradient = central_differences(filtered_motion.log_likelihoods)
    gradient[:DRAG_PARAMETERS] = -np.einsum(
        "kti,ti->k", slopes[:DRAG_PARAMETERS], whitened_innovations
    )

    # The covariance of the innovations contains information on the sizes of gusts and noise as well; for drag and lean
    # that part is left out.
    covariance_slopes = central_differences(covariances)
    relative_slopes = np.einsum("tij,ktjl->ktil", inverse, covariance_slopes)[DRAG_PARAMETERS:]
    information = np.einsum("kti,tij,ltj->kl", slopes, inverse, slopes)
    information[DRAG_PARAMETERS:, DRAG_PARAMETERS:] += (
        np.einsum("ktij,ltji->kl", relative_slopes, relative_slopes) / 2
    )
    speeds = air_speed_of_mean_force(points, grid)
    return _Expansion(
        filtered_motion.log_likelihoods[0],
        gradient,
        information,
        central_differences(speeds / SPEED_SCALE),
        central_differences(log_prior_of_force(points, speeds)),
    )


def steered_share(grid: MotionGrid) -> float:
    """Returns the fraction of the force's changes that is drag by manoeuvres; only this part determines the drag.

    In a manoeuvre, drag opposes the change of the velocity: force and velocity change in opposite directions. A gust
    accelerates the vehicle: both change in the same direction. So the share is the square of the correlation between
    changes of force and velocity over ``STEERED_SECONDS`` if that is negative, and 0 otherwise.

    Args:
        grid: velocity and specific force of the flight on an even time grid.

    Returns:
        Fraction of the variance of the force's changes, 0 to 1.
    """
    steps = max(round(STEERED_SECONDS / grid.step), 1)
    force = grid.level_force[:, HORIZONTAL]
    velocity = grid.velocity[:, HORIZONTAL]
    # A change is known if force and velocity are known at both its ends. North and east are taken together.
    is_change_known = grid.complete[steps:] & grid.complete[:-steps]
    force_changes = (force[steps:] - force[:-steps])[is_change_known].ravel()
    velocity_changes = (velocity[steps:] - velocity[:-steps])[is_change_known].ravel()
    # The error of a difference of two velocities has twice the variance of the error of one velocity. It is added to
    # the power of the changes, so that a hover, in which the velocity hardly changes, has a fraction of about 0.
    noise_power = 2 * VELOCITY_SD**2 * len(velocity_changes)
    force_power = force_changes @ force_changes
    velocity_power = velocity_changes @ velocity_changes + noise_power
    scale = np.sqrt(max(float(force_power * velocity_power), MIN_POWER))
    correlation = float(force_changes @ velocity_changes) / scale
    return max(-correlation, 0.0) ** 2


def _turned_fraction(grid: MotionGrid) -> float:
    """Returns the spread of the yaw: 1 minus the square of the mean heading vector's length, 0 to 1."""
    forward_axes = grid.body_axes[grid.complete, 0, :2]
    headings = forward_axes / np.hypot(*forward_axes.T)[:, None]
    return max(1 - np.hypot(*headings.mean(axis=0)) ** 2, 0.0)


def filter_parameters(scaled_parameters: Array, grid: MotionGrid) -> Array:
    """Converts scaled parameters to the parameters of :class:`AirflowFilter`.

    In the scaled parameters, the sizes of gusts and of the change of the mean wind are accelerations, m/s², which a
    flight shows independently of the drag. The filter needs them as velocities, m/s: the acceleration divided by the
    drag per speed, c + q |u|, at the mean air speed |u|.

    Args:
        scaled_parameters: (N, 10) N sets of scaled parameters; sizes are logarithms.
        grid: motion of the flight, from which the mean air speed follows.

    Returns:
        (N, 10) parameters of the filter.
    """
    linear, quadratic = np.exp(scaled_parameters[:, [LOG_LINEAR, LOG_QUADRATIC]]).T
    drag_per_speed = linear + quadratic * air_speed_of_mean_force(scaled_parameters, grid)
    parameters = scaled_parameters.copy()
    parameters[:, [GUST_SIZE, MEAN_WIND_CHANGE]] -= np.log(drag_per_speed)[:, None]
    return parameters


def air_speed_of_mean_force(scaled_parameters: Array, grid: MotionGrid) -> Array:
    """Returns the air speed (N,), m/s, at which the drag of scaled parameters (N, 10) causes the mean force."""
    force = grid.level_force[grid.complete, HORIZONTAL].mean(axis=0)
    linear, quadratic = np.exp(scaled_parameters[:, [LOG_LINEAR, LOG_QUADRATIC]]).T
    return air_speed(linear, quadratic, np.hypot(*force))


def log_prior_of_force(scaled_parameters: Array, speeds: Array) -> Array:
    """Returns the log prior density (N,) of the mean force by N sets of scaled parameters, up to a constant.

    The prior density of the wind speed u is half-normal with the scale ``SPEED_SCALE``. A flight does not show the
    speed but the force f = c u + q u². Its density is the density of the speed times the derivative of the speed by the
    force, 1 / (c + 2 q u). Without that factor a strong drag in a weak wind would seem more probable than it is.

    Args:
        scaled_parameters: (N, 10) N sets of scaled parameters.
        speeds: (N,) air speeds, m/s, at which their drag causes the mean force (:func:`air_speed_of_mean_force`).

    Returns:
        Log density (N,), nats.
    """
    linear, quadratic = np.exp(scaled_parameters[:, [LOG_LINEAR, LOG_QUADRATIC]]).T
    force_slopes = linear + 2 * quadratic * speeds
    log_density: Array = -((speeds / SPEED_SCALE) ** 2) / 2 - np.log(force_slopes)
    return log_density


def sampled_parameters(posterior: DragPosterior) -> Array:
    """Returns N samples (N, 10) of the posterior of the scaled parameters."""
    return normal_draws(posterior.mean, posterior.covariance, WIND_DRAWS, seed=1)


def sampled_winds(grid: MotionGrid, scaled_parameters: Array) -> SmoothedStates:
    """Returns smoothed states (T, N, 4) of the wind for N samples of the parameters, with their covariances."""
    return filter_motion(filter_parameters(scaled_parameters, grid), grid).smooth()


def independent_fraction(errors: Array) -> float:
    """Returns the ratio of effective to actual sample size of autocorrelated errors.

    Autocorrelated errors contain less information than independent ones. They are modelled as first-order
    autoregressions, for which the ratio is (1 − ρ) / (1 + ρ) with the lag-one autocorrelation ρ.

    Args:
        errors: (T, k) k series of errors, in any unit; NaN where one is missing. One ρ is estimated for all series.

    Returns:
        The ratio, above 0 and at most 1, since a negative autocorrelation is replaced by 0.
    """
    centred_errors = np.nan_to_num(errors - np.nanmean(errors, axis=0))
    power = max((centred_errors**2).sum(), MIN_POWER)
    autocorrelation = (centred_errors[1:] * centred_errors[:-1]).sum() / power
    correlation = min(max(autocorrelation, 0.0), MAX_AUTOCORRELATION)
    return (1 - correlation) / (1 + correlation)


def estimate_drag(
    time: Array,
    attitude: Array,
    velocity: Array,
    wind: Array,
) -> Drag:
    """Estimates the vehicle's drag and lean in a known wind.

    The measured specific force is fitted by nonlinear least squares with the population's prior. The errors are
    autocorrelated, so each has a weight below 1. The weight depends on the errors, and these depend on the fit, so both
    are computed alternately.

    Args:
        time: stamps (T,), s, ascending, as for :func:`mavdem.estimate_wind`.
        attitude: roll, pitch and yaw (T, 3), rad.
        velocity: velocity over ground, north, east and down (T, 3), m/s.
        wind: velocity of the air, north and east (2,) or (T, 2), m/s; a wind that varies is averaged over 3 s.

    Returns:
        The drag, as a prior for other flights.

    Raises:
        ValueError: an array has another shape, or the time does not ascend.
        NotLearnable: the flight is too short or not free, as for :func:`mavdem.estimate_wind`.
    """
    # Importing scipy.optimize takes half a second.
    from scipy.optimize import least_squares

    wind_array = as_real_array(wind, "wind")
    if wind_array.shape not in ((2,), (len(time), 2)):
        raise ValueError(f"wind must have shape (2,) or ({len(time)}, 2), not {wind_array.shape}")
    wind_of_samples = np.broadcast_to(wind_array, (len(time), 2))
    # Samples without a known wind are left out, like those without a velocity.
    is_wind_known = np.isfinite(wind_of_samples).all(axis=1, keepdims=True)
    known_velocity = np.where(is_wind_known, as_real_array(velocity, "velocity"), np.nan)
    samples = validated_motion(time, attitude, known_velocity)
    used_wind = wind_of_samples[samples.usable]
    varies = np.ptp(used_wind, axis=0).max() > VARYING_WIND
    grid = flight_grid(samples, GUST_SECONDS if varies else GRID_STEP, wind=used_wind)
    grid = grid.select(grid.complete)
    prior = Drag.from_parameters()
    air_velocity = grid.along_body_axes(grid.velocity)
    speed = np.hypot(*air_velocity.T)[:, None]
    prior_whitening = np.linalg.inv(np.linalg.cholesky(prior.covariance))

    def force_errors(logarithms: Array) -> Array:
        """Returns measured minus predicted force (T, 2), m/s², where the prediction is lean − (c + q |u|) u."""
        drag = axis_drag(logarithms)
        coefficient = drag.linear + drag.quadratic * speed
        return grid.force + coefficient * air_velocity - logarithms[LEAN]

    def residuals(logarithms: Array, weight: float) -> Array:
        """Returns the weighted errors of the force, then the whitened deviations from the prior."""
        deviation = prior_whitening @ (logarithms - prior.mean)
        return np.append(weight**0.5 * force_errors(logarithms), deviation)

    mean = prior.mean
    for _ in range(WEIGHTING_ITERATIONS):
        errors = force_errors(mean)
        weight = independent_fraction(errors) / max(errors.var(), MIN_VARIANCE)
        solution = least_squares(residuals, mean, args=(weight,))
        mean = solution.x
    # The residuals are whitened, so the inverse of JᵀJ is the posterior covariance.
    jacobian = np.asarray(solution.jac)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    return Drag(mean, covariance, DragSource.CALIBRATION).for_next_flight()
