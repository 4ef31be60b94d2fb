"""Flights in which barometer and satellites disagree about the height, as facts (coded findings).

An estimator follows its barometer, so that the height of a vehicle whose barometer drifts looks steady in flight. The
altitude by satellites shows that one of the two drifts, but not which: receivers of sound vehicles wander by several
metres. That is known after the landing, by the heights at rest (``barometer_drifts``).
"""

from collections.abc import Iterator
from math import inf, isfinite

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.assessment.barometer_drifts import WEATHER_RATE, is_barometer_steady
from mavdem.dataset.intervals import TimeInterval, in_intervals, intersection, true_intervals
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, series_of_boot
from mavdem.facts import Fact, Level
from mavdem.facts.ending import MotionEvent
from mavdem.witnesses.boot_sensors import BootSensors
from mavdem.witnesses.ground_heights import satellite_position
from mavdem.witnesses.height import MEAN_SECONDS, height_comparison, windowed_mean

MIN_DISAGREEMENT = 7.5
"""Difference, m, from which on both heights disagree.

In 44 of 46 real flights the two differed by at most 7.3 m for ``MIN_DISAGREEMENT_SECONDS``. In the other two, by 9 and
15 m, they do disagree, whichever of them is wrong.
"""

MIN_DISAGREEMENT_SECONDS = 5.0
"""Seconds for which they must differ so much: receivers lag in a climb or descent, and jump when satellites change."""

MAX_AGREEMENT = MIN_DISAGREEMENT / 2
"""Difference, m, below which they agree again: a choice, so that noise does not part one disagreement."""

SECONDS_BEFORE_TAKE_OFF = 10.0
"""Seconds before the take-off in which the initial difference is measured; a choice."""

SECONDS_AFTER_TAKE_OFF = 5.0
"""Seconds of a flight in which it is measured if nothing was recorded on the ground; a choice."""


def height_disagreements(sensors: BootSensors, flight_interval: TimeInterval) -> Iterator[Fact]:
    """Yields an event if the height by the barometer and that by satellites disagree in a flight.

    If the heights at rest show that the barometer is right, the altitude by satellites wandered: that is not a fault,
    so that the level of the event is good.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.

    Yields:
        At most one event, as of :func:`disagreement`, with its end.
    """
    take_off, landing = flight_interval
    difference = height_difference(sensors.signals, sensors.boot)
    if difference is None:
        return
    difference_at_take_off = initial_difference(difference, take_off)
    if difference_at_take_off is None:
        return
    event = disagreement(difference, difference_at_take_off, flight_interval)
    if event is None:
        return
    if not event.end_time:
        # It lasted until the landing, or until the last fix.
        last_fix_time = float(difference.time[-1])
        event = event.replace(end_time=min(landing, last_fix_time))
    if is_barometer_steady(sensors, flight_interval):
        event = event.replace(Level.GOOD)
    yield event


def height_difference(signals: Signals, boot: int) -> TimeSeries | None:
    """Returns how much higher the barometer reads than satellites, m, up to a constant: both levels are arbitrary.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.

    Returns:
        The difference (N,) at the receiver's fixes, both averaged over ``MEAN_SECONDS``; None if the barometer is
        missing or not usable, or no receiver had a fix.
    """
    barometer = height_comparison(signals, boot).barometer
    position = series_of_boot(satellite_position(signals), boot)
    if barometer is None or position is None:
        return None
    _, _, altitude = position.values.T
    is_covered = (position.time >= barometer.time[0]) & (position.time <= barometer.time[-1])
    if not is_covered.any():
        return None
    mean_altitude = windowed_mean(position.time, altitude, MEAN_SECONDS)
    barometer_height = np.interp(position.time, barometer.time, barometer.values)
    difference = TimeSeries(position.time, position.boot, barometer_height - mean_altitude)
    return difference.select(is_covered)


def initial_difference(difference: TimeSeries, take_off: float) -> float | None:
    """Returns the difference of both heights at a take-off, m: its median just before, or else just afterwards.

    Args:
        difference: how much higher the barometer reads (N,), m.
        take_off: start of the flight, s since boot; minus infinity if it was not recorded.

    Returns:
        The difference; None if it was not recorded at that time.
    """
    start = take_off if isfinite(take_off) else float(difference.time[0])
    interval_before = (start - SECONDS_BEFORE_TAKE_OFF, start)
    interval_after = (start, start + SECONDS_AFTER_TAKE_OFF)
    for interval in (interval_before, interval_after):
        differences = difference.values[in_intervals(difference.time, [interval])]
        if len(differences) > 1:
            return float(np.median(differences))
    return None


def disagreement(
    difference: TimeSeries,
    initial: float,
    flight_interval: TimeInterval,
    *,
    has_begun_before: bool = False,
) -> Fact | None:
    """Returns the event that the heights by barometer and by satellites disagree in a flight, or in its latest part.

    They begin to disagree if their difference changes by ``MIN_DISAGREEMENT`` for ``MIN_DISAGREEMENT_SECONDS``, and
    agree again once the change is less than ``MAX_AGREEMENT``. One of them began to drift earlier; a line through the
    differences before shows when.

    Args:
        difference: how much higher the barometer reads (N,), m.
        initial: the difference at take-off, m.
        flight_interval: start and end of the flight, s since boot.
        has_begun_before: whether they disagreed just before these samples, so that a difference of ``MAX_AGREEMENT``
            is enough to go on disagreeing.

    Returns:
        The latest such event, which begins with the drift, with the largest change of the difference since take-off as
        ``height``, m, positive where the barometer reads more. It has no end if the heights still disagree. None if
        they agree.
    """
    take_off, _ = flight_interval
    is_in_flight = in_intervals(difference.time, [flight_interval])
    times = difference.time[is_in_flight]
    changes = difference.values[is_in_flight] - initial
    first_time = take_off if isfinite(take_off) else float(difference.time[0])
    weather_change = WEATHER_RATE * (times - first_time)
    disagreements = true_intervals(times, abs(changes) >= MAX_AGREEMENT + weather_change)
    if not has_begun_before:
        # Of these intervals only those count in which the difference was large for long.
        large_intervals = true_intervals(times, abs(changes) >= MIN_DISAGREEMENT + weather_change)
        lasting_intervals = [interval for interval in large_intervals if _lasts(interval, times)]
        disagreements = [
            interval for interval in disagreements if intersection([interval], lasting_intervals)
        ]
    if not disagreements:
        return None
    start, end = disagreements[-1]
    do_disagree = in_intervals(times, [(start, end)])
    changes_of_latest = changes[do_disagree]
    return Fact(
        MotionEvent.HEIGHTS_DISAGREE,
        time=_drift_start(times, changes, do_disagree),
        end_time=None if end == inf else end,
        height=float(changes_of_latest[abs(changes_of_latest).argmax()]),
        boot=int(difference.boot[0]),
    )


def _drift_start(times: Array, changes: Array, do_disagree: Flags) -> float:
    """Estimates when the difference of both heights began to grow, as if it had grown at a constant rate from 0.

    The samples of a disagreement begin when the difference has grown to half of ``MIN_DISAGREEMENT``. At a constant
    rate this first half took as long as the second half, which the samples show. So the growth began as long before. It
    cannot have begun before the difference last had the other sign.

    Args:
        times: (N,) times of the differences, s.
        changes: (N,) change of the difference since the take-off, m.
        do_disagree: (N,) whether a sample belongs to the disagreement; at least one does.

    Returns:
        The time, s; not before the first sample.
    """
    first_disagreement = int(np.argmax(do_disagree))
    disagreement_start = float(times[first_disagreement])
    is_large = do_disagree & (abs(changes) >= MIN_DISAGREEMENT)
    growth_seconds = 0.0
    if is_large.any():
        first_large_time = float(times[np.argmax(is_large)])
        growth_seconds = first_large_time - disagreement_start
    is_before = times < disagreement_start
    has_other_sign = np.sign(changes) != np.sign(changes[first_disagreement])
    times_of_other_sign = times[is_before & has_other_sign]
    earliest_start = times_of_other_sign[-1] if len(times_of_other_sign) else times[0]
    return max(disagreement_start - growth_seconds, float(earliest_start))


def _lasts(interval: TimeInterval, times: Array) -> bool:
    """Returns whether an interval lasts ``MIN_DISAGREEMENT_SECONDS`` or longer, as far as there are samples.

    Args:
        interval: start and end, s since boot; infinite if it reaches an end of the record.
        times: (N,) times of all samples, s since boot.
    """
    start, end = interval
    duration = min(end, float(times[-1])) - max(start, float(times[0]))
    return duration >= MIN_DISAGREEMENT_SECONDS
