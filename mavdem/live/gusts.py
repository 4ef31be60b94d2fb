"""Wind torque of a live flight: it is shown where it exceeds its error, and gusts in it are reported once each."""

from collections import deque

import numpy as np

from mavdem.dem import Estimate
from mavdem.dem.record import Record
from mavdem.facts import Fact, Facts
from mavdem.facts.session import SessionFact
from mavdem.plant.gusts import RUNNING_LEVEL_SECONDS, detect_gusts, min_gust_duration
from mavdem.plant.online_wind_torque import MEMORY_SECONDS, is_torque_resolved

SEARCH_PERIOD = 1.0
"""Time between two searches for gusts, s: a choice."""


BAND_SECONDS = 5.0
"""Time constant over which the error of the torque is averaged, s: a choice, so that no single sample decides."""


class ResolvedTorque:
    """Leaves out the estimated wind torque while it is smaller than its error, as reports of logs do.

    Such a torque may be nothing but the error of the motors' estimated effect.
    """

    def __init__(self, dt: float) -> None:
        """Prepares the detection of gusts, before the first estimate of the wind torque.

        Args:
            dt: step between samples, s.
        """
        self._weight = 1 - np.exp(-dt / BAND_SECONDS)
        # Moving average of the squared half width of the torque's band, (rad/s²)²; NaN before the first estimate.
        self._mean_square_band = np.nan

    def resolved(self, estimate: Estimate) -> Estimate:
        """Returns an estimate without its wind torque if that is smaller than its error.

        The error is the root mean square of the half width of the torque's 90 % band, an exponential moving average
        over the recent estimates. The band stays in the estimate, since it shows why there is no torque.

        Args:
            estimate: estimate for the latest sample; estimates must come in order, since their bands are averaged.

        Returns:
            The estimate; its torque is NaN if it was smaller than the error.
        """
        if estimate.physical is None or not np.isfinite(estimate.wind_torque):
            return estimate
        squared_band = estimate.wind_torque_band**2
        if np.isnan(self._mean_square_band):
            # The first band is its own mean.
            self._mean_square_band = squared_band
        self._mean_square_band += self._weight * (squared_band - self._mean_square_band)
        rms_band = float(np.sqrt(self._mean_square_band))
        if is_torque_resolved(estimate.physical, rms_band):
            return estimate
        return estimate._replace(wind_torque=np.nan)


class GustDetector:
    """Finds gusts in the wind torque of the last minute, rad/s², as estimates of it come."""

    def __init__(self, dt: float) -> None:
        """Begins without a sample; ``dt`` is the step between samples, s."""
        self._dt = dt
        # Time, s, wind torque and half width of its band, rad/s².
        self._torques: deque[tuple[float, float, float]] = deque(maxlen=round(MEMORY_SECONDS / dt))
        self._search_time = -np.inf

    def add(self, estimate: Estimate) -> Facts:
        """Adds an estimate, and returns the gusts that have ended since the last search.

        Gusts stand out from a running median (``detect_gusts``), so the search begins once the torque is known for two
        of its widths, and is repeated every ``SEARCH_PERIOD`` on the last minute. If the torque is unknown, as for a
        while after a motor has changed, the earlier torque is forgotten: it is no level that later torques could be
        compared with.

        Args:
            estimate: estimate of the latest sample. Its wind torque, rad/s², is that at ``wind_time``, s of the boot
                clock, which is some time ago, since it is smoothed.

        Returns:
            One fact for each gust, with its beginning, s of the boot clock, duration and size.
        """
        if not np.isfinite(estimate.wind_torque):
            self._torques.clear()
            return ()
        self._torques.append((estimate.wind_time, estimate.wind_torque, estimate.wind_torque_band))
        is_long_enough = len(self._torques) * self._dt >= 2 * RUNNING_LEVEL_SECONDS
        is_search_due = estimate.wind_time >= self._search_time + SEARCH_PERIOD
        if not is_long_enough or not is_search_due:
            return ()
        former_search_time = self._search_time
        self._search_time = estimate.wind_time
        return self._ended_gusts(estimate, former_search_time)

    def _ended_gusts(self, estimate: Estimate, former_search_time: float) -> Facts:
        """Searches the last minute for gusts, and returns those that have ended since the former search.

        Args:
            estimate: the latest estimate, whose physical parameters bound how short a gust can be.
            former_search_time: time of the latest torque in the former search, s of the boot clock.

        Returns:
            A fact for each gust, with its beginning (``clock``, s of the boot clock), its ``duration``, s, and as
            ``torque`` the largest distance of the wind torque from its running level, rad/s².
        """
        # Arrays (N,): times, s of the boot clock, wind torques and half widths of their bands, rad/s².
        time, torque, band = np.array(self._torques).T
        min_duration = 0.0
        if estimate.physical is not None:
            min_duration = min_gust_duration(estimate.physical, self._dt)
        # The search needs a record only for its time step and for the length of its single segment. The inputs and
        # outputs of the record are not used, so that the torque stands for both.
        column = torque[:, None]
        record = Record(column, column, self._dt, (len(torque),))
        facts = []
        for gust in detect_gusts(torque, band, record, min_duration).gusts:
            start_time = time[gust.sample]
            # A gust that ended before the last search was reported then; one that reaches the latest sample may go on.
            if former_search_time < start_time + gust.length < time[-1]:
                facts.append(
                    Fact(
                        SessionFact.GUST_FELT,
                        clock=start_time,
                        torque=gust.size,
                        duration=gust.length,
                    )
                )
        return tuple(facts)
