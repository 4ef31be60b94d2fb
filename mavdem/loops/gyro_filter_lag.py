"""The gyro's low-pass as the cause of a missing margin: the phase that it takes, and what a higher cut-off would give.

This is what to look at, and no advice to raise the cut-off: a higher one passes more of the gyro's noise to the motors.
``gyro_cutoff`` advises it where that noise is known to be small.
"""

from collections.abc import Iterable, Mapping
from math import atan, degrees, pi
from typing import NamedTuple

import numpy as np

from mavdem.containers import JsonValues
from mavdem.facts import Fact
from mavdem.facts.loops import GainFact
from mavdem.loops.advice import Advice
from mavdem.loops.axis_loops import Loop, margin_rating
from mavdem.loops.controllers import Controller
from mavdem.loops.demand_noise import GyroNoise, demand_deviation
from mavdem.loops.filters import gyro_response
from mavdem.loops.gyro_cutoff import MIN_PHASE_LAG, low_pass_lag, with_raised_cutoff
from mavdem.plant.parameters import ESTIMATE


class PhaseLags(NamedTuple):
    """Phase lag of the parts of a rate loop at one frequency, degrees."""

    low_pass: float
    """The gyro's low-pass filter."""
    motors: float
    """The motors, a lag of first order."""
    delay: float
    """The delay of the loop."""

    @property
    def is_mostly_of_low_pass(self) -> bool:
        """Whether the low-pass takes at least ``MIN_PHASE_LAG``, and more than the motors and than the delay."""
        return bool(self.low_pass >= max(MIN_PHASE_LAG, self.motors, self.delay))


def phase_lags(loop: Loop, frequency: float) -> PhaseLags:
    """Returns the phase lag of the low-pass, the motors and the delay of a rate loop, for the estimated plant.

    Args:
        loop: loop of one axis.
        frequency: the frequency, Hz, such as the crossover of the rate loop.
    """
    _, motor_lag, delay = loop.dynamics[ESTIMATE]
    return PhaseLags(
        low_pass=low_pass_lag(loop, frequency),
        motors=degrees(atan(2 * pi * frequency * motor_lag)),
        delay=360 * frequency * delay,
    )


def gyro_filter_lag(
    advice_on_axes: Iterable[Advice], noise_by_axis: Mapping[str, GyroNoise]
) -> Fact | None:
    """Returns the finding that the gyro's low-pass takes most of the phase that a rate loop lacks.

    Args:
        advice_on_axes: advice on the axes whose margins no measurement contradicts.
        noise_by_axis: noise of the gyro after its filters, by axis; axes without it are left out.

    Returns:
        The fact (coded finding) about the axis on which the low-pass takes most. None if each loop reaches its margin
        goal, or if other parts of the loops take more phase.
    """
    findings = []
    for advice in advice_on_axes:
        finding = _filter_lag_of_axis(advice, noise_by_axis.get(advice.before.axis))
        if finding is not None:
            findings.append(finding)
    return max(findings, key=lambda fact: fact.figures["phase_lag"], default=None)


def _filter_lag_of_axis(advice: Advice, noise: GyroNoise | None) -> Fact | None:
    """Returns the finding of :func:`gyro_filter_lag` on one axis.

    Args:
        advice: the loops of the axis with the logged and with the advised gains.
        noise: noise of the gyro after its filters; None if the log is too slow to show it.
    """
    loop = advice.before
    crossover = loop.rate.crossover
    cutoff = with_raised_cutoff(loop)
    if cutoff is None or not advice.rating.is_bad:
        return None
    lags = phase_lags(loop, crossover)
    if not lags.is_mostly_of_low_pass:
        return None
    figures: JsonValues = {}
    if advice.parameters:
        loop_with_both = advice.after.with_parameters({cutoff.name: cutoff.new})
        figures["expected_with_new_gains"] = margin_rating(loop_with_both, advice.target)
    if noise is not None:
        figures |= _noise_figures(loop.controller, cutoff.loop.controller, noise)
    return Fact(
        GainFact.GYRO_FILTER_LAG,
        axis=loop.axis,
        name=cutoff.name,
        changes=((cutoff.name, cutoff.now, cutoff.new),),
        crossover=crossover,
        phase_lag=lags.low_pass,
        motor_phase_lag=lags.motors,
        delay_phase_lag=lags.delay,
        new_phase_lag=low_pass_lag(cutoff.loop, crossover),
        rating=advice.rating,
        expected=margin_rating(cutoff.loop, advice.target),
        **figures,
    )


def _noise_figures(
    controller: Controller, controller_with_cutoff: Controller, noise: GyroNoise
) -> JsonValues:
    """Returns how much the gyro's noise moves the demand now and with a higher cut-off, with the logged gains.

    Args:
        controller: the controller that flew.
        controller_with_cutoff: the same with a higher cut-off of the gyro's low-pass.
        noise: noise of the gyro in flight, after the filters of the controller that flew.

    Returns:
        Figures of a fact: standard deviations of the demand, as fractions of its range, and the lowest and highest
        frequency of the noise, Hz.
    """
    frequency = noise.frequency
    filter_change = gyro_response(controller_with_cutoff, frequency) / gyro_response(
        controller, frequency
    )
    passed_noise = noise._replace(density=noise.density * np.abs(filter_change) ** 2)
    return {
        "noise": demand_deviation(controller, noise),
        "new_noise": demand_deviation(controller_with_cutoff, passed_noise),
        "lowest_noise": frequency[0],
        "highest_noise": frequency[-1],
    }
