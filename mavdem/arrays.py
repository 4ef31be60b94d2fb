"""Types of arrays, and how they are written as JSON."""

from functools import partial
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import PlainSerializer, PlainValidator, WithJsonSchema


def _from_lists(dtype: type[np.generic], kinds: str, value: Any) -> NDArray[Any]:
    """Returns the array of a document's nested lists.

    Args:
        dtype: of the array.
        kinds: the kinds of numbers that the lists may have, as ``numpy.dtype.kind`` codes.
        value: the nested lists.

    Raises:
        ValueError: they are not lists, not of one shape, or of other kinds.
    """
    try:
        if isinstance(value, list) and np.asarray(value).dtype.kind in kinds:
            return np.array(value, dtype)
    except (TypeError, ValueError, OverflowError):
        pass
    raise ValueError("must be numbers of one shape")


def _to_lists(values: NDArray[Any]) -> Any:
    """Returns nested lists, with None in the place of NaN, which JSON does not have."""
    missing = np.isnan(values)
    return np.where(missing, np.array(None), values).tolist() if missing.any() else values.tolist()


_SERIALIZER = PlainSerializer(_to_lists)
_SCHEMA = WithJsonSchema({"type": "array"})

Array = Annotated[
    NDArray[np.float64],
    PlainValidator(partial(_from_lists, np.float64, "fiuO")),
    _SERIALIZER,
    _SCHEMA,
]
"""Floating-point numbers of any shape."""
ArrayPair = tuple[Array, Array]
Indices = Annotated[
    NDArray[np.intp], PlainValidator(partial(_from_lists, np.intp, "iu")), _SERIALIZER, _SCHEMA
]
"""Indices into another array."""
Flags = Annotated[
    NDArray[np.bool_], PlainValidator(partial(_from_lists, np.bool_, "b")), _SERIALIZER, _SCHEMA
]
"""True or false for each element of another array."""
Integers = NDArray[np.int64]


def as_real_array(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Returns a new float64 array in C order; ``ValueError``, which names the argument, for all but real numbers.

    Masked values and dates are refused: the mask would be lost, and a date would become a plain number.
    """
    if np.ma.is_masked(values):
        raise ValueError(
            f"{name} must not be masked: leave out what is missing, or cut there with Flight.segments"
        )
    try:
        if (kind := np.asarray(values).dtype).kind not in "biufO":
            raise TypeError(f"{kind} are none")
        # products round otherwise in another order
        return np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name} must be real numbers: {error}") from None
