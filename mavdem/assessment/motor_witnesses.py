"""Witnesses of the loss of a motor, facts (coded findings) for or against it: command, attitude, height and reports.

The loss itself is found by the commands of all motors; these statements show what else of the flight agrees with it.
"""

from collections.abc import Sequence

from mavdem.assessment.attitude_error import attitude_error, largest_error
from mavdem.assessment.flights import RECOVERY_SECONDS, flights_in_boot
from mavdem.assessment.motor_speeds import (
    MIN_COMMAND_RISE,
    MIN_LEAN_ERROR,
    command_change,
    reports_on_motor,
    rise_statement,
    speed_statements,
)
from mavdem.dataset.intervals import TimeInterval, in_intervals
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Facts
from mavdem.facts.witnesses import SensorStatement
from mavdem.witnesses.boot_sensors import BootSensors
from mavdem.witnesses.statements import supporting_statement, supporting_statements

MIN_MEDIAN_RISE = MIN_COMMAND_RISE / 2
"""Rise of a motor's median command, as a share of the range, that supports its loss: a slow loss has most of its rise
later, and a rise as small as the trims of sound motors is no witness."""


def with_motor_witnesses(
    signals: Signals, losses: Sequence[Fact], reports: Sequence[Fact]
) -> list[Fact]:
    """Adds the witnesses to each loss of a motor.

    Args:
        signals: signals of the vehicle.
        losses: facts with the name of a motor as subject, and their ``boot``.
        reports: events that the autopilot reports.

    Returns:
        All facts, in the same order; those that name no motor are unchanged.
    """
    facts = []
    for loss in losses:
        witnesses = _witnesses(signals, loss, reports)
        facts.append(loss.replace(witnesses=witnesses) if witnesses else loss)
    return facts


def _witnesses(signals: Signals, loss: Fact, reports: Sequence[Fact]) -> Facts:
    """Collects the witnesses of one loss, from its beginning for up to twice ``RECOVERY_SECONDS``.

    Args:
        signals: signals of the vehicle.
        loss: event that a motor was lost.
        reports: events that the autopilot reports.

    Returns:
        The statements that support or contradict it.
    """
    motors = signals.motors
    if motors is None or loss.time is None or loss.subject not in motors.geometry.names:
        return ()
    boot = loss.figures["boot"]
    interval = (loss.time, min(loss.latest_time, loss.time + 2 * RECOVERY_SECONDS))
    return (
        *_rise_of_command(signals, loss, interval),
        *_loss_of_attitude(signals, boot, interval),
        *_fast_descent(signals, boot, interval),
        *speed_statements(signals, loss),
        *reports_on_motor(reports, boot, loss.subject, interval),
    )


def _rise_of_command(signals: Signals, loss: Fact, interval: TimeInterval) -> Facts:
    """Returns the statement by how much the command of a motor rose, which supports that the motor lost thrust.

    The controller raises the command to make up for the lost thrust. If the loss was detected by the excess of the
    command over those of the other motors, that excess is stated instead.

    Args:
        signals: signals of the vehicle.
        loss: event in which a motor lost thrust.
        interval: start and end of the loss, s since boot.

    Returns:
        One fact, ``COMMAND_ABOVE_OTHERS`` or ``COMMAND_ROSE``; empty if the command hardly rose.
    """
    motors = signals.motors
    assert motors is not None
    excess = loss.figures.get("excess")
    if excess is not None:
        above_others = supporting_statement(
            SensorStatement.COMMAND_ABOVE_OTHERS,
            time=loss.time,
            end_time=loss.end_time,
            share=excess,
        )
        return (above_others,)
    commands = motors.range_fractions(loss.figures["boot"])
    motor = motors.geometry.names.index(loss.subject)
    change = command_change(commands.time, commands.values[:, motor], interval, later_quantile=0.5)
    if change is None or change.rise < MIN_MEDIAN_RISE:
        return ()
    return (rise_statement(change, interval),)


def _loss_of_attitude(signals: Signals, boot: int, interval: TimeInterval) -> Facts:
    """Returns the statement that the attitude left its setpoint, which supports that a motor was lost.

    If it did not, that proves nothing, since other motors may hold the attitude. If no setpoint was recorded, only a
    share of the lean counts as error (:func:`mavdem.assessment.attitude_error.attitude_error`), but the fact states the
    whole lean.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
        interval: start and end of the loss, s since boot.

    Returns:
        One fact, ``ATTITUDE_LEFT_SETPOINT`` with the largest error; empty if the error stayed below ``MIN_LEAN_ERROR``,
        or was not recorded.
    """
    error = attitude_error(signals, boot)
    if error is None:
        return ()
    largest = largest_error(error, interval)
    if largest is None or largest.counted_angle < MIN_LEAN_ERROR:
        return ()
    return (supporting_statement(SensorStatement.ATTITUDE_LEFT_SETPOINT, **largest._asdict()),)


def _fast_descent(signals: Signals, boot: int, interval: TimeInterval) -> Facts:
    """Returns the statements of height sensors that the vehicle sank fast, which support that a motor was lost.

    Args:
        signals: signals of the vehicle.
        boot: number of the boot.
        interval: start and end of the loss, s since boot.

    Returns:
        A fact for each sensor; empty if none shows it, or the loss did not begin in a flight.
    """
    loss_start, _ = interval
    for flight in flights_in_boot(signals, boot):
        if in_intervals(loss_start, [flight]):
            take_off, _ = flight
            return supporting_statements(
                BootSensors(signals, boot, take_off).sink_statements(interval)
            )
    return ()
