"""DEM's generative model: outputs ỹ, inputs η̃ and hidden X, each with its time derivatives, and prediction errors ε̃.

ỹ are the outputs, η̃ the recorded inputs, and X = [x̃; ṽ] the states and the true inputs, which are estimated:

    ỹ = C̃ x̃ + z̃,   D x̃ = Ã x̃ + B̃ ṽ + w̃,   ṽ = η̃ + input noise            Eq. ``generative_process``

A generalized vector stacks a signal and its derivatives, x̃ = [x; x'; x''; …], by order; D shifts each order up by one.
Everything is linear in the data, so the D, E and M steps need of the data only one matrix of second moments.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Indices
from mavdem.dem.engine.linalg import logdet
from mavdem.dem.engine.model import unpack
from mavdem.dem.engine.model_structure import (
    ErrorRows,
    OperatorStructure,
    PrecisionStructure,
    RegressorLayout,
    RegressorMoments,
)


class ModelSizes(NamedTuple):
    """Numbers of states n, inputs r and outputs m of a linear model."""

    n: int
    """Number of states."""

    r: int
    """Number of inputs."""

    m: int
    """Number of outputs."""


class ThetaAndLambda(NamedTuple):
    """A number for the parameters θ, and one for the log noise precisions λ."""

    theta: float
    """Of θ."""

    lambda_: float
    """Of λ."""


class Prior(NamedTuple):
    """Gaussian priors of the parameters θ and of the log noise precisions λ."""

    theta_mean: Array
    """(k,) prior mean η^θ."""

    theta_precision: Array
    """(k, k) prior precision P^θ."""

    lambda_mean: Array
    """(g,) prior mean η^λ."""

    lambda_precision: Array
    """(g, g) prior precision P^λ."""

    def squared_errors(self, theta: Array, lambda_: Array) -> ThetaAndLambda:
        """Returns the squared deviations of θ and of λ from their prior means, weighted by the prior precisions.

        Args:
            theta: (k,) parameters θ.
            lambda_: (g,) log noise precisions λ.

        Returns:
            (θ − η^θ)ᵀ P^θ (θ − η^θ), and the same of λ. Half of it is the decrease of the log prior density, nats.
        """
        theta_error = theta - self.theta_mean
        lambda_error = lambda_ - self.lambda_mean
        return ThetaAndLambda(
            theta=float(theta_error @ self.theta_precision @ theta_error),
            lambda_=float(lambda_error @ self.lambda_precision @ lambda_error),
        )


@dataclass(frozen=True, eq=False)
class GenerativeModel:
    """A linear model of signals with their time derivatives (generalized coordinates): sizes, noises and priors.

    The errors are ε̃ = [ỹ − C̃x̃; ṽ − η̃; Dx̃ − Ãx̃ − B̃ṽ], with the precision Π̃ = blockdiag(S⊗Πᶻ, P̃ᵛ, S⊗Πʷ).
    X = [x̃; ṽ] are the hidden generalized states and inputs.
    """

    n: int
    """Number of states."""

    r: int
    """Number of inputs."""

    m: int
    """Number of outputs."""

    p: int
    """Embedding order of the outputs and states."""

    d: int
    """Embedding order of the inputs."""

    q: int
    """Embedding order of the process noise: p, or p − 1 where the highest derivative has no dynamics."""

    output_temporal_precision: Array
    """(p + 1, p + 1) S of the measurement noise z̃: the precision of noise of variance 1 and its derivatives."""

    state_temporal_precision: Array
    """(q + 1, q + 1) S of the process noise w̃."""

    output_groups: Indices
    """(m,) index in λ of each output's measurement noise."""

    state_groups: Indices
    """(n,) index in λ of each state's process noise."""

    input_precision: Array
    """((d + 1)r, (d + 1)r) prior precision P̃ᵛ of the generalized inputs."""

    prior: Prior
    """Priors of θ and λ."""

    state_precision: Array | None = None
    """(n, n) prior precision of x about 0 at every sample, or ``None`` for a flat prior.

    With a flat prior the density of X is improper: F̄ of different n cannot be compared, and where θ leaves the unit of
    x free, F̄ is highest at C = 0.
    """

    @property
    def sizes(self) -> ModelSizes:
        """Numbers of states, inputs and outputs."""
        return ModelSizes(self.n, self.r, self.m)

    @property
    def error_rows(self) -> ErrorRows:
        """Rows of the prediction errors ε̃: of outputs, inputs and states, order after order, then of a prior of x."""
        end_of_outputs = self.m * (self.p + 1)
        end_of_inputs = end_of_outputs + self.r * (self.d + 1)
        end_of_states = end_of_inputs + self.n * (self.q + 1)
        prior_rows = 0 if self.state_precision is None else self.n
        return ErrorRows(
            outputs=slice(0, end_of_outputs),
            inputs=slice(end_of_outputs, end_of_inputs),
            states=slice(end_of_inputs, end_of_states),
            state_prior=slice(end_of_states, end_of_states + prior_rows),
        )

    @property
    def hidden_columns(self) -> slice:
        """Columns of X in the joint vector [ỹ; η̃; X]; the columns of the data come before them."""
        return slice(self.m * (self.p + 1) + self.r * (self.d + 1), None)

    @property
    def joint_size(self) -> int:
        """Length of the joint vector [ỹ; η̃; X]."""
        return self.hidden_columns.start + self.n * (self.p + 1) + self.r * (self.d + 1)

    def error_operator(self, theta: Array) -> Array:
        """Returns the matrix E that maps data and hidden states to the prediction errors, ε̃ = E [ỹ; η̃; X].

        With X = [x̃; ṽ] the errors are ỹ − C̃x̃ of the outputs, ṽ − η̃ of the inputs, Dx̃ − Ãx̃ − B̃ṽ of the states
        and, only where x has a prior, x itself. So the blocks of E are:

            rows        ỹ    η̃    x̃       ṽ
            outputs     I    0    −C̃      0
            inputs      0   −I    0       I
            states      0    0    D − Ã   −B̃
            prior       0    0    [I 0]   0

        Args:
            theta: (k,) parameters [vec(Aᵀ); vec(Bᵀ); vec(Cᵀ)].

        Returns:
            E, (dim ε̃, dim [ỹ; η̃; X]).
        """
        # Only the entries of −C̃, −Ã and −B̃ depend on θ: each of them is minus one parameter.
        structure = self._operator_structure
        operator = structure.constant.copy()
        operator[structure.rows, structure.columns] = -theta[structure.parameters]
        return operator

    @cached_property
    def _operator_structure(self) -> OperatorStructure:
        """The entries of the error operator E that are parameters, in its blocks −C̃, −Ã and −B̃, and its constants.

        They depend only on the sizes and embedding orders, and are computed once. For each θ, :meth:`error_operator`,
        whose documentation shows the blocks of E, then only fills in the parameters.

        First the constant blocks are filled. Then a matrix of the same shape is filled with the number of the parameter
        in each entry, and its nonzero entries are listed.
        """
        n, r, m = self.sizes
        rows = self.error_rows
        # Numbers of entries: of ỹ, of η̃ and ṽ each, and of x̃.
        size_of_y = rows.outputs.stop
        size_of_v = rows.inputs.stop - rows.inputs.start
        size_of_x = n * (self.p + 1)
        y_columns = slice(0, size_of_y)
        eta_columns = slice(y_columns.stop, y_columns.stop + size_of_v)
        x_columns = slice(eta_columns.stop, eta_columns.stop + size_of_x)
        v_columns = slice(x_columns.stop, x_columns.stop + size_of_v)

        # The constants: x − 0, where x has a prior; ỹ of ỹ − C̃ x̃; and ṽ − η̃.
        constant = np.zeros((rows.state_prior.stop, v_columns.stop))
        state_prior_rows = rows.state_prior.stop - rows.state_prior.start
        constant[rows.state_prior, x_columns] = np.eye(state_prior_rows, size_of_x)
        constant[rows.outputs, y_columns] = np.eye(size_of_y)
        constant[rows.inputs, eta_columns] = -np.eye(size_of_v)
        constant[rows.inputs, v_columns] = np.eye(size_of_v)
        # D shifts every order up by one. The derivative of the highest order is not modelled, so the last rows of D are
        # zero or, for q < p, absent.
        state_rows = rows.states.stop - rows.states.start
        constant[rows.states, x_columns] = np.eye(state_rows, size_of_x, k=n)

        # The Kronecker products repeat A, B and C for each order. Parameters are numbered from 1 in them, so that 0
        # marks the entries that are no parameters.
        parameter_count = n * n + n * r + m * n
        A, B, C = unpack(1.0 + np.arange(parameter_count), n, r, m)
        orders_of_y = self.p + 1
        orders_of_v = self.d + 1
        orders_of_w = self.q + 1
        parameter_numbers = np.zeros(constant.shape, int)
        parameter_numbers[rows.outputs, x_columns] = np.kron(np.eye(orders_of_y), C)
        parameter_numbers[rows.states, x_columns] = np.kron(np.eye(orders_of_w, orders_of_y), A)
        parameter_numbers[rows.states, v_columns] = np.kron(np.eye(orders_of_w, orders_of_v), B)
        entry_rows, entry_columns = np.nonzero(parameter_numbers)
        parameters = parameter_numbers[entry_rows, entry_columns] - 1
        return OperatorStructure(constant, entry_rows, entry_columns, parameters)

    @cached_property
    def _regressor_layout(self) -> RegressorLayout:
        """Index arrays: the regressors of each row of [A B] and of C in the joint vector, and its parameters in θ.

        Row i of [A B] is multiplied by the states and inputs [x; v], and in the k-th derivative of the equation by
        their k-th derivatives. So the regressors are columns of the joint vector [ỹ; η̃; X] of data and hidden
        variables, one set for each order of derivatives. X = [x; x′; …; v; v′; …] stacks n states and then r inputs,
        order after order: the states have derivatives up to order p, and the inputs up to order d.

        The regressors of [A B] are needed up to the order q of the states' noise. If d < q, the highest derivatives of
        the inputs are not modelled, and are 0. Their column is ``joint_size``, one after the last: code that uses this
        layout appends a column of zeros to the joint vector.
        """
        n, r, m = self.sizes
        orders_of_x = self.p + 1
        orders_of_w = self.q + 1
        # One row of columns for each order: (p + 1, n) of x, (q + 1, r) of v.
        first_x_column = self.hidden_columns.start
        x_columns = first_x_column + np.arange(orders_of_x * n).reshape(orders_of_x, n)
        first_v_column = first_x_column + orders_of_x * n
        v_columns = first_v_column + np.arange(orders_of_w * r).reshape(orders_of_w, r)
        column_of_zeros = self.joint_size
        v_columns[self.d + 1 :] = column_of_zeros
        # The numbers of the parameters, arranged like A, B and C.
        A, B, C = unpack(np.arange(n * n + n * r + m * n), n, r, m)
        return RegressorLayout(
            state_columns=np.hstack([x_columns[:orders_of_w], v_columns]),
            output_columns=x_columns,
            state_parameters=np.hstack([A, B]),
            output_parameters=C,
        )

    def regressor_moments(self, moments: Array) -> RegressorMoments:
        """Computes the second moments of the regressors, with their orders weighted by the temporal precisions S.

        Row i of [A B] multiplies the regressors [x; v] in the prediction error of state i, and their derivatives in the
        derivatives of that error. So ½ Σ ε̃ᵀ Π̃ ε̃ is quadratic in the row, with the matrix
        e^λ_i Σ_kl S_kl Σ_t [x; v]⁽ᵏ⁾ [x; v]⁽ˡ⁾ᵀ; the sums without e^λ_i are returned. The noises of different channels
        are independent, so that no two rows are coupled. The same holds for C, with the regressors x.

        Args:
            moments: (dim z, dim z) second moments of z = [ỹ; η̃; X], summed over the samples.

        Returns:
            The moments of [x; v], for the rows of [A B], and of x, for the rows of C.
        """
        layout = self._regressor_layout
        # The appended row and column of zeros are the moments of derivatives of the inputs that are not modelled.
        padded_moments = np.pad(moments, (0, 1))
        return RegressorMoments(
            states=_sum_over_orders(
                padded_moments, layout.state_columns, self.state_temporal_precision
            ),
            outputs=_sum_over_orders(
                padded_moments, layout.output_columns, self.output_temporal_precision
            ),
        )

    def error_curvature_in_theta(
        self, noise_precisions: Array, regressors: RegressorMoments
    ) -> Array:
        """Returns the second derivative of ½ Σ ε̃ᵀ Π̃ ε̃ by the parameters θ.

        The prediction error of a state is linear in its row of [A B], with [x; v] as regressors, and the error of an
        output is linear in its row of C, with x. As in any linear regression, the second derivative by a row is the
        second moment of its regressors times the precision of its noise. Different rows are not coupled.

        Args:
            noise_precisions: (g,) precisions e^λ of the noises.
            regressors: second moments of the regressors, weighted over the orders of derivatives.

        Returns:
            The second derivative (k, k).
        """
        layout = self._regressor_layout
        curvature = np.zeros((len(self.prior.theta_mean),) * 2)
        state_precisions = noise_precisions[self.state_groups]
        curvature[_row_block_index(layout.state_parameters)] = (
            state_precisions[:, None, None] * regressors.states
        )
        output_precisions = noise_precisions[self.output_groups]
        curvature[_row_block_index(layout.output_parameters)] = (
            output_precisions[:, None, None] * regressors.outputs
        )
        return curvature

    def error_gradient_in_theta(self, noise_precisions: Array, cross_moments: Array) -> Array:
        """Returns the gradient of −½ Σ ε̃ᵀ Π̃ ε̃ by the parameters θ.

        The errors are ε̃ = E z with z = [ỹ; η̃; X]. An entry of E that is −θ_l, in row i and column a, adds
        (Π̃ Σ ε̃ zᵀ)_ia to the gradient by θ_l. So the gradient by a parameter is a sum over its entries in E.

        Args:
            noise_precisions: (g,) e^λ.
            cross_moments: (dim ε̃, dim z) second moments Σ ε̃ zᵀ, summed over the samples.

        Returns:
            The gradient (k,).
        """
        structure = self._operator_structure
        gradient_in_operator = self.error_precision(noise_precisions) @ cross_moments
        gradient_in_entries = gradient_in_operator[structure.rows, structure.columns]
        return np.asarray(np.bincount(structure.parameters, gradient_in_entries), float)

    def mean_field_curvature_in_states(
        self, noise_precisions: Array, theta_covariance: Array
    ) -> Array:
        """Returns the matrix M with which the uncertainty of θ penalizes large states X of a sample, by −½ Xᵀ M X.

        It is what of the mean-field term W^θ of the free energy depends on X. If row i of [A B] has the
        posterior covariance Σ_i, an error δ ~ N(0, Σ_i) of the row changes the k-th derivative of the prediction error
        of state i by −δᵀ [x; v]⁽ᵏ⁾. The expected weighted squares of the errors therefore grow by the sum over the
        orders k and l of

            e^λ_i S_kl [x; v]⁽ᵏ⁾ᵀ Σ_i [x; v]⁽ˡ⁾

        with the temporal precisions S of the noise. So [A B] adds the Kronecker product S ⊗ W to M, at the columns of
        [x; v] and its derivatives, where W is the sum of e^λ_i Σ_i over the rows. The rows of C, which multiply x
        alone, add theirs likewise.

        Args:
            noise_precisions: (g,) e^λ.
            theta_covariance: (k, k) posterior covariance Σ^θ of all parameters.

        Returns:
            M, (dim X, dim X).
        """
        layout = self._regressor_layout
        # The covariances Σ_i of the parameters of each row, stacked along the first axis. Covariances between rows have
        # no effect, since the noises of different channels are independent.
        state_row_covariances = theta_covariance[_row_block_index(layout.state_parameters)]
        output_row_covariances = theta_covariance[_row_block_index(layout.output_parameters)]
        # W: the sum of these over the rows, weighted by the precision e^λ_i of the row's noise.
        state_weights = np.tensordot(
            noise_precisions[self.state_groups], state_row_covariances, axes=1
        )
        output_weights = np.tensordot(
            noise_precisions[self.output_groups], output_row_covariances, axes=1
        )
        # Inputs may have fewer derivatives than states. In the layout, all derivatives that they lack are assigned to
        # one column after the last. So the matrix has an additional row and column, which are cut off at the end.
        curvature = np.zeros((self.joint_size + 1, self.joint_size + 1))
        columns = layout.state_columns.ravel()
        curvature[np.ix_(columns, columns)] = np.kron(self.state_temporal_precision, state_weights)
        columns = layout.output_columns.ravel()
        curvature[np.ix_(columns, columns)] += np.kron(
            self.output_temporal_precision, output_weights
        )
        hidden = slice(self.hidden_columns.start, self.joint_size)
        return curvature[hidden, hidden]

    def mean_field_squared_errors(
        self, regressors: RegressorMoments, theta_covariance: Array
    ) -> Array:
        """Returns the squared prediction errors that are expected from the uncertainty of the parameters θ alone.

        The M step learns the noise precisions e^λ from the expected squared errors. These exceed the squared errors at
        the mean of θ: if row i of [A B] has the covariance Σ_i, an error δ ~ N(0, Σ_i) of the row changes the
        prediction error of state i by −δᵀ [x; v]. Its expected square, summed over samples and orders, is tr(Σ_i R),
        where R are the second moments of the regressors [x; v]. The same holds for each row of C, whose regressors are
        x.

        Args:
            regressors: second moments R of the regressors, weighted over the orders by the temporal precisions S.
            theta_covariance: (k, k) covariance Σ^θ.

        Returns:
            Expected squared errors (g,), summed over the channels of each noise, in the order of λ. They are not yet
            multiplied by e^λ.
        """
        layout = self._regressor_layout
        # Covariances Σ_i of the n rows of [A B] (n, n + r, n + r), and of the m rows of C (m, n, n).
        state_covariances = theta_covariance[_row_block_index(layout.state_parameters)]
        output_covariances = theta_covariance[_row_block_index(layout.output_parameters)]
        # The sum of the elementwise product of two symmetric matrices is the trace of their product, tr(Σ_i R).
        squares_of_states = np.sum(state_covariances * regressors.states, axis=(1, 2))
        squares_of_outputs = np.sum(output_covariances * regressors.outputs, axis=(1, 2))
        squares_of_channels = np.concatenate([squares_of_states, squares_of_outputs])
        # Channels that share a noise are added up.
        noise_of_channel = np.concatenate([self.state_groups, self.output_groups])
        return np.asarray(np.bincount(noise_of_channel, squares_of_channels), float)

    def error_precision(self, noise_precisions: Array) -> Array:
        """Returns the precision Π̃ = blockdiag(S⊗Πᶻ, P̃ᵛ, S⊗Πʷ) of the prediction errors ε̃ of outputs, inputs and states.

        Πᶻ and Πʷ are the precisions of measurement and process noise, S the precision of smooth noise of variance 1 and
        its derivatives, and P̃ᵛ the prior precision of the inputs.

        Args:
            noise_precisions: (g,) e^λ, which are the diagonals of Πᶻ and Πʷ.

        Returns:
            Π̃, (dim ε̃, dim ε̃); where x has a prior, its precision is the last block.
        """
        precision_at_zero, noise_of_error = self._precision_structure
        # As Πᶻ and Πʷ are diagonal, the column of each error is multiplied by the precision e^λ of its noise. Errors of
        # the inputs and of the prior of x have no such noise: their index is −1, which selects the 1 that is appended
        # at the end.
        column_scales = np.append(noise_precisions, 1.0)[noise_of_error]
        return precision_at_zero * column_scales

    @cached_property
    def _precision_structure(self) -> PrecisionStructure:
        """The precision Π̃ at λ = 0, and for each of its columns the index of the entry of λ that scales it.

        At λ = 0 all noises have variance 1. The blocks S⊗I of outputs and states then have only the temporal precision
        S of smooth noise and its derivatives; the blocks of the inputs and of a prior of x do not depend on λ.
        :meth:`error_precision` computes Π̃ at any λ from these two.
        """
        # The rows of the prediction errors of outputs, inputs, states and the prior of x, which come in this order.
        rows = self.error_rows
        error_count = rows.state_prior.stop
        precision = np.zeros((error_count, error_count))
        precision[rows.outputs, rows.outputs] = np.kron(
            self.output_temporal_precision, np.eye(self.m)
        )
        precision[rows.inputs, rows.inputs] = self.input_precision
        precision[rows.states, rows.states] = np.kron(self.state_temporal_precision, np.eye(self.n))
        if self.state_precision is not None:
            precision[rows.state_prior, rows.state_prior] = self.state_precision
        # Each derivative of an error has the noise of the error itself. The index −1 stands for no noise.
        noise_of_error = np.full(error_count, -1)
        noise_of_error[rows.outputs] = np.tile(self.output_groups, self.p + 1)
        noise_of_error[rows.states] = np.tile(self.state_groups, self.q + 1)
        return PrecisionStructure(precision, noise_of_error)

    @property
    def noise_of_error(self) -> Indices:
        """Index in λ of the noise of each prediction error, (dim ε̃,); −1 for errors whose precision λ leaves alone."""
        return self._precision_structure.noise_of_error

    def log_det_error_precision(self, lambda_: Array) -> float:
        """Returns ln|Π̃| for log noise precisions λ (g,)."""
        return float(self._log_det_at_zero + self.log_det_gradient @ lambda_)

    @cached_property
    def log_det_gradient(self) -> Array:
        """∂ ln|Π̃| / ∂λ, (g,): the number of errors that each noise precision scales, since ln|Π̃| is linear in λ."""
        noise_of_error = self._precision_structure.noise_of_error
        is_scaled = noise_of_error >= 0
        return np.bincount(noise_of_error[is_scaled]).astype(float)

    @cached_property
    def _log_det_at_zero(self) -> float:
        """ln|Π̃| at λ = 0."""
        return np.linalg.slogdet(self._precision_structure.precision_at_zero).logabsdet

    @cached_property
    def log_det_prior_precisions(self) -> ThetaAndLambda:
        """ln|P^θ| and ln|P^λ|."""
        return ThetaAndLambda(
            theta=logdet(self.prior.theta_precision), lambda_=logdet(self.prior.lambda_precision)
        )

    def squared_errors_by_noise(self, error_moments: Array) -> Array:
        """Returns the sums of squared prediction errors, one for each noise, that F̄ weights by the noise precisions.

        The log likelihood has the term −½ Σ_g exp(λ_g) c_g. Its coefficients c_g = Σ ε̃ᵀ (S⊗Ω_g) ε̃ are returned: sums
        over the samples, with the precision S of smooth noise and its derivatives (``output_temporal_precision`` or
        ``state_temporal_precision``). Ω_g is diagonal, 1 for the channels that have noise g and 0 for others.

        Args:
            error_moments: (dim ε̃, dim ε̃) second moments Σ ε̃ε̃ᵀ of the errors, summed over the samples.

        Returns:
            The sums c (g,), in the order of λ.
        """
        precision_at_zero, noise_of_error = self._precision_structure
        # At λ = 0 each noise has the precision 1, so that the precision Π̃ of the errors consists of the blocks S⊗Ω_g.
        # Σ ε̃ᵀ Π̃ ε̃ is the sum over the elementwise product of Π̃, which is symmetric, and Σ ε̃ε̃ᵀ. Each column
        # belongs to one error, so the sums of the columns are added up by the noise of that error. Errors of the inputs
        # and of the prior of x belong to no noise (index −1) and are left out.
        squares_by_error = (precision_at_zero * error_moments).sum(axis=0)
        is_scaled = noise_of_error >= 0
        squares = np.bincount(noise_of_error[is_scaled], squares_by_error[is_scaled])
        return np.asarray(squares, float)


def _sum_over_orders(moments: Array, columns: Indices, temporal_precision: Array) -> Array:
    """Sums the second moments of generalized signals over their orders, weighted by the temporal precision.

    Args:
        moments: (N, N) second moments of a vector that contains the signals.
        columns: (K, s) indices in that vector of s signals, by order.
        temporal_precision: (K, K) weights S_kl of the orders k and l.

    Returns:
        (s, s): Σ_kl S_kl times the moments of the k-th with the l-th derivatives.
    """
    orders, signals = columns.shape
    indices = columns.ravel()
    by_order = moments[np.ix_(indices, indices)].reshape(orders, signals, orders, signals)
    # Letters of einsum: orders k and l, signals i and j.
    return np.einsum("kl,kilj->ij", temporal_precision, by_order)


def _row_block_index(parameters: Indices) -> tuple[Indices, Indices]:
    """Returns the index that selects, from a (k, k) matrix over all parameters θ, one square block for each model row.

    A model row is a row of [A B] or of C, with its s parameters. Its block has the entries of these parameters with
    each other, such as their covariances. Entries of parameters of different rows are not selected: rows are
    independent in the model.

    Args:
        parameters: (rows, s) indices in θ of the s parameters of each row.

    Returns:
        Index arrays (rows, s, 1) and (rows, 1, s), by which ``matrix[_row_block_index(parameters)]`` is (rows, s, s).
    """
    return parameters[:, :, None], parameters[:, None, :]
