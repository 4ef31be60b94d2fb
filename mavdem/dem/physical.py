"""Physical reading: what each motor does, how the axis is damped and how late the motors are, in wind that is a state.

A third view of the flight, of few parameters and none of them free of meaning:

    rate' = −damping · rate + torque + wind,    torque' = (motors · u(t − delay) − torque) / lag,

with the torque and the wind per moment of inertia, rad/s², and the rate measured with white noise. The wind is coloured
noise of one or two components; which, how strong and how slow is learnt. Where motors answer the wind (closed loop),
least squares takes their answer for their effect. What they answer is past, however, and what errs here is the
prediction of each sample from those before it: maximum likelihood of these innovations is consistent in closed loop as
far as the wind's colour is right (Ljung, System Identification, 2nd ed., secs. 8.4, 13.4). So the smooth component has
the kernel of generalized coordinates' noise, of which rational spectra are no good likeness.

No colour is quite right, and a controller that sees the vehicle drift knows more of the wind than the rate tells. That
biases the motors' effect where nothing but wind moves them, by a quarter and more; so the reading says which share of
the torque is the wind's, and tells no interval where that is more than a tenth.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter
from scipy.stats import norm

from mavdem.dem.coloured import FIRST_ORDER, SMOOTH, Coloured
from mavdem.dem.level import require_probability
from mavdem.dem.model import Transition, discretize
from mavdem.dem.one_thread import one_thread
from mavdem.dem.positive import inverse
from mavdem.dem.priors import derivative_pairs
from mavdem.dem.record import Record, Recorded

Array = NDArray[np.float64]

ANSWERS = 0.1
"""Share that the wind may have of both torques' variance, its own and the motors', or the one cannot be told from the
other: the more it has, the further a wrong colour leads the motors' effect astray."""

MOTORS_ERROR, DAMPING_ERROR, LAG_ERROR = 0.03, 0.3, 0.05
"""Standard deviations of what no linear model knows: as a share of the motors' effect, which is another in wind, where
a vehicle hovers tilted; of damping, 1/s, and as a share of the lag, where rotors spin up twice as fast as they slow
down. By so much simulated flights differ from the same vehicle linearised, read at every step of their controller."""

SETTLE = 0.2
"""Seconds of each segment whose innovations do not count: the filter finds the state."""

FEWEST, MOST = 200, 5000
"""Samples in all; of longer records the first so many are read."""

ROUNDS, REJECTIONS, SETTLED = 60, 12, 5e-3
"""Steps at most, times that each is damped more, and nats that are next to nothing."""

LONGEST_STEP = 0.7
"""Of any logarithm, in one step."""

NUDGE = 1e-4
"""Of a parameter, or of 0.01 if that is more: for slopes by differences."""

DOUBLINGS = 40
"""At most, of the steps over which the filter has settled."""


class Physical(NamedTuple):
    """What was read from a flight.

    Attributes:
        motors: (r,) effect of each motor on the angular acceleration once it has settled, rad/s² per unit of input.
        damping: of the rate by itself, 1/s.
        lag: time constant of the motors, s.
        delay: of their commands, s; dead time of the stream is in it.
        covariance: (r + 2, r + 2) of motors, damping and lag, with what no linear model knows.
        wind: standard deviation of the angular acceleration that is not by the motors, rad/s².
        wind_share: of its variance in the sum with that of what the motors make.
    """

    motors: Array
    damping: float
    lag: float
    delay: float
    covariance: Array
    wind: float
    wind_share: float

    @property
    def told(self) -> bool:
        """Whether motors' effects can be told from wind."""
        return bool(self.wind_share <= ANSWERS)

    @property
    def caution(self) -> str | None:
        """What a user must know before reading motors' effects; ``None`` where they are told."""
        if self.told:
            return None
        return (
            "Motor effect, damping and lag cannot be told: the motors answer the wind, which has "
            f"{self.wind_share:.0%} of the torque's variance. Let the vehicle steer, until that is {ANSWERS:.0%}."
        )

    def interval(self, level: float = 0.9) -> tuple[Array, float, float]:
        """Half widths for motors (r,), damping and lag of intervals that hold each with probability ``level``.

        Args:
            level: probability, between 0 and 1.

        Returns:
            NaN throughout where they cannot be told from wind.

        Raises:
            ValueError: a level that is no probability between 0 and 1.
        """
        require_probability(level)
        half = norm.ppf(0.5 + level / 2) * np.sqrt(self.covariance.diagonal()) * (1.0 if self.told else np.nan)
        return half[:-2], float(half[-2]), float(half[-1])


WINDS = ((FIRST_ORDER,), (FIRST_ORDER, SMOOTH), (SMOOTH, SMOOTH))
"""What is tried: turbulence, turbulence with smooth gusts, and two kinds of smooth gusts, the slow ones first."""

MOTORS_SD = 20.0
"""rad/s² per standard deviation of each input."""

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
        return round(SETTLE / self.dt)

    def first(self, samples: int) -> _Data:
        """The first so many samples, of segments that are long enough."""
        kept = []
        for inputs, measured in self.segments:
            if min(len(measured), samples) > 2 * self.settle + 1:
                kept.append((inputs[:samples], measured[:samples]))
                samples -= len(kept[-1][1])
        return self._replace(segments=tuple(kept))


class _View(NamedTuple):
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
        """Transition, gain (b, n) and variance (b,) of the innovations of the settled filter, for parameters (b, k)."""
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
        P = _settled_covariance(transition.state, process, noise)
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
                *(_delayed(inputs, delay / data.dt) for delay in thetas[:, self.motors + 2]), strict=True
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


def _delayed(inputs: Array, steps: float) -> tuple[Array, Array]:
    """Commands (T − 1, r) as they act at the beginning and the end of each step, interpolated.

    A command that answers a sample must not help to predict it: within a step the last one that was given before it
    holds.
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


def _settled_covariance(F: Array, process: Array, noise: Array) -> Array:
    """(b, n, n) of the state, predicted one step, once the filter has settled; the first state is measured.

    By doubling of the steps (Anderson, "Second-order convergent algorithms for the steady-state Riccati equation",
    International Journal of Control 28, 1978).

    Args:
        F, process: (b, n, n) of the state's step.
        noise: (b,) variance of the measurement's.
    """
    across, gained, P = np.swapaxes(F, 1, 2), np.zeros_like(F), process
    gained[:, 0, 0] = 1 / noise
    for _ in range(DOUBLINGS):
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


class _Found(NamedTuple):
    """Where a climb ended."""

    view: _View
    theta: Array
    information: Array
    evidence: float


def _climbed(view: _View, data: _Data) -> _Found:
    """The most probable parameters, by Fisher's scoring with Levenberg and Marquardt's damping; Laplace's evidence.

    Raises:
        numpy.linalg.LinAlgError: it has no place to begin.
    """
    mean, sd = view.prior

    def at(thetas: Array) -> tuple[Array, Array, float]:
        with np.errstate(all="ignore"):
            errors, variance = view.innovations(thetas, data)
            value = 0.5 * errors[0] @ errors[0] / variance[0] + 0.5 * errors.shape[1] * np.log(variance[0])
            return errors, variance, float(value + 0.5 * np.sum(((thetas[0] - mean) / sd) ** 2))

    theta, damping, gained = mean.copy(), 1e-2, np.inf
    for _ in range(ROUNDS):
        nudges = NUDGE * np.maximum(0.01, np.abs(theta))
        errors, variance, loss = at(np.vstack([theta, theta + np.diag(nudges)]))
        own, size, number = errors[0], variance[0], errors.shape[1]
        of_errors, of_size = (errors[1:] - own) / nudges[:, None], (variance[1:] - size) / nudges / size
        slope = of_errors @ own / size + 0.5 * of_size * (number - own @ own / size) + (theta - mean) / sd**2
        information = of_errors @ of_errors.T / size + 0.5 * number * np.outer(of_size, of_size) + np.diag(sd**-2.0)
        if not (np.isfinite(loss) and np.isfinite(information).all()):
            raise np.linalg.LinAlgError("the filter does not settle")
        if gained < SETTLED:
            break
        for _ in range(REJECTIONS):
            step = -np.linalg.solve(information + damping * np.diag(information.diagonal()), slope)
            step *= min(1.0, LONGEST_STEP / np.abs(step[view.logarithms]).max())
            gained = loss - at((theta + step)[None])[2]
            if gained > 0:
                break
            damping *= 6
        if not gained > 0:
            break
        promised = -(slope @ step + 0.5 * step @ information @ step)
        damping = max(damping / 6, 1e-6) if gained > promised / 2 else damping if gained > promised / 5 else damping * 4
        theta = theta + step
    evidence = -loss - 0.5 * np.linalg.slogdet(information)[1] - np.log(sd).sum()
    return _Found(view, theta, information, float(evidence))


def physical(train: Recorded | Sequence[Recorded]) -> Physical:
    """Reads what motors, damping and lag are off a flight whose outputs hold an angle and its rate.

    Takes about half a second for 700 samples. Forecasts have no part in it, nor it in them.

    Args:
        train: a ``Flight``, or a list of them, segments with gaps between: rates in rad/s.

    Raises:
        ValueError: no output is the rate of another, there are too few samples, no motor moves, or no filter settles.
    """
    record = Record.of(train)
    pairs = derivative_pairs(record)
    if not pairs:
        raise ValueError("a physical reading takes an angle and its rate: no output is the derivative of another")
    spread = record.inputs.std(axis=0)
    if not spread.any():
        raise ValueError("a physical reading takes motors that move: all inputs are constant")
    unit = np.where(spread > 0, spread, 1.0)
    rate = record.outputs[:, pairs[0][1]]
    whole = _Data(
        tuple(
            ((inputs - record.inputs.mean(axis=0)) / unit, outputs[:, pairs[0][1]] - rate.mean())
            for inputs, outputs in record.segments
        ),
        record.dt,
    )
    data = whole.first(MOST)
    samples = sum(len(measured) for _, measured in data.segments)
    if samples < FEWEST:
        raise ValueError(f"a physical reading takes at least {FEWEST} samples on end, not {samples}")
    found = []
    with one_thread():
        for wind in WINDS:
            try:
                found.append(_climbed(_View(len(unit), wind), data))
            except (np.linalg.LinAlgError, ValueError):
                continue
    if not found:
        raise ValueError("no filter settles with what these motors and rates tell: take another stretch of the flight")
    return _read(max(found, key=lambda each: each.evidence), data, unit)


def _read(found: _Found, data: _Data, unit: Array) -> Physical:
    r, theta = len(unit), found.theta
    motors, damping, lag, delay = theta[:r], float(theta[r]), float(np.exp(theta[r + 1])), float(theta[r + 2])
    scale = np.concatenate([1 / unit, [1.0, lag]])
    covariance: Array = inverse(found.information)[: r + 2, : r + 2] * np.outer(scale, scale)
    covariance[:r, :r] += MOTORS_ERROR**2 * np.outer(motors / unit, motors / unit)
    covariance[r, r] += DAMPING_ERROR**2
    covariance[-1, -1] += (LAG_ERROR * lag) ** 2
    keeps = np.exp(-data.dt / lag)
    torque = np.concatenate([lfilter([1 - keeps], [1, -keeps], inputs @ motors) for inputs, _ in data.segments])
    wind = float(np.sum(found.view.sizes(theta) ** 2))
    share = wind / (wind + float(torque.var()))
    return Physical(motors / unit, damping, lag, delay, covariance, float(np.sqrt(wind)), share)
