"""A higher cut-off of the gyro's low-pass filter, for rate loops whose phase margin the filter takes.

Both autopilots have a Butterworth low-pass of second order there (``filters``). Its phase lag at the crossover is lost
phase margin. A higher cut-off costs noise in the motors, so it is advised only where the noise stays below the
resolution of a motor's output. PX4's guide weighs the same two against each other:
https://docs.px4.io/main/en/config_mc/filter_tuning.
"""

from collections.abc import Iterable
from dataclasses import replace
from math import isfinite
from typing import NamedTuple

from mavdem.errors import NotLearnable
from mavdem.facts import Fact
from mavdem.facts.loops import GainFact
from mavdem.loops.axis_loops import Loop, MarginTarget, margin_rating
from mavdem.loops.demand_noise import demand_noise
from mavdem.loops.filters import gyro_filters

MIN_PHASE_LAG = 30.0
"""Least phase lag of the low-pass at the crossover, degrees, that is worth a higher cut-off: a choice.

It is two thirds of the usual phase margin, 45°.
"""
CUTOFF_FACTOR = 2.0
"""Factor by which the cut-off is raised: a choice, about that from ArduPilot's default of 20 Hz to PX4's of 40 Hz."""
NOISE_FACTOR = CUTOFF_FACTOR**2
"""Largest factor by which noise of the filtered gyro grows at any frequency.

The gain of the low-pass at f is 1 / √(1 + (f / f_c)⁴). With a cut-off k f_c in the place of f_c it grows by a factor
that rises with f from 1 to k².
"""
MAX_DEMAND_NOISE = 1e-3
"""Largest standard deviation of the gyro's noise in the demand: the resolution of a PWM output, 1 of 1000 µs."""
MAX_CUTOFFS = {"INS_GYRO_FILTER": 256.0, "IMU_GYRO_CUTOFF": 1000.0}
"""Highest cut-off that ArduPilot and PX4 document for the parameter of the gyro's low-pass, Hz.

They are in ``AP_InertialSensor.cpp`` ("Range: 0 256", 127 in old versions) and ``imu_gyro_parameters.c`` ("max 1000").
"""


class RaisedCutoff(NamedTuple):
    """A higher cut-off of the gyro's low-pass, and the loops of an axis with it."""

    name: str
    """Name of the parameter."""
    now: float
    """The cut-off in flight, Hz."""
    new: float
    """The higher cut-off, Hz."""
    loop: Loop
    """Rate and attitude loop of the axis with the logged gains and the higher cut-off."""


def with_raised_cutoff(loop: Loop) -> RaisedCutoff | None:
    """Returns the loops of an axis with the cut-off of the gyro's low-pass raised by ``CUTOFF_FACTOR``.

    Args:
        loop: rate and attitude loop of the axis as it flew.

    Returns:
        The cut-off with its loops. None without a low-pass, if the autopilot does not allow the higher cut-off, or if
        the phase that the low-pass takes at the crossover of the rate loop is not known.
    """
    name = "INS_GYRO_FILTER" if loop.controller.is_ardupilot else "IMU_GYRO_CUTOFF"
    cutoff = loop.controller.gyro_filter
    new_cutoff = CUTOFF_FACTOR * cutoff
    # The plant that was identified without the setpoint contains the filter.
    is_filter_known = isfinite(loop.rate.crossover) and not loop.plant.filtered
    if not is_filter_known or cutoff == 0 or new_cutoff > MAX_CUTOFFS[name]:
        return None
    try:
        return RaisedCutoff(name, cutoff, new_cutoff, loop.with_parameters({name: new_cutoff}))
    except NotLearnable:
        return None


def gyro_cutoff_advice(loops: Iterable[Loop], target: MarginTarget) -> Fact | None:
    """Advises a higher cut-off of the gyro's low-pass, which all axes share, to a vehicle that lacks margin by its lag.

    Args:
        loops: rate and attitude loops of the axes with the logged gains.
        target: margins that the loops should have.

    Returns:
        The advice of the axis that gains most, a fact (coded finding). None if no loop lacks margin by the phase lag of
        the filter, or if the noise of the gyro is not known on each axis, or may become too large on one.
    """
    advice = []
    for loop in loops:
        noise = demand_noise(loop, loop.controller)
        if noise is None:
            return None
        max_noise = NOISE_FACTOR * noise.before
        if max_noise > MAX_DEMAND_NOISE:
            return None
        advice_of_axis = _cutoff_advice_of_axis(loop, target, max_noise)
        if advice_of_axis is not None:
            advice.append(advice_of_axis)
    return max(advice, key=lambda fact: fact.figures["phase_lag"], default=None)


def _cutoff_advice_of_axis(loop: Loop, target: MarginTarget, max_noise: float) -> Fact | None:
    """Returns the advice for one axis, with what its loops have with the higher cut-off.

    It is None if the axis needs no such cut-off, or still lacks margin with it.

    Args:
        loop: rate and attitude loop of the axis with the logged gains.
        target: margins that the loops should have.
        max_noise: standard deviation that the gyro's noise causes in the demand at most with the higher cut-off.
    """
    crossover = loop.rate.crossover
    rating = margin_rating(loop, target)
    cutoff = with_raised_cutoff(loop)
    if cutoff is None or not rating.is_bad:
        return None
    phase_lag = low_pass_lag(loop, crossover)
    if phase_lag < MIN_PHASE_LAG:
        return None
    new_rating = margin_rating(cutoff.loop, target)
    if new_rating.is_bad:
        return None
    return Fact(
        GainFact.GYRO_CUTOFF_LOW,
        axis=loop.axis,
        name=cutoff.name,
        changes=((cutoff.name, cutoff.now, cutoff.new),),
        crossover=crossover,
        phase_lag=phase_lag,
        new_phase_lag=low_pass_lag(cutoff.loop, crossover),
        rating=rating,
        expected=new_rating,
        noise=max_noise,
    )


def low_pass_lag(loop: Loop, frequency: float) -> float:
    """Returns the phase lag of the gyro's low-pass alone at a frequency in Hz, degrees."""
    without_notches = replace(loop.controller, notches=())
    return gyro_filters(without_notches, frequency).phase_lag
