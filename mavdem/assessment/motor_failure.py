"""What the motors were commanded when one of them failed: the evidence for the motor as the cause of a loss.

A vehicle that is lost by a motor shows it in the commands before it shows it in the attitude: the controller drives a
motor that gives too little thrust up, and the other motors show that it is not the load that it works against. The
sensors of the loss itself, such as the gyro, show only what followed.
"""

from collections.abc import Sequence
from math import inf
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.flights import RECOVERY_SECONDS, flights_in_boot, loss_onset
from mavdem.assessment.motor_events import LASTING_SECONDS
from mavdem.containers import Names
from mavdem.dataset.intervals import TimeInterval
from mavdem.dataset.quality import samples_at_limits
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import AVERAGING_SECONDS, TimeSeries, moving_average
from mavdem.facts import Fact, Facts
from mavdem.facts.ending import Ending, FailedFirst, MotionEvent
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.witnesses import SensorFact
from mavdem.ingest.output_scale import OutputScale
from mavdem.witnesses.sensor_facts import supporting_fact

CAUSES_BY_WEAK_MOTOR = (FailedFirst.LIMIT_FIRST, FailedFirst.THRUST_MISSING_FIRST)
"""Causes of a loss in which the controller drove the motor up before."""

CAUSES_BY_OUTPUT = (
    FailedFirst.MOTOR_OFF_FIRST,
    FailedFirst.OUTPUT_FROZE_FIRST,
    FailedFirst.MOTOR_STOOD_STILL_FIRST,
)
"""Causes of a loss in which a motor stopped."""

CAUSES_BY_ALL_MOTORS = (
    FailedFirst.ALL_OFF_FIRST,
    FailedFirst.FAILSAFE_FIRST,
    FailedFirst.LANDING_ASSUMED_FIRST,
)
"""Causes of a loss that the mean command of all motors shows: they idled."""

LOSSES_OF_THRUST = (MotorWatchFact.MOTOR_LOST_THRUST, MotorWatchFact.MOTOR_SATURATED)
"""Facts that a motor lost thrust, whether the flight went on or not."""

USUAL_QUANTILE = 0.95
"""Quantile of the command above the others' mean, in the usual flight, beyond which a command climbs; a choice."""


class FailureCommands(NamedTuple):
    """Median commands of the k motors of a vehicle when one of them failed, as shares of their range."""

    motor: int
    """Index of the motor that failed, from 0."""

    interval: TimeInterval
    """Time of ``at_failure``, s since boot."""

    usual: Array
    """(k,) medians of the flight before."""

    at_failure: Array
    """(k,) medians of the interval."""

    def others(self, commands: Array) -> float:
        """Returns the mean of some commands (k,) without that of the motor that failed."""
        return float(np.delete(commands, self.motor).mean())


def failure_commands(signals: Signals, failure: Fact) -> FailureCommands | None:
    """Returns the commands of all motors when one of them failed, and before.

    If the flight was lost, the commands at the failure are those of the ``AVERAGING_SECONDS`` from then on, before an
    impact; after that the vehicle tumbles. If only thrust was lost, they are those of up to twice ``RECOVERY_SECONDS``.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        failure: how the flight was lost, or that a motor lost thrust; its subject is the motor.

    Returns:
        The commands; None if the fact is neither of these, or there is no sample in flight before it or at it.
    """
    logged = _logged_commands(signals, failure)
    return None if logged is None else logged.medians(failure.subject)


def with_evidence_of_cause(
    signals: Signals, ending: Fact | None, events: Sequence[Fact]
) -> Fact | None:
    """Adds to the cause of a loss what shows it; the sensor facts of the loss itself show only what followed.

    Of a motor this is what it and the others were commanded (:func:`failure_commands`), and of all motors their mean
    command. If the cause is an event of its own, such as a motor that stood still by its speed controller, or a height
    estimate that diverged, it is the evidence for that event.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        ending: event with which the flight was lost, with its cause; None if it was not.
        events: events of the log, among them the one that is the cause.

    Returns:
        The event, whose cause has this evidence as its figure ``witnesses``, as far as there is any.
    """
    cause = None if ending is None else ending.figures.get("cause")
    if ending is None or cause is None:
        return ending
    evidence = _evidence_of_causing_event(ending, cause, events)
    logged = _logged_commands(signals, ending)
    if logged is not None and signals.motors is not None:
        evidence = (
            *evidence,
            *_change_of_commands(logged, ending, signals.motors.scale),
            *_change_of_mean_command(logged, ending),
        )
    return ending.replace(cause=cause.replace(witnesses=evidence)) if evidence else ending


def _interval_at_failure(failure: Fact) -> TimeInterval | None:
    """Returns the interval whose commands show what failed, s since boot; None if no motor did.

    Args:
        failure: how the flight was lost, or that a motor lost thrust.
    """
    if failure.code in LOSSES_OF_THRUST:
        start = failure.start_time
        return start, min(failure.latest_time, start + 2 * RECOVERY_SECONDS)
    cause = failure.figures.get("cause")
    onset = loss_onset(failure)
    if cause is None or onset is None:
        return None
    if cause.code not in (*CAUSES_BY_WEAK_MOTOR, *CAUSES_BY_OUTPUT, *CAUSES_BY_ALL_MOTORS):
        return None
    # An output that froze has no time of its own: it stood still when the attitude left its setpoint.
    start = onset if cause.time is None else cause.time
    end = start + AVERAGING_SECONDS
    if failure.code is Ending.CRASHED:
        end = max(min(end, failure.start_time), start)
    return start, end


class _LoggedCommands(NamedTuple):
    """Logged commands of k motors around a failure, as fractions of their range."""

    motor_names: Names
    """(k,) names of the motors."""

    commands: TimeSeries
    """(N, k) all commands of the boot."""

    interval: TimeInterval
    """Time that shows what failed, s since boot."""

    usual: TimeSeries
    """(M, k) those of the flight before, at least one."""

    at_failure: TimeSeries
    """(L, k) those of ``interval``, at least one."""

    def medians(self, motor: str) -> FailureCommands | None:
        """Returns the medians before and at the failure of a motor; None of another subject, such as the vehicle.

        Args:
            motor: name of the motor that failed.
        """
        if motor not in self.motor_names:
            return None
        start, end = self.interval
        return FailureCommands(
            self.motor_names.index(motor),
            (start, min(end, float(self.commands.time[-1]))),
            usual=np.median(self.usual.values, axis=0),
            at_failure=np.median(self.at_failure.values, axis=0),
        )


def _logged_commands(signals: Signals, failure: Fact) -> _LoggedCommands | None:
    """Returns the commands of all motors around a failure.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        failure: how the flight was lost, or that a motor lost thrust.

    Returns:
        The commands; None if no motor failed, or there is no sample in flight before the failure or at it.
    """
    interval = _interval_at_failure(failure)
    if signals.motors is None or interval is None:
        return None
    boot = failure.figures["boot"]
    commands = signals.motors.range_fractions(boot)
    usual = _usual_commands(signals, commands, boot, interval[0])
    at_failure = commands.within(interval)
    if not len(usual.time) or not len(at_failure.time):
        return None
    names = signals.motors.geometry.names
    return _LoggedCommands(names, commands, interval, usual, at_failure)


def _usual_commands(
    signals: Signals, commands: TimeSeries, boot: int, failure_time: float
) -> TimeSeries:
    """Selects the commands of the flight before a motor failed.

    The last twice ``RECOVERY_SECONDS`` are left out, in which the motor may have begun to fail, unless the flight is
    too short for that.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        commands: commands (N, k) of the k motors in the boot of the failure.
        boot: number of that boot.
        failure_time: time of the failure, s since boot.

    Returns:
        The commands; without samples if the failure was in no flight.
    """
    for take_off, landing in flights_in_boot(signals, boot):
        # An autopilot that stops the motors in the air ends the flight by that.
        if take_off <= failure_time <= landing + RECOVERY_SECONDS:
            before = commands.within((take_off, failure_time - 2 * RECOVERY_SECONDS))
            if len(before.time):
                return before
            return commands.within((take_off, failure_time - LASTING_SECONDS))
    return commands.select(slice(0))


def _change_of_commands(logged: _LoggedCommands, ending: Fact, scale: OutputScale) -> Facts:
    """Returns the fact how the command of the motor that failed changed, and those of the others.

    Args:
        logged: commands of all motors around the failure.
        ending: event with which the flight was lost; its subject is the motor.
        scale: range of the commands, with the limits that the autopilot sets.

    Returns:
        One fact; empty if the subject is not a motor.
    """
    change = logged.medians(ending.subject)
    if change is None:
        return ()
    cause = ending.figures["cause"]
    start, _ = change.interval
    end_time: float | None = None
    share = change.at_failure[change.motor]
    others_share = change.others(change.at_failure)
    if cause.code in CAUSES_BY_WEAK_MOTOR:
        # The controller drove the motor up before the vehicle fell, which changes the commands of all motors.
        end_time = start
        until_failure = logged.commands.within((-inf, end_time))
        start = _start_of_climb(logged.usual, until_failure, change.motor)
        last_commands = until_failure.within((end_time - AVERAGING_SECONDS, end_time))
        others_share = change.others(np.median(last_commands.values, axis=0))
        # The cause may begin in the sample before that with the highest command.
        until_soon_after = logged.commands.within((start, end_time + LASTING_SECONDS))
        highest = until_soon_after.values[:, change.motor].max()
        share = cause.figures.get("share") or highest
    is_at_limit, _ = samples_at_limits(np.array(share), scale)
    fact = supporting_fact(
        SensorFact.COMMANDS_CHANGED,
        subject=ending.subject,
        time=start,
        end_time=end_time,
        share_before=change.usual[change.motor],
        share=share,
        others_share_before=change.others(change.usual),
        others_share=others_share,
        is_at_limit=bool(is_at_limit),
    )
    return (fact,)


def _change_of_mean_command(logged: _LoggedCommands, ending: Fact) -> Facts:
    """Returns the fact how the mean command of all motors fell when they idled.

    Args:
        logged: commands of all motors around the loss.
        ending: event with which the flight was lost, with its cause.

    Returns:
        One fact; empty if another cause was found.
    """
    if ending.figures["cause"].code not in CAUSES_BY_ALL_MOTORS:
        return ()
    fact = supporting_fact(
        SensorFact.COMMANDS_CHANGED,
        time=logged.interval[0],
        share_before=float(np.median(logged.usual.values.mean(axis=1))),
        share=float(np.median(logged.at_failure.values.mean(axis=1))),
        is_at_limit=False,
    )
    return (fact,)


def _start_of_climb(usual: TimeSeries, until_failure: TimeSeries, motor: int) -> float:
    """Returns the time, s since boot, since which the command of a motor was farther above the others than usual.

    Args:
        usual: commands (N, k) of the k motors in the flight before.
        until_failure: commands (M, k) of the boot until the failure, at least one.
        motor: index of the motor.
    """
    usual_excess = _mean_excess(usual, motor)
    excess = _mean_excess(until_failure, motor)
    usual_rows = np.flatnonzero(excess <= np.quantile(usual_excess, USUAL_QUANTILE))
    first_row = usual_rows[-1] + 1 if len(usual_rows) else 0
    return float(until_failure.time[min(first_row, len(excess) - 1)])


def _mean_excess(commands: TimeSeries, motor: int) -> Array:
    """Returns the command of a motor above the mean of the others (N,), averaged over ``AVERAGING_SECONDS``.

    Args:
        commands: commands (N, k) of k motors in a boot.
        motor: index of the motor.
    """
    excess = commands.values[:, motor] - np.delete(commands.values, motor, axis=1).mean(axis=1)
    return moving_average(TimeSeries(commands.time, commands.boot, excess))


def _evidence_of_causing_event(ending: Fact, cause: Fact, events: Sequence[Fact]) -> Facts:
    """Returns the evidence for the event that caused a loss; empty if the cause is not an event, or has no evidence.

    Args:
        ending: event with which the flight was lost.
        cause: what failed first.
        events: events of the log, each a fact (a coded finding) with its time.
    """
    if cause.code is FailedFirst.HEIGHT_DIVERGED_FIRST:
        return tuple(cause.figures["cause"].figures.get("witnesses", ()))
    for event in events:
        is_standstill = event.code is MotionEvent.MOTOR_STOOD_STILL and event.is_bad
        is_cause = (
            cause.code is FailedFirst.MOTOR_STOOD_STILL_FIRST and event.subject == cause.subject
        )
        if is_standstill and is_cause and event.figures["boot"] == ending.figures["boot"]:
            return tuple(event.figures.get("witnesses", ()))
    return ()
