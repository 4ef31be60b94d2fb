"""The joint model: outputs and motors as one vector autoregression, whose order and prior the free energy selects.

In closed loop the motors answer the very disturbance that moves the vehicle. So they are no inputs: they are outputs of
one generative model of vehicle, wind and autopilot, z = [outputs, motors combined by the mixer row of the axis],

    z_t = Σᵢ Aᵢ z_{t−i} + offset + e_t,    i = 1 … L.

Its hidden states, such as the lagging torque, the wind and what the controller remembers, are what the past of z shows
of them. The model is linear in its parameters and Gaussian, so that DEM's steps have closed forms and F̄ is the log
evidence. F̄ selects L, the prior's precision and, if the mixer is not known, the combination of the motors:
docs/how_it_works.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import half_width
from mavdem.dem.engine.linalg import one_thread
from mavdem.dem.forecast import lag_regression, var
from mavdem.dem.record import MIN_MOTORS, Record
from mavdem.immutable import ImmutableResult

LAG_CANDIDATES = (6, 8, 10, 14, 20)
"""Numbers of lags L, in samples, from which F̄ selects. A choice: at 100 Hz, 0.06 to 0.2 s of the past."""

RIDGE_CANDIDATES = (1e-4, 1e-3, 1e-2)
"""Prior precisions of the first lag's coefficients, of channels of variance 1, from which F̄ selects."""

MIXER_LAGS = 10
"""Number of lags with which the motors' effects are estimated if the mixer is not known."""

MIXER_RIDGE = 1e-3
"""Prior precision of the first lag's coefficients in that estimate."""

QUADROTOR_X_MIXERS = np.array([[1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]]) / 2
"""(3, 4) mixer rows of a quadrotor X, of unit length: roll, pitch and yaw in some order, for any motor numbering.

On each axis two motors turn the vehicle one way and two the other.
"""

MIXER_NOISE = 1e-5
"""Variance added to the innovations' variance, of channels of variance 1, where F̄ compares combinations of the motors.

Without it the angle, which follows from its rate almost exactly, would dominate F̄, and it contains no information on
the motors.
"""

MIN_STUDENT_FREEDOM = 3.0
"""Least degrees of freedom of Student's t in a band; with 2 or fewer its variance would be infinite."""

FORECASTS_PER_INDEPENDENT_ERROR = 4
"""Number of consecutive forecasts that count as one independent error, since consecutive errors are correlated."""

MIN_SAMPLES_PER_LAG = 4
"""Least number of samples of the longest segment for each lag: a choice."""


class VarHyperparameters(NamedTuple):
    """Hyperparameters of the joint autoregression, which F̄ selects."""

    lags: int
    """Number of lags L."""

    ridge: float
    """Prior precision of the coefficients of the first lag; it grows with the square of the lag."""

    @property
    def prior_precision(self) -> Array:
        """(L, L) prior precision of a channel's coefficients by lag."""
        return lag_regression.lag_prior_precision(self.lags, self.ridge)


HYPERPARAMETER_GRID = tuple(
    VarHyperparameters(lags, ridge) for lags in LAG_CANDIDATES for ridge in RIDGE_CANDIDATES
)
"""All combinations of the candidates."""


def known_axis_mixer(inputs: int, effect_directions: Array | None) -> Array | None:
    """Returns the combinations of inputs that turn the axis, if they need not be estimated from a flight.

    If the effects of a multirotor's motors on the axis are known, there is one combination, with weights proportional
    to them. With fewer inputs than a multirotor has motors, each input is used by itself.

    Args:
        inputs: number of inputs r.
        effect_directions: (r,) relative effect of each motor on the axis; None if it is not known.

    Returns:
        (r, c) c combinations as columns of unit length; None if the effects must be estimated.
    """
    if inputs < MIN_MOTORS:
        return np.eye(inputs)
    if effect_directions is None or not effect_directions.any():
        return None
    return effect_directions[:, None] / np.linalg.norm(effect_directions)


def axis_mixer(record: Record) -> Array:
    """Returns the combinations of the inputs that turn the axis, which become channels of the joint model.

    If the mixer is not known, one candidate are the motors' effects as estimated by a regression of the last output.
    For four motors, the mixer rows of a quadrotor X are further candidates. The candidate with the largest mutual
    information with the outputs is used. The estimated effects have r − 1 free numbers, so that ½ ln N nats for each
    are subtracted from their mutual information, with N samples (the BIC; Schwarz, "Estimating the dimension of a
    model", 1978).

    Args:
        record: the training data: T samples of r inputs and m outputs, in one or several segments.

    Returns:
        (r, c) combinations of unit length as columns: one for a multirotor, each single input for fewer inputs.

    Raises:
        NotLearnable: no segment has two samples.
    """
    motor_count = record.inputs.shape[1]
    mixer = known_axis_mixer(motor_count, record.effect_directions)
    if mixer is not None:
        return mixer
    lags = min(MIXER_LAGS, max(1, record.longest_segment // MIN_SAMPLES_PER_LAG))
    prior_precision = lag_regression.lag_prior_precision(lags, MIXER_RIDGE)
    scaling, statistics = lag_regression.LagStatistics.from_record(record, lags)
    regression = lag_regression.regress(statistics.gram, statistics.row_count, prior_precision)
    estimated_row = _mixer_row_of_regression(regression, scaling, motor_count)
    estimation_cost = 0.5 * (motor_count - 1) * np.log(statistics.row_count)

    # The mixer rows of a frame have no free numbers, so that nothing is subtracted.
    best_row = estimated_row
    best_score = _mutual_information(record, estimated_row, prior_precision) - estimation_cost
    for mixer_row in QUADROTOR_X_MIXERS:
        if motor_count == len(mixer_row):
            score = _mutual_information(record, mixer_row, prior_precision)
            if score > best_score:
                best_row = mixer_row
                best_score = score
    return best_row[:, None]


def _mixer_row_of_regression(
    regression: lag_regression.Regression, scaling: lag_regression.ChannelScaling, motor_count: int
) -> Array:
    """Returns the effects of the motors on the last output, by an autoregression of outputs and all motors.

    The effect of a motor is the sum of its coefficients over all lags in the regression of the last output.

    Args:
        regression: the autoregression; its channels are the m outputs, and then the motors.
        scaling: means and standard deviations of the channels.
        motor_count: number r of motors.

    Returns:
        (r,) effects of unit length; zeros if all effects are zero.
    """
    # The coefficients of a channel are a column of the mean: those of each lag, channel by channel, and the constant.
    channel_count = regression.mean.shape[1]
    output_count = channel_count - motor_count
    last_output = output_count - 1
    coefficients = regression.mean[:-1, last_output].reshape(-1, channel_count)
    motor_scales = scaling.scale[output_count:]
    effects = coefficients[:, output_count:].sum(axis=0) / motor_scales
    return effects / (np.linalg.norm(effects) or 1.0)


def _mutual_information(record: Record, mixer_row: Array, prior_precision: Array) -> float:
    """Returns the mutual information of the outputs and a combination of the inputs, up to a constant, nats.

    It is the log evidence F̄ of a joint autoregression of both, minus the log evidences of two separate ones. The
    log evidence of the outputs alone is the same for every combination, and is left out.

    The evidence of the outputs given the combination would not be suitable. In closed loop, the controller computes the
    combination that turns the axis from the motion itself, so that it adds little information to the past motion.

    Args:
        record: the training data: T samples of r inputs and m outputs, in one or several segments.
        mixer_row: (r,) the combination.
        prior_precision: (L, L) prior precision of a channel's coefficients by lag.

    Returns:
        F̄ of the joint autoregression minus F̄ of the autoregression of the combination alone, nats.
    """
    lags = len(prior_precision)
    combined_record = _with_combined_inputs(record, mixer_row[:, None])
    statistics = lag_regression.LagStatistics.from_record(combined_record, lags).statistics
    k = record.outputs.shape[1] + 1
    # A row of the statistics has the k channels of each lag, the constant, and the k channels of the sample. The
    # combination is the last channel. The regression of it alone uses its column at each lag, the constant, and its
    # sample.
    constant_column = lags * k
    lag_columns = np.arange(k - 1, constant_column, k)
    sample_column = constant_column + k
    columns_of_combination = np.append(lag_columns, [constant_column, sample_column])
    gram_of_combination = statistics.gram[np.ix_(columns_of_combination, columns_of_combination)]
    joint = lag_regression.regress(
        statistics.gram, statistics.row_count, prior_precision, MIXER_NOISE
    )
    alone = lag_regression.regress(
        gram_of_combination, statistics.row_count, prior_precision, MIXER_NOISE
    )
    return joint.free_energy - alone.free_energy


def _with_combined_inputs(record: Record, mixer: Array) -> Record:
    """Replaces the inputs of a record by linear combinations of them.

    Args:
        record: the record, with r inputs.
        mixer: c combinations of the inputs, one in each column (r, c).

    Returns:
        A copy of the record with c inputs.
    """
    return replace(record, inputs=record.inputs @ mixer, effect_directions=None)


def select_hyperparameters(
    statistics: lag_regression.LagStatistics,
    lags: int,
    candidates: Sequence[VarHyperparameters] = HYPERPARAMETER_GRID,
) -> tuple[VarHyperparameters, lag_regression.Regression]:
    """Selects the number of lags and the ridge of the joint autoregression by the highest free energy F̄.

    Args:
        statistics: statistics of the samples with ``lags`` lags.
        lags: number of lags of the statistics.
        candidates: hyperparameters to select from. Those with more lags are left out; if none remains, all ridges are
            tried with ``lags`` lags.

    Returns:
        The selected hyperparameters and the regression with them; of equal ones the first.
    """
    possible_candidates = [candidate for candidate in candidates if candidate.lags <= lags]
    if not possible_candidates:
        possible_candidates = [VarHyperparameters(lags, ridge) for ridge in RIDGE_CANDIDATES]
    candidates_with_regressions = []
    for candidate in possible_candidates:
        # All candidates are fitted to the same samples, so that their free energies can be compared.
        gram = statistics.gram_of_fewer_lags(lags, candidate.lags)
        regression = lag_regression.regress(gram, statistics.row_count, candidate.prior_precision)
        candidates_with_regressions.append((candidate, regression))

    def free_energy(fit: tuple[VarHyperparameters, lag_regression.Regression]) -> float:
        """Returns the free energy of a candidate's regression, nats."""
        _, regression = fit
        return regression.free_energy

    return max(candidates_with_regressions, key=free_energy)


@dataclass(frozen=True, eq=False)
class JointModel(ImmutableResult):
    """A learned vector autoregression of outputs and motors, with its forecasts; all samples are in physical units."""

    mixer: Array
    """(r, c) combinations of the inputs, as columns, that are channels of the model after the m outputs."""

    hyperparameters: VarHyperparameters
    """Number of lags and prior precision that F̄ selected."""

    process: var.VectorAutoregression
    """The autoregression with the posterior means of its parameters."""

    terms: dict[str, float]
    """Terms of F̄ by name, nats."""

    last_samples: Array
    """(L, m + c) last samples of the training data, from which forecasts start."""

    sample_count: int
    """Number of samples of the training data."""

    @classmethod
    def learn(cls, record: Record) -> JointModel:
        """Learns the joint model from training data: first the mixer, then the lags and the ridge of highest F̄.

        Args:
            record: the training data: T samples of r inputs and m outputs, in one or several segments.

        Returns:
            The model, with the last samples of the training data, from which its forecasts start.

        Raises:
            NotLearnable: no segment has two samples.
        """
        with one_thread():
            mixer = axis_mixer(record)
            # The statistics of the largest number of lags contain the statistics of fewer lags.
            lags = _largest_lags(record)
            combined_record = _with_combined_inputs(record, mixer)
            scaling, statistics = lag_regression.LagStatistics.from_record(combined_record, lags)
            hyperparameters, regression = select_hyperparameters(statistics, lags)
            process = var.VectorAutoregression.from_regression(regression, scaling)
            return cls(
                mixer,
                hyperparameters,
                process,
                regression.terms,
                last_samples=process.last_samples(combined_record),
                sample_count=len(record),
            )

    def rolling_forecast_known_inputs(
        self,
        steps: int,
        inputs: Array,
        outputs: Array,
        smooth: bool = False,
    ) -> var.Forecast:
        """Forecasts the outputs with the inputs as measurements, starting again at every ``steps``-th sample.

        Args:
            steps: number of samples from the start of one forecast to the next.
            inputs: (H, r) inputs after the training data.
            outputs: (H, m) outputs after the training data; each forecast uses those before its start only.
            smooth: whether each sample of a forecast is estimated from all of its inputs, not only from those up to the
                sample.

        Returns:
            The outputs (H, m) with their variance.
        """
        return self.process.rolling_forecast_known_inputs(
            self.last_samples, steps, inputs @ self.mixer, outputs, smooth
        )

    def rolling_forecast_unknown_inputs(
        self, steps: int, inputs: Array, outputs: Array
    ) -> var.Forecast:
        """Forecasts the outputs with unknown future inputs, starting again at every ``steps``-th sample.

        Args:
            steps: number of samples from the start of one forecast to the next.
            inputs: (H, r) inputs after the training data; each forecast uses those before its start only.
            outputs: (H, m) outputs after the training data; each forecast uses those before its start only.

        Returns:
            The outputs (H, m) with their variance.
        """
        return self.process.rolling_forecast_unknown_inputs(
            self.last_samples, steps, inputs @ self.mixer, outputs
        )

    def one_step_predictions(self, record: Record) -> Array:
        """Predicts the outputs of each sample of a record from the samples before it and from its own inputs.

        Args:
            record: T samples in any number of segments.

        Returns:
            Outputs (T, m).
        """
        return self.process.one_step_predictions(_with_combined_inputs(record, self.mixer))

    def half_widths(self, variance: Array, level: float, steps: int) -> Array:
        """Returns the half widths of bands about rolling forecasts, by Student's t.

        The variance was estimated from the training data, in which errors of overlapping forecasts are not independent.
        So the degrees of freedom of a forecast of i samples are the number of such forecasts that fit into the training
        data without overlap, divided by ``FORECASTS_PER_INDEPENDENT_ERROR``, and at least ``MIN_STUDENT_FREEDOM``.

        Args:
            variance: (H, m) variances of the forecasts.
            level: probability of the band.
            steps: number of samples from the start of one forecast to the next.

        Returns:
            Half widths (H, m).
        """
        # Number of steps from the start of its forecast to each sample.
        forecast_lengths = np.arange(len(variance)) % max(1, steps) + 1
        independent_forecasts = self.sample_count / (
            FORECASTS_PER_INDEPENDENT_ERROR * forecast_lengths
        )
        freedom = np.maximum(independent_forecasts, MIN_STUDENT_FREEDOM)
        return half_width(variance, level, freedom[:, None])


def _largest_lags(record: Record) -> int:
    """Returns the largest number of lags of an autoregression for which a record is long enough.

    That is the largest of the ``LAG_CANDIDATES`` for which the longest segment has ``MIN_SAMPLES_PER_LAG`` samples for
    each lag. If it is too short for all of them, it is the smallest candidate, or one less than the samples of the
    segment.

    Args:
        record: the training data: T samples of r inputs and m outputs, in one or several segments.

    Returns:
        The number of lags, at least 1.
    """
    supported_lags = record.longest_segment // MIN_SAMPLES_PER_LAG
    possible_lags = [lags for lags in LAG_CANDIDATES if lags <= supported_lags]
    if possible_lags:
        return max(possible_lags)
    # An autoregression of L lags needs at least L + 1 samples in a row.
    smallest_candidate = LAG_CANDIDATES[0]
    return max(1, min(smallest_candidate, record.longest_segment - 1))
