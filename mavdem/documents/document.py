"""The base class of all JSON documents, and fields for a fact (a finding with a code and figures) and its sentence.

The other modules of this package have the models of the documents: their keys with types, units and meanings, of which
the published JSON schemas are made. A field is filled with the attribute of the same name of a result, where an array
becomes a list and a fact becomes its sentence.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from types import UnionType
from typing import Annotated, Any, Self, Union, get_args, get_origin

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    field_validator,
    model_validator,
)
from pydantic.fields import FieldInfo

from mavdem.containers import JsonValues
from mavdem.facts import Fact
from mavdem.facts.model import ModelName


def _sentence(value: Any) -> Any:
    """Converts a fact to its sentence, and None to an empty text; other values, such as texts, stay as they are."""
    if value is None:
        return ""
    if isinstance(value, Fact):
        return str(value)
    return value


def _sentence_with_remedy(value: Any) -> Any:
    """Converts a fact to its sentence followed by its remedy, and None to an empty text; other values stay."""
    if isinstance(value, Fact):
        return value.sentence_and_remedy
    return _sentence(value)


SentenceText = Annotated[str, BeforeValidator(_sentence)]
"""Type of a field with the sentence of a fact; empty without a fact."""

ModelField = Annotated[str, BeforeValidator(str)]
"""Type of a field with the name of the model that made the figures beside it (``mavdem.facts.model.ModelName``)."""

AdviceText = Annotated[str, BeforeValidator(_sentence_with_remedy)]
"""Type of a field with the sentence of a fact and what to do about it; empty without a fact."""

SentenceAndFact = SentenceText
"""Type of a field NAME with the sentence of a fact, to which a field NAME_fact with the fact itself is added.

A list of this type gets a field NAME_facts. The fields are added by :class:`Document`, which looks for the name of this
type in the annotations.
"""

AdviceAndFact = AdviceText
"""Like ``SentenceAndFact``, where the sentence is followed by the remedy."""

ADDS_FACT = "AndFact"
"""How the names of types end for which a field with the fact is added."""


def fact_field(attribute: str, meaning: str) -> Any:
    """Returns the pydantic definition of an optional field with a fact, or with a list of facts.

    A document has a finding in two fields: NAME is its sentence, for people, and NAME_fact the fact itself, a code with
    figures, for programs. Both are filled from the attribute NAME of a result: the alias of this field is that name,
    and the types of the two fields convert the same fact to a sentence or to a record.

    Args:
        attribute: name of the result's attribute. If its value is a text and no ``Fact``, this field is null or an
            empty list, since a text has no code.
        meaning: description of the field in the schema.

    Returns:
        The definition, whose default is None.
    """
    return Field(default=None, validation_alias=attribute, description=meaning)


class Document(BaseModel):
    """A record of a JSON document: immutable, of exactly these keys."""

    # The models are built when they are first used, since all of them together take long. Arrays and other results are
    # read by their attributes. ``DescribedSchema`` makes schemas with the docstrings of fields as descriptions.
    model_config = ConfigDict(
        defer_build=True,
        extra="forbid",
        from_attributes=True,
        frozen=True,
        protected_namespaces=(),
    )

    def __init_subclass__(cls, is_partial: bool = False, **options: Any) -> None:
        """Adds the fields with facts beside fields of the types ``SentenceAndFact`` and ``AdviceAndFact``.

        A sentence of a document is for people; the fact beside it has the same content for programs: a code with
        figures. So that no document declares both, each field of these types gets a second one, named ``…_fact``, or
        ``…_facts`` for a list. This changes the annotations, which are texts, before pydantic makes fields of them.

        Args:
            is_partial: whether all keys of the document may be absent; they then may also be null.
            **options: options of pydantic.
        """
        super().__init_subclass__(**options)
        annotations: dict[str, Any] = {}
        for name, annotation in cls.__annotations__.items():
            annotations[name] = annotation
            if is_partial and name not in vars(cls):
                annotations[name] = f"{annotation} | None"
                setattr(cls, name, None)
            if ADDS_FACT not in annotation:
                continue
            if "list[" in annotation:
                annotations[f"{name}_facts"] = FactList
                setattr(cls, f"{name}_facts", fact_field(name, f"{name} as facts"))
            else:
                meaning = f"{name} as a fact; null where there is none"
                annotations[f"{name}_fact"] = OptionalFact
                setattr(cls, f"{name}_fact", fact_field(name, meaning))
        cls.__annotations__ = annotations

    @field_validator("*", mode="before")
    @classmethod
    def _array_as_list(cls, value: Any) -> Any:
        """Converts NumPy arrays and NumPy numbers to plain lists and numbers before a field is checked."""
        return value.tolist() if hasattr(value, "tolist") else value

    @model_validator(mode="after")
    def _keep_model_name(self) -> Self:
        """Makes :meth:`as_dict` write the key ``model`` of a document whose figures all come from the same model.

        Such a document declares the name of the model as the default of its field ``model``. No caller passes a value,
        so pydantic counts the field as not set, and :meth:`as_dict` would leave it out. So it is marked as set here.
        """
        field = type(self).model_fields.get("model")
        if field is not None and isinstance(field.default, ModelName):
            self.__pydantic_fields_set__.add("model")
        return self

    @classmethod
    def from_results(cls, *results: Any, **values: Any) -> Self:
        """Makes the document from several results and values.

        Args:
            *results: objects whose attributes fill the fields of the same names; where several have an attribute, the
                first one counts.
            **values: values of fields, which take the place of attributes.

        Returns:
            The document. Optional fields for which there is neither a value nor an attribute are absent from its JSON.

        Raises:
            pydantic.ValidationError: a value has a wrong type, or one that is needed is missing.
        """
        # A field is filled from the attribute that its alias names, or from the one of its own name.
        attributes = {
            str(field.validation_alias or name) for name, field in cls.model_fields.items()
        }
        field_values = dict(values)
        for attribute in attributes - values.keys():
            for result in results:
                if hasattr(result, attribute):
                    field_values[attribute] = getattr(result, attribute)
                    # The first result that has the attribute counts.
                    break
        return cls.model_validate(field_values)

    def as_dict(self) -> JsonValues:
        """Returns plain JSON values, without keys that were never set; NaN and infinite numbers become null."""
        values = self.model_dump(mode="json", exclude_unset=True)
        return {name: _without_nan(value) for name, value in values.items()}


class Sentence(Document):
    """A fact: its code, level, time and figures, with its sentence and remedy in words."""

    code: str
    """what it says"""
    level: str
    """how much it matters: good, watch, bad or unknown"""
    time: float | None
    """when it was so, s on the boot clock; null where it is of no time"""
    until: float | None = Field(validation_alias="end_time")
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
    def _plain_figures(cls, values: Any) -> Any:
        """Converts the figures of a fact, by name, to plain JSON values."""
        return {name: _plain_figure(value) for name, value in values.items()}


def _fact_or_none(value: Any) -> Any:
    """Returns a value if it is a fact, not a plain sentence, otherwise None."""
    return value if isinstance(value, Fact) else None


def _facts_only(values: Any) -> Any:
    """Returns the values that are facts, not plain sentences, as a list; None counts as no values."""
    return [value for value in values or () if isinstance(value, Fact)]


OptionalFact = Annotated[Sentence | None, BeforeValidator(_fact_or_none)]
"""Type of a field with a fact as a record; null where its value is no fact."""

FactList = Annotated[list[Sentence], BeforeValidator(_facts_only)]
"""Type of a field with facts as records; values that are no facts are left out."""


class Judged(Document):
    """Headline, lights and next step of a flight."""

    headline: SentenceAndFact
    """the worst that was found, or how the flight was lost, one sentence"""
    lights: dict[str, Sentence]
    """motors, vibration, tracking, margins, power, estimator, wind and log, each with its level"""
    next_step: SentenceAndFact
    """what to do next, one sentence"""


class Error(Document):
    """Why there is no result."""

    reason: SentenceText
    """what is wrong, one sentence"""
    remedy: SentenceText
    """what to do; empty where the reason says it"""
    fact: OptionalFact = None
    """the same as a fact"""


class Failure(Document):
    """A command that ends without a document of its own."""

    error: Error
    """why there is no result"""


def _plain_figure(value: Any) -> Any:
    """Converts a figure of a fact (coded finding) to a plain JSON value.

    A figure may itself be a fact, such as the reason of the first. It becomes a dictionary of its figures and its code.

    Args:
        value: a number, a text, an array, an enumeration's member, a fact, or a collection of these.

    Returns:
        The plain value.
    """
    if isinstance(value, Fact):
        figures = {name: _plain_figure(figure) for name, figure in value.figures.items()}
        return figures | {"code": value.code}
    if isinstance(value, tuple):
        return [_plain_figure(element) for element in value]
    return value


def _without_nan(value: Any) -> Any:
    """Replaces NaN and infinite numbers by None, since JSON has no such numbers.

    Args:
        value: a JSON value, with nested lists and dictionaries.

    Returns:
        A copy of the value.
    """
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_nan(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def document_units(document: type[Document]) -> dict[str, str]:
    """Returns the units of all figures of a document, which are stated in the definitions of its fields.

    The JSON schema of the document has the same units, but it takes a tenth of a second to be made.

    Args:
        document: class of the document.

    Returns:
        Units by the path of the key, such as ``wind.speed``. In a path ``*`` stands for any key of a dictionary and any
        place in a list.
    """
    # The annotations of a class are texts until it is built.
    document.model_rebuild()
    return dict(_units_below(document, path="", parents=()))


def _units_below(
    annotation: Any, path: str, parents: tuple[type[BaseModel], ...]
) -> Iterator[tuple[str, str]]:
    """Yields the path and the unit of each figure in a type, found by walking through the annotations of its fields.

    Args:
        annotation: the type, or a type of typing, such as ``list[Speed]``. A unit is metadata of an annotated type.
        path: path of the values of this type, keys separated by dots. Every item of a list, and every value of a
            dictionary, has the key "*".
        parents: records that the type is in. A record that contains itself is not entered again.
    """
    # The origin of ``list[Speed]``, for example, is ``list``, and its only argument is ``Speed``.
    origin = get_origin(annotation)
    arguments = get_args(annotation)
    if origin is Annotated:
        # The first argument is the type itself, the others are its metadata.
        for metadata in arguments[1:]:
            if isinstance(metadata, FieldInfo):
                yield from _unit_of_field(metadata, path)
        yield from _units_below(arguments[0], path, parents)
    elif origin in (Union, UnionType):
        for alternative in arguments:
            yield from _units_below(alternative, path, parents)
    elif origin is dict:
        # The arguments are the types of keys and values.
        yield from _units_below(arguments[1], f"{path}.*", parents)
    elif origin in (list, tuple):
        for item in arguments:
            yield from _units_below(item, f"{path}.*", parents)
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
        if annotation not in parents:
            yield from _units_of_model(annotation, path, parents)


def _units_of_model(
    model: type[BaseModel], path: str, parents: tuple[type[BaseModel], ...]
) -> Iterator[tuple[str, str]]:
    """Yields the path and the unit of each figure in the fields of a record.

    Args:
        model: type of the record.
        path: path of the record, keys separated by dots; empty for the document itself.
        parents: records that this one is in.
    """
    for name, field in model.model_fields.items():
        key_path = f"{path}.{name}".removeprefix(".")
        yield from _unit_of_field(field, key_path)
        yield from _units_below(field.annotation, key_path, (*parents, model))


def _unit_of_field(field: FieldInfo, path: str) -> Iterator[tuple[str, str]]:
    """Yields the path and the unit of a field that has one.

    Args:
        field: definition of the field, with the unit where ``mavdem.units.with_unit`` added it.
        path: path of the field's values.
    """
    extra = field.json_schema_extra
    if isinstance(extra, dict) and "unit" in extra:
        # A unit of a list, or of a list of lists, stands at the key of the list itself.
        yield path.removesuffix(".*").removesuffix(".*"), str(extra["unit"])
