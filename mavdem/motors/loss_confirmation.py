"""Whether a loss of thrust that was detected in flight lasts, or was a gust or a lean of some seconds.

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

Later the wind may have changed, and flight before the change is no reference any more.
"""

SMALLEST_VARIANCE = 1e-6
"""Least variance of a mean share: it bounds the odds of blocks that are all alike."""

SMOOTHING_BLOCKS = 4
"""Number of blocks whose mean tells when a change was over: 2 s."""


class LossConfirmation(NamedTuple):
    """A loss of thrust that was detected a moment ago, with what tells whether it lasts."""

    motor: int
    """Index of the motor."""
    start: float
    """When the change began, s."""
    detection: float
    """When it was detected, s."""
    balance_before: Array
    """(a,) balance before the change."""
    change: Array
    """(a,) balance that the change left, less that before."""
    variance: Array
    """(a,) variance of the change."""

    def is_decidable(self, time: float) -> bool:
        """Returns whether there is enough flight after the change at a time, s."""
        return time >= self.start + MIN_LOSS_SECONDS + MIN_CONFIRMATION_SECONDS

    def is_over(self, time: float) -> bool:
        """Returns whether the loss is confirmed at a time, s, since nothing withdrew it."""
        return time >= self.start + MIN_LOSS_SECONDS + MAX_CONFIRMATION_SECONDS

    def shown_shares(self, balances: Array) -> Array:
        """Returns (N,) which share of the change each block shows: 0 as before the change, 1 as after it.

        It is the projection on the change, weighted by its variance, so that axes count more on which it is known well.

        Args:
            balances: (N, a) balance of each block.
        """
        weights = self.change / self.variance
        return (balances - self.balance_before) @ weights / (self.change @ weights)

    def log_odds_of_return(self, times: Sequence[float], balances: Sequence[Array]) -> float:
        """Returns the logarithm of the odds that the balance is again as before the change, against as after it.

        Both hypotheses expect a mean share of the change, 0 and 1, with the same error, that of a mean of correlated
        blocks. The logarithm of the ratio of two such normal densities is (1 − 2 m) / (2 σ²).

        Args:
            times: (N,) ends of the blocks since the detection, s.
            balances: N balances (a,).
        """
        is_settled = np.array(times) > self.start + MIN_LOSS_SECONDS
        shares = self.shown_shares(np.array(balances)[is_settled])
        if len(shares) * BLOCK_SECONDS < MIN_CONFIRMATION_SECONDS:
            return 0.0
        mean = shares.mean()
        block_variance = np.array([shares.var()])
        is_selected = np.ones((1, len(shares)), dtype=bool)
        long_run = long_run_variance(
            shares[:, None], is_selected, np.array([[mean]]), block_variance, PRIOR_FREEDOM
        )
        mean_variance = float(long_run.max()) / len(shares)
        return float((1 - 2 * mean) / (2 * max(mean_variance, SMALLEST_VARIANCE)))

    def blocks_since_return(self, balances: Sequence[Array]) -> int:
        """Returns for how many of the last blocks the change has been over: since it was last shown by half.

        Args:
            balances: N balances (a,) of the blocks since the detection.
        """
        shares = self.shown_shares(np.array(balances))
        means = np.convolve(shares, np.full(SMOOTHING_BLOCKS, 1 / SMOOTHING_BLOCKS), "same")
        rows = np.flatnonzero(means >= 0.5)
        last_shown = int(rows[-1]) if len(rows) else 0
        return max(len(shares) - 1 - last_shown, 1)
