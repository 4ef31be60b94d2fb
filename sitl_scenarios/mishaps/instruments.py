"""Instruments: what sensors and power module of a simulated vehicle measure in each cycle, apart from its motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl_scenarios.dynamics import State
from sitl_scenarios.mishaps.sensor_faults import SensorErrors
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
"""Clipped samples per second, for each m/s² of vibration above ``CLIPPING_LEVEL``."""

CLIPPING_IMPACT = 140.0
"""Acceleration of an impact, m/s², from which on the accelerometer clips."""

BAROMETER_NOISE = 0.12
"""Standard deviation of the barometer's height, m."""

PROP_WASH_HEIGHT = 0.6
"""Height, m, that the rotors' air takes from the barometer's reading near the ground."""

PROP_WASH_REACH = 1.0
"""Height above ground, m, up to which the rotors' air changes the barometer's reading."""

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
"""Standard deviation of the supply of the autopilot's board, V."""

SOUND_RATIO = 0.12
"""Usual innovation of a measurement, divided by the largest innovation that the filter accepts."""

SOUND_RATIO_SPREAD = 0.2
"""Standard deviation of that innovation from cycle to cycle, relative to it; a choice."""

FORCE_NOISE_PER_VIBRATION = 0.1
"""Standard deviation of the accelerometer, m/s², for each m/s² of added vibration; a choice."""

IMPACT_DIRECTION = (0.5, -0.4, -0.7)
"""Share of the acceleration of an impact on the ground that each body axis of the accelerometer measures; a choice.

The ground pushes upwards against the vehicle, and turns it, so that no axis measures all of it.
"""

IMPACT_CLIPS = 2
"""Samples beyond the range of the accelerometer in each cycle of a strong impact; a choice."""

USED_CELL_VOLTAGE = 3.5
"""Voltage without load, V, with which each cell of a second battery that will be empty begins the flight; a choice."""

SECOND_BATTERY_SHARE = 0.25
"""Current of the second battery divided by the first battery's, of a vehicle with two; a choice."""

NO_BATTERY = np.nan
"""Voltage of a battery that is not there."""


class CycleNoise(NamedTuple):
    """White noise of unit variance that one cycle of the instruments adds."""

    force_x: float
    force_y: float
    force_z: float
    barometer: float
    fix_north: float
    fix_east: float
    fix_down: float
    innovation_ratio: float
    board_voltage: float


class BatteryVoltages(NamedTuple):
    """Voltages of the batteries under load."""

    first: float
    """Voltage of the first battery, V."""

    second: float
    """Voltage of the second battery, V; NaN if there is none."""


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
    """(N, 4) innovations of velocity, horizontal position, height and compass, each divided by the largest that the
    filter accepts."""
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
    """(N,) text that the autopilot sends in each cycle; empty in most cycles."""
    severity: NDArray[np.int64]
    """(N,) MAV_SEVERITY of the text."""


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
        self._noises = self._cycle_noises(scenario)

    @staticmethod
    def _cycle_noises(scenario: Scenario) -> Iterator[CycleNoise]:
        """Yields the noise of one cycle after the other, without end; the scenario's seed fixes it."""
        random = scenario.random(INSTRUMENTS)
        numbers_per_cycle = len(CycleNoise._fields)
        while True:
            block = random.standard_normal((NOISE_BLOCK, numbers_per_cycle))
            yield from map(CycleNoise._make, block.tolist())

    def row(
        self,
        time: float,
        state: State,
        remaining_voltage: float,
        errors: SensorErrors,
        impact: float,
    ) -> dict[str, Any]:
        """Returns what the instruments measure in this cycle, by the names of the fields of ``InstrumentedMotion``.

        All measurements depend on the rotor speeds relative to hover. Thrust, and the imbalance that shakes the frame,
        are proportional to the square of the rotor speeds, and the power, and so the current, to their cube. The method
        must be called once per cycle, since noise and clipped samples continue from the cycle before.

        Args:
            time: Seconds after arming.
            state: True state, with the accelerations of the last step.
            remaining_voltage: Share of the first battery's voltage that the scenario's ``battery_sag`` leaves, 0 to 1.
            errors: Errors that faults of the sensors cause in this cycle.
            impact: Acceleration of an impact on the ground, m/s².

        Returns:
            Values of this cycle, in the units of these fields.
        """
        noise = next(self._noises)
        # Ratios to the values in hover.
        speed_ratios = [speed / self._hover_speed for speed in state.rotors]
        thrust_ratio = sum(ratio**2 for ratio in speed_ratios) / self._rotors
        power_ratio = sum(abs(ratio) ** 3 for ratio in speed_ratios) / self._rotors
        current = HOVER_CURRENT * self._rotors * power_ratio
        vibration = thrust_ratio * (SOUND_VIBRATION + errors.vibration)
        # The number of clipped samples grows with the vibration above a level, and by an impact.
        self._clips += max(vibration - CLIPPING_LEVEL, 0.0) * CLIPS_PER_VIBRATION * self._cycle
        if impact > CLIPPING_IMPACT:
            self._clips += IMPACT_CLIPS
        north, east, down = state.position
        sound_ratio = SOUND_RATIO * (1.0 + SOUND_RATIO_SPREAD * noise.innovation_ratio)
        return {
            "specific_force": self._specific_force(state, errors, impact, thrust_ratio, noise),
            "vibration": vibration,
            "clips": int(self._clips),
            "barometer_height": self._barometer_height(down, errors, thrust_ratio, noise),
            # Satellites lie on one side only, above: the vertical position is twice as uncertain.
            "fix": (
                north + FIX_NOISE * noise.fix_north,
                east + errors.east_error + FIX_NOISE * noise.fix_east,
                down + 2 * FIX_NOISE * noise.fix_down,
            ),
            "fix_type": errors.fix_type,
            "satellites": errors.satellites,
            "ratios": (
                sound_ratio,
                sound_ratio + errors.position_ratio,
                sound_ratio + errors.height_ratio,
                sound_ratio + errors.compass_ratio,
            ),
            "is_glitching": errors.position_ratio > 1.0,
            "battery_voltage": self._battery_voltages(time, current, remaining_voltage),
            "battery_current": current,
            "board_voltage": self._board_voltage(time) + BOARD_NOISE * noise.board_voltage,
        }

    @staticmethod
    def _barometer_height(
        down: float, errors: SensorErrors, thrust_ratio: float, noise: CycleNoise
    ) -> float:
        """Returns the height by the barometer.

        Near the ground the rotors press air below the vehicle: the pressure rises, and the height reads too low, the
        more the nearer the ground is.

        Args:
            down: True position down from the take-off, m.
            errors: Errors that faults of the sensors cause in this cycle.
            thrust_ratio: Thrust of the rotors as a fraction of their thrust in hover.
            noise: Random noise of all instruments in this cycle.

        Returns:
            The height, m above the take-off.
        """
        height = -down + errors.height_error
        if -down < PROP_WASH_REACH:
            height -= PROP_WASH_HEIGHT * min(thrust_ratio, 1.0) * (1.0 + down / PROP_WASH_REACH)
        height += BAROMETER_NOISE * noise.barometer
        if errors.stuck_height is not None:
            height = errors.stuck_height
        return height

    def _specific_force(
        self,
        state: State,
        errors: SensorErrors,
        impact: float,
        thrust_ratio: float,
        noise: CycleNoise,
    ) -> tuple[float, ...]:
        """Returns the measurement of the accelerometer: acceleration less gravity, with noise, bias and impacts.

        Args:
            state: True state; its linear accelerations are in NED, m/s².
            errors: Errors that faults of the sensors cause in this cycle.
            impact: Acceleration of an impact on the ground, m/s².
            thrust_ratio: Thrust of the rotors as a fraction of their thrust in hover; the noise grows with it.
            noise: Random noise of all instruments in this cycle.

        Returns:
            Specific force along the body axes, forward, right and down, m/s².
        """
        north, east, down = state.accelerations.linear
        without_gravity = (north, east, down - GRAVITY)
        # The columns of the matrix from body axes to NED are the body axes, on which the force is projected.
        rows = rotation_matrix(state.attitude)
        force_x, force_y, force_z = (
            dot(column, without_gravity) for column in zip(*rows, strict=True)
        )
        spread = thrust_ratio * (FORCE_NOISE + FORCE_NOISE_PER_VIBRATION * errors.vibration)
        impact_x, impact_y, impact_z = (share * impact for share in IMPACT_DIRECTION)
        return (
            force_x + spread * noise.force_x + impact_x,
            force_y + spread * noise.force_y + impact_y,
            force_z + spread * noise.force_z + errors.force_bias + impact_z,
        )

    def _battery_voltages(
        self, time: float, first_current: float, remaining_voltage: float
    ) -> BatteryVoltages:
        """Returns the voltages of both batteries under load.

        The voltage without load falls evenly over the flight, as the charge is used. The load lowers it by the current
        times the internal resistance.

        Args:
            time: Seconds after arming.
            first_current: Current of the first battery, A.
            remaining_voltage: Fraction of the first battery's voltage that the scenario's ``battery_sag`` leaves, 0 to
                1.

        Returns:
            Voltages, V; ``NO_BATTERY`` for a second battery that the vehicle does not have.
        """
        flown_share = min(max(time / self._duration, 0.0), 1.0)
        open_voltage = _interpolated(FULL_BATTERY_VOLTAGE, DISCHARGED_VOLTAGE, flown_share)
        mishap = self._mishap
        if isinstance(mishap, FailsafeDisarm) and mishap.cause == "battery":
            # This battery was used before the flight, and is empty when the failsafe acts.
            share_to_failsafe = min(max(time / mishap.start, 0.0), 1.0)
            open_voltage = _interpolated(DISCHARGED_VOLTAGE, EMPTY_VOLTAGE, share_to_failsafe)
        first_voltage = remaining_voltage * open_voltage - RESISTANCE * first_current
        if not isinstance(mishap, EmptyBattery):
            return BatteryVoltages(first_voltage, NO_BATTERY)
        cell_voltage = _interpolated(USED_CELL_VOLTAGE, mishap.cell, flown_share)
        second_current = SECOND_BATTERY_SHARE * first_current
        second_voltage = CELLS * cell_voltage - RESISTANCE * second_current
        return BatteryVoltages(first_voltage, second_voltage)

    def _board_voltage(self, time: float) -> float:
        """Returns the supply voltage of the autopilot's board.

        It is constant, except before a brown-out, in which it falls evenly to the voltage at which the board stops.

        Args:
            time: Seconds after arming.

        Returns:
            The supply voltage, V.
        """
        mishap = self._mishap
        if not isinstance(mishap, BrownOut) or time < mishap.start:
            return BOARD_VOLTAGE
        fallen_share = min((time - mishap.start) / mishap.seconds, 1.0)
        return _interpolated(BOARD_VOLTAGE, mishap.voltage, fallen_share)


def _interpolated(start: float, end: float, share: float) -> float:
    """Returns the value at a ``share``, 0 to 1, of the way from ``start`` to ``end``."""
    return start + (end - start) * share
