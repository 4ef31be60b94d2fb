"""The balance of the motors in one flight: torque commands relative to the thrust, by which flights are compared."""

from typing import NamedTuple

from mavdem.arrays import Array


class MotorBalance(NamedTuple):
    """Balance of the motors of a steady flight, in fractions of the mean command of all motors.

    Values that do not follow from the motors' geometry or the log are NaN. Errors are standard errors.
    """

    mean: Array
    """(3,) mean commands in roll, pitch and yaw."""
    error: Array
    """(3,) standard errors of ``mean`` at this lean, from the scatter of blocks."""
    lean: Array
    """(2,) mean roll and pitch, rad."""
    lean_effect: Array
    """(3, 2) change of the commands in roll, pitch and yaw by the roll and the pitch angle, 1/rad."""
    lean_effect_error: Array
    """(3, 2) standard errors of ``lean_effect``, 1/rad."""
    seconds: float
    """Duration of steady flight, s."""
