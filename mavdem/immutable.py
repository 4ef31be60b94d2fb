"""Immutable: results of Python's numbers, whose arrays and dictionaries nobody can change, however deep they stand."""

from dataclasses import is_dataclass
from operator import is_
from typing import Any, NoReturn, TypeVar

import numpy as np

Kind = TypeVar("Kind")
Key = TypeVar("Key")
Value = TypeVar("Value")


class ReadOnlyDict(dict[Key, Value]):
    """A dictionary of a result: it can be read, merged, pickled and written as JSON, but not changed."""

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise TypeError("a result cannot be changed: change a copy, dict(…)")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[Any, ...]:
        return ReadOnlyDict, (dict(self),)


def freeze(result: Kind) -> Kind:
    """Returns a result of Python's numbers; arrays and dictionaries in it, tuples and records too, stay as they are."""
    changed: Any = result
    if isinstance(result, np.ndarray):
        result.setflags(write=False)
    elif isinstance(result, np.generic):
        changed = result.item()
    elif isinstance(result, dict) and not isinstance(result, ReadOnlyDict):
        changed = ReadOnlyDict({key: freeze(value) for key, value in result.items()})
    elif isinstance(result, tuple):
        parts = tuple(map(freeze, result))
        # what can be changed nowhere stays the same object
        if not all(map(is_, parts, result)):
            changed = getattr(result, "_make", tuple)(parts)
    elif is_dataclass(result):
        for name, value in vars(result).items():
            object.__setattr__(result, name, freeze(value))
    return changed


class ImmutableResult:
    """A dataclass that is :func:`freeze`, where it is made and where it is unpickled."""

    __post_init__ = freeze

    def __setstate__(self, values: dict[str, Any]) -> None:
        vars(self).update(values)
        freeze(self)
