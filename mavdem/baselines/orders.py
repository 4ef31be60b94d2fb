"""Orders as they come in."""

from __future__ import annotations

from operator import index


def required_order(order: int) -> int:
    """``order`` as an ``int``; ``ValueError`` for what is no positive whole number."""
    try:
        number = index(order)
    except TypeError:
        number = 0
    if number < 1 or isinstance(order, bool):
        raise ValueError(f"order must be a positive whole number, not {order!r}")
    return number
