"""Losses of the horizontal position in flight: the estimator had one, and then had none for long.

Without a position an autopilot can only descend where the wind carries it. What its estimator reports of itself counts:
PX4's validity flags of vehicle_local_position, or the flags of the estimator status of both autopilots.
"""

from collections.abc import Iterator, Sequence

from mavdem.confidence import Interval
from mavdem.dataset.intervals import in_intervals, true_intervals
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.ending import MotionEvent
from mavdem.facts.events import Reported
from mavdem.facts.witnesses import Witness
from mavdem.witnesses.scene import Scene
from mavdem.witnesses.statements import supporting_statement

MIN_LOST_SECONDS = 5.0
"""Seconds without a position from which on that is an event: autopilots bridge shorter gaps by inertia."""

MIN_HELD_SECONDS = 5.0
"""Seconds in flight with a position before it, in all, so that a vehicle that never has one loses none."""

BLIND_MODES = frozenset({"Land", "Descend", "Alt hold", "Altitude"})
"""Modes to which autopilots change without a position."""

FAILSAFE_REPORTS = (Reported.FAILSAFE, Reported.ESTIMATOR_DIVERGED)
"""Reports of the autopilot that support a lost position."""

REACTION_SECONDS = 3.0
"""Seconds by which the reaction of the autopilot may come before the estimator reports the loss; a choice."""


def position_losses(scene: Scene, flight: Interval, reports: Sequence[Fact] = ()) -> Iterator[Fact]:
    """Yields when the estimator lost the horizontal position for long in a flight.

    Where nothing shows what the estimator had, the position counts as lost while no GPS receiver has a fix. It is bad
    where the autopilot reacted, by a failsafe or a mode without position; otherwise it is to be watched.

    Args:
        scene: sensors of the boot.
        flight: start and end of the flight, s since boot.
        reports: events that the autopilot reports.
    """
    position = scene.trust.position
    validity, fix = position.validity, position.fix
    has_position = fix if validity is None else validity
    if has_position is None:
        return
    inside = has_position.select(in_intervals(has_position.time, [flight]))
    if not len(inside.time):
        return
    first, last = float(inside.time[0]), float(inside.time[-1])
    # Flags may flicker before a loss, so that the time with a position counts and not its last stretch.
    held_seconds = 0.0
    former_end = first
    for start, end in true_intervals(inside.time, inside.values == 0):
        start, end = max(start, first), min(end, last)
        held_seconds += start - former_end
        former_end = end
        if held_seconds < MIN_HELD_SECONDS or end - start < MIN_LOST_SECONDS:
            continue
        reactions = _reactions(scene, (start, end), reports)
        level = Level.BAD if reactions else Level.WATCH
        invalid: Facts = ()
        if validity is not None:
            invalid = (supporting_statement(Witness.POSITION_INVALID, duration=end - start),)
        yield Fact(
            MotionEvent.POSITION_LOST,
            level,
            time=start,
            until=end,
            duration=end - start,
            boot=scene.boot,
            witnesses=(*invalid, *reactions, *_missing_fix(fix, (start, end))),
        )


def _reactions(scene: Scene, interval: Interval, reports: Sequence[Fact]) -> Facts:
    """Returns what the autopilot did about a lost position: failsafes, and modes that need none.

    Args:
        scene: sensors of the boot.
        interval: without a position, s since boot.
        reports: events that the autopilot reports.
    """
    # The estimator may report the loss later than the autopilot answers it.
    start, end = interval[0] - REACTION_SECONDS, interval[1]
    statements = []
    for report in reports:
        is_of_boot = report.figures["boot"] == scene.boot
        if is_of_boot and _is_reaction(report) and start <= (report.time or 0.0) <= end:
            statements.append(supporting_statement(Witness.AUTOPILOT_REPORTED, cause=report))
    for time, name in scene.signals.mode_changes(scene.boot):
        if start <= time <= end and name in BLIND_MODES:
            statements.append(supporting_statement(Witness.MODE_CHANGED, name=name, time=time))
    return tuple(statements)


def _is_reaction(report: Fact) -> bool:
    """Returns whether a report says that the autopilot acted on a lost position.

    That GPS had no fix is such a report only in the words of the autopilot. By the receiver's messages it is what
    ``NO_FIX`` states.
    """
    if report.code is Reported.GPS_LOST:
        return "error_code" in report.figures or "text" in report.figures
    return report.code in FAILSAFE_REPORTS


def _missing_fix(fix: TimeSeries | None, interval: Interval) -> Facts:
    """Returns that GPS had no fix in an interval; nothing if it had, or no receiver was recorded.

    Args:
        fix: whether a receiver had one (N,), 1 or 0.
        interval: start and end, s since boot.
    """
    if fix is None:
        return ()
    rows = in_intervals(fix.time, [interval])
    if rows.any() and not fix.values[rows].any():
        return (supporting_statement(Witness.NO_FIX),)
    return ()
