"""Grounding: what keeps a vehicle on the ground; nobody is advised to fly it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mavdem.alignment.signals import Signals
from mavdem.analysis.overrides import overrides_of
from mavdem.assessment.ending import ending_of
from mavdem.assessment.motion import motion_events
from mavdem.assessment.reported import reported_events
from mavdem.condition.condition import Condition, condition_of
from mavdem.condition.wind_of_log import Air
from mavdem.facts import Fact
from mavdem.facts.assessment import Override
from mavdem.facts.ending import MotionEvent

GROUNDING = (Override.OSCILLATION, Override.SATURATION, MotionEvent.MOTOR_AT_ITS_STOP)


def grounds_of_log(signals: Signals) -> tuple[Fact, ...]:
    """Returns what :func:`grounds_of` does of all that was recorded of a vehicle."""
    events = *reported_events(signals), *motion_events(signals)
    return grounds_of(condition_of(signals), events, ending_of(signals, events))


def grounds_of(
    condition: Condition, events: Sequence[Fact], ending: Fact | None
) -> tuple[Fact, ...]:
    """Returns why a vehicle must not fly again as it is: it was lost, it oscillates, or a motor was at its stop.

    Facts about such a vehicle are shown :attr:`~mavdem.facts.Fact.grounded`.
    """
    found = [*filter(None, [ending]), *overrides_of(condition, ()), *events]
    return tuple(one for one in found if one is ending or one.code in GROUNDING)


def grounded_air(air: Air) -> Air:
    """Returns what is known of the ``air`` with facts that are grounded."""
    wind, own, reason = air
    if wind is not None:
        wind = replace(wind, reasons={of: fact.grounded for of, fact in wind.reasons.items()})
    return wind, own, reason and reason.grounded
