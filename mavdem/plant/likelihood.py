"""The likelihood of the gray-box model: one-step prediction errors of windows of a flight, by their Fourier transforms.

    rate = response · effect · commands + noise,

with the response of :mod:`~mavdem.plant.sampled_plant` and white noise beside the wind's. As the gains of the
controller are not asked for, commands are known inputs. A prediction error is the transform of what they leave
unexplained over the minimum-phase factor of its density: maximising their likelihood is consistent in closed loop as
far as the wind's spectrum is right (Ljung, System Identification, 2nd ed., secs. 8.4, 13.4). Each window has a constant
of its own, which balances its trim, and a level of its own of wind and noise together; both are solved for. What
remains is the same in all windows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.fft import irfft, rfft

from mavdem.arrays import Array, ArrayPair, Indices
from mavdem.facts.model import Refinement
from mavdem.plant.closed_loop.spectra import ComplexArray
from mavdem.plant.identifiability import RESOLVED_LAG
from mavdem.plant.sampled_plant import Coloured, jumping

# of each window, whose prediction errors do not count: a transform takes its end for what was before
SETTLING_SECONDS = 0.25
# for which an autopilot answers one sample of the rate: then it has the next
ANSWERED_SECONDS = 0.004
MAX_DAMPING = 25.0  # 1/s: five times that of the smallest published vehicles
FOLDS = np.arange(-1, 2)[:, None]
"""Multiples of the sampling rate that fold: the next ones would add 1 % at half of it, and less below."""

EFFECT = (0.0, 2.0)
DAMPING = (np.log(2.0), 1.0)
LAG = (np.log(0.03), 1.0)
DELAY_PRIOR = (0.006, 0.004)
SIZE = (np.log(0.5), 1.5)
NOISE = (np.log(0.005), 2.0)
"""Mean and standard deviation beforehand, in s, rad/s and rad/s², of logarithms but for the delay: as of common
multirotors and their autopilots. Damping of a rotor in air is positive, and so are the lag and the effect along the
mixer's direction. The effect's mean is that of a first estimate."""

TIMES = ((np.log(1.0), 1.0), (np.log(0.07), 1.0))
"""Likewise of the time of each component of the wind: the drift of the air, and gusts."""

REFINEMENTS = {Refinement.JUMPS: (0.0, 0.3), Refinement.THRUST_CURVE: (0.0, 0.3)}
"""Refinements, each a parameter: by what share of a step inputs that jump between two samples did so sooner than half
way; and the relative change of the effect for one standard deviation of the inputs."""


class FlightWindows(NamedTuple):
    """Transforms of W windows of a flight, of N samples each, at F frequencies; each without its mean."""

    rate: ComplexArray  # (W, F) rad/s
    # (2 + refinements, r, W, F) in units of the inputs' common standard deviation: inputs but for what answers the rate
    # at the same sample, that, and what each refinement adds for one unit of its parameter
    inputs: ComplexArray
    samples: int  # N
    dt: float  # step, s
    unit: float  # of the inputs, in the unit of the record's

    @classmethod
    def of(
        cls, inputs: Array, rate: Array, answers: Array, dt: float, unit: float = 1.0
    ) -> FlightWindows:
        """Returns the transforms of deviations from the trim (W, N, r), of the rate (W, N) and of what answers it."""
        refined = {
            Refinement.JUMPS: jumping(inputs, 1.0) - inputs,
            Refinement.THRUST_CURVE: inputs**2 / 2,
        }
        channels = np.array([inputs - answers, answers, *(refined[name] for name in REFINEMENTS)])
        transforms = rfft(np.moveaxis(channels, 3, 1)), rfft(rate)
        for transform in transforms:
            transform[..., 0] = 0.0
        return cls(transforms[1], transforms[0], rate.shape[1], dt, unit)

    @property
    def turn(self) -> Array:
        """(F,) frequencies, rad/s."""
        return np.asarray(2 * np.pi / (self.samples * self.dt) * np.arange(self.rate.shape[1]))

    @property
    def folded(self) -> Array:
        """(folds, F) frequencies that a sample cannot tell from them, rad/s."""
        return self.turn + 2 * np.pi / self.dt * FOLDS

    def some(self, windows: slice | Indices) -> FlightWindows:
        """Returns some of them."""
        return self._replace(rate=self.rate[windows], inputs=self.inputs[:, :, windows])


class Parameters(NamedTuple):
    """What the entries of θ are.

    Log effect, deviation of each motor, log damping, log lag, delay; log size and log time of each component of the
    wind; log noise; refinements. The effect of motor i is exp(log effect) · (direction i + deviation i).
    """

    directions: Array  # (r,) mean of magnitudes 1
    deviation: float  # standard deviation beforehand of each motor's effect from its direction
    wind: tuple[Coloured, ...]
    least_noise: float  # rad/s
    refinements: tuple[Refinement, ...] = ()

    @property
    def motors(self) -> int:
        """Number of inputs r."""
        return len(self.directions)

    @property
    def prior(self) -> ArrayPair:
        """Mean and standard deviation (k,)."""
        wind = [each for time in TIMES[: len(self.wind)] for each in (SIZE, time)]
        deviations = [(0.0, self.deviation)] * self.motors
        refined = [REFINEMENTS[name] for name in self.refinements]
        mean, sd = np.array(
            [EFFECT, *deviations, DAMPING, LAG, DELAY_PRIOR, *wind, NOISE, *refined]
        ).T
        return mean, sd

    @property
    def noise_index(self) -> int:
        """Index of the log noise."""
        return self.motors + 4 + 2 * len(self.wind)

    @property
    def logarithms(self) -> list[int]:
        """Indices of logarithms."""
        r = self.motors
        return [0, r + 1, r + 2, *range(r + 4, self.noise_index + 1)]

    def effect(self, thetas: Array) -> Array:
        """Returns (…, r) effect of each motor, rad/s² per unit of ``FlightWindows.inputs``."""
        return np.exp(thetas[..., :1]) * (self.directions + thetas[..., 1 : self.motors + 1])

    def damping(self, thetas: Array) -> Array:
        """Returns (…) damping, 1/s: less than that of any multirotor's rotors in air, ``MAX_DAMPING``."""
        return 1 / (np.exp(-thetas[..., self.motors + 1]) + 1 / MAX_DAMPING)

    def lag(self, thetas: Array, dt: float) -> Array:
        """Returns (…) lag, s: no shorter than half a step, which a stream cannot tell from a delay."""
        return np.hypot(np.exp(thetas[..., self.motors + 2]), RESOLVED_LAG * dt)

    def sizes(self, theta: Array) -> Array:
        """Returns (…, components) standard deviations of the wind's components, rad/s²."""
        return np.exp(theta[..., self.motors + 4 : self.noise_index : 2])

    def times(self, theta: Array) -> Array:
        """Returns (…, components) times of the wind's components, s."""
        return np.exp(theta[..., self.motors + 5 : self.noise_index : 2])

    def noise(self, theta: Array) -> Array:
        """Returns (…) standard deviation of the measured rate's white noise, rad/s."""
        return np.hypot(np.exp(theta[..., self.noise_index]), self.least_noise)

    def driven(self, thetas: Array, windows: FlightWindows) -> ComplexArray:
        """Returns (b, W, F) rate that the motors alone would make, for parameters (b, k)."""
        dt = windows.dt
        # A sample later, and as much as the delay is, interpolated between two samples.
        later = np.exp(-1j * windows.turn * dt)
        whole, share = np.divmod(np.maximum(thetas[:, [self.motors + 3]], 0.0) / dt, 1.0)
        delayed = later**whole * (1 - share + share * later)
        turn = windows.folded
        damping = self.damping(thetas)[:, None, None]
        lag = self.lag(thetas, dt)[:, None, None]
        plant = 1 / (damping - lag * turn**2 + 1j * turn * (1 + damping * lag))
        line = np.sinc(turn * dt / (2 * np.pi))
        # A command that reacts to a sample must not help to predict it: what answers a sample is held from then on.
        hold = min(1.0, ANSWERED_SECONDS / dt) * line * np.exp(-0.5j * turn * dt)
        interpolated, held = (delayed * np.sum(plant * shape, axis=1) for shape in (line**2, hold))
        refined = (interpolated * value[:, None] for value in thetas[:, self.noise_index + 1 :].T)
        added = [2 + list(REFINEMENTS).index(name) for name in self.refinements]
        inputs = windows.inputs[[0, 1, *added]]
        torques = self.effect(thetas).astype(complex) @ inputs.reshape(*inputs.shape[:2], -1)
        torques = torques.reshape(len(inputs), len(thetas), *windows.rate.shape)
        responses = [interpolated, held, *refined]
        return np.einsum("cbwf,cbf->bwf", torques, responses)

    def density(self, thetas: Array, windows: FlightWindows) -> Array:
        """Returns (b, F) density of the rate that wind and noise make, a sample's variance where it is white."""
        components = zip(self.wind, self.sizes(thetas).T, self.times(thetas).T, strict=True)
        wind = [
            colour.density(windows.folded, size[:, None, None], time[:, None, None])
            for colour, size, time in components
        ]
        folded = np.sum(wind, axis=0) / (
            windows.folded**2 + self.damping(thetas)[:, None, None] ** 2
        )
        return folded.sum(axis=1) / windows.dt + self.noise(thetas)[:, None] ** 2

    def innovations(self, thetas: Array, windows: FlightWindows) -> ArrayPair:
        """Returns (b, W, N′) innovations of all windows but for their beginnings, for parameters (b, k).

        Their variance is (b,). They are without their mean in each window, as a constant acceleration explains it.
        """
        factor, variance = minimum_phase(self.density(thetas, windows), windows.samples)
        left = (windows.rate - self.driven(thetas, windows)) / factor[:, None]
        errors = irfft(left, windows.samples)[..., round(SETTLING_SECONDS / windows.dt) + 1 :]
        errors -= errors.mean(axis=-1, keepdims=True)
        return errors, variance


def minimum_phase(density: Array, samples: int) -> tuple[ComplexArray, Array]:
    """Returns the factor (b, F) of densities (b, F) that is causal, as its inverse is; and the variance (b,) it leaves.

    By the cepstrum (Oppenheim and Schafer, Discrete-Time Signal Processing, 3rd ed., ch. 13): a density is |factor|²
    times the variance of what is new in each sample.
    """
    cepstrum = irfft(np.log(density), samples)
    variance = np.exp(cepstrum[:, 0])
    cepstrum[:, 0] = 0.0
    cepstrum[:, samples // 2 + 1 :] = 0.0
    cepstrum[:, (samples + 1) // 2 : samples // 2 + 1] /= 2
    return np.exp(rfft(cepstrum)), variance
