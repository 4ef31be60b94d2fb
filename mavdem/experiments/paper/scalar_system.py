"""The scalar system of section IV of the paper, ẋ = A x + B v + w, y = x + z: exact data, and models of it.

The input v and the noises w and z are sums of harmonics. The response of a linear system to a harmonic is known, so
states and outputs are exact, whatever the sampling step.
"""

from dataclasses import dataclass
from math import ceil, e

import numpy as np
from numpy.random import Generator, default_rng

from mavdem.arrays import Array
from mavdem.dem.engine.generalized_coordinates import embed, temporal_precision
from mavdem.dem.engine.generative import GenerativeModel, Prior
from mavdem.dem.engine.moments import SufficientStatistics
from mavdem.loops.margins import Complex

TRUE_A = -2.0
"""1/s, the true parameter A, as in the paper."""

TRUE_B = 2.0
"""1/s, the true parameter B, as in the paper."""

INPUT_FREQUENCIES = np.array([0.7, 1.9, 3.1])
"""rad/s, frequencies of the input: on both sides of the system's corner at 2 rad/s, which distinguishes A and B."""

INPUT_HARMONICS = np.array([1.0, -1.0j, 0.6])
"""Complex amplitudes of the input at these frequencies, in units of its amplitude; a choice."""

KNOWN_PARAMETER_PRECISION = e**32
"""Prior precision of a parameter that is known, here C, as in the authors' own examples."""


@dataclass(frozen=True, eq=False)
class ScalarData:
    """Samples of the scalar system."""

    outputs: Array
    """(T, 1) measured outputs y."""

    inputs: Array
    """(T, 1) inputs v."""


@dataclass(frozen=True)
class ScalarSystem:
    """The true system with one state, input and output: duration and step of its data, its noises and its input."""

    duration: float = 576.0
    """Duration of the data, s."""

    dt: float = 0.1
    """Sampling step, s."""

    smoothness: float = 0.5
    """Width of the Gaussian kernel of both noises, s."""

    lambda_z: float = 6.0
    """Log precision of the measurement noise z."""

    lambda_w: float = 3.0
    """Log precision of the process noise w."""

    input_amplitude: float = 3.0
    """Amplitude of the input; an amplitude of 1 makes the state deviate by about 1."""

    def simulate(self, seed: int) -> ScalarData:
        """Simulates the exact outputs and inputs at every sample.

        Noises and state are computed as Fourier coefficients. A harmonic of the input or the process noise appears in
        the state multiplied by the transfer function 1 / (iω − A).

        Args:
            seed: seed of the noises.

        Returns:
            Outputs (T, 1) and inputs (T, 1).
        """
        rng = default_rng(seed)
        sample_count = round(self.duration / self.dt)
        # The harmonics need at least two steps within the kernel's width: then only e^-39 of the noise's power lies
        # beyond the Nyquist frequency.
        steps_per_sample = ceil(2 * self.dt / self.smoothness)
        # Sums of harmonics are periodic. The period is twice the duration, so that the end of the data does not
        # correlate with the beginning.
        step_count = 2 * sample_count * steps_per_sample
        cycle_frequencies = np.fft.rfftfreq(step_count, self.dt / steps_per_sample)
        noise_frequencies = 2 * np.pi * np.asarray(cycle_frequencies, float)
        w = random_harmonics(rng, noise_frequencies, self.smoothness, np.exp(-self.lambda_w / 2))
        z = random_harmonics(rng, noise_frequencies, self.smoothness, np.exp(-self.lambda_z / 2))
        state_noise = w / (1j * noise_frequencies - TRUE_A)
        noise = np.fft.irfft(state_noise + z, step_count, norm="forward")
        sampled_noise = noise[: sample_count * steps_per_sample : steps_per_sample]
        times = self.dt * np.arange(sample_count)
        tones = np.exp(1j * np.outer(times, INPUT_FREQUENCIES))
        v = self.input_amplitude * INPUT_HARMONICS
        forced_state = TRUE_B * v / (1j * INPUT_FREQUENCIES - TRUE_A)
        outputs = (tones @ forced_state).real + sampled_noise
        inputs = (tones @ v).real
        return ScalarData(outputs[:, None], inputs[:, None])


def random_harmonics(
    rng: Generator, frequencies: Array, smoothness: float, standard_deviation: float
) -> Complex:
    """Draws the Fourier coefficients of a random series: white Gaussian noise, smoothed by a Gaussian kernel.

    Args:
        rng: generator of random numbers.
        frequencies: (F,) angular frequencies from 0 on, rad/s.
        smoothness: width of the kernel, s.
        standard_deviation: standard deviation of the noise, in the unit of the result.

    Returns:
        (F,) coefficients for ``numpy.fft.irfft`` with ``norm="forward"``; the mean, at frequency 0, is zero.
    """
    power = np.exp(-((frequencies * smoothness) ** 2))
    power[0] = 0.0
    # Real and imaginary part have a standard deviation of 1/2 each, so the complex numbers have a variance of 1/2: a
    # real series has each coefficient and its conjugate.
    real_part, imaginary_part = rng.standard_normal((2, len(frequencies))) / 2
    return standard_deviation * np.sqrt(power / power.sum()) * (real_part + 1j * imaginary_part)


@dataclass(frozen=True)
class ScalarSettings:
    """Settings of DEM for the scalar system: what the model assumes, and which data it uses.

    The defaults suit the default :class:`ScalarSystem`. The precision of the measurement noise is known; the precision
    of the process noise is learned, from a prior two standard deviations off.
    """

    p: int = 2
    """Embedding order of outputs and states."""

    d: int = 1
    """Embedding order of the input."""

    q: int = 1
    """Embedding order of the process noise.

    With q = p the last row of the derivative operator D, which is zero, counts as evidence; q = p − 1 leaves it out.
    """

    smoothness: float = 0.5
    """Width of the noises' Gaussian kernel, s."""

    lambda_mean: tuple[float, float] = (6.0, 1.0)
    """Prior means of [λᶻ, λʷ]."""

    lambda_precision: tuple[float, float] = (e**25, 1.0)
    """Prior precisions of [λᶻ, λʷ]."""

    theta_mean: tuple[float, float, float] = (-8.0, 8.0, 1.0)
    """Prior means of A, B and C; the means of A and B are the paper's (Fig. 3, ``para_FE_opt``)."""

    theta_precision: tuple[float, float, float] = (e**-4, e**-4, KNOWN_PARAMETER_PRECISION)
    """Prior precisions of A, B and C."""

    input_precision: float = e**16
    """Prior precision of the input and of its derivatives."""

    spacing: float = 1.8
    """Time between the samples that are used, s; after 3.5 kernel widths noise is uncorrelated."""

    def sufficient_statistics(self, system: ScalarSystem, seed: int) -> SufficientStatistics:
        """Simulates a system, and returns number and second moments of its outputs and inputs with their derivatives.

        Derivatives are taken by a polynomial over a short window, and only every so many samples are used, so that
        their noises are uncorrelated.

        Args:
            system: the true system.
            seed: seed of the noises.

        Returns:
            The statistics.
        """
        data = system.simulate(seed)
        window = self.p + 1
        center = self.p // 2
        outputs = embed(data.outputs, self.p, system.dt, window, center)
        # The polynomial's derivatives are not exact. Outputs and inputs get the same polynomial, so that these errors
        # cancel in the equations of the model. Only the derivatives of the inputs up to order d are used.
        inputs = embed(data.inputs, self.p, system.dt, window, center)
        stride = round(self.spacing / system.dt)
        used_inputs = inputs[::stride, : self.d + 1]
        return SufficientStatistics.from_segments(np.hstack([outputs[::stride], used_inputs]))

    def model(self) -> GenerativeModel:
        """Returns the generative model whose free energy F̄ is maximised: one state, one input and one output.

        p, d and q are the embedding orders of output, input and state: how many derivatives DEM uses of each. The
        noises of output and state are smooth, with one precision each to be learned: hyperparameters 0 and 1. The prior
        is Gaussian, on the parameters θ and on the logarithms λ of these precisions.
        """
        return GenerativeModel(
            n=1,
            r=1,
            m=1,
            p=self.p,
            d=self.d,
            q=self.q,
            output_temporal_precision=temporal_precision(self.p, self.smoothness),
            state_temporal_precision=temporal_precision(self.q, self.smoothness),
            output_groups=np.array([0]),
            state_groups=np.array([1]),
            input_precision=self.input_precision * np.eye(self.d + 1),
            prior=Prior(
                np.array(self.theta_mean),
                np.diag(self.theta_precision),
                np.array(self.lambda_mean),
                np.diag(self.lambda_precision),
            ),
        )


PAPER_SYSTEM = ScalarSystem(duration=32.0, smoothness=0.1, lambda_z=20.0, input_amplitude=1.0)
"""System with the noises that the paper's settings describe.

Its input is about as large as the paper's scaling of inputs makes one, and as many samples are used as of the default
system.
"""

PAPER_SCALAR_SETTINGS = ScalarSettings(
    q=2,
    smoothness=0.1,
    lambda_mean=(20.0, 3.0),
    lambda_precision=(e**25, e**20),
    theta_precision=(e**4, e**4, KNOWN_PARAMETER_PRECISION),
    spacing=0.1,
)
"""The settings of section V.D of the paper, with the prior means (−8, 8) of its figure."""
