"""The scalar system of the demonstrations, ẋ = A x + B v + w, y = x + z, and the generative model it is learnt by.

Input and noises are sums of harmonics, so states, outputs and all derivatives are exact, whatever the sampling step.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, e

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.coordinates import embed
from mavdem.dem.generative import GenerativeModel, Samples
from mavdem.dem.positive import inverse
from mavdem.dem.priors import Prior
from mavdem.dem.smoothness import temporal_precision

Array = NDArray[np.float64]

A, B = -2.0, 2.0
"""What there is to find (1/s)."""

INPUT_FREQUENCIES = np.array([0.7, 1.9, 3.1])
"""rad/s; about the system's own corner at 2 rad/s, so that A and B can be told apart."""
INPUT_HARMONICS = np.array([1.0, -1.0j, 0.6])

CERTAIN = e**32
"""Precision of a parameter that is known: C, in the authors' own examples too."""


@dataclass(frozen=True)
class World:
    """What truly happens.

    Attributes:
        duration: s.
        step: between samples, s.
        smoothness: kernel width of both noises, s.
        lambda_z, lambda_w: log precisions of the outputs' and of the process noise.
        amplitude: of the input; 1 moves the state about as far as its own unit.
    """

    duration: float = 576.0
    step: float = 0.1
    smoothness: float = 0.5
    lambda_z: float = 6.0
    lambda_w: float = 3.0
    amplitude: float = 3.0

    def generalized(self, order: int, seed: int) -> tuple[Array, Array]:
        """Exact ỹ and ṽ at every sample, (T, order + 1) each."""
        rng = np.random.default_rng(seed)
        number = round(self.duration / self.step)
        # At half a kernel width a step, e^-39 of the noise's power lies beyond what the steps can hold.
        finer = ceil(2 * self.step / self.smoothness)
        # Harmonics repeat: over twice the duration, so that the end knows nothing of the beginning.
        total = 2 * number * finer
        omega = 2 * np.pi * np.fft.rfftfreq(total, self.step / finer)
        w = _harmonics(rng, omega, self.smoothness, np.exp(-self.lambda_w / 2))
        z = _harmonics(rng, omega, self.smoothness, np.exp(-self.lambda_z / 2))
        tones = np.exp(1j * np.outer(self.step * np.arange(number), INPUT_FREQUENCIES))
        v = self.amplitude * INPUT_HARMONICS
        forced, disturbed = B * v / (1j * INPUT_FREQUENCIES - A), w / (1j * omega - A)
        outputs, inputs = np.empty((number, order + 1)), np.empty((number, order + 1))
        for k in range(order + 1):
            slopes = (1j * INPUT_FREQUENCIES) ** k
            noise = np.fft.irfft((1j * omega) ** k * (disturbed + z), total, norm="forward")
            outputs[:, k] = (tones @ (slopes * forced)).real + noise[: number * finer : finer]
            inputs[:, k] = (tones @ (slopes * v)).real
        return outputs, inputs


def _harmonics(rng: np.random.Generator, omega: Array, smoothness: float, deviation: float) -> NDArray[np.complex128]:
    """Random harmonics, up to the Nyquist frequency, of a noise whose power is that of a Gaussian kernel."""
    power = np.exp(-((omega * smoothness) ** 2))
    power[0] = 0.0
    phases = rng.standard_normal((2, len(omega))) / 2
    return deviation * np.sqrt(power / power.sum()) * (phases[0] + 1j * phases[1])


@dataclass(frozen=True)
class Settings:
    """What is believed, and what of the data is used. The defaults suit the default :class:`World`.

    They know the sensor and learn the process noise, whose prior they put two standard deviations off.

    Attributes:
        p, d, q: embedding orders of outputs and states, of the input, and of the process noise; q = p counts D's last
            row, which is zero, as evidence, q = p − 1 leaves it out.
        smoothness: kernel width, s.
        lambda_mean, lambda_precision: prior of [λᶻ, λʷ].
        theta_mean, theta_precision: prior of A, B and C, the latter for each.
        input_precision: of the input and of its derivatives.
        spacing: s between the samples that are used; noise has forgotten itself in 3.5 of its kernel widths.
        exact_derivatives: whether they are taken from the simulation and not from samples.
    """

    p: int = 2
    d: int = 1
    q: int = 1
    smoothness: float = 0.5
    lambda_mean: tuple[float, float] = (6.0, 1.0)
    lambda_precision: tuple[float, float] = (e**25, 1.0)
    theta_mean: tuple[float, float, float] = (-8.0, 8.0, 1.0)
    theta_precision: tuple[float, float, float] = (e**-4, e**-4, CERTAIN)
    input_precision: float = e**16
    spacing: float = 1.8
    exact_derivatives: bool = False

    def samples(self, world: World, seed: int) -> Samples:
        """What the engine sees of the world."""
        outputs, inputs = world.generalized(self.p, seed)
        if not self.exact_derivatives:
            centre = self.p // 2
            outputs = embed(outputs[:, :1], self.p, world.step, self.p + 1, centre)
            # Of the same order as the outputs, so that the errors of both are those of one filter and cancel.
            inputs = embed(inputs[:, :1], self.p, world.step, self.p + 1, centre)
        every = round(self.spacing / world.step)
        return Samples.of(np.hstack([outputs[::every], inputs[::every, : self.d + 1]]))

    def model(self) -> GenerativeModel:
        """The generative model the engine climbs."""
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


PAPER_WORLD = World(duration=32.0, smoothness=0.1, lambda_z=20.0, amplitude=1.0)
"""The paper's noises, as its settings describe them, and an input about as large as its scaling leaves one; as many
samples as the default world has."""

PAPER = Settings(
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
