"""DEM learns the smoothness s of the noises: the free energy F̄ is maximised over s; and the uncertainty of s.

A. Anil Meera and M. Wisse, "Free Energy Principle for the Noise Smoothness Estimation of Linear Systems with Colored
Noise", 2022 (arXiv:2204.01796).

F̄ depends on s by the temporal precisions S(s) alone, which scale the k-th derivative of a noise by sᵏ. So ln|S| has
the derivative p (p + 1) by ln s, and S itself K S + S K with K = diag(0, 1, …, p). At the maximum of F̄ over states, θ
and λ these are the only terms of its gradient by ln s (the envelope theorem).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.dem.engine.ascent import Iterate, initial_iterate, run_rounds
from mavdem.dem.engine.free_energy import Posterior, expected_noise_precisions
from mavdem.dem.engine.generalized_coordinates import temporal_precision
from mavdem.dem.engine.generative import GenerativeModel
from mavdem.dem.engine.moments import GeneralizedMoments, SufficientStatistics
from mavdem.dem.engine.steps import FreeEnergyOfLambda

MAX_ROUNDS = 100
"""Largest number of rounds of D, E and M steps for one value of s."""

LOG_TOLERANCE = 0.01
"""Error of ln s at which the search ends: one percent of s, well below its standard deviation."""

DIFFERENCE_STEP = 1e-3
"""Change of ln s by which the second derivative of F̄ is computed."""

BLOCK_WIDTHS = 10.0
"""Length of a block of samples, in kernel widths: noise has the autocorrelation e⁻²⁵ over it."""


FitAt = Callable[[float], Iterate]
"""A function of the smoothness s that returns the maximum of F̄ over the states, and over θ and λ if unknown."""


class LearnedSmoothness(NamedTuple):
    """The smoothness at the maximum of F̄."""

    smoothness: float
    """Kernel width s of both noises, in the model's unit of time."""

    fit: Iterate
    """The fit at this s."""

    is_inside: bool
    """Whether the maximum lies between the candidates, and not at the smallest or largest of them."""


class SmoothnessUncertainty(NamedTuple):
    """Standard deviations of ln s, by two approximations."""

    laplace: float
    """From the curvature of F̄, which counts every sample as independent."""

    sandwich: float
    """From the curvature and the variance of the gradient between blocks, which counts overlapping samples as such."""

    blocks: int
    """Number of blocks: one less is the number of degrees of freedom of the sandwich."""


def with_smoothness(model: GenerativeModel, smoothness: float) -> GenerativeModel:
    """Returns a generative model whose output noise and state noise both have another smoothness.

    Args:
        model: model whose other values are kept.
        smoothness: width s of the Gaussian kernel of both noises, in the model's unit of time.
    """
    return replace(
        model,
        output_temporal_precision=temporal_precision(model.p, smoothness),
        state_temporal_precision=temporal_precision(model.q, smoothness),
    )


def fit_states(model: GenerativeModel, statistics: SufficientStatistics, s: float) -> Iterate:
    """Maximises F̄ over the states alone for one smoothness s; θ and λ are known, and are the prior means."""
    return initial_iterate(with_smoothness(model, s), statistics)


def fit_all(model: GenerativeModel, statistics: SufficientStatistics, s: float) -> Iterate:
    """Fits a model by DEM for one smoothness of the noises: maximises the free energy F̄ over states, θ and λ.

    Args:
        model: the generative model; its smoothness is replaced.
        statistics: sufficient statistics of the data.
        s: smoothness of both noises, in the model's unit of time.

    Returns:
        The last iterate, with the posterior of the parameters θ and of the noise precisions λ.
    """
    start = initial_iterate(with_smoothness(model, s), statistics)
    iterates, _ = run_rounds(start, MAX_ROUNDS)
    return iterates[-1]


def smoothness_gradient(posterior: Posterior) -> float:
    """Returns ∂F̄/∂ln s at a posterior of states, θ and λ.

    The free energy F̄ depends on the smoothness s only by the temporal precisions S(s) of the noises, in the terms
    ½ N ln|S ⊗ Π| − ½ Σ_g exp(λ_g) c_g(S), where N is the number of samples, Π the precision of the noises, and λ_g the
    log precision of noise g. The sums c_g of expected squared errors, mean-field terms included, are linear in S, so
    their derivatives are the same sums with ∂S/∂ln s in the place of S.

    Args:
        posterior: the posterior; if it maximises F̄ for its s, this is also the derivative of the maximum by ln s.

    Returns:
        The derivative, nats.
    """
    model = posterior.model
    # S ∝ s^(i+j) in row i and column j, so that ln|S| has the derivative 2 (0 + 1 + … + p) = p (p + 1) by ln s. It
    # counts once for each of the m outputs, whose noise has p derivatives, and n states, whose noise has q.
    output_log_det_gradient = model.m * model.p * (model.p + 1)
    state_log_det_gradient = model.n * model.q * (model.q + 1)
    log_det_gradient = output_log_det_gradient + state_log_det_gradient
    # ``from_posterior`` computes the sums c_g from the moments of a posterior. With moments of a model that has
    # ∂S/∂ln s in the place of S, its field ``c`` has the derivatives of the sums. All else in the posterior stays.
    derivative_model = _derivative_by_log_smoothness(model)
    derivative_moments = GeneralizedMoments(
        derivative_model, posterior.samples, posterior.moments.joint_map
    )
    derivative_posterior = posterior._replace(moments=derivative_moments)
    error_gradients = FreeEnergyOfLambda.from_posterior(derivative_posterior).c
    noise_precisions = np.exp(posterior.lambda_)
    return float(
        0.5 * posterior.samples.sample_count * log_det_gradient
        - 0.5 * error_gradients @ noise_precisions
    )


def _derivative_by_log_smoothness(model: GenerativeModel) -> GenerativeModel:
    """Returns the model in which the derivative ∂S/∂ln s replaces the temporal precision S of both noises.

    The precision of the inputs does not depend on s, so it is 0 here.

    Args:
        model: the model with the precisions S.

    Returns:
        The model with the derivatives.
    """
    derivatives = []
    for S in (model.output_temporal_precision, model.state_temporal_precision):
        # The entry of derivatives i and j is proportional to s^(i+j): its derivative by ln s is i + j times itself.
        orders = np.arange(len(S))
        derivatives.append(S * (orders + orders[:, None]))
    return replace(
        model,
        output_temporal_precision=derivatives[0],
        state_temporal_precision=derivatives[1],
        input_precision=np.zeros_like(model.input_precision),
    )


def learn_smoothness(fit_at: FitAt, candidates: Sequence[float]) -> LearnedSmoothness:
    """Maximises F̄ over s: on a grid first, since F̄ may have several maxima, then by the gradient about the best.

    Args:
        fit_at: the fit for one value of s.
        candidates: the grid, increasing, in the model's unit of time.

    Returns:
        The smoothness of highest F̄, within ``LOG_TOLERANCE`` of ln s. If F̄ is highest at an end of the grid, it is
        that end, and ``is_inside`` is false.
    """
    fits = [fit_at(candidate) for candidate in candidates]
    best_index = int(np.argmax([fit.free_energy for fit in fits]))
    if best_index in (0, len(candidates) - 1):
        return LearnedSmoothness(candidates[best_index], fits[best_index], is_inside=False)
    lower_bound, upper_bound = np.log([candidates[best_index - 1], candidates[best_index + 1]])
    # Bisection: the gradient is positive below the maximum and negative above it.
    while upper_bound - lower_bound > LOG_TOLERANCE:
        middle = (lower_bound + upper_bound) / 2
        if smoothness_gradient(fit_at(float(np.exp(middle))).posterior) > 0:
            lower_bound = middle
        else:
            upper_bound = middle
    smoothness = float(np.exp((lower_bound + upper_bound) / 2))
    return LearnedSmoothness(smoothness, fit_at(smoothness), is_inside=True)


def smoothness_uncertainty(
    learned: LearnedSmoothness, fit_at: FitAt, data: Array, dt: float
) -> SmoothnessUncertainty:
    """Estimates the uncertainty of ln s, for known θ and λ.

    F̄ sums the free energies of generalized samples whose windows overlap and whose noise is correlated. It is a
    composite likelihood, whose curvature alone is no measure of uncertainty. The sandwich J / H² is one, with the
    curvature H and the variance J of the gradient (C. Varin, N. Reid and D. Firth, "An overview of composite likelihood
    methods", Statistica Sinica 21, 2011). J is estimated from sums over blocks that are longer than the correlation.

    Args:
        learned: the smoothness at the maximum of F̄.
        fit_at: function that fits the model for one value of s.
        data: (T, dim [ỹ; η̃]) generalized data.
        dt: sampling step, in the unit of the smoothness.

    Returns:
        Standard deviations of ln s by the curvature (Laplace) and by the sandwich, and the number of blocks.
    """
    s = learned.smoothness
    gradient_below = smoothness_gradient(fit_at(s * np.exp(-DIFFERENCE_STEP)).posterior)
    gradient_above = smoothness_gradient(fit_at(s * np.exp(DIFFERENCE_STEP)).posterior)
    curvature = (gradient_below - gradient_above) / (2 * DIFFERENCE_STEP)
    # The noise is correlated over BLOCK_WIDTHS smoothnesses, and the embedding windows of p + 1 samples overlap.
    block_samples = int(np.ceil(BLOCK_WIDTHS * s / dt)) + learned.fit.posterior.model.p
    blocks = max(2, len(data) // block_samples)
    gradients = _sample_gradients(learned.fit.posterior, data)
    block_sums = [block.sum() for block in np.array_split(gradients, blocks)]
    # The gradient is the sum over all blocks, which are nearly independent.
    gradient_variance = blocks * np.var(block_sums, ddof=1)
    return SmoothnessUncertainty(
        laplace=float(1 / np.sqrt(curvature)),
        sandwich=float(np.sqrt(gradient_variance) / curvature),
        blocks=blocks,
    )


def _sample_gradients(posterior: Posterior, data: Array) -> Array:
    """Returns the derivative of each sample's free energy by ln s, up to a constant that is the same for all samples.

    The free energy of a sample contains −½ ε̃ᵀ Π̃(s) ε̃ with its prediction errors ε̃, of which only the precision Π̃
    depends on s. The constant does not matter, since only the variance of the derivatives is used.

    Args:
        posterior: the posterior.
        data: (T, dim [ỹ; η̃]) generalized data.

    Returns:
        The derivatives (T,), nats.
    """
    # In this model the derivative ∂Π̃/∂ln s takes the place of Π̃.
    derivative_model = _derivative_by_log_smoothness(posterior.model)
    # The states are linear in the data, and the errors in both: error_map maps the data to the errors.
    error_map = derivative_model.error_operator(posterior.theta) @ posterior.moments.joint_map
    errors = data @ error_map.T
    precisions = expected_noise_precisions(posterior.lambda_, posterior.lambda_covariance)
    precision_slope = derivative_model.error_precision(precisions)
    # The quadratic form ε̃ᵀ (∂Π̃/∂ln s) ε̃ of each sample.
    squares = np.sum(errors @ precision_slope * errors, axis=1)
    return np.asarray(-0.5 * squares, float)
