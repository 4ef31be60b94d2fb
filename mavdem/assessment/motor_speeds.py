"""Motors that stand still, by the speeds that their controllers (ESCs) measure, as facts (coded findings).

A motor that is commanded to turn and does not turn is lost. But a controller that no longer reports may send a speed of
0, so that a second sensor must confirm the loss: the vehicle leans, the command rises to compensate, or the autopilot
reports the motor. If a motor lost thrust but turns as before, its propeller is the cause.
"""

from bisect import insort
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.assessment.motor_events import lasting_runs
from mavdem.dataset.attitude_error import AttitudeError, largest_error
from mavdem.dataset.flight_states import min_airborne_collective
from mavdem.dataset.grounded import MAX_SETPOINT_DELAY
from mavdem.dataset.intervals import TimeInterval, in_intervals
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.signals import Signals
from mavdem.dataset.speed_controllers import SpeedController, speed_controllers
from mavdem.dataset.time_series import TimeSeries, series_of_boot
from mavdem.facts import Fact, Facts
from mavdem.facts.ending import MotionEvent
from mavdem.facts.events import ReportedEvent
from mavdem.facts.witnesses import SensorFact
from mavdem.ingest.motors import name_without_place
from mavdem.witnesses.boot_sensors import BootSensors
from mavdem.witnesses.sensor_facts import (
    checked_event,
    contradicting_fact,
    supporting_fact,
)

STANDSTILL_FRACTION = 0.05
"""Speed, as a fraction of the usual one in flight, below which a motor stands still; an idle motor has over 0.2."""

MIN_USUAL_SAMPLES = 5
"""Number of samples in flight before, whose median is the usual speed of a motor; a choice."""

MIN_LEAN_ERROR = np.radians(5.0)
"""Error of the attitude, rad, that shows that a motor does not hold the vehicle; sound ones stay below 3°."""

HIGHEST_COMMAND_QUANTILE = 0.95
"""Quantile of a motor's commands that is used as the highest one, so that single peaks have no effect; a choice."""

MIN_COMMAND_RISE = 0.1
"""Rise of a motor's command, as a fraction of the range, that makes up for lost thrust; 99 % of trims vary less."""

MIN_SPEED_CHANGE = 0.1
"""Change of a motor's speed, relative to the usual one, that counts; the battery's voltage changes it by less."""


REPORTS_OF_MOTOR = (ReportedEvent.MOTOR_FAILED, ReportedEvent.THRUST_LOST)
"""Reports of the autopilot on one motor."""


class SamplesAround(NamedTuple):
    """Samples of a motor's command or speed before a loss of its thrust and in it."""

    before: Array
    """(N,) of twice ``RECOVERY_SECONDS`` before."""

    during: Array
    """(M,) in the loss."""


class CommandChange(NamedTuple):
    """Command of one motor before a loss of thrust and in it, as fractions of the motor's range."""

    before: float
    """Median before the loss."""

    later: float
    """Quantile of the commands in the loss."""

    @property
    def rise(self) -> float:
        """By how much the later command is higher; negative if it fell."""
        return self.later - self.before


def standing_motors(
    sensors: BootSensors,
    error: AttitudeError,
    flight_interval: TimeInterval,
    reports: Sequence[Fact],
) -> Iterator[Fact]:
    """Yields an event for each time in a flight in which a motor stood still while it was commanded to turn.

    Args:
        sensors: sensors of the boot, with the take-off of this flight.
        error: error of the attitude in this boot.
        flight_interval: start and end of the flight, s since boot.
        reports: events that the autopilot reports.

    Yields:
        Facts with the name of the motor as subject, the ``name`` of its controller, its mean command as ``share`` of
        the range, and ``witnesses``: what sensors show for or against the standstill.
    """
    motors = sensors.signals.motors
    if motors is None or sensors.boot not in motors.boot:
        return
    for controller in speed_controllers(sensors.signals):
        motor = controller.motor_index(motors.geometry)
        speed = series_of_boot(controller.speed, sensors.boot)
        if motor is None or speed is None:
            continue
        speed_in_flight = speed.within(flight_interval)
        command = _commands_at(motors, sensors.boot, motor, speed_in_flight.time)
        for interval in _standstill_intervals(sensors.signals, speed_in_flight, command):
            yield _standstill(sensors, error, reports, controller, motor, interval)


def _commands_at(motors: MotorOutputs, boot: int, motor: int, time: Array) -> TimeSeries:
    """Returns the command of a motor as fractions of its range, at some times.

    Args:
        motors: outputs and geometry of all motors.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        motor: index of the motor.
        time: (N,) s since boot.

    Returns:
        Commands (N,), as fractions of the range.
    """
    commands = motors.motor_fractions(boot, motor)
    commands_at_time = np.interp(time, commands.time, commands.values)
    return TimeSeries(time, np.full(len(time), boot), commands_at_time)


def _standstill_intervals(
    signals: Signals, speed: TimeSeries, command: TimeSeries
) -> Iterator[TimeInterval]:
    """Yields the intervals in which a motor stood still although it was commanded to turn, s since boot.

    It must have turned in this flight before, which shows that its controller measures the speed. The motor stands
    still if its speed is far below the usual one of that time.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        speed: speed of the motor in flight (N,), 1/min.
        command: command of the motor at the same times (N,), as fractions of its range.
    """
    is_commanded = command.values > min_airborne_collective(signals.telemetry.parameters)
    is_standing = is_commanded & _is_far_below_usual(speed.values)
    yield from lasting_runs(speed.time, is_standing, RECOVERY_SECONDS)


def _is_far_below_usual(speeds: Array) -> Flags:
    """Determines at which samples a motor turns with less than ``STANDSTILL_FRACTION`` of its usual speed.

    The usual speed is the median of the earlier samples that are not so low themselves, since a lost motor may turn on
    slowly in the wind. Until there are ``MIN_USUAL_SAMPLES`` of these, no sample counts as low.

    Args:
        speeds: speeds of the motor in flight (N,), 1/min.

    Returns:
        (N,) whether it does.
    """
    is_low = np.zeros(len(speeds), np.bool_)
    usual_speeds: list[float] = []
    for sample, speed in enumerate(speeds.tolist()):
        if len(usual_speeds) >= MIN_USUAL_SAMPLES:
            # The speeds are in ascending order, so that the one in the middle is their median.
            median = usual_speeds[len(usual_speeds) // 2]
            is_low[sample] = speed < STANDSTILL_FRACTION * median
        if speed > 0 and not is_low[sample]:
            insort(usual_speeds, speed)
    return is_low


def _standstill(
    sensors: BootSensors,
    error: AttitudeError,
    reports: Sequence[Fact],
    controller: SpeedController,
    motor: int,
    interval: TimeInterval,
) -> Fact:
    """Returns the event that a motor stood still, which is bad if a second sensor confirms it.

    Args:
        sensors: sensors of the vehicle in one boot, which lasts from one start of the autopilot to the next.
        error: error of the attitude in this boot.
        reports: events that the autopilot reports.
        controller: speed controller (ESC) of the motor, which measures its speed.
        motor: index of the motor.
        interval: time when the controller measured no rotation, s since boot; the end may be infinite.

    Returns:
        The event, with the mean command of the motor in that time as ``share`` of its range.
    """
    motors = sensors.signals.motors
    assert motors is not None
    name = motors.geometry.names[motor]
    start, interval_end = interval
    end = min(interval_end, sensors.record_end)
    recorded_interval = (start, end)
    command = motors.motor_fractions(sensors.boot, motor)
    is_in_interval = in_intervals(command.time, [recorded_interval])
    mean_command = 0.0
    if is_in_interval.any():
        mean_command = float(command.values[is_in_interval].mean())
    no_rotation = supporting_fact(
        SensorFact.SPEED_ZERO,
        time=start,
        end_time=end,
        name=controller.name,
        duration=end - start,
        share=mean_command,
    )
    sensor_facts = (
        no_rotation,
        *_error_count_fact(controller, sensors.boot, recorded_interval),
        *_reaction_of_command(command, recorded_interval),
        *_reaction_of_attitude(error, recorded_interval),
        *reports_on_motor(reports, sensors.boot, name, recorded_interval),
    )
    event = Fact(
        MotionEvent.MOTOR_STOOD_STILL,
        time=start,
        end_time=None if np.isinf(interval_end) else interval_end,
        subject=name,
        name=controller.name,
        share=mean_command,
        boot=sensors.boot,
    )
    return checked_event(event, sensor_facts)


def _reaction_of_command(command: TimeSeries, interval: TimeInterval) -> Facts:
    """Returns the fact whether the command of a motor rose while its measured speed was zero.

    If the motor really stood still, its thrust was missing, and the flight controller raised the command to make up for
    it. If the command stayed as it was, the thrust was there, and the measured speed is wrong.

    Args:
        command: command of the motor in the boot (N,), as fractions of the range.
        interval: start and end of the time when its speed was zero, s since boot.

    Returns:
        One fact: a command that rose supports that the motor stood still, an unchanged one contradicts it. Empty if no
        command was recorded in the interval, or in the seconds before it (:func:`command_change`).
    """
    change = command_change(command.time, command.values, interval, HIGHEST_COMMAND_QUANTILE)
    if change is None:
        return ()
    if change.rise > MIN_COMMAND_RISE:
        return (rise_fact(change, interval),)
    start, end = interval
    usual_command = change.before
    unchanged_fact = contradicting_fact(
        SensorFact.COMMAND_UNCHANGED, share=usual_command, time=start, end_time=end
    )
    return (unchanged_fact,)


def command_change(
    time: Array, commands: Array, interval: TimeInterval, quantile_during: float
) -> CommandChange | None:
    """Compares the commands of a motor in an interval with those before.

    Args:
        time: time of the commands (N,), s since boot.
        commands: commands of the motor (N,), as fractions of its range.
        interval: start and end of a loss of the motor, s since boot.
        quantile_during: quantile by which the commands in the interval are summarised, 0 to 1; 0.5 is their median.

    Returns:
        The commands before and in the interval; None without a sample in either (:func:`samples_around`).
    """
    commands_before, commands_during = samples_around(time, commands, interval)
    if not len(commands_before) or not len(commands_during):
        return None
    return CommandChange(
        float(np.median(commands_before)), float(np.quantile(commands_during, quantile_during))
    )


def rise_fact(change: CommandChange, interval: TimeInterval) -> Fact:
    """Returns the fact that the command of a motor rose, which supports that the motor lost thrust.

    The controller raises the command of a weak motor, since it needs the same thrust of it as before.

    Args:
        change: its commands before and in the interval.
        interval: start and end of the loss, s since boot.

    Returns:
        A fact in favour of the loss, with the commands in and before it as the figures ``share`` and ``share_before``,
        fractions of the motor's range.
    """
    start, end = interval
    return supporting_fact(
        SensorFact.COMMAND_ROSE,
        share=change.later,
        share_before=change.before,
        time=start,
        end_time=end,
    )


def _reaction_of_attitude(error: AttitudeError, interval: TimeInterval) -> Facts:
    """Returns the fact whether the attitude left its setpoint while the measured speed of a motor was zero.

    If the motor really stood still, the vehicle leans to the side of the missing thrust. If the attitude stayed at its
    setpoint, the thrust was there, and the measured speed is wrong.

    Args:
        error: error of the attitude in the boot.
        interval: start and end of the time when the speed was zero, s since boot.

    Returns:
        One fact: ``ATTITUDE_LEFT_SETPOINT`` supports that the motor stood still, ``ATTITUDE_HELD`` contradicts it.
        Empty if no attitude was recorded in the interval or just before it.
    """
    start, end = interval
    interval_of_error = (start - MAX_SETPOINT_DELAY, end)
    peak_error = largest_error(error, interval_of_error)
    if peak_error is None:
        return ()
    if peak_error.counted_angle > MIN_LEAN_ERROR:
        return (supporting_fact(SensorFact.ATTITUDE_LEFT_SETPOINT, **peak_error._asdict()),)
    attitude_held = contradicting_fact(
        SensorFact.ATTITUDE_HELD,
        time=interval_of_error[0],
        end_time=end,
        angle=peak_error.angle,
        has_setpoint=peak_error.has_setpoint,
    )
    return (attitude_held,)


def _error_count_fact(controller: SpeedController, boot: int, interval: TimeInterval) -> Facts:
    """Returns the fact that a motor's controller counted errors in an interval, or shortly before it.

    The errors may precede the interval by ``MAX_SETPOINT_DELAY``, as long as a vehicle may take to show a fault.

    Args:
        controller: the speed controller of the motor, which may count its errors.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        interval: start and end, s since boot.

    Returns:
        One fact with the number of errors; empty if none was counted or the controller does not count.
    """
    errors = series_of_boot(controller.error_count, boot)
    if errors is None:
        return ()
    start, end = interval
    count_start = start - MAX_SETPOINT_DELAY
    # The controller counts all errors since it was switched on.
    count_before, count_after = np.interp([count_start, end], errors.time, errors.values)
    count = int(count_after - count_before)
    if count <= 0:
        return ()
    counted_errors_fact = supporting_fact(
        SensorFact.ERRORS_COUNTED,
        time=count_start,
        end_time=end,
        name=controller.name,
        count=count,
    )
    return (counted_errors_fact,)


def reports_on_motor(
    reports: Sequence[Fact], boot: int, name: str, interval: TimeInterval
) -> list[Fact]:
    """Collects the autopilot's reports on a motor within ``RECOVERY_SECONDS`` of an interval.

    Args:
        reports: events that the autopilot reports.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        name: name of the motor, which may have its place in brackets: "motor 2 (rear left)".
        interval: start and end, s since boot.

    Returns:
        A fact for each report, which supports that the motor was lost.
    """
    start, end = interval
    earliest_time = start - RECOVERY_SECONDS
    latest_time = end + RECOVERY_SECONDS
    supporting_reports = []
    for report in reports:
        is_of_motor = report.subject == name_without_place(name)
        is_in_time = earliest_time <= report.start_time <= latest_time
        is_near = report.figures["boot"] == boot and is_in_time
        if report.code in REPORTS_OF_MOTOR and is_of_motor and is_near:
            supporting_reports.append(supporting_fact(SensorFact.AUTOPILOT_REPORTED, cause=report))
    return supporting_reports


def speed_facts(signals: Signals, loss: Fact) -> Facts:
    """Returns the fact by which the measured speed shows whether a motor itself lost thrust, or its propeller.

    If the motor turned more slowly although its command did not fall, the motor is the cause. If it turned as fast as
    before or faster, the propeller is.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        loss: the loss of thrust, with the motor as subject.

    Returns:
        One fact: ``MOTOR_SLOWED`` supports that the motor was lost, ``MOTOR_TURNED`` contradicts it. Empty if the speed
        was not measured before and in the loss, or if speed and command fell together, which shows neither.
    """
    motors = signals.motors
    if motors is None or loss.time is None or loss.subject not in motors.geometry.names:
        return ()
    boot = loss.figures["boot"]
    motor = motors.geometry.names.index(loss.subject)
    end = loss.time + 2 * RECOVERY_SECONDS if loss.end_time is None else loss.end_time
    interval = (loss.time, end)
    for controller in speed_controllers(signals):
        if controller.motor_index(motors.geometry) != motor:
            continue
        change = _speed_change(series_of_boot(controller.speed, boot), interval)
        if change is None:
            continue
        figures = {
            "time": loss.time,
            "end_time": loss.end_time,
            "name": controller.name,
            "rotation": change.later,
            "rotation_before": change.before,
        }
        if not change.has_slowed:
            return (contradicting_fact(SensorFact.MOTOR_TURNED, **figures),)
        if _has_lower_command(motors, boot, motor, interval):
            # A motor that was commanded to turn slower did not lose thrust by itself.
            return ()
        return (supporting_fact(SensorFact.MOTOR_SLOWED, **figures),)
    return ()


class _SpeedChange(NamedTuple):
    """Median speed of a motor before a loss of thrust and in it, 1/min."""

    before: float
    later: float

    @property
    def has_slowed(self) -> bool:
        """Whether the speed fell by more than ``MIN_SPEED_CHANGE``."""
        return self.later < (1 - MIN_SPEED_CHANGE) * self.before


def _speed_change(speed: TimeSeries | None, interval: TimeInterval) -> _SpeedChange | None:
    """Compares the speeds of a motor in an interval with those before.

    Args:
        speed: speed of the motor (N,) in one boot, 1/min; None if it was not measured.
        interval: start and end of a loss of the motor, s since boot.

    Returns:
        The median speeds; None without ``MIN_USUAL_SAMPLES`` before and in the interval, or if the motor stood still
        before it.
    """
    if speed is None:
        return None
    speeds_before, speeds_during = samples_around(speed.time, speed.values, interval)
    if min(len(speeds_before), len(speeds_during)) < MIN_USUAL_SAMPLES:
        return None
    change = _SpeedChange(float(np.median(speeds_before)), float(np.median(speeds_during)))
    return change if change.before > 0 else None


def samples_around(time: Array, values: Array, interval: TimeInterval) -> SamplesAround:
    """Selects the samples before and in an interval.

    Args:
        time: time of the samples (N,), s since boot.
        values: command or speed of a motor (N,).
        interval: start and end of the loss, s since boot.

    Returns:
        The samples in twice ``RECOVERY_SECONDS`` before the interval, and those in it; either may be empty.
    """
    start, _ = interval
    return SamplesAround(
        before=values[in_intervals(time, [(start - 2 * RECOVERY_SECONDS, start)])],
        during=values[in_intervals(time, [interval])],
    )


def _has_lower_command(motors: MotorOutputs, boot: int, motor: int, interval: TimeInterval) -> bool:
    """Returns whether a motor was commanded to turn slower during a loss of thrust than just before it.

    The medians of both times are compared. The command counts as lower if it fell by more than the fraction
    ``MIN_SPEED_CHANGE``.

    Args:
        motors: outputs and geometry of all motors.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        motor: index of the motor.
        interval: start and end of the loss, s since boot.
    """
    commands = motors.motor_fractions(boot, motor)
    change = command_change(commands.time, commands.values, interval, quantile_during=0.5)
    if change is None:
        return False
    return change.later < (1 - MIN_SPEED_CHANGE) * change.before
