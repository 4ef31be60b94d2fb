"""Kalman filters and fixed-interval smoothers of linear-Gaussian state-space models, in steady state and before it.

A system is x⁺ = A x + g + w, y = C x + v, where g is a known forcing term, such as B u, and the noises have the
covariances Q = E wwᵀ, R = E vvᵀ and S = E wvᵀ. x̂ is the state predicted from all earlier samples, P its covariance, and

    K = (A P Cᵀ + S) F⁻¹,   F = C P Cᵀ + R,   x̂⁺ = A x̂ + g + K (y − C x̂)

is the filter in prediction form (Anderson and Moore, Optimal Filtering, 1979, sec. 5.4). Of a time-invariant system the
gain K becomes steady; the filter is then a linear recursion with constant coefficients, which is vectorized over time.

The smoothers are disturbance smoothers: the smoothed state is x̂ₜ + P rₜ₋₁ with rₜ₋₁ = Cᵀ F⁻¹ eₜ + Lᵀ rₜ, the
innovations e and L = A − K C (Durbin and Koopman, Time Series Analysis by State Space Methods, 2nd ed., sec. 4.4). They
give the same result as the RTS smoother, without inverting a covariance of states, which may be singular.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.linalg import LinAlgError

from mavdem.arrays import Array, Indices
from mavdem.dem.engine.linalg import may_overflow
from mavdem.dem.engine.model import linear_recursion

STEADY_CHANGE = 1e-11
"""Change of a covariance in one step, relative to its largest entry, below which it counts as steady.

A choice: well above rounding, and far below what a gain needs.
"""

MAX_DOUBLINGS = 60
"""Largest number of doublings in the search for a steady covariance.

A covariance that still changes after 2⁶⁰ samples grows without bound.
"""


class SteadyState(NamedTuple):
    """The steady state of the Kalman filter x̂⁺ = A x̂ + K (y − C x̂); leading axes are several systems."""

    gain: Array
    """(…, n, m) gain K."""

    covariance: Array
    """(…, n, n) covariance P of the predicted state."""


def steady_state_gain(
    A: Array,
    C: Array,
    Q: Array,
    R: Array,
    S: Array | None = None,
) -> SteadyState:
    """Computes the gain of the steady-state Kalman filter, by solving the discrete algebraic Riccati equation.

    The structure-preserving doubling algorithm is used, whose iteration k computes the covariance after 2ᵏ samples (E.
    K.-W. Chu, H.-Y. Fan, W.-W. Lin and C.-S. Wang, "Structure-preserving algorithms for periodic discrete-time
    algebraic Riccati equations", International Journal of Control 77, 2004). Leading axes are several systems, which
    are solved together.

    Args:
        A: (…, n, n) state transition matrix.
        C: (…, m, n) output matrix.
        Q: (…, n, n) covariance of the process noise.
        R: (…, m, m) covariance of the measurement noise, positive definite.
        S: (…, n, m) covariance between process and measurement noise; None if it is zero.

    Returns:
        The gain K and the covariance of the state before the measurement of each system.

    Raises:
        numpy.linalg.LinAlgError: a system has no steady filter for which A − K C is stable.
    """
    n = A.shape[-1]
    identity = np.eye(n)
    if S is None:
        S = np.zeros((n, C.shape[-2]))
    # The process noise is the sum of S R⁻¹ v, where v is the measurement noise, and a noise that is independent of v.
    # The first of these is included in the transition matrix. That is transposed, since the algorithm is written for
    # the dual control problem.
    R_inverse_C = np.linalg.solve(R, C)
    transition = (A - S @ R_inverse_C).mT
    information = C.mT @ R_inverse_C
    P = (Q + Q.mT) / 2 - S @ np.linalg.solve(R, S.mT)
    # If there is no steady filter the covariance overflows, and the error below is raised.
    with np.errstate(all="ignore"):
        for _ in range(MAX_DOUBLINGS):
            # (I + information · P)⁻¹ times the transition, and times the information.
            riccati_step = np.linalg.solve(
                identity + information @ P, np.concatenate([transition, information], axis=-1)
            )
            increase = transition.mT @ P @ riccati_step[..., :n]
            information = information + transition @ riccati_step[..., n:] @ transition.mT
            transition = transition @ riccati_step[..., :n]
            P = P + increase
            largest_change = abs(increase).max(axis=(-1, -2))
            largest_entry = abs(P).max(axis=(-1, -2))
            if np.all(np.divide(largest_change, largest_entry) <= STEADY_CHANGE):
                cross_covariance = A @ P @ C.mT + S
                gain = cross_covariance @ np.linalg.inv(C @ P @ C.mT + R)
                return SteadyState(gain, P)
    raise LinAlgError("there is no steady filter: an unstable state may not be observable")


class SmoothedSignal(NamedTuple):
    """A scalar signal h · x of the state, smoothed over a segment of T samples."""

    mean: Array
    """(T,) mean, given all samples of the segment."""

    states: Array
    """(T, n) state of the filter: predicted from the samples before each one."""


class SteadyStateFilter(NamedTuple):
    """The steady-state Kalman filter of a system whose first state is measured with white noise: y = x₁ + v.

    It is exact for an initial state that is as uncertain as all later ones.
    """

    P: Array
    """(n, n) covariance of the predicted state."""

    K: Array
    """(n,) gain."""

    F: float
    """Variance of the innovations."""

    L: Array
    """(n, n) transition matrix A − K C of the filter."""

    @classmethod
    def design(cls, A: Array, process_covariance: Array, noise_sd: float) -> SteadyStateFilter:
        """Computes the steady-state filter of a system whose first state is measured, C = [1 0 … 0].

        Args:
            A: (n, n) state transition matrix.
            process_covariance: (n, n) covariance of the process noise.
            noise_sd: standard deviation of the measurement noise, in the unit of the first state.

        Returns:
            The filter, with its gain and the covariance of the predicted state.

        Raises:
            numpy.linalg.LinAlgError: the system has no steady-state filter.
        """
        C = np.eye(1, len(A))
        K, P = steady_state_gain(A, C, process_covariance, np.array([[noise_sd**2]]))
        return cls(P=P, K=K[:, 0], F=P[0, 0] + noise_sd**2, L=A - K @ C)

    @may_overflow
    def smooth(
        self,
        forcing: Array,
        measurements: Array,
        initial_state: Array,
        signal: Array,
    ) -> SmoothedSignal:
        """Smooths a signal h · x over one segment: by the filter forward, and a disturbance smoother backward in time.

        Args:
            forcing: (T − 1, n) known terms g that are added to the next state at each sample except the last.
            measurements: (T,) measurements of the first state.
            initial_state: (n,) mean of the state at the first sample.
            signal: (n,) weights h of the states in the signal.

        Returns:
            Mean of the signal at each sample (T,), given all samples, and the predicted states of the filter (T, n).
        """
        filter_forcing = forcing + measurements[:-1, None] * self.K
        predicted_states = np.vstack(
            [initial_state, linear_recursion(self.L, filter_forcing, initial_state)]
        )
        # Backward in time: rₜ₋₁ = Cᵀ eₜ / F + Lᵀ rₜ.
        backward_forcing = np.zeros_like(predicted_states)
        backward_forcing[:, 0] = (measurements - predicted_states[:, 0])[::-1] / self.F
        backward_states = linear_recursion(self.L.T, backward_forcing[1:], backward_forcing[0])
        r = np.vstack([backward_forcing[0], backward_states])[::-1]
        P_h = self.P @ signal
        return SmoothedSignal(mean=predicted_states @ signal + r @ P_h, states=predicted_states)

    @may_overflow
    def smoothed_variance(self, samples: int, signal: Array) -> Array:
        """Returns the variance of a smoothed signal at each sample of a segment, which does not depend on the data.

        Args:
            samples: number T of samples of the segment.
            signal: (n,) weights h of the states in the signal.

        Returns:
            (T,) variances.
        """
        # Before the sample's own innovation and the later ones are known, the variance of the signal is h · P h. Each
        # of these innovations reduces it by the square of their covariance, over the variance F of the innovation. The
        # covariance with the innovation k samples later is the first entry of Lᵏ P h.
        P_h = self.P @ signal
        no_forcing = np.zeros((samples - 1, len(signal)))
        later_covariances = linear_recursion(self.L, no_forcing, P_h)[:, 0]
        innovation_covariances = np.append(P_h[0], later_covariances)
        # Reduction by the first 1, 2, …, T innovations. The last sample of the segment has only its own innovation, and
        # the first sample has all T.
        variance_reductions = np.cumsum(innovation_covariances**2) / self.F
        return np.asarray(signal @ P_h - variance_reductions[::-1])


class FilteredSegments(NamedTuple):
    """What a Kalman filter makes of segments of T samples each; leading axes are segments side by side."""

    states: Array
    """(…, T + 1, n) predicted states, before each sample and after the last."""

    innovations: Array
    """(…, T, m) innovations."""


class SmoothingResult(NamedTuple):
    """Smoothed states of a segment of T samples, and of the sample after it, given all measurements."""

    means: Array
    """(…, T + 1, n) means; leading axes are segments side by side."""

    covariances: Array
    """(T + 1, n, n) covariances, the same for all segments."""

    lag_one_covariances: Array
    """(T, n, n) covariances of each state after the first with the state one sample earlier."""


class KalmanFilter(NamedTuple):
    """The time-varying Kalman filter x̂⁺ = A x̂ + g + K (y − C x̂), from an uncertain initial state to the steady filter.

    h is the number of samples after which it is steady, or for which it was computed; the last gain, covariance and
    innovation precision hold for all later samples. Gains do not depend on the measurements.
    """

    A: Array
    """(n, n) state transition matrix."""

    C: Array
    """(m, n) output matrix."""

    covariances: Array
    """(h + 1, n, n) covariance P of the predicted state, before each sample and after the last."""

    gains: Array
    """(h, n, m) gain K at each sample."""

    innovation_precisions: Array
    """(h, m, m) inverse F⁻¹ of the covariance of each sample's innovation."""

    @classmethod
    def design(
        cls,
        A: Array,
        C: Array,
        Q: Array,
        R: Array,
        S: Array,
        initial_covariance: Array,
        samples: int,
    ) -> KalmanFilter:
        """Computes the gains and covariances of the filter.

        Args:
            A: (n, n) state transition matrix.
            C: (m, n) output matrix.
            Q: (n, n) covariance of the process noise.
            R: (m, m) covariance of the measurement noise.
            S: (n, m) covariance between process and measurement noise.
            initial_covariance: (n, n) covariance of the state at the first sample.
            samples: number of samples to which the filter will be applied; it may become steady earlier.

        Returns:
            The filter, with gains up to the sample at which its covariance is steady.
        """
        covariances = [initial_covariance]
        gains = []
        innovation_precisions = []
        # The covariance of an unstable system may overflow; its forecasts are then not finite.
        with np.errstate(all="ignore"):
            for _ in range(max(samples, 1)):
                P = covariances[-1]
                try:
                    F_inverse = np.linalg.inv(C @ P @ C.T + R)
                except LinAlgError:
                    # The covariance has overflowed.
                    F_inverse = np.full_like(R, np.nan)
                K = (A @ P @ C.T + S) @ F_inverse
                innovation_precisions.append(F_inverse)
                gains.append(K)
                # Joseph's form keeps the covariance positive semidefinite. The symmetric part of 2 S Kᵀ, which is taken
                # below, is S Kᵀ + K Sᵀ.
                L = A - K @ C
                next_P = L @ P @ L.T + Q + (K @ R - 2 * S) @ K.T
                covariances.append((next_P + next_P.T) / 2)
                if abs(covariances[-1] - P).max() <= STEADY_CHANGE * abs(P).max():
                    break
        return cls(
            A,
            C=C,
            covariances=np.array(covariances),
            gains=np.array(gains),
            innovation_precisions=np.array(innovation_precisions),
        )

    def predicted_covariances(self, samples: int) -> Array:
        """Returns the covariances of the predicted state before each sample and after the last, (samples + 1, n, n)."""
        rows = np.minimum(np.arange(samples + 1), len(self.covariances) - 1)
        return self.covariances[rows]

    def gain_rows(self, samples: int) -> Indices:
        """Returns the row of ``gains`` that holds at each sample, (samples,): the last one once they are steady."""
        return np.minimum(np.arange(samples), len(self.gains) - 1)

    @may_overflow
    def filter(self, initial_state: Array, forcing: Array, measurements: Array) -> FilteredSegments:
        """Runs the filter over segments of T samples each.

        Args:
            initial_state: (…, n) mean of the state at the first sample; leading axes are independent segments.
            forcing: (…, T, n) known terms g that are added to the next state.
            measurements: (…, T, m) measured outputs y.

        Returns:
            Predicted states (…, T + 1, n), the last one after the last sample, and innovations (…, T, m).
        """
        sample_count = measurements.shape[-2]
        # Index in ``gains`` of the gain of each sample: once the filter is steady, all later samples have the last one.
        gain_of_sample = self.gain_rows(sample_count)
        states = np.empty((*measurements.shape[:-2], sample_count + 1, len(self.A)))
        states[..., 0, :] = initial_state
        # With L = A − K C the filter is x̂⁺ = L x̂ + g + K y. Each gain has its own L. States are rows here, so that L is
        # transposed.
        L_transposed = (self.A - self.gains @ self.C).mT
        # Letters of einsum: sample t, output m, state n.
        driving_terms = forcing + np.einsum(
            "...tm,tnm->...tn", measurements, self.gains[gain_of_sample]
        )
        for t, gain_index in enumerate(gain_of_sample):
            states[..., t + 1, :] = (
                states[..., t, :] @ L_transposed[gain_index] + driving_terms[..., t, :]
            )
        innovations = measurements - states[..., :-1, :] @ self.C.T
        return FilteredSegments(states, innovations)

    def smooth(self, states: Array, innovations: Array) -> SmoothingResult:
        """Smooths the states over each segment, by the disturbance smoother.

        Means are x̂ₜ + Pₜ rₜ₋₁ and covariances Pₜ − Pₜ Nₜ₋₁ Pₜ, with Nₜ₋₁ = Cᵀ F⁻¹ C + Lᵀ Nₜ L (P. de Jong, "Smoothing
        and interpolation with the state-space model", Journal of the American Statistical Association 84(408), 1989).

        Args:
            states: (…, T + 1, n) predicted states, as :meth:`filter` returns them.
            innovations: (…, T, m) innovations, as :meth:`filter` returns them.

        Returns:
            Means (…, T + 1, n), covariances (T + 1, n, n) and lag-one covariances (T, n, n) of the states, given all
            measurements of the segment.
        """
        samples = innovations.shape[-2]
        rows = self.gain_rows(samples)
        L = self.A - self.gains @ self.C
        F_inverse_C = self.innovation_precisions @ self.C
        N = self._smoothing_precisions(L, F_inverse_C, samples)
        # r is computed backward in time, from 0 after the last sample. Letters of einsum: sample t, output m, state n.
        r = np.zeros_like(states)
        r[..., :-1, :] = np.einsum("...tm,tmn->...tn", innovations, F_inverse_C[rows])
        for t in range(samples - 1, -1, -1):
            r[..., t, :] += r[..., t + 1, :] @ L[rows[t]]
        P = self.predicted_covariances(samples)
        # The smoothed means are x̂ + P r at each sample t.
        return SmoothingResult(
            means=states + np.einsum("...ti,tij->...tj", r, P),
            covariances=P - P @ N @ P,
            lag_one_covariances=(np.eye(len(self.A)) - P[1:] @ N[1:]) @ L[rows] @ P[:-1],
        )

    def _smoothing_precisions(self, L: Array, F_inverse_C: Array, samples: int) -> Array:
        """Returns N of the disturbance smoother, by which later samples reduce the covariance of the predicted state.

        N is computed backward in time, from 0 after the last sample. Where the gain is steady N becomes steady too, as
        P does (``STEADY_CHANGE``), and is then filled in.

        Args:
            L: (h, n, n) transition matrices A − K C of the filter.
            F_inverse_C: (h, m, n) products F⁻¹ C.
            samples: number T of samples of the segment.

        Returns:
            N (T + 1, n, n), of which the first T reduce the covariance before each sample.
        """
        information = self.C.T @ F_inverse_C
        rows = self.gain_rows(samples)
        first_steady = len(self.gains) - 1
        N = np.zeros((samples + 1, *self.A.shape))
        t = samples - 1
        while t >= 0:
            row = rows[t]
            N[t] = information[row] + L[row].T @ N[t + 1] @ L[row]
            is_steady = abs(N[t] - N[t + 1]).max() <= STEADY_CHANGE * abs(N[t]).max()
            if is_steady and t > first_steady:
                N[first_steady:t] = N[t]
                t = first_steady
            t -= 1
        return N


class LinearGaussianModel(NamedTuple):
    """The linear-Gaussian model x⁺ = A x + B u + offset + w, y = C x + trim + v.

    The noises w ~ N(0, Q) and v ~ N(0, R) are white and independent.
    """

    A: Array
    """(n, n) state transition matrix."""

    B: Array
    """(n, k) input matrix."""

    offset: Array
    """(n,) constant that is added to the state at each step."""

    C: Array
    """(m, n) output matrix."""

    trim: Array
    """(m,) outputs at state 0."""

    Q: Array
    """(n, n) covariance of the process noise."""

    R: Array
    """(m, m) covariance of the measurement noise."""


class SmoothedStates(NamedTuple):
    """Smoothed states of a segment of T samples, given all of its outputs, and the likelihood of these."""

    means: Array
    """(T, n) means."""

    covariances: Array
    """(T, n, n) covariances."""

    lag_one_covariances: Array
    """(T − 1, n, n) covariances of each state after the first with the state one sample earlier."""

    log_likelihood: float
    """Log likelihood of the outputs."""


def smooth_states(
    model: LinearGaussianModel,
    initial_state: Array,
    inputs: Array,
    outputs: Array,
) -> SmoothedStates:
    """Smooths the states of one segment, and computes the likelihood of its outputs: the E step of the EM algorithm.

    Args:
        model: the model.
        initial_state: (n,) mean of the state at the first sample, whose covariance is the identity.
        inputs: (T, k) inputs u.
        outputs: (T, m) outputs y.

    Returns:
        The states given all outputs, and the log likelihood of the outputs.

    Raises:
        numpy.linalg.LinAlgError: a covariance overflows.
    """
    n = len(model.A)
    kalman_filter = KalmanFilter.design(
        model.A,
        model.C,
        model.Q,
        model.R,
        S=np.zeros((n, len(model.C))),
        initial_covariance=np.eye(n),
        samples=len(outputs),
    )
    if not np.isfinite(kalman_filter.covariances).all():
        raise LinAlgError("the filter's covariance overflows")
    forcing = inputs @ model.B.T + model.offset
    states, innovations = kalman_filter.filter(initial_state, forcing, outputs - model.trim)
    # The likelihood of the outputs is the likelihood of the innovations, which are independent Gaussians.
    precisions = kalman_filter.innovation_precisions[kalman_filter.gain_rows(len(innovations))]
    # The sum of eᵀ F⁻¹ e over the samples t.
    squares = np.einsum("ti,tij,tj->", innovations, precisions, innovations)
    log_likelihood = 0.5 * (
        np.linalg.slogdet(precisions)[1].sum() - squares - innovations.size * np.log(2 * np.pi)
    )
    smoothed_states = kalman_filter.smooth(states, innovations)
    # The filter also predicts the sample after the segment, which is not part of the result.
    return SmoothedStates(
        smoothed_states.means[:-1],
        smoothed_states.covariances[:-1],
        smoothed_states.lag_one_covariances[:-1],
        log_likelihood,
    )
