"""What failed first in a flight that was lost: one motor, all of them, the thrust, or the land detector.

A motor with too little thrust lets the vehicle fall to its side. The autopilot drives that motor to its limit and the
opposite one to idle, and the attitude is lost all the same. So a motor is named where three things agree: the commands,
the side to which the vehicle fell, and that it did not swing before. All of it is measured from when the attitude began
to leave its setpoint until it was lost: later every motor is at a limit. A vehicle that its own controller throws over
falls the way it was commanded, and one that swings was commanded both ways before: they name no motor.
"""

from collections.abc import Sequence
from math import inf, pi
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.assessment.attitude_error import AttitudeError, attitude_error
from mavdem.assessment.attitude_losses import LOST_ANGLE
from mavdem.assessment.battery_levels import cell_count, voltage_levels
from mavdem.assessment.commanded_overturn import commanded_overturn
from mavdem.assessment.flights import RECOVERY_SECONDS, loss_onset
from mavdem.assessment.lowered_throttle import lowered_throttle
from mavdem.assessment.motor_events import LASTING_SECONDS
from mavdem.confidence import Interval
from mavdem.dataset.intervals import in_intervals
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.phases import (
    AVERAGING_SECONDS,
    MANUAL_THROTTLE_MODES,
    MAX_SETPOINT_DELAY,
    min_airborne_command,
    mode_intervals,
    series_of_boot,
)
from mavdem.dataset.quality import samples_at_limits
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Code, Fact
from mavdem.facts.ending import FailedFirst, MotionEvent
from mavdem.facts.events import Reported
from mavdem.ingest.vocabulary import ON_GROUND
from mavdem.witnesses.boot_sensors import BootSensors
from mavdem.witnesses.sensors import FULL_STICK

CAUSES_OF_ALL_MOTORS = (
    FailedFirst.ALL_OFF_FIRST,
    FailedFirst.FAILSAFE_FIRST,
    FailedFirst.THROTTLE_CLOSED_FIRST,
    FailedFirst.HEIGHT_DIVERGED_FIRST,
    FailedFirst.LANDING_ASSUMED_FIRST,
    FailedFirst.THRUST_SPENT_FIRST,
    FailedFirst.OVERTURN_COMMANDED_FIRST,
    FailedFirst.THROTTLE_LOWERED_FIRST,
)
"""Causes that concern all motors alike, whatever the autopilot reports of one of them."""

LANDING_PARAMETERS = ("MPC_THR_HOVER", "MPC_THR_MIN", "MOT_THST_HOVER", "MOT_SPIN_MIN")
"""Parameters with levels of thrust, by which PX4 and ArduPilot distinguish a landed vehicle from one that descends."""

ALIGNMENT_SHARE = 2 / 3
"""A direction belongs to a motor if it is within this share of half the angle between neighbouring motors: then it
belongs to no other."""

SPENT_THRUST_SHARE = 0.9
"""Mean command of all motors, as a share of the highest, from which on all thrust is in use
(THRUST_LOSS_CHECK_MINIMUM_THROTTLE of ArduCopter's ``crash_check.cpp``)."""

LEAST_SINK_RATE = 0.5
"""Speed downward, m/s, from which on a vehicle sinks for certain: estimates drift by 0.1 to 0.3 m/s."""

SINKING_SECONDS = 1.0
"""Seconds before an impact in which a vehicle sinks at full throttle; a choice."""

LIMITED_SHARE = 0.5
"""Share of that time beyond which a motor must be at its limit; a choice."""

MIN_COMMAND_RANGE = 0.05
"""Mean range of all motors' commands, as a share of the full range, beside which one that is constant has frozen; also
the distance from its limit at which it must be constant."""

DIVERGENCE_SECONDS = 10.0
"""Seconds after a height estimate diverged within which a loss follows from it: a fall from 100 m takes as long."""

FIRST_RESPONSE_SECONDS = 0.3
"""Seconds in which a controller answers a failure before the vehicle has turned: three samples at 10 Hz."""

STOP_REASON_SECONDS = 2.0
"""Seconds around the stop of all motors within which its reason is reported."""

REASONS_OF_STOP = (
    Reported.MOTORS_STOPPED,
    Reported.FLIGHT_TERMINATED,
    Reported.RADIO_LOST,
    Reported.BATTERY_ALARMED,
    Reported.BATTERY_SPENT,
    Reported.GROUND_STATION_LOST,
    Reported.FENCE_BREACHED,
    Reported.FAILSAFE,
    Reported.ESTIMATOR_DIVERGED,
)
"""Reports of the autopilot that explain why it stopped all motors, whatever the pilot did.

A warning of a low battery comes again and again, so that it explains a stop only where the pilot did not close the
throttle.
"""

BATTERY_ALARMS = (Reported.BATTERY_ALARMED, Reported.BATTERY_SPENT)
"""Reports of an empty battery. As a mere state of the battery they say nothing of the motors."""

MIN_FROZEN_SAMPLES = 3
"""Number of equal samples that show a frozen output: two may be equal by chance."""


class _Trouble(NamedTuple):
    """The time just before a vehicle was lost, in which the commands of the motors are examined."""

    interval: Interval
    """Start and end, s since boot."""
    names_at_limit: Sequence[str] = ()
    """Names of the motors that were at their limit before an impact."""
    fall_direction: complex | None = None
    """Lean with which the vehicle fell, as in :func:`_weak_motor`; None if it hit something."""


def first_failure(
    signals: Signals, events: Sequence[Fact], loss: Fact, collective: float | None
) -> Fact | None:
    """Returns the fact on what failed first, before a vehicle was lost; None if nothing shows it.

    A motor that was off or stood still as the loss began is the cause, or a setpoint that turned the vehicle over.
    Otherwise the commands of the motors are examined over a short interval (:func:`_trouble_before_impact`,
    :func:`_trouble_of_attitude`). A height estimate that diverged before outranks what they show.

    Args:
        signals: signals of the vehicle.
        events: events of the flight.
        loss: the event of the motion with which the vehicle was lost.
        collective: mean output of all motors in the hover, as a share of their range.
    """
    boot = loss.figures["boot"]
    onset = loss_onset(loss)
    assert onset is not None
    motors_off = _events_at(events, MotionEvent.MOTOR_OFF, boot, onset)
    if motors_off:
        names = tuple(event.subject for event in motors_off)
        return Fact(
            FailedFirst.MOTOR_OFF_FIRST,
            time=motors_off[0].time,
            subject=names[0] if len(names) == 1 else "",
            names=names,
            settings=_changed_functions(signals, names),
        )
    standing = _standing_motor(events, boot, onset)
    if standing is not None:
        return Fact(
            FailedFirst.MOTOR_STOOD_STILL_FIRST, time=standing.time, subject=standing.subject
        )
    overturn = commanded_overturn(signals, boot, loss.time or onset)
    if overturn is not None:
        return overturn
    error = attitude_error(signals, boot)
    if error is None:
        return None
    if loss.code is MotionEvent.HIT:
        trouble = _trouble_before_impact(events, boot, onset)
    else:
        trouble = _trouble_of_attitude(error, onset)
    cause = _failure_by_commands(signals, boot, trouble)
    diverged = _diverged_height(events, boot, onset)
    if diverged is not None:
        return Fact(
            FailedFirst.HEIGHT_DIVERGED_FIRST,
            time=diverged.time,
            cause=diverged,
            later_cause=_closed_throttle(signals, boot, diverged, onset),
        )
    if cause is None and loss.code is MotionEvent.HIT:
        return lowered_throttle(signals, boot, onset)
    if cause is None or cause.code is not FailedFirst.ALL_OFF_FIRST:
        return cause
    # An autopilot that takes the vehicle for landed switches all motors off in the air.
    if trouble.fall_direction is not None and _assumed_landing(signals, boot, onset):
        return _landing_assumed(signals, cause, collective)
    return _reason_of_stop(signals, events, boot, cause)


def _trouble_before_impact(events: Sequence[Fact], boot: int, impact: float) -> _Trouble:
    """Finds the time before an impact in which something went wrong, and the motors that were at their limit.

    It begins with the first sign of trouble, a motor at its limit or a fall, but ``MAX_SETPOINT_DELAY`` before the
    impact at the latest.

    Args:
        events: events of the flight.
        boot: number of the boot.
        impact: time when the loss began, s since boot.

    Returns:
        The interval from the first sign of trouble to the impact, s since boot, and the names of those motors.
    """
    latest_start = impact - MAX_SETPOINT_DELAY
    # Motors fight an obstacle that turns the vehicle over, so that only earlier limits are evidence.
    motors_at_limit: list[Fact] = []
    for event in _events_at(events, MotionEvent.MOTOR_AT_ITS_STOP, boot, impact):
        if (event.time or 0.0) < latest_start:
            motors_at_limit.append(event)
    # The averages that show a fall end it up to a second before the impact, and begin it as late.
    falls = _events_at(events, MotionEvent.FELL, boot, latest_start, 2 * MAX_SETPOINT_DELAY)
    start = latest_start
    for event in [*motors_at_limit, *falls]:
        start = min(start, event.time or start)
    names_at_limit = [event.subject for event in motors_at_limit]
    return _Trouble((start, impact), names_at_limit=names_at_limit)


def _trouble_of_attitude(error: AttitudeError, onset: float) -> _Trouble:
    """Finds the time from the onset of a loss of attitude until the error exceeded ``LOST_ANGLE``.

    Args:
        error: error of the attitude in the boot.
        onset: time when the loss began, s since boot.

    Returns:
        The interval, s since boot, and the side to which the vehicle fell: the direction of the error at its end.
    """
    lost_row = np.argmax((error.time >= onset) & (error.magnitude > LOST_ANGLE))
    interval = (onset, float(error.time[lost_row]))
    return _Trouble(interval, fall_direction=complex(error.lean[lost_row]))


def _standing_motor(events: Sequence[Fact], boot: int, onset: float) -> Fact | None:
    """Returns the first motor that stood still as a loss began.

    Args:
        events: events of the flight.
        boot: number of the boot.
        onset: time when the loss began, s since boot. Telemetry of controllers may be ``MAX_SETPOINT_DELAY`` later.

    Returns:
        The motor, as a fact; None if none did, or no second witness confirms it.
    """
    for event in _events_at(events, MotionEvent.MOTOR_STOOD_STILL, boot, onset, MAX_SETPOINT_DELAY):
        if event.is_bad:
            return event
    return None


def _closed_throttle(signals: Signals, boot: int, diverged: Fact, onset: float) -> Fact | None:
    """Returns the fact that the pilot closed the throttle between a diverged height and the loss.

    Only in a mode in which the stick is the thrust does the vehicle fall from that.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
        diverged: the height estimate that diverged before.
        onset: time when the loss began, s since boot.

    Returns:
        The fact; None if the log does not show it.
    """
    start = max(diverged.until or inf, onset - STOP_REASON_SECONDS)
    closed = BootSensors(signals, boot).throttle_closed((start, onset))
    manual = mode_intervals(signals, boot, MANUAL_THROTTLE_MODES)
    if closed is None or not in_intervals(closed.time or 0.0, manual):
        return None
    return Fact(FailedFirst.THROTTLE_CLOSED_FIRST, time=closed.time)


def _diverged_height(events: Sequence[Fact], boot: int, onset: float) -> Fact | None:
    """Returns the last height estimate that diverged shortly before a loss.

    Args:
        events: events of the flight.
        boot: number of the boot.
        onset: time when the loss began, s since boot.

    Returns:
        The event; None if none did.
    """
    diverged = None
    for event in events:
        is_of_boot = event.figures.get("boot") == boot
        if event.code is MotionEvent.HEIGHT_DIVERGED and is_of_boot and event.is_bad:
            start, end = event.time or 0.0, event.until or inf
            if start <= onset <= end + DIVERGENCE_SECONDS:
                diverged = event
    return diverged


def _reason_of_stop(signals: Signals, events: Sequence[Fact], boot: int, cause: Fact) -> Fact:
    """Returns the reason why all motors went to idle: a reported failsafe or switch, or the pilot's throttle.

    Args:
        signals: signals of the vehicle.
        events: events of the flight, with those that the autopilot reports.
        boot: number of the boot.
        cause: the fact that all motors went to idle, with its time.

    Returns:
        The reason, or the fact itself if the log shows none.
    """
    stop_time = cause.time or 0.0
    earliest = stop_time - STOP_REASON_SECONDS
    latest = stop_time + STOP_REASON_SECONDS
    first_battery_warning = None
    for event in events:
        if event.figures.get("boot") != boot or not _is_reported_in(event, (earliest, latest)):
            continue
        is_mere_alarm = event.code in BATTERY_ALARMS and not _reports_failsafe(event)
        if is_mere_alarm and not _battery_was_low(signals, boot, stop_time):
            # The voltage does not confirm the alarm: a battery that breaks loose in a crash raises one too.
            continue
        if event.code in REASONS_OF_STOP:
            return Fact(FailedFirst.FAILSAFE_FIRST, time=event.time, cause=event)
        if event.code is Reported.BATTERY_WARNED and first_battery_warning is None:
            first_battery_warning = event
    # A pilot who closes the throttle later answers to the fall. The stick may be logged more slowly than the motors.
    throttle_closing = BootSensors(signals, boot).throttle_closed(
        (earliest, stop_time + FIRST_RESPONSE_SECONDS)
    )
    if throttle_closing is not None:
        return Fact(FailedFirst.THROTTLE_CLOSED_FIRST, time=throttle_closing.time)
    if first_battery_warning is not None:
        return Fact(
            FailedFirst.FAILSAFE_FIRST, time=first_battery_warning.time, cause=first_battery_warning
        )
    return cause


def _is_reported_in(event: Fact, interval: Interval) -> bool:
    """Returns whether the autopilot reported an event in an interval, s since boot.

    Reports are of a moment. Only the radio is lost for seconds before the failsafe acts: such a report lasts.
    """
    earliest, latest = interval
    start = event.time or 0.0
    end = (event.until or inf) if event.code is Reported.RADIO_LOST else start
    return start <= latest and end >= earliest


def _reports_failsafe(alarm: Fact) -> bool:
    """Returns whether an alarm of the battery is an act of the autopilot: a failsafe, by an error code or in words."""
    text = alarm.figures.get("text") or ""
    return "error_code" in alarm.figures or "failsafe" in text.lower()


def _battery_was_low(signals: Signals, boot: int, time: float) -> bool:
    """Returns whether a battery was low before a time, by its median voltage over ``RECOVERY_SECONDS``.

    The low level is the limit, since most logs do not contain the autopilot's critical voltage, which may be anywhere
    below it.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
        time: time when the motors stopped, s since boot.

    Returns:
        Whether it was low; False if no voltage or no limit is known.
    """
    parameters = signals.telemetry.parameters
    for battery in signals.batteries:
        voltage = series_of_boot(battery.voltage, boot)
        if voltage is None:
            continue
        volts = voltage.values[in_intervals(voltage.time, [(time - RECOVERY_SECONDS, time)])]
        cells = cell_count(parameters, battery) or 0
        low = voltage_levels(parameters, battery.number, cells).watch
        if len(volts) and np.median(volts) < low:
            return True
    return False


def _events_at(
    events: Sequence[Fact], code: Code, boot: int, time: float, delay: float = LASTING_SECONDS
) -> list[Fact]:
    """Selects the events of one code that last at a given time.

    Args:
        events: events of the log.
        code: code of the events to return.
        boot: number of the boot.
        time: time on the boot clock, s.
        delay: an event counts too that begins up to so many seconds later. ``LASTING_SECONDS`` is how long most events
            must last to be one.

    Returns:
        These events, in the order of ``events``.
    """
    return [
        event
        for event in events
        if event.code is code
        and event.figures["boot"] == boot
        and (event.time or 0.0) <= time + delay
        and (event.until or inf) >= time
    ]


def _changed_functions(signals: Signals, names: Sequence[str]) -> list[str]:
    """Finds the outputs of motors whose assignment was changed during the log.

    The parameter SERVOn_FUNCTION assigns output n to a motor. If it is changed in flight, the output no longer drives
    its motor, so that the change itself may be the failure.

    Args:
        signals: signals of the vehicle, whose ``initial_parameters`` are those that were changed.
        names: names of the motors.

    Returns:
        The names of the changed parameters.
    """
    assert signals.motors is not None
    geometry = signals.motors.geometry
    channel_by_motor = dict(zip(geometry.names, geometry.channels, strict=True))
    changed_parameters = signals.telemetry.initial_parameters
    changed_functions = []
    for name in names:
        parameter = f"SERVO{channel_by_motor[name]}_FUNCTION"
        if parameter in changed_parameters:
            changed_functions.append(parameter)
    return changed_functions


def _assumed_landing(signals: Signals, boot: int, onset: float) -> bool:
    """Returns whether the autopilot reported a landed vehicle within ``MAX_SETPOINT_DELAY`` before ``onset``, s."""
    landed_state = series_of_boot(signals.landed_state, boot)
    if landed_state is None:
        return False
    is_recent = in_intervals(landed_state.time, [(onset - MAX_SETPOINT_DELAY, onset)])
    return bool((landed_state.values[is_recent] == ON_GROUND).any())


def _landing_assumed(signals: Signals, cause: Fact, collective: float | None) -> Fact:
    """Returns the fact that the autopilot switched all motors off in the air because it took the vehicle for landed.

    The autopilot decides that by comparing the thrust with some parameters, whose values are in the fact, so that they
    can be compared with the thrust in the hover and mended.

    Args:
        signals: signals of the vehicle.
        cause: the fact that all motors were off, with its time.
        collective: mean output of all motors in the hover, as a share of their range; None if it is not known. It
            equals the thrust of the parameters only if PX4's THR_MDL_FAC is 0, since that bends the relation between
            the two. Otherwise the fact does not state it.
    """
    parameters = signals.telemetry.parameters
    settings = [(name, parameters[name]) for name in LANDING_PARAMETERS if name in parameters]
    return Fact(
        FailedFirst.LANDING_ASSUMED_FIRST,
        time=cause.time,
        settings=settings,
        collective=None if parameters.get("THR_MDL_FAC") else collective,
    )


def _failure_by_commands(signals: Signals, boot: int, trouble: _Trouble) -> Fact | None:
    """Returns the fact on what failed first, by the commands of the motors; None if they show nothing.

    The commands in the time of trouble are compared with the usual ones of the ``RECOVERY_SECONDS`` before. They
    show, in this order: that all motors were switched off, that all thrust was in use, that one motor is too weak
    (:func:`_weak_motor`), or that the output of one is frozen.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
        trouble: while the attitude left its setpoint or the vehicle fell.
    """
    motors = signals.motors
    if motors is None:
        return None
    interval, fall_direction = trouble.interval, trouble.fall_direction
    commands = motors.range_fractions(boot)
    # Commands of three times: usual flight before the failure, the seconds just before it, and the failure itself.
    start, _ = interval
    usual_commands = _commands_between(commands, start - RECOVERY_SECONDS, start - LASTING_SECONDS)
    commands_before = _commands_between(commands, start - AVERAGING_SECONDS, start)
    rows = in_intervals(commands.time, [interval])
    if not len(usual_commands) or not len(commands_before) or not rows.any():
        return None
    # All arrays have a column for each motor: (N,) times, (N, k) commands, (k,) usual commands and changes.
    time = commands.time[rows]
    commands_now = commands.values[rows]
    usual = usual_commands.mean(axis=0)
    change = commands_now.mean(axis=0) - usual
    if (change < -usual / 2).all():
        is_off = (commands_now < usual / 2).all(axis=1)
        return Fact(FailedFirst.ALL_OFF_FIRST, time=time[is_off][0] if is_off.any() else time[0])

    # While the attitude is lost the controller drives motors to their limits, so that the thrust before that counts.
    thrust_commands = commands_now if fall_direction is None else commands_before
    thrust_share = thrust_commands.mean() / motors.scale.stop
    if thrust_share > SPENT_THRUST_SHARE:
        spent_since = _spent_since(commands, time[0], motors.scale.stop)
        end = start if fall_direction is not None else interval[1]
        is_since = in_intervals(commands.time, [(spent_since, max(end, spent_since))])
        share = commands.values[is_since].mean() / motors.scale.stop
        return Fact(FailedFirst.THRUST_SPENT_FIRST, time=spent_since, share=share)

    if fall_direction is None:
        sinking = _sinking_at_full_throttle(signals, boot, motors, interval[1])
        if sinking is not None:
            return sinking

    # One motor: at its limit, or the opposite one at idle to make up for it.
    idle = min_airborne_command(motors)
    weak = _weak_motor(motors, change, fall_direction)
    if weak is None:
        # A vehicle that fights for long drives all motors to and fro: what its controller did first shows the motor.
        is_first = time <= time[0] + FIRST_RESPONSE_SECONDS
        weak = _weak_motor(motors, commands_now[is_first].mean(axis=0) - usual, fall_direction)
    if weak is None:
        return _frozen_output(signals, motors, commands_now, idle)
    name = motors.geometry.names[weak.motor]
    # Without a side to which the vehicle fell, an earlier limit of this motor alone must confirm it.
    if fall_direction is None and list(trouble.names_at_limit) != [name]:
        return None
    at_limit_now, _ = samples_at_limits(commands_now, motors.scale)
    failed_rows = np.flatnonzero(
        at_limit_now[:, weak.motor] | (commands_now[:, weak.opposite] < idle)
    )
    # A vehicle that swings was commanded the other way shortly before.
    opposite_at_limit, _ = samples_at_limits(commands_before[:, weak.opposite], motors.scale)
    has_swung = (opposite_at_limit | (commands_before[:, weak.motor] < idle)).any()
    if has_swung or not len(failed_rows):
        return None
    failure_time = time[failed_rows[0]]
    if _is_first_at_limit(at_limit_now, weak.motor):
        return Fact(FailedFirst.LIMIT_FIRST, time=failure_time, subject=name)
    highest_command = commands_now[:, weak.motor].max()
    return Fact(
        FailedFirst.THRUST_MISSING_FIRST, time=failure_time, subject=name, share=highest_command
    )


def _spent_since(commands: TimeSeries, time: float, stop: float) -> float:
    """Returns since when, s, all motors together used up their thrust without a break until a given time.

    Args:
        commands: (N, k) of k motors, as shares of their range.
        time: time of one of the samples, s, which is returned if the thrust was not used up at that sample.
        stop: the highest command.
    """
    is_left = commands.values.mean(axis=1) <= SPENT_THRUST_SHARE * stop
    rows_with_rest = np.flatnonzero(is_left & (commands.time <= time))
    first_row = rows_with_rest[-1] + 1 if len(rows_with_rest) else 0
    return float(min(commands.time[min(first_row, len(commands.time) - 1)], time))


def _is_first_at_limit(at_limit: Flags, motor: int) -> bool:
    """Returns whether one motor reached its upper limit, and no other one before it.

    Args:
        at_limit: (N, k) whether each of k motors is at its upper limit in each of N samples, in the order of time.
        motor: index of the motor.
    """
    limited_rows = np.flatnonzero(at_limit.any(axis=1))
    return len(limited_rows) > 0 and bool(at_limit[limited_rows[0], motor])


def _sinking_at_full_throttle(
    signals: Signals, boot: int, motors: MotorOutputs, time: float
) -> Fact | None:
    """Returns the fact that the vehicle sank at full throttle with a motor at its limit.

    Then all thrust is in use, however low the mean command is: a mixer lowers the other motors to keep the attitude.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
        motors: its motors.
        time: time of the impact, s since boot; the ``SINKING_SECONDS`` before it count.

    Returns:
        The fact; None if it did not.
    """
    interval = (time - SINKING_SECONDS, time)
    stick = BootSensors(signals, boot).stick
    climb = BootSensors(signals, boot).climb_estimate
    if stick is None or climb is None:
        return None
    stick_travel = stick.values[in_intervals(stick.time, [interval])]
    climb_rates = climb.values[in_intervals(climb.time, [interval])]
    commands = motors.range_fractions(boot)
    rows = in_intervals(commands.time, [interval])
    if not len(stick_travel) or not len(climb_rates) or not rows.any():
        return None
    at_limit, _ = samples_at_limits(commands.values[rows], motors.scale)
    has_limited_motor = at_limit.any(axis=1).mean() > LIMITED_SHARE
    is_full_throttle = stick_travel.min() >= FULL_STICK
    is_sinking = climb_rates.max() <= -LEAST_SINK_RATE
    if not (is_full_throttle and is_sinking and has_limited_motor):
        return None
    limited_names = []
    for motor, name in enumerate(motors.geometry.names):
        if at_limit[:, motor].any():
            limited_names.append(name)
    return Fact(
        FailedFirst.THRUST_SPENT_FIRST,
        time=interval[0],
        share=commands.values[rows].mean() / motors.scale.stop,
        names=tuple(limited_names),
    )


def _commands_between(commands: TimeSeries, start: float, end: float) -> Array:
    """Returns the commands (N, k) of k motors between two times, s, without the ends."""
    is_between = (commands.time > start) & (commands.time < end)
    return commands.values[is_between]


def _frozen_output(
    signals: Signals, motors: MotorOutputs, commands: Array, idle: float
) -> Fact | None:
    """Returns the fact that one motor's output froze while the others worked to save the vehicle.

    Exactly one motor must be constant, over ``MIN_FROZEN_SAMPLES``, while the range of the commands is on average
    ``MIN_COMMAND_RANGE``. The constant command must be off the limits, at which a mixer itself may keep an output.

    Args:
        signals: signals of the vehicle.
        motors: its motors, k of them.
        commands: (N, k) as shares of the motors' range.
        idle: the least command in flight, as a share of the range.

    Returns:
        The fact; None if no output froze.
    """
    ranges = np.ptp(commands, axis=0)
    is_within_limits = (commands[0] > idle) & (commands[0] < motors.scale.stop - MIN_COMMAND_RANGE)
    frozen_motors = np.flatnonzero((ranges == 0) & is_within_limits)
    has_enough_samples = len(commands) >= MIN_FROZEN_SAMPLES
    others_worked = ranges.mean() >= MIN_COMMAND_RANGE
    if len(frozen_motors) != 1 or not has_enough_samples or not others_worked:
        return None
    name = motors.geometry.names[frozen_motors[0]]
    settings = _changed_functions(signals, [name])
    return Fact(FailedFirst.OUTPUT_FROZE_FIRST, subject=name, settings=settings)


class _WeakMotor(NamedTuple):
    """Indices of a motor with too little thrust, and of the motor on the other side of the vehicle."""

    motor: int
    """Index of the motor with too little thrust."""
    opposite: int
    """Index of the motor across from it, which the controller throttles to level the vehicle."""


def _weak_motor(
    motors: MotorOutputs, change: Array, fall_direction: complex | None
) -> _WeakMotor | None:
    """Finds the one motor to whose side the vehicle fell and which the commands try to lift.

    The sum of the motors' positions, weighted with the changes of their commands, points to the side that the commands
    lift. That direction and the one of the fall must both be aligned with one motor, and with no other.

    Args:
        motors: k motors.
        change: (k,) change of the commands, as shares of the motors' range.
        fall_direction: lean with which the vehicle fell, rad: forward and, as imaginary part, to the right; None if it
            fell upright.

    Returns:
        The motor and its opposite one, whose command decreased; None if the commands show no such pair.
    """
    # Forward is the real part, right the imaginary part, as in the fall's direction.
    positions = np.array([complex(*position) for position in motors.geometry.positions])
    if not len(positions) or not positions.all():
        # The positions are not known, or a motor at the centre has no direction.
        return None
    # Half the angle between neighbouring motors is π over their number.
    max_angle = ALIGNMENT_SHARE * pi / len(positions)
    lift_direction = change @ positions
    if fall_direction is None:
        fall_direction = lift_direction
    # The angle of a quotient of complex numbers is the angle between their directions: (k,) from each motor.
    lift_angles = abs(np.angle(lift_direction / positions))
    fall_angles = abs(np.angle(fall_direction / positions))
    is_aligned = (lift_angles < max_angle) & (fall_angles < max_angle)
    motor = int(np.argmax(change))
    is_only_one = np.count_nonzero(is_aligned) == 1
    if not (is_aligned[motor] and is_only_one):
        return None
    angles_from_motor = abs(np.angle(positions / positions[motor]))
    opposite = int(np.argmax(angles_from_motor))
    if change[opposite] < 0 and angles_from_motor[opposite] > pi - max_angle:
        return _WeakMotor(motor, opposite)
    return None
