"""Why a vehicle was lost by its motor commands, as a fact (a coded finding): all off, thrust spent, one weak or frozen.

A motor with too little thrust lets the vehicle fall to its side. The autopilot drives that motor to its limit and the
opposite one to idle, and the attitude is still lost. So a motor is named if three things agree: the commands,
the side to which the vehicle fell, and that it did not swing before. All of it is measured from when the attitude began
to leave its setpoint until it was lost: later every motor is at a limit. A vehicle that its own controller throws over
falls the way it was commanded, and one that swings was commanded both ways before: they name no motor.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array, Flags
from mavdem.assessment.flights import RECOVERY_SECONDS
from mavdem.assessment.motor_events import LASTING_SECONDS, frozen_motor
from mavdem.assessment.stop_reason import FIRST_RESPONSE_SECONDS
from mavdem.dataset.flight_states import min_running_command
from mavdem.dataset.intervals import TimeInterval, in_intervals
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.quality import samples_at_limits
from mavdem.dataset.signals import Signals
from mavdem.dataset.time_series import AVERAGING_SECONDS, TimeSeries
from mavdem.facts import Fact
from mavdem.facts.ending import FailedFirst
from mavdem.witnesses.boot_sensors import BootSensors
from mavdem.witnesses.sensors import FULL_STICK

ALIGNMENT_FRACTION = 2 / 3
"""A direction belongs to a motor if it is within this fraction of half the angle between neighbouring motors: then it
belongs to no other."""

SPENT_THRUST_SHARE = 0.9
"""Mean command of all motors, as a fraction of the highest, from which on all thrust is in use
(THRUST_LOSS_CHECK_MINIMUM_THROTTLE of ArduCopter's ``crash_check.cpp``)."""

LEAST_SINK_RATE = 0.5
"""Speed downward, m/s, from which on a vehicle sinks for certain: estimates drift by 0.1 to 0.3 m/s."""

SINKING_SECONDS = 1.0
"""Seconds before an impact in which a vehicle sinks at full throttle; a choice."""

LIMITED_FRACTION = 0.5
"""Fraction of that time beyond which a motor must be at its limit; a choice."""

MIN_FROZEN_SAMPLES = 3
"""Number of equal samples that show a frozen output: two may be equal by chance."""

OFF_RATIO = 0.5
"""Command of a motor, relative to its usual one, below which the motor is off: no vehicle hovers with half of it."""


class LossContext(NamedTuple):
    """The time just before a vehicle was lost, in which the commands of the motors are examined."""

    interval: TimeInterval
    """Start and end, s since boot."""
    names_at_limit: Sequence[str] = ()
    """Names of the motors that were at their limit before an impact."""
    fall_direction: complex | None = None
    """Lean with which the vehicle fell, as in :func:`weak_motor`; None if it hit something."""


class WeakMotor(NamedTuple):
    """Indices of a motor with too little thrust, and of the motor on the other side of the vehicle."""

    motor: int
    """Index of the motor with too little thrust."""
    opposite: int
    """Index of the motor across from it, which the controller throttles to level the vehicle."""


@dataclass(frozen=True, eq=False)
class _LossCommands:
    """The commands of k motors, as fractions of their range, in the time in which a vehicle was lost and before it."""

    motors: MotorOutputs
    """The motors."""
    recorded: TimeSeries
    """All commands of the boot, (M, k)."""
    time: Array
    """(N,) times of the samples from the first sign of the loss to the loss itself, s since boot."""
    during: Array
    """(N, k) commands at these times."""
    just_before: Array
    """(L, k) commands in the ``AVERAGING_SECONDS`` before these times."""
    usual: Array
    """(k,) mean commands in the ``RECOVERY_SECONDS`` before these times, without the last ``LASTING_SECONDS``."""

    @property
    def change(self) -> Array:
        """(k,) change of the mean commands from the usual ones."""
        return self.during.mean(axis=0) - self.usual

    def change_until(self, end_time: float) -> Array:
        """Returns the change (k,) of the mean commands from the usual ones, from the loss to a time, s since boot."""
        is_selected = self.time <= end_time
        return self.during[is_selected].mean(axis=0) - self.usual


def failure_by_commands(signals: Signals, boot: int, loss_context: LossContext) -> Fact | None:
    """Returns the fact about what failed first, by the commands of the motors; None if they show no failure.

    The commands in the time of the loss are compared with the commands before. The first of these failures that they
    show is returned:

    1. All motors were switched off.
    2. The mean command of all motors was near the highest, so that all thrust was in use.
    3. Before an impact without a loss of attitude, the vehicle sank at full throttle with a motor at its limit, so that
       all thrust was in use as well.
    4. The output of one motor was frozen and did not follow the controller. The vehicle then falls towards it, as if it
       were weak, or away from it, as if the opposite motor were weak.
    5. One motor was too weak (:func:`weak_motor`), by all commands, by the first ones, or by those just before.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        loss_context: the time in which the attitude left its setpoint, or before an impact.
    """
    commands = _commands_around(signals, boot, loss_context.interval)
    if commands is None:
        return None
    cause_of_all = _motors_off_fact(commands) or _thrust_limit_fact(commands, loss_context)
    if cause_of_all is not None:
        return cause_of_all
    is_attitude_lost = loss_context.fall_direction is not None
    if not is_attitude_lost:
        # Then the time before the loss ends with an impact. After a loss of attitude the thrust points sideways, and
        # the vehicle sinks even if not all thrust is in use.
        _, impact = loss_context.interval
        sinking_fact = _sinking_at_full_throttle(signals, boot, commands.motors, impact)
        if sinking_fact is not None:
            return sinking_fact
    frozen = _frozen_output(signals, commands)
    if frozen is not None:
        return frozen
    return _weak_motor_failure(signals, boot, commands, loss_context)


def _weak_motor_failure(
    signals: Signals, boot: int, commands: _LossCommands, loss_context: LossContext
) -> Fact | None:
    """Returns the fact that one motor was too weak, by the change of the commands from the usual ones.

    The change is averaged over one of three intervals, the first of them that shows a weak motor:

    1. the whole time of the loss;
    2. its first ``FIRST_RESPONSE_SECONDS``: if the loss takes long, the controller changes the commands of all motors
       again and again, so that their means over the whole time do not show the weak motor;
    3. before a loss of attitude, the time from the controller's response to the failure to the beginning of the loss:
       the controller responds to the body rate, and this may be over when the attitude has left its setpoint.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        commands: commands of the motors while the vehicle was lost, just before, and as usual in the flight.
        loss_context: the time in which the attitude left its setpoint, or before an impact.

    Returns:
        The fact; None if no motor was too weak.
    """
    fall_direction = loss_context.fall_direction
    loss_start = float(commands.time[0])
    change_in_loss = commands.change
    change_in_first_response = commands.change_until(loss_start + FIRST_RESPONSE_SECONDS)
    for change in (change_in_loss, change_in_first_response):
        weak_pair = weak_motor(commands.motors, change, fall_direction)
        if weak_pair is not None:
            return _failure_of_motor(commands, loss_context, weak_pair)
    if fall_direction is None:
        # The vehicle hit something, and its attitude was not lost before.
        return None
    _, loss_end = loss_context.interval
    response_interval = (_start_of_response(commands), loss_end)
    response = _commands_around(signals, boot, response_interval)
    if response is None:
        return None
    change_before_loss = response.change_until(loss_start)
    weak_pair = weak_motor(commands.motors, change_before_loss, fall_direction)
    if weak_pair is None:
        return None
    return _failure_of_motor(response, loss_context, weak_pair)


def _start_of_response(commands: _LossCommands) -> float:
    """Returns when the controller began to respond to a failure, before the attitude was lost.

    From then to the loss of attitude the command of some motor is outside its usual range in each sample. The usual
    range is taken from the ``RECOVERY_SECONDS`` before the loss, without the last ``FIRST_RESPONSE_SECONDS``, in which
    the response is sought.

    Args:
        commands: commands of the motors while the vehicle was lost, and before it.

    Returns:
        The time, s since boot; the beginning of the loss if the commands show no response before it.
    """
    loss_start = float(commands.time[0])
    search_start = loss_start - FIRST_RESPONSE_SECONDS
    recorded = commands.recorded
    usual_commands = _commands_between(recorded, loss_start - RECOVERY_SECONDS, search_start)
    is_searched = (recorded.time >= search_start) & (recorded.time < loss_start)
    searched_times = recorded.time[is_searched]
    if not len(usual_commands) or not len(searched_times):
        return loss_start
    searched_commands = recorded.values[is_searched]
    lowest_usual = usual_commands.min(axis=0)
    highest_usual = usual_commands.max(axis=0)
    is_usual = (searched_commands >= lowest_usual) & (searched_commands <= highest_usual)
    samples_as_usual = np.flatnonzero(is_usual.all(axis=1))
    # The response begins after the last sample in which all commands were in their usual range.
    first_of_response = samples_as_usual[-1] + 1 if len(samples_as_usual) else 0
    if first_of_response == len(searched_times):
        return loss_start
    return float(searched_times[first_of_response])


def _commands_around(signals: Signals, boot: int, interval: TimeInterval) -> _LossCommands | None:
    """Selects the commands of the motors in the time in which a vehicle was lost, just before it, and some time before.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        interval: start and end of the time before the loss, s since boot: in it something went wrong, so that the
            vehicle was lost at its end.

    Returns:
        The commands; None if any of the three intervals has no samples.
    """
    motors = signals.motors
    if motors is None:
        return None
    all_commands = motors.range_fractions(boot)
    start, _ = interval
    usual_commands = _commands_between(
        all_commands, start - RECOVERY_SECONDS, start - LASTING_SECONDS
    )
    commands_before = _commands_between(all_commands, start - AVERAGING_SECONDS, start)
    is_during = in_intervals(all_commands.time, [interval])
    if not len(usual_commands) or not len(commands_before) or not is_during.any():
        return None
    return _LossCommands(
        motors=motors,
        recorded=all_commands,
        time=all_commands.time[is_during],
        during=all_commands.values[is_during],
        just_before=commands_before,
        usual=usual_commands.mean(axis=0),
    )


def _motors_off_fact(commands: _LossCommands) -> Fact | None:
    """Returns the fact that all motors were switched off before the vehicle was lost; None if they were not.

    A motor is off if its command is below ``OFF_RATIO`` of its usual one. The fact has the time from which on all
    motors are off. It may be before the attitude leaves its setpoint, since a vehicle without power is level for a
    while.

    Args:
        commands: commands of the motors while the vehicle was lost, just before, and as usual in the flight.
    """
    lowest_running_commands = OFF_RATIO * commands.usual
    # Each motor must have been off on average: a manoeuvre may stop one for a moment.
    mean_commands = commands.during.mean(axis=0)
    is_each_motor_off = bool((mean_commands < lowest_running_commands).all())
    if not is_each_motor_off:
        return None
    are_all_off = (commands.during < lowest_running_commands).all(axis=1)
    times_with_all_off = commands.time[are_all_off]
    off_time = commands.time[0]
    if len(times_with_all_off):
        off_time = times_with_all_off[0]
    # They may have been off since before the loss: then since the sample after the last one in which a motor ran.
    is_earlier = commands.recorded.time < off_time
    earlier_commands = commands.recorded.values[is_earlier]
    samples_with_power = np.flatnonzero((earlier_commands >= lowest_running_commands).any(axis=1))
    if len(samples_with_power):
        off_time = commands.recorded.time[samples_with_power[-1] + 1]
    return Fact(FailedFirst.ALL_OFF_FIRST, time=float(off_time))


def _thrust_limit_fact(commands: _LossCommands, loss_context: LossContext) -> Fact | None:
    """Returns the fact that all thrust was in use, so that none was left to keep the height.

    All thrust is in use if the mean command of all motors exceeds ``SPENT_THRUST_SHARE`` of the highest one. Once the
    attitude is lost, the controller drives motors to their limits anyway. Then the commands before the loss are judged.

    Args:
        commands: commands of the motors while the vehicle was lost, just before, and as usual in the flight.
        loss_context: the time in which the vehicle was lost, and whether it lost its attitude or hit something.

    Returns:
        The fact, with the time since when all thrust was in use, and the mean command since then, as a fraction of the
        highest one, as its figure ``share``; None if some thrust was left.
    """
    loss_start, loss_end = loss_context.interval
    # Upper limit of a motor's command, as a fraction of its range.
    highest_command = commands.motors.scale.upper_limit
    is_attitude_lost = loss_context.fall_direction is not None
    if is_attitude_lost:
        judged_commands = commands.just_before
        judged_end = loss_start
    else:
        judged_commands = commands.during
        judged_end = loss_end
    used_fraction = judged_commands.mean() / highest_command
    if used_fraction <= SPENT_THRUST_SHARE:
        return None
    recorded = commands.recorded
    start = _start_of_spent_thrust(recorded, commands.time[0], highest_command)
    # The thrust may be spent only from the first sample of the loss on: then that sample alone is averaged.
    end = max(judged_end, start)
    spent_commands = recorded.values[in_intervals(recorded.time, [(start, end)])]
    return Fact(
        FailedFirst.THRUST_SPENT_FIRST, time=start, share=spent_commands.mean() / highest_command
    )


def _failure_of_motor(
    commands: _LossCommands, loss_context: LossContext, motor_pair: WeakMotor
) -> Fact | None:
    """Returns the fact that one motor failed, by its command and the command of the motor across from it.

    If a motor gives too little thrust, the controller drives it to its upper limit, and throttles the opposite motor to
    idle, to level the vehicle. A vehicle that only swings to and fro commands the same for a moment. So there is no
    failure if the two motors were commanded the other way shortly before.

    Args:
        commands: commands of the motors while the vehicle was lost, just before, and as usual in the flight.
        loss_context: how and when the vehicle was lost. If it hit something, and did not fall to a side, this motor
            must be the only one that was at its limit before.
        motor_pair: the motor with too little thrust, and the opposite one.

    Returns:
        The fact, with the time when the motor reached its limit or the opposite one its idle; None if neither did. It
        is ``LIMIT_FIRST`` if no other motor reached its limit before, otherwise ``THRUST_MISSING_FIRST`` with the
        highest command of the motor as ``share``.
    """
    motors = commands.motors
    motor_name = motors.geometry.names[motor_pair.motor]
    fell_to_side = loss_context.fall_direction is not None
    if not fell_to_side and list(loss_context.names_at_limit) != [motor_name]:
        return None
    idle_command = min_running_command(motors)
    commands_before = commands.just_before
    was_opposite_at_limit, _ = samples_at_limits(
        commands_before[:, motor_pair.opposite], motors.scale
    )
    was_motor_idle = commands_before[:, motor_pair.motor] < idle_command
    if (was_opposite_at_limit | was_motor_idle).any():
        # The two motors were commanded the other way.
        return None
    is_at_limit, _ = samples_at_limits(commands.during, motors.scale)
    is_opposite_idle = commands.during[:, motor_pair.opposite] < idle_command
    failure_samples = np.flatnonzero(is_at_limit[:, motor_pair.motor] | is_opposite_idle)
    if not len(failure_samples):
        return None
    failure_time = commands.time[failure_samples[0]]
    if is_first_at_limit(is_at_limit, motor_pair.motor):
        return Fact(FailedFirst.LIMIT_FIRST, time=failure_time, subject=motor_name)
    return Fact(
        FailedFirst.THRUST_MISSING_FIRST,
        time=failure_time,
        subject=motor_name,
        share=commands.during[:, motor_pair.motor].max(),
    )


def _start_of_spent_thrust(commands: TimeSeries, time: float, highest_command: float) -> float:
    """Returns since when the motors together used up their thrust, up to a given time.

    Args:
        commands: (N, k) of k motors, as fractions of their range.
        time: time of one of the samples, s since boot.
        highest_command: upper limit of a command, as a fraction of the range.

    Returns:
        The time of the first sample after the last one with a reserve of thrust, s since boot; ``time`` itself if there
        was a reserve at that sample.
    """
    mean_command = commands.values.mean(axis=1)
    has_reserve = mean_command <= SPENT_THRUST_SHARE * highest_command
    samples_with_reserve = np.flatnonzero(has_reserve & (commands.time <= time))
    if not len(samples_with_reserve):
        return float(min(commands.time[0], time))
    # The last sample with reserve may be the last one of the record.
    last_sample = len(commands.time) - 1
    next_sample = min(samples_with_reserve[-1] + 1, last_sample)
    return float(min(commands.time[next_sample], time))


def is_first_at_limit(at_limit: Flags, motor: int) -> bool:
    """Returns whether one motor reached its upper limit, and no other one before it.

    Args:
        at_limit: (N, k) whether each of k motors is at its upper limit in each of N samples, in the order of time.
        motor: index of the motor.
    """
    limited_samples = np.flatnonzero(at_limit.any(axis=1))
    return len(limited_samples) > 0 and bool(at_limit[limited_samples[0], motor])


def _sinking_at_full_throttle(
    signals: Signals, boot: int, motors: MotorOutputs, time: float
) -> Fact | None:
    """Returns the fact that the vehicle sank before an impact although the pilot commanded full throttle.

    If a motor is at its limit then, all thrust is in use, however low the mean command is: a mixer lowers the other
    motors to keep the attitude.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        motors: outputs and geometry of the vehicle's motors.
        time: time of the impact, s since boot; the ``SINKING_SECONDS`` before it are examined.

    Returns:
        The fact, with the names of the motors at their limit and the mean command, a fraction of its upper limit, as
        ``share``. None if the vehicle did not sink at full throttle with a motor at its limit, or stick or climb rate
        were not recorded.
    """
    start = time - SINKING_SECONDS
    sensors = BootSensors(signals, boot)
    stick = sensors.stick
    climb = sensors.climb_estimate
    if stick is None or climb is None:
        return None
    stick_travel = stick.within((start, time)).values
    climb_rates = climb.within((start, time)).values
    commands = motors.range_fractions(boot).within((start, time)).values
    if not len(stick_travel) or not len(climb_rates) or not len(commands):
        return None
    is_full_throttle = stick_travel.min() >= FULL_STICK
    is_sinking = climb_rates.max() <= -LEAST_SINK_RATE
    # (samples, motors) whether a motor is at its upper limit.
    at_limit, _ = samples_at_limits(commands, motors.scale)
    has_limited_motor = at_limit.any(axis=1).mean() > LIMITED_FRACTION
    if not (is_full_throttle and is_sinking and has_limited_motor):
        return None
    limited_names = []
    for motor, name in enumerate(motors.geometry.names):
        if at_limit[:, motor].any():
            limited_names.append(name)
    return Fact(
        FailedFirst.THRUST_SPENT_FIRST,
        time=start,
        share=commands.mean() / motors.scale.upper_limit,
        names=tuple(limited_names),
    )


def _commands_between(commands: TimeSeries, start: float, end: float) -> Array:
    """Returns the commands (N, k) of k motors between two times, s, without the ends."""
    is_between = (commands.time > start) & (commands.time < end)
    return commands.values[is_between]


def _frozen_output(signals: Signals, commands: _LossCommands) -> Fact | None:
    """Finds a motor whose output froze when the vehicle was lost: it was constant while the others were moved.

    A mixer may hold an output constant at its lower limit, which is not always known. So the constant output must be
    above the lowest output of all motors from ``RECOVERY_SECONDS`` before the loss until its end.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        commands: commands of the motors in the time in which the vehicle was lost, and before it.

    Returns:
        The fact, with the name of the motor and, as ``settings``, parameters that were changed so that its output no
        longer drives it; None if no output froze, or there are less than ``MIN_FROZEN_SAMPLES``.
    """
    motors = commands.motors
    if len(commands.during) < MIN_FROZEN_SAMPLES:
        return None
    recorded_commands = commands.recorded
    loss_start, loss_end = commands.time[0], commands.time[-1]
    is_around = in_intervals(recorded_commands.time, [(loss_start - RECOVERY_SECONDS, loss_end)])
    lowest_command = recorded_commands.values[is_around].min()
    motor = frozen_motor(motors, commands.during, lowest_command=lowest_command)
    if motor is None:
        return None
    name = motors.geometry.names[motor]
    settings = reassigned_outputs(signals, [name])
    return Fact(FailedFirst.OUTPUT_FROZE_FIRST, subject=name, settings=settings)


def reassigned_outputs(signals: Signals, names: Sequence[str]) -> list[str]:
    """Returns ArduPilot's parameters that assign outputs to given motors, as far as they were changed during the log.

    The parameter SERVOn_FUNCTION says what output n drives. If it is changed in flight, the output no longer drives its
    motor, so that the change itself may be the failure.

    Args:
        signals: logged time series of the vehicle, with its parameters and the outputs of its motors.
        names: names of the motors.

    Returns:
        The names of the changed parameters, in the order of the motors.
    """
    assert signals.motors is not None
    geometry = signals.motors.geometry
    channel_by_motor = dict(zip(geometry.names, geometry.channels, strict=True))
    # The initial values are kept of those parameters alone that were changed.
    changed_parameters = signals.telemetry.initial_parameters
    reassignments = []
    for name in names:
        parameter = f"SERVO{channel_by_motor[name]}_FUNCTION"
        if parameter in changed_parameters:
            reassignments.append(parameter)
    return reassignments


def weak_motor(
    motors: MotorOutputs, command_changes: Array, fall_direction: complex | None
) -> WeakMotor | None:
    """Finds the motor that lost thrust: the vehicle fell to its side, and the controller tried to lift that side.

    The sum of the motors' positions, weighted with the changes of their commands, points to the side that the commands
    lift. There must be exactly one motor with which both this direction and the fall are aligned.

    Args:
        motors: outputs and geometry of k motors.
        command_changes: (k,) change of the commands from the usual ones, as fractions of the motors' range.
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
    max_angle = ALIGNMENT_FRACTION * pi / len(positions)
    lift_direction = command_changes @ positions
    if fall_direction is None:
        fall_direction = lift_direction
    # The angle of a quotient of complex numbers is the angle between their directions: (k,) from each motor.
    lift_angles = abs(np.angle(lift_direction / positions))
    fall_angles = abs(np.angle(fall_direction / positions))
    is_aligned = (lift_angles < max_angle) & (fall_angles < max_angle)
    motor = int(np.argmax(command_changes))
    is_only_one = np.count_nonzero(is_aligned) == 1
    if not (is_aligned[motor] and is_only_one):
        return None
    # The controller also lowers the command of the opposite motor, so that the vehicle does not climb.
    angles_from_motor = abs(np.angle(positions / positions[motor]))
    opposite = int(np.argmax(angles_from_motor))
    if command_changes[opposite] < 0 and angles_from_motor[opposite] > pi - max_angle:
        return WeakMotor(motor, opposite)
    return None
