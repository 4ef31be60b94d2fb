"""Effort: how hard all motors together are commanded at the battery's voltage, beside that of healthy flights.

A rotor's speed goes with its command times the voltage, so the collective times the voltage stays as the battery sags.
More of it is needed for a payload, in thinner air, and with propellers that give less thrust: which, it does not say.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from mavdem.health.explanations import CENTRE_WEIGHTS, CENTRES, LASTS, shift_sizes
from mavdem.health.reference import FEWEST_FLIGHTS, SCATTER_FREEDOM, HealthFigures

Array = NDArray[np.float64]

SCATTER = 0.02
"""Standard deviation over healthy flights before any was seen, as a share: air of 3 % more or less density, 5 K of
battery temperature, still air or 5 m/s of wind each make 1 to 2 %."""
CHANGED = 0.1  # Probability before any flight that it changed
SHIFT = 0.1  # Scale of a change, as a share


class EffortChange(NamedTuple):
    """The effort of a flight beside that of healthy ones.

    Attributes:
        more: by which share it is greater.
        usual: half the width of an interval of 90 % of healthy flights.
        probability: that it changed.
        candidates: (S,) the probabilities of no change, by the error of the healthy flights' mean, then of changes.
    """

    more: float
    usual: float
    probability: float
    candidates: Array


def effort_change(
    flight: HealthFigures, healthy: Sequence[HealthFigures], before: EffortChange | None = None
) -> EffortChange | None:
    """By how much the effort changed; None where it is not known of the flight and of two healthy ones.

    ``before`` is what the flight before it showed.
    """
    efforts = np.log([each.effort for each in healthy if each.effort is not None])
    if flight.effort is None or len(efforts) < FEWEST_FLIGHTS:
        return None
    freedom = SCATTER_FREEDOM + len(efforts) - 1
    centre = efforts.mean()
    spread = ((efforts - centre) ** 2).sum()
    scatter = (SCATTER_FREEDOM * SCATTER**2 + spread) / freedom
    centre_error = np.sqrt(scatter / len(efforts))
    more = float(np.log(flight.effort) - centre)
    sizes, weights = shift_sizes(SHIFT)
    prior = np.append((1 - CHANGED) * CENTRE_WEIGHTS / CENTRE_WEIGHTS.sum(), CHANGED * weights)
    if before is not None:
        prior = LASTS * before.candidates + (1 - LASTS) * prior
    # All flights share the error of the mean: without a change it is a candidate, as in the balance.
    expected = np.append(CENTRES * centre_error, np.zeros_like(sizes))
    scale = np.sqrt(scatter + np.append(np.zeros_like(CENTRES), centre_error**2 + sizes**2))
    posterior = prior * stats.t.pdf((more - expected) / scale, freedom) / scale
    posterior /= posterior.sum()
    usual = float(stats.t.ppf(0.95, freedom) * np.hypot(np.sqrt(scatter), centre_error))
    return EffortChange(float(np.expm1(more)), usual, float(posterior[len(CENTRES) :].sum()), posterior)
