"""Noise of the gyro in the demand of a rate controller, which heats the motors."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite
from typing import NamedTuple

import numpy as np

from mavdem.arrays import Array
from mavdem.loops.axis_loops import Loop
from mavdem.loops.controllers import Controller
from mavdem.loops.margins import MAX_FREQUENCY_RATIO, controller_response
from mavdem.plant.power_density import power_density

MIN_NOISE_CROSSOVER_RATIO = 3.0
"""Lowest frequency at which the gyro shows noise and no motion, relative to the crossover of the rate loop: a choice.

Well above the crossover the loop has hardly any gain, so that the vehicle does not follow commands.
"""
MIN_NOISE_FREQUENCY = 10.0
"""Lowest such frequency of slow loops, Hz: a choice, above the motion that wind causes."""
NOISE_WINDOW = 256
"""Largest number of samples in a window of the noise's spectrum: a choice between resolution and scatter."""


class DemandNoise(NamedTuple):
    """Noise of the gyro in the demand, as standard deviations; a demand of 1 is all that the mixer takes."""

    lowest: float
    """Lowest frequency that counts as noise, Hz."""
    highest: float
    """Highest frequency that the log shows, Hz."""
    before: float
    """Noise with the gains of the log."""
    after: float
    """Noise with the gains to set."""
    by_d: float
    """Noise of the D term alone, with the gains of the log."""
    heat: float
    """Factor by which fast commands heat the motors more: it grows with the square of the noise."""


class GyroNoise(NamedTuple):
    """Noise of the gyro in flight, at frequencies above the motion of the vehicle."""

    frequency: Array
    """Frequencies (F,), Hz."""
    density: Array
    """Spectral density (F,) of the rate after the gyro's filters, (rad/s)²/Hz."""
    is_measured: bool
    """Whether the log shows the noise; if it is too slow for that, white noise is assumed."""


def gyro_noise(loop: Loop) -> GyroNoise:
    """Estimates the spectral density of the gyro's noise in a flight, by Welch's method.

    Up to about the crossover the body rate is motion of the vehicle. So noise is measured from
    ``MIN_NOISE_CROSSOVER_RATIO`` times the crossover on. If the log does not contain at least an octave above that,
    white noise of density 1 is assumed instead, up to the highest frequency of the loop and over at least an octave.
    That suffices to compare two controllers.

    Args:
        loop: the loops with the logged gains; its record has the measured rate.

    Returns:
        Frequencies (F,), Hz, and one-sided density (F,), (rad/s)²/Hz; and whether it was measured.
    """
    record = loop.record
    # The last output of an axis is its body rate, rad/s.
    rate = record.outputs[:, -1]
    window = min(NOISE_WINDOW, len(record))
    frequency, density = power_density(rate, 1 / record.dt, window)
    noise = noise_above_motion(loop, frequency, density, 1 / record.dt)
    if noise is not None:
        return noise
    highest = MAX_FREQUENCY_RATIO / loop.controller.loop_period
    # A loop with a high crossover has less than an octave above it.
    lowest = min(_lowest_noise_frequency(loop), highest / 2)
    assumed_frequency = np.linspace(lowest, highest)
    return GyroNoise(assumed_frequency, np.ones(len(assumed_frequency)), is_measured=False)


def noise_above_motion(
    loop: Loop, frequency: Array, density: Array, sampling_rate: float
) -> GyroNoise | None:
    """Returns the part of a gyro's spectrum that is noise: it is above the frequencies at which the vehicle moves.

    Args:
        loop: rate and attitude loop of the axis, whose crossover limits the motion.
        frequency: frequencies of the spectrum (F,), Hz.
        density: spectral density (F,) of the rate after the gyro's filters, (rad/s)²/Hz.
        sampling_rate: rate of the samples, Hz; the spectrum counts up to ``MAX_FREQUENCY_RATIO`` of it.

    Returns:
        The noise; None if it has less than an octave.
    """
    lowest = _lowest_noise_frequency(loop)
    highest = MAX_FREQUENCY_RATIO * sampling_rate
    if highest < 2 * lowest:
        return None
    is_noise = (frequency >= lowest) & (frequency <= highest)
    return GyroNoise(frequency[is_noise], density[is_noise], is_measured=True)


def _lowest_noise_frequency(loop: Loop) -> float:
    """Returns the frequency, Hz, from which on the gyro of a loop shows noise and no motion of the vehicle."""
    # The crossover is NaN if the gain of the loop is below 1 at all frequencies.
    if not isfinite(loop.rate.crossover):
        return MIN_NOISE_FREQUENCY
    return max(MIN_NOISE_CROSSOVER_RATIO * loop.rate.crossover, MIN_NOISE_FREQUENCY)


def demand_noise(loop: Loop, new_controller: Controller) -> DemandNoise | None:
    """Returns how much noise the gyro adds to the controller's torque demand, with the logged gains and with new ones.

    It shows what new gains cost: the noise of the demand accelerates and brakes the motors, and heats them.

    Args:
        loop: loops with the logged gains, and with the record that contains the noise.
        new_controller: controller with the gains to set.

    Returns:
        The standard deviations of the demand before and after the change; None if the log is too slow to measure the
        noise of the gyro.
    """
    noise = gyro_noise(loop)
    if not noise.is_measured:
        return None
    controller = loop.controller
    # The noise is measured after the gyro's filters, so only the controller is between it and the demand.
    deviation_before = demand_deviation(controller, noise)
    deviation_after = demand_deviation(new_controller, noise)
    # The response of the D term is the controller's response minus the response of one without D.
    deviation_by_d = demand_deviation(controller, noise, subtracted=replace(controller, d=0.0))
    return DemandNoise(
        lowest=noise.frequency[0],
        highest=noise.frequency[-1],
        before=deviation_before,
        after=deviation_after,
        by_d=deviation_by_d,
        heat=(deviation_after / deviation_before) ** 2,
    )


def demand_deviation(
    controller: Controller, noise: GyroNoise, subtracted: Controller | None = None
) -> float:
    """Returns the standard deviation σ that the gyro's noise causes in the demand: σ² = ∫ |C(jω)|² S df.

    C is the controller's response from the rate to the demand, and S the density of the noise. The integral is computed
    by the trapezoidal rule.

    Args:
        controller: the controller, with the response C.
        noise: the noise of the rate, with its density S in (rad/s)²/Hz.
        subtracted: a controller whose response is subtracted from C, so that σ is caused by one term of the controller.

    Returns:
        σ, as a fraction of the largest demand.
    """
    response = controller_response(controller, noise.frequency).from_rate
    if subtracted is not None:
        response = response - controller_response(subtracted, noise.frequency).from_rate
    power = np.abs(response) ** 2 * noise.density
    return float(np.sqrt(np.trapezoid(power, noise.frequency)))
