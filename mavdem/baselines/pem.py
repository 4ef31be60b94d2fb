"""PEM: the state-space model whose one-step predictions of the training data err least."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mavdem.baselines.identified import Identified, of_stability
from mavdem.baselines.orders import required_order
from mavdem.baselines.prediction_errors import Parameters, prediction_errors, sensitivities, with_parameters
from mavdem.baselines.regression import stable_radius
from mavdem.baselines.state_space import StateSpace
from mavdem.baselines.subspace import Found, Weighting, found_by_projection
from mavdem.baselines.units import LEAST_VARIANCE, Segments, Units
from mavdem.dem.one_thread import one_thread
from mavdem.dem.record import Record, Recorded

Array = NDArray[np.float64]

REWEIGHTINGS = 30
"""Times at most that the errors are weighted anew, by their own covariance."""

EVALUATIONS = 30
"""Of the errors at most, with one weighting."""

SETTLED = 0.1
"""Nats: what gains less in the likelihood of all data is settled; one more parameter gains half a nat by chance."""


def pem(
    train: Recorded | Sequence[Recorded], order: int = 2, feedthrough: bool = False, stable: bool = False
) -> Identified:
    """The model in innovation form that makes the determinant of the one-step errors' covariance smallest.

    That is maximum likelihood where errors are Gaussian (Ljung, System Identification, 2nd ed., secs. 7.2, 10.2): all
    of A, B, C, K, the offset and the states in which segments begin, in full parametrization, by Levenberg and
    Marquardt's method on errors weighted by their covariance, taken anew until it settles. The determinant never rises:
    tr(R₀⁻¹R) bounds ln det R from above and touches it at R₀. It starts from the subspace model with the smallest
    determinant among all weightings, and stays where the predictor A − K C is stable. Consistent in closed loop, as far
    as the order is right.

    Args:
        train: a ``Flight``, or a list of them, segments with gaps between: nothing is predicted across a gap.
        order: number of states.
        feedthrough: whether inputs act on the outputs of the same sample, D; otherwise it is zero.
        stable: keep A of a model that comes out unstable stable all the way from a stable start.

    Raises:
        ValueError: as :func:`mavdem.baselines.subspace`, of whose models none can be started from.
    """
    order = required_order(order)
    record = Record.of(train)
    units = Units.of(record)
    with one_thread():
        segments = units.segments(record)
        found = _minimised(_best_start(segments, order, feedthrough, stable=False), feedthrough, segments, np.inf)
        stabilised = stable and not found.model.stable
        if stabilised:
            bound = stable_radius(len(record))
            found = _minimised(_best_start(segments, order, feedthrough, stable=True), feedthrough, segments, bound)
        cautions = of_stability(found.model, stabilised)
        if not found.settled:
            cautions += (
                f"The prediction errors were still falling after {REWEIGHTINGS} rounds: the model is not the best of "
                f"its order.",
            )
        return Identified(f"PEM({order})", units.physical(found.model), record, found.starts, stabilised, cautions)


class _Minimised(NamedTuple):
    model: StateSpace
    starts: Array
    settled: bool


def _best_start(segments: Segments, order: int, feedthrough: bool, stable: bool) -> Found:
    """The subspace model, of those there are, that predicts best."""
    found: list[Found] = []
    for weighting in get_args(Weighting):
        try:
            found.append(found_by_projection(segments, order, weighting, feedthrough, stable))
        except ValueError as error:
            refused = error
    if not found:
        raise refused
    return min(
        found, key=lambda one: _determinant(prediction_errors(_parameters(one, feedthrough), one.model, segments))
    )


def _parameters(found: Found, feedthrough: bool) -> Parameters:
    A, B, C, D, K, offset, *_ = found.model
    return Parameters(A, B, C, D if feedthrough else D[:, :0], K, offset, found.starts)


def _determinant(errors: Array) -> float:
    """The logarithm of that of the errors' covariance."""
    return float(np.linalg.slogdet(_covariance(errors))[1])


def _covariance(errors: Array) -> Array:
    return np.asarray(errors.T @ errors / len(errors) + LEAST_VARIANCE * np.eye(errors.shape[1]))


def _minimised(found: Found, feedthrough: bool, segments: Segments, bound: float) -> _Minimised:
    """From there downhill, the spectral radius of A never above ``bound``."""
    best, settled = _parameters(found, feedthrough), False
    errors = prediction_errors(best, found.model, segments)
    for _ in range(REWEIGHTINGS):
        weight = np.linalg.cholesky(np.linalg.inv(_covariance(errors)))
        tried = _downhill(best, found.model, segments, weight, bound)
        before, errors_there = _determinant(errors), prediction_errors(tried, found.model, segments)
        gained = before - _determinant(errors_there)
        if gained > 0:
            best, errors = tried, errors_there
        if gained * len(errors) / 2 < SETTLED:
            settled = True
            break
    return _Minimised(with_parameters(found.model, best), best.starts, settled)


def _downhill(start: Parameters, model: StateSpace, segments: Segments, weight: Array, bound: float) -> Parameters:
    """The parameters with the least sum of squared errors that is found, weighted."""
    nowhere = 1e3 * (prediction_errors(start, model, segments) @ weight).ravel()
    origin, directions = start.vector(), start.telling()

    def there(steps: Array) -> Parameters:
        return start.of(origin + directions @ steps)

    def weighted(steps: Array) -> Array:
        parameters = there(steps)
        if not _allowed(parameters, bound):
            return nowhere
        return (prediction_errors(parameters, model, segments) @ weight).ravel()

    def slopes(steps: Array) -> Array:
        by_output = sensitivities(there(steps), model, segments) @ directions
        return (weight.T @ by_output).reshape(-1, len(steps))

    still = np.zeros(directions.shape[1])
    # With this weight half the sum of squares, about half their number, is in nats.
    settled = 2 * SETTLED / len(nowhere)
    return there(least_squares(weighted, still, slopes, method="lm", ftol=settled, max_nfev=EVALUATIONS).x)


def _allowed(parameters: Parameters, bound: float) -> bool:
    """Whether the predictor is stable, and the model as far as it must be."""
    A, C, K = parameters.A, parameters.C, parameters.K
    finite = np.isfinite(parameters.vector()).all()
    return bool(
        finite
        and np.abs(np.linalg.eigvals(A - K @ C)).max() < 1
        and (bound == np.inf or np.abs(np.linalg.eigvals(A)).max() <= bound)
    )
