"""Tier of a log: what its rates allow, from a full model down to figures of the condition alone."""

from typing import NamedTuple

from mavdem.assessment.condition import Condition
from mavdem.dataset.segment_learnability import Learnability, slower_stream_rate
from mavdem.dataset.signals import MIN_SLOW_MOTION_RATE, MIN_STREAM_RATE
from mavdem.facts import Fact
from mavdem.facts.vehicle import TierAllowance

MIN_CONDITION_RATE = 1.0
"""Rate of attitude and motor outputs, Hz, from which on their means, spreads and limits are known."""

TIERS = {
    "a": Fact(TierAllowance.TIER_A, rate=MIN_STREAM_RATE),
    "b": Fact(TierAllowance.TIER_B, rate=MIN_SLOW_MOTION_RATE),
    "c": Fact(TierAllowance.TIER_C),
}
"""What each tier allows: "a" a full model, "b" a model of the slow motion, "c" figures of the condition only."""


class NextTier(NamedTuple):
    """The tier above the tier of a log, which the log does not reach."""

    tier: str
    """"a", "b" or "c"."""
    reason: Fact
    """Why the log does not have it, and what to change."""
    is_slow: bool
    """Whether higher rates are what is missing."""

    @property
    def remedy(self) -> str:
        """What to change to have it, in words."""
        return self.reason.remedy

    @property
    def needs(self) -> str:
        """What the log must have for it, in words."""
        return TIERS[self.tier].remedy if self.is_slow else self.remedy.rstrip(".")


class Tier(NamedTuple):
    """What a log allows."""

    tier: str | None
    """"a", "b" or "c"; None without settled flight."""
    tier_reason: Fact
    """What decided the tier; below "a" also what to change."""
    allows: Fact | None
    """What the tier gives; None without a tier."""
    next_tier: NextTier | None
    """The tier above; None for "a"."""

    @property
    def allows_full_model(self) -> bool:
        """Whether a full model can be learned of the log, tier "a"."""
        return self.tier == "a"


def log_tier(learnability: Learnability, condition: Condition) -> Tier:
    """Returns the tier of a log: "a" for a full model, "b" for one of the slow motion, "c" for the condition only.

    A log in which a full model can be learned has tier "a". Otherwise the rate of the slower stream decides, of the
    attitude and the model inputs. From ``MIN_SLOW_MOTION_RATE`` on it has tier "b", in which a model may still be
    refused (:func:`mavdem.assessment.axis.analyse`), and from ``MIN_CONDITION_RATE`` on tier "c".

    Args:
        learnability: whether a full model can be learned, and the rates, Hz.
        condition: condition of the vehicle. Without settled flight or attitude there is no tier.

    Returns:
        The tier, and the next better one with the reason why the log does not reach it.
    """
    reason = learnability.reason
    if learnability.learnable:
        return Tier("a", reason, TIERS["a"], next_tier=None)
    rate = slower_stream_rate(learnability.figures)
    needs_faster_streams = rate < MIN_STREAM_RATE
    # A rate of 0 is not known.
    is_too_slow = 0 < rate < MIN_CONDITION_RATE
    tier = None
    allowed_uses = None
    if not condition.settled or not condition.lean or is_too_slow:
        next_tier = "c"
    elif rate >= MIN_SLOW_MOTION_RATE:
        tier = "b"
        next_tier = "a"
        allowed_uses = TIERS[tier]
    else:
        tier = "c"
        next_tier = "b"
        allowed_uses = TIERS[tier]
    return Tier(tier, reason, allowed_uses, NextTier(next_tier, reason, needs_faster_streams))
