"""Quasi-Newton maximisation of the free energy F̄ over parameters θ and log noise precisions λ, where DEM is slow.

If hidden states and θ are strongly coupled, each round covers only a small part of the way. F̄ at the states of the D
step and at optimal covariances is a function of θ and λ alone, whose gradient is the gradient of F̄ with the states and
covariances held, since F̄ is at its maximum over them (the envelope theorem). L-BFGS maximises it, in coordinates in
which the E and M steps are steps of length one: M. Jamshidian and R. Jennrich, "Acceleration of the EM algorithm by
using quasi-Newton methods", J. R. Statist. Soc. B 59, 1997; R. Byrd et al., "A limited memory algorithm for bound
constrained optimization", SIAM J. Sci. Comput. 16, 1995.
"""

import numpy as np
import scipy
from numpy.linalg import LinAlgError

from mavdem.arrays import Array
from mavdem.dem.engine.ascent import CONVERGED_ROUND_NATS, Iterate, iterate_at, run_rounds
from mavdem.dem.engine.linalg import inverse, raise_on_overflow
from mavdem.dem.engine.steps import FreeEnergyOfLambda, theta_gradient, theta_precision

FIRST_ROUNDS = 5
"""Rounds of D, E and M steps before the search, whose coordinates are scaled by the curvatures there. A choice."""

REMEMBERED_STEPS = 30
"""Number of steps from which L-BFGS estimates curvatures; more hardly save evaluations."""

BREAKDOWN_NATS = 1e9
"""Distance below F̄ of the start, nats, that is reported as F̄ where it cannot be evaluated.

It is so far below all real values that the line search turns back from there.
"""


def maximise_by_quasi_newton(start: Iterate, max_evaluations: int) -> Iterate:
    """Maximises F̄ᵒ over θ and λ by L-BFGS, from a given iterate.

    A few rounds of D, E and M steps come first, since the search works with coordinates that are scaled by the
    curvature at their result.

    Args:
        start: the posterior, with its free energy, from which the iteration starts.
        max_evaluations: largest number of evaluations of F̄ᵒ and its gradient.

    Returns:
        The iterate of highest F̄ᵒ.
    """
    # Imported here, since the import takes half a second.
    from scipy.optimize import minimize

    iterates, _ = run_rounds(start, FIRST_ROUNDS)
    search = _Search(iterates[-1])
    minimize(
        search.evaluate,
        np.zeros(len(search.origin)),
        jac=True,
        method="L-BFGS-B",
        options={
            "maxfun": max_evaluations,
            "maxiter": max_evaluations,
            "maxcor": REMEMBERED_STEPS,
            # SciPy compares the gain relative to the value.
            "ftol": CONVERGED_ROUND_NATS / max(abs(search.best.free_energy), 1.0),
            "gtol": 0.0,
        },
    )
    return search.best


class _Search:
    """Objective of a quasi-Newton search: −F̄ᵒ over scaled coordinates of θ and λ; it remembers the best iterate."""

    best: Iterate
    """The iterate of highest F̄ᵒ."""

    origin: Array
    """(k + g,) θ and λ at coordinates zero."""

    _scaling: Array
    """(k + g, k + g) Cholesky factor of the inverse curvatures of F̄ in θ and λ at the origin.

    It maps coordinates to changes of θ and λ. In scaled coordinates the curvature at the origin is 1 in all directions.
    """

    _value_at_breakdown: float
    """−F̄ᵒ, nats, where it cannot be evaluated: larger than any other value, so that the search turns back."""

    def __init__(self, start: Iterate) -> None:
        """Puts the origin at the θ and λ of an iterate, and scales the coordinates by the curvatures there."""
        posterior = start.posterior
        self.best = start
        self.origin = np.concatenate([posterior.theta, posterior.lambda_])
        free_energy_of_lambda = FreeEnergyOfLambda.from_posterior(posterior)
        lambda_precision = free_energy_of_lambda.derivatives(posterior.lambda_).precision
        self._scaling = scipy.linalg.block_diag(
            np.linalg.cholesky(inverse(theta_precision(posterior))),
            np.linalg.cholesky(inverse(lambda_precision)),
        )
        self._value_at_breakdown = BREAKDOWN_NATS - start.free_energy

    def evaluate(self, coordinates: Array) -> tuple[float, Array]:
        """Evaluates −F̄ᵒ and its gradient, and stores the iterate as ``best`` if it is the best so far.

        Args:
            coordinates: (k + g,) deviations of θ and λ from the origin, scaled by the curvature there.

        Returns:
            −F̄ᵒ, nats, and its gradient by the coordinates (k + g,). If the states or the covariances have no finite
            solution, a large value and a zero gradient.
        """
        theta_and_lambda = self.origin + self._scaling @ coordinates
        theta, lambda_ = np.split(theta_and_lambda, [len(self.best.posterior.theta)])
        try:
            with raise_on_overflow():
                iterate = iterate_at(theta, lambda_, self.best.posterior)
                posterior = iterate.posterior
                free_energy_of_lambda = FreeEnergyOfLambda.from_posterior(posterior)
                lambda_gradient = free_energy_of_lambda.derivatives(lambda_).gradient
                gradient = np.concatenate([theta_gradient(posterior), lambda_gradient])
        except LinAlgError:
            return self._value_at_breakdown, np.zeros_like(coordinates)
        if iterate.free_energy > self.best.free_energy:
            self.best = iterate
        # The gradient by the coordinates follows from the gradient by θ and λ by the chain rule.
        return -iterate.free_energy, -self._scaling.T @ gradient
