"""Where the climb of a black-box model begins: states that could be read off the data, and the θ that goes with them.

F̄ of a model whose states nobody has seen has many maxima, most of them far below the highest. A start is given as a
map from the data to the states and their rates; the model is then a regression, and its coordinates are those in which
states are of variance 1 and their noises independent, as the priors have them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_lyapunov

from mavdem.dem.ascent import Place
from mavdem.dem.black_box import BlackBox
from mavdem.dem.generative import GenerativeModel
from mavdem.dem.model import pack, unpack

Array = NDArray[np.float64]

NEGLIGIBLE = 1e-9
"""Of a variance: what keeps a combination of channels that is nothing from being divided by."""

TAKEN_FROM_NOISE = 2
"""Directions of the noise, the largest ones, that are tried as a new state."""

FORGETTING = (0.3, 3.0)
"""1/unit of time: how fast, beyond the fastest growth, it is forgotten what a state did to the outputs."""


class StateMap(NamedTuple):
    """States and their rates as linear functions of the data [ỹ; η̃], (n, dim [ỹ; η̃]) each."""

    states: Array
    rates: Array


def chain(box: BlackBox, order: int) -> Array | None:
    """θ of states that are the outputs first, then what of their derivatives these and the inputs do not explain.

    Args:
        box: the data.
        order: how many states.

    Returns:
        θ, or None where all derivatives are used up before there are so many.
    """
    y, v = _channels(box)
    states = rates = np.zeros((0, len(box.data.gram)))
    for k in range(box.p):
        explained, of_rates = _explained(box, y[k], [states, *v[:k]], [rates, *v[1 : k + 1]])
        left, rate = y[k] - explained, y[k + 1] - of_rates
        unit = np.sqrt(np.diag(_moments(box, y[k], y[k])))
        # Its largest directions, in units of the derivative itself.
        most = _directions(_moments(box, left / unit[:, None], left / unit[:, None]))[: order - len(states)] / unit
        states, rates = np.vstack([states, most @ left]), np.vstack([rates, most @ rate])
        if len(states) == order:
            return _theta(box, StateMap(states, rates))
    return None


def grown(box: BlackBox, model: GenerativeModel, place: Place) -> list[Array]:
    """θ with one state more than a model has: what stood out of its outputs, or of the motion of its states, as noise.

    Args:
        box: the data.
        model: with one state less.
        place: where its climb ended.
    """
    n, m = model.n, model.m
    errors = model.error_operator(place.belief.theta) @ np.vstack([np.eye(len(box.data.gram)), place.state_map])
    of_y, _, of_x = model.errors
    starts = []
    for noise, size in ((errors[of_y], m), (errors[of_x], n)):
        now, rate = noise[:size], noise[size : 2 * size]
        for direction in _directions(_moments(box, now, now))[:TAKEN_FROM_NOISE]:
            states = np.vstack([place.state_map[:n], direction @ now])
            starts.append(_theta(box, StateMap(states, np.vstack([place.state_map[n : 2 * n], direction @ rate]))))
    return starts


def reduced(box: BlackBox, model: GenerativeModel, place: Place) -> list[Array]:
    """θ with one state less than a model has: without what of its states the outputs see least (balanced truncation).

    Moore 1981, IEEE Transactions on Automatic Control 26, 17; outputs are weighed by exp(−t · forgetting), since a
    model may be unstable, and the states' covariance is that of the data.

    Args:
        box: the data.
        model: with one state more.
        place: where its climb ended.
    """
    n = model.n
    A, _, C = unpack(place.belief.theta, *model.sizes)
    states, rates = place.state_map[:n], place.state_map[n : 2 * n]
    whitening = _whitening(_moments(box, states, states))
    growth = max(0.0, float(np.linalg.eigvals(A).real.max()))
    starts = []
    for forgetting in FORGETTING:
        seen = solve_continuous_lyapunov((A - (growth + forgetting) * np.eye(n)).T, -C.T @ C)
        back = np.linalg.inv(whitening)
        kept = _directions(back.T @ seen @ back)[:-1] @ whitening
        starts.append(_theta(box, StateMap(kept @ states, kept @ rates)))
    return starts


def _channels(box: BlackBox) -> tuple[list[Array], list[Array]]:
    """Selects y, y′, … and v, v′, … from the data."""
    every = np.eye(len(box.data.gram))
    outputs, inputs = np.split(every, [box.m * (box.p + 1)])
    return np.split(outputs, box.p + 1), np.split(inputs, box.p)


def _moments(box: BlackBox, left: Array, right: Array) -> Array:
    """Mean products of two linear functions of the data."""
    return np.asarray(left @ box.data.gram @ right.T / box.data.number)


def _explained(box: BlackBox, wanted: Array, by: list[Array], of_rates: list[Array]) -> tuple[Array, Array]:
    """What a regression on some functions of the data tells of others; and the same of both one's rates."""
    regressors = np.vstack(by)
    if not len(regressors):
        return np.zeros_like(wanted), np.zeros_like(wanted)
    coefficients = _regression(box, wanted, regressors, NEGLIGIBLE)
    return coefficients @ regressors, coefficients @ np.vstack(of_rates)


def _regression(box: BlackBox, wanted: Array, regressors: Array, ridge: float) -> Array:
    """Coefficients by least squares, with a ridge in units of the regressors' variances."""
    unit = np.sqrt(np.diag(_moments(box, regressors, regressors)))
    unit = np.where(unit > 0, unit, 1.0)[:, None]
    scaled = regressors / unit
    square = _moments(box, scaled, scaled) + ridge * np.eye(len(scaled))
    return np.asarray((np.linalg.solve(square, _moments(box, scaled, wanted)) / unit).T)


def _directions(symmetric: Array) -> Array:
    """Its eigenvectors as rows, those of the largest eigenvalues first."""
    return np.asarray(np.linalg.eigh(symmetric)[1].T[::-1])


def _whitening(covariance: Array) -> Array:
    """W with W covariance Wᵀ = 1."""
    values, modes = np.linalg.eigh(covariance)
    return np.asarray((modes / np.sqrt(np.maximum(values, NEGLIGIBLE * values.max()))).T)


def _theta(box: BlackBox, given: StateMap) -> Array:
    """θ by regression, in the coordinates in which states have variance 1 and their noises are independent."""
    n = len(given.states)
    y, v = _channels(box)
    whitening = _whitening(_moments(box, given.states, given.states))
    states, rates = whitening @ given.states, whitening @ given.rates
    regressors = np.vstack([states, v[0]])
    # As the priors do, it weighs as much as one sample.
    ridge = 1 / box.data.number
    dynamics = _regression(box, rates, regressors, ridge)
    noise = rates - dynamics @ regressors
    turn = _directions(_moments(box, noise, noise))
    A, B = np.split(turn @ dynamics, [n], axis=1)
    # Of inputs that nobody recorded nothing is seen but noise: at B = 0 it would never be theirs.
    unknown = np.flatnonzero(np.diag(_moments(box, v[0], v[0])) == 0)
    B[unknown % n, unknown] = np.sqrt(np.diag(turn @ _moments(box, noise, noise) @ turn.T)[unknown % n])
    return pack(A @ turn.T, B, _regression(box, y[0], turn @ states, ridge))
