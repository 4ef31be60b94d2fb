"""Conditions of flights, such as battery voltage and lean, and by how much they alone may change a quantity."""

from collections.abc import Iterable
from math import hypot, log
from statistics import fmean
from typing import NamedTuple

from mavdem.containers import Names, Numbers
from mavdem.dataset.axes import AXES
from mavdem.fleet.flights import Flights, log_row
from mavdem.fleet.health_figures import measured_voltage
from mavdem.fleet.quantities import (
    ATTITUDE_GAIN_MARGIN,
    ATTITUDE_PHASE_MARGIN,
    GAIN_MARGIN,
    MAX_SENSITIVITY,
    MEAN_EFFECT,
    OVERSHOOT,
    PHASE_MARGIN,
    RISE,
    SHARE,
)
from mavdem.fleet.row import FlightRow, FlightRows
from mavdem.immutable import ReadOnlyDict

SD_UNKNOWN_LEAN = 0.07
"""Standard deviation of the difference of roll or pitch between two states where a lean is not known, rad: 4°."""

RELATIVE_SD_PER_LEAN = 0.5
"""Standard deviation of the change of a trim share by lean, 1/rad.

It is that of drag which acts half an arm's length above or below the centre of mass.
"""


LOOP_CHANGES_PER_LOG_EFFECT = {
    GAIN_MARGIN: 8.7,
    PHASE_MARGIN: 0.7,
    ATTITUDE_GAIN_MARGIN: 8.7,
    ATTITUDE_PHASE_MARGIN: 0.7,
    MAX_SENSITIVITY: 1.2,
    OVERSHOOT: 0.4,
    RISE: 1.0,
}
"""Change of a loop's figure by the logarithm of the mean effect: dB, rad, relative, fraction of the step, relative.

The gain of the loop is proportional to the effect, and 1 is 8.7 dB. The crossover frequency too is about proportional
to it, and lag and delay turn the phase there by 40° over a factor e of frequency. The attitude loop, which contains
the rate loop, changes by as much at most.
"""


class WindSpeed(NamedTuple):
    """The mean wind speed in one flight."""

    speed: float
    """The speed, m/s."""

    interval: Numbers | None
    """Both ends of its 90 % interval, m/s; None where they are not known."""


class Conditions(NamedTuple):
    """How the flights of one state were flown: means over them; ``None`` where not known."""

    voltage: float | None
    """Voltage of the battery, V; ``None`` too where nothing measured it."""

    collective: float | None
    """Mean of the motors, as a fraction of their range: it depends on payload and voltage."""

    lean_roll: float | None
    """Mean roll, rad."""

    lean_pitch: float | None
    """Mean pitch, rad."""

    tilt_sd: float | None
    """Standard deviation of the angle from level, rad."""

    vibration: float | None
    """Mean vibration of the first IMU along the axis that vibrates most, m/s²; how a vehicle flies changes it too."""

    vibration_of_imus: tuple[float, ...]
    """The same of each IMU, m/s²; empty unless all flights have it of equally many IMUs."""

    wind_torque: dict[str, float]
    """Standard deviation of the wind torque by axis, rad/s²."""

    wind_speeds: tuple[WindSpeed, ...]
    """Mean wind speed in each flight in which it is known, the smallest first; that of still air is not."""

    step_sources: dict[str, Names]
    """Where overshoot of the rate and its time from 10 to 90 % come from, by axis: measured, identified_loop, or both.

    The step of an identified loop is computed by a model. A measured step and a computed one may differ although the
    vehicle has not changed.
    """


def mean_conditions(flights: Flights) -> Conditions:
    """Returns how the flights of one state of a vehicle were flown, on average: battery, lean, vibration and wind.

    The fleet's table has a row for each axis of a flight. The wind torque and the source of the step response differ by
    axis; all other conditions are the same in the rows of a flight, so that its first row is enough.

    Args:
        flights: the flights, each as the list of its rows.

    Returns:
        Means over the flights that have a value, each with the same weight; ``None`` where no flight has one.
    """
    flight_rows = [log_row(flight) for flight in flights]
    axis_rows: FlightRows = []
    for flight in flights:
        axis_rows += flight
    return Conditions(
        voltage=_mean_of_known(measured_voltage(row) for row in flight_rows),
        collective=_mean_of_known(row.collective for row in flight_rows),
        lean_roll=_mean_of_known(row.lean_roll for row in flight_rows),
        lean_pitch=_mean_of_known(row.lean_pitch for row in flight_rows),
        tilt_sd=_mean_of_known(row.tilt_sd for row in flight_rows),
        vibration=_mean_of_known(_largest_vibration(row) for row in flight_rows),
        vibration_of_imus=_mean_vibration_of_imus(flight_rows),
        wind_torque=ReadOnlyDict(_mean_wind_torques(axis_rows)),
        wind_speeds=_wind_speeds(flight_rows),
        step_sources=ReadOnlyDict(_step_sources(axis_rows)),
    )


def _mean_vibration_of_imus(flight_rows: FlightRows) -> tuple[float, ...]:
    """Returns the mean vibration of each IMU over some flights, m/s², such as (9.4, 15.7) for two IMUs.

    Args:
        flight_rows: one row of each flight.

    Returns:
        The means; empty if the flights have vibrations of different numbers of IMUs, or of none.
    """
    vibrations_by_flight = [row.vibration_imus or () for row in flight_rows]
    imu_counts = {len(vibrations) for vibrations in vibrations_by_flight}
    if len(imu_counts) != 1:
        return ()
    vibrations_by_imu = zip(*vibrations_by_flight, strict=True)
    return tuple(fmean(vibrations) for vibrations in vibrations_by_imu)


def _wind_speeds(flight_rows: FlightRows) -> tuple[WindSpeed, ...]:
    """Returns the mean wind speed of each flight in which it is known, with its interval, the smallest first.

    Args:
        flight_rows: one row of each flight.
    """
    speeds = []
    for row in flight_rows:
        if row.wind_speed is not None:
            speeds.append(WindSpeed(row.wind_speed, row.wind_speed_interval))
    return tuple(sorted(speeds, key=lambda wind: wind.speed))


def _mean_wind_torques(rows: FlightRows) -> dict[str, float]:
    """Computes the mean strength of the wind torque on each axis over several flights.

    The strength in one flight is the standard deviation of the torque.

    Args:
        rows: rows of the fleet's table: the figures of one flight on one axis each.

    Returns:
        Mean standard deviation by axis, rad/s². An axis on which no flight has a wind torque is left out.
    """
    mean_torques = {}
    for axis in AXES:
        mean_torque = _mean_of_known(row.wind_torque_sd for row in rows if row.axis == axis)
        if mean_torque is not None:
            mean_torques[axis] = mean_torque
    return mean_torques


def _step_sources(rows: FlightRows) -> dict[str, Names]:
    """Returns by which methods the step responses of the rate loop were estimated in several flights, by axis.

    Args:
        rows: rows of the fleet's table: the figures of one flight on one axis each.

    Returns:
        Names of the methods by axis, in alphabetical order, each once. An axis without a step response is left out.
    """
    step_sources = {}
    for axis in AXES:
        sources = {row.rate_step_source for row in rows if row.axis == axis}
        known_sources = sorted(source for source in sources if source)
        if known_sources:
            step_sources[axis] = tuple(known_sources)
    return step_sources


def _largest_vibration(row: FlightRow) -> float | None:
    """Returns the vibration of a flight on the axis that vibrates most, in the unit of the column; None if unknown."""
    if not row.vibration:
        return None
    return max(row.vibration)


def condition_allowance(kind: str, before: Conditions, after: Conditions) -> float:
    """Returns the amount by which other conditions of flight alone may change a quantity between two states.

    The trim shares depend on the lean of the vehicle, since drag acts above or below the centre of mass. The mean
    effect of the motors depends on voltage and thrust, and the margins on that effect. The other quantities get no
    allowance.

    Args:
        kind: kind of the quantity, such as ``SHARE``.
        before: flight conditions of the first state.
        after: flight conditions of the second state.

    Returns:
        A standard deviation in the unit of the difference: relative for shares and effects, rad and dB for margins.
    """
    if kind == SHARE:
        roll_change = _lean_change(before.lean_roll, after.lean_roll)
        pitch_change = _lean_change(before.lean_pitch, after.lean_pitch)
        return RELATIVE_SD_PER_LEAN * hypot(roll_change, pitch_change)
    if kind != MEAN_EFFECT and kind not in LOOP_CHANGES_PER_LOG_EFFECT:
        return 0.0
    # The effect is proportional to the voltage at the same thrust, and to the output where the thrust changes.
    voltage_change = _relative_change(before.voltage, after.voltage)
    output_change = _relative_change(before.collective, after.collective)
    effect_change = voltage_change + output_change
    if kind == MEAN_EFFECT:
        return effect_change
    return LOOP_CHANGES_PER_LOG_EFFECT[kind] * effect_change


def _lean_change(before: float | None, after: float | None) -> float:
    """Returns the change of a lean angle, rad; ``SD_UNKNOWN_LEAN`` where one of the two is not known."""
    if before is None or after is None:
        return SD_UNKNOWN_LEAN
    return before - after


def _relative_change(before: float | None, after: float | None) -> float:
    """Returns the magnitude of the logarithm of the ratio of two positive values; 0 where one is not known."""
    if not before or not after:
        return 0.0
    return abs(log(before / after))


def _mean_of_known(values: Iterable[float | None]) -> float | None:
    """Returns the mean of the values that are known; ``None`` if there are none."""
    known_values = [value for value in values if value is not None]
    return fmean(known_values) if known_values else None
