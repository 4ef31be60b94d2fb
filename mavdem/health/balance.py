"""Balance: what a settled flight asks of its motors in roll, pitch and yaw, and how that follows the vehicle's lean.

Wind from one side makes a vehicle lean against it and, by the flapping of its rotors, by drag above or below its centre
of mass and by a load beside it, asks for a steady torque too. Both change together within a flight, gust by gust, so
each flight shows its own slopes of the balance over the lean, whatever is damaged. With them, flights in other winds
are compared level.

A weak motor and a shifted load each make a pattern in thrust, roll, pitch and yaw, the motors' signatures.
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
from typing import NamedTuple

import numpy as np

from mavdem.alignment.align import settled_segments, within
from mavdem.alignment.drive import AXES, MotorGeometry
from mavdem.alignment.signals import Signals
from mavdem.dem.engine.linalg import Array

BLOCK_SECONDS = 3.0
"""Over which commands and lean are averaged: longer than the attitude's motion, shorter than most gusts."""
FEWEST_BLOCKS = 6  # From which means and slopes have an error that can be estimated


@dataclass(frozen=True)
class MotorSignatures:
    """The patterns of a vehicle with k motors, over the a axes that its layout is known for."""

    # "thrust", then "roll" and "pitch" where the motors' places are known, "yaw" where their spins are
    axes: tuple[str, ...]
    # (a, k) from commands to axes: thrust is the mean of all motors, roll on an X quad (left - right)/4, as
    # ``MotorGeometry.effect`` has them
    weights: Array

    @property
    def weak_motor(self) -> Array:
        """(k, a) how the balance of commands changes where motor i, by row, must work harder by 1."""
        return self.weights.T

    @cached_property
    def weak_motor_commands(self) -> Array:
        """(k, k) the same as commands of all motors: of four motors the identity, of more also the neighbours'."""
        return np.asarray(np.linalg.pinv(self.weights) @ self.weights).T

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
        if not signatures[:, -1].all():
            return False
        cosines = signatures @ signatures.T / np.outer(size, size)
        return bool((cosines[~np.eye(len(size), dtype=bool)] < 0.99).all())


def motor_signatures(
    motors: int, positions: Sequence[tuple[float, float]] = (), spins: Sequence[int] = ()
) -> MotorSignatures:
    """Those of a vehicle with so many ``motors``; ``positions`` and ``spins`` are as ``MotorGeometry`` has them.

    Both are empty where not known, and spins may be zeros then. Raises ValueError: they are of other motors.
    """
    if motors < 1 or {len(positions), len(spins)} - {0, motors}:
        raise ValueError(f"positions and spins must be of the {motors} motors, of which there is one at least")
    layout = MotorGeometry((), (), tuple(positions), "", False, False, spins=tuple(spins) if all(spins) else ())
    effects = {axis: effect for axis in AXES if (effect := layout.effect(axis)) is not None}
    return MotorSignatures(("thrust", *effects), np.array([np.full(motors, 1.0 / motors), *effects.values()]))


class BalanceFigures(NamedTuple):
    """The balance of one vehicle in settled flight, in shares of the mean command of all motors.

    NaN stands for what the layout of the motors or the log does not say. Errors are standard errors.
    """

    mean: Array  # (3,) of roll, pitch and yaw
    error: Array  # (3,) of ``mean`` at this lean, by the scatter of blocks of 3 s or a little more
    lean: Array  # (2,) mean roll and pitch, rad
    lean_effect: Array  # (3, 2) change of the balance by roll and by pitch, 1/rad
    lean_effect_error: Array  # (3, 2)
    seconds: float  # of settled flight


def balance_of_signals(signals: Signals) -> BalanceFigures | None:
    """The figures of a vehicle's settled flight; None without motor outputs, or where it is too short."""
    motors = signals.motors
    if motors is None:
        return None
    signatures = motor_signatures(len(motors.layout.motors), motors.layout.positions, motors.layout.spins)
    runs, segments = [], sorted(settled_segments(signals), key=lambda found: (found.boot, found.start))
    for segment in segments:
        time = motors.time[within(motors, segment)]
        lean = np.full((len(time), 2), np.nan)
        for column, tilt in enumerate(signals.tilts if len(signals.tilts) == 2 else ()):
            rows = within(tilt, segment)
            if rows.any():
                lean[:, column] = np.interp(time, tilt.time[rows], tilt.angle[rows])
        runs.append((time, motors.scale.fraction(motors.outputs[within(motors, segment)]), lean))
    return balance_figures(runs, signatures, sum(segment.duration for segment in segments))


def balance_figures(
    runs: Sequence[tuple[Array, Array, Array]], signatures: MotorSignatures, seconds: float
) -> BalanceFigures | None:
    """Those of unbroken runs of samples, of so many ``seconds`` in all; None where they are too short.

    A run is time (N,), s, rising; the motors' commands (N, k) as shares of their range; roll and pitch (N, 2), rad, NaN
    where not known.
    """
    blocks = [block for run in runs for block in _blocks(*run, signatures)]
    if len(blocks) < FEWEST_BLOCKS or len(signatures.axes) == 1:
        return None
    balance, lean = (np.array(means) for means in zip(*blocks, strict=True))
    rest, leaned = balance - balance.mean(axis=0), lean - lean.mean(axis=0)
    effect, effect_variance = np.full((3, 2), np.nan), np.full((3, 2), np.nan)
    freedom = len(blocks) - 1
    if np.isfinite(leaned).all() and np.linalg.matrix_rank(leaned) == 2:
        inverse = np.linalg.inv(leaned.T @ leaned)
        effect = (inverse @ leaned.T @ rest).T
        rest = rest - leaned @ effect.T
        freedom -= 2
        effect_variance = np.broadcast_to(np.diag(inverse), (3, 2))
    variance = (rest**2).sum(axis=0) / freedom * [_inflation(column) for column in rest.T]
    error, effect_error = np.sqrt(variance / len(blocks)), np.sqrt(variance[:, None] * effect_variance)
    return BalanceFigures(balance.mean(axis=0), error, lean.mean(axis=0), effect, effect_error, seconds)


def _blocks(time: Array, commands: Array, lean: Array, signatures: MotorSignatures) -> list[tuple[Array, Array]]:
    """Means of the balance (3,), over that of all motors, and of the lean (2,), of blocks of equal length."""
    if len(time) < 2:
        return []
    balance = np.full((len(time), 3), np.nan)
    asked = commands @ signatures.weights.T
    for axis, column in zip(signatures.axes[1:], asked.T[1:], strict=True):
        balance[:, AXES.index(axis)] = column
    thrust = asked[:, 0]
    seconds = time[-1] - time[0]
    count = int(seconds / BLOCK_SECONDS)
    number = np.minimum((time - time[0]) / seconds * count, count - 1).astype(int)
    rows = [number == block for block in range(count)]
    flown = [mine for mine in rows if mine.any() and thrust[mine].mean() > 0]
    return [(balance[mine].mean(axis=0) / thrust[mine].mean(), lean[mine].mean(axis=0)) for mine in flown]


def _inflation(rest: Array) -> float:
    """By how much the variance of a mean exceeds that of independent blocks, as for a first-order autoregression."""
    power = float(rest @ rest)
    correlation = float(rest[1:] @ rest[:-1]) / power if power > 0 else 0.0
    correlation = min(max(correlation, 0.0), 0.9)
    return (1 + correlation) / (1 - correlation)
