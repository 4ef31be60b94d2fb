"""Overrides: what makes a flight itself doubtful, whatever a model of it is good for."""

from collections.abc import Sequence

from mavdem.assessment.condition import Condition
from mavdem.containers import JsonValues
from mavdem.dataset.learnability import MIN_TRUSTED_CONSISTENCY
from mavdem.facts import Fact, Facts, Level
from mavdem.facts.assessment import Override
from mavdem.loops.limit_cycles import MIN_AT_LIMIT_SHARE
from mavdem.motors.hover import HoverFigures
from mavdem.motors.loss_detection import MotorAlarm, losses_of


def overrides_of(
    condition: Condition | None,
    alarms: Sequence[MotorAlarm],
    consistency: float | None = None,
    trim: Fact | None = None,
) -> Facts:
    """Returns what makes the flight doubtful, the worst first.

    What comes first explains the others: motors at their limits, where the vehicle oscillates or one is weak. The
    ``consistency`` is the share of the angle's changes that the rates explain, ``trim`` how even the motors work.
    """
    overrides = [
        Fact(
            Override.MOTORS,
            lost.level,
            time=lost.time,
            until=lost.until,
            subject=lost.subject,
            loss=lost.figures["loss"],
            because=lost,
        )
        for lost in losses_of(alarms)
    ]
    if condition is not None and condition.oscillation is not None:
        cycle = condition.oscillation
        overrides = [
            Fact(
                Override.OSCILLATION,
                duration=cycle.seconds,
                growing=cycle.growing,
                share=cycle.at_limit,
                **cycle.figures,
            )
        ]
    elif condition is not None and condition.hover is not None and not overrides:
        limited = limited_motor(condition.hover)
        if limited is not None:
            overrides = [Fact(Override.SATURATION, **limited)]
        elif trim is not None and trim.level is Level.WATCH:
            overrides = [Fact(Override.TRIM, subject=trim.subject, because=trim)]
    if consistency is not None and consistency < MIN_TRUSTED_CONSISTENCY:
        overrides.append(Fact(Override.DATA, consistency=consistency))
    return tuple(overrides)


def limited_motor(hover: HoverFigures) -> JsonValues | None:
    """Returns the motor that is most at its upper limit, as ``subject`` and ``share`` of a fact.

    None where that is at most ``MIN_AT_LIMIT_SHARE`` of the time.
    """
    share = max(hover.at_upper_limit)
    if share <= MIN_AT_LIMIT_SHARE:
        return None
    return {"subject": hover.motors[hover.at_upper_limit.index(share)], "share": share}
