"""Motors of a live vehicle that stay at their upper limit, where they leave the controller no authority."""

from __future__ import annotations

import numpy as np

from mavdem.arrays import Flags
from mavdem.assessment.failure_by_commands import SPENT_THRUST_SHARE
from mavdem.containers import Names
from mavdem.dataset.motor_outputs import MotorOutputs
from mavdem.facts import Fact
from mavdem.facts.motors import MotorsLight
from mavdem.live.samples import DECISION_SECONDS
from mavdem.motors.saturation import most_limited_motors

ALARMING_SHARE = 0.7
"""Share of the last seconds in which a motor is at its upper limit: an alarm.

Healthy vehicles that yaw or climb reach about half of it.
"""

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
        The fact, with the names of the motors and the time, s, over which they were tested. None if no motor was at its
        limit for so long, if all thrust is in use, or without outputs in these seconds.
    """
    recent_count = int(np.count_nonzero(motors.time >= now - DECISION_SECONDS))
    if not recent_count or len(is_at_upper) < MIN_LIMIT_SAMPLES:
        return None
    recent = slice(-max(recent_count, MIN_LIMIT_SAMPLES), None)
    mean_outputs = motors.scale.fraction(motors.outputs[recent]).mean(axis=0)
    # Where all thrust is in use, as in a climb at full throttle, it is by chance which motor is at its limit.
    has_reserve = mean_outputs.min() < SPENT_THRUST_SHARE * motors.scale.stop
    fact = _limited_motor(motors.geometry.names, is_at_upper[recent])
    if fact is None or not has_reserve:
        return None
    return fact.replace(duration=now - motors.time[recent][0])


def with_earlier_motors(limited_motor: Fact, alarm: Fact | None) -> Fact:
    """Adds the motors of the active alarm to those at their limit now, since motors that take turns are one event.

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
    return limited_motor.replace(
        subject=names[0] if len(names) == 1 else "",
        names=names,
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
    shares = is_at_upper.mean(axis=0)
    largest_share = shares.max()
    if largest_share < ALARMING_SHARE or shares.min() >= ALARMING_SHARE:
        return None
    limited_names = most_limited_motors(names, shares)
    return Fact(
        MotorsLight.MOTOR_LIMITED,
        subject=limited_names[0] if len(limited_names) == 1 else "",
        names=limited_names,
        share=largest_share,
    )
