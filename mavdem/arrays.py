"""Types of arrays, and how they are written as JSON."""

from functools import partial
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
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
Pair = tuple[Array, Array]
Indices = Annotated[
    NDArray[np.intp], PlainValidator(partial(_from_lists, np.intp, "iu")), _SERIALIZER, _SCHEMA
]
"""Indices into another array."""
Flags = Annotated[
    NDArray[np.bool_], PlainValidator(partial(_from_lists, np.bool_, "b")), _SERIALIZER, _SCHEMA
]
"""True or false for each element of another array."""
Integers = NDArray[np.int64]
