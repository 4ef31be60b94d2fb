"""The scalar system ẋ = A x + B v + w, y = x + z, the generative model that learns it, and F̄ᵒ over A and B.

Input and noises are sums of harmonics, so states and outputs are exact, whatever the sampling step.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, e

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.engine.coordinates import embed, temporal_precision
from mavdem.dem.engine.free_energy import Belief, optimal_terms
from mavdem.dem.engine.generative import GenerativeModel, Prior, SufficientStatistics
from mavdem.dem.engine.linalg import Array, inverse
from mavdem.dem.engine.steps import with_optimal_precisions

A, B = -2.0, 2.0  # the true ones, 1/s
INPUT_FREQUENCIES = np.array([0.7, 1.9, 3.1])  # rad/s; about the corner at 2 rad/s, to distinguish A and B
INPUT_HARMONICS = np.array([1.0, -1.0j, 0.6])

CERTAIN = e**32  # precision of a parameter that is known: C, in the authors' own examples too


@dataclass(frozen=True)
class ScalarWorld:
    """The true system and its noises."""

    duration: float = 576.0  # s
    step: float = 0.1  # between samples, s
    smoothness: float = 0.5  # kernel width of both noises, s
    lambda_z: float = 6.0  # log precision of the outputs' noise
    lambda_w: float = 3.0  # log precision of the process noise
    amplitude: float = 3.0  # of the input; 1 moves the state about as far as its own unit

    def signals(self, seed: int) -> tuple[Array, Array]:
        """Returns exact y and v at every sample, (T, 1) each."""
        rng = np.random.default_rng(seed)
        number = round(self.duration / self.step)
        # At half a kernel width a step, e^-39 of the noise's power lies beyond what the steps can hold.
        finer = ceil(2 * self.step / self.smoothness)
        # Harmonics repeat: over twice the duration, so that the end does not correlate with the beginning.
        total = 2 * number * finer
        omega: Array = 2 * np.pi * np.asarray(np.fft.rfftfreq(total, self.step / finer), float)
        w = _harmonics(rng, omega, self.smoothness, np.exp(-self.lambda_w / 2))
        z = _harmonics(rng, omega, self.smoothness, np.exp(-self.lambda_z / 2))
        tones = np.exp(1j * np.outer(self.step * np.arange(number), INPUT_FREQUENCIES))
        v = self.amplitude * INPUT_HARMONICS
        forced, disturbed = B * v / (1j * INPUT_FREQUENCIES - A), w / (1j * omega - A)
        noise = np.fft.irfft(disturbed + z, total, norm="forward")[: number * finer : finer]
        return ((tones @ forced).real + noise)[:, None], (tones @ v).real[:, None]


def _harmonics(rng: np.random.Generator, omega: Array, smoothness: float, deviation: float) -> NDArray[np.complex128]:
    """Random harmonics, up to the Nyquist frequency, of a noise whose power is that of a Gaussian kernel."""
    power = np.exp(-((omega * smoothness) ** 2))
    power[0] = 0.0
    phases = rng.standard_normal((2, len(omega))) / 2
    return np.asarray(deviation * np.sqrt(power / power.sum()) * (phases[0] + 1j * phases[1]))


@dataclass(frozen=True)
class ScalarSettings:
    """What the model assumes, and which data it uses. The defaults suit the default :class:`ScalarWorld`.

    The sensor's noise is known; the process noise is learned, from a prior two standard deviations off.
    """

    p: int = 2  # embedding order of outputs and states
    d: int = 1  # of the input
    q: int = 1  # of the process noise; q = p counts D's last row, which is zero, as evidence, q = p − 1 leaves it out
    smoothness: float = 0.5  # kernel width, s
    lambda_mean: tuple[float, float] = (6.0, 1.0)  # prior of [λᶻ, λʷ]
    lambda_precision: tuple[float, float] = (e**25, 1.0)
    theta_mean: tuple[float, float, float] = (-8.0, 8.0, 1.0)  # prior of A, B and C
    theta_precision: tuple[float, float, float] = (e**-4, e**-4, CERTAIN)  # for each
    input_precision: float = e**16  # of the input and of its derivatives
    spacing: float = 1.8  # s between the samples that are used; noise is uncorrelated after 3.5 kernel widths

    def samples(self, world: ScalarWorld, seed: int) -> SufficientStatistics:
        """The data that the engine gets."""
        # Inputs are embedded in the order of the outputs, so that the errors of both are of one filter and cancel.
        outputs, inputs = (embed(each, self.p, world.step, self.p + 1, self.p // 2) for each in world.signals(seed))
        every = round(self.spacing / world.step)
        return SufficientStatistics.of(np.hstack([outputs[::every], inputs[::every, : self.d + 1]]))

    def model(self) -> GenerativeModel:
        """The generative model whose F̄ is maximised."""
        return GenerativeModel(
            n=1,
            r=1,
            m=1,
            p=self.p,
            d=self.d,
            q=self.q,
            output_correlation=temporal_precision(self.p, self.smoothness),
            state_correlation=temporal_precision(self.q, self.smoothness),
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


PAPER_WORLD = ScalarWorld(duration=32.0, smoothness=0.1, lambda_z=20.0, amplitude=1.0)
"""The paper's noises, as its settings describe them, and an input about as large as its scaling leaves one; as many
samples as the default world has."""

PAPER = ScalarSettings(
    q=2,
    smoothness=0.1,
    lambda_mean=(20.0, 3.0),
    lambda_precision=(e**25, e**20),
    theta_precision=(e**4, e**4, CERTAIN),
    spacing=0.1,
)
"""The paper's section on algorithm settings, with η = (−8, 8) as in its figure."""


def truth_within(theta: Array, covariance: Array) -> bool:
    """Whether (A, B) lies in the 95 % region of a posterior: an ellipse, since A and B are correlated."""
    error = theta[:2] - [A, B]
    return bool(error @ inverse(covariance[:2, :2]) @ error < -2 * np.log(0.05))


def value_at(model: GenerativeModel, samples: SufficientStatistics, belief: Belief, a: float, b: float) -> float:
    """Returns F̄ᵒ (nats) at A = a, B = b, with the belief's states, λ and C held, and every covariance optimal there."""
    there = belief._replace(theta=np.array([a, b, belief.theta[2]]))
    return sum(optimal_terms(model, samples, with_optimal_precisions(model, there)).values())


def peak(model: GenerativeModel, samples: SufficientStatistics, belief: Belief) -> float:
    """Returns F̄ᵒ (nats) at the belief's own A and B."""
    return value_at(model, samples, belief, *belief.theta[:2])


def curvature(belief: Belief) -> float:
    """Returns the curvature of F̄ᵒ along A at the belief: the A entry of Π^θ, Eq. ``Picurvature``."""
    return float(np.linalg.inv(belief.theta_covariance[:2, :2])[0, 0])
