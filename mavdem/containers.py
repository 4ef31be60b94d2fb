"""Plain containers: the types of tuples and JSON objects, and the grouping of items by a key."""

from collections.abc import Callable, Hashable, Iterable
from typing import Any, TypeVar

Names = tuple[str, ...]
"""Names, such as the names of a table's columns."""

Numbers = tuple[float, ...]
"""Floating-point numbers, in an order that the field states."""

JsonValues = dict[str, Any]
"""JSON values by key: a document, or a part of one."""

Item = TypeVar("Item")
Key = TypeVar("Key", bound=Hashable)


def group_by(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Groups items by the key that a function gives each of them.

    Unlike ``itertools.groupby`` it needs no sorted items: equal keys need not be neighbours.

    Args:
        items: Items in any order.
        key: Function that returns the key of an item.

    Returns:
        The items of each key in their order; the keys are in the order in which they first occur.
    """
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups
