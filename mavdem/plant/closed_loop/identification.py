"""Identification: the plant of one axis by the maxima of its likelihood, by Fisher's scoring from several starts."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import softmax

from mavdem.arrays import Array
from mavdem.confidence import SIGNIFICANT_SIGMAS
from mavdem.dem.engine.gauss_newton import (
    MAX_STEPS,
    Damping,
    QuadraticExpansion,
    gauss_newton,
)
from mavdem.dem.engine.linalg import inverse
from mavdem.plant.closed_loop.likelihood import AxisPosterior
from mavdem.plant.closed_loop.parameters import CONTROLLER, PLANT, SD, STEP_TIME

STARTS = (1.0, 0.05, 0.009), (3.0, 0.05, 0.009), (10.0, 0.02, 0.005)
"""Crossover, Hz, lag and delay, s, to begin with: of slow yaw, and of large and of small vehicles."""
FIRST_STEPS = 8  # from each start, of which the two best go on
STEP_TIMES = (-2.0, 0.0, 2.0)
"""To go on from: in streams slower than the controller there may be a maximum near each, with other plants. On half of
the flights of ``tools/validation/loops.py``, one ascent of 50 Hz in five ended 3 nats below the highest maximum."""
SCATTER = 0.6
"""Of the variance by ``DEPENDENT`` values that count as one, which keeps slow logs to their priors: that of estimates
from flight to flight. Chosen on half of the flights of ``tools/validation/loops.py``."""
SAME_NATS = 4.0  # below a maximum, an ascent ends there
LONGEST_PARAMETER_STEP = 1.5  # of any parameter, and a standard deviation beforehand at most


class IdentifiedAxis(NamedTuple):
    """The parameters of an axis, as probable as its spectra and what is known beforehand make them."""

    axis: AxisPosterior
    theta: Array  # (k,) in the order of ``parameters.NAMES``
    covariance: Array  # (k, k)
    likeliest: Array  # (k,) of the ascent's end that has the largest share in them

    @property
    def cut_off(self) -> float:
        """The share of what the controller asked that limits kept from coming."""
        return float(np.clip(1 - np.exp(self.theta[CONTROLLER]), 0.0, self.axis.limited))

    @property
    def explains(self) -> bool:
        """Whether the controller has the gain of its parameters, or as much less as limits may make of it."""
        gains = np.array([self.theta, self.likeliest])[:, CONTROLLER]
        unsure = SIGNIFICANT_SIGMAS * SD[CONTROLLER]
        least = np.log1p(-self.axis.limited) - unsure
        return bool(((least <= gains) & (gains <= unsure)).all())

    @property
    def steered(self) -> float:
        """The share of the rate's variance that follows what was asked, by the parameters and by the likeliest."""
        return min(map(self.axis.steered_share, (self.theta, self.likeliest)))


def identified(axis: AxisPosterior) -> IdentifiedAxis:
    """Returns the parameters of an ``axis`` by its likelihood's maxima; ``LinAlgError`` where there are none."""
    begun = []
    for crossover, lag, delay in STARTS:
        theta = axis.mean.copy()
        _, back = np.abs(axis.known.transfer(np.array([crossover])))
        effect, _, *late = PLANT
        theta[[effect, *late]] = np.log([2 * np.pi * crossover / back[0], lag, delay])
        begun.append(_ascended(axis, theta, FIRST_STEPS))
    times = STEP_TIMES if axis.densities.between else STEP_TIMES[1:2]
    ended: list[QuadraticExpansion] = []
    for fit in sorted(begun, key=lambda fit: fit.value)[-2:]:
        for time in times:
            theta = lag_first(fit.point)
            theta[STEP_TIME] = time
            ended.append(_ascended(axis, theta, MAX_STEPS, ended))
    return _averaged(axis, ended)


def _averaged(axis: AxisPosterior, ended: Sequence[QuadraticExpansion]) -> IdentifiedAxis:
    """The mean over ends at different times of steps, each as probable as by Laplace's approximation."""
    finite = (fit for fit in ended if np.isfinite(fit.value))
    ascending = sorted(finite, key=lambda fit: fit.value)
    # Ascents that end at the same time of steps have found the same maximum: the highest stays.
    maxima = {round(fit.point[STEP_TIME]): fit for fit in ascending}.values()
    if not maxima:
        raise np.linalg.LinAlgError("nothing has a likelihood")
    shares = softmax([fit.value - np.linalg.slogdet(fit.curvature)[1] / 2 for fit in maxima])
    thetas = np.array([fit.point for fit in maxima])
    theta = shares @ thetas
    within = sum(
        share * _covariance(axis, fit.curvature) for share, fit in zip(shares, maxima, strict=True)
    )
    between = (thetas - theta).T * shares @ (thetas - theta)
    return IdentifiedAxis(axis, theta, within + between, thetas[np.argmax(shares)])


def _covariance(axis: AxisPosterior, curvature: Array) -> Array:
    """At a maximum of this ``curvature``: the sandwich of the prior and ``SCATTER`` of what the spectra say."""
    whole = inverse(curvature)
    prior = np.diag(axis.sd**-2.0)
    return whole @ (SCATTER * curvature + (1 - SCATTER) * prior) @ whole


def lag_first(theta: Array) -> Array:
    """Returns parameters (k,) of the same response as ``theta`` whose quicker pole is the lag's, not the damping's."""
    effect, damping, lag, _ = PLANT
    excess = max(theta[damping] + theta[lag], 0.0)
    swapped = theta.copy()
    swapped[[damping, lag]] -= excess
    swapped[effect] -= excess
    return swapped


def _apart(now: QuadraticExpansion, maximum: QuadraticExpansion) -> float:
    """By how much the function is lower here, about a ``maximum``."""
    step = now.point - maximum.point
    return float(step @ maximum.curvature @ step) / 2


def _ascended(
    axis: AxisPosterior, theta: Array, steps: int, maxima: Sequence[QuadraticExpansion] = ()
) -> QuadraticExpansion:
    """From parameters ``theta`` after so many damped steps, or where there is nothing to gain.

    An ascent that comes to one of the ``maxima`` has no more to find.
    """

    def enough(now: QuadraticExpansion) -> bool:
        return any(_apart(now, maximum) < SAME_NATS for maximum in maxima)

    damping = Damping(initial=1e-2, factor=5.0, max_attempts=16, limit_step=_limited)
    trace, _ = gauss_newton(axis, axis.expand(theta), damping, steps, enough)
    return trace[-1]


def _limited(step: Array) -> Array:
    """A step that changes no parameter by more than ``LONGEST_PARAMETER_STEP``."""
    longest = np.minimum(SD, LONGEST_PARAMETER_STEP)
    return step / max(1.0, np.abs(step / longest).max())
