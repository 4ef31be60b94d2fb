"""Loss of a motor's thrust, from the rise of the command by which the controller compensates it."""

import numpy as np

from mavdem.arrays import Array


def lost_thrust(rise: Array | float, own_rise_ratio: Array | float, exponent: float = 2.0) -> Array:
    """Computes the fraction of its thrust that a motor lost whose command rose.

    The controller compensates the loss, so that the thrust stays the same: if the command is 1 + ``rise`` times as
    high, the motor makes (1 + rise)^−exponent of the thrust that a sound one would make by this command. On vehicles
    with more than four motors the neighbours of a weak motor help it, so that its command rises by less than the thrust
    it lacks: the loss is divided by that ratio. It is at most 1.

    Args:
        rise: Rise of the motor's own command as a fraction of the command before, a number or an array.
        own_rise_ratio: Rise of the motor's own command if it must work harder by 1
            (:attr:`mavdem.motors.signatures.MotorSignatures.own_rise_ratios`): 1 on a quadrotor.
        exponent: Thrust is proportional to the command to the power of this exponent.

    Returns:
        The lost fraction, of the shape of ``rise`` and ``own_rise_ratio``.
    """
    return np.asarray(np.minimum((1 - (1 + rise) ** -exponent) / own_rise_ratio, 1.0))
