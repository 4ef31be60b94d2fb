"""Autoregressions: ARX, in which inputs are causes, and the joint VAR, in which they are measurements of the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from mavdem.baselines.identified import Baseline, Fitted, Identified, Segments, identified, regression, unstable
from mavdem.confidence import LEVEL, half_width, require_probability
from mavdem.dem.engine.linalg import Array, one_thread
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.forecast.var import RIDGE, Forecast, Var, lagged
from mavdem.dem.record import Record, UniformRecord, required_number
from mavdem.dem.validation import is_number


def arx(train: UniformRecord | Sequence[UniformRecord], order: int = 2) -> Identified:
    """y_t = Σₖ Aₖ y_{t−k} + Σₖ Bₖ u_{t−k} + c + e_t over ``order`` lags k = 1, 2, …, by least squares.

    Consistent, also in closed loop, where e is white (Ljung, System Identification, 2nd ed., secs. 7.3 and 13.4); noise
    of the measurements alone biases it. The model is realised in observer form, m · order states. The lags before a
    segment's first samples are taken to be at the trim.

    Args:
        train: a ``Flight``, or a list of them, segments with gaps between: no lag reaches across a gap.
        order: number of lags.

    Raises:
        ValueError: too few samples, values that are not finite, an output that does not vary, or an order that is no
            positive number.
    """
    order = required_number(order, "order")

    def fit(segments: Segments) -> Fitted:
        regressors, targets = _lagged(segments, order)
        (rows, columns), m = regressors.shape, targets.shape[1]
        if rows <= columns:
            raise ValueError(
                f"train has {rows} samples with {order} before them, and ARX({order}) of it has {columns} parameters "
                f"for each output: lower the order, or train on more samples"
            )
        return Fitted(_realised(regression(regressors, targets), order, m), np.zeros((len(segments), m * order)))

    found = identified(f"ARX({order})", train, fit)
    # The states in physical units, in which C = [I 0].
    model, scale = found.model, np.tile(found.model.C.diagonal(), order)[:, None]
    A, B, C, K, offset = scale * model.A / scale.T, scale * model.B, model.C / scale.T, scale * model.K, model.offset
    return replace(found, model=model._replace(A=A, B=B, C=C, K=K, offset=scale[:, 0] * offset))


def _lagged(segments: Segments, order: int) -> tuple[Array, Array]:
    """Regressors [outputs of each lag, inputs of each lag, 1] and targets, of all samples with as many before them."""
    rows = [np.hstack([lagged(y, order), lagged(u, order), np.ones((max(0, len(y) - order), 1))]) for u, y in segments]
    return np.vstack(rows), np.vstack([y[order:] for _, y in segments])


def _realised(coefficients: Array, order: int, m: int) -> StateSpace:
    """In observer form: state block i is what the samples so far contribute i − 1 samples later."""
    lags, n = coefficients.T, m * order
    k = (lags.shape[1] - 1) // order - m
    of_outputs = lags[:, :n].reshape(m, order, m).swapaxes(0, 1).reshape(n, m)
    of_inputs = lags[:, n:-1].reshape(m, order, k).swapaxes(0, 1).reshape(n, k)
    C = np.eye(m, n)
    shift = np.eye(n, k=m)
    return StateSpace(
        A=of_outputs @ C + shift,
        B=of_inputs,
        C=C,
        D=np.zeros((m, k)),
        K=of_outputs,
        offset=np.concatenate([lags[:, -1], np.zeros(n - m)]),
        input_trim=np.zeros(k),
        output_trim=np.zeros(m),
    )


def var(train: UniformRecord | Sequence[UniformRecord], order: int = 10, ridge: float = RIDGE) -> JointAutoregression:
    """Outputs and inputs as one autoregression of ``order`` lags, with a prior towards a random walk.

    Least squares with a ridge, the "Minnesota prior" (Litterman, 1986; see :mod:`mavdem.dem.forecast.var`). Unlike the
    other methods it can predict without the inputs; given them, it infers the outputs from what they show of the
    motion, by a Kalman filter. ``train`` and errors are as for :func:`arx`; ``ridge`` is the precision of the prior at
    lag 1, times i² at lag i, of channels of deviation 1.
    """
    order = required_number(order, "order")
    if not (is_number(ridge) and 0 < ridge < float("inf")):
        raise ValueError(f"ridge must be a positive number, not {ridge!r}")
    record = Record.of(train)
    with one_thread():
        return JointAutoregression(f"joint VAR({order})", Var.learn(record, order, ridge), record)


@dataclass(frozen=True, eq=False, repr=False)
class JointAutoregression(Baseline):
    """A joint autoregression with its forecasts and predictions, in physical units; a :class:`mavdem.Forecaster`.

    Attributes:
        method: its name, such as ``joint VAR(10)``.
        model: its parameters.
        record: the training data.

    Raises:
        ValueError: from every method, for inputs or outputs of another shape or not finite, fewer steps than 1, or a
            level that is no probability between 0 and 1.
    """

    model: Var

    @property
    def cautions(self) -> tuple[str, ...]:
        """One sentence where vehicle and autopilot together grow."""
        return tuple(filter(None, (unstable(self.spectral_radius),)))

    def one_step(self) -> Array:
        """Returns (T, m): each training sample from those before it in its segment, and the inputs up to its own."""
        return self.model.one_step(self.record)

    def predict(self, steps: int) -> Array:
        """Returns (steps, m): the outputs after the training data, inputs unknown."""
        return self._predicted(steps).mean

    def predict_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> Array:
        """Returns (H, m): a new prediction at every ``steps``-th of ``inputs`` (H, r), ``outputs`` (H, m)."""
        return self.model.predict_every(self._past, steps, *self.record.following(steps, inputs, outputs))

    def predict_band(self, steps: int, level: float = LEVEL) -> Array:
        """Returns (steps, m) half widths of bands of probability ``level``, as if the parameters were exact."""
        require_probability(level)
        return half_width(self._predicted(steps).variance, level)

    def forecast(self, inputs: ArrayLike, from_zero: bool = False, smooth: bool = False) -> Array:
        """Returns (H, m): the outputs after the training data given ``inputs`` (H, r); see :class:`mavdem.Forecaster`.

        With ``smooth`` all inputs count. ``from_zero`` begins with all channels at their mean.
        """
        return self._inferred(inputs, from_zero, smooth).mean

    def forecast_variance(self, inputs: ArrayLike) -> Array:
        """Returns (H, m) expected squared error of :meth:`forecast` with ``inputs``, as if parameters were exact."""
        return self._inferred(inputs).variance

    def forecast_band(self, inputs: ArrayLike, level: float = LEVEL) -> Array:
        """Returns (H, m) half widths, by :meth:`forecast_variance` of ``inputs``, of bands of probability ``level``."""
        require_probability(level)
        return half_width(self.forecast_variance(inputs), level)

    def forecast_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> Array:
        """Returns (H, m): a new forecast at every ``steps``-th of ``inputs`` (H, r), ``outputs`` (H, m)."""
        return self.model.infer_every(self._past, steps, *self.record.following(steps, inputs, outputs)).mean

    def simulate(self, inputs: ArrayLike) -> Array:
        """Refuses, with a ``ValueError``: this model has no plant whose ``inputs`` could be commanded."""
        raise ValueError(
            f"{self.method} takes the inputs for the autopilot's answer to the motion, and has no plant to command: "
            "use Learned.simulate"
        )

    @cached_property
    def _past(self) -> Array:
        return self.model.past(self.record)

    def _predicted(self, steps: int) -> Forecast:
        m = self.record.outputs.shape[1]
        return Forecast(*(table[:, :m] for table in self.model.predict(self._past, required_number(steps))))

    def _inferred(self, inputs: ArrayLike, from_zero: bool = False, smooth: bool = False) -> Forecast:
        past = np.tile(self.model.units.center, (self.model.lags, 1)) if from_zero else self._past
        return self.model.infer(past, self.record.following_inputs(inputs), smooth)
