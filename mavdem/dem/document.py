"""The document of a learned model, ``model.json``: every field by its name, arrays as nested lists.

pydantic checks it by the types of the records' fields.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache, reduce
from operator import or_
from types import UnionType
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    Field,
    PlainValidator,
    TypeAdapter,
    ValidationError,
    WithJsonSchema,
    create_model,
)

from mavdem.dem.record import STRICT, first_problem
from mavdem.dem.settings import Settings
from mavdem.errors import Unreadable
from mavdem.facts import Fact, Level
from mavdem.facts.model import ModelCaution, ModelFile
from mavdem.heading import heading

VERSION = 1
"""Of the document's schema."""
UNITS = {"record.dt": "s", "settings.horizon": "s"}

Kind = TypeVar("Kind")


def to_text(result: Any) -> str:
    """Returns the document of a result, a dataclass."""
    return json.dumps(heading("model", VERSION, UNITS) | _plain(result))


def from_text(kind: type[Kind], text: str) -> Kind:
    """Returns the result of this ``kind`` whose document is ``text``; ``ValueError`` names what is wrong in it."""
    later = (
        re.match(r'\{"document": "model", "schema_version": (\d{1,9})\b', text)
        if isinstance(text, str)
        else None
    )
    if later and int(later[1]) > VERSION:
        raise Unreadable(Fact(ModelFile.OF_LATER_VERSION))
    try:
        result: Kind = _adapter(cast(Any, kind)).validate_json(text)
    except (ValidationError, TypeError) as error:
        problem = first_problem(error) if isinstance(error, ValidationError) else str(error)
        # before documents said what they are
        is_old = isinstance(text, str) and text.startswith('{"settings"')
        fact = Fact(ModelFile.NO_MODEL_DOCUMENT, error=problem, is_old=is_old)
        raise Unreadable(fact) from None
    return result


@cache
def _adapter(kind: type) -> TypeAdapter[Any]:
    return TypeAdapter(_type(kind))


def _plain(value: Any) -> Any:
    """Arrays, tuples and dataclasses as lists and dictionaries."""
    if isinstance(value, Fact):
        return value.advised
    if isinstance(value, np.ndarray):
        return (
            np.where(np.isnan(value), np.array(None), value) if value.dtype.kind == "f" else value
        ).tolist()
    if named := _fields(value):
        return {name: _plain(inner) for name, inner in named.items()}
    if isinstance(value, tuple | list):
        return [_plain(inner) for inner in value]
    return value.item() if isinstance(value, np.generic) else value


def _fields(value: Any) -> dict[str, Any]:
    """What a record or a mapping holds by name; nothing of other values."""
    if isinstance(value, Mapping):
        return dict(value)
    if hasattr(value, "_asdict"):
        return dict(value._asdict())
    return (
        {field.name: getattr(value, field.name) for field in fields(value)}
        if is_dataclass(value)
        else {}
    )


def _type(hint: Any) -> Any:
    """The type by which pydantic reads what is of the type ``hint``."""
    origin = get_origin(hint)
    inner = get_args(hint)
    if origin is np.ndarray:
        return Annotated[
            Any,
            PlainValidator(_array_reader(get_args(inner[1])[0])),
            WithJsonSchema({"type": "array"}),
        ]
    if origin is UnionType:
        return reduce(or_, map(_type, inner))
    if inner and origin is not None:
        origin = dict if origin is Mapping else origin
        return origin[tuple(each if each is ... else _type(each) for each in inner)]
    if hint is Fact:
        return Annotated[str, AfterValidator(_recorded)]
    if isinstance(hint, type) and issubclass(hint, Settings):
        return Annotated[Any, PlainValidator(hint.from_dict)]
    if isinstance(hint, type) and (is_dataclass(hint) or hasattr(hint, "_fields")):
        names = [field.name for field in fields(hint)] if is_dataclass(hint) else hint._fields
        hints = get_type_hints(hint)
        defaults = getattr(hint, "_field_defaults", {})
        if is_dataclass(hint):  # what has a default, documents of former versions may lack
            defaults = {
                each.name: each.default for each in fields(hint) if each.default is not MISSING
            }
            made = {
                each.name: each.default_factory
                for each in fields(hint)
                if each.default_factory is not MISSING
            }
            defaults |= {name: Field(default_factory=make) for name, make in made.items()}
        parts = {name: (_type(hints[name]), defaults.get(name, ...)) for name in names}
        model = create_model(hint.__name__, __config__=STRICT, **parts)  # type: ignore[call-overload]
        return Annotated[model, AfterValidator(lambda part: hint(**dict(part)))]
    return hint


def _recorded(text: str) -> Fact:
    return Fact(ModelCaution.RECORDED, Level.WATCH, text=text)


def _array_reader(dtype: type[np.generic]) -> Callable[[Any], NDArray[Any]]:
    kinds = {"b": "b", "i": "iu"}.get(np.dtype(dtype).kind, "fiuO")

    def read(value: Any) -> NDArray[Any]:
        try:
            if isinstance(value, list) and np.asarray(value).dtype.kind in kinds:
                return np.array(value, dtype)
        except (TypeError, ValueError, OverflowError):
            pass
        raise ValueError("must be numbers of one shape")

    return read
