"""Forecaster: the interface that the models of all methods have."""

from typing import Protocol, runtime_checkable

from numpy.typing import ArrayLike

from mavdem.arrays import Array
from mavdem.facts import Fact


@runtime_checkable
class Forecaster(Protocol):
    """A model of a flight: ``mavdem.Learned`` and the results of ``mavdem.baselines``.

    It answers three questions about the time after the training data, and refuses those it has no answer to with a
    ``ValueError`` of one sentence: what comes next, the inputs unknown (:meth:`predict`); what happened to the outputs,
    given the recorded inputs (:meth:`forecast`); what if these inputs were commanded (:meth:`simulate`).

    Rows of inputs and outputs with the same number are of the same instant, as in a ``Flight``. The state at the end of
    training is that of the method's own filter after all samples of the last segment. Row 0 of a forecast is one
    sampling step after it.
    """

    @property
    def cautions(self) -> tuple[Fact | str, ...]:
        """What a user must know before using the model."""

    @property
    def spectral_radius(self) -> float:
        """The largest magnitude among the eigenvalues of the model's step from sample to sample."""

    @property
    def stable(self) -> bool:
        """Whether no mode of the model grows, but for rounding."""

    def one_step(self) -> Array:
        """Returns (T, m) predictions of each training sample from those before it in its segment, and the inputs."""

    def predict(self, steps: int) -> Array:
        """Returns (steps, m) outputs after the training data, inputs unknown; row 0 is the first sample after it."""

    def predict_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> Array:
        """Predicts anew, (H, m), from every ``steps``-th sample on, of ``inputs`` (H, r) and ``outputs`` (H, m)."""

    def forecast(self, inputs: ArrayLike, from_zero: bool = False, smooth: bool = False) -> Array:
        """Returns (H, m) outputs after the training data, given the inputs; row 0 is the first sample after it.

        ``inputs`` (H, r) are of the same instants, in the unit of the training inputs. ``from_zero`` begins with
        state 0, as the paper's figures do. Each sample is given the inputs up to its own instant; with ``smooth``
        all of them, which matters where inputs are measurements.
        """

    def forecast_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> Array:
        """Returns (H, m) samples after the training data, by a new forecast from every ``steps``-th of them on.

        Each begins with the state that the model's filter has of all samples before: with H ``steps`` or more it
        is :meth:`forecast`, with 1 the one-step prediction. ``inputs`` (H, r), ``outputs`` (H, m).
        """

    def simulate(self, inputs: ArrayLike) -> Array:
        """Returns (H, m) outputs after the training data if ``inputs`` (H, r) were commanded, by the plant alone."""


@runtime_checkable
class ProbabilisticForecaster(Forecaster, Protocol):
    """A forecaster that also gives the size of its errors, before the samples are known."""

    def predict_band(self, steps: int, level: float = 0.9) -> Array:
        """Returns (steps, m) half width of the band where a predicted sample lies with probability ``level``."""

    def forecast_variance(self, inputs: ArrayLike) -> Array:
        """Returns (H, m) expected squared error of the forecast of ``inputs`` (H, r).

        It is in the squares of the outputs' units.
        """

    def forecast_band(self, inputs: ArrayLike, level: float = 0.9) -> Array:
        """Returns (H, m) half width of the band in which a sample of the forecast lies with probability ``level``."""
