"""Discrete-time state-space model of one axis with coloured wind torque, for smoothing and for simulation.

In continuous time, with the body rate p, the motors' torque T and the wind torque w per moment of inertia (rad/s²):

    dp/dt = −d p + T + c + w            d rate damping, 1/s; c constant torque
    dT/dt = (b u(t − θ) − T) / τ        b effect, θ delay, τ motor time constant

The wind torque is a sum of stationary coloured noises, each with its own state-space form.
"""

from collections.abc import Sequence
from math import factorial
from typing import NamedTuple

import numpy as np
import scipy

from mavdem.arrays import Array, ArrayPair
from mavdem.dem.engine.kalman import SmoothedSignal, SteadyStateFilter
from mavdem.dem.engine.model import Transition, discretize


class ColouredNoise(NamedTuple):
    """Stationary noise of variance 1 in state-space form, dx/dt = A x + white noise, y = C x; time in its own unit."""

    A: Array
    """System matrix (k, k)."""

    Q: Array
    """Intensity of the white noise (k, k)."""

    C: Array
    """Output row (k,)."""

    inverse_density: Array
    """Coefficients of 1 / spectral density, as a polynomial in −ω², highest power first."""

    def density(self, omega: Array, sd: Array | float, time: Array | float) -> Array:
        """Returns the two-sided spectral density of the scaled noise.

        Args:
            omega: (…) angular frequencies, rad/s.
            sd: standard deviation of the noise, in its unit; an array (…) broadcasts with ``omega``.
            time: time scale of the noise, s; an array (…) broadcasts with ``omega``.

        Returns:
            (…) densities, unit² per Hz, in the common shape of the arguments.
        """
        return np.asarray(sd**2 * time / np.polyval(self.inverse_density, -((omega * time) ** 2)))


class WindComponent(NamedTuple):
    """One component of the wind torque."""

    colour: ColouredNoise
    """Spectrum of the component, up to scale."""

    size: float
    """Standard deviation of the component, as angular acceleration (torque per moment of inertia), rad/s²."""

    time: float
    """Time scale of the component, s."""


def process_covariance(A: Array, Q: Array, dt: float) -> Array:
    """Returns the covariance that white noise of intensity Q adds to the states of dx/dt = A x within a time step.

    It is computed by the matrix exponential of a block matrix (C. F. Van Loan, "Computing integrals involving the
    matrix exponential", IEEE Transactions on Automatic Control 23(3), 1978).

    Args:
        A: (…, n, n) system matrices, 1/s.
        Q: (…, n, n) intensities of the white noise.
        dt: time step, s.

    Returns:
        (…, n, n) covariances.
    """
    n = A.shape[-1]
    block_matrix = np.block([[-A, Q], [np.zeros_like(A), A.mT]])
    # The exponential is [[exp(−A dt), G], [0, exp(Aᵀ dt)]], and the covariance is exp(A dt) G.
    exponential = scipy.linalg.expm(block_matrix * dt)
    transition = exponential[..., n:, n:].mT
    G = exponential[..., :n, n:]
    return transition @ G


def _autoregressive_noise(denominator: Array) -> ColouredNoise:
    """Returns noise of variance 1: white noise that is filtered by an all-pole filter.

    With the denominator D of the filter, the noise x follows D(d/dt) x = white noise. The states are x and its
    derivatives. Their stationary covariance P solves the Lyapunov equation A P + P Aᵀ = −Q. Each state is divided by
    its standard deviation, so that all have variance 1.

    Args:
        denominator: coefficients (k + 1,) of the filter's denominator in s, highest power first, which is 1.

    Returns:
        The noise in companion form, with states scaled to variance 1.
    """
    order = len(denominator) - 1
    # Each state is the derivative of the one before; the last row has the coefficients, lowest power first.
    A = np.eye(order, k=1)
    A[-1] = -denominator[:0:-1]
    Q = np.zeros((order, order))
    Q[-1, -1] = 1.0
    # The Lyapunov equation as linear equations for the entries of P, row by row.
    identity = np.eye(order)
    equations = np.kron(A, identity) + np.kron(identity, A)
    covariance = np.linalg.solve(equations, -Q.ravel()).reshape(order, order)
    state_sd = np.sqrt(covariance.diagonal())
    Q[-1, -1] /= state_sd[-1] ** 2
    # |D(jω)|² is D(s) D(−s), of which only even powers of s remain.
    mirrored_denominator = denominator * (-1.0) ** np.arange(order, -1, -1)
    inverse_density = state_sd[0] ** 2 * np.polymul(denominator, mirrored_denominator)[::2]
    return ColouredNoise(A * state_sd / state_sd[:, None], Q, np.eye(order)[0], inverse_density)


def gaussian_kernel_noise(order: int) -> ColouredNoise:
    """Returns noise with nearly the Gaussian autocorrelation exp(−τ²/4), whose spectrum is proportional to exp(−ω²).

    The spectrum is approximated by 1 / (Taylor series of exp(ω²)), and the filter has the stable half of its poles
    (J. Hartikainen and S. Särkkä, "Kalman filtering and smoothing solutions to temporal Gaussian process regression
    models", MLSP 2010, sec. 3.3).

    Args:
        order: number of states, and order of the series in ω².

    Returns:
        The noise, of variance 1.
    """
    series = np.zeros(2 * order + 1)
    # With ω² = −s², the series of exp(ω²) has the coefficients (−1)^i / i! of s^(2i), here the highest power first.
    series[::2] = [(-1) ** power / factorial(power) for power in range(order, -1, -1)]
    roots = np.roots(series)
    stable = roots[roots.real < 0]
    return _autoregressive_noise(np.real(np.poly(stable)))


FIRST_ORDER = _autoregressive_noise(np.ones(2))
"""Noise with the autocorrelation exp(−|τ|), like turbulence along its mean wind (Dryden)."""

GAUSSIAN_KERNEL = gaussian_kernel_noise(4)
"""Noise with nearly the autocorrelation exp(−τ²/4), as the noise of generalized coordinates has (Eq. ``Smatrix``).

Four states are enough where the spectrum has power.
"""


def with_advanced_jumps(inputs: Array, jump_advance: float) -> Array:
    """Changes sampled inputs so that their jumps act earlier by a fraction of a sampling step.

    An input may jump somewhere between two samples. Linear interpolation turns the jump into a ramp, which acts as if
    the jump were in the middle of the step. A jump of size j that comes earlier by a fraction a of a step of length dt
    adds a · j · dt to the integral of the input. The same is added by raising the sample at the end of the step by
    a · j, since the interpolation of one raised sample is a triangle two steps wide.

    A steady ramp has no jumps. So the jump at a step is the part of its change that exceeds the change at the step
    before, or all of its change if the direction reverses.

    Args:
        inputs: W windows of r inputs (W, N, r).
        jump_advance: time by which each jump comes before the middle of its step, as a fraction of the step.

    Returns:
        Changed inputs (W, N, r).
    """
    changes = np.diff(inputs, axis=1, prepend=inputs[:, :1])
    previous = np.concatenate([np.zeros_like(changes[:, :1]), changes[:, :-1]], axis=1)
    # The part of a change that is no larger than the previous change, and in its direction, continues a ramp.
    lower = np.minimum(changes, 0.0)
    upper = np.maximum(changes, 0.0)
    jumps = changes - np.clip(previous, lower, upper)
    return inputs + jump_advance * jumps


def delayed_inputs(inputs: Array, delay_steps: float) -> ArrayPair:
    """Returns delayed inputs at the beginning and at the end of each step, interpolated linearly.

    Args:
        inputs: samples (T, r).
        delay_steps: delay in steps; a negative one is treated as 0. Before the first sample, the inputs are constant.

    Returns:
        Two arrays (T − 1, r): delayed inputs at the beginning, and at the end, of each step.
    """
    delay = max(0.0, delay_steps)
    whole_steps = int(min(delay, len(inputs)))
    fraction = min(delay - whole_steps, 1.0)
    # Row i + 1 of the padded inputs is the input ``whole_steps`` before sample i, and row i the one a step earlier.
    padded_inputs = np.concatenate([np.repeat(inputs[:1], whole_steps + 1, axis=0), inputs])
    padded_inputs = padded_inputs[: len(inputs) + 1]
    interpolated_inputs = (1 - fraction) * padded_inputs[1:] + fraction * padded_inputs[:-1]
    return interpolated_inputs[:-1], interpolated_inputs[1:]


class SampledPlant(NamedTuple):
    """The sampled axis: x⁺ = Φ x + Γ₀ c + Γ₁ c⁺ + noise, with commanded torque c at a sample and c⁺ at the next.

    The n states are the rate (rad/s), the motors' torque (rad/s²), and the states of the wind torque's components.
    """

    transition: Transition
    """Φ, Γ₀ and Γ₁, with one input: the commanded torque, rad/s²."""

    Q: Array
    """Covariance of the noise in one step (n, n), which drives the wind torque."""

    wind_output: Array
    """Row (n,) that gives the wind torque, rad/s², from the state."""

    jump_advance: float
    """Time by which jumps of commands come before the middle of a step, as a fraction of the step."""

    def input_contributions(self, commanded_torque: Array, delay_steps: float) -> Array:
        """Computes what the commanded torque adds to the states in each step: Γ₀ c + Γ₁ c⁺.

        Args:
            commanded_torque: commanded torque (T,), rad/s².
            delay_steps: delay from the command to the motors, in time steps, not necessarily whole.

        Returns:
            (T − 1, n) contributions to the n states, from the second sample on.
        """
        # Jumps of the commands come a fraction ``jump_advance`` of a step before the middle of their step. The torque
        # is one window (1, T, 1) of one input.
        window = commanded_torque.reshape(1, -1, 1)
        commands = with_advanced_jumps(window, self.jump_advance)[0]
        # Commands (T − 1, 1) at the beginning and at the end of each sampling step.
        commands_at_start, commands_at_end = delayed_inputs(commands, delay_steps)
        return (
            commands_at_start * self.transition.Gamma0[:, 0]
            + commands_at_end * self.transition.Gamma1[:, 0]
        )

    def rate_filter(self, noise_sd: float) -> SteadyStateFilter:
        """Designs the steady-state Kalman filter of a rate that is measured with white noise.

        Args:
            noise_sd: standard deviation of the noise, rad/s.

        Returns:
            The filter.

        Raises:
            numpy.linalg.LinAlgError: there is no steady-state filter.
        """
        return SteadyStateFilter.design(self.transition.Phi, self.Q, noise_sd)

    def smooth_wind_torque(
        self,
        rate_filter: SteadyStateFilter,
        commanded_torque: Array,
        delay_steps: float,
        rate: Array,
    ) -> SmoothedSignal:
        """Returns the smoothed wind torque of one segment from all of its rates.

        At the first sample, the torque of the motors is assumed to be the commanded one, and the wind torque to be 0.

        Args:
            rate_filter: the filter of this plant.
            commanded_torque: commanded torque, including any constant torque (T,), rad/s².
            delay_steps: delay of the commands, in steps.
            rate: measured rate (T,), rad/s.

        Returns:
            The smoothed wind torque (T,), rad/s², and the states that the filter predicted.
        """
        # The first state is the rate, the second one the torque of the motors; the others belong to the wind.
        initial_state = np.zeros(len(self.wind_output))
        initial_state[0] = rate[0]
        initial_state[1] = commanded_torque[0]
        contributions = self.input_contributions(commanded_torque, delay_steps)
        return rate_filter.smooth(contributions, rate, initial_state, self.wind_output)


def sampled_plant(
    damping: Array | float,
    lag: Array | float,
    components: Sequence[WindComponent | tuple[ColouredNoise, Array | float, Array | float]],
    dt: float,
    jump_advance: float = 0.0,
) -> SampledPlant:
    """Discretizes one axis, or several side by side (…), exactly for commands that vary linearly between samples.

    The states are the rate, the motors' torque, and the states of each component of the wind torque in order. The
    continuous system matrices are assembled block by block, and then discretised by matrix exponentials.

    Args:
        damping: rate damping (…), 1/s.
        lag: motor time constant (…), s.
        components: components of the wind torque: spectrum, standard deviation (…) in rad/s² and time (…) in s of each.
        dt: time step, s.
        jump_advance: time by which jumps of commands come before the middle of a step, as a fraction of the step.

    Returns:
        The discrete model, of one axis or of several.
    """
    shape = np.shape(damping)
    n = 2 + sum(len(spectrum.A) for spectrum, _, _ in components)
    A = np.zeros((*shape, n, n))
    intensity = np.zeros((*shape, n, n))
    B = np.zeros((*shape, n, 1))
    wind_output = np.zeros((*shape, n))
    # Each spectrum is defined for a time scale of 1. Its matrices are divided by the time scale of the component, s.
    first_state = 2
    for spectrum, sd, time in components:
        states = slice(first_state, first_state + len(spectrum.A))
        inverse_time = 1 / np.asarray(time)[..., None, None]
        A[..., states, states] = spectrum.A * inverse_time
        intensity[..., states, states] = spectrum.Q * inverse_time
        wind_output[..., states] = spectrum.C * np.asarray(sd)[..., None]
        first_state = states.stop
    # The rate is driven by its damping, the motors' torque and the wind torque; the torque follows the command.
    A[..., 0, :] = wind_output
    A[..., 0, 0] = -damping
    A[..., 0, 1] = 1.0
    B[..., 1, 0] = 1 / lag
    A[..., 1, 1] = -B[..., 1, 0]
    Q = process_covariance(A, intensity, dt)
    # Rounding makes it slightly asymmetric.
    Q = (Q + Q.mT) / 2
    return SampledPlant(discretize(A, B, dt), Q, wind_output, jump_advance)
