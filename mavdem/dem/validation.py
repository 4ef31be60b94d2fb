"""Validation of what comes from outside: one sentence that names the field, what it must be, and the value."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from reprlib import Repr
from typing import Any, TypeGuard, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, ValidationError, create_model

STRICT = ConfigDict(strict=True, allow_inf_nan=False)  # no text for a number, no ``True`` for 1, no infinity and no NaN

SHORT = Repr()
SHORT.maxother = SHORT.maxstring = 80


def checked_values(kind: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns values by name, as the fields of ``kind`` are annotated; ``ValueError``: ``<name> must be …, not …``."""
    try:
        return dict(_model(kind).model_validate(values))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        name, said = str(first["loc"][0]), first["msg"].removeprefix("Value error, ")
        said = said.replace("Input should", "must", 1).replace("Tuple should", "must", 1)
        raise ValueError(f"{name} {said}, not {values[name]!r}") from None


@cache
def _model(kind: type) -> type[BaseModel]:
    fields: Any = {name: (hint, ...) for name, hint in get_type_hints(kind, include_extras=True).items()}
    model: type[BaseModel] = create_model("Values", __config__=STRICT, **fields)
    return model


def first_problem(error: ValidationError) -> str:
    """The first thing that pydantic found, as ``<field> must be …, not <value>``, or ``<field> is missing``."""
    first = error.errors(include_url=False)[0]
    name, said = ".".join(map(str, first["loc"])), first["msg"].removeprefix("Value error, ")
    if first["type"] == "missing":
        return f"{name} is missing"
    if first["type"] == "value_error":
        return f"{name} {said}".lstrip()
    return f"{name} {said.replace('Input should be', 'must be', 1)}, not {SHORT.repr(first['input'])}".lstrip()


def real_numbers(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """A new float64 array in C order; ``ValueError``, which names the argument, for anything but real numbers.

    Masked values and dates are refused: the mask would be lost, and a date would become a plain number.
    """
    if np.ma.isMaskedArray(values) and np.ma.is_masked(values):
        raise ValueError(f"{name} must not be masked: fill or leave out what is missing")
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "biufO":
            raise TypeError(f"{array.dtype} is not a real number")
        return np.array(array, dtype=np.float64, order="C")
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name} must be real numbers: {error}") from None


def is_number(value: object) -> TypeGuard[float]:
    """Whether it is one real number, of Python's or numpy's; ``True`` is not."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def is_whole(value: object) -> TypeGuard[int]:
    """Whether it is one whole number of 64 bits, of Python's or numpy's; ``True`` is not."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and abs(int(value)) < 2**63
