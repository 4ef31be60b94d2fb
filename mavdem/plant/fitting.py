"""Maximum a posteriori fit of the gray-box model to all windows of a flight, by Fisher scoring."""

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.linalg import LinAlgError

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.gauss_newton import (
    FINITE_DIFFERENCE_STEP,
    MAX_STEPS,
    Damping,
    QuadraticExpansion,
    gauss_newton,
)
from mavdem.facts.model import Refinement
from mavdem.plant.likelihood import GrayBoxModel
from mavdem.plant.sampled_plant import FIRST_ORDER, GAUSSIAN_KERNEL
from mavdem.plant.windows import FlightWindows

WIND_SPECTRA = (
    (FIRST_ORDER,),
    (FIRST_ORDER, GAUSSIAN_KERNEL),
    (GAUSSIAN_KERNEL, GAUSSIAN_KERNEL),
)
"""Spectra of the wind torque to choose from, slow component first.

They are turbulence, turbulence with smooth gusts, and two kinds of smooth gusts.
"""

START_WIND_FACTORS = (1.0, 7.0, 50.0, 400.0)
"""Factors on the prior mean size of the wind torque, from which a fit may start: up to 200 rad/s².

A choice. If the model explains little of a rate, the wind torque explains the rest, and is that large.
"""

START_LAG_FACTORS = (1.0, 0.1)
"""Factors on the prior mean of the motor lag, from which a fit may start: 0.03 and 0.003 s. A choice."""

MAX_LOG_STEP = 0.7
"""Largest change of any logarithm in one step of the fit, about a factor of 2: a choice."""

KNOWN_MIXER_SD = 0.05
"""Prior standard deviation of a motor's effect from the mixer's direction, relative to the mean effect.

It is for a mixer that is known or recognised: a choice, as motors and propellers of one type differ.
"""

UNKNOWN_MIXER_SD = 1.0
"""Prior standard deviation of a motor's effect if the mixer is neither known nor recognised."""

MIN_RELATIVE_NOISE = 0.01
"""Least white noise of the rate, relative to its standard deviation.

Below it, rounding steps of the telemetry would be modelled and not the vehicle.
"""

MIN_PARAMETER_SCALE = 0.01
"""Least magnitude of a parameter for the size of its finite difference: a choice."""

RELATIVE_RIDGE = 1e-9
"""Ridge of the first regression, relative to the mean diagonal of its Gram matrix: it only keeps it invertible."""

MIN_INITIAL_EFFECT = 1e-6
"""Least effect to begin with, rad/s² per unit of the inputs, so that its logarithm is finite."""

INITIAL_DAMPING = 1e-2
"""Levenberg-Marquardt damping of the first step, relative to the curvature's diagonal: a choice."""

DAMPING_FACTOR = 6.0
"""Factor by which the damping changes after a step that fails or succeeds: a choice."""

MAX_DAMPING_ATTEMPTS = 12
"""Times that a step is damped more before the fit ends: a choice."""

MAX_CHUNK = 24
"""Number of windows whose prediction errors are in memory together."""


class GrayBoxFit(NamedTuple):
    """Log posterior of the gray-box model, expanded to second order about its maximum."""

    model: GrayBoxModel
    """The model, which says what the entries of θ are."""

    theta: Array
    """Most probable parameters (k,)."""

    value: float
    """Value of the log posterior there, in nats, up to a constant."""

    curvature: Array
    """Negative second derivative of the log posterior (k, k): information of the likelihood and of the prior."""

    levels: Array
    """Standard deviation of each window's prediction errors (W,), relative to what θ predicts."""

    @property
    def refinements(self) -> dict[Refinement, float]:
        """Estimated parameter of each refinement that the model has, by the name of the refinement."""
        values = self.model.refinement_values(self.theta).tolist()
        return dict(zip(self.model.refinements, values, strict=True))

    @property
    def evidence(self) -> float:
        """Log evidence of the model by Laplace's approximation, up to a constant that all wind spectra share."""
        _, prior_sd = self.model.prior
        return self.value - 0.5 * np.linalg.slogdet(self.curvature)[1] - np.log(prior_sd).sum()


class LogPosterior(NamedTuple):
    """Log posterior density of the gray-box model's parameters; an ``Objective`` for Fisher scoring.

    The level of each window's prediction errors is maximised over, so that a window of N errors contributes
    −N/2 · ln(mean square) to the log likelihood. A point outside the bounds of the model, such as one with a delay
    below 0, is first moved to them.
    """

    model: GrayBoxModel
    """The model."""

    windows: FlightWindows
    """The data."""

    def value(self, theta: Array) -> float:
        """Returns the log posterior density of θ (k,), nats, up to a constant; NaN where it does not exist."""
        theta = np.clip(theta, *self.model.bounds)
        value = self._log_prior(theta)
        for errors, _ in self.innovations(theta[None]):
            value += _log_likelihood(errors[0])
        return value

    def expand(self, theta: Array) -> QuadraticExpansion:
        """Expands the log posterior about θ (k,), for the next step of the search.

        It is the result of :meth:`full_expansion`, except at bounds. If the delay is 0 and the density would increase
        towards negative delays, the delay is kept fixed by removing it from gradient and curvature (active-set method:
        Nocedal and Wright, Numerical Optimization, 2nd ed., sec. 16.5), and so is any other parameter at its bound.
        Otherwise the other parameters would change in each step as if the delay became negative.

        Args:
            theta: parameters θ (k,).

        Returns:
            The expansion: value, gradient (k,) and curvature (k, k).
        """
        expansion = self.full_expansion(theta)
        lower, upper = self.model.bounds
        is_fixed = (expansion.point <= lower) & (expansion.gradient < 0)
        is_fixed |= (expansion.point >= upper) & (expansion.gradient > 0)
        if not is_fixed.any():
            return expansion
        gradient = np.where(is_fixed, 0.0, expansion.gradient)
        is_removed = is_fixed[:, None] | is_fixed
        curvature = np.where(is_removed, 0.0, expansion.curvature)
        np.fill_diagonal(curvature, expansion.curvature.diagonal())
        return expansion._replace(gradient=gradient, curvature=curvature)

    def full_expansion(self, theta: Array) -> QuadraticExpansion:
        """Returns the log posterior about θ (k,) to second order, with the Fisher information as curvature.

        Prediction errors are differentiated by forward differences in all parameters, evaluated in one batch. At a
        delay of 0 its derivative is therefore one-sided. With errors e, scaled to a mean square of 1 in each window,
        and their derivatives J by the parameters, the likelihood adds −Jᵀ e to the gradient and Jᵀ J to the curvature.
        The prior adds its gradient and its precision.

        Args:
            theta: parameters θ (k,), which are moved into the bounds of the model.

        Returns:
            The expansion: value, gradient (k,) and curvature (k, k).

        Raises:
            numpy.linalg.LinAlgError: the log posterior or its curvature is not finite.
        """
        theta = np.clip(theta, *self.model.bounds)
        mean, sd = self.model.prior
        steps = FINITE_DIFFERENCE_STEP * np.maximum(MIN_PARAMETER_SCALE, abs(theta))
        value = self._log_prior(theta)
        gradient = (mean - theta) / sd**2
        curvature = np.diag(sd**-2.0)
        for chunk in self._chunks():
            errors = self.model.innovations_after_steps(theta, steps, chunk)
            # The first row has the errors at the point itself, each other row those with one parameter changed. To save
            # memory the array is overwritten: by errors that are scaled to a mean square of 1 in each window, and then
            # by their derivatives.
            value += _log_likelihood(errors[0])
            errors /= np.sqrt(np.mean(errors[0] ** 2, axis=1))[:, None]
            errors[1:] -= errors[0]
            derivatives = errors[1:].reshape(len(theta), -1)
            derivatives /= steps[:, None]
            gradient -= derivatives @ errors[0].ravel()
            curvature += derivatives @ derivatives.T
        if not (np.isfinite(value) and np.isfinite(curvature).all()):
            raise LinAlgError("the log posterior or its curvature is not finite")
        return QuadraticExpansion(theta, value, gradient, curvature)

    def limited_step(self, step: Array) -> Array:
        """Shortens a step (k,) so that no logarithm changes by more than ``MAX_LOG_STEP``, and keeps its direction."""
        largest = abs(step[self.model.logarithm_indices]).max()
        return step * min(1.0, MAX_LOG_STEP / largest)

    def innovations(self, thetas: Array) -> Iterator[ArrayPair]:
        """Yields the prediction errors of the windows, a chunk of windows at a time to save memory.

        Args:
            thetas: b parameter vectors (b, k).

        Yields:
            Errors (b, chunk, N′), rad/s, and the variances (b,) that the model gives them.
        """
        with np.errstate(all="ignore"):
            for chunk in self._chunks():
                yield self.model.innovations(thetas, chunk)

    def _chunks(self) -> Iterator[FlightWindows]:
        """Yields the windows in chunks of at most ``MAX_CHUNK``, so that the errors of only one chunk are in memory."""
        for start in range(0, len(self.windows.rate), MAX_CHUNK):
            yield self.windows.select(slice(start, start + MAX_CHUNK))

    def _log_prior(self, theta: Array) -> float:
        """Returns the logarithm of the normal prior density of θ (k,), up to a constant."""
        mean, sd = self.model.prior
        return -0.5 * np.sum(((theta - mean) / sd) ** 2)


def _log_likelihood(errors: Array) -> float:
    """Returns the log likelihood of prediction errors (W, N) of W windows, each with the level that maximises it."""
    return -0.5 * errors.shape[1] * np.log(np.mean(errors**2, axis=1)).sum()


def fit_gray_box(
    model: GrayBoxModel, windows: FlightWindows, start: Array, min_gain: float = 0.0
) -> GrayBoxFit:
    """Fits the gray-box model to windows of a flight by damped Fisher scoring.

    As no flight follows the model exactly, the Fisher information is not the curvature of the likelihood. It is
    corrected by the observed changes of the gradient, which saves a third of the evaluations
    (docs/evidence/parameters.md).

    The result is the maximum of the posterior within the bounds of the model, and its curvature there. At a delay of 0
    the curvature is that towards longer delays. Finally the level of each window is estimated: the ratio of its RMS
    error to the one that the model expects.

    Args:
        model: the gray-box model: which refinements and which components of the wind torque it has.
        windows: W windows of a flight, as Fourier transforms.
        start: (k,) parameters θ at which the fit starts.
        min_gain: increase of the log posterior, in nats, that must be predicted at the start. If it is less, the fit
            makes no step, which saves time for a model that would hardly be better.

    Returns:
        Parameters (k,), log posterior, curvature (k, k), and levels (W,).

    Raises:
        numpy.linalg.LinAlgError: the log posterior is not finite at the start.
    """
    objective = LogPosterior(model, windows)
    damping = Damping(
        initial=INITIAL_DAMPING,
        factor=DAMPING_FACTOR,
        max_attempts=MAX_DAMPING_ATTEMPTS,
        limit_step=objective.limited_step,
    )
    expansion_at_start = objective.expand(start)
    is_worth_fitting = expansion_at_start.predicted_gain >= min_gain
    max_steps = MAX_STEPS if is_worth_fitting else 0
    maximisation = gauss_newton(
        objective, expansion_at_start, damping, max_steps, corrects_curvature=True
    )
    final_expansion = maximisation.expansions[-1]
    lower_bounds, upper_bounds = model.bounds
    is_at_bound = (final_expansion.point <= lower_bounds) | (final_expansion.point >= upper_bounds)
    if is_at_bound.any():
        # The steps leave out parameters at their bounds, but the curvature of all is needed.
        final_expansion = objective.full_expansion(final_expansion.point)
    levels = []
    for errors, expected_variance in objective.innovations(final_expansion.point[None]):
        mean_squares = np.mean(errors[0] ** 2, axis=1)
        levels.append(np.sqrt(mean_squares / expected_variance))
    return GrayBoxFit(
        model,
        final_expansion.point,
        final_expansion.value,
        final_expansion.curvature,
        np.concatenate(levels),
    )


def best_start(model: GrayBoxModel, start: Array, windows: FlightWindows) -> Array:
    """Returns the most probable one of several points from which a first fit may start, to save steps.

    The points differ in the size of the wind torque and in the motor lag, by ``START_WIND_FACTORS`` and
    ``START_LAG_FACTORS``.

    Args:
        model: the gray-box model: which refinements and which components of the wind torque it has.
        start: parameters θ (k,), with the prior means of wind torque and lag.
        windows: Fourier transforms of inputs and body rate in windows of the flight.

    Returns:
        θ (k,); ``start`` if no point has a finite posterior.
    """
    objective = LogPosterior(model, windows)
    starting_points = []
    log_posteriors = []
    for wind_factor, lag_factor in product(START_WIND_FACTORS, START_LAG_FACTORS):
        point = start.copy()
        point[model.wind_index] += np.log(wind_factor)
        point[model.lag_index] += np.log(lag_factor)
        starting_points.append(point)
        log_posteriors.append(objective.value(point))
    # A point whose posterior is not a number must not be chosen.
    comparable_log_posteriors = np.nan_to_num(log_posteriors, nan=-np.inf)
    return starting_points[int(np.argmax(comparable_log_posteriors))]


def initial_model(
    windows: FlightWindows, effect_directions: Array | None
) -> tuple[GrayBoxModel, Array]:
    """Returns the gray-box model with the motors' directions, and the parameters at which its fit begins.

    The effect of a motor is the angular acceleration per unit of its input. Its direction is its effect divided by the
    mean magnitude of all effects. The effects are estimated by linear regression of the prediction errors at the prior
    mean. If the mixer is not known, the directions follow from these effects. If it is known, its directions are used,
    and only the size of the effect along them is estimated.

    Args:
        windows: the data, with r inputs.
        effect_directions: relative effect of each input by the mixer (r,), or ``None``.

    Returns:
        The model with the first of ``WIND_SPECTRA``, and its prior mean θ (k,) with the estimated effect.
    """
    r = windows.inputs.shape[1]
    # By Parseval's theorem the root of this power, divided by the number of samples, is the size of the rate in a
    # window; the factor 2 is for negative frequencies. The measurement noise is at least a small fraction of that size.
    power = 2 * np.sum(abs(windows.rate) ** 2, axis=1).mean()
    min_noise = MIN_RELATIVE_NOISE * np.sqrt(power) / windows.samples
    model = GrayBoxModel(np.ones(r), UNKNOWN_MIXER_SD, WIND_SPECTRA[0], min_noise)

    # The errors are linear in the effects, so their slopes are differences. The first point has all effects at 0 (each
    # deviation is −1 from the direction 1), and each other point has one effect at 1 (its deviation is 0).
    mean, _ = model.prior
    points = np.repeat(mean[None], r + 1, axis=0)
    points[:, 0] = 0.0
    points[:, 1 : r + 1] = -1.0 + np.eye(r + 1, r, k=-1)
    errors, _ = model.innovations(points, windows)
    target = errors[0].ravel()
    slopes = (errors[0] - errors[1:]).reshape(r, -1).T
    gram = slopes.T @ slopes
    ridge = RELATIVE_RIDGE * np.trace(gram) / r
    effect = np.linalg.solve(gram + ridge * np.eye(r), slopes.T @ target)

    if effect_directions is None:
        directions = effect
        deviation_sd = UNKNOWN_MIXER_SD
    else:
        directions = effect_directions
        deviation_sd = KNOWN_MIXER_SD
    directions = directions / abs(directions).mean()
    # The least-squares size of the effect along the directions, with the same ridge.
    projected_effect = (directions @ gram @ effect) / (directions @ gram @ directions + ridge)
    # The autopilot's parameters may define rotations with the opposite sign.
    if projected_effect < 0:
        directions = -directions
    model = model._replace(directions=directions, deviation_sd=deviation_sd)
    start, _ = model.prior
    start[0] = np.log(max(abs(projected_effect), MIN_INITIAL_EFFECT))
    return model, start
