"""Signatures of weak motors: how thrust, roll, pitch and yaw commands change where a motor gives less thrust.

With four motors, a weak one changes its own command only. With six or eight the mixer commands thrust, roll, pitch and
yaw only, so a weak motor also raises the commands of its neighbours: all commands change by the projection of the weak
motor on what the mixer can command.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mavdem.arrays import Array
from mavdem.containers import Names
from mavdem.dataset.axes import AXES
from mavdem.ingest.motors import MotorGeometry

MAX_SIGNATURE_COSINE = 0.99
"""Cosine of the angle between two motors' signatures, from which the two motors cannot be told apart; a choice."""


@dataclass(frozen=True)
class MotorSignatures:
    """Mixer of a vehicle with k motors, for the a axes that its geometry gives, and the signatures of weak motors."""

    axes: Names
    """Names of the axes: "thrust", "roll" and "pitch" where positions are known, "yaw" where spins are known."""
    mixer_rows: Array
    """(a, k) contribution of each motor's command to each axis.

    Thrust is the mean of all commands; the other rows are those of ``MotorGeometry.mixer_row``, on an X quadrotor
    (left - right) / 4 for roll.
    """

    @property
    def weak_motor_balance(self) -> Array:
        """(k, a) change of the commands of the axes where the motor of the row must work harder by 1."""
        return self.mixer_rows.T

    @cached_property
    def weak_motor_commands(self) -> Array:
        """(k, k) change of the commands of all motors where the motor of the row must work harder by 1.

        The diagonal is the rise of the weak motor's own command. The change is the projection on what the mixer can
        command, pinv(M) M, of the mixer M. With four motors that is all commands, so only the motor's own changes.
        """
        allocation = np.linalg.pinv(self.mixer_rows)
        return (allocation @ self.mixer_rows).T

    @cached_property
    def is_motor_identifiable(self) -> bool:
        """Whether a weak motor can be told from a shifted load and from any other weak motor.

        Motors differ by the directions of their signatures in roll, pitch and yaw, since the size of a loss is not
        known. Two directions are too much alike from a cosine of ``MAX_SIGNATURE_COSINE`` on.

        If the spins of the motors are not known, it cannot: each signature is then that of a load that shifted towards
        the motor. Neither can it where two motors are above each other and turn the same way.
        """
        # The first column is thrust, the last one yaw.
        signatures = self.weak_motor_balance[:, 1:]
        has_all_axes = len(self.axes) > len(AXES)
        if not has_all_axes or not signatures[:, -1].all():
            return False
        directions = signatures / np.linalg.norm(signatures, axis=1, keepdims=True)
        cosines_of_pairs = np.triu(directions @ directions.T, 1)
        return cosines_of_pairs.max() < MAX_SIGNATURE_COSINE


def motor_signatures(geometry: MotorGeometry) -> MotorSignatures:
    """Computes the signatures of the motors of a vehicle from their positions and spins.

    Args:
        geometry: Positions and spins of the k motors. Axes for which it lacks something have no row in the mixer.

    Returns:
        The mixer, whose first row is the thrust: the mean of all commands.
    """
    motor_count = len(geometry.motors)
    axes = ["thrust"]
    rows = [np.full(motor_count, 1.0 / motor_count)]
    for axis in AXES:
        row = geometry.mixer_row(axis)
        if row is not None:
            axes.append(axis)
            rows.append(row)
    return MotorSignatures(tuple(axes), np.array(rows))
