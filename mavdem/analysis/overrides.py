"""Overrides: what makes a flight itself doubtful, whatever a model of it is good for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import radians

from mavdem.alignment.learnability import DOUBTFUL_CONSISTENCY
from mavdem.condition.condition import Condition, HoverFigures
from mavdem.condition.oscillation import Oscillation
from mavdem.facts import Fact, Level
from mavdem.facts.assessment import Override
from mavdem.health.in_flight import MotorAlarm

# share of the time at full throttle, from which on no linear model describes the vehicle
SATURATED = 0.05
UNEVEN = 8.0  # percent of a motor beyond the mean of all: what health calls a fault's size


def overrides_of(
    condition: Condition | None, alarms: Sequence[MotorAlarm], consistency: float | None = None
) -> tuple[Fact, ...]:
    """Returns what makes the flight doubtful, the worst first.

    What comes first explains the others: motors at their limits, where the vehicle oscillates or one is weak. The
    ``consistency`` is the share of the angle's changes that the rates explain.
    """
    overrides = [*_lost_thrust(alarms)]
    if condition is not None and condition.oscillation is not None:
        overrides = [_oscillation(condition.oscillation)]
    elif condition is not None and condition.hover is not None and not overrides:
        overrides = [*_unbalanced(condition.hover)]
    if consistency is not None and consistency < DOUBTFUL_CONSISTENCY:
        overrides.append(Fact(Override.DATA, Level.WATCH, consistency=consistency))
    return tuple(overrides)


def _oscillation(found: Oscillation) -> Fact:
    return Fact(
        Override.OSCILLATION,
        Level.BAD,
        subject=found.axis,
        frequency=found.frequency,
        turn_rate=radians(found.rate),
        duration=found.seconds,
        growing=found.growing,
        share=found.at_limit,
    )


def _lost_thrust(alarms: Sequence[MotorAlarm]) -> Iterator[Fact]:
    """Each motor that weakened in flight, at its first alarm's time, by its largest; the worst by the least first."""
    weak = sorted((alarm for alarm in alarms if alarm.weak), key=lambda alarm: -alarm.size)
    for name in reversed(dict.fromkeys(alarm.name for alarm in reversed(weak))):
        worst, *others = (alarm for alarm in weak if alarm.name == name)
        yield Fact(
            Override.MOTORS,
            Level.BAD,
            time=min(alarm.since for alarm in (worst, *others)),
            subject=name,
            loss=worst.loss,
            because=worst.fact,
        )


def most_uneven(imbalance: Sequence[float]) -> int:
    """Returns which motor, from 0, is farthest from the mean, in percent; one that works harder goes before others."""
    hardest = max(imbalance)
    return list(imbalance).index(hardest if hardest > UNEVEN else max(imbalance, key=abs))


def _unbalanced(hover: HoverFigures) -> Iterator[Fact]:
    """The motor most at its upper limit, if over ``SATURATED``; else the most uneven one, if over ``UNEVEN``."""
    share = max(hover.at_upper_limit)
    uneven = most_uneven(hover.imbalance)
    most = hover.imbalance[uneven]
    if share > SATURATED:
        limited = hover.motors[hover.at_upper_limit.index(share)]
        yield Fact(Override.SATURATION, Level.BAD, subject=limited, share=share)
    elif abs(most) > UNEVEN:
        yield Fact(Override.TRIM, Level.WATCH, subject=hover.motors[uneven], deviation=most / 100)
