"""The result of a method other than DEM, in physical units."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from mavdem.dem.engine.linalg import Array
from mavdem.dem.engine.state_space import StateSpace
from mavdem.dem.record import Record, required_steps
from mavdem.dem.validation import is_whole


@dataclass(frozen=True, eq=False, repr=False)
class Identified:
    """An identified model with its forecasts, in physical units; a :class:`mavdem.Forecaster`.

    Attributes:
        method: by which it was made, such as ``ARX(2)``.
        model: A, B, C, D and K of one sampling step.
        record: the training data.
        starts: (segments, n) the state of each segment's first sample, as the method has it.
        stabilised: whether the model was unstable and, as was asked for, made stable.
        cautions: one sentence for each limitation of the model.
    """

    method: str
    model: StateSpace
    record: Record
    starts: Array
    stabilised: bool = False
    cautions: tuple[str, ...] = ()

    def __repr__(self) -> str:
        (n, r), m = self.model.B.shape, len(self.model.C)
        return (
            f"<Identified: {self.method}, {n} states, {r} inputs, {m} outputs from {len(self.record)} samples at "
            f"{1 / self.record.dt:.6g} Hz, spectral radius {self.spectral_radius:.4g}>"
        )

    @property
    def spectral_radius(self) -> float:
        """The largest magnitude among the eigenvalues of A."""
        return self.model.spectral_radius

    @property
    def stable(self) -> bool:
        """Whether no mode grows, but for rounding: one of spectral radius 1 does not grow."""
        return self.model.stable

    def one_step(self) -> Array:
        """(T, m): each training sample predicted from those before it in its segment, and the inputs."""
        segments = zip(self.starts, self.record.segments, strict=True)
        return np.concatenate([self.model.predicted(start, *segment) for start, segment in segments])

    def predict(self, steps: int) -> Array:
        """(steps, m): the outputs after the training data, of a model on which inputs have no effect.

        Raises:
            ValueError: inputs have an effect; or no positive whole number of steps.
        """
        self._require_no_effect()
        return self.forecast(np.broadcast_to(self.model.input_trim, (required_steps(steps), self.model.B.shape[1])))

    def predict_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> Array:
        """(H, m): as :meth:`forecast_every`, of a model on which ``inputs`` (H, r) have no effect.

        ``outputs`` (H, m) are those after the training data, and a prediction begins at every ``steps``-th.

        Raises:
            ValueError: inputs have an effect; or as :meth:`forecast_every`.
        """
        self._require_no_effect()
        return self.forecast_every(steps, inputs, outputs)

    def _require_no_effect(self) -> None:
        if self.model.B.any() or self.model.D.any():
            raise ValueError(
                f"{self.method} needs the inputs of the time it forecasts: use forecast(inputs), or "
                "mavdem.baselines.var for predictions without them"
            )

    def forecast(self, inputs: ArrayLike, from_zero: bool = False, smooth: bool = False) -> Array:
        """Outputs after the training data: row 0 is the first sample after it, the state predicted from all before.

        Row h of the inputs is of the same instant as row h of the forecast, which without feedthrough depends on the
        rows before it only; row 0 on the last training input.
        The ``inputs`` (H, r) are in the unit of the training inputs, the result is (H, m); that of an unstable model
        may overflow to infinity or NaN. ``from_zero`` begins with state 0 at row 0 (the outputs at their trim), as the
        paper's figures do. The inputs are causes in these models, so that later ones change nothing: ``smooth`` returns
        the same.

        Raises:
            ValueError: inputs of another width, or not finite.
        """
        ahead = self.record.following_inputs(inputs)
        state = np.zeros(len(self.model.A)) if from_zero else self._last_state
        return self.model.simulated(state, ahead)

    def forecast_every(self, steps: int, inputs: ArrayLike, outputs: ArrayLike) -> Array:
        """(H, m): the samples after the training data, by a new forecast from every ``steps``-th of them on.

        Each begins with the state predicted from all samples before it. ``inputs`` (H, r) and ``outputs`` (H, m) are in
        the units of the training data. With ``steps`` of H or more it is what :meth:`forecast` returns.

        Raises:
            ValueError: fewer steps than 1, or inputs and outputs of other shapes, or not finite.
        """
        return self.model.simulated_every(steps, self._last_state, *self.record.following(steps, inputs, outputs))

    def simulate(self, inputs: ArrayLike) -> Array:
        """(H, m): the outputs if ``inputs`` (H, r) were commanded: what :meth:`forecast` returns.

        It is the plant's answer as far as the model is that of the plant: a model learnt in closed loop may not be.

        Raises:
            ValueError: inputs of another width, or not finite.
        """
        return self.forecast(inputs)

    @cached_property
    def _last_state(self) -> Array:
        """(n,) of the sample after the training data."""
        return np.asarray(self.model.filtered(self.starts[-1], *self.record.segments[-1])[-1])


def of_stability(model: StateSpace, stabilised: bool) -> tuple[str, ...]:
    """The caution that a model grows, or that it did."""
    if stabilised:
        return ("The model was unstable and has been made stable, as requested.",)
    if model.stable:
        return ()
    return (
        f"The model is unstable: a mode grows by {model.spectral_radius - 1:.2g} of itself at each sample, and so may "
        f"forecasts.",
    )


def required_order(order: int) -> int:
    """``order`` as an ``int``; ``ValueError`` for what is no positive whole number."""
    if not (is_whole(order) and order >= 1):
        raise ValueError(f"order must be a positive whole number, not {order!r}")
    return int(order)
