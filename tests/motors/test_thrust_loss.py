"""The thrust that a motor lost follows from the rise of its own command."""

import numpy as np
from frames import FRAMES, geometry
from pytest import approx, mark
from scipy.optimize import root

from mavdem.motors.signatures import motor_signatures
from mavdem.motors.thrust_loss import lost_thrust


@mark.parametrize("loss", [0.25, 0.5, 0.7])
@mark.parametrize("motors", FRAMES)
def test_the_loss_is_that_of_a_hover_with_the_weak_motor(motors, loss):
    """In the exact balance of thrusts that go with the square of the command, also where neighbours help."""
    signatures = motor_signatures(geometry(motors))
    thrust_shares = np.ones(motors)
    thrust_shares[0] -= loss
    allocation = np.linalg.pinv(signatures.mixer_rows)
    hover = np.eye(4)[0]

    def imbalance(demands):
        return signatures.mixer_rows @ (thrust_shares * (allocation @ demands) ** 2) - hover

    commands = allocation @ root(imbalance, hover).x
    assert lost_thrust(commands[0] - 1, signatures.own_rise_ratios[0]) == approx(loss, abs=0.06)


def test_no_motor_loses_more_than_all_its_thrust():
    assert lost_thrust(2.0, own_rise_ratio=0.5) == 1.0
