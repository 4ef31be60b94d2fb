"""MotorWatch: watches the motors of a vehicle over its settled flight, and says in a sentence what changed for good."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from mavdem.health.motor_signature import Array, motor_signatures
from mavdem.health.sequential import MIN_RATE, REFERENCE_SECONDS, BalanceTest

FALSE_ALARMS_PER_HOUR = 0.54
"""At most, with 95 % confidence: none came in 5.55 h of simulated sound flight in wind, with gusts and manoeuvres, on
which no parameter was chosen (``tools/validation/alarms.py``). Real vehicles may differ."""
FALSE_ALARMS_BASIS = (
    "none in 5.55 h of simulated sound flight that no parameter was chosen on, so at most 0.54 an hour with 95 % "
    "confidence; real vehicles may differ."
)
UNKNOWN_PLACES = "The motors' places and spins are not known, so that a weak motor would not be seen."
TOO_SLOW = f"Motor outputs come less than {MIN_RATE:.0f} times a second, so that a weak motor would not be seen."
GAP_SECONDS = 2.0  # Without settled samples: what was before is no reference for what comes after


class MotorAlarm(NamedTuple):
    """A lasting change of the motors' balance in flight.

    Attributes:
        time: s on the boot clock, when it was found.
        since: s, when it began, within a second or two.
        motor: number of the motor that works harder, from 1; None, which is no alarm: the steady torque in roll and
            pitch changed, as by wind or by a load that shifts.
        name: of the motor; empty without one.
        size: rise of its command, as a share of the mean command; else the change in roll and pitch.
        probability: that this is the cause, and none of the others that are considered.
        assumed: whether the motors' places are assumed, and with them the name.
        boot: number of the vehicle's boot, from 0 on, whose clock the times are on.
    """

    time: float
    since: float
    motor: int | None
    name: str
    size: float
    probability: float
    assumed: bool = False
    boot: int = 0

    @property
    def sentence(self) -> str:
        """What changed since when, and what that means."""
        clock = f"the clock of boot {self.boot + 1}" if self.boot else "the boot clock"
        since, sure = f"since {self.since:.0f} s of {clock}", f"probability {self.probability:.0%}"
        if self.motor is None:
            return (
                f"The steady torque in roll and pitch is another {since}, and that in yaw the same: no motor is named "
                f"({sure})."
            )
        known = ". Where the motors are is assumed, and so is the name" if self.assumed else ""
        return (
            f"Alarm: {self.name} works {self.size:.0%} harder {since}, as where it or its propeller gives less thrust "
            f"({sure}){known}."
        )

    def as_dict(self) -> dict[str, Any]:
        """All of it as plain JSON values, with the sentence."""
        return {**self._asdict(), "sentence": self.sentence}


def alarm_figures(found: Sequence[MotorAlarm]) -> dict[str, Any]:
    """Plain JSON values: the alarms on motors, the changes of the steady torque, which are none, and false alarms."""
    return {
        "alarms": [one.as_dict() for one in found if one.motor is not None],
        "torque_changes": [one.as_dict() for one in found if one.motor is None],
        "false_alarms_per_hour": {"at_most": FALSE_ALARMS_PER_HOUR, "basis": FALSE_ALARMS_BASIS},
    }


class MotorWatch:
    """The sequential test of one vehicle's motors, over the settled flights of one boot.

    How often it is wrong, ``FALSE_ALARMS_PER_HOUR`` says. Slower samples than ``MIN_RATE`` are not judged.

    Attributes:
        alarms: what was found so far.
        obstacle: why nothing can be found, from settled flight of a few seconds on; empty where it can.
    """

    def __init__(
        self,
        names: Sequence[str],
        numbers: Sequence[int],
        positions: Sequence[Sequence[float]],
        spins: Sequence[int],
        assumed: bool = False,
        boot: int = 0,
    ) -> None:
        """Begins; the motors' ``names``, ``numbers``, ``positions`` and ``spins`` are as of ``MotorGeometry``.

        ``assumed``: whether the positions are. ``boot``: the vehicle's, from 0 on.
        """
        self.alarms: list[MotorAlarm] = []
        self.obstacle = ""
        self._names, self._numbers = tuple(names), tuple(numbers)
        self._assumed, self._boot = assumed, boot
        signatures = motor_signatures(len(names), positions, spins)
        self._test = BalanceTest(signatures) if signatures.names_a_motor else None
        if self._test is None:
            self.obstacle = UNKNOWN_PLACES
        self._latest = self._rate_from = float("-inf")
        self._samples = 0  # Since ``_rate_from``

    def take(self, time: float, commands: Sequence[float] | Array, settled: bool) -> MotorAlarm | None:
        """A sample of the motors' ``commands``, shares of their range, at ``time``, s; returns what it shows."""
        if self._test is None or not settled:
            return None
        if not 0 <= time - self._latest < GAP_SECONDS:
            self._test.restart()
            self._rate_from, self._samples = time, 0
        self._latest = time
        self._check_rate(time)
        change = self._test.take(time, commands)
        if change is None:
            return None
        motor = change.motor
        name, number = ("", None) if motor is None else (self._names[motor], self._numbers[motor])
        found = change.time, change.since, number, name, change.size, change.probability
        self.alarms.append(MotorAlarm(*found, self._assumed, self._boot))
        return self.alarms[-1]

    def _check_rate(self, time: float) -> None:
        if time - self._rate_from >= REFERENCE_SECONDS:
            # By a tenth less, for what jitters.
            self.obstacle = "" if self._samples > 0.9 * MIN_RATE * (time - self._rate_from) else TOO_SLOW
            self._rate_from, self._samples = time, 0
        self._samples += 1
