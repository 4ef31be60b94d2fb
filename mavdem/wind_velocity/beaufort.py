"""The Beaufort scale, by which the speed of a wind is called known, or known only roughly.

A pilot decides by numbers of this scale: forecasts use them, and makers state with them how much wind a vehicle bears.
The empirical formula of the scale is v = 0.836 B^(3/2) with the speed v in m/s and the number B (WMO-No. 8, Guide to
Instruments and Methods of Observation, vol. I, ch. 5). A number is 0.7 m/s wide at 1 m/s and 2.8 m/s at 10 m/s, so that
the scale is neither absolute nor relative.
"""

from mavdem.confidence import Interval

SPEED_OF_NUMBER_ONE = 0.836
"""Speed of the Beaufort number 1, m/s."""

LIGHT_BREEZE = 3.3
"""Highest speed of a light breeze, the Beaufort number 2, m/s: no flight depends on how far a wind is below it."""

MAX_KNOWN_WIDTH = 1.0
"""Width of the 90 % interval, in Beaufort numbers, up to which a speed is known: as precise as a number states it."""


def beaufort_number(speed: float) -> float:
    """Returns the Beaufort number of a wind speed in m/s, with its fraction: it is rounded to get the usual number."""
    return float((speed / SPEED_OF_NUMBER_ONE) ** (2 / 3))


def is_speed_known(interval: Interval) -> bool:
    """Returns whether the interval of a wind's speed is narrow enough to decide by, or is known only roughly.

    It is if it is no wider than one Beaufort number, or if even its upper end is a light breeze at most.

    Args:
        interval: both ends of the 90 % interval of the speed, m/s.
    """
    low, high = interval
    if high <= LIGHT_BREEZE:
        return True
    return beaufort_number(high) - beaufort_number(low) <= MAX_KNOWN_WIDTH
