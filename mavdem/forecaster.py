"""Forecaster: what every method answers, whatever it made its model by."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray


@runtime_checkable
class Forecaster(Protocol):
    """A model of a flight that predicts: ``mavdem.Learned`` and whatever ``mavdem.baselines`` answers.

    Rows of inputs and outputs with the same number are of the same instant, as in a ``Flight``. The state at the end of
    training is the method's own filter's, which has seen every training sample of the last segment, and row 0 of a
    forecast is one sampling step after it.
    """

    @property
    def cautions(self) -> tuple[str, ...]:
        """One sentence for each thing a user must know before trusting the model."""

    @property
    def spectral_radius(self) -> float:
        """The largest magnitude among the eigenvalues of the model's step from sample to sample."""

    @property
    def stable(self) -> bool:
        """Whether no mode of the model grows, but for rounding."""

    def one_step(self) -> NDArray[np.float64]:
        """(T, m): each training sample predicted from those before it in its segment, and the inputs."""

    def forecast(self, inputs: ArrayLike, from_zero: bool = False) -> NDArray[np.float64]:
        """(H, m): outputs after the training data; row 0 is the first sample after it.

        Args:
            inputs: (H, r), of the same instants, in the unit of the training inputs.
            from_zero: begin with state 0 at row 0, as the paper's figures do, and not with the state at the end of
                training.
        """

    def forecast_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> NDArray[np.float64]:
        """(H, m): the samples after the training data, by a new forecast from every ``steps``-th of them on.

        Each is of the same model, which learns nothing more, and begins with the state that its filter has of all
        samples before; so with ``steps`` of H or more it is :meth:`forecast`, and with 1 the one-step prediction.

        Args:
            steps: samples that each forecast is of, at least 1.
            inputs, outputs: (H, r) and (H, m) of the samples, in the units of the training data.
        """


@runtime_checkable
class ProbabilisticForecaster(Forecaster, Protocol):
    """A forecaster that says how far its forecast may be off, which it knows before the samples are there."""

    def forecast_variance(self, inputs: ArrayLike) -> NDArray[np.float64]:
        """(H, m) squared error that the forecast expects of itself at each sample, in the squares of outputs' units.

        Args:
            inputs: (H, r) as for :meth:`forecast`.
        """

    def forecast_band(self, inputs: ArrayLike, level: float = 0.9) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper bounds, (H, m) each, between which a sample of the forecast lies with some probability.

        Args:
            inputs: (H, r) as for :meth:`forecast`.
            level: the probability, between 0 and 1.
        """
