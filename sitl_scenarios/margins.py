"""Margins: frequency response and stability margins of a simulated vehicle's rate and attitude loops.

The loops are those that fly: the controller's own impulse response, a hold over one cycle, the rotors' lag and the body
linearised about the flight, and the delay of the estimates. Nothing is of what is learned from a flight.
"""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl_scenarios.dynamics import MAX_PULSE, MIN_PULSE
from sitl_scenarios.gains import controller_for
from sitl_scenarios.motion import Array
from sitl_scenarios.scenario import AXES, Scenario
from sitl_scenarios.vehicles import airframe

SETTLED_CYCLES = 4096  # Cycles after which an impulse's response no longer changes
LOWEST = 0.05  # Hz: position control is slower
STEP = 1e-3, -1e-3  # of a demand, to linearise the mixer
Complex = NDArray[np.complex128]


def loops(scenario: Scenario, cycle: float, number: int, damping: float, effect: Array) -> dict[str, NDArray[Any]]:
    """Arrays by name of the loops about the axis ``number``, as docs/scenarios.md explains them.

    ``damping``, 1/s, is positive where it damps; ``effect`` (4,) is angular acceleration by each motor's output, rad/s²
    per µs. ``roll_rate_loop`` and ``roll_attitude_loop`` (N,) are open loops at ``loop_frequency`` (N,) Hz;
    ``roll_rate_margins``, ``roll_attitude_margins`` (4,) as ``margins``.
    """
    name, controller = AXES[number], controller_for(scenario, cycle)
    frequency = np.geomspace(LOWEST, 0.499 / cycle, 4000)
    s = np.asarray(2j * pi * frequency, np.complex128)
    feedback, setpoint = (_response(scenario, cycle, number, wanted, s * cycle) for wanted in (False, True))
    body = airframe(scenario.vehicle)
    about = np.append(np.eye(3)[number], 0.0)
    hover = np.append(np.zeros(3), body.command_for(body.hover_speed) / body.full)
    more, less = (controller.mixed((hover + step * about).tolist()) for step in STEP)
    gain = float(effect @ np.subtract(more, less)) * (MAX_PULSE - MIN_PULSE) / (STEP[0] - STEP[1])
    hold = (1 - np.exp(-s * cycle)) / (s * cycle)
    rate = gain * hold / ((s + damping) * (sum(body.lag) / 2 * s + 1))
    late = np.exp(-s * scenario.sensors.delay)
    rate_loop = -feedback * rate * late
    attitude_loop = controller.stiff[number] * setpoint * rate / (1 + rate_loop) * late / s
    return {
        "loop_frequency": frequency,
        f"{name}_rate_loop": rate_loop,
        f"{name}_attitude_loop": attitude_loop,
        f"{name}_rate_margins": margins(frequency, rate_loop),
        f"{name}_attitude_margins": margins(frequency, attitude_loop),
    }


def _response(scenario: Scenario, cycle: float, number: int, wanted: bool, turns: Complex) -> Complex:
    """(N,) of the rate controller at ``turns``, j times rad a cycle: from the rate that is ``wanted``, or the rate."""
    controller = controller_for(scenario, cycle)
    impulse = [1.0] + [0.0] * (SETTLED_CYCLES - 1)
    demands = [controller.demand(number, one * wanted, one * (not wanted), True) for one in impulse]
    # An integrator keeps what it has: the differences end.
    steps = np.diff(demands, prepend=0.0)
    kept = np.flatnonzero(np.abs(steps) > 1e-12 * np.abs(steps).max())
    response = np.polynomial.polynomial.polyval(np.exp(-turns), steps[: kept[-1] + 1])
    return np.asarray(response / (1 - np.exp(-turns)))


def margins(frequency: Array, loop: Complex) -> Array:
    """Gain crossover (Hz), phase margin (°), gain margin (dB) and Ms of an open ``loop`` (N,) at ``frequency`` (N,) Hz.

    Of several crossovers the highest; of several margins the least, of gain those against more of it. NaN: it crosses
    nowhere.
    """
    size, real = np.log(np.abs(loop)), loop.real
    crossings = np.flatnonzero(size[:-1] * size[1:] < 0)
    share = size[crossings] / (size[crossings] - size[crossings + 1])
    at = loop[crossings] + share * (loop[crossings + 1] - loop[crossings])
    crossover = frequency[crossings] * (frequency[crossings + 1] / frequency[crossings]) ** share
    turns = np.flatnonzero((loop.imag[:-1] * loop.imag[1:] < 0) & (real[:-1] < 0))
    share = loop.imag[turns] / (loop.imag[turns] - loop.imag[turns + 1])
    there = -(real[turns] + share * (real[turns + 1] - real[turns]))
    return np.array(
        [
            crossover.max() if len(crossover) else np.nan,
            np.degrees(np.angle(-at)).min() if len(at) else np.nan,
            -20 * np.log10(there[there < 1].max()) if (there < 1).any() else np.nan,
            (1 / np.abs(1 + loop)).max(),
        ]
    )
