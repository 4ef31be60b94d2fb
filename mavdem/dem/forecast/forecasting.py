"""The forecasts that all models of a record have in common, derived from rolling forecasts of each model."""

import numpy as np
from numpy.typing import ArrayLike

from mavdem.arrays import Array
from mavdem.dem.forecast.var import Forecast
from mavdem.dem.record import Record
from mavdem.dem.validation import MAX_STEPS, validated_count


class ForecasterBase:
    """Base class of models with the methods of :class:`mavdem.Forecaster`; a subclass implements three forecasts.

    Rolling forecasts start again at every ``steps``-th sample after the training data, each from all samples before it.
    A single forecast is one whose ``steps`` are as many as its samples. Outputs and inputs are in physical units.

    Raises:
        ValueError: from every method, for arguments of another shape or not finite, or fewer steps than 1.
    """

    record: Record
    """The training data."""

    def rolling_forecast_known_inputs(
        self, steps: int, inputs: Array, outputs: Array, smooth: bool = False
    ) -> Forecast:
        """Forecasts the samples after the training data with known inputs, starting again at every ``steps``-th one.

        Args:
            steps: number of samples from the start of one forecast to the next.
            inputs: (H, r) inputs after the training data.
            outputs: (H, m) outputs after the training data; each forecast uses those before its start only.
            smooth: whether each sample of a forecast is estimated from all of its inputs, not only from those up to the
                sample. It only matters for models that use the inputs as measurements.

        Returns:
            The outputs (H, m) with their variance.
        """
        raise NotImplementedError

    def rolling_forecast_unknown_inputs(
        self, steps: int, inputs: Array, outputs: Array
    ) -> Forecast:
        """Forecasts the samples after the training data with unknown inputs, starting again at every ``steps``-th one.

        Args:
            steps: number of samples from the start of one forecast to the next.
            inputs: (H, r) inputs after the training data; each forecast uses those before its start only.
            outputs: (H, m) outputs after the training data; each forecast uses those before its start only.

        Returns:
            The outputs (H, m) with their variance.
        """
        raise NotImplementedError

    def forecast_from_zero_state(self, inputs: Array) -> Array:
        """Forecasts the outputs with known inputs, from state 0: the outputs at their trim.

        Args:
            inputs: inputs of the forecast (H, r).

        Returns:
            Outputs (H, m).
        """
        raise NotImplementedError

    def predict(self, steps: int) -> Array:
        """Predicts the outputs after the training data, with the inputs unknown.

        >>> learned.predict(100).shape
        (100, 2)

        Args:
            steps: number of samples to predict.

        Returns:
            (steps, m) means of the outputs in physical units. Row 0 is the first sample after the training data.
        """
        return self.predict_with_variance(steps).mean

    def predict_with_variance(self, steps: int) -> Forecast:
        """Predicts the next ``steps`` samples, as :meth:`predict` does, and returns also their variance.

        Args:
            steps: number of samples to predict.

        Returns:
            The outputs (steps, m) with their variance.
        """
        horizon = validated_count(steps, limit=MAX_STEPS)
        # A single forecast uses no samples after its start, so that their values do not matter.
        unused_inputs = np.zeros((horizon, self.record.inputs.shape[1]))
        unused_outputs = np.zeros((horizon, self.record.outputs.shape[1]))
        return self.rolling_forecast_unknown_inputs(horizon, unused_inputs, unused_outputs)

    def predict_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> Array:
        """Predicts the samples after the training data, inputs unknown, starting again at every ``steps``-th sample.

        The parameters of the model are not changed.

        Args:
            steps: number of samples from the start of one prediction to the next.
            inputs: (H, r) inputs after the training data; each prediction uses those before its start only.
            outputs: (H, m) outputs after the training data; each prediction uses those before its start only.

        Returns:
            The outputs (H, m).
        """
        checked_inputs, checked_outputs = self.record.validated_samples(steps, inputs, outputs)
        return self.rolling_forecast_unknown_inputs(steps, checked_inputs, checked_outputs).mean

    def forecast(self, inputs: ArrayLike, from_zero: bool = False, smooth: bool = False) -> Array:
        """Forecasts the outputs after the training data with known inputs; row 0 is the first sample after it.

        >>> errors = learned.forecast(test.inputs) - test.outputs
        >>> bool((errors**2).mean() < test.outputs.var())
        True

        Args:
            inputs: (H, r) motor outputs over the forecast, in the unit of the training inputs.
            from_zero: whether to begin with state 0 at row 0 (the outputs at their trim), as in the paper's figures.
            smooth: whether each sample is estimated from all inputs, not only from those up to it, in models that use
                the inputs as measurements.

        Returns:
            The outputs (H, m), rad and rad/s.
        """
        checked_inputs = self.record.validated_inputs(inputs)
        if from_zero:
            return self.forecast_from_zero_state(checked_inputs)
        return self.forecast_with_variance(checked_inputs, smooth).mean

    def forecast_with_variance(self, inputs: Array, smooth: bool = False) -> Forecast:
        """Forecasts the outputs after the training data, as :meth:`forecast` does, and returns also their variance.

        Args:
            inputs: (H, r) validated inputs over the forecast.
            smooth: whether each sample is estimated from all inputs, not only from those up to it, in models that use
                the inputs as measurements.

        Returns:
            The outputs (H, m) with their variance.
        """
        # A single forecast uses no outputs after its start, so that their values do not matter.
        unused_outputs = np.zeros((len(inputs), self.record.outputs.shape[1]))
        horizon = max(1, len(inputs))
        return self.rolling_forecast_known_inputs(horizon, inputs, unused_outputs, smooth)

    def forecast_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> Array:
        """Forecasts the samples after the training data, inputs known, starting again at every ``steps``-th sample.

        Each forecast is one of :meth:`forecast`, from the state that the filter has after all samples before its start.
        The parameters of the model are not changed.

        Args:
            steps: number of samples from the start of one forecast to the next.
            inputs: (H, r) inputs after the training data.
            outputs: (H, m) outputs after the training data; each forecast uses those before its start only.

        Returns:
            The outputs (H, m).
        """
        checked_inputs, checked_outputs = self.record.validated_samples(steps, inputs, outputs)
        return self.rolling_forecast_known_inputs(steps, checked_inputs, checked_outputs).mean
