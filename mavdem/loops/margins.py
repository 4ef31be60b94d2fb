"""Margins of an open loop, and of what its closed loop does, with intervals from draws of the plant's posterior.

An open loop that is estimated from the spectra of a flight's outputs and inputs is biased: wind acts on both. So it is
the identified plant times the known controller. Source of the figures: K. J. Åström and R. M. Murray, Feedback Systems,
2nd ed., secs. 10.3 and 12.1.
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
from mavdem.loops.filters import gyro_response, notched

Complex = NDArray[np.complex128]
GRID = (0.02, 100.0, 500)
"""Hz from and to, and how many frequencies between, evenly by ratio; up to 0.45 of the loop's own rate at most."""


@dataclass(frozen=True)
class Figure:
    """A figure of a loop, of the estimated plant, as an attribute."""

    name: str

    def __get__(self, loop: Any, kind: type | None = None) -> float:
        return float(loop.figures[self.name][0])


@dataclass(frozen=True)
class FigureInterval:
    """The 90 % interval of a figure, (low, high), as an attribute."""

    name: str

    def __get__(self, loop: Any, kind: type | None = None) -> Interval:
        values = loop.figures[self.name]
        low, high = np.quantile(values, INTERVAL_QUANTILES, method="nearest").tolist()
        return low, high


class Margins(ImmutableResult):
    """Figures of a loop with their 90 % intervals; the margins are the smallest."""

    crossover = Figure("crossover")
    """The highest frequency at which the gain is 1, Hz."""
    crossover_interval = FigureInterval("crossover")
    phase_margin = Figure("phase_margin")
    """Degrees; negative where the loop is unstable."""
    phase_margin_interval = FigureInterval("phase_margin")
    gain_margin = Figure("gain_margin")
    """dB; infinite where no frequency has it."""
    gain_margin_interval = FigureInterval("gain_margin")
    delay_margin = Figure("delay_margin")
    """Seconds."""
    delay_margin_interval = FigureInterval("delay_margin")
    ms = Figure("ms")
    """The maximum sensitivity."""
    ms_interval = FigureInterval("ms")
    bandwidth = Figure("bandwidth")
    """Hz, up to which the closed loop is at least -3 dB."""
    bandwidth_interval = FigureInterval("bandwidth")
    rejection = Figure("rejection")
    """The largest response of rate or angle to a torque, s or s²."""
    rejection_interval = FigureInterval("rejection")


@dataclass(frozen=True, eq=False, repr=False)
class OpenLoop(Margins):
    """One loop, opened at its controller: N responses at F frequencies, the estimate's first and then of draws."""

    frequency: Array
    """(F,) Hz."""
    response: Complex
    """(N, F) of the open loop, without its sign."""
    closed: Complex
    """(N, F) from the setpoint to the rate, or the angle."""
    disturbance: Complex
    """(N, F) from the wind's torque, rad/s², to the rate, rad/s, or the angle, rad."""

    @cached_property
    def stable(self) -> Flags:
        """(N,) whether closed loops are stable, whose open loops are so but for poles at 0 (Nyquist's criterion).

        1 + L turns by a quarter for each pole at 0 from the lowest frequency to the highest, and not at all besides.
        """
        steps = wrapped_angle(np.diff(np.angle(1 + self.response), axis=1))
        quarters = -np.angle(self.response[:, 0]) / (np.pi / 2)
        besides = steps.sum(axis=1) - np.round(quarters).clip(0, 2) * np.pi / 2
        return freeze(np.abs(besides) < np.pi)

    @cached_property
    def figures(self) -> Mapping[str, Array]:
        """(N,) of each figure by its name: of the estimated plant, and then of draws."""
        at = np.log(self.frequency)
        response = self.response
        gain = np.log(np.abs(response))
        crossing = _Zeros.of(gain)
        hertz = np.exp(crossing.among(at))
        before = np.angle(-response[crossing.rows, crossing.columns])
        after = np.angle(-response[crossing.rows, crossing.columns + 1])
        margin = wrapped_angle(before + crossing.share * wrapped_angle(after - before))
        real = _Zeros.of(response.imag)
        bears = np.where(real.among(response.real) < 0, -real.among(gain), np.nan)
        nearest = real.least(np.abs(bears))
        nearest[real.rows[bears == -nearest[real.rows]]] *= -1
        falls = _Zeros.of(np.abs(self.closed) - 2**-0.5)  # half of the power
        figures = {
            "crossover": -crossing.least(-hertz),
            "phase_margin": np.degrees(_or_infinite(crossing.least(margin))),
            "gain_margin": 20 / np.log(10) * _or_infinite(nearest),
            "delay_margin": _or_infinite(crossing.least(margin / (2 * np.pi * hertz))),
            "ms": 1 / np.abs(1 + response).min(axis=1),
            "bandwidth": np.exp(falls.least(falls.among(at))),
            "rejection": np.abs(self.disturbance).max(axis=1),
        }
        return freeze(figures)


class _Zeros(NamedTuple):
    """Where values (N, F) change sign between two frequencies."""

    loops: int  # N
    rows: Indices  # (K,)
    columns: Indices  # (K,) of the frequency before
    share: Array  # (K,) of the step to the next one

    @classmethod
    def of(cls, values: Array) -> _Zeros:
        negative = np.signbit(values)
        rows, columns = np.nonzero(negative[:, :-1] != negative[:, 1:])
        before = values[rows, columns]
        return cls(len(values), rows, columns, before / (before - values[rows, columns + 1]))

    def among(self, others: Array) -> Array:
        """(K,) of others (N, F) or (F,), there."""
        others = np.broadcast_to(others, (self.loops, others.shape[-1]))
        before = others[self.rows, self.columns]
        return before + self.share * (others[self.rows, self.columns + 1] - before)

    def least(self, crossings: Array) -> Array:
        """(N,) the least of ``crossings`` (K,); NaN of nothing."""
        least = np.full(self.loops, np.nan)
        np.fmin.at(least, self.rows, crossings)
        return least


def _or_infinite(values: Array) -> Array:
    return np.where(np.isnan(values), np.inf, values)


def rate_loop(
    controller: Controller,
    gains: Array,
    dynamics: Array,
    grid: tuple[float, float, int] = GRID,
) -> OpenLoop:
    """Returns the loop of the rate; ``gains`` (N,) and ``dynamics`` (N, 3) are those of a :class:`Loop`."""
    lowest, highest, count = grid
    fastest = min(highest, 0.45 / controller.cycle)
    frequency = np.geomspace(lowest, fastest, count)
    s = 2j * np.pi * frequency
    damping, lag, delay = (column[:, None] for column in dynamics.T)
    late = np.exp(-s * delay)
    acted = gyro_response(controller, frequency) * late / (lag * s + 1)
    turned = 1 / (s + damping)
    to_rate = gains[:, None] * acted * turned
    forward, back = transfer(controller, frequency)
    response = back * to_rate
    closed = forward * to_rate / (1 + response)
    disturbance = turned / (1 + response)
    return OpenLoop(frequency, response, closed, disturbance)


def attitude_loop(controller: Controller, rate: OpenLoop) -> OpenLoop:
    """Returns the loop of the attitude around that of the ``rate``."""
    s = 2j * np.pi * rate.frequency
    # Rates are logged, and controlled, behind the gyro's filters, the angle is not.
    filtered = gyro_response(controller, rate.frequency)
    outer = controller.angle / s * rate.closed / filtered
    closed = outer / (1 + outer)
    disturbance = rate.disturbance / s / (1 + outer)
    return OpenLoop(rate.frequency, outer, closed, disturbance)


def transfer(controller: Controller, frequency: Array) -> tuple[Complex, Complex]:
    """Returns (…) from the rate's setpoint to the demand, and, without its sign, from the rate, at Hz (…)."""
    cycle = controller.cycle
    late = np.exp(-2j * np.pi * frequency * cycle)

    def filtered(cutoff: float) -> Any:
        share = cycle / (cycle + 1 / (2 * np.pi * cutoff)) if cutoff else 1.0
        return share / (1 - (1 - share) * late)

    differentiated = controller.d * filtered(controller.derivative_filter) * (1 - late) / cycle
    integrated = controller.i * cycle / (1 - late)
    if controller.derivative_of_error:
        back = filtered(controller.error_filter) * (controller.p + integrated + differentiated)
        back = back * notched(controller.error_notches, 1 / cycle, frequency)
        ahead = controller.ff + controller.derivative_ff * (1 - late) / cycle
        target = notched(controller.target_notches, 1 / cycle, frequency)
        return filtered(controller.target_filter) * target * (back + ahead), back
    # PX4 integrates the error after it has been used.
    error = controller.p + late * integrated
    output = filtered(controller.output_filter)
    return output * (error + controller.ff), output * (error + differentiated)
