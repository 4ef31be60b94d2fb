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
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.ending import Ending, FailedFirst, MotionEvent
from mavdem.facts.events import ReportedEvent
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

START_OF_RISE = 0.1
"""Fraction of a rise at which it begins: the lower reference level of rise times in IEEE Std 181."""


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
        """Returns the mean of commands (k,) without the motor that failed."""
        return float(np.delete(commands, self.motor).mean())


def failure_commands(signals: Signals, failure: Fact) -> FailureCommands | None:
    """Returns the commands of all motors when one of them failed, and before.

    Each is a median over time. At the failure, that is the time of :func:`_failure_interval`: the first seconds if
    the flight was lost, since the vehicle tumbles afterwards, and longer if a motor only lost thrust.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        failure: the fact (coded finding) how the flight was lost, or that a motor lost thrust; its subject is the name
            of that motor.

    Returns:
        The commands; None if the fact is another one, or there is no sample in flight before the failure or at it.
    """
    logged = _logged_commands(signals, failure)
    if logged is None:
        return None
    return logged.medians(failure.subject)


def with_evidence_of_cause(
    signals: Signals, ending: Fact | None, events: Sequence[Fact]
) -> Fact | None:
    """Adds the evidence for the cause of a lost flight to the event of the loss.

    If the cause is an event of its own, such as a motor that stood still according to its speed controller, or a height
    estimate that diverged, the evidence for that event comes first. If a motor failed, what this motor and the others
    were commanded follows (:func:`failure_commands`); if all motors idled, their mean command. The sensor facts of the
    loss itself, such as the gyro's, are no evidence for its cause: they show only what followed.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        ending: event with which the flight was lost, with its cause as the figure ``cause``; None if it was not lost.
        events: events of the log, among them the one that is the cause.

    Returns:
        The event, with the evidence as the figure ``witnesses`` of its cause: a tuple of facts. It is unchanged if the
        cause or evidence for it was not found.
    """
    if ending is None:
        return None
    cause = ending.figures.get("cause")
    if cause is None:
        return ending
    evidence = list(_evidence_of_causing_event(ending, cause, events))
    logged_commands = _logged_commands(signals, ending)
    if logged_commands is not None and signals.motors is not None:
        evidence += _change_of_commands(logged_commands, ending, signals.motors.scale)
        evidence += _change_of_mean_command(logged_commands, ending)
    if not evidence:
        return ending
    return ending.replace(cause=cause.replace(witnesses=tuple(evidence)))


def _failure_interval(failure: Fact) -> TimeInterval | None:
    """Returns the interval in which the commands of the motors show which motor failed.

    - If a motor lost thrust, it begins with that loss, and lasts twice ``RECOVERY_SECONDS`` at most.
    - If the flight was lost because a motor failed, it begins with the failure, and ends ``AVERAGING_SECONDS`` later or
      at the impact.

    Args:
        failure: the fact that a motor lost thrust; or that the flight was lost, with its cause in the figure "cause".

    Returns:
        Start and end, s since boot; None if the flight was lost for another reason than the motors.
    """
    if failure.code in LOSSES_OF_THRUST:
        start = failure.start_time
        return start, min(failure.latest_time, start + 2 * RECOVERY_SECONDS)
    cause = failure.figures.get("cause")
    onset = loss_onset(failure)
    if cause is None or onset is None:
        return None
    causes_by_motors = (*CAUSES_BY_WEAK_MOTOR, *CAUSES_BY_OUTPUT, *CAUSES_BY_ALL_MOTORS)
    if cause.code not in causes_by_motors:
        return None
    start = cause.time
    if start is None:
        # An output that froze has no time: it stood still when the attitude left its setpoint.
        start = onset
    end = start + AVERAGING_SECONDS
    if failure.code is Ending.CRASHED:
        impact_time = failure.start_time
        end = max(min(end, impact_time), start)
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
        """Returns the median command of every motor before and at the failure of one of them.

        Args:
            motor: subject of the failure: the name of the motor that failed, or another one, such as the vehicle.

        Returns:
            The medians; None if the subject is none of the motors.
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
    """Selects the commands of all motors in the flight before a failure, and at the failure.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        failure: how the flight was lost, or that a motor lost thrust.

    Returns:
        The commands; None if no motor failed, or there is no sample in flight before the failure or at it.
    """
    interval = _failure_interval(failure)
    if signals.motors is None or interval is None:
        return None
    failure_time, _ = interval
    boot = failure.figures["boot"]
    commands = signals.motors.range_fractions(boot)
    commands_before = _usual_commands(signals, commands, boot, failure_time)
    commands_at_failure = commands.within(interval)
    if not len(commands_before.time) or not len(commands_at_failure.time):
        return None
    return _LoggedCommands(
        signals.motors.geometry.names, commands, interval, commands_before, commands_at_failure
    )


def _usual_commands(
    signals: Signals, commands: TimeSeries, boot: int, failure_time: float
) -> TimeSeries:
    """Selects the commands of the flight before a motor failed, with which those at the failure are compared.

    The last twice ``RECOVERY_SECONDS`` are left out, in which the motor may have begun to fail. If the flight is too
    short for that, only the last ``LASTING_SECONDS`` are left out.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        commands: commands (N, k) of the k motors in the boot of the failure.
        boot: number of that boot.
        failure_time: time of the failure, s since boot.

    Returns:
        The commands; without samples if the failure was in no flight.
    """
    for take_off, landing in flights_in_boot(signals, boot):
        # An autopilot that stops the motors in the air ends the flight by that, so the failure may be a little later.
        is_in_flight = take_off <= failure_time <= landing + RECOVERY_SECONDS
        if not is_in_flight:
            continue
        usual_commands = commands.within((take_off, failure_time - 2 * RECOVERY_SECONDS))
        if not len(usual_commands.time):
            usual_commands = commands.within((take_off, failure_time - LASTING_SECONDS))
        return usual_commands
    no_samples = slice(0)
    return commands.select(no_samples)


def _change_of_commands(logged: _LoggedCommands, ending: Fact, scale: OutputScale) -> Facts:
    """Returns the fact of how the command of the motor that failed changed, and the mean command of the others.

    A motor that stopped is shown by the median commands after it stopped. A motor that lost thrust is shown before the
    vehicle fell, while the controller drove it up: from when its command climbed above the others' until the failure.

    Args:
        logged: commands of all motors around the failure.
        ending: event with which the flight was lost; its subject is the motor.
        scale: range of the commands, with the limits that the autopilot sets.

    Returns:
        One fact with the commands before and at the failure, as fractions of their range; empty if the subject is not a
        motor.
    """
    change = logged.medians(ending.subject)
    if change is None:
        return ()
    cause = ending.figures["cause"]
    start_time, _ = change.interval
    end_time: float | None = None
    command = change.at_failure[change.motor]
    mean_of_others = change.others(change.at_failure)
    if cause.code in CAUSES_BY_WEAK_MOTOR:
        end_time = start_time
        until_failure = logged.commands.within((-inf, end_time))
        start_time = _start_of_climb(logged.usual, until_failure, change.motor)
        last_commands = until_failure.within((end_time - AVERAGING_SECONDS, end_time))
        mean_of_others = change.others(np.median(last_commands.values, axis=0))
        # The command may be the highest one sample after the cause began.
        until_soon_after = logged.commands.within((start_time, end_time + LASTING_SECONDS))
        highest_command = until_soon_after.values[:, change.motor].max()
        command = cause.figures.get("share") or highest_command
    is_at_limit, _ = samples_at_limits(np.array(command), scale)
    fact = supporting_fact(
        SensorFact.COMMANDS_CHANGED,
        subject=ending.subject,
        time=start_time,
        end_time=end_time,
        share_before=change.usual[change.motor],
        share=command,
        others_share_before=change.others(change.usual),
        others_share=mean_of_others,
        is_at_limit=bool(is_at_limit),
    )
    return (fact,)


def _change_of_mean_command(logged: _LoggedCommands, ending: Fact) -> Facts:
    """Returns the fact of how far the mean command of all motors fell when all of them idled.

    Args:
        logged: commands of all motors around the loss.
        ending: event with which the flight was lost, with its cause as the figure ``cause``.

    Returns:
        One fact with the median of the mean command before and at the failure, as fractions of its range; empty if the
        cause is not that all motors idled (``CAUSES_BY_ALL_MOTORS``).
    """
    if ending.figures["cause"].code not in CAUSES_BY_ALL_MOTORS:
        return ()
    failure_time, _ = logged.interval
    mean_commands_before = logged.usual.values.mean(axis=1)
    mean_commands_at_failure = logged.at_failure.values.mean(axis=1)
    fact = supporting_fact(
        SensorFact.COMMANDS_CHANGED,
        time=failure_time,
        share_before=float(np.median(mean_commands_before)),
        share=float(np.median(mean_commands_at_failure)),
        is_at_limit=False,
    )
    return (fact,)


def _start_of_climb(usual: TimeSeries, until_failure: TimeSeries, motor: int) -> float:
    """Returns when the command of a motor began to climb above the others', before the motor failed.

    The excess of a command is how much it is above the mean of the others. The climb begins after the last sample whose
    excess, averaged over ``AVERAGING_SECONDS``, is at most :func:`_max_excess_before_climb`.

    Args:
        usual: commands (N, k) of the k motors in the flight before.
        until_failure: commands (M, k) of the boot until the failure, at least one.
        motor: index of the motor.

    Returns:
        The time, s since boot. It is the time of the first sample if no excess was so small, and the time of the last
        sample if that excess still is.
    """
    excess = _excess(until_failure, motor)
    max_excess_before = _max_excess_before_climb(_excess(usual, motor), excess)
    samples_before_climb = np.flatnonzero(moving_average(excess) <= max_excess_before)
    if not len(samples_before_climb):
        return float(excess.time[0])
    last_sample = len(excess.time) - 1
    first_sample_of_climb = min(samples_before_climb[-1] + 1, last_sample)
    return float(excess.time[first_sample_of_climb])


def _max_excess_before_climb(usual: TimeSeries, until_failure: TimeSeries) -> float:
    """Returns the largest excess of a motor's command that still counts as usual: above it, the climb has begun.

    The excess of a command is how much it is above the mean of the other motors' commands. The limit is the larger of
    two levels: the ``USUAL_QUANTILE`` of the excess in the flight before; and its median there plus ``START_OF_RISE``
    of the rise to the highest excess of the last ``AVERAGING_SECONDS``. By the first alone, a little more lean in the
    wind, seconds before a sudden failure, would be the beginning of a slow one.

    Args:
        usual: excess (N,) in the flight before, as a fraction of the range.
        until_failure: excess (M,) of the boot until the failure, at least one sample, as a fraction of the range.

    Returns:
        The limit, as a fraction of the range.
    """
    usual_means = moving_average(usual)
    median = np.median(usual_means)
    failure_time = until_failure.time[-1]
    last_seconds = until_failure.within((failure_time - AVERAGING_SECONDS, failure_time))
    rise = last_seconds.values.max() - median
    return max(
        float(np.quantile(usual_means, USUAL_QUANTILE)), float(median + START_OF_RISE * rise)
    )


def _excess(commands: TimeSeries, motor: int) -> TimeSeries:
    """Returns by how much the command of one motor exceeds the mean command of the other motors, over time.

    Args:
        commands: commands (N, k) of k motors in a boot, as fractions of their range.
        motor: index of the motor.

    Returns:
        The excess (N,), negative where the motor is commanded less.
    """
    mean_of_others = np.delete(commands.values, motor, axis=1).mean(axis=1)
    excess = commands.values[:, motor] - mean_of_others
    return TimeSeries(commands.time, commands.boot, excess)


def _evidence_of_causing_event(ending: Fact, cause: Fact, events: Sequence[Fact]) -> Facts:
    """Returns the evidence for the event that caused the loss of a flight.

    Two causes are events with evidence of their own: a height estimate that diverged, and a motor that stood still. A
    landing that was only assumed is supported by the landing that the autopilot reported in flight.

    Args:
        ending: event with which the flight was lost.
        cause: what failed first.
        events: events of the log, each a fact (a coded finding) with its time.

    Returns:
        Facts about what sensors show of the event; empty if the cause is none of these events, or has no evidence.
    """
    if cause.code is FailedFirst.HEIGHT_DIVERGED_FIRST:
        return tuple(cause.figures["cause"].figures.get("witnesses", ()))
    if cause.code is FailedFirst.LANDING_ASSUMED_FIRST:
        return _reported_landings(ending, events)
    if cause.code is not FailedFirst.MOTOR_STOOD_STILL_FIRST:
        return ()
    for event in events:
        is_standstill = event.code is MotionEvent.MOTOR_STOOD_STILL and event.is_bad
        is_same_motor = event.subject == cause.subject
        if is_standstill and is_same_motor and event.figures["boot"] == ending.figures["boot"]:
            return tuple(event.figures.get("witnesses", ()))
    return ()


def raise_level_of_assumed_landings(ending: Fact | None, events: Sequence[Fact]) -> list[Fact]:
    """Raises the level of landings that the autopilot assumed in the air to "bad", if that lost the flight.

    Args:
        ending: event with which the flight was lost, with its figure ``cause``; None if it was not lost.
        events: events of the log, each a fact (a coded finding) with its time.

    Returns:
        All events, in the same order.
    """
    if ending is None:
        return list(events)
    cause = ending.figures.get("cause")
    if cause is None or cause.code is not FailedFirst.LANDING_ASSUMED_FIRST:
        return list(events)
    # The evidence of such a loss is the autopilot's report of the landing, which has the event itself as its cause.
    assumed_landings = [report.figures["cause"] for report in _reported_landings(ending, events)]
    events_with_level = []
    for event in events:
        is_assumed_landing = event in assumed_landings
        events_with_level.append(event.replace(Level.BAD) if is_assumed_landing else event)
    return events_with_level


def _reported_landings(ending: Fact, events: Sequence[Fact]) -> Facts:
    """Returns the landing that the autopilot reported in flight within ``RECOVERY_SECONDS`` before the flight was lost.

    Args:
        ending: event with which the flight was lost.
        events: events of the log, each a fact (a coded finding) with its time.

    Returns:
        One fact for each such report; empty if there was none.
    """
    onset = loss_onset(ending) or 0.0
    reports = []
    for event in events:
        is_landing = event.code is ReportedEvent.LANDING_DETECTED_IN_FLIGHT
        is_same_boot = event.figures.get("boot") == ending.figures["boot"]
        if is_landing and is_same_boot and 0.0 <= onset - event.start_time <= RECOVERY_SECONDS:
            reports.append(supporting_fact(SensorFact.AUTOPILOT_REPORTED, cause=event))
    return tuple(reports)
