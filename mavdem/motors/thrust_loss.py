"""Loss of a motor's thrust, from the rise of the command by which the controller compensates it."""

from typing import TypeVar

from mavdem.arrays import Array

Rise = TypeVar("Rise", float, Array)


def lost_thrust(rise: Rise, exponent: float = 2.0) -> Rise:
    """Computes the fraction of its thrust that a motor lost whose command rose.

    The controller compensates the loss, so that the thrust stays the same: if the command is 1 + ``rise`` times as
    high, the motor makes (1 + rise)^−exponent of the thrust that a sound one would make by this command.

    Args:
        rise: Rise of the command as a fraction of the command before, a number or an array.
        exponent: Thrust is proportional to the command to the power of this exponent.

    Returns:
        The lost fraction, of the type and shape of ``rise``.
    """
    return 1 - (1 + rise) ** -exponent
