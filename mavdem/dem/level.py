"""The level of an interval: the probability with which it holds what it is about."""

from __future__ import annotations

from numbers import Real


def require_probability(level: float) -> None:
    """``ValueError`` unless ``level`` lies between 0 and 1."""
    if not (isinstance(level, Real) and 0 < level < 1):
        raise ValueError(f"level must be a probability between 0 and 1, not {level!r}")
