"""F̄ by model order: one flight fitted with one state, two, and so on, each from several starts.

F̄ of a model with hidden states has many maxima, most of them far below the highest. A start is a linear map from the
data to the states and their rates; θ follows by regression, in the coordinates of the priors: states of variance 1,
independent noises.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.linalg import solve_continuous_lyapunov
from scipy.optimize import minimize_scalar

from mavdem.dem.engine.ascent import CONVERGED_NATS, CoordinateAscent, Iterate
from mavdem.dem.engine.free_energy import Belief
from mavdem.dem.engine.generative import GeneralizedMoments, GenerativeModel, SufficientStatistics
from mavdem.dem.engine.linalg import Array, raise_on_overflow
from mavdem.dem.engine.model import pack, unpack
from mavdem.dem.order.system import BlackBox

Result = TypeVar("Result")

FIRST_ROUNDS = 12  # from every start; the best ones continue
ROUNDS, STARTS = (36, 200), (3, 1)  # the most further rounds, and from how many starts
SWEEPS = 2  # down from the largest order, and up again where that increased F̄
INCREASE_NATS = 1.0  # an increase of F̄ after which the neighbouring orders are fitted again
MAX_WIDTHS = 4.0  # of the kernel: a smoother disturbance counts as motion

SMOOTHNESS_ROUNDS, SMOOTHNESS_TOLERANCE = 12, 0.03
"""Rounds after a change of the noise's smoothness, and the relative tolerance of its search."""

SMOOTHNESS_GAIN_NATS = 10.0
"""The most that another smoothness is expected to add: fits further below the best so far are given up."""


class OrderFit(NamedTuple):
    """The best fit of one order: its model, the kernel width s (seconds) of its noise, the iterate of highest F̄ᵒ."""

    model: GenerativeModel
    smoothness: float
    iterate: Iterate


def fits_by_order(box: BlackBox, most: int, smoothness: float | None) -> tuple[OrderFit | None, ...]:
    """The best fit of each order from 1 to ``most``; None where every fit broke down.

    Without a ``smoothness`` of the noise, s, each order has the one that maximises its F̄ᵒ.
    """
    if smoothness is not None:
        return _swept(_Fits(box, box.counted(smoothness), smoothness), most)
    found = _swept(_Fits(box, box.counted(box.dt), None), most)
    highest = max((one for one in found if one), key=lambda one: one.iterate.free_energy, default=None)
    if highest is None:
        return found
    # The effective sample size follows from the smoothness, which is known only now.
    recounted = _Fits(box, box.counted(highest.smoothness), None)
    return tuple(None if one is None else recounted.continued(one) for one in found)


@dataclass(frozen=True, eq=False)
class _Fits:
    """Fits of one flight with one effective sample size; ``smoothness`` is ``None`` where it is estimated."""

    box: BlackBox
    samples: SufficientStatistics
    smoothness: float | None

    def best_of(self, order: int, smoothness: float, starts: Iterable[Array], best: float) -> OrderFit | None:
        """The best fit from the starts: a few rounds from each, more from the best, and last its smoothness.

        None where F̄ is no more than the ``best`` of that order so far.
        """
        ascent = CoordinateAscent(self.box.model(order, smoothness), self.samples)
        iterates = [iterate for theta in starts if (iterate := _or_none(partial(_from, ascent, theta)))]
        for rounds, kept in zip(ROUNDS, STARTS, strict=True):
            iterates = sorted(iterates, key=lambda iterate: -iterate.free_energy)[:kept]
            iterates = [_or_none(partial(_on, ascent, iterate, rounds)) or iterate for iterate in iterates]
        if not iterates or iterates[0].free_energy < best - SMOOTHNESS_GAIN_NATS:
            return None
        found = self._with_best_smoothness(OrderFit(ascent.model, smoothness, iterates[0]))
        return found if found.iterate.free_energy > best else None

    def continued(self, fit: OrderFit) -> OrderFit | None:
        """A fit continued with another effective sample size."""
        ascent = CoordinateAscent(fit.model, self.samples)
        iterate = _or_none(lambda: _on(ascent, ascent.at_belief(fit.iterate.belief), ROUNDS[-1]))
        return None if iterate is None else self._with_best_smoothness(fit._replace(iterate=iterate))

    def _with_best_smoothness(self, fit: OrderFit) -> OrderFit:
        """With the smoothness that maximises F̄."""
        if self.smoothness is not None:
            return fit
        fits = {fit.smoothness: fit}

        def negative_free_energy(log_width: float) -> float:
            # F̄ depends on the width of the noise after the kernel.
            smoothness = self.box.width * float(np.sqrt(np.expm1(2 * log_width)))
            ascent = CoordinateAscent(self.box.model(fit.model.n, smoothness), self.samples)
            iterate = _or_none(lambda: _on(ascent, ascent.at_belief(fit.iterate.belief), SMOOTHNESS_ROUNDS))
            if iterate is None:
                return -min(one.iterate.free_energy for one in fits.values())
            fits[smoothness] = OrderFit(ascent.model, smoothness, iterate)
            return -iterate.free_energy

        bounds = (0.0, float(np.log(MAX_WIDTHS)))
        minimize_scalar(negative_free_energy, bounds=bounds, method="bounded", options={"xatol": SMOOTHNESS_TOLERANCE})
        return max(fits.values(), key=lambda one: one.iterate.free_energy)


def _swept(fits: _Fits, most: int) -> tuple[OrderFit | None, ...]:
    """The best fits found by sweeping over the orders.

    Upwards, a model extends the one before; downwards, it is the next larger one reduced. Each finds maxima that the
    other does not.
    """
    box, begin = fits.box, fits.smoothness or fits.box.dt
    best: dict[int, OrderFit] = {}

    def improves(order: int, beside: int, starts: Sequence[Array] = ()) -> bool:
        """Whether a fit from the starts, or from one of the order ``beside``, increases F̄ of that order."""
        smoothness, before, near = begin, -np.inf, best.get(beside)
        if near is not None:
            smoothness, changed = near.smoothness, grown if beside < order else reduced
            starts = [*starts, *(_or_none(lambda: changed(box, near.model, near.iterate)) or ())]
        if order in best:
            before = best[order].iterate.free_energy
        found = fits.best_of(order, smoothness, starts, before)
        if found is None:
            return False
        best[order] = found
        return found.iterate.free_energy > before + INCREASE_NATS

    for order in range(1, most + 1):
        improves(order, order - 1, _or_none(partial(chain, box, order)) or ())
    for _ in range(SWEEPS):
        improved = {order for order in range(most - 1, 0, -1) if improves(order, order + 1)}
        for order in range(2, most + 1):
            if order - 1 in improved and improves(order, order - 1):
                improved.add(order)
        if not improved:
            break
    return tuple(best.get(order) for order in range(1, most + 1))


def _or_none(work: Callable[[], Result]) -> Result | None:
    """Its result; None where the fit breaks down."""
    try:
        with raise_on_overflow():
            return work()
    except np.linalg.LinAlgError:
        return None


def _from(ascent: CoordinateAscent, theta: Array) -> Iterate:
    """A few rounds from θ, with the noise at its prior."""
    prior = ascent.model.prior
    moments = GeneralizedMoments(ascent.model, ascent.samples.gram, np.empty((0, 0)))
    certain, known = np.zeros_like(prior.theta_precision), np.zeros_like(prior.lambda_precision)
    start = Belief(moments, np.empty(0), theta, certain, prior.lambda_mean, known)
    return _on(ascent, ascent.at_belief(start), FIRST_ROUNDS)


def _on(ascent: CoordinateAscent, iterate: Iterate, rounds: int) -> Iterate:
    """This many rounds further, or fewer once F̄ has converged."""
    done = 0
    while done < rounds:
        before = iterate.free_energy
        for following in ascent.rounds(iterate):
            iterate, done = following, done + 1
        if iterate.free_energy - before < CONVERGED_NATS:
            break
    return iterate


NEGLIGIBLE = 1e-9  # of a variance: keeps a combination of channels without variance from being divided by
NOISE_DIRECTIONS = 2  # the largest of the noise, each a start of a new state

FORGETTING_RATES = (0.3, 3.0)
"""1/unit of time beyond the fastest growth: of the weight exp(−t · rate) on a state's effect on the outputs."""


def chain(box: BlackBox, order: int) -> list[Array]:
    """θ of states that are the outputs, then the parts of their derivatives that these and the inputs do not explain.

    None of it where there are too few derivatives.
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
            return [_theta(box, states, rates)]
    return []


def grown(box: BlackBox, model: GenerativeModel, iterate: Iterate) -> list[Array]:
    """θ with one state more than a fitted model has: a direction of the noise of its outputs or of its states."""
    n, m = model.n, model.m
    errors = model.error_operator(iterate.belief.theta) @ np.vstack([np.eye(len(box.data.gram)), iterate.state_map])
    of_y, _, of_x = model.errors
    starts = []
    for noise, size in ((errors[of_y], m), (errors[of_x], n)):
        now, rate = noise[:size], noise[size : 2 * size]
        for direction in _directions(_moments(box, now, now))[:NOISE_DIRECTIONS]:
            states = np.vstack([iterate.state_map[:n], direction @ now])
            starts.append(_theta(box, states, np.vstack([iterate.state_map[n : 2 * n], direction @ rate])))
    return starts


def reduced(box: BlackBox, model: GenerativeModel, iterate: Iterate) -> list[Array]:
    """θ with one state less: without the states' direction of the least effect on the outputs (balanced truncation).

    Moore 1981, IEEE Transactions on Automatic Control 26, 17; outputs are weighted by exp(−t · forgetting), since a
    model may be unstable, and the states' covariance is that of the data.
    """
    n = model.n
    A, _, C = unpack(iterate.belief.theta, *model.sizes)
    states, rates = iterate.state_map[:n], iterate.state_map[n : 2 * n]
    whitening = _whitening(_moments(box, states, states))
    growth = max(0.0, float(np.linalg.eigvals(A).real.max()))
    starts = []
    for forgetting in FORGETTING_RATES:
        observability = solve_continuous_lyapunov((A - (growth + forgetting) * np.eye(n)).T, -C.T @ C)
        back = np.linalg.inv(whitening)
        kept = _directions(back.T @ observability @ back)[:-1] @ whitening
        starts.append(_theta(box, kept @ states, kept @ rates))
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
    """The prediction of some functions of the data by a regression on others; and the same of their rates."""
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
    """Its eigenvectors as rows, the largest eigenvalues first."""
    return np.asarray(np.linalg.eigh(symmetric)[1].T[::-1])


def _whitening(covariance: Array) -> Array:
    """W with W covariance Wᵀ = 1."""
    values, modes = np.linalg.eigh(covariance)
    return np.asarray((modes / np.sqrt(np.maximum(values, NEGLIGIBLE * values.max()))).T)


def _theta(box: BlackBox, states: Array, rates: Array) -> Array:
    """θ by regression, in the coordinates in which states have variance 1 and their noises are independent.

    ``states`` and ``rates`` (n, dim [ỹ; η̃]) are linear functions of the data.
    """
    n = len(states)
    y, v = _channels(box)
    whitening = _whitening(_moments(box, states, states))
    states, rates = whitening @ states, whitening @ rates
    regressors = np.vstack([states, v[0]])
    # Like the priors, it has the weight of one sample.
    ridge = 1 / box.data.number
    dynamics = _regression(box, rates, regressors, ridge)
    noise = rates - dynamics @ regressors
    turn = _directions(_moments(box, noise, noise))
    A, B = np.split(turn @ dynamics, [n], axis=1)
    # Unrecorded inputs appear as noise only: a fit from B = 0 would never attribute it to them.
    unknown = np.flatnonzero(np.diag(_moments(box, v[0], v[0])) == 0)
    B[unknown % n, unknown] = np.sqrt(np.diag(turn @ _moments(box, noise, noise) @ turn.T)[unknown % n])
    return pack(A @ turn.T, B, _regression(box, y[0], turn @ states, ridge))
