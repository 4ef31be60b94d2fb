"""Ending: how a flight was lost, and what failed first.

A motor that gives too little thrust lets the vehicle fall to its side. The autopilot drives that motor to its stop and
the opposite one to idle, and the attitude leaves all the same. So a motor is named where three things agree: the
commands, the side to which the vehicle fell, and that it did not swing before. All that is of the time from when the
attitude began to leave until it was lost; later every motor is at a stop. A vehicle that its controller throws over
falls the way it was sent, one that swings is sent both ways before, and names none.
"""

from collections.abc import Sequence
from math import inf, pi

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.autopilot_messages import in_order
from mavdem.assessment.motion import (
    CAUGHT_SECONDS,
    LOST_ANGLE,
    LOST_SECONDS,
    attitude_error,
)
from mavdem.confidence import Interval
from mavdem.dataset.intervals import in_intervals
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.phases import (
    AVERAGING_SECONDS,
    MAX_SETPOINT_DELAY,
    min_airborne_collective,
    series_of_boot,
)
from mavdem.dataset.quality import samples_at_limits
from mavdem.dataset.signals import Signals
from mavdem.facts import Code, Fact
from mavdem.facts.ending import Ending, FailedFirst, MotionEvent
from mavdem.facts.events import Reported
from mavdem.ingest.vocabulary import ON_GROUND

ENDINGS: dict[Code, Ending] = {
    MotionEvent.ATTITUDE_LOST: Ending.CONTROL_LOST,
    MotionEvent.TIPPED: Ending.TIPPED_OVER,
    MotionEvent.HIT: Ending.CRASHED,
}
"""What each event that may lose a vehicle makes of its flight."""
REPORTS = (Reported.CRASH_DETECTED, Reported.PARACHUTE_RELEASED)
"""What the autopilot reports of a flight that was lost, where the motion shows nothing of it."""
TOGETHER = (
    FailedFirst.ALL_OFF_FIRST,
    FailedFirst.LANDING_ASSUMED_FIRST,
    FailedFirst.THRUST_SPENT_FIRST,
)
"""What all motors do, so that no word of the autopilot on one of them is clear."""
LANDING_THRUSTS = ("MPC_THR_HOVER", "MPC_THR_MIN", "MOT_THST_HOVER", "MOT_SPIN_MIN")
"""Parameters by which an autopilot tells a landed vehicle from one that descends."""
NEAR_SHARE = 2 / 3
"""Of half the angle between neighbouring motors: what points so near to one points to no other."""
SPENT_SHARE = 0.9
"""Of the most that all motors may give together, from which on ArduCopter's check takes thrust for lost
(THRUST_LOSS_CHECK_MINIMUM_THROTTLE of ``crash_check.cpp``)."""

MOVED_SHARE = 0.05
"""Of the range: by so much the others move in the mean while an output that stands still is no mixer's."""
FROZEN_ROWS = 3  # At least: two samples may be the same by chance


def ending_of(
    signals: Signals, events: Sequence[Fact], collective: float | None = None
) -> Fact | None:
    """Returns how the last flight that was lost was lost, with what failed first; None where none was.

    ``events`` are those of ``motion_events`` and ``reported_events``, ``collective`` is the mean output in a hover.
    """
    bad = in_order(event for event in events if event.is_bad)
    shown = [event for event in bad if event.code in ENDINGS]
    reported = [event for event in bad if event.code in REPORTS]
    if not shown and not reported:
        return None
    event = (shown or reported)[-1]
    cause = _first(signals, events, event, collective) if shown else event
    if event.code is MotionEvent.TIPPED:
        cause = None
    word = _word(signals, bad, event.figures["boot"])
    names = {fact.subject for fact in (cause, word) if fact and fact.subject}
    is_clear = len(names) == 1 and (cause is None or cause.code not in TOGETHER)
    return Fact(
        ENDINGS.get(event.code, Ending.LOSS_REPORTED),
        time=event.time,
        until=event.until,
        subject=names.pop() if is_clear else "",
        cause=cause,
        word=word if word and (cause is None or cause.subject != word.subject) else None,
        **{name: event.figures.get(name) for name in ("height", "speed", "boot")},
    )


def _word(signals: Signals, bad: Sequence[Fact], boot: int) -> Fact | None:
    """The last word of the autopilot on a motor that failed in a ``boot``, with the motor's whole name."""
    if signals.motors is None:
        return None
    names = {name.partition(" (")[0]: name for name in signals.motors.layout.names}
    words = [
        Fact(event.code, event.level, time=event.time, subject=names[event.subject], boot=boot)
        for event in bad
        if event.code in (Reported.THRUST_LOST, Reported.MOTOR_FAILED)
        and event.subject in names
        and event.figures["boot"] == boot
    ]
    return words[-1] if words else None


def _first(
    signals: Signals, events: Sequence[Fact], lost: Fact, collective: float | None
) -> Fact | None:
    """What failed first: a motor that was off, or what commands show while the attitude left or the vehicle fell."""
    boot = lost.figures["boot"]
    onset = lost.time
    assert onset is not None
    if off := _during(events, MotionEvent.MOTOR_OFF, boot, onset):
        names = tuple(event.subject for event in off)
        subject = names[0] if len(names) == 1 else ""
        return Fact(
            FailedFirst.MOTOR_OFF_FIRST,
            time=off[0].time,
            subject=subject,
            names=names,
            settings=_set_anew(signals, names),
        )
    error = attitude_error(signals, boot)
    if error is None:
        return None
    at_stop = []
    fell = None
    if lost.code is MotionEvent.HIT:
        # What the ground turns over, motors fight: only what was so before says something.
        at_stop = [
            event
            for event in _during(events, MotionEvent.MOTOR_AT_ITS_STOP, boot, onset)
            if (event.time or 0.0) < onset - MAX_SETPOINT_DELAY
        ]
        began = [*at_stop, *_during(events, MotionEvent.FELL, boot, onset), lost][0]
        span = (began.time or onset, onset)
    else:
        at = np.argmax((error.time >= onset) & (error.size > LOST_ANGLE))
        span = (onset, error.time[at])
        fell = complex(error.lean[at])
    cause = _by_commands(signals, boot, span, [event.subject for event in at_stop], fell)
    if cause is None or fell is None or cause.code is not FailedFirst.ALL_OFF_FIRST:
        return cause
    own = signals.telemetry.parameters
    if _seemed_landed(signals, boot, onset):
        settings = [(name, own[name]) for name in LANDING_THRUSTS if name in own]
        # Thrust is the output unless THR_MDL_FAC bends it.
        hover = None if own.get("THR_MDL_FAC") else collective
        return Fact(
            FailedFirst.LANDING_ASSUMED_FIRST,
            time=cause.time,
            settings=settings,
            collective=hover,
        )
    return cause


def _seemed_landed(signals: Signals, boot: int, onset: float) -> bool:
    """Whether the autopilot took the vehicle for landed within the second before it fell."""
    landed = series_of_boot(signals.landed_state, boot)
    if landed is None:
        return False
    soon = in_intervals(landed.time, [(onset - MAX_SETPOINT_DELAY, onset)])
    return (landed.values[soon] == ON_GROUND).any()


def _during(events: Sequence[Fact], code: Code, boot: int, time: float) -> list[Fact]:
    """The events of this code that lasted at that time, s, or began as soon after it as they must last."""
    return [
        event
        for event in events
        if event.code is code
        and event.figures["boot"] == boot
        and (event.time or 0.0) <= time + LOST_SECONDS
        and (event.until or inf) >= time
    ]


def _by_commands(
    signals: Signals, boot: int, span: Interval, at_stop: Sequence[str], fell: complex | None
) -> Fact | None:
    """What failed first, by the commands in a ``span``: all motors, or one; None where they show nothing.

    ``at_stop`` are the motors that were at their stop before; ``fell`` as of ``_weak_motor``.
    """
    motors = signals.motors
    if motors is None:
        return None
    commands = motors.shares(boot)
    since, _ = span
    usual = commands.values[
        (commands.time > since - CAUGHT_SECONDS) & (commands.time < since - LOST_SECONDS)
    ]
    before = commands.values[(commands.time > since - AVERAGING_SECONDS) & (commands.time < since)]
    here = in_intervals(commands.time, [span])
    if not (len(usual) and len(before) and here.any()):
        return None
    time = commands.time[here]
    now = commands.values[here]
    change = now.mean(axis=0) - usual.mean(axis=0)
    if (change < -usual.mean(axis=0) / 2).all():
        return Fact(FailedFirst.ALL_OFF_FIRST, time=time[0])
    spent = (now if fell is None else before).mean() / motors.scale.stop
    if spent > SPENT_SHARE:
        return Fact(FailedFirst.THRUST_SPENT_FIRST, time=time[0], share=spent)
    idle = min_airborne_collective(signals.telemetry.parameters)
    weak = _weak_motor(motors, change, fell)
    if weak is None:
        return _frozen(signals, motors, now, idle)
    motor, opposite = weak
    name = motors.layout.names[motor]
    stopped = np.flatnonzero(
        samples_at_limits(now[:, motor], motors.scale)[0] | (now[:, opposite] < idle)
    )
    swung = samples_at_limits(before[:, opposite], motors.scale)[0] | (before[:, motor] < idle)
    is_alone = fell is not None or at_stop == [name]
    if swung.any() or not len(stopped) or not is_alone:
        return None
    return Fact(FailedFirst.LIMIT_FIRST, time=time[stopped[0]], subject=name)


def _set_anew(signals: Signals, names: Sequence[str]) -> list[str]:
    """The functions of these motors' outputs that were set anew; those of other outputs explain nothing."""
    assert signals.motors is not None
    layout = signals.motors.layout
    channels = dict(zip(layout.names, layout.channels, strict=True))
    functions = [f"SERVO{channels[name]}_FUNCTION" for name in names]
    return [name for name in functions if name in signals.telemetry.initial_parameters]


def _frozen(signals: Signals, motors: MotorOutputs, now: Array, idle: float) -> Fact | None:
    """The one motor whose output stood still, between idle and its stop, while the others fought."""
    moved = np.ptp(now, axis=0)
    between = (now[0] > idle) & (now[0] < motors.scale.stop - MOVED_SHARE)
    frozen = np.flatnonzero((moved == 0) & between)
    if len(now) < FROZEN_ROWS or len(frozen) != 1 or moved.mean() < MOVED_SHARE:
        return None
    name = motors.layout.names[frozen[0]]
    return Fact(FailedFirst.OUTPUT_FROZE_FIRST, subject=name, settings=_set_anew(signals, [name]))


def _weak_motor(
    motors: MotorOutputs, change: Array, fell: complex | None
) -> tuple[int, int] | None:
    """The motor that the commands' ``change`` (k,) lifts most, to whose side the vehicle ``fell``, and its opposite.

    ``fell`` is forward and, imaginary, to the right, rad; None where the vehicle fell upright. None where no motor is
    meant, or more than one.
    """
    places = np.array([complex(*arm) for arm in motors.layout.positions])
    if not len(places) or not places.all():
        return None
    near = NEAR_SHARE * pi / len(places)
    pushed = change @ places
    sides = np.angle([pushed / places, (pushed if fell is None else fell) / places])
    meant = (abs(sides) < near).all(axis=0)
    motor = int(np.argmax(change))
    if not meant[motor] or np.count_nonzero(meant) > 1:
        return None
    across = abs(np.angle(places / places[motor]))
    opposite = int(np.argmax(across))
    return (motor, opposite) if change[opposite] < 0 and across[opposite] > pi - near else None
