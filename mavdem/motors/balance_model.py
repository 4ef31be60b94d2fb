"""How the balance follows from the commands of a vehicle's motors, and how a weak motor changes both."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import coverage_factor
from mavdem.containers import Numbers
from mavdem.motors.motor_changes import THRUST_EXPONENTS
from mavdem.motors.signatures import MotorSignatures
from mavdem.motors.thrust_loss import lost_thrust

SETTLING_ERROR = 0.04
"""Standard error of a motor's rise a second after it began, as a fraction of it: yaw settles last."""


class RiseEstimate(NamedTuple):
    """Estimated rise of each of k motors' commands in a change, as a fraction of the command before it."""

    rises: Array
    """(k,) rises; 0 of motors that the change does not concern."""
    half_widths: Array
    """(k,) half widths of their 90 % intervals."""


@dataclass(frozen=True, eq=False)
class BalanceModel:
    """The mixer of a vehicle with k motors: the balance about a axes, and how weak motors change it.

    The balance is the torque about each axis that the motors' commands make, relative to their mean command.
    """

    mixer: MotorSignatures
    """Mixer with thrust, whose row is the first, and the a other axes."""

    @cached_property
    def torque_rows(self) -> Array:
        """(a, k) rows of the mixer that turn commands of motors into torque commands."""
        return self.mixer.mixer_rows[1:]

    @cached_property
    def signatures(self) -> Array:
        """(k, a) change of the balance where the own command of the motor of the row rises by 1."""
        return self.torque_rows.T / self.mixer.own_rise_ratios[:, None]

    @cached_property
    def allocation(self) -> Array:
        """(k, 1 + a) turns thrust and torque commands into commands of motors."""
        return np.linalg.pinv(self.mixer.mixer_rows).astype(np.float64)

    @cached_property
    def tilt_axes(self) -> Array:
        """(a,) 1 for roll and pitch, which a shifted load or wind changes, and 0 for yaw."""
        is_tilt_axis = [axis != "yaw" for axis in self.mixer.axes[1:]]
        return np.array(is_tilt_axis, dtype=np.float64)

    def estimated_rises(
        self, rises: Array, balance_before: Array, balance_after: Array, variance: Array
    ) -> RiseEstimate:
        """Estimates by how much the motors' commands rose in a change, relative to the commands before it.

        A hypothesis states which motors changed and in which ratio (``rises``), but not by how much. That is a factor,
        the size of the change, by which all rises are multiplied. It is the weighted least-squares estimate along the
        signature g, the change of the balance that ``rises`` themselves would make: with the balance before and after
        the change, b₀ and b₁, and the variance V, it is gᵀ V⁻¹ (b₁ − b₀) / (gᵀ V⁻¹ g).

        Torques change by ``rises`` times the signatures of the motors. The balance divides them by the mean command,
        which itself rises by mean_rise, so that g is less than that by mean_rise · b₁.

        Args:
            rises: (k,) rises of the motors' commands under the hypothesis; only their ratios matter.
            balance_before: (a,) balance before the change.
            balance_after: (a,) balance after it.
            variance: (a,) variance of the change.

        Returns:
            Rises (k,) as fractions of the commands before, with the half widths of their 90 % intervals.
        """
        mean_rise = (rises / self.mixer.own_rise_ratios).mean()
        signature = rises @ self.signatures - mean_rise * balance_after
        weighted_signature = signature / variance
        precision = weighted_signature @ signature
        size = weighted_signature @ (balance_after - balance_before) / precision
        # Commands before the change, relative to their mean: thrust 1 and the balance.
        commands = self.allocation @ [1.0, *balance_before]
        relative_rises = rises / commands
        estimates = size * relative_rises
        # Two independent errors: of least squares, and of a vehicle that has not settled yet.
        least_squares_errors = precision**-0.5 * relative_rises
        standard_errors = np.hypot(least_squares_errors, SETTLING_ERROR * estimates)
        return RiseEstimate(estimates, coverage_factor() * standard_errors)

    def thrust_loss(self, motor: int, lowest_rise: float, highest_rise: float) -> Numbers:
        """Returns an interval for the fraction of its thrust that a motor lost.

        The controller raises the command of the motor to compensate the loss, so that the loss follows from the rise
        (:func:`mavdem.motors.thrust_loss.lost_thrust`). Two things are uncertain: how far the command rose, and the
        exponent with which thrust depends on the command (``THRUST_EXPONENTS``).

        Args:
            motor: Index of the motor, from 0.
            lowest_rise: Lower end of the interval of the rise of its command, as a fraction of the command before.
            highest_rise: Upper end of that interval.

        Returns:
            Lower and upper end, fractions of the thrust.
        """
        smallest_exponent, largest_exponent = THRUST_EXPONENTS
        own_rise_ratio = self.mixer.own_rise_ratios[motor]
        return (
            float(lost_thrust(lowest_rise, own_rise_ratio, smallest_exponent)),
            float(lost_thrust(highest_rise, own_rise_ratio, largest_exponent)),
        )
