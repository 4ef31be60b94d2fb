"""Deviation of a flight's motor balance from the vehicle's healthy flights, without the effect of leaning in wind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import coverage_factor, half_width
from mavdem.motors.healthy_flights import HealthFigures, HealthFlights
from mavdem.motors.motor_balance import MotorBalance
from mavdem.motors.signatures import MotorSignatures

PRIOR_BALANCE_SD = np.array([0.010, 0.010, 0.008])
"""Prior standard deviation of the level balance in roll, pitch and yaw between healthy flights, relative to the thrust.

A battery that is 3 mm off, on arms of 160 mm, shifts 2 % of the thrust from one side to the other; commands go with
its root or a little more slowly. An arm that is twisted by 1° gives about 3 % in yaw, and a quarter of that counts as
usual.
"""

PRIOR_BALANCE_FREEDOM = 6.0
"""Degrees of freedom of that prior: the number of healthy flights that it is worth."""

LEAN_EFFECT_PRIOR_SD = np.array([[1.0, 0.3], [0.3, 1.0], [0.3, 0.3]])
"""Prior standard deviation of the effects of roll and pitch lean (columns) on roll, pitch and yaw (rows), 1/rad.

The large ones are drag an arm's length above or below the centre of mass, the small ones a load 5 mm off its axis.
"""

LEAN_EFFECT_SPREAD_SD = 0.2
"""Prior standard deviation of the effects of lean between flights of one vehicle, 1/rad.

Loads differ, and where a vehicle manoeuvres it leans without wind.
"""

LEAN_EFFECT_SPREAD_FREEDOM = 1.0
"""Degrees of freedom of that prior: the number of flights that it is worth."""

BEYOND_LEVEL = 0.999
"""Probability that a healthy flight's deviation lies inside the interval beyond which it is a change; a choice."""


class Deviation(NamedTuple):
    """Deviation of a flight's level balance from the mean of healthy flights, relative to the mean command."""

    change: Array
    """(3,) deviation in roll, pitch and yaw."""
    scale: Array
    """(3,) scale of the Student's t distribution that a healthy flight's deviation has."""
    freedom: float
    """Degrees of freedom of that distribution."""
    lean: float = 0.0
    """Mean angle of the flight from level, rad."""

    @property
    def usual_half_widths(self) -> Array:
        """(3,) half widths of the interval that has 90 % of healthy flights' deviations, for known scales."""
        return coverage_factor() * self.scale

    @property
    def is_unusual(self) -> bool:
        """Whether the deviation on some axis is larger than the deviations of 999 healthy flights in 1000."""
        half_widths = coverage_factor(BEYOND_LEVEL, self.freedom) * self.scale
        return (abs(self.change) > half_widths).any()


def deviation(flight: HealthFigures, healthy: HealthFlights) -> Deviation:
    """Computes how far the level balance of a flight is from the mean of healthy flights.

    The balance is the torque that the motors make about each axis, relative to their thrust. The level balance is the
    same without the torque that leaning in wind requires. Three variances add up to the variance of the deviation: the
    variance between healthy flights, pooled from their scatter and its prior; the variance of the flight's own level
    balance; and the variance of the mean of the healthy flights.

    Args:
        flight: A flight whose needed figures are all known (``HealthFigures.missing`` is None).
        healthy: n healthy flights with known figures, without that flight.

    Returns:
        The deviation, with the Student's t distribution that it would have, were the flight healthy.
    """
    balances = [flight.known_balance, *[healthy_flight.known_balance for healthy_flight in healthy]]
    # Row 0 is the flight, the other rows are the healthy flights.
    level = level_balances(balances)
    flight_balance = level.balances[0]
    flight_variance = level.variances[0]
    healthy_balances = level.balances[1:]
    count = len(healthy)
    centre = healthy_balances.mean(axis=0)
    squares = ((healthy_balances - centre) ** 2).sum(axis=0)
    # The prior counts like ``PRIOR_BALANCE_FREEDOM`` further flights.
    freedom = PRIOR_BALANCE_FREEDOM + count - 1
    variance_between = (PRIOR_BALANCE_FREEDOM * PRIOR_BALANCE_SD**2 + squares) / freedom
    variance_of_healthy = variance_between + level.variances[1:].mean(axis=0)
    variance_of_mean = variance_of_healthy / count
    scale = np.sqrt(variance_between + flight_variance + variance_of_mean)
    lean = float(np.linalg.norm(balances[0].lean))
    return Deviation(flight_balance - centre, scale, freedom, lean)


@dataclass(frozen=True, eq=False)
class LevelBalances:
    """Balances of n flights as they would be without lean, relative to the mean command."""

    balances: Array
    """(n, 3) commands in roll, pitch and yaw."""
    variances: Array
    """(n, 3) variances of their errors."""


def level_balances(flights: Sequence[MotorBalance]) -> LevelBalances:
    """Removes from the balances of flights what the lean explains: the effect of lean times the lean.

    Wind makes a vehicle lean and at the same time requires torque, so that without this step a windy flight would look
    like a change of the motors.

    Args:
        flights: n flights of one vehicle.

    Returns:
        The level balances. Their variances contain the errors of the balances and of the effects of lean.
    """
    effects = shrunken_lean_effects(flights)
    lean = np.array([flight.lean for flight in flights])
    mean = np.array([flight.mean for flight in flights])
    error = np.array([flight.error for flight in flights])
    # Indices: f the flight, a the axis of the command, l the angle of the lean.
    level = mean - np.einsum("fal,fl->fa", effects.effects, lean)
    lean_variance = np.einsum("fal,fl->fa", effects.variances, lean**2)
    return LevelBalances(level, error**2 + lean_variance)


class MotorDeviations(NamedTuple):
    """Deviations of k motors from their mean in n flights, as fractions of the mean command, without lean."""

    estimates: Array
    """(n, k) deviations; positive of a motor that works harder than the mean."""
    half_widths: Array
    """(n, k) half widths of their 90 % intervals."""


def deviations_of_motors(level: LevelBalances, signatures: MotorSignatures) -> MotorDeviations:
    """Converts level balances into how much the command of each motor deviates from the mean of all motors.

    A balance is the mean command in roll, pitch and yaw. The mixer of the vehicle adds it to the commands of the k
    motors. If there are more than four motors, other deviations of theirs are possible, which no balance shows.

    Args:
        level: Balances of n flights without lean.
        signatures: Mixer of the vehicle, in which all of thrust, roll, pitch and yaw are known.

    Returns:
        The deviations (n, k) with the half widths of their intervals.
    """
    # (k, 3) change of the command of each motor by the commands in roll, pitch and yaw.
    allocation = signatures.torque_allocation
    # The errors in roll, pitch and yaw are independent, so that their variances add up.
    variances = level.variances @ (allocation**2).T
    return MotorDeviations(
        estimates=level.balances @ allocation.T, half_widths=half_width(variances)
    )


@dataclass(frozen=True, eq=False)
class ShrunkenEffects:
    """Estimated effects of lean on the commands in n flights."""

    effects: Array
    """(n, 3, 2) change of the commands in roll, pitch and yaw by the roll and the pitch angle, 1/rad."""
    variances: Array
    """(n, 3, 2) variances of their errors, 1/rad²."""


def shrunken_lean_effects(flights: Sequence[MotorBalance]) -> ShrunkenEffects:
    """Estimates the effect of lean on the balance in each flight, by empirical-Bayes shrinkage.

    In a calm flight the lean hardly varies, and its effect is known only from the vehicle's other flights. So the
    estimate from a flight is averaged with the mean of all flights, each weighted by the inverse of its variance
    (precision). The effects of the flights scatter about their mean by the variance between flights. One half of that
    is taken as a true difference between the flights, and the other half as a further error of the estimates, since
    manoeuvres bias them (docs/evidence/motors.md). A flight without an estimate gets the mean.

    Args:
        flights: n flights of one vehicle.

    Returns:
        Effects of roll and pitch on the balance of each axis, and their variances.
    """
    # All arrays with a row for each flight have the shape (n, 3, 2): three axes of the balance, by roll and pitch.
    estimates = np.array([flight.lean_effect for flight in flights])
    variance = np.array([flight.lean_effect_error for flight in flights]) ** 2
    is_known = np.isfinite(estimates) & np.isfinite(variance)
    estimates = np.where(is_known, estimates, 0.0)
    # An infinite variance is a weight of 0.
    variance = np.where(is_known, variance, np.inf)

    # The variance between flights (3, 2) is pooled with its prior.
    count = is_known.sum(axis=0)
    unweighted_mean = estimates.sum(axis=0) / np.maximum(count, 1)
    squares = np.where(is_known, (estimates - unweighted_mean) ** 2, 0.0).sum(axis=0)
    freedom = LEAN_EFFECT_SPREAD_FREEDOM + np.maximum(count - 1, 0)
    prior_squares = LEAN_EFFECT_SPREAD_FREEDOM * LEAN_EFFECT_SPREAD_SD**2
    variance_between_flights = (prior_squares + squares) / freedom

    # The weighted mean of all flights (3, 2). The prior of the effects shrinks it towards 0.
    weights = 1 / (variance + variance_between_flights)
    total_weight = weights.sum(axis=0) + LEAN_EFFECT_PRIOR_SD**-2
    mean = (weights * estimates).sum(axis=0) / total_weight
    mean_variance = 1 / total_weight

    # The weighted average of a flight's own estimate and of that mean.
    half_variance_between = variance_between_flights / 2
    estimate_precision = 1 / (variance + half_variance_between)
    mean_precision = 1 / (half_variance_between + mean_variance)
    precision = estimate_precision + mean_precision
    effects = (estimate_precision * estimates + mean_precision * mean) / precision
    return ShrunkenEffects(effects, variances=1 / precision)
