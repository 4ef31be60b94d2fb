"""Facts (coded findings) that support or contradict the loss of a motor: its command, the attitude, height and reports.

The loss itself is found by the commands of all motors; these facts show what else of the flight agrees with it.
"""

from collections.abc import Sequence

import numpy as np

from mavdem.assessment.flights import RECOVERY_SECONDS, flights_in_boot
from mavdem.assessment.motor_speeds import (
    MIN_COMMAND_RISE,
    MIN_LEAN_ERROR,
    command_change,
    reports_on_motor,
    rise_fact,
    speed_facts,
)
from mavdem.dataset.attitude_error import attitude_error, largest_error
from mavdem.dataset.intervals import TimeInterval, in_intervals
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact, Facts
from mavdem.facts.witnesses import SensorFact
from mavdem.witnesses.boot_sensors import BootSensors
from mavdem.witnesses.sensor_facts import supporting_fact, supporting_facts

MIN_MEDIAN_RISE = MIN_COMMAND_RISE / 2
"""Rise of a motor's median command, as a fraction of the range, that supports its loss: a slow loss has most of its
rise later, and a rise as small as the trims of sound motors supports nothing."""


def with_sensor_evidence(
    signals: Signals, losses: Sequence[Fact], reports: Sequence[Fact]
) -> list[Fact]:
    """Adds to each loss of a motor what sensors and reports show for or against it, as the figure ``witnesses``.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        losses: facts with the name of a motor as subject, and their ``boot``.
        reports: events that the autopilot reports.

    Returns:
        All losses, in the same order; events that name no motor, or about which nothing was recorded, are unchanged.
    """
    completed_losses = []
    for loss in losses:
        sensor_facts = _sensor_facts_on_loss(signals, loss, reports)
        if sensor_facts:
            loss = loss.replace(witnesses=sensor_facts)
        completed_losses.append(loss)
    return completed_losses


def _sensor_facts_on_loss(signals: Signals, loss: Fact, reports: Sequence[Fact]) -> Facts:
    """Collects what sensors and reports show for or against a loss, up to twice ``RECOVERY_SECONDS`` after its start.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        loss: event that a motor was lost; its subject is the motor.
        reports: events that the autopilot reports.

    Returns:
        A fact for each sensor or report that supports or contradicts the loss; empty if the motor is not known.
    """
    motors = signals.motors
    if motors is None or loss.time is None or loss.subject not in motors.geometry.names:
        return ()
    boot = loss.figures["boot"]
    interval = (loss.time, min(loss.latest_time, loss.time + 2 * RECOVERY_SECONDS))
    return (
        *_rise_of_command(signals, loss, interval),
        *_loss_of_attitude(signals, boot, interval),
        *_fast_descent_facts(signals, boot, interval),
        *speed_facts(signals, loss),
        *reports_on_motor(reports, boot, loss.subject, interval),
    )


def _rise_of_command(signals: Signals, loss: Fact, interval: TimeInterval) -> Facts:
    """Returns the fact by how much the command of a motor rose, which supports that the motor lost thrust.

    The controller raises the command to make up for the lost thrust. If the loss was detected by the excess of the
    command over the other motors' commands, the fact has that excess instead.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        loss: event in which a motor lost thrust.
        interval: start and end of the loss, s since boot.

    Returns:
        One fact, ``COMMAND_ABOVE_OTHERS`` or ``COMMAND_ROSE``; empty if the command hardly rose.
    """
    motors = signals.motors
    assert motors is not None
    excess = loss.figures.get("excess")
    if excess is not None:
        above_others = supporting_fact(
            SensorFact.COMMAND_ABOVE_OTHERS,
            time=loss.time,
            end_time=loss.end_time,
            share=excess,
        )
        return (above_others,)
    commands = motors.range_fractions(loss.figures["boot"])
    motor = motors.geometry.names.index(loss.subject)
    change = command_change(commands.time, commands.values[:, motor], interval, quantile_during=0.5)
    if change is None or change.rise < MIN_MEDIAN_RISE:
        return ()
    # The change of the other motors shows whether the vehicle was only heavier, or climbed.
    mean_of_others = np.delete(commands.values, motor, axis=1).mean(axis=1)
    change_of_others = command_change(commands.time, mean_of_others, interval, quantile_during=0.5)
    fact = rise_fact(change, interval)
    if change_of_others is not None:
        fact = fact.replace(
            others_share_before=change_of_others.before, others_share=change_of_others.later
        )
    return (fact,)


def _loss_of_attitude(signals: Signals, boot: int, interval: TimeInterval) -> Facts:
    """Returns the fact that the attitude left its setpoint, which supports that a motor was lost.

    If it did not, that proves nothing, since other motors may hold the attitude. If no setpoint was recorded, only a
    fraction of the lean is compared with the limit (:func:`mavdem.dataset.attitude_error.attitude_error`), but the
    fact has the whole lean.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        interval: start and end of the loss, s since boot.

    Returns:
        One fact, ``ATTITUDE_LEFT_SETPOINT`` with the largest error; empty if the error stayed below ``MIN_LEAN_ERROR``,
        or was not recorded.
    """
    error = attitude_error(signals, boot)
    if error is None:
        return ()
    peak_error = largest_error(error, interval)
    if peak_error is None or peak_error.counted_angle < MIN_LEAN_ERROR:
        return ()
    return (supporting_fact(SensorFact.ATTITUDE_LEFT_SETPOINT, **peak_error._asdict()),)


def _fast_descent_facts(signals: Signals, boot: int, interval: TimeInterval) -> Facts:
    """Returns the facts of height sensors that the vehicle sank fast, which support that a motor was lost.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        interval: start and end of the loss, s since boot.

    Returns:
        A fact for each height sensor that shows a fast descent; empty if none does, or the loss did not begin in a
        flight.
    """
    loss_start, _ = interval
    for flight in flights_in_boot(signals, boot):
        if in_intervals(loss_start, [flight]):
            take_off, _ = flight
            sensors = BootSensors(signals, boot, take_off)
            return supporting_facts(sensors.sink_facts(interval))
    return ()
