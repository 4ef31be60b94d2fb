"""Lasting changes of the motors in the flights of a log: those that a live session finds, and slow losses of thrust."""

from collections.abc import Sequence
from math import inf

import numpy as np

from mavdem.arrays import Array
from mavdem.dataset.intervals import Intervals, TimeInterval, in_intervals, intersection
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.phases import (
    TRANSIENT_SECONDS,
    free_flight_intervals,
    settled_intervals,
)
from mavdem.dataset.signals import Signals
from mavdem.dataset.steady_flight import lean_at, tracked_headings
from mavdem.dataset.time_series import TimeSeries
from mavdem.ingest.motors import POSSIBLE_MULTIROTORS
from mavdem.motors.balance import SteadyRun, settled_run_around
from mavdem.motors.gradual_loss import gradual_loss
from mavdem.motors.lean_check import without_shifts_by_lean
from mavdem.motors.loss_detection import MotorLossDetector
from mavdem.motors.motor_changes import MotorChange, is_much_larger, lasting_changes
from mavdem.motors.signatures import motor_signatures


def motor_alarms(signals: Signals) -> tuple[MotorChange, ...]:
    """Returns the changes of the motors that a live session would have reported, and slow losses of thrust.

    Settled flight is searched sample by sample for sudden changes, as in flight. Then all of it is searched at once for
    motors that lost thrust slowly, which takes the whole flight.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.

    Returns:
        The changes, boot by boot; none if the motors were not recorded, or at less than 4 Hz, or if the vehicle is not
        a multirotor.
    """
    motors = signals.motors
    if motors is None or signals.telemetry.vehicle not in POSSIBLE_MULTIROTORS:
        return ()
    alarms = []
    for boot in np.unique(motors.boot).tolist():
        commands = motors.range_fractions(boot)
        headings = tracked_headings(signals, boot, commands.time)
        sudden_changes = _sudden_changes_of_boot(signals, motors, boot, commands, headings)
        # Headings are NaN while the attitude does not follow its setpoint. Then the balance of the motors does not show
        # which of them lost thrust.
        tracked_commands = commands.select(np.isfinite(headings))
        slow_losses = _lasting_losses(signals, motors, tracked_commands, boot, sudden_changes)
        alarms += sudden_changes + slow_losses
    return tuple(alarms)


def _sudden_changes_of_boot(
    signals: Signals, motors: MotorOutputs, boot: int, commands: TimeSeries, headings: Array
) -> list[MotorChange]:
    """Returns the lasting changes of the motors' balance that began in the settled flight of one boot.

    Settled flight is without take-off and landing. The detector is the one of live sessions, which finds the same
    changes at slightly different times. It also gets the descent, where it can confirm a change that began before. A
    shift of several motors at once is left out if the vehicle's lean against the wind explains it.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        motors: outputs and geometry of the k motors.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        commands: (N, k) outputs in this boot, as fractions of the range.
        headings: (N,) heading, rad; NaN while the attitude does not follow its setpoint.

    Returns:
        The changes, in the order of time.
    """
    changes = _detected_changes(signals, motors, boot, commands, headings)

    def settled_run(change: MotorChange, interval: TimeInterval) -> SteadyRun | None:
        """Returns the segment of settled flight around a change, limited to an interval, s since boot."""
        return settled_run_around(signals, motors, boot, change.onset_time, interval)

    return without_shifts_by_lean(
        lasting_changes(changes), motor_signatures(motors.geometry), settled_run
    )


def _detected_changes(
    signals: Signals, motors: MotorOutputs, boot: int, commands: TimeSeries, headings: Array
) -> list[MotorChange]:
    """Returns the sudden changes of the motors' balance in one boot, whether they last or not, in the order of time.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        motors: outputs and geometry of the k motors.
        boot: number of the boot.
        commands: (N, k) outputs in this boot, as fractions of the range.
        headings: (N,) heading, rad; NaN while the attitude does not follow its setpoint.
    """
    settled = settled_intervals(signals, boot)
    descents = _descents_after(settled, free_flight_intervals(signals, boot))
    is_settled = in_intervals(commands.time, settled)
    is_tested = is_settled | in_intervals(commands.time, descents)
    samples = zip(
        commands.time[is_tested].tolist(),
        commands.values[is_tested],
        headings[is_tested].tolist(),
        lean_at(signals, boot, commands.time[is_tested]),
        is_settled[is_tested].tolist(),
        strict=True,
    )
    detector = MotorLossDetector(motors.geometry, boot)
    changes: list[MotorChange] = []
    settled_end = -inf
    for time, command, heading, lean, is_settled_sample in samples:
        new_changes = detector.update(time, command, heading, lean)
        if is_settled_sample:
            settled_end = time
            changes += new_changes
            continue
        # In a descent the vehicle sinks through its own wake, which disturbs single motors. Only shifts of no single
        # motor that began before the descent count.
        for change in new_changes:
            if change.motor is None and change.onset_time < settled_end:
                changes.append(change)
    return changes


def _descents_after(settled: Intervals, flights: Intervals) -> Intervals:
    """Returns the descent at the end of each flight: from its settled part until shortly before the touch-down.

    Args:
        settled: intervals of settled flight, s since boot.
        flights: intervals in which the vehicle is airborne and nothing holds it, s since boot.

    Returns:
        At most one interval for each flight, s since boot. The last ``TRANSIENT_SECONDS`` are left out, since the
        ground disturbs the motors.
    """
    descents = []
    for start, end in flights:
        settled_ends = [settled_end for _, settled_end in settled if start < settled_end <= end]
        if settled_ends and max(settled_ends) < end - TRANSIENT_SECONDS:
            descents.append((max(settled_ends), end - TRANSIENT_SECONDS))
    return descents


def _lasting_losses(
    signals: Signals,
    motors: MotorOutputs,
    commands: TimeSeries,
    boot: int,
    changes: Sequence[MotorChange],
) -> list[MotorChange]:
    """Finds the motors that lost thrust slowly, or from the descent on, and did not recover.

    Each interval of settled flight is searched. If nothing is found, the flight that it belongs to is searched too,
    until shortly before the touch-down: a vehicle that sinks since a motor lost thrust is not in settled flight.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        motors: outputs and geometry of the k motors.
        commands: (N, k) their outputs while the attitude follows its setpoint, as fractions of the range.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        changes: changes in this boot that the detector of sudden losses reported.

    Returns:
        At most one alarm for each interval of settled flight, then one for each other flight.
    """
    intervals_of_settled_flight = settled_intervals(signals, boot)
    losses = _gradual_losses(signals, motors, commands, boot, intervals_of_settled_flight, changes)
    for flight in free_flight_intervals(signals, boot):
        start, end = flight
        settled_in_flight = intersection(intervals_of_settled_flight, [flight])
        has_slow_loss = any(start <= loss.onset_time <= end for loss in losses)
        has_sudden_loss = bool(_changes_of_motors(changes, flight))
        if not settled_in_flight or has_slow_loss or has_sudden_loss:
            continue
        first_settled_start, _ = settled_in_flight[0]
        # The touch-down itself is left out, since the ground disturbs the motors.
        flight_with_descent = (first_settled_start, end - TRANSIENT_SECONDS)
        losses += _gradual_losses(signals, motors, commands, boot, [flight_with_descent], changes)
    return losses


def _gradual_losses(
    signals: Signals,
    motors: MotorOutputs,
    commands: TimeSeries,
    boot: int,
    intervals: Intervals,
    changes: Sequence[MotorChange],
) -> list[MotorChange]:
    """Finds the motors that lost thrust slowly within intervals of flight.

    Where a motor changed suddenly, a slow loss counts only if the sudden one was a part of it.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        motors: outputs and geometry of the k motors.
        commands: (N, k) their outputs while the attitude follows its setpoint, as fractions of the range.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        intervals: intervals of flight, s since boot.
        changes: changes in this boot that the detector of sudden losses reported.

    Returns:
        At most one alarm for each interval, in the order of the intervals.
    """
    losses = []
    for interval in intervals:
        in_interval = commands.select(in_intervals(commands.time, [interval]))
        lean = lean_at(signals, boot, in_interval.time)
        loss = gradual_loss(in_interval.time, in_interval.values, lean, motors.geometry, boot)
        if loss is not None and is_much_larger(loss, _changes_of_motors(changes, interval)):
            losses.append(loss)
    return losses


def _changes_of_motors(changes: Sequence[MotorChange], interval: TimeInterval) -> list[MotorChange]:
    """Returns the changes that name a motor and were found in an interval, s since boot."""
    start, end = interval
    return [
        change for change in changes if change.motor is not None and start <= change.time <= end
    ]
