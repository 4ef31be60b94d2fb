"""What all models of a record answer alike, once they can forecast from every so many samples on."""

import numpy as np
from numpy.typing import ArrayLike

from mavdem.arrays import Array
from mavdem.dem.forecast.var import Forecast
from mavdem.dem.record import Record
from mavdem.dem.validation import MAX_STEPS, validated_count


class ForecasterBase:
    """Implements the forecasts of a :class:`mavdem.Forecaster` by three methods of its subclasses.

    ``ValueError`` from every method for arguments of another shape or not finite, or fewer steps than 1.
    """

    record: Record

    def rolling_forecast_known_inputs(
        self, steps: int, inputs: Array, outputs: Array, smooth: bool = False
    ) -> Forecast:
        """Returns (H, m) forecasts begun at every ``steps``-th of ``inputs`` (H, r) and ``outputs`` (H, m).

        Of inputs those up to each sample count; or, to ``smooth``, all of a forecast's.
        """
        raise NotImplementedError

    def rolling_forecast_unknown_inputs(
        self, steps: int, inputs: Array, outputs: Array
    ) -> Forecast:
        """Returns (H, m) forecasts likewise, each without the inputs after its beginning."""
        raise NotImplementedError

    def forecast_from_zero_state(self, inputs: Array) -> Array:
        """Returns the outputs (H, m) with ``inputs`` (H, r) from state 0."""
        raise NotImplementedError

    def predict(self, steps: int) -> Array:
        """Returns what comes next (steps, m), inputs unknown; row 0 is the first sample after the training data.

        >>> learned.predict(100).shape
        (100, 2)
        """
        return self.predict_with_variance(steps).mean

    def predict_with_variance(self, steps: int) -> Forecast:
        """Returns :meth:`predict` with its variance."""
        number = validated_count(steps, limit=MAX_STEPS)
        tables = self.record.inputs, self.record.outputs
        return self.rolling_forecast_unknown_inputs(
            number, *(np.zeros((number, each.shape[1])) for each in tables)
        )

    def predict_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> Array:
        """Returns the samples (H, m) after the training data, by a new prediction from every ``steps``-th of them on.

        Each uses the ``inputs`` (H, r) and ``outputs`` (H, m) before it, and none after; nothing is fitted again.
        """
        return self.rolling_forecast_unknown_inputs(
            steps, *self.record.validated_samples(steps, inputs, outputs)
        ).mean

    def forecast(self, inputs: ArrayLike, from_zero: bool = False, smooth: bool = False) -> Array:
        """Returns the outputs (H, m) after the training data: row 0 is the first sample after it.

        >>> errors = learned.forecast(test.inputs) - test.outputs
        >>> bool((errors**2).mean() < test.outputs.var())
        True

        Args:
            inputs: (H, r) motor outputs over the forecast, in the unit of the training inputs.
            from_zero: begins with state 0 at row 0 (the outputs at their trim), as the paper's figures do.
            smooth: lets a model that takes the motors for measurements use all of them for each sample, not only those
                up to it.
        """
        following = self.record.validated_inputs(inputs)
        if from_zero:
            return self.forecast_from_zero_state(following)
        return self.forecast_with_variance(following, smooth).mean

    def forecast_with_variance(self, inputs: Array, smooth: bool = False) -> Forecast:
        """Returns :meth:`forecast` of ``inputs`` (H, r) with its variance."""
        unseen = np.zeros((len(inputs), self.record.outputs.shape[1]))
        return self.rolling_forecast_known_inputs(max(1, len(inputs)), inputs, unseen, smooth)

    def forecast_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> Array:
        """Returns the samples (H, m) after the training data, by a new forecast from every ``steps``-th of them on.

        Each is as :meth:`forecast`'s, from the state that the filter has after all samples before it, in ``inputs``
        (H, r) and ``outputs`` (H, m); nothing is fitted again.
        """
        return self.rolling_forecast_known_inputs(
            steps, *self.record.validated_samples(steps, inputs, outputs)
        ).mean
