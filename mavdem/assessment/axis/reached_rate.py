"""Whether the body rate of an axis reaches its setpoint in long turns, and whether motors prevent it.

A rate loop with too little gain, and motors without more torque about an axis, both leave the rate below its setpoint.
The outputs of the motors tell the two apart.
"""

from typing import NamedTuple

import numpy as np

from mavdem.arrays import Flags
from mavdem.dataset.quality import samples_at_limits
from mavdem.dataset.segments import Segment, Segments, in_segments
from mavdem.dataset.signals import MIN_SLOW_MOTION_RATE, Signals, rate_between_outages
from mavdem.dataset.time_series import TimeSeries

MIN_TURN_RATE = np.radians(45.0)
"""Least setpoint of the rate in a turn, rad/s.

Smaller setpoints mostly answer the wind: of ten flights that only held their heading the setpoints reach 16 to 40 °/s,
and the rates 0.3 to 0.5 of these.
"""

MIN_TURN_SECONDS = 0.5
"""Shortest turn, s: a doublet is over before the rate has risen."""

RISE_SECONDS = 0.5
"""Time after the end of a turn's setpoint in which its largest rate may still come, s: a yaw loop rises as slowly."""

MIN_REACHED_FRACTION = 0.8
"""Least fraction of the setpoint that a sound axis reaches: 0.88 to 1.1 in good flights, at most 0.71 in others."""


class ReachedRate(NamedTuple):
    """The largest rates of a flight's median turn about one axis."""

    setpoint: float
    """Largest setpoint of the rate, rad/s."""
    rate: float
    """Largest rate, rad/s."""
    at_limit_share: float | None
    """Fraction of the turns' time with a motor at a limit; None if no motor outputs were recorded in them."""

    @property
    def share(self) -> float:
        """The rate over its setpoint."""
        return self.rate / self.setpoint

    @property
    def falls_short(self) -> bool:
        """Whether the rate does not reach its setpoint."""
        return self.share < MIN_REACHED_FRACTION


class _Turn(NamedTuple):
    """One turn about an axis."""

    segment: Segment
    """The time of its setpoint."""
    rates: ReachedRate
    """Its largest rates, without the fraction of motors at a limit."""


def reached_rate(signals: Signals, segments: Segments) -> ReachedRate | None:
    """Returns the largest rate and setpoint in a typical turn of a flight, and how long motors were at a limit.

    In a turn about the axis of ``signals`` the setpoint has one sign and exceeds half of the largest setpoint of the
    flight (:func:`_find_turns`). The typical turn is the median one by the fraction of its setpoint that the rate
    reaches.

    Args:
        signals: logged time series of the vehicle, with angle, rate and setpoints of the axis.
        segments: segments of the flight that are judged.

    Returns:
        The largest rate and setpoint of that turn, with the fraction of the time of all turns in which a motor was at a
        limit; None without turns, or if messages are too slow.
    """
    if signals.rate_and_setpoint is None:
        return None
    rate, setpoint = signals.rate_and_setpoint
    if min(rate_between_outages(rate), rate_between_outages(setpoint)) < MIN_SLOW_MOTION_RATE:
        return None
    turns = _find_turns(rate, setpoint, segments)
    if not turns:
        return None
    turns.sort(key=lambda turn: turn.rates.share)
    median_turn = turns[len(turns) // 2]
    at_limit_share = _fraction_of_time_at_limit(signals, [turn.segment for turn in turns])
    return median_turn.rates._replace(at_limit_share=at_limit_share)


def _find_turns(rate: TimeSeries, setpoint: TimeSeries, segments: Segments) -> list[_Turn]:
    """Finds the turns of a flight about one axis, with the largest rate and setpoint of each.

    A turn lasts as long as the setpoint exceeds half of its largest value in the flight, in one direction. Short turns
    are left out (:func:`_long_intervals`). The rate of a turn may be reached up to ``RISE_SECONDS`` later.

    Args:
        rate: body rate, rad/s.
        setpoint: setpoint of the body rate, rad/s.
        segments: segments of the flight that are judged.

    Returns:
        The turns, those in positive direction first; empty if no setpoint reaches ``MIN_TURN_RATE``.
    """
    is_judged = np.zeros(len(setpoint.time), dtype=bool)
    for segment in segments:
        is_judged |= in_segments(setpoint, segment, slack=0)
    largest_setpoint = abs(setpoint.values[is_judged]).max(initial=0.0)
    if largest_setpoint < MIN_TURN_RATE:
        return []
    turns = []
    for direction in (1.0, -1.0):
        is_turning = is_judged & (direction * setpoint.values > largest_setpoint / 2)
        for segment in _long_intervals(setpoint, is_turning):
            segment_with_rise = Segment(segment.boot, segment.start, segment.end + RISE_SECONDS)
            # Rates and setpoints of the turn, positive in its direction.
            rates = direction * rate.values[in_segments(rate, segment_with_rise)]
            if not rates.size:
                continue
            setpoints = direction * setpoint.values[in_segments(setpoint, segment)]
            # A rate in the other direction reaches nothing of the setpoint.
            largest_rate = max(rates.max(), 0.0)
            reached = ReachedRate(setpoints.max(), largest_rate, at_limit_share=None)
            turns.append(_Turn(segment, reached))
    return turns


def _long_intervals(series: TimeSeries, is_selected: Flags) -> list[Segment]:
    """Finds the intervals in which all samples of a series are selected, for at least ``MIN_TURN_SECONDS``.

    Args:
        series: N samples.
        is_selected: (N,) whether a sample is selected.

    Returns:
        The intervals, in time order, each within one boot.
    """
    # An unselected sample is added at each end, so that every run of selected samples has a first one and an end. The
    # flags change at both, which makes a pair of changes for each run.
    padded_flags = np.concatenate([[False], is_selected, [False]])
    changes = np.flatnonzero(np.diff(padded_flags))
    intervals = []
    for first_sample, end_sample in changes.reshape(-1, 2):
        last_sample = end_sample - 1
        boot = int(series.boot[first_sample])
        start = series.time[first_sample]
        end = series.time[last_sample]
        # The clock of another boot begins again.
        is_one_boot = boot == series.boot[last_sample]
        if is_one_boot and end - start >= MIN_TURN_SECONDS:
            intervals.append(Segment(boot, start, end))
    return intervals


def _fraction_of_time_at_limit(signals: Signals, turns: list[Segment]) -> float | None:
    """Returns the fraction of the time of turns in which some motor is at its upper or lower limit.

    Args:
        signals: signals of the vehicle, with the outputs of its motors.
        turns: times of the turns.

    Returns:
        Fraction of the samples of the motor outputs; None if there are no samples in the turns.
    """
    motors = signals.motors
    if motors is None:
        return None
    is_in_turn = np.zeros(len(motors.time), dtype=bool)
    for turn in turns:
        is_in_turn |= in_segments(motors, turn)
    if not is_in_turn.any():
        return None
    fractions = motors.scale.fraction(motors.outputs[is_in_turn])
    is_at_upper, is_at_lower = samples_at_limits(fractions, motors.scale)
    return float(np.mean((is_at_upper | is_at_lower).any(axis=1)))
