"""Figures of a flight by which the health of its motors is judged, from its row in the table of a fleet."""

from math import isclose

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import Numbers
from mavdem.facts import Level
from mavdem.facts.urgency import Urgency, urgency_of_headline
from mavdem.fleet.row import FlightRow
from mavdem.ingest.motors import MotorGeometry
from mavdem.motors.healthy_flights import HealthFigures
from mavdem.motors.motor_balance import MotorBalance
from mavdem.motors.signatures import motor_signatures

MAX_SATURATED_SHARE = 0.01
"""Fraction of the time that a motor of a sound flight spends at its upper limit, at most: a motor that is there for
longer has no thrust left, and its trim is not what the flight needs."""


def health_figures(row: FlightRow) -> HealthFigures:
    """Returns the figures of one flight by which the health of its motors is judged.

    Args:
        row: any row of the flight, since these columns are the same for all axes.

    Returns:
        The figures, None for those that the log does not have:

        - ``balance``: steady commands in roll, pitch and yaw (3,), the mean roll and pitch (2,), and the effect of roll
          and pitch on each command (3, 2);
        - ``signatures``: how the balance changes if one motor loses thrust, by the geometry of the motors;
        - ``voltage``: mean of the battery's voltage, V, where it was measured: the constant of an autopilot without a
          sensor says nothing of how empty the battery was;
        - ``sound``: whether the flight may be a healthy one to compare with (:func:`_is_sound`);
        - ``suspected_motor``, ``was_lost``: what its own log says of damage.
    """
    motors = row.motors or ()
    balance = None
    signatures = None
    if row.balance is not None:
        balance = MotorBalance(
            column_array(row.balance, 3),
            error=column_array(row.balance_error, 3),
            lean=column_array(row.balance_lean, 2),
            lean_effect=column_array(row.lean_effect, 6).reshape(3, 2),
            lean_effect_error=column_array(row.lean_effect_error, 6).reshape(3, 2),
            seconds=row.duration or 0.0,
        )
    if motors:
        # The signatures follow from positions and spins alone. Which output channel drives which motor does not matter
        # here, so that both get the same numbers.
        numbers = tuple(range(len(motors)))
        geometry = MotorGeometry(numbers, numbers, row.positions or (), spins=row.spins or ())
        signatures = motor_signatures(geometry)
    name = f"{row.file} {row.system} {row.component}"
    return HealthFigures(
        name,
        motors=motors,
        signatures=signatures,
        balance=balance,
        date=row.date,
        collective=row.collective,
        voltage=measured_voltage(row),
        sound=_is_sound(row),
        suspected_motor=row.failed_motor or row.watched_motor,
        was_lost=_was_lost(row),
    )


def _is_sound(row: FlightRow) -> bool:
    """Returns whether other flights of the vehicle may be compared with this one as a healthy flight.

    It must show no fault by its own log: the vehicle was not lost, its motors are not bad and did not oscillate, and
    none was at its upper limit for long.

    Args:
        row: any row of the flight.
    """
    has_bad_motors = row.light_motors == Level.BAD
    # Fractions of the time that each motor spends at its upper limit: the largest counts.
    saturated_share = max(row.saturated or (0.0,))
    is_at_limit = saturated_share >= MAX_SATURATED_SHARE
    return not (_was_lost(row) or has_bad_motors or is_at_limit or row.oscillation is not None)


def _was_lost(row: FlightRow) -> bool:
    """Returns whether the headline of a flight's own log is that the vehicle was lost.

    Args:
        row: any row of the flight.
    """
    return urgency_of_headline(row.headline_level, row.headline_rank) is Urgency.LOST


def measured_voltage(row: FlightRow) -> float | None:
    """Returns the mean voltage of a flight's battery, if it was measured.

    A voltage that never changes is a constant that the autopilot reports without a sensor. Flights cannot be compared
    by it.

    Args:
        row: any row of the flight in the fleet's table; all have the same voltages.

    Returns:
        The mean, V; ``None`` if it is unknown or the voltage was constant.
    """
    mean_voltage = row.voltage_mean
    if mean_voltage is None or row.voltage_end is None:
        return mean_voltage
    has_changed = row.voltage_start != row.voltage_end
    # The mean of equal samples equals each of them, except for rounding.
    is_mean_equal = isclose(mean_voltage, row.voltage_end)
    if has_changed or not is_mean_equal:
        return mean_voltage
    return None


def column_array(values: Numbers | None, count: int) -> Array:
    """Returns a column as an array, of ``count`` NaN where it is not known."""
    return np.full(count, np.nan) if values is None else np.array(values, dtype=np.float64)
