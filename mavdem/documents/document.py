"""Document: the JSON of a result; the models in this room have its keys, units and meanings, and make its schema.

A field takes the attribute of its name from the result: an array as a list, a fact as its sentence. What is made of
several results, :meth:`Document.gather` puts together.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator

from mavdem.containers import JsonValues
from mavdem.facts import Fact


def _said(value: Any) -> Any:
    return "" if value is None else str(value) if isinstance(value, Fact) else value


Said = Annotated[str, BeforeValidator(_said)]
"""The sentence of a fact; empty without one."""


def _advised(value: Any) -> Any:
    return value.advised if isinstance(value, Fact) else _said(value)


Advised = Annotated[str, BeforeValidator(_advised)]
"""The sentence of a fact and its remedy; empty without one."""


Told = Said
ToldWithRemedy = Advised
"""The same, and beside it, in ``…_fact`` or ``…_facts``, what it is the sentence of, where that is a fact."""


def beside(name: str, meaning: str) -> Any:
    """Returns the field that takes the attribute ``name`` where that is a fact, not where it is its sentence only."""
    return Field(default=None, validation_alias=name, description=meaning)


class Document(BaseModel):
    """A record of a document: immutable, of exactly these keys."""

    model_config = ConfigDict(
        defer_build=True,
        extra="forbid",
        from_attributes=True,
        frozen=True,
        protected_namespaces=(),
        use_attribute_docstrings=True,
    )

    def __init_subclass__(cls, is_partial: bool = False, **options: Any) -> None:
        """Adds the facts of keys that are ``Told``; those of a partial document may be absent."""
        super().__init_subclass__(**options)
        kinds = {}
        for name, kind in cls.__annotations__.items():
            kinds[name] = kind
            if is_partial and name not in vars(cls):
                kinds[name] = f"{kind} | None"
                setattr(cls, name, None)
            if "list[Told" in kind:
                kinds[f"{name}_facts"] = Facts
                setattr(cls, f"{name}_facts", beside(name, f"{name} as facts"))
            elif "Told" in kind:
                meaning = f"{name} as a fact; null where there is none"
                kinds[f"{name}_fact"] = OneFact
                setattr(cls, f"{name}_fact", beside(name, meaning))
        cls.__annotations__ = kinds

    @field_validator("*", mode="before")
    @classmethod
    def _plain(cls, value: Any) -> Any:
        return value.tolist() if hasattr(value, "tolist") else value

    @classmethod
    def gather(cls, *results: Any, **given: Any) -> Self:
        """Returns the document of the ``given`` values, and of the first of the ``results`` that has each other."""
        values = dict(given)
        names = {str(field.validation_alias or name) for name, field in cls.model_fields.items()}
        for name in names - given.keys():
            holder = next((result for result in results if hasattr(result, name)), None)
            if holder is not None:
                values[name] = getattr(holder, name)
        return cls.model_validate(values)

    def as_dict(self) -> JsonValues:
        """Returns plain JSON values, without keys that were not given; NaN and infinity become null."""
        return {
            name: _finite(value)
            for name, value in self.model_dump(mode="json", exclude_unset=True).items()
        }


class Sentence(Document):
    """A fact with its words."""

    code: str
    """what it says"""
    level: str
    """how much it matters: good, watch, bad or unknown"""
    time: float | None
    """when it was so, s on the boot clock; null where it is of no time"""
    until: float | None
    """until when, s on the boot clock; null where it is of no time, or still so"""
    subject: str
    """what it is about; empty where that is the flight as a whole"""
    figures: JsonValues
    """its figures by name"""
    units: dict[str, str]
    """their units by name"""
    sentence: str
    """the fact in words"""
    remedy: str
    """what to do about it; empty where there is nothing to be done"""

    @field_validator("figures", "units", mode="before")
    @classmethod
    def _named(cls, values: Any) -> Any:
        return {name: _figure(value) for name, value in values.items()}


def _fact(value: Any) -> Any:
    return value if isinstance(value, Fact) else None


def _facts(values: Any) -> Any:
    return [value for value in values or () if isinstance(value, Fact)]


OneFact = Annotated[Sentence | None, BeforeValidator(_fact)]
Facts = Annotated[list[Sentence], BeforeValidator(_facts)]


class Judged(Document):
    """What is judged of the flight."""

    headline: Told
    """the worst that was found, or how the flight was lost, one sentence"""
    lights: dict[str, Sentence]
    """motors, vibration, tracking, margins, power, estimator, wind and log, each with its level"""
    next_step: Told
    """what to do next, one sentence"""


class Error(Document):
    """Why there is no result."""

    reason: Said
    """what is wrong, one sentence"""
    remedy: Said
    """what to do; empty where the reason says it"""
    fact: OneFact = None
    """the same as a fact"""


class Failure(Document):
    """A command that ends without a document of its own."""

    error: Error
    """why there is no result"""


def _figure(value: Any) -> Any:
    if isinstance(value, Fact):
        return {name: _figure(figure) for name, figure in value.figures.items()} | {
            "code": value.code
        }
    if isinstance(value, tuple):
        return [_figure(item) for item in value]
    return value


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def units_of(schema: Mapping[str, Any]) -> dict[str, str]:
    """Returns the unit of each key of a JSON ``schema``, by its place; * stands for any key or place in a list."""
    return dict(_units(schema, schema.get("$defs", {}), "", ()))


def _units(
    schema: Mapping[str, Any], records: Mapping[str, Any], path: str, above: tuple[str, ...]
) -> Iterator[tuple[str, str]]:
    if "unit" in schema:
        yield path.removesuffix(".*").removesuffix(".*"), schema["unit"]
    name = schema.get("$ref", "").rpartition("/")[2]
    if name and name not in above:
        yield from _units(records[name], records, path, (*above, name))
    for inner in schema.get("anyOf", ()):
        yield from _units(inner, records, path, above)
    for key, inner in schema.get("properties", {}).items():
        yield from _units(inner, records, f"{path}.{key}".removeprefix("."), above)
    for rest in ("items", "additionalProperties"):
        if isinstance(schema.get(rest), dict):
            yield from _units(schema[rest], records, f"{path}.*", above)
