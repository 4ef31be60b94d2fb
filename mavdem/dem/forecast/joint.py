"""The joint model: outputs and the motors that turn the axis as one process, of which the motors measure the motion.

In closed loop the motors answer the very disturbance that moves the vehicle. So they are no inputs: they are outputs
of one generative model of vehicle, wind and autopilot, z = [outputs, turning combination of the motors],

    z_t = Σᵢ Wᵢ z_{t−i} + c + e_t,    i = 1 … L.

Its hidden states — lagging torque, wind, what the controller remembers — are what the past of z shows of them. The
model is linear in W and Gaussian, so that DEM's steps have closed forms. F̄ is the logarithm of the evidence; it chooses
L, the prior's precision and form, and, where the mixer is not known, the combination of the motors: docs/method.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import legvander

from mavdem.confidence import half_width
from mavdem.dem.engine.linalg import Array, one_thread
from mavdem.dem.forecast import var
from mavdem.dem.forecast.var import turning_patterns
from mavdem.dem.record import FEWEST_MOTORS, Record
from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.model import ModelRefusal

LAGS = (6, 8, 10, 14, 20)  # that F̄ chooses from, samples
# likewise, precisions of the prior at lag 1, of channels of deviation 1
RIDGES = (1e-4, 1e-3, 1e-2)
# of the models whose F̄ chooses the turning combination
MIXER_LAGS = 10
MIXER_RIDGE = 1e-3
# of the patterns an X comes first; a plus is flown by one vehicle in twenty, nats
X_PATTERNS = 3
PLUS_COST = 3.0
# added to their innovations: how well an angle follows from its rate tells nothing of the motors
MIXER_NOISE = 1e-5
DRAWS = 24  # of the posterior of W, in pairs about its mean
LARGEST = 1e6  # deviations: forecasts of unstable draws go no farther


class Choice(NamedTuple):
    """What F̄ chooses: the samples of the past that count, and the prior of their coefficients."""

    lags: int
    ridge: float
    smooth: bool

    @property
    def prior(self) -> Array:
        """(lags, lags) precision of a channel's coefficients by lag."""
        decay = np.sqrt(var.lag_prior(self.lags, self.ridge).diagonal())
        orders = np.arange(1.0, self.lags + 1) ** (2.0 if self.smooth else 0.0)
        basis = _generalized(self.lags)
        return np.asarray(decay[:, None] * ((basis * orders) @ basis.T) * decay)


CHOICES = tuple(
    Choice(lags, ridge, smooth) for lags in LAGS for ridge in RIDGES for smooth in (False, True)
)


@cache
def _generalized(lags: int) -> Array:
    """(lags, lags) orthonormal polynomials by lag: value, slope, curvature … of the past, one a column."""
    return np.linalg.qr(legvander(np.linspace(-1, 1, lags), lags - 1))[0]


def known_combinations(inputs: int, effect_directions: Array | None) -> Array | None:
    """Returns (r, c) as :func:`turning_combinations`; ``None`` where a flight must tell."""
    if inputs < FEWEST_MOTORS:
        return np.eye(inputs)
    if effect_directions is None or not effect_directions.any():
        return None
    return effect_directions[:, None] / np.linalg.norm(effect_directions)


def turning_combinations(record: Record) -> Array:
    """Returns (r, c) the combinations of the inputs that turn the axis, of unit length.

    One where the mixer is known; of other rotors the one of an X, a plus, or as the motors' effects come out, whose
    model explains the outputs best; inputs that are no rotors as they are.
    """
    r = record.inputs.shape[1]
    m = record.outputs.shape[1]
    known = known_combinations(r, record.effect_directions)
    if known is not None:
        return known
    lags = min(MIXER_LAGS, max(1, record.longest // 4))
    prior = var.lag_prior(lags, MIXER_RIDGE)

    def of_outputs(combinations: Array) -> tuple[var.Regression, var.ChannelUnits, float]:
        units, statistics = _statistics(record, combinations, lags)
        return (
            var.regress(statistics.gram, statistics.rows, prior, m, MIXER_NOISE),
            units,
            statistics.rows,
        )

    found = turning_patterns(r)
    every, units, rows = of_outputs(np.eye(r))
    effects = every.mean[:-1, m - 1].reshape(lags, m + r)[:, m:].sum(axis=0) / units.scale[m:]
    size = float(np.linalg.norm(effects))
    costs = [0.0 if place < X_PATTERNS else PLUS_COST for place in range(len(found))]
    if size > 0:
        # What the flight tells of the motors' effects costs as many nats as its numbers (Schwarz, 1978).
        found.append(effects / size)
        costs.append(0.5 * (r - 1) * np.log(rows))
    energies = [
        of_outputs(one[:, None])[0].free_energy - cost
        for one, cost in zip(found, costs, strict=True)
    ]
    return np.asarray(found[int(np.argmax(energies))][:, None])


def _combined(record: Record, combinations: Array) -> Record:
    """The record with these (r, c) combinations of its inputs as the inputs."""
    return replace(record, inputs=record.inputs @ combinations, effect_directions=None)


def _statistics(
    record: Record, combinations: Array, lags: int
) -> tuple[var.ChannelUnits, var.LagStatistics]:
    combined = _combined(record, combinations)
    units = var.ChannelUnits.of(combined)
    statistics = var.LagStatistics.of(units.segments(combined), lags)
    if statistics.rows <= 0:
        code = ModelRefusal.SEGMENTS_TOO_SHORT_FOR_LAGS
        raise NotLearnable(Fact(code, samples=lags, longest=record.longest))
    return units, statistics


def choose(statistics: var.LagStatistics, lags: int) -> tuple[Choice, var.Regression]:
    """Returns the choice of the highest F̄, and its posterior, for ``statistics`` of so many ``lags`` or fewer."""
    choices = [one for one in CHOICES if one.lags <= lags] or [
        Choice(lags, ridge, False) for ridge in RIDGES
    ]
    grams = {
        fewer: statistics.shortened(lags, fewer) for fewer in {choice.lags for choice in choices}
    }
    tried = [
        (choice, var.regress(grams[choice.lags], statistics.rows, choice.prior))
        for choice in choices
    ]
    return max(tried, key=lambda one: one[1].free_energy)


@dataclass(frozen=True, eq=False)
class JointModel:
    """The learnt joint model and its forecasts; all arguments and results are physical.

    Attributes:
        combinations: (r, c) of the inputs, that are channels of the model.
        choice: what F̄ chose.
        process: the model at the posterior's mean.
        terms: of F̄, nats.
        draws: (D, q, k) of the coefficients of [lag 1 … lag L, 1], in the process's units.
        past: (L, k) the last samples of the training data.
        samples: of the training data.
    """

    combinations: Array
    choice: Choice
    process: var.Var
    terms: dict[str, float]
    draws: Array
    past: Array
    samples: int

    @classmethod
    def learn(cls, record: Record, seed: int = 0) -> JointModel:
        """Learns from training data; ``seed`` is of the draws.

        Raises:
            ValueError: no segment has two samples.
        """
        with one_thread():
            combinations = turning_combinations(record)
            lags = max(
                (one for one in LAGS if one <= record.longest // 4),
                default=max(1, min(LAGS[0], record.longest - 1)),
            )
            units, statistics = _statistics(record, combinations, lags)
            choice, found = choose(statistics, lags)
            sizes, directions = np.linalg.eigh(found.covariance)
            spread = (directions * np.sqrt(np.maximum(sizes, 0.0))) @ directions.T
            half = np.random.default_rng(seed).standard_normal((DRAWS // 2, *found.mean.shape))
            away = found.root.T @ np.concatenate([half, -half]) @ spread
            process = var.Var.of(found, units)
            past = process.past(_combined(record, combinations))
            return cls(
                combinations, choice, process, found.terms, found.mean + away, past, len(record)
            )

    @property
    def free_energy(self) -> float:
        """F̄, nats."""
        return sum(self.terms.values())

    def known_every(
        self, steps: int, inputs: Array, outputs: Array, smooth: bool = False
    ) -> var.Forecast:
        """Returns (H, m) forecasts begun at every ``steps``-th of ``inputs`` (H, r) and ``outputs`` (H, m).

        Inputs are measured up to each sample; or, to ``smooth``, all of a forecast's.
        """
        length, m = outputs.shape
        steps = max(1, min(steps, length))
        combined = inputs @ self.combinations
        pasts = self.process.pasts(self.past, steps, combined, outputs)
        rows = var.pieces(len(pasts), steps, length)
        filtered = self.process.filter(m, steps)
        lags = self.choice.lags
        before = self.process.units.scaled(pasts)
        now = self.process.units.scaled_inputs(combined[rows])
        weights, offsets = self._weights
        parts = weights[:, :, :m], weights[:, :, m:]
        of_outputs, of_inputs = (
            part.reshape(len(weights), -1, weights.shape[-1]) for part in parts
        )
        earlier = var.lagged(np.concatenate([before[..., m:], now], axis=-2), lags)
        drives = earlier @ of_inputs[:, None] + offsets[:, None, None]
        state = np.repeat(var.latest_first(before[..., :m])[None], len(weights), axis=0)
        made = np.empty((*drives.shape[:-1], m))
        with np.errstate(over="ignore", invalid="ignore"):
            for t in range(steps):
                expected = state @ of_outputs + drives[:, :, t]
                gain = filtered.gains[min(t, len(filtered.gains) - 1)]
                state = np.concatenate([expected[..., :m], state[..., :-m]], axis=-1)
                state += (now[:, t] - expected[..., m:]) @ gain.T
                np.clip(state, -LARGEST, LARGEST, out=state)
                made[:, :, t] = state[..., :m]
        variance = np.maximum(
            np.diagonal(filtered.covariances_of(steps), axis1=1, axis2=2)[1:, :m], 0.0
        )
        moved = np.mean(now**2, axis=-1).cumsum(axis=1) / np.arange(1, steps + 1)
        mean = made[0]
        spread = np.mean((made[1:] - made[0]) ** 2, axis=0)
        if smooth:
            mean = self.process.units.scaled(
                self.process.infer(pasts, combined[rows], smooth=True).mean
            )
        return self._answer(mean, spread, variance, np.maximum(moved, 1.0)[..., None], length)

    def unknown_every(self, steps: int, inputs: Array, outputs: Array) -> var.Forecast:
        """Returns (H, m) forecasts likewise, each without the inputs after its beginning."""
        length, m = outputs.shape
        steps = max(1, min(steps, length))
        pasts = self.process.pasts(self.past, steps, inputs @ self.combinations, outputs)
        weights, offsets = self._weights
        weights = weights.reshape(len(weights), -1, weights.shape[-1])
        state = np.repeat(
            var.latest_first(self.process.units.scaled(pasts))[None], len(weights), axis=0
        )
        made = np.empty((*state.shape[:2], steps, m))
        with np.errstate(over="ignore", invalid="ignore"):
            for t in range(steps):
                following = np.clip(state @ weights + offsets[:, None], -LARGEST, LARGEST)
                state = np.concatenate([following, state[..., : -following.shape[-1]]], axis=-1)
                made[:, :, t] = following[..., :m]
        variance = self.process.variances(steps)[:, :m]
        variance = np.where(variance < LARGEST, variance, LARGEST)
        return self._answer(
            made[0], np.mean((made[1:] - made[0]) ** 2, axis=0), variance, np.ones(1), length
        )

    def predict_every(self, steps: int, inputs: Array, outputs: Array) -> Array:
        """Returns (H, m) the mean of :meth:`unknown_every`."""
        return self.unknown_every(steps, inputs, outputs).mean

    def forecast_every_with_band(
        self, steps: int, inputs: Array, outputs: Array, level: float
    ) -> tuple[Array, Array, Array]:
        """Returns :meth:`known_every`, mean and variance, and the half width of its band of probability ``level``."""
        mean, variance = self.known_every(steps, inputs, outputs)
        return mean, variance, self.half_widths(variance, level, steps)

    def one_step(self, record: Record) -> Array:
        """Returns (T, m): each sample of ``record`` from those before it in its segment and the inputs up to it."""
        return self.process.one_step(_combined(record, self.combinations))

    def half_widths(self, variance: Array, level: float, steps: int) -> Array:
        """Returns (H, m) of the band of probability ``level`` of forecasts of that ``variance``, begun each ``steps``.

        The variance is known by as many forecasts as the training data hold, each as far from the next as it is long,
        so that their errors are hardly correlated: Student's t.
        """
        lengths = np.arange(len(variance)) % max(1, steps) + 1
        return half_width(
            variance,
            level,
            np.maximum(self.samples / (2 * lengths), 4 * var.LEAST_FREEDOM)[:, None],
        )

    @property
    def _weights(self) -> tuple[Array, Array]:
        """(1 + D, L, k, k) by lag and (1 + D, k): of the mean and of each draw."""
        k = self.draws.shape[-1]
        across = self.process.across.T
        offset = self.process.offset
        every = np.concatenate([np.vstack([across, offset])[None], self.draws])
        return every[:, :-1].reshape(len(every), -1, k, k), every[:, -1]

    def _answer(
        self, deviation: Array, spread: Array, variance: Array, prior: Array, length: int
    ) -> var.Forecast:
        """The forecast of a ``deviation`` d (S, H, m) from the training mean with a ``spread`` V of draws; scaled.

        It was expected with variance S, the ``prior``; as far as the posterior leaves it open it becomes d / (1 + V/S).
        """
        kept = 1 / (1 + spread / prior)
        center, scale = (values[: deviation.shape[-1]] for values in self.process.units)
        answers = deviation * kept, variance + spread * kept
        mean, squared = (table.reshape(-1, table.shape[-1])[:length] for table in answers)
        return var.Forecast(center + scale * mean, scale**2 * squared)
