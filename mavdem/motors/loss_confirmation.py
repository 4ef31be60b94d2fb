"""Confirmation of a loss of thrust that was detected in flight: whether it persists, or was a gust or lean of seconds.

A change of the balance is detected within a second or more, and wind may push for longer than that. A motor that lost
thrust stays weak. So the balance from ``MIN_LOSS_SECONDS`` after the change on is compared with both: with the balance
before the change, and with that which the change left.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.motors.change_statistics import BLOCK_SECONDS, PRIOR_FREEDOM, long_run_variance
from mavdem.motors.motor_changes import MIN_LOSS_SECONDS

MIN_CONFIRMATION_SECONDS = 4.0
"""Seconds of flight after ``MIN_LOSS_SECONDS`` whose mean balance decides at the earliest; a choice."""

MAX_CONFIRMATION_SECONDS = 24.0
"""Seconds of flight after ``MIN_LOSS_SECONDS`` after which a loss that was not withdrawn is confirmed; a choice.

Later the wind may have changed, and flight before the change is not a reference any more.
"""

SMALLEST_VARIANCE = 1e-6
"""Least variance of a mean share: it bounds the odds of blocks that are all alike."""

SMOOTHING_BLOCKS = 4
"""Number of blocks, 2 s, over whose mean it is decided when a change was over: single blocks are too noisy."""

HALF_CHANGE = 0.5
"""Fraction of a change below which the balance is nearer to that before the change than to that after it."""


class LossConfirmation(NamedTuple):
    """A loss of thrust that was just detected, with the balance before and after it, to be confirmed or withdrawn.

    The balance is the torque about each of a axes relative to the thrust; a block is half a second of flight.
    """

    motor: int
    """Index of the motor."""
    start: float
    """When the change began, s."""
    detection: float
    """When it was detected, s."""
    balance_before: Array
    """(a,) balance on each axis before the change."""
    change: Array
    """(a,) balance after the change, less that before."""
    variance: Array
    """(a,) variance of that difference."""

    def is_decidable(self, time: float) -> bool:
        """Returns whether there is enough flight after the change at a time, s."""
        return time >= self.start + MIN_LOSS_SECONDS + MIN_CONFIRMATION_SECONDS

    def is_over(self, time: float) -> bool:
        """Returns whether the loss is confirmed at a time, s, since nothing withdrew it."""
        return time >= self.start + MIN_LOSS_SECONDS + MAX_CONFIRMATION_SECONDS

    def remaining_fractions(self, balances: Array) -> Array:
        """Returns the fraction of the change that remains in each block: 0 as before the change, 1 as after it.

        It is the projection of the balance on the change, by weighted least squares: each axis is weighted by the
        inverse of the variance of the change.

        Args:
            balances: (N, a) balance of each block.

        Returns:
            (N,) remaining fractions.
        """
        weights = self.change / self.variance
        return (balances - self.balance_before) @ weights / (self.change @ weights)

    def log_odds_of_return(self, times: Sequence[float], balances: Sequence[Array]) -> float:
        """Returns the logarithm of the odds that the balance has returned to its value before the change.

        The alternative is that it remains as after the change. In each block a fraction of the change remains. The mean
        m of these fractions is 0 if the balance has returned, and 1 if it remains changed, apart from a normal error of
        variance σ². With these two densities of m the log odds are (1 − 2 m) / (2 σ²).

        Args:
            times: (N,) ends of the blocks since the detection, s.
            balances: N balances (a,) of these blocks.

        Returns:
            The log odds; 0, even odds, while there is too little flight to decide.
        """
        # A gust or a correction of the attitude may take this long.
        is_after_disturbance = np.array(times) > self.start + MIN_LOSS_SECONDS
        remaining = self.remaining_fractions(np.array(balances)[is_after_disturbance])
        if len(remaining) * BLOCK_SECONDS < MIN_CONFIRMATION_SECONDS:
            return 0.0
        mean = remaining.mean()
        # The blocks are correlated, so that the variance of their mean follows from the long-run variance. The function
        # takes several signals and windows; here it is one signal, and one window with all blocks.
        variances_of_windows = long_run_variance(
            remaining[:, None],
            selection=np.ones((1, len(remaining)), dtype=bool),
            mean=np.array([[mean]]),
            prior_variance=np.array([remaining.var()]),
            prior_freedom=PRIOR_FREEDOM,
        )
        mean_variance = float(variances_of_windows.max()) / len(remaining)
        return float((1 - 2 * mean) / (2 * max(mean_variance, SMALLEST_VARIANCE)))

    def blocks_since_return(self, balances: Sequence[Array]) -> int:
        """Returns the number of blocks, at least 1, since the balance is back at its value before the change.

        It is back after the last block at which the moving average of the remaining fraction of the change was at least
        one half.

        Args:
            balances: (a,) balance in each of the N blocks since the detection.
        """
        remaining = self.remaining_fractions(np.array(balances))
        averaging_weights = np.full(SMOOTHING_BLOCKS, 1 / SMOOTHING_BLOCKS)
        mean_remaining = np.convolve(remaining, averaging_weights, "same")
        changed_blocks = np.flatnonzero(mean_remaining >= HALF_CHANGE)
        last_changed_block = int(changed_blocks[-1]) if len(changed_blocks) else 0
        blocks_after = len(remaining) - 1 - last_changed_block
        return max(blocks_after, 1)
