"""How near an efficient estimate of a system comes to it: the Cramér-Rao bound of what no choice of states changes."""

import numpy as np
from numpy.typing import NDArray

from mavdem import Flight
from mavdem.baselines import StateSpace
from mavdem.baselines.prediction_error_method import FreeParameters, sensitivities

Array = NDArray[np.float64]


def pulse_answers(model: StateSpace) -> Array:
    """C Aᵏ B and C Aᵏ K of as many lags as determine a system of its order."""
    powers = [np.linalg.matrix_power(model.A, k) for k in range(2 * len(model.A))]
    return np.concatenate([(model.C @ power @ np.hstack([model.B, model.K])).ravel() for power in powers])


class Bound:
    """Of estimates of ``system`` from ``flight``, whose innovations have the standard deviation ``noise``."""

    def __init__(self, system: StateSpace, flight: Flight, noise: float) -> None:
        n, m = len(system.A), len(system.C)
        parameters = FreeParameters(system.A, system.B, system.C, system.K, system.offset, np.zeros((1, n)))
        slopes = sensitivities(parameters, system, [(flight.inputs, flight.outputs)])
        slopes = slopes.reshape(-1, slopes.shape[2]) / noise
        vector = parameters.vector()

        def answers(vector: Array) -> Array:
            A, B, C, K, *_ = parameters.of(vector)
            return pulse_answers(system._replace(A=A, B=B, C=C, K=K))

        steps = 1e-6 * np.eye(len(vector))
        of_answers = np.stack([(answers(vector + step) - answers(vector - step)) / 2e-6 for step in steps], axis=1)
        # The choice of states tells nothing, nor does where those that C does not see are zero.
        told = len(vector) - n * n - max(n - m, 0)
        basis, sizes, _ = np.linalg.svd(slopes.T, full_matrices=False)
        half = of_answers @ (basis[:, :told] / sizes[:told])
        self.truth = answers(vector)
        self.freedom = n * (system.B.shape[1] + 2 * m)
        axes, deviations, _ = np.linalg.svd(half, full_matrices=False)
        self.axes, self.deviations = axes[:, : self.freedom], deviations[: self.freedom]

    def distance(self, model: StateSpace) -> float:
        """Mean square of the errors along the bound's axes, in its units: of an efficient estimate χ² / freedom."""
        errors = self.axes.T @ (pulse_answers(model) - self.truth) / self.deviations
        return float(np.mean(errors**2))
