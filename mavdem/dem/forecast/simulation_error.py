"""The simulation-error (output-error) fit: θ continues from the ascent, by simulations over a short horizon.

Over segments of the record the state starts where the filter has it and then follows ẋ = A x + B v, and the residual is
z, wind included. F̄ has λ at its maximum, which is known. It has many maxima; the ascent leads to the right one
(docs/how_it_works.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space

from mavdem.arrays import Array, Indices
from mavdem.dem.engine.gauss_newton import (
    CONVERGED_STEP_NATS,
    FINITE_DIFFERENCE_STEP,
    Damping,
    QuadraticExpansion,
    gauss_newton,
)
from mavdem.dem.engine.generative import GenerativeModel, ModelSizes
from mavdem.dem.engine.linalg import inverse, logdet, may_overflow
from mavdem.dem.engine.model import discretize, unpack
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.forecast.joint import axis_mixer
from mavdem.dem.priors import KINEMATIC_PRECISION, Scaling
from mavdem.dem.record import Record, Segments
from mavdem.dem.settings import CompleteSettings

WEAK_PRECISION = 1e-5
"""Prior precision of a free parameter, in the engine's units: it determines what the segments do not."""

QUIET_PRECISION = 0.1
"""Prior precision, in the engine's units, of the effect of a combination that does not turn the vehicle: its standard
deviation is about 3, since rotors are not quite alike and loads not quite centred."""

SAMPLES_PER_PARAMETER = 2.0
"""Least effective sample size for each free parameter. A short record has it over a shorter horizon only."""

MIN_HORIZON_SECONDS = 0.05
"""Seconds; below, a simulation says no more than the derivatives of the ascent, and there is no such fit."""

STARTS_PER_HORIZON = 4  # segments begin so many times a horizon
MAX_SEGMENTS = 500  # spread over the whole record, however long it is

DAMPING = Damping(initial=1e-3, factor=8.0, max_attempts=6)


def models_of(
    thetas: Array,
    sizes: ModelSizes,
    gain: Array,
    dt: float,
) -> StateSpace:
    """Returns models that differ in θ (b, k) alone, side by side.

    They have n states, r inputs and m outputs, and C of the first.
    """
    A, B, C = (
        np.stack(each) for each in zip(*(unpack(theta, *sizes) for theta in thetas), strict=True)
    )
    transition = discretize(A, B, dt)
    with np.errstate(over="ignore", invalid="ignore"):
        return StateSpace.from_transition(transition, C[0], gain)


@may_overflow
def simulate(models: StateSpace, inputs: Array, outputs: Array) -> Array:
    """Returns outputs (b, H, m, S) of b models over H steps, from the state that the filter finds over h steps.

    ``inputs`` are (h + H + 1, r, S), ``outputs`` (h + 1, m, S).
    """
    A, B, C, D, K = models.A, models.B, models.C, models.D, models.K
    samples = np.concatenate([inputs[: len(outputs)], outputs], axis=1)
    second = np.concatenate([models.second_of_inputs, models.second_of_outputs], axis=-1)
    closed = A - K @ C
    heard = np.concatenate([B - K @ D, K], axis=-1)
    ahead = []
    # An unstable model may overflow; its errors are then infinite.
    states = second @ samples[0]
    for now in samples[1:]:
        states = closed @ states + heard @ now
    for now in inputs[len(outputs) :]:
        ahead.append(C @ states + D @ now)
        states = A @ states + B @ now
    return np.stack(ahead, axis=1)


class SimulationSegments(NamedTuple):
    """Pieces of a record, step by step: the filter uses the first half of each, simulations begin at its middle.

    ``inputs`` (h + H, r, S) and ``outputs`` (h + H, m, S) are in the engine's units; the filter takes h = ``settle``
    steps; ``number`` is the effective one of segments: as many as follow each other in the record.
    """

    inputs: Array
    outputs: Array
    settle: int
    number: float

    @classmethod
    def from_segments(cls, segments: Segments, horizon: int) -> SimulationSegments:
        """Returns pieces of ``horizon`` samples before and ahead, all over segments, of which one is long enough."""
        whole = 2 * horizon
        starts = [
            (inputs, outputs, start)
            for inputs, outputs in segments
            for start in _starts(len(outputs), horizon)
        ]
        kept = np.unique(np.linspace(0, len(starts) - 1, MAX_SEGMENTS).astype(int))
        pieces = [
            (u[at : at + whole + 1], y[at : at + whole + 1])
            for u, y, at in (starts[i] for i in kept)
        ]
        inputs, outputs = (np.stack(tables, axis=2) for tables in zip(*pieces, strict=True))
        return cls(
            inputs,
            outputs,
            horizon,
            effective_number([len(outputs) for _, outputs in segments], horizon),
        )


def _starts(length: int, horizon: int) -> range:
    """The samples of a segment of that ``length`` at which its pieces begin."""
    return range(0, length - 2 * horizon, max(1, horizon // STARTS_PER_HORIZON))


def effective_number(lengths: Sequence[int], horizon: int) -> float:
    """Returns the effective number of pieces of segments of these ``lengths``.

    It is as many as follow each other, and at most as many as are used.
    """
    samples = sum(length for length in lengths if length > 2 * horizon)
    return min(
        samples / horizon,
        float(MAX_SEGMENTS),
        float(sum(len(_starts(each, horizon)) for each in lengths)),
    )


def simulation_horizon(
    model: GenerativeModel,
    settings: CompleteSettings,
    scaling: Scaling,
    record: Record,
) -> int | None:
    """Returns the number of samples of each simulation: ``settings.horizon`` at most.

    It is less where the effective sample size would be too small, 0 where even ``MIN_HORIZON_SECONDS`` is too long for
    the record. ``None`` where there is to be no fit: the settings ask for none, inputs are unknown, the prior is the
    paper's, or it leaves no parameter free.
    """
    n, r, m = model.sizes
    free = np.count_nonzero(
        np.diag(model.prior.theta_precision)[: n * n + n * r] < KINEMATIC_PRECISION
    )
    if settings.horizon is None or settings.prior == "uniform" or not scaling.known or not free:
        return None
    longest = max(1, round(settings.horizon / record.dt))
    shortest = min(longest, max(1, round(MIN_HORIZON_SECONDS / record.dt)))
    least = SAMPLES_PER_PARAMETER * free
    steps = range(longest, shortest - 1, -1)
    return next((each for each in steps if effective_number(record.lengths, each) * m >= least), 0)


@dataclass(frozen=True, eq=False)
class SimulationFit:
    """The result of the fit, in the engine's units."""

    theta: Array  # (k,) all parameters
    free: Indices  # (f,) indices of the free ones
    covariance: Array  # (f, f) of their posterior
    effective_samples: float  # outputs times horizons that follow each other
    horizon: int  # samples of each simulation, and of the filter before it
    terms: Mapping[str, Array]  # each named term of F̄, (I + 1,)
    # whether it has converged, by the gain of the last step or the gain that the curvature predicts
    converged: bool

    @property
    def degrees_of_freedom(self) -> float:
        """Degrees of freedom that the noise's variance is estimated with."""
        return self.effective_samples - len(self.free)

    def theta_covariance(self, held: Array) -> Array:
        """Returns (k, k) posterior covariance of θ.

        Parameters that were not free have that of the prior, ``held`` (k, k).
        """
        covariance = held.copy()
        covariance[self.free] = 0.0
        covariance[:, self.free] = 0.0
        covariance[np.ix_(self.free, self.free)] = self.covariance
        return covariance


@dataclass(frozen=True, eq=False)
class SimulationError:
    """The log joint of the simulation errors of segments and of free parameters, which are θ at ``free``."""

    theta: Array
    free: Indices
    prior_mean: Array
    prior_precision: Array
    sizes: ModelSizes
    gain: Array
    dt: float
    segments: SimulationSegments

    @property
    def effective_samples(self) -> float:
        """Effective sample size."""
        return self.segments.number * self.sizes[2]

    def errors(self, at: Array) -> Array:
        """Returns (b, H, m, S) errors of the models whose free parameters are ``at`` (b, f)."""
        inputs, outputs, settle, _ = self.segments
        thetas = np.repeat(self.theta[None], len(at), axis=0)
        thetas[:, self.free] = at
        models = models_of(thetas, self.sizes, self.gain, self.dt)
        predicted = simulate(models, inputs, outputs[: settle + 1])
        with np.errstate(over="ignore", invalid="ignore"):
            return outputs[settle + 1 :] - predicted

    def value(self, at: Array) -> float:
        """Returns the log joint up to a constant, with the noise precision at its maximum."""
        return self._value(at, self.errors(at[None]))

    def expand(self, at: Array) -> QuadraticExpansion:
        """Returns slope and Gauss-Newton curvature, the posterior precision, by differences of errors."""
        steps = FINITE_DIFFERENCE_STEP * np.maximum(1.0, abs(at))
        errors = self.errors(np.vstack([at, at + np.diag(steps)]))
        residuals = errors[0]
        jacobian = (errors[1:] - residuals).reshape(len(at), -1) / steps[:, None]
        mse = _mean_square(residuals)
        each = self.effective_samples / residuals.size
        slope = -each * jacobian @ residuals.ravel() / mse - self.prior_precision @ (
            at - self.prior_mean
        )
        curvature = each * jacobian @ jacobian.T / mse + self.prior_precision
        return QuadraticExpansion(at, self._value(at, residuals), slope, curvature)

    def terms(self, joint: QuadraticExpansion) -> dict[str, float]:
        """Returns the named terms of F̄, Eq. ``F_action_opt``; X has no entropy of its own in a simulation."""
        log_prior = self._log_prior(joint.point)
        return {
            "noise entropy": joint.value - log_prior,
            "parameter entropy": -0.5 * (logdet(joint.curvature) - logdet(self.prior_precision)),
            "prediction error of outputs": -0.5 * self.effective_samples,
            "prediction error of parameters": log_prior,
        }

    def _value(self, at: Array, errors: Array) -> float:
        return float(
            -0.5 * self.effective_samples * np.log(_mean_square(errors)) + self._log_prior(at)
        )

    def _log_prior(self, at: Array) -> float:
        off = at - self.prior_mean
        return float(-0.5 * off @ self.prior_precision @ off)


@may_overflow
def _mean_square(errors: Array) -> float:
    return (errors**2).mean()


def fit_simulation_error(
    model: GenerativeModel,
    settings: CompleteSettings,
    scaling: Scaling,
    theta: Array,
    gain: Array,
    record: Record,
) -> SimulationFit | None:
    """Fits the model to a record from θ (k,), with a filter of that gain (n, m), by damped steps that each increase F̄.

    Parameters of A and B with a prior precision below ``KINEMATIC_PRECISION`` are free. Under the package's own prior,
    combinations of the motors that are at right angles to the turning one of the joint model hardly turn the vehicle.
    ``None`` where there is no horizon (:func:`simulation_horizon`), or errors overflow.
    """
    horizon = simulation_horizon(model, settings, scaling, record)
    if not horizon:
        return None
    segments = SimulationSegments.from_segments(scaling.scale_segments(record), horizon)
    n, r, _ = model.sizes
    of_A = n * n
    varied = of_A + n * r  # of A and B
    precision = model.prior.theta_precision
    is_free = np.diag(precision) < KINEMATIC_PRECISION
    if settings.prior == "regulated":
        weak = WEAK_PRECISION * np.eye(len(is_free))
        precision = np.where(np.outer(is_free, is_free), weak, precision)
        quiet = null_space(axis_mixer(record).T)
        for row in np.flatnonzero(is_free[of_A:varied:r]):
            places = of_A + row * r + np.arange(len(quiet))
            precision[np.ix_(places, places)] += QUIET_PRECISION * quiet @ quiet.T
    free = np.flatnonzero(is_free[:varied])
    mean = model.prior.theta_mean[free]
    objective = SimulationError(
        theta, free, mean, precision[np.ix_(free, free)], model.sizes, gain, record.dt, segments
    )
    if not np.isfinite(objective.value(theta[free])):
        return None
    trace, gained = gauss_newton(objective, objective.expand(theta[free]), DAMPING)
    best = theta.copy()
    best[free] = trace[-1].point
    samples = objective.effective_samples
    terms = [objective.terms(each) for each in trace]
    return SimulationFit(
        theta=best,
        free=free,
        # The variance that is left is an estimate as well: of as many numbers as the parameters have left over.
        covariance=inverse(trace[-1].curvature) * samples / (samples - len(free)),
        effective_samples=samples,
        horizon=segments.settle,
        terms={name: np.array([row[name] for row in terms]) for name in terms[0]},
        converged=gained <= CONVERGED_STEP_NATS,
    )
