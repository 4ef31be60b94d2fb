"""MotorWatch: watches the motors of a vehicle over its settled flight, and says in a sentence what changed for good."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from mavdem.health.motor_signature import Array, motor_signatures
from mavdem.health.sequential import BalanceTest

GAP_SECONDS = 2.0  # Without settled samples: what was before is no reference for what comes after


class MotorAlarm(NamedTuple):
    """A lasting change of the motors' balance in flight.

    Attributes:
        time: s on the boot clock, when it was found.
        since: s, when it began, within a second or two.
        motor: number of the motor that works harder, from 1; None: a load shifted or the wind did, and no motor.
        name: of the motor; empty without one.
        size: how much harder it works than before, as a share of the mean command; else the change in roll and pitch.
        probability: that this is the cause, and none of the others that are considered.
        assumed: whether the motors' places are assumed, and with them the name.
    """

    time: float
    since: float
    motor: int | None
    name: str
    size: float
    probability: float
    assumed: bool = False

    @property
    def sentence(self) -> str:
        """What changed since when, and what that means."""
        since, sure = f"since {self.since:.0f} s of the boot clock", f"probability {self.probability:.0%}"
        if self.motor is None:
            return (
                f"The motors' balance is another in roll and pitch {since}, and the same in yaw: a load shifted or the "
                f"wind did, and no motor is to blame ({sure})."
            )
        known = ". Where the motors are is assumed, and so is the name" if self.assumed else ""
        return (
            f"Alarm: {self.name} works {self.size:.0%} harder {since}, as where it or its propeller gives less thrust "
            f"({sure}){known}."
        )

    def as_dict(self) -> dict[str, Any]:
        """All of it as plain JSON values, with the sentence."""
        return {**self._asdict(), "sentence": self.sentence}


class MotorWatch:
    """The sequential test of one vehicle's motors, over the settled flights of one boot.

    How often it is wrong, ``mavdem.health.sequential`` says. Samples must come 8 times a second; slower ones are not
    judged.

    Attributes:
        alarms: what was found so far.
        obstacle: why nothing can be found; empty where it can.
    """

    def __init__(
        self,
        names: Sequence[str],
        numbers: Sequence[int],
        positions: Sequence[Sequence[float]],
        spins: Sequence[int],
        assumed: bool = False,
    ) -> None:
        """Begins; the motors' ``names``, ``numbers``, ``positions`` and ``spins`` are as of ``MotorGeometry``.

        ``assumed``: whether the positions are.
        """
        self.alarms: list[MotorAlarm] = []
        self.obstacle = ""
        self._names, self._numbers, self._assumed = tuple(names), tuple(numbers), assumed
        signatures = motor_signatures(len(names), positions, spins)
        self._test = BalanceTest(signatures) if signatures.names_a_motor else None
        if self._test is None:
            self.obstacle = "The motors' places and spins are not known, so none can be told from a shifted load."
        self._latest = float("-inf")

    def take(self, time: float, commands: Sequence[float] | Array, settled: bool) -> MotorAlarm | None:
        """A sample of the motors' ``commands``, shares of their range, at ``time``, s; returns what it shows."""
        if self._test is None or not settled:
            return None
        if not 0 <= time - self._latest < GAP_SECONDS:
            self._test.restart()
        self._latest = time
        change = self._test.take(time, commands)
        if change is None:
            return None
        motor = change.motor
        name, number = ("", None) if motor is None else (self._names[motor], self._numbers[motor])
        alarm = MotorAlarm(change.time, change.since, number, name, change.size, change.probability, self._assumed)
        self.alarms.append(alarm)
        return alarm
