"""Grounding: what keeps a vehicle on the ground; nobody is advised to fly it."""

from __future__ import annotations

from collections.abc import Sequence

from mavdem.analysis.overrides import overrides_of
from mavdem.condition.condition import Condition
from mavdem.facts import Fact
from mavdem.facts.assessment import Override
from mavdem.facts.ending import MotionEvent

GROUNDING = (Override.OSCILLATION, Override.SATURATION, MotionEvent.MOTOR_AT_ITS_STOP)


def grounds_of(
    condition: Condition, events: Sequence[Fact], ending: Fact | None
) -> tuple[Fact, ...]:
    """Returns why a vehicle must not fly again as it is: it was lost, it oscillates, or a motor was at its stop.

    Facts about such a vehicle are shown :attr:`~mavdem.facts.Fact.grounded`.
    """
    found = [*filter(None, [ending]), *overrides_of(condition, ()), *events]
    return tuple(one for one in found if one is ending or one.code in GROUNDING)
