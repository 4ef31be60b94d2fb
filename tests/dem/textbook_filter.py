"""The Kalman filter as textbooks write it: predict from the last corrected state, then correct by the gain."""

from typing import NamedTuple

import numpy as np

from mavdem.dem.engine.model import Transition, discretize
from mavdem.dem.engine.state_space import StateSpace


class TextbookFilter(NamedTuple):
    """Of a model with first-order hold; ``gain`` (n, m) corrects the state of the sample itself."""

    transition: Transition
    C: np.ndarray
    gain: np.ndarray

    @classmethod
    def of(cls, A, B, C, dt, gain):
        return cls(discretize(A, B, dt), C, gain)

    @property
    def predictor(self):
        return StateSpace.from_transition(self.transition, self.C, self.gain)

    def corrected(self, inputs, outputs):
        """(T, n): corrected states, the first from its outputs alone; and (T − 1, m) predictions."""
        states = [np.linalg.pinv(self.C) @ outputs[0]]
        ahead = []
        for t in range(1, len(outputs)):
            predicted = self._moved(states[-1], inputs[t - 1], inputs[t])
            ahead.append(self.C @ predicted)
            states.append(predicted + self.gain @ (outputs[t] - ahead[-1]))
        return np.array(states), np.array(ahead)

    def forecast(self, state, inputs):
        """Returns (H, m) outputs after a corrected state, whose own inputs are row 0 of inputs (H + 1, r)."""
        ahead = []
        for t in range(1, len(inputs)):
            state = self._moved(state, inputs[t - 1], inputs[t])
            ahead.append(self.C @ state)
        return np.array(ahead)

    def _moved(self, state, now, later):
        phi, gamma0, gamma1 = self.transition
        return phi @ state + gamma0 @ now + gamma1 @ later
