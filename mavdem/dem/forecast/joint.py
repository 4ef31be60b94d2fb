"""The joint model: outputs and the motors that turn the axis as one process, of which the motors measure the motion.

In closed loop the motors answer the very disturbance that moves the vehicle. So they are no inputs: they are outputs
of one generative model of vehicle, wind and autopilot, z = [outputs, turning combination of the motors],

    z_t = Σᵢ Wᵢ z_{t−i} + c + e_t,    i = 1 … L.

Its hidden states — lagging torque, wind, what the controller remembers — are what the past of z shows of them. The
model is linear in W and Gaussian, so that DEM's steps have closed forms. F̄ is the logarithm of the evidence; it chooses
L, the prior's precision and, where the mixer is not known, the combination of the motors: docs/how_it_works.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import hadamard

from mavdem.arrays import Array
from mavdem.confidence import half_width
from mavdem.dem.engine.linalg import one_thread
from mavdem.dem.forecast import var
from mavdem.dem.record import MIN_MOTORS, Record
from mavdem.immutable import ImmutableResult

LAG_CANDIDATES = (6, 8, 10, 14, 20)  # that F̄ chooses from, samples
# likewise, precisions of the prior at lag 1, of channels of deviation 1
RIDGE_CANDIDATES = (1e-4, 1e-3, 1e-2)
# of the rotors of an X, however they are numbered: each turns one axis
X_PATTERNS = hadamard(4)[1:] / 2
# added to their innovations: how well an angle follows from its rate tells nothing of the motors
MIXER_NOISE = 1e-5
LEAST_FREEDOM = 3.0  # of Student's t, for which a variance is finite


class VarHyperparameters(NamedTuple):
    """What F̄ chooses: the samples of the past that count, and the prior of their coefficients."""

    lags: int
    ridge: float

    @property
    def prior(self) -> Array:
        """(lags, lags) precision of a channel's coefficients by lag."""
        return var.lag_prior(self.lags, self.ridge)


HYPERPARAMETER_GRID = tuple(
    VarHyperparameters(lags, ridge) for lags in LAG_CANDIDATES for ridge in RIDGE_CANDIDATES
)


def known_axis_mixer(inputs: int, effect_directions: Array | None) -> Array | None:
    """Returns (r, c) as :func:`axis_mixer`; ``None`` where a flight must tell."""
    if inputs < MIN_MOTORS:
        return np.eye(inputs)
    if effect_directions is None or not effect_directions.any():
        return None
    return effect_directions[:, None] / np.linalg.norm(effect_directions)


def axis_mixer(record: Record) -> Array:
    """Returns (r, c) the combinations of the inputs that turn the axis, of unit length.

    One where the mixer is known; of other rotors the one of an X, or as the motors' effects come out, that shares most
    with the outputs; inputs that are no rotors as they are.
    """
    r = record.inputs.shape[1]
    m = record.outputs.shape[1]
    combinations = known_axis_mixer(r, record.effect_directions)
    if combinations is not None:
        return combinations
    lags = min(LAG_CANDIDATES[2], max(1, record.longest_segment // 4))
    prior = var.lag_prior(lags, RIDGE_CANDIDATES[1])
    units, statistics = var.LagStatistics.from_record(record, lags)
    ahead = var.regress(statistics.gram, statistics.rows, prior).mean[:-1, m - 1]
    effects = ahead.reshape(lags, m + r)[:, m:].sum(axis=0) / units.scale[m:]
    # What the flight tells of the motors' effects costs as many nats as its numbers (Schwarz, 1978).
    cost = 0.5 * (r - 1) * np.log(statistics.rows)
    tried = [(effects / (np.linalg.norm(effects) or 1.0), cost)]
    tried += [(pattern, 0.0) for pattern in X_PATTERNS if r == len(pattern)]
    return max(tried, key=lambda each: _shared(record, each[0], prior) - each[1])[0][:, None]


def _shared(record: Record, combination: Array, prior: Array) -> float:
    """Shared information of outputs and a ``combination`` of the inputs, nats: F̄ of both together, less its own.

    F̄ of the outputs alone is no criterion: in closed loop what turns the axis follows from the axis, and adds little to
    its past; any slow combination, whose lags are alike and so cost fewer nats, may do as well.
    """
    _, statistics = var.LagStatistics.from_record(
        _combined(record, combination[:, None]), len(prior)
    )
    k = record.outputs.shape[1] + 1
    offset = len(prior) * k
    own = np.r_[k - 1 : offset : k, offset, offset + k]
    both, alone = (
        var.regress(gram, statistics.rows, prior, MIXER_NOISE).free_energy
        for gram in (statistics.gram, statistics.gram[np.ix_(own, own)])
    )
    return both - alone


def _combined(record: Record, combinations: Array) -> Record:
    """The record with these (r, c) combinations of its inputs as the inputs."""
    return replace(record, inputs=record.inputs @ combinations, effect_directions=None)


def select_hyperparameters(
    statistics: var.LagStatistics,
    lags: int,
    choices: Sequence[VarHyperparameters] = HYPERPARAMETER_GRID,
) -> tuple[VarHyperparameters, var.Regression]:
    """Returns the one of these ``choices`` of the highest F̄, and its posterior, for ``statistics`` of so many ``lags``.

    Where all need more lags, that of so many.
    """
    possible = [choice for choice in choices if choice.lags <= lags]
    tried = [
        (
            choice,
            var.regress(statistics.shortened(lags, choice.lags), statistics.rows, choice.prior),
        )
        for choice in possible or [VarHyperparameters(lags, ridge) for ridge in RIDGE_CANDIDATES]
    ]
    return max(tried, key=lambda fitted: fitted[1].free_energy)


@dataclass(frozen=True, eq=False)
class JointModel(ImmutableResult):
    """The learned joint model and its forecasts; all arguments and results are physical.

    Attributes:
        combinations: (r, c) of the inputs, that are channels of the model.
        choice: what F̄ chose.
        process: the model at the posterior's mean.
        terms: of F̄, nats.
        past: (L, k) the last samples of the training data.
        samples: of the training data.
    """

    combinations: Array
    choice: VarHyperparameters
    process: var.VectorAutoregression
    terms: dict[str, float]
    past: Array
    samples: int

    @classmethod
    def learn(cls, record: Record) -> JointModel:
        """Learns from training data; ``ValueError`` where no segment has two samples."""
        with one_thread():
            combinations = axis_mixer(record)
            lags = max(
                (lag for lag in LAG_CANDIDATES if lag <= record.longest_segment // 4),
                default=max(1, min(LAG_CANDIDATES[0], record.longest_segment - 1)),
            )
            combined = _combined(record, combinations)
            units, statistics = var.LagStatistics.from_record(combined, lags)
            choice, regression = select_hyperparameters(statistics, lags)
            process = var.VectorAutoregression.from_regression(regression, units)
            past = process.past(combined)
            return cls(combinations, choice, process, regression.terms, past, len(record))

    def rolling_forecast_known_inputs(
        self,
        steps: int,
        inputs: Array,
        outputs: Array,
        smooth: bool = False,
    ) -> var.Forecast:
        """Returns (H, m) forecasts begun at every ``steps``-th of ``inputs`` (H, r) and ``outputs`` (H, m).

        Inputs are measured up to each sample; or, to ``smooth``, all of a forecast's.
        """
        combined = inputs @ self.combinations
        return self.process.infer_every(self.past, steps, combined, outputs, smooth)

    def rolling_forecast_unknown_inputs(
        self, steps: int, inputs: Array, outputs: Array
    ) -> var.Forecast:
        """Returns (H, m) forecasts likewise, each without the inputs after its beginning."""
        return self.process.predict_every(self.past, steps, inputs @ self.combinations, outputs)

    def one_step(self, record: Record) -> Array:
        """Returns (T, m): each sample of ``record`` from those before it in its segment and the inputs up to it."""
        return self.process.one_step(_combined(record, self.combinations))

    def half_widths(self, variance: Array, level: float, steps: int) -> Array:
        """Returns (H, m) of the band of probability ``level`` of forecasts of that ``variance``, begun each ``steps``.

        The variance is known by as many forecasts as the training data hold, a quarter of them one after the other, so
        that their errors are hardly correlated: Student's t.
        """
        lengths = np.arange(len(variance)) % max(1, steps) + 1
        freedom = np.maximum(self.samples / (4 * lengths), LEAST_FREEDOM)
        return half_width(variance, level, freedom[:, None])
