"""Maximum likelihood: PEM minimises one-step prediction errors, EM makes the training data the most probable."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.linalg import LinAlgError

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.gauss_newton import (
    CONVERGED_STEP_NATS,
    Damping,
    QuadraticExpansion,
    gauss_newton,
)
from mavdem.dem.engine.kalman import LinearGaussianModel, SmoothedStates, smooth_states
from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.record import Segments, TrainingData
from mavdem.errors import NotLearnable
from mavdem.experiments.methods.identified import Identified, NormalizedFit, identified
from mavdem.experiments.methods.scaling import DEPENDENCE_TOLERANCE
from mavdem.experiments.methods.subspace_identification import (
    RANK_TOLERANCE,
    innovation_gain,
    subspace_fit,
)
from mavdem.facts.forecasts import ForecastFact

DAMPING = Damping(initial=1e-3, factor=8.0, max_attempts=8)
"""Levenberg-Marquardt damping of PEM's Gauss-Newton steps."""

MAX_ITERATIONS = 300
"""Iterations of PEM and of EM, at most: in a flat valley of the likelihood many small steps follow each other."""

EM_CONVERGED_NATS = 0.1
"""Gain of the log likelihood below which EM has converged; a further parameter gains 0.5 by chance."""

INITIAL_PROCESS_VARIANCE = 0.1
"""Variance that is added to each state's noise at the start of EM, in normalized units: EM converges slowly from a
motion that is assumed to be exact."""


def pem(train: TrainingData, order: int = 2) -> Identified:
    """Fits a state-space model by the prediction error method (PEM): it minimises the one-step errors' covariance.

    The determinant of the covariance is minimised, which is maximum likelihood if the errors are Gaussian (Ljung,
    System Identification, 2nd ed., secs. 7.2, 10.2). All of A, B, C, K, the offset and the first states of the segments
    are free, in full parametrization. The fit takes Gauss-Newton steps on errors weighted by their covariance, from the
    subspace model on, and the determinant never rises. It stays where the predictor A − K C is stable. The result is
    consistent in closed loop, if the order is right.

    Args:
        train: a flight, or segments of one that are sampled at the same rate.
        order: number of states.

    Returns:
        The model in innovation form.

    Raises:
        ValueError: the training data or the order are not valid, as in :func:`mavdem.baselines.subspace`.
    """
    return identified("PEM", train, order, pem_fit)


def pem_fit(segments: Segments, order: int) -> NormalizedFit:
    """Runs PEM (prediction error method) on segments in normalized units.

    Args:
        segments: inputs (T, k) and outputs (T, m) of each segment.
        order: number of states n.

    Returns:
        The model with the first states of the segments, and the number of iterations if it has not converged.
    """
    start = subspace_fit(segments, order)
    likelihood = PredictionErrorLikelihood(start.model, start.starts, segments)
    expansion = likelihood.expand(likelihood.parameters)
    maximisation = gauss_newton(likelihood, expansion, DAMPING, MAX_ITERATIONS)
    best_likelihood = likelihood.with_parameters(maximisation.expansions[-1].point)
    iterations = None
    if maximisation.last_gain > CONVERGED_STEP_NATS:
        # It has not converged. The first expansion is about the start, which is no iteration.
        iterations = len(maximisation.expansions) - 1
    return NormalizedFit(best_likelihood.model, best_likelihood.starts, iterations)


class PredictionErrorLikelihood(NamedTuple):
    """The Gaussian log likelihood of one-step prediction errors, as a function of one parameter vector (f,).

    The vector has A, B, C, K, the offset and the first states of the segments, one after the other, each row by row.
    """

    model: StateSpace
    """Model whose parameters are varied; its trims are not."""
    starts: Array
    """(segments, n) states at the first sample of each segment, which are varied too."""
    segments: Segments
    """Inputs (T, k) and outputs (T, m) of each segment, in normalized units."""

    @property
    def _parameter_arrays(self) -> tuple[Array, ...]:
        """The arrays that the parameter vector consists of."""
        model = self.model
        return model.A, model.B, model.C, model.K, model.offset, self.starts

    @property
    def parameters(self) -> Array:
        """The parameter vector (f,) of the model and the first states."""
        return np.concatenate([array.ravel() for array in self._parameter_arrays])

    def with_parameters(self, parameters: Array) -> PredictionErrorLikelihood:
        """Returns the same likelihood with the model and the first states of a parameter vector.

        It is the inverse of :attr:`parameters`, which joins all matrices and vectors to one: the parameter vector is
        cut into pieces of their sizes, which get their shapes back.

        Args:
            parameters: (f,) parameter vector.

        Returns:
            A copy of the likelihood with these values.
        """
        arrays = []
        start = 0
        for template in self._parameter_arrays:
            end = start + template.size
            arrays.append(parameters[start:end].reshape(template.shape))
            start = end
        A, B, C, K, offset, first_states = arrays
        model = replace(self.model, A=A, B=B, C=C, K=K, offset=offset)
        return self._replace(model=model, starts=first_states)

    def errors(self, parameters: Array) -> Array:
        """Returns the one-step prediction errors of all samples.

        Args:
            parameters: parameter vector (f,).

        Returns:
            Measured minus predicted outputs (T, m) in normalized units, segments one after the other. Each sample is
            predicted from those before it in its segment.
        """
        model, starts, segments = self.with_parameters(parameters)
        predictions = []
        for start, (inputs, outputs) in zip(starts, segments, strict=True):
            predictions.append(model.predicted_outputs(start, inputs, outputs))
        measured_outputs = np.concatenate([outputs for _, outputs in segments])
        return measured_outputs - np.concatenate(predictions)

    def error_derivatives(self, parameters: Array) -> Array:
        """Returns the derivatives of all one-step prediction errors with respect to the parameters.

        The predictor is x⁺ = (A − K C) x + B u + K y + offset, e = y − C x. So the sensitivity S = ∂x/∂θ of the state
        follows S⁺ = (A − K C) S + G, where G has the direct effect of each parameter on the next state, and
        ∂e/∂θ = −C S − (∂C/∂θ) x (Ljung, System Identification, 2nd ed., sec. 10.3).

        Args:
            parameters: parameter vector (f,), in the order of :attr:`parameters`.

        Returns:
            Derivatives (f, T, m) in normalized units, segments one after the other.
        """
        model, starts, segments = self.with_parameters(parameters)
        derivatives = []
        for number, (inputs, outputs) in enumerate(segments):
            states = model.predicted_states(starts[number], inputs, outputs)[:-1]
            first_sensitivity = self._first_state_derivatives(number)
            derivatives.append(
                _segment_derivatives(model, states, inputs, outputs, first_sensitivity)
            )
        return np.concatenate(derivatives).transpose(2, 0, 1)

    def _first_state_derivatives(self, number: int) -> Array:
        """Returns the derivatives (n, f) of the first state of a segment with respect to the parameters.

        The first states of the segments are the last parameters, so that these are zeros and an identity matrix.

        Args:
            number: number of the segment, from 0.
        """
        order = self.starts.shape[1]
        first_column = len(self.parameters) - self.starts.size + order * number
        derivatives = np.zeros((order, len(self.parameters)))
        derivatives[:, first_column : first_column + order] = np.eye(order)
        return derivatives

    def value(self, parameters: Array) -> float:
        """Returns the log likelihood of the training data, up to a constant, for one vector of the parameters.

        Args:
            parameters: (f,) parameters of the model in innovation form, and the first state of each segment.

        Returns:
            The log likelihood, nats; NaN if the predictor A − K C is not stable, since its errors then grow.
        """
        model = self.with_parameters(parameters).model
        predictor = model.A - model.K @ model.C
        if abs(np.linalg.eigvals(predictor)).max() >= 1:
            return np.nan
        return concentrated_log_likelihood(self.errors(parameters))

    def expand(self, parameters: Array) -> QuadraticExpansion:
        """Expands the log likelihood to second order around parameters, for a Gauss-Newton step.

        With errors e and their covariance Σ at these parameters, the log likelihood is −½ Σₜ eₜᵀ Σ⁻¹ eₜ, up to a
        constant. Its gradient is −Jᵀ Σ⁻¹ e and its curvature Jᵀ Σ⁻¹ J, with the derivatives J = ∂e/∂θ
        (:meth:`error_derivatives`).

        Args:
            parameters: (f,) parameter vector, in the order of :attr:`parameters`.

        Returns:
            Value (nats), gradient (f,) and curvature (f, f).
        """
        errors = self.errors(parameters)
        derivatives = self.error_derivatives(parameters)
        precision = np.linalg.inv(error_covariance(errors))
        # Σ⁻¹ = L Lᵀ: derivatives and errors times L have unit weight, so that plain products of them suffice.
        precision_root = np.linalg.cholesky(precision)
        weighted_derivatives = (derivatives @ precision_root).reshape(len(parameters), -1)
        curvature = weighted_derivatives @ weighted_derivatives.T
        # A change of the states' coordinates changes no error, so that the curvature is singular without this.
        curvature_floor = ROUNDING_TOLERANCE * curvature.diagonal().max()
        curvature += curvature_floor * np.eye(len(parameters))
        gradient = -weighted_derivatives @ (errors @ precision_root).ravel()
        value = concentrated_log_likelihood(errors)
        return QuadraticExpansion(parameters, value, gradient, curvature)


def _segment_derivatives(
    model: StateSpace, states: Array, inputs: Array, outputs: Array, first_sensitivity: Array
) -> Array:
    """Returns the derivatives of the one-step prediction errors of one segment with respect to all parameters of PEM.

    Args:
        model: the model in innovation form, n states, k inputs and m outputs, without feedthrough.
        states: (T, n) predicted states.
        inputs: (T, k).
        outputs: (T, m).
        first_sensitivity: (n, f) derivatives of the first state with respect to the parameters.

    Returns:
        Derivatives (T, m, f), in the order of ``PredictionErrorLikelihood.parameters``.
    """
    effects = _effects_on_next_state(model, states, inputs, outputs)
    model_parameter_count = effects.shape[2]
    transition = model.A - model.K @ model.C
    sensitivities = np.empty((len(states), *first_sensitivity.shape))
    sensitivities[0] = first_sensitivity
    for t in range(len(states) - 1):
        sensitivities[t + 1] = transition @ sensitivities[t]
        sensitivities[t + 1, :, :model_parameter_count] += effects[t]
    derivatives = -model.C @ sensitivities
    # A change of C also changes the predicted output of the same state.
    first_of_C = model.A.size + model.B.size
    derivatives[:, :, first_of_C : first_of_C + model.C.size] -= _effects_of_entries(
        np.eye(len(model.C)), states
    )
    return derivatives


def _effects_on_next_state(
    model: StateSpace, states: Array, inputs: Array, outputs: Array
) -> Array:
    """Returns what each parameter of a model adds to the next predicted state, when it grows by 1.

    Entry (i, j) of A, B and K adds signal j to state i. One of C adds its change of the predicted output, times −K.

    Args:
        model: the model in innovation form, n states, k inputs and m outputs, without feedthrough.
        states: (T, n) predicted states.
        inputs: (T, k).
        outputs: (T, m).

    Returns:
        Effects (T, n, p) of the p entries of A, B, C, K and the offset, each row by row.
    """
    innovations = outputs - model.noise_free_outputs(states, inputs)
    identity = np.eye(states.shape[1])
    return np.concatenate(
        [
            _effects_of_entries(identity, states),
            _effects_of_entries(identity, inputs - model.input_trim),
            _effects_of_entries(-model.K, states),
            _effects_of_entries(identity, innovations),
            _effects_of_entries(identity, np.ones((len(states), 1))),
        ],
        axis=2,
    )


def _effects_of_entries(directions: Array, signals: Array) -> Array:
    """Returns what each entry of a matrix adds to its product with signals, when it grows by 1.

    Args:
        directions: (n, p) column i is the effect of row i of the product.
        signals: (T, q) signals that the matrix (p, q) multiplies.

    Returns:
        Effects (T, n, p · q), the entries of the matrix row by row.
    """
    effects = np.einsum("ni,tq->tniq", directions, signals)
    return effects.reshape(len(signals), len(directions), -1)


def concentrated_log_likelihood(errors: Array) -> float:
    """Returns −T/2 ln |covariance| of errors (T, m): the log likelihood at the best covariance, up to a constant."""
    _, log_determinant = np.linalg.slogdet(error_covariance(errors))
    return float(-0.5 * len(errors) * log_determinant)


def error_covariance(errors: Array) -> Array:
    """Returns the covariance (m, m) of errors (T, m), with a floor that keeps it regular for perfect predictions."""
    floor = RANK_TOLERANCE**2 * np.eye(errors.shape[1])
    return errors.T @ errors / len(errors) + floor


def em(train: TrainingData, order: int = 2) -> Identified:
    """Fits a state-space model by expectation maximisation (EM), with independent white noises of states and outputs.

    The E step smooths the states with the present model. The M step computes new parameters from the smoothed states by
    regressions: A, B, offset and noise covariance Q of the states, C, trim and noise covariance R of the outputs, and
    the first states of the segments (Shumway and Stoffer, Journal of Time Series Analysis 3(4), 1982; with inputs Cara,
    Juan and Alarcón, Mechanical Systems and Signal Processing 46(2), 2014). It starts from the subspace model, and the
    likelihood rises with every iteration, to a maximum that need not be the highest. K is the steady-state Kalman gain.
    The result is consistent in closed loop, if order and noises are right.

    Args:
        train: a flight, or segments of one that are sampled at the same rate.
        order: number of states.

    Returns:
        The model in innovation form.

    Raises:
        ValueError: the training data or the order are not valid, as in :func:`mavdem.baselines.subspace`, or EM breaks
            down.
    """
    return identified("EM", train, order, em_fit)


def em_fit(segments: Segments, order: int) -> NormalizedFit:
    """Fits a state-space model by expectation maximisation (EM), in normalized units.

    EM finds the covariances Q and R of state and output noise. All methods here return models in innovation form, with
    one noise and a gain, so the steady-state Kalman gain K for Q and R is computed at the end.

    Args:
        segments: inputs (T, k) and outputs (T, m) of each segment, in normalized units.
        order: number of states.

    Returns:
        The model with the first state of each segment; and the number of iterations, if the likelihood still rose at
        the end.

    Raises:
        NotLearnable: the likelihood becomes infinite, or there is no steady-state filter.
    """
    try:
        fit = iterate_em(segments, order)
        A, B, offset, C, output_trim, Q, R = fit.model
        k = B.shape[1]
        m = len(C)
        K = innovation_gain(A, C, Q, R, S=np.zeros((order, m)))
    except LinAlgError:
        raise NotLearnable(ForecastFact.EM_BROKE_DOWN, order=order) from None
    model = StateSpace(
        A,
        B=B,
        C=C,
        D=np.zeros((m, k)),
        K=K,
        offset=offset,
        input_trim=np.zeros(k),
        output_trim=output_trim,
    )
    has_converged = len(fit.log_likelihoods) < MAX_ITERATIONS
    return NormalizedFit(model, fit.starts, None if has_converged else MAX_ITERATIONS)


class EMFit(NamedTuple):
    """The result of EM's iterations."""

    model: LinearGaussianModel
    """The model of the last iteration."""
    starts: Array
    """(segments, n) means of the state at the first sample of each segment."""
    log_likelihoods: list[float]
    """Log likelihood of the model before each iteration, nats."""


def iterate_em(segments: Segments, order: int, iterations: int = MAX_ITERATIONS) -> EMFit:
    """Runs EM (expectation maximisation) from the subspace model on, until the likelihood hardly rises.

    Each iteration smooths the states of all segments under the present model (E step), and fits a new model to the
    smoothed states (M step). The smoother also gives the log likelihood of the model.

    Args:
        segments: inputs (T, k) and outputs (T, m) of each, in normalized units.
        order: number of states.
        iterations: largest number of iterations.

    Returns:
        The model, the first state of each segment, and the log likelihood, nats, in each iteration.

    Raises:
        numpy.linalg.LinAlgError: the likelihood is not finite.
    """
    fit = subspace_fit(segments, order)
    model = model_with_noise(fit, segments)
    starts = fit.starts
    log_likelihoods: list[float] = []
    for _ in range(iterations):
        smoothed_states = []
        for start, (inputs, outputs) in zip(starts, segments, strict=True):
            smoothed_states.append(smooth_states(model, start, inputs, outputs))
        log_likelihoods.append(sum(states.log_likelihood for states in smoothed_states))
        if not np.isfinite(log_likelihoods[-1]):
            raise LinAlgError("the likelihood is not finite")
        if len(log_likelihoods) > 1:
            gain = log_likelihoods[-1] - log_likelihoods[-2]
            if gain < EM_CONVERGED_NATS:
                break
        model = maximize_expected_likelihood(model, smoothed_states, segments)
        starts = np.array([states.means[0] for states in smoothed_states])
    return EMFit(model, starts, log_likelihoods)


def model_with_noise(fit: NormalizedFit, segments: Segments) -> LinearGaussianModel:
    """Makes the model that EM starts from: the subspace model with independent noises of states and outputs.

    In the subspace model the innovations e, of covariance R, also enter the states, by the gain K: this is a noise of
    the states with the covariance K R Kᵀ. It may be nearly 0, and EM could hardly enlarge it then, so that a small
    variance is added.

    Args:
        fit: model and first states by the subspace method.
        segments: inputs (T, k) and outputs (T, m) of each, in normalized units, that it was fitted to.

    Returns:
        The model.
    """
    model = fit.model
    residuals = []
    for start, (inputs, outputs) in zip(fit.starts, segments, strict=True):
        residuals.append(outputs - model.predicted_outputs(start, inputs, outputs))
    innovations = np.concatenate(residuals)
    R = innovations.T @ innovations / len(innovations)
    Q = model.K @ R @ model.K.T + INITIAL_PROCESS_VARIANCE * np.eye(len(model.A))
    R += ROUNDING_TOLERANCE * np.eye(len(R))
    return LinearGaussianModel(
        model.A, B=model.B, offset=model.offset, C=model.C, trim=model.output_trim, Q=Q, R=R
    )


def maximize_expected_likelihood(
    model: LinearGaussianModel, smoothed_states: list[SmoothedStates], segments: Segments
) -> LinearGaussianModel:
    """Returns the model with the highest expected likelihood of outputs and states together: the M step of EM.

    It regresses the next state x⁺ on [x, u, 1], and the output y on [x, 1]. The states are not known, only their means
    and covariances, so that the regressions use expected products: E xxᵀ = mean · meanᵀ + covariance. The covariances
    are therefore added to the blocks of the products in which a state meets a state (Shumway and Stoffer, 1982).

    Args:
        model: model of the last iteration, for its shapes: n states, k inputs, m outputs.
        smoothed_states: the states of each segment under that model.
        segments: inputs (T, k) and outputs (T, m) of each segment.

    Returns:
        The model of the next iteration.
    """
    n, k = model.B.shape
    m = len(model.C)
    # Products of all columns with all columns, for each segment.
    dynamics_products = []
    observation_products = []
    for (inputs, outputs), states in zip(segments, smoothed_states, strict=True):
        means = states.means
        covariances = states.covariances
        ones = np.ones((len(outputs), 1))
        # Columns: state (n), inputs (k), constant, next state (n).
        transitions = np.hstack([means[:-1], inputs[:-1], ones[:-1], means[1:]])
        products = transitions.T @ transitions
        products[:n, :n] += covariances[:-1].sum(0)
        products[-n:, :n] += states.lag_one_covariances.sum(0)
        products[-n:, -n:] += covariances[1:].sum(0)
        dynamics_products.append(products)
        # Columns: state (n), constant, outputs (m).
        observations = np.hstack([means, ones, outputs])
        products = observations.T @ observations
        products[:n, :n] += covariances.sum(0)
        observation_products.append(products)
    samples = sum(len(outputs) for _, outputs in segments)
    # The last sample of a segment has no successor.
    transition_count = samples - len(segments)
    dynamics, Q = regress_on_products(dynamics_products, n, transition_count)
    observation, R = regress_on_products(observation_products, m, samples)
    return LinearGaussianModel(
        A=dynamics[:, :n],
        B=dynamics[:, n : n + k],
        offset=dynamics[:, -1],
        C=observation[:, :n],
        trim=observation[:, n],
        Q=Q,
        R=R,
    )


def regress_on_products(products: list[Array], target_count: int, samples: int) -> ArrayPair:
    """Regresses targets on regressors, given only the sums of their products.

    EM does not know the states, but the expected sums of their products, from which a regression can be computed.

    Args:
        products: (c + d, c + d) expected sums over the samples of each segment, of the products of c regressors and
            then d targets. The upper right block is not used.
        target_count: d.
        samples: number of samples in all segments.

    Returns:
        Coefficients (d, c), and the covariance (d, d) of the residuals. Its eigenvalues are at least
        ``ROUNDING_TOLERANCE``, which is the most likely such covariance where states and outputs are of size 1.
    """
    total_products = np.sum(products, axis=0)
    regressors = slice(None, -target_count)
    targets = slice(-target_count, None)
    regressor_products = total_products[regressors, regressors]
    cross_products = total_products[targets, regressors]
    target_products = total_products[targets, targets]
    # With regressors x, targets z and coefficients β = (Σ z xᵀ)(Σ x xᵀ)⁺, the residuals z − β x have the squared sum
    # Σ z zᵀ − β Σ x zᵀ − (β Σ x zᵀ)ᵀ + β (Σ x xᵀ) βᵀ.
    pseudoinverse = np.linalg.pinv(
        regressor_products, rcond=DEPENDENCE_TOLERANCE**2, hermitian=True
    )
    coefficients = cross_products @ pseudoinverse
    explained_products = coefficients @ cross_products.T
    squared_predictions = coefficients @ regressor_products @ coefficients.T
    residual_covariance = (
        target_products - explained_products - explained_products.T + squared_predictions
    ) / samples
    # Rounding leaves the difference a little asymmetric, and may make eigenvalues negative.
    symmetric = (residual_covariance + residual_covariance.T) / 2
    variances, axes = np.linalg.eigh(symmetric)
    covariance = axes * np.maximum(variances, ROUNDING_TOLERANCE) @ axes.T
    return coefficients, covariance
