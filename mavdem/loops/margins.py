"""Stability margins of a rate or attitude loop from its open-loop frequency response, with intervals.

    L = P C,    S = 1 / (1 + L),    T = L / (1 + L)

P is the identified plant and C the known controller: an open loop estimated from the spectra of a flight's outputs and
inputs would be biased, since wind acts on both. Intervals follow from draws from the posterior of the plant.
Margins are defined as by K. J. Åström and R. M. Murray, Feedback Systems, 2nd ed., secs. 10.3 and 12.1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
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
from mavdem.plant.parameters import ESTIMATE

Complex = NDArray[np.complex128]
"""Complex numbers of any shape, such as a frequency response."""


class FrequencyGrid(NamedTuple):
    """Frequencies of a response, evenly spaced on a logarithmic scale."""

    lowest: float
    """Hz."""
    highest: float
    """Hz; if the loop runs at less than 2.2 times that, the grid ends at ``MAX_FREQUENCY_RATIO`` of its rate."""
    points: int
    """How many frequencies there are."""


FINE_GRID = FrequencyGrid(0.02, 100.0, 500)
"""Frequencies of the margins that are reported."""
MAX_FREQUENCY_RATIO = 0.45
"""Highest frequency of a response, as a fraction of the rate of the loop: just below half of it."""
HALF_POWER_GAIN = 2**-0.5
"""Gain at which a response has half of the power, −3 dB: the end of the bandwidth."""
SIGNED_MARGINS = ("phase_margin", "gain_margin", "delay_margin")
"""Characteristics that are negative if a loop is unstable."""
DECIBELS_PER_NEPER = 20 / np.log(10)
"""What natural logarithms of a gain are multiplied by for decibels."""


@dataclass(frozen=True)
class EstimatedCharacteristic:
    """Descriptor: attribute of :class:`Margins` with a characteristic of the loop, such as its phase margin.

    Its value is that of the loop with the estimated plant.
    """

    name: str
    """The key in ``Margins.characteristics``."""

    def __get__(self, loop: Any, owner: type | None = None) -> float:
        """Returns the characteristic of the loop with the estimated plant."""
        return float(loop.characteristics[self.name][ESTIMATE])


@dataclass(frozen=True)
class CharacteristicInterval:
    """Descriptor: attribute of :class:`Margins` with the 90 % interval (low, high) of a characteristic of the loop.

    The interval is that of the values over draws of the plant.
    """

    name: str
    """The key in ``Margins.characteristics``."""

    def __get__(self, loop: Any, owner: type | None = None) -> Interval:
        """Returns the lower and upper end of the 90 % interval of the characteristic.

        A margin below 0 belongs to an unstable loop. If the estimate is stable, so was the loop that flew: the interval
        of its margins ends at the limit of stability.
        """
        # The method "nearest" takes values as they are: interpolation between infinite margins would give NaN.
        values = loop.characteristics[self.name]
        low, high = np.quantile(values, INTERVAL_QUANTILES, method="nearest").tolist()
        if self.name in SIGNED_MARGINS and values[ESTIMATE] >= 0:
            low = max(low, 0.0)
        return low, high


class Margins(ImmutableResult):
    """Stability margins and other characteristics of a loop, each with its 90 % interval.

    If the response crosses a limit several times, the smallest margin counts. A subclass has ``characteristics``: by
    name, the values (N,) of each, with the estimated plant first, then with draws from its posterior.
    """

    crossover = EstimatedCharacteristic("crossover")
    """Gain crossover: the highest frequency at which |L| = 1, Hz."""
    crossover_interval = CharacteristicInterval("crossover")
    phase_margin = EstimatedCharacteristic("phase_margin")
    """Phase margin, degrees; negative if the loop is unstable."""
    phase_margin_interval = CharacteristicInterval("phase_margin")
    gain_margin = EstimatedCharacteristic("gain_margin")
    """Gain margin, dB; infinite where L does not cross the negative real axis."""
    gain_margin_interval = CharacteristicInterval("gain_margin")
    delay_margin = EstimatedCharacteristic("delay_margin")
    """Delay margin, s: the further delay by which the loop becomes unstable."""
    delay_margin_interval = CharacteristicInterval("delay_margin")
    ms = EstimatedCharacteristic("ms")
    """Maximum sensitivity Ms, the largest |S|."""
    ms_interval = CharacteristicInterval("ms")
    bandwidth = EstimatedCharacteristic("bandwidth")
    """Bandwidth: the frequency up to which the closed loop is at least −3 dB, Hz."""
    bandwidth_interval = CharacteristicInterval("bandwidth")
    rejection = EstimatedCharacteristic("rejection")
    """The largest response of rate or angle to a torque, as an angular acceleration: s or s²."""
    rejection_interval = CharacteristicInterval("rejection")


@dataclass(frozen=True, eq=False, repr=False)
class OpenLoop(Margins):
    """Frequency responses of a loop with N plants: the estimated one, then draws from its posterior.

    The loop is opened at its controller. The responses are at F frequencies; row ``ESTIMATE`` is of the estimated
    plant. Only the open loop is kept: an array of all plants takes 3 MB, and a review has several loops on each of
    three axes. :class:`RateLoop` and :class:`AttitudeLoop` know the other responses of their loops.
    """

    frequency: Array
    """Frequencies (F,), Hz, ascending."""
    response: Complex
    """Response L of the open loop (N, F), without the minus sign of the feedback."""
    is_inner_stable: Flags | None = field(default=None, kw_only=True)
    """Whether the loop inside this one is stable (N,); None for the rate loop, inside which there is none."""

    @property
    def closed_loop_response(self) -> Complex:
        """Response of the closed loop (N, F), from the setpoint to the rate or the angle; computed at each access.

        It is T = L / (1 + L) of a controller that acts on the error of the setpoint.
        """
        return self.response / (1 + self.response)

    @property
    def disturbance(self) -> Complex:
        """Response (N, F) from the wind torque, rad/s², to the rate, rad/s, or the angle, rad, in the closed loop.

        It is computed at each access. It is 0 where it is not known: the open loop alone does not show it.
        """
        return np.zeros_like(self.response)

    @cached_property
    def stable(self) -> Flags:
        """Whether each of the N closed loops is stable, by Nyquist's criterion (N,).

        Open loops may have poles at 0 but none in the right half plane. As the frequency rises from 0 to infinity, the
        phase of 1 + L then increases by a quarter turn for each pole at 0 if the closed loop is stable. If it is not,
        the phase changes by a half turn or more in addition. The number of poles at 0 follows from the phase of L at
        the lowest frequency. A loop around an unstable one has poles in the right half plane, and is not judged by that
        criterion: it counts as unstable, since both were designed to be stable.
        """
        # The change of the phase of 1 + L is the sum of its small changes from each frequency to the next.
        phase_steps = wrapped_angle(np.diff(np.angle(1 + self.response), axis=1))
        # At the lowest frequency, each pole at 0 adds −90° to the phase of L. A loop here has at most two.
        poles_at_zero = np.round(-np.angle(self.response[:, 0]) / (np.pi / 2)).clip(0, 2)
        additional_change = phase_steps.sum(axis=1) - poles_at_zero * np.pi / 2
        is_stable = np.abs(additional_change) < np.pi
        if self.is_inner_stable is not None:
            is_stable &= self.is_inner_stable
        return freeze(is_stable)

    @property
    def is_stable(self) -> bool:
        """Whether the closed loop of the estimated plant is stable."""
        return bool(self.stable[ESTIMATE])

    @property
    def has_one_crossover(self) -> bool:
        """Whether the gain |L| with the estimated plant is below 1 at no frequency below the crossover."""
        is_below_crossover = self.frequency < self.crossover
        return bool((np.abs(self.response[ESTIMATE, is_below_crossover]) >= 1).all())

    @property
    def closed_loop_of_estimate(self) -> Complex:
        """Response of the closed loop (F,) with the estimated plant, from the setpoint to the rate or the angle."""
        return self.closed_loop_response[ESTIMATE]

    @cached_property
    def max_sensitivity(self) -> Array:
        """Maximum sensitivity Ms of each loop (N,), the largest |S|; one of the ``characteristics``."""
        return freeze(1 / np.abs(1 + self.response).min(axis=1))

    @cached_property
    def characteristics(self) -> Mapping[str, Array]:
        """Values (N,) of each characteristic of the N loops, in the units of :class:`Margins`, by its name there.

        The bandwidth is the lowest frequency at which the closed loop crosses −3 dB, interpolated as the crossings of
        the open loop are (``open_loop_characteristics``); without a crossing it is NaN.
        """
        # Where the closed loop's gain minus that at −3 dB is 0. Frequencies are interpolated by their logarithms.
        half_power_crossings = _ZeroCrossings.of_rows(
            np.abs(self.closed_loop_response) - HALF_POWER_GAIN
        )
        log_bandwidth = half_power_crossings.minimum_by_row(
            half_power_crossings.interpolate(np.log(self.frequency))
        )
        characteristics = {
            **self.open_loop_characteristics,
            "bandwidth": np.exp(log_bandwidth),
            "rejection": np.abs(self.disturbance).max(axis=1),
        }
        return freeze(characteristics)

    @cached_property
    def open_loop_characteristics(self) -> Mapping[str, Array]:
        """Values (N,) of the ``characteristics`` that follow from the open loop alone: crossover, margins and Ms.

        They follow from crossings of the response: with the unit circle (crossover, phase and delay margin) and with
        the negative real axis (gain margin). Crossings are interpolated linearly between frequencies, in the logarithms
        of gain and frequency. Without a crossing, margins are infinite, and the crossover is NaN. Around an unstable
        loop margins are minus infinity: no crossing shows how far from stable it is.
        """
        log_frequency = np.log(self.frequency)
        gain_crossings = _ZeroCrossings.of_rows(np.log(np.abs(self.response)))
        crossover = np.exp(gain_crossings.interpolate(log_frequency))
        phase_margin = _phase_margins(self.response, gain_crossings)
        log_gain_margin = _log_gain_margins(self.response)
        delay_margin = phase_margin / (2 * np.pi * crossover)
        characteristics = {
            # The highest crossover, as the negative of the smallest negative one.
            "crossover": -gain_crossings.minimum_by_row(-crossover),
            "phase_margin": np.degrees(
                _infinite_if_nan(gain_crossings.minimum_by_row(phase_margin))
            ),
            "gain_margin": DECIBELS_PER_NEPER * _infinite_if_nan(log_gain_margin),
            "delay_margin": _infinite_if_nan(gain_crossings.minimum_by_row(delay_margin)),
            "ms": self.max_sensitivity,
        }
        if self.is_inner_stable is not None:
            for name in SIGNED_MARGINS:
                characteristics[name] = np.where(
                    self.is_inner_stable, characteristics[name], -np.inf
                )
        return freeze(characteristics)


class _ZeroCrossings(NamedTuple):
    """K points at which N sampled functions cross zero: the row, the column before, and the fraction to the next."""

    row_count: int
    """Number N of rows."""
    rows: Indices
    """Row of each crossing (K,)."""
    columns: Indices
    """Column before each crossing (K,)."""
    fraction: Array
    """Position of each crossing between that column and the next, 0 to 1 (K,)."""

    @classmethod
    def of_rows(cls, values: Array) -> _ZeroCrossings:
        """Finds the zero crossings of N sampled functions, by linear interpolation between points of different sign.

        Args:
            values: (N, F) values of each function at F points.

        Returns:
            The crossings of all functions: first those of the first function, in the order of the points, then of the
                next.
        """
        is_negative = np.signbit(values)
        is_crossing = is_negative[:, :-1] != is_negative[:, 1:]
        # Each crossing has its function (row), and the point before it (column).
        rows, columns = np.nonzero(is_crossing)
        values_before = values[rows, columns]
        values_after = values[rows, columns + 1]
        fractions = values_before / (values_before - values_after)
        return cls(len(values), rows, columns, fractions)

    def interpolate(self, values: Array) -> Array:
        """Interpolates other functions linearly at the zero crossings, such as the phase where the gain crosses 1.

        Args:
            values: (N, F) values of each function at the same points, or (F,) values of one function for all N.

        Returns:
            (K,) value at each crossing.
        """
        values = np.broadcast_to(values, (self.row_count, values.shape[-1]))
        values_before = values[self.rows, self.columns]
        values_after = values[self.rows, self.columns + 1]
        return values_before + self.fraction * (values_after - values_before)

    def minimum_by_row(self, values: Array) -> Array:
        """Returns the least value among the crossings of each function.

        Args:
            values: (K,) values at the crossings; NaN values are ignored.

        Returns:
            (N,) least value of each function; NaN for a function without a crossing.
        """
        minimum = np.full(self.row_count, np.nan)
        np.fmin.at(minimum, self.rows, values)
        return minimum


def _phase_margins(response: Complex, gain_crossings: _ZeroCrossings) -> Array:
    """Returns the phase margin at each gain crossover: the phase of L above −180°, which is the angle of −L.

    It is interpolated along the unit circle between the two frequencies next to the crossing.

    Args:
        response: open-loop responses L (N, F).
        gain_crossings: the K crossings of the logarithm of |L| through 0.

    Returns:
        Phase margins (K,), rad, −π to π.
    """
    phase_before = np.angle(-response[gain_crossings.rows, gain_crossings.columns])
    phase_after = np.angle(-response[gain_crossings.rows, gain_crossings.columns + 1])
    phase_step = wrapped_angle(phase_after - phase_before)
    return np.asarray(wrapped_angle(phase_before + gain_crossings.fraction * phase_step))


def _log_gain_margins(response: Complex) -> Array:
    """Returns the natural logarithm of the gain margin of each loop: the factor on L with which L passes through −1.

    That is the inverse of |L| at a crossing with the negative real axis. The logarithm is negative for a loop that
    becomes unstable if its gain is lowered. Of several crossings, the one nearest to −1 is used.

    Args:
        response: (N, F) open-loop responses L.

    Returns:
        (N,) logarithms; NaN if L does not cross the negative real axis.
    """
    crossings = _ZeroCrossings.of_rows(response.imag)
    is_negative_axis = crossings.interpolate(response.real) < 0
    log_gain = crossings.interpolate(np.log(np.abs(response)))
    log_margin = np.where(is_negative_axis, -log_gain, np.nan)
    # The absolute value of the margin of each loop (N,), at its crossing nearest to −1.
    least_size = crossings.minimum_by_row(np.abs(log_margin))
    # The margin is negative if the crossing with this absolute value has a negative one.
    is_negative_margin = log_margin == -least_size[crossings.rows]
    signs = np.ones(len(least_size))
    signs[crossings.rows[is_negative_margin]] = -1
    return signs * least_size


def _infinite_if_nan(values: Array) -> Array:
    """Returns values of any shape with infinity in the place of NaN: a loop without a crossing has all the margin."""
    return np.where(np.isnan(values), np.inf, values)


class PlantResponse(NamedTuple):
    """Frequency responses of N plants after the gyro's filters, at F frequencies, which no gain changes.

    They take as long to compute as all that follows from them for one controller.
    """

    frequency: Array
    """Hz (F,)."""
    rate_per_demand: Complex
    """Filtered gyro rate per demand of the rate controller, rad/s (N, F)."""
    rate_per_torque: Complex
    """Body rate per angular acceleration of a disturbance, s (N, F)."""


def plant_response(
    controller: Controller,
    effectiveness: Array,
    dynamics: Array,
    grid: FrequencyGrid = FINE_GRID,
) -> PlantResponse:
    """Returns the frequency responses of N plants at once.

    The plant is a motor lag with a delay, then the rotation of the body with damping, then the gyro's filters:

        P = k e^(−s delay) / (lag s + 1) · 1 / (s + damping) · gyro filters

    Args:
        controller: controller, which has the gyro's filters (``Controller.gyro_path``) and the period of the loop.
        effectiveness: (N,) control effectiveness k of each plant: angular acceleration per demand, rad/s².
        dynamics: (N, 3) damping, 1/s, motor lag, s, and delay, s, of each plant, without the gyro's filters.
        grid: frequencies of the responses, at most up to ``MAX_FREQUENCY_RATIO`` of the controller's rate.

    Returns:
        Frequencies (F,), Hz, and responses (N, F), which are read-only.
    """
    highest_frequency = min(grid.highest, MAX_FREQUENCY_RATIO / controller.loop_period)
    frequency = np.geomspace(grid.lowest, highest_frequency, grid.points)
    s = 2j * np.pi * frequency
    damping, lag, delay = (column[:, None] for column in dynamics.T)
    delay_response = np.exp(-s * delay)
    actuation = gyro_response(controller, frequency) * delay_response / (lag * s + 1)
    rate_per_torque = 1 / (s + damping)
    rate_per_demand = effectiveness[:, None] * actuation * rate_per_torque
    return freeze(PlantResponse(frequency, rate_per_demand, rate_per_torque))


@dataclass(frozen=True, eq=False, repr=False)
class RateLoop(OpenLoop):
    """Loops of the body rate with N plants P and one controller."""

    plant: PlantResponse
    """The plants."""
    demand_from_setpoint: Complex
    """Response (F,) of the controller, from the setpoint to the demand, s/rad."""

    @property
    def closed_loop_response(self) -> Complex:
        """Response of the closed loops (N, F), from the setpoint of the rate to the rate."""
        sensitivity = 1 / (1 + self.response)
        return self.demand_from_setpoint * self.plant.rate_per_demand * sensitivity

    @property
    def disturbance(self) -> Complex:
        """Response (N, F) from the wind torque, rad/s², to the rate, rad/s, in the closed loop."""
        sensitivity = 1 / (1 + self.response)
        return self.plant.rate_per_torque * sensitivity


@dataclass(frozen=True, eq=False, repr=False)
class AttitudeLoop(OpenLoop):
    """Loops of the attitude around N closed rate loops."""

    rate: RateLoop
    """The rate loops."""

    @property
    def disturbance(self) -> Complex:
        """Response (N, F) from the wind torque, rad/s², to the angle, rad, with both loops closed."""
        s = 2j * np.pi * self.frequency
        return self.rate.disturbance / s / (1 + self.response)


def rate_loop(controller: Controller, plant: PlantResponse) -> RateLoop:
    """Returns the loop of the body rate with N plants P at once: L = C P.

    Args:
        controller: rate controller C of the axis, with its gains and filters.
        plant: the plants, with the gyro's filters of this controller.

    Returns:
        Responses of all loops (N, F).
    """
    demand_from_setpoint, demand_from_rate = controller_response(controller, plant.frequency)
    response = demand_from_rate * plant.rate_per_demand
    return RateLoop(plant.frequency, response, plant, demand_from_setpoint)


def attitude_loop(controller: Controller, rate: RateLoop) -> AttitudeLoop:
    """Returns the loop of the attitude around the closed loop of the rate: L = angle gain / s · T_rate / filters.

    T_rate is the response of the filtered rate to its setpoint. As the angle is the integral of the unfiltered rate,
    T_rate is divided by the response of the gyro's filters.

    Args:
        controller: controller of the axis, with the gain of the attitude controller and the gyro's filters.
        rate: the rate loop of N plants, at the frequencies of the result.

    Returns:
        The loops around all N rate loops.
    """
    s = 2j * np.pi * rate.frequency
    filters = gyro_response(controller, rate.frequency)
    response = controller.angle_gain / s * rate.closed_loop_response / filters
    return AttitudeLoop(rate.frequency, response, rate, is_inner_stable=rate.stable)


class ControllerResponse(NamedTuple):
    """Frequency responses of a rate controller."""

    from_setpoint: Complex
    """Demand per rate setpoint, s/rad, of the shape of the frequencies."""
    from_rate: Complex
    """Demand per gyro rate, s/rad, of the same shape, without the minus sign of the feedback."""


def controller_response(controller: Controller, frequency: Array) -> ControllerResponse:
    """Returns the responses of a discrete-time rate controller (PID with feed-forward) to its setpoint and to the rate.

    With z = e^(jω h) for the loop period h, the integral term is I h / (1 − z⁻¹), the derivative D (1 − z⁻¹) / h, and a
    first-order low-pass of cut-off f is a / (1 − (1 − a) z⁻¹) with a = h / (h + 1 / (2π f)).

    The autopilots combine these terms differently. ArduPilot's ``AC_PID`` filters the setpoint, and applies P, I and D
    to the error. PX4's ``RateControl`` applies P and I to the error and D only to the rate. It adds each error to the
    integral after the integral has been used, which is one period late.

    Args:
        controller: the rate controller of one axis.
        frequency: frequencies of any shape, Hz.

    Returns:
        The responses of the demand to setpoint and rate, in the shape of the frequencies.
    """
    period = controller.loop_period
    # z⁻¹ is the response of a delay by one loop period.
    delay = np.exp(-2j * np.pi * frequency * period)

    def low_pass(cutoff: float) -> Any:
        """Returns the response of a first-order low-pass with this cut-off, Hz; 1 for a cut-off of 0 (no filter)."""
        weight = period / (period + 1 / (2 * np.pi * cutoff)) if cutoff else 1.0
        return weight / (1 - (1 - weight) * delay)

    derivative = controller.d * low_pass(controller.derivative_filter) * (1 - delay) / period
    integral = controller.i * period / (1 - delay)
    is_ardupilot = controller.derivative_of_error
    if is_ardupilot:
        demand_from_error = low_pass(controller.error_filter) * (
            controller.p + integral + derivative
        )
        demand_from_error = demand_from_error * notch_response(
            controller.error_notches, 1 / period, frequency
        )
        feed_forward = controller.ff + controller.derivative_ff * (1 - delay) / period
        target_notches = notch_response(controller.target_notches, 1 / period, frequency)
        target_filters = low_pass(controller.target_filter) * target_notches
        return ControllerResponse(
            from_setpoint=target_filters * (demand_from_error + feed_forward),
            from_rate=demand_from_error,
        )
    proportional_integral = controller.p + delay * integral
    output_filter = low_pass(controller.output_filter)
    return ControllerResponse(
        from_setpoint=output_filter * (proportional_integral + controller.ff),
        from_rate=output_filter * (proportional_integral + derivative),
    )
