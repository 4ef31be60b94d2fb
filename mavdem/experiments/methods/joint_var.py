"""The joint VAR: outputs and inputs as one vector autoregression, which can predict without knowing the inputs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from mavdem.arrays import Array
from mavdem.dem.engine.linalg import one_thread
from mavdem.dem.forecast.var import Forecast, VectorAutoregression
from mavdem.dem.record import Record, TrainingData
from mavdem.dem.validation import validated_count
from mavdem.experiments.methods.identified import Baseline
from mavdem.facts.forecasts import MethodName


def var(train: TrainingData, order: int = 10) -> JointAutoregression:
    """Models outputs and inputs as one autoregression of ``order`` lags, with a prior towards a random walk.

    It is least squares with a ridge, the "Minnesota prior" (Litterman, 1986; see :mod:`mavdem.dem.forecast.var`).
    Unlike the other methods it can predict without the inputs. If inputs are given, a Kalman filter treats them as
    measurements of the motion, and infers the outputs from them.

    Args:
        train: a flight, or segments of one that are sampled at the same rate.
        order: number of lags.

    Returns:
        The fitted autoregression.

    Raises:
        ValueError: the training data or the order are not valid.
    """
    order = validated_count(order, "order")
    record = Record.from_flights(train)
    with one_thread():
        model = VectorAutoregression.learn(record, order)
    return JointAutoregression(f"{MethodName.JOINT_VAR}({order})", model, record)


@dataclass(frozen=True, eq=False, repr=False)
class JointAutoregression(Baseline):
    """A joint autoregression with its forecasts and predictions, in physical units; a :class:`mavdem.Forecaster`.

    Attributes:
        method: its name, such as ``joint VAR(10)``.
        model: its parameters.
        record: the training data.
        iterations: always ``None``: least squares has a closed solution.

    Raises:
        ValueError: from every method, for inputs or outputs of another shape or not finite, or fewer steps than 1.
    """

    model: VectorAutoregression

    def one_step(self) -> Array:
        """Predicts the outputs of each training sample from the samples before it in its segment, and from the inputs.

        Returns:
            (T, m) predictions in the outputs' units, of all segments one after the other. The inputs of the predicted
            sample itself are among those that are used.
        """
        return self.model.one_step_predictions(self.record)

    def rolling_forecast_unknown_inputs(
        self, steps: int, inputs: Array, outputs: Array
    ) -> Forecast:
        """Forecasts the outputs without the inputs of that time, with a new forecast at every ``steps``-th sample.

        Args:
            steps: number of samples of each forecast.
            inputs: (H, r) inputs after the training data; a forecast uses those before it.
            outputs: (H, m) outputs of the same samples; a forecast uses those before it.

        Returns:
            Means and variances of the outputs (H, m).
        """
        return self.model.rolling_forecast_unknown_inputs(
            self._last_samples, steps, inputs, outputs
        )

    def rolling_forecast_known_inputs(
        self, steps: int, inputs: Array, outputs: Array, smooth: bool = False
    ) -> Forecast:
        """Forecasts the outputs after the training data, with a new forecast at every ``steps``-th sample.

        Args:
            steps: number of samples of each forecast.
            inputs: (H, r) inputs after the training data.
            outputs: (H, m) outputs of the same samples; a forecast uses those before it.
            smooth: whether each sample is inferred from all inputs of its forecast, and not only from those up to its
                own.

        Returns:
            Means and variances of the outputs (H, m).
        """
        return self.model.rolling_forecast_known_inputs(
            self._last_samples, steps, inputs, outputs, smooth
        )

    def forecast_from_zero_state(self, inputs: Array) -> Array:
        """Returns the outputs (H, m) with ``inputs`` (H, r), after all channels were at their mean."""
        mean_samples = np.tile(self.model.scaling.center, (self.model.lags, 1))
        return self.model.forecast_known_inputs(mean_samples, inputs).mean

    def simulate(self, inputs: ArrayLike) -> Array:
        """Raises ``ValueError``: this model has no plant whose ``inputs`` could be commanded."""
        raise ValueError(
            f"{self.method} takes the inputs for the autopilot's answer to the motion, and has no plant to command: "
            "use Learned.simulate"
        )

    @cached_property
    def _last_samples(self) -> Array:
        """The last samples (lags, m + r) of the training data, outputs first."""
        return self.model.last_samples(self.record)
