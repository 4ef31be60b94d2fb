"""The discrete linear model in innovation form, which every method's model is brought to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.dem.model import HELD
from mavdem.dem.recursion import recursion

Array = NDArray[np.float64]


class StateSpace(NamedTuple):
    """x⁺ = A x + B (u − input_trim) + offset + K e,  y = C x + D (u − input_trim) + output_trim + e.

    One step is one sample, e is the error of predicting y from all samples before it. With D = 0 the input of an
    instant moves the outputs from the next sample on.
    """

    A: Array  # (n, n)
    B: Array  # (n, r)
    C: Array  # (m, n)
    D: Array  # (m, r)
    K: Array  # (n, m)
    offset: Array  # (n,)
    input_trim: Array  # (r,)
    output_trim: Array  # (m,)

    @property
    def spectral_radius(self) -> float:
        """The largest magnitude among the eigenvalues of A; 0 of a model without states."""
        return float(np.abs(np.linalg.eigvals(self.A)).max(initial=0.0))

    @property
    def stable(self) -> bool:
        """Whether no mode grows, but for rounding."""
        return self.spectral_radius <= 1 + HELD

    def with_states(self, change: Array) -> StateSpace:
        """The same model of states ``change`` (n, n) times as they are."""
        inverse = np.linalg.inv(change)
        return self._replace(
            A=change @ self.A @ inverse,
            B=change @ self.B,
            C=self.C @ inverse,
            K=change @ self.K,
            offset=change @ self.offset,
        )

    def filtered(self, start: Array, inputs: Array, outputs: Array) -> Array:
        """States (T + 1, n): of each sample predicted from those before it, and of the one after the last.

        Args:
            start: (n,) the first sample's.
            inputs, outputs: (T, r), (T, m).
        """
        direct = self.direct(inputs)
        pushes = self._pushes(inputs) + (outputs - direct) @ self.K.T
        return np.vstack([start, recursion(self.A - self.K @ self.C, pushes, start)])

    def predicted(self, start: Array, inputs: Array, outputs: Array) -> Array:
        """(T, m): each sample predicted from those before it and the inputs.

        Args:
            start, inputs, outputs: as for :meth:`filtered`.
        """
        return self.filtered(start, inputs, outputs)[:-1] @ self.C.T + self.direct(inputs)

    def simulated(self, start: Array, inputs: Array) -> Array:
        """(H, m): outputs without noise, the first of state ``start`` (n,), of inputs (H, r).

        Of an unstable model they may run beyond all numbers, to infinity or NaN.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            states = np.vstack([start, recursion(self.A, self._pushes(inputs)[:-1], start)])[: len(inputs)]
            return np.asarray(states @ self.C.T + self.direct(inputs))

    def simulated_every(self, steps: int, start: Array, inputs: Array, outputs: Array) -> Array:
        """(T, m): outputs without noise, from every ``steps``-th sample on of the state predicted from all before it.

        Args:
            steps: at least 1.
            start: (n,) the first sample's state.
            inputs, outputs: (T, r), (T, m).
        """
        begun = np.arange(0, len(inputs), steps)
        predicted, pushes = self.direct(inputs), self._pushes(inputs)
        with np.errstate(over="ignore", invalid="ignore"):
            states = self.filtered(start, inputs, outputs)[begun]
            for rows in (begun + step for step in range(min(steps, len(inputs)))):
                there = rows[rows < len(inputs)]
                predicted[there] += states[: len(there)] @ self.C.T
                states = states[: len(there)] @ self.A.T + pushes[there]
        return predicted

    def _pushes(self, inputs: Array) -> Array:
        return (inputs - self.input_trim) @ self.B.T + self.offset

    def direct(self, inputs: Array) -> Array:
        """(T, m): what of the outputs does not come of the state, but of ``inputs`` (T, r) and the trim."""
        return np.asarray((inputs - self.input_trim) @ self.D.T + self.output_trim)
