"""Motors of a live vehicle that stay at their upper limit, where they leave the controller no authority."""

from __future__ import annotations

import numpy as np

from mavdem.arrays import Flags
from mavdem.assessment.failure_by_commands import SPENT_THRUST_SHARE
from mavdem.assessment.height_divergence import MIN_TRUE_CLIMB
from mavdem.containers import Names
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.dataset.time_series import TimeSeries
from mavdem.facts import Fact, Level
from mavdem.facts.motors import MotorsLight
from mavdem.facts.watch import WatchFact
from mavdem.live.samples import DECISION_SECONDS
from mavdem.motors.saturation import equally_loaded_motors, most_limited_motors

ALARMING_SHARE = 0.7
"""Share of the last seconds in which a motor is at its upper limit: an alarm.

Healthy vehicles that yaw or climb reach about half of it.
"""

MIN_CLIMB_RATES = 3
"""Least number of estimated speeds in these seconds by which a vehicle sinks, a choice: they come at 2 to 10 Hz."""

MIN_LIMIT_SAMPLES = 10
"""Least number of outputs by which a motor is said to stay at its limit, a choice: a single one may be of a gust."""


def motor_at_upper_limit(motors: MotorOutputs, is_at_upper: Flags, now: float) -> Fact | None:
    """Returns the fact that a motor has been at its upper limit for most of the last ``DECISION_SECONDS``.

    If the outputs come slowly, the last ``MIN_LIMIT_SAMPLES`` count instead.

    Args:
        motors: outputs of k motors in the last seconds, N samples.
        is_at_upper: (N, k) whether each output is at its motor's upper limit.
        now: present time on the boot clock, s.

    Returns:
        The fact, with the names of the motors, the names of others with as high a mean output (``equally_loaded``), and
        the time, s, over which they were tested. Its subject is the motor, if a single one stands out. None if no motor
        was at its limit for so long, if all thrust is in use, or without outputs in these seconds.
    """
    recent_count = int(np.count_nonzero(motors.time >= now - DECISION_SECONDS))
    if recent_count == 0 or len(is_at_upper) < MIN_LIMIT_SAMPLES:
        return None
    # The last samples, at least as many as a decision needs.
    tested_count = max(recent_count, MIN_LIMIT_SAMPLES)
    tested_times = motors.time[-tested_count:]
    tested_outputs = motors.scale.fraction(motors.outputs[-tested_count:])
    # Where all thrust is in use, as in a climb at full throttle, it is by chance which motor is at its limit.
    mean_outputs = tested_outputs.mean(axis=0)
    has_reserve = mean_outputs.min() < SPENT_THRUST_SHARE * motors.scale.upper_limit
    motor_names = motors.geometry.names
    fault = _limited_motor(motor_names, is_at_upper[-tested_count:])
    if fault is None or not has_reserve:
        return None
    # Strong wind drives the motors on one side of the vehicle to their limits. None of them is weak then, and none
    # stands out as the subject of the fault.
    deviations = dict(zip(motor_names, mean_outputs - mean_outputs.mean(), strict=True))
    equally_loaded = equally_loaded_motors(deviations, fault.figures["names"])
    return fault.replace(
        subject="" if equally_loaded else fault.subject,
        equally_loaded=equally_loaded,
        duration=now - tested_times[0],
        is_in_flight=True,
    )


def sinks_at_limit(
    motors: MotorOutputs, is_at_upper: Flags, climb_rate: TimeSeries, now: float
) -> Fact | None:
    """Returns the fact that a vehicle sinks with motors at their upper limit: no reserve is left to stop that.

    Args:
        motors: outputs of k motors in the last seconds, N samples.
        is_at_upper: (N, k) whether each output is at its motor's upper limit.
        climb_rate: estimated speed upward, m/s.
        now: present time on the boot clock, s.

    Returns:
        The fact, with the present speed, and the names of the motors that have been at their limit for most of the last
        ``DECISION_SECONDS``, or none where all were. None if no motor was, or if the vehicle has not sunk faster than
        ``MIN_TRUE_CLIMB`` all that time.
    """
    start_time = now - DECISION_SECONDS
    recent_rates = climb_rate.values[climb_rate.time >= start_time]
    recent_flags = is_at_upper[motors.time >= start_time]
    if len(recent_rates) < MIN_CLIMB_RATES or len(recent_flags) < MIN_LIMIT_SAMPLES:
        return None
    # The fraction of these seconds in which each motor is at its limit.
    limited_fractions = recent_flags.mean(axis=0)
    is_sinking = bool((recent_rates <= -MIN_TRUE_CLIMB).all())
    if not is_sinking or limited_fractions.max() < ALARMING_SHARE:
        return None
    limited_names: Names = ()
    are_all_limited = limited_fractions.min() >= ALARMING_SHARE
    if not are_all_limited:
        limited_names = most_limited_motors(motors.geometry.names, limited_fractions)
    return Fact(
        WatchFact.SINKS_AT_LIMIT,
        Level.BAD,
        subject=limited_names[0] if len(limited_names) == 1 else "",
        names=limited_names,
        share=limited_fractions.max(),
        speed=-float(recent_rates[-1]),
    )


def with_motors_of_alarm(limited_motor: Fact, alarm: Fact | None) -> Fact:
    """Joins the motors at their limit now with those of the active alarm, so that both give one alarm.

    In a vehicle without reserve of thrust, motors reach their limit in turn: each would begin another alarm.

    Args:
        limited_motor: fact on the motors that are at their limit now, with their names and share of the time.
        alarm: the active alarm, the same fact on motors that were at their limit before; None without an alarm.

    Returns:
        The fact on all these motors, with the larger share.
    """
    if alarm is None:
        return limited_motor
    # A dictionary keeps each name once, in order.
    names = tuple(dict.fromkeys((*alarm.figures["names"], *limited_motor.figures["names"])))
    equally_loaded = tuple(
        name for name in limited_motor.figures["equally_loaded"] if name not in names
    )
    stands_out = len(names) == 1 and not equally_loaded
    return limited_motor.replace(
        subject=names[0] if stands_out else "",
        names=names,
        equally_loaded=equally_loaded,
        share=max(alarm.figures["share"], limited_motor.figures["share"]),
    )


def _limited_motor(names: Names, is_at_upper: Flags) -> Fact | None:
    """Returns the fact that a motor is at its upper limit in at least ``ALARMING_SHARE`` of some samples.

    Args:
        names: names of the k motors.
        is_at_upper: (N, k) whether each output is at its motor's upper limit.

    Returns:
        The fact; None if no motor is, or if all are, as in a climb at full throttle.
    """
    # The fraction of the samples in which each motor is at its limit.
    limited_fractions = is_at_upper.mean(axis=0)
    is_any_limited = limited_fractions.max() >= ALARMING_SHARE
    are_all_limited = limited_fractions.min() >= ALARMING_SHARE
    if not is_any_limited or are_all_limited:
        return None
    limited_names = most_limited_motors(names, limited_fractions)
    return Fact(
        MotorsLight.MOTOR_LIMITED,
        subject=limited_names[0] if len(limited_names) == 1 else "",
        names=limited_names,
        share=limited_fractions.max(),
    )
