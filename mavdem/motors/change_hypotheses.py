"""Hypotheses on what changed the balance of a vehicle's motors between flights, and their posterior probabilities.

The hypotheses exclude each other: nothing changed; one motor or its propeller is weak, by any amount; roll and pitch
changed, as by a shifted load; yaw alone changed, as by a twisted arm; all three changed, of any cause.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mavdem.arrays import SMALLEST_POSITIVE, Array
from mavdem.confidence import INTERVAL_QUANTILES, student_t_log_density
from mavdem.immutable import ImmutableResult
from mavdem.motors.deviation import Deviation
from mavdem.motors.signatures import MotorSignatures

PRIOR_PROBABILITIES = {"healthy": 0.76, "motor": 0.10, "load": 0.08, "yaw": 0.04, "other": 0.02}
"""Prior probability of each group of hypotheses for any flight; a choice.

They are: nothing changed; a motor or propeller is weak; roll and pitch, yaw alone, or all three changed in any way.
"""

CHANGED_AXES = {"load": (1, 1, 0), "yaw": (0, 0, 1), "other": (1, 1, 1)}
"""Which of roll, pitch and yaw (1 or 0) change, by the group of hypotheses that are not a motor's."""

ROLL, YAW = 0, 2
"""Columns of these axes in a balance, which has roll, pitch and yaw."""

PERSISTENCE = 0.5
"""Probability that what holds in one flight holds in the next: much is noticed and repaired on the ground. A choice."""

MEAN_RISE = 0.15
"""Mean of the exponential prior of a weak motor's rise, relative to the mean command.

A motor needs this much more command to make up for a quarter less thrust.
"""

RISES = np.linspace(0.0, 1.0, 401)[1:]
"""(r,) rises of a weak motor's command, relative to the mean command, for which there is a hypothesis each."""

CHANGE_SCALE = 0.05
"""Scale of a change of the balance on an axis, relative to the mean command.

A load that moved by 15 mm on arms of 160 mm, or an arm twisted by 1.5°.
"""

CHANGE_FREEDOM = 2.0
"""Degrees of freedom of the Student's t distribution of changes: heavy tails, since none is too large to happen."""

MIXTURE_SCALES = np.geomspace(0.4, 40.0, 24)
"""Standard deviations, in scales of a t distribution, of the normal distributions that approximate it. A choice."""

FAULT_RISE = 0.08
"""Rise of a motor's command, relative to the mean command, from which it is a fault.

On four motors, it has lost an eighth of its thrust.
"""

DETECTABLE_RISE = 0.2
"""Rise that must be detectable in a flight that is called healthy: of four motors, a third less thrust."""

MAX_MISFIT = 4.0
"""Deviation on any axis from a weak motor's signature, in scales, from which it is not that motor's; a choice."""


@dataclass(frozen=True, eq=False)
class NormalMixture:
    """A distribution as a mixture of s normal distributions about 0."""

    standard_deviations: Array
    """(s,) standard deviations of its components."""
    weights: Array
    """(s,) their weights, with the sum 1."""


def student_t_mixture(scale: float) -> NormalMixture:
    """Approximates Student's t distribution with ``CHANGE_FREEDOM`` degrees of freedom by a mixture of normal ones.

    A t distribution of ν degrees of freedom is a mixture of normal distributions whose variances follow an inverse
    gamma distribution. Their standard deviations s then have the density s^(−ν − 1) e^(−ν/2 (scale / s)²). It is
    sampled at those of ``MIXTURE_SCALES``, in geometric steps; the weight of each is the density times s, its step. As
    normal distributions, the components can be combined with normal errors by adding variances.

    Args:
        scale: Scale of the t distribution, in the unit of the change.

    Returns:
        The components of the mixture, with mean 0, and their weights.
    """
    standard_deviations = scale * MIXTURE_SCALES
    decay = np.exp(-CHANGE_FREEDOM / 2 * (scale / standard_deviations) ** 2)
    weights = standard_deviations**-CHANGE_FREEDOM * decay
    return NormalMixture(standard_deviations, weights / weights.sum())


class ChangeHypotheses:
    """All S hypotheses on a change of the balance of one vehicle, with their prior probabilities.

    Attributes:
        signatures: Mixer of the vehicle with k motors.
        change: (S, 3) expected change in roll, pitch and yaw, relative to the mean command.
        spread: (S, 3) standard deviation of the change about that.
        prior: (S,) prior probabilities, with the sum 1.
        groups: Hypotheses of each name in ``PRIOR_PROBABILITIES``; the hypotheses of the motors are sorted by motor,
            then by ``RISES``.
    """

    def __init__(
        self,
        signatures: MotorSignatures,
        prior_probabilities: Mapping[str, float] = PRIOR_PROBABILITIES,
    ) -> None:
        """Makes the hypotheses of a vehicle: a table with one row for each size of each cause.

        Args:
            signatures: Mixer of the vehicle.
            prior_probabilities: Prior weight of each group, of any sum.
        """
        self.signatures = signatures
        # A motor's rises have an exponential prior. Other changes are a mixture of normal distributions, with one
        # hypothesis for each component.
        motor_count = len(signatures.weak_motor_balance)
        mixture = student_t_mixture(CHANGE_SCALE)
        weights_by_group = {
            "healthy": np.ones(1),
            "motor": np.tile(np.exp(-RISES / MEAN_RISE), motor_count),
            "load": mixture.weights,
            "yaw": mixture.weights,
            "other": mixture.weights,
        }
        total = sum(prior_probabilities.values())
        self.groups: dict[str, slice] = {}
        priors = []
        start = 0
        for name, weights in weights_by_group.items():
            self.groups[name] = slice(start, start + len(weights))
            start += len(weights)
            priors.append(prior_probabilities[name] / total * weights / weights.sum())
        self.prior = np.concatenate(priors)

        self.change = np.zeros((len(self.prior), 3))
        # (k, 1, 3): the first column of a signature is thrust, the others are roll, pitch and yaw.
        signatures_of_motors = signatures.weak_motor_balance[:, None, 1:]
        self.change[self.groups["motor"]] = (signatures_of_motors * RISES[:, None]).reshape(-1, 3)
        self.spread = np.zeros((len(self.prior), 3))
        for name, axes in CHANGED_AXES.items():
            self.spread[self.groups[name]] = np.outer(mixture.standard_deviations, axes)

    def cause_probabilities(
        self, deviation: Deviation, previous: Array | None = None
    ) -> ChangeProbabilities:
        """Computes how probable each cause of a change is, given the deviation of a flight's balance from healthy ones.

        There are S hypotheses, each a cause with one size: nothing changed, motor i works harder by one of r rises, a
        load shifted, and others. Their probabilities by Bayes' rule are summed by cause and by motor. A motor has a
        fault if its own command rises by ``FAULT_RISE`` or more. On vehicles with more than four motors the neighbours
        of a weak motor help it, so that its own command rises by less than it must work harder (``own_rise_ratios``).

        Args:
            deviation: Deviation of the flight's balance.
            previous: (S,) posterior probabilities after the vehicle's flight before this one, which persist with the
                probability ``PERSISTENCE``; None without one.

        Returns:
            The posterior probabilities, by cause and by motor.
        """
        posterior = self._posterior_probabilities(deviation, previous)
        group_probabilities = {name: posterior[rows].sum() for name, rows in self.groups.items()}

        # (k, r): hypotheses of the motors are sorted by motor, then by rise.
        by_motor_and_rise = posterior[self.groups["motor"]].reshape(-1, len(RISES))
        motor_probabilities = by_motor_and_rise.sum(axis=1)
        own_rise_ratios = self.signatures.own_rise_ratios
        # (k, r): the outer product is the rise of each motor's own command.
        is_fault = np.outer(own_rise_ratios, RISES) >= FAULT_RISE
        fault_probabilities = np.where(is_fault, by_motor_and_rise, 0.0).sum(axis=1)

        return ChangeProbabilities(
            group_probabilities=group_probabilities,
            motor_probabilities=motor_probabilities,
            fault_probabilities=fault_probabilities,
            rises=_mean_and_interval_of_rises(by_motor_and_rise) * own_rise_ratios,
            posterior=posterior,
        )

    def _posterior_probabilities(self, deviation: Deviation, previous: Array | None) -> Array:
        """Computes the posterior probabilities of the hypotheses by Bayes' rule.

        A hypothesis expects a change of the balance about roll, pitch and yaw, with a standard deviation (spread). The
        scale of healthy flights' deviations is added to that in quadrature. The likelihood is the product of Student's
        t densities on the three axes. The hypothesis that a motor is weak is ruled out if the observed change differs
        from its expected change by more than ``MAX_MISFIT`` scales on any axis. Otherwise it might win only because the
        others fit even worse.

        Args:
            deviation: Deviation of the flight's balance.
            previous: (S,) posterior probabilities after the vehicle's flight before this one; None without one.

        Returns:
            (S,) probabilities with the sum 1.
        """
        prior = self.prior
        if previous is not None:
            prior = PERSISTENCE * previous + (1 - PERSISTENCE) * prior
        # Slices of the hypotheses with each cause.
        load_rows = self.groups["load"]
        motor_rows = self.groups["motor"]
        spread = self.spread.copy()
        # If the vehicle leans, a load that shifted changes yaw too, since the drag acts off the centre of gravity.
        spread[load_rows, YAW] = spread[load_rows, ROLL] * deviation.lean
        # (S, 3), as are the spread and the standard scores: hypotheses by axes.
        scale = np.hypot(deviation.scale, spread)
        standard_scores = (deviation.change - self.change) / scale
        log_densities = student_t_log_density(standard_scores, deviation.freedom) - np.log(scale)
        log_likelihood = log_densities.sum(axis=1)
        is_ruled_out = np.zeros(len(log_likelihood), dtype=bool)
        is_ruled_out[motor_rows] = (abs(standard_scores[motor_rows]) > MAX_MISFIT).any(axis=1)
        log_likelihood[is_ruled_out] = -np.inf
        # The largest is subtracted, so that the exponentials do not all vanish.
        likelihood_ratios = np.exp(log_likelihood - log_likelihood.max())
        posterior = prior * likelihood_ratios
        posterior /= posterior.sum()
        return posterior

    def detection_probability(self, deviation: Deviation) -> float:
        """Returns the probability with which a flight would show a rise of one motor's command by ``DETECTABLE_RISE``.

        A flight whose balance is imprecise looks healthy even if a motor is weak. To measure this, the flight's change
        is replaced by the signature of each motor in turn, with the scale of the flight, and explained.

        Args:
            deviation: Deviation of the flight; its change does not count.

        Returns:
            Probability that something changed, the mean over the motors, 0 to 1.
        """
        rises = DETECTABLE_RISE / self.signatures.own_rise_ratios
        # The first column of a signature is thrust, the others are roll, pitch and yaw.
        signatures = self.signatures.weak_motor_balance[:, 1:]
        changes = signatures * rises[:, None]
        probabilities = []
        for change in changes:
            change_probabilities = self.cause_probabilities(deviation._replace(change=change))
            probabilities.append(1 - change_probabilities.unchanged_probability)
        return float(np.mean(probabilities))


def _mean_and_interval_of_rises(by_motor_and_rise: Array) -> Array:
    """Returns by how much the command of each motor rises if this motor is the weak one: mean and 90 % interval.

    Args:
        by_motor_and_rise: (k, r) posterior probability that a motor is the weak one and its command rose by one of the
            r ``RISES``.

    Returns:
        (3, k) mean, 5 % and 95 % quantile of each motor.
    """
    # Probabilities given the motor are divided by its own. The limit avoids a division by 0 for impossible motors.
    motor_probabilities = np.maximum(by_motor_and_rise.sum(axis=1), SMALLEST_POSITIVE)
    mean = by_motor_and_rise @ RISES / motor_probabilities
    cumulative = np.cumsum(by_motor_and_rise, axis=1) / motor_probabilities[:, None]
    quantiles = []
    for quantile in INTERVAL_QUANTILES:
        # Index of the first rise at which the cumulative probability reaches the quantile. Rounding may keep the sum of
        # all probabilities below it.
        rise_index = (cumulative < quantile).sum(axis=1).clip(max=len(RISES) - 1)
        quantiles.append(RISES[rise_index])
    return np.array([mean, *quantiles])


@dataclass(frozen=True, eq=False)
class ChangeProbabilities(ImmutableResult):
    """What may explain the deviation of a flight of a vehicle with k motors, with probabilities that sum to 1."""

    group_probabilities: dict[str, float]
    """Probability of each group of hypotheses, by the names in ``PRIOR_PROBABILITIES``."""
    motor_probabilities: Array
    """(k,) probability that each motor, or its propeller, is weak."""
    fault_probabilities: Array
    """(k,) probability that each motor is so weak that its command rises by ``FAULT_RISE`` or more."""
    rises: Array
    """(3, k) rise of each motor's own command if it is the weak one, relative to the mean command.

    Rows: the mean, then the ends of the 90 % interval.
    """
    posterior: Array
    """(S,) posterior probabilities of all hypotheses."""

    @property
    def unchanged_probability(self) -> float:
        """Probability that nothing changed except for the usual scatter from flight to flight."""
        return self.group_probabilities["healthy"]

    @property
    def fault_probability(self) -> float:
        """Probability that some motor, or its propeller, is so weak that it is a fault."""
        return self.fault_probabilities.sum()
