"""Motor signatures: the pattern in thrust, roll, pitch and yaw that a weak motor makes, and that a shifted load makes.

In trim the motors' thrusts balance the weight and the moments, so what the motors are commanded is fixed. Where motor
i gives less thrust for the same command, the controller raises its command and, where the vehicle has four motors,
that of no other: on an X quad the rise shows as much in roll as in pitch and in yaw, with signs by its place and its
spin. A shifted load or wind from one side shows in roll and pitch, and hardly in yaw.

With six or eight motors the mixer commands thrust, roll, pitch and yaw only, so a weak motor raises its neighbours
too: commands change by the motor's projection on what the mixer can command.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SAME = 0.99  # Cosine from which two signatures are one


@dataclass(frozen=True)
class MotorSignatures:
    """The patterns of a vehicle with k motors, over the a axes that its layout is known for.

    Attributes:
        axes: "thrust", then "roll" and "pitch" where the motors' places are known, "yaw" where their spins are.
        weights: (a, k) from commands to axes: thrust is the mean of all motors, roll on an X quad (left - right)/4, as
            ``MotorGeometry.effect`` has them.
    """

    axes: tuple[str, ...]
    weights: Array

    def balance(self, commands: Array) -> Array:
        """(..., a) commands (..., k) in thrust, roll, pitch and yaw, in their unit."""
        return np.asarray(np.asarray(commands, dtype=np.float64) @ self.weights.T)

    def commands(self, balance: Array) -> Array:
        """(..., k) the smallest commands that make a ``balance`` (..., a)."""
        return np.asarray(np.asarray(balance, dtype=np.float64) @ self._mixer.T)

    @cached_property
    def weak_motor(self) -> Array:
        """(k, a) how the balance of commands changes where motor i, by row, must work harder by 1."""
        return self.weights.T.copy()

    @cached_property
    def weak_motor_commands(self) -> Array:
        """(k, k) the same as commands of all motors: of four motors the identity, of more also the neighbours'."""
        return np.asarray(self._mixer @ self.weights).T

    @cached_property
    def shifted_load(self) -> Array:
        """(2 or 0, a) how the balance changes by a load that shifts to the left, and to the front, or by wind."""
        rows = [axis for axis in ("roll", "pitch") if axis in self.axes]
        return np.array([np.eye(len(self.axes))[self.axes.index(axis)] for axis in rows]).reshape(-1, len(self.axes))

    @cached_property
    def names_a_motor(self) -> bool:
        """Whether a weak motor can be told from a shifted load and from another weak motor.

        Without spins it cannot: every motor's signature is then that of a load shifted towards it. Nor can it where two
        motors lie above each other and turn the same way.
        """
        if "yaw" not in self.axes or "roll" not in self.axes:
            return False
        signatures = self.weak_motor[:, 1:]
        size = np.linalg.norm(signatures, axis=1)
        if not (size > 0).all() or not (np.abs(signatures[:, -1]) > 0).all():
            return False
        cosines = signatures @ signatures.T / np.outer(size, size)
        return bool((cosines[~np.eye(len(size), dtype=bool)] < SAME).all())

    @cached_property
    def _mixer(self) -> Array:
        """(k, a) commands that make a balance of 1 on one axis and nothing on the others."""
        return np.asarray(np.linalg.pinv(self.weights))


def motor_signatures(
    motors: int, positions: Sequence[Sequence[float]] = (), spins: Sequence[int] = ()
) -> MotorSignatures:
    """Those of a vehicle.

    Args:
        motors: how many it has.
        positions: (forward, right) of each motor, as ``MotorGeometry.positions``; empty where not known.
        spins: 1 of a propeller that turns counterclockwise seen from above, -1 clockwise; empty, or zeros, where not
            known.

    Raises:
        ValueError: there are no motors, or positions or spins of another number of them.
    """
    if motors < 1:
        raise ValueError(f"motors must be 1 or more, not {motors}")
    for name, given in (("positions", positions), ("spins", spins)):
        if len(given) not in (0, motors):
            raise ValueError(f"{name} must hold none or {motors} entries, not {len(given)}")
    axes, rows = ["thrust"], [np.full(motors, 1.0 / motors)]
    known: list[tuple[str, Array]] = []
    if len(positions):
        forward, right = np.asarray(positions, dtype=np.float64).T
        known += [("roll", -right), ("pitch", forward)]
    if len(spins) and all(spins):
        known.append(("yaw", np.asarray(spins, dtype=np.float64)))
    for axis, row in known:
        total = float(np.abs(row).sum())
        if total > 0:
            axes.append(axis)
            rows.append(row / total)
    return MotorSignatures(tuple(axes), np.array(rows))
