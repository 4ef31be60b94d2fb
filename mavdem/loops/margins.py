"""Stability margins of a rate or attitude loop from its open-loop frequency response, with intervals.

    L = P C,    S = 1 / (1 + L),    T = L / (1 + L)

P is the identified plant and C the known controller: an open loop estimated from the spectra of a flight's outputs and
inputs would be biased, since wind acts on both. Intervals are those of draws from the posterior of the plant. Figures
are defined as by K. J. Åström and R. M. Murray, Feedback Systems, 2nd ed., secs. 10.3 and 12.1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavdem.arrays import Array, Flags, Indices
from mavdem.confidence import INTERVAL_QUANTILES, Interval
from mavdem.immutable import ImmutableResult, freeze
from mavdem.ingest.vocabulary import wrapped_angle
from mavdem.loops.controllers import Controller
from mavdem.loops.filters import gyro_response, notch_response

Complex = NDArray[np.complex128]
"""Complex numbers of any shape, such as a frequency response."""


class FrequencyGrid(NamedTuple):
    """Frequencies of a response, evenly spaced on a logarithmic scale."""

    lowest: float
    """Hz."""
    highest: float
    """Hz; where the loop runs at less than 2.2 times that, the grid ends at ``MAX_FREQUENCY_RATIO`` of its rate."""
    points: int
    """How many frequencies there are."""


FINE_GRID = FrequencyGrid(0.02, 100.0, 500)
"""Frequencies of the margins that are reported."""
MAX_FREQUENCY_RATIO = 0.45
"""Highest frequency of a response, as a fraction of the rate of the loop: just below half of it."""
HALF_POWER_GAIN = 2**-0.5
"""Gain at which a response has half of the power, −3 dB: the end of the bandwidth."""
DECIBELS_PER_NEPER = 20 / np.log(10)
"""What natural logarithms of a gain are multiplied by for decibels."""


@dataclass(frozen=True)
class FigureEstimate:
    """Descriptor: attribute of :class:`Margins` that is a figure of the estimated plant, the first of its values."""

    name: str
    """The key in ``Margins.figures``."""

    def __get__(self, loop: Any, kind: type | None = None) -> float:
        return float(loop.figures[self.name][0])


@dataclass(frozen=True)
class FigureInterval:
    """Descriptor: attribute of :class:`Margins`, the 90 % interval (low, high) of a figure over draws of the plant."""

    name: str
    """The key in ``Margins.figures``."""

    def __get__(self, loop: Any, kind: type | None = None) -> Interval:
        # The method "nearest" takes values as they are: interpolation between infinite margins would give NaN.
        values = loop.figures[self.name]
        low, high = np.quantile(values, INTERVAL_QUANTILES, method="nearest").tolist()
        return low, high


class Margins(ImmutableResult):
    """The figures of a loop, each with its 90 % interval; of several crossings the smallest margin counts.

    A subclass has ``figures``: (N,) values of each by name, of the estimated plant and then of draws.
    """

    crossover = FigureEstimate("crossover")
    """Gain crossover: the highest frequency at which |L| = 1, Hz."""
    crossover_interval = FigureInterval("crossover")
    phase_margin = FigureEstimate("phase_margin")
    """Phase margin, degrees; negative where the loop is unstable."""
    phase_margin_interval = FigureInterval("phase_margin")
    gain_margin = FigureEstimate("gain_margin")
    """Gain margin, dB; infinite where L does not cross the negative real axis."""
    gain_margin_interval = FigureInterval("gain_margin")
    delay_margin = FigureEstimate("delay_margin")
    """Delay margin, s: the further delay by which the loop becomes unstable."""
    delay_margin_interval = FigureInterval("delay_margin")
    ms = FigureEstimate("ms")
    """Maximum sensitivity Ms, the largest |S|."""
    ms_interval = FigureInterval("ms")
    bandwidth = FigureEstimate("bandwidth")
    """Bandwidth: the frequency up to which the closed loop is at least −3 dB, Hz."""
    bandwidth_interval = FigureInterval("bandwidth")
    rejection = FigureEstimate("rejection")
    """The largest response of rate or angle to a torque, as an angular acceleration: s or s²."""
    rejection_interval = FigureInterval("rejection")


@dataclass(frozen=True, eq=False, repr=False)
class OpenLoop(Margins):
    """Frequency responses of a rate or attitude loop, opened at its controller.

    There are N responses at F frequencies: that of the estimated plant, and then those of draws from its posterior.
    """

    frequency: Array
    """(F,) Hz, ascending."""
    response: Complex
    """(N, F) open loop L; the minus sign of the feedback is not in it."""
    closed: Complex
    """(N, F) closed loop, from the setpoint to the rate or the angle."""
    disturbance: Complex
    """(N, F) from the torque of the wind, rad/s², to the rate, rad/s, or the angle, rad."""

    @cached_property
    def stable(self) -> Flags:
        """(N,) whether the closed loops are stable, by Nyquist's criterion.

        Open loops may have poles at 0 but none in the right half plane. As the frequency rises from 0 to infinity,
        1 + L then turns by a quarter turn for each pole at 0 if the closed loop is stable, and by a half turn or more
        besides if not. How many poles at 0 there are shows in the phase of L at the lowest frequency.
        """
        # The turn of 1 + L, rad, is the sum of small turns from each frequency to the next.
        phase_steps = wrapped_angle(np.diff(np.angle(1 + self.response), axis=1))
        # Each pole at 0 adds −90° to the phase of L there.
        poles_at_zero = np.round(-np.angle(self.response[:, 0]) / (np.pi / 2)).clip(0, 2)
        further_turn = phase_steps.sum(axis=1) - poles_at_zero * np.pi / 2
        return freeze(np.abs(further_turn) < np.pi)

    @cached_property
    def figures(self) -> Mapping[str, Array]:
        """(N,) values of each figure of :class:`Margins` by its name.

        Each margin is read where the response crosses something: the unit circle (phase and delay margin), the negative
        real axis (gain margin), or −3 dB (bandwidth). Crossings are interpolated linearly between frequencies, of the
        logarithms of gain and frequency. Where there is no crossing, margins are infinite, crossover and bandwidth NaN.
        """
        log_frequency = np.log(self.frequency)
        response = self.response
        log_gain = np.log(np.abs(response))

        gain_crossings = _ZeroCrossings.of(log_gain)
        crossover = np.exp(gain_crossings.interpolate(log_frequency))
        # The angle of −L is the phase above −180°. It is interpolated on the circle.
        phase_before = np.angle(-response[gain_crossings.rows, gain_crossings.columns])
        phase_after = np.angle(-response[gain_crossings.rows, gain_crossings.columns + 1])
        phase_step = wrapped_angle(phase_after - phase_before)
        phase_margin = wrapped_angle(phase_before + gain_crossings.fraction * phase_step)

        real_axis_crossings = _ZeroCrossings.of(response.imag)
        is_negative = real_axis_crossings.interpolate(response.real) < 0
        log_gain_margin = np.where(is_negative, -real_axis_crossings.interpolate(log_gain), np.nan)
        # A loop may become unstable by less gain too. The crossing nearest to −1 counts, with its sign.
        nearest = real_axis_crossings.minimum_by_row(np.abs(log_gain_margin))
        # The least distance has no sign: where it is that of a crossing with a negative margin, it is made negative.
        rows = real_axis_crossings.rows
        nearest[rows[log_gain_margin == -nearest[rows]]] *= -1

        half_power_crossings = _ZeroCrossings.of(np.abs(self.closed) - HALF_POWER_GAIN)
        log_bandwidth = half_power_crossings.minimum_by_row(
            half_power_crossings.interpolate(log_frequency)
        )
        delay_margin = phase_margin / (2 * np.pi * crossover)
        figures = {
            "crossover": -gain_crossings.minimum_by_row(-crossover),
            "phase_margin": np.degrees(
                _infinite_if_nan(gain_crossings.minimum_by_row(phase_margin))
            ),
            "gain_margin": DECIBELS_PER_NEPER * _infinite_if_nan(nearest),
            "delay_margin": _infinite_if_nan(gain_crossings.minimum_by_row(delay_margin)),
            "ms": 1 / np.abs(1 + response).min(axis=1),
            "bandwidth": np.exp(log_bandwidth),
            "rejection": np.abs(self.disturbance).max(axis=1),
        }
        return freeze(figures)


class _ZeroCrossings(NamedTuple):
    """Where the rows of values (N, F) change sign between two neighbouring columns, K crossings in all."""

    row_count: int
    """N."""
    rows: Indices
    """(K,) row of each crossing."""
    columns: Indices
    """(K,) column before each crossing."""
    fraction: Array
    """(K,) of the step to the next column at which the linearly interpolated value is 0."""

    @classmethod
    def of(cls, values: Array) -> _ZeroCrossings:
        """Finds the crossings of N functions with 0.

        Args:
            values: (N, F) each function at F points.
        """
        is_negative = np.signbit(values)
        rows, columns = np.nonzero(is_negative[:, :-1] != is_negative[:, 1:])
        before = values[rows, columns]
        after = values[rows, columns + 1]
        return cls(len(values), rows, columns, before / (before - after))

    def interpolate(self, values: Array) -> Array:
        """Returns the values of other functions at the crossings, linearly interpolated.

        Args:
            values: (N, F) each function at the same points, or (F,) one for all rows.

        Returns:
            (K,) value at each crossing.
        """
        values = np.broadcast_to(values, (self.row_count, values.shape[-1]))
        before = values[self.rows, self.columns]
        after = values[self.rows, self.columns + 1]
        return before + self.fraction * (after - before)

    def minimum_by_row(self, values: Array) -> Array:
        """Returns the least value among the crossings of each row.

        Args:
            values: (K,) at the crossings; NaN values are passed over.

        Returns:
            (N,) the least of each row; NaN where it has no crossing.
        """
        minimum = np.full(self.row_count, np.nan)
        np.fmin.at(minimum, self.rows, values)
        return minimum


def _infinite_if_nan(values: Array) -> Array:
    return np.where(np.isnan(values), np.inf, values)


def rate_loop(
    controller: Controller,
    effectiveness: Array,
    dynamics: Array,
    grid: FrequencyGrid = FINE_GRID,
) -> OpenLoop:
    """Returns the loop of the body rate, for N plants at once.

    The plant is a motor lag with a delay, then the rotation of the body with damping, then the gyro's filters:

        P = k e^(−s delay) / (lag s + 1) · 1 / (s + damping) · gyro filters,    L = C P

    Args:
        controller: C.
        effectiveness: (N,) k, angular acceleration per demand, rad/s², of N plants.
        dynamics: (N, 3) damping, 1/s, motor lag and delay, s, of each plant, without the gyro's filters.
        grid: frequencies of the responses.
    """
    highest = min(grid.highest, MAX_FREQUENCY_RATIO / controller.loop_period)
    frequency = np.geomspace(grid.lowest, highest, grid.points)
    s = 2j * np.pi * frequency
    damping, lag, delay = (column[:, None] for column in dynamics.T)
    delayed = np.exp(-s * delay)
    actuation = gyro_response(controller, frequency) * delayed / (lag * s + 1)
    rate_per_torque = 1 / (s + damping)
    plant = effectiveness[:, None] * actuation * rate_per_torque
    from_setpoint, from_rate = controller_response(controller, frequency)
    response = from_rate * plant
    closed = from_setpoint * plant / (1 + response)
    disturbance = rate_per_torque / (1 + response)
    return OpenLoop(frequency, response, closed, disturbance)


def attitude_loop(controller: Controller, rate: OpenLoop) -> OpenLoop:
    """Returns the loop of the attitude around the closed loop of the rate: L = angle gain / s · T_rate.

    The closed loop of the rate ends at the gyro's filters, behind which rates are controlled. The angle is not
    filtered: so their response is divided out.

    Args:
        controller: of the axis, with the gain of the attitude controller and the gyro's filters.
        rate: the rate loop of N plants, at the frequencies of the result.

    Returns:
        The loop with responses to the setpoint of the angle, and to torques: rad per rad/s².
    """
    s = 2j * np.pi * rate.frequency
    filters = gyro_response(controller, rate.frequency)
    response = controller.angle_gain / s * rate.closed / filters
    closed = response / (1 + response)
    disturbance = rate.disturbance / s / (1 + response)
    return OpenLoop(rate.frequency, response, closed, disturbance)


class ControllerResponse(NamedTuple):
    """Frequency responses of a rate controller."""

    from_setpoint: Complex
    """(…) demand per rad/s of the rate's setpoint."""
    from_rate: Complex
    """(…) demand per rad/s of the gyro's rate; the minus sign of the feedback is not in it."""


def controller_response(controller: Controller, frequency: Array) -> ControllerResponse:
    """Returns the responses of a discrete-time rate controller, with z = e^(jω h) for its loop period h.

    The integral is I h / (1 − z⁻¹), the derivative D (1 − z⁻¹) / h, and a first-order low-pass of cut-off f is
    a / (1 − (1 − a) z⁻¹) with a = h / (h + 1 / (2π f)). ArduPilot's ``AC_PID`` differentiates the error and filters the
    setpoint; PX4's ``RateControl`` differentiates the rate, and integrates the error after it has been used.

    Args:
        controller: of one axis.
        frequency: (…) Hz.
    """
    period = controller.loop_period
    # z⁻¹
    previous = np.exp(-2j * np.pi * frequency * period)

    def low_pass(cutoff: float) -> Any:
        # A cut-off of 0 is no filter.
        weight = period / (period + 1 / (2 * np.pi * cutoff)) if cutoff else 1.0
        return weight / (1 - (1 - weight) * previous)

    derivative = controller.d * low_pass(controller.derivative_filter) * (1 - previous) / period
    integral = controller.i * period / (1 - previous)
    # ArduPilot: P, I and D act on the filtered error, feed-forward on the filtered setpoint.
    if controller.derivative_of_error:
        from_error = low_pass(controller.error_filter) * (controller.p + integral + derivative)
        from_error = from_error * notch_response(controller.error_notches, 1 / period, frequency)
        feed_forward = controller.ff + controller.derivative_ff * (1 - previous) / period
        target_notches = notch_response(controller.target_notches, 1 / period, frequency)
        target_filters = low_pass(controller.target_filter) * target_notches
        return ControllerResponse(target_filters * (from_error + feed_forward), from_error)
    # PX4: D acts on the rate alone, and the integral is used one period late.
    proportional_integral = controller.p + previous * integral
    output_filter = low_pass(controller.output_filter)
    return ControllerResponse(
        output_filter * (proportional_integral + controller.ff),
        output_filter * (proportional_integral + derivative),
    )
