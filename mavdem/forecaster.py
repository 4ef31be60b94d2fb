"""Interface of all models that forecast a flight: by Dynamic Expectation Maximization (DEM), and by other methods.

Symbols of the shapes: T training samples, H forecast samples, r inputs (motor outputs), m outputs (angle and rate).
"""

from typing import Protocol, runtime_checkable

from numpy.typing import ArrayLike

from mavdem.arrays import Array
from mavdem.facts import Fact


@runtime_checkable
class Forecaster(Protocol):
    """A model learned from a flight: ``mavdem.Learned``, and the results of ``mavdem.baselines``.

    It has three questions about the time after the training data, and refuses those that its method cannot answer
    with a ``ValueError`` of one sentence:

    - :meth:`predict`: what comes next, while the inputs are unknown?
    - :meth:`forecast`: what happened to the outputs, given the recorded inputs?
    - :meth:`simulate`: what would happen if these inputs were commanded?

    Rows of inputs and outputs with the same number belong to the same instant, as in a ``Flight``. The state at the end
    of training is the state of the method's own filter after all samples of the last segment. Row 0 of a forecast is
    one sampling step after it.
    """

    @property
    def cautions(self) -> tuple[Fact | str, ...]:
        """Limits of the model that a user must know before using it."""

    @property
    def spectral_radius(self) -> float:
        """Largest magnitude among the eigenvalues of the model's transition from one sample to the next."""

    @property
    def stable(self) -> bool:
        """Whether no mode of the model grows, apart from rounding."""

    def one_step(self) -> Array:
        """Predicts each training sample from the samples before it in its segment, and from the inputs.

        Returns:
            Predicted outputs, (T, m), in the units of the outputs.
        """

    def predict(self, steps: int) -> Array:
        """Predicts the outputs after the training data while the inputs are unknown.

        Args:
            steps: Number of samples to predict.

        Returns:
            Predicted outputs, (steps, m); row 0 is the first sample after the training data.
        """

    def predict_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> Array:
        """Predicts samples after the training data, with a new prediction at every ``steps``-th of them.

        Each prediction uses all samples before its beginning, and neither inputs nor outputs after it.

        Args:
            steps: Number of samples from the beginning of one prediction to the beginning of the next.
            inputs: Inputs after the training data, (H, r).
            outputs: Outputs of the same samples, (H, m).

        Returns:
            Predicted outputs, (H, m).
        """

    def forecast(self, inputs: ArrayLike, from_zero: bool = False, smooth: bool = False) -> Array:
        """Forecasts the outputs after the training data, given the inputs.

        Args:
            inputs: Inputs after the training data, (H, r), in the unit of the training inputs.
            from_zero: Whether to begin with state 0, instead of the state at the end of training. The figures of the
                paper on DEM (Dynamic Expectation Maximization) do.
            smooth: Whether each sample is estimated from all inputs, also from later ones. This makes a difference for
                methods that treat inputs as measurements.

        Returns:
            Forecast outputs, (H, m); row 0 is the first sample after the training data.
        """

    def forecast_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> Array:
        """Forecasts samples after the training data, with a new forecast at every ``steps``-th of them.

        Each forecast begins with the state that the model's filter has after all samples before. With ``steps`` of H or
        more it is :meth:`forecast`; with 1 it is the one-step prediction.

        Args:
            steps: Number of samples from the beginning of one forecast to the beginning of the next.
            inputs: Inputs after the training data, (H, r).
            outputs: Outputs of the same samples, (H, m).

        Returns:
            Forecast outputs, (H, m).
        """

    def simulate(self, inputs: ArrayLike) -> Array:
        """Simulates the plant alone after the training data, as if ``inputs`` were commanded.

        Args:
            inputs: Commanded inputs, (H, r), in the unit of the training inputs.

        Returns:
            Simulated outputs, (H, m).
        """


@runtime_checkable
class ProbabilisticForecaster(Forecaster, Protocol):
    """A forecaster that also states how large its errors will be, before the samples are known."""

    def predict_band(self, steps: int, level: float = 0.9) -> Array:
        """Returns half widths of the band about :meth:`predict`.

        Args:
            steps: Number of predicted samples.
            level: Probability that a sample lies in the band.

        Returns:
            Half widths, (steps, m), in the units of the outputs.
        """

    def forecast_variance(self, inputs: ArrayLike) -> Array:
        """Returns the expected squared errors of :meth:`forecast`.

        Args:
            inputs: Inputs after the training data, (H, r).

        Returns:
            Expected squared errors, (H, m), in the squares of the outputs' units.
        """

    def forecast_band(self, inputs: ArrayLike, level: float = 0.9) -> Array:
        """Returns half widths of the band about :meth:`forecast`.

        Args:
            inputs: Inputs after the training data, (H, r).
            level: Probability that a sample lies in the band.

        Returns:
            Half widths, (H, m), in the units of the outputs.
        """
