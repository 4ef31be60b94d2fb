"""Loss of a motor's thrust, from the rise of the command by which its vehicle makes up for it."""

from typing import TypeVar

from mavdem.arrays import Array

Rise = TypeVar("Rise", float, Array)


def lost_thrust(rise: Rise, exponent: float = 2.0) -> Rise:
    """Computes the fraction of its thrust that a motor lost whose command rose.

    The vehicle makes up for the loss, so that the thrust stays the same: with the command higher by ``rise``, thrust
    per command is lower by (1 + rise)^−exponent.

    Args:
        rise: Rise of the command as a fraction of the command before, a number or an array.
        exponent: Power of the command that the thrust goes with: 2 for the square.

    Returns:
        The lost fraction, of the type and shape of ``rise``.
    """
    return 1 - (1 + rise) ** -exponent
