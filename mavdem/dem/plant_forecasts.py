"""Forecasts by the plant alone: the model A, B, C with the recorded motors as causes, as in the paper."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import half_width
from mavdem.dem.engine.linalg import may_overflow
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.forecast.var import Forecast
from mavdem.dem.record import Record
from mavdem.dem.scaling import Scaling

FORECAST_HORIZON_SECONDS = 1.5
"""Length of a test forecast, s: a few periods of the roll motion, as in the paper at 100 Hz."""

TEST_FORECASTS = 200
"""About how many forecasts of the training data the errors are estimated from, spread evenly over the flight."""

FILTER_SETTLING_FRACTION = 4
"""The filter runs for a horizon divided by this number before a test forecast, so that its hidden states converge."""


@dataclass(frozen=True, eq=False)
class PlantForecasts:
    """Forecasts of outputs after the training data by the plant A, B, C with its Kalman filter.

    It has the methods of ``JointModel``, which forecasts by outputs and motors together. Arguments and results of its
    methods are in physical units.

    Attributes:
        record: The training data.
        scaling: Conversion between physical units and the units of ``process``.
        process: The plant with its Kalman filter, in the engine's units.
    """

    record: Record
    scaling: Scaling
    process: StateSpace

    def one_step_predictions(self, record: Record) -> Array:
        """Predicts each sample of a record from those before it in its segment, and from the inputs.

        Args:
            record: Samples, (T, r) and (T, m), in any number of segments.

        Returns:
            Predicted outputs, (T, m). The prediction of the first sample of a segment is the trim.
        """
        predictions = []
        for inputs, outputs in self.scaling.scale_segments(record):
            scaled_predictions = self.process.one_step_predictions(inputs, outputs)
            predictions.append(self.scaling.output_trim[None])
            predictions.append(self.scaling.physical_outputs(scaled_predictions))
        return np.concatenate(predictions)

    def half_widths(self, variance: Array, level: float, steps: int) -> Array:
        """Returns half widths of the band of forecasts, for normally distributed errors.

        Args:
            variance: Expected squared errors of the forecasts, (H, m).
            level: Probability that a sample lies in the band.
            steps: Not used. ``JointModel.half_widths`` needs the length of the forecasts and has the same arguments.

        Returns:
            Half widths, (H, m), in the units of the outputs.
        """
        return half_width(variance, level)

    def forecast_from_zero_state(self, inputs: Array) -> Array:
        """Simulates the plant from state 0, with the outputs at their trim, as for the paper's figures.

        Args:
            inputs: Inputs after the training data, (H, r), in physical units.

        Returns:
            Outputs, (H, m), in physical units; the first row is the trim.
        """
        scaled_inputs = self.scaling.scale_inputs(inputs)
        output_count = len(self.scaling.output_trim)
        # In the engine's units the trim is 0, and so is state 0.
        outputs_at_trim = np.zeros((1, output_count))
        if len(scaled_inputs) > 1:
            second_state = self.process.second_state(scaled_inputs[0], outputs_at_trim[0])
            later_outputs = self.process.simulate(second_state, scaled_inputs[1:])
            scaled_outputs = np.vstack([outputs_at_trim, later_outputs])
        else:
            # One row or, without inputs, none.
            scaled_outputs = outputs_at_trim[: len(inputs)]
        return self.scaling.physical_outputs(scaled_outputs)

    def rolling_forecast_known_inputs(
        self, steps: int, inputs: Array, outputs: Array, smooth: bool = False
    ) -> Forecast:
        """Forecasts the H samples that follow the training data, with a new forecast at every ``steps``-th of them.

        For example, with ``steps`` = 3 the samples 0, 1 and 2 are forecast from the training data, then the samples 3,
        4 and 5 from all data up to sample 2, and so on.

        Args:
            steps: Number of samples from the beginning of one forecast to the next.
            inputs: Inputs after the training data, (H, r).
            outputs: Measured outputs of the same samples, (H, m); each forecast uses those before its beginning.
            smooth: Not used; ``JointModel`` has the same arguments. The plant treats the inputs as causes of the
                motion, and later causes have no effect on it.

        Returns:
            Forecast outputs and their expected squared errors, (H, m) each.
        """
        # The filter over the last segment of the training data gives the state at the first sample to forecast.
        last_inputs, last_outputs = self.record.segments[-1]
        first_state = self.process.state_after(
            self.scaling.scale_inputs(last_inputs), self.scaling.scale_outputs(last_outputs)
        )
        scaled_inputs = self.scaling.scale_inputs(inputs)
        scaled_outputs = self.scaling.scale_outputs(outputs)
        forecast_length = max(1, steps)
        scaled_forecast = self.process.rolling_forecast(
            forecast_length, first_state, scaled_inputs, scaled_outputs
        )
        # Row i of the mean squared errors is for i + 1 steps ahead. The first sample of each forecast is one step
        # ahead. For samples further ahead than the last row, the last row is used.
        rows = np.arange(len(scaled_inputs)) % forecast_length
        last_row = len(self.mean_squared_errors) - 1
        expected_squares = self.mean_squared_errors[np.minimum(rows, last_row)]
        return Forecast(self.scaling.physical_outputs(scaled_forecast), expected_squares)

    @cached_property
    @may_overflow
    def mean_squared_errors(self) -> Array:
        """Mean squared errors of forecasts of the training data, by the number of steps ahead.

        Forecasts with known inputs start at many samples of the training data, each from the state that the Kalman
        filter predicts there. Their errors contain noise, wind and the errors of the model, so that no assumption about
        these is needed.

        Shape (L, m), in the squares of the outputs' units; row i is i + 1 steps ahead. Infinite for steps at which a
        forecast overflows.
        """
        usual_horizon = round(FORECAST_HORIZON_SECONDS / self.record.dt)
        # In a short record a forecast covers two thirds of the longest segment. The filter needs the samples before it.
        horizon = max(1, min(usual_horizon, 2 * self.record.longest_segment // 3))
        stride = max(1, len(self.record) // TEST_FORECASTS)
        squared_errors = []
        for inputs, outputs in self.scaling.scale_segments(self.record):
            # Index of the first sample of each forecast. The filter has converged on the samples before the first one.
            settling_samples = horizon // FILTER_SETTLING_FRACTION
            first_samples = np.arange(settling_samples + 1, len(outputs) - horizon + 1, stride)
            # The filter cannot predict sample 0, which no sample precedes. So it starts with the state of sample 1, and
            # row i of its predictions is the state of sample i + 1.
            second_state = self.process.second_state(inputs[0], outputs[0])
            states = self.process.predicted_states(second_state, inputs[1:], outputs[1:])
            first_states = states[first_samples - 1]
            forecasts = self.process.simulate_from(first_samples, horizon, first_states, inputs)
            # (forecasts, horizon): index of the sample at each step of each forecast.
            forecast_samples = first_samples[:, None] + np.arange(horizon)
            squared_errors.append((outputs[forecast_samples] - forecasts) ** 2)
        mean_squares = np.concatenate(squared_errors).mean(axis=0) * self.scaling.output_scale**2
        return np.where(np.isfinite(mean_squares), mean_squares, np.inf)
