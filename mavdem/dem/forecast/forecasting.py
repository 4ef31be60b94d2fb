"""What all models of a record answer alike, once they can forecast from every so many samples on."""

import numpy as np
from numpy.typing import ArrayLike

from mavdem.dem.engine.linalg import Array
from mavdem.dem.forecast.var import Forecast
from mavdem.dem.record import MOST_STEPS, Record, required_number


class Forecaster:
    """A model of a flight: ``mavdem.Learned`` and the results of ``mavdem.baselines``.

    It answers three questions about the time after the training data, and refuses those it has no answer to with a
    ``ValueError`` of one sentence: what comes next, the inputs unknown (:meth:`predict`); what happened to the outputs,
    given the recorded inputs (:meth:`forecast`); what if these inputs were commanded (``simulate``). ``ValueError``
    too for arguments of another shape or not finite, or fewer steps than 1.

    Rows of inputs and outputs with the same number are of the same instant, as in a ``Flight``. The state at the end of
    training is that of the method's own filter after all samples of the last segment. Row 0 of a forecast is one
    sampling step after it.

    Beside ``record``, the training data, every model has ``cautions``: what a user must know before using it;
    ``spectral_radius``: the largest magnitude among the eigenvalues of its step from sample to sample; ``stable``:
    whether no mode grows, but for rounding; and ``one_step()``: (T, m), each training sample predicted from the inputs
    and those before it in its segment.
    """

    record: Record

    def known_every(
        self, steps: int, inputs: Array, outputs: Array, smooth: bool = False
    ) -> Forecast:
        """Returns (H, m) forecasts begun at every ``steps``-th of ``inputs`` (H, r) and ``outputs`` (H, m).

        Of inputs those up to each sample count; or, to ``smooth``, all of a forecast's.
        """
        raise NotImplementedError

    def unknown_every(self, steps: int, inputs: Array, outputs: Array) -> Forecast:
        """Returns (H, m) forecasts of these ``steps, inputs, outputs``, each without the inputs after its beginning."""
        raise NotImplementedError

    def from_zero(self, inputs: Array) -> Array:
        """Returns the outputs (H, m) with ``inputs`` (H, r) from state 0."""
        raise NotImplementedError

    def predict(self, steps: int) -> Array:
        """Returns what comes next (steps, m), inputs unknown; row 0 is the first sample after the training data.

        >>> learned.predict(100).shape
        (100, 2)
        """
        return self.predicted(steps).mean

    def predicted(self, steps: int) -> Forecast:
        """Returns :meth:`predict` of so many ``steps`` with its variance."""
        number = required_number(steps, most=MOST_STEPS)
        tables = self.record.inputs, self.record.outputs
        return self.unknown_every(number, *(np.zeros((number, each.shape[1])) for each in tables))

    def predict_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> Array:
        """Returns the samples (H, m) after the training data, by a new prediction from every ``steps``-th of them on.

        Each uses the ``inputs`` (H, r) and ``outputs`` (H, m) before it, and none after; nothing is fitted again.
        """
        return self.unknown_every(steps, *self.record.following(steps, inputs, outputs)).mean

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
        following = self.record.following_inputs(inputs)
        return self.from_zero(following) if from_zero else self.forecasted(following, smooth).mean

    def forecasted(self, inputs: Array, smooth: bool = False) -> Forecast:
        """Returns :meth:`forecast` of ``inputs`` (H, r), to ``smooth`` or not, with its variance."""
        unseen = np.zeros((len(inputs), self.record.outputs.shape[1]))
        return self.known_every(max(1, len(inputs)), inputs, unseen, smooth)

    def forecast_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> Array:
        """Returns the samples (H, m) after the training data, by a new forecast from every ``steps``-th of them on.

        Each is as :meth:`forecast`'s, from the state that the filter has after all samples before it, in ``inputs``
        (H, r) and ``outputs`` (H, m); nothing is fitted again.
        """
        return self.known_every(steps, *self.record.following(steps, inputs, outputs)).mean
