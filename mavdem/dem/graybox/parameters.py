"""Physical parameters (gray-box model): each motor's effect, the damping, and the motors' lag, with wind as a state.

    rate' = −damping · rate + torque + wind,    torque' = (motors · u(t − delay) − torque) / lag,

with torque and wind per moment of inertia, rad/s², and the rate measured with white noise. The wind is coloured noise
of one or two components, whose kind, strength and time constant are estimated, by maximum likelihood of the one-step
prediction errors: consistent in closed loop, as far as the wind's spectrum is right (Ljung, System Identification, 2nd
ed., secs. 8.4, 13.4). See docs/method.md.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter
from scipy.stats import norm

from mavdem.dem.engine.gauss_newton import Damping, Quadratic, resumable_gauss_newton
from mavdem.dem.engine.linalg import Array, inverse, one_thread
from mavdem.dem.engine.model import Transition, discretize
from mavdem.dem.engine.resumable import Resumable, run_to_end
from mavdem.dem.graybox.coloured import FIRST_ORDER, SMOOTH, Coloured
from mavdem.dem.priors import derivative_pairs
from mavdem.dem.record import Record, UniformRecord
from mavdem.dem.validation import LEVEL, require_probability

MAX_WIND_SHARE = 0.1
"""Of the variance of wind and motor torque together: above it a wrong wind spectrum biases the motors' effect."""

MOTORS_ERROR, DAMPING_ERROR, LAG_ERROR = 0.03, 0.3, 0.05
"""Standard deviations of nonlinear effects: as a share of the motors' effect, which changes with the tilt in wind; of
damping, 1/s; and as a share of the lag, since rotors spin up twice as fast as they slow down. By so much
simulated flights differ from the same vehicle linearised, sampled at every step of their controller."""

SETTLING_SECONDS = 0.2  # of each segment, whose prediction errors do not count: the filter finds the state
MIN_SAMPLES, MAX_SAMPLES = 200, 5000  # in all; of longer records the first so many are used
MAX_ITERATIONS, CONVERGED_NATS = 60, 5e-3  # Gauss-Newton steps at most, and the gain below which they have converged
LONGEST_STEP = 0.7  # of any logarithm, in one step
RELATIVE_STEP = 1e-4  # of a parameter, or of 0.01 if that is more: for slopes by differences
MAX_DOUBLINGS = 40  # of the steps over which the filter becomes steady


class WindComponent(NamedTuple):
    """One component of the wind: noise of this ``colour`` with standard deviation ``size``, rad/s², and ``time``, s."""

    colour: Coloured
    size: float
    time: float


class Physical(NamedTuple):
    """Physical parameters of one axis.

    Attributes:
        motors: (r,) effect of each motor on the angular acceleration in steady state, rad/s² per unit of input.
        damping: of the rate by itself, 1/s.
        lag: time constant of the motors, s.
        delay: of their commands, s; dead time of the stream is in it.
        covariance: (r + 2, r + 2) of motors, damping and lag, nonlinear effects included.
        wind: standard deviation of the angular acceleration that is not by the motors, rad/s².
        wind_share: of its variance in the sum with that of the motors' torque.
        components: of the wind.
    """

    motors: Array
    damping: float
    lag: float
    delay: float
    covariance: Array
    wind: float
    wind_share: float
    components: tuple[WindComponent, ...]

    @property
    def identifiable(self) -> bool:
        """Whether motors' effects can be separated from wind."""
        return bool(self.wind_share <= MAX_WIND_SHARE)

    @property
    def told(self) -> bool:
        """Deprecated name of :attr:`identifiable`."""
        warnings.warn("Physical.told is now Physical.identifiable", DeprecationWarning, stacklevel=2)
        return self.identifiable

    @property
    def caution(self) -> str | None:
        """Why no interval is given; ``None`` where there is one."""
        if self.identifiable:
            return None
        return (
            "Motor effect, damping and lag are not identifiable: the inputs are correlated with the wind (closed "
            f"loop), which has {self.wind_share:.0%} of the torque's variance. Fly quick inputs on the axis "
            f"(doublets, or a sweep of about 3°) in calm air, until the wind's share is {MAX_WIND_SHARE:.0%} or less."
        )

    def interval(self, level: float = LEVEL) -> tuple[Array, float, float]:
        """Half widths for motors (r,), damping and lag of intervals that hold each with probability ``level``.

        Returns:
            NaN throughout where they are not identifiable.

        Raises:
            ValueError: a level that is no probability between 0 and 1.
        """
        require_probability(level)
        half = norm.ppf(0.5 + level / 2) * np.sqrt(self.covariance.diagonal()) * (1.0 if self.identifiable else np.nan)
        return half[:-2], float(half[-2]), float(half[-1])


WINDS = ((FIRST_ORDER,), (FIRST_ORDER, SMOOTH), (SMOOTH, SMOOTH))
"""Winds to choose from: turbulence, turbulence with smooth gusts, two kinds of smooth gusts, the slow ones first."""

MOTORS_SD = 20.0  # rad/s² per standard deviation of each input

DAMPING, LOG_LAG, DELAY = (2.0, 3.0), (np.log(0.03), 1.0), (0.006, 0.004)
LOG_SIZE, LOG_NOISE, TRIM = (np.log(0.5), 1.5), (np.log(0.005), 2.0), (0.0, 0.1)
"""Mean and standard deviation beforehand, in s, rad/s and rad/s²: as of common multirotors and their autopilots."""

LOG_TIMES = ((np.log(1.0), 1.0), (np.log(0.07), 1.0))
"""Likewise of the time of each component of the wind: the drift of the air, and gusts."""


class _Data(NamedTuple):
    """Segments in the units of the fit."""

    segments: tuple[tuple[Array, Array], ...]  # inputs (T, r) and rate (T,) of each
    dt: float

    @property
    def settle(self) -> int:
        return round(SETTLING_SECONDS / self.dt)

    def first(self, samples: int) -> _Data:
        """The first so many samples, of segments that are long enough."""
        kept = []
        for inputs, measured in self.segments:
            if min(len(measured), samples) > 2 * self.settle + 1:
                kept.append((inputs[:samples], measured[:samples]))
                samples -= len(kept[-1][1])
        return self._replace(segments=tuple(kept))


class _Parameters(NamedTuple):
    """Parameters: motors, damping, log lag, delay, log size and log time of each component, log noise, trim."""

    motors: int
    wind: tuple[Coloured, ...]

    @property
    def prior(self) -> tuple[Array, Array]:
        """Mean and standard deviation (k,)."""
        of_wind = [each for time in LOG_TIMES[: len(self.wind)] for each in (LOG_SIZE, time)]
        of_motors = [(0.0, MOTORS_SD)] * self.motors
        mean, sd = np.array([*of_motors, DAMPING, LOG_LAG, DELAY, *of_wind, LOG_NOISE, TRIM]).T
        return mean, sd

    @property
    def logarithms(self) -> NDArray[np.intp]:
        """Places of logarithms."""
        return np.append(self.motors + 1, np.arange(self.motors + 3, self.motors + 4 + 2 * len(self.wind)))

    def sizes(self, theta: Array) -> Array:
        """(…, components) standard deviations of the wind's components."""
        return np.exp(theta[..., self.motors + 3 : -2 : 2])

    def filters(self, thetas: Array, dt: float) -> tuple[Transition, Array, Array]:
        """Transition, gain (b, n) and variance (b,) of the innovations of the steady filter, for parameters (b, k)."""
        r = self.motors
        n = 2 + sum(len(each.A) for each in self.wind)
        A, B, drive = (np.zeros((len(thetas), n, width)) for width in (n, r, n))
        rate = np.exp(-thetas[:, r + 1])
        A[:, 0, 0], A[:, 0, 1], A[:, 1, 1] = -thetas[:, r], 1.0, -rate
        B[:, 1] = thetas[:, :r] * rate[:, None]
        start = 2
        for each, size, time in zip(self.wind, self.sizes(thetas).T, thetas[:, r + 4 : -2 : 2].T, strict=True):
            of = slice(start, start + len(each.A))
            A[:, of, of] = each.A * np.exp(-time)[:, None, None]
            drive[:, of, of] = each.drive * np.exp(-time)[:, None, None]
            A[:, 0, of] = each.C * size[:, None]
            start = of.stop
        transition = discretize(A, B, dt)
        # Van Loan, "Computing integrals involving the matrix exponential", 1978.
        flow = expm(np.block([[-A, drive], [np.zeros_like(A), np.swapaxes(A, 1, 2)]]) * dt)
        process = np.swapaxes(flow[:, n:, n:], 1, 2) @ flow[:, :n, n:]
        noise = np.exp(2 * thetas[:, -2])
        P = _steady_covariance(transition.state, process, noise)
        variance = P[:, 0, 0] + noise
        return transition, (transition.state @ P[:, :, :1])[:, :, 0] / variance[:, None], variance

    def innovations(self, thetas: Array, data: _Data) -> tuple[Array, Array]:
        """(b, T′) of all segments but for their beginnings, and their variance (b,)."""
        transition, gain, variance = self.filters(thetas, data.dt)
        step = transition.state.copy()
        step[:, :, 0] -= gain
        step = np.swapaxes(step, 1, 2)
        now, later = (np.swapaxes(each, 1, 2) for each in transition[1:])
        trim, found = thetas[:, -1:], []
        for inputs, measured in data.segments:
            off = measured - trim
            before, after = zip(
                *(delayed(inputs, delay / data.dt) for delay in thetas[:, self.motors + 2]), strict=True
            )
            drive = np.array(before) @ now + np.array(after) @ later + off[:, :-1, None] * gain[:, None]
            rows = np.ascontiguousarray(np.swapaxes(drive, 0, 1))[:, :, None]
            x = np.zeros((len(thetas), 1, gain.shape[1]))
            x[:, 0, 0] = off[:, 0]
            predicted = np.empty((len(rows), len(thetas)))
            for k, row in enumerate(rows):
                x = x @ step + row
                predicted[k] = x[:, 0, 0]
            found.append((off[:, 1:] - predicted.T)[:, data.settle :])
        return np.concatenate(found, axis=1), variance


def delayed(inputs: Array, steps: float) -> tuple[Array, Array]:
    """Commands (T − 1, r) as they act at the beginning and the end of each step, interpolated.

    A command that reacts to a sample must not help to predict it: within a step the last command before it holds.
    """
    last = np.arange(len(inputs) - 1, dtype=np.float64)
    ends = []
    for place in (last - max(steps, 0.0), last + min(1 - steps, 0.0)):
        whole = np.floor(place)
        share = (place - whole)[:, None]
        at = whole.astype(np.intp)
        low, high = np.maximum(at, 0), np.clip(at + 1, 0, len(inputs) - 1)
        ends.append((1 - share) * inputs[low] + share * inputs[high])
    return ends[0], ends[1]


def _steady_covariance(F: Array, process: Array, noise: Array) -> Array:
    """(b, n, n) of the predicted state, of the steady filter; the first state is measured with ``noise`` (b,).

    By doubling of the steps (Anderson, "Second-order convergent algorithms for the steady-state Riccati equation",
    International Journal of Control 28, 1978).
    """
    across, gained, P = np.swapaxes(F, 1, 2), np.zeros_like(F), process
    gained[:, 0, 0] = 1 / noise
    for _ in range(MAX_DOUBLINGS):
        solved = np.linalg.inv(np.eye(F.shape[-1]) + gained @ P)
        half = across @ solved
        back = np.swapaxes(across, 1, 2)
        doubled = P + back @ P @ solved @ across
        gained = gained + half @ gained @ back
        across = half @ across
        done = np.abs(doubled - P).max() <= 1e-11 * np.abs(doubled).max()
        P = (doubled + np.swapaxes(doubled, 1, 2)) / 2
        if done:
            break
    return P


class _LogJoint(NamedTuple):
    """The log joint of the innovations and the parameters, an ``Objective`` of Fisher's scoring."""

    parameters: _Parameters
    data: _Data

    def resumable_value(self, at: Array) -> Resumable[tuple[float, Array]]:
        """The value, and the innovations (T′,)."""
        yield from ()
        errors, _, value = self._evaluated(at[None])
        return value, errors[0]

    def resumable_quadratic(self, at: Array, residuals: Array) -> Resumable[Quadratic]:
        """By differences, all at once, so that ``residuals`` are not needed; ``LinAlgError`` if no filter is steady."""
        yield from ()
        mean, sd = self.parameters.prior
        steps = RELATIVE_STEP * np.maximum(0.01, np.abs(at))
        errors, variance, value = self._evaluated(np.vstack([at, at + np.diag(steps)]))
        own, size, number = errors[0], variance[0], errors.shape[1]
        of_errors, of_size = (errors[1:] - own) / steps[:, None], (variance[1:] - size) / steps / size
        slope = of_errors @ own / size + 0.5 * of_size * (number - own @ own / size) + (at - mean) / sd**2
        information = of_errors @ of_errors.T / size + 0.5 * number * np.outer(of_size, of_size) + np.diag(sd**-2.0)
        if not (np.isfinite(value) and np.isfinite(information).all()):
            raise np.linalg.LinAlgError("there is no steady filter")
        return Quadratic(at, value, -slope, information)

    def limited(self, step: Array) -> Array:
        """A step that changes no logarithm by more than ``LONGEST_STEP``."""
        return np.asarray(step * min(1.0, LONGEST_STEP / np.abs(step[self.parameters.logarithms]).max()))

    def _evaluated(self, thetas: Array) -> tuple[Array, Array, float]:
        """Innovations and their variance for parameters (b, k), and the log joint of the first."""
        mean, sd = self.parameters.prior
        with np.errstate(all="ignore"):
            errors, variance = self.parameters.innovations(thetas, self.data)
            loss = 0.5 * errors[0] @ errors[0] / variance[0] + 0.5 * errors.shape[1] * np.log(variance[0])
            return errors, variance, -float(loss + 0.5 * np.sum(((thetas[0] - mean) / sd) ** 2))


def _fitted(parameters: _Parameters, data: _Data) -> tuple[float, Quadratic]:
    """Laplace's evidence of a wind, and the log joint about the most probable parameters.

    ``LinAlgError`` where there is no steady filter at the prior's mean.
    """
    objective, (mean, sd) = _LogJoint(parameters, data), parameters.prior
    damping = Damping(first=1e-2, factor=6.0, attempts=12, limited=objective.limited, careful=True)
    start = run_to_end(objective.resumable_quadratic(mean, np.empty(0)))
    trace, _ = run_to_end(resumable_gauss_newton(objective, start, damping, MAX_ITERATIONS, CONVERGED_NATS))
    best = trace[-1]
    return best.value - 0.5 * float(np.linalg.slogdet(best.curvature)[1]) - float(np.log(sd).sum()), best


def physical(train: UniformRecord | Sequence[UniformRecord]) -> Physical:
    """Estimates the motors' effect, damping and lag from a flight whose outputs include an angle and its rate.

    Takes about half a second for 700 samples. Forecasts do not use it.

    Args:
        train: a ``Flight``, or a list of them, segments with gaps between: rates in rad/s.

    Raises:
        ValueError: no output is the rate of another, there are too few samples, no motor moves, or there is no steady
            filter.
    """
    record = Record.of(train)
    pairs = derivative_pairs(record)
    if not pairs:
        raise ValueError("physical parameters need an angle and its rate: no output is the derivative of another")
    spread = record.inputs.std(axis=0)
    if not spread.any():
        raise ValueError("physical parameters need motors that move: all inputs are constant")
    unit = np.where(spread > 0, spread, 1.0)
    rate = record.outputs[:, pairs[0][1]]
    whole = _Data(
        tuple(
            ((inputs - record.inputs.mean(axis=0)) / unit, outputs[:, pairs[0][1]] - rate.mean())
            for inputs, outputs in record.segments
        ),
        record.dt,
    )
    data = whole.first(MAX_SAMPLES)
    samples = sum(len(measured) for _, measured in data.segments)
    if samples < MIN_SAMPLES:
        raise ValueError(f"physical parameters need at least {MIN_SAMPLES} samples without long gaps, not {samples}")
    found = []
    with one_thread():
        for wind in WINDS:
            try:
                parameters = _Parameters(len(unit), wind)
                found.append((*_fitted(parameters, data), parameters))
            except (np.linalg.LinAlgError, ValueError):
                continue
    if not found:
        raise ValueError("there is no steady filter for these motors and rates: take another part of the flight")
    _, best, parameters = max(found, key=lambda each: each[0])
    return _physical(parameters, best, data, unit)


def _physical(parameters: _Parameters, best: Quadratic, data: _Data, unit: Array) -> Physical:
    r, theta = len(unit), best.at
    motors, damping, lag, delay = theta[:r], float(theta[r]), float(np.exp(theta[r + 1])), float(theta[r + 2])
    scale = np.concatenate([1 / unit, [1.0, lag]])
    covariance: Array = inverse(best.curvature)[: r + 2, : r + 2] * np.outer(scale, scale)
    covariance[:r, :r] += MOTORS_ERROR**2 * np.outer(motors / unit, motors / unit)
    covariance[r, r] += DAMPING_ERROR**2
    covariance[-1, -1] += (LAG_ERROR * lag) ** 2
    keeps = np.exp(-data.dt / lag)
    torque = np.concatenate([lfilter([1 - keeps], [1, -keeps], inputs @ motors) for inputs, _ in data.segments])
    wind = float(np.sum(parameters.sizes(theta) ** 2))
    share = wind / (wind + float(torque.var()))
    times = np.exp(theta[r + 4 : -2 : 2])
    components = tuple(
        WindComponent(colour, float(size), float(time))
        for colour, size, time in zip(parameters.wind, parameters.sizes(theta), times, strict=True)
    )
    return Physical(motors / unit, damping, lag, delay, covariance, float(np.sqrt(wind)), share, components)
