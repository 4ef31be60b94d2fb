"""Difference of a quantity between two groups of flights by a random-effects model, and a joint test of many of them.

The variance of a difference has two parts: that within the flights, by their intervals, and that between flights, which
several flights of a group show. ``SD_BETWEEN_FLIGHTS`` is assumed beforehand (random effects, L. V. Hedges and I.
Olkin, "Statistical Methods for Meta-Analysis", 1985). The quantities are tested by families. Of those of a family that
are called changed some share is false: the expected mean of this share over the families with changes is at most
``SIGNIFICANCE``, where the intervals hold. The share among the changes of all families together is not bounded. If
nothing changed, ``SIGNIFICANCE`` bounds the probability that any is called so (Y. Benjamini and M. Bogomolov,
"Selective inference on multiple families of hypotheses", 2014).
"""

from collections.abc import Collection, Sequence
from math import exp, expm1, hypot, inf, nan, sqrt
from typing import NamedTuple

import numpy as np
import scipy

from mavdem.arrays import Array
from mavdem.confidence import CONFIDENCE_LEVEL, Interval, coverage_factor
from mavdem.containers import Numbers, group_by
from mavdem.experiments.paired_test import SIGNIFICANCE
from mavdem.facts.fleet import QuantityOutcome
from mavdem.fleet.quantities import (
    ATTITUDE_GAIN_MARGIN,
    ATTITUDE_LOOP_KINDS,
    ATTITUDE_PHASE_MARGIN,
    DAMPING,
    EFFECT,
    GAIN_MARGIN,
    LAG,
    LOGARITHMIC_KINDS,
    LOOP_KINDS,
    MAX_SENSITIVITY,
    MEAN_EFFECT,
    OVERSHOOT,
    PHASE_MARGIN,
    RISE,
    SHARE,
    Estimate,
    Quantity,
)
from mavdem.motors.deviation import PRIOR_BALANCE_SD

SD_BETWEEN_FLIGHTS = {
    SHARE: float(np.linalg.norm(PRIOR_BALANCE_SD)),
    EFFECT: 0.02,
    MEAN_EFFECT: 0.1,
    DAMPING: 0.2,
    LAG: 0.004,
    PHASE_MARGIN: 0.07,
    GAIN_MARGIN: 0.9,
    ATTITUDE_PHASE_MARGIN: 0.07,
    ATTITUDE_GAIN_MARGIN: 0.9,
    MAX_SENSITIVITY: 0.12,
    OVERSHOOT: 0.04,
    RISE: 0.1,
}
"""Assumed standard deviation of a quantity from flight to flight of the same vehicle.

Those of ``LOGARITHMIC_KINDS`` are relative, that of the damping is in 1/s, that of the motor time constant in s, those
of the margins in rad and dB, that of the overshoot a fraction of the step. Shares have what the health of motors
assumes for the three axes; docs/evidence/motors.md shows where the others come from. Figures of loops have what the
mean effect does to a loop: a tenth of the gain is 0.9 dB, moves the phase at the crossover by about 4°, and Ms,
overshoot and rise time of usual loops by so much.
"""

PRIOR_FREEDOM = 8
"""Degrees of freedom of ``SD_BETWEEN_FLIGHTS``: the assumption counts as much as this many flights. A choice."""

INTERVAL_FREEDOM = 20
"""Degrees of freedom of the variance within a flight, whose interval is itself an estimate: a choice."""

EQUIVALENCE_LIMITS = {
    SHARE: 0.06,
    EFFECT: 0.2,
    MEAN_EFFECT: 0.2,
    DAMPING: 0.8,
    LAG: 0.02,
    PHASE_MARGIN: 0.2,
    GAIN_MARGIN: 3.0,
    ATTITUDE_PHASE_MARGIN: 0.2,
    ATTITUDE_GAIN_MARGIN: 3.0,
    MAX_SENSITIVITY: 0.3,
    OVERSHOOT: 0.15,
    RISE: 0.3,
}
"""Largest difference of a quantity that is called the same, as ``QuantityChange.difference`` has it.

The whole interval of the difference must lie within it (an equivalence test). The limits are choices.
"""


MAX_REMAINING_PART = 0.5
"""Part of a change of a trim below which the rest without lean must be, for lean to explain most of the change."""

FAMILIES = {
    "trims": (SHARE,),
    "physical parameters": (EFFECT, MEAN_EFFECT, DAMPING, LAG),
    "loops": LOOP_KINDS,
}
"""Kinds of quantities by family: each family is estimated in another way, and changes for other reasons.

They are the motors' outputs in hover, the physical parameters of the models, and the figures of the identified loops.
"""


def equivalence_interval(kind: str) -> Interval:
    """Returns the smallest and the largest difference of a quantity that are called the same.

    A ratio of 1.2 is +20 % or, with the other state as the first, −17 %. Both count as one difference, so that the
    result does not depend on the order of the states.

    Args:
        kind: kind of the quantity, such as ``DAMPING``.

    Returns:
        The two differences, as ``QuantityChange.difference`` has them, such as (−0.167, 0.2).
    """
    limit = EQUIVALENCE_LIMITS[kind]
    if kind in LOGARITHMIC_KINDS:
        return (1 / (1 + limit) - 1, limit)
    return (-limit, limit)


class QuantityChange(NamedTuple):
    """One quantity in two states of a vehicle, and its difference."""

    quantity: Quantity
    """The quantity."""

    before: float
    """Mean of the first state; shares and effects of motors are relative to the median motor, 0 if equal."""

    after: float
    """Mean of the second state, likewise."""

    tested_difference: float
    """Second state less first; for ``LOGARITHMIC_KINDS`` the logarithm of the ratio of second to first.

    The logarithm has the same size whichever of the two states is called the first.
    """

    tested_half_width: float
    """Half width of the 90 % interval of ``tested_difference``."""

    p: float
    """Probability of a difference as large if nothing changed (two-sided p-value)."""

    allowance: float
    """Standard deviation of what other conditions of flight may do to it, which is in the half width."""

    outcome: QuantityOutcome = QuantityOutcome.SAME
    """Changed; the same; or uncertain, where the interval reaches beyond what is called the same."""

    freedom: float = inf
    """Degrees of freedom of the standard deviation that the interval is made of."""

    flights_before: Numbers = ()
    """Value in each flight of the first state, as the mean ``before``, in order of date; NaN where it has none."""

    flights_after: Numbers = ()
    """Value in each flight of the second state, likewise."""

    without_lean: "QuantityChange | None" = None
    """Of a trim, the same change without the part that lean makes; None where that is not known."""

    @property
    def difference(self) -> float:
        """Second state less first; relative for ``LOGARITHMIC_KINDS``."""
        if self._is_ratio:
            return expm1(self.tested_difference)
        return self.tested_difference

    @property
    def half_width(self) -> float:
        """Half width of the 90 % interval of the difference; for ``LOGARITHMIC_KINDS`` linearized, see ``interval``."""
        if self._is_ratio:
            return exp(self.tested_difference) * self.tested_half_width
        return self.tested_half_width

    @property
    def interval(self) -> Interval:
        """Ends of the 90 % interval of the difference, which is not symmetric for ``LOGARITHMIC_KINDS``."""
        low = self.tested_difference - self.tested_half_width
        high = self.tested_difference + self.tested_half_width
        if self._is_ratio:
            return (expm1(low), expm1(high))
        return (low, high)

    @property
    def _is_ratio(self) -> bool:
        """Whether the difference is a ratio less 1."""
        return self.quantity.kind in LOGARITHMIC_KINDS

    @property
    def interval_contains_zero(self) -> bool:
        """Whether the interval of the difference, without regard to other quantities, contains "no change"."""
        return abs(self.tested_difference) <= self.tested_half_width

    @property
    def is_doubtful(self) -> bool:
        """Whether it does not count as changed though its own interval does not contain "no change".

        That interval disregards how many quantities are tested.
        """
        return self.outcome is QuantityOutcome.UNCERTAIN and not self.interval_contains_zero

    @property
    def difference_without_lean(self) -> float | None:
        """Of a trim, the difference without the part that lean makes; None where that is not known."""
        return None if self.without_lean is None else self.without_lean.difference

    @property
    def is_explained_by_lean(self) -> bool:
        """Whether a change of a motor's trim, sure or doubtful, comes only from another lean of the vehicle.

        In other wind a vehicle leans otherwise, for which its motors must work otherwise. Lean explains the change if,
        without its effect, less than ``MAX_REMAINING_PART`` of the difference is left and that may be chance.
        """
        seems_changed = self.outcome is QuantityOutcome.CHANGED or self.is_doubtful
        if self.without_lean is None or not seems_changed:
            return False
        remaining_difference = abs(self.without_lean.tested_difference)
        is_most_explained = remaining_difference < MAX_REMAINING_PART * abs(self.tested_difference)
        return is_most_explained and self.without_lean.interval_contains_zero

    @property
    def shows_weaker_motor(self) -> bool:
        """Whether it means a weaker motor.

        A motor that became weaker either takes a larger share of the output to hold the vehicle level, or has less
        effect.
        """
        if not self.quantity.is_of_motor:
            return False
        if self.quantity.kind == SHARE:
            return self.difference > 0
        return self.difference < 0

    @property
    def is_equivalent(self) -> bool:
        """Whether the whole interval of the difference lies within what is called the same (an equivalence test)."""
        low, high = self.interval
        lowest, highest = equivalence_interval(self.quantity.kind)
        return lowest <= low and high <= highest

    @property
    def largest_difference(self) -> float:
        """Largest size of a difference that the interval contains, in the unit of the difference."""
        return max(abs(end) for end in self.interval)

    def detectable_difference(self, significance: float) -> float:
        """Returns the true ``difference`` that a test finds in 90 % of comparisons like this one, in the same unit.

        The test calls a quantity changed if its p-value is at most the significance. An estimate exceeds that limit
        with a probability of 90 % if the true difference is larger by the one-sided 90 % quantile of the error: the
        minimum detectable difference of sample-size planning (S.-C. Chow, "Sample Size Calculations", sec. 3.2).

        Args:
            significance: significance level of the two-sided test of this quantity. In a test of several quantities it
                is a fraction of the level of all.
        """
        sd = self.tested_half_width / coverage_factor(freedom=self.freedom)
        quantile_of_test = scipy.special.stdtrit(self.freedom, 1 - significance / 2)
        quantile_of_error = scipy.special.stdtrit(self.freedom, CONFIDENCE_LEVEL)
        tested_difference = float(sd * (quantile_of_test + quantile_of_error))
        # Of a ratio it is an increase; the decrease by the same factor is as detectable, and smaller.
        return expm1(tested_difference) if self._is_ratio else tested_difference


class StateMean(NamedTuple):
    """Mean of one quantity over the flights of a state, with the variance of this mean and where that comes from.

    The parts of the variance are kept apart, since τ² and the variances within flights have different degrees of
    freedom.
    """

    value: float
    """The mean."""

    variance: float
    """Variance of the mean."""

    variance_from_between: float
    """Part of it that comes from the variance τ² between flights; the rest comes from errors within the flights."""


class StateEstimates(NamedTuple):
    """The estimates of one quantity in the f flights of a state."""

    values: Array
    """The estimates (f,)."""

    variances: Array
    """Variances of their errors within the flights (f,)."""

    @classmethod
    def from_known(cls, estimates: Sequence[Estimate | None]) -> "StateEstimates":
        """Collects values and variances of the flights that have an estimate.

        Args:
            estimates: estimate of each flight; None for a flight without one, which is left out.
        """
        known = [estimate for estimate in estimates if estimate is not None]
        values = np.array([estimate.value for estimate in known])
        variances = np.array([estimate.sd**2 for estimate in known])
        return cls(values, variances)

    @property
    def excess_squares(self) -> float:
        """Sum of squared deviations of the flights from their mean, less what the errors within the flights explain.

        If the f flights do not differ, Σ (x − x̄)² has the expectation Σ v (1 − 1/f), with the variances v of the
        errors. What exceeds this comes from real differences between the flights; without such differences it can be
        negative by chance. The unit is the squared unit of the estimates.
        """
        flight_count = self.values.size
        squared_deviations = (self.values - self.values.mean()) ** 2
        expected_squares = self.variances.sum() * (1 - 1 / flight_count)
        return float(squared_deviations.sum() - expected_squares)

    def weighted_mean(self, variance_between: float) -> StateMean:
        """Returns the mean of the flights, weighted by the inverse of the variance of each flight's estimate.

        Args:
            variance_between: variance τ² of the quantity between flights, which adds to the variance within each.
        """
        weights = 1 / (self.variances + variance_between)
        total_weight = weights.sum()
        relative_weights = weights / total_weight
        return StateMean(
            value=float(weights @ self.values / total_weight),
            variance=float(1 / total_weight),
            variance_from_between=float((relative_weights**2).sum() * variance_between),
        )


def quantity_change(
    quantity: Quantity,
    before: Sequence[Estimate | None],
    after: Sequence[Estimate | None],
    allowance: float,
) -> QuantityChange:
    """Estimates the difference of one quantity between two states by a random-effects model (Hedges and Olkin, 1985).

    The variance of a flight's estimate is that within the flight plus a common variance between flights, τ². The mean
    of a state weighs its flights by the inverse of that sum. The difference of the means has a t distribution, whose
    degrees of freedom follow from the degrees of freedom of both variances by Welch and Satterthwaite.

    Args:
        quantity: compared quantity.
        before: estimate in each flight of the first state, None where it has none; at least one is known.
        after: estimate in each flight of the second state, likewise.
        allowance: standard deviation of what other conditions may do to the difference.

    Returns:
        The change, not yet tested together with others.
    """
    states = [StateEstimates.from_known(before), StateEstimates.from_known(after)]
    between_freedom = PRIOR_FREEDOM + sum(state.values.size - 1 for state in states)
    variance_between = variance_between_flights(quantity.kind, states, between_freedom)

    state_means = [state.weighted_mean(variance_between) for state in states]
    # The variances of both means add up to the variance of the difference.
    variance = sum(mean.variance for mean in state_means)
    variance_from_between = sum(mean.variance_from_between for mean in state_means)
    variance_from_within = variance - variance_from_between
    # The degrees of freedom of a sum of two variances, by Welch and Satterthwaite.
    freedom = variance**2 / (
        variance_from_between**2 / between_freedom + variance_from_within**2 / INTERVAL_FREEDOM
    )

    sd = hypot(sqrt(variance), allowance)
    half_width = coverage_factor(freedom=freedom) * sd
    mean_before, mean_after = (mean.value for mean in state_means)
    difference = mean_after - mean_before
    # Two-sided probability of such a difference if nothing changed.
    p_value = float(2 * scipy.special.stdtr(freedom, -abs(difference) / sd))
    return QuantityChange(
        quantity,
        before=_shown_value(quantity, mean_before),
        after=_shown_value(quantity, mean_after),
        tested_difference=difference,
        tested_half_width=half_width,
        p=p_value,
        allowance=allowance,
        freedom=freedom,
        flights_before=_shown_estimates(quantity, before),
        flights_after=_shown_estimates(quantity, after),
    )


def _shown_value(quantity: Quantity, tested_value: float) -> float:
    """Returns a value of a quantity as it is shown: 0.05 for a motor whose tested logarithm is log(1.05).

    Args:
        quantity: the quantity. A motor's value is its ratio to the median motor, shown as the deviation from 1. The
            mean effect of all motors is shown itself.
        tested_value: the value that is tested, a logarithm for ``LOGARITHMIC_KINDS``; others are shown unchanged.
    """
    if quantity.kind not in LOGARITHMIC_KINDS:
        return tested_value
    reference = 1.0 if quantity.is_of_motor else 0.0
    return exp(tested_value) - reference


def _shown_estimates(quantity: Quantity, estimates: Sequence[Estimate | None]) -> tuple[float, ...]:
    """Returns the value of a quantity in each flight as it is shown (:func:`_shown_value`); NaN where it has none.

    Args:
        quantity: the quantity.
        estimates: its estimate in each flight, None where it has none.
    """
    values = []
    for estimate in estimates:
        values.append(nan if estimate is None else _shown_value(quantity, estimate.value))
    return tuple(values)


def variance_between_flights(kind: str, states: Sequence[StateEstimates], freedom: int) -> float:
    """Estimates the variance τ² of a quantity between flights of one state, from an assumption and from the flights.

    The assumption ``SD_BETWEEN_FLIGHTS`` counts as ``PRIOR_FREEDOM`` flights. Its sum of squares and the sum of squares
    that the flights show are added, and divided by the degrees of freedom of both.

    Args:
        kind: kind of the quantity, such as ``DAMPING``.
        states: estimates of the quantity in the flights of each state.
        freedom: degrees of freedom of the assumption and of the flights together.

    Returns:
        Variance τ², in the squared unit of the quantity.
    """
    prior_squares = PRIOR_FREEDOM * SD_BETWEEN_FLIGHTS[kind] ** 2
    # Flights that differ less than their errors by chance do not lower the assumed variance.
    observed_squares = max(sum(state.excess_squares for state in states), 0.0)
    return (prior_squares + observed_squares) / freedom


def with_outcomes(
    changes: Sequence[QuantityChange],
    axes_with_other_gains: Collection[str] = (),
    axes_with_other_attitude_gains: Collection[str] = (),
) -> list[QuantityChange]:
    """Decides which quantities changed.

    - The figures of a loop whose gains are known to differ are expected to differ too. Such a figure changed if its own
      90 % interval does not contain 0.
    - All other quantities are tested together (:func:`_changed_quantities`), which bounds the number of false alarms.
    - A quantity that did not change is called the same if its whole interval lies within ``equivalence_interval``,
      and uncertain otherwise.

    Args:
        changes: the differences with their p-values.
        axes_with_other_gains: axes on which gains or filters of the rate loop differ between the states.
        axes_with_other_attitude_gains: axes on which the gain from attitude error to rate setpoint differs.

    Returns:
        The changes with their outcomes, in the order of kinds, motors and axes.
    """
    tested_changes = []
    changed_quantities = set()
    for change in changes:
        if not follows_from_gains(
            change.quantity, axes_with_other_gains, axes_with_other_attitude_gains
        ):
            tested_changes.append(change)
        elif not change.interval_contains_zero:
            changed_quantities.add(change.quantity)
    changed_quantities |= _changed_quantities(tested_changes)

    changes_with_outcomes = []
    for change in changes:
        if change.quantity in changed_quantities:
            outcome = QuantityOutcome.CHANGED
        elif change.is_equivalent:
            outcome = QuantityOutcome.SAME
        else:
            outcome = QuantityOutcome.UNCERTAIN
        changes_with_outcomes.append(change._replace(outcome=outcome))
    kinds = list(SD_BETWEEN_FLIGHTS)
    return sorted(
        changes_with_outcomes,
        key=lambda change: (kinds.index(change.quantity.kind), change.quantity),
    )


def follows_from_gains(
    quantity: Quantity,
    axes_with_other_gains: Collection[str],
    axes_with_other_attitude_gains: Collection[str] = (),
) -> bool:
    """Returns whether a quantity is expected to differ between two states, because gains of its loop were changed.

    This is so for the figures of a control loop, for example a phase margin. The attitude loop contains the rate loop
    of its axis, so that its figures depend on the gains of both.

    Args:
        quantity: kind of the quantity, such as a margin, with its axis or motor.
        axes_with_other_gains: axes on which gains or filters of the rate loop were changed.
        axes_with_other_attitude_gains: axes on which the gain from attitude error to rate setpoint was changed.
    """
    if quantity.kind not in LOOP_KINDS:
        return False
    if quantity.axis in axes_with_other_gains:
        return True
    is_of_attitude_loop = quantity.kind in ATTITUDE_LOOP_KINDS
    return is_of_attitude_loop and quantity.axis in axes_with_other_attitude_gains


def significance_of_single_change(changes: Sequence[QuantityChange], kind: str) -> float:
    """Returns the p-value below which a quantity is called changed if it is the only one that changed.

    The hierarchical test of :func:`_changed_quantities` is strictest then, and equals a Bonferroni correction: the
    significance is divided by the number of families, and by the number of quantities in the family.

    Args:
        changes: the differences of all quantities that are tested, of any kind.
        kind: kind of the quantity, such as a damping, which determines its family.
    """
    families = [family_of(change.quantity.kind) for change in changes]
    family_count = len(set(families))
    quantities_in_family = families.count(family_of(kind))
    return SIGNIFICANCE / (family_count * quantities_in_family)


def _changed_quantities(changes: Sequence[QuantityChange]) -> set[Quantity]:
    """Finds the quantities that changed by a hierarchical test of families (Benjamini and Bogomolov, 2014).

    If each quantity were tested by itself, the chances of false alarms would add up. If all were tested in one family,
    many figures of loops could hide a change of one motor. So there are two steps, each of them the procedure of Y.
    Benjamini and Y. Hochberg (1995):

    1. The families of ``FAMILIES``, such as motors, are tested by their p-values of R. J. Simes (1986). R of the m
       families are selected at the false discovery rate ``SIGNIFICANCE``.
    2. The quantities of each selected family are tested at the false discovery rate R / m · ``SIGNIFICANCE``.

    Args:
        changes: the differences with their p-values.

    Returns:
        The quantities that changed.
    """
    if not changes:
        return set()
    changes_by_family = group_by(changes, lambda change: family_of(change.quantity.kind))
    adjusted_by_family = {}
    simes_p_values = []
    for family, changes_of_family in changes_by_family.items():
        p_values = [change.p for change in changes_of_family]
        adjusted_p_values = scipy.stats.false_discovery_control(p_values)
        adjusted_by_family[family] = adjusted_p_values
        # The smallest adjusted p-value is the p-value of Simes.
        simes_p_values.append(adjusted_p_values.min())
    is_selected = scipy.stats.false_discovery_control(simes_p_values) <= SIGNIFICANCE
    selected_fraction = is_selected.mean()
    false_discovery_rate = SIGNIFICANCE * selected_fraction
    changed_quantities = set()
    for family, is_family_selected in zip(changes_by_family, is_selected, strict=True):
        if not is_family_selected:
            continue
        changes_of_family = changes_by_family[family]
        for change, adjusted_p in zip(changes_of_family, adjusted_by_family[family], strict=True):
            if adjusted_p <= false_discovery_rate:
                changed_quantities.add(change.quantity)
    return changed_quantities


def family_of(kind: str) -> str:
    """Returns the name of the family, of ``FAMILIES``, that a kind of quantities belongs to."""
    return next(name for name, kinds in FAMILIES.items() if kind in kinds)
