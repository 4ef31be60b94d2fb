"""Surprise of each sample, and Marks of what is unusual by it, at a stated rate of false ones."""

from __future__ import annotations

from collections import deque

import numpy as np
from scipy.stats import t as student

SECONDS = 10.0  # of F(t), by which the next value is standardised
LOW_QUANTILE = 0.05  # its distance from the median is the unit of surprise
MAX_QUARTILES = 3.0
"""Of the unit, in distances of the lower quartile from the median. Of normal values it is 2.4; larger ones come of a
failure that lasts, which must not hide the next."""
MIN_UNIT = 1e-6  # nats; values of F(t) that differ by less are the same but for rounding
MIN_PAST = 100  # values before a surprise is reported

FALSE_MARK_SECONDS = 300.0
"""Mean time between marks in a flight that goes on as before, manoeuvres included."""
EVIDENCE_SECONDS = 1.0
PEAK_SECONDS = 5.0
PEAKS = 24  # the latest that the limit is computed of: two minutes
MIN_PEAKS = 3
MIN_SPREAD = 0.12  # standard deviation of peaks, which a few that happen to be equal do not show
REFRACTORY_SECONDS = 20.0  # of no other mark: as long as the learner's memory holds what came before the change


class Surprise:
    """Standardises F(t) by the median and the low quantile of its past.

    Not by a standard deviation: F(t) has a long lower tail, and one gust would hide the next.
    """

    def __init__(self, dt: float) -> None:
        """Begins without a past, of values every ``dt`` s."""
        self._past: deque[float] = deque(maxlen=max(round(SECONDS / dt), 2 * MIN_PAST))
        self._median, self._unit = np.nan, np.nan

    def add(self, value: float) -> float:
        """Takes the next value; returns its distance below the median, in units of the low quantile's."""
        self._past.append(value)
        return (self._median - value) / self._unit

    def update_quantiles(self) -> None:
        """Computes the quantiles again; done once a block, since it takes the whole past."""
        if len(self._past) >= MIN_PAST:
            low, quartile, self._median = np.quantile(self._past, [LOW_QUANTILE, 0.25, 0.5])
            unit = min(self._median - low, MAX_QUARTILES * (self._median - quartile))
            self._unit = max(unit, MIN_UNIT)


class Marks:
    """Which samples to mark: where surprise stays above what is usual for this vehicle in this flight.

    The evidence is log(1 + surprise), averaged over ``EVIDENCE_SECONDS``: a short manoeuvre gives less than a change
    that lasts, and a failure more than all. Its largest values in every ``PEAK_SECONDS`` are the vehicle's own. The
    limit is what the next of them exceeds once in ``FALSE_MARK_SECONDS``: by Student's t about their median, in units
    of their median deviation, so that few peaks give a high limit and none gives no mark.
    """

    def __init__(self, dt: float) -> None:
        """Begins without a past, of samples every ``dt`` s."""
        self._share = min(1.0, dt / EVIDENCE_SECONDS)
        self._block, self._rest = (max(1, round(seconds / dt)) for seconds in (PEAK_SECONDS, REFRACTORY_SECONDS))
        self._peaks: deque[float] = deque(maxlen=PEAKS)
        self._evidence, self._peak, self._limit = 0.0, 0.0, np.inf
        self._samples, self._marked = 0, -np.inf

    def add(self, surprise: float) -> bool:
        """Takes a sample's surprise; returns whether to mark it, at most once in ``REFRACTORY_SECONDS``.

        A surprise that is not finite, beside a gap, is ignored.
        """
        if not np.isfinite(surprise):
            return False
        self._samples += 1
        self._evidence += self._share * (np.log1p(max(surprise, 0.0)) - self._evidence)
        self._peak = max(self._peak, self._evidence)
        mark = self._evidence > self._limit and self._samples - self._marked >= self._rest
        if mark:
            self._marked = self._samples
        if self._samples % self._block == 0:
            # A mark counts as the limit, whatever its size: one failure must not hide the next.
            self._peaks.append(min(self._peak, self._limit))
            self._peak = self._evidence
            self._limit = _limit(np.array(self._peaks))
        return bool(mark)


def _limit(peaks: np.typing.NDArray[np.float64]) -> float:
    number = len(peaks)
    if number < MIN_PEAKS:
        return np.inf
    middle = np.median(peaks)
    spread = max(1.4826 * float(np.median(np.abs(peaks - middle))), MIN_SPREAD)
    far = student.ppf(1 - PEAK_SECONDS / FALSE_MARK_SECONDS, number - 1) * np.sqrt(1 + 1 / number)
    return float(middle + far * spread)
