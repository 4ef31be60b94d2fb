"""Instruments: what sensors and power module of a simulated vehicle measure in each cycle, beside its motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl_scenarios.dynamics import State
from sitl_scenarios.mishaps.sensor_faults import Readings
from sitl_scenarios.mishaps.specs import BrownOut, EmptyBattery, FailsafeDisarm
from sitl_scenarios.motion import Array, Flags, Motion
from sitl_scenarios.scenario import INSTRUMENTS, Scenario
from sitl_scenarios.vectors import dot, rotation_matrix
from sitl_scenarios.vehicles import FULL_BATTERY_VOLTAGE, GRAVITY, airframe

NOISE_BLOCK = 1000
"""Cycles whose noise is drawn at once."""

FORCE_NOISE = 0.25
"""Standard deviation of the accelerometer on each axis, m/s², of a sound vehicle in hover."""

SOUND_VIBRATION = 7.0
"""Vibration in hover of a sound vehicle, m/s², as ArduPilot measures it: below 15 is good."""

CLIPPING_LEVEL = 45.0
"""Vibration, m/s², from which on samples of the accelerometer exceed its range."""

CLIPS_PER_VIBRATION = 3.0
"""Clipped samples per second and m/s² of vibration above that."""

KNOCK_CLIP = 140.0
"""Knock, m/s², from which on the accelerometer clips."""

BAROMETER_NOISE = 0.12
"""Standard deviation of the barometer's height, m."""

PROP_WASH_HEIGHT = 0.6
"""Height, m, that the rotors' air takes from the barometer's reading near the ground."""

PROP_WASH_REACH = 1.0
"""Height above ground, m, up to which that is so."""

FIX_NOISE = 0.15
"""Standard deviation of the satellites' position from cycle to cycle, m."""

HOVER_CURRENT = 4.5
"""Current of one motor in hover, A."""

RESISTANCE = 0.012
"""Internal resistance of the battery, ohm."""

DISCHARGED_VOLTAGE = 11.4
"""Voltage without load, V, at the end of a flight that used two thirds of the charge."""

EMPTY_VOLTAGE = 9.6
"""Voltage without load, V, of a battery on which a failsafe acts: 3.2 V a cell."""

CELLS = 3
"""Cells in series of each battery."""

BOARD_VOLTAGE = 5.05
"""Supply of the autopilot's board, V."""

BOARD_NOISE = 0.01
"""Standard deviation of that, V."""

SOUND_RATIO = 0.12
"""Usual innovation of a measurement by what the filter accepts."""

NO_BATTERY = np.nan
"""Voltage of a battery that is not there."""

FIELDS_OF_NOISE = 9
"""Random numbers of one cycle."""


@dataclass(frozen=True, eq=False)
class InstrumentedMotion(Motion):
    """Rows of a simulated flight with what its instruments measure and its autopilot reports."""

    specific_force: Array
    """(N, 3) accelerometer in body axes, m/s²: (0, 0, −9.81) at rest."""
    vibration: Array
    """(N,) vibration, m/s², as ArduPilot measures it."""
    clips: NDArray[np.int64]
    """(N,) samples of the accelerometer beyond its range since boot."""
    barometer_height: Array
    """(N,) height by the barometer, m above the take-off."""
    fix: Array
    """(N, 3) position by satellites, NED, m."""
    fix_type: NDArray[np.int64]
    """(N,) GPS_FIX_TYPE."""
    satellites: NDArray[np.int64]
    """(N,) satellites that are used."""
    ratios: Array
    """(N, 4) innovations of velocity, horizontal position, height and compass by what the filter accepts."""
    is_glitching: Flags
    """(N,) whether the filter reports that the satellites' position jumped."""
    battery_voltage: Array
    """(N, 2) voltage of each battery, V; NaN of one that is not there."""
    battery_current: Array
    """(N,) current of the first battery, A."""
    board_voltage: Array
    """(N,) supply of the autopilot's board, V."""
    throttle_stick: Array
    """(N,) the pilot's throttle, 0 to 1; below 0 where the receiver has lost the radio."""
    mode: NDArray[np.int64]
    """(N,) index of the flight mode in ``sitl_scenarios.mishaps.pilot.MODES``."""
    is_failsafe: Flags
    """(N,) whether a failsafe acts."""
    text: NDArray[np.str_]
    """(N,) what the autopilot says in this cycle; empty mostly."""
    severity: NDArray[np.int64]
    """(N,) MAV_SEVERITY of that."""


class Instruments:
    """Instruments of one vehicle, read once per cycle of its autopilot."""

    def __init__(self, scenario: Scenario) -> None:
        """Takes vehicle, mishap, cycle and random seed of a scenario."""
        self._mishap = scenario.mishap
        self._duration = scenario.duration
        self._cycle = scenario.cycle
        body = airframe(scenario.vehicle)
        self._rotors = body.rotors
        self._hover_speed = body.hover_speed
        self._clips = 0.0
        self._noise = self._noise_rows(scenario)

    @staticmethod
    def _noise_rows(scenario: Scenario) -> Iterator[list[float]]:
        """Yields white noise of unit variance, ``FIELDS_OF_NOISE`` numbers for each cycle."""
        random = scenario.random(INSTRUMENTS)
        while True:
            yield from random.standard_normal((NOISE_BLOCK, FIELDS_OF_NOISE)).tolist()

    def row(
        self, time: float, state: State, battery: float, readings: Readings, knock: float
    ) -> dict[str, Any]:
        """Returns what the instruments measure in this cycle, by the names of the fields of ``InstrumentedMotion``.

        Args:
            time: Seconds after arming.
            state: True state, with the accelerations of the last step.
            battery: Remaining fraction of the battery's voltage.
            readings: Errors of the sensors.
            knock: Blow of the ground, m/s².
        """
        noise = next(self._noise)
        # Mean cube of the rotor speeds by that in hover: the power; their mean square: thrust and imbalance.
        ratios = [speed / self._hover_speed for speed in state.rotors]
        effort = sum(ratio**2 for ratio in ratios) / self._rotors
        power = sum(abs(ratio) ** 3 for ratio in ratios) / self._rotors
        vibration = effort * (SOUND_VIBRATION + readings.vibration)
        self._clips += max(vibration - CLIPPING_LEVEL, 0.0) * CLIPS_PER_VIBRATION * self._cycle
        if knock > KNOCK_CLIP:
            self._clips += 2
        voltages = self._battery_voltages(time, HOVER_CURRENT * self._rotors * power, battery)
        north, east, down = state.position
        height = -down + readings.height_error
        if -down < PROP_WASH_REACH:
            height -= PROP_WASH_HEIGHT * min(effort, 1.0) * (1.0 + down / PROP_WASH_REACH)
        height += BAROMETER_NOISE * noise[3]
        if readings.stuck_height is not None:
            height = readings.stuck_height
        fix_noise = [FIX_NOISE * number for number in noise[4:7]]
        usual = SOUND_RATIO * (1.0 + 0.2 * noise[7])
        return {
            "specific_force": self._specific_force(state, readings, knock, effort, noise),
            "vibration": vibration,
            "clips": int(self._clips),
            "barometer_height": height,
            "fix": (
                north + fix_noise[0],
                east + readings.east_error + fix_noise[1],
                down + 2 * fix_noise[2],
            ),
            "fix_type": readings.fix_type,
            "satellites": readings.satellites,
            "ratios": (
                usual,
                usual + readings.position_ratio,
                usual + readings.height_ratio,
                usual + readings.compass_ratio,
            ),
            "is_glitching": readings.position_ratio > 1.0,
            "battery_voltage": voltages,
            "battery_current": HOVER_CURRENT * self._rotors * power,
            "board_voltage": self._board_voltage(time) + BOARD_NOISE * noise[8],
        }

    def _specific_force(
        self, state: State, readings: Readings, knock: float, effort: float, noise: list[float]
    ) -> tuple[float, ...]:
        """Returns the accelerometer in body axes, m/s²: acceleration less gravity, with noise, bias and knock."""
        north, east, down = state.accelerations.linear
        without_gravity = (north, east, down - GRAVITY)
        rows = rotation_matrix(state.attitude)
        force = [dot(column, without_gravity) for column in zip(*rows, strict=True)]
        spread = effort * (FORCE_NOISE + 0.1 * readings.vibration)
        x, y, z = (part + spread * number for part, number in zip(force, noise[:3], strict=True))
        # The ground pushes against the vehicle, and turns it: the axes share the blow.
        return x + 0.5 * knock, y - 0.4 * knock, z + readings.force_bias - 0.7 * knock

    def _battery_voltages(self, time: float, current: float, battery: float) -> tuple[float, float]:
        """Returns the voltages of both batteries under a current, A; the second is NaN where there is none."""
        share = min(max(time / self._duration, 0.0), 1.0)
        open_voltage = FULL_BATTERY_VOLTAGE + (DISCHARGED_VOLTAGE - FULL_BATTERY_VOLTAGE) * share
        mishap = self._mishap
        if isinstance(mishap, FailsafeDisarm) and mishap.cause == "battery":
            # It is empty at the failsafe.
            spent = min(max(time / mishap.start, 0.0), 1.0)
            open_voltage = 11.4 + (EMPTY_VOLTAGE - 11.4) * spent
        first = battery * open_voltage - RESISTANCE * current
        if isinstance(mishap, EmptyBattery):
            second = CELLS * (3.5 + (mishap.cell - 3.5) * share) - RESISTANCE * current / 4
            return first, second
        return first, NO_BATTERY

    def _board_voltage(self, time: float) -> float:
        """Returns the supply of the board, V, which falls before a brown-out."""
        mishap = self._mishap
        if not isinstance(mishap, BrownOut) or time < mishap.start:
            return BOARD_VOLTAGE
        fallen = min((time - mishap.start) / mishap.seconds, 1.0)
        return BOARD_VOLTAGE + (mishap.voltage - BOARD_VOLTAGE) * fallen
