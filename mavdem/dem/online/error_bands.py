"""Bands of predictions from their latest errors: the half width that contains the next error with 90 % probability.

The next error is below the k-th smallest of n independent errors with probability k / (n + 1). Errors of predictions
h steps ahead are not independent: each is a sum of the innovations of h steps, and errors j steps apart have h − j of
these in common. The squares of such sums have the correlation (1 − j/h)², so that

    1 + 2 Σⱼ (1 − j/h)² = (2 h² + 1) / (3 h),    j = 1 … h − 1,

consecutive errors count as one independent error. With fewer than nine independent errors no band has 90 %.
"""

from collections.abc import Sequence

import numpy as np

from mavdem.arrays import Array
from mavdem.confidence import CONFIDENCE_LEVEL, MIN_SAMPLES_FOR_STATISTICS

BAND_SECONDS = 6.0
"""Length of the errors that are kept, s; a choice.

Fewer give no steady quantile. A change of the vehicle widens the bands for this long.
"""

MIN_ERRORS = 100
"""Number of errors that are kept at least, however long the sampling step is; a choice."""

MAX_MEDIANS = 12.0
"""Largest half width of a band, in medians of the errors' sizes.

For normal errors the 90 % quantile is 2.4 medians; where manoeuvres alternate with hover it reaches 12. A failure would
give hundreds, by errors that the next fitted model does not make.
"""


class ErrorBands:
    """Half widths of the 90 % bands of online predictions: of a sample from the samples before it, and at each horizon.

    Large and small errors are kept for the same time, so bands recover as soon as the predictions have.

    Attributes:
        half_widths: (1 + H, m) half widths in the units of the outputs: row 0 of the prediction of a sample from the
            samples before it, the others at each horizon; NaN where there are too few errors.
    """

    def __init__(self, horizons: Sequence[int], outputs: int, dt: float) -> None:
        """Begins without errors.

        Args:
            horizons: Steps ahead of the predictions, H of them.
            outputs: Number of outputs, m.
            dt: Sampling step, s.
        """
        capacity = max(round(BAND_SECONDS / dt), MIN_ERRORS)
        # Ring buffer over the last axis; NaN where there is no error. Row 0 has the errors of predictions from the
        # samples before, the other rows at each horizon.
        self._errors = np.full((1 + len(horizons), outputs, capacity), np.nan)
        self._next_slot = 0
        self.half_widths = np.full((1 + len(horizons), outputs), np.nan)
        # Number of consecutive errors that count as one independent error (1 + H, 1, 1), in each row.
        steps_ahead = np.array([1, *horizons], dtype=float)
        self._errors_per_independent = _errors_per_independent_one(steps_ahead)[:, None, None]

    def add(self, one_step_error: Array, horizon_errors: Array) -> None:
        """Adds the errors of the predictions of one sample; those that are not finite are ignored.

        Args:
            one_step_error: (m,) error of the sample's prediction from the samples before it.
            horizon_errors: (H, m) errors of the sample's predictions at each horizon.
        """
        self._errors[0, :, self._next_slot] = one_step_error
        self._errors[1:, :, self._next_slot] = horizon_errors
        # The buffer is a ring: after its last slot the oldest errors, in the first slot, are overwritten.
        _, _, capacity = self._errors.shape
        self._next_slot = (self._next_slot + 1) % capacity

    def update(self) -> None:
        """Computes the half widths from the errors of the last ``BAND_SECONDS``.

        The next error is smaller than the half width with a probability of 90 %. This follows from the order statistics
        of the errors, without an assumption about their distribution. A half width is at most ``MAX_MEDIANS`` times the
        median size of the errors, and NaN for too few independent errors. This function sorts all errors, and is
        therefore called once for each block of samples.
        """
        # Sorting puts infinity and NaN last, so that the first ``count`` sizes are the finite ones. Sizes have the
        # shape (1 + H, m, capacity), counts and quantiles (1 + H, m, 1).
        sizes = np.sort(abs(self._errors))
        count = np.isfinite(sizes).sum(axis=-1, keepdims=True)
        # Of n independent errors it is the CONFIDENCE_LEVEL · (n + 1)-th smallest. Of the more numerous errors that
        # overlap, each stands for a fraction of one.
        independent_count = count / self._errors_per_independent
        independent_rank = CONFIDENCE_LEVEL * (independent_count + 1)
        rank = np.ceil(independent_rank * self._errors_per_independent).astype(int)
        index_of_quantile = np.clip(rank, 1, np.maximum(count, 1)) - 1
        quantile = np.take_along_axis(sizes, index_of_quantile, axis=-1)
        median = np.take_along_axis(sizes, count // 2, axis=-1)
        half_widths = np.minimum(quantile, MAX_MEDIANS * median)
        has_enough_errors = (count >= MIN_SAMPLES_FOR_STATISTICS) & (rank <= count)
        self.half_widths = np.where(has_enough_errors, half_widths, np.nan)[:, :, 0]


def _errors_per_independent_one(steps_ahead: Array) -> Array:
    """Returns how many errors in a row tell as much as one independent error.

    The head of this file derives it: 1 one step ahead, and about 7 ten steps ahead.

    Args:
        steps_ahead: (N,) steps h ahead of which the predictions are made.

    Returns:
        (N,) numbers of errors.
    """
    return (2 * steps_ahead**2 + 1) / (3 * steps_ahead)
