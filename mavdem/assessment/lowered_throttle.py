"""The fact (coded finding) that the pilot's throttle let a vehicle sink until it hit the ground."""

from math import inf

import numpy as np

from mavdem.dataset.flight_states import MANUAL_THROTTLE_MODES, mode_intervals
from mavdem.dataset.intervals import in_intervals, intersection, true_intervals
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import series_of_boot
from mavdem.facts import Fact
from mavdem.facts.ending import FailedFirst
from mavdem.witnesses.sensors import throttle_stick

USUAL_SECONDS = 10.0
"""Seconds before a descent in which the median of the stick is its usual position: a hover, or slow flight."""

DESCENT_SECONDS = 5.0
"""Longest time, s, from when the throttle is lowered to the impact: a vehicle falls 30 m and more in that time."""

LOWERED_TRAVEL = 0.2
"""Travel of the stick below its usual position that counts as lowered; a choice. A hover takes 0.3 to 0.7 of the
travel, so that the thrust is then about two thirds of the weight, and the vehicle sinks at 3 m/s after a second."""

LOWERED_SECONDS = 0.5
"""Time, s, for which the stick must be that low: a shorter movement only brakes a climb."""


def lowered_throttle(signals: Signals, boot: int, onset: float) -> Fact | None:
    """Returns the fact that the pilot lowered the throttle before an impact; None if the stick does not show it.

    Only flight modes are examined in which the stick sets the thrust; in others the autopilot limits the descent. The
    pilot may have opened the throttle again, but too late.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        onset: time when the vehicle hit the ground, or lost its attitude just before, s since boot.

    Returns:
        A fact with the time at which the throttle was lowered, and the lowest travel as the figure ``share``.
    """
    stick = series_of_boot(throttle_stick(signals), boot)
    if stick is None:
        return None
    descent_start = onset - DESCENT_SECONDS
    is_usual = in_intervals(stick.time, [(descent_start - USUAL_SECONDS, descent_start)])
    if not is_usual.any():
        return None
    usual_travel = float(np.median(stick.values[is_usual]))
    lowered_intervals = true_intervals(stick.time, stick.values < usual_travel - LOWERED_TRAVEL)
    manual_intervals = mode_intervals(signals, boot, MANUAL_THROTTLE_MODES)
    manual_before_impact = intersection(manual_intervals, [(-inf, onset)])
    lowered_before_impact = intersection(lowered_intervals, manual_before_impact)
    # The latest movement is the cause, since a pilot who descends in steps lowers the throttle several times.
    for start, end in reversed(lowered_before_impact):
        if start < descent_start:
            return None
        if end - start >= LOWERED_SECONDS:
            travel = stick.values[in_intervals(stick.time, [(start, end)])]
            return Fact(
                FailedFirst.THROTTLE_LOWERED_FIRST,
                time=start,
                end_time=min(end, onset),
                share=float(travel.min()),
            )
    return None
