"""Overrides: facts (coded findings) that make a flight itself doubtful, even if its model is good."""

from collections.abc import Sequence
from typing import NamedTuple

from mavdem.assessment.condition import Condition
from mavdem.containers import Names
from mavdem.dataset.segment_learnability import MIN_TRUSTED_CONSISTENCY
from mavdem.facts import Code, Fact, Facts, Level
from mavdem.facts.assessment import Override
from mavdem.loops.limit_cycles import MIN_AT_LIMIT_SHARE, Oscillation
from mavdem.motors.hover import HoverFigures
from mavdem.motors.motor_changes import MotorChange, thrust_losses
from mavdem.motors.saturation import equally_loaded_motors, most_limited_motors

MIN_STATED_SHARE = 0.01
"""Fraction of the time at the limit from which on a further motor is stated: less reads as 0 %."""


class LimitedMotors(NamedTuple):
    """Motors that are at their upper limit in the hover: one that stands out, or several that are similar."""

    names: Names
    """Names of the motors."""
    share: float
    """Fraction of the time at the limit, of the motor with the most."""
    equally_loaded: Names
    """Other motors, seldom at their limit, whose mean command in the hover is about as high."""
    other_names: Names = ()
    """Names of the other motors that were at their limit too, for at least ``MIN_STATED_SHARE`` of the time."""
    others_share: float = 0.0
    """Fraction of the time at the limit, of the motor with the most among these."""

    @property
    def subject(self) -> str:
        """Name of the motor that stands out; empty if several are similar, so that none is suspect."""
        return self.names[0] if len(self.names) == 1 and not self.equally_loaded else ""

    def fact(self, code: Code) -> Fact:
        """Returns a fact (a coded finding) about these motors: their names, and the fraction of time at the limit.

        Args:
            code: code that says what the fact states, from which its sentence is made.
        """
        return Fact(
            code,
            subject=self.subject,
            names=self.names,
            share=self.share,
            equally_loaded=self.equally_loaded,
            other_names=self.other_names,
            others_share=self.others_share,
        )


def flight_overrides(
    condition: Condition | None,
    alarms: Sequence[MotorChange],
    consistency: float | None = None,
    trim: Fact | None = None,
) -> Facts:
    """Collects the faults of a flight that override the grades of any model learned from it.

    Of the first four of these only the worst is returned, since each explains the ones after it:

    1. A limit cycle (``Override.OSCILLATION``).
    2. Motors that lost thrust, with a fact (coded finding) for each (``Override.MOTORS``).
    3. A motor at its upper limit in the hover (``Override.SATURATION``).
    4. Motors whose commands in the hover differ much from their mean (``Override.TRIM``).
    5. Recorded body rates that do not match the angles (``Override.DATA``): a fault of the data, which is independent
       of the others.

    Args:
        condition: condition of the vehicle, with its limit cycle and its hover; None if it is not known.
        alarms: lasting changes of the motors' balance.
        consistency: fraction of the angle's changes that the recorded rates explain (R²); None if it is not known.
        trim: fact about the deviations of the motors' commands from their mean; None if they are not known.

    Returns:
        The facts, the worst first; empty for a sound flight.
    """
    losses = thrust_losses(alarms)
    overrides: list[Fact] = []
    if condition is not None and condition.oscillation is not None:
        overrides.append(_oscillation_override(condition.oscillation))
    elif losses:
        overrides += [_loss_override(loss) for loss in losses]
    elif condition is not None and condition.hover is not None:
        motors_at_limit = limited_motors(condition.hover)
        if motors_at_limit is not None:
            overrides.append(motors_at_limit.fact(Override.SATURATION))
        elif trim is not None and trim.level is Level.WATCH:
            overrides.append(Fact(Override.TRIM, subject=trim.subject, reason=trim))
    if consistency is not None and consistency < MIN_TRUSTED_CONSISTENCY:
        overrides.append(Fact(Override.DATA, consistency=consistency))
    return tuple(overrides)


def _oscillation_override(oscillation: Oscillation) -> Fact:
    """Returns the fact that the vehicle was in a limit cycle, which overrides the grades of any model of the flight.

    A model of such a flight describes the oscillation and not the response to commands, so that its figures mean
    nothing.

    Args:
        oscillation: the limit cycle, an oscillation that the control loops keep up.

    Returns:
        A fact (coded finding) with the ``duration`` of the limit cycle, s, whether its amplitude was ``growing``, the
        ``share`` of the time with a motor at a limit, and the figures of the oscillation itself, such as its frequency.
    """
    return Fact(
        Override.OSCILLATION,
        duration=oscillation.seconds,
        growing=oscillation.growing,
        share=oscillation.at_limit,
        **oscillation.figures,
    )


def _loss_override(loss: Fact) -> Fact:
    """Returns the fact that a motor lost thrust in flight, which overrides the grades of any model of the flight.

    The fact (coded finding) is made of the loss: it says that no grade of a model holds, because a motor lost thrust.

    Args:
        loss: the loss of one motor's thrust, from :func:`mavdem.motors.motor_changes.thrust_losses`.

    Returns:
        A fact with the time, level and motor of the loss, the lost fraction of thrust, 0 to 1, as ``loss``, and the
        loss itself as its ``reason``.
    """
    return Fact(
        Override.MOTORS,
        loss.level,
        time=loss.time,
        end_time=loss.end_time,
        subject=loss.subject,
        loss=loss.figures["loss"],
        reason=loss,
    )


def limited_motors(hover: HoverFigures) -> LimitedMotors | None:
    """Returns the motors that are at their upper limit for the largest fraction of the time in the hover.

    Args:
        hover: figures of the motors in the hover.

    Returns:
        The motors, that fraction, and other motors with as high a command; None if the fraction is at most
        ``MIN_AT_LIMIT_SHARE``, so that no motor counts as limited.
    """
    largest_fraction = max(hover.at_upper_limit)
    if largest_fraction <= MIN_AT_LIMIT_SHARE:
        return None
    names = most_limited_motors(hover.motors, hover.at_upper_limit)
    # The imbalance of a motor is the deviation of its mean command from the mean of all motors.
    deviations = dict(zip(hover.motors, hover.imbalance, strict=True))
    # The fraction of the time at the limit of every other motor that is worth a statement.
    other_fractions = {}
    for name, fraction in zip(hover.motors, hover.at_upper_limit, strict=True):
        if name not in names and fraction >= MIN_STATED_SHARE:
            other_fractions[name] = fraction
    return LimitedMotors(
        names,
        largest_fraction,
        equally_loaded_motors(deviations, names),
        other_names=tuple(other_fractions),
        others_share=max(other_fractions.values(), default=0.0),
    )
