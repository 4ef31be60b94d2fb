"""Losses of the horizontal position in flight, as facts (coded findings): the estimator had one, then none for long.

Without a position an autopilot can only descend where the wind carries it. What its estimator reports of itself counts:
PX4's validity flags of vehicle_local_position, or the flags of the estimator status of both autopilots.
"""

from collections.abc import Iterator, Sequence

from mavdem.dataset.intervals import TimeInterval, in_intervals, true_intervals
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.witnesses import SensorFact
from mavdem.witnesses.boot_sensors import BootSensors
from mavdem.witnesses.sensor_facts import supporting_fact

MIN_LOST_SECONDS = 5.0
"""Seconds without a position from which on that is an event: autopilots bridge shorter gaps by inertia."""

MIN_SECONDS_WITH_POSITION = 5.0
"""Seconds of the flight, in all, with a position before a loss: a vehicle that never had one cannot lose it. A choice.
"""

MODES_WITHOUT_POSITION = frozenset({"Land", "Descend", "Alt hold", "Altitude"})
"""Modes that need no position, to which autopilots change when they have lost it."""

FAILSAFE_REPORTS = (ReportedEvent.FAILSAFE, ReportedEvent.ESTIMATOR_DIVERGED)
"""Reports of the autopilot that support a lost position."""

REACTION_SECONDS = 3.0
"""Seconds by which the reaction of the autopilot may come before the estimator reports the loss; a choice."""


def position_losses(
    sensors: BootSensors, flight_interval: TimeInterval, reports: Sequence[Fact] = ()
) -> Iterator[Fact]:
    """Yields an event for each time in a flight in which the estimator lost the horizontal position for long.

    If the log does not show the estimator's position, the position counts as lost while no GPS receiver has a fix. The
    loss is bad if the autopilot reacted, by a failsafe or a mode without position; otherwise it is to be watched.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        flight_interval: start and end of the flight, s since boot.
        reports: events that the autopilot reports.

    Yields:
        Events with start, end and duration of the loss within the flight, s, and ``witnesses``: what sensors and the
        autopilot show. Where the position did not come back at all, the event has the figure ``is_permanent``.
    """
    # Whether the estimator has a position, and whether one of the GPS receivers has a fix, over time.
    validity = sensors.trust.position.validity
    fix = sensors.trust.position.fix
    has_position = fix if validity is None else validity
    if has_position is None:
        return
    for start, end in _long_losses(has_position, flight_interval):
        reactions = _autopilot_reactions(sensors, (start, end), reports)
        # A position that never came back has no end: a landing does not end its loss.
        came_back = bool(has_position.values[has_position.time > start].any())
        known_end = end if came_back else None
        invalid: Facts = ()
        if validity is not None:
            position_invalid = supporting_fact(
                SensorFact.POSITION_INVALID, time=start, end_time=known_end, duration=end - start
            )
            invalid = (position_invalid,)
        loss = Fact(
            MotionEvent.POSITION_LOST,
            Level.BAD if reactions else Level.WATCH,
            time=start,
            end_time=end,
            duration=end - start,
            boot=sensors.boot,
            witnesses=(*invalid, *reactions, *_missing_fix(fix, (start, end), known_end)),
        )
        yield loss if came_back else loss.replace(is_permanent=True)


def _long_losses(has_position: TimeSeries, flight_interval: TimeInterval) -> Iterator[TimeInterval]:
    """Yields the intervals of a flight, s since boot, in which a position that had been there was missing for long.

    Args:
        has_position: whether there was a position (N,), 1 or 0.
        flight_interval: start and end of the flight, s since boot.
    """
    flags = has_position.select(in_intervals(has_position.time, [flight_interval]))
    if not len(flags.time):
        return
    record_start, record_end = float(flags.time[0]), float(flags.time[-1])
    # Flags may flicker before a loss, so that all the time with a position is added up, not only that just before.
    seconds_with_position = 0.0
    end_of_last_loss = record_start
    for interval_start, interval_end in true_intervals(flags.time, flags.values == 0):
        # Intervals at the ends of the record are infinite.
        start = max(interval_start, record_start)
        end = min(interval_end, record_end)
        seconds_with_position += start - end_of_last_loss
        end_of_last_loss = end
        had_position = seconds_with_position >= MIN_SECONDS_WITH_POSITION
        if had_position and end - start >= MIN_LOST_SECONDS:
            yield start, end


def _autopilot_reactions(
    sensors: BootSensors, interval: TimeInterval, reports: Sequence[Fact]
) -> Facts:
    """Returns the reactions of the autopilot to a lost position: failsafes, and changes to modes that need no position.

    Args:
        sensors: sensors of the boot, with the changes of the flight mode.
        interval: start and end of the time without a position, s since boot.
        reports: events that the autopilot reports, of all boots.

    Returns:
        A fact for each reaction, which supports that the position was lost: ``AUTOPILOT_REPORTED`` with the report of
        a failsafe as its cause, or ``MODE_CHANGED`` with name and time of the new mode.
    """
    loss_time, end = interval
    # The estimator may report the loss later than the autopilot reacts to it.
    start = loss_time - REACTION_SECONDS
    reactions = []
    for report in reports:
        is_of_boot = report.figures["boot"] == sensors.boot
        if is_of_boot and _is_reaction(report) and start <= report.start_time <= end:
            reactions.append(supporting_fact(SensorFact.AUTOPILOT_REPORTED, cause=report))
    for time, name in sensors.signals.mode_changes(sensors.boot):
        if start <= time <= end and name in MODES_WITHOUT_POSITION:
            reactions.append(supporting_fact(SensorFact.MODE_CHANGED, name=name, time=time))
    return tuple(reactions)


def _is_reaction(report: Fact) -> bool:
    """Returns whether a report says that the autopilot acted on a lost position.

    ``GPS_LOST`` is such a report only if the autopilot itself sent it, as an error code or a text. If it was derived
    from the receiver's messages, it is the same fact as ``NO_FIX``, and does not count a second time.

    Args:
        report: event that the autopilot reported, or that was derived from messages.
    """
    if report.code is ReportedEvent.GPS_LOST:
        return "error_code" in report.figures or "text" in report.figures
    return report.code in FAILSAFE_REPORTS


def _missing_fix(fix: TimeSeries | None, interval: TimeInterval, known_end: float | None) -> Facts:
    """Returns the fact that no GPS receiver had a fix in an interval, which supports that the position was lost.

    Args:
        fix: whether a receiver had a fix (N,), 1 or 0; None if no receiver was recorded.
        interval: start and end of the time without a position, s since boot.
        known_end: when the position came back, s since boot; None if it did not.

    Returns:
        One fact; empty if a receiver had a fix, or none was recorded.
    """
    if fix is None:
        return ()
    is_in_interval = in_intervals(fix.time, [interval])
    if is_in_interval.any() and not fix.values[is_in_interval].any():
        start, _ = interval
        return (supporting_fact(SensorFact.NO_FIX, time=start, end_time=known_end),)
    return ()
