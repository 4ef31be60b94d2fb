"""Events of motors, as facts (coded findings): outputs at their upper limit in flight, frozen, or off."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import inf
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.dataset.flight_states import MANUAL_THROTTLE_MODES, min_running_command, mode_intervals
from mavdem.dataset.grounded import MAX_GROUND_HEIGHT, MAX_SETPOINT_DELAY
from mavdem.dataset.intervals import (
    Intervals,
    TimeInterval,
    in_intervals,
    intersection,
    merge_close_intervals,
    true_intervals,
)
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.phases import MIN_CLIMB_SPEED
from mavdem.dataset.quality import LIMIT_MARGIN, samples_at_limits
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import TimeSeries, rows_of_boot, series_of_boot
from mavdem.facts import Fact, Level
from mavdem.facts.ending import MotionEvent
from mavdem.witnesses.height import reliable_height
from mavdem.witnesses.sensors import FULL_STICK, throttle_stick

LASTING_SECONDS = 0.3
"""Seconds that a loss of attitude, or a motor at its limit, must last: longer than one sample of a stream at 4 Hz."""

MIN_LIMIT_SAMPLES = 3
"""Number of successive samples at its limit that show that a motor stayed there, whatever the rate of the outputs: two
may be two peaks."""

FROZEN_SECONDS = 2.0
"""Time, s, for which an output must stand still to have frozen while the vehicle flies on; a choice."""

FROZEN_SAMPLES = 8
"""Number of samples that must show it: those of that time at 4 Hz."""

MIN_COMMAND_RANGE = 0.05
"""Mean range of motors' commands, as a fraction of the full range, from which on one that is constant has frozen; also
the least distance of that constant command from the upper limit."""

FULL_THROTTLE_FRACTION = 0.5
"""Fraction of a motor's time at its limit with full throttle beyond which that explains the limit; a choice."""


def lasting_runs(time: Array, is_true: Flags, gap: float, min_samples: int = 2) -> Intervals:
    """Returns the intervals in which a condition holds for ``LASTING_SECONDS`` without a break at least once.

    A run is a sequence of samples in which the condition holds. Runs that are close together become one interval. An
    interval without a run of ``LASTING_SECONDS`` is left out.

    Args:
        time: (N,) times of the samples, s, ascending.
        is_true: (N,) whether the condition holds.
        gap: shortest time between two runs, s, that separates intervals.
        min_samples: least number of samples of the run that lasts.

    Returns:
        (start, end) of each interval, s; infinite if the condition holds at the first or the last sample.
    """
    intervals_of_runs = true_intervals(time, is_true)
    # A run lasts until the sample after its last one, or until the end of the record.
    next_time = np.append(time, time[-1])
    lasting_run_starts = []
    for start, end in intervals_of_runs:
        row_after_run = np.searchsorted(time, end, "right")
        sample_count = row_after_run - np.searchsorted(time, start)
        has_lasted = next_time[row_after_run] - start >= LASTING_SECONDS
        if has_lasted and sample_count >= min_samples:
            lasting_run_starts.append(start)
    intervals = []
    for start, end in merge_close_intervals(intervals_of_runs, gap):
        # The starts are in ascending order: one is in the interval if more of them are before its end than before its
        # start.
        count_before_start = np.searchsorted(lasting_run_starts, start)
        count_before_end = np.searchsorted(lasting_run_starts, end)
        has_lasting_run = count_before_end > count_before_start
        if has_lasting_run:
            intervals.append((start, end))
    return intervals


class _MotorCondition(NamedTuple):
    """A condition of the motors that is an event if it lasts."""

    code: MotionEvent
    """The kind of the event."""
    is_true: Flags
    """(N, k) whether the condition holds at each of N samples, for each of k motors."""
    min_duration: float = 0.0
    """Duration, s, that an event must exceed."""
    min_samples: int = 2
    """Least number of successive samples in which the condition holds."""


def motor_events(signals: Signals, boot: int, flights: Intervals) -> Iterator[Fact]:
    """Yields an event for each time in flight in which a motor stayed at its upper limit, was off, or its output froze.

    A limit is reported only once the vehicle has left the ground: on a stand that holds it, the controller drives
    motors to any command. A motor is reported as off only after more than ``MAX_SETPOINT_DELAY``, since a mixer may
    stop one for a moment.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        flights: start and end of each flight of the boot, s.

    Yields:
        The frozen outputs first. Then a fact for each interval in which a motor, its subject, was at its limit or off.
        The time of an event that began before the record is -inf. Its figures are:

        - ``share``: the fraction of the interval's samples in which the motor was so;
        - ``duration``: the duration of these samples, s;
        - ``sampling_interval``: the time step of the outputs, s, if they are so slow that short events may be missed;
        - ``is_full_throttle``: the pilot commanded full throttle. Such a limit is good if the vehicle climbs.
    """
    motors = signals.motors
    if motors is None or boot not in motors.boot:
        return
    commands = motors.range_fractions(boot)
    yield from _frozen_outputs(motors, boot, commands, flights)
    is_in_flight = in_intervals(commands.time, flights)
    is_off_ground = _has_left_ground(signals, boot, flights, commands.time)
    # (N, k) flags of N samples of k motors.
    is_at_limit, _ = samples_at_limits(commands.values, motors.scale)
    is_off = _is_off(signals, motors, boot, commands.values)
    limit_off_ground = _MotorCondition(
        MotionEvent.MOTOR_AT_ITS_STOP,
        is_at_limit & is_off_ground[:, None],
        min_samples=MIN_LIMIT_SAMPLES,
    )
    off_in_flight = _MotorCondition(
        MotionEvent.MOTOR_OFF, is_off & is_in_flight[:, None], min_duration=MAX_SETPOINT_DELAY
    )
    for condition in (limit_off_ground, off_in_flight):
        yield from _lasting_events(signals, motors.geometry.names, commands.time, boot, condition)


def _lasting_events(
    signals: Signals, names: Sequence[str], time: Array, boot: int, condition: _MotorCondition
) -> Iterator[Fact]:
    """Yields an event for each interval in which a condition holds for a motor, such as that it is at its limit.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        names: names of the k motors.
        time: times of the samples of the condition (N,), s since boot.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        condition: the condition, for all motors.

    Yields:
        The events, as :func:`motor_events` describes them, motor by motor.
    """
    sampling_interval = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    for motor, name in enumerate(names):
        holds = condition.is_true[:, motor]
        for start, end in lasting_runs(time, holds, RECOVERY_SECONDS, condition.min_samples):
            # An interval that reaches an end of the record is infinite there.
            recorded_start = max(start, time[0])
            recorded_end = min(end, time[-1])
            duration = recorded_end - recorded_start
            if duration <= condition.min_duration:
                continue
            recorded_interval = (recorded_start, recorded_end)
            # Runs that follow each other soon are one interval, so that the condition need not hold in all of it.
            fraction_of_samples = holds[in_intervals(time, [recorded_interval])].mean()
            event = Fact(
                condition.code,
                time=start,
                end_time=None if np.isinf(end) else end,
                subject=name,
                share=fraction_of_samples,
                duration=fraction_of_samples * duration,
                boot=boot,
            )
            if sampling_interval > LASTING_SECONDS:
                # Outputs this slow miss what happens between them, so that reports state the interval.
                event = event.replace(sampling_interval=sampling_interval)
            if event.code is MotionEvent.MOTOR_AT_ITS_STOP:
                event = _with_full_throttle_marked(signals, boot, recorded_interval, event)
            yield event


def _frozen_outputs(
    motors: MotorOutputs, boot: int, commands: TimeSeries, flights: Intervals
) -> Iterator[Fact]:
    """Yields an event for each time in flight in which the output of one motor was constant while the others changed.

    A vehicle with six or eight motors flies on with a frozen output. The trims of its motors then look as if some of
    them were weak.

    Args:
        motors: outputs of the k motors, with their scale.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        commands: outputs of the motors in this boot (N, k), as fractions of their range.
        flights: start and end of each flight of the boot, s.

    Yields:
        A fact with the name of the motor as subject, and its constant command as ``share`` of the range.
    """
    for flight in flights:
        commands_in_flight = commands.within(flight)
        time, values = commands_in_flight.time, commands_in_flight.values
        for motor, name in enumerate(motors.geometry.names):
            for first_sample, end in _constant_runs(values[:, motor]):
                start_time, end_time = time[first_sample], time[end - 1]
                if end_time - start_time < FROZEN_SECONDS:
                    continue
                # Outputs of all motors while that of this one was constant.
                outputs = values[first_sample:end]
                if frozen_motor(motors, outputs, lowest_command=outputs.min()) == motor:
                    yield Fact(
                        MotionEvent.OUTPUT_FROZE,
                        time=start_time,
                        end_time=end_time,
                        subject=name,
                        share=float(values[first_sample, motor]),
                        boot=boot,
                    )


def frozen_motor(motors: MotorOutputs, commands: Array, lowest_command: float) -> int | None:
    """Returns the index of the one motor whose output is frozen: its command is constant while other commands change.

    The others change if the range of the commands, averaged over the motors, is at least ``MIN_COMMAND_RANGE``. As a
    mixer may hold an output at a limit that is not known, the constant command must be above the idle and
    above the lowest command that occurred, and below the upper limit. If no parameter says which outputs drive motors,
    a constant one may drive something else, such as a gimbal: then none is reported.

    Args:
        motors: outputs of the k motors, with their scale.
        commands: commands of that time (N, k), as fractions of their range.
        lowest_command: lowest command of all motors that occurred around that time, as fraction of the range.

    Returns:
        The index; None if no output is frozen, or several seem to be.
    """
    if motors.geometry.channels_assumed:
        return None
    command_ranges = np.ptp(commands, axis=0)
    if command_ranges.mean() < MIN_COMMAND_RANGE:
        # All commands are nearly constant, as in calm air.
        return None
    is_constant = command_ranges == 0
    lower_limit = max(min_running_command(motors), lowest_command)
    upper_limit = motors.scale.upper_limit - MIN_COMMAND_RANGE
    is_between_limits = (commands[0] > lower_limit) & (commands[0] < upper_limit)
    frozen_motors = np.flatnonzero(is_constant & is_between_limits)
    if len(frozen_motors) != 1:
        return None
    return int(frozen_motors[0])


def _constant_runs(commands: Array) -> Iterator[tuple[int, int]]:
    """Yields runs of at least ``FROZEN_SAMPLES`` equal commands: the first sample, and the one after the last.

    Args:
        commands: commands of one motor (N,).
    """
    # Each change begins a new run of equal commands.
    changes = np.flatnonzero(np.diff(commands)) + 1
    edges = np.concatenate([[0], changes, [len(commands)]]).tolist()
    for first_sample, end in pairwise(edges):
        if end - first_sample >= FROZEN_SAMPLES:
            yield first_sample, end


def _with_full_throttle_marked(
    signals: Signals, boot: int, interval: TimeInterval, limit: Fact
) -> Fact:
    """Marks the event of a motor at its limit if the pilot gave full throttle for most of its time.

    With all thrust in use, some motor is always at its limit: the one that the attitude needs most. That is not a
    fault, so that the event is good if the vehicle climbs.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        interval: start and end of the event, s since boot.
        limit: fact (a coded finding) that a motor was at its limit, with its time.

    Returns:
        The event with ``is_full_throttle`` and the mean ``climb_speed``, m/s, if it was measured. In a climb its level
        is "good". It is unchanged unless the stick was at full throttle, in a mode in which it sets the thrust, for
        more than ``FULL_THROTTLE_FRACTION`` of the time.
    """
    stick = series_of_boot(throttle_stick(signals), boot)
    if stick is None:
        return limit
    manual_intervals = mode_intervals(signals, boot, MANUAL_THROTTLE_MODES)
    is_in_event = in_intervals(stick.time, [interval])
    is_manual_in_event = in_intervals(stick.time, intersection(manual_intervals, [interval]))
    is_full_throttle = is_manual_in_event & (stick.values >= FULL_STICK)
    # Numbers of samples of the stick, which stand for durations.
    full_throttle_count = is_full_throttle.sum()
    event_count = is_in_event.sum()
    if full_throttle_count <= FULL_THROTTLE_FRACTION * event_count:
        return limit
    limit_at_full_throttle = limit.replace(is_full_throttle=True)
    climb_rate = series_of_boot(signals.climb_rate, boot)
    if climb_rate is not None:
        climb_in_event = climb_rate.values[in_intervals(climb_rate.time, [interval])]
        if len(climb_in_event):
            climb_speed = float(climb_in_event.mean())
            level = Level.GOOD if climb_speed > MIN_CLIMB_SPEED else limit.level
            return limit_at_full_throttle.replace(level, climb_speed=climb_speed)
    return limit_at_full_throttle


def _has_left_ground(signals: Signals, boot: int, flights: Intervals, time: Array) -> Flags:
    """Determines at which times a vehicle has left the ground in its present flight.

    It has left it from the first sample on that is more than ``MAX_GROUND_HEIGHT`` above the take-off. If no height was
    recorded, or the flight began before the record, it counts as off the ground throughout the flight.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        flights: start and end of each flight of the boot, s.
        time: (N,) times, s.

    Returns:
        (N,) whether the vehicle has left the ground; False outside flights.
    """
    is_off_ground = in_intervals(time, flights)
    for flight in flights:
        take_off, _ = flight
        height_record = reliable_height(signals, boot, take_off)
        if height_record is None or take_off == -inf:
            continue
        height = height_record.series
        has_risen = in_intervals(height.time, [flight]) & (height.values > MAX_GROUND_HEIGHT)
        # A vehicle that never rises has not left the ground in this flight.
        lift_off = height.time[has_risen].min(initial=inf)
        is_before_lift_off = in_intervals(time, [flight]) & (time < lift_off)
        is_off_ground[is_before_lift_off] = False
    return is_off_ground


def _is_off(signals: Signals, motors: MotorOutputs, boot: int, commands: Array) -> Flags:
    """Returns whether each of k motors is off while the others carry the vehicle, at each of N samples.

    The range of ArduPilot's outputs begins below the idle in flight, so that its lower end means off. The range of
    PX4's outputs begins at the idle, so that a motor is off only if its output is lower by ``LIMIT_MARGIN``.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        motors: outputs of the k motors, with their scale.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        commands: (N, k) outputs of the motors in this boot, as fractions of their range.

    Returns:
        (N, k) flags.
    """
    is_ardupilot = signals.telemetry.autopilot == "ARDUPILOTMEGA"
    off_command = 0.0 if is_ardupilot else -LIMIT_MARGIN
    # An output of 0 means "no pulses" where pulses begin at a larger number.
    outputs_in_boot = motors.outputs[rows_of_boot(motors.boot, boot)]
    has_no_pulses = (outputs_in_boot == 0) & (motors.scale.low > 0)
    is_off = (commands <= off_command) | has_no_pulses
    idle_command = min_running_command(motors)
    sum_of_all = commands.sum(axis=1)
    number_of_others = max(commands.shape[1] - 1, 1)
    # Motor by motor, since tables of hours of flight take much memory.
    for motor, command in enumerate(commands.T):
        mean_of_others = (sum_of_all - command) / number_of_others
        do_others_carry = mean_of_others > idle_command
        is_off[:, motor] &= do_others_carry
    # An output that never rose above idle drives no motor.
    has_run = commands.max(axis=0) > idle_command
    return is_off & has_run
