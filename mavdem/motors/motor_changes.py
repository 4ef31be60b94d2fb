"""Lasting changes of the motors' balance in flight, and the facts about them: lost thrust, recovery, steady torque."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import NamedTuple

from mavdem.containers import JsonValues, Numbers
from mavdem.facts import Fact, Level
from mavdem.facts.motors import MotorWatchFact
from mavdem.facts.session import SessionFact

FALSE_ALARMS = Fact(MotorWatchFact.FALSE_ALARMS, duration=5.55 * 3600, alarms_per_hour=0.54)
"""Upper bound of the rate of false alarms, with 95 % confidence, and the seconds of flights without a fault behind it.

It was measured with ``tools/validation/alarms.py``; see docs/evidence/motors.md.
"""

THRUST_EXPONENTS = (1.0, 2.0)
"""Bounds of the exponent n of the thrust curve: thrust is proportional to the command to the power of n.

The exponent is 1 in PX4's simulator SIH, and 2 in ArduPilot's SITL at hover. The lower end of an interval of lost
thrust is for the first, the upper end for the second.
"""


MIN_LOSS_SECONDS = 8.0
"""Seconds that a loss of thrust must last: a gust, or a lean of the vehicle in a correction, is over by then."""


MAX_ONSET_ERROR = 2.0
"""Largest error of the time at which a detected loss began, s: ``MotorChange.onset_time`` is known to 1 to 2 s."""


MIN_REPORTED_GROWTH = 1.5
"""Ratio of the rise of a motor's command to the reported one from which on a loss is reported again: a choice."""


class CauseProbabilities(NamedTuple):
    """Probabilities of the causes of a change that names no motor; the rest is that of all others, such as wind."""

    load: float
    """Probability that a load shifted."""
    motor: float
    """Probability that some motor, or its propeller, lost thrust."""
    likeliest_motor: int
    """Index of the motor that most probably lost thrust."""
    likeliest_motor_probability: float
    """Probability that this motor, or its propeller, lost thrust."""


class SuspectedMotor(NamedTuple):
    """The motor that probably changed the torque in roll and pitch, though the evidence is too weak for an alarm."""

    name: str
    """Name of the motor."""
    probability: float
    """Probability that it, or its propeller, lost thrust."""
    rise: float
    """Rise of its own command if it did, as a fraction of the command before."""


class MotorChange(NamedTuple):
    """A lasting change of the balance in flight: a motor lost thrust or regained it, or the steady torque changed."""

    time: float
    """When it was detected, s on the boot clock."""
    onset_time: float
    """When it began, s on the boot clock, to within a second or two."""
    motor: int | None
    """Number of the motor, from 1. None: the steady torque in roll and pitch changed, as by a shifted load."""
    name: str
    """Name of the motor; empty without one."""
    size: float
    """Rise of the motor's own command since it was sound, as a fraction of it; 0 of one that has recovered.

    Without a motor: the change in roll and pitch, as a fraction of the mean command.
    """
    probability: float
    """Probability that this is the cause, and none of the others that are considered."""
    assumed: bool = False
    """Whether the positions of the motors, and with them the name, are an assumption."""
    boot: int = 0
    """Number of the boot whose clock the times are on, from 0."""
    loss: Numbers = ()
    """Ends of the 90 % interval of the fraction of its thrust that a weak motor lost, for all ``THRUST_EXPONENTS``."""
    cause_probabilities: CauseProbabilities | None = None
    """What may have changed the torque, where no motor is named."""
    suspect: SuspectedMotor | None = None
    """The motor that probably changed the torque; None if none is probable enough, or if ``motor`` names it."""

    @property
    def is_weak(self) -> bool:
        """Whether a motor gives less thrust than when it was sound."""
        return self.motor is not None and self.size > 0

    @property
    def fact(self) -> Fact:
        """The fact that states what changed, and since when; its level is bad where a motor lost thrust.

        It is one of three: the steady torque changed, a motor lost thrust, or a motor recovered.
        """
        if self.motor is None:
            code = MotorWatchFact.STEADY_TORQUE_CHANGED
        elif self.is_weak:
            code = MotorWatchFact.MOTOR_LOST_THRUST
        else:
            code = MotorWatchFact.MOTOR_RECOVERED
        fact = Fact(
            code,
            time=self.onset_time,
            subject=self.name,
            rise=self.size,
            loss=self.loss,
            probability=self.probability,
            assumed=self.assumed,
            boot=self.boot,
        )
        causes = self.cause_probabilities
        if causes is None:
            return fact
        fact = fact.replace(load_probability=causes.load, motor_probability=causes.motor)
        suspect = self.suspect
        if suspect is None:
            return fact
        return fact.replace(
            suspect=suspect.name,
            suspect_probability=suspect.probability,
            suspect_rise=suspect.rise,
        )

    @property
    def event(self) -> Fact:
        """The fact as an event in flight, an alarm where a motor lost thrust."""
        return alarm_if_bad(self.fact, self.onset_time)


def alarm_if_bad(fact: Fact, time: float) -> Fact:
    """Returns what a live session reports of a finding in flight, such as the fault of a motor: an event or an alarm.

    Args:
        fact: The finding.
        time: Time when it was detected, s on the boot clock.

    Returns:
        For a bad finding an alarm (``SessionFact.ALARM``) with the finding as its reason. Any other finding becomes an
        event, which begins at its own time or, if it has none, when it was detected. Its end time is removed: a finding
        that is reported in flight may still go on.
    """
    if fact.is_bad:
        return Fact(SessionFact.ALARM, time=time, subject=fact.subject, reason=fact)
    return fact.replace(time=time if fact.time is None else fact.time, end_time=None)


def thrust_losses(changes: Sequence[MotorChange]) -> list[Fact]:
    """Returns the losses of thrust in a flight as facts, the worst first.

    Of several losses of a motor before it recovers, only the largest is returned. There are three cases:

    - A loss without a recovery is bad.
    - A loss that ended has the level "watch", and its end time. It is bad too if it was larger than a loss that lasts,
      since the lasting one may then be the smaller fault.
    - A loss that ended soon was too brief to be real, and is left out (:func:`_losses_by_outcome`).

    Args:
        changes: All changes of the flight, in the order of time.

    Returns:
        The facts: bad ones before the others, and both by descending rise of the motor's command. Each has the names of
        all motors whose losses are bad.
    """
    lasting_losses, ended_losses = _losses_by_outcome(changes)
    # The size of a loss is the rise of the motor's command by which the controller compensates for it.
    smallest_lasting_size = min((loss.size for loss in lasting_losses), default=inf)
    bad_losses = [loss.fact for loss in lasting_losses]
    watched_losses = []
    for loss, recovery_time in ended_losses:
        if loss.size > smallest_lasting_size:
            bad_losses.append(loss.fact.replace(Level.BAD, end_time=recovery_time))
        else:
            watched_losses.append(loss.fact.replace(Level.WATCH, end_time=recovery_time))
    bad_losses.sort(key=_rise_of_command, reverse=True)
    watched_losses.sort(key=_rise_of_command, reverse=True)
    # A motor may have several losses, but is named once: a dictionary keeps the order, and each key once.
    names_of_bad_motors = tuple(dict.fromkeys(fact.subject for fact in bad_losses))
    return [fact.replace(names=names_of_bad_motors) for fact in (*bad_losses, *watched_losses)]


def torque_changes(changes: Sequence[MotorChange]) -> list[Fact]:
    """Returns the lasting changes of the steady torque in a flight, which name no motor for certain, as facts.

    Args:
        changes: All changes of the flight, in the order of time.

    Returns:
        The facts, in the same order; their level is "watch".
    """
    return [change.fact for change in changes if change.motor is None]


def _rise_of_command(loss: Fact) -> float:
    """Returns by how much the command of a motor rose when it lost thrust, relative to the command before."""
    return float(loss.figures["rise"])


def is_much_larger(slow_loss: MotorChange, sudden_changes: Sequence[MotorChange]) -> bool:
    """Returns whether a slow loss is so much larger than sudden losses of its motor that these were only parts of it.

    A slow loss is found by comparing the end of a flight with its beginning, as if only one motor had changed. If
    another motor changed suddenly, or the motor recovered, that is not so, and the slow loss is not relied on.

    Args:
        slow_loss: the loss of one motor that was found in all of a flight.
        sudden_changes: sudden changes in this flight, each of which names a motor.

    Returns:
        Whether it is; true without any sudden change.
    """
    for change in sudden_changes:
        is_loss_of_same_motor = change.is_weak and change.name == slow_loss.name
        if not is_loss_of_same_motor:
            return False
        if slow_loss.size < MIN_REPORTED_GROWTH * change.size:
            return False
    return True


class _EndedLoss(NamedTuple):
    """A loss of thrust from which the motor recovered."""

    loss: MotorChange
    """The loss."""
    recovery_time: float
    """When the motor gave its full thrust again, s since boot."""


class _LossesByOutcome(NamedTuple):
    """The losses of thrust in a flight: of each motor the largest before it recovers."""

    lasting: list[MotorChange]
    """Losses without a recovery."""
    ended: list[_EndedLoss]
    """Losses that ended; none that ended within ``MIN_LOSS_SECONDS``."""


def _losses_by_outcome(changes: Sequence[MotorChange]) -> _LossesByOutcome:
    """Separates the losses of thrust in a flight into those that last and those from which the motor recovered.

    A motor may lose thrust several times before it recovers. Only the largest of these losses is returned.

    Args:
        changes: all changes of the motors in a flight, in the order of time.
    """
    # The largest loss of each motor that has not recovered yet, by boot and name of the motor.
    largest_losses: dict[tuple[int, str], MotorChange] = {}
    ended_losses: list[_EndedLoss] = []
    for change in changes:
        motor = (change.boot, change.name)
        if change.is_weak:
            earlier_loss = largest_losses.get(motor)
            if earlier_loss is None or change.size > earlier_loss.size:
                largest_losses[motor] = change
        elif motor in largest_losses:
            # A change that does not leave the motor weak is its recovery.
            loss = largest_losses.pop(motor)
            recovery_time = change.onset_time
            if recovery_time - loss.onset_time >= MIN_LOSS_SECONDS:
                ended_losses.append(_EndedLoss(loss, recovery_time))
    # The losses that no recovery has removed last until the end of the flight.
    lasting_losses = list(largest_losses.values())
    return _LossesByOutcome(lasting_losses, ended_losses)


def lasting_changes(changes: Sequence[MotorChange]) -> list[MotorChange]:
    """Returns the changes of a flight without losses of thrust that were too brief to be real.

    A motor that seems weak for less than ``MIN_LOSS_SECONDS`` was disturbed by a gust or a correction of the attitude.
    Its loss is removed together with the recovery that ended it. A recovery without a loss before it is removed as
    well. All changes of the steady torque, which concern no single motor, remain.

    Args:
        changes: All changes of the flight, in the order of time.

    Returns:
        The remaining changes, in the same order.
    """
    # The losses of each motor since it last gave its full thrust, by boot and name of the motor.
    open_losses: dict[tuple[int, str], list[MotorChange]] = {}
    removed_changes: list[MotorChange] = []
    for change in changes:
        if change.motor is None:
            continue
        motor = (change.boot, change.name)
        if change.is_weak:
            open_losses.setdefault(motor, []).append(change)
            continue
        # Every other change of a motor is its recovery, which ends its losses.
        ended_losses = open_losses.pop(motor, [])
        if not ended_losses:
            removed_changes.append(change)
            continue
        # A motor may lose more thrust before it recovers. The time is counted from the onset of the largest loss.
        largest_loss = max(ended_losses, key=lambda loss: loss.size)
        seconds_until_recovery = change.onset_time - largest_loss.onset_time
        if seconds_until_recovery < MIN_LOSS_SECONDS:
            removed_changes += [*ended_losses, change]
    return [change for change in changes if change not in removed_changes]


def alarm_figures(changes: Sequence[MotorChange]) -> JsonValues:
    """Returns the changes of a flight, sorted by what changed, and the bound on the rate of false alarms.

    Args:
        changes: All changes of the flight.

    Returns:
        Values by the keys that the JSON documents have: "alarms" (a motor lost thrust), "recoveries" and
        "torque_changes", each a list of changes; and "false_alarms_per_hour", the bound and the fact it is based on.
    """
    codes = {
        "alarms": MotorWatchFact.MOTOR_LOST_THRUST,
        "recoveries": MotorWatchFact.MOTOR_RECOVERED,
        "torque_changes": MotorWatchFact.STEADY_TORQUE_CHANGED,
    }
    figures: JsonValues = {}
    for name, code in codes.items():
        figures[name] = [change for change in changes if change.fact.code is code]
    figures["false_alarms_per_hour"] = {
        "at_most": FALSE_ALARMS.figures["alarms_per_hour"],
        "basis": FALSE_ALARMS,
    }
    return figures
