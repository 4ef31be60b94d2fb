"""The joint model of a stream: it predicts each sample from those before it, and the next samples with inputs unknown.

The joint model is a vector autoregression of the outputs and of the combination of motors that turns the axis
(``mavdem.dem.forecast.joint``). The sums over samples that its regression needs are forgotten exponentially, and every
half second the model is fitted to them again.
"""

from collections.abc import Iterable
from contextlib import suppress
from itertools import cycle
from typing import NamedTuple

import numpy as np
from numpy.linalg import LinAlgError

from mavdem.arrays import Array
from mavdem.dem.engine.linalg import may_overflow, one_thread
from mavdem.dem.forecast.joint import (
    HYPERPARAMETER_GRID,
    LAG_CANDIDATES,
    VarHyperparameters,
    select_hyperparameters,
)
from mavdem.dem.forecast.lag_regression import ChannelScaling, LagStatistics, latest_samples
from mavdem.dem.forecast.var import VectorAutoregression
from mavdem.dem.online.memory import MemoryBlock, SampleMemory
from mavdem.dem.online.prediction_errors import PredictionErrors

MEMORY_SECONDS = 30.0
"""Time constant with which samples are forgotten, s; a choice."""

FIRST_FIT_SECONDS = 1.0
"""Length of the samples before the first fit, s; their means and deviations scale the channels."""

REFIT_SECONDS = 0.5
"""Length of new samples from one fit to the next, s; a choice."""

MAX_LAGS = LAG_CANDIDATES[-1]
"""Most lags that a model may have, samples; the sums are kept for as many."""

INITIAL_HYPERPARAMETERS = VarHyperparameters(LAG_CANDIDATES[2], 1e-3)
"""Lags and ridge of the first fit, in the middle of those that are tried."""


class PredictionMaps(NamedTuple):
    """A fitted model as linear maps from the latest samples, in physical units, to all of its predictions.

    Scaling of the channels and combination of the inputs are part of the maps, since they are applied to every sample
    of a stream. With H horizons, L = ``MAX_LAGS``, m outputs and r inputs, the rows are first the outputs at each
    horizon, and last the outputs of the latest sample from its own inputs and the samples before.

    Attributes:
        output_map: ((H + 1) m, (L + 1) m) map of the outputs of the L + 1 latest samples, the earliest first.
        input_map: ((H + 1) m, (L + 1) r) map of their inputs.
        constants: ((H + 1) m,) constants that are added.
    """

    output_map: Array
    input_map: Array
    constants: Array

    @may_overflow
    def predict(self, inputs: Array, outputs: Array) -> Array:
        """Predicts the outputs at all horizons from the latest samples, and the latest sample from those before it.

        Args:
            inputs: Inputs of the latest samples, (T, r). If T is below L + 1, the samples before the first are assumed
                to equal the first.
            outputs: Outputs of the same samples, (T, m).

        Returns:
            (H + 1, m) outputs at each horizon and, last, of the latest sample. Values that overflow are not finite.
        """
        if len(outputs) <= MAX_LAGS:
            inputs = latest_samples(inputs, MAX_LAGS + 1)
            outputs = latest_samples(outputs, MAX_LAGS + 1)
        predictions = self.output_map.dot(outputs.ravel())
        predictions += self.input_map.dot(inputs.ravel())
        predictions += self.constants
        return predictions.reshape(-1, outputs.shape[1])


class NextPredictions(NamedTuple):
    """Predictions that are made when the latest sample of a stream has arrived."""

    expected: Array
    """(m,) the latest sample as predicted from those before it and from its own inputs; NaN without a prediction."""

    ahead: Array
    """(H, m) predictions at each horizon."""


class OnlineForecaster:
    """Predicts a stream at H horizons by a vector autoregression, which learns from each new block of samples.

    Before the first fit the last sample is held.

    Attributes:
        axis_mixer: (r, c) combinations of the inputs that turn the axis; ``None`` while they are not known, so that
            there is no model.
        errors: Errors of the predictions, compared with the errors of trivial predictions.
    """

    def __init__(
        self,
        dt: float,
        horizons: tuple[int, ...],
        outputs: int,
        axis_mixer: Array | None,
    ) -> None:
        """Begins without samples.

        Args:
            dt: Sampling step, s.
            horizons: Steps ahead to predict, increasing.
            outputs: Number of outputs, m.
            axis_mixer: (r, c) combinations of the inputs that turn the axis, or ``None`` if :meth:`relearn` brings
                them later.
        """
        self._dt = dt
        self._horizons = np.array(horizons)
        self._outputs = outputs
        self.errors = PredictionErrors(dt, horizons, outputs)
        self._maps: PredictionMaps | None = None
        # The hyperparameters of the last fit, and those to compare with: each fit tries one other, in turn.
        self._hyperparameters = INITIAL_HYPERPARAMETERS
        self._alternatives = cycle(HYPERPARAMETER_GRID)
        self.relearn((), axis_mixer)

    def relearn(self, blocks: Iterable[MemoryBlock], axis_mixer: Array | None) -> None:
        """Discards all samples and learns from these blocks instead.

        It is called when the mixer has changed, or when samples have turned out not to be of flight. The fitted model
        is kept, and predicts until the next fit. So the blocks are added without fits between them.

        Args:
            blocks: Blocks in the order of time.
            axis_mixer: (r, c) combinations of the inputs that turn the axis.
        """
        self.axis_mixer = axis_mixer
        # Blocks of the first second, whose samples determine the scaling of the channels.
        self._blocks_before_scaling: list[MemoryBlock] = []
        self._scaling: ChannelScaling | None = None
        # Sums over all samples, with weights that decrease exponentially with their age.
        self._statistics: LagStatistics | None = None
        # Scaled channels (up to L, k) of the latest samples in the sums, which are the lags of the next samples.
        self._latest_channels = np.empty((0, 0))
        self._samples_since_fit = 0
        self.errors.forget_averages()
        for block in blocks:
            self.add_block(block, may_fit=False)

    def end_segment(self) -> None:
        """Ends a segment, as a gap follows: no sample after it is compared with predictions before it."""
        self.errors.forget_predictions()

    def predict(self, memory: SampleMemory) -> NextPredictions:
        """Predicts the next samples from the latest one, and records the errors of earlier predictions.

        ``errors`` compares the latest sample with the earlier predictions of it. Then it stores the new predictions,
        which are compared with later samples.

        Args:
            memory: Memory to which the latest sample has been added.

        Returns:
            The prediction of the latest sample, NaN if there is none, and the predictions at each horizon.
        """
        # A prediction needs the latest sample and the ``MAX_LAGS`` samples before it.
        inputs, outputs = memory.latest_samples(MAX_LAGS + 1)
        self.errors.compare(outputs[-1])
        predictions = self._predictions(inputs, outputs)
        self.errors.store(predictions.ahead, outputs[-1])
        return predictions

    def _predictions(self, inputs: Array, outputs: Array) -> NextPredictions:
        """Returns the predictions by the fitted model or, where it gives none, the latest sample itself.

        There is none before the first fit, and soon after a gap, when the samples of some lags are not known. Single
        predictions that overflow are replaced too.

        Args:
            inputs: Inputs of the latest samples since the last gap, (T, r), at most ``MAX_LAGS`` + 1.
            outputs: Outputs of the same samples, (T, m).
        """
        latest_outputs = outputs[-1]
        expected_outputs = np.full(self._outputs, np.nan)
        ahead = np.tile(latest_outputs, (len(self._horizons), 1))
        if self._maps is not None:
            # (H + 1, m): at each horizon and, last, of the latest sample itself.
            predictions = self._maps.predict(inputs, outputs)
            if len(outputs) > 1:
                expected_outputs = predictions[-1]
            if len(outputs) >= MAX_LAGS:
                is_finite = np.isfinite(predictions[:-1])
                ahead = np.where(is_finite, predictions[:-1], latest_outputs)
        return NextPredictions(expected_outputs, ahead)

    def add_block(self, block: MemoryBlock, *, may_fit: bool = True) -> None:
        """Learns from a block of samples that has just been completed.

        The model is a linear regression of each sample on the samples before it, computed from sums over all samples.
        The block's samples are added to these sums. When ``REFIT_SECONDS`` of samples have come since the last fit, the
        model is fitted to the sums again.

        Args:
            block: Consecutive samples of inputs and outputs of one segment.
            may_fit: Whether the model is fitted when a fit is due. While another thread computes a fit, this fit is
                postponed, so that samples do not wait.
        """
        # The mixer combines the motor outputs to demands on roll, pitch and yaw, on which the regression is. It may not
        # be known yet: :meth:`relearn` is given the blocks again when it is.
        if self.axis_mixer is None:
            return
        # The samples of the first second determine the scaling, and are added to the sums only when it is known.
        if self._scaling is None:
            self._blocks_before_scaling.append(block)
            self._scaling = self._scaling_of_first_second(self.axis_mixer)
            if self._scaling is None:
                return
            new_blocks = self._blocks_before_scaling
            self._blocks_before_scaling = []
        else:
            new_blocks = [block]
        for new_block in new_blocks:
            # After the last block these are the sums over all samples so far.
            statistics = self._updated_statistics(new_block, self.axis_mixer, self._scaling)
        seconds_since_fit = self._samples_since_fit * self._dt
        is_fit_due = seconds_since_fit >= REFIT_SECONDS and statistics.row_count >= 1
        if may_fit and is_fit_due:
            # If another thread computes (``is_free`` is then false), or the regression fails, the fit is made after a
            # later block.
            with one_thread(wait=False) as is_free, suppress(LinAlgError):
                if is_free:
                    self._samples_since_fit = 0
                    self._refit(self.axis_mixer, statistics, self._scaling)

    def _channels(self, block: MemoryBlock, axis_mixer: Array) -> Array:
        """Returns the channels of a block, its outputs and the combinations of its inputs, in physical units.

        Args:
            block: The block, of b samples.
            axis_mixer: (r, c) combinations of the inputs.

        Returns:
            (b, m + c) channels.
        """
        return np.hstack([block.outputs, block.inputs @ axis_mixer])

    def _scaling_of_first_second(self, axis_mixer: Array) -> ChannelScaling | None:
        """Returns the scaling of the channels by the samples of the first second.

        Args:
            axis_mixer: (r, c) combinations of the inputs.

        Returns:
            Mean and standard deviation of each channel in the blocks so far; None if these are shorter than
            ``FIRST_FIT_SECONDS``.
        """
        blocks = self._blocks_before_scaling
        if sum(len(block.outputs) for block in blocks) * self._dt < FIRST_FIT_SECONDS:
            return None
        channels = np.concatenate([self._channels(block, axis_mixer) for block in blocks])
        deviation = channels.std(axis=0)
        # A channel that is constant at first may vary later, so it keeps its physical unit.
        return ChannelScaling(channels.mean(axis=0), np.where(deviation > 0, deviation, 1.0))

    def _updated_statistics(
        self, block: MemoryBlock, axis_mixer: Array, scaling: ChannelScaling
    ) -> LagStatistics:
        """Updates the sums of the regression with the samples of a block, and reduces the weight of earlier samples.

        The sums are second moments of each sample with the ``MAX_LAGS`` samples before it. With n new samples the old
        sums are multiplied by exp(−n dt / ``MEMORY_SECONDS``) before the new ones are added.

        Args:
            block: Consecutive samples of inputs and outputs of one segment.
            axis_mixer: (r, c) combinations of the inputs.
            scaling: Centre and scale of each channel.

        Returns:
            The new sums.
        """
        channels = scaling.scaled(self._channels(block, axis_mixer))
        # Within a segment, the last samples of the block before are the lags of the first samples of this one.
        if not block.starts_segment and len(self._latest_channels):
            channels = np.vstack([self._latest_channels, channels])
        self._latest_channels = channels[-MAX_LAGS:]
        self._samples_since_fit += len(block.outputs)
        statistics = LagStatistics.from_segments([channels], MAX_LAGS)
        if self._statistics is not None:
            # The factor by which the weight of earlier samples decreases over the time of the new ones.
            remaining_weight = np.exp(-statistics.row_count * self._dt / MEMORY_SECONDS)
            statistics = statistics.plus_discounted(self._statistics, remaining_weight)
        self._statistics = statistics
        return statistics

    def _refit(self, axis_mixer: Array, statistics: LagStatistics, scaling: ChannelScaling) -> None:
        """Fits the model with the last hyperparameters and with one alternative, and keeps the better.

        Args:
            axis_mixer: (r, c) combinations of the inputs.
            statistics: Sums over the samples.
            scaling: Centre and scale of each channel.

        Raises:
            numpy.linalg.LinAlgError: The regression fails for these samples; it may succeed with more.
        """
        # Trying all hyperparameters of the grid at each fit would take too long. Each fit tries one alternative, and
        # successive fits try them all.
        candidates = self._hyperparameters, next(self._alternatives)
        selected_hyperparameters, regression = select_hyperparameters(
            statistics, MAX_LAGS, candidates
        )
        process = VectorAutoregression.from_regression(regression, scaling)
        # The spectral radius is the factor by which the fastest growing motion of the model grows in each step. With
        # the factor 1 + 1/h it grows by (1 + 1/h)ʰ ≈ e over the longest horizon of h steps.
        longest_horizon = self._horizons[-1]
        max_spectral_radius = 1 + 1 / longest_horizon
        if process.spectral_radius > max_spectral_radius:
            # At the beginning of a manoeuvre the fitted motion can grow without limit. Then the last model is kept, and
            # the model is fitted again with the next block, which contains more of the manoeuvre.
            self._samples_since_fit = round(REFIT_SECONDS / self._dt)
            return
        self._hyperparameters = selected_hyperparameters
        self._maps = self._prediction_maps(axis_mixer, process, scaling)

    def _prediction_maps(
        self, axis_mixer: Array, process: VectorAutoregression, scaling: ChannelScaling
    ) -> PredictionMaps:
        """Returns the linear maps by which a fitted process predicts, computed once for all samples until the next fit.

        There are two kinds of prediction. The outputs at each of the H horizons are predicted from the samples up to
        the latest one. The outputs of the latest sample itself are predicted from its inputs and from the samples
        before it. The weights of both are put into one array, (H + 1, m, L + 1, k) with L = ``MAX_LAGS`` and the k
        scaled channels [outputs, inputs @ axis_mixer]. Then they are converted to weights of outputs and inputs in
        physical units.

        Args:
            axis_mixer: (r, c) combinations of the inputs that are channels of the process.
            process: The fitted process, of up to ``MAX_LAGS`` lags.
            scaling: Centre and scale of each of the k channels.

        Returns:
            The maps.
        """
        m = self._outputs
        # The process predicts all channels at every step up to the last horizon. Only the outputs, which are the first
        # m channels, at the horizons are needed; a horizon of h steps has index h − 1.
        all_maps, all_constants = process.prediction_maps(int(self._horizons[-1]))
        horizon_maps = all_maps[self._horizons - 1, :m]
        horizon_constants = all_constants[self._horizons - 1, :m]
        latest_map, latest_constant = process.output_map(m)
        # Weights are in blocks of k channels, the latest sample first. The process may have fewer lags than MAX_LAGS;
        # the weights of the older samples are then zero. The map of the latest sample is one block longer than the
        # others, since its first block contains the weights of the inputs of that sample.
        k = len(scaling.center)
        weights = np.zeros((len(horizon_maps) + 1, m, (MAX_LAGS + 1) * k))
        weights[:-1, :, : horizon_maps.shape[2]] = horizon_maps
        weights[-1, :, : latest_map.shape[1]] = latest_map
        # In the samples of a stream the earliest is first, so the blocks are reversed.
        weights = weights.reshape(-1, m, MAX_LAGS + 1, k)[:, :, ::-1]
        constants = np.vstack([horizon_constants, latest_constant[None]])

        # A scaled channel is (channel − centre) / scale, for the predictions and for the samples.
        weights = scaling.scale[:m, None, None] * weights / scaling.scale
        constants = scaling.center[:m] + scaling.scale[:m] * constants
        constants -= (weights @ scaling.center).sum(axis=2)
        input_weights = weights[..., m:] @ axis_mixer.T
        return PredictionMaps(
            output_map=weights[..., :m].reshape(constants.size, -1),
            input_map=input_weights.reshape(constants.size, -1),
            constants=constants.ravel(),
        )
