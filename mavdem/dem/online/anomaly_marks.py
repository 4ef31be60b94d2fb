"""Marks of unusual samples: where surprise stays above what is usual for this vehicle in this flight."""

from collections import deque

import numpy as np

from mavdem.arrays import Array

MEAN_SECONDS_BETWEEN_FALSE_MARKS = 300.0
"""Mean time between two marks, s, in a flight without a change, manoeuvres included; a choice."""

EVIDENCE_SECONDS = 1.0
"""Time constant of the average of the evidence, s; a choice."""

PEAK_SECONDS = 5.0
"""Length of the intervals whose largest evidence is a peak, s; a choice."""

MAX_PEAKS = round(MEAN_SECONDS_BETWEEN_FALSE_MARKS / PEAK_SECONDS)
"""Number of the latest peaks that the limit is computed from."""

MIN_PEAKS = 3
"""Number of peaks below which there is no limit, and no mark."""

MIN_GUMBEL_SCALE = 0.09
"""Smallest scale of Gumbel's distribution of the peaks, which a few peaks that happen to be equal do not show."""

GUMBEL_MEDIAN_DEVIATION = 0.767
"""Median absolute deviation from the median of Gumbel's distribution of scale 1."""

REFRACTORY_SECONDS = 20.0
"""Time after a mark without another, s: as long as the learner's memory holds samples from before the change."""


class AnomalyMarks:
    """Marks the samples of a stream where the average of log(1 + surprise) exceeds a limit set by its past peaks.

    The evidence is log(1 + surprise), averaged over ``EVIDENCE_SECONDS``: a short manoeuvre gives less than a change
    that lasts, and a failure gives most. The largest evidence of every ``PEAK_SECONDS`` is a peak; peaks are
    characteristic of the vehicle and the flight. A sample is marked where its evidence exceeds the limit that the
    next peak exceeds once in ``MEAN_SECONDS_BETWEEN_FALSE_MARKS``. The limit is a quantile of Gumbel's distribution of
    largest values, whose tail is longer than a normal one, with the median and the median deviation of the peaks.
    """

    def __init__(self, dt: float) -> None:
        """Begins without a past, so that nothing is marked before there are ``MIN_PEAKS`` peaks.

        Args:
            dt: Sampling step, s.
        """
        # Weight of a new value in the exponential average; the times of the constants in samples.
        self._new_value_weight = min(1.0, dt / EVIDENCE_SECONDS)
        self._samples_per_peak = max(1, round(PEAK_SECONDS / dt))
        self._refractory_samples = max(1, round(REFRACTORY_SECONDS / dt))
        self._peaks: deque[float] = deque(maxlen=MAX_PEAKS)
        self._evidence = 0.0
        # Largest evidence since the last interval ended.
        self._current_peak = 0.0
        self._limit = np.inf
        # Numbers of samples so far, and at the last mark.
        self._sample_count = 0
        self._last_marked_sample = -np.inf

    def add(self, surprise: float) -> bool:
        """Adds the surprise of the next sample, and returns whether the sample is marked as an anomaly.

        Args:
            surprise: Drop of the sample's free energy below its recent median, in units of a usual drop (``Surprise``).
                A value that is not finite is ignored; samples soon after a gap have none.

        Returns:
            Whether the evidence, an average of log(1 + surprise), exceeds its limit, and the last marked sample is at
            least ``REFRACTORY_SECONDS`` ago.
        """
        if not np.isfinite(surprise):
            return False
        self._sample_count += 1
        # The evidence is an exponential average of log(1 + surprise). The logarithm limits the weight of a single very
        # large surprise, which would otherwise have the same effect as a lasting change.
        log_surprise = np.log1p(max(surprise, 0.0))
        self._evidence += self._new_value_weight * (log_surprise - self._evidence)
        self._current_peak = max(self._current_peak, self._evidence)
        samples_since_mark = self._sample_count - self._last_marked_sample
        is_marked = self._evidence > self._limit and samples_since_mark >= self._refractory_samples
        if is_marked:
            self._last_marked_sample = self._sample_count
        if self._sample_count % self._samples_per_peak == 0:
            # An interval of PEAK_SECONDS ends here. Its largest evidence is a peak, from which the limit follows. It is
            # cut off at the present limit: otherwise one failure would raise the limit so much that the next one
            # would not be marked.
            self._peaks.append(min(self._current_peak, self._limit))
            self._current_peak = self._evidence
            self._limit = evidence_limit(np.array(self._peaks))
        return bool(is_marked)


def evidence_limit(peaks: Array) -> float:
    """Returns the evidence that the next peak exceeds once in ``MEAN_SECONDS_BETWEEN_FALSE_MARKS``.

    The peaks are assumed to have Gumbel's distribution, whose quantile is x(P) = μ − β log(−log P). The location μ
    follows from the median of the peaks, the scale β from their median deviation. The distance of the limit from the
    median of n peaks is multiplied by √(1 + 1/n), since the median is uncertain.

    Args:
        peaks: (n,) largest evidence of each interval of ``PEAK_SECONDS``.

    Returns:
        The limit, without a unit like the evidence; infinite for fewer peaks than ``MIN_PEAKS``.
    """
    count = len(peaks)
    if count < MIN_PEAKS:
        return np.inf
    median = np.median(peaks)
    # There is a peak every PEAK_SECONDS. In MEAN_SECONDS_BETWEEN_FALSE_MARKS all of them but one are below the limit.
    probability = 1 - PEAK_SECONDS / MEAN_SECONDS_BETWEEN_FALSE_MARKS
    # Distance of the quantile from the median, which is the quantile of P = 1/2, in units of the scale.
    distance = np.log(np.log(2)) - np.log(-np.log(probability))
    median_deviation = np.median(abs(peaks - median))
    scale = max(median_deviation / GUMBEL_MEDIAN_DEVIATION, MIN_GUMBEL_SCALE)
    return median + np.sqrt(1 + 1 / count) * distance * scale
