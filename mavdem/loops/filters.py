"""Frequency responses of the gyro's low-pass and notch filters, after which an autopilot controls and logs rates.

The filters are second-order analog ones made discrete by the bilinear transform, so that their response is that of the
analog one at the warped frequency tan(π f / rate). Sources: ``LowPassFilter2p`` and ``NotchFilter`` of
https://github.com/ArduPilot/ardupilot and, by the same names, of https://github.com/PX4/PX4-Autopilot.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array
from mavdem.loops.autopilot_parameters import Notch
from mavdem.loops.controllers import Controller

MAX_NOTCH_FREQUENCY_RATIO = 0.48
"""Centre of a notch filter, relative to the rate it runs at, from which on it is off.

It is ArduPilot's ``HARMONIC_NYQUIST_CUTOFF``.
"""
DELAY_FREQUENCY = 0.1
"""Frequency at which the delay of the gyro's filters is computed, Hz: far below all cut-offs."""
PHASE_STEPS = 100
"""Number of frequencies between 0 and a given one over which phase is unwrapped."""


class GyroFilters(NamedTuple):
    """The gyro's filters, and what they cost."""

    low_pass: float
    """Cut-off of the second-order low-pass, Hz; 0 if there is none."""
    notches: tuple[Notch, ...]
    """The notch filters."""
    phase_lag: float
    """Phase lag of all filters together at a given frequency, degrees."""


def gyro_response(controller: Controller, frequency: Array) -> NDArray[np.complex128]:
    """Returns the response of the gyro's filters: the rate that is controlled and logged, per true rate.

    The low-pass is a Butterworth filter of second order, 1 / (1 + √2 jx − x²), in series with the notches. Here x is
    the frequency over the cut-off, both warped by the bilinear transform.

    Args:
        controller: controller with the parameters of the filters.
        frequency: frequencies (…), Hz, of any shape.

    Returns:
        Complex response (…), in the same shape.
    """
    rate = controller.gyro_rate
    response = notch_response(controller.notches, rate, frequency)
    cutoff = controller.gyro_filter
    if cutoff:
        warped_frequency = np.tan(np.pi * frequency / rate)
        warped_cutoff = np.tan(np.pi * min(cutoff / rate, MAX_NOTCH_FREQUENCY_RATIO))
        ratio = warped_frequency / warped_cutoff
        response /= 1 + 2**0.5 * 1j * ratio - ratio**2
    return response


def notch_response(
    notches: Iterable[Notch], rate: float, frequency: Array
) -> NDArray[np.complex128]:
    """Returns the response of several notch filters in series.

        N = (1 − x² + a jx / Q) / (1 − x² + jx / Q)

    with the frequency over the centre x, both warped by the bilinear transform, and the gain a at the centre.

    Args:
        notches: centre frequency, bandwidth and attenuation of each filter.
        rate: rate at which the filters run, Hz.
        frequency: frequencies (…), Hz, of any shape.

    Returns:
        Complex response (…), in the same shape.
    """
    warped_frequency = np.tan(np.pi * frequency / rate)
    response = np.ones(np.shape(frequency), complex)
    for notch in notches:
        if notch.frequency < MAX_NOTCH_FREQUENCY_RATIO * rate:
            ratio = warped_frequency / np.tan(np.pi * notch.frequency / rate)
            damping_term = 1j * ratio * _inverse_quality(notch, rate)
            center_gain = 10 ** (-notch.attenuation / 20)
            undamped_response = 1 - ratio**2
            response *= (undamped_response + center_gain * damping_term) / (
                undamped_response + damping_term
            )
    return response


def _inverse_quality(notch: Notch, rate: float) -> float:
    """Returns the damping 1/Q of a notch's poles, which determines its width.

    ArduPilot computes it for the analog filter as bandwidth divided by centre. PX4's notch, which has infinite
    attenuation, warps the bandwidth separately: its coefficient is α = tan(π bandwidth / rate), while that of the
    analog filter would be sin(2π centre / rate) / 2Q (``NotchFilter::setParameters``).

    Args:
        notch: notch filter with its centre below half of the rate.
        rate: rate at which the filter runs, Hz.

    Returns:
        The damping, without a unit.
    """
    if not np.isinf(notch.attenuation):
        return notch.bandwidth / notch.frequency
    alpha = np.tan(np.pi * min(notch.bandwidth / rate, MAX_NOTCH_FREQUENCY_RATIO))
    return float(2 * alpha / np.sin(2 * np.pi * notch.frequency / rate))


def gyro_delay(controller: Controller) -> float:
    """Returns the delay of the gyro's filters at low frequencies, s: the slope of their phase there, −φ / ω."""
    response = gyro_response(controller, np.array([DELAY_FREQUENCY]))
    phase = np.angle(response)[0]
    return -phase / (2 * np.pi * DELAY_FREQUENCY)


def gyro_filters(controller: Controller, frequency: float) -> GyroFilters:
    """Collects the filters of the gyro and computes their phase lag at one frequency.

    Args:
        controller: controller with the parameters of the filters.
        frequency: the frequency, Hz. At the crossover, the phase margin is smaller by the phase lag of the filters.

    Returns:
        The low-pass filter, the notches, and the phase lag of both together, degrees.
    """
    # The phase is unwrapped from frequency 0 on, since it may exceed half a turn.
    frequencies = np.linspace(0.0, frequency, PHASE_STEPS)
    phase = np.unwrap(np.angle(gyro_response(controller, frequencies)))
    phase_lag = -np.degrees(phase[-1])
    return GyroFilters(controller.gyro_filter, controller.notches, phase_lag)
