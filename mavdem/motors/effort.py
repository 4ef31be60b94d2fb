"""Effort of a vehicle's motors in hover: collective times voltage, and whether it changed between flights.

The speed of a rotor goes with its command times the voltage, so this product stays as the battery sags. It grows with
the payload, in thinner air, and with propellers that give less thrust. Which of these it was, it does not say.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import coverage_factor, student_t_log_density
from mavdem.containers import Numbers
from mavdem.motors.change_hypotheses import PERSISTENCE, student_t_mixture
from mavdem.motors.deviation import PRIOR_BALANCE_FREEDOM
from mavdem.motors.healthy_flights import MIN_HEALTHY_FLIGHTS, HealthFigures, HealthFlights

PRIOR_EFFORT_SD = 0.02
"""Prior standard deviation of the effort between healthy flights, as a fraction.

Air of 3 % more or less density, 5 K of battery temperature, and still air or 5 m/s of wind make 1 to 2 % each.
"""

PRIOR_CHANGE_PROBABILITY = 0.1
"""Prior probability that the effort of a flight changed; a choice."""

CHANGE_SCALE = 0.1
"""Scale of a change of the effort, as a fraction; a choice."""


class EffortChange(NamedTuple):
    """Change of a flight's effort from the effort of healthy flights."""

    relative_change: float
    """Change as a fraction of the healthy flights' effort."""
    probability: float
    """Probability that the effort changed at all, 0 to 1."""
    posterior: Array
    """(1 + s,) posterior probabilities of no change, then of changes of s sizes."""
    interval: Numbers
    """Both ends of the 90 % interval of the change, as fractions, without regard to the prior of a change."""


def effort_change(
    flight: HealthFigures, healthy: HealthFlights, previous: EffortChange | None
) -> EffortChange | None:
    """Estimates whether and by how much the effort of a flight differs from the effort of healthy flights.

    Args:
        flight: The flight.
        healthy: Healthy flights, without that flight.
        previous: Result of the vehicle's flight before this one, which persists with the probability ``PERSISTENCE``;
            None without one.

    Returns:
        The relative change, and the probability that anything changed; None if the effort of the flight or of
        ``MIN_HEALTHY_FLIGHTS`` healthy ones is not known.
    """
    healthy_efforts = [
        healthy_flight.effort for healthy_flight in healthy if healthy_flight.effort is not None
    ]
    if flight.effort is None or len(healthy_efforts) < MIN_HEALTHY_FLIGHTS:
        return None
    return change_between_efforts(healthy_efforts, [flight.effort], previous)


def change_between_efforts(
    before: Sequence[float], after: Sequence[float], previous: EffortChange | None = None
) -> EffortChange:
    """Estimates whether and by how much the effort of flights differs from that of other flights of the vehicle.

    The effort is the mean motor output times the battery voltage. Its logarithm is normal over flights of an unchanged
    vehicle, with a variance pooled from their scatter and a prior. So without a change the difference of the mean
    logarithms follows Student's t distribution. The prior of a change is a mixture of normal distributions of s sizes,
    and Bayes' rule gives the probability of each size and of no change.

    Args:
        before: Efforts of the flights to compare with, V; at least one.
        after: Efforts of the flights that may have changed, V; at least one.
        previous: Result of the vehicle's flight before ``after``; None without one.

    Returns:
        The relative change with its interval, and the probability that anything changed.
    """
    logs_before, logs_after = np.log(before), np.log(after)
    squares = ((logs_before - logs_before.mean()) ** 2).sum()
    squares += ((logs_after - logs_after.mean()) ** 2).sum()
    # The prior counts like ``PRIOR_BALANCE_FREEDOM`` further flights.
    freedom = PRIOR_BALANCE_FREEDOM + len(before) + len(after) - 2
    variance_between = (PRIOR_BALANCE_FREEDOM * PRIOR_EFFORT_SD**2 + squares) / freedom
    # The errors of both means.
    variance = variance_between * (1 / len(before) + 1 / len(after))
    log_change = logs_after.mean() - logs_before.mean()
    posterior = _posterior_of_change(log_change, variance, freedom, previous)
    half_width = coverage_factor(freedom=freedom) * np.sqrt(variance)
    return EffortChange(
        float(np.expm1(log_change)),
        probability=float(1 - posterior[0]),
        posterior=posterior,
        interval=(
            float(np.expm1(log_change - half_width)),
            float(np.expm1(log_change + half_width)),
        ),
    )


def _posterior_of_change(
    log_change: float, variance: float, freedom: float, previous: EffortChange | None
) -> Array:
    """Returns the probabilities (1 + s,) of no change of the effort, and of changes of s sizes, by Bayes' rule.

    Args:
        log_change: Measured difference of the mean logarithms.
        variance: Variance of its error.
        freedom: Degrees of freedom of that variance.
        previous: Result of the vehicle's flight before, which persists with the probability ``PERSISTENCE``; None
            without one.
    """
    mixture = student_t_mixture(CHANGE_SCALE)
    prior = np.append(1 - PRIOR_CHANGE_PROBABILITY, PRIOR_CHANGE_PROBABILITY * mixture.weights)
    if previous is not None:
        prior = PERSISTENCE * previous.posterior + (1 - PERSISTENCE) * prior
    # The first entry is "no change", of standard deviation 0; the others are the components of the mixture.
    change_sds = np.append(0.0, mixture.standard_deviations)
    scale = np.sqrt(variance + change_sds**2)
    likelihood = np.exp(student_t_log_density(log_change / scale, freedom)) / scale
    posterior = prior * likelihood
    return posterior / posterior.sum()
