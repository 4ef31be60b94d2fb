"""Motors that lost thrust, as facts (coded findings): they saturate in flight, and the vehicle still leans or sinks.

A controller gives a motor that lost thrust a higher command. At its limit that is no longer enough: the vehicle leans
to the side of that motor, or sinks, while the other motors have thrust left. A loss that takes a minute hides in the
trim, and changes nothing quickly enough for ``MotorLossDetector``; at the limit it shows.
"""

from collections.abc import Iterator, Sequence
from math import inf

import numpy as np

from mavdem.arrays import Array
from mavdem.assessment.flights import RECOVERY_SECONDS, flights_in_boot, loss_onset
from mavdem.assessment.motor_events import LASTING_SECONDS
from mavdem.dataset.attitude_error import attitude_error
from mavdem.dataset.grounded import MAX_GROUND_HEIGHT, MAX_SETPOINT_DELAY
from mavdem.dataset.intervals import TimeInterval, in_intervals
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.phases import MIN_CLIMB_SPEED
from mavdem.dataset.quality import samples_at_limits
from mavdem.dataset.signals import Signals
from mavdem.facts import Fact
from mavdem.facts.ending import Ending, FailedFirst, MotionEvent
from mavdem.facts.motors import MotorWatchFact
from mavdem.motors.saturation import most_limited_motors
from mavdem.witnesses.boot_sensors import BootSensors

MIN_LIMIT_SECONDS = 1.0
"""Time, s, that a motor must be at its limit: longer than a quick manoeuvre takes."""

MIN_EXCESS = 0.25
"""Least command of a saturated motor above the mean of the others, as a fraction of the range.

Then the others have thrust left, so that the motor and not the load is to blame.

In real logs 99 % of the motors of sound vehicles are less than 0.11 above, a motor that failed was 0.25.
"""

MAX_FORMER_EXCESS = 0.15
"""Largest excess over the others in the flight before, as a fraction of the range.

A motor that was farther above the others all along did not change: its load is larger.
"""

FORMER_QUANTILE = 0.25
"""Quantile of the flight before that is used for the sound motor, which may have lost thrust for most of that time."""

MIN_LEAN_ERROR = np.radians(5.0)
"""Error of the attitude, rad, towards the motor, that shows that it does not hold the vehicle."""

MAX_LEAN_ANGLE = np.pi / 3
"""Angle, rad, between the side to which the vehicle leans and the motor; the next motor of a quadrotor is at 90°."""


def saturation_losses(signals: Signals, events: Sequence[Fact], ending: Fact | None) -> list[Fact]:
    """Returns the losses of motors that saturated and still could not hold the vehicle.

    A motor is saturated while its command is at its upper limit.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        events: events of the log (facts with a time), among them the events that a motor was at its limit.
        ending: event with which the flight was lost; None if it was not.

    Returns:
        Facts with the motor as subject, its ``excess`` above the others as a fraction of the range, and the time at the
        limit, s, as ``duration``.
    """
    motors = signals.motors
    if motors is None:
        return []
    losses = []
    for event in _unexplained_limits(events, ending):
        # The vehicle was lost in this boot, and so after the event.
        precedes_loss = ending is not None and ending.figures.get("boot") == event.figures["boot"]
        loss = _saturation_loss(signals, motors, event, is_lost=precedes_loss)
        if loss is not None:
            losses.append(loss)
    return losses


def _unexplained_limits(events: Sequence[Fact], ending: Fact | None) -> Iterator[Fact]:
    """Yields the events of motors at their limit that no other fault of the vehicle explains.

    Controllers drive sound motors to their limits too if the height estimate diverged in the same boot, after a motor
    stood still, and after the vehicle was lost. Such events are left out. An event may begin ``LASTING_SECONDS`` before
    or after the fault that caused it, since a state must last that long to be an event.

    Args:
        events: events of the log (facts with a time), among them the events that a motor was at its limit.
        ending: event with which the flight was lost; None if it was not.
    """
    latest_start_before_loss = _latest_start_before_ending(ending)
    boot_of_loss = None if ending is None else ending.figures.get("boot")
    standstill_by_boot = _first_standstill_by_boot(events)
    boots_with_diverged_height = set()
    for event in events:
        if event.code is MotionEvent.HEIGHT_DIVERGED:
            boots_with_diverged_height.add(event.figures["boot"])
    for event in events:
        if event.code is not MotionEvent.MOTOR_AT_ITS_STOP or event.time is None:
            continue
        boot = event.figures["boot"]
        # A height controller that follows a diverged height drives all motors up, sound ones too.
        is_by_diverged_height = boot in boots_with_diverged_height
        # After a motor stood still, the others work harder to replace it.
        standstill_time = standstill_by_boot.get(boot, inf)
        is_by_standstill = event.time >= standstill_time - LASTING_SECONDS
        is_in_boot_of_loss = ending is not None and boot == boot_of_loss
        is_by_loss = is_in_boot_of_loss and event.time > latest_start_before_loss
        if not (is_by_diverged_height or is_by_standstill or is_by_loss):
            yield event


def _latest_start_before_ending(ending: Fact | None) -> float:
    """Returns the time after which the loss of the flight itself explains that motors reach their limits.

    A motor that reached its limit earlier may be the cause of the loss.

    Args:
        ending: event with which the flight was lost; None if it was not.

    Returns:
        The time on the clock of the boot of the loss, s; infinite if no flight was lost, or the time is not known.
    """
    if ending is None or ending.time is None:
        return inf
    if ending.code is Ending.CRASHED:
        # The controller drives motors to their limits in the impact, so that only earlier limits are evidence.
        return (loss_onset(ending) or ending.time) - MAX_SETPOINT_DELAY
    return ending.time + LASTING_SECONDS


def _first_standstill_by_boot(events: Sequence[Fact]) -> dict[int, float]:
    """Returns the time at which a motor first stood still in each boot, s since boot.

    Args:
        events: events of the log, each a fact (a coded finding) with its time.
    """
    standstill_by_boot: dict[int, float] = {}
    for event in events:
        if event.code is MotionEvent.MOTOR_STOOD_STILL and event.is_bad:
            standstill_by_boot.setdefault(event.figures["boot"], event.start_time)
    return standstill_by_boot


def with_saturated_motor(
    ending: Fact | None, losses: Sequence[Fact], events: Sequence[Fact] = ()
) -> Fact | None:
    """Adds a motor that lost thrust as the cause to the event of a lost flight, if no other cause is known.

    It is added only if all losses of that boot, and the autopilot's own report if there is one, are of this one motor.
    The cause is that it was at its limit first, or, if another motor was at its limit just before, that its thrust was
    missing.

    Args:
        ending: event with which the flight was lost; None if it was not. Its figure ``cause`` is what failed first, if
            that is known already, and its subject the motor that the autopilot reported, if it did.
        losses: losses of motors (:func:`saturation_losses`), in any boot and in the order of time.
        events: events of the log (facts with a time), among them the events that a motor was at its limit.

    Returns:
        The event with cause and motor. It is unchanged if it has a cause, is no loss of control, or no motor is clearly
        the cause.
    """
    if ending is None or ending.code is not Ending.CONTROL_LOST or ending.figures["cause"]:
        return ending
    losses_in_boot = [loss for loss in losses if loss.figures["boot"] == ending.figures["boot"]]
    if not losses_in_boot:
        return ending
    named_motors = {loss.subject for loss in losses_in_boot}
    if ending.subject:
        named_motors.add(ending.subject)
    if len(named_motors) > 1:
        return ending
    last_loss = losses_in_boot[-1]
    if _was_other_motor_limited(last_loss, events):
        cause_code = FailedFirst.THRUST_MISSING_FIRST
    else:
        cause_code = FailedFirst.LIMIT_FIRST
    cause = Fact(cause_code, time=last_loss.time, subject=last_loss.subject)
    return ending.replace(subject=last_loss.subject, cause=cause)


def with_motors_limited_before(ending: Fact | None, events: Sequence[Fact]) -> Fact | None:
    """Adds to the event of a lost flight the motors that were at their limit before all thrust was used up.

    The mean command of all motors shows when all thrust is used up. But it hides a motor that worked at its limit long
    before the others came near theirs, which may be the weak one.

    Args:
        ending: event with which the flight was lost, with its cause as the figure ``cause``; None if it was not lost.
        events: events of the log (facts with a time), among them the events that a motor was at its limit.

    Returns:
        The event. Its cause has ``limited_names``, the motors that had been at their limit for ``MIN_LIMIT_SECONDS``
        when all thrust was used up, and ``limited_since``, the earliest of these times, s since boot. It is unchanged
        if there is no such motor, or another cause.
    """
    if ending is None:
        return None
    cause = ending.figures.get("cause")
    if cause is None or cause.code is not FailedFirst.THRUST_SPENT_FIRST:
        return ending
    latest_start_time = cause.time - MIN_LIMIT_SECONDS
    limited_motors = []
    start_times = []
    for event in events:
        if event.code is not MotionEvent.MOTOR_AT_ITS_STOP or event.time is None:
            continue
        if event.figures["boot"] != ending.figures["boot"]:
            continue
        # The motor must have come to its limit early enough, and must still have been there.
        if event.start_time <= latest_start_time and event.latest_time >= cause.time:
            limited_motors.append(event.subject)
            start_times.append(event.start_time)
    if not limited_motors:
        return ending
    cause = cause.replace(limited_names=tuple(limited_motors), limited_since=min(start_times))
    return ending.replace(cause=cause)


def _was_other_motor_limited(loss: Fact, events: Sequence[Fact]) -> bool:
    """Returns whether another motor was at its limit in the ``RECOVERY_SECONDS`` before a motor lost thrust.

    Args:
        loss: the loss, with the motor as subject.
        events: events of the log (facts with a time), among them the events that a motor was at its limit.
    """
    assert loss.time is not None
    for event in events:
        if event.code is not MotionEvent.MOTOR_AT_ITS_STOP or event.subject == loss.subject:
            continue
        if event.figures["boot"] != loss.figures["boot"] or event.time is None:
            continue
        if event.time < loss.time and event.latest_time >= loss.time - RECOVERY_SECONDS:
            return True
    return False


def _saturation_loss(
    signals: Signals, motors: MotorOutputs, event: Fact, *, is_lost: bool
) -> Fact | None:
    """Returns the fact that a motor at its limit lost thrust; None if the log does not show that.

    All of this must be true:

    - The motor is at its limit to the end of the record, to the loss of the vehicle, for ``RECOVERY_SECONDS``, or
      while the vehicle sinks to the ground.
    - The vehicle is off the ground, since the ground could make it lean.
    - The motor's command was close to the others' commands before, and is far from them at the limit.
    - The vehicle leans towards the motor, or sinks.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        motors: outputs and geometry of its k motors.
        event: fact (a coded finding) that one of them was at its limit, with its time.
        is_lost: whether the vehicle was lost after that.
    """
    boot = event.figures["boot"]
    start = event.time
    assert start is not None
    end = event.latest_time
    sensors = _sensors_in_flight(signals, boot, start)
    is_long_enough = is_lost or end == inf or end - start >= RECOVERY_SECONDS
    if not is_long_enough:
        is_long_enough = _sinks_to_ground(sensors, (start, end))
    if event.figures["duration"] < MIN_LIMIT_SECONDS or not is_long_enough:
        return None
    height = sensors.height_at(start)
    if height is not None and height < MAX_GROUND_HEIGHT:
        return None
    excess = _conspicuous_excess(signals, motors, event, (start, end))
    if excess is None:
        return None
    sink_rate = sensors.sink_rate((start, end)) or 0.0
    motor = motors.geometry.names.index(event.subject)
    leans = _leans_towards(signals, motors, motor, boot, (start, end))
    if not leans and sink_rate < MIN_CLIMB_SPEED:
        return None
    return Fact(
        MotorWatchFact.MOTOR_SATURATED,
        time=start,
        end_time=event.end_time,
        subject=event.subject,
        excess=excess,
        duration=event.figures["duration"],
        boot=boot,
    )


def _conspicuous_excess(
    signals: Signals, motors: MotorOutputs, event: Fact, interval: TimeInterval
) -> float | None:
    """Returns the excess of a limited motor's command over the mean of the other motors, if it is conspicuous.

    Three conditions must hold: this motor alone is at its limit most often, its mean excess is at least ``MIN_EXCESS``,
    and in the flight before the event its excess was at most ``MAX_FORMER_EXCESS``.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        motors: outputs and geometry of its k motors.
        event: fact (a coded finding) that one of them was at its limit, with its time.
        interval: start and end of the event, s since boot; the end may be infinite.

    Returns:
        Mean excess, as a fraction of the range; None if it is not conspicuous, or there are no samples in flight
        before.
    """
    boot = event.figures["boot"]
    start, _ = interval
    motor = motors.geometry.names.index(event.subject)
    commands = motors.range_fractions(boot)
    is_in_flight = in_intervals(commands.time, flights_in_boot(signals, boot))
    is_before_event = is_in_flight & (commands.time < start - LASTING_SECONDS)
    if not is_before_event.any():
        return None
    former_excesses = _command_excess(commands.values[is_before_event], motor)
    former_excess = np.quantile(former_excesses, FORMER_QUANTILE)
    commands_in_event = commands.values[in_intervals(commands.time, [interval])]
    excess = float(_command_excess(commands_in_event, motor).mean())
    is_at_limit, _ = samples_at_limits(commands_in_event, motors.scale)
    most_limited = most_limited_motors(motors.geometry.names, is_at_limit.sum(axis=0))
    is_most_limited_alone = most_limited == (event.subject,)
    has_changed = excess >= MIN_EXCESS and former_excess <= MAX_FORMER_EXCESS
    if not (is_most_limited_alone and has_changed):
        return None
    return excess


def _sensors_in_flight(signals: Signals, boot: int, time: float) -> BootSensors:
    """Returns the sensors of a boot, with heights above the take-off of the flight that a given time is in.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        time: s on the boot clock.

    Returns:
        The sensors. If the time is in no flight, heights are above the beginning of the record.
    """
    for flight in flights_in_boot(signals, boot):
        if in_intervals(time, [flight]):
            take_off, _ = flight
            return BootSensors(signals, boot, take_off)
    return BootSensors(signals, boot)


def _sinks_to_ground(sensors: BootSensors, interval: TimeInterval) -> bool:
    """Returns whether an interval ends with the flight, about, and the vehicle sinks to the ground in it.

    It must lose more than ``MAX_GROUND_HEIGHT`` of height, so that it was not on the ground for most of the time.

    Args:
        sensors: sensors of the boot.
        interval: start and end, s since boot.
    """
    start, end = interval
    ends_with_flight = False
    for take_off, landing in flights_in_boot(sensors.signals, sensors.boot):
        if take_off <= start and abs(landing - end) < LASTING_SECONDS:
            ends_with_flight = True
    height_at_start = sensors.height_at(start)
    height_at_end = sensors.height_at(end)
    if not ends_with_flight or height_at_start is None or height_at_end is None:
        return False
    height_loss = height_at_start - height_at_end
    return height_loss > MAX_GROUND_HEIGHT


def _command_excess(commands: Array, motor: int) -> Array:
    """Returns the excess of one motor's command over the mean of the others.

    Args:
        commands: (N, k) commands of k motors, as fractions of the range.
        motor: index of the motor.

    Returns:
        (N,) excess, as fractions of the range.
    """
    return commands[:, motor] - np.delete(commands, motor, axis=1).mean(axis=1)


def _leans_towards(
    signals: Signals, motors: MotorOutputs, motor: int, boot: int, interval: TimeInterval
) -> bool:
    """Returns whether the vehicle leans to the side of a motor, against its setpoint.

    Only the first second of the lean is examined, since an uncontrolled vehicle may later turn over to any side.

    Args:
        signals: logged time series of the vehicle, such as attitude, setpoints and motor outputs.
        motors: motors of the vehicle, with their positions.
        motor: index of the motor.
        boot: number of the boot; a boot lasts from one start of the autopilot to the next.
        interval: start and end of the time in which the lean may begin, s.

    Returns:
        Whether the mean lean of that second points to the motor within ``MAX_LEAN_ANGLE``. False too if attitude or
        positions are not known, or the motor is at the centre.
    """
    error = attitude_error(signals, boot)
    if error is None or not motors.geometry.positions:
        return False
    is_leaning = in_intervals(error.time, [interval]) & (error.magnitude >= MIN_LEAN_ERROR)
    leaning_times = error.time[is_leaning]
    if not len(leaning_times):
        return False
    # Lean and position are both complex numbers whose real part is forward, and whose imaginary part is to the right.
    position = complex(*motors.geometry.positions[motor])
    if position == 0:
        return False
    lean_start = leaning_times[0]
    first_second = (lean_start, lean_start + MAX_SETPOINT_DELAY)
    mean_lean = complex(error.lean[in_intervals(error.time, [first_second])].mean())
    # The quotient of two complex numbers has the angle between them.
    angle_from_motor = abs(float(np.angle(mean_lean / position)))
    return abs(mean_lean) >= MIN_LEAN_ERROR and angle_from_motor <= MAX_LEAN_ANGLE
