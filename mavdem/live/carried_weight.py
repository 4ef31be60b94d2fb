"""Do the motors of a flying vehicle carry its weight? Their mean command, compared with that of the flight so far."""

from math import inf, nan

from mavdem.motors.balance import MAX_GAP

MEMORY_SECONDS = 8.0
"""Time constant of the mean command of the flight so far, s: longer than a descent takes to begin; a choice."""

MIN_WEIGHT_FRACTION = 0.75
"""Least mean command that carries the weight, as a fraction of that of the flight so far.

Thrust grows at least in proportion to the command (``THRUST_EXPONENTS``). So a free vehicle would fall with a quarter
of gravity or more, 2.5 m/s². A level flight after one at a lean of 40°, which needs more thrust, is above it.
"""


class CarriedWeight:
    """Judges, sample by sample, whether the motors carry a vehicle's weight, or the ground may carry a part of it.

    An autopilot may report a flight for some seconds after the touch-down. The motors then run down one after the
    other, so that their commands show nothing about their thrust.
    """

    def __init__(self) -> None:
        """Begins without a sample."""
        # Mean command while the motors carried the weight, as a fraction of the range, and the time of its last sample.
        self._flight_command = nan
        self._latest_time = -inf

    def is_carried(self, time: float, mean_command: float) -> bool:
        """Returns whether the motors carry the weight at the time of a sample; False if the ground may carry a part.

        They do while their mean command is at least ``MIN_WEIGHT_FRACTION`` of that of the flight so far. A vehicle
        that stays in the air for ``MAX_GAP`` with less thrust has become lighter, as after it has dropped its load.
        Then, and after a gap of the samples, the comparison begins anew.

        Args:
            time: time of the sample, s of the boot clock.
            mean_command: mean command of the motors, as a fraction of their range.
        """
        step = time - self._latest_time
        is_continued = 0 <= step < MAX_GAP
        if not is_continued:
            self._flight_command = mean_command
            self._latest_time = time
            return True
        if mean_command < MIN_WEIGHT_FRACTION * self._flight_command:
            return False
        self._flight_command += step / MEMORY_SECONDS * (mean_command - self._flight_command)
        self._latest_time = time
        return True
