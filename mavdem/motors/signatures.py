"""Signatures of weak motors: how thrust, roll, pitch and yaw commands change if a motor gives less thrust.

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
"""Cosine of the angle between two motors' signatures from which on they cannot be distinguished; a choice."""


@dataclass(frozen=True)
class MotorSignatures:
    """Mixer of a vehicle with k motors, for the a axes known from its geometry, and the signatures of weak motors."""

    axes: Names
    """Names of the axes: "thrust", "roll" and "pitch" where positions are known, "yaw" where spins are known."""
    mixer_rows: Array
    """(a, k) contribution of each motor's command to each axis.

    Thrust is the mean of all commands; the other rows come from ``MotorGeometry.mixer_row``, on an X quadrotor
    (left - right) / 4 for roll.
    """

    @property
    def weak_motor_balance(self) -> Array:
        """(k, a) change of the commands of the axes where the motor of the row must work harder by 1."""
        return self.mixer_rows.T

    @cached_property
    def weak_motor_commands(self) -> Array:
        """(k, k) change of the commands of all motors if the motor of the row must work harder by 1.

        With the mixer M the change is the projection pinv(M) M of the rise on the commands that the mixer can make. On
        the diagonal is the rise of the weak motor's command. With four motors the projection is the identity: only the
        command of the weak motor changes.
        """
        allocation = np.linalg.pinv(self.mixer_rows)
        return (allocation @ self.mixer_rows).T

    @cached_property
    def torque_allocation(self) -> Array:
        """(k, a - 1) change of the command of each motor by the commands of all axes but thrust."""
        return np.linalg.pinv(self.mixer_rows)[:, 1:].astype(np.float64)

    @property
    def own_rise_ratios(self) -> Array:
        """(k,) rise of a motor's own command if it must work harder by 1; its neighbours supply the rest."""
        return np.diag(self.weak_motor_commands)

    @cached_property
    def is_motor_identifiable(self) -> bool:
        """Whether a weak motor can be distinguished from a shifted load and from any other weak motor.

        Since the size of a loss is not known, motors differ only in the directions of their signatures in roll, pitch
        and yaw. Two directions are too similar if their cosine is ``MAX_SIGNATURE_COSINE`` or more, as for two motors
        above each other that turn the same way. Without the spins of the motors, each signature equals the signature of
        a load that shifted towards the motor.
        """
        # Thrust must be known too, besides roll, pitch and yaw.
        has_all_axes = len(self.axes) > len(AXES)
        if not has_all_axes:
            return False
        # The signature of each motor (k, 3): roll, pitch and yaw. The column before them is thrust.
        signatures = self.weak_motor_balance[:, 1:]
        yaw_column = -1
        if not signatures[:, yaw_column].all():
            return False
        directions = signatures / np.linalg.norm(signatures, axis=1, keepdims=True)
        # The upper triangle has each pair of different motors once.
        cosines_of_pairs = np.triu(directions @ directions.T, k=1)
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
    mixer_rows = [np.full(motor_count, 1.0 / motor_count)]
    for axis in AXES:
        mixer_row = geometry.mixer_row(axis)
        if mixer_row is not None:
            axes.append(axis)
            mixer_rows.append(mixer_row)
    return MotorSignatures(tuple(axes), np.array(mixer_rows))
