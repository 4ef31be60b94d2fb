"""Gray-box model of one axis in the frequency domain: rate by motors, wind torque and noise; one-step errors.

The sampled rate of a window has the transform

    y = P(jω) · Σ_i b_i u_i + v,       P = e^(−jωθ) Σ_folds H / ((jω + d)(jωτ + 1)),

with effects b_i of the inputs u_i, damping d, motor lag τ, delay θ, the hold H by which samples of the inputs act, and
noise v: wind torque through the damped rate, and white measurement noise. The gains of the controller are not used, so
the inputs count as known. The prediction errors are y − P Σ b u over the minimum-phase factor of the density of v.
Maximising their likelihood is consistent in closed loop as far as the spectrum of the wind torque is right (Ljung,
System Identification, 2nd ed., secs. 8.4 and 13.4). Each window has its own constant, which balances its trim, and
its own level of wind torque and noise; both are solved for. All other parameters are the same in all windows.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import scipy

from mavdem.arrays import Array, ArrayPair
from mavdem.facts.model import Refinement
from mavdem.plant.closed_loop.spectra import ComplexArray
from mavdem.plant.identifiability import RESOLVED_LAG
from mavdem.plant.sampled_plant import ColouredNoise
from mavdem.plant.windows import (
    HELD_CHANNEL,
    INTERPOLATED_CHANNEL,
    MAX_JUMP_ADVANCE,
    REFINEMENT_CHANNEL,
    REFINEMENTS,
    FlightWindows,
)

SETTLING_SECONDS = 0.25
"""Beginning of each window whose prediction errors do not count, s.

A transform takes the end of a window for what was before its beginning.
"""

RESPONSE_SECONDS = 0.004
"""Time for which an autopilot's response to one sample of the rate lasts, s: it has the next gyro sample then."""

MAX_DAMPING = 25.0
"""Upper bound of the rate damping, 1/s: five times the damping of the smallest published vehicles."""

ALIAS_NUMBERS = np.arange(-1, 2)[:, None]
"""Multiples of the sampling rate whose content folds onto each frequency.

The next ones would add 1 % at half of the sampling rate, and less below.
"""


class Prior(NamedTuple):
    """Normal prior distribution of one entry of θ."""

    mean: float
    """Its mean."""

    sd: float
    """Its standard deviation."""


# The priors below describe common multirotors and their autopilots.

LOG_EFFECT_PRIOR = Prior(0.0, 2.0)
"""Prior of the logarithm of the effect, rad/s² per unit of the inputs; the mean is replaced by a first estimate."""

LOG_DAMPING_PRIOR = Prior(np.log(2.0), 1.0)
"""Prior of the logarithm of the damping, 1/s: damping of a rotor in air is positive."""

LOG_LAG_PRIOR = Prior(np.log(0.03), 1.0)
"""Prior of the logarithm of the motor lag, s."""

DELAY_PRIOR = Prior(0.006, 0.004)
"""Prior of the delay, s."""

LOG_WIND_SIZE_PRIOR = Prior(np.log(0.5), 1.5)
"""Prior of the logarithm of the standard deviation of each component of the wind torque, rad/s²."""

LOG_WIND_TIME_PRIORS = (Prior(np.log(1.0), 1.0), Prior(np.log(0.07), 1.0))
"""Prior of the logarithm of the time of the first component of the wind torque (drift), and the second (gusts), s."""

LOG_NOISE_PRIOR = Prior(np.log(0.005), 2.0)
"""Prior of the logarithm of the standard deviation of the rate's white noise, rad/s."""

REFINEMENT_PRIOR = Prior(0.0, 0.3)
"""Prior of the parameter of each refinement; ``windows.REFINEMENTS`` says what it is."""


class GrayBoxModel(NamedTuple):
    """Body rate of one axis by its motors, wind torque and noise, as functions of the k entries of the parameters θ.

    The entries of θ, in this order: log effect; deviation of each motor (r of them); log damping; log lag; delay; log
    size and log time of each component of the wind torque; log noise; refinements. The effect of motor i is
    exp(log effect) · (direction i + deviation i).
    """

    directions: Array
    """Direction of the motors' effects (r,), with mean magnitude 1."""

    deviation_sd: float
    """Prior standard deviation of each motor's deviation from its direction."""

    wind: tuple[ColouredNoise, ...]
    """Spectra of the components of the wind torque, without scale."""

    min_noise: float
    """Lower bound of the standard deviation of the rate's white noise, rad/s."""

    refinements: tuple[Refinement, ...] = ()
    """Refinements that have a parameter in θ."""

    @property
    def motors(self) -> int:
        """Number r of motors, or other inputs."""
        return len(self.directions)

    @property
    def prior(self) -> ArrayPair:
        """Normal prior of θ: its mean (k,) and its standard deviation (k,), in the order of the entries of θ.

        All entries are independent: the log effect; the deviation of each motor's effect from the common one; log
        damping, log lag and delay; log size and log time of each component of the wind torque, the slow component
        first; log noise; and the parameter of each refinement of the model, such as the curvature of the thrust curve.
        """
        # The order must agree with the indices below.
        priors = [LOG_EFFECT_PRIOR]
        priors += [Prior(0.0, self.deviation_sd)] * self.motors
        priors += [LOG_DAMPING_PRIOR, LOG_LAG_PRIOR, DELAY_PRIOR]
        for time_prior in LOG_WIND_TIME_PRIORS[: len(self.wind)]:
            priors += [LOG_WIND_SIZE_PRIOR, time_prior]
        priors.append(LOG_NOISE_PRIOR)
        priors += [REFINEMENT_PRIOR] * len(self.refinements)
        mean, sd = np.array(priors).T
        return mean, sd

    @property
    def damping_index(self) -> int:
        """Index of the log damping in θ."""
        return self.motors + 1

    @property
    def lag_index(self) -> int:
        """Index of the log lag in θ."""
        return self.motors + 2

    @property
    def delay_index(self) -> int:
        """Index of the delay in θ."""
        return self.motors + 3

    @property
    def wind_index(self) -> int:
        """Index of the first log size of the wind torque's components in θ; their log times follow each."""
        return self.motors + 4

    @property
    def noise_index(self) -> int:
        """Index of the log noise in θ."""
        return self.wind_index + 2 * len(self.wind)

    @property
    def effect_indices(self) -> range:
        """Indices of the log effect and of the motors' deviations from it in θ, which it begins with."""
        return range(self.damping_index)

    @property
    def wind_and_noise_indices(self) -> range:
        """Indices of sizes and times of the wind torque's components and of the noise in θ."""
        return range(self.wind_index, self.noise_index + 1)

    @property
    def refinement_indices(self) -> range:
        """Indices of the parameters of the refinements in θ, which it ends with."""
        first_refinement = self.noise_index + 1
        return range(first_refinement, first_refinement + len(self.refinements))

    @property
    def logarithm_indices(self) -> list[int]:
        """Indices of all entries of θ that are logarithms."""
        return [0, self.damping_index, self.lag_index, *self.wind_and_noise_indices]

    def effect(self, thetas: Array) -> Array:
        """Returns the effect of each motor (…, r), rad/s² per unit of ``FlightWindows.inputs``, for θ (…, k)."""
        deviations = thetas[..., 1 : self.motors + 1]
        return np.exp(thetas[..., :1]) * (self.directions + deviations)

    def damping(self, thetas: Array) -> Array:
        """Returns the damping (…), 1/s, for θ (…, k); it approaches ``MAX_DAMPING`` smoothly."""
        return 1 / (np.exp(-thetas[..., self.damping_index]) + 1 / MAX_DAMPING)

    def lag(self, thetas: Array, dt: float) -> Array:
        """Returns the motor lag, s, of several parameter vectors.

        It approaches a lower bound of ``RESOLVED_LAG`` time steps smoothly: samples cannot distinguish a shorter lag
        from a delay.

        Args:
            thetas: (…, k) parameter vectors θ.
            dt: time step of the samples, s.

        Returns:
            (…) lags, s.
        """
        return np.hypot(np.exp(thetas[..., self.lag_index]), RESOLVED_LAG * dt)

    def wind_sizes(self, thetas: Array) -> Array:
        """Returns the standard deviations of the wind torque's components (…, components), rad/s², for θ (…, k)."""
        return np.exp(thetas[..., self.wind_index : self.noise_index : 2])

    def wind_times(self, thetas: Array) -> Array:
        """Returns the times of the wind torque's components (…, components), s, for θ (…, k)."""
        return np.exp(thetas[..., self.wind_index + 1 : self.noise_index : 2])

    def noise(self, thetas: Array) -> Array:
        """Returns the standard deviation of the rate's white noise (…), rad/s, for θ (…, k), above ``min_noise``."""
        return np.hypot(np.exp(thetas[..., self.noise_index]), self.min_noise)

    def refinement_values(self, thetas: Array) -> Array:
        """Returns the parameter of each refinement (…, refinements), for θ (…, k)."""
        return thetas[..., self.noise_index + 1 :]

    @property
    def bounds(self) -> ArrayPair:
        """Lower and upper bounds (k,) of the entries of θ, infinite for most.

        The delay is at least 0, since no command acts before it is given. An input that jumps between two samples did
        so at the earlier one at the earliest (refinement ``JUMPS``). Where a fit would move it even earlier, this bound
        is better than a fit without the refinement, whose effect was up to 15 % too high, and damping, lag and delay
        too low.
        """
        lower = np.full(len(self.prior[0]), -np.inf)
        upper = np.full(len(lower), np.inf)
        lower[self.delay_index] = 0.0
        for refinement, index in zip(self.refinements, self.refinement_indices, strict=True):
            if refinement is Refinement.JUMPS:
                upper[index] = MAX_JUMP_ADVANCE
        return lower, upper

    def rate_by_motors(self, thetas: Array, windows: FlightWindows) -> ComplexArray:
        """Returns the Fourier transform of the body rate that the motors alone cause.

        The inputs are multiplied by the motors' effects, and by the frequency response of their channel.

        Args:
            thetas: b parameter vectors θ (b, k).
            windows: W windows with F frequencies.

        Returns:
            Transforms (b, W, F), rad/s.
        """
        inputs = self._input_channels(windows)
        # Windows and frequencies are flattened, so that the effects (b, r) multiply inputs (channels, r, W F).
        torques = self.effect(thetas).astype(complex) @ inputs.reshape(*inputs.shape[:2], -1)
        torques = torques.reshape(len(inputs), len(thetas), *windows.rate.shape)
        # Letters of einsum: channel c, parameter vector b, window w, frequency f. The channels' rates add up.
        return np.einsum("cbwf,cbf->bwf", torques, self._channel_responses(thetas, windows))

    def _input_channels(self, windows: FlightWindows) -> ComplexArray:
        """Returns the channels of the inputs that this model uses.

        The inputs are the sum of two signals, their channels, which act differently between samples: commands are
        interpolated linearly, and the controller's immediate response to a sample is held from that sample on. Each
        refinement of the model, such as the curvature of the thrust curve, adds one more channel.

        Args:
            windows: W windows with F frequencies.

        Returns:
            The channels (channels, r, W, F).
        """
        channels = [INTERPOLATED_CHANNEL, HELD_CHANNEL]
        for refinement in self.refinements:
            channels.append(REFINEMENT_CHANNEL + REFINEMENTS.index(refinement))
        return windows.inputs[channels]

    def _channel_responses(self, thetas: Array, windows: FlightWindows) -> ComplexArray:
        """Returns the frequency response of the body rate to the motors' torque, for each channel of the inputs.

        Each response is a product of three: the delay, the conversion from samples to continuous time (interpolation or
        hold), and the plant, 1 / ((damping + jω) (1 + lag jω)). Sampling aliases frequencies above the Nyquist
        frequency, so that the response is summed over all aliases of each frequency.

        Args:
            thetas: b parameter vectors θ (b, k).
            windows: windows with F frequencies.

        Returns:
            Responses (channels, b, F), s; the channels of ``_input_channels``.
        """
        dt = windows.dt
        omega = _aliases(windows)
        damping = self.damping(thetas)[:, None, None]
        lag = self.lag(thetas, dt)[:, None, None]
        plant = 1 / (damping - lag * omega**2 + 1j * omega * (1 + damping * lag))

        # Linear interpolation between samples has the spectrum sinc²; a value that is held for one sample has the
        # spectrum sinc with a delay of half a sample. Inputs are interpolated, except for the immediate response of the
        # controller to a sample. It must not be used to predict the sample, and is therefore held from the sample on.
        held_spectrum = np.sinc(omega * dt / (2 * np.pi))
        interpolation = held_spectrum**2
        # If the sampling interval is longer than the autopilot's response, the response is held only for a fraction of
        # the interval. Its spectrum is approximated by the spectrum of the whole interval times this fraction, which is
        # correct at low frequencies.
        held_fraction = min(1.0, RESPONSE_SECONDS / dt)
        half_sample_delay = np.exp(-0.5j * omega * dt)
        hold = held_fraction * held_spectrum * half_sample_delay
        delay_response = self._delay_response(thetas, windows)
        interpolated_response = delay_response * np.sum(plant * interpolation, axis=1)
        held_response = delay_response * np.sum(plant * hold, axis=1)
        responses = [interpolated_response, held_response]
        # The channel of a refinement adds its signal, weighted by the parameter of the refinement, to the inputs.
        for weight in self.refinement_values(thetas).T:
            responses.append(interpolated_response * weight[:, None])
        return np.array(responses)

    def _delay_response(self, thetas: Array, windows: FlightWindows) -> ComplexArray:
        """Returns the frequency response of the delay from a command to the motors' torque.

        It is a delay by whole samples, and a linear interpolation between two samples for the remainder.

        Args:
            thetas: b parameter vectors θ (b, k).
            windows: windows with F frequencies.

        Returns:
            Responses (b, F), without unit.
        """
        delay = np.maximum(thetas[:, [self.delay_index]], 0.0)
        whole_samples, remainder = np.divmod(delay / windows.dt, 1.0)
        one_sample_later = np.exp(-1j * windows.omega * windows.dt)
        interpolation = (1 - remainder) + remainder * one_sample_later
        return np.asarray(one_sample_later**whole_samples * interpolation)

    def noise_density(self, thetas: Array, windows: FlightWindows) -> Array:
        """Returns the spectral density of the body rate that wind torque and measurement noise cause.

        The density of the wind torque, the sum of its components, is multiplied by the squared response of the damped
        axis, 1 / (ω² + damping²), and summed over all aliases of each frequency. The density of white measurement noise
        is added.

        Args:
            thetas: b parameter vectors (b, k).
            windows: windows of the flight, which have the F frequencies and the time step.

        Returns:
            Densities of the samples (b, F), in (rad/s)², normalised so that white noise has the variance of its
            samples.
        """
        # Angular frequencies of all aliases. With the parameter vectors in front, densities have the axes (b, aliases,
        # F), and parameters (b, 1, 1).
        omega = _aliases(windows)
        sizes_of_components = self.wind_sizes(thetas).T[:, :, None, None]
        times_of_components = self.wind_times(thetas).T[:, :, None, None]
        components = zip(self.wind, sizes_of_components, times_of_components, strict=True)
        torque_densities = [colour.density(omega, size, time) for colour, size, time in components]
        torque_density = np.sum(torque_densities, axis=0)
        damping = self.damping(thetas)[:, None, None]
        rate_density = torque_density / (omega**2 + damping**2)
        noise_variance = self.noise(thetas)[:, None] ** 2
        return rate_density.sum(axis=1) / windows.dt + noise_variance

    def innovations(self, thetas: Array, windows: FlightWindows) -> ArrayPair:
        """Returns the one-step prediction errors (innovations) of all windows, without their beginnings.

        The rate minus the rate that the motors cause is divided by the minimum-phase factor of the noise's density, in
        the frequency domain. That whitens it: the result is what cannot be predicted of each sample from the samples
        before it.

        Args:
            thetas: b parameter vectors θ (b, k).
            windows: W windows of N samples.

        Returns:
            Prediction errors (b, W, N′), rad/s, without their mean in each window, since a constant acceleration
            explains that; and the variance (b,) that the model gives them.
        """
        noise = minimum_phase(self.noise_density(thetas, windows), windows.samples)
        residual = windows.rate - self.rate_by_motors(thetas, windows)
        return _prediction_errors(residual, noise.factor, windows), noise.variance

    def innovations_after_steps(self, theta: Array, steps: Array, windows: FlightWindows) -> Array:
        """Returns the one-step prediction errors at a point θ, and those with each entry of θ changed by a step.

        They equal the errors of :meth:`innovations` at all these parameter vectors, but take less time. The errors are
        the rate minus the rate that the motors cause, filtered to be white by the noise's density. Effects change
        neither frequency responses nor that density, and wind and noise do not change the rate by the motors.

        ``tests/plant/test_physical.py`` compares them with :meth:`innovations` at the changed parameters.

        Args:
            theta: parameters θ (k,).
            steps: change of each parameter (k,).
            windows: W windows of N samples.

        Returns:
            Prediction errors (k + 1, W, N′), rad/s, at θ first, without their mean in each window.
        """
        # Row 0 of the points is θ, and row i + 1 has entry i of θ changed (``_rows_of_entries``).
        points = np.vstack([theta, theta + np.diag(steps)])
        residual = windows.rate - self._rate_by_motors_after_steps(points, windows)
        factor = self._noise_factors_after_steps(points, windows)
        return _prediction_errors(residual, factor, windows)

    def _rate_by_motors_after_steps(self, points: Array, windows: FlightWindows) -> ComplexArray:
        """Returns the Fourier transform of the rate that the motors cause, at θ and with each of its entries changed.

        New frequency responses are computed only for changes of damping, lag, delay and the refinements. Effects do not
        change the responses, and wind and noise do not change this rate at all.

        Args:
            points: θ, and θ with each of its entries changed (k + 1, k).
            windows: W windows with F frequencies.

        Returns:
            Transforms (k + 1, W, F), rad/s, as :meth:`rate_by_motors` returns them for the points.
        """
        # The effects are the first entries of θ. With θ itself, in row 0, their rows are the first ones of the points.
        effect_rows = slice(0, 1 + len(self.effect_indices))
        response_rows = _rows_of_entries(
            [self.damping_index, self.lag_index, self.delay_index, *self.refinement_indices]
        )
        inputs = self._input_channels(windows)
        responses = self._channel_responses(points[[0, *response_rows]], windows)
        response_at_theta = responses[:, 0]
        responses_after_steps = responses[:, 1:]

        # Letters of einsum: channel c, input r, parameter vector b, window w, frequency f.
        rate_by_motors = np.empty((len(points), *windows.rate.shape), complex)
        # If the effects change, the rate by each input is the same, and is multiplied by other effects.
        rate_per_effect = np.einsum("crwf,cf->rwf", inputs, response_at_theta)
        effects = self.effect(points[effect_rows]).astype(complex)
        rate_by_motors[effect_rows] = np.tensordot(effects, rate_per_effect, axes=1)
        # If wind or noise change, the rate is that at θ, which is in row 0.
        rate_by_motors[effect_rows.stop :] = rate_by_motors[0]
        # If the response changes, the torques of the motors are the same, and are multiplied by other responses.
        torques = np.einsum("crwf,r->cwf", inputs, effects[0])
        rate_by_motors[response_rows] = np.einsum("cwf,cbf->bwf", torques, responses_after_steps)
        return rate_by_motors

    def _noise_factors_after_steps(self, points: Array, windows: FlightWindows) -> ComplexArray:
        """Returns the minimum-phase factor of the noise's density, at θ and with each of its entries changed.

        The noise is the rate that wind torque and measurement noise cause. Its density depends on the damping and on
        the entries of wind and noise only, so that all other points have the factor at θ.

        Args:
            points: θ, and θ with each of its entries changed (k + 1, k).
            windows: windows of the flight, which have the F frequencies and the time step.

        Returns:
            Factors (k + 1, F).
        """
        changed_rows = _rows_of_entries([self.damping_index, *self.wind_and_noise_indices])
        # Row 0 of the points is θ itself.
        computed_rows = [0, *changed_rows]
        densities = self.noise_density(points[computed_rows], windows)
        computed_factors = minimum_phase(densities, windows.samples).factor
        factor_at_theta = computed_factors[:1]
        factors = np.repeat(factor_at_theta, len(points), axis=0)
        factors[computed_rows] = computed_factors
        return factors


def _rows_of_entries(entries: Iterable[int]) -> list[int]:
    """Returns the rows of the points after steps in which these entries of θ are changed: row 0 is θ unchanged."""
    return [1 + entry for entry in entries]


def _prediction_errors(
    residual: ComplexArray, factor: ComplexArray, windows: FlightWindows
) -> Array:
    """Returns the one-step prediction errors of windows, without their beginnings and their mean.

    Errors are the residual divided by the factor of the noise's density, which makes them white, transformed back to
    time. The first ``SETTLING_SECONDS`` of a window are left out, since the samples before them are missing. The mean
    is removed, since a constant acceleration, which balances the window's trim, is no error.

    Args:
        residual: transforms of the rate minus the rate that the motors cause (b, W, F), rad/s.
        factor: minimum-phase factors of the noise's density (b, F).
        windows: the W windows, of N samples.

    Returns:
        Prediction errors (b, W, N′), rad/s.
    """
    whitened_residual = residual * (1 / factor)[:, None]
    errors = scipy.fft.irfft(whitened_residual, windows.samples)
    first_settled_sample = round(SETTLING_SECONDS / windows.dt) + 1
    settled_errors = errors[..., first_settled_sample:]
    settled_errors -= settled_errors.mean(axis=-1, keepdims=True)
    return settled_errors


def _aliases(windows: FlightWindows) -> Array:
    """Returns the angular frequencies (folds, F), rad/s, that samples cannot distinguish from those of the windows."""
    return windows.omega + 2 * np.pi / windows.dt * ALIAS_NUMBERS


class SpectralFactorisation(NamedTuple):
    """Spectral densities in the form variance · |factor|², for b densities at F frequencies."""

    factor: ComplexArray
    """(b, F) minimum-phase factors: causal, with a causal inverse."""

    variance: Array
    """(b,) variances of the one-step prediction errors."""


def minimum_phase(density: Array, samples: int) -> SpectralFactorisation:
    """Factorises spectral densities as variance · |factor|², with a factor that is causal and has a causal inverse.

    The cepstrum of a minimum-phase factor is the causal half of the density's (Oppenheim and Schafer,
    Discrete-Time Signal Processing, 3rd ed., ch. 13).

    Args:
        density: b densities (b, F) at the frequencies of a real transform.
        samples: number of samples of the transform, which has F = samples // 2 + 1 frequencies.
    """
    cepstrum = scipy.fft.irfft(np.log(density), samples)
    variance = np.exp(cepstrum[:, 0])
    # The causal half of the cepstrum is kept, without sample 0, which is the log variance. With an even number of
    # samples, the one in the middle belongs to both halves: half of it is kept.
    cepstrum[:, 0] = 0.0
    first_anticausal = samples // 2 + 1
    cepstrum[:, first_anticausal:] = 0.0
    cepstrum[:, (samples + 1) // 2 : first_anticausal] /= 2
    return SpectralFactorisation(factor=np.exp(scipy.fft.rfft(cepstrum)), variance=variance)
