"""Checks of the arguments of a fit: numbers, tables of samples and settings, with errors that name the argument."""

from collections.abc import Mapping
from functools import cache
from reprlib import Repr
from typing import Any, TypeGuard, get_type_hints

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from mavdem.arrays import Array, as_real_array
from mavdem.containers import JsonValues

MAX_STEPS = 100_000
"""Most samples that may be predicted ahead: as many take a fraction of a gigabyte, and seconds."""

MIN_STEP = 1e-9
"""Shortest sampling step, s; its inverse is the longest. Beyond, derivatives or their squares overflow or vanish."""

MAX_ABS_VALUE = 1e50
"""Largest size of a sample, in its unit, and of a setting. The squares of larger ones could overflow."""

MAX_COUNT = 1_000_000_000
"""Largest count that is accepted unless a caller gives another limit; a choice."""

STRICT = ConfigDict(strict=True, allow_inf_nan=False)
"""How pydantic reads values: no text for a number, no ``True`` for 1, no infinity and no NaN."""

MAX_QUOTED_LENGTH = 80
"""Characters of a wrong value that an error message quotes."""

_short_repr = Repr()
_short_repr.maxother = _short_repr.maxstring = MAX_QUOTED_LENGTH


def checked_values(record: type, values: Mapping[str, Any]) -> JsonValues:
    """Checks values against the annotated fields of a class.

    Args:
        record: A class whose fields are annotated; the annotations may contain constraints of pydantic.
        values: The value of each field by its name.

    Returns:
        The values by name, as pydantic converts them; it converts lists to tuples, for example.

    Raises:
        ValueError: A value does not agree with its annotation; the message is ``<name> must be …, not <value>``.
    """
    try:
        return dict(_pydantic_model(record).model_validate(values))
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        name = str(problem["loc"][0])
        raise ValueError(f"{name} {_requirement(problem)}, not {values[name]!r}") from None


@cache
def _pydantic_model(record: type) -> type[BaseModel]:
    """Returns a pydantic model in which all annotated fields of a class are required."""
    fields: Any = {}
    for name, hint in get_type_hints(record, include_extras=True).items():
        fields[name] = (hint, ...)
    return create_model("Values", __config__=STRICT, **fields)


def first_problem(error: ValidationError) -> str:
    """Describes the first problem that pydantic found, in the form of this package's other error messages.

    Args:
        error: The error that pydantic has raised for a document or a record.

    Returns:
        ``<field> must be …, not <value>`` or ``<field> is missing``. The field is a dotted path into the document; the
        value is shortened.
    """
    problem = error.errors(include_url=False)[0]
    # The location of a value is the list of keys and indices that lead to it.
    name = ".".join(map(str, problem["loc"]))
    if problem["type"].startswith("missing"):
        return f"{name} is missing"
    requirement = f"{name} {_requirement(problem)}".lstrip()
    # The message of a validator's own error already says what is wrong with the value.
    if problem["type"] == "value_error":
        return requirement
    return f"{requirement}, not {_short_repr.repr(problem['input'])}"


def _requirement(problem: Mapping[str, Any]) -> str:
    """Returns what pydantic requires of a value, as ``must be …`` in place of ``Input should be …``."""
    message = str(problem["msg"].removeprefix("Value error, "))
    return message.replace("Input should", "must", 1).replace("Tuple should", "must", 1)


def is_number(value: object) -> TypeGuard[float]:
    """Returns whether a value is one real number, of Python's or numpy's type; a boolean is not one."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def is_integer(value: object) -> TypeGuard[int]:
    """Returns whether a value is an integer of Python or numpy that fits 64 bits.

    ``True`` and ``False`` are rejected, although Python treats them as integers. A larger number would overflow in
    arrays.

    Args:
        value: Any object.
    """
    return (
        isinstance(value, int | np.integer)
        and not isinstance(value, bool)
        and abs(int(value)) < 2**63
    )


def validated_step(dt: object) -> float:
    """Returns a sampling step ``dt``, in seconds, as a float; raises ``ValueError`` unless it is from 1 ns to 1e9 s."""
    if not (is_number(dt) and MIN_STEP <= dt <= 1 / MIN_STEP):
        raise ValueError(f"dt must be positive seconds, at least {MIN_STEP:g}, not {dt!r}")
    return float(dt)


def validated_count(number: int, name: str = "steps", limit: int = MAX_COUNT) -> int:
    """Checks that an argument is an integer from 1 to a limit.

    Args:
        number: The argument.
        name: Its name, for the message of an error.
        limit: Largest number that is accepted.

    Returns:
        The number, as Python's ``int``.

    Raises:
        ValueError: The argument is not such an integer.
    """
    if not (is_integer(number) and 1 <= number <= limit):
        raise ValueError(f"{name} must be a whole number from 1 to {limit:,}, not {number!r}")
    return int(number)


def validated_directions(values: ArrayLike, motor_count: int) -> Array:
    """Checks that effect directions are finite numbers, one for each motor.

    Args:
        values: Relative effect of each motor on the axis, (r,).
        motor_count: Number of motors, r.

    Returns:
        The effect directions as an array, (r,).

    Raises:
        ValueError: There are more or fewer directions than motors, or one is not finite.
    """
    directions = as_real_array(values, "effect_directions")
    if directions.shape != (motor_count,) or not np.isfinite(directions).all():
        raise ValueError(f"effect_directions must be {motor_count} finite numbers, not {values!r}")
    return directions


def validated_table(values: ArrayLike, name: str, columns: int) -> Array:
    """Checks that an argument is a table of finite samples.

    Args:
        values: The samples, (H, columns); (H,) is accepted for a single column.
        name: Name of the argument, for the message of an error.
        columns: Number of columns that the table must have.

    Returns:
        The samples as an array, (H, columns).

    Raises:
        ValueError: The table has another shape, or a value is not finite.
    """
    samples = as_real_array(values, name)
    if samples.ndim == 1 and columns == 1:
        samples = samples[:, None]
    if samples.ndim != 2 or samples.shape[1] != columns:
        raise ValueError(f"{name} must have shape (H, {columns}), not {samples.shape}")
    if not np.isfinite(samples).all():
        raise ValueError(f"{name} must be finite")
    return samples


def require_finite_and_bounded(samples: Array, name: str) -> None:
    """Checks that all samples are finite and at most ``MAX_ABS_VALUE``, so that their squares are finite.

    Args:
        samples: samples of any shape.
        name: name of the argument, with which the error message begins.

    Raises:
        ValueError: a sample is NaN, infinite or too large.
    """
    # If a value is NaN the maximum is NaN, for which no comparison is true.
    if abs(samples).max(initial=0.0) <= MAX_ABS_VALUE:
        return
    if not np.isfinite(samples).all():
        raise ValueError(f"{name} must be finite")
    raise ValueError(f"{name} must not be larger than {MAX_ABS_VALUE:g}")
