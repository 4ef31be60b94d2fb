"""Types of NumPy arrays, their form in JSON documents, and the check that a caller's values are real numbers."""

from functools import partial
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import PlainSerializer, PlainValidator, WithJsonSchema

SMALLEST_POSITIVE = np.finfo(np.float64).tiny
"""Smallest normal float, 2e-308: added or used as a floor, it avoids division by zero and the logarithm of zero."""

FLOAT_KINDS = "fiuO"
"""Kinds of ``numpy.dtype`` whose JSON lists are read as floating-point numbers.

Objects ("O") are among them, because a list with None, which stands for NaN, becomes an array of objects.
"""

INDEX_KINDS = "iu"
"""Kinds of ``numpy.dtype`` whose JSON lists are read as indices: whole numbers only."""

FLAG_KINDS = "b"
"""Kind of ``numpy.dtype`` whose JSON lists are read as flags: Booleans only."""

REAL_NUMBER_KINDS = "biufO"
"""Kinds of ``numpy.dtype`` that a caller's real numbers may have; neither complex numbers nor texts nor dates."""


def _array_from_json(dtype: type[np.generic], accepted_kinds: str, value: Any) -> NDArray[Any]:
    """Converts nested lists of a JSON document to an array, when pydantic validates a field of one of the types below.

    Args:
        dtype: Type of the array's elements.
        accepted_kinds: Kinds of numbers that the lists may hold, as codes of ``numpy.dtype.kind``.
        value: The nested lists; None stands for NaN.

    Returns:
        An array of that type, with the shape of the nested lists.

    Raises:
        ValueError: The value is no list, the lists are ragged, or they hold numbers of another kind.
    """
    try:
        # The kind is taken before the conversion, which would turn texts or fractions into the wanted type.
        if isinstance(value, list) and np.asarray(value).dtype.kind in accepted_kinds:
            return np.array(value, dtype)
    except (TypeError, ValueError, OverflowError):
        # The one reason below covers all of these errors.
        pass
    raise ValueError("must be numbers of one shape")


def _json_from_array(values: NDArray[Any]) -> Any:
    """Converts an array to nested lists, with None in the place of NaN, which JSON does not have."""
    is_nan = np.isnan(values)
    if is_nan.any():
        return np.where(is_nan, np.array(None), values).tolist()
    return values.tolist()


_JSON_SERIALIZER = PlainSerializer(_json_from_array)
_JSON_SCHEMA = WithJsonSchema({"type": "array"})

Array = Annotated[
    NDArray[np.float64],
    PlainValidator(partial(_array_from_json, np.float64, FLOAT_KINDS)),
    _JSON_SERIALIZER,
    _JSON_SCHEMA,
]
"""Floating-point numbers of any shape."""

ArrayPair = tuple[Array, Array]
"""Two arrays of floating-point numbers, such as inputs and outputs of the same samples."""

Indices = Annotated[
    NDArray[np.intp],
    PlainValidator(partial(_array_from_json, np.intp, INDEX_KINDS)),
    _JSON_SERIALIZER,
    _JSON_SCHEMA,
]
"""Indices into another array."""

Flags = Annotated[
    NDArray[np.bool_],
    PlainValidator(partial(_array_from_json, np.bool_, FLAG_KINDS)),
    _JSON_SERIALIZER,
    _JSON_SCHEMA,
]
"""True or false for each element of another array."""

Integers = NDArray[np.int64]
"""Whole numbers that are no indices, such as counts and time stamps in microseconds."""


def as_real_array(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Converts a caller's values to a new array of real numbers.

    Masked values and dates are refused: the mask would be lost, and a date would become a plain number.

    Args:
        values: Numbers of any shape: an array, nested lists or a single number.
        name: Name of the caller's argument, for the message of an error.

    Returns:
        A copy in C order, so that products of the same numbers are rounded the same way whatever their origin.

    Raises:
        ValueError: The values are masked or no real numbers; the message begins with ``name``.
    """
    if np.ma.is_masked(values):
        raise ValueError(
            f"{name} must not be masked: leave out what is missing, or cut there with Flight.segments"
        )
    try:
        dtype = np.asarray(values).dtype
        if dtype.kind not in REAL_NUMBER_KINDS:
            raise TypeError(f"{dtype} are none")
        return np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name} must be real numbers: {error}") from None


def cumulative_integral(values: Array, steps: Array) -> Array:
    """Integrates samples over time by the trapezoidal rule, from 0 at the first sample.

    ``scipy.integrate.cumulative_trapezoid`` does the same, but takes half a second to import.

    Args:
        values: (N,) or (N, k) samples.
        steps: (N - 1,) time between them, s.

    Returns:
        The integrals up to each sample, shaped like ``values``.
    """
    areas = steps * (values[1:] + values[:-1]).T / 2
    integrals = np.zeros_like(values)
    integrals[1:] = np.cumsum(areas, axis=-1).T
    return integrals
