"""The JSON document of a learned model, ``model.json``: writing it, and reading it with errors that say what is wrong.

Every field of the result and of the records within it is a key; arrays are nested lists. pydantic writes and reads the
document by the annotations of the fields.
"""

import json
import re
from functools import cache
from typing import Any, TypeVar, cast

from pydantic import TypeAdapter, ValidationError

from mavdem.dem.validation import first_problem
from mavdem.document_heading import document_heading
from mavdem.errors import Unreadable
from mavdem.facts import Fact
from mavdem.facts.model import ModelFile

VERSION = 2
"""Version of the document's schema; documents of later versions are refused."""

UNITS = {"record.dt": "s", "settings.horizon": "s"}
"""Unit by dotted key, for the document's heading."""

HEADING_PATTERN = re.compile(r'\{"document": "model", "schema_version": (\d{1,9})\b')
"""Beginning of a document that has a heading; its group is the version of the schema."""

FORMER_BEGINNING = '{"settings"'
"""Beginning of documents of earlier versions, which had no heading."""

ResultType = TypeVar("ResultType")


def to_text(result: Any) -> str:
    """Returns the JSON document of a result, which is a dataclass."""
    # The training data is most of it. Written straight to text, they need not become lists of Python's numbers.
    values = _adapter(cast(Any, type(result))).dump_json(result).decode()
    heading = json.dumps(document_heading("model", VERSION, UNITS))
    return f"{heading.removesuffix('}')}, {values.removeprefix('{')}"


def from_text(result_type: type[ResultType], text: str) -> ResultType:
    """Reads a result from its JSON document.

    Args:
        result_type: The dataclass of the result.
        text: The document, as :func:`to_text` returns it.

    Returns:
        The result, an instance of ``result_type``.

    Raises:
        Unreadable: The document has a later version of the schema, or is not a document of this type. The message names
            the first key that is missing or has a wrong value, and says if the document is from an earlier version.
    """
    version = _schema_version(text)
    if version is not None and version > VERSION:
        raise Unreadable(ModelFile.OF_LATER_VERSION)
    # The error of pydantic names the problem, whether the text cannot be parsed, lacks a key or has a wrong value. A
    # TypeError means that the argument is not a text.
    try:
        return _adapter(cast(Any, result_type)).validate_json(text, strict=True)
    except (ValidationError, TypeError) as error:
        problem = first_problem(error) if isinstance(error, ValidationError) else str(error)
        is_from_earlier_version = isinstance(text, str) and text.startswith(FORMER_BEGINNING)
    message = Fact(ModelFile.NO_MODEL_DOCUMENT, error=problem, is_old=is_from_earlier_version)
    raise Unreadable(message)


def _schema_version(text: object) -> int | None:
    """Returns the version of the schema in a document's heading.

    It is read from the beginning of the text, so that a later version is recognised before the document is parsed.

    Args:
        text: The document.

    Returns:
        The version; None if there is no heading, as in earlier versions and other files, or ``text`` is not a string.
    """
    if not isinstance(text, str):
        return None
    heading = HEADING_PATTERN.match(text)
    return int(heading[1]) if heading else None


@cache
def _adapter(result_type: type) -> TypeAdapter[Any]:
    """Returns pydantic's reader and writer of a type, which is made once for each type."""
    return TypeAdapter(result_type)
