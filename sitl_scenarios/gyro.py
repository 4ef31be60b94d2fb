"""Simulated gyro: body rates with vibration, after an autopilot's low-pass and notch filters.

The filters are ``LowPassFilter2p`` and ``NotchFilter`` of ArduPilot and PX4: analog filters of second order, on the
warped frequencies of the bilinear transform, tan(π f / sampling rate).
"""

from collections.abc import Sequence
from functools import partial
from math import pi, sqrt, tan
from operator import add

import numpy as np
from numpy.polynomial.polynomial import polyval

from mavdem.loops.autopilot_parameters import Notch
from mavdem.loops.controllers import Controller
from mavdem.loops.filters import MAX_NOTCH_FREQUENCY_RATIO
from mavdem.loops.margins import Complex
from sitl_scenarios.dynamics import AirState, Body, State, steps_in
from sitl_scenarios.motion import Array
from sitl_scenarios.sensors import GyroVibration
from sitl_scenarios.vectors import Vector3, Vector4

MAX_SAMPLING_PERIOD = 1e-3
"""Longest period of the gyro's samples, s: autopilots sample theirs at 1 kHz and more."""

NO_ROTATION = (0.0, 0.0, 0.0)
"""Body rates of a vehicle that does not rotate, rad/s."""

IDENTITY_SECTION = [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]
"""Second-order section (b0, b1, b2, a0, a1, a2) that passes everything."""


class Gyro:
    """Gyro of a vehicle in flight.

    ``raw_rates`` are the body rates with vibration, before the filters, and ``filtered_rates`` the rates after them,
    both in rad/s.
    """

    def __init__(self, filters: Controller | None, cycle: float) -> None:
        """Designs the low-pass and notch filters as second-order sections, one after another.

        Args:
            filters: Controller whose gyro filters are used; None: the gyro has no filters. Those whose frequency is too
                high for the sampling period are left out.
            cycle: Period of the autopilot's loop, s.
        """
        self._samples = gyro_samples(cycle)
        step = cycle / self._samples
        self.raw_rates: Vector3 = NO_ROTATION
        self.filtered_rates: Vector3 = NO_ROTATION
        sections = [IDENTITY_SECTION]
        if filters is not None:
            if 0 < filters.gyro_filter * step < MAX_NOTCH_FREQUENCY_RATIO:
                sections.append(_low_pass_section(filters.gyro_filter, step))
            for notch in filters.notches:
                if notch.frequency * step < MAX_NOTCH_FREQUENCY_RATIO:
                    sections.append(_notch_section(notch, step))
        # The frequency response needs one section at least: the first one passes everything, and is not run.
        self._sections = np.array(sections)
        self._filters = self._sections[1:].tolist()
        # Two states of each filter (direct form II transposed), for the three axes one after another.
        self._filter_states = [[0.0] * 6 for _ in self._filters]
        self._step = step

    def response(self, frequency: Array) -> Complex:
        """Returns the frequency response of the filters in series.

        Args:
            frequency: Frequencies (F,), Hz.

        Returns:
            Complex responses (F,).
        """
        # ``scipy.signal.sosfreqz`` does the same, but that package takes half a second to import.
        one_sample_earlier = np.exp(-2j * pi * frequency * self._step)
        # Coefficients of numerators and denominators, (3, sections) each.
        numerators, denominators = np.split(self._sections.T, 2)
        ratios = polyval(one_sample_earlier, numerators) / polyval(one_sample_earlier, denominators)
        return np.asarray(np.prod(ratios, axis=0))

    def advance(
        self,
        body: Body,
        state: State,
        settled_speeds: Vector4,
        air: AirState,
        vibration: GyroVibration | None = None,
    ) -> State:
        """Moves the body by one cycle of the autopilot, and measures its rates.

        The filters of an autopilot run at the sampling rate of the gyro, which is higher than the rate of the control
        loop. With filters or vibration, the gyro therefore takes a sample after each step of the physics. Afterwards
        ``raw_rates`` and ``filtered_rates`` belong to the end of the cycle.

        Args:
            body: Body that moves, with the same cycle as the gyro.
            state: State at the beginning.
            settled_speeds: Speeds (n,) that the rotors tend to, rad/s.
            air: Velocity of the air, and moments on the vehicle, during the cycle.
            vibration: Vibration that is added to the rates; None for none.

        Returns:
            The state at the end.
        """
        felt_vibration = vibration if vibration is not None and vibration.is_felt else None
        if felt_vibration is None and not self._filters:
            # Nothing depends on the rates between: they need not be measured after each step.
            state = body.advanced(state, settled_speeds, air)
            self.raw_rates = self.filtered_rates = state.rates
            return state
        measure = partial(self.measure, vibration=felt_vibration)
        return body.advanced(state, settled_speeds, air, self._samples, measure)

    def measure(
        self, rates: Vector3, rotors: Sequence[float], vibration: GyroVibration | None = None
    ) -> None:
        """Takes one sample of the gyro, and runs the filters on it.

        Args:
            rates: Body rates (3,), rad/s.
            rotors: Rotor speeds (n,), rad/s.
            vibration: Vibration that is added to the rates; None for none.
        """
        self.raw_rates = rates
        if vibration is not None:
            self.raw_rates = tuple(map(add, rates, vibration.sample(rotors)))
        self.filtered_rates = self._filtered(self.raw_rates)

    def _filtered(self, rates: Vector3) -> Vector3:
        """Runs the filters of all axes for one sample.

        It is the direct form II transposed of the second-order sections. It is written out, because a call of SciPy's
        filter takes longer than a step of the physics, and one of a function for each axis twice as long.

        Args:
            rates: Body rates (3,) before the filters, rad/s.

        Returns:
            Body rates (3,) after the filters, rad/s.
        """
        p, q, r = rates
        # The section's a0 is 1.
        for (b0, b1, b2, _, a1, a2), states in zip(self._filters, self._filter_states, strict=True):
            p1, p2, q1, q2, r1, r2 = states
            filtered_p = b0 * p + p1
            filtered_q = b0 * q + q1
            filtered_r = b0 * r + r1
            states[:] = (
                b1 * p - a1 * filtered_p + p2,
                b2 * p - a2 * filtered_p,
                b1 * q - a1 * filtered_q + q2,
                b2 * q - a2 * filtered_q,
                b1 * r - a1 * filtered_r + r2,
                b2 * r - a2 * filtered_r,
            )
            p, q, r = filtered_p, filtered_q, filtered_r
        return p, q, r


def gyro_samples(cycle: float) -> int:
    """Returns the number of samples of the gyro in a cycle of the autopilot, s."""
    return steps_in(cycle, MAX_SAMPLING_PERIOD)


def _low_pass_section(cutoff: float, step: float) -> list[float]:
    """Returns the coefficients of a Butterworth low-pass filter of second order, as ``LowPassFilter2p`` has it.

    Its analog prototype is k² / (s² + √2 k s + k²), with the warped cut-off frequency k = tan(π f step).

    Args:
        cutoff: Cut-off frequency f, Hz.
        step: Sampling period, s.

    Returns:
        Second-order section b0, b1, b2, a0, a1, a2, with a0 = 1.
    """
    k = tan(pi * cutoff * step)
    return _digital_section((0.0, 0.0, k * k), (1.0, sqrt(2) * k, k * k))


def _notch_section(notch: Notch, step: float) -> list[float]:
    """Returns the coefficients of a digital notch filter, as ``NotchFilter`` of ArduPilot and PX4 has it.

    Its analog prototype is (s² + d g s + k²) / (s² + d s + k²). The warped frequency k = tan(π f step) puts the
    centre of the digital notch at exactly f. The damping d is k times bandwidth over frequency, and g is the gain at
    the centre of the notch.

    Args:
        notch: Centre frequency f and bandwidth, Hz, and attenuation at the centre, dB.
        step: Sampling period, s.

    Returns:
        Second-order section b0, b1, b2, a0, a1, a2, with a0 = 1.
    """
    k = tan(pi * notch.frequency * step)
    damping = k * notch.bandwidth / notch.frequency
    damping_at_centre = damping * 10 ** (-notch.attenuation / 20)
    return _digital_section((1.0, damping_at_centre, k * k), (1.0, damping, k * k))


def _digital_section(numerator: Vector3, denominator: Vector3) -> list[float]:
    """Converts an analog filter of second order to a digital one, by the bilinear transform s = (z − 1)/(z + 1).

    ``scipy.signal.bilinear`` does the same, but importing that package would take a second.

    Args:
        numerator: Coefficients (3,) of s², s and 1.
        denominator: Coefficients (3,) of s², s and 1.

    Returns:
        Second-order section b0, b1, b2, a0, a1, a2, with a0 = 1.
    """
    coefficients = []
    for square, linear, constant in (numerator, denominator):
        # Times (z + 1)², the polynomial is (z − 1)² square + (z − 1)(z + 1) linear + (z + 1)² constant. These are its
        # coefficients of z², z and 1.
        coefficients += [
            square + linear + constant,
            2 * (constant - square),
            square - linear + constant,
        ]
    a0 = coefficients[3]
    return [coefficient / a0 for coefficient in coefficients]
