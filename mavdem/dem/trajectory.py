"""Trajectories: the climb goes on along the model's own motion over a short horizon.

Generalized coordinates read a motion from a window as wide as its derivatives take, a few samples; what a model makes
of its inputs over a third of a second shows in them only as far as noise lets it. So from where the climb in
generalized coordinates has ended, θ climbs on along trajectories: over stretches of the record the state starts where
the filter has it and then follows ẋ = A x + B v by itself, the limit of a high precision of w. What is left of the
samples is z, wind and all, which is smooth: within a stretch neighbours tell the same, so that of T samples as many
count as stretches follow each other in them. F̄ has its named terms, with its parameters' prior, which is weak here, and
with the noise precision λ at its maximum, which is known.

Along trajectories F̄ has many maxima; the climb in generalized coordinates finds the right one's foot.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from mavdem.dem.layout import Layout, Likelihood
from mavdem.dem.model import Transition, discretize, unpack
from mavdem.dem.parts import Parts, at_once
from mavdem.dem.positive import inverse, logdet
from mavdem.dem.priors import KINEMATIC

Array = NDArray[np.float64]

WEAK = 1e-5
"""Prior precision of a free parameter, in the engine's units: it holds what the stretches tell nothing of."""

NUMBERS_EACH = 2.0
"""So many numbers each free parameter asks for; with fewer the climb stays where generalized coordinates led it."""

OVERLAP = 4
"""Stretches begin so many times a horizon."""

MOST_STRETCHES = 2000
"""There are no more, spread over the whole record, however long it is."""

ROUNDS = 40
"""Gauss-Newton steps at most."""

SETTLED = 0.02
"""Nats that are next to nothing: there are as few numbers as stretches."""

DAMPINGS = 6
"""Times that a step is damped more, by a factor of ``FIRMER``, before the climb ends where it is."""

FIRMER = 8.0

GENTLE = 1e-3
"""Damping of the first step, in shares of each parameter's own curvature."""

NUDGE = 1e-6
"""Of a parameter, or of 1 if that is more: for slopes by differences."""

STEPS_COUNTED = 30
"""Of a horizon at most, evenly: of faster samples neighbours tell the same."""

STEPS_A_PART = 70
"""Of one model; of several side by side as many fewer."""


class Stretches(NamedTuple):
    """Pieces of a record, step by step: the filter reads the first half of each, and forecasts begin at its middle.

    Attributes:
        inputs: (h + H, S, r) in the engine's units, of S stretches.
        outputs: likewise, (h + H, S, m).
        settle: h, steps that the filter takes to find the state.
        number: how many stretches follow each other in the record: so much of it is news.
    """

    inputs: Array
    outputs: Array
    settle: int
    number: float

    @classmethod
    def of(cls, segments: list[tuple[Array, Array]], horizon: int) -> Stretches | None:
        """Stretches all over segments (T, r), (T, m) in the engine's units; ``None`` where none has room for one.

        Args:
            segments: inputs and outputs.
            horizon: samples ahead, and as many before.
        """
        whole = 2 * horizon
        starts = [
            (inputs, outputs, start)
            for inputs, outputs in segments
            for start in range(0, len(outputs) - whole, max(1, horizon // OVERLAP))
        ]
        if not starts:
            return None
        kept = np.unique(np.linspace(0, len(starts) - 1, MOST_STRETCHES).astype(int))
        pieces = [
            (u[start : start + whole + 1], y[start : start + whole + 1]) for u, y, start in (starts[i] for i in kept)
        ]
        inputs, outputs = (np.stack(tables, axis=1) for tables in zip(*pieces, strict=True))
        samples = sum(len(outputs) for _, outputs in segments if len(outputs) > whole)
        return cls(inputs, outputs, horizon, min(samples / horizon, float(len(kept))))


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Where the climb along trajectories ended, in the engine's units.

    Attributes:
        theta: (k,) all parameters.
        places: (f,) which of them were free.
        covariance: (f, f) of their posterior.
        numbers: news in the stretches: outputs times stretches that follow each other.
        horizon: samples that each stretch was forecast, and from which the filter found the state before.
        terms: each named term of F̄, (I + 1,).
        settled: whether next to nothing was left to climb, by what the last step gained or the curvature promises.
        mse: (L, m) of forecasts inside the training data, by their length.
        gain: (n, m) of the filter that finds the state before each stretch.
        layout: the rotors' that was taken for granted; ``None`` where a prior was given, or inputs are not rotors.
    """

    theta: Array
    places: NDArray[np.intp]
    covariance: Array
    numbers: float
    horizon: int
    terms: Mapping[str, Array]
    settled: bool
    mse: Array
    gain: Array
    layout: Layout | None

    @property
    def rounds(self) -> int:
        """Steps that led there."""
        return len(self.terms["noise entropy"]) - 1

    @property
    def freedom(self) -> float:
        """Degrees of freedom that the noise's variance is estimated with."""
        return self.numbers - len(self.places)

    def theta_covariance(self, held: Array) -> Array:
        """(k, k) posterior covariance of θ; parameters that were not free have that of the prior, ``held`` (k, k)."""
        covariance = np.zeros_like(held)
        fixed = np.setdiff1d(np.arange(len(held)), self.places)
        covariance[np.ix_(fixed, fixed)] = held[np.ix_(fixed, fixed)]
        covariance[np.ix_(self.places, self.places)] = self.covariance
        return covariance

    def quantile(self, level: float) -> float:
        """Half width of an interval that holds its number with probability ``level``, in standard deviations."""
        return float(student.ppf(0.5 + level / 2, self.freedom))

    @property
    def noise(self) -> Array:
        """(L, m) variance about a forecast with the true θ, by its length.

        Forecasts of what was learnt from err less, by the share of numbers that the parameters took; a shorter one has
        more numbers to itself.
        """
        lengths = np.minimum(np.arange(1, len(self.mse) + 1), self.horizon)
        numbers = self.numbers * self.horizon / lengths
        return np.asarray(self.mse * (numbers / (numbers - len(self.places)))[:, None])

    def spread(self, sizes: tuple[int, int, int], dt: float, inputs: Array, outputs: Array) -> Array:
        """(S, H, m) variance that θ's posterior gives forecasts; infinite where it leaves the range of numbers.

        Args:
            sizes: n, r and m.
            dt: sampling step, s.
            inputs: (h + H, S, r) for S forecasts: of the samples before, by which the filter finds the state, and on.
            outputs: (h, S, m) before.
        """
        free = self.theta[self.places]
        nudges = NUDGE * np.maximum(1.0, np.abs(free))
        thetas = np.repeat(self.theta[None], len(free) + 1, axis=0)
        thetas[1:, self.places] += np.diag(nudges)
        bundle = Bundle.of(thetas, sizes, self.gain, dt)
        ahead = at_once(bundle.run(inputs, outputs))
        with np.errstate(over="ignore", invalid="ignore"):
            jacobian = (ahead[1:] - ahead[0]) / nudges[:, None, None, None]
            variance = np.einsum("isht,ij,jsht->sht", jacobian, self.covariance, jacobian, optimize=True)
        return np.where(np.isfinite(variance), variance, np.inf)


class Bundle(NamedTuple):
    """Models that differ in θ alone, b of them, which run side by side."""

    transition: Transition  # (b, n, n), (b, n, r), (b, n, r)
    C: Array  # (m, n)
    gain: Array  # (n, m)

    @classmethod
    def of(cls, thetas: Array, sizes: tuple[int, int, int], gain: Array, dt: float) -> Bundle:
        """Of θ (b, k), for n states, r inputs and m outputs; C is that of the first."""
        A, B, C = (np.stack(each) for each in zip(*(unpack(theta, *sizes) for theta in thetas), strict=True))
        return cls(discretize(A, B, dt), C[0], gain)

    def run(self, inputs: Array, outputs: Array, every: int = 1) -> Parts[Array]:
        """Outputs (b, S, H / every, m) over H steps from where the filter, over the steps before, has found the state.

        Args:
            inputs: (h + H + 1, S, r).
            outputs: (h + 1, S, m).
            every: how many steps lie from one that is answered to the next.
        """
        F, now, later = (np.swapaxes(each, 1, 2) for each in self.transition)
        settle = len(outputs) - 1
        state = np.broadcast_to(outputs[0] @ np.linalg.pinv(self.C).T, (len(F), inputs.shape[1], F.shape[1]))
        ahead, part = [], max(1, STEPS_A_PART // len(F))
        for step in range(1, len(inputs)):
            # An unstable model may run beyond all numbers; its errors are then infinite.
            with np.errstate(over="ignore", invalid="ignore"):
                state = state @ F + inputs[step - 1] @ now + inputs[step] @ later
                if step <= settle:
                    state = state + (outputs[step] - state @ self.C.T) @ self.gain.T
                elif not (step - settle) % every:
                    ahead.append(state @ self.C.T)
            if not step % part:
                yield
        return np.stack(ahead, axis=2)


class _Slopes(NamedTuple):
    """Where a climb stands, and how the ground lies there."""

    free: Array  # (f,) the free parameters
    mse: float
    slope: Array  # (f,) ∂/∂ free of the log joint
    curvature: Array  # (f, f) of its negative, Gauss-Newton: the posterior precision


@dataclass(frozen=True, eq=False)
class _Climb:
    """A climb of the log joint of stretches and free parameters.

    Attributes:
        theta: (k,) all parameters, of which the free ones stand at ``places``.
        places: (f,).
        prior_mean, prior_precision: (f,), (f, f).
        sizes: n, r and m.
        gain: (n, m) of the filter.
        dt: sampling step, s.
        stretches: of the record.
    """

    theta: Array
    places: NDArray[np.intp]
    prior_mean: Array
    prior_precision: Array
    sizes: tuple[int, int, int]
    gain: Array
    dt: float
    stretches: Stretches

    @property
    def numbers(self) -> float:
        """What counts as news in the stretches."""
        return self.stretches.number * self.sizes[2]

    def errors(self, free: Array) -> Parts[Array]:
        """(b, S, steps counted, m) of the models whose free parameters are (b, f)."""
        inputs, outputs, settle, _ = self.stretches
        every = -(-settle // STEPS_COUNTED)
        predicted = yield from self.bundle(free).run(inputs, outputs[: settle + 1], every)
        yield
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(np.moveaxis(outputs[settle + every :: every], 0, 1) - predicted)

    def bundle(self, free: Array) -> Bundle:
        """The models whose free parameters are (b, f)."""
        thetas = np.repeat(self.theta[None], len(free), axis=0)
        thetas[:, self.places] = free
        return Bundle.of(thetas, self.sizes, self.gain, self.dt)

    def height(self, free: Array, mse: float) -> float:
        """The log joint, but for what is the same everywhere, with the noise precision at its maximum, 1/mse."""
        off = free - self.prior_mean
        return float(-0.5 * self.numbers * np.log(mse) - 0.5 * off @ self.prior_precision @ off)

    def slopes(self, free: Array, errors: Array) -> Parts[_Slopes]:
        """At parameters whose ``errors`` (S, steps counted, m) are known."""
        nudges = NUDGE * np.maximum(1.0, np.abs(free))
        nudged = yield from self.errors(free + np.diag(nudges))
        yield
        jacobian = (nudged - errors).reshape(len(free), -1) / nudges[:, None]
        yield
        mse, each = _mean_square(errors), self.numbers / errors.size
        slope = -each * jacobian @ errors.ravel() / mse - self.prior_precision @ (free - self.prior_mean)
        return _Slopes(free, mse, slope, each * jacobian @ jacobian.T / mse + self.prior_precision)

    def promised(self, at: _Slopes) -> float:
        """Nats that the curvature says are left to climb."""
        return float(0.5 * at.slope @ np.linalg.solve(at.curvature, at.slope))

    def likelihood(self, at: _Slopes) -> Likelihood:
        """The log joint less its prior."""
        off = at.free - self.prior_mean
        return Likelihood(at.free, at.slope + self.prior_precision @ off, at.curvature - self.prior_precision)

    def terms(self, at: _Slopes) -> dict[str, float]:
        """The named terms of F̄, Eq. ``F_action_opt``; X has no entropy of its own along a trajectory."""
        off = at.free - self.prior_mean
        return {
            "noise entropy": -0.5 * self.numbers * float(np.log(at.mse)),
            "parameter entropy": -0.5 * (logdet(at.curvature) - logdet(self.prior_precision)),
            "prediction error of outputs": -0.5 * self.numbers,
            "prediction error of parameters": -0.5 * float(off @ self.prior_precision @ off),
        }


def climb_by_parts(
    theta: Array,
    prior: tuple[Array, Array],
    sizes: tuple[int, int, int],
    gain: Array,
    dt: float,
    stretches: Stretches,
    rounds: int,
) -> Parts[tuple[Trajectory, Likelihood] | None]:
    """Climbs from θ by damped Gauss-Newton steps (Levenberg and Marquardt), each of which leads higher.

    Args:
        theta: (k,) in the engine's units.
        prior: mean (k,) and precision (k, k) of θ; parameters of A and B with a precision below ``KINEMATIC`` are free.
        sizes: n, r and m.
        gain: (n, m) of the filter, which stays.
        dt: sampling step, s.
        stretches: of the record.
        rounds: at most so many steps.

    Returns:
        where it ended, and the likelihood about there;
        ``None`` where the stretches are too few for so many parameters, or errors leave the range of numbers.
    """
    n, r, _ = sizes
    mean, precision = prior
    places = np.flatnonzero(np.diag(precision)[: n * n + n * r] < KINEMATIC)
    climb = _Climb(theta, places, mean[places], precision[np.ix_(places, places)], sizes, gain, dt, stretches)
    if climb.numbers < NUMBERS_EACH * len(places) or not len(places):
        return None
    errors = (yield from climb.errors(theta[places][None]))[0]
    if not np.isfinite(_mean_square(errors)):
        return None
    at = yield from climb.slopes(theta[places], errors)
    trace, damping, gained = [climb.terms(at)], GENTLE, np.inf
    while gained > SETTLED and len(trace) <= rounds:
        for _ in range(DAMPINGS):
            curvature = at.curvature + damping * np.diag(np.diag(at.curvature))
            there = at.free + np.linalg.solve(curvature, at.slope)
            errors = (yield from climb.errors(there[None]))[0]
            gained = climb.height(there, _mean_square(errors)) - climb.height(at.free, at.mse)
            if gained > 0:
                break
            damping *= FIRMER
        if not gained > 0:
            gained = climb.promised(at)
            break
        damping /= FIRMER
        at = yield from climb.slopes(there, errors)
        trace.append(climb.terms(at))
    best = theta.copy()
    best[places] = at.free
    # The variance that is left is an estimate as well: of as many numbers as the parameters have left over.
    covariance = inverse(at.curvature) * climb.numbers / (climb.numbers - len(places))
    terms = {name: np.array([row[name] for row in trace]) for name in trace[0]}
    return Trajectory(
        theta=best,
        places=places,
        covariance=covariance,
        numbers=climb.numbers,
        horizon=stretches.settle,
        terms=terms,
        settled=gained <= SETTLED,
        mse=np.empty((0, sizes[2])),
        gain=gain,
        layout=None,
    ), climb.likelihood(at)


def _mean_square(errors: Array) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        return float((errors**2).mean())
