"""Filters: frequency responses of what stands between a vehicle's true rate and the one that is controlled and logged.

Second-order filters by the bilinear transform are analog ones on a warped axis of frequency, tan(π f / rate). Sources:
``LowPassFilter2p`` and ``NotchFilter`` of https://github.com/ArduPilot/ardupilot and, by the same names, of
https://github.com/PX4/PX4-Autopilot.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array
from mavdem.loops.controllers import Controller, Notch

MAX_NOTCH_FREQUENCY_RATIO = 0.48
"""Of the rate it runs at: a notch filter from there on is off (``HARMONIC_NYQUIST_CUTOFF`` of ArduPilot)."""


class GyroFilters(NamedTuple):
    """The gyro's filters, and what they cost."""

    low_pass: float  # Hz, of the second-order low-pass; 0 where there is none
    notches: tuple[Notch, ...]
    phase_lag: float  # degrees, of all at a frequency


def gyro_response(controller: Controller, frequency: Array) -> NDArray[np.complex128]:
    """Returns (…) the rate that is controlled and logged by the true one, at ``frequency`` (…), Hz."""
    rate = controller.gyro_rate
    response = notched(controller.notches, rate, frequency)
    cutoff = controller.gyro_filter
    if cutoff:
        warped = np.tan(np.pi * frequency / rate)
        warped_cutoff = np.tan(np.pi * min(cutoff / rate, MAX_NOTCH_FREQUENCY_RATIO))
        share = warped / warped_cutoff
        response /= 1 + 2**0.5 * 1j * share - share**2
    return response


def notched(notches: Iterable[Notch], rate: float, frequency: Array) -> NDArray[np.complex128]:
    """Returns (…) the response of ``notches`` that run at a ``rate``, Hz, at ``frequency`` (…), Hz."""
    warped = np.tan(np.pi * frequency / rate)
    response = np.ones(np.shape(frequency), complex)
    for notch in notches:
        if notch.frequency < MAX_NOTCH_FREQUENCY_RATIO * rate:
            share = warped / np.tan(np.pi * notch.frequency / rate)
            damped = 1j * share * notch.bandwidth / notch.frequency
            kept = 10 ** (-notch.attenuation / 20)
            undamped = 1 - share**2
            response *= (undamped + kept * damped) / (undamped + damped)
    return response


def gyro_delay(controller: Controller) -> float:
    """Returns by how much the gyro's filters delay slow motion, s."""
    slow = 0.1  # Hz, far below all
    response = gyro_response(controller, np.array([slow]))
    phase = np.angle(response)[0]
    return -phase / (2 * np.pi * slow)


def gyro_filters(controller: Controller, frequency: float) -> GyroFilters:
    """Returns the gyro's filters, and their phase lag at a ``frequency``, Hz, such as the crossover."""
    # from low frequencies on, so that it may be more than half a turn
    upwards = np.linspace(0.0, frequency, 100)
    response = gyro_response(controller, upwards)
    phase = np.unwrap(np.angle(response))
    lag = -np.degrees(phase[-1])
    return GyroFilters(controller.gyro_filter, controller.notches, lag)
