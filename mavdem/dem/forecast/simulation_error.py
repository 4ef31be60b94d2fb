"""The simulation-error (output-error) fit of θ: it minimises the errors of simulations over a short horizon.

Over each of many pieces of the record, the state starts where the Kalman filter has it, and then follows ẋ = A x + B v
without measurements. All that the simulation misses, wind included, counts as measurement noise z. The fit maximises
F̄ with the noise precision at its maximum, which has a closed form, by Gauss-Newton steps. F̄ has many maxima; the fit
starts from θ of the ascent, which leads to the right one (docs/how_it_works.md). A model whose residual is all
measurement noise is called an output-error model (Ljung, System Identification, 2nd ed., sec. 4.2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from mavdem.arrays import Array, Flags, Indices
from mavdem.dem.engine.free_energy import Term
from mavdem.dem.engine.gauss_newton import (
    CONVERGED_STEP_NATS,
    FINITE_DIFFERENCE_STEP,
    Damping,
    QuadraticExpansion,
    gauss_newton,
)
from mavdem.dem.engine.generative import GenerativeModel, ModelSizes
from mavdem.dem.engine.linalg import inverse, logdet, may_overflow
from mavdem.dem.engine.model import discretize, unpack
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.forecast.joint import axis_mixer
from mavdem.dem.priors import KINEMATIC_PRECISION
from mavdem.dem.record import Record, Segments
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import CompleteSettings

FREE_PARAMETER_PRECISION = 1e-5
"""Prior precision of a free parameter, in the engine's units: so weak that it only decides what the data leave open."""

NON_TURNING_PRECISION = 0.1
"""Prior precision, in the engine's units, of the effect of a motor combination that should not turn the vehicle.

Its standard deviation is about 3, since rotors are not exactly equal and loads not exactly centred.
"""

MIN_SAMPLES_PER_PARAMETER = 2.0
"""Smallest effective sample size for each free parameter; a short record has it only over a shorter horizon."""

MIN_HORIZON_SECONDS = 0.05
"""Shortest horizon, s: a shorter simulation shows no more than the derivatives that the ascent has used."""

STARTS_PER_HORIZON = 4
"""Number of pieces that begin within one horizon; pieces overlap. A choice."""

MAX_PIECES = 500
"""Largest number of pieces, spread over the whole record, however long it is: a bound on the cost of the fit."""

DAMPING = Damping(initial=1e-3, factor=8.0, max_attempts=6)
"""Damping of the Gauss-Newton steps. A choice."""


def models_for_parameters(
    thetas: Array,
    sizes: ModelSizes,
    gain: Array,
    dt: float,
) -> StateSpace:
    """Returns the discrete-time state-space models of several parameter vectors, to be simulated together.

    Args:
        thetas: (b, k) b parameter vectors, which differ in A and B only.
        sizes: numbers of states n, inputs r and outputs m.
        gain: (n, m) gain of the filter, the same for all models.
        dt: sampling step, s.

    Returns:
        The models, with a leading axis of length b in all matrices but C, which they share.
    """
    matrices = [unpack(theta, *sizes) for theta in thetas]
    A = np.stack([model.A for model in matrices])
    B = np.stack([model.B for model in matrices])
    transition = discretize(A, B, dt)
    # Models with large eigenvalues overflow; their errors are then infinite.
    with np.errstate(over="ignore", invalid="ignore"):
        return StateSpace.from_transition(transition, matrices[0].C, gain)


@may_overflow
def simulate_models(models: StateSpace, inputs: Array, outputs: Array) -> Array:
    """Simulates several models over several pieces of a record.

    A simulation must start from the state of the vehicle, which is not measured. So a Kalman filter estimates it from
    the first h + 1 samples of a piece, and the model is simulated over the H samples after them, with the inputs alone.
    An unstable model may overflow; its outputs are then infinite or NaN.

    Args:
        models: b models, as :func:`models_for_parameters` returns them.
        inputs: (h + H + 1, r, S) inputs of S pieces.
        outputs: (h + 1, m, S) outputs, which the filter uses.

    Returns:
        (b, H, m, S) simulated outputs.
    """
    A, B, C, D, K = models.A, models.B, models.C, models.D, models.K
    # Inputs and outputs, which the filter needs at each step of every piece, (h + 1, r + m, S).
    samples = np.concatenate([inputs[: len(outputs)], outputs], axis=1)
    # No sample precedes the first one, from which its state could be predicted. So the filter starts at the second
    # sample, with a state that is a linear function of the first inputs and outputs (``StateSpace.second_state``).
    start_map = np.concatenate([models.second_of_inputs, models.second_of_outputs], axis=-1)
    # The filter x⁺ = (A − K C) x + (B − K D) u + K y corrects the states by the measured outputs.
    filter_transition = A - K @ C
    filter_inputs = np.concatenate([B - K @ D, K], axis=-1)
    # Each step is computed for the states (b, n, S) of all models and pieces at once.
    states = start_map @ samples[0]
    for sample in samples[1:]:
        states = filter_transition @ states + filter_inputs @ sample
    # Then the models are simulated without measurements.
    simulated_outputs = []
    for inputs_of_step in inputs[len(outputs) :]:
        simulated_outputs.append(C @ states + D @ inputs_of_step)
        states = A @ states + B @ inputs_of_step
    return np.stack(simulated_outputs, axis=1)


class SimulationPieces(NamedTuple):
    """Pieces of a record, in the engine's units: the filter runs over the first half, a simulation over the second."""

    inputs: Array
    """(h + H + 1, r, S) inputs of S pieces, step by step; h = H is the horizon."""

    outputs: Array
    """(h + H + 1, m, S) outputs of the pieces."""

    filter_steps: int
    """Number of steps h that the filter takes before each simulation."""

    effective_count: float
    """Effective number of pieces: how many simulations fit into the segments without overlap."""

    @classmethod
    def from_segments(cls, segments: Segments, horizon: int) -> SimulationPieces:
        """Cuts segments into overlapping pieces of two horizons each; at most ``MAX_PIECES``, evenly spread.

        Over the first half of a piece the filter estimates the state, and over the second half the model is simulated.

        Args:
            segments: inputs (T, r) and outputs (T, m) of each segment, one of them longer than two horizons.
            horizon: number of samples of each simulation, and of the filter before it.

        Returns:
            The pieces as arrays with the step as the first axis, so that all of them are simulated at once.
        """
        # The filter and the simulation last one horizon each; one more sample initialises the state of the filter.
        piece_length = 2 * horizon + 1
        input_pieces: list[Array] = []
        output_pieces: list[Array] = []
        segment_lengths = []
        for inputs, outputs in segments:
            segment_lengths.append(len(outputs))
            for start in _piece_starts(len(outputs), horizon):
                end = start + piece_length
                input_pieces.append(inputs[start:end])
                output_pieces.append(outputs[start:end])
        # If there are fewer pieces than MAX_PIECES, each is selected once.
        last_piece = len(input_pieces) - 1
        selection = np.unique(np.linspace(0, last_piece, MAX_PIECES).astype(int)).tolist()
        return cls(
            np.stack([input_pieces[index] for index in selection], axis=2),
            np.stack([output_pieces[index] for index in selection], axis=2),
            filter_steps=horizon,
            effective_count=effective_piece_count(segment_lengths, horizon),
        )


def _piece_starts(length: int, horizon: int) -> range:
    """Returns the samples at which the pieces of a segment begin, ``STARTS_PER_HORIZON`` within each horizon.

    Args:
        length: number of samples of the segment.
        horizon: number of samples of each simulation. A piece has one sample from which the filter starts, then one
            horizon over which it converges, and then the horizon that is simulated.

    Returns:
        The first sample of each piece; none if the segment is too short for a piece.
    """
    samples_between_starts = max(1, horizon // STARTS_PER_HORIZON)
    end_of_starts = length - 2 * horizon
    return range(0, end_of_starts, samples_between_starts)


def effective_piece_count(lengths: Sequence[int], horizon: int) -> float:
    """Returns how many independent simulations have as much information as all simulations of a fit.

    Each simulation is the second half of a piece of two horizons. As pieces overlap, their errors are not independent.
    The effective number is that of the simulations that fit into the samples without overlap, and at most the number of
    simulations, of which a fit uses ``MAX_PIECES``. The effective sample size of the fit follows from it.

    Args:
        lengths: numbers of samples of the segments.
        horizon: number of samples of each simulation.

    Returns:
        The effective number, not necessarily an integer.
    """
    piece_count = 0
    usable_samples = 0
    for length in lengths:
        pieces_of_segment = len(_piece_starts(length, horizon))
        # A short segment has no piece, so that its samples are not used.
        if pieces_of_segment:
            piece_count += pieces_of_segment
            usable_samples += length
    simulations_without_overlap = usable_samples / horizon
    return float(min(simulations_without_overlap, piece_count, MAX_PIECES))


def simulation_horizon(
    model: GenerativeModel,
    settings: CompleteSettings,
    scaling: Scaling,
    record: Record,
) -> int | None:
    """Returns the horizon of the fit: the number of samples of each simulation, at most ``settings.horizon``.

    A shorter horizon yields more independent simulations. So for a short record it is shortened until the effective
    sample size is ``MIN_SAMPLES_PER_PARAMETER`` times the number of free parameters of A and B.

    Args:
        model: the generative model; parameters that its prior does not fix are free.
        settings: settings of the fit, with the horizon in seconds.
        scaling: the engine's units, and whether the inputs are known.
        record: the training data: T samples of r inputs and m outputs, in one or several segments.

    Returns:
        The number of samples; 0 if even ``MIN_HORIZON_SECONDS`` is too long for the record; ``None`` if there is to be
        no fit, since the settings ask for none, the inputs are unknown, the prior is the paper's, or no parameter is
        free.
    """
    n, r, m = model.sizes
    # The uniform prior is that of the paper, whose method has no such fit. Without known inputs nothing is simulated.
    if settings.horizon is None or settings.prior == "uniform" or not scaling.known:
        return None
    # θ has the n² entries of A first, then the n r entries of B. Those that the prior fixes have a large precision.
    precisions_of_A_and_B = np.diag(model.prior.theta_precision)[: n * n + n * r]
    free_parameter_count = np.count_nonzero(precisions_of_A_and_B < KINEMATIC_PRECISION)
    if free_parameter_count == 0:
        return None
    # The horizon is the longest for which the record suffices, from the settings' horizon down to the shortest.
    max_horizon = max(1, round(settings.horizon / record.dt))
    min_horizon = min(max_horizon, max(1, round(MIN_HORIZON_SECONDS / record.dt)))
    for horizon in range(max_horizon, min_horizon - 1, -1):
        effective_samples = effective_piece_count(record.lengths, horizon) * m
        if effective_samples >= MIN_SAMPLES_PER_PARAMETER * free_parameter_count:
            return horizon
    return 0


@dataclass(frozen=True, eq=False)
class SimulationFit:
    """Result of the simulation-error (output-error) fit: parameters θ and their covariance, in the engine's units."""

    theta: Array
    """(k,) all parameters, the free ones as fitted and the others as they were."""

    free: Indices
    """(f,) indices of the free parameters in θ."""

    covariance: Array
    """(f, f) posterior covariance of the free parameters."""

    effective_samples: float
    """Effective sample size: number of outputs times the effective number of simulations."""

    horizon: int
    """Number of samples of each simulation, and of the filter before it."""

    terms: Mapping[str, Array]
    """Terms of F̄ by name, nats, (I + 1,) each, by iteration from the start."""

    converged: bool
    """Whether the last step gained, or the last curvature predicts, less than ``CONVERGED_STEP_NATS``."""

    @property
    def degrees_of_freedom(self) -> float:
        """Degrees of freedom with which the variance of the noise is estimated."""
        return self.effective_samples - len(self.free)

    def theta_covariance(self, prior_covariance: Array) -> Array:
        """Returns the posterior covariance of all parameters θ.

        Free parameters have the covariance of the fit. Their covariance with the others, which the fit did not change,
        is 0.

        Args:
            prior_covariance: covariance of the prior (k, k), which parameters that were not free keep.

        Returns:
            The posterior covariance (k, k).
        """
        covariance = prior_covariance.copy()
        covariance[self.free] = 0.0
        covariance[:, self.free] = 0.0
        covariance[np.ix_(self.free, self.free)] = self.covariance
        return covariance


@dataclass(frozen=True, eq=False)
class SimulationObjective:
    """Log joint density of the simulation errors and the free parameters, the objective of the Gauss-Newton steps.

    The noise precision is at its maximum: with N effective samples the log likelihood is −N/2 ln(mean squared error),
    up to a constant. Points are the free parameters (f,).
    """

    theta: Array
    """(k,) all parameters; the free ones are replaced."""

    free: Indices
    """(f,) indices of the free parameters in θ, which are in A and B."""

    prior_mean: Array
    """(f,) prior mean of the free parameters."""

    prior_precision: Array
    """(f, f) prior precision of the free parameters."""

    sizes: ModelSizes
    """Numbers of states, inputs and outputs."""

    gain: Array
    """(n, m) gain of the filter."""

    dt: float
    """Sampling step, s."""

    pieces: SimulationPieces
    """Pieces of the record that are simulated."""

    @property
    def effective_samples(self) -> float:
        """Effective sample size: number of outputs times the effective number of pieces."""
        return self.pieces.effective_count * self.sizes.m

    def errors(self, points: Array) -> Array:
        """Simulates all pieces with several parameter vectors at once, and returns the errors of the outputs.

        Args:
            points: (b, f) free parameters of b models; the other parameters are the same for all.

        Returns:
            Measured minus simulated outputs (b, H, m, S): over H steps, of S pieces; infinite or NaN where a simulation
            overflows.
        """
        thetas = np.repeat(self.theta[None], len(points), axis=0)
        thetas[:, self.free] = points
        models = models_for_parameters(thetas, self.sizes, self.gain, self.dt)
        first_simulated = self.pieces.filter_steps + 1
        outputs = self.pieces.outputs
        simulated_outputs = simulate_models(models, self.pieces.inputs, outputs[:first_simulated])
        with np.errstate(over="ignore", invalid="ignore"):
            return outputs[first_simulated:] - simulated_outputs

    def value(self, point: Array) -> float:
        """Returns the log joint density, nats, up to a constant."""
        return self._value_of_errors(point, self.errors(point[None]))

    def expand(self, point: Array) -> QuadraticExpansion:
        """Expands the log joint density to second order about a point.

        The gradient and the Gauss-Newton curvature, of the form JᵀJ, follow from the Jacobian J of the errors. It is
        computed by finite differences: one simulation for each free parameter, all of them at once.

        Args:
            point: (f,) free parameters.

        Returns:
            The value, the gradient (f,) and the curvature (f, f) at the point.
        """
        steps = FINITE_DIFFERENCE_STEP * np.maximum(1.0, abs(point))
        errors = self.errors(np.vstack([point, point + np.diag(steps)]))
        residuals = errors[0]
        # The derivatives of all errors by one parameter in each row (f, number of errors).
        jacobian = (errors[1:] - residuals).reshape(len(point), -1) / steps[:, None]
        mean_square = _mean_square(residuals)
        # As the pieces overlap, each error counts only as a fraction of an independent sample.
        samples_per_error = self.effective_samples / residuals.size
        # The derivatives of the log likelihood, −N/2 ln(mean square), and of the log prior.
        likelihood_gradient = -samples_per_error * jacobian @ residuals.ravel() / mean_square
        prior_gradient = self.prior_precision @ (point - self.prior_mean)
        gradient = likelihood_gradient - prior_gradient
        curvature = samples_per_error * jacobian @ jacobian.T / mean_square + self.prior_precision
        return QuadraticExpansion(
            point, self._value_of_errors(point, residuals), gradient, curvature
        )

    def terms(self, expansion: QuadraticExpansion) -> dict[Term, float]:
        """Returns the terms of the free energy F̄ of this fit, with the names that they have in DEM's own F̄.

        For N effective samples with the mean squared error V, the noise precision is 1 / V, and the terms are:

        - Entropy of the noise: N/2 ln(1 / V), which is the log likelihood.
        - Prediction errors of outputs: −½ Σ (squared errors / V) = −N/2, whatever V is.
        - Prediction errors of parameters: the log prior density.
        - Entropy of the parameters: −½ ln(determinant of the curvature over that of the prior precision).

        Simulated states are not uncertain, so that there is no entropy of states.

        Args:
            expansion: expansion of the log joint density about the point at which the terms are computed.

        Returns:
            The terms by name, nats.
        """
        log_prior = self._log_prior(expansion.point)
        # The value of the expansion is the log likelihood plus the log prior.
        log_likelihood = expansion.value - log_prior
        log_precision_ratio = logdet(expansion.curvature) - logdet(self.prior_precision)
        return {
            Term.NOISE_ENTROPY: log_likelihood,
            Term.PARAMETER_ENTROPY: -0.5 * log_precision_ratio,
            Term.PREDICTION_ERROR_OF_OUTPUTS: -0.5 * self.effective_samples,
            Term.PREDICTION_ERROR_OF_PARAMETERS: log_prior,
        }

    def _value_of_errors(self, point: Array, errors: Array) -> float:
        """Returns the log joint density at a point whose simulation errors are known."""
        log_likelihood = -0.5 * self.effective_samples * np.log(_mean_square(errors))
        return float(log_likelihood + self._log_prior(point))

    def _log_prior(self, point: Array) -> float:
        """Returns the log prior density of the free parameters, up to a constant."""
        deviation = point - self.prior_mean
        return float(-0.5 * deviation @ self.prior_precision @ deviation)


@may_overflow
def _mean_square(errors: Array) -> float:
    """Returns the mean of the squared errors, infinite or NaN where a simulation overflowed."""
    return (errors**2).mean()


def fit_simulation_error(
    model: GenerativeModel,
    settings: CompleteSettings,
    scaling: Scaling,
    theta: Array,
    gain: Array,
    record: Record,
) -> SimulationFit | None:
    """Fits A and B by Gauss-Newton steps, so that simulations over a short horizon have the smallest errors.

    Each step increases the free energy F̄. A parameter of A and B is free if its prior precision is below
    ``KINEMATIC_PRECISION``; the others are fixed by kinematics.

    Args:
        model: the generative model, whose prior is used.
        settings: order, embedding, noise, priors and iterations of the fit.
        scaling: means and units of the channels, which convert them to the engine's units.
        theta: (k,) parameters to start from.
        gain: (n, m) gain of the filter that provides the states at which simulations start.
        record: the training data: T samples of r inputs and m outputs, in one or several segments.

    Returns:
        The fit; ``None`` if there is no horizon (:func:`simulation_horizon`) or the simulations overflow.
    """
    # None and 0 both mean that there is no fit.
    horizon = simulation_horizon(model, settings, scaling, record)
    if not horizon:
        return None
    pieces = SimulationPieces.from_segments(scaling.scale_segments(record), horizon)
    is_free = np.diag(model.prior.theta_precision) < KINEMATIC_PRECISION
    precision = model.prior.theta_precision
    if settings.prior == "regulated":
        precision = _weak_prior_precision(model, is_free, record)
    # θ = [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)]: parameters of C are not fitted.
    size_of_A_and_B = model.n * model.n + model.n * model.r
    free = np.flatnonzero(is_free[:size_of_A_and_B])
    objective = SimulationObjective(
        theta,
        free,
        prior_mean=model.prior.theta_mean[free],
        prior_precision=precision[np.ix_(free, free)],
        sizes=model.sizes,
        gain=gain,
        dt=record.dt,
        pieces=pieces,
    )
    if not np.isfinite(objective.value(theta[free])):
        return None
    maximisation = gauss_newton(objective, objective.expand(theta[free]), DAMPING)
    maximum = maximisation.expansions[-1]
    fitted_theta = theta.copy()
    fitted_theta[free] = maximum.point
    effective_samples = objective.effective_samples
    terms = [objective.terms(expansion) for expansion in maximisation.expansions]
    # In the curvature the noise variance is the mean squared error, which is too small since the parameters were
    # fitted. The factor corrects it to the sum of squares divided by the degrees of freedom.
    degrees_of_freedom = effective_samples - len(free)
    covariance = inverse(maximum.curvature) * effective_samples / degrees_of_freedom
    return SimulationFit(
        theta=fitted_theta,
        free=free,
        covariance=covariance,
        effective_samples=effective_samples,
        horizon=pieces.filter_steps,
        terms={name: np.array([row[name] for row in terms]) for name in terms[0]},
        converged=maximisation.last_gain <= CONVERGED_STEP_NATS,
    )


def _weak_prior_precision(model: GenerativeModel, is_free: Flags, record: Record) -> Array:
    """Returns the prior precision of the simulation-error fit under the "regulated" prior.

    That prior (``priors.regulated_prior``) fixes the kinematic parameters and leaves the others free. Free parameters
    get the weak ``FREE_PARAMETER_PRECISION`` here, so that the data determine them. But combinations of motors that are
    orthogonal to the mixer row of the axis, such as the sum of all motors, hardly turn the vehicle: their effects get
    the higher precision ``NON_TURNING_PRECISION`` about 0.

    Args:
        model: the generative model, whose prior is used for all other parameters.
        is_free: (k,) which parameters are free.
        record: the training data: T samples of r inputs and m outputs, in one or several segments.

    Returns:
        Prior precision of θ, (k, k).
    """
    size_of_A = model.n * model.n
    size_of_A_and_B = size_of_A + model.n * model.r
    weak_precision = FREE_PARAMETER_PRECISION * np.eye(len(is_free))
    precision = np.where(np.outer(is_free, is_free), weak_precision, model.prior.theta_precision)
    # Columns are an orthonormal basis of the motor combinations that should not turn the vehicle.
    non_turning = scipy.linalg.null_space(axis_mixer(record).T)
    # The first entry of a row of B, which is a motor's, shows whether the row is free.
    free_rows = np.flatnonzero(is_free[size_of_A : size_of_A_and_B : model.r])
    for row in free_rows:
        # The row of B begins with the motors; the constant input, if there is one, follows them.
        motor_entries = size_of_A + row * model.r + np.arange(len(non_turning))
        precision[np.ix_(motor_entries, motor_entries)] += (
            NON_TURNING_PRECISION * non_turning @ non_turning.T
        )
    return precision
