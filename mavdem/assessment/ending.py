"""Ending: how a flight was lost, and what failed first.

A motor that gives too little thrust lets the vehicle fall to its side. The autopilot drives that motor to its stop and
the opposite one to idle, and the attitude leaves all the same. So a motor is named where three things agree: the
commands, the side to which the vehicle fell, and that it did not swing before. All that is of the time from when the
attitude began to leave until it was lost; later every motor is at a stop. A vehicle that its controller throws over
falls the way it was sent, one that swings is sent both ways before, and names none.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, pi

import numpy as np

from mavdem.alignment.drive import Motors
from mavdem.alignment.phases import airborne_collective
from mavdem.alignment.quality import at_limits
from mavdem.alignment.signals import Signals
from mavdem.assessment.motion import LOST_ANGLE, LOST_SECONDS, attitude_error
from mavdem.facts import Code, Fact, Level
from mavdem.facts.ending import Ending, FailedFirst, MotionEvent
from mavdem.ingest.telemetry import Array

ENDINGS: dict[Code, Ending] = {
    MotionEvent.ATTITUDE_LOST: Ending.CONTROL_LOST,
    MotionEvent.TIPPED: Ending.TIPPED_OVER,
    MotionEvent.HIT: Ending.CRASHED,
}
"""What each event that may lose a vehicle makes of its flight."""
TRIM_SECONDS = 5.0  # Of flight before, whose mean commands are the usual ones
BEFORE_SECONDS = 2.0
"""In which thrust was spent before the attitude left, and in which the opposite of a weak motor is at no stop."""
NEAR_SHARE = 2 / 3
"""Of half the angle between neighbouring motors: what points so near to one points to no other."""
SPENT_SHARE = 0.9
"""Of the most that all motors may give together, from which on ArduCopter's check takes thrust for lost
(THRUST_LOSS_CHECK_MINIMUM_THROTTLE of ``crash_check.cpp``)."""

MOVED_SHARE = 0.05
"""Of the range: by so much the others move in the mean while an output that stands still is no mixer's."""
FROZEN_ROWS = 3  # At least: two samples may be the same by chance


def ending_of(signals: Signals, events: Sequence[Fact]) -> Fact | None:
    """Returns how the last flight that was lost was lost, with what failed first; None where none was.

    ``events`` are those of ``motion_events`` and ``reported_events``.
    """
    lost = [event for event in events if event.code in ENDINGS and event.level is Level.BAD]
    if not lost:
        return None
    event = lost[-1]
    boot = event.figures["boot"]
    onset = event.time
    assert onset is not None
    cause = None
    if event.code is not MotionEvent.TIPPED:
        cause = _switched_off(events, boot, onset) or _by_commands(signals, boot, onset)
    figures = {name: event.figures[name] for name in ("height", "speed", "boot")}
    subject = cause.subject if cause else ""
    code = ENDINGS[event.code]
    return Fact(
        code, Level.BAD, time=onset, until=event.until, subject=subject, cause=cause, **figures
    )


def _switched_off(events: Sequence[Fact], boot: int, onset: float) -> Fact | None:
    """The motors that were off as the attitude left."""
    off = [
        event
        for event in events
        if event.code is MotionEvent.MOTOR_OFF
        and event.figures["boot"] == boot
        and (event.time or 0.0) <= onset + LOST_SECONDS
        and (event.until or inf) >= onset
    ]
    if not off:
        return None
    names = tuple(event.subject for event in off)
    subject = names[0] if len(names) == 1 else ""
    code = FailedFirst.MOTOR_OFF_FIRST
    return Fact(code, Level.BAD, time=off[0].time, subject=subject, names=names)


def _by_commands(signals: Signals, boot: int, onset: float) -> Fact | None:
    """What failed first, by the commands of the motors while the attitude left, from ``onset`` on, s."""
    motors = signals.motors
    error = attitude_error(signals, boot)
    if motors is None or error is None:
        return None
    leaving = np.flatnonzero(error.time >= onset)
    leaving = leaving[: 1 + np.argmax(error.size[leaving] > LOST_ANGLE)]
    here = motors.boot == boot
    time = motors.time[here]
    shares = motors.scale.fraction(motors.outputs[here])
    usual = shares[(time > onset - TRIM_SECONDS) & (time < onset - LOST_SECONDS)]
    now = shares[(time >= onset) & (time <= error.time[leaving[-1]])]
    before = shares[(time > onset - BEFORE_SECONDS) & (time < onset)]
    if not (len(usual) and len(now) and len(before)):
        return None
    change = now.mean(axis=0) - usual.mean(axis=0)
    if (change < -usual.mean(axis=0) / 2).all():
        return Fact(FailedFirst.ALL_OFF_FIRST, Level.BAD, time=onset)
    if before.mean() > SPENT_SHARE * motors.scale.stop:
        return Fact(FailedFirst.THRUST_SPENT_FIRST, Level.BAD, time=onset)
    at = leaving[-1]
    idle = airborne_collective(signals.telemetry.parameters)
    weak = _weak_motor(motors, change, complex(-error.pitch[at], error.roll[at]))
    if weak is None:
        return _frozen(motors, now, idle)
    motor, opposite = weak
    upper, _ = at_limits(np.concatenate([before, now]), motors.scale)
    idles = np.concatenate([before, now]) < idle
    first = len(before)
    stopped = np.flatnonzero(upper[first:, motor] | idles[first:, opposite])
    swung = (upper[:first, opposite] | idles[:first, motor]).any()
    if swung or not len(stopped):
        return None
    since = float(time[time >= onset][stopped[0]])
    name = motors.layout.names[motor]
    return Fact(FailedFirst.LIMIT_FIRST, Level.BAD, time=since, subject=name)


def _frozen(motors: Motors, now: Array, idle: float) -> Fact | None:
    """The one motor whose output stood still, between idle and its stop, while the others fought."""
    moved = np.ptp(now, axis=0)
    between = (now[0] > idle) & (now[0] < motors.scale.stop - MOVED_SHARE)
    frozen = np.flatnonzero((moved == 0) & between)
    if len(now) < FROZEN_ROWS or len(frozen) != 1 or moved.mean() < MOVED_SHARE:
        return None
    name = motors.layout.names[frozen[0]]
    return Fact(FailedFirst.OUTPUT_FROZE_FIRST, Level.BAD, subject=name)


def _weak_motor(motors: Motors, change: Array, fell: complex) -> tuple[int, int] | None:
    """The motor to whose side the vehicle ``fell`` though the commands' ``change`` (k,) lifts it, and its opposite.

    ``fell`` is forward and, imaginary, to the right, rad. None where no motor is meant, or more than one.
    """
    places = np.array([complex(*place) for place in motors.layout.positions])
    if not len(places):
        return None
    near = NEAR_SHARE * pi / len(places)
    meant = np.abs(np.angle(change @ places / places)) < near
    meant &= np.abs(np.angle(fell / places)) < near
    if np.count_nonzero(meant) != 1:
        return None
    motor = int(np.argmax(meant))
    across = np.abs(np.angle(places / places[motor]))
    opposite = int(np.argmax(across))
    lifts = change[opposite] < 0 < change[motor]
    return (motor, opposite) if lifts and across[opposite] > pi - near else None
