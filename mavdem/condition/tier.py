"""Tier: how much the rates of a log let it say, why no more, and what the next tier needs."""

from __future__ import annotations

from typing import Any, NamedTuple

from mavdem.alignment.signals import MINIMUM_RATE, SLOW_MOTION_RATE
from mavdem.alignment.verdict import Verdict
from mavdem.condition.condition import Condition

SLOWEST_RATE = 1.0  # Hz, of attitude and motor outputs, down to which their means, spreads and limits are known
ALLOWS = {
    "a": "everything: the model, the vehicle's physical parameters, the wind, and the vehicle's condition",
    "b": "the slow motion, if a model predicts it better than none does, and the vehicle's condition: balance, limits, "
    "lean and steady disturbance; not motors' effect, damping, lag, the wind's torque and poles, which show at several "
    "Hz",
    "c": "the vehicle's condition: balance, headroom, saturation, lean, vibration and battery; no model",
}
"""What each tier allows."""
NEEDS = {
    "a": f"{MINIMUM_RATE:.0f} Hz of attitude and of motor outputs or demand, better 100",
    "b": f"{SLOW_MOTION_RATE:.0f} Hz of attitude and of motor outputs or demand",
    "c": "settled flight of a multirotor, with attitude",
}
"""What each tier needs."""


class Tier(NamedTuple):
    """What a log allows.

    Attributes:
        name: "a", "b" or "c"; None where there is no settled flight.
        reason: one sentence with the figures that decided; of all but "a", why it is no better.
        next_tier: the next better one; None for "a".
        next_needs: what that needs; empty for "a".
        remedy: what to change, by the log's own parameters and firmware; empty for "a".
    """

    name: str | None
    reason: str
    next_tier: str | None
    next_needs: str
    remedy: str

    @property
    def allows(self) -> str:
        """What it allows, in words; empty where there is none."""
        return ALLOWS.get(self.name or "", "")

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values: ``tier``, ``tier_reason`` and ``next_tier``."""
        following = {"tier": self.next_tier, "needs": self.next_needs, "remedy": self.remedy}
        return {
            "tier": self.name,
            "tier_reason": self.reason,
            "allows": self.allows,
            "next_tier": None if self.next_tier is None else following,
        }


def tier_of(verdict: Verdict, condition: Condition) -> Tier:
    """The tier of a vehicle with a ``verdict`` on one axis and the ``condition`` of its settled flight.

    It goes by the rates. In the second tier a model may still be refused, such as for rates and angles that contradict
    each other; :func:`mavdem.analysis.analyse` says.
    """
    figures = verdict.figures
    slower = min(figures.attitude_rate or 0.0, figures.motor_rate or 0.0)
    if verdict.learnable:
        return Tier("a", verdict.reason, None, "", "")
    if not condition.settled or not condition.lean:
        name, following = None, "c"
    elif slower >= SLOW_MOTION_RATE:
        name, following = "b", "a"
    elif 0 < slower < SLOWEST_RATE:
        name, following = None, "c"
    else:
        name, following = "c", "b"
    return Tier(name, verdict.reason, following, NEEDS[following], verdict.remedy)
