"""Fits of black-box models with 1, 2, … states to one flight, whose free energies can be compared between orders.

docs/order.md shows why they are comparable. All orders are fitted to the same data, which a Gaussian kernel filters, in
units of the flight's own: outputs, and all inputs together, of variance 1, and a unit of time in which the outputs
change by their standard deviation. A prior of variance 1 then means the same for any flight. The effective sample size
is counted, since noise of kernel width s is correlated over √(2π) s/dt samples, Σₖ ρ(k dt)².

F̄ of a model with hidden states has many maxima, most of them far below the highest. So the fit of each order starts
from the data: a linear map takes them to estimates of the states and of their rates, from which θ follows by
regression, in the coordinates of the priors: states of variance 1, and independent noises.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, e, pi, sqrt

import numpy as np
import scipy
from numpy.linalg import LinAlgError

from mavdem.arrays import Array
from mavdem.confidence import MIN_SAMPLES_FOR_STATISTICS
from mavdem.dem.engine.ascent import Iterate, initial_iterate
from mavdem.dem.engine.generalized_coordinates import temporal_precision
from mavdem.dem.engine.generative import GenerativeModel, Prior
from mavdem.dem.engine.linalg import ROUNDING_TOLERANCE, raise_on_overflow
from mavdem.dem.engine.model import pack
from mavdem.dem.engine.moments import SufficientStatistics
from mavdem.dem.engine.quasi_newton import maximise_by_quasi_newton
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling
from mavdem.dem.settings import Settings
from mavdem.errors import NotLearnable
from mavdem.facts.model import ModelRefusal

RELATIVE_KERNEL_WIDTH = 0.6
"""Width σ of the kernel over the time in which the outputs change by their standard deviation.

A choice: wide enough to average noise, narrow enough to keep fast states visible.
"""

MIN_KERNEL_SAMPLES = 100.0
"""Least effective sample size that the kernel leaves of a flight: a short flight has a narrower kernel."""

MIN_KERNEL_STEPS = 1.5
"""Smallest width σ of the kernel, in sampling steps: derivatives of a narrower kernel are undersampled."""

KERNEL_REACH = 6.0
"""Widths σ to either side at which the kernel is cut off; beyond, even its eighth derivative is below 5e-5."""

SPARE_VALUES = 3
"""Number of values of a generalized output beyond the states of the largest model: they distinguish the orders."""

MIN_EMBEDDING_ORDER = 2
"""Lowest embedding order p of the outputs: below the second derivative the noise cannot be estimated."""

LAMBDA_Z = 8.0
"""Prior mean of the log precision of the measurement noise: 2 % of the outputs' standard deviation."""

LAMBDA_W = 2.0
"""Prior mean of the log precision of the process noise: about a third of the size of the states' rates."""

LAMBDA_PRECISION = 0.1
"""Prior precision of the log noise precisions: the noises' standard deviations are known within a factor of five."""

KNOWN_INPUT_PRECISION = Settings.input_precision
"""Prior precision of recorded inputs, and of the constant one, as in ``Settings``."""

UNKNOWN_INPUT_PRECISION = e**2
"""Prior precision of unknown inputs about 0, as in the paper."""

MAX_EVALUATIONS = 400
"""Largest number of evaluations of F̄ and its gradient in one fit: a guard, since most fits converge in far fewer."""


@dataclass(frozen=True, eq=False)
class BlackBoxData:
    """Outputs and inputs of a flight with their time derivatives, to which models of any order are fitted.

    All are in units of the flight's own: outputs, and all inputs together, of variance 1, and ``time_unit``.
    """

    statistics: SufficientStatistics
    """Statistics of the generalized data [ỹ; η̃] of all samples."""

    r: int
    """Number of inputs, the constant one at the end included."""

    m: int
    """Number of outputs."""

    p: int
    """Embedding order of the outputs; the inputs have p − 1."""

    dt: float
    """Sampling step, s."""

    kernel_width: float
    """Width σ of the Gaussian kernel that filters the data, s."""

    time_unit: float
    """Unit of time of the data: the time in which the outputs change by their standard deviation, s."""

    input_precision: Array
    """(p r, p r) prior precision P̃ᵛ of the generalized inputs."""

    @classmethod
    def from_record(cls, record: Record, max_order: int, known_inputs: bool) -> BlackBoxData:
        """Filters a record by a Gaussian kernel, embeds it into generalized coordinates, and scales it.

        Args:
            record: the training data: T samples of r inputs and m outputs, in one or several segments.
            max_order: largest number of states that the data are to be fitted with.
            known_inputs: whether the recorded inputs are used; if not, as many unknown ones are estimated.

        Returns:
            The second moments of the data of all segments, with the units and embedding order of the data.

        Raises:
            NotLearnable: the record has too few effective samples, or an output is constant.
        """
        settings = replace(Settings.paper(), scaling="channel", known_inputs=known_inputs)
        scaling = Scaling.from_record(record, settings)
        width = kernel_width(record)
        m = record.outputs.shape[1]
        recorded_inputs = record.inputs.shape[1]
        # The scaling "channel" has a constant input, which follows the recorded ones.
        r = recorded_inputs + 1
        # The p + 1 derivatives of m outputs are as many values as the largest model has states, and some more.
        p = max(MIN_EMBEDDING_ORDER, ceil((max_order + SPARE_VALUES) / m) - 1)
        data_of_segments = []
        for inputs, outputs in scaling.scale_segments(record):
            generalized_outputs = embed_by_kernel(outputs, p, width, record.dt)
            generalized_inputs = embed_by_kernel(inputs, p - 1, width, record.dt)
            data_of_segments.append(np.hstack([generalized_outputs, generalized_inputs]))
        data = np.concatenate(data_of_segments)
        effective_samples = len(data) / _samples_per_effective_sample(width, record.dt)
        if not effective_samples >= MIN_SAMPLES_FOR_STATISTICS:
            raise NotLearnable(
                ModelRefusal.TOO_FEW_TO_CHOOSE_ORDER,
                samples=len(record),
                width=width,
                effective_samples=effective_samples,
                least_samples=float(MIN_SAMPLES_FOR_STATISTICS),
            )
        # The first m columns are the outputs, the next m are their first derivatives.
        time_unit = _time_of_change(data[:, :m], data[:, m : 2 * m])
        # The unit of the k-th derivative contains timeᵏ. Outputs have the orders 0 to p, inputs 0 to p − 1.
        derivative_orders = np.concatenate(
            [np.repeat(np.arange(p + 1), m), np.repeat(np.arange(p), r)]
        )
        unit_per_column = time_unit**derivative_orders
        # The constant input is known in any case.
        precision_per_input = np.full(r, KNOWN_INPUT_PRECISION)
        if not known_inputs:
            precision_per_input[:recorded_inputs] = UNKNOWN_INPUT_PRECISION
        return cls(
            SufficientStatistics.from_segments(data * unit_per_column),
            r=r,
            m=m,
            p=p,
            dt=record.dt,
            kernel_width=width,
            time_unit=time_unit,
            input_precision=np.diag(np.tile(precision_per_input, p)),
        )

    @property
    def smoothness(self) -> float:
        """Kernel width of the noise after the filter, s; before the filter it is assumed to be one sampling step."""
        return np.hypot(self.dt, self.kernel_width)

    @property
    def effective_statistics(self) -> SufficientStatistics:
        """The statistics with the effective sample size: each sample counts as a fraction of an independent one."""
        weight = 1 / _samples_per_effective_sample(self.smoothness, self.dt)
        return SufficientStatistics(
            weight * self.statistics.sample_count, weight * self.statistics.gram
        )

    def generative_model(self, order: int) -> GenerativeModel:
        """Returns the generative model with ``order`` states, dx/dt = A x + B u + w, y = C x + z, and its priors.

        The model is in generalized coordinates: each signal stands with its time derivatives, outputs y and states x up
        to order p, inputs u and process noise w up to order p − 1. The rate of the highest derivative of x is not
        modelled, so that w has one derivative less.

        The elements of A, B and C have prior mean 0 and variance 1, and so have the states. The logarithms λ of the
        noise precisions are one for the measurement noise z of all outputs, and then one for the process noise of each
        state.

        Args:
            order: number of states n, beside m outputs and r inputs.
        """
        n = order
        m = self.m
        theta_mean = pack(A=np.zeros((n, n)), B=np.zeros((n, self.r)), C=np.zeros((m, n)))
        prior = Prior(
            theta_mean,
            theta_precision=np.eye(len(theta_mean)),
            lambda_mean=np.array([LAMBDA_Z] + [LAMBDA_W] * n),
            lambda_precision=LAMBDA_PRECISION * np.eye(1 + n),
        )
        order_of_inputs_and_noise = self.p - 1
        # Width of the noise's autocorrelation, in the flight's own unit of time, which the data have.
        smoothness = self.smoothness / self.time_unit
        return GenerativeModel(
            n=n,
            r=self.r,
            m=m,
            p=self.p,
            d=order_of_inputs_and_noise,
            q=order_of_inputs_and_noise,
            output_temporal_precision=temporal_precision(self.p, smoothness),
            state_temporal_precision=temporal_precision(order_of_inputs_and_noise, smoothness),
            # Index in λ of the noise of each output and of each state.
            output_groups=np.zeros(m, int),
            state_groups=1 + np.arange(n),
            input_precision=self.input_precision,
            prior=prior,
            state_precision=np.eye(n),
        )


def embed_by_kernel(
    samples: Array,
    order: int,
    width: float,
    dt: float,
) -> Array:
    """Embeds samples into generalized coordinates by convolution with a Gaussian kernel and its derivatives.

    The generalized coordinates of a signal are its smoothed value and its derivatives, side by side.

    Derivatives from a polynomial fit over a window are not exactly the derivatives of one signal, and an additional
    state might explain the difference. The derivatives here are exact: convolution preserves ẋ = A x + B v + w and
    y = C x + z (P. Young, "Parameter estimation for continuous-time models: a survey", Automatica 17, 1981), and noise
    of smoothness s becomes noise of smoothness √(s² + σ²), so that Eq. ``Smatrix`` holds.

    Args:
        samples: (T, m) uniformly sampled signals.
        order: highest derivative.
        width: width σ of the kernel exp(−t²/2σ²)/(√(2π) σ), s, so large that the samples resolve the kernel.
        dt: sampling step, s.

    Returns:
        Generalized vectors (T', (order + 1) · m): the m smoothed values, their first derivatives and so on, of the
        samples around which the whole kernel lies in the signal. Empty if the kernel is longer than the signal.
    """
    # Samples to either side of the kernel's centre. Without the tolerance, rounding might add one more.
    kernel_reach = ceil(KERNEL_REACH * width / dt * (1 - ROUNDING_TOLERANCE))
    if len(samples) <= 2 * kernel_reach:
        return np.empty((0, (order + 1) * samples.shape[1]))
    derivatives = []
    for k in range(order + 1):
        derivative_per_step = scipy.ndimage.gaussian_filter1d(
            samples, width / dt, axis=0, order=k, radius=kernel_reach
        )
        # SciPy takes the sampling step as the unit of time; dividing the k-th derivative by dtᵏ converts it to seconds.
        derivatives.append(derivative_per_step / dt**k)
    # At both ends the kernel reaches beyond the signal.
    return np.hstack(derivatives)[kernel_reach:-kernel_reach]


def _samples_per_effective_sample(width: float, dt: float) -> float:
    """Computes how many samples of smooth noise carry as much information as one independent sample.

    Neighbouring samples of smooth noise are correlated, so that T samples have the effective sample size T / N. Here N
    is Σₖ ρ(k dt)², with the autocorrelation ρ(τ) = exp(−τ²/4s²) of noise of kernel width s. The sum is √(2π) s/dt.

    Args:
        width: kernel width s, in seconds.
        dt: sampling step, s.

    Returns:
        The number, not rounded.
    """
    return sqrt(2 * pi) * width / dt


def kernel_width(record: Record) -> float:
    """Returns the width σ of the Gaussian kernel that filters a record.

    The kernel averages noise, and must be narrow compared with the motion: its width is ``RELATIVE_KERNEL_WIDTH`` times
    the time in which the outputs change by their standard deviation. Since a wide kernel correlates neighbouring
    samples, the width is limited so that the effective sample size of the filtered record, the number of independent
    samples with as much information, is at least ``MIN_KERNEL_SAMPLES``. Above all, it is at least ``MIN_KERNEL_STEPS``
    sampling steps, since a narrower kernel would be undersampled.

    Args:
        record: the training data: T samples of r inputs and m outputs, in one or several segments.

    Returns:
        The width σ, s.
    """
    # A kernel of w sampling steps leaves one effective sample of N w samples, where N is the number for one step. With
    # the widest kernel, MIN_KERNEL_SAMPLES of them remain of the duration of the record.
    samples_per_kernel_step = _samples_per_effective_sample(width=1.0, dt=1.0)
    duration = len(record) * record.dt
    width = duration / (samples_per_kernel_step * MIN_KERNEL_SAMPLES)
    time_of_change = _time_of_output_change(record)
    if time_of_change is not None:
        width = min(width, RELATIVE_KERNEL_WIDTH * time_of_change)
    return max(MIN_KERNEL_STEPS * record.dt, width)


def _time_of_output_change(record: Record) -> float | None:
    """Returns the time, s, in which the outputs change by their standard deviation (:func:`_time_of_change`).

    Args:
        record: the training data, in one or several segments.

    Returns:
        The time; None if all segments are shorter than the kernel by which the rates are computed.
    """
    statistics = record.channel_statistics.outputs
    output_count = record.outputs.shape[1]
    # The rates are computed with a narrow kernel, which averages the noise of a few samples only.
    rate_kernel_width = 2 * record.dt
    derivatives_of_segments = []
    for _, outputs in record.segments:
        scaled_outputs = (outputs - statistics.mean) / np.sqrt(statistics.variance)
        derivatives_of_segments.append(
            embed_by_kernel(scaled_outputs, 1, rate_kernel_width, record.dt)
        )
    # The columns are the smoothed outputs, and then their rates.
    derivatives = np.concatenate(derivatives_of_segments)
    if not len(derivatives):
        return None
    return _time_of_change(derivatives[:, :output_count], derivatives[:, output_count:])


def _time_of_change(values: Array, rates: Array) -> float:
    """Returns the time in which signals change by their standard deviation: the ratio of their size to their rate.

    Args:
        values: T samples of m signals of about the same variance (T, m).
        rates: derivatives of the signals (T, m), per second.

    Returns:
        RMS deviation of the signals divided by the RMS deviation of the rates, s.
    """
    return np.sqrt(values.var(axis=0).mean() / rates.var(axis=0).mean())


def fits_by_order(data: BlackBoxData, max_order: int) -> tuple[Iterate | None, ...]:
    """Fits models with 1 to ``max_order`` states to the same data, independently of each other.

    Args:
        data: outputs, inputs and their time derivatives (generalized coordinates), with their moments.
        max_order: largest number of states.

    Returns:
        The fit of each order from 1 on: parameters and noise precisions at the highest free energy that was found. None
        for an order whose fit overflowed or met a singular matrix.
    """
    fits: list[Iterate | None] = []
    for order in range(1, max_order + 1):
        try:
            # An overflow raises a LinAlgError here, as a singular matrix does.
            with raise_on_overflow():
                fit = _fit_order(data, order)
        except LinAlgError:
            fits.append(None)
        else:
            fits.append(fit)
    return tuple(fits)


def _fit_order(data: BlackBoxData, order: int) -> Iterate:
    """Fits a black-box model with a given number of states: maximises F̄ over the parameters and the noise precisions.

    The free energy has many maxima. So the fit starts from θ by regressions (:func:`theta_from_data`) and from the
    prior means of the log noise precisions λ, and the first states are estimated as if both were exact. A few rounds of
    DEM follow, and then a quasi-Newton search (:func:`maximise_by_quasi_newton`), since rounds alone converge slowly if
    the outputs depend on few of the states.

    Args:
        data: outputs, inputs and their time derivatives (generalized coordinates), with their moments.
        order: number of states.

    Returns:
        The iterate of highest free energy.

    Raises:
        numpy.linalg.LinAlgError: the fit breaks down.
    """
    model = data.generative_model(order)
    # With a covariance of 0 the first D step treats the noise precisions as exact, as it treats θ.
    no_uncertainty = np.zeros_like(model.prior.lambda_precision)
    start = initial_iterate(
        model,
        data.effective_statistics,
        theta=theta_from_data(data, order),
        lambda_covariance=no_uncertainty,
    )
    return maximise_by_quasi_newton(start, MAX_EVALUATIONS)


def theta_from_data(data: BlackBoxData, order: int) -> Array:
    """Estimates the parameters θ = (A, B, C) of a model by regressions, as a start for the fit.

    The states are chosen as linear functions of the generalized data. The first states are the outputs. Further states
    are the principal components of the outputs' first, second, … derivative, after the part that the earlier states and
    the inputs explain is subtracted, until there are enough. The rate of each state is the same function of the next
    higher derivatives. With states and rates as functions of the data, A, B and C are computed by regression.

    Args:
        data: the generalized data: outputs and inputs with their derivatives.
        order: number of states.

    Returns:
        θ (k,) in the units of the data.

    Raises:
        numpy.linalg.LinAlgError: there are too few derivatives for this number of states.
    """
    # The matrices y[k] and v[k] select the k-th derivatives of the outputs and of the inputs.
    y, v = _signal_selectors(data)
    # The states so far and their rates: linear functions of the data, one in each row.
    states = np.zeros((0, len(data.statistics.gram)))
    rates = states
    for k in range(data.p):
        # The k-th derivative of the outputs, and its own rate, as linear functions of the data. From the first
        # derivative on, what the states and the inputs up to order k − 1 explain is subtracted.
        residual_derivative = y[k]
        residual_rate = y[k + 1]
        if k > 0:
            # The inputs up to order k − 1, and their rates, which are the inputs of the orders 1 to k.
            regressors = np.vstack([states, *v[:k]])
            regressor_rates = np.vstack([rates, *v[1 : k + 1]])
            coefficients = _regress_with_ridge(data, y[k], regressors, ROUNDING_TOLERANCE)
            residual_derivative = residual_derivative - coefficients @ regressors
            residual_rate = residual_rate - coefficients @ regressor_rates
        # The largest principal components of the residual become further states, as many as are still missing. Outputs
        # are compared in units of the derivatives' standard deviations.
        deviation = np.sqrt(np.diag(_mean_products(data, y[k], y[k])))
        scaled_residual = residual_derivative / deviation[:, None]
        directions = _principal_directions(_mean_products(data, scaled_residual, scaled_residual))
        missing_states = order - len(states)
        combinations = directions[:missing_states] / deviation
        states = np.vstack([states, combinations @ residual_derivative])
        rates = np.vstack([rates, combinations @ residual_rate])
        if len(states) == order:
            return _theta_by_regression(data, states, rates)
    raise LinAlgError("too few derivatives for as many states")


def _signal_selectors(data: BlackBoxData) -> tuple[list[Array], list[Array]]:
    """Returns the matrices that select each derivative of outputs and inputs from a sample of the generalized data.

    A sample is the vector [ỹ; η̃]: the m outputs, their first derivatives and so on up to order p, and then the r
    inputs likewise up to order p − 1.

    Args:
        data: outputs, inputs and their time derivatives (generalized coordinates), with their moments.

    Returns:
        p + 1 matrices (m, dim [ỹ; η̃]), one for each derivative of the outputs, and p matrices (r, dim [ỹ; η̃]), one
        for each derivative of the inputs.
    """
    identity = np.eye(len(data.statistics.gram))
    outputs, inputs = np.split(identity, [data.m * (data.p + 1)])
    return np.split(outputs, data.p + 1), np.split(inputs, data.p)


def _mean_products(
    data: BlackBoxData, left_coefficients: Array, right_coefficients: Array
) -> Array:
    """Returns the mean over all samples of the products of two sets of linear functions of the data.

    The mean of (a · z)(b · z) is aᵀ E[z zᵀ] b, so that it can be computed from the second moments of the data
    z = [ỹ; η̃].

    Args:
        data: outputs, inputs and their time derivatives (generalized coordinates), with their moments.
        left_coefficients: coefficients of a functions, one in each row (a, dim [ỹ; η̃]).
        right_coefficients: coefficients of b functions (b, dim [ỹ; η̃]).

    Returns:
        Mean products (a, b).
    """
    return (
        left_coefficients
        @ data.statistics.gram
        @ right_coefficients.T
        / data.statistics.sample_count
    )


def _regress_with_ridge(
    data: BlackBoxData,
    targets: Array,
    regressors: Array,
    ridge: float,
) -> Array:
    """Regresses linear functions of the data, such as derivatives of outputs, on others, by least squares with a ridge.

    A function is the scalar product of its coefficients with the generalized data of a sample. The normal equations
    need only means over all samples of products of such functions, which follow from the second moments of the data.

    Args:
        data: outputs, inputs and their time derivatives (generalized coordinates), with their moments.
        targets: the functions to explain, a rows of coefficients (a, dim [ỹ; η̃]).
        regressors: the functions that explain them, b rows of coefficients (b, dim [ỹ; η̃]).
        ridge: the ridge, as a fraction of each regressor's variance.

    Returns:
        Coefficients (a, b).
    """
    # Regressors are scaled to variance 1, so that the ridge has the same effect on each. One that is always 0 remains
    # 0.
    deviation = np.sqrt(np.diag(_mean_products(data, regressors, regressors)))
    scale = np.where(deviation > 0, deviation, 1.0)[:, None]
    scaled_regressors = regressors / scale
    normal_matrix = _mean_products(data, scaled_regressors, scaled_regressors)
    normal_matrix += ridge * np.eye(len(scaled_regressors))
    moments = _mean_products(data, scaled_regressors, targets)
    scaled_coefficients = np.linalg.solve(normal_matrix, moments)
    return (scaled_coefficients / scale).T


def _principal_directions(symmetric_matrix: Array) -> Array:
    """Returns the eigenvectors of a symmetric matrix as rows, the largest eigenvalues first."""
    return np.linalg.eigh(symmetric_matrix)[1].T[::-1]


def _theta_by_regression(data: BlackBoxData, states: Array, rates: Array) -> Array:
    """Estimates θ by regression of rates and outputs on states and inputs, in the coordinates of the priors.

    The data determine the states only up to an invertible linear map. The priors assume states of variance 1 with
    independent noises. So the states are first whitened, and then rotated to the principal axes of the process noise.

    Args:
        data: outputs, inputs and their time derivatives (generalized coordinates), with their moments.
        states: (n, dim [ỹ; η̃]) linear functions of the data that estimate the n states, one in each row.
        rates: (n, dim [ỹ; η̃]) linear functions of the data that estimate the derivatives of the states.

    Returns:
        θ (k,) in the units of the data.
    """
    n = len(states)
    output_derivatives, input_derivatives = _signal_selectors(data)
    outputs = output_derivatives[0]
    inputs = input_derivatives[0]
    # Whitening: the states are divided by their standard deviations along their principal axes.
    variances, axes = np.linalg.eigh(_mean_products(data, states, states))
    min_variance = ROUNDING_TOLERANCE * variances.max()
    whitening = (axes / np.sqrt(np.maximum(variances, min_variance))).T
    states = whitening @ states
    rates = whitening @ rates
    # A and B follow from a regression of the rates on states and inputs, whose residual is the process noise.
    regressors = np.vstack([states, inputs])
    # Like the priors, the ridge has the weight of one sample.
    ridge = 1 / data.statistics.sample_count
    dynamics = _regress_with_ridge(data, rates, regressors, ridge)
    noise = rates - dynamics @ regressors
    noise_covariance = _mean_products(data, noise, noise)
    # The rotation leaves the states' variances at 1, and makes their noises independent.
    rotation = _principal_directions(noise_covariance)
    A, B = np.split(rotation @ dynamics, [n], axis=1)
    # An unknown input has no data, so its column of B is 0 so far. A fit that starts from 0 would attribute all of its
    # effect to the process noise. So the column of each unknown input starts with an effect on one state, as large as
    # the noise of that state.
    unknown_inputs = np.flatnonzero(np.diag(_mean_products(data, inputs, inputs)) == 0)
    driven_states = unknown_inputs % n
    noise_deviations = np.sqrt(np.diag(rotation @ noise_covariance @ rotation.T)[driven_states])
    B[driven_states, unknown_inputs] = noise_deviations
    C = _regress_with_ridge(data, outputs, rotation @ states, ridge)
    # The rows of A have been rotated with the rates. Its columns belong to the states, and are rotated here.
    return pack(A @ rotation.T, B, C)
