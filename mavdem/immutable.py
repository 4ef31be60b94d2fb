"""Immutable results: dataclasses whose arrays and dictionaries cannot be changed, however deeply they are nested."""

from dataclasses import is_dataclass
from enum import Enum
from operator import is_
from typing import Any, NoReturn, TypeVar

import numpy as np

from mavdem.facts import Fact

ValueType = TypeVar("ValueType")
Key = TypeVar("Key")
Value = TypeVar("Value")


IMMUTABLE_TYPES = frozenset({bool, bytes, complex, float, int, str, type(None)})
"""Types of values that cannot be changed and contain nothing: most values are of these.

Types derived from these do not count: NumPy's numbers are some of them.
"""


class ReadOnlyDict(dict[Key, Value]):
    """A dictionary that can be read, merged, pickled and written as JSON, but not changed."""

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        """Takes the place of all methods that change a dictionary, and raises ``TypeError``."""
        raise TypeError("a result cannot be changed: change a copy, dict(…)")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles the dictionary as a call of its constructor with a plain dictionary."""
        # By default pickle fills a dictionary item by item, which is refused here.
        return ReadOnlyDict, (dict(self),)


def freeze(value: ValueType) -> ValueType:
    """Makes a value immutable, with all that it contains.

    Results are cached and shared, so that a change by one caller would change the results of all others. Arrays are set
    read-only in place, and NumPy's scalars become Python's numbers. Dictionaries are copied to a :class:`ReadOnlyDict`.
    Tuples, named tuples and dataclasses are searched for such values; values in a dataclass, even a frozen one, are
    replaced in place.

    Args:
        value: Any value. Other types, lists for example, are returned as they are.

    Returns:
        The frozen value: the same object wherever nothing had to be replaced.
    """
    if type(value) in IMMUTABLE_TYPES:
        return value
    frozen: Any = value
    # Most of the other values are arrays, so that these come first.
    if isinstance(value, np.ndarray):
        value.setflags(write=False)
    elif isinstance(value, (ImmutableResult, Fact, Enum)):
        # The values of an immutable result were frozen when it was created, those of a fact were made plain, and a
        # member of an enumeration has none.
        pass
    elif isinstance(value, np.generic):
        frozen = value.item()
    elif isinstance(value, dict) and not isinstance(value, ReadOnlyDict):
        frozen_items = {}
        for key, item in value.items():
            # An autopilot has a thousand parameters; a call for each number would take most of the time.
            if type(item) not in IMMUTABLE_TYPES:
                item = freeze(item)
            frozen_items[key] = item
        frozen = ReadOnlyDict(frozen_items)
    elif isinstance(value, tuple):
        items = [item if type(item) in IMMUTABLE_TYPES else freeze(item) for item in value]
        is_unchanged = all(map(is_, items, value))
        if not is_unchanged:
            # A named tuple is made by its method ``_make``, since its constructor takes the items one by one.
            frozen = getattr(value, "_make", tuple)(items)
    elif is_dataclass(value):
        _freeze_attributes(value)
    return frozen


def _freeze_attributes(record: Any) -> None:
    """Replaces the values of a dataclass by frozen ones, in place."""
    for name, item in vars(record).items():
        if type(item) not in IMMUTABLE_TYPES:
            object.__setattr__(record, name, freeze(item))


class ImmutableResult:
    """Base class of dataclasses that freeze their values (:func:`freeze`) when they are made and when unpickled."""

    def __post_init__(self) -> None:
        """Freezes the values when the result is made."""
        _freeze_attributes(self)

    def __setstate__(self, values: dict[str, Any]) -> None:
        """Freezes the values again when the result is unpickled."""
        # Arrays lose their read-only flag when they are pickled.
        vars(self).update(values)
        _freeze_attributes(self)
