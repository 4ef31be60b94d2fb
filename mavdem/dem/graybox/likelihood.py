"""The likelihood of the gray-box model: one-step prediction errors of windows of a flight, all windows at once.

    rate' = −damping · rate + torque + constant + wind,    torque' = (effect · u(t − delay) − torque) / lag,

torque and wind per moment of inertia, rad/s², the rate measured with white noise. The wind is coloured noise of one or
two components. Each window has a constant of its own, which balances its trim, and a level of its own of wind and noise
together; both are solved for. What remains is the same in all windows. Maximising the likelihood of the one-step
prediction errors is consistent in closed loop as far as the wind's spectrum is right (Ljung, System Identification, 2nd
ed., secs. 8.4, 13.4). The same plant, sampled, is what the wind's torque is smoothed with once its parameters are
known.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import factorial
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import expm, solve_continuous_lyapunov

from mavdem.dem.closed_loop.spectra import Complex
from mavdem.dem.engine.kalman import SteadyFilter, SteadySmoothed, steady_gain
from mavdem.dem.engine.linalg import Array, Indices, Pair
from mavdem.dem.engine.model import Transition, discretize
from mavdem.dem.graybox.identifiability import RESOLVED_LAG
from mavdem.facts.model import Refinement


class Coloured(NamedTuple):
    """Stationary noise of variance 1, y = C x with ẋ = A x + white noise, in units of its own time."""

    A: Array  # (k, k)
    drive: Array  # (k, k) intensity of the white noise
    C: Array  # (k,)


def step_covariance(A: Array, drive: Array, dt: float) -> Array:
    """(…, n, n) covariance that white noise of intensity ``drive`` (…, n, n) adds to ẋ = A x in a step of ``dt`` s.

    Van Loan, "Computing integrals involving the matrix exponential", 1978.
    """
    n = A.shape[-1]
    flow = expm(np.block([[-A, drive], [np.zeros_like(A), A.mT]]) * dt)
    return flow[..., n:, n:].mT @ flow[..., :n, n:]


def _autoregressive(coefficients: Array) -> Coloured:
    """Of a denominator with the leading coefficient 1, highest power first, each state of variance 1."""
    order = len(coefficients) - 1
    A = np.eye(order, k=1)
    A[-1] = -coefficients[:0:-1]
    drive = np.zeros((order, order))
    drive[-1, -1] = 1.0
    size = np.sqrt(solve_continuous_lyapunov(A, -drive).diagonal())
    drive[-1, -1] /= size[-1] ** 2
    return Coloured(A * size / size[:, None], drive, np.eye(order)[0])


def smooth(order: int) -> Coloured:
    """Returns noise of the Gaussian kernel whose width is the unit of time, of spectrum exp(−ω²).

    1/exp(ω²) by Taylor's series in the denominator: Hartikainen and Särkkä, "Kalman filtering and smoothing solutions
    to temporal Gaussian process regression models", MLSP 2010, sec. 3.3.
    """
    series = np.zeros(2 * order + 1)
    series[::2] = [(-1) ** power / factorial(power) for power in range(order, -1, -1)]
    roots = np.roots(series)
    return _autoregressive(np.real(np.poly(roots[roots.real < 0])))


# autocorrelation exp(−|τ|): turbulence along its mean wind
FIRST_ORDER = _autoregressive(np.ones(2))

GUSTS = smooth(4)
"""Autocorrelation exp(−τ²/4), nearly: noise with a Gaussian kernel, the noise of generalized coordinates (Eq.
``Smatrix``), to an order that is enough for the spectrum where there is power."""

# of each window, whose prediction errors do not count: the filter finds the state
SETTLING_SECONDS = 0.25
# for which an autopilot answers one sample of the rate: then it has the next
ANSWERED_SECONDS = 0.004
MAX_DAMPING = 25.0  # 1/s: five times that of the smallest published vehicles

EFFECT = (0.0, 2.0)
DAMPING = (np.log(2.0), 1.0)
LAG = (np.log(0.03), 1.0)
DELAY = (0.006, 0.004)
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
    """W windows of a flight, of N samples each."""

    inputs: Array  # (W, N, r) deviations from the trim, in units of their common standard deviation
    rate: Array  # (W, N) rad/s
    dt: float  # step, s
    unit: float  # of the inputs, in the unit of the record's
    # (W, N, r) of the inputs, what answers what is new in the rate at the same sample
    answers: Array

    def of(self, some: slice | Indices) -> FlightWindows:
        """Returns some of them."""
        return self._replace(
            **{name: getattr(self, name)[some] for name in ("inputs", "rate", "answers")}
        )


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
    def prior(self) -> Pair:
        """Mean and standard deviation (k,)."""
        wind = [each for time in TIMES[: len(self.wind)] for each in (SIZE, time)]
        deviations = [(0.0, self.deviation)] * self.motors
        refined = [REFINEMENTS[name] for name in self.refinements]
        mean, sd = np.array([EFFECT, *deviations, DAMPING, LAG, DELAY, *wind, NOISE, *refined]).T
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
        """(…, r) effect of each motor, rad/s² per unit of ``FlightWindows.inputs``."""
        return np.exp(thetas[..., :1]) * (self.directions + thetas[..., 1 : self.motors + 1])

    def damping(self, thetas: Array) -> Array:
        """(…) damping, 1/s: less than that of any multirotor's rotors in air, ``MAX_DAMPING``."""
        return 1 / (np.exp(-thetas[..., self.motors + 1]) + 1 / MAX_DAMPING)

    def lag(self, thetas: Array, dt: float) -> Array:
        """(…) lag, s: no shorter than half a step, which a stream cannot tell from a delay."""
        return np.hypot(np.exp(thetas[..., self.motors + 2]), RESOLVED_LAG * dt)

    def sizes(self, theta: Array) -> Array:
        """(…, components) standard deviations of the wind's components, rad/s²."""
        return np.exp(theta[..., self.motors + 4 : self.noise_index : 2])

    def times(self, theta: Array) -> Array:
        """(…, components) their times, s."""
        return np.exp(theta[..., self.motors + 5 : self.noise_index : 2])

    def filters(self, thetas: Array, dt: float) -> tuple[Plant, Array, Array]:
        """Plant, gain (b, n, 1) and variance (b,) of the innovations of the steady filter, for parameters (b, k)."""
        components = zip(self.wind, self.sizes(thetas).T, self.times(thetas).T, strict=True)
        of = plant(self.damping(thetas), self.lag(thetas, dt), list(components), dt)
        noise = np.exp(2 * thetas[:, self.noise_index]) + self.least_noise**2
        seen = np.eye(1, of.process.shape[-1])
        gain, covariance = steady_gain(of.step.state, seen, of.process, noise[:, None, None])
        return of, gain, covariance[:, 0, 0] + noise

    def _refined(self, values: Array, inputs: Array) -> Array:
        """(W, N, r) inputs with refinements of these ``values``."""
        for name, value in zip(self.refinements, values, strict=True):
            jumps = name is Refinement.JUMPS
            inputs = jumping(inputs, value) if jumps else inputs + value * inputs**2 / 2
        return inputs

    def commanded(self, theta: Array, windows: FlightWindows) -> Array:
        """(W, N) the torque that the motors would settle at, rad/s², refinements included."""
        return self._refined(theta[self.noise_index + 1 :], windows.inputs) @ self.effect(theta)

    def _driven(self, thetas: Array, windows: FlightWindows) -> Iterator[Array]:
        """(2, W, N − 1) torque that drives the filter, at both ends of each step, for each of parameters (b, k)."""
        refined = dict[bytes, Array]()
        for theta in thetas:
            values = theta[self.noise_index + 1 :]
            same = values.tobytes()
            if same not in refined:
                refined[same] = self._refined(values, windows.inputs)
            steps = float(theta[self.motors + 3]) / windows.dt
            effect = self.effect(theta)
            # A command that reacts to a sample must not help to predict it: what answers a sample is held from then on.
            answer = windows.answers @ effect
            held, _ = delayed(min(1.0, ANSWERED_SECONDS / windows.dt) * answer.T, steps)
            ends = delayed((refined[same] @ effect - answer).T, steps)
            yield np.array([(part + held).T for part in ends])

    def innovations(self, thetas: Array, windows: FlightWindows) -> Pair:
        """(b, W, N′) of all windows but for their beginnings, for parameters (b, k); and their variance (b,).

        They are without what a constant acceleration in each window explains. What parameters share, their filter or
        their torque, is made once.
        """
        of_filter = np.isin(np.arange(thetas.shape[1]), self.logarithms[1:])
        filters, torques = (_alike(thetas[:, of]) for of in (of_filter, ~of_filter))
        of, gain, variance = self.filters(thetas[filters[0]], windows.dt)
        step = of.step.state.copy()
        step[:, :, :1] -= gain
        number = windows.rate.shape[1] - 1
        # A state at the beginning acts like an input that nothing follows: the first rate, and a steady torque.
        gains = np.concatenate(
            [of.step.input_now, of.step.input_next, gain, step[:, :, :2]], axis=2
        )
        effects = gains.mT @ responses(step, number).mT
        # A constant acceleration of 1 rad/s² acts like a steady torque.
        steady = np.cumsum(effects[:, 0] + effects[:, 1], axis=1) + effects[:, 4]
        settled = round(SETTLING_SECONDS / windows.dt)
        # What rounding hides is left out, so that transforms are short.
        sizes = abs(effects[:, :4]).max(axis=(0, 1))
        hidden = sizes <= np.finfo(np.float64).eps * sizes.max()
        lasting = number - int(hidden[::-1].argmin())
        length = next_fast_len(number + lasting, real=True)
        transforms = rfft(effects[:, :4, :lasting], length)
        rate = rfft(windows.rate[:, :-1], length)
        errors = np.empty((len(thetas), len(rate), number - settled))
        # One after the other: all at once are too large for the processor's cache.
        for torque, driven in enumerate(self._driven(thetas[torques[0]], windows)):
            inputs = [*rfft(driven, length), rate, windows.rate[:, :1]]
            for column in np.flatnonzero(torques[1] == torque):
                filtered = filters[1][column]
                predicted = convolved(inputs, transforms[filtered], length)[:, settled:number]
                left = windows.rate[:, settled + 1 :] - predicted
                response = steady[filtered, settled:]
                share = left @ response / (response @ response)
                np.subtract(left, share[:, None] * response, out=errors[column])
        return errors, variance[filters[1]]


def _alike(rows: Array) -> tuple[list[int], Indices]:
    """The first of each kind of equal ``rows`` (b, k), and of which kind each is (b,)."""
    keys = [row.tobytes() for row in rows]
    kinds = [*dict.fromkeys(keys)]
    return [keys.index(kind) for kind in kinds], np.array([kinds.index(key) for key in keys])


def responses(step: Array, number: int) -> Array:
    """(b, N, n) rows [1, 0, …] · stepᵏ, k = 0 … N − 1, of b models (b, n, n), N the ``number``.

    Of x_{k+1} = step x_k + gain · input_k they give what an input does to the first state, any number of steps later.
    """
    rows = np.tile(np.eye(1, step.shape[-1]), (len(step), 1, 1))
    while rows.shape[1] < number:
        rows = np.concatenate([rows, rows @ step], axis=1)
        step = step @ step
    return rows[:, :number]


def convolved(inputs: Sequence[Complex], effects: Complex, length: int) -> Array:
    """(W, length) sum of c inputs (c, W, F), each convolved with its effects (c, F), of their transforms."""
    both = sum(each * effect for each, effect in zip(inputs, effects, strict=True))
    return np.asarray(irfft(both, length))


def jumping(inputs: Array, sooner: float) -> Array:
    """(W, N, r) inputs whose jumps between two samples come ``sooner`` than half way, in shares of a step.

    A jump is what a change has beyond the one before it, and of it alone where their signs differ.
    """
    changes = np.diff(inputs, axis=1, prepend=inputs[:, :1])
    before = np.concatenate([np.zeros_like(changes[:, :1]), changes[:, :-1]], axis=1)
    return np.asarray(
        inputs
        + sooner * (changes - np.clip(before, np.minimum(changes, 0.0), np.maximum(changes, 0.0)))
    )


def delayed(inputs: Array, steps: float) -> Pair:
    """Commands (T − 1, r) as they act at the beginning and the end of each step, interpolated."""
    whole = int(min(max(0.0, steps), len(inputs)))
    share = min(max(0.0, steps) - whole, 1.0)
    later = np.concatenate([np.repeat(inputs[:1], whole + 1, axis=0), inputs])[: len(inputs) + 1]
    moved = (1 - share) * later[1:] + share * later[:-1]
    return moved[:-1], moved[1:]


class Plant(NamedTuple):
    """x⁺ = Φ x + Γ₀ c + Γ₁ c⁺ + noise, with the state x = [rate, torque, wind's states] and the commanded torque c."""

    step: Transition  # it has one input, c in rad/s²
    process: Array  # (n, n) covariance of the noise, which drives the wind
    wind: Array  # (n,) the wind's torque, rad/s², out of a state
    jumps: float  # share of a step by which commands that jump do so sooner than half way

    def pushes(self, commanded: Array, steps: float) -> Array:
        """Returns (T − 1, n) what commands (T,), rad/s², that act so many ``steps`` later do to the next state."""
        early, late = delayed(jumping(commanded[None, :, None], self.jumps)[0], steps)
        return early * self.step.input_now[:, 0] + late * self.step.input_next[:, 0]

    def filter(self, noise: float) -> SteadyFilter:
        """Returns the steady filter of a rate measured with white ``noise``, rad/s; ``LinAlgError`` without one."""
        return SteadyFilter.of(self.step.state, self.process, noise)

    def smoothed(
        self,
        steady: SteadyFilter,
        commanded: Array,
        steps: float,
        rate: Array,
    ) -> SteadySmoothed:
        """Returns the wind's torque in a segment, rad/s², from all of its ``rate`` (T,), rad/s, by a ``steady`` filter.

        At its beginning the motors have settled at what is commanded, with all that is steady, and there is no wind.
        """
        first = np.zeros(len(self.wind))
        first[:2] = rate[0], commanded[0]
        return steady.smoothed(self.pushes(commanded, steps), rate, first, self.wind)


def plant(
    damping: Array | float,
    lag: Array | float,
    components: Sequence[tuple[Coloured, Array | float, Array | float]],
    dt: float,
    jumps: float = 0.0,
) -> Plant:
    """The plant with ``damping``, 1/s, ``lag``, s, and wind, sampled every ``dt`` seconds.

    ``components`` of the wind are colour, standard deviation in rad/s² (…), and time in s (…) of each. Of several (…)
    side by side its arrays have these axes first.
    """
    shape = np.shape(damping)
    n = 2 + sum(len(colour.A) for colour, _, _ in components)
    A, drive = np.zeros((2, *shape, n, n))
    B = np.zeros((*shape, n, 1))
    wind = np.zeros((*shape, n))
    start = 2
    for colour, size, time in components:
        states = slice(start, start + len(colour.A))
        pace = 1 / np.asarray(time)[..., None, None]
        A[..., states, states] = colour.A * pace
        drive[..., states, states] = colour.drive * pace
        wind[..., states] = colour.C * np.asarray(size)[..., None]
        start = states.stop
    A[..., 0, :] = wind
    A[..., 0, 0] = -np.asarray(damping)
    A[..., 0, 1] = 1.0
    B[..., 1, 0] = 1 / np.asarray(lag)
    A[..., 1, 1] = -B[..., 1, 0]
    process = step_covariance(A, drive, dt)
    process = (process + process.mT) / 2
    return Plant(discretize(A, B, dt), process, wind, jumps)
